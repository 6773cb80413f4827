"""How the axes of an odometry are turned against the vehicle's: no fix, no filter.

The middle of the rear axle does not go sideways. So the velocity to the right of a point x m in front of it, in axes
that are turned to the left by yaw, is yaw v + x w + s v w with the speed v and the turn rate w: the angle, the distance
and the sideslip of the tyres, which grows with the lateral acceleration v w. Least squares of the three, sigma by the
jackknife.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.regression import blocks, fit, jackknife
from mems_ins_fusion.samples import Twists, in_time_order, possible_numbers

#: samples in motion, at least: at 5 Hz the four stretches of 10 s that the jackknife asks for
_FEWEST = 200
#: m/s, slowest motion: the noise of an odometry, some cm/s, is an angle of 10 deg there
_SLOWEST = 0.3
#: standard deviations about zero: angle (rad), distance (m), sideslip (rad/(m/s^2)), in units of the noise, of which
#: one of 0.1 m/s is assumed
_PRIOR = np.array([0.5, 3.0, 0.05]) / 0.1
#: rad: a sigma is at least this
_FLOOR = math.radians(0.1)


@dataclass(frozen=True)
class OdometryAxes:
    """yaw, sigma: rad, by which they are turned to the left. ahead: m, of the rear axle, and its sigma."""

    yaw: float
    sigma: float
    ahead: tuple[float, float]


def estimate_odometry_axes(twists: Twists) -> OdometryAxes | None:
    """What `twists` (SI units) show; None without a velocity sideways, or with too little motion."""
    forward, right, turn = possible_numbers(twists.twist).T
    good = in_time_order(twists.stamp, (right != 0.0) & (np.hypot(forward, right) > _SLOWEST))
    if len(good) < _FEWEST:
        return None
    forward, right, turn = forward[good], right[good], np.nan_to_num(turn[good])
    found = fit(np.column_stack([forward, turn, forward * turn]), right[:, None], _PRIOR,
                blocks((twists.stamp[good] - twists.stamp[good[0]]) * 1e-9))
    sigma = jackknife(found.left_out[:, :, 0], found.shown(0))
    yaw, ahead = math.atan(float(found.solution[0, 0])), float(found.solution[1, 0])
    return OdometryAxes(yaw, math.hypot(float(sigma[0]), _FLOOR), (ahead, float(sigma[1])))
