"""Checks that the parameters of a node do not contradict each other, with one line for each contradiction."""
from __future__ import annotations

from collections.abc import Callable

from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from ..filter.measurements.registry import further_inputs
from ..guard import one_line
from ..parameters.parameter import ParameterError

#: parameters with the topics that the node subscribes to, and those with the topics on which it publishes
INPUTS = ('imu_topic', 'gnss_topic', 'temperature_topic', 'initial_pose_topic')
OUTPUTS = ('odometry_topic', 'fix_topic', 'pose_topic')


def check_together(values: dict, resolve: Callable[[str], str]) -> None:
    """Raise ParameterError if `values` contradict each other. resolve: gives a topic's full name, with remappings."""
    _check_topics(values, resolve)
    _check_frames(values)
    if values['predict_to_now'] and not values['odometry_rate']:
        raise ParameterError("parameter 'predict_to_now' needs an 'odometry_rate' above 0, at which to publish")


def _check_topics(values, resolve):
    purposes: dict[str, str] = {}
    for name in (*INPUTS, *(measurement.topic for measurement in further_inputs(values)), *OUTPUTS):
        if not values.get(name):
            if name in ('imu_topic', 'gnss_topic', 'odometry_topic', 'fix_topic', 'pose_topic'):
                raise ParameterError(f"parameter '{name}' must name a topic, got ''")
            continue
        try:
            validate_topic_name(values[name])
        except InvalidTopicNameException as error:
            raise ParameterError(f"parameter '{name}': {one_line(error)}") from None
        topic = resolve(values[name])
        if topic in purposes:
            raise ParameterError(f"parameters '{purposes[topic]}' and '{name}' are the same topic, {topic}")
        purposes[topic] = name


def _check_frames(values):
    names = ['frame_id', 'child_frame_id', *(['map_frame_id'] if values['frames'] == 'map_odom' else [])]
    frames: dict[str, str] = {}
    for name in names:
        frame = values[name]
        if not frame or frame.startswith('/'):
            raise ParameterError(f"parameter '{name}' must be a frame without a slash in front, got '{frame}'")
        if frame in frames:
            raise ParameterError(f"parameters '{frames[frame]}' and '{name}' are the same frame, '{frame}'")
        frames[frame] = name
