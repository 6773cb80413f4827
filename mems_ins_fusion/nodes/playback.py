"""Replayed odometry on topics, with /clock, at a chosen speed."""
from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from ..recordings.writing import OdometrySamples
from ..samples import SECOND

#: s between two checks for a signal
_PATIENCE = 0.1


def play(node: Node, tracks: dict[str, OdometrySamples], rate: float, stopped: Callable[[], bool], frame_id: str,
         child_frame_id: str) -> None:
    """Publish `tracks` on /odometry/NAME, all on one time line, `rate` times as fast as recorded, until `stopped()`."""
    clock = node.create_publisher(Clock, '/clock', 10)  # reliable: heard by both kinds
    publishers = {name: node.create_publisher(Odometry, f'/odometry/{name}', 10) for name in tracks}
    stamps = np.concatenate([track.stamp for track in tracks.values()])
    owner = np.repeat(np.arange(len(tracks)), [len(track.stamp) for track in tracks.values()])
    index = np.concatenate([np.arange(len(track.stamp)) for track in tracks.values()])
    order = np.argsort(stamps, kind='stable')
    names = list(tracks)
    began, last = time.monotonic(), None
    for k in order:
        stamp, name = int(stamps[k]), names[owner[k]]
        if not _wait_until(began + (stamp - int(stamps[order[0]])) / (SECOND * rate), stopped):
            return
        if stamp != last:
            clock.publish(Clock(clock=time_message(stamp)))
            last = stamp
        publishers[name].publish(_message(tracks[name], int(index[k]), frame_id, child_frame_id))


def _wait_until(moment: float, stopped) -> bool:
    """Wait until `moment`; False if a stop is requested before."""
    while (remaining := moment - time.monotonic()) > 0 and not stopped():
        time.sleep(min(remaining, _PATIENCE))
    return not stopped()


def time_message(stamp: int) -> Time:
    """stamp: ns."""
    seconds, nanoseconds = divmod(stamp, SECOND)
    return Time(sec=seconds, nanosec=nanoseconds)


def _message(track: OdometrySamples, i: int, frame_id: str, child_frame_id: str) -> Odometry:
    message = Odometry(child_frame_id=child_frame_id)
    message.header.stamp = time_message(int(track.stamp[i]))
    message.header.frame_id = frame_id
    pose, twist = message.pose, message.twist
    for target, values in ((pose.pose.position, track.position[i]), (twist.twist.linear, track.velocity[i])):
        target.x, target.y, target.z = values.tolist()
    q = pose.pose.orientation
    q.x, q.y, q.z, q.w = track.orientation[i].tolist()
    pose.covariance[:] = track.pose_covariance[i].ravel()
    twist.covariance[:] = track.twist_covariance[i].ravel()
    return message
