"""Do several drives agree on an effect? One that only some of the drives have is not a property of the vehicle."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .drives import Drives, select_fixes
from .estimate import PLAIN, Estimate
from .fit import FittedModel
from .problem import blocks
from .tracing import Candidate, significance

#: twice the log likelihood by which one part of the data prefers no effect to that of the other part, above which the
#: two contradict each other
AGAINST = 9.0


@dataclass(frozen=True)
class _Side:
    """Estimates from a part of the data: unknowns (p,), the inverse of their covariance (p, p), and sigma (p,)."""

    x: np.ndarray
    weight: np.ndarray
    sigma: np.ndarray

    def against(self, other: np.ndarray) -> float:
        """Twice the log likelihood ratio of no effect to the effect `other` (p,)."""
        away = other - self.x
        return float(away @ self.weight @ away - self.x @ self.weight @ self.x)

    @property
    def plain(self) -> bool:
        return float(self.x @ self.weight @ self.x) > PLAIN**2


def by_drive(model: FittedModel, noise: int, chosen) -> dict[str, dict[str, Estimate]]:
    """Estimates of the unknowns `chosen` (indices) from each of several drives, by the name of the drive and of the
    parameter, without unit; empty for one drive. All unknowns but the noise levels are estimated.
    """
    drives = model.problem.each
    if len(drives) < 2:
        return {}
    found = {}
    for drive, mask in zip(drives, _masks(model)):
        side = _side(model, mask, noise, chosen)
        found[drive.recording.name] = {
            model.unknowns[i].parameter: Estimate(*model.unknowns[i].meant(float(x), float(s)), '-')
            for i, x, s in zip(chosen, side.x, side.sigma)}
    return found


def contradicted(model: FittedModel, noise: int, chosen) -> bool:
    """Whether a drive contradicts all others, or these the drive: no effect is clearly more likely than the estimate of
    `chosen` from the other side."""
    if len(model.problem.each) < 2 or not len(chosen):
        return False
    for mask in _masks(model):
        one, rest = (_side(model, m, noise, chosen) for m in (mask, model.problem.mask & ~mask))
        if rest.plain and one.against(rest.x) > AGAINST or one.plain and rest.against(one.x) > AGAINST:
            return True
    return False


def plainest_in_one(candidates: Sequence[Candidate], problem: Drives) -> tuple[Candidate, float] | None:
    """The candidate with the smallest p value in a single drive, and that p value, corrected for the number of drives
    and candidates. An effect that only one drive has scatters over blocks, so it is less significant in all together.
    """
    tests = [(candidate, p) for candidate in candidates if candidate.scores is not None
             for p in _in_each(candidate, problem)]
    if not tests:
        return None
    candidate, p = min(tests, key=lambda test: test[1])
    return candidate, min(1.0, p * len(tests))


def _in_each(candidate: Candidate, problem: Drives) -> list[float]:
    """P value of a candidate in each of several drives."""
    found = []
    usual = np.array([u.usual for u in candidate.unknowns])
    for drive, where in zip(problem.each, problem.slices) if len(problem.each) > 1 else ():
        own = select_fixes(candidate.scores, where)
        information, total = own.information(drive.mask), own.gradient(drive.mask)
        theta = np.linalg.solve(information + np.diag(1e-6 / usual**2), total)
        found.append(significance(drive, own, theta, total)[1])
    return found


def _masks(model: FittedModel) -> list[np.ndarray]:
    drives = model.problem.each
    return [np.concatenate([p.mask & (p is drive) for p in drives]) for drive in drives]


def _side(model: FittedModel, mask: np.ndarray, noise: int, chosen) -> _Side:
    """Estimates from the fixes of `mask`; their covariance is from the information or, if larger, from the scatter of
    the scores of blocks."""
    x, covariance = model.refitted(mask, noise)
    chosen, counted = np.asarray(chosen), mask[model.problem.mask]
    score = np.where(counted[:, None], model.scores.score[model.problem.mask], 0.0)
    seen = np.where(counted[:, None, None], model.scores.sensitivity[model.problem.mask], 0.0)
    products = np.einsum('fpi,fqi->fpq', seen, seen)
    moved = np.where(np.arange(len(x)) < noise, 0.0, x - model.x)
    weight, excess = np.linalg.inv(covariance[np.ix_(chosen, chosen)]), 1.0
    for begins in blocks(model.problem):
        # without the part of the estimate itself
        sums = np.add.reduceat(score, begins) - np.add.reduceat(products, begins) @ moved
        spread = (covariance @ (sums.T @ sums) @ covariance)[np.ix_(chosen, chosen)]
        excess = max(excess, float(np.trace(weight @ spread)) / len(chosen))
    return _Side(x[chosen], weight / excess, np.sqrt(excess * np.diag(covariance)[chosen]))


def drives_text(drives: Mapping[str, Mapping[str, Estimate]]) -> str:
    """The estimates from each drive as text."""
    return '; '.join(f'{name}: ' + ', '.join(f'{p} {e.text()}' for p, e in found.items())
                     for name, found in drives.items())
