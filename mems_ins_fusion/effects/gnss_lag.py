"""GNSS lag: the receiver smooths its positions, which come late for it."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter, added
from mems_ins_fusion.parameters.parameter import Parameter


class GnssLag(Effect):
    """The receiver passes its positions through a first-order low pass of time constant tau.

    To second order every smoothing receiver says p(t - delay) - lag a(t): a low pass has the delay tau and the lag
    -tau^2/2 (1/(1 + tau s) against exp(-tau s)), one that tracks the velocity (critically damped) no delay and the lag
    tau^2. The delay is a time offset and is traced as one; the lag is what is traced here. It lasts for as long as the
    acceleration and the receiver's filter do (`filter.trust.lag`).
    """

    name = 'gnss_lag'
    signature = ('innovations along the track behind accelerations, across it in bends; what is late at constant '
                 'speed, too, is a time offset')
    in_words = 'the receiver smooths its positions'
    to_check = 'the navigation filter setting of the receiver (dynamic model, position averaging, static hold)'
    looks_the_same = 'a receiver whose stamps are late looks nearly the same'
    parameters = (EffectParameter('tau', 's', 0.5),)
    # how long it lasts changes with its size: that of a second is looked for, not of an instant
    traced = (EffectParameter('lag', 's^2', 0.25, step=1.0),)
    settings = (Parameter('gnss.lag_per_acceleration', 0.0, 's^2', 'A receiver that smooths its positions: by how much '
                          'they stay behind, m for each m/s^2 that lasts, beside gnss.time_offset; the square of its '
                          'time constant.', minimum=-10.0,
                          maximum=10.0),)

    def as_traced(self, values):
        return {'delay': values['tau'], 'lag': -0.5 * values['tau']**2}

    def distort_fixes(self, drive, time, position, values, rng):
        from scipy.signal import lfilter

        if values['tau'] == 0:
            return position
        # s = 2 / dt (z - 1) / (z + 1); the vehicle begins at rest
        ratio = 2 * drive.rate * values['tau']
        weight = 1 / (1 + ratio)
        smooth = lfilter([weight, weight], [1.0, (1 - ratio) * weight], drive.position - drive.position[0], axis=0)
        behind = smooth - (drive.position - drive.position[0])
        return position + np.column_stack([np.interp(time, drive.time, axis) for axis in behind.T])

    def adjusted(self, values, theta):
        values = added(values, 'gnss.time_offset', change=theta.get('delay', 0.0))
        return added(values, 'gnss.lag_per_acceleration', change=theta['lag'])
