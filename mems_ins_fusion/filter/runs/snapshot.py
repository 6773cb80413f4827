"""Snapshots: the state of a filter as plain numbers (the state file), and the start of the next filter from one.

A snapshot is a dict for JSON: stamp (ns), latitude, longitude (rad), height (m), speed (m/s), yaw of the vehicle (rad,
clockwise from north) and yaw_sigma; errors: names of the augmented states, estimate, covariance and constant part (see
`start.SensorErrors`), and the configured corrections to which the estimates are relative, namely the conditioning of
the samples and the declared errors of the inputs; wheels: `wheel_vibration.calibration`, where there is one.
"""
from __future__ import annotations

import math

import numpy as np

from ...errors import InputError
from ...navigation.strapdown import to_euler
from ..config import FilterConfig
from ..measurements import wheel_vibration
from ..memory import NAV, newest_row
from ..start.initial import sensor_errors_after, sensor_errors_of
from ..start.start import SavedState, SensorErrors
from .odometry import navigation_solution, published_covariance

AT_REST = 0.5  # m/s, largest estimated speed at the snapshot of a vehicle that was at rest. Chosen, not measured
PARKED_YAW_SIGMA = 0.02  # rad, standard deviation of the change of heading of a parked vehicle


def make_snapshot(config: FilterConfig, memory: np.ndarray, stamp: int) -> dict:
    """The snapshot of a filter with this memory, whose newest sample has `stamp` (ns)."""
    layout = config.layout
    latitude, longitude, height, v_n, v_e, _, _ = _solution(config, memory)
    yaw, yaw_sigma = vehicle_heading(config, memory)
    errors, wheels = sensor_errors_of(config, memory), wheel_vibration.calibration(memory)
    return {'stamp': int(stamp), 'latitude': latitude, 'longitude': longitude, 'height': height,
            'speed': math.hypot(v_n, v_e), 'yaw': yaw, 'yaw_sigma': yaw_sigma,
            'errors': {'names': list(layout.names[layout.n_navigation:]), 'estimate': errors.estimate.tolist(),
                       'covariance': errors.covariance.tolist(), 'constant': errors.constant.tolist(),
                       'conditioning': config.conditioning.tolist(), 'declared': config.declared_errors},
            **({} if wheels is None else {'wheels': wheels.tolist()})}


def _solution(config: FilterConfig, memory: np.ndarray) -> tuple:
    return navigation_solution(newest_row(memory), 0, np.array(config.layout.rows, dtype=float), config.open_loop)


def vehicle_heading(config: FilterConfig, memory: np.ndarray) -> tuple[float, float]:
    """Yaw of the vehicle (that of the body plus that of the mounting), rad clockwise from north, and its sigma."""
    layout, row = config.layout, newest_row(memory)
    yaw = to_euler(_solution(config, memory)[-1])[2]
    direction, mounting = np.zeros(layout.n), layout.index('mounting_yaw')
    direction[layout.n_navigation - 1] = 1.0
    if mounting >= 0:
        yaw += row[NAV + mounting]
        direction[mounting] = -1.0
    return yaw, math.sqrt(max(direction @ published_covariance(row, layout) @ direction, 0.0))


def saved_at_jump(config: FilterConfig, memory: np.ndarray, before: int, now: int) -> SavedState:
    """State for a restart of the filter after the stamps of the samples have jumped from `before` to `now` (ns),
    because a clock was set or a recording begins again. The duration of a jump back is unknown and counts as zero."""
    snapshot = {**make_snapshot(config, memory, before), 'stamp': min(before, now)}
    return from_snapshot(config, snapshot, now, config.parameters['state_file_max_distance'])[0]


def from_snapshot(config: FilterConfig, snapshot: dict, now: int, max_distance: float) -> tuple[SavedState, str]:
    """The parts of `snapshot` that a filter with `config` can use at `now` (ns), and a description in words. Raises
    InputError where `snapshot` is not one."""
    try:
        age = (now - snapshot['stamp']) * 1e-9
        position = tuple(float(snapshot[name]) for name in ('latitude', 'longitude', 'height'))
        speed, yaw, sigma = (float(snapshot[name]) for name in ('speed', 'yaw', 'yaw_sigma'))
        errors = _errors(config, snapshot['errors'])
        wheels = wheel_vibration.checked_calibration(snapshot['wheels']) if 'wheels' in snapshot else None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f'not a state of the filter: {" ".join(str(error).split())}') from None
    if not (all(map(math.isfinite, (*position, speed, yaw, sigma, age))) and sigma >= 0.0 and age >= 0.0):
        raise InputError('not a state of the filter: numbers that are not finite or below zero')
    if speed > AT_REST:
        sigma, heading = math.inf, f'no heading, it ended at {speed:.1f} m/s'
    else:
        sigma = math.hypot(sigma, PARKED_YAW_SIGMA)
        heading = f'heading {math.degrees(yaw) % 360:.1f} +- {math.degrees(sigma):.1f} deg'
    said = f"{heading}; {'sensor errors' if errors else 'no sensor errors, they are of other parameters'}"
    return SavedState(position, yaw, sigma, max_distance, sensor_errors_after(config, errors, age) if errors else None,
                      wheels), said


def _errors(config: FilterConfig, values: dict) -> SensorErrors | None:
    """The sensor errors of a snapshot; None where they belong to a filter with other states, another mounting or other
    declared errors: an offset that was estimated and then declared would be applied twice."""
    layout = config.layout
    names, conditioning = list(values['names']), np.array(values['conditioning'], dtype=float)
    if (names != list(layout.names[layout.n_navigation:]) or values.get('declared', []) != config.declared_errors
            or conditioning.shape != (6, 6) or not np.allclose(conditioning, config.conditioning)):
        return None
    errors = SensorErrors(*(np.array(values[name], dtype=float) for name in ('estimate', 'covariance', 'constant')))
    m = layout.n_augmented
    if (errors.estimate.shape, errors.covariance.shape, errors.constant.shape) != (
            (m,), (m, m), (len(config.models),)):
        raise InputError('arrays of another size than their names')
    total = errors.estimate.sum() + errors.covariance.sum() + errors.constant.sum()
    if not (math.isfinite(total) and np.allclose(errors.covariance, errors.covariance.T)
            and np.linalg.eigvalsh(errors.covariance).min() > -1e-9 * np.abs(errors.covariance).max()):
        raise InputError('not a covariance matrix')
    return errors
