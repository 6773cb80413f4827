"""The live filter: fed with one event at a time as they arrive. The numbers are those of `replay`, bit for bit."""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..samples import Fixes, Headings, Speeds, Velocities
from . import kernel
from .alignment import Alignment, Start
from .config import FilterConfig
from .imu_faults import FAULTS, Fault
from .initial import initialize
from .intake import GOOD, JUMPED, NAMES, Intake, corrected
from .kernel import TAKEN
from .layout import NAV, Event, Head, Kind, Nav, Verdict, covariance, state_at, views
from .odometry import SIZE, odometry
from .results import columns

#: the verdicts in words
VERDICTS = {Verdict.USED: 'used', Verdict.WEIGHTED: 'weighted down', Verdict.REFUSED: 'beyond the gate',
            Verdict.FROZEN: 'position repeats while moving', Verdict.AHEAD: 'stamped ahead of the IMU',
            Verdict.RECOVERED: 'the filter started anew from it'}
#: what a fault leaves behind shows for so long, s
_DEGRADED, _RECOVERING = 5.0, 10.0
_STEADY_REFUSED = 3


@dataclass(frozen=True)
class Judged:
    """What the filter did with one measurement. stamp: ns. kind: fix, speed, velocity or heading. weight: of its
    inverse covariance, 0 to 1. reason: in words. innovation: predicted minus measured, m, m/s or rad."""

    stamp: int
    kind: str
    used: bool
    weight: float
    reason: str
    innovation: tuple[float, ...]
    nis: float


class FusionFilter(Intake):
    """The live filter. Stamps are integer nanoseconds; IMU samples are in sensor axes."""

    def __init__(self, config: FilterConfig):
        super().__init__(config)
        self.odometry = np.zeros(SIZE)
        self.geodetic = np.zeros(3)
        self.position_covariance_enu = np.zeros(9)
        self.datum = config.datum
        self._height_sigma = config.gnss.default_sigma
        self._outage_after = round(config.gnss.outage_after * 1e9)
        self._correctors = config.correctors()
        self._celsius = math.nan
        # what the kernel takes: one sample, one event, and nothing of either
        self._sample, self._stamp = np.zeros((1, 7)), np.zeros(1, dtype=np.int64)
        self._columns, self._states = columns(config.layout), np.zeros((0, len(columns(config.layout))))
        self._none, self._log = np.zeros(0, dtype=np.int64), np.zeros((0, Event.SIZE))
        self._answer, self._before = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
        self._using_fixes = True
        self._start_given: Start | None = None
        self.reset()

    def reset(self) -> None:
        """Forget everything but the datum, and align anew."""
        self._alignment = Alignment(self.config)
        self._memory: np.ndarray | None = None
        self._epoch: int | None = None
        self._newest_fix = 0
        self._outage = False
        self._last = dict.fromkeys(self._last)
        self._pending: dict[int, tuple[int, int]] = {}
        self._judged: list[Judged] = []
        self._ids = 0
        self._counts: dict[str, int] = {}
        self._said_faults = np.zeros(Head.RECOVERIES + 1 - Head.FAULTS)
        self._last_fault = self._last_recovery = -math.inf
        self._refused_in_a_row = 0

    def use_fixes(self, use: bool) -> None:
        """Whether fixes are used from now on; without them the filter coasts."""
        self._using_fixes = use

    @property
    def aligned(self) -> bool:
        """Whether there is an estimate."""
        return self._memory is not None

    @property
    def status(self) -> str:
        """What the filter is doing, in a few words."""
        if self._memory is None:
            return f'waiting for {self._alignment.waiting_for}'
        if self._outage:
            return f'outage for {(self._now - self._newest_fix) * 1e-9:.1f} s'
        return 'running'

    @property
    def state(self) -> str:
        """waiting, aligning, fusing, coasting, degraded or recovering."""
        if self._memory is None:
            return 'aligning' if self._last[Kind.POSITION] is not None else 'waiting'
        now = self._now * 1e-9
        if now - self._last_recovery < _RECOVERING:
            return 'recovering'
        if self._outage:
            return 'coasting'
        if now - self._last_fault < _DEGRADED or self._refused_in_a_row >= _STEADY_REFUSED:
            return 'degraded'
        return 'fusing'

    @property
    def _now(self) -> int:
        """Stamp of the newest IMU sample, ns."""
        return int(self._follow[0])

    def add_imu(self, stamp: int, f_x, f_y, f_z, w_x, w_y, w_z, q_x=0.0, q_y=0.0, q_z=0.0, q_w=0.0) -> bool:
        """One IMU sample, sensor axes: specific force m/s^2, angular rate rad/s. True when there is a new estimate.

        The quaternion is `Imu.orientation`, zero where the driver has none.
        """
        sample = self._sample
        sample[0, 1:] = f_x, f_y, f_z, w_x, w_y, w_z
        self._stamp[0] = stamp
        code = self.follow(self._stamp, sample[:, 1:])[0]
        if code != GOOD:
            if code != JUMPED:
                return False
            self.reset()
        if self._correctors:
            sample[:, 1:] = corrected(self._correctors, self._stamp, sample[:, 1:], np.array([self._celsius]))
        if self._epoch is None:
            self._epoch = stamp
            if self._memory is None:
                self._alignment.waiting_for = f'a fix on {self.config.gnss.topic}'
                self.say('info', f'waiting for {self._alignment.waiting_for}')
        sample[0, 0] = (stamp - self._epoch) * 1e-9
        if self._memory is None:
            self._alignment.add_samples(sample, [(q_x, q_y, q_z, q_w)])
            return False
        self._filter(sample, self._log, self._none)
        if self._memory[Head.FAULTS:Head.RECOVERIES + 1].sum() != self._said_faults.sum():
            self._say_faults(stamp)
        if self._pending:
            self._judge()
        if stamp - self._newest_fix > self._outage_after and not self._outage:
            self._outage = True
            self.say('warning', f'no fix used from {self.config.gnss.topic} for '
                                f'{(stamp - self._newest_fix) * 1e-9:.1f} s: coasting on prediction')
        return True

    def _filter(self, samples, events, arrival) -> int:
        """Samples and events through the kernel; its answer to the event."""
        kernel.run(self._memory, samples, events, arrival, self._answer, self._columns, self._none, self._states,
                   self._log)
        return int(self._answer[0])

    def add_temperature(self, stamp: int, celsius: float) -> None:
        """The sensors' temperature from now on, degrees Celsius."""
        if math.isfinite(celsius):
            self._celsius = celsius
        else:
            self.say('warning', f'{self.config.imu.temperature_topic}: temperature {celsius}: dropped')

    def add_fix(self, stamp: int, latitude, longitude, height, covariance, status=0, covariance_type=2) -> None:
        """One fix of the antenna: rad, m; covariance: nine numbers, east-north-up, as in `NavSatFix`."""
        if self._using_fixes:
            stamps = np.array([stamp], dtype=np.int64)
            self._add(Kind.POSITION, Fixes(stamps, stamps, *_ones(latitude, longitude, height),
                                           np.reshape(np.asarray(covariance, dtype=float), (1, 3, 3)),
                                           np.array([status]), np.array([covariance_type])))

    def add_velocity(self, stamp: int, velocity, covariance) -> None:
        """Velocity of the antenna, (3,) m/s north-east-down, and its covariance (3, 3)."""
        if self._using_fixes:
            stamps = np.array([stamp], dtype=np.int64)
            self._add(Kind.VELOCITY, Velocities(stamps, stamps, np.reshape(np.asarray(velocity, dtype=float), (1, 3)),
                                                np.reshape(np.asarray(covariance, dtype=float), (1, 3, 3))))

    def add_speed(self, stamp: int, speed: float, variance: float) -> None:
        """Speed at the rear axle, m/s forward, and its variance."""
        stamps = np.array([stamp], dtype=np.int64)
        self._add(Kind.SPEED, Speeds(stamps, stamps, *_ones(speed, variance)))

    def add_heading(self, stamp: int, yaw: float, variance: float) -> None:
        """Heading of the vehicle, rad clockwise from north, and its variance."""
        stamps = np.array([stamp], dtype=np.int64)
        self._add(Kind.HEADING, Headings(stamps, stamps, *_ones(yaw, variance)))

    def _add(self, kind: int, samples) -> None:
        if self._epoch is None:  # nothing to compare it with yet
            return
        used, records = self.measured(kind, samples, np.array([self._now]), self._epoch)
        if not len(used):
            self._count(NAMES[kind], 'unusable')
            return
        record = records[0]
        stamp = self._epoch + round(record[Event.TIME] * 1e9)
        if kind == Kind.POSITION:
            self._height_sigma = math.sqrt(record[Event.R_DD])
        if self._memory is None:
            if kind == Kind.POSITION:
                start = self._alignment.add_record(record, self.say)
                if start is not None:
                    self._begin(start, stamp)
            return
        record[Event.ID] = self._ids
        self._ids += 1
        answer = self._filter(self._sample[:0], records, self._before)
        if answer != TAKEN:
            self.say_not_taken(kind, answer, stamp, self._now)
            self._count(NAMES[kind], 'late')
            return
        self._pending[self._ids - 1] = kind, stamp
        self._judge()

    def _begin(self, start: Start, stamp: int) -> None:
        memory = self.config.memory()
        initialize(memory, self.config, start)
        if self.datum is None:
            self.datum = np.array([start.latitude, start.longitude, start.height])
        self._memory, self._newest_fix = memory, stamp
        self._filter(np.ascontiguousarray(self._alignment.samples_after(start.time)), self._log, self._none)

    def _judge(self) -> None:
        """What the filter has done with the measurements it had still to come to."""
        records = views(self._memory)[4][:int(self._memory[Head.EVENTS])]
        for record in records[np.isin(records[:, Event.ID], list(self._pending))]:
            verdict = int(record[Event.VERDICT])
            if verdict == Verdict.PENDING:
                continue
            kind, stamp = self._pending.pop(int(record[Event.ID]))
            used = verdict in (Verdict.USED, Verdict.WEIGHTED, Verdict.RECOVERED)
            dimensions = {Kind.POSITION: 2, Kind.VELOCITY: 2}.get(kind, 1)
            self._judged.append(Judged(stamp, NAMES[kind], used, float(record[Event.WEIGHT]), VERDICTS[verdict],
                                       tuple(record[Event.Z_N:Event.Z_N + dimensions].tolist()),
                                       float(record[Event.NIS])))
            self._count(NAMES[kind], VERDICTS[verdict])
            if kind == Kind.POSITION:
                self._fix_judged(verdict, used, stamp, record)

    def _fix_judged(self, verdict: int, used: bool, stamp: int, record) -> None:
        topic = self.config.gnss.topic
        self._refused_in_a_row = 0 if used else self._refused_in_a_row + 1
        off = math.hypot(record[Event.Z_N], record[Event.Z_E])
        if verdict == Verdict.REFUSED:
            self.say('warning', f'{topic}: fix {off:.1f} m off, {math.sqrt(record[Event.NIS]):.0f} sigma: refused')
        elif verdict == Verdict.FROZEN:
            self.say('warning', f'{topic}: the same position again while the vehicle moves: fix refused')
        elif verdict == Verdict.AHEAD:
            self.say('warning', f'{topic}: fix stamped after the IMU sample that came next: the clocks differ '
                                '(gnss.time_offset); refused')
        elif verdict == Verdict.RECOVERED:
            self._last_recovery = stamp * 1e-9
            self.say('warning', f'{topic}: the fixes refused for {self.config.gnss.recovery_time:.0f} s agree with '
                                'each other: position, velocity and heading start anew from them')
        if not used:
            return
        self._newest_fix = max(self._newest_fix, stamp)
        if self._outage and self._now - stamp < self._outage_after:
            self._outage = False
            self.say('info', f'fixes on {topic} again')

    def _say_faults(self, stamp: int) -> None:
        counts = self._memory[Head.FAULTS:Head.RECOVERIES + 1].copy()
        new = counts - self._said_faults
        self._said_faults = counts
        for fault in range(1, Fault.SIZE):
            if new[fault] > 0:
                self._last_fault = stamp * 1e-9
                f = ', '.join(f'{v:.4g}' for v in self._sample[0, 1:4])
                w = ', '.join(f'{v:.4g}' for v in self._sample[0, 4:7])
                self._count('imu', FAULTS[fault])
                self.say('warning', f'{self.config.imu.topic}: linear_acceleration ({f}), angular_velocity ({w}): '
                                    f'{FAULTS[fault]}: sample not believed, bridged')
        if new[Head.RESTARTS - Head.FAULTS] > 0:
            self._last_recovery = stamp * 1e-9
            self.say('error', 'the state was not finite: the filter went back to the last good one')

    def _count(self, what: str, outcome: str) -> None:
        key = f'{what} {outcome}'
        self._counts[key] = self._counts.get(key, 0) + 1

    def verdicts(self) -> list[Judged]:
        """What was done with each measurement since the last call."""
        judged, self._judged = self._judged, []
        return judged

    def health(self) -> dict:
        """Numbers and words for a diagnosis of the running filter, by name with the unit."""
        values: dict = {'state': self.state, 'status': self.status, **self._counts}
        if self._memory is None:
            return values
        layout = self.config.layout
        at = state_at(self._memory, int(self._memory[Head.SAMPLES]))
        row = self._memory[at:at + int(self._memory[Head.WIDTH])]
        sigma = np.sqrt(np.diag(covariance(row, layout)))
        heading = 4 if layout.n_navigation == 5 else 8
        values |= {'age of the last fix used, s': (self._now - self._newest_fix) * 1e-9,
                   'realised over claimed sigma of the fixes': math.sqrt(row[Nav.GNSS_RATIO]),
                   'position sigma, m': float(math.hypot(sigma[0], sigma[1])),
                   'heading sigma, deg': math.degrees(sigma[heading])}
        for i, name in enumerate(layout.names[layout.n_navigation:], start=layout.n_navigation):
            values[name] = float(row[NAV + i])
            values[f'{name} sigma'] = float(sigma[i])
        if self.datum is not None:
            latitude, longitude = np.degrees(self.datum[:2])
            values['datum'] = f'{latitude:.8f}, {longitude:.8f}, {self.datum[2]:.3f}'
        return values

    def update_odometry(self) -> int:
        """Fill `odometry`, `geodetic` and `position_covariance_enu` for the newest estimate; its stamp in ns."""
        odometry(self._memory, self.datum, self._height_sigma, self.odometry, self.geodetic,
                 self.position_covariance_enu)
        return self._now

    def warm_up(self) -> None:
        """Compile or load the kernel now, so that the first message is not late."""
        memory = self.config.memory()
        initialize(memory, self.config, Start(0.0, 0.0, 0.0, 0.0, np.zeros(2), 0.0, np.eye(5), None))
        event = np.zeros((1, Event.SIZE))
        event[0, [Event.TIME, Event.KIND]] = 0.005, Kind.POSITION
        event[0, [Event.R_NN, Event.R_EE, Event.R_DD]] = 1.0
        sample = np.array([[0.01, 0.0, 0.0, -9.8, 0.0, 0.0, 0.0]])
        kernel.run(memory, sample, event, self._before, self._answer.copy(), self._columns, self._none, self._states,
                   self._log)
        odometry(memory, np.zeros(3), 1.0, self.odometry.copy(), self.geodetic.copy(),
                 self.position_covariance_enu.copy())
        follow = self._follow.copy()
        self.follow(np.array([0], dtype=np.int64), sample[:, 1:])
        self._follow[:] = follow


def _ones(*values) -> tuple[np.ndarray, ...]:
    return tuple(np.array([float(value)]) for value in values)
