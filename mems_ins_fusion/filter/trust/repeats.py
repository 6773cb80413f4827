"""Whether an input repeats itself: a sensor or a driver that has stopped and goes on sending its last value.

A receiver that moves never says the same position or velocity twice, and an input whose messages have all differed
does not repeat one several times. A speed in whole kilometres an hour may stay as it is for a minute, but not while the
inertial sensors see more of a change than their errors explain: what the state has gained of it between the messages
since it has that value, in the last seconds. What is too slow for them to see makes a speed that does not change less
known by the second. A heading in whole degrees that stays as it is is refused by what the gyroscopes have seen since.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.geometry import body_to_level, body_velocity
from ..memory import ROW, Event, Head, Kind, Nav, is_of_heading, is_of_velocity
from .scale import Seen, seen_of
from .standstill import moves

#: of a state
Repeats = ROW.place(
    'Repeats',
    STUCK=1)  # 1: the main receiver has repeated its position while the vehicle moved, and has done so ever since
#: m/s, change of a speed that rounding leaves unsaid: some steps of the coarsest there are
ROUNDED_SPEED = 1.0
#: m/s^2, by which the inertial sensors may be wrong: a tilt of two degrees
UNSEEN_ACCELERATION = 0.3
#: s over which that is added up: shorter than a car takes to gain what rounding hides, or errors would pass for it
FORGETTING_TIME = 5.0
#: messages in a row, each unlike the one before it, while the vehicle moved: after as many an input counts as one that
#: does not repeat itself. One that rounds to a tenth of its noise repeats each tenth
LIVELY = 100.0
#: messages in a row that such an input repeats before it has stopped: two or three come twice on a busy bus
FEWEST_EQUAL = 4.0
#: stands for more than is explained
UNEXPLAINED = 1e6
#: s for which a speed in steps may stay as it is, and m/s^2, by which it is less known from then on
LONGEST_STEADY, AGEING = 2.0, 0.1


@njit(_nrt=False)
def is_stuck(mem, r, at):
    """Whether the event at `at`, of any input, repeats the one before although the state at r has changed."""
    if mem[Head.GATE] == 0.0:
        return False
    kind = int(mem[at + Event.KIND])
    if kind == Kind.POSITION:
        if not _repeats(mem, at, r + Nav.FIX_LATITUDE):
            mem[r + Repeats.STUCK] = 0.0
        elif moves(mem, r):
            mem[r + Repeats.STUCK] = 1.0
        return mem[r + Repeats.STUCK] != 0.0
    own = seen_of(mem, r, at)
    same = mem[at + Event.VALUE] == mem[own + Seen.LATEST]
    if kind == Kind.PLACE or kind == Kind.VELOCITY or kind == Kind.MAGNETIC:
        same = _repeats(mem, at, own + Seen.LATEST)
        mem[own + Seen.LATEST + 1] = mem[at + Event.VALUE + 1]
    mem[own + Seen.LATEST] = mem[at + Event.VALUE]
    since, mem[own + Seen.LATEST_TIME] = mem[at + Event.TIME] - mem[own + Seen.LATEST_TIME], mem[at + Event.TIME]
    moving = moves(mem, r)
    if moving:
        _count(mem, own, same)
    if not same:
        mem[own + Seen.SINCE], mem[own + Seen.GAINED] = mem[at + Event.TIME], 0.0
        return False
    if moving and (kind == Kind.PLACE or kind == Kind.VELOCITY) or mem[own + Seen.DIFFERENT] >= LIVELY + FEWEST_EQUAL:
        mem[own + Seen.GAINED] = UNEXPLAINED
    if is_of_velocity(kind) and mem[own + Seen.GAINED] != UNEXPLAINED:  # until it says something else
        gained = _told(mem, r, kind) - mem[own + Seen.LEFT]
        mem[own + Seen.GAINED] = mem[own + Seen.GAINED] * math.exp(-max(since, 0.0) / FORGETTING_TIME) + gained
        if abs(mem[own + Seen.GAINED]) > ROUNDED_SPEED + UNSEEN_ACCELERATION * FORGETTING_TIME:
            mem[own + Seen.GAINED] = UNEXPLAINED
    return mem[own + Seen.GAINED] == UNEXPLAINED


@njit(_nrt=False)
def _count(mem, own, same):
    """Count the messages in a row that are other ones, up to LIVELY, and after as many those that are the same."""
    count = mem[own + Seen.DIFFERENT]
    if same:
        mem[own + Seen.DIFFERENT] = count + 1.0 if count >= LIVELY else 0.0
    else:
        mem[own + Seen.DIFFERENT] = min(count + 1.0, LIVELY) if count <= LIVELY else 0.0


@njit(_nrt=False)
def unknown(mem, own, time):
    """Variance, m^2/s^2, of a speed or an odometry that has not changed at all for so long: it may be that of then. One
    of zero is usual: vehicles stand."""
    if mem[own + Seen.LATEST] == 0.0:
        return 0.0
    return (AGEING * max(time - mem[own + Seen.SINCE] - LONGEST_STEADY, 0.0)) ** 2


@njit(_nrt=False)
def note(mem, r, at):
    """Remember what the state at r says of what the event at `at` measures, after its correction."""
    kind = int(mem[at + Event.KIND])
    if is_of_velocity(kind) or is_of_heading(kind):
        mem[seen_of(mem, r, at) + Seen.LEFT] = _told(mem, r, kind)


@njit(_nrt=False)
def _repeats(mem, at, latest):
    return mem[at + Event.VALUE] == mem[latest] and mem[at + Event.VALUE + 1] == mem[latest + 1]


@njit(_nrt=False)
def _told(mem, r, kind):
    """What the state says of a heading, rad, or a speed, m/s."""
    c = body_to_level(mem, r)
    if is_of_heading(kind):
        return math.atan2(c[3], c[0])
    return body_velocity(mem, r, c, 0)
