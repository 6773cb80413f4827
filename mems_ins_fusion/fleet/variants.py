"""Recordings made from one recording: with fixes withheld, for filters that cannot be copied at an outage; and changed
in ways that the result of a filter must follow exactly, a test that needs no truth.

Source of the second idea: T. Y. Chen, S. C. Cheung, S. M. Yiu, "Metamorphic testing: a new approach for generating next
test cases", 1998.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..filter.measurements.registry import MEASUREMENTS
from ..navigation.earth import from_local, to_local
from ..navigation.frames import mounting, wrap
from ..recordings.several import shifted_recording
from ..samples import Recording

#: ns by which all stamps are moved
SHIFT = 1000
#: effect of a mirror that swaps left and right on a vector in body axes (forward, right, down)
_MIRROR = np.diag([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Variant:
    """One way to change a recording. make: (recording, values of the parameters, datum) -> the changed recording. back:
    converts (north, east), m, of its result to those of the unchanged recording. shift: ns, by which its stamps are
    later. parameters: of this package's filter for it. words: the change in words."""

    words: str
    make: Callable[[Recording, dict, tuple], Recording]
    back: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    parameters: Callable[[dict], dict] = lambda values: values
    shift: int = 0


def shifted(recording: Recording, values: dict, datum: tuple) -> Recording:
    """All stamps a microsecond later."""
    return shifted_recording(recording, SHIFT)


def turned(recording: Recording, values: dict, datum: tuple) -> Recording:
    """The world rotated clockwise by 90 degrees: north becomes east."""
    return _world(recording, datum, np.array([[0.0, -1.0], [1.0, 0.0]]), lambda yaw: yaw + np.pi / 2)


def mirrored(recording: Recording, values: dict, datum: tuple) -> Recording:
    """East and west swapped, and left and right of the vehicle: its sensors measure what they would in that world."""
    reflect, imu = _reflection(values), recording.imu
    # a rate is an axial vector: its sign is opposite
    imu = replace(imu, specific_force=imu.specific_force @ reflect.T, angular_rate=-imu.angular_rate @ reflect.T)
    return _world(replace(recording, imu=imu), datum, np.diag([1.0, -1.0]), lambda yaw: -yaw)


def _reflection(values: dict) -> np.ndarray:
    """(3, 3) the mirror in the axes of the sensor."""
    to_body = mounting(values['imu.mounting_rpy'])
    return to_body.T @ _MIRROR @ to_body


def halved(recording: Recording, values: dict, datum: tuple) -> Recording:
    """Half the rate of the IMU: each pair of samples is replaced by its mean, at the time of the later one."""
    imu, n = recording.imu, len(recording.imu) // 2 * 2

    def pairs(array):
        return None if array is None else array[:n].reshape(n // 2, 2, *array.shape[1:]).mean(axis=1)

    later = imu.select(slice(1, n, 2))
    return replace(recording, imu=replace(later, specific_force=pairs(imu.specific_force),
                                          angular_rate=pairs(imu.angular_rate)))


def _world(recording: Recording, datum: tuple, turn: np.ndarray, yaw: Callable) -> Recording:
    """Positions, velocities and headings in another world. turn: (2, 2) of north and east. The orientation in IMU
    messages is removed, as it is that of the first world."""
    gnss, axes = recording.gnss, np.eye(3)
    north, east, down = to_local(gnss.latitude, gnss.longitude, gnss.height, datum)
    latitude, longitude, height = from_local(*(turn @ [north, east]), down, datum)
    axes[:2, :2] = turn[::-1, ::-1]  # a NavSatFix has east first
    gnss = replace(gnss, latitude=latitude, longitude=longitude, height=height,
                   covariance=axes @ gnss.covariance @ axes.T)
    velocity, heading = recording.velocity, recording.heading
    if velocity is not None:
        three = np.eye(3)
        three[:2, :2] = turn
        velocity = replace(velocity, velocity=velocity.velocity @ three.T,
                           covariance=three @ velocity.covariance @ three.T)
    if heading is not None:
        heading = replace(heading, yaw=wrap(yaw(heading.yaw)))
    return replace(recording, imu=replace(recording.imu, orientation=None), gnss=gnss, velocity=velocity,
                   heading=heading, reference=None)


def _mirrored_parameters(values: dict) -> dict:
    """Those of the mirrored vehicle."""
    reflect, arm = _reflection(values), values['gnss.lever_arm']
    changed = {'gnss.lever_arm': [arm[0], -arm[1] + 0.0, arm[2]]}
    for sensor, sign in (('accelerometer', 1.0), ('gyroscope', -1.0)):
        bias = np.broadcast_to(values[f'{sensor}.bias'], 3)
        changed[f'{sensor}.bias'] = (sign * reflect @ bias).tolist()
    return values | changed


#: by name; the result for each is transformed back and compared with that for the unchanged recording
VARIANTS = {
    'shifted': Variant('stamps a microsecond later', shifted, lambda n, e: (n, e), shift=SHIFT),
    'turned': Variant('the world turned by 90 degrees', turned, lambda n, e: (e, -n)),
    'mirrored': Variant('the world and the vehicle mirrored', mirrored, lambda n, e: (n, -e), _mirrored_parameters),
    'halved': Variant('half the rate of the IMU', halved, lambda n, e: (n, e))}


def withheld(recording: Recording, begins: np.ndarray, duration: float, time_offset: float = 0.0) -> Recording:
    """`recording` without the fixes and other measurements of the receiver in the `duration` s after each of `begins`
    (ns).

    A fix at a begin is the last one before the outage. time_offset: s, as `gnss.time_offset`.
    """
    def outside(samples):
        stamp = samples.stamp - round(time_offset * 1e9)
        last = np.searchsorted(begins, stamp, side='left') - 1  # the last begin before each
        after = stamp - np.append(begins, np.iinfo(np.int64).max)[last]
        return samples.select(~((last >= 0) & (after <= round(duration * 1e9))))

    told = tuple(measurement.samples for measurement in MEASUREMENTS.values() if measurement.from_satellites)
    return recording.having({name: outside(samples) for name, samples in recording.streams().items()
                             if isinstance(samples, told)})


def interleaved(fixes: np.ndarray, first: int, spacing: float, duration: float, recovery: float) -> list[np.ndarray]:
    """Begins of outages, ns, for as few recordings as possible with `recovery` s with fixes between two outages.

    fixes: (n,) ns, stamps of the fixes, ascending. Outages begin at the first fix at or after `first`, `first` +
    spacing, ...: those of all recordings together are those of a replay.
    """
    wanted = np.arange(first, fixes[-1] - round(duration * 1e9) + 1, round(spacing * 1e9))
    begins = np.unique(fixes[np.searchsorted(fixes, wanted)])
    apart = max(int(np.ceil((duration + recovery) / spacing)), 1)
    return [begins[i::apart] for i in range(min(apart, len(begins)))]


