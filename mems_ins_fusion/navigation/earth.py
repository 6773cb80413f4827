"""WGS-84: radii of curvature, normal gravity, and the local level frame at a datum.

The scalar functions are compiled and used by the kernel; `radii` and `gravity` also accept arrays.
Source: NIMA TR8350.2, "Department of Defense World Geodetic System 1984", third edition.
"""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.compiled import njit

SEMI_MAJOR_AXIS = 6378137.0  # m
FLATTENING = 1 / 298.257223563  # of the ellipsoid
ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)
EQUATORIAL_GRAVITY = 9.7803253359  # m/s^2
SOMIGLIANA = 0.00193185265241  # k of the formula for normal gravity
GRAVITY_RATIO = 0.00344978650684  # m = omega^2 a^2 b / GM
STANDARD_GRAVITY = 9.80665  # m/s^2, for conversions of unit only


@njit
def radii(latitude):
    """Meridian and prime-vertical radius of curvature, m, at `latitude`, rad."""
    w2 = 1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2
    prime_vertical = SEMI_MAJOR_AXIS / np.sqrt(w2)
    return prime_vertical * (1.0 - ECCENTRICITY_SQUARED) / w2, prime_vertical


@njit
def gravity(latitude, height):
    """Normal gravity, m/s^2, at `latitude`, rad, and `height`, m: Somigliana with the second-order height term."""
    s2 = np.sin(latitude) ** 2
    surface = EQUATORIAL_GRAVITY * (1.0 + SOMIGLIANA * s2) / np.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)
    ratio = height / SEMI_MAJOR_AXIS
    return surface * (1.0 - 2.0 * (1.0 + FLATTENING + GRAVITY_RATIO - 2.0 * FLATTENING * s2) * ratio + 3.0 * ratio**2)


@njit
def _to_ecef(latitude, longitude, height):
    _, n = radii(latitude)
    x = (n + height) * np.cos(latitude) * np.cos(longitude)
    y = (n + height) * np.cos(latitude) * np.sin(longitude)
    z = (n * (1.0 - ECCENTRICITY_SQUARED) + height) * np.sin(latitude)
    return x, y, z


@njit
def _to_geodetic(x, y, z):
    """Inverse of `_to_ecef` by Bowring's formula (1985), iterated: exact to rounding near the ground."""
    p = np.sqrt(x**2 + y**2)
    b = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
    beta = np.arctan2(SEMI_MAJOR_AXIS * z, b * p)
    second = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)
    latitude = np.arctan2(z, p)
    for _ in range(3):
        latitude = np.arctan2(z + second * b * np.sin(beta) ** 3,
                              p - ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS * np.cos(beta) ** 3)
        beta = np.arctan2((1.0 - FLATTENING) * np.sin(latitude), np.cos(latitude))
    _, n = radii(latitude)
    height = p * np.cos(latitude) + z * np.sin(latitude) - SEMI_MAJOR_AXIS**2 / n
    return latitude, np.arctan2(y, x), height


@njit
def to_local(latitude, longitude, height, datum):
    """Position in the local level frame `n` (north, east, down; m) at `datum` (latitude, longitude, height).

    Angles in rad; arrays or scalars. The horizontal plane of the frame touches the level surface at the datum, as in
    REP-105: far from the datum the ground is below this plane.
    """
    x, y, z = _to_ecef(latitude, longitude, height)
    x0, y0, z0 = _to_ecef(datum[0], datum[1], datum[2])
    dx, dy, dz = x - x0, y - y0, z - z0
    sin_lat, cos_lat = np.sin(datum[0]), np.cos(datum[0])
    sin_lon, cos_lon = np.sin(datum[1]), np.cos(datum[1])
    outward = cos_lon * dx + sin_lon * dy
    return (cos_lat * dz - sin_lat * outward,
            cos_lon * dy - sin_lon * dx,
            -cos_lat * outward - sin_lat * dz)


@njit
def from_local(north, east, down, datum):
    """Latitude, longitude (rad) and height (m) of a point in the local level frame: inverse of `to_local`."""
    x0, y0, z0 = _to_ecef(datum[0], datum[1], datum[2])
    sin_lat, cos_lat = np.sin(datum[0]), np.cos(datum[0])
    sin_lon, cos_lon = np.sin(datum[1]), np.cos(datum[1])
    outward = -sin_lat * north - cos_lat * down
    return _to_geodetic(x0 + cos_lon * outward - sin_lon * east,
                        y0 + sin_lon * outward + cos_lon * east,
                        z0 + cos_lat * north - sin_lat * down)
