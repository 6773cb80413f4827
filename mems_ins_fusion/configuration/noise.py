"""White noise and biases of an IMU from the standstills of a recording."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.characterization.allan import bounds, degrees_of_freedom
from mems_ins_fusion.recordings.motion import robust_sigma
from mems_ins_fusion.samples import ImuSamples, runs

#: s; shortest averaging time: longer than a filter inside the sensor
_SHORTEST = 0.5
#: s; longest averaging time: shorter than a drift of the bias
_LONGEST = 16.0
#: s, left out at both ends of a standstill, as the vehicle may still move there
_EDGE = 1.0
#: smallest number of differences of means for an estimate
_FEWEST = 6
#: degrees of freedom of a variance from the median of the squares, as a share of those of their mean
_OF_MEDIANS = 0.37


@dataclass(frozen=True)
class Noise:
    """force_density, rate_density: (3,) m/s^2/sqrt(Hz) and rad/s/sqrt(Hz). seconds: of the standstills they are from.
    part: standard deviation of the densities, relative. bias: (3,) rad/s of the gyroscopes at rest."""

    force_density: np.ndarray
    rate_density: np.ndarray
    seconds: float
    part: float
    bias: np.ndarray


def find_noise(imu: ImuSamples, still: np.ndarray) -> Noise | None:
    """Noise of `imu` (SI units) in its standstills `still`, (n,) bool; None where there are too few samples.

    The filter integrates the samples, so what matters is the noise of means over a second and more: the Allan
    deviation. A running engine, or people who get in, rock the vehicle on its springs, which makes the Allan deviation
    of some averaging times larger, but not that of all. So of all averaging times the one with the smallest upper bound
    of the density is taken. The sensors of the three axes of one chip are alike, and the rocking is not about all of
    them, so the densities are those of the quietest axis. Medians are used because of single knocks.
    """
    interval = float(np.median(np.diff(imu.stamp))) * 1e-9 if len(imu) > 1 else 0.0
    if interval <= 0.0:
        return None
    both, edge = np.hstack([imu.specific_force, imu.angular_rate]), round(_EDGE / interval)
    rests = [both[a + edge:b - edge] for a, b in runs(still) if b - a > 2 * edge]
    found = [_density(rests, size, interval) for size in _sizes(rests, interval)]
    found = [one for one in found if one is not None]
    if not found:
        return None
    densities, upper, degrees = (np.array(values) for values in zip(*found))
    best = np.argmin(upper, axis=0)
    least = [3 * k + int(np.argmin(upper[best, range(6)][3 * k:3 * k + 3])) for k in range(2)]
    force, rate = (np.full(3, densities[best[axis], axis]) for axis in least)
    part = float((2.0 * degrees[best[least]].min()) ** -0.5)
    rates = np.concatenate([rest[:, 3:] for rest in rests])
    return Noise(force, rate, float(still.sum() * interval), part, np.median(rates, axis=0))


def _sizes(rests, interval) -> list[int]:
    """Averaging times of means to compare, in samples: each twice the one before."""
    longest = min(max((len(rest) for rest in rests), default=0) // 3, round(_LONGEST / interval))
    shortest = max(round(_SHORTEST / interval), 1)
    return [shortest * 2**k for k in range(16) if shortest * 2**k <= longest]


def _density(rests, size: int, interval: float):
    """Of means over `size` samples: noise densities (6,), their upper bounds, and degrees of freedom; None of too few.
    """
    sums = [np.cumsum(np.vstack([np.zeros(6), rest]), axis=0) for rest in rests]
    steps = np.concatenate([(s[2 * size:] - 2.0 * s[size:-size] + s[:-2 * size]) / size for s in sums
                            if len(s) > 2 * size])
    if len(steps) < _FEWEST * size:
        return None
    density = np.array([robust_sigma(step) for step in steps.T]) * np.sqrt(size * interval / 2.0)
    degrees = max(_OF_MEDIANS * degrees_of_freedom(len(steps) + 2 * size, size, -0.5), 1.0)
    return density, bounds(density, np.full(6, degrees))[1], degrees
