"""What may be published of a filter that does not know its heading."""
from __future__ import annotations

import math

import numpy as np

from ...navigation.earth import to_local
from ..runs.odometry import POSE_COVARIANCE
from .start import Start


def spread(start: Start, datum, out: np.ndarray, geodetic: np.ndarray, covariance: np.ndarray) -> None:
    """Take out of an `odometry` the way since `start`, whose direction nobody knows: in place.

    The equations are linear in the heading's error, which here may be anything. So the position stays that of the
    start, and the way that the sensors saw is added to its sigma in both directions. At rest there is none.
    """
    north, east, down = to_local(start.latitude, start.longitude, start.height, datum)
    way = math.hypot(out[0] - east, out[1] - north)
    out[0], out[1], out[2] = east, north, -down
    geodetic[:] = start.latitude, start.longitude, start.height
    out[[POSE_COVARIANCE, POSE_COVARIANCE + 7]] += way**2
    covariance[[0, 4]] += way**2
