"""A diagnosis for a person (the answer, HTML), for a program (JSON), and for the filter (YAML)."""
from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from ..diagnosis.error_changes import error_changes
from ..diagnosis.estimate import Estimate, rounded
from ..diagnosis.findings import Diagnosis, Finding
from ..diagnosis.measured import outages_nearest
from ..diagnosis.tracing import Candidate
from ..evaluation.verdict import Verdict
from ..parameters.params_file import yaml_value
from ..parameters.table import parameters_of
from ..recordings.remarks import checked_text
from ..recordings.sketch import sketch
from ..results import plain
from . import diagnosis_figures as plots
from . import html
from .answer import Answer, topics_of
from .charts import charts
from .colours import MODEL_NAMES
from .effect_words import remaining_cause
from .layers import centre_of, diagnosed_truth, diagnosis_layers
from .series import diagnosis_charts
from .track import script, track
from .verdict import change_text, held_text, verdict_json


def report(diagnosis: Diagnosis, answered: Answer, checked=(), warned=()) -> dict:
    """The content of `report.json`: plain types, None for unknown values. answered: result of `answer`. checked:
    findings of the checker. warned: messages of the reader."""
    d = diagnosis
    model, mechanization = d.values['sensor_error_model'], d.values['mechanization']
    return plain({
        'recording': d.name,
        'drives': [_drive(d, drive) for drive in d.drives],
        'left_out': d.left_out,
        'answer': answered.json(),
        'verdict': verdict_json(d.verdict, d.trust),
        'findings': _findings(checked, d.values),
        'model': model,
        'mechanization': mechanization,
        'effects': [_effect(f) for f in d.findings],
        'before': _measured(d, 'before', d.values),
        'noise_fitted': _measured(d, 'fitted', d.values),
        'after': _measured(d, 'after', d.corrected),
        'unexplained': d.unexplained,
        'not_identifiable': list(not_identifiable(d)),
        'not_identifiable_reasons': not_identifiable(d),
        'comparison': d.comparison,
        'goes_with': [asdict(one) for one in d.correlations],
        'noise_factors': d.noise,
        'noise_that_would_explain': d.explained,
        'use_corrected': d.better,
        'changed_parameters': changed_parameters(d),
        'rounds': [[_candidate(c, d) for c in candidates] for candidates in d.rounds],
        'remarks': d.remarks,
        'warnings': list(warned),
    })


def not_usable_report(names: Sequence[str], values: dict, verdict: Verdict, answered: Answer, checked, warned) -> dict:
    """The content of `report.json` if the recordings `names` cannot be diagnosed: no effect, no errors."""
    return plain({
        'recording': ', '.join(names), 'answer': answered.json(), 'verdict': verdict_json(verdict),
        'findings': _findings(checked, values), 'model': values['sensor_error_model'],
        'mechanization': values['mechanization'], 'effects': [], 'use_corrected': False, 'warnings': list(warned)})


def not_usable_page(names: Sequence[str], answered: Answer, checked, values: dict) -> str:
    """The content of `report.html` in this case."""
    return html.page(f'Diagnosis of {", ".join(names)}', [
        html.section('Use corrected.yaml?', answered.html()), answered.evidence(),
        html.folded('Recording', html.bullets(f['text'] for f in _findings(checked, values)))])


def _findings(checked, values: dict) -> list[dict]:
    return [{'severity': f.severity, 'topic': f.topic, 'message': f.message,
             'text': checked_text(f, topics_of(values))} for f in checked]


def _effect(finding: Finding) -> dict:
    return {
        'name': finding.name,
        'group': finding.group,
        'parameters': {name: asdict(estimate) for name, estimate in finding.parameters.items()},
        'log_likelihood_gain': finding.gain,
        'p_value': finding.p,
        'added': finding.added,
        # an observed effect is not fitted: it is proven by errors, not by a likelihood
        'held_out_log_likelihood_gain': None if finding.seen else finding.held_out.gain,
        'held_out_p_value': None if finding.seen else finding.held_out.p,
        'reason': finding.reason,
        'changes': finding.changes,
        'outages_without_and_with_it': finding.saves and dict(
            zip(('duration_s', 'max_error_mean_without_m', 'max_error_mean_with_m'), finding.saves)),
        'seen': finding.seen,
        'drives': {name: {p: asdict(estimate) for p, estimate in found.items()}
                   for name, found in finding.drives.items()},
        'drives_contradict': finding.drives_contradict,
    }


def _drive(d: Diagnosis, drive: Diagnosis) -> dict:
    """One of several drives, by name, in the form of all of them together."""
    return {
        'recording': drive.name,
        'before': _measured(drive, 'before', d.values),
        'noise_fitted': _measured(drive, 'fitted', d.values),
        'after': _measured(drive, 'after', d.corrected),
        'unexplained': drive.unexplained,
        'comparison': drive.comparison,
        'goes_with': [asdict(one) for one in drive.correlations],
        'remarks': drive.remarks,
    }


def _measured(d: Diagnosis, stage: str, values: dict) -> dict:
    detection = d.detections[stage]
    numbers = {'before': d.before, 'fitted': d.fitted, 'after': d.after}[stage].summary()
    key = {'model': values['sensor_error_model'], 'mechanization': values['mechanization']}
    return {**numbers, 'outages': [key | outage for outage in numbers['outages']], 'nis_mean': detection.nis_mean,
            'nis_bounds': detection.nis_bounds, 'ljung_box_p': detection.ljung_box_p, 'mean': detection.mean,
            'mean_p': detection.mean_p, 'whiteness_p': detection.whiteness_p, 'to_next': detection.to_next,
            'innovations': detection.count, 'words': detection.words()}


def _candidate(c: Candidate, d: Diagnosis) -> dict:
    """Result of a test; parameters that the recording does not determine are named without a number."""
    return {'name': c.name, 'score_gain': c.gain, 'p_value': c.p, 'p_adjusted': c.p_adjusted,
            'parameters': {name: asdict(estimate) for name, estimate in _tested(c, d).items()},
            'undetermined': c.undetermined}


def _tested(c: Candidate, d: Diagnosis) -> dict[str, Estimate]:
    """One-step estimates of the parameters that a candidate determines, at the time of the test and at the end."""
    units = {p.name: p.unit for p in c.effect.traced}
    return {u.parameter: Estimate(*u.meant(float(value), float(sigma)), units[u.parameter])
            for u, value, sigma in zip(c.unknowns, c.theta, c.sigma) if u.name not in d.hidden}


def not_identifiable(d: Diagnosis) -> dict[str, str]:
    """Effects, and single parameters of effects, that the data do not determine, and why.

    An effect without any determined parameter is named as a whole.
    """
    found = dict(d.hidden)
    for c in d.rounds[-1] if d.rounds else []:
        if c.undetermined and not c.unknowns:
            for name in c.undetermined:
                found.pop(f'{c.name}.{name}', None)
            found[c.name] = f'none of its parameters is determined by this recording ({", ".join(c.undetermined)})'
    return found


def changed_parameters(d: Diagnosis) -> dict:
    """The parameters that the diagnosis changed, with 4 significant digits as in `corrected.yaml`."""
    return {name: rounded_value(value) for name, value in d.corrected.items() if value != d.values[name]}


#: share of the largest of several numbers below which a number is a rounding error
NOTHING = 1e-6


def rounded_value(value, digits: int = 4):
    """`value` of a parameter to `digits` significant digits: 4 in a file, 3 in a sentence."""
    if isinstance(value, (list, tuple)):
        largest = max((abs(v) for v in value), default=0.0)
        return [rounded_value(v if abs(v) > NOTHING * largest else 0.0, digits) for v in value]
    return float(f'{value:.{digits}g}') if isinstance(value, float) else value


def corrected_yaml(diagnosis: Diagnosis, given: dict) -> str:
    """The params file with the corrections: the `given` values (by full name), the changes, and their origin.

    If nothing is proven to be better, the given values.
    """
    d = diagnosis
    new = changed_parameters(d)
    if d.changed:
        new['fitted_to'] = sorted({*given.get('fitted_to', ()), *sketch(r.gnss for r in d.recordings)})
    known = parameters_of(given)
    checked = {name: known[name].check(value) for name, value in given.items()}
    found = '; '.join(parameters_text(f) for f in d.findings if f.added) or 'none'
    shown = d.verdict.shown
    said = (f'Corrected by diagnose from {d.name}: {change_text(shown, d.verdict.level)}. Effects added: {found}.'
            if d.changed else f'As given: no gain is proven for what diagnose found in {d.name}.')
    if d.changed:
        said += ' What is changed has its reason above it; all else is as it was given.'
    lines = [*_comment(said, ''), '/**:', '  ros__parameters:']
    for name, value in {**checked, **new}.items():
        if name in new:
            lines += _comment(origin_text(d, name), '    ')
        lines.append(f'    {name}: {yaml_value(value)}')
    # a file with an empty mapping would not be a params file
    lines += [] if checked or new else [f'    imu_topic: {yaml_value(d.values["imu_topic"])}']
    return '\n'.join(lines).replace('\N{PLUS-MINUS SIGN}', '+-') + '\n'  # plain ASCII, for all readers


def origin_text(d: Diagnosis, name: str) -> str:
    """Origin of the changed value of parameter `name`."""
    if name == 'fitted_to':
        return 'hashes of the recordings that the values were fitted to'
    before = yaml_value(rounded_value(d.values[name]))
    if name in d.noise:
        return ('with this noise level the positions are predicted best; '
                f'it is {d.noise[name]:.3g} times the configured one, {before}')
    text = '; '.join(parameters_text(f) for f in d.findings if f.added and name in f.changes)
    text = text or next((remark.rstrip('.') for remark in d.remarks if name in remark), 'changed with the effects')
    return f'{text}; before: {before}'


def _comment(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, 110, initial_indent=f'{indent}# ', subsequent_indent=f'{indent}# ')


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def parameters_text(finding: Finding) -> str:
    """An effect with its values in words."""
    values = ', '.join(f'{name} {estimate.text()}' for name, estimate in finding.parameters.items())
    return f'{finding.name} ({values or "its parameters are not determined"})'


def diagnosis_lines(diagnosis: Diagnosis, answered: Answer) -> list[str]:
    """The diagnosis in words: the whole answer, then the steps that led to it."""
    d = diagnosis
    lines = [*answered.lines(), '', f'{d.name}: {d.detections["before"].count} innovations', 'As configured: '
             + ' '.join(d.detections['before'].words())]
    lines += [f'Effect: {finding_text(f)}' for f in d.findings] or ['No effect was found.']
    before, after = (html.number(m.summary()['horizontal_rmse_m'], 3) for m in (d.before, d.after))
    lines.append(f'Error with the fixes used: RMS {before} m before, {after} m after.')
    if d.changed:
        lines.append(f'{plots.STAGES["after"].capitalize()}: {" ".join(d.detections["after"].words())}')
    if hidden := not_identifiable(d):
        lines.append(f'Cannot be seen in {subject(d)}: {_hidden_text(hidden)}.')
    return [*lines, *(drive_text(drive) for drive in d.drives)]


def subject(d: Diagnosis) -> str:
    """The subject of the diagnosis in a sentence."""
    return 'these recordings' if d.drives else 'this recording'


def drive_text(drive: Diagnosis) -> str:
    """One of several drives in a sentence."""
    return f'{drive.name}: ' + ('; '.join(outage_error_lines(drive)) or 'too short for outages') + '.'


def _hidden_text(hidden: dict[str, str]) -> str:
    """Names by reason."""
    reasons = {}
    for name, why in hidden.items():
        reasons.setdefault(why, []).append(name)
    return '; '.join(f'{", ".join(names)} ({why})' for why, names in reasons.items())


def finding_text(f: Finding) -> str:
    others = [name for name in f.group if name != f.name]
    how = ' by another mechanization' if 'mechanization' in f.changes else ''
    group = f'; this recording cannot tell it from {" or ".join(others)}' if others else ''
    return f'{parameters_text(f)}{group}; ' + (f'added{how}.' if f.added else f'not added: {f.reason}.')


def unexplained_text(d: Diagnosis) -> str:
    if not d.unexplained:
        return 'Nothing is left unexplained.'
    text = 'A part stays unexplained'
    if not d.correlations:
        seen = 'change sign from fix to fix' if d.detections['search'].alternates else (
            'still last from one fix to the next')
        text = f'{text}: errors {seen}, and go with nothing that was recorded.'
    else:
        seen = ', or of the '.join(f'{r.where} that goes with {r.what} ({rounded(abs(r.rms), r.sigma)} {r.unit} RMS)'
                                   for r in d.correlations[:3])
        text = f'{text}. What is left looks like an error of the {seen}.'
    causes = [left for f in d.findings if f.added and (left := remaining_cause(f.name, d.values))]
    return f'{text} It may come from {", or ".join(causes)}.' if causes else text


def outage_error_lines(d: Diagnosis) -> list[str]:
    """Errors in outages, as configured and with corrected.yaml, in words; and the share of them inside the ellipse."""
    held = {h.duration: held_text(h) for h in d.trust.held}
    if d.changed:
        said = {c.duration: change_text(c, d.verdict.level) for c in error_changes(d.before, d.after)}
        said.pop(None, None)
    else:
        means = {o.duration: html.number(float(o.max_error.mean()), 2) for o in d.before.outages if len(o.begin)}
        said = {duration: f'{duration:g} s without fixes {mean} m as configured' for duration, mean in means.items()}
    return [f'{text}; {held[duration]}' if duration in held else text for duration, text in said.items()]


def report_html(diagnosis: Diagnosis, given: dict, answered: Answer, checked=(), warned=()) -> str:
    """The content of `report.html`: the answer and the track, then the evidence in folded sections. given: as for
    `corrected_yaml`."""
    d = diagnosis
    count = d.detections['before'].count
    evidence = [part for drive in d.drives for part in (_in_drive(drive), _over_time(drive, f' ({drive.name})'))] or [
        _residual(d), _over_time(d)]
    yaml = html.folded('corrected.yaml', 'With --params-file of every tool, the filter runs as here.',
                       html.preformatted(corrected_yaml(d, given)))
    return html.page(f'Diagnosis of {d.name}', [
        _answered(d, answered), answered.evidence(), _errors(d), _added(d), yaml, _unexplained(d), *evidence, _noise(d),
        _recording(d, checked, warned), _candidates(d)],
        f'{d.values["mechanization"]} mechanization, {MODEL_NAMES[d.values["sensor_error_model"]]} sensor errors, '
        f'{count} innovations', script())


def _answered(d: Diagnosis, answered: Answer) -> html.Html:
    shown = _drives(d) if d.drives else _track(d)
    return html.section('Use corrected.yaml?', answered.html(), shown, html.figure(
        plots.errors(d), f'Horizontal position error{" before and after" if d.changed else ""}, to the left with the '
        'fixes used, to the right against the time without fixes: median, and half of the outages.'))


def _track(d: Diagnosis) -> html.Html:
    return track(diagnosis_layers(d), html.figure(
        plots.track(d), f'The drive from above, as configured{" and with corrected.yaml" if d.changed else ""}, with '
        'all fixes and in the longest outages, each ending at x.'), centre_of(diagnosed_truth(d).reference))


def _over_time(d: Diagnosis, of: str = '') -> html.Html:
    return html.folded(f'Over time{of}', charts(diagnosis_charts(d), 'errors, innovations and signals over time'))


def _drives(d: Diagnosis) -> html.Html:
    """Tables of several drives: their errors before and after, and their separate estimates of the effects."""
    rows = []
    for drive in d.drives:
        problem = drive.problem
        minutes = float(np.ptp(problem.stamp[problem.mask])) * 1e-9 / 60
        before, after = (outages_nearest(m) for m in (drive.before, drive.after))
        numbers = [None] * 5 if before is None or after is None else [
            before.duration, *(float(o.max_error.mean()) for o in (before, after)),
            *(100 * float(o.within.mean()) for o in (before, after))]
        rows.append((drive.name, minutes, drive.detections['before'].count, *numbers))
    columns = ('drive', 'minutes', 'fixes', 'without fixes, s', 'largest error, mean: before, m', 'after, m',
               'inside 95 % ellipse: before, %', 'after, %')
    said = [(f.name, drive.name, _sizes(f.drives.get(drive.name, {})) or 'nothing')
            for f in d.findings if f.drives for drive in d.drives]
    of_effects = html.table(('effect', 'drive', 'what it says alone'), said, 'A drive alone is less sure than all '
                            'together; one in which an effect does not show says nothing against it.')
    tracks = ''.join(f'<h3>{html.paragraph(drive.name)[3:-4]}</h3>{_track(drive)}' for drive in d.drives)
    return html.Html(html.table(columns, rows, 'Each drive.', 3) + (of_effects if said else '') + tracks)


def _in_drive(drive: Diagnosis) -> html.Html:
    return html.folded(f'Drive {drive.name}', html.bullets([*outage_error_lines(drive), *drive.remarks]),
                       *_innovations(drive))


def _recording(d: Diagnosis, checked, warned) -> html.Html:
    found = [f'{f.severity}: {checked_text(f, topics_of(d.values))}' for f in checked]
    parts = (('The reader said:', list(warned)), ('The checker found:', found), ('Worth knowing:', d.remarks))
    return html.folded('Recording', *(part for head, lines in parts if lines
                                      for part in (html.paragraph(head), html.bullets(lines))))


def _residual(d: Diagnosis) -> html.Html:
    return html.folded('What the filter could not explain' + (', before and after' if d.changed else ''),
                       *_innovations(d))


def _innovations(d: Diagnosis) -> list[html.Html]:
    after = [html.paragraph(f'{capital(plots.STAGES["after"])}:'), html.bullets(d.detections['after'].words()),
             html.figure(plots.residual(d, 'after'), 'The same at the end.')] if d.changed else []
    return [
        html.bullets(d.detections['before'].words()),
        html.figure(plots.residual(d, 'before'), 'Innovations (fix minus prediction) of the filter as configured, in '
                    'units of their predicted standard deviation, along and across the track. What is beyond 5 sigma '
                    'stands at the edges of the histogram.'), *after, _tests(d, plots.measured_stages(d))]


def _tests(d: Diagnosis, stages) -> html.Html:
    rows = [(plots.STAGES[stage], name, det.mean[name], _p(det.mean_p[name]), _p(det.whiteness_p[name]))
            for stage in stages for det in (d.detections[stage],) for name in det.mean]
    return html.table(('filter', 'component', 'mean, sigma', 'p of mean zero', 'p of white (Ljung-Box)'), rows,
                      digits=3)


def _p(value: float) -> str:
    """A p value as text."""
    return '< 0.001' if value < 0.001 else html.number(value, 2)


def _noise(d: Diagnosis) -> html.Html:
    of_effects = [name for f in d.findings if f.added for name in f.changes if name.endswith('noise_density')]
    kept = 'corrected.yaml has those that were given' + (
        f', but for {" and ".join(of_effects)} (see What was found).' if of_effects else '.')
    return html.folded(
        'Noise levels', 'Two things are told apart. The levels with which each fix is explained best by the one before '
        'belong to the search alone, where they keep a badly tuned filter from being taken for a missing effect. Those '
        'in corrected.yaml are chosen by what the filter predicts up to a minute ahead, and only if that is better on '
        'parts of the drive that did not choose.',
        html.table(('noise level', 'factor in the search'), list(d.explained.items()), digits=3),
        html.table(('noise level', 'factor in corrected.yaml'), list(d.noise.items()), digits=3) if d.noise else kept)


def _candidates(d: Diagnosis) -> html.Html:
    if not d.rounds:
        return html.folded('Candidates and their evidence', 'No effect could be tested.')
    tables = [html.table(('effect', 'gain', 'p', 'p, all tests counted', 'would be', 'not determined'),
                         [(c.name, c.gain, _p(c.p), _p(c.p_adjusted), _estimates(c, d), ', '.join(c.undetermined))
                          for c in candidates],
                         f'Round {i + 1}', 3) for i, candidates in enumerate(d.rounds)]
    hidden = html.bullets(f'{name}: {why}' for name, why in not_identifiable(d).items())
    return html.folded(
        'Candidates and their evidence', 'The score test: how much better each effect would explain the innovations, '
        'with the share of noise levels and of effects added before taken out. Coloured: significant after counting '
        'all tests; dark: the one chosen. That need not be the one with the largest gain: of the first ones, at '
        'several noise levels, each is fitted together with all that was found before, and the largest likelihood then '
        'counts; a plain cause goes before one that changes with time and so can do all that the plain one does.',
        html.figure(plots.evidence(d), 'Evidence for each candidate, round by round.'), *tables,
        'What this recording cannot show:', hidden)


def _estimates(c: Candidate, d: Diagnosis) -> str:
    return ', '.join(f'{name} {estimate.text()}' for name, estimate in _tested(c, d).items())


def _added(d: Diagnosis) -> html.Html:
    if not d.findings:
        return html.folded('What was found', 'No candidate is significant.')
    rows = [(f.name, ', '.join(n for n in f.group if n != f.name), _sizes(f.parameters),
             *((None,) * 3 if f.seen else (f.gain, f.held_out.gain, _p(f.held_out.p))), f.added,
             f.reason) for f in d.findings]
    return html.folded(
        'What was found', 'Values of the last joint fit. The held-out gain is that of the log likelihood in blocks of '
        'the recording that the effect was not fitted to; an effect without one is not added. What is not fitted '
        '(without a gain) has another proof: errors that are smaller with it for certain, or that the filter finds it '
        'itself in each drive.',
        html.table(('effect', 'cannot be told from', 'value', 'score gain', 'held-out gain', 'p held out', 'added',
                    'why not'), rows, digits=3))


def _sizes(parameters: dict[str, Estimate]) -> str:
    return ', '.join(f'{name} {estimate.text()}' for name, estimate in parameters.items())


def _errors(d: Diagnosis) -> html.Html:
    rows = [(f"{c['drive']}: {c['what']}" if 'drive' in c else c['what'],
             *map(c.get, ('count', 'before', 'after', 'difference')), _interval(c), _p(c['p']) if 'p' in c else '')
            for c in d.comparison]
    summaries = {plots.STAGES[stage]: measured.summary() for stage, measured in plots.measured_stages(d).items()}
    columns = ('filter', 'RMS with fixes, m', 'without fixes, s', 'outages', 'largest error: mean, m', 'RMS, m',
               '95 % below, m',
               '% of distance', 'inside 95 % ellipse, %')
    table = [(name, s['horizontal_rmse_m'] if i == 0 else None, o['duration_s'], o['count'], o['max_error_mean_m'],
              o['max_error_rms_m'], o['max_error_p95_m'], o['percent_of_distance'],
              o['within_95_percent'])
             for name, s in summaries.items() for i, o in enumerate(s['outages'])]
    return html.folded(
        'Error before and after', 'Each error after is one of a model that was fitted to other blocks of the '
        'recording, unless no effect was added.',
        html.table(columns, table, digits=3),
        html.table(('what', 'count', 'before', 'after', 'difference', '95 % interval', 'p of no difference'), rows,
                   'Paired differences, after minus before' + ('' if d.changed else ': what was tried, and is not in '
                                                               'corrected.yaml') +
                   '. Each interval is of its row alone; those of the answer hold for all rows at once, and are wider.',
                   3))


def _interval(row: dict) -> str:
    return f'{html.number(row["low"], 3)} to {html.number(row["high"], 3)}' if 'low' in row else ''


def _unexplained(d: Diagnosis) -> html.Html:
    parts = [unexplained_text(d)]
    if d.correlations:
        parts += ['An error of one sensor, or of the position, in proportion to something else would explain the rest '
                  'better. No effect of the library stands for it, so it is not corrected.',
                  html.table(('error of', 'goes with', 'RMS', '\N{PLUS-MINUS SIGN}', 'unit', 'gain', 'p, all tests '
                              'counted'), [(r.where, r.what, r.rms, r.sigma, r.unit, r.gain, _p(r.p))
                                           for r in d.correlations],
                             digits=3)]
    elif d.unexplained:
        parts.append('It goes with none of time, speed, acceleration, turn rate, heading and temperature (as far as '
                     'recorded).')
    return html.folded('What stays unexplained', *parts)
