"""What the filter makes of receivers and IMUs that are not as it thinks, with and without what it learns of itself.

    python studies/covariance.py [--seeds 2] [--minutes 20] [--output FILE.md]

The realistic drives and the table of studies/vehicle.py, setting *car*: as it is, and with `gnss.adapt_covariance` and
`vehicle.learn_drift` off.
"""
from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

from vehicle import FIXES, SETTINGS, drive_of, header, judge, pooled, row, simulated

from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import SensorErrors, simulate_recording

#: three and four times what the defaults say
BAD_IMU = {'gyroscope.gauss_markov.sigma': [0.003], 'accelerometer.gauss_markov.sigma': [0.2]}
EARLY = 0.25  # s, by which the stamps of a late receiver are: of its fixes and of what they are compared with
LEARNING = {'learns nothing': {'gnss.adapt_covariance': False, 'vehicle.learn_drift': False}, 'car': {}}


def variants(seed: int, minutes: float) -> dict[str, Recording]:
    """One drive as different receivers and IMUs record it."""
    drive = drive_of(seed, minutes)
    found = {name: simulated(seed, minutes, fixes, drive) for name, fixes in FIXES.items()}
    for name in ('RTK', '1.5 m'):
        recording = found[name]
        found[f'{name}, stamps early'] = replace(recording, **{
            stream: replace(samples, stamp=samples.stamp - round(EARLY * 1e9))
            for stream, samples in (('gnss', recording.gnss), ('reference', recording.reference))})
        bad = SensorErrors.from_parameters(table.check({**REALISTIC.imu, **BAD_IMU}), 'gauss_markov')
        recording = simulate_recording(drive, bad, FIXES[name], seed=seed, name=f'bad IMU {seed}',
                                       **REALISTIC.distortions(seed)).recording
        found[f'{name}, bad IMU'] = replace(recording, reference=recording.reference.select(slice(None, None, 10)))
    gnss = found['1.5 m'].gnss
    found['1.5 m, claims 0.15'] = replace(found['1.5 m'], gnss=replace(gnss, covariance=0.01 * gnss.covariance))
    return found


def of_seed(seed: int, minutes: float):
    """((receiver, setting), result) of one drive."""
    return [((name, setting), judge(recording, {**SETTINGS['car'], **given}))
            for name, recording in variants(seed, minutes).items() for setting, given in LEARNING.items()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=2)
    parser.add_argument('--first-seed', type=int, default=1000)
    parser.add_argument('--minutes', type=float, default=20.0)
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    results: dict = {}
    with ProcessPoolExecutor(2) as pool:
        for drive in pool.map(of_seed, seeds, [options.minutes] * len(seeds)):
            for key, result in drive:
                results.setdefault(key, []).append(result)
    lines = [header(), *(row(f'{len(seeds)} simulated', *key, pooled(found)) for key, found in results.items())]
    print('\n'.join(lines))
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
