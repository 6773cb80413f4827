"""Non-holonomic constraint: a land vehicle moves where its wheels roll, neither sideways nor up.

It holds in the vehicle's axes, which differ from the body's (those of the configured mounting), and at the axle that
does not steer, which is not where the IMU is: both differences are optional states. R covers the rest: sideslip in
bends, suspension, cross-fall.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import NAV, Error, Event, Head, Sample, row_of
from ..trust.white_noise import density
from .geometry import add_body_velocity, angular_rate, body_velocity, second_order, vehicle_to_level


@njit(_nrt=False)
def _noise_of_direction(mem, sample, force, turn, innovation, forward):
    """Angle, rad, by which the noise of a gyroscope has turned the axis across which `innovation`, m/s, is seen.

    The share of the gyroscope in the white noise of that velocity: its own times the forward velocity, m/s, and that of
    the accelerometer along the axis. force, turn: the two sensors, as axes of the IMU sample at `sample`.
    """
    by_turn = forward * forward * density(mem, sample, turn)
    total = by_turn + density(mem, sample, force)
    return by_turn / total * innovation / forward if by_turn > 0.0 else 0.0


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Velocity at the axle to the right, and (strapdown) down, vehicle's axes. Returns the number of components.

    Both are linearised at the estimate of the mounting, which may be any angle; `update` subtracts H times it from z.

    A gyroscope's noise turns the row of H and, times the speed, makes the innovation. Both are one error, so each
    correction would take something from the speed, and P would hold that for knowledge of it: with white noise of
    0.2 rad/s an estimate of 26 m/s became 0 within a minute, sigma 0.6 m/s. So the rows are turned back by what of the
    innovation is that noise (`_noise_of_direction`); then they are perpendicular to the velocity where it is all of it.
    """
    yaw, axle, pitch = int(mem[Head.MOUNTING_YAW]), int(mem[Head.AXLE]), int(mem[Head.MOUNTING_PITCH])
    w_x, w_y, w_z = angular_rate(mem, r, sample)
    acceleration = mem[sample + Sample.F_Y]
    turn = mem[r + NAV + yaw] if yaw >= 0 else 0.0
    if turn != 0.0:
        a, b = math.cos(turn), math.sin(turn)
        w_x, w_y = a * w_x + b * w_y, a * w_y - b * w_x
        acceleration = a * acceleration - b * mem[sample + Sample.F_X]
    c = vehicle_to_level(mem, r, c)
    forward = body_velocity(mem, r, c, 0)
    lateral = body_velocity(mem, r, c, 1) + w_z * mem[Head.AXLE_X] - w_x * mem[Head.AXLE_Z]
    lateral -= mem[Head.SIDESLIP] * acceleration * forward  # sideslip of the tyres in a bend
    add_body_velocity(mem, r, h, c, 1, 1.0)
    innovation = lateral
    if axle >= 0:
        mem[h + axle] = -w_z
        innovation += w_z * mem[r + NAV + axle]
    add_body_velocity(mem, r, h, c, 0, -_noise_of_direction(mem, sample, 1, 5, innovation, forward))
    if yaw >= 0:
        mem[h + yaw] = forward
        lateral += forward * turn
    mem[at + Event.Z_N] = lateral
    angle = (mem[Head.ANGLE_SIGMA] * forward) ** 2
    mem[at + Event.R_NN] = (mem[Head.LATERAL_SIGMA] ** 2 + angle
                            + (mem[Head.SLIP_SIGMA] * acceleration * forward) ** 2
                            + second_order(mem, n, c, 2, yaw))
    mem[at + Event.R_NE] = 0.0
    if row_of(mem, Error.V_D) < 0:
        return 1
    vertical = body_velocity(mem, r, c, 2) + w_x * mem[Head.AXLE_Y] - w_y * mem[Head.AXLE_X]
    add_body_velocity(mem, r, h + n, c, 2, 1.0)
    across, innovation = int(mem[Head.AXLE_ACROSS]), vertical
    if axle >= 0:
        mem[h + n + axle] = w_y
        innovation -= w_y * mem[r + NAV + axle]
    if across >= 0:
        mem[h + n + across] = -w_x
        innovation += w_x * mem[r + NAV + across]
    add_body_velocity(mem, r, h + n, c, 0, -_noise_of_direction(mem, sample, 2, 4, innovation, forward))
    if pitch >= 0:
        mem[h + n + pitch] = -forward
        vertical -= forward * mem[r + NAV + pitch]
    mem[at + Event.Z_E] = vertical
    mem[at + Event.R_EE] = mem[Head.VERTICAL_SIGMA] ** 2 + angle + second_order(mem, n, c, 1, pitch)
    return 2
