"""By how much what an input measures changes within the time by which its stamps may be off without anybody knowing.

A speed that is late is off in proportion to the acceleration, a heading in proportion to the turn rate: nothing while
the vehicle drives evenly, and the same for as long as a manoeuvre lasts. An input is expected to be off by that besides
the noise that it claims, and its scale (`scale.py`) is one of both.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import ROW, Nav
from .hypotheses import UNDECLARED_OFFSET

#: of a state: by what the velocity has changed in about the last UNDECLARED_OFFSET, m/s, north, east and down
Late = ROW.place('Late', GAINED=3)


@njit(_nrt=False)
def gain(mem, src, dst, dt):
    """Carry that change from the state at src on to the one at dst, predicted dt s later."""
    keep = math.exp(-dt / UNDECLARED_OFFSET)
    for k in range(3):
        change = mem[dst + Nav.V_N + k] - mem[src + Nav.V_N + k]
        mem[dst + Late.GAINED + k] = keep * mem[src + Late.GAINED + k] + change
