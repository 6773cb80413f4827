"""White noise and slow sensor error, estimated together: exact maximum likelihood on averaged samples.

The samples are averaged over intervals of T seconds. A mean is

    z(k) = level + mean over the interval of the slow error x(t) + v(k),   v ~ N(0, N^2 / T)

with white noise density N, a constant unknown level (a new one whenever the sensor was moved), and x a random walk, a
first-order Gauss-Markov process or an AR(p) that steps once per interval. A Kalman filter gives the likelihood; the
level is integrated out (restricted likelihood), which avoids the bias that subtracting the mean would cause.
Sources: A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter (1989), sections 3.4 and 4.3;
P. de Jong, The diffuse Kalman filter, Annals of Statistics 19 (1991).
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.compiled import njit

from ..sensor_errors.models import Autoregressive, GaussMarkov, Model, RandomWalk

#: relative change of the covariance below which the filter has reached its steady state
_STEADY = 1e-11


@dataclass(frozen=True)
class Averages:
    """Interval means of one axis. z: (n,) unit of the sensor, NaN where missing. part: (n,) int, counted from 0:
    its level is the same within one part. interval: T, s."""

    z: np.ndarray
    part: np.ndarray
    interval: float

    def coarser(self, factor: int) -> Averages:
        """Means over `factor` intervals each."""
        return average([self.z[self.part == p] for p in np.unique(self.part)], factor, self.interval)

    def slice(self, start: int, stop: int) -> Averages:
        return Averages(self.z[start:stop], self.part[start:stop], self.interval)

    @property
    def duration(self) -> float:
        """Time covered by present intervals, s."""
        return float(np.isfinite(self.z).sum() * self.interval)

    def centred(self) -> list[np.ndarray]:
        """The parts, each without its mean."""
        parts = [self.z[self.part == p] for p in np.unique(self.part)]
        return [p - np.nanmean(p) for p in parts if np.isfinite(p).any()]


def average(parts, factor: int, interval: float) -> Averages:
    """Means over `factor` samples `interval` s apart; missing where more than half of the samples are."""
    means, labels = [], []
    for label, x in enumerate(parts):
        blocks = x[:len(x) // factor * factor].reshape(-1, factor)
        present = np.isfinite(blocks)
        count = present.sum(axis=1)
        total = np.where(present, blocks, 0.0).sum(axis=1)
        means.append(np.where(2 * count >= factor, total / np.maximum(count, 1), np.nan))
        labels.append(np.full(len(blocks), label))
    return Averages(np.concatenate(means), np.concatenate(labels), factor * interval)


@dataclass(frozen=True)
class StateSpace:
    """x(k+1) = a x(k) + w, w ~ N(0, q); the interval's mean is c x + white noise of variance r; x(0) ~ N(0, p0)."""

    a: np.ndarray
    q: np.ndarray
    c: np.ndarray
    r: float
    p0: np.ndarray


def state_space(model: Model | None, noise_density: float, interval: float) -> StateSpace:
    """White noise plus `model` (None: nothing else), seen through means over `interval` s."""
    r = noise_density**2 / interval
    if model is None:
        return StateSpace(np.zeros((1, 1)), np.zeros((1, 1)), np.ones(1), r, np.zeros((1, 1)))
    if isinstance(model, Autoregressive):
        p = model.order
        return StateSpace(model.transition(), model.process_noise(), np.eye(p)[0], r, model.initial_covariance())
    if isinstance(model, RandomWalk):
        phi, gain, start = 1.0, 1.0, 0.0
        q = model.q**2 * interval * np.array([[1.0, 1 / 2], [1 / 2, 1 / 3]])
    else:
        phi, gain, q = _gauss_markov_mean(model, interval)
        start = model.sigma**2
    a = np.array([[phi, 0.0], [gain, 0.0]])
    return StateSpace(a, q, np.array([0.0, 1.0]), r, start * np.outer(a[:, 0], a[:, 0]) + q)


def autoregressive_space(partial, b0: float, noise_density: float, interval: float) -> StateSpace:
    """As `state_space` for the AR(p) with reflection coefficients `partial`: exact however near to the unit circle.

    Its stationary covariance follows from the reflection coefficients without solving an equation (Levinson).
    """
    order = len(partial)
    variance = b0**2 / np.prod(1 - np.square(partial))
    covariances = [variance]
    a = np.ones(1)
    for k in partial:
        covariances.append(-k * variance - a[1:] @ covariances[:0:-1])
        a = np.concatenate([a, [0.0]])
        a = a + k * a[::-1]
        variance *= 1 - k**2
    companion = np.eye(order, k=-1)
    companion[0] = -a[1:]
    lag = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
    q = np.zeros((order, order))
    q[0, 0] = b0**2
    return StateSpace(companion, q, np.eye(order)[0], noise_density**2 / interval, np.array(covariances)[lag])


def _gauss_markov_mean(model, interval):
    """Transition, mean for unit start, and covariance of (end value, mean) of the process over one interval."""
    u = interval / model.tau
    decay = math.exp(-u)
    lost = -math.expm1(-u)
    if u < 1e-3:  # the closed form below cancels
        mean = 2 * u / 3 - u**2 / 2
    else:
        mean = 2 * (u - 2 * lost - math.expm1(-2 * u) / 2) / u**2
    q = np.array([[-math.expm1(-2 * u), lost**2 / u], [lost**2 / u, mean]])
    return decay, lost / u, model.sigma**2 * q


def _innovations(z, part, a, q, c, r, p0):
    """Innovations of z (n,) and of a constant 1, their variance, and the state for z predicted after each interval
    (n, d), from one Kalman filter; restarts with each part."""
    n, d = len(z), len(c)
    error, level, variance = np.full((3, n), np.nan)
    states = np.empty((n, d))
    _filter(z, part, a, q, c, r, p0, error, level, variance, states, np.zeros((6, d)), np.zeros((3, d, d)))
    return error, level, variance, states


@njit(nogil=True)
def _filter(z, part, a, q, c, r, p0, error, level, variance, states, vectors, matrices):
    """`_innovations` into error, level, variance (n,) of NaN and states (n, d), with room to work.

    Once the covariance has converged, it is not updated until the next missing average, nor is the response to the
    constant: most of a long recording costs one product with the transition matrix per average.
    """
    n, d = len(z), len(c)
    x, y, x_next, y_next = vectors[0], vectors[1], vectors[2], vectors[3]
    column, gain = vectors[4], vectors[5]  # p c, and a p c / f
    p, p_next, ap = matrices[0], matrices[1], matrices[2]
    f, el = 1.0, 1.0
    steady, settled = False, False
    for k in range(n):
        if k == 0 or part[k] != part[k - 1]:
            for i in range(d):
                x[i] = y[i] = 0.0
                for j in range(d):
                    p[i, j] = p0[i, j]
            steady = False
        present = not np.isnan(z[k])
        if not present:
            steady = False
        if not steady:
            settled = False
            f = r
            for i in range(d):
                column[i] = 0.0
                for j in range(d):
                    column[i] += p[i, j] * c[j]
                f += c[i] * column[i]
            for i in range(d):
                gain[i] = 0.0
                for j in range(d):
                    gain[i] += a[i, j] * column[j] / f
        ez = 0.0
        if present:
            ez = z[k]
            for i in range(d):
                ez -= c[i] * x[i]
            if not settled:
                el = 1.0
                for i in range(d):
                    el -= c[i] * y[i]
            error[k], level[k], variance[k] = ez, el, f
        for i in range(d):
            x_next[i] = gain[i] * ez
            for j in range(d):
                x_next[i] += a[i, j] * x[j]
        for i in range(d):
            x[i] = states[k, i] = x_next[i]
        if not settled:
            move = 0.0
            for i in range(d):
                y_next[i] = gain[i] * el if present else 0.0
                for j in range(d):
                    y_next[i] += a[i, j] * y[j]
                move += abs(y_next[i] - y[i])
            for i in range(d):
                y[i] = y_next[i]
            settled = steady and move < _STEADY
        if not steady:
            for i in range(d):
                for j in range(d):
                    ap[i, j] = 0.0
                    for m in range(d):
                        if present:
                            ap[i, j] += a[i, m] * (p[m, j] - column[m] * column[j] / f)
                        else:
                            ap[i, j] += a[i, m] * p[m, j]
            change, size = 0.0, r
            for i in range(d):
                for j in range(d):
                    p_next[i, j] = q[i, j]
                    for m in range(d):
                        p_next[i, j] += ap[i, m] * a[j, m]
                    change = max(change, abs(p_next[i, j] - p[i, j]))
                    size = max(size, abs(p_next[i, j]))
            steady = present and change <= _STEADY * size
            if not steady:
                for i in range(d):
                    for j in range(d):
                        p[i, j] = p_next[i, j]


def innovations(data: Averages, space: StateSpace, levels) -> tuple[np.ndarray, np.ndarray]:
    """Innovations and their variances, (n,) each, with the given level of each part."""
    error, one, variance, _ = _innovations(data.z, data.part, space.a, space.q, space.c, space.r, space.p0)
    return error - np.asarray(levels)[data.part] * one, variance


def estimate_levels(data: Averages, space: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """Best estimate of each part's level and its one sigma, (parts,) each; for a random walk, that of its start."""
    error, one, variance, _ = _innovations(data.z, data.part, space.a, space.q, space.c, space.r, space.p0)
    count = int(data.part.max()) + 1
    present = np.isfinite(error)
    weight = np.where(present, one / variance, 0.0)
    information = np.bincount(data.part, weight * np.where(present, one, 0.0), count)
    weighted = np.bincount(data.part, weight * np.where(present, error, 0.0), count)
    with np.errstate(divide='ignore', invalid='ignore'):
        return weighted / information, 1 / np.sqrt(information)


def predicted_states(data: Averages, space: StateSpace, levels) -> np.ndarray:
    """State (n, d) expected for the interval after each one, from all averages up to it; levels: one per part."""
    return _innovations(data.z - np.asarray(levels)[data.part], data.part, space.a, space.q, space.c, space.r,
                        space.p0)[3]


def log_likelihood(data: Averages, space: StateSpace) -> float:
    """Restricted log likelihood of `data`, nats."""
    squares, log_variance, log_information, n, parts = _terms(data, space)
    return -0.5 * (squares + log_variance + log_information + (n - parts) * math.log(2 * math.pi))


def _terms(data, s):
    error, one, variance, _ = _innovations(data.z, data.part, s.a, s.q, s.c, s.r, s.p0)
    return _sums(error, one, variance, data.part)


@njit(nogil=True)
def _sums(error, one, variance, part):
    """Sum of squared normalized innovations with the levels at their best, and the log determinants."""
    squares, log_variance, log_information = 0.0, 0.0, 0.0
    n, parts = 0, 0
    oo, oe = 0.0, 0.0
    for k in range(len(error)):
        if k > 0 and part[k] != part[k - 1]:
            if oo > 0:
                squares -= oe * oe / oo
                log_information += math.log(oo)
                parts += 1
            oo, oe = 0.0, 0.0
        if np.isnan(error[k]):
            continue
        squares += error[k] * error[k] / variance[k]
        log_variance += math.log(variance[k])
        oo += one[k] * one[k] / variance[k]
        oe += one[k] * error[k] / variance[k]
        n += 1
    if oo > 0:
        squares -= oe * oe / oo
        log_information += math.log(oo)
        parts += 1
    return squares, log_variance, log_information, n, parts


def relative_likelihood(data: Averages, space: StateSpace) -> tuple[float, float]:
    """Log likelihood maximized over a common scale of all amplitudes in `space`, nats, and that scale."""
    squares, log_variance, log_information, n, parts = _terms(data, space)
    if not squares > 0:
        return -math.inf, 0.0
    free = n - parts
    scale2 = squares / free
    value = -0.5 * (free * (math.log(2 * math.pi * scale2) + 1) + log_variance + log_information)
    return value, math.sqrt(scale2)


def scaled(model: Model | None, factor: float) -> Model | None:
    """`model` with its amplitude multiplied."""
    if model is None:
        return None
    if isinstance(model, RandomWalk):
        return RandomWalk(model.q * factor, model.initial_sigma)
    if isinstance(model, GaussMarkov):
        return GaussMarkov(model.sigma * factor, model.tau)
    return Autoregressive(model.coefficients, model.b0 * factor, model.interval)
