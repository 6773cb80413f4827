"""Checks of the inputs besides the fixes, by comparison with the fixes: units, signs, frames, stated sigma.

Each input is averaged over chords: straight lines between fixes that are far enough apart to have a direction.
"""
from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mems_ins_fusion.filter.measurements.base import Measurement, SensorSettings
from mems_ins_fusion.filter.measurements.pressure import HIGHEST_PRESSURE, LOWEST_PRESSURE, SEA_LEVEL, height_of
from mems_ins_fusion.filter.measurements.registry import AIDING
from mems_ins_fusion.navigation.frames import wrap
from mems_ins_fusion.recordings.motion import (
    SLOWEST_COURSE,
    TIGHTEST_COURSE,
    UNSTATED_SIGMA,
    integral,
    positions,
    robust_sigma,
    sigmas,
)
from mems_ins_fusion.recordings.remarks import ERROR, INFO, SURE, WARNING, Remark, count_of
from mems_ins_fusion.samples import (
    Fixes,
    Headings,
    MagneticFields,
    Pressures,
    Speeds,
    Twists,
    Velocities,
    in_time_order,
    possible,
    possible_numbers,
)

#: Pa in each unit of pressure
PRESSURES = {'Pa': 1.0, 'hPa': 100.0, 'kPa': 1000.0, 'bar': 1e5, 'psi': 6894.76, 'mmHg': 133.322}
#: T in each unit of a magnetic field
FIELDS = {'T': 1.0, 'mT': 1e-3, 'uT': 1e-6, 'nT': 1e-9, 'gauss': 1e-4, 'mG': 1e-7}
#: T, range of the earth's field with iron nearby: it does not overlap for any two of these units
_WEAKEST, _STRONGEST = 15e-6, 150e-6
_EARTH = 50e-6  # T, size of the earth's field in middle latitudes
_DISTURBED = 0.5  # largest scatter of the horizontal field about the one expected by the course, as a share of it
_CLIMB = 10.0  # m, smallest standard deviation of the heights of the fixes for a comparison with a pressure
#: m/s in each unit that a receiver, a vehicle or a log may use for a speed
SPEED_UNITS = {'m/s': 1.0, 'km/h': 1 / 3.6, 'mph': 0.44704, 'knots': 1852 / 3600, 'mm/s': 1e-3, 'cm/s': 1e-2}
#: largest relative difference to the speed of the fixes for a unit to be recognized: half of the 15 % between mph,
#: knots
_SAME_UNIT = 0.07
_LONGEST_CHORD = 10.0  # s, longest chord
_SHORTEST_CHORD = 10.0  # shortest chord, in standard deviations of a fix
_SHOWS_COURSE = 1.0  # m/s, smallest speed of a vehicle whose course shows its heading
_FEWEST = 12  # smallest number of chords for a remark
_OVERSURE = 3.0  # ratio of the scatter to the stated sigma above which the sigma is reported as too small
_ALIGNED = 0.9  # cosine of the angle between two velocities above which they have the same direction
#: largest scatter of the ratio of a speed to that of the fixes, relative to the ratio; for an east velocity it is 1
_PROPORTIONAL = 0.2
_ZERO = 0.02  # m/s: an input whose speed never exceeds this stays at zero
#: smallest variance of the unit vectors of the courses, in the direction in which they differ least, for a comparison
#: with a magnetic field: courses within some 30 deg to each side have less
_TURNED = 0.02
_STRAIGHT = 0.99  # mean resultant length of courses above which they are one course: within some 8 deg
_CURVE = 0.03  # rad by which the courses of chords differ from the headings in bends, with any receiver
#: matrices that a wrong frame of the message applies to a horizontal velocity (north, east)
_MISTAKES = {
    'north-east-down instead of east-north-up': np.array([[0.0, 1.0], [1.0, 0.0]]),
    'of the opposite sign': -np.eye(2),
    'of the opposite sign in east': np.diag([1.0, -1.0]),
    'of the opposite sign in north': np.diag([-1.0, 1.0]),
}


@dataclass(frozen=True)
class _Chords:
    """Chords between fixes. begin, end: (k,) ns. velocity: (k, 2) m/s north-east, the mean. climb: (k,) m/s. sigma:
    (k,) m/s of a component of the velocity.
    """

    begin: np.ndarray
    end: np.ndarray
    velocity: np.ndarray
    climb: np.ndarray
    sigma: np.ndarray

    @property
    def speed(self) -> np.ndarray:
        return np.linalg.norm(self.velocity, axis=1)

    @property
    def course(self) -> np.ndarray:
        return np.arctan2(self.velocity[:, 1], self.velocity[:, 0])

    def select(self, index) -> _Chords:
        return _Chords(self.begin[index], self.end[index], self.velocity[index], self.climb[index], self.sigma[index])


def check_aiding(measurement: Measurement, samples, fixes: Fixes | None, settings: SensorSettings) -> list[Remark]:
    """Compare `samples` of an input with the fixes, after the `settings` are applied to the samples.

    If a parameter would correct a remark, the first such remark names it with its value. fixes: valid fixes in the
    order of their stamps, or None. Empty for an input for which there is no check here.
    """
    kind = NAMES.get(measurement.kind)
    if kind not in _CHECKS:
        return []
    declared = measurement.declared(settings, samples)
    remarks = [replace(remark, topic=measurement.name) for remark in _CHECKS[kind](declared, fixes)]
    parameter, advice = _advice(measurement, remarks, declared, settings)
    for k, remark in enumerate(remarks):
        if advice and remark.severity != INFO and COMPARED & remark.values.keys():
            remarks[k] = replace(remark, message=f'{remark.message}: {advice}',
                                  settings=(f'{measurement.name}.{parameter}',) if parameter else ())
            break
    return remarks


def _advice(measurement: Measurement, remarks: list[Remark], declared, settings: SensorSettings) -> tuple[str, str]:
    """Which parameter to set, factor or offset, and the advice in words; each '' where none helps."""
    name = NAMES[measurement.kind]
    shown = {key: value for remark in remarks for key, value in remark.values.items()}
    if 'repeated' in shown:
        return '', f'leave {measurement.topic} empty until its sensor works'
    if name in ('speed', 'twist') and 'ratio' in shown:
        if not shown['ratio'] or np.nanmax(np.abs(forward_speed(declared).speed)) < _ZERO:
            return '', ('it stays at zero while the vehicle drives; '
                        f'leave {measurement.topic} empty until its sensor works')
        sign = -1.0 if 'negative' in shown else 1.0
        return 'factor', f"set {measurement.name}.factor to {sign * settings.factor / shown['ratio']:.5g}"
    if name == 'pressure' and 'ratio' in shown:
        middle = shown['ratio'] * SEA_LEVEL
        per = next((per for per in PRESSURES.values() if LOWEST_PRESSURE <= middle * per <= HIGHEST_PRESSURE), None)
        return ('factor', f'set {measurement.name}.factor to {settings.factor * per:g}') if per else ('', '')
    if name == 'magnetometer' and 'ratio' in shown:
        per = _field_unit(shown['ratio'] * _EARTH)
        return ('factor', f'set {measurement.name}.factor to {settings.factor * FIELDS[per]:g}') if per else ('', '')
    if name == 'heading' and 'offset_rad' in shown:
        turned = float(wrap(settings.offset + shown['offset_rad']))
        return 'offset', f'set {measurement.name}.offset to {turned:.4f}'
    return '', ''


def check_speed(speeds: Speeds, fixes: Fixes | None) -> Iterator[Remark]:
    """Check unit, sign and scale of the speed. fixes: valid fixes in the order of their stamps, or None."""
    yield from _check_forward('speed', speeds, fixes)


def check_twist(twists: Twists, fixes: Fixes | None) -> Iterator[Remark]:
    """`check_speed` for the forward velocity of an odometry."""
    yield from _check_forward('twist', forward_speed(twists), fixes)


def forward_speed(samples: Speeds | Twists) -> Speeds:
    """The forward velocity of a speed or an odometry, as a speed."""
    if isinstance(samples, Speeds):
        return samples
    return Speeds(samples.stamp, samples.received, samples.twist[:, 0], samples.variance[:, 0])


def _check_forward(topic, speeds, fixes):
    yield from _check_present(topic, speeds, speeds.speed, speeds.variance)
    compared = _compare(topic, speeds, speeds.speed, fixes, changes=_speed_changes)
    if isinstance(compared, Remark):
        yield compared
        return
    mean, chords = compared
    ratio = mean / chords.speed
    yield from _check_ratio(topic, ratio)
    if np.median(ratio) < 0:
        yield Remark(ERROR, topic, f'the {topic} is negative while the vehicle drives: forward has to be positive, '
                     'unless all of it was in reverse', {'negative': float((ratio < 0).mean())})
    yield from _check_sigma(topic, 'm/s', mean - np.median(ratio) * chords.speed,
                            abs(np.median(ratio)) * chords.sigma, speeds.variance)


def speed_factor(speeds: Speeds, fixes: Fixes | None) -> float | None:
    """Factor that converts `speeds` to m/s, positive forwards; 1 if `check_speed` has no remark about their size.

    None if they are not proportional to the speed of the fixes, NaN without enough fixes in motion. fixes: as for
    `check_speed`.
    """
    compared = _compare('speed', speeds, speeds.speed, fixes, changes=_speed_changes)
    if isinstance(compared, Remark):
        return np.nan if compared.severity == INFO else None
    mean, chords = compared
    ratio = mean / chords.speed
    middle = float(np.median(ratio))
    if not abs(middle) > 0 or robust_sigma(ratio) > _PROPORTIONAL * abs(middle):
        return None
    shown = next(_check_ratio('speed', np.abs(ratio)))
    return (-1.0 if middle < 0 else 1.0) * (1.0 if shown.severity == INFO else 1.0 / abs(middle))


def check_velocity(velocities: Velocities, fixes: Fixes | None) -> Iterator[Remark]:
    """Check unit and frame of the velocity. fixes: valid fixes in the order of their stamps, or None."""
    variance = 0.5 * (velocities.covariance[:, 0, 0] + velocities.covariance[:, 1, 1])
    yield from _check_present('velocity', velocities, velocities.velocity, variance)
    compared = _compare('velocity', velocities, velocities.velocity, fixes,
                        changes=lambda chords: _speed_changes(chords) or _course_changes(chords))
    if isinstance(compared, Remark):
        yield compared
        return
    mean, chords = compared
    horizontal = mean[:, :2]
    pace = np.maximum(np.linalg.norm(horizontal, axis=1), 1e-9)
    yield from _check_ratio('velocity', pace / chords.speed)

    def alignment(matrix):
        """Median cosine between the velocities and those of the fixes turned by `matrix`."""
        return float(np.median(np.einsum('ki,ki->k', horizontal, chords.velocity @ matrix.T) / (pace * chords.speed)))

    right = alignment(np.eye(2))
    if right < _ALIGNED:
        mistake = max(_MISTAKES, key=lambda name: alignment(_MISTAKES[name]))
        if alignment(_MISTAKES[mistake]) > _ALIGNED:
            text = f'it seems to be {mistake}'
        elif _concentration(np.arctan2(horizontal[:, 1], horizontal[:, 0])) > _ALIGNED:
            text = 'it seems to be in the axes of the vehicle, not east-north-up'
        else:
            text = 'its frame or its stamps are wrong'
        yield Remark(ERROR, 'velocity', f'the velocity does not point along the track of the fixes: {text}',
                     {'cosine': right})
        return
    rising = np.std(chords.climb)
    against = np.corrcoef(chords.climb, -mean[:, 2])[0, 1] if rising > 0 and np.std(mean[:, 2]) > 0 else 0.0
    if against < -0.8:
        yield Remark(ERROR, 'velocity', 'the vertical velocity runs against the heights of the fixes: up has to be '
                     'positive in the message', {'correlation': float(against)})
    yield from _check_sigma('velocity', 'm/s', (horizontal - chords.velocity).ravel(), chords.sigma, variance)


def mistaken_velocity(velocities: Velocities, fixes: Fixes | None) -> str:
    """What is wrong with a velocity of a receiver, in words: its unit, or exchanged or reversed axes; '' for one that
    is right, and where it may be no such velocity: one along a single axis may be the speed of wheels. fixes: as for
    `check_speed`.
    """
    east, north = velocities.velocity[:, 1], velocities.velocity[:, 0]
    moving = np.hypot(east, north) > 0.5 * np.nanmedian(np.hypot(east, north))
    if not (east.any() and north.any()) or _concentration(np.arctan2(east, north)[moving]) > _STRAIGHT:
        return ''
    wrong = [remark for remark in check_velocity(velocities, fixes) if remark.severity == ERROR]
    named = [one for one in wrong if 'ratio' in one.values or any(mistake in one.message for mistake in _MISTAKES)]
    return named[-1].message if named else ''


def check_heading(headings: Headings, fixes: Fixes | None) -> Iterator[Remark]:
    """Check sense of rotation and zero of the heading. fixes: valid fixes in the order of their stamps, or None."""
    yield from _check_present('heading', headings, headings.yaw, headings.variance)
    compared = _compare('heading', headings, headings.yaw, fixes, np.unwrap, _course_changes)
    if isinstance(compared, Remark):
        yield compared
        return
    mean, chords = compared
    difference, total = mean - chords.course, mean + chords.course
    if _concentration(total) > max(_ALIGNED, _concentration(difference)) and _concentration(difference) < _ALIGNED:
        yield Remark(ERROR, 'heading', 'the heading turns the other way round than the course of the fixes: clockwise '
                     'from north instead of counter-clockwise from east (REP 103)?',
                     {'concentration': _concentration(total)})
        return
    if _concentration(difference) < 0.7:
        yield Remark(ERROR, 'heading', 'the heading does not follow the course of the fixes',
                     {'concentration': _concentration(difference)})
        return
    middle = np.angle(np.exp(1j * difference).mean())
    middle = float(wrap(middle + np.median(wrap(difference - middle))))
    residual = wrap(difference - middle)
    noise = np.hypot(chords.sigma / chords.speed, _CURVE)
    sigma = max(1.2533 * robust_sigma(residual), 1e-4) / np.sqrt(len(residual))
    values = {'offset_rad': middle, 'sigma_rad': float(sigma)}
    text = f'the heading is {np.degrees(middle):.1f} deg clockwise from the course of the fixes'
    if abs(middle) > max(np.radians(5.0), SURE * sigma):
        yield Remark(ERROR if abs(middle) > np.radians(45.0) else WARNING, 'heading', f'{text}: antennas or compass '
                     'are not aligned with the vehicle, or north and east are exchanged', values)
    else:
        yield Remark(INFO, 'heading', text, values)
    yield from _check_sigma('heading', 'rad', residual, noise, headings.variance)


def pressure_factor(pressures: Pressures) -> float | None:
    """Factor that converts `pressures` to Pa; None if no unit fits."""
    middle = float(np.nanmedian(pressures.pressure)) if np.isfinite(pressures.pressure).any() else 0.0
    return next((per for per in PRESSURES.values() if LOWEST_PRESSURE <= middle * per <= HIGHEST_PRESSURE), None)


def check_pressure(pressures: Pressures, fixes: Fixes | None) -> Iterator[Remark]:
    """Check the unit of the pressure, and whether its heights change like those of the fixes. fixes: valid fixes in the
    order of their stamps, or None."""
    yield from _check_present('pressure', pressures, pressures.pressure, pressures.variance)
    finite = np.sort(pressures.pressure[np.isfinite(pressures.pressure)])
    if not len(finite):
        return
    middle = float(finite[len(finite) // 2])
    if not LOWEST_PRESSURE <= middle <= HIGHEST_PRESSURE:
        unit = next((unit for unit, per in PRESSURES.items()
                     if LOWEST_PRESSURE <= middle * per <= HIGHEST_PRESSURE), None)
        seems = f'it seems to be in {unit} instead of Pa' if unit else 'no unit makes it an air pressure'
        yield Remark(ERROR, 'pressure', f'the pressure is {middle:.4g} Pa: {seems}', {'ratio': middle / SEA_LEVEL})
        return
    if finite[0] == finite[-1]:
        yield Remark(WARNING, 'pressure', 'the pressure is the same in every message', {'count': len(finite)})
        return
    heights = replace(pressures, pressure=height_of(np.clip(pressures.pressure, LOWEST_PRESSURE, HIGHEST_PRESSURE)))
    compared = _compare('pressure', heights, heights.pressure, fixes)
    if isinstance(compared, Remark):
        yield compared
        return
    mean, chords = compared
    middle = 0.5 * (chords.begin - fixes.stamp[0] + chords.end - fixes.stamp[0])
    height = np.interp(middle, fixes.stamp - fixes.stamp[0], fixes.height)
    if np.std(height) < _CLIMB:
        yield Remark(INFO, 'pressure', 'no climbs to compare the pressure with')
        return
    ratio = float(np.cov(mean, height)[0, 1] / np.var(height, ddof=1))
    text = f'by the pressure the vehicle climbs {ratio:.2f} times as much as by the fixes'
    doubtful = not 0.5 < ratio < 1.5
    yield Remark(WARNING if doubtful else INFO, 'pressure', text + (': it is not that of the air outside' if doubtful
                 else ''), {'climb': ratio})


def magnetic_factor(fields: MagneticFields) -> float | None:
    """Factor that converts `fields` to T; None if no unit fits."""
    size = np.linalg.norm(fields.field[possible(fields.field)], axis=1)
    unit = _field_unit(float(np.median(size))) if len(size) else None
    return None if unit is None else FIELDS[unit]


def _field_unit(size: float) -> str | None:
    return next((unit for unit, per in FIELDS.items() if _WEAKEST <= size * per <= _STRONGEST), None)


def shows_course(fixes: Fixes | None) -> bool:
    """Whether `fixes`, valid ones in the order of their stamps, are of a vehicle fast enough for a course."""
    chords = _chords(fixes) if fixes is not None else None
    return chords is not None and np.count_nonzero(chords.speed > _SHOWS_COURSE) >= _FEWEST


def check_magnetometer(fields: MagneticFields, fixes: Fixes | None) -> Iterator[Remark]:
    """Check the unit of the magnetic field, and whether it turns with the vehicle's course. fixes: valid fixes in the
    order of their stamps, or None."""
    topic = 'magnetometer'
    size = np.linalg.norm(possible_numbers(fields.field), axis=1)
    yield from _check_present(topic, fields, size, fields.variance)
    middle = float(np.nanmedian(size)) if np.isfinite(size).any() else np.nan
    if not _WEAKEST <= middle <= _STRONGEST:
        unit = _field_unit(middle)
        seems = f'it seems to be in {unit} instead of T' if unit else "no unit makes it the earth's field"
        yield Remark(ERROR, topic, f'the magnetic field is {middle:.4g} T: {seems}', {'ratio': middle / _EARTH})
        return
    if (fields.field == fields.field[0]).all():
        yield Remark(WARNING, topic, 'the magnetic field is the same in every message', {'count': len(fields)})
        return
    compared = _compare(topic, fields, fields.field, fixes)
    if isinstance(compared, Remark):
        yield compared
        return
    mean, chords = compared
    rows = np.column_stack([np.ones(len(mean)), np.cos(chords.course), np.sin(chords.course)])
    if np.linalg.eigvalsh(np.cov(rows[:, 1:].T))[0] < _TURNED:
        yield Remark(INFO, topic, 'the courses of the fixes are too much alike to compare the magnetic field with')
        return
    fitted = np.linalg.lstsq(rows, mean, rcond=None)[0]
    horizontal = float(np.linalg.norm(fitted[1:]) / np.sqrt(2.0))
    scatter = float(np.sqrt(((mean - rows @ fitted) ** 2).sum(axis=1).mean()))
    text = f'{1e6 * horizontal:.3g} uT of the magnetic field turn with the course, {1e6 * scatter:.2g} uT do not'
    wrong = scatter > _DISTURBED * horizontal
    yield Remark(WARNING if wrong else INFO, topic, text + (
        ': it is not fixed to the vehicle, or currents and iron disturb it' if wrong else ''),
        {'horizontal': horizontal, 'scatter': scatter})


_CHECKS = {'pressure': check_pressure, 'magnetometer': check_magnetometer, 'speed': check_speed,
           'velocity': check_velocity, 'heading': check_heading, 'twist': check_twist}
#: name of each kind of measurement
NAMES = {measurement.kind: measurement.name for measurement in AIDING}
#: keys of the values of remarks that come from a comparison with fixes
COMPARED = {'climb', 'horizontal', 'ratio', 'repeated', 'negative', 'cosine', 'offset_rad', 'concentration'}


def _check_present(topic, samples, value, variance):
    """Remarks on messages without a value, or without a covariance."""
    broken = ~_possible(value)
    if broken.any():
        count = int(broken.sum())
        yield Remark(ERROR if broken.all() else WARNING, topic, f'{count_of(count, "message")} without a {topic}, or '
                     'with an impossible one', {'count': count})
    unknown = ~broken & ~((variance > 0) & np.isfinite(variance))
    if unknown.any():
        count = int(unknown.sum())
        yield Remark(WARNING, topic, f'{count_of(count, "message")} with an unknown or zero covariance',
                     {'count': count})


def _compare(topic, samples, value, fixes, prepare=lambda value: value, changes=lambda chords: False):
    """Means of `value` over the chords that the samples cover, and these chords; a Remark where there are too few, or
    where all values are the same although they have to change.

    prepare: function that is applied to the finite values, in the order of their stamps, before they are averaged.
    changes: whether they have to change, by the chords; none is zero in motion.
    """
    chords = _chords(fixes) if fixes is not None else None
    if chords is None or len(chords.begin) < _FEWEST:
        return Remark(INFO, topic, f'too few fixes move fast enough to compare the {topic} with')
    order = in_time_order(samples.stamp, _possible(value))
    stamp = samples.stamp[order]
    count = np.searchsorted(stamp, chords.end) - np.searchsorted(stamp, chords.begin)
    enough = count > 0
    if enough.any():
        enough &= count > 0.5 * np.median(count[enough])
        enough &= (chords.begin >= stamp[0]) & (chords.end <= stamp[-1])
    if enough.sum() < _FEWEST:
        return Remark(WARNING, topic, f'the {topic} hardly overlaps with the fixes of the moving vehicle: nothing to '
                      'compare it with', {'chords': int(enough.sum())})
    chords = chords.select(enough)
    seen = value[order] if value.ndim == 1 else value[order][:, :2]  # a vertical velocity may be NaN
    if (seen == seen[0]).all() and (changes(chords) or not np.any(seen[0])):
        return Remark(ERROR, topic, f'the {topic} is the same in every message while the vehicle drives',
                      {'repeated': len(order)})
    time = (stamp - stamp[0]) * 1e-9
    area = integral(time, prepare(value[order]))
    begin, end = ((edge - stamp[0]) * 1e-9 for edge in (chords.begin, chords.end))

    def mean(column):
        return (np.interp(end, time, column) - np.interp(begin, time, column)) / (end - begin)

    return (mean(area) if area.ndim == 1 else np.column_stack([mean(column) for column in area.T])), chords


def _speed_changes(chords: _Chords) -> bool:
    return robust_sigma(chords.speed) > _PROPORTIONAL * np.median(chords.speed)


def _course_changes(chords: _Chords) -> bool:
    return _concentration(chords.course) < _STRAIGHT


def _chords(fixes: Fixes) -> _Chords | None:
    """Chords along which the vehicle moved, of a length in time that depends on the noise of the fixes."""
    fixes = fixes.select(np.diff(fixes.stamp, prepend=fixes.stamp[0] - 1) > 0)
    if len(fixes) < 2:
        return None
    sigma = sigmas(fixes, UNSTATED_SIGMA)
    length = float(np.clip(2.0 * np.median(sigma), 1.0, _LONGEST_CHORD))
    later = np.searchsorted(fixes.stamp, fixes.stamp + round(length * 1e9) - 1)
    first = np.flatnonzero(later < len(fixes))
    last = later[first]
    duration = (fixes.stamp[last] - fixes.stamp[first]) * 1e-9
    velocity = (positions(fixes)[last] - positions(fixes)[first]) / duration[:, None]
    climb = (fixes.height[last] - fixes.height[first]) / duration
    chords = _Chords(fixes.stamp[first], fixes.stamp[last], velocity, climb,
                     np.hypot(sigma[first], sigma[last]) / duration)
    return chords.select((chords.speed > np.maximum(SLOWEST_COURSE, _SHORTEST_CHORD * chords.sigma / np.sqrt(2)))
                         & (chords.speed > TIGHTEST_COURSE * _turn_rate(chords)) & (duration < 2 * length))


def _turn_rate(chords: _Chords) -> np.ndarray:
    """Magnitude of the turn rate of the course at each chord, (k,) rad/s, from the chord before it to the one after it.
    chords: all, in the order of their stamps."""
    before = np.minimum(np.searchsorted(chords.end, chords.begin), np.arange(len(chords.begin)))
    after = np.minimum(np.searchsorted(chords.begin, chords.end), len(chords.begin) - 1)
    time = (chords.begin[after] - chords.begin[before]) * 1e-9
    return np.abs(wrap(chords.course[after] - chords.course[before])) / np.maximum(time, 1e-9)


def _check_ratio(topic, ratio):
    """Remarks on the ratio (k,) of the measured values to those of the fixes."""
    middle = float(np.median(np.abs(ratio)))
    sigma = 1.2533 * robust_sigma(np.abs(ratio)) / np.sqrt(len(ratio))
    values = {'ratio': middle, 'sigma': float(sigma)}
    text = f'the {topic} is {middle:.3g} times that of the fixes'
    unit = next((unit for unit, per in SPEED_UNITS.items() if abs(middle * per - 1) < _SAME_UNIT), 'm/s')
    if unit != 'm/s':
        yield Remark(ERROR, topic, f'{text}: it seems to be in {unit} instead of m/s', values)
    elif abs(middle - 1) > max(0.1, SURE * sigma):
        yield Remark(WARNING, topic, f'{text}: a wrong scale or unit', values)
    else:
        yield Remark(INFO, topic, text, values)


def _check_sigma(topic, unit, residual, noise, variance):
    """Whether the `residual` against the fixes, whose own sigma is `noise`, fits the stated variance."""
    known = variance[(variance > 0) & np.isfinite(variance)]
    if not len(known):
        return
    stated, scatter = float(np.sqrt(np.median(known))), robust_sigma(residual)
    if scatter > _OVERSURE * np.hypot(stated, np.median(noise)):
        yield Remark(WARNING, topic, f'stated sigma {stated:.3g} {unit}, scatter against the fixes {scatter:.3g} '
                     f'{unit}: it is too sure of itself, or late', {'stated': stated, 'scatter': scatter})


def _possible(value) -> np.ndarray:
    """(n,) which values are; of vectors (n, 3) by the horizontal two, as not every receiver has a vertical one."""
    return possible(value if value.ndim == 1 else value[:, :2])


def _concentration(angle) -> float:
    """Mean resultant length of angles (k,) rad: 1 if all are equal, near 0 if they are random."""
    return float(np.hypot(np.sin(angle).mean(), np.cos(angle).mean()))
