"""The maximum of the likelihood over what is assumed, its scores and its information.

Derivatives are differences between runs of the filter; with them score and Fisher information follow (F. C. Schweppe,
"Evaluation of likelihood functions for Gaussian signals", 1965; R. K. Mehra, "On the identification of variances and
adaptive Kalman filtering", 1970).
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .clock import FIX_BLOCK
from .problem import Problem, Unknown, block_begins, blocks
from .residuals import TAIL, Residual, whiten, whiten_matrix

#: an innovation, or its slope, of more sigma is the filter's that has left the earth; its square is a number still
LARGEST = 1e100
#: a fit ends when a step gains less than this in log likelihood
ENOUGH_GAIN = 0.2
#: a model must let the filter see this part of the fixes
FEWEST_SEEN = 0.98
#: a standard deviation counts what goes together over such a part of a drive, too
LONGEST_PART = 8
#: ratio of the squares of the changes on both sides of a point, from which on an innovation jumps on one side: the
#: filter decides otherwise there (a standstill or none), and a difference across that is no derivative. Where it is
#: smooth the ratio is near 1, unless its slope is nearly zero; then either side is as good
JUMP = 10.0
#: standard deviations of an innovation, largest derivative of it by the logarithm of a noise level: a larger change is
#: a jump. The noise changes the weight of what has been measured before, so that e times of it moves a prediction by
#: about its own standard deviation
NOISE_SLOPE = 2.0


@dataclass(frozen=True)
class Scores:
    """Derivatives of the log likelihood by some unknowns, zero where a fix does not count.

    score (f, p): each fix's share of the gradient. sensitivity (f, p, 5): whitened derivatives of innovation and
    covariance, scaled so that their products are the Fisher information.
    """

    score: np.ndarray
    sensitivity: np.ndarray

    def gradient(self, mask: np.ndarray) -> np.ndarray:
        return self.score[mask].sum(axis=0)

    def information(self, mask: np.ndarray, other: Scores | None = None) -> np.ndarray:
        """Fisher information (p, p), or (p, q) with those of `other`."""
        other = other or self
        return np.einsum('fpi,fqi->pq', self.sensitivity[mask], other.sensitivity[mask])

    def joined(self, other: Scores) -> Scores:
        return Scores(np.concatenate([self.score, other.score], axis=1),
                      np.concatenate([self.sensitivity, other.sensitivity], axis=1))


def scores(problem: Problem, unknowns: Sequence[Unknown], x, at: Residual | None = None,
           quick: bool = False) -> tuple[Residual, Scores]:
    """Residual at `x` and the scores of `unknowns` there, by differences between runs of the filter.

    Central differences, or forward ones, as each unknown asks; quick: forward ones for all. Where the innovation of a
    fix jumps on one side of `x`, a central difference becomes that on the other side, and a forward one of a noise
    level zero; other forward differences contain the jump.
    """
    x = np.asarray(x, dtype=float)
    if quick:
        unknowns = [replace(u, one_sided=True) for u in unknowns]
    points = [] if at is not None else [x]
    for i, unknown in enumerate(unknowns):
        for sign in (1,) if unknown.one_sided else (1, -1):
            points.append(x + sign * unknown.step * (np.arange(len(x)) == i))
    found = problem.residuals(unknowns, points)
    if at is None:
        at, *found = found
    slopes = []
    for unknown in unknowns:
        plus = found.pop(0)
        slopes.append(_slopes(at, plus, at if unknown.one_sided else found.pop(0), unknown))
    return at, _scores(at, slopes, problem.mask)


def _slopes(at: Residual, plus: Residual, minus: Residual, unknown: Unknown) -> list[np.ndarray]:
    """Derivatives of z, s and beside by one unknown, from the residuals on both sides of `at`, or on one side and `at`
    itself. A fix counts with all its residuals, or with those of one side, as its innovation z jumps or not."""
    factors = at.factors()
    ahead, behind = ((_finite(whiten(factors, (other.z - at.z) / unknown.step)) ** 2).sum(axis=1)
                     for other in (plus, minus))
    jumps_ahead, jumps_behind = ahead > JUMP * behind, behind > JUMP * ahead
    if unknown.one_sided:
        jumps_ahead, jumps_behind = unknown.noise & (ahead > NOISE_SLOPE**2), np.zeros(len(ahead), dtype=bool)
    distance = np.where(jumps_ahead | jumps_behind | unknown.one_sided, unknown.step, 2 * unknown.step)

    def slope(name):
        middle, after, before = (getattr(one, name) for one in (at, plus, minus))
        shape = (-1, *(1,) * (middle.ndim - 1))
        jumps, jumped = jumps_ahead.reshape(shape), jumps_behind.reshape(shape)
        return (np.where(jumps, middle, after) - np.where(jumped, middle, before)) / distance.reshape(shape)
    return [slope(name) for name in ('z', 's', 'beside')]


def _finite(values: np.ndarray) -> np.ndarray:
    """`values`, zero where they are no numbers or so large that their squares are none: such an innovation says
    nothing of a slope."""
    return np.where(np.abs(values) < LARGEST, values, 0.0)


def _scores(at: Residual, slopes: Sequence[list[np.ndarray]], mask) -> Scores:
    """d log L = -tr(S^-1 dS) / 2 + z' S^-1 dS S^-1 z / 2 - dz' S^-1 z, with information tr(S^-1 dS S^-1 dS) / 2 +
    dz' S^-1 dz; slopes: by each unknown, those of z, s and beside."""
    factors, u = at.factors(), _finite(at.whitened())
    shifts = [_finite(whiten(factors, dz)) for dz, _, _ in slopes]
    shapes = [_finite(whiten_matrix(factors, ds)) for _, ds, _ in slopes]
    d, m = np.stack(shifts, axis=1), np.stack(shapes, axis=1)
    weight = TAIL**2 / np.maximum((u**2).sum(axis=1), TAIL**2)  # the slope of rho
    squares = np.stack([weight * u[:, 0] ** 2 - 1, 2 * weight * u[:, 0] * u[:, 1], weight * u[:, 1] ** 2 - 1], axis=1)
    score = 0.5 * np.einsum('fpi,fi->fp', m, squares) - weight[:, None] * np.einsum('fpi,fi->fp', d, u)
    sensitivity = np.sqrt(weight)[:, None, None] * np.concatenate([d, m * np.sqrt([0.5, 1.0, 0.5])], axis=2)
    more = _scores_beside(at, [change for *_, change in slopes])
    score, sensitivity = score + more.score, np.concatenate([sensitivity, more.sensitivity], axis=2)
    score[~mask], sensitivity[~mask] = 0.0, 0.0
    return Scores(score, sensitivity)


def _scores_beside(at: Residual, slopes: Sequence[np.ndarray]) -> Scores:
    """The same of the innovations that are numbers of their own."""
    z, s = at.beside[:, 0], at.beside[:, 1]
    u = _finite(z / np.sqrt(s))
    change = np.stack(slopes, axis=1)  # (f, p, 2, b)
    d, m = _finite(change[:, :, 0] / np.sqrt(s)[:, None]), _finite(change[:, :, 1] / s[:, None])
    weight = TAIL**2 / np.maximum(u**2, TAIL**2)
    score = (0.5 * m * (weight * u**2 - 1)[:, None] - d * (weight * u)[:, None]).sum(axis=2)
    weight = np.tile(np.sqrt(weight), 2)[:, None]
    return Scores(score, weight * np.concatenate([d, m * np.sqrt(0.5)], axis=2))


@dataclass(frozen=True)
class FittedModel:
    """What is assumed and how well it fits: unknowns at x with covariance (p, p), and residual and scores there."""

    problem: Problem
    unknowns: list[Unknown]
    x: np.ndarray
    covariance: np.ndarray
    residual: Residual
    scores: Scores

    def likelihood(self, mask: np.ndarray) -> float:
        return float(np.nansum(self.residual.log_likelihood()[mask]))

    def sigma(self) -> np.ndarray:
        """Standard deviations of x, (p,): by the information, or by how the scores of blocks scatter, what is larger.

        The latter holds where innovations follow each other, too (P. J. Huber, 1967; W. K. Newey, K. D. West, 1987).
        """
        variance, score = np.diag(self.covariance), self.scores.score[self.problem.mask]
        seconds = np.ptp(self.problem.stamp[self.problem.mask]) * 1e-9
        for begins in (*blocks(self.problem), block_begins(self.problem, max(seconds / LONGEST_PART, FIX_BLOCK))):
            sums = np.add.reduceat(score, begins)
            variance = np.maximum(variance, np.diag(self.covariance @ (sums.T @ sums) @ self.covariance))
        return np.sqrt(variance)

    def moved(self) -> Problem:
        """The problem with this model as what is assumed."""
        return self.problem.moved(self.unknowns, self.x)

    def refitted(self, mask: np.ndarray, kept: int) -> tuple[np.ndarray, np.ndarray]:
        """x from the fixes in `mask` alone, by one step of scoring, and its covariance.

        The first `kept` unknowns stay as they are; their rows and columns of the covariance are zero.
        """
        base, prior = priors(self.unknowns)
        gradient = self.scores.gradient(mask) - (self.x - base) / prior**2
        information = self.scores.information(mask) + np.diag(1 / prior**2)
        free = slice(kept, None)
        x, covariance = self.x.copy(), np.zeros_like(information)
        covariance[free, free] = np.linalg.inv(information[free, free])
        x[free] += np.clip(covariance[free, free] @ gradient[free], -prior[free], prior[free])
        # one step tells no more of what is a size
        low, high = np.array([u.near(at) for u, at in zip(self.unknowns, self.x)]).T
        return np.clip(x, low, high), covariance


def priors(unknowns: Sequence[Unknown]) -> tuple[np.ndarray, np.ndarray]:
    return np.array([u.base for u in unknowns]), np.array([u.prior for u in unknowns])


def fitted_further(model: FittedModel, iterations: int = 8) -> FittedModel:
    """`model` fitted further."""
    return fit(model.problem, model.unknowns, model.x, iterations, model)


def fit(problem: Problem, unknowns: Sequence[Unknown], x, iterations: int = 8,
        begun: FittedModel | None = None) -> FittedModel:
    """The maximum of the likelihood.

    Fisher's scoring with Levenberg's damping; each unknown has a weak Gaussian prior about its base. begun: a model
    that was fitted at `x` already.
    """
    base, prior = priors(unknowns)
    bounds = np.reshape([u.bounds for u in unknowns], (-1, 2)).T
    x, mask = np.clip(np.asarray(x, dtype=float), *bounds), problem.mask
    at, found = (begun.residual, begun.scores) if begun else scores(problem, unknowns, x)
    value, damping = objective_of(at, mask, x, base, prior), 1e-3
    for _ in range(iterations):
        gradient = found.gradient(mask) - (x - base) / prior**2
        information = found.information(mask) + np.diag(1 / prior**2)
        moved = False
        for _ in range(5):
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            step = np.clip(x + np.clip(step, -prior, prior), *bounds) - x
            [trial] = problem.residuals(unknowns, [x + step])
            better = objective_of(trial, mask, x + step, base, prior)
            if better > value:
                moved, gain = True, better - value
                x, value, damping = x + step, better, max(damping / 10, 1e-6)
                at, found = scores(problem, unknowns, x, trial)
                break
            damping = max(10 * damping, 1e-2)
        if not moved or gain < ENOUGH_GAIN:
            break
    return FittedModel(problem, list(unknowns), x, np.linalg.inv(found.information(mask) + np.diag(1 / prior**2)), at,
                       found)


def objective_of(residual: Residual, mask, x, base, prior) -> float:
    likelihood = residual.log_likelihood()[mask]
    seen = np.isfinite(likelihood)
    if seen.mean() < FEWEST_SEEN:
        return -np.inf
    likelihood = np.where(seen, likelihood, likelihood[seen].min())
    return float(likelihood.sum() - 0.5 * (((x - base) / prior) ** 2).sum())
