"""IMU and GNSS logs in CSV to samples, in the axes and units of the ROS messages."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.tables import Table, read_table, unit_in_name
from mems_ins_fusion.samples import Fixes, ImuSamples, Temperatures

ACCELERATION_UNITS = {'m/s^2': 1.0, 'g': STANDARD_GRAVITY, 'mg': STANDARD_GRAVITY / 1000.0}
GYRO_UNITS = {'rad/s': 1.0, 'deg/s': np.pi / 180.0}
ANGLE_UNITS = {'deg': np.pi / 180.0, 'rad': 1.0}
#: how people write the units in the names of columns
_SPELLINGS = {**dict.fromkeys(('m/s2', 'm s^-2', 'm/s²', 'm/s/s', 'mps2', 'm_s2'), 'm/s^2'),
              **dict.fromkeys(('rad s^-1', 'rad_s', 'radps'), 'rad/s'),
              **dict.fromkeys(('deg s^-1', 'deg_s', 'degps', 'dps', '°/s'), 'deg/s'),
              **dict.fromkeys(('°', 'degree', 'degrees'), 'deg'), **dict.fromkeys(('radian', 'radians'), 'rad')}
_LONGEST_IMU_INTERVAL = 0.2  # s

#: forward-left-up directions
DIRECTIONS = {'forward': (1, 0, 0), 'back': (-1, 0, 0), 'left': (0, 1, 0), 'right': (0, -1, 0), 'up': (0, 0, 1),
              'down': (0, 0, -1)}
_ACCELEROMETER = ('a', 'acc', 'accel', 'accelerometer', 'acceleration', 'linearacceleration', 'specificforce', 'f',
                  'accelerometers', 'arss')
_GYROSCOPE = ('w', 'g', 'gyr', 'gyro', 'gyroscope', 'omega', 'angularvelocity', 'angularrate', 'rate', 'wrss')
TIME = ('time', 't', 'timestamp', 'stamp', 'sec', 'seconds', 'unixtime', 'utc', 'epoch', 'headerstamp', 'rostime')


def _axis_aliases(prefixes, axis):
    return tuple(f'{prefix}{axis}' for prefix in prefixes) + tuple(f'{axis}{prefix}' for prefix in prefixes)


#: usual names of columns, as `tables.plain` leaves them
IMU_COLUMNS = {'time': TIME,
               **{f'a{axis}': _axis_aliases(_ACCELEROMETER, axis) for axis in 'xyz'},
               **{f'w{axis}': _axis_aliases(_GYROSCOPE, axis) for axis in 'xyz'},
               'temperature': ('temperature', 'temp', 'imutemperature', 'imutemp')}
GNSS_COLUMNS = {'time': TIME, 'latitude': ('latitude', 'lat', 'latdeg', 'phi'),
                'longitude': ('longitude', 'lon', 'lng', 'long', 'londeg', 'lambda'),
                'height': ('height', 'altitude', 'alt', 'h', 'hgt', 'ellipsoidalheight'),
                'sigma': ('sigma', 'hacc', 'horizontalaccuracy', 'accuracy', 'std')}


def parse_columns(text: str, known) -> dict[str, str]:
    """`time=t,ax=acc 1,...` as a dictionary. RecordingError for a name that is not in `known`."""
    given = {}
    for pair in filter(None, (part.strip() for part in text.split(','))):
        wanted, equals, name = (part.strip() for part in pair.partition('='))
        if not equals or not name or wanted not in known:
            raise RecordingError(f"columns are given as NAME=COLUMN with NAME one of {', '.join(known)}; got '{pair}'")
        given[wanted] = name
    return given


def axes_rotation(text: str) -> np.ndarray:
    """Rotation from sensor axes to forward-left-up of three words that say where the sensor's x, y and z point.

    The words are keys of DIRECTIONS. RecordingError unless they make a right-handed set of axes.
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
             acceleration_unit=None, gyro_unit=None) -> tuple[ImuSamples, Temperatures | None, str]:
    """Samples turned to forward-left-up, temperatures where there is such a column, and what was taken for what.

    columns: those whose names are not usual, by the keys of IMU_COLUMNS. Units that are None are taken from brackets in
    the columns' names, else m/s^2 and rad/s; time's also from its intervals. Raises RecordingError.
    """
    rotation = axes_rotation(axes)
    table, columns = read_table(path), columns or {}
    names = {wanted: table.require(wanted, IMU_COLUMNS[wanted], columns)
             for wanted in ('time', 'ax', 'ay', 'az', 'wx', 'wy', 'wz')}
    stamp, time_unit = table.times(names['time'], time_unit, _LONGEST_IMU_INTERVAL)
    acceleration_unit = acceleration_unit or _unit(names['ax'], ACCELERATION_UNITS)
    gyro_unit = gyro_unit or _unit(names['wx'], GYRO_UNITS)
    force, rate = (np.column_stack([table.numbers(names[f'{sensor}{axis}']) for axis in 'xyz']) for sensor in 'aw')
    force, rate = force * ACCELERATION_UNITS[acceleration_unit], rate * GYRO_UNITS[gyro_unit]
    received = np.maximum.accumulate(stamp)
    imu = ImuSamples(stamp, received, force @ rotation.T, rate @ rotation.T)
    warm = table.find('temperature', IMU_COLUMNS['temperature'], columns)
    temperature = Temperatures(stamp, received, table.numbers(warm)) if warm else None
    return imu, temperature, _summary(table, names, len(stamp), (time_unit, acceleration_unit, gyro_unit))


def read_gnss(path, columns: dict[str, str] | None = None, time_unit=None, angle_unit=None,
              sigma: float = 2.5) -> tuple[Fixes, str]:
    """Fixes, and what was taken for what.

    columns, units: as for `read_imu`, with the keys of GNSS_COLUMNS; angles are in degrees without a unit.
    sigma: horizontal standard deviation, m, where the file has no column for it; the vertical is twice that. Without a
    height it is zero. Rows with an empty or impossible position become messages without a fix. Raises RecordingError.
    """
    if not 0 < sigma < np.inf:
        raise RecordingError(f'the sigma of fixes must be above 0, got {sigma:g}')
    table, columns = read_table(path), columns or {}
    names = {wanted: table.require(wanted, GNSS_COLUMNS[wanted], columns)
             for wanted in ('time', 'latitude', 'longitude')}
    for wanted in ('height', 'sigma'):
        found = table.find(wanted, GNSS_COLUMNS[wanted], columns)
        if found:
            names[wanted] = found
    stamp, time_unit = table.times(names['time'], time_unit)
    angle_unit = angle_unit or _unit(names['latitude'], ANGLE_UNITS)
    latitude, longitude = (table.numbers(names[name]) * ANGLE_UNITS[angle_unit] for name in ('latitude', 'longitude'))
    height = table.numbers(names['height']) if 'height' in names else np.zeros(len(stamp))
    if np.nanmax(np.abs(latitude), initial=0.0) > np.pi / 2 or np.nanmax(np.abs(longitude), initial=0.0) > 2 * np.pi:
        raise RecordingError(f"{path}: latitudes and longitudes beyond 90 and 360 deg: are they in {angle_unit}?")
    stated = table.numbers(names['sigma']) if 'sigma' in names else np.full(len(stamp), sigma)
    variance = np.where(stated > 0, stated, sigma) ** 2
    covariance = variance[:, None, None] * np.diag([1.0, 1.0, 4.0])
    present = np.isfinite(latitude) & np.isfinite(longitude) & np.isfinite(height)
    fixes = Fixes(stamp, np.maximum.accumulate(stamp), latitude, longitude, height, covariance,
                  np.where(present, 0, -1).astype(np.int8), np.full(len(stamp), 1, np.uint8))  # 1: approximated
    return fixes, _summary(table, names, len(stamp), (time_unit, angle_unit))


def _unit(name, units) -> str:
    """The unit in a column's name, or the first of `units`."""
    spelled = unit_in_name(name, {*units, *_SPELLINGS})
    unit = _SPELLINGS.get(spelled, spelled)
    return unit if unit in units else next(iter(units))


def _summary(table: Table, names, count, units) -> str:
    columns = ', '.join(f'{wanted}={name}' for wanted, name in names.items())
    return f'{table.path}: {count} rows; {columns}; in {", ".join(units)}'
