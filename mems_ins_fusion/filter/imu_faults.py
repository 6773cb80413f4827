"""Which IMU samples can be believed, by what the sensor itself has shown before.

A sample that is not believed is not lost time: the filter bridges it, first as if the vehicle went on as it did, then
as if it neither turned nor changed its speed, with a covariance that knows what a vehicle may do meanwhile.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from mems_ins_fusion.compiled import njit

from .layout import Head, Nav


class _Fault(NamedTuple):
    """Why a sample is not believed."""

    NONE: int = 0
    RANGE: int = 1  # beyond what imu.max_specific_force or imu.max_angular_rate allow
    SPIKE: int = 2  # far from its neighbours
    SATURATED: int = 3  # an axis stays at a large value to the last digit
    FROZEN: int = 4  # an axis that always changes repeats itself to the last digit while the vehicle moves, or all do
    ZERO: int = 5  # all axes zero: no gravity
    WHIRL: int = 6  # a turn that no wheels hold at that speed
    DOUBTED: int = 7  # nothing wrong with it, but the fixes have contradicted those before it
    SIZE: int = 8


Fault = _Fault()
#: in words, by number
FAULTS = ('', 'out of range', 'spike', 'saturated', 'frozen', 'all zero',
          'a turn that is too fast for the speed (imu.rate_unit?)',
          'contradicted by the fixes (units? imu.mounting_rpy?)')

#: the vehicle certainly moves above this speed, m/s
MOVING_SPEED = 1.0
#: time constant of the running mean that neighbours are told by, s
NEIGHBOURHOOD = 0.2
#: a sample this far from it, plus so many sigma, is a spike, unless it lasts
JUMP_FORCE, JUMP_RATE, JUMP_SIGMAS = 30.0, 2.0, 8.0  # m/s^2, rad/s
LONGEST_SPIKE = 0.25  # s
#: values that a vehicle reaches, but does not keep to the last digit
LARGE_FORCE, LARGE_RATE = 15.0, 1.5  # m/s^2, rad/s
#: so many equal values are no chance where the sensor's noise shows in its last digit
FEWEST_EQUAL = 2
FROZEN_TIME = 0.3  # s
#: and of one axis so many, where it has changed with so much of the samples: the digits of others are coarse
FEWEST_STUCK, ALWAYS = 5.0, 0.9
#: speed times turn rate that no vehicle reaches, m/s^2
FASTEST_WHIRL = 50.0
#: so long it may last in all, s, before the sensor is not believed any more; it is forgotten at this rate, s/s
LONGEST_WHIRL, FORGET_WHIRL, MOST_WHIRL = 0.5, 0.01, 3.0
#: a filter that has strayed twice from fixes that were right does not believe the IMU for so long, s, twice as long
#: each time up to so many times
DOUBT_TIME, MOST_STRAYED = 60.0, 8.0


@njit(_nrt=False)
def is_doubted(mem, r, time):
    """Whether what the fixes have shown till the state at r speaks against the IMU at `time`."""
    if mem[Head.WHIRLED] > LONGEST_WHIRL:
        return True
    lasts = DOUBT_TIME * 2.0 ** (min(mem[r + Nav.STRAYED], MOST_STRAYED) - 2.0)
    return mem[r + Nav.STRAYED] >= 2.0 and time - mem[r + Nav.STRAYED_TIME] < lasts


@njit(_nrt=False)
def _whirls(mem, speed, dt):
    """Whether the vehicle would have to turn faster than it can at this speed, m/s; how long it has is remembered."""
    turn = mem[Head.OFFSET + 5]
    for j in range(6):
        turn += mem[Head.CONDITIONING + 30 + j] * mem[Head.RAW + j]
    whirls = speed * abs(turn) > FASTEST_WHIRL
    mem[Head.WHIRLED] = min(mem[Head.WHIRLED] + dt, MOST_WHIRL) if whirls else max(
        mem[Head.WHIRLED] - FORGET_WHIRL * dt, 0.0)
    return whirls


@njit(_nrt=False)
def check(mem, samples, k, dt, speed, doubted):
    """What is wrong with sample k, a `Fault`; it, and what it shows, is remembered in the head of `mem`.

    samples (n, 7): time (s), specific force and angular rate in sensor axes. dt: s since the one before. speed: that
    the vehicle certainly has, m/s. doubted: whether the IMU is not believed at this time.
    """
    moving = speed > MOVING_SPEED
    time = samples[k, 0]
    equal, zero, out, saturated, stuck = 1e9, True, False, False, 0
    lively = mem[Head.VARIED] > 0.5 * mem[Head.BELIEVED] and mem[Head.BELIEVED] > 10.0
    for i in range(6):
        value = samples[k, 1 + i]
        mem[Head.SAME + i] = mem[Head.SAME + i] + 1.0 if value == mem[Head.RAW + i] else 0.0
        mem[Head.RAW + i] = value
        equal = min(equal, mem[Head.SAME + i])
        zero = zero and value == 0.0
        out = out or abs(value) > mem[Head.MAX_FORCE + (i >= 3)]
        large = abs(value) > (LARGE_FORCE if i < 3 else LARGE_RATE)
        saturated = saturated or (large and mem[Head.SAME + i] >= FEWEST_EQUAL)
        stuck += 1 if _stays(mem, i, dt) else 0
    fault = Fault.NONE
    if out:
        fault = Fault.RANGE
    elif lively and zero:
        fault = Fault.ZERO
    elif lively and saturated:
        fault = Fault.SATURATED
    elif lively and (moving and (equal >= FEWEST_EQUAL and equal * dt > FROZEN_TIME or stuck > 0) or stuck == 6):
        fault = Fault.FROZEN
    elif _is_spike(mem, time):
        fault = Fault.SPIKE
    elif _whirls(mem, speed, dt):
        fault = Fault.WHIRL
    elif doubted:
        fault = Fault.DOUBTED
    if fault != Fault.NONE:
        mem[Head.FAULTS + fault] += 1.0
        return fault
    mem[Head.SPIKE_SINCE] = time
    mem[Head.BELIEVED] += 1.0
    if equal == 0.0:
        mem[Head.VARIED] += 1.0
    for i in range(6):
        if mem[Head.SAME + i] == 0.0:
            mem[Head.CHANGED + i] += 1.0
    _remember(mem, dt)
    return fault


@njit(_nrt=False)
def _stays(mem, i, dt):
    """Whether number i of the samples, which always changes, has repeated itself for too long."""
    return (mem[Head.SAME + i] >= FEWEST_STUCK and mem[Head.SAME + i] * dt > FROZEN_TIME
            and mem[Head.CHANGED + i] > ALWAYS * mem[Head.BELIEVED])


@njit(_nrt=False)
def is_stuck(mem, dt):
    """Whether an accelerometer repeats itself: at rest that is no fault to be bridged, but no sign of rest either."""
    return _stays(mem, 0, dt) or _stays(mem, 1, dt) or _stays(mem, 2, dt)


@njit(_nrt=False)
def _is_spike(mem, time):
    if mem[Head.BELIEVED] < 10.0 or time - mem[Head.SPIKE_SINCE] > LONGEST_SPIKE:
        return False
    force = JUMP_FORCE + JUMP_SIGMAS * math.sqrt(mem[Head.SPREAD])
    rate = JUMP_RATE + JUMP_SIGMAS * math.sqrt(mem[Head.SPREAD + 1])
    for i in range(6):
        if abs(mem[Head.RAW + i] - mem[Head.CENTRE + i]) > (force if i < 3 else rate):
            return True
    return False


@njit(_nrt=False)
def _remember(mem, dt):
    """Running mean and variance of what was believed."""
    weight = 1.0 if mem[Head.BELIEVED] == 1.0 else min(1.0, dt / NEIGHBOURHOOD)
    for half in range(2):
        squared = 0.0
        for i in range(3 * half, 3 * half + 3):
            deviation = mem[Head.RAW + i] - mem[Head.CENTRE + i]
            mem[Head.CENTRE + i] += weight * deviation
            squared = max(squared, deviation * deviation)
        mem[Head.SPREAD + half] += min(weight, 0.5) * ((squared if weight < 1.0 else 0.0) - mem[Head.SPREAD + half])
