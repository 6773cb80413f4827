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
from .scale import Inputs, Seen

#: variance of that share before any way is compared: a speed is off by a fifth
PRIOR = 0.04
#: sigma of it over a way that is known exactly: stamps that are late while the speed changes, bends between samples
UNEVEN = 0.02
#: share of what one way tells by which the estimate is less known with each: twenty ways ago it was another
FORGOTTEN = 0.05
#: share of the way by the speeds below which that of the fixes has no direction of its own
NO_DIRECTION = 0.3
#: a way tells something where it is so many sigmas of both: of half as long ones UNEVEN and the sigmas hide a third
FEWEST_SIGMAS = 16.0
#: one that differs by more sigmas counts as that, but for the second in a row that is longer, or shorter
LARGEST_SURPRISE = 2.0
#: s: an input that pauses for longer has made a way that nobody knows
LONGEST_PAUSE = 1.5
#: s: fixes further apart are not compared, as the heading that the speeds are laid along has errors
LONGEST_WAY = 60.0
#: rad: with a heading that is less known only their lengths are compared, which do not depend on it
LARGEST_YAW_SIGMA = 0.3
#: what of a way is compared: its length along that of the fixes, its direction, its length
ALONG, DIRECTION, LENGTH = 0.0, 1.0, 2.0
#: a speed may be off by this share: tyres that nobody declared, which is about what the filter can estimate
TOLERATED = 0.05
#: sigmas beyond which more than that is certain
CERTAIN = 3.0
#: sigma of the share below which ways have been compared: after one, mostly, and three times that is certain
COMPARED = 0.09


@njit(_nrt=False)
def interrupt(mem, own):
    """What an input says now is no part of any way: the next one begins with the next fix."""
    mem[own + Seen.START] = 0.0


@njit(_nrt=False)
def travel(mem, own, time, v_n, v_e, density, yaw_variance, tells_direction):
    """Add what an input says at `time`, s, to its way. own: position of its `Seen`.

    v_n, v_e: velocity of the antenna, m/s, linear between two of them. density: variance of its way in a second, m^2/s.
    tells_direction: whether it tells a direction, and the length of the way is the state's.
    """
    if tells_direction:
        mem[own + Seen.COMPARED_IN] = DIRECTION
    elif yaw_variance > LARGEST_YAW_SIGMA**2:
        mem[own + Seen.COMPARED_IN] = LENGTH
    before, mem[own + Seen.WAY_TIME] = mem[own + Seen.WAY_TIME], time
    since = time - before
    if before != 0.0 and since > LONGEST_PAUSE:  # one so slow makes no way, and nothing can speak against it
        mem[own + Seen.COMPARED] = 1.0
    if not 0.0 < since <= LONGEST_PAUSE:
        interrupt(mem, own)
    mem[own + Seen.VARIANCE] += density * since
    for k, v in enumerate((v_n, v_e)):
        change, mem[own + Seen.LAST + k] = v - mem[own + Seen.LAST + k], v
        mem[own + Seen.WAY + k] += (v - 0.5 * change) * since
        mem[own + Seen.VARIANCE] += (change * since) ** 2 / 12.0  # it may have changed at any time in between


@njit(_nrt=False)
def compare(mem, r, at, variance):
    """Compare the ways of all inputs of the state at r with that to the fix at `at`; variance: of a component, m^2."""
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
        more, sigma = _differs(mem, own, north, east, mem[own + Seen.WAY] + last_n, mem[own + Seen.WAY + 1] + last_e,
                               2.0 * variance + mem[own + Seen.VARIANCE])
        tells = sigma < 1.0 / FEWEST_SIGMAS
        if time - mem[own + Seen.START] < LONGEST_WAY and not (tells and _is_enough(mem, own, more, sigma)):
            return
        if tells:
            _learn(mem, own, more, sigma**2 + UNEVEN**2)
        else:  # nothing speaks against it, and a robot may never go further
            mem[own + Seen.COMPARED] = 1.0
    mem[own + Seen.START], mem[own + Seen.VARIANCE], mem[own + Seen.COMPARED_IN] = time, 0.0, ALONG
    mem[own + Seen.WAY], mem[own + Seen.WAY + 1] = -last_n, -last_e  # what is before the fix is of the way before
    mem[own + Seen.START + 1], mem[own + Seen.START + 2] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]


@njit(_nrt=False)
def _differs(mem, own, north, east, way_n, way_e, variance):
    """By what share the way of an input is longer than that of the fixes (north, east), or, of one that tells a
    direction, by how much it is turned, rad; and the sigma of that by `variance`, m^2, of both."""
    fixes, speeds, common = math.hypot(north, east), math.hypot(way_n, way_e), north * way_n + east * way_e
    longer = max(fixes, speeds, 1e-9)
    if mem[own + Seen.COMPARED_IN] == DIRECTION:
        turned = math.atan2(north * way_e - east * way_n, common)
        # backwards is backwards: half a turn to the left and half a turn to the right had no turn as their mean
        return turned if common > 0.0 else abs(turned), math.sqrt(variance) / max(min(fixes, speeds), 1e-9)
    if mem[own + Seen.COMPARED_IN] == LENGTH:
        more = speeds - fixes
    else:
        more = common / fixes - fixes if fixes > NO_DIRECTION * speeds else speeds - common / max(speeds, 1e-9)
    return more / longer, math.sqrt(variance) / longer


@njit(_nrt=False)
def _is_enough(mem, own, more, sigma):
    """Whether a way is long enough to be compared: the first one is at once, later ones where it would tell no more if
    it were longer, or where it certainly says something else than those before."""
    expected = math.sqrt(PRIOR - mem[own + Seen.KNOWN] + sigma**2 + UNEVEN**2)
    return (mem[own + Seen.COMPARED] == 0.0 or sigma < UNEVEN
            or abs(more - mem[own + Seen.MORE]) > CERTAIN * expected)


@njit(_nrt=False)
def _learn(mem, own, more, noise):
    variance = min(PRIOR - mem[own + Seen.KNOWN] + FORGOTTEN * noise, PRIOR)
    surprise, sigma = more - mem[own + Seen.MORE], math.sqrt(variance + noise)
    far = math.copysign(1.0, surprise) if abs(surprise) > LARGEST_SURPRISE * sigma else 0.0
    if far != 0.0 and far == mem[own + Seen.SURPRISED]:  # from now on it is another speed
        variance = PRIOR
    elif far != 0.0:  # perhaps it is; or a fix is far off, which makes one way longer and the next one shorter
        variance = min(variance + noise, PRIOR)
        surprise = far * LARGEST_SURPRISE * math.sqrt(variance + noise)
    mem[own + Seen.SURPRISED] = far
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
def is_contradicted(mem, own, tolerated=TOLERATED):
    """Whether the ways of an input are certainly not those of the fixes. tolerated: share by which they may differ."""
    return abs(mem[own + Seen.MORE]) > tolerated + CERTAIN * math.sqrt(PRIOR - mem[own + Seen.KNOWN])
