"""What a live filter would publish of a recording: the same compiled `odometry` after the same events."""
from __future__ import annotations

import numpy as np

from ..samples import Fixes, ImuSamples
from .config import FilterConfig
from .layout import Event, Kind
from .odometry import SIZE, odometry
from .replay import Aiding, _Events, _Replay, _Work


def published(config: FilterConfig, imu: ImuSamples, fixes: Fixes, aiding: Aiding, datum,
              keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (k,) ns and what `odometry` makes of the state after each of the samples `keep` (n,), (k, SIZE).

    datum: latitude, longitude (rad), height of the origin.
    """
    work = _Publishing(config, imu, fixes, aiding, None, keep)
    work.datum = np.array(datum, dtype=float)
    work.run()
    index, rows = (np.concatenate(parts) for parts in zip(*work.published)) if work.published else (
        np.empty(0, dtype=np.int64), np.empty((0, SIZE)))
    return imu.stamp[index], rows


class _Publishing(_Replay):
    """A replay that stops after each sample kept and asks for the odometry, as the node does."""

    datum: np.ndarray
    height_sigma = 0.0

    def run(self):
        self.published: list[tuple[np.ndarray, np.ndarray]] = []
        self.height_sigma = self.config.gnss.default_sigma
        return super().run()

    def _events(self, kept: np.ndarray, end: int, epoch: int) -> _Events:
        events = super()._events(kept, end, epoch)
        fixes = events.select(events.kind == Kind.POSITION)
        self._heights = len(kept), fixes.arrival, np.sqrt(fixes.record[:, Event.R_DD])
        return events

    def _filter(self, memory, samples, index, events: _Events, epoch: int) -> None:
        kept = np.flatnonzero(self.keep[index])
        rows, geodetic, covariance = np.zeros((len(kept), SIZE)), np.empty(3), np.empty(9)
        events.record[:, Event.ID] = np.arange(len(events.kind))
        work = _Work(samples, events, self.columns, kept[:0], np.empty((0, len(self.columns))))
        # the planar height is as good as the latest fix says, those of the alignment too
        length, arrived, sigma = self._heights
        latest = np.searchsorted(arrived, kept + length - len(index), side='right') - 1
        sigma = np.append(sigma, self.height_sigma)  # -1, none yet, is the one before
        for i, k in enumerate(kept.tolist()):
            work.advance(memory, k + 1)
            odometry(memory, self.datum, sigma[latest[i]], rows[i], geodetic, covariance)
        work.finish(memory)
        self.height_sigma = sigma[len(arrived) - 1]
        self.published.append((index[kept], rows))
