"""Wheel speed scale factor error: tyres of another size or pressure."""
from __future__ import annotations

from mems_ins_fusion.effects.aiding_time_offset import hidden_by_state
from mems_ins_fusion.effects.base import Effect, EffectParameter


class SpeedScale(Effect):
    """measured = (1 + scale) true."""

    name = 'speed_scale'
    signature = ('in every gap between fixes the track is too long or too short; innovations along the track in '
                 'proportion to speed, as with a time offset')
    in_words = 'the wheels measure too much or too little'
    to_check = 'the size and pressure of the tyres'
    sizes = {'scale': ('{} too much', '{} too little')}
    parameters = (EffectParameter('scale', '-', 0.02, adds_to=('speed.scale',)),)

    def distort_speeds(self, speed, values):
        return (1 + values['scale']) * speed

    def hidden(self, values, recording):
        return hidden_by_state('speed', 'speed.scale_sigma', 0.0, values, recording)
