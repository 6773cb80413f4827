"""Text tables: columns by name, whatever separates them, and times to the nanosecond."""
from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.samples import SECOND

#: nanoseconds in a unit of time
TIME_UNITS = {'s': SECOND, 'ms': 10**6, 'us': 10**3, 'ns': 1}
_UNIT = re.compile(r'[\[(]\s*(.*?)\s*[\])]|_(s|ms|us|ns|m|deg|rad|g|mg|dps|rad_s|deg_s|radps|degps|m_s2|mps2|mps|m_s)$',
                   re.IGNORECASE)
#: ns: ROS stamps end in 2038
LATEST = 2**31 * SECOND
_DATE = re.compile(r'\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d*)?)?\s*[Zz]?\s*')
#: largest number in a table, in any unit: the range of times in ns (int64). A larger one is damaged
LARGEST = 9e18
_LARGEST_FILE = 2 * 10**9  # bytes, largest file; a table takes some ten times its size in memory
_COMMENT = '#%'
_LISTED = 40  # largest number of column names in a message


@dataclass(frozen=True)
class Table:
    """A text table. names: of the columns, as written. columns: the cells, one tuple of texts a column.

    lines: line number of each row in the file.
    """

    path: Path
    names: list[str]
    columns: list[tuple[str, ...]]
    lines: list[int]

    def select(self, rows: np.ndarray) -> Table:
        """The rows for which `rows`, (n,) bool, is true."""
        kept = np.flatnonzero(rows).tolist()
        return Table(self.path, self.names, [tuple(column[i] for i in kept) for column in self.columns],
                     [self.lines[i] for i in kept])

    def numbers(self, name: str) -> np.ndarray:
        """Column `name` as (n,) float64; NaN where a cell is empty or beyond LARGEST. RecordingError for a cell that is
        no number."""
        cells = self.columns[self.names.index(name)]
        try:
            values = np.array(list(map(float, cells)))
        except ValueError:
            values = np.array([self._number(name, line, cell) for line, cell in zip(self.lines, cells)])
        values[np.abs(values) > LARGEST] = np.nan
        return values

    def _number(self, name, line, cell) -> float:
        try:
            return float(cell) if cell.strip() else np.nan
        except ValueError:
            raise RecordingError(f"{self.path}, line {line}: '{cell}' in column '{name}' is not a number") from None

    def times(self, name: str, unit: str | None = None, longest: float = 20.0) -> tuple[np.ndarray, str]:
        """Column `name` as (n,) int64 ns, and the unit it was in: a key of TIME_UNITS, or `date` for ISO 8601.

        Without `unit` it is taken from the column's name, else from the intervals, which are at most `longest` seconds.
        """
        cells = self.columns[self.names.index(name)]
        if cells and ':' in cells[0]:
            return self._in_epoch(name, self._dates(name, cells), 'date'), 'date'
        unit = unit or unit_in_name(name, TIME_UNITS) or _guess_unit(self.numbers(name), longest)
        scale = TIME_UNITS[unit]
        # a number that is too large is not a time in any unit, and would take very long as an integer
        wrong = [not (_is_number(cell) and abs(float(cell)) < 1e19) for cell in cells]
        try:
            if True in wrong:
                raise ValueError
            stamp = [int(Decimal(cell) * scale) for cell in cells]
        except (InvalidOperation, ValueError, OverflowError):
            row = wrong.index(True) if True in wrong else 0
            raise RecordingError(f"{self.path}, line {self.lines[row]}: '{cells[row]}' in column '{name}' is not a "
                                 'time') from None
        return self._in_epoch(name, stamp, unit), unit

    def _dates(self, name, cells) -> list[int]:
        """ISO 8601, UTC, as ns."""
        for line, cell in zip(self.lines, cells):
            if not _DATE.fullmatch(cell):
                raise RecordingError(f"{self.path}, line {line}: '{cell}' in column '{name}' is not a date such as "
                                     '2024-05-31T12:00:00.5Z')
        try:
            texts = [cell.strip().rstrip('Zz ').replace(',', '.') for cell in cells]
            # in microseconds first: beyond the years that nanoseconds hold NumPy wraps without a word
            coarse = np.array(texts, 'datetime64[us]').astype(np.int64)
            if coarse.min() < 0 or coarse.max() >= LATEST // 1000:
                return (coarse.astype(object) * 1000).tolist()
            return np.array(texts, 'datetime64[ns]').astype(np.int64).tolist()
        except ValueError as error:
            raise RecordingError(f"{self.path}: column '{name}' holds no valid dates: {error}") from None

    def _in_epoch(self, name, stamp: list[int], unit) -> np.ndarray:
        cells = self.columns[self.names.index(name)]
        if min(stamp, default=0) < 0 and unit != 'date':
            row = stamp.index(min(stamp))
            raise RecordingError(f"{self.path}, line {self.lines[row]}: time {cells[row]} in column '{name}' is before "
                                 '0: add the same number to the times of all files, or leave such rows out')
        if min(stamp, default=0) < 0 or max(stamp, default=0) >= LATEST:
            raise RecordingError(f"{self.path}: times from {cells[0]} to {cells[-1]} in column '{name}', taken for "
                                 f'{unit}, are not between 1970 and 2038; state their unit')
        return np.array(stamp, np.int64)

    def find(self, aliases) -> str | None:
        """Name of the column that has the first of the names `aliases` that is there.

        Names are compared without case, units in brackets, and punctuation.
        """
        there = {plain_name(name): name for name in reversed(self.names)}
        return next((there[alias] for alias in aliases if alias in there), None)

    def require(self, wanted: str, aliases) -> str:
        """As `find`, but raises RecordingError if there is no column for `wanted`."""
        name = self.find(aliases)
        if name is None:
            raise RecordingError(f'{self.path} has no column that looks like {wanted}; {self.listing()}')
        return name

    def listing(self) -> str:
        shown = [name if len(name) <= 40 else f'{name[:40]}..' for name in self.names[:_LISTED]]
        more = len(self.names) - len(shown)
        return f'its columns are {", ".join(shown)}' + (f' and {more} more' if more else '')


def read_table(path) -> Table:
    """Read a text table.

    The names of the columns stand in the first line, or in the last comment before it; without them the columns are
    called 1, 2, 3 ... Cells are separated by comma, semicolon (then the decimal sign may be a comma), tab or blanks.
    Lines that begin with # or % are comments. RecordingError where the file is no such table.
    """
    path = Path(path)
    text = read_text(path)
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip()]
    body = [(i, line) for i, line in lines if line[0] not in _COMMENT]
    if not lines:
        raise RecordingError(f'{path} is empty')
    if not body:
        raise RecordingError(f'{path} has no rows')
    delimiter = next((sign for sign in ',;\t' if sign in body[0][1]), None)
    first = _cells(body[0][1], delimiter)
    if all(_is_number(cell.replace(',', '.')) for cell in first if cell):
        above = [line for i, line in lines if i < body[0][0]]
        names = _cells(above[-1].lstrip(f'{_COMMENT} '), delimiter) if above else []
        if len(names) != len(first):
            names = [str(i) for i in range(1, len(first) + 1)]
    else:
        names, body = first, body[1:]
    return Table(path, names, *_rows(path, body, delimiter, len(names)))


def read_text(path, encoding: str = 'utf-8-sig', errors: str = 'strict') -> str:
    """The contents of a text file. RecordingError where it cannot be read or is too large."""
    path = Path(path)
    try:
        if path.exists() and not path.is_file():  # reading from a pipe could wait for ever
            raise RecordingError(f'{path} is not a file')
        size = path.stat().st_size
        if size > _LARGEST_FILE:
            raise RecordingError(f'{path} has {size / 1e9:.1f} GB and would take about {size / 1e8:.0f} GB of memory; '
                                 f'at most {_LARGEST_FILE / 1e9:g} GB are read: split it')
        return path.read_text(encoding=encoding, errors=errors)
    except OSError as error:
        raise RecordingError(f'cannot read {path}: {error.strerror}') from None
    except UnicodeDecodeError:
        raise RecordingError(f'{path} is not a text file') from None


def _rows(path, body, delimiter, width):
    """The columns, and the number of the line of each row."""
    if delimiter is None:
        rows = [line.split() for _, line in body]
    else:
        reader = csv.reader((line for _, line in body), delimiter=delimiter, skipinitialspace=True)
        try:
            rows = list(reader)
        except csv.Error as error:
            raise RecordingError(f'{path}, line {body[min(reader.line_num, len(body)) - 1][0]}: {error}') from None
    if delimiter == ';':
        rows = [[cell.replace(',', '.') for cell in row] for row in rows]
    for (line, _), row in zip(body, rows):
        if len(row) != width:
            raise RecordingError(f'{path}, line {line}: {len(row)} cells instead of {width}')
    if not rows:
        raise RecordingError(f'{path} has no rows, only the names of its columns')
    if len(rows) != len(body):
        raise RecordingError(f'{path}: a quotation mark (") is not closed in the line in which it stands')
    return list(zip(*rows)), [line for line, _ in body]


def plain_name(name: str) -> str:
    """A column's name without case, unit and punctuation: `Acc_X [m/s^2]` and `acc_x_m_s2` are accx."""
    return re.sub('[^a-z0-9]', '', _UNIT.sub('', name).lower())


def unit_in_name(name: str, units) -> str | None:
    """The one of `units` that stands in a column's name, in brackets or behind its last underscore."""
    found = _UNIT.search(name)
    text = (found.group(1) or found.group(2) or '').lower() if found else ''
    return text if text in units else None


def _guess_unit(times, longest) -> str:
    """The coarsest unit in which the median interval of `times` is at most `longest` seconds."""
    steps = np.abs(np.diff(times))
    steps = steps[np.isfinite(steps) & (steps > 0)]
    interval = np.median(steps) if len(steps) else 0.0
    return next((unit for unit, scale in TIME_UNITS.items() if interval <= longest * 1e9 / scale), 'ns')


def _cells(line, delimiter):
    return [cell.strip().strip('"') for cell in line.split(delimiter)]


def _is_number(text) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
