"""A receiver without satellites that goes on at its last velocity: its fixes lie on a straight line, evenly spaced.

Where the vehicle goes straight on, too, such fixes fit; where it brakes or turns, the filter has the choice between
them and the IMU. But fixes that are measured scatter, and these follow from those before them to the centimetre. A
test of two hypotheses against each other, fix by fix: extrapolated, and measured (E. S. Page, "Continuous inspection
schemes", Biometrika 41, 1954; A. Wald, *Sequential Analysis*, 1947). Where the fixes then depart from the way that
the inertial sensors see, those on the line are refused, and those that have been believed by then are withdrawn: a
receiver that smooths follows a line, too, but with the vehicle.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, ROW, Event, Head, Nav, Verdict
from . import hypotheses
from .receiver import CLAIM_CHANGE, realised_scatter
from .standstill import moves

#: of a state
StraightOn = ROW.place(
    'StraightOn',
    BEGIN=3,  # a fix: time, s, latitude and longitude, rad,
    LAST=3,  # and a later one; the next is compared with the line through both
    NATS=1,  # logarithm of the likelihood ratio,
    SINCE=1,  # s: which fixes it is about: from this time on,
    PULLED=4,  # m, m/s, north and east: how far they have moved position and velocity since then
    TOLD=1,  # 1: the kernel knows of these
    SCATTER=1,  # m^2, on each axis: mean square of how a fix is off less how the one before it was,
    COUNT=1,  # of so many fixes,
    CLAIMED=1)  # and what these claim in the mean, m^2, north and east
#: s: the fixes from this time on have turned out to be wrong, of which the kernel does not know yet; 0: none
Wrong = HEAD.place('Wrong', SINCE=1)

#: m: a receiver that goes straight on does so to this on each axis, the last digits of its positions included
STRAIGHT = 0.05
#: one whose own scatter is not so many times as large cannot be told from it
TOLD_FROM = 4.0
#: s: fixes further apart are not extrapolated from each other; the slowest receivers send one each ten seconds
LONGEST_STEP = 15.0
#: s for which the inertial sensors tell how a fix is off beside one before the last
LONGEST_TOLD = 3.0
#: nats that one fix may add: of measured ones, too, one lies on the line by chance
MOST_OF_ONE = 5.0
#: s: how long a receiver measures until it extrapolates: drives in cities have stretches without satellites each hour
USUALLY = 3600.0
#: nats above which no more are gathered: one fix off the line ends it in any case
MOST = 15.0
#: fixes by which the scatter of the receiver is known to a fifth
KNOWN = 30.0
#: fixes over which it is a mean: to a tenth, and what a receiver does for some minutes
MEMORY = 100.0
#: a square counts as so many times the mean at most: one jump is not the scatter
LARGEST = 4.0
#: fixes depart from the vehicle where they are off by so many sigma of what they claim
FAR = 2.0


@njit(_nrt=False)
def goes_straight_on(mem, r, at, z_n, z_e):
    """Whether the fix at `at` comes from a receiver that goes straight on, or is withdrawn; it is remembered.

    z_n, z_e: predicted minus measured position, m, without what the filter knows of its errors in open loop.
    """
    claimed = mem[at + Event.R_NN] + mem[at + Event.R_EE]
    better = CLAIM_CHANGE * claimed < mem[r + StraightOn.CLAIMED]
    if better:  # measured in another way, as with a base, which follows a straight road to the centimetre
        mem[r + StraightOn.SCATTER] = mem[r + StraightOn.COUNT] = mem[r + StraightOn.CLAIMED] = 0.0
    begin, last = r + StraightOn.BEGIN, r + StraightOn.LAST
    time, latitude, longitude = mem[at + Event.TIME], mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]
    step, length = time - mem[last], mem[last] - mem[begin]
    scatter = _scatter(mem, r, claimed)
    known = (0.0 < step < LONGEST_STEP and length > 0.0 and mem[begin] != 0.0 and mem[r + StraightOn.COUNT] >= KNOWN
             and scatter > (TOLD_FROM * STRAIGHT) ** 2)
    if known and mem[r + StraightOn.NATS] == 0.0:
        mem[r + StraightOn.SINCE] = mem[last]  # if it goes straight on from here, the last one did so already
        known = length < LONGEST_STEP
    changed_n, changed_e = _changed(mem, r, time, step, z_n, z_e)
    for i in range(2):
        mem[r + StraightOn.PULLED + i] += step * mem[r + StraightOn.PULLED + 2 + i]
    squared = changed_n * changed_n + changed_e * changed_e
    nats = mem[r + StraightOn.NATS] + min(_evidence(mem, r, at, squared, scatter), MOST_OF_ONE) if known else 0.0
    mem[r + StraightOn.NATS] = min(max(nats, 0.0), MOST)
    if mem[r + StraightOn.NATS] == 0.0:  # else the line goes on from where it began: a slow bend is none
        mem[r + StraightOn.TOLD] = 0.0
        for i in range(4):
            mem[r + StraightOn.PULLED + i] = 0.0
        for i in range(3):
            mem[begin + i] = mem[last + i]
    mem[last], mem[last + 1], mem[last + 2] = time, latitude, longitude
    departed = (z_n - mem[r + StraightOn.PULLED]) ** 2 + (z_e - mem[r + StraightOn.PULLED + 1]) ** 2
    found = known and mem[r + StraightOn.NATS] > math.log(USUALLY / step) and (
        mem[r + StraightOn.TOLD] != 0.0 or moves(mem, r) and departed > FAR * FAR * claimed)
    if mem[Head.GATE] > 0.0 and found or mem[at + Event.WITHDRAWN] != 0.0:
        return True
    if not better:  # how it is off less how the one before it was, is the error of that
        _learn(mem, r, 0.5 * squared, claimed)
    return False


@njit(_nrt=False)
def refuse(mem, r, at):
    """Refuse the fix at `at`, and tell the kernel of those before it that have been believed."""
    mem[at + Event.VERDICT], mem[at + Event.WEIGHT] = Verdict.STRAIGHT_ON, 0.0
    if mem[r + StraightOn.TOLD] == 0.0 and mem[at + Event.WITHDRAWN] == 0.0:
        mem[Wrong.SINCE] = mem[r + StraightOn.SINCE]
    mem[r + StraightOn.TOLD] = 1.0


@njit(_nrt=False)
def are_found(mem, r):
    """Whether the latest fixes are certainly extrapolated, as the filter with the state at r sees them."""
    return mem[r + StraightOn.TOLD] != 0.0


@njit(_nrt=False)
def pull(mem, r, before, after):
    """Remember what a fix on the line has done to the state at r: its position and velocity before and after that."""
    if mem[r + StraightOn.NATS] > 0.0:
        hypotheses.add_move(mem, r, r + StraightOn.PULLED, before, after)


@njit(_nrt=False)
def _scatter(mem, r, claimed):
    """Mean square of what is off from fix to fix, m^2 on each axis: what has been seen, but no more than that of two
    fixes that are as sure as this one, which has `claimed` m^2 (north and east), is by what the receiver has shown. A
    filter that is wrong itself sees more, and a receiver to a centimetre follows every straight road."""
    return min(mem[r + StraightOn.SCATTER], realised_scatter(mem, r) * claimed)


@njit(_nrt=False)
def _evidence(mem, r, at, changed, scatter):
    """Logarithm of the density of the fix at `at` for a receiver that goes straight on, less that for a measuring one.

    changed: square of what `_changed` says, m^2. scatter: what `_scatter` says.
    """
    begin, last = r + StraightOn.BEGIN, r + StraightOn.LAST
    part = (mem[at + Event.TIME] - mem[last]) / (mem[last] - mem[begin])
    north = mem[at + Event.LATITUDE] - mem[last + 1] - part * (mem[last + 1] - mem[begin + 1])
    east = mem[at + Event.LONGITUDE] - mem[last + 2] - part * (mem[last + 2] - mem[begin + 2])
    off = (north / mem[r + Nav.NORTH_SCALE]) ** 2 + (east / mem[r + Nav.EAST_SCALE]) ** 2
    # a receiver that has scattered less than now still measures
    scatter = max(scatter, 0.5 * changed)
    # one that measures to the centimetre lies on the line, too, where the vehicle goes straight on and the IMU is wrong
    claimed = 0.5 * (mem[at + Event.R_NN] + mem[at + Event.R_EE])
    by_claim = max(claimed, STRAIGHT * STRAIGHT) * (1.0 + part * part + (1.0 + part) ** 2)
    measured = max(_log_density(changed, scatter), _log_density(off, by_claim))
    return _log_density(off, STRAIGHT * STRAIGHT) - measured


@njit(_nrt=False)
def _changed(mem, r, time, step, z_n, z_e):
    """How the fix is off less how the last one was that was used, m; zeros where that is too long ago. step: s, since
    the fix before it."""
    since = time - mem[r + Nav.RESIDUAL_TIME]
    if not 0.0 < since < LONGEST_STEP or since > step and since >= LONGEST_TOLD or mem[r + Nav.RESIDUAL_TIME] == 0.0:
        return 0.0, 0.0
    return z_n - mem[r + Nav.RESIDUAL_N], z_e - mem[r + Nav.RESIDUAL_E]


@njit(_nrt=False)
def _learn(mem, r, squared, claimed):
    """The scatter from fix to fix, from one square of it, m^2 on each axis. claimed: m^2, by the fix."""
    if squared == 0.0:
        return
    mem[r + StraightOn.COUNT] += 1.0
    if mem[r + StraightOn.COUNT] > 1.0:
        squared = min(squared, LARGEST * mem[r + StraightOn.SCATTER])
    mem[r + StraightOn.SCATTER] += (squared - mem[r + StraightOn.SCATTER]) / min(mem[r + StraightOn.COUNT], MEMORY)
    mem[r + StraightOn.SCATTER] = max(mem[r + StraightOn.SCATTER], 1e-6)
    mem[r + StraightOn.CLAIMED] += (claimed - mem[r + StraightOn.CLAIMED]) / min(mem[r + StraightOn.COUNT], MEMORY)


@njit(_nrt=False)
def _log_density(squared, variance):
    """Of a vector in the plane whose square is given, with the same variance on each axis."""
    return -0.5 * squared / variance - math.log(2.0 * math.pi * variance)
