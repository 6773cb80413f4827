"""White noise and biases of an IMU from what standstills there are; where there is none, from the quietest seconds."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.samples import ImuSamples

_INTERVAL = 0.5  # s that are averaged: long enough for an internal filter, short enough for a short stop
_QUIETEST = 5.0  # percent of the seconds of a recording without a standstill


@dataclass(frozen=True)
class Noise:
    """force_density, rate_density: (3,) m/s^2/sqrt(Hz) and rad/s/sqrt(Hz). seconds: of the standstills they are from;
    0: from the quietest seconds of the drive, an upper limit. part: standard deviation of the densities, relative.
    bias, bias_sigma: (3,) rad/s of the gyroscopes at rest, or None."""

    force_density: np.ndarray
    rate_density: np.ndarray
    seconds: float
    part: float
    bias: np.ndarray | None
    bias_sigma: np.ndarray | None


def find_noise(imu: ImuSamples, still: np.ndarray) -> Noise | None:
    """Noise of `imu` (SI units) in its standstills `still`, (n,) bool; None where there are too few samples."""
    interval = float(np.median(np.diff(imu.stamp))) * 1e-9 if len(imu) > 1 else 0.0
    if interval <= 0.0:
        return None
    size = max(round(_INTERVAL / interval), 1)
    both = np.hstack([imu.specific_force, imu.angular_rate])
    steps, means = [], []
    for rest in np.split(both, np.flatnonzero(np.diff(still)) + 1)[0 if still[0] else 1::2]:
        blocks = rest[:len(rest) // size * size].reshape(-1, size, 6).mean(axis=1)
        steps.append(np.diff(blocks, axis=0))
        means.append(blocks)
    steps = np.concatenate(steps) if steps else np.empty((0, 6))
    if len(steps) < 6:
        return _quietest(both, interval)
    # by medians: a standstill's first and last second may belong to the motion
    density = 1.4826 * np.median(np.abs(steps), axis=0) * np.sqrt(size * interval / 2.0)
    bias = np.concatenate(means)[:, 3:]
    scatter = 1.4826 * np.median(np.abs(bias - np.median(bias, axis=0)), axis=0)
    scatter = np.maximum(scatter, density[3:] / np.sqrt(size * interval)) * np.sqrt(np.pi / 2.0 / len(bias))
    return Noise(density[:3], density[3:], float(still.sum() * interval), float(np.sqrt(1.36 / len(steps))),
                 np.median(bias, axis=0), scatter)


def _quietest(both, interval) -> Noise | None:
    size = max(round(1.0 / interval), 4)
    count = len(both) // size
    if count < 20:
        return None
    steps = np.diff(both[:count * size].reshape(count, size, 6), axis=1)
    density = np.sqrt(np.nanpercentile((steps**2).mean(axis=1), _QUIETEST, axis=0) / 2.0 * interval)
    return Noise(density[:3], density[3:], 0.0, float(np.sqrt(1.0 / count)), None, None)
