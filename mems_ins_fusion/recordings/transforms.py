"""Places of sensors in the vehicle, from the static transforms in a recording (`/tf_static`)."""
from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter

import numpy as np

from mems_ins_fusion.filter.measurements.base import ODOMETRY, POSE, POSE_STAMPED
from mems_ins_fusion.filter.measurements.fix_quality import NAV_PVT
from mems_ins_fusion.recordings.bags import Bag
from mems_ins_fusion.recordings.messages import deserialized

TOPIC, TYPE = '/tf_static', 'tf2_msgs/msg/TFMessage'
#: frame of the vehicle (REP 105)
BASE = 'base_link'
#: largest number of frames between a sensor and the vehicle; with more, the transforms form a circle
_LONGEST = 50
#: message types without a header, or whose header names the frame of the world: field with the frame of the sensor, ''
#: if there is none
_FRAME = {ODOMETRY: 'child_frame_id', POSE_STAMPED: '', POSE: '', NAV_PVT: ''}


def has_frame(kind: str) -> bool:
    """Whether messages of this type name the frame of what measures."""
    return _FRAME.get(kind) != ''


def sensor_frame(message, kind: str) -> str:
    """Frame of the sensor in a message of a type that has one (`has_frame`)."""
    return attrgetter(_FRAME.get(kind, 'header.frame_id'))(message).lstrip('/')


def sensor_poses(bag: Bag, topics: Mapping[str, str]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """For each topic whose frame is connected to BASE: position of the sensor, (3,) m, and the rotation (3, 3) from its
    axes, in BASE.

    bag: open. topics: name and message type; the frame is that of the first message. Damaged messages are left out.
    """
    topics = {topic: kind for topic, kind in topics.items() if has_frame(kind)}
    if bag.topics.get(TOPIC) != TYPE:
        return {}
    links: dict[str, tuple[str, np.ndarray, np.ndarray]] = {}
    for _, _, raw, _ in bag.read([TOPIC]):
        for message in filter(None, deserialized(raw, TYPE)):
            links |= {one.child_frame_id.lstrip('/'): link for one in message.transforms
                      if (link := _link(one)) is not None}
    frames: dict[str, str] = {}
    for topic, _, raw, _ in bag.read(topics) if links else ():
        if topic not in frames:
            frames |= {topic: sensor_frame(message, topics[topic])
                       for message in filter(None, deserialized(raw[:1], topics[topic]))}
        if len(frames) == len(topics):
            break
    found = {topic: _in_base(links, frame) for topic, frame in frames.items()}
    return {topic: place for topic, place in found.items() if place is not None}


def _link(one) -> tuple[str, np.ndarray, np.ndarray] | None:
    """Parent, rotation (3, 3) and translation (3,) of a transform; None where it is not valid."""
    from scipy.spatial.transform import Rotation

    translation, quaternion = (np.array([getattr(part, axis) for axis in axes]) for part, axes in (
        (one.transform.translation, 'xyz'), (one.transform.rotation, 'xyzw')))
    if not np.isfinite([*translation, *quaternion]).all() or not quaternion.any():
        return None
    return one.header.frame_id.lstrip('/'), Rotation.from_quat(quaternion).as_matrix(), translation


def _in_base(links: Mapping[str, tuple], frame: str) -> tuple[np.ndarray, np.ndarray] | None:
    up, down = (_to_root(links, name) for name in (frame, BASE))
    if up is None or down is None or up[0] != down[0]:
        return None
    (_, rotation, place), (_, of_base, base) = up, down
    return of_base.T @ (place - base), of_base.T @ rotation


def _to_root(links: Mapping[str, tuple], frame: str) -> tuple[str, np.ndarray, np.ndarray] | None:
    """The root of the tree of frames that contains `frame`, and rotation and position in it; None for a circle."""
    rotation, place = np.eye(3), np.zeros(3)
    for _ in range(_LONGEST):
        if frame not in links:
            return frame, rotation, place
        frame, turned, moved = links[frame]
        rotation, place = turned @ rotation, turned @ place + moved
    return None
