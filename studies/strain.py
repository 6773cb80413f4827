"""How often innovations are larger than expected: on drives on which nothing is wrong, and on those with a mistake.

    python studies/strain.py [--seeds 100] [--minutes 10] [--only NAME] [--output FILE.md]

The state `degraded` has as one of its reasons that innovations are so many times as large as expected. For each kind
of drive the realised over expected sigma of the innovations is looked at once a second, from SETTLED on, at the default
parameters. The table says what that is at the 50th and 99th percentile of the time and at most (the median, the 99th
percentile and the largest of the drives), and which share of the drives and of the time is above each threshold.

*as assumed*: sensors and receiver are what the parameters say. The others are REALISTIC drives (simulation/scene.py)
with the receivers of studies/vehicle.py; then those with a mistake in the parameters.
"""
from __future__ import annotations

import argparse
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from vehicle import FIXES, drive_of, simulated

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Nav
from mems_ins_fusion.filter.runs.replay import Aiding, Replay
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

#: the filter has settled so long after its start, s
SETTLED = 60.0
THRESHOLDS = (1.3, 1.5, 1.75, 2.0, 2.5, 3.0)


def as_assumed(seed: int, minutes: float) -> Recording:
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(simulate_drive(60.0 * minutes, seed, standstill=10.0), sensors, GnssNoise(1.5),
                              seed=seed).recording


def early(seconds: float):
    """Makes drives with fixes whose stamps are `seconds` early."""
    def make(seed, minutes):
        recording = realistic('1.5 m')(seed, minutes)
        return replace(recording, gnss=replace(recording.gnss, stamp=recording.gnss.stamp - round(seconds * 1e9)))
    return make


def realistic(receiver: str):
    """Makes REALISTIC drives with one of FIXES."""
    return lambda seed, minutes: simulated(seed, minutes, FIXES[receiver], driven(seed, minutes))


driven = lru_cache(maxsize=1)(drive_of)  # a drive is the same whatever the receiver

DRIVES = {'as assumed': as_assumed, **{name: realistic(name) for name in FIXES},
          'fixes 0.3 s early': early(0.3), 'fixes 0.8 s early': early(0.8)}


def strains(recording: Recording) -> np.ndarray:
    """Realised over expected sigma of the innovations, once a second."""
    keep = np.diff(recording.imu.stamp // 10**9, prepend=-1) > 0
    work = Replay(FilterConfig.from_parameters(table.defaults()), recording.imu, recording.gnss, Aiding(), None, keep)
    found = work.run()
    if not len(found.stamp):
        return np.zeros(0)
    factor = np.concatenate([stretch.states for stretch in work.stretches])[:, list(work.columns).index(
        Nav.VARIANCE_FACTOR)]
    return np.sqrt(factor[found.stamp - found.stamp[0] > SETTLED * 1e9])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=100)
    parser.add_argument('--minutes', type=float, default=10.0)
    parser.add_argument('--only', choices=DRIVES, nargs='+', default=list(DRIVES))
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    heads = ['drives', '50 %', '99 %', 'largest (50, 99 %, all)', *(f'above {t:g}' for t in THRESHOLDS)]
    lines = [f'| {" | ".join(["", *heads])} |', '|' + '---|' * (len(heads) + 1)]
    found = {name: [] for name in options.only}
    for seed in range(options.seeds):
        for name, drives in found.items():
            drives.append(strains(DRIVES[name](3000 + seed, options.minutes)))
    for name, drives in found.items():
        every = np.concatenate(drives)
        largest = np.array([drive.max() for drive in drives if len(drive)])
        above = [f'{np.mean(largest > t):.0%}, {np.mean(every > t):.2%}' for t in THRESHOLDS]
        lines.append(f'| {name} | {len(largest)} | {np.median(every):.2f} | {np.quantile(every, 0.99):.2f} | '
                     f'{np.median(largest):.2f}, {np.quantile(largest, 0.99):.2f}, {largest.max():.2f} | '
                     f'{" | ".join(above)} |')
    print(*lines, sep='\n')
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
