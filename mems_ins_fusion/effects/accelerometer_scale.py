"""Accelerometer scale factor error, Eq. 9 of the paper."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter, with_added
from mems_ins_fusion.navigation.frames import mounting


class AccelerometerScale(Effect):
    """measured = (1 + S) true, S = x on the forward axis of the body and y on the lateral one."""

    name = 'accelerometer_scale'
    signature = ('along-track innovations after each change of speed, of its sign; across in bends; a body '
                 'that pitches and rolls with the acceleration looks the same to f_x and f_y')
    in_words = 'the accelerometers measure too much or too little'
    to_check = 'the range setting and unit conversion of the accelerometers'
    looks_the_same = 'a body that leans on its springs, or an IMU that is not level, looks nearly the same'
    sizes = {'x': ('forward {} too much', 'forward {} too little'),
             'y': ('sideways {} too much', 'sideways {} too little')}
    largest = {'x': 0.15, 'y': 0.15}
    larger_is = 'a wrong unit or range setting, an IMU that is turned, slopes, or positions that the receiver smooths'
    parameters = (EffectParameter('x', '-', 0.02), EffectParameter('y', '-', 0.02))

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        return specific_force * np.array([1 + values['x'], 1 + values['y'], 1.0]), angular_rate

    def adjusted(self, values, theta):
        along = np.abs(mounting(values['imu.mounting_rpy'])).argmax(axis=1)
        for body_axis, axis in enumerate('xy'):
            values = with_added(values, 'accelerometer.scale', int(along[body_axis]), change=theta[axis])
        return values
