"""What there is to do: one job for each recording, or for all recordings of a vehicle that can be used."""
from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from .sources import Entry

#: what a recording alone is asked for by each task; LOOK: what it shows of the vehicle, as `configure` sees it
LOOK = 'look'
TASKS = {'replay': 'replay', 'configure': LOOK, 'diagnose': LOOK, 'characterize': 'characterize'}
#: tasks that take all recordings of a vehicle together, after each was looked at alone
TOGETHER = ('configure', 'diagnose')


@dataclass(frozen=True)
class Job:
    """One piece of work. vehicle: whose recordings they are. recordings: where they are; contents: what tells each from
    others. params_file and references: '' where there is none; references are as many as recordings. options: `pages`,
    `memory_gb`. id: the name of its result, made of all that decides what the result is, and of nothing else.
    """

    task: str
    vehicle: str
    recordings: tuple[str, ...]
    contents: tuple[str, ...]
    params_file: str
    references: tuple[str, ...]
    options: dict
    code: str
    id: str


def job(task: str, recordings: Sequence[tuple[Entry, str]], read: dict[str, str], options: dict) -> Job:
    """The job of `task` on `recordings`, each with its content. read: contents of params files and references."""
    entries = [entry for entry, _ in recordings]
    contents = [content for _, content in recordings]
    params_file = entries[0].params_file
    decides = [task, contents, read.get(params_file, ''), [read.get(e.reference, '') for e in entries], options, code()]
    digest = hashlib.blake2b(json.dumps(decides).encode(), digest_size=12).hexdigest()
    return Job(task, entries[0].vehicle, tuple(e.recording for e in entries), tuple(contents), params_file,
               tuple(e.reference for e in entries), options, code(), digest)


def from_dict(values: dict) -> Job:
    """The job of `dataclasses.asdict`, by which another process, of whatever version, is told of it."""
    return Job(**{name: tuple(v) if isinstance(v, list) else v for name, v in values.items()})


@cache
def code() -> str:
    """What tells this version of the package from others: results of different ones are not mixed."""
    package = Path(__file__).parents[1]
    digest = hashlib.blake2b(digest_size=8)
    for source in sorted(package.rglob('*.py')):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def by_vehicle(entries: Iterable[tuple[Entry, str]]) -> list[list[tuple[Entry, str]]]:
    """Recordings that can be taken together: of one vehicle and with one params file."""
    found: dict[tuple, list] = {}
    for entry, content in entries:
        found.setdefault((entry.vehicle, entry.params_file), []).append((entry, content))
    return list(found.values())
