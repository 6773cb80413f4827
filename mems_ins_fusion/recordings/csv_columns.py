"""Columns of a CSV log: their usual names and units, and the search for them in a table."""
from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.tables import Table, unit_in_name

#: whole numbers of 1e-7 deg are what u-blox, MAVLink and PX4 send, with heights in mm
ANGLE_UNITS = {'deg': np.pi / 180.0, 'rad': 1.0, '1e-7 deg': 1e-7 * np.pi / 180.0}
LENGTH_UNITS = {'m': 1.0, 'cm': 1e-2, 'mm': 1e-3}
#: how people write the units in the names of columns
SPELLINGS = {**dict.fromkeys(('m/s2', 'm s^-2', 'm/s²', 'm/s/s', 'mps2', 'm_s2'), 'm/s^2'),
             **dict.fromkeys(('rad s^-1', 'rad_s', 'radps'), 'rad/s'),
             **dict.fromkeys(('deg s^-1', 'deg_s', 'degps', 'dps', '°/s'), 'deg/s'),
             **dict.fromkeys(('m s^-1', 'm_s', 'mps'), 'm/s'), **dict.fromkeys(('kmh', 'kph', 'km h^-1'), 'km/h'),
             **dict.fromkeys(('kn', 'kt', 'kts', 'knot'), 'knots'),
             **dict.fromkeys(('mbar', 'millibar', 'hectopascal'), 'hPa'),
             **dict.fromkeys(('°', 'degree', 'degrees'), 'deg'), **dict.fromkeys(('radian', 'radians'), 'rad')}
_ACCELEROMETER = ('a', 'acc', 'accel', 'accelerometer', 'acceleration', 'linearacceleration', 'specificforce', 'f',
                  'accelerometers', 'arss')
_GYROSCOPE = ('w', 'g', 'gyr', 'gyro', 'gyroscope', 'omega', 'angularvelocity', 'angularrate', 'rate', 'wrss')
TIME = ('time', 'timeus', 'timems', 'timens', 't', 'timestamp', 'stamp', 'sec', 'seconds', 'unixtime', 'utc', 'epoch',
        'headerstamp', 'rostime', 'millis', 'milliseconds', 'micros', 'microseconds', 'utctime', 'gpstime', 'timeofday')
#: units of time that are the name itself, or stand at its end without a sign between: TimeUS, millis of Arduino, iTOW
_UNIT_OF_TIME = (('us', 'us|micros|microseconds'), ('ms', 'ms|millis|milliseconds'), ('ns', 'ns'))


def _axis_aliases(prefixes, axis):
    return tuple(f'{prefix}{axis}' for prefix in prefixes) + tuple(f'{axis}{prefix}' for prefix in prefixes)


#: time in two columns, a date and a time of day, or week and seconds (or ms, GMS) of GPS time; or in six, a date
_DAY = ('date', 'utcdate', 'gpsdate', 'datum')
_WEEK = ('week', 'gpsweek', 'gwk', 'wn')
_INTO_WEEK = ('tow', 'sow', 'seconds', 'secondsofweek', 'itow', 'gms', 'gpstow', 'gpssow', 'gpsseconds', 'gpssec')
DATE = (('year',), ('month',), ('day',), ('hour',), ('min', 'minute'), ('sec', 'second', 'seconds'))
#: usual names of columns, as `tables.plain_name` leaves them
IMU_COLUMNS = {'time': TIME,
               **{f'a{axis}': _axis_aliases(_ACCELEROMETER, axis) for axis in 'xyz'},
               **{f'w{axis}': _axis_aliases(_GYROSCOPE, axis) for axis in 'xyz'},
               'temperature': ('temperature', 'temp', 'imutemperature', 'imutemp')}
GNSS_COLUMNS = {'time': TIME, 'latitude': ('latitude', 'lat', 'latdeg', 'phi'),
                'longitude': ('longitude', 'lon', 'lng', 'long', 'londeg', 'lambda'),
                'height': ('ellipsoidalheight', 'altellipsoid', 'height', 'altitude', 'alt', 'h', 'hgt'),
                'sigma': ('sigma', 'hacc', 'horizontalaccuracy', 'eph', 'hrms', 'accuracy', 'std'),
                'vertical_sigma': ('verticalsigma', 'vacc', 'verticalaccuracy', 'epv', 'vrms'),
                'hdop': ('hdop',), 'status': ('status', 'fixtype', 'fixquality', 'quality', 'gpsstatus', 'fix'),
                **{wanted: (f'v{wanted[0]}', f'vel{wanted[0]}', f'{wanted[0]}vel', f'vel{wanted}', f'{wanted}vel',
                            f'velocity{wanted}', f'{wanted}velocity') for wanted in ('north', 'east', 'down')},
                'velocity_sigma': ('velocitysigma', 'sacc', 'speedaccuracy', 'velocityaccuracy')}
SPEED_COLUMNS = {'time': TIME, 'speed': ('speed', 'v', 'velocity', 'wheelspeed', 'vehiclespeed', 'odometerspeed'),
                 'turn_rate': ('turnrate', 'yawrate', 'angularvelocity', 'angularrate', 'omega', 'wz'),
                 'sigma': ('sigma', 'std', 'speedsigma', 'accuracy')}
PRESSURE_COLUMNS = {'time': TIME, 'pressure': ('pressure', 'airpressure', 'press', 'p', 'baro', 'barometer')}
_MAGNETOMETER = ('m', 'mag', 'magnetometer', 'magneticfield', 'field', 'b')
MAGNETOMETER_COLUMNS = {'time': TIME, **{f'm{axis}': _axis_aliases(_MAGNETOMETER, axis) for axis in 'xyz'}}


def parse_columns(text: str, known) -> dict[str, str]:
    """`time=t,ax=acc 1,...` as a dictionary. RecordingError for a name that is not in `known`."""
    given = {}
    for pair in filter(None, (part.strip() for part in text.split(','))):
        wanted, equals, name = (part.strip() for part in pair.partition('='))
        if not equals or not name or wanted not in known:
            raise RecordingError(f"columns are given as NAME=COLUMN with NAME one of {', '.join(known)}; got '{pair}'")
        given[wanted] = name
    return given


class Column(NamedTuple):
    """A column of a table. stated: the unit that the user stated with it, None where none was."""

    name: str
    stated: str | None = None

    def unit_among(self, units, default: str | None = None) -> str:
        """Its unit, one of `units`: as stated, else as in its name, else `default`, or the first of `units`.

        RecordingError for a stated unit that is not among them.
        """
        spelled = {**{unit.lower(): unit for unit in units},
                   **{text: unit for text, unit in SPELLINGS.items() if unit in units}}
        if self.stated is None:
            return spelled.get(unit_in_name(self.name, spelled), next(iter(units)) if default is None else default)
        if self.stated.lower() not in spelled:
            raise RecordingError(f"unit '{self.stated}' of column '{self.name}' is not one of {', '.join(units)}")
        return spelled[self.stated.lower()]


def find(table: Table, wanted: str, known: dict, columns: dict[str, str]) -> Column | None:
    """The column for `wanted`, or None: see `read_imu`.

    RecordingError where one is given that is not there, unless it ends in `|`.
    """
    given = columns.get(wanted)
    if given is None:
        name = table.find(known[wanted])
        return Column(name) if name else None
    found = matching_column(table, given)
    if found is None and not given.endswith('|'):
        raise RecordingError(f"{table.path} has no column '{given}' for {wanted}; {table.listing()}")
    return found


def matching_column(table: Table, given: str) -> Column | None:
    """The first of the columns `A|B [unit]` that `table` has; None where it has none."""
    for name in (given, *given.split('|')):
        if name in table.names:
            return Column(name)
        plain, unit = re.fullmatch(r'(.*?)\s*(?:\[([^][]*)\])?', name, re.DOTALL).groups()
        if plain in table.names:
            return Column(plain, unit)
    return None


def time_source(table: Table, columns: dict[str, str]) -> tuple[str, ...] | None:
    """The columns of time: one, a date and a time of day, week and seconds of GPS time, or six of a date; None where
    there are none."""
    if 'time' in columns:
        found = matching_column(table, columns['time'])
        return _with_day(table, found.name) if found else None
    date = tuple(table.find(aliases) for aliases in DATE)
    week, into = (table.find(aliases) for aliases in (_WEEK, _INTO_WEEK))
    name = table.find(TIME)
    return (date if all(date) else _with_day(table, name) if name else (week, into) if week and into else
            (into,) if into else None)


def _with_day(table: Table, name: str) -> tuple[str, ...]:
    """The column of time `name`, with that of the date before it if it holds times of day."""
    day = table.find(_DAY) if is_time_of_day(table, name) else None
    return (day, name) if day and day != name else (name,)


def is_time_of_day(table: Table, name: str) -> bool:
    """Whether the first cell of a column is a time of day without a date."""
    cells = table.columns[table.names.index(name)]
    return bool(re.fullmatch(r'\s*\d{1,2}:\d\d(:\d\d([.,]\d*)?)?\s*[Zz]?\s*', cells[0]))


def unit_of_time(name: str) -> str | None:
    """The unit of time that a column's name tells without a sign before it, None where it tells none."""
    if name.lower() in ('itow', 'gms'):
        return 'ms'
    return next((unit for unit, ends in _UNIT_OF_TIME if re.search(f'({ends})$', name, re.IGNORECASE)), None)


def values_of(table: Table, columns) -> np.ndarray:
    """(n, k) numbers of k columns, by their names."""
    return np.column_stack([table.numbers(name) for name in columns])


def summary(table: Table, found: dict[str, Column], count: int, units) -> str:
    """Which column is used for what, in words. found: columns by quantity."""
    columns = ', '.join(f'{wanted}={found[wanted].name}' for wanted in sorted(found, key=lambda name: name != 'time'))
    return f'{table.path}: {count} rows; {columns}; in {", ".join(units)}'
