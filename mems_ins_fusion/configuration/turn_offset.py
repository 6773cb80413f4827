"""The time offset between the turn rate of an odometry and the gyroscopes: no fix, no filter.

turn(t) = k w(t - T) + b, w about the up axis. With scale k and bias b free, the offset T that fits best is where the
correlation is largest: on a grid, then by a parabola. A curve or two are enough, at any speed. A low pass that the turn
rate comes through is a part of the offset; its time constant is that with which w, through the same low pass, is
correlated most. Without it the largest correlation is at less than the offset in all.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.kinematics import InertialIntegrals
from mems_ins_fusion.configuration.offset import FLOOR, LARGEST
from mems_ins_fusion.configuration.regression import BLOCKS, jackknife, shares
from mems_ins_fusion.configuration.speed_offset import LowPass
from mems_ins_fusion.configuration.track import through_low_pass
from mems_ins_fusion.recordings.motion import integral
from mems_ins_fusion.samples import Headings, ImuSamples, Twists, in_time_order, possible

#: s, step of the grid of offsets
_STEP = 0.02
#: s over which both turn rates are averaged: longer than vibration, shorter than turns of a vehicle
_SMOOTHED = 0.2
#: smallest number of samples for an estimate
_FEWEST = 200
#: rad/s, smallest standard deviation of the turn rate for an estimate
_LEAST = 0.02
#: s, time constants of low passes that are tried: the correlation is flat between two of them
_LOW_PASSES = np.arange(0.0, 1.55, 0.1)
#: s about the offset without a low pass, less the time constant, in which the offset with one is searched
_ABOUT = 0.4
#: s, largest interval between two samples of which a low pass is estimated: their mean over longer ones would look
#: like a low pass of a third of it
_DENSE = 0.25


@dataclass(frozen=True)
class TurnOffset:
    """lag, lag_sigma: s, by which the stamps are late, with the part that `low_pass` makes. correlation: with the
    gyroscopes, negative if its sign is wrong. low_pass: None where none is searched, or the samples are too rare.
    """

    lag: float
    lag_sigma: float
    correlation: float
    low_pass: LowPass | None = None


def estimate_turn_offset(imu: ImuSamples, twists: Twists, up: np.ndarray, enough: float = 1.0) -> TurnOffset | None:
    """Estimate from `imu` (SI units) and the turn rate of `twists`; None with too few of either.

    up: (3,) the up axis of base_link, in sensor axes. enough: no low pass is searched where the correlation without one
    is larger (absolute value): the search takes twice the time of all else.
    """
    good = in_time_order(twists.stamp, possible(twists.twist[:, 2]))
    if len(good) < _FEWEST or len(imu) < _FEWEST:
        return None
    origin = int(imu.stamp[0])
    inertial = InertialIntegrals(imu, origin)
    time, turn = (twists.stamp[good] - origin) * 1e-9, -twists.twist[good, 2]
    angle = inertial.angle @ up
    inside = inertial.covers(time - LARGEST - _SMOOTHED, time + LARGEST + _SMOOTHED)
    time, turn = time[inside], _mean(time, integral(time, turn), time[inside])
    if len(time) < _FEWEST or turn.std() < _LEAST:
        return None
    first = np.searchsorted(shares(len(time)), np.arange(BLOCKS))

    def searched(lags, tau):
        """Offsets and correlations (1 + BLOCKS,) of the whole, and with each block left out."""
        smoothed = through_low_pass(inertial.time, angle, tau)
        # (lags, blocks, 6) sums of 1, w, turn, w w, w turn, turn turn
        sums = np.array([_sums(_mean(inertial.time, smoothed, time - lag), turn, first) for lag in lags])
        whole = sums.sum(axis=1)
        return np.array([_best(lags, whole), *(_best(lags, whole - sums[:, block]) for block in range(BLOCKS))]).T

    grid = np.arange(-LARGEST, LARGEST + 0.5 * _STEP, _STEP)
    lag, correlation = searched(grid, 0.0)
    if np.median(np.diff(time)) > _DENSE or abs(correlation[0]) > enough:
        return TurnOffset(float(lag[0]), math.hypot(float(jackknife(lag[1:])), FLOOR), float(correlation[0]))
    found = [(lag, correlation), *(searched(grid[np.abs(grid + tau - lag[0]) <= _ABOUT], tau)
                                   for tau in _LOW_PASSES[1:] if lag[0] - tau > -LARGEST)]
    tau, late, best = _with_low_pass(*np.swapaxes(found, 0, 1))
    tau_sigma, late_sigma = (math.hypot(float(jackknife(one[1:])), FLOOR) for one in (tau, late))
    return TurnOffset(float(late[0]), late_sigma, float(best[0]), LowPass(float(tau[0]), tau_sigma))


def _with_low_pass(lags: np.ndarray, correlations: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time constant of the low pass with the largest correlation, the offset in all with it, s, and that correlation.

    lags, correlations: (t, w), with each of the first t of _LOW_PASSES.
    """
    found = []
    for lag, size in zip(lags.T, correlations.T):
        at = int(np.argmax(np.abs(size)))
        part = _top(np.abs(size[at - 1:at + 2])) if 0 < at < len(size) - 1 else 0.0
        tau = _LOW_PASSES[at] + part * _LOW_PASSES[1]
        found.append((tau, tau + np.interp(tau, _LOW_PASSES[:len(lag)], lag), size[at]))
    return tuple(np.array(found).T)


def turning_of(headings: Headings) -> Twists:
    """The turn rate that `headings` show, each between two of them."""
    good = in_time_order(headings.stamp, possible(headings.yaw))
    step = np.diff(headings.stamp[good])
    turn = np.diff(np.unwrap(headings.yaw[good])) / (step * 1e-9)
    middle, nothing = headings.stamp[good][:-1] + step // 2, np.full(len(turn), np.nan)
    return Twists(middle, middle, np.column_stack([nothing, nothing, turn]), np.full((len(turn), 3), np.nan))


def _mean(time, integrated, at):
    """Mean rate about the times `at`, from its integral."""
    half = 0.5 * _SMOOTHED
    return (np.interp(at + half, time, integrated) - np.interp(at - half, time, integrated)) / _SMOOTHED


def _sums(rate, turn, first):
    """(blocks, 6) sums over blocks, each of which begins at one of `first` and ends at the next."""
    products = np.array([np.ones(len(turn)), rate, turn, rate * rate, rate * turn, turn * turn])
    return np.add.reduceat(products, first, axis=1).T


def _best(lags, sums) -> tuple[float, float]:
    """The offset with the largest correlation, and that correlation."""
    n, rate, turn, rates, both, turns = sums.T
    with np.errstate(invalid='ignore', divide='ignore'):
        size = np.nan_to_num((both - rate * turn / n) / np.sqrt((rates - rate**2 / n) * (turns - turn**2 / n)))
    at = int(np.argmax(np.abs(size)))
    lag = float(lags[at])
    if 0 < at < len(lags) - 1:
        lag += _STEP * _top(np.abs(size[at - 1:at + 2]))
    return lag, float(size[at])


def _top(three: np.ndarray) -> float:
    """Where the parabola through three values, of which the second is the largest, is largest: steps from that."""
    before, here, after = three
    bend = before - 2.0 * here + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0
