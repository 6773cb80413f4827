"""Whether a speed is the vehicle's: the way that it makes up is compared with the one between fixes.

A wheel speed in km/h, one of the wrong sign, one that stays at zero and a velocity in other axes are taken for
measurements with much noise, and twenty of them a second are more than a fix of metres each second can say against.
But whatever the filter thinks of its velocity, the way between two fixes is known to some metres. By what share the
way that the speeds make up is longer or shorter, along that of the fixes, is estimated from each way that is long
enough to tell, with a Kalman filter of one state. An input whose ways are certainly wrong is refused, also when fixes
end, until its ways fit again. A heading makes up a way as well: the one that the nose leads along. All are ways of the
antenna, from the instant of one fix to that of another: a robot's turns on the spot, and the way that it makes between
two speeds, are longer than its fixes are uncertain.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import INPUT_SIZE, Event, Head, Nav, nonnegative
from .scale import KINDS, Inputs, Kinds, Seen

#: variance of that share before any way is compared: a speed is off by a fifth
PRIOR = 0.04
#: sigma of it over a way that is known exactly: stamps that are late while the speed changes, bends between samples
UNEVEN = 0.05
#: share of what one way tells by which the estimate is less known with each: twenty ways ago it was another
FORGOTTEN = 0.05
#: share of the way by the speeds below which that of the fixes has no direction of its own
NO_DIRECTION = 0.3
#: a way tells something where it is so many sigmas of both: of half as long ones UNEVEN and the sigmas hide a third
FEWEST_SIGMAS = 16.0
#: one that differs by more sigmas counts as that: a fix that is far off is not the speed's
LARGEST_SURPRISE = 2.0
#: s: an input that pauses for longer has made a way that nobody knows
LONGEST_PAUSE = 1.5
#: s: fixes further apart are not compared, as the heading that the speeds are laid along has errors
LONGEST_WAY = 60.0
#: rad: nor are they with a heading that is less known
LARGEST_YAW_SIGMA = 0.3
#: a speed may be off by this share: tyres that nobody declared, which is about what the filter can estimate
TOLERATED = 0.05
#: sigmas beyond which more than that is certain
CERTAIN = 3.0
#: sigma of the share below which ways have been compared: after one, mostly, and three times that is certain
COMPARED = 0.09


@njit(_nrt=False)
def travel(mem, own, time, v_n, v_e, density, yaw_variance):
    """Add what an input says at `time`, s, to its way. own: position of its `Seen`.

    v_n, v_e: velocity of the antenna, m/s, linear between two of them. density: variance of its way in a second, m^2/s.
    """
    before, mem[own + Seen.WAY_TIME] = mem[own + Seen.WAY_TIME], time
    since = time - before
    if before != 0.0 and since > LONGEST_PAUSE:  # one so slow makes no way, and nothing can speak against it
        mem[own + Seen.COMPARED] = 1.0
    if not 0.0 < since <= LONGEST_PAUSE or yaw_variance > LARGEST_YAW_SIGMA**2:
        mem[own + Seen.START] = 0.0
    mem[own + Seen.VARIANCE] += density * since
    for k, v in enumerate((v_n, v_e)):
        change, mem[own + Seen.LAST + k] = v - mem[own + Seen.LAST + k], v
        mem[own + Seen.WAY + k] += (v - 0.5 * change) * since
        mem[own + Seen.VARIANCE] += (change * since) ** 2 / 12.0  # it may have changed at any time in between


@njit(_nrt=False)
def compare(mem, r, at, variance):
    """Compare the ways of all inputs of the state at r with that to the fix at `at`; variance: of a component, m^2."""
    for kind in range(KINDS):
        _compare(mem, r, at, nonnegative(r + Kinds.SEEN + Seen.SIZE * kind), variance)
    width, inputs = int(mem[Head.WIDTH]), int(mem[Inputs.COUNT])
    for i in range(inputs):
        _compare(mem, r, at, nonnegative(r + width - INPUT_SIZE * (i + 1)), variance)


@njit(_nrt=False)
def _compare(mem, r, at, own, variance):
    time = mem[at + Event.TIME]
    if mem[own + Seen.WAY_TIME] == 0.0:
        return
    since = time - mem[own + Seen.WAY_TIME]
    last_n, last_e = mem[own + Seen.LAST] * since, mem[own + Seen.LAST + 1] * since
    if mem[own + Seen.START] != 0.0 and since <= LONGEST_PAUSE:
        north = (mem[at + Event.LATITUDE] - mem[own + Seen.START + 1]) / mem[r + Nav.NORTH_SCALE]
        east = (mem[at + Event.LONGITUDE] - mem[own + Seen.START + 2]) / mem[r + Nav.EAST_SCALE]
        way_n, way_e = mem[own + Seen.WAY] + last_n, mem[own + Seen.WAY + 1] + last_e
        fixes, speeds = math.hypot(north, east), math.hypot(way_n, way_e)
        longer, common = max(fixes, speeds), north * way_n + east * way_e
        both = 2.0 * variance + mem[own + Seen.VARIANCE]
        enough = longer > FEWEST_SIGMAS * math.sqrt(both)
        if not enough and time - mem[own + Seen.START] < LONGEST_WAY:
            return
        if not enough:  # nothing speaks against it, and a robot may never go further
            mem[own + Seen.COMPARED] = 1.0
        else:
            more = common / fixes - fixes if fixes > NO_DIRECTION * speeds else speeds - common / speeds
            _learn(mem, own, more / longer, both / longer**2 + UNEVEN**2)
    mem[own + Seen.START], mem[own + Seen.VARIANCE] = time, 0.0
    mem[own + Seen.WAY], mem[own + Seen.WAY + 1] = -last_n, -last_e  # what is before the fix is of the way before
    mem[own + Seen.START + 1], mem[own + Seen.START + 2] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]


@njit(_nrt=False)
def _learn(mem, own, more, noise):
    variance = PRIOR - mem[own + Seen.KNOWN] + FORGOTTEN * noise
    surprise, sigma = more - mem[own + Seen.MORE], math.sqrt(variance + noise)
    if abs(surprise) > LARGEST_SURPRISE * sigma:  # a fix that is far off, or from now on another speed
        variance += noise
        sigma = math.sqrt(variance + noise)
    variance = min(variance, PRIOR)
    surprise = max(-LARGEST_SURPRISE * sigma, min(surprise, LARGEST_SURPRISE * sigma))
    gain = variance / (variance + noise)
    mem[own + Seen.MORE] += gain * surprise
    mem[own + Seen.KNOWN] = PRIOR - (1.0 - gain) * variance
    if (1.0 - gain) * variance < COMPARED**2:
        mem[own + Seen.COMPARED] = 1.0


@njit(_nrt=False)
def is_compared(mem, own):
    """Whether the ways of an input have been known well enough to be contradicted, were they wrong."""
    return mem[own + Seen.COMPARED] != 0.0


@njit(_nrt=False)
def is_contradicted(mem, own):
    """Whether the ways of an input are certainly not those of the fixes."""
    return abs(mem[own + Seen.MORE]) > TOLERATED + CERTAIN * math.sqrt(PRIOR - mem[own + Seen.KNOWN])
