"""The topics of a recording besides the IMU and the first receiver: what each measures, its unit, place and time
offset.

The type of its messages does not say what a topic measures: geometry_msgs/TwistWithCovarianceStamped can be a wheel
speed, the velocity of a receiver or an odometry. It is identified by its correlation with the speed of the fixes along
one axis, with their velocity north and east, or with the turn rate of the gyroscopes; else by its name. A topic that
neither identifies is not used.
"""
from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.configuration.baseline import estimate_baseline
from mems_ins_fusion.configuration.dynamic_pressure import DynamicPressure, estimate_dynamic_pressure
from mems_ins_fusion.configuration.mounting import Mounting
from mems_ins_fusion.configuration.odometry_axes import OdometryAxes, estimate_odometry_axes
from mems_ins_fusion.configuration.offset import FLOOR
from mems_ins_fusion.configuration.receiver import TOO_SURE
from mems_ins_fusion.configuration.second_imu import compare_imus
from mems_ins_fusion.configuration.speed_offset import SHOWN, LowPass, estimate_speed_offset
from mems_ins_fusion.configuration.turn_offset import TurnOffset, estimate_turn_offset, turning_of
from mems_ins_fusion.configuration.velocity_offset import estimate_velocity_offset
from mems_ins_fusion.filter.measurements.base import Measurement
from mems_ins_fusion.filter.measurements.registry import INERTIAL, TYPES
from mems_ins_fusion.filter.runs.usable import usable_fixes, usable_samples
from mems_ins_fusion.navigation.frames import near
from mems_ins_fusion.parameters.table import ALL
from mems_ins_fusion.recordings.aiding import (
    check_heading,
    check_speed,
    check_velocity,
    forward_speed,
    magnetic_factor,
    mistaken_velocity,
    pressure_factor,
    shows_course,
    speed_factor,
)
from mems_ins_fusion.recordings.motion import scatter_at_rest, sigmas
from mems_ins_fusion.recordings.remarks import INFO, SURE
from mems_ins_fusion.recordings.units import find_units, in_si
from mems_ins_fusion.samples import Displacements, Fixes, ImuSamples, Pressures, Speeds, Twists

#: kinds of measurements that contain the forward speed
WHEELED = 'speed', 'twist', 'pose'
#: kinds whose time offset can be estimated (`clock_of`)
CLOCKED = (*WHEELED, 'velocity', 'heading', 'fix')
# what names of topics say: measured by wheels, by another sensor,
WHEELS = re.compile(r'wheel|vehicle|(^|/|_)can($|/|_)', re.IGNORECASE)
OTHER_SENSORS = re.compile(r'lidar|laser|vision|visual|camera|vio', re.IGNORECASE)
# by a receiver, a heading,
_RECEIVER = re.compile(r'gps|gnss|fix', re.IGNORECASE)
_HEADING = re.compile(r'heading|yaw|compass|gps|gnss|antenna', re.IGNORECASE)
# the result of a filter that has used the fixes, or a reference
RESULT = re.compile(r'reference|truth|fused|filter|ekf|estimate|initial|gt($|/)', re.IGNORECASE)
# in words, of messages of an IMU, of which `find_topics` has looked at the rest
_NO_IMU = 'most of its rates and forces are the same in every message, or no numbers: no IMU, and '
_TURNING = 0.9  # smallest correlation (absolute value) of a turn rate with that of the gyroscopes
_HEADING_TURNS = 0.5  # the same for the derivative of a heading, which is noisier
# smallest ratio of the actual scatter of the difference of two receivers and the expected one of independent errors:
# with less they are the same receiver
_IN_COMMON = 0.7
LEAST_APART = 0.1  # m, smallest distance of two antennas: the phase centres of one antenna differ by less
#: share of the dynamic pressure that is known without a recording, as its standard deviation: an estimate with a larger
#: sigma tells nothing, and a smaller error of the parameter is estimated by the filter
SHARE_KNOWN = ALL['pressure.dynamic_sigma'].default
_ARM_KNOWN = 0.3  # m, largest sigma of the place of a second antenna that is used, or the noise of its fixes


@dataclass(frozen=True)
class InputShown:
    """What one recording shows of a topic.

    measurement: its kind. why: how that is known, in words. factor: converts it to SI units. turned: rad, constant
    error of a heading, clockwise. lag: time offset, s, and its sigma, None if unknown; of a further receiver against
    the first one; low_pass: of which a low pass makes a part, None if unknown. axes: of an odometry, dynamic: of a
    pressure, None if unknown. arm: (3,) m, forward-left-up, and its sigma (3,), infinite if unknown; from the IMU, of a
    further receiver from the first antenna. sigma: m, of the white noise of a receiver that states less; else None.
    rotation: of a further IMU, (3, 3) from its axes to those of the first one, and its sigma, rad; units: those of its
    accelerometers and gyroscopes. unplaced: in words, why `arm` is not known well enough; empty if it is. Such an input
    is used only if the transforms contain its place. messages: their number and rate, in words.
    """

    topic: str
    measurement: Measurement
    why: str
    factor: float = 1.0
    turned: float = 0.0
    lag: tuple[float, float] | None = None
    low_pass: LowPass | None = None
    axes: OdometryAxes | None = None
    dynamic: DynamicPressure | None = None
    arm: tuple[np.ndarray, np.ndarray] = (np.zeros(3), np.full(3, np.inf))
    sigma: float | None = None
    rotation: tuple[np.ndarray, float] | None = None
    units: tuple[str, str] = ('m/s^2', 'rad/s')
    unplaced: str = ''
    messages: str = ''


@dataclass(frozen=True)
class UnusedTopic:
    """A topic that is not used. why: in words."""

    topic: str
    why: str


def shown_inputs(readings: Mapping[str, Mapping[str, object]], receivers: Mapping[str, Fixes], imu: ImuSamples,
                 fixes: Fixes | None, still: np.ndarray, mounting: Mounting | None) -> list[InputShown | UnusedTopic]:
    """What one recording shows of each topic, in their order.

    readings: by topic and by each kind of measurement that it may be, the samples read so. receivers: by topic, the
    fixes of further receivers. imu: SI units. fixes: usable ones of the first receiver, None without. still: (n,) bool,
    samples at rest.
    """
    found = [_counted(_receiver(topic, others, imu, fixes, still), others) for topic, others in receivers.items()]
    for topic, read in readings.items():
        kind = _kind(topic, read, imu, fixes, mounting)
        timed = kind if isinstance(kind, UnusedTopic) else _timed(kind, read, imu, fixes, mounting)
        found.append(_counted(timed, next(iter(read.values()))))
    return _without_repeats(found)


def further_imus(imus: Mapping[str, ImuSamples], first: ImuSamples, fixes: Fixes | None, gravity: float
                 ) -> list[InputShown | UnusedTopic]:
    """What one recording shows of each IMU besides the first. imus: by topic, as recorded. first: SI units. gravity:
    m/s^2, there."""
    found: list[InputShown | UnusedTopic] = []
    for topic, samples in imus.items():
        units = find_units(usable_samples(samples), fixes, gravity)
        shown = compare_imus(first, in_si(samples, units.acceleration, units.rate))
        found.append(UnusedTopic(topic, shown) if isinstance(shown, str) else _counted(InputShown(
            topic, INERTIAL, f'a further IMU: its turn rates and forces are those of the first, turned '
            f'(+- {math.degrees(shown.sigma):.1f} deg)', lag=(shown.lag, shown.lag_sigma),
            rotation=(shown.rotation, shown.sigma), units=(units.acceleration, units.rate)), samples))
    return found


def _counted(shown: InputShown | UnusedTopic, samples) -> InputShown | UnusedTopic:
    if isinstance(shown, UnusedTopic):
        return shown
    interval = float(np.median(np.diff(samples.stamp))) * 1e-9
    return replace(shown, messages=f'{len(samples)} messages' + (f', {1.0 / interval:.3g} Hz' if interval > 0 else ''))


def _kind(topic, read, imu, fixes, mounting) -> InputShown | UnusedTopic:
    """The kind of measurement of a topic, or why it is not used."""
    if RESULT.search(topic):
        return UnusedTopic(topic, 'a result or a reference by its name')
    if 'pressure' in read:
        factor = pressure_factor(read['pressure'])
        if factor is None:
            return UnusedTopic(topic, 'no pressure of the air in any unit')
        if np.nanmin(read['pressure'].pressure) == np.nanmax(read['pressure'].pressure):
            return UnusedTopic(topic, 'the pressure is the same in every message')
        return InputShown(topic, TYPES['pressure'], 'of the air by its size', factor,
                          dynamic=dynamic_of(read['pressure'], factor, fixes))
    if 'magnetometer' in read:
        return _magnetometer(topic, read['magnetometer'], fixes)
    if 'pose' in read and (not read['twist'].twist.any() if 'twist' in read else OTHER_SENSORS.search(topic)):
        return _pose(topic, read['pose'], imu, fixes, mounting)
    if 'heading' in read:
        return _heading(topic, read['heading'], fixes, 'pose' not in read)
    if 'speed' not in read:
        return UnusedTopic(topic, 'poses that are not of a lidar or a camera by its name: they may have seen the fixes')
    factor = speed_factor(read['speed'], fixes)
    goes_forwards = factor is not None and math.isfinite(factor)
    if 'velocity' in read and _points_along(read['velocity'], fixes) and (not goes_forwards or _RECEIVER.search(topic)):
        return InputShown(topic, TYPES['velocity'], 'it points along the track of the fixes')
    if 'velocity' in read and not WHEELS.search(topic) and (wrong := mistaken_velocity(read['velocity'], fixes)):
        return UnusedTopic(topic, wrong)
    if not goes_forwards and not (factor is not None and WHEELS.search(topic)):
        repeated = [remark.message for remark in check_speed(read['speed'], fixes) if 'repeated' in remark.values]
        return UnusedTopic(topic, repeated[0] if repeated else
                           'it goes neither with the speed of the fixes nor with their velocity' if factor is None else
                           'neither its name shows what it is, nor do the fixes: too few of them move fast enough')
    why = 'it goes with the speed of the fixes' if goes_forwards else (
        'by its name: too few fixes move fast enough to compare it with, its unit is taken to be m/s')
    kind, turn = 'speed', _turning(imu, read['twist'], mounting, enough=_TURNING) if 'twist' in read else None
    if turn is not None and turn.correlation < 0:
        why += ', its turn rate has the opposite sign of that of the gyroscopes and is not used'
    elif turn is not None:
        kind, why = 'twist', f'{why}, its turn rate with the gyroscopes'
    return InputShown(topic, TYPES[kind], why, factor if goes_forwards else 1.0)


def _pose(topic, displacements, imu, fixes, mounting):
    """A topic with poses. Only the displacements between them are used, if these agree with fixes and gyroscopes: the
    axes of the poses are unknown."""
    factor = speed_factor(forward_speed(displacements), fixes)
    if factor is None or not math.isfinite(factor):
        return UnusedTopic(topic, 'the way between its poses does not go with the speed of the fixes')
    turn = _turning(imu, displacements, mounting, enough=_TURNING)
    if turn is None or turn.correlation < 0:
        return UnusedTopic(topic, 'the turns between its poses are not shown to be those of the gyroscopes')
    return InputShown(topic, TYPES['pose'], 'it has no twist; the way between its poses goes with the speed of the '
                      'fixes, their turns with the gyroscopes', factor)


def _magnetometer(topic, fields, fixes):
    """A topic with a magnetic field. Iron and currents disturb it, so it is used only if nothing else shows the
    heading."""
    factor = magnetic_factor(fields)
    if factor is None:
        return UnusedTopic(topic, 'no magnetic field of the earth in any unit')
    if shows_course(fixes):
        return UnusedTopic(topic, 'the course of the fixes tells the heading better than a magnetic field')
    return InputShown(topic, TYPES['magnetometer'], 'the vehicle is too slow for its course to tell the heading',
                      factor)


def _heading(topic, headings, fixes, of_imu: bool):
    """of_imu: in messages of an IMU, whose rates and forces are none."""
    if not _HEADING.search(topic):
        return UnusedTopic(topic, f'{_NO_IMU if of_imu else ""}no heading of antennas or a compass by its name')
    findings = list(check_heading(headings, fixes)) if fixes is not None else []
    turned = next((finding.values for finding in findings if 'offset_rad' in finding.values), None)
    if turned is None:
        return UnusedTopic(topic, next((finding.message for finding in findings), 'no fixes to compare it with'))
    sure = abs(turned['offset_rad']) > SURE * turned['sigma_rad']
    return InputShown(topic, TYPES['heading'], 'it follows the course of the fixes',
                      turned=turned['offset_rad'] if sure else 0.0)


def _points_along(velocities, fixes) -> bool:
    """Whether the velocity is that of the fixes, in size and direction."""
    findings = list(check_velocity(velocities, fixes))
    shown = [finding for finding in findings if finding.values.keys() & {'ratio', 'cosine', 'correlation'}]
    return bool(shown) and all(finding.severity == INFO for finding in shown)


def _timed(shown: InputShown, read, imu, fixes, mounting: Mounting | None) -> InputShown:
    """`shown` with its time offset and, for wheels and odometry, their place: to the left from the speed in bends,
    ahead from the velocity sideways, which shows how far ahead of the rear axle it is, as the mounting of the IMU."""
    samples = _in_si(read[shown.measurement.name], shown.factor)
    clock = clock_of(shown.measurement.name, samples, imu, fixes, mounting)
    axes = axes_of(samples)
    shown = replace(shown, lag=clock.lag, low_pass=clock.low_pass, axes=axes)
    left = clock.left or (0.0, math.inf)
    ahead = (0.0, math.inf)
    if axes is not None and mounting is not None:
        ahead = axes.ahead[0] - mounting.imu[0], math.hypot(axes.ahead[1], mounting.imu[1])
    return replace(shown, arm=(np.array([ahead[0], left[0], 0.0]), np.array([ahead[1], left[1], np.inf])))


def _in_si(samples, factor: float):
    """`samples` with speeds in m/s."""
    if isinstance(samples, Speeds):
        return replace(samples, speed=factor * samples.speed)
    return replace(samples, twist=samples.twist * [factor, factor, 1.0]) if isinstance(samples, Twists) else samples


def axes_of(samples) -> OdometryAxes | None:
    """How an odometry or poses are turned against the vehicle; None for other samples, and where it does not show."""
    return estimate_odometry_axes(samples) if isinstance(samples, (Twists, Displacements)) else None


def dynamic_of(pressures: Pressures, factor: float, fixes: Fixes | None) -> DynamicPressure | None:
    """Which share of the dynamic pressure `pressures` times `factor`, Pa, have; None without fixes that show it, and of
    a vehicle too slow for it: at 1 m/s the whole dynamic pressure is 5 cm of height."""
    if fixes is None:
        return None
    shown = estimate_dynamic_pressure(replace(pressures, pressure=factor * pressures.pressure), fixes)
    return shown if shown is not None and shown.sigma < SHARE_KNOWN else None


class InputClock(NamedTuple):
    """lag: time offset of an input, s, with its sigma, None if unknown: of a GNSS velocity and of a further receiver
    against the fixes, of others against the IMU. left: of wheels, their distance to the left of the IMU, m, with its
    sigma, None if unknown. low_pass: the part of the offset that a low pass makes, None if unknown."""

    lag: tuple[float, float] | None
    left: tuple[float, float] | None = None
    low_pass: LowPass | None = None


def clock_of(kind: str, samples, imu: ImuSamples, fixes: Fixes | None, mounting: Mounting | None) -> InputClock:
    """What is shown of the time of an input.

    kind: name of its measurement. samples: m/s, positive forwards. imu: SI units. fixes: usable ones of the first
    receiver. mounting: of the IMU, None if not even its up axis is known, with which turns are compared; speeds need
    its yaw, too.
    """
    shown, left = [], None
    if kind == 'velocity' and fixes is not None:
        shown = [estimate_velocity_offset(samples, fixes)]
    elif kind == 'heading':
        shown = [_turning(imu, turning_of(samples), mounting, _HEADING_TURNS)]
    elif kind == 'fix' and fixes is not None:
        baseline = estimate_baseline(fixes, usable_fixes(samples))
        return InputClock(None if baseline is None else (baseline.late, math.hypot(baseline.late_sigma, FLOOR)))
    elif kind in WHEELED:
        offset = None
        if mounting is not None and mounting.yaw_known:
            offset = estimate_speed_offset(imu, forward_speed(samples), mounting.rotation)
        left = None if offset is None else offset.left
        # for an odometry also from its turn rate, in which springs do not look like a low pass
        shown = [offset, _turning(imu, samples, mounting) if kind != 'speed' else None]
    shown = [one for one in shown if one is not None]
    lags = [(one.lag, one.lag_sigma) for one in shown if one.lag_sigma < SHOWN]
    low_passes = [one.low_pass for one in shown if getattr(one, 'low_pass', None) is not None]
    # of several estimates the one with the smallest sigma
    return InputClock(min(lags, key=lambda lag: lag[1], default=None), left,
                      min(low_passes, key=lambda one: one.sigma, default=None))


def _turning(imu, twists, mounting, least=_TURNING, enough=1.0) -> TurnOffset | None:
    """Time offset from the turn rate; None if that is not correlated with the gyroscopes, with either sign, or the up
    axis is unknown. enough: as for `estimate_turn_offset`."""
    if mounting is None:
        return None
    turn = estimate_turn_offset(imu, twists, mounting.rotation[2], enough)
    return turn if turn is not None and abs(turn.correlation) > least else None


def _receiver(topic, others: Fixes, imu, fixes, still) -> InputShown | UnusedTopic:
    """A further receiver, if its antenna is at another place or its errors are independent of those of the first one.
    """
    others = usable_fixes(others)
    if fixes is None or len(others) < 2:
        return UnusedTopic(topic, 'too few fixes')
    baseline = estimate_baseline(fixes, others)
    if baseline is None:
        return InputShown(topic, TYPES['fix'], 'a receiver', unplaced='too little motion, or too noisy, to see where '
                          'its antenna is')
    first, second = (scatter_at_rest(one, imu, still) for one in (fixes, others))
    between = scatter_at_rest(_less(fixes, others, baseline.late), imu, still)
    apart = bool((np.abs(baseline.arm[:2]) > np.maximum(LEAST_APART, SURE * baseline.arm_sigma[:2])).any())
    own = None not in (first, second, between) and between > _IN_COMMON * math.hypot(first, second)
    if not apart and not own:
        return UnusedTopic(topic, 'neither another place nor errors of its own are shown: it may be the same receiver '
                           'twice')
    stated = float(np.nanmedian(sigmas(others))) if np.isfinite(sigmas(others)).any() else 0.0
    needed = max(_ARM_KNOWN, stated, second or 0.0)
    unplaced = baseline.arm_sigma[:2].max() > needed
    why = 'a receiver at another place' if apart else (
        f'a receiver with errors of its own: {second:.2g} m at rest, {between:.2g} m against the first')
    return InputShown(topic, TYPES['fix'], why, lag=(baseline.late, math.hypot(baseline.late_sigma, FLOOR)),
                      arm=(baseline.arm, baseline.arm_sigma),
                      unplaced=f'the place of its antenna is not known to {needed:.2g} m: set it by hand' if unplaced
                      else '',
                      sigma=second if second is not None and stated and second > TOO_SURE * stated else None)


def _less(first: Fixes, second: Fixes, late: float) -> Fixes:
    """`first` minus the displacement of `second` from its own first fix, so that the scatter is that of the difference.
    late: s, time offset of the second one against the first one."""
    at, time = first.stamp - first.stamp[0], second.stamp - first.stamp[0] - round(late * 1e9)
    both = (at >= time[0]) & (at <= time[-1])
    first, longitude = first.select(both), near(second.longitude, second.longitude[0])
    return replace(first, **{name: getattr(first, name) - np.interp(at[both], time, values) + values[0]
                             for name, values in (('latitude', second.latitude), ('longitude', longitude))})


def _without_repeats(found: list[InputShown | UnusedTopic]) -> list[InputShown | UnusedTopic]:
    """`found` without topics that may repeat another one: the same wheels, receiver or air. Of a speed and an odometry
    of the same wheels the odometry stays, because it also has the turn rate."""
    kept: dict[int, InputShown | UnusedTopic] = {}
    odometry = [isinstance(one, InputShown) and one.measurement.name == 'twist' for one in found]
    for k in np.argsort(np.logical_not(odometry), kind='stable').tolist():
        one = found[k]
        same = next((other for other in kept.values() if isinstance(other, InputShown) and isinstance(one, InputShown)
                     and _same_source(other, one)), None)
        kept[k] = one if same is None else UnusedTopic(one.topic, f'{one.why}; it is not shown to measure anything but '
                                                       f'what {same.topic} does')
    return [kept[k] for k in range(len(found))]


def _same_source(one: InputShown, other: InputShown) -> bool:
    """Whether two inputs may be one sensor: of the same kind (or a speed and an odometry), and not shown to be at
    different places. False for receivers, which `_receiver` has compared."""
    kinds = {one.measurement.name, other.measurement.name}
    if kinds == {'fix'} or len(kinds) > 1 and not kinds <= set(WHEELED):
        return False
    if bool(OTHER_SENSORS.search(one.topic)) != bool(OTHER_SENSORS.search(other.topic)):
        return False
    places, sigmas = zip(one.arm, other.arm)
    with np.errstate(invalid='ignore'):
        apart = np.abs(places[0] - places[1]) > SURE * np.hypot(*sigmas)
    return not apart.any()
