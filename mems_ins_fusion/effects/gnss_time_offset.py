"""GNSS time offset: the receiver's stamps and those of the IMU come from clocks that disagree."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter


class GnssTimeOffset(Effect):
    """A fix stamped t describes the vehicle when the IMU's clock read t - time_offset."""

    name = 'gnss_time_offset'
    signature = ('innovations along the track in proportion to speed, across it in proportion to speed times '
                 'turn rate; at constant speed a lever arm along the vehicle looks the same')
    in_words = 'the clocks of receiver and IMU disagree'
    to_check = ('whether the receiver\'s driver stamps a fix with the time of its measurement (GPS time, PPS) or of '
                'its arrival')
    sizes = {'time_offset': ('fixes are stamped {} too late', 'fixes are stamped {} too early')}
    largest = {'time_offset': 2.0}
    larger_is = ('stamps of another clock (UTC and GPS time, a clock that was set), or positions that the receiver '
                 'smooths')
    parameters = (EffectParameter('time_offset', 's', 0.1, adds_to=('gnss.time_offset',),
                                  sigma_in='gnss.time_offset_sigma'),)

    def fix_times(self, time, values):
        return time - values['time_offset']
