"""Autocorrelation of a sensor at rest, and the Gauss-Markov process fitted to it (section 4.1 of the paper).

White noise contributes to lag 0 only, so the fit begins at lag 1 and returns the slow process. Subtracting the mean
lowers the whole curve by the variance of the mean; the fitted curve includes this.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..sensor_errors.models import GaussMarkov, simulate
from .fitting import IntervalEstimate
from .likelihood import Averages

_REPLICAS = 60  # number of simulated recordings from which the standard deviations of a fit are computed


@dataclass(frozen=True)
class AutocorrelationFit:
    """sigma, tau: of the Gauss-Markov process. white_variance: of the white noise in one average, unit squared.
    lags: s. values: the autocorrelation, unit squared. fitted: the curve through lags 1 and above."""

    sigma: IntervalEstimate
    tau: IntervalEstimate
    white_variance: float
    lags: np.ndarray
    values: np.ndarray
    fitted: np.ndarray


def autocorrelation(parts, max_lag: int) -> np.ndarray:
    """Autocorrelation at lags 0..max_lag of zero-mean series, missing samples (NaN) left out; unit squared.

    Products of present pairs over their number, by FFT, pooled over the parts; NaN for a lag without pairs.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    products, pairs = np.zeros(max_lag + 1), np.zeros(max_lag + 1)
    for x in parts:
        present = np.isfinite(x)
        size = next_fast_len(len(x) + max_lag + 1, real=True)
        reach = min(max_lag + 1, len(x))
        for total, values in ((products, np.where(present, x, 0.0)), (pairs, present.astype(float))):
            total[:reach] += irfft(np.abs(rfft(values, size)) ** 2, size)[:reach]
    pairs = np.round(pairs)
    return np.divide(products, pairs, out=np.full(max_lag + 1, np.nan), where=pairs > 0)


def ljung_box(values: np.ndarray, lags: int) -> float:
    """p-value of the hypothesis that `values` (n,) are white, from the first `lags` lags, at most n / 5 of them.

    G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models", Biometrika 65, 1978.
    """
    from scipy.stats import chi2

    n, centred = len(values), values - values.mean()
    lags = min(lags, n // 5)
    if lags < 1 or not centred.any():
        return 1.0
    left = n - np.arange(lags + 1)
    covariance = autocorrelation([centred], lags) * left / n
    correlation = covariance[1:] / covariance[0]
    return float(chi2.sf(n * (n + 2) * np.sum(correlation**2 / left[1:]), lags))


def fit_gauss_markov_autocorrelation(data: Averages) -> AutocorrelationFit:
    """Gauss-Markov fit to the autocorrelation of averages, with 95 % intervals from a parametric bootstrap.

    The uncertainty is the scatter of the fits to 60 simulated recordings of the same length with the fitted process.
    The residuals of the fit do not show it, as neighbouring lags are almost perfectly correlated.
    """
    parts = data.centred()
    longest = max(len(p) for p in parts)
    max_lag = longest // 4
    if max_lag < 10:
        raise InputError(f'{longest} averages are too few for an autocorrelation; 40 are needed')
    values = autocorrelation(parts, max_lag)
    lags = np.unique(np.round(np.geomspace(1, max_lag, 150)).astype(int))
    duration = longest * data.interval
    sigma, tau = _fit(values[lags], lags * data.interval, duration)
    white = max(values[0] - values[1], 0.0)
    spread = _bootstrap(sigma, tau, white, data.interval, longest, lags)
    all_lags = np.arange(max_lag + 1) * data.interval
    return AutocorrelationFit(_log_normal(sigma, spread[0], ''), _log_normal(tau, spread[1], 's'), white, all_lags,
                              values, sigma**2 * _shape(all_lags, tau, duration))


def _shape(lags, tau, duration):
    """Expected autocorrelation for unit variance after the mean over `duration` was removed."""
    ratio = duration / tau
    return np.exp(-lags / tau) - 2 / ratio * (1 + np.expm1(-ratio) / ratio)


def _fit(values, lags, duration):
    """sigma and tau by least squares: sigma^2 is linear, tau is searched for. sigma is 0 if there is no slow process.
    """
    from scipy.optimize import minimize_scalar

    def variance(tau):
        shape = _shape(lags, tau, duration)
        return max(values @ shape / (shape @ shape), 0.0)

    def squares(log_tau):
        tau = math.exp(log_tau)
        return float(np.sum((values - variance(tau) * _shape(lags, tau, duration)) ** 2))

    candidates = np.linspace(math.log(lags[0]), math.log(2 * duration), 25)
    best = int(np.argmin([squares(c) for c in candidates]))
    bounds = candidates[max(best - 1, 0)], candidates[min(best + 1, len(candidates) - 1)]
    tau = math.exp(minimize_scalar(squares, bounds=bounds, method='bounded').x)
    return math.sqrt(variance(tau)), tau


def _bootstrap(sigma, tau, white, interval, n, lags):
    """Standard deviations of log(sigma) and log(tau); infinite if the fit to a replica finds no slow process."""
    if sigma <= 0:
        return math.inf, math.inf
    rng = np.random.default_rng(0)
    fits = []
    for _ in range(_REPLICAS):
        x = simulate(GaussMarkov(sigma, tau), n, interval, rng) + math.sqrt(white) * rng.standard_normal(n)
        fits.append(_fit(autocorrelation([x - x.mean()], lags[-1])[lags], lags * interval, n * interval))
    found = np.array(fits)
    if np.any(found[:, 0] <= 0):
        return math.inf, math.inf
    return tuple(np.std(np.log(found), axis=0))


def _log_normal(value, spread, unit):
    if value <= 0 or not math.isfinite(spread):
        return IntervalEstimate(value, 0.0, math.inf, unit)
    return IntervalEstimate(value, value * math.exp(-1.96 * spread), value * math.exp(1.96 * spread), unit)
