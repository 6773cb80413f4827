"""Two replays side by side: paired statistics, one page. What `compare` does but its options."""
from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import __version__
from ..evaluation.bootstrap import Difference, holm, paired
from ..evaluation.comparison import SIGNIFICANCE
from ..evaluation.metrics import rms
from . import colours, html
from .answer import GOOD, WARNING, Answer, Step, held_text
from .html import number
from .track import Layer, script, track

#: 95 % ellipses that hold the truth less often than this, %, are too small
COVERED = 85.0
#: differences smaller than this part are of no practical meaning, however significant
PRACTICAL = 0.02


class CompareError(ValueError):
    """Two results that cannot be compared: one line that says why."""


@dataclass(frozen=True)
class Series:
    """Errors by time: stamp (n,) ns, error (n,) m, and east and north of truth and estimate, (n, 2) m each; of outages
    the begin and the largest error, and whether the 95 % ellipse held the truth, (n,)."""

    stamp: np.ndarray
    error: np.ndarray
    truth: np.ndarray | None = None
    estimate: np.ndarray | None = None
    within: np.ndarray | None = None


@dataclass(frozen=True)
class Result:
    """One replay. runs: by (recording, model, interval); outages: by (recording, model, duration)."""

    name: str
    recordings: list[str]
    models: list[str]
    runs: dict[tuple, Series]
    outages: dict[tuple, Series]


@dataclass(frozen=True)
class Row:
    """One quantity of both. duration: of outages, s, else None. paired: over the epochs that both have, count of them;
    p: of no difference, all rows counted, None where they share too few epochs."""

    recording: str
    models: tuple[str, str]
    interval: float
    duration: float | None
    rms: tuple[float, float]
    median: tuple[float, float]
    within: tuple[float | None, float | None]
    count: int
    difference: Difference | None
    p: float | None

    @property
    def better(self) -> int | None:
        """0 or 1 for the one that is better for certain and by more than nobody would notice, else None."""
        low, high = sorted(self.rms)
        if self.p is None or self.p >= SIGNIFICANCE or high <= (1 + PRACTICAL) * low:
            return None
        return int(self.difference.mean > 0)


def read_result(folder, name: str) -> Result:
    """The replay in `folder`. CompareError where it is none."""
    folder = Path(folder)
    try:
        content = json.loads((folder / 'report.json').read_text(encoding='utf-8'))
    except (OSError, ValueError):
        raise CompareError(f'{folder} is not a result of replay_node: it has no readable report.json') from None
    if not isinstance(content, dict) or content.get('tool') != 'replay_node':
        raise CompareError(f'{folder} is not a result of replay_node')
    recordings = [r['name'] for r in content['recordings']]
    runs, outages = {}, {}
    offset = round(content['parameters'].get('gnss.time_offset', 0.0) * 1e9)
    try:
        for recording, truth_source in ((r['name'], r['truth']) for r in content['recordings']):
            # by the fixes' own stamps, so that the same epochs are compared whatever a replay says of the clocks
            delay = offset if truth_source == 'fixes' else 0
            prefix = f'{recording}_' if len(recordings) > 1 else ''
            truth = _tum(folder / f'{prefix}truth.tum')
            for run in (r for r in content['runs'] if r['recording'] == recording):
                model, interval = run['model'], run['update_interval_s']
                estimate = _tum(folder / f'{prefix}{model}_{interval:g}s.tum')
                runs[recording, model, interval] = _series(truth, estimate, delay)
            for (model, duration), series in _outages(folder / f'{prefix}outages.csv', offset).items():
                outages[recording, model, duration] = series
    except (OSError, ValueError, KeyError) as error:
        raise CompareError(f'{folder}: {error}; replay the recording again with this version') from None
    return Result(name, recordings, list(dict.fromkeys(r['model'] for r in content['runs'])), runs, outages)


def _tum(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) ns and east and north (n, 2) m."""
    stamps, positions = [], []
    with open(path, encoding='ascii') as file:
        for line in file:
            if not line.startswith('#'):
                time, east, north, *_ = line.split()
                seconds, _, fraction = time.partition('.')
                stamps.append(int(seconds) * 10**9 + int(fraction.ljust(9, '0')[:9] or 0))
                positions.append((float(east), float(north)))
    return np.array(stamps, dtype=np.int64), np.array(positions).reshape(-1, 2)


def _series(truth, estimate, delay: int) -> Series:
    stamp, a, b = np.intersect1d(truth[0], estimate[0], return_indices=True)
    positions = truth[1][a], estimate[1][b]
    return Series(stamp + delay, np.hypot(*(positions[1] - positions[0]).T), *positions)


def _outages(path: Path, offset: int) -> dict[tuple, Series]:
    found: dict[tuple, list] = {}
    with open(path, encoding='ascii', newline='') as file:
        for row in csv.DictReader(file):
            found.setdefault((row['model'], float(row['duration_s'])), []).append(
                (int(row['begin_ns']) + offset, float(row['max_error_m']), row['within_95'] == '1'))
    return {key: Series(np.array([r[0] for r in rows], dtype=np.int64), np.array([r[1] for r in rows]),
                        within=np.array([r[2] for r in rows])) for key, rows in found.items()}


def rows_of(first: Result, second: Result) -> list[Row]:
    """All quantities that both have, judged together (Holm). CompareError where there are none.

    Recordings are matched in their order; models by name, or, where the two share none, the first of each.
    """
    shared = [m for m in first.models if m in second.models]
    models = [(m, m) for m in shared] or [(first.models[0], second.models[0])]
    found = []
    for one, other in zip(first.recordings, second.recordings):
        for a, b in models:
            for kind in ('runs', 'outages'):
                mine, theirs = getattr(first, kind), getattr(second, kind)
                sizes = sorted({size for name, model, size in mine if (name, model) == (one, a)}
                               & {size for name, model, size in theirs if (name, model) == (other, b)})
                found += [_row(one, (a, b), kind, size, mine[one, a, size], theirs[other, b, size]) for size in sizes]
    found = [row for row in found if row is not None]
    if not found:
        raise CompareError(f'{first.name} and {second.name} have no update interval or outage in common')
    tested = [row for row in found if row.difference is not None]
    adjusted = dict(zip(map(id, tested), holm([row.difference.p for row in tested])))
    return [Row(**{**vars(row), 'p': adjusted.get(id(row))}) for row in found]


def _row(recording, models, kind, size, mine: Series, theirs: Series) -> Row | None:
    if not len(mine.stamp) or not len(theirs.stamp):
        return None
    _, a, b = np.intersect1d(mine.stamp, theirs.stamp, return_indices=True)
    enough = len(a) > 0.5 * min(len(mine.stamp), len(theirs.stamp))
    x, y = (mine.error[a], theirs.error[b]) if enough else (mine.error, theirs.error)
    outage = kind == 'outages'
    within = tuple(100 * float(s.within[i if enough else slice(None)].mean()) if outage else None
                   for s, i in ((mine, a), (theirs, b)))
    difference = (paired(x, y) if outage else paired(x**2, y**2)) if enough else None
    return Row(recording, models, 0.0 if outage else size, size if outage else None, (rms(x), rms(y)),
               (float(np.median(x)), float(np.median(y))), within, len(a) if enough else 0, difference, None)


def answer(first: Result, second: Result, rows: list[Row]) -> Answer:
    """Which of the two is better, and by how much without fixes."""
    names = first.name, second.name
    better = {row.better for row in rows} - {None}
    unpaired = [row for row in rows if not row.count]
    wrong = ['The two share too few epochs for paired statistics: the errors stand side by side, and a difference may '
             'be one of the drives.'] if unpaired else []
    trust = ''
    if len(better) == 1:
        best = better.pop()
        held = min((row.within[best] for row in rows if row.within[best] is not None), default=None)
        if held is not None:
            whether = 'That of' if held >= COVERED else 'Not even that of'
            trust = f'{whether} {names[best]}, whose 95 % ellipse held the truth {held_text(held)}.'
        certain = sum(row.better is not None for row in rows)
        headline = (f'{names[best]} is better: {_headline_row(rows, best, names)}; certain in {certain} of {len(rows)} '
                    'comparisons, and in none is the other.')
        steps = [Step(f'Use {names[best]}.')]
    elif better:
        headline = 'Each is better at something: see the table.'
        steps = [Step('Decide by what the vehicle needs: the rows with fixes, or those of the outages that it meets.')]
    else:
        headline = f'No certain difference between {names[0]} and {names[1]}.'
        steps = [Step('Take the simpler one, or compare them on a longer recording.')]
    return Answer(GOOD if len({row.better for row in rows} - {None}) == 1 else WARNING, headline, wrong,
                  [_cost(row, names) for row in rows if row.duration is not None], steps, trust)


def _headline_row(rows: list[Row], best: int, names) -> str:
    row = max((r for r in rows if r.better == best), key=lambda r: (r.duration is not None, max(r.rms) / min(r.rms)))
    errors = [number(value, 3) for value in row.rms]
    return f'{_what(row)}, {errors[best]} m instead of {errors[1 - best]} m RMS'


def _what(row: Row) -> str:
    if row.duration is not None:
        return f'largest error in {row.duration:g} s without fixes'
    return f'error with fixes each {row.interval:g} s' if row.interval else 'error with all fixes'


def _cost(row: Row, names) -> str:
    texts = [f'{name} {number(median, 2)} m (its 95 % ellipse held the truth in {number(within, 2)} %)'
             for name, median, within in zip(names, row.median, row.within)]
    of = f' of {row.count} outages' if row.count else ''
    model = f', {colours.MODEL_NAMES[row.models[0]]}' if row.models[0] == row.models[1] else ''
    return f'{row.duration:g} s{model}: {texts[0]}, {texts[1]}; median{of}'


def report(first: Result, second: Result, rows: list[Row], answered: Answer) -> dict:
    """The content of `report.json`."""
    return {'tool': 'compare', 'version': __version__, 'first': first.name, 'second': second.name,
            'answer': answered.json(),
            'rows': [{'recording': r.recording, 'models': list(r.models), 'update_interval_s': r.interval or None,
                      'outage_duration_s': r.duration, 'paired': r.count, 'rms_m': list(r.rms),
                      'median_m': list(r.median), 'within_95_percent': list(r.within),
                      'p_adjusted': r.p, 'better': None if r.better is None else (first, second)[r.better].name}
                     for r in rows]}


def report_page(first: Result, second: Result, rows: list[Row], answered: Answer) -> str:
    """The content of `report.html`."""
    names = first.name, second.name
    table = html.table(
        ('recording and model', 'error', 'compared', 'A, RMS m', 'B, RMS m', 'A, median m', 'B, median m',
         'inside 95 % ellipse, A / B, %', 'p', 'better'),
        [(f'{r.recording}, ' + ' / '.join(dict.fromkeys(colours.MODEL_NAMES[m] for m in r.models)), _what(r),
          r.count or None, *r.rms, *r.median,
          '–' if None in r.within else ' / '.join(number(share, 2) for share in r.within), _p(r.p),
          '–' if r.better is None else 'AB'[r.better]) for r in rows],
        f'A: {names[0]}. B: {names[1]}. Over the epochs, or outages, that both have.', 3)
    drawn = layers(first, second, rows)
    return html.page(f'{names[0]} against {names[1]}', [
        html.section('Which is better?', answered.html(), *([track(drawn, _still(drawn))] if drawn else []), table),
        html.folded('How to read this', html.bullets([
            'Both went through the same protocol; errors are estimate minus truth at the same epochs, outages those '
            'that begin at the same fix.',
            'p: that of no difference, by a block bootstrap of the paired differences (squared errors, or largest '
            'errors of outages), adjusted for all rows (Holm). Better means p below 5 % and more than 2 %.']))],
        script=script())


def layers(first: Result, second: Result, rows: list[Row]) -> list[Layer]:
    """The truth and both tracks, at the shortest interval that both have; none where they share no epochs."""
    row = next((r for r in rows if r.duration is None and r.count), None)
    if row is None:
        return []
    mine = first.runs[row.recording, row.models[0], row.interval]
    place = first.recordings.index(row.recording)
    theirs = second.runs[second.recordings[place], row.models[1], row.interval]
    stamp, a, b = np.intersect1d(mine.stamp, theirs.stamp, return_indices=True)
    truth, time = mine.truth[a], (stamp - stamp[0]) * 1e-9
    found = [Layer('truth', colours.TRUTH, time, *truth.T, {}, 6.0)]
    # by their errors: each replay has its own origin
    for name, series, at, colour, width in ((first.name, mine, a, colours.FIRST, 3.0),
                                            (second.name, theirs, b, colours.SECOND, 1.8)):
        east, north = (truth + series.estimate[at] - series.truth[at]).T
        found.append(Layer(name, colour, time, east, north, {'error': series.error[at]}, width))
    return found


def _still(drawn: list[Layer]) -> html.Html:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 7), layout='constrained')
    axes = figure.add_subplot()
    for layer in drawn:
        axes.plot(layer.east, layer.north, color=layer.colour, linewidth=0.7 * layer.width, label=layer.name)
    axes.set_aspect('equal', adjustable='datalim')
    axes.set(xlabel='east, m', ylabel='north, m')
    axes.legend(fontsize=8, loc='upper left')
    return html.figure(figure, 'The drive from above.')


def _p(value: float | None) -> str:
    """A p value, as people write it."""
    return '–' if value is None else '< 0.001' if value < 0.001 else number(value, 2)


def table_text(first: Result, second: Result, rows: list[Row]) -> str:
    """The rows as text for a terminal."""
    lines = [f'A: {first.name}', f'B: {second.name}', f"{'error':<46}{'A, RMS':>11}{'B, RMS':>11}{'p':>9}  better"]
    for r in rows:
        model = ' / '.join(dict.fromkeys(r.models))
        p = _p(r.p)
        lines.append(f'{_what(r).replace("largest error in ", "")}, {model}'.ljust(46)
                     + ''.join(f'{number(v, 3):>9} m' for v in r.rms)
                     + f"{p:>9}  {'-' if r.better is None else 'AB'[r.better]}")
    return '\n'.join(lines)
