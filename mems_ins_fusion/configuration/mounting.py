"""Orientation of the IMU in the vehicle, estimated from a drive without a filter and without assumptions on the axes.

Averaged over spans of seconds, the specific force in sensor axes is a sum of three vectors: forward times the
acceleration, right times speed times turn rate, up times gravity; acceleration, speed and turn rate come from fixes and
gyroscopes. Least squares estimates the vectors. Their standard deviations are those of a jackknife: the estimate is
repeated without one stretch of the drive after the other, so that errors by the road (grades, crown), which are the
same for a hundred metres and more, count as such. The gyroscopes also show the up axis: the vehicle turns about it.
That estimate does not contain the accelerometers' biases.
The equations: docs/configure.md.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from mems_ins_fusion.configuration.kinematics import (
    LONGEST,
    FixIntervals,
    InertialIntegrals,
    Spans,
    fix_intervals,
    spans,
)
from mems_ins_fusion.configuration.offset import LARGEST, Offset, estimate_offset
from mems_ins_fusion.configuration.regression import RegressionFit, blocks, fit, jackknife, weighted
from mems_ins_fusion.filter.prediction import UNKNOWN_YAW_SIGMA
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.recordings.motion import TIGHTEST_COURSE, find_standstill, robust_sigma
from mems_ins_fusion.samples import Fixes, ImuSamples, runs

#: m/s^2, standard deviation of a consumer accelerometer's turn-on bias, which looks like a tilt
BIAS_SIGMA = 0.2
#: rad, standard deviation of the slope where a vehicle stands, and of that of the road where heights do not show it
SLOPE_SIGMA = math.radians(1.5)
#: m of road over which the slope stays the same: on one hillside a vehicle sees one slope for minutes
_SLOPE_LASTS = 100.0
#: rad, standard deviation of the change of a road's tilt over a right-angled turn
TURN_TILT_SIGMA = math.radians(1.5)
#: rad, standard deviation of the angles between the axes of a MEMS sensor from 90 deg
AXES_SIGMA = math.radians(0.3)
#: rad: a yaw with a larger standard deviation is not known
SHOWN = math.radians(20.0)
#: m, standard deviation of the distance from the IMU to the rear axle, before anything is known
_ARM_SIGMA = 1.5
#: s, step of the first search for the time offset: shorter than a change of speed
_ROUGH = 0.4
#: m/s^2: a span with a larger acceleration is an error of the receiver
_HARDEST = 8.0
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # turns right into forward
#: m/s, smallest speed that counts as driving: slow robots drive at 0.4
_SLOWEST = 0.2
#: the fastest speed has to be this multiple of `_Motion.slowest`: else the speeds are mostly noise
_CLEAR = 2.0
#: number of spans in motion below which nothing is estimated
_FEWEST_SPANS = 15
#: largest relative difference between the fitted gravity and the mean specific force: with a larger one, the spans are
#: too few or too similar to separate motion from gravity
_GRAVITY_ELSEWHERE = 0.1
#: smallest ratio of specific force to acceleration: with a smaller one, noise of the fixes hides the acceleration, and
#: longer spans are used. The same for the acceleration in turns, and for gravity along the forward axis and the grade
_SMALLEST_GAIN = 0.6
#: largest ratio of specific force to acceleration in turns, and of gravity along the forward axis to the grade: 1, and
#: up to a tenth more where the body rolls and pitches on its springs
_LARGEST_GAIN = 1.5
#: rad: evidence for the yaw with a larger standard deviation is not used
_USABLE = 0.6
# rows of the vectors that explain the specific force; and their prior, in units of the noise of a span, about 0.1 m/s^2
_FORWARD, _RIGHT, _GRADE, _UP, _TURN_CHANGE, _TURN_SQUARED = range(6)
_PRIOR = np.array([1e4, 1e4, 10.0, 1e6, 10.0 * _ARM_SIGMA, 10.0 * _ARM_SIGMA])


@dataclass(frozen=True)
class Evidence:
    """One independent estimate of an angle: its difference from the final estimate, and its sigma, rad."""

    source: str
    angle: tuple[float, ...]
    sigma: tuple[float, ...]


@dataclass(frozen=True)
class Mounting:
    """The rotation from sensor axes to base_link (forward-left-up), and the evidence for it.

    rotation: (3, 3). sigma: (3,) rad, of small rotations about forward, left and up; UNKNOWN_YAW_SIGMA where nothing
    shows it.
    level, heading: the evidence for the up axis (angles about forward and left) and for the yaw (about up).
    offset: time offset and lever arm of the antenna; None where the drive shows neither, or where the offset was given.
    imu: m, (value, sigma) of its distance ahead of the rear axle.
    bias: (3,) m/s^2, of the accelerometers in sensor axes, beyond what tilt explains, and bias_sigma.
    gain: ratio of specific force to acceleration, forward and sideways: 1, more where the body pitches and rolls on its
    springs. driven: s in motion. turned: rad, sum of the turns. spans: of which the estimate was made, or None.
    """

    rotation: np.ndarray
    sigma: np.ndarray
    level: tuple[Evidence, ...] = ()
    heading: tuple[Evidence, ...] = ()
    offset: Offset | None = None
    imu: tuple[float, float] = (0.0, math.inf)
    bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bias_sigma: float = math.inf
    gain: float = math.nan
    driven: float = 0.0
    turned: float = 0.0
    spans: Spans | None = None

    @property
    def lag(self) -> float:
        """The time offset, s; 0 where it is not shown."""
        return self.offset.lag if self.offset is not None and self.offset.shown else 0.0

    @property
    def lag_sigma(self) -> float:
        return self.offset.lag_sigma if self.offset is not None else math.inf

    @property
    def rpy(self) -> np.ndarray:
        """Roll, pitch, yaw, rad, as `imu.mounting_rpy`."""
        return rpy(self.rotation)

    @property
    def yaw_known(self) -> bool:
        return bool(np.max(self.sigma) < SHOWN)  # of an IMU whose roll or pitch may be anything, there is none


def rpy(rotation: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw, rad, of R_z(yaw) R_y(pitch) R_x(roll); roll 0 where the pitch is a right angle."""
    pitch = math.asin(min(1.0, max(-1.0, -rotation[2, 0])))
    if abs(rotation[2, 0]) > 1.0 - 1e-9:
        return np.array([0.0, pitch, math.atan2(-rotation[0, 1], rotation[1, 1])])
    return np.array([math.atan2(rotation[2, 1], rotation[2, 2]), pitch, math.atan2(rotation[1, 0], rotation[0, 0])])


def deviation(rotation: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(3,) rad, the rotation about forward, left and up that leads from `other` to `rotation`, both to base_link."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation @ other.T).as_rotvec()


def estimate_mounting(imu: ImuSamples, fixes: Fixes | None = None, gravity: float = STANDARD_GRAVITY,
                      lag: float | None = None) -> Mounting | None:
    """The mounting that `imu` (SI units) and `fixes` show; None where they do not even show the up axis.

    gravity: m/s^2, at this place. lag: s, the time offset, None: it is estimated, too. The up axis comes from gravity
    and from the axis of the turns; the yaw from acceleration, turns and, where the heights are good, grades. Forward is
    the direction in which most of the drive goes.
    """
    intervals = fix_intervals(fixes) if fixes is not None else None
    inertial = InertialIntegrals(imu, intervals.origin if intervals else int(imu.stamp[0]))
    if len(inertial.time) < 2:
        return None
    up = _first_up(inertial, intervals, gravity)
    if up is None:
        return None
    rests = _rests(imu, find_standstill(imu, fixes))
    while intervals is not None:
        level = _levelled(inertial, intervals, up)
        at = _rough_lag(inertial, intervals, level) if lag is None else lag
        motion = _explain(inertial, intervals, level, at)
        longer = 2.0 * intervals.length
        if motion is not None and (motion.gain > _SMALLEST_GAIN or longer > LONGEST):
            found = _assemble(motion, rests, level, gravity)
            if lag is not None or not found.yaw_known:
                return found
            offset = estimate_offset(imu, fixes, found.rotation)
            if offset is None or not offset.shown:
                return replace(found, offset=offset)

            def mounted(lag, level=level, intervals=intervals):
                motion = _explain(inertial, intervals, level, lag)
                return _assemble(motion, rests, level, gravity) if motion is not None else found
            return _with_offset(mounted(offset.lag), mounted(offset.lag + offset.lag_sigma), offset)
        # in longer intervals the receiver's noise hides less of the changes of speed
        intervals = fix_intervals(fixes, longer) if longer < 2.0 * LONGEST else None
    return _at_rest(rests, up, gravity)


def _with_offset(found: Mounting, later: Mounting, offset: Offset) -> Mounting:
    """`found` with larger sigmas for the error of the time offset. later: the mounting with an offset that is larger by
    one sigma."""
    turned = deviation(later.rotation, found.rotation) if later.yaw_known and found.yaw_known else np.zeros(3)
    return replace(found, sigma=np.hypot(found.sigma, turned), offset=offset)


def _first_up(inertial: InertialIntegrals, intervals: FixIntervals | None, gravity) -> np.ndarray | None:
    """The up axis to a few degrees: the mean specific force, or the axis of the turns where gravity is missing."""
    mean = inertial.velocity[-1] / (inertial.time[-1] - inertial.time[0])
    if np.linalg.norm(mean) > 0.5 * gravity:
        return mean / np.linalg.norm(mean)
    if intervals is None:
        return None
    _, vectors = np.linalg.eigh(np.cov(inertial.rate.T))
    # of the two directions of the axis, the one about which the course turns, too
    costs = [_misfit(inertial, intervals, sign * vectors[:, 2]) for sign in (1.0, -1.0)]
    return (1.0, -1.0)[int(np.argmin(costs))] * vectors[:, 2]


def _misfit(inertial, intervals, up) -> float:
    found = spans(inertial, intervals, up, 0.0)
    return robust_sigma(found.sideways[np.abs(found.speed) > _SLOWEST]) if found is not None else math.inf


@dataclass(frozen=True)
class _Motion:
    """Spans in motion for one time offset, and the fit of the specific force to them. slowest: m/s, smallest speed that
    counts as motion: most speeds by noise of the fixes are smaller."""

    spans: Spans
    slowest: float
    moving: np.ndarray
    block: np.ndarray
    fit: RegressionFit

    @property
    def gain(self) -> float:
        """Ratio of specific force to acceleration: about 1, less where noise of the fixes adds to the acceleration."""
        return float(np.linalg.norm(self.fit.solution[_FORWARD]))

    def sigma(self, function, index: int | None = None) -> np.ndarray:
        """Standard deviation of `function` of the fit's (6, 3) vectors. index: of the vector that matters most."""
        return jackknife(np.array([function(vectors) for vectors in self.fit.left_out]),
                         None if index is None else self.fit.shown(index))


def _explain(inertial, intervals, up, lag) -> _Motion | None:
    """Least squares of the specific force on the motion; None with too little motion."""
    motion = spans(inertial, intervals, up, lag)
    if motion is None:
        return None
    slowest = max(_SLOWEST, 3.0 * intervals.sigma / intervals.length)
    # a robot that turns on the spot and drives in one span has another speed in its turn than on average
    moving = ((np.abs(motion.speed) > np.maximum(slowest, TIGHTEST_COURSE * np.abs(motion.turn)))
              & (np.abs(motion.acceleration) < _HARDEST) & (np.abs(motion.centripetal) < _HARDEST))
    if moving.sum() < _FEWEST_SPANS:
        return None
    grade = np.where(np.isfinite(motion.grade), motion.grade, 0.0)
    design = np.column_stack([motion.acceleration, motion.centripetal, STANDARD_GRAVITY * np.sin(grade),
                              np.ones(len(grade)), motion.turn_change, motion.turn_squared])[moving]
    block = blocks(motion.time[moving])
    explained = fit(design, motion.force[moving], _PRIOR, block)
    mean = float(np.linalg.norm(motion.force[moving].mean(axis=0)))
    kept = float(np.linalg.norm(explained.solution[_UP]))
    if mean > 0.5 * STANDARD_GRAVITY and abs(kept / mean - 1.0) > _GRAVITY_ELSEWHERE:
        return None  # so few spans, or spans so alike, that gravity may be anything else
    return _Motion(motion, float(slowest), moving, block, explained)


def _levelled(inertial, intervals, up):
    """`up` without the mean of the accelerations forward and sideways, which is part of the mean specific force."""
    for _ in range(2):
        motion = _explain(inertial, intervals, up, 0.0)
        vector = motion.fit.solution[_UP] if motion is not None else np.zeros(3)
        if np.linalg.norm(vector) < 0.5 * STANDARD_GRAVITY:
            return up
        up = vector / np.linalg.norm(vector)
    return up


def _rough_lag(inertial, intervals, up) -> float:
    """The time offset that explains the specific force best, to some tenths of a second."""
    lags = np.arange(-LARGEST, LARGEST + 0.01, _ROUGH)
    return float(lags[np.argmin([_cost(_explain(inertial, intervals, up, lag)) for lag in lags])])


def _cost(motion: _Motion | None) -> float:
    """Mean squared residual of a span, bounded for outliers."""
    if motion is None:
        return math.inf
    return float(motion.fit.weight @ (motion.fit.residual**2).sum(axis=1) / motion.fit.weight.sum())


def _rests(imu: ImuSamples, still: np.ndarray) -> np.ndarray:
    """(k, 3) mean specific force of each standstill."""
    return np.array([imu.specific_force[a:b].mean(axis=0) for a, b in runs(still)]).reshape(-1, 3)


def _at_rest(rests, up, gravity) -> Mounting:
    """The mounting without motion: only the up axis, from the standstills or from the mean over the recording."""
    tilt, up_sigma = np.zeros(2), np.full(2, math.hypot(SLOPE_SIGMA, BIAS_SIGMA / gravity))
    if len(rests):
        up = rests.mean(axis=0) / np.linalg.norm(rests.mean(axis=0))
    level = Evidence('gravity at rest' if len(rests) else 'mean specific force', tuple(tilt), tuple(up_sigma))
    return Mounting(_default_heading(up), np.array([*up_sigma[::-1], UNKNOWN_YAW_SIGMA]), level=(level,),
                    bias=_bias(rests.mean(axis=0) if len(rests) else gravity * up, up, gravity), bias_sigma=BIAS_SIGMA)


def _assemble(motion: _Motion, rests, up, gravity) -> Mounting:
    """The mounting from all evidence."""
    axes = _axes(up, _default_heading(up)[0])
    for _ in range(3):  # angles are small about the axes found before
        heading, yaw, yaw_sigma = _heading(motion, axes)
        axes = _axes(axes[2], axes.T @ [math.cos(yaw), math.sin(yaw), 0.0])
        level, tilt, up_sigma = _level(motion, rests, axes, gravity)
        axes = _axes(axes.T @ [*tilt, 1.0], axes[0])
    if yaw_sigma > SHOWN:
        axes, yaw_sigma, heading = _default_heading(axes[2]), UNKNOWN_YAW_SIGMA, ()
    return Mounting(
        rotation=axes, sigma=np.array([up_sigma[1], up_sigma[0], yaw_sigma]), level=tuple(level),
        heading=tuple(heading), bias=_bias(motion.fit.solution[_UP], axes[2], gravity),
        bias_sigma=gravity * float(up_sigma.max()), imu=_imu_arm(motion, axes), gain=motion.gain,
        driven=float(np.ptp(motion.spans.time[motion.moving])), turned=_turned(motion), spans=motion.spans)


def _axes(up: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Rotation whose rows are forward, left and up, with `up` as given and `forward` near to what is given."""
    up = up / np.linalg.norm(up)
    forward = forward - (forward @ up) * up
    forward = forward / np.linalg.norm(forward)
    return np.array([forward, np.cross(up, forward), up])


def _default_heading(up: np.ndarray) -> np.ndarray:
    """The rotation with that up axis and yaw 0: the sensor's x axis forward, or its z axis where x is upright."""
    return _axes(up, np.eye(3)[0] if abs(up[0]) < 0.99 else np.eye(3)[2] * -np.sign(up[0]))


def _heading(motion: _Motion, axes):
    """Evidence for the yaw about the axes, the yaw and its sigma, rad."""
    ways = []
    if np.percentile(np.abs(motion.spans.speed), 90) < _CLEAR * motion.slowest:
        return ways, 0.0, math.inf  # what counts as motion is mostly noise of the fixes
    for source, index, turn in (('changes of speed', _FORWARD, np.eye(3)), ('turns', _RIGHT, _QUARTER),
                                ('grades', _GRADE, np.eye(3))):
        def angle(vectors, towards=0.0):
            x, y, _ = turn @ axes @ vectors[index]
            return math.remainder(math.atan2(y, x) - towards, 2 * math.pi)

        # on a straight road its slopes look like a turn, and heights may have nothing to do with it
        if index != _FORWARD and not _SMALLEST_GAIN < np.linalg.norm(motion.fit.solution[index]) < _LARGEST_GAIN:
            continue
        seen = angle(motion.fit.solution)
        sigma = math.hypot(motion.sigma(lambda vectors: angle(vectors, seen), index), AXES_SIGMA)
        if index == _GRADE:
            sigma = math.hypot(sigma, _bank_beside_grades(motion))
        if sigma < _USABLE:
            ways.append(Evidence(source, (seen,), (sigma,)))
    if not ways:
        return ways, 0.0, math.inf
    best = min(ways, key=lambda way: way.sigma).angle[0]
    away = np.array([math.remainder(way.angle[0] - best, 2 * math.pi) for way in ways])
    yaw, sigma = weighted(away, np.array([way.sigma[0] for way in ways]))
    return ways, best + float(yaw), float(sigma)


def _bank_beside_grades(motion: _Motion) -> float:
    """Standard deviation, rad, of the yaw from grades, by banks of the road that correlate with the grades by chance.
    Both stay the same for _SLOPE_LASTS, so a short drive has few of them, which the jackknife does not see."""
    spread = np.nanstd(motion.spans.grade[motion.moving])
    return SLOPE_SIGMA / max(spread, 1e-6) / math.sqrt(_slopes(motion))


def _slopes(motion: _Motion) -> float:
    """Number of different slopes (of _SLOPE_LASTS each) on the drive, at least one."""
    speed, time = np.abs(motion.spans.speed[motion.moving]), motion.spans.time[motion.moving]
    way = float(speed[1:] @ np.minimum(np.diff(time), motion.spans.length))
    return max(way / _SLOPE_LASTS, 1.0)


def _level(motion: _Motion, rests, axes, gravity):
    """Evidence for the up axis as its tilt forward and to the left, the tilt and its sigma, rad."""
    def tilt(vector):
        x, y, z = axes @ vector
        return np.array([x, y]) / z

    ways = []
    if np.linalg.norm(motion.fit.solution[_UP]) > 0.5 * gravity:
        sigma = np.hypot(motion.sigma(lambda vectors: tilt(vectors[_UP])), _unseen_slope(motion, axes))
        ways.append(Evidence('gravity in motion', tuple(tilt(motion.fit.solution[_UP])), tuple(sigma)))
        if len(rests):
            sigma = SLOPE_SIGMA / math.sqrt(len(rests))
            ways.append(Evidence('gravity at rest', tuple(np.mean([tilt(r) for r in rests], axis=0)), (sigma, sigma)))
        mean, sigma = weighted(np.array([way.angle for way in ways]), np.array([way.sigma for way in ways]))
        gravitational = mean, np.hypot(sigma, BIAS_SIGMA / gravity)
    else:
        gravitational = np.zeros(2), np.full(2, UNKNOWN_YAW_SIGMA)
    seen, sigma = _axis_of_turns(motion, axes)
    ways.append(Evidence('axis of the turns', tuple(seen), tuple(sigma)))
    information = 1.0 / np.array([gravitational[1], sigma]) ** 2
    mean = (information * [gravitational[0], seen]).sum(axis=0) / information.sum(axis=0)
    return ways, mean, information.sum(axis=0) ** -0.5


def _confirmed(motion: _Motion, axes) -> float:
    """Factor on the grades in the fit, 0 to 1: how much of the grades by heights the specific force along the forward
    axis confirms. Heights that wander under a slow vehicle, or jump, have nothing to do with the road."""
    return float(np.clip(axes[0] @ motion.fit.solution[_GRADE], 0.0, 1.0))


def _unseen_slope(motion: _Motion, axes) -> float:
    """Standard deviation, rad, of the up axis by a mean slope of the drive that heights do not show. The jackknife does
    not see a slope that is the same on the whole drive."""
    seen = np.isfinite(motion.spans.grade[motion.moving]).mean() * _confirmed(motion, axes)
    return (1.0 - float(seen)) * SLOPE_SIGMA / math.sqrt(_slopes(motion))


def _axis_of_turns(motion: _Motion, axes):
    """Tilt of the axis about which the vehicle turns, and its sigma."""
    rate, weight = motion.spans.rate[motion.moving] @ axes.T, motion.fit.weight
    design = np.column_stack([rate[:, 2], np.ones(len(rate))])
    turns = fit(design, rate[:, :2], np.array([1e6, 1e6]), motion.block)
    grade = np.nan_to_num(motion.spans.grade[motion.moving])
    squared = weight * rate[:, 2] ** 2
    # on a winding climb the vertical lies ahead of the up axis; gyroscopes without noise may show no turn at all
    climbing = _confirmed(motion, axes) * float(squared @ grade / max(squared.sum(), np.finfo(float).tiny))
    angles = _turned(motion) / (math.pi / 2)
    sigma = np.hypot(jackknife(turns.left_out)[0], math.hypot(AXES_SIGMA, TURN_TILT_SIGMA / math.sqrt(
        max(angles, 1e-3))))
    return turns.solution[0] - np.array([climbing, 0.0]), sigma


def _turned(motion: _Motion) -> float:
    """Sum of all turns, rad."""
    turn, time = np.abs(motion.spans.turn[motion.moving]), motion.spans.time[motion.moving]
    return float((turn[1:] * np.minimum(np.diff(time), motion.spans.length)).sum())


def _bias(force, up, gravity) -> np.ndarray:
    """(3,) m/s^2, `force` minus gravity."""
    return force - gravity * up if np.linalg.norm(force) > 0.5 * gravity else np.asarray(force)


def _imu_arm(motion: _Motion, axes) -> tuple[float, float]:
    """How far the IMU is ahead of the rear axle, and sigma, m."""
    ways = [(-axes[1], _TURN_CHANGE), (-axes[0], _TURN_SQUARED)]
    arms = [axis @ motion.fit.solution[index] for axis, index in ways]
    sigmas = [math.hypot(float(motion.sigma(lambda vectors: axis @ vectors[index])), 0.05) for axis, index in ways]
    arm, sigma = weighted(np.array(arms), np.array(sigmas))
    return float(arm), float(min(sigma, _ARM_SIGMA))
