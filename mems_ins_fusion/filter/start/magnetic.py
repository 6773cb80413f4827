"""The first heading from the magnetic field, once the vehicle's iron is known, from turns or from a calibration.

Model and priors are those of measurements/magnetometer.py: before the vehicle has turned, the unknown hard iron leaves
the heading unknown. The gyroscopes give the turn, the accelerometers roll and pitch. Gauss-Newton estimates iron,
heading and gyroscope bias. The filter starts with the estimated iron as well.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..config import FilterConfig
from ..measurements.magnetometer import FIELD_STATES
from .course import LONGEST_COURSE_TIME
from .start import KNOWN_RATE_SIGMA, Iron, SensorErrors, Standstill

SHORTEST_FIELDS = 3.0  # s of fields needed
AROUND = 0.5  # s to each side over which the accelerometers are averaged for roll and pitch
LEVEL_SIGMA = 0.02  # rad, standard deviation of roll and pitch by the accelerometers while a vehicle drives slowly
INITIAL_HEADINGS = 8  # number of starts of Gauss-Newton: hard iron stronger than the field causes local minima
ITERATIONS = 8  # number of iterations from each of them
OTHERS_SIGMAS = 4.0  # standard deviations by which every other heading has to fit worse
#: largest sum of squares over its expectation, of means over a second: above this the field is not the earth's alone
#: Chosen, not measured
FIELD_MISFIT = 0.3
#: rad by which the vehicle has to turn: without a turn, a field that changes by itself would be estimated as iron
LEAST_TURN = 0.4
IRON_KNOWN = 0.2  # standard deviation of the hard iron, as a share of the field, below which no turn is needed
HEADING_SIGMA = 0.15  # rad, standard deviation of the heading that is good enough to start


class MagneticHeading(NamedTuple):
    """Heading of the body at the newest sample, rad, its sigma, and the iron estimated with it."""

    yaw: float
    sigma: float
    iron: Iron


def find_magnetic_heading(imu: np.ndarray, fields: np.ndarray, standstill: Standstill | None, config: FilterConfig,
                          name: str, known: SensorErrors | None) -> MagneticHeading | None:
    """The heading at the newest sample; None while it is not determined to HEADING_SIGMA.

    imu: samples (n, 7 or more) of time, f, w in body axes. fields: (k, 6) of time, field in body axes, variance and
    declination, as in the events. name: of the input. known: sensor errors of an earlier run.
    """
    now = imu[-1, 0]
    part = imu[imu[:, 0] > now - LONGEST_COURSE_TIME]
    fields = fields[(fields[:, 0] > part[0, 0]) & (fields[:, 0] <= now)]
    if len(fields) < 2 or fields[-1, 0] - fields[0, 0] < SHORTEST_FIELDS:
        return None
    time = fields[:, 0]
    bias_sigma = config.alignment.gyroscope_turn_on if standstill is None else KNOWN_RATE_SIGMA
    rate = part[:, 6] - (0.0 if standstill is None else standstill.angular_rate[2])
    turn = np.cumsum(rate * np.diff(part[:, 0], prepend=part[0, 0]))
    turn = np.interp(time, part[:, 0], turn) - turn[-1]
    sigma = np.sqrt(fields[:, 4] + (LEVEL_SIGMA * fields[:, 3]) ** 2)
    # means over a second: within it the errors are nearly constant
    first = np.flatnonzero(np.diff(np.floor(time), prepend=-1.0))
    level, turn, since, sigma = (np.add.reduceat(of, first) / np.diff(np.append(first, len(time))).reshape(
        -1, *[1] * (of.ndim - 1)) for of in (_levelled(part, fields), turn, time - now, sigma))
    names = tuple(f'{name}_{state}' for state in FIELD_STATES)
    prior, spread = _prior(config, names, known)
    mean, sigmas = np.concatenate([prior, [0.0, 0.0]]), np.concatenate([spread, [math.inf, bias_sigma]])
    if np.ptp(turn) < LEAST_TURN and spread[:2].max() > IRON_KNOWN:
        return None
    found = [_fitted(yaw, mean, sigmas, level, turn, since, sigma)
             for yaw in np.arange(INITIAL_HEADINGS) * 2.0 * math.pi / INITIAL_HEADINGS]
    cost, x, normal, excess = min(found, key=lambda one: one[0])
    others = [one[0] for one in found if math.cos(one[1][6] - x[6]) < math.cos(3.0 * HEADING_SIGMA)]
    if min(others, default=math.inf) < cost + OTHERS_SIGMAS**2 or not excess < FIELD_MISFIT:
        return None
    covariance = np.linalg.inv(normal)
    yaw_variance = covariance[6, 6]
    if not yaw_variance < HEADING_SIGMA**2:
        return None
    by_yaw = -covariance[:6, 6] / yaw_variance  # an error in the filter is estimate minus truth
    return MagneticHeading(float(x[6] + fields[-1, 5]), math.sqrt(yaw_variance), Iron(
        names, x[:6].copy(), by_yaw, covariance[:6, :6] - yaw_variance * np.outer(by_yaw, by_yaw)))


def _prior(config: FilterConfig, names, known: SensorErrors | None) -> tuple[np.ndarray, np.ndarray]:
    """Prior mean and sigma (6,) of the states."""
    sigma = {extra.name: extra.initial_sigma for extra in config.extras}
    mean, spread = np.zeros(len(names)), np.array([sigma[name] for name in names])
    if known is not None:
        at = [config.layout.index(name) - config.layout.n_navigation for name in names]
        mean, spread = known.estimate[at], np.sqrt(known.covariance[at, at])
    return mean, spread


def _levelled(imu, fields) -> np.ndarray:
    """Forward and right components (k, 2) of the fields after levelling."""
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(imu[:, 1:4], axis=0)])
    begin = np.searchsorted(imu[:, 0], fields[:, 0] - AROUND)
    end = np.maximum(np.searchsorted(imu[:, 0], fields[:, 0] + AROUND), begin + 1)
    f_x, f_y, f_z = ((total[end] - total[begin]) / (end - begin)[:, None]).T
    roll, pitch = np.arctan2(-f_y, -f_z), np.arctan2(f_x, np.hypot(f_y, f_z))
    x, y, z = fields[:, 1:4].T
    return np.column_stack([np.cos(pitch) * x + np.sin(pitch) * (np.sin(roll) * y + np.cos(roll) * z),
                            np.cos(roll) * y - np.sin(roll) * z])


def _fitted(yaw, mean, sigmas, level, turn, since, sigma):
    """Gauss-Newton from a heading: the sum of squares including priors, the estimate (8,) of iron, heading and
    gyroscope bias, the normal matrix (8, 8), and the mean square of the residuals."""
    c, s = np.cos(yaw + turn), -np.sin(yaw + turn)
    x = mean.copy()
    x[6] = yaw + mean[5]
    hard = np.mean(level - (1.0 + mean[2]) * np.column_stack([c, s]), axis=0)
    x[:2] = mean[:2] + (hard - mean[:2]) * np.minimum(1.0, sigmas[:2])  # a smaller step where the hard iron is known
    for _ in range(ITERATIONS):
        residual, jacobian = _misfit(x, level, turn, since, sigma)
        rows = np.concatenate([jacobian, np.diag(1.0 / sigmas)])
        normal = rows.T @ rows
        x = x - np.linalg.solve(normal, rows.T @ np.concatenate([residual, (x - mean) / sigmas]))
    residual, _ = _misfit(x, level, turn, since, sigma)
    away = (x - mean) / sigmas
    return float(residual @ residual + away @ away), x, normal, float(residual @ residual) / len(residual)


def _misfit(x, level, turn, since, sigma) -> tuple[np.ndarray, np.ndarray]:
    """Residual (2 k,) in sigmas and its derivative (2 k, 8) by hard_x, hard_y, strength, stretch, skew, declination,
    heading now and gyroscope bias. since: (k,) s, until now negative."""
    hard_x, hard_y, strength, stretch, skew, declination, yaw, bias = x
    angle = yaw - declination + turn - bias * since
    c, s, zero, one = np.cos(angle), -np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    along, across = 1.0 + strength + stretch, 1.0 + strength - stretch
    residual = np.column_stack([along * c + skew * s + hard_x - level[:, 0],
                                skew * c + across * s + hard_y - level[:, 1]])
    by_angle = np.column_stack([along * s - skew * c, skew * s - across * c])
    jacobian = np.stack([np.column_stack([one, zero]), np.column_stack([zero, one]), np.column_stack([c, s]),
                         np.column_stack([c, -s]), np.column_stack([s, c]), -by_angle, by_angle,
                         -since[:, None] * by_angle], axis=2)
    return (residual / sigma[:, None]).ravel(), (jacobian / sigma[:, None, None]).reshape(-1, 8)
