"""Whether a receiver's driver puts the covariance of one fix beside the position of another.

A fix off the middle of its neighbours by e = p_k - (p_{k-1} + p_{k+1}) / 2 has moved, with a variance c, and is noisy,
with the variance q (R_k + (R_{k-1} + R_{k+1}) / 4): R as the receiver claims, q by how much it is wrong in all. The
likelihood of all e, with c and q as fit best, is that of the claims as they are, and of those some fixes later or
earlier. It is of Student's distribution, as fixes have outliers. Claims that do not change tell nothing.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.recordings.motion import positions, sigmas
from mems_ins_fusion.recordings.remarks import SURE
from mems_ins_fusion.samples import Fixes

#: fixes by which a covariance may be late or early: drivers that wait for the next message are wrong by one
_FARTHEST = 3
#: fixes that have all neighbours, at least
_FEWEST = 60
#: times the usual interval: fixes that are further apart are no neighbours
_GAP = 1.5
#: m, standard deviations of motion that are tried, from the noise of RTK to braking between fixes of 2 s
_MOTION = np.geomspace(1e-3, 5.0, 14)
#: factors on the claimed variance that are tried: receivers are off by four times in sigma
_FACTORS = 4.0 ** np.arange(-2, 3)
#: degrees of freedom of Student's distribution: tails of a receiver with outliers
_FREEDOM = 4.0
#: each fix is part of so many differences, so that the likelihood counts it as often
_COUNTED = 3.0


@dataclass(frozen=True)
class Misplaced:
    """A covariance that belongs to the fix `late` messages before it (after it where negative). gain: of log
    likelihood, against covariances that belong to their own fix."""

    late: int
    gain: float


def misplaced_covariances(fixes: Fixes) -> Misplaced | None:
    """What usable `fixes` in the order of their stamps show for certain; None where that is nothing."""
    shifts = np.arange(-_FARTHEST, _FARTHEST + 1)
    variance, step = sigmas(fixes) ** 2, np.diff(fixes.stamp)
    if len(fixes) < _FEWEST + 2 * _FARTHEST + 2:
        return None
    path = positions(fixes)
    off = (path[1:-1] - 0.5 * (path[:-2] + path[2:]))
    near = np.maximum(step[1:], step[:-1]) < _GAP * np.median(step)
    claimed = variance[1:-1] + 0.25 * (variance[:-2] + variance[2:])
    inside = np.arange(_FARTHEST, len(off) - _FARTHEST)
    # (shifts, n): with shift j a fix has the claims of the one j behind it, as where covariances are j late
    claims = claimed[inside + shifts[:, None]]
    used = near[inside] & np.isfinite(claims).all(axis=0)
    if np.count_nonzero(used) < _FEWEST:
        return None
    square = (off[inside][used] ** 2).sum(axis=1)
    likelihood = np.array([_likelihood(square, one[used]) for one in claims])
    best = int(np.argmax(likelihood))
    gain = float(likelihood[best] - likelihood[_FARTHEST]) / _COUNTED
    return Misplaced(int(shifts[best]), gain) if gain > 0.5 * SURE**2 else None


def _likelihood(square: np.ndarray, claimed: np.ndarray) -> float:
    """Largest logarithm of the likelihood of distances with these squares, m^2, by the variances `claimed`."""
    motion, factor = (one.ravel()[:, None] for one in np.meshgrid(_MOTION**2, _FACTORS))
    variance = motion + factor * claimed
    each = -np.log(variance) - 0.5 * (_FREEDOM + 2.0) * np.log1p(square / (_FREEDOM * variance))
    return float(each.sum(axis=1).max())
