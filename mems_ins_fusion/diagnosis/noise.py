"""Noise levels as unknowns of a problem: of the receiver, of each kind of sensor, of the constraint."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..filter.config import SENSORS
from ..sensor_errors.models import MODELS
from .fit import objective_of, priors
from .problem import Problem, Unknown, with_covariances

#: by sensor error model, the parameter of its noise level
MODEL_NOISE = {name: model.level for name, model in MODELS.items()}
#: prior standard deviation of the natural logarithm of a sensor's noise level, about the configured one
NOISE_PRIOR = 1.0
#: the same for the receiver, of which data sheets say less
RECEIVER_PRIOR = 1.5
SMALLEST_FACTOR = 3.0  # largest factor by which a fit makes a noise level smaller
LARGEST_FACTOR = 10.0  # largest factor by which it makes that of a sensor larger: more is not noise of the sensor
LARGEST_RECEIVER = 100.0  # the same for the receiver
#: levels that no drive makes smaller: the sigma of a constraint is a bound for every road. A drive on which the vehicle
#: hardly slides asks for none at all, and its other unknowns are then fitted to a constraint that is too strict
ONLY_LARGER = 'vehicle.non_holonomic_sigma',


def noise_unknowns(problem: Problem) -> list[Unknown]:
    """Logarithms of the noise levels as factors: of the receiver, of each kind of sensor, of the constraint."""
    model = MODEL_NOISE[problem.values['sensor_error_model']]

    def receiver(values, recording, x):
        own = problem.of(recording)
        return values, replace(recording, gnss=replace(
            recording.gnss, covariance=with_covariances(own.drive.gnss, own.claimed, x, own.outlying).covariance))

    groups = {f'{sensor}.noise': [f'{sensor}.noise_density', f'{sensor}.{model}'] for sensor in SENSORS}
    if problem.values['vehicle.non_holonomic']:
        groups['vehicle.non_holonomic_sigma'] = ['vehicle.non_holonomic_sigma']
    sensors = [Unknown(name, _scaled(names), 0.0, 0.05, NOISE_PRIOR, one_sided=True, noise=True,
                       bounds=(0.0 if name in ONLY_LARGER else -np.log(SMALLEST_FACTOR), np.log(LARGEST_FACTOR)))
               for name, names in groups.items()]
    return [Unknown('gnss.sigma', receiver, 0.0, 0.05, RECEIVER_PRIOR, one_sided=True, noise=True,
                    bounds=(-np.log(SMALLEST_FACTOR), np.log(LARGEST_RECEIVER))), *sensors]


def _scaled(names: Sequence[str]) -> Callable:
    def apply(values, recording, x):
        for name in names:
            values = scaled(values, name, float(np.exp(x)))
        return values, recording
    return apply


def scaled(values: dict, name: str, factor: float) -> dict:
    """`values` with the value `name` (a number, or one for each axis) multiplied by `factor`."""
    value = values[name]
    return {**values, name: [v * factor for v in value] if isinstance(value, (list, tuple)) else value * factor}


def calibrated(problem: Problem, unknowns: Sequence[Unknown], x=None) -> np.ndarray:
    """`x` with the noise levels as configured, except the receiver's, which is the one of the highest likelihood."""
    start = np.zeros(len(unknowns)) if x is None else np.array(x, dtype=float)
    start[[u.noise for u in unknowns]] = 0.0

    def at(level):
        return np.append(level, start[1:])

    levels = np.log([0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0])
    found = [objective_of(r, problem.mask, at(level), *priors(unknowns))
             for level, r in zip(levels, problem.residuals(unknowns, [at(level) for level in levels]))]
    return at(levels[int(np.argmax(found))])
