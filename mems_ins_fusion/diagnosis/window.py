"""The samples of the last minutes, as a recording that grows at its end and is cut at its begin."""
from __future__ import annotations

from dataclasses import fields

import numpy as np

from ..samples import Recording
from .gathering import JUMP


def seconds(recording: Recording) -> float:
    return float(recording.imu.stamp[-1] - recording.imu.stamp[0]) * 1e-9 if len(recording.imu) else 0.0


def jumps(before: Recording, after: Recording) -> bool:
    """Whether the stamps of two recordings in a row jump."""
    return not 0 < int(after.imu.stamp[0]) - int(before.imu.stamp[-1]) <= JUMP


def joined_recordings(before: Recording | None, after: Recording) -> Recording:
    """Two recordings in a row as one."""
    if before is None:
        return after
    streams, later = before.streams(), after.streams()
    for name, samples in later.items():
        if name in streams:
            own = {f.name: (getattr(streams[name], f.name), getattr(samples, f.name)) for f in fields(samples)}
            streams[name] = type(samples)(**{n: None if b is None else np.concatenate([a, b])
                                             for n, (a, b) in own.items()})
        else:
            streams[name] = samples
    return before.having(streams)


def last_seconds(recording: Recording, seconds: float) -> Recording:
    """The last `seconds` of a recording."""
    return from_stamp(recording, int(recording.imu.stamp[-1]) - round(seconds * 1e9) + 1)


def from_stamp(recording: Recording, stamp: int) -> Recording:
    """A recording from `stamp` on, ns."""
    return recording.having({name: samples.select(samples.stamp >= stamp)
                             for name, samples in recording.streams().items()})
