"""Reading of MCAP files, the whole ones and what is left of broken ones.

rosbags yields an MCAP file message by message through a merge of its chunks, which takes longer than the filter, and
refuses a file without its end, which is what a crash or a flat battery leaves behind. Here the records are walked from
the front, so that everything before the damage is read. Source: the MCAP specification, mcap.dev/spec.
"""
from __future__ import annotations

import mmap
import struct
import zlib
from collections import Counter
from pathlib import Path

from mems_ins_fusion.recordings.compression import decompress, most_unpacked
from mems_ins_fusion.recordings.errors import RecordingError

MAGIC = b'\x89MCAP0\r\n'
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
_CHUNK_INDEX, _STATISTICS, _DATA_END = 0x08, 0x0B, 0x0F
_RECORD = struct.Struct('<BQ')
_MESSAGE_HEADER = struct.Struct('<HIQQ')
_CHUNK_HEADER = struct.Struct('<QQQI')
_FOOTER_SIZE = _RECORD.size + 20
BLOCK = 10_000  # messages that are read or written at once


#: what reading a record raises that is shorter than its kind, or whose texts are none
_MALFORMED = (struct.error, UnicodeDecodeError)


class _Truncated(Exception):
    """The data end within the record that begins at `begin`."""

    def __init__(self, opcode: int | None, begin: int):
        super().__init__(opcode, begin)
        self.opcode, self.begin = opcode, begin


class McapFile:
    """One MCAP file. topics: name to message type. damage: what is wrong with the file, or None (known after `read`).

    Raises RecordingError where the file is not MCAP.
    """

    def __init__(self, path: Path):
        self.path = path
        self.damage: str | None = None
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, int, str]] = {}  # topic, schema, encoding
        self._counts: Counter = Counter()  # messages by channel
        self._chunk_channels: dict[int, set[int]] = {}  # where a chunk begins: the channels in it
        self._unpacked = 0  # bytes
        with path.open('rb') as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise RecordingError(f'{path} is not an MCAP file: it does not begin like one')
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        if not self._read_summary():
            self._schemas, self._channels, self._chunk_channels, self._counts = {}, {}, {}, Counter()
            for _ in self._blocks(self._counts):
                pass
        self.topics = {topic: self._schemas.get(schema, '') for topic, schema, _ in self._channels.values()}

    def close(self) -> None:
        self._data.close()

    def counts(self) -> Counter:
        """Number of messages by topic."""
        counts: Counter = Counter()
        for channel, (topic, _, _) in self._channels.items():
            counts[topic] += self._counts[channel]
        return counts

    def read(self, topics):
        """Yield (topic, log times, serialized messages, part of the file that is read) in blocks, as recorded."""
        wanted = {channel: topic for channel, (topic, _, _) in self._channels.items() if topic in topics}
        for channel, topic in wanted.items():
            encoding = self._channels[channel][2]
            if encoding != 'cdr':
                raise RecordingError(f"topic '{topic}' in {self.path} is encoded as '{encoding}', not as cdr")
        for found, position in self._blocks(Counter(), wanted):
            for channel, (times, messages) in found.items():
                yield wanted[channel], times, messages, position / len(self._data)

    def _read_summary(self) -> bool:
        """Take topics, counts and chunks from the summary at the file's end; False where it has no complete one."""
        data, end = self._data, len(self._data) - len(MAGIC)
        if end < _FOOTER_SIZE or data[end:] != MAGIC or data[end - _FOOTER_SIZE] != _FOOTER:
            return False
        start = struct.unpack_from('<Q', data, end - _FOOTER_SIZE + _RECORD.size)[0]
        has_counts = False
        try:
            for opcode, begin, stop in _records(data, start or end, end):
                record = data[begin:stop]
                if opcode == _STATISTICS:
                    has_counts = True
                    size = struct.unpack_from('<I', record, 42)[0]
                    self._counts.update(dict(struct.iter_unpack('<HQ', record[46:46 + size])))
                elif opcode == _CHUNK_INDEX:
                    chunk, size = struct.unpack_from('<Q', record, 16)[0], struct.unpack_from('<I', record, 32)[0]
                    self._chunk_channels[chunk] = {c for c, _ in struct.iter_unpack('<HQ', record[36:36 + size])}
                else:
                    self._note(opcode, record)
        except (_Truncated, *_MALFORMED):
            return False
        return has_counts and set(self._counts) <= set(self._channels)

    def _note(self, opcode, record) -> None:
        """Take in a schema or a channel."""
        if opcode == _SCHEMA:
            self._schemas[struct.unpack_from('<H', record)[0]] = _text(record, 2)[0]
        elif opcode == _CHANNEL:
            channel, schema = struct.unpack_from('<HH', record)
            topic, position = _text(record, 4)
            self._channels[channel] = topic, schema, _text(record, position)[0]

    def _blocks(self, counts, wanted=()):
        """Walk the file; yield ({channel: (log times, messages)}, position) and count the messages by channel."""
        data, found = self._data, {channel: ([], []) for channel in wanted}
        pending, self._unpacked = 0, 0
        try:
            for opcode, begin, stop in self._top_records():
                if opcode in (_DATA_END, _FOOTER):
                    break
                if self._unpacked > most_unpacked(len(data)):
                    self.damage = f'it unpacks to more than {_megabytes(most_unpacked(len(data)))}'
                    break
                if opcode == _CHUNK:
                    channels = self._chunk_channels.get(begin - _RECORD.size)
                    if channels and channels.isdisjoint(wanted):
                        continue
                    self._read_chunk(data[begin:stop], begin, counts, found)
                    pending = BLOCK
                else:
                    self._read_records(data, ((opcode, begin, stop),), counts, found)
                    pending += opcode == _MESSAGE
                if pending >= BLOCK:
                    release(data, stop)
                    yield found, stop
                    found, pending = {channel: ([], []) for channel in wanted}, 0
            else:
                raise _Truncated(None, len(data))
        except _Truncated as end:
            whole = data[len(data) - len(MAGIC):] == MAGIC
            if self.damage is None or not whole:
                self.damage = self._damage_at(end.begin) if whole else f'it breaks off at {_megabytes(len(data))}'
            if end.opcode == _CHUNK:
                self._read_chunk(data[end.begin:], end.begin, counts, found)
        yield found, len(data)

    def _top_records(self):
        """The records of the file; where one is damaged in length, on from the next chunk that the summary names."""
        data, position = self._data, len(MAGIC)
        while True:
            try:
                for opcode, begin, stop in _records(data, position, len(data)):
                    position = stop
                    yield opcode, begin, stop
                return
            except _Truncated as end:
                later = [chunk for chunk in self._chunk_channels if end.begin <= chunk < len(data)]
                if not later:
                    raise
                self.damage = self.damage or self._damage_at(end.begin)
                position = min(later)

    def _read_chunk(self, record, begin, counts, found) -> None:
        """Read the messages of one chunk record, or those before the place where it is damaged."""
        try:
            _, _, size, checksum = _CHUNK_HEADER.unpack_from(record)
            compression, position = _text(record, _CHUNK_HEADER.size)
            content = decompress(record[position + 8:], compression)
            self._unpacked += len(content)
            if len(content) == size and checksum and zlib.crc32(content) != checksum:
                raise ValueError('checksum')
            self._read_records(content, _records(content, 0, len(content)), counts, found)
        except RecordingError as error:
            self.damage = self.damage or f'{self._damage_at(begin)} ({error})'
        except MemoryError:
            raise
        except Exception:  # every decompressor has exceptions of its own
            self.damage = self.damage or self._damage_at(begin)

    def _damage_at(self, position) -> str:
        return f'it is damaged at {_megabytes(position)} of {_megabytes(len(self._data))}'

    def _read_records(self, data, records, counts, found) -> None:
        """Read the messages, and what they need to be understood, among `records` of `data`."""
        unpack, header = _MESSAGE_HEADER.unpack_from, _MESSAGE_HEADER.size
        for opcode, begin, stop in records:
            if opcode == _MESSAGE and stop - begin >= header:
                channel, _, log_time, _ = unpack(data, begin)
                counts[channel] += 1
                if channel in found:
                    times, messages = found[channel]
                    times.append(log_time)
                    messages.append(data[begin + header:stop])
                continue
            try:
                if opcode == _MESSAGE:
                    raise struct.error('too short')
                if opcode in (_SCHEMA, _CHANNEL):
                    self._note(opcode, data[begin:stop])
            except _MALFORMED:
                self.damage = self.damage or f'a record of it is damaged (kind {opcode}, {stop - begin} bytes)'


def release(data: mmap.mmap, position: int) -> None:
    """Let go of the memory that holds what was read before `position`: a mapped file counts as the process's own."""
    if hasattr(mmap, 'MADV_DONTNEED'):
        data.madvise(mmap.MADV_DONTNEED, 0, position - position % mmap.PAGESIZE or mmap.PAGESIZE)


def _records(data, position, end):
    """Yield (opcode, begin, stop) of the records in data[position:end]; _Truncated where the last is not complete."""
    unpack, header = _RECORD.unpack_from, _RECORD.size
    while position < end:
        if position + header > end:
            raise _Truncated(None, position)
        opcode, size = unpack(data, position)
        begin = position + header
        position = begin + size
        if position > end or opcode == 0:
            raise _Truncated(opcode, begin)
        yield opcode, begin, position


def _text(record, position) -> tuple[str, int]:
    """A string that begins at `position`, and where it ends."""
    begin = position + 4
    end = begin + struct.unpack_from('<I', record, position)[0]
    if end > len(record):
        raise struct.error('a text is longer than its record')
    return record[begin:end].decode(), end


def _megabytes(size) -> str:
    return f'{size / 1e6:.3g} MB'
