"""When what the diagnosis while driving has proven counts, and a recording driven so, as a live node drives."""
from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from ..effects.registry import effect_called
from ..filter.config import FilterConfig
from ..filter.runs.changing import ChangingFilter, Dropped, Handover
from ..filter.runs.odometry import SIZE
from ..samples import Recording
from .gathering import ChunkEnds
from .quantity import FilterFindings

if TYPE_CHECKING:  # it brings all of `diagnose`, which a node has no use for
    from .watch import RecordingWatch

#: chunks after its own with whose end the answer to a chunk counts. An answer takes 1 to 3 s of a core at 100 Hz, 10 to
#: 30 s at the default share. Counted in chunks, not by the clock, so that a replay does the same at the same sample
WAIT = 1


def with_applied(given: dict, applied: dict[str, dict]) -> tuple[dict, dict[str, dict]]:
    """The parameters `given` with those of the findings `applied`, by name; and so without each of them that the filter
    does not estimate itself: one without any of these meets the fixes as well, whichever is right."""
    def but(left_out: str | None) -> dict:
        return {**given, **{parameter: value for name, sets in applied.items() if name != left_out
                            for parameter, value in sets.items()}}
    return but(None), {name: but(name) for name in applied if effect_called(name).held(given) == given}


def apply_findings(fusion: ChangingFilter, given: dict, findings: FilterFindings, changes: bool) -> None:
    """Have `fusion` go on with `findings` beside the parameters `given`. changes: whether others are applied now."""
    if changes:
        fusion.change(*with_applied(given, findings.applied))
    fusion.doubt(findings.doubted)
    fusion.prepare([with_applied(given, {**findings.applied, name: sets})[0]
                    for name, sets in findings.tried.items()])


class AnswerSchedule:
    """Which answer counts. applied: the findings that the filter has now, parameters by name of each.

    One thread calls `answered`, another one the rest.
    """

    def __init__(self, applied: dict[str, dict]):
        self._now, self._answers, self._handed = FilterFindings(applied, {}), [], 0
        self._asked: FilterFindings | None = None
        self._dropped: list[tuple[int, str]] = []  # chunks handed over before, and name
        #: answers that should be there and are not
        self.late = 0

    def handed(self) -> None:
        """A chunk has been given to the diagnosis."""
        self._handed += 1

    def answered(self, findings: FilterFindings, is_chunk: bool = True) -> None:
        """The diagnosis has answered the next chunk, or what a user asked: that counts at once."""
        if is_chunk:
            self._answers.append(findings)
        else:
            self._answers[:] = [findings] * len(self._answers)
            self._asked = findings

    def dropped(self, name: str) -> None:
        """The filter has dropped this finding. Answers to chunks from before do not know that."""
        self._now = _without({name}, self._now)
        self._dropped.append((self._handed, name))

    def unknown_to(self, answer: int) -> set[str]:
        """Findings that have been dropped after the chunk with this number, from 0."""
        return {name for handed, name in self._dropped if answer < handed}

    def asked(self) -> FilterFindings | None:
        """The findings that a user has asked for, where others than before."""
        if self._asked is None:
            return None
        findings, self._asked = self._asked, None
        return self._new(findings)

    def at_end_of_chunk(self) -> FilterFindings | None:
        """The findings from the first sample behind a chunk on, where others than before; before `handed`."""
        due = self._handed + 1 - WAIT
        there = min(due, len(self._answers))
        self.late = max(due - there, 0)
        if there <= 0:
            return None
        return self._new(_without(self.unknown_to(there - 1), self._answers[there - 1]))

    def _new(self, findings: FilterFindings) -> FilterFindings | None:
        if findings == self._now:
            return None
        self._now = findings
        return findings


def _without(names: set[str], findings: FilterFindings) -> FilterFindings:
    applied, tried = ({name: sets for name, sets in part.items() if name not in names} for part in findings[:2])
    return FilterFindings(applied, tried, findings.doubted - names)


@dataclass(frozen=True)
class LiveOutput:
    """What a live node would have published: stamps (k,) ns and `odometry` (k, 85), where filters have taken over, and
    what was dropped at once."""

    stamp: np.ndarray
    odometry: np.ndarray
    handovers: list[Handover]
    dropped: list[Dropped]


def live_output(recording: Recording, values: dict, watch: RecordingWatch | None = None, datum=None,
                every: int = 1) -> LiveOutput:
    """`recording` through a live filter with the checked parameters `values`, sample by sample, that goes on with what
    `watch` finds in it as a node does; None: as it is. every: samples from one odometry kept to the next."""
    kept = {} if watch is None else watch.wanted.applied
    began, without = with_applied(values, kept)
    fusion, slots, due = ChangingFilter(FilterConfig.from_parameters(began)), ChunkEnds(), AnswerSchedule(kept)
    fusion.watch(without)
    fusion.datum = fusion.datum if datum is None else np.array(datum, dtype=float)
    imu, events = recording.imu, _events(recording)
    force, rate = imu.specific_force.tolist(), imu.angular_rate.tolist()
    celsius = imu.temperature
    orientation = imu.orientation if values['alignment.heading'] == 'orientation' else None
    stamps, rows, event, dropped, untold = [], [], next(events, None), [], []
    for i, stamp in enumerate(imu.stamp.tolist()):
        if watch and math.isfinite(sum(force[i]) + sum(rate[i])) and slots.ends_before(stamp):
            new = due.at_end_of_chunk()
            if new is not None:
                apply_findings(fusion, values, new, new.applied != kept)
                kept = new.applied
            due.handed()
            due.answered(watch.take(untold))
            untold = []
        if celsius is not None:
            fusion.add_temperature(stamp, float(celsius[i]))
        told = () if orientation is None else orientation[i].tolist()
        if fusion.add_imu(stamp, *force[i], *rate[i], *told) and i % every == 0:
            fusion.update_odometry()
            stamps.append(stamp)
            rows.append(fusion.odometry.copy())
        for one in fusion.dropped():
            due.dropped(one.name)
            kept = {name: sets for name, sets in kept.items() if name != one.name}
            dropped.append(one)
            untold.append(one)
        while event is not None and event[0] == i + 1:
            event[1](fusion)
            event = next(events, None)
        if i % 1000 == 0:
            fusion.notices(), fusion.verdicts()
    return LiveOutput(np.array(stamps, dtype=np.int64), np.array(rows).reshape(-1, SIZE), fusion.handovers, dropped)


def _events(recording: Recording):
    """Measurements in the order of their arrival: how many samples came before each, and what to call with a filter."""
    streams = {name: samples for name, samples in recording.streams().items()
               if name not in ('imu', 'reference', 'temperature')}
    order = []
    for name, samples in streams.items():
        arrival = np.searchsorted(recording.imu.received, samples.received, side='right')
        order += [(int(a), int(r), name, i) for i, (a, r) in enumerate(zip(arrival, samples.received))]
    for arrival, _, name, i in sorted(order):
        if arrival:
            numbers = [getattr(streams[name], f.name)[i] for f in fields(streams[name]) if f.name != 'received']
            yield arrival, _added(name, numbers)


def _added(name: str, numbers: list):
    if name == 'gnss':
        return lambda fusion: fusion.add_fix(int(numbers[0]), *numbers[1:])
    return lambda fusion: fusion.add(name, int(numbers[0]), *numbers[1:])
