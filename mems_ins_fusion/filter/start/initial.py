"""The first row of the filter's memory, from a `Start`; and the sensor errors that are kept from one run to the next.
"""
from __future__ import annotations

import math

import numpy as np

from ...navigation.earth import gravity
from ...navigation.frames import leveling
from ...navigation.strapdown import from_euler, matrix
from ..config import REPEATED_TURN_ON, FilterConfig
from ..measurements import wheel_vibration
from ..measurements.position import NO_ALTITUDE_SIGMA
from ..memory import NAV, ROW, Error, Head, Nav, Sample, newest_row, set_covariance, variance_factor, views
from ..memory import covariance as covariance_of
from ..prediction import UNKNOWN_TILT_SIGMA, set_radii
from ..trust.contradiction import FIRST_USUAL
from ..trust.receiver import Receiver
from ..trust.scale import Scale
from .start import Iron, SensorErrors, Standstill, Start

#: m/s^2, gravity on the slope of a parking place (2 deg), which the planar filter removes with the tilt of the IMU
TILT_SIGMA = 0.3
STILL_LEVEL_SIGMA = 0.002  # rad, standard deviation of roll and pitch from a standstill, besides accelerometer errors
VERTICAL_SPEED_SIGMA = 0.2  # m/s, standard deviation of the vertical velocity at the start
STILL_STEPS = 1024  # steps in which a continuous-time process is followed through a standstill


def initialize(memory: np.ndarray, config: FilterConfig, start: Start) -> None:
    """Write the first state into `memory` (of `config.memory()`)."""
    head, _, rows, ring, _ = views(memory)
    conditioning, offset = config.conditioning, config.offset
    still = start.standstill
    level = config.alignment.level and still is not None
    if level:
        conditioning, offset = leveled(config, still)
    estimate, covariance, constant = _sensor_errors(config, start, level)
    offset = offset.copy()
    offset[config.channel_axes] -= constant
    head[Head.CONDITIONING:Head.CONDITIONING + 36] = conditioning.T.ravel()
    head[Head.OFFSET:Head.OFFSET + 6] = offset

    row, layout = rows[0], config.layout
    row[:] = 0.0
    row[Nav.TIME], row[Nav.LATITUDE], row[Nav.LONGITUDE], row[Nav.HEIGHT] = (
        start.time, start.latitude, start.longitude, start.height)
    row[Nav.V_N], row[Nav.V_E] = start.velocity
    row[Nav.USUAL_SLIDING_NIS] = FIRST_USUAL
    row[Nav.VARIANCE_FACTOR] = 1.0
    row[Nav.ARM_VARIANCE] = config.gnss.lever_arm_sigma**2
    ROW.begin(row)
    row[Receiver.SCALE:Receiver.SCALE + Scale.CHANGING_SIZE] = start.gnss_scale
    full = np.zeros((layout.n, layout.n))
    full[layout.n_navigation:, layout.n_navigation:] = covariance
    mounting = layout.index('mounting_yaw') - layout.n_navigation
    yaw = start.yaw - (estimate[mounting] if mounting >= 0 else 0.0)  # of the body
    states = [layout.rows[error] for error in (Error.R_N, Error.R_E, Error.V_N, Error.V_E, Error.PHI_D)]
    full[np.ix_(states, states)] = start.covariance
    if layout.is_level:
        row[Nav.YAW] = yaw
    else:
        # estimated errors of the two horizontal accelerometers
        errors = estimate[:2 * layout.order:layout.order] + constant[:2]
        _strapdown_attitude(config, row, full, start, yaw, errors)
    if start.iron is None:
        _correlate_with_mounting(config, full)
    else:  # a magnetic heading is that of the body
        _take_iron(config, start.iron, estimate, full)
    row[NAV + layout.n_navigation:NAV + layout.n] = estimate
    set_covariance(row, layout, full)
    set_radii(memory, int(head[Head.ROWS_AT]))
    ring[0, Sample.TIME] = start.time
    wheel_vibration.restore(memory, start.wheels)


def _correlate_with_mounting(config: FilterConfig, full: np.ndarray) -> None:
    """The heading of the start is the vehicle's, so that of the body contains the error of the mounting's yaw."""
    layout = config.layout
    mounting, yaw = layout.index('mounting_yaw'), layout.n_navigation - 1
    if mounting >= 0:
        full[yaw] += full[mounting]
        full[:, yaw] += full[:, mounting]


def _take_iron(config: FilterConfig, iron: Iron, estimate: np.ndarray, full: np.ndarray) -> None:
    """Write estimate and covariance of the iron that was found with a magnetic heading, and its correlation with the
    heading, to `estimate` and `full`."""
    layout = config.layout
    states, yaw = [layout.index(name) for name in iron.names], layout.n_navigation - 1
    if min(states) < 0:  # a filter without magnetometer
        return
    estimate[np.array(states) - layout.n_navigation] = iron.estimate
    full[states] = full[:, states] = 0.0
    full[states] = np.outer(iron.by_yaw, full[yaw])
    full[:, states] = full[states].T
    full[np.ix_(states, states)] = full[yaw, yaw] * np.outer(iron.by_yaw, iron.by_yaw) + iron.covariance


def _sensor_errors(config: FilterConfig, start: Start, level: bool):
    """Estimate (m,) and covariance (m, m) of the augmented states; constant part (channels,) of the sensor errors."""
    p, m = config.layout.order, config.layout.n_augmented
    estimate, covariance, constant = np.zeros(m), np.zeros((m, m)), np.zeros(len(config.models))
    still, is_level = start.standstill, config.layout.is_level
    # a late fix may start the filter within the standstill
    span = (still.duration, max(0.0, start.time - still.end)) if still else (0.0, 0.0)
    unseen = np.ones(m, dtype=bool)  # states that the standstill does not show
    for channel, (model, axis) in enumerate(zip(config.models, config.channel_axes)):
        block = slice(channel * p, (channel + 1) * p)
        mean, sigma = _error_at_rest(start, axis, level), config.turn_on_sigma[channel]
        if axis < 2 and not is_level:
            mean = None  # a standstill shows the sum of tilt and bias: see _strapdown_attitude
        elif axis < 2 and level:
            sigma = math.hypot(sigma, TILT_SIGMA)
        # saved accelerometer errors of a planar filter include the slope of the place where they were saved
        unseen[block] = mean is None and not (axis < 2 and is_level)
        estimate[block], covariance[block, block], constant[channel] = channel_prior(
            model, sigma, config.white[axis], mean, *span)
    for state, extra in enumerate(config.extras, start=config.layout.n_sensor):
        covariance[state, state] = extra.initial_sigma**2
    if start.errors is not None:
        known, pairs = start.errors, np.ix_(unseen, unseen)
        estimate[unseen], covariance[pairs] = known.estimate[unseen], known.covariance[pairs]
        constant = np.where(unseen[:config.layout.n_sensor:p], known.constant, constant)
    return estimate, covariance, constant


def sensor_errors_of(config: FilterConfig, memory: np.ndarray) -> SensorErrors:
    """The sensor errors as the filter with this memory has estimated them."""
    layout, row, head = config.layout, newest_row(memory), memory
    n = layout.n_navigation
    # the constant parts: offset in the memory minus offset of the configuration, which is levelled if the memory's was
    leveled_offset = (head[Head.CONDITIONING:Head.CONDITIONING + 36].reshape(6, 6).T
                      @ np.linalg.solve(config.conditioning, config.offset))
    constant = (leveled_offset - head[Head.OFFSET:Head.OFFSET + 6])[config.channel_axes]
    return SensorErrors(row[NAV + n:NAV + layout.n].copy(),
                        variance_factor(row, 0) * covariance_of(row, layout)[n:, n:], constant)


def sensor_errors_after(config: FilterConfig, errors: SensorErrors, age: float) -> SensorErrors:
    """`errors` after `age` s: predicted by their models, with a larger variance, as the IMU may have been switched off.
    """
    p, m = config.layout.order, config.layout.n_augmented
    transition, noise = np.zeros((m, m)), np.zeros((m, m))
    blocks = [(model, slice(k * p, (k + 1) * p), REPEATED_TURN_ON**2 * first)
              for k, (model, first) in enumerate(zip(config.models, config.first_variance))]
    blocks += [(extra.model, slice(k, k + 1), 0.0)
               for k, extra in enumerate(config.extras, start=config.layout.n_sensor)]
    for model, block, switched in blocks:
        interval = model.interval or age
        transition[block, block], noise[block, block] = _repeated(
            model.transition(interval), model.process_noise(interval), round(age / interval) if age else 0)
        noise[block.start, block.start] += switched
    covariance = transition @ errors.covariance @ transition.T + noise
    return SensorErrors(transition @ errors.estimate, 0.5 * (covariance + covariance.T), errors.constant)


def _error_at_rest(start: Start, axis: int, level: bool) -> float | None:
    """Error of one body axis by the standstill; None without one."""
    still = start.standstill
    if still is None:
        return None
    if axis >= 3:
        return float(still.angular_rate[axis - 3])
    if axis == 2:  # the size of gravity is known
        return float(gravity(start.latitude, start.height) - np.linalg.norm(still.specific_force))
    return 0.0 if level else float(still.specific_force[axis])


def _strapdown_attitude(config: FilterConfig, row: np.ndarray, full: np.ndarray, start: Start, yaw: float,
                        errors: np.ndarray) -> None:
    """Attitude, and covariance of attitude, height and vertical velocity. errors: those estimated of f_x, f_y, m/s^2.

    Roll and pitch are those of the specific force at standstill; without a standstill both start at 0. After a
    standstill attitude error and accelerometer errors are fully correlated: g phi_e = df_n, g phi_n = -df_e.
    """
    roll = pitch = 0.0
    if start.standstill is not None:
        f = start.standstill.specific_force - [*errors, 0.0]
        roll, pitch = math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2]))
    q = from_euler(roll, pitch, yaw)
    row[Nav.Q_W], row[Nav.Q_X], row[Nav.Q_Y], row[Nav.Q_Z] = q
    full[Error.R_D, Error.R_D] = (4 * max(start.covariance[0, 0], start.covariance[1, 1]) if start.has_height
                                  else NO_ALTITUDE_SIGMA**2)
    full[Error.V_D, Error.V_D] = VERTICAL_SPEED_SIGMA**2
    if start.standstill is None:
        full[Error.PHI_N, Error.PHI_N] = full[Error.PHI_E, Error.PHI_E] = UNKNOWN_TILT_SIGMA**2
        return
    g = gravity(start.latitude, start.height)
    c = np.array(matrix(q)).reshape(3, 3)
    coupling = np.zeros((3, config.layout.n_augmented))  # phi = coupling x
    for axis in range(2):
        state = axis * config.layout.order
        coupling[0, state], coupling[1, state] = -c[1, axis] / g, c[0, axis] / g
    phi, sensors = slice(Error.PHI_N, Error.PHI_D + 1), slice(config.layout.n_navigation, None)
    sensor = full[sensors, sensors]
    full[phi, phi] += coupling @ sensor @ coupling.T + np.diag([STILL_LEVEL_SIGMA**2, STILL_LEVEL_SIGMA**2, 0])
    full[phi, sensors] = coupling @ sensor
    full[sensors, phi] = full[phi, sensors].T


def leveled(config: FilterConfig, standstill: Standstill):
    """Conditioning (6, 6) and offset (6,) of `config` with the tilt of `standstill` removed: the smallest rotation that
    makes its specific force vertical."""
    rotation = np.kron(np.eye(2), leveling(standstill.specific_force))
    return rotation @ config.conditioning, rotation @ config.offset


def channel_prior(model, turn_on_sigma: float, white: float, mean: float | None, duration: float, since: float = 0.0):
    """Estimate (p,), covariance (p, p) and constant part of one channel's error at the start.

    The error is a constant N(0, turn_on_sigma^2) plus the model's process. A standstill of `duration` s that ended
    `since` s ago shows the mean of their sum, `mean`, with the variance of white noise (density `white`) averaged over
    `duration`. The change of the process during and after the standstill is taken into account.
    """
    p = model.order
    if mean is None:
        covariance = model.initial_covariance()
        covariance[0, 0] += turn_on_sigma**2  # the constant has no state of its own: it is added to the first state
        return np.zeros(p), covariance, 0.0
    interval = model.interval or duration / STILL_STEPS
    steps = max(1, round(duration / interval))
    # states: the process, the constant, and the mean over the standstill, as it accumulates
    transition, noise, prior = np.eye(p + 2), np.zeros((p + 2, p + 2)), np.zeros((p + 2, p + 2))
    transition[:p, :p], noise[:p, :p] = model.transition(interval), model.process_noise(interval)
    transition[-1, 0] = transition[-1, -2] = 1.0 / steps
    prior[:p, :p], prior[p, p] = model.initial_covariance(), turn_on_sigma**2
    f, q = _repeated(transition, noise, steps)
    transition[-1, :-1] = 0.0
    after, grown = _repeated(transition, noise, round(since / interval))
    f, q = after @ f, after @ q @ after.T + grown
    joint = f @ prior @ f.T + q
    gain = joint[:, -1] / (joint[-1, -1] + white / duration)
    estimate = gain * mean
    covariance = (joint - np.outer(gain, joint[-1]))[:p, :p]
    return estimate[:p], 0.5 * (covariance + covariance.T), estimate[p]


def _repeated(transition, noise, steps: int):
    """Transition and process noise of `steps` steps, by doubling."""
    f, q = np.eye(len(transition)), np.zeros_like(noise)
    while steps:
        if steps & 1:
            f, q = transition @ f, transition @ q @ transition.T + noise
        transition, noise = transition @ transition, transition @ noise @ transition.T + noise
        steps >>= 1
    return f, q
