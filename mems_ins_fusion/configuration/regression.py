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
#: smallest number of degrees of freedom: standard deviations are some hundred times as large then, so the estimate
#: counts as unknown
_LEAST_FREEDOM = 0.3


@dataclass(frozen=True)
class Fit:
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


def fit(design: np.ndarray, values: np.ndarray, prior: np.ndarray, block: np.ndarray) -> Fit:
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
    return Fit(design, values, weight, prior, block, solution, residual, covariance)


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


def weighted(values: np.ndarray, sigmas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of (k, ...) `values` weighted by their `sigmas`, and its standard deviation; larger where they contradict
    each other."""
    information = 1.0 / np.clip(sigmas, 1e-6, 1e3) ** 2  # what is not shown has an infinite sigma
    mean = (information * values).sum(axis=0) / information.sum(axis=0)
    contradiction = (information * (values - mean) ** 2).sum(axis=0) / max(len(values) - 1, 1)
    return mean, np.sqrt(np.maximum(contradiction, 1.0) / information.sum(axis=0))
