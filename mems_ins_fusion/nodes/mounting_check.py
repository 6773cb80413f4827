"""Checks of the IMU's units and mounting against the parameters while the vehicle drives, and whether standstills can
be distinguished from motion: the same checks as for a replay."""
from __future__ import annotations

from collections import deque

import numpy as np

from ..configuration.check import YAW_NOT_SHOWN, check_standstills, compare_mounting
from ..recordings.checker import ERROR, check_units
from ..recordings.motion import find_standstill
from ..samples import SECOND, Fixes, ImuSamples
from .aiding_check import MEMORY

#: Hz, rate to which the samples are averaged
RATE = 20.0
#: s of samples after which the mounting is checked; each check takes some 50 ms
LOOKS = (30.0, 60.0, 120.0, 240.0, 480.0, 960.0)
LONGEST_GAP = 5.0  # s, longest gap in the samples; after a longer one the check begins again
#: number of consecutive checks that have to give the same result: at the second one the data are twice as long
CERTAIN_LOOKS = 2


class MountingCheck:
    """Collects samples and fixes, SI units in sensor axes, and checks them at the times in LOOKS.

    add_sample and add_fix are the `append` methods of lists. A sample: stamp (ns), specific force, angular rate. A fix:
    stamp (ns), latitude, longitude (rad), height (m), nine elements of the covariance (m^2), status, covariance type.
    values: checked parameters.
    """

    def __init__(self, values: dict):
        self._values = values
        self._limits = np.repeat([values['imu.max_specific_force'], values['imu.max_angular_rate']], 3)
        self._samples: list[tuple] = []
        self.add_sample = self._samples.append
        self._fixes: deque[tuple] = deque(maxlen=round(20 * MEMORY))
        self.add_fix = self._fixes.append
        self._means: deque[np.ndarray] = deque(maxlen=round(RATE * MEMORY))
        self._first: int | None = None
        self._last = 0
        self._looks = list(LOOKS)
        self.found = 'not looked at yet'
        self.is_wrong = False
        #: level and text of a problem with its standstills, None without one
        self.standstills: tuple[str, str] | None = None
        self._times_certain = 0

    @property
    def is_certainly_wrong(self) -> bool:
        """Whether consecutive checks have found an impossible mounting (not just a reversing vehicle), so that
        estimates are wrong."""
        return self._times_certain >= CERTAIN_LOOKS

    @property
    def done(self) -> bool:
        """Whether there will be no further check."""
        return not self._looks

    def force(self) -> np.ndarray | None:
        """Mean specific force of the last second, (3,) m/s^2 in sensor axes; None without samples."""
        rows = list(self._means)[-round(RATE):] or [(0.0, *sample[1:]) for sample in self._samples]
        return np.mean(np.array(rows)[:, 1:4], axis=0) if rows else None

    def _restart(self) -> None:
        """Discard samples and fixes: the next samples do not follow the earlier ones."""
        self._means.clear()
        self._first = None

    def look(self) -> tuple[str, str] | None:
        """Process the new samples; if a check was due and has found a problem, ('error' or 'warning', text)."""
        if self.done:
            self._samples.clear()
            return None
        if not self._samples:
            return None
        stamps, rows = np.array([s[0] for s in self._samples]), np.array([s[1:] for s in self._samples], dtype=float)
        self._samples.clear()
        believed = (np.abs(rows) <= self._limits).all(axis=1)  # not NaN, too
        stamps, rows = stamps[believed], rows[believed]
        if not len(stamps):
            return None
        steps = np.diff(stamps, prepend=self._last if self._first is not None else stamps[0])
        breaks = np.flatnonzero((steps < 0) | (steps > LONGEST_GAP * SECOND))  # another clock, another drive
        if len(breaks):
            self._restart()
            stamps, rows = stamps[breaks[-1]:], rows[breaks[-1]:]
        if self._first is None:
            self._first = int(stamps[0])
        self._last = int(stamps[-1])
        rows = np.column_stack([stamps - self._first, rows])
        slot = (stamps - self._first) * round(RATE) // SECOND
        starts = np.flatnonzero(np.diff(slot, prepend=-1))
        length = np.diff(np.append(starts, len(rows)))[:, None]
        self._means.extend(np.add.reduceat(rows, starts) / length)
        seconds = (self._last - self._first) * 1e-9
        if seconds < self._looks[0]:
            return None
        self._looks = [look for look in self._looks if look > seconds]
        return self._judge()

    def _judge(self) -> tuple[str, str] | None:
        try:
            with np.errstate(all='ignore'):
                imu, fixes = self._imu(), self._received()
                units = check_units(imu, fixes, self._values, find_standstill(imu, fixes))
                wrong = [finding.message for finding in units if finding.severity == ERROR]
                if wrong:  # with wrong units or scales, the mounting cannot be checked
                    self.is_wrong, self.found = True, '; '.join(wrong)
                    return 'error', self.found
                findings, seen = compare_mounting(imu, fixes, self._values, self._values['gnss.time_offset'])
                standstills = list(check_standstills(imu, fixes, self._values)) if fixes is not None else []
        except (ValueError, ArithmeticError, np.linalg.LinAlgError):  # impossible values must not stop a node
            return None
        self.standstills = next(((f.severity, f.message) for f in standstills), None)
        self.is_wrong = bool(findings)
        certain = bool(findings) and findings[0].severity == ERROR
        self._times_certain = self._times_certain + 1 if certain else 0
        fits = 'nothing speaks against imu.mounting_rpy'
        if seen is None or not seen.yaw_known:
            fits = f'gravity does not speak against imu.mounting_rpy; {YAW_NOT_SHOWN} yet'
        self.found = findings[0].message if findings else fits
        return ('error' if certain else 'warning', self.found) if findings else None

    def _imu(self) -> ImuSamples:
        rows = np.array(self._means)
        stamp = self._first + np.rint(rows[:, 0]).astype(np.int64)
        return ImuSamples(stamp, stamp, rows[:, 1:4], rows[:, 4:7])

    def _received(self) -> Fixes | None:
        fixes = [fix for fix in self._fixes if fix[0] > self._first - SECOND]
        if len(fixes) < 2:
            return None
        stamp = np.array([fix[0] for fix in fixes])
        latitude, longitude, height = (np.array([fix[i] for fix in fixes], dtype=float) for i in (1, 2, 3))
        covariance = np.array([fix[4] for fix in fixes], dtype=float).reshape(-1, 3, 3)
        status, kind = (np.array([fix[i] for fix in fixes]) for i in (5, 6))
        return Fixes(stamp, stamp, latitude, longitude, height, covariance, status, kind)
