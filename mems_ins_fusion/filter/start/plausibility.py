"""Checks before the start whether the IMU samples can be what the parameters say: unit, axes, mounting.

Each returns what to wait for, as a text that continues 'waiting for', or '' where nothing is wrong.
"""
from __future__ import annotations

import math

import numpy as np

from ..config import FilterConfig
from .at_rest import STILL_BLOCK, Blocks
from .course import BACKWARDS, DIRECTION_CERTAIN, FASTEST, FASTEST_REVERSE

LARGEST_MOUNTING_TILT = math.radians(40.0)  # rad, largest tilt of an IMU whose mounting is as configured, on any road
LARGEST_TURN_RATE = 3.0  # rad/s, largest mean turn rate of a vehicle over a second
#: m/s^2, smallest mean specific force over a second: gravity with biases
LEAST_GRAVITY = 6.0
#: m/s^2, the largest: the same, and braking
MOST_GRAVITY = 14.0
MOST_G = 2.0  # a mean specific force from 1 / MOST_G to MOST_G is reported as one in g
#: the same where gravity may be missing: from 1 minus this to 1 plus this, as accelerations are of such sizes, too
LEVEL_G = 0.1
#: rad from straight forward or backward: no vehicle with wheels drives off in other directions
SIDEWAYS = math.radians(45.0)
#: s over which the speed is the distance between fixes: their noise is small beside it, and a bend hardly shorter
SPEED_INTERVAL = 4.0
#: number of blocks in motion from which the direction of motion is determined. Chosen, not measured
FEWEST_DRIVEN = 10
MOVING_SIGMAS = 3.0  # standard deviations by which a speed by two fixes has to exceed their noise: seldom by chance
#: m/s^2, smallest standard deviation of the horizontal specific force beside the acceleration: a slope of 1.7 deg
OTHER_FORCE = 0.3
OTHER_FORCE_TIME = 5.0  # s for which a slope of the road lasts. Chosen, not measured
#: rad, directions of motion to the right of the body's forward axis between which `direction_in_motion` decides
QUARTER_TURNS = 0.5 * math.pi * np.array([0.0, 1.0, 2.0, -1.0])


def problem_of_samples(imu: np.ndarray, config: FilterConfig) -> str:
    """Check unit, scale and mounting by the last second of the samples (n, 7 or more): time, f, w in body axes."""
    topic = config.imu.topic
    recent = imu[np.searchsorted(imu[:, 0], imu[-1, 0] - 1.0, side='right'):]
    turn = float(np.abs(recent[:, 4:7].mean(axis=0)).max())
    if turn > LARGEST_TURN_RATE:
        return (f'a possible turn rate on {topic}: angular_velocity is {turn:.1f} rad/s over a second; if the '
                "driver delivers deg/s, set imu.rate_unit to 'deg/s'")
    mean = recent[:, 1:4].mean(axis=0)
    size = float(np.linalg.norm(mean))
    level = config.layout.is_level  # the vertical axis may be missing
    if imu[-1, 0] - imu[0, 0] > 1.0 and not LEAST_GRAVITY < size < MOST_GRAVITY and (
            not level or is_in_g(size, level)):
        return (f'a possible specific force on {topic}: linear_acceleration is {size:.3f} m/s^2 over a second: '
                f'{why_not_gravity(size, level)}')
    if not level and size > 5.0 and -mean[2] < math.cos(LARGEST_MOUNTING_TILT) * size:
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, -mean[2] / size))))
        return (f'an IMU that is mounted as imu.mounting_rpy says: gravity on {topic} is {tilt:.0f} deg off the '
                'vertical of the vehicle (`configure` finds the mounting from a recording)')
    return ''


def is_in_g(size: float, level: bool) -> bool:
    """Whether a mean specific force, m/s^2, is likely gravity in g. level: whether its vertical axis may be missing."""
    return abs(size - 1.0) < LEVEL_G if level else 1.0 / MOST_G < size < MOST_G


def why_not_gravity(size: float, level: bool) -> str:
    """Causes of a mean specific force, m/s^2, that is not gravity. level: as for `is_in_g`."""
    unit = "in g; set imu.acceleration_unit to 'g'" if is_in_g(size, level) else 'a wrong unit or scale'
    removed = not level and size < LEAST_GRAVITY
    return unit + (', or the driver has removed gravity; strapdown needs it in the samples' if removed else '')


def is_backwards(angle: float) -> bool:
    """Whether the direction of driving off, rad to the right of the body's forward axis, is backwards."""
    return abs(angle) > math.pi - SIDEWAYS


def problem_of_direction(angle: float, moves: str) -> str:
    """Check the mounting by the direction in which the vehicle moves, rad to the right of the body's forward axis.

    moves: the verb for what it does.
    """
    if is_backwards(angle):
        return BACKWARDS.format(moves)
    if abs(angle) > SIDEWAYS:
        return (f'an IMU that is mounted as imu.mounting_rpy says: the vehicle {moves} '
                f'{abs(math.degrees(angle)):.0f} deg to the {"right" if angle > 0 else "left"} of its forward axis: '
                f'add {angle:.2f} to the yaw of imu.mounting_rpy')
    return ''


def direction_in_motion(imu: np.ndarray, blocks: Blocks, positions: np.ndarray) -> float | None:
    """Direction of motion that changes of speed and turns show, rad to the right of the body's forward axis; None
    where they do not tell to which of QUARTER_TURNS it is next.

    imu (n, 7 or more): time, specific force and angular rate in body axes, in `blocks`. positions (k, 4): time, north,
    east, sigma. Whatever the tilt of the IMU, the horizontal specific force changes by the acceleration of the vehicle:
    forward by the change of speed, to the right by speed times turn rate. As complex numbers forward + i right, the
    specific force is e^(i direction) times that, plus a constant: the coefficient is found by least squares, and
    compared with those of the four directions.
    """
    middle, time = imu[blocks.starts, 0] + 0.5 * STILL_BLOCK, positions[:, 0]
    inside = (middle > time[0] + SPEED_INTERVAL) & (middle < time[-1] - SPEED_INTERVAL)
    at = middle[inside, None] + SPEED_INTERVAL * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    north, east, sigma = (np.interp(at, time, column) for column in positions[:, 1:].T)
    # over SPEED_INTERVAL, half an interval before, at and half an interval after the middle of each block
    before, speed, after = (np.hypot(north[:, 2:] - north[:, :-2], east[:, 2:] - east[:, :-2]) / SPEED_INTERVAL).T
    noise = math.sqrt(2.0) * sigma.max(axis=1) / SPEED_INTERVAL
    driven = (np.maximum(before, after) < FASTEST) & (
        np.minimum(np.minimum(before, speed), after) > np.maximum(FASTEST_REVERSE, MOVING_SIGMAS * noise))
    if driven.sum() < FEWEST_DRIVEN:
        return None
    mean = blocks.mean[inside][driven]
    acceleration = (after - before)[driven] / SPEED_INTERVAL + 1j * speed[driven] * mean[:, 5]
    force = mean[:, 0] + 1j * mean[:, 1]
    acceleration, force = acceleration - acceleration.mean(), force - force.mean()
    squares = max(float(np.vdot(acceleration, acceleration).real), 1e-9)
    coefficient = np.vdot(acceleration, force) / squares
    other = max(OTHER_FORCE, math.sqrt(0.5 * np.mean(np.abs(force - coefficient * acceleration) ** 2)))
    misfit = np.abs(coefficient - np.exp(1j * QUARTER_TURNS)) ** 2 * squares / (
        other**2 * OTHER_FORCE_TIME / STILL_BLOCK)
    best, second = np.sort(misfit)[:2]
    return float(np.angle(coefficient)) if second - best > DIRECTION_CERTAIN else None
