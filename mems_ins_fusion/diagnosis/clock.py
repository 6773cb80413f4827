"""In which clock the reference runs: that of the IMU, that of the receiver, or its own (`reference_clock`).

Reference and fixes are positions of the same vehicle, so how late one is against the other shows without any filter.
Where they agree in time, the reference goes with the fixes: whatever offset is found for these is its, too, and it
neither speaks for one nor against it. A reference with a clock of its own judges all but time: errors are measured with
the difference that suits each track best. Where they do not agree, or nobody can tell, it is taken for one in the IMU's
clock as long as it agrees with what is found, and for one with its own where it does not.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..evaluation.metrics import Truth, position_errors
from ..filter.measurements.position import is_fix
from ..filter.runs.results import Run
from ..navigation.earth import radii
from ..navigation.frames import near
from ..samples import Fixes, Recording, Reference

IMU, GNSS, OWN, AUTO = 'imu', 'gnss', 'own', 'auto'

#: s by which two clocks differ at most that count as the same
SAME = 0.02
#: sigmas by which they have to differ from that to be different ones
SIGMAS = 2.0
#: s: with a larger sigma nothing is told of them
UNKNOWN = 0.03
#: fixes in blocks of this length count as one, s
BLOCK = 20.0
#: who is slower shows no time, m/s
SLOWEST = 1.0
#: times that a track's lateness is looked for about the one before
ITERATIONS = 3


@dataclass(frozen=True)
class Clock:
    """name: IMU, GNSS, OWN, or AUTO where it may be either of IMU and OWN. late, sigma: s, by which the stamps of the
    reference are later than those of the fixes; NaN where that does not show."""

    name: str
    late: float
    sigma: float


def whose(recording: Recording, name: str) -> Clock:
    """The clock of the reference, `name` by `reference_clock`; without a reference the truth are the fixes."""
    if recording.reference is None or recording.gnss is None:
        return Clock(GNSS, 0.0, 0.0)
    late, sigma = lateness(recording.reference, recording.gnss)
    same = np.isfinite(late) and sigma < UNKNOWN and abs(late) < SAME + SIGMAS * sigma
    return Clock(GNSS if name == AUTO and same else name, late, sigma)


def lateness(reference: Reference, fixes: Fixes) -> tuple[float, float]:
    """By how much the stamps of the reference are later than those of the fixes, s, and sigma; NaN if it moves little.

    Along its velocity the reference differs from the fixes by the speed times that; sigma from the scatter of blocks.
    """
    fixes = fixes.select(is_fix(fixes))
    stamp, first = np.unique(reference.stamp, return_index=True)
    nan = float('nan'), float('nan')
    if len(stamp) < 3 or not len(fixes):
        return nan
    meridian, prime_vertical = radii(reference.latitude[0])
    scale = np.array([meridian, prime_vertical * np.cos(reference.latitude[0])])
    origin = np.array([reference.latitude[0], reference.longitude[0]])

    def local(places):
        return (np.column_stack([places.latitude, near(places.longitude, origin[1])]) - origin) * scale

    path = local(reference)[first]
    time, at = (stamp - stamp[0]) * 1e-9, (fixes.stamp - stamp[0]) * 1e-9
    velocity = np.gradient(path, time, axis=0)
    inside = (at > time[0]) & (at < time[-1])
    at = at[inside]
    gap = np.diff(time)[np.clip(np.searchsorted(time, at) - 1, 0, len(time) - 2)] < 2.5
    there = np.column_stack([np.interp(at, time, axis) for axis in path.T])
    speed = np.column_stack([np.interp(at, time, axis) for axis in velocity.T])
    off = local(fixes)[inside] - there
    return _along(at[gap], off[gap], speed[gap])


def lateness_against(track: Run, truth: Truth) -> float:
    """By how much the stamps of the truth are later than those of a filter's track, s; 0 where that does not show."""
    late = 0.0
    for _ in range(ITERATIONS):  # the longer it is, the less a velocity tells of the way
        errors = position_errors(track, earlier(truth, round(late * 1e9)), np.zeros(len(truth), dtype=bool))
        if not len(errors):
            return late
        at, time = ((stamp - track.stamp[0]) * 1e-9 for stamp in (errors.stamp, track.stamp))
        velocity = np.column_stack([np.interp(at, time, axis) for axis in track.velocity.T[:2]])
        more, _ = _along(at, np.column_stack([errors.north, errors.east]), velocity)
        late += more if np.isfinite(more) else 0.0
    return late


def earlier(truth: Truth, shift: int) -> Truth:
    """`truth` with stamps that are earlier by `shift`, ns."""
    return replace(truth, reference=replace(truth.reference, stamp=truth.reference.stamp - shift))


def _along(at: np.ndarray, off: np.ndarray, velocity: np.ndarray) -> tuple[float, float]:
    """The time, s, that multiplied by the `velocity` (m, 2) is `off` (m, 2), and sigma; NaN where little moves.

    at: s. What lies apart from the others does not count.
    """
    distance = np.linalg.norm(off - np.median(off, axis=0), axis=1) if len(off) else np.zeros(0)
    good = (np.linalg.norm(velocity, axis=1) > SLOWEST) & (distance < 5 * np.median(distance) + 1.0)
    if good.sum() < 20:
        return float('nan'), float('nan')
    # about their means: an antenna elsewhere, or another map, is no time
    off, velocity = (v[good] - v[good].mean(axis=0) for v in (off, velocity))
    block = np.unique((at[good] // BLOCK).astype(int), return_inverse=True)[1]
    share, weight = (np.bincount(block, (velocity * v).sum(axis=1)) for v in (off, velocity))
    late = share.sum() / weight.sum()
    return float(late), float(np.sqrt(((share - late * weight) ** 2).sum()) / weight.sum())
