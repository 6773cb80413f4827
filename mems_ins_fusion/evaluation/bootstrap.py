"""Confidence intervals and comparisons for errors that follow each other in time.

Neighbouring errors are alike, so they count for less than their number: whole blocks are drawn, not single values.
Source: D. N. Politis, J. P. Romano, "A circular block-resampling procedure for stationary data", 1992.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DRAWS = 2000
#: blocks are this many correlation times long: the variance is then underestimated by a tenth
BLOCK = 10
#: with fewer blocks than this an interval means nothing; more than that many only cost time
FEWEST_BLOCKS, MOST_BLOCKS = 5, 400


@dataclass(frozen=True)
class Difference:
    """Whether two series differ. mean: of the differences; low, high: its 95 % interval; p: of no difference."""

    mean: float
    low: float
    high: float
    p: float


def correlation_length(values: np.ndarray) -> float:
    """Sum of the autocorrelation of `values` (n,), both sides, up to its first zero: 1 sample for white noise."""
    n = len(values)
    centred = values - values.mean()
    if n < 3 or not centred.any():
        return 1.0
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    spectrum = np.fft.rfft(centred, size)
    covariance = np.fft.irfft(spectrum * spectrum.conj(), size)[:n]
    rho = covariance / covariance[0]
    negative = np.flatnonzero(rho <= 0)
    return float(1 + 2 * rho[1:negative[0] if len(negative) else n].sum())


def block_means(values: np.ndarray, draws: int = DRAWS, seed: int = 0) -> np.ndarray | None:
    """Means of `draws` resamples of `values` (n,), in circular blocks; None where there are too few blocks or
    values that are no numbers."""
    n = len(values)
    if not np.isfinite(values).all():
        return None
    with np.errstate(over='ignore', invalid='ignore'):
        if not np.isfinite(values @ values):  # too large for their variance to be a number
            return None
    block = int(np.ceil(BLOCK * correlation_length(values))) if n > 2 else n
    block = min(max(block, -(-n // MOST_BLOCKS)), n // FEWEST_BLOCKS)
    if block < 1:
        return None
    total = np.concatenate([[0.0], np.cumsum(np.concatenate([values, values[:block]]))])
    blocks = int(round(n / block))
    start = np.random.default_rng(seed).integers(0, n, (draws, blocks))
    return (total[start + block] - total[start]).sum(axis=1) / (block * blocks)


def interval_of_mean(values: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """Confidence interval of the mean of `values` (n,), a stationary series; NaN where it is too short."""
    means = block_means(np.asarray(values, dtype=float))
    if means is None:
        return float('nan'), float('nan')
    low, high = np.percentile(means, [50 * (1 - level), 50 * (1 + level)])
    return float(low), float(high)


def paired(first: np.ndarray, second: np.ndarray) -> Difference | None:
    """Whether the means of two series (n,) of the same epochs differ, first minus second; None if too short to say."""
    difference = np.asarray(first, dtype=float) - np.asarray(second, dtype=float)
    means = block_means(difference)
    if means is None:
        return None
    mean = float(difference.mean())
    p = (1 + np.count_nonzero(np.abs(means - mean) >= abs(mean))) / (1 + len(means))
    low, high = np.percentile(means, [2.5, 97.5])
    return Difference(mean, float(low), float(high), float(p) if difference.any() else 1.0)


def holm(p: list[float]) -> list[float]:
    """`p` values adjusted for the number of comparisons (Holm 1979)."""
    order = np.argsort(p)
    adjusted = np.empty(len(p))
    running = 0.0
    for rank, i in enumerate(order):
        running = max(running, (len(p) - rank) * p[i])
        adjusted[i] = min(running, 1.0)
    return adjusted.tolist()
