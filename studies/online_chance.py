"""What the diagnosis while driving applies where there is nothing to be found: chance, and faults.

    python studies/online_chance.py [--hours 10] [--minutes 60] [--processes 1] [--find] [--share 0.1]
                                    [--receivers "1.5 m" RTK]

Realistic drives (studies/vehicle.py) with the receivers 1.5 m, RTK, city, smoothing in turn, every second one with a
fault of studies/faults.py each five minutes. Each minute the look without a filter, as always; in the place of the
analyses, at the times of these, findings that are wrong: a time offset, an antenna's arm, a scale of the gyroscope of
z, a mounting, each of a size that an analysis would find. So a drive has many times as many trials as one in
which `diagnose` finds nothing, and an hour takes minutes. --find: the analyses of `diagnose`, which take an hour for
some hours. --share: diagnosis.share; with 1 the result of an analysis counts a minute after its begin, so that an hour
has as many analyses as it can have. For each drive: findings on trial, which of them were wrong ones that came to FINE,
all that was applied. The mounting of realistic drives is some degrees off, which is there to be found.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from faults import FAULTS
from vehicle import FIXES, simulated

from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.findings import Finding
from mems_ins_fusion.diagnosis.held_out import HeldOut
from mems_ins_fusion.diagnosis.quantity import FINE
from mems_ins_fusion.diagnosis.watch import Watch
from mems_ins_fusion.effects.registry import effect_called
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording

#: effect, parameter, and sizes that an analysis would find
WRONG = (('gnss_time_offset', 'time_offset', (0.05, 0.3)), ('gnss_lever_arm', 'x', (0.5, 2.0)),
         ('gyroscope_scale', 'z', (0.005, 0.03)), ('mounting_rotation', 'yaw', (0.03, 0.1)))
#: s from one fault to the next
APART = 300.0


def wrong_findings(rng: np.random.Generator) -> Callable:
    """Analyses that find two effects of WRONG each time, of random sizes."""
    def find(recording: Recording, values: dict) -> list[Finding]:
        found = []
        for k in rng.choice(len(WRONG), 2, replace=False):
            name, parameter, (least, most) = WRONG[k]
            effect, size = effect_called(name), float(rng.choice((-1.0, 1.0)) * rng.uniform(least, most))
            sizes = {one.name: size if one.name == parameter else 0.0 for one in effect.traced}
            changes = {n: v for n, v in effect.adjusted(values, sizes).items() if v != values.get(n)}
            found.append(Finding(name, [name], {parameter: Estimate(size, 0.2 * abs(size), '')}, 0.0, 0.0, True,
                                 HeldOut(0.0, 1.0, []), changes=changes))
        return found
    return find


def with_faults(recording: Recording, seed: int) -> tuple[Recording, list[str]]:
    """A fault of those that need no further parameters each APART s, in random order."""
    rng, names = np.random.default_rng(seed), []
    faults = [fault for fault in FAULTS if not fault.values]
    begin, end = (recording.imu.stamp[k] for k in (0, -1))
    for at in np.arange(APART, (end - begin) * 1e-9 - APART, APART):
        fault = faults[rng.integers(len(faults))]
        inside = [(samples.stamp >= begin + at * 1e9) & (samples.stamp < begin + (at + fault.duration) * 1e9)
                  for samples in (recording.imu, recording.gnss)]
        recording = fault.alter(recording, *inside, rng)
        names.append(fault.name)
    return recording, names


def of_drive(seed: int, minutes: float, find: bool, receivers: list[str], share: float
             ) -> tuple[str, list, list, int, list]:
    """What the drive is, what was FINE, what was applied, how many findings were on trial, and the faults."""
    receiver = receivers[seed % len(receivers)]
    values = table.check({'diagnosis.online': 'apply', 'diagnosis.share': share})
    recording = replace(simulated(seed, minutes, FIXES[receiver]), reference=None, speed=None, velocity=None,
                        heading=None)
    faulty = seed // len(receivers) % 2 == 1
    recording, names = with_faults(recording, seed) if faulty else (recording, [])
    watch = Watch(recording, values, find=None if find else wrong_findings(np.random.default_rng(seed)))
    while watch.take() is not None:
        pass
    begin = int(recording.imu.stamp[0])
    said = [(round((q.time - begin) * 1e-9), q.name, q.text.split(';')[0]) for q in watch.said if q.state == FINE]
    applied = [(round((q.time - begin) * 1e-9), q.name, q.text) for q in watch.said if q.applied]
    return f'{receiver}{", faults" if faulty else ""}', said, applied, watch.trials, names


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--hours', type=float, default=10.0)
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--first-seed', type=int, default=7000)
    parser.add_argument('--processes', type=int, default=1)
    parser.add_argument('--find', action='store_true')
    parser.add_argument('--share', type=float, default=0.1)
    parser.add_argument('--receivers', nargs='+', choices=FIXES, default=list(FIXES))
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + round(options.hours * 60.0 / options.minutes))
    hours = trials = 0.0
    print('| seed | drive | on trial | FINE | applied |\n|---|---|---|---|---|', flush=True)
    with ProcessPoolExecutor(options.processes) as pool:
        rest = options.minutes, options.find, options.receivers, options.share
        rows = pool.map(of_drive, seeds, *zip(*[rest] * len(seeds)))
        for seed, (drive, said, applied, count, names) in zip(seeds, rows):
            hours, trials = hours + options.minutes / 60.0, trials + count
            print(f"| {seed} | {drive} | {count} | {said or 'none'} | {applied or 'none'} |", flush=True)
            print(f'{hours:.1f} h, {trials:.0f} trials', names, flush=True)


if __name__ == '__main__':
    main()
