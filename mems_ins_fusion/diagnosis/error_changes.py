"""Comparison of the errors before and after a change of the parameters: is the change proven, does it do harm?"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..evaluation.intervals import LEVEL, Difference, effective_number, log_ratios, paired, ratio
from ..evaluation.verdict import (
    BETTER,
    CANNOT_TELL,
    FELT,
    Change,
    Verdict,
    change_in_outages,
    change_with_fixes,
    decide,
    told,
)
from .held_out import CERTAIN, HeldOut
from .measured import MeasuredErrors, without_clock_of_truth

GROWN = 0.03  # smallest relative growth of an error that is certainly larger and counts (together with NOTICED)
NOTICED = 0.1  # m, smallest growth of an error that counts: a user does not notice less
LARGER = 1.1  # ratio of two means, or root mean squares, above which an error counts as larger, certain or not
#: p value below which an error that is larger by LARGER counts as larger if the effect is proven by its likelihood
LIKELY = 0.05
#: standard deviation of the natural logarithm of the largest error in one outage, about that of a Rayleigh
#: distribution, and of the ratio of two with a correlation of 0.5. Used if there are too few outages for a test
SCATTER = 0.5
#: number of standard deviations of the logarithm of a ratio that has a p value of about LIKELY
NOT_BY_CHANCE = 2.0
PLAINLY = 0.7  # ratio of two errors below which the error has become much smaller
#: smallest share of the fixes before at which a filter has to run with a correction: one that never starts has no
#: errors
RUNS = 0.5
COVERED = 0.9  # smallest share of the outages in which the 95 % ellipse has to contain the truth
#: largest decrease of this share that is tolerated if it was below COVERED before
LESS_HELD = 0.15
#: level of the two-sided interval whose lower end is a one-sided bound at LEVEL
ONE_SIDED = 2 * LEVEL - 1


def error_changes(before: MeasuredErrors, after: MeasuredErrors) -> list[Change]:
    """The changes on which the verdict is based: of the errors in the same outages, and with all fixes used if there is
    another truth than the fixes; all drives together."""
    before, after = without_clock_of_truth(before, after)
    found = []
    if before.independent:
        _, a, b = np.intersect1d(before.continuous.stamp, after.continuous.stamp, return_indices=True)
        if len(a):
            found.append(change_with_fixes(before.continuous.horizontal[a], after.continuous.horizontal[b]))
    for old, new in zip(before.outages, after.outages):
        _, a, b = np.intersect1d(old.begin, new.begin, return_indices=True)
        if len(a):
            found.append(change_in_outages(old.duration, old.max_error[a], new.max_error[b], old.apart))
    return found


def verdict_on(before: MeasuredErrors, after: MeasuredErrors, effects: bool = False,
               candidates: float = 1.0) -> Verdict:
    """Verdict on a change. It is not `better` if it does harm: to the ellipses, or to the errors of a single drive.
    candidates: as for `decide`."""
    verdict = decide(error_changes(before, after), candidates)
    against = larger_errors(compared(before, after), effects) if verdict.answer == BETTER else ''
    return replace(verdict, answer=CANNOT_TELL, why=(against,)) if against else verdict


def candidates(before: MeasuredErrors, tried: Sequence[MeasuredErrors]) -> float:
    """Number of independent filters that those `tried` are worth, by the changes of their errors in the same outages,
    those of the duration in which they have least in common."""
    found = []
    for k, old in enumerate(before.outages):
        begin = old.begin
        for one in tried:
            begin = np.intersect1d(begin, one.outages[k].begin)
        if len(begin) > 2:
            errors = np.array([one.outages[k].max_error[np.isin(one.outages[k].begin, begin)]
                               for one in (before, *tried)])
            found.append(effective_number(np.array([log_ratios(e, errors[0], FELT) for e in errors[1:]])))
    return max(found, default=max(len(tried), 1))


def compared(before: MeasuredErrors, after: MeasuredErrors) -> list[dict]:
    """Rows with the errors before and after: the mean square error with all fixes used; the mean and the root mean
    square of the largest error in outages, and how often the 95 % ellipse contained the truth.

    decides: false if the truth is the fixes that the filter was given: that error only shows how closely the filter
    follows them. apart: number of the `count` outages that do not overlap. drive: name of the drive, in the rows of
    single drives, which come last.
    """
    rows = _compared(*without_clock_of_truth(before, after))
    for name in before.drives:
        both = without_clock_of_truth(before.drives[name], after.drives[name])
        rows += [row | {'drive': name} for row in _compared(*both)]
    return rows


def _compared(before: MeasuredErrors, after: MeasuredErrors) -> list[dict]:
    rows = [_row('with all fixes used, mean square error in m^2', before.continuous.stamp, after.continuous.stamp,
                 before.continuous.horizontal**2, after.continuous.horizontal**2, power=2)
            | {'decides': before.independent}]
    for old, new in zip(before.outages, after.outages):
        row = _row(f'outages of {old.duration:g} s, mean largest error in m', old.begin, new.begin, old.max_error,
                   new.max_error, old.apart)
        if row['count']:
            row |= _tails(old.begin, new.begin, old.max_error, new.max_error, old.apart) | {
                'within_before': float(old.within.mean()), 'within_after': float(new.within.mean()),
                'apart': old.apart}
        rows.append(row | {'decides': True})
    return rows


def larger_errors(comparison: Sequence[dict], effects: bool = False, floor: float = COVERED) -> str:
    """In words, what becomes worse and by how much; empty if nothing does.

    - An error counts as larger if it is certainly larger, by GROWN and NOTICED; or if its mean or root mean square is
      larger by LARGER, certain or not. With `effects`, and in single drives, the latter needs a p value below LIKELY:
      the largest errors of a few dozen outages scatter by more, and the effect is proven by the likelihood of held-out
      data, or by all drives together.
    - If the ellipse contained the truth in COVERED of the outages, it has to contain it in `floor` of them, with one
      outage less tolerated. If it did not, the share must not decrease by more than LESS_HELD, or it still has to be
      `floor`.
    """
    for row in comparison:
        if row.get('kept', 1.0) < RUNS:
            return f"the filter runs in {100 * row['kept']:.0f} % only of what it did before: {row['what']}"
        if not (row.get('before') and row.get('after') and row['decides']):
            continue
        squared = 'mean square' in row['what']
        tolerant = effects or 'drive' in row
        where = f"in {row['drive']} " if 'drive' in row else ''
        pairs = [(row['before'], row['after'], row.get('p')),
                 (row.get('rms_before', 0.0), row.get('rms_after', 0.0), row.get('rms_p'))]
        for i, (old, new, p) in enumerate(pairs):
            old, new = (np.sqrt(old), np.sqrt(new)) if squared else (old, new)
            larger = new > LARGER * old + NOTICED
            if tolerant and larger:
                chance = np.exp(NOT_BY_CHANCE * SCATTER / np.sqrt(row.get('apart', row['count'])))
                larger = p < LIKELY if p is not None else new > chance * old + NOTICED
            certain = i == 0 and p is not None and p < CERTAIN
            if larger or certain and new > (1 + GROWN) * old + NOTICED:
                which = 'root mean square of the ' if i else ''
                return (f"the error grows: {where}{which}{row['what']}, {_plain(old, squared)} before, "
                        f'{_plain(new, squared)} after')
        held, holds = row.get('within_before'), row.get('within_after')
        if held is not None and holds < (floor - 1.0 / row['apart'] if held >= COVERED
                                         else min(held - max(LESS_HELD, 1.0 / row['apart']), floor)):
            which = row['what'].split(',')[0]
            return (f'{where}{which}: the 95 % ellipse held the truth in {100 * held:.0f} % before, '
                    f'in {100 * holds:.0f} % after')
    return ''


def _plain(value: float, squared: bool) -> str:
    return f'{value**2 if squared else value:.3g}'


def gain_proven(before: MeasuredErrors, after: MeasuredErrors) -> bool:
    """Whether noise levels or settings are proven by data that they were not chosen with. before: the same filter
    without them.

    They are if errors are certainly smaller; or if predictions are certainly better (`predicted`, which depends on the
    sigmas, too) and no error grows.
    """
    if verdict_on(before, after).answer == BETTER:
        return True
    gain = predicted(before, after)
    return gain is not None and gain.interval(ONE_SIDED)[0] > 0.0 and not objection_to_errors(compared(before, after))


def predicts_worse(before: MeasuredErrors, after: MeasuredErrors) -> bool:
    """Whether predictions are certainly worse."""
    gain = predicted(before, after)
    return gain is not None and gain.interval(ONE_SIDED)[1] < 0.0


def predicted(before: MeasuredErrors, after: MeasuredErrors) -> Difference | None:
    """Gain of predictions in log likelihood, the measure by which noise levels are chosen: the mean over the prediction
    horizons, all with the same weight. None if there are too few predictions, or no difference.

    The horizons share one drive, so their errors may be fully correlated. The sigma of the mean is therefore the mean
    of the sigmas, and the relative error of the sigma, 1 / sqrt(2 (count - 1)), the mean of the relative errors
    weighted by sigma: both are upper bounds.
    """
    apart = [np.inf, *(o.apart for o in (before.without_offset or before).outages if len(o.begin))]
    scores, found = (before.scores(), after.scores()), []
    if len(scores[0]) != len(scores[1]):  # one of the filters never runs for so long
        return None
    for (old, was), (new, now), count in zip(*scores, apart):
        _, a, b = np.intersect1d(old, new, return_indices=True)
        found.append(paired(now[b], was[a], count))
    found = [one for one in found if one is not None]
    mean, sigma, count = np.array([(one.mean, one.sigma, one.count) for one in found]).reshape(-1, 3).T
    if not sigma.any():
        return None
    together = 1.0 + (sigma.sum() / (sigma / np.sqrt(count - 1.0)).sum()) ** 2
    return Difference(float(mean.mean()), float(sigma.mean()), float(together))


def objection(proof: HeldOut, comparison: Sequence[dict]) -> str:
    """In words, what speaks against an effect: no gain of likelihood, or an error that grows. Empty if nothing does.

    comparison: errors without the effect and with it, on parts of the data that it was not fitted to. No objection are:
    - a gain of likelihood that is not certain, if an error becomes certainly and much smaller;
    - an error that stays the same, if the ellipses contain it more often: withheld fixes have correlated errors, too,
      so errors against them do not become smaller by modelling these;
    - ellipses that contain the truth less often, if the error is much smaller or the effect is certain: other errors
      show only now, and the noise levels, which determine the ellipses, are chosen at the end.
    """
    if not proof.stands:
        return 'not there without the one part of the recording or the other'
    change = overall_ratio(comparison)
    settled = 0.0 < change <= PLAINLY or proof.helps and proof.p < CERTAIN
    worse = larger_errors(comparison, proof.helps, 0.0 if settled else COVERED)
    if worse:
        return worse
    for name, (gain, p) in proof.drives.items():
        if p < CERTAIN:
            return f'{name} speaks against it (log likelihood {gain:+.1f} there, p {p:.2g})'
    shrinks = any(row.get('p', 1.0) < CERTAIN and row['after'] < PLAINLY * row['before']
                  for row in rows_of_all_drives(comparison))
    if not (proof.helps or (proof.gain > 0 and shrinks)):
        what = 'too small a gain' if proof.gain > 0 else 'no gain'
        return f'{what} on data it was not fitted to (log likelihood {proof.gain:+.1f}, p {proof.p:.2g})'
    return _larger(comparison, settled)


def _larger(comparison: Sequence[dict], settled: bool = False) -> str:
    """In words, that errors are larger on the whole; empty if they are not.

    settled: the change is certain by other proofs. Then errors may be larger by LARGER, as those of a few dozen outages
    scatter by as much.
    """
    change = overall_ratio(comparison)
    if change <= 1 + GROWN or (change <= LARGER and (settled or ellipses_better(rows_of_all_drives(comparison)))):
        return ''
    return f'the error does not shrink: all in all it is {change:.2f} times that before'


def objection_to_errors(comparison: Sequence[dict]) -> str:
    """In words, what the errors say against a change that is proven otherwise (`objection`, `gain_proven`): that they
    grow. Empty if they do not.

    They need not become smaller. The truth is usually the withheld fixes, and these have the same time offset and lever
    arm as the fixes that are used.
    """
    plainly = 0.0 < overall_ratio(comparison) <= PLAINLY
    floor = COVERED - LESS_HELD if plainly else COVERED
    return larger_errors(comparison, effects=True, floor=floor) or _larger(comparison)


def ellipses_better(rows: Sequence[dict]) -> bool:
    """Whether ellipses that contained the truth too seldom contain it in two more of the outages (counted by those that
    do not overlap)."""
    return any(row['within_before'] < COVERED and row['within_after'] >= row['within_before'] + 2 / row['apart']
               for row in rows if 'within_before' in row)


def overall_ratio(comparison: Sequence[dict]) -> float:
    """Ratio of the errors after to those before: the geometric mean of all rows that decide, 0 without any. Rows with
    too few outages for a test count only if all rows have too few: one of three outages would decide there."""
    rows = rows_of_all_drives(comparison)
    ratios = [row['after'] / row['before'] for row in [row for row in rows if row.get('p') is not None] or rows]
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 0.0


def rows_of_all_drives(comparison: Sequence[dict]) -> list[dict]:
    """The rows of all drives together that decide and have errors."""
    return [row for row in comparison if row['decides'] and row.get('before') and row.get('after')
            and 'drive' not in row]


def _row(what: str, stamp, new_stamp, old, new, apart: float = np.inf, power: int = 1) -> dict:
    """Means before and after over the epochs of both (kept: their part of those before), with the 95 % interval of the
    difference, given the mean before, if it can be told. power: old and new are errors in m to this power."""
    _, a, b = np.intersect1d(stamp, new_stamp, return_indices=True)
    row = {'what': what, 'count': len(a), 'kept': len(a) / len(stamp) if len(stamp) else 1.0}
    if not len(a):
        return row
    old, new = old[a], new[b]
    row |= {'before': float(old.mean()), 'after': float(new.mean())}
    found = ratio(new, old, FELT**power, apart)
    if found is not None:
        row |= {'difference': row['after'] - row['before'], 'p': found.p}
        interval = told(*found.interval(), row['before'], row['after'], power)
        if interval is not None:
            row |= dict(zip(('low', 'high'), interval))
    return row


def _tails(stamp, new_stamp, old, new, apart: float) -> dict:
    """Root mean squares before and after, and p that they are the same."""
    row = _row('', stamp, new_stamp, old**2, new**2, apart, 2)
    return {'rms_before': row['before']**0.5, 'rms_after': row['after']**0.5} | (
        {'rms_p': row['p']} if 'p' in row else {})
