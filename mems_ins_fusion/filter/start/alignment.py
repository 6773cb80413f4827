"""Alignment: the first state of the filter, from the IMU samples and fixes of the first seconds to minutes."""
from __future__ import annotations

import math
from bisect import insort
from dataclasses import replace

import numpy as np

from ...navigation.earth import radii, to_local
from ...navigation.frames import near, wrap, yaw_from_enu, yaw_of_quaternion
from ..config import FilterConfig
from ..measurements.position import is_without_altitude
from ..measurements.registry import imus
from ..memory import Event, Kind
from ..prediction import UNKNOWN_YAW_SIGMA
from ..trust.receiver import SHORTEST_PAIR
from ..trust.scale import Scale, learn_changes, scale
from .at_rest import (
    SHORTEST_STILL,
    STILL_BLOCK,
    Blocks,
    blocks_of,
    is_quiet,
    latest_standstill,
    note_standstill,
    tumbling_rate,
)
from .course import (
    FASTEST_REVERSE,
    LONGEST_COURSE_TIME,
    Backwards,
    Contradicted,
    Course,
    Refused,
    driven_off,
    find_course,
    has_moved,
    inertial_motion,
    start_covariance,
)
from .magnetic import find_magnetic_heading
from .plausibility import direction_in_motion, is_backwards, problem_of_direction, problem_of_samples
from .start import DATUM_FIXES, SavedState, Standstill, Start
from .two_receivers import SLOW_SPEED, SPEED_CHANGE_SIGMA, find_heading

#: s of samples and fixes that are kept
LONGEST_KEPT = 300.0
#: s after a start during which it is discarded if the motion shows that the mounting is wrong: as far back as samples
#: are kept. Vehicles have turned and braked by then
LONGEST_WATCHED = LONGEST_KEPT
RECENT = 10.0  # s of samples and fixes from which a present standstill, or the speed of a slow vehicle, is determined
DISPLACEMENT_SIGMAS = 3.0  # standard deviations of two fixes by which their displacement has to contradict a heading
STANDING_SIGMA = 0.05  # m/s, standard deviation of the velocity at rest
#: number of deviations as small as the noise learned so far allows before a course is looked for: noise that is larger
#: than claimed looks like motion
FEWEST_CONSISTENT = 3
#: weight of one deviation in motion (`_learn_noise`), where each fix is part of three deviations
OVERLAP = 0.5
#: largest number of fixes at rest in the line that predicts the next fix (`_learn_noise`). The variance of the
#: deviation is 1.9 times that of a fix with six of them, and 6 times with two. With more it is hardly smaller, and slow
#: errors of the receiver become part of it
LINE_FIXES = 6
#: s: a standstill that begins later than this after the first sample may follow a drive of which there are no samples
SEEN_FROM_BEGIN = 2.0
#: s after the first sample until which a saved heading is used: a vehicle not seen at rest by then has driven off
LONGEST_SAVED = 30.0


class Alignment:
    """Collects samples and fixes until they determine a start. Times are seconds since the filter's epoch."""

    def __init__(self, config: FilterConfig):
        self.config = config
        self.waiting_for = 'IMU samples'
        self.contradicted = False  # whether the inputs contradict the parameters, so that waiting does not help
        # time, body-axis f and w, raw f and w and, of several IMUs, their difference
        self._imu = np.empty((1024, 19 if imus(config.parameters) else 13))
        self._count = 0
        self._blocks: Blocks | None = None  # of the samples up to the latest fix
        self._orientation: np.ndarray | None = None
        #: the first magnetometer, which may give the heading
        self._magnetometer = next((one for number, one in config.inputs.items() if one.kind == Kind.MAGNETIC
                                   and config.settings_of(number).topic), None)
        self._fields: list[tuple] = []  # time, field in body axes, variance and declination
        #: further receivers by their `Event.INPUT`, and the fixes of each: time, latitude, longitude, variance
        self._receivers = {config.of_input(number)[0]: one for number, one in config.inputs.items()
                           if one.kind == Kind.POSITION and not one.is_plain}
        self._places: dict[float, list[tuple]] = {number: [] for number in self._receivers}
        self._fixes: list[tuple] = []  # time, latitude, longitude, variance, height, covariance
        self._has_height = True  # whether the newest fix has an altitude
        self._first: float | None = None  # time of the first sample
        self._started = -math.inf  # time of the start
        self._saved: SavedState | None = None
        self._scale = np.zeros(Scale.CHANGING_SIZE)  # realised over claimed variance of the fixes
        self._track: list[tuple] = []  # the latest fixes that are SHORTEST_PAIR apart: LINE_FIXES at rest, else two
        self._consistent = 0  # number of fixes that agreed with the noise known so far
        #: what driving off, or the motion, has shown to be wrong with the mounting
        self._mounting_problem: Contradicted | None = None
        self._drove_off = -math.inf  # time of the end of the standstill after which driving off has shown it
        self._forwards = False  # whether the motion has shown that the vehicle moves along the body's forward axis

    def use_saved(self, saved: SavedState) -> None:
        """State of an earlier run: its heading is used if the vehicle has been at rest ever since the first sample."""
        self._saved = saved

    def add_samples(self, samples: np.ndarray, orientation=None) -> None:
        """Add samples (k, 7) in sensor axes: time, specific force, angular rate. orientation: (k, 4) or None.

        With several IMUs they may have six more columns, the difference, which is only kept (`samples_after`)."""
        k = len(samples)
        while self._count + k > len(self._imu):
            self._imu = np.concatenate([self._imu, np.empty_like(self._imu)])
        rows = self._imu[self._count:self._count + k]
        rows[:, 0], rows[:, 7:13] = samples[:, 0], samples[:, 1:7]
        rows[:, 13:] = samples[:, 7:] if samples.shape[1] > 7 and rows.shape[1] > 13 else 0.0
        for i in range(6):  # summed in a fixed order, so that one sample gives the same bits as many
            total = self.config.offset[i]
            for j in range(6):
                total = total + self.config.conditioning[i, j] * rows[:, 7 + j]
            rows[:, 1 + i] = total
        # samples out of range are replaced here; the raw ones are kept, as the filter checks them itself
        limit = np.repeat([self.config.imu.max_specific_force, self.config.imu.max_angular_rate], 3)
        for i in np.flatnonzero((np.abs(rows[:, 7:13]) > limit).any(axis=1)) + self._count:
            self._imu[i, 1:7] = self._imu[max(i - 1, 0), 1:7]
        if orientation is not None:
            orientation = np.asarray(orientation)
            given = orientation[np.isfinite(orientation).all(axis=1) & orientation.any(axis=1)]
            self._orientation = given[-1] if len(given) else self._orientation
        self._count += k
        if self._first is None and k:
            self._first = float(samples[0, 0])

    def add_input(self, event: np.ndarray) -> None:
        """Add one magnetic field, or one fix of a further receiver, as an event."""
        if event[Event.KIND] == Kind.PLACE:
            self._places[event[Event.INPUT]].append((event[Event.TIME], event[Event.LATITUDE],
                                                      event[Event.LONGITUDE], event[Event.R_NN]))
        elif event[Event.INPUT] == self.config.of_input(self._magnetometer.number)[0]:
            self._fields.append((event[Event.TIME], *event[Event.VALUE:Event.VALUE + 3], event[Event.R_NN],
                                 event[Event.DECLINATION]))

    @property
    def _samples(self) -> np.ndarray:
        return self._imu[:self._count]

    def samples_after(self, time: float) -> np.ndarray:
        """The samples later than `time`, as given: rows of time, f, w in sensor axes, difference of several IMUs."""
        imu = self._samples
        return imu[imu[:, 0] > time][:, [0, *range(7, imu.shape[1])]]

    def add_event(self, event: np.ndarray, say) -> Start | None:
        """Add one valid fix, as an event; messages to the user go to say(level, text). Returns the start once there is
        one."""
        before = self.waiting_for
        covariance = np.array([[event[Event.R_NN], event[Event.R_NE]], [event[Event.R_NE], event[Event.R_EE]]])
        self._has_height = not is_without_altitude(event[Event.R_DD])
        start = self.add_fix(event[Event.TIME], event[Event.LATITUDE], event[Event.LONGITUDE],
                             event[Event.HEIGHT], covariance)
        if start is not None:
            for level, text in start.notes:
                say(level, text)
        elif self.waiting_for != before:
            say('info', f'waiting for {self.waiting_for}')
        return start

    def add_fix(self, time, latitude, longitude, height, covariance) -> Start | None:
        """Add one valid fix of the antenna; covariance: north-east (2, 2) m^2. Returns the start once there is one."""
        if not self._count:
            return None
        variance = float(0.5 * (covariance[0, 0] + covariance[1, 1]))
        self._learn_noise(time, latitude, longitude, height, variance)
        self._keep_fix(time, latitude, longitude, variance, height, covariance)
        ahead = time - self._samples[-1, 0]
        self.contradicted = ahead > self.config.ahead
        if self.contradicted:
            self.waiting_for = (f'fixes whose stamps agree with those of {self.config.imu.topic}: they are '
                                f'{ahead:.1f} s ahead (gnss.time_offset)')
        if self._fixes[-1][0] > time or self.contradicted or time <= self._imu[0, 0]:
            return None
        problem = problem_of_samples(self._samples, self.config)
        if problem:
            self.waiting_for, self.contradicted = problem, True
            return None
        positions = self._positions()
        source = self.config.alignment.heading
        try:
            self._check_mounting(positions)
            return self._start_from_saved(positions) or (
                self._start_from_course(positions) if source == 'course' else
                self._start_with_heading(source, positions))
        except Refused as reason:
            if isinstance(reason, Backwards) and not self._mounting_problem:
                standstill = self._standstill(positions)
                self._mounting_problem, self._drove_off = reason, standstill.end if standstill else -math.inf
            self.waiting_for, self.contradicted = str(reason), isinstance(reason, Contradicted)
            return None

    @property
    def is_watching(self) -> bool:
        """Whether the motion may still show, after the start, that the IMU is mounted in another direction."""
        return bool(self.config.vehicle.lateral_sigma and not self._forwards and self._count
                    and self._imu[self._count - 1, 0] - self._started < LONGEST_WATCHED)

    def takes_back_the_start(self, event: np.ndarray, say) -> bool:
        """Add one valid fix after the start, as an event. Returns whether the motion by now contradicts the mounting:
        then there is no start yet. Messages to the user go to say(level, text)."""
        variance = 0.5 * (event[Event.R_NN] + event[Event.R_EE])
        self._keep_fix(*event[[Event.TIME, Event.LATITUDE, Event.LONGITUDE]], variance, event[Event.HEIGHT], None)
        before, now = (fix[0] // STILL_BLOCK for fix in self._fixes[-2:]) if len(self._fixes) > 1 else (-1.0, 0.0)
        if before == now:  # the motion is looked at in blocks of that length
            return False
        found = direction_in_motion(self._samples, self._in_blocks(), self._positions())
        problem = '' if found is None else self._judge_motion(found)
        if problem:
            self.waiting_for, self.contradicted = problem, True
            say('error', f'{self.config.imu.topic}: the start is taken back; waiting for {problem}')
        return bool(problem)

    def provisional(self) -> Start | None:
        """A start while the heading is unknown: at the newest fix, at rest or at an unknown velocity.

        None before there are enough fixes for a datum, and while the samples contradict the configuration. The yaw is
        east, with the standard deviation of a uniformly distributed heading.
        """
        latest = self._samples[-1, 0] + self.config.ahead
        if (len(self._fixes) < DATUM_FIXES or self._fixes[-1][0] > latest
                or problem_of_samples(self._samples, self.config)):
            return None
        time, latitude, longitude, _, height, r = self._fixes[-1]
        r = self._realised * r
        positions, imu = self._positions(), self._samples
        recent = imu[imu[:, 0] > imu[-1, 0] - RECENT]
        still = latest_standstill(recent, blocks_of(recent), positions, self.config)
        speed = STANDING_SIGMA
        if still is None or imu[-1, 0] - still.end > 2 * STILL_BLOCK:
            before, now = positions[-2:]
            moved = math.hypot(*(now[1:3] - before[1:3]))
            speed = math.hypot(moved, before[3], now[3]) / max(now[0] - before[0], 0.1)
        arm = self.config.gnss.lever_arm
        ahead = max(time - imu[-1, 0], 0.0)  # the state must not be later than the newest sample
        position = r + np.eye(2) * (0.5 * (arm[0] ** 2 + arm[1] ** 2) + (ahead * speed) ** 2)
        covariance = np.zeros((5, 5))
        covariance[:2, :2] = position
        covariance[[2, 3, 4], [2, 3, 4]] = speed**2, speed**2, UNKNOWN_YAW_SIGMA**2
        return Start(time - ahead, latitude, longitude, height + arm[2], np.zeros(2), math.pi / 2, covariance, still,
                     gnss_scale=self._scale.copy(), has_height=self._has_height)

    def _keep_fix(self, *fix) -> None:
        """Keep a fix: time, latitude, longitude, variance, height, covariance."""
        self._forget(fix[0] - LONGEST_KEPT)
        insort(self._fixes, fix, key=lambda fix: fix[0])

    def _forget(self, before: float) -> None:
        first = int(np.searchsorted(self._samples[:, 0], before))
        if first > self._count // 2:
            self._imu[:self._count - first] = self._imu[first:self._count]
            self._count -= first
            self._blocks = None
        while self._fixes and self._fixes[0][0] < before:
            self._fixes.pop(0)
        self._fields = [field for field in self._fields if field[0] >= before]
        self._places = {number: [place for place in places if place[0] >= before]
                        for number, places in self._places.items()}

    def _positions(self) -> np.ndarray:
        """The fixes (k, 4): time, s; north and east from the first one, m; sigma, m."""
        return self._relative([fix[:4] for fix in self._fixes])

    def _relative(self, places) -> np.ndarray:
        """Time, latitude, longitude and variance (k, 4) as time, s, north and east from the first fix, and sigma, m."""
        _, latitude, longitude, _, height, _ = self._fixes[0]
        north, east = radii(latitude)
        positions = np.array(places)
        positions[:, 1] = (positions[:, 1] - latitude) * (north + height)
        positions[:, 2] = (near(positions[:, 2], longitude) - longitude) * (east + height) * math.cos(latitude)
        positions[:, 3] = np.sqrt(self._realised * positions[:, 3])
        return positions

    @property
    def _white(self) -> float:
        """Share of the claimed variance of the fixes that is white noise; the rest may be slow errors."""
        return min(scale(self._scale, 0), 1.0)

    @property
    def _realised(self) -> float:
        """Realised over claimed variance of the fixes, at least 1: what does not show as white noise may be slow."""
        return max(scale(self._scale, 0), 1.0)

    def _learn_noise(self, *fix) -> None:
        """Learn the noise of the fixes from the deviation of a new one (time, latitude, longitude, height, variance)
        from the straight line through the fixes before it.

        At rest the line has up to LINE_FIXES fixes. The deviations are then the recursive residuals of a regression,
        which are independent of each other (R. L. Brown, J. Durbin, J. M. Evans, "Techniques for testing the constancy
        of regression relationships over time", J. Royal Statistical Society B 37, 1975). In motion it has two. The
        deviation then contains the errors of three fixes and the acceleration of the vehicle, for which the inertial
        sensors give a bound although the heading is unknown.
        """
        if self._track and fix[0] - self._track[-1][0] < SHORTEST_PAIR:
            return
        track, self._track = self._track, [*self._track[1 - LINE_FIXES:], fix]
        if len(track) < 2:
            return
        motion = inertial_motion(self._samples, track[-2][0], fix[0], None, self.config)
        if motion is None:
            return
        first_sample, last_sample = np.searchsorted(self._samples[:, 0], [track[-2][0], fix[0]])
        quiet, changed = is_quiet(self._samples[first_sample:last_sample], self.config), 0.0
        if not quiet:
            track, self._track = track[-2:], self._track[-2:]
            changed = 0.5 * (fix[0] - track[-1][0]) * (
                math.hypot(*motion.gained) + motion.bias_f * (fix[0] - track[-2][0]))
        off, variance = _off_line(track, fix)
        self._consistent += learn_changes(self._scale, 0, fix[0], 0.5 * float(off @ off), variance, 0.5 * changed**2, 2,
                                          1.0 if quiet else OVERLAP)

    def _standstill(self, positions) -> Standstill | None:
        return latest_standstill(self._samples, self._in_blocks(), positions, self.config)

    def _in_blocks(self) -> Blocks:
        """The samples in blocks."""
        known = 0 if self._blocks is None else self._blocks.starts[-1] + self._blocks.length[-1]
        if known < self._count:
            self._blocks = blocks_of(self._samples, self._blocks)
        return self._blocks

    def _lasts(self, standstill: Standstill | None) -> bool:
        """Whether there is a standstill that has not ended."""
        return standstill is not None and self._samples[-1, 0] - standstill.end < 2 * STILL_BLOCK

    def standing(self) -> Standstill | None:
        """The standstill at present; None where the vehicle moves or there are not enough fixes to tell."""
        if not self._count or len(self._fixes) < 2:
            return None
        standstill = self._standstill(self._positions())
        return standstill if self._lasts(standstill) else None

    def _start_from_saved(self, positions) -> Start | None:
        """Start with the heading of the saved state, if the vehicle has not moved since."""
        saved = self._saved
        if saved is None or not math.isfinite(saved.yaw_sigma) or (
                self._samples[-1, 0] - self._first > LONGEST_SAVED):
            return None
        standstill = self._standstill(positions)
        if not self._lasts(standstill):
            return None
        _, latitude, longitude, _, height, _ = self._fixes[-1]
        away = math.hypot(*to_local(latitude, longitude, height, saved.position)[:2])
        if standstill.end - standstill.duration > self._first + SEEN_FROM_BEGIN or away > saved.max_distance:
            return None
        return self._start(saved.yaw, saved.yaw_sigma, 0.0, STANDING_SIGMA, standstill, 'heading from the state file')

    def _start_with_heading(self, source, positions) -> Start | None:
        """Start with the heading of a parameter or of the IMU's orientation; velocity zero at standstill, else from the
        fixes."""
        if source == 'parameter':
            yaw = self.config.alignment.yaw
        elif self._orientation is None:
            raise Refused(f'orientation in the messages on {self.config.imu.topic}')
        else:
            yaw = self._heading_of_orientation()
        standstill = self._standstill(positions)
        speed, speed_sigma = 0.0, STANDING_SIGMA
        if not self._lasts(standstill):
            course = find_course(self._samples, positions, standstill, self.config, self._white, self._forwards)
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

    def _check_mounting(self, positions) -> None:
        """Raises Contradicted where standstill or driving off contradict the configured unit or mounting."""
        topic = self.config.imu.topic
        rate = tumbling_rate(self._samples, self._in_blocks(), positions, self.config)
        if rate:
            raise Contradicted(f'a possible turn rate on {topic}: angular_velocity is {rate:.3f} rad/s at rest, '
                               'about an axis about which no vehicle turns; if the driver delivers deg/s, set '
                               "imu.rate_unit to 'deg/s'")
        if not self.config.vehicle.lateral_sigma:
            return  # without the non-holonomic constraint the vehicle may drive off in any direction
        standstill = self._standstill(positions)
        self._look_at_direction(positions, standstill)
        if self._mounting_problem and not (isinstance(self._mounting_problem, Backwards)
                                           and self._has_reversed(positions, standstill)):
            raise self._mounting_problem

    def _look_at_direction(self, positions, standstill) -> None:
        """Set what the direction of motion, or of driving off, shows to be wrong with the mounting."""
        known = self._mounting_problem
        if isinstance(known, Backwards) and standstill is not None and standstill.end > self._drove_off:
            self._mounting_problem = None  # it drives off again, which shows it again
        in_motion = direction_in_motion(self._samples, self._in_blocks(), positions)
        if in_motion is not None:
            self._judge_motion(in_motion)
        elif standstill is not None and self._drove_off < math.inf:  # no better evidence so far
            # the direction is that of the inertial sensors; the fixes, with their claimed noise, confirm the distance
            claimed = positions / [1.0, 1.0, 1.0, math.sqrt(self._realised)]
            found = driven_off(self._samples, claimed, standstill, self.config)
            if found is not None:
                self._set_problem(problem_of_direction(found, 'drives off'),
                                  Backwards if is_backwards(found) else Contradicted)
                self._drove_off = standstill.end

    def _judge_motion(self, direction: float) -> str:
        """Set and return what `direction_in_motion` shows to be wrong with the mounting; '' where it is right."""
        problem = problem_of_direction(direction, 'moves')
        self._forwards, self._drove_off = not problem, math.inf
        self._set_problem(problem, Contradicted)
        return problem

    def _set_problem(self, problem: str, kind: type[Contradicted]) -> None:
        if not problem:
            self._mounting_problem = None
        elif type(self._mounting_problem) is not kind:  # the first one stays: others have slightly different numbers
            self._mounting_problem = kind(problem)

    def _has_reversed(self, positions, standstill) -> bool:
        """Whether a vehicle that went backwards now moves forwards: then the IMU is not mounted backwards."""
        if standstill is None or self._samples[-1, 0] - standstill.end > LONGEST_COURSE_TIME:
            return False
        try:
            course = find_course(self._samples, positions, standstill, self.config, self._white, self._forwards)
        except Refused:
            return False
        return course is not None and course.speed > FASTEST_REVERSE

    def _start_from_course(self, positions) -> Start | None:
        course = standstill = None
        source = 'heading from the course'
        if has_moved(positions, self._white) and self._consistent >= FEWEST_CONSISTENT:
            standstill = self._standstill(positions)
            course = self._course_of_receivers(positions)
            if course is not None:
                source = 'heading from two receivers'
            else:
                course = find_course(self._samples, positions, standstill, self.config, self._white, self._forwards)
        if course is None and self._magnetometer is not None:
            return self._start_from_field(positions)
        if course is None:
            raise Refused('the vehicle to move straight on: its course shows the heading')
        return self._start(course.yaw, course.yaw_sigma, course.speed, course.speed_sigma, standstill, source)

    def _course_of_receivers(self, positions) -> Course | None:
        """Heading and speed from the main receiver and the further one that shows the heading best."""
        found, begin = [], positions[-1, 0] - RECENT
        for number, one in self._receivers.items():
            places = sorted(place for place in self._places[number] if place[0] > begin)
            if places:
                found.append(find_heading(positions, self._relative(places),
                                          (one.arm - self.config.gnss.lever_arm)[:2],
                                          self.config.parameters[f'{one.name}.lever_arm_sigma']))
        return min(filter(None, found), key=lambda course: course.yaw_sigma, default=None)

    def _start_from_field(self, positions) -> Start:
        """Start with the heading from the magnetic field, for a vehicle whose fixes show no course."""
        fields = np.array(sorted(self._fields)).reshape(-1, 6)
        standstill = self._standstill(positions)
        found = find_magnetic_heading(self._samples, fields, standstill, self.config, self._magnetometer.name,
                                      self._saved.errors if self._saved else None)
        if found is None:
            topic = self.config.settings_of(self._magnetometer.number).topic
            raise Refused(f'the vehicle to move straight on, or turns that show the iron which disturbs {topic}')
        speed, speed_sigma = 0.0, STANDING_SIGMA
        if not self._lasts(standstill):
            speed, speed_sigma = self._slow_speed(found.yaw + self._known_mounting, positions)
        start = self._start(found.yaw + self._known_mounting, found.sigma, speed, speed_sigma, standstill,
                            'heading from the magnetic field')
        return replace(start, iron=found.iron)

    @property
    def _known_mounting(self) -> float:
        """Yaw of the vehicle in the body's axes, as saved by an earlier run, rad."""
        state = self.config.layout.index('mounting_yaw') - self.config.layout.n_navigation
        return float(self._saved.errors.estimate[state]) if (
            state >= 0 and self._saved and self._saved.errors) else 0.0

    def _slow_speed(self, yaw, positions) -> tuple[float, float]:
        """Speed along the heading and its sigma, m/s, from the fixes of the last seconds. Raises Refused where they
        move sideways, or so fast that the course gives the heading."""
        recent = positions[positions[:, 0] >= positions[-1, 0] - RECENT]
        if len(recent) < 2:
            raise Refused('more fixes to tell how fast the vehicle moves')
        moved, interval = recent[-1, 1:3] - recent[0, 1:3], recent[-1, 0] - recent[0, 0]
        noise = math.hypot(recent[0, 3], recent[-1, 3])
        along = math.cos(yaw) * moved[0] + math.sin(yaw) * moved[1]
        across = math.cos(yaw) * moved[1] - math.sin(yaw) * moved[0]
        if abs(across) > max(DISPLACEMENT_SIGMAS * noise, abs(along)):
            raise Refused('a magnetic heading that agrees with the fixes, which move sideways to it')
        if math.hypot(*moved) > SLOW_SPEED * interval + DISPLACEMENT_SIGMAS * noise:
            raise Refused('the vehicle to move straight on: it is fast enough for its course to show the heading')
        return float(along / interval), math.hypot(noise / interval, SPEED_CHANGE_SIGMA)

    def _start(self, yaw, yaw_sigma, speed, speed_sigma, standstill, source) -> Start:
        time, latitude, longitude, _, height, r = self._fixes[-1]
        self._started = time
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
                     errors=self._saved.errors if self._saved else None, gnss_scale=self._scale.copy(),
                     wheels=self._saved.wheels if self._saved else None, has_height=self._has_height)


def _off_line(track: list[tuple], fix: tuple) -> tuple[np.ndarray, float]:
    """Deviation of a fix from the regression line through two or more earlier ones, (2,) north and east, m, and the
    variance of a component, m^2, computed from the variances of all these fixes. A fix: as for `_learn_noise`."""
    time = np.array([earlier[0] for earlier in track])
    variance = np.array([earlier[4] for earlier in track])
    position = np.array([to_local(*earlier[1:4], fix[1:4])[:2] for earlier in track])
    weight = 1.0 / variance / np.sum(1.0 / variance)
    middle = weight @ time
    share = weight * (1.0 + (fix[0] - middle) * (time - middle) / (weight @ (time - middle) ** 2))
    return share @ position, float(fix[4] + share**2 @ variance)
