"""Run of a fleet: from its source to tables, histories and a page. Work that is already done is not repeated."""
from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

from .. import __version__
from ..guard import heard_interruption
from ..results import ResultError, write_files
from . import change_points, history, tables
from .engines import DIED, engine
from .failures import PASSING
from .jobs import TASKS, TOGETHER, Job, by_vehicle, job
from .sources import Entry, SourceError, find_entries, is_state_file, size_and_time
from .work import RESULT, RESULTS, do_job, identify, record_crash

#: tells a folder of ours, and what is in it
MARKER = 'fleet.json'
#: which contents have been read already, by shard
_CONTENTS = 'contents'
#: part of the work that is done when the contents of all recordings are known
_READ = 0.05
#: part that is done when each recording was looked at alone
_ALONE = 0.6
#: done of a recording: `recordings.status`
DONE, FAILED, DUPLICATE, OPEN = 'done', 'failed', 'duplicate', 'open'


@dataclass(frozen=True)
class FleetTask:
    """The task of a fleet run. params_file: for recordings whose table names none. workers: processes on this machine.
    memory: GB for each of them. shard: (i, n), the i-th of n parts; (1, 1): all. pages: whether to write the pages of
    recordings."""

    source: str
    task: str
    output: Path
    vehicle_from: str = ''
    params_file: str = ''
    scheduler: str = 'local'
    workers: int = 1
    memory: float = 1.0
    shard: tuple[int, int] = (1, 1)
    pages: bool = True


@dataclass
class Fleet:
    """Result of a fleet run. rows: by table name. said: messages to the user. interrupted: whether jobs are left."""

    asked: FleetTask
    rows: dict[str, list[dict]]
    changes: list[change_points.ChangePoint]
    said: list[str] = field(default_factory=list)
    interrupted: bool = False

    def count(self, status: str) -> int:
        return sum(row['status'] == status for row in self.rows['recordings'])

    def not_usable(self) -> dict[str, dict[str, str]]:
        """The first reason why each recording is certainly not usable, by vehicle and `recording_id`."""
        found: dict[str, dict[str, str]] = {}
        for row in self.rows.get('findings', ()):
            if row['severity'] == 'error' and row['recording_id']:
                found.setdefault(row['vehicle'], {}).setdefault(row['recording_id'], row['message'])
        return found


def run(asked: FleetTask, progress: Callable[[float, str], None] = lambda part, what: None) -> Fleet:
    """Do the jobs that are left, and write tables, histories and the page; with a shard, only the jobs.

    progress: called with the part done and the current step. An interruption ends the jobs; what is finished is
    written. Raises SourceError, EngineError, ResultError.
    """
    entries, states = _entries(asked)
    _claim(asked)
    known = _Known(asked)
    try:
        with engine(asked.scheduler, asked.workers) as workers:
            known.read(entries, workers, lambda part: progress(_READ * part, 'looking what there is'))
            known.load(entries)
            alone = _ALONE if asked.task in TOGETHER else 1.0
            _all(workers, known.alone(entries), known, asked, lambda part, what: progress(
                _READ + (alone - _READ) * part, what))
            _all(workers, known.together(entries), known, asked, lambda part, what: progress(
                alone + (1.0 - alone) * part, what))
    except KeyboardInterrupt:
        heard_interruption()
        return _interrupted(asked, known, entries)
    progress(1.0, 'done')
    if asked.shard != (1, 1):
        return Fleet(asked, {'recordings': known.recordings(entries)}, [])
    return _written(asked, known, entries, states)


def _entries(asked: FleetTask) -> tuple[list[Entry], list[Entry]]:
    """The recordings of the shard, and the state files."""
    found = find_entries(asked.source, asked.vehicle_from)
    states = [entry for entry in found if is_state_file(entry.recording)]
    entries = [replace(e, params_file=e.params_file or asked.params_file) for e in found if e not in states]
    i, n = asked.shard
    if asked.task in TOGETHER:  # all recordings of a vehicle are in one shard
        vehicles = sorted({entry.vehicle for entry in entries})
        entries = [entry for entry in entries if vehicles.index(entry.vehicle) % n == i - 1]
    else:
        entries = entries[i - 1::n]
    return entries, states


def _claim(asked: FleetTask) -> None:
    """Make the output folder. ResultError if it belongs to something else, or to another task."""
    output = asked.output
    marker = output / MARKER
    if marker.is_file():
        task = ''
        with suppress(OSError, ValueError, KeyError, TypeError):
            task = json.loads(marker.read_text(encoding='utf-8'))['task']
        if task != asked.task:
            raise ResultError(f'{output} holds a fleet with --task {task or "that is not readable"}; choose another '
                              'output')
        return
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise ResultError(f'{output} holds other files than results of fleet; choose another output')
    (output / RESULTS).mkdir(parents=True, exist_ok=True)
    write_files({marker: json.dumps({'tool': 'fleet', 'task': asked.task, 'version': __version__}) + '\n'},
                overwrite=True)


class _Known:
    """Identities of the recordings, and their results so far."""

    def __init__(self, asked: FleetTask):
        self._asked = asked
        self._options = {'pages': asked.pages, 'memory_gb': asked.memory}
        self._contents = self._remembered()
        self._read: dict[str, str] = {}
        #: of finished jobs: their columns in the table `recordings`, by the id of the job, and their rows in the other
        #: tables; loaded: whether the results of earlier runs are included
        self._results: dict[str, dict] = {}
        self.texts = tables.TableTexts()
        self.loaded = False

    def _remembered(self) -> dict[str, tuple[str, int, str]]:
        found = {}
        for path in sorted((self._asked.output / _CONTENTS).glob('*.csv')):
            with open(path, encoding='utf-8', newline='') as file:
                found.update({place: (content, int(size), time) for place, content, size, time in csv.reader(file)})
        return found

    def read(self, entries: Sequence[Entry], workers, progress: Callable[[float], None]) -> None:
        """Read the recordings whose identity is not known from an earlier run."""
        places = sorted({p for e in entries for p in (e.recording, e.params_file, e.reference) if p})
        unread = [place for place in places if not self._is_known(place)]
        for done, (place, found) in enumerate(workers.each(identify, unread), 1):
            if found is not None and found is not DIED:
                self._contents[place] = found
            progress(done / len(unread))
        self._read = {place: self._contents[place][0] for place in places if place in self._contents}
        text = io.StringIO()
        csv.writer(text, lineterminator='\n').writerows([p, *self._contents[p]] for p in places if p in self._contents)
        i, n = self._asked.shard
        write_files({self._asked.output / _CONTENTS / f'{i}_of_{n}.csv': text.getvalue()}, overwrite=True)

    def _is_known(self, place: str) -> bool:
        with suppress(OSError, SourceError):
            return place in self._contents and self._contents[place][1:] == size_and_time(place)
        return False

    def content(self, entry: Entry) -> str:
        """Identity of the recording; its name if it could not be read."""
        return self._read.get(entry.recording, entry.recording)

    def size(self, work: Job) -> int:
        """Bytes of its recordings."""
        return sum(self._contents[place][1] for place in work.recordings if place in self._contents)

    def firsts(self, entries: Sequence[Entry]) -> dict[tuple, Entry]:
        """The first of each group of identical recordings, by identity."""
        found: dict[tuple, Entry] = {}
        for entry in entries:
            found.setdefault(self._key(entry), entry)
        return found

    def _key(self, entry: Entry) -> tuple:
        return self.content(entry), self._read.get(entry.params_file, ''), self._read.get(entry.reference, '')

    def load(self, entries: Sequence[Entry]) -> None:
        """Look up the results of all jobs."""
        for work in self.alone(entries).values():
            self.look_up(work)
        for work in self.together(entries).values():
            self.look_up(work)
        self.loaded = True

    def look_up(self, work: Job) -> None:
        """Take over the result of a job, if there is one."""
        found = result(self._asked.output, work)
        if found is not None:
            self._results[work.id] = {name: found[name] for name in ('status', 'error_id', 'reason')} | {
                'page': found.get('page', ''), 'recording': found.get('recording', {})}
            for name, rows in rows_of(work, found).items():
                self.texts.add(name, tables.complete(name, rows), work.id)

    def is_open(self, work: Job) -> bool:
        """Whether a job is to be done: it has no result, or one that may change when it is repeated."""
        found = self._results.get(work.id)
        return found is None or found['error_id'] in PASSING

    def alone(self, entries: Sequence[Entry]) -> dict[Entry, Job]:
        """The job of each recording; of identical recordings only that of the first."""
        return {entry: job(TASKS[self._asked.task], [(entry, self.content(entry))], self._read, self._options)
                for entry in self.firsts(entries).values()}

    def together(self, entries: Sequence[Entry]) -> dict[tuple[Entry, ...], Job]:
        """The jobs with all readable recordings of a vehicle."""
        if self._asked.task not in TOGETHER:
            return {}
        read = [(entry, self.content(entry)) for entry, alone in self.alone(entries).items()
                if self._results.get(alone.id, {}).get('status') == DONE]
        return {tuple(entry for entry, _ in group): job(self._asked.task, group, self._read, self._options)
                for group in by_vehicle(read)}

    def recordings(self, entries: Sequence[Entry]) -> list[dict]:
        """The rows of the table `recordings`."""
        jobs, firsts = self.alone(entries), self.firsts(entries)
        return [self._recording(entry, firsts[self._key(entry)], jobs) for entry in entries]

    def _recording(self, entry: Entry, first: Entry, jobs: dict[Entry, Job]) -> dict:
        row = {'vehicle': entry.vehicle, 'recording': entry.recording, 'recording_id': self.content(entry),
               'task': self._asked.task, 'error_id': '', 'reason': '', 'same_as': '', 'page': '',
               'params_file': entry.params_file, 'reference': entry.reference}
        if entry != first:
            return row | {'status': DUPLICATE, 'same_as': first.recording}
        found = self._results.get(jobs[entry].id)
        if found is None:
            return row | {'status': OPEN}
        page = f'{RESULTS}/{jobs[entry].id}/{found["page"]}' if found['page'] else ''
        return row | {name: found[name] for name in ('status', 'error_id', 'reason')} | found['recording'] | {
            'page': page}


def result(output: Path, work: Job) -> dict | None:
    """The result of a job; None where there is none."""
    try:
        return json.loads((output / RESULTS / work.id / RESULT).read_text(encoding='utf-8'))
    except (OSError, ValueError):
        return None


def _all(workers, jobs: dict, known: _Known, asked: FleetTask, progress: Callable[[float, str], None]) -> None:
    """Do those of `jobs` that have no result, the largest first, so that the last ones to end are short.

    Source: R. L. Graham, "Bounds on multiprocessing timing anomalies", 1969.
    """
    by_size = sorted(jobs.values(), key=lambda work: (-known.size(work), work.id))
    left = {work.id: work for work in by_size if known.is_open(work)}
    here, count = partial(do_job, output=str(asked.output)), len(left)
    progress(0.0, '')
    given = [asdict(work) for work in left.values()]
    for done, (values, answer) in enumerate(_compiled_first(workers, here, given, asked), 1):
        if answer is DIED:
            record_crash(values, str(asked.output))
        known.look_up(left[values['id']])
        progress(done / count, f'{done} of {count} {"vehicles" if len(values["recordings"]) > 1 else "recordings"}')


def _compiled_first(workers, function, items: list, asked: FleetTask) -> Iterator[tuple]:
    """`workers.each`, but one job at a time until the filter is compiled: otherwise each process would compile it."""
    from ..compiled import FOLDER

    while items and asked.scheduler == 'local' and not FOLDER.exists():
        yield from workers.each(function, items[:1])
        items = items[1:]
    if items:
        yield from workers.each(function, items)


def _interrupted(asked: FleetTask, known: _Known, entries) -> Fleet:
    """Write only the CSV tables of finished jobs, which is fast, after an interruption."""
    rows = {'recordings': known.recordings(entries)}
    if known.loaded and asked.shard == (1, 1):
        known.texts.add('recordings', tables.complete('recordings', rows['recordings']))
        write_files(known.texts.files(asked.output / tables.FOLDER), overwrite=True)
    return Fleet(asked, rows, [], interrupted=True)


def _written(asked: FleetTask, known: _Known, entries, states) -> Fleet:
    """Tables, histories, changes and page."""
    from .page import page

    rows = _rows(asked, known, entries)
    said = []
    begins = {row['recording_id']: row.get('begin_ns') for row in rows['recordings']}
    seen = []
    for entry in states:
        found, why = history.read_state_file(entry.recording)
        seen += [{'vehicle': entry.vehicle, **row} for row in found]
        said += [why] if why else []
    estimates = history.estimates(rows['effects'], begins, seen)
    changes = change_points.find_changes(change_points.series_of(estimates))
    rows['findings'] += [{'vehicle': c.vehicle, 'recording_id': '', 'params_file': '', 'task': asked.task,
                          'source': 'watchman', 'severity': 'warning', 'topic': f'{c.quantity.effect}.'
                          f'{c.quantity.parameter}', 'message': c.words()} for c in changes]
    rows = {name: tables.complete(name, some) for name, some in rows.items()}
    history.write(asked.output, estimates)
    said += [text for text in [tables.write(asked.output, rows)] if text]
    fleet = Fleet(asked, rows, changes, said)
    write_files({asked.output / 'fleet.html': page(fleet, estimates)}, overwrite=True)
    return fleet


def _rows(asked: FleetTask, known: _Known, entries: Sequence[Entry]) -> dict[str, list[dict]]:
    """The rows of all tables, from the results so far."""
    rows: dict[str, list[dict]] = {name: [] for name in tables.TABLES}
    rows['recordings'] = known.recordings(entries)
    for work in (*known.alone(entries).values(), *known.together(entries).values()):
        for name, some in rows_of(work, result(asked.output, work) or {}).items():
            rows[name] += some
    return rows


def rows_of(work: Job, found: dict) -> dict[str, list[dict]]:
    """The rows of the tables that the result `found` of a job adds."""
    about = {'vehicle': work.vehicle, 'params_file': work.params_file, 'task': work.task,
             'recording_id': work.contents[0] if len(work.contents) == 1 else ''}
    rows = {name: [about | row for row in some] for name, some in found.get('rows', {}).items()}
    if found.get('status') == FAILED and work.task in TOGETHER:  # of other tasks: in `recordings`
        rows.setdefault('findings', []).append(about | {
            'source': work.task, 'severity': 'error', 'topic': '',
            'message': f'{found["error_id"]}: {found["reason"]}'})
    return rows
