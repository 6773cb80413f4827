"""Start anew: the whole state from refused fixes that are right, or only the heading from the course.

A straight line over time is fitted to the innovations of fixes refused in a row (`line.py`, at `Nav.REFUSED`). Fixes
near this line agree with each other. Its slope shows whether the filter has diverged from them.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..history import forget
from ..measurements.geometry import set_heading
from ..measurements.position import NO_ALTITUDE_SIGMA, is_without_altitude
from ..memory import NAV, Error, Event, Head, Nav, Verdict, row_of, velocity_state, yaw_state
from ..prediction import GAP_ACCELERATION, UNKNOWN_TILT_SIGMA, UNKNOWN_YAW_SIGMA
from ..update import scratch_of
from . import hypotheses
from .drift import Drift
from .hypotheses import Hypothesis
from .line import FEWEST_ON_LINE, Line, add_to_line, begin_line, fit_line
from .receiver import Receiver, excess_scatter
from .scale import reset_scale

#: s, longest interval between two fixes that give a course: in more time the vehicle may have turned
LONGEST_PAIR = 3.0
#: s, time for which fixes must have been refused before a new start by divergence: innovations that grow by
#: DIVERGED_SLOPE have then grown by more than fixes scatter
DIVERGED_AFTER = 2.0
#: m/s, smallest growth of the innovations of a filter that has diverged. Errors of a receiver grow more slowly, except
#: while it drifts
DIVERGED_SLOPE = 2.0
#: smallest growth as a share of the size of the innovations: those of a receiver that has jumped do not grow
DIVERGED_SHARE = 0.5
#: a slope is significant if its probability by noise alone is below this: one in a thousand rows of refused fixes
SIGNIFICANCE = 0.001
#: largest scatter of refused fixes that agree about their line, in standard deviations of a fix
AGREEMENT_SIGMAS = 2.0
#: m, added to the standard deviation: a vehicle that brakes or turns leaves the line by about this distance
AGREEMENT_FLOOR = 1.0
#: share of the size of the innovations that is added to the allowed scatter: with a wrong heading, the error of the
#: filter grows along a curve, not a line
AGREEMENT_SHARE = 0.3
#: m/s, standard deviation of the velocity after a new start, besides the noise of the fixes: change of a vehicle's
#: velocity between two fixes
NEW_VELOCITY_SIGMA = 0.5
#: m/s, smallest speed whose course gives a heading: at lower speeds the error of the velocity is too large
COURSE_SPEED = 3.0
#: rad, standard deviation of such a heading: sideslip, and turns between two fixes
COURSE_SIGMA = 0.2
#: rad, standard deviation above which a new heading is looked for: the filter is linear in the heading error up to
#: about 30 deg
LARGEST_YAW_SIGMA = 0.5


@njit(_nrt=False)
def note(mem, r, at):
    """Add the fix at `at` to the line of the fixes refused in a row; if it was not refused, clear the line.

    If the earlier fixes of the line do not agree with each other, a new line begins with this fix.
    """
    time = mem[at + Event.TIME]
    if mem[at + Event.VERDICT] != Verdict.REFUSED or _may_start(mem, r) and not _agree_as_claimed(mem, r):
        begin_line(mem, r + Nav.REFUSED, 0.0)
    if mem[at + Event.VERDICT] != Verdict.REFUSED:
        return
    if mem[r + Nav.REFUSED] == 0.0:
        mem[r + Nav.REFUSED + Line.SINCE] = time
    add_to_line(mem, r + Nav.REFUSED, time, mem[at + Event.Z_N], mem[at + Event.Z_E])


@njit(_nrt=False)
def _may_start(mem, r):
    """Whether enough fixes have been refused in a row for a new start, and for long enough. r: state at the latest
    one."""
    return (mem[r + Nav.REFUSED] >= FEWEST_ON_LINE
            and mem[r + Nav.FIX_TIME] - mem[r + Nav.REFUSED + Line.SINCE] >= DIVERGED_AFTER)


@njit(_nrt=False)
def _agree_as_claimed(mem, r):
    """Whether the refused fixes agree with each other within the claimed variance of the latest fix."""
    return _agree(mem, r, 2.0 * mem[r + Receiver.CLAIMED])


@njit(_nrt=False)
def are_refused(mem, r):
    """Whether right fixes have been refused in a row: they agree with each other and thus are no outliers. r: state at
    the latest one. False if the filter has diverged from them, as it then starts anew anyway."""
    return (_may_start(mem, r) and mem[r + Hypothesis.FIXES_WRONG] == 0.0 and _agree_as_claimed(mem, r)
            and not _diverged(mem, r, mem[r + Nav.FIX_TIME]))


@njit(_nrt=False)
def is_due(mem, r, at):
    """Whether the state at r starts anew from the fix at `at`.

    There are two reasons: a decision of `bank.py`, or refused fixes that are right. These have come for long enough and
    agree with each other: their innovations are near a line, as with errors of position and velocity.
    """
    if mem[r + Hypothesis.START_DUE] != 0.0:
        return True
    lasted = mem[at + Event.TIME] - mem[r + Nav.REFUSED + Line.SINCE]
    if mem[r + Nav.REFUSED] < FEWEST_ON_LINE or lasted < min(DIVERGED_AFTER, mem[Head.RECOVERY_TIME]):
        return False
    if lasted < mem[Head.RECOVERY_TIME] and not _diverged(mem, r, mem[at + Event.TIME]):
        return False
    return _agree(mem, r, mem[at + Event.R_NN] + mem[at + Event.R_EE])


@njit(_nrt=False)
def _agree(mem, r, claimed):
    """Whether the refused innovations are near their line. claimed: variance of a fix, sum of both components, m^2."""
    _, _, spread, _ = fit_line(mem, r + Nav.REFUSED)
    size = math.sqrt(mem[r + Nav.REFUSED + Line.SQUARE] / mem[r + Nav.REFUSED])
    sigma = math.sqrt(excess_scatter(mem, r) * claimed)
    return math.sqrt(spread) < AGREEMENT_SIGMAS * (sigma + AGREEMENT_FLOOR) + AGREEMENT_SHARE * size


@njit(_nrt=False)
def start_anew(mem, r, at):
    """Take position and velocity from the refused fixes and the heading from the course, with P in the scratch to
    match.

    The estimated sensor errors are kept with twice the standard deviation, as they may be wrong, too.
    """
    # with other decisions of `bank.py`, the fixes may have been wrong instead of the IMU: not counted as a divergence
    due, mem[r + Hypothesis.START_DUE] = mem[r + Hypothesis.START_DUE], 0.0
    if due == hypotheses.START_WITHOUT_IMU:
        diverged = True
        v_n, v_e, drift = hypotheses.velocity_if_imu_wrong(mem, r)
    else:
        diverged = due == 0.0 and _diverged(mem, r, mem[at + Event.TIME])
        v_n, v_e, drift = _velocity_of_fixes(mem, r, at, diverged)
    if diverged:
        mem[r + Nav.DIVERGENCE_TIME] = mem[at + Event.TIME]
    mem[r + Drift.TIME] = mem[r + Receiver.FIRST] = 0.0
    # earlier innovations were those of a wrong state
    reset_scale(mem, r + Receiver.INNOVATION_SCALE)
    for i in range(3):
        mem[r + Nav.LONG_PASSED + i] = mem[r + Receiver.SHORT_PASSED + i] = 0.0
    mem[r + Nav.VARIANCE_FACTOR] = 1.0
    (n, p), n_navigation = scratch_of(mem), int(mem[Head.N_NAVIGATION])
    for i in range(n):
        for j in range(n):
            if i >= n_navigation and j >= n_navigation:
                mem[p + n * i + j] *= 4.0
            else:
                mem[p + n * i + j] = 0.0
    for i in range(n_navigation):
        mem[r + NAV + i] = 0.0
        forget(mem, i, n)
    mem[r + Nav.LATITUDE], mem[r + Nav.LONGITUDE] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]
    mem[r + Nav.V_N], mem[r + Nav.V_E] = v_n, v_e
    variance = _fix_variance(mem, r, at)
    arm = mem[Head.LEVER_X] ** 2 + mem[Head.LEVER_Y] ** 2 + mem[Head.LEVER_Z] ** 2
    for i in range(2):
        mem[p + (n + 1) * i] = variance + arm
    first = velocity_state(mem)
    for i in range(2):
        mem[p + (n + 1) * (first + i)] = drift
    height_variance = 4.0 * variance
    if row_of(mem, Error.R_D) >= 0:
        mem[r + Nav.V_D] = 0.0
        if is_without_altitude(mem[at + Event.R_DD]):
            height_variance = NO_ALTITUDE_SIGMA**2
        else:
            mem[r + Nav.HEIGHT] = mem[at + Event.HEIGHT]
    for error, value in ((Error.R_D, height_variance), (Error.V_D, NEW_VELOCITY_SIGMA**2),
                         (Error.PHI_N, UNKNOWN_TILT_SIGMA**2), (Error.PHI_E, UNKNOWN_TILT_SIGMA**2)):
        state = row_of(mem, error)
        if state >= 0:
            mem[p + (n + 1) * state] = value
    take_course(mem, r, v_n, v_e, drift)
    mem[r + Nav.RECOVERIES] += 1.0
    mem[r + Hypothesis.CONSISTENT] = 1.0


@njit(_nrt=False)
def _since_last_fix(mem, r, at):
    """Displacement from the last fix to that at `at`, north and east, m."""
    return ((mem[at + Event.LATITUDE] - mem[r + Nav.FIX_LATITUDE]) / mem[r + Nav.NORTH_SCALE],
            (mem[at + Event.LONGITUDE] - mem[r + Nav.FIX_LONGITUDE]) / mem[r + Nav.EAST_SCALE])


@njit(_nrt=False)
def _fix_variance(mem, r, at):
    """Variance of the fix at `at`, sum of both components, m^2: the larger of the learned one and that of the refused
    fixes about their line."""
    variance = excess_scatter(mem, r) * (mem[at + Event.R_NN] + mem[at + Event.R_EE])
    if mem[r + Nav.REFUSED] == 0.0:
        return variance
    _, _, spread, _ = fit_line(mem, r + Nav.REFUSED)
    # the line of each component has two fitted parameters
    return max(variance, spread * mem[r + Nav.REFUSED] / max(mem[r + Nav.REFUSED] - 2.0, 1.0))


@njit(_nrt=False)
def _velocity_of_fixes(mem, r, at, diverged):
    """Velocity (north, east) by the refused fixes, and its variance.

    If the filter has diverged, its own velocity may be wrong, and the last two fixes are used. Else it is the velocity
    of the filter minus the slope of the line.
    """
    slope_n, slope_e, _, variance = fit_line(mem, r + Nav.REFUSED)
    interval = mem[at + Event.TIME] - mem[r + Nav.FIX_TIME]
    if not diverged or not 0.0 < interval < LONGEST_PAIR:
        return mem[r + Nav.V_N] - slope_n, mem[r + Nav.V_E] - slope_e, NEW_VELOCITY_SIGMA**2 + variance
    north, east = _since_last_fix(mem, r, at)
    return (north / interval, east / interval,
            NEW_VELOCITY_SIGMA**2 + (GAP_ACCELERATION * interval) ** 2 + _fix_variance(mem, r, at) / interval**2)


@njit(_nrt=False)
def _diverged(mem, r, time):
    """Whether the filter has diverged from the fixes refused until `time`, s.

    The innovations then grow. If instead the receiver has jumped, they stay constant.
    """
    slope_n, slope_e, _, variance = fit_line(mem, r + Nav.REFUSED)
    slope, free = math.hypot(slope_n, slope_e), max(mem[r + Nav.REFUSED] - 2.0, 1.0)
    if math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]) < COURSE_SPEED:
        return False  # a filter that hardly moves does not diverge
    size = math.sqrt(mem[r + Nav.REFUSED + Line.SQUARE] / mem[r + Nav.REFUSED])
    # probability that fixes that only scatter have such a slope: F distribution with 2 and 2 (n - 2) degrees of freedom
    chance = (1.0 + 0.5 * slope * slope / (free * max(variance, 1e-9))) ** -free
    return (slope > DIVERGED_SLOPE and chance < SIGNIFICANCE
            and slope * (time - mem[r + Nav.REFUSED + Line.SINCE]) > DIVERGED_SHARE * size)


@njit(_nrt=False)
def take_course(mem, r, v_n, v_e, drift):
    """Set the heading to the course of a velocity, with its variance in P of the scratch. At low speed, the heading
    becomes unknown.

    drift: variance of the velocity, m^2/s^2.
    """
    (n, p), k = scratch_of(mem), yaw_state(mem)
    for i in range(n):
        mem[p + n * k + i] = mem[p + n * i + k] = 0.0
    forget(mem, k, n)
    if math.hypot(v_n, v_e) < COURSE_SPEED:
        mem[p + (n + 1) * k] = UNKNOWN_YAW_SIGMA**2
        return
    yaw, variance = math.atan2(v_e, v_n), COURSE_SIGMA**2 + drift / (v_n**2 + v_e**2)
    mounting = int(mem[Head.MOUNTING_YAW])
    if mounting >= 0:  # the course is that of the vehicle's axis, from which the body's differs by the mounting
        yaw -= mem[r + NAV + mounting]
        variance += mem[p + (n + 1) * mounting]
    mem[p + (n + 1) * k] = variance
    set_heading(mem, r, yaw)


@njit(_nrt=False)
def course_velocity(mem, r, at):
    """Velocity between the last fix and that at `at`, for a new heading. Zeros if the heading is known or the velocity
    is too uncertain."""
    (n, p), k = scratch_of(mem), yaw_state(mem)
    interval = mem[at + Event.TIME] - mem[r + Nav.FIX_TIME]
    if (mem[Head.GATE] == 0.0 or mem[p + (n + 1) * k] < LARGEST_YAW_SIGMA**2 or mem[r + Nav.FIX_TIME] == 0.0
            or not 0.0 < interval < LONGEST_PAIR):
        return 0.0, 0.0
    north, east = _since_last_fix(mem, r, at)
    sigma = math.sqrt(2.0 * excess_scatter(mem, r) * (mem[at + Event.R_NN] + mem[at + Event.R_EE]))
    if math.hypot(north, east) < sigma / COURSE_SIGMA:
        return 0.0, 0.0
    return north / interval, east / interval
