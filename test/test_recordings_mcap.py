"""MCAP as other writers make it: without chunks, without a summary, lz4, checksums; judged by the specification."""
from __future__ import annotations

import struct
import warnings
import zlib

import lz4.frame
import pytest
from backports import zstd
from test_recordings import IMU, NAV_SAT_FIX, START, STORE, assert_is_drive, drive, fix, imu, write_bag

from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.reading import read_recording

MAGIC = b'\x89MCAP0\r\n'
COMPRESSORS = {'': bytes, 'lz4': lz4.frame.compress, 'zstd': zstd.compress}


def text(value):
    return struct.pack('<I', len(value)) + value.encode()


def record(opcode, content):
    return struct.pack('<BQ', opcode, len(content)) + content


def channels(messages, encoding='cdr'):
    """Schema and channel records, and the number of each topic."""
    numbers, records = {}, []
    for topic, kind, _, _ in messages:
        if topic not in numbers:
            number = numbers[topic] = len(numbers) + 1
            records.append(record(0x03, struct.pack('<H', number) + text(kind) + text('ros2msg') + text('')))
            records.append(record(0x04, struct.pack('<HH', number, number) + text(topic) + text(encoding) + text('')))
    return numbers, b''.join(records)


def message_records(messages, numbers):
    header = struct.Struct('<HIQQ')
    return [record(0x05, header.pack(numbers[topic], 0, time, time) + bytes(STORE.serialize_cdr(message, kind)))
            for topic, kind, time, message in messages]


def write_mcap(path, *records):
    """A file without a summary: header, records, data end, footer."""
    path.write_bytes(b''.join([MAGIC, record(0x01, text('ros2') + text('test')), *records,
                               record(0x0F, bytes(4)), record(0x02, bytes(20)), MAGIC]))
    return path


def read_quietly(path, *topics):
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        return read_recording(path, *topics)


def test_messages_outside_chunks(tmp_path):
    messages = drive()
    numbers, head = channels(messages)
    file = write_mcap(tmp_path / 'drive.mcap', head, *message_records(messages, numbers))
    assert_is_drive(read_quietly(file, '/imu/data', '/gps/fix'))


@pytest.mark.parametrize('compression', COMPRESSORS)
def test_chunks_of_each_compression_without_a_summary(tmp_path, compression):
    messages = drive()
    numbers, head = channels(messages)
    records = message_records(messages, numbers)
    chunks = []
    for content in (head + b''.join(records[:20]), b''.join(records[20:])):
        data = COMPRESSORS[compression](content)
        chunks.append(record(0x06, struct.pack('<QQQI', START, START, len(content), zlib.crc32(content))
                             + text(compression) + struct.pack('<Q', len(data)) + data))
    file = write_mcap(tmp_path / 'drive.mcap', *chunks)
    assert_is_drive(read_quietly(file, '/imu/data', '/gps/fix'))
    with pytest.raises(RecordingError, match=r'/gps/fix \(5 messages\)'):
        read_recording(file, '/imu/data', '/fix')


def test_an_unknown_compression_is_named(tmp_path):
    chunk = record(0x06, struct.pack('<QQQI', START, START, 4, 0) + text('zip') + struct.pack('<Q', 4) + bytes(4))
    with pytest.raises(RecordingError, match="unknown compression 'zip'"):
        read_recording(write_mcap(tmp_path / 'drive.mcap', chunk), '/imu/data')


def test_messages_that_are_not_cdr_are_refused(tmp_path):
    messages = drive()
    numbers, head = channels(messages, 'ros1')
    file = write_mcap(tmp_path / 'drive.mcap', head, *message_records(messages, numbers))
    with pytest.raises(RecordingError, match="'/imu/data' in .* is encoded as 'ros1', not as cdr"):
        read_recording(file, '/imu/data')


def test_chunks_without_a_wanted_topic_are_not_even_decompressed(tmp_path):
    # given a recording whose first chunks hold other messages, which are damaged
    fixes = [('/gps/fix', NAV_SAT_FIX, START + i, fix(i)) for i in range(9000)]
    inertial = [('/imu/data', IMU, START + 10**9 + i, imu(i)) for i in range(6000)]
    bag = write_bag(tmp_path / 'bag', [*fixes, *inertial])
    file = bag / 'bag.mcap'
    content = bytearray(file.read_bytes())
    content[200_000:200_400] = b'\xff' * 400
    file.write_bytes(content)
    # then nobody notices who does not want them
    assert len(read_quietly(bag, '/imu/data').imu) == 6000
    with pytest.warns(UserWarning):
        read_recording(bag, '/imu/data', '/gps/fix')
