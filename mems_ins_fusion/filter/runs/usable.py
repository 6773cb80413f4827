"""What of a recording may be looked at beside the filter: the samples that the filter's intake takes, and no others.

Who looks at raw samples - checker, `configure`, `characterize`, `diagnose`, the measuring of errors - gets them from
here. The filter itself gets the messages as they came, live and replayed, and judges them one by one with the same
functions (`intake.follow`, `measurements.position.is_place`); a sample out of range it bridges.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from mems_ins_fusion.samples import Fixes, ImuSamples, Recording

from ..measurements.position import is_fix
from .intake import GOOD, JUMPED, LATEST, follow

#: no IMU delivers more, whatever its unit: 16 g are 16 000 mg, and MEMS gyroscopes end at 4000 deg/s
LARGEST_IN_ANY_UNIT = 1e5
#: s: a longer gap between samples begins another recording: loggers are switched off for a pause of an hour
LONGEST_PAUSE = 3600.0
#: s, as `imu.restart_gap` is by default: after a longer gap all begins anew
_RESTART_GAP = 10.0
#: s, as `imu.max_gap` is by default: a clock that steps back by less is waited for
_STEP_BACK = 0.5


def usable(recording: Recording, largest_force: float = LARGEST_IN_ANY_UNIT,
           largest_rate: float = LARGEST_IN_ANY_UNIT) -> Recording:
    """`recording` with the IMU samples and fixes that may be looked at (`usable_samples`, `usable_fixes`)."""
    fixes = None if recording.gnss is None else usable_fixes(recording.gnss)
    return replace(recording, imu=usable_samples(recording.imu, largest_force, largest_rate), gnss=fixes)


def usable_samples(imu: ImuSamples, largest_force: float = LARGEST_IN_ANY_UNIT,
                   largest_rate: float = LARGEST_IN_ANY_UNIT) -> ImuSamples:
    """The samples of `imu` that are numbers, within range, with a specific force that is not zero (gravity never is),
    and whose stamps ascend: perhaps none, and none of an IMU whose gyroscopes say nothing but zero.

    largest_force, largest_rate: of a component, in the unit of the samples. Where stamps jump from one clock to
    another, those of the clock that most samples have. The same object where all are good.
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
    """Indices of the samples of the clock that most of them have, with ascending stamps (n,) ns."""
    codes = np.zeros(len(stamp), dtype=np.int64)
    follow(np.full(3, -1, dtype=np.int64), stamp, values, round(_RESTART_GAP * 1e9), round(_STEP_BACK * 1e9), codes)
    good = np.flatnonzero((codes == GOOD) | (codes == JUMPED))
    pieces = np.split(good, np.flatnonzero(codes[good] == JUMPED))
    clocks: list[list[np.ndarray]] = []
    for piece in (piece for piece in pieces if len(piece)):
        for clock in clocks:
            if 0 < (stamp[piece[0]] - stamp[clock[-1][-1]]) * 1e-9 <= LONGEST_PAUSE:
                clock.append(piece)
                break
        else:
            clocks.append([piece])
    return max((np.concatenate(clock) for clock in clocks), key=len, default=good)


def usable_fixes(fixes: Fixes) -> Fixes:
    """Those of `fixes` that have a place on earth, each once, in the order of their stamps: perhaps none.

    A fix that comes by more than LATEST sooner or later after its stamp than others do has a stamp of another clock.
    """
    index = np.flatnonzero(is_fix(fixes))
    if len(index):
        delay = (fixes.received[index] - fixes.stamp[index]) * 1e-9
        index = index[np.abs(delay - np.median(delay)) <= LATEST]
    _, first = np.unique(fixes.stamp[index], return_index=True)
    index = index[first]
    return fixes if len(index) == len(fixes) and (index[1:] > index[:-1]).all() else fixes.select(index)
