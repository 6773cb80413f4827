"""What the filter learns by itself: where the constraint shows them, the mounting's angles are states.

A score test sees nothing of a mounting that is turned: its state takes it up within a minute. So the size of that
effect is what the state has come to, at the end of the drive and of each half of it.
"""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..effects.mounting_rotation import MountingRotation
from ..evaluation.comparison import aiding_of
from ..filter.config import FilterConfig
from ..filter.runs.replay import run
from ..samples import Recording
from .estimate import PLAIN, Estimate

#: angles below this are for the filter to find, whatever their sigma, rad
SMALL = math.radians(1.5)
STATES = {'pitch': 'mounting_pitch', 'yaw': 'mounting_yaw'}


def estimated_by_filter(values: dict) -> dict[str, str]:
    """Effects that are states of the filter with these parameters, and why they are not traced."""
    if MountingRotation().held(values) != values:
        return {MountingRotation.name: 'the filter estimates pitch and yaw itself (imu.mounting_sigma)'}
    return {}


@dataclass(frozen=True)
class LearnedAngles:
    """Mounting angles as learned, rad: of all data, and of its halves, or of all drives but one in turn.

    drives: of each of several drives. contradicted: that these contradict each other, empty where they do not.
    """

    whole: dict[str, Estimate]
    halves: list[dict[str, float]]
    drives: tuple[dict[str, Estimate], ...] = ()
    contradicted: str = ''

    @property
    def plain(self) -> dict[str, Estimate]:
        """Those that are there."""
        return {name: e for name, e in self.whole.items()
                if abs(e.value) > SMALL and abs(e.value) > PLAIN * e.sigma}


def learned_angles(recording: Recording, values: dict) -> LearnedAngles | None:
    """The mounting's angles as a filter with these parameters learns them; None where it does not."""
    if not estimated_by_filter(values):
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
    return LearnedAngles(found, [{name: value for name, (value, _) in half.items()} for half in halves])


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


def combined_angles(found: Sequence[LearnedAngles | None]) -> LearnedAngles | None:
    """The angles of one mounting in several drives, weighted by their sigmas; None where none was learned."""
    if len(found) == 1 or all(angles is None for angles in found):
        return found[0]
    drives = tuple(angles.whole if angles else {} for angles in found)
    known = [angles for angles in drives if angles]
    names = [name for name in STATES if all(name in angles for angles in known)]
    whole = {name: _mean([angles[name] for angles in known]) for name in names}
    # of each drive in turn what the others say; where there is one other, it alone
    others = [{name: _mean([a[name] for k, a in enumerate(drives) if a and (k != i or len(known) == 1)]).value
               for name in names} for i in range(len(drives))]
    apart = [name for name in names if np.ptp([a[name].value for a in known]) > max(
        SMALL, PLAIN * float(np.hypot(*sorted(a[name].sigma for a in known)[-2:]) if len(known) > 1 else 0.0))]
    said = ', '.join(f'{name} ' + ', '.join(f'{a[name].value:.3f}' for a in known) + ' rad' for name in apart)
    return LearnedAngles(whole, others, drives, f'the drives contradict each other: {said}' if apart else '')


def _mean(estimates: Sequence[Estimate]) -> Estimate:
    """Weighted by their sigmas; sigma at least what they scatter."""
    value, sigma = (np.array([getattr(e, part) for e in estimates]) for part in ('value', 'sigma'))
    weight = sigma**-2 / (sigma**-2).sum()
    mean = float(weight @ value)
    scatter = float(np.sqrt(weight @ (value - mean) ** 2 / max(len(value) - 1, 1)))
    return Estimate(mean, max(float((sigma**-2).sum() ** -0.5), scatter), 'rad')
