"""Reference trajectories from files: CSV, TUM, KF-GINS, NMEA 0183 and RTKLIB .pos."""
from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np

from mems_ins_fusion.filter.measurements.position import is_place
from mems_ins_fusion.navigation.earth import from_local
from mems_ins_fusion.navigation.frames import yaw_from_enu, yaw_of_quaternion
from mems_ins_fusion.recordings.csv_columns import GNSS_COLUMNS
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.gps_time import EPOCH, WEEK, leap_seconds
from mems_ins_fusion.recordings.nmea import epoch_seconds, read_nmea, time_of_day
from mems_ins_fusion.recordings.tables import LATEST, Table, read_table, read_text, unit_in_name
from mems_ins_fusion.samples import SECOND, Reference

#: columns of a navigation result of KF-GINS: s, deg, m, m/s north-east-down, deg
KF_GINS_NAVIGATION = ('week', 'seconds', 'latitude', 'longitude', 'height', 'vn', 've', 'vd', 'roll', 'pitch', 'yaw')
_LOCAL = {'east': ('east', 'e', 'x', 'positionx', 'px'), 'north': ('north', 'n', 'y', 'positiony', 'py'),
          'up': ('up', 'u', 'z', 'positionz', 'pz')}
_OPTIONAL = {'velocity north': ('vn', 'velocitynorth', 'velnorth', 'vnorth', 'northvelocity'),
             'velocity east': ('ve', 'velocityeast', 'veleast', 'veast', 'eastvelocity'),
             'velocity down': ('vd', 'velocitydown', 'veldown', 'vdown', 'downvelocity'),
             'velocity up': ('vu', 'velocityup', 'velup', 'vup', 'upvelocity'),
             'yaw': ('yaw', 'heading', 'azimuth')}


def read_reference(path, datum=None) -> Reference:
    """A reference trajectory from a file, in the order of its stamps (UTC since the epoch).

    - CSV: columns as for import_csv (time, latitude, longitude, height; degrees unless the name says rad), or east,
      north, up at `datum`; if there vn, ve, vd or vu (m/s), and yaw or heading (clockwise from north, as the angles).
    - TUM: time x y z qx qy qz qw, east-north-up at `datum` (forward-left-up axes), with yaw.
    - KF-GINS (i2Nav): week, seconds, latitude, longitude (deg), height, velocity north-east-down, roll, pitch, yaw
      (deg), without names; stamps are the seconds of the week alone, as in the files beside it.
    - NMEA: GGA with the date of RMC or ZDA; without GGA the positions of RMC, height 0. Heights above the ellipsoid.
    - RTKLIB .pos: latitude, longitude, height; velocity if there; GPS time is turned into UTC.

    datum: latitude, longitude (rad), height (m) of the local frame's origin, needed by local coordinates only.
    Raises RecordingError with one line for the user.
    """
    path = Path(path)
    first = _first_line(path)
    if first.startswith('$'):
        fixes = read_nmea(path)
        reference = Reference(fixes.stamp, fixes.latitude, fixes.longitude, np.nan_to_num(fixes.height))
    elif first.startswith('%') or path.suffix == '.pos':
        reference = _read_rtklib(path)
    elif path.suffix == '.tum' or _numbers_in(first) == 8:
        reference = _read_tum(path, datum)
    elif _numbers_in(first) == len(KF_GINS_NAVIGATION):
        reference = _read_kf_gins(path)
    else:
        reference = _read_csv(path, datum)
    reference = reference.select(is_place(reference.latitude, reference.longitude, reference.height))
    if not len(reference):
        raise RecordingError(f'{path} holds no valid position')
    return reference.select(np.argsort(reference.stamp, kind='stable'))


def _first_line(path: Path) -> str:
    """The first line that tells the format: not empty, and no comment of a TUM file."""
    lines = [line.strip() for line in read_text(path, 'utf-8', 'replace').splitlines()[:50]]
    lines = [line for line in lines if line]
    if not lines:
        raise RecordingError(f'{path} is empty')
    return next((line for line in lines if not line.startswith('#')), lines[0])


def _numbers_in(line: str) -> int:
    """How many numbers, separated by blanks, the line is made of; 0 where it is made of something else."""
    try:
        return len([float(cell) for cell in line.split()])
    except ValueError:
        return 0


def _geodetic(east, north, up, datum, path):
    if datum is None:
        raise RecordingError(f'{path} holds local coordinates: give the datum (latitude, longitude and height of their '
                             'origin)')
    return from_local(north, east, -up, tuple(float(value) for value in datum))


def _read_tum(path, datum) -> Reference:
    table = read_table(path)
    if len(table.names) != 8:
        raise RecordingError(f'{path} is not a TUM trajectory: {len(table.names)} columns instead of 8')
    # the names in a comment, if there are any, are not binding
    columns = Table(path, [str(i) for i in range(8)], table.columns, table.lines)
    stamp, _ = columns.times('0', 's')
    east, north, up, x, y, z, w = (columns.numbers(str(i)) for i in range(1, 8))
    latitude, longitude, height = _geodetic(east, north, up, datum, path)
    size = np.sqrt(x**2 + y**2 + z**2 + w**2)
    if not (size > 0).all():
        return Reference(stamp, latitude, longitude, height)
    return Reference(stamp, latitude, longitude, height, None,
                     yaw_from_enu(yaw_of_quaternion(x / size, y / size, z / size, w / size)))


def _read_kf_gins(path) -> Reference:
    """A navigation result of KF-GINS, as the truth of the data sets of the i2Nav group is: eleven columns."""
    table = read_table(path)
    columns = Table(path, list(KF_GINS_NAVIGATION), table.columns, table.lines)
    # the IMU and GNSS files beside it count the seconds of the week alone
    stamp, _ = columns.times('seconds', 's')
    latitude, longitude, height, yaw = (columns.numbers(n) for n in ('latitude', 'longitude', 'height', 'yaw'))
    velocity = np.column_stack([columns.numbers(name) for name in ('vn', 've', 'vd')])
    return Reference(stamp, np.radians(latitude), np.radians(longitude), height, velocity, np.radians(yaw))


def _read_csv(path, datum) -> Reference:
    table = read_table(path)
    stamp, _ = table.times(table.require('time', GNSS_COLUMNS['time']))
    names = {wanted: table.find(GNSS_COLUMNS[wanted]) for wanted in ('latitude', 'longitude', 'height')}
    angle = np.pi / 180
    if names['latitude'] and names['longitude']:
        angle = 1.0 if unit_in_name(names['latitude'], ('rad', 'radians')) else angle
        latitude, longitude = table.numbers(names['latitude']) * angle, table.numbers(names['longitude']) * angle
        height = table.numbers(names['height']) if names['height'] else np.zeros(len(stamp))
    else:
        local = {wanted: table.find(aliases) for wanted, aliases in _LOCAL.items()}
        if not local['east'] or not local['north']:
            raise RecordingError(f'{path} has no columns that look like latitude and longitude, or east and north; '
                                 f'{table.listing()}')
        up = table.numbers(local['up']) if local['up'] else np.zeros(len(stamp))
        latitude, longitude, height = _geodetic(table.numbers(local['east']), table.numbers(local['north']), up, datum,
                                                path)
    yaw = table.find(_OPTIONAL['yaw'])
    if yaw:
        yaw = table.numbers(yaw) * (1.0 if unit_in_name(yaw, ('rad', 'radians')) else np.pi / 180)
    return Reference(stamp, latitude, longitude, height, _velocity(table), yaw)


def _velocity(table: Table):
    """(n, 3) north, east, down, or None where the table has no horizontal velocity."""
    north, east, down, up = (table.find(_OPTIONAL[name]) for name in (
        'velocity north', 'velocity east', 'velocity down', 'velocity up'))
    if not north or not east:
        return None
    vertical = table.numbers(down) if down else -table.numbers(up) if up else np.zeros(len(table.lines))
    return np.column_stack([table.numbers(north), table.numbers(east), vertical])


def _read_rtklib(path) -> Reference:
    """Solution file of RTKLIB: the manual, appendix B."""
    lines = read_text(path, 'utf-8', 'replace').splitlines()
    header = next((line for line in lines if line.startswith('%') and 'latitude' in line.lower()), None)
    if header is None:
        raise RecordingError(f'{path} has no RTKLIB header with latitude(deg), longitude(deg) and height(m); write the '
                             'solution as lat/lon/height in degrees')
    names = header.lstrip('% ').split()
    rows = [(i, line.split()) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith('%')]
    # the time is one column in the header and two in the rows: date and time, or week and seconds
    names = [names[0], 'time of day', *names[1:]]
    for line, row in rows:
        if len(row) != len(names):
            raise RecordingError(f'{path}, line {line}: {len(row)} cells instead of {len(names)}')
    if not rows:
        raise RecordingError(f'{path} holds no positions')
    table = Table(path, names, list(zip(*(row for _, row in rows))), [line for line, _ in rows])
    stamp = np.array([_rtklib_stamp(path, line, row) for line, row in rows], np.int64)
    if names[0].upper() != 'UTC':
        stamp -= leap_seconds(int(stamp[0])) * SECOND
    latitude, longitude, height = (table.numbers(table.require(wanted, (wanted,)))
                                   for wanted in ('latitude', 'longitude', 'height'))
    return Reference(stamp, np.radians(latitude), np.radians(longitude), height, _velocity(table))


def _rtklib_stamp(path, line, row) -> int:
    """ns since the epoch, without leap seconds, of `2024/05/01 12:00:00.000` or `2312 302400.000`."""
    try:
        if '/' in row[0]:
            day = datetime.strptime(row[0], '%Y/%m/%d')
            stamp = epoch_seconds(day) * SECOND + time_of_day(row[1].replace(':', ''))
        else:
            stamp = (EPOCH + int(row[0]) * WEEK) * SECOND + round(float(row[1]) * 1e6) * 1000
        if not EPOCH * SECOND <= stamp < LATEST:
            raise ValueError
        return stamp
    except (ValueError, OverflowError):
        raise RecordingError(f"{path}, line {line}: '{row[0]} {row[1]}' is not a time") from None
