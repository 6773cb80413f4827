"""Sigmas of fitted parameters, including the uncertainty of parameters that the fit keeps constant.

Along the track, an error of the antenna's position is equivalent to a time offset of that distance divided by the
speed: at walking speed, decimetres correspond to tenths of a second. A fit of one of the two treats the other as exact,
so its own sigma is too small.
"""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..configuration.offset import FLOOR, Offset
from ..effects.registry import EFFECTS
from .estimate import SYSTEMATIC
from .fit import Model, scores
from .problem import Unknown
from .tracing import effect_unknowns

#: effects that shift fixes along the track: an error of one of them changes the estimates of the others
TOGETHER = 'gnss_time_offset', 'gnss_lever_arm', 'gnss_lag'
#: those of TOGETHER whose uncertainty is added if they are not fitted. That of the receiver's smoothing is already in
#: the sigma of the offset, if the track does not distinguish the two (`Offset.undecided`)
HELD = 'gnss_time_offset', 'gnss_lever_arm'
LONGEST_SMOOTHING = 10.0  # s, longest time over which a receiver smooths its positions


def sigmas(model: Model, track: Offset | None, given: Mapping) -> np.ndarray:
    """Standard deviations (p,) of the unknowns of `model`, for the decision on effects and for the report.

    track, given: as for `of_what_is_held`.
    """
    receiver = [of_receiver(model, track) if u.effect == 'gnss_time_offset' and not u.noise else 0.0
                for u in model.unknowns]
    return np.hypot(np.hypot(model.sigma(), of_what_is_held(model, track, given)), receiver)


def of_receiver(model: Model, track: Offset | None) -> float:
    """Standard deviation, s, to be added to that of a time offset, as a receiver may smooth its positions, which is a
    delay when the vehicle brakes or turns. It has two parts: a share of the correlation time of the fixes' errors,
    which is that of the smoothing unless it is longer than LONGEST_SMOOTHING; and what `track` does not distinguish,
    unless `model` contains both effects."""
    lasting = [u.meant(x, 0.0)[0] for u, x in zip(model.unknowns, model.x) if u.name == 'gnss_coloured_noise.tau']
    smoothed = lasting[0] if lasting and lasting[0] < LONGEST_SMOOTHING else 0.0
    undecided = track.undecided if track is not None and 'gnss_lag' not in {u.effect for u in model.unknowns} else 0.0
    return math.hypot(SYSTEMATIC * smoothed, undecided, FLOOR)


def of_what_is_held(model: Model, track: Offset | None, given: Mapping) -> np.ndarray:
    """Standard deviations (p,) to be added to those of `model`: the effect on its time offset, lever arm and smoothing
    of errors of those of HELD that it does not fit. Zero for all other unknowns.

    track: time offset, lever arm and smoothing that the recordings show without a filter, estimated together. An added
    sigma is therefore at most the difference between the value of `model` and that of the track, beyond its sigma.
    """
    further = np.zeros(len(model.unknowns))
    own = [i for i, u in enumerate(model.unknowns) if u.effect in TOGETHER and not u.noise]
    if not own:
        return further
    there = {u.name for u in model.unknowns}
    held = [(u, size) for name in HELD for u in effect_unknowns(EFFECTS[name], {}, model.problem.attitude)
            if u.name not in there and (size := _doubt(u, track, given)) > 0.0]
    if not held:
        return further
    # finite differences of that size: with smaller ones, at walking speed, single standstills cause steps
    unknowns, sizes = [replace(u, step=size) for u, size in held], np.array([size for _, size in held])
    _, other = scores(model.moved(), unknowns, np.zeros(len(unknowns)), model.residual, quick=True)
    moves = model.covariance @ model.scores.information(model.problem.mask, other)  # of each by one unit of those held
    for i in own:
        further[i] = min(float(np.linalg.norm(moves[i] * sizes)), _apart(model.unknowns[i], model.x[i], track, given))
    return further


def _apart(unknown: Unknown, x: float, track: Offset | None, given: Mapping) -> float:
    """Difference between `x` and the value of `unknown` from the track, beyond the track's sigma; inf without a
    track."""
    if track is None:
        return math.inf
    value, sigma = _shown(unknown, track, given)
    return math.sqrt(max((x - value) ** 2 - sigma**2, 0.0))


def _shown(unknown: Unknown, track: Offset, given: Mapping) -> tuple[float, float]:
    """Value of `unknown` (one of TOGETHER) from the track, relative to the given parameters, and its sigma."""
    if unknown.effect == 'gnss_time_offset':
        return track.lag - given['gnss.time_offset'], track.lag_sigma
    if unknown.effect == 'gnss_lag':
        return track.smoothing - given['gnss.lag_per_acceleration'], track.smoothing_sigma
    axis = 'xyz'.index(unknown.parameter)
    return float(track.arm[axis] - given['gnss.lever_arm'][axis]), float(track.arm_sigma[axis])


def _doubt(unknown: Unknown, track: Offset | None, given: Mapping) -> float:
    """Standard deviation of `unknown` (one of HELD) about its given value: from the track, or its usual size without
    one. A lever arm that is given was measured, to `gnss.lever_arm_sigma` forward and left."""
    if unknown.effect == 'gnss_lever_arm' and any(given['gnss.lever_arm']):
        return given['gnss.lever_arm_sigma'] if unknown.parameter in ('x', 'y') else 0.0
    return unknown.usual if track is None else math.hypot(*_shown(unknown, track, given))
