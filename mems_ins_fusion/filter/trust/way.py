"""Whether a speed is the vehicle's: the way that it makes up is compared with the fixes.

A wheel speed in km/h, one of the wrong sign, wheels that slip on sand and a velocity in other axes are taken for
measurements with much noise, and twenty of them a second are more than a fix of metres each second can say against.
But whatever the filter thinks of its velocity, the fixes show the way within some metres.

A Kalman filter of its own, with two states for each input: how far the way that its speeds make up has gone away from
the antenna, m, and by what share it is longer than the way of the antenna. The share makes the distance grow; fixes
measure the distance. Both are complex numbers, north + i east: the real part of the share is length, the imaginary part
direction, as by a heading that is off. So the equations are those of one axis, and variances are real. An input whose
share is certainly wrong is refused, also when fixes end, until it is right again. A heading makes up a way as well: the
one that the nose leads along. All are ways of the antenna: a robot's turns on the spot, and the way that it makes
between two speeds, are longer than its fixes are uncertain.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.base import UNDECLARED_OFFSET
from ..memory import INPUT_SIZE, Event, Head, Kind, Nav, is_of_heading, nonnegative
from .hypotheses import LASTING
from .receiver import LASTING_TIME
from .scale import Inputs, Seen

#: variance of the share before any fix is compared: a speed in another unit, or of the wrong sign
PRIOR = 1.0
#: 1/m, by which it grows with the way: on another ground wheels slip by other shares, six percent in a kilometre
WANDERS = 4e-6
#: of a way within a second, one sigma: bends between samples, a heading that is a degree off
UNEVEN = 0.02
#: s over which a speed changes evenly
CHANGE_LASTS = 1.0
#: sigmas: a fix that is further off is passed over. After two in a row the fixes are elsewhere, or it is another speed
SURPRISE = 4.0
#: s: an input that pauses for longer has made a way that nobody knows
LONGEST_PAUSE = 1.5
#: rad: with a heading that is less known the way of wheels has no direction
LARGEST_YAW_SIGMA = 0.3
#: a speed may be off by this share: tyres that nobody declared, which is about what the filter can estimate
TOLERATED = 0.05
#: sigmas beyond which more than that is certain
CERTAIN = 3.0
#: sigma of the share below which an input has been compared: three times that would be certain of a third
COMPARED = 0.09


@njit(_nrt=False)
def interrupt(mem, own):
    """What an input says now is no part of any way: the next one begins with the next fix."""
    mem[own + Seen.START] = 0.0


@njit(_nrt=False)
def travel(mem, r, own, time, v_n, v_e, density, yaw_variance, late, late_variance):
    """Add what an input says at `time`, s, to its way. own: position of its `Seen`.

    v_n, v_e: velocity of the antenna, m/s, linear between two of them. density: variance of its way in a second, m^2/s.
    yaw_variance: of the direction that it has been laid along, rad^2. late: by which its stamps are late, s, and the
    variance of that.
    """
    before, mem[own + Seen.WAY_TIME] = mem[own + Seen.WAY_TIME], time
    since = time - before
    mem[own + Seen.GONE] += mem[r + Nav.V_N] * since
    mem[own + Seen.GONE + 1] += mem[r + Nav.V_E] * since
    if before != 0.0 and since > LONGEST_PAUSE:  # one so slow makes no way, and nothing can speak against it
        mem[own + Seen.COMPARED] = 1.0
    if yaw_variance > LARGEST_YAW_SIGMA**2:
        _forget_share(mem, own)
        interrupt(mem, own)
    if not 0.0 < since <= LONGEST_PAUSE:
        interrupt(mem, own)
    mem[own + Seen.VARIANCE] += density * since
    repeated = CHANGE_LASTS / max(since, 1e-3)
    for k, v in enumerate((v_n, v_e)):
        change, mem[own + Seen.LAST + k] = v - mem[own + Seen.LAST + k], v
        mem[own + Seen.WAY + k] += (v - 0.5 * change) * since + late * change
        # it may have changed at any time in between; and all within a second has the same lateness
        mem[own + Seen.VARIANCE] += ((since**2) / 12.0 + max(repeated, 1.0) * late_variance) * change**2


@njit(_nrt=False)
def forget(mem, own):
    """An input has become another one: it is wrong until it is known to be right."""
    _forget_share(mem, own)
    interrupt(mem, own)
    mem[own + Seen.COMPARED] = -1.0


@njit(_nrt=False)
def _forget_share(mem, own):
    """Nothing is known of the share but the prior."""
    mem[own + Seen.SHARE] = mem[own + Seen.SHARE + 1] = mem[own + Seen.KNOWN] = 0.0


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
    interval = time - mem[own + Seen.START]
    # stamps that are late by more than has been found yet
    noise = variance + UNDECLARED_OFFSET**2 * (mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2)
    if interval > 0.0:  # errors of a fix last: all fixes within that time count as one
        noise *= max(1.0, LASTING / interval)
    if mem[own + Seen.START] == 0.0 or since > LONGEST_PAUSE:
        _begin(mem, own, noise)
    elif interval <= 0.0:
        return
    else:
        north = (mem[at + Event.LATITUDE] - mem[own + Seen.START + 1]) / mem[r + Nav.NORTH_SCALE]
        east = (mem[at + Event.LONGITUDE] - mem[own + Seen.START + 2]) / mem[r + Nav.EAST_SCALE]
        way = complex(mem[own + Seen.WAY] + last_n, mem[own + Seen.WAY + 1] + last_e)
        drift = (mem[own + Seen.VARIANCE] + UNEVEN**2 * abs(way) ** 2 / interval
                 + 2.0 * mem[r + Nav.LASTING] * interval / LASTING_TIME)
        if not learn(mem, own, way, complex(north, east), drift, noise):
            return
    mem[own + Seen.START], mem[own + Seen.VARIANCE] = time, 0.0
    mem[own + Seen.GONE] = mem[own + Seen.GONE + 1] = 0.0
    mem[own + Seen.WAY], mem[own + Seen.WAY + 1] = -last_n, -last_e  # what is before the fix is of the way before
    mem[own + Seen.START + 1], mem[own + Seen.START + 2] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]


@njit(_nrt=False)
def _begin(mem, own, noise):
    """The way of an input begins anew, at a fix with this variance, m^2; what its share is stays known."""
    for i in range(2):
        mem[own + Seen.GAP + i] = mem[own + Seen.TOGETHER + i] = 0.0
    mem[own + Seen.GAP_VARIANCE], mem[own + Seen.SURPRISED] = noise, 0.0


@njit(_nrt=False)
def learn(mem, own, way, fixes, drift, noise):
    """Learn from the way of an input and of the fixes since the fix before, m, north + i east. own: of its `Seen`.

    drift: variance that the distance gathers besides; noise: of the fix, m^2. Whether the fix has been compared, and
    the next way begins at it.
    """
    # that of the filter: that of the input has noise, which would pass for a share of its own
    gone = complex(mem[own + Seen.GONE], mem[own + Seen.GONE + 1])
    share = complex(mem[own + Seen.SHARE], mem[own + Seen.SHARE + 1])
    together = complex(mem[own + Seen.TOGETHER], mem[own + Seen.TOGETHER + 1])  # covariance of distance and share
    variance = min(PRIOR - mem[own + Seen.KNOWN] + WANDERS * abs(gone), PRIOR)
    gap = (mem[own + Seen.GAP_VARIANCE] + 2.0 * (together * gone.conjugate()).real + abs(gone) ** 2 * variance + drift)
    together += gone * variance
    # the distance as estimated, less the one measured at the fix before, is in GAP
    surprise = way - fixes - share * gone - complex(mem[own + Seen.GAP], mem[own + Seen.GAP + 1])
    if abs(surprise) ** 2 > SURPRISE**2 * (gap + noise):
        mem[own + Seen.SURPRISED] += 1.0
        if mem[own + Seen.SURPRISED] < 2.0:
            return False
        # one that was wrong is so until it is known to be right
        wrong = _is_certain(mem, own, abs(share), TOLERATED)
        mem[own + Seen.COMPARED], mem[own + Seen.KNOWN] = -1.0 if wrong else 0.0, 0.0
        _begin(mem, own, noise)
        return True
    gain = gap / (gap + noise)
    share += together.conjugate() * surprise / (gap + noise)
    variance -= abs(together) ** 2 / (gap + noise)
    together *= 1.0 - gain
    left = (gain - 1.0) * surprise
    mem[own + Seen.SHARE], mem[own + Seen.SHARE + 1], mem[own + Seen.KNOWN] = share.real, share.imag, PRIOR - variance
    mem[own + Seen.TOGETHER], mem[own + Seen.TOGETHER + 1] = together.real, together.imag
    mem[own + Seen.GAP], mem[own + Seen.GAP + 1], mem[own + Seen.GAP_VARIANCE] = left.real, left.imag, gain * noise
    mem[own + Seen.SURPRISED] = 0.0
    if variance < COMPARED**2:
        mem[own + Seen.COMPARED] = 1.0
    return True


@njit(_nrt=False)
def is_compared(mem, own):
    """Whether the ways of an input have been known well enough to be contradicted, were they wrong."""
    return mem[own + Seen.COMPARED] != 0.0


@njit(_nrt=False)
def is_contradicted(mem, own, kind, tolerated):
    """Whether the ways of an input of this kind are certainly not those of the fixes. tolerated: share by which they
    may differ; of a heading, rad."""
    share = complex(mem[own + Seen.SHARE], mem[own + Seen.SHARE + 1])
    if is_of_heading(kind):
        off = abs(math.atan2(share.imag, 1.0 + share.real))
    else:
        off = abs(share) if kind == Kind.VELOCITY else abs(share.real)
    return mem[own + Seen.COMPARED] < 0.0 or _is_certain(mem, own, off, tolerated)


@njit(_nrt=False)
def _is_certain(mem, own, off, tolerated):
    return off > tolerated + CERTAIN * math.sqrt(PRIOR - mem[own + Seen.KNOWN])
