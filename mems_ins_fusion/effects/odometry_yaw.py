"""Mounting of an odometry: the axes in which it says its velocity are turned against the vehicle's."""
from __future__ import annotations

from mems_ins_fusion.effects.aiding_time_offset import hidden_by_state
from mems_ins_fusion.effects.base import Effect, EffectParameter

#: rad; the filter estimates it where what is left beside the parameter is more than this
ESTIMATED = 1e-3


class OdometryYaw(Effect):
    """The axes of the odometry `of` are turned to the left by yaw, seen from above: a vehicle that goes straight on
    seems to slip to the right by yaw times its speed."""

    signature = 'a sideways velocity in proportion to the speed, also straight on: it turns the heading'
    in_words = 'the odometry is mounted at an angle'
    to_check = 'the direction in which the lidar or camera looks, and the frame in which its driver says the twist'
    looks_the_same = ('an IMU that is mounted at the opposite angle looks the same where nothing else shows where '
                      'forward is')
    sizes = {'yaw': ('turned to the left by {}', 'turned to the right by {}')}

    def __init__(self, of: str):
        self.of, self.name = of, f'{of}_yaw'
        self.parameters = (EffectParameter('yaw', 'rad', 0.03, adds_to=(f'{of}.yaw',)),)

    def turned(self, name, values):
        return values['yaw'] if name == self.of else 0.0

    def hidden(self, values, recording):
        return hidden_by_state(self.of, f'{self.of}.yaw_sigma', ESTIMATED, values, recording)
