"""Do several drives agree on an effect? What one drive has and another has not is not the vehicle's."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .drives import Drives, part
from .estimate import PLAIN, Estimate
from .fit import Model
from .problem import blocks
from .tracing import Candidate, significance

#: a drive, or all others, would rather have no effect than that of the other side: twice the log likelihood
AGAINST = 9.0


@dataclass(frozen=True)
class _Side:
    """What a part of the data says alone: unknowns (p,), the inverse of their covariance (p, p), and sigma (p,)."""

    x: np.ndarray
    weight: np.ndarray
    sigma: np.ndarray

    def against(self, other: np.ndarray) -> float:
        """How much rather it has none than `other` (p,), twice the log likelihood."""
        away = other - self.x
        return float(away @ self.weight @ away - self.x @ self.weight @ self.x)

    @property
    def plain(self) -> bool:
        return float(self.x @ self.weight @ self.x) > PLAIN**2


def by_drive(model: Model, noise: int, chosen) -> dict[str, dict[str, Estimate]]:
    """What each of several drives says of the unknowns `chosen` (indices), with all that is no noise level free.

    By name of the drive and parameter; without unit. Nothing where there is one drive.
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


def contradicted(model: Model, noise: int, chosen) -> bool:
    """Whether a drive, or the others without it, would rather have none of `chosen` than what the other side says."""
    if len(model.problem.each) < 2 or not len(chosen):
        return False
    for mask in _masks(model):
        one, rest = (_side(model, m, noise, chosen) for m in (mask, model.problem.mask & ~mask))
        if rest.plain and one.against(rest.x) > AGAINST or one.plain and rest.against(one.x) > AGAINST:
            return True
    return False


def plainest_in_one(candidates: Sequence[Candidate], problem: Drives) -> tuple[Candidate, float] | None:
    """The candidate that one of several drives shows most plainly, and p with all drives and candidates counted.

    What one drive has and another has not scatters from block to block, so that all together show it the less.
    """
    tests = [(candidate, p) for candidate in candidates if candidate.scores is not None
             for p in _in_each(candidate, problem)]
    if not tests:
        return None
    candidate, p = min(tests, key=lambda test: test[1])
    return candidate, min(1.0, p * len(tests))


def _in_each(candidate: Candidate, problem: Drives) -> list[float]:
    """p of a candidate in each of several drives."""
    found = []
    usual = np.array([u.usual for u in candidate.unknowns])
    for drive, where in zip(problem.each, problem.slices) if len(problem.each) > 1 else ():
        own = part(candidate.scores, where)
        information, total = own.information(drive.mask), own.gradient(drive.mask)
        theta = np.linalg.solve(information + np.diag(1e-6 / usual**2), total)
        found.append(significance(drive, own, theta, total)[1])
    return found


def _masks(model: Model) -> list[np.ndarray]:
    drives = model.problem.each
    return [np.concatenate([p.mask & (p is drive) for p in drives]) for drive in drives]


def _side(model: Model, mask: np.ndarray, noise: int, chosen) -> _Side:
    """By the information, or by how the scores of blocks scatter, what says less."""
    x, covariance = model.refitted(mask, noise)
    chosen, counted = np.asarray(chosen), mask[model.problem.mask]
    score = np.where(counted[:, None], model.scores.score[model.problem.mask], 0.0)
    seen = np.where(counted[:, None, None], model.scores.sensitivity[model.problem.mask], 0.0)
    products = np.einsum('fpi,fqi->fpq', seen, seen)
    moved = np.where(np.arange(len(x)) < noise, 0.0, x - model.x)
    weight, excess = np.linalg.inv(covariance[np.ix_(chosen, chosen)]), 1.0
    for begins in blocks(model.problem):
        # what the estimate itself adds to a block is no scatter
        sums = np.add.reduceat(score, begins) - np.add.reduceat(products, begins) @ moved
        spread = (covariance @ (sums.T @ sums) @ covariance)[np.ix_(chosen, chosen)]
        excess = max(excess, float(np.trace(weight @ spread)) / len(chosen))
    return _Side(x[chosen], weight / excess, np.sqrt(excess * np.diag(covariance)[chosen]))


def said(drives: Mapping[str, Mapping[str, Estimate]]) -> str:
    """What each drive says, for a person."""
    return '; '.join(f'{name}: ' + ', '.join(f'{p} {e.text()}' for p, e in found.items())
                     for name, found in drives.items())
