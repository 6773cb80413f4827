"""The live filter with a start and a memory from outside."""
from __future__ import annotations

import math

import numpy as np

from ..filter.alignment import Start
from ..filter.live import FusionFilter


class LiveFilter(FusionFilter):
    """A `FusionFilter` that can be told where it is, and that can be continued after a restart."""

    def set_start(self, latitude, longitude, height, yaw, covariance) -> None:
        """Be there now, at rest. rad, m; yaw clockwise from north; covariance (4, 4) of north, east, down (m), yaw."""
        if self._epoch is None:
            self.say('warning', 'start pose: no IMU sample yet, nothing to start from')
            return
        epoch = self._now
        self.reset()
        self._epoch = epoch
        p = np.zeros((5, 5))
        p[np.ix_([0, 1, 4], [0, 1, 4])] = np.asarray(covariance)[np.ix_([0, 1, 3], [0, 1, 3])]
        p[2, 2] = p[3, 3] = 0.25
        self._begin(Start(0.0, latitude, longitude, height, np.zeros(2), float(yaw), p, None), epoch)

    def snapshot(self) -> dict | None:
        """What a restart can begin with, in plain numbers; None while there is no estimate."""
        if not self.aligned:
            return None
        stamp, health = self.update_odometry(), self.health()
        latitude, longitude, height = self.geodetic.tolist()
        x, y, z, w = self.odometry[3:7].tolist()
        east = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return {'stamp': stamp, 'latitude': latitude, 'longitude': longitude, 'height': height,
                'yaw': math.pi / 2 - east, 'yaw_sigma': math.radians(health['heading sigma, deg']),
                'position_sigma': health['position sigma, m']}

    def restore(self, snapshot: dict) -> None:
        """Begin with a `snapshot` of an earlier run; ValueError where it is not one."""
        try:
            sigma = snapshot['position_sigma'] + 1.0
            self.set_start(snapshot['latitude'], snapshot['longitude'], snapshot['height'], snapshot['yaw'],
                           np.diag([sigma**2, sigma**2, sigma**2, snapshot['yaw_sigma'] ** 2 + 0.05**2]))
        except (KeyError, TypeError) as error:
            raise ValueError(f'not a state of the filter: {error}') from None
