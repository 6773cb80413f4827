"""The low pass that an input comes through: a bus, a driver or a sensor that smooths what it measures.

What comes out of a first-order low pass of the time constant tau, 1 / (1 + tau s), is behind what goes in by a value
that follows the changes and decays: in an interval T in which it changes by D, from u to u exp(-T / tau) + D tau / T
(1 - exp(-T / tau)). The changes are those that the inertial sensors show from one message of the input to the next,
without what the messages correct. At a constant acceleration it is tau times that: the part of the time offset that
the low pass makes, so the event is of the time of the stamp less the rest (`FilterConfig.time_offset_of`).
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import Event, Kind
from ..trust.scale import Seen, seen_of

#: s without a message, in time constants, after which nothing is behind: the low pass has had the time to follow
FOLLOWED_AFTER = 5.0


@njit(_nrt=False)
def unfollowed(mem, r, at, now):
    """By how much the event at `at` is behind `now`, the forward speed of the state at r, m/s, or its heading, rad: as
    far as its low pass has not followed yet."""
    change = now - mem[seen_of(mem, r, at) + Seen.LEFT]
    if mem[at + Event.KIND] == Kind.HEADING:
        change = math.atan2(math.sin(change), math.cos(change))
    return _follow(mem, r, at, Seen.UNFOLLOWED, change)


@njit(_nrt=False)
def unfollowed_turn(mem, r, at, rate):
    """The same of the turn rate of an odometry, rad/s; rate: that of the gyroscopes."""
    own = seen_of(mem, r, at)
    change, mem[own + Seen.TURN] = rate - mem[own + Seen.TURN], rate
    return _follow(mem, r, at, Seen.UNFOLLOWED_TURN, change)


@njit(_nrt=False)
def _follow(mem, r, at, column, change):
    """Carry on the value in the first of two columns of the input's `Seen`, the second of which has its time.

    change: since the message before.
    """
    lag, at_value = mem[at + Event.LAG], seen_of(mem, r, at) + column
    before, mem[at_value + 1] = mem[at_value + 1], mem[at + Event.TIME]
    since = mem[at + Event.TIME] - before
    if before == 0.0 or not 0.0 < since < FOLLOWED_AFTER * lag:  # without a low pass always
        mem[at_value] = 0.0
    else:
        keep = math.exp(-since / lag)
        mem[at_value] = keep * mem[at_value] + change * lag / since * (1.0 - keep)
    return mem[at_value]
