"""How far fixes are from where the filter would be had those of the last seconds not moved it, beside what is usual.

Fixes that drift away are followed: each of them fits nearly, and moves position and velocity a little, but always the
same way. How much of that is too much depends on the IMU, on what the parameters do not say of it, and on the receiver;
so it is compared with what it has been in this drive.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import ROW, Event, Nav
from .hypotheses import Hypothesis

#: of a state
FixDrift = ROW.place(
    'FixDrift',
    MOVED=4,  # m, m/s, north and east: how far the fixes of the last seconds have moved position and velocity,
    LATEST=1,  # m^2: square of how far the latest fix is from where the filter would be without that,
    USUAL=1,  # m^2: the mean of these squares,
    SEEN=1)  # s: over so long

#: s for which what fixes have done is remembered: so long a car's IMU holds the position to about what a fix is off
FORGETTING_TIME = 4.0
#: s over which the usual distance is a mean: it has bends and stops in it, and follows another road
USUAL_TIME = 300.0
#: s over which it is one at least: some times FORGETTING_TIME, within which distances are alike
SHORTEST_USUAL = 30.0
#: times the usual distance from which on fixes are far: on the measured drives longer than for a second only where the
#: receiver fails, and where a time offset of 0.26 s is not declared
FAR_RATIO = 3.0


@njit(_nrt=False)
def note(mem, r, at, z_n, z_e):
    """Note how far the fix at `at` is off. z_n, z_e: predicted minus measured position, m, without what the filter
    knows of its errors in open loop."""
    step = min(max(mem[at + Event.TIME] - mem[r + Nav.FIX_TIME], 0.0), FORGETTING_TIME)
    moved, left = r + FixDrift.MOVED, math.exp(-step / FORGETTING_TIME)
    for i in range(2):
        mem[moved + i] = left * (mem[moved + i] + step * mem[moved + 2 + i])
        mem[moved + 2 + i] *= left
    squared = (z_n - mem[moved]) ** 2 + (z_e - mem[moved + 1]) ** 2
    mem[r + FixDrift.LATEST] = squared
    if mem[r + Hypothesis.FIXES_WRONG] != 0.0:
        return
    mem[r + FixDrift.SEEN] = min(mem[r + FixDrift.SEEN] + step, USUAL_TIME)
    if mem[r + FixDrift.SEEN] > SHORTEST_USUAL:
        squared = min(squared, FAR_RATIO * FAR_RATIO * mem[r + FixDrift.USUAL])
    mem[r + FixDrift.USUAL] += (squared - mem[r + FixDrift.USUAL]) * min(step / mem[r + FixDrift.SEEN], 1.0)


@njit(_nrt=False)
def reset(mem, r):
    """The state at r has begun anew: nothing has moved it, and what is usual of it has not been seen."""
    mem[r + FixDrift.SEEN] = 0.0
    for i in range(4):
        mem[r + FixDrift.MOVED + i] = 0.0


@njit(_nrt=False)
def are_followed(mem, r):
    """Whether the latest fix has been used and is further than is usual from where the state at r would be without it
    and those before it."""
    return (mem[r + FixDrift.SEEN] > SHORTEST_USUAL and mem[r + Nav.REFUSED] == 0.0
            and mem[r + FixDrift.LATEST] > FAR_RATIO * FAR_RATIO * mem[r + FixDrift.USUAL])
