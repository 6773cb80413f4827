"""Detect fixes that drift away and are followed by the filter.

Each drifting fix is nearly consistent with the state, and corrects position and velocity a little, but always in the
same direction. So each fix is compared with the position that the filter would have without the corrections of the last
seconds. The usual distance between them depends on the IMU, including errors that its parameters do not contain, and on
the receiver. So the distance is compared with its mean in the same drive.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import ROW, Event, Nav
from .hypotheses import Hypothesis

#: columns of a state
FixDrift = ROW.place(
    'FixDrift',
    MOVED=4,  # m, m/s, north and east: sum of the corrections of position and velocity in the last seconds
    LATEST=1,  # m^2: squared distance of the latest fix from the position without these corrections
    USUAL=1,  # m^2: mean of these squares
    SEEN=1)  # s: time over which it was averaged

#: s, time constant with which corrections are forgotten: in this time, the position error by a car's IMU grows to about
#: that of a fix
FORGETTING_TIME = 4.0
#: s, averaging time of the usual distance: contains bends and stops, and adapts to another road
USUAL_DISTANCE_TIME = 300.0
#: s, shortest averaging time with which the usual distance is used: several times FORGETTING_TIME, within which
#: distances are correlated
SHORTEST_USUAL = 30.0
#: ratio to the usual distance above which fixes are far: on the measured drives exceeded for longer than a second only
#: if the receiver fails, or with a time offset of 0.26 s that is not configured
FAR_RATIO = 3.0


@njit(_nrt=False)
def note(mem, r, at, z_n, z_e):
    """Compare the fix at `at` with the position without the corrections of the last seconds, and update the usual
    distance.

    z_n, z_e: predicted minus measured position, m, with the estimated errors subtracted (open loop).
    """
    step = min(max(mem[at + Event.TIME] - mem[r + Nav.FIX_TIME], 0.0), FORGETTING_TIME)
    moved, left = r + FixDrift.MOVED, math.exp(-step / FORGETTING_TIME)
    for i in range(2):
        mem[moved + i] = left * (mem[moved + i] + step * mem[moved + 2 + i])
        mem[moved + 2 + i] *= left
    squared = (z_n - mem[moved]) ** 2 + (z_e - mem[moved + 1]) ** 2
    mem[r + FixDrift.LATEST] = squared
    if mem[r + Hypothesis.FIXES_WRONG] != 0.0:
        return
    mem[r + FixDrift.SEEN] = min(mem[r + FixDrift.SEEN] + step, USUAL_DISTANCE_TIME)
    if mem[r + FixDrift.SEEN] > SHORTEST_USUAL:
        squared = min(squared, FAR_RATIO * FAR_RATIO * mem[r + FixDrift.USUAL])
    mem[r + FixDrift.USUAL] += (squared - mem[r + FixDrift.USUAL]) * min(step / mem[r + FixDrift.SEEN], 1.0)


@njit(_nrt=False)
def reset(mem, r):
    """Reset the statistics of the state at r after a new start."""
    mem[r + FixDrift.SEEN] = 0.0
    for i in range(4):
        mem[r + FixDrift.MOVED + i] = 0.0


@njit(_nrt=False)
def are_followed(mem, r):
    """Whether the filter follows fixes that drift away: the latest fix was used, and its distance from the position
    without the latest corrections is unusually large."""
    return (mem[r + FixDrift.SEEN] > SHORTEST_USUAL and mem[r + Nav.REFUSED] == 0.0
            and mem[r + FixDrift.LATEST] > FAR_RATIO * FAR_RATIO * mem[r + FixDrift.USUAL])
