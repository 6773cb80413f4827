"""Velocity of a point of a simulated vehicle."""
from __future__ import annotations

import numpy as np

STEP = 1e-3  # s, half the interval of the central differences


def velocity_at(drive, time: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """(m, 3) m/s in n at `time` (m,) s, of the point at `arm` (3,) from the IMU, body axes, m."""
    velocity = drive.at(time).velocity
    if not np.any(arm):
        return velocity
    before, after = (drive.at(time + step).attitude.apply(arm) for step in (-STEP, STEP))
    return velocity + (after - before) / (2 * STEP)
