"""Gyroscope scale factor error, Eq. 10 of the paper."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter, with_added
from mems_ins_fusion.navigation.frames import mounting


class GyroscopeScale(Effect):
    """measured = (1 + S) true, S = z on the vertical axis of the body."""

    name = 'gyroscope_scale'
    signature = 'across-track innovations after each bend, of the sign of the bend'
    in_words = 'the gyroscopes measure too much or too little'
    to_check = 'the range setting and unit conversion of the gyroscopes'
    sizes = {'z': ('in bends {} too much', 'in bends {} too little')}
    largest = {'z': 0.15}
    larger_is = 'a wrong unit or range setting, an IMU that is turned, slopes, or positions that the receiver smooths'
    parameters = (EffectParameter('z', '-', 0.02),)

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        return specific_force, angular_rate * np.array([1.0, 1.0, 1 + values['z']])

    def adjusted(self, values, theta):
        along = np.abs(mounting(values['imu.mounting_rpy'])).argmax(axis=1)
        return with_added(values, 'gyroscope.scale', int(along[2]), change=theta['z'])
