"""Detection of a receiver that extrapolates without satellites: its fixes lie evenly spaced on a straight line.

Such fixes agree with the filter as long as the vehicle keeps its velocity, and contradict the IMU when it brakes or
turns. Measured fixes scatter, while each extrapolated fix follows from the ones before it to a centimetre. A sequential
test compares the two hypotheses, extrapolated and measured, with each fix (E. S. Page, "Continuous inspection schemes",
Biometrika 41, 1954; A. Wald, *Sequential Analysis*, 1947). A receiver that smooths its positions also follows a
straight line, but with the vehicle. So fixes are refused only after they have departed from the path by the inertial
sensors; those on the line that were used before are withdrawn.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, ROW, Event, Head, Nav, Verdict
from . import hypotheses
from .hypotheses import Hypothesis
from .receiver import CLAIM_CHANGE, realised_scatter
from .standstill import moves

#: of a state
Extrapolation = ROW.place(
    'Extrapolation',
    BEGIN=3,  # first fix on the line: time, s, latitude and longitude, rad,
    LAST=3,  # and latest one; the next fix is compared with the line through both
    NATS=1,  # logarithm of the likelihood ratio, extrapolated over measured,
    SINCE=1,  # s, time of the first fix that it refers to,
    MOVED=4,  # m, m/s, north and east: change of position and velocity by the fixes since then
    REPORTED=1,  # 1: these fixes have been reported to the kernel (`Wrong`)
    SCATTER=1,  # m^2 per axis: mean square of the change of the residual from one fix to the next,
    COUNT=1,  # the number of fixes in it,
    CLAIMED=1)  # and the mean of the variance that they claim, m^2, north plus east
#: s, time from which on fixes have turned out to be wrong, for the kernel; 0: none
Wrong = HEAD.place('Wrong', SINCE=1)

#: m, standard deviation per axis of extrapolated fixes from the line, rounding of the positions included
LINE_SIGMA = 0.05
#: smallest scatter of a receiver over LINE_SIGMA with which it can be told from one that extrapolates
LEAST_RATIO = 4.0
#: s, longest interval between fixes of one line: the slowest receivers send a fix each ten seconds
LONGEST_STEP = 15.0
#: s, largest age of the residual with which a fix is compared if it is not that of the previous fix: the drift of the
#: IMU in this time is small
LONGEST_COMPARED = 3.0
#: nats, upper limit of the evidence of one fix: a measured fix may also lie on the line by chance
LARGEST_EVIDENCE = 5.0
#: nats, upper limit of the sum: one fix that is not on the line has to end it
LARGEST_NATS = 15.0
#: number of fixes after which the scatter is used: it is then known to a fifth
FEWEST_FIXES = 30.0
#: number of fixes over which the scatter is averaged: it is known to a tenth then, and is that of the last minutes
SCATTER_MEMORY = 100.0
#: upper limit of one squared change over the mean, so that a single jump does not count as scatter
LARGEST_SQUARE = 4.0
#: number of claimed standard deviations beyond which fixes have departed from the path by the inertial sensors
DEPARTED = 2.0


@njit(_nrt=False)
def is_extrapolated(mem, r, at, z_n, z_e):
    """Whether the fix at `at` comes from a receiver that extrapolates, or was withdrawn. Updates the test.

    z_n, z_e: predicted minus measured position, m, after removal of the estimated errors of the state (open loop).
    """
    claimed = mem[at + Event.R_NN] + mem[at + Event.R_EE]
    better = CLAIM_CHANGE * claimed < mem[r + Extrapolation.CLAIMED]
    if better:  # another mode of the receiver, such as RTK, whose fixes on a straight road are on a line
        mem[r + Extrapolation.SCATTER] = mem[r + Extrapolation.COUNT] = mem[r + Extrapolation.CLAIMED] = 0.0
    begin, last = r + Extrapolation.BEGIN, r + Extrapolation.LAST
    time, latitude, longitude = mem[at + Event.TIME], mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]
    step, length = time - mem[last], mem[last] - mem[begin]
    scatter = _scatter(mem, r, claimed)
    known = (0.0 < step < LONGEST_STEP and length > 0.0 and mem[begin] != 0.0
             and mem[r + Extrapolation.COUNT] >= FEWEST_FIXES and scatter > (LEAST_RATIO * LINE_SIGMA) ** 2)
    if known and mem[r + Extrapolation.NATS] == 0.0:
        mem[r + Extrapolation.SINCE] = mem[last]  # if this fix is extrapolated, so was the previous one
        known = length < LONGEST_STEP
    changed_n, changed_e = _residual_change(mem, r, time, step, z_n, z_e)
    for i in range(2):
        mem[r + Extrapolation.MOVED + i] += step * mem[r + Extrapolation.MOVED + 2 + i]
    squared = changed_n * changed_n + changed_e * changed_e
    nats = 0.0
    if known:
        nats = mem[r + Extrapolation.NATS] + min(_evidence(mem, r, at, squared, scatter), LARGEST_EVIDENCE)
    mem[r + Extrapolation.NATS] = min(max(nats, 0.0), LARGEST_NATS)
    if mem[r + Extrapolation.NATS] == 0.0:  # otherwise the line keeps its begin, so that a slow bend is not one
        mem[r + Extrapolation.REPORTED] = 0.0
        for i in range(4):
            mem[r + Extrapolation.MOVED + i] = 0.0
        for i in range(3):
            mem[begin + i] = mem[last + i]
    mem[last], mem[last + 1], mem[last + 2] = time, latitude, longitude
    departed = (z_n - mem[r + Extrapolation.MOVED]) ** 2 + (z_e - mem[r + Extrapolation.MOVED + 1]) ** 2
    imu_is_right = mem[r + Nav.USE_ALL_FIXES] == 0.0 and mem[r + Nav.BRIDGED] == 0.0
    found = known and mem[r + Extrapolation.NATS] > -math.log(hypotheses.FAULT_RATE * step) and (
        mem[r + Extrapolation.REPORTED] != 0.0
        or imu_is_right and moves(mem, r) and departed > DEPARTED * DEPARTED * claimed)
    if mem[Head.GATE] > 0.0 and found or mem[at + Event.WITHDRAWN] != 0.0:
        return True
    if not better:  # in another mode of the receiver the change is dominated by the error of the previous fix
        _learn(mem, r, 0.5 * squared, claimed)
    return False


@njit(_nrt=False)
def refuse_fix(mem, r, at):
    """Refuse the fix at `at`, and report the fixes before it that were used to the kernel."""
    mem[at + Event.VERDICT], mem[at + Event.WEIGHT] = Verdict.EXTRAPOLATED, 0.0
    mem[r + Hypothesis.START_DUE] = 0.0
    if mem[r + Extrapolation.REPORTED] == 0.0 and mem[at + Event.WITHDRAWN] == 0.0:
        mem[Wrong.SINCE] = mem[r + Extrapolation.SINCE]
    mem[r + Extrapolation.REPORTED] = 1.0


@njit(_nrt=False)
def are_found(mem, r):
    """Whether the filter with the state at r has found the latest fixes to be extrapolated."""
    return mem[r + Extrapolation.REPORTED] != 0.0


@njit(_nrt=False)
def odds(mem, r):
    """Nats by which the latest fixes are more likely extrapolated than measured, with the rate at which receivers fail;
    0 where they are not."""
    return max(mem[r + Extrapolation.NATS] + math.log(hypotheses.FAULT_RATE), 0.0)


@njit(_nrt=False)
def note_move(mem, r, before, after):
    """Add the correction of the state at r by a fix on the line. before, after: `position_and_velocity`."""
    if mem[r + Extrapolation.NATS] > 0.0:
        hypotheses.add_move(mem, r, r + Extrapolation.MOVED, before, after)


@njit(_nrt=False)
def _scatter(mem, r, claimed):
    """Mean square change of the residual from one fix to the next, m^2 per axis. claimed: variance of the fix, north
    plus east, m^2.

    Its upper limit is what two fixes with this claim have by the learned scatter of the receiver: residuals of a filter
    that is wrong itself change by more.
    """
    return min(mem[r + Extrapolation.SCATTER], realised_scatter(mem, r) * claimed)


@njit(_nrt=False)
def _evidence(mem, r, at, changed, scatter):
    """Log likelihood of the fix at `at` for a receiver that extrapolates, minus that for one that measures.

    changed: square of `_residual_change`, m^2. scatter: result of `_scatter`, m^2.
    """
    begin, last = r + Extrapolation.BEGIN, r + Extrapolation.LAST
    part = (mem[at + Event.TIME] - mem[last]) / (mem[last] - mem[begin])
    north = mem[at + Event.LATITUDE] - mem[last + 1] - part * (mem[last + 1] - mem[begin + 1])
    east = mem[at + Event.LONGITUDE] - mem[last + 2] - part * (mem[last + 2] - mem[begin + 2])
    off = (north / mem[r + Nav.NORTH_SCALE]) ** 2 + (east / mem[r + Nav.EAST_SCALE]) ** 2
    # a change that is larger than the usual scatter is no evidence of extrapolation
    scatter = max(scatter, 0.5 * changed)
    # fixes with centimetre accuracy are also on the line if the vehicle drives straight and the IMU is wrong
    claimed = 0.5 * (mem[at + Event.R_NN] + mem[at + Event.R_EE])
    by_claim = max(claimed, LINE_SIGMA * LINE_SIGMA) * (1.0 + part * part + (1.0 + part) ** 2)
    measured = max(_log_density(changed, scatter), _log_density(off, by_claim))
    return _log_density(off, LINE_SIGMA * LINE_SIGMA) - measured


@njit(_nrt=False)
def _residual_change(mem, r, time, step, z_n, z_e):
    """Residual of the fix minus that of the last fix used, north and east, m; zeros if that was too long ago. step: s
    since the previous fix."""
    since = time - mem[r + Nav.RESIDUAL_TIME]
    if (mem[r + Nav.RESIDUAL_TIME] == 0.0 or not 0.0 < since < LONGEST_STEP
            or since > step and since >= LONGEST_COMPARED):
        return 0.0, 0.0
    return z_n - mem[r + Nav.RESIDUAL_N], z_e - mem[r + Nav.RESIDUAL_E]


@njit(_nrt=False)
def _learn(mem, r, squared, claimed):
    """Update the scatter with one squared change of the residual, m^2 per axis. claimed: variance of the fix, m^2."""
    if squared == 0.0:
        return
    mem[r + Extrapolation.COUNT] += 1.0
    if mem[r + Extrapolation.COUNT] > 1.0:
        squared = min(squared, LARGEST_SQUARE * mem[r + Extrapolation.SCATTER])
    count = min(mem[r + Extrapolation.COUNT], SCATTER_MEMORY)
    mem[r + Extrapolation.SCATTER] += (squared - mem[r + Extrapolation.SCATTER]) / count
    mem[r + Extrapolation.SCATTER] = max(mem[r + Extrapolation.SCATTER], 1e-6)
    mem[r + Extrapolation.CLAIMED] += (claimed - mem[r + Extrapolation.CLAIMED]) / count


@njit(_nrt=False)
def _log_density(squared, variance):
    """Log density of a normal vector in the plane. squared: its square. variance: that of each axis."""
    return -0.5 * squared / variance - math.log(2.0 * math.pi * variance)
