"""Accelerometer lever arm: the accelerometers are not at the point that the track describes."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter, added
from mems_ins_fusion.navigation.frames import FLU_TO_FRD
from mems_ins_fusion.parameters import Parameter

LONGEST_STEP = 0.5  # s between samples over which an angular acceleration means something


class AccelerometerLeverArm(Effect):
    """The accelerometers stand at (x, y, z) from the IMU's reference point, base_link (forward-left-up)."""

    name = 'accelerometer_lever_arm'
    signature = ('the same as a lever arm of the antenna, with the opposite sign')
    parameters = tuple(EffectParameter(axis, 'm', 0.5) for axis in 'xyz')
    settings = (Parameter('imu.lever_arm', [0.0, 0.0, 0.0], 'm', 'From the point that the track describes to the '
                          'accelerometers, base_link (forward-left-up).', lengths=(3,), minimum=-20.0, maximum=20.0),)

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        arm = np.array([values['x'], -values['y'], -values['z']])  # body, forward-right-down
        rate = drive.angular_rate
        centripetal = np.cross(rate, np.cross(rate, arm))
        tangential = np.cross(np.gradient(rate, 1 / drive.rate, axis=0), arm)
        return specific_force + centripetal + tangential, angular_rate

    def adjusted(self, values, theta):
        for index, axis in enumerate('xyz'):
            values = added(values, 'imu.lever_arm', index, theta[axis])
        return values

    def corrector(self, values, rotation):
        if not any(values['imu.lever_arm']):
            return None
        arm = rotation.T @ (FLU_TO_FRD @ np.array(values['imu.lever_arm']))
        last_stamp, last_rate = np.zeros(1, dtype=np.int64), np.zeros((1, 3))

        def correct(stamp, f, w, celsius):
            dt = np.diff(np.concatenate([last_stamp, stamp])) * 1e-9
            change = np.diff(np.concatenate([last_rate, w]), axis=0)
            usable = (dt > 0) & (dt < LONGEST_STEP)
            acceleration = np.where(usable, 1.0, 0.0)[:, None] * change / np.where(usable, dt, 1.0)[:, None]
            last_stamp[:], last_rate[:] = stamp[-1], w[-1]
            return f - _cross(w, _cross(w, arm)) - _cross(acceleration, arm), w

        return correct


def _cross(a, b):
    """Cross product written out: the same bits for one sample and for many."""
    b = np.broadcast_to(b, a.shape)
    return np.stack([a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1], a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
                     a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], axis=1)
