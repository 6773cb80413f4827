"""The published estimate where another filter takes over: it does not jump, it goes over to that of the new filter.

The difference between the two is added to the new estimate, less and less of it until nothing is left after BLENDING.
What is added is an error if the new filter is right, so that its square is part of the published covariance.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...navigation.earth import radii
from ...navigation.strapdown import from_rotation_vector, multiply
from .odometry import ANGULAR, LINEAR, ORIENTATION, POSE_COVARIANCE, POSITION, TWIST_COVARIANCE

BLENDING = 10.0  # s until nothing is left: two metres are 0.2 m/s then, which a controller follows without a jerk


@dataclass(frozen=True)
class Blending:
    """How far the published estimate was from that of the new filter when this took over. begun: ns, that sample.
    position (3,): east, north, up, m. velocity (3,): forward, left, up, m/s. rotation (3,): about east, north, up,
    rad."""

    begun: int
    position: np.ndarray
    velocity: np.ndarray
    rotation: np.ndarray

    def part(self, stamp: int) -> float:
        """What is left of the difference at `stamp`, ns: 1 to 0."""
        return min(max(1.0 - (stamp - self.begun) * 1e-9 / BLENDING, 0.0), 1.0)

    def left(self, stamp: int) -> tuple[float, float, float]:
        """What is left of the difference at `stamp`, ns: north and east, m, and for how long, s."""
        part = self.part(stamp)
        return part * float(self.position[1]), part * float(self.position[0]), part * BLENDING

    def add_to(self, odometry: np.ndarray, geodetic: np.ndarray, covariance: np.ndarray, part: float) -> None:
        """Add `part` of the difference, and its square to the covariances, in place.

        odometry: (SIZE,) of `odometry.odometry`. geodetic: (3,) latitude, longitude (rad), height (m) of the same
        position; covariance: (9,) of that, east-north-up, m^2.
        """
        position, velocity, rotation = part * self.position, part * self.velocity, part * self.rotation
        odometry[POSITION:ORIENTATION] += position
        odometry[LINEAR:ANGULAR] += velocity
        w, x, y, z = multiply(from_rotation_vector(*rotation.tolist()), _quaternion(odometry))
        odometry[ORIENTATION:POSE_COVARIANCE] = x, y, z, w
        pose = np.concatenate([position, rotation])
        odometry[POSE_COVARIANCE:LINEAR] += np.outer(pose, pose).ravel()
        odometry[TWIST_COVARIANCE:].reshape(6, 6)[:3, :3] += np.outer(velocity, velocity)
        _move(geodetic, *position.tolist())
        covariance += np.outer(position, position).ravel()


def blending(begun: int, published: np.ndarray, new: np.ndarray) -> Blending:
    """From the odometry `published` (SIZE,) to `new` (SIZE,), both of the sample stamped `begun`, ns."""
    w, x, y, z = _quaternion(new)
    turned = multiply(_quaternion(published), (w, -x, -y, -z))
    return Blending(begun, (published - new)[POSITION:ORIENTATION], (published - new)[LINEAR:ANGULAR],
                    _rotation_vector(turned))


def _quaternion(odometry: np.ndarray) -> tuple[float, float, float, float]:
    """w, x, y, z."""
    x, y, z, w = odometry[ORIENTATION:POSE_COVARIANCE].tolist()
    return w, x, y, z


def _rotation_vector(q: tuple[float, float, float, float]) -> np.ndarray:
    """Of the shorter turn, (3,) rad."""
    w, *axis = q if q[0] >= 0.0 else tuple(-one for one in q)
    sine = math.hypot(*axis)
    return np.array(axis) * (2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 2.0)


def _move(geodetic: np.ndarray, east: float, north: float, up: float) -> None:
    """Latitude, longitude (rad) and height moved by so many metres, in place."""
    meridian, normal = radii(geodetic[0])
    geodetic += (north / (meridian + geodetic[2]), east / ((normal + geodetic[2]) * math.cos(geodetic[0])), up)
