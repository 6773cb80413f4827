"""Time offset and antenna as a look at some minutes finds them: how large are the sigmas, and do they hold?

    python studies/look_sigmas.py [--seeds 10] [--first-seed 55200] [--receivers RTK "1.5 m"] [-v]

Realistic drives of ten minutes (studies/vehicle.py) without an offset, the antenna at the IMU; seeds take the receivers
in turn. Of each the estimate of `configuration/offset.py` from the 60, 120 and 240 s that end after 240, 420 and 590 s.
Told where a sigma is below 0.3 s or 0.9 m. The looks of a drive share samples and turns: the 95 % interval of the
share within two sigma is that of drives drawn anew. -v: each estimate.
"""
from __future__ import annotations

import argparse
from collections import defaultdict

import numpy as np
from vehicle import FIXES, simulated

from mems_ins_fusion.configuration.mounting import estimate_mounting

SECOND = 10**9  # ns
LENGTHS, ENDS = (60, 120, 240), (240, 420, 590)  # s
LARGEST = {'offset': 0.3, 'forward': 0.9, 'left': 0.9, 'up': 0.9}  # s, m
DRAWS = 2000  # times that drives are drawn anew for an interval


def looks(seed: int, receiver: str):
    """Length and end, s, and values with sigmas (4, 2) by name, of each look that finds something."""
    recording = simulated(seed, 10.0, FIXES[receiver])
    begin = int(recording.imu.stamp[0])
    for length in LENGTHS:
        for end in ENDS:
            first, last = begin + (end - length) * SECOND, begin + end * SECOND
            found = estimate_mounting(*(samples.select((samples.stamp > first) & (samples.stamp <= last))
                                        for samples in (recording.imu, recording.gnss)))
            if found is not None and found.offset is not None:
                one = found.offset
                yield length, end, [(one.lag, one.lag_sigma), *zip(one.arm.tolist(), one.arm_sigma.tolist())]


def interval(within: np.ndarray, drive: np.ndarray) -> tuple[float, float]:
    """95 % interval of the mean of `within` (n,), by drawing drives anew. drive: (n,) of which drive each is."""
    drives, place = np.unique(drive, return_inverse=True)
    counts = np.array([np.bincount(place, within), np.bincount(place)])
    drawn = counts[:, np.random.default_rng(0).integers(len(drives), size=(DRAWS, len(drives)))].sum(axis=2)
    return tuple(np.percentile(drawn[0] / drawn[1], [2.5, 97.5]).tolist())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--first-seed', type=int, default=55200)
    parser.add_argument('--receivers', nargs='+', choices=FIXES, default=['RTK', '1.5 m'])
    parser.add_argument('-v', action='store_true')
    options = parser.parse_args()
    seen = defaultdict(list)
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        receiver = options.receivers[seed % len(options.receivers)]
        for length, end, values in looks(seed, receiver):
            seen[receiver].append([(seed, *one) for one in values])
            if options.v:
                print(f'{seed} {receiver} {length} s to {end} s: ' + ', '.join(
                    f'{name} {value:.3f} +- {sigma:.3f}' for name, (value, sigma) in zip(LARGEST, values)), flush=True)
    print(f'| receiver | | known | within two sigma | RMS of error over sigma | median sigma |\n|{"---|" * 6}')
    for receiver, values in seen.items():
        for k, (name, largest) in enumerate(LARGEST.items()):
            drive, error, sigma = np.array(values)[:, k].T
            known = sigma < largest
            score = error[known] / sigma[known]
            if not len(score):
                continue
            within = np.abs(score) < 2.0
            low, high = interval(within, drive[known])
            rms = np.sqrt(np.mean(score**2))
            print(f'| {receiver} | {name} | {known.sum()} of {len(known)} | {within.sum()} of {known.sum()}, '
                  f'{100 * within.mean():.1f} % ({100 * low:.0f} to {100 * high:.0f}) | {rms:.2f} | '
                  f'{np.median(sigma):.3f} |')


if __name__ == '__main__':
    main()
