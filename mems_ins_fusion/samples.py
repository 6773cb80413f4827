"""Samples of the sensors as arrays, the common data format of all parts of the package.

Stamps are integer nanoseconds since the epoch, as in the message headers. `received` is the time at which the message
arrived (the log time of a bag); a live filter processes messages in this order.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np

SECOND = 10**9  # ns: stamps are whole nanoseconds


def runs(mask: np.ndarray) -> np.ndarray:
    """First and last + 1 of each run of True in `mask` (n,): (k, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, np.int8), [0]]))).reshape(-1, 2)


#: no input of a vehicle has a larger number, in any unit
_MOST = 1e9


def possible_numbers(values: np.ndarray) -> np.ndarray:
    """`values`, NaN where an input of a vehicle cannot have such a number."""
    return np.where(np.abs(values) <= _MOST, values, np.nan)


def possible(values: np.ndarray) -> np.ndarray:
    """(n,) which of `values`, (n,) or (n, k), have only numbers that an input of a vehicle can have."""
    known = ~np.isnan(possible_numbers(values))
    return known if known.ndim == 1 else known.all(axis=1)


def in_time_order(stamp: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Indices of the samples that are `usable` (n,) bool, in the order of `stamp` (n,) ns; of equal stamps, the first.
    """
    index = np.flatnonzero(usable)
    return index[np.unique(stamp[index], return_index=True)[1]]


class _Samples:
    """Length and slicing for dataclasses whose fields are arrays along the same first axis."""

    def __len__(self) -> int:
        return len(self.stamp)

    def select(self, index):
        """The samples at `index` (a slice, a boolean mask or integer indices)."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{name: a[index] for name, a in arrays.items() if a is not None})


@dataclass(frozen=True)
class ImuSamples(_Samples):
    """Inertial samples in sensor axes `s`.

    stamp, received: (n,) int64 ns. specific_force: (n, 3) m/s^2. angular_rate: (n, 3) rad/s.
    orientation: (n, 4) quaternion x, y, z, w as the message carries it, or None where no message had one.
    temperature: (n,) degrees Celsius, the last known when each sample arrived, NaN before; None where unknown.
    difference: (n, 6) specific force and angular rate, another IMU minus the leading one, where two IMUs differ that
    these samples are the mean of, else zero; None of a single IMU.
    """

    stamp: np.ndarray
    received: np.ndarray
    specific_force: np.ndarray
    angular_rate: np.ndarray
    orientation: np.ndarray | None = None
    temperature: np.ndarray | None = None
    difference: np.ndarray | None = None

    def with_temperature(self, temperatures: Temperatures | None) -> ImuSamples:
        """The samples with the latest of `temperatures`, in the order of arrival, at the time when each arrived."""
        if temperatures is None:
            return self
        last = np.searchsorted(temperatures.received, self.received, side='right') - 1
        celsius = np.append(temperatures.celsius, np.nan)[last]  # index -1 (none yet) gives the NaN
        return replace(self, temperature=celsius)


#: samples of an IMU that a recording does not have
NO_SAMPLES = ImuSamples(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))


@dataclass(frozen=True)
class Fixes(_Samples):
    """GNSS positions of the antenna.

    stamp, received: (n,) int64 ns. latitude, longitude: (n,) rad. height: (n,) m above the ellipsoid.
    covariance: (n, 3, 3) m^2, east-north-up as in `NavSatFix`. status: (n,) int8, `NavSatStatus.status`.
    covariance_type: (n,) uint8, `NavSatFix.position_covariance_type`.
    """

    stamp: np.ndarray
    received: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    covariance: np.ndarray
    status: np.ndarray
    covariance_type: np.ndarray


@dataclass(frozen=True)
class Reference(_Samples):
    """A reference trajectory, against which errors are measured.

    stamp: (n,) int64 ns. latitude, longitude: (n,) rad. height: (n,) m.
    velocity: (n, 3) m/s north-east-down or None. yaw: (n,) rad clockwise from north or None.
    """

    stamp: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    velocity: np.ndarray | None = None
    yaw: np.ndarray | None = None


@dataclass(frozen=True)
class Temperatures(_Samples):
    """Sensor temperature. stamp, received: (n,) int64 ns. celsius: (n,) degrees Celsius."""

    stamp: np.ndarray
    received: np.ndarray
    celsius: np.ndarray


@dataclass(frozen=True)
class Speeds(_Samples):
    """Speed of the vehicle, from wheels or gearbox.

    stamp, received: (n,) int64 ns. speed: (n,) m/s, forward at the rear axle, negative in reverse.
    variance: (n,) m^2/s^2, NaN or not above zero where the message has none.
    """

    stamp: np.ndarray
    received: np.ndarray
    speed: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True)
class Velocities(_Samples):
    """Velocity of the antenna over ground, from the GNSS receiver.

    stamp, received: (n,) int64 ns. velocity: (n, 3) m/s north-east-down. covariance: (n, 3, 3) m^2/s^2, north-east-down
    too, with NaN or not above zero on the diagonal where the message has none.
    """

    stamp: np.ndarray
    received: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class Headings(_Samples):
    """Heading of the vehicle, from two antennas or a compass.

    stamp, received: (n,) int64 ns. yaw: (n,) rad clockwise from north, NaN where the message has none.
    variance: (n,) rad^2, NaN or not above zero where the message has none.
    """

    stamp: np.ndarray
    received: np.ndarray
    yaw: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True)
class Pressures(_Samples):
    """Pressure of the air.

    stamp, received: (n,) int64 ns. pressure: (n,) Pa. variance: (n,) Pa^2, NaN or not above zero where the message
    has none.
    """

    stamp: np.ndarray
    received: np.ndarray
    pressure: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True)
class MagneticFields(_Samples):
    """Magnetic flux density where a magnetometer is.

    stamp, received: (n,) int64 ns. field: (n, 3) T, sensor axes. variance: (n,) T^2 of a component, NaN or not above
    zero where the message has none.
    """

    stamp: np.ndarray
    received: np.ndarray
    field: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True)
class Twists(_Samples):
    """Velocity and turn rate of the vehicle in its own axes, forward-right-down, from odometry.

    stamp, received: (n,) int64 ns. twist: (n, 3) m/s forwards, m/s to the right, rad/s clockwise. variance: (n, 3) of
    these, NaN or not above zero where the message has none.
    """

    stamp: np.ndarray
    received: np.ndarray
    twist: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True)
class Displacements(Twists):
    """Twists computed as the mean between two successive poses, with stamps in the middle between them.

    position: (n, 3) m and orientation: (n, 4) quaternion x, y, z, w, of the second pose as in its message. later: (n,)
    int64 ns, stamp of the second pose.
    """

    position: np.ndarray
    orientation: np.ndarray
    later: np.ndarray


class Aiding(dict):
    """The inputs besides the fixes: samples by the name of the input (`filter.measurements`)."""


@dataclass(frozen=True)
class Recording:
    """One recording. Absent parts are None. others: samples by name, of the inputs that have no field here."""

    name: str
    imu: ImuSamples
    gnss: Fixes | None = None
    reference: Reference | None = None
    temperature: Temperatures | None = None
    speed: Speeds | None = None
    velocity: Velocities | None = None
    heading: Headings | None = None
    others: Mapping[str, _Samples] = field(default_factory=dict)

    def streams(self) -> dict[str, _Samples]:
        """The parts that are not absent, by name."""
        parts = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ('name', 'others')}
        return {name: samples for name, samples in (parts | dict(self.others)).items() if samples is not None}

    def having(self, streams: Mapping[str, _Samples]) -> Recording:
        """The recording with `streams` in place of the parts of the same names."""
        own = {name: samples for name, samples in streams.items() if name in {f.name for f in fields(self)}}
        others = {name: samples for name, samples in streams.items() if name not in own}
        return replace(self, **own, others={**self.others, **others})
