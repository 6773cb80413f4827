"""The diagnosis while driving on simulated drives: what it finds, proves and applies, when, and where nothing is.

    python studies/online.py [--seeds 3] [--minutes 20] [--processes 2]

Plain drives (an IMU and a receiver exactly as the parameters say) and realistic ones (studies/vehicle.py: hills,
springs, vibration, a mount that is some degrees off, which is there to be found), with nothing wrong, with fixes
stamped 0.25 s late or early (the sign from the seed), and with fixes stamped so from a third of the drive on, or until
there. By name how often something was on trial, and applied, and after how many seconds (median, last; after a change:
since it); how many values of the time offset were within 2 sigma; after how many seconds, from the change where there
is one, a value was dropped at once. Then the RMS position error of the last third of the drive, m, as a node
publishes it: with the parameters as given, with `diagnosis.online: apply`, and with the time offset given.
"""
from __future__ import annotations

import argparse
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from vehicle import FIXES, simulated

from mems_ins_fusion.diagnosis.applying import LiveOutput, live_output
from mems_ins_fusion.diagnosis.quantity import COARSE
from mems_ins_fusion.diagnosis.watch import RecordingWatch
from mems_ins_fusion.filter.runs.odometry import POSITION
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import SensorErrors, simulate_drive, simulate_recording

#: s, by which fixes are stamped late or early
OFFSET = 0.25
#: (drive, receiver, from which part of the drive on the stamps are wrong, and until which)
ROWS = (('plain', '1.5 m', 0.0, 0.0), ('plain', 'RTK', 0.0, 0.0), ('realistic', '1.5 m', 0.0, 0.0),
        ('plain', '1.5 m', 0.0, 1.0), ('realistic', 'RTK', 0.0, 1.0), ('plain', 'RTK', 0.0, 1.0),
        ('plain', 'RTK', 1 / 3, 1.0), ('plain', 'RTK', 0.0, 0.5))
#: last part of a drive, in which the errors are compared
LAST = 1 / 3


def recorded(row: tuple, seed: int, minutes: float):
    """The recording, and the offset (s) of its fixes where they are wrong."""
    kind, receiver, begin, end = row
    if kind == 'realistic':
        recording = simulated(seed, minutes, FIXES[receiver])
    else:
        sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
        recording = simulate_recording(simulate_drive(60.0 * minutes, seed), sensors, FIXES[receiver],
                                       seed=seed).recording
    offset, fixes = OFFSET * (-1) ** seed if end > begin else 0.0, recording.gnss
    part = (fixes.stamp - recording.imu.stamp[0]) / (60e9 * minutes)
    stamp = np.where((part >= begin) & (part < end), fixes.stamp + round(offset * 1e9), fixes.stamp)
    return replace(recording, gnss=replace(fixes, stamp=stamp), speed=None, velocity=None, heading=None), offset


def error(recording, values: dict, watch: RecordingWatch | None = None) -> tuple[float, LiveOutput]:
    """RMS horizontal error of the last part, m, and the drive."""
    truth, imu = recording.reference, recording.imu
    run = live_output(replace(recording, reference=None), values, watch,
                      (truth.latitude[0], truth.longitude[0], 0.0), every=10)
    return rms(recording, run, imu.stamp[-1] - LAST * (imu.stamp[-1] - imu.stamp[0]), imu.stamp[-1]), run


def rms(recording, run: LiveOutput, begin: float, end: float) -> float:
    """RMS horizontal error of a drive whose datum is the first position of the reference, m, from `begin` to `end`, ns.
    """
    truth = recording.reference
    north, east, _ = to_local(truth.latitude, truth.longitude, truth.height,
                              np.array([truth.latitude[0], truth.longitude[0], 0.0]))
    part = (run.stamp >= begin) & (run.stamp <= end)
    at = (run.stamp[part] - truth.stamp[0]) * 1e-9, (truth.stamp - truth.stamp[0]) * 1e-9
    off = run.odometry[part, POSITION:POSITION + 2] - np.column_stack([np.interp(*at, east), np.interp(*at, north)])
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def of_drive(row: tuple, seed: int, minutes: float):
    """The row, its offset, what was said and applied, and three errors."""
    recording, offset = recorded(row, seed, minutes)
    values = table.check({'diagnosis.online': 'apply'})
    watch = RecordingWatch(replace(recording, reference=None), values)
    with_offset = {**values, 'gnss.time_offset': offset if row[3] == 1.0 else 0.0}
    as_given, _ = error(recording, values)
    apply, run = error(recording, values, watch)
    right, _ = error(recording, with_offset)
    begin = int(recording.imu.stamp[0])
    said = [((q.time - begin) * 1e-9, q) for q in watch.said]
    gone = [(one.name, (one.stamp - begin) * 1e-9) for one in run.dropped]
    return row, offset, said, gone, (as_given, apply, right)


def line(row: tuple, drives: list, minutes: float) -> str:
    """Of the table."""
    kind, receiver, begin, end = row
    changed = 60.0 * minutes * (begin or (end if end < 1.0 else 0.0))
    tried, applied, right, dropped = defaultdict(int), defaultdict(list), [], []
    for offset, said, gone, _ in drives:
        for name in {q.name for _, q in said if q.state == COARSE}:
            tried[name] += 1
        for name in {q.name for _, q in said if q.applied}:
            when, quantity = next((when, q) for when, q in said if q.name == name and q.applied)
            applied[name].append(when - 60.0 * minutes * begin)
            if name == 'gnss_time_offset':
                found = quantity.parameters['time_offset']
                right.append(abs(found.value - offset) < 2.0 * found.sigma)
        dropped += [when - changed for name, when in gone]
    wrong = 'nothing' if begin == end else f'stamps, {begin:.0%} to {end:.0%}'
    told = '; '.join(f'{name} {len(t)} ({np.median(t):.0f}, {max(t):.0f} s)' for name, t in sorted(applied.items()))
    shown = ', '.join(f'{name} {count}' for name, count in sorted(tried.items()))
    errors = np.sqrt(np.mean(np.square([e for *_, e in drives]), axis=0))
    return (f"| {kind}, {receiver} | {wrong} | {len(drives)} | {shown or 'none'} | {told or 'none'} | "
            f"{f'{sum(right)} of {len(right)}' if right else ''} | {', '.join(f'{s:.0f} s' for s in dropped)} | "
            f"{' | '.join(f'{e:.2f}' for e in errors)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=3)
    parser.add_argument('--first-seed', type=int, default=5000)
    parser.add_argument('--minutes', type=float, default=20.0)
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    work = [(row, seed) for row in ROWS for seed in range(options.first_seed, options.first_seed + options.seeds)]
    results = defaultdict(list)
    print('| drive | wrong | drives | on trial | applied | within 2 sigma | dropped after | as given | apply | offset '
          'given |')
    print(f'|{"---|" * 10}', flush=True)
    with ProcessPoolExecutor(options.processes) as pool:
        rows, seeds = zip(*work)
        for row, *told in pool.map(of_drive, rows, seeds, [options.minutes] * len(work)):
            results[row].append(told)
            if len(results[row]) == options.seeds:
                print(line(row, results[row], options.minutes), flush=True)


if __name__ == '__main__':
    main()
