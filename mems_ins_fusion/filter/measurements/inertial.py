"""A further IMU (`NAME.type: imu`). It is not a measurement of the filter: `runs/imus.py` merges its samples with those
of `imu_topic`. It has a name and is read, written and simulated like a measurement."""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...navigation.earth import STANDARD_GRAVITY
from ...navigation.frames import FLU_TO_FRD, mounting, rotation_from_rpy
from ...parameters.parameter import Parameter
from ...samples import ImuSamples
from .base import IMU, NOT_THERE, Measurement

#: SI units per unit, for each choice of `imu.acceleration_unit` and `imu.rate_unit`
ACCELERATION = {'m/s^2': 1.0, 'g': STANDARD_GRAVITY, 'mg': 1e-3 * STANDARD_GRAVITY}
RATE = {'rad/s': 1.0, 'deg/s': math.pi / 180.0}


@dataclass(frozen=True)
class InertialSettings:
    """to_first: rotation (3, 3) from its sensor axes to those of the first IMU. arm: (3,) m from the first IMU,
    base_link (forward-left-up). time_offset: s. force_unit, rate_unit: SI units per unit of its messages."""

    name: str
    topic: str
    time_offset: float
    to_first: np.ndarray
    arm: tuple[float, float, float]
    force_unit: float
    rate_unit: float


class Inertial(Measurement):
    """`NAME.type: imu`."""

    kind, name, samples, unit, default_sigma = -1, 'imu', ImuSamples, 'm/s^2', 0.0
    topic_text = 'Topic of a further IMU: sensor_msgs/Imu'
    messages = {IMU: ('angular_velocity', 'linear_acceleration')}
    written_to = '/imu_2/data'
    has_arm = True
    mounting_rpy = (0.0, 0.0, 0.0)  # of a named input
    #: Hz; consumer grade: white noise (m/s^2/sqrt(Hz), rad/s/sqrt(Hz)) and turn-on biases (m/s^2, rad/s)
    simulated_with = {'imu_rate': 100.0, 'imu_force_noise': 0.002, 'imu_turn_noise': 1e-4, 'imu_force_bias': 0.1,
                      'imu_turn_bias': 0.005}

    def parameters(self):
        return (
            Parameter(f'{self.name}.mounting_rpy', [0.0, 0.0, 0.0], 'rad', 'Roll, pitch, yaw of the rotation from its '
                      'sensor axes to base_link (forward-left-up).', lengths=(3,), minimum=-2 * math.pi,
                      maximum=2 * math.pi),
            Parameter(f'{self.name}.time_offset', 0.0, 's', f'By which the stamps on {self.topic} are late against '
                      'those of the first IMU.', minimum=-10.0, maximum=10.0),
            Parameter(f'{self.name}.acceleration_unit', 'm/s^2', 'text', 'Unit of its linear_acceleration.',
                      choices=tuple(ACCELERATION)),
            Parameter(f'{self.name}.rate_unit', 'rad/s', 'text', 'Unit of its angular_velocity.', choices=tuple(RATE)))

    def settings(self, values):
        own = {key: values[f'{self.name}.{key}'] for key in ('topic', 'time_offset', 'mounting_rpy', 'lever_arm',
                                                             'acceleration_unit', 'rate_unit')}
        return InertialSettings(
            self.name, own['topic'], own['time_offset'],
            mounting(values['imu.mounting_rpy']).T @ mounting(own['mounting_rpy']), tuple(own['lever_arm']),
            ACCELERATION[own['acceleration_unit']], RATE[own['rate_unit']])

    def read(self, fields, message):
        return ImuSamples(fields['stamp'], fields['received'], fields['linear_acceleration'],
                          fields['angular_velocity'])

    def written(self, samples):
        return {'orientation_covariance': np.array(NOT_THERE), 'linear_acceleration': samples.specific_force,
                'angular_velocity': samples.angular_rate}

    def simulated(self, drive, errors, effects, rng, instants):
        """As `Measurement.simulated`, at the IMU's lever arm, in its axes and with its errors. Only effects on stamps
        are applied."""
        time, stamp = instants(errors['imu_rate'], 0.0031)
        rate, to_sensor = drive.angular_rate, FLU_TO_FRD @ rotation_from_rpy(*self.mounting_rpy)
        force = drive.specific_force + np.cross(rate, np.cross(rate, self.arm)) + np.cross(
            np.gradient(rate, 1.0 / drive.rate, axis=0), self.arm)
        parts = []
        for true, sensor in ((force, 'force'), (rate, 'turn')):
            at = np.column_stack([np.interp(time, drive.time, column) for column in true.T]) @ to_sensor
            white = errors[f'imu_{sensor}_noise'] * math.sqrt(errors['imu_rate']) * rng.standard_normal(at.shape)
            parts.append(at + white + errors[f'imu_{sensor}_bias'] * rng.standard_normal(3))
        return ImuSamples(stamp, stamp.copy(), *parts)
