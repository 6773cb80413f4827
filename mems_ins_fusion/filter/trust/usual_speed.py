"""How fast the vehicle usually is, which bounds its velocity where no fix does.

The velocity of a vehicle is a stationary random process: R. A. Singer, "Estimating optimal tracking filter performance
for manned maneuvering targets", IEEE Trans. Aerospace and Electronic Systems 6, 1970, has the same for accelerations.
So without any measurement each component has mean zero and the variance that the drive has shown. Nothing of that is in
the integral of an IMU: without fixes its error grows without bound, until a robot seems to be as fast as a car.
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..memory import ROW, Nav, velocity_variance
from .scale import Scale, learn, scale

#: of a state: realised variance of the velocity over ASSUMED
UsualSpeed = ROW.place('UsualSpeed', SCALE=Scale.SIZE)

#: m^2/s^2, variance of a component of the velocity before a fix has shown it: of a vehicle at 7 m/s, as many times
#: faster than a robot at 1 m/s as a car at 50 m/s is faster than it
ASSUMED = 5.0**2
#: s, after which the velocity of a vehicle is another one: it turns, stops or speeds up. One velocity in that time is
#: learned from, and without fixes the variance counts as one measurement in that time
CORRELATION = 20.0
#: s without a fix after which it is applied: most receivers have one each second, and some each five
SHORTEST_OUTAGE = 5.0


@njit(_nrt=False)
def learn_speed(mem, r, time):
    """Learn from the velocity of the state at r, which moves, after a fix that is used at `time`, s."""
    at = r + UsualSpeed.SCALE
    if mem[at + Scale.TIME] == 0.0 or time - mem[at + Scale.TIME] > CORRELATION:
        squared = 0.5 * (mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2)
        learn(mem, at, time, squared, ASSUMED, 0.5 * velocity_variance(mem, r), 2)


@njit(_nrt=False)
def bounds(mem, r):
    """Whether the velocity of the state at r is less certain, without fixes, than that of any vehicle like this.

    Where it is known better, the usual one would make it a little smaller all the time, and no surer; and before fixes
    have shown any speed, nothing is usual.
    """
    return (mem[r + UsualSpeed.SCALE + Scale.TIME] != 0.0
            and mem[r + Nav.TIME] - mem[r + Nav.FIX_TIME] > SHORTEST_OUTAGE
            and 0.5 * velocity_variance(mem, r) > _usual(mem, r))


@njit(_nrt=False)
def variance(mem, r, since):
    """Variance with which zero is applied as the velocity, m^2/s^2; since: s since the previous constraint."""
    return _usual(mem, r) * CORRELATION / since


@njit(_nrt=False)
def _usual(mem, r):
    """Variance of a component of the vehicle's velocity, m^2/s^2."""
    return ASSUMED * scale(mem, r + UsualSpeed.SCALE)
