"""A recording given to the diagnosis while driving chunk by chunk, as by a live node."""
from __future__ import annotations

from collections.abc import Callable, Sequence

from ..filter.measurements.registry import aiding
from ..filter.runs.changing import Dropped
from ..samples import Recording
from .gathering import chunks
from .online import Find, Online, findings_in_recording
from .quantity import EarlierFinding, FilterFindings, FindingState


class RecordingWatch:
    """A recording given to `Online` chunk by chunk. said: each finding at the time at which it changed.

    progress: called from time to time with the part that is done; an exception ends everything. find, look, kept: as
    for `Online`.
    """

    def __init__(self, recording: Recording, values: dict, progress: Callable[[float], None] = lambda part: None,
                 find: Find | None = None, look: Find | None = None, kept: Sequence[EarlierFinding] = ()):
        self.said: list[FindingState] = []
        self._progress, self._done, self._told = progress, 0.0, {}
        self._work = Online(values, find or (lambda part, given: findings_in_recording(
            part, given, lambda _, what: progress(self._done))), look, kept)
        self._chunks, self._span = chunks(recording, aiding(values)), recording.imu.stamp[[0, -1]].tolist()

    @property
    def wanted(self) -> FilterFindings:
        """The findings for the filters."""
        return self._work.wanted

    @property
    def trials(self) -> int:
        """Number of findings that have been on trial."""
        return self._work.begun

    def take(self, dropped: Sequence[Dropped] = ()) -> FilterFindings | None:
        """The findings for the filters after the next chunk, in which it has `dropped` findings; None after the last
        one."""
        self._progress(self._done)
        chunk = next(self._chunks, None)
        if chunk is None:
            return None
        begin, end = self._span
        self._done = (int(chunk.imu.stamp[-1]) - begin) / max(end - begin, 1)
        for quantity in self._work.take(chunk, dropped):
            if self._told.get(quantity.name) != quantity.said and not quantity.is_as_given:
                self.said.append(quantity)
            self._told[quantity.name] = quantity.said
        return self.wanted


def live_messages(recording: Recording, values: dict, progress: Callable[[float], None] = lambda part: None
                  ) -> list[FindingState]:
    """The messages of a live node for `recording` that does not apply findings."""
    watch = RecordingWatch(recording, values, progress)
    while watch.take() is not None:
        pass
    return watch.said
