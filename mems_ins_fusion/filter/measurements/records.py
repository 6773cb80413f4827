"""What the files of measurements share when they make records of what the sensors delivered."""
from __future__ import annotations

import numpy as np

from ..memory import Event


def empty(kind: int, n: int) -> np.ndarray:
    """Records (n, Event.SIZE) of one kind, nothing filled in."""
    records = np.zeros((n, Event.SIZE))
    records[:, Event.KIND] = kind
    return records


def refuse(reasons: np.ndarray, wrong: np.ndarray, text) -> None:
    """Give those of `reasons` (n,) that have none yet and are `wrong` (n,) a text: text(i) for the i-th."""
    if not wrong.any():
        return
    for i in np.flatnonzero(wrong & (reasons == '')):
        reasons[i] = text(i)


def stated_or(variance: np.ndarray, settings, smallest: float) -> np.ndarray:
    """Variances (n,): as configured, else as stated where they are numbers above zero, else the default."""
    if settings.sigma > 0:
        return np.full(len(variance), settings.sigma**2)
    known = np.isfinite(variance) & (variance > 0)
    return np.where(known, np.maximum(np.where(known, variance, 1.0), smallest**2), settings.default_sigma**2)
