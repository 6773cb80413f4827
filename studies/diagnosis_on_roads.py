"""Does the diagnosis help, and never harm, on drives whose simulator knows more than any filter?

    python studies/diagnosis_on_roads.py RESULTS.csv [--drives N] [--first I] [--processes 2] [--minutes M]

Each drive adds a line to RESULTS.csv; those that are there are not run again. Then the table of
docs/diagnosis_study.md is printed, of all that are there. --dry says what the drives are and runs none.

What a drive is follows from its number alone (`car`): a road with grade and bank, a body on springs, vibration, a
crooked mount, one of three grades of sensors, with their noise levels declared or not, RTK or 1.5 m; in every other one
the constraints of the default settings, else planar without; in a third outliers and a receiver that smooths; in a
fifth a mounting yaw with a time offset; else none, one or two effects of the library, of which nothing is declared.

Judged is a second drive of the same car that the diagnosis never sees, against the truth: the settings as given, what
the diagnosis made of them, and those of a filter that knows all (strapdown, every effect and noise level declared).
"""
from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mems_ins_fusion.diagnosis.diagnose import diagnose  # noqa: E402
from mems_ins_fusion.effects.registry import EFFECTS  # noqa: E402
from mems_ins_fusion.evaluation.comparison import aiding_of, samples_to_keep, truth_of  # noqa: E402
from mems_ins_fusion.evaluation.intervals import paired  # noqa: E402
from mems_ins_fusion.evaluation.metrics import position_errors  # noqa: E402
from mems_ins_fusion.evaluation.outages import outage_begins, run_outages  # noqa: E402
from mems_ins_fusion.filter.config import FilterConfig  # noqa: E402
from mems_ins_fusion.filter.runs.replay import run  # noqa: E402
from mems_ins_fusion.parameters import table  # noqa: E402
from mems_ins_fusion.samples import Recording  # noqa: E402
from mems_ins_fusion.simulation.drive import stream  # noqa: E402
from mems_ins_fusion.simulation.scene import REALISTIC, SIDESLIP  # noqa: E402
from mems_ins_fusion.simulation.simulation import (  # noqa: E402
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_recording,
)

FIRST_SEED, SECOND_DRIVE = 30_000, 500_000
DURATION = 900.0  # s
DURATIONS, SPACING = (10.0, 30.0, 60.0), 20.0
STARTED = 60.0  # s, after which every filter runs
#: the mounting of all drives is off by up to this, rad; that of the pairs on top
CROOKED = math.radians(1.0)
#: an effect that is not declared makes the errors larger by this factor, or it makes no difference
MATTERS = 1.15
CERTAIN, CLOSE = 0.01, 1.10

#: noise levels by grade of the sensors; the first are the defaults
GRADES = {
    'consumer': {},
    'automotive': REALISTIC.imu,
    'tactical': {'gyroscope.noise_density': [2e-5], 'gyroscope.gauss_markov.sigma': [1e-5],
                 'gyroscope.initial_sigma': [1e-4], 'accelerometer.noise_density': [5e-4],
                 'accelerometer.gauss_markov.sigma': [3e-3], 'accelerometer.initial_sigma': [0.01]}}
TRUTH = {'reference_lever_arm': [0.0, 0.0, 0.0]}  # is of the IMU
PLANAR = {'mechanization': 'planar', 'vehicle.zero_velocity': False, 'vehicle.non_holonomic': False}
#: effects that show only with the constraints, and those that the two kinds of filter are not asked for
ONLY_CONSTRAINED = ('mounting_rotation', 'sideslip', 'rear_axle')
NOT_ASKED = ('tilt',)  # it is in every drive
#: settings without which the filter itself estimates an effect
GIVEN = {'speed_scale': {'speed_topic': '/wheel/speed', 'speed.scale_sigma': 0.0},
         'rear_axle': {'vehicle.rear_axle': [-x for x in REALISTIC.axle_to_imu],
                       'vehicle.rear_axle_sigma': 0.0}}
#: between which sizes are drawn, of either sign, where one to three times the usual is not what is meant
SIZES = {'gnss_time_offset': {'time_offset': (0.1, 0.6)},
         'gnss_coloured_noise': {'sigma': (1.0, 3.0), 'tau': (20.0, 90.0)},
         'gnss_lag': {'tau': (0.4, 1.2)}, 'gnss_latency': {'step': (0.2, 0.5), 'at': (0.3, 0.7)},
         'gnss_outliers': {'share': (0.01, 0.05), 'sigma': (20.0, 40.0)},
         'gyroscope_warm_up': {'z': (2e-3, 6e-3), 'tau': (60.0, 400.0)}, 'mounting_rotation': {'yaw': (0.05, 0.14)},
         'imu_repeats': {'share': (0.1, 0.4)}, 'imu_jitter': {'sigma': (3e-3, 8e-3)}}
UNSIGNED = ('sigma', 'tau', 'share', 'at')


@dataclass(frozen=True)
class Car:
    """One case. true: what nobody declared and the diagnosis is asked for, effect -> parameters. there: what else is
    undeclared and no false finding, the same way. given: the settings as declared."""

    number: int
    kind: str
    grade: str
    characterized: bool
    receiver: GnssNoise
    true: dict[str, dict[str, float]]
    there: dict[str, dict[str, float]]
    given: dict

    @property
    def seed(self) -> int:
        return FIRST_SEED + self.number

    @property
    def constrained(self) -> bool:
        return self.given['mechanization'] == 'strapdown'

    def declaring(self, names: Sequence[str], recording: Recording) -> dict:
        """Settings of a filter that knows road, receiver and sensors, and of the effects those of `names`.

        recording: what is seen in the data is seen there.
        """
        # who knows the noise does not take vibration for it, which swings about its mean
        known = {'imu.adapt_noise': False} | {name: self.given[name] for name in (
            'vehicle.non_holonomic', 'vehicle.zero_velocity', 'speed_topic', 'speed.scale_sigma',
            'vehicle.rear_axle_sigma')}
        axle = GIVEN['rear_axle']['vehicle.rear_axle']
        values = table.check({**GRADES[self.grade], **known, 'vehicle.rear_axle': axle, **TRUTH})
        body = {'sideslip': {'angle_per_acceleration': SIDESLIP}}
        for name, theta in [*body.items(), *self.there.items(), *((name, self.true[name]) for name in names)]:
            values = EFFECTS[name].adjusted(values, EFFECTS[name].as_traced(EFFECTS[name].complete(theta)))
            seen = EFFECTS[name].seen(values, recording)
            values = {**values, **(seen.helps if seen else {})}
        lag = values['gnss.lag_per_acceleration'] + smoothing_lag(self.receiver)
        return {**values, 'gnss.lag_per_acceleration': lag}

    def truth(self) -> dict[str, float]:
        """Values of the parameters of the true effects, effect.parameter, with what else acts alike."""
        found = {f'{name}.{parameter}': value for name, theta in self.true.items()
                 for parameter, value in EFFECTS[name].as_traced(EFFECTS[name].complete(theta)).items()}
        if 'gnss_lag' in self.true:
            found.setdefault('gnss_time_offset.time_offset', 0.0)
        late = found.pop('gnss_lag.delay', 0.0) - self.true.get('imu_jitter', {}).get('sigma', 0.0)
        alike = {'sideslip.angle_per_acceleration': SIDESLIP, 'gnss_lag.lag': smoothing_lag(self.receiver),
                 'gnss_time_offset.time_offset': late}
        return {name: value + alike.get(name, 0.0) for name, value in found.items()}

    def drive(self, second: bool = False) -> Recording:
        """The drive that is diagnosed, or the second one of the same car; with the truth."""
        seed = self.seed + SECOND_DRIVE * second
        scene = replace(REALISTIC, mounting_error=0.0)
        drive = scene.drive(DURATION, seed)
        distortions = scene.distortions(seed)
        both = [*self.there.items(), *self.true.items()]
        aiding = SimulatedAiding(speed_rate=10.0, speed_scale=0.0) if self.given['speed_topic'] else None
        sensors = SensorErrors.from_parameters(table.check(GRADES[self.grade]), 'gauss_markov')
        return simulate_recording(drive, sensors, self.receiver, [(EFFECTS[name], theta) for name, theta in both],
                                  seed=seed, name=f'drive {self.number}', vibration=distortions['vibration'],
                                  aiding=aiding).recording


def smoothing_lag(receiver: GnssNoise) -> float:
    """By how much the receiver's tracking filter stays behind for each m/s^2, s^2: (1 - g) / h of its gains."""
    if not receiver.smoothing:
        return 0.0
    theta = math.exp(-1 / (receiver.rate * receiver.smoothing))
    return (theta / (1 - theta) / receiver.rate) ** 2


def car(number: int) -> Car:
    """The case of this number."""
    rng = stream(FIRST_SEED + number, 'roads')
    constrained, spoiled = number % 2 == 0, number % 3 == 0
    mount = dict(zip(('roll', 'pitch', 'yaw'), rng.uniform(-CROOKED, CROOKED, 3).tolist()))
    smoothing, share = rng.uniform(0.8, 1.5), rng.uniform(0.01, 0.04)
    if number % 5 == 0:
        kind = 'mounting and offset'
        turn, late = math.radians(rng.uniform(3.0, 8.0)), rng.uniform(0.2, 0.8)
        true = {'gnss_time_offset': {'time_offset': float(rng.choice([-1, 1]) * late)},
                'mounting_rotation': {'yaw': float(rng.choice([-1, 1]) * turn)}}
    else:
        count = int(rng.choice([0, 1, 2], p=[0.15, 0.5, 0.35]))
        asked = [name for name in EFFECTS if name not in NOT_ASKED and (constrained or name not in ONLY_CONSTRAINED)]
        true = {str(name): sizes(str(name), rng) for name in rng.choice(asked, count, replace=False)}
        kind = ('nothing', 'one effect', 'two effects')[count]
    there = {'mounting_rotation': mount}
    if 'mounting_rotation' in true:  # the crooked mount is part of it
        true['mounting_rotation'] = {'roll': mount['roll'], 'pitch': mount['pitch'],
                                     'yaw': true['mounting_rotation']['yaw'] + mount['yaw']}
    if not constrained and 'mounting_rotation' in true:  # nothing shows it
        there['mounting_rotation'] = true.pop('mounting_rotation')
    there = {name: theta for name, theta in there.items() if name not in true}
    rtk = (number // 2) % 2 == 1 and not spoiled and 'gnss_lag' not in true  # one that smooths would be metres off
    receiver = GnssNoise(0.02 if rtk else 1.5, smoothing=smoothing if spoiled else 0.0,
                         outliers=share if spoiled else 0.0)
    grade, characterized = list(GRADES)[(number // 4) % 3], number // 12 % 2 == 1
    given = {**(GRADES[grade] if characterized else {}), **({} if constrained else PLANAR), **TRUTH}
    for name in true:
        given |= GIVEN.get(name, {})
    return Car(number, kind, grade, characterized, receiver, true, there, table.check(given))


def sizes(name: str, rng) -> dict[str, float]:
    """Random sizes of an effect's parameters."""
    ranges = SIZES.get(name) or {p.name: (p.prior_scale, 3 * p.prior_scale) for p in EFFECTS[name].parameters}
    return {parameter: float(rng.uniform(*between) * (1 if parameter in UNSIGNED else rng.choice([-1, 1])))
            for parameter, between in ranges.items()}


@dataclass(frozen=True)
class Answer:
    """What the diagnosis said. added: groups of names, the first found first. parameters: effect.parameter -> value and
    sigma. corrected: the settings it recommends."""

    added: list[list[str]]
    parameters: dict[str, tuple[float, float]]
    corrected: dict
    unexplained: bool


def asked(recording: Recording, given: dict) -> Answer:
    """The diagnosis of a drive, which has no reference: the only place that knows what `diagnose` returns."""
    result = diagnose(replace(recording, reference=None), given, durations=DURATIONS)
    added = [f for f in result.findings if f.added]
    parameters = {f'{f.name}.{name}': (e.value, e.sigma) for f in added for name, e in f.parameters.items() if e.known}
    return Answer([list(f.group) for f in added], parameters, result.corrected, bool(result.unexplained))


@dataclass(frozen=True)
class Errors:
    """Of one filter on one drive: RMS with all fixes, and by duration of the outages the largest errors (o,), their
    begins and whether the 95 % ellipse held the error at the end."""

    rms: float
    begin: list[np.ndarray]
    largest: list[np.ndarray]
    within: list[np.ndarray]


def errors(values: dict, recording: Recording) -> Errors:
    config, truth = FilterConfig.from_parameters(values), truth_of(recording, values)
    imu, fixes, keep = recording.imu, recording.gnss, samples_to_keep(recording.imu, truth.reference.stamp)
    result = run(config, imu, fixes, aiding_of(recording), keep=keep)
    begins = outage_begins(int(fixes.stamp[0] + STARTED * 1e9), fixes, 0.0, SPACING, DURATIONS[0])
    found = run_outages(config, imu, fixes, truth, DURATIONS, begins, aiding_of(recording), keep)
    all_fixes = position_errors(result, truth, np.zeros(len(truth), dtype=bool)).horizontal
    return Errors(float(np.sqrt(np.mean(all_fixes**2))), [o.begin for o in found], [o.max_error for o in found],
                  [o.within for o in found])


def ratios(one: Errors, other: Errors) -> list[float]:
    """Errors of one filter over another's: RMS with all fixes, mean largest error for each duration."""
    return [one.rms / other.rms, *(float(a.mean() / b.mean()) for a, b in zip(one.largest, other.largest))]


def certainly_larger(after: Errors, before: Errors) -> bool:
    """Whether the errors of the outages of some duration have grown, and not by chance."""
    for begin, new, old_begin, old in zip(after.begin, after.largest, before.begin, before.largest):
        _, a, b = np.intersect1d(begin, old_begin, return_indices=True)
        difference = paired(new[a], old[b])
        if difference is not None and difference.mean > 0 and difference.p < CERTAIN:
            return True
    return False


COLUMNS = ('number', 'kind', 'constrained', 'grade', 'characterized', 'sigma', 'smoothing', 'outliers', 'true',
           'matters', 'found', 'deviations', 'unexplained', 'before', 'after', 'knowing', 'harm', 'within_before',
           'within_after', 'within_knowing', 'seconds', 'failure')


def judged(number: int) -> dict:
    """The line of one drive."""
    case = car(number)
    row = dict.fromkeys(COLUMNS, '') | {
        'number': number, 'kind': case.kind, 'constrained': case.constrained, 'grade': case.grade,
        'characterized': case.characterized, 'sigma': case.receiver.sigma, 'smoothing': case.receiver.smoothing,
        'outliers': case.receiver.outliers, 'true': case.true}
    first, second = case.drive(), case.drive(second=True)
    began = time.perf_counter()
    try:
        answer = asked(first, case.given)
    except Exception as error:  # whatever it is, the study goes on and counts it
        return row | {'failure': f'{type(error).__name__}: {error}'}
    row['seconds'] = time.perf_counter() - began
    before, after = errors(case.given, second), errors(answer.corrected, second)
    knowing = errors(case.declaring(list(case.true), second), second)
    if not all(np.isfinite(measured(e)).all() for e in (before, after, knowing)):
        return row | {'failure': 'a filter does not run through the second drive'}
    matters = [name for name in case.true if max(ratios(errors(case.declaring(
        [other for other in case.true if other != name], second), second), knowing)) > MATTERS]
    return row | {
        'matters': matters, 'found': answer.added, 'deviations': deviations(case, answer),
        'unexplained': answer.unexplained, 'before': measured(before), 'after': measured(after),
        'knowing': measured(knowing), 'harm': certainly_larger(after, before),
        **{f'within_{what}': [float(w.mean()) for w in e.within]
           for what, e in (('before', before), ('after', after), ('knowing', knowing))}}


def measured(e: Errors) -> list[float]:
    return [e.rms, *(float(largest.mean()) for largest in e.largest)]


def deviations(case: Car, answer: Answer) -> dict[str, float]:
    """Estimates less the truth, in sigmas, of the parameters of the true effects."""
    return {name: (answer.parameters[name][0] - value) / answer.parameters[name][1]
            for name, value in case.truth().items() if name in answer.parameters}


# the table

#: effects that are found under another name, too: the delay of a low pass is a time offset
ALSO = {'gnss_lag': {'gnss_time_offset'}, 'gnss_latency': {'gnss_time_offset'}, 'imu_jitter': {'gnss_time_offset'}}
#: and those that are no false finding where the other is there, as theory says that they look alike
KIN = {'gnss_lever_arm': {'accelerometer_lever_arm'}, 'accelerometer_lever_arm': {'gnss_lever_arm'},
       'rear_axle': {'sideslip'}, 'tilt': {'accelerometer_scale'}, 'gnss_latency': {'gnss_coloured_noise'}}


def called(names) -> set[str]:
    """What these effects may be called."""
    return set(names).union(*(ALSO.get(name, set()) for name in names))


def really(row: dict) -> set[str]:
    """Names that are no false finding in this drive."""
    there = {*row['true'], 'tilt', 'sideslip', 'mounting_rotation'}
    if row['outliers']:
        there |= {'gnss_outliers', 'gnss_lag', 'gnss_coloured_noise'}
    return called(there).union(*(KIN.get(name, set()) for name in there))


def right_first(row: dict) -> bool:
    """Whether the first group added, but for those of what is in every drive, has a true effect in it."""
    for group in row['found']:
        if set(group) & called(row['matters']):
            return True
        if not set(group) & (really(row) - set(row['true'])):
            return False
    return False


def all_found(row: dict) -> bool:
    return all(any(set(group) & called([name]) for group in row['found']) for name in row['matters'])


def report(rows: Sequence[dict]) -> str:
    """The table, as Markdown."""
    done = [row for row in rows if not row['failure']]
    lines = ['| | ' + ' | '.join(['all', *KINDS]) + ' | target |', '|---' * (len(KINDS) + 3) + '|']
    for what, share, target in SCORES:
        cells = [share([row for row in done if select(row)]) for select in (lambda row: True, *KINDS.values())]
        lines.append(f'| {what} | ' + ' | '.join(cells) + f' | {target} |')
    failed = [f"drive {row['number']}: {row['failure']}" for row in rows if row['failure']]
    return '\n'.join([*lines, '', f'{len(rows)} drives, {len(failed)} failed.', *failed])


KINDS = {'constraints': lambda row: row['constrained'], 'planar': lambda row: not row['constrained'],
         'outliers, smoothing': lambda row: row['outliers'] > 0,
         'mounting and offset': lambda row: row['kind'] == 'mounting and offset',
         'nothing': lambda row: row['kind'] == 'nothing'}


def _share(of, where=lambda row: True):
    """Of the rows `where`, those `of`: 'k of n (share)'."""
    def count(rows):
        n = [of(row) for row in rows if where(row)]
        return f'{sum(n)} of {len(n)} ({100 * np.mean(n):.0f} %)' if n else '-'
    return count


def _within_two_sigma(rows):
    inside = [abs(d) < 2 for row in rows for d in row['deviations'].values()]
    return f'{sum(inside)} of {len(inside)} ({100 * np.mean(inside):.0f} %)' if inside else '-'


def _means(column):
    """Means over the drives, for the three durations."""
    def mean(rows):
        return ', '.join(f'{100 * m:.0f}' for m in np.mean([row[column] for row in rows], axis=0)) if rows else '-'
    return mean


def _medians(column, other):
    def median(rows):
        found = [np.divide(row[column], row[other]) for row in rows]
        return ', '.join(f'{m:.2f}' for m in np.median(found, axis=0)) if found else '-'
    return median


def _near_knowing(row) -> bool:
    return max(np.divide(row['after'], row['knowing'])) <= CLOSE


SCORES = (
    ('right first, or its group', _share(right_first, lambda row: row['matters']), '95 %'),
    ('all true effects found, or their groups', _share(all_found, lambda row: row['matters']), ''),
    ('a false finding', _share(lambda row: any(not set(group) & really(row) for group in row['found'])), '3 %'),
    ('harm: larger errors in outages, for certain', _share(lambda row: row['harm']), '0'),
    ('values within 2 sigma', _within_two_sigma, '90 %'),
    ('errors within 10 % of the knowing filter', _share(_near_knowing), '90 %'),
    ('error after / before (fixes; 10, 30, 60 s), median', _medians('after', 'before'), '< 1'),
    ('error after / knowing, median', _medians('after', 'knowing'), ''),
    ('error before / knowing, median', _medians('before', 'knowing'), ''),
    ('95 % ellipse holds, %, before (10, 30, 60 s)', _means('within_before'), ''),
    ('after', _means('within_after'), '90'),
    ('knowing', _means('within_knowing'), ''),
    ('something left unexplained', _share(lambda row: row['unexplained']), ''),
    ('seconds', lambda rows: f"{np.median([row['seconds'] for row in rows]):.0f}" if rows else '-', '60'))


def read(path: Path) -> list[dict]:
    """The lines that are there, by number."""
    if not path.exists():
        return []
    with path.open(newline='') as file:
        rows = [{name: _parsed(text) for name, text in row.items()} for row in csv.DictReader(file)]
    return sorted(rows, key=lambda row: row['number'])


def _parsed(text: str):
    try:
        return json.loads(text)
    except ValueError:
        return text


def append(path: Path, row: dict) -> None:
    """One line more."""
    new = not path.exists()
    with path.open('a', newline='') as file:
        writer = csv.DictWriter(file, COLUMNS)
        if new:
            writer.writeheader()
        writer.writerow({name: value if isinstance(value, str) else json.dumps(_rounded(value))
                         for name, value in row.items()})


def _rounded(tree):
    if isinstance(tree, dict):
        return {key: _rounded(value) for key, value in tree.items()}
    if isinstance(tree, (list, tuple)):
        return [_rounded(value) for value in tree]
    return float(f'{tree:.4g}') if isinstance(tree, float) else bool(tree) if isinstance(tree, np.bool_) else tree


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('results', type=Path, help='csv with a line for each drive')
    parser.add_argument('--drives', type=int, default=0, help='how many, from --first on (default: only the table)')
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--processes', type=int, default=1)
    parser.add_argument('--minutes', type=float, default=math.inf, help='begin no drive later than this')
    parser.add_argument('--dry', action='store_true', help='only say what the drives are')
    options = parser.parse_args(arguments)
    numbers = range(options.first, options.first + options.drives)
    if options.dry:
        for case in map(car, numbers):
            print(case.number, case.kind, 'constrained' if case.constrained else 'planar', case.grade,
                  'characterized' if case.characterized else 'defaults', f'{case.receiver.sigma:g} m',
                  'outliers, smoothing' if case.receiver.outliers else '', json.dumps(_rounded(case.true)))
        return 0
    there = {row['number'] for row in read(options.results)}
    began = time.monotonic()
    with ProcessPoolExecutor(options.processes) as pool:
        waiting = iter([number for number in numbers if number not in there])
        running = {pool.submit(judged, number) for _, number in zip(range(options.processes), waiting)}
        while running:
            ready = next(as_completed(running))
            running.remove(ready)
            append(options.results, row := ready.result())
            print(f"{row['number']} {row['kind']} {_rounded(row['true'])}: {row['failure'] or row['found']} "
                  f"before {_rounded(row['before'])} after {_rounded(row['after'])} knowing {_rounded(row['knowing'])} "
                  f"{'HARM ' if row['harm'] else ''}{row['seconds'] or 0:.0f} s", file=sys.stderr, flush=True)
            if time.monotonic() - began < 60 * options.minutes:
                running |= {pool.submit(judged, number) for _, number in zip(range(1), waiting)}
    print(report(read(options.results)))
    return 0


if __name__ == '__main__':
    sys.exit(main())
