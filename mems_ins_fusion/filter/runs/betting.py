"""Sequential test by betting: which of two filters predicts the fixes better, without using their covariances.

Both filters predict a position, p the present filter and q the other one, before a measurement z that neither has used.
With d = |q - p|, the component of z along the line from p to q, counted from the middle,

    y = (|z - p|^2 - |z - q|^2) / (2 d),

is the noise of the measurement minus d / 2 if the present filter is right, and plus d / 2 if the other one is. It is
scaled and clipped,

    x = (y - c) / B,    -1 <= x <= 1,    c = max(MARGIN d, WORTH),

where B is the mean distance of a measurement from the nearer prediction. If the other filter is not better by at least
c, E x <= 0 for any distribution of the errors. A wealth of 1, of which the share l is staked on each x, is multiplied
by 1 + l x each time. Its mean does not grow then, and the probability that it ever reaches 1 / a is at most a
(J. Ville, "Etude critique de la notion de collectif", 1939; I. Waudby-Smith and A. Ramdas, "Estimating means of bounded
random variables by betting", J. Royal Statistical Society B 86, 2024). d and B are known before the measurement, so l
may depend on them: it is proportional to the mean of x if the other filter is right, (d / 2 - c) / B. If this is not
positive, nothing is staked.

If d is small compared with B, the sign of y is mostly that of an error that both predictions have in common. On some
roads such errors last for a minute, and a series of bets is won or lost by chance. `Bets(CLEAR)` stakes only if d is
large compared with the common errors.

Errors that are correlated from one measurement to the next also violate the condition that E x <= 0 given the past.
Bets on the other filter are therefore on the mean of a *block* of measurements with the weights d. A block is several
times as long as the correlation time of the errors along the line, as seen until then, so that successive blocks are
nearly independent; without correlation each measurement is a block. The length of a block is fixed before it begins.
Bets on the present filter are on single measurements: another filter that has become wrong has to be dropped soon, and
one that is dropped by chance is found again.
"""
from __future__ import annotations

import math

import numpy as np

#: share of d, in c: the other filter has to be nearer to the measurements by this share of d. Chosen: a smaller
#: improvement is not worth a change
MARGIN = 0.05
WORTH = 0.005  # m, in c: filters whose predictions are less than a centimetre apart are not distinguished
LARGEST_BET = 0.9  # largest share of the wealth that is staked: a single measurement must not take all of it
#: stake divided by the mean of x if the other filter is right. The best factor is one over the variance of x: normal
#: errors in a plane with the mean distance B have a sigma of 0.8 B along a line, and 1 / 0.8^2 = 1.56
PART = 1.56
#: smallest d, in units of B, for `Bets(CLEAR)`: d / 2 is then 0.8 B, one sigma of the common errors along the line
CLEAR = 1.6
USUAL = 30  # number of measurements over which B is averaged; nothing is staked on the first measurement
#: length of a block over the correlation time of the errors (the sum of their correlations at positive and negative
#: lags). With 3, means of successive blocks have a correlation of 1/12 if errors decay exponentially, with 2 of 1/8
APART_BY = 3.0
#: correlation of errors below which the sum of correlations ends: in 60 errors it differs from none by 1.5 sigma
LASTING_CORRELATION = 0.2
FEWEST_ERRORS = 8  # number of errors below which no correlation is estimated: it would be chance
KEPT_ERRORS = 300  # number of measurements kept: enough for errors that are correlated over a tenth of this


class Bets:
    """Bets on two filters.

    pro: logarithm of the wealth staked on the other filter, con: on the present one. clear: smallest distance of the
    predictions for a stake, in units of B. first: number of measurements before the first stake on the other filter
    (those of `see` count); they show the correlation time of the errors. 0: no correlation is assumed, and each
    measurement is a block.
    """

    def __init__(self, clear: float = 0.0, first: int = 0):
        self._clear, self._first = clear, first
        self.pro = self.con = 0.0
        #: components along the line from p to q of the last innovations of both filters, up to `_end`
        self._rows, self._end = np.empty((2 * KEPT_ERRORS, 2)), 0
        self._block: list[tuple[float, float]] = []  # d and y of the measurements of the present block that are bet on
        self._left, self._usual = 0, 0.0  # number of measurements still to come in the block, and B when it began
        self._near, self._count = 0.0, 0  # B, and number of measurements so far

    def take(self, present: tuple[float, float], other: tuple[float, float]) -> None:
        """Bet on one more measurement. present, other: innovations of the two filters, north and east, m."""
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
        """Take one more measurement into the statistics of the errors, without a bet; arguments as for `take`."""
        if self._end == len(self._rows):
            self._rows[:KEPT_ERRORS], self._end = self._rows[KEPT_ERRORS:].copy(), KEPT_ERRORS
        self._rows[self._end] = _along(present, other)[1:]
        self._end += 1
        self._count += 1
        self._near += (min(math.hypot(*present), math.hypot(*other)) - self._near) / min(self._count, USUAL)

    @property
    def usual_distance(self) -> float:
        """Mean distance of a measurement from the nearer one of both predictions, m (B above); 0 before the first."""
        return self._near

    def begin_anew(self) -> None:
        """Reset the wealth; the statistics of the errors stay."""
        self.pro = self.con = 0.0
        self._block, self._left = [], 0

    def _lasting(self) -> int:
        """Length of the next block: APART_BY times the correlation time of the errors; 1 without correlation."""
        seen, n = self._rows[max(self._end - KEPT_ERRORS, 0):self._end], min(self._count, KEPT_ERRORS)
        if self._first == 0 or n < FEWEST_ERRORS:
            return 1
        present, other = seen.T
        better = present if present @ present <= other @ other else other
        errors = np.minimum(np.maximum(better, -self._near), self._near)
        errors -= errors.sum() / n
        variance, total = float(errors @ errors), 1.0
        for lag in range(1, n // 2):
            covariance = float(errors[lag:] @ errors[:-lag])
            if covariance <= LASTING_CORRELATION * variance:
                break
            total += 2.0 * covariance / variance
        return math.ceil(APART_BY * total) if total > 1.0 else 1


def _along(present: tuple[float, float], other: tuple[float, float]) -> tuple[float, float, float]:
    """Distance of the two predictions, and the components of both innovations along the line between them, m."""
    north, east = present[0] - other[0], present[1] - other[1]
    apart = math.hypot(north, east)
    if apart == 0.0:
        return 0.0, 0.0, 0.0
    return apart, *((north * one[0] + east * one[1]) / apart for one in (present, other))


def _won(apart: float, y: float, usual: float) -> float:
    """Logarithm of the factor on the wealth by a bet that y, m, is positive. apart: d, m. usual: B, m."""
    least = max(MARGIN * apart, WORTH)
    return math.log1p(min(PART * (0.5 * apart - least) / usual, LARGEST_BET) * _bounded((y - least) / usual))


def _worth_a_bet(apart: float) -> bool:
    """Whether predictions at the distance `apart`, m, differ by enough for a bet."""
    return 0.5 * apart > max(MARGIN * apart, WORTH)


def _bounded(x: float) -> float:
    return min(max(x, -1.0), 1.0)
