"""The time offset between a receiver's velocities and its fixes: no IMU, no filter.

The displacement between two fixes is the integral of the velocity over the same time, shifted by the offset. On a grid
of offsets, the squared differences of all displacements are summed; the estimate is the offset about which this sum is
symmetric. Where the velocity is constant the difference does not depend on the offset.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.offset import FLOOR, LARGEST
from mems_ins_fusion.configuration.regression import BLOCKS, jackknife, shares
from mems_ins_fusion.recordings.motion import integral, positions
from mems_ins_fusion.samples import Fixes, Velocities, in_time_order, possible

#: s, step of the grid of offsets
_STEP = 0.05
#: s, length of a displacement: the velocity of a car changes in it, and it is larger than errors of metres of the fixes
_WAY = 2.0
#: smallest number of displacements for an estimate
_FEWEST = 40
#: multiple of the median difference, to which larger differences are limited: outliers of the fixes
_FAR = 3.0


@dataclass(frozen=True)
class VelocityOffset:
    """lag, lag_sigma: s, by which the velocities are stamped late against the fixes."""

    lag: float
    lag_sigma: float


def estimate_velocity_offset(velocities: Velocities, fixes: Fixes) -> VelocityOffset | None:
    """Estimate from usable `fixes`, in the order of their stamps, and `velocities`; None with too few of either."""
    good = in_time_order(velocities.stamp, possible(velocities.velocity[:, :2]))
    if len(good) < _FEWEST or len(fixes) < _FEWEST:
        return None
    origin = fixes.stamp[0]
    at, time = (fixes.stamp - origin) * 1e-9, (velocities.stamp[good] - origin) * 1e-9
    way = integral(time, velocities.velocity[good, :2])
    step = max(1, round(_WAY / float(np.median(np.diff(at)))))
    begin, end = at[:-step], at[step:]
    gap = np.concatenate([[0.0], np.cumsum(np.diff(time) > 3.0 * np.median(np.diff(time)))])
    whole = np.interp(end + LARGEST, time, gap) == np.interp(begin - LARGEST, time, gap)
    kept = (whole & (end - begin < 2.0 * _WAY) & (begin - LARGEST > time[0]) & (end + LARGEST < time[-1]))
    if np.count_nonzero(kept) < _FEWEST:
        return None
    begin, end, gone = begin[kept], end[kept], (positions(fixes)[step:] - positions(fixes)[:-step])[kept]
    lags = np.arange(-LARGEST, LARGEST + 0.5 * _STEP, _STEP)
    squares = np.array([np.square(gone - _between(time, way, begin + lag, end + lag)).sum(axis=1) for lag in lags])
    squares = np.minimum(squares, _FAR**2 * np.median(squares, axis=1, keepdims=True))
    blocks = shares(len(begin))
    costs = np.array([squares[:, blocks == block].sum(axis=1) for block in range(BLOCKS)])
    whole_cost = costs.sum(axis=0)
    apart = max(1, round(min(float(np.median(np.diff(fixes.stamp))) * 1e-9, float(np.median(np.diff(time)))) / _STEP))
    lag = _least(lags, whole_cost, apart)
    sigma = float(jackknife(np.array([_least(lags, whole_cost - cost, apart) for cost in costs])))
    return VelocityOffset(lag, math.hypot(sigma, FLOOR))


def _between(time, way, begin, end):
    return np.column_stack([np.interp(end, time, part) - np.interp(begin, time, part) for part in way.T])


def _least(lags, cost, apart: int) -> float:
    """The offset about which the cost is symmetric, next to the smallest: as large `apart` steps sooner as later.

    apart: steps between two fixes or two velocities. Between two velocities their noise averages out, so that the cost
    has a minimum of its own in each such interval; an interval apart they are interpolated alike.
    """
    at = int(np.argmin(cost))
    slope = cost[2 * apart:] - cost[:-2 * apart]  # at lags[apart:-apart]
    rising = np.flatnonzero((slope[:-1] < 0.0) & (slope[1:] >= 0.0))
    if not len(rising):
        return float(lags[at])
    i = rising[np.argmin(np.abs(rising + apart + 0.5 - at))]
    return float(lags[i + apart]) + _STEP * float(slope[i] / (slope[i] - slope[i + 1]))
