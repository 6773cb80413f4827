"""Checks of speed, velocity and heading against their parameters while the vehicle drives, with the code and the
messages of the checks for recordings (`recordings.aiding`)."""
from __future__ import annotations

from collections import deque

import numpy as np

from ..filter.measurements.position import is_fix
from ..filter.measurements.registry import aiding
from ..recordings.aiding import COMPARED, check_aiding
from ..recordings.remarks import INFO
from ..samples import SECOND, Fixes

#: Hz, rate at which samples of each input are kept: the motion of a vehicle has no higher frequencies
RATE = 10.0
#: s for which samples of the inputs, and means of those of the IMU, are kept: some bends and stops; some 400 kB each
MEMORY = 240.0
#: s between two checks of an input
PERIOD = 5.0
#: number of checks with data to compare, after which checking ends: a minute of them
LOOKS = 12


class AidingCheck:
    """Collects the samples of the fixes and of the inputs with a topic in `values` (checked parameters), and compares
    them each PERIOD until LOOKS checks are done.

    found: by name of the input, level and text of the worst finding of the newest check.
    """

    def __init__(self, values: dict):
        self._measurements = {one.name: one for one in aiding(values) if values.get(one.topic)}
        self._rows: dict[str, deque] = {name: deque(maxlen=round(RATE * MEMORY)) for name in self._measurements}
        self._fixes: deque[tuple] = deque(maxlen=round(RATE * MEMORY))
        self._looks = dict.fromkeys(self._measurements, LOOKS)
        self._values, self._due = values, 0
        self.found: dict[str, tuple[str, str]] = {}

    def add(self, name: str, stamp: int, numbers: tuple) -> None:
        """Add a measurement of any input: stamp (ns), and value and (co)variance as for the filter."""
        if name in self._rows:
            _add_thinned(self._rows[name], (stamp, *numbers))

    def add_fix(self, fix: tuple) -> None:
        """Add a fix: stamp (ns), latitude, longitude (rad), height (m), nine elements of the covariance (m^2), status,
        covariance type."""
        if self._rows:
            _add_thinned(self._fixes, fix)

    def look(self) -> list[tuple[str, str, str]]:
        """Do the checks that are due; name, level and text of each new finding."""
        now = self._fixes[-1][0] if self._fixes else 0
        if 0 <= self._due - now <= PERIOD * SECOND or len(self._fixes) < 2:
            return []
        self._due = now + round(PERIOD * SECOND)
        said = []
        for name in [name for name, left in self._looks.items() if left and len(self._rows[name]) > 2]:
            try:
                with np.errstate(all='ignore'):
                    compared, found = self._judge(name)
            except (ValueError, ArithmeticError, np.linalg.LinAlgError):  # values that are numerically impossible
                continue
            self._looks[name] -= compared
            before = self.found.pop(name, None)
            if found is not None:
                self.found[name] = found
                if before is None or before[1][:40] != found[1][:40]:
                    said.append((name, *found))
        return said

    def _judge(self, name) -> tuple[bool, tuple[str, str] | None]:
        measurement = self._measurements[name]
        stamp, *columns = (np.array(column) for column in zip(*self._rows[name]))
        stamp, fixes = stamp.astype(np.int64), self._received()
        findings = check_aiding(measurement, measurement.samples(stamp, stamp, *columns),
                                fixes.select(is_fix(fixes)), measurement.settings(self._values))
        if not any(COMPARED & finding.values.keys() for finding in findings):
            return False, None
        worth = [f for f in findings if f.severity != INFO and 'count' not in f.values]
        return True, (worth[0].severity, worth[0].message) if worth else None

    def _received(self) -> Fixes:
        rows = list(self._fixes)
        stamp = np.array([row[0] for row in rows], dtype=np.int64)
        latitude, longitude, height = (np.array([row[i] for row in rows], dtype=float) for i in (1, 2, 3))
        covariance = np.array([row[4] for row in rows], dtype=float).reshape(-1, 3, 3)
        fixes = Fixes(stamp, stamp, latitude, longitude, height, covariance, *(np.array([row[i] for row in rows])
                                                                               for i in (5, 6)))
        return fixes.select(np.argsort(stamp, kind='stable'))


def _add_thinned(rows: deque, row: tuple) -> None:
    """Append `row`, which begins with a stamp, if the previous row is old enough (RATE), or of another clock."""
    if not rows or not 0 <= row[0] - rows[-1][0] < 0.9 * SECOND / RATE:
        rows.append(row)
