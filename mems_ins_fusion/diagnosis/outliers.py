"""Fixes that are off alone: neither the fix before nor the one after is, so nothing of the filter explains them."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .residuals import Problem, Residual

#: a fix is off from so many sigma on, where its neighbours are within the other
OFF, WITHIN = 6.0, 3.0
#: fewer than this, or than this part of the fixes, are not worth a word
FEWEST, SHARE = 3, 0.003


@dataclass(frozen=True)
class Outliers:
    """index: of the fixes that were set aside, among those used. share: of all. typical: m, the median of how far off
    they are."""

    index: np.ndarray
    share: float
    typical: float

    @classmethod
    def of(cls, problem: Problem, outlying: np.ndarray) -> Outliers:
        """Those of `outlying` (f,), by the innovations of the filter as configured."""
        index = np.flatnonzero(outlying)
        distance = np.hypot(*problem.base.z[index].T)
        distance = distance[np.isfinite(distance)]
        return cls(index, len(index) / max(len(outlying), 1), float(np.median(distance)) if len(distance) else 0.0)

    @property
    def matter(self) -> bool:
        return len(self.index) >= FEWEST and self.share >= SHARE


def isolated(residual: Residual, mask: np.ndarray) -> np.ndarray:
    """Which fixes are off alone, (f,) bool."""
    squared = np.where(mask, residual.nis(), 0.0)
    squared = np.where(np.isfinite(squared), squared, 0.0)
    before, after = np.append(0.0, squared[:-1]), np.append(squared[1:], 0.0)
    return mask & (squared > OFF**2) & (before < WITHIN**2) & (after < WITHIN**2)
