"""How the IMU is mounted, from tf."""
from __future__ import annotations

import time

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import Imu

from ..navigation.strapdown import to_euler
from ..parameters.parameter import ParameterError
from .run import Stop

#: what is waited for is said again after so many seconds
_SAY_AGAIN = 10.0


def mounting_from_tf(node: Node, imu_topic: str, base_frame: str, stop: Stop) -> list[float]:
    """Roll, pitch, yaw (rad) of the rotation from the IMU's frame, that of its messages, to `base_frame`.

    Waits for the first message and for the transform; KeyboardInterrupt when `stop` is requested meanwhile.
    ParameterError where tf2_ros is not installed.
    """
    try:
        from tf2_ros import Buffer, TransformException, TransformListener
    except ImportError:
        raise ParameterError("parameter 'mounting_from_tf' needs the ROS package tf2_ros, which is not installed") \
            from None
    buffer = Buffer()
    listener = TransformListener(buffer, node)
    frames: list[str] = []
    subscription = node.create_subscription(Imu, imu_topic, lambda message: frames.append(message.header.frame_id),
                                            QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT))
    missing, said = '', -_SAY_AGAIN
    while True:
        if frames:
            try:
                rotation = buffer.lookup_transform(base_frame, frames[-1], Time()).transform.rotation
                break
            except TransformException as error:
                missing = f"the transform from '{frames[-1]}' to '{base_frame}' ({error})"
        else:
            missing = f'a message on {subscription.topic_name}, whose header.frame_id is the frame of the IMU'
        if time.monotonic() - said > _SAY_AGAIN:
            said = time.monotonic()
            node.get_logger().info(f'mounting_from_tf: waiting for {missing}')
        rclpy.spin_once(node, timeout_sec=0.1)
        if stop.requested:
            raise KeyboardInterrupt
    node.destroy_subscription(subscription)
    del listener
    rpy = list(to_euler((rotation.w, rotation.x, rotation.y, rotation.z)))
    node.get_logger().info(f"imu.mounting_rpy from tf, '{frames[-1]}' to '{base_frame}': "
                           f"[{', '.join(f'{angle:.4f}' for angle in rpy)}] rad")
    return rpy
