"""The results of a comparison in sentences: the answer first, then the models."""
from __future__ import annotations

import shlex
from dataclasses import replace

import numpy as np

from ..evaluation.comparison import Comparison, OutageResult, PairResult
from ..evaluation.metrics import rms
from ..evaluation.verdict import (
    BETTER,
    NO,
    NOT_USABLE,
    SAME,
    WORSE,
    Consistency,
    Trust,
    Verdict,
    change_in_outages,
    decide,
    trust_in_sigmas,
)
from ..recordings.checker import INFO, Remark
from ..recordings.remarks import checked_text
from ..recordings.sketch import fitted_to
from .answer import BAD, GOOD, WARNING, Answer, Step, cure, let_configure, topics_of
from .html import number
from .replay_figures import model_name
from .verdict import certainly_wrong, change_text, too_small_text, trust_text

#: relative difference below which a significant difference is not relevant
PRACTICAL = 0.02
#: ratio of the error of the truth to that of the filter above which it is mentioned
NOISY_TRUTH = 0.3
#: ratio of the errors to their sigmas that, if significant, makes the answer bad
FAR_TOO_LARGE = 2.0
#: share of unused fixes above which it is mentioned
REFUSED = 0.02


def best_model(comparison: Comparison, configured: str) -> str:
    """The `configured` model if it was replayed and no other is significantly and noticeably better; else the one with
    the smallest error in the longest outages, or at the longest interval if there are none."""
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


def replay_verdict(comparison: Comparison, remarks: list[Remark], values: dict, where: str = '') -> Verdict:
    """Whether the filter, with its best model, is better in outages than keeping the last velocity. where: name of the
    recording, if there are several."""
    wrong = tuple(checked_text(f, topics_of(values)) for f in certainly_wrong(remarks, values))
    if wrong:
        return Verdict(NOT_USABLE, why=wrong)
    best = best_model(comparison, values['sensor_error_model'])
    verdict = decide(change_in_outages(r.outages.duration, r.outages.kept, r.outages.max_error, r.outages.apart,
                                       where=where)
                     for r in comparison.outages if r.model == best and len(r.outages.begin))
    return replace(verdict, fitted_here=fitted_to(comparison.recording, values['fitted_to']))


def consistencies(comparison: Comparison, values: dict) -> list[Consistency]:
    """Errors of the best model over its sigmas: with fixes (by the innovations if the fixes are the only truth) and in
    outages."""
    best = best_model(comparison, values['sensor_error_model'])
    result = comparison.run_of(best, comparison.intervals[0])
    with_fixes = result.errors.nees if result.independent else result.run.innovations.nis
    return [Consistency(None, with_fixes), *(r.outages.consistency for r in comparison.outages
                                             if r.model == best and len(r.outages.begin))]


def answer(comparison: Comparison, remarks: list[Remark], values: dict, bag: str, params_file: str) -> Answer:
    """Whether the filter is good on this recording, what is wrong, what it costs, what to do, by the best model.

    values: parameters. bag, params_file: for the commands.
    """
    best = best_model(comparison, values['sensor_error_model'])
    outages = [r for r in comparison.outages if r.model == best and len(r.outages.begin)]
    # points with a parameter to set come first
    told = sorted((f for f in remarks if f.severity != INFO), key=lambda f: not f.settings)
    said = [checked_text(f, topics_of(values)) for f in told]
    verdict, trust = replay_verdict(comparison, remarks, values), trust_in_sigmas(consistencies(comparison, values))
    wrong = [*said, *_refused(comparison, best)]
    if trust.answer == NO and verdict.answer == WORSE:  # otherwise it is in the headline
        wrong.insert(0, f'Its sigmas are too small: {too_small_text(trust)}.')
    if verdict.fitted_here:
        wrong.insert(0, 'The parameters were fitted to this very recording: on another drive errors will be larger.')
    grade = _grade(verdict, trust)
    accuracy = _accuracy(comparison, best, values['fixes_until'])
    costs = [*accuracy, *_cost(outages)]
    if verdict.answer == NOT_USABLE:  # on wrong data the sigmas mean nothing
        return Answer(grade, _headline(verdict, trust, accuracy), wrong, costs,
                      [cure(certainly_wrong(remarks, values), [bag])])
    steps = _steps(grade, comparison, best, values, bag, params_file)
    if any(f.settings for f in told) and not verdict.fitted_here:
        steps.insert(0, let_configure([bag]))
    return Answer(grade, _headline(verdict, trust, accuracy), wrong, costs, steps, trust_text(trust))


def _grade(verdict: Verdict, trust: Trust) -> str:
    if verdict.answer in (NOT_USABLE, WORSE):
        return BAD
    if trust.answer == NO and trust.scale is not None and trust.scale.least > FAR_TOO_LARGE:
        return BAD
    good = trust.answer != NO and (verdict.answer == BETTER or not verdict.changes)
    return GOOD if good else WARNING


def _headline(verdict: Verdict, trust: Trust, accuracy: list[str]) -> str:
    if verdict.answer == NOT_USABLE:
        return f'Not usable: {verdict.why[0]}'
    if trust.answer == NO and verdict.answer != WORSE:
        return f'The filter is not good here, its sigmas are too small: {too_small_text(trust)}.'
    if verdict.shown is None:
        return ': '.join(['With fixes it works; there were no outages to judge it by', *accuracy[:1]])
    proof = change_text(verdict.shown, verdict.level, 'with the last velocity kept')
    return {BETTER: f'The filter is good here: {proof}.', WORSE: f'Do not use it, the filter is wrong here: {proof}.',
            SAME: f'The filter is no better than doing without: {proof}.'}.get(
                verdict.answer, f'Cannot tell whether the filter helps: {proof}.')


def _accuracy(comparison: Comparison, best: str, fixes_until: float) -> list[str]:
    """Sentence on the horizontal error that 95 % of the positions do not exceed, against a truth that the filter was
    not given."""
    result = next((r for r in comparison.runs if r.model == best and r.independent), None)
    if result is None:
        return []
    when = f'without fixes after {fixes_until:g} s' if fixes_until else (
        f'with fixes each {result.interval:g} s' if result.interval else 'with all fixes')
    return [f'{when}: within {number(result.summary["horizontal_p95_m"], 2)} m of the {_truth_name(comparison)} for '
            '95 % of the time']


def _truth_name(comparison: Comparison) -> str:
    return 'fixes withheld' if comparison.recording.reference is None else comparison.truth.source


def _refused(comparison: Comparison, best: str) -> list[str]:
    """Fixes after the start that the filter did not use."""
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
        mean, worst = (number(float(v), 2) for v in (error.mean(), np.percentile(error, 95)))
        said.append(f'{result.outages.duration:g} s without fixes: {mean} m (mean of the largest error in {len(error)} '
                    f'outages; one in twenty is worse than {worst} m); its 95 % ellipse held the truth in '
                    f'{int(within.sum())} of {len(within)}')
    return said


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


def sentences(comparison: Comparison) -> list[str]:
    """Sentences on one recording: models, update intervals, turns, outages, and consistency of the sigmas."""
    parts = (_truth, _models, _intervals, _turns, _outages, _consistency)
    return [sentence for part in parts for sentence in part(comparison)]


def _truth(comparison: Comparison) -> list[str]:
    """Limits of the truth."""
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
        return (f'{where} no model is certainly better than another ({listed} RMS): chance alone may make such a '
                f'difference (p {number(p, 2)}, all comparisons counted).')
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
    between = {i: np.ptp([rms(comparison.run_of(m, i).errors.horizontal) for m in comparison.models])
               for i in intervals}
    first, last = intervals[0], intervals[-1]
    sentence = (f'Fixes each {last:g} s instead of each {first:g} s change the RMS error from '
                f'{number(error[first], 3)} m to {number(error[last], 3)} m')
    if len(comparison.models) > 1:
        sentence += f'; between the models the largest difference is {number(max(between.values()), 2)} m'
    return [sentence + '.']


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
    return [f'The mean NIS at fixes each {interval:g} s is {values} (2 where its sigmas are right).']
