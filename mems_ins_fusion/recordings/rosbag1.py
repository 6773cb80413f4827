"""Reading of ROS 1 bags, the whole ones and what is left of broken ones.

rosbags finds the messages by the index at a bag's end, which a crash leaves out, and unpacks a chunk to whatever size
it has. Here the records are walked from the front; rosbags only turns the messages into CDR. Source: the ROS wiki,
Bags/Format/2.0.
"""
from __future__ import annotations

import mmap
import struct
from collections import Counter
from pathlib import Path

from mems_ins_fusion.recordings.compression import decompress, most_unpacked
from mems_ins_fusion.recordings.errors import RecordingError, needs_rosbags
from mems_ins_fusion.recordings.mcap import BLOCK, release
from mems_ins_fusion.samples import SECOND

MAGIC = b'#ROSBAG V2.0\n'
_MESSAGE, _BAG, _CHUNK, _CONNECTION = 2, 3, 5, 7
_LARGEST_HEADER = 10_000  # bytes


class _Broken(Exception):
    """The data end or make no sense at the position given."""


class Rosbag1File:
    """One .bag file. topics: name to message type. damage: what is wrong with it, or None (known after `read`).

    Raises RecordingError where the file is no ROS 1 bag.
    """

    def __init__(self, path: Path):
        with needs_rosbags(f'reading the ROS 1 bag {path}'):
            from rosbags.typesys import Stores, get_typestore
        self.path = path
        self.damage: str | None = None
        self._to_cdr = get_typestore(Stores.ROS2_JAZZY).ros1_to_cdr
        self._connections: dict[int, tuple[str, str]] = {}  # topic, type
        with path.open('rb') as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise RecordingError(f'{path} is not a ROS 1 bag, or it is damaged: it does not begin like one')
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        if not self._read_index():
            for _ in self._messages():
                pass
        if not self._connections:
            self.close()
            raise RecordingError(f'{path} is not a ROS 1 bag, or it is damaged: it holds no topics')
        self.topics = dict(self._connections.values())

    def close(self) -> None:
        self._data.close()

    def counts(self) -> Counter:
        """Number of messages by topic, as far as they are readable."""
        counts: Counter = Counter()
        for connection, _, _, _ in self._messages():
            counts[self._connections[connection][0]] += 1
        return counts

    def read(self, topics):
        """Yield (topic, log times, messages as CDR, part of the file that is read) in blocks, as recorded."""
        wanted = {number: kind for number, (topic, kind) in self._connections.items() if topic in topics}
        found, size = {topic: ([], []) for topic in topics}, 0
        part = 1.0
        for connection, time, data, part in self._messages():
            if connection not in wanted:
                continue
            times, messages = found[self._connections[connection][0]]
            times.append(time)
            messages.append(self._converted(data, wanted[connection]))
            size += 1
            if size == BLOCK:
                yield from ((topic, *block, part) for topic, block in found.items())
                found, size = {topic: ([], []) for topic in topics}, 0
        yield from ((topic, *block, 1.0) for topic, block in found.items())

    def _converted(self, data: bytes, kind: str) -> bytes:
        try:
            return bytes(self._to_cdr(data, kind))
        except Exception:  # rosbags raises its own errors, struct's and others
            return b''  # which is not decodable, and counted there

    def _read_index(self) -> bool:
        """Take the connections from the index at the file's end; False where there is none."""
        try:
            fields, _, _, _ = _record(self._data, len(MAGIC), len(self._data))
            begin = struct.unpack('<Q', fields[b'index_pos'])[0]
            if fields[b'op'] != bytes([_BAG]) or not len(MAGIC) < begin < len(self._data):
                return False
            for fields, start, stop in _records(self._data, begin, len(self._data)):
                if fields[b'op'] == bytes([_CONNECTION]):
                    self._note(fields, self._data[start:stop])
        except (_Broken, KeyError, struct.error, UnicodeDecodeError):
            return False
        return bool(self._connections)

    def _note(self, fields, data) -> None:
        """Take in a connection."""
        inner = _fields(data)
        kind = inner[b'type'].decode()
        package, _, name = kind.rpartition('/')
        kind = kind if '/msg/' in kind else f'{package}/msg/{name}'
        self._connections[struct.unpack('<I', fields[b'conn'])[0]] = fields[b'topic'].decode(), kind

    def _messages(self):
        """Yield (connection, log time, message, part of the file) of each message of a connection that is known."""
        data, unpacked = self._data, 0
        try:
            for fields, begin, stop in _records(data, len(MAGIC), len(data)):
                if fields.get(b'op') != bytes([_CHUNK]):
                    yield from self._records_in(data, [(fields, begin, stop)], stop / len(data))
                    continue
                release(data, begin)
                try:
                    content = decompress(data[begin:stop], fields.get(b'compression', b'').decode())
                    unpacked += len(content)
                    if unpacked > most_unpacked(len(data)):
                        raise RecordingError('it unpacks to far more than a recording')
                    yield from self._records_in(content, _records(content, 0, len(content)), stop / len(data))
                except MemoryError:
                    raise
                except RecordingError as error:
                    self._hurt(begin, f' ({error})')
                    if unpacked > most_unpacked(len(data)):
                        return
                except (_Broken, OSError, ValueError, EOFError, RuntimeError):  # the decompressors'
                    self._hurt(begin)
        except _Broken as end:
            self._hurt(end.args[0])

    def _records_in(self, data, records, part):
        for fields, begin, stop in records:
            try:
                if fields[b'op'] == bytes([_CONNECTION]):
                    self._note(fields, data[begin:stop])
                elif fields[b'op'] == bytes([_MESSAGE]):
                    connection = struct.unpack('<I', fields[b'conn'])[0]
                    seconds, nanoseconds = struct.unpack('<II', fields[b'time'])
                    if connection in self._connections:
                        yield connection, seconds * SECOND + nanoseconds, data[begin:stop], part
            except (KeyError, struct.error, UnicodeDecodeError, _Broken):
                self._hurt(begin)

    def _hurt(self, position: int, why: str = '') -> None:
        self.damage = self.damage or (f'it is damaged or breaks off at {position / 1e6:.3g} MB of '
                                      f'{len(self._data) / 1e6:.3g} MB{why}')


def _records(data, position, end):
    """Yield (header fields, begin, stop of the data) of the records in data[position:end]; _Broken where one is not
    complete."""
    while position < end:
        fields, begin, stop, position = _record(data, position, end)
        yield fields, begin, stop


def _record(data, position, end):
    """Header fields, begin and stop of the data of the record at `position`, and where the next one begins."""
    start = position + 4
    if start > end:
        raise _Broken(position)
    begin = start + struct.unpack_from('<I', data, position)[0] + 4
    if begin > end or begin - start > _LARGEST_HEADER:
        raise _Broken(position)
    stop = begin + struct.unpack_from('<I', data, begin - 4)[0]
    if stop > end:
        raise _Broken(position)
    return _fields(data[start:begin - 4], position), begin, stop, stop


def _fields(header: bytes, at: int = 0) -> dict[bytes, bytes]:
    """The `name=value` fields of a header."""
    fields, position = {}, 0
    while position < len(header):
        begin = position + 4
        if begin > len(header):
            raise _Broken(at)
        position = begin + struct.unpack_from('<I', header, begin - 4)[0]
        name, equals, value = header[begin:position].partition(b'=')
        if not equals or position > len(header):
            raise _Broken(at)
        fields[name] = value
    return fields
