"""The diagnosis while driving on simulated drives: what it finds and when, and what it finds where nothing is.

    python studies/online.py [--seeds 3] [--minutes 15] [--processes 2]

Plain drives (an IMU and a receiver exactly as the parameters say) and realistic ones (studies/vehicle.py: hills,
springs, vibration, a mount that is some degrees off, which is there to be found), with nothing wrong, with fixes
stamped 0.25 s late or early (the sign from the seed), and with fixes stamped so from the middle on. FINE by name, how
often and after how many seconds (median, last; of a change: since it), and how many values of the time offset were
within 2 sigma.
"""
from __future__ import annotations

import argparse
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from vehicle import FIXES, simulated

from mems_ins_fusion.diagnosis.online import watched
from mems_ins_fusion.diagnosis.quantity import COARSE, FINE
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import SensorErrors, simulate_drive, simulate_recording

#: s, by which fixes are stamped late or early
OFFSET = 0.25
#: (drive, receiver, from which part of the drive on the stamps are wrong; 1: never)
ROWS = (('plain', '1.5 m', 1.0), ('plain', 'RTK', 1.0), ('realistic', '1.5 m', 1.0), ('plain', '1.5 m', 0.0),
        ('realistic', 'RTK', 0.0), ('plain', 'RTK', 0.5))


def recorded(kind: str, receiver: str, seed: int, minutes: float, begin: float):
    """The recording, and the offset (s) of its fixes at the end."""
    if kind == 'realistic':
        recording = simulated(seed, minutes, FIXES[receiver])
    else:
        sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
        recording = simulate_recording(simulate_drive(60.0 * minutes, seed), sensors, FIXES[receiver],
                                       seed=seed).recording
    offset, fixes = OFFSET * (-1) ** seed, recording.gnss
    if begin == 1.0:
        offset = 0.0
    first = recording.imu.stamp[0] + round(begin * 60e9 * minutes)
    stamp = np.where(fixes.stamp >= first, fixes.stamp + round(offset * 1e9), fixes.stamp)
    return replace(recording, gnss=replace(fixes, stamp=stamp), reference=None, speed=None, velocity=None,
                   heading=None), offset


def of_drive(row: tuple, seed: int, minutes: float):
    """The row, its offset, and what was said."""
    kind, receiver, begin = row
    recording, offset = recorded(kind, receiver, seed, minutes, begin)
    changed = recording.imu.stamp[0] + round((begin % 1.0) * 60e9 * minutes)
    return row, offset, [((q.time - changed) * 1e-9, q) for q in watched(recording, table.defaults())]


def line(row: tuple, drives: list) -> str:
    """Of the table."""
    fine, coarse, right = defaultdict(list), defaultdict(int), []
    for offset, said in drives:
        for name in {q.name for _, q in said if q.state == COARSE}:
            coarse[name] += 1
        for name in {q.name for _, q in said if q.state == FINE}:
            when, quantity = next((when, q) for when, q in said if q.name == name and q.state == FINE and (
                row[2] != 0.5 or when > 0.0))
            fine[name].append(when)
            if name == 'gnss_time_offset':
                found = quantity.parameters['time_offset']
                right.append(abs(found.value - offset) < 2.0 * found.sigma)
    kind, receiver, begin = row
    wrong = {1.0: 'nothing', 0.0: 'stamps', 0.5: 'stamps from the middle on'}[begin]
    told = '; '.join(f'{name} {len(t)} ({np.median(t):.0f}, {max(t):.0f} s)' for name, t in sorted(fine.items()))
    tried = ', '.join(f'{name} {count}' for name, count in sorted(coarse.items()))
    return (f"| {kind}, {receiver} | {wrong} | {len(drives)} | {tried or 'none'} | {told or 'none'} | "
            f"{f'{sum(right)} of {len(right)}' if right else ''} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=3)
    parser.add_argument('--first-seed', type=int, default=5000)
    parser.add_argument('--minutes', type=float, default=15.0)
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    work = [(row, seed) for row in ROWS for seed in range(options.first_seed, options.first_seed + options.seeds)]
    results = defaultdict(list)
    print('| drive | wrong | drives | COARSE | FINE | within 2 sigma |')
    print(f'|{"---|" * 6}', flush=True)
    with ProcessPoolExecutor(options.processes) as pool:
        rows, seeds = zip(*work)
        for row, offset, said in pool.map(of_drive, rows, seeds, [options.minutes] * len(work)):
            results[row].append((offset, said))
            if len(results[row]) == options.seeds:
                print(line(row, results[row]), flush=True)


if __name__ == '__main__':
    main()
