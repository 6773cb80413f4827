"""Standstills before the filter starts: their detection, and messages about them.

The running filter has a detector of its own, which adapts while it runs: trust/standstill.py.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...navigation.earth import gravity
from ...samples import runs
from ..config import FilterConfig
from .start import Standstill

STILL_BLOCK = 1.0  # s, length of the blocks that a standstill consists of
SHORTEST_STILL = 3.0  # s, shortest standstill
#: m/s^2, largest difference of the mean of a block from the median of all blocks of a standstill
STEADY_ACCELERATION = 0.06
STEADY_RATE = 0.005  # rad/s, the same of the angular rate
#: rad/s, largest mean of an axis of the gyroscopes at rest: bias and not a turn, nor deg/s taken for rad/s. Biases of
#: cheap ones stay below; how much samples scatter says nothing of it, and the next start has another bias
LARGEST_BIAS = 0.05
#: the same in standard deviations of the bias, where the parameters state larger ones: more than five sigma is no
#: bias. With the default sigma of 0.01 rad/s both limits are the same
BIAS_SIGMAS = 5.0
#: number of blocks needed to decide whether a turn rate oscillates, as of a boat: fewer may be the first of a drive
FEWEST_BLOCKS = 10
#: m/s, largest drift of the fixes of a vehicle at rest. A vehicle that moves more slowly, and as smoothly as one at
#: rest, counts as at rest: at constant velocity its sensors show the same biases
RECEIVER_DRIFT = 0.3
SMALLEST_DRIFT = 0.1  # m, drift that is always allowed, however short the time
STAYING_SIGMAS = 4.0  # standard deviations by which the medians of the fixes may differ in addition to the drift
FASTEST_DRIFT = 2.0  # m/s: if fixes move faster, the vehicle drives, however much they scatter
#: the vehicle has moved where the displacement of the fixes exceeds their scatter about a straight line by this factor
WANDERING = 4.0
MEDIAN_SIGMA = math.sqrt(math.pi / 2)  # standard deviation of a median over that of a mean, for normal errors
#: share of gravity by which the specific force at rest may differ from gravity: no accelerometer has larger errors
GRAVITY_TOLERANCE = 0.1


class Blocks(NamedTuple):
    """Samples in blocks of STILL_BLOCK; specific force and angular rate in body axes."""

    mean: np.ndarray  # (k, 6)
    scatter: np.ndarray  # (k, 6), standard deviations
    starts: np.ndarray  # (k,), index of the first sample
    length: np.ndarray  # (k,), number of samples


def blocks_of(imu: np.ndarray, earlier: Blocks | None = None) -> Blocks:
    """The blocks of samples (n, 7 or more): time, specific force and angular rate in body axes.

    earlier: those of the first of these samples. All but the last of them are complete and are not computed again.
    """
    complete = 0 if earlier is None else len(earlier.starts) - 1
    first = earlier.starts[complete] if complete else 0
    rest = imu[first:]
    block = np.floor((rest[:, 0] - imu[0, 0]) / STILL_BLOCK).astype(np.int64)
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    length = np.diff(np.append(starts, len(rest)))
    mean = np.add.reduceat(rest[:, 1:7], starts) / length[:, None]
    squares = np.add.reduceat((rest[:, 1:7] - np.repeat(mean, length, axis=0)) ** 2, starts)
    found = Blocks(mean, np.sqrt(squares / length[:, None]), first + starts, length)
    return Blocks(*(np.concatenate([old[:complete], new]) for old, new in zip(earlier, found))) if complete else found


def latest_standstill(imu: np.ndarray, blocks: Blocks, positions: np.ndarray, config: FilterConfig) -> (
        Standstill | None):
    """The latest period of at least SHORTEST_STILL in which the sensors are quiet and the fixes do not move.

    imu (n, 7 or more): time, specific force and angular rate in body axes. positions (k, 4): time, north, east, sigma.
    """
    mean, scatter, starts, length = blocks
    quiet = ((scatter[:, :3].max(axis=1) < config.vehicle.still_acceleration)
             & (scatter[:, 3:].max(axis=1) < config.vehicle.still_rate) & (length > 2))
    ends = np.append(starts[1:], len(imu))
    for first, last in runs(quiet)[::-1]:
        if _swings(mean[first:last, 3:]):
            continue
        steady = _longest_steady(mean[first:last])
        begin, end = starts[first + steady.start], ends[first + steady.stop - 1]
        duration = imu[end - 1, 0] - imu[begin, 0]
        if duration >= SHORTEST_STILL and _stays(positions, imu[begin, 0], imu[end - 1, 0]):
            means = imu[begin:end, 1:7].mean(axis=0)
            turns = np.abs(means[3:]).max() > _largest_bias(config)
            return None if turns else Standstill(imu[end - 1, 0], duration, means[:3], means[3:])
    return None


def is_quiet(imu: np.ndarray, config: FilterConfig) -> bool:
    """Whether the sensors are quiet and steady throughout `imu` (n, 7 or more), so that the velocity is constant."""
    mean, scatter, _, length = blocks_of(imu)
    mean, scatter = mean[length > 2], scatter[length > 2]
    if not len(mean):
        return False
    steady = _longest_steady(mean)
    return (scatter[:, :3].max() < config.vehicle.still_acceleration
            and scatter[:, 3:].max() < config.vehicle.still_rate and steady.stop - steady.start == len(mean))


def tumbling_rate(imu: np.ndarray, blocks: Blocks, positions: np.ndarray, config: FilterConfig) -> float:
    """The larger of roll rate and pitch rate, rad/s, while the accelerometers are quiet and the fixes do not move; 0
    where it is small. No vehicle rolls or pitches for seconds, so a unit or an axis is wrong."""
    mean, scatter, starts, length = blocks
    ends = np.append(starts[1:], len(imu))
    for first, last in runs((scatter[:, :3].max(axis=1) < config.vehicle.still_acceleration) & (length > 2)):
        begin, end = imu[starts[first], 0], imu[ends[last - 1] - 1, 0]
        rate = float(np.abs(mean[first:last, 3:5].mean(axis=0)).max())
        if rate > _largest_bias(config) and end - begin >= SHORTEST_STILL and _stays(positions, begin, end):
            return rate
    return 0.0


def _largest_bias(config: FilterConfig) -> float:
    """Mean of an axis of the gyroscopes at rest, rad/s, above which it is no bias."""
    return max(LARGEST_BIAS, BIAS_SIGMAS * config.alignment.gyroscope_turn_on)


def _swings(rate: np.ndarray) -> bool:
    """Whether the angular rate (k, 3) of blocks oscillates, as on a boat at anchor, rather than being a bias."""
    away = np.abs(rate - np.median(rate, axis=0)).max(axis=1)
    return len(rate) >= FEWEST_BLOCKS and np.mean(away < STEADY_RATE) < 0.5


def _longest_steady(mean: np.ndarray) -> slice:
    """The longest run of blocks whose means (k, 6) are near their median; a gentle acceleration is quiet, not steady.
    """
    away = np.abs(mean - np.median(mean, axis=0))
    found = runs((away[:, :3].max(axis=1) < STEADY_ACCELERATION) & (away[:, 3:].max(axis=1) < STEADY_RATE))
    if not len(found):
        return slice(0, 1)
    first, last = found[np.argmax(found[:, 1] - found[:, 0])]
    return slice(int(first), int(last))


def _stays(positions: np.ndarray, begin: float, end: float) -> bool:
    """Whether the fixes between two times, at least two, show no motion: the medians of their two halves agree.

    Fixes of receivers at rest drift by more than their sigma, so slow motion is ignored. So are motion that is not
    straight, as the sensors would show a turn, and single outliers, which do not change a median.
    """
    inside = positions[(positions[:, 0] >= begin - 0.5) & (positions[:, 0] <= end + 0.5)]
    if len(inside) < 2:
        return False
    half = len(inside) // 2
    moved = np.hypot(*(np.median(inside[half:, 1:3], axis=0) - np.median(inside[:half, 1:3], axis=0)))
    sigma = MEDIAN_SIGMA * inside[:, 3].mean() * math.sqrt(1 / half + 1 / (len(inside) - half))
    interval = max(0.5 * (inside[-1, 0] - inside[0, 0]), 1e-3)
    time, position = inside[:, 0] - inside[:, 0].mean(), inside[:, 1:3] - inside[:, 1:3].mean(axis=0)
    straight = np.outer(time, time @ position / max(time @ time, 1e-9))
    scatter = math.sqrt(((position - straight) ** 2).sum() / max(len(inside) - 2, 1))
    allowed = STAYING_SIGMAS * sigma + max(SMALLEST_DRIFT, RECEIVER_DRIFT * interval)
    if len(inside) >= FEWEST_BLOCKS:
        allowed = max(allowed, WANDERING * scatter)
    return moved < min(FASTEST_DRIFT * interval, allowed)


def note_standstill(standstill: Standstill | None, latitude: float, height: float,
                    config: FilterConfig) -> list[tuple[str, str]]:
    """Messages about the standstill: levels and texts."""
    if standstill is None:
        return [('info', 'no standstill seen: gyroscope bias and tilt of the IMU start unknown')]
    size = float(np.linalg.norm(standstill.specific_force))
    tilt = math.degrees(math.acos(min(1.0, max(-1.0, -standstill.specific_force[2] / size)))) if size else math.nan
    bias = ', '.join(f'{math.degrees(w):.3f}' for w in standstill.angular_rate)
    removed = ' (removed)' if config.alignment.level else ''
    expected = gravity(latitude, height)
    text = (f'standstill of {standstill.duration:.1f} s: gyroscope bias {bias} deg/s (forward, right, down), '
            f'tilt {tilt:.1f} deg{removed}, specific force {size:.3f} m/s^2 '
            f'(gravity here {expected:.3f})')
    notes = [('info', text)]
    if abs(size - expected) > GRAVITY_TOLERANCE * expected:
        notes.append(('error', f'{config.imu.topic}: linear_acceleration is {size:.3f} at rest '
                               f'where gravity is {expected:.3f} m/s^2: a wrong unit or scale'))
    return notes
