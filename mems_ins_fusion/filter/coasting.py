"""A recording through the filter, with the outages it would have coasted through branched off on the way.

Until the first fix that is withheld, an outage's run is the ordinary run. So the filter is copied there and the copy
goes on without fixes: each outage is the only one in its run, however many there are and however close they lie, and
costs no more than its own duration.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.compiled import njit

from ..samples import Fixes, ImuSamples
from .config import FilterConfig
from .fusion import Run, _Part, _Replay
from .kernel import collect, take_fix, take_sample
from .layout import Fix, Head, state_at


@dataclass(frozen=True)
class Coasting:
    """Outages of one filter.

    begin (o,): ns, the IMU's clock: fixes later than this are withheld. first (o + 1,): outage i has the rows first[i]
    to first[i + 1] of `run`, from the last sample kept at or before its begin.
    """

    begin: np.ndarray
    first: np.ndarray
    run: Run


def replay(config: FilterConfig, imu: ImuSamples, fixes: Fixes, keep: np.ndarray | None = None) -> Run:
    """As `fusion.run`, but the result holds only the samples marked in `keep` (n,) bool; all where None."""
    return _CoastingReplay(config, imu, fixes, keep).run()


def replay_outages(config: FilterConfig, imu: ImuSamples, fixes: Fixes, begin: np.ndarray, duration: float,
                   keep: np.ndarray | None = None) -> tuple[Run, Coasting]:
    """The ordinary run, and the runs in which the fixes after each `begin` are withheld.

    begin: (o,) ns, ascending. duration: s that each outage is followed for, or to the end of the recording. keep: as
    for `replay`. An outage is left out where the filter was not running at its begin.
    """
    work = _CoastingReplay(config, imu, fixes, keep, np.asarray(begin, dtype=np.int64), duration)
    run = work.run()
    parts = work.coasted
    work.parts = [part for part, _ in parts]
    first = np.concatenate([[0], np.cumsum([len(part.samples) for part in work.parts])]).astype(np.int64)
    return run, Coasting(np.array([b for _, b in parts], dtype=np.int64), first, work._result())


class _CoastingReplay(_Replay):
    def __init__(self, config, imu, fixes, keep=None, begin=(), duration=0.0):
        super().__init__(config, imu, fixes)
        self.keep = np.ones(len(imu), dtype=bool) if keep is None else keep
        self.begin, self.duration = begin, duration
        self.coasted: list[tuple[_Part, int]] = []

    def _filter(self, memory, time, samples, records, arrival, answers, epoch):
        kept = np.flatnonzero(self.keep[samples])
        states = np.empty((len(kept), len(self.columns)))
        begin = [b for b in self.begin if len(kept) and time[kept[0]] <= (b - epoch) * 1e-9 <= time[-1]]
        edges = np.array([((b - epoch) * 1e-9, (b - epoch) * 1e-9 + self.duration) for b in begin]).reshape(-1, 2)
        # one row before the begin and one after the end, to interpolate between
        rows = np.column_stack([np.searchsorted(time[kept], edges[:, 0], side='right') - 1,
                                np.minimum(np.searchsorted(time[kept], edges[:, 1]) + 1, len(kept))])
        fork = np.array([_first(arrival[records[:, Fix.TIME] > t], len(time)) for t in edges[:, 0]], dtype=np.int64)
        order = np.argsort(fork, kind='stable')
        coasted = [np.empty((stop - start, len(self.columns))) for start, stop in rows]
        flat = np.empty((sum(len(c) for c in coasted), len(self.columns)))
        first = np.concatenate([[0], np.cumsum(rows[:, 1] - rows[:, 0])]).astype(np.int64)
        _run(memory, time, *self._inputs(samples), records, arrival, answers, self.columns, kept, states,
             order, fork, edges[:, 0].copy(), rows, first, flat, np.empty_like(memory))
        for i, b in enumerate(begin):
            part = _Part(samples[kept[rows[i, 0]:rows[i, 1]]], flat[first[i]:first[i + 1]], epoch,
                         np.empty(0, dtype=np.int64), np.empty((0, records.shape[1])))
            self.coasted.append((part, b))
        return samples[kept], states


def _first(values, default):
    return values.min() if len(values) else default


@njit(nogil=True)
def _run(memory, time, force, rate, fixes, arrival, answers, columns, kept, states,
         order, fork, begin, rows, first, coasted, spare):
    """As `kernel.run`, with states only of the samples `kept`, and with outages.

    order: of the outages by `fork`, the sample before which the first withheld fix of each is known. begin: s, after
    which fixes are withheld. rows (o, 2): of `states` that each outage covers; first: where they stand in `coasted`.
    spare: a second memory.
    """
    next_fix, next_row, next_outage = 0, 0, 0
    for k in range(len(time)):
        while next_outage < len(order) and fork[order[next_outage]] <= k:
            i = order[next_outage]
            _coast(memory, spare, time, force, rate, fixes, arrival, next_fix, columns, kept, states, k,
                   next_row, begin[i], rows[i, 0], coasted[first[i]:first[i + 1]])
            next_outage += 1
        while next_fix < len(fixes) and arrival[next_fix] <= k:
            if memory[Head.FIXES] == memory[Head.FIX_CAPACITY]:
                collect(memory, fixes)
            fixes[next_fix, Fix.ID] = next_fix
            answers[next_fix] = take_fix(memory, fixes[next_fix])
            next_fix += 1
        take_sample(memory, time[k], force[k, 0], force[k, 1], force[k, 2], rate[k, 0], rate[k, 1], rate[k, 2])
        if next_row < len(kept) and kept[next_row] == k:
            newest = np.uint64(state_at(memory, int(memory[Head.SAMPLES])))
            for c in range(len(columns)):
                states[next_row, c] = memory[newest + columns[c]]
            next_row += 1
    collect(memory, fixes)
    for j in range(next_outage, len(order)):  # no fix came any more
        i = order[j]
        coasted[first[i]:first[i + 1]] = states[rows[i, 0]:rows[i, 1]]


@njit(nogil=True)
def _coast(memory, spare, time, force, rate, fixes, arrival, next_fix, columns, kept, states, k,
           next_row, begin, row, coasted):
    """One outage from sample k on: rows from `row` on, the first of them from `states`, those from sample k on without
    fixes later than `begin`."""
    done = min(max(next_row - row, 0), len(coasted))
    coasted[:done] = states[row:row + done]
    if done == len(coasted):
        return
    spare[:] = memory
    last = kept[row + len(coasted) - 1]
    while k <= last:
        while next_fix < len(fixes) and arrival[next_fix] <= k:
            if fixes[next_fix, Fix.TIME] <= begin:  # late, but of a time before the outage
                take_fix(spare, fixes[next_fix])
            next_fix += 1
        take_sample(spare, time[k], force[k, 0], force[k, 1], force[k, 2], rate[k, 0], rate[k, 1], rate[k, 2])
        if kept[row + done] == k:
            newest = np.uint64(state_at(spare, int(spare[Head.SAMPLES])))
            for c in range(len(columns)):
                coasted[done, c] = spare[newest + columns[c]]
            done += 1
        k += 1
