"""The first heading and speed, from the displacement between fixes and the motion by the inertial sensors.

A *chord* is the straight line between two fixes.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..config import FilterConfig
from ..trust.new_start import LARGEST_YAW_SIGMA
from ..trust.receiver import LASTING_TIME
from .start import KNOWN_FORCE_SIGMA, KNOWN_RATE_SIGMA, UNKNOWN_TILT_FORCE, Standstill

CHORD_SIGMA = 0.1  # rad, largest noise over length of a chord from which a course is computed. Chosen, not measured
FASTEST = 70.0  # m/s, largest speed of a land vehicle
FASTEST_REVERSE = 3.0  # m/s: no vehicle starts faster in reverse
SHORTEST_COURSE = 1.0  # m, shortest chord
LONGEST_COURSE_TIME = 60.0  # s, longest chord in time: over longer times the biases of the inertial sensors are large
SLOWEST_START = 0.2  # m/s: at a lower speed a chord of a minute is no longer than body and antenna sway
#: m/s, standard deviation of velocity components at the start, besides that of speed and heading
START_VELOCITY_SIGMA = 0.05
SIDESLIP_SIGMA = 0.02  # rad, standard deviation of the angle between the heading of a car and its course
CHORD_STEP = 1.1  # factor between the times of chords that are tried: closer ones have nearly the same information
#: number of fixes, evenly spaced, that are tested between the ends of a chord: more take time without a better decision
MOST_BETWEEN = 20
FEWEST_BETWEEN = 3  # number of fixes needed between the ends of a chord that does not begin at a standstill
LONGEST_START = 12.0  # s after a standstill for which the biases found there are used. Chosen, not measured
#: rad: after a larger turn since the standstill, the direction of driving off is not determined. Chosen, not measured
LARGEST_START_TURN = 0.7
MOVED_OFF = 0.2  # m/s, standard deviation of the velocity at the end of a standstill
#: if the speed by the fixes, forwards and backwards, differs by more than this many standard deviations from that by
#: the accelerometers, neither direction is used: the fixes move while the vehicle stands
NEITHER_SIGMAS = 5.0
NEITHER_SPEED = 1.0  # m/s by which it has to differ besides: errors of the fixes that their sigmas do not contain
#: difference of the squared normalized residuals by which one direction has to fit the accelerometers better: 3 sigma
DIRECTION_CERTAIN = 9.0
LARGEST_TURN = 1.0  # rad, largest turn within a chord; after a larger turn a curved path is fitted
BENT = 0.6  # smallest chord over path length of a curved path that is tried. Chosen, not measured
KNOT = 4.0  # s between the knots of the piecewise linear speed that is fitted to a curved path
PICKED_UP = 8.0  # m/s, standard deviation of the change of this speed from one knot to the next: 2 m/s^2
FEWEST_ON_PATH = 10  # number of fixes needed for a curved path
PATH_MISFIT = 3.0  # largest sum of squared residuals over its expectation for a curved path. Chosen, not measured


class Course(NamedTuple):
    """Heading and speed at the newest fix, rad and m/s, with their sigmas."""

    yaw: float
    speed: float
    yaw_sigma: float
    speed_sigma: float


class Refused(ValueError):
    """There is no start yet; the text names what is awaited."""


class Contradicted(Refused):
    """There is no start because the inputs contradict the parameters, so that waiting does not help."""


class Backwards(Contradicted):
    """There is no start because the vehicle seems to go backwards. One that does, and one whose IMU is mounted
    backwards, are the same until it drives forwards."""


#: what is waited for then, with the verb for what the vehicle does
BACKWARDS = 'the vehicle to drive forwards: it {} backwards; if not, turn the yaw of imu.mounting_rpy by pi'


class _Motion(NamedTuple):
    """Motion by the inertial sensors between two times, in the body axes of the first."""

    turn: float  # rad
    gained: np.ndarray  # (2,) change of velocity, m/s
    moved: np.ndarray  # (2,) displacement due to the specific force, m
    bias_f: float  # standard deviation of the bias of the specific force, m/s^2,
    bias_w: float  # and of the turn rate, rad/s


def has_moved(positions: np.ndarray, white: float = 1.0) -> bool:
    """Whether the fixes (k, 4: time, north, east, sigma) are far enough apart for a course: a quick test before
    `find_course`. white: as for `find_course`."""
    recent = positions[positions[:, 0] > positions[-1, 0] - LONGEST_COURSE_TIME]
    moved = np.hypot(*(recent[:, 1:3] - recent[-1, 1:3]).T).max()
    return moved > max(SHORTEST_COURSE, BENT * math.sqrt(white) * recent[-1, 3] / CHORD_SIGMA)


def find_course(imu: np.ndarray, positions: np.ndarray, standstill: Standstill | None,
                config: FilterConfig, white: float = 1.0, is_forwards: bool = False) -> Course | None:
    """The course from the chord between the newest fix and an earlier one; None while no chord is good enough.

    Raises Refused, Contradicted or Backwards.

    imu, positions: as for `at_rest.latest_standstill`. white: share of the variance of the fixes that is white noise.
    is_forwards: whether the vehicle is known to move along the forward axis where it is fast
    (`plausibility.direction_in_motion`).
    The inertial sensors give turn and change of speed: with s the speed at the beginning of the chord and D the
    displacement due to the specific force in the body axes of that time, the chord is C(yaw) ([s T, 0] + D), which
    gives both s and yaw. No sideslip is assumed.
    """
    now, north, east, sigma = positions[-1]
    refused, tried = None, 0.0
    if standstill is not None:
        positions = _since(positions, standstill)
    for i in range(len(positions) - 2, -1, -1):
        time, n, e, s = positions[i]
        chord = np.array([north - n, east - e])
        if now - time > LONGEST_COURSE_TIME:
            break
        distance, interval = float(np.hypot(*chord)), now - time
        if interval <= CHORD_STEP * tried:
            continue
        variance = white * (sigma**2 + s**2) + _wandered(config, interval)
        noise = math.sqrt(variance - (1.0 - white) * (sigma**2 + s**2) * math.expm1(-interval / LASTING_TIME))
        if distance >= max(SHORTEST_COURSE, noise / CHORD_SIGMA):
            # an outlier must not count as motion: the fixes in between have to lie on the path
            between = positions[i + 1:-1] - [0.0, n, e, 0.0]
            if standstill is not None:
                return (_of_chord(imu, chord, time, now, noise, between, standstill, config, is_forwards)
                        or _of_curved_path(imu, positions, standstill, config, is_forwards))
            tried = interval
            try:
                found = _of_chord(imu, chord, time, now, noise, between, None, config, is_forwards)
            except Refused as reason:
                refused = refused or reason
                continue
            if found is not None:
                return found
    if refused is not None:
        raise refused
    return _of_curved_path(imu, positions, standstill, config, is_forwards)


def _of_curved_path(imu, positions, standstill, config, is_forwards) -> Course | None:
    """The course of a vehicle that never goes straight for long: least squares of heading and speeds to the fixes.

    With the turn t(tau) that the gyroscope shows from tau to the newest fix, and as complex numbers north + i east, the
    vehicle was at p - e^(i yaw) int s(tau) e^(-i t(tau)) dtau. Rotated by -yaw this is linear in p and in the speeds s
    at the knots, with one design matrix for all headings. The sum of squared residuals is a quadratic form of
    (cos yaw, sin yaw), m - r cos 2 (yaw - yaw_0): minimum and curvature 4 r in closed form, ambiguous by pi (reverse).
    """
    now = positions[-1, 0]
    since = now - LONGEST_COURSE_TIME if standstill is None else max(now - LONGEST_COURSE_TIME, standstill.end)
    fixes = positions[positions[:, 0] >= max(since, imu[0, 0])]
    part = imu[(imu[:, 0] >= since) & (imu[:, 0] <= now)]
    if len(fixes) < FEWEST_ON_PATH or len(part) < 3 or fixes[-1, 0] - fixes[0, 0] < 2.0 * KNOT:
        return None
    # fixes within a second have about the same error
    duration = fixes[-1, 0] - fixes[0, 0]
    variance = max(1.0, len(fixes) / duration) * fixes[:, 3] ** 2 + len(fixes) * _bent(config, duration)
    sigma = np.sqrt(variance)
    knots = np.linspace(fixes[0, 0], now, 1 + math.ceil(duration / KNOT))
    design, turned, bias = _path_of_knots(part, fixes[:, 0], knots, standstill, config)
    if turned < LARGEST_TURN:
        return None
    k = len(knots)
    rows = np.zeros((2 * len(fixes) + k - 1, 2 + k))
    rows[:len(fixes), 0] = rows[len(fixes):2 * len(fixes), 1] = 1.0 / sigma
    rows[:2 * len(fixes), 2:] = np.concatenate([design.real, design.imag]) / np.tile(sigma, 2)[:, None]
    rows[2 * len(fixes):, 2:] = np.diff(np.eye(k), axis=0) / PICKED_UP
    q, triangle = np.linalg.qr(rows)
    measured = (fixes[:, 1] + 1j * fixes[:, 2] - fixes[-1, 1] - 1j * fixes[-1, 2]) / sigma
    back = np.zeros((2, len(rows)))  # the fixes rotated by a heading of 0 and of pi / 2
    back[:, :2 * len(fixes)] = [np.concatenate([z.real, z.imag]) for z in (measured, -1j * measured)]
    left = back - back @ q @ q.T
    (a, b), (_, c) = left @ left.T
    r = math.hypot(0.5 * (a - c), b)
    if 0.5 * (a + c) - r > PATH_MISFIT * 2.0 * len(fixes) or r < 0.5 / CHORD_SIGMA**2:
        return None
    yaw = 0.5 * math.atan2(-b, -0.5 * (a - c))
    inverse = np.linalg.inv(triangle)
    speeds = (inverse @ (q.T @ (math.cos(yaw) * back[0] + math.sin(yaw) * back[1])))[2:]
    speed_sigma = float(np.linalg.norm(inverse[2:], axis=1)[-1])
    sign = 0
    if abs(speeds[-1]) > 0:
        sign = _direction(imu, now, standstill, speeds[-1], -speeds[-1], speed_sigma, config, is_forwards)
    if standstill is None or now - standstill.end > LONGEST_COURSE_TIME:
        sign = 1 if speeds.sum() > 0 else -1  # the solution is ambiguous by half a turn: assume forward motion
    # at best as accurate as a chord of the same length: common errors of the fixes do not show in the residuals
    length, noise = (float(0.5 * abs(speeds[1:] + speeds[:-1]) @ np.diff(knots)),
                     math.sqrt(2.0) * float(fixes[:, 3].max()))
    yaw_sigma = math.sqrt(max(0.5 / r, (noise / max(length, 1e-3)) ** 2) + (0.5 * bias * duration) ** 2
                          + SIDESLIP_SIGMA**2)
    if (sign == 0 or length < max(SHORTEST_COURSE, noise / CHORD_SIGMA) or not SLOWEST_START < abs(speeds[-1])
            or abs(speeds).max() > FASTEST or sign * speeds[-1] < -FASTEST_REVERSE or yaw_sigma > LARGEST_YAW_SIGMA):
        return None
    return Course(yaw if sign > 0 else yaw + math.pi, sign * speeds[-1], yaw_sigma, speed_sigma)


def _path_of_knots(part, times, knots, standstill, config) -> tuple[np.ndarray, float, float]:
    """Position at `times` (f,) relative to now, for heading 0 now and 1 m/s at each of the knots (k,): (f, k), complex.
    And the range of headings, rad, and the standard deviation of the turn rate's bias, rad/s."""
    rate, bias = part[:, 6], config.alignment.gyroscope_turn_on
    if standstill is not None:
        rate, bias = rate - standstill.angular_rate[2], KNOWN_RATE_SIGMA
    dt = np.diff(part[:, 0], prepend=part[0, 0])
    turn = np.cumsum(rate * dt)
    heading = np.exp(1j * (turn - turn[-1]))
    shape = np.array([np.interp(part[:, 0], knots, one) for one in np.eye(len(knots))]).T
    path = np.cumsum(shape * (heading * dt)[:, None], axis=0)
    path -= path[-1]
    at = np.clip(np.searchsorted(part[:, 0], times), 0, len(part) - 1)
    return path[at], float(np.ptp(turn)), bias


def _since(positions: np.ndarray, standstill: Standstill) -> np.ndarray:
    """The fixes after a standstill, preceded by the median of those during it at its end."""
    later = positions[positions[:, 0] > standstill.end]
    at_rest = positions[(positions[:, 0] > standstill.end - standstill.duration) & (positions[:, 0] <= standstill.end)]
    if not len(at_rest):
        return later
    median = [standstill.end, *np.median(at_rest[:, 1:3], axis=0), at_rest[:, 3].mean()]
    return np.concatenate([[median], later])


def driven_off(imu: np.ndarray, positions: np.ndarray, standstill: Standstill,
               config: FilterConfig) -> float | None:
    """Direction in which the vehicle drove off after `standstill`, rad to the right of the body's forward axis.

    None where IMU and fixes do not show the same distance, or not yet. Arguments as for `find_course`.
    """
    fixes = _since(positions[positions[:, 0] <= standstill.end + LONGEST_START], standstill)
    if not len(fixes) or fixes[0, 0] > standstill.end:
        return None
    begin = fixes[0, 1:3]
    for time, north, east, sigma in fixes[:0:-1]:
        by_fixes, interval = math.hypot(north - begin[0], east - begin[1]), time - standstill.end
        uncertain = sigma + 0.5 * KNOWN_FORCE_SIGMA * interval**2
        if not by_fixes > 2.0 * uncertain:
            continue  # the conditions below cannot both hold; saves the integration for each fix of a slow vehicle
        motion = inertial_motion(imu, standstill.end, time, standstill, config)
        if motion is None or abs(motion.turn) > LARGEST_START_TURN:
            continue
        by_imu = math.hypot(*motion.moved)
        if by_imu > 5.0 * uncertain and abs(by_imu - by_fixes) < 2.0 * uncertain + 0.2 * by_imu:
            return math.atan2(motion.moved[1], motion.moved[0])
    return None


def _of_chord(imu, chord, time, now, noise, between, standstill, config, is_forwards) -> Course | None:
    """The course of a chord (north, east) from `time` to `now` with the noise `noise`, m; None if it is not certain.

    between: fixes that have to lie on the path, rows of time, north, east from the beginning of the chord, sigma.
    """
    motion = inertial_motion(imu, time, now, standstill, config)
    distance, interval = float(np.hypot(*chord)), now - time
    if motion is None or abs(motion.turn) > LARGEST_TURN or abs(motion.moved[1]) > 0.5 * distance:
        return None
    speed_sigma = math.hypot(noise / interval, 0.5 * motion.bias_f * interval)
    forward = math.sqrt(distance**2 - motion.moved[1] ** 2)
    sign = _direction(imu, time, standstill, (forward - motion.moved[0]) / interval,
                      (-forward - motion.moved[0]) / interval, speed_sigma, config, is_forwards)
    if sign == 0:
        return None
    forward *= sign
    speed = (forward - motion.moved[0]) / interval
    last = speed + motion.gained[0]
    yaw_sigma = math.sqrt((noise / distance) ** 2 + (motion.bias_w * interval / 2) ** 2
                          + (0.5 * motion.bias_f * interval**2 / distance) ** 2 + SIDESLIP_SIGMA**2)
    if abs(speed) > FASTEST:
        raise Contradicted(f'possible fixes: they move at {abs(speed):.0f} m/s')
    if abs(last) < SLOWEST_START or yaw_sigma > LARGEST_YAW_SIGMA:
        return None
    yaw = math.atan2(chord[1], chord[0]) - math.atan2(motion.moved[1], forward)
    if not _on_path(imu, between, time, now, yaw, speed, noise, standstill, config):
        return None
    if last < 0.0 and (config.vehicle.lateral_sigma or -last > FASTEST_REVERSE):
        raise Backwards(BACKWARDS.format('seems to go'))
    return Course(yaw + motion.turn, math.copysign(math.hypot(last, motion.gained[1]), last), yaw_sigma, speed_sigma)


def _on_path(imu, between, time, now, yaw, speed, noise, standstill, config) -> bool:
    """Whether more than half of the fixes between the ends of a chord lie on the path.

    False if they are too few, unless the chord begins at a standstill, where the IMU has to show the motion, too: a
    receiver that smooths its positions turns an outlier into two or three fixes that look like motion.
    """
    if not len(between) and standstill is not None:
        return True
    if len(between) < FEWEST_BETWEEN and standstill is None:
        return False
    between, agreeing = between[::math.ceil(len(between) / MOST_BETWEEN)], 0
    for at, north, east, sigma in between:
        motion = inertial_motion(imu, time, at, standstill, config)
        moved = np.array([speed * (at - time), 0.0]) + (motion.moved if motion is not None else 0.0)
        c, s = math.cos(yaw), math.sin(yaw)
        off = math.hypot(north - c * moved[0] + s * moved[1], east - s * moved[0] - c * moved[1])
        bent = 0.5 * UNKNOWN_TILT_FORCE * (at - time) * (now - at)
        agreeing += off < 3.0 * math.sqrt(noise**2 + sigma**2 + bent**2)
    return 2 * agreeing > len(between)


def _wandered(config, interval: float) -> float:
    """Variance of the change of the receiver's coloured error within `interval` s, one axis, m^2."""
    if not config.gnss.coloured:
        return 0.0
    return -2.0 * config.gnss.coloured.sigma**2 * math.expm1(-interval / config.gnss.coloured.tau)


def _bent(config, duration: float) -> float:
    """What the receiver's coloured error does to a path fitted to fixes over `duration` s: as much as white noise of
    this variance, m^2, times the number of fixes, does to the slope of a straight line.

    White noise of the same density where the error changes fast; a random walk where it hardly changes, as an error
    that stays moves the path and turns it by nothing. The smaller of both is within 0.92 and 1.41 of the exact one.
    """
    if not config.gnss.coloured:
        return 0.0
    return min(2.0 * config.gnss.coloured.tau / duration * config.gnss.coloured.sigma**2,
               0.1 * _wandered(config, duration))


def _direction(imu, time, standstill, forwards, backwards, sigma, config, is_forwards) -> int:
    """1 forwards, -1 backwards, 0 unclear: which of two speeds at `time` agrees with the accelerometers since the
    standstill. is_forwards: as for `find_course`."""
    if standstill is None:
        return 1
    if is_forwards and max(forwards, backwards) > FASTEST_REVERSE:
        return 1 if forwards > backwards else -1
    since = time - standstill.end
    motion = inertial_motion(imu, standstill.end, time, standstill, config)
    expected = 0.0
    if motion is not None:
        expected = math.cos(motion.turn) * motion.gained[0] + math.sin(motion.turn) * motion.gained[1]
    variance = sigma**2 + (MOVED_OFF + KNOWN_FORCE_SIGMA * since) ** 2
    if since < LONGEST_COURSE_TIME and min(abs(forwards - expected), abs(backwards - expected)) > (
            NEITHER_SIGMAS * math.sqrt(variance) + NEITHER_SPEED):
        return 0  # the fixes move, the IMU shows no motion
    difference = (forwards - expected) ** 2 - (backwards - expected) ** 2
    if abs(difference) < DIRECTION_CERTAIN * variance:
        # long after the standstill: forwards, as vehicles drive most of the time
        return 1 if since > LONGEST_COURSE_TIME else 0
    return 1 if difference < 0 else -1


def inertial_motion(imu, begin, end, standstill, config) -> _Motion | None:
    """Motion between two times by the samples (n, 7 or more: time, f, w in body axes); None where there are too few."""
    part = imu[slice(*np.searchsorted(imu[:, 0], [begin, end], side='right'))]
    if len(part) < 3:
        return None
    force, rate = part[:, 1:3].copy(), part[:, 6].copy()
    bias_f, bias_w = UNKNOWN_TILT_FORCE, config.alignment.gyroscope_turn_on
    if standstill is not None:
        rate -= standstill.angular_rate[2]
        force -= standstill.specific_force[:2]
        bias_f, bias_w = KNOWN_FORCE_SIGMA, KNOWN_RATE_SIGMA
    dt = np.diff(part[:, 0], prepend=begin)
    yaw = np.cumsum(rate * dt)
    c, s = np.cos(yaw), np.sin(yaw)
    level = np.stack([c * force[:, 0] - s * force[:, 1], s * force[:, 0] + c * force[:, 1]])
    velocity = np.cumsum(level * dt, axis=1)
    return _Motion(float(yaw[-1]), velocity[:, -1], (velocity * dt).sum(axis=1), bias_f, bias_w)


def start_covariance(r: np.ndarray, yaw: float, yaw_sigma: float, speed: float, speed_sigma: float) -> np.ndarray:
    """Covariance (5, 5) of r_n, r_e, v_n, v_e, yaw where the velocity is along the heading. r: (2, 2) of the position.

    An error of the heading is then an error of the velocity, too.
    """
    course = np.array([math.cos(yaw), math.sin(yaw)])
    across = np.array([-course[1], course[0]])
    jacobian = np.zeros((5, 4))
    jacobian[:2, :2] = np.linalg.cholesky(r)
    jacobian[2:4, 2] = course * speed_sigma
    jacobian[2:4, 3] = across * speed * yaw_sigma
    jacobian[4, 3] = yaw_sigma
    return jacobian @ jacobian.T + np.diag([0, 0, *[(START_VELOCITY_SIGMA + SIDESLIP_SIGMA * speed) ** 2] * 2, 0])
