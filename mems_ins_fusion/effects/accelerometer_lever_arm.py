"""Accelerometer lever arm: the accelerometers are not at the point that the track describes."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter


class AccelerometerLeverArm(Effect):
    """The accelerometers stand at (x, y, z) from the IMU's reference point, base_link (forward-left-up)."""

    name = 'accelerometer_lever_arm'
    parameters = tuple(EffectParameter(axis, 'm', 0.5) for axis in 'xyz')

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        arm = np.array([values['x'], -values['y'], -values['z']])  # body, forward-right-down
        rate = drive.angular_rate
        centripetal = np.cross(rate, np.cross(rate, arm))
        tangential = np.cross(np.gradient(rate, 1 / drive.rate, axis=0), arm)
        return specific_force + centripetal + tangential, angular_rate
