"""The sensor error models that a set of parameters describes."""
from __future__ import annotations

from mems_ins_fusion.sensor_errors.models import MODELS, Model, per_axis

__all__ = ['error_models', 'per_axis']


def error_models(parameters: dict, sensor: str, model: str) -> list[Model]:
    """The models of one sensor's x, y and z axes.

    parameters: checked, by full name. sensor: accelerometer or gyroscope. model: a name in MODELS. ParameterError for
    an autoregressive model that is not stable or has no clear order.
    """
    return MODELS[model].from_parameters(parameters, sensor)
