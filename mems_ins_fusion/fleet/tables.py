"""The tables of a fleet: `recordings`, `results`, `outages`, `effects`, `findings`, as CSV and as Parquet.

The same results give the same tables, bit for bit: rows are sorted, and do not depend on when, where or in what order
the work was done. Every fleet has the same columns, even if a column is empty.
"""
from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable
from pathlib import Path

from ..errors import InputError
from ..results import result_folder, write_files

#: folder of the tables below the output folder
FOLDER = 'tables'
TEXT, NUMBER, COUNT, FLAG = 'text', 'number', 'count', 'flag'

_ABOUT = {'vehicle': TEXT, 'recording_id': TEXT, 'params_file': TEXT, 'task': TEXT}
_MODEL = {'model': TEXT, 'mechanization': TEXT, 'stage': TEXT}
#: columns and their types of each table; docs/fleet.md describes them
TABLES = {
    'recordings': {'vehicle': TEXT, 'recording': TEXT, 'recording_id': TEXT, 'task': TEXT, 'status': TEXT,
                   'error_id': TEXT, 'reason': TEXT, 'same_as': TEXT, 'begin_ns': COUNT, 'duration_s': NUMBER,
                   'imu_samples': COUNT, 'fixes': COUNT, 'params_file': TEXT, 'reference': TEXT, 'page': TEXT},
    'results': {**_ABOUT, **_MODEL, 'update_interval_s': NUMBER, 'horizontal_rmse_m': NUMBER,
                'horizontal_rmse_low_m': NUMBER, 'horizontal_rmse_high_m': NUMBER, 'horizontal_median_m': NUMBER,
                'horizontal_p95_m': NUMBER, 'horizontal_max_m': NUMBER, 'along_track_rmse_m': NUMBER,
                'cross_track_rmse_m': NUMBER, 'turning_rmse_m': NUMBER, 'straight_rmse_m': NUMBER,
                'turning_share': NUMBER, 'heading_rmse_deg': NUMBER, 'speed_rmse_mps': NUMBER,
                'relative_translation_percent': NUMBER, 'nees_mean': NUMBER, 'nis_mean': NUMBER,
                'within_95_percent': NUMBER, 'errors_counted': COUNT, 'imu_samples': COUNT, 'fixes_used': COUNT},
    'outages': {**_ABOUT, **_MODEL, 'update_interval_s': NUMBER, 'duration_s': NUMBER, 'count': COUNT,
                'max_error_rms_m': NUMBER, 'max_error_median_m': NUMBER, 'max_error_p95_m': NUMBER,
                'percent_of_distance': NUMBER, 'within_95_percent': NUMBER, 'announced_s': NUMBER, 'crossed_s': NUMBER,
                'crossed_early_percent': NUMBER},
    'effects': {**_ABOUT, 'source': TEXT, 'effect': TEXT, 'parameter': TEXT, 'value': NUMBER, 'sigma': NUMBER,
                'unit': TEXT, 'added': FLAG, 'p_value': NUMBER, 'gain': NUMBER, 'cannot_be_told_from': TEXT},
    'findings': {**_ABOUT, 'source': TEXT, 'severity': TEXT, 'topic': TEXT, 'message': TEXT},
}


class TableError(InputError):
    """Tables that cannot be read; the text is one line with the reason."""


def complete(table: str, rows: Iterable[dict]) -> list[dict]:
    """The rows with every column of `table`, None for unknown values, sorted."""
    columns = TABLES[table]
    return sorted(({name: row.get(name) for name in columns} for row in rows), key=_order)


def _order(row: dict) -> tuple:
    """Sort key: unknown values first."""
    return tuple([(value is not None, value) for value in row.values()])


def can_write_parquet() -> bool:
    """Whether Parquet can be written."""
    try:
        import pyarrow.dataset  # noqa: F401
    except ImportError:
        return False
    return True


class TableTexts:
    """The tables as text, updated with each result, so that finished results can be written at once.

    Rows are sorted by the columns that all tables begin with, which are the same in all rows of one result.
    """

    def __init__(self):
        self._parts: dict[str, dict[tuple, str]] = {name: {} for name in TABLES}

    def add(self, name: str, rows: list[dict], of: str = '') -> None:
        """Set the rows of the table `name` that belong `of` one result."""
        found: dict[tuple, list[list[str]]] = {}
        for row in rows:
            cells = [cell_text(value) for value in row.values()]
            found.setdefault((*cells[:len(_ABOUT)], of), []).append(cells)
        for key, lines in found.items():
            text = io.StringIO()
            csv.writer(text, lineterminator='\n').writerows(lines)
            self._parts[name][key] = text.getvalue()

    def files(self, folder: Path) -> dict[Path, str]:
        """The CSV files of the tables in `folder`, with their contents."""
        return {folder / f'{name}.csv': ','.join(TABLES[name]) + '\n' + ''.join(parts[key] for key in sorted(parts))
                for name, parts in self._parts.items()}


def write(output: Path, rows: dict[str, list[dict]]) -> str:
    """Write the tables to `output` (rows by table name), replacing earlier ones. Returns a message, or ''."""
    texts, both = TableTexts(), can_write_parquet()
    with result_folder(Path(output) / FOLDER, overwrite=True, marker='recordings.csv') as folder:
        for name in TABLES:
            some = complete(name, rows.get(name, ()))
            texts.add(name, some)
            if both:
                _write_parquet(folder / name, name, some)
        write_files(texts.files(folder), overwrite=True)
    return '' if both else 'tables are written as CSV only: pip install "mems_ins_fusion[fleet]" writes Parquet, too'


def cell_text(value) -> str:
    """A cell of a CSV table: numbers such that they are read back exactly, nothing for None."""
    if value is None or isinstance(value, float) and not math.isfinite(value):
        return ''
    if isinstance(value, bool):
        return 'true' if value else 'false'
    return repr(float(value)) if isinstance(value, float) else str(value)


def _write_parquet(folder: Path, name: str, rows: list[dict]) -> None:
    """One file for each vehicle, in a folder named like a partition of Hive, which Spark, DuckDB and pandas read."""
    import pyarrow
    from pyarrow import dataset

    if not rows:
        return
    types = {TEXT: pyarrow.string(), NUMBER: pyarrow.float64(), COUNT: pyarrow.int64(), FLAG: pyarrow.bool_()}
    schema = pyarrow.schema([(column, types[kind]) for column, kind in TABLES[name].items()])
    columns = {column: [row[column] for row in rows] for column in schema.names}
    columns['vehicle'] = [vehicle or '' for vehicle in columns['vehicle']]
    by_vehicle = dataset.partitioning(pyarrow.schema([('vehicle', pyarrow.string())]), flavor='hive')
    vehicles = len(set(columns['vehicle']))
    dataset.write_dataset(pyarrow.table(columns, schema), folder, format='parquet', partitioning=by_vehicle,
                          basename_template='part-{i}.parquet', use_threads=False, max_partitions=vehicles,
                          max_rows_per_file=0, existing_data_behavior='error')


def read(output: Path, name: str) -> list[dict]:
    """The rows of the table `name` in the output folder of a fleet. TableError if it has none."""
    path = Path(output) / FOLDER / f'{name}.csv'
    try:
        with open(path, encoding='utf-8', newline='') as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise TableError(f'{output} is not the output of fleet: {path.name}: {error.strerror}') from None
    columns = TABLES[name]
    try:
        return [{column: _value(row[column], kind) for column, kind in columns.items()} for row in rows]
    except (KeyError, ValueError, TypeError) as error:
        raise TableError(f'{path} is not a table of this version: {type(error).__name__} {error}') from None


def _value(text: str, kind: str):
    if text == '':
        return '' if kind == TEXT else None
    return {TEXT: str, NUMBER: float, COUNT: int, FLAG: lambda t: t == 'true'}[kind](text)
