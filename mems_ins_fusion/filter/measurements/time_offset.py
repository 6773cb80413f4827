"""The state of each input for its remaining time offset: its column of H.

A time offset causes an error that is the offset times the time derivative of the measured quantity: for a position the
velocity, for a speed the acceleration, for a heading the turn rate. While this derivative is zero, the offset is not
observable and has no effect.
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..memory import ROW, Event, Nav

#: s over which the acceleration is averaged. That of a single sample is mostly vibration, and noise in H makes the
#: estimated offset too small (errors in variables). Half the offset of slow buses, so that the mean describes the time
#: between the true time and the stamp
AVERAGED = 0.2
#: columns of a state: change of the velocity in about the last AVERAGED, m/s, north, east and down
Changed = ROW.place('Changed', VELOCITY=3)


@njit(_nrt=False)
def carry_on(mem, src, dst, dt):
    """Update `Changed` from the state at src to the state at dst, dt s later."""
    keep = AVERAGED / (AVERAGED + dt)
    for k in range(3):
        change = mem[dst + Nav.V_N + k] - mem[src + Nav.V_N + k]
        mem[dst + Changed.VELOCITY + k] = keep * (mem[src + Changed.VELOCITY + k] + change)


@njit(_nrt=False)
def acceleration(mem, r):
    """Mean acceleration before the state at r: north, east and down, m/s^2."""
    at = r + Changed.VELOCITY
    return mem[at] / AVERAGED, mem[at + 1] / AVERAGED, mem[at + 2] / AVERAGED


@njit(_nrt=False)
def add_time_offset(mem, at, h, rate):
    """Set the column of the time offset of the event at `at` in the row of H at `h`. rate: time derivative of the
    measured quantity. A positive offset means that the event describes the vehicle before the time of its stamp."""
    state = int(mem[at + Event.TIME_OFFSET])
    if state > 0:
        mem[h + state] = rate
