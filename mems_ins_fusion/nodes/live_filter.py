"""What the node asks of a live filter beside samples and fixes, on top of `filter.fusion.FusionFilter`.

The node knows the filter by this interface only: state and health in plain numbers and words, what became of each
fix, and a start, a stop and a memory from outside.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..filter.alignment import Start
from ..filter.fusion import FusionFilter
from ..filter.layout import NAV, Fix, Nav, covariance, views


@dataclass(frozen=True)
class Judged:
    """What the filter did with one measurement. stamp: ns. kind: fix, speed, velocity or heading. weight: of its
    inverse covariance, 0 to 1. reason: in words. innovation: predicted minus measured, m, m/s or rad."""

    stamp: int
    kind: str
    used: bool
    weight: float
    reason: str
    innovation: tuple[float, ...]
    nis: float


class LiveFilter(FusionFilter):
    """A `FusionFilter` that tells how it is."""

    def __init__(self, config):
        super().__init__(config)
        self._fixes_wanted = True
        self._told = -math.inf
        self._judged: list[Judged] = []
        self._counts = {'used': 0, 'refused': 0}
        self._delay = math.nan

    @property
    def state(self) -> str:
        """waiting, aligning, fusing, coasting, degraded or recovering."""
        if self._memory is None:
            return 'waiting' if self._last_fix_stamp is None else 'aligning'
        return 'coasting' if self._outage else 'fusing'

    def health(self) -> dict:
        """What a user should see of the filter: numbers (SI units unless the name says otherwise) and words."""
        self._look_at_fixes()
        values: dict = {'state': self.state, 'status': self.status, 'fix used': self._counts['used'],
                        'fix refused': self._counts['refused'], 'delay of the fixes, s': self._delay}
        if self.datum is not None:
            values['datum'] = ' '.join(f'{v:.8f}' for v in (*np.degrees(self.datum[:2]), self.datum[2]))
        if self._memory is None:
            return values
        row = self._newest_row()
        n = self.config.navigation
        sigma = np.sqrt(np.diag(covariance(row, n, self.config.others)))
        values |= {'age of the last fix used, s': (self._last_stamp - self._newest_fix) * 1e-9,
                   'position sigma, m': float(np.hypot(*sigma[:2])),
                   'heading sigma, deg': math.degrees(sigma[4 if n == 5 else 8])}
        for i, channel in enumerate(self.config.channels):
            values[f'error {channel}'] = float(row[NAV + n + i * self.config.order])
            values[f'error {channel} sigma'] = float(sigma[n + i * self.config.order])
        return values

    def add_fix(self, stamp, latitude, longitude, height, covariance, status=0, covariance_type=2) -> None:
        if self._fixes_wanted:
            if self._last_stamp is not None:
                self._delay = (self._last_stamp - stamp) * 1e-9
            said = len(self._notices)
            super().add_fix(stamp, latitude, longitude, height, covariance, status, covariance_type)
            refusals = [n.text for n in self._notices[said:] if 'dropped' in n.text or 'no fix' in n.text]
            if refusals:
                self._counts['refused'] += 1
                self._judged.append(Judged(stamp, 'fix', False, 0.0, refusals[-1], (math.nan, math.nan), math.nan))

    def verdicts(self) -> list[Judged]:
        """What was done with each measurement since the last call."""
        self._look_at_fixes()
        judged, self._judged = self._judged, []
        return judged

    def _look_at_fixes(self) -> None:
        if self._memory is None:
            return
        fixes = views(self._memory)[4]
        for fix in fixes[fixes[:, Fix.APPLIED] == 1.0]:
            if fix[Fix.TIME] > self._told:
                self._told = fix[Fix.TIME]
                self._counts['used'] += 1
                self._judged.append(Judged(self._epoch + self._offset + round(fix[Fix.TIME] * 1e9), 'fix', True, 1.0,
                                           'used', (float(fix[Fix.Z_N]), float(fix[Fix.Z_E])), float(fix[Fix.NIS])))

    def reset(self) -> None:
        """Forget everything but the datum and begin anew."""
        self._restart()
        self._told = -math.inf
        self._say('info', 'reset: the filter aligns anew')

    def use_fixes(self, wanted: bool) -> None:
        """Whether fixes are used from now on."""
        self._fixes_wanted = wanted

    def set_start(self, latitude, longitude, height, yaw, covariance) -> None:
        """Be there now, at rest. rad, m; yaw clockwise from north; covariance (4, 4) of north, east, down (m), yaw."""
        if self._last_stamp is None:
            self._say('warning', 'start pose: no IMU sample yet, nothing to start from')
            return
        epoch = self._last_stamp
        self._restart()
        self._told = -math.inf
        self._epoch = epoch
        p = np.zeros((5, 5))
        p[np.ix_([0, 1, 4], [0, 1, 4])] = np.asarray(covariance)[np.ix_([0, 1, 3], [0, 1, 3])]
        p[2, 2] = p[3, 3] = 0.25
        self._begin(Start(0.0, latitude, longitude, height, np.zeros(2), float(yaw), p, None), epoch)

    def snapshot(self) -> dict | None:
        """What a restart can begin with, in plain numbers; None while there is no estimate."""
        if self._memory is None:
            return None
        row, health = self._newest_row(), self.health()
        self.update_odometry()
        latitude, longitude, height = self.geodetic.tolist()
        x, y, z, w = self.odometry[3:7].tolist()
        east = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return {'stamp': self._last_stamp, 'latitude': latitude, 'longitude': longitude, 'height': height,
                'yaw': math.pi / 2 - east, 'yaw_sigma': math.radians(health['heading sigma, deg']),
                'position_sigma': health['position sigma, m'], 'moving': float(np.hypot(row[Nav.V_N], row[Nav.V_E]))}

    def restore(self, snapshot: dict) -> None:
        """Begin with a `snapshot` of an earlier run; ValueError where it is not one."""
        try:
            sigma = snapshot['position_sigma'] + 1.0
            self.set_start(snapshot['latitude'], snapshot['longitude'], snapshot['height'], snapshot['yaw'],
                           np.diag([sigma**2, sigma**2, sigma**2, snapshot['yaw_sigma'] ** 2 + 0.05**2]))
        except (KeyError, TypeError) as error:
            raise ValueError(f'not a state of the filter: {error}') from None

    def add_speed(self, stamp: int, speed: float, variance: float) -> None:
        """m/s forward at the rear axle, m^2/s^2."""

    def add_velocity(self, stamp: int, velocity, covariance) -> None:
        """(3,) m/s north-east-down of the antenna; (3, 3) m^2/s^2."""

    def add_heading(self, stamp: int, yaw: float, variance: float) -> None:
        """rad clockwise from north, rad^2."""

    def _newest_row(self):
        head, _, rows, *_ = views(self._memory)
        return rows[np.argmax(rows[:-2, Nav.TIME])]
