"""Lag of an input behind a low pass: a bus, a driver or a sensor that smooths the measured value.

The output of a first-order low pass, 1 / (1 + tau s), lags behind its input by u. In an interval T in which the input
changes by D, u becomes u exp(-T / tau) + D tau / T (1 - exp(-T / tau)). D is the change by the inertial sensors from
one message of the input to the next, without the corrections by the messages. At a constant acceleration u is tau times
the acceleration, which is a part of the time offset of the input. So only the rest of the time offset is subtracted
from the stamp (`FilterConfig.time_offset_of`).
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import INPUT, Event, Kind, input_at
from ..trust.repeats import Latest

#: of an input
LowPass = INPUT.place(
    'LowPass',
    UNFOLLOWED=2,  # m/s or rad, lag of its low pass, and the time of that, s
    UNFOLLOWED_TURN=2,  # rad/s, the same of its turn rate, and the time of that, s
    TURN=1)  # rad/s, turn rate of the gyroscopes at its latest message
#: time without a message, in time constants, after which the lag is zero again
FOLLOWED_AFTER = 5.0


@njit(_nrt=False)
def unfollowed(mem, r, at, now):
    """Lag of the event at `at` behind `now`, which is the forward speed, m/s, or the heading, rad, of the state at r.
    """
    change = now - mem[input_at(mem, r, at) + Latest.LEFT]
    if mem[at + Event.KIND] == Kind.HEADING:
        change = math.atan2(math.sin(change), math.cos(change))
    return _follow(mem, r, at, LowPass.UNFOLLOWED, change)


@njit(_nrt=False)
def unfollowed_turn(mem, r, at, rate):
    """Lag of the turn rate of an odometry, rad/s. rate: turn rate by the gyroscopes, rad/s."""
    own = input_at(mem, r, at)
    change, mem[own + LowPass.TURN] = rate - mem[own + LowPass.TURN], rate
    return _follow(mem, r, at, LowPass.UNFOLLOWED_TURN, change)


@njit(_nrt=False)
def _follow(mem, r, at, column, change):
    """Update the lag in the first of two columns of the input; the second one is its time. Returns the lag.

    change: of the input of the low pass since the previous message.
    """
    lag, at_value = mem[at + Event.LAG], input_at(mem, r, at) + column
    before, mem[at_value + 1] = mem[at_value + 1], mem[at + Event.TIME]
    since = mem[at + Event.TIME] - before
    if before == 0.0 or not 0.0 < since < FOLLOWED_AFTER * lag:  # always true without a low pass, lag 0
        mem[at_value] = 0.0
    else:
        keep = math.exp(-since / lag)
        mem[at_value] = keep * mem[at_value] + change * lag / since * (1.0 - keep)
    return mem[at_value]
