"""What the filter has learned by itself: mounting angles and the axle are states where the constraint shows them.

A score test sees nothing of a mounting that is turned: its state takes it up within a minute. So the value of that
effect is what the state has come to, and its proof that of the two halves of the drive.
"""
from __future__ import annotations

import numpy as np


def hides(values: dict) -> dict[str, str]:
    """Effects that are states of the filter with these parameters, and why they are not traced."""
    if values['vehicle.non_holonomic'] and values['imu.mounting_sigma'] > 0:
        return {'mounting_rotation': 'the filter estimates pitch and yaw itself (imu.mounting_sigma)'}
    return {}


def with_mounting(correction, known, bench):
    """`correction`, for now."""
    return correction
