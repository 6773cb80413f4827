"""Tilt in motion: on hills, and on its suspension, the body pitches and rolls, and gravity leaks into f_x and f_y.

Two causes are distinguished. The tilt by the suspension is proportional to f_x and f_y themselves, and two parameters
correct it. The tilt of the road can only be found with the other sensors of the IMU, in the attitude of a strapdown
run: the correction is then the strapdown mechanization, and needs no parameter.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.navigation.frames import mounting
from mems_ins_fusion.parameters.parameter import Parameter

SUSPENSION = ('pitch_per_acceleration', 'roll_per_acceleration')


class Tilt(Effect):
    """Nose up by pitch_per_acceleration when speeding up, leaning outwards by roll_per_acceleration in a bend.

    In the diagnosis there is also `compensation`: the factor on the gravity leakage, computed from the attitude of a
    strapdown run of the diagnosis, that best explains the innovations of the planar filter. It is 1 if the attitude
    explains them.
    """

    name = 'tilt'
    signature = ('along-track innovations on slopes, across-track ones on banked roads, up to g times the angle; where '
                 'only the suspension tilts, scale factors of the accelerometers look the same')
    in_words = 'gravity leaks into the accelerometers on slopes or when the body leans'
    largest = {'pitch_per_acceleration': 0.03, 'roll_per_acceleration': 0.03}
    larger_is = 'slopes, or a scale factor'
    parameters = tuple(EffectParameter(name, 'rad/(m/s^2)', 0.01, adds_to=(f'vehicle.{name}',)) for name in SUSPENSION)
    traced = (*parameters, EffectParameter('compensation', '-', 0.3))
    tried = (dict.fromkeys(SUSPENSION, 0.0), {'compensation': 0.0})
    settings = tuple(Parameter(f'vehicle.{name}', 0.0, 'rad/(m/s^2)', text, minimum=-0.05, maximum=0.05)
                     for name, text in zip(SUSPENSION, (
                         'Nose up by this much for each m/s^2 of forward acceleration (planar mechanization).',
                         'Leaning outwards by this much for each m/s^2 of lateral acceleration (planar '
                         'mechanization).')))

    def alter_drive(self, drive, values):
        return drive.altered(
            pitch_per_acceleration=drive.path.pitch_per_acceleration + values['pitch_per_acceleration'],
            roll_per_acceleration=drive.path.roll_per_acceleration + values['roll_per_acceleration'])

    def hidden(self, values, recording):
        if values['mechanization'] == 'strapdown':
            return 'the strapdown mechanization has no such error'
        return ''

    def conditioning(self, values):
        pitch, roll = (values[f'vehicle.{name}'] for name in SUSPENSION)
        if values['mechanization'] == 'strapdown' or pitch == roll == 0:
            return None
        return np.diag([1 / (1 + STANDARD_GRAVITY * pitch), 1 / (1 + STANDARD_GRAVITY * roll), 1, 1, 1, 1])

    def replaces_model(self, theta):
        return theta.get('compensation', 0.0) != 0.0

    def adjusted(self, values, theta):
        if self.replaces_model(theta):
            return {**values, 'mechanization': 'strapdown'}
        return super().adjusted(values, theta)

    def applied(self, values, recording, theta, attitude=None):
        """With `compensation`: the recording with this part of the leakage taken out, the mechanization as it is."""
        if not self.replaces_model(theta):
            return self.adjusted(values, theta), recording
        leaked = leakage(*attitude(recording)) @ mounting(values['imu.mounting_rpy'])
        force = recording.imu.specific_force - theta['compensation'] * leaked
        return values, replace(recording, imu=replace(recording.imu, specific_force=force))


def leakage(roll: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Gravity in f_x and f_y of a body at rest with roll and pitch (n,), rad: (n, 3) m/s^2 in body axes."""
    return STANDARD_GRAVITY * np.column_stack([np.sin(pitch), -np.sin(roll) * np.cos(pitch), np.zeros(len(roll))])
