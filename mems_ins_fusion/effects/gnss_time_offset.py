"""GNSS time offset: the receiver's stamps and those of the IMU come from clocks that disagree."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter


class GnssTimeOffset(Effect):
    """A fix stamped t describes the vehicle when the IMU's clock read t - time_offset."""

    name = 'gnss_time_offset'
    parameters = (EffectParameter('time_offset', 's', 0.1),)

    def fix_times(self, time, values):
        return time - values['time_offset']
