"""Confidence intervals of the mean of a time series of errors, of differences and ratios of means, and of shares.

Successive errors are correlated, so n of them count as n / tau independent ones, with tau the sum of the
autocorrelation (G. V. Bayley, J. M. Hammersley, "The effective number of independent observations in an autocorrelated
time series", 1946). Outages that overlap count as no more than those that do not. Student's t distribution with this
number of values gives valid intervals from a handful of outages to hours of fixes.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import betainc, betaincinv, stdtr, stdtrit

LEVEL = 0.95  # confidence of an interval
#: smallest number of independent values from which their scatter is estimated. Chosen, not measured
FEWEST = 4.0
#: smallest number of equal errors that are worth those of a mean: one alone has no scatter. As large
#: as FEWEST, it would take half of the verdicts of 5 skewed outages, with intervals that hold the ratio no more often
FEWEST_EQUAL = 2.0


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
        """p-value: probability of a mean as far from zero if there is no difference."""
        if self.sigma == 0:
            return float(self.mean == 0)
        return float(2 * stdtr(self.count - 1, -abs(self.mean) / self.sigma))


def correlation_length(values: np.ndarray) -> float:
    """Sum of the autocorrelation of `values` (n,), both sides, up to its first zero: 1 sample for white noise."""
    n = len(values)
    centred = values - values.mean()
    if n < 3 or np.ptp(values) == 0.0:
        return 1.0
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    spectrum = np.fft.rfft(centred, size)
    covariance = np.fft.irfft(spectrum * spectrum.conj(), size)[:n]
    rho = covariance / covariance[0]
    negative = np.flatnonzero(rho <= 0)
    return float(1 + 2 * rho[1:negative[0] if len(negative) else n].sum())


def mean_with_error(values: np.ndarray, apart: float = np.inf, independent: bool = False) -> Difference | None:
    """The mean of `values` (n,), a stationary series, with its standard error; None where it is too short, or contains
    a value that is not finite. apart: largest number of values that share no time. independent: they have no order."""
    values = np.asarray(values, dtype=float)
    with np.errstate(over='ignore', invalid='ignore'):
        if len(values) < FEWEST or not np.isfinite(values @ values):  # also if the sum of squares overflows
            return None
    count = len(values) if independent else min(len(values) / correlation_length(values), apart)
    if count < FEWEST:
        return None
    return Difference(float(values.mean()), float(values.std(ddof=1) / np.sqrt(count)), float(count))


def interval_of_mean(values: np.ndarray, level: float = LEVEL) -> tuple[float, float]:
    """Confidence interval of the mean of `values` (n,), a stationary series; NaN where it is too short."""
    found = mean_with_error(values)
    return (float('nan'), float('nan')) if found is None else found.interval(level)


def paired(first: np.ndarray, second: np.ndarray, apart: float = np.inf) -> Difference | None:
    """Difference of the means of two series (n,) at the same epochs, first minus second; None if they are too short."""
    return mean_with_error(np.asarray(first, dtype=float) - np.asarray(second, dtype=float), apart)


def log_ratios(first: np.ndarray, second: np.ndarray, floor: float) -> np.ndarray:
    """Pseudo-values (n,) of the logarithm of the ratio of the means of two series (n,) of errors: their mean is its
    estimate, their scatter gives the standard error (J. W. Tukey's jackknife, 1958). floor: value to which smaller
    errors are raised.
    """
    first, second = (np.maximum(np.asarray(values, dtype=float), floor) for values in (first, second))
    n = len(first)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        without_one = np.log((first.sum() - first) / (second.sum() - second))
        values = n * np.log(first.sum() / second.sum()) - (n - 1) * without_one
    return np.round(values, 9)  # the rounding errors of a constant ratio would look correlated


def ratio(first: np.ndarray, second: np.ndarray, floor: float, apart: float = np.inf,
          independent: bool = False) -> Difference | None:
    """The logarithm of the ratio of the means of two series (n,) of errors, first over second, at the same epochs or,
    `independent`, of units without an order; None if they are too short, or almost one error makes both means. apart:
    as in `mean_with_error`.

    Errors are positive and skewed: a few large ones make both a mean and its standard error, so the interval of a
    difference of two means is too wide where one of them is much larger, and reaches below an error of zero. The
    logarithm of the ratio is nearly symmetric. It is of the means, not of the single errors: a filter that is better in
    most outages and worse in the mean is not better. As a mean that few large errors make is known no better than from
    so few, Student's t has as many values as would make it with equal weights (L. Kish, "Survey Sampling", 1965), the
    average of those of both means. A ratio that is the same everywhere has no scatter to estimate.
    """
    values = log_ratios(first, second, floor)
    found = mean_with_error(values, apart, independent)
    if found is None or found.sigma == 0.0:
        return found
    weights = [w / w.max() for w in (np.maximum(first, floor), np.maximum(second, floor))]
    equal = float(np.mean([w.sum() ** 2 / (w @ w) for w in weights]))
    return replace(found, count=min(found.count, equal)) if equal >= FEWEST_EQUAL else None


def interval_of_share(count: float, of: float, level: float = LEVEL) -> tuple[float, float]:
    """Confidence interval of a probability, from `count` events in `of` independent trials (C. J. Clopper, E. S.
    Pearson, 1934). The numbers may be fractional."""
    tail = 0.5 * (1 - level)
    low = float(betaincinv(count, of - count + 1, tail)) if count > 0 else 0.0
    high = float(betaincinv(count + 1, of - count, 1 - tail)) if count < of else 1.0
    return low, high


def p_of_so_few(count: float, of: float, share: float) -> float:
    """Probability of `count` or fewer events in `of` independent trials with the probability `share`. The numbers may
    be fractional."""
    return float(betainc(of - count, count + 1, 1 - share)) if count < of else 1.0


def effective_number(values: np.ndarray) -> float:
    """Number of independent tests that are worth as much as k tests of `values` (k, n), which are correlated: from 1,
    if all rows go together, to k. Rows that are constant have no correlation and count as no test.

    Source: D. R. Nyholt, "A simple correction for multiple testing for single-nucleotide polymorphisms in linkage
    disequilibrium with each other", American Journal of Human Genetics 74 (2004), by the mean square correlation.
    """
    values = values[np.ptp(values, axis=1) > 0.0]
    k = len(values)
    if k < 2:
        return 1.0
    alike = (np.sum(np.corrcoef(values) ** 2) - k) / (k * (k - 1))
    return float(1 + (k - 1) * (1 - alike))


def holm(p: list[float]) -> list[float]:
    """`p` values adjusted for the number of comparisons (Holm 1979)."""
    order = np.argsort(p)
    adjusted = np.empty(len(p))
    running = 0.0
    for rank, i in enumerate(order):
        running = max(running, (len(p) - rank) * p[i])
        adjusted[i] = min(running, 1.0)
    return adjusted.tolist()
