"""Trajectories of runs as files that other tools read: TUM text (evo), GeoJSON, GPX and KML (maps), CSV (tables),
rosbag2 (RViz, Foxglove)."""
from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from ..evaluation.comparison import RunResult, aiding_of
from ..evaluation.metrics import Errors
from ..filter.memory import PLANAR
from ..filter.runs.live_output import published
from ..filter.runs.odometry import ANGULAR, LINEAR, ORIENTATION, POSE_COVARIANCE, TWIST_COVARIANCE
from ..filter.runs.results import Run
from ..navigation.earth import to_local
from ..navigation.frames import near
from ..recordings.writing import OdometrySamples, write_recording
from ..samples import SECOND, Recording, Reference

#: s, between two points of a line on a map
MAP_INTERVAL = 1.0
#: s, between two poses of a TUM or CSV file
POSE_INTERVAL = 0.1


def odometry_of(recording: Recording, result: RunResult, datum) -> OdometrySamples:
    """The odometry of a live filter for `recording` at the states of `result`: base_link at `datum`.

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
    seconds, nanoseconds = np.divmod(stamp, SECOND)
    rows = zip(seconds.tolist(), nanoseconds.tolist(), *position.T.tolist(), *orientation.T.tolist())
    line = '%d.%09d %.4f %.4f %.4f %.7f %.7f %.7f %.7f\n'
    with open(path, 'w', encoding='ascii') as file:
        file.write('# timestamp x y z qx qy qz qw\n')
        file.writelines(line % row for row in rows)


def write_truth(path: Path, reference: Reference, datum) -> None:
    """`reference` as TUM text in the frame east-north-up at `datum`, with a pose at each of its epochs.

    Without a heading the orientation is that of the frame.
    """
    yaw = np.full(len(reference), np.pi / 2) if reference.yaw is None else reference.yaw
    write_tum(path, reference.stamp, _local(reference, datum), _orientation(*np.zeros((2, len(yaw))), np.pi / 2 - yaw))


def write_judged(path: Path, run: Run, errors: Errors, reference: Reference, datum) -> None:
    """The positions at which the error of `run` was measured as TUM text: the point that `reference` describes, by the
    run, at the epochs that count. evo without alignment measures the reported error between this file and that of the
    truth."""
    at = np.searchsorted(reference.stamp, errors.stamp)
    position = _local(reference.select(at), datum)
    position[:, 0] += errors.east
    position[:, 1] += errors.north
    origin = run.stamp[0]
    height, roll, pitch, yaw = (np.interp(errors.stamp - origin, run.stamp - origin, values)
                                for values in (run.height, run.roll, run.pitch, np.unwrap(run.yaw)))
    position[:, 2] += height - reference.height[at]
    write_tum(path, errors.stamp, position, _orientation(roll, -pitch, np.pi / 2 - yaw))


def _local(track: Reference, datum) -> np.ndarray:
    """East, north, up (n, 3), m."""
    north, east, down = to_local(track.latitude, track.longitude, track.height, datum)
    return np.column_stack([east, north, -down])


#: columns of a CSV
CSV_COLUMNS = ('time_s', 'latitude_deg', 'longitude_deg', 'height_m', 'velocity_north_mps', 'velocity_east_mps',
               'velocity_down_mps', 'roll_deg', 'pitch_deg', 'yaw_deg', 'sigma_north_m', 'sigma_east_m',
               'sigma_velocity_north_mps', 'sigma_velocity_east_mps', 'sigma_yaw_deg')
#: columns of `Run.sigma` of the last five of them, of a planar and of a strapdown run
_PLANAR_SIGMAS = (0, 1, 2, 3, 4)
_STRAPDOWN_SIGMAS = (0, 1, 3, 4, 8)


def write_csv(path: Path, run: Run) -> None:
    """`run` as a table, a row every POSE_INTERVAL s: base_link, forward-right-down in north-east-down, yaw clockwise
    from north; time in s since the epoch."""
    at = first_in_each_slot(run.stamp, POSE_INTERVAL)
    sigma = run.sigma[at][:, _PLANAR_SIGMAS if run.config.mechanization == PLANAR else _STRAPDOWN_SIGMAS]
    attitude = np.degrees(np.column_stack([run.roll, run.pitch, run.yaw])[at])
    rows = np.column_stack([_degrees(run, at), run.height[at], run.velocity[at], attitude, sigma[:, :4],
                            np.degrees(sigma[:, 4])])
    line = '%d.%09d,%.9f,%.9f,%.4f' + ',%.4f' * (len(CSV_COLUMNS) - 4) + '\n'
    seconds, nanoseconds = np.divmod(run.stamp[at], SECOND)
    with open(path, 'w', encoding='ascii') as file:
        file.write(','.join(CSV_COLUMNS) + '\n')
        file.writelines(line % (*time, *row) for *time, row in zip(seconds.tolist(), nanoseconds.tolist(),
                                                                   rows.tolist()))


def _degrees(track: Run | Reference, at: np.ndarray) -> np.ndarray:
    """Latitude and longitude, (k, 2) deg from -180 to 180, at the indices `at` (k,)."""
    return np.degrees(np.column_stack([track.latitude[at], near(track.longitude[at], 0.0)]))


def write_gpx(path: Path, run: Run, name: str) -> None:
    """`run` as a track of GPX 1.1, a point every MAP_INTERVAL s."""
    at = first_in_each_slot(run.stamp, MAP_INTERVAL)
    points = [f'<trkpt lat="{latitude:.8f}" lon="{longitude:.8f}"><ele>{height:.2f}</ele><time>{_utc(stamp)}</time>'
              '</trkpt>' for (latitude, longitude), height, stamp in zip(
                  _degrees(run, at), run.height[at], run.stamp[at].tolist())]
    path.write_text('<?xml version="1.0" encoding="UTF-8"?>\n'
                    '<gpx version="1.1" creator="mems_ins_fusion" xmlns="http://www.topografix.com/GPX/1/1">\n'
                    f'<trk><name>{escape(name)}</name><trkseg>\n' + '\n'.join(points) + '\n</trkseg></trk>\n</gpx>\n',
                    encoding='utf-8')


def _utc(stamp: int) -> str:
    """`stamp`, ns, as ISO 8601 to milliseconds."""
    seconds, nanoseconds = divmod(stamp, SECOND)
    return f'{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds // 10**6:03d}Z'


def write_kml(path: Path, run: Run, name: str) -> None:
    """`run` as a line of KML 2.2 on the ground, a point every MAP_INTERVAL s."""
    at = first_in_each_slot(run.stamp, MAP_INTERVAL)
    points = ' '.join(f'{longitude:.8f},{latitude:.8f},{height:.2f}' for (latitude, longitude), height in zip(
        _degrees(run, at), run.height[at]))
    path.write_text('<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">\n<Document>'
                    f'<name>{escape(name)}</name>\n<Placemark><name>{escape(name)}</name><LineString><tessellate>1'
                    f'</tessellate><altitudeMode>clampToGround</altitudeMode>\n<coordinates>{points}</coordinates>\n'
                    '</LineString></Placemark></Document>\n</kml>\n', encoding='utf-8')


def _orientation(roll, pitch, yaw) -> np.ndarray:
    """Quaternions x, y, z, w (n, 4) of R_z(yaw) R_y(pitch) R_x(roll)."""
    (cr, cp, cy), (sr, sp, sy) = (f(0.5 * np.array([roll, pitch, yaw])) for f in (np.cos, np.sin))
    return np.column_stack([sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
                            cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy])


def first_in_each_slot(stamp: np.ndarray, interval: float) -> np.ndarray:
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
        at = first_in_each_slot(track.stamp, MAP_INTERVAL)
        points = np.round(_degrees(track, at)[:, ::-1], 8)
        lines.append({'type': 'Feature', 'properties': {'name': name},
                      'geometry': {'type': 'LineString', 'coordinates': points.tolist()}})
    path.write_text(json.dumps({'type': 'FeatureCollection', 'features': lines}), encoding='ascii')
