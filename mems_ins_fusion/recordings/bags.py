"""Bags of every kind as one: topics, and the serialized messages in blocks.

rosbag2 folders (mcap or sqlite3, split, compressed, with or without metadata.yaml), single .mcap and .db3 files, and
ROS 1 .bag files, whose messages rosbags converts to CDR.
"""
from __future__ import annotations

import shutil
import sqlite3
import struct
import tempfile
import warnings
from collections import Counter
from contextlib import ExitStack
from pathlib import Path, PurePath
from urllib.parse import quote

from mems_ins_fusion.guard import one_line
from mems_ins_fusion.parameters.params_file import read_yaml
from mems_ins_fusion.recordings.compression import ZSTD_MAGIC, decompress, decompress_file, zstd
from mems_ins_fusion.recordings.errors import RecordingError, RecordingWarning
from mems_ins_fusion.recordings.mcap import BLOCK, McapFile
from mems_ins_fusion.recordings.rosbag1 import Rosbag1File

_LARGEST_CELL = 2**24  # bytes, of a database
_LARGEST_MESSAGE = 2**20  # bytes, of those read here: an Imu has some 330


class Bag:
    """A recording of one or several files, to be used in a `with` statement.

    topics: name to message type. Raises RecordingError where `path` is absent or is no recording.
    """

    def __init__(self, path):
        self.path = Path(path)
        self._stack = ExitStack()
        self._files: list = []

    def __enter__(self) -> Bag:
        with self._stack:  # closes what is open already if one file fails
            for path in _storage_files(self.path):
                self._files.append(self._open(path))
                self._stack.callback(self._files[-1].close)
            self._stack = self._stack.pop_all()
        self.topics = {name: kind for file in self._files for name, kind in file.topics.items()}
        return self

    def __exit__(self, *exception) -> None:
        self._stack.close()

    def counts(self) -> Counter:
        """Number of messages by topic."""
        return sum((file.counts() for file in self._files), Counter())

    def read(self, topics):
        """Yield (topic, log times, serialized messages, part of the whole that is read) in blocks, as recorded."""
        for i, file in enumerate(self._files):
            for topic, times, messages, part in file.read(topics):
                if any(message.startswith(ZSTD_MAGIC) for message in messages[:1]):
                    messages = [_plain(message) for message in messages]
                yield topic, times, messages, (i + part) / len(self._files)

    def damage(self) -> list[str]:
        """What is wrong with the files, one line each; complete only after `read`."""
        return [f'{file.path}: {file.damage}' for file in self._files if file.damage]

    def _open(self, path: Path):
        try:
            if not path.is_file():
                raise RecordingError(f'{path} is not a file')
            if path.stat().st_size == 0:
                raise RecordingError(f'{path} is empty (0 bytes)')
            if path.suffix == '.zstd':
                path = self._decompress_file(path)
            return _STORAGES[path.suffix](path)
        except OSError as error:
            raise RecordingError(f'cannot read {path}: {error.strerror or error}') from None

    def _decompress_file(self, path: Path) -> Path:
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
        plain = folder / path.stem
        try:
            with path.open('rb') as source, plain.open('wb') as target:
                decompress_file(source, target, path.stat().st_size)
        except RecordingError as error:
            raise RecordingError(f'{path}: {error}') from None
        except (zstd().ZstdError, EOFError) as error:
            if not plain.stat().st_size:
                raise RecordingError(f'cannot decompress {path}: {error}') from None
            warnings.warn(f'{path} is decompressed only in part: {error}', RecordingWarning, stacklevel=2)
        return plain


def _plain(message: bytes) -> bytes:
    """A message without its compression; as it is, and so not decodable, where that is damaged."""
    try:
        return decompress(message, 'zstd', _LARGEST_MESSAGE)
    except (zstd().ZstdError, RecordingError):
        return message


class _Sqlite3File:
    """One .db3 file of rosbag2, whatever version of its schema. Its contents are data, never SQL."""

    def __init__(self, path: Path):
        self.path = path
        self._folder = None
        try:
            self._database, self.damage = self._opened(path)
        except sqlite3.Error as error:
            raise RecordingError(f'{path} cannot be opened: {error}') from None
        try:
            if hasattr(self._database, 'setlimit'):  # from Python 3.11 on
                self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_CELL)
            self._database.execute('PRAGMA trusted_schema = OFF')
            # without this a file shorter than it says it is would be refused as a whole
            self._database.execute('PRAGMA writable_schema = ON')
            self._refuse_computed('topics', 'messages')
            rows = self._database.execute('SELECT id, name, type, serialization_format FROM topics').fetchall()
        except (sqlite3.Error, UnicodeDecodeError) as error:
            self.close()
            raise RecordingError(f'{path} is not a rosbag2 database, or it is damaged: {one_line(error)}') from None
        except RecordingError:
            self.close()
            raise
        good = [row for row in rows if isinstance(row[0], int) and all(isinstance(cell, str) for cell in row[1:])]
        if len(good) < len(rows):
            self.damage = self.damage or f'{len(rows) - len(good)} of its topics are damaged'
        self._names = {number: name for number, name, _, _ in good}
        self._formats = {name: encoding for _, name, _, encoding in good}
        self.topics = {name: kind for _, name, kind, _ in good}

    def _opened(self, path: Path):
        """The database, and what is wrong with the file."""
        whole_pages, damage = _missing_pages(path)
        if damage:  # in memory, without the last page if that is cut: sqlite would fill it up with zeros
            database = sqlite3.connect(':memory:')
            database.deserialize(path.read_bytes()[:whole_pages])
            return database, damage
        log = path.with_name(f'{path.name}-wal')
        if log.exists() and log.stat().st_size:  # reading it writes beside it: so a copy of both is read
            self._folder = tempfile.TemporaryDirectory()
            for file in (log, path):
                shutil.copyfile(file, Path(self._folder.name) / file.name)
            path = Path(self._folder.name) / path.name
            return sqlite3.connect(path), None
        # immutable: no lock can be taken on read-only media
        return sqlite3.connect(f'file:{quote(str(path.absolute()))}?mode=ro&immutable=1', uri=True), None

    def _refuse_computed(self, *tables) -> None:
        """RecordingError unless `tables` are plain tables: views and generated columns can be computed without end."""
        for table in tables:
            kinds = self._database.execute('SELECT type, rootpage FROM sqlite_master WHERE name = ?',
                                           (table,)).fetchall()
            columns = self._database.execute(f'PRAGMA table_xinfo({table})').fetchall()
            if [kind for kind, page in kinds if page] != ['table'] or any(column[6] for column in columns):
                raise RecordingError(f"{self.path} is not a rosbag2 database, or it is damaged: '{table}' is no plain "
                                     'table')

    def close(self) -> None:
        self._database.close()
        if self._folder is not None:
            self._folder.cleanup()

    def counts(self) -> Counter:
        counts: Counter = Counter()
        try:
            for number, in self._database.execute('SELECT topic_id FROM messages'):
                counts[self._names.get(number)] += 1
        except sqlite3.Error as error:
            self.damage = self.damage or f'it is damaged ({error})'
        return counts

    def read(self, topics):
        wanted = {number: name for number, name in self._names.items() if name in topics}
        for name in wanted.values():
            if self._formats[name] != 'cdr':
                raise RecordingError(f"topic '{name}' in {self.path} is encoded as '{self._formats[name]}', not as cdr")
        # in the order of writing: unlike the index on time, it reads from front to end, and up to a damage
        query = (f'SELECT id, topic_id, timestamp, data FROM messages WHERE topic_id IN ({",".join("?" * len(wanted))})'
                 ' ORDER BY id')
        last = self._last_id()
        found, size, number = {topic: ([], []) for topic in wanted}, 0, 0
        try:
            for number, topic, time, data in self._database.execute(query, list(wanted)):
                times, messages = found[topic]
                whole = isinstance(data, bytes) and isinstance(time, int)
                times.append(time if whole else 0)
                messages.append(data if whole else b'')  # which is not decodable, and counted there
                size += 1
                if size == BLOCK:
                    yield from ((wanted[topic], *block, min(number / last, 1.0)) for topic, block in found.items())
                    found, size = {topic: ([], []) for topic in wanted}, 0
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            self.damage = self.damage or f'it is damaged after message {number} ({one_line(error)})'
        yield from ((wanted[topic], *block, 1.0) for topic, block in found.items())

    def _last_id(self) -> float:
        try:
            last = self._database.execute('SELECT MAX(id) FROM messages').fetchone()[0]
        except sqlite3.Error:
            return float('inf')
        return last if isinstance(last, int) and last > 0 else 1


def _missing_pages(path: Path) -> tuple[int, str | None]:
    """Size of the whole pages in a database, bytes, and what to say where it is shorter than its header says.

    Source: sqlite.org/fileformat, section 1.3.
    """
    size = path.stat().st_size
    with path.open('rb') as file:
        header = file.read(100)
    if len(header) < 100 or header[24:28] != header[92:96]:  # else the number of pages in the header is not valid
        return size, None
    page_size, pages = struct.unpack('>H', header[16:18])[0], struct.unpack('>I', header[28:32])[0]
    page_size = 65536 if page_size == 1 else page_size
    if size >= page_size * pages:
        return size, None
    return size - size % page_size, f'it breaks off at {size / 1e6:.3g} MB of {page_size * pages / 1e6:.3g} MB'


_TEXT = '.csv', '.txt'
_STORAGES = {'.mcap': McapFile, '.db3': _Sqlite3File, '.bag': Rosbag1File}


def _storage_files(path: Path) -> list[Path]:
    """The files of the recording `path`, in the order of recording."""
    if not path.exists():
        raise RecordingError(f'recording {path} does not exist')
    if path.is_dir():
        return _files_of_folder(path)
    if path.name == 'metadata.yaml':
        return _files_of_folder(path.parent)
    if not _is_storage(path):
        expected = 'a rosbag2 folder, or an .mcap, .db3 or .bag file'
        log = '; import_csv makes one of a log in CSV' if path.suffix.lower() in _TEXT else ''
        raise RecordingError(f'{path} is not a recording: expected {expected}{log}')
    return [path]


def _files_of_folder(folder: Path) -> list[Path]:
    there = sorted(path for path in folder.iterdir() if _is_storage(path))
    try:
        names = read_yaml(folder / 'metadata.yaml')['rosbag2_bagfile_information']['relative_file_paths']
        if not isinstance(names, list) or not names:
            raise ValueError('no list of files')
        listed = [folder / PurePath(name).name for name in names]
    except (OSError, ValueError, TypeError, KeyError) as error:
        if not there:
            inside = sorted(path.parent.name for path in folder.glob('*/metadata.yaml'))
            raise RecordingError(f'{folder} is not a recording: it holds no metadata.yaml and no .mcap, .db3 or .bag '
                                 f'file{f"; did you mean {folder / inside[0]}?" if inside else ""}') from None
        reason = 'has no metadata.yaml' if isinstance(error, FileNotFoundError) else 'has a damaged metadata.yaml'
        warnings.warn(f'{folder} {reason}; reading {", ".join(path.name for path in there)}', RecordingWarning,
                      stacklevel=2)
        return there
    missing = [path.name for path in listed if not (_is_storage(path) and path.is_file())]
    listed = [path for path in dict.fromkeys(listed) if path.name not in missing]
    if not listed and not there:
        raise RecordingError(f'{folder} is incomplete: {", ".join(missing)} is missing')
    if missing:
        instead = '' if listed else f'; reading {", ".join(path.name for path in there)}'
        warnings.warn(f'{folder} is incomplete: {", ".join(missing)} is missing{instead}', RecordingWarning,
                      stacklevel=2)
    return listed or there


def _is_storage(path: Path) -> bool:
    return path.with_suffix('').suffix in _STORAGES if path.suffix == '.zstd' else path.suffix in _STORAGES
