"""Decisions from measured errors: whether a filter is better than another one, and whether its sigmas can be trusted.

All tools use these decisions. Their wording is in `reports.verdict`.
"""
from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..configuration.remaining import ANGLES, TIME_OFFSET, Remaining
from .intervals import LEVEL, Difference, interval_of_share, mean_with_error, p_of_so_few, ratio
from .metrics import rms

BETTER, SAME, WORSE, CANNOT_TELL, NOT_USABLE = 'better', 'same', 'worse', 'cannot_tell', 'not_usable'
#: s without fixes: a headline reports the outages whose duration is closest to this, a tunnel in a town
HEADLINE = 30.0
#: share of the error: a smaller difference does not matter, even if it is significant. Chosen, not measured
FELT_PART = 0.03
#: m, the same as an absolute difference; smaller errors count as this one in a ratio, which is not defined at zero
FELT = 0.01
#: share of the error: two errors are the same if the confidence interval of their difference is within this. Chosen
ALIKE_PART = 0.1
#: m, the same as an absolute difference
ALIKE = 0.05
#: an interval that reaches beyond this many times the larger one of two errors is not told: it says no more than that
#: there are too few. Of 12 outages of 1 m, with one of 300 m after the change, its end would be at thousands of km
FAR = 10.0

YES, NO, TOO_CAREFUL = 'yes', 'no', 'too_careful'
#: nominal share of errors within the 95 % ellipse
NOMINAL = 0.95
#: sigmas can be trusted if the ellipse certainly contains this share of the errors: they are too small by a factor of
#: 1.6 at most
HELD = 0.7
#: ratio of errors to sigmas: the sigmas are too small if it is certainly larger than this. Chosen, not measured
TOO_LARGE = 1.2
#: the same ratio: the sigmas are too large if it is certainly smaller than this. Chosen, not measured
TOO_SMALL = 0.67
#: normalized squared errors of two components have this mean where sigmas are right
RIGHT = 2.0


@dataclass(frozen=True)
class Change:
    """One error that a user feels, of two filters at the same epochs or in the same outages.

    duration: s without fixes; None: with fixes. before, after: m, the mean of the largest errors of `count` outages, or
    the root mean square at `count` epochs. log_ratio: logarithm of the ratio of after to before, of mean squares with
    fixes; None where there are too few to say. where: in which recording. every: s between fixes, 0 for all there are.
    """

    duration: float | None
    before: float
    after: float
    count: int
    log_ratio: Difference | None
    where: str = ''
    every: float = 0.0

    def interval(self, level: float = LEVEL) -> tuple[float, float] | None:
        """The confidence interval of after minus before, m, given this value of before; None where there are too few
        to say, or to tell it (FAR)."""
        if self.log_ratio is None:
            return None
        low, high = (d / power_of(self.duration) for d in self.log_ratio.interval(level))
        return told(low, high, self.before, self.after)

    @property
    def turned(self) -> Change:
        """The change from after to before."""
        log_ratio = self.log_ratio and replace(self.log_ratio, mean=-self.log_ratio.mean)
        return replace(self, before=self.after, after=self.before, log_ratio=log_ratio)

    def sign(self, level: float = LEVEL) -> int:
        """-1 if the error has certainly become smaller, by more than FELT; 1 if it has certainly become larger; else 0.
        """
        felt = max(FELT_PART * self.before, FELT)
        if self.log_ratio is None or abs(self.after - self.before) <= felt:
            return 0
        low, high = self.log_ratio.interval(level)
        return int(low > 0) - int(high < 0)

    @property
    def smaller(self) -> bool:
        """Whether the error is smaller after, certain or not."""
        return self.after < self.before

    def alike(self, level: float = LEVEL) -> bool:
        """Whether the confidence interval excludes a difference that matters (ALIKE)."""
        interval = self.interval(level)
        return interval is not None and max(map(abs, interval)) <= max(ALIKE_PART * self.before, ALIKE)


def power_of(duration: float | None) -> int:
    """Of errors whose mean is compared: largest errors in outages as they are, those with fixes squared."""
    return 2 if duration is None else 1


def told(low: float, high: float, before: float, after: float, power: int = 1) -> tuple[float, float] | None:
    """The interval of after minus before, m, from that of the logarithm of their ratio; None where it reaches
    too far (FAR). power: all in m to this power."""
    floor = max(before, FELT**power)
    if high > np.log(FAR**power * max(floor, after) / floor):
        return None
    return floor * float(np.expm1(low)), floor * float(np.expm1(high))


def change_in_outages(duration: float, before: np.ndarray, after: np.ndarray, apart: float, **known) -> Change:
    """The change in outages. before, after: (o,) m, largest errors of the same outages, of which `apart` do not
    overlap.
    """
    return Change(duration, float(before.mean()), float(after.mean()), len(before), ratio(after, before, FELT, apart),
                  **known)


def change_with_fixes(before: np.ndarray, after: np.ndarray, **known) -> Change:
    """The change with fixes. before, after: (m,) m, errors at the same epochs."""
    return Change(None, rms(before), rms(after), len(before), ratio(after**2, before**2, FELT**2), **known)


@dataclass(frozen=True)
class Verdict:
    """Whether a filter is better than the one before.

    answer: BETTER, SAME, WORSE, CANNOT_TELL, or NOT_USABLE where the data are wrong. changes: all changes. level:
    confidence level of their intervals, such that all of them together, and those of the filters that were compared
    but not chosen, hold in 95 of 100 cases. fitted_here: whether
    the new filter was fitted to these data, which then prove no gain. why: what makes the data unusable.
    """

    answer: str
    changes: tuple[Change, ...] = ()
    level: float = LEVEL
    fitted_here: bool = False
    why: tuple[str, ...] = ()

    @property
    def gains(self) -> list[Change]:
        return [c for c in self.changes if c.sign(self.level) < 0]

    @property
    def losses(self) -> list[Change]:
        return [c for c in self.changes if c.sign(self.level) > 0]

    @property
    def shown(self) -> Change | None:
        """The change for a headline: among the changes that decided, or else among all, the outages with a duration
        closest to HEADLINE; errors with fixes come last."""
        decided = {BETTER: self.gains, WORSE: self.losses}.get(self.answer) or self.gains or self.changes
        known = [c for c in decided if c.log_ratio is not None]
        return min(known or decided, key=lambda c: np.inf if c.duration is None else abs(np.log(c.duration / HEADLINE)),
                   default=None)


def decide(changes: Iterable[Change], candidates: float = 1.0) -> Verdict:
    """BETTER if some error is certainly smaller, by an amount that matters, and none is certainly larger; WORSE in the
    opposite case; SAME if the intervals exclude any difference that matters; else CANNOT_TELL.

    candidates: number of independent filters of which this one was chosen as the best on these data
    (`intervals.effective_number`). The best of several looks better than it is, so the intervals of all of them have to
    hold together (Bonferroni).
    """
    changes = tuple(changes)
    tested = [c for c in changes if c.log_ratio is not None]
    level = 1 - (1 - LEVEL) / (max(len(tested), 1) * candidates)
    signs = {c.sign(level) for c in tested}
    if signs >= {-1, 1} or not tested:
        answer = CANNOT_TELL
    elif -1 in signs:
        answer = BETTER
    elif 1 in signs:
        answer = WORSE
    else:
        answer = SAME if all(c.alike(level) for c in tested) else CANNOT_TELL
    return Verdict(answer, changes, level)


# --- whether a params file is good enough to drive with ---

#: s: a file is not ready if a time offset in it may be off by more, at two sigma
READY_OFFSET = 0.1
#: rad, the same for a mounting angle. The lever arm of the antenna is measured by the user
READY_ANGLE = math.radians(3.0)


def unsettled(left: Iterable[Remaining]) -> list[Remaining]:
    """The remaining offsets in `left` because of which a params file is not ready to drive with."""
    most = {TIME_OFFSET: READY_OFFSET, **dict.fromkeys(ANGLES, READY_ANGLE)}
    return [one for one in left if not one.settled(most.get(one.name, math.inf))]


# --- whether sigmas can be trusted ---

@dataclass(frozen=True)
class Consistency:
    """Errors relative to sigmas. duration: s without fixes; None: with fixes. nees: (n,) normalized squared errors over
    time, or their means over each outage. within: (n,) bool, whether each outage ends within the ellipse; None with
    fixes. apart: number of outages that share no time."""

    duration: float | None
    nees: np.ndarray
    within: np.ndarray | None = None
    apart: float = np.inf


@dataclass(frozen=True)
class EllipseCount:
    """Outages of `duration` s at whose end the 95 % ellipse contained the truth: held of count. low, high: 95 %
    interval of the share. p: probability of so few with right sigmas."""

    duration: float
    held: int
    count: int
    low: float
    high: float
    p: float


@dataclass(frozen=True)
class ErrorOverSigma:
    """Ratio of the errors to the sigmas over time. duration: s without fixes; None: with fixes. low, high: 95 %
    interval of the ratio; least: its lower bound, adjusted for the number of tests."""

    duration: float | None
    value: float
    low: float
    high: float
    least: float


@dataclass(frozen=True)
class Trust:
    """Whether sigmas can be trusted. answer: YES, NO, TOO_CAREFUL, or CANNOT_TELL."""

    answer: str
    held: tuple[EllipseCount, ...] = ()
    scales: tuple[ErrorOverSigma, ...] = ()

    @property
    def scale(self) -> ErrorOverSigma | None:
        """The scale that is the strongest evidence against the sigmas; if they are too small, None unless the scale
        proves it."""
        if self.answer == NO:
            return max((s for s in self.scales if s.least > TOO_LARGE), key=lambda s: s.low, default=None)
        if self.answer == TOO_CAREFUL:
            return min(_without_fixes(self.scales), key=lambda s: s.high)
        return max(self.scales, key=lambda s: s.low, default=None)

    @property
    def shown(self) -> EllipseCount | None:
        """The outages for a headline: if the sigmas are too small, those that show it best, else those with most data.
        """
        return min(self.held, key=lambda h: h.p) if self.answer == NO and self.held else \
            max(self.held, key=lambda h: (h.low, h.duration), default=None)


def trust_in_sigmas(said: Sequence[Consistency]) -> Trust:
    """Whether sigmas can be trusted, from counts with binomial intervals and from normalized errors over time.

    NO if a count, or the errors over time, contradict the sigmas significantly, adjusted for the number of tests. YES
    if an ellipse certainly contains the truth in a share of HELD at least, and there is no such contradiction.
    """
    said = [one for one in said if len(one.nees)]
    tests = max(sum(1 + (one.within is not None) for one in said), 1)
    held, scales = [], []
    for one in said:
        if one.within is not None:
            apart = min(one.apart, len(one.within))
            inside = float(one.within.mean()) * apart
            held.append(EllipseCount(one.duration, int(one.within.sum()), len(one.within),
                                     *interval_of_share(inside, apart),
                                     p_of_so_few(inside, apart, NOMINAL)))
        mean = mean_with_error(one.nees, one.apart)
        if mean is not None:
            ends = (mean.mean, *mean.interval(), mean.interval(1 - (1 - LEVEL) / tests)[0])
            scales.append(ErrorOverSigma(one.duration, *(float(np.sqrt(max(value, 0.0) / RIGHT)) for value in ends)))
    return Trust(_whether(held, scales, (1 - LEVEL) / tests), tuple(held), tuple(scales))


def _without_fixes(scales: Sequence[ErrorOverSigma]) -> Sequence[ErrorOverSigma]:
    """The scales without fixes, if there are any: with fixes, the noise of the truth hides the filter's own sigmas."""
    return [s for s in scales if s.duration is not None] or scales


def _whether(held: Sequence[EllipseCount], scales: Sequence[ErrorOverSigma], chance: float) -> str:
    if any(h.p < chance for h in held) or any(s.least > TOO_LARGE for s in scales):
        return NO
    if scales and all(s.high < TOO_SMALL for s in _without_fixes(scales)):
        return TOO_CAREFUL
    doubtful = any(h.p < 1 - LEVEL for h in held) or any(s.low > TOO_LARGE for s in scales)
    return YES if any(h.low >= HELD for h in held) and not doubtful else CANNOT_TELL
