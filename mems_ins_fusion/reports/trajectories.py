"""Trajectories of runs as files that other tools read: TUM text (evo), GeoJSON (maps), rosbag2 (RViz, Foxglove)."""
from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..evaluation.comparison import RunResult, aiding_of
from ..filter.odometry import ANGULAR, LINEAR, ORIENTATION, POSE_COVARIANCE, TWIST_COVARIANCE
from ..filter.publish import published
from ..filter.results import Run
from ..navigation.earth import to_local
from ..recordings.writing import OdometrySamples, write_recording
from ..samples import Recording, Reference

#: points of a line on a map and poses of a TUM file, s apart
MAP_INTERVAL, POSE_INTERVAL = 1.0, 0.1


def odometry_of(recording: Recording, result: RunResult, datum) -> OdometrySamples:
    """What a live filter would have published of `recording` where `result` has states: base_link at `datum`.

    datum: origin of the frame east-north-up, rad, rad, m.
    """
    keep = np.zeros(len(recording.imu), dtype=bool)
    keep[result.run.index] = True
    stamp, rows = published(result.run.config, recording.imu, result.fixes, aiding_of(recording), datum, keep)
    return OdometrySamples(stamp, stamp, rows[:, :ORIENTATION], rows[:, ORIENTATION:POSE_COVARIANCE],
                           rows[:, LINEAR:ANGULAR], rows[:, ANGULAR:TWIST_COVARIANCE],
                           rows[:, POSE_COVARIANCE:LINEAR], rows[:, TWIST_COVARIANCE:])


def write_tum(path: Path, stamp: np.ndarray, position: np.ndarray, orientation: np.ndarray) -> None:
    """`path` in the format of the TUM RGB-D benchmark: s, x y z (m), quaternion x y z w, one line for each pose.

    stamp (n,) ns, position (n, 3), orientation (n, 4).
    """
    seconds, nanoseconds = np.divmod(stamp, 10**9)
    rows = zip(seconds.tolist(), nanoseconds.tolist(), *position.T.tolist(), *orientation.T.tolist())
    line = '%d.%09d %.4f %.4f %.4f %.7f %.7f %.7f %.7f\n'
    with open(path, 'w', encoding='ascii') as file:
        file.write('# timestamp x y z qx qy qz qw\n')
        file.writelines(line % row for row in rows)


def write_track(path: Path, track: Run | Reference, datum) -> None:
    """`track` as TUM text: base_link in the frame east-north-up at `datum`, a pose every POSE_INTERVAL s.

    Where a reference has no heading, the orientation is that of the frame.
    """
    at = _every(track.stamp, POSE_INTERVAL)
    north, east, down = to_local(track.latitude[at], track.longitude[at], track.height[at], datum)
    yaw = np.full(len(at), np.pi / 2) if track.yaw is None else track.yaw[at]
    roll, pitch = (track.roll[at], track.pitch[at]) if isinstance(track, Run) else np.zeros((2, len(at)))
    write_tum(path, track.stamp[at], np.column_stack([east, north, -down]), _orientation(roll, -pitch, np.pi / 2 - yaw))


def _orientation(roll, pitch, yaw) -> np.ndarray:
    """Quaternions x, y, z, w (n, 4) of R_z(yaw) R_y(pitch) R_x(roll)."""
    (cr, cp, cy), (sr, sp, sy) = (f(0.5 * np.array([roll, pitch, yaw])) for f in (np.cos, np.sin))
    return np.column_stack([sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
                            cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy])


def _every(stamp: np.ndarray, interval: float) -> np.ndarray:
    """Indices of the first stamp (ns) in each slot of `interval` s: the same slots for every track."""
    return np.flatnonzero(np.diff(stamp // round(interval * 1e9), prepend=-1))


def write_bag(path: Path, recording: Recording, runs: dict[str, RunResult], datum, values: dict) -> None:
    """A rosbag2: the recording's fixes, and one Odometry topic /odometry/NAME for each of `runs`.

    values: parameters; gnss_topic, frame_id and child_frame_id name what is written. The IMU samples are left out.
    """
    write_recording(replace(recording, imu=None), path, gnss_topic=values['gnss_topic'],
                    odometry={f'/odometry/{name}': odometry_of(recording, run, datum) for name, run in runs.items()},
                    odometry_frame=values['frame_id'], base_frame=values['child_frame_id'])


def write_geojson(path: Path, tracks: dict[str, Run | Reference]) -> None:
    """`tracks` as lines in WGS-84 (RFC 7946), one for each, named; a point every MAP_INTERVAL s."""
    lines = []
    for name, track in tracks.items():
        at = _every(track.stamp, MAP_INTERVAL)
        points = np.round(np.degrees(np.column_stack([track.longitude[at], track.latitude[at]])), 8)
        lines.append({'type': 'Feature', 'properties': {'name': name},
                      'geometry': {'type': 'LineString', 'coordinates': points.tolist()}})
    path.write_text(json.dumps({'type': 'FeatureCollection', 'features': lines}), encoding='ascii')
