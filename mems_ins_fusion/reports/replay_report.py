"""The results of a replay as `report.json`, `report.html` and figures."""
from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import __version__
from ..diagnosis.quantity import FindingState
from ..evaluation.comparison import Comparison, outage_row, run_row
from ..evaluation.verdict import NOT_USABLE, decide, trust_in_sigmas
from ..parameters.table import defaults as default_parameters
from ..recordings.remarks import checked_text
from ..recordings.sketch import fitted_to
from ..results import json_text
from . import html
from . import replay_figures as drawings
from .answer import Answer, topics_of
from .charts import charts
from .html import bullets, figure, folded, image_bytes, number, paragraph, section, table
from .layers import centre_of, replay_layers
from .replay_answer import best_model, consistencies, replay_verdict, sentences
from .replay_figures import model_name
from .series import replay_charts
from .settings import settings_table
from .track import script, track
from .verdict import verdict_json

#: file name, drawing and caption of each figure
FIGURES = (
    ('track', drawings.track, 'The drive from above. Grey: the truth. Pink: what the filter made of stretches without '
     'fixes, ending at x; the dotted line leads to where the vehicle was.'),
    ('error_against_time', drawings.error_against_time, 'Horizontal error against time. Grey bands: turning. Grey '
     'line: two sigma as the filter states it; about 95 % of the errors should lie below.'),
    ('error_against_interval', drawings.error_against_interval, 'RMS error against the update interval: with 95 % '
     'confidence intervals (left), in turns and on straights (right).'),
    ('manoeuvre', drawings.manoeuvre, 'The turn with the largest error, at each update interval.'),
    ('outage_growth', drawings.outage_growth, 'How the error grows without fixes: RMS over the outages (solid), and '
     'two sigma as the filter states it (dashed). A solid line above its dashed one: the sigma is too small.'),
)


def report(comparisons: dict[str, Comparison], values: dict, findings: dict[str, list], said: dict[str, list[str]],
           online: list[dict], answers: dict[str, Answer], timing: dict) -> dict:
    """The content of `report.json`. comparisons, findings of the checker, messages of the reader, answers: by name of
    the recording. online: rows of `online_row`. timing: name -> s."""
    defaults = default_parameters()
    return {
        'tool': 'replay_node', 'version': __version__,
        'sensor_error_model': best_model(next(iter(comparisons.values())), values['sensor_error_model']),
        'recordings': [_recording(name, c, findings[name], said[name], values) for name, c in comparisons.items()],
        'runs': [run_row(r, c.mechanization, name) for name, c in comparisons.items() for r in c.runs],
        'outages': [outage_row(r, c.mechanization, name) for name, c in comparisons.items() for r in c.outages],
        'smoothed': [run_row(r, c.mechanization, name) for name, c in comparisons.items() for r in c.smoothed],
        'online': online,
        'comparisons': [_pair(p, name) for name, c in comparisons.items() for p in c.pairs],
        'answer': {name: a.json() for name, a in answers.items()},
        'verdict': _verdict(comparisons, values, findings),
        'sentences': {name: sentences(c) for name, c in comparisons.items()},
        'parameters': {name: value for name, value in values.items() if value != defaults.get(name)},
        'seconds': timing,
    }


def online_row(quantity: FindingState, name: str, begin: int) -> dict:
    """One entry of `online` in `report.json`: a finding at the time at which it changed. begin: ns."""
    return {'recording': name, 'time_s': (quantity.time - begin) * 1e-9, 'name': quantity.name, 'state': quantity.state,
            'parameters': {n: {'value': e.value, 'sigma': e.sigma, 'unit': e.unit}
                           for n, e in quantity.parameters.items()},
            'set': list(quantity.sets), 'applied': quantity.applied, 'advice': quantity.advice, 'text': quantity.text}


def _recording(name: str, comparison: Comparison, findings: list, said: list[str], values: dict) -> dict:
    imu, gnss = comparison.recording.imu, comparison.recording.gnss
    return {'name': name, 'duration_s': float((imu.stamp[-1] - imu.stamp[0]) * 1e-9), 'imu_samples': len(imu),
            'fixes': len(gnss), 'truth': comparison.truth.source, 'truth_positions': len(comparison.truth),
            'truth_sigma_m': float(np.sqrt(np.median(comparison.truth.variance))),
            'fitted_to_it': fitted_to(comparison.recording, values['fitted_to']),
            'warnings': said, 'notices': _notices(comparison),
            'findings': [{'severity': f.severity, 'topic': f.topic, 'message': f.message,
                          'text': checked_text(f, topics_of(values))} for f in findings]}


def _verdict(comparisons: dict[str, Comparison], values: dict, findings: dict[str, list]) -> dict:
    """The verdict on all recordings together."""
    several = len(comparisons) > 1
    each = [replay_verdict(c, findings[name], values, name if several else '') for name, c in comparisons.items()]
    verdict = decide(change for v in each for change in v.changes)
    verdict = replace(verdict, fitted_here=any(v.fitted_here for v in each))
    why = tuple(text for v in each for text in v.why)
    verdict = replace(verdict, answer=NOT_USABLE, why=why) if why else verdict
    return verdict_json(verdict, trust_in_sigmas([c for of in comparisons.values() for c in consistencies(of, values)]))


def _notices(comparison: Comparison) -> list[str]:
    """Messages of the filter in its runs, each once: of messages that differ only in their numbers, the first."""
    said = {}
    for place, result in enumerate(comparison.runs):
        for notice in result.run.notices:
            if notice.level != 'info':
                said.setdefault(re.sub(r'\d+(\.\d+)?', '0', notice.text), []).append((place, notice.text))
    found = []
    for texts in said.values():
        others = len({place for place, _ in texts}) - 1
        found.append(texts[0][1] + (f' (and alike in {others} of the other {len(comparison.runs) - 1} runs)' if others
                                    else ''))
    return found


def _pair(pair, name: str) -> dict:
    difference = pair.difference
    unit = 'mean_square_error_m2' if pair.duration is None else 'mean_largest_error_m'
    return {'recording': name, 'first': pair.first, 'second': pair.second, 'update_interval_s': pair.interval,
            'outage_duration_s': pair.duration, 'quantity': unit, 'first_rms_m': pair.rms[0],
            'second_rms_m': pair.rms[1], 'difference': difference.mean,
            'interval': [difference.low, difference.high], 'p_value': difference.p,
            'p_adjusted': pair.p_adjusted, 'significant': pair.significant}


def draw_figures(name: str, comparison: Comparison, folder: Path, progress=lambda: None) -> list[html.Html]:
    """The figures for the page, each also written to `folder` as PNG. progress: called after each."""
    drawn = []
    for file, draw, caption in FIGURES:
        drawing = draw(comparison)
        if drawing is not None:
            png = image_bytes(drawing)
            (folder / f'{name}{file}.png').write_bytes(png)
            drawn.append(figure(png, caption, narrow=html.narrow_bytes(drawing)))
        progress()
    return drawn


def report_page(comparisons: dict[str, Comparison], values: dict, content: dict, figures: dict[str, list],
                answers: dict[str, Answer]) -> str:
    """The content of `report.html`: the answer and the track, then the evidence in folded sections."""
    sections = []
    for name, comparison in comparisons.items():
        of = f' ({name})' if len(comparisons) > 1 else ''
        still, *others = figures[name]
        best = best_model(comparison, values['sensor_error_model'])
        names = {model: model_name(comparison, model) for model in comparison.models}
        sections += [
            section(f'Is the filter good here?{of}', answers[name].html(),
                    track(replay_layers(comparison, best, names), still, centre_of(comparison.truth.reference)),
                    _glance(comparison, content, name)),
            answers[name].evidence(),
            folded(f'Over time{of}', charts(replay_charts(comparison, best), 'estimates and signals over time')),
            folded(f'Which sensor error model is best?{of}', bullets(sentences(comparison))),
            folded(f'Position errors{of}', *_run_tables(comparison, content, name), *others[:3]),
            folded(f'Outages{of}', *_outage_tables(comparison, content, name, values['horizon.limit']),
                   *others[3:]),
            _recording_section(f'Recording{of}', content, name, values)]
        told = [f"{r['time_s']:.0f} s: {r['name']} {r['state']}: {r['text']}" for r in content['online']
                if r['recording'] == name]
        if told:
            sections.append(folded(f'Diagnosed while driving{of}', bullets(told)))
    sections += [_settings(values, content), _explanation()]
    names = ', '.join(comparisons)
    truths = ', '.join(dict.fromkeys(c.truth.source for c in comparisons.values()))
    return html.page(f'Replay of {names}', sections,
                     f'{values["mechanization"]} mechanization, {len(content["runs"])} runs. Errors are measured '
                     f'against: {truths}.', script())


def _glance(comparison: Comparison, content: dict, name: str):
    """The error of each model with fixes and in the outages, with the share inside its 95 % ellipse."""
    rows = []
    for model in comparison.models:
        run = next(r for r in content['runs'] if r['recording'] == name and r['model'] == model
                   and r['update_interval_s'] == comparison.intervals[0])
        outages = [r for r in content['outages'] if r['recording'] == name and r['model'] == model]
        rows.append([model_name(comparison, model), run['horizontal_rmse_m'],
                     *(None if r['count'] == 0 else f'{number(r["max_error_mean_m"], 3)} m '
                       f'({number(r["within_95_percent"], 2)} %)' for r in outages)])
    columns = ['model', f'RMS, fixes each {comparison.intervals[0]:g} s, m',
               *(f'{d:g} s without fixes' for d in comparison.durations)]
    return table(columns, rows, 'Horizontal position error. Without fixes: the mean of the largest error, and in '
                 'brackets how often the filter\'s own 95 % ellipse held the truth.' if comparison.durations else '',
                 digits=3)


def _run_tables(comparison: Comparison, content: dict, name: str):
    rows = [r for r in content['runs'] if r['recording'] == name]
    first = [[model_name(comparison, r['model']), r['update_interval_s'], r['horizontal_rmse_m'],
              _interval(r['horizontal_rmse_interval_m']), r['horizontal_p95_m'], r['horizontal_max_m'],
              r['relative_translation_percent'], r['nis_mean'], r['within_95_percent']] for r in rows]
    second = [[model_name(comparison, r['model']), r['update_interval_s'], r['horizontal_median_m'],
               r['along_track_rmse_m'], r['cross_track_rmse_m'], r['turning_rmse_m'], r['straight_rmse_m'],
               r['heading_rmse_deg'], r['speed_rmse_mps']] for r in rows]
    rows = [r for r in content['smoothed'] if r['recording'] == name]
    smooth = [[model_name(comparison, r['model']), r['horizontal_rmse_m'], _interval(r['horizontal_rmse_interval_m']),
               r['horizontal_p95_m'], r['horizontal_max_m'], r['within_95_percent']] for r in rows]
    smoothed = [table(['model', 'RMS, m', '95 % interval of it', '95 % below, m', 'largest, m',
                       'inside 95 % ellipse, %'], smooth, f'Smoothed, fixes each {comparison.intervals[0]:g} s: each '
                      'position with what came after it, too.', digits=3)] if rows else []
    return (_full_table(['model', 'fixes each, s', 'RMS, m', '95 % interval of it', '95 % below, m', 'largest, m',
                         'relative, % of path', 'NIS (2 is right)', 'inside 95 % ellipse, %'], first,
                        'Horizontal position error of each run.'),
            *smoothed,
            _full_table(['model', 'fixes each, s', 'median, m', 'along track, m', 'across, m', 'in turns, m',
                         'on straights, m', 'heading, deg', 'speed, m/s'], second,
                        'The first table in parts: RMS but for the median.'))


def _full_table(columns, rows, caption: str):
    """A table without empty columns."""
    keep = [i for i in range(len(columns)) if any(row[i] is not None for row in rows)]
    return table([columns[i] for i in keep], [[row[i] for i in keep] for row in rows], caption, digits=3)


def _interval(bounds) -> str | None:
    return None if bounds is None else f'{number(bounds[0], 3)} to {number(bounds[1], 3)}'


def _outage_tables(comparison: Comparison, content: dict, name: str, limit: float) -> list[html.Html]:
    found = [r for r in content['outages'] if r['recording'] == name]
    if not found:
        return [paragraph('No outages were asked for.')]
    rows = [[model_name(comparison, r['model']), r['duration_s'], r['count'], r['max_error_rms_m'],
             r['max_error_median_m'], r['max_error_p95_m'], r['percent_of_distance'], r['within_95_percent']]
            for r in found]
    columns, caption = ['model', 'without fixes, s', 'outages', 'RMS, m', 'median, m', '95 % below, m', '% of distance',
                        'inside 95 % ellipse, %'], 'Largest horizontal error in each outage.'
    if any('smoothed' in r for r in found):
        columns += ['smoothed: median, m', '95 % below, m', 'inside, %']
        caption += ' Smoothed: with the fixes that come after the outage; inside the ellipse in its middle.'
        rows = [[*row, s['max_error_median_m'], s['max_error_p95_m'], s['within_95_percent']]
                for row, s in zip(rows, (r['smoothed'] for r in found if 'smoothed' in r))]
    horizon = [[*row[:2], r['announced_s'], r['crossed_s'], r['crossed_early_percent']] for row, r in zip(rows, found)]
    return [table(columns, rows, caption, digits=3), table(
        ['model', 'without fixes, s', 'announced, s', 'crossed, s', 'crossed early, %'], horizon,
        'Announced: for how long the filter said, as the outage began, that its error stays below '
        f'horizon.limit ({limit:g} m) with 95 %; crossed: when the error was larger '
        '(medians; a dash: in fewer than half of the outages).', digits=3)]


def _recording_section(title: str, content: dict, name: str, values: dict):
    r = next(r for r in content['recordings'] if r['name'] == name)
    rows = [[r['duration_s'], r['imu_samples'], r['fixes'], r['truth'], r['truth_positions']]]
    found = [f"{f['severity']}: {f['text']}" for f in r['findings']]
    parts = (('The reader said:', r['warnings']), ('The checker found:', found), ('The filter said:', r['notices']))
    return folded(title, table(['duration, s', 'IMU samples', 'fixes', 'truth', 'positions of it'], rows, digits=3),
                  *(part for head, lines in parts if lines for part in (paragraph(head), bullets(lines))))


def _settings(values: dict, content: dict):
    seconds = ', '.join(f'{name} {number(s, 3)} s' for name, s in content['seconds'].items())
    given = content['parameters']
    return folded('Settings', settings_table(given, 'Parameters that are not at their default.') if given
                   else paragraph('All parameters are at their defaults.'), paragraph(f'CPU time: {seconds}.'))


def _explanation():
    return folded('How to read this', bullets([
        'Each run is the same recording through the same filter, with another model of the sensor errors or with fewer '
        'fixes. Errors are estimate minus truth at the antenna; trajectories are not aligned to each other.',
        'Fixes that the filter used are no truth for it, unless noise was added to them: without a reference only '
        'withheld fixes count.',
        'Until the filter has started it is given every fix; only then are they thinned out. All runs of a recording '
        'are judged over the same time.',
        'Relative: the error of the displacement over 100 to 800 m of path, in percent of the path, mean over all '
        'such stretches, as in the KITTI benchmark. Where the truth has no heading, an error of the heading counts, '
        'too.',
        'Turns: the vehicle turns faster than 5 degrees per second, 2 s before and after included.',
        'NIS, the normalized innovation squared, compares each fix with the filter\'s prediction and its covariance. '
        'Its mean is 2 where the sigmas of the filter are right.',
        'Outages: each is a run of its own in which fixes are withheld once; the error counts from the last fix used.',
        'A difference between models is called significant when the paired differences give an '
        'adjusted p below 5 % (Holm, over all comparisons on the recording).']))


def write_report(folder: Path, content: dict, page: str) -> None:
    (folder / 'report.json').write_text(json_text(content, indent=1) + '\n', encoding='utf-8')
    (folder / 'report.html').write_text(page, encoding='utf-8')


def summary_table(content: dict) -> str:
    """The position error of each run, and the outages, as text for a terminal."""
    lines = [f"{'model':<16}{'fixes each':>11}{'RMS':>11}{'95 %':>11}{'max':>11}{'NIS':>8}"]
    several = len(content['recordings']) > 1
    for r in content['runs']:
        lines.append(f"{r['model']:<16}{r['update_interval_s']:>9g} s{_metres(r['horizontal_rmse_m'])}"
                     f"{_metres(r['horizontal_p95_m'])}{_metres(r['horizontal_max_m'])}"
                     f"{number(r['nis_mean'], 3):>8}" + (f"  {r['recording']}" if several else ''))
    for r in content['smoothed']:
        lines.append(f"{r['model']:<16}{'smoothed':>11}{_metres(r['horizontal_rmse_m'])}"
                     f"{_metres(r['horizontal_p95_m'])}{_metres(r['horizontal_max_m'])}"
                     f"{'':>8}" + (f"  {r['recording']}" if several else ''))
    if any(r['count'] for r in content['outages']):
        lines.append(f"{'model':<16}{'outage':>11}{'RMS':>11}{'median':>11}{'95 %':>11}{'count':>8}{'in ellipse':>12}")
    for r in (r for r in content['outages'] if r['count']):
        lines.append(f"{r['model']:<16}{r['duration_s']:>9g} s{_metres(r['max_error_rms_m'])}"
                     f"{_metres(r['max_error_median_m'])}{_metres(r['max_error_p95_m'])}{r['count']:>8}"
                     f"{r['within_95_percent']:>10.0f} %" + (f"  {r['recording']}" if several else ''))
        if 'smoothed' in r:
            s = r['smoothed']
            lines.append(f"{'':<16}{'smoothed':>11}{_metres(s['max_error_rms_m'])}{_metres(s['max_error_median_m'])}"
                         f"{_metres(s['max_error_p95_m'])}{s['count']:>8}{s['within_95_percent']:>10.0f} %")
    return '\n'.join(lines)


def _metres(value: float) -> str:
    return f'{number(value, 3):>9} m'
