"""Fixes that are off alone: the fix before and the one after are not, so nothing of the filter explains them.

The search sets them aside; what a user is told of them is a direct look at the recording (`effects/gnss_outliers.py`).
"""
from __future__ import annotations

import numpy as np

from .residuals import Residual

#: a fix is off from so many sigma on, where its neighbours are within the other
OFF, WITHIN = 6.0, 3.0


def isolated(residual: Residual, mask: np.ndarray) -> np.ndarray:
    """Which fixes are off alone, (f,) bool."""
    squared = np.where(mask, residual.nis(), 0.0)
    squared = np.where(np.isfinite(squared), squared, 0.0)
    before, after = np.append(0.0, squared[:-1]), np.append(squared[1:], 0.0)
    return mask & (squared > OFF**2) & (before < WITHIN**2) & (after < WITHIN**2)
