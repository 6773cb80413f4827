"""Sequential test by betting: which of two filters predicts the fixes better, without using their covariances.

Both predict a position, p the present filter and q the other one, before a measurement m that neither has seen. With
d = |q - p|, the component of m along the line from p to q, counted from the middle,

    y = (|m - p|^2 - |m - q|^2) / (2 d),

is the noise of the measurement minus d / 2 where the present filter is right, plus d / 2 where the other one is. It is
scaled and clipped,

    x = (y - m) / B,    -1 <= x <= 1,    m = max(MARGIN d, WORTH)

with B the usual distance of a measurement from the nearer prediction. Where the other filter is not better by m at
least, E x <= 0 for any distribution of the errors, and a wealth that stakes the share l, so that it is multiplied by
1 + l x, does not grow in the mean: it ever reaches 1 / a with a probability of at most a (J. Ville, "Etude critique de
la notion de collectif", 1939; I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by betting",
J. Royal Statistical Society B 86, 2024). d and B are known before the measurement, so l may depend on them: it is
proportional to the mean of x where the other filter is right, (d / 2 - m) / B. Where that is not positive, nothing is
staked.

Where d is small against B, the side on which m lies is mostly that of an error that both predictions have in common.
Such errors last for a minute on some roads, and with them a row of bets is lost, or won, by chance. `Bets(CLEAR)`
stakes only where d is large enough for the middle to be clear of them.
"""
from __future__ import annotations

import math

MARGIN = 0.05  # share of d by which the other filter has to be nearer: less is not worth a change
WORTH = 0.005  # m by which it has to be nearer: predictions that are less than a centimetre apart decide nothing
LARGEST_BET = 0.9  # largest share of the wealth staked: a single measurement must not take all of it
#: stake as a share of the mean of x where the other filter is right. One over the variance of x is best: normal errors
#: in a plane with the mean distance B have a sigma of 0.8 B along a line
PART = 1.56
#: usual distances B by which the predictions have to be apart for the middle between them to be clear of common errors:
#: these have a sigma of 0.8 B along the line (PART), and d / 2 is as much then
CLEAR = 1.6
USUAL = 30.0  # measurements over which the usual distance is averaged; nothing is staked on the first


class Bets:
    """pro: logarithm of the wealth staked on the other filter, con: on the present one. clear: usual distances by which
    the predictions have to be apart for a stake."""

    def __init__(self, clear: float = 0.0):
        self._clear = clear
        self.pro = self.con = 0.0
        self._usual, self._count = 0.0, 0

    def take(self, present: tuple[float, float], other: tuple[float, float]) -> None:
        """One more measurement. present, other: innovations of the two filters, north and east, m."""
        a, b = math.hypot(*present), math.hypot(*other)
        apart, usual = math.hypot(present[0] - other[0], present[1] - other[1]), self._usual
        self._count += 1
        self._usual += (min(a, b) - usual) / min(self._count, USUAL)
        least = max(MARGIN * apart, WORTH)
        if not (usual > 0.0 and 0.5 * apart > least and apart >= self._clear * usual):
            return
        y, bet = (a * a - b * b) / (2.0 * apart), min(PART * (0.5 * apart - least) / usual, LARGEST_BET)
        self.pro += math.log1p(bet * _bounded((y - least) / usual))
        self.con += math.log1p(bet * _bounded((-y - least) / usual))

    def begin_anew(self) -> None:
        """Reset the wealth, not the usual distance."""
        self.pro = self.con = 0.0


def _bounded(x: float) -> float:
    return min(max(x, -1.0), 1.0)
