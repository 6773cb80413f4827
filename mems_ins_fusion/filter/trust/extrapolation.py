"""A receiver without satellites that extrapolates: its fixes lie on a straight line, evenly spaced.

Where the vehicle keeps its velocity, too, such fixes fit; where it brakes or turns, the filter has the choice between
them and the IMU. But fixes that are measured scatter, and these follow from those before them to the centimetre. A
test of two hypotheses against each other, fix by fix: extrapolated, and measured (E. S. Page, "Continuous inspection
schemes", Biometrika 41, 1954; A. Wald, *Sequential Analysis*, 1947). Where the fixes then depart from the path that
the inertial sensors show, those on the line are refused, and those that have been used by then are withdrawn: a
receiver that smooths follows a line, too, but with the vehicle.
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
    BEGIN=3,  # a fix: time, s, latitude and longitude, rad,
    LAST=3,  # and a later one; the next is compared with the line through both
    NATS=1,  # logarithm of the likelihood ratio,
    SINCE=1,  # s: which fixes it is about: from this time on,
    MOVED=4,  # m, m/s, north and east: how far they have moved position and velocity since then
    REPORTED=1,  # 1: the kernel knows of these
    SCATTER=1,  # m^2, on each axis: mean square of how a fix is off less how the one before it was,
    COUNT=1,  # of so many fixes,
    CLAIMED=1)  # and what these claim in the mean, m^2, north and east
#: s: the fixes from this time on have turned out to be wrong, of which the kernel does not know yet; 0: none
Wrong = HEAD.place('Wrong', SINCE=1)

#: m: extrapolated fixes lie on the line to this sigma on each axis, the last digits of the positions included
LINE_SIGMA = 0.05
#: multiple of LINE_SIGMA: a receiver that scatters by less than this cannot be told from one that extrapolates
LEAST_RATIO = 4.0
#: s: fixes further apart are not extrapolated from each other; the slowest receivers send one each ten seconds
LONGEST_STEP = 15.0
#: s: the residual of a used fix before the last one is compared with the next up to this age, for which an IMU holds
LONGEST_COMPARED = 3.0
#: nats that one fix may add at most: of measured ones, too, one lies on the line by chance
LARGEST_EVIDENCE = 5.0
#: nats above which no more are gathered: one fix off the line ends it in any case
LARGEST_NATS = 15.0
#: fixes from which on its scatter is used: it is then known to a fifth
FEWEST_FIXES = 30.0
#: fixes over which the scatter is a mean: known to a tenth, and of the last minutes
SCATTER_MEMORY = 100.0
#: a squared change counts as so many times the mean at most: one jump is not the scatter
LARGEST_SQUARE = 4.0
#: sigmas that fixes claim: beyond this they have departed from the vehicle
DEPARTED = 2.0


@njit(_nrt=False)
def is_extrapolated(mem, r, at, z_n, z_e):
    """Whether the fix at `at` comes from a receiver that extrapolates, or is withdrawn; it is remembered.

    z_n, z_e: predicted minus measured position, m, without what the filter knows of its errors in open loop.
    """
    claimed = mem[at + Event.R_NN] + mem[at + Event.R_EE]
    better = CLAIM_CHANGE * claimed < mem[r + Extrapolation.CLAIMED]
    if better:  # measured otherwise, as with a base, which follows a straight road to the centimetre
        mem[r + Extrapolation.SCATTER] = mem[r + Extrapolation.COUNT] = mem[r + Extrapolation.CLAIMED] = 0.0
    begin, last = r + Extrapolation.BEGIN, r + Extrapolation.LAST
    time, latitude, longitude = mem[at + Event.TIME], mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]
    step, length = time - mem[last], mem[last] - mem[begin]
    scatter = _scatter(mem, r, claimed)
    known = (0.0 < step < LONGEST_STEP and length > 0.0 and mem[begin] != 0.0
             and mem[r + Extrapolation.COUNT] >= FEWEST_FIXES and scatter > (LEAST_RATIO * LINE_SIGMA) ** 2)
    if known and mem[r + Extrapolation.NATS] == 0.0:
        mem[r + Extrapolation.SINCE] = mem[last]  # if it is extrapolated, so was the last one
        known = length < LONGEST_STEP
    changed_n, changed_e = _residual_change(mem, r, time, step, z_n, z_e)
    for i in range(2):
        mem[r + Extrapolation.MOVED + i] += step * mem[r + Extrapolation.MOVED + 2 + i]
    squared = changed_n * changed_n + changed_e * changed_e
    nats = 0.0
    if known:
        nats = mem[r + Extrapolation.NATS] + min(_evidence(mem, r, at, squared, scatter), LARGEST_EVIDENCE)
    mem[r + Extrapolation.NATS] = min(max(nats, 0.0), LARGEST_NATS)
    if mem[r + Extrapolation.NATS] == 0.0:  # else the line goes on from where it began: a slow bend is none
        mem[r + Extrapolation.REPORTED] = 0.0
        for i in range(4):
            mem[r + Extrapolation.MOVED + i] = 0.0
        for i in range(3):
            mem[begin + i] = mem[last + i]
    mem[last], mem[last + 1], mem[last + 2] = time, latitude, longitude
    departed = (z_n - mem[r + Extrapolation.MOVED]) ** 2 + (z_e - mem[r + Extrapolation.MOVED + 1]) ** 2
    imu_is_right = mem[r + Nav.USE_ALL_FIXES] == 0.0 and mem[r + Nav.BRIDGED] == 0.0  # and used
    found = known and mem[r + Extrapolation.NATS] > -math.log(hypotheses.FAULT_RATE * step) and (
        mem[r + Extrapolation.REPORTED] != 0.0
        or imu_is_right and moves(mem, r) and departed > DEPARTED * DEPARTED * claimed)
    if mem[Head.GATE] > 0.0 and found or mem[at + Event.WITHDRAWN] != 0.0:
        return True
    if not better:  # how it is off less how the one before it was, is the error of that
        _learn(mem, r, 0.5 * squared, claimed)
    return False


@njit(_nrt=False)
def refuse_fix(mem, r, at):
    """Refuse the fix at `at`, and report those before it that have been used to the kernel."""
    mem[at + Event.VERDICT], mem[at + Event.WEIGHT] = Verdict.EXTRAPOLATED, 0.0
    mem[r + Hypothesis.START_DUE] = 0.0
    if mem[r + Extrapolation.REPORTED] == 0.0 and mem[at + Event.WITHDRAWN] == 0.0:
        mem[Wrong.SINCE] = mem[r + Extrapolation.SINCE]
    mem[r + Extrapolation.REPORTED] = 1.0


@njit(_nrt=False)
def are_found(mem, r):
    """Whether the latest fixes are certainly extrapolated, as the filter with the state at r sees them."""
    return mem[r + Extrapolation.REPORTED] != 0.0


@njit(_nrt=False)
def odds(mem, r):
    """Nats by which the latest fixes are more likely extrapolated than measured, with the rate at which receivers fail;
    0 where they are not."""
    return max(mem[r + Extrapolation.NATS] + math.log(hypotheses.FAULT_RATE), 0.0)


@njit(_nrt=False)
def note_move(mem, r, before, after):
    """Remember what a fix on the line has done to the state at r: its position and velocity before and after that."""
    if mem[r + Extrapolation.NATS] > 0.0:
        hypotheses.add_move(mem, r, r + Extrapolation.MOVED, before, after)


@njit(_nrt=False)
def _scatter(mem, r, claimed):
    """Mean square of what is off from fix to fix, m^2 on each axis: what has been seen, but no more than that of two
    fixes that are as sure as this one, which has `claimed` m^2 (north and east), is by what the receiver has shown. A
    filter that is wrong itself sees more, and a receiver to a centimetre follows every straight road."""
    return min(mem[r + Extrapolation.SCATTER], realised_scatter(mem, r) * claimed)


@njit(_nrt=False)
def _evidence(mem, r, at, changed, scatter):
    """Logarithm of the density of the fix at `at` for a receiver that extrapolates, less that for one that measures.

    changed: square of what `_residual_change` says, m^2. scatter: what `_scatter` says.
    """
    begin, last = r + Extrapolation.BEGIN, r + Extrapolation.LAST
    part = (mem[at + Event.TIME] - mem[last]) / (mem[last] - mem[begin])
    north = mem[at + Event.LATITUDE] - mem[last + 1] - part * (mem[last + 1] - mem[begin + 1])
    east = mem[at + Event.LONGITUDE] - mem[last + 2] - part * (mem[last + 2] - mem[begin + 2])
    off = (north / mem[r + Nav.NORTH_SCALE]) ** 2 + (east / mem[r + Nav.EAST_SCALE]) ** 2
    # a receiver that has scattered less than now still measures
    scatter = max(scatter, 0.5 * changed)
    # one that measures to the centimetre lies on the line, too, where the vehicle goes straight on and the IMU is wrong
    claimed = 0.5 * (mem[at + Event.R_NN] + mem[at + Event.R_EE])
    by_claim = max(claimed, LINE_SIGMA * LINE_SIGMA) * (1.0 + part * part + (1.0 + part) ** 2)
    measured = max(_log_density(changed, scatter), _log_density(off, by_claim))
    return _log_density(off, LINE_SIGMA * LINE_SIGMA) - measured


@njit(_nrt=False)
def _residual_change(mem, r, time, step, z_n, z_e):
    """How the fix is off less how the last one was that was used, m; zeros where that is too long ago. step: s, since
    the fix before it."""
    since = time - mem[r + Nav.RESIDUAL_TIME]
    if (mem[r + Nav.RESIDUAL_TIME] == 0.0 or not 0.0 < since < LONGEST_STEP
            or since > step and since >= LONGEST_COMPARED):
        return 0.0, 0.0
    return z_n - mem[r + Nav.RESIDUAL_N], z_e - mem[r + Nav.RESIDUAL_E]


@njit(_nrt=False)
def _learn(mem, r, squared, claimed):
    """The scatter from fix to fix, from one square of it, m^2 on each axis. claimed: m^2, by the fix."""
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
    """Of a vector in the plane whose square is given, with the same variance on each axis."""
    return -0.5 * squared / variance - math.log(2.0 * math.pi * variance)
