"""Does it explain data that it was not fitted to? The likelihood of each part, with what the others say.

The filter always runs through whole recordings; an estimate uses the innovations of all parts but one and is judged on
that one.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from .drives import Drives
from .fit import Model
from .folds import SHORTEST_BLOCK, parts
from .problem import Problem
from .residuals import Residual

#: probability by chance, below which a held-out gain counts that is CLEAR; a smaller one counts where it is CERTAIN
SIGNIFICANCE = 0.2
#: gain of log likelihood (five sigma): in real cars something small is always wrong, by which an effect with many
#: parameters gains a little
CLEAR = 12.5
#: what is new is supported by a part of the data where it is no chance at this level
SUPPORT = 0.95
#: share of the parts that the rest of the data has to support it for: an effect that is not there without the one part
#: or the other is no better known than that
MOST = 0.5
#: a gain, or an error that has changed, is certain when chance would give it this rarely
CERTAIN = 0.01


@dataclass(frozen=True)
class HeldOut:
    """Gain of log likelihood on fixes that the estimate did not see: total, and p of no gain by blocks of time.

    estimates: the unknowns by the part that was held out. drives: gain and p of no loss, by the name of each of several
    drives. supported: the share of the parts for which the rest of the data supports what is new.
    """

    gain: float
    p: float
    estimates: list[np.ndarray]
    drives: dict[str, tuple[float, float]] = field(default_factory=dict)
    supported: float = 1.0

    @property
    def stands(self) -> bool:
        """Whether most of the data would have led to it."""
        return self.supported > MOST

    @property
    def helps(self) -> bool:
        return self.stands and self.gain > 0 and (self.p < CERTAIN or self.gain > CLEAR and self.p < SIGNIFICANCE)


def held_out(longer: Model, shorter: Model, noise: int) -> HeldOut:
    """What `longer` explains more than `shorter` on data that neither was fitted to.

    Of both, the first `noise` unknowns are noise levels and stay as they are. What is judged is the whole procedure:
    where the other parts do not support what is new in `longer`, they would not have led to it, and the estimate is
    that of `shorter`.
    """
    problem = longer.problem
    place = {u.name: i for i, u in enumerate(longer.unknowns)}
    old = [place[u.name] for u in shorter.unknowns]
    new = sorted(set(place.values()) - set(old))
    found, without, supported = [], [], 0
    for part in parts(problem):
        mask = problem.mask & ~part
        x, covariance = longer.refitted(mask, noise)
        without.append(shorter.refitted(mask, noise)[0])
        if x[new] @ np.linalg.solve(covariance[np.ix_(new, new)], x[new]) < chi2.ppf(SUPPORT, len(new)):
            x[old], x[new] = without[-1], 0.0
        else:
            supported += 1
        found.append(x)
    one, other = problem.residuals(longer.unknowns, found), problem.residuals(shorter.unknowns, without)
    gains = np.zeros(len(problem.stamp))
    for part, with_it, plain in zip(parts(problem), one, other):
        # a fix that one of them did not get to see says nothing
        gains[part] = np.nan_to_num((with_it.log_likelihood() - plain.log_likelihood())[part])
    return replace(_of_gains(problem, gains, found), supported=supported / len(found))


def gain_of(problem: Problem, before: Residual, after: Residual) -> HeldOut:
    """What a model without unknowns of its own gains: nothing of it was fitted, so all data are held out. Of the fixes,
    as another mechanization measures other things beside them."""
    one, other = after.of_fixes.log_likelihood(), before.of_fixes.log_likelihood()
    gains = np.where(problem.mask, np.nan_to_num(one - other), 0.0)
    return _of_gains(problem, gains, [])


def _of_gains(problem: Problem | Drives, gains: np.ndarray, estimates: list[np.ndarray]) -> HeldOut:
    drives, first = {}, 0
    for drive in problem.each if len(problem.each) > 1 else ():
        own = gains[first:first + len(drive.stamp)]
        drives[drive.recording.name] = float(own.sum()), _p_of_no_gain(drive, -own)
        first += len(drive.stamp)
    return HeldOut(float(gains.sum()), _p_of_no_gain(problem, gains), estimates, drives)


def _p_of_no_gain(problem: Problem | Drives, gains: np.ndarray) -> float:
    """One-sided t test of the sums over blocks of SHORTEST_BLOCK."""
    block = ((problem.stamp - problem.stamp[0]) // round(SHORTEST_BLOCK * 1e9))[problem.mask]
    _, index = np.unique(block, return_inverse=True)
    sums = np.bincount(index, gains[problem.mask])
    if len(sums) < 3 or sums.std() == 0:
        return 1.0
    return float(student.sf(sums.mean() / (sums.std(ddof=1) / np.sqrt(len(sums))), len(sums) - 1))
