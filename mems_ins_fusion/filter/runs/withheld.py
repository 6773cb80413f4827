"""Ratio of the realised to the expected variance of position errors without fixes: a factor for the trust horizon.

At the begin of a PERIOD the newest state of the filter is copied, and the copy is continued without fixes, in steps of
several samples (coarse.py). After each of AGES its position is compared with that of the filter. Both have the same
past, so their difference has the covariance P_copy - P_filter, and errors that both have, such as slow errors of the
receiver, are not part of it. The normalized square of the difference is one deviation for a scale (trust/scale.py). A
scale above 1 is used as it is, one below 1 with an allowance for its uncertainty. The filter itself does not use the
ratio: its gains depend on ratios of variances, and the difference does not show which part of P is wrong.
"""
from __future__ import annotations

import math

import numpy as np

from ..config import FilterConfig
from ..memory import (
    Event,
    Head,
    Nav,
    Sample,
    covariance,
    event_at,
    newest_row,
    sample_at,
    time_of,
    variance_factor,
)
from ..trust.scale import PRIOR, Scale, learn_changes
from .coarse import follow
from .newest import NewestState
from .odometry import navigation_solution

PERIOD = 30.0  # s, duration of a copy: that of most outages in a town
COPIES_AT_ONCE = 6  # number of copies at the begin without a pause: three minutes show the errors of most drives
#: number of periods from the begin of one copy to that of the next after that. A copy takes 18 % of the filter's time;
#: so all copies take 5 %, and a change of the road or the sensors is noticed within two minutes
PERIODS_APART = 4
#: s without fixes after which a copy is compared. The first difference is mostly that of velocity errors, the second
#: that of errors of heading, tilt and gyroscopes
AGES = (10.0, PERIOD)
#: exponent of the likelihood of one deviation: those of one copy are correlated and together count as one
WEIGHT = 1.0 / len(AGES)
#: largest variance of the filter over that of the copy, along an axis, at which they are compared: with a larger one,
#: for example in an outage, both have nearly the same error
LARGEST_SHARE = 0.5
#: m, smallest displacement during the copy: errors at a standstill are smaller than those of a drive
DRIVEN = 20.0
#: s, longest time without samples before a comparison. Chosen, not measured
LONGEST_UNSAMPLED = 1.0
#: s, between samples, for the first one, which has no interval: above zero, so that a replay goes on
SHORTEST_INTERVAL = 1e-6


class Withheld:
    """Copies of a filter with `config` from which fixes are withheld, one after the other.

    due: s, time of a sample before which `before` has to be called.
    """

    def __init__(self, config: FilterConfig):
        self._layout, self._open_loop = config.layout, config.open_loop
        self._rows = np.array(config.layout.rows, dtype=float)
        self._scale = np.zeros(Scale.CHANGING_SIZE)
        # two states, two between samples
        self._small = NewestState(config, 4, 2, config.event_capacity)
        self._withheld = config.from_satellites
        self._count = 0  # of copies so far
        self._place = 0.0, 0.0  # rad, where the copy began
        self._followed = -1  # number of the sample up to which the copy has followed; -1: there is no copy
        # s: begin of the PERIOD of the copy, or of the next one where there is none; and when the copy is compared
        self._slot = self._age = self.due = math.inf

    @property
    def realised(self) -> float:
        """Realised over expected variance of the errors without fixes: the estimate, and below 1 with an allowance for
        its uncertainty.

        If the logarithm of the variance of a normal error in a plane is itself normal with the variance v, the error
        exceeds its 95 % limit as often as with a logarithm that is larger by v (to second order; along a line 0.7 v).
        """
        level, unknown = self._scale[Scale.LOG], max(PRIOR - self._scale[Scale.REDUCED], 0.0)
        return math.exp(max(level, min(level + unknown, 0.0)))

    def begin(self, time: float) -> None:
        """Begin with a new filter whose newest sample is at `time`, s. The estimate is kept."""
        self._followed = -1
        self._slot = self.due = (math.floor(time / PERIOD) + 1.0) * PERIOD

    def stop(self) -> None:
        """Make no more copies."""
        self._followed = -1
        self._slot = self.due = math.inf

    def before(self, time: float, memory: np.ndarray) -> None:
        """Do what is due before the sample at `time`, s, of the filter with `memory`."""
        if self._followed >= 0:
            self._go_on(time, memory)
        if self._followed < 0 and time >= self._slot:
            self._copy(time, memory)
        if self._followed < 0:
            self.due = self._slot
        else:
            self._age = next(self._slot + age for age in AGES if self._slot + age > time)
            self.due = min(self._age, time + _held(memory))

    def _copy(self, time: float, memory: np.ndarray) -> None:
        self._small.take(memory)
        self._followed, self._place = int(memory[Head.SAMPLES]), self._latitude_longitude(newest_row(memory))
        self._count += 1
        self._slot = math.floor(time / PERIOD) * PERIOD

    def _go_on(self, time: float, memory: np.ndarray) -> None:
        """Have the copy follow the filter with `memory`, and compare both where that is due."""
        complete = follow(self._small.memory, memory, self._followed, self._withheld)
        if complete and time >= self._age:
            self._compare(memory)
        if complete and time < self._slot + AGES[-1]:
            self._followed = int(memory[Head.SAMPLES])
        else:
            self._followed = -1
            self._slot += PERIOD * (1 if self._count < COPIES_AT_ONCE else PERIODS_APART)

    def _compare(self, memory: np.ndarray) -> None:
        """Learn from the difference between the copy and the filter with `memory`, at the time that is due."""
        row, copy = newest_row(memory), newest_row(self._small.memory)
        place, metre = self._latitude_longitude(row), row[[Nav.NORTH_SCALE, Nav.EAST_SCALE]]
        driven = np.subtract(place, self._place) / metre
        if row[Nav.TIME] < self._age - LONGEST_UNSAMPLED or math.hypot(*driven) < DRIVEN:
            return
        without, with_fixes = (variance_factor(one, 0) * covariance(one, self._layout)[:2, :2] for one in (copy, row))
        variance, axes = np.linalg.eigh(without)
        own = np.einsum('ij,ik,kj->j', axes, with_fixes, axes)
        shows = own < LARGEST_SHARE * variance
        if shows.any():
            off = np.subtract(self._latitude_longitude(copy), place) / metre @ axes
            squared = float(np.mean(off[shows]**2 / (variance - own)[shows]))
            learn_changes(self._scale, 0, float(row[Nav.TIME]), squared, 1.0, 0.0, int(shows.sum()), WEIGHT)

    def warm_up(self, memory: np.ndarray) -> None:
        """Compile or load what is compiled. memory: of a filter that has begun."""
        self.begin(-PERIOD)
        self.before(0.0, memory)
        follow(self._small.memory, memory, self._followed, self._withheld)
        learn_changes(np.zeros(Scale.CHANGING_SIZE), 0, 1.0, 1.0, 1.0, 0.0, 2, WEIGHT)

    def _latitude_longitude(self, row: np.ndarray) -> tuple[float, float]:
        return navigation_solution(row, 0, self._rows, self._open_loop)[:2]


def _held(memory: np.ndarray) -> float:
    """For how long, s, samples and measurements stay in the memory: half of it (a quarter of the measurements, as the
    older half is dropped at once), at the newest sample's interval and the measurements' rate."""
    newest, count = int(memory[Head.SAMPLES]), int(memory[Head.EVENTS])
    interval = max(memory[sample_at(memory, newest) + Sample.INTERVAL], SHORTEST_INTERVAL)
    samples = 0.5 * memory[Head.CAPACITY] * interval
    if count == 0:
        return samples
    # in a gap of the samples all measurements may be later than the newest one
    since = max(time_of(memory, newest) - memory[event_at(memory, 0) + Event.TIME], interval)
    return min(samples, 0.25 * memory[Head.EVENT_CAPACITY] * since / count)
