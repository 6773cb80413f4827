"""Gyroscope warm-up: after switch-on the bias drifts to its final value, and no temperature is measured."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.parameters.parameter import Parameter


class GyroscopeWarmUp(Effect):
    """The vertical gyroscope reads z exp(-t / tau) too much, body axes; t since the first sample."""

    name = 'gyroscope_warm_up'
    signature = ('a drift of the estimated bias of the vertical gyroscope, fast at first, slow later; any slow error '
                 'of the gyroscope looks the same')
    in_words = 'the vertical gyroscope drifts in the first minutes, as one that warms up'
    to_check = 'whether a recording that begins some minutes after the IMU was switched on has it, too'
    looks_the_same = 'a heading or biases that the filter had to find first look the same'
    parameters = (EffectParameter('z', 'rad/s', 2e-3), EffectParameter('tau', 's', 300.0, default=300.0))
    tried = ({'tau': 60.0}, {'tau': 300.0}, {'tau': 1200.0})
    refined = ('tau',)
    settings = (
        Parameter('gyroscope.warm_up', 0.0, 'rad/s', 'Bias of w_z (body axes) at the first sample, which decays as the '
                  'sensor warms up.', minimum=-0.5, maximum=0.5),
        Parameter('gyroscope.warm_up_time', 300.0, 's', 'Time constant of gyroscope.warm_up.', positive=True,
                  maximum=1e5))

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        bias = values['z'] * np.exp(-(drive.time - drive.time[0]) / values['tau'])
        return specific_force, angular_rate + bias[:, None] * [0.0, 0.0, 1.0]

    def adjusted(self, values, theta):
        return {**values, 'gyroscope.warm_up': values['gyroscope.warm_up'] + theta['z'],
                'gyroscope.warm_up_time': theta['tau']}

    def corrector(self, values, rotation):
        if values['gyroscope.warm_up'] == 0:
            return None
        bias, rate = rotation.T @ [0.0, 0.0, values['gyroscope.warm_up']], -1e-9 / values['gyroscope.warm_up_time']
        first = []  # the stamp of the first sample, once it has come

        def correct(stamp, f, w, celsius):
            if not first and len(stamp):
                first.append(stamp[0])
            return f, w - bias * np.exp(rate * (stamp - first[0]))[:, None] if first else w

        return correct
