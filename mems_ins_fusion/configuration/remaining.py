"""Differences between the estimates from a recording and a params file, with their standard deviations.

The checker reports them for any file; `configure` uses them to decide whether its file is ready.
"""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.mounting import Mounting, rpy
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
    """The difference of one quantity: `value`, the estimate minus the value in the file, and its standard deviation,
    infinite if the recording does not determine it. name: TIME_OFFSET or LOW_PASS (s), one of ANGLES or YAW (rad, as of
    the effect `mounting_rotation`), one of ARM (m), or SHARE."""

    name: str
    value: float
    sigma: float

    def settled(self, most: float, sigmas: float = 2.0) -> bool:
        """Whether the difference is certainly at most `most`."""
        return abs(self.value) + sigmas * self.sigma <= most

    def certain(self, least: float, sigmas: float) -> bool:
        """Whether it is significantly larger than `least`."""
        return abs(self.value) > max(least, sigmas * self.sigma)


@dataclass(frozen=True)
class ClockLeft(Remaining):
    """The difference of the time offset of an input. low_pass: that of its low pass, as if none were declared; None
    without evidence of one. axes: that of the rotation of an odometry; None if it is not determined."""

    low_pass: LowPass | None = None
    axes: OdometryAxes | None = None


def remaining_of(found: Mounting | None, values: Mapping) -> tuple[Remaining, ...]:
    """Differences of the estimates `found` from the parameters `values`: angles, time offset, lever arm."""
    if found is None:
        return tuple(Remaining(name, 0.0, math.inf) for name in (*ANGLES, TIME_OFFSET, *ARM))
    angles = [Remaining(name, angle, sigma) for name, angle, sigma in zip(ANGLES, *_turned(
        found.rotation @ rotation_from_rpy(*values['imu.mounting_rpy']).T, found.sigma))]
    offset = found.offset
    if offset is None or not offset.shown:
        return (*angles, *(Remaining(name, 0.0, math.inf) for name in (TIME_OFFSET, *ARM)))
    arm = [Remaining(name, float(seen - said), float(sigma)) for name, seen, said, sigma in zip(
        ARM, offset.arm, values['gnss.lever_arm'], offset.arm_sigma)]
    return (*angles, Remaining(TIME_OFFSET, offset.lag - values['gnss.time_offset'], offset.lag_sigma), *arm)


def _turned(rotation: np.ndarray, sigma: np.ndarray) -> tuple[list[float], list[float]]:
    """Roll, pitch and yaw, rad, of `rotation` (3, 3), and their standard deviations, infinite if not determined.

    sigma: (3,) rad, of small independent rotations about forward, left and up, after `rotation`. Roll and pitch are
    before the yaw: of an IMU that is turned by a right angle, the axis of the roll is to the left in the end.
    """
    angles = rpy(rotation)
    _, pitch, yaw = angles
    forward, left, up = np.minimum(sigma, UNKNOWN_YAW_SIGMA).tolist()
    along, across = (math.hypot(a * math.cos(yaw), b * math.sin(yaw)) for a, b in ((forward, left), (left, forward)))
    found = along / max(math.cos(pitch), 1e-9), across, math.hypot(up, math.tan(pitch) * along)
    return angles.tolist(), [one if one < UNKNOWN_YAW_SIGMA else math.inf for one in found]
