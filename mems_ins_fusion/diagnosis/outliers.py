"""Single outliers among the fixes: the fix before and the one after fit, so an error of the filter does not explain
them.

The search leaves them out. The report on outliers is from a direct look at the recording (`effects/gnss_outliers.py`).
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects.gnss_outliers import far_off
from ..samples import Fixes
from .residuals import Residual

OFF = 6.0  # number of sigmas beyond which a fix is an outlier
WITHIN = 3.0  # number of sigmas within which the fixes before and after it have to be


def isolated(residual: Residual, mask: np.ndarray) -> np.ndarray:
    """(f,) bool: whether a fix is a single outlier."""
    squared = np.where(mask, residual.nis(), 0.0)
    squared = np.where(np.isfinite(squared), squared, 0.0)
    before, after = np.append(0.0, squared[:-1]), np.append(squared[1:], 0.0)
    return mask & (squared > OFF**2) & (before < WITHIN**2) & (after < WITHIN**2)


def without_far_off(fixes: Fixes) -> Fixes:
    """`fixes` with those marked invalid that are far from where the fixes before and after place the vehicle."""
    status = fixes.status.copy()
    status[far_off(fixes)[0]] = -1
    return replace(fixes, status=status)
