"""GNSS latency: the delay of the fixes changes, suddenly or slowly."""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter

FOLLOWED = 60.0  # s within which the filter's time offset state should follow a change


class GnssLatency(Effect):
    """A fix stamped t after the start describes t - drift t, and from `at` (share of the drive) on `step` earlier.

    When the latency changes differs from drive to drive. So the changes themselves are not corrected: traced and
    corrected is the random walk of the time offset that the filter estimates.
    """

    name = 'gnss_latency'
    signature = 'what a time offset does, of another size or sign in another part of the recording'
    in_words = 'the delay of the fixes changes during the drive'
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
