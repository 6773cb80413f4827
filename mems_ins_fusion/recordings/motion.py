"""The vehicle's motion in a whole recording, found without a filter: standstills, the vertical, turns.

Works with the units that the sensors deliver, so that wrong units can be found.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.navigation.frames import wrap
from mems_ins_fusion.samples import Fixes, ImuSamples

#: largest spread of the specific force at rest, as a share of gravity: a running engine causes less
QUIET = 0.03
#: m/s, largest speed that counts as rest
CREEP = 0.15
#: m, standard deviation of a fix whose message states none: that of a receiver without corrections
UNSTATED_SIGMA = 3.0
#: rad/s, smallest turn rate that counts as a turn: more than the bias of a gyroscope changes in a drive, less than a
#: robot's turn on the spot
TURNS = 0.03
#: m/s, smallest speed for which a course is computed: robots drive at 0.4; the noise of the receiver usually needs more
SLOWEST_COURSE = 0.2
#: m, smallest radius of a bend for which a course is computed: in tighter bends a robot turns on the spot, and its
#: antenna moves sideways
TIGHTEST_COURSE = 3.0
#: shortest displacement for which a course is computed, in standard deviations of a fix
_SHORTEST_COURSE = 5.0
#: rad, scatter of the course about the heading that is not caused by the receiver
_SLIP = 0.01
#: s, largest time offset of the fixes that is searched for
_LARGEST_LAG = 2.0
#: number of Gauss-Newton steps after the search
_STEPS = 4
#: smallest number of changes of the course from which a scale is estimated
_FEWEST_CHANGES = 12
#: share of the variance of the course that the turns of the gyroscopes must explain for a finding on the gyroscopes
_EXPLAINED = 0.3
#: standard deviations by which the scale must differ from 0 for a finding on the gyroscopes
_CLEAR = 5.0


def robust_sigma(values: np.ndarray) -> float:
    """Standard deviation of `values` from the median of their absolute deviations: outliers do not count."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def integral(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Running integral of `values` (n, ...) over `time` (n,) by the trapezoidal rule, zero at the first time."""
    step = np.diff(time).reshape(-1, *[1] * (values.ndim - 1))
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(0.5 * (values[1:] + values[:-1]) * step, axis=0)])


def advancing(imu: ImuSamples, origin: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), s after `origin` (ns), specific forces and angular rates (n, 3) of the samples that are finite and
    whose stamps are later than all before."""
    finite = np.isfinite(imu.specific_force).all(axis=1) & np.isfinite(imu.angular_rate).all(axis=1)
    stamp = imu.stamp[finite]
    later = np.diff(np.maximum.accumulate(stamp), prepend=stamp[:1] - 1) > 0
    return (stamp[later] - origin) * 1e-9, imu.specific_force[finite][later], imu.angular_rate[finite][later]


def positions(fixes: Fixes) -> np.ndarray:
    """(n, 2) north and east, m, from the first of `fixes`, which must all be valid."""
    datum = np.array([fixes.latitude[0], fixes.longitude[0], fixes.height[0]])
    # contiguous, as those that `compile` has compiled it for: each fifth fix is not
    places = map(np.ascontiguousarray, (fixes.latitude, fixes.longitude, fixes.height))
    return np.column_stack(to_local(*places, datum)[:2])


def sigmas(fixes: Fixes, unstated: float = math.nan) -> np.ndarray:
    """(n,) horizontal standard deviation per axis as the receiver states it, m; `unstated` where it states none."""
    variance = 0.5 * (fixes.covariance[:, 0, 0] + fixes.covariance[:, 1, 1])
    known = (fixes.covariance_type > 0) & (variance > 0) & np.isfinite(variance)
    return np.sqrt(np.where(known, variance, unstated**2))


def middle_sigma(fixes: Fixes) -> float:
    """Median of the stated standard deviations, m; UNSTATED_SIGMA where no fix states one."""
    stated = sigmas(fixes)
    return float(np.nanmedian(stated)) if np.isfinite(stated).any() else UNSTATED_SIGMA


def find_standstill(imu: ImuSamples, fixes: Fixes | None = None) -> np.ndarray:
    """(n,) which samples are at rest: accelerometers quiet for two seconds or more, and fixes that do not move.

    The test is made second by second. Without fixes, only the accelerometers are used.

    There are three other detectors of standstills, with other information and other costs of an error. Here nothing is
    known of the sensors, not even their unit. `filter.start.at_rest` has thresholds from the parameters and computes
    biases from one standstill, which must not contain slow motion. `filter.trust.standstill` tests each sample while
    the filter runs, and learns from the filter when the vehicle certainly moves. `characterization.stationary` looks
    for hours of an untouched sensor, relative to the usual scatter in the recording, and leaves out single knocks.
    """
    size, count = _seconds(imu)
    if not count:
        return np.zeros(len(imu), bool)
    blocks = imu.specific_force[:count * size].reshape(count, size, 3)
    with np.errstate(invalid='ignore'):
        mean = blocks.mean(axis=1)
        spread = np.sqrt(np.einsum('nij,nij->nj', blocks, blocks) / size - mean**2).max(axis=1)
    level = np.nanmedian(np.linalg.norm(mean, axis=1))
    quiet = spread < QUIET * level
    if fixes is not None and len(fixes) > 1:
        middle = imu.stamp[size // 2:count * size:size]
        quiet &= _stays(middle, fixes)
    quiet &= np.append(quiet[1:], False) | np.append(False, quiet[:-1])
    still = np.zeros(len(imu), bool)
    still[:count * size] = np.repeat(quiet, size)
    return still


def without_turns(still: np.ndarray, imu: ImuSamples) -> np.ndarray:
    """`still` (n,) without the seconds in which the gyroscopes of `imu` (SI units) turn: a robot that turns on the spot
    may be quiet, and its antenna slower than CREEP."""
    size, count = _seconds(imu)
    if not count or not still.any():
        return still
    bias = np.median(imu.angular_rate[still], axis=0)
    mean = imu.angular_rate[:count * size].reshape(count, size, 3).mean(axis=1)
    turns = np.linalg.norm(mean - bias, axis=1) > TURNS
    still = still.copy()
    still[:count * size] &= ~np.repeat(turns, size)
    return still


def _seconds(imu: ImuSamples) -> tuple[int, int]:
    """How many samples a second has, at least 4, and how many whole seconds there are."""
    interval = np.median(np.diff(imu.stamp)) * 1e-9 if len(imu) > 1 else 0.0
    size = max(round(1.0 / interval), 4) if interval > 0 else len(imu)
    return size, len(imu) // size if size else 0


def _stays(stamp: np.ndarray, fixes: Fixes) -> np.ndarray:
    """Whether the fixes around each of `stamp` show no motion; false where there are none."""
    sigma = middle_sigma(fixes)
    window = float(np.clip(5.0 * sigma, 2.0, 10.0))  # s; a poor receiver needs longer to show a creep
    order = np.argsort(fixes.stamp, kind='stable')
    time = (fixes.stamp[order] - fixes.stamp[order[0]]) * 1e-9
    at = (stamp - fixes.stamp[order[0]]) * 1e-9
    path = positions(fixes)[order]
    before = np.column_stack([np.interp(at - window / 2, time, path[:, axis]) for axis in (0, 1)])
    after = np.column_stack([np.interp(at + window / 2, time, path[:, axis]) for axis in (0, 1)])
    near = np.searchsorted(time, at + window) > np.searchsorted(time, at - window)
    return near & (np.linalg.norm(after - before, axis=1) < CREEP * window + 3.0 * sigma)


def scatter_at_rest(fixes: Fixes, imu: ImuSamples, still: np.ndarray) -> float | None:
    """Standard deviation per axis of the fixes about their mean in each standstill, m; None with too few."""
    path = positions(fixes)
    place = np.clip(np.searchsorted(imu.stamp, fixes.stamp), 0, len(imu) - 1)
    number = np.cumsum(np.diff(still.astype(np.int8), prepend=0) > 0)[place]
    rest = still[place]
    squares, freedom = 0.0, 0
    for group in np.unique(number[rest]):
        points = path[rest & (number == group)]
        if len(points) >= 10:
            squares += float(((points - points.mean(axis=0)) ** 2).sum())
            freedom += 2 * (len(points) - 1)
    return np.sqrt(squares / freedom) if freedom else None


def scatter_of_track(track: np.ndarray) -> float:
    """Upper limit of the standard deviation per axis of the white noise of fixes, m, from the second differences of
    `track` (n, 2) m, which do not contain motion at constant velocity. If fixes are rare, it contains accelerations."""
    return max(robust_sigma(axis) for axis in np.diff(track, 2, axis=0).T) / np.sqrt(6.0)


def up_axis(imu: ImuSamples, still: np.ndarray) -> tuple[np.ndarray, float]:
    """Unit vector up in sensor axes, and the mean magnitude of the specific force; at rest if there is a rest."""
    chosen = still if still.any() else np.isfinite(imu.specific_force).all(axis=1)
    mean = imu.specific_force[chosen].mean(axis=0)
    magnitude = float(np.linalg.norm(mean))
    return mean / magnitude, magnitude


@dataclass(frozen=True)
class Steering:
    """Comparison of the turns by gyroscopes and by fixes. scale: change of the course over the angle by the gyroscopes,
    with its standard deviation. explained: share of the variance of the course, 0 to 1. intervals: number of course
    changes compared. diluted: share by which the noise of the gyroscopes may have made the scale too small.
    """

    scale: float
    scale_sigma: float
    explained: float
    intervals: int
    diluted: float = 0.0

    @property
    def turned(self) -> tuple[float, float]:
        """Magnitude of the angle by the gyroscopes over the change of the course, and its standard deviation."""
        turned = 1.0 / abs(self.scale)
        return turned, turned * float(np.hypot(self.scale_sigma * turned, self.diluted))

    @property
    def tells(self) -> bool:
        """Whether the turns suffice for a finding on the gyroscopes."""
        return self.explained >= _EXPLAINED and abs(self.scale) >= _CLEAR * self.scale_sigma


def compare_steering(imu: ImuSamples, fixes: Fixes, up: np.ndarray) -> Steering | None:
    """Fit the course between fixes with the integrated heading of the gyroscopes; None where nothing moves.

    Changes of the mean heading from one interval to the next are compared, so that a gyroscope's slow drift is a
    constant. To first order, with heading psi, its rate w, speed v, time offset T and arm L, the course of a chord is
    the mean over its interval of psi(t - T) + L w / v. Weighted least squares; T by a search, then by Gauss-Newton.
    T and L are estimated only because they influence the scale; `configuration.offset` estimates them better.

    Noise of the gyroscopes (aliased vibration) is noise of the regressor and makes the scale too small. An upper limit
    of this error, relative to the explained variance, is the residual variance beyond the noise of the fixes.
    (W. A. Fuller, "Measurement Error Models", section 1.1.)
    """
    course = _course_changes(fixes)
    if course is None:
        return None
    times, pace, change, weight = course
    heading = _Heading(imu, up)
    begin, middle, end = ((stamp - imu.stamp[0]) * 1e-9 for stamp in times)

    def design(lag):
        """Derivatives of the course change by scale, drift, arm times scale, and lag over scale."""
        rate_before = heading.mean_rate(begin - lag, middle - lag)
        rate_after = heading.mean_rate(middle - lag, end - lag)
        return np.column_stack([heading.mean(middle - lag, end - lag) - heading.mean(begin - lag, middle - lag),
                                (end - begin) / 2, rate_after / pace[1] - rate_before / pace[0],
                                rate_before - rate_after])

    chosen = np.ones(len(change), bool)
    for _ in range(2):  # the second time without outliers: reversing, a jump of the receiver
        lags = np.arange(-_LARGEST_LAG, _LARGEST_LAG + 0.01, 0.2)
        costs = [_solve(design(lag)[chosen, :3], change[chosen], weight[chosen])[1] for lag in lags]
        lag = float(lags[np.argmin(costs)])
        for _ in range(_STEPS):
            scale, _, _, product = _solve(design(lag)[chosen], change[chosen], weight[chosen])[0]
            lag += float(np.clip(product / scale if scale else 0.0, -0.2, 0.2))
        columns = design(lag)
        solution, cost, covariance = _solve(columns[chosen], change[chosen], weight[chosen])
        residual = wrap(change - columns @ solution) * np.sqrt(weight)
        kept, chosen = chosen, np.abs(residual) < 4.0 * max(robust_sigma(residual), 1e-9)
        if chosen.sum() < _FEWEST_CHANGES:
            return None
    scale = float(solution[0])
    sigma = np.sqrt(np.diag(covariance) * max(cost / max(kept.sum() - 4, 1), 1.0))
    total = float((weight * change**2)[kept].sum())
    beyond = max(cost - kept.sum(), 0.0) / max(total - cost, np.finfo(float).tiny)
    return Steering(scale, float(sigma[0]), 1.0 - cost / total if total else 0.0, int(kept.sum()), float(beyond))


def _solve(design, values, weight):
    """Weighted least squares of angles: solution, weighted sum of squared residuals, covariance for weights 1/sigma^2.

    Columns are scaled first; what the data do not determine at all stays zero.
    """
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-12)
    scaled = design / size
    covariance = np.linalg.pinv((scaled * weight[:, None]).T @ scaled, hermitian=True)
    solution = covariance @ ((scaled * weight[:, None]).T @ values)
    residual = wrap(values - scaled @ solution)
    return solution / size, float((weight * residual**2).sum()), covariance / np.outer(size, size)


def _course_changes(fixes: Fixes):
    """For pairs of successive intervals: stamps (begin, middle, end), speeds, change of course, rad, and its weight."""
    fixes = fixes.select(np.diff(fixes.stamp, prepend=fixes.stamp[0] - 1) > 0)
    if len(fixes) < 2:
        return None
    sigma = sigmas(fixes, UNSTATED_SIGMA)
    pace = np.linalg.norm(np.diff(positions(fixes), axis=0), axis=1) / np.diff(fixes.stamp) * 1e9
    # intervals long enough for a course to a few degrees, short enough to resolve a turn
    length = np.clip(40.0 * np.median(sigma) / max(np.percentile(pace, 75), 0.1), 1.0, 4.0)
    chosen = slice(None, None, max(round(length * 1e9 / np.median(np.diff(fixes.stamp))), 1))
    fixes, sigma = fixes.select(chosen), sigma[chosen]
    if len(fixes) < _FEWEST_CHANGES + 2:
        return None
    stamp, interval = fixes.stamp, np.diff(fixes.stamp) * 1e-9
    step = np.diff(positions(fixes), axis=0)
    distance = np.linalg.norm(step, axis=1)
    sigma = np.maximum(sigma[1:], sigma[:-1])
    good = (distance > np.maximum(_SHORTEST_COURSE * sigma, 0.5)) & (interval < 1.5 * np.median(interval))
    course = np.arctan2(step[:, 1], step[:, 0])
    variance = 2.0 * (sigma / np.maximum(distance, 1e-9)) ** 2 + _SLIP**2
    pair = np.flatnonzero(good[1:] & good[:-1])
    if len(pair) < _FEWEST_CHANGES:
        return None
    speed = distance / interval
    return ((stamp[pair], stamp[pair + 1], stamp[pair + 2]), (speed[pair], speed[pair + 1]),
            wrap(course[pair + 1] - course[pair]), 1.0 / (variance[pair + 1] + variance[pair]))


class _Heading:
    """The integrated heading of the gyroscopes, clockwise, as a function of seconds after the first sample."""

    def __init__(self, imu: ImuSamples, up):
        self.time, _, rate = advancing(imu, int(imu.stamp[0]))
        self.angle = integral(self.time, -(rate @ up))
        self.area = integral(self.time, self.angle)

    def mean(self, begin, end):
        """Mean heading between times, rad."""
        return (np.interp(end, self.time, self.area) - np.interp(begin, self.time, self.area)) / (end - begin)

    def mean_rate(self, begin, end):
        """Mean rate of turn between times, rad/s."""
        return (np.interp(end, self.time, self.angle) - np.interp(begin, self.time, self.angle)) / (end - begin)
