"""Fixed-interval smoothing: each state of a recording estimated from all measurements, before and after it.

The filter runs forward and stores, for each state that is kept, its row (estimate, covariance P) and the history since
the previous one (history.py). A backward pass accumulates the later innovations in lambda and their information in
Lambda; then

    smoothed x = x + P lambda          smoothed P = P - P Lambda P

which is the smoother of Rauch, Tung and Striebel in the form of Bryson and Frazier (G. J. Bierman, "Fixed interval
smoothing with discrete measurements", Int. J. Control 18, 1973): nothing is inverted, and any number of predictions and
corrections may lie between two stored states. All states of the filter are smoothed.

The rows are stored in a temporary file: 8 (width + 2 n^2 + n) bytes each, 7.4 kB with the 18 states of a car, 270 MB
for an hour at 10 Hz; BLOCK of them are in memory.
"""
from __future__ import annotations

import tempfile
from collections.abc import Iterator

import numpy as np

from ...samples import Aiding, Fixes, ImuSamples
from .. import history
from ..config import FilterConfig
from ..memory import NAV, Event, Head, StateLayout, covariance, covariance_index, row_width, state_at
from ..update import feed_back
from .replay import Coasting, Events, Playback, Replay, Stretch
from .results import Run

BLOCK = 256  # rows in memory at a time
AFTER = 60.0  # s after an outage whose measurements are used to smooth it


def smoothed(config: FilterConfig, imu: ImuSamples, fixes: Fixes, aiding: Aiding = Aiding(),
             keep: np.ndarray | None = None) -> Run:
    """`replay.run` with smoothed states, sigmas and covariance. Verdicts and innovations are those of the forward
    filter.

    keep: samples whose states are kept, (n,) bool; intervals of a tenth of a second suffice.
    """
    return _Smoothing(config, imu, fixes, aiding, None, keep).run()


def smoothed_outages(config: FilterConfig, imu: ImuSamples, fixes: Fixes, begin: np.ndarray, duration: float,
                     aiding: Aiding = Aiding(), keep: np.ndarray | None = None) -> Coasting:
    """Smoothed outages, which begin at `begin` (o,) ns: fixes are withheld for `duration` s and are used again after
    it.

    Other arguments and the result as for `replay.run_with_outages`, in which fixes do not return.
    """
    work = _SmoothedOutages(config, imu, fixes, aiding, None, keep, np.asarray(begin, dtype=np.int64), duration)
    work.run()
    return work.coasting()


class _Rows:
    """Rows of floats, appended one by one and read back from the last to the first."""

    def __init__(self, width: int):
        self.file, self.block, self.used, self.blocks = tempfile.TemporaryFile(), np.empty((BLOCK, width)), 0, 0

    def next(self) -> np.ndarray:
        """Room for one more row."""
        if self.used == BLOCK:
            self.file.write(self.block.data)
            self.used, self.blocks = 0, self.blocks + 1
        self.used += 1
        return self.block[self.used - 1]

    def backward(self) -> Iterator[np.ndarray]:
        yield from self.block[:self.used][::-1]
        for i in reversed(range(self.blocks)):
            self.file.seek(i * self.block.nbytes)
            yield from np.frombuffer(self.file.read(self.block.nbytes)).reshape(self.block.shape)[::-1]
        self.file.close()


class _Smoothing(Replay):
    """A replay with the measurements in the order of their times, without delays."""

    def _memory(self) -> np.ndarray:
        memory = self.config.memory(history=True)
        history.begin(memory, self.config.layout.n)
        return memory

    def _filter(self, memory, samples, index, events: Events, epoch: int) -> None:
        order = np.argsort(events.event[:, Event.TIME], kind='stable')
        timely = events.select(order)
        timely.event[:, Event.ID] = np.arange(len(order))
        timely.arrival[:] = np.searchsorted(samples[:, 0], timely.event[:, Event.TIME])
        self._smooth(memory, samples, index, timely, epoch)
        events.event[order], events.answer[order] = timely.event, timely.answer

    def _smooth(self, memory, samples, index, events: Events, epoch: int) -> None:
        kept = np.flatnonzero(self.keep[index])
        rows, work = self._rows(), self._work(samples, events)
        for k in kept.tolist():
            work.advance(memory, k + 1)
            self._take(memory, rows.next())
        work.advance(memory, len(samples))
        work.finish(memory)
        self.stretches.append(Stretch(index[kept], self._looked_back(memory, rows, len(kept))))

    def _work(self, samples, events: Events, after: Playback | None = None) -> Playback:
        none = np.empty(0, dtype=np.int64)
        return Playback(samples, events, self.columns, none, np.empty((0, len(self.columns))), after)

    def _rows(self) -> _Rows:
        layout = self.config.layout
        return _Rows(row_width(layout) + 2 * layout.n**2 + layout.n)

    def _take(self, memory, out: np.ndarray) -> None:
        history.take(memory, state_at(memory, int(memory[Head.SAMPLES])), self.config.layout.n, out)

    def _looked_back(self, memory, rows: _Rows, count: int) -> np.ndarray:
        """Columns (count, c) of the smoothed states; the history since the last of `rows` is in `memory`."""
        layout, columns = self.config.layout, self.columns.astype(np.int64)
        last = np.empty_like(rows.block[0])
        self._take(memory, last)
        vector, information = _history(last, layout)[1:]  # lambda and Lambda
        states, n = np.empty((count, len(columns))), layout.n
        diagonal = [covariance_index(i, i, layout) for i in range(n)] + [covariance_index(0, 1, layout)]
        at = int(memory[Head.RING_AT]) - row_width(layout)  # a spare row of the memory
        for i, row in zip(range(count - 1, -1, -1), rows.backward()):
            p, state = covariance(row, layout), memory[at:at + row_width(layout)]
            state[:] = row[:len(state)]
            state[NAV:NAV + n] += p @ vector
            feed_back(memory, at)
            smoothed_p = p - p @ information @ p
            state[diagonal] = [*np.maximum(np.diag(smoothed_p), 0.0), smoothed_p[0, 1]]
            states[i] = state[columns]
            transition, g, more = _history(row, layout)
            vector = transition.T @ vector + g
            information = transition.T @ information @ transition + more
        return states


class _SmoothedOutages(_Smoothing):
    """Outages as copies of the filter, each continued until AFTER its end."""

    def _smooth(self, memory, samples, index, events: Events, epoch: int) -> None:
        kept, time = np.flatnonzero(self.keep[index]), samples[:, 0]
        work, withheld = self._work(samples, events), self._are_withheld(events)
        for b in self.begin:
            begin = (b - epoch) * 1e-9
            if not len(kept) or not time[kept[0]] <= begin <= time[-1]:
                continue
            first = int(np.searchsorted(time[kept], begin, side='right')) - 1
            stop = min(int(np.searchsorted(time[kept], begin + self.duration)) + 1, len(kept))
            work.advance(memory, int(kept[first]) + 1)
            left = events.select(~(withheld & (events.event[:, Event.TIME] > begin)
                                   & (events.event[:, Event.TIME] <= begin + self.duration)))
            branch, coasting, rows = self._work(samples, left, work), memory.copy(), self._rows()
            history.begin(coasting, self.config.layout.n)
            for k in kept[first:stop].tolist():
                branch.advance(coasting, k + 1)
                self._take(coasting, rows.next())
            branch.advance(coasting, int(np.searchsorted(time, begin + self.duration + AFTER)))
            self.branches.append(Stretch(index[kept[first:stop]],
                                          self._looked_back(coasting, rows, stop - first), int(b),
                                          self.duration))


def _history(row: np.ndarray, layout: StateLayout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """T (n, n), g (n,) and G (n, n) of the history stored with a row."""
    n, at = layout.n, row_width(layout)
    square = at + n * n
    return row[at:square].reshape(n, n), row[square + n * n:], row[square:square + n * n].reshape(n, n)
