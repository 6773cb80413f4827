"""The paper's planar mechanization: two accelerometers and the vertical gyroscope on a level road.

State: v_n, v_e (m/s), yaw (rad, clockwise from north); position follows from the velocity. Input over one interval of
length dt: f_x, f_y (m/s^2, forward and right) and w_z (rad/s, about down), sensor errors already removed.

Source: section 4 of the paper.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from mems_ins_fusion.compiled import njit


class _State(NamedTuple):
    """The error states, estimate minus truth: position (m), velocity (m/s) and yaw (rad)."""

    R_N: int = 0
    R_E: int = 1
    V_N: int = 2
    V_E: int = 3
    YAW: int = 4
    SIZE: int = 5


State = _State()
STATES = tuple(name.lower() for name in State._fields[:-1])
#: the sensors it uses, body axes
CHANNELS = ('f_x', 'f_y', 'w_z')


@njit
def rotate(yaw, dt, f_x, f_y, w_z):
    """Specific force in `n` with the yaw of mid-interval, and that yaw's cosine and sine: (f_n, f_e, cos, sin)."""
    middle = yaw + 0.5 * dt * w_z
    c, s = math.cos(middle), math.sin(middle)
    return c * f_x - s * f_y, s * f_x + c * f_y, c, s


@njit
def mechanize(v_n, v_e, yaw, f_x, f_y, w_z, dt):
    """Mechanize one interval of dt, s. Returns displacement north and east, m, and v_n, v_e, yaw at its end."""
    f_n, f_e, _, _ = rotate(yaw, dt, f_x, f_y, w_z)
    dv_n, dv_e = dt * f_n, dt * f_e
    return dt * (v_n + 0.5 * dv_n), dt * (v_e + 0.5 * dv_e), v_n + dv_n, v_e + dv_e, yaw + dt * w_z


@njit
def error_step(dt, f_n, f_e, c, s, r_n, r_e, v_n, v_e, yaw, f_x, f_y, w_z):
    """Propagate small errors over one interval: the transition matrix (Eq. 18, corrected) times one column.

    f_n, f_e, c, s: of `rotate`. r_n to w_z: errors before the interval, the last three those of the sensors. Returns
    the errors r_n, r_e, v_n, v_e, yaw after it. This is the derivative of `mechanize`. Eq. 18 of the paper is
    corrected: a yaw error rotates the specific force, so the two entries of column 5 have opposite signs.
    """
    turned = yaw + 0.5 * dt * w_z
    u_n = dt * (c * f_x - s * f_y - f_e * turned)
    u_e = dt * (s * f_x + c * f_y + f_n * turned)
    return (r_n + dt * (v_n + 0.5 * u_n), r_e + dt * (v_e + 0.5 * u_e), v_n + u_n, v_e + u_e, yaw + dt * w_z)
