"""Repeated IMU samples: the messages come faster than the sensor measures, or the driver read too early."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter, Sighting
from mems_ins_fusion.sensor_errors.models import per_axis

SMALLEST = 0.01  # smallest share of repeated samples that is reported


class ImuRepeats(Effect):
    """A `share` of the samples repeats the one before it to the last digit."""

    name = 'imu_repeats'
    signature = 'no clear one: the sensors are noisier than characterized'
    in_words = 'IMU samples come twice'
    to_check = 'the rate of the IMU\'s driver and that at which the sensor measures'
    parameters = (EffectParameter('share', '-', 0.2),)
    traced = ()

    def distort_samples(self, imu, values, rng):
        own = rng.uniform(size=len(imu)) >= values['share']
        source = np.maximum.accumulate(np.where(own, np.arange(len(imu)), 0))
        return replace(imu, specific_force=imu.specific_force[source], angular_rate=imu.angular_rate[source])

    def seen(self, values, recording):
        imu = recording.imu
        both = np.hstack([imu.specific_force, imu.angular_rate])
        same = (both[1:] == both[:-1]).all(axis=1)
        share = float(same.mean()) if len(same) else 0.0
        if not SMALLEST < share < 1:
            return None
        seconds = (imu.stamp[-1] - imu.stamp[0]) * 1e-9
        return Sighting({'share': (share, float(np.sqrt(share * (1 - share) / len(same))))},
                        f'{100 * share:.2g} % of the IMU samples repeat the one before to the last digit: about '
                        f'{(1 - share) * len(same) / seconds:.3g} a second are new. Set the driver to the rate at '
                        'which the sensor measures', wider_noise(values, imu, share))


def wider_noise(values: dict, imu, share: float) -> dict:
    """Noise densities with the white noise added that repeated samples cause. share: share of samples repeated.

    A repeated sample misses the change of one interval T. This is white noise with a density squared of share times T
    times the mean square change, which is mostly vibration.
    """
    interval = (imu.stamp[-1] - imu.stamp[0]) * 1e-9 / (len(imu) - 1)
    raised = {}
    for sensor, samples in (('accelerometer', imu.specific_force), ('gyroscope', imu.angular_rate)):
        change = np.diff(samples, axis=0)
        change = change[(change != 0).any(axis=1)]
        density = np.sqrt(share * interval * np.mean(change**2, axis=0))
        raised[f'{sensor}.noise_density'] = np.hypot(per_axis(values, f'{sensor}.noise_density'), density).tolist()
    return raised
