"""What a fit takes for exact: an antenna ahead of where the params file has it is, to who drives, as an offset of the
clocks, by the arm over the speed; at walking speed some decimetres are tenths of a second. A fit of one of them holds
the other, whose own uncertainty is not in the information of that fit.
"""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..configuration.offset import Offset
from ..effects.registry import EFFECTS
from .fit import Model, scores
from .problem import Unknown
from .tracing import effect_unknowns

#: effects that go together, and those of them of which the track knows how far they may be from the params file; a
#: receiver that smooths is accounted for where the track cannot tell it from an offset (`Offset.undecided`)
TOGETHER = 'gnss_time_offset', 'gnss_lever_arm', 'gnss_lag'
HELD = 'gnss_time_offset', 'gnss_lever_arm'


def of_what_is_held(model: Model, track: Offset | None, given: Mapping) -> np.ndarray:
    """What the standard deviations of `model` lack, (p,): by how much its time offset, arm and smoothing are off where
    those of HELD that are not in it are not as in the parameters `given`. Zero for all other unknowns.

    track: time offset, arm and smoothing as the recordings show them without a filter, each with the others unknown. So
    it is no more than what a value of `model` is from that of the track beyond the latter's own sigma.
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
    # differences over that size: at walking speed a standstill that is seen or not makes steps in smaller ones
    unknowns, sizes = [replace(u, step=size) for u, size in held], np.array([size for _, size in held])
    _, other = scores(model.moved(), unknowns, np.zeros(len(unknowns)), model.residual, quick=True)
    moves = model.covariance @ model.scores.information(model.problem.mask, other)  # of each by one unit of those held
    for i in own:
        further[i] = min(float(np.linalg.norm(moves[i] * sizes)), _apart(model.unknowns[i], model.x[i], track, given))
    return further


def _apart(unknown: Unknown, x: float, track: Offset | None, given: Mapping) -> float:
    """By how much `x` contradicts what the track shows of `unknown`, beyond the track's sigma."""
    if track is None:
        return math.inf
    value, sigma = _shown(unknown, track, given)
    return math.sqrt(max((x - value) ** 2 - sigma**2, 0.0))


def _shown(unknown: Unknown, track: Offset, given: Mapping) -> tuple[float, float]:
    """What the track shows of `unknown`, of TOGETHER, beyond what is given, and its sigma."""
    if unknown.effect == 'gnss_time_offset':
        return track.lag - given['gnss.time_offset'], track.lag_sigma
    if unknown.effect == 'gnss_lag':
        return track.smoothing - given['gnss.lag_per_acceleration'], track.smoothing_sigma
    axis = 'xyz'.index(unknown.parameter)
    return float(track.arm[axis] - given['gnss.lever_arm'][axis]), float(track.arm_sigma[axis])


def _doubt(unknown: Unknown, track: Offset | None, given: Mapping) -> float:
    """How far `unknown`, of HELD, may be from where `given` has it: by what the track shows, and else by what is usual.
    An arm that is stated was measured."""
    if unknown.effect == 'gnss_lever_arm' and any(given['gnss.lever_arm']):
        return 0.0
    return unknown.usual if track is None else math.hypot(*_shown(unknown, track, given))
