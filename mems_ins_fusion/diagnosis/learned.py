"""What the filter learns by itself: where the constraint shows them, the mounting's angles are states.

A score test sees nothing of a mounting that is turned: its state takes it up within a minute. So the size of that
effect is what the state has come to, at the end of the drive and of each half of it.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..evaluation.comparison import aiding_of
from ..filter.config import FilterConfig
from ..filter.replay import run
from ..samples import Recording
from .estimate import Estimate

#: angles below this are for the filter to find, whatever their sigma, rad
SMALL = math.radians(1.5)
#: an angle is there from so many sigma on
PLAIN = 3.0
STATES = {'pitch': 'mounting_pitch', 'yaw': 'mounting_yaw'}


def hides(values: dict) -> dict[str, str]:
    """Effects that are states of the filter with these parameters, and why they are not traced."""
    if values['vehicle.non_holonomic'] and values['imu.mounting_sigma'] > 0:
        return {'mounting_rotation': 'the filter estimates pitch and yaw itself (imu.mounting_sigma)'}
    return {}


@dataclass(frozen=True)
class Angles:
    """Mounting angles as learned, rad: of the whole drive, and of its halves where those are long enough."""

    whole: dict[str, Estimate]
    halves: list[dict[str, float]]

    @property
    def plain(self) -> dict[str, Estimate]:
        """Those that are there."""
        return {name: e for name, e in self.whole.items()
                if abs(e.value) > SMALL and abs(e.value) > PLAIN * e.sigma}


def angles(recording: Recording, values: dict) -> Angles | None:
    """The mounting's angles as a filter with these parameters learns them; None where it does not."""
    if not hides(values):
        return None
    config = FilterConfig.from_parameters(values)
    begin, end = recording.imu.stamp[[0, -1]]
    middle = begin + (end - begin) // 2
    whole = _learned(config, recording, begin, end)
    if whole is None:
        return None
    halves = [h for h in (_learned(config, recording, begin, middle), _learned(config, recording, middle, end)) if h]
    found = {}
    for name, (value, sigma) in whole.items():
        apart = [abs(half[name][0] - value) for half in halves]
        found[name] = Estimate(value, max([sigma, *apart]), 'rad')
    return Angles(found, [{name: value for name, (value, _) in half.items()} for half in halves])


def _learned(config: FilterConfig, recording: Recording, begin: int, end: int) -> dict | None:
    """Value and sigma of each angle after the drive from `begin` to `end`, ns; None where the filter does not start."""
    imu, fixes = (samples.select((samples.stamp >= begin) & (samples.stamp <= end))
                  for samples in (recording.imu, recording.gnss))
    if len(imu) < 2 or not len(fixes):
        return None
    keep = np.zeros(len(imu), dtype=bool)
    keep[-1] = True
    result = run(config, imu, fixes, aiding_of(recording), keep=keep)
    if not len(result.stamp):
        return None
    names = config.layout.names
    first = len(names) - len(config.extras)
    return {angle: (float(result.extras[-1, names.index(state) - first]), float(result.sigma[-1, names.index(state)]))
            for angle, state in STATES.items() if state in names}
