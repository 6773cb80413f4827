"""Robust least squares, with standard deviations that are right for errors that last for a long time, too."""
from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

#: robust standard deviations beyond which a residual has less weight (Huber)
HUBER = 2.5
#: iterations of reweighted least squares
_ITERATIONS = 8
#: smallest weight of a row that is used for the noise
_LEAST_WEIGHT = 0.3
#: number of blocks into which a recording is divided for the jackknife
BLOCKS = 20
#: s, shortest block
_BLOCK = 10.0
#: smallest number of blocks for a standard deviation
_FEWEST_BLOCKS = 4
#: probability of a normal distribution below two standard deviations
_TWO_SIGMA = 0.97725
#: degrees of freedom as which the variance by a model counts beside the jackknife's: over drives the jackknife scatters
#: about the model as by chance (docs/configure.md); a model whose variance is off by a factor of 1.5 (one sigma) would
#: have shown
MODEL_FREEDOM = 12.0
#: smallest number of degrees of freedom: standard deviations are some hundred times as large then, so the estimate
#: counts as unknown
_LEAST_FREEDOM = 0.3


@dataclass(frozen=True)
class RegressionFit:
    """values = design @ solution. design: (n, k). values, residual: (n, c). weight: (n,). prior, block: as given.
    solution: (k, c). covariance: (c, c) of the residual, without outliers."""

    design: np.ndarray
    values: np.ndarray
    weight: np.ndarray
    prior: np.ndarray
    block: np.ndarray
    solution: np.ndarray
    residual: np.ndarray
    covariance: np.ndarray

    @cached_property
    def left_out(self) -> np.ndarray:
        """(b, k, c) solutions, each without one block."""
        weighted = self.design * self.weight[:, None]
        normal, right = _normal(weighted, self.design, self.values, self.prior)
        solutions = []
        for number in np.unique(self.block):
            rows = self.block == number
            solutions.append(_solve(normal - weighted[rows].T @ self.design[rows],
                                    right - weighted[rows].T @ self.values[rows]))
        return np.array(solutions)

    def shown(self, index: int) -> np.ndarray:
        """(b,) information of each block about row `index` of the solution: weighted sum of squares of its column."""
        return np.bincount(self.block, self.weight * self.design[:, index] ** 2)[np.unique(self.block)]


def blocks(time: np.ndarray) -> np.ndarray:
    """Number of the block of the recording to which each of `time`, s, ascending, belongs."""
    length = max((time[-1] - time[0]) / BLOCKS, _BLOCK)
    return np.minimum((time - time[0]) / length, BLOCKS - 1).astype(int)


def fit(design: np.ndarray, values: np.ndarray, prior: np.ndarray, block: np.ndarray) -> RegressionFit:
    """Robust least squares of (n, c) `values` on (n, k) `design`.

    prior: (k,) standard deviations of the solution about zero, in units of a row's noise. block: (n,) number of the
    block of each row; errors in different blocks are independent.
    """
    weight, typical = np.ones(len(design)), math.sqrt(values.shape[1])
    for _ in range(_ITERATIONS):
        solution = _solve(*_normal(design * weight[:, None], design, values, prior))
        residual = values - design @ solution
        covariance = np.atleast_2d(np.cov(residual[weight > _LEAST_WEIGHT].T)) + 1e-9 * np.eye(values.shape[1])
        size = np.sqrt(np.einsum('ni,ij,nj->n', residual, np.linalg.inv(covariance), residual))
        size *= typical / max(np.median(size), 1e-9)
        weight = np.minimum(1.0, HUBER * typical / np.maximum(size, 1e-9)) ** 2
    return RegressionFit(design, values, weight, prior, block, solution, residual, covariance)


def _normal(weighted, design, values, prior):
    return weighted.T @ design + np.diag(1.0 / prior**2), weighted.T @ values


def _solve(normal, right):
    return np.linalg.lstsq(normal, right, rcond=None)[0]


def shares(count: int) -> np.ndarray:
    """(count,) int: in which of BLOCKS parts of as many values each of `count` values in a row is, from 0 on."""
    return (BLOCKS * np.arange(count)) // count


def jackknife(values: np.ndarray, shown: np.ndarray | None = None) -> np.ndarray:
    """Standard deviation of an estimate from its values (b, ...), each with one of b blocks left out.

    With few blocks their scatter is not well known: the result is scaled such that two standard deviations have the
    probability of two of a normal distribution, by Student's distribution with b - 1 degrees of freedom.
    shown: (b,) information of each block about the estimate. If most of it is in two of twenty blocks (two changes of
    speed in a drive), their agreement may be chance; then b is the effective number of blocks (L. Kish, "Survey
    Sampling", 1965).
    Source: Efron and Tibshirani, "An Introduction to the Bootstrap", section 11.2.
    """
    count = len(values)
    if count < _FEWEST_BLOCKS:
        return np.full(values.shape[1:], math.inf)
    effective = count if shown is None else shown.sum() ** 2 / max((shown**2).sum(), np.finfo(float).tiny)
    spread = ((values - values.mean(axis=0)) ** 2).sum(axis=0)
    widened = float(stdtrit(max(effective - 1.0, _LEAST_FREEDOM), _TWO_SIGMA)) / 2.0
    return widened * np.sqrt((count - 1) / count * spread)


def moderated(left_out: np.ndarray, each: np.ndarray, prior: np.ndarray, noise: float) -> np.ndarray:
    """Standard deviations (k,) of a least squares estimate: by its model, corrected by what the jackknife shows.

    left_out: (b, k) estimates, each without one of the blocks. each: (b, k, k) information of the blocks, for a noise
    variance of 1. prior: (k,) that of the prior. noise: the variance, as the residuals show it.

    What one turn in a drive tells of an antenna is in one or two blocks. The jackknife of these scatters by a factor of
    three with nothing but the noise, and is too large in the mean, as a turn is missed where it is left out. Both are
    known: by the model each block's score has the covariance of its information, so that the jackknife's variance is
    a quadratic form of normal variables with this expectation and so many degrees of freedom (Satterthwaite). Its
    realised over expected value corrects the model's variance as that many degrees of freedom beside MODEL_FREEDOM.
    What comes from the prior is not corrected. Widened by Student's distribution as `jackknife`.
    Source: G. K. Smyth, "Linear models and empirical Bayes methods for assessing differential expression", Statistical
    Applications in Genetics and Molecular Biology 3 (2004), for the moderated variance.
    """
    count, total = len(each), each.sum(axis=0)
    inverse = np.linalg.inv(total + np.diag(prior))
    by_data = np.diag(inverse @ total @ inverse)
    without = np.linalg.inv(total - each + np.diag(prior))
    changed = without @ each  # of the solution without block i, by what the scores have in common
    covariance = np.einsum('ika,ab,jkb->kij', changed, inverse @ total @ inverse - 2.0 * inverse, changed)
    blocks_alone = np.arange(count)
    covariance[:, blocks_alone, blocks_alone] += np.einsum('ika,ika->ki', changed, without)
    about_mean = np.eye(count) - 1.0 / count
    form = about_mean @ covariance @ about_mean
    tiny = np.finfo(float).tiny  # nothing is told of an unknown that no piece shows
    trace = np.maximum(np.trace(form, axis1=1, axis2=2), tiny)
    freedom = trace**2 / np.maximum((form**2).sum(axis=(1, 2)), tiny)
    spread = ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)
    corrected = (MODEL_FREEDOM * noise + freedom * spread / trace) / (MODEL_FREEDOM + freedom)
    widened = stdtrit(MODEL_FREEDOM + freedom, _TWO_SIGMA) / 2.0
    return np.sqrt((np.diag(inverse) - by_data) * noise + by_data * corrected * widened**2)


def weighted(values: np.ndarray, sigmas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of (k, ...) `values` weighted by their `sigmas`, and its standard deviation; larger where they contradict
    each other."""
    information = 1.0 / np.clip(sigmas, 1e-6, 1e3) ** 2  # what is not shown has an infinite sigma
    mean = (information * values).sum(axis=0) / information.sum(axis=0)
    contradiction = (information * (values - mean) ** 2).sum(axis=0) / max(len(values) - 1, 1)
    return mean, np.sqrt(np.maximum(contradiction, 1.0) / information.sum(axis=0))
