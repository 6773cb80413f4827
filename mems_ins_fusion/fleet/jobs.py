"""The jobs of a fleet: one for each recording, or one for all usable recordings of a vehicle."""
from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from .sources import Entry

#: work with a single recording for each task; LOOK: the estimates of `configure` from this recording
LOOK = 'look'
TASKS = {'replay': 'replay', 'configure': LOOK, 'diagnose': LOOK, 'characterize': 'characterize'}
#: tasks that use all recordings of a vehicle together, after the work with each of them
TOGETHER = ('configure', 'diagnose')


@dataclass(frozen=True)
class Job:
    """One piece of work. recordings: of one vehicle, where they are; contents: their identities. params_file,
    references: '' if there are none; one reference for each recording. options: `pages`, `memory_gb`. id: name of the
    result, computed from everything that determines the result and from nothing else."""

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
    """The job of `task` on `recordings`, each with its identity. read: identities of params files and references."""
    entries = [entry for entry, _ in recordings]
    contents = [content for _, content in recordings]
    params_file = entries[0].params_file
    decides = [task, contents, read.get(params_file, ''), [read.get(e.reference, '') for e in entries], options, code()]
    digest = hashlib.blake2b(json.dumps(decides).encode(), digest_size=12).hexdigest()
    return Job(task, entries[0].vehicle, tuple(e.recording for e in entries), tuple(contents), params_file,
               tuple(e.reference for e in entries), options, code(), digest)


def from_dict(values: dict) -> Job:
    """The job from `dataclasses.asdict`, as it is passed to other processes, which may have another version."""
    return Job(**{name: tuple(v) if isinstance(v, list) else v for name, v in values.items()})


@cache
def code() -> str:
    """Identity of this version of the package: results of different versions are not mixed."""
    package = Path(__file__).parents[1]
    digest = hashlib.blake2b(digest_size=8)
    for source in sorted(package.rglob('*.py')):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def by_vehicle(entries: Iterable[tuple[Entry, str]]) -> list[list[tuple[Entry, str]]]:
    """Recordings that can be used together: of one vehicle and with one params file."""
    found: dict[tuple, list] = {}
    for entry, content in entries:
        found.setdefault((entry.vehicle, entry.params_file), []).append((entry, content))
    return list(found.values())
