"""Position errors of a run against the truth, and their summary. Definitions: docs/metrics.md.

Errors are estimate minus truth, at the epochs of the truth and at the point that the truth describes (usually an
antenna): the position of the run is moved to this point by the lever arm. Trajectories are never aligned.
"""
from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ..filter.measurements.position import is_fix
from ..filter.runs.results import Run
from ..filter.runs.usable import usable_samples
from ..navigation.earth import radii
from ..navigation.frames import wrap
from ..recordings.motion import integral
from ..samples import Fixes, ImuSamples, Reference
from .intervals import interval_of_mean

#: rad/s, turn rate above which a vehicle is in a manoeuvre
TURN_RATE = np.radians(5.0)
#: s before and after a turn that belong to the manoeuvre
TURN_MARGIN = 2.0
#: m/s, smallest speed for which a course is computed
SLOWEST_COURSE = 1.0
#: s over which the displacement gives the course
COURSE_SPAN = 1.0
#: 95 % of a chi-square distribution with 2 degrees of freedom
NEES_95 = 5.991464547107979
#: lengths of path, m, and time between two starts, s, of the relative error: those of the KITTI odometry benchmark
PATH_LENGTHS, PATH_SPACING = tuple(range(100, 900, 100)), 1.0


@dataclass(frozen=True)
class Truth:
    """The trajectory against which errors are measured.

    reference: positions of the point `lever_arm` (3,) m from the IMU, body axes forward-right-down. variance (m,): of
    its north and of its east position, m^2 (0: assumed exact). source: in words. behind: whether it consists of fixes
    of a receiver that may smooth them; the lag for which the filter corrects is then not counted as an error.
    receiver_clock: whether its stamps are of the receiver's clock; the time offset that the filter estimates beside
    gnss.time_offset is then not counted as an error. Only of a `Run`: a recorded odometry tells no such offset. The
    filter's covariance stays as it is, so that it contains what that offset may be off.
    """

    reference: Reference
    lever_arm: np.ndarray
    variance: np.ndarray
    source: str
    behind: bool = False
    receiver_clock: bool = False

    def __len__(self) -> int:
        return len(self.reference)

    def select(self, index) -> Truth:
        return replace(self, reference=self.reference.select(index), variance=self.variance[index])


@dataclass(frozen=True)
class Errors:
    """Errors of one run, (m,) each, at the epochs of the truth within the run.

    stamp: ns. north, east, along, cross: m, along and across the heading. sigma: m, the filter's horizontal standard
    deviation, sqrt(P_nn + P_ee). variance: m^2, expected variance of the error on each axis, including that of the
    truth. nees: normalized error squared of the horizontal position. heading, rad, and speed, m/s: NaN where the truth
    has none. turning: bool, in a manoeuvre.
    """

    stamp: np.ndarray
    north: np.ndarray
    east: np.ndarray
    along: np.ndarray
    cross: np.ndarray
    sigma: np.ndarray
    variance: np.ndarray
    nees: np.ndarray
    heading: np.ndarray
    speed: np.ndarray
    turning: np.ndarray

    def __len__(self) -> int:
        return len(self.stamp)

    @property
    def horizontal(self) -> np.ndarray:
        return np.hypot(self.north, self.east)

    def select(self, index) -> Errors:
        return Errors(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def position_errors(run: Run, truth: Truth, turning: np.ndarray, longest_gap: float = 10.0) -> Errors:
    """Errors of `run` at the epochs of `truth` that it covers; turning (m,): of each epoch of `truth`.

    Between its samples the run is interpolated linearly; epochs in a step of more than `longest_gap` s are left out.
    """
    inside = _covered(run.stamp, truth.reference.stamp, longest_gap)
    truth, turning = truth.select(inside), turning[inside]
    reference = truth.reference
    at = _Interpolation(run.stamp, reference.stamp)
    latitude, longitude = at(run.latitude), at(run.longitude)
    yaw = at(np.unwrap(run.yaw))
    arm_n, arm_e = lever_arm_north_east(truth.lever_arm, at(run.roll), at(run.pitch), yaw)
    meridian, prime_vertical = radii(reference.latitude)
    north = (latitude - reference.latitude) * (meridian + reference.height) + arm_n
    east = (wrap(longitude - reference.longitude) * (prime_vertical + reference.height) * np.cos(reference.latitude)
            + arm_e)
    if truth.behind:
        north, east = north - at(run.behind[:, 0]), east - at(run.behind[:, 1])
    if truth.receiver_clock and isinstance(run, Run):
        offset = _estimated_offset(run)
        north, east = north - at(offset * run.velocity[:, 0]), east - at(offset * run.velocity[:, 1])
    heading = yaw if reference.yaw is None else reference.yaw
    cos, sin = np.cos(heading), np.sin(heading)
    p_nn, p_ee, p_ne = at(run.sigma[:, 0])**2, at(run.sigma[:, 1])**2, at(run.covariance_ne)
    missing = np.full(len(reference), np.nan)
    return Errors(
        stamp=reference.stamp, north=north, east=east, along=cos * north + sin * east, cross=cos * east - sin * north,
        sigma=np.sqrt(p_nn + p_ee), variance=0.5 * (p_nn + p_ee) + truth.variance,
        nees=_nees(north, east, p_nn + truth.variance, p_ee + truth.variance, p_ne),
        heading=missing if reference.yaw is None else wrap(yaw - reference.yaw),
        speed=missing if reference.velocity is None else
        np.hypot(at(run.velocity[:, 0]), at(run.velocity[:, 1])) - np.hypot(*reference.velocity.T[:2]),
        turning=turning)


def _estimated_offset(run: Run) -> np.ndarray:
    """(k,) s, time offset of the fixes that the filter estimates beside gnss.time_offset; 0 where it does not."""
    names = [extra.name for extra in run.config.extras]
    return run.extras[:, names.index('time_offset')] if 'time_offset' in names else np.zeros(len(run.stamp))


class _Interpolation:
    """Linear interpolation from one set of stamps (ns, ascending) to another."""

    def __init__(self, stamp, wanted):
        origin = stamp[0] if len(stamp) else 0
        x, at = stamp - origin, wanted - origin
        self.left = np.clip(np.searchsorted(x, at, side='right') - 1, 0, max(len(x) - 2, 0))
        self.right = np.minimum(self.left + 1, max(len(x) - 1, 0))
        step = x[self.right] - x[self.left] if len(x) else np.zeros(0)
        self.part = np.where(step > 0, (at - x[self.left]) / np.maximum(step, 1), 0.0) if len(x) else np.zeros(0)

    def __call__(self, values):
        left = values[self.left]
        return left + self.part * (values[self.right] - left)


def _covered(stamp, wanted, longest_gap):
    """Which of the `wanted` stamps lie between samples that are not far apart."""
    if len(stamp) < 2:
        return np.zeros(len(wanted), dtype=bool)
    left = np.clip(np.searchsorted(stamp, wanted, side='right') - 1, 0, len(stamp) - 2)
    near = (stamp[left + 1] - stamp[left] <= longest_gap * 1e9) | (stamp[left] == wanted)
    return (wanted >= stamp[0]) & (wanted <= stamp[-1]) & near


def lever_arm_north_east(arm, roll, pitch, yaw):
    """North and east component of a lever arm in body axes (forward-right-down), m."""
    x, y, z = arm
    sin_roll, cos_roll = np.sin(roll), np.cos(roll)
    forward = np.cos(pitch) * x + np.sin(pitch) * (sin_roll * y + cos_roll * z)
    right = cos_roll * y - sin_roll * z
    return np.cos(yaw) * forward - np.sin(yaw) * right, np.sin(yaw) * forward + np.cos(yaw) * right


def _nees(north, east, p_nn, p_ee, p_ne):
    """e^T P^-1 e of the two horizontal components."""
    determinant = p_nn * p_ee - p_ne**2
    return (p_ee * north**2 - 2 * p_ne * north * east + p_nn * east**2) / determinant


def turning_at(imu: ImuSamples, conditioning: np.ndarray, stamp: np.ndarray) -> np.ndarray:
    """Whether the vehicle is in a manoeuvre at each `stamp` (m,) ns: a mean turn rate over 1 s above TURN_RATE, then or
    within TURN_MARGIN.

    The turn rate is that of the gyroscopes, so that manoeuvres are the same for all models. conditioning: (6, 6), of
    `FilterConfig`.
    """
    imu = usable_samples(imu)
    if len(imu) < 2:
        return np.zeros(len(stamp), dtype=bool)
    time = (imu.stamp - imu.stamp[0]) * 1e-9
    rate = imu.angular_rate @ conditioning[5, 3:]
    yaw = integral(time, rate)
    # only where there are samples: if a clock is set during a recording, it spans decades
    grid = np.unique(np.floor(10.0 * time)) / 10.0
    turn = np.abs(np.interp(grid + 0.5, time, yaw) - np.interp(grid - 0.5, time, yaw)) > TURN_RATE
    count = np.concatenate([[0], np.cumsum(turn)])
    at = (stamp - imu.stamp[0]) * 1e-9
    first, last = (np.clip(np.searchsorted(grid, at + offset), 0, len(grid)) for offset in (-TURN_MARGIN, TURN_MARGIN))
    return count[last] > count[first]


def truth_from_fixes(fixes: Fixes, lever_arm, time_offset: float, source: str) -> Truth:
    """Valid fixes as the truth for the antenna. lever_arm: (3,) m forward-right-down. time_offset: s, as
    `gnss.time_offset`. Their variance is that in the messages (0 where the messages have none)."""
    fixes = fixes.select(is_fix(fixes))
    fixes = fixes.select(np.argsort(fixes.stamp, kind='stable'))
    variance = 0.5 * (fixes.covariance[:, 0, 0] + fixes.covariance[:, 1, 1])
    known = (fixes.covariance_type > 0) & np.isfinite(variance) & (variance > 0)
    return Truth(Reference(fixes.stamp - round(time_offset * 1e9), fixes.latitude, fixes.longitude, fixes.height),
                 np.asarray(lever_arm, dtype=float), np.where(known, variance, 0.0), source, behind=True,
                 receiver_clock=True)


def rms(values) -> float:
    """Root mean square, NaN of nothing."""
    values = np.asarray(values)
    return float(np.sqrt(np.mean(values**2))) if len(values) else float('nan')


def summary(errors: Errors) -> dict:
    """The numbers of one run for `report.json`; None where they cannot be computed."""
    horizontal = errors.horizontal
    low, high = interval_of_mean(horizontal**2)
    quantile = {name: float(np.percentile(horizontal, q)) if len(horizontal) else None
                for name, q in (('median', 50), ('p95', 95), ('max', 100))}
    numbers = {
        'horizontal_rmse_m': rms(horizontal),
        'horizontal_rmse_interval_m': np.sqrt(np.maximum([low, high], 0.0)).tolist() if np.isfinite(low) else None,
        **{f'horizontal_{name}_m': value for name, value in quantile.items()},
        'cep50_m': quantile['median'], 'cep95_m': quantile['p95'],
        'along_track_rmse_m': rms(errors.along), 'cross_track_rmse_m': rms(errors.cross),
        'turning_rmse_m': rms(horizontal[errors.turning]), 'straight_rmse_m': rms(horizontal[~errors.turning]),
        'turning_share': float(errors.turning.mean()) if len(errors) else None,
        'heading_rmse_deg': float(np.degrees(rms(errors.heading[np.isfinite(errors.heading)]))),
        'speed_rmse_mps': rms(errors.speed[np.isfinite(errors.speed)]),
        'nees_mean': float(errors.nees.mean()) if len(errors) else None,
        'within_95_percent': float(100 * (errors.nees < NEES_95).mean()) if len(errors) else None,
        'errors_counted': len(errors),
    }
    return {name: None if isinstance(value, float) and not np.isfinite(value) else value
            for name, value in numbers.items()}


def turned_by_course(stamp: np.ndarray, truth: np.ndarray, estimate: np.ndarray) -> np.ndarray:
    """Heading error (m,), rad, for a truth without heading: rotation between the displacements over COURSE_SPAN of both
    tracks; NaN where the vehicle is slow.

    Both tracks (m, 2) are of the same point of the vehicle, so that neither sideslip nor mounting matters. stamp: ns.
    """
    half = round(0.5e9 * COURSE_SPAN)
    last = np.clip(np.searchsorted(stamp, stamp + half), 0, len(stamp) - 1)
    first = np.clip(np.searchsorted(stamp, stamp - half, side='right') - 1, 0, len(stamp) - 1)
    (north, east), (n, e) = (truth[last] - truth[first]).T, (estimate[last] - estimate[first]).T
    seconds = np.maximum((stamp[last] - stamp[first]) * 1e-9, 1e-3)
    slow = np.hypot(north, east) < SLOWEST_COURSE * seconds
    return np.where(slow, np.nan, wrap(np.arctan2(e, n) - np.arctan2(east, north)))


def relative_translation_percent(stamp: np.ndarray, truth: np.ndarray, estimate: np.ndarray, turned: np.ndarray,
                                 distance: np.ndarray) -> float | None:
    """Relative translation error in percent of the path length, mean over all paths with the lengths PATH_LENGTHS and a
    start each PATH_SPACING s; None where the drive is shorter than the shortest path.

    stamp (m,) ns, ascending. truth, estimate (m, 2): north and east, m. turned (m,): heading error, rad. Where it is
    NaN the displacements are compared without a rotation, so that the heading error is part of the result. distance
    (m,): driven since the first epoch, m, not decreasing.

    Both displacements are expressed in the vehicle's axes at the start of the path, as in A. Geiger, P. Lenz, R.
    Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite", 2012 (its development kit), in two
    dimensions.
    """
    if not len(stamp):
        return None
    start = np.flatnonzero(np.diff((stamp - stamp[0]) // round(PATH_SPACING * 1e9), prepend=-1))
    turned = np.nan_to_num(turned)
    found = []
    for length in PATH_LENGTHS:
        end = np.searchsorted(distance, distance[start] + length)
        first, last = start[end < len(stamp)], end[end < len(stamp)]
        d_north, d_east = (estimate[last] - estimate[first]).T
        cos, sin = np.cos(turned[first]), np.sin(turned[first])
        seen = np.column_stack([cos * d_north + sin * d_east, cos * d_east - sin * d_north])
        found.append(np.linalg.norm(seen - (truth[last] - truth[first]), axis=1) / length)
    found = np.concatenate(found)
    return float(100 * found.mean()) if len(found) else None
