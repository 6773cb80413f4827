"""Gyroscope g-sensitivity: specific force shows as angular rate."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter


class GSensitivity(Effect):
    """The vertical gyroscope reads x f_x + y f_y too much, body axes."""

    name = 'g_sensitivity'
    parameters = (EffectParameter('x', '(rad/s)/(m/s^2)', 5e-4), EffectParameter('y', '(rad/s)/(m/s^2)', 5e-4))

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        angular_rate = angular_rate.copy()
        angular_rate[:, 2] += values['x'] * specific_force[:, 0] + values['y'] * specific_force[:, 1]
        return specific_force, angular_rate
