"""A diagnosis for a person (story, HTML), for a program (JSON), and for the filter (YAML)."""
from __future__ import annotations

import math
import textwrap

import numpy as np

from ..evaluation import html
from ..parameters import ALL, yaml_value
from .diagnose import Diagnosis, Finding
from .tracing import Candidate

_STAGES = {'before': 'as configured', 'fitted': 'with fitted noise levels', 'after': 'with the effects added'}


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
        'correlated': d.correlated,
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
        'held_out_log_likelihood_gain': finding.held_out.gain if finding.held_out else None,
        'held_out_p_value': finding.held_out.p if finding.held_out else None,
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
        value, sigma = float(value), float(sigma)
        if unknown.variance:
            value = math.sqrt(max(value, 0.0))
            sigma = sigma / (2 * value) if value > 0 else None
        found[unknown.name.split('.')[1]] = value, sigma
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
    return f'{finding.name} ({", ".join(_parameter(*item) for item in finding.parameters.items())})'


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
    lines.append(f'{_STAGES["after"].capitalize() if any(f.added for f in d.findings) else "With fitted noise levels"}: '
                 + ' '.join(d.detections['after'].words()))
    lines += [unexplained_text(d), *d.remarks]
    if hidden := not_identifiable(d):
        lines.append(f'Not identifiable here: {", ".join(hidden)}.')
    return lines


def finding_text(f: Finding) -> str:
    others = [name for name in f.group if name != f.name]
    how = ' by another mechanization' if f.effect.replaces_model({k: v for k, (v, _, _) in f.parameters.items()}) else ''
    group = f'; this recording cannot tell it from {" or ".join(others)}' if others else ''
    return f'{parameters_text(f)}{group}; ' + (f'added{how}.' if f.added else f'not added: {f.reason}.')


def unexplained_text(d: Diagnosis) -> str:
    if not d.unexplained:
        return 'Nothing is left unexplained.'
    text = 'A part stays unexplained.'
    if d.correlated:
        text += ' It goes with ' + ', '.join(
            f'{c["with"]} ({c["component"]}, correlation {c["correlation"]:+.2f})' for c in d.correlated[:3]) + '.'
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
    """The content of `report.html`."""
    return html.page(f'Diagnosis of {diagnosis.recording.name}', [html.section('Result', html.bullets(story(diagnosis)))])
