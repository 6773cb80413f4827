"""Whether speed, velocity and heading are what their parameters say, looked at while the vehicle drives: in the words,
and with the code, of the checks that a recording passes."""
from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from ..recordings.aiding import check_heading, check_speed, check_velocity
from ..recordings.findings import INFO, Finding
from ..recordings.motion import valid_fixes
from ..samples import Fixes, Headings, Speeds, Velocities

#: so many of each are kept a second, and for so long, s
RATE, MEMORY = 10.0, 240.0
#: it is looked at so often, s, until so many looks have found something to compare with
PERIOD, LOOKS = 5.0, 12
#: a speed that is never more is none, m/s
_ZERO = 0.02
_SECOND = 10**9  # ns
_KINDS = {'speed': (Speeds, check_speed), 'velocity': (Velocities, check_velocity),
          'heading': (Headings, check_heading)}
#: what a finding's values hold where there was something to compare with
_COMPARED = {'ratio', 'offset_rad', 'cosine', 'concentration'}


class AidingCheck:
    """Collects what the inputs `names` and the fixes say, and compares them now and then until LOOKS are through.

    found: by name, the finding of the newest look that is worth a word, as (level, text).
    """

    def __init__(self, names: Sequence[str], values: dict):
        self._rows: dict[str, deque] = {name: deque(maxlen=round(RATE * MEMORY)) for name in names}
        self._fixes: deque[tuple] = deque(maxlen=round(RATE * MEMORY))
        self._looks = dict.fromkeys(names, LOOKS)
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
        if 0 <= self._due - now <= PERIOD * _SECOND or len(self._fixes) < 2:
            return []
        self._due = now + round(PERIOD * _SECOND)
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
        kind, check = _KINDS[name]
        columns = [np.array(column) for column in zip(*self._rows[name])]
        stamp = columns[0].astype(np.int64)
        factor = self._values['speed.factor'] if name == 'speed' else 1.0
        samples = kind(stamp, stamp, factor * columns[1], factor**2 * columns[2])
        if name == 'heading':
            samples = Headings(stamp, stamp, columns[1] - self._values['heading.offset'], columns[2])
        fixes = self._received()
        findings = list(check(samples, fixes.select(valid_fixes(fixes))))
        compared = any(finding.values.keys() & _COMPARED for finding in findings)
        worth = [f for f in findings if f.severity != INFO and 'count' not in f.values and 'chords' not in f.values]
        if not worth or not compared:
            return compared, None
        return True, (worth[0].severity, worth[0].message + self._advice(name, worth, factor * columns[1]))

    def _advice(self, name: str, findings: list[Finding], value) -> str:
        """The parameter to set."""
        ratio = next((f.values['ratio'] for f in findings if 'ratio' in f.values), 1.0)
        if name == 'speed' and np.abs(value).max() < _ZERO:
            return ': it stays at zero while the vehicle drives; leave speed_topic empty until its sensor works'
        if name == 'speed' and any({'ratio', 'negative'} & f.values.keys() for f in findings):
            sign = -1.0 if any('negative' in f.values for f in findings) else 1.0
            return f": set speed.factor to {sign * self._values['speed.factor'] / ratio:.5g}"
        offset = findings[0].values.get('offset_rad')
        if name == 'heading' and offset is not None:
            return f": set heading.offset to {self._values['heading.offset'] + offset:.4f}"
        return ''

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
    if not rows or not 0 <= row[0] - rows[-1][0] < 0.9 * _SECOND / RATE:
        rows.append(row)
