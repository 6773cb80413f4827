"""Selection of the sensor error model: the one that best predicts data to which it was not fitted.

The models are fitted to the first part of the recording and predict the rest, one interval ahead and further. For an
outage of h seconds the mean of the sensor error over the coming h seconds matters: times h it is the error of velocity
or heading. Differences of the log score between models are tested against their spread over blocks of time.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..sensor_errors.models import Model
from .autocorrelation import ljung_box
from .likelihood import Averages, StateSpace, estimate_levels, innovations, predicted_states, state_space

#: share of the recording to which the models are fitted
TRAINING = 0.6
#: outage lengths of interest, s
HORIZONS = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)
#: difference of scores, in standard errors, from which a model counts as better
_DECIDED = 2.0
_BLOCKS = 20  # number of blocks of the held-out data whose scores are compared
_LAGS = 20  # number of lags up to which the autocorrelation is tested


@dataclass(frozen=True)
class Prediction:
    """One model on the held-out data of one axis.

    score: mean log likelihood per interval, nats. one_step_rmse: unit of the sensor. horizons: s; horizon_rmse: RMS
    error of the predicted mean over the coming horizon, unit of the sensor. residual: (n,) normalized innovations.
    whiteness_p: Ljung-Box p-value of the residual over 20 lags. block_scores: (20,) nats per interval, by time.
    """

    name: str
    score: float
    one_step_rmse: float
    horizons: np.ndarray
    horizon_rmse: np.ndarray
    residual: np.ndarray
    whiteness_p: float
    block_scores: np.ndarray


@dataclass(frozen=True)
class Recommendation:
    """model: the simplest one that no other significantly beats. decided: whether all others are significantly worse.
    text: in words."""

    model: str
    decided: bool
    text: str


def split(data: Averages) -> tuple[Averages, int]:
    """The longest part and the index in it at which the held-out data begin."""
    labels, counts = np.unique(data.part, return_counts=True)
    z = data.z[data.part == labels[np.argmax(counts)]]
    return Averages(z, np.zeros(len(z), int), data.interval), int(TRAINING * len(z))


def predict(data: Averages, start: int, name: str, model: Model | None, noise_density: float) -> Prediction:
    """Run the filter of `model` over `data` (one part) and evaluate its predictions from index `start` on."""
    space = state_space(model, noise_density, data.interval)
    level, _ = estimate_levels(data.slice(0, start), space)
    error, variance = innovations(data, space, level)
    error, variance = error[start:], variance[start:]
    present = np.isfinite(error)
    scores = -0.5 * (np.log(2 * math.pi * variance[present]) + error[present] ** 2 / variance[present])
    residual = error[present] / np.sqrt(variance[present])
    horizons, rmse = _horizon_errors(data, start, space, level)
    return Prediction(name, float(scores.mean()), float(np.sqrt(np.mean(error[present] ** 2))), horizons, rmse,
                      residual, ljung_box(residual, _LAGS),
                      np.array([block.mean() for block in np.array_split(scores, _BLOCKS)]))


def _horizon_errors(data, start, space: StateSpace, level):
    states = predicted_states(data, space, level)
    steps = np.array([round(h / data.interval) for h in HORIZONS])
    steps = np.unique(steps[(steps >= 1) & (steps <= (len(data.z) - start) // 4)])
    present = np.isfinite(data.z)
    total = np.concatenate([[0.0], np.cumsum(np.where(present, data.z - level[0], 0.0))])
    count = np.concatenate([[0], np.cumsum(present)])
    rmse = []
    for h in steps:
        origins = np.arange(start - 1, len(data.z) - h)
        whole = count[origins + 1 + h] - count[origins + 1] == h
        actual = (total[origins + 1 + h] - total[origins + 1]) / h
        error = (actual - states[origins] @ _mean_output(space, h))[whole]
        rmse.append(math.sqrt(np.mean(error**2)) if len(error) else math.nan)
    return steps * data.interval, np.array(rmse)


def _mean_output(space: StateSpace, h: int):
    """Row that maps a predicted state to the mean output over h intervals, the first being its own."""
    row, total = space.c.copy(), np.zeros_like(space.c)
    for _ in range(h):
        total += row
        row = row @ space.a
    return total / h


def recommend(predictions: list[Prediction], significant: bool) -> Recommendation:
    """The simplest model that the best one does not significantly beat. predictions: simplest first.

    significant: whether the recording shows a slow error at all.
    """
    best = max(predictions, key=lambda p: p.score)
    equal = [p for p in predictions if not _beats(best, p)]
    model = equal[0].name
    others = tuple(p.name for p in equal[1:])
    if not significant:
        return Recommendation(model, False, 'no slow error is seen beside the white noise: '
                              'the data cannot decide between the models')
    if not others:
        return Recommendation(model, True, f'{_words(model)} predicts better than the others')
    return Recommendation(model, False, f'the data cannot decide between {_words(model)} and '
                          f'{" and ".join(map(_words, others))}; {_words(model)} is the simplest of them')


def smallest_unbeaten(predictions: list[Prediction]) -> int:
    """Index of the first of `predictions`, simplest first, that the best one does not significantly beat."""
    best = max(predictions, key=lambda p: p.score)
    return next(i for i, p in enumerate(predictions) if not _beats(best, p))


def overall(by_axis: list[list[Prediction]]) -> str:
    """One model for all axes: the simplest that no other beats on all axes together. by_axis: the same models for each.
    """
    pooled = [_pooled([axis[i] for axis in by_axis]) for i in range(len(by_axis[0]))]
    return pooled[smallest_unbeaten(pooled)].name


def _pooled(predictions):
    """The predictions for several axes as one, with the blocks of all."""
    blocks = np.concatenate([p.block_scores for p in predictions])
    residual = np.concatenate([p.residual for p in predictions])
    return replace(predictions[0], score=float(blocks.mean()), block_scores=blocks, residual=residual)


def _beats(best: Prediction, other: Prediction) -> bool:
    """Whether the mean difference of the scores is significantly above zero, and at least a nat in total.

    Blocks of time vary independently.
    """
    difference = best.block_scores - other.block_scores
    if difference.mean() * len(best.residual) < 1:
        return False
    return difference.mean() > _DECIDED * difference.std(ddof=1) / math.sqrt(len(difference))


def _words(name: str) -> str:
    return {'random_walk': 'random walk', 'gauss_markov': 'Gauss-Markov'}.get(name, name)
