"""The clock of the stamps of the reference: that of the IMU, that of the receiver, or its own (`reference_clock`).

Reference and fixes are positions of the same vehicle, so their time offset shows without a filter.
- If it is zero, the reference has the clock of the fixes: a time offset that is found for the fixes is also that of the
  reference, which neither confirms nor contradicts it.
- A reference with its own clock is the truth in all but time: errors are measured with the time offset that fits each
  track best.
- If the offset is not zero or not known, the reference is treated as if it had the clock of the IMU, as long as it does
  not contradict what is found; and as if it had its own otherwise.
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

SAME = 0.02  # s, largest time offset with which two clocks count as the same
SIGMAS = 2.0  # number of sigmas by which the offset must exceed SAME for them to be different
UNKNOWN = 0.03  # s, largest sigma with which the offset counts as known
#: s, length of a block of fixes whose errors, and scores, may be correlated
FIX_BLOCK = 20.0
SLOWEST = 1.0  # m/s, lowest speed at which positions show a time offset
ITERATIONS = 3  # number of linearizations when the time offset of a track is estimated


@dataclass(frozen=True)
class ReferenceClock:
    """The clock of the reference. name: IMU, GNSS, OWN, or AUTO if it may be IMU or OWN. late, sigma: s by which the
    stamps of the reference are later than those of the fixes; NaN if unknown."""

    name: str
    late: float
    sigma: float


def reference_clock_of(recording: Recording, name: str) -> ReferenceClock:
    """The clock of the reference; without one the fixes are the truth. name: the parameter `reference_clock`."""
    if recording.reference is None or recording.gnss is None:
        return ReferenceClock(GNSS, 0.0, 0.0)
    late, sigma = lateness(recording.reference, recording.gnss)
    same = np.isfinite(late) and sigma < UNKNOWN and abs(late) < SAME + SIGMAS * sigma
    return ReferenceClock(GNSS if name == AUTO and same else name, late, sigma)


def lateness(reference: Reference, fixes: Fixes) -> tuple[float, float]:
    """s by which the stamps of the reference are later than those of the fixes, and sigma; NaN with too little motion.

    The difference of the positions along the velocity is the speed times the offset. sigma: from the scatter of blocks.
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
    """s by which the stamps of the truth are later than those of a filter's track; 0 if unknown."""
    late = 0.0
    for _ in range(ITERATIONS):  # the velocity is not constant over a long offset
        errors = position_errors(track, shifted_truth(truth, round(late * 1e9)), np.zeros(len(truth), dtype=bool))
        if not len(errors):
            return late
        at, time = ((stamp - track.stamp[0]) * 1e-9 for stamp in (errors.stamp, track.stamp))
        velocity = np.column_stack([np.interp(at, time, axis) for axis in track.velocity.T[:2]])
        more, _ = _along(at, np.column_stack([errors.north, errors.east]), velocity)
        late += more if np.isfinite(more) else 0.0
    return late


def shifted_truth(truth: Truth, shift: int) -> Truth:
    """`truth` with stamps that are earlier by `shift`, ns."""
    return replace(truth, reference=replace(truth.reference, stamp=truth.reference.stamp - shift))


def _along(at: np.ndarray, off: np.ndarray, velocity: np.ndarray) -> tuple[float, float]:
    """The time offset, s, that best explains the differences `off` (k, 2), m, as `velocity` (k, 2) times the offset,
    and its sigma; NaN with too little motion. at (k,): s. Outliers are left out.
    """
    distance = np.linalg.norm(off - np.median(off, axis=0), axis=1) if len(off) else np.zeros(0)
    good = (np.linalg.norm(velocity, axis=1) > SLOWEST) & (distance < 5 * np.median(distance) + 1.0)
    if good.sum() < 20:
        return float('nan'), float('nan')
    # without their means: a constant difference is that of another antenna or datum, not of time
    off, velocity = (v[good] - v[good].mean(axis=0) for v in (off, velocity))
    block = np.unique((at[good] // FIX_BLOCK).astype(int), return_inverse=True)[1]
    share, weight = (np.bincount(block, (velocity * v).sum(axis=1)) for v in (off, velocity))
    late = share.sum() / weight.sum()
    return float(late), float(np.sqrt(((share - late * weight) ** 2).sum()) / weight.sum())
