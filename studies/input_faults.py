"""What faults of the further inputs cost: each input missing, late, wrong, doubled and dead, with fixes and without.

    python studies/input_faults.py [--seeds 6] [--rates 0.2 1 10] [--only TEXT,TEXT] [--output FILE.md]

The drives of faults.py with one input more, at the rates that vehicles have (RATES): speed, velocity, odometry, poses
of a lidar, heading, pressure, magnetometer, a second receiver 1.6 m behind the first or a second IMU. The fault lasts
for a minute from 200 s on. Each row twice: with fixes all the time, and without any in the second half of that minute.
*without it*: the same filter that does not have the input while the fault lasts. RMS and largest error are those of
that minute; *after*: of the minute after it; in 95 %: of both. A row is **bold** where the input is worse than none, by
more than a tenth in RMS, or less are in the ellipse than 92 % and than without it.

missing: nothing comes. late, early: stamps of half a second later or earlier. doubled: each message twice. dead: it
stays at the value it has as the fault begins. wrong: WRONG below.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import yaml
from faults import BEGIN, METRE, MINUTES, Fault, Outcome, outcome
from several_imus import SECOND, with_two_imus
from vehicle import drive_of, sensors

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import rms
from mems_ins_fusion.filter.measurements.registry import aiding
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SimulatedAiding, simulate_recording

#: Hz, of each input but further receivers, which have the rate of the first
RATES = {'speed_rate': 100.0, 'velocity_rate': 10.0, 'twist_rate': 50.0, 'heading_rate': 10.0, 'pressure_rate': 50.0,
         'magnetometer_rate': 20.0}
DURATION = 60.0
WITHOUT_FIXES = 30.0, 60.0  # s of the fault
REAR = {'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': '/rear', 'rear.lever_arm': [-1.6, 0.0, 0.0]}
LIDAR = {'inputs': ['lidar'], 'lidar.type': 'pose', 'lidar.topic': '/lidar/odometry'}
#: parameters of each input
INPUTS = {**{name: {f'{name}_topic': f'/{name}'} for name in ('speed', 'velocity', 'twist', 'heading', 'pressure',
                                                                   'magnetometer')},
          'lidar': LIDAR, 'rear': REAR, 'second': SECOND}


def _noise(shape):
    """White noise of one, the same each time."""
    return np.random.default_rng(0).standard_normal(shape)


#: what it does to samples, by words
WRONG: dict[str, dict[str, Callable]] = {
    'speed': {'in km/h': lambda s: replace(s, speed=3.6 * s.speed),
              'a tenth more': lambda s: replace(s, speed=1.1 * s.speed),
              'scatters by 2 m/s': lambda s: replace(s, speed=s.speed + 2.0 * _noise(len(s.speed)))},
    'velocity': {'north and east exchanged': lambda s: replace(s, velocity=s.velocity[:, [1, 0, 2]]),
                 'in km/h': lambda s: replace(s, velocity=3.6 * s.velocity),
                 'of the other sign': lambda s: replace(s, velocity=-s.velocity),
                 'scatters by 2 m/s': lambda s: replace(s, velocity=s.velocity + 2.0 * _noise(s.velocity.shape))},
    'twist': {'scatters by 2 m/s': lambda s: replace(s, twist=s.twist + [2.0, 2.0, 0.0] * _noise(s.twist.shape)),
              'in km/h, turns the other way': lambda s: replace(s, twist=s.twist * [3.6, 3.6, -1.0])},
    'heading': {'scatters by 30 deg': lambda s: replace(s, yaw=s.yaw + np.radians(30.0) * _noise(len(s.yaw))),
                '90 deg off': lambda s: replace(s, yaw=s.yaw + 0.5 * np.pi),
                '5 deg off': lambda s: replace(s, yaw=s.yaw + np.radians(5.0))},
    'pressure': {'5 hPa off': lambda s: replace(s, pressure=s.pressure + 500.0)},
    'magnetometer': {'beside a magnet of 30 uT': lambda s: replace(s, field=s.field + [3e-5, 3e-5, 0.0])},
    'lidar': {'turned by 90 deg': lambda s: replace(s, twist=s.twist[:, [1, 0, 2]] * [1.0, -1.0, 1.0])},
    'second': {'axes x and y exchanged': lambda s: replace(s, specific_force=s.specific_force[:, [1, 0, 2]],
                                                           angular_rate=s.angular_rate[:, [1, 0, 2]])},
    'rear': {'30 m off': lambda s: replace(s, latitude=s.latitude + 30.0 * METRE)},
}
#: which arrays of its samples an input measures
_VALUES = {'rear': ('latitude', 'longitude', 'height'), 'heading': ('yaw',),
           'magnetometer': ('field',), 'lidar': ('twist',), 'second': ('specific_force', 'angular_rate')}


@cache
def clean(seed: int, rate: float) -> Recording:
    """A realistic drive with all inputs. rate: of the receivers, Hz."""
    aided = SimulatedAiding(**RATES, fix_rate=rate, fix_sigma=1.5)
    named = [one for values in (REAR, LIDAR) for one in aiding(table.check(values)) if not one.is_plain]
    recording = simulate_recording(drive_of(seed, MINUTES), sensors(), GnssNoise(1.5, rate=rate), seed=seed,
                                   **{**REALISTIC.distortions(seed), 'aiding': aided, 'named': named}).recording
    second = with_two_imus(seed, MINUTES).others['second']
    return replace(recording.having({'second': second}), reference=recording.reference.select(slice(None, None, 10)))



def _dead(name, samples, inside):
    first, found = np.flatnonzero(inside)[0], {}
    for part in _VALUES.get(name, (name,)):
        values = getattr(samples, part).copy()
        values[inside] = 0.0 if name == 'lidar' else values[first]  # poses that stay are no displacement
        found[part] = values
    return replace(samples, **found)


def _partly(samples, changed, inside):
    """`changed` inside, `samples` elsewhere."""
    values = {name: np.where(inside.reshape(-1, *[1] * (np.ndim(part) - 1)), getattr(changed, name), part)
              for name, part in vars(samples).items() if part is not None}
    return replace(samples, **values)


def _late(samples, inside, sign=1):
    by = np.where(inside, sign * 500_000_000, 0)
    moved = replace(samples, stamp=samples.stamp + by, received=samples.received + by)
    return moved.select(np.argsort(moved.stamp, kind='stable'))


def changes(name: str) -> dict[str, Callable]:
    """What happens to the input, by the words for it: changed(samples, inside)."""
    return {'missing': lambda samples, inside: samples.select(~inside),
            'stamped 0.5 s late': _late,
            'stamped 0.5 s early': partial(_late, sign=-1),
            **{words: lambda samples, inside, wrong=wrong: _partly(samples, wrong(samples), inside)
               for words, wrong in WRONG[name].items()},
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


def judged(fault: Fault, seed: int, rate: float, given: dict, known: dict) -> tuple[Outcome, Outcome]:
    """With the fault, and without the input while it lasts, which is the same for all faults of an input. rate: of the
    fixes, Hz. given: parameters. known: outcomes without the input, which are added."""
    recording = clean(seed, rate)
    values = table.check({'reference_lever_arm': [0.0, 0.0, 0.0], **fault.values, **given})
    truth, key = truth_of(recording, values), (fault.name.split()[0], fault.name.endswith('no fixes'), seed, rate)
    if key not in known:
        known[key] = outcome(fault.coast(recording), truth, values, BEGIN)
    return outcome(fault.alter(recording), truth, values, BEGIN), known[key]


def row(fault: Fault, rate: float, found: list[tuple[Outcome, Outcome]]) -> str:
    """A line of the table from what was `judged` for each seed."""
    def errors(outcomes, begin, end):
        return np.concatenate([o.error[(o.time >= begin) & (o.time <= end)] for o in outcomes])

    faulty, without = zip(*found)
    during, after = ([errors(one, *span) for one in (faulty, without)] for span in (
        (0.0, DURATION + 1.0), (DURATION + 1.0, 2.0 * DURATION)))
    held, held_without = (np.concatenate([o.inside[(o.time >= 0.0) & (o.time <= 2.0 * DURATION)] for o in one]).mean()
                          for one in (faulty, without))
    pairs = [f'{f(with_it):.2f} | {f(without_it):.2f}' for f, (with_it, without_it) in (
        (rms, during), (np.max, during), (rms, after))]
    bad = rms(during[0]) > 1.1 * rms(during[1]) or held < min(0.92, held_without)
    name = f'**{fault.name}**' if bad else fault.name
    return f'| {name} | {rate:g} | {" | ".join(pairs)} | {100 * held:.0f} % |'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=6)
    parser.add_argument('--first-seed', type=int, default=2001)
    parser.add_argument('--rates', type=float, nargs='+', default=[1.0], help='of the fixes, Hz')
    parser.add_argument('--only', default='', help='faults with one of these in their name, separated by commas')
    parser.add_argument('--set', nargs='+', default=[], metavar='NAME=VALUE', help='parameters')
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    given = {name: yaml.safe_load(value) for name, _, value in (text.partition('=') for text in options.set)}
    lines = ['| fault | fixes, Hz | RMS, m | without it | largest, m | without it | after, m | without it | in 95 % |',
             '|---|---|---|---|---|---|---|---|---|']
    print(*lines, sep='\n')
    known: dict[tuple, Outcome] = {}
    for rate in options.rates:
        for fault in FAULTS:
            if any(part in fault.name for part in options.only.split(',')):
                lines.append(row(fault, rate, [judged(fault, seed, rate, given, known) for seed in range(
                    options.first_seed, options.first_seed + options.seeds)]))
                print(lines[-1], flush=True)
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
