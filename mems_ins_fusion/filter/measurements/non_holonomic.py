"""A land vehicle moves where its wheels roll: not sideways, and not up.

It holds for the vehicle's axes, which differ from the body's (those of the configured mounting) by small angles, and at
the axle that does not steer, which is where the IMU is not. Both are optional states. What is left - sideslip in bends,
suspension, cross-fall - is in R.
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..layout import NAV, PLANAR, Event, Head, Sample
from .geometry import add_body_velocity, angular_rate, body_velocity, second_order


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Velocity to the right, and (strapdown) down, at the axle; the number of components."""
    w_x, w_y, w_z = angular_rate(mem, r, sample)
    forward = body_velocity(mem, r, c, 0)
    lateral = body_velocity(mem, r, c, 1) + w_z * mem[Head.AXLE_X] - w_x * mem[Head.AXLE_Z]
    acceleration = mem[sample + Sample.F_Y]
    lateral -= mem[Head.SIDESLIP] * acceleration * forward  # what the tyres let it slip in a bend
    mem[at + Event.Z_N] = lateral
    add_body_velocity(mem, r, h, c, 1, 1.0)
    yaw, axle, pitch = int(mem[Head.MOUNTING_YAW]), int(mem[Head.AXLE]), int(mem[Head.MOUNTING_PITCH])
    if yaw >= 0:
        mem[h + yaw] = forward
        # across the vehicle's axis, not the body's: else an error of the speed passes for one across
        add_body_velocity(mem, r, h, c, 0, -mem[r + NAV + yaw])
    if axle >= 0:
        mem[h + axle] = -w_z
    angle = (mem[Head.ANGLE_SIGMA] * forward) ** 2
    mem[at + Event.R_NN] = (mem[Head.LATERAL_SIGMA] ** 2 + angle
                            + (mem[Head.SLIP_SIGMA] * acceleration * forward) ** 2
                            + second_order(mem, n, c, 2, yaw))
    mem[at + Event.R_NE] = 0.0
    if mem[Head.MECHANIZATION] == PLANAR:
        return 1
    mem[at + Event.Z_E] = body_velocity(mem, r, c, 2) + w_x * mem[Head.AXLE_Y] - w_y * mem[Head.AXLE_X]
    add_body_velocity(mem, r, h + n, c, 2, 1.0)
    if pitch >= 0:
        mem[h + n + pitch] = -forward
        add_body_velocity(mem, r, h + n, c, 0, mem[r + NAV + pitch])
    if axle >= 0:
        mem[h + n + axle] = w_y
    across = int(mem[Head.AXLE_ACROSS])
    if across >= 0:
        mem[h + n + across] = -w_x
    mem[at + Event.R_EE] = mem[Head.VERTICAL_SIGMA] ** 2 + angle + second_order(mem, n, c, 1, pitch)
    return 2
