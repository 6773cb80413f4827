"""Non-holonomic constraint: a land vehicle moves where its wheels roll, neither sideways nor up.

It holds in the vehicle's axes, which differ from the body's (those of the configured mounting), and at the axle that
does not steer, which is not where the IMU is: both differences are optional states. R covers the rest: sideslip in
bends, suspension, cross-fall.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import NAV, Error, Event, Head, Sample, row_of
from ..trust.white_noise import COMPARED_OVER, density
from ..update import product
from .geometry import add_body_velocity, angular_rate, axle_of, body_velocity, second_order, vehicle_to_level

#: columns of the event that hold the second-order term of each component (`geometry.second_order`), m^2/s^2. The
#: components are applied one after the other, and there is no third one
SECOND_ORDER = Event.R_NE, Event.R_DD


@njit(_nrt=False)
def _turn_back(mem, r, h, n, c, z, forward, sigma, share):
    """Turn the row of H at `h` back by what an error of the direction has turned its axis, which its innovation shows.

    c: rotation from the vehicle's axes to n. z, forward: measurement and forward velocity, m/s. sigma: of the
    constraint, m/s; at speeds below it the row stays. share: of the innovation.
    """
    innovation = z - product(mem, n, h, r + NAV)
    add_body_velocity(mem, r, h, c, 0, -share * innovation * forward / (forward * forward + sigma * sigma))


@njit(_nrt=False)
def _share_of_direction(mem, sample, axis, forward, ahead, aside, noise):
    """Share of an error of the direction in the white noise of an innovation.

    axis: gyroscope that shows how the direction turns, 4 or 5. forward: velocity, m/s. ahead: of the axle, m. aside:
    its coordinate along the axis of that gyroscope, m. noise: density squared of the accelerometer along the
    constraint, m^2/s^3. The error of a direction and that of a velocity grow with time, here COMPARED_OVER; the turn
    rates of this sample times the place of the axle are noise of this sample alone.
    """
    turns = density(mem, sample, axis)
    direction = COMPARED_OVER * forward * forward * turns
    place = (ahead * ahead * turns + aside * aside * density(mem, sample, 3)) / mem[sample + Sample.INTERVAL]
    return direction / (direction + COMPARED_OVER * noise + place) if direction > 0.0 else 0.0


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Velocity at the axle to the right, and (strapdown) down, vehicle's axes. Returns the number of components.

    Both are linearised at the estimate of the mounting, which may be any angle; `update` subtracts H times it from z.

    An error of the direction turns the row of H and, times the speed, makes the innovation. A correction takes them for
    independent, lowers the speed each time, and makes P smaller: with white noise of 0.2 rad/s of a gyroscope an
    estimate of 26 m/s became 0 within a minute, sigma 0.6 m/s. So the rows are turned back (`_turn_back`), by the
    share of the direction in the innovation (`_share_of_direction`), in the axes of the parameters' mounting.

    What the linearisation omits is not in R, as it is no noise: it stays for as long as the errors do (SECOND_ORDER).
    """
    yaw, pitch = int(mem[Head.MOUNTING_YAW]), int(mem[Head.MOUNTING_PITCH])
    axle, across, below = int(mem[Head.AXLE]), int(mem[Head.AXLE_ACROSS]), int(mem[Head.AXLE_BELOW])
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
    if yaw >= 0:
        mem[h + yaw] = forward
        lateral += forward * turn
    mem[at + Event.Z_N] = lateral
    if axle >= 0:
        mem[h + axle] = -w_z
    if below >= 0:
        mem[h + below] = w_x
    x, y, z = axle_of(mem, r)
    share = _share_of_direction(mem, sample, 5, forward, x, z, density(mem, sample, 1))
    _turn_back(mem, r, h, n, c, lateral, forward, mem[Head.LATERAL_SIGMA], share)
    angle = (mem[Head.ANGLE_SIGMA] * forward) ** 2
    mem[at + Event.R_NN] = (mem[Head.LATERAL_SIGMA] ** 2 + angle
                            + (mem[Head.SLIP_SIGMA] * acceleration * forward) ** 2)
    mem[at + SECOND_ORDER[0]] = second_order(mem, n, c, 2, yaw)
    if row_of(mem, Error.V_D) < 0:
        return 1
    vertical = body_velocity(mem, r, c, 2) + w_x * mem[Head.AXLE_Y] - w_y * mem[Head.AXLE_X]
    add_body_velocity(mem, r, h + n, c, 2, 1.0)
    if axle >= 0:
        mem[h + n + axle] = w_y
    if across >= 0:
        mem[h + n + across] = -w_x
    if pitch >= 0:
        mem[h + n + pitch] = -forward
        vertical -= forward * mem[r + NAV + pitch]
    share = _share_of_direction(mem, sample, 4, forward, x, y, density(mem, sample, 2))
    _turn_back(mem, r, h + n, n, c, vertical, forward, mem[Head.VERTICAL_SIGMA], share)
    mem[at + Event.Z_E] = vertical
    mem[at + Event.R_EE] = mem[Head.VERTICAL_SIGMA] ** 2 + angle
    mem[at + SECOND_ORDER[1]] = second_order(mem, n, c, 1, pitch)
    return 2
