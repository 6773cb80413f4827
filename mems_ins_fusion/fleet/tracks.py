"""Trajectories of other filters (Odometry in a bag, TUM text, text of KF-GINS, CSV), measured like runs of this
package."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..navigation.earth import from_local, to_local
from ..navigation.frames import yaw_from_enu, yaw_of_quaternion
from ..recordings import messages
from ..recordings.bags import Bag
from ..recordings.gps_time import EPOCH, WEEK, leap_seconds, utc_of_week
from ..recordings.reference_files import KF_GINS_NAVIGATION, read_reference
from ..recordings.tables import read_text
from ..samples import SECOND

#: number of columns in a file of standard deviations by KF-GINS: seconds, north, east, down, ...
#: Source: writeSTD of its src/kf_gins.cpp
_KF_GINS_STD_COLUMNS = 22
#: end of the name of this file, beside the navigation result
_STD = '.std'


class TrackError(InputError):
    """A trajectory that cannot be read; the text is one line with the reason."""


@dataclass(frozen=True)
class FilterTrack:
    """Trajectory of a filter, (n,) each, with the names of `filter.runs.results.Run`, so that the same code measures
    it.

    stamp: ns. latitude, longitude: rad. height: m. roll, pitch, yaw: rad. velocity: (n, 2) m/s north, east. sigma: (n,
    2) m north, east, NaN if the filter gives none; covariance_ne: m^2. behind: zeros, as other filters do not model a
    receiver that smooths.
    """

    stamp: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    roll: np.ndarray
    pitch: np.ndarray
    yaw: np.ndarray
    velocity: np.ndarray
    sigma: np.ndarray
    covariance_ne: np.ndarray

    @property
    def behind(self) -> np.ndarray:
        return np.zeros((len(self.stamp), 2))


def read_track(path, datum, topic: str = '', week: int = 0) -> FilterTrack:
    """The track in `path`: a bag with nav_msgs/Odometry, TUM text, a navigation result of KF-GINS (with its standard
    deviations in the file beside it that ends in .std, if there is one), or CSV as read by
    `recordings.reference_files`. datum: rad, rad, m, of local coordinates. topic: of the odometry; '' if there is only
    one. week: GPS week if the file contains 0. Raises TrackError, RecordingError."""
    path = Path(path)
    if path.is_dir() or path.suffix in ('.mcap', '.db3', '.bag'):
        return _read_bag(path, datum, topic)
    rows = _numbers(path)
    if rows is not None and rows.shape[1] == len(KF_GINS_NAVIGATION):
        return _kf_gins(rows, _numbers(path.with_suffix(_STD)) if path.with_suffix(_STD).is_file() else None, week)
    reference = read_reference(path, datum)
    missing, still = np.full(len(reference), np.nan), np.zeros(len(reference))
    velocity = _differences(reference) if reference.velocity is None else reference.velocity[:, :2]
    yaw = np.arctan2(*velocity.T[::-1]) if reference.yaw is None else reference.yaw
    return _in_order(FilterTrack(reference.stamp, reference.latitude, reference.longitude, reference.height, still,
                                 still,
                                 yaw, velocity, np.column_stack([missing, missing]), missing))


def _numbers(path: Path) -> np.ndarray | None:
    """The rows of a file that contains only numbers, the same count in each; None for other files."""
    try:
        rows = [line.split() for line in read_text(path, 'utf-8', 'replace').splitlines()
                if line.strip() and not line.startswith(('#', '%'))]
        return np.array(rows, dtype=float) if rows and len({len(row) for row in rows}) == 1 else None
    except ValueError:
        return None


def _kf_gins(rows: np.ndarray, deviations: np.ndarray | None, week: int) -> FilterTrack:
    # KF-GINS writes 0 for the week
    weeks, second, latitude, longitude, height, v_n, v_e, _, roll, pitch, yaw = rows.T
    weeks = np.where(weeks > 0, weeks, week).astype(np.int64)
    stamp = utc_of_week(weeks, np.rint(second * 1e9).astype(np.int64))
    sigma = np.full((len(rows), 2), np.nan)
    if deviations is not None and deviations.shape[1] == _KF_GINS_STD_COLUMNS:
        sigma = np.column_stack([np.interp(second, deviations[:, 0], deviations[:, i]) for i in (1, 2)])
    angles = np.radians([latitude, longitude, roll, pitch, yaw])
    # the file has no covariance of north and east
    return _in_order(FilterTrack(stamp, angles[0], angles[1], height, *angles[2:], np.column_stack([v_n, v_e]), sigma,
                                 np.where(np.isfinite(sigma[:, 0]), 0.0, np.nan)))


def _read_bag(path: Path, datum, topic: str) -> FilterTrack:
    with Bag(path) as bag:
        topics = [name for name, kind in sorted(bag.topics.items()) if kind == messages.ODOMETRY]
        if not topics or (topic and topic not in topics):
            raise TrackError(f'{path} has no nav_msgs/Odometry' + (f" on '{topic}'" if topic else ''))
        if not topic and len(topics) > 1:
            raise TrackError(f'{path} has several nav_msgs/Odometry: name one with --odometry-topic; '
                             f'{", ".join(topics)}')
        blocks = []
        for _, _, raw, _ in bag.read([topic or topics[0]]):
            if raw:
                blocks.append(messages.decode(raw, messages.ODOMETRY)[0])
    if not blocks:
        raise TrackError(f"{path} holds no messages on '{topic or topics[0]}'")
    array = np.concatenate(blocks)
    east, north, up = array['pose.pose.position'].T
    orientation = array['pose.pose.orientation']
    latitude, longitude, height = from_local(north, east, -up, tuple(float(v) for v in datum))
    yaw = yaw_from_enu(yaw_of_quaternion(*orientation.T))
    covariance = array['pose.covariance'].reshape(-1, 6, 6)
    known = (covariance[:, 0, 0] > 0) & (covariance[:, 1, 1] > 0)
    variance = np.where(known[:, None], covariance[:, [1, 0], [1, 0]], np.nan)
    speed = array['twist.twist.linear'][:, 0]
    return _in_order(FilterTrack(messages.stamps(array), latitude, longitude, height, *_roll_pitch(orientation), yaw,
                                 np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw)]), np.sqrt(variance),
                                 np.where(known, covariance[:, 0, 1], np.nan)))


def _roll_pitch(orientation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch of the body (forward-right-down), rad, from quaternions (n, 4) of forward-left-up to
    east-north-up."""
    x, y, z, w = orientation.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return roll, -np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))


def _differences(reference) -> np.ndarray:
    """Velocity north and east, (n, 2) m/s, by differences of positions."""
    datum = reference.latitude[0], reference.longitude[0], reference.height[0]
    north, east, _ = to_local(reference.latitude, reference.longitude, reference.height, datum)
    time = (reference.stamp - reference.stamp[0]) * 1e-9
    if len(time) < 2:
        return np.zeros((len(time), 2))
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.nan_to_num(np.column_stack([np.gradient(north, time), np.gradient(east, time)]))


def _in_order(track: FilterTrack) -> FilterTrack:
    """Sorted by time, without duplicate times."""
    _, index = np.unique(track.stamp, return_index=True)
    return FilterTrack(**{name: array[index] for name, array in vars(track).items()})


def gps_week(stamp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """GPS week and seconds of it, of stamps (n,) ns since the epoch (UTC)."""
    whole = stamp + (leap_seconds(int(stamp[0])) - EPOCH) * SECOND
    return whole // (WEEK * SECOND), (whole % (WEEK * SECOND)) * 1e-9
