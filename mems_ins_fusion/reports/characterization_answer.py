"""The answer of a characterization: the content of imu.yaml, how well the recording supports it, and its effect on the
road."""
from __future__ import annotations

import shlex

from ..characterization.characterize import Characterization
from ..recordings.checker import INFO, Remark
from ..recordings.remarks import checked_text
from .answer import GOOD, WARNING, YOURS, Answer, Step
from .colours import MODEL_NAMES
from .html import number

#: m/s^2, smallest gravity on the surface of the earth (high mountains at the equator)
LEAST_GRAVITY = 9.76
#: m/s^2, largest gravity there (the poles)
MOST_GRAVITY = 9.84
#: smallest length of a recording in correlation times for good estimates of sigma and tau of Gauss-Markov
FEWEST_TIMES = 20
#: m/s, speed at which an error of the heading is converted to metres
SPEED = 15.0
#: share of the recording above which excluded parts are mentioned
DISTURBED = 0.05


def answer(c: Characterization, checked: list[Remark], topics: dict[str, str], output: str) -> Answer:
    """The answer. checked: findings of the checker about `topics`. output: folder of the results, for the command."""
    wrong = [*_about_gravity(c), *_about_length(c), *_about_disturbances(c),
             *(checked_text(f, topics) for f in checked if f.severity != INFO)]
    quiet = _quiet(c)
    return Answer(GOOD if not wrong else WARNING, _headline(c, wrong), wrong, _cost(c), _steps(c, output),
                  _trust(c, quiet))


def _quiet(c: Characterization) -> list[str]:
    return [a.name for a in c.axes if not a.significant]


def short(c: Characterization) -> list[str]:
    """Axes with a recording of fewer than FEWEST_TIMES correlation times."""
    return [a.name for a in c.axes if a.significant and c.duration < FEWEST_TIMES * a.fits['gauss_markov'].model.tau]


def _headline(c: Characterization, wrong: list[str]) -> str:
    decided = sum(a.recommendation.decided for a in c.axes)
    model = MODEL_NAMES[c.model]
    if decided == len(c.axes):
        why = 'the data decide for it on all axes'
    elif any(not a.recommendation.decided and a.recommendation.model != c.model for a in c.axes):
        why = 'all axes together decide, not each alone'
    elif decided:
        why = f'the data decide on {decided} of {len(c.axes)} axes; elsewhere it is the simplest that does as well'
    else:
        why = 'it is the simplest, and the data show no other to be better'
    return f'Use imu.yaml with the {model} model: {why}.' + (' See below what limits it.' if wrong else '')


def _about_gravity(c: Characterization) -> list[str]:
    off = max(LEAST_GRAVITY - c.gravity, c.gravity - MOST_GRAVITY)
    if off <= 0:
        return []
    return [f'The mean specific force is {c.gravity:.3f} m/s², which is gravity nowhere on earth: the accelerometers '
            f'have a bias or scale error of at least {number(off, 2)} m/s², mostly on the vertical axis.']


def _about_length(c: Characterization) -> list[str]:
    axes = short(c)
    if not axes:
        return []
    longest = max(a.fits['gauss_markov'].model.tau for a in c.axes if a.name in axes)
    return [f'The recording is short for the slow errors of {", ".join(axes)}: sigma and tau of Gauss-Markov are '
            f'uncertain there, only their ratio, the driving noise, is well known. '
            f'{number(FEWEST_TIMES * longest / 3600, 2)} h would show them.']


def _about_disturbances(c: Characterization) -> list[str]:
    said = []
    cut = sum(x.stop - x.start for x in c.rest.cuts)
    if cut > DISTURBED * c.duration:
        said.append(f'{len(c.rest.cuts)} disturbances, {cut:.0f} s in all, were cut out: something moved the IMU.')
    if c.rest.shifts:
        said.append(f'The level shifted {len(c.rest.shifts)} times without a disturbance: the table tilted, or a bias '
                    'jumped.')
    return said


def _cost(c: Characterization) -> list[str]:
    """Effect on the road of the errors that the recommended model predicts to remain."""
    said = []
    for sensor, factor, text in (('accelerometer', 0.5, ''), ('gyroscope', 0.5 * SPEED, f' at {SPEED:g} m/s')):
        predictions = [a.predictions[c.model] for a in c.of(sensor) if len(a.predictions[c.model].horizons)]
        if predictions:
            horizon = predictions[0].horizons[-1]
            error = max(p.horizon_rmse[-1] for p in predictions)
            said.append(f'{number(horizon, 3)} s without fixes: the {sensor}s alone cost about '
                        f'{number(factor * error * horizon**2, 2)} m{text} (worst axis, from held-out data).')
    return said


def _trust(c: Characterization, quiet: list[str]) -> str:
    if not quiet:
        return f'Yes: a slow error is seen on all axes in {number(c.duration / 3600, 2)} h at rest.'
    return (f'White noise yes. No slow error was seen on {", ".join(quiet)}: there, imu.yaml holds the upper limit of '
            'what could be, so the filter stays on the safe side; a longer recording would show more.')


def _steps(c: Characterization, output: str) -> list[Step]:
    files = f'--params-file {YOURS} --params-file {shlex.quote(f"{output}/imu.yaml")}'
    return [Step(f'Diagnose a drive with it, after the file with topics and mounting ({YOURS}); the later file counts:',
                 f'python -m mems_ins_fusion diagnose --bag DRIVE {files} --output diagnosis'),
            Step('Drive with both:', f'python -m mems_ins_fusion fusion_node --ros-args {files}'),
            Step('What a drive adds to it (vibration, temperature) no recording at rest shows: where NIS on the road '
                 'is far above 2, raise noise_density first.')]
