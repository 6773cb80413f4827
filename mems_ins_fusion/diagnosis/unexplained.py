"""Errors that no effect of the library explains: in which measurement they are, and with what they are correlated.

Errors of a sensor or of the position in proportion to a known quantity of the drive are tested like effects, by score
tests. They are only reported, not corrected: their cause has to be found on the vehicle.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..evaluation.intervals import holm
from ..navigation.earth import radii
from ..navigation.frames import mounting
from ..samples import Recording
from .fit import Scores, scores
from .problem import Problem, Unknown
from .residuals import Residual
from .tracing import FAMILY_ERROR_RATE, efficient, significance

SMOOTH = 0.2  # s over which angular rate and specific force are averaged before they are squared
# root mean squares of errors, as steps for finite differences:
FORCE_STEP = 0.01  # m/s^2, of an accelerometer
RATE_STEP = 2e-4  # rad/s, of a gyroscope
POSITION_STEP = 0.05  # m, of fixes


@dataclass(frozen=True)
class Correlation:
    """An error of the measurement `where` in proportion to the quantity `what`. rms: with the sign of the proportion.
    sigma: of rms. gain, p: of the score test."""

    where: str
    what: str
    rms: float
    sigma: float
    unit: str
    gain: float
    p: float


def correlations(problem: Problem, nuisance: Scores, at: Residual) -> list[Correlation]:
    """Significant errors in the innovations `at`, the largest gain first. problem: at the model of these innovations.
    nuisance: scores of the unknowns of that model."""
    tests = _tests(problem, *regressors(problem))
    unknowns = [unknown for *_, unknown in tests]
    _, found = scores(problem, unknowns, np.zeros(len(unknowns)), at)
    mask, results = problem.mask, []
    for k, (where, what, unit, _) in enumerate(tests):
        own = Scores(found.score[:, [k]], found.sensitivity[:, [k]])
        own = efficient(own, nuisance, mask)
        information, total = own.information(mask), own.gradient(mask)
        if information[0, 0] <= 0:
            continue
        theta = total / information[0, 0]
        gain, p = significance(problem, own, theta, total)
        results.append(Correlation(where, what, float(theta[0]), float(information[0, 0] ** -0.5), unit, gain, p))
    adjusted = holm([r.p for r in results])
    return sorted((replace(r, p=float(p)) for r, p in zip(results, adjusted) if p <= FAMILY_ERROR_RATE),
                  key=lambda r: -r.gain)


def regressors(problem: Problem) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Quantities that an error may be proportional to, in SI units, by name: at the IMU samples, and at the fixes."""
    imu, gnss, values = problem.recording.imu, problem.recording.gnss, problem.values
    result = problem.filtered(values, problem.recording)
    to_body = mounting(values['imu.mounting_rpy']).T
    force, rate = _smooth(imu.stamp, imu.specific_force @ to_body), _smooth(imu.stamp, imu.angular_rate @ to_body)
    speed = np.interp(imu.stamp, result.stamp, np.hypot(*result.velocity.T[:2]))
    yaw = np.interp(imu.stamp, result.stamp, np.unwrap(result.yaw))
    found = {'time': (imu.stamp - imu.stamp[0]) * 1e-9, 'speed': speed, 'speed squared': speed**2,
             'forward acceleration': force[0], 'forward acceleration squared': force[0]**2,
             'lateral acceleration': force[1], 'lateral acceleration squared': force[1]**2,
             'turn rate': rate[2], 'turn rate squared': rate[2]**2,
             'north part of the heading': np.cos(yaw), 'east part of the heading': np.sin(yaw)}
    if imu.temperature is not None:
        found['temperature'] = np.nan_to_num(imu.temperature, nan=np.nanmean(imu.temperature))
    return found, {name: np.interp(gnss.stamp, imu.stamp, series) for name, series in found.items()}


def _smooth(stamp: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Each axis of `series` (n, 3) about its median, averaged over SMOOTH: (3, n)."""
    count = max(round(SMOOTH * 1e9 / max(np.median(np.diff(stamp)), 1)), 1)
    return np.stack([np.convolve(axis - np.median(axis), np.ones(count) / count, mode='same') for axis in series.T])


def _tests(problem: Problem, at_samples: dict, at_fixes: dict) -> list[tuple[str, str, str, Unknown]]:
    """Where, what, unit and the unknown, the RMS of the error: for the axes of the planar equations and the position.

    A position error that goes with the heading would be one of the map.
    """
    to_sensor = mounting(problem.values['imu.mounting_rpy'])  # rows: body axes as the sensor sees them
    c, s = np.cos(problem.base.yaw), np.sin(problem.base.yaw)
    tests = []
    for what, series in at_samples.items():
        shape = _normalized(series)
        for where, axis, sensor, unit, step in (
                ('forward accelerometer', 0, 'specific_force', 'm/s^2', FORCE_STEP),
                ('lateral accelerometer', 1, 'specific_force', 'm/s^2', FORCE_STEP),
                ('vertical gyroscope', 2, 'angular_rate', 'rad/s', RATE_STEP)):
            tests.append((where, what, unit, _unknown(_sensor_error(sensor, shape[:, None] * to_sensor[axis]), step)))
    for what, series in at_fixes.items():
        shape = _normalized(series)
        if 'heading' not in what:
            tests += [('position along the track', what, 'm',
                       _unknown(_position_error(shape * c, shape * s), POSITION_STEP)),
                      ('position across the track', what, 'm',
                       _unknown(_position_error(-shape * s, shape * c), POSITION_STEP))]
    return tests


def _normalized(values: np.ndarray) -> np.ndarray:
    """`values` of mean zero and RMS one; zero where they are all the same."""
    centred = values - values.mean()
    return centred / max(float(np.sqrt(np.mean(centred**2))), 1e-12)


def _unknown(apply: Callable, step: float) -> Unknown:
    return Unknown('', apply, 0.0, step, 100 * step, one_sided=True)


def _sensor_error(sensor: str, shape: np.ndarray) -> Callable:
    def apply(values: dict, recording: Recording, x: float):
        imu = replace(recording.imu, **{sensor: getattr(recording.imu, sensor) - x * shape})
        return values, replace(recording, imu=imu)
    return apply


def _position_error(north: np.ndarray, east: np.ndarray) -> Callable:
    def apply(values: dict, recording: Recording, x: float):
        gnss = recording.gnss
        meridian, prime_vertical = radii(gnss.latitude)
        moved = replace(gnss, latitude=gnss.latitude - x * north / (meridian + gnss.height),
                        longitude=gnss.longitude - x * east / ((prime_vertical + gnss.height) * np.cos(gnss.latitude)))
        return values, replace(recording, gnss=moved)
    return apply
