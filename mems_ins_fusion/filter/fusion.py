"""The event-driven filter: fed with samples and fixes as they arrive, live or from a recording.

`FusionFilter` takes one event at a time; `run` takes a whole recording through the same alignment and the same kernel.
Both give the same numbers, bit for bit, for the same events in the same order.
"""
from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, replace

import numpy as np

from mems_ins_fusion.compiled import njit

from ..navigation.strapdown import to_euler
from ..samples import Fixes, ImuSamples
from .alignment import Alignment, Start, retaken
from .config import FilterConfig
from .initial import initialize
from .kernel import FIX_TAKEN, FIX_TOO_LATE, take_fix, take_sample
from .kernel import run as run_kernel
from .layout import FIX_SIZE, NAV, Fix, Nav, covariance_index
from .odometry import SIZE, corrected, odometry

#: samples in a row whose stamps do not follow, after which the clock is believed to have jumped
JUMP_COUNT = 5
#: a fix stamped this much after the newest IMU sample is not of the same clock, s
LATEST_FIX = 5.0
#: position of a fix is not better than this, m
SMALLEST_SIGMA = 0.001


@dataclass(frozen=True)
class Notice:
    """Something a user should know. level: info, warning or error."""

    level: str
    text: str


class _Intake:
    """What both ways into the filter share: which events are good, and what to say of the others."""

    def __init__(self, config: FilterConfig):
        self.config = config
        self._last_stamp: int | None = None
        self._jump_stamp: int | None = None
        self._jumps = 0
        self._last_fix_stamp: int | None = None
        self._notices: list[Notice] = []
        self._restart_gap = round(config.values['imu.restart_gap'] * 1e9)
        self._offset = round(config.values['gnss.time_offset'] * 1e9)

    def notices(self) -> list[Notice]:
        """What has happened since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def _say(self, level: str, text: str) -> None:
        self._notices.append(Notice(level, text))

    def _say_not_finite(self, f_x, f_y, f_z, w_x, w_y, w_z) -> None:
        self._say('warning', f"{self.config.values['imu_topic']}: linear_acceleration ({f_x}, {f_y}, {f_z}), "
                             f'angular_velocity ({w_x}, {w_y}, {w_z}): sample dropped')

    def _follows(self, stamp: int) -> bool | None:
        """Whether an IMU stamp follows the last one; None when the clock has jumped and all must begin anew."""
        last = self._last_stamp
        if last is None or 0 < stamp - last <= self._restart_gap:
            self._last_stamp, self._jumps = stamp, 0
            return True
        self._jumps = self._jumps + 1 if self._jumps and stamp > self._jump_stamp else 1
        self._jump_stamp = stamp
        topic = self.config.values['imu_topic']
        if self._jumps >= JUMP_COUNT:
            self._say('warning', f'{topic}: header.stamp jumped by {(stamp - last) * 1e-9:+.3f} s and stays there: '
                                 'the filter aligns anew')
            self._last_stamp, self._jumps = stamp, 0
            return None
        self._say('warning', f'{topic}: header.stamp {stamp * 1e-9:.6f} s does not follow {last * 1e-9:.6f} s: '
                             'sample dropped')
        return False

    def _check_fix(self, stamp, latitude, longitude, height, covariance, status, covariance_type):
        """The fix as the kernel takes it, TIME still as stamped in ns; None for one that cannot be used."""
        topic, values = self.config.values['gnss_topic'], self.config.values
        if status < 0:
            self._say('warning', f'{topic}: status {int(status)}: no fix')
            return None
        if not (math.isfinite(latitude) and math.isfinite(longitude) and math.isfinite(height)):
            self._say('warning', f'{topic}: latitude, longitude, altitude {math.degrees(latitude)}, '
                                 f'{math.degrees(longitude)}, {height}: fix dropped')
            return None
        if abs(latitude) > math.pi / 2 or abs(longitude) > 2 * math.pi:
            self._say('warning', f'{topic}: latitude {math.degrees(latitude):.6f}, longitude '
                                 f'{math.degrees(longitude):.6f} deg is not on earth: fix dropped')
            return None
        if stamp == self._last_fix_stamp:
            self._say('warning', f'{topic}: header.stamp {stamp * 1e-9:.6f} s came twice: second fix dropped')
            return None
        self._last_fix_stamp = stamp
        r = np.zeros(FIX_SIZE)
        r[Fix.LATITUDE], r[Fix.LONGITUDE], r[Fix.HEIGHT] = latitude, longitude, height
        r[Fix.R_NN], r[Fix.R_NE], r[Fix.R_EE], r[Fix.R_DD] = self._fix_covariance(covariance, covariance_type, topic)
        if values['gnss.sigma'] > 0:
            r[Fix.R_NN] = r[Fix.R_EE] = values['gnss.sigma'] ** 2
            r[Fix.R_NE] = 0.0
            r[Fix.R_DD] = max(r[Fix.R_DD], values['gnss.sigma'] ** 2)
        return r

    def _fix_covariance(self, covariance, covariance_type, topic):
        """R_nn, R_ne, R_ee, R_dd from the message's east-north-up covariance; the default where it says nothing."""
        ee, en, nn, uu = (float(covariance[i]) for i in (0, 1, 4, 8))
        smallest = SMALLEST_SIGMA**2
        usable = all(math.isfinite(v) for v in (ee, en, nn, uu)) and min(ee, nn) > 0 and nn * ee > en * en
        if covariance_type == 0 or not usable:
            sigma = self.config.values['gnss.default_sigma']
            if self.config.values['gnss.sigma'] == 0:
                self._say('warning', f'{topic}: position_covariance (type {int(covariance_type)}) [{ee:g}, {en:g}, .., '
                                     f'{nn:g}, .., {uu:g}] says nothing: gnss.default_sigma {sigma:g} m is used')
            return sigma**2, 0.0, sigma**2, 4 * sigma**2
        return max(nn, smallest), en, max(ee, smallest), max(uu, smallest) if uu > 0 else 4 * max(nn, ee)

    def _say_not_taken(self, answer: int, stamp: int, newest: int) -> None:
        topic = self.config.values['gnss_topic']
        if answer == FIX_TOO_LATE:
            self._say('warning', f'{topic}: fix stamped {stamp * 1e-9:.3f} s came {(newest - stamp) * 1e-9:.2f} s '
                                 'after the IMU samples of its time: later than gnss.max_delay, or the clocks differ '
                                 '(gnss.time_offset); dropped')

    def _align(self, alignment: Alignment, record, time: float) -> Start | None:
        covariance = np.array([[record[Fix.R_NN], record[Fix.R_NE]], [record[Fix.R_NE], record[Fix.R_EE]]])
        before = alignment.waiting_for
        start = alignment.add_fix(time, record[Fix.LATITUDE], record[Fix.LONGITUDE], record[Fix.HEIGHT], covariance)
        if start is not None:
            for level, text in start.notes:
                self._say(level, text)
        elif alignment.waiting_for != before:
            self._say('info', f'waiting for {alignment.waiting_for}')
        return start

    def _out_of_time(self, stamp: int, newest: int) -> bool:
        """True for a fix so far from the newest sample that it comes too late or its clock is another."""
        ahead = (stamp - newest) * 1e-9
        if -ahead > self.config.values['gnss.max_delay']:
            self._say_not_taken(FIX_TOO_LATE, stamp, newest)
            return True
        if ahead > LATEST_FIX:
            self._say('warning', f"{self.config.values['gnss_topic']}: fix stamped {ahead:.1f} s after the newest IMU "
                                 'sample: the clocks differ (gnss.time_offset); dropped')
        return ahead > LATEST_FIX


class FusionFilter(_Intake):
    """The live filter. Stamps are integer nanoseconds; IMU samples are in sensor axes."""

    def __init__(self, config: FilterConfig):
        super().__init__(config)
        self.odometry = np.zeros(SIZE)
        self.geodetic = np.zeros(3)
        self.position_covariance_enu = np.zeros(9)
        self.datum = _datum(config)
        self._height_sigma = config.values['gnss.default_sigma']
        self._outage_after = round(config.values['gnss.outage_after'] * 1e9)
        self._correctors = config.correctors()
        self._celsius = math.nan
        self._restart()

    def _restart(self) -> None:
        self._alignment = Alignment(self.config)
        self._memory: np.ndarray | None = None
        self._epoch: int | None = None
        self._newest_fix = 0
        self._outage = False
        self._last_fix_stamp = None

    @property
    def status(self) -> str:
        """What the filter is doing, in a few words."""
        if self._memory is None:
            return f'waiting for {self._alignment.waiting_for}'
        if self._outage:
            return f'outage for {(self._last_stamp - self._newest_fix) * 1e-9:.1f} s'
        return 'running'

    def add_imu(self, stamp: int, f_x, f_y, f_z, w_x, w_y, w_z, q_x=0.0, q_y=0.0, q_z=0.0, q_w=0.0) -> bool:
        """One IMU sample, sensor axes: specific force m/s^2, angular rate rad/s. True when there is a new estimate.

        The quaternion is `Imu.orientation`, zero where the driver has none.
        """
        if not math.isfinite(f_x + f_y + f_z + w_x + w_y + w_z):
            self._say_not_finite(f_x, f_y, f_z, w_x, w_y, w_z)
            return False
        follows = self._follows(stamp)
        if not follows:
            if follows is None:
                self._restart()
            else:
                return False
        if self._correctors:
            (f_x, f_y, f_z), (w_x, w_y, w_z) = self._corrected(stamp, (f_x, f_y, f_z), (w_x, w_y, w_z))
        if self._memory is not None:
            take_sample(self._memory, (stamp - self._epoch) * 1e-9, f_x, f_y, f_z, w_x, w_y, w_z)
            if stamp - self._newest_fix > self._outage_after and not self._outage:
                self._outage = True
                self._say('warning', f"no fix on {self.config.values['gnss_topic']} for "
                                     f'{(stamp - self._newest_fix) * 1e-9:.1f} s: coasting on prediction')
            return True
        if self._epoch is None:
            self._epoch = stamp
            self._alignment.waiting_for = f"a fix on {self.config.values['gnss_topic']}"
            self._say('info', f'waiting for {self._alignment.waiting_for}')
        self._alignment.add_samples([(stamp - self._epoch) * 1e-9], [(f_x, f_y, f_z)], [(w_x, w_y, w_z)],
                                    [(q_x, q_y, q_z, q_w)])
        return False

    def _corrected(self, stamp: int, f: tuple, w: tuple) -> tuple:
        stamps, celsius = np.array([stamp], dtype=np.int64), np.array([self._celsius])
        force, rate = _correct(self._correctors, stamps, np.array([f]), np.array([w]), celsius)
        return force[0].tolist(), rate[0].tolist()

    def add_temperature(self, stamp: int, celsius: float) -> None:
        """The sensors' temperature from now on, degrees Celsius."""
        if math.isfinite(celsius):
            self._celsius = celsius
        else:
            self._say('warning', f"{self.config.values['temperature_topic']}: temperature {celsius}: dropped")

    def add_fix(self, stamp: int, latitude, longitude, height, covariance, status=0, covariance_type=2) -> None:
        """One fix of the antenna: rad, m; covariance: nine numbers, east-north-up, as in `NavSatFix`."""
        if self._epoch is None:  # nothing to compare it with yet
            return
        record = self._check_fix(stamp, latitude, longitude, height, covariance, status, covariance_type)
        if record is None:
            return
        stamp -= self._offset
        if self._out_of_time(stamp, self._last_stamp):
            return
        record[Fix.TIME] = (stamp - self._epoch) * 1e-9
        self._height_sigma = math.sqrt(record[Fix.R_DD])
        if self._memory is None:
            start = self._align(self._alignment, record, record[Fix.TIME])
            if start is not None:
                self._begin(start, stamp)
            return
        answer = take_fix(self._memory, record)
        if answer != FIX_TAKEN:
            self._say_not_taken(answer, stamp, self._last_stamp)
            return
        self._newest_fix = max(self._newest_fix, stamp)
        if self._outage and self._last_stamp - stamp < self._outage_after:
            self._outage = False
            self._say('info', f"fixes on {self.config.values['gnss_topic']} again")

    def _begin(self, start: Start, stamp: int) -> None:
        memory = self.config.memory()
        initialize(memory, self.config, start)
        if self.datum is None:
            self.datum = np.array([start.latitude, start.longitude, start.height])
        for time, *sample in self._alignment.samples_after(start.time):
            take_sample(memory, time, *sample)
        self._memory, self._newest_fix = memory, stamp

    def update_odometry(self) -> int:
        """Fill `odometry`, `geodetic` and `position_covariance_enu` for the newest estimate; its stamp in ns."""
        odometry(self._memory, self.datum, self._height_sigma, self.odometry, self.geodetic,
                 self.position_covariance_enu)
        return self._last_stamp

    def warm_up(self) -> None:
        """Compile or load the kernel now, so that the first message is not late."""
        memory = self.config.memory()
        initialize(memory, self.config, Start(0.0, 0.0, 0.0, 0.0, np.zeros(2), 0.0, np.eye(5), None))
        take_sample(memory, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        record = np.zeros(FIX_SIZE)
        record[Fix.TIME] = 0.005
        record[Fix.R_NN] = record[Fix.R_EE] = record[Fix.R_DD] = 1.0
        take_fix(memory, record)
        odometry(memory, np.zeros(3), 1.0, self.odometry.copy(), self.geodetic.copy(),
                 self.position_covariance_enu.copy())


def _correct(correctors: list, stamp, force, rate, celsius) -> tuple[np.ndarray, np.ndarray]:
    """Specific force and angular rate (n, 3), sensor axes, without the effects that are declared."""
    for corrector in correctors:
        force, rate = corrector(stamp, force, rate, celsius)
    return force, rate


def _datum(config: FilterConfig) -> np.ndarray | None:
    datum = config.values['datum']
    if not datum:
        return None
    return np.array([math.radians(datum[0]), math.radians(datum[1]), datum[2]])


@dataclass(frozen=True)
class Innovations:
    """What each fix told the filter, in the order of the fixes' times.

    index (f,): position in the `Fixes` given. stamp (f,): ns, at which the fix describes the vehicle. z (f, 2):
    innovation north, east, m, predicted minus measured antenna position. s (f, 3): its covariance nn, ne, ee. nis
    (f,): normalized innovation squared, 2 degrees of freedom. z_down, s_down (f,): the same for height (strapdown).
    yaw (f,), velocity (f, 2): the prediction's, before the fix was applied.
    """

    index: np.ndarray
    stamp: np.ndarray
    z: np.ndarray
    s: np.ndarray
    nis: np.ndarray
    z_down: np.ndarray
    s_down: np.ndarray
    yaw: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True)
class Run:
    """One recording through the filter, at each IMU sample from the first estimate on.

    stamp (k,) ns. index (k,): of each in the `ImuSamples` given. latitude, longitude (k,) rad, height (k,) m, velocity
    (k, 3) m/s in `n`, roll, pitch, yaw (k,) rad. sensor_errors (k, channels): estimates. sigma (k, n): square roots of
    the covariance's diagonal, navigation errors first. covariance_ne (k,): of north and east position error, m^2.
    memory: the kernel's memory at the end. filter_seconds: CPU time of the filter alone.
    """

    config: FilterConfig
    stamp: np.ndarray
    index: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    velocity: np.ndarray
    roll: np.ndarray
    pitch: np.ndarray
    yaw: np.ndarray
    sensor_errors: np.ndarray
    sigma: np.ndarray
    covariance_ne: np.ndarray
    innovations: Innovations
    start: Start | None
    notices: list[Notice]
    memory: np.ndarray | None
    filter_seconds: float


def run(config: FilterConfig, imu: ImuSamples, fixes: Fixes, start: Start | None = None, states: bool = True) -> Run:
    """The whole recording in one call: the same events in the order of their arrival, the same numbers as live.

    start: begin there instead of aligning, where the recording has no restart. states: false leaves all but the
    innovations out of the result.
    """
    return _Replay(config, imu, fixes, start, states).run()


class _Replay(_Intake):
    """A recording on its way through the filter: stretches between restarts, aligned and run one by one."""

    def __init__(self, config: FilterConfig, imu: ImuSamples, fixes: Fixes, given: Start | None = None,
                 states: bool = True):
        super().__init__(config)
        self.imu, self.fixes, self.given = imu, fixes, given
        # a fix that arrived together with a sample comes after it
        self.arrival = np.searchsorted(imu.received, fixes.received, side='right')
        self.columns = _columns(config) if states else np.empty(0, dtype=np.uint64)
        self.parts: list[_Part] = []
        self.start: Start | None = None
        self.memory: np.ndarray | None = None
        self.seconds = 0.0

    def run(self) -> Run:
        segments = self._segments()
        self._correct_samples(segments)
        ends = [kept[0] for kept in segments[1:]] + [np.iinfo(np.int64).max]
        for kept, end in zip(segments, ends):
            self._run_segment(kept, end)
        return self._result()

    def _segments(self) -> list[np.ndarray]:
        """Indices of the good samples, one array for each stretch between restarts."""
        stamp = self.imu.stamp
        finite = np.isfinite(self.imu.specific_force).all(axis=1) & np.isfinite(self.imu.angular_rate).all(axis=1)
        step = np.diff(stamp)
        if finite.all() and np.all((step > 0) & (step <= self._restart_gap)):
            return [np.arange(len(stamp))] if len(stamp) else []
        segments: list[list[int]] = [[]]
        for i in range(len(stamp)):
            if not finite[i]:
                self._say_not_finite(*self.imu.specific_force[i], *self.imu.angular_rate[i])
                continue
            follows = self._follows(int(stamp[i]))
            if follows is None:
                segments.append([])
            if follows is not False:
                segments[-1].append(i)
        return [np.array(kept, dtype=np.int64) for kept in segments if kept]

    def _correct_samples(self, segments: list[np.ndarray]) -> None:
        correctors = self.config.correctors()
        if not correctors or not segments:
            return
        kept = np.concatenate(segments)
        force, rate = self.imu.specific_force.copy(), self.imu.angular_rate.copy()
        celsius = self.imu.temperature
        celsius = np.full(len(kept), np.nan) if celsius is None else celsius[kept]
        force[kept], rate[kept] = _correct(correctors, self.imu.stamp[kept], force[kept], rate[kept], celsius)
        self.imu = replace(self.imu, specific_force=force, angular_rate=rate)

    def _run_segment(self, kept: np.ndarray, end: int) -> None:
        """Align on the samples `kept` and run the rest; `end`: the index of the sample with which the next begins."""
        epoch = int(self.imu.stamp[kept[0]])
        time = (self.imu.stamp[kept] - epoch) * 1e-9
        mine = np.flatnonzero((self.arrival > kept[0]) & (self.arrival <= end))
        before = np.searchsorted(kept, self.arrival[mine])  # samples of this stretch that came before each fix
        used, records = self._check_fixes(mine, self.imu.stamp[kept[before - 1]], epoch)
        mine, before = mine[used], before[used]
        start, first = self._align_segment(kept, time, before, records)
        if start is None:
            return
        self.start = self.start or start
        memory = self.config.memory()
        initialize(memory, self.config, start)
        skip = int(np.searchsorted(time, start.time, side='right'))
        samples = kept[skip:]
        records, index = np.ascontiguousarray(records[first:]), mine[first:]
        answers = np.zeros(len(records), dtype=np.int64)
        began = clock.thread_time()
        samples, states = self._filter(memory, time[skip:], samples, records, before[first:] - skip, answers, epoch)
        self.seconds += clock.thread_time() - began
        self.memory = memory
        for i in np.flatnonzero(answers != FIX_TAKEN):
            self._say_not_taken(answers[i], epoch + round(records[i, Fix.TIME] * 1e9),
                                int(self.imu.stamp[kept[before[first + i] - 1]]))
        applied = records[:, Fix.APPLIED] == 1.0
        self.parts.append(_Part(samples, states, epoch, index[applied], records[applied]))

    def _filter(self, memory, time, samples, records, arrival, answers, epoch) -> tuple[np.ndarray, np.ndarray]:
        """`samples` (indices) through the kernel: those whose states are kept, and the states."""
        states = np.empty((len(samples), len(self.columns)))
        run_kernel(memory, time, *self._inputs(samples), records, arrival, answers, self.columns, states)
        return samples, states

    def _inputs(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Specific force and angular rate of `samples` (indices)."""
        n = len(samples)
        part = slice(samples[0], samples[0] + n) if n and samples[-1] - samples[0] == n - 1 else samples  # no copy
        return self.imu.specific_force[part], self.imu.angular_rate[part]

    def _check_fixes(self, mine: np.ndarray, newest: np.ndarray, epoch: int) -> tuple[np.ndarray, np.ndarray]:
        """Which of the fixes can be used (positions in `mine`), and those as the kernel takes them."""
        self._last_fix_stamp = None
        records = self._plain_records(mine, newest, epoch)
        if records is not None:
            return np.arange(len(mine)), records
        used, records = [], []
        for k, i in enumerate(mine.tolist()):
            f = self.fixes
            stamp = int(f.stamp[i])
            record = self._check_fix(stamp, float(f.latitude[i]), float(f.longitude[i]), float(f.height[i]),
                                     f.covariance[i].ravel(), f.status[i], f.covariance_type[i])
            if record is None or self._out_of_time(stamp - self._offset, int(newest[k])):
                continue
            record[Fix.TIME] = (stamp - self._offset - epoch) * 1e-9
            used.append(k)
            records.append(record)
        return np.array(used, dtype=np.int64), np.array(records).reshape(-1, FIX_SIZE)

    def _plain_records(self, mine: np.ndarray, newest: np.ndarray, epoch: int) -> np.ndarray | None:
        """The fixes as the kernel takes them, at once, where there is nothing to say of any; else None."""
        f, values = self.fixes.select(mine), self.config.values
        stamp = f.stamp - self._offset
        ahead = (stamp - newest) * 1e-9
        ee, en, nn, uu = (f.covariance[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1), (2, 2)))
        with np.errstate(invalid='ignore', over='ignore'):
            plain = (np.all(f.status >= 0) and np.all(np.abs(f.latitude) <= math.pi / 2)
                     and np.all(np.abs(f.longitude) <= 2 * math.pi) and np.isfinite(f.height).all()
                     and np.all(np.diff(f.stamp) != 0) and np.all(ahead <= LATEST_FIX)
                     and np.all(-ahead <= values['gnss.max_delay']) and np.all(f.covariance_type != 0)
                     and np.isfinite(ee + en + nn + uu).all() and np.all(np.minimum(ee, nn) > 0)
                     and np.all(nn * ee > en * en))
        if not plain:
            return None
        smallest = SMALLEST_SIGMA**2
        r = np.zeros((len(mine), FIX_SIZE))
        r[:, Fix.TIME] = (stamp - epoch) * 1e-9
        r[:, Fix.LATITUDE], r[:, Fix.LONGITUDE], r[:, Fix.HEIGHT] = f.latitude, f.longitude, f.height
        r[:, Fix.R_NN], r[:, Fix.R_NE], r[:, Fix.R_EE] = np.maximum(nn, smallest), en, np.maximum(ee, smallest)
        r[:, Fix.R_DD] = np.where(uu > 0, np.maximum(uu, smallest), 4 * np.maximum(nn, ee))
        if values['gnss.sigma'] > 0:
            variance = values['gnss.sigma'] ** 2
            r[:, Fix.R_NN] = r[:, Fix.R_EE] = variance
            r[:, Fix.R_NE] = 0.0
            r[:, Fix.R_DD] = np.maximum(r[:, Fix.R_DD], variance)
        return r

    def _align_segment(self, kept, time, before, records) -> tuple[Start | None, int]:
        """The start, and the number of fixes that went into it."""
        if self.given is not None and self.start is None:
            start = retaken(self.given, self.config, time, self.imu.specific_force[kept], self.imu.angular_rate[kept])
            return start, int(np.count_nonzero(records[:, Fix.TIME] <= start.time + 1e-6))
        alignment, fed = Alignment(self.config), 0
        imu = self.imu
        for k, record in enumerate(records):
            new = kept[fed:before[k]]
            alignment.add_samples(time[fed:before[k]], imu.specific_force[new], imu.angular_rate[new],
                                  None if imu.orientation is None else imu.orientation[new])
            fed = before[k]
            start = self._align(alignment, record, record[Fix.TIME])
            if start is not None:
                return start, k + 1
        self._say('error', f'the filter did not start: waiting for {alignment.waiting_for}')
        return None, len(records)

    def _result(self) -> Run:
        n, navigation = self.config.navigation + self.config.others, self.config.navigation
        channels, p = len(self.config.models), self.config.order
        kept = self.parts if len(self.columns) else []
        states = [part.states for part in kept] or [np.empty((0, len(_columns(self.config))))]
        states = states[0] if len(states) == 1 else np.concatenate(states)
        index = np.concatenate([part.samples for part in kept]) if kept else np.empty(0, dtype=np.int64)
        solution = _solution(states, navigation, self.config.values['feedback'] == 'open')
        errors = states[:, NAV + navigation:NAV + navigation + channels * p:p]
        return Run(config=self.config, stamp=self.imu.stamp[index], index=index, latitude=solution[:, 0],
                   longitude=solution[:, 1], height=solution[:, 2], velocity=solution[:, 3:6], roll=solution[:, 6],
                   pitch=solution[:, 7], yaw=solution[:, 8], sensor_errors=errors,
                   sigma=np.sqrt(states[:, NAV + n:NAV + 2 * n]), covariance_ne=states[:, NAV + 2 * n],
                   innovations=_innovations(self.parts), start=self.start, notices=self.notices(), memory=self.memory,
                   filter_seconds=self.seconds)


@dataclass(frozen=True)
class _Part:
    """One stretch between restarts, run."""

    samples: np.ndarray
    states: np.ndarray
    epoch: int
    fixes: np.ndarray
    records: np.ndarray


def _columns(config: FilterConfig) -> np.ndarray:
    """What of each state is kept: navigation solution, x, the covariance's diagonal and its north-east element."""
    n = config.navigation + config.others
    pairs = [(i, i) for i in range(n)] + [(0, 1)]
    kept = [*range(NAV + n)] + [covariance_index(i, j, config.navigation, config.others) for i, j in pairs]
    return np.array(kept, dtype=np.uint64)  # unsigned: the kernel need not look for negative ones


@njit
def _solution(states, navigation, open_loop):
    """Latitude, longitude, height, v_n, v_e, v_d, roll, pitch, yaw of each state."""
    out = np.empty((len(states), 9))
    for k in range(len(states)):
        (out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4], out[k, 5],
         q) = corrected(states[k], navigation, open_loop)
        if navigation == 5:
            out[k, 6] = out[k, 7] = 0.0
            out[k, 8] = states[k, Nav.YAW] - (states[k, NAV + 4] if open_loop else 0.0)
        else:
            out[k, 6], out[k, 7], out[k, 8] = to_euler(q)
    return out


def _innovations(parts: list[_Part]) -> Innovations:
    """The innovations of all stretches, by the time of the fix."""
    records = np.concatenate([part.records for part in parts]) if parts else np.empty((0, FIX_SIZE))
    index = np.concatenate([part.fixes for part in parts]) if parts else np.empty(0, dtype=np.int64)
    stamp = np.concatenate([part.epoch + np.rint(part.records[:, Fix.TIME] * 1e9).astype(np.int64)
                            for part in parts]) if parts else np.empty(0, dtype=np.int64)
    order = np.argsort(stamp, kind='stable')
    r = records[order]
    return Innovations(index=index[order], stamp=stamp[order], z=r[:, [Fix.Z_N, Fix.Z_E]],
                       s=r[:, [Fix.S_NN, Fix.S_NE, Fix.S_EE]], nis=r[:, Fix.NIS], z_down=r[:, Fix.Z_D],
                       s_down=r[:, Fix.S_DD], yaw=r[:, Fix.YAW], velocity=r[:, [Fix.V_N, Fix.V_E]])
