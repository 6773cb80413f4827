"""The state file: state and findings of the filter when it was stopped, for the next start."""
from __future__ import annotations

import json
import math
import os
import tempfile
from pathlib import Path

from ..diagnosis.estimate import Estimate
from ..diagnosis.quantity import EarlierFinding
from ..navigation.earth import to_local
from ..parameters.parameter import ParameterError
from ..parameters.table import ALL

_VERSION = 2  # version of the file format; files with another version are not read


class StateFile:
    """A snapshot of the filter in the file `path`. max_age: s, max_distance: m: limits beyond which it is not used."""

    def __init__(self, path: str, max_age: float, max_distance: float):
        self._path = Path(path).expanduser()
        self._max_age, self._max_distance = max_age, max_distance
        if not self._path.parent.is_dir():
            raise ParameterError(f"parameter 'state_file': there is no folder {self._path.parent}")
        self._snapshot: dict | None = None
        self._calibration: list[dict] = []

    def read(self) -> str | None:
        """Read the file, for `fitting`, and remove unfinished files of a node that was killed while it wrote. Returns
        what is wrong with the file; None if nothing is wrong or there is no file yet."""
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
                for device in one.get('devices', {}).values():
                    float(device['rate'])
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            return f'state file {self._path}: cannot be used ({" ".join(str(error).split())}); starting without'
        self._snapshot, self._calibration = snapshot, calibration
        return None

    def calibration(self, topics: dict) -> tuple[list[EarlierFinding], list[str]]:
        """The findings of earlier drives for the sensors on the same `topics`, and their description in words. They do
        not depend on time and position of the snapshot."""
        same = [one for one in self._calibration if one['topics'] == topics]
        return [_kept(one) for one in same], [
            f"state file {self._path}: {one['name']} of an earlier drive: " + ', '.join(
                f'{name}: {value}' for name, value in one['set'].items()) for one in same]

    def devices(self, topics: dict) -> dict[str, dict]:
        """Properties of the devices on the same `topics` for which the findings are valid; empty in older files."""
        return next((one['devices'] for one in self._calibration if one['topics'] == topics and one.get('devices')), {})

    def fitting(self, stamp: int, latitude: float, longitude: float, height: float) -> tuple[dict | None, str] | None:
        """The snapshot, if it fits the first fix (ns, rad, m), and a message; None if there is no snapshot.

        It is used once: a snapshot that did not fit the first fix is not tried again.
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

    def write(self, snapshot: dict, kept: list[EarlierFinding] | None = None, topics: dict | None = None,
              devices: dict | None = None) -> str | None:
        """Replace the file; at any moment either the old or the new one exists. Returns an error message, or None.

        kept: findings for the sensors on `topics`; None: those in the file stay. devices: properties of these sensors.
        """
        if kept is not None:
            self._calibration = [one for one in self._calibration if one['topics'] != topics] + [
                {'name': one.name, 'set': one.sets, 'topics': topics, 'devices': devices or {}, 'found': one.found,
                 'parameters': {name: [e.value, e.sigma, e.unit] for name, e in one.parameters.items()}}
                for one in kept]
        name = None
        try:
            handle, name = tempfile.mkstemp(dir=self._path.parent, prefix=f'.{self._path.name}.')
            with os.fdopen(handle, 'w') as file:
                json.dump({'version': _VERSION, 'filter': snapshot, 'calibration': self._calibration}, file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(name, self._path)
        except OSError as error:
            if name:  # on a full disk there would be one more every time
                Path(name).unlink(missing_ok=True)
            return f'state file {self._path}: not written: {error.strerror}'
        return None


def _kept(one: dict) -> EarlierFinding:
    """A finding from an entry of the file. Raises ValueError, KeyError or TypeError for an invalid entry."""
    values = {name: ALL[name].check(value) for name, value in one['set'].items()}
    return EarlierFinding(str(one['name']),
                          {name: Estimate(float(value), None if sigma is None else float(sigma), str(unit))
                           for name, (value, sigma, unit) in one['parameters'].items()}, values,
                          int(one.get('found', 0)))
