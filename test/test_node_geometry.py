"""Mounting and lever arms from tf, with a stand-in for tf2_ros, of which there is no wheel."""
from __future__ import annotations

import math
import sys
import types
from types import SimpleNamespace

import pytest
import ros_support  # noqa: F401  a ROS domain for the tests
from scipy.spatial.transform import Rotation

from mems_ins_fusion.nodes import geometry
from mems_ins_fusion.nodes.geometry import geometry_from_tf
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.parameter import ParameterError

MOUNTING = Rotation.from_euler('ZYX', [math.pi / 2, 0.1, -0.2])
#: where each frame is in base_link, m
PLACES = {'imu_link': [0.3, 0.0, 0.5], 'gps_link': [1.0, -0.2, 1.5], 'rear_link': [-1.0, 0.0, 1.4],
          'base_link': [0.0, 0.0, 0.0], 'odom': [7.0, 8.0, 0.0]}
INPUTS = {'inputs': ['rear', 'wheels', 'camera', 'height'], 'rear.type': 'fix', 'rear.topic': '/rear/fix',
          'wheels.type': 'twist', 'wheels.topic': '/wheels/odometry', 'camera.type': 'velocity',
          'camera.topic': '/camera/velocity', 'camera.lever_arm': [0.5, 0.0, 0.0],
          'height.type': 'pressure', 'height.topic': '/pressure'}
ODOMETRY, TWIST = 'nav_msgs/msg/Odometry', 'geometry_msgs/msg/TwistWithCovarianceStamped'


class Absent(Exception):
    """No such transform yet."""


def header(frame):
    return SimpleNamespace(header=SimpleNamespace(frame_id=frame))


@pytest.fixture
def heard(monkeypatch):
    """A node, the lines of its log, and the messages that it hears by topic: first nothing, then these, then tf.

    Time goes on by a second with each spin.
    """
    lines, spins, callbacks = [], [], {}
    messages = {'/imu/data': header('imu_link'), '/gps/fix': header('/gps_link'), '/rear/fix': header('rear_link')}

    class Buffer:
        def lookup_transform(self, target, source, time):
            assert target == 'base_link'
            if len(spins) < 3 or source not in PLACES:
                raise Absent(f"'{source}' does not exist")
            turned = MOUNTING if source == 'imu_link' else Rotation.identity()
            return SimpleNamespace(transform=SimpleNamespace(
                translation=SimpleNamespace(**dict(zip('xyz', PLACES[source]))),
                rotation=SimpleNamespace(**dict(zip('xyzw', turned.as_quat())))))

    tf2_ros = types.ModuleType('tf2_ros')
    tf2_ros.Buffer, tf2_ros.TransformException = Buffer, Absent
    tf2_ros.TransformListener = lambda buffer, node: None
    monkeypatch.setitem(sys.modules, 'tf2_ros', tf2_ros)

    def subscribe(kind, topic, callback, qos):
        callbacks[topic] = callback
        return topic

    def spin_once(node, timeout_sec):
        spins.append(timeout_sec)
        if len(spins) >= 2:
            for topic, message in messages.items():
                for one in (message, header('another')):  # that of the first message counts
                    callbacks.get(topic, lambda message: None)(one)
    monkeypatch.setattr(geometry.rclpy, 'spin_once', spin_once)
    monkeypatch.setattr(geometry.time, 'monotonic', lambda: float(len(spins)))
    kinds = {'/wheels/odometry': ODOMETRY, '/camera/velocity': TWIST}
    node = SimpleNamespace(
        create_subscription=subscribe, destroy_subscription=callbacks.pop, resolve_topic_name=str,
        get_publishers_info_by_topic=lambda topic: [SimpleNamespace(topic_type=kinds[topic])] if topic in kinds else [],
        get_logger=lambda: SimpleNamespace(info=lines.append, warning=lambda line: lines.append(f'WARN {line}')))
    return SimpleNamespace(node=node, lines=lines, messages=messages, callbacks=callbacks)


def asked(heard, requested=False, **values):
    return geometry_from_tf(heard.node, table.check(values), SimpleNamespace(requested=requested))


def test_the_rotation_from_the_frame_of_the_imu_messages_is_taken(heard):
    found = asked(heard, mounting_from_tf=True)
    assert list(found) == ['imu.mounting_rpy'] and found['imu.mounting_rpy'] == pytest.approx([-0.2, 0.1, math.pi / 2])
    assert 'mounting_from_tf: waiting for a message on /imu/data' in heard.lines[0]
    assert "from tf, 'imu_link' to 'base_link': [-0.2000, 0.1000, 1.5708] rad" in heard.lines[-1]


def test_arms_are_from_the_imu_to_the_frame_of_the_first_message_of_each_input(heard):
    # given an odometry whose twist is that of base_link, in a frame of the world
    heard.messages |= {'/wheels/odometry': SimpleNamespace(child_frame_id='base_link'),
                       '/camera/velocity': header('unknown')}
    # when arms are asked for
    found = asked(heard, arms_from_tf=True, **INPUTS)
    # then each is that of its input, axes of the vehicle
    assert found['gnss.lever_arm'] == pytest.approx([0.7, -0.2, 1.0])
    assert found['rear.lever_arm'] == pytest.approx([-1.3, 0.0, 0.9])
    assert found['wheels.lever_arm'] == pytest.approx([-0.3, 0.0, -0.5])
    # and the filter takes them
    assert table.check({**INPUTS, **found})
    # what tf does not know stays, which is said; what has no arm is not asked for
    assert len(found) == 3 and '/pressure' not in '\n'.join(heard.lines)
    said = next(line for line in heard.lines if 'WARN' in line)
    assert "camera.lever_arm stays [0.5000, 0.0000, 0.0000] m: nothing from tf: the transform from 'unknown'" in said
    assert not heard.callbacks  # nothing stays subscribed


@pytest.mark.parametrize('frame, said', [('odom', 'a frame of the world'), ('imu_link', "the IMU's frame"),
                                         (None, 'a message on /camera/velocity')])
def test_a_frame_that_is_no_place_of_a_sensor_gives_no_arm(heard, frame, said):
    if frame:
        heard.messages['/camera/velocity'] = header(frame)
    found = asked(heard, arms_from_tf=True, **INPUTS)
    assert 'camera.lever_arm' not in found and len(found) == 2
    assert any('WARN camera.lever_arm stays' in line and said in line for line in heard.lines)


def test_an_arm_that_no_vehicle_has_is_refused(heard, monkeypatch):
    monkeypatch.setitem(PLACES, 'gps_link', [400.0, 0.0, 0.0])
    with pytest.raises(ParameterError, match='gnss.lever_arm'):
        asked(heard, arms_from_tf=True)


def test_nothing_is_waited_for_where_nothing_is_asked_for(heard):
    assert asked(heard) == {} and not heard.lines


def test_a_signal_ends_the_wait(heard):
    with pytest.raises(KeyboardInterrupt):
        asked(heard, requested=True, arms_from_tf=True)


@pytest.mark.parametrize('name', ['mounting_from_tf', 'arms_from_tf'])
def test_without_tf2_ros_it_is_one_clear_line(monkeypatch, name):
    monkeypatch.setitem(sys.modules, 'tf2_ros', None)
    with pytest.raises(ParameterError, match=f"'{name}' needs the ROS package tf2_ros, which is not installed"):
        geometry_from_tf(None, table.check({name: True}), None)
