"""Whether the IMU sits as the parameters say, looked at while the vehicle drives: as replays look at it."""
from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from ..configuration.check import mounting_findings
from ..recordings.checker import ERROR
from ..samples import Fixes, ImuSamples

#: the samples are averaged to so many a second, and kept for so long, s: some 400 kB
RATE, MEMORY = 20.0, 240.0
#: after so many seconds of samples it is looked at; each look takes some 50 ms
LOOKS = (30.0, 60.0, 120.0, 240.0, 480.0, 960.0)
LONGEST_GAP = 5.0  # s
_SECOND = 10**9  # ns


class MountingCheck:
    """Collects samples and fixes, SI units in sensor axes, and looks at them now and then until LOOKS are through.

    add_sample and add_fix are lists' own `append`: stamp (ns), specific force and angular rate; stamp, latitude, longitude
    (rad), height (m), nine of the covariance (m^2), status, covariance type.
    """

    def __init__(self, mounting_rpy: Sequence[float], time_offset: float):
        self._mounting, self._lag = mounting_rpy, time_offset
        self._samples: list[tuple] = []
        self.add_sample = self._samples.append
        self._fixes: deque[tuple] = deque(maxlen=round(20 * MEMORY))
        self.add_fix = self._fixes.append
        self._means: deque[np.ndarray] = deque(maxlen=round(RATE * MEMORY))
        self._first: int | None = None
        self._looks = list(LOOKS)
        self.found = 'not looked at yet'
        self.is_wrong = False

    @property
    def done(self) -> bool:
        """Whether there will be no other look."""
        return not self._looks

    def restart(self) -> None:
        """Forget the samples: those to come do not follow them."""
        self._samples.clear()
        self._fixes.clear()
        self._means.clear()
        self._first = None

    def look(self) -> tuple[str, str] | None:
        """Take in what has come; where it was time for a look that has found something, ('error' or 'warning', text)."""
        if self.done:
            self._samples.clear()
            return None
        if not self._samples:
            return None
        rows = np.array(self._samples)  # stamps as floats are good to a microsecond
        stamps = [sample[0] for sample in self._samples]
        self._samples.clear()
        if self._first is None:
            self._first = self._last = stamps[0]
        if min(stamps) < self._last or max(stamps) > self._last + LONGEST_GAP * _SECOND:  # another clock
            self.restart()
            return None
        self._last = stamps[-1]
        slot = np.array([(stamp - self._first) * RATE // _SECOND for stamp in stamps])
        starts = np.flatnonzero(np.diff(slot, prepend=np.nan) != 0)
        length = np.diff(np.append(starts, len(rows)))[:, None]
        rows[:, 0] -= self._first
        self._means.extend(np.add.reduceat(rows, starts) / length)
        if (stamps[-1] - self._first) * 1e-9 < self._looks[0]:
            return None
        self._looks.pop(0)
        return self._judge()

    def _judge(self) -> tuple[str, str] | None:
        try:
            findings = mounting_findings(self._imu(), self._received(), self._mounting, self._lag)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):  # numbers that no vehicle gives: no reason to stop
            return None
        self.is_wrong = bool(findings)
        self.found = findings[0].message if findings else 'nothing speaks against imu.mounting_rpy'
        return ('error' if findings[0].severity == ERROR else 'warning', self.found) if findings else None

    def _imu(self) -> ImuSamples:
        rows = np.array(self._means)
        stamp = self._first + np.rint(rows[:, 0]).astype(np.int64)
        return ImuSamples(stamp, stamp, rows[:, 1:4], rows[:, 4:7])

    def _received(self) -> Fixes | None:
        fixes = [fix for fix in self._fixes if fix[0] > self._first - _SECOND]
        if len(fixes) < 2:
            return None
        stamp = np.array([fix[0] for fix in fixes])
        latitude, longitude, height = (np.array([fix[i] for fix in fixes], dtype=float) for i in (1, 2, 3))
        covariance = np.array([fix[4] for fix in fixes], dtype=float).reshape(-1, 3, 3)
        status, kind = (np.array([fix[i] for fix in fixes]) for i in (5, 6))
        return Fixes(stamp, stamp, latitude, longitude, height, covariance, status, kind)
