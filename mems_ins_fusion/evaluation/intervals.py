"""Confidence intervals: of the mean of errors that follow each other in time, of differences, and of shares.

Neighbouring errors are alike, so they count for less than their number n: for n / tau, with tau the sum of the
autocorrelation (G. V. Bayley, J. M. Hammersley, "The effective number of independent observations in an autocorrelated
time series", 1946), and outages that overlap for no more than those that do not. Student's t with as many values then
holds from a handful of outages to hours of fixes.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betainc, betaincinv, stdtr, stdtrit

LEVEL = 0.95  # confidence of an interval
#: fewer independent values say nothing of their scatter
FEWEST = 4.0


@dataclass(frozen=True)
class Difference:
    """The mean of the differences of two series. sigma: its standard error; count: independent differences."""

    mean: float
    sigma: float
    count: float

    def interval(self, level: float = LEVEL) -> tuple[float, float]:
        """Its confidence interval."""
        half = float(stdtrit(self.count - 1, 0.5 + 0.5 * level)) * self.sigma
        return self.mean - half, self.mean + half

    @property
    def low(self) -> float:
        return self.interval()[0]

    @property
    def high(self) -> float:
        return self.interval()[1]

    @property
    def p(self) -> float:
        """How often chance gives a mean as far from zero where there is no difference."""
        if self.sigma == 0:
            return float(self.mean == 0)
        return float(2 * stdtr(self.count - 1, -abs(self.mean) / self.sigma))


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


def of_mean(values: np.ndarray, apart: float = np.inf) -> Difference | None:
    """The mean of `values` (n,), a stationary series, with its standard error; None where it is too short to say, or
    holds what is no number. apart: how many of them share no time, at most."""
    values = np.asarray(values, dtype=float)
    with np.errstate(over='ignore', invalid='ignore'):
        if len(values) < FEWEST or not np.isfinite(values @ values):  # also: too large for their variance to be one
            return None
    count = min(len(values) / correlation_length(values), apart)
    if count < FEWEST:
        return None
    return Difference(float(values.mean()), float(values.std(ddof=1) / np.sqrt(count)), float(count))


def interval_of_mean(values: np.ndarray, level: float = LEVEL) -> tuple[float, float]:
    """Confidence interval of the mean of `values` (n,), a stationary series; NaN where it is too short."""
    found = of_mean(values)
    return (float('nan'), float('nan')) if found is None else found.interval(level)


def paired(first: np.ndarray, second: np.ndarray, apart: float = np.inf) -> Difference | None:
    """Whether the means of two series (n,) of the same epochs differ, first minus second; None if too short to say."""
    return of_mean(np.asarray(first, dtype=float) - np.asarray(second, dtype=float), apart)


def interval_of_share(count: float, of: float, level: float = LEVEL) -> tuple[float, float]:
    """Confidence interval of a probability of which `count` of `of` were seen (C. J. Clopper, E. S. Pearson, 1934);
    numbers of independent events need not be whole."""
    tail = 0.5 * (1 - level)
    low = float(betaincinv(count, of - count + 1, tail)) if count > 0 else 0.0
    high = float(betaincinv(count + 1, of - count, 1 - tail)) if count < of else 1.0
    return low, high


def p_of_so_few(count: float, of: float, share: float) -> float:
    """How often `count` or fewer of `of` happen where each does with probability `share`; need not be whole numbers."""
    return float(betainc(of - count, count + 1, 1 - share)) if count < of else 1.0


def holm(p: list[float]) -> list[float]:
    """`p` values adjusted for the number of comparisons (Holm 1979)."""
    order = np.argsort(p)
    adjusted = np.empty(len(p))
    running = 0.0
    for rank, i in enumerate(order):
        running = max(running, (len(p) - rank) * p[i])
        adjusted[i] = min(running, 1.0)
    return adjusted.tolist()
