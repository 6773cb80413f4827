"""Sigmas of fitted parameters, including the uncertainty of parameters that the fit keeps constant.

Along the track, an error of the antenna's position is equivalent to a time offset of that distance divided by the
speed: at walking speed, decimetres correspond to tenths of a second. A fit of one of the two treats the other as exact,
so its own sigma is too small.
"""
from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..configuration.offset import FLOOR, Offset
from ..effects.registry import EFFECTS
from .estimate import SYSTEMATIC
from .fit import FittedModel, Scores, fit, priors, scores
from .problem import Unknown
from .tracing import effect_unknowns

#: effects that shift fixes along the track: an error of one of them changes the estimates of the others
TOGETHER = 'gnss_time_offset', 'gnss_lever_arm', 'gnss_lag'
#: those of TOGETHER whose uncertainty is included if they are not fitted. That of the receiver's smoothing is already
#: in the sigma of the offset, if the track does not distinguish the two (`Offset.undecided`)
HELD = 'gnss_time_offset', 'gnss_lever_arm'
LONGEST_SMOOTHING = 10.0  # s, longest time over which a receiver smooths its positions
#: s, time constants of a receiver's smoothing that are tried beside none for the sigma of a time offset: navigation
#: filters of receivers follow within some tenths of a second to seconds. The delay grows with their square: 0.5 s are
#: decimetres for a car in town, hardly more than the scatter of its fixes, and each next one adds about as much
SMOOTHINGS = 0.5, 0.8, 1.1, 1.5, 2.0
#: difference of log likelihood to the best smoothing, from which on one is excluded, and each longer one: it would have
#: less than 1 % of the weight of the best
EXCLUDED = 5.0
REFITTED = 3  # number of iterations of a fit that starts near its maximum


def sigmas(model: FittedModel, track: Offset | None, given: Mapping) -> np.ndarray:
    """Standard deviations (p,) of the unknowns of `model`, for the decision on effects and for the report.

    track, given: as for `with_what_is_held`. What the track (`Offset.undecided`) and what the fit (`of_smoothing`)
    cannot tell from smoothing are added as squares. They are of one cause, so this is too much by up to a factor of 1.4
    where they agree; but smoothing has other forms than these fits know: with both, errors of offsets are 1.2 sigma
    (RMS) for receivers that smooth (measured when `of_smoothing` came), so less would be less honest.
    """
    receiver = [math.hypot(of_receiver(model, track), of_smoothing(model, given))
                if u.effect == 'gnss_time_offset' and not u.noise else 0.0 for u in model.unknowns]
    return np.hypot(with_what_is_held(model, track, given), receiver)


def of_receiver(model: FittedModel, track: Offset | None) -> float:
    """Standard deviation, s, to be added to that of a time offset, as a receiver may smooth its positions, which is a
    delay when the vehicle brakes or turns. It has two parts: a share of the correlation time of the fixes' errors,
    which is that of the smoothing unless it is longer than LONGEST_SMOOTHING; and what `track` does not distinguish,
    unless `model` contains both effects."""
    lasting = [u.meant(x, 0.0)[0] for u, x in zip(model.unknowns, model.x) if u.name == 'gnss_coloured_noise.tau']
    smoothed = lasting[0] if lasting and lasting[0] < LONGEST_SMOOTHING else 0.0
    undecided = track.undecided if track is not None and 'gnss_lag' not in {u.effect for u in model.unknowns} else 0.0
    return math.hypot(SYSTEMATIC * smoothed, undecided, FLOOR)


def of_smoothing(model: FittedModel, given: Mapping) -> float:
    """Standard deviation, s, to be added to that of the time offset of `model`, as the receiver may smooth its
    positions: root mean square change of the offset when all is fitted again with SMOOTHINGS, weighted by their
    likelihoods. Zero where the smoothing is in `model` or given.

    The information at no smoothing does not tell that: the delay grows with the square of the time constant, and the
    noise levels take the place of what is left.
    """
    if 'gnss_lag' in {u.effect for u in model.unknowns} or given['gnss.lag_per_acceleration']:
        return 0.0
    [lag] = effect_unknowns(EFFECTS['gnss_lag'], {}, model.problem.attitude)
    at = [u.name for u in model.unknowns].index('gnss_time_offset.time_offset')
    mask, x, changes = model.problem.mask, model.x, [0.0]
    likely = [model.likelihood(mask)]
    for tau in SMOOTHINGS:
        found = fit(model.problem.moved([lag], np.array([tau**2])), model.unknowns, x, REFITTED)
        x = found.x
        changes.append(float(x[at] - model.x[at]))
        likely.append(found.likelihood(mask))
        if likely[-1] < max(likely) - EXCLUDED:
            break
    weight = np.exp(np.array(likely) - max(likely))
    return math.sqrt(weight @ np.square(changes) / weight.sum())


def with_what_is_held(model: FittedModel, track: Offset | None, given: Mapping) -> np.ndarray:
    """Standard deviations (p,) of the unknowns of `model`; those of its time offset, lever arm and smoothing include
    that those of HELD that it does not fit may differ from `given`.

    Two bounds, of which the smaller counts. The fit: the marginal standard deviation if these were fitted as well,
    with their uncertainty beforehand as the prior, and by how much that would change the value. The track (time offset,
    lever arm and smoothing that the recordings show without a filter, estimated together): the difference from its
    value and its standard deviation.
    """
    sigma = model.sigma()
    own = [i for i, u in enumerate(model.unknowns) if u.effect in TOGETHER and not u.noise]
    if not own:
        return sigma
    there = {u.name for u in model.unknowns}
    held = [replace(u, step=size, prior=size) for name in HELD
            for u in effect_unknowns(EFFECTS[name], {}, model.problem.attitude)
            if u.name not in there and (size := _doubt(u, track, given)) > 0.0]
    if not held:
        return sigma
    # finite differences of the size of the prior: with smaller ones, at walking speed, single standstills cause steps
    _, other = scores(model.moved(), held, np.zeros(len(held)), model.residual, quick=True)
    joint = _joint(model, held, other)
    change = joint.covariance @ np.append(np.zeros(len(model.x)), other.gradient(model.problem.mask))
    marginal = np.hypot(joint.sigma(), change)
    for i in own:
        sigma[i] = max(sigma[i], min(marginal[i], _by_track(model.unknowns[i], model.x[i], track, given)))
    return sigma


def _joint(model: FittedModel, held: Sequence[Unknown], other: Scores) -> FittedModel:
    """`model` with the unknowns `held` at zero as well, whose scores are `other`."""
    unknowns, joined = [*model.unknowns, *held], model.scores.joined(other)
    _, prior = priors(unknowns)
    return replace(model, unknowns=unknowns, x=np.append(model.x, np.zeros(len(held))), scores=joined,
                   covariance=np.linalg.inv(joined.information(model.problem.mask) + np.diag(1 / prior**2)))


def _by_track(unknown: Unknown, x: float, track: Offset | None, given: Mapping) -> float:
    """Standard deviation of `x` by the value of `unknown` from the track; inf without a track."""
    if track is None:
        return math.inf
    value, sigma = _shown(unknown, track, given)
    return math.hypot(x - value, sigma)


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
