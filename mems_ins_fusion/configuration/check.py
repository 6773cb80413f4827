"""Whether a recording fits the parameters it is to be filtered with: mounting, clocks, antenna, sigma of the fixes.

The same estimates as those of `configure`, for all tools that read a recording, and for the live node.
"""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.configuration.inputs import CLOCKED, SHARE_KNOWN, axes_of, clock_of, dynamic_of
from mems_ins_fusion.configuration.mounting import Mounting, estimate_mounting
from mems_ins_fusion.configuration.odometry_axes import OdometryAxes
from mems_ins_fusion.configuration.receiver import TOO_SURE, assess_receiver
from mems_ins_fusion.configuration.remaining import ANGLES, ARM, SHARE, TIME_OFFSET, ClockLeft, Remaining, remaining_of
from mems_ins_fusion.configuration.speed_offset import MOST_SPRINGS, LowPass
from mems_ins_fusion.configuration.vehicle import standstills_show
from mems_ins_fusion.filter.measurements.registry import MEASUREMENTS, aiding
from mems_ins_fusion.filter.memory import Kind
from mems_ins_fusion.filter.runs.usable import usable_fixes, usable_samples
from mems_ins_fusion.navigation.earth import gravity
from mems_ins_fusion.navigation.frames import ANGLE_DIGITS, rotation_from_rpy
from mems_ins_fusion.parameters.params_file import yaml_value
from mems_ins_fusion.recordings.checker import check_recording
from mems_ins_fusion.recordings.motion import find_standstill, without_turns
from mems_ins_fusion.recordings.remarks import ERROR, INFO, SURE, WARNING, Remark
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording

#: rad: smaller errors of the yaw of the mounting are estimated by the filter
SMALL_YAW = math.radians(3.0)
#: rad: the same of roll and pitch
SMALL_TILT = math.radians(5.0)
#: rad: a larger error of the mounting is reported as an error
LARGE = math.radians(30.0)
#: rad: with a larger error of the yaw the IMU is mounted backwards, or the vehicle has gone in reverse
_BACKWARDS = math.radians(150.0)
#: m/s, largest speed in reverse: a faster vehicle goes forwards
FASTEST_IN_REVERSE = 8.0
#: s: smaller errors of a time offset are not reported
SMALL_OFFSET = 0.05
#: m: smaller errors of a component of the lever arm of the antenna are estimated by the filter
SMALL_ARM = 0.3
#: ratio of the actual scatter of fixes to their stated sigma, below which the sigma is certainly wrong
_FAR_BETTER = 0.05
#: m: a lever arm with a larger standard deviation is not compared
VAGUE_ARM = 0.3
YAW_NOT_SHOWN = 'whether the yaw of imu.mounting_rpy is right does not show'


def check(recording: Recording, values: dict) -> list[Remark]:
    """All that is wrong or remarkable with `recording` (SI units): by itself, and against the checked parameters
    `values`. An ERROR says that the recording gives no sensible result with these parameters."""
    findings = check_recording(recording, values)
    if any(finding.severity == ERROR for finding in findings):
        return findings  # mounting and offset stand on sensors that are right
    return [*findings, *check_setup(recording, values)]


def check_setup(recording: Recording, values: dict) -> list[Remark]:
    """Mounting, time offset, antenna and scatter of the fixes that `recording` shows, beside what `values` say of them.

    Where the recording shows too little of something, nothing is said of it.
    """
    imu, fixes = _usable(recording, values)
    findings, found = compare_mounting(imu, fixes, values)
    if fixes is None or len(imu) < 2:
        return findings
    if found is None or not found.yaw_known:
        findings.append(Remark(INFO, 'imu', f'{YAW_NOT_SHOWN}: too few turns and stops'))
    elif not findings:
        findings.append(_mounting_left(found, values))
    return [*findings, *check_standstills(imu, fixes, values), *_check_offset(found, values),
            *_check_sigma(imu, fixes, found, values), *_check_clocks(recording, imu, found, values),
            *_check_pressures(recording, fixes, values)]


def check_standstills(imu: ImuSamples, fixes: Fixes | None, values: dict):
    """Whether standstills, where they are used, can be told from motion."""
    shown = standstills_show(imu, fixes) if values['vehicle.zero_velocity'] else None
    if shown is None or shown[0]:
        return
    seen = f'{shown[1]:.0%} of the motion is slow and as quiet as rest'
    wheels = [values[one.topic] for one in aiding(values) if one.kind in (Kind.SPEED, Kind.TWIST) and values[one.topic]]
    if wheels:
        yield Remark(INFO, 'imu', f'{seen}: standstills count only where {" and ".join(wheels)} '
                     f'{"do" if len(wheels) > 1 else "does"} not say motion', {'alike': shown[1]})
    else:
        yield Remark(WARNING, 'imu', f'{seen}: set vehicle.zero_velocity: false', {'alike': shown[1]},
                     ('vehicle.zero_velocity',))


def _usable(recording: Recording, values: dict) -> tuple[ImuSamples, Fixes | None]:
    """The samples and fixes that can be looked at, of the whole recording as in `configure`; None without such
    fixes."""
    imu = usable_samples(recording.imu, values['imu.max_specific_force'], values['imu.max_angular_rate'])
    if recording.gnss is None or not len(imu):
        return imu, None
    fixes = usable_fixes(recording.gnss)
    overlap = len(fixes) > 1 and imu.stamp[-1] > fixes.stamp[0] and imu.stamp[0] < fixes.stamp[-1]
    return imu, fixes if overlap else None


def compare_mounting(imu: ImuSamples, fixes: Fixes | None, values: dict,
                     lag: float | None = None) -> tuple[list[Remark], Mounting | None]:
    """What speaks against the mounting of the checked parameters `values`, and the one that samples in sensor axes (SI
    units) and fixes, by arrival, show; None where not even the up axis shows. Of the last minutes of a live filter,
    too.
    An ERROR is one that cannot be: not that of a vehicle that may have reversed, or gone sideways.

    lag: s, `gnss.time_offset`; None searches for it, ten times the work. With a lag, two minutes at 100 Hz take about
    50 ms of CPU: for now and then, not for each fix. Tells an IMU that is not upright from gravity alone, a wrong
    yaw only after some turns or changes of speed, and is silent till then.
    """
    imu = usable_samples(imu)
    if fixes is not None:
        fixes = usable_fixes(fixes)
    if len(imu) < 2:
        return [], None
    there = {} if fixes is None or not len(fixes) else {
        'gravity': float(gravity(fixes.latitude[0], fixes.height[0]))}
    found = estimate_mounting(imu, fixes, lag=lag, **there)
    return ([], None) if found is None else (_compare(found, values), found)


def _check_offset(found: Mounting | None, values: dict):
    """What the parameters leave of time offset and arm."""
    offset = found.offset if found is not None else None
    if offset is None or not offset.shown:
        yield Remark(INFO, 'imu/gnss', 'a clock offset does not show: too few turns and stops, or noisy fixes')
        return
    left = {one.name: one for one in remaining_of(found, values)}
    lag, declared = left[TIME_OFFSET], values['gnss.time_offset']
    seen = {'lag_s': offset.lag, 'sigma_s': offset.lag_sigma, 'left_s': lag.value, 'arm_m': offset.arm.tolist(),
            'arm_sigma_m': offset.arm_sigma.tolist(), 'rivals_s': list(offset.rivals)}
    if lag.certain(SMALL_OFFSET, SURE):
        yield Remark(WARNING, 'imu/gnss', f'the fixes are {_late(lag, "gnss.time_offset", declared)} to '
                     f'{offset.lag:.3f}', seen, ('gnss.time_offset',))
    else:
        beside = f'what is left of the time offset beside gnss.time_offset {declared:g} s'
        what = beside if declared else 'no clock offset to be seen'
        yield Remark(INFO, 'imu/gnss', f'{what}: {round(lag.value, 3) + 0.0:.3f} +- {lag.sigma:.3f} s', seen)
    arm = [left[name] for name in ARM if left[name].sigma < VAGUE_ARM]
    if any(part.certain(SMALL_ARM, SURE) for part in arm):
        words = ', '.join(f'{seen:.2f} +- {sigma:.2f} m {name}' for seen, sigma, name in zip(
            offset.arm, offset.arm_sigma, ARM) if sigma < VAGUE_ARM)
        yield Remark(WARNING, 'gnss', f'gnss.lever_arm would be {words}',
                     {'arm_m': offset.arm.tolist(), 'arm_sigma_m': offset.arm_sigma.tolist()}, ('gnss.lever_arm',))


def _check_sigma(imu: ImuSamples, fixes: Fixes, found: Mounting | None, values: dict):
    """The stated sigma, or `gnss.sigma`, against what the fixes scatter by. A filter that takes sigmas for what it sees
    (`gnss.adapt_sigma`) needs no advice."""
    receiver = assess_receiver(fixes, imu, without_turns(find_standstill(imu, fixes), imu), found)
    stated, scatter = values['gnss.sigma'] or receiver.stated, receiver.realised
    if stated is None or scatter is None:
        return
    seen = {'stated_m': stated, 'scatter_m': scatter, 'at_rest_m': receiver.at_rest, 'in_motion_m': receiver.in_motion}
    text = (f'{"gnss.sigma" if values["gnss.sigma"] else "stated sigma"} {stated:.3g} m, scatter '
            f'{"at rest" if scatter == receiver.at_rest else "in motion"} {scatter:.2g} m')
    doubt = ''
    if scatter > TOO_SURE * stated:
        doubt = ': the receiver is too sure of itself; set gnss.sigma'
    elif scatter < _FAR_BETTER * stated:
        doubt = ': the receiver is far better than it says, or its fixes are smoothed'
    if doubt and not values['gnss.adapt_sigma']:
        yield Remark(WARNING, 'gnss', f'{text}{doubt}', seen, ('gnss.sigma',))
    else:
        yield Remark(INFO, 'gnss', text, seen)


def _mounting_left(found: Mounting, values: dict) -> Remark:
    """What the parameters leave of a mounting that nothing speaks against."""
    left = [one for one in remaining_of(found, values) if one.name in ANGLES]
    words = ', '.join(f'{one.name} {round(math.degrees(one.value), 1) + 0.0:.1f} +- {math.degrees(one.sigma):.1f}'
                      for one in left)
    return Remark(INFO, 'imu', f'left beside imu.mounting_rpy, deg: {words}',
                  {one.name: one.value for one in left} | {f'{one.name}_sigma': one.sigma for one in left})


def _check_clocks(recording: Recording, imu: ImuSamples, found: Mounting | None, values: dict):
    """What the parameters leave of the time offset of each input whose clock can be seen."""
    of_receiver = {one.name: one.of_antenna for one in aiding(values)}
    for name, left in clocks_left(recording, imu, found, values).items():
        yield _clock_remark(name, left, values[f'{name}.time_offset'], 'fixes' if of_receiver[name] else 'IMU')
        if left.axes is not None:
            yield _axes_remark(name, left.axes, values[f'{name}.yaw'])
        if left.low_pass is not None:
            yield _low_pass_remark(name, left.low_pass, values[f'{name}.lag'])


def _check_pressures(recording: Recording, fixes: Fixes, values: dict):
    """What the parameters leave of the dynamic pressure of each barometer."""
    for name, left in shares_left(recording, fixes, values).items():
        share = left.value + values[f'{name}.dynamic']
        shown = {'share': share, 'sigma': left.sigma, 'left': left.value}
        said = f'the {name} has {share:.2f} +- {left.sigma:.2f} of the dynamic pressure'
        if left.certain(SHARE_KNOWN, SURE):
            yield Remark(WARNING, f'gnss/{name}', f'{said}: set {name}.dynamic to {share:.2f}', shown,
                         (f'{name}.dynamic',))
        else:
            yield Remark(INFO, f'gnss/{name}', said, shown)


def shares_left(recording: Recording, fixes: Fixes, values: dict) -> dict[str, Remaining]:
    """By the names of barometers: what the checked parameters `values` leave of the share of the dynamic pressure that
    `recording` shows, with its usable `fixes`."""
    left, streams = {}, recording.streams()
    for one in aiding(values):
        if one.kind != Kind.PRESSURE or not values[one.topic] or one.name not in streams:
            continue
        seen = dynamic_of(streams[one.name], values[f'{one.name}.factor'], fixes)
        if seen is not None:
            left[one.name] = Remaining(SHARE, seen.share - values[f'{one.name}.dynamic'], seen.sigma)
    return left


def clocks_left(recording: Recording, imu: ImuSamples, found: Mounting | None, values: dict) -> dict[str, ClockLeft]:
    """What the checked parameters `values` leave of the time offset of each input, by its name, as `recording` shows it
    without a filter; imu: its usable samples. Of those that are compared with the IMU only where its mounting is shown:
    turns need the up axis, speeds the yaw, too."""
    fixes = usable_fixes(recording.gnss) if recording.gnss is not None and len(recording.gnss) else None
    left, streams = {}, recording.streams()
    for measurement in aiding(values):
        name, kind = measurement.name, MEASUREMENTS[measurement.kind].name
        compared = fixes if measurement.of_antenna else found
        if kind not in CLOCKED or not values[measurement.topic] or name not in streams or compared is None:
            continue
        samples = measurement.declared(measurement.settings(values), streams[name])
        samples = samples.select(samples.stamp < imu.stamp[-1])
        clock = clock_of(kind, samples, imu, fixes, found)
        lag, sigma = clock.lag or (0.0, math.inf)
        declared = values[f'{name}.time_offset']
        if measurement.of_antenna and not measurement.is_plain:  # that of the plain one is beside gnss.time_offset
            declared -= values['gnss.time_offset']
        left[name] = ClockLeft(TIME_OFFSET, lag - declared, sigma, clock.low_pass, axes_of(samples))
    return left


def _clock_remark(name: str, left: Remaining, declared: float, against: str) -> Remark:
    topic = f'{"gnss" if against == "fixes" else "imu"}/{name}'
    if not math.isfinite(left.sigma):
        return Remark(INFO, topic, f'how late the {name} is does not show: too few turns and stops, or noise')
    shown = {'lag_s': declared + left.value, 'sigma_s': left.sigma, 'left_s': left.value}
    if left.certain(SMALL_OFFSET, SURE):
        return Remark(WARNING, topic, f'the {name} is {_late(left, f"{name}.time_offset", declared)} to '
                      f'{declared + left.value:.2f}', shown)
    beside = f' beside {name}.time_offset {declared:g} s' if declared else ''
    return Remark(INFO, topic, f'the {name} is of the time of its stamps{beside}: {left.value:.3f} +- '
                  f'{left.sigma:.3f} s', shown)


def _axes_remark(name: str, left: OdometryAxes, declared: float) -> Remark:
    shown = {'yaw_rad': declared + left.yaw, 'sigma_rad': left.sigma, 'left_rad': left.yaw}
    turned = f'{math.degrees(left.yaw):.1f} +- {math.degrees(left.sigma):.1f} deg'
    if abs(left.yaw) > max(SMALL_YAW, SURE * left.sigma):
        return Remark(WARNING, f'imu/{name}', f'the axes of the {name} are turned to the left by {turned} beside '
                      f'{name}.yaw: set {name}.yaw to {declared + left.yaw:.3f}', shown, (f'{name}.yaw',))
    return Remark(INFO, f'imu/{name}', f'the axes of the {name} are those of the vehicle, beside {name}.yaw '
                  f'{declared:g}: {turned}', shown)


def _low_pass_remark(name: str, seen: LowPass, declared: float) -> Remark:
    shown = {'low_pass_s': seen.tau, 'sigma_s': seen.sigma}
    if seen.certain and abs(seen.tau - declared) > SURE * seen.sigma:
        beside = f' beside {name}.lag {declared:g} s' if declared else ''
        return Remark(WARNING, f'imu/{name}', f'the {name} comes through a low pass of {seen.tau:.2f} +- '
                      f'{seen.sigma:.2f} s{beside}, which is a part of its time offset: set {name}.lag to '
                      f'{seen.tau:.2f}', shown, (f'{name}.lag',))
    if seen.certain:
        return Remark(INFO, f'imu/{name}', f'the {name} comes through a low pass of {seen.tau:.2f} +- '
                      f'{seen.sigma:.2f} s, as {name}.lag says', shown)
    return Remark(INFO, f'imu/{name}', f'a low pass of the {name} does not show for certain: {seen.tau:.2f} +- '
                  f'{seen.sigma:.2f} s, where a body on springs looks like one of up to {MOST_SPRINGS:g} s', shown)


def _late(left: Remaining, name: str, declared: float) -> str:
    """How late something is beside the offset that is declared for it as `name`, s, and what to set."""
    return (f'{abs(left.value):.3f} +- {left.sigma:.3f} s {"late" if left.value > 0 else "early"}'
            + (f' beside {name} {declared:g} s: set it' if declared else f': set {name}'))


def _compare(found: Mounting, values: dict) -> list[Remark]:
    declared = rotation_from_rpy(*values['imu.mounting_rpy'])
    tilt = math.acos(min(1.0, max(-1.0, float(found.rotation[2] @ declared[2]))))
    tilt_sigma = float(found.sigma[:2].max())
    # the yaw is compared about the up axis found, which a wrong level does not disturb unless it lies on its side
    forward = found.rotation @ declared[0]
    yaw = math.atan2(forward[1], forward[0])
    upright = math.hypot(forward[0], forward[1]) > 0.3
    tilted = tilt > max(SMALL_TILT, SURE * tilt_sigma)
    turned = found.yaw_known and upright and abs(yaw) > max(SMALL_YAW, SURE * float(found.sigma[2]))
    if not tilted and not turned:
        return []
    words = ([_tilt_in_words(tilt, tilt_sigma)] if tilted else []) + (
        [_yaw_in_words(yaw, float(found.sigma[2]))] if turned else [])
    known = '' if found.yaw_known else ' (yaw 0: too few turns and changes of speed to see it)'
    words = ' and '.join(reversed(words))  # backwards, and tilted
    advice = f'set imu.mounting_rpy to {yaml_value([round(float(angle), ANGLE_DIGITS) for angle in found.rpy])}{known}'
    # without the constraint a vehicle may drive sideways
    wrong_way = turned and abs(yaw) > LARGE and values['vehicle.non_holonomic'] and not _may_reverse(found, yaw)
    severity = ERROR if (tilted and tilt > LARGE) or wrong_way else WARNING
    return [Remark(severity, 'imu', f'the IMU seems to be mounted {words}: {advice}',
                   {'tilt': tilt, 'tilt_sigma': tilt_sigma, 'yaw': yaw if found.yaw_known else None,
                    'yaw_sigma': float(found.sigma[2]), 'mounting_rpy': found.rpy.tolist()},
                   ('imu.mounting_rpy',))]


def _may_reverse(found: Mounting, yaw: float) -> bool:
    """Whether a forward axis that points backwards may be that of a vehicle that goes backwards: it was never faster
    than one does that."""
    return abs(yaw) > _BACKWARDS and (found.spans is None or float(
        np.percentile(np.abs(found.spans.speed), 95)) < FASTEST_IN_REVERSE)


def _tilt_in_words(tilt, sigma) -> str:
    degrees = f'{math.degrees(tilt):.0f} +- {math.degrees(sigma):.1f} deg'
    if tilt > math.radians(150.0):
        return f'upside down ({degrees} off level)'
    if tilt > math.radians(60.0):
        return f'on its side ({degrees} off level)'
    return f'tilted by {degrees}'


def _yaw_in_words(yaw, sigma) -> str:
    degrees = f'{abs(math.degrees(yaw)):.0f} +- {math.degrees(sigma):.1f} deg'
    if abs(yaw) > _BACKWARDS:
        return f'backwards (turned by {degrees})'
    return f'turned to the {"left" if yaw > 0 else "right"} by {degrees}'
