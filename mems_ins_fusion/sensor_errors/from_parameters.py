"""The sensor error models that a set of parameters describes."""
from __future__ import annotations

from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.sensor_errors.models import Autoregressive, GaussMarkov, Model, RandomWalk


def per_axis(parameters: dict, name: str) -> list[float]:
    """The values of a parameter that holds one value for all axes or three, as three: sensor axes x, y, z."""
    values = parameters[name]
    return list(values) * 3 if len(values) == 1 else list(values)


def error_models(parameters: dict, sensor: str, model: str) -> list[Model]:
    """The models of one sensor's x, y and z axes.

    parameters: checked, by full name. sensor: accelerometer or gyroscope. model: random_walk, gauss_markov or
    autoregressive. ParameterError for an autoregressive model that is not stable or has no clear order.
    """
    if model == 'random_walk':
        sigma = per_axis(parameters, f'{sensor}.initial_sigma')
        return [RandomWalk(q, s) for q, s in zip(per_axis(parameters, f'{sensor}.random_walk.q'), sigma)]
    if model == 'gauss_markov':
        tau = per_axis(parameters, f'{sensor}.gauss_markov.tau')
        return [GaussMarkov(s, t) for s, t in zip(per_axis(parameters, f'{sensor}.gauss_markov.sigma'), tau)]
    interval = parameters[f'{sensor}.autoregressive.interval']
    b0 = per_axis(parameters, f'{sensor}.autoregressive.b0')
    try:
        return [Autoregressive(a, b, interval) for a, b in zip(_coefficients(parameters, sensor), b0)]
    except ValueError as error:
        raise ParameterError(f"parameter '{sensor}.autoregressive.coefficients': {error}") from None


def _coefficients(parameters, sensor):
    values = parameters[f'{sensor}.autoregressive.coefficients']
    order = parameters[f'{sensor}.autoregressive.order'] or len(values)
    if len(values) not in (order, 3 * order):
        raise ParameterError(f"parameter '{sensor}.autoregressive.coefficients' must have {order} or {3 * order} "
                             f'values for order {order}, got {len(values)}')
    per_axis_values = values * 3 if len(values) == order else values
    return [tuple(per_axis_values[i * order:(i + 1) * order]) for i in range(3)]
