"""Vibration of an IMU in a vehicle by engine, wheels and road, as its samples contain it."""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter

#: Hz, firing frequency at rest: a four-cylinder engine at 800 revolutions a minute
_FIRING = 26.7
#: Hz per m/s, its growth with the speed within a gear
_FIRING_PER_SPEED = 1.6
#: m/s, range of speeds of a gear
_GEAR = 12.0
#: Hz, lowest rate at which the road is computed before it is sampled, without a filter, at that of the IMU
_FASTEST = 200.0
#: Hz, frequency band of the road's vibration that springs and tyres pass on to the body
_WHEELS = (4.0, 25.0)
#: m, wavelengths with which the roughness of the road varies
_SURFACES = (830.0, 310.0, 97.0)
#: vibration along each body axis over that along the vertical one
_AXES = np.array([0.5, 0.6, 1.0])
#: rad/s of rotation for each m/s^2 of vibration
_TURN = 0.06
#: relative size of the harmonics of the wheels: imbalance, tyre and tread
_HARMONICS = (1.0, 0.6, 0.4, 0.3)
#: m/s, speed for which the vibration by the wheels is given; as with any imbalance it grows with the square of the
#: speed
_WHEEL_SPEED = 10.0
#: m/s, speed above which it does not grow
_FASTEST_WHEEL = 20.0
#: Hz, natural frequencies of the suspension and of the IMU's mount
_LINES = (11.3, 14.1)


@dataclass(frozen=True)
class Vibration:
    """idle: m/s^2 RMS of the engine on the vertical axis. engine_off: share of the stops with the engine off.
    road: m/s^2 RMS of the road on the vertical axis at 10 m/s, in proportion to the speed. smoothness: how much the
    surface varies along the road: its roughness is lognormal about the mean, with this standard deviation.
    wheels: m/s^2 RMS of the first harmonic of each of four wheels that are out of balance, at 10 m/s.
    circumference: m, of all wheels, within 0.1 %. changed: s after which it is 3 % smaller; 0: never. lines: m/s^2 RMS
    of each of two lines of constant frequency (Hz) while the vehicle moves. gears: ratios of the engine's second order
    to the wheels; in motion the engine vibrates with `idle` at this order, instead of at its firing frequency.

    The other axes shake somewhat less, and the body turns with it. Faster parts than the IMU's samples show appear
    folded, as without an anti-aliasing filter.
    """

    idle: float = 0.0
    road: float = 0.0
    engine_off: float = 0.5
    smoothness: float = 0.7
    wheels: float = 0.0
    circumference: float = 1.95
    changed: float = 0.0
    lines: float = 0.0
    gears: tuple[float, ...] = ()

    def shake(self, drive, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Added specific force (n, 3) m/s^2 and angular rate (n, 3) rad/s, body axes, at the samples of `drive`."""
        speed = np.abs(drive.path.wheel_speed(drive.time))
        engine = np.random.default_rng(rng.integers(2**63))
        force = self._road(drive, speed, rng) + self._engine(drive, speed, engine)
        if self.wheels or self.lines:
            force += self._wheels(drive, speed, np.random.default_rng(engine.integers(2**63)))
        return force * _AXES, _TURN * force[:, [1, 2, 0]] * _AXES[[2, 2, 0]]

    def _engine(self, drive, speed, rng):
        """Firing of the engine, with a frequency that is proportional to the speed within a gear."""
        standing = speed < 1e-9
        number = np.cumsum(np.diff(standing.astype(int), prepend=0) > 0)
        off = rng.uniform(size=number[-1] + 1)[number] < self.engine_off
        frequency = _FIRING + _FIRING_PER_SPEED * (speed % _GEAR)
        if self.gears:
            gear = np.minimum((speed / _GEAR * len(self.gears)).astype(int), len(self.gears) - 1)
            frequency = np.where(speed > 2.0, np.array(self.gears)[gear] * speed / self.circumference, _FIRING)
        phase = 2 * math.pi * np.cumsum(frequency / drive.rate * (1 + 0.01 * rng.standard_normal(len(speed))))
        shaking = math.sqrt(2) * self.idle * np.sin(phase[:, None] + rng.uniform(0, 2 * math.pi, 3))
        return shaking * ~(standing & off)[:, None]

    def _wheels(self, drive, speed, rng):
        """Four wheels that are not quite the same, and lines of constant frequency (Hz)."""
        circumference = self.circumference * np.where(self.changed and drive.time > self.changed, 0.97, 1.0)
        turned = 2 * math.pi * np.cumsum(speed / circumference) / drive.rate
        force = np.zeros((len(speed), 3))
        strength = math.sqrt(2) * self.wheels * (np.minimum(speed, _FASTEST_WHEEL) / _WHEEL_SPEED) ** 2
        for _ in range(4):
            phase = turned * (1.0 + 0.001 * rng.standard_normal())
            for number, part in enumerate(_HARMONICS, 1):
                begin = rng.uniform(0, 2 * math.pi, 3)
                force += part * strength[:, None] * np.sin(number * phase[:, None] + begin)
        for frequency in _LINES:
            swing = 2 * math.pi * np.cumsum(frequency * (1 + 0.2 * rng.standard_normal(len(speed)))) / drive.rate
            force += math.sqrt(2) * self.lines * ((speed > 0.1) * np.sin(swing))[:, None]
        return force

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
