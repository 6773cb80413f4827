"""Motion of the vehicle by its fixes, and means of the inertial sensors over the same spans of time.

A span consists of two successive intervals between fixes. The change of the mean speed from the first to the second is
a weighted mean of the acceleration, with a triangular weight. The sensors are averaged with the same weight, so that
both are the same quantity however long the span is.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.filter.runs.usable import usable_fixes
from mems_ins_fusion.recordings.motion import (
    advancing,
    integral,
    middle_sigma,
    positions,
    robust_sigma,
    scatter_of_track,
)
from mems_ins_fusion.samples import Fixes, ImuSamples

#: s to each side of a span, in which the courses of the fixes are averaged, turned by the integrated angular rate
COURSE_WINDOW = 20.0
#: s, longest gap between samples in a span
LONGEST_GAP = 0.3
#: s, shortest interval between two fixes of a span
SHORTEST = 1.0
#: s, longest interval between them
LONGEST = 5.0
#: Hz, rate to which the samples are reduced: enough for the motion of a vehicle
FINEST = 25.0
#: Hz, largest rate at which spans begin
_DENSEST = 2.0
#: smallest number of iterations: the first assumes a constant speed and the gyroscopes without a bias, the others use
#: the last result
_FEWEST_STEPS = 3
#: largest number of them: a bias of the gyroscopes of 0.1 rad/s takes six, one of 0.2 rad/s twelve
_MOST_STEPS = 12
#: rad/s, change of the gyroscopes' bias with which they end: within COURSE_WINDOW it turns a course by 1 deg
_SETTLED = 1e-3
#: m/s: below this speed, the path within a span is computed as at constant speed
_SLOW = 0.3
#: m, shortest distance over which a grade is measured
_CLIMB = 60.0
#: steepest grade of a road
_STEEPEST = 0.35


class InertialIntegrals:
    """Integrals over time of specific force and angular rate in sensor axes, interpolated at any time.

    Times are seconds after `origin` (ns), FINEST of them a second.
    """

    def __init__(self, imu: ImuSamples, origin: int):
        time, force, rate = advancing(imu, origin)
        velocity, angle = integral(time, force), integral(time, rate)
        self.gap_end = time[1:][np.diff(time) > LONGEST_GAP]
        some = slice(None, None, max(round(1.0 / (FINEST * np.median(np.diff(time)))), 1) if len(time) > 1 else 1)
        self.time, self.velocity, self.angle = time[some], velocity[some], angle[some]
        self.displacement = integral(time, velocity)[some]
        self.rate = np.gradient(self.angle, self.time, axis=0) if len(self.time) > 1 else np.zeros_like(self.angle)

    def covers(self, begin, end) -> np.ndarray:
        """Whether there are samples without a gap from `begin` to `end`, (m,) s."""
        whole = np.searchsorted(self.gap_end, begin) == np.searchsorted(self.gap_end, end + LONGEST_GAP)
        return whole & (begin >= self.time[0]) & (end <= self.time[-1])


def _at(times, time, values):
    """`values` (n, k) or (n,), real or complex, at `times`, linear in between."""
    if values.ndim == 1:
        return np.interp(times, time, values)
    return np.column_stack([np.interp(times, time, column) for column in values.T])


@dataclass(frozen=True)
class FixIntervals:
    """Overlapping intervals between fixes, three times each: begin, middle and end of the spans they make.

    times: (m, 3) s after origin (ns). places: (m, 3) complex, north + i east, m. heights: (m, 3) m.
    length: s, nominal. sigma: m, of a fix against the next, north or east.
    """

    origin: int
    times: np.ndarray
    places: np.ndarray
    heights: np.ndarray
    length: float
    sigma: float


def fix_intervals(fixes: Fixes, shortest: float = SHORTEST) -> FixIntervals | None:
    """The spans of `fixes`, long enough for the noise of the receiver and at least `shortest` s; None with too few."""
    fixes = usable_fixes(fixes)
    if len(fixes) < 12:
        return None
    time = (fixes.stamp - fixes.stamp[0]) * 1e-9
    interval = float(np.median(np.diff(time)))
    path = positions(fixes)
    sigma = fix_sigma(fixes, path)
    steps = max(round(np.clip(0.5 + 2.0 * sigma, shortest, max(shortest, LONGEST)) / interval), 1)
    begin = np.arange(0, len(fixes) - 2 * steps, max(round(1.0 / (_DENSEST * interval)), 1))
    if len(begin) < 10:
        return None
    at = begin[:, None] + steps * np.arange(3)
    times = time[at]
    whole = (np.diff(times, axis=1) < 1.5 * steps * interval).all(axis=1)
    place = path[:, 0] + 1j * path[:, 1]
    return FixIntervals(int(fixes.stamp[0]), times[whole], place[at][whole], fixes.height[at][whole],
                        steps * interval, sigma)


def fix_sigma(fixes: Fixes, path: np.ndarray) -> float:
    """Scatter of the fixes about their neighbours, m: as stated, or less where the track is smoother."""
    return float(np.clip(scatter_of_track(path), 0.005, max(middle_sigma(fixes), 0.005)))


@dataclass(frozen=True)
class Spans:
    """Motion by the fixes and means of the sensors of each span; arrays over spans.

    stamp: s, its middle by the clock of the fixes. time: s, the same by that of the IMU. speed: m/s,
    forwards. acceleration: m/s^2, forwards. centripetal: m/s^2 to the right, speed times turn rate.
    grade: rad, upwards; NaN where heights do not show it.
    turn: rad/s, clockwise. turn_change: rad/s^2. turn_squared: (rad/s)^2.
    force: (m, 3) m/s^2 and rate: (m, 3) rad/s in sensor axes. sideways: m/s, of the antenna, to the right.
    length: s of an interval; a span has two.
    """

    stamp: np.ndarray
    time: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    centripetal: np.ndarray
    grade: np.ndarray
    turn: np.ndarray
    turn_change: np.ndarray
    turn_squared: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    sideways: np.ndarray
    length: float


def spans(inertial: InertialIntegrals, fixes: FixIntervals, up: np.ndarray, lag: float) -> Spans | None:
    """The spans of `fixes` in which there are samples. up: (3,) in sensor axes. lag: s, as `gnss.time_offset`.

    The course is a mean of those of the fixes within COURSE_WINDOW, each turned by the integrated angular rate between,
    without its estimated bias. So a noisy fix hardly changes it, and speeds in reverse are negative.
    """
    covered = inertial.covers(fixes.times[:, 0] - lag - 0.5, fixes.times[:, 2] - lag + 0.5)
    if covered.sum() < 10:
        return None
    stamped, place, height = fixes.times[covered], fixes.places[covered], fixes.heights[covered]
    times = stamped - lag
    time = inertial.time
    step = np.diff(place, axis=1)
    length = np.diff(times, axis=1)
    middle = times[:, 1]
    bias, pace = 0.0, np.ones(len(time))
    for steps in range(1, _MOST_STEPS + 1):
        heading = -(inertial.angle @ up) - bias * time
        path = np.column_stack([integral(time, pace * np.cos(heading)), integral(time, pace * np.sin(heading)),
                                integral(time, pace)])
        arc = np.diff(_at(times.ravel(), time, path).reshape(*times.shape, 3), axis=1)
        arc = (arc[..., 0] + 1j * arc[..., 1]) * length / arc[..., 2]  # where a metre per second would lead
        course = _local_sum(middle, (step * arc.conj()).sum(axis=1), COURSE_WINDOW)
        drift = _drift(middle, course)
        bias -= drift
        course /= np.maximum(np.abs(course), 1e-9)
        along = step * (course[:, None] * arc).conj() / np.abs(arc) ** 2
        speed, sideways = along.real, along.imag
        mean_speed = (speed * length).sum(axis=1) / length.sum(axis=1)
        pace = np.interp(time, middle, mean_speed)
        pace = np.where(np.abs(pace) > _SLOW, pace, _SLOW)
        if steps >= _FEWEST_STEPS and abs(drift) < _SETTLED:
            break
    span = length.mean(axis=1)
    turn_rate = -(inertial.rate @ up) - bias
    pace = np.interp(time, middle, mean_speed)

    def weighted(double_integral):
        """The mean with the span's triangular weight, from the second integral over time."""
        values = _at(times.ravel(), time, double_integral).reshape(*times.shape, -1)
        mean = np.diff(values, axis=1) / length[..., None]
        return (mean[:, 1] - mean[:, 0]) / span[:, None]

    lateral = weighted(integral(time, integral(time, pace * turn_rate)))[:, 0]
    squared = weighted(integral(time, integral(time, turn_rate**2)))[:, 0]
    turning = weighted(integral(time, heading))[:, 0]
    mean_turn = np.diff(_at(times.ravel(), time, heading).reshape(times.shape), axis=1) / length
    return Spans(
        stamp=stamped[:, 1], time=middle, speed=mean_speed, acceleration=np.diff(speed, axis=1)[:, 0] / span,
        centripetal=lateral,
        grade=_grades(middle, mean_speed, height[:, 1], fixes), turn=turning,
        turn_change=np.diff(mean_turn, axis=1)[:, 0] / span, turn_squared=squared,
        force=weighted(inertial.displacement), rate=weighted(integral(time, inertial.angle)),
        sideways=sideways.mean(axis=1), length=fixes.length)


def _local_sum(time, values, window):
    """Sum of `values` within `window` s on each side of each of `time`, which ascends."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return total[np.searchsorted(time, time + window, side='right')] - total[np.searchsorted(time, time - window)]


def _drift(time, course) -> float:
    """Robust mean slope of the phase of `course`, rad/s, where it is well determined: the remaining gyroscope bias."""
    apart = max(round(COURSE_WINDOW / max(np.median(np.diff(time)), 1e-3)), 1)
    if len(time) <= apart:
        return 0.0
    turned = np.angle(course[apart:] * course[:-apart].conj()) / (time[apart:] - time[:-apart])
    strength = np.minimum(np.abs(course[apart:]), np.abs(course[:-apart]))
    strong = strength > 0.2 * np.percentile(strength, 90)
    return float(np.median(turned[strong])) if strong.any() else 0.0


def _grades(time, speed, height, fixes: FixIntervals) -> np.ndarray:
    """Grade of the road: slope of a line through the heights of the fixes over _CLIMB, or more with noisy heights."""
    distance = np.concatenate([[0.0], np.cumsum(np.abs(0.5 * (speed[1:] + speed[:-1])) * np.minimum(
        np.diff(time), 5.0))])
    if distance[-1] < _CLIMB:
        return np.full(len(time), np.nan)
    noise = robust_sigma(np.diff(height, 2)) / np.sqrt(6.0)
    reach = 0.5 * max(_CLIMB, 100.0 * noise)
    ends = np.searchsorted(distance, distance - reach), np.searchsorted(distance, distance + reach, side='right')
    count, x, h, xx, xh = (np.concatenate([[0.0], np.cumsum(v)])[ends[1]] - np.concatenate([[0.0], np.cumsum(v)])[
        ends[0]] for v in (np.ones_like(time), distance, height, distance**2, distance * height))
    spread = xx - x**2 / count
    enough = (count >= 4) & (spread / count > (0.2 * reach) ** 2)
    with np.errstate(divide='ignore', invalid='ignore'):
        grade = np.arctan((xh - x * h / count) / spread)
    return np.where(enough & (np.abs(grade) < _STEEPEST), grade, np.nan)
