"""What kind of vehicle drives: whether it goes where it points, and whether its standstills can be told from motion."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.mounting import Mounting
from mems_ins_fusion.recordings.motion import robust_sigma
from mems_ins_fusion.samples import ImuSamples

_SIDEWAYS = 0.5  # m/s: robust standard deviation of a vehicle with wheels, arm of the antenna included
_ARM_KNOWN = 1.0  # m: an arm with a larger sigma is none
_BLOCK = 1.0  # s, as the filter judges rest


@dataclass(frozen=True)
class Vehicle:
    """sideways: m/s, robust standard deviation of the velocity across the nose, noise of the fixes included, or None.
    noise: m/s, of it by the receiver alone. wheels: whether that is how a vehicle with wheels moves, None unknown.
    rest_force, rest_rate: what axes scatter by at rest (95 % of the seconds stay below), m/s^2 and rad/s, or None.
    drive_force, drive_rate: what they scatter by in motion (95 % of the seconds stay above). alike: share of the
    seconds in motion that stay below rest_force and rest_rate, both."""

    sideways: float | None
    noise: float
    wheels: bool | None
    rest_force: float | None = None
    rest_rate: float | None = None
    drive_force: float | None = None
    drive_rate: float | None = None
    alike: float | None = None


def assess_vehicle(imu: ImuSamples, still: np.ndarray, found: Mounting | None, fix_sigma: float) -> Vehicle:
    """The vehicle of `imu` (SI units). still: (n,) samples at rest. fix_sigma: m."""
    sideways, noise, wheels = None, 0.0, None
    if found is not None and found.spans is not None:
        drive = found.spans
        moving = np.abs(drive.speed) > max(1.0, 0.3 * np.percentile(np.abs(drive.speed), 90))
        if moving.sum() > 20 and found.turned > 1.0:
            sideways = robust_sigma(drive.sideways[moving] - _ahead(found) * drive.turn[moving])
            noise = float(fix_sigma / np.sqrt(2.0) / drive.length)
            wheels = bool(np.sqrt(max(sideways**2 - noise**2, 0.0)) < _SIDEWAYS)
    return Vehicle(sideways, noise, wheels, *_scatter(imu, still))


def _ahead(found: Mounting) -> float:
    """How far the antenna is ahead of the rear axle, m, as far as that is known."""
    arm = found.offset.arm[0] if found.offset is not None and found.offset.arm_sigma[0] < _ARM_KNOWN else 0.0
    return float(found.imu[0] + arm)


def _scatter(imu, still):
    interval = np.median(np.diff(imu.stamp)) * 1e-9
    size = max(round(_BLOCK / interval), 4)
    count = len(imu) // size
    if not count:
        return [None] * 5
    both = np.hstack([imu.specific_force, imu.angular_rate])[:count * size].reshape(count, size, 6).std(axis=1)
    part = still[:count * size].reshape(count, size).mean(axis=1)
    rest, drive = both[part == 1.0], both[part == 0.0]
    if len(rest) < 3 or len(drive) < 10:
        return [None] * 5
    sensors = slice(0, 3), slice(3, 6)
    most = [np.percentile(rest[:, axes].max(axis=1), 95) for axes in sensors]
    alike = np.all([drive[:, axes].max(axis=1) < limit for axes, limit in zip(sensors, most)], axis=0)
    return [*map(float, most), *(float(np.percentile(drive[:, axes].max(axis=1), 5)) for axes in sensors),
            float(alike.mean())]
