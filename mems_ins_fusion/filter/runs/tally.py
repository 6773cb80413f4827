"""Counts of one input: how many measurements were used, why others were refused, and how large the innovations were."""
from __future__ import annotations

import math
from collections import deque

RECENT = 100  # measurements whose NIS is averaged
STEADY = 3  # measurements refused in a row that are reported
STEADY_TIME = 1.0  # s that these have to last for a fast sensor
FORGOTTEN = 5.0  # s after the last refusal for which it is reported


class Tally:
    """Counts of one input. Stamps are ns.

    used: how many. refused: how many, by reason. row: refused in a row at present, from `since` to `last`, the last one
    for `reason`.
    """

    def __init__(self):
        self.used, self.refused = 0, {}
        self.row, self.since, self.last, self.reason = 0, 0, 0, ''
        self._misfit: deque[float] = deque(maxlen=RECENT)

    def use(self, misfit: float) -> None:
        """One was used. misfit: its NIS over the number of components."""
        self.used, self.row = self.used + 1, 0
        self._misfit.append(misfit)

    def refuse(self, stamp: int, reason: str, misfit: float = math.nan) -> None:
        """One was refused. reason: without numbers, so that equal reasons are counted together."""
        self.refused[reason] = self.refused.get(reason, 0) + 1
        self.since = stamp if self.row == 0 else self.since
        self.row, self.last, self.reason = self.row + 1, stamp, reason
        if math.isfinite(misfit):
            self._misfit.append(misfit)

    @property
    def misfit(self) -> float:
        """Root mean square normalized innovation of the latest; 1 is expected, NaN before the first."""
        return math.sqrt(sum(self._misfit) / len(self._misfit)) if self._misfit else math.nan

    def steadily(self, now: int, patient: bool) -> bool:
        """Whether all recent measurements were refused. patient: require STEADY_TIME, for fast sensors."""
        return (self.row >= STEADY and (now - self.last) * 1e-9 < FORGOTTEN
                and (not patient or (self.last - self.since) * 1e-9 >= STEADY_TIME))
