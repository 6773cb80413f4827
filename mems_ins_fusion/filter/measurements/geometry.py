"""What several measurements need of a state: its rotation and its velocity in the body, with their derivatives."""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ...navigation import planar, strapdown
from ..layout import NAV, PLANAR, Head, Nav, Sample


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
def turned(mem, h, n, u_n, u_e, u_d):
    """Add to three rows of H (north, east, down) what an error of attitude does to the vector u of the body, in n."""
    if mem[Head.MECHANIZATION] == PLANAR:
        mem[h + planar.State.YAW] -= u_e
        mem[h + n + planar.State.YAW] += u_n
        return
    # phi x u
    mem[h + strapdown.State.PHI_E] += u_d
    mem[h + strapdown.State.PHI_D] -= u_e
    mem[h + n + strapdown.State.PHI_N] -= u_d
    mem[h + n + strapdown.State.PHI_D] += u_n
    mem[h + 2 * n + strapdown.State.PHI_N] += u_e
    mem[h + 2 * n + strapdown.State.PHI_E] -= u_n


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
    if mem[Head.MECHANIZATION] == PLANAR:
        mem[h + planar.State.V_N] += x
        mem[h + planar.State.V_E] += y
        mem[h + planar.State.YAW] += x * v_e - y * v_n
        return
    mem[h + strapdown.State.V_N] += x
    mem[h + strapdown.State.V_E] += y
    mem[h + strapdown.State.V_D] += z
    mem[h + strapdown.State.PHI_N] += y * v_d - z * v_e
    mem[h + strapdown.State.PHI_E] += z * v_n - x * v_d
    mem[h + strapdown.State.PHI_D] += x * v_e - y * v_n


@njit(_nrt=False)
def _along(mem, p, n, k, c, axis):
    """Variance of the vector whose errors in n are the states from k on, along a body axis; p: position of P (n, n)."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += c[3 * i + axis] * mem[p + n * (k + i) + k + j] * c[3 * j + axis]
    return total


@njit(_nrt=False)
def second_order(mem, n, c, axis, mounting):
    """Variance of (error of the forward speed) times (error of an angle), which no H holds: the product of theirs.

    axis: of the body, about which the angle is; mounting: index of the state that adds to it, or -1. P stands in the
    scratch. A speed that is metres per second off must not pass for an angle (second-order filter; P. S. Maybeck,
    "Stochastic Models, Estimation, and Control", vol. 2, 1982, ch. 12).
    """
    p = int(mem[Head.SCRATCH_AT])
    if mem[Head.MECHANIZATION] == PLANAR:
        s, a, b = planar.State, c[0], c[3]
        v = p + n * s.V_N + s.V_N
        speed = a * a * mem[v] + 2.0 * a * b * mem[v + 1] + b * b * mem[v + n + 1]
        angle = mem[p + (n + 1) * s.YAW]
    else:
        speed = _along(mem, p, n, strapdown.State.V_N, c, 0)
        angle = _along(mem, p, n, strapdown.State.PHI_N, c, axis)
    if mounting >= 0:
        angle += mem[p + (n + 1) * mounting]
    return speed * angle


@njit(_nrt=False)
def angular_rate(mem, r, sample):
    """Angular rate of the sample at `sample` less the gyroscope errors estimated at r, rad/s, body axes."""
    x, p = r + Nav.SIZE + int(mem[Head.N_NAVIGATION]), int(mem[Head.ORDER])
    if mem[Head.MECHANIZATION] == PLANAR:
        return 0.0, 0.0, mem[sample + Sample.W_Z] - mem[x + 2 * p]
    return (mem[sample + Sample.W_X] - mem[x + 3 * p], mem[sample + Sample.W_Y] - mem[x + 4 * p],
            mem[sample + Sample.W_Z] - mem[x + 5 * p])
