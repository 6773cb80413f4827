"""What the numbers of a comparison say, in sentences: the answer first, then what the models do."""
from __future__ import annotations

import shlex

import numpy as np

from ..evaluation.comparison import Comparison, OutageResult, PairResult
from ..evaluation.metrics import rms
from ..recordings.checker import ERROR, INFO, Finding
from .answer import BAD, GOOD, WARNING, Answer, Step, checked_text, held_text, topics_of
from .html import number
from .plots import model_name

#: differences smaller than this part are of no practical meaning, however significant
PRACTICAL = 0.02
#: a truth whose own error is more than this part of the error is mentioned
NOISY_TRUTH = 0.3
#: mean NIS of a filter that judges itself rightly is 2; beyond these it is not
NIS_LOW, NIS_HIGH = 1.4, 3.0
#: beyond this nothing the filter says of itself can be believed
NIS_BAD = 8.0
#: 95 % ellipses that hold the truth less often than this, %, are too small, or much too small; said of so many outages
COVERED, POORLY_COVERED, FEWEST_OUTAGES = 85.0, 60.0, 5
#: a part of the fixes not used that is worth a word
REFUSED = 0.02


def best_model(comparison: Comparison, configured: str) -> str:
    """The `configured` model, where it was replayed and no other is better for certain and noticeably; else the one
    with the smallest error in the longest outages, or at the longest interval where there are none."""
    outages = {r.model: rms(r.outages.max_error) for r in comparison.outages
               if len(r.outages.begin) and r.outages.duration == comparison.durations[-1]}
    error = outages or {m: rms(comparison.run_of(m, comparison.intervals[-1]).errors.horizontal)
                        for m in comparison.models}
    if configured in error:
        noticed = [p for p in comparison.pairs if p.significant and configured in (p.first, p.second)
                   and max(p.rms) > (1 + PRACTICAL) * min(p.rms)]
        worse = {p.first if p.better == p.second else p.second for p in noticed}
        error = {m: e for m, e in error.items() if m == configured
                 or m in {p.better for p in noticed} - worse}
        error = {m: e for m, e in error.items() if m != configured} or error
    return min(error, key=error.get)


def answer(comparison: Comparison, findings: list[Finding], values: dict, bag: str, params_file: str) -> Answer:
    """Is the filter good here, what is wrong, what it costs, what to do. The best model speaks for the filter.

    values: parameters. bag, params_file: for the commands.
    """
    best = best_model(comparison, values['sensor_error_model'])
    result = comparison.run_of(best, comparison.intervals[0])
    nis, outages = _nis(result), [r for r in comparison.outages if r.model == best and len(r.outages.begin)]
    said = [checked_text(f, topics_of(values)) for f in findings if f.severity != INFO]
    grades = [_grade_of_nis(nis), *(_grade_of_coverage(r) for r in outages),
              BAD if any(f.severity == ERROR for f in findings) else GOOD]
    grade = next(g for g in (BAD, WARNING, GOOD) if g in grades)
    refused = _refused(comparison, best)
    wrong = [*_about_nis(nis), *_about_coverage(outages), *refused, *said]
    headline = _headline(grade, comparison, result, nis, findings, values['fixes_until'])
    return Answer(grade, headline, wrong, _cost(outages),
                  _steps(grade, comparison, best, values, bag, params_file), _trust(nis, outages, result))


def _nis(result) -> float | None:
    nis = result.run.innovations.nis
    return float(nis.mean()) if len(nis) else None


def _grade_of_nis(nis: float | None) -> str:
    if nis is None or NIS_LOW <= nis <= NIS_HIGH:
        return GOOD
    return BAD if nis > NIS_BAD else WARNING


def _coverage(result: OutageResult) -> float | None:
    """Share of outages that end inside the filter's 95 % ellipse, %; None where they are too few to say."""
    within = result.outages.within
    return float(100 * within.mean()) if len(within) >= FEWEST_OUTAGES else None


def _grade_of_coverage(result: OutageResult) -> str:
    share = _coverage(result)
    if share is None or share >= COVERED:
        return GOOD
    return BAD if share < POORLY_COVERED else WARNING


def _headline(grade: str, comparison: Comparison, result, nis, findings, fixes_until: float) -> str:
    judged = next((r for r in comparison.runs if r.model == result.model and r.independent), None)
    accuracy = 'it follows the fixes'
    if judged is not None:
        when = f'without fixes after {fixes_until:g} s' if fixes_until else f'with fixes each {judged.interval:g} s'
        accuracy = (f'{when} its position is within {number(judged.summary["horizontal_p95_m"], 2)} m of the '
                    f'{_truth_name(comparison)} for 95 % of the time')
    if grade == GOOD:
        found = ' The checker found something in the recording, see below.' if any(f.severity != INFO
                                                                                  for f in findings) else ''
        return f'The filter is good here: {accuracy}, and it knows its own uncertainty.{found}'
    if grade == WARNING:
        return f'The filter works here, but not all is right: {accuracy}; see below what is wrong.'
    if any(f.severity == ERROR for f in findings):
        return 'The filter is not good here: the recording itself is wrong, see below.'
    if nis is not None and nis > NIS_BAD:
        return (f'The filter is not good here: the fixes lie {_times(nis)} times as far from its predictions as it '
                'expects.')
    return 'The filter is not good here: without fixes it is far more certain of its position than it may be.'


def _truth_name(comparison: Comparison) -> str:
    return 'fixes withheld' if comparison.recording.reference is None else comparison.truth.source


def _times(nis: float) -> str:
    return number(float(np.sqrt(nis / 2)), 2)


def _about_nis(nis: float | None) -> list[str]:
    if nis is None or NIS_LOW <= nis <= NIS_HIGH:
        return []
    said = f'The mean NIS is {number(nis, 3)} where 2 is right: '
    if nis < NIS_LOW:
        return [said + 'the filter is more careful than it need be. The fixes are better than their covariances, or '
                'gnss.sigma, say.']
    return [said + f'each fix is {_times(nis)} times as far from the prediction as the filter expects. Something on '
            'the vehicle is not in its model (the receiver\'s stamps, the mounting of the IMU, the place of the '
            'antenna, hills under a planar filter), or its noise levels are too small.']


def _about_coverage(outages: list[OutageResult]) -> list[str]:
    said = []
    for result in outages:
        if _grade_of_coverage(result) != GOOD:
            inside, count = int(result.outages.within.sum()), len(result.outages.within)
            said.append(f'After {result.outages.duration:g} s without fixes its 95 % ellipse held the truth in '
                        f'{inside} of {count} outages ({number(100 * inside / count, 2)} %).')
    return said


def _refused(comparison: Comparison, best: str) -> list[str]:
    """Fixes given to the filter after its start that it did not use."""
    run = comparison.run_of(best, comparison.intervals[0]).run
    given = comparison.fixes_given[comparison.intervals[0]]
    given = given[(given >= run.stamp[0]) & (given <= run.stamp[-1])]
    lost = len(given) - int(np.isin(given, run.innovations.stamp).sum())
    if lost <= REFUSED * len(given):
        return []
    return [f'{lost} of {len(given)} fixes were refused by the filter or lost on their way: see what it said, under '
            'Recording.']


def _cost(outages: list[OutageResult]) -> list[str]:
    said = []
    for result in outages:
        error, within = result.outages.max_error, result.outages.within
        median, worst = (number(float(np.percentile(error, q)), 2) for q in (50, 95))
        text = (f'{result.outages.duration:g} s: {median} m (median of the largest error in {len(error)} outages; one '
                f'in twenty is worse than {worst} m)')
        said.append(f'{text}; its 95 % ellipse held the truth in {int(within.sum())} of {len(within)}')
    return said


def _trust(nis: float | None, outages: list[OutageResult], result) -> str:
    shares = [s for s in map(_coverage, outages) if s is not None]
    poor = [s for s in shares if s < COVERED]
    if poor and min(poor) < POORLY_COVERED or (nis is not None and nis > NIS_BAD):
        return 'No: do not use its covariance to decide anything until the cause is found.'
    if poor or (nis is not None and nis > NIS_HIGH):
        return 'Not quite: its sigmas are too small, multiply them by two or so until the cause is found.'
    if nis is not None and nis < NIS_LOW:
        return 'Yes, on the safe side: its sigmas are larger than they need be.'
    if not shares:
        return 'With fixes, yes. Without them this recording is too short to say.'
    return f'Yes: its 95 % ellipse held the truth {held_text(min(shares))}.'


def _steps(grade: str, comparison: Comparison, best: str, values: dict, bag: str, params_file: str) -> list[Step]:
    steps = []
    configured = values['sensor_error_model']
    if configured in comparison.models and best != configured:
        steps.append(Step(f'Use the sensor error model that is best here: sensor_error_model: {best} in the params '
                          f'file (it is {configured}).'))
    if grade != GOOD:
        truth = [f'--reference-topic {shlex.quote(values["reference_topic"])}'] if values['reference_topic'] else []
        steps.append(Step('Let diagnose look for what is missing, and estimate it from this recording:', ' '.join(
            ['python -m mems_ins_fusion diagnose --bag', shlex.quote(bag), '--params-file', shlex.quote(params_file),
             *truth, '--output diagnosis'])))
        if values['mechanization'] == 'planar':
            steps.append(Step('If there are hills or a sloping car park: mechanization: strapdown in the params file. '
                              'The planar filter takes gravity on a slope for acceleration.'))
        steps.append(Step('Check on the vehicle: how the IMU is mounted (imu.mounting_rpy), where the antenna is seen '
                          'from it (gnss.lever_arm), and whether the receiver stamps a fix with the time of its '
                          'measurement or of its arrival (gnss.time_offset).'))
    else:
        steps.append(Step('Drive with these parameters:', 'python -m mems_ins_fusion fusion_node --ros-args '
                          f'--params-file {shlex.quote(params_file)}'))
    return steps


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
        p = next((pair.p_adjusted for pair in against_best if worst in (pair.first, pair.second)), 1.0)
        return (f'{where} no model is certainly better than another ({listed} RMS): errors a second apart are alike, '
                'so the difference rests on few stretches of the drive, and chance could deal them so (p '
                f'{number(p, 2)}, all comparisons counted).')
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
