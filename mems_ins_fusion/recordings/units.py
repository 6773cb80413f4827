"""The units of IMU messages: those of sensor_msgs/Imu, and those that drivers deliver all the same."""
from __future__ import annotations

import math
from dataclasses import replace

from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.samples import ImuSamples

#: SI units per unit, by the choices of `imu.acceleration_unit` and `imu.rate_unit`
ACCELERATION = {'m/s^2': 1.0, 'g': STANDARD_GRAVITY}
RATE = {'rad/s': 1.0, 'deg/s': math.pi / 180.0}


def in_si(imu: ImuSamples, acceleration_unit: str, rate_unit: str) -> ImuSamples:
    """`imu` in m/s^2 and rad/s."""
    force, rate = ACCELERATION[acceleration_unit], RATE[rate_unit]
    if force == rate == 1.0:
        return imu
    return replace(imu, specific_force=imu.specific_force * force, angular_rate=imu.angular_rate * rate)
