"""Does it help where it was not fitted? Parts of the recording held out in turn, and errors of position in all of them.

The filter always runs through the whole recording; an estimate uses the innovations of all parts but one and is judged
on that one.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from ..evaluation import metrics
from ..evaluation.bootstrap import paired
from ..evaluation.comparison import aiding_of, samples_to_keep, truth_of
from ..evaluation.metrics import Errors, position_errors
from ..evaluation.outages import Outages, outage_begins, run_outages
from ..evaluation.outages import summary as outage_summary
from ..filter.config import FilterConfig
from ..filter.replay import run
from ..samples import ImuSamples, Recording
from .residuals import Model, Problem, Residual

#: parts of the recording, each held out in turn; blocks of each part; a block is not shorter than this, s
PARTS, BLOCKS, SHORTEST_BLOCK = 4, 2, 30.0
#: a held-out gain counts when chance would give it this rarely: the tests that led to the effect were far stricter
SIGNIFICANCE = 0.2
#: what is new is supported by a part of the data where it is no chance at this level
SUPPORT = 0.95
#: an error is larger or smaller for certain when chance would give that this rarely
CERTAIN = 0.01


def parts(problem: Problem) -> list[np.ndarray]:
    """Masks of the fixes that count, by part: blocks of time in turns, so that all parts see all kinds of road."""
    stamp = problem.stamp[problem.mask]
    duration = (stamp[-1] - stamp[0]) * 1e-9
    length = max(duration / (PARTS * BLOCKS), min(SHORTEST_BLOCK, duration / PARTS)) + 1e-6
    part = part_of(problem.stamp, stamp[0], length)
    return [problem.mask & (part == k) for k in range(PARTS)]


def part_of(stamp: np.ndarray, origin: int, length: float) -> np.ndarray:
    """0 to PARTS - 1 for each stamp (ns), by blocks of `length` s from `origin` on."""
    return np.floor((stamp - origin) * 1e-9 / length).astype(np.int64) % PARTS


@dataclass(frozen=True)
class HeldOut:
    """Gain of log likelihood on fixes that the estimate did not see: total, and p of no gain by blocks of time.

    estimates: the unknowns by the part that was held out.
    """

    gain: float
    p: float
    estimates: list[np.ndarray]

    @property
    def helps(self) -> bool:
        return self.gain > 0 and self.p < SIGNIFICANCE


def held_out(longer: Model, shorter: Model, noise: int) -> HeldOut:
    """What `longer` explains more than `shorter` on data that neither was fitted to.

    Of both, the first `noise` unknowns are noise levels and stay as they are. What is judged is the whole procedure:
    where the other parts do not support what is new in `longer`, they would not have led to it, and the estimate is
    that of `shorter`.
    """
    problem = longer.problem
    place = {u.name: i for i, u in enumerate(longer.unknowns)}
    old = [place[u.name] for u in shorter.unknowns]
    new = sorted(set(place.values()) - set(old))
    found, without = [], []
    for part in parts(problem):
        mask = problem.mask & ~part
        x, covariance = longer.refitted(mask, noise)
        without.append(shorter.refitted(mask, noise)[0])
        if x[new] @ np.linalg.solve(covariance[np.ix_(new, new)], x[new]) < chi2.ppf(SUPPORT, len(new)):
            x[old], x[new] = without[-1], 0.0
        found.append(x)
    one, other = problem.residuals(longer.unknowns, found), problem.residuals(shorter.unknowns, without)
    gains = np.zeros(len(problem.stamp))
    for part, with_it, plain in zip(parts(problem), one, other):
        gains[part] = (with_it.log_likelihood() - plain.log_likelihood())[part]
    return HeldOut(float(gains.sum()), _p_of_no_gain(problem, gains), found)


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


def measure(problem: Problem, recording: Recording, imu: ImuSamples, models: Sequence[dict], durations,
            spacing: float) -> Measured:
    """Errors of a model with parameters `models`: one set, or one for each of `parts`, fitted to the others.

    recording: with all fixes, for the truth; imu: the samples that the filter gets.
    """
    first = int(problem.stamp[problem.mask][0])
    # by the fixes' own stamps, so that the same outages are compared whatever a model says of the clocks
    begins = outage_begins(first, problem.full.gnss, 0.0, spacing, min(durations, default=0.0))
    judged = parts(problem) if len(models) > 1 else [problem.mask]
    found = []
    for values, part in zip(models, judged):
        config = FilterConfig.from_parameters(values)
        truth, delay = truth_of(recording, values), round(values['gnss.time_offset'] * 1e9)
        keep = samples_to_keep(imu, truth.reference.stamp)
        result = run(config, imu, problem.full.gnss, aiding_of(recording), keep=keep)
        errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
        if recording.reference is None:
            errors = replace(errors, stamp=errors.stamp + delay)
        mine = begins
        if len(models) > 1:
            mine = begins[_in_mask(begins, problem, part)]
            errors = errors.select(_in_mask(errors.stamp, problem, part))
        errors = errors.select(errors.stamp >= first)
        outages = run_outages(config, imu, problem.full.gnss, truth, durations, mine - delay,
                              aiding_of(recording), keep) if durations else []
        found.append((errors, [replace(o, begin=o.begin + delay) for o in outages]))
    if len(found) == 1:
        return Measured(*found[0])
    return Measured(_joined_errors([errors for errors, _ in found]),
                    [_joined_outages(list(same)) for same in zip(*(outages for _, outages in found))])


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


def objection(proof: HeldOut, comparison: Sequence[dict]) -> str:
    """What speaks against an effect, empty where nothing does: no gain of likelihood, or errors that do not shrink.

    comparison: errors with the effect and without, of parts that it was not fitted to. An error is larger or smaller
    for certain at CERTAIN; all in all counts the mean of their logarithms. A likelihood that gains, but not for
    certain, is no objection where an error shrinks for certain.
    """
    rows = [row for row in comparison if row.get('before') and row.get('after')]
    certain = [row for row in rows if row.get('p', 1.0) < CERTAIN]
    for row in certain:
        if row['after'] > row['before']:
            return f"the error grows: {row['what']}, {row['before']:.3g} before, {row['after']:.3g} after"
    if not (proof.helps or (proof.gain > 0 and certain)):
        return f'no gain on data it was not fitted to (log likelihood {proof.gain:+.1f}, p {proof.p:.2g})'
    change = all_in_all(rows)
    return f'the error does not shrink: all in all it is {change:.2f} times that before' if change >= 1 else ''


def all_in_all(comparison: Sequence[dict]) -> float:
    """Errors after over those before, the geometric mean of all rows; 0 where nothing was measured."""
    ratios = [row['after'] / row['before'] for row in comparison if row.get('before') and row.get('after')]
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 0.0


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
