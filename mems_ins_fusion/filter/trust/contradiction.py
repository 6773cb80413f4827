"""Detect an IMU that is wrong although its samples are finite and within range.

Examples are swapped axes, a gyroscope bias of degrees per second or the noise of a loose mount. The innovations of the
fixes are then large, as if the fixes were wrong. The non-holonomic constraint distinguishes the two cases: with a wrong
IMU, the vehicle appears to slide sideways by more than is usual for this vehicle. (The sigma of the constraint is no
measure of that, as it is an upper limit for all cars and roads.) The variances of velocity and heading are then
increased by the size of the slide. For USE_ALL_TIME, all fixes are used, whatever their innovation.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import Error, Head, Nav, row_of, velocity_state, yaw_state
from ..prediction import UNKNOWN_YAW_SIGMA
from . import hypotheses
from .force_noise import ForceNoise
from .scale import reset_scale

#: s, averaging time of the normalized innovation squared (NIS) of the lateral constraint: its errors are correlated for
#: about this time
SLIDING_TIME = 1.0
#: s, averaging time of the usual NIS of the vehicle: contains bends and straights
USUAL_SLIDING_TIME = 30.0
#: usual NIS at the start: an innovation of half a sigma, as the sigma of the constraint is an upper limit for all
#: vehicles
FIRST_USUAL = 0.25
#: upper limit of a NIS over the usual one, a larger one counts as this: one slide must not change the usual NIS
LARGEST_RATIO = 10.0
#: ratio of the mean NIS to the usual one above which the vehicle slides: below 29 on all measured drives
SLIDE_RATIO = 40.0
#: smallest mean NIS of a slide, about half a sigma: a smaller one is no contradiction, even if the usual NIS of the
#: vehicle is very small
SMALLEST_SLIDE_NIS = 0.2
#: the same as SLIDE_RATIO during USE_ALL_TIME after a slide, when another one is more probable
SLIDE_AGAIN_RATIO = 10.0
#: s for which all fixes are used after a slide: in this time the heading is found again from them
USE_ALL_TIME = 20.0
#: m/s, lower limit of the speed where a slide is divided by it, as the heading error would be unbounded at rest. Also
#: the lower limit of the speed in `inflate_to_fit`
SLIDE_SPEED = 1.0
#: normalized innovation squared of a fix, 2 degrees of freedom, after P was increased: its expectation
INFLATED_NIS = 2.0
#: rad (17 deg), largest standard deviation of roll and pitch after P was increased: a mount that has slipped. The
#: filter is linear in them, and without the IMU fixes do not correct them
LARGEST_TILT = 0.3


@njit(_nrt=False)
def slides(mem, r, innovation, s, since):
    """Whether the IMU shows a lateral velocity that is unusual for this vehicle.

    innovation, s: innovation of the lateral constraint, m/s, and its variance. since: s since the previous one.
    """
    nis = innovation * innovation / s
    usual = mem[r + Nav.USUAL_SLIDING_NIS]
    mem[r + Nav.SLIDING_NIS] += (nis - mem[r + Nav.SLIDING_NIS]) * min(since / SLIDING_TIME, 1.0)
    mem[r + Nav.USUAL_SLIDING_NIS] += (min(nis, LARGEST_RATIO * usual) - usual) * min(since / USUAL_SLIDING_TIME, 1.0)
    times = SLIDE_AGAIN_RATIO if mem[r + Nav.USE_ALL_FIXES] > 0.0 else SLIDE_RATIO
    return mem[r + Nav.SLIDING_NIS] > max(times * usual, SMALLEST_SLIDE_NIS)


@njit(_nrt=False)
def raise_uncertainty(mem, r, n, innovation, since):
    """Increase the variances of velocity and heading in P of the scratch after a slide, and use all fixes for
    USE_ALL_TIME.

    innovation: of the lateral constraint, m/s. since: s since the previous one.
    """
    p, squared = int(mem[Head.SCRATCH_AT]), innovation * innovation
    speed = max(math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]), SLIDE_SPEED)
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
    """Use all fixes for a time, as the state at r contains a wrong input that was used for `since` s.

    The innovations in this time were caused by the input, not by the accelerometers. So the noise of the accelerometers
    that was learned from them is reset.
    """
    reset_scale(mem, r + ForceNoise.SCALE)
    if mem[Head.LATERAL_SIGMA] > 0.0:  # only the lateral constraint counts this time down
        mem[r + Nav.USE_ALL_FIXES] = max(mem[r + Nav.USE_ALL_FIXES], min(since, USE_ALL_TIME))


@njit(_nrt=False)
def inflate_to_fit(mem, r, n, nis):
    """Increase the navigation part of P in the scratch until a fix with this nis, before the correction, is consistent
    with it.

    There are two limits. The standard deviation of the velocity is increased to the speed at most: an IMU that turns
    the velocity causes an error of about this size. That of each attitude angle is increased to that of an unknown
    angle at most. Returns whether the fix is consistent then; if not, it may be an outlier.
    """
    if nis <= INFLATED_NIS:
        return True
    p, n_navigation, first = int(mem[Head.SCRATCH_AT]), int(mem[Head.N_NAVIGATION]), velocity_state(mem)
    speed = max(math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]), SLIDE_SPEED)
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
