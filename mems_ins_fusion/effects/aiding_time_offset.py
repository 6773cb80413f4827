"""Time offset of what is measured besides the fixes: wheels that report late, a velocity of another clock."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter, added


class AidingTimeOffset(Effect):
    """A measurement of the input `of` stamped t describes the vehicle when the IMU's clock read t - time_offset."""

    sizes = {'time_offset': ('stamped {} too late', 'stamped {} too early')}
    largest = {'time_offset': 2.0}
    larger_is = 'stamps of another clock'
    parameters = (EffectParameter('time_offset', 's', 0.1),)

    def __init__(self, of: str, signature: str, in_words: str, to_check: str):
        self.of, self.name = of, f'{of}_time_offset'
        self.signature, self.in_words, self.to_check = signature, in_words, to_check

    def measured_times(self, name, time, values):
        return time - values['time_offset'] if name == self.of else time

    def hidden(self, values, recording):
        there = self.of in recording.streams() and values[f'{self.of}_topic']
        return '' if there else f'no {self.of} in the recording ({self.of}_topic)'

    def adjusted(self, values, theta):
        return added(values, f'{self.of}.time_offset', None, theta['time_offset'])


TIME_OFFSETS = (
    AidingTimeOffset('speed', 'innovations along the track at each change of speed, in proportion to the acceleration',
                     'the speed of the wheels comes late',
                     'what the driver of the wheel speed stamps: the counting of the pulses or the arrival on the bus, '
                     'and over how long it averages'),
    AidingTimeOffset('velocity', 'innovations along and across the track in proportion to the acceleration',
                     "the receiver's velocity is of another time than its fixes",
                     'whether the receiver smooths its velocity, and what its driver stamps'),
    AidingTimeOffset('twist', 'innovations along the track at each change of speed, in proportion to the acceleration',
                     'the odometry comes late',
                     'what the driver of the odometry stamps, and over how long it computes'),
    AidingTimeOffset('heading', 'a heading that is off in proportion to the turn rate', 'the heading comes late',
                     'whether the compass or the receiver smooths its heading, and what its driver stamps'),
)
