"""The exact motion of a simulated land vehicle, and the samples of perfect sensors in it.

Speed and course are piecewise quintic polynomials of time, so accelerations and angular rates are continuous and known
exactly. Positions are their integrals in the local level frame `n`, by Gauss-Legendre quadrature to rounding.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline, PPoly
from scipy.signal import cont2discrete, lfilter
from scipy.spatial.transform import Rotation

from mems_ins_fusion.errors import InputError
from mems_ins_fusion.navigation.earth import gravity, radii
from mems_ins_fusion.navigation.strapdown import EARTH_RATE
from mems_ins_fusion.simulation.manoeuvres import CITY, Segment, plan

#: ns, stamp of the start: a present date, so that stamps look like those of real recordings
START_STAMP = 1_700_000_000_000_000_000
#: latitude, longitude (rad) and height (m) of the start
ORIGIN = (0.8378, 0.2007, 480.0)
#: s of motion that is simulated beyond the end, for fixes that describe a later time
MARGIN = 60.0
#: number of samples computed at once
_BLOCK = 100_000
#: s, length of a quadrature cell: the ends of segments fall on the edges of cells
_CELL = 0.02
#: damping ratio of a car's body on its springs
_DAMPING = 0.3
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


def stream(seed: int, purpose: str) -> np.random.Generator:
    """Random number generator for one purpose: nothing else that is simulated with `seed` changes its numbers."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(purpose.encode())))


@dataclass(frozen=True)
class Motion:
    """Position, velocity and attitude of the vehicle at times (n,) s after the start.

    position: (n, 3) m north-east-down along the ground from the start. latitude, longitude: (n,) rad. height: (n,) m.
    velocity: (n, 3) m/s north-east-down. roll, pitch, yaw: (n,) rad, body (forward-right-down) to north-east-down;
    yaw clockwise from north, not wrapped.
    """

    time: np.ndarray
    position: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    velocity: np.ndarray
    roll: np.ndarray
    pitch: np.ndarray
    yaw: np.ndarray

    @property
    def attitude(self) -> Rotation:
        """Rotation from body to north-east-down."""
        return Rotation.from_euler('ZYX', np.column_stack([self.yaw, self.pitch, self.roll]))


@dataclass(frozen=True)
class Drive(Motion):
    """A simulated drive, sampled as an IMU samples it.

    stamp: (n,) int64 ns. specific_force: (n, 3) m/s^2 and angular_rate: (n, 3) rad/s in body axes, each the mean over
    the interval that ends at `time`: the rotation vector and, in the body axes at mid-interval, the velocity increment,
    divided by the interval. rate: samples per second. path: the motion at any time.
    """

    stamp: np.ndarray
    specific_force: np.ndarray
    angular_rate: np.ndarray
    rate: float
    path: Path

    def at(self, time) -> Motion:
        """The exact motion at `time`, (m,) s after the start, whether or not a sample falls on it."""
        return self.path.at(time)

    def altered(self, **changes) -> Drive:
        """The same drive on a `Path` with `changes`, such as a suspension that pitches."""
        return follow(replace(self.path, **changes), self.time[-1], self.rate)


@dataclass(frozen=True)
class Path:
    """Exact motion along a road, as functions of time.

    segments: the manoeuvres. origin: latitude, longitude (rad) and height (m) of the start. course: of the start, rad.
    hills, banks: (k, 3) of amplitude, wavelength (m) and phase of cosines along the road: of its grade, and of its
    bank, positive with the right side down; empty: a level road.
    pitch_per_acceleration, roll_per_acceleration: rad per m/s^2, positive as in a car: nose up when it speeds up, and
    leaning outwards in a bend. suspension: natural frequency, Hz, with which the body follows; 0: at once.
    unevenness: rad, of pitch and of roll on that suspension, from the road, at 10 m/s (RMS, growing with the speed);
    unevenness_seed: what it is drawn from. sideslip_per_acceleration: rad per m/s^2, angle from the body's x axis to
    the velocity, clockwise, for a lateral acceleration to the right. axle_to_imu: (3,) m, body axes, from the middle of
    the rear axle, which is what follows the road, to the IMU, whose motion this is. rotating_earth: the sensors feel
    earth rate, transport rate and Coriolis acceleration; without it `n` is an inertial frame, and the planar
    mechanization is exact on a level road.
    """

    segments: tuple[Segment, ...]
    origin: tuple[float, float, float] = ORIGIN
    course: float = 0.0
    hills: tuple[tuple[float, float, float], ...] = ()
    pitch_per_acceleration: float = 0.0
    roll_per_acceleration: float = 0.0
    sideslip_per_acceleration: float = 0.0
    rotating_earth: bool = False
    banks: tuple[tuple[float, float, float], ...] = ()
    suspension: float = 0.0
    unevenness: float = 0.0
    unevenness_seed: int = 0
    axle_to_imu: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, time) -> Motion:
        """The motion at `time`, (m,) s; before the start the vehicle stands at the origin.

        ValueError for a time after the last segment.
        """
        time = np.atleast_1d(np.asarray(time, float))
        if time.size and time.max() > self._speed.x[-1]:
            raise InputError(f'the simulated drive ends at {self._speed.x[-1]:g} s; asked for {time.max():g} s')
        t = np.maximum(time, 0.0)
        start, latitude, longitude, height, *plane = self._cells
        cell = np.minimum((t / _CELL).astype(int), len(start) - 1)
        step = self._plane_displacement(start[cell], t - start[cell])
        climb = _sum_of_integrals(self.hills, self._distance(t))
        meridian, prime_vertical = radii(latitude[cell])
        lat = latitude[cell] + step[0] / (meridian + height[cell])
        lon = longitude[cell] + step[1] / ((prime_vertical + height[cell]) * np.cos(latitude[cell]))
        speed, course = self._speed(t), self._course(t)
        grade = _sum_of(self.hills, self._distance(t))
        velocity = np.column_stack([speed * np.cos(course), speed * np.sin(course), -grade * speed])
        position = np.column_stack([plane[0][cell] + step[0], plane[1][cell] + step[1], -climb])
        roll, pitch, yaw = self._angles(t)
        axle = Motion(time, position, lat, lon, self.origin[2] + climb, velocity, roll, pitch, yaw)
        return self._at_imu(axle, t) if any(self.axle_to_imu) else axle

    def wheel_speed(self, time) -> np.ndarray:
        """Speed of the rear axle along the road, (m,) m/s at `time` (m,) s, negative in reverse."""
        t = np.maximum(np.asarray(time, float), 0.0)
        return self._speed(t) * np.hypot(1.0, _sum_of(self.hills, self._distance(t)))

    def _at_imu(self, axle: Motion, t) -> Motion:
        """The motion of the IMU, of that of the rear axle."""
        arm = axle.attitude.apply(self.axle_to_imu)
        rates = _body_rates(axle.roll, axle.pitch, *self._angles(t, 1))
        turning = axle.attitude.apply(np.cross(rates, self.axle_to_imu))
        meridian, prime_vertical = radii(axle.latitude)
        return replace(axle, position=axle.position + arm, height=axle.height - arm[:, 2],
                       latitude=axle.latitude + arm[:, 0] / (meridian + axle.height),
                       longitude=axle.longitude + arm[:, 1] / ((prime_vertical + axle.height) * np.cos(axle.latitude)),
                       velocity=axle.velocity + turning)

    def _angles(self, t, order=0):
        """Roll, pitch and yaw of the body, rad, at `t` (m,) s, or their derivatives with `order` 1."""
        (pitch, roll), distance = self._body(t, order), self._distance(t)
        grade, bank = _sum_of(self.hills, distance), _sum_of(self.banks, distance)
        slip = self.sideslip_per_acceleration * self._lateral(t, order)
        if order == 0:
            return np.arctan(bank) + roll, np.arctan(grade) + pitch, self._course(t) - slip
        speed = self._speed(t)
        return (_sum_of_slopes(self.banks, distance) * speed / (1 + bank**2) + roll,
                _sum_of_slopes(self.hills, distance) * speed / (1 + grade**2) + pitch, self._course(t, 1) - slip)

    def _lateral(self, t, order=0):
        """Lateral acceleration of the axle to the right, m/s^2, or its derivative."""
        lateral = self._speed(t) * self._course(t, 1 + order)
        return lateral + self._speed(t, 1) * self._course(t, 1) if order else lateral

    def _body(self, t, order=0):
        """Pitch and roll of the body on its wheels, rad, or their derivatives."""
        if self.suspension > 0:
            return [spline(t, order) for spline in self._springs]
        return self.pitch_per_acceleration * self._speed(t, 1 + order), -self.roll_per_acceleration * self._lateral(
            t, order)

    @cached_property
    def _springs(self) -> tuple[CubicSpline, CubicSpline]:
        """Pitch and roll of a body that swings on its suspension: a damped oscillator each, pushed by acceleration and
        road. Sampled, and smooth in between: any smooth course of the angles is a motion that is possible.
        """
        t = np.arange(round(self._speed.x[-1] / _CELL) + 1) * _CELL
        push = np.vstack([self.pitch_per_acceleration * self._speed(t, 1),
                          -self.roll_per_acceleration * self._lateral(t)])
        omega = 2 * math.pi * self.suspension
        oscillator = [omega**2], [1.0, 2 * _DAMPING * omega, omega**2]
        numerator, denominator, _ = cont2discrete(oscillator, _CELL, 'bilinear')
        # white noise of this size makes the oscillator swing with a standard deviation of 1
        size = math.sqrt(4 * _DAMPING / (omega * _CELL))
        road = stream(self.unevenness_seed, 'unevenness').standard_normal((len(t), 2)).T
        push += self.unevenness * size * np.abs(self._speed(t)) / 10.0 * road
        return tuple(CubicSpline(t, lfilter(numerator[0], denominator, axis)) for axis in push)

    @cached_property
    def _speed(self) -> PPoly:
        return _quintic_steps(self.segments, [s.speed_change for s in self.segments], 0.0)

    @cached_property
    def _course(self) -> PPoly:
        return _quintic_steps(self.segments, [s.course_change for s in self.segments], self.course)

    @cached_property
    def _distance(self) -> PPoly:
        return self._speed.antiderivative()

    def _plane_displacement(self, start, duration):
        """Displacement north and east, (2, m) m, from `start` (m,) over `duration` (m,) s, within a cell."""
        displacement = np.zeros((2, len(start)))
        for node, weight in zip(_NODES, _WEIGHTS):
            t = start + 0.5 * duration * (1 + node)
            along = 0.5 * duration * weight * self._speed(t)
            course = self._course(t)
            displacement += along * np.cos(course), along * np.sin(course)
        return displacement

    @cached_property
    def _cells(self):
        """At the start of each quadrature cell: time, latitude, longitude, height, distance north and east."""
        n = round(self._speed.x[-1] / _CELL)
        start = np.arange(n) * _CELL
        steps = self._plane_displacement(start, np.full(n, _CELL))
        north, east = np.cumsum(np.column_stack([np.zeros(2), steps]), axis=1)
        height = self.origin[2] + _sum_of_integrals(self.hills, self._distance(np.arange(n + 1) * _CELL))
        middle_height = _middle(height)
        # the radii need the latitude: one from a constant radius is good for them to 1e-12
        middle = _middle(self.origin[0] + north / (radii(self.origin[0])[0] + self.origin[2]))
        latitude = self.origin[0] + _cumulated(steps[0] / (radii(middle)[0] + middle_height))
        longitude = self.origin[1] + _cumulated(steps[1] / ((radii(middle)[1] + middle_height) * np.cos(middle)))
        return tuple(a[:-1] for a in (np.append(start, 0.0), latitude, longitude, height, north, east))


def _sum_of(waves, distance):
    """Sum of `waves` (amplitude, wavelength in m, phase) at `distance`, m, along the road."""
    return sum((size * np.cos(2 * np.pi * distance / length + phase) for size, length, phase in waves),
               np.zeros_like(distance))


def _sum_of_integrals(waves, distance):
    """Integral of `_sum_of` from the start of the road, m."""
    return sum((size * length / (2 * np.pi) * (np.sin(2 * np.pi * distance / length + phase) - np.sin(phase))
                for size, length, phase in waves), np.zeros_like(distance))


def _sum_of_slopes(waves, distance):
    """Derivative of `_sum_of` by the distance, 1/m."""
    return sum((-size * 2 * np.pi / length * np.sin(2 * np.pi * distance / length + phase)
                for size, length, phase in waves), np.zeros_like(distance))


def _body_rates(roll, pitch, roll_rate, pitch_rate, yaw_rate):
    """Angular rates in body axes, (m, 3) rad/s, by Euler's kinematic equations."""
    sin_roll, cos_roll, level = np.sin(roll), np.cos(roll), yaw_rate * np.cos(pitch)
    return np.column_stack([roll_rate - yaw_rate * np.sin(pitch), pitch_rate * cos_roll + level * sin_roll,
                            level * cos_roll - pitch_rate * sin_roll])


def _frame_rates(edges: Motion):
    """Earth rate and transport rate in `n`, (n - 1, 3) rad/s, in the middle between `edges`."""
    latitude, (v_n, v_e, _) = _middle(edges.latitude), _middle(edges.velocity).T
    meridian, prime_vertical = (radius + _middle(edges.height) for radius in radii(latitude))
    earth = EARTH_RATE * np.column_stack([np.cos(latitude), np.zeros_like(latitude), -np.sin(latitude)])
    return earth, np.column_stack([v_e / prime_vertical, -v_n / meridian, -v_e * np.tan(latitude) / prime_vertical])


def _middle(values):
    return 0.5 * (values[1:] + values[:-1])


def _cumulated(steps):
    return np.concatenate([[0.0], np.cumsum(steps)])


def _quintic_steps(segments, changes, start) -> PPoly:
    """The function that changes by `changes` over the segments, with two continuous derivatives."""
    duration = np.array([s.duration for s in segments])
    change = np.asarray(changes, float)
    level = start + _cumulated(change)[:-1]
    zero = np.zeros_like(change)
    coefficients = [6 * change / duration**5, -15 * change / duration**4, 10 * change / duration**3, zero, zero, level]
    return PPoly(np.array(coefficients), _cumulated(duration))


def simulate_drive(duration: float, seed: int = 0, rate: float = 100.0, *, standstill: float = 25.0,
                   hills: bool = False, rotating_earth: bool = False, origin=ORIGIN,
                   pitch_per_acceleration: float = 0.0, roll_per_acceleration: float = 0.0,
                   sideslip_per_acceleration: float = 0.0, grade: float = 0.0, bank: float = 0.0,
                   parked_on_slope: bool = False, manoeuvres=CITY, suspension: float = 0.0, unevenness: float = 0.0,
                   axle_to_imu=(0.0, 0.0, 0.0)) -> Drive:
    """A land vehicle's drive: a standstill, then straights, bends, right-angle turns and stops at 2-20 m/s.

    duration: s. seed: the same gives the same drive, and a longer one begins as a shorter one. rate: Hz, IMU samples.
    standstill: s at the start; `duration` or more for a vehicle at rest. hills: a road with grades of up to 6 %; else a
    level one. grade, bank: of a random road instead, the largest there can be (0.03 is 3 %), which parked_on_slope
    begins with. manoeuvres: a deck of `manoeuvres.py`. The others as in `Path`. ValueError for a duration or rate that
    is not positive, a negative standstill.
    """
    if not (0 < duration < np.inf and 0 < rate < np.inf):
        raise InputError(f'duration and rate must be positive, got {duration:g} s and {rate:g} Hz')
    if not standstill >= 0:
        raise InputError(f'the standstill at the start must not be negative, got {standstill:g} s')
    rng = stream(seed, 'drive')
    course = rng.uniform(-np.pi, np.pi)
    segments = tuple(plan(duration + MARGIN, standstill if standstill < duration else duration + MARGIN, rng,
                          manoeuvres))
    road = _random_hills(stream(seed, 'hills')) if hills and not grade else _random_waves(
        grade, (1900.0, 700.0, 260.0), parked_on_slope, stream(seed, 'grade'))
    path = Path(segments, tuple(origin), course, road, pitch_per_acceleration, roll_per_acceleration,
                sideslip_per_acceleration, rotating_earth,
                _random_waves(bank, (1100.0, 370.0, 130.0), parked_on_slope, stream(seed, 'bank')),
                suspension, unevenness, seed, tuple(axle_to_imu))
    return follow(path, duration, rate)


def _random_hills(rng):
    waves = zip((0.025, 0.02, 0.012), (1900.0, 700.0, 260.0))
    return tuple((grade, length * rng.uniform(0.8, 1.2), rng.uniform(0, 2 * np.pi)) for grade, length in waves)


def _random_waves(largest, wavelengths, crest, rng):
    """Waves that reach `largest` together, at the start if `crest`: either upwards or downwards."""
    if not largest:
        return ()
    start = rng.choice([0.0, np.pi])
    phases = [start] * 3 if crest else rng.uniform(0, 2 * np.pi, 3)
    return tuple((share * largest, length * rng.uniform(0.8, 1.2), phase)
                 for share, length, phase in zip((0.5, 0.3, 0.2), wavelengths, phases))


def follow(path: Path, duration: float, rate: float) -> Drive:
    """The drive on `path` as an IMU with `rate` sees it; its first sample ends at time 0."""
    n = int(np.floor(duration * rate + 1e-6)) + 1
    blocks = [_block(path, rate, first, min(first + _BLOCK, n)) for first in range(0, n, _BLOCK)]
    arrays = {name: np.concatenate([block.pop(name) for block in blocks]) for name in list(blocks[0])}
    stamp = START_STAMP + np.round(arrays['time'] * 1e9).astype(np.int64)
    return Drive(**arrays, stamp=stamp, rate=rate, path=path)


def _block(path: Path, rate: float, first: int, stop: int) -> dict[str, np.ndarray]:
    """The samples from `first` to before `stop`: a block at a time, as this takes many times the room of the result."""
    edges = path.at(np.arange(first - 1, stop) / rate)
    velocity_increment = np.diff(edges.velocity, axis=0)
    velocity_increment[:, 2] -= gravity(edges.latitude, edges.height)[1:] / rate
    attitude = edges.attitude
    before = seen_from_middle = seen_from_end = attitude[:-1]  # the attitude at the start, in `n` of then and later
    if path.rotating_earth:
        earth, transport = _frame_rates(edges)
        frame_turn = (earth + transport) / rate
        seen_from_middle = Rotation.from_rotvec(-frame_turn / 2) * before
        seen_from_end = Rotation.from_rotvec(-frame_turn) * before
        velocity_increment += np.cross(2 * earth + transport, _middle(edges.velocity)) / rate
    turn = (seen_from_end.inv() * attitude[1:]).as_rotvec()
    middle = seen_from_middle * Rotation.from_rotvec(turn / 2)
    states = {name: getattr(edges, name)[1:] for name in Motion.__dataclass_fields__}
    return {**states, 'specific_force': middle.inv().apply(velocity_increment) * rate, 'angular_rate': turn * rate}
