"""The mounting from tf, with a stand-in for tf2_ros, of which there is no wheel."""
from __future__ import annotations

import math
import sys
import types
from types import SimpleNamespace

import pytest
import ros_support  # noqa: F401  a ROS domain for the tests
from scipy.spatial.transform import Rotation

from mems_ins_fusion.nodes import mounting
from mems_ins_fusion.parameters.parameter import ParameterError


class Absent(Exception):
    """No such transform yet."""


@pytest.fixture
def heard(monkeypatch):
    """What a node hears while it spins: first nothing, then the IMU, then tf; the lines of its log."""
    rotation = Rotation.from_euler('ZYX', [math.pi / 2, 0.1, -0.2])
    spins, lines = [], []

    class Buffer:
        def lookup_transform(self, target, source, time):
            if len(spins) < 3:
                raise Absent(f"'{source}' does not exist")
            assert (target, source) == ('base_link', 'imu_link')
            x, y, z, w = rotation.as_quat()
            return SimpleNamespace(transform=SimpleNamespace(rotation=SimpleNamespace(x=x, y=y, z=z, w=w)))

    tf2_ros = types.ModuleType('tf2_ros')
    tf2_ros.Buffer, tf2_ros.TransformException = Buffer, Absent
    tf2_ros.TransformListener = lambda buffer, node: None
    monkeypatch.setitem(sys.modules, 'tf2_ros', tf2_ros)
    callbacks = []

    def subscribe(kind, topic, callback, qos):
        callbacks.append(callback)
        return SimpleNamespace(topic_name=topic)

    def spin_once(node, timeout_sec):
        spins.append(timeout_sec)
        if len(spins) == 2:
            callbacks[0](SimpleNamespace(header=SimpleNamespace(frame_id='imu_link')))
    monkeypatch.setattr(mounting.rclpy, 'spin_once', spin_once)
    node = SimpleNamespace(create_subscription=subscribe, destroy_subscription=lambda subscription: None,
                           get_logger=lambda: SimpleNamespace(info=lines.append))
    return node, lines


def test_the_rotation_from_the_frame_of_the_imu_messages_is_taken(heard):
    node, lines = heard
    rpy = mounting.mounting_from_tf(node, '/imu/data', 'base_link', SimpleNamespace(requested=False))
    assert rpy == pytest.approx([-0.2, 0.1, math.pi / 2])
    assert 'waiting for a message on /imu/data' in lines[0]
    assert "from tf, 'imu_link' to 'base_link': [-0.2000, 0.1000, 1.5708] rad" in lines[-1]


def test_a_signal_ends_the_wait(heard):
    with pytest.raises(KeyboardInterrupt):
        mounting.mounting_from_tf(heard[0], '/imu/data', 'base_link', SimpleNamespace(requested=True))


def test_without_tf2_ros_it_is_one_clear_line(monkeypatch):
    monkeypatch.setitem(sys.modules, 'tf2_ros', None)
    with pytest.raises(ParameterError, match='needs the ROS package tf2_ros, which is not installed'):
        mounting.mounting_from_tf(None, '/imu/data', 'base_link', None)
