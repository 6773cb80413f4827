"""The sigmas of what a fit finds, with the uncertainty of what it takes for exact.

Along the track, an antenna that is further ahead than the params file says is the same as an offset of the clocks by
that distance over the speed: at walking speed, decimetres are tenths of a second. A fit of one of the two takes the
other for exact, whose uncertainty its sigma then lacks.
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

#: effects that shift fixes along the track, so that an error of one of them changes the estimates of the others
TOGETHER = 'gnss_time_offset', 'gnss_lever_arm', 'gnss_lag'
#: those of TOGETHER whose uncertainty counts where they are not fitted; that of a receiver that smooths is in the sigma
#: of the offset already, where the track cannot tell the two apart (`Offset.undecided`)
HELD = 'gnss_time_offset', 'gnss_lever_arm'
#: s; a receiver smooths over no longer
LONGEST_SMOOTHING = 10.0


def sigmas(model: Model, track: Offset | None, given: Mapping) -> np.ndarray:
    """Standard deviations of all that `model` has found, (p,): what decides whether it is there, and what is told.

    track, given: as of `of_what_is_held`.
    """
    receiver = [of_receiver(model, track) if u.effect == 'gnss_time_offset' and not u.noise else 0.0
                for u in model.unknowns]
    return np.hypot(np.hypot(model.sigma(), of_what_is_held(model, track, given)), receiver)


def of_receiver(model: Model, track: Offset | None) -> float:
    """What the sigma of a time offset lacks, s, as the receiver may smooth its positions: to who brakes or turns
    meanwhile that is a delay of its own. Its errors last for as long, unless they last for longer than a receiver's
    filter; and by so much `track` cannot tell the two apart, unless `model` has both."""
    lasting = [u.meant(x, 0.0)[0] for u, x in zip(model.unknowns, model.x) if u.name == 'gnss_coloured_noise.tau']
    smoothed = lasting[0] if lasting and lasting[0] < LONGEST_SMOOTHING else 0.0
    undecided = track.undecided if track is not None and 'gnss_lag' not in {u.effect for u in model.unknowns} else 0.0
    return math.hypot(SYSTEMATIC * smoothed, undecided, FLOOR)


def of_what_is_held(model: Model, track: Offset | None, given: Mapping) -> np.ndarray:
    """Standard deviations, (p,), to be added to those of `model`: the errors of its time offset, arm and smoothing
    where those of HELD that it does not fit are not as in the parameters `given`. Zero for all other unknowns.

    track: time offset, arm and smoothing as the recordings show them without a filter, each with the others unknown. An
    added sigma is thus at most the distance of a value of `model` from that of the track, beyond the track's sigma.
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
    # differences of that size: in smaller ones, at walking speed, one standstill more or less makes steps
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
