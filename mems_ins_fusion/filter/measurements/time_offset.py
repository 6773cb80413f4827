"""The state that every input has for what is left of its time offset: its column of H.

A speed that is late is off in proportion to the acceleration, a heading in proportion to the turn rate, a position to
the velocity: by the derivative of what is measured times the offset. While the vehicle drives evenly nothing is known
of the offset, and nothing is off by it.
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..memory import ROW, Event, Nav

#: s, over which an acceleration is averaged: that of a single sample is vibration, and noise in H makes an offset too
#: small (errors in variables); half the offset of slow buses, so that the mean is that of the time in between
AVERAGED = 0.2
#: of a state: by what the velocity has changed in about the last AVERAGED, m/s, north, east and down
Changed = ROW.place('Changed', VELOCITY=3)


@njit(_nrt=False)
def carry_on(mem, src, dst, dt):
    """Carry that change from the state at src on to the one at dst, predicted dt s later."""
    keep = AVERAGED / (AVERAGED + dt)
    for k in range(3):
        change = mem[dst + Nav.V_N + k] - mem[src + Nav.V_N + k]
        mem[dst + Changed.VELOCITY + k] = keep * (mem[src + Changed.VELOCITY + k] + change)


@njit(_nrt=False)
def acceleration(mem, r):
    """Of the state at r, north, east and down, m/s^2."""
    at = r + Changed.VELOCITY
    return mem[at] / AVERAGED, mem[at + 1] / AVERAGED, mem[at + 2] / AVERAGED


@njit(_nrt=False)
def add_time_offset(mem, at, h, rate):
    """Set the column of the time offset of the record at `at` in the row of H at `h`. rate: derivative by time of what
    is measured: the record describes the vehicle that much before its stamp."""
    state = int(mem[at + Event.TIME_OFFSET])
    if state > 0:
        mem[h + state] = rate
