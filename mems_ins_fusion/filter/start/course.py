"""The first heading from the way between two fixes, and what the inertial sensors say of that way."""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..config import FilterConfig
from ..trust.receiver import LASTING_TIME
from .start import UNKNOWN_TILT_SIGMA, Standstill

COURSE_SIGMA = 0.1  # rad: a course must be known to this, one sigma, before the filter starts from it
FASTEST = 70.0  # m/s: no land vehicle is faster
FASTEST_REVERSE = 3.0  # m/s: none starts faster backwards; where it seems to, the IMU is mounted the other way round
SHORTEST_COURSE = 1.0  # m, between the two fixes that a course is taken from
LONGEST_COURSE_TIME = 60.0  # s between them: for longer the biases of the inertial sensors are not small
SLOWEST_START = 0.5  # m/s: a course of a slower vehicle is that of the fixes' errors
SIDESLIP_SIGMA = 0.02  # rad: between where a car points and where it goes
LARGEST_YAW_SIGMA = 0.5  # rad: the filter's equations are linear in the heading's error
FEWEST_BETWEEN = 3  # fixes between the two ends of a course that does not begin at a standstill
LONGEST_START = 12.0  # s after a standstill for which the biases that it has shown hold
LARGEST_START_TURN = 0.7  # rad: one that has turned by more since the standstill shows no direction of driving off
MOVED_OFF = 0.2  # m/s, sigma of the velocity at the end of a standstill
LARGEST_TURN = 1.0  # rad: the way of a vehicle that turns by more between two fixes is not their chord
BENT = 0.6  # chord over length of the most bent way that a course is looked for on
KNOT = 4.0  # s between the knots of the piecewise linear speed that is fitted to a bent way
PICKED_UP = 8.0  # m/s, sigma of its change from one knot to the next
FEWEST_ON_WAY = 10  # fixes that a bent way needs
MISFIT = 3.0  # a bent way with a sum of squares this many times the expected one is not the vehicle's


class Course(NamedTuple):
    """Heading and speed at the newest fix, rad and m/s, with their sigmas."""

    yaw: float
    speed: float
    yaw_sigma: float
    speed_sigma: float


class Refused(ValueError):
    """The fixes show a course that cannot be; says what is waited for."""


class Contradicted(Refused):
    """What comes is not what the parameters say it is, and waiting will not change that."""


class _Motion(NamedTuple):
    """What the inertial sensors saw between two times, in the body axes of the first, and sigmas of their biases."""

    turn: float
    gained: np.ndarray  # (2,) velocity
    moved: np.ndarray  # (2,) displacement that the specific force adds
    bias_f: float
    bias_w: float


def has_moved(positions: np.ndarray, white: float = 1.0) -> bool:
    """Whether the fixes (k, 4: time, north, east, sigma) are far enough apart for a course, before all is looked at.

    white: as for `find_course`."""
    recent = positions[positions[:, 0] > positions[-1, 0] - LONGEST_COURSE_TIME]
    moved = np.hypot(*(recent[:, 1:3] - recent[-1, 1:3]).T).max()
    return moved > max(SHORTEST_COURSE, BENT * math.sqrt(white) * recent[-1, 3] / COURSE_SIGMA)


def find_course(imu: np.ndarray, positions: np.ndarray, standstill: Standstill | None,
                config: FilterConfig, white: float = 1.0) -> Course | None:
    """The course from the chord of the newest fix to an earlier one; None if not yet. Raises Refused.

    imu, positions as for `at_rest.latest_standstill`. The inertial sensors tell how the vehicle turned and changed
    speed on the way: with s the speed at the chord's begin and D the displacement that the specific force adds in the
    body axes of then, the chord is C(yaw) ([s T, 0] + D), which gives both s and yaw. No sideslip is assumed.
    """
    now, north, east, sigma = positions[-1]
    refused = None
    if standstill is not None:
        positions = _since(positions, standstill)
    for i in range(len(positions) - 2, -1, -1):
        time, n, e, s = positions[i]
        chord = np.array([north - n, east - e])
        if now - time > LONGEST_COURSE_TIME:
            break
        distance, interval = float(np.hypot(*chord)), now - time
        if interval <= 0:
            continue
        variance = white * (sigma**2 + s**2) + _wandered(config, interval)
        noise = math.sqrt(variance - (1.0 - white) * (sigma**2 + s**2) * math.expm1(-interval / LASTING_TIME))
        if distance >= max(SHORTEST_COURSE, noise / COURSE_SIGMA):
            if standstill is not None:
                return (_of_chord(imu, chord, time, now, noise, standstill, config)
                        or _of_bent_way(imu, positions, standstill, config))
            # one fix far off must not pass for a drive: those in between have to lie on the way
            try:
                found = _of_chord(imu, chord, time, now, noise, None, config, positions[i + 1:-1] - [0.0, n, e, 0.0])
            except Refused as reason:
                refused = refused or reason
                continue
            if found is not None:
                return found
    if refused is not None:
        raise refused
    return _of_bent_way(imu, positions, standstill, config)


def _of_bent_way(imu, positions, standstill, config) -> Course | None:
    """The course of a vehicle that never goes straight on for long: what heading and speeds fit the fixes best.

    With the turn t(tau) that the gyroscope shows from tau to the newest fix, and as complex numbers north + i east, the
    vehicle was at p - e^(i yaw) int s(tau) e^(-i t(tau)) dtau. Turned back by the yaw that is linear in p and in the
    speeds s at the knots: one matrix for all headings. What it leaves is a quadratic form of (cos yaw, sin yaw), so
    m - r cos 2 (yaw - yaw_0): the least and its curvature 4 r in closed form, yaw and yaw + pi (backwards) alike.
    """
    now = positions[-1, 0]
    since = now - LONGEST_COURSE_TIME if standstill is None else max(now - LONGEST_COURSE_TIME, standstill.end)
    fixes = positions[positions[:, 0] >= max(since, imu[0, 0])]
    part = imu[(imu[:, 0] >= since) & (imu[:, 0] <= now)]
    if len(fixes) < FEWEST_ON_WAY or len(part) < 3 or fixes[-1, 0] - fixes[0, 0] < 2.0 * KNOT:
        return None
    # fixes closer together than a second err alike, and all as far as their error lasts
    duration = fixes[-1, 0] - fixes[0, 0]
    variance = max(1.0, len(fixes) / duration) * fixes[:, 3] ** 2
    if config.gnss.coloured:
        variance += 2.0 * config.gnss.coloured.tau * len(fixes) / duration * config.gnss.coloured.sigma**2
    sigma = np.sqrt(variance)
    knots = np.linspace(fixes[0, 0], now, 1 + math.ceil(duration / KNOT))
    design, turned, bias = _way_of_knots(part, fixes[:, 0], knots, standstill, config)
    if turned < LARGEST_TURN:
        return None
    k = len(knots)
    rows = np.zeros((2 * len(fixes) + k - 1, 2 + k))
    rows[:len(fixes), 0] = rows[len(fixes):2 * len(fixes), 1] = 1.0 / sigma
    rows[:2 * len(fixes), 2:] = np.concatenate([design.real, design.imag]) / np.tile(sigma, 2)[:, None]
    rows[2 * len(fixes):, 2:] = np.diff(np.eye(k), axis=0) / PICKED_UP
    q, triangle = np.linalg.qr(rows)
    measured = (fixes[:, 1] + 1j * fixes[:, 2] - fixes[-1, 1] - 1j * fixes[-1, 2]) / sigma
    back = np.zeros((2, len(rows)))  # turned by a heading of 0 and of pi / 2
    back[:, :2 * len(fixes)] = [np.concatenate([z.real, z.imag]) for z in (measured, -1j * measured)]
    left = back - back @ q @ q.T
    (a, b), (_, c) = left @ left.T
    r = math.hypot(0.5 * (a - c), b)
    if 0.5 * (a + c) - r > MISFIT * 2.0 * len(fixes) or r < 0.5 / COURSE_SIGMA**2:
        return None
    yaw = 0.5 * math.atan2(-b, -0.5 * (a - c))
    inverse = np.linalg.inv(triangle)
    speeds = (inverse @ (q.T @ (math.cos(yaw) * back[0] + math.sin(yaw) * back[1])))[2:]
    speed_sigma = float(np.linalg.norm(inverse[2:], axis=1)[-1])
    way = _way(imu, now, standstill, speeds[-1], -speeds[-1], speed_sigma, config) if abs(speeds[-1]) > 0 else 0
    if standstill is None or now - standstill.end > LONGEST_COURSE_TIME:
        way = 1 if speeds.sum() > 0 else -1  # in most of the time a vehicle drives forwards
    # no better than by two fixes and a chord as long: what the receiver's errors have in common does not show
    length, noise = (float(0.5 * abs(speeds[1:] + speeds[:-1]) @ np.diff(knots)),
                     math.sqrt(2.0) * float(fixes[:, 3].max()))
    yaw_sigma = math.sqrt(max(0.5 / r, (noise / max(length, 1e-3)) ** 2) + (0.5 * bias * duration) ** 2
                          + SIDESLIP_SIGMA**2)
    if (way == 0 or length < max(SHORTEST_COURSE, noise / COURSE_SIGMA) or not SLOWEST_START < abs(speeds[-1])
            or abs(speeds).max() > FASTEST or way * speeds[-1] < -FASTEST_REVERSE or yaw_sigma > LARGEST_YAW_SIGMA):
        return None
    return Course(yaw if way > 0 else yaw + math.pi, way * speeds[-1], yaw_sigma, speed_sigma)


def _way_of_knots(part, times, knots, standstill, config) -> tuple[np.ndarray, float, float]:
    """Displacement at `times` (f,) against now for 1 m/s at each of the knots (k,), heading 0 now: (f, k), complex.
    And by how much it turned (the range of headings, rad), and the sigma of the turn rate, rad/s."""
    rate, bias = part[:, 6], config.alignment.gyroscope_turn_on
    if standstill is not None:
        rate, bias = rate - standstill.angular_rate[2], 1e-3
    dt = np.diff(part[:, 0], prepend=part[0, 0])
    turn = np.cumsum(rate * dt)
    heading = np.exp(1j * (turn - turn[-1]))
    shape = np.array([np.interp(part[:, 0], knots, one) for one in np.eye(len(knots))]).T
    way = np.cumsum(shape * (heading * dt)[:, None], axis=0)
    way -= way[-1]
    at = np.clip(np.searchsorted(part[:, 0], times), 0, len(part) - 1)
    return way[at], float(np.ptp(turn)), bias


def _since(positions: np.ndarray, standstill: Standstill) -> np.ndarray:
    """The fixes from the end of a standstill on, those at rest as one: their median, as one may be far off."""
    later = positions[positions[:, 0] > standstill.end]
    at_rest = positions[(positions[:, 0] > standstill.end - standstill.duration) & (positions[:, 0] <= standstill.end)]
    if not len(at_rest):
        return later
    place = [standstill.end, *np.median(at_rest[:, 1:3], axis=0), at_rest[:, 3].mean()]
    return np.concatenate([[place], later])


def driven_off(imu: np.ndarray, positions: np.ndarray, standstill: Standstill,
               config: FilterConfig) -> tuple[float, float] | None:
    """Which way a vehicle drove off after `standstill`: angle to the right of its body's forward axis (rad) and speed.

    None where IMU and fixes do not show the same way, or not yet. Arguments as for `find_course`.
    """
    way_driven = _since(positions[positions[:, 0] <= standstill.end + LONGEST_START], standstill)
    if not len(way_driven) or way_driven[0, 0] > standstill.end:
        return None
    begin, found = way_driven[0, 1:3], None
    for time, north, east, sigma in way_driven[1:]:
        motion, interval = inertial_motion(imu, standstill.end, time, standstill, config), time - standstill.end
        if motion is None or abs(motion.turn) > LARGEST_START_TURN:
            continue
        way = math.hypot(north - begin[0], east - begin[1])
        uncertain = sigma + 0.5 * motion.bias_f * interval**2
        shown = math.hypot(*motion.moved)
        if shown > 5.0 * uncertain and abs(shown - way) < 2.0 * uncertain + 0.2 * shown:
            found = math.atan2(motion.moved[1], motion.moved[0]), math.hypot(*motion.gained)
    return found


def _of_chord(imu, chord, time, now, noise, standstill, config, between=None) -> Course | None:
    """between: fixes as rows of time, north, east from the chord's begin, sigma, where they have to agree."""
    motion = inertial_motion(imu, time, now, standstill, config)
    distance, interval = float(np.hypot(*chord)), now - time
    if motion is None or abs(motion.turn) > LARGEST_TURN or abs(motion.moved[1]) > 0.5 * distance:
        return None
    speed_sigma = math.hypot(noise / interval, 0.5 * motion.bias_f * interval)
    forward = math.sqrt(distance**2 - motion.moved[1] ** 2)
    way = _way(imu, time, standstill, (forward - motion.moved[0]) / interval, (-forward - motion.moved[0]) / interval,
               speed_sigma, config)
    if way == 0:
        return None
    forward *= way
    speed = (forward - motion.moved[0]) / interval
    last = speed + motion.gained[0]
    yaw_sigma = math.sqrt((noise / distance) ** 2 + (motion.bias_w * interval / 2) ** 2
                          + (0.5 * motion.bias_f * interval**2 / distance) ** 2 + SIDESLIP_SIGMA**2)
    if abs(speed) > FASTEST:
        raise Contradicted(f'believable fixes: they move at {abs(speed):.0f} m/s')
    if way < 0 and abs(last) > FASTEST_REVERSE:
        raise Contradicted(f'the vehicle to drive forwards: it seems to go backwards at {abs(last):.1f} m/s; if it '
                           'does not, the IMU is mounted the other way round: turn the yaw of imu.mounting_rpy by pi')
    if abs(last) < SLOWEST_START or yaw_sigma > LARGEST_YAW_SIGMA:
        return None
    yaw = math.atan2(chord[1], chord[0]) - math.atan2(motion.moved[1], forward)
    if between is not None and not _on_the_way(imu, between, time, now, yaw, speed, noise, config):
        return None
    return Course(yaw + motion.turn, math.copysign(math.hypot(last, motion.gained[1]), last), yaw_sigma, speed_sigma)


def _on_the_way(imu, between, time, now, yaw, speed, noise, config) -> bool:
    """Whether of the fixes between the ends of a chord more than half lie where it was driven; with too few: no, as a
    receiver that smooths makes of one fix far off two or three that look like a drive."""
    if len(between) < FEWEST_BETWEEN:
        return False
    agreeing = 0
    for at, north, east, sigma in between:
        motion = inertial_motion(imu, time, at, None, config)
        moved = np.array([speed * (at - time), 0.0]) + (motion.moved if motion is not None else 0.0)
        c, s = math.cos(yaw), math.sin(yaw)
        off = math.hypot(north - c * moved[0] + s * moved[1], east - s * moved[0] - c * moved[1])
        bent = 0.5 * UNKNOWN_TILT_SIGMA * 9.8 * (at - time) * (now - at)  # by what tilt passes for acceleration
        agreeing += off < 3.0 * math.sqrt(noise**2 + sigma**2 + bent**2)
    return 2 * agreeing > len(between)


def _wandered(config, interval: float) -> float:
    """Variance of how far the receiver's coloured error has gone within `interval` s, m^2, one axis."""
    if not config.gnss.coloured:
        return 0.0
    return -2.0 * config.gnss.coloured.sigma**2 * math.expm1(-interval / config.gnss.coloured.tau)


def _way(imu, time, standstill, forwards, backwards, sigma, config) -> int:
    """1 forwards, -1 backwards, 0 unclear: which speed at `time` fits the accelerometers since it stood."""
    if standstill is None:
        return 1
    since = time - standstill.end
    motion = inertial_motion(imu, standstill.end, time, standstill, config)
    expected = 0.0
    if motion is not None:
        expected = math.cos(motion.turn) * motion.gained[0] + math.sin(motion.turn) * motion.gained[1]
    variance = sigma**2 + (MOVED_OFF + 0.1 * since) ** 2
    if since < LONGEST_COURSE_TIME and min(abs(forwards - expected), abs(backwards - expected)) > (
            5.0 * math.sqrt(variance) + 1.0):
        return 0  # the fixes move, the IMU does not
    difference = (forwards - expected) ** 2 - (backwards - expected) ** 2
    if abs(difference) < 9 * variance:  # after long it tells nothing: forwards, then, as most vehicles drive
        return 1 if since > LONGEST_COURSE_TIME else 0
    return 1 if difference < 0 else -1


def inertial_motion(imu, begin, end, standstill, config) -> _Motion | None:
    """What samples (n, 7 or more: time, f, w in body axes) saw between two times; None where there are too few."""
    part = imu[(imu[:, 0] > begin) & (imu[:, 0] <= end)]
    if len(part) < 3:
        return None
    force, rate = part[:, 1:3].copy(), part[:, 6].copy()
    bias_f, bias_w = UNKNOWN_TILT_SIGMA * 9.8, config.alignment.gyroscope_turn_on
    if standstill is not None:
        rate -= standstill.angular_rate[2]
        force -= standstill.specific_force[:2]
        bias_f, bias_w = 0.1, 1e-3
    dt = np.diff(part[:, 0], prepend=begin)
    yaw = np.cumsum(rate * dt)
    c, s = np.cos(yaw), np.sin(yaw)
    level = np.stack([c * force[:, 0] - s * force[:, 1], s * force[:, 0] + c * force[:, 1]])
    velocity = np.cumsum(level * dt, axis=1)
    return _Motion(float(yaw[-1]), velocity[:, -1], (velocity * dt).sum(axis=1), bias_f, bias_w)
