"""Import of IMU and GNSS logs in CSV: samples in the axes and units of the ROS messages."""
from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from mems_ins_fusion.filter.measurements.position import without_altitude
from mems_ins_fusion.recordings.aiding import FIELDS, PRESSURES, SPEED_UNITS, magnetic_factor, pressure_factor
from mems_ins_fusion.recordings.csv_columns import (
    ANGLE_UNITS,
    DATE,
    GNSS_COLUMNS,
    IMU_COLUMNS,
    LENGTH_UNITS,
    MAGNETOMETER_COLUMNS,
    PRESSURE_COLUMNS,
    SPEED_COLUMNS,
    Column,
    find,
    is_time_of_day,
    matching_column,
    summary,
    time_source,
    unit_of_time,
    values_of,
)
from mems_ins_fusion.recordings.csv_proposal import proposal
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.gps_time import utc_of_week
from mems_ins_fusion.recordings.nmea import read_nmea
from mems_ins_fusion.recordings.tables import TIME_UNITS, Table, read_table, read_text
from mems_ins_fusion.recordings.units import ACCELERATION, RATE
from mems_ins_fusion.samples import (
    Fixes,
    ImuSamples,
    MagneticFields,
    Pressures,
    Speeds,
    Temperatures,
    Twists,
    Velocities,
)

_LONGEST_IMU_INTERVAL = 0.2  # s
_LONGEST_INTERVAL = 20.0  # s, of all other sensors

#: forward-left-up directions
DIRECTIONS = {'forward': (1, 0, 0), 'back': (-1, 0, 0), 'left': (0, 1, 0), 'right': (0, -1, 0), 'up': (0, 0, 1),
              'down': (0, 0, -1)}


def axes_rotation(text: str) -> np.ndarray:
    """Rotation from sensor axes to forward-left-up, from three words for the directions of the sensor's x, y and z.

    The words are keys of DIRECTIONS. RecordingError unless they form a right-handed set of axes.
    """
    words = text.replace(',', ' ').lower().split()
    if len(words) != 3 or any(word not in DIRECTIONS for word in words):
        raise RecordingError(f"IMU axes must be three of {', '.join(DIRECTIONS)} (where x, y, z point); got '{text}'")
    rotation = np.array([DIRECTIONS[word] for word in words], float).T
    determinant = np.linalg.det(rotation)
    if abs(determinant) < 0.5:
        raise RecordingError(f"IMU axes '{text}': two of them lie on one line")
    if determinant < 0:
        opposite = {(-np.array(DIRECTIONS[word])).tobytes(): word for word in DIRECTIONS}
        other = opposite[np.array(DIRECTIONS[words[2]]).tobytes()]
        raise RecordingError(f"IMU axes '{text}' are left-handed; with these x and y axes z points {other}")
    return rotation


def read_imu(path, columns: dict[str, str] | None = None, axes: str = 'forward left up', time_unit=None,
             acceleration_unit=None, gyro_unit=None, *, increments: bool = False, rows: tuple[str, str] | None = None,
             gyro=None, gravity=None) -> tuple[ImuSamples, Temperatures | None, str]:
    """Samples in forward-left-up, temperatures if there is a column for them, and the columns that were used.

    columns: columns with unusual names, by the keys of IMU_COLUMNS; `NAME [unit]` gives a unit, `A|B` is the first that
    exists. Units that are None are those given there, else those in the names of the first columns, else m/s^2 and
    rad/s; that of the time is also found from its intervals. increments: the columns are increments of velocity and
    angle since the previous sample, instead of rates. rows: (column, value) of the rows to use. gyro: a separate file
    of the angular rates, which are interpolated to the times of the specific force. gravity: a separate file of the
    gravity that the specific force does not contain, interpolated in the same way. Raises RecordingError, which names
    all missing columns and suggests options.
    """
    rotation, columns = axes_rotation(axes), columns or {}
    table = _selected_rows(read_table(path), rows)
    sensors = _AXES['a'] if gyro else (*_AXES['a'], *_AXES['w'])
    # in a file with a single sensor, columns called x, y, z are its axes
    found = _require(table, sensors, IMU_COLUMNS, columns, {f'a{axis}': (axis,) for axis in 'xyz'} if gyro else {})
    stamp, time_unit = _times(table, columns, time_unit, _LONGEST_IMU_INTERVAL, found)
    acceleration_unit = acceleration_unit or found['ax'].unit_among(ACCELERATION)
    force = _vectors(table, found, 'a') * ACCELERATION[acceleration_unit]
    if gravity:
        other = _SensorFile(gravity, 'a', columns, time_unit, acceleration_unit)
        inside = other.covers(stamp, path)
        table, stamp, force = table.select(inside), stamp[inside], force[inside] + other.at(stamp[inside])
        found['gravity'] = Column(other.table.path.name)
    if gyro:
        other = _SensorFile(gyro, 'w', columns, time_unit, gyro_unit)
        inside = other.covers(stamp, path)
        table, stamp, force = table.select(inside), stamp[inside], force[inside]
        rate, gyro_unit = other.at(stamp), other.unit
        found |= {name: Column(f'{other.table.path.name}: {other.found[name].name}') for name in _AXES['w']}
    else:
        gyro_unit = gyro_unit or found['wx'].unit_among(RATE)
        rate = _vectors(table, found, 'w') * RATE[gyro_unit]
    if increments:
        if len(stamp) < 2:
            raise RecordingError(f'{path}: increments of a single sample are no rates')
        step = np.diff(stamp, prepend=2 * stamp[0] - stamp[1])[:, None] * 1e-9
        force, rate = (np.where(step > 0, v / np.where(step > 0, step, 1.0), np.nan) for v in (force, rate))
    received = np.maximum.accumulate(stamp)
    imu = ImuSamples(stamp, received, force @ rotation.T, rate @ rotation.T)
    celsius = find(table, 'temperature', IMU_COLUMNS, columns)
    temperature = Temperatures(stamp, received, table.numbers(celsius.name)) if celsius else None
    units = (time_unit, acceleration_unit, gyro_unit, *(['increments'] if increments else []))
    return imu, temperature, summary(table, found, len(stamp), units)


#: keys of the columns of the three axes of a sensor: accelerometer (a), gyroscope (w), magnetometer (m)
_AXES = {sensor: tuple(f'{sensor}{axis}' for axis in 'xyz') for sensor in 'awm'}


def _vectors(table: Table, found: dict[str, Column], sensor: str) -> np.ndarray:
    """(n, 3) of the three axes of `sensor`, a key of _AXES."""
    return values_of(table, [found[axis].name for axis in _AXES[sensor]])


class _SensorFile:
    """One sensor with three axes in a separate file, interpolated to the times of another one. sensor: a or w."""

    def __init__(self, path, sensor: str, columns, time_unit, unit):
        self.table = read_table(path)
        units = ACCELERATION if sensor == 'a' else RATE
        self.found = _require(self.table, _AXES[sensor], IMU_COLUMNS, columns,
                              {f'{sensor}{axis}': (axis,) for axis in 'xyz'})
        stamp, _ = _times(self.table, columns, time_unit if time_unit != 'date' else None, _LONGEST_IMU_INTERVAL,
                          self.found)
        self.unit = unit or self.found[f'{sensor}x'].unit_among(units)
        order = np.argsort(stamp, kind='stable')
        self.stamp = stamp[order]
        self.values = _vectors(self.table, self.found, sensor)[order] * units[self.unit]

    def covers(self, stamp: np.ndarray, path) -> np.ndarray:
        """(n,) which of the times are inside the file; RecordingError with the name `path` of the other file if none
        is."""
        inside = (stamp >= self.stamp[0]) & (stamp <= self.stamp[-1])
        if not inside.any():
            raise RecordingError(f'{path} and {self.table.path} do not overlap in time')
        return inside

    def at(self, stamp: np.ndarray) -> np.ndarray:
        """(n, 3) linear interpolation."""
        return np.column_stack([np.interp(stamp - self.stamp[0], self.stamp - self.stamp[0], v) for v in self.values.T])


def read_gnss(path, columns: dict[str, str] | None = None, time_unit=None, angle_unit=None,
              sigma: float = 2.5, *, rows: tuple[str, str] | None = None, of_imu: bool = False) -> tuple[Fixes, str]:
    """Fixes, and the columns that were used.

    path: CSV, or NMEA. columns, units, rows: as for `read_imu`, with the keys of GNSS_COLUMNS; angles without a unit
    are in degrees, or in 1e-7 deg if they are beyond 360. sigma: horizontal standard deviation, m, if the file has no
    column for it; multiplied by HDOP if there is a column for this. Without a column the vertical one is twice that.
    Rows without a height become fixes without altitude (`without_altitude`); rows with an empty or impossible position,
    or a status without a fix, messages without a fix. of_imu: the file has a row for each sample of the IMU: only rows
    with another position than the row before are fixes. Raises RecordingError.
    """
    if not 0 < sigma < np.inf:
        raise RecordingError(f'the sigma of fixes must be above 0, got {sigma:g}')
    if read_text(path, 'utf-8', 'replace').lstrip()[:1] == '$':
        return _nmea_fixes(path, sigma)
    table, columns = _selected_rows(read_table(path), rows), columns or {}
    found = _require(table, ('latitude', 'longitude'), GNSS_COLUMNS, columns)
    table, stamp, time_unit = _received(table, columns, time_unit, of_imu, found)
    found |= {wanted: column for wanted in ('height', 'sigma', 'vertical_sigma', 'hdop', 'status')
              if (column := find(table, wanted, GNSS_COLUMNS, columns))}
    latitude, longitude = (table.numbers(found[name].name) for name in ('latitude', 'longitude'))
    largest = np.nanmax(np.abs(latitude), initial=0.0)
    guess = '1e-7 deg' if 360.0 < largest < 1e10 and (latitude == np.round(latitude))[np.isfinite(latitude)].all() \
        else None
    guess = None if found['latitude'].stated else guess
    angle_unit = angle_unit or guess or found['latitude'].unit_among(ANGLE_UNITS)
    latitude, longitude = latitude * ANGLE_UNITS[angle_unit], longitude * ANGLE_UNITS[angle_unit]
    if np.nanmax(np.abs(latitude), initial=0.0) > np.pi / 2 or np.nanmax(np.abs(longitude), initial=0.0) > 2 * np.pi:
        raise RecordingError(f"{path}: latitudes and longitudes beyond 90 and 360 deg: are they in {angle_unit}?")

    def column(wanted, default='m'):
        """The column in metres, None if there is none. default: its unit if neither it nor the user gives one."""
        if wanted not in found:
            return None
        return table.numbers(found[wanted].name) * LENGTH_UNITS[found[wanted].unit_among(LENGTH_UNITS, default)]

    height = column('height', 'mm' if angle_unit == '1e-7 deg' else 'm')
    height = np.full(len(stamp), np.nan) if height is None else height.copy()
    horizontal, vertical = column('sigma'), column('vertical_sigma')
    hdop = table.numbers(found['hdop'].name) if 'hdop' in found else None
    covariance = _covariance(horizontal, vertical, hdop, sigma, len(stamp))
    without_altitude(height, covariance)
    status = _statuses(table, found['status'].name) if 'status' in found else np.zeros(len(stamp), np.int8)
    present = np.isfinite(latitude) & np.isfinite(longitude)
    kind = 2 if horizontal is not None and vertical is not None else 1  # diagonal known, or approximated
    fixes = Fixes(stamp, np.maximum.accumulate(stamp), latitude, longitude, height, covariance,
                  np.where(present, status, -1).astype(np.int8), np.full(len(stamp), kind, np.uint8))
    text = summary(table, found, len(stamp), (time_unit, angle_unit))
    return fixes, text if 'height' in found else f'{text}; no column of heights: fixes without altitude'


def _received(table: Table, columns: dict[str, str], time_unit, of_imu: bool, found: dict[str, Column]
              ) -> tuple[Table, np.ndarray, str]:
    """The rows of `table` that the receiver sent, their stamps and the unit of these; see `_times`. of_imu: those that
    have a position, and another one than the row before."""
    stamp, unit = _times(table, columns, time_unit, _LONGEST_IMU_INTERVAL if of_imu else _LONGEST_INTERVAL, found)
    if not of_imu:
        return table, stamp, unit
    place = [find(table, name, GNSS_COLUMNS, columns) for name in ('latitude', 'longitude', 'height')]
    rows = list(zip(*(table.columns[table.names.index(column.name)] for column in place if column)))
    new = np.array([row != before and all(map(str.strip, row)) for row, before in zip(rows, [None, *rows])])
    return table.select(new), stamp[new], unit


def _nmea_fixes(path, sigma: float) -> tuple[Fixes, str]:
    found = read_nmea(path)
    order = np.argsort(found.stamp, kind='stable')
    stamp, count = found.stamp[order], len(found.stamp)
    status = np.array([_QUALITY.get(q, 0) for q in found.quality[order]], np.int8)
    height, covariance = found.height[order], _covariance(None, None, found.hdop[order], sigma, count)
    without_altitude(height, covariance)
    fixes = Fixes(stamp, stamp.copy(), found.latitude[order], found.longitude[order], height, covariance, status,
                  np.full(count, 1, np.uint8))
    return fixes, f'{path}: {count} NMEA positions; sigma {sigma:g} m times HDOP'


def _covariance(horizontal, vertical, hdop, sigma: float, count: int) -> np.ndarray:
    """(n, 3, 3) m^2, east-north-up, from the columns of the file, (n,) each or None."""
    fallback = np.full(count, sigma)
    if hdop is not None:
        fallback = np.where(hdop > 0, sigma * np.where(hdop > 0, hdop, 1.0), sigma)
    flat = fallback if horizontal is None else np.where(horizontal > 0, horizontal, fallback)
    up = 2.0 * flat if vertical is None else np.where(vertical > 0, vertical, 2.0 * flat)
    covariance = np.zeros((count, 3, 3))
    covariance[:, 0, 0] = covariance[:, 1, 1] = flat**2
    covariance[:, 2, 2] = up**2
    return covariance


#: `NavSatStatus.status` for the quality of a GGA sentence, and for the fix type of u-blox, PX4 and ArduPilot
_QUALITY = {0: -1, 1: 0, 2: 1, 3: 0, 4: 2, 5: 2, 6: -1, 7: 0, 8: -1}
_FIX_TYPE = {0: -1, 1: -1, 2: 0, 3: 0, 4: 1, 5: 2, 6: 2}
_WORDS = {'': -1, 'a': 0, 'v': -1, 'none': -1, 'no fix': -1, 'nofix': -1, 'invalid': -1, '2d': 0, '3d': 0, 'gps': 0,
          'single': 0, 'dgps': 1, 'dgnss': 1, 'sbas': 1, 'float': 2, 'fixed': 2, 'rtk': 2, 'fix': 0}


def _statuses(table: Table, name: str) -> np.ndarray:
    """(n,) `NavSatStatus.status` of a column: words, NMEA's quality, fix types, or the status of ROS itself."""
    cells = [cell.strip().lower() for cell in table.columns[table.names.index(name)]]
    if any(cell in _WORDS and cell for cell in cells):
        return np.array([_WORDS.get(cell, max((_WORDS.get(word, 0) for word in cell.split()), default=0))
                         for cell in cells], np.int8)  # 3D fix, RTK float
    numbers = table.numbers(name)
    codes = np.where(np.isfinite(numbers), numbers, 0).astype(int)
    known = _QUALITY if 'qual' in name.lower() else _FIX_TYPE
    status = np.array([known.get(code, 0) for code in codes], np.int8)
    if (codes < 0).any() or (status < 0).all():  # ROS: -1 is no fix, 0 is one
        status = np.clip(codes, -1, 2).astype(np.int8)
    return status


def read_velocity(path, columns: dict[str, str] | None = None, time_unit=None, *,
                  rows: tuple[str, str] | None = None, of_imu: bool = False) -> tuple[Velocities, str] | None:
    """The receiver's velocities in the file of the fixes, and the columns that were used; None without such columns.

    columns, of_imu: as for `read_gnss`. In the unit in brackets, else m/s. Without a column `down` the vertical
    velocity is NaN; without one for the standard deviation the covariance is NaN. Raises RecordingError.
    """
    if read_text(path, 'utf-8', 'replace').lstrip()[:1] == '$':
        return None
    table, columns = _selected_rows(read_table(path), rows), columns or {}
    parts = ('north', 'east', 'down', 'velocity_sigma')
    found = {wanted: column for wanted in parts if (column := find(table, wanted, GNSS_COLUMNS, columns))}
    if 'north' not in found or 'east' not in found:
        return None
    table, stamp, time_unit = _received(table, columns, time_unit, of_imu, found)
    unit = found['north'].unit_among(SPEED_UNITS)
    north, east, down, sigma = (SPEED_UNITS[unit] * table.numbers(found[wanted].name) if wanted in found
                                else np.full(len(stamp), np.nan) for wanted in parts)
    covariance = np.square(sigma)[:, None, None] * np.eye(3)
    return (Velocities(stamp, np.maximum.accumulate(stamp), np.column_stack([north, east, down]), covariance),
            summary(table, found, len(stamp), (time_unit, unit)))


def read_speed(path, columns: dict[str, str] | None = None, time_unit=None) -> tuple[Speeds | Twists, str]:
    """Speeds of the rear axle, forward positive, and the columns that were used. With a turn rate, left positive, the
    result is an odometry.

    columns: columns with unusual names, by the keys of SPEED_COLUMNS. In the units in brackets, else m/s and rad/s;
    without a column `sigma` the variance is NaN. Raises RecordingError.
    """
    table, columns = read_table(path), columns or {}
    found = _require(table, ('speed',), SPEED_COLUMNS, columns)
    stamp, time_unit = _times(table, columns, time_unit, _LONGEST_INTERVAL, found)
    found |= {wanted: column for wanted in ('sigma', 'turn_rate')
              if (column := find(table, wanted, SPEED_COLUMNS, columns))}
    unit = found['speed'].unit_among(SPEED_UNITS)
    speed, received = SPEED_UNITS[unit] * table.numbers(found['speed'].name), np.maximum.accumulate(stamp)
    variance = unknown = np.full(len(stamp), np.nan)
    if 'sigma' in found:
        sigma = found['sigma']
        variance = np.square(SPEED_UNITS[sigma.unit_among(SPEED_UNITS, unit)] * table.numbers(sigma.name))
    samples: Speeds | Twists = Speeds(stamp, received, speed, variance)
    if 'turn_rate' in found:
        turn = RATE[found['turn_rate'].unit_among(RATE)] * table.numbers(found['turn_rate'].name)
        samples = Twists(stamp, received, np.column_stack([speed, np.zeros(len(stamp)), -turn]),
                         np.column_stack([variance, unknown, unknown]))
    return samples, summary(table, found, len(stamp), (time_unit, unit))


def read_pressure(path, columns: dict[str, str] | None = None, time_unit=None) -> tuple[Pressures, str]:
    """Air pressures, Pa, and the columns that were used.

    columns: columns with unusual names, by the keys of PRESSURE_COLUMNS. The unit is that in brackets, else the one in
    which the values are possible air pressures. Raises RecordingError.
    """
    table, columns = read_table(path), columns or {}
    found = _require(table, ('pressure',), PRESSURE_COLUMNS, columns)
    stamp, time_unit = _times(table, columns, time_unit, _LONGEST_INTERVAL, found)
    pressure = table.numbers(found['pressure'].name)
    samples = Pressures(stamp, np.maximum.accumulate(stamp), pressure, np.full(len(stamp), np.nan))
    unit = found['pressure'].unit_among(PRESSURES, _unit_of_factor(PRESSURES, pressure_factor(samples)))
    if not unit:
        raise RecordingError(f"{path}: column '{found['pressure'].name}' is not an air pressure in any of "
                             f"{', '.join(PRESSURES)}")
    return (replace(samples, pressure=PRESSURES[unit] * pressure),
            summary(table, found, len(stamp), (time_unit, unit)))


def _unit_of_factor(units: dict[str, float], factor: float | None) -> str:
    """The unit of `units` with this factor to SI, '' if there is none."""
    return next((unit for unit, per in units.items() if per == factor), '')


def read_magnetometer(path, columns: dict[str, str] | None = None, axes: str = 'forward left up', time_unit=None
                      ) -> tuple[MagneticFields, str]:
    """Magnetic fields in forward-left-up, T, and the columns that were used.

    columns: columns with unusual names, by the keys of MAGNETOMETER_COLUMNS. axes: as for `read_imu`. The unit is that
    in brackets, else the one in which the values are possible fields of the earth. Raises RecordingError.
    """
    rotation, table, columns = axes_rotation(axes), read_table(path), columns or {}
    found = _require(table, _AXES['m'], MAGNETOMETER_COLUMNS, columns, {f'm{axis}': (axis,) for axis in 'xyz'})
    stamp, time_unit = _times(table, columns, time_unit, _LONGEST_INTERVAL, found)
    field = _vectors(table, found, 'm') @ rotation.T
    samples = MagneticFields(stamp, np.maximum.accumulate(stamp), field, np.full(len(stamp), np.nan))
    unit = found['mx'].unit_among(FIELDS, _unit_of_factor(FIELDS, magnetic_factor(samples)))
    if not unit:
        raise RecordingError(f"{path}: columns '{found['mx'].name}' .. are not the earth's magnetic field in any of "
                             f"{', '.join(FIELDS)}")
    return replace(samples, field=FIELDS[unit] * field), summary(table, found, len(stamp), (time_unit, unit))


def _selected_rows(table: Table, rows: tuple[str, str] | None) -> Table:
    """The rows of `table` with a given value in a column, by (column, value); all if it has no such column."""
    if rows is None or rows[0] not in table.names:
        return table
    cells = table.columns[table.names.index(rows[0])]
    kept = np.array([cell.strip() == rows[1] for cell in cells])
    if not kept.any():
        raise RecordingError(f"{table.path} has no row with {rows[1]} in column '{rows[0]}'")
    return table.select(kept)


def _require(table: Table, wanted, known: dict, columns: dict[str, str], alone: dict | None = None
             ) -> dict[str, Column]:
    """The column for each of `wanted`; RecordingError with all missing ones and suggestions.

    alone: further names that are usual in this file.
    """
    known = {name: (*aliases, *(alone or {}).get(name, ())) for name, aliases in known.items()}
    found = {name: matching_column(table, columns[name]) if name in columns else find(table, name, known, {})
             for name in wanted}
    missing = [name for name in wanted if found[name] is None]
    if missing:
        missing += ['time'] if time_source(table, columns) is None else []
        named = [f"{name} ('{columns[name]}' is not there)" if name in columns else name for name in missing]
        columns_look = 'columns that look' if len(missing) > 1 else 'column that looks'
        raise RecordingError(f'{table.path} has no {columns_look} like {", ".join(named)}; {table.listing()}'
                             f'{proposal(table, wanted, found, columns)}')
    return found


def _times(table: Table, columns: dict[str, str], unit, longest: float, found: dict[str, Column]):
    """Stamps (n,) ns, UTC, and their unit; adds the columns that they are from to `found`.

    unit: None if it is to be found. longest: s, between two rows. RecordingError without a time.
    """
    source = time_source(table, columns)
    if source is None:
        if 'time' in columns:
            raise RecordingError(f"{table.path} has no column '{columns['time']}' for time; {table.listing()}")
        raise RecordingError(f'{table.path} has no column that looks like time; {table.listing()}'
                             f'{proposal(table, tuple(found), found, columns)}')
    found['time'] = Column(' '.join(source))
    name = source[-1]
    cells = [table.columns[table.names.index(column)] for column in source]
    if len(source) == len(DATE) or is_time_of_day(table, name):
        dates = tuple(_date(row) for row in zip(*cells)) if len(source) == len(DATE) else _dated(*cells)
        stamp, _ = Table(table.path, ['date'], [dates], table.lines).times('date')
        nano = table.find(('nano',)) if len(source) == len(DATE) else None
        return stamp + (0 if nano is None else table.numbers(nano).astype(np.int64)), 'date'
    time = matching_column(table, columns['time']) if 'time' in columns else Column(name)
    stamp, unit = table.times(name, time.unit_among(TIME_UNITS) if time.stated else unit or unit_of_time(name), longest)
    if len(source) == 2:
        return utc_of_week(table.numbers(source[0]), stamp), f'GPS weeks and {unit}'
    return stamp, unit


def _dated(*cells) -> tuple[str, ...]:
    """ISO 8601 of dates (2024-05-31, 2024/05/31 or 31.05.2024) and times of day, or of times of day alone: then from
    1970-01-01 on, with a day more after each midnight. An invalid one is found when the text is read."""
    *days, clocks = cells
    clocks = [f'0{clock}' if clock.find(':') == 1 else clock for clock in map(str.strip, clocks)]
    if days:
        days = [re.sub(r'^(\d\d?)\.(\d\d?)\.(\d{4})$', r'\3-\2-\1', day.strip()) for day in days[0]]
        days = ['-'.join(part.zfill(2) for part in re.split('[-/.]', day)) for day in days]
    else:
        midnights = np.cumsum(np.diff([int(f'0{clock[:2]}') if clock[:2].isdigit() else 0 for clock in clocks],
                                      prepend=0) < -12)
        days = [f'1970-01-{1 + passed:02d}' for passed in midnights]
    return tuple(f'{day}T{clock}' for day, clock in zip(days, clocks))


def _date(row) -> str:
    """ISO 8601 of year, month, day, hour, minute, second; an invalid date is found when the text is read."""
    try:
        year, month, day, hour, minute, second = (float(cell) for cell in row)
        return f'{year:04.0f}-{month:02.0f}-{day:02.0f}T{hour:02.0f}:{minute:02.0f}:{second:09.6f}'
    except ValueError:
        return ':'.join(row)
