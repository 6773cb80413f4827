"""What the filter makes of receivers and IMUs that are not as it thinks, with and without what it learns of itself.

    python studies/covariance.py [--seeds 2] [--minutes 20] [--processes 2] [--output FILE.md]

The realistic drives and the table of studies/vehicle.py, setting *car*: as it is, and with `gnss.adapt_covariance` and
`vehicle.learn_drift` off.
"""
from __future__ import annotations

from dataclasses import replace

import over_drives
from vehicle import FIXES, SETTINGS, drive_of, header, judge, pooled, row, simulated

from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

#: three and four times what the defaults say
BAD_IMU = {'gyroscope.gauss_markov.sigma': [0.003], 'accelerometer.gauss_markov.sigma': [0.2]}
#: hardly any noise, and an error that lasts for a minute
WANDERING = GnssNoise(0.3, rate=5.0, coloured_sigma=1.5, coloured_tau=60.0)
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
    found['wandering'] = simulated(seed, minutes, WANDERING, drive)
    for name, claimed in (('1.5 m', 0.15), ('1.5 m', 5.0), ('city', 1.5)):
        gnss = found[name].gnss
        found[f'{name}, claims {claimed:g}'] = replace(found[name], gnss=replace(
            gnss, covariance=claimed**2 / gnss.covariance[0, 0, 0] * gnss.covariance))
    return found


def of_drive(seed: int, minutes: float):
    """((receiver, setting), result) of one drive."""
    return [((name, setting), judge(recording, {**SETTINGS['car'], **given}))
            for name, recording in variants(seed, minutes).items() for setting, given in LEARNING.items()]


def lines(results: dict, drives: int):
    """The table of studies/vehicle.py."""
    yield header()
    for key, found in results.items():
        yield row(f'{drives} simulated', *key, pooled(found))


if __name__ == '__main__':
    over_drives.main(__doc__, of_drive, lines, seeds=2)
