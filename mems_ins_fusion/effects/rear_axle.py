"""Rear axle: the point of the vehicle that does not move sideways is not where the parameters say."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter


class RearAxle(Effect):
    """The rear axle is x m further forward than vehicle.rear_axle says."""

    name = 'rear_axle'
    signature = ('a sideways velocity of the IMU in proportion to the turn rate: with the non-holonomic constraint '
                 'across-track innovations in bends')
    in_words = 'the rear axle is not where the parameters say'
    to_check = 'the place of the rear axle seen from the IMU, with a tape measure (vehicle.rear_axle)'
    sizes = {'x': ('it is {} further forward', 'it is {} further back')}
    parameters = (EffectParameter('x', 'm', 1.0, adds_to=('vehicle.rear_axle', 0)),)

    def alter_drive(self, drive, values):
        x, y, z = drive.path.axle_to_imu
        return drive.altered(axle_to_imu=(x - values['x'], y, z)) if values['x'] else drive

    def hidden(self, values, recording):
        if not values['vehicle.non_holonomic']:
            return 'only vehicle.non_holonomic knows an axle'
        if values['vehicle.rear_axle_sigma'] > 0:
            return 'the filter estimates it (vehicle.rear_axle_sigma)'
        return ''
