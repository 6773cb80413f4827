"""Simulated recordings: the samples of sensors with errors and of a GNSS receiver in a drive, with undeclared effects.

Each purpose has its own random number generator, so that adding an effect, or a model of an axis, changes nothing else.
"""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from mems_ins_fusion.effects.base import Effect
from mems_ins_fusion.filter.measurements.base import Measurement
from mems_ins_fusion.filter.measurements.inertial import Inertial
from mems_ins_fusion.filter.measurements.registry import AIDING, MEASUREMENTS
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.navigation.frames import FLU_TO_FRD, rotation_from_rpy, wrap
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording, Reference, Temperatures
from mems_ins_fusion.sensor_errors.models import MODELS, Model, per_axis
from mems_ins_fusion.sensor_errors.models import simulate as simulate_errors
from mems_ins_fusion.simulation.drive import START_STAMP, Drive, simulate_drive, stream
from mems_ins_fusion.simulation.receiver import GnssNoise
from mems_ins_fusion.simulation.vibration import Vibration

__all__ = ['SimulatedAiding', 'GnssNoise', 'SensorErrors', 'Simulation', 'Vibration', 'simulate_drive',
           'simulate_recording']

_FLIP = FLU_TO_FRD.diagonal()  # its own inverse
_COVARIANCE_TYPE_DIAGONAL_KNOWN = 2  # sensor_msgs/NavSatFix
_STATUS_FIX = 0  # sensor_msgs/NavSatStatus
_LAGUERRE = 12  # nodes of the mean over the past that a low pass is


@dataclass(frozen=True)
class SensorErrors:
    """The errors of an IMU, sensor axes x, y, z.

    accelerometer, gyroscope: the models of the slow errors, None for an axis without. *_noise_density: white noise,
    m/s^2/sqrt(Hz) and rad/s/sqrt(Hz). *_bias: constant, m/s^2 and rad/s. *_turn_on_sigma: standard deviation of another
    constant, drawn anew for each seed. *_scale: measured = (1 + scale) true + errors.
    """

    accelerometer: Sequence[Model | None] = (None, None, None)
    gyroscope: Sequence[Model | None] = (None, None, None)
    accelerometer_noise_density: Sequence[float] = (0.0, 0.0, 0.0)
    gyroscope_noise_density: Sequence[float] = (0.0, 0.0, 0.0)
    accelerometer_bias: Sequence[float] = (0.0, 0.0, 0.0)
    gyroscope_bias: Sequence[float] = (0.0, 0.0, 0.0)
    accelerometer_turn_on_sigma: Sequence[float] = (0.0, 0.0, 0.0)
    gyroscope_turn_on_sigma: Sequence[float] = (0.0, 0.0, 0.0)
    accelerometer_scale: Sequence[float] = (0.0, 0.0, 0.0)
    gyroscope_scale: Sequence[float] = (0.0, 0.0, 0.0)

    @classmethod
    def from_parameters(cls, parameters: dict, model: str) -> SensorErrors:
        """The errors that `parameters` describe with `model` (random_walk, gauss_markov or autoregressive).

        The turn-on bias, `initial_sigma`, is where a random walk starts; it comes on top of the other two models, which
        vary about zero.
        """
        per_sensor = {}
        for sensor in ('accelerometer', 'gyroscope'):
            per_sensor[sensor] = MODELS[model].from_parameters(parameters, sensor)
            for name in ('noise_density', 'bias', 'scale'):
                per_sensor[f'{sensor}_{name}'] = per_axis(parameters, f'{sensor}.{name}')
            if model != 'random_walk':
                per_sensor[f'{sensor}_turn_on_sigma'] = per_axis(parameters, f'{sensor}.initial_sigma')
        return cls(**per_sensor)


class SimulatedAiding(dict):
    """Rates, Hz, and errors of further sensors, by the names in `Measurement.simulated_with`. A rate of 0: the sensor
    is not simulated."""

    def __init__(self, **given: float):
        known = {name: value for one in (*MEASUREMENTS.values(), Inertial)
                 for name, value in one.simulated_with.items()}
        if given.keys() - known.keys():
            raise ValueError(f"no errors of a simulated sensor: {', '.join(sorted(given.keys() - known.keys()))}")
        super().__init__({**known, **given})


@dataclass(frozen=True)
class Simulation:
    """A simulated recording and its truth.

    drive: the true motion, with the effects that move the body. sensor_errors: (n, 6) m/s^2 and rad/s, the slow errors
    and constant biases in body axes (forward-right-down), without white noise and effects.
    effects: name -> parameter values.
    """

    recording: Recording
    drive: Drive
    sensor_errors: np.ndarray
    effects: dict[str, dict[str, float]]


def simulate_recording(drive: Drive, sensors: SensorErrors | None = None, gnss: GnssNoise | None = None,
                       effects: Sequence[tuple[Effect, dict[str, float]]] = (), mounting_rpy=(0.0, 0.0, 0.0),
                       seed: int = 0, name: str = 'simulation', vibration: Vibration | None = None,
                       aiding: SimulatedAiding | None = None, named: Sequence[Measurement] = ()) -> Simulation:
    """Simulate the recording of sensors in `drive`.

    sensors, gnss: perfect sensors and the default receiver where None. effects: in the order in which they act, each
    with its parameters (those left out take their defaults). mounting_rpy: roll, pitch, yaw (rad) of the rotation from
    sensor axes to base_link (forward-left-up), as declared. vibration, aiding: none where None. named: inputs with a
    name (`Measurement.named`), each with the errors of its kind in `aiding`, 10 Hz (a fix 1 Hz) without a rate there.
    The reference is the true position of the IMU, the velocity there and the yaw of the body, at each IMU sample.
    InputError for an unknown parameter of an effect.
    """
    sensors, gnss = sensors or SensorErrors(), gnss or GnssNoise()
    effects = [(effect, effect.complete(values)) for effect, values in effects]
    for effect, values in effects:
        drive = effect.alter_drive(drive, values)
    to_sensor = Rotation.from_matrix(rotation_from_rpy(*mounting_rpy)).inv()
    imu, slow_errors = _imu(drive, sensors, effects, to_sensor, seed, vibration)
    reference = Reference(drive.stamp, drive.latitude, drive.longitude, drive.height, drive.velocity, wrap(drive.yaw))
    for effect, values in effects:
        imu = effect.distort_samples(imu, values, stream(seed, effect.name))
    temperatures = _temperatures(drive, effects, seed)
    recording = Recording(name, imu.with_temperature(temperatures), _fixes(drive, gnss, effects, seed), reference,
                          temperatures)
    if aiding or named:
        recording = recording.having(_aided(drive, aiding, effects, seed, named, to_sensor))
    return Simulation(recording, drive, slow_errors, {effect.name: values for effect, values in effects})


def _imu(drive, sensors, effects, to_sensor, seed, vibration):
    """The samples in sensor axes, and the slow errors in body axes."""
    force, rate = drive.specific_force, drive.angular_rate
    if vibration is not None:
        shaking = vibration.shake(drive, stream(seed, 'vibration'))
        force, rate = force + shaking[0], rate + shaking[1]
    for effect, values in effects:
        force, rate = effect.distort_imu(drive, force, rate, values, stream(seed, effect.name))
    measured, slow = [], []
    for sensor, true in (('accelerometer', force), ('gyroscope', rate)):
        error = np.column_stack([_slow_error(drive, model, stream(seed, f'{sensor}.{axis}'))
                                 for axis, model in zip('xyz', getattr(sensors, sensor))])
        turn_on = stream(seed, f'{sensor}.turn_on').standard_normal(3)
        error += getattr(sensors, f'{sensor}_bias') + turn_on * getattr(sensors, f'{sensor}_turn_on_sigma')
        white = stream(seed, f'{sensor}.white').standard_normal(true.shape) * math.sqrt(drive.rate)
        white *= getattr(sensors, f'{sensor}_noise_density')
        scale = 1 + np.asarray(getattr(sensors, f'{sensor}_scale'))
        measured.append(scale * to_sensor.apply(true * _FLIP) + error + white)
        slow.append(to_sensor.inv().apply(error) * _FLIP)
    return ImuSamples(drive.stamp, drive.stamp.copy(), *measured), np.column_stack(slow)


def _slow_error(drive, model, rng):
    return np.zeros(len(drive.time)) if model is None else simulate_errors(model, len(drive.time), 1 / drive.rate, rng)


def _fixes(drive, gnss, effects, seed) -> Fixes:
    stamped = gnss.received(gnss.times(drive.time[-1]), stream(seed, 'gnss.dropouts'))
    described = stamped
    for effect, values in effects:
        described = effect.fix_times(described, values)
    true = drive.at(described)
    position = true.position
    for effect, values in effects:
        position = effect.distort_fixes(drive, described, position, values, stream(seed, effect.name))
    vertical = 1.5 * gnss.sigma if gnss.vertical_sigma is None else gnss.vertical_sigma
    sigma = np.array([gnss.sigma, gnss.sigma, vertical])
    # random numbers for each possible fix, so that an outage does not change the noise of the other fixes
    slot = np.round((stamped - gnss.phase) * gnss.rate).astype(int)
    noise = stream(seed, 'gnss.white').standard_normal((slot[-1] + 1 if len(slot) else 0, 3))[slot]
    error = gnss.distort(stamped, true.position, position - true.position + sigma * noise, lambda purpose: stream(
        seed, f'gnss.{purpose}'))
    north, east, down = error.T
    meridian, prime_vertical = radii(true.latitude)
    stamp = START_STAMP + np.round(stamped * 1e9).astype(np.int64)
    return Fixes(stamp, stamp + round(gnss.latency * 1e9),
                 latitude=true.latitude + north / (meridian + true.height),
                 longitude=true.longitude + east / ((prime_vertical + true.height) * np.cos(true.latitude)),
                 height=true.height - down,
                 covariance=np.tile(np.diag(sigma**2 + gnss.coloured_sigma**2), (len(stamp), 1, 1)),
                 status=np.full(len(stamp), _STATUS_FIX, np.int8),
                 covariance_type=np.full(len(stamp), _COVARIANCE_TYPE_DIAGONAL_KNOWN, np.uint8))


def _aided(drive, aiding, effects, seed, named, to_sensor) -> dict:
    """The samples of the further sensors, by name."""
    errors = {**SimulatedAiding(), **(aiding or {})}
    wanted = [measurement for measurement in AIDING if errors[f'{measurement.name}_rate']]
    said = {}
    for measurement in (*wanted, *named):
        rate = next(iter(measurement.simulated_with))
        own = {**errors, rate: errors[rate] or (1.0 if measurement.from_satellites else 10.0)}
        lag = sum(effect.measured_lag(measurement.name, values) for effect, values in effects)
        nodes, weights = np.polynomial.laguerre.laggauss(_LAGUERRE) if lag else ([0.0], [1.0])
        # a low pass is a mean over the past; the noise is added after it
        parts = [measurement.simulated(drive, own, effects, stream(seed, measurement.name), partial(
            _instants, drive, effects, measurement.name, lag * node)) for node in nodes]
        said[measurement.name] = measurement.seen_from(_mean(parts, weights), to_sensor)
    return said


def _mean(parts, weights):
    """The first of `parts`, samples of one input, with the weighted mean of the values of all."""
    if len(parts) == 1:
        return parts[0]
    name = fields(parts[0])[2].name
    values = [getattr(part, name) for part in parts]
    if name == 'yaw':  # of angles that are near each other
        values = [values[0] + wrap(value - values[0]) for value in values]
    return replace(parts[0], **{name: sum(weight * value for weight, value in zip(weights, values))})


def _instants(drive, effects, name, late, rate, phase):
    """Times, s after the start, and stamps of measurements of the input `name` at `rate` Hz; late: s, by which the
    times are before these. phase: s, None as the receiver's."""
    phase = GnssNoise.phase if phase is None else phase
    time = phase + np.arange(math.floor((drive.time[-1] - phase) * rate + 1e-9) + 1) / rate
    stamp = START_STAMP + np.round(time * 1e9).astype(np.int64)
    for effect, values in effects:
        time = effect.measured_times(name, time, values)
    return time - late, stamp


def _temperatures(drive, effects, seed) -> Temperatures | None:
    """The sensor's temperature once a second, where an effect makes it matter."""
    for effect, values in effects:
        celsius = effect.temperature(drive, values, stream(seed, effect.name))
        if celsius is not None:
            every = max(round(drive.rate), 1)
            stamp = drive.stamp[::every]
            return Temperatures(stamp, stamp.copy(), celsius[::every])
    return None
