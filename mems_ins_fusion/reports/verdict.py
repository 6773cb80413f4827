"""What the numbers of a comparison say, in sentences."""
from __future__ import annotations

import numpy as np

from ..evaluation.comparison import Comparison, PairResult
from ..evaluation.metrics import rms
from .html import number
from .plots import model_name

#: differences smaller than this part are of no practical meaning, however significant
PRACTICAL = 0.02
#: a truth whose own error is more than this part of the error is mentioned
NOISY_TRUTH = 0.3
#: mean NIS of a filter that judges itself rightly is 2; beyond these it is not
NIS_LOW, NIS_HIGH = 1.4, 3.0


def verdict(comparison: Comparison) -> list[str]:
    """Sentences on one recording: models, update intervals, turns, outages, and the filter's opinion of itself."""
    parts = (_truth, _models, _intervals, _turns, _outages, _consistency)
    return [sentence for part in parts for sentence in part(comparison)]


def _truth(comparison: Comparison) -> list[str]:
    """What the truth is not good for."""
    sentences = []
    own = [r.interval for r in comparison.runs if not r.independent]
    if own:
        intervals = ' and '.join(f'{i:g} s' for i in sorted(set(own)))
        sentences.append(f'At {intervals} the filter used every fix there is and is measured against the same fixes: '
                         'that shows agreement, not accuracy. A reference, longer intervals or outages show more.')
    sigma = float(np.sqrt(np.median(comparison.truth.variance)))
    error = min(rms(r.errors.horizontal) for r in comparison.runs)
    if np.sqrt(2) * sigma > NOISY_TRUTH * error:
        sentences.append(f'The truth is itself uncertain by {number(sigma, 2)} m north and east, which is part of '
                         'every error below.')
    return sentences


def _models(comparison: Comparison) -> list[str]:
    if len(comparison.models) < 2:
        return []
    return [_contest(comparison, [p for p in comparison.pairs if p.duration is None and p.interval == interval],
                     f'With fixes each {interval:g} s')
            for interval in comparison.intervals]


def _contest(comparison: Comparison, pairs: list[PairResult], where: str) -> str:
    if not pairs:
        return f'{where} there are too few data to tell the models apart.'
    error = {}
    for pair in pairs:
        error.update(zip((pair.first, pair.second), pair.rms))
    best, worst = min(error, key=error.get), max(error, key=error.get)
    name = {model: model_name(comparison, model) for model in error}
    listed = ', '.join(f'{name[m]} {number(error[m], 3)} m' for m in sorted(error, key=error.get))
    against_best = [p for p in pairs if best in (p.first, p.second)]
    beaten = [p.second if p.first == best else p.first for p in against_best if p.significant and p.better == best]
    spread = error[worst] / error[best] - 1 if error[best] > 0 else 0.0
    if not beaten:
        return f'{where} no model is significantly better than another ({listed} RMS).'
    over = ' and '.join(name[m] for m in beaten)
    size = (f', but by no more than {100 * spread:.1f} %, which nobody will notice' if spread < PRACTICAL
            else f'; the worst is {100 * spread:.0f} % worse')
    return f'{where} {name[best]} is significantly better than {over} ({listed} RMS){size}.'


def _intervals(comparison: Comparison) -> list[str]:
    intervals = comparison.intervals
    if len(intervals) < 2:
        return []
    error = {i: rms(np.concatenate([comparison.run_of(m, i).errors.horizontal for m in comparison.models]))
             for i in intervals}
    between = {i: _spread([rms(comparison.run_of(m, i).errors.horizontal) for m in comparison.models])
               for i in intervals}
    first, last = intervals[0], intervals[-1]
    sentence = (f'Fixes each {last:g} s instead of each {first:g} s change the RMS error from '
                f'{number(error[first], 3)} m to {number(error[last], 3)} m')
    if len(comparison.models) > 1:
        sentence += f'; between the models the largest difference is {number(max(between.values()), 2)} m'
    return [sentence + '.']


def _spread(values) -> float:
    return max(values) - min(values)


def _turns(comparison: Comparison) -> list[str]:
    interval = comparison.intervals[-1]
    turns, straights = [], []
    for model in comparison.models:
        errors = comparison.run_of(model, interval).errors
        if not errors.turning.any() or errors.turning.all():
            return []
        turns.append((rms(errors.horizontal[errors.turning]), model))
        straights.append((rms(errors.horizontal[~errors.turning]), model))
    best, on_straights = min(turns)[1], min(straights)[1]
    listed = ', '.join(f'{model_name(comparison, m)} {number(t, 3)} m in turns and {number(s, 3)} m on straights'
                       for (t, m), (s, _) in zip(turns, straights))
    sentence = f'At fixes each {interval:g} s: {listed}.'
    if len(comparison.models) > 1:
        sentence += (f' In turns {model_name(comparison, best)} has the smallest error, on straights '
                     f'{model_name(comparison, on_straights)}.')
    return [sentence]


def _outages(comparison: Comparison) -> list[str]:
    sentences = []
    for duration in comparison.durations:
        count = max(len(r.outages.begin) for r in comparison.outages if r.outages.duration == duration)
        if not count:
            sentences.append(f'The recording is too short for an outage of {duration:g} s.')
            continue
        where = f'In {count} outages of {duration:g} s'
        if len(comparison.models) > 1:
            sentences.append(_contest(comparison, [p for p in comparison.pairs if p.duration == duration],
                                      where + ' (largest error)'))
        else:
            result = next(r for r in comparison.outages if r.outages.duration == duration)
            sentences.append(f'{where} the largest error is {number(rms(result.outages.max_error), 3)} m RMS.')
    return sentences


def _consistency(comparison: Comparison) -> list[str]:
    interval = comparison.intervals[0]
    nis = {m: comparison.run_of(m, interval).run.innovations.nis for m in comparison.models}
    nis = {m: float(v.mean()) for m, v in nis.items() if len(v)}
    if not nis:
        return []
    low, high = min(nis.values()), max(nis.values())
    values = number(low, 2) if len(nis) == 1 or high - low < 0.05 else f'{number(low, 2)} to {number(high, 2)}'
    sentence = f'The mean NIS at fixes each {interval:g} s is {values} (2 is expected): '
    if high > NIS_HIGH:
        sentence += ('the filter trusts itself, or the fixes, too much. Something in the recording is not in its '
                     'model, or its noise parameters are too small; `diagnose` looks for it.')
    elif low < NIS_LOW:
        sentence += 'the filter is more careful than it need be; the fixes are better than their covariances say.'
    else:
        sentence += 'the filter judges itself about rightly.'
    return [sentence]
