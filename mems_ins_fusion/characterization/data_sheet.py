"""Sensor errors in the units of data sheets."""
from __future__ import annotations

import math

from ..navigation.earth import STANDARD_GRAVITY

#: units of white noise and of biases: unit -> number of these units in one SI unit (m/s^2, rad/s; or per sqrt(Hz))
_WHITE = {'accelerometer': {'ug/sqrt(Hz)': 1e6 / STANDARD_GRAVITY, 'm/s/sqrt(h)': 60.0},
          'gyroscope': {'deg/sqrt(h)': math.degrees(60.0), 'deg/s/sqrt(Hz)': math.degrees(1.0)}}
_BIAS = {'accelerometer': {'mg': 1e3 / STANDARD_GRAVITY}, 'gyroscope': {'deg/h': math.degrees(3600.0)}}


def white_noise(sensor: str, density: float) -> dict[str, float]:
    """Noise density of `sensor` (accelerometer: m/s^2/sqrt(Hz), gyroscope: rad/s/sqrt(Hz)) by unit."""
    return {unit: factor * density for unit, factor in _WHITE[sensor].items()}


def bias(sensor: str, value: float) -> dict[str, float]:
    """A bias, or its standard deviation (m/s^2, rad/s), by unit."""
    return {unit: factor * value for unit, factor in _BIAS[sensor].items()}
