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

Errors that last from one measurement to the next also break the condition that E x <= 0 whatever came before. So what
is bet on is the mean of a *block* of measurements, each with the weight d. A block is several times as long as errors
along the line have lasted until then, so that one says next to nothing about the next; where they do not last, each
measurement is a block. Its length is known before it begins, as the rest is. Bets against the other filter are on each
measurement: one that has become wrong has to go soon, and one that goes by chance is found again.
"""
from __future__ import annotations

import math

import numpy as np

MARGIN = 0.05  # share of d by which the other filter has to be nearer: less is not worth a change
WORTH = 0.005  # m by which it has to be nearer: predictions that are less than a centimetre apart decide nothing
LARGEST_BET = 0.9  # largest share of the wealth staked: a single measurement must not take all of it
#: stake as a share of the mean of x where the other filter is right. One over the variance of x is best: normal errors
#: in a plane with the mean distance B have a sigma of 0.8 B along a line
PART = 1.56
#: usual distances B by which the predictions have to be apart for the middle between them to be clear of common errors:
#: these have a sigma of 0.8 B along the line (PART), and d / 2 is as much then
CLEAR = 1.6
USUAL = 30  # measurements over which the usual distance is averaged; nothing is staked on the first
#: length of a block, over the time for which errors last (the sum of their correlations, both ways): means of
#: neighbouring blocks have a correlation of a twelfth then where errors decay exponentially, of an eighth with 2
APART_BY = 3.0
#: correlation of errors at which they count as lasting: a minute of outages of 1 s tells it from none by 1.5 sigma
LASTING = 0.2
FEWEST = 8  # errors that show whether they last: a correlation of fewer is chance
KEPT = 300  # measurements kept, which tell of errors that last for a tenth of that


class Bets:
    """pro: logarithm of the wealth staked on the other filter, con: on the present one. clear: usual distances by which
    the predictions have to be apart for a stake. first: number of measurements before the first stake on the other one,
    which tell for how long errors last (of `see`, too); 0: errors are taken not to last, each measurement is a block.
    """

    def __init__(self, clear: float = 0.0, first: int = 0):
        self._clear, self._first = clear, first
        self.pro = self.con = 0.0
        #: distances of the last measurements from p and from q along the line between these, up to `_end`
        self._rows, self._end = np.empty((2 * KEPT, 2)), 0
        self._block: list[tuple[float, float]] = []  # d and y of what is staked on in the present block
        self._left, self._usual = 0, 0.0  # measurements that are left of it, and B when it began
        self._near, self._count = 0.0, 0  # B, and how many have come

    def take(self, present: tuple[float, float], other: tuple[float, float]) -> None:
        """One more measurement. present, other: innovations of the two filters, north and east, m."""
        apart, of_present, of_other = _along(present, other)
        if self._near > 0.0 and _worth_a_bet(apart) and apart >= self._clear * self._near:
            y = 0.5 * (of_present + of_other)
            self.con += _won(apart, -y, self._near)
            if self._count >= self._first:
                if self._left == 0:
                    self._left = self._lasting()
                    self._usual = self._near
                self._block.append((apart, y))
        self.see(present, other)
        if self._left > 0:
            self._left -= 1
            if self._left == 0:
                block, self._block = np.array(self._block).T, []
                weight = block[0] / block[0].sum()
                self.pro += _won(*(block @ weight).tolist(), self._usual)

    def see(self, present: tuple[float, float], other: tuple[float, float]) -> None:
        """What is known of the errors with one more measurement, on which nothing is staked."""
        if self._end == len(self._rows):
            self._rows[:KEPT], self._end = self._rows[KEPT:].copy(), KEPT
        self._rows[self._end] = _along(present, other)[1:]
        self._end += 1
        self._count += 1
        self._near += (min(math.hypot(*present), math.hypot(*other)) - self._near) / min(self._count, USUAL)

    def begin_anew(self) -> None:
        """Reset the wealth, not what is known of the errors."""
        self.pro = self.con = 0.0
        self._block, self._left = [], 0

    def _lasting(self) -> int:
        """Length of a block, so that one says next to nothing about the next; 1 where errors do not last."""
        seen, n = self._rows[max(self._end - KEPT, 0):self._end], min(self._count, KEPT)
        if self._first == 0 or n < FEWEST:
            return 1
        present, other = seen.T
        better = present if present @ present <= other @ other else other
        errors = np.minimum(np.maximum(better, -self._near), self._near)
        errors -= errors.sum() / n
        variance, total = float(errors @ errors), 1.0
        for lag in range(1, n // 2):
            covariance = float(errors[lag:] @ errors[:-lag])
            if covariance <= LASTING * variance:
                break
            total += 2.0 * covariance / variance
        return math.ceil(APART_BY * total) if total > 1.0 else 1


def _along(present: tuple[float, float], other: tuple[float, float]) -> tuple[float, float, float]:
    """How far the predictions are apart, and the measurement from either along the line between them."""
    north, east = present[0] - other[0], present[1] - other[1]
    apart = math.hypot(north, east)
    if apart == 0.0:
        return 0.0, 0.0, 0.0
    return apart, *((north * one[0] + east * one[1]) / apart for one in (present, other))


def _won(apart: float, y: float, usual: float) -> float:
    """Logarithm of the factor on the wealth by a bet on the filter to whose side y, m, is positive."""
    least = max(MARGIN * apart, WORTH)
    return math.log1p(min(PART * (0.5 * apart - least) / usual, LARGEST_BET) * _bounded((y - least) / usual))


def _worth_a_bet(apart: float) -> bool:
    """Whether predictions that are `apart`, m, decide anything."""
    return 0.5 * apart > max(MARGIN * apart, WORTH)


def _bounded(x: float) -> float:
    return min(max(x, -1.0), 1.0)
