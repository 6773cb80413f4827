"""Two replays side by side: paired statistics and one page; the work of the tool `compare`."""
from __future__ import annotations

import csv
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .. import __version__
from ..errors import InputError
from ..evaluation.metrics import rms
from ..evaluation.verdict import (
    BETTER,
    CANNOT_TELL,
    SAME,
    WORSE,
    Change,
    Consistency,
    Trust,
    Verdict,
    change_in_outages,
    change_with_fixes,
    decide,
    trust_in_sigmas,
)
from ..guard import one_line
from ..samples import SECOND
from . import colours, html
from .answer import GOOD, WARNING, Answer, Step
from .html import number
from .track import Layer, script, track
from .verdict import because, change_text, span_text, trust_text, verdict_json


class CompareError(InputError):
    """Two results that cannot be compared; the text is one line with the reason."""


@dataclass(frozen=True)
class ErrorSeries:
    """Errors by time: stamp (n,) ns, error (n,) m, and east and north of truth and estimate, (n, 2) m. independent:
    whether the truth is more than the fixes that the filter was given. Of outages: the begin and the largest error,
    whether the 95 % ellipse contained the truth, and the mean normalized squared error, (n,)."""

    stamp: np.ndarray
    error: np.ndarray
    truth: np.ndarray | None = None
    estimate: np.ndarray | None = None
    within: np.ndarray | None = None
    nees: np.ndarray | None = None
    independent: bool = True

    def apart(self, duration: float) -> int:
        """Number of these outages of `duration` s that do not overlap."""
        return len(np.unique((self.stamp - self.stamp[0]) // round(duration * 1e9))) if len(self.stamp) else 0


@dataclass(frozen=True)
class Result:
    """One replay. models: the one that represents it, which is the best, comes first. runs: by (recording, model,
    interval); outages: by (recording, model, duration). fitted_here: the recordings that its parameters were fitted to.
    """

    name: str
    recordings: list[str]
    models: list[str]
    runs: dict[tuple, ErrorSeries]
    outages: dict[tuple, ErrorSeries]
    fitted_here: tuple[str, ...] = ()


@dataclass(frozen=True)
class Row:
    """One quantity of both. duration: of outages, s, else None. count: number of common epochs, 0 if they are too few.
    change: of the second relative to the first at these. decides: whether it counts for the verdict; not if the truth
    is the fixes that the filters were given."""

    recording: str
    models: tuple[str, str]
    interval: float
    duration: float | None
    rms: tuple[float, float]
    median: tuple[float, float]
    within: tuple[float | None, float | None]
    count: int
    change: Change | None
    decides: bool


def read_result(folder, name: str) -> Result:
    """The replay in `folder`. CompareError if there is none."""
    folder = Path(folder)
    try:
        content = json.loads((folder / 'report.json').read_text(encoding='utf-8'))
    except (OSError, ValueError):
        raise CompareError(f'{folder} is not a result of replay_node: it has no readable report.json') from None
    if not isinstance(content, dict) or content.get('tool') != 'replay_node':
        raise CompareError(f'{folder} is not a result of replay_node')
    runs, outages = {}, {}
    try:
        recordings = [r['name'] for r in content['recordings']]
        offset = round(content['parameters'].get('gnss.time_offset', 0.0) * 1e9)
        best = content['sensor_error_model']
        for recording, truth_source in ((r['name'], r['truth']) for r in content['recordings']):
            # by the stamps of the fixes, so that the epochs are the same with any time offset
            delay = offset if truth_source == 'fixes' else 0
            prefix = f'{recording}_' if len(recordings) > 1 else ''
            truth = _tum(folder / f'{prefix}truth.tum')
            for run in (r for r in content['runs'] if r['recording'] == recording):
                model, interval = run['model'], run['update_interval_s']
                estimate = _tum(folder / f'{prefix}{model}_{interval:g}s.tum')
                runs[recording, model, interval] = _series(truth, estimate, delay, run['independent_truth'])
            for (model, duration), series in _outages(folder / f'{prefix}outages.csv', offset).items():
                outages[recording, model, duration] = series
        fitted = tuple(r['name'] for r in content['recordings'] if r.get('fitted_to_it'))
        models = list(dict.fromkeys([best, *(r['model'] for r in content['runs'])]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CompareError(f'{folder}: {type(error).__name__}: {one_line(error)}; replay the recording again with this '
                           'version') from None
    return Result(name, recordings, models, runs, outages, fitted)


def _tum(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) ns and east and north (n, 2) m."""
    stamps, positions = [], []
    with open(path, encoding='ascii') as file:
        for line in file:
            if not line.startswith('#'):
                time, east, north, *_ = line.split()
                seconds, _, fraction = time.partition('.')
                stamps.append(int(seconds) * SECOND + int(fraction.ljust(9, '0')[:9] or 0))
                positions.append((float(east), float(north)))
    return np.array(stamps, dtype=np.int64), np.array(positions).reshape(-1, 2)


def _series(truth, estimate, delay: int, independent: bool) -> ErrorSeries:
    stamp, a, b = np.intersect1d(truth[0], estimate[0], return_indices=True)
    positions = truth[1][a], estimate[1][b]
    return ErrorSeries(stamp + delay, np.hypot(*(positions[1] - positions[0]).T), *positions, independent=independent)


def _outages(path: Path, offset: int) -> dict[tuple, ErrorSeries]:
    found: dict[tuple, list] = {}
    with open(path, encoding='ascii', newline='') as file:
        for row in csv.DictReader(file):
            found.setdefault((row['model'], float(row['duration_s'])), []).append(
                (int(row['begin_ns']) + offset, float(row['max_error_m']), row['within_95'] == '1', float(row['nees'])))
    return {key: ErrorSeries(np.array([r[0] for r in rows], dtype=np.int64), np.array([r[1] for r in rows]),
                             within=np.array([r[2] for r in rows]), nees=np.array([r[3] for r in rows]))
            for key, rows in found.items()}


def rows_of(first: Result, second: Result) -> list[Row]:
    """All quantities that both have, with a correction for multiple tests (Holm). CompareError if there are none.

    Recordings are matched by their order; of the models first those that represent the replays, then those of equal
    name.
    """
    shared = [(m, m) for m in first.models if m in second.models]
    models = list(dict.fromkeys([(first.models[0], second.models[0]), *shared]))
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
    return found


def _row(recording, models, kind, size, mine: ErrorSeries, theirs: ErrorSeries) -> Row | None:
    if not len(mine.stamp) or not len(theirs.stamp):
        return None
    _, a, b = np.intersect1d(mine.stamp, theirs.stamp, return_indices=True)
    enough = len(a) > 0.5 * min(len(mine.stamp), len(theirs.stamp))
    x, y = (mine.error[a], theirs.error[b]) if enough else (mine.error, theirs.error)
    outage = kind == 'outages'
    within = tuple(100 * float(s.within[i if enough else slice(None)].mean()) if outage else None
                   for s, i in ((mine, a), (theirs, b)))
    decides = mine.independent and theirs.independent
    change = None
    if enough:
        change = change_in_outages(size, x, y, mine.apart(size), where=recording) if outage else \
            change_with_fixes(x, y, where=recording, every=size)
    return Row(recording, models, 0.0 if outage else size, size if outage else None, (rms(x), rms(y)),
               (float(np.median(x)), float(np.median(y))), within, len(a) if enough else 0, change, decides)


def comparison_verdict(first: Result, second: Result, rows: list[Row]) -> Verdict:
    """Whether the second is better than the first, by the models that represent them."""
    several, judged_by = len(first.recordings) > 1, (first.models[0], second.models[0])
    changes = [row.change if several else replace(row.change, where='') for row in rows
               if row.change is not None and row.decides and row.models == judged_by]
    verdict = decide(changes)
    # a gain on the data that the parameters were fitted to is no proof
    winner = {BETTER: second, WORSE: first}.get(verdict.answer)
    return replace(verdict, answer=CANNOT_TELL, fitted_here=True) if winner and winner.fitted_here else verdict


def trust_of(result: Result) -> Trust:
    """Whether the sigmas of a replay are right, by its outages."""
    model = result.models[0]
    return trust_in_sigmas([Consistency(duration, s.nees, s.within, s.apart(duration))
                            for (recording, name, duration), s in result.outages.items()
                            if name == model and recording == result.recordings[0]])


def answer(first: Result, second: Result, rows: list[Row]) -> Answer:
    """Which of the two is better, with the interval of the difference."""
    names = first.name, second.name
    if all(row.count and row.rms[0] == row.rms[1] and row.median[0] == row.median[1] for row in rows):
        return Answer(WARNING, f'No difference between {names[0]} and {names[1]}: all their errors are equal.', [], [],
                      [Step('Use either: the filter does the same with both.'
                            if all(row.within[0] == row.within[1] for row in rows) else
                            'Use the one whose ellipse holds more nearly 95 % of its errors (see the table).')])
    verdict = comparison_verdict(first, second, rows)
    wrong = [_why_unpaired(rows)] if not all(row.count for row in rows) else []
    wrong += [f'{r.name} was fitted to this recording, where a smaller error proves nothing. Compare on another drive.'
              for r in (first, second) if r.fitted_here]
    best = {BETTER: second, WORSE: first}.get(verdict.answer)
    trust = '' if best is None else f'{best.name}: {trust_text(trust_of(best))}'
    further = 'Replay both on the same drive, or a longer one.' if verdict.shown is None else \
        'Compare them on another drive, or a longer one.'
    step = Step(further if best is None else f'Use {best.name}.')
    return Answer(GOOD if best is not None else WARNING, _headline(verdict, names), wrong, [], [step], trust,
                  why=because(verdict))


def _why_unpaired(rows: list[Row]) -> str:
    """Why some of `rows` are not compared epoch by epoch, or outage by outage."""
    if all(row.count for row in rows if row.duration is None):
        return ('Without fixes they are not compared: the outages of the two begin at other fixes, as outage_spacing '
                'or the version that replayed them is another one. Their errors stand in the table.')
    return ('The two have too few epochs in common for paired statistics, as they are of different drives, or of a '
            'short one. Their errors stand in the table; a difference may be one of the drives.')


def _headline(verdict: Verdict, names) -> str:
    if verdict.shown is None:
        return f'Cannot tell {names[1]} from {names[0]}: too few of their errors are of the same times.'
    proof, turned = (change_text(change, verdict.level) for change in (verdict.shown, verdict.shown.turned))
    if verdict.answer in (BETTER, WORSE):
        return f'{names[1]} is better: {proof}.' if verdict.answer == BETTER else f'{names[0]} is better: {turned}.'
    if verdict.answer == SAME:
        return f'No difference between {names[0]} and {names[1]}: {proof}.'
    if verdict.fitted_here:
        name, proof = (names[1], proof) if verdict.gains else (names[0], turned)
        return f'No proof that {name} is better, as it was fitted to this recording: {proof}.'
    if verdict.gains and verdict.losses:
        return f'Each is better at something: with {names[1]}, {proof}; see the table.'
    return f'Cannot tell which is better: with {names[1]}, {proof}.'


def _what(row: Row) -> str:
    if row.duration is not None:
        return f'largest error in {row.duration:g} s without fixes'
    return f'error with fixes each {row.interval:g} s' if row.interval else 'error with all fixes'


def report(first: Result, second: Result, rows: list[Row], answered: Answer) -> dict:
    """The content of `report.json`."""
    level = comparison_verdict(first, second, rows).level
    return {'tool': 'compare', 'version': __version__, 'first': first.name, 'second': second.name,
            'answer': answered.json(), 'verdict': verdict_json(comparison_verdict(first, second, rows)),
            'rows': [{'recording': r.recording, 'models': list(r.models), 'update_interval_s': r.interval or None,
                      'outage_duration_s': r.duration, 'paired': r.count, 'rms_m': list(r.rms),
                      'median_m': list(r.median), 'within_95_percent': list(r.within),
                      'interval_m': r.change and r.change.interval(level), 'better': _better(r, level, first, second),
                      'independent_truth': r.decides} for r in rows]}


def _better(row: Row, level: float, first: Result, second: Result) -> str | None:
    """The name of the one that is certainly better."""
    sign = 0 if row.change is None else row.change.sign(level)
    return {-1: second.name, 1: first.name}.get(sign)


def report_page(first: Result, second: Result, rows: list[Row], answered: Answer) -> str:
    """The content of `report.html`."""
    names = first.name, second.name
    level = comparison_verdict(first, second, rows).level
    table = html.table(
        ('recording and model', 'error', 'compared', 'A, m', 'B, m', 'B against A, 95 %', 'A, median, m',
         'B, median, m',
         'inside 95 % ellipse, A / B, %'),
        [(f'{r.recording}, ' + ' / '.join(dict.fromkeys(colours.MODEL_NAMES[m] for m in r.models)), _what(r),
          r.count or None, *_numbers(r), _span(r, level), *r.median,
          '–' if None in r.within else ' / '.join(number(share, 2) for share in r.within)) for r in rows],
        f'A: {names[0]}. B: {names[1]}. Errors: root mean square over the epochs that both have, or mean of the '
        'largest error in the outages that both have.', 3)
    drawn = layers(first, second, rows)
    return html.page(f'{names[0]} against {names[1]}', [
        html.section('Which is better?', answered.html(), *([track(drawn, _still(drawn))] if drawn else []), table),
        answered.evidence(),
        html.folded('How to read this', html.bullets([
            'Both went through the same protocol; errors are estimate minus truth at the same epochs, outages those '
            'that begin at the same fix.',
            'B against A: in 95 of 100 cases all true differences lie between these, by the ratio of the mean squared '
            'errors, or of the means of the largest errors of outages, times the error of A. Better means that this is '
            'below zero for one of them and above zero for none.']))],
        script=script())


def _numbers(row: Row) -> tuple[float, float]:
    """The errors of both, m, at common epochs if they are paired."""
    return row.rms if row.change is None else (row.change.before, row.change.after)


def _span(row: Row, level: float) -> str:
    interval = None if row.change is None else row.change.interval(level)
    if interval is None:
        return 'too few'
    return span_text(*interval) + ('' if row.decides else ' (fixes that both were given)')


def layers(first: Result, second: Result, rows: list[Row]) -> list[Layer]:
    """The truth and both tracks, at the shortest common interval; none without common epochs."""
    row = next((r for r in rows if r.duration is None and r.count), None)
    if row is None:
        return []
    mine = first.runs[row.recording, row.models[0], row.interval]
    place = first.recordings.index(row.recording)
    theirs = second.runs[second.recordings[place], row.models[1], row.interval]
    stamp, a, b = np.intersect1d(mine.stamp, theirs.stamp, return_indices=True)
    truth, time = mine.truth[a], (stamp - stamp[0]) * 1e-9
    found = [Layer('truth', colours.TRUTH, time, *truth.T, {}, 6.0)]
    # computed from the errors, as each replay has its own origin
    for name, series, at, colour, width in ((first.name, mine, a, colours.FIRST, 3.0),
                                            (second.name, theirs, b, colours.SECOND, 1.8)):
        east, north = (truth + series.estimate[at] - series.truth[at]).T
        found.append(Layer(name, colour, time, east, north, {'error': series.error[at]}, width))
    return found


def _still(drawn: list[Layer]) -> html.Html:
    figure = html.empty_figure(9, 7)
    axes = figure.add_subplot()
    for layer in drawn:
        axes.plot(layer.east, layer.north, color=layer.colour, linewidth=0.7 * layer.width, label=layer.name)
    axes.set_aspect('equal', adjustable='datalim')
    axes.set(xlabel='east, m', ylabel='north, m')
    axes.legend(fontsize=8, loc='upper left')
    return html.figure(figure, 'The drive from above.')


def table_text(first: Result, second: Result, rows: list[Row]) -> str:
    """The rows as text for a terminal."""
    level = comparison_verdict(first, second, rows).level
    lines = [f'A: {first.name}', f'B: {second.name}', f"{'error':<46}{'A':>11}{'B':>11}  B against A, 95 %"]
    for r in rows:
        model = ' / '.join(dict.fromkeys(r.models))
        lines.append(f'{_what(r).replace("largest error in ", "")}, {model}'.ljust(46)
                     + ''.join(f'{number(v, 3):>9} m' for v in _numbers(r)) + f'  {_span(r, level)}')
    return '\n'.join(lines)
