"""Writing of recordings as rosbag2."""
from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from mems_ins_fusion.filter.measurements.base import NOT_THERE
from mems_ins_fusion.filter.measurements.registry import AIDING, MEASUREMENTS
from mems_ins_fusion.filter.memory import Kind
from mems_ins_fusion.guard import one_line
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.navigation.frames import FLU_TO_FRD, ned_from_enu
from mems_ins_fusion.recordings import messages
from mems_ins_fusion.recordings.errors import RecordingError, needs_rosbags
from mems_ins_fusion.recordings.mcap import BLOCK
from mems_ins_fusion.results import ResultError, result_folder
from mems_ins_fusion.samples import (
    Fixes,
    ImuSamples,
    Recording,
    Reference,
    Temperatures,
)

STORAGES = ('mcap', 'sqlite3')


@dataclass(frozen=True)
class OdometrySamples:
    """The content of nav_msgs/Odometry messages, in the axes of REP-103.

    stamp, received: (n,) int64 ns. position: (n, 3) m east-north-up at the datum. orientation: (n, 4) quaternion
    x, y, z, w from base_link (forward-left-up) to east-north-up. velocity: (n, 3) m/s and angular_rate: (n, 3) rad/s
    in base_link. pose_covariance, twist_covariance: (n, 6, 6) or (n, 36), or None for zeros.
    """

    stamp: np.ndarray
    received: np.ndarray
    position: np.ndarray
    orientation: np.ndarray
    velocity: np.ndarray
    angular_rate: np.ndarray
    pose_covariance: np.ndarray | None = None
    twist_covariance: np.ndarray | None = None


def odometry_from_reference(reference: Reference, datum, roll=0.0, pitch=0.0) -> OdometrySamples:
    """A reference with velocity and yaw as odometry at `datum` (latitude, longitude in rad, height in m).

    roll, pitch: (n,) rad of the body forward-right-down, zero where not known. The angular rate is left at zero.
    """
    from scipy.spatial.transform import Rotation
    north, east, down = to_local(reference.latitude, reference.longitude, reference.height,
                                 tuple(float(value) for value in datum))
    angles = np.column_stack(np.broadcast_arrays(reference.yaw, pitch, roll))
    to_ned = Rotation.from_euler('ZYX', angles)
    turn_axes = Rotation.from_matrix(ned_from_enu(np.eye(3)))
    flip = Rotation.from_matrix(FLU_TO_FRD)
    return OdometrySamples(
        stamp=reference.stamp, received=reference.stamp,
        position=np.column_stack([east, north, -down]), orientation=(turn_axes * to_ned * flip).as_quat(),
        velocity=(to_ned * flip).inv().apply(reference.velocity), angular_rate=np.zeros((len(reference), 3)))


def write_recording(recording: Recording, path, storage='mcap', *, imu_topic='/imu/data', gnss_topic='/gps/fix',
                    reference_topic='/reference/fix', temperature_topic='/imu/temperature',
                    odometry: dict[str, OdometrySamples] | None = None, imu_frame='imu', gnss_frame='gnss',
                    odometry_frame='odom', base_frame='base_link', overwrite=False, inputs=AIDING,
                    **aiding_topics) -> None:
    """Write the parts that `recording` has, and odometry by topic, as the rosbag2 folder `path`.

    storage: mcap or sqlite3. A reference is written as NavSatFix, logged at its stamps; its velocity and yaw only
    through `odometry` (see `odometry_from_reference`). inputs: measurements besides the fixes; aiding_topics: of these,
    by the name of their parameter (`speed_topic`); else each goes to its own (`Measurement.written_to`). Messages are
    logged in the order of `received`.
    The folder has its name only when it is complete. Raises ValueError (ResultError) where `path` is taken and
    `overwrite` is false, RecordingError where rosbags is absent or the storage unknown.
    """
    in_imu, in_antenna = {'header.frame_id': imu_frame}, {'header.frame_id': gnss_frame}
    streams, found = [], recording.streams()
    if recording.imu is not None:
        streams.append(_Stream(imu_topic, messages.IMU, recording.imu, _imu_fields, in_imu))
    if recording.gnss is not None:
        fix_fields = MEASUREMENTS[Kind.POSITION].written
        streams.append(_Stream(gnss_topic, messages.NAV_SAT_FIX, recording.gnss, fix_fields, in_antenna))
    if recording.reference is not None:
        streams.append(_Stream(reference_topic, messages.NAV_SAT_FIX, recording.reference, _reference_fields,
                               in_antenna))
    if recording.temperature is not None:
        streams.append(_Stream(temperature_topic, messages.TEMPERATURE, recording.temperature,
                               lambda samples: {'temperature': samples.celsius}, in_imu))
    for measurement in (m for m in inputs if m.name in found):
        frames = {'header.frame_id': gnss_frame if measurement.of_antenna else base_frame, 'child_frame_id': base_frame}
        streams.append(_Stream(aiding_topics.get(measurement.topic, measurement.written_to),
                               next(iter(measurement.messages)), found[measurement.name], measurement.written, frames))
    for topic, samples in (odometry or {}).items():
        streams.append(_Stream(topic, messages.ODOMETRY, samples, _odometry_fields,
                               {'header.frame_id': odometry_frame, 'child_frame_id': base_frame}))
    _write(Path(path), storage, streams, overwrite)


@dataclass(frozen=True)
class _Stream:
    """The samples of one topic and how they become messages."""

    topic: str
    kind: str
    samples: ImuSamples | Fixes | Reference | Temperatures | OdometrySamples
    fields: Callable[..., dict]
    strings: dict[str, str]

    @property
    def times(self) -> np.ndarray:
        return self.samples.stamp if isinstance(self.samples, Reference) else self.samples.received

    def encoded(self, index: np.ndarray) -> list[memoryview]:
        """The samples at `index` (m,), serialized."""
        arrays = {f.name: getattr(self.samples, f.name) for f in fields(self.samples)}
        part = replace(self.samples, **{name: _finite(array[index]) for name, array in arrays.items()
                                        if array is not None})
        return messages.encode(self.kind, {**messages.stamp_fields(part.stamp), **self.fields(part)}, self.strings)


def _finite(values: np.ndarray) -> np.ndarray:
    """`values`, NaN where they are infinite: nothing measured is."""
    infinite = np.isinf(values)
    return np.where(infinite, np.nan, values) if infinite.any() else values


def _imu_fields(imu: ImuSamples) -> dict:
    fields = {'angular_velocity': imu.angular_rate, 'linear_acceleration': imu.specific_force}
    if imu.orientation is None:
        return {**fields, 'orientation': (0.0, 0.0, 0.0, 1.0), 'orientation_covariance': NOT_THERE}
    covariance = np.zeros((len(imu), 9))
    covariance[np.isnan(imu.orientation).any(axis=1), 0] = NOT_THERE[0]
    return {**fields, 'orientation': imu.orientation, 'orientation_covariance': covariance}


def _reference_fields(reference: Reference) -> dict:
    return {'latitude': np.degrees(reference.latitude), 'longitude': np.degrees(reference.longitude),
            'altitude': reference.height, 'status.service': 1}


def _odometry_fields(odometry: OdometrySamples) -> dict:
    fields = {'pose.pose.position': odometry.position, 'pose.pose.orientation': odometry.orientation,
              'twist.twist.linear': odometry.velocity, 'twist.twist.angular': odometry.angular_rate}
    for name, covariance in (('pose.covariance', odometry.pose_covariance),
                             ('twist.covariance', odometry.twist_covariance)):
        if covariance is not None:
            fields[name] = covariance.reshape(-1, 36)
    return fields


def _write(path: Path, storage: str, streams: list[_Stream], overwrite: bool) -> None:
    """Write all `streams` in the order of log time, serialized block by block: as messages they are several times as
    large as in arrays."""
    if storage not in STORAGES:
        raise RecordingError(f"unknown storage '{storage}' for {path}: expected {' or '.join(STORAGES)}")
    with needs_rosbags(f'writing {path}'):
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.rosbag2.errors import WriterError
        from rosbags.typesys import Stores, get_typestore
    store = get_typestore(Stores.ROS2_JAZZY)
    times = np.concatenate([stream.times for stream in streams])
    order = np.argsort(times, kind='stable')
    first = np.concatenate([[0], np.cumsum([len(stream.times) for stream in streams])])
    try:
        with result_folder(path, overwrite, marker='metadata.yaml') as folder:
            inner = folder / path.absolute().name  # rosbags makes the folder itself and names the data after it
            with Writer(inner, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
                connections = [writer.add_connection(s.topic, s.kind, typestore=store) for s in streams]
                for begin in range(0, len(order), BLOCK):
                    block = order[begin:begin + BLOCK]
                    owner = np.searchsorted(first, block, side='right') - 1
                    data = [iter(s.encoded(block[owner == i] - first[i])) for i, s in enumerate(streams)]
                    for i, time in zip(owner.tolist(), times[block].tolist()):
                        writer.write(connections[i], time, next(data[i]))
            for file in inner.iterdir():
                file.rename(folder / file.name)
            inner.rmdir()
    except (sqlite3.Error, WriterError) as error:
        raise ResultError(f'cannot write {path}: {one_line(error)}') from None
