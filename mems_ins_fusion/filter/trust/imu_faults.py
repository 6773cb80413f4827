"""Check IMU samples: select those that are used, by comparison with earlier samples of the same sensor.

The filter bridges samples that are not used: it assumes constant velocity and heading, with a covariance that contains
the possible motion of a vehicle in this time.
"""
from __future__ import annotations

from typing import NamedTuple

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, Nav
from .standstill import MOVING_SPEED


class _Fault(NamedTuple):
    """Reasons for which a sample is not used."""

    NONE: int = 0
    RANGE: int = 1  # above imu.max_specific_force or imu.max_angular_rate
    SPIKE: int = 2  # far from the running mean of the samples before it
    SATURATED: int = 3  # a large value of an axis repeats itself to the last digit
    FROZEN: int = 4  # an axis that normally changes repeats itself while the vehicle moves, or all axes do
    ZERO: int = 5  # all axes zero: no gravity
    CONTRADICTED: int = 6  # no fault of its own, but fixes have contradicted the samples before it
    SIZE: int = 7


Fault = _Fault()
#: the reasons in words, by number
FAULTS = ('', 'out of range', 'spike', 'saturated', 'frozen', 'all zero',
          'contradicted by the fixes (units? imu.mounting_rpy? gnss.time_offset?)')

#: settings, and statistics of the samples in sensor axes
Imu = HEAD.place(
    'Imu',
    MAX_FORCE=1,  # m/s^2
    MAX_RATE=1,  # rad/s
    RAW=6,  # components of the latest sample
    SAME=6,  # number of repetitions of each value in a row
    CHANGED=6,  # number of used samples in which the value changed
    CENTRE=6,  # running mean of the used samples
    RATE_SCATTER=1,  # (rad/s)^2, running variance of the angular rate
    VARIED=1,  # number of used samples in which at least one value changed
    SPIKE_SINCE=1,  # s, time of the last used sample
    USED=1,  # number of used samples
    FAULTS=Fault.SIZE)  # number of samples not used, by reason

#: s, time constant of the running mean with which a sample is compared to detect spikes
NEIGHBOURHOOD = 0.2
#: m/s^2, deviation of the specific force from this mean above which it is a spike: larger than that of a pothole
SPIKE_FORCE = 30.0
#: rad/s, the same for the angular rate: no vehicle changes its turn rate by this from one sample to the next
SPIKE_RATE = 2.0
#: s, longest duration of a spike: a deviation that lasts longer is motion
LONGEST_SPIKE = 0.25
#: m/s^2, specific force above which a repeated value is saturation: a vehicle reaches it, but does not keep it constant
#: to the last digit
LARGE_FORCE = 15.0
#: rad/s, the same for the angular rate
LARGE_RATE = 1.5
#: smallest number of repetitions in a row that is not chance, if the last digit of the sensor shows noise
FEWEST_EQUAL = 2
#: s, time for which values must be equal to count as frozen
FROZEN_TIME = 0.3
#: smallest number of repetitions in a row of a single axis that is not chance, if the axis normally changes (ALWAYS)
FEWEST_STUCK = 5.0
#: share of the samples with which an axis must have changed to be checked alone: an axis that changes less often has a
#: coarse resolution
ALWAYS = 0.9
#: s for which the IMU is not used after the filter has diverged from right fixes. Longer than a temporary fault (a
#: kerb, a driver that restarts). With 60 s the errors are as large, and the filter is without an IMU for twice as long
WRONG_TIME = 30.0


@njit(_nrt=False)
def is_wrong(mem, r, time):
    """Whether fixes up to the state at r have shown that the IMU is wrong at `time`, s."""
    diverged = mem[r + Nav.DIVERGENCE_TIME]
    return diverged != 0.0 and time - diverged < WRONG_TIME


@njit(_nrt=False, forceinline=True)
def check(mem, samples, k, dt, speed, contradicted, before=Fault.NONE):
    """Return the `Fault` of sample k, and update the statistics of the samples in the head of `mem`.

    samples (n, 7): time (s), specific force and angular rate in sensor axes. dt: s since the previous sample. speed:
    lower limit of the speed of the vehicle, m/s. contradicted: whether fixes contradict the IMU at this time. before:
    the `Fault` of the previous sample.
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
    if most >= FEWEST_EQUAL:  # with most sensors no axis repeats itself this often
        for i in range(6):
            large = abs(mem[Imu.RAW + i]) > (LARGE_FORCE if i < 3 else LARGE_RATE)
            saturated = saturated or (large and mem[Imu.SAME + i] >= FEWEST_EQUAL)
            stuck += 1 if _stays(mem, i, dt) else 0
            repeats += 1 if mem[Imu.SAME + i] >= FEWEST_STUCK else 0
    # at rest, repeated values are no fault, except of an axis that was frozen before while the others still show noise
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
    """Whether component i of the samples normally changes with each sample, but has now repeated itself for too
    long."""
    return (mem[Imu.SAME + i] >= FEWEST_STUCK and mem[Imu.SAME + i] * dt > FROZEN_TIME
            and mem[Imu.CHANGED + i] > ALWAYS * mem[Imu.USED])


@njit(_nrt=False)
def is_stuck(mem, dt):
    """Whether an accelerometer repeats the same value. At rest this is no fault to be bridged, but the equal values
    must not be taken as a sign of rest either."""
    return _stays(mem, 0, dt) or _stays(mem, 1, dt) or _stays(mem, 2, dt)


@njit(_nrt=False)
def _is_spike(mem, time):
    """Whether the latest sample is far from the running mean, and has been so for LONGEST_SPIKE at most."""
    if mem[Imu.USED] < 10.0 or time - mem[Imu.SPIKE_SINCE] > LONGEST_SPIKE:
        return False
    for i in range(6):
        if abs(mem[Imu.RAW + i] - mem[Imu.CENTRE + i]) > (SPIKE_FORCE if i < 3 else SPIKE_RATE):
            return True
    return False


@njit(_nrt=False, forceinline=True)
def _remember(mem, dt):
    """Update the running mean of the used samples, and the variance of the angular rate on the axis with the largest
    deviation."""
    weight, squared = 1.0 if mem[Imu.USED] == 1.0 else min(1.0, dt / NEIGHBOURHOOD), 0.0
    for i in range(6):
        deviation = mem[Imu.RAW + i] - mem[Imu.CENTRE + i]
        mem[Imu.CENTRE + i] += weight * deviation
        if i >= 3 and weight < 1.0:
            squared = max(squared, deviation * deviation)
    mem[Imu.RATE_SCATTER] += min(weight, 0.5) * (squared - mem[Imu.RATE_SCATTER])
