"""Noise of the accelerometers beyond that of their samples and parameters, learned from the innovations of the fixes.

Errors of the specific force that last for seconds (rectified vibration, a loose mount, a changing tilt) are neither
white noise that the samples show nor a bias that the filter can follow. They make the velocity error a random walk. If
P does not contain it, the filter trusts its velocity too much, and low-passed innovations are larger than those of
white noise. A filter that follows fixes with the time constant tau has a position error whose variance is larger by
density^2 tau^3 / 3. One scale (scale.py) learns the density from this (covariance matching, R. K. Mehra, "Approaches to
adaptive filtering", IEEE Trans. Automatic Control 17, 1972). The part of the claimed variance by which fixes do not
scatter is a slow error of the receiver, and does not count as noise of the IMU.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.acceleration import DENSITY
from ..memory import ROW, Nav
from .drift import DriftSettings
from .scale import Scale, learn

#: of a state: realised noise density squared over ASSUMED_DENSITY
ForceNoise = ROW.place('ForceNoise', SCALE=Scale.SIZE)

#: m^2/s^3, noise density squared at a scale of 1: 0.1 m/s^2 for a second, ten times that of cheap IMUs. Only the excess
#: over it is used, so that accelerometers that agree with their parameters have none
ASSUMED_DENSITY = 0.01
#: largest share of P that is attributed to this noise: in the steady state of a filter of position and velocity, half
#: of the variance that a correction removes is caused by the noise since the previous one
MOST_OF_P = 0.5
#: smallest share of the expected variance of white innovations that is attributed to other causes. Chosen; a quarter
#: and four times of it move little (docs/ablation.md)
LEAST_WHITE = 0.1


@njit(_nrt=False)
def force_noise(mem, r):
    """Noise density squared of the specific force in addition to that of the samples, m^2/s^3, in the state at r. At
    most that of a vehicle's acceleration, which is known without an IMU."""
    level = mem[r + ForceNoise.SCALE + Scale.LOG]
    return min(ASSUMED_DENSITY * (math.exp(level) - 1.0), DENSITY) if level > 0.0 else 0.0


@njit(_nrt=False)
def learn_force_noise(mem, r, time, squared, white, p, tau, lasting, weight):
    """Learn from an innovation, or from low-passed ones, with a fix at `time`, s.

    squared: their mean square, m^2. white: its expectation for white innovations with the covariance S, m^2. p:
    variance of the position before the fix, m^2. tau: s, time constant with which the filter follows fixes. lasting:
    variance of the slow errors that the receiver claims, m^2. weight: of this fix; below 1 as successive values are
    correlated.
    """
    if mem[DriftSettings.LEARNED] == 0.0 or mem[r + Nav.BRIDGED] > 0.0 or mem[r + Nav.USE_ALL_FIXES] > 0.0 or p <= 0.0:
        return  # not learned, or the IMU is not used or known to be wrong
    part = ASSUMED_DENSITY * tau**3 / 3.0
    known = min(math.exp(mem[r + ForceNoise.SCALE + Scale.LOG]) * part, MOST_OF_P * p)  # already contained in S
    rest = max(white - known, LEAST_WHITE * white) + lasting
    learn(mem, r + ForceNoise.SCALE, time, squared, part, rest, 2, weight)


@njit(_nrt=False)
def learn_from_velocity(mem, r, time, squared, since):
    """Learn from the velocity error of a filter that used no fix for `since` s and whose IMU was found wrong.

    squared: mean square of the two components of the error, m^2/s^2. If the IMU is only noisier than its parameters
    say, it is used with this noise afterwards.
    """
    if mem[DriftSettings.LEARNED] != 0.0 and since > 0.0:
        learn(mem, r + ForceNoise.SCALE, time, squared, ASSUMED_DENSITY * since, 0.0, 2)


@njit(_nrt=False)
def learn_from_change(mem, r, time, squared, noise_share, rest):
    """Update noise that was found before, from the second difference of three rare fixes, the last at `time`, s.

    Unlike an innovation, it does not depend on the state: without it, noise of 1 m/s^2 is not learned while fixes are
    refused.

    squared: its mean square, m^2. noise_share: expectation of it per m^2/s^3 of noise, s^3. rest: expectation by other
    causes, m^2.
    """
    if mem[DriftSettings.LEARNED] != 0.0 and mem[r + ForceNoise.SCALE + Scale.LOG] > 0.0:
        learn(mem, r + ForceNoise.SCALE, time, squared, ASSUMED_DENSITY * noise_share, rest, 2)
