"""Messages of speed, velocity and heading as numbers for the filter, whichever of the accepted types they come in."""
from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Imu

from ..navigation.frames import yaw_from_enu, yaw_of_quaternion
from .log import Watch

#: east-north-up to north-east-down, and back
_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def stamp_of(message) -> int:
    """ns."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def speed_of(message) -> tuple[float, float]:
    """Speed along base_link's x axis, m/s, and its variance, of a twist or an odometry."""
    return message.twist.twist.linear.x, float(message.twist.covariance[0])


def velocity_of(message) -> tuple[np.ndarray, np.ndarray]:
    """Velocity (3,) m/s and covariance (3, 3), north-east-down, of a twist that is east-north-up."""
    linear = message.twist.twist.linear
    covariance = np.reshape(message.twist.covariance, (6, 6))[:3, :3]
    return _NED @ [linear.x, linear.y, linear.z], _NED @ covariance @ _NED


def heading_of(message) -> tuple[float, float]:
    """Yaw clockwise from north, rad, and its variance; NaN where the message has no orientation."""
    if isinstance(message, Imu):
        q, variance = message.orientation, message.orientation_covariance[8]
        absent = message.orientation_covariance[0] == -1.0  # REP 145
    else:
        q, variance = message.pose.pose.orientation, message.pose.covariance[35]
        absent = False
    if absent or q.x == q.y == q.z == q.w == 0.0:
        return np.nan, float(variance)
    return float(yaw_from_enu(yaw_of_quaternion(q.x, q.y, q.z, q.w))), float(variance)


def subscribe(node: Node, kind, topic: str, callback, depth: int):
    """Best effort also hears reliable drivers; a reliable subscription would not hear best-effort ones."""
    return node.create_subscription(
        kind, topic, callback, QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT),
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        qos_overriding_options=QoSOverridingOptions.with_default_policies())


class Input:
    """A topic that may carry one of several types: subscribed once a publisher shows which. `watch` counts messages.

    take: called with the stamp (ns) and the numbers that `convert` makes of a message.
    """

    def __init__(self, node: Node, topic: str, kinds: tuple, convert: Callable, take: Callable, patience: float = 3.0):
        self.topic_name = node.resolve_topic_name(topic)
        self.watch = Watch(patience)
        self.kind = ' or '.join(_name(kind) for kind in kinds)
        self._node, self._topic, self._convert, self._take = node, topic, convert, take
        self._kinds = {_name(kind): kind for kind in kinds}
        self._subscription = None
        self.look()

    def look(self) -> None:
        """Subscribe where there is a publisher by now."""
        if self._subscription is not None:
            return
        for info in self._node.get_publishers_info_by_topic(self.topic_name):
            if info.topic_type in self._kinds:
                self._subscription = subscribe(self._node, self._kinds[info.topic_type], self._topic, self._on_message,
                                               50)
                return

    def _on_message(self, message):
        self.watch.count += 1
        self._take(stamp_of(message), *self._convert(message))


def _name(kind) -> str:
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


def aiding_inputs(node: Node, values: dict, fusion) -> list[Input]:
    """The inputs of speed, velocity and heading that `values` ask for, into the filter `fusion`."""
    inputs = (('speed_topic', (TwistWithCovarianceStamped, Odometry), speed_of, fusion.add_speed),
              ('velocity_topic', (TwistWithCovarianceStamped,), velocity_of, fusion.add_velocity),
              ('heading_topic', (Imu, PoseWithCovarianceStamped), heading_of, fusion.add_heading))
    return [Input(node, values[name], kinds, convert, take) for name, kinds, convert, take in inputs
            if values.get(name)]
