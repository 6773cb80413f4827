"""Sideslip: in a bend the body does not point along the velocity."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter


class Sideslip(Effect):
    """Angle from the body's x axis to the velocity, clockwise, per lateral acceleration to the right."""

    name = 'sideslip'
    parameters = (EffectParameter('angle_per_acceleration', 'rad/(m/s^2)', 0.01),)

    def alter_drive(self, drive, values):
        return drive.altered(sideslip_per_acceleration=drive.path.sideslip_per_acceleration
                             + values['angle_per_acceleration'])
