"""What shakes an IMU in a vehicle beside the motion of the body: the engine and the road, as it samples them."""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter

_FIRING = 26.7  # Hz: a four-cylinder engine at 800 revolutions a minute
_FIRING_PER_SPEED = 1.6  # Hz per m/s, up to a gear's end
_GEAR = 12.0  # m/s
_FASTEST = 200.0  # Hz: the road is made at this rate at least, and sampled without a filter
_WHEELS = (4.0, 25.0)  # Hz: what of the road reaches the body through springs and tyres
_SURFACES = (830.0, 310.0, 97.0)  # m: over which the surface changes
_AXES = np.array([0.5, 0.6, 1.0])  # part of the shaking along each body axis
_TURN = 0.06  # rad/s of rotation with each m/s^2 of shaking


@dataclass(frozen=True)
class Vibration:
    """idle: m/s^2 RMS of the engine on the vertical axis. engine_off: share of the stops with the engine off.
    road: m/s^2 RMS of the road on the vertical axis at 10 m/s, in proportion to the speed. smoothness: how much the
    surface varies along the road: its roughness is lognormal about the mean, with this standard deviation.

    The other axes shake somewhat less, and the body turns with it. Faster parts than the IMU's samples show appear
    folded, as without an anti-aliasing filter.
    """

    idle: float = 0.0
    road: float = 0.0
    engine_off: float = 0.5
    smoothness: float = 0.7

    def shake(self, drive, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Added specific force (n, 3) m/s^2 and angular rate (n, 3) rad/s, body axes, at the samples of `drive`."""
        speed = np.abs(drive.path.wheel_speed(drive.time))
        engine = np.random.default_rng(rng.integers(2**63))
        force = self._road(drive, speed, rng) + self._engine(drive, speed, engine)
        return force * _AXES, _TURN * force[:, [1, 2, 0]] * _AXES[[2, 2, 0]]

    def _engine(self, drive, speed, rng):
        """Firing of the engine, of a frequency that goes with the speed within a gear."""
        standing = speed < 1e-9
        number = np.cumsum(np.diff(standing.astype(int), prepend=0) > 0)
        off = rng.uniform(size=number[-1] + 1)[number] < self.engine_off
        frequency = _FIRING + _FIRING_PER_SPEED * (speed % _GEAR)
        phase = 2 * math.pi * np.cumsum(frequency / drive.rate * (1 + 0.01 * rng.standard_normal(len(speed))))
        shaking = math.sqrt(2) * self.idle * np.sin(phase[:, None] + rng.uniform(0, 2 * math.pi, 3))
        return shaking * ~(standing & off)[:, None]

    def _road(self, drive, speed, rng):
        every = max(math.ceil(_FASTEST / drive.rate), 1)
        rate = drive.rate * every
        waves = rng.uniform(0, 2 * math.pi, len(_SURFACES))
        distance = np.cumsum(speed) / drive.rate
        surface = sum(np.cos(2 * math.pi * distance / length + phase) for length, phase in zip(_SURFACES, waves))
        surface *= self.smoothness / math.sqrt(len(_SURFACES) / 2)
        numerator, denominator = butter(2, _WHEELS, 'bandpass', fs=rate)
        shaking = lfilter(numerator, denominator, rng.standard_normal((every * len(speed), 3)), axis=0)[::every]
        shaking *= math.sqrt(rate / 2 / (_WHEELS[1] - _WHEELS[0]))  # to a standard deviation of about one
        return self.road * (speed / 10.0 * np.exp(surface - self.smoothness**2 / 2))[:, None] * shaking
