"""Mounting of the IMU and lever arms of antennas and other sensors, from tf."""
from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time

from ..filter.measurements.registry import further_inputs
from ..navigation.strapdown import to_euler
from ..parameters.parameter import ParameterError
from ..parameters.table import parameters_of
from ..recordings.messages import IMU
from ..recordings.reading import FIX_TYPES
from ..recordings.transforms import has_frame, sensor_frame
from .inputs import message_class
from .run import Stop

#: s between two messages on what the node waits for
_SAY_AGAIN = 10.0
#: s for which the node waits for inputs besides IMU and antenna: a missing one must not stop a vehicle
_PATIENCE = 10.0
#: frames of the world (REP 105), in which a sensor has no place
_WORLD = frozenset({'map', 'odom', 'earth', 'world'})


def geometry_from_tf(node: Node, values: Mapping, stop: Stop) -> dict:
    """Values from tf for the parameters that are to come from tf: imu.mounting_rpy and lever arms.

    values: checked parameters. Waits for the first messages of IMU and antenna and for their transforms. Raises
    KeyboardInterrupt when `stop` is requested in this time, ParameterError where tf2_ros is not installed.
    """
    asked = [name for name in ('mounting_from_tf', 'arms_from_tf') if values[name]]
    if not asked:
        return {}
    tf = _Transforms(node, asked, values['child_frame_id'], stop)
    imu = _Sensor(node, 'the IMU', values['imu_topic'], (IMU,))
    arms = _arms(node, values) if values['arms_from_tf'] else {}
    first = [sensor for name, sensor in arms.items() if name == 'gnss.lever_arm']
    tf.wait([imu, *first], math.inf)
    tf.wait(list(arms.values()), _PATIENCE)
    found = {'imu.mounting_rpy': _mounting(imu.transform)} if values['mounting_from_tf'] else {}
    found |= {name: arm for name, sensor in arms.items() if (arm := _arm(node, name, sensor, imu, values)) is not None}
    for name, value in found.items():
        parameters_of(values)[name].check(value)
        frame = imu.frame if name == 'imu.mounting_rpy' else arms[name].frame
        node.get_logger().info(f"{name} from tf, '{frame}' to '{values['child_frame_id']}': {_text(value)} "
                               f"{'rad' if name == 'imu.mounting_rpy' else 'm'}, instead of {_text(values[name])}")
    for sensor in (imu, *arms.values()):
        sensor.close()
    return found


def _arms(node, values) -> dict[str, _Sensor]:
    """By the parameter of its lever arm, each input that has one, and whose messages name a frame of its own."""
    wanted = [('gnss.lever_arm', 'the antenna', values['gnss_topic'], FIX_TYPES)]
    wanted += [(f'{one.name}.lever_arm', f"'{one.name}'", values[one.topic], one.messages)
               for one in further_inputs(values) if f"{one.name}.lever_arm" in values]
    return {name: _Sensor(node, what, topic, found) for name, what, topic, kinds in wanted
            if topic and (found := tuple(filter(has_frame, kinds)))}


def _mounting(transform) -> list[float]:
    q = transform.rotation
    return list(to_euler((q.w, q.x, q.y, q.z)))


def _arm(node, name, sensor, imu, values) -> list[float] | None:
    """From the IMU to `sensor`, axes of the vehicle, m; None, with a warning, where tf does not have it."""
    why = ''
    if sensor.transform is None:
        why = f'nothing from tf: {sensor.missing}'
    elif sensor.frame == imu.frame:
        why = f"messages on {sensor.topic} have the IMU's frame '{imu.frame}', not the frame of the sensor"
    elif sensor.frame in _WORLD | {values['frame_id'], values['map_frame_id']}:
        why = f"messages on {sensor.topic} have '{sensor.frame}', a frame of the world and not of the vehicle"
    if why:
        node.get_logger().warning(f'{name} stays {_text(values[name])} m: {why}')
        return None
    return (_place(sensor.transform) - _place(imu.transform)).tolist()


def _place(transform) -> np.ndarray:
    return np.array([transform.translation.x, transform.translation.y, transform.translation.z])


def _text(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{value:.4f}' for value in values)}]"


class _Sensor:
    """A topic whose first message names the frame of the sensor `what`. kinds: message types that it may have."""

    def __init__(self, node: Node, what: str, topic: str, kinds: Sequence[str]):
        self.what, self.topic, self.frame, self.transform = what, topic, '', None
        self.missing = f'a message on {topic}, which names the frame of {what}'
        self._node, self._kinds, self._subscription = node, [kind for kind in kinds if message_class(kind)], None
        if len(self._kinds) == 1:
            self._subscribe(self._kinds[0])

    def look(self, buffer, base: str, absent: type[Exception]) -> None:
        """Subscribe if there is a publisher, and take the transform if it is available."""
        if self._subscription is None:
            for info in self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(self.topic)):
                if info.topic_type in self._kinds and self._subscription is None:
                    self._subscribe(info.topic_type)
        if self.frame and self.transform is None:
            try:
                self.transform = buffer.lookup_transform(base, self.frame, Time()).transform
            except absent as error:
                self.missing = f"the transform from '{self.frame}' to '{base}' ({error})"

    def close(self) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)

    def _subscribe(self, kind):
        def take(message):
            self.frame = self.frame or sensor_frame(message, kind)

        self._subscription = self._node.create_subscription(
            message_class(kind), self.topic, take, QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT))


class _Transforms:
    """The transforms on tf. asked: names of the parameters that need them."""

    def __init__(self, node: Node, asked: Sequence[str], base: str, stop: Stop):
        try:
            from tf2_ros import Buffer, TransformException, TransformListener
        except ImportError:
            raise ParameterError(f"parameter '{asked[0]}' needs the ROS package tf2_ros, which is not installed") \
                from None
        self._buffer, self._absent = Buffer(), TransformException
        self._listener = TransformListener(self._buffer, node)  # it listens as long as it is there
        self._node, self._asked, self._base, self._stop = node, ', '.join(asked), base, stop

    def wait(self, sensors: Sequence[_Sensor], patience: float) -> None:
        """Wait until the transform of each sensor is available, at most `patience` s."""
        began, said = time.monotonic(), -_SAY_AGAIN
        while time.monotonic() - began < patience:
            for sensor in sensors:
                sensor.look(self._buffer, self._base, self._absent)
            missing = [sensor.missing for sensor in sensors if sensor.transform is None]
            if not missing:
                return
            if time.monotonic() - said > _SAY_AGAIN:
                said = time.monotonic()
                self._node.get_logger().info(f"{self._asked}: waiting for {', '.join(missing)}")
            rclpy.spin_once(self._node, timeout_sec=0.1)
            if self._stop.requested:
                raise KeyboardInterrupt
