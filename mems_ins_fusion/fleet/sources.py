"""The recordings of a fleet and their vehicles: from a folder, a glob or a table, local or behind a URL."""
from __future__ import annotations

import csv
import hashlib
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ..errors import InputError
from ..guard import one_line

#: extensions of recordings: those of `recordings.bags`, and those that `characterize` reads
SUFFIXES = ('.mcap', '.db3', '.bag', '.mcap.zstd', '.db3.zstd', '.npz')
#: end of the name of a state file of `fusion_node`
STATE_FILE = '.json'
#: columns of a table of recordings; the first two are required
COLUMNS = ('vehicle', 'recording', 'params_file', 'reference')
#: bytes that are read at once to compute an identity
_PIECE = 2**22


class SourceError(InputError):
    """A source of recordings that cannot be used; the text is one line with the reason."""


@dataclass(frozen=True, order=True)
class Entry:
    """One recording of a vehicle. recording, params_file, reference: path or URL; the last two may be ''."""

    vehicle: str
    recording: str
    params_file: str = ''
    reference: str = ''


def find_entries(source: str, vehicle_from: str = '') -> list[Entry]:
    """The recordings that `source` names, sorted: a folder, a glob (with `**` for any depth), a table or one recording.

    vehicle_from: pattern of a path with the name of the vehicle, such as 'logs/{vehicle}/*'; otherwise it is the name
    of the folder that contains the recording. Raises SourceError.
    """
    pattern = _vehicle_pattern(vehicle_from)
    if source.endswith(('.csv', '.parquet')):
        entries = list(_read_table(source, pattern))
    else:
        paths = sorted(set(_remote_paths(source) if is_url(source) else _local_paths(source)))
        entries = [Entry(_vehicle_of(path, pattern), path) for path in paths]
    if not entries:
        raise SourceError(f'{source}: no recording there ({", ".join(SUFFIXES)} files, or rosbag2 folders)')
    return sorted(set(entries))


def is_url(path: str) -> bool:
    """Whether fsspec is needed to read `path`."""
    return '://' in path


def is_state_file(path: str) -> bool:
    return path.endswith(STATE_FILE)


def _vehicle_pattern(text: str) -> re.Pattern | None:
    if not text:
        return None
    if text.count('{vehicle}') != 1:
        raise SourceError(f"--vehicle-from must hold {{vehicle}} once, got '{text}'")
    parts = re.split(r'(\{vehicle\}|\*\*|\*)', text.removeprefix('./'))
    meaning = {'{vehicle}': '(?P<vehicle>[^/]+)', '**': '.*', '*': '[^/]*'}
    return re.compile('(?:^|/)' + ''.join(meaning.get(part, re.escape(part)) for part in parts) + '(?:/|$)')


def _vehicle_of(path: str, pattern: re.Pattern | None) -> str:
    if pattern is None:
        return PurePosixPath(path).parent.name or 'vehicle'
    found = pattern.search(path)
    if found is None:
        raise SourceError(f'--vehicle-from does not fit {path}')
    return found['vehicle']


def _local_paths(source: str) -> Iterator[str]:
    path = Path(source).expanduser()
    if any(c in source for c in '*?['):
        root = Path(path.anchor) if path.is_absolute() else Path()
        for match in root.glob(str(path.relative_to(path.anchor) if path.is_absolute() else path)):
            yield from _recordings_in(match, asked=True)
    elif path.exists():
        yield from _recordings_in(path, asked=True)
    else:
        raise SourceError(f'{source} does not exist')


def _recordings_in(path: Path, asked: bool = False) -> Iterator[str]:
    """The recordings at or below `path`. asked: whether the user named this path, so that any file counts as a
    recording."""
    if path.is_file():
        if path.name.endswith(SUFFIXES) or path.name.endswith(STATE_FILE) or asked:
            yield str(path)
    elif (path / 'metadata.yaml').exists():
        yield str(path)
    elif path.is_dir():
        for child in sorted(path.iterdir()):
            if not child.name.startswith('.'):
                yield from _recordings_in(child)


def _remote_paths(source: str) -> Iterator[str]:
    system, path = opened(source)
    found = [path] if system.isfile(path) else (
        system.glob(path) if any(c in path for c in '*?[') else system.find(path))
    files = []
    for match in found:
        files += system.find(match) if system.isdir(match) else [match]
    folders = {str(PurePosixPath(file).parent) for file in files if PurePosixPath(file).name == 'metadata.yaml'}
    for file in files:
        folder = str(PurePosixPath(file).parent)
        if folder in folders:
            yield system.unstrip_protocol(folder)
        elif file.endswith(SUFFIXES) or file.endswith(STATE_FILE):
            yield system.unstrip_protocol(file)


def opened(url: str):
    """The file system of `url`, and the path in it. SourceError if fsspec or the driver is not installed."""
    try:
        import fsspec

        return fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        reason = 'fsspec is not installed' if 'fsspec' in str(error) else one_line(error)
        raise SourceError(f'{url}: {reason}; pip install "mems_ins_fusion[fleet]" reads URLs, with the driver of the '
                          'protocol') from None


def _read_table(source: str, pattern) -> Iterator[Entry]:
    rows = _parquet_rows(source) if source.endswith('.parquet') else _csv_rows(source)
    if rows and 'recording' not in rows[0]:
        raise SourceError(f"{source} has no column 'recording', only {', '.join(map(str, rows[0]))}")
    for number, row in enumerate(rows, 1):
        if not row.get('recording'):
            raise SourceError(f"{source}: row {number} has no 'recording'")
        where = str(row['recording'])
        vehicle = str(row.get('vehicle') or '') or _vehicle_of(where, pattern)
        given = {name: _beside(source, str(row.get(name) or '')) for name in COLUMNS[1:]}
        yield Entry(vehicle, **given)


def _beside(table: str, path: str) -> str:
    """A path in a table, which may be relative to the folder of the table."""
    if not path or is_url(path) or Path(path).is_absolute():
        return path
    return f'{table.rpartition("/")[0]}/{path}' if is_url(table) else str(Path(table).parent / path)


def _csv_rows(source: str) -> list[dict]:
    with local_copy(source) as path:
        try:
            with open(path, encoding='utf-8-sig', newline='') as file:
                return list(csv.DictReader(file))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise SourceError(f'{source}: {one_line(error)}') from None


def _parquet_rows(source: str) -> list[dict]:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise SourceError(f'{source}: pip install "mems_ins_fusion[fleet]" reads Parquet') from None
    with local_copy(source) as path:
        try:
            return parquet.read_table(path).to_pylist()
        except (OSError, pyarrow.ArrowException) as error:
            raise SourceError(f'{source}: {one_line(error)}') from None


@contextmanager
def local_copy(path: str) -> Iterator[Path]:
    """`path` if it is local, else a copy that is removed at the end of the block. SourceError if it cannot be read."""
    if not is_url(path):
        yield Path(path).expanduser()
        return
    system, there = opened(path)
    with tempfile.TemporaryDirectory(prefix='mems_ins_fusion_') as folder:
        here = Path(folder) / PurePosixPath(there).name
        try:
            system.get(there, str(here), recursive=system.isdir(there))
        except OSError as error:
            raise SourceError(f'{path}: {error.strerror or error}') from None
        yield here


def content_id(path: Path) -> str:
    """Identity of a recording, a params file or a reference: a digest of its bytes, independent of its name.

    Of a rosbag2 folder it is that of the files with messages, in the order of their names.
    """
    files = [path] if path.is_file() else [f for f in sorted(path.glob('*')) if f.name.endswith(SUFFIXES)]
    digest = hashlib.blake2b(digest_size=12)
    size = 0
    for file in files:
        digest.update(b'file')
        with open(file, 'rb') as stream:
            while piece := stream.read(_PIECE):
                size += len(piece)
                digest.update(piece)
    if not size:  # two empty files do not count as identical
        digest.update(str(path).encode())
    return digest.hexdigest()


def size_and_time(path: str) -> tuple[int, str]:
    """Bytes and time of change of what `path` names. If both are unchanged, so is the content."""
    if is_url(path):
        system, there = opened(path)
        files = system.find(there) or [there]
        infos = [system.info(file) for file in files]
        return sum(i.get('size') or 0 for i in infos), hashlib.blake2b(
            repr([str(i.get(k)) for i in infos for k in ('mtime', 'LastModified', 'ETag', 'etag', 'created')]).encode(),
            digest_size=8).hexdigest()
    where = Path(path).expanduser()
    stats = [file.stat() for file in ([where] if where.is_file() else sorted(where.glob('*')))]
    return sum(s.st_size for s in stats), str(max((s.st_mtime_ns for s in stats), default=0))
