"""Counts of one input: how many measurements were used, why others were refused, and how large the innovations were."""
from __future__ import annotations

import math
import re
from collections import deque

#: numbers in a reason, which are left out where equal reasons are counted together
_NUMBER = re.compile(r'[-+]?\b(?:nan|inf|\d[\d.]*(?:e[-+]?\d+)?)\b')
NIS_MEMORY = 100  # number of measurements over which the NIS is averaged
STEADY = 3  # number of measurements refused in a row from which on this is reported
STEADY_TIME = 1.0  # s: and of a fast sensor these must have come for this long
REPORTED = 5.0  # s for which a refusal, or a faulty IMU sample, is reported. Chosen, not measured


class Tally:
    """Counts of one input. Stamps are ns.

    used: number of measurements used. refused: number of measurements refused, by reason without its numbers. row:
    number refused in a row until now, from `since` to `last`; `reason`: why the last one was.
    """

    def __init__(self):
        self.used, self.refused = 0, {}
        self.row, self.since, self.last, self.reason = 0, 0, 0, ''
        self._misfit: deque[float] = deque(maxlen=NIS_MEMORY)

    def use(self, misfit: float) -> None:
        """Count a measurement that was used. misfit: its NIS over the number of components."""
        self.used, self.row = self.used + 1, 0
        self._misfit.append(misfit)

    def refuse(self, stamp: int, reason: str, misfit: float = math.nan) -> None:
        """Count a refused measurement."""
        counted = _NUMBER.sub('..', reason)
        self.refused[counted] = self.refused.get(counted, 0) + 1
        self.since = stamp if self.row == 0 else self.since
        self.row, self.last, self.reason = self.row + 1, stamp, reason
        if math.isfinite(misfit):
            self._misfit.append(misfit)

    @property
    def misfit(self) -> float:
        """Root mean square of the latest normalized innovations; 1 is expected, NaN before the first."""
        return math.sqrt(sum(self._misfit) / len(self._misfit)) if self._misfit else math.nan

    def steadily(self, now: int, patient: bool) -> bool:
        """Whether all recent measurements were refused. patient: require STEADY_TIME, for fast sensors."""
        return (self.row >= STEADY and (now - self.last) * 1e-9 < REPORTED
                and (not patient or (self.last - self.since) * 1e-9 >= STEADY_TIME))
