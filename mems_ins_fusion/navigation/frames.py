"""Conversions between the axes of ROS (REP 103 and 105) and those of this package: east-north-up to north-east-down,
forward-left-up to forward-right-down.

The mounting rotation, which users give in REP 103 axes, converts from sensor axes `s` to body axes `b`.
"""
from __future__ import annotations

import math

import numpy as np

#: decimals of an angle, rad, in a line to set: 0.03 deg, less than any recording shows
ANGLE_DIGITS = 3
#: converts a vector from forward-left-up to forward-right-down axes, and back
FLU_TO_FRD = np.diag([1.0, -1.0, -1.0])


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rotation matrix R_z(yaw) R_y(pitch) R_x(roll), as in URDF and tf; angles in rad."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array([[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                     [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                     [-sp, cp * sr, cp * cr]])


def mounting(rpy) -> np.ndarray:
    """Rotation (3, 3) from sensor axes `s` to body axes `b` (forward-right-down). rpy: `imu.mounting_rpy`, rad."""
    rotation = FLU_TO_FRD @ rotation_from_rpy(*rpy)
    # elements that are zero but for rounding are set to zero: quarter turns are exact
    return np.where(np.abs(rotation) < 1e-15, 0.0, rotation)


def ned_from_enu(vector: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) converted from east-north-up to north-east-down, or back. A NaN stays in its component."""
    return vector[..., [1, 0, 2]] * (1.0, 1.0, -1.0)


def ned_covariance_from_enu(covariance: np.ndarray) -> np.ndarray:
    """Covariances (..., 3, 3) of vectors converted from east-north-up to north-east-down, or back."""
    return np.swapaxes(ned_from_enu(np.swapaxes(ned_from_enu(covariance), -1, -2)), -1, -2)


def wrap(angle):
    """`angle` (rad, scalar or array) in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def near(angle, other):
    """`angle` (rad, scalar or array) plus the whole turns that bring it within half a turn of `other`; unchanged to the
    last bit if it is that near. Makes longitudes continuous across the antimeridian."""
    return angle - 2 * math.pi * np.round((angle - other) / (2 * math.pi))


def yaw_from_enu(angle):
    """Yaw converted from counter-clockwise from east to clockwise from north, or back; rad."""
    return wrap(math.pi / 2 - angle)


def unit_quaternions(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) of length one; NaN where they are zero or NaN."""
    with np.errstate(invalid='ignore'):
        return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def yaw_of_quaternion(x, y, z, w):
    """Yaw about the vertical of a quaternion (z-y-x), rad."""
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def leveling(specific_force: np.ndarray) -> np.ndarray:
    """The smallest rotation (3, 3) that turns `specific_force` (3,), measured at rest in body axes, straight up (-z).

    For a force straight down any horizontal axis would do, and x is taken; for a zero force it is the identity.
    """
    up = specific_force / (np.linalg.norm(specific_force) or 1.0)
    axis = np.cross(up, [0.0, 0.0, -1.0])
    sine, cosine = np.linalg.norm(axis), -up[2]
    if sine < 1e-12:
        return np.diag([1.0, -1.0, -1.0]) if cosine < 0 else np.eye(3)
    x, y, z = axis / sine
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + sine * skew + (1 - cosine) * skew @ skew
