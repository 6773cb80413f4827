"""Replay: run the filter over a whole recording, with simulated outages.

The same inputs in the order of their arrival give the same results as live, bit for bit. Up to the first measurement
that is withheld, a run with an outage equals the ordinary run. So the filter is copied at that point, and the copy
continues without the withheld measurements: each outage is the only one in its run, and takes only the time of its own
duration.
"""
from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...samples import Aiding, Fixes, ImuSamples
from .. import kernel
from ..advance import TAKEN
from ..bank import copied
from ..config import FilterConfig
from ..memory import Event, Head, Kind, Nav, Sample, Verdict, newest_row
from ..start.alignment import Alignment
from ..start.initial import initialize
from ..start.start import SavedState, Start, remeasured
from ..trust.imu_faults import FAULTS, Imu
from .horizon import HorizonPredictor
from .intake import GOOD, JUMPED, Intake, remove_effects
from .results import MeasurementLog, Run, columns, result
from .snapshot import saved_at_jump
from .vehicle_check import found_time_offsets, vehicle_warnings
from .withheld import Withheld

_NOTHING = np.empty((0, Event.SIZE))  # no measurements


@dataclass(frozen=True)
class Coasting:
    """Outages of one filter.

    begin (o,): ns, IMU's clock; fixes later than this are withheld. duration (o,): s, for how long. first (o + 1,):
    outage i has the rows first[i] to first[i + 1] of `run`, from the last sample kept at or before its begin. announced
    (o,): the trust horizon at the begin, s (`horizon.py`); NaN where it was not asked for.
    """

    begin: np.ndarray
    duration: np.ndarray
    first: np.ndarray
    run: Run
    announced: np.ndarray


def run(config: FilterConfig, imu: ImuSamples, fixes: Fixes, aiding: Aiding = Aiding(), start: Start | None = None,
        keep: np.ndarray | None = None) -> Run:
    """Replay the whole recording.

    start: used instead of the alignment at the beginning. keep: whether to keep the state after each sample of `imu`,
    (n,) bool; None: all.
    """
    return Replay(config, imu, fixes, aiding, start, keep).run()


@dataclass(frozen=True)
class Constrained:
    """Innovations of the vehicle's constraints in the order of time: index (c,) of the IMU sample, kind (c,) of `Kind`,
    innovation z (c, 3) and its variances s (c, 3), m/s: north, east and down at standstill, else right and down in the
    vehicle's axes."""

    index: np.ndarray
    kind: np.ndarray
    z: np.ndarray
    s: np.ndarray


def run_with_constraints(config: FilterConfig, imu: ImuSamples, fixes: Fixes, aiding: Aiding = Aiding(),
                         start: Start | None = None, keep: np.ndarray | None = None) -> tuple[Run, Constrained]:
    """`run`, and the innovations of the vehicle constraints."""
    work = Replay(config, imu, fixes, aiding, start, keep)
    work.constrained = [(np.empty(0, dtype=np.int64), np.empty((0, Sample.SIZE)))]
    found = work.run()
    index, samples = (np.concatenate(parts) for parts in zip(*work.constrained))
    return found, Constrained(index, samples[:, Sample.CONSTRAINT].astype(np.int64), samples[:, Sample.Z:Sample.Z + 3],
                              samples[:, Sample.S:Sample.S + 3])


def run_with_outages(config: FilterConfig, imu: ImuSamples, fixes: Fixes, begin: np.ndarray,
                     duration: float | np.ndarray, aiding: Aiding = Aiding(), keep: np.ndarray | None = None,
                     start: Start | None = None, announces: bool = True) -> tuple[Run, Coasting]:
    """The ordinary run, and the runs in which all measurements from satellites after each `begin` are withheld.

    begin: (o,) ns, ascending. duration: s, length of all outages or of each (o,), which may end with the recording.
    keep, start: as for `run`. announces: whether the trust horizon is asked for: what copies without fixes have shown
    until then is part of it (withheld.py). Outages that begin while the filter is not running are left out.
    """
    work = Replay(config, imu, fixes, aiding, start, keep, np.asarray(begin, dtype=np.int64), duration)
    work.announces = announces
    return work.run(), work.coasting()


@dataclass(frozen=True)
class Stretch:
    """Kept states of the run between two restarts, or of one outage: indices of their samples, and the states. Of an
    outage: its begin, ns, its duration, s, and the trust horizon at the begin, s."""

    samples: np.ndarray
    states: np.ndarray
    begin: int = 0
    duration: float = 0.0
    announced: float = np.nan


class Replay(Intake):
    """A replay: stretches between restarts of the filter, aligned and run one by one.

    Subclasses (smoothing.py, live_output.py) override steps of it: `_memory` (memory of a new filter), `_events`
    (measurements of a stretch), `_alignment` and `_align` (its start), `_filter` (all that follows).
    """

    def __init__(self, config: FilterConfig, imu: ImuSamples, fixes: Fixes, aiding: Aiding, given: Start | None,
                 keep: np.ndarray | None, begin: Sequence[int] = (),
                 duration: float | np.ndarray = 0.0):
        super().__init__(config)
        self.imu, self.given = imu, given
        self.keep = np.ones(len(imu), dtype=bool) if keep is None else keep
        self.begin, self.duration = begin, duration
        self.inputs = {Kind.POSITION: fixes}
        for kind, measurement in config.inputs.items():
            samples = aiding.get(measurement.name)
            if samples is not None and self.topic(kind):
                self.inputs[kind] = samples
            elif samples is not None:
                self.say('warning', f'{measurement.topic} is empty: {measurement.name} not used')
        # a measurement that arrived at the same time as a sample is processed after the sample
        self.arrival = {kind: np.searchsorted(imu.received, samples.received, side='right')
                        for kind, samples in self.inputs.items()}
        self.columns = columns(config.layout)
        self.stretches: list[Stretch] = []
        self.branches: list[Stretch] = []
        self.measurements: list[MeasurementLog] = []
        self.constrained: list[tuple[np.ndarray, np.ndarray]] | None = None  # samples with a constraint, if asked for
        self.start: Start | None = None
        self.memory: np.ndarray | None = None
        self.seconds = 0.0
        self.announces = False  # whether the trust horizon is asked for at the begin of each outage
        self._began = 0.0  # s, of the newest sample when the filter began

    def run(self) -> Run:
        segments = self._segments()
        self.saved: SavedState | None = None  # state at the end of the previous stretch
        ends = [kept[0] for kept in segments[1:]] + [np.iinfo(np.int64).max]
        correctors = self.config.correctors()
        for kept, end in zip(segments, ends):
            self._run_segment(kept, end, correctors)
        self._sum_up()
        return self.result(self.stretches)

    def _segments(self) -> list[np.ndarray]:
        """Indices of the valid samples, one array for each stretch between restarts."""
        codes = self.follow(self.imu.stamp, np.hstack([self.imu.specific_force, self.imu.angular_rate]))
        good = np.flatnonzero((codes == GOOD) | (codes == JUMPED))
        return [part for part in np.split(good, np.flatnonzero(codes[good] == JUMPED)) if len(part)]

    def _run_segment(self, kept: np.ndarray, end: int, correctors: list) -> None:
        """Align on the samples `kept` and run the rest; `end`: index of the first sample of the next stretch."""
        saved, self.saved = self.saved, None
        epoch = int(self.imu.stamp[kept[0]])
        time = (self.imu.stamp[kept] - epoch) * 1e-9
        # filled in place: hours of samples are hundreds of megabytes
        samples = np.empty((len(kept), 7 if self.imu.difference is None else 13))
        samples[:, 0] = time
        samples[:, 1:4], samples[:, 4:7] = self.imu.specific_force[kept], self.imu.angular_rate[kept]
        if correctors:
            celsius = np.full(len(kept), np.nan) if self.imu.temperature is None else self.imu.temperature[kept]
            samples[:, 1:7] = remove_effects(correctors, self.imu.stamp[kept], samples[:, 1:7].copy(), celsius)
        if self.imu.difference is not None:
            samples[:, 7:] = self.imu.difference[kept]
        events = self._events(kept, end, epoch)
        start, first = self._align(kept, samples, events, saved)
        if start is None:
            return
        self.start = self.start or start
        memory = self._memory()
        initialize(memory, self.config, start)
        skip = int(np.searchsorted(time, start.time, side='right'))
        self._began = max(start.time, float(time[events.arrival[first - 1] - 1])) if first else start.time
        events = events.later(first, skip)
        began = clock.thread_time()
        self._filter(memory, samples[skip:], kept[skip:], events, epoch)
        self.seconds += clock.thread_time() - began
        self.memory = memory
        if end < len(self.imu):
            self.saved = saved_at_jump(self.config, memory, int(self.imu.stamp[kept[-1]]), int(self.imu.stamp[end]))
        for i in np.flatnonzero(events.answer != TAKEN):
            last = max(events.arrival[i] + skip - 1, 0)
            self.say_not_taken(int(events.kind[i]), int(events.answer[i]),
                               epoch + round(events.event[i, Event.TIME] * 1e9), int(self.imu.stamp[kept[last]]))
        judged = events.event[:, Event.VERDICT] != Verdict.PENDING
        stamp = epoch + np.rint(events.event[:, Event.TIME] * 1e9).astype(np.int64)
        self.measurements.append(MeasurementLog(events.kind, events.index, stamp, events.event).select(judged))

    def _memory(self) -> np.ndarray:
        return self.config.memory()

    def _events(self, kept: np.ndarray, end: int, epoch: int) -> Events:
        """The valid measurements that arrived within a stretch, in the order of arrival."""
        parts = []
        for kind in self.arrival:
            arrival = self.arrival[kind]
            self._last[kind] = -1
            mine = np.flatnonzero((arrival > kept[0]) & (arrival <= end))
            before = np.searchsorted(kept, arrival[mine])  # number of samples of this stretch before each
            with np.errstate(over='ignore', invalid='ignore'):  # what no sensor measures is refused by its event
                used, events = self.measured(kind, self.inputs[kind].select(mine), self.imu.stamp[kept[before - 1]],
                                             epoch)
            parts.append((np.full(len(used), kind), mine[used], before[used], self.inputs[kind].received[mine[used]],
                          events))
        kind, index, arrival, received, event = (np.concatenate(column) for column in zip(*parts))
        order = np.lexsort((received, arrival))
        event = np.ascontiguousarray(event[order])
        return Events(kind[order], index[order], arrival[order].astype(np.int64), event,
                       np.zeros(len(order), dtype=np.int64))

    def _align(self, kept, samples, events: Events, saved: SavedState | None) -> tuple[Start | None, int]:
        """The start (None: the filter does not start), and the number of events up to it. saved: state of the previous
        stretch."""
        fixes = np.flatnonzero(events.kind == Kind.POSITION)
        if self.given is not None and self.start is None:
            start = remeasured(self.given, self.config, samples)
            first = int(np.searchsorted(events.event[fixes, Event.TIME], start.time + 1e-6, side='right'))
            return start, int(fixes[first]) if first < len(fixes) else len(events.kind)
        alignment, fed, found, after = self._alignment(), 0, None, len(events.kind)
        if saved is not None:
            alignment.use_saved(saved)
        for i in np.flatnonzero((events.kind == Kind.POSITION)
                                | np.isin(events.event[:, Event.KIND], (Kind.MAGNETIC, Kind.PLACE))):
            if events.kind[i] != Kind.POSITION:
                alignment.add_input(events.event[i])
                continue
            upto = events.arrival[i]
            orientation = None if self.imu.orientation is None else self.imu.orientation[kept[fed:upto]]
            alignment.add_samples(samples[fed:upto], orientation)
            fed = upto
            if found is None:
                found, after = alignment.add_event(events.event[i], self.say), i + 1
            elif alignment.takes_back_the_start(events.event[i], self.say):
                found = None
            if found is not None and not alignment.is_watching:
                return found, after
        if found is not None:
            return found, after
        missing = alignment.waiting_for if len(fixes) else f'a usable fix on {self.config.gnss.topic}'
        self.say('error', f'the filter did not start: waiting for {missing}')
        return None, len(events.kind)

    def _alignment(self) -> Alignment:
        return Alignment(self.config)

    def _filter(self, memory, samples, index, events: Events, epoch: int) -> None:
        """Pass samples (k, 7) with their indices, and events, to the kernel; run outages in copies of the filter."""
        kept = np.flatnonzero(self.keep[index])
        states = np.empty((len(kept), len(self.columns)))
        time = samples[:, 0]
        outages = [(b, d) for b, d in zip(self.begin, np.broadcast_to(self.duration, len(self.begin)).tolist())
                   if len(kept) and time[kept[0]] <= (b - epoch) * 1e-9 <= time[-1]]
        withheld = self._are_withheld(events)
        forks = []
        for b, _ in outages:
            later = withheld & (events.event[:, Event.TIME] > (b - epoch) * 1e-9)
            forks.append(int(events.arrival[later].min()) if later.any() else len(samples))
        events.event[:, Event.ID] = np.arange(len(events.kind))
        work = Playback(samples, events, self.columns, kept, states)
        branches, horizon, spare = {}, HorizonPredictor(self.config), np.zeros(len(memory))
        copies = Copies(self.config, work, self._began) if self.announces and outages else None
        for i in np.argsort(forks, kind='stable'):
            (work if copies is None else copies).advance(memory, forks[i])
            begin, duration = outages[i]
            since = (begin - epoch) * 1e-9
            branches[int(i)] = (*self._branch(memory, work, since, since + duration, withheld, spare),
                                np.nan if copies is None else _announced(horizon, memory, since, copies.realised))
        if self.constrained is not None:
            self._keep_constraints(memory, work, index)
        work.advance(memory, len(samples))
        work.finish(memory)
        for i, (begin, duration) in enumerate(outages):
            rows, coasted, announced = branches[i]
            self.branches.append(Stretch(index[kept[rows]], coasted, begin, duration, announced))
        self.stretches.append(Stretch(index[kept], states))

    def _are_withheld(self, events: Events) -> np.ndarray:
        """Which of the events an outage withholds."""
        return self.config.from_satellites[events.event[:, Event.INPUT].astype(int)] != 0.0

    def _keep_constraints(self, memory, work: Playback, index) -> None:
        """Run to the last sample and keep those at which a constraint was applied, before the memory drops them."""
        capacity, first = self.config.capacity, int(memory[Head.SAMPLES]) + 1
        samples = memory[int(memory[Head.RING_AT]):][:capacity * Sample.SIZE].reshape(capacity, Sample.SIZE)
        for begin in range(0, len(work.samples), capacity // 2):
            end = min(begin + capacity // 2, len(work.samples))
            work.advance(memory, end)
            rows = samples[(first + np.arange(begin, end)) % capacity]
            applied = rows[:, Sample.CONSTRAINT] != 0.0
            self.constrained.append((index[begin:end][applied], rows[applied]))

    def _branch(self, memory, work: Playback, begin: float, end: float, withheld, spare) -> tuple[slice, np.ndarray]:
        """Run one outage from the present position of `work`; begin, end: s. spare: room for a copy of the filter.

        Returns which of the kept states the outage covers, and these states, with one before its begin and one after
        its end, so that states in between can be interpolated.
        """
        time = work.samples[work.kept, 0]
        first = int(np.searchsorted(time, begin, side='right')) - 1
        stop = min(int(np.searchsorted(time, end)) + 1, len(time))
        coasted = np.empty((stop - first, len(self.columns)))
        done = min(max(work.next_row - first, 0), len(coasted))
        coasted[:done] = work.states[first:first + done]
        if done < len(coasted):
            left = work.events.select(~(withheld & (work.events.event[:, Event.TIME] > begin)))
            branch = Playback(work.samples, left, self.columns, work.kept, np.empty_like(work.states[:0]), work)
            branch.into(coasted[done:], first + done)
            branch.advance(copied(memory, spare), int(work.kept[stop - 1]) + 1)
        return slice(first, stop), coasted

    def _sum_up(self) -> None:
        """Add one message for each reason for which measurements were refused, and the messages on IMU and vehicle."""
        measured = self.measured_all
        for kind in self.arrival:
            counts = measured.verdicts(kind)
            total = sum(counts.values())
            for verdict, why in ((Verdict.REFUSED, 'refused: they do not fit what the filter expects'),
                                 (Verdict.FROZEN, 'refused: they repeat themselves while the vehicle moves'),
                                 (Verdict.EXTRAPOLATED, 'refused: the receiver extrapolates a straight line, as '
                                                        'without satellites'),
                                 (Verdict.CONTRADICTED, 'refused: their integral differs from the displacement between '
                                                        'fixes (a wrong unit, sign or axes, or a dead sensor)'),
                                 (Verdict.AHEAD, 'refused: stamped ahead of the IMU, the clocks differ '
                                                 '(gnss.time_offset)'),
                                 (Verdict.RECOVERED, 'restarted the filter: those refused before agree with it')):
                if counts.get(verdict):
                    self.say('warning', f'{self.topic(kind)}: {counts[verdict]} of {total} messages {why}')
        if self.memory is None:
            return
        fixes = measured.event[measured.kind == Kind.POSITION]
        for text in (*_imu_warnings(self.memory, self.config.imu.topic),
                     *vehicle_warnings(self.memory, self.config, fixes)):
            self.say('warning', text)
        for kind, text in found_time_offsets(self.memory, self.config).items():
            self.say('warning', f'{self.topic(kind)}: {text}')

    @property
    def measured_all(self) -> MeasurementLog:
        if not self.measurements:
            return MeasurementLog(*np.empty((3, 0), dtype=np.int64), _NOTHING)
        names = ('kind', 'index', 'stamp', 'event')
        return MeasurementLog(*(np.concatenate([getattr(m, name) for m in self.measurements]) for name in names))

    def coasting(self) -> Coasting:
        """The outages, after `run`."""
        first = np.concatenate([[0], np.cumsum([len(branch.samples) for branch in self.branches])]).astype(np.int64)
        return Coasting(np.array([branch.begin for branch in self.branches], dtype=np.int64),
                        np.array([branch.duration for branch in self.branches]), first,
                        self.result(self.branches), np.array([branch.announced for branch in self.branches]))

    def result(self, stretches: list[Stretch]) -> Run:
        states = [s.states for s in stretches] or [np.empty((0, len(self.columns)))]
        states = states[0] if len(states) == 1 else np.concatenate(states)
        index = np.concatenate([s.samples for s in stretches]) if stretches else np.empty(0, dtype=np.int64)
        return result(self.config, self.imu.stamp[index], index, states, self.measured_all, start=self.start,
                      notices=self.notices(), memory=self.memory, filter_seconds=self.seconds)


@dataclass(frozen=True)
class Events:
    """Measurements in the order of arrival: kind (number of the input), index among the samples of the input, arrival
    (number of IMU samples before it), event, and the kernel's answer."""

    kind: np.ndarray
    index: np.ndarray
    arrival: np.ndarray
    event: np.ndarray
    answer: np.ndarray

    def select(self, index) -> Events:
        return Events(self.kind[index], self.index[index], self.arrival[index], self.event[index],
                       self.answer[index])

    def later(self, first: int, skip: int) -> Events:
        """The measurements from number `first` on, for a run without the first `skip` IMU samples."""
        events = self.select(slice(first, None))
        return Events(events.kind, events.index, np.maximum(events.arrival - skip, 0), events.event, events.answer)


class Playback:
    """Position of the kernel in a recording. after: the run of which this is a copy."""

    def __init__(self, samples, events: Events, names: np.ndarray, kept, states, after: Playback | None = None):
        self.samples, self.events, self.columns, self.kept, self.states = samples, events, names, kept, states
        self.sample = after.sample if after else 0
        self.next_row = 0
        self.first_row = 0
        # a copy does not write to the log of the original run
        self.log = _NOTHING if after else events.event
        self.next_event = 0
        if after:
            done = after.events.event[:after.next_event, Event.ID]
            self.next_event = int(np.count_nonzero(np.isin(events.event[:, Event.ID], done)))

    def into(self, states, row: int) -> None:
        """Write the states from kept sample number `row` on to `states`."""
        self.states, self.first_row, self.next_row = states, row, row

    def advance(self, memory, stop: int) -> None:
        """Process the samples before number `stop`, and the events that arrived before this sample."""
        kept = self.kept[self.next_row:np.searchsorted(self.kept, stop)]
        upto = int(np.searchsorted(self.events.arrival, stop))
        rows = slice(self.next_row - self.first_row, self.next_row - self.first_row + len(kept))
        part = slice(self.next_event, upto)
        kernel.run(memory, self.samples[self.sample:stop], self.events.event[part].copy(),
                   self.events.arrival[part] - self.sample, self.events.answer[part], self.columns,
                   kept - self.sample, self.states[rows], self.log)
        self.next_row += len(kept)
        self.next_event, self.sample = upto, stop

    def finish(self, memory) -> None:
        """Process the rest, with the events that arrived after the last sample."""
        self.advance(memory, len(self.samples))
        part = slice(self.next_event, len(self.events.kind))
        kernel.run(memory, self.samples[:0], self.events.event[part].copy(), self.events.arrival[part] * 0,
                   self.events.answer[part], self.columns, self.kept[:0], self.states[:0], self.log)
        kernel.collect(memory, self.log)


class Copies:
    """Copies without fixes of a filter in a replay (withheld.py), as a live filter has them. work: the playback of the
    filter. began: s, of the newest sample at its begin."""

    def __init__(self, config: FilterConfig, work: Playback, began: float):
        self._copies, self._work = Withheld(config), work
        self._copies.begin(began)

    @property
    def realised(self) -> float:
        """As of `Withheld`."""
        return self._copies.realised

    def advance(self, memory, stop: int) -> None:
        """As of `Playback`, for filter and copies."""
        time = self._work.samples[:, 0]
        while (due := int(np.searchsorted(time, self._copies.due))) < stop:
            self._work.advance(memory, due)
            self._copies.before(float(time[due]), memory)
        self._work.advance(memory, stop)


def _announced(horizon: HorizonPredictor, memory: np.ndarray, begin: float, realised: float) -> float:
    """The trust horizon of a filter with this memory, s after `begin`; 0 where the heading is unknown. realised: as of
    `Withheld`."""
    seconds = horizon.predict(memory, realised=realised).seconds
    return float(newest_row(memory)[Nav.TIME]) - begin + seconds if seconds > 0.0 else 0.0


def _imu_warnings(memory: np.ndarray, topic: str) -> list[str]:
    """Messages on rejected IMU samples, and on states that were not finite."""
    texts = [f'{topic}: {memory[Imu.FAULTS + i]:.0f} samples rejected: {name}'
             for i, name in enumerate(FAULTS) if i and memory[Imu.FAULTS + i]]
    restarts = newest_row(memory)[Nav.RESTARTS]
    if restarts:
        texts.append(f'{restarts:.0f} states were not finite: the filter went back to the last good one')
    return texts

