"""How good the filter is for a car: simulated realistic drives and measured ones, settings as users have them.

    python studies/vehicle.py [--seeds 3] [--minutes 20] [--data ../shared/data] [--settings ...] [--fixes ...]
                              [--set NAME=VALUE ...] [--only simulated|measured] [--processes 2] [--output FILE.md]

Each drive goes through the filter with fixes once a second and default noise parameters, and without fixes for 10, 30
and 60 s every 100 s (30 s in the measured drives, which are short). The table says, for each kind of fixes and each
setting over all simulated drives, and for each measured drive: RMSE with all fixes and how often the 95 % ellipse held
the truth; then for each duration the error at the end of the outage and the largest in it (median / 95 %), and how
often the ellipse at the end held the truth.

The simulated drives know more than the filter: `mems_ins_fusion/simulation/scene.py`, REALISTIC. Of the measured ones
the mounting is given to the nearest right angle, nothing else.
"""
from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from mems_ins_fusion.evaluation.comparison import compare
from mems_ins_fusion.evaluation.metrics import NEES_95
from mems_ins_fusion.parameters import table as parameters
from mems_ins_fusion.recordings.errors import RecordingWarning
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

DURATIONS = (10.0, 30.0, 60.0)
_AIDING = ('speed', 'velocity', 'heading')
_ALONE = {'vehicle.zero_velocity': False, 'vehicle.non_holonomic': False}
#: the defaults: named, so that they stay when those change
_CAR = {'mechanization': 'strapdown', 'vehicle.zero_velocity': True, 'vehicle.non_holonomic': True}

#: what is asked of the filter, by name; a topic of _AIDING says that these samples are used
SETTINGS = {
    'planar': {'mechanization': 'planar', **_ALONE},
    'strapdown': {'mechanization': 'strapdown', **_ALONE},
    'car': _CAR,
    'car + speed': {**_CAR, 'speed_topic': '/wheel/speed'},
    'car + velocity': {**_CAR, 'velocity_topic': '/gps/velocity'},
    'car + heading': {**_CAR, 'heading_topic': '/gps/heading'},
}
DEFAULT_SETTINGS = ('planar', 'strapdown', 'car', 'car + speed')

#: receivers of the simulated drives
FIXES = {
    '1.5 m': GnssNoise(1.5),
    'RTK': GnssNoise(0.02),
    'city': GnssNoise(1.5, coloured_sigma=2.0, coloured_tau=30.0, outliers=0.03, dropouts=20.0),
    'smoothing': GnssNoise(2.5, smoothing=0.8, coloured_sigma=1.0, coloured_tau=60.0),
}
DEFAULT_FIXES = ('1.5 m', 'RTK')


@dataclass(frozen=True)
class Measured:
    """A recording of the data's README. path: within its folder. values: parameters, with the mounting."""

    path: str
    gnss_topic: str
    values: dict
    reference_topic: str | None = None


MEASURED = {
    'longmont_rtk_drive': Measured('bag', '/gps/fix', {'imu.mounting_rpy': [0.0, 0.0, np.pi]}),
    'karlsruhe_hills': Measured('bag', '/gps/fix', {}, '/reference/fix'),
    'kingston_span': Measured('bag', '/gps/fix', {'imu.mounting_rpy': [0.0, 0.0, -np.pi / 2]}, '/reference/fix'),
    'incheon_square_ros2': Measured('bag', '/fix', {'imu.mounting_rpy': [np.pi, 0.0, 0.0]}),
    'incheon_park_ros2': Measured('bag_0.db3', '/fix', {}),
}


@dataclass(frozen=True)
class Judged:
    """What one drive showed in one setting. error, inside (m,): m with fixes, and whether the ellipse held it.
    end, largest, within: by duration, (o,) of each outage. seconds: of the filter. problem: why there is nothing."""

    error: np.ndarray
    inside: np.ndarray
    end: dict
    largest: dict
    within: dict
    seconds: float = 0.0
    problem: str = ''


def simulated(seed: int, minutes: float, fixes: GnssNoise, drive=None) -> Recording:
    """A realistic drive, with all further sensors and the truth at 10 Hz. drive: made before, by `drive_of`."""
    simulation = simulate_recording(drive or drive_of(seed, minutes), sensors(), fixes, seed=seed,
                                    name=f'simulated {seed}', **REALISTIC.distortions(seed))
    recording = simulation.recording
    return replace(recording, reference=recording.reference.select(slice(None, None, 10)))


def drive_of(seed: int, minutes: float):
    return REALISTIC.drive(60.0 * minutes, seed)


def sensors() -> SensorErrors:
    return SensorErrors.from_parameters(parameters.check(REALISTIC.imu), 'gauss_markov')


def measured(name: str, data: Path) -> Recording:
    """One of MEASURED."""
    given = MEASURED[name]
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RecordingWarning)
        return read_recording(data / name / given.path, '/imu/data', given.gnss_topic, given.reference_topic)


def judge(recording: Recording, values: dict) -> Judged:
    """The errors of `recording` with parameters `values`; only those further sensors are used whose topic is set."""
    values = parameters.check({'models': ['gauss_markov'], 'update_intervals': [1.0], 'outage_spacing': 100.0,
                               'outage_durations': list(DURATIONS), **values})
    unused = {name: None for name in _AIDING if not values[f'{name}_topic']}
    try:
        comparison = compare(replace(recording, **unused), values)
    except ValueError as error:
        empty = {duration: np.empty(0) for duration in DURATIONS}
        return Judged(np.empty(0), np.empty(0), empty, empty, empty, problem=str(error))
    run = comparison.runs[0]
    found = {o.outages.duration: o.outages for o in comparison.outages}
    return Judged(run.errors.horizontal, run.errors.nees < NEES_95,
                  {d: np.array([e.horizontal[-1] for e in o.errors]) for d, o in found.items()},
                  {d: o.max_error for d, o in found.items()}, {d: o.within for d, o in found.items()},
                  run.run.filter_seconds)


def pooled(results: list[Judged]) -> Judged:
    """Several drives as one."""
    def joined(name):
        return {d: np.concatenate([getattr(r, name)[d] for r in results]) for d in DURATIONS}

    return Judged(np.concatenate([r.error for r in results]), np.concatenate([r.inside for r in results]),
                  joined('end'), joined('largest'), joined('within'), sum(r.seconds for r in results),
                  '; '.join(dict.fromkeys(r.problem for r in results if r.problem)))


def of_seed(seed: int, minutes: float, fixes, settings, given: dict) -> list[tuple[tuple[str, str], Judged]]:
    """((fixes, setting), result) of one simulated drive."""
    drive, found = drive_of(seed, minutes), []
    for name in fixes:
        recording = simulated(seed, minutes, FIXES[name], drive)
        found += [((name, setting), judge(recording, {**SETTINGS[setting], **given})) for setting in settings]
    return found


def of_measured(name: str, data: Path, settings, given: dict) -> list[tuple[tuple[str, str], Judged]]:
    """((fixes, setting), result) of one measured drive: fixes as they are, and with noise where they are RTK."""
    recording, found = measured(name, data), []
    sigma = float(np.sqrt(np.median(recording.gnss.covariance[:, 0, 0])))
    for fixes, noise in (('as recorded', 0.0), ('with 1.5 m noise', 1.5)):
        if noise == 0.0 or sigma < 0.3:
            for setting in settings:
                if not any(f'{kind}_topic' in SETTINGS[setting] for kind in _AIDING):
                    values = {**MEASURED[name].values, **SETTINGS[setting], 'fix_noise': noise,
                              'outage_spacing': 30.0, **given}
                    found.append(((fixes, setting), judge(recording, values)))
    return found


def row(first: str, fixes: str, setting: str, result: Judged) -> str:
    """A line of the table."""
    if not len(result.error):
        return f'| {first} | {fixes} | {setting} | {result.problem} |' + ' |' * (1 + 4 * len(DURATIONS))
    cells = [_number(np.sqrt(np.mean(result.error**2)), 3), _percent(result.inside)]
    for duration in DURATIONS:
        cells += [str(len(result.end[duration])), *(_median_and_95(values[duration]) for values in (
            result.end, result.largest)), _percent(result.within[duration])]
    return f'| {first} | {fixes} | {setting} | {" | ".join(cells)} |'


def header() -> str:
    names = ['drives', 'fixes', 'setting', 'RMSE, m', 'in 95 %']
    for duration in DURATIONS:
        names += [f'{duration:g} s', 'end, m', 'largest, m', 'in 95 %']
    return f'| {" | ".join(names)} |\n|{"---|" * len(names)}'


def _median_and_95(values) -> str:
    return ' / '.join(_number(np.percentile(values, q), 2) for q in (50, 95)) if len(values) else '-'


def _number(value, digits) -> str:
    return f'{float(f"{value:.{digits}g}"):g}'


def _percent(inside) -> str:
    return f'{100 * np.mean(inside):.0f} %' if len(inside) else '-'


def study(seeds, minutes: float, data: Path | None, fixes=DEFAULT_FIXES, settings=DEFAULT_SETTINGS,
          given: dict | None = None, processes: int = 2, progress=lambda text: None) -> Iterator[str]:
    """The lines of the table. seeds: of simulated drives of `minutes`. data: folder of the measured ones, or None.

    given: parameters laid over every setting.
    """
    yield header()
    with ProcessPoolExecutor(processes) as pool:
        drives = [pool.submit(of_seed, seed, minutes, fixes, settings, given or {}) for seed in seeds]
        recorded = {name: pool.submit(of_measured, name, data, settings, given or {}) for name in MEASURED
                    if data is not None and (data / name).exists()}
        results: dict = {}
        for seed, drive in zip(seeds, drives):
            for key, result in drive.result():
                results.setdefault(key, []).append(result)
            progress(f'simulated {seed}')
        title = f'{len(drives)} simulated, {minutes:g} min each'
        for (name, setting), found in results.items():
            yield row(title, name, setting, pooled(found))
        for name, drive in recorded.items():
            for key, result in drive.result():
                yield row(name, *key, result)
            progress(name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add('--seeds', type=int, default=3, help='number of simulated drives')
    add('--first-seed', type=int, default=1000)
    add('--minutes', type=float, default=20.0)
    add('--data', type=Path, default=Path('../shared/data'))
    add('--settings', nargs='+', choices=SETTINGS, default=DEFAULT_SETTINGS)
    add('--fixes', nargs='+', choices=FIXES, default=DEFAULT_FIXES)
    add('--set', nargs='+', default=[], metavar='NAME=VALUE', help='parameters laid over every setting')
    add('--only', choices=('simulated', 'measured'))
    add('--processes', type=int, default=2)
    add('--output', type=Path)
    options = parser.parse_args()
    given = {name: yaml.safe_load(value) for name, _, value in (text.partition('=') for text in options.set)}
    began, lines = time.monotonic(), []
    seeds = range(options.first_seed, options.first_seed + (0 if options.only == 'measured' else options.seeds))
    data = None if options.only == 'simulated' else options.data

    def progress(text):
        print(f'{time.monotonic() - began:6.0f} s  {text}', file=sys.stderr, flush=True)

    for line in study(seeds, options.minutes, data, options.fixes, options.settings, given, options.processes,
                      progress):
        lines.append(line)
        print(line, flush=True)
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
