"""Whether speed, velocity and heading are what their parameters say, looked at while the vehicle drives: in the words,
and with the code, of the checks that a recording passes."""
from __future__ import annotations

from collections import deque

import numpy as np

from ..filter.measurements.position import is_fix
from ..filter.measurements.registry import aiding
from ..recordings.aiding import COMPARED, check_aiding
from ..recordings.findings import INFO
from ..samples import SECOND, Fixes

#: Hz at which samples of each input are kept: a vehicle does not change faster
RATE = 10.0
#: s for which they are kept: some bends and stops
MEMORY = 240.0
#: s from one check of an input to the next
PERIOD = 5.0
#: checks with something to compare, after which there is no other: a minute of them
LOOKS = 12


class AidingCheck:
    """Collects what the inputs with a topic in `values` (checked parameters) and the fixes say, and compares them now
    and then until LOOKS are through.

    found: by name, the finding of the newest look that is worth a word, as (level, text).
    """

    def __init__(self, values: dict):
        self._measurements = {one.name: one for one in aiding(values) if values.get(one.topic)}
        self._rows: dict[str, deque] = {name: deque(maxlen=round(RATE * MEMORY)) for name in self._measurements}
        self._fixes: deque[tuple] = deque(maxlen=round(RATE * MEMORY))
        self._looks = dict.fromkeys(self._measurements, LOOKS)
        self._values, self._due = values, 0
        self.found: dict[str, tuple[str, str]] = {}

    def add(self, name: str, stamp: int, numbers: tuple) -> None:
        """A measurement of any input: stamp (ns), and value and (co)variance as the filter takes them."""
        if name in self._rows:
            _add_thinned(self._rows[name], (stamp, *numbers))

    def add_fix(self, fix: tuple) -> None:
        """stamp (ns), latitude, longitude (rad), height (m), nine of the covariance (m^2), status, covariance type."""
        if self._rows:
            _add_thinned(self._fixes, fix)

    def look(self) -> list[tuple[str, str, str]]:
        """Where a look is due: name, level and text of what was not found before."""
        now = self._fixes[-1][0] if self._fixes else 0
        if 0 <= self._due - now <= PERIOD * SECOND or len(self._fixes) < 2:
            return []
        self._due = now + round(PERIOD * SECOND)
        said = []
        for name in [name for name, left in self._looks.items() if left and len(self._rows[name]) > 2]:
            try:
                with np.errstate(all='ignore'):
                    compared, found = self._judge(name)
            except (ValueError, ArithmeticError, np.linalg.LinAlgError):  # numbers that no vehicle gives
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
    """Append `row`, whose first is a stamp, where the one before it is old enough, or of another clock."""
    if not rows or not 0 <= row[0] - rows[-1][0] < 0.9 * SECOND / RATE:
        rows.append(row)
