"""What recordings show without a filter, and the further starts of a search that follow from it: a search that begins
at a wrong time offset may not leave it."""
from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..configuration.check import SMALL_OFFSET, clocks_left
from ..configuration.mounting import estimate_mounting
from ..configuration.offset import Offset, together
from ..configuration.regression import weighted
from ..configuration.remaining import Remaining
from ..configuration.speed_offset import LowPass
from ..effects.aiding_lag import AidingLag
from ..effects.aiding_time_offset import SeveralTimeOffsets
from ..effects.base import Effect
from ..effects.registry import effects_of
from ..recordings.remarks import SURE
from ..samples import Recording

SAME = 0.05  # s, difference of time offsets below which two starts lead to the same maximum
TIME_OFFSET = 'gnss.time_offset'


@dataclass(frozen=True)
class DirectEvidence:
    """What all recordings show without a filter. track: time offset, lever arm and smoothing of the receiver; None if
    the fixes do not show them. clocks: by the name of an input, its time offset minus the given one. low_passes: the
    same, s, for certain, that it comes through beside that of the given parameters: a part of that offset."""

    track: Offset | None = None
    clocks: Mapping[str, Remaining] = field(default_factory=dict)
    low_passes: Mapping[str, LowPass] = field(default_factory=dict)

    @property
    def late(self) -> dict[str, float]:
        """By name of the input: time offsets, s, that are certainly not as given."""
        return {name: left.value for name, left in self.clocks.items() if left.certain(SMALL_OFFSET, SURE)}

    def effects(self, values: dict) -> tuple[Effect, ...]:
        """All there are for the parameters `values`. What comes through a low pass has its offset with it; several
        offsets are an effect of their own, too."""
        found = [effect for effect in effects_of(values)
                 if effect.name not in {f'{name}_time_offset' for name in self.low_passes}]
        found = [AidingLag(effect.of, effect.known, effect.of in self.low_passes) if isinstance(effect, AidingLag)
                 else effect for effect in found]
        if len(self.late) > 1:
            found.append(SeveralTimeOffsets(self.late, {name: one.tau for name, one in self.low_passes.items()
                                                        if name in self.late}))
        return tuple(found)


def shown_without_filter(recordings: Sequence[Recording], values: dict) -> DirectEvidence:
    """What the recordings show, relative to the checked parameters `values`."""
    found = [estimate_mounting(recording.imu, recording.gnss) for recording in recordings]
    each = [clocks_left(recording, recording.imu, mounting, values) for recording, mounting in zip(recordings, found)]
    clocks, low_passes = {}, {}
    for name in dict.fromkeys(name for one in each for name in one):
        parts = [one[name] for one in each if name in one and math.isfinite(one[name].sigma)]
        if parts:
            value, sigma = weighted(np.array([p.value for p in parts]), np.array([p.sigma for p in parts]))
            clocks[name] = Remaining(parts[0].name, float(value), float(sigma))
        passes = [p.low_pass for p in parts if p.low_pass is not None]
        if passes:
            one = LowPass(*map(float, weighted(np.array([p.tau for p in passes]), np.array([p.sigma for p in passes]))))
            if (beside := one.left(values[f'{name}.lag'])) is not None:
                low_passes[name] = beside
    return DirectEvidence(together([m.offset for m in found if m is not None and m.offset is not None]), clocks,
                          low_passes)


def other_starts(offset: Offset | None, values: dict) -> list[dict]:
    """`values` with the time offset that the tracks show, and with none, as far as these differ from `values`."""
    tried, others = [values[TIME_OFFSET]], []
    for lag in ([offset.lag] if offset is not None and offset.shown else []) + [0.0]:
        if all(abs(lag - other) > SAME for other in tried):
            tried.append(lag)
            others.append({**values, TIME_OFFSET: lag})
    return others
