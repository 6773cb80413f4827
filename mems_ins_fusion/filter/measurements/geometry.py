"""Rotations and body velocities of a state, with their derivatives, for the measurements that need them."""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ...navigation import strapdown
from ..memory import NAV, PLANAR, Error, Event, Head, Nav, Sample, channel_of, row_of
from ..trust import imu_share
from ..trust.imu_share import Difference, Share


@njit(_nrt=False)
def body_to_level(mem, r):
    """Rotation from b to n of the state at r: nine numbers, row by row."""
    if mem[Head.MECHANIZATION] == PLANAR:
        c, s = math.cos(mem[r + Nav.YAW]), math.sin(mem[r + Nav.YAW])
        return c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0
    return strapdown.matrix((mem[r + Nav.Q_W], mem[r + Nav.Q_X], mem[r + Nav.Q_Y], mem[r + Nav.Q_Z]))


@njit(_nrt=False)
def turn_attitude(mem, r, north, east, down):
    """Correct the attitude of the state at r by the small error (north, east, down), rad."""
    if mem[Head.MECHANIZATION] == PLANAR:
        mem[r + Nav.YAW] -= down
        return
    q = (mem[r + Nav.Q_W], mem[r + Nav.Q_X], mem[r + Nav.Q_Y], mem[r + Nav.Q_Z])
    mem[r + Nav.Q_W], mem[r + Nav.Q_X], mem[r + Nav.Q_Y], mem[r + Nav.Q_Z] = strapdown.correct_attitude(
        q, north, east, down)


@njit(_nrt=False)
def set_heading(mem, r, yaw):
    """Set the heading of the body in the state at r to `yaw`, rad; roll and pitch stay."""
    if mem[Head.MECHANIZATION] == PLANAR:
        mem[r + Nav.YAW] = yaw
        return
    roll, pitch, _ = strapdown.to_euler((mem[r + Nav.Q_W], mem[r + Nav.Q_X], mem[r + Nav.Q_Y], mem[r + Nav.Q_Z]))
    mem[r + Nav.Q_W], mem[r + Nav.Q_X], mem[r + Nav.Q_Y], mem[r + Nav.Q_Z] = strapdown.from_euler(roll, pitch, yaw)


@njit(_nrt=False)
def yaw_of(c):
    """Yaw of the body, rad; c: rotation from b to n."""
    return math.atan2(c[3], c[0])


@njit(_nrt=False)
def rotate(c, x, y, z):
    """The body-axis vector (x, y, z) in n; c: rotation from b to n."""
    return (c[0] * x + c[1] * y + c[2] * z, c[3] * x + c[4] * y + c[5] * z, c[6] * x + c[7] * y + c[8] * z)


@njit(_nrt=False)
def vehicle_to_level(mem, r, c):
    """Rotation from the vehicle's axes to n; c: rotation from b to n.

    The estimated mounting rotates the vehicle's axes in b about z by its yaw, then about y by its pitch. No small-angle
    approximation: the mounting may be far from the configured one.
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
    """Add `value` to the column of one of the nine navigation errors in the row of H at `h`; does nothing where the
    mechanization does not have that error."""
    state = row_of(mem, error)
    if state >= 0:
        mem[h + state] += value


@njit(_nrt=False)
def arm_of(mem, at):
    """Lever arm from the IMU to the point of measurement of the event at `at`, body axes, m."""
    return mem[at + Event.ARM], mem[at + Event.ARM + 1], mem[at + Event.ARM + 2]


@njit(_nrt=False)
def axle_of(mem, r):
    """Lever arm from the IMU to the point that does not go sideways, as estimated at r, body axes, m."""
    x, y, z = mem[Head.AXLE_X], mem[Head.AXLE_Y], mem[Head.AXLE_Z]
    axle, across, below = int(mem[Head.AXLE]), int(mem[Head.AXLE_ACROSS]), int(mem[Head.AXLE_BELOW])
    if axle >= 0:
        x += mem[r + NAV + axle]
    if across >= 0:
        y += mem[r + NAV + across]
    if below >= 0:
        z += mem[r + NAV + below]
    return x, y, z


@njit(_nrt=False)
def add_attitude_error(mem, h, n, u_n, u_e, u_d):
    """Add to three rows of H (north, east, down) the derivative phi x u of a body-fixed vector u, given in n."""
    add(mem, h, Error.PHI_E, u_d)
    add(mem, h, Error.PHI_D, -u_e)
    add(mem, h + n, Error.PHI_N, -u_d)
    add(mem, h + n, Error.PHI_D, u_n)
    add(mem, h + 2 * n, Error.PHI_N, u_e)
    add(mem, h + 2 * n, Error.PHI_E, -u_n)


@njit(_nrt=False)
def along(vector, c, axis):
    """Component along one body axis of a vector in n; c: rotation from b to n."""
    return c[axis] * vector[0] + c[3 + axis] * vector[1] + c[6 + axis] * vector[2]


@njit(_nrt=False)
def body_velocity(mem, r, c, axis):
    """Velocity along one body axis; c: rotation from b to n."""
    return along((mem[r + Nav.V_N], mem[r + Nav.V_E], mem[r + Nav.V_D]), c, axis)


@njit(_nrt=False)
def add_body_velocity(mem, r, h, c, axis, scale):
    """Add to a row of H `scale` times the derivative of `body_velocity`: C^T v changes by C^T (dv + v x phi)."""
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
    """Variance along a body axis of an error vector in n: the three errors from `first` on (V_N or PHI_N), as far as
    they are states. p: position of P (n, n)."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            row, column = row_of(mem, first + i), row_of(mem, first + j)
            if row >= 0 and column >= 0:
                total += c[3 * i + axis] * mem[p + n * row + column] * c[3 * j + axis]
    return total


@njit(_nrt=False)
def second_order(mem, n, c, axis, mounting):
    """Second-order term of a constraint: variance of (error of forward speed) x (error of angle), m^2/s^2.

    The linearisation omits this product (P. S. Maybeck, "Stochastic Models, Estimation, and Control", vol. 2, 1982,
    ch. 12). axis: body axis of the angle.
    mounting: index of the mounting state that adds to the angle, or -1. P is at the start of the scratch.
    """
    p = int(mem[Head.SCRATCH_AT])
    speed = _along(mem, p, n, Error.V_N, c, 0)
    angle = _along(mem, p, n, Error.PHI_N, c, axis)
    if mounting >= 0:
        angle += mem[p + (n + 1) * mounting]
    return speed * angle


@njit(_nrt=False)
def angular_rate(mem, r, sample):
    """Angular rate of the IMU sample at `sample` minus the gyroscope errors estimated at r, rad/s, body axes."""
    return (_rate(mem, r, sample, 0), _rate(mem, r, sample, 1), _rate(mem, r, sample, 2))


@njit(_nrt=False)
def _rate(mem, r, sample, axis):
    """One component of `angular_rate`; zero where the mechanization does not use that gyroscope."""
    state = channel_of(mem, 3 + axis)
    if state < 0:
        return 0.0
    return mem[sample + Sample.W_X + axis] - mem[r + NAV + state] - imu_share.error(mem, r, sample, 3 + axis)


@njit(_nrt=False)
def sensor_error(mem, r, sample, axis):
    """Error of sensor `axis` (0 to 5: f_x ... w_z, one that is used) of the sample at `sample`, as estimated at r."""
    return mem[r + NAV + channel_of(mem, axis)] + imu_share.error(mem, r, sample, axis)


@njit(_nrt=False)
def add_sensor_error(mem, h, sample, axis, factor):
    """Add `factor` times the error of sensor `axis` to the row of H at `h`: that of the sensor and, of two IMUs, that
    by the share. Returns `factor` times what has been subtracted from the sample for the share, which is to be added to
    z, as `update` subtracts H times the whole estimate."""
    mem[h + channel_of(mem, axis)] += factor
    if mem[Share.STATE] == 0.0:
        return 0.0
    difference = factor * mem[sample + Difference.VALUE + axis]
    mem[h + int(mem[Share.STATE])] += difference
    return mem[sample + Difference.TAKEN] * difference
