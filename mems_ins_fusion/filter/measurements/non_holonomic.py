"""A land vehicle moves where its wheels roll: not sideways, and not up.

It holds for the vehicle's axes, which differ from the body's (those of the configured mounting), and at the axle that
does not steer, which is where the IMU is not. Both are optional states. What is left - sideslip in bends,
suspension, cross-fall - is in R.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import NAV, Error, Event, Head, Sample, row_of
from .geometry import add_body_velocity, angular_rate, body_velocity, second_order, vehicle_to_level


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Velocity to the right, and (strapdown) down, at the axle, in the vehicle's axes; the number of components.

    Both are linearised where the mounting's estimate is, which is taken out of z as x will be: it may be any angle.

    What suspension and road do to the velocity across the floor grows with the speed: it is a direction, and tells
    nothing of the speed. A row of H that is not perpendicular to the velocity would make the speed smaller with each
    direction that does not fit, which is the smaller violation: an IMU that the vehicle shakes braked from 36 m/s to
    16 within half a minute. Below the constraint's sigma it is no direction.
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
    lateral -= mem[Head.SIDESLIP] * acceleration * forward  # what the tyres let it slip in a bend
    add_body_velocity(mem, r, h, c, 1, 1.0)
    if yaw >= 0:
        mem[h + yaw] = forward
        lateral += forward * turn
    mem[at + Event.Z_N] = lateral
    if axle >= 0:
        mem[h + axle] = -w_z
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
    direction = innovation * forward / (forward * forward + mem[Head.VERTICAL_SIGMA] ** 2)
    add_body_velocity(mem, r, h + n, c, 0, -direction)
    if pitch >= 0:
        mem[h + n + pitch] = -forward
        vertical -= forward * mem[r + NAV + pitch]
    mem[at + Event.Z_E] = vertical
    mem[at + Event.R_EE] = mem[Head.VERTICAL_SIGMA] ** 2 + angle + second_order(mem, n, c, 1, pitch)
    return 2
