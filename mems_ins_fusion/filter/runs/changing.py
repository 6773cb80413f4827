"""A live filter whose parameters change while it drives: one with the new ones runs beside it until it takes its place.

The new filter begins with nothing, aligns by itself and has the same messages; one with what is on trial does so before
it is asked for. How far the fixes are from where either filter expects them is a bet each second (`betting.py`). The
new filter takes over once that has shown that its state is better, or once it is as sure as the present one and where
the change does not show: the estimates differ by less than both publish as their sigmas, or the vehicle stands. The
filter that it replaces runs on beside, without the finding that has been applied; where the finding has become wrong -
a driver has been restarted - the filter without it is better within seconds and takes over at once. All filters and
comparisons depend on nothing but stamps and numbers of what comes in: live and in a replay it is the same sample.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...navigation.frames import wrap, yaw_of_quaternion
from ..config import FilterConfig
from ..memory import Event
from .betting import Bets
from .live import FusionFilter
from .odometry import LINEAR, ORIENTATION, POSE_COVARIANCE, POSITION, TWIST_COVARIANCE

#: s for which the new filter runs beside the present one before they are compared: its sensor errors settle in that
SETTLING = 60.0
#: s after which it takes over wherever it is: its parameters have been proven to be better
LONGEST = 180.0
#: sigmas of position and heading, as parts of those of the present filter, with which the new one is as sure: a filter
#: that has just begun is less sure for a minute or two, and rightly so
AS_SURE = 1.25
#: ns from one comparison to the next
PERIOD = 10**9
#: wealth of the filter without a finding at which that is dropped: where the finding does good, it comes to that once
#: in so many bets at most, which is a day
DROPPED = 86_400.0
#: wealth of a new filter at which its state is better than the present one, whatever both say of themselves: its
#: parameters have been proven before
SHOWN_BETTER = 20.0
#: fixes whose misfit is kept: two filters judge the same fix within seconds, or one of them does not
KEPT = 100
#: m/s: a slower vehicle stands, and no controller depends on its pose
STANDING = 0.05
#: of the filter that drives, not of its parameters: what others look at or have heard, and counts since the start
_STAYS = frozenset({'odometry', 'geodetic', 'position_covariance_enu', 'datum', 'tallies', 'gaps', 'waited', '_notices',
                    '_judged', '_said', '_said_mounting', '_next_look', '_recent', '_last_recovery', '_using_fixes'})


@dataclass(frozen=True)
class Handover:
    """A filter has taken the place of another. stamp: ns. By how much the estimate has changed: m, rad."""

    stamp: int
    position: float
    yaw: float

    @property
    def text(self) -> str:
        """In words."""
        return (f'the filter goes on with other parameters: position {self.position:.2f} m, heading '
                f'{math.degrees(self.yaw):+.2f} deg from where it was')


@dataclass(frozen=True)
class Dropped:
    """A finding that is not true any more. since: ns, when it began to predict worse; stamp: when it was dropped."""

    name: str
    since: int
    stamp: int


class WatchedFilter(FusionFilter):
    """`FusionFilter` that keeps how far each fix was from where it was expected, by the fix's number."""

    def __init__(self, config: FilterConfig):
        self._numbers: dict[int, int] = {}  # of fixes that are not judged yet, by the id of their record
        self.misfits: dict[int, tuple[float, float]] = {}
        super().__init__(config)

    def add_numbered(self, number: int, *fix) -> None:
        """`add_fix` of the fix with this number."""
        self._numbers[self._ids] = number
        FusionFilter.add_fix(self, *fix)

    def _fix_judged(self, used: bool, stamp: int, record) -> None:
        super()._fix_judged(used, stamp, record)
        number = self._numbers.pop(int(record[Event.ID]), None)
        if number is not None and record[Event.NIS] > 0.0:  # one that was not compared has none
            self.misfits[number] = float(record[Event.Z_N]), float(record[Event.Z_N + 1])
            self.misfits.pop(number - KEPT, None)


class Beside:
    """A filter with other findings than the one that drives, and how much better it is. begun: ns. since: ns, when its
    wealth was last what it began with. after: number of the newest fix before it is compared."""

    def __init__(self, fusion: WatchedFilter, begun: int, after: int):
        self.fusion, self.begun, self.since = fusion, begun, begun
        self._bets, self._compared = Bets(), after

    def is_better(self, wealth: float) -> bool:
        """Whether the bets on it have come to `wealth`."""
        return self.fusion.aligned and self._bets.pro >= math.log(wealth)

    def compare(self, driving: dict[int, tuple[float, float]], now: int) -> None:
        """Bet on the fixes that both filters have judged since the last time, on their mean: errors of one second go
        together. driving: misfits of the filter that drives. now: ns."""
        own = self.fusion.misfits
        both = sorted(number for number in driving.keys() & own.keys() if number > self._compared)
        if both:
            self._compared = both[-1]
            self._bets.take(*(tuple(np.mean([misfits[number] for number in both], axis=0).tolist())
                              for misfits in (driving, own)))
            if self._bets.pro <= 0.0:
                self._bets.pro, self.since = 0.0, now


class ChangingFilter(WatchedFilter):
    """`FusionFilter` with `change`."""

    def __init__(self, config: FilterConfig):
        self._next: Beside | None = None
        self._slot, self._fixes = 0, 0  # ns, of the newest comparison; count
        self._without: dict[str, dict] = {}  # parameters without each finding that is applied, or about to be
        self._beside: dict[str, Beside] = {}
        self._ready: list[Beside] = []  # with what is on trial
        self._dropped: list[Dropped] = []
        self.handovers: list[Handover] = []
        super().__init__(config)

    @property
    def changing(self) -> bool:
        """Whether a filter with other parameters runs beside this one."""
        return self._next is not None

    @property
    def _others(self) -> list[WatchedFilter]:
        return [one.fusion for one in self._running]

    @property
    def _running(self) -> list[Beside]:
        return [*([] if self._next is None else [self._next]), *self._beside.values(), *self._ready]

    def change(self, values: dict, without: dict[str, dict] | None = None) -> None:
        """Go on with the checked parameters `values`, as soon as a filter that has them is where this one is.

        without: the parameters without each finding that is part of them, by its name.
        """
        self._without = without or {}
        self._next = self._having(values)
        self._ready = [one for one in self._ready if one is not self._next]

    def prepare(self, several: list[dict]) -> None:
        """Have filters with each of these checked parameters run beside, so that one that is to take over has settled
        by then; those with others end."""
        self._ready = [self._having(values) for values in several]

    def watch(self, without: dict[str, dict]) -> None:
        """Filters without each finding that is part of the parameters, beside this one: as after `change`."""
        self._without = without
        self._beside = {name: self._beside_with(values) for name, values in without.items()}

    def dropped(self) -> list[Dropped]:
        """Findings that have been dropped since the last call: the filter goes on without them."""
        dropped, self._dropped = self._dropped, []
        return dropped

    def _having(self, values: dict) -> Beside:
        """The filter that is ready with the parameters `values`, or one that begins."""
        there = next((one for one in self._ready if one.fusion.config.parameters == values), None)
        return there or self._beside_with(values)

    def _beside_with(self, values: dict) -> Beside:
        fusion = WatchedFilter(FilterConfig.from_parameters(values))
        fusion.use_fixes(self._using_fixes)
        return Beside(fusion, self._now, self._fixes)

    def add_imu(self, stamp: int, *numbers) -> bool:
        new = super().add_imu(stamp, *numbers)
        for other in self._others:
            other.add_imu(stamp, *numbers)
        if self._others and stamp // PERIOD != self._slot:
            self._slot = stamp // PERIOD
            for other in self._others:
                other.notices(), other.verdicts()  # said by the filter that drives
            self._compare(stamp)
        return new

    def add_fix(self, *fix) -> None:
        self._fixes += 1
        for fusion in (self, *self._others):
            fusion.add_numbered(self._fixes, *fix)

    def add(self, name: str, stamp: int, *numbers) -> None:
        super().add(name, stamp, *numbers)
        for other in self._others:
            other.add(name, stamp, *numbers)

    def add_temperature(self, stamp: int, celsius: float) -> None:
        super().add_temperature(stamp, celsius)
        for other in self._others:
            other.add_temperature(stamp, celsius)

    def adopt(self, config: FilterConfig) -> None:
        super().adopt(config)
        for other in self._others:
            other.adopt(other.changed(config.parameters))

    def use_fixes(self, use: bool) -> None:
        super().use_fixes(use)
        for other in self._others:
            other.use_fixes(use)

    def set_start(self, *start) -> None:
        super().set_start(*start)
        for other in self._others:
            other.set_start(*start)

    def reset(self) -> None:
        super().reset()
        for other in self._others:
            other.reset()

    def _compare(self, now: int) -> None:
        """Take over where it is time: a new filter that is where this one is, or one without a wrong finding."""
        for one in self._running:
            one.compare(self.misfits, now)
        wrong = next((name for name, one in self._beside.items() if one.is_better(DROPPED)), None)
        if wrong is not None:
            self._drop(wrong, now)
        elif self._next is not None:
            self._follow_up(now)

    def _follow_up(self, now: int) -> None:
        other, waited = self._next.fusion, now - self._next.begun
        if not self.has_estimate:
            self._take_over(other, now, 0.0, 0.0)
        elif other.aligned and waited >= SETTLING * 1e9:
            position, velocity, yaw = self._from(other)
            stands = max(abs(self.odometry[LINEAR]), abs(other.odometry[LINEAR])) < STANDING
            smooth = stands or _covered(position, velocity, yaw, self.odometry, other.odometry)
            if ((smooth and _as_sure(self.odometry, other.odometry)) or self._next.is_better(SHOWN_BETTER)
                    or waited >= LONGEST * 1e9):
                self._take_over(other, now, position, yaw)

    def _from(self, other: FusionFilter) -> tuple[float, float, float]:
        """How far the estimate of `other` is from this one: m, m/s, rad."""
        other.datum = self.datum
        self.update_odometry()
        other.update_odometry()
        return _differences(self.odometry, other.odometry)

    def _drop(self, name: str, now: int) -> None:
        """Go on without a finding, at once: what it is worth has been shown. What else is applied is watched by the
        diagnosis alone from now on."""
        one, without = self._beside[name], self._without.get(name)
        position, _, yaw = self._from(one.fusion)
        self._dropped.append(Dropped(name, one.since, now))
        pending, self._next = self._next is not None, None
        self._take_over(one.fusion, now, position, yaw)
        self._beside, self._without = {}, {}
        if pending:
            self.change(without)

    def _take_over(self, other: WatchedFilter, now: int, position: float, yaw: float) -> None:
        """Go on as `other`; the present filter goes on beside, where it is one without a finding."""
        before = WatchedFilter(self.config)
        before.__dict__.update({name: vars(self)[name] for name in vars(before) if name not in _STAYS})
        filters = (before, *(one.fusion for one in self._beside.values()))
        self._next = None
        self.__dict__.update({name: value for name, value in vars(other).items() if name not in _STAYS})
        self._beside = {}
        for name, values in self._without.items():
            there = next((fusion for fusion in filters if fusion.config.parameters == values), None)
            self._beside[name] = self._beside_with(values) if there is None else Beside(there, now, self._fixes)
        self.handovers.append(Handover(now, position, yaw))
        self.say('info', self.handovers[-1].text)


def _differences(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Of two odometries (85,): horizontal distance m, of the velocities m/s, and of the yaw from the first, rad."""
    position = math.hypot(*(b - a)[POSITION:POSITION + 2])
    velocity = math.hypot(*(b - a)[LINEAR:LINEAR + 2])
    yaw = wrap(yaw_of_quaternion(*b[ORIENTATION:POSE_COVARIANCE]) - yaw_of_quaternion(*a[ORIENTATION:POSE_COVARIANCE]))
    return position, velocity, float(yaw)


def _as_sure(present: np.ndarray, other: np.ndarray) -> bool:
    """Whether the odometry `other` (85,) claims position and heading about as well as `present`."""
    a, b = (odometry[POSE_COVARIANCE:LINEAR].reshape(6, 6) for odometry in (present, other))
    return bool(b[0, 0] + b[1, 1] <= AS_SURE**2 * (a[0, 0] + a[1, 1]) and b[5, 5] <= AS_SURE**2 * a[5, 5])


def _covered(position: float, velocity: float, yaw: float, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether differences are within one sigma of what the odometries `a` and `b` (85,) claim together."""
    pose = (a + b)[POSE_COVARIANCE:LINEAR].reshape(6, 6)
    twist = (a + b)[TWIST_COVARIANCE:].reshape(6, 6)
    return (position**2 <= pose[0, 0] + pose[1, 1] and velocity**2 <= twist[0, 0] + twist[1, 1]
            and yaw**2 <= pose[5, 5])
