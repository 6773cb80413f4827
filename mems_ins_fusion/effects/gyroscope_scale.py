"""Gyroscope scale factor error, Eq. 10 of the paper."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter


class GyroscopeScale(Effect):
    """measured = (1 + S) true, S = z on the vertical axis of the body."""

    name = 'gyroscope_scale'
    parameters = (EffectParameter('z', '-', 0.02),)

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        return specific_force, angular_rate * np.array([1.0, 1.0, 1 + values['z']])
