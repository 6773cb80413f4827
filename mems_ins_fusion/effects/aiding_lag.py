"""Lag of the inputs besides the fixes: a low pass in the sensor, its driver or the bus."""
from __future__ import annotations

import math

from mems_ins_fusion.effects.aiding_time_offset import why_missing
from mems_ins_fusion.effects.base import Effect, EffectParameter, with_added

#: by which the stamps are later than what is measured, in all
DELAY = EffectParameter('delay', 's', 0.1)


class AidingLag(Effect):
    """The input `of` comes through a first-order low pass of the time constant tau.

    1 / (1 + tau s) is exp(-tau s) to first order: what is smoothed is late by tau, which is found and corrected as the
    time offset of the input. The rest, tau^2 / 2 times the second derivative, is this effect: its size is the square.
    `known`: whether the filter has a model of it (`NAME.lag`); if not, the offset is all that is corrected.
    `delayed`: whether a diagnosis estimates the offset with it. It does where a recording shows the low pass without a
    filter: of a long one, the offset alone and the rest alone are each worse than neither.
    """

    signature = 'what a time offset does, with the opposite sign before each change of acceleration and after it'
    sizes = {'tau': ('smoothed over {}', 'smoothed over {}'), 'delay': ('{} late in all', '{} early in all')}
    parameters = (EffectParameter('tau', 's', 0.3, variance=True),)

    def __init__(self, of: str, known: bool = True, delayed: bool = True):
        self.of, self.known, self.delayed, self.name = of, known, delayed, f'{of}_lag'
        self.in_words = f'the {of} is smoothed'
        self.to_check = f'the filter of the sensor, the driver or the bus that the {of} comes through'
        self.looks_the_same = 'stamps that are late by its time constant look nearly the same: only jerks differ'

    @property
    def traced(self):
        return (DELAY, *self.parameters) if self.delayed else self.parameters

    def measured_lag(self, name, values):
        return values['tau'] if name == self.of else 0.0

    def as_traced(self, values):
        return {'delay': values['tau'], 'tau': values['tau']}

    def hidden(self, values, recording):
        if not self.known:
            return f'the filter has no model of it: it is found as {self.of}_time_offset'
        return why_missing(self.of, values, recording)

    def adjusted(self, values, theta):
        values = with_added(values, f'{self.of}.time_offset', change=theta.get('delay', 0.0))
        lag = f'{self.of}.lag'
        return {**values, lag: math.hypot(values[lag], theta['tau'])} if self.known else values


LAGS = (*(AidingLag(name) for name in ('speed', 'twist', 'heading')),
        *(AidingLag(name, known=False) for name in ('velocity', 'magnetometer', 'pressure')))
