"""Does it help where it was not fitted? Parts of the data held out in turn, and errors of position in all of them.

Parts are blocks of time of each drive, or, of three drives and more, the drives. The filter always runs through whole
recordings; an estimate uses the innovations of all parts but one and is judged on that one.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from ..evaluation import metrics
from ..evaluation.bootstrap import paired
from ..evaluation.comparison import aiding_of, samples_to_keep, truth_of
from ..evaluation.metrics import Errors, Truth, position_errors
from ..evaluation.outages import Outages, outage_begins, outages_of
from ..evaluation.outages import summary as outage_summary
from ..filter.config import FilterConfig
from ..filter.replay import run, run_with_outages
from ..samples import ImuSamples, Recording
from .clock import GNSS, IMU, OWN, earlier, lateness_against
from .drives import Drives
from .fit import Model
from .problem import Problem, on_all_cores
from .residuals import Residual, tempered

#: parts of the recording, each held out in turn; blocks of each part; a block is not shorter than this, s
PARTS, BLOCKS, SHORTEST_BLOCK = 4, 2, 30.0
#: of so many drives and more, each is held out as a whole
FEWEST_DRIVES = 3
#: a held-out gain counts when chance would give it this rarely, and where it is so large (five sigma): in real cars
#: something small is always wrong, and what can bend most gains a little by it; a smaller one where it is CERTAIN
SIGNIFICANCE, CLEAR = 0.2, 12.5
#: what is new is supported by a part of the data where it is no chance at this level
SUPPORT = 0.95
#: an error is larger or smaller for certain when chance would give that this rarely
CERTAIN = 0.01
#: an error has grown noticeably beyond this part and this much, m; by this factor it has grown, certain or not
GROWN, NOTICED, LARGER = 0.03, 0.1, 1.1
#: such a growth is one with a proven effect, too, if chance gives it more rarely than this; where there are too few
#: outages to say, if it is larger than this part over the root of their number
LIKELY, SCATTER = 0.2, 0.5
#: errors that are this part of those before have shrunk plainly; noise levels alone are better from this part on
PLAINLY, BETTER = 0.7, 0.9
#: fewer outages do not prove noise levels
FEWEST_OUTAGES = 5
#: 95 % ellipses shall hold the truth in this part of the outages
COVERED, LESS_HELD = 0.9, 0.15
#: errors in outages count as they are up to so many sigma: who is in one wants to be told of the large ones
END_TAIL = 6.0
#: a predicted error smaller than this is none, m
SMALLEST_ERROR = 0.1


def parts(problem: Problem | Drives) -> list[np.ndarray]:
    """Masks of the fixes that count, by part: whole drives where there are enough; else parts of each."""
    if len(problem.each) < FEWEST_DRIVES:
        return [np.concatenate(same) for same in zip(*(_blocks(p) for p in problem.each))]
    return [np.concatenate([p.mask & (p is drive) for p in problem.each]) for drive in problem.each]


def _blocks(problem: Problem) -> list[np.ndarray]:
    """Parts of one drive: blocks of time in turns, so that all parts see all kinds of road."""
    stamp = problem.stamp[problem.mask]
    duration = (stamp[-1] - stamp[0]) * 1e-9
    length = max(duration / (PARTS * BLOCKS), min(SHORTEST_BLOCK, duration / PARTS)) + 1e-6
    part = part_of(problem.stamp, stamp[0], length)
    return [problem.mask & (part == k) for k in range(PARTS)]


def which_part(problem: Problem):
    """A function that tells the part, by its place in `parts`, of stamps (k,) ns."""
    masks = parts(problem)

    def of(stamp):
        found = np.full(len(stamp), -1)
        for k, mask in enumerate(masks):
            found[_in_mask(stamp, problem, mask)] = k
        return found
    return of


def part_of(stamp: np.ndarray, origin: int, length: float) -> np.ndarray:
    """0 to PARTS - 1 for each stamp (ns), by blocks of `length` s from `origin` on."""
    return np.floor((stamp - origin) * 1e-9 / length).astype(np.int64) % PARTS


@dataclass(frozen=True)
class HeldOut:
    """Gain of log likelihood on fixes that the estimate did not see: total, and p of no gain by blocks of time.

    estimates: the unknowns by the part that was held out. drives: gain and p of no loss, by the name of each of several
    drives.
    """

    gain: float
    p: float
    estimates: list[np.ndarray]
    drives: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def helps(self) -> bool:
        return self.gain > 0 and (self.p < CERTAIN or self.gain > CLEAR and self.p < SIGNIFICANCE)


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
        # a fix that one of them did not get to see says nothing
        gains[part] = np.nan_to_num((with_it.log_likelihood() - plain.log_likelihood())[part])
    return _of_gains(problem, gains, found)


def gain_of(problem: Problem, before: Residual, after: Residual) -> HeldOut:
    """What a model without unknowns of its own gains: nothing of it was fitted, so all data are held out. Of the fixes,
    as another mechanization measures other things beside them."""
    one, other = after.of_fixes.log_likelihood(), before.of_fixes.log_likelihood()
    gains = np.where(problem.mask, np.nan_to_num(one - other), 0.0)
    return _of_gains(problem, gains, [])


def _of_gains(problem: Problem | Drives, gains: np.ndarray, estimates: list[np.ndarray]) -> HeldOut:
    drives, first = {}, 0
    for drive in problem.each if len(problem.each) > 1 else ():
        own = gains[first:first + len(drive.stamp)]
        drives[drive.recording.name] = float(own.sum()), _p_of_no_gain(drive, -own)
        first += len(drive.stamp)
    return HeldOut(float(gains.sum()), _p_of_no_gain(problem, gains), estimates, drives)


def _p_of_no_gain(problem: Problem | Drives, gains: np.ndarray) -> float:
    """One-sided t test of the sums over blocks of SHORTEST_BLOCK."""
    block = ((problem.stamp - problem.stamp[0]) // round(SHORTEST_BLOCK * 1e9))[problem.mask]
    _, index = np.unique(block, return_inverse=True)
    sums = np.bincount(index, gains[problem.mask])
    if len(sums) < 3 or sums.std() == 0:
        return 1.0
    return float(student.sf(sums.mean() / (sums.std(ddof=1) / np.sqrt(len(sums))), len(sums) - 1))


@dataclass(frozen=True)
class Measured:
    """Errors of one model: at the truth's epochs with the fixes used, in outages, and the innovations of its filter.

    independent: whether the truth is more than the fixes that the filter was given. stamp, likelihood (k,): of the
    fixes that count, ns, and how well each was predicted. drives: those of each of several drives, by name. late: s,
    by which the truth's clock is later than that of the tracks, as far as it is not known; timeless: the same with that
    taken out, where the truth may have a clock of its own.
    """

    continuous: Errors
    outages: list[Outages]
    independent: bool
    stamp: np.ndarray
    likelihood: np.ndarray
    drives: dict[str, Measured] = field(default_factory=dict)
    late: float = 0.0
    timeless: Measured | None = None

    def select(self, epochs: Callable, fixes: np.ndarray) -> Measured:
        """With those epochs of the truth for which `epochs` says so of their stamps, and those `fixes` (k,)."""
        return replace(self, continuous=self.continuous.select(epochs(self.continuous.stamp)), stamp=self.stamp[fixes],
                       likelihood=self.likelihood[fixes],
                       timeless=self.timeless and self.timeless.select(epochs, fixes))

    def summary(self) -> dict:
        """The numbers for `report.json`."""
        return {'horizontal_rmse_m': metrics.rms(self.continuous.horizontal),
                'outages': [outage_summary(outages) for outages in self.outages]}

    def scores(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Stamps and log likelihoods of what was predicted: fix by fix, and at the end of the outages of each duration.

        A likelihood counts both: how far off, and how far off the filter thought that it may be.
        """
        outages = (self.timeless or self).outages
        ends = [(o.begin, _end_scores(o)) for o in outages if len(o.begin)]
        return [(self.stamp, self.likelihood), *ends]


def _end_scores(outages: Outages) -> np.ndarray:
    """Log likelihood of the error at the end of each outage, (o,): the covariance as that of a circle."""
    error = np.array([e.horizontal[-1] for e in outages.errors])
    variance = np.maximum(0.5 * np.array([e.sigma[-1] for e in outages.errors]) ** 2, SMALLEST_ERROR**2)
    return -0.5 * (2 * np.log(variance) + tempered(error**2 / variance, END_TAIL))


def measure(problem: Problem, recording: Recording, imu: ImuSamples, models: Sequence[dict], durations,
            spacing: float, judged: Sequence[np.ndarray] | None = None) -> Measured:
    """Errors in one drive of a model with parameters `models`: one set, or one for each part, fitted to the others.

    recording: with all fixes, for the truth; imu: the samples that the filter gets. judged: masks of the parts, those
    of `parts` by default.
    """
    first = int(problem.stamp[problem.mask][0])
    # by the fixes' own stamps, so that the same outages are compared whatever a model says of the clocks
    begins = outage_begins(first, problem.full.gnss, 0.0, spacing, min(durations, default=0.0))
    if len(models) == 1:
        judged = [problem.mask]
    elif judged is None:
        judged = parts(problem)
    whole = len(models) == 1

    def one(model):
        values, part = model
        found = _run(problem, recording, imu, values, durations,
                     begins if whole else begins[_in_mask(begins, problem, part)])
        return found.select(lambda stamp: (whole | _in_mask(stamp, problem, part)) & (stamp >= first),
                            np.isfinite(found.likelihood) & part)
    return _joined(on_all_cores(one, zip(models, judged)))


def together(drives: dict[str, Measured]) -> Measured:
    """The errors in several drives, by name, as those of one; of one, these."""
    return replace(_joined(list(drives.values())), drives=drives if len(drives) > 1 else {})


def _joined(found: Sequence[Measured]) -> Measured:
    """What was measured in parts of a drive, or in drives on one time axis, in the order of time."""
    if len(found) == 1:
        return found[0]
    stamp, likelihood = (np.concatenate([getattr(m, name) for m in found]) for name in ('stamp', 'likelihood'))
    order = np.argsort(stamp, kind='stable')
    durations = sorted({o.duration for m in found for o in m.outages})
    outages = [_joined_outages([o for m in found for o in m.outages if o.duration == d]) for d in durations]
    timeless = [m.timeless or m for m in found] if any(m.timeless for m in found) else []
    return Measured(_joined_errors([m.continuous for m in found]), outages, all(m.independent for m in found),
                    stamp[order], likelihood[order], late=float(np.mean([m.late for m in found])),
                    timeless=_joined(timeless) if timeless else None)


def _run(problem: Problem, recording: Recording, imu: ImuSamples, values: dict, durations,
         begins: np.ndarray) -> Measured:
    """One filter through the recording: errors with the fixes used, in outages, and the likelihood of each fix (f,)."""
    config, delay = FilterConfig.from_parameters(values), round(values['gnss.time_offset'] * 1e9)
    truth, clock = truth_of(recording, values), problem.reference_clock
    if recording.reference is not None and clock == GNSS:
        truth = earlier(truth, delay)
    keep = samples_to_keep(imu, truth.reference.stamp)
    coasting = None
    if durations:
        result, coasting = run_with_outages(config, imu, problem.full.gnss, begins - delay, max(durations),
                                            aiding_of(recording), keep)
    else:
        result = run(config, imu, problem.full.gnss, aiding_of(recording), keep=keep)
    likelihood = problem.innovations(result).log_likelihood()

    def against(truth: Truth, shift: int) -> Measured:
        """`truth` has stamps that are earlier by `shift` than its own, by which different models are compared."""
        outages = outages_of(result, coasting, truth, durations, config.imu.restart_gap) if coasting else []
        errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
        return Measured(_later(errors, shift), [
            replace(o, begin=o.begin + delay, errors=[_later(e, shift) for e in o.errors]) for o in outages],
            recording.reference is not None, problem.stamp, likelihood)

    if clock in (IMU, GNSS):
        return against(truth, delay if clock == GNSS else 0)
    late = lateness_against(result, truth)
    shift = round(late * 1e9)
    timeless = against(earlier(truth, shift), shift)
    return timeless if clock == OWN else replace(against(truth, 0), late=late, timeless=timeless)


def _later(errors: Errors, shift: int) -> Errors:
    return replace(errors, stamp=errors.stamp + shift)


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


def nearest(measured: Measured, duration: float = 30.0) -> Outages | None:
    """Its outages of about `duration` s, None where there are none."""
    there = [outages for outages in measured.outages if len(outages.begin)]
    return min(there, key=lambda o: abs(o.duration - duration)) if there else None


def saved(before: Measured, after: Measured) -> tuple[float, float, float] | None:
    """Duration of outages, s, and the median of the largest error in them before and after, m; None without any."""
    one, other = map(nearest, fairly(before, after))
    if one is None or other is None or one.duration != other.duration:
        return None
    return one.duration, float(np.median(one.max_error)), float(np.median(other.max_error))


def fairly(before: Measured, after: Measured) -> tuple[Measured, Measured]:
    """Both without what the truth says of time, if it may have a clock of its own and what is new takes the track away
    from it: that would be a veto by a clock."""
    if before.timeless and after.timeless and abs(after.late) > abs(before.late):
        return before.timeless, after.timeless
    return before, after


def compared(before: Measured, after: Measured) -> list[dict]:
    """Whether the errors differ, by what is measured: mean, root mean square (for the tails), and how often the 95 %
    ellipse held the truth; mean square with the fixes used, mean of the largest error in outages.

    decides: not where the truth is the fixes that the filter was given, which only shows how closely it follows them.
    drive: its name in the rows of each of several drives, which come last; else there is none.
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
                   new.max_error)
        if row['count']:
            row |= _tails(old.begin, new.begin, old.max_error, new.max_error) | {
                'within_before': float(old.within.mean()), 'within_after': float(new.within.mean())}
        rows.append(row | {'decides': True})
    return rows


def harm(comparison: Sequence[dict], effects: bool = False, floor: float = COVERED) -> str:
    """What becomes worse, and by how much; empty where nothing does.

    An error grows where it is larger for certain and noticeably (GROWN, NOTICED), or where its mean or its root mean
    square is larger by LARGER, certain or not; effects: if that is LIKELY, as the largest errors of a few dozen
    outages scatter by more and the likelihood of held-out data has proven the effect already; so, too, in single
    drives, as all together have to be better. An ellipse that held the truth in COVERED has to hold it in `floor`, or
    one outage less; one that did not must not hold it in LESS_HELD less, unless it holds it in `floor` still.
    """
    for row in comparison:
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
                larger = p < LIKELY if p is not None else new > (1 + SCATTER / np.sqrt(row['count'])) * old + NOTICED
            certain = i == 0 and p is not None and p < CERTAIN
            if larger or certain and new > (1 + GROWN) * old + NOTICED:
                which = 'root mean square of the ' if i else ''
                return (f"the error grows: {where}{which}{row['what']}, {_plain(old, squared)} before, "
                        f'{_plain(new, squared)} after')
        held, holds = row.get('within_before'), row.get('within_after')
        if held is not None and holds < (floor - 1.0 / row['count'] if held >= COVERED
                                         else min(held - LESS_HELD, floor)):
            which = row['what'].split(',')[0]
            return (f'{where}{which}: the 95 % ellipse held the truth in {100 * held:.0f} % before, '
                    f'in {100 * holds:.0f} % after')
    return ''


def _plain(value: float, squared: bool) -> str:
    return f'{value**2 if squared else value:.3g}'


def objection(proof: HeldOut, comparison: Sequence[dict]) -> str:
    """What speaks against an effect, empty where nothing does: no gain of likelihood, or an error that grows.

    comparison: errors with the effect and without, of parts that it was not fitted to. A likelihood that gains, but
    not for certain, is no objection where an error shrinks for certain and plainly. Nor is an error that is the same,
    where the ellipses come to hold it: errors that last are in the withheld fixes, too, so these never favour who
    models them. Nor are ellipses that hold a far smaller error less often, or one with an effect that is certain: what
    else is wrong shows only now, and noise levels, which decide on ellipses, are chosen at the end.
    """
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
    return _larger(comparison)


def _larger(comparison: Sequence[dict]) -> str:
    """An objection to errors that are larger all in all; empty where they are not."""
    change = all_in_all(comparison)
    if change <= 1 + GROWN or (change <= LARGER and honest(of_all(comparison))):
        return ''
    return f'the error does not shrink: all in all it is {change:.2f} times that before'


def unproven(comparison: Sequence[dict], effects: bool = False) -> str:
    """What speaks against another configuration; empty where it is proven to be better.

    effects: what is new in it has been proven by the likelihood of held-out data already (`objection`), so errors
    must not grow. Whether they shrink the fixes that are the truth as a rule cannot say: who stamps them late, or
    stands elsewhere, has the withheld ones late and elsewhere, too. Noise levels alone have no such proof: with them
    errors have to shrink, or the ellipses to hold the truth where they did not.
    """
    rows = [row for row in of_all(comparison) if effects or row['count'] >= FEWEST_OUTAGES]
    change = all_in_all(rows)
    worse = harm(comparison, effects, COVERED - LESS_HELD if effects and 0.0 < change <= PLAINLY else COVERED)
    if worse or effects:
        return worse or _larger(comparison)
    if rows and (change < BETTER or honest(rows) and change <= 1.0):
        return ''
    return 'the errors do not shrink with it'


def honest(rows: Sequence[dict]) -> bool:
    """Whether ellipses that did not hold the truth hold it more often, by two outages or more."""
    return any(row['within_before'] < COVERED and row['within_after'] >= row['within_before'] + 2 / row['count']
               for row in rows if 'within_before' in row)


def all_in_all(comparison: Sequence[dict]) -> float:
    """Errors after over those before, the geometric mean of all rows that decide; 0 where nothing was measured."""
    ratios = [row['after'] / row['before'] for row in of_all(comparison)]
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 0.0


def of_all(comparison: Sequence[dict]) -> list[dict]:
    """The rows that decide and were measured, of all drives together."""
    return [row for row in comparison if row['decides'] and row.get('before') and row.get('after')
            and 'drive' not in row]


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


def _tails(stamp, new_stamp, old, new) -> dict:
    """Root mean squares before and after, and p that they are the same."""
    row = _row('', stamp, new_stamp, old**2, new**2)
    return {'rms_before': row['before']**0.5, 'rms_after': row['after']**0.5} | (
        {'rms_p': row['p']} if 'p' in row else {})
