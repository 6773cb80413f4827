"""What comes in while driving, in chunks: the same ones live, sample by sample, and of a recording."""
from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..filter.measurements.base import Measurement
from ..filter.measurements.registry import AIDING
from ..samples import Fixes, ImuSamples, Recording

#: s of samples, of a chunk
CHUNK = 30.0
_CHUNK = round(CHUNK * 1e9)  # ns
#: ns: stamps that jump by more are of another drive
JUMP = 10 * 10**9
#: of a recording of what came in lately
NAME = 'the last minutes'
_FIX_TYPES = (float, float, float, float, np.int8, np.uint8)


class ChunkEnds:
    """When a chunk ends: with the last sample before the next slot of CHUNK s, counted from the first sample, and where
    the stamps jump. newest: the latest stamp since, ns; 0: none yet."""

    def __init__(self):
        self.newest = self._first = self._slot = 0

    def ends_before(self, stamp: int) -> bool:
        """Whether the sample with `stamp`, ns, begins another chunk. To be asked of each sample, in order."""
        before = self.newest
        if not before or abs(stamp - before) > JUMP:
            self.newest, self._first, self._slot = stamp, stamp, 0
            return before != 0
        self.newest = max(stamp, before)
        slot = (self.newest - self._first) // _CHUNK
        ends, self._slot = slot != self._slot, slot
        return ends


@dataclass
class Chunk:
    """One chunk, as it came in: stamps (ns), the numbers as in their samples, and the newest stamp of the IMU.

    kinds: what the measurements besides the fixes are as arrays, by name.
    """

    kinds: dict[str, type]
    samples: list[tuple] = field(default_factory=list)
    fixes: list[tuple] = field(default_factory=list)
    aiding: dict[str, list[tuple]] = field(default_factory=dict)

    def recording(self) -> Recording:
        """It as arrays."""
        stamp, received, values = _columns(self.samples, (float,) * 6)
        values = np.array(values).T
        imu = ImuSamples(stamp, received, values[:, :3].copy(), values[:, 3:].copy())
        aiding = {name: _samples(self.kinds[name], rows) for name, rows in self.aiding.items() if rows}
        return Recording(NAME, imu, _samples(Fixes, self.fixes)).having(aiding)


def _samples(kind: type, rows: list[tuple]):
    """Measurements as samples of their kind."""
    if kind is Fixes:
        stamp, received, values = _columns(rows, _FIX_TYPES)
        values[3] = values[3].reshape(-1, 3, 3)
    else:
        stamp, received, values = _columns(rows, (float,) * (len(rows[0]) - 2))
    return kind(stamp, received, *values)


def _columns(rows: list[tuple], types: tuple) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Stamps, when received, and the columns in between, of these types."""
    stamp, *values, received = zip(*rows) if rows else [()] * (len(types) + 2)
    return (np.array(stamp, dtype=np.int64), np.array(received, dtype=np.int64),
            [np.array(v, dtype=t) for v, t in zip(values, types)])


class Gathering:
    """Takes what comes in, until it is a chunk. inputs: what there may be besides the fixes."""

    def __init__(self, inputs: Sequence[Measurement] = AIDING):
        self._kinds = {one.name: one.samples for one in inputs}
        self._slots, self._chunk = ChunkEnds(), Chunk(self._kinds)

    def add_sample(self, sample: tuple) -> Chunk | None:
        """Stamp (ns), specific force, angular rate. What came before it, where that is a chunk."""
        full = None
        if not math.isfinite(sum(sample[1:])):
            return full
        if self._slots.ends_before(sample[0]):
            full, self._chunk = self._chunk, Chunk(self._kinds)
        self._chunk.samples.append((*sample, self._slots.newest))
        return full

    def add_fix(self, fix: tuple) -> None:
        """Stamp (ns), latitude, longitude (rad), height, covariance (9,), status, type of the covariance."""
        if self._slots.newest:
            self._chunk.fixes.append((*fix, self._slots.newest))

    def add(self, name: str, stamp: int, numbers: tuple) -> None:
        """A measurement besides the fixes; numbers: in the order of the fields of its samples."""
        if self._slots.newest:
            self._chunk.aiding.setdefault(name, []).append((stamp, *numbers, self._slots.newest))


def chunks(recording: Recording, inputs: Sequence[Measurement] = AIDING) -> Iterator[Recording]:
    """`recording`, of it the fixes and `inputs`, in the complete chunks that a live node makes of it.

    What came before the first sample, the temperature and the reference are left out; received: when the newest sample
    before it was stamped.
    """
    imu, slots, newest, edges = recording.imu, ChunkEnds(), [], [0]
    imu = imu.select(np.isfinite(imu.specific_force.sum(axis=1) + imu.angular_rate.sum(axis=1)))
    for i, stamp in enumerate(imu.stamp.tolist()):
        if slots.ends_before(stamp):
            edges.append(i)
        newest.append(slots.newest)
    newest = np.array(newest, dtype=np.int64)
    parts = {name: samples for name, samples in recording.streams().items()
             if name in {'gnss', *(measurement.name for measurement in inputs)}}
    arrived = {name: np.searchsorted(imu.received, samples.received, side='right') for name, samples in parts.items()}
    imu = replace(imu, received=newest, orientation=None, temperature=None)
    parts = {name: replace(samples, received=newest[np.maximum(arrived[name], 1) - 1])
             for name, samples in parts.items()}
    for first, end in zip(edges[:-1], edges[1:]):
        yield Recording(NAME, imu.select(slice(first, end))).having({
            name: samples.select((arrived[name] > first) & (arrived[name] <= end)) for name, samples in parts.items()})
