"""An IMU that is wrong although its samples are finite and in range.

Its axes are swapped, a gyroscope is off by degrees per second, a loose mount makes noise. The fixes then do not fit,
which looks as if they were wrong. The non-holonomic constraint tells the two apart: with such an IMU the vehicle seems
to slide sideways, more than is usual for this vehicle (the constraint's sigma is a bound for every car and road).
Velocity and heading are then made as uncertain as the slide is large, and for USE_ALL_TIME fixes are used
whatever their innovation.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import Error, Head, Nav, row_of, velocity_state, yaw_state
from ..prediction import UNKNOWN_YAW_SIGMA
from . import hypotheses
from .force_noise import ForceNoise
from .scale import reset_scale

#: s over which the normalized innovation squared (NIS) of the lateral constraint is averaged: its errors last about as
#: long
SLIDING_TIME = 1.0
#: s over which the usual NIS of a vehicle is averaged: some bends and some straights
USUAL_TIME = 30.0
#: usual NIS before any has been seen: half a sigma, as the constraint's sigma is a bound for all vehicles
FIRST_USUAL = 0.25
#: a NIS of more than this many times the usual counts as that: one slide must not become the usual
LARGEST_RATIO = 10.0
#: a slide is a mean NIS of this many times the usual: measured drives stay below 29
SLIDE_RATIO = 40.0
#: and this mean NIS at least: below half a sigma there is nothing to explain, however quiet the vehicle usually is
SMALLEST_SLIDE_NIS = 0.2
#: times the usual, while unsettled: who slid a moment ago does so again more easily
SLIDE_AGAIN_RATIO = 10.0
#: s for which the fixes decide after a slide: in that time a heading is found again from them
USE_ALL_TIME = 20.0
#: m/s, speed below which a slide tells no more of the heading than at it: the ratio of the two would be without bound
SLOWEST_SPEED = 1.0
#: normalized innovation squared of a fix, 2 degrees of freedom, to which an unsettled state is loosened
INFLATED_NIS = 2.0
#: rad (17 deg), largest standard deviation that this gives to roll and pitch: a mount that has slipped. The filter is
#: linear in them, and without the IMU no fix corrects them
LARGEST_TILT = 0.3


@njit(_nrt=False)
def slides(mem, r, innovation, s, since):
    """Whether the IMU has the vehicle slide as it does not usually.

    innovation, s: of the lateral constraint, m/s, and its variance. since: s from the one before.
    """
    nis = innovation * innovation / s
    usual = mem[r + Nav.USUAL_SLIDING_NIS]
    mem[r + Nav.SLIDING_NIS] += (nis - mem[r + Nav.SLIDING_NIS]) * min(since / SLIDING_TIME, 1.0)
    mem[r + Nav.USUAL_SLIDING_NIS] += (min(nis, LARGEST_RATIO * usual) - usual) * min(since / USUAL_TIME, 1.0)
    times = SLIDE_AGAIN_RATIO if mem[r + Nav.USE_ALL_FIXES] > 0.0 else SLIDE_RATIO
    return mem[r + Nav.SLIDING_NIS] > max(times * usual, SMALLEST_SLIDE_NIS)


@njit(_nrt=False)
def raise_uncertainty(mem, r, n, innovation, since):
    """Velocity and heading of P in the scratch less certain by a slide of `innovation`, m/s."""
    p, squared = int(mem[Head.SCRATCH_AT]), innovation * innovation
    speed = max(math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]), SLOWEST_SPEED)
    first, yaw = velocity_state(mem), yaw_state(mem)
    for i in range(first, first + 2):
        mem[p + (n + 1) * i] += squared
    mem[p + (n + 1) * yaw] += squared / (speed * speed)
    if mem[r + Nav.USE_ALL_FIXES] == 0.0:
        hypotheses.add_prior(mem, r, hypotheses.IMU_FAULT_PRIOR)
    mem[r + Nav.USE_ALL_FIXES] = USE_ALL_TIME
    mem[r + Nav.SLID] += since


@njit(_nrt=False)
def use_all_fixes(mem, r, since):
    """The state at r has been misled by an input that is wrong for certain and has been believed for `since` s, and the
    innovations have been that input's, not the accelerometers'."""
    reset_scale(mem, r + ForceNoise.SCALE)
    if mem[Head.LATERAL_SIGMA] > 0.0:  # else nobody counts the time
        mem[r + Nav.USE_ALL_FIXES] = max(mem[r + Nav.USE_ALL_FIXES], min(since, USE_ALL_TIME))


@njit(_nrt=False)
def inflate_to_fit(mem, r, n, nis):
    """The navigation errors in P of the scratch so uncertain that a fix with this nis, before the correction, fits.

    But its velocity no more than by itself: an IMU that turns the velocity makes it wrong by that at most. And its
    attitude no more than if nothing were known of it. Returns whether the fix fits then; else it may be an outlier.
    """
    if nis <= INFLATED_NIS:
        return True
    p, n_navigation, first = int(mem[Head.SCRATCH_AT]), int(mem[Head.N_NAVIGATION]), velocity_state(mem)
    speed = max(math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]), SLOWEST_SPEED)
    variance = max(mem[p + (n + 1) * first], mem[p + (n + 1) * (first + 1)])
    squared = min(nis / INFLATED_NIS, max(speed * speed / variance, 1.0))
    tilt, yaw = row_of(mem, Error.PHI_N), yaw_state(mem)
    for i in range(n_navigation):
        factor = math.sqrt(squared)
        if i == yaw or 0 <= tilt <= i:
            sigma, largest = math.sqrt(mem[p + (n + 1) * i]), UNKNOWN_YAW_SIGMA if i == yaw else LARGEST_TILT
            if factor * sigma > largest:
                factor = max(largest / sigma, 1.0)
        for j in range(n):
            mem[p + n * i + j] *= factor
            mem[p + n * j + i] *= factor
    return squared == nis / INFLATED_NIS
