"""Gyroscope g-sensitivity: specific force shows as angular rate."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.parameters.parameter import Parameter


class GSensitivity(Effect):
    """The vertical gyroscope reads x f_x + y f_y too much, body axes."""

    name = 'g_sensitivity'
    signature = ('across-track innovations after changes of speed (x) and in bends (y); in bends a gyroscope scale '
                 'factor error looks the same')
    in_words = 'the gyroscopes react to acceleration'
    to_check = 'the data sheet of the gyroscopes; vibration at the mount'
    largest = {'x': 0.01, 'y': 0.01}
    larger_is = 'an IMU that is turned, or gyroscopes that are not at right angles to the accelerometers'
    parameters = tuple(EffectParameter(axis, '(rad/s)/(m/s^2)', 5e-4, adds_to=('gyroscope.g_sensitivity', i))
                       for i, axis in enumerate('xy'))
    settings = (Parameter('gyroscope.g_sensitivity', [0.0, 0.0], '(rad/s)/(m/s^2)', 'What f_x and f_y (body axes) add '
                          'to the vertical angular rate.', lengths=(2,), minimum=-0.1, maximum=0.1),)

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        angular_rate = angular_rate.copy()
        angular_rate[:, 2] += values['x'] * specific_force[:, 0] + values['y'] * specific_force[:, 1]
        return specific_force, angular_rate

    def conditioning(self, values):
        x, y = values['gyroscope.g_sensitivity']
        if x == 0 and y == 0:
            return None
        matrix = np.eye(6)
        matrix[5, :2] = -x, -y
        return matrix
