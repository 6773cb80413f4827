"""Three-dimensional strapdown mechanization in the local level frame, all six sensors.

State: latitude, longitude, height, velocity (v_n, v_e, v_d), quaternion from b to n. Attitude error phi in `n`:
C_ins = (I + [phi x]) C_true, so that its down component is the yaw error of the planar mechanization.
Sources: P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems", 2nd ed., ch. 5;
E.-H. Shin, "Estimation Techniques for Low-Cost Inertial Navigation", 2005.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from mems_ins_fusion.compiled import njit


class _State(NamedTuple):
    """The error states, estimate minus truth, in `n`: position (m), velocity (m/s) and attitude phi (rad)."""

    R_N: int = 0
    R_E: int = 1
    R_D: int = 2
    V_N: int = 3
    V_E: int = 4
    V_D: int = 5
    PHI_N: int = 6
    PHI_E: int = 7
    PHI_D: int = 8
    SIZE: int = 9


State = _State()
STATES = tuple(name.lower() for name in State._fields[:-1])
#: the sensors it uses, body axes
CHANNELS = ('f_x', 'f_y', 'f_z', 'w_x', 'w_y', 'w_z')

EARTH_RATE = 7.292115e-5  # rad/s, WGS-84


@njit
def multiply(a, b):
    """Quaternion product a b (w, x, y, z)."""
    return (a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0])


@njit
def from_rotation_vector(x, y, z):
    """Quaternion of the rotation by the vector (x, y, z), rad."""
    squared = 0.25 * (x * x + y * y + z * z)
    if squared < 1e-4:  # series: exact to rounding, no division by a small angle
        half_sinc = 0.5 * (1.0 - squared / 6.0 * (1.0 - squared / 20.0 * (1.0 - squared / 42.0)))
        w = 1.0 - squared / 2.0 * (1.0 - squared / 12.0 * (1.0 - squared / 30.0))
        return w, half_sinc * x, half_sinc * y, half_sinc * z
    half = math.sqrt(squared)
    scale = 0.5 * math.sin(half) / half
    return math.cos(half), scale * x, scale * y, scale * z


@njit
def matrix(q):
    """Rotation matrix of quaternion `q` as nine numbers, row by row."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))


@njit
def column(c, axis):
    """One of the three columns of the rotation matrix `c`, nine numbers row by row: the axis of `b` in `n`."""
    if axis == 0:
        return c[0], c[3], c[6]
    if axis == 1:
        return c[1], c[4], c[7]
    return c[2], c[5], c[8]


@njit
def from_euler(roll, pitch, yaw):
    """Quaternion from b to n of roll, pitch, yaw (rad, z-y-x)."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy)


@njit
def to_euler(q):
    """Roll, pitch, yaw (rad, z-y-x) of quaternion `q` from b to n."""
    c = matrix(q)
    return math.atan2(c[7], c[8]), -math.asin(min(1.0, max(-1.0, c[6]))), math.atan2(c[3], c[0])


@njit
def correct_attitude(q, phi_n, phi_e, phi_d):
    """Quaternion `q` corrected by the attitude error phi (rad, in `n`), normalized."""
    r = multiply(from_rotation_vector(-phi_n, -phi_e, -phi_d), q)
    scale = 1.0 / math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3])
    return r[0] * scale, r[1] * scale, r[2] * scale, r[3] * scale


@njit
def frame_rates(latitude, v_n, v_e, north_radius, east_radius):
    """Earth rate and transport rate in `n`, rad/s: (e_n, e_d, t_n, t_e, t_d); radii with the height added, m."""
    c, s = math.cos(latitude), math.sin(latitude)
    return EARTH_RATE * c, -EARTH_RATE * s, v_e / east_radius, -v_n / north_radius, -v_e * s / (c * east_radius)


@njit
def mechanize(q, v_n, v_e, v_d, f, w, dt, gravity, rates):
    """Mechanize one interval of dt, s.

    q: quaternion from b to n. f (m/s^2), w (rad/s): specific force and angular rate in `b`, tuples. gravity: m/s^2.
    rates: of `frame_rates`. Returns quaternion, C of mid-interval, f in `n`, displacement in `n` (m) and velocity in
    `n` (m/s) at its end.
    """
    e_n, e_d, t_n, t_e, t_d = rates
    half = multiply(from_rotation_vector(-0.5 * dt * (e_n + t_n), -0.5 * dt * t_e, -0.5 * dt * (e_d + t_d)),
                    multiply(q, from_rotation_vector(0.5 * dt * w[0], 0.5 * dt * w[1], 0.5 * dt * w[2])))
    c = matrix(half)
    f_n = c[0] * f[0] + c[1] * f[1] + c[2] * f[2]
    f_e = c[3] * f[0] + c[4] * f[1] + c[5] * f[2]
    f_d = c[6] * f[0] + c[7] * f[1] + c[8] * f[2]
    # Coriolis: -(2 earth rate + transport rate) x v
    o_n, o_e, o_d = 2 * e_n + t_n, t_e, 2 * e_d + t_d
    dv_n = dt * (f_n - (o_e * v_d - o_d * v_e))
    dv_e = dt * (f_e - (o_d * v_n - o_n * v_d))
    dv_d = dt * (f_d + gravity - (o_n * v_e - o_e * v_n))
    end = multiply(from_rotation_vector(-0.5 * dt * (e_n + t_n), -0.5 * dt * t_e, -0.5 * dt * (e_d + t_d)),
                   multiply(half, from_rotation_vector(0.5 * dt * w[0], 0.5 * dt * w[1], 0.5 * dt * w[2])))
    # one Newton step keeps the norm at 1
    scale = 1.5 - 0.5 * (end[0] * end[0] + end[1] * end[1] + end[2] * end[2] + end[3] * end[3])
    end = (end[0] * scale, end[1] * scale, end[2] * scale, end[3] * scale)
    displacement = (dt * (v_n + 0.5 * dv_n), dt * (v_e + 0.5 * dv_e), dt * (v_d + 0.5 * dv_d))
    return end, c, (f_n, f_e, f_d), displacement, (v_n + dv_n, v_e + dv_e, v_d + dv_d)


@njit
def transition(dt, c, f):
    """Argument `step` of `error_step` for one interval: dt, C and f times dt. c: C of mid-interval. f: specific force
    in `n`."""
    return (dt, dt * c[0], dt * c[1], dt * c[2], dt * c[3], dt * c[4], dt * c[5], dt * c[6], dt * c[7], dt * c[8],
            dt * f[0], dt * f[1], dt * f[2])


@njit
def error_step(step, r, v, phi, df, dw):
    """Propagate small errors over one interval: the transition matrix times one column.

    step: of `transition`. r, v, phi: errors of position (m), velocity (m/s) and attitude (rad) before the interval. df,
    dw: errors of the sensors, in `b`. Returns the nine errors after the interval. Errors of the frame rates and of
    gravity (Schuler oscillation, 84 minutes) are neglected: they are far below those of a MEMS sensor.
    """
    dt, c0, c1, c2, c3, c4, c5, c6, c7, c8, f_n, f_e, f_d = step
    w_n = c0 * dw[0] + c1 * dw[1] + c2 * dw[2]
    w_e = c3 * dw[0] + c4 * dw[1] + c5 * dw[2]
    w_d = c6 * dw[0] + c7 * dw[1] + c8 * dw[2]
    p_n, p_e, p_d = phi[0] + 0.5 * w_n, phi[1] + 0.5 * w_e, phi[2] + 0.5 * w_d
    u_n = c0 * df[0] + c1 * df[1] + c2 * df[2] + p_e * f_d - p_d * f_e
    u_e = c3 * df[0] + c4 * df[1] + c5 * df[2] + p_d * f_n - p_n * f_d
    u_d = c6 * df[0] + c7 * df[1] + c8 * df[2] + p_n * f_e - p_e * f_n
    return (r[0] + dt * (v[0] + 0.5 * u_n), r[1] + dt * (v[1] + 0.5 * u_e), r[2] + dt * (v[2] + 0.5 * u_d),
            v[0] + u_n, v[1] + u_e, v[2] + u_d, phi[0] + w_n, phi[1] + w_e, phi[2] + w_d)
