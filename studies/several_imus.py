"""What a second IMU is worth, and what its faults cost: paired with the same drives and one IMU alone.

    python studies/several_imus.py [--seeds 8] [--first-seed 3001] [--minutes 16] [--only TEXT,TEXT] [--output FILE.md]

The drives of faults.py with two IMUs of one grade, each with its own errors, vibration and mounting, the second one's
stamps 4 ms after the first one's. Fixes of 1.5 m once a second are withheld for 30 s each 100 s. A fault begins 30 s
before each of these outages and ends with it; *always*: from the begin, *from 150 s on*: to the end. With a fault of
the second IMU, *alone* is the first one alone, without fault. With a fault of the first IMU it is the second one alone,
the best that can be had where the first one fails; beside it, the first one alone with its fault.

Of each drive the RMS of the largest errors in its outages is taken, and its ratio to that of one IMU alone; the table
has the RMS over all drives, m, the geometric mean of the ratios with its 95 % interval over the drives (Student's t of
their logarithms), and on how many drives it was larger. Then the same of the RMS of the error with fixes, and the share
of all errors within the 95 % ellipse.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from faults import outcome
from scipy.special import stdtrit
from vehicle import drive_of, sensors

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import rms
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import ImuSamples, Recording
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_recording

SPACING = 100.0  # s from the begin of one outage to that of the next
LENGTH = 30.0  # s, of an outage
BEFORE = 30.0  # s before each outage at which its fault begins
SETTLED = 60.0  # s after the begin from which errors with fixes are judged
DIES = 150.0  # s after the begin at which an IMU ends, or falls silent for 10 s and comes back with other biases
#: parameters of two IMUs: the second one lies on its side
SECOND = {'inputs': ['second'], 'second.type': 'imu', 'second.topic': '/second/imu',
          'second.mounting_rpy': [0.5 * np.pi, 0.0, 0.3]}


def with_two_imus(seed: int, minutes: float) -> Recording:
    """A realistic drive with a second IMU, its stamps 4 ms after those of the first one."""
    drive, given = drive_of(seed, minutes), REALISTIC.distortions(seed)
    first = simulate_recording(drive, sensors(), GnssNoise(1.5), seed=seed, **given).recording
    other = simulate_recording(drive, sensors(), seed=seed + 10_000, mounting_rpy=SECOND['second.mounting_rpy'],
                               **given).recording.imu
    time = (other.stamp - other.stamp[0]) * 1e-9
    values = [np.column_stack([np.interp(time + 0.004, time, column) for column in part.T])
              for part in (other.specific_force, other.angular_rate)]
    second = ImuSamples(other.stamp + 4_000_000, other.received + 4_000_000, *values)
    return replace(first, reference=first.reference.select(slice(None, None, 10)), others={'second': second})


def _before(seconds):
    """Samples of the first `seconds` are missing."""
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
    """Ten seconds of silence from DIES on, and other biases from then on."""
    time = (imu.stamp - imu.stamp[0]) * 1e-9 - DIES
    gone, later = (time >= 0.0) & (time < 10.0), time >= 0.0
    force, rate = rng.normal(0.0, 0.1, 3), np.radians(rng.normal(0.0, 0.3, 3))
    changed = replace(imu, specific_force=imu.specific_force + np.where(later[:, None], force, 0.0),
                      angular_rate=imu.angular_rate + np.where(later[:, None], rate, 0.0))
    return changed.select(~gone)


def _noisy(imu, inside, rng):
    noise = rng.normal(0.0, 1.0, (2, len(imu), 3)) * np.where(inside, 1.0, 0.0)[:, None]
    return replace(imu, specific_force=imu.specific_force + 3.0 * noise[0],
                   angular_rate=imu.angular_rate + 0.2 * noise[1])


def _lost(imu, inside, rng):
    """Each sample is lost with a probability of 30 %."""
    return imu.select(~inside | (rng.random(len(imu)) > 0.3))


def _in_parts(imu, inside, rng):
    """Silent for 3 s of each 10 s."""
    return imu.select(~inside | ((imu.stamp // 10**9) % 10 >= 3))


def _delayed(imu, inside, rng):
    """The values are those of half a second ago."""
    time = imu.stamp * 1e-9 - imu.stamp[0] * 1e-9
    late = {name: np.column_stack([np.interp(time - 0.5, time, column) for column in getattr(imu, name).T])
            for name in ('specific_force', 'angular_rate')}
    return replace(imu, **{name: np.where(inside[:, None], late[name], getattr(imu, name)) for name in late})


def _white(imu, inside, rng):
    """Ten times the white noise of REALISTIC."""
    more = np.where(inside, 10.0 * np.sqrt(100.0), 0.0)[:, None] * rng.standard_normal((2, len(imu), 3))
    return replace(imu, specific_force=imu.specific_force + 0.1 / 60 * more[0],
                   angular_rate=imu.angular_rate + np.radians(0.2) / 60 * more[1])


def _scaled(scale):
    def change(imu, inside, rng):
        by = np.where(inside, scale, 1.0)[:, None]
        return replace(imu, specific_force=by * imu.specific_force, angular_rate=by * imu.angular_rate)
    return change


def _swapped(imu, inside, rng):
    order = np.where(inside[:, None], [1, 0, 2], [0, 1, 2])
    return replace(imu, **{name: np.take_along_axis(getattr(imu, name), order, axis=1)
                           for name in ('specific_force', 'angular_rate')})


def _drifts(imu, inside, rng):
    """The rate about z changes by 0.3 deg/s in a minute, again and again."""
    ramp = np.where(inside, np.radians(0.3) * ((imu.stamp - imu.stamp[0]) * 1e-9 % 60.0) / 60.0, 0.0)
    return replace(imu, angular_rate=imu.angular_rate + ramp[:, None] * [0.0, 0.0, 1.0])


def _none(imu, inside, rng):
    """No numbers."""
    return replace(imu, angular_rate=np.where(inside[:, None], np.nan, imu.angular_rate))


def _dies(imu, inside, rng):
    return imu.select(imu.stamp < imu.stamp[0] + round(DIES * 1e9))


EACH, ALWAYS = 'each', 'always'
CHANGES: dict[str, tuple[str, Callable]] = {
    'nothing': (EACH, lambda imu, inside, rng: imu),
    'missing': (EACH, lambda imu, inside, rng: imu.select(~inside)),
    'missing for the first 100 s': (ALWAYS, _before(100.0)),
    'missing from 150 s on': (ALWAYS, _dies),
    '10 s away at 150 s, then with other biases': (ALWAYS, _other_biases),
    'stays as it is': (EACH, _stays),
    'not a number': (EACH, _none),
    'doubled': (EACH, lambda imu, inside, rng: imu.select(np.repeat(np.arange(len(imu)), 1 + inside))),
    'loses 30 % of its samples': (EACH, _lost),
    'loses 30 % of its samples, always': (ALWAYS, _lost),
    'silent for 3 s of each 10 s, always': (ALWAYS, _in_parts),
    'comes 0.5 s late': (EACH, _received_late),
    'comes 0.5 s late, always': (ALWAYS, _received_late),
    'measures 0.5 s late': (EACH, _delayed),
    'measures 0.5 s late, always': (ALWAYS, _delayed),
    'noise of 3 m/s^2 and 0.2 rad/s': (EACH, _noisy),
    'ten times the noise': (EACH, _white),
    'ten times the noise, always': (ALWAYS, _white),
    'scale 5 % more': (EACH, _scaled(1.05)),
    'scale 5 % more, always': (ALWAYS, _scaled(1.05)),
    'scale 3 % more, always': (ALWAYS, _scaled(1.03)),
    'axes x and y exchanged': (EACH, _swapped),
    'axes x and y exchanged, always': (ALWAYS, _swapped),
    'gyroscope z 5 deg/s off': (EACH, _turns_more),
    'gyroscope z drifts 0.3 deg/s in a minute, always': (ALWAYS, _drifts),
}
#: of the first IMU: what makes it unusable, so that the second one alone is what can be had
OF_FIRST = ('missing', 'missing for the first 100 s', 'missing from 150 s on',
            '10 s away at 150 s, then with other biases', 'stays as it is', 'not a number',
            'noise of 3 m/s^2 and 0.2 rad/s', 'ten times the noise', 'gyroscope z 5 deg/s off', 'scale 5 % more',
            'axes x and y exchanged', 'measures 0.5 s late', 'gyroscope z drifts 0.3 deg/s in a minute, always')


def _phase(recording: Recording, samples) -> np.ndarray:
    """s from the last begin of a fault, -1 before the first, of each of `samples`."""
    time = (samples.stamp - recording.imu.stamp[0]) * 1e-9 - (SPACING - BEFORE)
    return np.where(time < 0.0, -1.0, time % SPACING)


def in_outage(time: np.ndarray) -> np.ndarray:
    """Whether fixes are withheld at `time` (n,), s after the begin."""
    return (time >= SPACING) & (time % SPACING < LENGTH)


@cache
def clean(seed: int, minutes: float) -> Recording:
    """Two IMUs without fault, and fixes but in the outages."""
    whole = with_two_imus(seed, minutes)
    time = (whole.gnss.stamp - whole.imu.stamp[0]) * 1e-9
    return replace(whole, gnss=whole.gnss.select(~in_outage(time)))


def changed(recording: Recording, which: str, words: str) -> ImuSamples:
    """The samples of an IMU, `imu` or `second`, with the fault in those words."""
    when, change = CHANGES[words]
    imu = recording.streams()[which]
    phase = _phase(recording, imu)
    inside = (phase >= 0.0) & (phase < BEFORE + LENGTH) if when == EACH else np.ones(len(imu), bool)
    return change(imu, inside, np.random.default_rng(1))


def measured(recording: Recording, clean: Recording, given: dict) -> np.ndarray:
    """Largest errors in the outages RMS, m; error with fixes RMS, m; share within the 95 % ellipse."""
    values = table.check({'reference_lever_arm': [0.0, 0.0, 0.0], **given})
    begin = float((clean.imu.stamp[0] - recording.imu.stamp[0]) * 1e-9)
    o = outcome(recording, truth_of(clean, values), values, begin)
    number, dark = np.floor(o.time / SPACING), in_outage(o.time)
    largest = [o.error[dark & (number == n)].max() for n in np.unique(number[dark])]
    settled = o.time > SETTLED
    return np.array([rms(np.array(largest)), rms(o.error[~dark & settled]), o.inside[settled].mean()])


def _second_alone(recording: Recording) -> tuple[Recording, dict]:
    return (replace(recording, imu=recording.others['second'], others={}),
            {'imu.mounting_rpy': SECOND['second.mounting_rpy']})


def _one_alone(recording: Recording, which: str) -> tuple[Recording, dict]:
    return (replace(recording, others={}), {}) if which == 'imu' else _second_alone(recording)


def _ratio(found: np.ndarray, alone: np.ndarray) -> str:
    logs = np.log(found / alone)
    half = stdtrit(len(logs) - 1, 0.975) * logs.std(ddof=1) / np.sqrt(len(logs))
    low, middle, high = np.exp([logs.mean() - half, logs.mean(), logs.mean() + half])
    return f'{middle:.3f} ({low:.3f} to {high:.3f}), {np.count_nonzero(logs > 1e-9)} of {len(logs)}'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=8)
    parser.add_argument('--first-seed', type=int, default=3001)
    parser.add_argument('--minutes', type=float, default=16.0)
    parser.add_argument('--only', default='', help='rows with one of these in their name, separated by commas')
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    drives = [clean(seed, options.minutes) for seed in seeds]
    alone = {which: np.array([measured(*_of(drive, _one_alone(drive, which))) for drive in drives])
             for which in ('imu', 'second')}
    lines = ['| fault | without fixes, m | alone, m | ratio, larger on | with fixes: ratio, larger on | in 95 % | '
             'the first alone with it, m |', '|---|---|---|---|---|---|---|']
    print(*lines, sep='\n')
    rows = [('second', words) for words in CHANGES] + [('imu', words) for words in OF_FIRST]
    for which, words in rows:
        name = f'{"first" if which == "imu" else which} IMU {words}'
        if not any(part in name for part in options.only.split(',')):
            continue
        of, found, faulty = alone['second' if which == 'imu' else 'imu'], [], []
        for drive in drives:
            altered = drive.having({which: changed(drive, which, words)})
            found.append(measured(altered, drive, SECOND))
            if which == 'imu':
                faulty.append(measured(replace(altered, others={}), drive, {}))
        found = np.array(found)
        cells = [name, f'{rms(found[:, 0]):.2f}', f'{rms(of[:, 0]):.2f}', _ratio(found[:, 0], of[:, 0]),
                 _ratio(found[:, 1], of[:, 1]), f'{100 * found[:, 2].mean():.1f} %',
                 f'{rms(np.array(faulty)[:, 0]):.2f}'.replace('nan', 'nothing') if faulty else '']
        lines.append(f'| {" | ".join(cells)} |')
        print(lines[-1], flush=True)
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


def _of(drive: Recording, way: tuple[Recording, dict]) -> tuple[Recording, Recording, dict]:
    return way[0], drive, way[1]


if __name__ == '__main__':
    main()
