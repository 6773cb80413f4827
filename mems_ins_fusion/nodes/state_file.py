"""What the filter knew when it was stopped, kept in a file for the next start."""
from __future__ import annotations

import json
import math
import os
import tempfile
from pathlib import Path

from ..diagnosis.estimate import Estimate
from ..diagnosis.quantity import Kept
from ..navigation.earth import to_local
from ..parameters.parameter import ParameterError
from ..parameters.table import ALL

_VERSION = 2  # of the file: others are not read


class StateFile:
    """A snapshot of the filter in the file `path`; max_age: s, max_distance: m, beyond which it is not used."""

    def __init__(self, path: str, max_age: float, max_distance: float):
        self._path = Path(path).expanduser()
        self._max_age, self._max_distance = max_age, max_distance
        if not self._path.parent.is_dir():
            raise ParameterError(f"parameter 'state_file': there is no folder {self._path.parent}")
        self._snapshot: dict | None = None
        self._calibration: list[dict] = []

    def read(self) -> str | None:
        """Read the file, for `fitting`; what is wrong with it, None where nothing is or there is none yet. What a node
        that was killed while it wrote has left beside it goes."""
        for unfinished in self._path.parent.glob(f'.{self._path.name}.*'):
            unfinished.unlink(missing_ok=True)
        if self._path.exists() and not self._path.is_file():  # a pipe would be waited for, for ever
            return f'state file {self._path}: cannot be used (it is not a file); starting without'
        try:
            content = json.loads(self._path.read_text())
            if content['version'] != _VERSION:
                raise ValueError(f"version {content['version']}, not {_VERSION}")
            snapshot = content['filter']
            if not all(math.isfinite(snapshot[name]) for name in ('stamp', 'latitude', 'longitude', 'height')):
                raise ValueError('numbers that are not finite')
            calibration = content.get('calibration', [])
            for one in calibration:
                _kept(one)
                for told in one.get('devices', {}).values():
                    float(told['rate'])
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            return f'state file {self._path}: cannot be used ({" ".join(str(error).split())}); starting without'
        self._snapshot, self._calibration = snapshot, calibration
        return None

    def calibration(self, topics: dict) -> tuple[list[Kept], list[str]]:
        """What earlier drives have found of the sensors on the same `topics`, and that in words. It does not go with
        the time or the place of the snapshot."""
        same = [one for one in self._calibration if one['topics'] == topics]
        return [_kept(one) for one in same], [
            f"state file {self._path}: {one['name']} of an earlier drive: " + ', '.join(
                f'{name}: {value}' for name, value in one['set'].items()) for one in same]

    def devices(self, topics: dict) -> dict[str, dict]:
        """What the sensors on the same `topics` told of themselves when that was found; empty in older files."""
        return next((one['devices'] for one in self._calibration if one['topics'] == topics and one.get('devices')), {})

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

    def write(self, snapshot: dict, kept: list[Kept] | None = None, topics: dict | None = None,
              devices: dict | None = None) -> str | None:
        """Replace the file, the old or the new one at any moment; what went wrong, or None.

        kept: what is known of the sensors on `topics`; None: what was in the file stays there. devices: what these
        sensors tell of themselves.
        """
        if kept is not None:
            self._calibration = [one for one in self._calibration if one['topics'] != topics] + [
                {'name': one.name, 'set': one.sets, 'topics': topics, 'devices': devices or {}, 'found': one.found,
                 'parameters': {name: [e.value, e.sigma, e.unit] for name, e in one.parameters.items()}}
                for one in kept]
        try:
            handle, name = tempfile.mkstemp(dir=self._path.parent, prefix=f'.{self._path.name}.')
            with os.fdopen(handle, 'w') as file:
                json.dump({'version': _VERSION, 'filter': snapshot, 'calibration': self._calibration}, file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(name, self._path)
        except OSError as error:
            return f'state file {self._path}: not written: {error.strerror}'
        return None


def _kept(one: dict) -> Kept:
    """An entry of the file. Raises ValueError, KeyError or TypeError where it is none."""
    values = {name: ALL[name].check(value) for name, value in one['set'].items()}
    return Kept(str(one['name']), {name: Estimate(float(value), None if sigma is None else float(sigma), str(unit))
                                   for name, (value, sigma, unit) in one['parameters'].items()}, values,
                int(one.get('found', 0)))
