"""Reading and writing of bags; the judge is rosbags' own writing and deserialization."""
from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import shared_data
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mems_ins_fusion.navigation.earth import from_local
from mems_ins_fusion.recordings.errors import RecordingWarning
from mems_ins_fusion.recordings.messages import IMU, NAV_SAT_FIX, ODOMETRY, POSE_STAMPED, TEMPERATURE, decode
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import odometry_from_reference, write_recording
from mems_ins_fusion.results import ResultError
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording, Reference, Temperatures

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPE = STORE.types
START = 1_700_000_000_000_000_000
PLUGINS = [StoragePlugin.MCAP, StoragePlugin.SQLITE3]


def header(stamp, frame='imu', store=STORE):
    fields = {'seq': 0} if store is not STORE else {}
    time = store.types['builtin_interfaces/msg/Time'](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return store.types['std_msgs/msg/Header'](stamp=time, frame_id=frame, **fields)


def vector(x, y, z, store=STORE):
    return store.types['geometry_msgs/msg/Vector3'](x=x, y=y, z=z)


def quaternion(x, y, z, w, store=STORE):
    return store.types['geometry_msgs/msg/Quaternion'](x=x, y=y, z=z, w=w)


def imu(i, stamp=None, frame='imu', store=STORE, orientation=(0.1, -0.2, 0.3, 0.9)):
    covariance = np.arange(9.0)
    return store.types[IMU](
        header=header(START + i * 10**7 if stamp is None else stamp, frame, store),
        orientation=quaternion(*orientation, store), orientation_covariance=covariance,
        angular_velocity=vector(0.1 * i, -0.2 * i, 0.3 * i, store), angular_velocity_covariance=covariance,
        linear_acceleration=vector(1.0 + i, 2.0 + i, 9.8 - i, store), linear_acceleration_covariance=covariance)


def fix(i, frame='gps', store=STORE, status=2, latitude=48.0):
    return store.types[NAV_SAT_FIX](
        header=header(START + i * 10**9 + 7, frame, store),
        status=store.types['sensor_msgs/msg/NavSatStatus'](status=status, service=1),
        latitude=latitude + 1e-5 * i, longitude=11.0 - 2e-5 * i, altitude=400.0 + i,
        position_covariance=np.arange(9.0) + i, position_covariance_type=2)


def temperature(i):
    return TYPE[TEMPERATURE](header=header(START + i * 10**8), temperature=20.0 + i, variance=0.5)


def write_bag(path, messages, plugin=StoragePlugin.MCAP, compression=None):
    """A rosbag2 by rosbags of (topic, type, log time, message or bytes)."""
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, kind, time, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            data = message if isinstance(message, bytes) else STORE.serialize_cdr(message, kind)
            writer.write(connections[topic], time, data)
    return path


def drive(count=50, **fields):
    """A short recording's messages: an Imu every 10 ms, a NavSatFix with every tenth, both logged 3 ms late."""
    messages = []
    for i in range(count):
        messages.append(('/imu/data', IMU, START + i * 10**7 + 3_000_000, imu(i, **fields)))
        if i % 10 == 0:
            messages.append(('/gps/fix', NAV_SAT_FIX, START + i * 10**7 + 3_000_001, fix(i)))
    return messages


def assert_is_drive(recording, count=50):
    i = np.arange(count)
    assert (recording.imu.stamp == START + i * 10**7).all()
    assert (recording.imu.received == recording.imu.stamp + 3_000_000).all()
    assert (recording.imu.specific_force == np.column_stack([1.0 + i, 2.0 + i, 9.8 - i])).all()
    assert (recording.imu.angular_rate == np.column_stack([0.1 * i, -0.2 * i, 0.3 * i])).all()
    assert (recording.imu.orientation == (0.1, -0.2, 0.3, 0.9)).all()
    j = i[::10]
    assert (recording.gnss.stamp == START + j * 10**9 + 7).all()
    np.testing.assert_allclose(recording.gnss.latitude, np.radians(48.0 + 1e-5 * j), rtol=1e-15)
    np.testing.assert_allclose(recording.gnss.longitude, np.radians(11.0 - 2e-5 * j), rtol=1e-15)
    assert (recording.gnss.height == 400.0 + j).all()
    assert (recording.gnss.covariance == np.arange(9.0).reshape(3, 3) + j[:, None, None]).all()
    assert (recording.gnss.status == 2).all() and (recording.gnss.covariance_type == 2).all()


@pytest.mark.parametrize('plugin', PLUGINS)
@pytest.mark.parametrize('compression', [None, CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.STORAGE])
def test_a_rosbag2_of_any_storage_and_compression_is_read(tmp_path, plugin, compression):
    if plugin == StoragePlugin.SQLITE3 and compression == CompressionMode.STORAGE:
        compression = None  # sqlite3 has no compression of its own
    bag = write_bag(tmp_path / 'drive', drive(), plugin, compression)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        recording = read_recording(bag, '/imu/data', '/gps/fix')
    assert_is_drive(recording)
    assert recording.name == 'drive'


@pytest.mark.parametrize('plugin', PLUGINS)
def test_the_storage_file_itself_is_read(tmp_path, plugin):
    bag = write_bag(tmp_path / 'drive', drive(), plugin)
    file = next(path for path in bag.iterdir() if path.name != 'metadata.yaml')
    assert_is_drive(read_recording(file, '/imu/data', '/gps/fix'))


@pytest.mark.parametrize('plugin', PLUGINS)
@pytest.mark.parametrize('compression', [None, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_bag_without_metadata_is_read_with_a_warning(tmp_path, plugin, compression):
    bag = write_bag(tmp_path / 'drive', drive(), plugin, compression)
    (bag / 'metadata.yaml').unlink()
    with pytest.warns(RecordingWarning, match='drive has no metadata.yaml; reading drive'):
        assert_is_drive(read_recording(bag, '/imu/data', '/gps/fix'))


def test_a_damaged_metadata_file_is_no_obstacle(tmp_path):
    bag = write_bag(tmp_path / 'drive', drive())
    (bag / 'metadata.yaml').write_text('rosbag2_bagfile_information: [')
    with pytest.warns(RecordingWarning, match='damaged metadata.yaml'):
        assert_is_drive(read_recording(bag, '/imu/data', '/gps/fix'))


@pytest.mark.parametrize('plugin', PLUGINS)
def test_a_split_bag_is_read_as_one(tmp_path, plugin):
    # given eleven parts, so that sorting by text would put part 10 before part 2
    split = tmp_path / 'split'
    split.mkdir()
    messages = drive(55)
    per_part = math.ceil(len(messages) / 11)
    names = []
    for part in range(11):
        bag = write_bag(tmp_path / f'part_{part}', messages[part * per_part:(part + 1) * per_part], plugin)
        file = next(path for path in bag.iterdir() if path.name != 'metadata.yaml')
        names.append(file.rename(split / f'split_{part}{file.suffix}').name)
    # when read without metadata and with it
    with pytest.warns(RecordingWarning, match='has no metadata.yaml'):
        assert_is_drive(read_recording(split, '/imu/data', '/gps/fix'), 55)
    metadata = yaml.safe_load((tmp_path / 'part_0' / 'metadata.yaml').read_text())
    metadata['rosbag2_bagfile_information']['relative_file_paths'] = names
    (split / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert_is_drive(read_recording(split, '/imu/data', '/gps/fix'), 55)
    # then a missing part is named
    (split / names[10]).unlink()
    with pytest.warns(RecordingWarning, match=f'{names[10]} is missing'):
        assert len(read_recording(split, '/imu/data', '/gps/fix').imu) == 54


def test_a_ros1_bag_is_read(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(tmp_path / 'drive.bag') as writer:
        topics = {topic: writer.add_connection(topic, kind, typestore=store)
                  for topic, kind in (('/imu/data', IMU), ('/gps/fix', NAV_SAT_FIX))}
        for i in range(50):
            writer.write(topics['/imu/data'], START + i * 10**7 + 3_000_000,
                         store.serialize_ros1(imu(i, store=store), IMU))
            if i % 10 == 0:
                writer.write(topics['/gps/fix'], START + i * 10**7 + 3_000_001,
                             store.serialize_ros1(fix(i, store=store), NAV_SAT_FIX))
    assert_is_drive(read_recording(tmp_path / 'drive.bag', '/imu/data', '/gps/fix'))


@pytest.mark.parametrize('plugin', PLUGINS)
def test_samples_come_in_the_order_of_log_time(tmp_path, plugin):
    # given messages that were stamped in one order, logged in a second and written in a third
    log = [5, 1, 4, 1, 3]
    messages = [('/imu/data', IMU, START + time, imu(i)) for i, time in enumerate(log)]
    recording = read_recording(write_bag(tmp_path / 'bag', messages, plugin), '/imu/data')
    assert (recording.imu.received - START).tolist() == [1, 1, 3, 4, 5]
    assert ((recording.imu.stamp - START) // 10**7).tolist() == [1, 3, 4, 2, 0]


@pytest.mark.parametrize('frame', ['', 'a', 'imu', 'imu_link', 'base/imu_link_1'])
@pytest.mark.parametrize('kind, make', [(IMU, imu), (NAV_SAT_FIX, fix), (TEMPERATURE, temperature)])
def test_bulk_decoding_agrees_with_rosbags_for_any_frame(frame, kind, make, monkeypatch):
    made = [make(i) for i in range(3)]
    for message in made:
        message.header.frame_id = frame
    raw = [bytes(STORE.serialize_cdr(message, kind)) for message in made]
    # what a middleware may append changes nothing
    monkeypatch.setattr('mems_ins_fusion.recordings.messages._decode_each', None)
    for array, _ in (decode(raw, kind), decode([data + bytes(3) for data in raw], kind)):
        for got, message in zip(array, made):
            assert got['header.stamp.sec'] == message.header.stamp.sec
            assert got['header.stamp.nanosec'] == message.header.stamp.nanosec
            if kind == IMU:
                assert got['linear_acceleration_covariance'].tolist() == list(message.linear_acceleration_covariance)
                assert got['linear_acceleration'][2] == message.linear_acceleration.z
            elif kind == NAV_SAT_FIX:
                assert got['status.service'] == 1 and got['altitude'] == message.altitude
                assert got['position_covariance_type'] == 2
            else:
                assert (got['temperature'], got['variance']) == (message.temperature, message.variance)


def test_messages_of_different_layout_are_read_one_by_one(tmp_path):
    messages = drive()
    for i, (_, _, _, message) in enumerate(messages):
        message.header.frame_id = 'frame' * (i % 4)
    assert_is_drive(read_recording(write_bag(tmp_path / 'frames', messages), '/imu/data', '/gps/fix'))
    big_endian = [(topic, kind, time, bytes(STORE.serialize_cdr(message, kind, little_endian=False)))
                  for topic, kind, time, message in drive()]
    assert_is_drive(read_recording(write_bag(tmp_path / 'endian', big_endian), '/imu/data', '/gps/fix'))


def test_nan_and_missing_fixes_are_passed_on(tmp_path):
    broken = imu(1)
    broken.linear_acceleration.y = math.nan
    messages = [('/imu/data', IMU, START, imu(0)), ('/imu/data', IMU, START + 1, broken),
                ('/gps/fix', NAV_SAT_FIX, START + 2, fix(0, status=-1)),
                ('/gps/fix', NAV_SAT_FIX, START + 3, fix(1, latitude=math.nan))]
    recording = read_recording(write_bag(tmp_path / 'bag', messages), '/imu/data', '/gps/fix')
    assert np.isnan(recording.imu.specific_force).tolist() == [[False] * 3, [False, True, False]]
    assert recording.gnss.status.tolist() == [-1, 2]
    assert np.isnan(recording.gnss.latitude).tolist() == [False, True]


def test_orientation_is_none_where_no_message_has_one(tmp_path):
    absent = imu(1)
    absent.orientation_covariance = np.array([-1.0] + [0.0] * 8)
    zero, identity = imu(2, orientation=(0.0, 0.0, 0.0, 0.0)), imu(3, orientation=(0.0, 0.0, 0.0, 1.0))

    def orientation(name, *made):
        messages = [('/imu/data', IMU, START + i, message) for i, message in enumerate(made)]
        return read_recording(write_bag(tmp_path / name, messages), '/imu/data').imu.orientation

    for name, message in (('absent', absent), ('zero', zero), ('identity', identity)):
        assert orientation(name, message, message) is None
    mixed = orientation('mixed', imu(0), absent)
    assert mixed[0].tolist() == [0.1, -0.2, 0.3, 0.9] and np.isnan(mixed[1]).all()


def test_progress_ends_at_one(tmp_path):
    parts = []
    read_recording(write_bag(tmp_path / 'bag', drive()), '/imu/data', '/gps/fix', progress=parts.append)
    assert parts == sorted(parts) and parts[-1] == 1.0


def local_reference(tmp_path, kind):
    """A bag with one pose 100 m east, 50 m north, 10 m up, nose 30 deg left of east, 5 m/s forward and 1 m/s left."""
    pose = TYPE['geometry_msgs/msg/Pose'](
        position=TYPE['geometry_msgs/msg/Point'](x=100.0, y=50.0, z=10.0),
        orientation=quaternion(0.0, 0.0, math.sin(math.radians(15)), math.cos(math.radians(15))))
    if kind == POSE_STAMPED:
        message = TYPE[POSE_STAMPED](header=header(START, 'map'), pose=pose)
    else:
        twist = TYPE['geometry_msgs/msg/Twist'](linear=vector(5.0, 1.0, -0.5), angular=vector(0.0, 0.0, 0.0))
        message = TYPE[ODOMETRY](
            header=header(START, 'odom'), child_frame_id='base_link',
            pose=TYPE['geometry_msgs/msg/PoseWithCovariance'](pose=pose, covariance=np.zeros(36)),
            twist=TYPE['geometry_msgs/msg/TwistWithCovariance'](twist=twist, covariance=np.zeros(36)))
    return write_bag(tmp_path / 'bag', [*drive(), ('/reference', kind, START, message)])


@pytest.mark.parametrize('kind', [ODOMETRY, POSE_STAMPED])
def test_a_local_reference_is_placed_at_the_datum(tmp_path, kind):
    datum = (0.8, 0.2, 300.0)
    reference = read_recording(local_reference(tmp_path, kind), '/imu/data', reference_topic='/reference',
                               datum=datum).reference
    expected = from_local(50.0, 100.0, -10.0, datum)
    assert (reference.latitude[0], reference.longitude[0], reference.height[0]) == pytest.approx(expected, rel=1e-13)
    assert math.degrees(reference.yaw[0]) == pytest.approx(60.0)
    if kind == ODOMETRY:
        c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
        assert reference.velocity[0] == pytest.approx([5 * s + c, 5 * c - s, 0.5])
    else:
        assert reference.velocity is None


def test_the_first_fix_stands_in_for_the_datum_and_it_is_said(tmp_path):
    bag = local_reference(tmp_path, ODOMETRY)
    with pytest.warns(RecordingWarning, match=r"'/reference'.*first fix, 48.00000000 deg, 11.00000000 deg, 400.000 m"):
        reference = read_recording(bag, '/imu/data', '/gps/fix', '/reference').reference
    expected = from_local(50.0, 100.0, -10.0, (math.radians(48), math.radians(11), 400.0))
    assert reference.latitude[0] == pytest.approx(expected[0], rel=1e-13)
    with pytest.raises(ValueError, match="'/reference' holds local poses: give the datum"):
        read_recording(bag, '/imu/data', reference_topic='/reference')


def test_a_reference_of_fixes_leaves_out_what_is_no_position(tmp_path):
    messages = [*drive(), *(('/reference', NAV_SAT_FIX, START + i, message) for i, message in enumerate(
        [fix(3), fix(1), fix(2, status=-1), fix(4, latitude=math.nan)]))]
    reference = read_recording(write_bag(tmp_path / 'bag', messages), '/imu/data', '/gps/fix', '/reference').reference
    assert ((reference.stamp - START) // 10**9).tolist() == [1, 3]
    assert reference.height.tolist() == [401.0, 403.0]


def made_recording(count=200):
    generator = np.random.default_rng(5)
    stamp = START + np.arange(count) * 10_000_000
    orientation = generator.normal(size=(count, 4))
    orientation[7] = np.nan
    slow = stamp[::20]
    fixes = Fixes(slow, slow + 60_000_000, np.full(10, 0.8) + np.arange(10) * 1e-6, np.full(10, -2.0),
                  generator.normal(size=10), generator.normal(size=(10, 3, 3)),
                  np.arange(-1, 9).astype(np.int8), np.full(10, 3, np.uint8))
    reference = Reference(slow, fixes.latitude, fixes.longitude, fixes.height, generator.normal(size=(10, 3)),
                          generator.uniform(-3, 3, size=10))
    return Recording('made', ImuSamples(stamp, stamp + 1_234_567, generator.normal(size=(count, 3)),
                                        generator.normal(size=(count, 3)), orientation),
                     fixes, reference, Temperatures(slow, slow + 5, generator.normal(size=10)))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_what_is_written_is_read_back(tmp_path, storage):
    made = made_recording()
    made = replace(made, imu=made.imu.with_temperature(made.temperature))  # as reading does
    datum = (0.8, -2.0, 0.0)
    write_recording(made, tmp_path / 'made', storage,
                    odometry={'/odometry': odometry_from_reference(made.reference, datum)})
    read = read_recording(tmp_path / 'made', '/imu/data', '/gps/fix', '/odometry', '/imu/temperature', datum=datum)
    for part in ('imu', 'gnss', 'temperature'):
        for name, array in vars(getattr(made, part)).items():
            if array is not None:  # difference of two IMUs
                np.testing.assert_allclose(getattr(getattr(read, part), name), array, rtol=1e-15, err_msg=name)
    for name, array in vars(made.reference).items():
        np.testing.assert_allclose(getattr(read.reference, name), array, rtol=0, atol=1e-7, err_msg=name)
    assert [path.name for path in tmp_path.iterdir()] == ['made']


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_rosbags_reads_what_is_written(tmp_path, storage):
    made = made_recording()
    write_recording(made, tmp_path / 'made', storage,
                    odometry={'/odometry': odometry_from_reference(made.reference, (0.8, -2.0, 0.0))})
    with AnyReader([tmp_path / 'made']) as reader:
        messages = [(c.topic, time, reader.deserialize(raw, c.msgtype)) for c, time, raw in reader.messages()]
    assert [time for _, time, _ in messages] == sorted(time for _, time, _ in messages)
    inertial = [(time, message) for topic, time, message in messages if topic == '/imu/data']
    assert len(inertial) == 200
    for i in (0, 7, 199):
        time, message = inertial[i]
        assert time == made.imu.received[i] and message.header.frame_id == 'imu'
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == made.imu.stamp[i]
        assert message.linear_acceleration.y == made.imu.specific_force[i, 1]
        assert message.orientation_covariance[0] == (-1.0 if i == 7 else 0.0)
    fixes = [message for topic, _, message in messages if topic == '/gps/fix']
    assert fixes[3].latitude == np.degrees(made.gnss.latitude[3]) and fixes[3].status.status == 2
    assert fixes[3].position_covariance.tolist() == made.gnss.covariance[3].ravel().tolist()
    odometry = next(message for topic, _, message in messages if topic == '/odometry')
    speed = np.hypot(odometry.twist.twist.linear.x, odometry.twist.twist.linear.y)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ('odom', 'base_link')
    assert speed == pytest.approx(np.linalg.norm(made.reference.velocity[0, :2]))


def test_an_existing_recording_is_only_overwritten_on_request(tmp_path):
    made = made_recording()
    write_recording(made, tmp_path / 'made')
    with pytest.raises(ResultError, match='exists already'):
        write_recording(made, tmp_path / 'made')
    write_recording(made, tmp_path / 'made', 'sqlite3', overwrite=True)
    assert sorted(path.name for path in (tmp_path / 'made').iterdir()) == ['made.db3', 'metadata.yaml']


@pytest.mark.parametrize('name, gnss_topic', [('longmont_rtk_drive', '/gps/fix'), ('incheon_square_ros2', '/fix')])
def test_measured_recordings_are_read_as_rosbags_reads_them(name, gnss_topic):
    path = Path(shared_data(name)) / 'bag'
    recording = read_recording(path, '/imu/data', gnss_topic)
    with AnyReader([path], default_typestore=STORE) as reader:
        for topic, samples in (('/imu/data', recording.imu), (gnss_topic, recording.gnss)):
            connections = [connection for connection in reader.connections if connection.topic == topic]
            messages = list(reader.messages(connections))
            assert len(samples) == len(messages)
            assert samples.received.tolist() == [time for _, time, _ in messages]
            for i in range(0, len(messages), 97):
                message = reader.deserialize(messages[i][2], messages[i][0].msgtype)
                assert samples.stamp[i] == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                if topic == gnss_topic:
                    assert samples.latitude[i] == np.radians(message.latitude)
                else:
                    assert samples.angular_rate[i, 2] == message.angular_velocity.z
    assert recording.name == name
