"""In which clock the reference runs: that of the IMU, that of the receiver, or its own (`reference_clock`).

Reference and fixes are positions of the same vehicle, so how late one is against the other shows without any filter.
Where they agree in time, the reference goes with the fixes: whatever offset is found for these is its, too, and it
neither speaks for one nor against it.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..navigation.earth import radii
from ..samples import Fixes, Recording, Reference

#: clocks that differ by less, s, are the same, as far as so many sigma can tell; a larger sigma, s, tells nothing
SAME, SIGMAS, UNKNOWN = 0.02, 2.0, 0.03
#: fixes in blocks of this length count as one, s
BLOCK = 20.0
#: who is slower shows no time, m/s
SLOWEST = 1.0


@dataclass(frozen=True)
class Clock:
    """with_fixes: whether the reference runs in the clock of the fixes. late, sigma: s, by which its stamps are later
    than those of the fixes; NaN where that does not show."""

    with_fixes: bool
    late: float
    sigma: float


def in_its_clock(recording: Recording, name: str) -> tuple[Recording, Clock]:
    """The recording with its reference in the clock `name` (of `reference_clock`), and that clock."""
    if recording.reference is None or recording.gnss is None:
        return recording, Clock(True, 0.0, 0.0)
    late, sigma = lateness(recording.reference, recording.gnss)
    same = np.isfinite(late) and sigma < UNKNOWN and abs(late) < SAME + SIGMAS * sigma
    clock = Clock(name in ('gnss', 'own') or (name == 'auto' and same), late, sigma)
    if name == 'own' and np.isfinite(late):
        moved = replace(recording.reference, stamp=recording.reference.stamp - round(late * 1e9))
        recording = replace(recording, reference=moved)
    return recording, clock


def lateness(reference: Reference, fixes: Fixes) -> tuple[float, float]:
    """By how much the stamps of the reference are later than those of the fixes, s, and sigma; NaN if it moves little.

    Along its velocity the reference differs from the fixes by the speed times that; sigma from the scatter of blocks.
    """
    fixes = fixes.select(fixes.status >= 0)
    stamp, first = np.unique(reference.stamp, return_index=True)
    nan = float('nan'), float('nan')
    if len(stamp) < 3 or not len(fixes):
        return nan
    meridian, prime_vertical = radii(reference.latitude[0])
    scale = np.array([meridian, prime_vertical * np.cos(reference.latitude[0])])
    origin = np.array([reference.latitude[0], reference.longitude[0]])
    path = (np.column_stack([reference.latitude, reference.longitude])[first] - origin) * scale
    time, at = (stamp - stamp[0]) * 1e-9, (fixes.stamp - stamp[0]) * 1e-9
    velocity = np.gradient(path, time, axis=0)
    inside = (at > time[0]) & (at < time[-1])
    at = at[inside]
    gap = np.diff(time)[np.clip(np.searchsorted(time, at) - 1, 0, len(time) - 2)] < 2.5
    there = np.column_stack([np.interp(at, time, axis) for axis in path.T])
    speed = np.column_stack([np.interp(at, time, axis) for axis in velocity.T])
    off = (np.column_stack([fixes.latitude, fixes.longitude])[inside] - origin) * scale - there
    distance = np.linalg.norm(off - np.median(off, axis=0), axis=1)
    good = gap & (np.linalg.norm(speed, axis=1) > SLOWEST) & (distance < 5 * np.median(distance) + 1.0)
    if good.sum() < 20:
        return nan
    # about their means: an antenna elsewhere, or another map, is no time
    off, speed = (v[good] - v[good].mean(axis=0) for v in (off, speed))
    block = np.unique((at[good] // BLOCK).astype(int), return_inverse=True)[1]
    share, weight = (np.bincount(block, (speed * v).sum(axis=1)) for v in (off, speed))
    late = share.sum() / weight.sum()
    return float(late), float(np.sqrt(((share - late * weight) ** 2).sum()) / weight.sum())
