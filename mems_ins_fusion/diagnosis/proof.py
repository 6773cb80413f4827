"""Does it help where it was not fitted? Blocks of the recording in two folds, and errors of position in both.

The filter always runs through the whole recording; an estimate uses the innovations of one fold and is judged on the
other, and the other way round.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from ..evaluation import metrics
from ..evaluation.bootstrap import paired
from ..evaluation.comparison import truth_of
from ..evaluation.metrics import Errors, position_errors
from ..evaluation.outages import Outages, outage_begins, run_outages
from ..evaluation.outages import summary as outage_summary
from ..filter.fusion import FilterConfig, run
from ..samples import Recording
from .residuals import Problem, Residual, Unknown, fit

#: blocks of each fold; a block is not shorter than this, s
BLOCKS, SHORTEST_BLOCK = 4, 30.0
#: a held-out gain counts when chance would give it this rarely
SIGNIFICANCE = 0.05
#: iterations of a fit that starts at the estimate from all data
REFIT = 2


def folds(problem: Problem) -> list[np.ndarray]:
    """Two masks of the fixes that count: alternating blocks of time, so that both see all kinds of road."""
    stamp = problem.stamp[problem.mask]
    duration = (stamp[-1] - stamp[0]) * 1e-9
    length = max(duration / (2 * BLOCKS), min(SHORTEST_BLOCK, duration / 2)) + 1e-6
    odd = fold_of(problem.stamp, stamp[0], length)
    return [problem.mask & (odd == 0), problem.mask & (odd == 1)]


def fold_of(stamp: np.ndarray, origin: int, length: float) -> np.ndarray:
    """0 or 1 for each stamp (ns), by blocks of `length` s from `origin` on."""
    return np.floor((stamp - origin) * 1e-9 / length).astype(np.int64) % 2


@dataclass(frozen=True)
class HeldOut:
    """Gain of log likelihood on fixes that the estimate did not see: total, and p of no gain by blocks of time.

    estimates: the unknowns by the fold they were fitted on.
    """

    gain: float
    p: float
    estimates: list[np.ndarray]

    @property
    def helps(self) -> bool:
        return self.gain > 0 and self.p < SIGNIFICANCE


def held_out(problem: Problem, unknowns: Sequence[Unknown], x: np.ndarray, without: int) -> HeldOut:
    """What the unknowns behind the first `without` add on held-out data; both models are fitted to the other fold."""
    masks = folds(problem)
    gains, estimates = np.zeros(len(problem.stamp)), []
    for fold, other in ((masks[0], masks[1]), (masks[1], masks[0])):
        longer, _, with_effect, _ = fit(problem, unknowns, x, fold, REFIT)
        _, _, without_effect, _ = fit(problem, unknowns[:without], x[:without], fold, REFIT + 2)
        gains[other] = (with_effect.log_likelihood() - without_effect.log_likelihood())[other]
        estimates.append(longer)
    return HeldOut(float(gains.sum()), _p_of_no_gain(problem, gains), estimates)


def gain_of(problem: Problem, before: Residual, after: Residual) -> HeldOut:
    """What a model without unknowns of its own gains: nothing of it was fitted, so all data are held out."""
    gains = np.where(problem.mask, np.nan_to_num(after.log_likelihood() - before.log_likelihood()), 0.0)
    return HeldOut(float(gains.sum()), _p_of_no_gain(problem, gains), [])


def _p_of_no_gain(problem: Problem, gains: np.ndarray) -> float:
    """One-sided t test of the sums over blocks of SHORTEST_BLOCK."""
    block = ((problem.stamp - problem.stamp[0]) // round(SHORTEST_BLOCK * 1e9))[problem.mask]
    _, index = np.unique(block, return_inverse=True)
    sums = np.bincount(index, gains[problem.mask])
    if len(sums) < 3 or sums.std() == 0:
        return 1.0
    return float(student.sf(sums.mean() / (sums.std(ddof=1) / np.sqrt(len(sums))), len(sums) - 1))


@dataclass(frozen=True)
class Measured:
    """Position errors of one model: at the truth's epochs with the fixes used, and in outages."""

    continuous: Errors
    outages: list[Outages]

    def summary(self) -> dict:
        """The numbers for `report.json`."""
        return {'horizontal_rmse_m': metrics.rms(self.continuous.horizontal),
                'outages': [outage_summary(outages) for outages in self.outages]}


def measure(problem: Problem, recording: Recording, models: Sequence[dict], durations, spacing: float) -> Measured:
    """Errors of a model with parameters `models`: one set, or two, of which the second holds where fold 0 is.

    recording: with all fixes, for the truth. With two sets each error is one of a model fitted elsewhere.
    """
    masks = folds(problem)
    first = int(problem.stamp[problem.mask][0])
    # by the fixes' own stamps, so that the same outages are compared whatever a model says of the clocks
    begins = outage_begins(first, problem.full.gnss, 0.0, spacing, min(durations, default=0.0))
    parts = []
    for k, values in enumerate(models):
        config = FilterConfig.from_parameters(values)
        result = run(config, problem.full.imu, problem.full.gnss)
        truth, delay = truth_of(recording, values), round(values['gnss.time_offset'] * 1e9)
        errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
        if recording.reference is None:
            errors = replace(errors, stamp=errors.stamp + delay)
        outages = run_outages(config, problem.full.imu, problem.full.gnss, truth, durations, begins - delay) \
            if durations else []
        outages = [replace(o, begin=o.begin + delay) for o in outages]
        if len(models) == 2:  # this set was fitted on fold k: it is judged on the other
            errors = errors.select(_in_mask(errors.stamp, problem, masks[1 - k]))
            outages = [o.select(_in_mask(o.begin, problem, masks[1 - k])) for o in outages]
        else:
            errors = errors.select(errors.stamp >= first)
        parts.append((errors, outages))
    if len(parts) == 1:
        return Measured(*parts[0])
    return Measured(_joined_errors([errors for errors, _ in parts]),
                    [_joined_outages(list(pair)) for pair in zip(*(outages for _, outages in parts))])


def _in_mask(stamp: np.ndarray, problem: Problem, mask: np.ndarray) -> np.ndarray:
    """Which stamps (ns) lie in the blocks of `mask`: those whose latest fix does."""
    at = np.clip(np.searchsorted(problem.stamp, stamp, side='right') - 1, 0, len(mask) - 1)
    return mask[at]


def _joined_errors(parts: list[Errors]) -> Errors:
    order = np.argsort(np.concatenate([e.stamp for e in parts]), kind='stable')
    return Errors(**{name: np.concatenate([getattr(e, name) for e in parts])[order]
                     for name in Errors.__dataclass_fields__})


def _joined_outages(parts: list[Outages]) -> Outages:
    order = np.argsort(np.concatenate([o.begin for o in parts]), kind='stable')
    joined = {name: np.concatenate([getattr(o, name) for o in parts])[order]
              for name in ('begin', 'max_error', 'distance', 'within', 'growth', 'sigma')}
    errors = [e for o in parts for e in o.errors]
    return Outages(duration=parts[0].duration, time=parts[0].time, errors=[errors[i] for i in order], **joined)


def compared(before: Measured, after: Measured) -> list[dict]:
    """Whether the errors differ: mean square of the continuous error, mean of the largest error of the outages."""
    rows = [_row('with all fixes used, mean square error in m^2', before.continuous.stamp, after.continuous.stamp,
                 before.continuous.horizontal**2, after.continuous.horizontal**2)]
    for old, new in zip(before.outages, after.outages):
        rows.append(_row(f'outages of {old.duration:g} s, mean largest error in m', old.begin, new.begin, old.max_error,
                         new.max_error))
    return rows


def _row(what: str, stamp, new_stamp, old, new) -> dict:
    """Means before and after over the epochs of both, with the 95 % interval of the difference by block bootstrap."""
    _, a, b = np.intersect1d(stamp, new_stamp, return_indices=True)
    row = {'what': what, 'count': len(a)}
    if not len(a):
        return row
    old, new = old[a], new[b]
    row |= {'before': float(old.mean()), 'after': float(new.mean())}
    difference = paired(new, old)
    if difference is not None:
        row |= {'difference': difference.mean, 'low': difference.low, 'high': difference.high, 'p': difference.p}
    return row
