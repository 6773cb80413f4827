"""How the filter starts by itself: position, gyroscope bias, level and heading from what the first minutes show."""
from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...navigation.earth import radii, to_local
from ...navigation.frames import wrap, yaw_from_enu, yaw_of_quaternion
from ..config import FilterConfig
from ..measurements.registry import FIRST_NAMED
from ..memory import Event, Kind
from ..trust.receiver import SHORTEST_PAIR, UNKNOWN_YAW_SIGMA
from ..trust.scale import Scale, learn, scale
from .at_rest import SHORTEST_STILL, STILL_BLOCK, is_quiet, latest_standstill, note_standstill, tumbling_rate
from .course import (
    FASTEST_REVERSE,
    LONGEST_COURSE_TIME,
    SIDESLIP_SIGMA,
    Contradicted,
    Refused,
    driven_off,
    find_course,
    has_moved,
    inertial_motion,
)
from .magnetic import find_magnetic_heading
from .start import DATUM_FIXES, SensorErrors, Standstill, Start

MEMORY = 300.0  # s of samples kept while waiting
LARGEST_TILT = math.radians(40.0)  # of an IMU whose mounting is as configured, on any road
FASTEST_TURN = 3.0  # rad/s: of the vehicle's mean turn over a second
LEAST_GRAVITY = 6.0  # m/s^2: what accelerometers show at least in a second's mean, biased, braking or in g
MOST_GRAVITY = 14.0  # m/s^2: and at most
MOST_G = 2.0  # of a mean specific force in g
SIDEWAYS = math.radians(45.0)  # from straight on: no wheels drive off that way
RECENT = 10.0  # s: what tells whether the vehicle stands now, and how fast it is where it is slow
CERTAIN = 3.0  # sigmas of two fixes by which they show that a vehicle does not go along its heading
CHANGED = 0.3  # m/s: by how much the speed of a slow vehicle differs from the mean of that time
SLOW = 2.0  # m/s: a faster vehicle shows a course soon
STANDING_SIGMA = 0.05  # m/s, of a velocity of zero at rest
FEWEST_SHOWN = 3  # second differences of fixes that fit: before that a claim that is too small passes for a drive
OVERLAP = 0.5  # of what it tells: each fix is in three second differences
#: a node that starts this late after the IMU came to rest may have been driven before, s
SEEN_FROM_BEGIN = 2.0
#: s after which a vehicle that has not been seen at rest has driven off, so that a remembered heading does not hold
LONGEST_REMEMBERED = 30.0


@dataclass(frozen=True)
class Remembered:
    """What an earlier run knew when it ended at rest: place (rad, rad, m), heading of the vehicle (rad) with its sigma,
    how far away a fix may be (m), the sensor errors, None where they are of another configuration, and the wheels, None
    where they are not known (`wheel_vibration`)."""

    place: tuple[float, float, float]
    yaw: float
    yaw_sigma: float
    max_distance: float
    errors: SensorErrors | None
    wheels: np.ndarray | None = None


class Alignment:
    """Collects samples and fixes until there is enough to start. Times are seconds since the filter's epoch."""

    def __init__(self, config: FilterConfig):
        self.config = config
        self.waiting_for = 'IMU samples'
        self.contradicted = False  # whether that cannot come by itself: what comes is not what the parameters say
        self._imu = np.empty((1024, 13))  # time, body-axis f and w, raw f and w
        self._count = 0
        self._orientation: np.ndarray | None = None
        #: the magnetometer that tells the heading: the first of them
        self._magnetometer = next((one for number, one in config.inputs.items() if one.kind == Kind.MAGNETIC
                                   and config.settings_of(number).topic), None)
        self._fields: list[tuple] = []  # its time, field in body axes, variance and declination
        self._fixes: list[tuple] = []
        self._first: float | None = None
        self._remembered: Remembered | None = None
        self._scale = np.zeros(Scale.SIZE)  # realised over claimed variance of the fixes
        self._track: list[tuple] = []  # the latest three of them that are apart, which show how far they scatter,
        self._shown = 0  # and how often they have, as was expected
        self._turned = ''  # what driving off has shown of the mounting, empty: nothing that is wrong
        self._backwards = False  # whether that is that it drove off backwards

    def remember(self, remembered: Remembered) -> None:
        """What an earlier run knew: its heading holds if the vehicle has been at rest ever since the first sample."""
        self._remembered = remembered

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
        # the raw ones stay as they are: the filter looks at them again
        limit = np.repeat([self.config.imu.max_specific_force, self.config.imu.max_angular_rate], 3)
        for i in np.flatnonzero((np.abs(rows[:, 7:13]) > limit).any(axis=1)) + self._count:
            self._imu[i, 1:7] = self._imu[max(i - 1, 0), 1:7]  # if all are, the first one shows what is wrong with them
        if orientation is not None:
            orientation = np.asarray(orientation)
            given = orientation[np.isfinite(orientation).all(axis=1) & orientation.any(axis=1)]
            self._orientation = given[-1] if len(given) else self._orientation
        self._count += k
        if self._first is None and k:
            self._first = float(samples[0, 0])

    def add_field(self, record: np.ndarray) -> None:
        """One magnetic field as the kernel takes it."""
        number = 0 if self._magnetometer.is_plain else self._magnetometer.number - FIRST_NAMED + 1
        if record[Event.INPUT] == number:
            self._fields.append((record[Event.TIME], *record[Event.VALUE:Event.VALUE + 3], record[Event.R_NN],
                                 record[Event.DECLINATION]))

    @property
    def _samples(self) -> np.ndarray:
        return self._imu[:self._count]

    def samples_after(self, time: float) -> np.ndarray:
        """The samples later than `time` as they were given: rows of time, f, w in sensor axes."""
        imu = self._samples
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
        variance = float(0.5 * (covariance[0, 0] + covariance[1, 1]))
        self._learn_scatter(time, latitude, longitude, height, variance)
        self._fixes.append((time, latitude, longitude, variance, height, covariance))
        self._fixes.sort(key=lambda fix: fix[0])
        ahead = time - self._samples[-1, 0]
        self.contradicted = ahead > self.config.ahead
        if self.contradicted:
            self.waiting_for = (f'fixes whose stamps agree with those of {self.config.imu.topic}: they are '
                                f'{ahead:.1f} s ahead (gnss.time_offset)')
        if self._fixes[-1][0] > time or self.contradicted or time <= self._imu[0, 0]:
            return None
        problem = self._problem()
        if problem:
            self.waiting_for, self.contradicted = problem, True
            return None
        positions = self._positions()
        source = self.config.alignment.heading
        try:
            self._refuse_contradictions(positions)
            return self._start_as_before(positions) or (
                self._start_from_course(positions) if source == 'course' else
                self._start_with_heading(source, positions))
        except Refused as reason:
            self.waiting_for, self.contradicted = str(reason), isinstance(reason, Contradicted)
            return None

    def provisional(self) -> Start | None:
        """Where the vehicle is while its heading is unknown: the newest fix, at rest or at an unknown velocity.

        None before there are as many good fixes as make a datum, and while the samples are not what the configuration
        says they are. The yaw, east, has the sigma of any heading being as likely as any other.
        """
        latest = self._samples[-1, 0] + self.config.ahead
        if len(self._fixes) < DATUM_FIXES or self._fixes[-1][0] > latest or self._problem():
            return None
        time, latitude, longitude, _, height, r = self._fixes[-1]
        r = self._realised * r
        positions, imu = self._positions(), self._samples
        still = latest_standstill(imu[imu[:, 0] > imu[-1, 0] - RECENT], positions, self.config)
        speed = STANDING_SIGMA
        if still is None or imu[-1, 0] - still.end > 2 * STILL_BLOCK:
            before, now = positions[-2:]
            moved = math.hypot(*(now[1:3] - before[1:3]))
            speed = math.hypot(moved, before[3], now[3]) / max(now[0] - before[0], 0.1)
        arm = self.config.gnss.lever_arm
        ahead = max(time - imu[-1, 0], 0.0)  # the state is of a sample's time
        position = r + np.eye(2) * (0.5 * (arm[0] ** 2 + arm[1] ** 2) + (ahead * speed) ** 2)
        covariance = np.zeros((5, 5))
        covariance[:2, :2] = position
        covariance[[2, 3, 4], [2, 3, 4]] = speed**2, speed**2, UNKNOWN_YAW_SIGMA**2
        return Start(time - ahead, latitude, longitude, height + arm[2], np.zeros(2), math.pi / 2, covariance, still,
                     gnss_scale=self._scale.copy())

    def _problem(self) -> str:
        """Why the samples cannot be what the configuration says they are; empty if they can."""
        imu, topic = self._samples, self.config.imu.topic
        recent = imu[np.searchsorted(imu[:, 0], imu[-1, 0] - 1.0, side='right'):]
        turn = float(np.abs(recent[:, 4:7].mean(axis=0)).max())
        if turn > FASTEST_TURN:
            return (f'a believable turn rate on {topic}: angular_velocity is {turn:.1f} rad/s over a second; if the '
                    "driver delivers deg/s, set imu.rate_unit to 'deg/s'")
        mean = recent[:, 1:4].mean(axis=0)
        size = float(np.linalg.norm(mean))
        level = self.config.layout.is_level  # it may be given no vertical axis
        if imu[-1, 0] - imu[0, 0] > 1.0 and not LEAST_GRAVITY < size < MOST_GRAVITY and (
                not level or abs(size - 1.0) < 0.1):
            unit = "in g; set imu.acceleration_unit to 'g'" if 1.0 / MOST_G < size < MOST_G else 'a wrong unit or scale'
            return (f'a believable specific force on {topic}: linear_acceleration is {size:.3f} m/s^2 over a second, '
                    f'gravity included: {unit}')
        if level:
            return ''
        if size > 5.0 and -mean[2] < math.cos(LARGEST_TILT) * size:
            tilt = math.degrees(math.acos(max(-1.0, min(1.0, -mean[2] / size))))
            return (f'an IMU that is mounted as imu.mounting_rpy says: gravity on {topic} is {tilt:.0f} deg off the '
                    'vertical of the vehicle (`configure` finds the mounting from a recording)')
        return ''

    def _forget(self, before: float) -> None:
        first = int(np.searchsorted(self._samples[:, 0], before))
        if first > self._count // 2:
            self._imu[:self._count - first] = self._imu[first:self._count]
            self._count -= first
        while self._fixes and self._fixes[0][0] < before:
            self._fixes.pop(0)
        self._fields = [field for field in self._fields if field[0] >= before]

    def _positions(self) -> np.ndarray:
        """The fixes as (time, north, east, sigma), metres from the first."""
        _, latitude, longitude, _, height, _ = self._fixes[0]
        north, east = radii(latitude)
        # at each fix, and of as many as MEMORY holds: a drive may begin with minutes at rest
        positions = np.array([fix[:4] for fix in self._fixes])
        positions[:, 1] = (positions[:, 1] - latitude) * (north + height)
        positions[:, 2] = (positions[:, 2] - longitude) * (east + height) * math.cos(latitude)
        positions[:, 3] = np.sqrt(self._realised * positions[:, 3])
        return positions

    @property
    def _white(self) -> float:
        """Share of the variance of the fixes by which they scatter."""
        return min(scale(self._scale, 0), 1.0)

    @property
    def _realised(self) -> float:
        """Realised over claimed variance of the fixes: what they claim and do not scatter may last."""
        return max(scale(self._scale, 0), 1.0)

    def _learn_scatter(self, *fix) -> None:
        """How far a new fix (time, latitude, longitude, height, variance) is from the track that two before it show.

        The second difference of three fixes is that of their errors and of the way by which the speed changed, which
        the inertial sensors bound, whatever the heading.
        """
        if self._track and fix[0] - self._track[-1][0] < SHORTEST_PAIR:
            return
        self._track = [*self._track[-2:], fix]
        if len(self._track) < 3:
            return
        (t_1, *first), (t_2, *second), (t_3, *third) = self._track
        motion = inertial_motion(self._samples, t_1, t_3, None, self.config)
        if motion is None:
            return
        ahead, ratio = t_3 - t_2, (t_3 - t_2) / (t_2 - t_1)
        to, back = (np.array(to_local(*place[:3], second[:3])[:2]) for place in (third, first))
        first_sample, last_sample = np.searchsorted(self._samples[:, 0], [t_1, t_3])
        changed = 0.0 if is_quiet(self._samples[first_sample:last_sample], self.config) else (
            0.5 * ahead * (math.hypot(*motion.gained) + motion.bias_f * (t_3 - t_1)))
        self._shown += learn(self._scale, 0, t_3, 0.5 * float(np.sum((to + ratio * back) ** 2)),
                             third[3] + (1.0 + ratio) ** 2 * second[3] + ratio**2 * first[3], 0.5 * changed**2, 2,
                             OVERLAP)

    def standing(self) -> Standstill | None:
        """The standstill that still lasts, None where the vehicle moves or nothing tells that it does not."""
        if not self._count or len(self._fixes) < 2:
            return None
        return self._still_standing(latest_standstill(self._samples, self._positions(), self.config))

    def _still_standing(self, standstill: Standstill | None) -> Standstill | None:
        lasts = standstill is not None and self._samples[-1, 0] - standstill.end < 2 * STILL_BLOCK
        return standstill if lasts else None

    def _start_as_before(self, positions) -> Start | None:
        """The heading remembered, if nothing has moved since."""
        known = self._remembered
        if known is None or not math.isfinite(known.yaw_sigma) or (
                self._samples[-1, 0] - self._first > LONGEST_REMEMBERED):
            return None
        standstill = self._still_standing(latest_standstill(self._samples, positions, self.config))
        if standstill is None:
            return None
        _, latitude, longitude, _, height, _ = self._fixes[-1]
        away = math.hypot(*to_local(latitude, longitude, height, known.place)[:2])
        if standstill.end - standstill.duration > self._first + SEEN_FROM_BEGIN or away > known.max_distance:
            return None
        return self._start(known.yaw, known.yaw_sigma, 0.0, STANDING_SIGMA, standstill, 'heading from the state file')

    def _start_with_heading(self, source, positions) -> Start | None:
        """Heading given; velocity zero at standstill, else from the fixes."""
        if source == 'parameter':
            yaw = self.config.alignment.yaw
        elif self._orientation is None:
            raise Refused(f'orientation in the messages on {self.config.imu.topic}')
        else:
            yaw = self._heading_of_orientation()
        standstill = latest_standstill(self._samples, positions, self.config)
        speed, speed_sigma = 0.0, STANDING_SIGMA
        if not self._still_standing(standstill):
            course = find_course(self._samples, positions, standstill, self.config, self._white)
            if course is None:
                raise Refused(f'{SHORTEST_STILL:.0f} s at rest or motion')
            speed, speed_sigma = course.speed, course.speed_sigma
        return self._start(yaw, self.config.alignment.yaw_sigma, speed, speed_sigma, standstill,
                           f'heading from {source}')

    def _heading_of_orientation(self) -> float:
        from scipy.spatial.transform import Rotation

        rotation = Rotation.from_quat(self._orientation) * Rotation.from_euler(
            'xyz', self.config.imu.mounting_rpy).inv()
        return float(yaw_from_enu(yaw_of_quaternion(*rotation.as_quat())))

    def _refuse_contradictions(self, positions) -> None:
        """Refused where rest or driving off have shown that the samples are not what the configuration says."""
        topic = self.config.imu.topic
        rate = tumbling_rate(self._samples, positions, self.config)
        if rate:
            raise Contradicted(f'a believable turn rate on {topic}: angular_velocity is {rate:.3f} rad/s at rest, '
                               'about an axis about which no vehicle turns; if the driver delivers deg/s, set '
                               "imu.rate_unit to 'deg/s'")
        if not self.config.vehicle.lateral_sigma:
            return  # a vehicle that may move sideways drives off in any direction
        standstill = latest_standstill(self._samples, positions, self.config)
        # the inertial sensors show it, fixes only that it was
        claimed = positions / [1.0, 1.0, 1.0, math.sqrt(self._realised)]
        found = None if standstill is None else driven_off(self._samples, claimed, standstill, self.config)
        if found is not None:
            angle, speed = found
            self._turned, self._backwards = '', abs(angle) > math.pi - SIDEWAYS
            if self._backwards and speed > FASTEST_REVERSE:
                self._turned = (f'the vehicle to drive forwards: it drives off backwards at {speed:.1f} m/s; if it '
                                'does not, the IMU is mounted the other way round: turn the yaw of '
                                'imu.mounting_rpy by pi')
            elif SIDEWAYS < abs(angle) < math.pi - SIDEWAYS:
                self._turned = (f'an IMU that is mounted as imu.mounting_rpy says: the vehicle drives off '
                                f'{abs(math.degrees(angle)):.0f} deg to the {"right" if angle > 0 else "left"} of its '
                                f'forward axis: add {angle:.2f} to the yaw of imu.mounting_rpy')
        if self._turned and not (self._backwards and self._has_reversed(positions, standstill)):
            raise Contradicted(self._turned)

    def _has_reversed(self, positions, standstill) -> bool:
        """Whether who drove off backwards goes forwards by now, as a vehicle does whose IMU is not turned round."""
        if standstill is None or self._samples[-1, 0] - standstill.end > LONGEST_COURSE_TIME:
            return False
        try:
            course = find_course(self._samples, positions, standstill, self.config, self._white)
        except Refused:
            return False
        return course is not None and course.speed > FASTEST_REVERSE

    def _start_from_course(self, positions) -> Start | None:
        course = standstill = None
        if has_moved(positions, self._white) and self._shown >= FEWEST_SHOWN:  # else do not look through all samples
            standstill = latest_standstill(self._samples, positions, self.config)
            course = find_course(self._samples, positions, standstill, self.config, self._white)
        if course is None and self._magnetometer is not None:
            return self._start_from_field(positions)
        if course is None:
            raise Refused('the vehicle to move straight on: the heading comes from the course of the fixes')
        return self._start(course.yaw, course.yaw_sigma, course.speed, course.speed_sigma, standstill,
                           'heading from the course')

    def _start_from_field(self, positions) -> Start:
        """Of a vehicle whose course the fixes do not show."""
        fields = np.array(sorted(self._fields)).reshape(-1, 6)
        standstill = latest_standstill(self._samples, positions, self.config)
        found = find_magnetic_heading(self._samples, fields, standstill, self.config, self._magnetometer.name,
                                      self._remembered.errors if self._remembered else None)
        if found is None:
            raise Refused('the vehicle to move straight on, or to turn: the heading comes from the course of the '
                          f'fixes, or from {self.config.settings_of(self._magnetometer.number).topic} once turns '
                          'have shown the iron of the vehicle')
        speed, speed_sigma = 0.0, STANDING_SIGMA
        if not self._still_standing(standstill):
            speed, speed_sigma = self._slow_speed(found.yaw + self._known_mounting, positions)
        start = self._start(found.yaw + self._known_mounting, found.sigma, speed, speed_sigma, standstill,
                            'heading from the magnetic field')
        return replace(start, iron=found.iron)

    @property
    def _known_mounting(self) -> float:
        """Yaw of the vehicle in the body's axes that an earlier run has found, rad."""
        state = self.config.layout.index('mounting_yaw') - self.config.layout.n_navigation
        return float(self._remembered.errors.estimate[state]) if (
            state >= 0 and self._remembered and self._remembered.errors) else 0.0

    def _slow_speed(self, yaw, positions) -> tuple[float, float]:
        """Speed along the heading and its sigma, m/s, by the fixes of the last seconds. Raises Refused where these go
        sideways, or too fast for a mean of them."""
        recent = positions[positions[:, 0] >= positions[-1, 0] - RECENT]
        if len(recent) < 2:
            raise Refused('more fixes to tell how fast the vehicle moves')
        moved, interval = recent[-1, 1:3] - recent[0, 1:3], recent[-1, 0] - recent[0, 0]
        noise = math.hypot(recent[0, 3], recent[-1, 3])
        along = math.cos(yaw) * moved[0] + math.sin(yaw) * moved[1]
        across = math.cos(yaw) * moved[1] - math.sin(yaw) * moved[0]
        if abs(across) > max(CERTAIN * noise, abs(along)):
            raise Refused('a magnetic field that agrees with the way of the fixes: they go to the side of its heading')
        if math.hypot(*moved) > SLOW * interval + CERTAIN * noise:
            raise Refused('the vehicle to move straight on: it is fast enough for the heading to come from the course')
        return float(along / interval), math.hypot(noise / interval, CHANGED)

    def _start(self, yaw, yaw_sigma, speed, speed_sigma, standstill, source) -> Start:
        time, latitude, longitude, _, height, r = self._fixes[-1]
        r = self._realised * r
        course = np.array([math.cos(yaw), math.sin(yaw)])
        across = np.array([-course[1], course[0]])
        covariance = start_covariance(r, yaw, yaw_sigma, speed, speed_sigma)
        arm = self.config.gnss.lever_arm
        north = -(course[0] * arm[0] + across[0] * arm[1])  # from the antenna back to the IMU
        east = -(course[1] * arm[0] + across[1] * arm[1])
        meridian, prime_vertical = radii(latitude)
        notes = [('info', f'aligned: {source} {math.degrees(yaw) % 360:.1f} deg +- {math.degrees(yaw_sigma):.1f} deg, '
                          f'speed {speed:.2f} +- {speed_sigma:.2f} m/s')]
        notes += note_standstill(standstill, latitude, height, self.config)
        return Start(time, latitude + north / (meridian + height),
                     longitude + east / ((prime_vertical + height) * math.cos(latitude)), height + arm[2],
                     speed * course, float(wrap(yaw)), covariance, standstill, notes,
                     self._remembered.errors if self._remembered else None, self._scale.copy(),
                     self._remembered.wheels if self._remembered else None)


def start_covariance(r: np.ndarray, yaw: float, yaw_sigma: float, speed: float, speed_sigma: float) -> np.ndarray:
    """Covariance (5, 5) of r_n, r_e, v_n, v_e, yaw where the velocity lies along the yaw. r: (2, 2) of the position.

    An error of yaw is one of velocity, too.
    """
    course = np.array([math.cos(yaw), math.sin(yaw)])
    across = np.array([-course[1], course[0]])
    jacobian = np.zeros((5, 4))
    jacobian[:2, :2] = np.linalg.cholesky(r)
    jacobian[2:4, 2] = course * speed_sigma
    jacobian[2:4, 3] = across * speed * yaw_sigma
    jacobian[4, 3] = yaw_sigma
    return jacobian @ jacobian.T + np.diag([0, 0, *[(0.05 + SIDESLIP_SIGMA * speed) ** 2] * 2, 0])
