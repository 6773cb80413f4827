"""Temperature-dependent bias: the sensors warm up after they are switched on, and the cabin cools and heats."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.parameters.parameter import Parameter

REFERENCE = 25.0  # degrees Celsius at which the effect is zero


class Temperature(Effect):
    """Biases of f_x, f_y and w_z, body axes, that grow with the temperature above 25 degrees Celsius."""

    name = 'temperature'
    signature = ('a drift of the estimated sensor errors with the temperature; slow sensor errors of other '
                 'origin look the same')
    in_words = 'the bias follows the temperature'
    to_check = 'the place of the IMU (sun, engine), and its warm-up time'
    parameters = (
        EffectParameter('accelerometer_x', 'm/s^2/K', 5e-3, adds_to=('accelerometer.temperature_coefficient', 0)),
        EffectParameter('accelerometer_y', 'm/s^2/K', 5e-3, adds_to=('accelerometer.temperature_coefficient', 1)),
        EffectParameter('gyroscope_z', 'rad/s/K', 1e-4, adds_to=('gyroscope.temperature_coefficient',)))
    settings = (
        Parameter('accelerometer.temperature_coefficient', [0.0, 0.0], 'm/s^2/K', 'Growth of the biases of f_x and f_y '
                  '(body axes) with temperature.', lengths=(2,), minimum=-1.0, maximum=1.0),
        Parameter('gyroscope.temperature_coefficient', 0.0, 'rad/s/K', 'Growth of the bias of w_z (body axes) with '
                  'temperature.', minimum=-0.1, maximum=0.1),
        Parameter('imu.reference_temperature', REFERENCE, 'degC', 'Temperature at which these biases are zero.',
                  minimum=-60.0, maximum=150.0))

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

    def hidden(self, values, recording):
        if recording.imu.temperature is None:
            return 'no temperature in the recording (temperature_topic)'
        return ''

    def corrector(self, values, rotation):
        x, y = values['accelerometer.temperature_coefficient']
        z = values['gyroscope.temperature_coefficient']
        if x == y == z == 0:
            return None
        f_gain, w_gain = rotation.T @ [x, y, 0.0], rotation.T @ [0.0, 0.0, z]
        reference = values['imu.reference_temperature']

        def correct(stamp, f, w, celsius):
            warmth = np.where(np.isnan(celsius), 0.0, celsius - reference)[:, None]
            return f - f_gain * warmth, w - w_gain * warmth

        return correct
