"""What a filter knows, as plain numbers that outlast it, and what of that the next filter can begin with.

A snapshot is a dict that JSON can hold: stamp (ns), latitude, longitude (rad), height (m), speed (m/s), yaw of the
vehicle (rad, clockwise from north) and yaw_sigma, and errors: names of the states behind the navigation errors, their
estimate, covariance and constant parts (see `start.SensorErrors`), and the conditioning of the samples that they belong
to; wheels: what has been learned of them, where that is asked for and known.
"""
from __future__ import annotations

import math

import numpy as np

from ...errors import InputError
from ...navigation.strapdown import to_euler
from ..config import FilterConfig
from ..measurements import wheel_vibration
from ..memory import NAV, Head, state_at
from ..start.alignment import Remembered
from ..start.initial import aged, learned
from ..start.start import SensorErrors
from .odometry import corrected, published_covariance

#: a vehicle that was faster when the snapshot was made has gone on after it, m/s
AT_REST = 0.5
#: a parked car is pushed, a receiver's position wanders: what the heading may have become, rad
PARKED_YAW_SIGMA = 0.02


def made(config: FilterConfig, memory: np.ndarray, stamp: int) -> dict:
    """The snapshot of a filter with this memory, whose newest sample has `stamp` (ns)."""
    layout, at = config.layout, state_at(memory, int(memory[Head.SAMPLES]))
    latitude, longitude, height, v_n, v_e, _, _ = corrected(memory, at, config.layout.is_level,
                                                            config.open_loop)
    yaw, yaw_sigma = vehicle_heading(config, memory)
    errors, wheels = learned(config, memory), wheel_vibration.calibration(memory)
    return {'stamp': int(stamp), 'latitude': latitude, 'longitude': longitude, 'height': height,
            'speed': math.hypot(v_n, v_e), 'yaw': yaw, 'yaw_sigma': yaw_sigma,
            'errors': {'names': list(layout.names[layout.n_navigation:]), 'estimate': errors.estimate.tolist(),
                       'covariance': errors.covariance.tolist(), 'constant': errors.constant.tolist(),
                       'conditioning': config.conditioning.tolist()},
            **({} if wheels is None else {'wheels': wheels.tolist()})}


def vehicle_heading(config: FilterConfig, memory: np.ndarray) -> tuple[float, float]:
    """Yaw of the vehicle, the body's and the mounting's, rad clockwise from north, and its sigma."""
    layout, at = config.layout, state_at(memory, int(memory[Head.SAMPLES]))
    q = corrected(memory, at, config.layout.is_level, config.open_loop)[-1]
    p = published_covariance(memory[at:at + int(memory[Head.WIDTH])], layout)
    row, turned = layout.n_navigation - 1, layout.index('mounting_yaw')
    direction = np.zeros(layout.n)
    direction[row] = 1.0
    yaw = to_euler(q)[2]
    if turned >= 0:
        yaw += memory[at + NAV + turned]
        direction[turned] = -1.0
    return yaw, math.sqrt(max(direction @ p @ direction, 0.0))


def after_jump(config: FilterConfig, memory: np.ndarray, before: int, now: int) -> Remembered:
    """What a filter with this memory can begin anew with where the stamps of the samples jump from `before` to `now`
    (ns): a clock that was set, or a recording that begins again. Where they jump back nobody knows how much later it
    is; it is taken as no time."""
    snapshot = {**made(config, memory, before), 'stamp': min(before, now)}
    return recalled(config, snapshot, now, config.parameters['state_file_max_distance'])[0]


def recalled(config: FilterConfig, snapshot: dict, now: int, max_distance: float) -> tuple[Remembered, str]:
    """What `snapshot` tells a filter with `config` at `now` (ns), and that in words. InputError where it is not one."""
    try:
        age = (now - snapshot['stamp']) * 1e-9
        place = tuple(float(snapshot[name]) for name in ('latitude', 'longitude', 'height'))
        speed, yaw, sigma = (float(snapshot[name]) for name in ('speed', 'yaw', 'yaw_sigma'))
        errors = _errors(config, snapshot['errors'])
        wheels = wheel_vibration.checked_calibration(snapshot['wheels']) if 'wheels' in snapshot else None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f'not a state of the filter: {" ".join(str(error).split())}') from None
    if not (all(map(math.isfinite, (*place, speed, yaw, sigma, age))) and sigma >= 0.0 and age >= 0.0):
        raise InputError('not a state of the filter: numbers that are not finite or below zero')
    if speed > AT_REST:
        sigma, heading = math.inf, f'no heading, it ended at {speed:.1f} m/s'
    else:
        sigma = math.hypot(sigma, PARKED_YAW_SIGMA)
        heading = f'heading {math.degrees(yaw) % 360:.1f} +- {math.degrees(sigma):.1f} deg'
    said = f"{heading}; {'sensor errors' if errors else 'no sensor errors, they are of other parameters'}"
    return Remembered(place, yaw, sigma, max_distance, aged(config, errors, age) if errors else None,
                      wheels), said


def _errors(config: FilterConfig, values: dict) -> SensorErrors | None:
    """The sensor errors in a snapshot; None where they are of a filter with other states or another mounting."""
    layout = config.layout
    names, conditioning = list(values['names']), np.array(values['conditioning'], dtype=float)
    if names != list(layout.names[layout.n_navigation:]) or conditioning.shape != (6, 6) or not np.allclose(
            conditioning, config.conditioning):
        return None
    errors = SensorErrors(*(np.array(values[name], dtype=float) for name in ('estimate', 'covariance', 'constant')))
    m = layout.n_augmented
    if (errors.estimate.shape, errors.covariance.shape, errors.constant.shape) != (
            (m,), (m, m), (len(config.models),)):
        raise InputError('arrays of another size than their names')
    total = errors.estimate.sum() + errors.covariance.sum() + errors.constant.sum()
    if not (math.isfinite(total) and np.allclose(errors.covariance, errors.covariance.T)
            and np.linalg.eigvalsh(errors.covariance).min() > -1e-9 * np.abs(errors.covariance).max()):
        raise InputError('a covariance that is none')
    return errors
