"""Comparison of a further IMU with the first one: rotation, time offset, and whether it is a different sensor at all.

Both measure the same motion. The magnitude of the angular rate does not depend on the axes, so it gives the time
offset. The rotation is the one that fits angular rates and specific forces of both: turns determine the vertical axis,
braking and curves the others.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.mounting import BIAS_SIGMA
from mems_ins_fusion.filter.runs.usable import usable_samples
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.recordings.motion import integral
from mems_ins_fusion.samples import ImuSamples

#: s, length of the blocks whose means are compared: longer than vibration, shorter than turns
BLOCK = 0.1
#: s, largest time offset between two IMUs
LARGEST_LAG = 1.0
#: s, step of the search for the time offset
STEP = 0.02
#: smallest correlation of the magnitudes of both angular rates: with less, the IMUs are not on the same vehicle, or it
#: does not move
LEAST_ALIKE = 0.8
#: smallest number of blocks for a comparison
FEWEST = 100
#: share of the samples that are equal to the last digit, above which both are the same sensor
COPIED = 0.5
#: smallest noise of the difference of two IMUs, as a share of that of independent noise: with less, both are the same
#: sensor
IN_COMMON = 0.5
#: rad, largest standard deviation of the rotation that is used: with a larger one, gravity would show as a difference
#: of the accelerations, which the comparison of IMUs takes for a fault
LARGEST_SIGMA = math.radians(3.0)


@dataclass(frozen=True)
class ImuComparison:
    """A further IMU compared with the first. rotation: (3, 3) from its axes to those of the first, with a sigma, rad.
    lag: s, by which its stamps are late, with a sigma."""

    rotation: np.ndarray
    sigma: float
    lag: float
    lag_sigma: float


def compare_imus(first: ImuSamples, other: ImuSamples) -> ImuComparison | str:
    """`other` compared with `first`, both in SI units; or in words why they cannot be compared."""
    first, other = usable_samples(first), usable_samples(other)
    if min(len(first), len(other)) < 2:
        return 'no samples that can be used'
    if _copied(first, other):
        return 'it repeats samples of the first IMU: the same sensor twice'
    lag, alike, sharp = _lag(first, other)
    if alike < LEAST_ALIKE:
        return f'its turn rates do not go with those of the first IMU (correlation {alike:.2f}), or too little motion'
    blocks = _blocks(first, other, lag)
    gravity, other_gravity = (part.mean(axis=0) for part in blocks[1])
    pairs = [_weighed(*part) for part in blocks]
    # each turn and each acceleration weighs by its noise, gravity once, by the biases
    vectors, others = (np.vstack([*(pair[i] for pair in pairs), mean[None] / BIAS_SIGMA])
                       for i, mean in enumerate((gravity, other_gravity)))
    products = vectors.T @ others
    u, _, v = np.linalg.svd(products)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    shown = 0.5 * (products @ rotation.T + rotation @ products.T)  # what both see: noise is in each for itself
    information = np.linalg.eigvalsh(np.trace(shown) * np.eye(3) - shown)[0]
    sigma = 1.0 / math.sqrt(information) if information > 0.0 else math.inf
    if abs(np.linalg.norm(gravity) / STANDARD_GRAVITY - 1) > 0.2 or abs(
            np.linalg.norm(other_gravity) / STANDARD_GRAVITY - 1) > 0.2:
        return 'gravity is not in the samples of both'
    if sigma > LARGEST_SIGMA:
        return f'its rotation against the first IMU is not shown: {math.degrees(sigma):.1f} deg'
    if _noise_in_common(first, other, rotation, lag):
        return 'its noise is that of the first IMU: the same sensor twice'
    return ImuComparison(rotation, sigma, lag, sharp)


def _copied(first: ImuSamples, other: ImuSamples) -> bool:
    values = [np.ascontiguousarray(np.hstack([one.specific_force, one.angular_rate])) for one in (first, other)]
    rows = [one.view(np.dtype((np.void, one.dtype.itemsize * one.shape[1]))).ravel() for one in values]
    return bool(np.isin(rows[1], rows[0]).mean() > COPIED)


def _integral(imu: ImuSamples, values: np.ndarray):
    """A function of stamps (n,) s after the first IMU's begin: the integral of `values` over time."""
    def at(time, origin):
        own = (imu.stamp - origin) * 1e-9
        return np.column_stack([np.interp(time, own, column) for column in integral(own, values).T])
    return at


def _edges(first: ImuSamples, other: ImuSamples) -> np.ndarray:
    """Begins and ends of blocks that both cover, s after the first sample."""
    begin = max(0.0, (other.stamp[0] - first.stamp[0]) * 1e-9) + LARGEST_LAG
    end = (min(first.stamp[-1], other.stamp[-1]) - first.stamp[0]) * 1e-9 - LARGEST_LAG
    return np.arange(begin, end, BLOCK)


def _lag(first: ImuSamples, other: ImuSamples) -> tuple[float, float, float]:
    """Time by which the stamps of `other` are late, s; the correlation of the magnitudes of the angular rates with it;
    its sigma, s."""
    edges = _edges(first, other)
    if len(edges) < FEWEST:
        return 0.0, 0.0, math.inf
    sizes = [np.linalg.norm(one.angular_rate - np.median(one.angular_rate, axis=0), axis=1)[:, None]
             for one in (first, other)]
    mine, its = (_integral(one, size) for one, size in zip((first, other), sizes))
    mine = np.diff(mine(edges, first.stamp[0])[:, 0])

    def alike(lag):
        return float(np.corrcoef(mine, np.diff(its(edges + lag, first.stamp[0])[:, 0]))[0, 1])

    lags = np.arange(-LARGEST_LAG, LARGEST_LAG + STEP / 2, STEP)
    found = np.array([alike(lag) for lag in lags])
    if not np.isfinite(found).all():
        return 0.0, 0.0, math.inf
    best = int(np.clip(found.argmax(), 1, len(lags) - 2))
    before, top, after = found[best - 1:best + 2]
    curve = max(2 * top - before - after, 1e-12)
    lag = float(lags[best] + 0.5 * STEP * (after - before) / curve)
    # of a peak of this curvature, whose height noise makes less than 1
    sigma = STEP * math.sqrt(max(1.0 - top**2, 1e-6) / (curve * len(mine)))
    return lag, float(top), sigma


def _blocks(first: ImuSamples, other: ImuSamples, lag: float):
    """Means over blocks of both, of angular rates and of specific forces."""
    edges, origin = _edges(first, other), first.stamp[0]
    return [[np.diff(_integral(one, getattr(one, name))(edges + late, origin), axis=0) / BLOCK
             for one, late in ((first, 0.0), (other, lag))] for name in ('angular_rate', 'specific_force')]


def _weighed(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both without their means, divided by the scatter of the difference of their magnitudes, which does not depend on
    the axes."""
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    noise = max(float(np.median(np.abs(np.linalg.norm(one, axis=1) - np.linalg.norm(other, axis=1)))), 1e-6)
    return one / noise, other / noise


def _noise_in_common(first: ImuSamples, other: ImuSamples, rotation: np.ndarray, lag: float) -> bool:
    """Whether what is left of the difference is less than two sensors would have, judged by the changes from sample to
    sample: those of the first one, where the other one is turned into its axes and time."""
    time, own = (first.stamp - first.stamp[0]) * 1e-9, (other.stamp - first.stamp[0]) * 1e-9 - lag
    inside = (time > own[0]) & (time < own[-1])
    turned = other.angular_rate @ rotation.T
    its = np.column_stack([np.interp(time[inside], own, column) for column in turned.T])
    changes, left = (np.diff(part, axis=0) for part in (first.angular_rate[inside], first.angular_rate[inside] - its))
    return bool(np.median(left.std(axis=0) / np.maximum(changes.std(axis=0), 1e-12)) < IN_COMMON)
