"""Score tests: which effect would explain the innovations, by how much, and what could be mistaken for it.

For a candidate with parameters theta, the derivatives of the innovations by theta (from runs of the filter) give a
score g and an information I, with the noise levels' share taken out: gain = g' I^-1 g, theta = I^-1 g, sigma from I^-1
(C. R. Rao, 1948). Where the rest of the model is wrong, too, neighbouring scores go together and the gain is too large;
so it is also computed with the variance that the scores show over blocks of time, and the smaller gain counts.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2, f

from ..effects.base import Effect
from ..evaluation.bootstrap import holm
from .residuals import Problem, Residual, Scores, Unknown, scores

#: family-wise error of one round of tests
SIGNIFICANCE = 0.01
#: an effect is not determined where its sigma is larger than this many times what is usual
DETERMINED = 1.0
#: length of a block over which scores may go together, s, and the fewest blocks that say anything
BLOCK = 20.0
FEWEST_BLOCKS = 8


@dataclass
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
        return self.fixed | {u.name.split('.')[1]: float(t) for u, t in zip(self.unknowns, self.theta)}


def effect_unknowns(effect: Effect, fixed: dict[str, float]) -> list[Unknown]:
    """One unknown for each parameter of `effect` that a diagnosis can vary, the `fixed` ones left where they are."""
    zero = {p.name: 0.0 for p in effect.traced} | fixed

    def varied(parameter):
        def apply(values, recording, x):
            # what is looked for in the innovations is the variance: a standard deviation of zero has no derivative
            change = float(np.sqrt(max(x, 0.0))) if parameter.variance else x
            if change == 0:
                return values, recording
            return effect.applied(values, recording, {**zero, parameter.name: change})
        return apply

    return [Unknown(f'{effect.name}.{p.name}', varied(p), 0.0, *_scale(p), p.variance, p.variance)
            for p in effect.traced if p.name not in fixed]


def _scale(parameter) -> tuple[float, float]:
    """Step and prior of an unknown."""
    size = parameter.prior_scale**2 if parameter.variance else parameter.prior_scale
    return 0.1 * size, 10 * size


def trace(problem: Problem, nuisance: Scores, at: Residual, effects: Sequence[Effect], mask: np.ndarray,
          progress: Callable[[], None] = lambda: None) -> list[Candidate]:
    """All candidates at the present model of `problem`, the best first; nuisance: scores of what is fitted already."""
    found = []
    for effect in effects:
        tried = []
        for fixed in effect.tried:
            unknowns = effect_unknowns(effect, fixed)
            _, own = scores(problem, unknowns, np.zeros(len(unknowns)), at)
            tried.append(_test(problem, effect, unknowns, own, nuisance, mask, fixed))
        best = max(tried, key=lambda c: c.gain)
        best.p = min(1.0, best.p * len(tried))
        found.append(best)
        progress()
    for candidate, p in zip(found, holm([c.p for c in found])):
        candidate.p_adjusted = float(p)
    return sorted(found, key=lambda c: (c.p, -c.gain))


def _test(problem, effect, unknowns, own: Scores, nuisance: Scores, mask, fixed) -> Candidate:
    own = _efficient(own, nuisance, mask)
    information = own.information(mask)
    prior = np.array([u.prior / 10 for u in unknowns])
    keep = _determined(information, prior)
    undetermined = [u.name.split('.')[1] for u, kept in zip(unknowns, keep) if not kept]
    unknowns = [u for u, kept in zip(unknowns, keep) if kept]
    own = Scores(own.score[:, keep], own.sensitivity[:, keep])
    if not unknowns:
        return Candidate(effect, [], np.zeros(0), np.zeros(0), 0.0, 1.0, None, undetermined, fixed)
    covariance = np.linalg.inv(information[np.ix_(keep, keep)])
    total = own.gradient(mask)
    theta, sigma = covariance @ total, np.sqrt(np.diag(covariance))
    gain, p = _significance(problem, own.score, total, covariance, mask)
    if unknowns[0].variance:  # only more variance is an effect
        gain, p = (gain, p / 2) if total[0] > 0 else (0.0, 1.0)
    return Candidate(effect, unknowns, theta, sigma, gain, p, own, undetermined, fixed)


def _efficient(own: Scores, nuisance: Scores, mask) -> Scores:
    """The scores of an effect's parameters with the share of the nuisance parameters taken out."""
    information = nuisance.information(mask)
    share = np.linalg.lstsq(information, nuisance.information(mask, own), rcond=1e-10)[0]
    return Scores(own.score - nuisance.score @ share,
                  own.sensitivity - np.einsum('fqi,qp->fpi', nuisance.sensitivity, share))


def _determined(information: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Which parameters the data determine: worst ones are left out until the others' sigma is below what is usual."""
    keep = np.ones(len(prior), dtype=bool)
    while keep.any():
        part = information[np.ix_(keep, keep)] + np.diag(1e-6 / prior[keep] ** 2)
        relative = np.sqrt(np.diag(np.linalg.inv(part))) / prior[keep]
        if relative.max() <= DETERMINED:
            break
        keep[np.flatnonzero(keep)[relative.argmax()]] = False
    return keep


def _significance(problem: Problem, score, total, covariance, mask) -> tuple[float, float]:
    """Gain and p: by the information, and by the variance of the scores over blocks; the more careful of the two."""
    size = len(total)
    gain = float(total @ covariance @ total)
    p = float(chi2.sf(gain, size))
    block = ((problem.stamp[mask] - problem.stamp[0]) // round(BLOCK * 1e9)).astype(np.int64)
    _, index = np.unique(block, return_inverse=True)
    sums = np.zeros((index.max() + 1, size))
    np.add.at(sums, index, score[mask])
    count = len(sums)
    if count < max(FEWEST_BLOCKS, 2 * size):
        return gain, p
    spread = sums.T @ sums
    robust = float(total @ np.linalg.solve(spread + 1e-12 * np.trace(spread) * np.eye(size), total))
    # the blocks' own sums contain the mean: Hotelling's statistic without it
    hotelling = robust / max(1 - robust / count, 1e-9)
    robust_p = float(f.sf(hotelling * (count - size) / (count * size), size, count - size))
    return min(gain, hotelling) if robust_p > p else gain, max(p, robust_p)


def group(winner: Candidate, others: Sequence[Candidate], mask: np.ndarray) -> list[str]:
    """Names of the candidates that the data cannot tell from `winner`, which comes first.

    With the other in the model, what the winner adds must be insignificant, or a tenth of what both explain.
    """
    names = [winner.name]
    for other in others:
        if other.name == winner.name or other.scores is None or other.p > SIGNIFICANCE:
            continue
        both = winner.scores.joined(other.scores)
        information, total = both.information(mask), both.gradient(mask)
        k = len(winner.theta)
        joint, alone = _gain(total, information), _gain(total[k:], information[k:, k:])
        if joint - alone < chi2.ppf(0.999, k) or joint - alone < 0.1 * joint:
            names.append(other.name)
    return names


def _gain(total, information) -> float:
    scale = np.sqrt(np.diag(information))
    return float(total / scale @ np.linalg.lstsq(information / np.outer(scale, scale), total / scale, rcond=1e-8)[0])
