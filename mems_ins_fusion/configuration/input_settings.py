"""Parameters of the inputs other than the first IMU and receiver, and contradictions between them and the transforms.
"""
from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from itertools import chain, count

import numpy as np

from mems_ins_fusion.configuration.inputs import LEAST_APART, WHEELED, InputShown, UnusedTopic
from mems_ins_fusion.configuration.mounting import rpy
from mems_ins_fusion.configuration.receiver import TOO_SURE
from mems_ins_fusion.configuration.regression import weighted
from mems_ins_fusion.configuration.remaining import ARM
from mems_ins_fusion.configuration.setting import (
    ARM_SHOWN,
    OF_SEVERAL,
    TF_ARM,
    Setting,
    arm_apart,
    is_sure,
    left_at_zero_text,
    rounded,
)
from mems_ins_fusion.configuration.speed_offset import LowPass
from mems_ins_fusion.configuration.topics import Topics
from mems_ins_fusion.filter.measurements.registry import AIDING, TYPES
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters.table import ALL
from mems_ins_fusion.recordings.remarks import SURE
from mems_ins_fusion.recordings.transforms import TOPIC as TF

_LEAST_ARM_SIGMA = 0.01  # m: of the centre of phase of an antenna


def inputs_against_tf(topics: Topics, drives: Sequence[Sequence[InputShown | UnusedTopic]]):
    """Contradictions between the transforms and the place of an input by the drives, in words, by topic."""
    for one in drives[0]:
        if isinstance(one, UnusedTopic) or (told := _told_place(topics, one)) is None:
            continue
        arm, sigma = _seen_place(_seen(drives, one))
        for k in np.flatnonzero(arm_apart(arm, sigma, told))[:1]:
            yield one.topic, (f'{TF} has {one.topic} {told[k]:.2f} m {ARM[k]} of {_whence(one)}, the drive shows '
                              f'{arm[k]:.2f} +- {sigma[k]:.2f} m: measure it')


def _told_place(topics: Topics, one: InputShown) -> np.ndarray | None:
    """(3,) m by the transforms, from the IMU, or of a further receiver from the first antenna; None if they do not
    contain it."""
    arms, kind = topics.arms_of_tf, one.measurement
    if not kind.has_arm or one.topic not in arms:
        return None
    if kind.name != 'fix':
        return arms[one.topic]
    return None if topics.arm_of_tf is None else arms[one.topic] - topics.arm_of_tf


def placed(topics: Topics, one: InputShown | UnusedTopic) -> InputShown | UnusedTopic:
    """The input, left out if neither the drive nor the transforms show its place, and the place matters."""
    if isinstance(one, UnusedTopic) or not one.unplaced:
        return one
    told = _told_place(topics, one)
    if told is not None and np.hypot(*told[:2]) > LEAST_APART:  # at the same place it may be the same receiver twice
        return one
    return UnusedTopic(one.topic, one.unplaced)


def _whence(one: InputShown) -> str:
    return 'the antenna of gnss_topic' if one.measurement.name == 'fix' else 'the IMU'


def input_settings(drives: Sequence[Sequence[InputShown | UnusedTopic]], mechanization: str, first: Mapping,
                    topics: Topics):
    """Parameters for the topics of the first drive. first: parameters of the first IMU and receiver. The first topic of
    each kind has the parameters without a name; others, further receivers and IMUs, are named after their topics."""
    used = [one for one in drives[0] if isinstance(one, InputShown)
            and not (one.measurement.needs_height and mechanization != 'strapdown')]
    plain = {}
    for one in used:
        if one.measurement in AIDING and not _is_aside(one, topics):
            plain.setdefault(one.measurement.name, one.topic)
    names = _names([one.topic for one in used if plain.get(one.measurement.name) != one.topic])
    left_out = tuple(f'{one.topic} is not used: {one.why}' for one in drives[0] if isinstance(one, UnusedTopic))
    if names or left_out:
        why = (*(f'{name}: {topic}' for topic, name in names.items()), *left_out)
        yield Setting('inputs', list(names.values()), why)
    for one in used:
        seen = _seen(drives, one)
        name = names.get(one.topic, one.measurement.name)
        if one.topic in names:
            yield Setting(f'{name}.type', one.measurement.name, (one.why,))
            yield Setting(f'{name}.topic', one.topic, (one.messages,))
            yield from _place_settings(name, seen, first, _told_place(topics, one))
        else:
            yield Setting(one.measurement.topic, one.topic, (f'{one.messages}; {one.why}',))
        yield from _value_settings(name, seen, first)


def _seen(drives: Sequence[Sequence[InputShown | UnusedTopic]], one: InputShown) -> list[InputShown]:
    """Estimates of this input from each drive."""
    return [other for inputs in drives for other in inputs if isinstance(other, InputShown)
            and other.topic == one.topic and other.measurement is one.measurement]


def _is_aside(one: InputShown, topics: Topics) -> bool:
    """Whether it is certainly measured to the left or right of the IMU, as by one wheel, or ahead of the rear axle, as
    by a lidar, or is there by the transforms; of a velocity, whether the transforms have it elsewhere than at the
    antenna."""
    told = _told_place(topics, one)
    if one.measurement.of_antenna:
        return bool(told is not None and topics.arm_of_tf is not None
                    and np.linalg.norm(told - topics.arm_of_tf) > ARM_SHOWN)
    if one.axes is not None and abs(one.axes.ahead[0]) > max(ARM_SHOWN, SURE * one.axes.ahead[1]):
        return True
    across, sigma = one.arm[0][1], one.arm[1][1]
    if told is not None:
        return bool(abs(told[1]) > ARM_SHOWN)
    return bool(abs(across) > max(ARM_SHOWN, SURE * sigma))


def _names(topics: Sequence[str]) -> dict[str, str]:
    """A name for the input of each topic that no parameter or other input has."""
    names: dict[str, str] = {}
    taken = {name.split('.')[0] for name in ALL} | set(TYPES)
    for topic in topics:
        base = re.sub(r'[^a-z0-9]+', '_', topic.lower()).strip('_') or 'input'
        base = base if base[0].isalpha() else f'input_{base}'
        names[topic] = next(name for name in chain([base], (f'{base}_{k}' for k in count(2)))
                            if name not in taken and name not in names.values())
    return names


def _seen_place(seen: Sequence[InputShown]) -> tuple[np.ndarray, np.ndarray]:
    """(3,) m by the drives, and its sigma (3,), large if they do not show it."""
    return weighted(*(np.array([one.arm[k] for one in seen]) for k in (0, 1)))


def _place_settings(name: str, seen: Sequence[InputShown], first: Mapping, told: np.ndarray | None):
    """Place of a named input in the vehicle, by the drives, or by the transforms (`told`)."""
    (arm, sigma), is_fix = _seen_place(seen), seen[0].measurement.name == 'fix'
    known = np.isfinite([one.arm[1] for one in seen]).any(axis=0) & (is_fix or sigma < ARM_SHOWN)
    if told is None and not known.any():
        return
    text = ', '.join(f'{value:.2f} +- {s:.2f} m {axis}' for value, s, axis, k in zip(arm, sigma, ARM, known) if k)
    begin = np.array(first.get('gnss.lever_arm', [0.0] * 3)) if is_fix else np.zeros(3)
    if told is not None:
        why = f'from {TF}; the drive ' + (f'shows {text} from {_whence(seen[0])}' if text else 'does not show it')
        yield Setting(f'{name}.lever_arm', rounded(begin + told, 3), (why,))
    else:
        yield Setting(f'{name}.lever_arm', rounded(begin + np.where(known, arm, 0.0), 2), (
            f'from {_whence(seen[0])} {text}', 'a tape measure is better'))
    if is_fix:
        left = float(max(sigma[:2].max(), _LEAST_ARM_SIGMA)) if told is None else TF_ARM
        yield Setting(f'{name}.lever_arm_sigma', round(left, 3), (
            'of forward and left, the larger one: the filter estimates what is left of them' if told is None else
            'of what somebody has measured: the filter estimates what is left of it',))


def _value_settings(name: str, seen: Sequence[InputShown], first: Mapping):
    """Unit, zero, noise and clock of an input."""
    kind = seen[0].measurement.name
    if seen[0].rotation is not None:
        yield from _imu_settings(name, seen, first)
    factor = float(np.median([one.factor for one in seen]))
    if factor != 1.0:
        yield Setting(f'{name}.factor', float(f'{factor:.5g}'), (
            f'it is {1.0 / factor:.4g} times the speed of the fixes' if seen[0].measurement.unit == 'm/s' else
            f'makes {seen[0].measurement.unit} of it',))
    if seen[0].turned:
        turned = float(np.median([one.turned for one in seen]))
        yield Setting(f'{name}.offset', round(turned, 4), (f'it is {math.degrees(turned):.1f} deg clockwise from the '
                                                           'course of the fixes',))
    axes = [(one.axes.yaw, one.axes.sigma) for one in seen if one.axes is not None]
    if axes:
        yaw, sigma, sure = _together(axes)
        yield Setting(f'{name}.yaw', round(yaw, 4) if sure else 0.0, (
            f'straight on it moves sideways: its axes are turned to the left by {math.degrees(yaw):.1f} +- '
            f'{math.degrees(sigma):.1f} deg{"" if sure else left_at_zero_text(OF_SEVERAL)}',))
    flows = [(one.dynamic.share, one.dynamic.sigma) for one in seen if one.dynamic is not None]
    if flows:
        share, sigma, sure = _together(flows)
        yield Setting(f'{name}.dynamic', round(share, 2) if sure else 0.0, (
            f'its heights beside those of the fixes have {share:.2f} +- {sigma:.2f} of the dynamic pressure'
            f'{"" if sure else left_at_zero_text(OF_SEVERAL)}',))
    noise = [one.sigma for one in seen if one.sigma is not None]
    if noise:
        yield Setting(f'{name}.sigma', float(f'{max(noise):.2g}'), (
            f'it scatters by {max(noise):.2g} m at rest, more than {TOO_SURE:g} times what it states',))
    lags = [one.lag for one in seen if one.lag is not None]
    if lags:
        lag, sigma, sure = _together(lags)
        of_receiver = kind in ('fix', 'velocity')
        # the offset of the plain velocity is relative to gnss.time_offset
        begin = first.get('gnss.time_offset', 0.0) if of_receiver and name != 'velocity' else 0.0
        what = 'gnss_topic' if of_receiver else 'the IMU'
        yield Setting(f'{name}.time_offset', round(begin + (lag if sure else 0.0), 3) + 0.0, (
            f'against {what} {lag:.3f} +- {sigma:.3f} s{"" if sure else left_at_zero_text(OF_SEVERAL)}',))
        yield from _low_pass_settings(name, seen)
    elif kind in WHEELED:
        yield Setting(f'{name}.time_offset', 0.0, ('not shown: too few changes of speed, or a road too rough',))
    elif kind == 'magnetometer':
        yield Setting(f'{name}.time_offset', 0.0, (
            'not looked for: 0.1 s at 0.5 rad/s are 3 deg, less than what iron turns the field by',
            'its axes are taken to be those of the IMU; hard and soft iron are estimated while driving'))


def _together(shown: Sequence[tuple[float, float]]) -> tuple[float, float, bool]:
    """Weighted mean of the estimates of several recordings: value, sigma, and whether it is certain."""
    value, sigma = (float(x) for x in weighted(*(np.array(part) for part in zip(*shown))))
    return value, sigma, is_sure(value, sigma, OF_SEVERAL)


def _low_pass_settings(name: str, seen: Sequence[InputShown]):
    """The part of the time offset that is caused by a low pass, if it is certain."""
    found = [(one.low_pass.tau, one.low_pass.sigma) for one in seen if one.low_pass is not None]
    if found:
        tau, sigma, _ = _together(found)
        if LowPass(tau, sigma).certain:
            yield Setting(f'{name}.lag', round(tau, 2), (
                f'a low pass of {tau:.2f} +- {sigma:.2f} s makes a part of the time offset',))


def _imu_settings(name: str, seen: Sequence[InputShown], first: Mapping):
    """Mounting of a further IMU, relative to imu.mounting_rpy, and its units."""
    best = min(seen, key=lambda one: one.rotation[1])
    mounted = rotation_from_rpy(*first.get('imu.mounting_rpy', [0.0] * 3)) @ best.rotation[0]
    yield Setting(f'{name}.mounting_rpy', rounded(rpy(mounted), 4), (
        'imu.mounting_rpy and the rotation that fits rates and forces of both, +- '
        f'{math.degrees(best.rotation[1]):.1f} deg: another imu.mounting_rpy asks for another one here',))
    for key, unit, usual in zip(('acceleration_unit', 'rate_unit'), best.units, ('m/s^2', 'rad/s')):
        if unit != usual:
            yield Setting(f'{name}.{key}', unit, ('as that of the first IMU is found',))
