"""The tables of a fleet: `recordings`, `results`, `outages`, `effects`, `findings`, as CSV and as Parquet.

The same results give the same tables, bit for bit: rows are sorted, and nothing in them depends on when, where or in
what order the work was done. A column is the same in each fleet, also where nothing stands in it.
"""
from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import quote

from ..errors import InputError
from ..results import result_folder

#: where the tables stand below the output folder
FOLDER = 'tables'
TEXT, NUMBER, COUNT, FLAG = 'text', 'number', 'count', 'flag'

_ABOUT = {'vehicle': TEXT, 'recording_id': TEXT, 'params_file': TEXT, 'task': TEXT}
_MODEL = {'model': TEXT, 'mechanization': TEXT, 'stage': TEXT}
#: name of a table -> its columns and their types; what they mean: docs/fleet.md
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
                'percent_of_distance': NUMBER, 'within_95_percent': NUMBER},
    'effects': {**_ABOUT, 'source': TEXT, 'effect': TEXT, 'parameter': TEXT, 'value': NUMBER, 'sigma': NUMBER,
                'unit': TEXT, 'added': FLAG, 'p_value': NUMBER, 'gain': NUMBER, 'cannot_be_told_from': TEXT},
    'findings': {**_ABOUT, 'source': TEXT, 'severity': TEXT, 'topic': TEXT, 'message': TEXT},
}


class TableError(InputError):
    """Tables that cannot be read: one line that says why."""


def complete(table: str, rows: Iterable[dict]) -> list[dict]:
    """The rows with every column of `table`, None where nothing is known, sorted."""
    columns = TABLES[table]
    return sorted(({name: row.get(name) for name in columns} for row in rows), key=_order)


def _order(row: dict) -> tuple:
    return tuple((value is not None, str(value) if isinstance(value, str) else '', 0.0 if value is None or isinstance(
        value, str) else float(value)) for value in row.values())


def ready() -> bool:
    """Whether Parquet can be written. Importing what writes it takes its time, which an interrupted user has not: so
    this is asked before the work begins."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        return False
    return True


def write(output: Path, tables: dict[str, list[dict]]) -> str:
    """Replace the tables in `output` (rows by name of the table); what is to be said of that, or ''."""
    with result_folder(Path(output) / FOLDER, overwrite=True, marker='recordings.csv') as folder:
        for name in TABLES:
            rows = complete(name, tables.get(name, ()))
            with open(folder / f'{name}.csv', 'w', encoding='utf-8', newline='') as file:
                writer = csv.writer(file, lineterminator='\n')
                writer.writerow(TABLES[name])
                writer.writerows([_text(value) for value in row.values()] for row in rows)
        if not ready():
            return 'tables are written as CSV only: pip install "mems_ins_fusion[fleet]" writes Parquet, too'
        for name in TABLES:
            _write_parquet(folder / name, name, complete(name, tables.get(name, ())))
    return ''


def _text(value) -> str:
    """As it is read again to the same number; nothing for None."""
    if value is None or isinstance(value, float) and not math.isfinite(value):
        return ''
    if isinstance(value, bool):
        return 'true' if value else 'false'
    return repr(float(value)) if isinstance(value, float) else str(value)


def _write_parquet(folder: Path, name: str, rows: list[dict]) -> None:
    """One file for each vehicle, in a folder that tells it, as Hive, Spark, DuckDB and pandas read it."""
    import pyarrow
    from pyarrow import parquet

    types = {TEXT: pyarrow.string(), NUMBER: pyarrow.float64(), COUNT: pyarrow.int64(), FLAG: pyarrow.bool_()}
    # the vehicle is told by the folder
    schema = pyarrow.schema([(column, types[kind]) for column, kind in TABLES[name].items() if column != 'vehicle'])
    by_vehicle: dict[str, list] = {}
    for row in rows:
        by_vehicle.setdefault(row['vehicle'] or '', []).append(row)
    for vehicle, some in by_vehicle.items():
        part = folder / f'vehicle={quote(vehicle, safe="")}'
        part.mkdir(parents=True)
        columns = {column: [row[column] for row in some] for column in schema.names}
        parquet.write_table(pyarrow.table(columns, schema), part / 'part-0.parquet', store_schema=False)


def read(output: Path, name: str) -> list[dict]:
    """The rows of the table `name` in the folder `output` of a fleet. TableError where it is none."""
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
