"""History of each vehicle over all its drives, from recordings and the node's state files."""
from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from ..guard import one_line
from ..results import write_files
from .sources import local_copy
from .tables import cell_text

#: folder of the files below the output folder, and their columns
FOLDER = 'history'
COLUMNS = ('stamp_ns', 'source', 'recording_id', 'effect', 'parameter', 'value', 'sigma', 'unit')
#: states in a state file that belong to the vehicle, relative to its params file
_STATES = {'time_offset': ('gnss_time_offset', 'time_offset', 's'),
           'mounting_pitch': ('mounting_rotation', 'pitch', 'rad'), 'mounting_yaw': ('mounting_rotation', 'yaw', 'rad')}


def read_state_file(place: str) -> tuple[list[dict], str]:
    """Rows of the history from a state file of `fusion_node`, and the reason if there are none, else ''."""
    try:
        with local_copy(place) as path:
            snapshot = json.loads(path.read_text(encoding='utf-8'))['filter']
        stamp, errors = int(snapshot['stamp']), snapshot['errors']
        rows = []
        for i, name in enumerate(errors['names']):
            if name in _STATES:
                effect, parameter, unit = _STATES[name]
                value, variance = float(errors['estimate'][i]), float(errors['covariance'][i][i])
                if not (math.isfinite(value) and variance >= 0.0):
                    raise ValueError(f'{name} is no number')
                rows.append({'stamp_ns': stamp, 'source': 'state_file', 'recording_id': '', 'effect': effect,
                             'parameter': parameter, 'value': value, 'sigma': math.sqrt(variance), 'unit': unit})
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        return [], f'{place} is not a state file of fusion_node: {one_line(error)}'
    return rows, ''


def estimates(effects: Sequence[dict], begins: dict[str, int], states: Sequence[dict]) -> list[dict]:
    """All estimates by time: rows with `vehicle` and COLUMNS. effects: rows of that table, of which those of single
    recordings are used. begins: ns, by recording_id. states: rows of state files, with `vehicle`."""
    known = [{**{name: row.get(name) for name in ('vehicle', *COLUMNS)}, 'stamp_ns': begins[row['recording_id']]}
             for row in effects if begins.get(row['recording_id']) is not None]
    known += list(states)
    return sorted(known, key=lambda row: (row['vehicle'], row['stamp_ns'], row['source'], row['recording_id'],
                                          row['effect'], row['parameter']))


def write(output: Path, rows: Sequence[dict]) -> None:
    """Write a file for each vehicle in `rows`."""
    texts: dict[Path, list[str]] = {}
    for row in rows:
        path = Path(output) / FOLDER / f'{quote(row["vehicle"], safe=" ")}.csv'
        texts.setdefault(path, [','.join(COLUMNS)]).append(','.join(cell_text(row[name]) for name in COLUMNS))
    write_files({path: '\n'.join(lines) + '\n' for path, lines in texts.items()}, overwrite=True)
