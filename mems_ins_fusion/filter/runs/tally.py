"""What became of the measurements of one input: how many were used, why others were not, and how well they fitted."""
from __future__ import annotations

import math
from collections import deque

#: measurements whose misfit is averaged
RECENT = 100
#: refused ones in a row that tell of more than chance
STEADY = 3
#: s, for which those of a fast sensor have to go on
STEADY_TIME = 1.0
#: what was refused longer ago does not tell of now, s
FORGOTTEN = 5.0


class Tally:
    """Counts of one input. Stamps are ns.

    used: how many. refused: how many by reason, in words. row: how many in a row were refused, from `since` to `last`,
    the last one for `reason`.
    """

    def __init__(self):
        self.used, self.refused = 0, {}
        self.row, self.since, self.last, self.reason = 0, 0, 0, ''
        self._misfit: deque[float] = deque(maxlen=RECENT)

    def use(self, misfit: float) -> None:
        """One was used. misfit: its normalized innovation squared for each component."""
        self.used, self.row = self.used + 1, 0
        self._misfit.append(misfit)

    def refuse(self, stamp: int, reason: str, misfit: float = math.nan) -> None:
        """One was refused, for a reason that names no numbers."""
        self.refused[reason] = self.refused.get(reason, 0) + 1
        self.since = stamp if self.row == 0 else self.since
        self.row, self.last, self.reason = self.row + 1, stamp, reason
        if math.isfinite(misfit):
            self._misfit.append(misfit)

    @property
    def misfit(self) -> float:
        """Innovations of the latest over what the filter and the messages claim for them; NaN before the first."""
        return math.sqrt(sum(self._misfit) / len(self._misfit)) if self._misfit else math.nan

    def steadily(self, now: int, patient: bool) -> bool:
        """Whether all that has come of late was refused. patient: of a fast sensor, three in a row are an instant."""
        return (self.row >= STEADY and (now - self.last) * 1e-9 < FORGOTTEN
                and (not patient or (self.last - self.since) * 1e-9 >= STEADY_TIME))
