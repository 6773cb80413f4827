"""Which of two filters predicts better, by a sequential test that rests on no sigma of theirs.

Both predict the same place, and a measurement m that neither has seen comes after. p: the prediction of the present
filter, q: of the other one, d = |q - p|. How far the measurement is beyond the middle between them, towards the other,

    y = (|m - p|^2 - |m - q|^2) / (2 d),

is the noise of the measurement along that line, less d / 2 where the present filter is right, and d / 2 more where the
other one is. As a bounded number

    x = (y - MARGIN d) / B,    -1 <= x <= 1,

with B the usual distance of a measurement from the nearer of the two. Where the other filter is not better, by MARGIN
of the way at least, E x <= 0, whatever the errors are distributed like, and a wealth that bets the part l of it, times
1 + l x, does not grow in the mean: it comes to 1 / a with a probability of a at most, whenever one looks (J. Ville,
"Etude critique de la notion de collectif", 1939; I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random
variables by betting", J. Royal Statistical Society B 86, 2024). d and B are known before the measurement, so that l may
depend on them: of normal errors with sigma B the logarithm grows fastest with l about d / B, while predictions that are
the same say nothing and nothing is bet.
"""
from __future__ import annotations

import math

#: part of the difference that the other filter has to be nearer by: less is not worth a change
MARGIN = 0.05
#: of the wealth that is bet at most: a single measurement must not take it all
LARGEST_BET = 0.9
#: of d / B, that is bet: a little less than is best for small d, as x is bounded
PART = 0.7
#: measurements that make up the usual distance: the first ones begin with less, and nothing is bet on the first
USUAL = 30.0


class Bets:
    """On one kind of predictions. pro: logarithm of the wealth for the other filter, con: against it."""

    def __init__(self):
        self.pro = self.con = 0.0
        self._usual, self._count = 0.0, 0

    def take(self, present: tuple[float, float], other: tuple[float, float]) -> None:
        """One more measurement: how far the two predictions were from it, north and east, m."""
        a, b = math.hypot(*present), math.hypot(*other)
        apart, usual = math.hypot(present[0] - other[0], present[1] - other[1]), self._usual
        self._count += 1
        self._usual += (min(a, b) - usual) / min(self._count, USUAL)
        if not (usual > 0.0 and apart > 0.0):
            return
        y, least, bet = (a * a - b * b) / (2.0 * apart), MARGIN * apart, min(PART * apart / usual, LARGEST_BET)
        self.pro += math.log1p(bet * _bounded((y - least) / usual))
        self.con += math.log1p(bet * _bounded((-y - least) / usual))

    def begin_anew(self) -> None:
        """Forget what was won and lost, not how large errors usually are."""
        self.pro = self.con = 0.0


def _bounded(x: float) -> float:
    return min(max(x, -1.0), 1.0)
