"""The valid samples of a recording, for tools that look at raw samples: checker, `configure` and others.

These are the samples that the filter would use. The filter itself gets all messages and checks them one by one with the
same functions (`intake.follow`, `measurements.position.is_place`); it bridges samples that are out of range.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from mems_ins_fusion.samples import Fixes, ImuSamples, Recording

from ...parameters.table import defaults
from ..measurements.position import has_altitude, is_fix
from .intake import GOOD, JUMPED, LATEST, follow

#: largest value of an IMU in any unit (mg, deg/s): 16 g are 16 000 mg, and the range of MEMS gyroscopes is at most
#: 4000 deg/s
LARGEST_IN_ANY_UNIT = 1e5
LONGEST_BREAK = 3600.0  # s, longest gap between samples of one recording


def usable(recording: Recording, largest_force: float = LARGEST_IN_ANY_UNIT,
           largest_rate: float = LARGEST_IN_ANY_UNIT) -> Recording:
    """`recording` with its valid IMU samples and fixes (`usable_samples`, `usable_fixes`)."""
    fixes = None if recording.gnss is None else usable_fixes(recording.gnss)
    return replace(recording, imu=usable_samples(recording.imu, largest_force, largest_rate), gnss=fixes)


def usable_samples(imu: ImuSamples, largest_force: float = LARGEST_IN_ANY_UNIT,
                   largest_rate: float = LARGEST_IN_ANY_UNIT) -> ImuSamples:
    """The samples of `imu` that are finite, within range, with a specific force other than zero, and with ascending
    stamps; none where all angular rates are zero.

    largest_force, largest_rate: of a component, in the unit of the samples. Where stamps jump between clocks, the
    samples of the most frequent clock. The same object where all are valid.
    """
    if not len(imu):
        return imu
    if not imu.angular_rate.any():
        return imu.select(slice(0, 0))
    values = np.hstack([imu.specific_force, imu.angular_rate])
    with np.errstate(invalid='ignore'):
        good = (np.abs(values) <= np.repeat([largest_force, largest_rate], 3)).all(axis=1) & values[:, :3].any(axis=1)
    index = np.flatnonzero(good)
    index = index[_of_one_clock(imu.stamp[index], values[index])]
    return imu if len(index) == len(imu) else imu.select(index)


def _of_one_clock(stamp: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Indices of the samples of the most frequent clock, with ascending stamps (n,) ns."""
    codes, parameters = np.zeros(len(stamp), dtype=np.int64), defaults()
    restart_gap, step_back = (round(parameters[name] * 1e9) for name in ('imu.restart_gap', 'imu.max_gap'))
    follow(np.full(3, -1, dtype=np.int64), stamp, values, restart_gap, step_back, codes)
    good = np.flatnonzero((codes == GOOD) | (codes == JUMPED))
    pieces = np.split(good, np.flatnonzero(codes[good] == JUMPED))
    clocks: list[list[np.ndarray]] = []
    for piece in (piece for piece in pieces if len(piece)):
        for clock in clocks:
            if 0 < (stamp[piece[0]] - stamp[clock[-1][-1]]) * 1e-9 <= LONGEST_BREAK:
                clock.append(piece)
                break
        else:
            clocks.append([piece])
    return max((np.concatenate(clock) for clock in clocks), key=len, default=good)


def usable_fixes(fixes: Fixes) -> Fixes:
    """The valid ones of `fixes`, each once, in the order of their stamps.

    A fix whose delay differs from the median delay by more than LATEST has the stamp of another clock. Where some have
    no altitude, theirs is interpolated between those that have one.
    """
    index = np.flatnonzero(is_fix(fixes))
    if len(index):
        delay = (fixes.received[index] - fixes.stamp[index]) * 1e-9
        index = index[np.abs(delay - np.median(delay)) <= LATEST]
    _, first = np.unique(fixes.stamp[index], return_index=True)
    index = index[first]
    if len(index) < len(fixes) or (index[1:] < index[:-1]).any():
        fixes = fixes.select(index)
    known = has_altitude(fixes)
    if known.all() or not known.any():
        return fixes
    since = fixes.stamp - fixes.stamp[0]
    return replace(fixes, height=np.interp(since, since[known], fixes.height[known]))
