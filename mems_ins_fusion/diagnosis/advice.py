"""What is missing to know an effect better: the manoeuvre that shows most of it, by its Fisher information.

Manoeuvres are simulated on a level road, at the speed and with the receiver of the recording, and go through the filter
with the present parameters. Differences between runs with and without a small part of the effect give the information
of each, which adds to what is known (`fit.scores`). The part of a sigma that is no matter of samples (`Finding.least`)
stays. What a look has estimated without a filter, with the noise that its samples show, is predicted by the same
estimate (`offset.with_more`): parameters that make the IMU worse than it is would promise too little.
"""
from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..configuration.kinematics import fix_sigma
from ..configuration.mounting import estimate_mounting
from ..configuration.offset import with_more
from ..effects.registry import effect_called
from ..errors import InputError
from ..filter.runs.usable import usable_fixes
from ..recordings.motion import positions
from ..samples import Fixes, Recording
from ..simulation.drive import Drive, Path, follow
from ..simulation.manoeuvres import ASKED, asked
from ..simulation.simulation import GnssNoise, SensorErrors, simulate_recording
from .findings import Finding
from .fit import scores
from .problem import Problem
from .tracing import effect_unknowns
from .window import from_stamp

#: s of a simulated drive before a manoeuvre: the filter has to know its heading
BEFORE = 80.0
#: s from the begin of a manoeuvre, for all the same: some are shorter, and go straight on then
DURATION = 30.0
#: m/s: on a road in town, for a vehicle whose fixes show none
SPEED = 9.0
#: s over which the displacement of a vehicle shows its speed, and in sigmas of a fix, how long that is at least
SPAN, SHORTEST = 10.0, 10.0
#: Hz of the simulated IMU: twice what a diagnosis looks at
RATE = 25.0
#: a manoeuvre that leaves more of a sigma is not worth a sentence
WORTH = 0.8
#: effects that looks estimate (`configuration/offset.py`), both together
DIRECT = ('gnss_time_offset', 'gnss_lever_arm')
#: part of a variance that is a matter of more samples, at least
TINY = 1e-6
#: s between two fixes at least: what a diagnosis uses
FIX_INTERVAL = 1.0


@dataclass(frozen=True)
class Advice:
    """A manoeuvre (in words) and what it does to a parameter: its standard deviation now and behind it, in its unit."""

    manoeuvre: str
    parameter: str
    unit: str
    now: float
    then: float

    def text(self) -> str:
        unit = '' if self.unit == '-' else f' {self.unit}'
        return (f'{self.manoeuvre} would bring the sigma of {self.parameter} from {self.now:.2g} to '
                f'{self.then:.2g}{unit}')


def advised(finding: Finding, recording: Recording, values: dict) -> Advice | None:
    """The manoeuvre that makes the sigma of a parameter of `finding` smallest, as a part of what it is now; None where
    none is worth it.

    recording: what the receiver claims, how often it comes, and how fast the vehicle drives. values: checked parameters
    of the filter.
    """
    effect = effect_called(finding.name)
    known = {name: e for name, e in finding.parameters.items() if e.known and e.sigma > 0.0}
    tried = {name: e.value for name, e in finding.parameters.items() if name in effect.refined}
    unknowns = [u for u in effect_unknowns(effect, tried) if u.parameter in known]
    if not unknowns or any(u.variance for u in unknowns):  # a noise shows with time, whatever is driven
        return None
    sigma = np.array([known[u.parameter].sigma for u in unknowns])
    sigmas_behind = _by_look if finding.direct and finding.name in DIRECT else _by_filter
    best = None
    for name, then in sigmas_behind(finding, unknowns, sigma, recording, values):
        worst = int(np.argmin(then / sigma))
        if then[worst] < WORTH * sigma[worst] and (best is None or then[worst] / sigma[worst] < best.then / best.now):
            best = Advice(name, unknowns[worst].parameter, known[unknowns[worst].parameter].unit, float(sigma[worst]),
                          float(then[worst]))
    return best


def _by_filter(finding: Finding, unknowns: list, sigma: np.ndarray, recording: Recording, values: dict
               ) -> Iterator[tuple[str, np.ndarray]]:
    """Each of ASKED, and the sigmas behind it by the information that it adds in the filter."""
    least = np.array([finding.least.get(u.parameter, 0.0) for u in unknowns])
    own = np.maximum(sigma**2 - least**2, TINY * sigma**2)
    for name in ASKED:
        information = fisher_information(name, unknowns, recording, values)
        yield name, np.sqrt(np.diag(np.linalg.inv(np.diag(1.0 / own) + information)) + np.minimum(least, sigma)**2)


def _by_look(finding: Finding, unknowns: list, sigma: np.ndarray, recording: Recording, values: dict
             ) -> Iterator[tuple[str, np.ndarray]]:
    """Each of ASKED, and the sigmas behind it by the estimate that found it, with the noise that it has seen. As
    `_by_filter` where these samples do not show it any more."""
    part = from_stamp(recording, finding.since)
    mounting = estimate_mounting(part.imu, part.gnss)
    offset = mounting.offset if mounting is not None else None
    if offset is None or not offset.shown:
        yield from _by_filter(finding, unknowns, sigma, recording, values)
        return
    now = _of(unknowns, offset.lag_sigma, offset.arm_sigma)
    for name in ASKED:
        drive, begin = drive_with_manoeuvre(name, part)
        made = simulate_recording(drive, None, receiver(part, 0.0)).recording
        since = int(made.imu.stamp[0]) + round(begin * 1e9)
        yield name, sigma * _of(unknowns, *with_more(offset, made.imu, made.gnss, since)) / now


def _of(unknowns: list, lag_sigma: float, arm_sigma: np.ndarray) -> np.ndarray:
    """Of the sigmas of an estimate of both effects of DIRECT those of `unknowns`."""
    sigmas = dict(zip(('time_offset', *'xyz'), (lag_sigma, *arm_sigma)))
    return np.array([sigmas[unknown.parameter] for unknown in unknowns])


def fisher_information(name: str, unknowns: list, recording: Recording, values: dict) -> np.ndarray:
    """Fisher information (p, p) of `unknowns` in DURATION s from the begin of the manoeuvre `name`."""
    drive, before = drive_with_manoeuvre(name, recording)
    # with their noise: of perfect sensors, standing and driving straight on at one speed look the same
    sensors = SensorErrors.from_parameters(values, values['sensor_error_model'])
    simulated = simulate_recording(drive, sensors, receiver(recording),
                                   mounting_rpy=values['imu.mounting_rpy']).recording
    try:
        problem = Problem(simulated, values)
    except InputError:
        return np.zeros((len(unknowns),) * 2)
    begin = simulated.imu.stamp[0] + round(before * 1e9)
    mask = problem.mask & (problem.stamp > begin)
    _, found = scores(problem, unknowns, np.zeros(len(unknowns)))
    return found.information(mask)


def drive_with_manoeuvre(name: str, recording: Recording) -> tuple[Drive, float]:
    """A drive with the manoeuvre `name` and straight on until DURATION behind its begin, as fast as in `recording`, and
    the time of the begin, s."""
    segments, before = asked(name, driven_speed(recording.gnss), BEFORE, DURATION)
    return follow(Path(segments), before + DURATION + 5.0, RATE), before


def driven_speed(fixes: Fixes) -> float:
    """Speed, m/s, over the latest SPAN in which the vehicle drove and was not just stopping: by more than half of the
    usual (median) speed. SPEED where `fixes` show none."""
    fixes = usable_fixes(fixes)
    if len(fixes) < 2:
        return SPEED
    place, time = positions(fixes), (fixes.stamp - fixes.stamp[0]) * 1e-9
    first = np.searchsorted(time, time - SPAN)  # of the span that ends with each fix
    way, took = np.linalg.norm(place - place[first], axis=1), time - time[first]
    moved = (took >= 0.5 * SPAN) & (way > SHORTEST * fix_sigma(fixes, place))
    speed = way[moved] / took[moved]
    return float(speed[speed > 0.5 * np.median(speed)][-1]) if len(speed) else SPEED


def receiver(recording: Recording, shortest: float = FIX_INTERVAL) -> GnssNoise:
    """A receiver whose fixes are as sure and as frequent as those of `recording`, one each `shortest` s at most."""
    fixes = recording.gnss
    variance = np.median(0.5 * (fixes.covariance[:, 0, 0] + fixes.covariance[:, 1, 1])) if len(fixes) else 0.0
    interval = float(np.median(np.diff(fixes.stamp))) * 1e-9 if len(fixes) > 1 else FIX_INTERVAL
    return GnssNoise(float(np.sqrt(variance)) or 1.0, rate=1.0 / max(interval, shortest))
