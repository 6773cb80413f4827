"""The node's parameters: what is refused and how it is said, how they are described; and the messages it fills."""
from __future__ import annotations

import sys
import types

import numpy as np
import pytest
import ros_support  # noqa: F401  a ROS domain for the tests
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message

from mems_ins_fusion.nodes import fusion_node, replay_node
from mems_ins_fusion.nodes.output import Output
from mems_ins_fusion.nodes.ros_parameters import describe
from mems_ins_fusion.parameters import table


@pytest.fixture
def refusal(capsys):
    """Runs the node in this process; returns the one line it refuses its arguments with."""
    def run(*arguments):
        assert fusion_node.main([*arguments]) == 2
        line, end = capsys.readouterr().err.split('\n')
        assert end == ''
        return line.removeprefix('fusion_node: ')

    return run


@pytest.mark.parametrize('name, value, said', [
    ('sensor_error_model', 'gauss', "must be one of random_walk, gauss_markov, autoregressive; got 'gauss'"),
    ('gnss.sigma', '-1', 'must be at least 0 and at most 1000 m, got -1'),
    ('gnss.sigma', '.nan', 'must be a number, got nan'),
    ('gnss.sigma', 'near', "must be a number, got 'near'"),
    ('gnss.lever_arm', '[1, 2]', 'must have 3 values, got 2: [1, 2]'),
    ('gnss.lever_arm', '[]', 'must have 3 values, got 0: []'),
    ('gyroscope.gauss_markov.tau', '[0]', 'must be above 0 and at most 1e+09 s, got 0'),
    ('vehicle.zero_velocity', '1', 'must be true or false, got 1'),
])
def test_a_value_that_does_not_fit_is_refused_with_what_would(refusal, name, value, said):
    assert refusal('--ros-args', '-p', f'{name}:={value}') == f"parameter '{name}' {said}"


@pytest.mark.parametrize('arguments, said', [
    (['-p', 'gnss.sigm:=1'], "unknown parameter 'gnss.sigm'; did you mean 'gnss.sigma'?"),
    (['-p', 'gnss.lever_arm:=[0, 0.5, 1]'], 'write whole numbers in a list of decimals with a decimal point'),
    (['-p', 'qos_overrides./imu.subscription.depth:=5'],
     "unknown parameter 'qos_overrides./imu.subscription.depth'; there are"),
    (['-p', 'imu_topic:=/imu data'], "Invalid topic name: topic name must not contain characters other than"),
    (['--frobnicate'], "unknown ROS arguments ['--frobnicate']"),
    (['--params-file', 'absent.yaml'], 'params file absent.yaml: No such file or directory'),
])
def test_a_wrong_argument_is_refused(refusal, arguments, said):
    assert said in refusal('--ros-args', *arguments)


@pytest.mark.parametrize('text, said', [
    ('other_node:\n  ros__parameters:\n    gnss.sigma: 1.0\n',
     "holds nothing for the node '/fusion_node', only for /other_node"),
    ('/**:\n  ros__parameters:\n    gnss: {sigma: 1.0, lever_arms: [1.0, 0.0, 0.0]}\n',
     "unknown parameter 'gnss.lever_arms'; did you mean 'gnss.lever_arm'?"),
    ('/**:\n  ros__parameters:\n    gnss.lever_arm: [1, 0.5, 0]\n', "as in 'gnss.lever_arm': [1, 0.5, 0]"),
    ('5\n', 'holds no parameters'),
    ('/**:\n\tros__parameters:\n', 'is not valid YAML'),
    ('/**:\n  gnss.sigma: 1.0\n', "each node's parameters must stand under 'ros__parameters'"),
])
def test_a_params_file_that_ros_would_ignore_or_refuse_in_riddles_is_explained(refusal, tmp_path, text, said):
    path = tmp_path / 'params.yaml'
    path.write_text(text)
    assert said in refusal('--ros-args', '--params-file', str(path))


def test_arguments_that_are_not_for_ros_are_refused(refusal):
    assert refusal('drive.bag').startswith("'drive.bag' is not understood")


def test_transforms_without_tf2_msgs_are_refused(refusal, monkeypatch):
    monkeypatch.setitem(sys.modules, 'tf2_msgs', None)
    said = refusal('--ros-args', '-p', 'publish_tf:=true')
    assert said == "parameter 'publish_tf' needs the ROS package tf2_msgs, which is not installed"


@pytest.mark.parametrize('arguments, said', [
    (['gnss_topic:=/imu/data'], "parameters 'imu_topic' and 'gnss_topic' are the same topic, /imu/data"),
    (['fix_topic:=imu/data'], "parameters 'imu_topic' and 'fix_topic' are the same topic, /imu/data"),
    (['odometry_topic:=""'], "parameter 'odometry_topic' must name a topic, got ''"),
    (['frame_id:=base_link'], "parameters 'frame_id' and 'child_frame_id' are the same frame, 'base_link'"),
    (['frames:=map_odom', 'map_frame_id:=odom'],
     "parameters 'frame_id' and 'map_frame_id' are the same frame, 'odom'"),
    (['child_frame_id:=/car'], "parameter 'child_frame_id' must be a frame without a slash in front, got '/car'"),
    (['datum:=[95.0, 11.0, 0.0]'], "parameter 'datum' must have a latitude from -90 to 90, got 95"),
    (['start_pose:=[48.0, 400.0, 0.0, 0.0]'], "parameter 'start_pose' must have a longitude from -360 to 360, got 400"),
    (['predict_to_now:=true'], "parameter 'predict_to_now' needs an 'odometry_rate' above 0"),
    (['state_file:=/absent/state.json'], "parameter 'state_file': there is no folder /absent"),
    (['mounting_from_tf:=true'], "parameter 'mounting_from_tf' needs the ROS package tf2_ros"),
])
def test_parameters_that_contradict_each_other_are_refused_before_anything_takes_time(refusal, monkeypatch, arguments,
                                                                                      said):
    monkeypatch.setitem(sys.modules, 'tf2_ros', None)
    monkeypatch.setattr(fusion_node, 'load', lambda *_: pytest.fail('compiled'))
    assert refusal('--ros-args', *(part for argument in arguments for part in ('-p', argument))).startswith(said)


@pytest.mark.parametrize('node', [fusion_node, replay_node])
def test_help_names_every_parameter_with_default_and_unit(node, capsys):
    assert node.main(['--help']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f'usage: python -m mems_ins_fusion {node.NAME}')
    assert 'ros2 run' in lines[1]
    assert '  gnss.max_delay = 1.0 s' in lines
    assert ('  odometry_rate = 0.0 Hz' in lines) == (node is fusion_node)


def test_whole_numbers_other_tools_names_and_sections_by_pattern_are_accepted(refusal, tmp_path, monkeypatch):
    # given all that is fine, and one thing that is found missing only after the parameters were taken
    monkeypatch.setitem(sys.modules, 'tf2_msgs', None)
    path = tmp_path / 'params.yaml'
    path.write_text('/**/fusion_node:\n  ros__parameters:\n    gnss: {sigma: 2, lever_arm: [1, 0, 2]}\n'
                    '    datum: [48, 11, 500]\n    update_intervals: [1, 5]\n    bag: drive\n'
                    'other_node:\n  ros__parameters:\n    what: ever\n')
    # then only that is complained of
    said = refusal('--ros-args', '-r', '__ns:=/car', '--params-file', str(path), '-p', 'publish_tf:=true')
    assert said.startswith("parameter 'publish_tf' needs")


@pytest.mark.parametrize('name', ['gnss.sigma', 'gnss.max_delay'])
def test_a_description_holds_unit_and_range(name):
    parameter = table.ALL[name]
    described = describe(parameter, read_only=True)
    assert described.description.startswith(f'[{parameter.unit}] ')
    assert described.read_only
    allowed, = described.floating_point_range
    assert (allowed.from_value, allowed.to_value) == (parameter.minimum, parameter.maximum)


def test_a_description_names_choices_and_lengths():
    assert 'planar, strapdown' in describe(table.ALL['mechanization'], True).additional_constraints
    assert '0 or 3 values' in describe(table.ALL['datum'], True).additional_constraints


class Estimate:
    """Where a filter leaves its newest estimate."""

    def __init__(self):
        self.odometry = np.arange(85.0) / 7
        self.geodetic = np.array([0.5, -1.5, 300.0])
        self.position_covariance_enu = np.arange(9.0) / 3


def test_a_filled_message_survives_serialization_with_every_field_in_its_place():
    # given a message filled twice, as the node refills it
    estimate = Estimate()
    output = Output(estimate, 'map', 'car')
    output.fill(1)
    estimate.odometry += 1000.0
    output.fill(1_700_000_000_123_456_789)
    received = deserialize_message(serialize_message(output.odometry), Odometry)
    pose, twist = received.pose.pose, received.twist.twist
    assert (received.header.frame_id, received.child_frame_id) == ('map', 'car')
    assert (received.header.stamp.sec, received.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    filled = np.concatenate([
        [pose.position.x, pose.position.y, pose.position.z],
        [pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w], received.pose.covariance,
        [twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y, twist.angular.z],
        received.twist.covariance])
    assert np.array_equal(filled, estimate.odometry)
    assert (output.fix.latitude, output.fix.longitude) == (np.degrees(0.5), np.degrees(-1.5))
    assert np.array_equal(output.fix.position_covariance, estimate.position_covariance_enu)


def test_the_transform_is_the_pose(monkeypatch):
    message = types.ModuleType('tf2_msgs.msg')
    message.TFMessage = lambda transforms: transforms
    monkeypatch.setitem(sys.modules, 'tf2_msgs', types.ModuleType('tf2_msgs'))
    monkeypatch.setitem(sys.modules, 'tf2_msgs.msg', message)
    estimate = Estimate()
    output = Output(estimate, 'map', 'car')
    transform, = output.add_transform()
    output.fill(5 * 10**9)
    assert (transform.header.frame_id, transform.child_frame_id, transform.header.stamp.sec) == ('map', 'car', 5)
    moved, turned = transform.transform.translation, transform.transform.rotation
    assert [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w] == estimate.odometry[:7].tolist()
