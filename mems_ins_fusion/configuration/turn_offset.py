"""The time offset between the turn rate of an odometry and the gyroscopes: no fix, no filter.

turn(t) = k w(t - T) + b, w about the up axis. With scale k and bias b free, the offset T that fits best is where the
correlation is largest: on a grid, then by a parabola. A curve or two are enough, at any speed.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.kinematics import InertialIntegrals
from mems_ins_fusion.configuration.offset import FLOOR, LARGEST
from mems_ins_fusion.configuration.regression import BLOCKS, jackknife, shares
from mems_ins_fusion.recordings.motion import integral
from mems_ins_fusion.samples import Headings, ImuSamples, Twists, in_time_order

#: s, step of the grid of offsets
_STEP = 0.02
#: s over which both turn rates are averaged: longer than vibration, shorter than turns of a vehicle
_SMOOTHED = 0.2
#: smallest number of samples for an estimate
_FEWEST = 200
#: rad/s, smallest standard deviation of the turn rate for an estimate
_LEAST = 0.02


@dataclass(frozen=True)
class TurnOffset:
    """lag, lag_sigma: s, by which the stamps are late. correlation: with the gyroscopes, negative if its sign is wrong.
    """

    lag: float
    lag_sigma: float
    correlation: float


def estimate_turn_offset(imu: ImuSamples, twists: Twists, rotation: np.ndarray) -> TurnOffset | None:
    """Estimate from `imu` (SI units) and the turn rate of `twists`; None with too few of either.

    rotation: (3, 3) from sensor axes to base_link.
    """
    good = in_time_order(twists.stamp, np.isfinite(twists.twist[:, 2]))
    if len(good) < _FEWEST or len(imu) < _FEWEST:
        return None
    origin = int(imu.stamp[0])
    inertial = InertialIntegrals(imu, origin)
    time, turn = (twists.stamp[good] - origin) * 1e-9, -twists.twist[good, 2]
    angle = inertial.angle @ rotation[2]
    inside = inertial.covers(time - LARGEST - _SMOOTHED, time + LARGEST + _SMOOTHED)
    time, turn = time[inside], _mean(time, integral(time, turn), time[inside])
    if len(time) < _FEWEST or turn.std() < _LEAST:
        return None
    lags = np.arange(-LARGEST, LARGEST + 0.5 * _STEP, _STEP)
    blocks = shares(len(time))
    # (lags, blocks, 6) sums of 1, w, turn, w w, w turn, turn turn
    sums = np.array([_sums(_mean(inertial.time, angle, time - lag), turn, blocks) for lag in lags])
    whole = sums.sum(axis=1)
    lag, best = _best(lags, whole)
    left_out = np.array([_best(lags, whole - sums[:, block])[0] for block in range(BLOCKS)])
    return TurnOffset(lag, math.hypot(float(jackknife(left_out)), FLOOR), best)


def turning_of(headings: Headings) -> Twists:
    """The turn rate that `headings` show, each between two of them."""
    good = in_time_order(headings.stamp, np.isfinite(headings.yaw))
    step = np.diff(headings.stamp[good])
    turn = np.diff(np.unwrap(headings.yaw[good])) / (step * 1e-9)
    middle, nothing = headings.stamp[good][:-1] + step // 2, np.full(len(turn), np.nan)
    return Twists(middle, middle, np.column_stack([nothing, nothing, turn]), np.full((len(turn), 3), np.nan))


def _mean(time, integrated, at):
    """Mean rate about the times `at`, from its integral."""
    half = 0.5 * _SMOOTHED
    return (np.interp(at + half, time, integrated) - np.interp(at - half, time, integrated)) / _SMOOTHED


def _sums(rate, turn, blocks):
    products = np.column_stack([np.ones(len(turn)), rate, turn, rate * rate, rate * turn, turn * turn])
    return np.array([np.bincount(blocks, column, BLOCKS) for column in products.T]).T


def _best(lags, sums) -> tuple[float, float]:
    """The offset with the largest correlation, and that correlation."""
    n, rate, turn, rates, both, turns = sums.T
    with np.errstate(invalid='ignore', divide='ignore'):
        size = np.nan_to_num((both - rate * turn / n) / np.sqrt((rates - rate**2 / n) * (turns - turn**2 / n)))
    at = int(np.argmax(np.abs(size)))
    lag = float(lags[at])
    if 0 < at < len(lags) - 1:
        before, here, after = np.abs(size[at - 1:at + 2])
        bend = before - 2.0 * here + after
        lag += _STEP * 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return lag, float(size[at])
