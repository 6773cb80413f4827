"""When what the diagnosis while driving has proven counts, and a recording driven so, as a live node drives."""
from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from ..filter.config import FilterConfig
from ..filter.runs.changing import ChangingFilter, Handover
from ..filter.runs.odometry import SIZE
from ..samples import Recording
from .gathering import Slots

#: chunks after its own with whose end the answer to a chunk counts: what an analysis takes at the default share.
#: Counted in chunks, not by the clock, so that a replay does the same at the same sample
WAIT = 1


class Due:
    """Which answer counts. sets: parameters that the filter has now, beside those that it was given.

    One thread calls `answered`, another one the rest.
    """

    def __init__(self, sets: dict):
        self._sets, self._answers, self._handed = sets, [], 0
        self._asked: dict | None = None
        #: answers that should be there and are not
        self.late = 0

    def handed(self) -> None:
        """A chunk has been given to the diagnosis."""
        self._handed += 1

    def answered(self, sets: dict, is_chunk: bool = True) -> None:
        """The diagnosis has answered the next chunk, or what a user asked: that counts at once."""
        if is_chunk:
            self._answers.append(sets)
        else:
            self._answers[:] = [sets] * len(self._answers)
            self._asked = sets

    def asked(self) -> dict | None:
        """The parameters that a user has asked for, where others than before."""
        if self._asked is None:
            return None
        sets, self._asked = self._asked, None
        return self._new(sets)

    def at_end_of_chunk(self) -> dict | None:
        """The parameters from the first sample behind a chunk on, where others than before; before `handed`."""
        due = self._handed + 1 - WAIT
        there = min(due, len(self._answers))
        self.late = max(due - there, 0)
        return self._new(self._answers[there - 1]) if there > 0 else None

    def _new(self, sets: dict) -> dict | None:
        if sets == self._sets:
            return None
        self._sets = sets
        return sets


@dataclass(frozen=True)
class Driven:
    """What a live node would have published: stamps (k,) ns and `odometry` (k, 85), and where filters have taken
    over."""

    stamp: np.ndarray
    odometry: np.ndarray
    handovers: list[Handover]


def driven(recording: Recording, values: dict, sets: list[dict], datum=None, every: int = 1,
           progress: Callable[[float], None] = lambda part: None) -> Driven:
    """`recording` through a live filter with the checked parameters `values`, sample by sample, that goes on with
    `sets` of each chunk as a node does. every: samples from one odometry kept to the next."""
    fusion, slots, due, answers = ChangingFilter(FilterConfig.from_parameters(values)), Slots(), Due({}), iter(sets)
    fusion.datum = fusion.datum if datum is None else np.array(datum, dtype=float)
    imu, events = recording.imu, _events(recording)
    force, rate = imu.specific_force.tolist(), imu.angular_rate.tolist()
    celsius = imu.temperature
    orientation = imu.orientation if values['alignment.heading'] == 'orientation' else None
    stamps, rows, event = [], [], next(events, None)
    for i, stamp in enumerate(imu.stamp.tolist()):
        if math.isfinite(sum(force[i]) + sum(rate[i])) and slots.ends_before(stamp):
            new = due.at_end_of_chunk()
            if new is not None:
                fusion.change({**values, **new})
            due.handed()
            due.answered(next(answers))
            progress(i / len(imu))
        if celsius is not None:
            fusion.add_temperature(stamp, float(celsius[i]))
        told = () if orientation is None else orientation[i].tolist()
        if fusion.add_imu(stamp, *force[i], *rate[i], *told) and i % every == 0:
            fusion.update_odometry()
            stamps.append(stamp)
            rows.append(fusion.odometry.copy())
        while event is not None and event[0] == i + 1:
            event[1](fusion)
            event = next(events, None)
        if i % 1000 == 0:
            fusion.notices(), fusion.verdicts()
    return Driven(np.array(stamps, dtype=np.int64), np.array(rows).reshape(-1, SIZE), fusion.handovers)


def _events(recording: Recording):
    """Measurements in the order of their arrival: how many samples came before each, and what to call with a filter."""
    streams = {name: samples for name, samples in recording.streams().items() if name not in ('imu', 'reference')}
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
