"""The units of IMU messages: those of sensor_msgs/Imu, and others that drivers deliver in spite of it.

The unit of the accelerometers is found by gravity, that of the gyroscopes by the course of the fixes.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mems_ins_fusion.filter.measurements.inertial import ACCELERATION, RATE
from mems_ins_fusion.recordings.motion import Steering, compare_steering, find_standstill, up_axis
from mems_ins_fusion.samples import Fixes, ImuSamples

_TOLERANCE = 0.2  # share of gravity by which the specific force may differ by a bias; more is a wrong unit
FASTEST_TURN = 4.0  # rad/s: no land vehicle turns faster


def in_si(imu: ImuSamples, acceleration_unit: str, rate_unit: str) -> ImuSamples:
    """`imu` in m/s^2 and rad/s."""
    return _times(imu, ACCELERATION[acceleration_unit], RATE[rate_unit])


def as_delivered(imu: ImuSamples, acceleration_unit: str, rate_unit: str) -> ImuSamples:
    """`imu`, in m/s^2 and rad/s, converted to the units in which it was delivered: inverse of `in_si`."""
    return _times(imu, 1.0 / ACCELERATION[acceleration_unit], 1.0 / RATE[rate_unit])


def _times(imu: ImuSamples, force: float, rate: float) -> ImuSamples:
    if force == rate == 1.0:
        return imu
    return replace(imu, specific_force=imu.specific_force * force, angular_rate=imu.angular_rate * rate)


@dataclass(frozen=True)
class Units:
    """The units of an IMU, and the evidence.

    acceleration, rate: as `imu.acceleration_unit` and `imu.rate_unit`. gravity: whether the specific force contains
    gravity; if not, the unit is assumed to be m/s^2. magnitude: of the mean specific force, in the unit delivered;
    at_rest: whether it is that at rest. steering: comparison of the gyroscopes, in the unit delivered, with the course;
    None without a turn. largest: largest angular rate, in the unit delivered.
    """

    acceleration: str
    rate: str
    gravity: bool
    magnitude: float
    at_rest: bool
    steering: Steering | None
    largest: float


def find_units(imu: ImuSamples, fixes: Fixes | None, gravity: float) -> Units:
    """The units of `imu` as delivered. gravity: m/s^2, at the place of the recording."""
    still = find_standstill(imu, fixes)
    up, magnitude = up_axis(imu, still)
    acceleration = next((unit for unit, scale in ACCELERATION.items()
                         if abs(magnitude * scale / gravity - 1.0) < _TOLERANCE), None)
    steering = compare_steering(imu, fixes, up) if fixes is not None and len(fixes) > 1 else None
    largest = float(np.nanpercentile(np.abs(imu.angular_rate), 99.9))
    if steering is None or not steering.tells:
        rate, steering = ('deg/s' if largest > FASTEST_TURN else 'rad/s'), None
    else:
        rate = min(RATE, key=lambda unit: abs(math.log(steering.turned[0] * RATE[unit])))
    return Units(acceleration or 'm/s^2', rate, acceleration is not None, magnitude, bool(still.any()), steering,
                 largest)
