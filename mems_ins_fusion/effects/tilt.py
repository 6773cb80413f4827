"""Tilt in motion: the suspension lets the body pitch and roll with acceleration, and gravity leaks into f_x and f_y."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter


class Tilt(Effect):
    """Nose up by pitch_per_acceleration when speeding up, leaning outwards by roll_per_acceleration in a bend."""

    name = 'tilt'
    parameters = (EffectParameter('pitch_per_acceleration', 'rad/(m/s^2)', 0.01),
                  EffectParameter('roll_per_acceleration', 'rad/(m/s^2)', 0.01))

    def alter_drive(self, drive, values):
        return drive.altered(
            pitch_per_acceleration=drive.path.pitch_per_acceleration + values['pitch_per_acceleration'],
            roll_per_acceleration=drive.path.roll_per_acceleration + values['roll_per_acceleration'])
