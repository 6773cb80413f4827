"""The first heading from two receivers: from one antenna to the other, while a slow vehicle goes straight on.

At rest the antennas tell it, too. But whether they are exchanged shows only in the way that the vehicle goes.
"""
from __future__ import annotations

import math

import numpy as np

from .course import Course
from .magnetic import HEADING_SIGMA

#: s over which the vehicle has to go straight on: a robot at walking pace goes by more than its fixes are uncertain
STRAIGHT_TIME = 1.0
#: s between two fixes of the main receiver, at most, between which its place is interpolated, and from the latest place
#: of the further one to the latest fix
LONGEST_GAP = 1.1
#: rad by which the heading may change meanwhile: in a turn it is another one at the latest fix
LARGEST_TURN = 0.1
#: sigmas by which the displacement has to differ from zero: it then shows its direction to a fifth of a radian
MOVED = 5.0
#: sigmas by which the distance of the antennas differs from that of their arms at most: a chance of 0.3 % a pair
APART = 3.0
#: largest displacement to the side, as a share of that ahead: slip and noise. Antennas that are exchanged go backwards
LARGEST_SIDEWAYS = 0.3
#: m/s: the course of a faster vehicle soon shows its heading, and its speed has changed within STRAIGHT_TIME
SLOW_SPEED = 2.0
#: m/s, standard deviation of the present speed about its mean over STRAIGHT_TIME: half a second at 0.6 m/s^2
SPEED_SIGMA = 0.3


def find_heading(positions: np.ndarray, places: np.ndarray, arm: np.ndarray, arm_sigma: float) -> Course | None:
    """Heading and speed at the latest fix; None where the heading is not known to HEADING_SIGMA, or not confirmed by
    the way that the vehicle goes.

    positions, places: fixes (k, 4) and (m, 4) of the main and of a further receiver, time, s, ascending, north, east
    and sigma, m. arm: (2,) from the main antenna to the other, forward and right, m. arm_sigma: of each component.
    """
    length = math.hypot(*arm)
    after = np.searchsorted(positions[:, 0], places[:, 0])
    inside = (after > 0) & (after < len(positions))
    places, after = places[inside], after[inside]
    pairs = places[positions[after, 0] - positions[after - 1, 0] < LONGEST_GAP]
    if len(pairs) < 2 or positions[-1, 0] - pairs[-1, 0] > LONGEST_GAP:
        return None
    main = np.column_stack([np.interp(pairs[:, 0], positions[:, 0], positions[:, k]) for k in (1, 2, 3)])
    apart = pairs[:, 1:3] - main[:, :2]
    sigma = np.sqrt(pairs[:, 3] ** 2 + main[:, 2] ** 2 + arm_sigma**2)
    first = int(np.searchsorted(pairs[:, 0], pairs[-1, 0] - STRAIGHT_TIME + 1e-3, side='right')) - 1
    if first < 0 or sigma[-1] > HEADING_SIGMA * length or pairs[-1, 0] - pairs[first, 0] > 2.0 * STRAIGHT_TIME:
        return None
    if (np.abs(np.hypot(*apart.T) - length) > APART * sigma)[first:].any():
        return None
    bearing = np.unwrap(np.arctan2(apart[first:, 1], apart[first:, 0]))
    if np.ptp(bearing) > max(LARGEST_TURN, APART * sigma[-1] / length):
        return None
    yaw = float(bearing[-1]) - math.atan2(arm[1], arm[0])
    ahead, interval = np.array([math.cos(yaw), math.sin(yaw)]), pairs[-1, 0] - pairs[first, 0]
    moved, noise = main[-1, :2] - main[first, :2], math.hypot(main[-1, 2], main[first, 2])
    along, across = float(moved @ ahead), float(moved[1] * ahead[0] - moved[0] * ahead[1])
    if along < MOVED * noise or abs(across) > LARGEST_SIDEWAYS * along or along > SLOW_SPEED * interval:
        return None
    return Course(yaw, along / interval, float(sigma[-1]) / length, math.hypot(noise / interval, SPEED_SIGMA))
