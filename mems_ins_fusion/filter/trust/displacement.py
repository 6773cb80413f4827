"""Consistency check of velocity inputs: the integral of an input is compared with the displacement between fixes.

A speed in km/h or of the wrong sign, slipping wheels, and a velocity in other axes look like measurements with much
noise, and at 20 Hz they outweigh fixes at 1 Hz. But the displacement between fixes is known to some metres, whatever
velocity the filter estimates.

For each input there is a separate Kalman filter with two states:

* the *distance* d from the antenna to the point that the input's velocity leads to when it is integrated, m;
* the *relative error* s by which the input's displacement is longer than that of the antenna.

The distance changes by s times the displacement, and each fix measures it. Both are complex numbers, north + i east:
the real part of the relative error is one of length, the imaginary part one of direction, as by a wrong heading. Thus
the equations are those of one axis, and variances are real. An input with a significant relative error is refused until
it is right again, also without fixes. A heading is integrated as well, with the forward speed of the state. All
displacements are those of the antenna, which in a turn on the spot moves by more than the noise of the fixes.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.base import UNDECLARED_OFFSET
from ..memory import INPUT, INPUT_SIZE, Event, Head, Kind, Nav, is_of_heading, nonnegative
from .hypotheses import SHORTEST_CORRELATION
from .receiver import LASTING_TIME
from .scale import Inputs

#: of an input
Integral = INPUT.place(
    'Integral',
    DISPLACEMENT=2,  # m, north and east, integral of its velocity since the fix START,
    TIME=1,  # s, end of the integral; 0: nothing was integrated
    START=3,  # time (s; 0: none), latitude and longitude (rad) of that fix
    LAST=2,  # m/s, latest velocity, north and east
    BEGAN=2,  # m/s, the same at START
    VARIANCE=1,  # m^2, of the displacement,
    LATE=1,  # and by the error of its time offset
    TRAVELLED=2,  # m, north and east, displacement of the filter since START
    DISTANCE=2,  # m, north and east, from the antenna to the integral: estimate minus measurement at START,
    DISTANCE_VARIANCE=1,  # m^2, variance of the estimate,
    COVARIANCE=2,  # m, and its covariance with the relative error
    RELATIVE_ERROR=2,  # by which its displacements are longer than those of the antenna, and to the side,
    REDUCED=1,  # and ERROR_PRIOR minus its variance
    COMPARED=1,  # s, time at which the comparison was complete; 0: not yet; -1: begun anew after it was wrong
    REJECTED=1)  # number of fixes in a row that were not compared
#: prior variance of the relative error: a speed in another unit, or of the wrong sign
ERROR_PRIOR = 1.0
#: 1/m, growth of the variance of the relative error with the distance travelled: slip changes with the ground, by six
#: percent in a kilometre
ERROR_WALK = 4e-6
#: standard deviation of a displacement within a second over its length: bends between samples, a heading error of one
#: degree
UNEVENNESS = 0.02
#: a fix beyond this many standard deviations is not compared: one of 3000 by chance. After two in a row the fixes have
#: jumped or the input has changed, and the estimate begins anew. Chosen, not measured
COMPARED_GATE = 4.0
#: s: after a longer pause of an input its displacement is unknown
LONGEST_PAUSE = 1.5
#: rad: with a larger standard deviation of the heading, the direction of a displacement of wheels is unknown
LARGEST_HEADING_SIGMA = 0.3
#: relative error that is none: tyres of another size, about as much as the filter itself can estimate
TOLERATED_ERROR = 0.05
#: standard deviations by which a relative error has to exceed the tolerated one to be significant
ERROR_SIGMAS = 3.0
#: standard deviation of the relative error below which the comparison is complete: one of a third would be significant
COMPARED_SIGMA = 0.09


@njit(_nrt=False)
def interrupt(mem, own):
    """End the displacement of an input: the next one begins with the next fix."""
    mem[own + Integral.START] = 0.0


@njit(_nrt=False)
def integrate(mem, r, own, time, v_n, v_e, density, yaw_variance, late, late_variance):
    """Integrate the velocity that an input measures at `time`, s. own: position of its columns.

    v_n, v_e: velocity of the antenna, m/s; linear between two measurements. density: variance of the integral in 1 s,
    m^2/s. yaw_variance: of the heading by which the velocity was rotated, rad^2. late, late_variance: estimated time
    offset of its stamps, s, and the variance of this estimate.
    """
    before, mem[own + Integral.TIME] = mem[own + Integral.TIME], time
    since = time - before
    mem[own + Integral.TRAVELLED] += mem[r + Nav.V_N] * since
    mem[own + Integral.TRAVELLED + 1] += mem[r + Nav.V_E] * since
    if before != 0.0 and since > LONGEST_PAUSE:  # too slow to be integrated: accepted without a comparison
        accept(mem, own)
    if yaw_variance > LARGEST_HEADING_SIGMA**2:
        forget_error(mem, own)
        interrupt(mem, own)
    if not 0.0 < since <= LONGEST_PAUSE:
        interrupt(mem, own)
    mem[own + Integral.VARIANCE] += density * since
    mem[own + Integral.LATE] = 0.0
    for k, v in enumerate((v_n, v_e)):
        change, mem[own + Integral.LAST + k] = v - mem[own + Integral.LAST + k], v
        mem[own + Integral.DISPLACEMENT + k] += (v - 0.5 * change) * since + late * change
        mem[own + Integral.VARIANCE] += since**2 / 12.0 * change**2  # it may have changed at any time in between
        mem[own + Integral.LATE] += late_variance * (v - mem[own + Integral.BEGAN + k]) ** 2


@njit(_nrt=False)
def forget(mem, own):
    """Begin the comparison of an input anew after it has changed; the input counts as wrong until it is right again
    (`inputs._is_right_again`)."""
    forget_error(mem, own)
    interrupt(mem, own)
    mem[own + Integral.COMPARED] = -1.0


@njit(_nrt=False)
def forget_error(mem, own):
    """Reset the relative error to its prior."""
    mem[own + Integral.RELATIVE_ERROR] = mem[own + Integral.RELATIVE_ERROR + 1] = mem[own + Integral.REDUCED] = 0.0


@njit(_nrt=False)
def compare(mem, r, at, variance):
    """Compare the displacement of each input with that to the fix at `at`. variance: of one component of it, m^2."""
    width, inputs = int(mem[Head.WIDTH]), int(mem[Inputs.COUNT])
    for i in range(inputs):
        _compare(mem, r, at, nonnegative(r + width - INPUT_SIZE * (i + 1)), variance)


@njit(_nrt=False)
def _compare(mem, r, at, own, variance):
    time = mem[at + Event.TIME]
    if mem[own + Integral.TIME] == 0.0:
        return
    since = time - mem[own + Integral.TIME]
    last_n, last_e = mem[own + Integral.LAST] * since, mem[own + Integral.LAST + 1] * since
    interval = time - mem[own + Integral.START]
    # with the error by a time offset that has not been estimated yet
    noise = variance + UNDECLARED_OFFSET**2 * (mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2)
    if interval > 0.0:  # errors of successive fixes are correlated: all fixes within this time count as one
        noise *= max(1.0, SHORTEST_CORRELATION / interval)
    if mem[own + Integral.START] == 0.0 or since > LONGEST_PAUSE:
        _begin(mem, own, noise)
    elif interval <= 0.0:
        return
    else:
        north = (mem[at + Event.LATITUDE] - mem[own + Integral.START + 1]) / mem[r + Nav.NORTH_SCALE]
        east = (mem[at + Event.LONGITUDE] - mem[own + Integral.START + 2]) / mem[r + Nav.EAST_SCALE]
        moved = complex(mem[own + Integral.DISPLACEMENT] + last_n, mem[own + Integral.DISPLACEMENT + 1] + last_e)
        drift = (mem[own + Integral.VARIANCE] + mem[own + Integral.LATE] + UNEVENNESS**2 * abs(moved) ** 2 / interval
                 + 2.0 * mem[r + Nav.LASTING] * interval / LASTING_TIME)
        if not learn(mem, own, moved, complex(north, east), drift, noise):
            return
    mem[own + Integral.START], mem[own + Integral.VARIANCE] = time, 0.0
    mem[own + Integral.TRAVELLED] = mem[own + Integral.TRAVELLED + 1] = 0.0
    # the time up to the fix belongs to the previous displacement
    mem[own + Integral.DISPLACEMENT], mem[own + Integral.DISPLACEMENT + 1] = -last_n, -last_e
    mem[own + Integral.BEGAN], mem[own + Integral.BEGAN + 1] = mem[own + Integral.LAST], mem[own + Integral.LAST + 1]
    mem[own + Integral.LATE] = 0.0
    mem[own + Integral.START + 1], mem[own + Integral.START + 2] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]


@njit(_nrt=False)
def _begin(mem, own, noise):
    """Begin the distance of an input anew at a fix with the variance `noise`, m^2. That of the relative error stays."""
    for i in range(2):
        mem[own + Integral.DISTANCE + i] = mem[own + Integral.COVARIANCE + i] = 0.0
    mem[own + Integral.DISTANCE_VARIANCE], mem[own + Integral.REJECTED] = noise, 0.0


@njit(_nrt=False)
def learn(mem, own, moved, fixes, drift, noise):
    """Kalman step with the displacements since the previous fix by an input (moved) and the fixes, m, north + i east.

    own: position of the input's columns. drift: process noise of the distance, m^2. noise: variance of the fix, m^2.
    Returns whether the fix was compared, so that the next displacement begins at it.
    """
    # displacement of the filter: that of the input contains noise, which would make the relative error too small
    travelled = complex(mem[own + Integral.TRAVELLED], mem[own + Integral.TRAVELLED + 1])
    relative = complex(mem[own + Integral.RELATIVE_ERROR], mem[own + Integral.RELATIVE_ERROR + 1])
    # of distance and relative error
    covariance = complex(mem[own + Integral.COVARIANCE], mem[own + Integral.COVARIANCE + 1])
    variance = min(ERROR_PRIOR - mem[own + Integral.REDUCED] + ERROR_WALK * abs(travelled), ERROR_PRIOR)
    expected = (mem[own + Integral.DISTANCE_VARIANCE] + 2.0 * (covariance * travelled.conjugate()).real
                + abs(travelled) ** 2 * variance + drift)
    covariance += travelled * variance
    # DISTANCE holds the distance estimated minus that measured at the previous fix
    distance = complex(mem[own + Integral.DISTANCE], mem[own + Integral.DISTANCE + 1])
    innovation = moved - fixes - relative * travelled - distance
    if abs(innovation) ** 2 > COMPARED_GATE**2 * (expected + noise):
        mem[own + Integral.REJECTED] += 1.0
        if mem[own + Integral.REJECTED] < 2.0:
            return False
        # an input that was wrong stays wrong until it is right again
        wrong = _is_significant(mem, own, abs(relative), TOLERATED_ERROR)
        mem[own + Integral.COMPARED], mem[own + Integral.REDUCED] = -1.0 if wrong else 0.0, 0.0
        _begin(mem, own, noise)
        return True
    gain = expected / (expected + noise)
    relative += covariance.conjugate() * innovation / (expected + noise)
    variance -= abs(covariance) ** 2 / (expected + noise)
    covariance *= 1.0 - gain
    left = (gain - 1.0) * innovation
    mem[own + Integral.RELATIVE_ERROR], mem[own + Integral.RELATIVE_ERROR + 1] = relative.real, relative.imag
    mem[own + Integral.REDUCED] = ERROR_PRIOR - variance
    mem[own + Integral.COVARIANCE], mem[own + Integral.COVARIANCE + 1] = covariance.real, covariance.imag
    mem[own + Integral.DISTANCE], mem[own + Integral.DISTANCE + 1] = left.real, left.imag
    mem[own + Integral.DISTANCE_VARIANCE] = gain * noise
    mem[own + Integral.REJECTED] = 0.0
    if variance < COMPARED_SIGMA**2:
        accept(mem, own)
    return True


@njit(_nrt=False)
def accept(mem, own):
    """Mark the comparison of an input as complete."""
    if mem[own + Integral.COMPARED] <= 0.0:
        mem[own + Integral.COMPARED] = mem[own + Integral.TIME]


@njit(_nrt=False)
def is_compared(mem, own):
    """Whether the comparison of an input is complete: a wrong input would have been significant."""
    return mem[own + Integral.COMPARED] > 0.0


@njit(_nrt=False)
def squared_error(mem, own):
    """Square of the relative error that an input has, beyond what the variance of its estimate explains."""
    square = mem[own + Integral.RELATIVE_ERROR] ** 2 + mem[own + Integral.RELATIVE_ERROR + 1] ** 2
    return max(square - 2.0 * (ERROR_PRIOR - mem[own + Integral.REDUCED]), 0.0)


@njit(_nrt=False)
def differs(mem, own, kind, tolerated):
    """Whether the displacements of an input of this kind differ significantly from those of the fixes. tolerated:
    relative error up to which they may differ; of a heading, rad."""
    relative = complex(mem[own + Integral.RELATIVE_ERROR], mem[own + Integral.RELATIVE_ERROR + 1])
    if is_of_heading(kind):
        off = abs(math.atan2(relative.imag, 1.0 + relative.real))
    else:
        off = abs(relative) if kind == Kind.VELOCITY else abs(relative.real)
    return _is_significant(mem, own, off, tolerated)


@njit(_nrt=False)
def _is_significant(mem, own, off, tolerated):
    return off > tolerated + ERROR_SIGMAS * math.sqrt(ERROR_PRIOR - mem[own + Integral.REDUCED])
