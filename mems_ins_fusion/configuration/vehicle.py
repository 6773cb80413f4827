"""What kind of vehicle drives: whether it goes where it points, and whether its standstills can be told from motion."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.mounting import Mounting
from mems_ins_fusion.parameters.table import defaults
from mems_ins_fusion.recordings.motion import find_standstill, positions, robust_sigma
from mems_ins_fusion.samples import Fixes, ImuSamples

#: smallest share of the seconds in motion that are slow and as quiet as at rest, with which standstills cannot be told
#: from motion: for cars and phones it is 0 to 7 %, for simulated rovers on smooth ground 52 to 80 %
LARGEST_ALIKE = 0.2
#: m/s: at a higher speed the filter refuses a standstill by its own velocity
_SLOW = 2.0
#: s between the two positions that give the speed: to 0.5 m/s for fixes of 1.5 m
_SPEED_OVER = 4.0
#: m/s, largest robust standard deviation of the sideways velocity of a vehicle with wheels, lever arm of the antenna
#: included
_SIDEWAYS = 0.5
#: m: a lever arm with a larger standard deviation is not known
_ARM_KNOWN = 1.0
#: s, length of the blocks whose scatter is compared, as in the filter's check for a standstill
_BLOCK = 1.0
#: smallest number of blocks at rest for a scatter. Chosen, not measured
_FEWEST_AT_REST = 3
#: the same in motion. Chosen, not measured
_FEWEST_IN_MOTION = 10


@dataclass(frozen=True)
class Vehicle:
    """Motion and vibration of a vehicle.

    sideways: m/s, robust standard deviation of the sideways velocity with the noise of the fixes, or None. noise: m/s,
    the part of it by the fixes. wheels: whether a vehicle with wheels moves like this, None: unknown. rest_force,
    rest_rate: m/s^2 and rad/s, 95th percentile of the scatter of an axis in a second at rest, or None. drive_force,
    drive_rate: 5th percentile of the same in motion. alike: share of the seconds in motion that are slow and below both
    rest_force and rest_rate; without a standstill, below the defaults of vehicle.still_acceleration and
    vehicle.still_rate."""

    sideways: float | None
    noise: float
    wheels: bool | None
    rest_force: float | None = None
    rest_rate: float | None = None
    drive_force: float | None = None
    drive_rate: float | None = None
    alike: float | None = None


def assess_vehicle(imu: ImuSamples, still: np.ndarray, found: Mounting | None, fix_sigma: float,
                   fixes: Fixes | None = None) -> Vehicle:
    """The vehicle of `imu` (SI units). still: (n,) samples at rest. fix_sigma: m. fixes: usable ones; without them all
    motion counts as slow."""
    sideways, noise, wheels = None, 0.0, None
    if found is not None and found.spans is not None:
        drive = found.spans
        moving = np.abs(drive.speed) > max(1.0, 0.3 * np.percentile(np.abs(drive.speed), 90))
        if moving.sum() > 20 and found.turned > 1.0:
            sideways = robust_sigma(drive.sideways[moving] - _ahead(found) * drive.turn[moving])
            noise = float(fix_sigma / np.sqrt(2.0) / drive.length)
            wheels = bool(np.sqrt(max(sideways**2 - noise**2, 0.0)) < _SIDEWAYS)
    return Vehicle(sideways, noise, wheels, *_scatter(imu, still, fixes))


def standstills_show(imu: ImuSamples, fixes: Fixes | None) -> tuple[bool, float] | None:
    """Whether standstills can be told from motion by the scatter of `imu` (SI units), and the share of the seconds in
    motion that are slow and as quiet as rest; None where there is no standstill beside motion.

    fixes: usable ones; None where there are none."""
    if len(imu) < 2 or not np.median(np.diff(imu.stamp)) > 0:
        return None
    rest, *_, alike = _scatter(imu, find_standstill(imu, fixes), fixes)
    return None if rest is None else (alike < LARGEST_ALIKE, alike)


def _ahead(found: Mounting) -> float:
    """How far the antenna is ahead of the rear axle, m, as far as that is known."""
    arm = found.offset.arm[0] if found.offset is not None and found.offset.arm_sigma[0] < _ARM_KNOWN else 0.0
    return float(found.imu[0] + arm)


def _slow(time: np.ndarray, fixes: Fixes | None) -> np.ndarray:
    """Whether the vehicle is slow at `time` (k,), ns, by the fixes around it; where there are none, it is."""
    if fixes is None or len(fixes) < 2:
        return np.ones(len(time), dtype=bool)
    half, since = 0.5 * _SPEED_OVER, (fixes.stamp - fixes.stamp[0]) * 1e-9
    at, place = (time - fixes.stamp[0]) * 1e-9, positions(fixes)
    way = [np.interp(at + half, since, axis) - np.interp(at - half, since, axis) for axis in place.T]
    return np.hypot(*way) < _SLOW * _SPEED_OVER


def _scatter(imu, still, fixes):
    """rest_force, rest_rate, drive_force, drive_rate and alike of `Vehicle`."""
    interval = np.median(np.diff(imu.stamp)) * 1e-9
    size = max(round(_BLOCK / interval), 4)
    count = len(imu) // size
    if not count:
        return [None] * 5
    both = np.hstack([imu.specific_force, imu.angular_rate])[:count * size].reshape(count, size, 6).std(axis=1)
    part = still[:count * size].reshape(count, size).mean(axis=1)
    rest, drive = both[part == 1.0], both[part == 0.0]
    if len(drive) < _FEWEST_IN_MOTION:
        return [None] * 5
    sensors, there = (slice(0, 3), slice(3, 6)), len(rest) >= _FEWEST_AT_REST
    most = ([float(np.percentile(rest[:, axes].max(axis=1), 95)) for axes in sensors] if there else
            [defaults()[name] for name in ('vehicle.still_acceleration', 'vehicle.still_rate')])
    alike = np.all([drive[:, axes].max(axis=1) < limit for axes, limit in zip(sensors, most)], axis=0)
    alike &= _slow(imu.stamp[size // 2:count * size:size][part == 0.0], fixes)
    least = [float(np.percentile(drive[:, axes].max(axis=1), 5)) for axes in sensors]
    return [*(most if there else (None, None)), *least, float(alike.mean())]
