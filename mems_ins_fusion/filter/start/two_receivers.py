"""The first heading from two receivers: from one antenna to the other, while a slow vehicle drives straight.

The antennas give a heading at rest as well. But whether they are exchanged is known only once the vehicle moves: the
displacement has to point along the heading.
"""
from __future__ import annotations

import math

import numpy as np

from .course import Course
from .magnetic import HEADING_SIGMA

#: s for which the vehicle has to drive straight: at walking pace it moves by more than the noise of its fixes
STRAIGHT_TIME = 1.0
#: s, longest interval between two fixes of the main receiver between which its position is interpolated, and longest
#: time from the latest fix of the further receiver to that of the main one
LONGEST_GAP = 1.1
#: rad, largest change of the heading within STRAIGHT_TIME: in a turn the heading at the latest fix is another one
LARGEST_HEADING_CHANGE = 0.1
#: smallest displacement in standard deviations: its direction is then known to a fifth of a radian
MOVED = 5.0
#: largest difference between the measured distance of the antennas and that of their lever arms, in standard
#: deviations: exceeded by chance in 0.3 % of the pairs
ANTENNA_SIGMAS = 3.0
#: largest displacement to the side, as a share of that ahead: slip and noise. With exchanged antennas it is backwards
LARGEST_SIDEWAYS = 0.3
#: m/s, largest speed: the course of a faster vehicle shows the heading soon, and its speed may change much within
#: STRAIGHT_TIME
SLOW_SPEED = 2.0
#: m/s, standard deviation of the present speed of a slow vehicle about its mean over the last seconds: half a second at
#: 0.6 m/s^2. Chosen, not measured
SPEED_CHANGE_SIGMA = 0.3


def find_heading(positions: np.ndarray, places: np.ndarray, arm: np.ndarray, arm_sigma: float) -> Course | None:
    """Heading and speed at the latest fix; None where the heading is not known to HEADING_SIGMA, or the displacement
    does not confirm it.

    positions, places: fixes (k, 4) of the main and (m, 4) of a further receiver: time (s, ascending), north, east and
    sigma (m). arm: (2,) from the main antenna to the other, forward and right, m. arm_sigma: m, of each component.
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
    if (np.abs(np.hypot(*apart.T) - length) > ANTENNA_SIGMAS * sigma)[first:].any():
        return None
    bearing = np.unwrap(np.arctan2(apart[first:, 1], apart[first:, 0]))
    if np.ptp(bearing) > max(LARGEST_HEADING_CHANGE, ANTENNA_SIGMAS * sigma[-1] / length):
        return None
    yaw = float(bearing[-1]) - math.atan2(arm[1], arm[0])
    ahead, interval = np.array([math.cos(yaw), math.sin(yaw)]), pairs[-1, 0] - pairs[first, 0]
    moved, noise = main[-1, :2] - main[first, :2], math.hypot(main[-1, 2], main[first, 2])
    along, across = float(moved @ ahead), float(moved[1] * ahead[0] - moved[0] * ahead[1])
    if along < MOVED * noise or abs(across) > LARGEST_SIDEWAYS * along or along > SLOW_SPEED * interval:
        return None
    return Course(yaw, along / interval, float(sigma[-1]) / length, math.hypot(noise / interval, SPEED_CHANGE_SIGMA))
