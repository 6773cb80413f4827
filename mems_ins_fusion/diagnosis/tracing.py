"""Score tests: which effect explains the innovations, by how much, and which other effects cannot be told from it.

For a candidate with parameters theta, the derivatives of the innovations with respect to theta (from runs of the
filter) give a score g and an information I, both with the noise levels as nuisance parameters: gain = g' I^-1 g,
theta = I^-1 g, sigma from I^-1 (C. R. Rao, 1948). If the rest of the model is wrong, neighbouring scores are correlated
and the gain is too large. It is divided by the ratio of the actual scatter of scores, over blocks of time, and the
expected one.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2

from ..effects.base import Effect
from ..evaluation.intervals import holm
from .fit import Scores, scores
from .problem import Problem, Unknown, blocks
from .residuals import Residual

FAMILY_ERROR_RATE = 0.01  # largest family-wise error rate of the tests in one round
#: share of the signal of one effect that another effect explains, above which the two are not distinguished
PARALLEL = 0.95
DETERMINED = 1.0  # largest sigma of a parameter that is determined, in units of its usual size
TOLERATED = 5.0  # the same limit if the value is larger than DISTINCT sigmas
DISTINCT = 3.5  # number of sigmas, see TOLERATED


@dataclass(frozen=True)
class Candidate:
    """Result of the score test of one effect: its unknowns that the data determine, with estimates theta and sigma, the
    gain of log likelihood (times two), and p values.

    fixed: parameters that are tested at a few values only, at the best of these. scores: without the part that noise
    levels explain; None if nothing is determined.
    """

    effect: Effect
    unknowns: list[Unknown]
    theta: np.ndarray
    sigma: np.ndarray
    gain: float
    p: float
    scores: Scores | None
    undetermined: list[str]
    fixed: dict[str, float] = field(default_factory=dict)
    p_adjusted: float = 1.0

    @property
    def name(self) -> str:
        return self.effect.name

    def values(self) -> dict[str, float]:
        """The parameters of the effect: estimated, or fixed."""
        return self.fixed | {u.parameter: float(t) for u, t in zip(self.unknowns, self.theta)}


def effect_unknowns(effect: Effect, fixed: dict[str, float], attitude: Callable | None = None) -> list[Unknown]:
    """One unknown for each parameter of `effect` that can be estimated; those in `fixed` keep these values.

    attitude: `Problem.attitude`, for the effects that need it.
    """
    zero = {p.name: 0.0 for p in effect.traced} | fixed

    def varied(parameter):
        def apply(values, recording, x):
            # the unknown is the variance: at zero, innovations have no derivative by a standard deviation
            change = float(np.sqrt(max(x, 0.0))) if parameter.variance else x
            if change == 0:
                return values, recording
            return effect.applied(values, recording, {**zero, parameter.name: change}, attitude)
        return apply

    def unknown(p):
        size = p.prior_scale**2 if p.variance else p.prior_scale
        step = p.step or 0.1 * size
        return Unknown(f'{effect.name}.{p.name}', varied(p), 0.0, step, 10 * size, size, p.variance, p.variance)

    return [unknown(p) for p in effect.traced if p.name not in fixed]


def refined_unknowns(effect: Effect, fixed: dict[str, float]) -> list[Unknown]:
    """Unknowns for the parameters in `fixed`, as logarithms of factors: they can be estimated once the effect is in the
    model."""
    zero = {p.name: 0.0 for p in effect.traced} | fixed

    def varied(name):
        def apply(values, recording, x):
            return effect.applied(values, recording, {**zero, name: fixed[name] * float(np.exp(x))})
        return apply

    return [Unknown(f'{effect.name}.{name}', varied(name), 0.0, 0.1, 1.5, 0.5, factor_on=fixed[name])
            for name in effect.refined if name in fixed]


def also_determined(problem: Problem, unknowns: Sequence[Unknown], nuisance: Scores, at: Residual,
                    mask: np.ndarray) -> list[Unknown]:
    """Those of `unknowns` that the data determine beside the present model, which does not contain them."""
    if not unknowns:
        return []
    _, own = scores(problem, unknowns, np.zeros(len(unknowns)), at)
    own = efficient(own, nuisance, mask)
    keep = _determined(own.information(mask), own.gradient(mask), unknowns)
    return [u for u, kept in zip(unknowns, keep) if kept]


def trace(problem: Problem, nuisance: Scores, at: Residual, effects: Sequence[Effect], mask: np.ndarray,
          progress: Callable[[], None] = lambda: None) -> list[Candidate]:
    """Score tests of all `effects` beside the present model of `problem`, the best first. nuisance: scores of the
    unknowns that are fitted already."""
    found = []
    for effect in effects:
        tried = []
        for fixed in effect.tried:
            unknowns = effect_unknowns(effect, fixed, problem.attitude)
            _, own = scores(problem, unknowns, np.zeros(len(unknowns)), at, quick=True)
            tried.append(_test(problem, effect, unknowns, own, nuisance, mask, fixed))
        best = max(tried, key=lambda c: c.gain)
        found.append(replace(best, p=min(1.0, best.p * len(tried))))
        progress()
    found = [replace(c, p_adjusted=float(p)) for c, p in zip(found, holm([c.p for c in found]))]
    return sorted(found, key=lambda c: (c.p, -c.gain))


def _test(problem, effect, unknowns, own: Scores, nuisance: Scores, mask, fixed) -> Candidate:
    own = efficient(own, nuisance, mask)
    information, total = own.information(mask), own.gradient(mask)
    keep = _determined(information, total, unknowns)
    undetermined = [u.parameter for u, kept in zip(unknowns, keep) if not kept]
    unknowns = [u for u, kept in zip(unknowns, keep) if kept]
    own = Scores(own.score[:, keep], own.sensitivity[:, keep])
    if not unknowns:
        return Candidate(effect, [], np.zeros(0), np.zeros(0), 0.0, 1.0, None, undetermined, fixed)
    covariance, total = np.linalg.inv(information[np.ix_(keep, keep)]), total[keep]
    theta, sigma = covariance @ total, np.sqrt(np.diag(covariance))
    gain, p = significance(problem, own, theta, total)
    if unknowns[0].variance:  # only more variance is an effect
        gain, p = (gain, p / 2) if total[0] > 0 else (0.0, 1.0)
    return Candidate(effect, unknowns, theta, sigma, gain, p, own, undetermined, fixed)


def efficient(own: Scores, nuisance: Scores, mask) -> Scores:
    """The efficient scores of the parameters of an effect: without the part that the nuisance parameters explain."""
    information = nuisance.information(mask)
    share = np.linalg.lstsq(information, nuisance.information(mask, own), rcond=1e-10)[0]
    return Scores(own.score - nuisance.score @ share,
                  own.sensitivity - np.einsum('fqi,qp->fpi', nuisance.sensitivity, share))


def _determined(information: np.ndarray, total: np.ndarray, unknowns: Sequence[Unknown]) -> np.ndarray:
    """(p,) bool: whether the data determine an unknown. The least determined one is left out until all others are."""
    usual = np.array([u.usual for u in unknowns])
    keep = np.ones(len(usual), dtype=bool)
    while keep.any():
        covariance = np.linalg.inv(information[np.ix_(keep, keep)] + np.diag(1e-6 / usual[keep] ** 2))
        theta, sigma = covariance @ total[keep], np.sqrt(np.diag(covariance))
        good = determined(theta, sigma, [u for u, k in zip(unknowns, keep) if k])
        if good.all():
            break
        keep[np.flatnonzero(keep)[np.where(good, 0.0, sigma / usual[keep]).argmax()]] = False
    return keep


def determined(theta: np.ndarray, sigma: np.ndarray, unknowns: Sequence[Unknown]) -> np.ndarray:
    """(p,) bool: whether an unknown is determined: its sigma is small, or not very large and the value many sigmas."""
    usual = np.array([u.usual for u in unknowns])
    return (sigma <= DETERMINED * usual) | ((sigma <= TOLERATED * usual) & (np.abs(theta) > DISTINCT * sigma))


def significance(problem: Problem, own: Scores, theta, total) -> tuple[float, float]:
    """Gain and p value, both corrected for the scatter of the scores of blocks of time beyond the expected one.

    The part of the effect itself is subtracted first, as a few blocks may contain nearly all of its information.
    """
    gain, excess, mask = float(theta @ total), 1.0, problem.mask
    sensitivity, score = own.sensitivity[mask], own.score[mask]
    products = np.einsum('fpi,fqi->fpq', sensitivity, sensitivity)
    for begins in blocks(problem):
        information = np.add.reduceat(products, begins)
        rest = np.add.reduceat(score, begins) - information @ theta
        scatter = np.einsum('bp,bq->pq', rest, rest)
        excess = max(excess, float(np.trace(np.linalg.solve(information.sum(axis=0), scatter))) / len(theta))
    return gain / excess, float(chi2.sf(gain / excess, len(theta)))


def group(winner: Candidate, others: Sequence[Candidate], mask: np.ndarray) -> list[str]:
    """Names of the candidates that the data do not distinguish from `winner`, which comes first.

    These are candidates beside which the winner adds no significant gain, or less than a tenth of the gain of both; or
    which explain PARALLEL of what the winner does to the innovations, as their sensitivities are nearly parallel.
    """
    names = [winner.name]
    for other in others:
        if other.name == winner.name or other.scores is None or other.p > FAMILY_ERROR_RATE:
            continue
        both = winner.scores.joined(other.scores)
        information, total = both.information(mask), both.gradient(mask)
        k = len(winner.theta)
        joint, alone = _gain(total, information), _gain(total[k:], information[k:, k:])
        cross = information[k:, :k] @ winner.theta
        represented = cross @ np.linalg.lstsq(information[k:, k:], cross, rcond=1e-8)[0]
        parallel = represented > PARALLEL * (winner.theta @ information[:k, :k] @ winner.theta)
        if parallel or joint - alone < chi2.ppf(0.999, k) or joint - alone < 0.1 * joint:
            names.append(other.name)
    return names


def _gain(total, information) -> float:
    scale = np.sqrt(np.diag(information))
    return float(total / scale @ np.linalg.lstsq(information / np.outer(scale, scale), total / scale, rcond=1e-8)[0])
