"""Autoregressive models AR(p), Eq. 15 of the paper, by the Yule-Walker, covariance and Burg methods.

Signs as in Eq. 15: y(n) = -a_1 y(n-1) - ... - a_p y(n-p) + b_0 w(n), with w of unit variance.
Source: S. M. Kay, Modern Spectral Estimation (1988), chapter 7.

These methods fit the whole series, white noise included; in raw samples of a MEMS sensor the white noise dominates.
`fitting.fit_autoregressive` separates the two.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..samples import runs


@dataclass(frozen=True)
class ArFit:
    """An estimated AR(p). coefficients: (a_1..a_p). b0: driving noise, unit of the series. method: its name."""

    coefficients: tuple[float, ...]
    b0: float
    method: str

    @property
    def radius(self) -> float:
        """Largest pole radius."""
        return _radius(self.coefficients)

    @property
    def stable(self) -> bool:
        return self.radius < 1

    def time_constant(self, interval: float) -> float:
        """Time constant of the slowest pole, s, for a series sampled at `interval` s; infinite for an unstable model.
        """
        return time_constant(self.coefficients, interval)


def time_constant(coefficients, interval: float) -> float:
    """Time, s, in which the slowest component of an AR model sampled at `interval` s decays to 1/e."""
    radius = _radius(coefficients)
    if radius >= 1:
        return math.inf
    return -interval / math.log(radius) if radius > 0 else 0.0


def _radius(coefficients) -> float:
    return float(np.abs(np.roots([1.0, *coefficients])).max())


def segments(x) -> list[np.ndarray]:
    """`x`, an array or a list of arrays, cut at its missing samples (NaN)."""
    parts = []
    for part in x if isinstance(x, (list, tuple)) else [x]:
        part = np.asarray(part, float)
        parts += [part[a:b] for a, b in runs(np.isfinite(part))]
    return parts


def yule_walker(x, order: int) -> ArFit:
    """Yule-Walker method: from the biased autocorrelation. The model is stable if no sample is missing, and biased for
    short records.

    x: zero-mean series, or several whose samples are pooled; NaN where missing. Like the two other methods, it raises
    InputError if there are not enough consecutive samples for the order.
    """
    from scipy.linalg import solve_toeplitz

    runs = _long_enough(x, order)
    total = sum(len(r) for r in runs)
    lags = np.arange(order + 1)
    products = np.array([sum(r[lag:] @ r[:len(r) - lag] for r in runs) for lag in lags])
    pairs = np.array([sum(len(r) - lag for r in runs) for lag in lags])
    covariances = products / pairs * (1 - lags / total)  # of one run: the biased autocorrelation, products / total
    a = -solve_toeplitz(covariances[:-1], covariances[1:])
    return ArFit(tuple(a), math.sqrt(max(covariances[0] + a @ covariances[1:], 0.0)), 'yule_walker')


def covariance(x, order: int) -> ArFit:
    """Least squares without any windowing of the data; may give an unstable model."""
    runs = _long_enough(x, order)
    normal = np.zeros((order + 1, order + 1))
    rows = 0
    for run in runs:
        lagged = np.stack([run[order - lag:len(run) - lag] for lag in range(order + 1)])
        normal += lagged @ lagged.T
        rows += lagged.shape[1]
    a = -np.linalg.lstsq(normal[1:, 1:], normal[1:, 0], rcond=None)[0]
    error = normal[0, 0] + a @ normal[1:, 0]
    return ArFit(tuple(a), math.sqrt(max(error, 0.0) / rows), 'covariance')


def burg(x, order: int) -> ArFit:
    """Burg method: minimizes forward and backward prediction errors together; stable, and best for short records."""
    return burg_all(x, order)[-1]


def burg_all(x, order: int) -> list[ArFit]:
    """Burg models of orders 1 to `order`; the recursion yields each on its way."""
    runs = _long_enough(x, order)
    power = sum(r @ r for r in runs) / sum(len(r) for r in runs)
    forward = [r[1:].copy() for r in runs]
    backward = [r[:-1].copy() for r in runs]
    a = np.ones(1)
    fits = []
    for _ in range(order):
        cross = sum(f @ b for f, b in zip(forward, backward))
        both = sum(f @ f + b @ b for f, b in zip(forward, backward))
        reflection = -2 * cross / both if both > 0 else 0.0
        a = np.concatenate([a, [0.0]])
        a = a + reflection * a[::-1]
        power *= 1 - reflection**2
        fits.append(ArFit(tuple(a[1:]), math.sqrt(max(power, 0.0)), 'burg'))
        updated = [(f + reflection * b, b + reflection * f) for f, b in zip(forward, backward)]
        forward = [f[1:] for f, _ in updated]
        backward = [b[:-1] for _, b in updated]
    return fits


METHODS = {'yule_walker': yule_walker, 'covariance': covariance, 'burg': burg}


def _long_enough(x, order):
    if order < 1:
        raise InputError(f'the order of an autoregressive model must be at least 1, got {order}')
    runs = [r for r in segments(x) if len(r) > 2 * order]
    if not runs:
        raise InputError(f'no {2 * order + 1} samples follow each other: too few for an AR({order}) model')
    return runs


def prediction_rmse(fit: ArFit, x) -> float:
    """Root mean square of the one-step prediction error of `fit` on the zero-mean series x (Figure 6)."""
    from scipy.signal import lfilter

    order = len(fit.coefficients)
    errors = [lfilter([1.0, *fit.coefficients], [1.0], run)[order:] for run in segments(x) if len(run) > order]
    if not errors:
        raise InputError(f'no {order + 1} samples follow each other: nothing to predict')
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


@dataclass(frozen=True)
class OrderCurve:
    """Figure 6 of the paper with its criteria: arrays over `orders`.

    rmse: one-step prediction error on held-out data, unit of the series. aic, bic: nats, smaller is better.
    fpe: Akaike's final prediction error, unit squared.
    """

    orders: np.ndarray
    rmse: np.ndarray
    aic: np.ndarray
    bic: np.ndarray
    fpe: np.ndarray

    def elbow(self) -> int:
        """Smallest order whose RMSE is within 1 % of the best: higher orders improve nothing."""
        return int(self.orders[self.rmse <= 1.01 * self.rmse.min()][0])


def order_curve(training, held_out, max_order: int) -> OrderCurve:
    """Burg models of orders 1..max_order fitted to `training` and evaluated on `held_out` (both zero-mean)."""
    n = sum(len(r) for r in segments(training))
    fits = burg_all(training, max_order)
    orders = np.arange(1, max_order + 1)
    variance = np.array([fit.b0**2 for fit in fits])
    with np.errstate(divide='ignore'):
        log_variance = n * np.log(variance)
    return OrderCurve(orders, np.array([prediction_rmse(fit, held_out) for fit in fits]),
                      log_variance + 2 * orders, log_variance + math.log(n) * orders,
                      variance * (n + orders + 1) / (n - orders - 1))
