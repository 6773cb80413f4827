"""Time offset of the inputs besides the fixes, such as wheels that report late, or a velocity with another clock."""
from __future__ import annotations

import math
from collections.abc import Mapping

from mems_ins_fusion.effects.base import Effect, EffectParameter, with_added

#: what the time offset leaves of a low pass of an input that has no `NAME.lag`
_NOT_MODELLED = 'a low pass of the {}, of which the filter corrects the time offset only'
#: between the names of several inputs
AND = '_and_'


class AidingTimeOffset(Effect):
    """A measurement of the input `of` stamped t describes the vehicle when the IMU's clock read t - time_offset."""

    sizes = {'time_offset': ('stamped {} too late', 'stamped {} too early')}
    largest = {'time_offset': 2.0}
    larger_is = 'stamps of another clock'
    looks_the_same = 'a low pass in the sensor, its driver or the bus, late by its time constant, looks nearly the same'
    parameters = (EffectParameter('time_offset', 's', 0.1),)

    def __init__(self, of: str, signature: str, in_words: str, to_check: str, called: str = ''):
        """called: what `of` is in words, where it is not its own name."""
        self.of, self.name, self._called = of, f'{of}_time_offset', called or of
        self.signature, self.in_words, self.to_check = signature, in_words, to_check

    def measured_times(self, name, time, values):
        return time - values['time_offset'] if name == self.of else time

    def hidden(self, values, recording):
        return why_missing(self.of, values, recording)

    def adjusted(self, values, theta):
        return with_added(values, f'{self.of}.time_offset', change=theta['time_offset'])

    def leaves(self, values):
        return '' if f'{self.of}.lag' in values else _NOT_MODELLED.format(self._called)


def why_missing(name: str, values: Mapping, recording) -> str:
    """Why `recording` has nothing of the input `name`; empty where it has."""
    there = name in recording.streams() and (values.get(f'{name}_topic') or values.get(f'{name}.topic'))
    return '' if there else f'no {name} in the recording ({name}_topic)'


def hidden_by_state(of: str, deviation: str, least: float, values: Mapping, recording) -> str:
    """Why the innovations have nothing of an effect of the input `of`; empty where they may have. The filter estimates
    it where `deviation`, the parameter of what is left of it, is more than `least`: less is no matter."""
    return why_missing(of, values, recording) or (
        f'the filter estimates it ({deviation})' if values[deviation] > least else '')


class SeveralTimeOffsets(Effect):
    """Time offsets of several inputs that are known without a filter, with the low passes that are a part of them,
    corrected together: if two inputs are late, the correction of one alone would not agree with the other. Only a
    common factor of the known sizes is estimated; it is 1 where they are right."""

    signature = 'innovations along the track at each change of speed, in proportion to the acceleration'
    in_words = 'the stamps of several inputs are off'
    to_check = 'what the drivers of these inputs stamp, and over how long they average'
    sizes = {'share': ('{} of the offsets that the IMU shows', '{} of the opposite of what the IMU shows')}
    parameters = (EffectParameter('share', '-', 1.0),)

    def __init__(self, sizes: Mapping[str, float], low_passes: Mapping[str, float] | None = None):
        """sizes: s, by the inputs' names; low_passes: time constants, s, of those of them that have one."""
        self.known, self.name = dict(sizes), f'{AND.join(sizes)}_time_offset'
        self.low_passes = low_passes or {}

    def hidden(self, values, recording):
        return next((why for name in self.known if (why := time_offset_of(name).hidden(values, recording))), '')

    def adjusted(self, values, theta):
        for name, size in self.known.items():
            values = with_added(values, f'{name}.time_offset', change=theta['share'] * size)
        for name, tau in self.low_passes.items():
            values = {**values, f'{name}.lag': math.hypot(values[f'{name}.lag'], theta['share'] * tau)}
        return values


TIME_OFFSETS = (
    AidingTimeOffset('speed', 'innovations along the track at each change of speed, in proportion to the acceleration',
                     'the speed of the wheels comes late',
                     'what the driver of the wheel speed stamps: the counting of the pulses or the arrival on the bus, '
                     'and over how long it averages'),
    AidingTimeOffset('velocity', 'innovations along and across the track in proportion to the acceleration',
                     "the stamps of the receiver's velocity are off against those of its fixes",
                     'whether the receiver smooths its velocity, and what its driver stamps'),
    AidingTimeOffset('twist', 'innovations along the track at each change of speed, in proportion to the acceleration',
                     'the odometry comes late',
                     'what the driver of the odometry stamps, and over how long it computes'),
    AidingTimeOffset('heading', 'a heading that is off in proportion to the turn rate', 'the heading comes late',
                     'whether the compass or the receiver smooths its heading, and what its driver stamps'),
    AidingTimeOffset('magnetometer', 'a magnetic field that is off in proportion to the turn rate',
                     'the magnetometer comes late', 'whether the magnetometer averages, and what its driver stamps'),
    AidingTimeOffset('pressure', 'heights that are off in proportion to the climb', 'the pressure comes late',
                     'whether the pressure sensor averages, or air comes to it slowly, and what its driver stamps'),
)


def time_offset_of(name: str) -> AidingTimeOffset:
    """The time offset of the input called `name` in a params file."""
    return AidingTimeOffset(name, 'innovations in proportion to how fast what it measures changes',
                            f"the stamps of the input '{name}' are off",
                            f"what the driver of the input '{name}' stamps, and over how long it averages",
                            f"input '{name}'")
