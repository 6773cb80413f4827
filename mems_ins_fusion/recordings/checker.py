"""Checks of a recording before it is given to a filter.

`check_recording` checks each stream by itself (rate, gaps, stamps, values) and then compares the streams with each
other. Checks that need an estimate of mounting, clocks or the receiver's scatter are in `configuration.check`.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from mems_ins_fusion.filter.measurements.position import has_altitude, is_fix
from mems_ins_fusion.filter.measurements.registry import aiding
from mems_ins_fusion.filter.runs.usable import LARGEST_IN_ANY_UNIT, usable
from mems_ins_fusion.filter.start.course import FASTEST
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY, gravity
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.aiding import check_aiding
from mems_ins_fusion.recordings.claims import misplaced_covariances
from mems_ins_fusion.recordings.motion import (
    UNSTATED_SIGMA,
    find_standstill,
    positions,
    robust_sigma,
    sigmas,
    up_axis,
)
from mems_ins_fusion.recordings.remarks import ERROR, INFO, SURE, WARNING, Remark, count_of, time_in_words
from mems_ins_fusion.recordings.units import RATE, Units, as_delivered, find_units
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording, runs
from mems_ins_fusion.sensor_errors.models import per_axis

HARDEST = 12.0  # m/s^2, largest acceleration of a land vehicle
GAP = 2.5  # shortest gap between messages, in median intervals
#: mean over median interval above which messages come in bursts: where single messages are lost, at most every second
#: one, it is below 2
BURST = 2.0
FEWEST_BURSTS = 10  # a recording with at most 10 gaps has gaps, not bursts. Chosen, not measured
LONGEST_PAUSE = 1.0  # s between bursts: what is longer is a pause of the recording. Chosen, not measured
_AXES = np.array(['x', 'y', 'z'])
_STRAIGHT = np.cos(np.radians(20.0))  # an axis within 20 degrees of the vertical is reported to point up
_SCALE = 0.1  # share of a turn by which gyroscopes may be off; more is reported as a wrong scale
#: units where no parameters are given
_UNITS = {'imu.acceleration_unit': 'm/s^2', 'imu.rate_unit': 'rad/s'}


def check_recording(recording: Recording, values: Mapping = MappingProxyType({})) -> list[Remark]:
    """The remarks on `recording`: for each stream, then for IMU and fixes together. The recording is not changed.

    values: parameters, if there are any: what they already correct, such as a factor of the speed, is not reported.
    `configuration.check` compares the mounting, the clocks, the lever arm and the receiver's scatter with them.
    """
    imu, fixes, seen = recording.imu, recording.gnss, usable(recording)
    remarks = [*check_stamps('imu', imu), *_check_values(imu)]
    good = None
    if fixes is not None:
        remarks += check_stamps('gnss', fixes)
        remarks += _check_fixes_present(fixes, values.get('gnss.sigma', 0.0))
        good = seen.gnss if len(seen.gnss) > 1 else None
    if recording.temperature is not None:
        remarks += check_stamps('temperature', recording.temperature)
    streams = recording.streams()
    for measurement in (measurement for measurement in aiding(values) if measurement.name in streams):
        samples = streams[measurement.name]
        remarks += check_stamps(measurement.name, samples)
        remarks += check_aiding(measurement, samples, good, measurement.settings({**table.defaults(), **values}))
    imu = seen.imu
    if len(imu) < 2:
        return remarks
    if good is not None and (imu.stamp.max() < good.stamp[0] or imu.stamp.min() > good.stamp[-1]):
        return [*remarks, _no_overlap(imu, good)]
    imu, still = _as_declared(imu, values), find_standstill(imu, good)
    remarks += [*check_units(imu, good, values, still), *_check_rest(imu, still)]
    if good is not None:
        remarks += [*_check_claims(good), *_check_frozen(good, imu, still),
                     *_check_jumps(good, values.get('gnss.robust_sigma', 0.0) > 0)]
    return remarks


def check_units(imu: ImuSamples, fixes: Fixes | None, values: Mapping, still: np.ndarray) -> list[Remark]:
    """Check units, scales and signs of usable samples, by gravity and by the turns in the course of usable fixes. Also
    used for the last minutes of a live filter. still: (n,) bool, at rest."""
    declared = [values.get(name, unit) for name, unit in _UNITS.items()]
    expected = float(gravity(fixes.latitude[0], fixes.height[0])) if fixes is not None else STANDARD_GRAVITY
    units = find_units(as_delivered(imu, *declared), fixes, expected)
    return [*_check_gravity(imu, still, expected, units, declared[0], values),
            *(_check_turns(units, declared[1]) if fixes is not None else ())]


def _as_declared(imu: ImuSamples, values: Mapping) -> ImuSamples:
    """`imu` without the biases and scale errors that the parameters `values` state."""
    if 'gyroscope.bias' not in values:
        return imu

    def right(sensor, samples):
        bias, scale = (np.array(per_axis(values, f'{sensor}.{name}')) for name in ('bias', 'scale'))
        return (samples - bias) / (1.0 + scale)
    return replace(imu, specific_force=right('accelerometer', imu.specific_force),
                   angular_rate=right('gyroscope', imu.angular_rate))


def check_stamps(topic, samples):
    """Rate, gaps, jitter and order of the header stamps, and their distance from the log time."""
    stamp = samples.stamp
    if len(stamp) < 2:
        yield Remark(WARNING, topic, f'only {count_of(len(stamp), "message")}', {'count': len(stamp)})
        return
    if not stamp.any():
        yield Remark(ERROR, topic, 'the header stamps are not set (all zero)')
        return
    step = np.diff(stamp)
    if (step < 0).any():
        back = step[step < 0]
        largest = float(-back.min() * 1e-9)
        yield Remark(WARNING, topic, f'stamps go back {count_of(len(back), "time")}, by up to {largest:.3f} s',
                     {'count': len(back), 'largest_s': largest})
    if (step == 0).any():
        repeated = int((step == 0).sum())
        yield Remark(WARNING, topic, f'{count_of(repeated, "stamp")} repeated from the message before',
                     {'count': repeated})
    intervals = step[step > 0] * 1e-9
    if not len(intervals):
        return
    interval, jitter = float(np.median(intervals)), robust_sigma(intervals)
    duration = (stamp.max() - stamp.min()) * 1e-9
    gaps, mean = np.flatnonzero(step * 1e-9 > GAP * interval), duration / len(intervals)
    apart = float(np.median(step[gaps])) * 1e-9 if len(gaps) > FEWEST_BURSTS else np.inf
    if mean > BURST * interval and apart < LONGEST_PAUSE:
        size = len(stamp) / (len(gaps) + 1)
        yield Remark(WARNING, topic, f'stamps come in bursts of {size:.0f}, {apart:.2g} s apart, {1 / mean:.4g} Hz in '
                     'the mean: set on arrival, it seems; the driver is to spread them evenly',
                     {'size': size, 'apart_s': apart, 'rate_hz': 1 / mean})
        yield from _check_latency(topic, samples)
        return
    yield Remark(INFO, topic, f'{len(stamp)} messages, {1 / interval:.4g} Hz, {duration:.1f} s; intervals scatter by '
                 f'{jitter * 1e3:.3g} ms',
                 {'count': len(stamp), 'rate_hz': 1 / interval, 'jitter_s': jitter})
    if jitter > 0.3 * interval:
        yield Remark(WARNING, topic, f'stamps are irregular: intervals scatter by {jitter * 1e3:.3g} ms about '
                     f'{interval * 1e3:.3g} ms', {'jitter_s': jitter})
    if len(gaps):
        longest = gaps[np.argmax(step[gaps])]
        lost = int(np.round(step[gaps] * 1e-9 / interval - 1).sum())
        seconds, at = float(step[longest] * 1e-9), float((stamp[longest] - stamp[0]) * 1e-9)
        yield Remark(WARNING, topic, f'{count_of(len(gaps), "gap")}, about {count_of(lost, "message")} missing; the '
                     f'longest lasts {seconds:.2f} s, {at:.1f} s after the start',
                     {'count': len(gaps), 'missing': lost, 'longest_s': seconds, 'at_s': at})
    yield from _check_latency(topic, samples)


def _check_latency(topic, samples):
    delay = (samples.received - samples.stamp) * 1e-9
    low, middle, high = (float(value) for value in np.percentile(delay, (1, 50, 99)))
    values = {'median_s': middle, 'p1_s': low, 'p99_s': high}
    text = (f'messages arrive {middle * 1e3:.3g} ms after their stamp '
            f'(1 to 99 %: {low * 1e3:.3g} to {high * 1e3:.3g} ms)')
    if not delay.any():
        yield Remark(INFO, topic, 'log times equal the stamps: the recording does not show how late messages arrive',
                     values)
        return
    if abs(middle) > 2.0:
        yield Remark(WARNING, topic, f'stamps and log times are {middle:.2f} s apart: different clocks', values)
    elif low < -0.001:
        yield Remark(WARNING, topic, f'{text}: some arrive before it', values)
    else:
        yield Remark(INFO, topic, text, values)
    if len(delay) > 10 and (samples.received[-1] - samples.received[0]) > 60 * 10**9:
        third = len(delay) // 3
        first, last = delay[:third], delay[-third:]
        drift = float(np.median(last) - np.median(first))
        if abs(drift) > max(0.01, 5.0 * max(robust_sigma(part - np.linspace(0.0, drift / 2, third))
                                            for part in (first, last))):
            yield Remark(WARNING, topic, f'the delay from stamp to log time drifts by {drift * 1e3:.3g} ms: the '
                         'clocks run at different speeds', {'drift_s': drift})


def _check_values(imu: ImuSamples):
    """Remarks on samples that are not finite, and on sensors whose values are constant."""
    both = np.hstack([imu.specific_force, imu.angular_rate])
    broken = ~np.isfinite(both).all(axis=1)
    if broken.any():
        first = (imu.stamp[np.argmax(broken)] - imu.stamp[0]) * 1e-9
        count = int(broken.sum())
        yield Remark(ERROR if broken.all() else WARNING, 'imu', f'{count_of(count, "sample")} not finite (NaN or '
                     f'infinite), the first {first:.1f} s after the start', {'count': count, 'first_s': float(first)})
    with np.errstate(invalid='ignore'):
        beyond = ~broken & ((np.abs(both) > LARGEST_IN_ANY_UNIT).any(axis=1) | ~both[:, :3].any(axis=1))
    if beyond.any():
        count, largest = int(beyond.sum()), float(np.abs(both[beyond]).max())
        beyond_any = largest > LARGEST_IN_ANY_UNIT
        words = f'beyond what an IMU delivers (up to {largest:.3g})' if beyond_any else 'with a specific force of zero'
        yield Remark(ERROR if (broken | beyond).all() else WARNING, 'imu', f'{count_of(count, "sample")} {words}',
                     {'count': count, 'largest': largest})
    broken |= beyond
    if broken.all() or len(imu) < 2:
        return
    for columns, name in ((slice(0, 3), 'accelerometer'), (slice(3, 6), 'gyroscope')):
        constant = np.ptp(both[~broken, columns], axis=0) == 0
        if constant.any():
            axes = ', '.join(_AXES[constant])
            yield Remark(ERROR, 'imu', f'{name} {axes}: the same value in every sample', {'axes': axes})
    same = (both[1:] == both[:-1]).all(axis=1)
    if same.mean() > 0.01 and not same.all():
        count = int(same.sum())
        yield Remark(WARNING, 'imu', f'{count_of(count, "sample")} ({same.mean():.0%}) repeat the one before exactly: '
                     'the driver is faster than the sensor',
                     {'count': count, 'part': float(same.mean())})


def _check_fixes_present(fixes: Fixes, declared: float):
    """Remarks on fixes without a position, and on missing sigmas that are not `declared`, m, either."""
    without = fixes.status < 0
    null = ~without & (fixes.latitude == 0) & (fixes.longitude == 0)
    broken = ~without & ~null & ~is_fix(fixes)
    for mask, text in ((without, 'without a fix (status -1)'),
                       (broken, 'with a position that is not finite or impossible'),
                       (null, 'at latitude 0, longitude 0, where receivers without a fix are')):
        if mask.any():
            count = int(mask.sum())
            yield Remark(ERROR if mask.all() else WARNING, 'gnss', f'{count_of(count, "message")} {text}',
                         {'count': count})
    level = is_fix(fixes) & ~has_altitude(fixes)
    if level.any():
        count = int(level.sum())
        yield Remark(INFO, 'gnss', f'{count_of(count, "fix" if count == 1 else "fixe")} without altitude: they tell '
                     'nothing of the height', {'count': count})
    unknown = np.isnan(sigmas(fixes)) & is_fix(fixes)
    if unknown.any() and not declared:
        count = int(unknown.sum())
        yield Remark(WARNING, 'gnss', f'{count_of(count, "fix" if count == 1 else "fixe")} with an unknown or zero '
                     'covariance: gnss.default_sigma will be used', {'count': count})


def _no_overlap(imu, fixes):
    offset = float(fixes.stamp[0] - imu.stamp[0]) * 1e-9
    return Remark(ERROR, 'imu/gnss', f'IMU and fixes do not overlap in time: the fixes begin '
                  f'{time_in_words(abs(offset))} {"after" if offset > 0 else "before"} the IMU by their stamps',
                  {'offset_s': offset})


def _check_gravity(imu, still, expected, units: Units, declared, values):
    """Magnitude and direction of the specific force: the accelerometers' unit, and which axis points up.

    expected: m/s^2, gravity there. declared: `imu.acceleration_unit`. values: parameters.
    """
    up, magnitude = up_axis(imu, still)
    where = 'at rest' if still.any() else 'without a standstill'
    seen = {'magnitude': magnitude, 'expected': expected, 'up': up.tolist(), 'standstill_s': float(
        still.mean() * (imu.stamp.max() - imu.stamp.min()) * 1e-9)}
    text = f'the specific force is {magnitude:.4g} m/s^2 {where}, gravity there is {expected:.4g} m/s^2'
    if units.gravity and units.acceleration != declared:
        yield Remark(ERROR, 'imu', f'{text}: the accelerometers seem to be in {units.acceleration} instead of '
                     f'{declared} (see imu.acceleration_unit)', seen, ('imu.acceleration_unit',))
    elif units.gravity:
        doubtful = abs(magnitude - expected) > 0.3
        text += ': a large bias or scale error' if doubtful else ''
        yield Remark(WARNING if doubtful else INFO, 'imu', text, seen)
    elif magnitude < 0.2 * expected:
        severity = INFO if values.get('mechanization') == 'planar' else ERROR  # planar needs no gravity
        yield Remark(severity, 'imu', f'{text}: the unit is wrong, or the driver has removed gravity; strapdown needs '
                     'it in the samples (planar does not)', seen)
    else:
        yield Remark(ERROR, 'imu', f'{text}: unit or scale is wrong', seen)
    mounting = values.get('imu.mounting_rpy')
    if mounting is not None and any(mounting):  # which axis points up is said by it
        return
    axis = int(np.argmax(np.abs(up)))
    name = f'{"+" if up[axis] > 0 else "-"}{_AXES[axis]}'
    upright = abs(up[axis]) > _STRAIGHT
    points = f'sensor axis {name} points up' if upright else f'no sensor axis points up: {name} is nearest'
    yield Remark(INFO, 'imu', points, {'axis': name})


def _check_rest(imu, still):
    """Biases of the gyroscopes, where there is a standstill."""
    if still.any():
        bias = imu.angular_rate[still].mean(axis=0)
        if np.abs(bias).max() > 0.05:
            yield Remark(WARNING, 'imu', f'the gyroscopes show {np.abs(bias).max():.3g} rad/s at rest: a large bias, '
                         'or deg/s instead of rad/s', {'bias': bias.tolist()})


def _check_claims(fixes: Fixes):
    """Whether covariances are those of other fixes."""
    seen = misplaced_covariances(fixes)
    if seen is not None:
        where = f'{count_of(abs(seen.late), "message")} {"before" if seen.late > 0 else "after"} its own'
        yield Remark(WARNING, 'gnss', f'the covariance in a message fits the fix {where}: the driver puts together '
                     'what belongs to different epochs', {'late_messages': seen.late, 'gain': seen.gain})


def _check_frozen(fixes, imu, still):
    """Fixes that repeat a position to the last digit while the vehicle moves."""
    same = (np.diff(fixes.latitude) == 0) & (np.diff(fixes.longitude) == 0)
    moving = ~still[np.clip(np.searchsorted(imu.stamp, fixes.stamp[1:]), 0, len(imu) - 1)]
    edges = runs(same)
    begins, ends = edges.T
    moved = np.diff(np.concatenate([[0], np.cumsum(moving)])[edges], axis=1)[:, 0]
    step = np.linalg.norm(np.diff(positions(fixes), axis=0), axis=1)
    pace = np.median(step[step > 0]) if (step > 0).any() else 0.0
    after = np.append(step, 0.0)[np.minimum(ends, len(step))]  # step to where the vehicle is by then
    run = (ends - begins >= 2) & (moved > 0.5 * (ends - begins)) & (after > max(0.5 * pace, 0.05))
    if run.any():
        longest = int(np.argmax(np.where(run, ends - begins, 0)))
        seconds = (fixes.stamp[ends[longest]] - fixes.stamp[begins[longest]]) * 1e-9
        count = int(run.sum())
        yield Remark(WARNING, 'gnss', f'the position freezes {count_of(count, "time")} while the vehicle moves, for '
                     f'up to {seconds:.1f} s', {'count': count, 'longest_s': float(seconds)})


def _check_jumps(fixes, weighed_down):
    """Remarks on steps that no land vehicle makes, beyond five sigma of the receiver. weighed_down: whether the filter
    gives such fixes less weight (gnss.robust_sigma)."""
    stated = sigmas(fixes, UNSTATED_SIGMA)
    time = (fixes.stamp - fixes.stamp[0]) * 1e-9
    interval = np.diff(time)
    step = np.diff(positions(fixes), axis=0)
    with np.errstate(divide='ignore', invalid='ignore'):
        velocity = step / interval[:, None]
        change = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
        span = 0.5 * (interval[1:] + interval[:-1])
        noise = 5.0 * np.hypot(stated[1:], stated[:-1])
        fast = np.linalg.norm(step, axis=1) > FASTEST * interval + noise
        hard = change > HARDEST * span + (noise[1:] + noise[:-1]) / np.minimum(interval[1:], interval[:-1])
    jump = fast | np.append(hard, False) & np.append(False, hard)
    if jump.any():
        # an outlier is two jumps, there and back
        size = np.linalg.norm(step, axis=1)[jump]
        count = int(jump.sum())
        advice = '; gnss.robust_sigma weighs such fixes down' if weighed_down else ' (see gnss.robust_sigma)'
        yield Remark(INFO if weighed_down else WARNING, 'gnss', f'the position jumps {count_of(count, "time")}, by up '
                     f'to {size.max():.3g} m{advice}',
                     {'count': count, 'largest_m': float(size.max()), 'first_s': float(time[1:][jump][0])})


def _check_turns(units: Units, declared: str):
    """Unit and sign of the gyroscopes, from the turns in the course of the fixes. declared: `imu.rate_unit`."""
    if units.steering is None:
        yield Remark(INFO, 'imu/gnss', 'no turns clear enough to compare the gyroscopes with the course of the fixes')
        return
    turned, sigma = (RATE[declared] * value for value in units.steering.turned)
    values = {'ratio': turned, 'sigma': sigma}
    text = f'the gyroscopes turn through {turned:#.3g} times the angle of the course'
    if units.rate != declared:
        yield Remark(ERROR, 'imu', f'{text}: they seem to be in {units.rate} instead of {declared} (see '
                     'imu.rate_unit)', values, ('imu.rate_unit',))
    elif units.steering.scale < 0:
        yield Remark(ERROR, 'imu', f'{text}: their sign does not fit the accelerometers; the axes are mirrored (not '
                     'right-handed), or the specific force has the wrong sign', values)
    elif abs(turned - 1) > max(_SCALE, SURE * sigma):
        yield Remark(WARNING, 'imu', f'{text}: a wrong scale', values)
    else:
        yield Remark(INFO, 'imu', text, values)
