"""How the filter starts by itself: position, gyroscope bias, level and heading from what the first minutes show."""
from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..navigation.earth import gravity, radii
from ..navigation.frames import leveling, wrap, yaw_from_enu, yaw_of_quaternion
from .config import FilterConfig
from .layout import PLANAR, Event

MEMORY = 300.0  # s of samples kept while waiting
STILL_BLOCK = 1.0  # s; a standstill is made of such blocks
SHORTEST_STILL = 3.0  # s
STEADY_ACCELERATION = 0.06  # m/s^2: between the mean of a block and the standstill's
STEADY_RATE = 0.005  # rad/s
COURSE_SIGMA = 0.1  # rad: straightness of course that is good enough to start
LATEST_FIX = 1.0  # s after the newest sample
FASTEST = 70.0  # m/s: no land vehicle is faster
LARGEST_TILT = math.radians(40.0)  # of an IMU whose mounting is as configured, on any road
FASTEST_TURN = 3.0  # rad/s: of the vehicle's mean turn over a second
FASTEST_REVERSE = 3.0  # m/s: who starts faster backwards has the IMU turned round
SHORTEST_COURSE = 1.0  # m
LONGEST_COURSE_TIME = 60.0  # s
SLOWEST_START = 0.5  # m/s
SIDESLIP_SIGMA = 0.02  # rad: between where a car points and where it goes
UNKNOWN_TILT_SIGMA = 0.05  # rad
LARGEST_YAW_SIGMA = 0.5  # rad: the filter's equations are linear in the heading's error
MOVED_OFF = 0.2  # m/s: of a vehicle whose standstill has only just ended
RECEIVER_DRIFT = 0.3  # m/s: positions wander this fast at rest; who is as slow and as quiet shows the same biases
GRAVITY_TOLERANCE = 0.1  # of gravity: more is no sensor's error at rest
STILL_STEPS = 1024  # in which a process that is continuous in time is followed through a standstill


@dataclass
class Start:
    """The first state: where, how fast, which way, and how well that is known."""

    time: float  # s since the epoch
    latitude: float
    longitude: float
    height: float
    velocity: np.ndarray  # (2,) north, east, m/s
    yaw: float
    covariance: np.ndarray  # (5, 5) of r_n, r_e, v_n, v_e, yaw
    standstill: Standstill | None
    notes: list[tuple[str, str]] = field(default_factory=list)  # level and text


@dataclass
class Standstill:
    """What the sensors showed at rest, body axes: means over `duration` seconds that ended at `end`."""

    end: float
    duration: float
    specific_force: np.ndarray
    angular_rate: np.ndarray


class Alignment:
    """Collects samples and fixes until there is enough to start. Times are seconds since the filter's epoch."""

    def __init__(self, config: FilterConfig):
        self.config = config
        self.waiting_for = 'IMU samples'
        self._imu = np.empty((1024, 13))  # time, body-axis f and w, raw f and w
        self._count = 0
        self._orientation: np.ndarray | None = None
        self._fixes: list[tuple] = []

    def add_samples(self, samples: np.ndarray, orientation=None) -> None:
        """Samples (k, 7) in sensor axes: time, specific force, angular rate. orientation: (k, 4) or None."""
        k = len(samples)
        while self._count + k > len(self._imu):
            self._imu = np.concatenate([self._imu, np.empty_like(self._imu)])
        rows = self._imu[self._count:self._count + k]
        rows[:, 0], rows[:, 7:13] = samples[:, 0], samples[:, 1:]
        for i in range(6):  # sums of six terms in one order, so that one sample and many give the same bits
            total = self.config.offset[i]
            for j in range(6):
                total = total + self.config.conditioning[i, j] * rows[:, 7 + j]
            rows[:, 1 + i] = total
        if orientation is not None:
            orientation = np.asarray(orientation)
            given = orientation[np.isfinite(orientation).all(axis=1) & orientation.any(axis=1)]
            self._orientation = given[-1] if len(given) else self._orientation
        self._count += k

    def samples_after(self, time: float) -> np.ndarray:
        """The samples later than `time` as they were given: rows of time, f, w in sensor axes."""
        imu = self._imu[:self._count]
        return imu[imu[:, 0] > time][:, [0, *range(7, 13)]]

    def add_record(self, record: np.ndarray, say) -> Start | None:
        """One good fix as the kernel takes it; what there is to tell goes to say(level, text)."""
        before = self.waiting_for
        covariance = np.array([[record[Event.R_NN], record[Event.R_NE]], [record[Event.R_NE], record[Event.R_EE]]])
        start = self.add_fix(record[Event.TIME], record[Event.LATITUDE], record[Event.LONGITUDE],
                             record[Event.HEIGHT], covariance)
        if start is not None:
            for level, text in start.notes:
                say(level, text)
        elif self.waiting_for != before:
            say('info', f'waiting for {self.waiting_for}')
        return start

    def add_fix(self, time, latitude, longitude, height, covariance) -> Start | None:
        """One good fix of the antenna; covariance: north-east (2, 2) m^2. The start, as soon as there is one."""
        if not self._count:
            return None
        self._forget(time - MEMORY)
        self._fixes.append((time, latitude, longitude, height, covariance))
        self._fixes.sort(key=lambda fix: fix[0])
        ahead = time - self._imu[self._count - 1, 0]
        if ahead > LATEST_FIX:
            self.waiting_for = (f'fixes whose stamps agree with those of {self.config.imu.topic}: they are '
                                f'{ahead:.1f} s ahead (gnss.time_offset)')
        if self._fixes[-1][0] > time or not self._imu[0, 0] < time <= self._imu[self._count - 1, 0] + LATEST_FIX:
            return None
        positions = self._positions()
        problem = self._problem(positions)
        if problem:
            self.waiting_for = problem
            return None
        source = self.config.alignment.heading
        if source == 'course':
            return self._start_from_course(positions)
        return self._start_with_heading(source, positions, self._standstill(positions))

    def _problem(self, positions) -> str:
        """Why the samples cannot be what the configuration says they are; empty if they can."""
        imu, topic = self._imu[:self._count], self.config.imu.topic
        recent = imu[imu[:, 0] > imu[-1, 0] - 1.0]
        turn = float(np.abs(recent[:, 4:7].mean(axis=0)).max())
        if turn > FASTEST_TURN:
            return (f'a believable turn rate on {topic}: angular_velocity is {turn:.1f} rad/s over a second; if the '
                    "driver delivers deg/s, set imu.rate_unit to 'deg/s'")
        if self.config.mechanization == PLANAR:
            return ''
        mean = recent[:, 1:4].mean(axis=0)
        size = float(np.linalg.norm(mean))
        if size > 5.0 and -mean[2] < math.cos(LARGEST_TILT) * size:
            tilt = math.degrees(math.acos(max(-1.0, min(1.0, -mean[2] / size))))
            return (f'an IMU that is mounted as imu.mounting_rpy says: gravity on {topic} is {tilt:.0f} deg off the '
                    'vertical of the vehicle (`configure` finds the mounting from a recording)')
        return ''

    def _forget(self, before: float) -> None:
        first = int(np.searchsorted(self._imu[:self._count, 0], before))
        if first > self._count // 2:
            self._imu[:self._count - first] = self._imu[first:self._count]
            self._count -= first
        while self._fixes and self._fixes[0][0] < before:
            self._fixes.pop(0)

    def _positions(self) -> np.ndarray:
        """The fixes as (time, north, east, sigma), metres from the first."""
        _, latitude, longitude, height, _ = self._fixes[0]
        north, east = radii(latitude)
        return np.array([(t, (lat - latitude) * (north + height),
                          (lon - longitude) * (east + height) * math.cos(latitude),
                          math.sqrt(0.5 * (c[0, 0] + c[1, 1]))) for t, lat, lon, _, c in self._fixes])

    def _standstill(self, positions: np.ndarray) -> Standstill | None:
        """The latest standstill: at least SHORTEST_STILL in which the sensors are quiet and the fixes stay in place."""
        imu, vehicle = self._imu[:self._count], self.config.vehicle
        block = np.floor((imu[:, 0] - imu[0, 0]) / STILL_BLOCK).astype(np.int64)
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        length = np.diff(np.append(starts, len(imu)))[:, None]
        mean = np.add.reduceat(imu[:, 1:7], starts) / length
        scatter = np.sqrt(np.add.reduceat((imu[:, 1:7] - np.repeat(mean, length[:, 0], axis=0)) ** 2, starts) / length)
        quiet = ((scatter[:, :3].max(axis=1) < vehicle.still_acceleration)
                 & (scatter[:, 3:].max(axis=1) < vehicle.still_rate) & (length[:, 0] > 2))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], quiet.astype(np.int8), [0]])))
        ends = np.append(starts[1:], len(imu))
        for first, last in list(zip(edges[::2], edges[1::2]))[::-1]:
            steady = _longest_steady(mean[first:last])
            begin, end = starts[first + steady.start], ends[first + steady.stop - 1]
            duration = imu[end - 1, 0] - imu[begin, 0]
            if duration >= SHORTEST_STILL and _stays(positions, imu[begin, 0], imu[end - 1, 0]):
                means = imu[begin:end, 1:7].mean(axis=0)
                return Standstill(imu[end - 1, 0], duration, means[:3], means[3:])
        return None

    def _start_with_heading(self, source, positions, standstill) -> Start | None:
        """Heading given; velocity zero at standstill, else from the fixes."""
        sigma = self.config.alignment.yaw_sigma
        if source == 'parameter':
            yaw = self.config.alignment.yaw
        elif self._orientation is None:
            self.waiting_for = f"orientation in the messages on {self.config.imu.topic}"
            return None
        else:
            yaw = self._heading_of_orientation()
        still = standstill is not None and self._imu[self._count - 1, 0] - standstill.end < 2 * STILL_BLOCK
        if still:
            speed, speed_sigma = 0.0, 0.05
        else:
            course = self._course(positions, standstill)
            if course is None:
                self.waiting_for = f'{SHORTEST_STILL:.0f} s at rest or motion'
                return None
            speed, speed_sigma = course[1], course[3]
        return self._start(yaw, sigma, speed, speed_sigma, standstill, f'heading from {source}')

    def _heading_of_orientation(self) -> float:
        from scipy.spatial.transform import Rotation

        rotation = Rotation.from_quat(self._orientation) * Rotation.from_euler(
            'xyz', self.config.imu.mounting_rpy).inv()
        return float(yaw_from_enu(yaw_of_quaternion(*rotation.as_quat())))

    def _start_from_course(self, positions) -> Start | None:
        recent = positions[positions[:, 0] > positions[-1, 0] - LONGEST_COURSE_TIME]
        moved = np.hypot(*(recent[:, 1:3] - recent[-1, 1:3]).T).max()
        course, said = None, self.waiting_for
        if moved > max(SHORTEST_COURSE, recent[-1, 3] / COURSE_SIGMA):  # else do not look through all samples
            standstill = self._standstill(positions)
            course = self._course(positions, standstill)
        if course is None:
            if self.waiting_for == said:
                self.waiting_for = 'the vehicle to move straight on: the heading comes from the course of the fixes'
            return None
        yaw, speed, yaw_sigma, speed_sigma = course
        return self._start(yaw, yaw_sigma, speed, speed_sigma, standstill, 'heading from the course')

    def _course(self, positions, standstill):
        """Yaw and speed at the newest fix with their sigmas, from the chord to an earlier fix; None if not yet.

        The inertial sensors tell how the vehicle turned and changed speed on the way: with s the speed at the chord's
        begin and D the displacement that the specific force adds in the body axes of then, the chord is
        C(yaw) ([s T, 0] + D), which gives both s and yaw. No sideslip is assumed.
        """
        now, north, east, sigma = positions[-1]
        for time, n, e, s in positions[-2::-1]:
            chord = np.array([north - n, east - e])
            if now - time > LONGEST_COURSE_TIME:
                return None
            if standstill is not None:  # as long as it stood, it was there
                time = max(time, standstill.end)
            distance, interval = float(np.hypot(*chord)), now - time
            if interval <= 0:
                continue
            noise = math.sqrt(sigma**2 + s**2 + self._wandered(interval))
            if distance < max(SHORTEST_COURSE, noise / COURSE_SIGMA):
                continue
            motion = self._inertial_motion(time, now, standstill)
            if motion is None:
                return None
            turn, gained, added, bias_f, bias_w = motion
            if abs(turn) > 1.0 or abs(added[1]) > 0.5 * distance:
                return None
            speed_sigma = math.hypot(noise / interval, 0.5 * bias_f * interval)
            forward = math.sqrt(distance**2 - added[1] ** 2)
            way = self._way(time, standstill, (forward - added[0]) / interval, (-forward - added[0]) / interval,
                            speed_sigma)
            if way == 0:
                return None
            forward *= way
            speed = (forward - added[0]) / interval
            yaw_sigma = math.sqrt((noise / distance) ** 2 + (bias_w * interval / 2) ** 2
                                  + (0.5 * bias_f * interval**2 / distance) ** 2 + SIDESLIP_SIGMA**2)
            if abs(speed) > FASTEST:
                self.waiting_for = f'believable fixes: they move at {abs(speed):.0f} m/s'
                return None
            if way < 0 and abs(speed + gained[0]) > FASTEST_REVERSE:
                self.waiting_for = ('the vehicle to drive forwards: it seems to go backwards at '
                                    f'{abs(speed + gained[0]):.1f} m/s; if it does not, the IMU is mounted the other '
                                    'way round: turn the yaw of imu.mounting_rpy by pi')
                return None
            if abs(speed + gained[0]) < SLOWEST_START or yaw_sigma > LARGEST_YAW_SIGMA:
                return None
            yaw = math.atan2(chord[1], chord[0]) - math.atan2(added[1], forward)
            end_speed = math.copysign(math.hypot(speed + gained[0], gained[1]), speed + gained[0])
            return yaw + turn, end_speed, yaw_sigma, speed_sigma
        return None

    def _wandered(self, interval: float) -> float:
        """Variance of how far the receiver's coloured error has gone within `interval` s, m^2, one axis."""
        if not self.config.gnss.coloured:
            return 0.0
        return -2.0 * self.config.gnss.coloured.sigma**2 * math.expm1(-interval / self.config.gnss.coloured.tau)

    def _way(self, time, standstill, forwards, backwards, sigma) -> int:
        """1 forwards, -1 backwards, 0 unclear: which speed at `time` fits the accelerometers since it stood."""
        if standstill is None:
            return 1
        since = time - standstill.end
        motion = self._inertial_motion(standstill.end, time, standstill)
        expected = 0.0
        if motion is not None:
            turn, gained, *_ = motion
            expected = math.cos(turn) * gained[0] + math.sin(turn) * gained[1]
        variance = sigma**2 + (MOVED_OFF + 0.1 * since) ** 2
        if since < LONGEST_COURSE_TIME and min(abs(forwards - expected), abs(backwards - expected)) > (
                5.0 * math.sqrt(variance) + 1.0):
            return 0  # the fixes move, the IMU does not
        difference = (forwards - expected) ** 2 - (backwards - expected) ** 2
        if abs(difference) < 9 * variance:  # long ago it no longer helps: who has not turned round drives forwards
            return 1 if since > LONGEST_COURSE_TIME else 0
        return 1 if difference < 0 else -1

    def _inertial_motion(self, begin, end, standstill):
        """Turn, velocity and displacement gained between two times, in the body axes of the begin, and bias sigmas."""
        imu = self._imu[:self._count]
        part = imu[(imu[:, 0] > begin) & (imu[:, 0] <= end)]
        if len(part) < 3:
            return None
        force, rate = part[:, 1:3].copy(), part[:, 6].copy()
        bias_f, bias_w = UNKNOWN_TILT_SIGMA * 9.8, self.config.alignment.gyroscope_turn_on
        if standstill is not None:
            rate -= standstill.angular_rate[2]
            force -= standstill.specific_force[:2]
            bias_f, bias_w = 0.1, 1e-3
        dt = np.diff(part[:, 0], prepend=begin)
        yaw = np.cumsum(rate * dt)
        c, s = np.cos(yaw), np.sin(yaw)
        level = np.stack([c * force[:, 0] - s * force[:, 1], s * force[:, 0] + c * force[:, 1]])
        velocity = np.cumsum(level * dt, axis=1)
        return float(yaw[-1]), velocity[:, -1], (velocity * dt).sum(axis=1), bias_f, bias_w

    def _start(self, yaw, yaw_sigma, speed, speed_sigma, standstill, source) -> Start:
        time, latitude, longitude, height, r = self._fixes[-1]
        course = np.array([math.cos(yaw), math.sin(yaw)])
        across = np.array([-course[1], course[0]])
        # the velocity lies along the yaw, so an error of yaw is one of velocity, too
        jacobian = np.zeros((5, 4))
        jacobian[:2, :2] = np.linalg.cholesky(r)
        jacobian[2:4, 2] = course * speed_sigma
        jacobian[2:4, 3] = across * speed * yaw_sigma
        jacobian[4, 3] = yaw_sigma
        covariance = jacobian @ jacobian.T + np.diag([0, 0, *[(0.05 + SIDESLIP_SIGMA * speed) ** 2] * 2, 0])
        arm = self.config.gnss.lever_arm
        north = -(course[0] * arm[0] + across[0] * arm[1])  # from the antenna back to the IMU
        east = -(course[1] * arm[0] + across[1] * arm[1])
        meridian, prime_vertical = radii(latitude)
        notes = [('info', f'aligned: {source} {math.degrees(yaw) % 360:.1f} deg +- {math.degrees(yaw_sigma):.1f} deg, '
                          f'speed {speed:.2f} +- {speed_sigma:.2f} m/s')]
        notes += self._note_standstill(standstill, latitude, height)
        return Start(time, latitude + north / (meridian + height),
                     longitude + east / ((prime_vertical + height) * math.cos(latitude)), height + arm[2],
                     speed * course, float(wrap(yaw)), covariance, standstill, notes)

    def _note_standstill(self, standstill, latitude, height) -> list[tuple[str, str]]:
        if standstill is None:
            return [('info', 'no standstill seen: gyroscope bias and tilt of the IMU start unknown')]
        tilt = math.degrees(math.acos(min(1.0, max(-1.0, -standstill.specific_force[2]
                                                   / np.linalg.norm(standstill.specific_force)))))
        size = float(np.linalg.norm(standstill.specific_force))
        bias = ', '.join(f'{math.degrees(w):.3f}' for w in standstill.angular_rate)
        removed = ' (removed)' if self.config.alignment.level and self.config.mechanization == PLANAR else ''
        expected = gravity(latitude, height)
        text = (f'standstill of {standstill.duration:.1f} s: gyroscope bias {bias} deg/s (forward, right, down), '
                f'tilt {tilt:.1f} deg{removed}, specific force {size:.3f} m/s^2 '
                f'(gravity here {expected:.3f})')
        notes = [('info', text)]
        if abs(size - expected) > GRAVITY_TOLERANCE * expected:
            unit = 'in g, not in m/s^2' if abs(size - 1.0) < GRAVITY_TOLERANCE else 'a wrong unit or scale'
            notes.append(('error', f"{self.config.imu.topic}: linear_acceleration is {size:.3f} at rest "
                                   f'where gravity is {expected:.3f} m/s^2: {unit}'))
        return notes


def _stays(positions: np.ndarray, begin: float, end: float) -> bool:
    """No motion between two times as far as the fixes can tell: at least two of them, first and last halves agree.

    Receivers wander by more than they say: what goes slowly enough for that does not speak against a standstill.
    """
    inside = positions[(positions[:, 0] >= begin - 0.5) & (positions[:, 0] <= end + 0.5)]
    if len(inside) < 2:
        return False
    half = len(inside) // 2
    moved = np.hypot(*(inside[half:, 1:3].mean(axis=0) - inside[:half, 1:3].mean(axis=0)))
    sigma = inside[:, 3].mean() * math.sqrt(1 / half + 1 / (len(inside) - half))
    interval = max(0.5 * (inside[-1, 0] - inside[0, 0]), 1e-3)
    return moved < 4 * sigma + max(0.1, RECEIVER_DRIFT * interval) and moved < 2.0 * interval


def _longest_steady(mean: np.ndarray) -> slice:
    """The longest run of blocks whose means (k, 6) stay near their median: a gentle start is quiet, but not that."""
    away = np.abs(mean - np.median(mean, axis=0))
    steady = (away[:, :3].max(axis=1) < STEADY_ACCELERATION) & (away[:, 3:].max(axis=1) < STEADY_RATE)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(np.int8), [0]]))).reshape(-1, 2)
    if not len(edges):
        return slice(0, 1)
    first, last = edges[np.argmax(edges[:, 1] - edges[:, 0])]
    return slice(int(first), int(last))


def leveled(config: FilterConfig, standstill: Standstill):
    """Conditioning and offset of `config` with the tilt of `standstill` removed: (6, 6), (6,).

    The tilt is the smallest rotation that makes the specific force vertical. Planar: what is then left of f_x, f_y is
    zero. Strapdown: attitude starts level.
    """
    rotation = np.kron(np.eye(2), leveling(standstill.specific_force))
    return rotation @ config.conditioning, rotation @ config.offset


def channel_prior(model, turn_on_sigma: float, white: float, mean: float | None, duration: float, since: float = 0.0):
    """Estimate (p,), covariance (p, p) and constant part of one channel's error at the start.

    The error is a constant N(0, turn_on_sigma^2) plus the model's process from its initial covariance on. A standstill
    of `duration` s that ended `since` s ago shows the mean of their sum, `mean`, with the variance of white noise
    averaged over `duration`. What the process does during the standstill and after it counts, too.
    """
    p = model.order
    if mean is None:
        covariance = model.initial_covariance()
        covariance[0, 0] += turn_on_sigma**2  # the constant has no state: the first stands for it
        return np.zeros(p), covariance, 0.0
    interval = model.interval or duration / STILL_STEPS
    steps = max(1, round(duration / interval))
    # the process, the constant, and the mean over the standstill as it adds up
    transition, noise, prior = np.eye(p + 2), np.zeros((p + 2, p + 2)), np.zeros((p + 2, p + 2))
    transition[:p, :p], noise[:p, :p] = model.transition(interval), model.process_noise(interval)
    transition[-1, 0] = transition[-1, -2] = 1.0 / steps
    prior[:p, :p], prior[p, p] = model.initial_covariance(), turn_on_sigma**2
    f, q = _repeated(transition, noise, steps)
    transition[-1, :-1] = 0.0
    after, grown = _repeated(transition, noise, round(since / interval))
    f, q = after @ f, after @ q @ after.T + grown
    joint = f @ prior @ f.T + q
    gain = joint[:, -1] / (joint[-1, -1] + white / duration)
    estimate = gain * mean
    covariance = (joint - np.outer(gain, joint[-1]))[:p, :p]
    return estimate[:p], 0.5 * (covariance + covariance.T), estimate[p]


def _repeated(transition, noise, steps: int):
    """Transition and process noise of `steps` steps, by doubling."""
    f, q = np.eye(len(transition)), np.zeros_like(noise)
    while steps:
        if steps & 1:
            f, q = transition @ f, transition @ q @ transition.T + noise
        transition, noise = transition @ transition, transition @ noise @ transition.T + noise
        steps >>= 1
    return f, q


def transferred(start: Start, old: FilterConfig, new: FilterConfig) -> Start:
    """The start that `old` found, for a filter with other parameters: so that two runs differ by these alone.

    The time offset moves its time, the lever arm its position; what the standstill shows is `retaken` by the run.
    """
    delay = new.gnss.time_offset - old.gnss.time_offset
    arm = new.gnss.lever_arm - old.gnss.lever_arm
    c, s = math.cos(start.yaw), math.sin(start.yaw)
    meridian, prime_vertical = radii(start.latitude)
    return replace(
        start, time=start.time - delay, latitude=start.latitude - (c * arm[0] - s * arm[1]) / (meridian + start.height),
        longitude=start.longitude - (s * arm[0] + c * arm[1]) / (
            (prime_vertical + start.height) * math.cos(start.latitude)),
        height=start.height + arm[2])


def retaken(start: Start, config: FilterConfig, samples: np.ndarray) -> Start:
    """`start` with what its standstill shows in these samples (n, 7): time as in `start`, f and w in sensor axes."""
    still = start.standstill
    if still is None:
        return start
    inside = slice(*np.searchsorted(samples[:, 0], [still.end - still.duration - 1e-6, still.end + 1e-6]))
    seen = samples[inside, 1:].mean(axis=0)
    seen = config.conditioning @ seen + config.offset
    return replace(start, standstill=replace(still, specific_force=seen[:3], angular_rate=seen[3:]))
