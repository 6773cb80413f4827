"""Position of a second antenna relative to the first, and time offset of its fixes, without IMU and without filter.

The difference of both fixes is the vector b between the antennas, turned with the vehicle, and the distance driven in
the time offset T: p2 - p1 = R(course) b - v T, which is linear in b and T. The course is that of the first antenna in
motion, from fixes that are not in the difference. At rest the difference is as long as b, whatever course and T are:
where fixes are much better than that, its length is known before the vehicle has moved.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.kinematics import fix_sigma
from mems_ins_fusion.configuration.regression import BLOCKS, jackknife, shares
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.recordings.motion import SLOWEST_COURSE, TIGHTEST_COURSE, robust_sigma
from mems_ins_fusion.samples import Fixes

#: s over which a course is computed: over longer times it is not that of the middle in bends
_CHORD = 3.0
#: shortest distance over which a course is computed, in standard deviations of a fix
_SHARP = 10.0
#: smallest number of fixes of both antennas in motion
_FEWEST = 40
#: standard deviations of a fix: an antenna that moves by less within a chord rests
_RESTING = 4.0
#: standard deviations of a difference at rest: a shorter one shows its noise, not its length
_LONG = 5.0
#: m, of a length: the phase centres of antennas differ by as much
_LEAST_SIGMA = 0.01
#: steps of Gauss-Newton with the length, which is not linear
_STEPS = 4


@dataclass(frozen=True)
class Baseline:
    """arm, arm_sigma: (3,) m, from the first antenna to the second, forward-left-up. late, late_sigma: s, by which the
    second one's stamps are late against the first one's."""

    arm: np.ndarray
    arm_sigma: np.ndarray
    late: float
    late_sigma: float


def estimate_baseline(first: Fixes, second: Fixes) -> Baseline | None:
    """Estimate from usable fixes of two receivers, in the order of their stamps; None with too little motion."""
    if len(first) < _FEWEST or len(second) < _FEWEST:
        return None
    datum = np.array([first.latitude[0], first.longitude[0], first.height[0]])
    both = first, second
    one, two = (np.column_stack(to_local(part.latitude, part.longitude, part.height, datum)) for part in both)
    at, time = ((part.stamp - first.stamp[0]) * 1e-9 for part in both)
    step = max(1, round(0.5 * _CHORD / float(np.median(np.diff(at)))))
    begin, middle, end = one[:-2 * step], slice(step, -step), one[2 * step:]
    length = at[2 * step:] - at[:-2 * step]
    way = (end - begin)[:, :2]
    speed = np.linalg.norm(way, axis=1) / length
    # a gap of the second one is not bridged
    gap = np.interp(at[middle], 0.5 * (time[1:] + time[:-1]), np.diff(time)) > 2.0 * np.median(np.diff(time))
    noise = fix_sigma(first, one[:, :2])
    bend = _angle_between((one[middle] - begin)[:, :2], (end - one[middle])[:, :2])
    good = ((speed > SLOWEST_COURSE) & (speed * length > _SHARP * noise) & (length < 2.0 * _CHORD) & ~gap
            & (0.5 * speed * length > TIGHTEST_COURSE * np.abs(bend))
            & (at[middle] > time[0]) & (at[middle] < time[-1]))
    resting = ~gap & (speed < SLOWEST_COURSE) & (speed * length < _RESTING * noise)
    if np.count_nonzero(good) < _FEWEST:
        return None
    there = np.column_stack([np.interp(at[middle][good], time, part) for part in two.T])
    difference = there - one[middle][good]
    way, length = way[good], length[good, None]
    velocity, forward = way / length, way / np.linalg.norm(way, axis=1, keepdims=True)
    left = np.column_stack([forward[:, 1], -forward[:, 0]])
    design = np.stack([forward, left, -velocity], axis=2)
    blocks = shares(len(forward))
    normal = np.array([np.einsum('nij,nik->jk', design[blocks == k], design[blocks == k]) for k in range(BLOCKS)])
    right = np.array([np.einsum('nij,ni->j', design[blocks == k], difference[blocks == k, :2]) for k in range(BLOCKS)])
    if np.linalg.matrix_rank(normal.sum(axis=0)) < 3:
        return None
    solution = np.linalg.solve(normal.sum(axis=0), right.sum(axis=0))
    try:
        left_out = np.linalg.solve(normal.sum(axis=0) - normal, (right.sum(axis=0) - right)[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return None
    known = _length(one[middle][resting], at[middle][resting], two, time)
    solution, sigma = _with_length(solution, jackknife(left_out), np.corrcoef(left_out.T), *known)
    up = np.array([-difference[blocks == k, 2].mean() for k in range(BLOCKS)])
    return Baseline(np.append(solution[:2], up.mean()), np.append(sigma[:2], up.std() / math.sqrt(BLOCKS - 1)),
                    float(solution[2]), float(sigma[2]))


def _length(one, at, two, time) -> tuple[float, float]:
    """Horizontal distance from the fixes `one` of an antenna at rest, at the times `at`, to the fixes `two` of the
    other at `time`, m, and its standard deviation: that of a single difference, as errors of receivers last; infinite
    where it does not show."""
    if len(one) < _FEWEST:
        return 0.0, math.inf
    there = np.column_stack([np.interp(at, time, part) for part in two[:, :2].T])
    apart = np.linalg.norm(there - one[:, :2], axis=1)
    length, sigma = float(np.median(apart)), robust_sigma(apart)
    return length, max(sigma, _LEAST_SIGMA) if length > _LONG * sigma else math.inf


def _with_length(solution, sigma, correlation, length, length_sigma) -> tuple[np.ndarray, np.ndarray]:
    """Forward, left and time offset, with their standard deviations, where the distance of the antennas is known."""
    covariance = correlation * np.outer(sigma, sigma)
    if not math.isfinite(length_sigma) or not np.isfinite(covariance).all():
        return solution, sigma
    found = solution
    for _ in range(_STEPS):
        size = max(float(np.hypot(*found[:2])), 1e-3)
        row = np.array([found[0] / size, found[1] / size, 0.0])
        gain = covariance @ row / (row @ covariance @ row + length_sigma**2)
        found = solution + gain * (length - size - row @ (solution - found))
    return found, np.sqrt(np.diag(covariance - np.outer(gain, row @ covariance)))


def _angle_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n,) rad, by which vectors `other` (n, 2) are turned against `one` (n, 2)."""
    return np.arctan2(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0], (one * other).sum(axis=1))
