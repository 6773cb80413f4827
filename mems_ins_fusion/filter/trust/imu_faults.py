"""Which IMU samples are used, by what the sensor itself has shown before.

A sample that is not used is not lost time: the filter bridges it as if the vehicle neither turned nor changed its
speed, with a covariance that knows what a vehicle may do meanwhile.
"""
from __future__ import annotations

from typing import NamedTuple

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, Nav
from .standstill import MOVING_SPEED


class _Fault(NamedTuple):
    """Why a sample is not used."""

    NONE: int = 0
    RANGE: int = 1  # beyond what imu.max_specific_force or imu.max_angular_rate allow
    SPIKE: int = 2  # far from its neighbours
    SATURATED: int = 3  # an axis stays at a large value to the last digit
    FROZEN: int = 4  # an axis that always changes repeats itself to the last digit while the vehicle moves, or all do
    ZERO: int = 5  # all axes zero: no gravity
    CONTRADICTED: int = 6  # nothing wrong with it, but the fixes have contradicted those before it
    SIZE: int = 7


Fault = _Fault()
#: in words, by number
FAULTS = ('', 'out of range', 'spike', 'saturated', 'frozen', 'all zero',
          'contradicted by the fixes (units? imu.mounting_rpy? gnss.time_offset?)')

#: settings, and what has been seen of the samples as they came, sensor axes
Imu = HEAD.place(
    'Imu',
    MAX_FORCE=1,  # m/s^2
    MAX_RATE=1,  # rad/s
    RAW=6,  # the last six numbers
    SAME=6,  # how often each came again one after the other
    CHANGED=6,  # and how often it was another one than before
    CENTRE=6,  # running mean of what was used
    RATE_SCATTER=1,  # (rad/s)^2, and the running variance of the angular rate
    VARIED=1,  # samples that differ from the one before
    SPIKE_SINCE=1,  # s
    USED=1,  # samples used so far
    FAULTS=Fault.SIZE)  # samples not used, by reason

#: time constant of the running mean that neighbours are told by, s
NEIGHBOURHOOD = 0.2
#: m/s^2: a specific force further from that mean is a spike: a pothole is less
SPIKE_FORCE = 30.0
#: rad/s: the same of a turn rate: no vehicle begins to turn so fast from one sample to the next
SPIKE_RATE = 2.0
#: s: what lasts for longer is no spike
LONGEST_SPIKE = 0.25
#: m/s^2: what a vehicle reaches, but does not keep to the last digit: an axis that does is saturated
LARGE_FORCE = 15.0
#: rad/s: the same of a turn rate
LARGE_RATE = 1.5
#: samples: so many equal values are no chance where the sensor's noise shows in its last digit
FEWEST_EQUAL = 2
#: s: for how long all axes must have been equal to be frozen
FROZEN_TIME = 0.3
#: samples: so many equal values of one axis alone are no chance, if it has changed with ALWAYS of the samples
FEWEST_STUCK = 5.0
#: share of the samples: the digits of axes that change more rarely are coarse
ALWAYS = 0.9
#: s: a filter that has diverged from fixes that were right does not use the IMU for so long. Longer than a fault that
#: passes (a kerb, a driver that restarts); with 60 s errors are as large, and the filter is without an IMU for twice as
#: long
WRONG_TIME = 30.0


@njit(_nrt=False)
def is_wrong(mem, r, time):
    """Whether the fixes till the state at r have shown that the IMU is wrong at `time`, s."""
    diverged = mem[r + Nav.DIVERGENCE_TIME]
    return diverged != 0.0 and time - diverged < WRONG_TIME


@njit(_nrt=False)
def check(mem, samples, k, dt, speed, contradicted, before=Fault.NONE):
    """What is wrong with sample k, a `Fault`; it, and what it shows, is remembered in the head of `mem`.

    samples (n, 7): time (s), specific force and angular rate in sensor axes. dt: s since the one before. speed: that
    the vehicle certainly has, m/s. contradicted: whether fixes contradict the IMU at this time. before: the `Fault` of
    the sample before it.
    """
    time = samples[k, 0]
    equal, most, zero, out, saturated, stuck, repeats = 1e9, 0.0, True, False, False, 0, 0
    lively = mem[Imu.VARIED] > 0.5 * mem[Imu.USED] and mem[Imu.USED] > 10.0
    for i in range(6):
        value = samples[k, 1 + i]
        same = mem[Imu.SAME + i] + 1.0 if value == mem[Imu.RAW + i] else 0.0
        mem[Imu.SAME + i], mem[Imu.RAW + i] = same, value
        equal, most = min(equal, same), max(most, same)
        zero = zero and value == 0.0
        out = out or abs(value) > mem[Imu.MAX_FORCE + (i >= 3)]
    if most >= FEWEST_EQUAL:  # of most sensors no axis repeats itself so often
        for i in range(6):
            large = abs(mem[Imu.RAW + i]) > (LARGE_FORCE if i < 3 else LARGE_RATE)
            saturated = saturated or (large and mem[Imu.SAME + i] >= FEWEST_EQUAL)
            stuck += 1 if _stays(mem, i, dt) else 0
            repeats += 1 if mem[Imu.SAME + i] >= FEWEST_STUCK else 0
    # at rest an axis may repeat itself; one that was frozen before it, beside axes that all show noise, is so still
    tells = speed > MOVING_SPEED or before == Fault.FROZEN and repeats == stuck
    fault = Fault.NONE
    if out:
        fault = Fault.RANGE
    elif lively and zero:
        fault = Fault.ZERO
    elif lively and saturated:
        fault = Fault.SATURATED
    elif lively and (tells and (equal >= FEWEST_EQUAL and equal * dt > FROZEN_TIME or stuck > 0) or stuck == 6):
        fault = Fault.FROZEN
    elif _is_spike(mem, time):
        fault = Fault.SPIKE
    elif contradicted:
        fault = Fault.CONTRADICTED
    if fault != Fault.NONE:
        mem[Imu.FAULTS + fault] += 1.0
        return fault
    mem[Imu.SPIKE_SINCE] = time
    mem[Imu.USED] += 1.0
    if equal == 0.0:
        mem[Imu.VARIED] += 1.0
    for i in range(6):
        if mem[Imu.SAME + i] == 0.0:
            mem[Imu.CHANGED + i] += 1.0
    _remember(mem, dt)
    return fault


@njit(_nrt=False)
def _stays(mem, i, dt):
    """Whether number i of the samples, which always changes, has repeated itself for too long."""
    return (mem[Imu.SAME + i] >= FEWEST_STUCK and mem[Imu.SAME + i] * dt > FROZEN_TIME
            and mem[Imu.CHANGED + i] > ALWAYS * mem[Imu.USED])


@njit(_nrt=False)
def is_stuck(mem, dt):
    """Whether an accelerometer repeats itself: at rest that is no fault to be bridged, but no sign of rest either."""
    return _stays(mem, 0, dt) or _stays(mem, 1, dt) or _stays(mem, 2, dt)


@njit(_nrt=False)
def _is_spike(mem, time):
    if mem[Imu.USED] < 10.0 or time - mem[Imu.SPIKE_SINCE] > LONGEST_SPIKE:
        return False
    for i in range(6):
        if abs(mem[Imu.RAW + i] - mem[Imu.CENTRE + i]) > (SPIKE_FORCE if i < 3 else SPIKE_RATE):
            return True
    return False


@njit(_nrt=False)
def _remember(mem, dt):
    """Running mean of the samples used, and variance of their angular rates, on the axis that is furthest off."""
    weight, squared = 1.0 if mem[Imu.USED] == 1.0 else min(1.0, dt / NEIGHBOURHOOD), 0.0
    for i in range(6):
        deviation = mem[Imu.RAW + i] - mem[Imu.CENTRE + i]
        mem[Imu.CENTRE + i] += weight * deviation
        if i >= 3 and weight < 1.0:
            squared = max(squared, deviation * deviation)
    mem[Imu.RATE_SCATTER] += min(weight, 0.5) * (squared - mem[Imu.RATE_SCATTER])
