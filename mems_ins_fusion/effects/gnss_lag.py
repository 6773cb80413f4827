"""GNSS lag: the receiver smooths its positions, so they are late."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter, with_added
from mems_ins_fusion.parameters.parameter import Parameter


class GnssLag(Effect):
    """The receiver passes its positions through a first-order low pass of time constant tau.

    To second order the position of every smoothing receiver is p(t - delay) - lag a(t). A low pass has the delay tau
    and the lag -tau^2/2 (1/(1 + tau s) compared with exp(-tau s)); a receiver that tracks the velocity (critically
    damped) has no delay and the lag tau^2. The delay is a time offset and is traced as such; here only the lag is
    traced. The error decays with the receiver's filter after the acceleration has ended (`filter.trust.lag`).
    """

    name = 'gnss_lag'
    signature = ('innovations along the track after accelerations, across it in bends; a delay at constant speed is a '
                 'time offset')
    in_words = 'the receiver smooths its positions'
    to_check = 'the navigation filter setting of the receiver (dynamic model, position averaging, static hold)'
    looks_the_same = 'a receiver whose stamps are late looks nearly the same'
    parameters = (EffectParameter('tau', 's', 0.5),)
    # the duration of the error depends on its size: with this step, the sensitivity is that of a filter with tau = 1 s
    traced = (EffectParameter('lag', 's^2', 0.25, step=1.0),)
    settings = (Parameter('gnss.lag_per_acceleration', 0.0, 's^2', 'Lag of the positions of a receiver that smooths '
                          'them, in addition to gnss.time_offset: m for each m/s^2 of constant acceleration; the '
                          'square of the time constant of its filter.', minimum=-10.0,
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
        values = with_added(values, 'gnss.time_offset', change=theta.get('delay', 0.0))
        return with_added(values, 'gnss.lag_per_acceleration', change=theta['lag'])
