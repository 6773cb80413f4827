"""GNSS latency: how late the fixes are changes, at once or little by little."""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter

FOLLOWED = 60.0  # s within which a filter that knows should have followed a change


class GnssLatency(Effect):
    """A fix stamped t after the start describes t - drift t, and from `at` (part of the drive) on `step` earlier still.

    Where in a drive the latency changes says nothing of the next one: what is traced and corrected is that it wanders,
    the driving noise of a time offset that the filter estimates.
    """

    name = 'gnss_latency'
    signature = 'what a time offset does, of another size or sign in another part of the recording'
    in_words = 'how late the fixes are changes during the drive'
    to_check = 'whether the receiver\'s driver stamps a fix when it arrives, and what else uses its serial line'
    parameters = (EffectParameter('step', 's', 0.1), EffectParameter('drift', '-', 2e-4),
                  EffectParameter('at', '-', 0.5, default=0.5))
    traced = (EffectParameter('wander', 's/sqrt(s)', 0.01, variance=True),)

    def as_traced(self, values):
        return {'wander': math.hypot(values['step'] / math.sqrt(FOLLOWED), values['drift'] * math.sqrt(FOLLOWED))}

    def fix_times(self, time, values):
        changed = time >= values['at'] * (time[-1] if len(time) else 0.0)
        return time - values['drift'] * np.maximum(time, 0.0) - values['step'] * changed

    def adjusted(self, values, theta):
        return {**values, 'gnss.time_offset_walk': float(np.hypot(values['gnss.time_offset_walk'], theta['wander']))}
