"""What the tests of the simulator share."""
from __future__ import annotations

import numpy as np

FLU = np.array([1.0, -1.0, -1.0])  # between forward-right-down and forward-left-up


def close(actual, expected, bound) -> bool:
    """Whether all of `actual` lies within `bound` of `expected`: absolute, and fast on long arrays."""
    difference = np.abs(np.asarray(actual) - np.asarray(expected))
    return bool(difference.size) and bool(np.all(difference <= bound))
