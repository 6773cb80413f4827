"""Overlapping Allan deviation with confidence bounds, and the noise coefficients read from its slope regions.

Sources: IEEE Std 952-1997, annex C (coefficients and slopes); W. J. Riley, Handbook of Frequency Stability Analysis,
NIST SP 1065 (2008), Table 5 (equivalent degrees of freedom). The "frequency" there is our sensor's output.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..samples import runs

#: sigma of flicker noise at the flat minimum is this times the bias instability B (IEEE 952, C.1.2)
FLICKER_MINIMUM = math.sqrt(2 * math.log(2) / math.pi)
#: the Allan deviation of a first-order Gauss-Markov process peaks at this multiple of its correlation time
GAUSS_MARKOV_PEAK = 1.8926
#: smallest share of the samples of an averaging window that must be present
_PRESENT = 0.9
#: number of averaging times in each octave
_PER_OCTAVE = 4


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviation against averaging time, arrays of equal length.

    tau: s. deviation, lower, upper: unit of the sensor, bounds of the central 95 % interval.
    degrees: equivalent degrees of freedom of deviation**2. slope: d log(deviation) / d log(tau).
    """

    tau: np.ndarray
    deviation: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    degrees: np.ndarray
    slope: np.ndarray


@dataclass(frozen=True)
class AllanParameters:
    """Noise coefficients; None where the curve has no region from which they can be read.

    noise_density (angle or velocity random walk N): unit/sqrt(Hz). bias_instability B: unit, at
    bias_instability_tau s. random_walk (rate random walk K): unit/sqrt(s). Each with one sigma.
    correlation_time: s, of the Gauss-Markov process whose hump the curve shows.
    """

    noise_density: float | None
    noise_density_sigma: float | None
    bias_instability: float | None
    bias_instability_tau: float | None
    random_walk: float | None
    random_walk_sigma: float | None
    correlation_time: float | None


def allan_deviation(parts, rate: float) -> AllanCurve:
    """Overlapping Allan deviation of a sensor at rest.

    parts: one array, or several (stretches between which the sensor was moved); unit of the sensor, NaN where a
    sample is missing. rate: Hz. Averaging times run from one sample to a quarter of the longest part.
    Raises InputError for fewer than 16 samples.
    """
    parts = [np.asarray(p, float) for p in (parts if isinstance(parts, (list, tuple)) else [parts])]
    longest = max((len(p) for p in parts), default=0)
    if longest < 16:
        raise InputError(f'an Allan deviation needs at least 16 samples in a row, got {longest}')
    sizes = np.unique(np.round(2 ** np.arange(0, math.log2(longest / 4) + 1e-9, 1 / _PER_OCTAVE)).astype(int))
    squares = np.zeros(len(sizes))
    pairs = np.zeros(len(sizes))
    for part in parts:
        part_squares, part_pairs = _sums(part, sizes)
        squares += part_squares
        pairs += part_pairs
    sizes, squares, pairs = sizes[pairs > 0], squares[pairs > 0], pairs[pairs > 0]
    tau = sizes / rate
    deviation = np.sqrt(squares / pairs / 2)
    slope = _slopes(tau, deviation)
    samples = sum(np.isfinite(p).sum() for p in parts)
    degrees = np.array([degrees_of_freedom(samples + 1, m, s) for m, s in zip(sizes, slope)])
    lower, upper = bounds(deviation, degrees)
    return AllanCurve(tau, deviation, lower, upper, degrees, slope)


def _sums(x, sizes):
    """Sum of squared differences of adjacent window means, and their number, for each window size."""
    present = np.isfinite(x)
    if not present.any():
        return np.zeros(len(sizes)), np.zeros(len(sizes))
    complete = present.all()
    centred = np.where(present, x - np.mean(x[present]), 0.0)
    total = np.concatenate([[0.0], np.cumsum(centred)])
    count = None if complete else np.concatenate([[0], np.cumsum(present)])
    sums = [_differences(total, count, m) for m in sizes]
    return np.array([s for s, _ in sums]), np.array([n for _, n in sums])


def _differences(total, count, m):
    if len(total) <= 2 * m:
        return 0.0, 0
    if count is None:
        difference = total[2 * m:] - total[m:-m]
        difference -= total[m:-m]
        difference += total[:-2 * m]
        return difference @ difference / m**2, len(difference)
    number = count[m:] - count[:-m]
    with np.errstate(invalid='ignore', divide='ignore'):
        mean = (total[m:] - total[:-m]) / number
    mean[number < _PRESENT * m] = np.nan
    difference = mean[m:] - mean[:-m]
    difference = difference[np.isfinite(difference)]
    return difference @ difference, len(difference)


def _slopes(tau, deviation):
    """Slope of a line through the points within half an octave of each, in log-log."""
    x, y = np.log(tau), np.log(np.maximum(deviation, np.finfo(float).tiny))
    reach = 0.5 * math.log(2) + 1e-9
    slopes = np.empty(len(x))
    for i in range(len(x)):
        near = np.abs(x - x[i]) <= reach
        if near.sum() < 2:  # the first window sizes, 1 and 2, are an octave apart
            near = np.abs(x - x[i]) <= math.log(2) + 1e-9
        slopes[i] = np.polyfit(x[near], y[near], 1)[0] if near.sum() > 1 else -0.5
    return slopes


def degrees_of_freedom(points: int, m: int, slope: float) -> float:
    """Equivalent degrees of freedom of an overlapping Allan variance, NIST SP 1065, Table 5.

    points: number of integrated samples (samples + 1). m: window size. slope: of the deviation in log-log,
    from which the kind of noise follows: white below -1/4, flicker up to +1/4, random walk above.
    """
    n = points
    if slope < -0.25:
        value = (3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5)
    elif slope < 0.25:
        value = 2 * (n - 2) ** 2 / (2.3 * n - 4.9) if m == 1 else 5 * n**2 / (4 * m * (n + 3 * m))
    else:
        value = (n - 2) / m * ((n - 1) ** 2 - 3 * m * (n - 1) + 4 * m**2) / (n - 3) ** 2
    return max(value, 1.0)


def bounds(deviation, degrees):
    """The central 95 % interval of deviations (k,), lower and upper, from their equivalent degrees of freedom (k,)."""
    from scipy.stats import chi2

    tail = (1 - 0.95) / 2
    return (deviation * np.sqrt(degrees / chi2.ppf(1 - tail, degrees)),
            deviation * np.sqrt(degrees / chi2.ppf(tail, degrees)))


def allan_parameters(curve: AllanCurve) -> AllanParameters:
    """The coefficients, each from its region of the slope, and only where the confidence bounds prove that region."""
    white = _region(np.abs(curve.slope + 0.5) < 0.1, curve.degrees)
    density = density_sigma = None
    if white is not None:
        density, density_sigma = _coefficient(curve, white, curve.deviation**2 * curve.tau)
    minimum, peak = _rise(curve)
    rises = peak > minimum
    walk, walk_sigma = _random_walk(curve, minimum, density)
    return AllanParameters(density, density_sigma,
                           float(curve.deviation[minimum] / FLICKER_MINIMUM) if rises else None,
                           float(curve.tau[minimum]) if rises else None,
                           walk, walk_sigma, _correlation_time(curve, peak) if rises else None)


def _rise(curve):
    """Indices of a minimum and a later peak between which the curve certainly rises, those with the largest rise. If it
    certainly rises nowhere, twice the index of the smallest deviation."""
    ahead = np.maximum.accumulate(curve.lower[::-1])[::-1]
    minimum = int(np.argmax(ahead / curve.deviation))
    if ahead[minimum] <= curve.deviation[minimum]:
        return (int(np.argmin(curve.deviation)),) * 2
    return minimum, minimum + int(np.argmax(curve.lower[minimum:]))


def _region(inside, weight):
    """Indices of the run of `inside` with the largest total weight, at least two points long; or None."""
    long = [np.arange(a, b) for a, b in runs(inside) if b - a >= 2]
    return max(long, key=lambda run: weight[run].sum()) if long else None


def _coefficient(curve, region, squared):
    """Square root of the weighted mean of `squared` over `region`, and its one sigma.

    The points of one region come from the same samples, so the uncertainty is that of the best of them.
    """
    value = math.sqrt(np.average(squared[region], weights=curve.degrees[region]))
    return value, value / math.sqrt(2 * curve.degrees[region].max())


def _random_walk(curve, minimum, density):
    """Rate random walk from the region of slope +1/2, where white noise alone cannot explain the deviation."""
    from scipy.stats import chi2

    white = 0.0 if density is None else density**2
    certain = curve.deviation**2 * curve.degrees / chi2.ppf(0.999, curve.degrees)
    rising = (np.abs(curve.slope - 0.5) < 0.25) & (certain > 2 * white / curve.tau)
    rising[:minimum] = False
    region = _region(rising, curve.degrees)
    if region is None:
        return None, None
    return _coefficient(curve, region, np.maximum(curve.deviation**2 - white / curve.tau, 0.0) * 3 / curve.tau)


def _correlation_time(curve, peak):
    """Correlation time from the peak after the minimum, if the curve certainly falls again after it."""
    falls = np.any(curve.upper[peak:] < curve.deviation[peak])
    return float(curve.tau[peak] / GAUSS_MARKOV_PEAK) if falls else None
