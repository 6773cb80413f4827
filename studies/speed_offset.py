"""How well `configuration.speed_offset` finds how late a wheel speed is: realistic simulated drives.

    python studies/speed_offset.py [DRIVES]

Roads with grades, suspension, vibration, an IMU two metres in front of the axle and turned by what `configure`
leaves of its mounting (2 deg); wheels with a scale of 1 % and 0.05 m/s of noise, offsets of -0.4 to 0.6 s. What is
printed stands in docs/configure.md, "Wheel speed".
"""
from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from mems_ins_fusion.configuration.speed_offset import SHOWN, estimate_speed_offset
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Speeds
from mems_ins_fusion.simulation.scene import SCENES
from mems_ins_fusion.simulation.simulation import Aiding, SensorErrors, simulate_recording

#: s, of a drive
DURATION = 300.0
#: rad: by which the mounting that is given is wrong
MOUNTING = np.radians([2.0, -2.0, 2.0])


def quantized(speeds: Speeds, step: float) -> Speeds:
    """As a bus delivers them: in steps, and nothing below two of them."""
    rounded = np.round(speeds.speed / step) * step
    return replace(speeds, speed=np.where(np.abs(rounded) < 2.0 * step, 0.0, rounded))


def main(drives: int) -> None:
    scene = replace(SCENES['realistic'], axle_to_imu=(2.0, 0.3, 0.5), mounting_error=0.0,
                    aiding=Aiding(speed_rate=10.0))
    values = {**table.defaults(), **scene.imu}
    found = []
    for seed in range(drives):
        offset = np.random.default_rng(seed).uniform(-0.4, 0.6)
        drive = scene.drive(DURATION, seed, 100.0)
        distortions = scene.distortions(seed)
        recording = simulate_recording(drive, SensorErrors.from_parameters(values, 'gauss_markov'), None,
                                       distortions.pop('effects'), seed=seed, **distortions).recording
        late = replace(recording.speed, stamp=recording.speed.stamp + round(offset * 1e9))
        seen = estimate_speed_offset(recording.imu, quantized(late, 0.1 if seed % 2 else 0.01),
                                     rotation_from_rpy(*MOUNTING))
        if seen is None:
            print(f'drive {seed}: not shown')
            continue
        print(f'drive {seed}: {offset:.3f} s, found {seen.lag:.3f} +- {seen.lag_sigma:.3f} s')
        found.append((seen.lag - offset, seen.lag_sigma, seen.lag_sigma < SHOWN))
    error, sigma, shown = (np.array(column) for column in zip(*found))
    print(f'{len(found)} of {drives} drives, {shown.sum()} with sigma below 0.1 s')
    error, sigma = error[shown], sigma[shown]
    score = np.sqrt(((error / sigma)**2).mean())
    rms = np.sqrt((error**2).mean())
    print(f'error: mean {error.mean():.3f} s, RMS {rms:.3f} s, at most {np.abs(error).max():.3f} s; '
          f'sigma: median {np.median(sigma):.3f} s; RMS of error over sigma {score:.2f}')
    print(f'within 0.05 s: {(np.abs(error) < 0.05).mean():.0%}; '
          f'within 2 sigma: {(np.abs(error) < 2 * sigma).mean():.0%}')


if __name__ == '__main__':
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
