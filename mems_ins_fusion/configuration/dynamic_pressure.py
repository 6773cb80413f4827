"""Which share of the dynamic pressure a barometer measures: its heights beside those of the fixes. No IMU, no filter.

height by pressure - height of the fix = weather - share v^2 / (2 g). The weather and the slow errors of a receiver are
taken as constant in each stretch of the drive, so only changes of the speed within one count. The speed between two
fixes has their noise, with which least squares would find too small a share. So the speed some fixes before and after
takes its place on the left of the normal equation, as its noise is another (instrumental variables, P. G. Wright,
1928). Sigma by the jackknife over the stretches.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.regression import blocks, jackknife
from mems_ins_fusion.filter.measurements.position import has_altitude
from mems_ins_fusion.filter.measurements.pressure import height_of, is_air
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.recordings.motion import positions
from mems_ins_fusion.samples import Fixes, Pressures, in_time_order

#: fixes, and messages of the barometer, at least: a minute of one each second, six stretches for the jackknife
_FEWEST = 60
#: s between two fixes that show a speed, at most: over T at an acceleration a the mean square of the speed is larger
#: than the square of its mean by (a T)^2 / 12, 4 cm of height for 1 m/s^2
_LONGEST = 3.0
#: steps from fix to fix before and after, from which a speed is taken as the instrument: the next ones share a fix, and
#: so its noise
_APART = 2
#: part of the dynamic pressure; a sigma is at least this: 0.2 m/s of wind along the road at 15 m/s (2 w / v), beyond
#: what both directions of driving take out
_FLOOR = 0.03


@dataclass(frozen=True)
class DynamicPressure:
    """share of the dynamic pressure that is measured in addition, and its sigma."""

    share: float
    sigma: float


def estimate_dynamic_pressure(pressures: Pressures, fixes: Fixes) -> DynamicPressure | None:
    """What `pressures` (Pa) and usable `fixes` in the order of their stamps show; None with too few of them."""
    good = in_time_order(pressures.stamp, is_air(pressures.pressure))
    if len(good) < _FEWEST or len(fixes) < _FEWEST:
        return None
    time, at = ((samples - fixes.stamp[0]) * 1e-9 for samples in (pressures.stamp[good], fixes.stamp))
    step, moved = np.diff(at), np.diff(positions(fixes)[:, :2], axis=0)
    shown = (step > 0.0) & (step < _LONGEST) & (at[:-1] > time[0]) & (at[1:] < time[-1])
    if np.count_nonzero(shown) < _FEWEST or not has_altitude(fixes).any():
        return None
    flow = np.square(moved / np.maximum(step, 1e-3)[:, None]).sum(axis=1)[shown] / (2.0 * STANDARD_GRAVITY)
    middle = 0.5 * (at[1:] + at[:-1])[shown]
    higher = np.interp(middle, time, height_of(pressures.pressure[good])) - (
        0.5 * (fixes.height[1:] + fixes.height[:-1]))[shown]
    stretch = blocks(middle)
    ends = slice(_APART, -_APART)
    beside = 0.5 * (flow[2 * _APART:] + flow[:-2 * _APART])
    columns = np.column_stack([flow[ends], higher[ends], beside])
    number = np.unique(stretch[ends], return_inverse=True)[1]
    count = np.bincount(number)
    columns -= np.column_stack([np.bincount(number, column) / count for column in columns.T])[number]
    by_flow, by_height = (np.bincount(number, columns[:, 2] * columns[:, k]) for k in (0, 1))
    left_out = -(by_height.sum() - by_height) / np.maximum(by_flow.sum() - by_flow, 1e-9)
    sigma = jackknife(left_out, np.maximum(by_flow, 0.0))
    return DynamicPressure(float(-by_height.sum() / max(by_flow.sum(), 1e-9)), math.hypot(float(sigma), _FLOOR))
