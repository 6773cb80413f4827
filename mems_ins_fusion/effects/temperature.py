"""Temperature-dependent bias: the sensors warm up after they are switched on, and the cabin cools and heats."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter

REFERENCE = 25.0  # degrees Celsius at which the effect is zero


class Temperature(Effect):
    """Biases of f_x, f_y and w_z, body axes, that grow with the temperature above 25 degrees Celsius."""

    name = 'temperature'
    parameters = (EffectParameter('accelerometer_x', 'm/s^2/K', 5e-3),
                  EffectParameter('accelerometer_y', 'm/s^2/K', 5e-3),
                  EffectParameter('gyroscope_z', 'rad/s/K', 1e-4))

    def temperature(self, drive, values, rng):
        """Warms up by 20 K within minutes from 20 degrees; then heating and windows, slow and of random phase."""
        phase = rng.uniform(0, 2 * np.pi, 2)
        slow = sum(np.sin(2 * np.pi * drive.time / period + p) - np.sin(p) for period, p in zip((310.0, 970.0), phase))
        return 20.0 - 20.0 * np.expm1(-drive.time / 400.0) + 1.5 * slow

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        warmth = self.temperature(drive, values, rng) - REFERENCE
        specific_force, angular_rate = specific_force.copy(), angular_rate.copy()
        specific_force[:, 0] += values['accelerometer_x'] * warmth
        specific_force[:, 1] += values['accelerometer_y'] * warmth
        angular_rate[:, 2] += values['gyroscope_z'] * warmth
        return specific_force, angular_rate
