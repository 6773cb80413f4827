"""The filter's settings in the filter's terms: built from the parameters, and laid out in its memory."""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..effects.registry import EFFECTS
from ..navigation.frames import FLU_TO_FRD, mounting
from ..sensor_errors.from_parameters import error_models, per_axis
from ..sensor_errors.models import Autoregressive, GaussMarkov, Model, RandomWalk
from .layout import (
    CHANNELS,
    FIX_SIZE,
    HEAD_SIZE,
    NAVIGATION_STATES,
    PLANAR,
    SAMPLE_SIZE,
    STRAPDOWN,
    Head,
    noise_size,
    row_width,
)

#: the fastest IMU for which all of gnss.max_delay is remembered, Hz
FASTEST_IMU = 1000
FIX_CAPACITY = 256
SENSORS = ('accelerometer', 'gyroscope')


@dataclass(frozen=True)
class FilterConfig:
    """Settings of one filter. Axes are body axes unless a name says otherwise; `values` are the parameters."""

    values: dict
    mechanization: int
    models: tuple[Model, ...]  # one per channel of CHANNELS[mechanization]
    white: np.ndarray  # (6,) noise densities squared
    turn_on_sigma: np.ndarray  # (channels,) of the constant bias outside the model
    conditioning: np.ndarray  # (6, 6): body-axis f, w = conditioning (raw f, w) + offset
    offset: np.ndarray  # (6,)
    lever_arm: np.ndarray  # (3,)

    @classmethod
    def from_parameters(cls, values: dict) -> FilterConfig:
        """From checked parameters (`parameters.table.check`). Raises ParameterError where they do not fit together."""
        rotation = mounting(values['imu.mounting_rpy'])
        mechanization = STRAPDOWN if values['mechanization'] == 'strapdown' else PLANAR
        mixing = np.kron(np.eye(2), rotation)
        along = np.abs(mixing).argmax(axis=1)  # the sensor axis that lies along each body axis
        density = np.concatenate([per_axis(values, f'{sensor}.noise_density') for sensor in SENSORS])
        turn_on = np.concatenate([per_axis(values, f'{sensor}.initial_sigma') for sensor in SENSORS])
        bias = np.concatenate([per_axis(values, f'{sensor}.bias') for sensor in SENSORS])
        scale = np.concatenate([per_axis(values, f'{sensor}.scale') for sensor in SENSORS])
        axes = [0, 1, 5] if mechanization == PLANAR else range(6)
        kind = values['sensor_error_model']
        sensor_models = [model for sensor in SENSORS for model in error_models(values, sensor, kind)]
        models = tuple(sensor_models[along[i]] for i in axes)
        conditioning = mixing / (1.0 + scale)
        for effect in EFFECTS.values():
            correction = effect.conditioning(values)
            if correction is not None:
                conditioning = correction @ conditioning
        constant = [0.0 if isinstance(model, RandomWalk) else turn_on[along[i]] for i, model in zip(axes, models)]
        return cls(values=values, mechanization=mechanization, models=_equal_order(models),
                   white=mixing**2 @ density**2, turn_on_sigma=np.array(constant), conditioning=conditioning,
                   offset=-conditioning @ bias,
                   lever_arm=FLU_TO_FRD @ np.asarray(values['gnss.lever_arm'], dtype=float))

    @property
    def channels(self) -> tuple[str, ...]:
        return CHANNELS[self.mechanization]

    @property
    def channel_axes(self) -> list[int]:
        """Which of f_x, f_y, f_z, w_x, w_y, w_z each channel is."""
        return [CHANNELS[STRAPDOWN].index(name) for name in self.channels]

    @property
    def navigation(self) -> int:
        """Number of navigation error states, N."""
        return NAVIGATION_STATES[self.mechanization]

    @property
    def order(self) -> int:
        """States per sensor channel, p."""
        return self.models[0].order

    @property
    def coloured(self) -> GaussMarkov | None:
        """Model of the receiver's coloured noise, or None."""
        sigma = self.values['gnss.coloured_noise.sigma']
        return GaussMarkov(sigma, self.values['gnss.coloured_noise.tau']) if sigma > 0 else None

    @property
    def others(self) -> int:
        """Number of states that are not navigation errors, m."""
        return len(self.models) * self.order + (2 if self.coloured else 0)

    @property
    def capacity(self) -> int:
        """States and samples remembered for fixes that come late: a power of two, small enough for the cache."""
        return 2 ** math.ceil(math.log2(self.values['gnss.max_delay'] * FASTEST_IMU + 16))

    def correctors(self) -> list:
        """What takes the effects that the parameters declare out of samples in sensor axes, in order."""
        rotation = mounting(self.values['imu.mounting_rpy'])
        made = (effect.corrector(self.values, rotation) for effect in EFFECTS.values())
        return [corrector for corrector in made if corrector is not None]

    def memory(self) -> np.ndarray:
        """The kernel's memory with these settings in it, before the first state."""
        n, p, channels = self.navigation + self.others, self.order, len(self.models)
        width = row_width(self.navigation, self.others)
        rows = HEAD_SIZE + noise_size(self.others, p, channels)
        ring = rows + (self.capacity + 2) * width  # two rows more, for states between samples
        fixes = ring + self.capacity * SAMPLE_SIZE
        scratch = fixes + FIX_CAPACITY * FIX_SIZE
        memory = np.zeros(scratch + n * n + 5 * n)
        self._write_head(memory[:HEAD_SIZE], width)
        memory[[Head.ROWS_AT, Head.RING_AT, Head.FIXES_AT, Head.SCRATCH_AT]] = rows, ring, fixes, scratch
        memory[HEAD_SIZE:rows] = self._noise()
        return memory

    def _write_head(self, head: np.ndarray, width: int) -> None:
        values = self.values
        autoregressive = isinstance(self.models[0], Autoregressive)
        still = 3 * values['vehicle.still_acceleration'] ** 2, 3 * values['vehicle.still_rate'] ** 2
        settings = {
            Head.MECHANIZATION: self.mechanization, Head.OPEN_LOOP: values['feedback'] == 'open',
            Head.NAVIGATION: self.navigation, Head.OTHERS: self.others, Head.ORDER: self.order,
            Head.CHANNELS: len(self.models), Head.WIDTH: width, Head.CAPACITY: self.capacity,
            Head.FIX_CAPACITY: FIX_CAPACITY,
            Head.COLOURED: self.navigation + len(self.models) * self.order if self.coloured else -1,
            Head.ACCELEROMETER_INTERVAL: self.models[0].interval if autoregressive else 0,
            Head.GYROSCOPE_INTERVAL: self.models[-1].interval if autoregressive else 0,
            Head.MAX_GAP: values['imu.max_gap'], Head.MAX_DELAY: values['gnss.max_delay'],
            Head.ROBUST_SIGMA: values['gnss.robust_sigma'],
            Head.LEVER_X: self.lever_arm[0], Head.LEVER_Y: self.lever_arm[1], Head.LEVER_Z: self.lever_arm[2],
            Head.ZERO_VELOCITY_SIGMA: values['vehicle.zero_velocity'] * values['vehicle.zero_velocity_sigma'],
            Head.NON_HOLONOMIC_SIGMA: values['vehicle.non_holonomic'] * values['vehicle.non_holonomic_sigma'],
            Head.SIDESLIP: values['vehicle.sideslip_per_acceleration'],
            Head.STILL_ACCELERATION: values['vehicle.still_acceleration'],
            Head.STILL_RATE: values['vehicle.still_rate'],
            Head.STILL_VARIANCE_F: 10 * still[0], Head.STILL_VARIANCE_W: 10 * still[1],
        }
        for index, value in settings.items():
            head[index] = value
        head[Head.CONDITIONING:Head.CONDITIONING + 36] = self.conditioning.ravel()
        head[Head.OFFSET:Head.OFFSET + 6] = self.offset

    def _noise(self) -> np.ndarray:
        decay, walk, variance = np.zeros((3, self.others))
        coefficients = np.zeros((len(self.models), self.order))
        driving = np.zeros(len(self.models))
        for channel, model in enumerate(self.models):
            _set_noise(model, channel * self.order, decay, walk, variance)
            if isinstance(model, Autoregressive):
                coefficients[channel] = model.coefficients
                driving[channel] = model.b0**2
        if self.coloured:
            for state in (self.others - 2, self.others - 1):
                _set_noise(self.coloured, state, decay, walk, variance)
        return np.concatenate([self.white, decay, walk, variance, coefficients.ravel(), driving])


def _set_noise(model: Model, state: int, decay, walk, variance) -> None:
    if isinstance(model, RandomWalk):
        walk[state] = model.q**2
    elif isinstance(model, GaussMarkov):
        decay[state] = 1 / model.tau
        variance[state] = model.sigma**2


def _equal_order(models: tuple[Model, ...]) -> tuple[Model, ...]:
    """Autoregressive models of different order, filled up with zeros: the kernel has one p for all channels."""
    order = max(model.order for model in models)
    return tuple(model if model.order == order else
                 Autoregressive((*model.coefficients, *[0.0] * (order - model.order)), model.b0, model.interval)
                 for model in models)
