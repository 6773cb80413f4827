"""New starts: of the whole state from fixes that were refused although they are right, of the heading from the course.

Sums over a row of refused fixes (`Nav.REFUSED` and the columns after it) give a line through their innovations. Fixes
that lie on it agree with each other, and its slope tells whether the filter has diverged from them.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..history import forget
from ..measurements.geometry import set_heading
from ..memory import NAV, Error, Event, Head, Nav, Verdict, row_of, velocity_state, yaw_state
from ..prediction import GAP_ACCELERATION, UNKNOWN_TILT_SIGMA, UNKNOWN_YAW_SIGMA
from ..update import scratch_of
from . import hypotheses
from .drift import Drift
from .hypotheses import Hypothesis
from .line import FEWEST_ON_LINE, Line, add_to_line, begin_line, fit_line
from .receiver import Receiver, excess_scatter
from .scale import reset_scale

#: s: fixes further apart say nothing of the course, as the vehicle may have turned between them
LONGEST_PAIR = 3.0
#: s after which a filter that diverges from refused fixes starts anew from them: innovations that grow by
#: DIVERGED_SLOPE have then grown by more than fixes scatter
DIVERGED_AFTER = 2.0
#: m/s, by which they then grow at least: a receiver's errors do not, but for one that drifts
DIVERGED_SLOPE = 2.0
#: share of the size of the refused innovations by which they have grown where the filter diverged from the fixes: those
#: of a receiver that jumped stay as they were
DIVERGED_SHARE = 0.5
#: probability below which it is significant that innovations of fixes that only scatter have a slope: one in a thousand
#: rows of refused fixes
SIGNIFICANCE = 0.001
#: sigmas by which refused fixes that agree scatter about a line at most
AGREEMENT_SIGMAS = 2.0
#: m more: a vehicle that brakes or turns leaves the line by about so much
AGREEMENT_FLOOR = 1.0
#: and this share of how far they are off, as the line of a filter that turned away is none
AGREEMENT_SHARE = 0.3
#: m/s, sigma of a new start's velocity besides what the fixes tell: what a vehicle gains between two of them
NEW_VELOCITY_SIGMA = 0.5
#: m/s above which a course is a heading: slower, errors of the velocity turn it too far
COURSE_SPEED = 3.0
#: rad, sigma of such a heading: sideslip, turns between two fixes
COURSE_SIGMA = 0.2
#: rad, sigma beyond which a heading is sought anew: the equations are linear in its error, to about 30 deg
LARGEST_YAW_SIGMA = 0.5


@njit(_nrt=False)
def note(mem, r, at):
    """Add the fix at `at`, which has been judged, to the sums over fixes refused in a row that agree.

    Where those before it do not agree, the row begins with this fix: a receiver that was wrong is right again.
    """
    time = mem[at + Event.TIME]
    if mem[at + Event.VERDICT] != Verdict.REFUSED or _may_start(mem, r) and not _agree_as_claimed(mem, r):
        begin_line(mem, r + Nav.REFUSED, 0.0)
    if mem[at + Event.VERDICT] != Verdict.REFUSED:
        return
    if mem[r + Nav.REFUSED] == 0.0:
        mem[r + Nav.REFUSED + Line.SINCE] = time
    add_to_line(mem, r + Nav.REFUSED, time, mem[at + Event.Z_N], mem[at + Event.Z_E], 1.0)


@njit(_nrt=False)
def _may_start(mem, r):
    """Whether so many fixes have been refused in a row, and for so long, the latest with the state at r, that they are
    no outliers where they agree."""
    return (mem[r + Nav.REFUSED] >= FEWEST_ON_LINE
            and mem[r + Nav.FIX_TIME] - mem[r + Nav.REFUSED + Line.SINCE] >= DIVERGED_AFTER)


@njit(_nrt=False)
def _agree_as_claimed(mem, r):
    """Whether the refused innovations lie on a line, for fixes that claim what the latest one does."""
    return _agree(mem, r, 2.0 * mem[r + Receiver.CLAIMED])


@njit(_nrt=False)
def are_refused(mem, r):
    """Whether several fixes have been refused in a row, the latest with the state at r, and agree so well that they are
    no outliers; not where the filter is certainly wrong."""
    return (_may_start(mem, r) and mem[r + Hypothesis.FIXES_WRONG] == 0.0 and _agree_as_claimed(mem, r)
            and not _diverged(mem, r, mem[r + Nav.FIX_TIME]))


@njit(_nrt=False)
def is_due(mem, r, at):
    """Whether the state at r starts anew from the fix at `at`: `bank.py` has decided so, or those refused before it
    were right. They have come for long enough, and their innovations lie on a line, as the error of a position and a
    velocity would."""
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
    """Whether the refused innovations lie on a line; claimed: variance of a fix, both components, m^2."""
    _, _, spread, _ = fit_line(mem, r + Nav.REFUSED)
    size = math.sqrt(mem[r + Nav.REFUSED + Line.SQUARE] / mem[r + Nav.REFUSED])
    sigma = math.sqrt(excess_scatter(mem, r) * claimed)
    return math.sqrt(spread) < AGREEMENT_SIGMAS * (sigma + AGREEMENT_FLOOR) + AGREEMENT_SHARE * size


@njit(_nrt=False)
def start_anew(mem, r, at):
    """Take position and velocity from the refused fixes, the heading from the course, with P in the scratch to match.

    The sensor errors stay as estimated, with twice the sigma: what was wrong may have spoiled them, too.
    """
    # where it may as well be the fixes that are wrong, nothing is said against the IMU
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
    # the innovations until now were those of a state that was wrong
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
    if row_of(mem, Error.R_D) >= 0:
        mem[r + Nav.HEIGHT], mem[r + Nav.V_D] = mem[at + Event.HEIGHT], 0.0
    for error, value in ((Error.R_D, 4.0 * variance), (Error.V_D, NEW_VELOCITY_SIGMA**2),
                         (Error.PHI_N, UNKNOWN_TILT_SIGMA**2), (Error.PHI_E, UNKNOWN_TILT_SIGMA**2)):
        state = row_of(mem, error)
        if state >= 0:
            mem[p + (n + 1) * state] = value
    take_course(mem, r, v_n, v_e, drift)
    mem[r + Nav.RECOVERIES] += 1.0
    mem[r + Hypothesis.CONSISTENT] = 1.0


@njit(_nrt=False)
def _since_last_fix(mem, r, at):
    """Way from the last fix to that at `at`, north and east, m."""
    return ((mem[at + Event.LATITUDE] - mem[r + Nav.FIX_LATITUDE]) / mem[r + Nav.NORTH_SCALE],
            (mem[at + Event.LONGITUDE] - mem[r + Nav.FIX_LONGITUDE]) / mem[r + Nav.EAST_SCALE])


@njit(_nrt=False)
def _fix_variance(mem, r, at):
    """Variance of the fix at `at`, both components, m^2: as fixes have been seen to scatter, or as the refused ones
    scatter about their line, where that is more."""
    variance = excess_scatter(mem, r) * (mem[at + Event.R_NN] + mem[at + Event.R_EE])
    if mem[r + Nav.REFUSED] == 0.0:
        return variance
    _, _, spread, _ = fit_line(mem, r + Nav.REFUSED)
    # each component's line has two numbers that are fitted to them
    return max(variance, spread * mem[r + Nav.REFUSED] / max(mem[r + Nav.REFUSED] - 2.0, 1.0))


@njit(_nrt=False)
def _velocity_of_fixes(mem, r, at, diverged):
    """Velocity (north, east) that the refused fixes show, and its variance: by how they drift from the filter, whose
    own may be of no use where it has diverged, or by the last two of them."""
    slope_n, slope_e, _, variance = fit_line(mem, r + Nav.REFUSED)
    interval = mem[at + Event.TIME] - mem[r + Nav.FIX_TIME]
    if not diverged or not 0.0 < interval < LONGEST_PAIR:
        return mem[r + Nav.V_N] - slope_n, mem[r + Nav.V_E] - slope_e, NEW_VELOCITY_SIGMA**2 + variance
    north, east = _since_last_fix(mem, r, at)
    return (north / interval, east / interval,
            NEW_VELOCITY_SIGMA**2 + (GAP_ACCELERATION * interval) ** 2 + _fix_variance(mem, r, at) / interval**2)


@njit(_nrt=False)
def _diverged(mem, r, time):
    """Whether it was the filter that diverged from the fixes refused until `time`, s: from those of a receiver that
    jumps it stays as far as at first."""
    slope_n, slope_e, _, variance = fit_line(mem, r + Nav.REFUSED)
    slope, free = math.hypot(slope_n, slope_e), max(mem[r + Nav.REFUSED] - 2.0, 1.0)
    if math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]) < COURSE_SPEED:
        return False  # who hardly moves cannot diverge
    size = math.sqrt(mem[r + Nav.REFUSED + Line.SQUARE] / mem[r + Nav.REFUSED])
    # probability of such a slope of fixes that only scatter: F distribution with 2 and 2 (n - 2) degrees of freedom
    chance = (1.0 + 0.5 * slope * slope / (free * max(variance, 1e-9))) ** -free
    return (slope > DIVERGED_SLOPE and chance < SIGNIFICANCE
            and slope * (time - mem[r + Nav.REFUSED + Line.SINCE]) > DIVERGED_SHARE * size)


@njit(_nrt=False)
def take_course(mem, r, v_n, v_e, drift):
    """Heading from the course of a velocity, with its variance in P of the scratch; unknown if it is too slow.

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
    if mounting >= 0:  # the vehicle goes along its own axis, the body is turned by that
        yaw -= mem[r + NAV + mounting]
        variance += mem[p + (n + 1) * mounting]
    mem[p + (n + 1) * k] = variance
    set_heading(mem, r, yaw)


@njit(_nrt=False)
def course_velocity(mem, r, at):
    """Whether the heading is unknown and the way since the last fix tells it: the velocity then, else zeros."""
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
