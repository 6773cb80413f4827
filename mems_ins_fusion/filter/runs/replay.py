"""A whole recording through the filter, with the outages it would have coasted through branched off on the way.

The same events in the order of their arrival give the same numbers as live, bit for bit. Until the first measurement
that is withheld, an outage's run is the ordinary run. So the filter is copied there and the copy goes on without: each
outage is the only one in its run, however many there are and however close they lie, and costs its own duration.
"""
from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...samples import Aiding, Fixes, ImuSamples
from .. import kernel
from ..advance import TAKEN
from ..config import FilterConfig
from ..memory import Event, Head, Kind, Nav, Sample, Verdict, state_at
from ..start.alignment import Alignment, Remembered
from ..start.initial import initialize
from ..start.start import Start, retaken
from ..trust.imu_faults import FAULTS, Imu
from .horizon import Lookout
from .intake import GOOD, JUMPED, Intake, corrected
from .results import Measured, Run, columns, result
from .snapshot import after_jump
from .vehicle_check import vehicle_says

_NOTHING = np.empty((0, Event.SIZE))


@dataclass(frozen=True)
class Coasting:
    """Outages of one filter.

    begin (o,): ns, the IMU's clock: fixes later than this are withheld. first (o + 1,): outage i has the rows first[i]
    to first[i + 1] of `run`, from the last sample kept at or before its begin. announced (o,): s from the begin, for
    which the filter then said that its error stays below `horizon.limit` (`horizon.py`).
    """

    begin: np.ndarray
    first: np.ndarray
    run: Run
    announced: np.ndarray


def run(config: FilterConfig, imu: ImuSamples, fixes: Fixes, aiding: Aiding = Aiding(), start: Start | None = None,
        keep: np.ndarray | None = None) -> Run:
    """The whole recording.

    start: begin there instead of aligning, where the recording has no restart. keep: whether to keep the state after
    each sample of `imu`, (n,) bool; all where None.
    """
    return Replay(config, imu, fixes, aiding, start, keep).run()


@dataclass(frozen=True)
class Constrained:
    """What the vehicle's constraints said, in the order of time: index (c,) of the IMU sample, kind (c,) of `Kind`,
    innovation z (c, 3) and its variances s (c, 3), m/s: north, east and down at standstill, else to the right and
    down of the vehicle."""

    index: np.ndarray
    kind: np.ndarray
    z: np.ndarray
    s: np.ndarray


def run_with_constraints(config: FilterConfig, imu: ImuSamples, fixes: Fixes, aiding: Aiding = Aiding(),
                         start: Start | None = None, keep: np.ndarray | None = None) -> tuple[Run, Constrained]:
    """The same as `run`, and what the constraints said in it."""
    work = Replay(config, imu, fixes, aiding, start, keep)
    work.said = []
    found = work.run()
    columns = [np.concatenate(c) for c in zip(*work.said)] if work.said else [np.empty(0, dtype=np.int64),
                                                                                np.empty((0, Sample.SIZE))]
    index, samples = columns
    return found, Constrained(index, samples[:, Sample.CONSTRAINT].astype(np.int64), samples[:, Sample.Z:Sample.Z + 3],
                              samples[:, Sample.S:Sample.S + 3])


def run_with_outages(config: FilterConfig, imu: ImuSamples, fixes: Fixes, begin: np.ndarray, duration: float,
                     aiding: Aiding = Aiding(), keep: np.ndarray | None = None,
                     start: Start | None = None) -> tuple[Run, Coasting]:
    """The ordinary run, and the runs in which what comes from satellites after each `begin` is withheld.

    begin: (o,) ns, ascending. duration: s that each outage is followed for, or to the end of the recording. keep,
    start: as for `run`. An outage is left out where the filter was not running at its begin.
    """
    work = Replay(config, imu, fixes, aiding, start, keep, np.asarray(begin, dtype=np.int64), duration)
    whole = work.run()
    lengths = [len(branch.samples) for branch in work.branches]
    first = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return whole, Coasting(np.array([branch.begin for branch in work.branches], dtype=np.int64), first,
                           work.result(work.branches), np.array([branch.announced for branch in work.branches]))


@dataclass(frozen=True)
class Stretch:
    """Between two restarts, or one outage: the samples (indices) whose states are kept, and these. Of an outage: its
    begin, ns, and for how long it was then announced to be endured, s."""

    samples: np.ndarray
    states: np.ndarray
    begin: int = 0
    announced: float = np.nan


class Replay(Intake):
    """A recording on its way through the filter: stretches between restarts, aligned and run one by one.

    Who wants something else of a replay (`smoothing`, `publish`) overrides a step of it: `_memory` (the filter's, new),
    `_events` (what was measured in a stretch), `_alignment` and `_align` (its start), `_filter` (the rest of it).
    """

    def __init__(self, config: FilterConfig, imu: ImuSamples, fixes: Fixes, aiding: Aiding, given: Start | None,
                 keep: np.ndarray | None, begin: Sequence[int] = (), duration: float = 0.0):
        super().__init__(config)
        self.imu, self.given = imu, given
        self.keep = np.ones(len(imu), dtype=bool) if keep is None else keep
        self.begin, self.duration = begin, duration
        self.inputs = {kind: fixes if kind == Kind.POSITION else aiding.get(measurement.name)
                       for kind, measurement in config.inputs.items()}
        #: numbers of what comes from satellites and is withheld in an outage
        self.withheld = [kind for kind, measurement in config.inputs.items() if measurement.from_satellites]
        # what arrived together with a sample comes after it
        self.arrival = {kind: np.searchsorted(imu.received, samples.received, side='right')
                        for kind, samples in self.inputs.items() if samples is not None}
        self.columns = columns(config.layout)
        self.stretches: list[Stretch] = []
        self.branches: list[Stretch] = []
        self.measurements: list[Measured] = []
        self.said: list[tuple[np.ndarray, np.ndarray]] | None = None
        self.start: Start | None = None
        self.memory: np.ndarray | None = None
        self.seconds = 0.0

    def run(self) -> Run:
        segments = self._segments()
        self.kept: Remembered | None = None  # of the stretch before
        ends = [kept[0] for kept in segments[1:]] + [np.iinfo(np.int64).max]
        correctors = self.config.correctors()
        for kept, end in zip(segments, ends):
            self._run_segment(kept, end, correctors)
        self._sum_up()
        return self.result(self.stretches)

    def _segments(self) -> list[np.ndarray]:
        """Indices of the good samples, one array for each stretch between restarts."""
        codes = self.follow(self.imu.stamp, np.hstack([self.imu.specific_force, self.imu.angular_rate]))
        good = np.flatnonzero((codes == GOOD) | (codes == JUMPED))
        return [part for part in np.split(good, np.flatnonzero(codes[good] == JUMPED)) if len(part)]

    def _run_segment(self, kept: np.ndarray, end: int, correctors: list) -> None:
        """Align on the samples `kept` and run the rest; `end`: the index of the sample with which the next begins."""
        remembered, self.kept = self.kept, None
        epoch = int(self.imu.stamp[kept[0]])
        time = (self.imu.stamp[kept] - epoch) * 1e-9
        samples = np.empty((len(kept), 7))  # one array, and no copies beside it: hours are hundreds of megabytes
        samples[:, 0] = time
        samples[:, 1:4], samples[:, 4:] = self.imu.specific_force[kept], self.imu.angular_rate[kept]
        if correctors:
            celsius = np.full(len(kept), np.nan) if self.imu.temperature is None else self.imu.temperature[kept]
            samples[:, 1:] = corrected(correctors, self.imu.stamp[kept], samples[:, 1:].copy(), celsius)
        events = self._events(kept, end, epoch)
        start, first = self._align(kept, samples, events, remembered)
        if start is None:
            return
        self.start = self.start or start
        memory = self._memory()
        initialize(memory, self.config, start)
        skip = int(np.searchsorted(time, start.time, side='right'))
        events = events.later(first, skip)
        began = clock.thread_time()
        self._filter(memory, samples[skip:], kept[skip:], events, epoch)
        self.seconds += clock.thread_time() - began
        self.memory = memory
        if end < len(self.imu):
            self.kept = after_jump(self.config, memory, int(self.imu.stamp[kept[-1]]), int(self.imu.stamp[end]))
        for i in np.flatnonzero(events.answer != TAKEN):
            last = max(events.arrival[i] + skip - 1, 0)
            self.say_not_taken(int(events.kind[i]), int(events.answer[i]),
                               epoch + round(events.record[i, Event.TIME] * 1e9), int(self.imu.stamp[kept[last]]))
        judged = events.record[:, Event.VERDICT] != Verdict.PENDING
        stamp = epoch + np.rint(events.record[:, Event.TIME] * 1e9).astype(np.int64)
        self.measurements.append(Measured(events.kind, events.index, stamp, events.record).select(judged))

    def _memory(self) -> np.ndarray:
        return self.config.memory()

    def _events(self, kept: np.ndarray, end: int, epoch: int) -> Events:
        """The good measurements that arrived within a stretch, in the order of their arrival."""
        parts = []
        for kind in self.arrival:
            arrival = self.arrival[kind]
            self._last[kind] = None
            mine = np.flatnonzero((arrival > kept[0]) & (arrival <= end))
            before = np.searchsorted(kept, arrival[mine])  # samples of this stretch that came before each
            used, records = self.measured(kind, self.inputs[kind].select(mine), self.imu.stamp[kept[before - 1]], epoch)
            parts.append((np.full(len(used), kind), mine[used], before[used], self.inputs[kind].received[mine[used]],
                          records))
        kind, index, arrival, received, record = (np.concatenate(column) for column in zip(*parts))
        order = np.lexsort((received, arrival))
        record = np.ascontiguousarray(record[order])
        return Events(kind[order], index[order], arrival[order].astype(np.int64), record,
                       np.zeros(len(order), dtype=np.int64))

    def _align(self, kept, samples, events: Events, remembered: Remembered | None) -> tuple[Start | None, int]:
        """The start, and how many events went into it or came before it. remembered: of the stretch before."""
        fixes = np.flatnonzero(events.kind == Kind.POSITION)
        if self.given is not None and self.start is None:
            start = retaken(self.given, self.config, samples)
            first = int(np.searchsorted(events.record[fixes, Event.TIME], start.time + 1e-6, side='right'))
            return start, int(fixes[first]) if first < len(fixes) else len(events.kind)
        alignment, fed = self._alignment(), 0
        if remembered is not None:
            alignment.remember(remembered)
        for i in np.flatnonzero((events.kind == Kind.POSITION) | (events.record[:, Event.KIND] == Kind.MAGNETIC)):
            if events.kind[i] != Kind.POSITION:
                alignment.add_field(events.record[i])
                continue
            upto = events.arrival[i]
            orientation = None if self.imu.orientation is None else self.imu.orientation[kept[fed:upto]]
            alignment.add_samples(samples[fed:upto], orientation)
            fed = upto
            start = alignment.add_record(events.record[i], self.say)
            if start is not None:
                return start, i + 1
        missing = alignment.waiting_for if len(fixes) else f'a usable fix on {self.config.gnss.topic}'
        self.say('error', f'the filter did not start: waiting for {missing}')
        return None, len(events.kind)

    def _alignment(self) -> Alignment:
        return Alignment(self.config)

    def _filter(self, memory, samples, index, events: Events, epoch: int) -> None:
        """`samples` (k, 7) of the IMU (`index` of each) and events through the kernel, outages branched off."""
        kept = np.flatnonzero(self.keep[index])
        states = np.empty((len(kept), len(self.columns)))
        time = samples[:, 0]
        begin = [b for b in self.begin if len(kept) and time[kept[0]] <= (b - epoch) * 1e-9 <= time[-1]]
        withheld = np.isin(events.kind, self.withheld)
        forks = []
        for b in begin:
            later = withheld & (events.record[:, Event.TIME] > (b - epoch) * 1e-9)
            forks.append(int(events.arrival[later].min()) if later.any() else len(samples))
        events.record[:, Event.ID] = np.arange(len(events.kind))
        work = Progress(samples, events, self.columns, kept, states)
        branches, lookout = {}, Lookout(self.config)
        for i in np.argsort(forks, kind='stable'):
            work.advance(memory, forks[i])
            since = (begin[i] - epoch) * 1e-9
            branches[int(i)] = *self._branch(memory, work, since, withheld), _announced(lookout, memory, since)
        if self.said is not None:
            self._listen(memory, work, index)
        work.advance(memory, len(samples))
        work.finish(memory)
        for i, b in enumerate(begin):
            rows, coasted, announced = branches[i]
            self.branches.append(Stretch(index[kept[rows]], coasted, b, announced))
        self.stretches.append(Stretch(index[kept], states))

    def _listen(self, memory, work: Progress, index) -> None:
        """Go on to the last sample, and keep what the constraints said: the memory holds it for some samples only."""
        capacity, first = self.config.capacity, int(memory[Head.SAMPLES]) + 1
        samples = memory[int(memory[Head.RING_AT]):][:capacity * Sample.SIZE].reshape(capacity, Sample.SIZE)
        for begin in range(0, len(work.samples), capacity // 2):
            end = min(begin + capacity // 2, len(work.samples))
            work.advance(memory, end)
            rows = samples[(first + np.arange(begin, end)) % capacity]
            spoke = rows[:, Sample.CONSTRAINT] != 0.0
            self.said.append((index[begin:end][spoke], rows[spoke]))

    def _branch(self, memory, work: Progress, begin: float, withheld) -> tuple[slice, np.ndarray]:
        """One outage from where `work` is: which of the kept states it covers, and these.

        One row before the begin and one after the end are there to interpolate between.
        """
        time = work.samples[work.kept, 0]
        first = int(np.searchsorted(time, begin, side='right')) - 1
        stop = min(int(np.searchsorted(time, begin + self.duration)) + 1, len(time))
        coasted = np.empty((stop - first, len(self.columns)))
        done = min(max(work.next_row - first, 0), len(coasted))
        coasted[:done] = work.states[first:first + done]
        if done < len(coasted):
            left = work.events.select(~(withheld & (work.events.record[:, Event.TIME] > begin)))
            branch = Progress(work.samples, left, self.columns, work.kept, np.empty_like(work.states[:0]), work)
            branch.into(coasted[done:], first + done)
            branch.advance(memory.copy(), int(work.kept[stop - 1]) + 1)
        return slice(first, stop), coasted

    def _sum_up(self) -> None:
        """Say what the filter did not believe, once for each reason."""
        measured = self.measured_all
        for kind in self.arrival:
            counts = measured.verdicts(kind)
            total = sum(counts.values())
            for verdict, why in ((Verdict.REFUSED, 'refused: they do not fit what the filter expects'),
                                 (Verdict.FROZEN, 'refused: they repeat themselves while the vehicle moves'),
                                 (Verdict.STRAIGHT_ON, 'refused: the receiver goes straight on as without satellites'),
                                 (Verdict.CONTRADICTED, 'refused: they make up another way than the one between the '
                                                        'fixes (a wrong unit, sign or axes, or a dead sensor)'),
                                 (Verdict.AHEAD, 'refused: stamped ahead of the IMU, the clocks differ '
                                                 '(gnss.time_offset)'),
                                 (Verdict.RECOVERED, 'had the filter start anew: those refused before it agree')):
                if counts.get(verdict):
                    self.say('warning', f'{self.topic(kind)}: {counts[verdict]} of {total} messages {why}')
        if self.memory is None:
            return
        fixes = measured.record[measured.kind == Kind.POSITION]
        for text in (*kernel_says(self.memory, self.config.imu.topic), *vehicle_says(self.memory, self.config, fixes)):
            self.say('warning', text)

    @property
    def measured_all(self) -> Measured:
        if not self.measurements:
            return Measured(*np.empty((3, 0), dtype=np.int64), _NOTHING)
        names = ('kind', 'index', 'stamp', 'record')
        return Measured(*(np.concatenate([getattr(m, name) for m in self.measurements]) for name in names))

    def result(self, stretches: list[Stretch]) -> Run:
        states = [s.states for s in stretches] or [np.empty((0, len(self.columns)))]
        states = states[0] if len(states) == 1 else np.concatenate(states)
        index = np.concatenate([s.samples for s in stretches]) if stretches else np.empty(0, dtype=np.int64)
        return result(self.config, self.imu.stamp[index], index, states, self.measured_all, start=self.start,
                      notices=self.notices(), memory=self.memory, filter_seconds=self.seconds)


@dataclass(frozen=True)
class Events:
    """Measurements in the order of their arrival: kind (number of the input), index among its samples, how many
    of the IMU came before, records as the kernel takes them, and its answers."""

    kind: np.ndarray
    index: np.ndarray
    arrival: np.ndarray
    record: np.ndarray
    answer: np.ndarray

    def select(self, index) -> Events:
        return Events(self.kind[index], self.index[index], self.arrival[index], self.record[index],
                       self.answer[index])

    def later(self, first: int, skip: int) -> Events:
        """Those from `first` on, with `skip` samples less in front."""
        events = self.select(slice(first, None))
        return Events(events.kind, events.index, np.maximum(events.arrival - skip, 0), events.record, events.answer)


class Progress:
    """How far the kernel has come with a recording."""

    def __init__(self, samples, events: Events, names: np.ndarray, kept, states, after: Progress | None = None):
        self.samples, self.events, self.columns, self.kept, self.states = samples, events, names, kept, states
        self.sample = after.sample if after else 0
        self.next_row = 0
        self.first_row = 0
        # a branch leaves the measurements' records to the run it came from
        self.log = _NOTHING if after else events.record
        self.next_event = 0
        if after:
            done = after.events.record[:after.next_event, Event.ID]
            self.next_event = int(np.count_nonzero(np.isin(events.record[:, Event.ID], done)))

    def into(self, states, row: int) -> None:
        """Put the states from kept sample number `row` on into `states`."""
        self.states, self.first_row, self.next_row = states, row, row

    def advance(self, memory, stop: int) -> None:
        """Up to the sample `stop`, which is left, and with the events that arrived before it."""
        kept = self.kept[self.next_row:np.searchsorted(self.kept, stop)]
        upto = int(np.searchsorted(self.events.arrival, stop))
        rows = slice(self.next_row - self.first_row, self.next_row - self.first_row + len(kept))
        part = slice(self.next_event, upto)
        kernel.run(memory, self.samples[self.sample:stop], self.events.record[part].copy(),
                   self.events.arrival[part] - self.sample, self.events.answer[part], self.columns,
                   kept - self.sample, self.states[rows], self.log)
        self.next_row += len(kept)
        self.next_event, self.sample = upto, stop

    def finish(self, memory) -> None:
        """The events that arrived after the last sample."""
        self.advance(memory, len(self.samples))
        part = slice(self.next_event, len(self.events.kind))
        kernel.run(memory, self.samples[:0], self.events.record[part].copy(), self.events.arrival[part] * 0,
                   self.events.answer[part], self.columns, self.kept[:0], self.states[:0], self.log)
        kernel.collect(memory, self.log)


def _announced(lookout: Lookout, memory: np.ndarray, begin: float) -> float:
    """For how long after `begin`, s, a filter with this memory trusts itself without fixes, s; 0 where it does not."""
    seconds = lookout.look(memory).seconds
    now = float(memory[state_at(memory, int(memory[Head.SAMPLES])) + Nav.TIME])
    return now - begin + seconds if seconds > 0.0 else 0.0


def kernel_says(memory: np.ndarray, topic: str) -> list[str]:
    """What the kernel counted of samples it did not believe, in words."""
    texts = [f'{topic}: {memory[Imu.FAULTS + i]:.0f} samples not believed: {name}'
             for i, name in enumerate(FAULTS) if i and memory[Imu.FAULTS + i]]
    restarts = memory[state_at(memory, int(memory[Head.SAMPLES])) + Nav.RESTARTS]
    if restarts:
        texts.append(f'{restarts:.0f} states were not finite: the filter went back to the last good one')
    return texts

