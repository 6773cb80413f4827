"""The live filter: fed with one event at a time as they arrive. The numbers are those of `replay`, bit for bit."""
from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from ..parameters.parameter import ParameterError
from ..samples import Fixes, Headings, Speeds, Velocities
from . import kernel, white_noise
from .alignment import STANDING_SIGMA, Alignment, start_covariance
from .config import FilterConfig
from .imu_faults import FAULTS, Fault
from .initial import initialize, learned
from .intake import JUMPED, NAMES, Intake, corrected
from .kernel import TAKEN
from .layout import NAV, Event, Head, Kind, Nav, Verdict, sample_at, state_at, views
from .odometry import LINEAR, SIZE, TWIST_COVARIANCE, odometry, published_covariance
from .results import columns
from .snapshot import made, recalled
from .start import Start
from .unheaded import spread
from .vehicle_check import ADRIFT, vehicle_says

#: the verdicts in words
VERDICTS = {Verdict.USED: 'used', Verdict.WEIGHTED: 'weighted down', Verdict.REFUSED: 'beyond the gate',
            Verdict.FROZEN: 'position repeats while moving', Verdict.AHEAD: 'stamped ahead of the IMU',
            Verdict.RECOVERED: 'the filter started anew from it'}
#: what a fault leaves behind shows for so long, s
_DEGRADED, _RECOVERING = 5.0, 10.0
_STEADY_REFUSED = 3
#: what the vehicle shows against the parameters is said so often, ns
_LOOK_PERIOD = 60 * 10**9
#: of a speed that nobody has told, m/s
UNKNOWN_SPEED_SIGMA = 15.0
#: parameters that may change while the filter runs, and where those that the kernel uses stand
CHANGEABLE = ('gnss.gate_probability', 'gnss.robust_sigma', 'gnss.recovery_time', 'gnss.adapt_sigma',
              'gnss.outage_after', 'vehicle.zero_velocity', 'vehicle.zero_velocity_sigma', 'vehicle.non_holonomic',
              'vehicle.non_holonomic_sigma', 'vehicle.non_holonomic_vertical_sigma')
_CHANGED = (Head.GATE, Head.ROBUST_SIGMA, Head.RECOVERY_TIME, Head.ADAPT, Head.CONSTRAINTS, Head.ZERO_VELOCITY_SIGMA,
            Head.LATERAL_SIGMA, Head.VERTICAL_SIGMA)


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
        self._max_gap = round(config.imu.max_gap * 1e9)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the datum, and align anew."""
        self._alignment = Alignment(self.config)
        self._memory: np.ndarray | None = None
        self._provisional: np.ndarray | None = None  # a filter that does not know its heading yet,
        self._unheaded: Start | None = None  # and where it began
        self._epoch: int | None = None
        self._newest_fix = 0
        self._outage = False
        self._last = dict.fromkeys(self._last)
        self._pending: dict[int, tuple[int, int]] = {}
        self._judged: list[Judged] = []
        self._ids = 0
        self._counts: dict[str, int] = {}
        self._said_faults = bytes(8 * (Head.RECOVERIES + 1 - Head.FAULTS))  # the counts, quick to compare
        self._last_gap = 0.0
        self._last_fault = self._last_recovery = -math.inf
        self._refused_in_a_row = 0
        self._recent: deque[np.ndarray] = deque(maxlen=ADRIFT)  # records of fixes
        self._looked = -_LOOK_PERIOD  # ns: when the vehicle was last said to be another than the parameters tell
        self._said: list[str] = []  # of it, at the last look

    def changed(self, values: dict) -> FilterConfig:
        """The configuration with those of `values` (checked, by name) that are CHANGEABLE.

        ParameterError where the filter would have to begin anew.
        """
        values = {name: value for name, value in values.items() if name in CHANGEABLE}
        config = FilterConfig.from_parameters({**self.config.parameters, **values})
        if config.layout == self.config.layout:
            return config
        if config.parameters['vehicle.non_holonomic']:
            raise ParameterError("parameter 'vehicle.non_holonomic' cannot be switched on while the filter runs: it "
                                 'brings states (mounting, axle) that were not there at the start; start the node '
                                 'with it')
        return replace(config, extras=self.config.extras)  # the states that it does not need any more stay

    def adopt(self, config: FilterConfig) -> None:
        """Go on with the configuration `config`, one of `changed`."""
        self.config = config
        self._outage_after = round(config.gnss.outage_after * 1e9)
        for memory in (self._memory, self._provisional):
            if memory is not None:
                memory[list(_CHANGED)] = config.memory()[list(_CHANGED)]

    def use_fixes(self, use: bool) -> None:
        """Whether fixes are used from now on; without them the filter coasts."""
        self._using_fixes = use

    @property
    def aligned(self) -> bool:
        """Whether the heading is known: before that an estimate is one of the position alone."""
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
        sample, last = self._sample, self._now
        sample[0, 1:] = f_x, f_y, f_z, w_x, w_y, w_z
        self._stamp[0] = stamp
        if 0 < stamp - last <= self._restart_gap and last != -1 and math.isfinite(f_x + f_y + f_z + w_x + w_y + w_z):
            self._follow[0], self._follow[2] = stamp, 0  # as `follow` does, which is for the other cases
            if stamp - last > self._max_gap:
                self._say_gap((stamp - last) * 1e-9)
        else:
            code = self.follow(self._stamp, sample[:, 1:])[0]
            if code == JUMPED:
                self.reset()
            elif code:
                return False
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
            if self._provisional is None:
                return False
            self._filter(self._provisional, sample, self._log, self._none)
            return True
        self._filter(self._memory, sample, self._log, self._none)
        if self._memory[Head.FAULTS:Head.RECOVERIES + 1].tobytes() != self._said_faults:
            self._say_faults(stamp)
        if self._pending:
            self._judge()
        if stamp - self._newest_fix > self._outage_after and not self._outage:
            self._outage = True
            self.say('warning', f'no fix used from {self.config.gnss.topic} for '
                                f'{(stamp - self._newest_fix) * 1e-9:.1f} s: coasting on prediction')
        return True

    @property
    def _estimating(self) -> np.ndarray | None:
        """The memory that the estimate is taken from; None where there is none."""
        return self._provisional if self._memory is None else self._memory

    def _filter(self, memory, samples, events, arrival) -> int:
        """Samples and events through the kernel; its answer to the event."""
        kernel.run(memory, samples, events, arrival, self._answer, self._columns, self._none, self._states,
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
                else:
                    self._unheaded = self._alignment.provisional()
                    self._provisional = None if self._unheaded is None else self._started(self._unheaded)
            return
        record[Event.ID] = self._ids
        self._ids += 1
        answer = self._filter(self._memory, self._sample[:0], records, self._before)
        if answer != TAKEN:
            self.say_not_taken(kind, answer, stamp, self._now)
            self._count(NAMES[kind], 'late')
            return
        self._pending[self._ids - 1] = kind, stamp
        self._judge()

    def _begin(self, start: Start, stamp: int) -> None:
        self._memory, self._newest_fix = self._started(start), stamp
        self._provisional = None

    def _started(self, start: Start) -> np.ndarray:
        """The memory of a filter that began with `start` and has seen all samples since."""
        memory = self.config.memory()
        initialize(memory, self.config, start)
        if self.datum is None:
            self.datum = np.array([start.latitude, start.longitude, start.height])
        self._filter(memory, np.ascontiguousarray(self._alignment.samples_after(start.time)), self._log, self._none)
        return memory

    def set_start(self, latitude, longitude, height, yaw, covariance) -> None:
        """Be there now. rad, m; yaw clockwise from north; covariance (4, 4) of north, east, down (m), yaw.

        The speed, along the yaw, is what the filter had, or zero where the vehicle is seen to stand; where nothing
        tells, zero with UNKNOWN_SPEED_SIGMA. What the filter had learned of the sensors stays.
        """
        if self._epoch is None:
            self.say('warning', 'start pose: no IMU sample yet, nothing to start from')
            return
        speed, speed_sigma, still, errors = 0.0, UNKNOWN_SPEED_SIGMA, self._alignment.standing(), None
        if self._memory is not None:
            self.update_odometry()
            speed, speed_sigma = float(self.odometry[LINEAR]), math.sqrt(self.odometry[TWIST_COVARIANCE])
            errors = learned(self.config, self._memory)
        elif still is not None:
            speed_sigma = STANDING_SIGMA
            still.end -= (self._now - self._epoch) * 1e-9
        epoch = self._now
        self.reset()
        self._epoch = epoch
        given = np.asarray(covariance)[np.ix_([0, 1, 3], [0, 1, 3])]
        p = start_covariance(np.eye(2), yaw, math.sqrt(given[2, 2]), speed, speed_sigma)
        p[np.ix_([0, 1, 4], [0, 1, 4])] = given
        velocity = speed * np.array([math.cos(yaw), math.sin(yaw)])
        self._begin(Start(0.0, latitude, longitude, height, velocity, float(yaw), p, still, errors=errors), epoch)

    def snapshot(self) -> dict | None:
        """What a restart can begin with, in plain numbers (see snapshot.py); None while there is no heading."""
        return None if self._memory is None else made(self.config, self._memory, self._now)

    def restore(self, snapshot: dict, max_distance: float) -> str:
        """Start with what an earlier run knew, if the vehicle has stood since; max_distance: m from where that was.

        What is used of it, in words; ValueError where `snapshot` is not one.
        """
        if self._memory is not None or self._epoch is None:
            raise ValueError('the filter has started already, or has no IMU sample yet')
        remembered, said = recalled(self.config, snapshot, self._now, max_distance)
        self._alignment.remember(remembered)
        return said

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
            missing = f'IMU samples are missing, {self._last_gap:.1f} s of them' if self._last_gap else (
                'IMU samples come late, as on a busy machine')
            self.say('warning', f'{topic}: fix stamped {(stamp - self._now) * 1e-9:.1f} s after the IMU sample that '
                                f'came next: {missing}, or the clocks differ (gnss.time_offset); refused')
        elif verdict == Verdict.RECOVERED:
            self._last_recovery = stamp * 1e-9
            self.say('warning', f'{topic}: the fixes refused for {self.config.gnss.recovery_time:.0f} s agree with '
                                'each other: position, velocity and heading start anew from them')
        self._recent.append(record.copy())
        if stamp - self._looked > _LOOK_PERIOD:
            said = vehicle_says(self._memory, self.config, np.array(self._recent))
            self._looked = stamp if said else self._looked
            for text in said:
                if text not in self._said:  # what goes on is said once
                    self.say('warning', text)
            self._said = said
        if not used:
            return
        self._newest_fix = max(self._newest_fix, stamp)
        if self._outage and self._now - stamp < self._outage_after:
            self._outage = False
            self.say('info', f'fixes on {topic} again')

    def _say_faults(self, stamp: int) -> None:
        counts = self._memory[Head.FAULTS:Head.RECOVERIES + 1].copy()
        new = counts - np.frombuffer(self._said_faults)
        self._said_faults = counts.tobytes()
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

    def _say_gap(self, seconds: float) -> None:
        self._last_gap = seconds
        self._count('imu', 'gaps')
        self.say('warning', f'{self.config.imu.topic}: no sample for {seconds:.2f} s (imu.max_gap): samples are '
                            'missing, bridged')

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
        memory = self._estimating
        if memory is None:
            return values
        layout = self.config.layout
        at = state_at(memory, int(memory[Head.SAMPLES]))
        row = memory[at:at + int(memory[Head.WIDTH])]
        sigma = np.sqrt(np.diag(published_covariance(row, layout)))
        values |= {'position sigma, m': float(math.hypot(sigma[0], sigma[1])),
                   'heading sigma, deg': math.degrees(sigma[layout.n_navigation - 1])}
        if self._memory is None:
            return values
        sample = sample_at(memory, int(memory[Head.SAMPLES]))
        values |= {'age of the last fix used, s': (self._now - self._newest_fix) * 1e-9,
                   'realised over claimed sigma of the fixes': math.sqrt(row[Nav.GNSS_RATIO]),
                   'realised over expected sigma of the innovations': math.sqrt(row[Nav.VARIANCE_FACTOR]),
                   'realised over assumed drift of the accelerometers': math.sqrt(row[Nav.DRIFT_RATIO]),
                   'realised over assumed drift of the gyroscopes': math.sqrt(row[Nav.DRIFT_RATIO + 1]),
                   'shown over assumed noise of the accelerometers': math.sqrt(white_noise.shown(memory, sample, 0)),
                   'shown over assumed noise of the gyroscopes': math.sqrt(white_noise.shown(memory, sample, 3)),
                   'contradicted by the constraint, s': float(memory[Head.SLID])}
        for i, name in enumerate(layout.names[layout.n_navigation:], start=layout.n_navigation):
            values[name] = float(row[NAV + i])
            values[f'{name} sigma'] = float(sigma[i])
        if self.datum is not None:
            latitude, longitude = np.degrees(self.datum[:2])
            values['datum'] = f'{latitude:.8f}, {longitude:.8f}, {self.datum[2]:.3f}'
        return values

    def update_odometry(self) -> int:
        """Fill `odometry`, `geodetic` and `position_covariance_enu` for the newest estimate; its stamp in ns."""
        odometry(self._estimating, self.datum, self._height_sigma, self.odometry, self.geodetic,
                 self.position_covariance_enu)
        if self._memory is None:
            spread(self._unheaded, self.datum, self.odometry, self.geodetic, self.position_covariance_enu)
        return self._now

    def warm_up(self) -> None:
        """Compile or load the kernel now, so that the first message is not late."""
        memory = self.config.memory()
        start, datum = Start(0.0, 0.0, 0.0, 0.0, np.zeros(2), 0.0, np.eye(5), None), np.zeros(3)
        initialize(memory, self.config, start)
        event = np.zeros((1, Event.SIZE))
        event[0, [Event.TIME, Event.KIND]] = 0.005, Kind.POSITION
        event[0, [Event.R_NN, Event.R_EE, Event.R_DD]] = 1.0
        sample = np.array([[0.01, 0.0, 0.0, -9.8, 0.0, 0.0, 0.0]])
        kernel.run(memory, sample, event, self._before, self._answer.copy(), self._columns, self._none, self._states,
                   self._log)
        filled = self.odometry.copy(), self.geodetic.copy(), self.position_covariance_enu.copy()
        odometry(memory, datum, 1.0, *filled)
        spread(start, datum, *filled)
        follow = self._follow.copy()
        self.follow(np.array([0], dtype=np.int64), sample[:, 1:])
        self._follow[:] = follow


def _ones(*values) -> tuple[np.ndarray, ...]:
    return tuple(np.array([float(value)]) for value in values)
