"""Conversion of a running filter to another mounting of the IMU (`imu.mounting_rpy`).

If the filter estimates the mounting, another value of the parameter only changes the axes b in which the state is
written. With D the rotation from the old axes to the new ones, a vector v in b becomes D v, the attitude C_bn becomes
C_bn D^T, and the estimated mounting is computed such that the vehicle's forward axis stays the same. Errors of
position, velocity and attitude are in n and do not change. Lever arms are given in the axes of the parameter and keep
their numbers, so the position of the IMU is moved such that the antenna, which the fixes measure, stays in place.
"""
from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ...navigation.strapdown import from_euler, matrix, multiply
from ..bank import Bank
from ..config import MOUNTING_STATES, FilterConfig
from ..measurements.magnetometer import Magnetometer
from ..memory import NAV, Head, Nav, Sample, StateLayout, covariance, set_covariance, views
from ..trust.drift import Drift
from ..trust.gyroscopes import Gyroscopes
from ..trust.imu_share import Difference
from ..trust.standstill import Still

MOUNTING = 'imu.mounting_rpy'  # the parameter that changes


def turns_into(config: FilterConfig, values: Mapping) -> bool:
    """Whether a running filter with `config` can be turned into one with the checked parameters `values`: only the
    mounting differs, and the filter estimates it. A magnetometer's axes and its iron would have to be turned as well.
    """
    return (values != config.parameters and {**config.parameters, MOUNTING: values[MOUNTING]} == values
            and _can_be_turned(config))


def _can_be_turned(config: FilterConfig) -> bool:
    magnetic = any(isinstance(one, Magnetometer) and config.settings_of(number).topic
                   for number, one in config.inputs.items())
    return not magnetic and all(config.layout.index(name) >= 0 for name in MOUNTING_STATES)


def warm_up(config: FilterConfig) -> None:
    """Compile or load what `turn` calls, so that the sample at which it is called is not delayed."""
    if _can_be_turned(config):
        memory = config.memory()
        views(memory)[2][0, Nav.Q_W] = 1.0
        turn(memory, config, config)


def turn(memory: np.ndarray, before: FilterConfig, after: FilterConfig) -> None:
    """Write the filter in `memory`, of `before`, in the axes of `after` (`turns_into`), in place."""
    rotation = after.imu.mounting @ before.imu.mounting.T
    both = np.kron(np.eye(2), rotation)
    size = int(memory[Bank.SIZE])
    # the second filter (bank.py) follows the first; where there is none, one will begin as a copy of the first
    for one in (memory, memory[size:]) if memory[Bank.OPEN] else (memory,):
        head, _, rows, ring, _ = views(one)
        constant = before.offset - head[Head.OFFSET:Head.OFFSET + 6]
        head[Head.CONDITIONING:Head.CONDITIONING + 36] = after.conditioning.T.ravel()
        head[Head.OFFSET:Head.OFFSET + 6] = after.offset - both @ constant
        for column in (Still.FIRST, Still.SECOND, Still.MEAN):
            head[column:column + 3] = rotation @ head[column:column + 3]
        ring[:, Sample.F_X:Sample.W_Z + 1] = ring[:, Sample.F_X:Sample.W_Z + 1] @ both.T
        ring[:, Difference.VALUE:Difference.GIVEN] = ring[:, Difference.VALUE:Difference.GIVEN] @ both.T
        rows[:, Drift.BIAS:Drift.BIAS + 6] = rows[:, Drift.BIAS:Drift.BIAS + 6] @ both.T
        rows[:, Gyroscopes.BEFORE:Gyroscopes.BEFORE + 3] = rows[:, Gyroscopes.BEFORE:Gyroscopes.BEFORE + 3] @ rotation.T
        for row in rows:
            _turn_state(row, after.layout, rotation, head[Head.LEVER_X:Head.LEVER_X + 3])


def _turn_state(row: np.ndarray, layout: StateLayout, rotation: np.ndarray, lever: np.ndarray) -> None:
    """Convert one state. rotation (3, 3): from the old axes to the new ones. lever: (3,) m, of the antenna."""
    attitude = row[Nav.Q_W:Nav.Q_Z + 1]
    if not attitude.any():  # no state yet
        return
    was = np.array(matrix(tuple(attitude))).reshape(3, 3)
    attitude[:] = multiply(tuple(attitude), _quaternion(rotation.T))
    north, east, down = was @ (lever - rotation.T @ lever)
    row[Nav.LATITUDE] += north * row[Nav.NORTH_SCALE]
    row[Nav.LONGITUDE] += east * row[Nav.EAST_SCALE]
    row[Nav.HEIGHT] -= down
    n, m = layout.n_navigation, layout.n_sensor
    x = row[NAV + n:NAV + n + m]
    sensors = np.kron(np.kron(np.eye(2), rotation), np.eye(layout.order))
    x[:] = sensors @ x
    states = [layout.index(name) for name in MOUNTING_STATES]
    angles = row[[NAV + state for state in states]]
    change = np.eye(layout.n)
    change[n:n + m, n:n + m] = sensors
    change[np.ix_(states, states)] = _slope(angles, rotation)
    row[[NAV + state for state in states]] = _turned(angles, rotation)
    set_covariance(row, layout, change @ covariance(row, layout) @ change.T)


def _quaternion(c: np.ndarray) -> tuple[float, float, float, float]:
    """w, x, y, z of the rotation matrix c (3, 3)."""
    return from_euler(math.atan2(c[2, 1], c[2, 2]), -math.asin(min(max(c[2, 0], -1.0), 1.0)),
                      math.atan2(c[1, 0], c[0, 0]))


def _turned(angles: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Yaw and pitch (2,) of the vehicle's forward axis in the new axes, from those in the old ones, rad."""
    (sy, sp), (cy, cp) = np.sin(angles), np.cos(angles)
    x, y, z = rotation @ [cy * cp, sy * cp, -sp]
    return np.array([np.arctan2(y, x), np.arctan2(-z, np.hypot(x, y))])


def _slope(angles: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Derivative (2, 2) of `_turned`."""
    (sy, sp), (cy, cp) = np.sin(angles), np.cos(angles)
    x, y, _ = rotation @ [cy * cp, sy * cp, -sp]
    across = rotation @ [[-sy * cp, -cy * sp], [cy * cp, -sy * sp], [0.0, -cp]]
    level = np.hypot(x, y)
    return np.array([(x * across[1] - y * across[0]) / level**2, -across[2] / level])
