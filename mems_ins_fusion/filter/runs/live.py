"""The live filter: takes IMU samples and measurements one at a time, as they arrive. Its results equal those of
`replay` bit for bit. status.py reports its state."""
from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...parameters.parameter import ParameterError
from ...samples import Fixes
from .. import kernel
from ..advance import TAKEN
from ..bank import Bank
from ..config import FilterConfig
from ..measurements import wheel_vibration
from ..measurements.registry import imus
from ..memory import Event, Head, Kind, Nav, Verdict, newest_row
from ..start.alignment import STANDING_SIGMA, Alignment
from ..start.course import start_covariance
from ..start.initial import initialize, sensor_errors_of
from ..start.start import DATUM_FIXES, Start, first_place
from ..trust.imu_faults import Fault, Imu
from .horizon import HorizonPredictor
from .intake import JUMPED, NOT_FINITE, remove_effects
from .odometry import LINEAR, SIZE, TWIST_COVARIANCE, odometry, widen_without_heading
from .results import columns
from .snapshot import from_snapshot, make_snapshot, saved_at_jump
from .status import VERDICTS, FilterStatus
from .tally import Tally
from .vehicle_check import ADRIFT, found_mounting, found_time_offsets, vehicle_warnings
from .withheld import Withheld

_CHECK_PERIOD = 5 * 10**9  # ns between two checks (vehicle_check.py); each takes 0.1 ms
_MESSAGE_PERIOD = 60 * 10**9  # ns from a message of this check to the next check
MOST_UNSEEN = 1000  # samples that wait for a fix before the alignment gets them: some seconds, in an outage, too
UNKNOWN_SPEED_SIGMA = 15.0  # m/s, standard deviation of an unknown speed: a car on any road
#: parameters that may change while the filter runs, and the columns of the head that depend on them
CHANGEABLE = ('gnss.gate_probability', 'gnss.robust_sigma', 'gnss.recovery_time', 'gnss.adapt_sigma',
              'gnss.outage_after', 'vehicle.zero_velocity', 'vehicle.zero_velocity_sigma', 'vehicle.non_holonomic',
              'vehicle.non_holonomic_sigma', 'vehicle.non_holonomic_vertical_sigma')
_CHANGED = (Head.GATE, Head.ROBUST_SIGMA, Head.RECOVERY_TIME, Head.ADAPT, Head.ZERO_VELOCITY_SIGMA, Head.LATERAL_SIGMA,
            Head.VERTICAL_SIGMA)


class Judgement(NamedTuple):
    """What the filter did with one measurement. stamp: ns. kind: name of the input. weight: factor on the inverse of
    its covariance, 0 to 1. reason: in words. innovation: predicted minus measured, m, m/s or rad."""

    stamp: int
    kind: str
    used: bool
    weight: float
    reason: str
    innovation: tuple[float, ...]
    nis: float


class FusionFilter(FilterStatus):
    """The live filter. Stamps are integer nanoseconds; IMU samples are in sensor axes."""

    #: whether a trust horizon is asked of it, which copies without fixes make truer (withheld.py)
    announces = True

    def __init__(self, config: FilterConfig):
        super().__init__(config)
        self.odometry = np.zeros(SIZE)
        self.geodetic = np.zeros(3)
        self.position_covariance_enu = np.zeros(9)
        self.datum = config.datum
        self._first_places: list[tuple[float, float, float]] = []  # of valid fixes, until there is a datum
        self._height_sigma = config.gnss.default_sigma
        self._outage_after = round(config.gnss.outage_after * 1e9)
        self._correctors = config.correctors()
        self._celsius = math.nan
        # arguments of the kernel: one sample, and empty arrays; and one fix (new arrays are slow)
        self._sample, self._stamp = np.zeros((1, 13 if imus(config.parameters) else 7)), np.zeros(1, dtype=np.int64)
        self._columns, self._states = columns(config.layout), np.zeros((0, len(columns(config.layout))))
        self._none, self._log = np.zeros(0, dtype=np.int64), np.zeros((0, Event.SIZE))
        self._fix = Fixes(*np.zeros((2, 1), dtype=np.int64), *np.zeros((3, 1)), np.zeros((1, 3, 3)),
                          *np.zeros((2, 1), dtype=np.int64))
        self._covariance = self._fix.covariance.ravel()  # the same numbers
        self._answer, self._before = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
        self._using_fixes = True
        self._max_gap = round(config.imu.max_gap * 1e9)
        self._horizon = HorizonPredictor(config)
        self.reset()

    def reset(self) -> None:
        """Discard everything but the datum, and align again."""
        self._alignment = Alignment(self.config)
        self._memory: np.ndarray | None = None
        self._withheld = Withheld(self.config)
        self._unseen: list[list[float]] = []  # samples since the latest fix while the alignment watches
        self._provisional: np.ndarray | None = None  # memory of a filter without a heading,
        self._without_heading: Start | None = None  # and its start
        self._epoch: int | None = None
        self._newest_fix = 0
        self._outage = False
        self._last = dict.fromkeys(self._last, -1)
        self._pending: dict[int, tuple[int, int]] = {}  # measurements not judged yet
        self._judged: list[Judgement] = []
        self._ids = 0
        #: counts of each input, by its name
        self.tallies = {name: Tally() for name in ('imu', *(one.name for one in self.config.inputs.values()))}
        self._said_faults = bytes(8 * Fault.SIZE)  # the counts as bytes, which are quick to compare
        self._starts = 0.0, 0.0  # Nav.RESTARTS and Nav.RECOVERIES of the published state, as reported so far
        self._last_gap, self.gaps = 0.0, 0
        self._last_fault = self._last_recovery = -math.inf
        self._fault = ''
        self._recent: deque[list[float]] = deque(maxlen=ADRIFT)  # events of fixes
        self._next_look = 0  # ns: time of the next check whether the vehicle contradicts the parameters
        self._said: list[str] = []  # messages of the last check
        self._said_mounting = False
        self._said_late: set[int] = set()  # numbers of the inputs whose time offset was reported

    def changed(self, values: dict) -> FilterConfig:
        """The configuration with those of the checked `values` that are CHANGEABLE.

        Raises ParameterError where the running filter cannot take them.
        """
        values = {name: value for name, value in values.items() if name in CHANGEABLE}
        config = FilterConfig.from_parameters({**self.config.parameters, **values})
        if config.layout == self.config.layout:
            return config
        if config.parameters['vehicle.non_holonomic']:
            raise ParameterError("parameter 'vehicle.non_holonomic' cannot be switched on while the filter runs: it "
                                 'brings states (mounting, axle) that were not there at the start; start the node '
                                 'with it')
        return replace(config, extras=self.config.extras)  # states that are no longer needed stay

    def adopt(self, config: FilterConfig) -> None:
        """Use `config`, which `changed` has returned, from now on."""
        self.config = config
        self._outage_after = round(config.gnss.outage_after * 1e9)
        settings = config.memory()[list(_CHANGED)]
        for memory in (self._memory, self._provisional):
            if memory is not None:
                for one in (memory, memory[int(memory[Bank.SIZE]):]):  # the second filter (bank.py) follows the first
                    one[list(_CHANGED)] = settings

    def use_fixes(self, use: bool) -> None:
        """Switch the use of fixes and other measurements from satellites on or off."""
        self._using_fixes = use

    def add_imu(self, stamp: int, f_x, f_y, f_z, w_x, w_y, w_z, q_x=0.0, q_y=0.0, q_z=0.0, q_w=0.0,
                difference=()) -> bool:
        """Take one IMU sample, sensor axes: specific force m/s^2, angular rate rad/s. True when there is a new
        estimate.

        The quaternion is `Imu.orientation`, zero where the driver has none. difference: six numbers of several IMUs, as
        in `ImuSamples`.
        """
        sample, last = self._sample, self._now
        sample[0, 1:7] = f_x, f_y, f_z, w_x, w_y, w_z
        sample[0, 7:] = difference or 0.0
        self._stamp[0] = stamp
        if 0 < stamp - last <= self._restart_gap and last != -1 and math.isfinite(f_x + f_y + f_z + w_x + w_y + w_z):
            self._follow[0], self._follow[2] = stamp, 0  # the usual case of `follow`, without the call
            if stamp - last > self._max_gap:
                self._say_gap((stamp - last) * 1e-9)
        else:
            code = self.follow(self._stamp, sample[:, 1:7])[0]
            if code == JUMPED:
                saved = None if self._memory is None else saved_at_jump(self.config, self._memory, last, stamp)
                self.reset()
                if saved is not None:
                    self._alignment.use_saved(saved)
            elif code:
                self.tallies['imu'].refuse(stamp, 'not a number' if code == NOT_FINITE else 'its stamp does not follow')
                return False
        if self._correctors:
            sample[:, 1:7] = remove_effects(self._correctors, self._stamp, sample[:, 1:7], np.array([self._celsius]))
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
        if self._alignment.is_watching:
            self._unseen.append(sample[0].tolist())
            if len(self._unseen) == MOST_UNSEEN:
                self._show()
        if sample[0, 0] >= self._withheld.due:
            self._withheld.before(float(sample[0, 0]), self._memory)
        self._filter(self._memory, sample, self._log, self._none)
        if self._memory[Imu.FAULTS:Imu.FAULTS + Fault.SIZE].tobytes() != self._said_faults:
            self._say_faults(stamp)
        if self._pending:
            self._judge()
        self._say_new_starts()
        if stamp - self._newest_fix > self._outage_after and not self._outage:
            self._outage = True
            self.say('warning', f'no fix used from {self.config.gnss.topic} for '
                                f'{(stamp - self._newest_fix) * 1e-9:.1f} s: coasting on prediction')
        return True

    def _filter(self, memory, samples, events, arrival) -> int:
        """Pass samples and measurements to the kernel; returns its answer to the measurement."""
        kernel.run(memory, samples, events, arrival, self._answer, self._columns, self._none, self._states,
                   self._log)
        return int(self._answer[0])

    def add_temperature(self, stamp: int, celsius: float) -> None:
        """Temperature of the sensors from now on, degrees Celsius."""
        if math.isfinite(celsius):
            self._celsius = celsius
        else:
            self.say('warning', f'{self.config.imu.temperature_topic}: temperature {celsius}: dropped')

    def add_fix(self, stamp: int, latitude, longitude, height, covariance, status=0, covariance_type=2) -> None:
        """Take one fix of the antenna: rad, m; covariance: nine numbers, east-north-up, as in `NavSatFix`."""
        if self._using_fixes:
            fix = self._fix
            fix.stamp[0], fix.latitude[0], fix.longitude[0], fix.height[0] = stamp, latitude, longitude, height
            self._covariance[:] = covariance if len(covariance) == 9 else np.ravel(covariance)
            fix.status[0], fix.covariance_type[0] = status, covariance_type
            self._add(Kind.POSITION, fix)

    def add(self, name: str, stamp: int, *numbers) -> None:
        """Take one measurement of the input `name`; numbers: fields of its samples (`Measurement.samples`), in order.
        """
        measurement = next(m for m in self.config.inputs.values() if m.name == name)
        if self._using_fixes or not measurement.of_antenna:
            stamps, values = np.array([stamp], dtype=np.int64), (np.array([number], dtype=float) for number in numbers)
            with np.errstate(over='ignore', invalid='ignore'):  # what no sensor measures is refused by its event
                self._add(measurement.number, measurement.samples(stamps, stamps, *values))

    def _add(self, kind: int, samples) -> None:
        stamp = int(samples.stamp[0])
        if self._epoch is None:  # no IMU sample yet
            return
        used, events = self.measured(kind, samples, self._follow[:1], self._epoch)
        tally = self.tallies[self.name(kind)]
        if not len(used):
            tally.refuse(stamp, self.refusal)
            return
        event = events[0]
        stamp = self._epoch + round(float(event[Event.TIME]) * 1e9)  # float: numpy rounds ten times slower
        if kind == Kind.POSITION:
            self._height_sigma = math.sqrt(event[Event.R_DD])
            if self.datum is None:
                self._first_places.append(event[[Event.LATITUDE, Event.LONGITUDE, Event.HEIGHT]].tolist())
                self.datum = first_place(self._first_places) if len(self._first_places) == DATUM_FIXES else None
        if self._memory is None:
            if event[Event.KIND] in (Kind.MAGNETIC, Kind.PLACE):
                self._alignment.add_input(event)
            elif kind == Kind.POSITION:
                start = self._alignment.add_event(event, self.say)
                if start is not None:
                    self._begin(start, stamp)
                else:
                    self._without_heading = self._alignment.provisional()
                    self._provisional = None if self._without_heading is None else self._started(self._without_heading)
            return
        if kind == Kind.POSITION and self._unseen:
            self._show()
            if self._alignment.takes_back_the_start(event, self.say):
                self._begin_again()
                return
        event[Event.ID] = self._ids
        self._ids += 1
        answer = self._filter(self._memory, self._sample[:0], events, self._before)
        if answer != TAKEN:
            self.say_not_taken(kind, answer, stamp, self._now)
            tally.refuse(stamp, 'too late')
            return
        self._pending[self._ids - 1] = kind, stamp
        self._judge()  # a new start is told with the next sample

    def _begin(self, start: Start, stamp: int) -> None:
        self._memory, self._newest_fix = self._started(start), stamp
        self._follow_withheld()
        self._provisional = None

    def _show(self) -> None:
        """Give the samples since the latest fix to the alignment, which watches. One by one it takes 50 us each."""
        self._alignment.add_samples(np.array(self._unseen))
        self._unseen.clear()

    def _begin_again(self) -> None:
        """Discard the running filter, and go on with the alignment."""
        self._memory, self._withheld = None, Withheld(self.config)
        self._pending.clear()
        self._outage = False

    def _follow_withheld(self) -> None:
        """Have copies without fixes of the present filter, where a horizon is asked of it."""
        if self.announces:
            self._withheld.begin(float(newest_row(self._memory)[Nav.TIME]))

    def _started(self, start: Start) -> np.ndarray:
        """Memory of a filter that has begun with `start` and processed all samples since."""
        memory = self.config.memory()
        initialize(memory, self.config, start)
        if self.datum is None:
            self.datum = first_place(self._first_places or [(start.latitude, start.longitude, start.height)])
        self._filter(memory, np.ascontiguousarray(self._alignment.samples_after(start.time)), self._log, self._none)
        return memory

    def set_start(self, latitude, longitude, height, yaw, covariance) -> None:
        """Restart at a given pose. rad, m; yaw clockwise from north; covariance (4, 4) of north, east, down (m), yaw.

        The speed, along the yaw, is the filter's present one, or zero at standstill; where it is unknown, zero with
        UNKNOWN_SPEED_SIGMA. The estimated sensor errors are kept.
        """
        if self._epoch is None:
            self.say('warning', 'start pose: no IMU sample yet, nothing to start from')
            return
        speed, speed_sigma, still, errors = 0.0, UNKNOWN_SPEED_SIGMA, self._alignment.standing(), None
        wheels = None
        if self._memory is not None:
            self.update_odometry()
            speed, speed_sigma = float(self.odometry[LINEAR]), math.sqrt(self.odometry[TWIST_COVARIANCE])
            errors, wheels = sensor_errors_of(self.config, self._memory), wheel_vibration.calibration(self._memory)
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
        """State for the state file (snapshot.py); None while there is no heading."""
        return None if self._memory is None else make_snapshot(self.config, self._memory, self._now)

    def restore(self, snapshot: dict, max_distance: float) -> str:
        """Start from a snapshot, if the vehicle has not moved since; max_distance: m, from the saved position.

        Returns in words which parts are used. Raises ValueError where `snapshot` is not one.
        """
        if self._memory is not None or self._epoch is None:
            raise ValueError('the filter has started already, or has no IMU sample yet')
        saved, said = from_snapshot(self.config, snapshot, self._now, max_distance)
        self._alignment.use_saved(saved)
        return said

    def _judge(self) -> None:
        """Report the measurements that the filter has applied or refused since the last call."""
        for identity, (kind, stamp) in list(self._pending.items()):
            at = kernel.find_event(self._memory, identity)
            if at < 0:  # the memory has dropped it: too many measurements wait for IMU samples
                del self._pending[identity]
                continue
            event = self._memory[at:at + Event.SIZE].tolist()
            verdict = int(event[Event.VERDICT])
            if verdict == Verdict.PENDING:
                continue
            del self._pending[identity]
            used = verdict in (Verdict.USED, Verdict.WEIGHTED, Verdict.RECOVERED)
            measurement = self.config.inputs[kind]
            self._judged.append(Judgement(stamp, measurement.name, used, event[Event.WEIGHT], VERDICTS[verdict],
                                          tuple(event[Event.Z_N:Event.Z_N + measurement.components]),
                                          event[Event.NIS]))
            tally, misfit = self.tallies[measurement.name], event[Event.NIS] / measurement.components
            if used:
                tally.use(misfit)
            elif verdict != Verdict.AWAITED:  # this verdict is usual at the beginning of a drive
                tally.refuse(stamp, VERDICTS[verdict], misfit if verdict == Verdict.REFUSED else math.nan)
                self.say('warning', f'{self.topic(kind)}: {self._refusal(kind, verdict, stamp, event)}')
            if kind == Kind.POSITION:
                self._fix_judged(used, stamp, event)

    def _fix_judged(self, used: bool, stamp: int, event) -> None:
        topic = self.config.gnss.topic
        self._recent.append(event)
        if stamp >= self._next_look:
            said = vehicle_warnings(self._memory, self.config, np.array(self._recent))
            self._next_look = stamp + (_MESSAGE_PERIOD if said else _CHECK_PERIOD)
            for text in said:
                if text not in self._said:  # a lasting condition is reported once
                    self.say('warning', text)
            self._said = said
            if not self._said_mounting and (found := found_mounting(self._memory, self.config)):
                self._said_mounting = True
                self.say('warning', f'{self.config.imu.topic}: {found}')
            for kind, text in found_time_offsets(self._memory, self.config).items():
                if kind not in self._said_late:
                    self._said_late.add(kind)
                    self.say('warning', f'{self.topic(kind)}: {text}')
        if not used:
            return
        self._newest_fix = max(self._newest_fix, stamp)
        if self._outage and self._now - stamp < self._outage_after:
            self._outage = False
            self.say('info', f'fixes on {topic} again')

    def update_odometry(self) -> int:
        """Write the newest estimate to `odometry`, `geodetic` and `position_covariance_enu`; returns its stamp, ns."""
        odometry(self._estimating, self.datum, self._height_sigma, self.odometry, self.geodetic,
                 self.position_covariance_enu)
        if self._memory is None:
            widen_without_heading(self._without_heading, self.datum, self.odometry, self.geodetic,
                                  self.position_covariance_enu)
        return self._now

    def warm_up(self) -> None:
        """Compile or load the kernel now, so that the first message is not delayed."""
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
        filled = self.odometry.copy(), self.geodetic.copy(), self.position_covariance_enu.copy()
        odometry(memory, datum, 1.0, *filled)
        widen_without_heading(start, datum, *filled)
        self._memory, before = memory, self._memory
        self.health()
        self.snapshot()
        Withheld(self.config).warm_up(memory)
        self._memory = before
        follow = self._follow.copy()
        self.follow(np.array([0], dtype=np.int64), sample[:, 1:])
        self._follow[:] = follow
