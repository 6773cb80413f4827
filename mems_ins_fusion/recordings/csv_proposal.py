"""The options of `import_csv` that would fit a table whose columns have no usual names, by what they hold."""
from __future__ import annotations

import re

import numpy as np

from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.recordings.csv_columns import IMU_COLUMNS, SPELLINGS, time_source, values_of
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.tables import Table, unit_in_name
from mems_ins_fusion.recordings.units import ACCELERATION, FASTEST_TURN, RATE

#: largest logarithm of the ratio of the size of three columns to gravity, to be proposed as accelerometers
_NEAR_GRAVITY = 0.15
#: deg, largest range of two columns to be proposed as latitude and longitude: a drive stays within it
_NEIGHBOURHOOD = 3.0
#: largest median size of three columns to be proposed as gyroscopes: in deg/s no vehicle turns faster for long
_FASTEST_DEG = 100.0


def proposal(table: Table, wanted, found, given: dict[str, str]) -> str:
    """The whole line of options that would fit by what the columns hold: time ascends, gravity is in three of them."""
    columns = {name: column.name for name, column in found.items() if column}
    time = time_source(table, given) or (_ascending(table),)
    if len(time) == 1:
        columns['time'] = time[0]
    if 'ax' in wanted and _holds_increments(table):
        return '; as it seems: --preset kf-gins'
    kind = next((kind for kind in ('pressure', 'speed') if kind in wanted), 'gnss')
    kind = 'magnetometer' if 'mx' in wanted else kind
    option, units = f'--{kind}-columns', ''
    if 'ax' in wanted:
        option = '--imu-columns'
        numbers = {name: v for name, v in _numeric(table).items() if name not in columns.values()}
        for triple, unit in _triples(numbers):
            sensor = 'a' if unit in ACCELERATION else 'w'
            if f'{sensor}x' in wanted and f'{sensor}x' not in columns:
                columns |= {f'{sensor}{axis}': name for axis, name in zip('xyz', triple)}
                if unit_in_name(triple[0], {*ACCELERATION, *RATE, *SPELLINGS}) is None:
                    units += f' --{"acceleration" if sensor == "a" else "gyro"}-unit {unit}'
    if 'latitude' in wanted and not {'latitude', 'longitude'} & set(columns):
        of_imu = {table.find(aliases) for aliases in IMU_COLUMNS.values()}
        numbers = {name: v for name, v in _numeric(table).items() if name not in of_imu}
        columns |= dict(zip(('latitude', 'longitude'), _place(numbers, columns.get('time'))))
    asked = ('time', *wanted) if len(time) == 1 else wanted
    line = ','.join(f'{name}={columns.get(name) or "?"}' for name in asked)
    words = 'as it seems' if set(columns) - {'time'} else 'name them'
    return f'; {words}: {option} "{line}"{units}'


def _numeric(table: Table) -> dict[str, np.ndarray]:
    """The columns that are numbers throughout."""
    found = {}
    for name in table.names:
        try:
            values = table.numbers(name)
        except RecordingError:
            continue
        if np.isfinite(values).all():
            found[name] = values
    return found


def _ascending(table: Table) -> str | None:
    """The first column that ascends, as a time does."""
    for name, values in _numeric(table).items():
        step = np.diff(values)
        if len(step) and (step >= 0).all() and (step > 0).mean() > 0.5:
            return name
    return None


def _holds_increments(table: Table) -> bool:
    """Whether seven columns without names are time and increments of angle and velocity, as KF-GINS has them."""
    if table.names != [str(i) for i in range(1, 8)] or len(table.lines) < 2 or len(_numeric(table)) < 7:
        return False
    step = np.median(np.diff(table.numbers('1')))
    gained = np.median(np.linalg.norm(values_of(table, '567'), axis=1))
    return bool(step > 0 and abs(np.log(max(gained / step, 1e-9) / STANDARD_GRAVITY)) < _NEAR_GRAVITY)


def _place(numbers: dict[str, np.ndarray], time: str | None) -> tuple[str, ...]:
    """Two columns side by side that may be latitude and longitude, deg: with many decimals, of one neighbourhood."""
    names = [name for name in numbers if name != time]
    fine = {name: bool((np.abs(numbers[name] - np.round(numbers[name], 4)) > 1e-9).mean() > 0.5
                       and np.ptp(numbers[name]) < _NEIGHBOURHOOD) for name in names}
    for pair in zip(names, names[1:]):
        largest = [np.abs(numbers[name]).max() for name in pair]
        if all(fine[name] for name in pair) and largest[0] <= 90.0 and largest[1] <= 180.0:
            return pair
    return ()


def _triples(numbers: dict[str, np.ndarray]):
    """Yield neighbouring columns that may be the axes of a sensor, with its unit: accelerometers hold gravity, and of
    the rest what is near zero may be gyroscopes."""
    names = list(numbers)
    triples = [tuple(names[i:i + 3]) for i in range(len(names) - 2)]
    # one axis of a sensor together with two of another that are near zero has the same size as the sensor itself:
    # columns called x, y, z or 1, 2, 3, or whose number is a multiple of three, come first
    triples.sort(key=lambda t: (not re.fullmatch('xyz|123|012', ''.join(n[-1:] for n in t).lower()),
                                names.index(t[0]) % 3))
    size = {t: np.linalg.norm([numbers[n] for n in t], axis=0) for t in triples}
    taken: set[str] = set()
    near = ((t, unit) for t, s in size.items() for unit, per in ACCELERATION.items()
            if abs(np.log(max(np.median(s), 1e-9) * per / STANDARD_GRAVITY)) < _NEAR_GRAVITY)
    for triple, unit in near:
        taken |= set(triple)
        yield triple, unit
        break
    for triple, s in size.items():
        if not taken & set(triple) and 0 < np.median(s) < _FASTEST_DEG:
            yield triple, 'deg/s' if np.percentile(s, 99) > FASTEST_TURN else 'rad/s'
            return
