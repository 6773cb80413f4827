"""Usual speed of the vehicle, which limits the velocity error without fixes.

The velocity of a vehicle is modelled as a stationary random process, as R. A. Singer, "Estimating optimal tracking
filter performance for manned maneuvering targets", IEEE Trans. Aerospace and Electronic Systems 6, 1970, does for
accelerations. Without any measurement each component has mean zero and a variance that is learned during the drive. An
IMU alone does not know this: without fixes its velocity error grows without limit, until a robot seems to be as fast as
a car.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import ROW, Nav, velocity_variance
from .scale import LARGEST_SCALE, Scale, learn, scale
from .standstill import certain_speed, velocity_sigma

#: of a state: realised variance of the velocity over ASSUMED_VARIANCE
UsualSpeed = ROW.place('UsualSpeed', SCALE=Scale.SIZE)

#: m^2/s^2, prior variance of a component of the velocity: of a vehicle at 7 m/s, the geometric mean of a robot at 1 m/s
#: and a car at 50 m/s
ASSUMED_VARIANCE = 5.0**2
#: s, correlation time of the velocity: in this time a vehicle turns, stops or speeds up. One velocity in this time is
#: learned from, and one zero velocity in this time is applied. Chosen; a quarter and four times of it move little
#: (docs/ablation.md)
CORRELATION = 20.0
#: s without a fix after which it is applied, and a standstill at any estimated speed believed: longer than the interval
#: of slow receivers
SHORTEST_OUTAGE = 5.0


@njit(_nrt=False)
def learn_speed(mem, r, time):
    """Learn from the velocity of the state at r, which moves, after a fix that is used at `time`, s."""
    at = r + UsualSpeed.SCALE
    if mem[at + Scale.TIME] == 0.0 or time - mem[at + Scale.TIME] > CORRELATION:
        squared = 0.5 * (mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2)
        learn(mem, at, time, squared, ASSUMED_VARIANCE, 0.5 * velocity_variance(mem, r), 2)


@njit(_nrt=False)
def learn_certain_speed(mem, r):
    """Learn from the state at r, if there are no fixes and the vehicle is certainly faster than usual: in traffic that
    flows again, it is soon ten times as fast."""
    if not is_without_fixes(mem, r):
        return
    squared = 0.5 * certain_speed(mem, r, velocity_sigma(mem, r)) ** 2
    if squared > usual(mem, r):
        mem[r + UsualSpeed.SCALE + Scale.LOG] = math.log(min(squared / ASSUMED_VARIANCE, LARGEST_SCALE))


@njit(_nrt=False)
def is_without_fixes(mem, r):
    """Whether there has been no fix for SHORTEST_OUTAGE before the state at r."""
    return mem[r + Nav.TIME] - mem[r + Nav.FIX_TIME] > SHORTEST_OUTAGE


@njit(_nrt=False)
def bounds(mem, r):
    """Whether the usual speed is applied to the state at r: there are no fixes, and its velocity is less certain.

    A velocity that is known better would become smaller all the time without becoming more accurate.
    """
    return (mem[r + UsualSpeed.SCALE + Scale.TIME] != 0.0
            and is_without_fixes(mem, r)
            and 0.5 * velocity_variance(mem, r) > usual(mem, r))


@njit(_nrt=False)
def variance(mem, r, since):
    """Variance with which a velocity of zero is applied, m^2/s^2. since: s since the previous constraint."""
    return usual(mem, r) * CORRELATION / since


@njit(_nrt=False)
def usual(mem, r):
    """Variance of a component of the vehicle's velocity, m^2/s^2."""
    return ASSUMED_VARIANCE * scale(mem, r + UsualSpeed.SCALE)
