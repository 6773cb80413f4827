"""Cross-validation: the likelihood of each part of the data with the estimates from the other parts.

The filter always runs through whole recordings. An estimate uses the innovations of all parts but one, and its
likelihood is that of the innovations in this one.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from .drives import Drives
from .fit import FittedModel
from .folds import SHORTEST_BLOCK, part_masks
from .problem import Problem
from .residuals import Residual

#: largest p value of a held-out gain that is above CLEAR; a smaller gain needs a p value below CERTAIN
HELD_OUT_P = 0.2
#: gain of log likelihood, five sigma. On real cars there are always small model errors, from which an effect with many
#: parameters gains a little
CLEAR = 12.5
#: confidence level at which the new unknowns must differ from zero in the data without one part, to count as supported
SUPPORT = 0.95
#: share of the parts without which the data must support an effect: else it depends on single parts of the recording
MOST = 0.5
CERTAIN = 0.01  # p value below which a gain, or a change of an error, is called certain


@dataclass(frozen=True)
class HeldOut:
    """Gain of log likelihood on held-out fixes: the sum, and the p value of no gain from blocks of time.

    estimates: the unknowns, for each part that is held out. drives: gain and p value of no loss, by the name of each of
    several drives. supported: share of the parts without which the data support the new unknowns.
    """

    gain: float
    p: float
    estimates: list[np.ndarray]
    drives: dict[str, tuple[float, float]] = field(default_factory=dict)
    supported: float = 1.0

    @property
    def stands(self) -> bool:
        """Whether the data support it without most of the parts."""
        return self.supported > MOST

    @property
    def helps(self) -> bool:
        return self.stands and self.gain > 0 and (self.p < CERTAIN or self.gain > CLEAR and self.p < HELD_OUT_P)


def held_out(longer: FittedModel, shorter: FittedModel, noise: int, support: float = SUPPORT) -> HeldOut:
    """The gain of `longer` over `shorter` on data that neither was fitted to.

    The first `noise` unknowns of both are noise levels; they are not fitted again. The gain is that of the whole
    procedure: if the other parts do not support the new unknowns of `longer` at the level `support`, the procedure
    would not have added them, and the estimate is that of `shorter`.
    """
    problem = longer.problem
    place = {u.name: i for i, u in enumerate(longer.unknowns)}
    old = [place[u.name] for u in shorter.unknowns]
    new = sorted(set(place.values()) - set(old))
    found, without, supported = [], [], 0
    for part in part_masks(problem):
        mask = problem.mask & ~part
        x, covariance = longer.refitted(mask, noise)
        without.append(shorter.refitted(mask, noise)[0])
        if x[new] @ np.linalg.solve(covariance[np.ix_(new, new)], x[new]) < chi2.ppf(support, len(new)):
            x[old], x[new] = without[-1], 0.0
        else:
            supported += 1
        found.append(x)
    one, other = problem.residuals(longer.unknowns, found), problem.residuals(shorter.unknowns, without)
    gains = np.zeros(len(problem.stamp))
    for part, with_it, plain in zip(part_masks(problem), one, other):
        # a fix without an innovation in one of them counts as no gain
        gains[part] = np.nan_to_num((with_it.log_likelihood() - plain.log_likelihood())[part])
    return replace(_of_gains(problem, gains, found), supported=supported / len(found))


def gain_of(problem: Problem, before: Residual, after: Residual) -> HeldOut:
    """The gain of a model without new unknowns: nothing was fitted, so all data are held out. Only innovations of fixes
    count, as another mechanization has other residuals besides."""
    return _without_fit(problem, before.of_fixes, after.of_fixes)


def certainly_better(one: FittedModel, other: FittedModel, gain: float) -> bool:
    """Whether `one` explains the same data better than `other` does, by more than `gain` in log likelihood and for
    certain: the difference is tested by its scatter over blocks of time (Q. H. Vuong, 1989), as innovations that follow
    each other make its sum larger than it is worth."""
    found = _without_fit(one.problem, other.residual, one.residual)
    return found.gain > gain and found.p < CERTAIN


def _without_fit(problem: Problem, before: Residual, after: Residual) -> HeldOut:
    """The gain of one residual over another, by innovations of the same fixes."""
    gains = np.nan_to_num(after.log_likelihood() - before.log_likelihood())
    return _of_gains(problem, np.where(problem.mask, gains, 0.0), [])


def _of_gains(problem: Problem | Drives, gains: np.ndarray, estimates: list[np.ndarray]) -> HeldOut:
    drives, first = {}, 0
    for drive in problem.each if len(problem.each) > 1 else ():
        own = gains[first:first + len(drive.stamp)]
        drives[drive.recording.name] = float(own.sum()), _p_of_no_gain(drive, -own)
        first += len(drive.stamp)
    return HeldOut(float(gains.sum()), _p_of_no_gain(problem, gains), estimates, drives)


def _p_of_no_gain(problem: Problem | Drives, gains: np.ndarray) -> float:
    """P value of a one-sided t test on the sums of the gains over blocks of SHORTEST_BLOCK."""
    block = ((problem.stamp - problem.stamp[0]) // round(SHORTEST_BLOCK * 1e9))[problem.mask]
    _, index = np.unique(block, return_inverse=True)
    sums = np.bincount(index, gains[problem.mask])
    if len(sums) < 3 or sums.std() == 0:
        return 1.0
    return float(student.sf(sums.mean() / (sums.std(ddof=1) / np.sqrt(len(sums))), len(sums) - 1))
