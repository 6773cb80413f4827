"""What recordings show without a filter, and so other values to start a search from than those of the parameters: one
that is wrong must be left again."""
from __future__ import annotations

from collections.abc import Sequence

from ..configuration.mounting import estimate_mounting
from ..configuration.offset import Offset, together
from ..samples import Recording

#: s: time offsets that are closer than this lead to the same maximum
SAME = 0.05
TIME_OFFSET = 'gnss.time_offset'


def shown_by_track(recordings: Sequence[Recording]) -> Offset | None:
    """Time offset, arm and smoothing that the tracks between fixes show together; None where they show nothing."""
    found = [estimate_mounting(recording.imu, recording.gnss) for recording in recordings]
    return together([mounting.offset for mounting in found if mounting is not None and mounting.offset is not None])


def other_starts(offset: Offset | None, values: dict) -> list[dict]:
    """`values` with the time offset that the tracks show, and with none at all, where that is another start than
    `values`."""
    tried, others = [values[TIME_OFFSET]], []
    for lag in ([offset.lag] if offset is not None and offset.shown else []) + [0.0]:
        if all(abs(lag - other) > SAME for other in tried):
            tried.append(lag)
            others.append({**values, TIME_OFFSET: lag})
    return others
