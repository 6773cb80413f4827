"""The odometry that a live filter would publish for a recording, by the same code after the same inputs."""
from __future__ import annotations

import numpy as np

from ...samples import Aiding, Fixes, ImuSamples
from ..config import FilterConfig
from ..memory import Event, Kind
from ..start.alignment import Alignment
from ..start.initial import initialize
from ..start.start import Start
from .odometry import SIZE, odometry, widen_without_heading
from .replay import Events, Playback, Replay


def published(config: FilterConfig, imu: ImuSamples, fixes: Fixes, aiding: Aiding, datum,
              keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (k,) ns and `odometry` (k, SIZE) after each of the samples `keep` (n,) bool.

    datum: latitude, longitude (rad), height of the origin. Until the heading is known, the odometry is that of the
    provisional filter.
    """
    work = _Publishing(config, imu, fixes, aiding, None, keep)
    work.datum = np.array(datum, dtype=float)
    work.run()
    index, rows = (np.concatenate(parts) for parts in zip(*work.published)) if work.published else (
        np.empty(0, dtype=np.int64), np.empty((0, SIZE)))
    return imu.stamp[index], rows


class _Waiting(Alignment):
    """An alignment that notes each provisional start and the number of samples before it."""

    def __init__(self, config: FilterConfig):
        super().__init__(config)
        self.fed = 0
        self.found: list[tuple[int, Start | None]] = []

    def add_samples(self, samples, orientation=None):
        super().add_samples(samples, orientation)
        self.fed += len(samples)

    def add_event(self, event, say):
        start = super().add_event(event, say)
        self.found.append((self.fed, None if start else self.provisional()))
        return start


class _Publishing(Replay):
    """A replay that stops after each sample kept to compute the odometry, as the node does."""

    datum: np.ndarray
    height_sigma = 0.0

    def run(self):
        self.published: list[tuple[np.ndarray, np.ndarray]] = []
        self.height_sigma = self.config.gnss.default_sigma
        return super().run()

    def _events(self, kept: np.ndarray, end: int, epoch: int) -> Events:
        events = super()._events(kept, end, epoch)
        fixes = events.select(events.kind == Kind.POSITION)
        self._heights = fixes.arrival, np.sqrt(fixes.event[:, Event.R_DD])
        self._length = len(kept)
        return events

    def _alignment(self) -> Alignment:
        self._waiting = _Waiting(self.config)
        return self._waiting

    def _align(self, kept, samples, events: Events, saved) -> tuple[Start | None, int]:
        start, first = super()._align(kept, samples, events, saved)
        found = self._waiting.found
        if start is not None:
            self._aligned, _ = found[-1]
        else:
            found.append((len(samples), None))
        nothing = events.select(slice(0))
        for (fed, provisional), (end, _) in zip(found, found[1:]):
            if provisional is not None:
                memory = self.config.memory()
                initialize(memory, self.config, provisional)
                begin = int(np.searchsorted(samples[:end, 0], provisional.time, side='right'))
                self._ask(memory, samples[begin:end], kept[begin:end], nothing, begin, fed - begin, provisional)
        return start, first

    def _filter(self, memory, samples, index, events: Events, epoch: int) -> None:
        events.event[:, Event.ID] = np.arange(len(events.kind))
        first = self._length - len(index)  # the start describes the time of its fix, but the fix arrived later
        self._ask(memory, samples, index, events, first, max(self._aligned - first, 0)).finish(memory)
        self.height_sigma = np.append(self._heights[1], self.height_sigma)[len(self._heights[0]) - 1]

    def _ask(self, memory, samples, index, events: Events, first: int, silent: int = 0,
             without_heading: Start | None = None) -> Playback:
        """Pass samples with their indices to the kernel, and compute the odometry after each sample that is kept.

        first: number of the first sample. silent: number of samples before the first output. without_heading: the start
        of a provisional filter.
        """
        kept = np.flatnonzero(self.keep[index])
        kept = kept[kept >= silent]
        rows, geodetic, covariance = np.zeros((len(kept), SIZE)), np.empty(3), np.empty(9)
        work = Playback(samples, events, self.columns, kept[:0], np.empty((0, len(self.columns))))
        # the standard deviation of the planar height is that of the latest fix, including those of the alignment
        arrived, sigma = self._heights
        latest = np.searchsorted(arrived, kept + first, side='right') - 1
        sigma = np.append(sigma, self.height_sigma)  # -1, none yet, is the one before
        for i, k in enumerate(kept.tolist()):
            work.advance(memory, k + 1)
            odometry(memory, self.datum, sigma[latest[i]], rows[i], geodetic, covariance)
            if without_heading is not None:
                widen_without_heading(without_heading, self.datum, rows[i], geodetic, covariance)
        self.published.append((index[kept], rows))
        return work
