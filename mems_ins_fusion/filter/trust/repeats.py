"""Detection of an input that repeats its last value because the sensor or its driver has stopped.

* A receiver that moves never sends the same position or velocity twice.
* An input whose messages have always differed does not send the same value several times.
* A speed that is rounded, for example to whole km/h, may stay the same for a minute. But it is wrong if the inertial
  sensors show a larger change than their errors explain; the change is summed over the last seconds.
* Changes too slow for the inertial sensors: the variance of a speed that stays the same grows with time.

A rounded heading needs no test: it is refused as soon as the gyroscopes show a turn.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.geometry import body_to_level, body_velocity, yaw_of
from ..memory import INPUT, ROW, Event, Head, Kind, Nav, input_at, is_of_heading, is_of_velocity
from .standstill import moves

#: of a state
Repeats = ROW.place(
    'Repeats',
    STUCK=1)  # 1: the main receiver has sent the same position since a time when the vehicle moved
#: of an input
Latest = INPUT.place(
    'Latest',
    VALUE=2,  # two values of the latest message,
    TIME=1,  # s, and its time
    GAINED=1,  # m/s or rad, change of the state since its value is the same,
    LEFT=1,  # m/s or rad, value of the state after the latest message,
    SINCE=1,  # s, time since which its value is the same
    DIFFERENT=1)  # number of messages in a row that differ from the previous one
#: m/s, change that a rounded speed may hide: a few steps of the coarsest ones
ROUNDED_SPEED = 1.0
#: m/s^2, error of the acceleration by the inertial sensors: a tilt of two degrees
TILT_ACCELERATION = 0.3
#: s, time constant with which changes are summed. Longer, and errors of the inertial sensors would exceed ROUNDED_SPEED
CHANGE_MEMORY = 5.0
#: number of successive messages that differ from the one before, while the vehicle moves, after which an input counts
#: as one that does not repeat values. An input rounded to a tenth of its noise repeats a value every tenth message
LIVELY = 100.0
#: number of repetitions in a row after which such an input has stopped: on a busy bus a message may come two or three
#: times
FEWEST_REPEATED = 4.0
#: mark for a change larger than explained by rounding and inertial errors
UNEXPLAINED = 1e6
#: s for which a rounded speed may stay the same without a larger variance. Chosen, not measured
LONGEST_STEADY = 2.0
#: m/s^2, growth of its standard deviation after that: a car that coasts. Chosen, not measured
AGEING = 0.1


@njit(_nrt=False)
def is_stuck(mem, r, at):
    """Whether the event at `at`, of any input, repeats the previous one although the state at r has changed."""
    if mem[Head.GATE] == 0.0:
        return False
    kind = int(mem[at + Event.KIND])
    if kind == Kind.POSITION:
        if not _repeats(mem, at, r + Nav.FIX_LATITUDE):
            mem[r + Repeats.STUCK] = 0.0
        elif moves(mem, r):
            mem[r + Repeats.STUCK] = 1.0
        return mem[r + Repeats.STUCK] != 0.0
    own = input_at(mem, r, at)
    same = mem[at + Event.VALUE] == mem[own + Latest.VALUE]
    if kind == Kind.PLACE or kind == Kind.VELOCITY or kind == Kind.MAGNETIC:
        same = _repeats(mem, at, own + Latest.VALUE)
        mem[own + Latest.VALUE + 1] = mem[at + Event.VALUE + 1]
    mem[own + Latest.VALUE] = mem[at + Event.VALUE]
    since, mem[own + Latest.TIME] = mem[at + Event.TIME] - mem[own + Latest.TIME], mem[at + Event.TIME]
    moving = moves(mem, r)
    if moving:
        _count(mem, own, same)
    if not same:
        mem[own + Latest.SINCE], mem[own + Latest.GAINED] = mem[at + Event.TIME], 0.0
        return False
    never_repeats = kind == Kind.PLACE or kind == Kind.VELOCITY
    if moving and never_repeats or mem[own + Latest.DIFFERENT] >= LIVELY + FEWEST_REPEATED:
        mem[own + Latest.GAINED] = UNEXPLAINED
    if is_of_velocity(kind) and mem[own + Latest.GAINED] != UNEXPLAINED:  # the mark stays until the value changes
        gained = _predicted(mem, r, kind) - mem[own + Latest.LEFT]
        mem[own + Latest.GAINED] = mem[own + Latest.GAINED] * math.exp(-max(since, 0.0) / CHANGE_MEMORY) + gained
        if abs(mem[own + Latest.GAINED]) > ROUNDED_SPEED + TILT_ACCELERATION * CHANGE_MEMORY:
            mem[own + Latest.GAINED] = UNEXPLAINED
    return mem[own + Latest.GAINED] == UNEXPLAINED


@njit(_nrt=False)
def _count(mem, own, same):
    """Count the messages in a row that differ from the previous one, up to LIVELY; then those that are the same."""
    count = mem[own + Latest.DIFFERENT]
    if same:
        mem[own + Latest.DIFFERENT] = count + 1.0 if count >= LIVELY else 0.0
    else:
        mem[own + Latest.DIFFERENT] = min(count + 1.0, LIVELY) if count <= LIVELY else 0.0


@njit(_nrt=False)
def unknown(mem, own, time):
    """Variance, m^2/s^2, to be added to that of a speed or odometry at `time`, s, because it has not changed for long.
    None for a speed of zero, as vehicles stand."""
    if mem[own + Latest.VALUE] == 0.0:
        return 0.0
    return (AGEING * max(time - mem[own + Latest.SINCE] - LONGEST_STEADY, 0.0)) ** 2


@njit(_nrt=False)
def note(mem, r, at):
    """Keep the value of the quantity that the event at `at` measures, by the corrected state at r."""
    kind = int(mem[at + Event.KIND])
    if is_of_velocity(kind) or is_of_heading(kind):
        mem[input_at(mem, r, at) + Latest.LEFT] = _predicted(mem, r, kind)


@njit(_nrt=False)
def _repeats(mem, at, latest):
    return mem[at + Event.VALUE] == mem[latest] and mem[at + Event.VALUE + 1] == mem[latest + 1]


@njit(_nrt=False)
def _predicted(mem, r, kind):
    """Heading, rad, or forward speed, m/s, of the state at r."""
    c = body_to_level(mem, r)
    if is_of_heading(kind):
        return yaw_of(c)
    return body_velocity(mem, r, c, 0)
