"""The first row of the filter's memory, from what the alignment found."""
from __future__ import annotations

import math

import numpy as np

from ..navigation.earth import gravity
from ..navigation.strapdown import from_euler, matrix
from .alignment import Start, channel_prior, leveled
from .config import FilterConfig
from .layout import NAV, PLANAR, Head, Nav, Sample, set_covariance, views
from .prediction import set_radii

UNKNOWN_TILT_SIGMA = 0.05  # rad, roll and pitch where no standstill showed them
#: of the tilt that a standstill takes out: on a parking place nobody has surveyed
TILT_SIGMA = 0.3  # m/s^2, 2 deg times gravity


def initialize(memory: np.ndarray, config: FilterConfig, start: Start) -> None:
    """Write the first state into `memory` (of `config.memory()`)."""
    head, _, rows, ring, _ = views(memory)
    conditioning, offset = config.conditioning, config.offset
    still = start.standstill
    # the planar filter has no attitude: what the standstill shows of it is taken out of the samples
    level = config.alignment.level and still is not None and config.mechanization == PLANAR
    if level:
        conditioning, offset = leveled(config, still)
    estimate, covariance, constant = _sensor_errors(config, start, level)
    offset = offset.copy()
    offset[config.channel_axes] -= constant
    head[Head.CONDITIONING:Head.CONDITIONING + 36] = conditioning.ravel()
    head[Head.OFFSET:Head.OFFSET + 6] = offset

    row, layout = rows[0], config.layout
    row[:] = 0.0
    row[Nav.TIME], row[Nav.LATITUDE], row[Nav.LONGITUDE], row[Nav.HEIGHT] = (
        start.time, start.latitude, start.longitude, start.height)
    row[Nav.V_N], row[Nav.V_E] = start.velocity
    row[Nav.GNSS_RATIO] = 1.0
    full = np.zeros((layout.n, layout.n))
    full[layout.n_navigation:, layout.n_navigation:] = covariance
    if config.mechanization == PLANAR:
        row[Nav.YAW] = start.yaw
        full[:5, :5] = start.covariance
    else:
        _strapdown_attitude(config, row, full, start, level)
    _turn_into_vehicle(config, full)
    row[NAV + layout.n_navigation:NAV + layout.n] = estimate
    set_covariance(row, layout, full)
    set_radii(memory, int(head[Head.ROWS_AT]))
    ring[0, Sample.TIME] = start.time


def _turn_into_vehicle(config: FilterConfig, full: np.ndarray) -> None:
    """The start's heading is the vehicle's; that of the body is off by the mounting's yaw, if this is not exact."""
    layout = config.layout
    mounting, yaw = layout.index('mounting_yaw'), layout.n_navigation - 1
    if mounting >= 0:
        full[yaw, yaw] += full[mounting, mounting]
        full[yaw, mounting] = full[mounting, yaw] = full[mounting, mounting]


def _sensor_errors(config: FilterConfig, start: Start, level: bool):
    """Estimate (m,), covariance (m, m) and constant part (channels,) of the states behind the navigation errors."""
    p, m = config.layout.order, config.layout.n_augmented
    estimate, covariance, constant = np.zeros(m), np.zeros((m, m)), np.zeros(len(config.models))
    still = start.standstill
    span = (still.duration, start.time - still.end) if still else (0.0, 0.0)
    for channel, (model, axis) in enumerate(zip(config.models, config.channel_axes)):
        block = slice(channel * p, (channel + 1) * p)
        mean, sigma = _shown(config, start, axis, level), config.turn_on_sigma[channel]
        if axis < 2 and config.mechanization != PLANAR:
            mean = None  # tilt and bias stay one: see _strapdown_attitude
        elif axis < 2 and level:
            sigma = math.hypot(sigma, TILT_SIGMA)
        estimate[block], covariance[block, block], constant[channel] = channel_prior(
            model, sigma, config.white[axis], mean, *span)
    for state, extra in enumerate(config.extras, start=config.layout.n_sensor):
        covariance[state, state] = extra.initial_sigma**2
    return estimate, covariance, constant


def _shown(config: FilterConfig, start: Start, axis: int, level: bool) -> float | None:
    """What the standstill showed of the error of one body axis."""
    still = start.standstill
    if still is None:
        return None
    if axis >= 3:
        return float(still.angular_rate[axis - 3])
    if axis == 2:  # the size of gravity is known
        return float(gravity(start.latitude, start.height) - np.linalg.norm(still.specific_force))
    return 0.0 if level else float(still.specific_force[axis])


def _strapdown_attitude(config: FilterConfig, row: np.ndarray, full: np.ndarray, start: Start, level: bool) -> None:
    """Attitude and covariance of the nine navigation errors.

    Leveled at standstill, the attitude error and the errors of f_x, f_y are one: g phi_e = df_n, g phi_n = -df_e.
    Not leveled, the standstill's specific force is taken as it is for roll and pitch; never at rest, both start at 0.
    """
    roll = pitch = 0.0
    if start.standstill is not None and not level:
        f = start.standstill.specific_force
        roll, pitch = math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2]))
    q = from_euler(roll, pitch, start.yaw)
    row[Nav.Q_W], row[Nav.Q_X], row[Nav.Q_Y], row[Nav.Q_Z] = q
    planar = [0, 1, 3, 4, 8]
    full[np.ix_(planar, planar)] = start.covariance
    full[2, 2] = 4 * max(start.covariance[0, 0], start.covariance[1, 1])
    full[5, 5] = 0.2**2
    if start.standstill is None:
        full[6, 6] = full[7, 7] = UNKNOWN_TILT_SIGMA**2
        return
    g = gravity(start.latitude, start.height)
    c = np.array(matrix(q)).reshape(3, 3)
    coupling = np.zeros((3, config.layout.n_augmented))  # phi = coupling x
    for axis in range(2):
        state = axis * config.layout.order
        coupling[0, state], coupling[1, state] = -c[1, axis] / g, c[0, axis] / g
    sensor = full[9:, 9:]
    full[6:9, 6:9] += coupling @ sensor @ coupling.T + np.diag([0.002**2, 0.002**2, 0])
    full[6:9, 9:] = coupling @ sensor
    full[9:, 6:9] = full[6:9, 9:].T
