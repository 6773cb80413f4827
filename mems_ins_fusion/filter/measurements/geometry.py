"""What several measurements need of a state: its rotation and its velocity in the body, with their derivatives."""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ...navigation import strapdown
from ..memory import NAV, PLANAR, Error, Event, Head, Nav, Sample, channel_of, row_of


@njit(_nrt=False)
def body_to_level(mem, r):
    """Rotation from b to n of the state at r, as nine numbers, row by row."""
    if mem[Head.MECHANIZATION] == PLANAR:
        c, s = math.cos(mem[r + Nav.YAW]), math.sin(mem[r + Nav.YAW])
        return c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0
    return strapdown.matrix((mem[r + Nav.Q_W], mem[r + Nav.Q_X], mem[r + Nav.Q_Y], mem[r + Nav.Q_Z]))


@njit(_nrt=False)
def vehicle_to_level(mem, r, c):
    """Rotation from the vehicle's axes to n, where the estimated mounting turns them in b; c: rotation from b to n.

    About z by the yaw, then about y by the pitch, however large: the mounting may be far from what is configured.
    """
    yaw, pitch = int(mem[Head.MOUNTING_YAW]), int(mem[Head.MOUNTING_PITCH])
    if yaw >= 0:
        a, b = math.cos(mem[r + NAV + yaw]), math.sin(mem[r + NAV + yaw])
        c = (a * c[0] + b * c[1], a * c[1] - b * c[0], c[2], a * c[3] + b * c[4], a * c[4] - b * c[3], c[5],
             a * c[6] + b * c[7], a * c[7] - b * c[6], c[8])
    if pitch >= 0:
        a, b = math.cos(mem[r + NAV + pitch]), math.sin(mem[r + NAV + pitch])
        c = (a * c[0] - b * c[2], c[1], a * c[2] + b * c[0], a * c[3] - b * c[5], c[4], a * c[5] + b * c[3],
             a * c[6] - b * c[8], c[7], a * c[8] + b * c[6])
    return c


@njit(_nrt=False)
def add(mem, h, error, value):
    """Add to the row of H at `h` the derivative by one of the nine navigation errors, if the mechanization has it."""
    state = row_of(mem, error)
    if state >= 0:
        mem[h + state] += value


@njit(_nrt=False)
def arm_of(mem, at, plain):
    """From the IMU to where the record at `at` was measured, body axes, m; plain: where that of the input without a
    name stands."""
    if mem[at + Event.INPUT] > 0.0:
        plain = at + Event.ARM
    return mem[plain], mem[plain + 1], mem[plain + 2]


@njit(_nrt=False)
def own_state(mem, at, plain):
    """Index of the optional state of the record's input, -1: none; plain: where that of the one without a name
    stands."""
    return int(mem[at + Event.STATE]) if mem[at + Event.INPUT] > 0.0 else int(mem[plain])


@njit(_nrt=False)
def turned(mem, h, n, u_n, u_e, u_d):
    """Add to three rows of H (north, east, down) what an error of attitude does to the vector u of the body, in n."""
    # phi x u
    add(mem, h, Error.PHI_E, u_d)
    add(mem, h, Error.PHI_D, -u_e)
    add(mem, h + n, Error.PHI_N, -u_d)
    add(mem, h + n, Error.PHI_D, u_n)
    add(mem, h + 2 * n, Error.PHI_N, u_e)
    add(mem, h + 2 * n, Error.PHI_E, -u_n)


@njit(_nrt=False)
def body_velocity(mem, r, c, axis):
    """Velocity along one body axis; c: rotation from b to n."""
    return c[axis] * mem[r + Nav.V_N] + c[3 + axis] * mem[r + Nav.V_E] + c[6 + axis] * mem[r + Nav.V_D]


@njit(_nrt=False)
def add_body_velocity(mem, r, h, c, axis, scale):
    """Add to a row of H the derivative of `body_velocity`, times `scale`: an error of attitude turns the body, too.

    C^T v changes by C^T (dv + v x phi).
    """
    x, y, z = scale * c[axis], scale * c[3 + axis], scale * c[6 + axis]
    v_n, v_e, v_d = mem[r + Nav.V_N], mem[r + Nav.V_E], mem[r + Nav.V_D]
    add(mem, h, Error.V_N, x)
    add(mem, h, Error.V_E, y)
    add(mem, h, Error.V_D, z)
    add(mem, h, Error.PHI_N, y * v_d - z * v_e)
    add(mem, h, Error.PHI_E, z * v_n - x * v_d)
    add(mem, h, Error.PHI_D, x * v_e - y * v_n)


@njit(_nrt=False)
def _along(mem, p, n, first, c, axis):
    """Variance along a body axis of the vector of errors in n that begins with `first` (V_N or PHI_N), as far as the
    mechanization has them; p: position of P (n, n)."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            row, column = row_of(mem, first + i), row_of(mem, first + j)
            if row >= 0 and column >= 0:
                total += c[3 * i + axis] * mem[p + n * row + column] * c[3 * j + axis]
    return total


@njit(_nrt=False)
def second_order(mem, n, c, axis, mounting):
    """Variance of (error of the forward speed) times (error of an angle), which no H holds: the product of theirs.

    axis: of the body, about which the angle is; mounting: index of the state that adds to it, or -1. P stands in the
    scratch. A speed that is metres per second off must not pass for an angle (second-order filter; P. S. Maybeck,
    "Stochastic Models, Estimation, and Control", vol. 2, 1982, ch. 12).
    """
    p = int(mem[Head.SCRATCH_AT])
    speed = _along(mem, p, n, Error.V_N, c, 0)
    angle = _along(mem, p, n, Error.PHI_N, c, axis)
    if mounting >= 0:
        angle += mem[p + (n + 1) * mounting]
    return speed * angle


@njit(_nrt=False)
def angular_rate(mem, r, sample):
    """Angular rate of the sample at `sample` less the gyroscope errors estimated at r, rad/s, body axes."""
    return (_rate(mem, r, sample, 0), _rate(mem, r, sample, 1), _rate(mem, r, sample, 2))


@njit(_nrt=False)
def _rate(mem, r, sample, axis):
    """Zero about an axis about which the mechanization does not turn."""
    state = channel_of(mem, 3 + axis)
    return mem[sample + Sample.W_X + axis] - mem[r + NAV + state] if state >= 0 else 0.0
