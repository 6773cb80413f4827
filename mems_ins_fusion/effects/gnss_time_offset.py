"""GNSS time offset: the receiver's stamps and those of the IMU come from clocks that disagree."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter, added


class GnssTimeOffset(Effect):
    """A fix stamped t describes the vehicle when the IMU's clock read t - time_offset."""

    name = 'gnss_time_offset'
    signature = ('innovations along the track in proportion to speed, across it in proportion to speed times '
                 'turn rate; at constant speed a lever arm along the vehicle looks the same')
    parameters = (EffectParameter('time_offset', 's', 0.1),)

    def fix_times(self, time, values):
        return time - values['time_offset']

    def adjusted(self, values, theta):
        return added(values, 'gnss.time_offset', None, theta['time_offset'])
