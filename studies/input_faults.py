"""What faults of the further inputs cost: each input missing, late, wrong, doubled and dead, with fixes and without.

    python studies/input_faults.py [--seeds 6] [--rate 1] [--only TEXT,TEXT] [--set NAME=VALUE ...] [--output FILE.md]
    python studies/input_faults.py --imus ...

The drives of faults.py with one input more: speed, velocity, odometry, heading, pressure, magnetometer or a second
receiver 1.6 m behind the first. The fault lasts for a minute from 200 s on. Each row twice: with fixes all the time,
and without any in the second half of that minute. *without it*: the same filter that does not have the input while
the fault lasts. The other columns are those of faults.py.

With --imus the faults are those of two IMUs of one grade, each with its own errors, vibration and mounting: of the
first one and of the second one. *without it*: the same fault, with the first IMU alone; *without fault*: the first one
alone. A line behind the table has the largest errors without fixes, with either IMU alone all the time, with both, and
with either alone from the fault on.

missing: nothing comes. late: stamps of half a second later. doubled: each message twice. dead: it stays at the value it
has as the fault begins. wrong: WRONG below.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import yaml
from faults import BEGIN, METRE, MINUTES, Fault, judged, outcome, row
from vehicle import drive_of, sensors

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.filter.measurements.registry import aiding
from mems_ins_fusion.filter.runs.imus import as_one
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import ImuSamples, Recording
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import Aiding, GnssNoise, simulate_recording

DURATION = 60.0
WITHOUT_FIXES = 30.0, 60.0  # s of the fault
REAR = {'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': '/rear', 'rear.lever_arm': [-1.6, 0.0, 0.0]}
#: parameters of each input
INPUTS = {**{name: {f'{name}_topic': f'/{name}'} for name in ('speed', 'velocity', 'twist', 'heading', 'pressure',
                                                                   'magnetometer')},
          'rear': REAR}
#: in words, and what it does to samples
WRONG: dict[str, tuple[str, Callable]] = {
    'speed': ('in km/h', lambda s: replace(s, speed=3.6 * s.speed)),
    'velocity': ('north and east exchanged', lambda s: replace(s, velocity=s.velocity[:, [1, 0, 2]])),
    'twist': ('in km/h, turns the other way', lambda s: replace(s, twist=s.twist * [3.6, 3.6, -1.0])),
    'heading': ('90 deg off', lambda s: replace(s, yaw=s.yaw + 0.5 * np.pi)),
    'pressure': ('5 hPa off', lambda s: replace(s, pressure=s.pressure + 500.0)),
    'magnetometer': ('beside a magnet of 30 uT', lambda s: replace(s, field=s.field + [3e-5, 3e-5, 0.0])),
    'rear': ('30 m off', lambda s: replace(s, latitude=s.latitude + 30.0 * METRE)),
}
#: which arrays of its samples an input measures
_VALUES = {'rear': ('latitude', 'longitude', 'height'), 'heading': ('yaw',),
           'magnetometer': ('field',)}


@cache
def clean(seed: int, rate: float) -> Recording:
    """A realistic drive with all inputs."""
    aided = Aiding(speed_rate=10.0, velocity_rate=rate, twist_rate=20.0, heading_rate=5.0, pressure_rate=10.0,
                   magnetometer_rate=20.0, fix_rate=rate, fix_sigma=1.5)
    named = [one for one in aiding(table.check(REAR)) if not one.is_plain]
    recording = simulate_recording(drive_of(seed, MINUTES), sensors(), GnssNoise(1.5, rate=rate), seed=seed,
                                   **{**REALISTIC.distortions(seed), 'aiding': aided, 'named': named}).recording
    return replace(recording, reference=recording.reference.select(slice(None, None, 10)))


def _dead(name, samples, inside):
    first, found = np.flatnonzero(inside)[0], {}
    for part in _VALUES.get(name, (name,)):
        values = getattr(samples, part).copy()
        values[inside] = values[first]
        found[part] = values
    return replace(samples, **found)


def _partly(samples, changed, inside):
    """`changed` inside, `samples` elsewhere."""
    values = {name: np.where(inside.reshape(-1, *[1] * (np.ndim(part) - 1)), getattr(changed, name), part)
              for name, part in vars(samples).items() if part is not None}
    return replace(samples, **values)


def _late(samples, inside):
    by = np.where(inside, 500_000_000, 0)
    moved = replace(samples, stamp=samples.stamp + by, received=samples.received + by)
    return moved.select(np.argsort(moved.stamp, kind='stable'))


def changes(name: str) -> dict[str, Callable]:
    """What happens to the input, by the words for it: changed(samples, inside)."""
    words, wrong = WRONG[name]
    return {'missing': lambda samples, inside: samples.select(~inside),
            'stamped 0.5 s late': _late,
            words: lambda samples, inside: _partly(samples, wrong(samples), inside),
            'doubled': lambda samples, inside: samples.select(np.repeat(np.arange(len(samples)), 1 + inside)),
            'dead': lambda samples, inside: _dead(name, samples, inside)}


def fault_of(name: str, words: str, change: Callable, fixes: bool) -> Fault:
    """The fault of the input `name`; fixes: whether they come all the time."""
    def within(recording):
        samples = recording.streams()[name]
        time = (samples.stamp - recording.imu.stamp[0]) * 1e-9 - BEGIN
        return samples, (time >= 0.0) & (time < DURATION)

    def with_fixes(recording):
        time = (recording.gnss.stamp - recording.imu.stamp[0]) * 1e-9 - BEGIN
        kept = fixes | (time < WITHOUT_FIXES[0]) | (time >= WITHOUT_FIXES[1])
        return replace(recording, gnss=recording.gnss.select(kept))

    def alter(recording, *_):
        return with_fixes(recording).having({name: change(*within(recording))})

    def coast(recording, *_):
        samples, inside = within(recording)
        return with_fixes(recording).having({name: samples.select(~inside)})
    return Fault(f'{name} {words}{"" if fixes else ", no fixes"}', DURATION, alter, coast, INPUTS[name])


FAULTS = tuple(fault_of(name, words, change, fixes) for name in INPUTS for words, change in changes(name).items()
               for fixes in (True, False))

#: two IMUs: the second one lies on its side
SECOND = {'inputs': ['second'], 'second.type': 'imu', 'second.topic': '/second/imu',
          'second.mounting_rpy': [0.5 * np.pi, 0.0, 0.3]}


@cache
def with_two_imus(seed: int, rate: float, minutes: float = MINUTES) -> Recording:
    """A realistic drive with a second IMU, its stamps 4 ms after those of the first one."""
    drive, given = drive_of(seed, minutes), REALISTIC.distortions(seed)
    first = simulate_recording(drive, sensors(), GnssNoise(1.5, rate=rate), seed=seed, **given).recording
    other = simulate_recording(drive, sensors(), seed=seed + 10_000, mounting_rpy=SECOND['second.mounting_rpy'],
                               **given).recording.imu
    time = (other.stamp - other.stamp[0]) * 1e-9
    values = [np.column_stack([np.interp(time + 0.004, time, column) for column in part.T])
              for part in (other.specific_force, other.angular_rate)]
    second = ImuSamples(other.stamp + 4_000_000, other.received + 4_000_000, *values)
    return replace(first, reference=first.reference.select(slice(None, None, 10)), others={'second': second})


def _before(seconds):
    """Samples of the first so many seconds are missing."""
    return lambda imu, inside, rng: imu.select(imu.stamp > imu.stamp[0] + round(seconds * 1e9))


def _received_late(imu, inside, rng):
    received = imu.received + np.where(inside, 500_000_000, 0)
    return replace(imu, received=np.maximum.accumulate(received))


def _stays(imu, inside, rng):
    first = np.flatnonzero(inside)[0]
    return replace(imu, **{name: np.where(inside[:, None], getattr(imu, name)[first], getattr(imu, name))
                           for name in ('specific_force', 'angular_rate')})


def _turns_more(imu, inside, rng):
    return replace(imu, angular_rate=imu.angular_rate + np.where(inside[:, None], np.radians([0.0, 0.0, 5.0]), 0.0))


def _other_biases(imu, inside, rng):
    """Ten seconds of silence, and other biases from then on."""
    first = np.flatnonzero(inside)[0]
    gone = inside & (imu.stamp < imu.stamp[first] + 10 * 10**9)
    later = np.arange(len(imu)) >= first
    force, rate = rng.normal(0.0, 0.1, 3), np.radians(rng.normal(0.0, 0.3, 3))
    changed = replace(imu, specific_force=imu.specific_force + np.where(later[:, None], force, 0.0),
                      angular_rate=imu.angular_rate + np.where(later[:, None], rate, 0.0))
    return changed.select(~gone)


def _noisy(imu, inside, rng):
    noise = rng.normal(0.0, 1.0, (2, len(imu), 3)) * np.where(inside, 1.0, 0.0)[:, None]
    return replace(imu, specific_force=imu.specific_force + 3.0 * noise[0],
                   angular_rate=imu.angular_rate + 0.2 * noise[1])


IMU_CHANGES: dict[str, Callable] = {
    'nothing': lambda imu, inside, rng: imu,
    'missing': lambda imu, inside, rng: imu.select(~inside),
    'missing for the first 100 s': _before(100.0),
    'comes 0.5 s late': _received_late,
    'stays as it is': _stays,
    'doubled': lambda imu, inside, rng: imu.select(np.repeat(np.arange(len(imu)), 1 + inside)),
    'gyroscope z 5 deg/s off': _turns_more,
    'noise of 3 m/s^2 and 0.2 rad/s': _noisy,
    '10 s away, then with other biases': _other_biases,
}


def fault_of_imu(which: int, words: str, change: Callable, fixes: bool) -> Fault:
    """The fault of the first (0) or the second (1) IMU; fixes: whether they come all the time."""
    def changed(recording, rng):
        imu = recording.others['second'] if which else recording.imu
        time = (imu.stamp - recording.imu.stamp[0]) * 1e-9 - BEGIN
        return change(imu, (time >= 0.0) & (time < DURATION), rng)

    def with_fixes(recording):
        time = (recording.gnss.stamp - recording.imu.stamp[0]) * 1e-9 - BEGIN
        kept = fixes | (time < WITHOUT_FIXES[0]) | (time >= WITHOUT_FIXES[1])
        return replace(recording, gnss=recording.gnss.select(kept))

    def alter(recording, *_):
        imu = changed(recording, np.random.default_rng(1))
        altered = recording.having({'second' if which else 'imu': imu})
        return with_fixes(as_one(altered, table.check(SECOND))[0])

    def coast(recording, *_):
        alone = recording if which else replace(recording, imu=changed(recording, np.random.default_rng(1)))
        return with_fixes(alone)
    return Fault(f'{("first", "second")[which]} IMU {words}{"" if fixes else ", no fixes"}', DURATION, alter, coast)


def without_fixes(seed: int, rate: float, given: dict) -> list[float]:
    """Largest error, m, in the outage, with: the first IMU alone, the second one, both, and from the fault on the first
    alone, the second one."""
    clean, values = with_two_imus(seed, rate), {'reference_lever_arm': [0.0, 0.0, 0.0], **given}
    truth, faults = truth_of(clean, table.check(values)), {fault.name: fault for fault in IMU_FAULTS}
    cut = faults['first IMU nothing, no fixes'].coast(clean)
    turned = {**values, 'imu.mounting_rpy': SECOND['second.mounting_rpy']}
    ways = [(cut, values), (replace(cut, imu=clean.others['second'], others={}), turned), *(
        (faults[f'{name}, no fixes'].alter(clean), values)
        for name in ('first IMU nothing', 'second IMU missing', 'first IMU missing'))]
    found = [outcome(recording, truth, table.check(chosen), BEGIN) for recording, chosen in ways]
    return [float(o.error[(o.time >= 0) & (o.time <= DURATION + 1.0)].max()) for o in found]


IMU_FAULTS = tuple(fault_of_imu(which, words, change, fixes) for which in (0, 1)
                   for words, change in IMU_CHANGES.items() for fixes in (True, False))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=6)
    parser.add_argument('--first-seed', type=int, default=2001)
    parser.add_argument('--rate', type=float, default=1.0, help='of the fixes, Hz')
    parser.add_argument('--only', default='', help='faults with one of these in their name, separated by commas')
    parser.add_argument('--set', nargs='+', default=[], metavar='NAME=VALUE', help='parameters')
    parser.add_argument('--imus', action='store_true', help='faults of two IMUs')
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    given = {name: yaml.safe_load(value) for name, _, value in (text.partition('=') for text in options.set)}
    lines = ['| fault | largest, m | without it | 20 s after, m | without fault | after without it | in 95 % | said |',
             '|---|---|---|---|---|---|---|---|']
    print(*lines, sep='\n')
    faults, drive = (IMU_FAULTS, with_two_imus) if options.imus else (FAULTS, clean)
    for fault in faults:
        if any(part in fault.name for part in options.only.split(',')):
            lines.append(row(fault, [judged(fault, seed, options.rate, given, drive) for seed in range(
                options.first_seed, options.first_seed + options.seeds)]))
            print(lines[-1], flush=True)
    if options.imus:
        found = np.array([without_fixes(seed, options.rate, given) for seed in range(
            options.first_seed, options.first_seed + options.seeds)])
        ways = ('first IMU alone', 'second alone', 'both', 'first alone from the fault on',
                'second alone from the fault on')
        sizes = ', '.join(f'{way} {size:.1f}' for way, size in zip(ways, np.sqrt((found**2).mean(axis=0))))
        lines += ['', f'Largest error without fixes, m, RMS of the drives: {sizes}.']
        print(*lines[-2:], sep='\n')
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
