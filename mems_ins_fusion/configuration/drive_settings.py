"""Parameters from drives: topics, units, mounting, clock and antenna, receiver, noise, constraints."""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.configuration.input_settings import input_settings
from mems_ins_fusion.configuration.mounting import BIAS_SIGMA, Mounting, deviation, rpy
from mems_ins_fusion.configuration.noise import Noise
from mems_ins_fusion.configuration.receiver import TOO_SURE, Receiver
from mems_ins_fusion.configuration.remaining import ARM
from mems_ins_fusion.configuration.setting import (
    ARM_SHOWN,
    ARM_UNKNOWN,
    SET_SIGMAS,
    TF_ARM,
    Setting,
    arm_apart,
    is_sure,
    left_at_zero_text,
    rounded,
)
from mems_ins_fusion.configuration.topics import Topics
from mems_ins_fusion.configuration.vehicle import LARGEST_ALIKE
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.parameters.table import defaults
from mems_ins_fusion.recordings.motion import UNSTATED_SIGMA
from mems_ins_fusion.recordings.remarks import count_of
from mems_ins_fusion.recordings.transforms import BASE
from mems_ins_fusion.recordings.transforms import TOPIC as TF
from mems_ins_fusion.recordings.units import RATE, Units

_TF_ANGLE = math.radians(15.0)  # rad, largest error of a bracket; transforms often contain whole right angles
_LEAST_MOUNTING_SIGMA = 0.01  # rad, bending of body and bracket while driving


def settings_of(topics: Topics, drives, mounting):
    """Yield the parameters from `drives` (`configure.RecordingEvidence`) and their common mounting, in the order of the
    file."""
    first = drives[0]
    rotation, arm = topics.mounting_of_tf, topics.arm_of_tf
    yield from _topic_settings(topics)
    yield from _unit_settings(first.units)
    mechanization = _mechanization(drives, mounting)
    yield mechanization
    mounted = []
    if mounting is not None:
        mounted.append(_mounting_setting(mounting, rotation))
        yield from mounted
        if mounting.yaw_known:
            yield Setting('imu.mounting_sigma', round(float(max(_LEAST_MOUNTING_SIGMA, mounting.sigma[1:].max())), 3), (
                'of pitch and yaw, the larger one: the filter estimates what is left of them',))
    elif rotation is not None:
        mounted.append(Setting('imu.mounting_rpy', rounded(rpy(rotation), 4), (
            f'from {TF}; the drive does not show it',)))
        yield from mounted
    antenna = []
    if mounting is not None:
        antenna += _time_offset_settings(mounting.offset)
    if mounting is not None or arm is not None:
        antenna += _arm_settings(mounting.offset if mounting is not None else None, arm)
    yield from antenna
    yield from _receiver_settings([drive.receiver for drive in drives if drive.receiver is not None])
    yield from input_settings([drive.inputs for drive in drives], mechanization.value,
                               {setting.name: setting.value for setting in (*mounted, *antenna)}, topics)
    yield from _noise_settings(drives, mounting)
    yield from vehicle_settings(drives)


def _topic_settings(topics):
    for name, candidates, kind in (('imu_topic', topics.imu, 'Imu'), ('gnss_topic', topics.gnss, 'NavSatFix')):
        if not candidates:
            yield Setting(name, '', (f'no topic of sensor_msgs/{kind}',))
            continue
        chosen, *others = candidates
        why = [f'{chosen.describe()}' + ('' if others else f'; the only sensor_msgs/{kind}')]
        why += [f'rather than {other.topic}: {other.describe()}' for other in others]
        yield Setting(name, chosen.topic, tuple(why))
    if len(topics.temperature) == 1:
        yield Setting('temperature_topic', topics.temperature[0], ('the only sensor_msgs/Temperature',))


def _unit_settings(units: Units):
    where = 'at rest' if units.at_rest else 'on average'
    yield Setting('imu.acceleration_unit', units.acceleration, (
        f'{units.magnitude:.4g} {units.acceleration} {where}'
        + (', which is gravity' if units.gravity else ': no gravity in it, taken to be m/s^2'),))
    if units.steering is None:
        why = f'no turns clear enough to tell; the largest rates are {units.largest:.2g}'
    else:
        turned, sigma = (RATE[units.rate] * value for value in units.steering.turned)
        why = f'the gyroscopes turn by {turned:.3g} +- {max(sigma, 0.001):.1g} times the angle of the course'
    yield Setting('imu.rate_unit', units.rate, (why,))


def _mechanization(drives, mounting) -> Setting:
    if not all(drive.units.gravity for drive in drives):
        return Setting('mechanization', 'planar', ('gravity is not in the accelerometers: strapdown needs it',))
    if mounting is None:
        return Setting('mechanization', 'planar', ('the up axis is not known',))
    return Setting('mechanization', 'strapdown', ('the accelerometers measure gravity, too; planar would take '
                                                  'roads that slope for acceleration',))


def _mounting_setting(found: Mounting, told: np.ndarray | None) -> Setting:
    """The mounting. told: rotation (3, 3) by the transforms."""
    if told is not None and not found.yaw_known:
        return Setting('imu.mounting_rpy', rounded(rpy(told), 4), (
            f'from {TF}; gravity agrees to {math.degrees(_angle_of_level(found, told)):.1f} deg, the drive does not '
            'show the yaw',))
    angles = np.degrees(found.rpy)
    sigma = np.degrees(found.sigma)
    level = f'roll {angles[0]:.1f}, pitch {angles[1]:.1f}'
    why = [f'{level}, yaw {angles[2]:.1f} deg; sigma {sigma[0]:.1f}, {sigma[1]:.1f}, {sigma[2]:.1f} deg about forward, '
           'left and up' if found.yaw_known else
           f'{level} deg; sigma {sigma[0]:.1f}, {sigma[1]:.1f} deg about forward and left']
    why += [f'{way.source} alone: {_degrees(way.angle[0], way.sigma[0])} from this about forward, '
            f'{_degrees(way.angle[1], way.sigma[1])} about left' for way in found.level]
    if found.spans is not None:
        why.append(f'the sigma of gravity is {math.degrees(BIAS_SIGMA / STANDARD_GRAVITY):.1f} deg larger than that: a '
                   'bias of the accelerometers looks like a tilt')
    if found.yaw_known:
        why += [f'{way.source} alone: {_degrees(way.angle[0], way.sigma[0])} from this about up'
                for way in found.heading]
    else:
        why.append('yaw not shown: too few turns and changes of speed; 0 is the default, it may be anything')
    if told is not None:
        why.append(f'{TF} says roll, pitch, yaw {", ".join(f"{a:.1f}" for a in np.degrees(rpy(told)))} deg')
    return Setting('imu.mounting_rpy', rounded(found.rpy, 4), tuple(why))


def _angle_of_level(found: Mounting, told: np.ndarray) -> float:
    """rad, between the up axis by the drive and that by the rotation `told`, independent of the yaw."""
    return float(np.arccos(np.clip(found.rotation[2] @ told[2], -1.0, 1.0)))


def _degrees(angle, sigma) -> str:
    return f'{round(math.degrees(angle), 1) + 0.0:+.1f} +- {max(math.degrees(sigma), 0.1):.1f} deg'


def _time_offset_settings(offset) -> list[Setting]:
    """The time offset of the fixes and, if it is determined, its sigma: the filter estimates the rest."""
    name = 'gnss.time_offset'
    if offset is None or not offset.shown:
        why = 'not shown' if offset is None else f'{offset.lag:.1f} +- {offset.lag_sigma:.1f} s: as good as not shown'
        return [Setting(name, 0.0, (why,))]
    seen = f'by the track between fixes {offset.lag:.3f} +- {offset.lag_sigma:.3f} s, with the arm unknown'
    if offset.rivals:
        seen += f'; {" or ".join(f"{rival:g}" for rival in offset.rivals)} s would fit nearly as well'
    sure = is_sure(offset.lag, offset.lag_sigma)
    return [Setting(name, round(offset.lag, 3) if sure else 0.0, (seen if sure else f'{seen}{left_at_zero_text()}',)),
            Setting(f'{name}_sigma', round(float(offset.lag_sigma), 3), ('the filter estimates what is left of it',))]


def _arm_settings(offset, told: np.ndarray | None) -> tuple[Setting, Setting]:
    """The lever arm and its sigma. told: (3,) m from the IMU to the antenna by the transforms."""
    name = 'gnss.lever_arm'
    of_tf = Setting(f'{name}_sigma', TF_ARM, ('of what somebody has measured',))
    if offset is None:
        if told is not None:
            return Setting(name, rounded(told, 3), (f'from {TF}; the drive does not show it',)), of_tf
        return (Setting(name, [0.0, 0.0, 0.0], ('not shown; measure it with a tape',)),
                Setting(f'{name}_sigma', ARM_UNKNOWN, ('not shown: of antennas on robots and cars',)))
    seen = ', '.join(f'{arm:.2f} +- {sigma:.2f}' for arm, sigma in zip(offset.arm, offset.arm_sigma))
    if told is not None:
        return Setting(name, rounded(told, 3), (f'from {TF}; the drive shows {seen} m forward, left, up',)), of_tf
    known = [sigma < ARM_SHOWN and is_sure(arm, sigma) for arm, sigma in zip(offset.arm, offset.arm_sigma)]
    left = '' if all(known) else (f'; what is not known to {ARM_SHOWN:g} m, or less than {SET_SIGMAS:g} sigma, is '
                                  'left at zero')
    arm = [round(float(part), 2) + 0.0 if there else 0.0 for part, there in zip(offset.arm, known)]
    sigma = max(s if there else min(math.hypot(part, s), ARM_UNKNOWN)
                for part, s, there in zip(offset.arm[:2], offset.arm_sigma[:2], known))
    return (Setting(name, arm, (f'from the IMU to the antenna {seen} m forward, left, up{left}',
                                'a tape measure is better')),
            Setting(f'{name}_sigma', round(float(sigma), 3), (
                'the larger one of forward and left, with what was left at zero; a tape measure: 0.02',)))


def against_tf(topics: Topics, mounting: Mounting | None):
    """Contradictions between the transforms of the recording and its data, in words."""
    told, arm = topics.mounting_of_tf, topics.arm_of_tf
    if mounting is not None and told is not None:
        away = _angle_of_level(mounting, told)
        if mounting.yaw_known:
            away = float(np.linalg.norm(deviation(mounting.rotation, told)))
        if away > _TF_ANGLE:
            yield (f'{TF} has the IMU turned by {math.degrees(away):.0f} deg from what the drive shows: its '
                   f'header.frame_id or the transform to {BASE} is wrong')
    if mounting is not None and mounting.offset is not None and arm is not None:
        for name, seen, sigma, said, apart in zip(ARM, mounting.offset.arm, mounting.offset.arm_sigma, arm,
                                                  arm_apart(mounting.offset.arm, mounting.offset.arm_sigma, arm)):
            if apart:
                yield (f'{TF} has the antenna {said:.2f} m {name} of the IMU, the drive shows {seen:.2f} +- '
                       f'{sigma:.2f} m: measure it')


def _receiver_settings(receivers: list[Receiver]):
    if not receivers:
        return
    stated = [r.stated for r in receivers if r.stated is not None]
    seen = [r.realised for r in receivers if r.realised is not None]
    realised = max(seen) if seen else None
    text = ', '.join(f'{what} {max(values):.2g} m' for what, values in (
        ('stated', stated), ('scatter at rest', [r.at_rest for r in receivers if r.at_rest is not None]),
        ('white noise in motion about', [r.in_motion for r in receivers if r.in_motion is not None])) if values)
    if stated:
        too_sure = realised is not None and realised > TOO_SURE * max(stated)
        yield Setting('gnss.sigma', float(f'{realised:.2g}') if too_sure else 0.0,
                      (text, 'the receiver is too sure of itself' if too_sure else 'the stated sigma is used'))
    else:
        yield Setting('gnss.default_sigma', float(f'{max(realised or UNSTATED_SIGMA, 0.02):.2g}'),
                      (text or 'not shown', 'the receiver states no sigma'))
    delays = [r.delay for r in receivers if r.delay is not None]
    if delays and max(delays) > 0.7 * defaults()['gnss.max_delay']:
        yield Setting('gnss.max_delay', min(round(1.5 * max(delays), 1), 10.0),
                      (f'fixes arrive up to {max(delays):.2f} s (99 %) after the IMU samples of their time',))


def _noise_settings(drives, mounting):
    best = max((drive.noise for drive in drives if drive.noise is not None), key=lambda noise: noise.seconds,
               default=None)
    if best is not None:
        why = f'{best.seconds:.0f} s at rest, the quietest axis; known to {best.part:.0%}'
        for sensor, density in (('accelerometer', best.force_density), ('gyroscope', best.rate_density)):
            if min(density) > 0.0:  # the noise of a sensor with constant output is not configured
                yield Setting(f'{sensor}.noise_density', _significant(density), (why,))
        yield _turn_on_bias([drive.noise for drive in drives if drive.noise is not None])
    if mounting is not None and mounting.spans is not None:
        sure = is_sure(float(np.linalg.norm(mounting.bias)), mounting.bias_sigma)
        yield Setting('accelerometer.bias', _significant(mounting.bias, 2) if sure else [0.0], (
            f'specific force less acceleration and gravity: {np.linalg.norm(mounting.bias):.2g} +- '
            f'{mounting.bias_sigma:.2g} m/s^2{"" if sure else left_at_zero_text()}',))


def _turn_on_bias(rests: list[Noise]) -> Setting:
    """gyroscope.bias from the standstills of each recording. The next start has another turn-on bias, so one start
    shows what stays of it only to gyroscope.initial_sigma, however long it stood; the filter's sigma is that, too. Each
    recording counts as a start of its own, as stamps do not tell whether the IMU was switched off in between. If one
    axis shows a bias, all three are set: the best values there are."""
    bias = np.mean([rest.bias for rest in rests], axis=0)
    turn_on = defaults()['gyroscope.initial_sigma'][0] / math.sqrt(len(rests))
    sure = is_sure(float(np.abs(bias).max()), turn_on)
    return Setting('gyroscope.bias', _significant(bias) if sure else [0.0], (
        f'mean over {count_of(len(rests), "recording")} (each counted as a start of its own) of the median at rest: '
        f'{", ".join(f"{b:.2g}" for b in bias)} rad/s; the next start has another turn-on bias, so what stays is known '
        f'to {turn_on:.2g} rad/s'
        + ('; the largest axis is beyond two sigma, so all three are set' if sure else left_at_zero_text()),))


def vehicle_settings(drives):
    vehicles = [drive.vehicle for drive in drives]
    seen = [vehicle for vehicle in vehicles if vehicle.wheels is not None]
    # the filter's heading is that of the course at the start, so the constraint holds whatever the yaw of the mounting
    yield Setting('vehicle.non_holonomic', all(vehicle.wheels for vehicle in seen), (
        f'velocity to the side scatters by {max(v.sideways for v in seen):.2f} m/s; noise of the fixes alone makes '
        f'{max(v.noise for v in seen):.2f} m/s' if seen else
        'too few turns to see it; the default is that of vehicles on wheels',))
    alike = max((vehicle.alike for vehicle in vehicles if vehicle.alike is not None), default=0.0)
    told, quiet = alike < LARGEST_ALIKE, f'{alike:.0%} of the seconds in motion are slow and as quiet as rest'
    rest = [vehicle for vehicle in vehicles if vehicle.rest_force is not None]
    if not rest:  # a drive without a standstill is no reason against later ones
        if not told:
            yield Setting('vehicle.zero_velocity', False, (f'{quiet} by default: not to be told from standstills',))
        return
    force, rate = max(v.rest_force for v in rest), max(v.rest_rate for v in rest)
    drive_force, drive_rate = min(v.drive_force for v in rest), min(v.drive_rate for v in rest)
    yield Setting('vehicle.zero_velocity', told, (
        f'axes scatter by up to {force:.2g} m/s^2 and {rate:.2g} rad/s at rest, by at least {drive_force:.2g} and '
        f'{drive_rate:.2g} in motion; {quiet}' + ('' if told else ': not to be told apart'),))
    if told:
        yield _threshold('vehicle.still_acceleration', force, drive_force)
        yield _threshold('vehicle.still_rate', rate, drive_rate)


def _threshold(name: str, rest: float, drive: float) -> Setting:
    """A value between `rest` and `drive`, by ratio; a little above rest if they are similar."""
    between, least = math.sqrt(rest * drive), 1.2 * rest
    why = 'between rest and motion' if between > least else 'a little above rest: quiet motion scatters as little'
    return Setting(name, float(f'{max(between, least):.2g}'), (why,))


def _significant(values, digits=3) -> list:
    return [float(f'{value:.{digits}g}') for value in values]
