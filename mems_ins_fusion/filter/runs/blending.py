"""Transition of the published estimate when another filter takes over: it moves smoothly to the new filter's estimate.

The difference of the two estimates is added to the new one, with a factor that falls from 1 to 0 within BLENDING. If
the new filter is right, what is added is an error, so its square is added to the published covariance.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...navigation.earth import radii
from ...navigation.strapdown import from_rotation_vector, multiply
from .odometry import ANGULAR, LINEAR, ORIENTATION, POSE_COVARIANCE, POSITION, TWIST_COVARIANCE

#: s, duration of the transition: a difference of 2 m changes by 0.2 m/s then, which a controller follows without a jerk
BLENDING = 10.0


@dataclass(frozen=True)
class Blending:
    """Difference of the estimates when the new filter took over: the published one minus that of the new filter.

    begun: ns, stamp of the sample at which it took over. position (3,): east, north, up, m. velocity (3,): forward,
    left, up, m/s. rotation (3,): about east, north, up, rad.
    """

    begun: int
    position: np.ndarray
    velocity: np.ndarray
    rotation: np.ndarray

    def part(self, stamp: int) -> float:
        """Factor of the difference at `stamp`, ns: 1 at the begin, 0 from BLENDING on."""
        return min(max(1.0 - (stamp - self.begun) * 1e-9 / BLENDING, 0.0), 1.0)

    def left(self, stamp: int) -> tuple[float, float, float]:
        """Remaining difference at `stamp`, ns: north and east, m, and the time until it is zero, s."""
        part = self.part(stamp)
        return part * float(self.position[1]), part * float(self.position[0]), part * BLENDING

    def add_to(self, odometry: np.ndarray, geodetic: np.ndarray, covariance: np.ndarray, part: float,
               error: float | None = None) -> None:
        """Add `part` times the difference to the estimate, and the square of `error` times it, without it of what is
        added, to the covariances, in place.

        odometry: (SIZE,) of `odometry.odometry`. geodetic: (3,) latitude, longitude (rad), height (m) of the same
        position. covariance: (9,) of this position, east-north-up, m^2.
        """
        position, velocity, rotation = part * self.position, part * self.velocity, part * self.rotation
        odometry[POSITION:ORIENTATION] += position
        odometry[LINEAR:ANGULAR] += velocity
        w, x, y, z = multiply(from_rotation_vector(*rotation.tolist()), _quaternion(odometry))
        odometry[ORIENTATION:POSE_COVARIANCE] = x, y, z, w
        error = part if error is None else error
        pose, moving = error * np.concatenate([self.position, self.rotation]), error * self.velocity
        odometry[POSE_COVARIANCE:LINEAR] += np.outer(pose, pose).ravel()
        odometry[TWIST_COVARIANCE:].reshape(6, 6)[:3, :3] += np.outer(moving, moving)
        _move(geodetic, *position.tolist())
        covariance += np.outer(pose[:3], pose[:3]).ravel()


def blending(begun: int, published: np.ndarray, new: np.ndarray) -> Blending:
    """The transition from the odometry `published` (SIZE,) to `new` (SIZE,), both of the sample stamped `begun`, ns."""
    w, x, y, z = _quaternion(new)
    turned = multiply(_quaternion(published), (w, -x, -y, -z))
    return Blending(begun, (published - new)[POSITION:ORIENTATION], (published - new)[LINEAR:ANGULAR],
                    _rotation_vector(turned))


def _quaternion(odometry: np.ndarray) -> tuple[float, float, float, float]:
    """The orientation of `odometry` as a quaternion w, x, y, z."""
    x, y, z, w = odometry[ORIENTATION:POSE_COVARIANCE].tolist()
    return w, x, y, z


def _rotation_vector(q: tuple[float, float, float, float]) -> np.ndarray:
    """Rotation vector (3,), rad, of the quaternion q, for the rotation by less than half a turn."""
    w, *axis = q if q[0] >= 0.0 else tuple(-one for one in q)
    sine = math.hypot(*axis)
    return np.array(axis) * (2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 2.0)


def _move(geodetic: np.ndarray, east: float, north: float, up: float) -> None:
    """Move latitude, longitude (rad) and height (m) by `east`, `north` and `up` m, in place."""
    meridian, normal = radii(geodetic[0])
    geodetic += (north / (meridian + geodetic[2]), east / ((normal + geodetic[2]) * math.cos(geodetic[0])), up)
