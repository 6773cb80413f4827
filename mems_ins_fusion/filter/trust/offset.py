"""A Kalman filter of an offset in the plane: with its velocity and acceleration, from positions that are off by it.

Both axes have the same covariance. The acceleration is a first-order Gauss-Markov process (R. A. Singer, "Estimating
optimal tracking filter performance for manned maneuvering targets", IEEE Trans. Aerospace and Electronic Systems 6,
1970), or none where its variance is zero.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from mems_ins_fusion.compiled import njit


class _Offset(NamedTuple):
    """Columns of one, from where it begins; north and east."""

    OFFSET: int = 0  # 2, m,
    VELOCITY: int = 2  # 2, m/s,
    ACCELERATION: int = 4  # 2, m/s^2,
    VARIANCE: int = 6  # of the offset, m^2,
    COVARIANCE: int = 7  # of offset and velocity, m^2/s,
    VELOCITY_VARIANCE: int = 8  # m^2/s^2,
    OFFSET_ACCELERATION: int = 9  # covariance of offset and acceleration, m^2/s^2,
    VELOCITY_ACCELERATION: int = 10  # of velocity and acceleration, m^2/s^3,
    ACCELERATION_VARIANCE: int = 11  # m^2/s^4
    SIZE: int = 12


Offset = _Offset()


class Walk(NamedTuple):
    """How an offset changes.

    Spectral densities of white noise on its velocity, m^2/s, and on its acceleration, m^2/s^3; standard deviation of
    its acceleration, m/s^2, and the correlation time of that, s.
    """

    velocity: float
    acceleration: float
    sigma: float = 0.0
    correlation_time: float = 1.0


@njit(_nrt=False)
def begin(mem, at, north, east, variance, velocity_variance, acceleration_sigma):
    """The offset at `at`, m, with the variance `variance`, m^2, on each axis, and with a velocity and an acceleration
    of zero, of this variance, m^2/s^2, and standard deviation, m/s^2."""
    for i in range(Offset.SIZE):
        mem[at + i] = 0.0
    mem[at], mem[at + 1] = north, east
    mem[at + Offset.VARIANCE], mem[at + Offset.VELOCITY_VARIANCE] = variance, velocity_variance
    mem[at + Offset.ACCELERATION_VARIANCE] = acceleration_sigma * acceleration_sigma


@njit(_nrt=False)
def predict(mem, at, dt, walk):
    """Predict the offset at `at` by `dt`, s, as `walk` (Walk) says.

    The noise of the acceleration is that of intervals shorter than its correlation time (Singer 1970, equation 13).
    """
    left = math.exp(-dt / walk.correlation_time)
    to_v = walk.correlation_time * (1.0 - left)  # velocity, and offset, for an acceleration of one
    to_x = walk.correlation_time * (dt - to_v)
    for i in range(2):
        x, v, a = at + i, at + Offset.VELOCITY + i, at + Offset.ACCELERATION + i
        mem[x] += dt * mem[v] + to_x * mem[a]
        mem[v] += to_v * mem[a]
        mem[a] *= left
    p = at + Offset.VARIANCE
    xx, xv, vv, xa, va, aa = mem[p], mem[p + 1], mem[p + 2], mem[p + 3], mem[p + 4], mem[p + 5]
    noise = 2.0 * walk.sigma * walk.sigma / walk.correlation_time
    mem[p] = (xx + 2.0 * dt * xv + dt * dt * vv + 2.0 * to_x * (xa + dt * va) + to_x * to_x * aa
              + dt * (walk.velocity + dt * dt * (walk.acceleration / 3.0 + noise * dt * dt / 20.0)))
    mem[p + 1] = (xv + dt * vv + to_v * (xa + dt * va) + to_x * (va + to_v * aa)
                  + dt * dt * (walk.acceleration / 2.0 + noise * dt * dt / 8.0))
    mem[p + 2] = vv + to_v * (2.0 * va + to_v * aa) + dt * (walk.acceleration + noise * dt * dt / 3.0)
    mem[p + 3] = left * (xa + dt * va + to_x * aa) + noise * dt**3 / 6.0
    mem[p + 4] = left * (va + to_v * aa) + noise * dt * dt / 2.0
    mem[p + 5] = left * left * aa + walk.sigma * walk.sigma * (1.0 - left * left)


@njit(_nrt=False)
def density(north, east, variance, late_n, late_e):
    """Density, 1/m^2, of an innovation (north, east), m, with `variance`, m^2, on each axis.

    late: m, one sigma of what an undeclared time offset adds, along the velocity.
    """
    along = variance + late_n * late_n + late_e * late_e
    nis = (north * north + east * east - (late_n * north + late_e * east) ** 2 / along) / variance
    return math.exp(-0.5 * min(nis, 1000.0)) / (2.0 * math.pi * math.sqrt(variance * along))


@njit(_nrt=False)
def correct(mem, at, north, east, variance):
    """Correct the offset at `at` by a position that is off by (north, east), m, with `variance`, m^2, on each axis."""
    p = at + Offset.VARIANCE
    xx, xv, xa = mem[p], mem[p + 1], mem[p + 3]
    s, n, e = xx + variance, north - mem[at], east - mem[at + 1]
    for i in range(2):
        z = n if i == 0 else e
        mem[at + i] += xx / s * z
        mem[at + Offset.VELOCITY + i] += xv / s * z
        mem[at + Offset.ACCELERATION + i] += xa / s * z
    mem[p + 2] -= xv * xv / s
    mem[p + 4] -= xv * xa / s
    mem[p + 5] -= xa * xa / s
    left = variance / s
    mem[p], mem[p + 1], mem[p + 3] = left * xx, left * xv, left * xa
