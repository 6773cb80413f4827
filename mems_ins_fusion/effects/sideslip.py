"""Sideslip: in a bend the body does not point along the velocity."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.parameters.parameter import Parameter


class Sideslip(Effect):
    """Angle from the body's x axis to the velocity, clockwise, per lateral acceleration to the right."""

    name = 'sideslip'
    signature = ('a heading that differs from the course in bends; only the non-holonomic constraint assumes that '
                 'both are equal')
    in_words = 'the vehicle moves sideways in bends'
    to_check = 'tyres and load; whether the IMU points straight ahead'
    looks_the_same = 'an IMU far from the rear axle looks nearly the same'
    largest = {'angle_per_acceleration': 0.03}
    larger_is = 'an IMU that is turned, or one far from the rear axle'
    parameters = (EffectParameter('angle_per_acceleration', 'rad/(m/s^2)', 0.01,
                                  adds_to=('vehicle.sideslip_per_acceleration',)),)
    settings = (Parameter('vehicle.sideslip_per_acceleration', 0.0, 'rad/(m/s^2)', 'Angle from the forward axis to the '
                          'velocity, clockwise, per lateral acceleration to the right (non-holonomic constraint).',
                          minimum=-0.1, maximum=0.1),)

    def alter_drive(self, drive, values):
        return drive.altered(sideslip_per_acceleration=drive.path.sideslip_per_acceleration
                             + values['angle_per_acceleration'])

    def hidden(self, values, recording):
        return '' if values['vehicle.non_holonomic'] else (
            'only vehicle.non_holonomic assumes that course and heading are equal')
