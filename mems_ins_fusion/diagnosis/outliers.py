"""Fixes that are off alone: the fix before and the one after are not, so nothing of the filter explains them.

The search sets them aside; what a user is told of them is a direct look at the recording (`effects/gnss_outliers.py`).
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects.gnss_outliers import far_off
from ..samples import Fixes
from .residuals import Residual

#: sigmas from which on a fix is off,
OFF = 6.0
#: and within which its neighbours have to be
WITHIN = 3.0


def isolated(residual: Residual, mask: np.ndarray) -> np.ndarray:
    """Which fixes are off alone, (f,) bool."""
    squared = np.where(mask, residual.nis(), 0.0)
    squared = np.where(np.isfinite(squared), squared, 0.0)
    before, after = np.append(0.0, squared[:-1]), np.append(squared[1:], 0.0)
    return mask & (squared > OFF**2) & (before < WITHIN**2) & (after < WITHIN**2)


def without_far_off(fixes: Fixes) -> Fixes:
    """`fixes` with those invalid that neither the ones before nor the ones after explain."""
    status = fixes.status.copy()
    status[far_off(fixes)[0]] = -1
    return replace(fixes, status=status)
