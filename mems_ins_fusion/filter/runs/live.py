"""The live filter: fed with one event at a time as they arrive. The numbers are those of `replay`, bit for bit."""
from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from ...parameters.parameter import ParameterError
from ...samples import Fixes
from .. import kernel
from ..advance import TAKEN
from ..bank import Bank
from ..config import FilterConfig
from ..measurements import wheel_vibration
from ..memory import NAV, Event, Head, Kind, Nav, Sample, Verdict, sample_at, state_at
from ..start.alignment import STANDING_SIGMA, Alignment, start_covariance
from ..start.initial import initialize, learned
from ..start.start import DATUM_FIXES, Start, first_place
from ..start.without_heading import spread
from ..trust import white_noise
from ..trust.drift import Drift
from ..trust.imu_faults import FAULTS, Fault, Imu
from ..trust.receiver import Receiver
from ..trust.scale import scale
from .horizon import Horizon, Lookout
from .intake import JUMPED, NOT_FINITE, Intake, corrected
from .odometry import LINEAR, SIZE, TWIST_COVARIANCE, odometry, published_covariance
from .results import columns
from .snapshot import after_jump, made, recalled, vehicle_heading
from .tally import Tally
from .vehicle_check import ADRIFT, found_mounting, vehicle_says

#: the verdicts in words
VERDICTS = {Verdict.USED: 'used', Verdict.WEIGHTED: 'weighted down', Verdict.REFUSED: 'beyond the gate',
            Verdict.FROZEN: 'repeats itself while the vehicle moves',
            Verdict.STRAIGHT_ON: 'goes straight on as without satellites', Verdict.AHEAD: 'stamped ahead of the IMU',
            Verdict.CONTRADICTED: 'not the way between the fixes',
            Verdict.AWAITED: 'its way is not compared with that of the fixes yet',
            Verdict.RECOVERED: 'the filter started anew from it'}
#: s for which samples that were not believed show in the state
_DEGRADED = 5.0
#: s for which a new start from refused fixes does: the heading is found again in about that time
_RECOVERING = 10.0
#: innovations this many times as large as expected are no chance: of 180 drives of 10 minutes on which nothing is wrong
#: the largest was 1.72, and 2 % of them were above 1.5; with fixes stamped 0.8 s early each is above
#: (studies/strain.py)
STRAINED = 1.75
#: ns between two looks at whether the vehicle shows something against the parameters: each takes 0.1 ms
_LOOK_PERIOD = 5 * 10**9
#: ns from something said about that to the next look
_SAY_PERIOD = 60 * 10**9
#: m/s, of a speed that no measurement has told
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
        self._first_places: list[tuple[float, float, float]] = []  # of good fixes, until there is a datum
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
        self._lookout = Lookout(config)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the datum, and align anew."""
        self._alignment = Alignment(self.config)
        self._memory: np.ndarray | None = None
        self._provisional: np.ndarray | None = None  # a filter that does not know its heading yet,
        self._without_heading: Start | None = None  # and where it began
        self._epoch: int | None = None
        self._newest_fix = 0
        self._outage = False
        self._last = dict.fromkeys(self._last)
        self._pending: dict[int, tuple[int, int]] = {}
        self._judged: list[Judged] = []
        self._ids = 0
        self.tallies = {name: Tally() for name in ('imu', *(one.name for one in self.config.inputs.values()))}
        self._said_faults = bytes(8 * Fault.SIZE)  # the counts, quick to compare
        self._restarts = 0.0
        self._last_gap, self.gaps = 0.0, 0
        self._last_fault = self._last_recovery = -math.inf
        self._fault = ''
        self._recent: deque[np.ndarray] = deque(maxlen=ADRIFT)  # records of fixes
        self._next_look = 0  # ns: when it is looked whether the vehicle is another than the parameters tell
        self._said: list[str] = []  # of it, at the last look
        self._said_mounting = False

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
        settings = config.memory()[list(_CHANGED)]
        for memory in (self._memory, self._provisional):
            if memory is not None:
                for one in (memory, memory[int(memory[Bank.SIZE]):]):  # and the second filter behind it
                    one[list(_CHANGED)] = settings

    def use_fixes(self, use: bool) -> None:
        """Whether fixes are used from now on; without them the filter coasts."""
        self._using_fixes = use

    @property
    def aligned(self) -> bool:
        """Whether the heading is known: before that an estimate is one of the position alone."""
        return self._memory is not None

    @property
    def has_estimate(self) -> bool:
        """Whether there is one, be it of the position alone."""
        return self._estimating is not None

    @property
    def status(self) -> str:
        """What the filter is doing, in a few words."""
        if self._memory is None:
            tally = self.tallies['fix']
            if tally.steadily(tally.last, patient=False):
                return f'waiting for a fix that can be used: the last {tally.row} were refused ({tally.reason})'
            return f'waiting for {self._alignment.waiting_for}'
        if self._outage:
            return f'outage for {(self._now - self._newest_fix) * 1e-9:.1f} s'
        return '; '.join(self.reasons) or 'running'

    @property
    def contradicted(self) -> bool:
        """Whether the filter waits for what will not come by itself: what comes is not what the parameters say."""
        if self._memory is not None:
            return False
        tally = self.tallies['fix']
        refused = tally.steadily(tally.last, patient=False) and 'without a fix' not in tally.reason and (
            'no fix' not in tally.reason)  # that comes by itself
        return self._alignment.contradicted or refused

    @property
    def reasons(self) -> list[str]:
        """Why the filter is degraded, each in words; none where nothing is wrong."""
        if self._memory is None:
            return []
        now, found = self._now, []
        if now * 1e-9 - self._last_fault < _DEGRADED:
            found.append(f'samples on {self.config.imu.topic} not believed: {self._fault}')
        for kind, measurement in self.config.inputs.items():
            tally = self.tallies[measurement.name]
            if tally.steadily(now, patient=kind != Kind.POSITION):
                found.append(f'the last {tally.row} messages on {self.topic(kind)} refused: {tally.reason}')
        strain = self._strain()
        if strain > STRAINED:
            found.append(f'innovations {strain:.1f} times as large as expected: a wrong gnss.time_offset, '
                         'gnss.lever_arm or noise (`diagnose` finds which)')
        return found

    def _strain(self) -> float:
        """Realised over expected sigma of the innovations."""
        return math.sqrt(self._memory[state_at(self._memory, int(self._memory[Head.SAMPLES])) + Nav.VARIANCE_FACTOR])

    @property
    def state(self) -> str:
        """waiting, aligning, fusing, coasting, degraded or recovering."""
        if self._memory is None:
            return 'aligning' if self._last[Kind.POSITION] is not None else 'waiting'
        if self._now * 1e-9 - self._last_recovery < _RECOVERING:
            return 'recovering'
        if self._outage:
            return 'coasting'
        return 'degraded' if self.reasons else 'fusing'

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
                kept = None if self._memory is None else after_jump(self.config, self._memory, last, stamp)
                self.reset()
                if kept is not None:
                    self._alignment.remember(kept)
            elif code:
                self.tallies['imu'].refuse(stamp, 'not a number' if code == NOT_FINITE else 'its stamp does not follow')
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
        if self._memory[Imu.FAULTS:Imu.FAULTS + Fault.SIZE].tobytes() != self._said_faults:
            self._say_faults(stamp)
        self._say_restarts(stamp)
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

    def add(self, name: str, stamp: int, *numbers) -> None:
        """One measurement besides the fixes; numbers: those of its samples (`samples`), in their order."""
        measurement = next(m for m in self.config.inputs.values() if m.name == name)
        if self._using_fixes or not measurement.of_antenna:
            stamps = np.array([stamp], dtype=np.int64)
            self._add(measurement.number, measurement.samples(stamps, stamps, *_ones(*numbers)))

    def add_velocity(self, stamp: int, velocity, covariance) -> None:
        """Velocity of the antenna, (3,) m/s north-east-down, and its covariance (3, 3)."""
        self.add('velocity', stamp, velocity, covariance)

    def add_speed(self, stamp: int, speed: float, variance: float) -> None:
        """Speed at the rear axle, m/s forward, and its variance."""
        self.add('speed', stamp, speed, variance)

    def add_heading(self, stamp: int, yaw: float, variance: float) -> None:
        """Heading of the vehicle, rad clockwise from north, and its variance."""
        self.add('heading', stamp, yaw, variance)

    def _add(self, kind: int, samples) -> None:
        stamp = int(samples.stamp[0])
        if self._epoch is None:  # nothing to compare it with yet
            return
        used, records = self.measured(kind, samples, np.array([self._now]), self._epoch)
        tally = self.tallies[self.name(kind)]
        if not len(used):
            tally.refuse(stamp, self.refusal)
            return
        record = records[0]
        stamp = self._epoch + round(record[Event.TIME] * 1e9)
        if kind == Kind.POSITION:
            self._height_sigma = math.sqrt(record[Event.R_DD])
            self._find_datum(record)
        if self._memory is None:
            if record[Event.KIND] == Kind.MAGNETIC:
                self._alignment.add_field(record)
            elif kind == Kind.POSITION:
                start = self._alignment.add_record(record, self.say)
                if start is not None:
                    self._begin(start, stamp)
                else:
                    self._without_heading = self._alignment.provisional()
                    self._provisional = None if self._without_heading is None else self._started(self._without_heading)
            return
        record[Event.ID] = self._ids
        self._ids += 1
        answer = self._filter(self._memory, self._sample[:0], records, self._before)
        if answer != TAKEN:
            self.say_not_taken(kind, answer, stamp, self._now)
            tally.refuse(stamp, 'too late')
            return
        self._pending[self._ids - 1] = kind, stamp
        self._judge()

    def _begin(self, start: Start, stamp: int) -> None:
        self._memory, self._newest_fix = self._started(start), stamp
        self._provisional = None

    def _find_datum(self, record) -> None:
        """The origin of the local frame, where no parameter gives it, from the first good fixes."""
        if self.datum is None:
            self._first_places.append(tuple(record[[Event.LATITUDE, Event.LONGITUDE, Event.HEIGHT]].tolist()))
            if len(self._first_places) == DATUM_FIXES:
                self.datum = first_place(self._first_places)

    def _started(self, start: Start) -> np.ndarray:
        """The memory of a filter that began with `start` and has seen all samples since."""
        memory = self.config.memory()
        initialize(memory, self.config, start)
        if self.datum is None:
            self.datum = first_place(self._first_places or [(start.latitude, start.longitude, start.height)])
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
        wheels = None
        if self._memory is not None:
            self.update_odometry()
            speed, speed_sigma = float(self.odometry[LINEAR]), math.sqrt(self.odometry[TWIST_COVARIANCE])
            errors, wheels = learned(self.config, self._memory), wheel_vibration.calibration(self._memory)
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
        start = Start(0.0, latitude, longitude, height, velocity, float(yaw), p, still, errors=errors, wheels=wheels)
        self._begin(start, epoch)

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
        for identity, (kind, stamp) in list(self._pending.items()):
            at = kernel.find_event(self._memory, identity)
            if at < 0:  # more than are remembered wait for the IMU
                del self._pending[identity]
                continue
            record = self._memory[at:at + Event.SIZE]
            verdict = int(record[Event.VERDICT])
            if verdict == Verdict.PENDING:
                continue
            del self._pending[identity]
            used = verdict in (Verdict.USED, Verdict.WEIGHTED, Verdict.RECOVERED)
            dimensions = self.config.inputs[kind].components
            self._judged.append(Judged(stamp, self.name(kind), used, float(record[Event.WEIGHT]), VERDICTS[verdict],
                                       tuple(record[Event.Z_N:Event.Z_N + dimensions].tolist()),
                                       float(record[Event.NIS])))
            tally, misfit = self.tallies[self.name(kind)], float(record[Event.NIS]) / dimensions
            if verdict == Verdict.RECOVERED:
                self._last_recovery = stamp * 1e-9
                lasted = (stamp - tally.since) * 1e-9
                self.say('warning', f'{self.topic(kind)}: the fixes refused for {lasted:.0f} s agree with each other: '
                                    'position, velocity and heading start anew from them')
            if used:
                tally.use(misfit)
            elif verdict != Verdict.AWAITED:  # for the first ways of each drive, as it should be
                tally.refuse(stamp, VERDICTS[verdict], misfit if verdict == Verdict.REFUSED else math.nan)
                self.say('warning', f'{self.topic(kind)}: {self._refusal(kind, verdict, stamp, record)}')
            if kind == Kind.POSITION:
                self._fix_judged(used, stamp, record)

    def _refusal(self, kind: int, verdict: int, stamp: int, record) -> str:
        """Why a measurement was refused, in words and numbers."""
        if verdict == Verdict.FROZEN:
            return f'the same {self.name(kind)} again while the vehicle moves: {self.name(kind)} refused'
        if verdict == Verdict.STRAIGHT_ON:
            return 'fixes on a straight line, as of a receiver that goes on without satellites: fix refused'
        if verdict == Verdict.CONTRADICTED:
            return (f'{self.name(kind)} makes up another way than the one between the fixes, as with a wrong unit, '
                    'sign or axes, or a dead sensor: refused')
        if verdict == Verdict.AHEAD:
            missing = f'IMU samples are missing, {self._last_gap:.1f} s of them' if self._last_gap else (
                'IMU samples come late, as on a busy machine')
            return (f'{self.name(kind)} stamped {(stamp - self._now) * 1e-9:.1f} s after the IMU sample that came '
                    f'next: {missing}, or the clocks differ (gnss.time_offset); refused')
        measurement = self.config.inputs[kind]
        innovation = record[Event.Z_N:Event.Z_N + measurement.components]
        said = f'{measurement.off(record[Event.VALUE], innovation)}, {math.sqrt(record[Event.NIS]):.0f} sigma: refused'
        return f'{said}, as of wheels that slip' if measurement.kind in (Kind.SPEED, Kind.TWIST) else said

    def _fix_judged(self, used: bool, stamp: int, record) -> None:
        topic = self.config.gnss.topic
        self._recent.append(record.copy())
        if stamp >= self._next_look:
            said = vehicle_says(self._memory, self.config, np.array(self._recent))
            self._next_look = stamp + (_SAY_PERIOD if said else _LOOK_PERIOD)
            for text in said:
                if text not in self._said:  # what goes on is said once
                    self.say('warning', text)
            self._said = said
            if not self._said_mounting and (found := found_mounting(self._memory, self.config)):
                self._said_mounting = True
                self.say('warning', f'{self.config.imu.topic}: {found}')
        if not used:
            return
        self._newest_fix = max(self._newest_fix, stamp)
        if self._outage and self._now - stamp < self._outage_after:
            self._outage = False
            self.say('info', f'fixes on {topic} again')

    def _say_faults(self, stamp: int) -> None:
        counts = self._memory[Imu.FAULTS:Imu.FAULTS + Fault.SIZE].copy()
        new = counts - np.frombuffer(self._said_faults)
        self._said_faults = counts.tobytes()
        for fault in range(1, Fault.SIZE):
            if new[fault] > 0:
                self._last_fault = stamp * 1e-9
                f = ', '.join(f'{v:.4g}' for v in self._sample[0, 1:4])
                w = ', '.join(f'{v:.4g}' for v in self._sample[0, 4:7])
                self._fault = FAULTS[fault]
                self.tallies['imu'].refuse(stamp, self._fault)
                self.say('warning', f'{self.config.imu.topic}: linear_acceleration ({f}), angular_velocity ({w}): '
                                    f'{FAULTS[fault]}: sample not believed, bridged')

    def _say_restarts(self, stamp: int) -> None:
        restarts = float(self._memory[state_at(self._memory, int(self._memory[Head.SAMPLES])) + Nav.RESTARTS])
        if restarts > self._restarts:
            self._last_recovery = stamp * 1e-9
            self.say('error', 'the state was not finite: the filter went back to the last good one')
        self._restarts = restarts

    def _say_gap(self, seconds: float) -> None:
        self._last_gap = seconds
        self.gaps += 1
        self.say('warning', f'{self.config.imu.topic}: no sample for {seconds:.2f} s (imu.max_gap): samples are '
                            'missing, bridged')

    def verdicts(self) -> list[Judged]:
        """What was done with each measurement since the last call."""
        judged, self._judged = self._judged, []
        return judged

    def health(self) -> dict:
        """Numbers and words for a diagnosis of the running filter, by name with the unit."""
        values: dict = {'state': self.state, 'status': self.status, 'gaps between IMU samples': self.gaps}
        for name, tally in self.tallies.items():
            values |= {f'{name} used': tally.used} if tally.used else {}
            values |= {f'{name} refused, {reason}': count for reason, count in tally.refused.items()}
        memory = self._estimating
        if memory is None:
            return values
        layout = self.config.layout
        at = state_at(memory, int(memory[Head.SAMPLES]))
        row = memory[at:at + int(memory[Head.WIDTH])]
        sigma = np.sqrt(np.diag(published_covariance(row, layout)))
        values |= {'position sigma, m': float(math.hypot(sigma[0], sigma[1])),
                   'heading sigma, deg': math.degrees(sigma[layout.n_navigation - 1]),
                   'speed, m/s': math.hypot(row[Nav.V_N], row[Nav.V_E]),
                   'speed sigma, m/s': math.sqrt(sigma[layout.index('v_n')]**2 + sigma[layout.index('v_e')]**2)}
        if self._memory is None:
            return values
        horizon = self._lookout.look(memory)
        values |= {'trust horizon, s': horizon.seconds, 'trust horizon, m': horizon.metres,
                   'trust horizon to, m': self.config.parameters['horizon.limit']}
        values['heading sigma of the vehicle, deg'] = math.degrees(vehicle_heading(self.config, memory)[1])
        values['mounting found'] = found_mounting(memory, self.config) or 'nothing against imu.mounting_rpy'
        sample = sample_at(memory, int(memory[Head.SAMPLES]))
        values |= {'age of the last fix used, s': (self._now - self._newest_fix) * 1e-9,
                   'realised over claimed sigma of the fixes': math.sqrt(scale(row, Receiver.SCALE)),
                   'realised over expected sigma of the innovations': self._strain(),
                   'realised over assumed drift of the accelerometers': math.sqrt(row[Drift.RATIO]),
                   'realised over assumed drift of the gyroscopes': math.sqrt(row[Drift.RATIO + 1]),
                   'shown over assumed noise of the accelerometers': math.sqrt(white_noise.shown(memory, sample, 0)),
                   'shown over assumed noise of the gyroscopes': math.sqrt(white_noise.shown(memory, sample, 3)),
                   'contradicted by the constraint, s': float(row[Nav.SLID])}
        values |= wheel_vibration.diagnostics(memory, memory[sample + Sample.TIME])
        for i, name in enumerate(layout.names[layout.n_navigation:], start=layout.n_navigation):
            values[name] = float(row[NAV + i])
            values[f'{name} sigma'] = float(sigma[i])
        if self.datum is not None:
            latitude, longitude = np.degrees(self.datum[:2])
            values['datum'] = f'{latitude:.8f}, {longitude:.8f}, {self.datum[2]:.3f}'
        return values

    def horizon(self) -> Horizon | None:
        """For how long and how far the estimate can be trusted without fixes; None before the heading is known."""
        return None if self._memory is None else self._lookout.look(self._memory)

    def update_odometry(self) -> int:
        """Fill `odometry`, `geodetic` and `position_covariance_enu` for the newest estimate; its stamp in ns."""
        odometry(self._estimating, self.datum, self._height_sigma, self.odometry, self.geodetic,
                 self.position_covariance_enu)
        if self._memory is None:
            spread(self._without_heading, self.datum, self.odometry, self.geodetic, self.position_covariance_enu)
        return self._now

    def vehicle_axes(self) -> tuple[float, float, float | None]:
        """The vehicle's axes in those that imu.mounting_rpy gives: turned to the right, then up, rad.

        And the sigma of the vehicle's heading, None before there is one.
        """
        if self._memory is None:
            return 0.0, 0.0, None
        states = (self.config.layout.index(name) for name in ('mounting_yaw', 'mounting_pitch'))
        at = state_at(self._memory, int(self._memory[Head.SAMPLES])) + NAV
        yaw, pitch = (float(self._memory[at + state]) if state >= 0 else 0.0 for state in states)
        return yaw, pitch, vehicle_heading(self.config, self._memory)[1]

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
        kernel.find_event(memory, 0)
        at = state_at(memory, 0)
        published_covariance(memory[at:at + int(memory[Head.WIDTH])], self.config.layout)
        filled = self.odometry.copy(), self.geodetic.copy(), self.position_covariance_enu.copy()
        odometry(memory, datum, 1.0, *filled)
        spread(start, datum, *filled)
        self._lookout.look(memory)
        follow = self._follow.copy()
        self.follow(np.array([0], dtype=np.int64), sample[:, 1:])
        self._follow[:] = follow


def _ones(*values) -> tuple[np.ndarray, ...]:
    return tuple(np.array([value], dtype=float) for value in values)
