"""What a user is told about a recording that cannot be used, and what is saved of a damaged one."""
from __future__ import annotations

import builtins
import re
import sqlite3
import struct
import sys
import warnings
import zlib

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from test_recordings import IMU, NAV_SAT_FIX, PLUGINS, START, drive, fix, imu, write_bag

from mems_ins_fusion.recordings.errors import RecordingError, RecordingWarning
from mems_ins_fusion.recordings.messages import typestore
from mems_ins_fusion.recordings.reading import read_recording

#: in words, what fixes may be of
FIXES = ('sensor_msgs/NavSatFix or gps_msgs/GPSFix or septentrio_gnss_driver/PVTGeodetic or ublox_msgs/NavPVT')


def complaint(path, imu_topic='/imu/data', gnss_topic='/gps/fix', **options):
    """The text of the RecordingError, which must be one line and name the recording."""
    with pytest.raises(RecordingError) as caught:
        read_recording(path, imu_topic, gnss_topic, **options)
    text = str(caught.value)
    assert '\n' not in text
    return text


def storage_file(bag):
    return next(path for path in bag.iterdir() if path.name != 'metadata.yaml')


def test_an_absent_path(tmp_path):
    assert complaint(tmp_path / 'nowhere') == f"recording {tmp_path / 'nowhere'} does not exist"


def test_a_path_that_is_no_recording(tmp_path):
    text = tmp_path / 'notes.md'
    text.write_text('hello')
    assert 'notes.md is not a recording: expected a rosbag2 folder' in complaint(text)
    assert 'import_csv' not in complaint(text)
    log = text.rename(tmp_path / 'log.CSV')
    assert 'log.CSV is not a recording' in complaint(log) and 'import_csv makes one' in complaint(log)
    assert 'is not a recording: it holds no metadata.yaml' in complaint(tmp_path)
    # and the folder above one
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'metadata.yaml').touch()
    assert complaint(tmp_path).endswith(f"did you mean {tmp_path / 'bag'}?")


@pytest.mark.parametrize('suffix, expected', [('.mcap', 'is not an MCAP file'), ('.db3', 'is not a rosbag2 database'),
                                              ('.bag', 'is not a ROS 1 bag')])
def test_a_file_with_other_contents_than_its_name_says(tmp_path, suffix, expected):
    file = tmp_path / f'drive{suffix}'
    file.write_bytes(b'')
    assert complaint(file) == f'{file} is empty (0 bytes)'
    for content in (b'x', b'nothing of that kind\n' * 100):
        file.write_bytes(content)
        assert f'{file} {expected}' in complaint(file)


@pytest.mark.parametrize('plugin', PLUGINS)
def test_an_empty_bag(tmp_path, plugin):
    bag = write_bag(tmp_path / 'bag', [], plugin)
    assert complaint(bag) == f'{bag} holds no messages'


@pytest.mark.parametrize('plugin', PLUGINS)
def test_a_missing_topic_lists_those_of_its_type(tmp_path, plugin):
    bag = write_bag(tmp_path / 'bag', [*drive(), ('/imu/raw', IMU, START, imu(0))], plugin)
    assert complaint(bag, '/imu') == (f"no topic '/imu' in {bag}; of type sensor_msgs/Imu: /imu/data (50 messages), "
                                      '/imu/raw (1 messages)')
    assert complaint(bag, gnss_topic='/fix') == (f"no topic '/fix' in {bag}; of type {FIXES}: "
                                                 '/gps/fix (5 messages)')
    assert "no topic '/truth'" in complaint(bag, reference_topic='/truth')


def test_a_missing_topic_of_a_type_that_is_not_there(tmp_path):
    bag = write_bag(tmp_path / 'bag', [('/gps/fix', NAV_SAT_FIX, START, fix(0))])
    assert complaint(bag) == (f"no topic '/imu/data' in {bag}; the recording has no topic of type sensor_msgs/Imu, "
                              'only /gps/fix (sensor_msgs/NavSatFix)')


def test_a_topic_of_the_wrong_type(tmp_path):
    bag = write_bag(tmp_path / 'bag', drive())
    assert complaint(bag, gnss_topic='/imu/data') == (
        f"topic '/imu/data' in {bag} carries sensor_msgs/Imu, not {FIXES}; these do: /gps/fix (5 messages)")


@pytest.mark.parametrize('plugin', PLUGINS)
def test_a_topic_without_messages(tmp_path, plugin):
    # given a topic that was announced but never heard
    file = storage_file(write_bag(tmp_path / 'bag', drive(), plugin))
    if plugin == StoragePlugin.SQLITE3:
        with sqlite3.connect(file) as database:
            database.execute('DELETE FROM messages WHERE topic_id = 2')
        database.close()
        assert complaint(file) == f"topic '/gps/fix' in {file} holds no messages"


@pytest.mark.parametrize('data', [b'\x00\x01\x00\x00', b'', b'\x00\x01\x00\x00' + b'\xff' * 400])
def test_a_message_that_cannot_be_decoded_loses_itself_and_no_more(tmp_path, data):
    bag = write_bag(tmp_path / 'bag', [('/imu/data', IMU, START, imu(0)), ('/imu/data', IMU, START + 1, data),
                                       ('/imu/data', IMU, START + 2, imu(2))])
    with pytest.warns(RecordingWarning) as caught:
        recording = read_recording(bag, '/imu/data')
    assert recording.imu.specific_force[:, 0].tolist() == [1.0, 3.0]
    assert recording.imu.received.tolist() == [START, START + 2]
    assert f"{bag}: 1 messages on '/imu/data' are no valid {IMU}; readable: 2 messages" in str(caught[-1].message)
    # when none can be decoded, then the recording is refused
    bag = write_bag(tmp_path / 'none', [('/imu/data', IMU, START, data)])
    text = complaint(bag, gnss_topic=None)
    assert f"1 messages on '/imu/data' are no valid {IMU}; of topic '/imu/data' nothing" in text


def long_drive(tmp_path, plugin):
    """A recording of several chunks or pages: 9000 Imu, about 3 MB."""
    return storage_file(write_bag(tmp_path / 'bag', drive(9000), plugin))


@pytest.mark.parametrize('plugin, part', [(StoragePlugin.MCAP, 0.02), (StoragePlugin.MCAP, 0.5),
                                          (StoragePlugin.MCAP, 0.999), (StoragePlugin.SQLITE3, 0.8)])
def test_a_truncated_file_is_read_up_to_its_end_and_it_is_said(tmp_path, plugin, part):
    file = long_drive(tmp_path, plugin)
    content = file.read_bytes()
    file.write_bytes(content[:int(part * len(content))])
    with pytest.warns(RecordingWarning) as caught:
        recording = read_recording(file, '/imu/data', '/gps/fix')
    # then what is read is the beginning, nothing is invented, and little before the end is lost
    count = len(recording.imu)
    assert 0.9 * part * 9000 - 50 < count <= min(9000, 1.1 * part * 9000 + 50)
    assert (recording.imu.received == START + np.arange(count) * 10**7 + 3_000_000).all()
    assert (recording.imu.specific_force[:, 0] == 1.0 + np.arange(count)).all()
    text = str(caught[-1].message)
    assert re.search(f'{file}: it breaks off at [0-9.]+ MB', text)
    seconds = (count - 1) / 100
    assert f'readable: {count} messages of /imu/data ({seconds:.1f} s), {len(recording.gnss)} messages' in text


@pytest.mark.parametrize('plugin', PLUGINS)
def test_a_file_cut_off_before_its_first_message(tmp_path, plugin):
    file = long_drive(tmp_path, plugin)
    file.write_bytes(file.read_bytes()[:60])
    assert str(file) in complaint(file)


def test_a_database_whose_inner_pages_are_cut_off(tmp_path):
    # the pages that lead to the messages come after some 2 MB of messages: nothing is found without them
    file = long_drive(tmp_path, StoragePlugin.SQLITE3)
    file.write_bytes(file.read_bytes()[:1_000_000])
    assert re.search("it breaks off at 1 MB of .*; of topic '/imu/data' nothing is readable", complaint(file))


def test_a_damaged_chunk_costs_no_more_than_itself(tmp_path):
    # given an mcap of several chunks, some bytes of the second overwritten
    file = long_drive(tmp_path, StoragePlugin.MCAP)
    content = bytearray(file.read_bytes())
    content[1_500_000:1_500_400] = b'\xff' * 400
    file.write_bytes(content)
    with pytest.warns(RecordingWarning, match='it is damaged at'):
        recording = read_recording(file, '/imu/data', '/gps/fix')
    assert 5000 < len(recording.imu) < 9000
    assert recording.imu.received[-1] == START + 8999 * 10**7 + 3_000_000


def test_a_wrong_checksum_is_noticed(tmp_path):
    # given an mcap of one chunk with a checksum (rosbags writes none)
    file = storage_file(write_bag(tmp_path / 'bag', drive(20)))
    content = bytearray(file.read_bytes())
    chunk = content.index(b'\x06', 8 + 9 + struct.unpack_from('<Q', content, 9)[0]) + 9
    size = struct.unpack_from('<Q', content, chunk + 16)[0]
    data = chunk + 28 + 4 + 8  # no compression, so its name is empty
    struct.pack_into('<I', content, chunk + 24, zlib.crc32(content[data:data + size]))
    file.write_bytes(content)
    assert len(read_recording(file, '/imu/data').imu) == 20
    # when one bit of it changes
    content[data + size - 100] ^= 1
    file.write_bytes(content)
    assert "it is damaged at" in complaint(file)


@pytest.mark.parametrize('part', [0.5, 0.9])
@pytest.mark.parametrize('compression', [None, Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4])
def test_a_truncated_ros1_bag_is_read_up_to_its_end(tmp_path, part, compression):
    store = get_typestore(Stores.ROS1_NOETIC)
    file = tmp_path / 'drive.bag'
    writer = Writer1(file)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connection = writer.add_connection('/imu/data', IMU, typestore=store)
        for i in range(9000):
            writer.write(connection, START + i, store.serialize_ros1(imu(i, store=store), IMU))
    assert len(read_recording(file, '/imu/data').imu) == 9000
    content = file.read_bytes()
    file.write_bytes(content[:int(part * len(content))])
    with pytest.warns(RecordingWarning, match='it is damaged or breaks off at'):
        recording = read_recording(file, '/imu/data')
    count = len(recording.imu)
    assert 0.3 * part * 9000 < count <= 9000
    assert (recording.imu.specific_force[:, 0] == 1.0 + np.arange(count)).all()


def test_any_byte_may_be_wrong(tmp_path):
    # whatever is damaged, the user gets a recording or one line, never another exception
    generator = np.random.default_rng(3)
    for plugin in PLUGINS:
        file = storage_file(write_bag(tmp_path / f'bag_{plugin.name}', drive(100), plugin))
        content = file.read_bytes()
        for _ in range(60):
            damaged = bytearray(content)
            start = generator.integers(len(content) - 8)
            damaged[start:start + 8] = generator.bytes(8)
            file.write_bytes(damaged)
            with warnings.catch_warnings():
                warnings.simplefilter('ignore', RecordingWarning)
                try:
                    read_recording(file, '/imu/data', '/gps/fix')
                except RecordingError as error:
                    assert '\n' not in str(error)


def test_rosbags_absent(tmp_path, monkeypatch):
    typestore.cache_clear()  # what an earlier test has read with them
    # given messages that need rosbags' own deserialization, and a ROS 1 bag, but no rosbags
    bag = write_bag(tmp_path / 'bag', [*drive(4), ('/imu/data', IMU, START, b'not laid out as the others')])
    (tmp_path / 'drive.bag').write_bytes(b'#ROSBAG V2.0\n')
    real = builtins.__import__

    def without_rosbags(name, *args, **kwargs):
        if name.startswith('rosbags'):
            raise ModuleNotFoundError(f'No module named {name}')
        return real(name, *args, **kwargs)

    for name in [name for name in sys.modules if name.startswith('rosbags')]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, '__import__', without_rosbags)
    for path in (bag, tmp_path / 'drive.bag'):
        assert 'pip install "rosbags>=0.11"' in complaint(path)
