"""A diagnosis for a person (story, HTML), for a program (JSON), and for the filter (YAML)."""
from __future__ import annotations

import math
import textwrap
from dataclasses import asdict

import numpy as np

from ..diagnosis.diagnose import Diagnosis, Finding
from ..diagnosis.tracing import Candidate
from ..parameters.params_file import yaml_value
from ..parameters.table import ALL
from . import diagnosis_figures as plots
from . import html


def report(diagnosis: Diagnosis, warned=()) -> dict:
    """The content of `report.json`: plain types, None for what is not known. warned: what reading said."""
    d = diagnosis
    model, mechanization = d.values['sensor_error_model'], d.values['mechanization']
    return _plain({
        'recording': d.recording.name,
        'model': model,
        'mechanization': mechanization,
        'effects': [_effect(f, d) for f in d.findings],
        'before': _measured(d, 'before', d.values),
        'noise_fitted': _measured(d, 'fitted', d.values),
        'after': _measured(d, 'after', d.corrected),
        'unexplained': d.unexplained,
        'not_identifiable': list(not_identifiable(d)),
        'not_identifiable_reasons': not_identifiable(d),
        'comparison': d.comparison,
        'goes_with': [asdict(rest) for rest in d.rest],
        'noise_factors': d.noise,
        'changed_parameters': changed(d),
        'rounds': [[_candidate(c) for c in candidates] for candidates in d.rounds],
        'remarks': d.remarks,
        'warnings': list(warned),
    })


def _effect(finding: Finding, d: Diagnosis) -> dict:
    return {
        'name': finding.name,
        'group': finding.group,
        'parameters': {name: {'value': value, 'sigma': sigma, 'unit': unit}
                       for name, (value, sigma, unit) in finding.parameters.items()},
        'log_likelihood_gain': finding.gain,
        'p_value': finding.p,
        'added': finding.added,
        'held_out_log_likelihood_gain': finding.held_out.gain,
        'held_out_p_value': finding.held_out.p,
        'reason': finding.reason,
    }


def _measured(d: Diagnosis, stage: str, values: dict) -> dict:
    detection = d.detections[stage]
    numbers = {'before': d.before, 'fitted': d.fitted, 'after': d.after}[stage].summary()
    key = {'model': values['sensor_error_model'], 'mechanization': values['mechanization']}
    return {**numbers, 'outages': [key | outage for outage in numbers['outages']], 'nis_mean': detection.nis_mean,
            'nis_bounds': detection.nis_bounds, 'ljung_box_p': detection.ljung_box_p, 'mean': detection.mean,
            'mean_p': detection.mean_p, 'whiteness_p': detection.whiteness_p, 'innovations': detection.count,
            'words': detection.words()}


def _candidate(c: Candidate) -> dict:
    """What a test said; parameters that the recording does not determine are named and have no number."""
    return {'name': c.name, 'score_gain': c.gain, 'p_value': c.p, 'p_adjusted': c.p_adjusted,
            'parameters': {name: {'value': value, 'sigma': sigma} for name, (value, sigma) in _tested(c).items()},
            'undetermined': c.undetermined}


def _tested(c: Candidate) -> dict[str, tuple[float, float | None]]:
    """One-step estimates of the parameters that a candidate determines; standard deviations, not variances."""
    found = {}
    for unknown, value, sigma in zip(c.unknowns, c.theta, c.sigma):
        found[unknown.parameter] = unknown.meant(float(value), float(sigma))
    return found


def not_identifiable(d: Diagnosis) -> dict[str, str]:
    """Effects, and single parameters of effects, that the data cannot show, and why.

    An effect of which no parameter is determined is named as a whole, an added one by what is missing of it.
    """
    found = dict(d.hidden)
    present = {f.name for f in d.findings}
    for candidates in d.rounds:
        for c in candidates:
            if c.name in present:
                found |= {f'{c.name}.{name}': 'not determined by this recording' for name in c.undetermined}
    for c in d.rounds[-1] if d.rounds else []:
        if c.undetermined and not c.unknowns:
            for name in c.undetermined:
                found.pop(f'{c.name}.{name}', None)
            found[c.name] = f'none of its parameters is determined by this recording ({", ".join(c.undetermined)})'
    return found


def changed(d: Diagnosis) -> dict:
    """The parameters that the diagnosis changed, as `corrected.yaml` holds them: to 6 significant digits."""
    return {name: _rounded(value) for name, value in d.corrected.items() if value != d.values[name]}


def _rounded(value):
    if isinstance(value, (list, tuple)):
        return [_rounded(v) for v in value]
    return float(f'{value:.6g}') if isinstance(value, float) else value


def corrected_yaml(diagnosis: Diagnosis, given: dict) -> str:
    """The params file with the effects added: what was `given` (by full name), what changed, and where that is from."""
    d = diagnosis
    new = changed(d)
    checked = {name: ALL[name].check(value) for name, value in given.items()}
    found = '; '.join(parameters_text(f) for f in d.findings if f.added) or 'none'
    lines = [*_comment(f'Corrected by diagnose from {d.recording.name}. Effects added: {found}.', ''),
             '# Other parameters are as they were given.', '/**:', '  ros__parameters:']
    for name, value in {**checked, **new}.items():
        if name in _READING:
            continue  # which part of a recording was looked at is no property of the vehicle
        if name in new:
            lines += _comment(_origin(d, name), '    ')
        lines.append(f'    {name}: {yaml_value(value)}')
    return '\n'.join(lines).replace('\N{PLUS-MINUS SIGN}', '+-') + '\n'  # plain ASCII: not every reader knows better


_READING = ('start', 'stop', 'reference_topic', 'reference_file', 'bag', 'output_dir', 'overwrite')


def _origin(d: Diagnosis, name: str) -> str:
    """Where the changed value of parameter `name` comes from."""
    if name in d.noise:
        said = f'noise level fitted to the innovations: {d.noise[name]:.3g} times'
        before = d.values[name]
        if name == 'gnss.sigma' and not before:
            return f'{said} what the messages say (their covariance was used before)'
        return f'{said} the value before, {yaml_value(_rounded(before))}'
    sources = [f for f in d.findings if f.added and _touches(f, d.values, name)]
    text = '; '.join(parameters_text(f) for f in sources)
    return f'{text or "changed with the effects"}; before: {yaml_value(d.values[name])}'


def _touches(finding: Finding, values: dict, name: str) -> bool:
    """Whether the correction of this effect changes parameter `name`."""
    theta = {p.name: 0.0 for p in (*finding.effect.parameters, *finding.effect.traced)}
    theta |= {key: value for key, (value, _, _) in finding.parameters.items()}
    return finding.effect.adjusted(values, theta)[name] != values[name]


def _comment(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, 110, initial_indent=f'{indent}# ', subsequent_indent=f'{indent}# ')


def parameters_text(finding: Finding) -> str:
    """An effect with its values, for a person."""
    values = ', '.join(_parameter(*item) for item in finding.parameters.items())
    return f'{finding.name} ({values or "its parameters are not determined"})'


def _parameter(name: str, estimate: tuple[float, float | None, str]) -> str:
    value, sigma, unit = estimate
    known = sigma is not None and math.isfinite(sigma)
    text = f'{name} {_to(value, sigma)}' + (f' \N{PLUS-MINUS SIGN} {sigma:.2g}' if known else '')
    if unit == 'rad':
        return f'{text} rad, {math.degrees(value):.3g} deg'
    return text if unit == '-' else f'{text} {unit}'


def _to(value: float, sigma: float | None) -> str:
    """`value` to as many digits as its uncertainty is worth."""
    if not sigma or not math.isfinite(sigma):
        return f'{value:.4g}'
    digits = max(1 - math.floor(math.log10(sigma)), 0)
    return f'{value:.{digits}f}' if digits < 8 else f'{value:.3g}'


def story(diagnosis: Diagnosis) -> list[str]:
    """The diagnosis in a few lines."""
    d = diagnosis
    lines = [f'{d.recording.name}: {d.detections["before"].count} innovations', 'As configured: '
             + ' '.join(d.detections['before'].words())]
    lines += [f'Effect: {finding_text(f)}' for f in d.findings] or ['No effect was found.']
    lines += [f'Error, {text}' for text in error_lines(d)]
    last = 'after' if any(f.added for f in d.findings) else 'fitted'
    lines.append(f'{plots.STAGES[last].capitalize()}: {" ".join(d.detections["after"].words())}')
    lines += [unexplained_text(d), *d.remarks]
    if hidden := not_identifiable(d):
        lines.append(f'Not identifiable here: {", ".join(hidden)}.')
    return lines


def finding_text(f: Finding) -> str:
    others = [name for name in f.group if name != f.name]
    replaced = f.effect.replaces_model({name: value for name, (value, _, _) in f.parameters.items()})
    how = ' by another mechanization' if replaced else ''
    group = f'; this recording cannot tell it from {" or ".join(others)}' if others else ''
    return f'{parameters_text(f)}{group}; ' + (f'added{how}.' if f.added else f'not added: {f.reason}.')


def unexplained_text(d: Diagnosis) -> str:
    if not d.unexplained:
        return 'Nothing is left unexplained.'
    text = 'A part stays unexplained.'
    if d.rest:
        text += ' An error would explain some of it that goes with ' + ', or '.join(
            f'{r.what} ({r.where}, {_to(abs(r.rms), r.sigma)} {r.unit} RMS)' for r in d.rest[:3]) + '.'
    return text


def error_lines(d: Diagnosis) -> list[str]:
    """The error as configured and at the end, continuous and in outages."""
    before, after = d.before.summary(), d.after.summary()
    lines = [f'fixes used: RMS {html.number(before["horizontal_rmse_m"], 3)} m before, '
             f'{html.number(after["horizontal_rmse_m"], 3)} m after']
    for old, new in zip(before['outages'], after['outages']):
        lines.append(f'{old["duration_s"]:g} s without fixes: median of the largest error '
                     f'{html.number(old["max_error_median_m"], 3)} m before, '
                     f'{html.number(new["max_error_median_m"], 3)} m after ({new["count"]} outages)')
    return lines


def _plain(value):
    """`value` in types of JSON; None for numbers that are not finite."""
    if isinstance(value, dict):
        return {str(key): _plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value


def report_html(diagnosis: Diagnosis, given: dict, warned=()) -> str:
    """The content of `report.html`: the story with its pictures; given: as for `corrected_yaml`."""
    d = diagnosis
    count = d.detections['before'].count
    return html.page(f'Diagnosis of {d.recording.name}', [
        _result(d, warned), _residual_before(d), _noise(d), _candidates(d), _added(d), _residual_after(d), _errors(d),
        _unexplained(d), html.section('corrected.yaml', 'With --params-file of every tool, the filter runs as here.',
                                      html.preformatted(corrected_yaml(d, given)))],
        f'{d.values["mechanization"]} mechanization, {d.values["sensor_error_model"].replace("_", " ")} sensor errors, '
        f'{count} innovations')


def _result(d: Diagnosis, warned) -> html.Html:
    added = [f for f in d.findings if f.added]
    said = '; '.join(parameters_text(f) for f in added)
    head = html.note(f'Added: {said}.', 'good') if added else html.note('No effect was added.')
    left = html.note(unexplained_text(d), 'warning' if d.unexplained else 'good')
    return html.section('Result', head, html.bullets(f'Error, {line}' for line in error_lines(d)), left,
                        *(html.note(w, 'warning') for w in warned))


def _residual_before(d: Diagnosis) -> html.Html:
    return html.section(
        'What the filter cannot explain', html.bullets(d.detections['before'].words()),
        html.figure(plots.residual(d, 'before'), 'Innovations (fix minus prediction) of the filter as configured, in '
                    'units of their predicted standard deviation, along and across the track. What is beyond 5 sigma '
                    'stands at the edges of the histogram.'),
        _tests(d, ('before',)))


def _tests(d: Diagnosis, stages) -> html.Html:
    rows = [(plots.STAGES[stage], name, det.mean[name], _p(det.mean_p[name]), _p(det.whiteness_p[name]))
            for stage in stages for det in (d.detections[stage],) for name in det.mean]
    return html.table(('model', 'component', 'mean, sigma', 'p of mean zero', 'p of white (Ljung-Box)'), rows, digits=3)


def _p(value: float) -> str:
    return f'{value:.2g}'


def _noise(d: Diagnosis) -> html.Html:
    return html.section(
        'Noise levels first', 'So that a badly tuned filter is not taken for a missing effect, the noise levels are '
        'fitted to the innovations before any effect is tested, and again with each one added.',
        html.table(('noise level', 'factor at the end'), list(d.noise.items()), digits=3),
        html.bullets(d.detections['fitted'].words()),
        html.figure(plots.residual(d, 'fitted'), 'The same innovations with fitted noise levels and no effect.'))


def _candidates(d: Diagnosis) -> html.Html:
    if not d.rounds:
        return html.section('Candidates and their evidence', 'No effect could be tested.')
    tables = [html.table(('effect', 'gain', 'p', 'p, all tests counted', 'would be', 'not determined'),
                         [(c.name, c.gain, _p(c.p), _p(c.p_adjusted), _estimates(c), ', '.join(c.undetermined))
                          for c in candidates],
                         f'Round {i + 1}', 3) for i, candidates in enumerate(d.rounds)]
    hidden = html.bullets(f'{name}: {why}' for name, why in not_identifiable(d).items())
    return html.section(
        'Candidates and their evidence', 'The score test: how much better each effect would explain the innovations, '
        'with the share of noise levels and of effects added before taken out. Green: significant after counting all '
        'tests; dark green: the one chosen.',
        html.figure(plots.evidence(d), 'Evidence for each candidate, round by round.'), *tables,
        'What this recording cannot show:', hidden)


def _estimates(c: Candidate) -> str:
    units = {p.name: p.unit for p in c.effect.traced}
    return ', '.join(_parameter(name, (value, sigma, units[name])) for name, (value, sigma) in _tested(c).items())


def _added(d: Diagnosis) -> html.Html:
    if not d.findings:
        return html.section('What was found', 'No candidate is significant.')
    rows = [(f.name, ', '.join(n for n in f.group if n != f.name), _values(f), f.gain,
             f.held_out.gain, _p(f.held_out.p), f.added, f.reason) for f in d.findings]
    return html.section(
        'What was found', 'Values of the last joint fit. The held-out gain is that of the log likelihood in blocks of '
        'the recording that the effect was not fitted to; an effect without one is not added.',
        html.table(('effect', 'cannot be told from', 'value', 'score gain', 'held-out gain', 'p held out', 'added',
                    'why not'), rows, digits=3))


def _values(f: Finding) -> str:
    return ', '.join(_parameter(*item) for item in f.parameters.items())


def _residual_after(d: Diagnosis) -> html.Html:
    return html.section(
        'The residual after', html.bullets(d.detections['after'].words()),
        html.figure(plots.residual(d, 'after'), 'Innovations with the effects added.'), _tests(d, ('fitted', 'after')))


def _errors(d: Diagnosis) -> html.Html:
    rows = [(c['what'], c.get('count'), c.get('before'), c.get('after'), c.get('difference'), _interval(c),
             _p(c['p']) if 'p' in c else '') for c in d.comparison]
    summaries = {plots.STAGES[stage]: measured.summary() for stage, measured in plots.measured_stages(d).items()}
    columns = ('model', 'RMS with fixes, m', 'outage, s', 'outages', 'largest error: median, m', 'RMS, m', '95 %, m',
               '% of distance')
    table = [(name, s['horizontal_rmse_m'] if i == 0 else None, o['duration_s'], o['count'], o['max_error_median_m'],
              o['max_error_rms_m'], o['max_error_p95_m'], o['percent_of_distance'])
             for name, s in summaries.items() for i, o in enumerate(s['outages'])]
    return html.section(
        'Error before and after', 'Each error after is one of a model that was fitted to other blocks of the '
        'recording, unless no effect was added.',
        html.figure(plots.errors(d), 'Horizontal position error.'), html.table(columns, table, digits=3),
        html.table(('what', 'count', 'before', 'after', 'difference', '95 % interval', 'p of no difference'), rows,
                   'Paired differences, after minus before, by block bootstrap.', 3))


def _interval(row: dict) -> str:
    return f'{row["low"]:.3g} to {row["high"]:.3g}' if 'low' in row else ''


def _unexplained(d: Diagnosis) -> html.Html:
    parts = [unexplained_text(d)]
    if d.rest:
        parts += ['An error of one sensor, or of the position, in proportion to something else would explain the rest '
                  'better. No effect of the library stands for it, so it is not corrected.',
                  html.table(('error of', 'goes with', 'RMS', '\N{PLUS-MINUS SIGN}', 'unit', 'gain', 'p, all tests '
                              'counted'), [(r.where, r.what, r.rms, r.sigma, r.unit, r.gain, _p(r.p)) for r in d.rest],
                             digits=3)]
    elif d.unexplained:
        parts.append('It goes with none of time, speed, acceleration, turn rate, heading and temperature (as far as '
                     'recorded).')
    if d.remarks:
        parts += ['Worth knowing:', html.bullets(d.remarks)]
    return html.section('What stays unexplained', *parts)
