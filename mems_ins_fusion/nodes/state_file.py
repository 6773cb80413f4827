"""What the filter knew when it was stopped, kept in a file for the next start."""
from __future__ import annotations

import json
import math
import os
import tempfile
from pathlib import Path

from ..navigation.earth import to_local
from ..parameters.parameter import ParameterError

_VERSION = 2


class StateFile:
    """A snapshot of the filter in the file `path`; max_age: s, max_distance: m, beyond which it is not used."""

    def __init__(self, path: str, max_age: float, max_distance: float):
        self._path = Path(path).expanduser()
        self._max_age, self._max_distance = max_age, max_distance
        if not self._path.parent.is_dir():
            raise ParameterError(f"parameter 'state_file': there is no folder {self._path.parent}")
        self._snapshot: dict | None = None

    def read(self) -> str | None:
        """Read the file, for `fitting`; what is wrong with it, None where nothing is or there is none yet."""
        if self._path.exists() and not self._path.is_file():  # a pipe would be waited for, for ever
            return f'state file {self._path}: cannot be used (it is not a file); starting without'
        try:
            content = json.loads(self._path.read_text())
            if content['version'] != _VERSION:
                raise ValueError(f"version {content['version']}, not {_VERSION}")
            snapshot = content['filter']
            if not all(math.isfinite(snapshot[name]) for name in ('stamp', 'latitude', 'longitude', 'height')):
                raise ValueError('numbers that are not finite')
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            return f'state file {self._path}: cannot be used ({" ".join(str(error).split())}); starting without'
        self._snapshot = snapshot
        return None

    def fitting(self, stamp: int, latitude: float, longitude: float, height: float) -> tuple[dict | None, str] | None:
        """The snapshot, where it fits a first fix (ns, rad, m), and what is to be said of it; None where there is none.

        It is looked at once: what did not fit the first fix is not tried again.
        """
        snapshot, self._snapshot = self._snapshot, None
        if snapshot is None:
            return None
        age = (stamp - snapshot['stamp']) * 1e-9
        place = (snapshot['latitude'], snapshot['longitude'], snapshot['height'])
        north, east, _ = to_local(latitude, longitude, height, place)
        distance = math.hypot(north, east)
        if not 0.0 <= age <= self._max_age:
            return None, (f'state file {self._path}: it is {age:.0f} s old, not 0 to {self._max_age:.0f} s '
                          '(state_file_max_age): starting without')
        if not distance <= self._max_distance:
            return None, (f'state file {self._path}: its position is {distance:.0f} m from the first fix, more than '
                          f'{self._max_distance:.0f} m (state_file_max_distance): starting without')
        return snapshot, f'starting from state file {self._path}, {age:.0f} s old, {distance:.1f} m away'

    def write(self, snapshot: dict) -> str | None:
        """Replace the file, the old or the new one at any moment; what went wrong, or None."""
        try:
            handle, name = tempfile.mkstemp(dir=self._path.parent, prefix=f'.{self._path.name}.')
            with os.fdopen(handle, 'w') as file:
                json.dump({'version': _VERSION, 'filter': snapshot}, file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(name, self._path)
        except OSError as error:
            return f'state file {self._path}: not written: {error.strerror}'
        return None
