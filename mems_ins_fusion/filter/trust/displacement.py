"""Whether a speed is the vehicle's: the displacement that it integrates to is compared with that between fixes.

A wheel speed in km/h, one of the wrong sign, wheels that slip on sand and a velocity in other axes are taken for
measurements with much noise, and twenty of them a second are more than a fix of metres each second can say against.
But whatever velocity the filter estimates, the fixes show the displacement to some metres.

A Kalman filter of its own, with two states for each input: the distance between the integral of its speeds and the
antenna, m, and the share by which its displacement is longer than that of the antenna. The share makes the distance
grow; fixes measure the distance. Both are complex numbers, north + i east: the real part of the share is length, the
imaginary part direction, as of a heading that is off. So the equations are those of one axis, and variances are real.
An input whose share is significantly wrong is refused, also when fixes end, until it is right again. A heading has a
displacement, too: along the nose, with the forward speed of the state. All are displacements of the antenna: in a turn
on the spot it moves by more than fixes are uncertain.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.base import UNDECLARED_OFFSET
from ..memory import INPUT_SIZE, Event, Head, Kind, Nav, is_of_heading, nonnegative
from .hypotheses import SHORTEST_CORRELATION
from .receiver import LASTING_TIME
from .scale import Inputs, Seen

#: variance of the share before any fix is compared: a speed in another unit, or of the wrong sign
PRIOR = 1.0
#: 1/m, by which it grows with the distance travelled: on another ground wheels slip by another share, six percent in a
#: kilometre
SHARE_WALK = 4e-6
#: error of a displacement within a second, as a share of it, one sigma: bends between samples, a heading one degree off
UNEVEN_SHARE = 0.02
#: sigmas: a fix that is further off is not compared (four: one of 3000 by chance, chosen). After two in a row the fixes
#: have jumped, or the speed has changed: the distance and its share begin anew
GATE = 4.0
#: s: over a longer pause of an input its displacement is unknown
LONGEST_PAUSE = 1.5
#: rad: with a heading that is less known the displacement of wheels has no direction
LARGEST_YAW_SIGMA = 0.3
#: a speed may be off by this share: tyres that nobody declared, which is about what the filter can estimate
TOLERATED_SHARE = 0.05
#: sigmas beyond which a share is significantly larger than that
SIGNIFICANT = 3.0
#: sigma of the share below which an input has been compared: a share of a third is then significant
COMPARED_SIGMA = 0.09


@njit(_nrt=False)
def interrupt(mem, own):
    """What an input measures now is part of no displacement: the next one begins with the next fix."""
    mem[own + Seen.START] = 0.0


@njit(_nrt=False)
def integrate(mem, r, own, time, v_n, v_e, density, yaw_variance, late, late_variance):
    """Integrate the velocity that an input measures at `time`, s. own: position of its `Seen`.

    v_n, v_e: velocity of the antenna, m/s, linear between two of them. density: variance of the integral in 1 s, m^2/s.
    yaw_variance: of the heading it was turned by, rad^2. late: by which its stamps are late, s, late_variance: the
    variance of that.
    """
    before, mem[own + Seen.DISPLACEMENT_TIME] = mem[own + Seen.DISPLACEMENT_TIME], time
    since = time - before
    mem[own + Seen.TRAVELLED] += mem[r + Nav.V_N] * since
    mem[own + Seen.TRAVELLED + 1] += mem[r + Nav.V_E] * since
    if before != 0.0 and since > LONGEST_PAUSE:  # too slow to be integrated, so nothing contradicts it
        _believe(mem, own)
    if yaw_variance > LARGEST_YAW_SIGMA**2:
        forget_share(mem, own)
        interrupt(mem, own)
    if not 0.0 < since <= LONGEST_PAUSE:
        interrupt(mem, own)
    mem[own + Seen.VARIANCE] += density * since
    mem[own + Seen.LATE] = 0.0
    for k, v in enumerate((v_n, v_e)):
        change, mem[own + Seen.LAST + k] = v - mem[own + Seen.LAST + k], v
        mem[own + Seen.DISPLACEMENT + k] += (v - 0.5 * change) * since + late * change
        mem[own + Seen.VARIANCE] += since**2 / 12.0 * change**2  # it may have changed at any time in between
        mem[own + Seen.LATE] += late_variance * (v - mem[own + Seen.BEGAN + k]) ** 2


@njit(_nrt=False)
def forget(mem, own):
    """An input has become another one: it is wrong until it is known to be right."""
    forget_share(mem, own)
    interrupt(mem, own)
    mem[own + Seen.COMPARED] = -1.0


@njit(_nrt=False)
def forget_share(mem, own):
    """Nothing is known of the share but the prior."""
    mem[own + Seen.SHARE] = mem[own + Seen.SHARE + 1] = mem[own + Seen.REDUCED] = 0.0


@njit(_nrt=False)
def compare(mem, r, at, variance):
    """Compare the displacements of all inputs with that to the fix at `at`; variance: of one of its components, m^2."""
    width, inputs = int(mem[Head.WIDTH]), int(mem[Inputs.COUNT])
    for i in range(inputs):
        _compare(mem, r, at, nonnegative(r + width - INPUT_SIZE * (i + 1)), variance)


@njit(_nrt=False)
def _compare(mem, r, at, own, variance):
    time = mem[at + Event.TIME]
    if mem[own + Seen.DISPLACEMENT_TIME] == 0.0:
        return
    since = time - mem[own + Seen.DISPLACEMENT_TIME]
    last_n, last_e = mem[own + Seen.LAST] * since, mem[own + Seen.LAST + 1] * since
    interval = time - mem[own + Seen.START]
    # stamps that are late by more than has been found yet
    noise = variance + UNDECLARED_OFFSET**2 * (mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2)
    if interval > 0.0:  # errors of a fix last: all fixes within that time count as one
        noise *= max(1.0, SHORTEST_CORRELATION / interval)
    if mem[own + Seen.START] == 0.0 or since > LONGEST_PAUSE:
        _begin(mem, own, noise)
    elif interval <= 0.0:
        return
    else:
        north = (mem[at + Event.LATITUDE] - mem[own + Seen.START + 1]) / mem[r + Nav.NORTH_SCALE]
        east = (mem[at + Event.LONGITUDE] - mem[own + Seen.START + 2]) / mem[r + Nav.EAST_SCALE]
        moved = complex(mem[own + Seen.DISPLACEMENT] + last_n, mem[own + Seen.DISPLACEMENT + 1] + last_e)
        drift = (mem[own + Seen.VARIANCE] + mem[own + Seen.LATE] + UNEVEN_SHARE**2 * abs(moved) ** 2 / interval
                 + 2.0 * mem[r + Nav.LASTING] * interval / LASTING_TIME)
        if not learn(mem, own, moved, complex(north, east), drift, noise):
            return
    mem[own + Seen.START], mem[own + Seen.VARIANCE] = time, 0.0
    mem[own + Seen.TRAVELLED] = mem[own + Seen.TRAVELLED + 1] = 0.0
    # what is before the fix belongs to the displacement before
    mem[own + Seen.DISPLACEMENT], mem[own + Seen.DISPLACEMENT + 1] = -last_n, -last_e
    mem[own + Seen.BEGAN], mem[own + Seen.BEGAN + 1] = mem[own + Seen.LAST], mem[own + Seen.LAST + 1]
    mem[own + Seen.LATE] = 0.0
    mem[own + Seen.START + 1], mem[own + Seen.START + 2] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]


@njit(_nrt=False)
def _begin(mem, own, noise):
    """The distance of an input begins anew, at a fix with this variance, m^2; the estimate of its share stays."""
    for i in range(2):
        mem[own + Seen.DISTANCE + i] = mem[own + Seen.COVARIANCE + i] = 0.0
    mem[own + Seen.DISTANCE_VARIANCE], mem[own + Seen.REJECTED] = noise, 0.0


@njit(_nrt=False)
def learn(mem, own, moved, fixes, drift, noise):
    """Learn from the displacement of an input (moved) and of the fixes, since the fix before, m, north + i east.

    own: position of its `Seen`.

    drift: variance that the distance gathers besides; noise: of the fix, m^2. Returns whether the fix has been
    compared, and the next displacement begins at it.
    """
    # that of the filter: that of the input has noise, which would pass for a share of its own
    travelled = complex(mem[own + Seen.TRAVELLED], mem[own + Seen.TRAVELLED + 1])
    share = complex(mem[own + Seen.SHARE], mem[own + Seen.SHARE + 1])
    covariance = complex(mem[own + Seen.COVARIANCE], mem[own + Seen.COVARIANCE + 1])  # covariance of distance and share
    variance = min(PRIOR - mem[own + Seen.REDUCED] + SHARE_WALK * abs(travelled), PRIOR)
    expected = (mem[own + Seen.DISTANCE_VARIANCE] + 2.0 * (covariance * travelled.conjugate()).real
                + abs(travelled) ** 2 * variance + drift)
    covariance += travelled * variance
    # the distance as estimated, less the one measured at the fix before, is in DISTANCE
    innovation = moved - fixes - share * travelled - complex(mem[own + Seen.DISTANCE], mem[own + Seen.DISTANCE + 1])
    if abs(innovation) ** 2 > GATE**2 * (expected + noise):
        mem[own + Seen.REJECTED] += 1.0
        if mem[own + Seen.REJECTED] < 2.0:
            return False
        # one that was wrong is so until it is known to be right
        wrong = _is_significant(mem, own, abs(share), TOLERATED_SHARE)
        mem[own + Seen.COMPARED], mem[own + Seen.REDUCED] = -1.0 if wrong else 0.0, 0.0
        _begin(mem, own, noise)
        return True
    gain = expected / (expected + noise)
    share += covariance.conjugate() * innovation / (expected + noise)
    variance -= abs(covariance) ** 2 / (expected + noise)
    covariance *= 1.0 - gain
    left = (gain - 1.0) * innovation
    mem[own + Seen.SHARE], mem[own + Seen.SHARE + 1], mem[own + Seen.REDUCED] = share.real, share.imag, PRIOR - variance
    mem[own + Seen.COVARIANCE], mem[own + Seen.COVARIANCE + 1] = covariance.real, covariance.imag
    mem[own + Seen.DISTANCE], mem[own + Seen.DISTANCE + 1] = left.real, left.imag
    mem[own + Seen.DISTANCE_VARIANCE] = gain * noise
    mem[own + Seen.REJECTED] = 0.0
    if variance < COMPARED_SIGMA**2:
        _believe(mem, own)
    return True


@njit(_nrt=False)
def _believe(mem, own):
    """Nothing has to be awaited before an input is believed."""
    if mem[own + Seen.COMPARED] <= 0.0:
        mem[own + Seen.COMPARED] = mem[own + Seen.DISPLACEMENT_TIME]


@njit(_nrt=False)
def is_compared(mem, own):
    """Whether the share of an input has been known well enough to be contradicted, were it wrong."""
    return mem[own + Seen.COMPARED] != 0.0


@njit(_nrt=False)
def differs(mem, own, kind, tolerated):
    """Whether the displacements of an input of this kind are significantly not those of the fixes. tolerated: share by
    which they may differ; of a heading, rad."""
    share = complex(mem[own + Seen.SHARE], mem[own + Seen.SHARE + 1])
    if is_of_heading(kind):
        off = abs(math.atan2(share.imag, 1.0 + share.real))
    else:
        off = abs(share) if kind == Kind.VELOCITY else abs(share.real)
    return mem[own + Seen.COMPARED] < 0.0 or _is_significant(mem, own, off, tolerated)


@njit(_nrt=False)
def _is_significant(mem, own, off, tolerated):
    return off > tolerated + SIGNIFICANT * math.sqrt(PRIOR - mem[own + Seen.REDUCED])
