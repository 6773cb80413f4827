"""Whether errors before and after differ, and whether a change is proven by them."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..evaluation.intervals import LEVEL, Difference, paired
from ..evaluation.verdict import BETTER, CANNOT_TELL, Change, Verdict, change_in_outages, change_with_fixes, decide
from .held_out import CERTAIN, HeldOut
from .measured import Measured, fairly

#: share by which an error has to be larger, beside NOTICED, to count as larger where it is so for certain
GROWN = 0.03
#: m; an error that grows by less nobody notices
NOTICED = 0.1
#: factor by which a mean or a root mean square is larger that counts as larger, certain or not
LARGER = 1.1
#: probability by chance, below which an error that is larger by LARGER counts with a proven effect, too
LIKELY = 0.05
#: standard deviation of the natural logarithm of one outage's largest error: about that of a Rayleigh distribution; and
#: of the ratio of two that go together by half. Where outages are too few for a test it tells what may be chance
SCATTER = 0.5
#: standard deviations of the logarithm of a ratio beyond which it is so rarely by chance as LIKELY says
NOT_BY_CHANCE = 2.0
#: factor on an error, below which it has become smaller plainly
PLAINLY = 0.7
#: share of what the filter ran before that it has to run with a correction: one that never starts errs nowhere
RUNS = 0.5
#: share of the outages in which the 95 % ellipse has to hold the truth
COVERED = 0.9
#: by which share less of them an ellipse may hold it that held it in less than COVERED before
LESS_HELD = 0.15
#: of an interval whose lower end is passed by chance in 1 - LEVEL of the cases: that a gain is one is asked of one side
ONE_SIDED = 2 * LEVEL - 1


def changes(before: Measured, after: Measured) -> list[Change]:
    """What changes for who drives with it, for the verdict: errors in the same outages, and with fixes where the truth
    is more than these; of all drives together."""
    before, after = fairly(before, after)
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


def judged(before: Measured, after: Measured, effects: bool = False) -> Verdict:
    """Whether to use another configuration. It is no better, either, where an ellipse comes to lie, or where a single
    drive has the cost of what the others gain."""
    verdict = decide(changes(before, after))
    against = harm(compared(before, after), effects) if verdict.answer == BETTER else ''
    return replace(verdict, answer=CANNOT_TELL, why=(against,)) if against else verdict


def compared(before: Measured, after: Measured) -> list[dict]:
    """Whether the errors differ, by what is measured: mean, root mean square (for the tails), and how often the 95 %
    ellipse held the truth; mean square with the fixes used, mean of the largest error in outages.

    decides: not where the truth is the fixes that the filter was given, which only shows how closely it follows them.
    apart: how many of `count` outages do not overlap. drive: its name in the rows of each of several drives, which come
    last; else there is none.
    """
    rows = _compared(*fairly(before, after))
    for name in before.drives:
        both = fairly(before.drives[name], after.drives[name])
        rows += [row | {'drive': name} for row in _compared(*both)]
    return rows


def _compared(before: Measured, after: Measured) -> list[dict]:
    rows = [_row('with all fixes used, mean square error in m^2', before.continuous.stamp, after.continuous.stamp,
                 before.continuous.horizontal**2, after.continuous.horizontal**2)
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


def harm(comparison: Sequence[dict], effects: bool = False, floor: float = COVERED) -> str:
    """What becomes worse, and by how much; empty where nothing does.

    An error grows where it is larger for certain and noticeably (GROWN, NOTICED), or where its mean or its root mean
    square is larger by LARGER, certain or not; effects: if that is LIKELY, as the largest errors of a few dozen
    outages scatter by more and the likelihood of held-out data has proven the effect already; so, too, in single
    drives, as all together have to be better. An ellipse that held the truth in COVERED has to hold it in `floor`, or
    one outage less, of those that do not overlap; one that did not must not hold it in LESS_HELD less, unless it holds
    it in `floor` still.
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


def gain_proven(before: Measured, after: Measured) -> bool:
    """Whether noise levels or settings are proven by data that did not choose them. before: the same filter without.

    Errors are smaller for certain; or predictions are better for certain (`predicted`), which counts sigmas that come
    to be honest as well, and no error grows.
    """
    if judged(before, after).answer == BETTER:
        return True
    gain = predicted(before, after)
    return gain is not None and gain.interval(ONE_SIDED)[0] > 0.0 and not unproven(compared(before, after))


def predicts_worse(before: Measured, after: Measured) -> bool:
    """Whether predictions are worse for certain."""
    gain = predicted(before, after)
    return gain is not None and gain.interval(ONE_SIDED)[1] < 0.0


def predicted(before: Measured, after: Measured) -> Difference | None:
    """By how much predictions are better, in log likelihood: what noise levels are chosen by, the mean over the
    horizons, each with one vote; None where there are too few to say, or where they are the same.

    The horizons see the same drive, so that their errors may go together, and the errors of their sigmas: the sigma is
    the mean of theirs, and its relative error 1 / sqrt(2 (count - 1)) the mean of theirs by sigma. Neither can be
    larger.
    """
    apart = [np.inf, *(o.apart for o in (before.timeless or before).outages if len(o.begin))]
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
    """What speaks against an effect, empty where nothing does: no gain of likelihood, or an error that grows.

    comparison: errors with the effect and without, of parts that it was not fitted to. A likelihood that gains, but
    not for certain, is no objection where an error shrinks for certain and plainly. Nor is an error that is the same,
    where the ellipses come to hold it: errors that last are in the withheld fixes, too, so these never favour who
    models them. Nor are ellipses that hold a far smaller error less often, or one with an effect that is certain: what
    else is wrong shows only now, and noise levels, which decide on ellipses, are chosen at the end.
    """
    if not proof.stands:
        return 'not there without the one part of the recording or the other'
    change = all_in_all(comparison)
    settled = 0.0 < change <= PLAINLY or proof.helps and proof.p < CERTAIN
    worse = harm(comparison, proof.helps, 0.0 if settled else COVERED)
    if worse:
        return worse
    for name, (gain, p) in proof.drives.items():
        if p < CERTAIN:
            return f'{name} speaks against it (log likelihood {gain:+.1f} there, p {p:.2g})'
    shrinks = any(row.get('p', 1.0) < CERTAIN and row['after'] < PLAINLY * row['before'] for row in of_all(comparison))
    if not (proof.helps or (proof.gain > 0 and shrinks)):
        what = 'too small a gain' if proof.gain > 0 else 'no gain'
        return f'{what} on data it was not fitted to (log likelihood {proof.gain:+.1f}, p {proof.p:.2g})'
    return _larger(comparison, settled)


def _larger(comparison: Sequence[dict], settled: bool = False) -> str:
    """An objection to errors that are larger all in all; empty where they are not.

    settled: what is new is certain, and errors of a few dozen outages scatter by as much as LARGER.
    """
    change = all_in_all(comparison)
    if change <= 1 + GROWN or (change <= LARGER and (settled or honest(of_all(comparison)))):
        return ''
    return f'the error does not shrink: all in all it is {change:.2f} times that before'


def unproven(comparison: Sequence[dict]) -> str:
    """What speaks against another configuration; empty where nothing does.

    What is new in it has been proven by the likelihood of held-out data already (`objection`, `gain_proven`), so
    errors must not grow. Whether they shrink the fixes that are the truth as a rule cannot say: who stamps them late,
    or stands elsewhere, has the withheld ones late and elsewhere, too.
    """
    plainly = 0.0 < all_in_all(comparison) <= PLAINLY
    return harm(comparison, effects=True, floor=COVERED - LESS_HELD if plainly else COVERED) or _larger(comparison)


def honest(rows: Sequence[dict]) -> bool:
    """Whether ellipses that did not hold the truth hold it more often, by two outages or more that do not overlap."""
    return any(row['within_before'] < COVERED and row['within_after'] >= row['within_before'] + 2 / row['apart']
               for row in rows if 'within_before' in row)


def all_in_all(comparison: Sequence[dict]) -> float:
    """Errors after over those before, the geometric mean of all rows that decide; 0 where nothing was measured. A row
    of too few outages for a test counts only where all are: of three, one decides."""
    rows = of_all(comparison)
    ratios = [row['after'] / row['before'] for row in [row for row in rows if row.get('p') is not None] or rows]
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 0.0


def of_all(comparison: Sequence[dict]) -> list[dict]:
    """The rows that decide and were measured, of all drives together."""
    return [row for row in comparison if row['decides'] and row.get('before') and row.get('after')
            and 'drive' not in row]


def _row(what: str, stamp, new_stamp, old, new, apart: float = np.inf) -> dict:
    """Means before and after over the epochs of both (kept: their part of those before), with the 95 % interval of the
    paired difference."""
    _, a, b = np.intersect1d(stamp, new_stamp, return_indices=True)
    row = {'what': what, 'count': len(a), 'kept': len(a) / len(stamp) if len(stamp) else 1.0}
    if not len(a):
        return row
    old, new = old[a], new[b]
    row |= {'before': float(old.mean()), 'after': float(new.mean())}
    difference = paired(new, old, apart)
    if difference is not None:
        row |= {'difference': difference.mean, 'low': difference.low, 'high': difference.high, 'p': difference.p}
    return row


def _tails(stamp, new_stamp, old, new, apart: float) -> dict:
    """Root mean squares before and after, and p that they are the same."""
    row = _row('', stamp, new_stamp, old**2, new**2, apart)
    return {'rms_before': row['before']**0.5, 'rms_after': row['after']**0.5} | (
        {'rms_p': row['p']} if 'p' in row else {})
