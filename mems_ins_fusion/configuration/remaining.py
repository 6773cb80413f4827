"""What a recording leaves of the parameters: how far its estimates are from what a params file says, with their sigma.

The checker says it of any file, and whether a file that `configure` wrote is ready stands on the same numbers.
"""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from mems_ins_fusion.configuration.mounting import Mounting, deviation
from mems_ins_fusion.configuration.odometry_axes import OdometryAxes
from mems_ins_fusion.configuration.speed_offset import LowPass
from mems_ins_fusion.filter.prediction import UNKNOWN_YAW_SIGMA
from mems_ins_fusion.navigation.frames import rotation_from_rpy

TIME_OFFSET = 'time offset'
ANGLES = 'roll', 'pitch', 'yaw'
ARM = 'forward', 'left', 'up'
LOW_PASS, YAW, SHARE = 'low pass', 'yaw', 'share of the dynamic pressure'


@dataclass(frozen=True)
class Remaining:
    """What is left of one quantity: `value`, the estimate less what the file says, and its standard deviation, infinite
    where the recording does not show it. name: TIME_OFFSET or LOW_PASS (s), one of ANGLES or YAW (rad, about forward,
    left and up), one of ARM (m), or SHARE."""

    name: str
    value: float
    sigma: float

    def settled(self, most: float, sigmas: float = 2.0) -> bool:
        """Whether no more than `most` can be left."""
        return abs(self.value) + sigmas * self.sigma <= most

    def certain(self, least: float, sigmas: float) -> bool:
        """Whether more than `least` is left, and not by chance."""
        return abs(self.value) > max(least, sigmas * self.sigma)


@dataclass(frozen=True)
class ClockLeft(Remaining):
    """What is left of the time offset of an input. low_pass: that it shows, as if none were declared, None where it
    shows nothing of one. axes: what is left of how an odometry is turned, None where that does not show."""

    low_pass: LowPass | None = None
    axes: OdometryAxes | None = None


def remaining_of(found: Mounting | None, values: Mapping) -> tuple[Remaining, ...]:
    """What the estimates `found` leave of the parameters `values`: the angles, the time offset, the arm."""
    if found is None:
        return tuple(Remaining(name, 0.0, math.inf) for name in (*ANGLES, TIME_OFFSET, *ARM))
    turned = deviation(found.rotation, rotation_from_rpy(*values['imu.mounting_rpy']))
    angles = [Remaining(name, float(angle), float(sigma) if sigma < UNKNOWN_YAW_SIGMA else math.inf)
              for name, angle, sigma in zip(ANGLES, turned, found.sigma)]
    offset = found.offset
    if offset is None or not offset.shown:
        return (*angles, *(Remaining(name, 0.0, math.inf) for name in (TIME_OFFSET, *ARM)))
    arm = [Remaining(name, float(seen - said), float(sigma)) for name, seen, said, sigma in zip(
        ARM, offset.arm, values['gnss.lever_arm'], offset.arm_sigma)]
    return (*angles, Remaining(TIME_OFFSET, offset.lag - values['gnss.time_offset'], offset.lag_sigma), *arm)
