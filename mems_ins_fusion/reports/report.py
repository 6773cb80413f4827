"""The results of a replay as `report.json`, `report.html` and figures."""
from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from .. import __version__
from ..evaluation.comparison import Comparison, outage_row, run_row
from ..parameters.table import defaults as default_parameters
from . import html, plots
from .html import bullets, figure, image_bytes, note, number, paragraph, section, table
from .plots import model_name
from .verdict import verdict

#: file name, drawing and caption of each figure
_FIGURES = (
    ('track', plots.track, 'The drive from above. Grey: the truth. Red: what the filter made of stretches without '
     'fixes, ending at x; the dotted line leads to where the vehicle was.'),
    ('error_against_time', plots.error_against_time, 'Horizontal error against time. Grey bands: turning. Grey line: '
     'two standard deviations by the filter\'s own account; about 95 % of the errors should lie below.'),
    ('error_against_interval', plots.error_against_interval, 'RMS error against the update interval: with 95 % '
     'confidence intervals (left), in turns and on straights (right).'),
    ('manoeuvre', plots.manoeuvre, 'The turn with the largest error, at each update interval.'),
    ('outage_growth', plots.outage_growth, 'How the error grows without fixes: RMS over the outages (solid), and two '
     'standard deviations by the filter\'s own account (dashed). A solid line above its dashed one: the filter '
     'promises too much.'),
)


def report(comparisons: dict[str, Comparison], values: dict, findings: dict[str, list], said: dict[str, list[str]],
           timing: dict) -> dict:
    """The content of `report.json`. comparisons, findings of the checker, what reading said: by name of the recording.
    timing: name -> s."""
    defaults = default_parameters()
    return {
        'tool': 'replay_node', 'version': __version__,
        'recordings': [_recording(name, c, findings[name], said[name]) for name, c in comparisons.items()],
        'runs': [run_row(r, c.mechanization, name) for name, c in comparisons.items() for r in c.runs],
        'outages': [outage_row(r, c.mechanization, name) for name, c in comparisons.items() for r in c.outages],
        'comparisons': [_pair(p, name) for name, c in comparisons.items() for p in c.pairs],
        'verdict': {name: verdict(c) for name, c in comparisons.items()},
        'parameters': {name: value for name, value in values.items() if value != defaults[name]},
        'seconds': timing,
    }


def _recording(name: str, comparison: Comparison, findings: list, said: list[str]) -> dict:
    imu, gnss = comparison.recording.imu, comparison.recording.gnss
    return {'name': name, 'duration_s': float((imu.stamp[-1] - imu.stamp[0]) * 1e-9), 'imu_samples': len(imu),
            'fixes': len(gnss), 'truth': comparison.truth.source, 'truth_positions': len(comparison.truth),
            'truth_sigma_m': float(np.sqrt(np.median(comparison.truth.variance))),
            'warnings': said, 'notices': _notices(comparison),
            'findings': [{'severity': f.severity, 'topic': f.topic, 'message': f.message} for f in findings]}


def _notices(comparison: Comparison) -> list[str]:
    """What the filter said, each once."""
    return list(dict.fromkeys(n.text for r in comparison.runs for n in r.run.notices if n.level != 'info'))


def _pair(pair, name: str) -> dict:
    difference = pair.difference
    unit = 'mean_square_error_m2' if pair.duration is None else 'mean_largest_error_m'
    return {'recording': name, 'first': pair.first, 'second': pair.second, 'update_interval_s': pair.interval,
            'outage_duration_s': pair.duration, 'quantity': unit, 'first_rms_m': pair.rms[0],
            'second_rms_m': pair.rms[1], 'difference': difference.mean,
            'interval': [difference.low, difference.high], 'p_value': difference.p,
            'p_adjusted': pair.p_adjusted, 'significant': pair.significant}


def draw_figures(name: str, comparison: Comparison, folder: Path, progress=lambda: None) -> list[tuple[bytes, str]]:
    """PNG and caption of each figure, also written to `folder`. progress: called after each."""
    drawn = []
    for file, draw, caption in _FIGURES:
        drawing = draw(comparison)
        if drawing is not None:
            png = image_bytes(drawing)
            (folder / f'{name}{file}.png').write_bytes(png)
            drawn.append((png, caption))
        progress()
    return drawn


def report_page(comparisons: dict[str, Comparison], values: dict, content: dict, figures: dict[str, list]) -> str:
    """The content of `report.html`."""
    sections = []
    for name, comparison in comparisons.items():
        title = f'{name}: ' if len(comparisons) > 1 else ''
        track, *others = (figure(png, caption) for png, caption in figures[name])
        sections += [section(f'{title}Verdict', bullets(verdict(comparison)), *_warnings(name, content)),
                     section(f'{title}Track', track),
                     section(f'{title}Position errors', _run_table(comparison, content, name), *others[:3]),
                     section(f'{title}Outages', _outage_table(comparison, content, name), *others[3:])]
    sections += [_recordings(content), _settings(values, content), _explanation()]
    names = ', '.join(comparisons)
    return html.page('Which sensor error model is best?', sections,
                     f'{names}: {values["mechanization"]} mechanization, '
                     f'{len(content["runs"])} runs. Errors are measured against: {_truths(comparisons)}.')


def _truths(comparisons) -> str:
    return ', '.join(dict.fromkeys(c.truth.source for c in comparisons.values()))


def _warnings(name, content):
    recording = next(r for r in content['recordings'] if r['name'] == name)
    return [note(text, 'warning') for text in (
        *recording['warnings'], *(f['message'] for f in recording['findings'] if f['severity'] != 'info'))]


def _run_table(comparison: Comparison, content: dict, name: str):
    rows = [[model_name(comparison, r['model']), r['update_interval_s'], r['horizontal_rmse_m'],
             _interval(r['horizontal_rmse_interval_m']), r['horizontal_median_m'], r['horizontal_p95_m'],
             r['horizontal_max_m'], r['along_track_rmse_m'], r['cross_track_rmse_m'], r['turning_rmse_m'],
             r['straight_rmse_m'], r['heading_rmse_deg'], r['speed_rmse_mps'], r['nis_mean'], r['within_95_percent']]
            for r in content['runs'] if r['recording'] == name]
    columns = ['model', 'fixes each, s', 'RMS, m', '95 % interval of it', 'median, m', '95 %, m', 'max, m', 'along, m',
               'across, m', 'turns, m', 'straights, m', 'heading, deg', 'speed, m/s', 'NIS', 'inside 95 % ellipse, %']
    dropped = [i for i in range(len(columns)) if all(row[i] is None for row in rows)]
    keep = [i for i in range(len(columns)) if i not in dropped]
    return table([columns[i] for i in keep], [[row[i] for i in keep] for row in rows],
                 'Horizontal position error of each run.', digits=3)


def _interval(bounds) -> str | None:
    return None if bounds is None else f'{number(bounds[0], 3)} to {number(bounds[1], 3)}'


def _outage_table(comparison: Comparison, content: dict, name: str):
    rows = [[model_name(comparison, r['model']), r['duration_s'], r['count'], r['max_error_rms_m'],
             r['max_error_median_m'], r['max_error_p95_m'], r['percent_of_distance'], r['within_95_percent']]
            for r in content['outages'] if r['recording'] == name]
    if not rows:
        return paragraph('No outages were asked for.')
    return table(['model', 'duration, s', 'outages', 'RMS, m', 'median, m', '95 %, m', '% of distance',
                  'inside 95 % ellipse, %'], rows, 'Largest horizontal error in each outage.', digits=3)


def _recordings(content: dict):
    rows = [[r['name'], r['duration_s'], r['imu_samples'], r['fixes'], r['truth'], r['truth_positions']]
            for r in content['recordings']]
    said = [f"{r['name']}: {text}" for r in content['recordings'] for text in r['notices']]
    found = [f"{r['name']}, {f['severity']}: {f['message']}" for r in content['recordings'] for f in r['findings']]
    columns = ['name', 'duration, s', 'IMU samples', 'fixes', 'truth', 'positions of it']
    return section('Recordings', table(columns, rows, digits=8),
                   paragraph('Findings of the checker:') if found else '', bullets(found) if found else '',
                   paragraph('What the filter said:') if said else '', bullets(said) if said else '')


def _settings(values: dict, content: dict):
    rows = [[name, str(value)] for name, value in content['parameters'].items()]
    seconds = ', '.join(f'{name} {number(s, 3)} s' for name, s in content['seconds'].items())
    return section('Settings', table(['parameter', 'value'], rows, 'Parameters that are not at their default.') if rows
                   else paragraph('All parameters are at their defaults.'), paragraph(f'CPU time: {seconds}.'))


def _explanation():
    return section('How to read this', bullets([
        'Each run is the same recording through the same filter, with another model of the sensor errors or with fewer '
        'fixes. Errors are estimate minus truth at the antenna; trajectories are not aligned to each other.',
        'Fixes that the filter used are no truth for it, unless noise was added to them: without a reference only '
        'withheld fixes count.',
        'Until the filter has started it is given every fix; only then are they thinned out. All runs of a recording '
        'are judged over the same time.',
        'Turns: the vehicle turns faster than 5 degrees per second, 2 s before and after included.',
        'NIS, the normalized innovation squared, compares each fix with the filter\'s prediction and its covariance. '
        'Its mean is 2 for a filter that judges itself rightly.',
        'Outages: each is a run of its own in which fixes are withheld once; the error counts from the last fix used.',
        'A difference between models is called significant when a block bootstrap of the paired differences gives an '
        'adjusted p below 5 % (Holm, over all comparisons on the recording).']))


def write_report(folder: Path, content: dict, page: str) -> None:
    (folder / 'report.json').write_text(json.dumps(content, indent=1, allow_nan=False) + '\n', encoding='utf-8')
    (folder / 'report.html').write_text(page, encoding='utf-8')


def summary_table(content: dict) -> str:
    """The position error of each run, and the outages, as text for a terminal."""
    lines = [f"{'model':<16}{'fixes each':>11}{'RMS':>9}{'95 %':>9}{'max':>9}{'NIS':>10}"]
    several = len(content['recordings']) > 1
    for r in content['runs']:
        lines.append(f"{r['model']:<16}{r['update_interval_s']:>9g} s{r['horizontal_rmse_m']:>7.2f} m"
                     f"{r['horizontal_p95_m']:>7.2f} m{r['horizontal_max_m']:>7.2f} m"
                     f"{number(r['nis_mean'], 3):>10}" + (f"  {r['recording']}" if several else ''))
    if any(r['count'] for r in content['outages']):
        lines.append(f"{'model':<16}{'outage':>11}{'RMS':>9}{'median':>9}{'95 %':>9}{'count':>7}")
    for r in (r for r in content['outages'] if r['count']):
        lines.append(f"{r['model']:<16}{r['duration_s']:>9g} s{r['max_error_rms_m']:>7.2f} m"
                     f"{r['max_error_median_m']:>7.2f} m{r['max_error_p95_m']:>7.2f} m{r['count']:>7}"
                     + (f"  {r['recording']}" if several else ''))
    return '\n'.join(lines)
