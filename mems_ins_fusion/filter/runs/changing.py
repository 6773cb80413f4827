"""A live filter whose parameters change while it runs: a filter with the new ones runs in parallel, then takes over.

The new filter begins with position, heading and speed of the present one and gets the same messages. For parameters on
trial it is started in advance. The innovations of the fixes in both filters are compared each second (betting.py). The
new filter takes over once it is shown to be better, or once it is about as certain as the present one. The replaced
filter, which does not contain the finding that was applied, continues in parallel: if the finding becomes wrong, as
when a driver is restarted, this filter is better within seconds and takes over at once. Before this is certain, the
published estimate goes over to it (`ParallelFilter.weight`) and its covariance covers both. Where the fixes jump, a
copy of the present filter goes on without the finding (`ChangingFilter._branch`): an antenna that is moved is shown by
the jump itself, before the turn that both filters need. What is published does not jump (blending.py). All decisions
depend only on stamps and values of the inputs: live and in a replay the filters change at the same sample.
"""
from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from ...navigation.frames import wrap, yaw_of_quaternion
from ..bank import Bank
from ..config import FilterConfig
from ..memory import Event
from ..start.course import start_covariance
from ..start.start import Start
from .betting import CLEAR, Bets
from .blending import Blending, blending
from .horizon import Horizon, HorizonPredictor
from .live import FusionFilter
from .odometry import LINEAR, ORIENTATION, POSE_COVARIANCE, POSITION, TWIST_COVARIANCE
from .turning import turn, turns_into
from .turning import warm_up as warm_up_turning

SETTLING = 60.0  # s for which the new filter runs before it may take over: its sensor errors settle in that time
#: s after which the new filter takes over unless its alignment was wrong (LOST): its parameters are proven to be better
LONGEST_WAIT = 180.0
#: largest ratio of the standard deviations of position and heading, new over present filter, at which the new one takes
#: over before LONGEST_WAIT. A filter that has just started is less certain for a minute or two, for longer while it
#: estimates its mounting
AS_SURE = 1.5
#: ratio above which, after LONGEST_WAIT, the alignment of the new filter was wrong, so that it is started again. A
#: filter with a good alignment is within 1.5 by then; one that has taken a reversing vehicle for one that drives off
#: forwards has a ratio of a hundred
LOST = 3.0
#: m, standard deviation of the position with which a new filter begins at the state of the present one. This and the
#: next two cover lever arms of metres, a time offset of 0.3 s, and the errors that these cause in the present filter.
#: An alignment of its own could take a reversing vehicle for one that drives off, and be wrong for minutes
BEGIN_POSITION = 5.0
#: m/s, the same of the speed
BEGIN_SPEED = 1.0
#: rad, the same of the heading
BEGIN_HEADING = math.radians(10.0)
COMPARISON_PERIOD = 10**9  # ns from one comparison to the next
#: wealth (betting.py) of the filter without a finding above which the finding is dropped. A useful finding is dropped
#: at most once in this many comparisons, which are a day; each branch, of which at most one begins in a comparison,
#: counts like one more
DROPPED = 86_400.0
#: wealth above which a new filter takes over although it is less certain, and the filter without a finding that is
#: doubted (`ChangingFilter.doubt`). Smaller than DROPPED, as there is evidence besides the innovations: the new
#: parameters have been proven, and another value than the doubted one is on trial
SHOWN_BETTER = 20.0
#: distance of a jump's end from a prediction over the length of the jump: one in SHOWN_BETTER directions meets a circle
#: of this radius, whatever the length
NEAR = math.sin(math.pi / SHOWN_BETTER)
#: number of fixes whose innovations are kept: two filters process the same fix within seconds of each other
KEPT_FIXES = 100
#: attributes of the filter object that stay when another filter takes over: outputs, messages and counts
_STAYS = frozenset({'odometry', 'geodetic', 'position_covariance_enu', 'datum', 'tallies', 'gaps', 'waited', '_notices',
                    '_judged', '_said', '_said_mounting', '_said_late', '_next_look', '_recent',
                    '_last_recovery', '_using_fixes'})


@dataclass(frozen=True)
class Handover:
    """A change to another filter. stamp: ns. position, yaw: difference of the estimates, m and rad; the published
    estimate changes by it within `blending.BLENDING`."""

    stamp: int
    position: float
    yaw: float

    @property
    def text(self) -> str:
        """The change in words, for a message."""
        return (f'the filter goes on with other parameters: position {self.position:.2f} m, heading '
                f'{math.degrees(self.yaw):+.2f} deg from where it was')


@dataclass(frozen=True)
class Dropped:
    """A finding that is no longer valid. since: ns, when predictions with it became worse; stamp: ns, when it was
    dropped."""

    name: str
    since: int
    stamp: int


class WatchedFilter(FusionFilter):
    """`FusionFilter` that keeps the innovations of the fixes, by a number of the fix that several filters share."""

    announces = False

    def __init__(self, config: FilterConfig):
        self._numbers: dict[int, int] = {}  # by Event.ID: numbers of fixes that are not processed yet
        self.misfits: dict[int, tuple[float, float]] = {}
        super().__init__(config)

    def begin_at(self, other: FusionFilter) -> None:
        """Begin at the state of `other`, whose newest sample is the first one of this filter."""
        FusionFilter.update_odometry(other)
        yaw = math.pi / 2.0 - float(yaw_of_quaternion(*other.odometry[ORIENTATION:POSE_COVARIANCE]))
        # the IMU is the same, only the mounting by which its axes are related to the vehicle's differs
        yaw += self.config.parameters['imu.mounting_rpy'][2] - other.config.parameters['imu.mounting_rpy'][2]
        speed, epoch = float(other.odometry[LINEAR]), self._now
        self.reset()
        self._epoch = epoch
        covariance = start_covariance(BEGIN_POSITION**2 * np.eye(2), yaw, BEGIN_HEADING, speed, BEGIN_SPEED)
        velocity = speed * np.array([math.cos(yaw), math.sin(yaw)])
        self._begin(Start(0.0, *other.geodetic.tolist(), velocity, float(wrap(yaw)), covariance, None), epoch)

    def begin_as(self, other: FusionFilter) -> None:
        """Begin at the whole state of `other`, whose newest sample is the first one of this filter. Of its settings
        those that differ between both configurations are replaced."""
        self.reset()
        if other._memory is None:
            return
        self._epoch, self._ids, self._newest_fix = other._epoch, other._ids, other._newest_fix
        self._memory = other._memory.copy()
        before, after = other.config.memory(), self.config.memory()
        differ = np.flatnonzero((before != after) & ~(np.isnan(before) & np.isnan(after)))
        size = int(self._memory[Bank.SIZE])
        for one in (self._memory, self._memory[size:]) if self._memory[Bank.OPEN] else (self._memory,):
            one[differ] = after[differ]

    def turn_into(self, values: dict) -> None:
        """Go on with the checked parameters `values`, of another mounting (`turns_into`)."""
        config = FilterConfig.from_parameters(values)
        turn(self._memory, self.config, config)
        self.config, self._correctors, self._horizon = config, config.correctors(), HorizonPredictor(config)
        self._follow_withheld()

    def add_numbered(self, number: int, *fix) -> None:
        """`add_fix` for the fix that has this number in all parallel filters."""
        self._numbers[self._ids] = number
        FusionFilter.add_fix(self, *fix)

    def _fix_judged(self, used: bool, stamp: int, event) -> None:
        super()._fix_judged(used, stamp, event)
        number = self._numbers.pop(int(event[Event.ID]), None)
        if number is not None and event[Event.NIS] > 0.0:  # a refusal without an innovation has none
            self.misfits[number] = float(event[Event.Z_N]), float(event[Event.Z_N + 1])
            self.misfits.pop(number - KEPT_FIXES, None)


class ParallelFilter:
    """A filter with other parameters than the present one, and the bets on it.

    begun: ns. since: ns, when its wealth was last at its initial value. after: number of the last fix before the
    comparison. settling: s with fixes in both filters before the first bet, if neither has run before: a filter that
    has just aligned predicts worse by chance. is_new: it has no sample yet. branch_of: where this filter is a branch (a
    copy of the present filter, begun where the fixes jumped): the filter without the same finding that was running
    then; its error statistics are taken over.
    """

    def __init__(self, fusion: WatchedFilter, begun: int, after: int, settling: float = 0.0, is_new: bool = False,
                 branch_of: ParallelFilter | None = None):
        self.fusion, self.begun, self.since, self.is_new = fusion, begun, begun, is_new
        self.is_branch, self._has_bet = branch_of is not None, False
        self._bets, self._compared, self._settling = Bets(), after, settling
        if branch_of is not None:
            self._bets = deepcopy(branch_of._bets)
            self._bets.begin_anew()
        self._settled: int | None = None  # ns, from when on there are bets
        self._weights, self._bet = (0.0, 0.0), begun  # `weight` before the last bet and a second after it; ns, the bet

    @property
    def usual_distance(self) -> float:
        """Mean distance of a fix from the nearer one of both predictions, m; 0 before the first fix."""
        return self._bets.usual_distance

    @property
    def is_refuted(self) -> bool:
        """Whether this filter, a branch, has ended: the first fixes after the jump were too far from its prediction, or
        bets on later ones have lost what it began with."""
        return self._has_bet and self._bets.pro <= 0.0

    def begin_anew(self) -> None:
        """Reset the comparison: both filters have to align again."""
        self._settled, self._weights = None, (0.0, 0.0)

    @property
    def log_wealth(self) -> float:
        """Logarithm of the wealth staked on this filter."""
        return self._bets.pro

    def is_better(self, wealth: float) -> bool:
        """Whether the wealth staked on this filter is above `wealth`. The first second of fixes brings a branch to
        SHOWN_BETTER, which is not above it: it has to win a bet as well."""
        return self.fusion.aligned and self.log_wealth > math.log(wealth)

    def weight(self, stamp: int) -> float:
        """Weight of this filter, which is without a finding, in the published estimate at `stamp`, ns: 1 less the
        inverse of the odds that the finding is wrong, 1 to SHOWN_BETTER times the wealth; none below equal odds, from
        where it grows without a step. It changes within a second."""
        before, after = self._weights
        part = min((stamp - self._bet) / COMPARISON_PERIOD, 1.0)
        return before + (after - before) * part if self.fusion.aligned else 0.0

    def compare(self, present: dict[int, tuple[float, float]], now: int) -> None:
        """Bet on the mean innovation of the fixes that both filters have processed since the last call.

        The mean, as errors within a second are correlated. present: innovations of the present filter. now: ns.
        """
        own = self.fusion.misfits
        both = sorted(number for number in present.keys() & own.keys() if number > self._compared)
        if not both:
            return
        self._compared = both[-1]
        self._settled = now + round(self._settling * 1e9) if self._settled is None else self._settled
        if now < self._settled:
            self.since = now
            return
        means = [tuple(np.mean([misfits[number] for number in both], axis=0).tolist()) for misfits in (present, own)]
        if self.is_branch and not self._has_bet:
            self._bets.pro = math.log(SHOWN_BETTER) if _meets(*means) else 0.0
            self._bets.see(*means)
        else:
            self._bets.take(*means)
        self._has_bet = True
        if self._bets.pro <= 0.0:
            self._bets.pro, self.since = 0.0, now
        self._weights = self.weight(now), max(1.0 - SHOWN_BETTER * math.exp(-self._bets.pro), 0.0)
        self._bet = now


def _meets(present: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether a filter that is right behind a jump of the fixes away from the present one is met by it, as a jump in a
    direction by chance would meet it with a probability of 1 / SHOWN_BETTER. present, other: innovations, m."""
    return math.hypot(*other) < NEAR * math.dist(present, other)


class ChangingFilter(WatchedFilter):
    """`FusionFilter` with `change`."""

    announces = True

    def __init__(self, config: FilterConfig):
        self._next: ParallelFilter | None = None  # the filter that is to take over
        self._slot, self._fixes = 0, 0  # period of the newest comparison; number of fixes
        self._without: dict[str, dict] = {}  # parameters without each finding that is applied, or about to be
        self._beside: dict[str, ParallelFilter] = {}  # filters without each finding
        #: filters that go on from a jump of the fixes without a finding, as if it had become wrong in that moment
        self._branches: dict[str, ParallelFilter] = {}
        self._ready: list[ParallelFilter] = []  # filters with parameters on trial
        self._doubted: frozenset[str] = frozenset()
        self._dropped: list[Dropped] = []
        self._blending: Blending | None = None
        self._said_suspected: str | None = None  # `_suspected` of the last message on it
        #: north and east, m: distance of the published position from the further one of the two filters it is between
        self._further = 0.0, 0.0
        self.handovers: list[Handover] = []
        super().__init__(config)

    @property
    def changing(self) -> bool:
        """Whether a filter with other parameters is to take over."""
        return self._next is not None

    @property
    def _others(self) -> list[WatchedFilter]:
        return [one.fusion for one in self._running]

    @property
    def _running(self) -> list[ParallelFilter]:
        return [*([] if self._next is None else [self._next]), *self._beside.values(), *self._branches.values(),
                *self._ready]

    def _without_it(self, name: str) -> ParallelFilter:
        """The filter without a finding that speaks more against it."""
        return max((some[name] for some in (self._beside, self._branches) if name in some),
                   key=lambda one: one.weight(self._now))

    def change(self, values: dict, without: dict[str, dict] | None = None) -> None:
        """Change to the checked parameters `values` as soon as a filter with them can take over.

        without: by name of each finding in them, the parameters without it.
        """
        self._without = without or {}
        if self.aligned and turns_into(self.config, values):
            self._turn(values)
            return
        # where a finding is taken back, the filter without it runs already
        there = max((one for one in (*self._beside.values(), *self._branches.values())
                     if one.fusion.config.parameters == values), key=lambda one: one.log_wealth, default=None)
        suspected = self._suspected
        if suspected is not None:
            self.update_odometry()
        published = self.odometry.copy()
        self._next = there or self._having(values)
        self._ready = [one for one in self._ready if one is not self._next]
        self._beside, self._branches = ({name: one for name, one in some.items() if one is not self._next}
                                        for some in (self._beside, self._branches))
        if suspected is not None and suspected != self._suspected:
            self._begin_blending(published)

    def prepare(self, several: list[dict]) -> None:
        """Run a filter with each of these checked parameters in parallel, so that it has settled when it is to take
        over; not where the present one can be turned. Filters that were prepared before are dropped."""
        self._ready = [self._having(values) for values in several if not turns_into(self.config, values)]

    def watch(self, without: dict[str, dict]) -> None:
        """Run in parallel, for each finding in the present parameters, a filter without it, as after `change`."""
        self._without = without
        self._beside = {name: self._beside_with(values, SETTLING) for name, values in without.items()}

    def doubt(self, names: frozenset[str]) -> None:
        """Take these findings for doubtful: of each another value is on trial, so that less evidence of the fixes
        (SHOWN_BETTER) is enough to drop one."""
        self._doubted = names

    def dropped(self) -> list[Dropped]:
        """Findings that the filter has dropped since the last call."""
        dropped, self._dropped = self._dropped, []
        return dropped

    def _having(self, values: dict) -> ParallelFilter:
        """The prepared filter with the parameters `values`, or a new one."""
        there = next((one for one in self._ready if one.fusion.config.parameters == values), None)
        return there or self._beside_with(values)

    def _beside_with(self, values: dict, settling: float = 0.0,
                     branch_of: ParallelFilter | None = None) -> ParallelFilter:
        fusion = WatchedFilter(FilterConfig.from_parameters(values))
        fusion.use_fixes(self._using_fixes)
        return ParallelFilter(fusion, self._now, self._fixes, settling, True, branch_of)

    def add_imu(self, stamp: int, *numbers) -> bool:
        new = super().add_imu(stamp, *numbers)
        for one in self._running:
            one.fusion.add_imu(stamp, *numbers)
            if one.is_new and one.fusion._now == stamp:
                one.is_new = False
                if self.aligned:
                    (one.fusion.begin_as if one.is_branch else one.fusion.begin_at)(self)
        if self._others and stamp // COMPARISON_PERIOD != self._slot:
            self._slot = stamp // COMPARISON_PERIOD
            for other in self._others:
                other.notices(), other.verdicts()  # dropped: the present filter reports
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

    def update_odometry(self) -> int:
        """As `FusionFilter.update_odometry`, with the part of a filter without a finding that seems to be wrong, and
        the transition of `blending.py` after another filter has taken over."""
        stamp = super().update_odometry()
        self._further = 0.0, 0.0
        suspected = self._suspected
        if suspected is not None:
            self._move_toward(self._without_it(suspected), stamp)
        if self._blending is not None:
            part = self._blending.part(stamp)
            if part > 0.0:
                self._blending.add_to(self.odometry, self.geodetic, self.position_covariance_enu, part)
            else:
                self._blending = None
        return stamp

    @property
    def _suspected(self) -> str | None:
        """Name of the finding that seems to be wrong: the one without which the fixes are met best; None: there is
        none."""
        weight, best = max(((self._without_it(name).weight(self._now), name) for name in self._beside),
                           key=lambda found: found[0], default=(0.0, None))
        return best if weight > 0.0 else None

    def _move_toward(self, one: ParallelFilter, stamp: int) -> None:
        """Move the estimate at `stamp`, ns, by the weight of `one` toward it, with the square of the distance to the
        further one of both in the covariances: at a small weight `one` may well be right."""
        weight, other = one.weight(stamp), one.fusion
        other.datum = self.datum
        other.update_odometry()
        for covariance in (slice(POSE_COVARIANCE, LINEAR), slice(TWIST_COVARIANCE, None)):
            self.odometry[covariance] += weight * (other.odometry[covariance] - self.odometry[covariance])
        self.position_covariance_enu += weight * (other.position_covariance_enu - self.position_covariance_enu)
        toward = blending(stamp, other.odometry, self.odometry)
        further = max(weight, 1.0 - weight)
        toward.add_to(self.odometry, self.geodetic, self.position_covariance_enu, weight, further)
        self._further = further * float(toward.position[1]), further * float(toward.position[0])

    def horizon(self) -> Horizon | None:
        """As `FusionFilter.horizon`, of the published estimate."""
        if self._memory is None or (self._blending is None and self._suspected is None):
            return super().horizon()
        self.update_odometry()
        added = self._blending.left(self._now) if self._blending is not None else (*self._further, math.inf)
        return self._horizon.predict(self._memory, added=added, realised=self._withheld.realised)

    def warm_up(self) -> None:
        super().warm_up()
        blending(0, self.odometry, self.odometry).add_to(self.odometry.copy(), self.geodetic.copy(),
                                                         self.position_covariance_enu.copy(), 1.0)
        warm_up_turning(self.config)

    def reset(self) -> None:
        super().reset()
        self._blending, self._branches = None, {}
        for one in self._running:
            one.fusion.reset()
            one.begin_anew()

    def _compare(self, now: int) -> None:
        """Compare the parallel filters, and let one take over: a filter without a finding that is wrong, else the next.
        """
        for one in self._running:
            one.compare(self.misfits, now)
        self._branch(now)
        better = [(name, one) for some in (self._beside, self._branches) for name, one in some.items()
                  if one.is_better(SHOWN_BETTER if name in self._doubted else DROPPED)]
        if better:
            self._drop(*max(better, key=lambda found: found[1].log_wealth), now)
        elif self._next is not None:
            self._follow_up(now)
        self._say_suspected()

    def _branch(self, now: int) -> None:
        """Where the newest fix is so far off that a jump to another prediction would be clear, go on from here without
        each finding as well, as if it became wrong in this second; end what the fixes after it do not meet."""
        self._branches = {name: one for name, one in self._branches.items()
                          if name in self._beside and not one.is_refuted}
        off = math.hypot(*self.misfits[max(self.misfits)]) if self.misfits and self._memory is not None else 0.0
        for name, one in self._beside.items():
            config = one.fusion.config  # a time offset has room for other measurements, so its memory is no copy
            if (name not in self._branches and one.fusion._memory is not None
                    and 0.0 < CLEAR * one.usual_distance < NEAR * off
                    and config.layout == self.config.layout and len(one.fusion._memory) == len(self._memory)):
                self._branches[name] = self._beside_with(config.parameters, branch_of=one)

    def _say_suspected(self) -> None:
        """Say where the published estimate begins to move to a filter without a finding, and where it is back; nothing
        where that finding was dropped or taken back meanwhile."""
        before, self._said_suspected = self._said_suspected, self._suspected
        if self._said_suspected == before:
            return
        if self._said_suspected is not None:
            self.say('warning', f'{self._said_suspected}: the fixes are met better without it: the estimate moves '
                                'there, and its covariance covers both, until it is certain whether it is wrong')
        elif before in self._beside:
            self.say('info', f'{before}: the fixes are no longer met better without it: the estimate is the one '
                             'with it again')

    def _follow_up(self, now: int) -> None:
        other, waited = self._next.fusion, now - self._next.begun
        if not self.has_estimate or (other.aligned and not self.aligned):
            self._take_over(other, now, 0.0, 0.0)
        elif other.aligned and waited >= SETTLING * 1e9:
            position, yaw = self._from(other)
            late = waited >= LONGEST_WAIT * 1e9
            FusionFilter.update_odometry(self)  # its own certainty: what is published contains a part of another filter
            if (_as_sure(self.odometry, other.odometry, LOST if late else AS_SURE)
                    or self._next.is_better(SHOWN_BETTER)):
                self._take_over(other, now, position, yaw)
            elif late:
                self._next = self._beside_with(other.config.parameters)

    def _turn(self, values: dict) -> None:
        """Go on in the axes of another mounting, and the filters without each finding as well."""
        self._next, self._branches = None, {}
        self.update_odometry()
        published = self.odometry.copy()
        self.turn_into(values)
        for name, others in self._without.items():
            there = self._beside.get(name)
            if there is not None and there.fusion.aligned and turns_into(there.fusion.config, others):
                there.fusion.turn_into(others)
            else:
                self._beside[name] = self._beside_with(others, SETTLING)
        self._begin_blending(published)
        self._note_handover(self._now, *_difference(published, self.odometry))

    def _from(self, other: FusionFilter) -> tuple[float, float]:
        """Difference of the estimates of `other` and this filter: horizontal position m, yaw rad."""
        other.datum = self.datum
        self.update_odometry()
        other.update_odometry()
        return _difference(self.odometry, other.odometry)

    def _drop(self, name: str, one: ParallelFilter, now: int) -> None:
        """Let `one`, which is without the finding `name`, take over at once. From now on only the diagnosis watches
        other findings."""
        without = self._without.get(name)
        position, yaw = self._from(one.fusion)
        self._dropped.append(Dropped(name, one.since, now))
        pending, self._next = self._next is not None, None
        self._take_over(one.fusion, now, position, yaw)
        self._beside, self._branches, self._without = {}, {}, {}
        if pending:
            self.change(without)

    def _take_over(self, other: WatchedFilter, now: int, position: float, yaw: float) -> None:
        """Become `other`. The present filter continues in parallel if it is the filter without one of the findings."""
        published = None
        if self.aligned:  # else the covariance holds any heading anyway
            self.update_odometry()
            published = self.odometry.copy()
        before = WatchedFilter(self.config)
        before.__dict__.update({name: vars(self)[name] for name in vars(before) if name not in _STAYS})
        filters = (before, *(one.fusion for one in self._beside.values()))
        self._next = None
        self.__dict__.update({name: value for name, value in vars(other).items() if name not in _STAYS})
        self._blending, self._beside, self._branches = None, {}, {}
        before._withheld.stop()
        if self._memory is not None:
            self._follow_withheld()
        if published is not None:
            self._begin_blending(published)
        for name, values in self._without.items():
            there = next((fusion for fusion in filters if fusion.config.parameters == values), None)
            self._beside[name] = self._beside_with(values) if there is None else ParallelFilter(
                there, now, self._fixes)
        self._note_handover(now, position, yaw)

    def _begin_blending(self, published: np.ndarray) -> None:
        """Let the published estimate go from the odometry `published` (SIZE,) to that of the filter."""
        self._blending = None
        stamp = self.update_odometry()
        self._blending = blending(stamp, published, self.odometry)

    def _note_handover(self, now: int, position: float, yaw: float) -> None:
        self.handovers.append(Handover(now, position, yaw))
        self.say('info', self.handovers[-1].text)


def _difference(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Difference of two odometries (SIZE,): horizontal position m, yaw rad."""
    yaw = yaw_of_quaternion(*b[ORIENTATION:POSE_COVARIANCE]) - yaw_of_quaternion(*a[ORIENTATION:POSE_COVARIANCE])
    return math.hypot(*(b - a)[POSITION:POSITION + 2]), float(wrap(yaw))


def _as_sure(present: np.ndarray, other: np.ndarray, times: float) -> bool:
    """Whether the standard deviations of position and heading of the odometry `other` (SIZE,) are at most `times` those
    of `present`."""
    a, b = (odometry[POSE_COVARIANCE:LINEAR].reshape(6, 6) for odometry in (present, other))
    return bool(b[0, 0] + b[1, 1] <= times**2 * (a[0, 0] + a[1, 1]) and b[5, 5] <= times**2 * a[5, 5])
