"""Checks before the start whether the IMU samples can be what the parameters say: unit, axes, mounting.

Each returns what to wait for, as a text that continues 'waiting for', or '' where nothing is wrong.
"""
from __future__ import annotations

import math

import numpy as np

from ..config import FilterConfig
from .course import FASTEST_REVERSE

LARGEST_TILT = math.radians(40.0)  # rad, largest tilt of an IMU whose mounting is as configured, on any road
FASTEST_TURN = 3.0  # rad/s, largest mean turn rate of a vehicle over a second
#: m/s^2, smallest mean specific force over a second: gravity with biases
LEAST_GRAVITY = 6.0
#: m/s^2, the largest: the same, and braking
MOST_GRAVITY = 14.0
MOST_G = 2.0  # a mean specific force from 1 / MOST_G to MOST_G is reported as one in g
#: rad from straight forward or backward: no vehicle with wheels drives off in other directions
SIDEWAYS = math.radians(45.0)


def problem_of_samples(imu: np.ndarray, config: FilterConfig) -> str:
    """Check unit, scale and mounting by the last second of the samples (n, 7 or more): time, f, w in body axes."""
    topic = config.imu.topic
    recent = imu[np.searchsorted(imu[:, 0], imu[-1, 0] - 1.0, side='right'):]
    turn = float(np.abs(recent[:, 4:7].mean(axis=0)).max())
    if turn > FASTEST_TURN:
        return (f'a possible turn rate on {topic}: angular_velocity is {turn:.1f} rad/s over a second; if the '
                "driver delivers deg/s, set imu.rate_unit to 'deg/s'")
    mean = recent[:, 1:4].mean(axis=0)
    size = float(np.linalg.norm(mean))
    level = config.layout.is_level  # the vertical axis may be missing
    if imu[-1, 0] - imu[0, 0] > 1.0 and not LEAST_GRAVITY < size < MOST_GRAVITY and (
            not level or abs(size - 1.0) < 0.1):
        unit = "in g; set imu.acceleration_unit to 'g'" if 1.0 / MOST_G < size < MOST_G else 'a wrong unit or scale'
        return (f'a possible specific force on {topic}: linear_acceleration is {size:.3f} m/s^2 over a second, '
                f'gravity included: {unit}')
    if not level and size > 5.0 and -mean[2] < math.cos(LARGEST_TILT) * size:
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, -mean[2] / size))))
        return (f'an IMU that is mounted as imu.mounting_rpy says: gravity on {topic} is {tilt:.0f} deg off the '
                'vertical of the vehicle (`configure` finds the mounting from a recording)')
    return ''


def is_backwards(angle: float) -> bool:
    """Whether the direction of driving off, rad to the right of the body's forward axis, is backwards."""
    return abs(angle) > math.pi - SIDEWAYS


def problem_of_driving_off(angle: float, speed: float) -> str:
    """Check the mounting by the direction (as for `is_backwards`) and the speed, m/s, at which the vehicle drives off.
    """
    if is_backwards(angle) and speed > FASTEST_REVERSE:
        return (f'the vehicle to drive forwards: it drives off backwards at {speed:.1f} m/s; if it does not, the IMU '
                'is mounted the other way round: turn the yaw of imu.mounting_rpy by pi')
    if SIDEWAYS < abs(angle) < math.pi - SIDEWAYS:
        return (f'an IMU that is mounted as imu.mounting_rpy says: the vehicle drives off '
                f'{abs(math.degrees(angle)):.0f} deg to the {"right" if angle > 0 else "left"} of its forward axis: '
                f'add {angle:.2f} to the yaw of imu.mounting_rpy')
    return ''
