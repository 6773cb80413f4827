"""Score tests: which effect would explain the innovations, by how much, and what could be mistaken for it.

For a candidate with parameters theta, the derivatives of the innovations by theta (from runs of the filter) give a
score g and an information I, with the noise levels' share taken out: gain = g' I^-1 g, theta = I^-1 g, sigma from I^-1
(C. R. Rao, 1948). Where the rest of the model is wrong, too, neighbouring scores go together and the gain is too large;
so it is divided by what the scores of blocks of time scatter more than they should.
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

#: family-wise error of one round of tests
SIGNIFICANCE = 0.01
#: part of an effect's signal that another stands for when the two cannot be told apart
PARALLEL = 0.95
#: sigma of a parameter over its usual size, up to which it is determined
DETERMINED = 1.0
#: the same of a parameter whose value is larger than DISTINCT sigmas
TOLERATED = 5.0
#: sigmas
DISTINCT = 3.5


@dataclass(frozen=True)
class Candidate:
    """One effect under test: its unknowns that the data determine, what they come to, and how much they explain.

    fixed: parameters that were tried at some values, at the best of them. scores: noise levels' share taken out.
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
        """The effect's parameters as estimated, or as they were tried."""
        return self.fixed | {u.parameter: float(t) for u, t in zip(self.unknowns, self.theta)}


def effect_unknowns(effect: Effect, fixed: dict[str, float], attitude: Callable | None = None) -> list[Unknown]:
    """One unknown for each parameter of `effect` that a diagnosis can vary, the `fixed` ones left where they are.

    attitude: `Problem.attitude`, for the effects that need it.
    """
    zero = {p.name: 0.0 for p in effect.traced} | fixed

    def varied(parameter):
        def apply(values, recording, x):
            # what is looked for in the innovations is the variance: a standard deviation of zero has no derivative
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
    """Logarithms of factors on the parameters that were tried at `fixed`: once the effect is there, they show, too."""
    zero = {p.name: 0.0 for p in effect.traced} | fixed

    def varied(name):
        def apply(values, recording, x):
            return effect.applied(values, recording, {**zero, name: fixed[name] * float(np.exp(x))})
        return apply

    return [Unknown(f'{effect.name}.{name}', varied(name), 0.0, 0.1, 1.5, 0.5, factor_on=fixed[name])
            for name in effect.refined if name in fixed]


def also_determined(problem: Problem, unknowns: Sequence[Unknown], nuisance: Scores, at: Residual,
                    mask: np.ndarray) -> list[Unknown]:
    """Those of `unknowns`, none of them in the model yet, that the data determine at the present one."""
    if not unknowns:
        return []
    _, own = scores(problem, unknowns, np.zeros(len(unknowns)), at)
    own = efficient(own, nuisance, mask)
    keep = _determined(own.information(mask), own.gradient(mask), unknowns)
    return [u for u, kept in zip(unknowns, keep) if kept]


def trace(problem: Problem, nuisance: Scores, at: Residual, effects: Sequence[Effect], mask: np.ndarray,
          progress: Callable[[], None] = lambda: None) -> list[Candidate]:
    """All candidates at the present model of `problem`, the best first; nuisance: scores of what is fitted already."""
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
    """The scores of an effect's parameters with the share of the nuisance parameters taken out."""
    information = nuisance.information(mask)
    share = np.linalg.lstsq(information, nuisance.information(mask, own), rcond=1e-10)[0]
    return Scores(own.score - nuisance.score @ share,
                  own.sensitivity - np.einsum('fqi,qp->fpi', nuisance.sensitivity, share))


def _determined(information: np.ndarray, total: np.ndarray, unknowns: Sequence[Unknown]) -> np.ndarray:
    """Which unknowns the data determine: the worst ones are left out until the others are."""
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
    """Which of `unknowns` are determined: a rather large sigma does not speak against a value many times larger."""
    usual = np.array([u.usual for u in unknowns])
    return (sigma <= DETERMINED * usual) | ((sigma <= TOLERATED * usual) & (np.abs(theta) > DISTINCT * sigma))


def significance(problem: Problem, own: Scores, theta, total) -> tuple[float, float]:
    """Gain and p, both with what the scores of blocks of time scatter more than the information says.

    What the effect itself adds to a block is taken out first: a few blocks may hold all that the recording knows.
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
    """Names of the candidates that the data cannot tell from `winner`, which comes first.

    With the other in the model, what the winner adds must be insignificant, or a tenth of what both explain; or the
    sensitivities are nearly parallel: the other can stand for PARALLEL of what the winner does to the innovations.
    """
    names = [winner.name]
    for other in others:
        if other.name == winner.name or other.scores is None or other.p > SIGNIFICANCE:
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
