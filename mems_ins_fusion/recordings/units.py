"""The units of IMU messages: those of sensor_msgs/Imu, and those that drivers deliver all the same.

Gravity tells the unit of the accelerometers, the course of the fixes that of the gyroscopes.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mems_ins_fusion.filter.measurements.inertial import ACCELERATION, RATE
from mems_ins_fusion.recordings.motion import Steering, compare_steering, find_standstill, up_axis
from mems_ins_fusion.samples import Fixes, ImuSamples

_TOLERANCE = 0.2  # part of gravity: more is no bias
FASTEST_TURN = 4.0  # rad/s: of no land vehicle


def in_si(imu: ImuSamples, acceleration_unit: str, rate_unit: str) -> ImuSamples:
    """`imu` in m/s^2 and rad/s."""
    return _times(imu, ACCELERATION[acceleration_unit], RATE[rate_unit])


def as_delivered(imu: ImuSamples, acceleration_unit: str, rate_unit: str) -> ImuSamples:
    """`imu`, in m/s^2 and rad/s, in the units that it was delivered in: the contrary of `in_si`."""
    return _times(imu, 1.0 / ACCELERATION[acceleration_unit], 1.0 / RATE[rate_unit])


def _times(imu: ImuSamples, force: float, rate: float) -> ImuSamples:
    if force == rate == 1.0:
        return imu
    return replace(imu, specific_force=imu.specific_force * force, angular_rate=imu.angular_rate * rate)


@dataclass(frozen=True)
class Units:
    """What tells the units of an IMU.

    acceleration, rate: as `imu.acceleration_unit` and `imu.rate_unit`. gravity: whether it is in the accelerometers;
    without it their unit is only taken to be m/s^2. magnitude: of their mean, in the unit delivered; at_rest: whether
    that is at rest. steering: the course against the gyroscopes, in the unit delivered; None where no turn tells.
    largest: of the rates.
    """

    acceleration: str
    rate: str
    gravity: bool
    magnitude: float
    at_rest: bool
    steering: Steering | None
    largest: float


def find_units(imu: ImuSamples, fixes: Fixes | None, gravity: float) -> Units:
    """The units of `imu` as delivered. gravity: m/s^2, there."""
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
