"""`fleet.html`: statements about the fleet, vehicles that differ or have changed, and a table of all recordings."""
from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np

from ..recordings.remarks import count_of
from ..reports import html
from ..reports.answer import GOOD, WARNING, Answer, Step
from ..reports.html import Html, bullets, empty_figure, figure, folded, note, number, paragraph, section, table
from . import population
from .change_points import QUANTITIES, day

#: script of the table of recordings; it uses no library and no network
_SCRIPT = (Path(__file__).parent / 'fleet.js').read_text(encoding='ascii')
#: columns of the table of recordings
_COLUMNS = ('vehicle', 'begin', 'recording', 'status', 'length, min', 'error, m', 'reason')
#: largest number of lines of one kind; further ones are counted
_MOST = 200
#: the same in the answer, at the top of the page
_MOST_SAID = 20
#: largest number of vehicles in a figure
_MOST_DRAWN = 60


def page(fleet, estimates: list[dict]) -> str:
    """The page. estimates: of each vehicle over time, by `history.estimates`."""
    rows, asked = fleet.rows, fleet.asked
    wrong = fleet.not_usable()
    ids = {recording_id for some in wrong.values() for recording_id in some}
    errors = population.errors_of(*([row for row in rows[name] if row['recording_id'] not in ids]
                                    for name in ('results', 'outages')))
    standings = population.standings(errors)
    effects = population.by_effect(rows['effects'])
    strange = _strange(errors, effects)
    vehicles = {row['vehicle'] for row in rows['recordings']}
    answered = answer(fleet, standings, strange)
    parts = [section('How is the fleet?', answered.html(), *map(note, fleet.said), _counts(fleet))]
    if fleet.changes:
        parts.append(section('What changed, and when', _changes(fleet)))
    if wrong:
        parts.append(section('Not usable with these parameters', _not_usable(wrong)))
    if standings:
        parts.append(section('Which model wins where', *_standings(standings)))
    if strange:
        parts.append(section('Vehicles that are not as the others', _outliers(strange)))
    if effects:
        parts.append(folded('The vehicles, effect by effect', *_effects(effects)))
    if estimates:
        parts.append(folded('Each vehicle over time', *_histories(fleet, estimates)))
    parts += [section('Recordings', _recordings(rows)), folded('What failed', *_failures(rows)), _explanation()]
    return html.page(f'Fleet: {asked.task}', parts, f'{len(rows["recordings"])} recordings of {len(vehicles)} vehicles '
                     f'from {asked.source}', Html(f'<script>\n{_SCRIPT}</script>\n'))


def answer(fleet, standings, strange) -> Answer:
    """The most important statements."""
    done, failed, left = (fleet.count(status) for status in ('done', 'failed', 'open'))
    changed = sorted({c.vehicle for c in fleet.changes})
    wrong = [f'{c.vehicle}: {c.words()}'.replace('+-', '\N{PLUS-MINUS SIGN}') for c in fleet.changes[:_MOST_SAID]]
    wrong += [f'{o.vehicle} is not as the others: {o.what} {number(o.value, 3)} {o.unit}, median of all '
              f'{number(o.middle, 3)}' for o in strange[:_MOST_SAID]]
    wrong += [f'{vehicle}: {count_of(len(some), "recording")} not usable: {next(iter(some.values()))}'
              for vehicle, some in list(fleet.not_usable().items())[:_MOST_SAID]]
    wrong += [f'{count_of(failed, "recording")} without a result; see below why.'] if failed else []
    said = [f'{count_of(len(changed), "vehicle")} changed'] if changed else ['no vehicle changed']
    if failed or left:
        said.append(f'{failed} failed' + (f', {left} left to do' if left else ''))
    headline = f'{done} recordings are done: {", ".join(said)}.'
    best = [s for s in standings if not s.answer and s.where.without]
    cost = [f'{s.where.words()}: {number(s.mean, 3)} m, the best of all with '
            f'{s.candidate.words(len({b.candidate.params_file for b in standings}) > 1)}' for s in best]
    steps = [Step('Run the same command again: what is done is not done again.')] if left else []
    return Answer(WARNING if wrong or left else GOOD, headline, wrong, cost, steps)


def _counts(fleet) -> Html:
    counts = Counter(row['status'] for row in fleet.rows['recordings'])
    return table(['status', 'recordings'], sorted(counts.items()))


def _changes(fleet) -> Html:
    rows = [[c.vehicle, c.quantity.words, c.step, c.sigma, c.quantity.unit, day(c.last), day(c.first),
             f'{c.drives[0]} and {c.drives[1]}', c.p] for c in fleet.changes[:_MOST]]
    return table(['vehicle', 'what', 'by', '\N{PLUS-MINUS SIGN}', 'unit', 'last drive before', 'first drive after',
                  'drives before and after', 'p'], rows, 'Steps in what the drives show, all places counted.', 3)


def _not_usable(wrong: dict[str, dict[str, str]]) -> Html:
    rows = [[vehicle, len(some), next(iter(some.values()))] for vehicle, some in wrong.items()]
    return table(['vehicle', 'recordings', 'for example'], rows[:_MOST],
                 'Their errors do not count below: what a wrong mounting makes of them is no property of a model.')


def _standings(standings) -> list[Html]:
    several = len({s.candidate.params_file for s in standings}) > 1
    rows = [[s.where.words(), s.candidate.words(several), s.mean,
             None if s.low is None else f'{number(s.low, 3)} to {number(s.high, 3)}', s.count,
             'best' if not s.answer else s.answer.replace('_', ' ')] for s in standings]
    units = {s.unit for s in standings}
    said = 'Each vehicle counts once.' if units == {population.VEHICLES} else (
        'There are too few vehicles for a statement on vehicles: each recording counts once, and what is said holds '
        'for these vehicles only.')
    return [paragraph(said), table(['where', 'what', 'error, m', '95 % interval', 'count', 'against the best'], rows,
                                   'RMS position error with fixes, and of the largest errors without.', 3)]


def _strange(errors: population.Errors, effects) -> list[population.Outlier]:
    found = []
    for (_, effect, parameter, unit), vehicles in effects.items():
        quantity = QUANTITIES.get((effect, parameter))
        if quantity is not None:
            scale = 1.0 if quantity.ratio else quantity.scale
            found += population.outliers({v: scale * x for v, x in vehicles.items()}, quantity.words,
                                         unit if quantity.ratio else quantity.unit)
    for where, candidates in errors.items():
        candidate = min(candidates, key=lambda c: float(np.mean(list(candidates[c].values()))))
        by_vehicle: dict[str, list] = {}
        for (vehicle, _), error in candidates[candidate].items():
            by_vehicle.setdefault(vehicle, []).append(error)
        found += population.outliers({v: float(np.mean(e)) for v, e in by_vehicle.items()},
                                     f'error, {where.words()},', 'm')
    return sorted(found, key=lambda o: -o.distance)


def _outliers(strange) -> Html:
    return table(['vehicle', 'what', 'value', 'median of all', 'unit', 'standard deviations away'],
                 [[o.vehicle, o.what, o.value, o.middle, o.unit, o.distance] for o in strange[:_MOST]], digits=3)


def _effects(effects) -> list[Html]:
    rows = []
    for (source, effect, parameter, unit), vehicles in effects.items():
        values = np.array(list(vehicles.values()))
        rows.append([effect, parameter, source, len(values), *np.percentile(values, [5, 50, 95]).tolist(), unit])
    shown = [figure(_distribution(effects), 'Each dot one vehicle: the median of its recordings.')] if rows else []
    return [*shown, table(['effect', 'parameter', 'seen by', 'vehicles', '5 %', 'median', '95 %', 'unit'],
                          rows[:_MOST], 'Over vehicles: the median of the recordings of each.', 3)]


def _distribution(effects):
    shown = [(QUANTITIES[key[1:3]], key, vehicles) for key, vehicles in effects.items() if key[1:3] in QUANTITIES]
    drawing = empty_figure(9, 0.5 + 0.85 * max(len(shown), 1))
    panels = drawing.subplots(max(len(shown), 1), 1, squeeze=False)[:, 0]
    for axes, (quantity, (source, *_, unit), vehicles) in zip(panels, shown):
        scale = 1.0 if quantity.ratio else quantity.scale
        axes.plot(scale * np.array(list(vehicles.values())), np.zeros(len(vehicles)), 'o', alpha=0.4, color='#1b6ca8',
                  markersize=5)
        # above, as beside it there would be no room for the axis on a phone
        axes.set_title(f'{quantity.words}, {unit if quantity.ratio else quantity.unit} ({source})', fontsize=8,
                       loc='left')
        axes.set_yticks([])
        axes.locator_params(axis='x', nbins=4)
        axes.tick_params(axis='x', labelsize=7)
        axes.grid(axis='x', color='0.92')
    return drawing


def _histories(fleet, estimates: list[dict]) -> list[Html]:
    """A figure of the vehicles that changed; the others are in the files."""
    from .history import FOLDER

    changed = list(dict.fromkeys((c.vehicle, c.quantity, c.source) for c in fleet.changes))[:_MOST_DRAWN]
    said = paragraph(f'All that is known of each vehicle, by time, is in {FOLDER}/VEHICLE.csv.')
    return [said, figure(_steps(fleet, changed, estimates), 'What the drives show, with two standard deviations as '
                         'stated; lines: between which drives it changed.')] if changed else [said]


def _steps(fleet, changed, estimates):
    drawing = empty_figure(9, 2.2 * len(changed))
    panels = drawing.subplots(len(changed), 1, squeeze=False)[:, 0]
    for axes, (vehicle, quantity, source) in zip(panels, changed):
        rows = [r for r in estimates if (r['vehicle'], r['source'], r['effect'], r['parameter'])
                == (vehicle, source, quantity.effect, quantity.parameter) and r['value'] is not None]
        scale = 1.0 if quantity.ratio else quantity.scale
        time = np.array([r['stamp_ns'] for r in rows], dtype='datetime64[ns]')
        axes.errorbar(time, [scale * r['value'] for r in rows], [2 * scale * (r['sigma'] or 0.0) for r in rows],
                      fmt='o', color='#1b6ca8', markersize=4, linewidth=1)
        for change in fleet.changes:
            if (change.vehicle, change.quantity, change.source) == (vehicle, quantity, source):
                axes.axvspan(np.datetime64(change.last, 'ns'), np.datetime64(change.first, 'ns'), color='#c0392b',
                             alpha=0.15)
        axes.set_title(f'{vehicle}: {quantity.words}', fontsize=9)
        axes.tick_params(labelsize=7)
        axes.grid(color='0.92')
    return drawing


def _recordings(rows) -> Html:
    """All recordings as data; the script shows some of them at a time, so that 10 000 are drawn as fast as 50."""
    errors = {}
    for row in sorted(rows['results'], key=lambda r: (r['update_interval_s'] or 0.0, r['horizontal_rmse_m'] or 0.0)):
        if row['horizontal_rmse_m'] is not None and not row['stage']:
            errors.setdefault(row['recording_id'], row['horizontal_rmse_m'])
    cells = [[r['vehicle'], '' if r['begin_ns'] is None else day(r['begin_ns']), r['recording'], r['status'],
              None if r['duration_s'] is None else round(r['duration_s'] / 60, 1),
              None if r['recording_id'] not in errors or r['status'] != 'done'
              else float(f'{errors[r["recording_id"]]:.3g}'),
              f'{r["error_id"]}: {r["reason"]}' if r['error_id'] else
              f'same as {r["same_as"]}' if r['same_as'] else '', r['page'] or ''] for r in rows['recordings']]
    data = json.dumps({'columns': _COLUMNS, 'rows': cells}).replace('<', '\\u003c')
    return Html('<div class="fleet-table"><p><input type="search" placeholder="part of a name, a status, a reason" '
                'aria-label="search" style="font: inherit; padding: .2rem .5rem; width: 24rem; max-width: 100%"> '
                '<span class="said"></span></p><table><thead></thead><tbody></tbody></table>'
                '<p><button type="button" data-turn="-1">earlier</button> '
                '<button type="button" data-turn="1">later</button></p>'
                f'<script type="application/json">{data}</script>'
                '<noscript><p>The table is in tables/recordings.csv.</p></noscript></div>')


def _failures(rows) -> list[Html]:
    failed = [r for r in rows['recordings'] if r['status'] == 'failed']
    if not failed:
        return [paragraph('Nothing did.')]
    counts = Counter(r['error_id'] for r in failed)
    first = {r['error_id']: r['reason'] for r in reversed(failed)}
    return [table(['error', 'recordings', 'for example'], [[e, n, first[e]] for e, n in counts.most_common(_MOST)])]


def _explanation() -> Html:
    return folded('How to read this', bullets([
        'The vehicle is the unit: a hundred recordings of one car count as one car. Intervals are Student\'s t over '
        'vehicles. With fewer than three vehicles recordings are the unit, which says nothing of other vehicles.',
        'A change is a step in what the drives of a vehicle show, tested against how much neighbouring drives of all '
        'vehicles really differ; in a fleet in which nothing changed one is found in one of a hundred runs.',
        'A vehicle is not as the others where it is more than four robust standard deviations from their median.',
        'The same recording under two names counts once. All numbers: tables/*.csv, and Parquet where pyarrow is '
        'installed.']))
