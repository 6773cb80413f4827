"""How much noisier the accelerometers are than their samples and parameters say: as the fixes show it.

Errors of the specific force that last for seconds (vibration that is rectified, a mount that gives way, a tilt that
comes and goes) are neither white noise that the samples show nor a bias that the filter can follow. To the velocity
they are noise: a random walk. Where that is missing in P, the filter holds on to a velocity that the fixes contradict,
and its innovations behind a low pass are larger than white ones. Their variance grows with this noise as the position
of a filter does that follows fixes within tau: by the density squared times tau^3 / 3. One scale learns the density
from that (scale.py; covariance matching, R. K. Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic
Control 17, 1972). What fixes claim and do not scatter are errors that last of the receiver, and no noise of the IMU.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.acceleration import DENSITY
from ..memory import ROW, Nav
from .drift import DriftSettings
from .scale import Scale, learn

#: of a state: realised noise over ASSUMED
ForceNoise = ROW.place('ForceNoise', SCALE=Scale.SIZE)

#: m^2/s^3, noise density squared that a scale of 1 stands for: 0.1 m/s^2 for a second, ten times that of cheap IMUs.
#: Only what is beyond it counts, so that accelerometers as good as their parameters say have none
ASSUMED = 0.01
#: share of the variance of P that is this noise at most: in a filter of position and velocity in its steady state half
#: of what a correction takes away comes from the noise since the last one
MOST_OF_P = 0.5
#: share of the expected variance of white innovations that is left at least of what else is in them
LEAST_WHITE = 0.1


@njit(_nrt=False)
def force_noise(mem, r):
    """Noise density squared of the specific force beside that of the samples, m^2/s^3, in the state at r: at most that
    of a vehicle's acceleration, which is all that is known without an IMU."""
    level = mem[r + ForceNoise.SCALE + Scale.LOG]
    return min(ASSUMED * (math.exp(level) - 1.0), DENSITY) if level > 0.0 else 0.0


@njit(_nrt=False)
def learn_force_noise(mem, r, time, squared, white, p, tau, lasting, weight):
    """Learn from innovations, behind a low pass or not, with a fix at `time`, s.

    squared: their mean square, m^2. white: what it would be of white ones that S expects, m^2. p: variance of the
    position before the fix, m^2. tau: s, within which the filter follows fixes. lasting: variance of the receiver's
    errors that last, m^2, as far as it claims them. weight: of this fix, as several tell the same.
    """
    if mem[DriftSettings.LEARNED] == 0.0 or mem[r + Nav.BRIDGED] > 0.0 or mem[r + Nav.USE_ALL_FIXES] > 0.0 or p <= 0.0:
        return  # also where the IMU is not used, or known to be wrong
    part = ASSUMED * tau**3 / 3.0
    known = min(math.exp(mem[r + ForceNoise.SCALE + Scale.LOG]) * part, MOST_OF_P * p)  # of it is in S already
    rest = max(white - known, LEAST_WHITE * white) + lasting
    learn(mem, r + ForceNoise.SCALE, time, squared, part, rest, 2, weight)


@njit(_nrt=False)
def learn_from_velocity(mem, r, time, squared, since):
    """Learn from how far the velocity of a filter was off that used no fix for `since`, s, and whose IMU is wrong.

    squared: mean square of the two components of that error, m^2/s^2. An IMU that is only noisier than its parameters
    say is then used with that noise.
    """
    if mem[DriftSettings.LEARNED] != 0.0 and since > 0.0:
        learn(mem, r + ForceNoise.SCALE, time, squared, ASSUMED * since, 0.0, 2)


@njit(_nrt=False)
def learn_from_change(mem, r, time, squared, noise_share, rest):
    """Learn from the second difference of three rare fixes at `time`, s, whether noise that was found is still there.

    squared: its mean square, m^2. noise_share: of it, for each m^2/s^3 of noise, s^3. rest: what else is in it, m^2.
    """
    if mem[DriftSettings.LEARNED] != 0.0 and mem[r + ForceNoise.SCALE + Scale.LOG] > 0.0:
        learn(mem, r + ForceNoise.SCALE, time, squared, ASSUMED * noise_share, rest, 2)
