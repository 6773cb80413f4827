"""Functions that measurements share: events for the kernel, and the velocity of a point of a simulated vehicle."""
from __future__ import annotations

import numpy as np

from ..memory import Event

DIFFERENCE_STEP = 1e-3  # s, half the interval of the central differences in a simulation
LARGEST_VELOCITY = 150.0  # m/s, largest velocity that is not refused: no land vehicle is faster
#: m/s (for a turn rate rad/s), lower limit of the standard deviation of a velocity, whatever the message states
SMALLEST_SPEED_SIGMA = 0.001
#: largest standard deviation of a measurement, over its default one: it weighs nothing, and in any unit its square is a
#: number, whatever the message states
MOST_DEFAULTS = 1e6


def empty(kind: int, n: int) -> np.ndarray:
    """n events of one kind, all other columns zero: (n, Event.SIZE)."""
    events = np.zeros((n, Event.SIZE))
    events[:, Event.KIND] = kind
    return events


def refuse(reasons: dict[int, str], wrong: np.ndarray, text) -> None:
    """Set reasons[i] to text(i) where `wrong` (n,) is true and there is no reason yet."""
    for i in np.flatnonzero(wrong).tolist():
        if i not in reasons:
            reasons[i] = text(i)


def stated_or(variance: np.ndarray, settings, smallest: float) -> np.ndarray:
    """Variances (n,): settings.sigma where configured, else the message's where positive, else settings.default_sigma.

    smallest: lower limit of the standard deviation; the upper one is MOST_DEFAULTS.
    """
    if settings.sigma > 0:
        return np.full(len(variance), settings.sigma**2)
    known = np.isfinite(variance) & (variance > 0)
    limited = np.clip(np.where(known, variance, 1.0), smallest**2, (MOST_DEFAULTS * settings.default_sigma) ** 2)
    return np.where(known, limited, settings.default_sigma**2)


def velocity_at(drive, time: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """(m, 3) m/s in n at `time` (m,) s, of the point of a vehicle at `arm` (3,) from its IMU, body axes, m."""
    velocity = drive.at(time).velocity
    if not np.any(arm):
        return velocity
    before, after = (drive.at(time + step).attitude.apply(arm) for step in (-DIFFERENCE_STEP, DIFFERENCE_STEP))
    return velocity + (after - before) / (2 * DIFFERENCE_STEP)
