"""Accelerometer scale factor error, Eq. 9 of the paper."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter


class AccelerometerScale(Effect):
    """measured = (1 + S) true, S = x on the forward axis of the body and y on the lateral one."""

    name = 'accelerometer_scale'
    parameters = (EffectParameter('x', '-', 0.02), EffectParameter('y', '-', 0.02))

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        return specific_force * np.array([1 + values['x'], 1 + values['y'], 1.0]), angular_rate
