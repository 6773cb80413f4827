"""Speed, velocity and heading from bags and back; the judge is rosbags' own writing and deserialization."""
from __future__ import annotations

import math

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from test_recordings import START, TYPE, drive, header, imu, quaternion, vector, write_bag

from mems_ins_fusion.evaluation.comparison import time_span
from mems_ins_fusion.filter.measurements.base import (
    IMU,
    ODOMETRY,
    POSE,
    TWIST,
)
from mems_ins_fusion.navigation.frames import ned_covariance_from_enu, ned_from_enu
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.samples import Headings, ImuSamples, Recording, Speeds, Velocities

COVARIANCE = np.arange(36.0) + 1  # of twists and poses: not symmetric, so that a wrong place shows


def twist(linear, covariance=COVARIANCE):
    return TYPE['geometry_msgs/msg/TwistWithCovariance'](
        twist=TYPE['geometry_msgs/msg/Twist'](linear=vector(*linear), angular=vector(7.0, 8.0, 9.0)),
        covariance=covariance)


def pose(degrees):
    """Nose `degrees` counter-clockwise from east."""
    half = math.radians(degrees) / 2
    return TYPE['geometry_msgs/msg/PoseWithCovariance'](
        pose=TYPE['geometry_msgs/msg/Pose'](position=TYPE['geometry_msgs/msg/Point'](x=1.0, y=2.0, z=3.0),
                                            orientation=quaternion(0.0, 0.0, math.sin(half), math.cos(half))),
        covariance=COVARIANCE)


def read(tmp_path, kind, messages, **topics):
    aiding = [('/aiding', kind, START + 5 + i, message) for i, message in enumerate(messages)]
    bag = write_bag(tmp_path / 'bag', [*drive(), *aiding])
    return read_recording(bag, '/imu/data', '/gps/fix', **topics)


def test_a_velocity_is_turned_from_east_north_up(tmp_path):
    messages = [TYPE[TWIST](header=header(START + 3), twist=twist((4.0, 3.0, 0.5))),
                TYPE[TWIST](header=header(START + 4), twist=twist((1.0, -2.0, math.nan)))]
    velocity = read(tmp_path, TWIST, messages, velocity_topic='/aiding').velocity
    assert velocity.stamp.tolist() == [START + 3, START + 4] and velocity.received.tolist() == [START + 5, START + 6]
    assert velocity.velocity[0].tolist() == [3.0, 4.0, -0.5]
    # a receiver without a height still has the others
    assert velocity.velocity[1, :2].tolist() == [-2.0, 1.0] and np.isnan(velocity.velocity[1, 2])
    ee, en, eu, ne, nn, nu, ue, un, uu = COVARIANCE[[0, 1, 2, 6, 7, 8, 12, 13, 14]]
    assert velocity.covariance[0].tolist() == [[nn, ne, -nu], [en, ee, -eu], [-un, -ue, uu]]


def test_axes_are_turned_as_a_matrix_would(tmp_path):
    turn = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    generator = np.random.default_rng(3)
    vectors, covariances = generator.normal(size=(5, 3)), generator.normal(size=(5, 3, 3))
    np.testing.assert_allclose(ned_from_enu(vectors), vectors @ turn.T)
    np.testing.assert_allclose(ned_covariance_from_enu(covariances), turn @ covariances @ turn.T)


@pytest.mark.parametrize('kind', [TWIST, ODOMETRY])
def test_a_speed_is_forward(tmp_path, kind):
    if kind == ODOMETRY:
        message = TYPE[ODOMETRY](header=header(START), child_frame_id='base_link', pose=pose(30.0),
                                 twist=twist((-4.0, 3.0, 0.5)))
    else:
        message = TYPE[kind](header=header(START), twist=twist((-4.0, 3.0, 0.5)))
    speed = read(tmp_path, kind, [message], speed_topic='/aiding').speed
    assert speed.speed.tolist() == [-4.0] and speed.variance.tolist() == [1.0]


@pytest.mark.parametrize('degrees, clockwise_from_north', [(90.0, 0.0), (0.0, 90.0), (30.0, 60.0), (180.0, -90.0)])
@pytest.mark.parametrize('kind', [IMU, POSE])
def test_a_heading_is_clockwise_from_north(tmp_path, kind, degrees, clockwise_from_north):
    half = math.radians(degrees) / 2
    message = imu(0, START, orientation=(0.0, 0.0, 2 * math.sin(half), 2 * math.cos(half))) if kind == IMU else \
        TYPE[kind](header=header(START), pose=pose(degrees))
    heading = read(tmp_path, kind, [message], heading_topic='/aiding').heading
    assert np.degrees(heading.yaw[0]) == pytest.approx(clockwise_from_north, abs=1e-9)
    assert heading.variance.tolist() == [8.0 if kind == IMU else 36.0]


def test_a_message_without_heading_is_nan(tmp_path):
    absent, zero = imu(0), imu(0, orientation=(0.0, 0.0, 0.0, 0.0))
    absent.orientation_covariance = np.array([-1.0] + [0.0] * 8)
    heading = read(tmp_path, IMU, [imu(0), absent, zero], heading_topic='/aiding').heading
    assert np.isnan(heading.yaw).tolist() == [False, True, True]


def test_one_topic_may_serve_two_purposes(tmp_path):
    message = TYPE[ODOMETRY](header=header(START), child_frame_id='base_link', pose=pose(0.0),
                             twist=twist((4.0, 0.0, 0.0)))
    recording = read(tmp_path, ODOMETRY, [message], reference_topic='/aiding', speed_topic='/aiding',
                     heading_topic='/imu/data', datum=(0.8, 0.2, 300.0))
    assert recording.speed.speed.tolist() == [4.0] and len(recording.heading) == len(recording.imu)
    assert recording.reference.velocity[0] == pytest.approx([0.0, 4.0, 0.0], abs=1e-12)


def test_a_topic_of_another_type_is_refused_with_those_that_fit(tmp_path):
    with pytest.raises(ValueError, match=r"'/gps/fix'.* carries sensor_msgs/NavSatFix, not geometry_msgs/Twist"
                                         r'WithCovarianceStamped; the recording has no topic of type'):
        read(tmp_path, IMU, [imu(0)], velocity_topic='/gps/fix')


def made(count=50):
    generator = np.random.default_rng(8)
    stamp = START + np.arange(count) * 100_000_000
    received = stamp + 7_000_000
    yaw = generator.uniform(-3, 3, count)
    yaw[9] = np.nan
    return Recording(
        'made', ImuSamples(stamp, stamp, *generator.normal(size=(2, count, 3))),
        speed=Speeds(stamp, received, generator.normal(size=count), generator.uniform(size=count)),
        velocity=Velocities(stamp, received, generator.normal(size=(count, 3)), generator.normal(size=(count, 3, 3))),
        heading=Headings(stamp, received, yaw, generator.uniform(size=count)))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_what_is_written_is_read_back(tmp_path, storage):
    written = made()
    write_recording(written, tmp_path / 'made', storage)
    found = read_recording(tmp_path / 'made', '/imu/data', speed_topic='/wheel/speed', velocity_topic='/gps/velocity',
                           heading_topic='/gps/heading')
    for part in ('speed', 'velocity', 'heading'):
        for name, array in vars(getattr(written, part)).items():
            np.testing.assert_allclose(getattr(getattr(found, part), name), array, rtol=1e-14, err_msg=name)


def test_rosbags_reads_what_is_written(tmp_path):
    written = made()
    write_recording(written, tmp_path / 'made')
    with AnyReader([tmp_path / 'made']) as reader:
        messages = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
    speed, velocity, heading = (messages[topic] for topic in ('/wheel/speed', '/gps/velocity', '/gps/heading'))
    assert speed.header.frame_id == 'base_link' and velocity.header.frame_id == 'gnss'
    assert speed.twist.twist.linear.x == written.speed.speed[-1]
    north, east, down = written.velocity.velocity[-1]
    linear = velocity.twist.twist.linear
    assert (linear.x, linear.y, linear.z) == (east, north, -down)
    assert velocity.twist.covariance[7] == written.velocity.covariance[-1, 0, 0]
    angle = 2 * math.atan2(heading.orientation.z, heading.orientation.w)
    assert math.cos(angle) == pytest.approx(math.sin(written.heading.yaw[-1]))
    assert math.sin(angle) == pytest.approx(math.cos(written.heading.yaw[-1]))
    assert heading.orientation_covariance[8] == written.heading.variance[-1]
    assert heading.linear_acceleration_covariance[0] == heading.angular_velocity_covariance[0] == -1


def test_cutting_a_recording_cuts_all_its_streams():
    recording = made()
    fixes = recording.heading  # anything with stamps stands in for the fixes
    shorter = time_span(Recording('r', recording.imu, fixes, None, None, recording.speed, recording.velocity,
                                  recording.heading), 1.0, 2.0)
    assert [len(getattr(shorter, part)) for part in ('imu', 'speed', 'velocity', 'heading')] == [11] * 4


@pytest.mark.filterwarnings('error::RuntimeWarning')
def test_what_is_infinite_is_written_as_nothing_measured(tmp_path):
    # given a speed and a heading of which one each is infinite
    stamp = START + 10**8 * np.arange(3)
    variance = np.full(3, 0.01)
    made = Recording('made', None, speed=Speeds(stamp, stamp, np.array([1.0, math.inf, 3.0]), variance),
                     heading=Headings(stamp, stamp, np.array([0.1, 0.2, -math.inf]), variance))
    # when they are written, with warnings as errors
    write_recording(made, tmp_path / 'bag')
    # then the others are as they were, and these two are read as none
    with AnyReader([tmp_path / 'bag']) as reader:
        messages = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
    speeds = [message.twist.twist.linear.x for topic, message in messages if topic == '/wheel/speed']
    assert speeds == pytest.approx([1.0, math.nan, 3.0], nan_ok=True)
    absent = [message.orientation_covariance[0] == -1.0 for topic, message in messages if topic == '/gps/heading']
    assert absent == [False, False, True]
