"""Reading of a recording into arrays, with messages to the user where that is not possible."""
from __future__ import annotations

import math
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mems_ins_fusion.filter.measurements.base import IMU, NAV_SAT_FIX, NOT_THERE, ODOMETRY, POSE_STAMPED
from mems_ins_fusion.filter.measurements.inertial import Inertial
from mems_ins_fusion.filter.measurements.position import is_fix, is_place
from mems_ins_fusion.filter.measurements.registry import AIDING, MEASUREMENTS, TYPES
from mems_ins_fusion.filter.memory import Kind
from mems_ins_fusion.navigation.earth import from_local
from mems_ins_fusion.navigation.frames import ned_from_enu, unit_quaternions, yaw_from_enu, yaw_of_quaternion
from mems_ins_fusion.recordings import messages
from mems_ins_fusion.recordings.bags import Bag
from mems_ins_fusion.recordings.errors import RecordingError, RecordingWarning
from mems_ins_fusion.recordings.messages import TEMPERATURE
from mems_ins_fusion.samples import (
    NO_SAMPLES,
    Fixes,
    ImuSamples,
    Recording,
    Reference,
    Temperatures,
)

#: message types of fixes
FIX_TYPES = tuple(MEASUREMENTS[Kind.POSITION].messages)
#: message types of a reference
REFERENCE_TYPES = (NAV_SAT_FIX, ODOMETRY, POSE_STAMPED)
_LATEST = 2**63  # ns

#: fields that are kept, by message type
_KEPT = {
    IMU: ('orientation', 'orientation_covariance', 'angular_velocity', 'linear_acceleration'),
    NAV_SAT_FIX: ('status.status', 'latitude', 'longitude', 'altitude', 'position_covariance',
                  'position_covariance_type'),
    TEMPERATURE: ('temperature',),
    ODOMETRY: ('pose.pose.position', 'pose.pose.orientation', 'twist.twist.linear', 'twist.covariance'),
    POSE_STAMPED: ('pose.position', 'pose.orientation'),
}
for _measurement in TYPES.values():
    for _message, _fields in _measurement.messages.items():
        _KEPT[_message] = tuple(dict.fromkeys((*_KEPT.get(_message, ()), *_fields)))
#: message types that are read
READABLE = frozenset(_KEPT)
#: elements of covariances that are kept: of the orientation the first, which marks a missing orientation, and the yaw;
#: of a twist the velocity and the turn rate about the vertical; of a pose the yaw
_COLUMNS = {'orientation_covariance': [0, 8], 'twist.covariance': [0, 1, 2, 6, 7, 8, 12, 13, 14, 35],
            'pose.covariance': [35]}


@dataclass(frozen=True)
class Memory:
    """Memory of a tool. limit: GB, as `memory_limit`. base: GB, without a recording. each: bytes for each message, at
    the tool's peak."""

    limit: float
    base: float
    each: float

    def check(self, path: str, messages: int, part: float = 1.0) -> None:
        """Raise RecordingError if all messages in `path`, of which `messages` are the first `part`, would take more
        than the limit."""
        if self.base + self.each * messages * 1e-9 > self.limit:
            whole = messages / max(part, 1e-6)
            raise RecordingError(f'{path}: about {whole:.2g} messages would take about '
                                 f"{self.base + self.each * whole * 1e-9:.1f} GB of memory, more than parameter "
                                 f"'memory_limit', {self.limit:g} GB: raise it or split the recording")


def read_recording(path, imu_topic, gnss_topic=None, reference_topic=None, temperature_topic=None, progress=None,
                   datum=None, memory: Memory | None = None, inputs=AIDING, **aiding_topics) -> Recording:
    """Read a bag, once, into arrays.

    path: rosbag2 folder, .mcap, .db3 or ROS 1 .bag. Topics that are None or empty are not read.
    reference_topic: NavSatFix, or Odometry or PoseStamped with a pose in a local east-north-up frame, whose origin is
    `datum`: latitude, longitude (rad), height (m). Without it the first fix of `gnss_topic` is used, with a warning.
    progress: called with the part of the recording that is read, 0 to 1. memory: limit of the tool; a longer recording
    is refused before it is read to its end. inputs: measurements besides the fixes. aiding_topics: topics of these, by
    the name of their parameter (`speed_topic`), see `filter.measurements`; no mounting is applied. If some of several
    IMUs are missing, the others are read, with a warning.

    Samples are in the order of arrival (log time) and complete, including those with NaN. A reference is in the order
    of its stamps, without messages that have no fix or contain NaN.
    Raises RecordingError with one line for the user. Warns RecordingWarning where only a part was readable.
    """
    imu_topics = {imu_topic, *(aiding_topics.get(m.topic) for m in inputs if isinstance(m, Inertial))} - {None, ''}
    wanted = [(topic, types) for topic, types in (
        (imu_topic, (IMU,)), (gnss_topic, FIX_TYPES), (reference_topic, REFERENCE_TYPES),
        (temperature_topic, (TEMPERATURE,)),
        *((aiding_topics.get(m.topic), tuple(m.messages)) for m in inputs)) if topic]
    with Bag(path) as bag:
        absent = _absent(bag, imu_topics)
        wanted = [(topic, types) for topic, types in wanted if topic not in absent]
        for topic, types in wanted:
            if bag.topics.get(topic) not in types:
                raise RecordingError(_topic_problem(bag, topic, types))
        arrays, lost = _read_arrays(bag, dict.fromkeys(topic for topic, _ in wanted), progress, memory)
        _report_damage(bag, arrays, lost)
    gnss = _fixes(arrays[gnss_topic], bag.topics[gnss_topic]) if gnss_topic else None
    temperature = _temperatures(arrays[temperature_topic]) if temperature_topic else None
    return Recording(
        name=_name(Path(path)),
        imu=NO_SAMPLES if imu_topic in absent else _imu_samples(arrays[imu_topic]).with_temperature(temperature),
        gnss=gnss,
        reference=_reference(arrays[reference_topic], bag.topics[reference_topic], datum, gnss, reference_topic)
        if reference_topic else None,
        temperature=temperature).having({m.name: m.read(arrays[topic], bag.topics[topic]) for m in inputs
                                         if (topic := aiding_topics.get(m.topic)) and topic not in absent})


def _absent(bag: Bag, imu_topics: set[str]) -> set[str]:
    """The topics in `imu_topics` that the recording does not have, if it has at least one of them; with a warning."""
    counts = bag.counts()
    absent = {topic for topic in imu_topics if bag.topics.get(topic) != IMU or not counts[topic]}
    if absent == imu_topics:
        return set()
    for topic in sorted(absent):
        warnings.warn(f"no messages of an IMU on '{topic}' in {bag.path}: the other IMU is used alone",
                      RecordingWarning, stacklevel=3)
    return absent


def _name(path: Path) -> str:
    """Name of the recording: that of its file or folder, or of the folder above if it is just `bag`."""
    path = path.absolute()
    return path.parent.name if path.stem in ('bag', 'rosbag2') and path.parent.name else path.stem


def _topic_problem(bag: Bag, topic, types) -> str:
    """Message for a user who asked for `topic` with one of `types`, which the recording does not have."""
    counts = bag.counts()
    if not counts.total():
        return f'{bag.path} holds no messages' + ''.join(f'; {line}' for line in bag.damage())
    kinds = {name: _short(kind) for name, kind in sorted(bag.topics.items())}
    wanted = ' or '.join(map(_short, types))
    fitting = [f'{name} ({counts[name]} messages)' for name in kinds if bag.topics[name] in types]
    if topic in kinds:
        problem = f"topic '{topic}' in {bag.path} carries {kinds[topic]}, not {wanted}"
        found = f'; these do: {", ".join(fitting)}'
    else:
        problem = f"no topic '{topic}' in {bag.path}"
        found = f'; of type {wanted}: {", ".join(fitting)}'
    if fitting:
        return problem + found
    there = ', '.join(f'{name} ({kind})' for name, kind in kinds.items())
    return f'{problem}; the recording has no topic of type {wanted}, only {there}'


def _short(kind: str) -> str:
    """A type of messages as people write it: package/Name."""
    return kind.replace('/msg/', '/')


def _read_arrays(bag: Bag, topics, progress, memory: Memory | None) -> tuple[dict, Counter]:
    """{topic: {field: array}} in the order of log time, with `received` and `stamp`; and the messages not decoded."""
    blocks: dict = {topic: [] for topic in topics}
    lost: Counter = Counter()
    count = 0
    for topic, times, raw, part in bag.read(topics):
        if raw:
            array, valid = messages.decode(raw, bag.topics[topic])
            dated = np.array([0 <= time < _LATEST for time in times])
            keep = dated[valid]
            lost[topic] += len(raw) - int(keep.sum())
            received = np.array([time for time, good in zip(times, valid & dated) if good], np.int64)
            block = {name: thinned(name, array[name][keep]) for name in _KEPT[bag.topics[topic]]}
            stamp = messages.stamps(array[keep]) if 'header.stamp.sec' in array.dtype.names else received
            blocks[topic].append({**block, 'stamp': stamp, 'received': received})
            count += len(received)
            if memory is not None:
                memory.check(f'{bag.path}', count, part)
        if progress is not None:
            progress(part)
    return {topic: _join(found) for topic, found in blocks.items()}, lost


def thinned(name: str, array: np.ndarray) -> np.ndarray:
    """A copy of what is kept of a field."""
    return array[:, _COLUMNS[name]] if name in _COLUMNS else array.copy()


def _join(blocks: list[dict]) -> dict | None:
    """The blocks as one, in the order of log time; None where there are no messages. Empties `blocks`."""
    if not any(len(block['received']) for block in blocks):
        return None
    joined = {name: np.concatenate([block.pop(name) for block in blocks]) for name in list(blocks[0])}
    received = joined['received']
    if (np.diff(received) < 0).any():
        order = np.argsort(received, kind='stable')
        for name in joined:
            joined[name] = joined[name][order]
    return joined


def _report_damage(bag: Bag, arrays: dict, lost: Counter) -> None:
    """RecordingError where a topic has no messages; RecordingWarning where some are lost."""
    damage = bag.damage() + [f"{bag.path}: {count} messages on '{topic}' are no valid {bag.topics[topic]}"
                             for topic, count in lost.items() if count]
    damage = '; '.join(damage)
    for topic, array in arrays.items():
        if array is None:
            if damage:
                raise RecordingError(f"{damage}; of topic '{topic}' nothing is readable")
            if not bag.counts().total():
                raise RecordingError(f'{bag.path} holds no messages')
            raise RecordingError(f"topic '{topic}' in {bag.path} holds no messages")
    if damage:
        counts = bag.counts()
        readable = ', '.join(f'{len(array["received"])} messages of {topic} '
                             f'({(array["received"][-1] - array["received"][0]) / 1e9:.1f} s)'
                             + _share(counts[topic], len(array['received']))
                             for topic, array in arrays.items())
        warnings.warn(f'{damage}; readable: {readable}', RecordingWarning, stacklevel=3)


def _share(total: int, read: int) -> str:
    """How many messages are lost, where the recording says how many there were."""
    return f', {total - read} lost' if total > read else ''


def _imu_samples(array) -> ImuSamples:
    return ImuSamples(stamp=array['stamp'], received=array['received'], specific_force=array['linear_acceleration'],
                      angular_rate=array['angular_velocity'], orientation=_orientation(array))


def _orientation(array) -> np.ndarray | None:
    """Quaternions, NaN in messages that say they have none; None where none has one.

    A covariance that begins with -1 says so (sensor_msgs/Imu); zeros, and a constant identity, are fields not filled.
    """
    orientation = array['orientation'].copy()
    absent = (array['orientation_covariance'][:, 0] == NOT_THERE[0]) | ~orientation.any(axis=1)
    if absent.all() or (orientation[~absent] == (0, 0, 0, 1)).all():
        return None
    orientation[absent] = np.nan
    return orientation


def _fixes(array, msgtype) -> Fixes:
    return MEASUREMENTS[Kind.POSITION].read(array, msgtype)


def _temperatures(array) -> Temperatures:
    return Temperatures(stamp=array['stamp'], received=array['received'], celsius=array['temperature'])


def _reference(array, msgtype, datum, gnss, topic) -> Reference:
    if msgtype == NAV_SAT_FIX:
        fixes = _fixes(array, msgtype)
        reference = Reference(fixes.stamp, fixes.latitude, fixes.longitude, fixes.height).select(is_fix(fixes))
    else:
        reference = _local_reference(array, msgtype, datum if datum is not None else _first_fix(gnss, topic))
    reference = reference.select(is_place(reference.latitude, reference.longitude, reference.height))
    if not len(reference):
        raise RecordingError(f"reference topic '{topic}' holds no valid position")
    return reference.select(np.argsort(reference.stamp, kind='stable'))


def _first_fix(gnss: Fixes | None, topic) -> tuple:
    """The datum for local poses on `topic` if none is given: the first fix."""
    valid = () if gnss is None else np.flatnonzero(is_fix(gnss))
    if not len(valid):
        raise RecordingError(f"reference topic '{topic}' holds local poses: give the datum (latitude, longitude and "
                             'height of their origin)')
    first = valid[0]
    datum = gnss.latitude[first], gnss.longitude[first], gnss.height[first]
    warnings.warn(f"reference topic '{topic}' holds local poses and no datum is given: their origin is taken to be the "
                  f'first fix, {math.degrees(datum[0]):.8f} deg, {math.degrees(datum[1]):.8f} deg, {datum[2]:.3f} m',
                  RecordingWarning, stacklevel=4)
    return datum


def _local_reference(array, msgtype, datum) -> Reference:
    """A reference from poses (east-north-up at `datum`; body axes forward-left-up)."""
    prefix = 'pose.pose' if msgtype == ODOMETRY else 'pose'
    east, north, up = array[f'{prefix}.position'].T
    orientation = unit_quaternions(array[f'{prefix}.orientation'])
    yaw = yaw_from_enu(yaw_of_quaternion(*orientation.T))
    latitude, longitude, height = from_local(north, east, -up, tuple(float(value) for value in datum))
    velocity = None
    if msgtype == ODOMETRY:
        velocity = ned_from_enu(_rotated(orientation, array['twist.twist.linear']))
    return Reference(array['stamp'], latitude, longitude, height, velocity, yaw)


def _rotated(quaternion, vector) -> np.ndarray:
    """`vector` (n, 3) rotated by unit quaternions x, y, z, w (n, 4), of which some may be NaN."""
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    return vector + 2.0 * np.cross(axis, np.cross(axis, vector) + w * vector)
