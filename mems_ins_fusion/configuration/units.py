"""The units of an IMU by what it measured: gravity tells the accelerometers', the course the gyroscopes'."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.recordings.motion import Steering, compare_steering, find_standstill, up_axis
from mems_ins_fusion.recordings.units import ACCELERATION, RATE
from mems_ins_fusion.samples import Fixes, ImuSamples

_TOLERANCE = 0.2  # part of gravity: more is no bias
_FASTEST_TURN = 4.0  # rad/s: of no land vehicle


@dataclass(frozen=True)
class Units:
    """acceleration, rate: as `imu.acceleration_unit` and `imu.rate_unit`. gravity: whether it is in the accelerometers;
    without it their unit is only taken to be m/s^2. why_acceleration, why_rate: what that stands on.
    steering: course against gyroscopes, in SI units, or None. doubts: what does not fit."""

    acceleration: str
    rate: str
    gravity: bool
    why_acceleration: str
    why_rate: str
    steering: Steering | None
    doubts: tuple[str, ...] = ()


def find_units(imu: ImuSamples, fixes: Fixes | None, gravity: float) -> Units:
    """The units of `imu` as recorded. gravity: m/s^2, there."""
    still = find_standstill(imu, fixes)
    up, magnitude = up_axis(imu, still)
    acceleration = next((unit for unit, scale in ACCELERATION.items()
                         if abs(magnitude * scale / gravity - 1.0) < _TOLERANCE), None)
    where = 'at rest' if still.any() else 'on average'
    doubts = []
    if acceleration is not None:
        why = f'{magnitude:.4g} {acceleration} {where}, where gravity is {gravity:.2f} m/s^2'
    else:
        why = f'{magnitude:.3g} {where}: no gravity in it, taken to be m/s^2'
        if magnitude > 0.2 * gravity:
            doubts.append(f'the accelerometers show {magnitude:.3g} {where}, which is gravity in no known unit')
    rate, why_rate, steering, wrong = _rate_unit(imu, fixes, up)
    return Units(acceleration or 'm/s^2', rate, acceleration is not None, why, why_rate, steering, (*doubts, *wrong))


def _rate_unit(imu, fixes, up):
    steering = compare_steering(imu, fixes, up) if fixes is not None and len(fixes) > 1 else None
    if steering is None or not steering.tells:
        largest = float(np.nanpercentile(np.abs(imu.angular_rate), 99.9))
        rate = 'deg/s' if largest > _FASTEST_TURN else 'rad/s'
        return rate, f'no turn tells; the largest rates are {largest:.2g}', None, ()
    ratio = 1.0 / abs(steering.scale)
    rate = min(RATE, key=lambda unit: abs(np.log(ratio * RATE[unit])))
    why = f'the gyroscopes turn by {ratio * RATE[rate]:.3g} of the angle of the course'
    wrong = []
    if steering.scale < 0:
        wrong.append('the gyroscopes turn against the course: their axes, or the accelerometers\', are mirrored, which '
                     'no mounting explains')
    if abs(np.log(ratio * RATE[rate])) > 0.2:
        wrong.append(f'{why}: neither rad/s nor deg/s')
    return rate, why, steering, wrong
