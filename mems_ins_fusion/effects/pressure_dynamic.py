"""Dynamic pressure: a barometer in a moving vehicle measures the flow of the air, too."""
from __future__ import annotations

from mems_ins_fusion.effects.aiding_time_offset import hidden_by_state
from mems_ins_fusion.effects.base import Effect, EffectParameter

#: the filter estimates the share where more than this is left beside the parameter
ESTIMATED = 0.01


class PressureDynamic(Effect):
    """The pressure `of` is larger by the `share` of the dynamic pressure: by share v^2 / (2 g) it seems to be lower."""

    signature = 'heights that fall or rise with the square of the speed: with the pitch of the body, an acceleration'
    in_words = 'the barometer measures the wind of the drive'
    to_check = 'where the barometer is: open windows and fans draw air out, a duct in the front holds it up'
    looks_the_same = 'a road that descends wherever the vehicle is fast looks the same'
    largest = {'share': 1.5}
    larger_is = 'a wrong unit'

    def __init__(self, of: str):
        self.of, self.name = of, f'{of}_dynamic'
        self.parameters = (EffectParameter('share', '-', 0.3, adds_to=(f'{of}.dynamic',)),)

    def dynamic_pressure(self, name, values):
        return values['share'] if name == self.of else 0.0

    def hidden(self, values, recording):
        return hidden_by_state(self.of, f'{self.of}.dynamic_sigma', ESTIMATED, values, recording)
