"""By how much a variance is larger or smaller than assumed: the one estimator of that, for every input of the filter.

What is estimated is the logarithm of (realised over assumed variance), as an error of a factor of ten is as likely too
small as too large: a mean and a variance of it, a Kalman filter with one state. A squared deviation that is expected to
be `scale part + rest` - `part` is the variance in question, `rest` what else is in it, such as the way that the
inertial sensors did not see - says something of the scale as far as `part` is of it. The logarithm of a chi-square
variable has a known mean and variance; a deviation of any size counts as a few sigma of it, so that a single wild one
does not ruin the rest. One that is too large for chance is more of `part`: `rest` has its bounds.

The prior is what receivers and data sheets claim. It is forgotten with time as the scale itself changes. (S. Sarkka and
A. Nummenmaa, "Recursive noise adaptive Kalman filtering by variational Bayesian approximations", IEEE Trans. Automatic
Control 54, 2009, has an inverse gamma distribution for the same; R. K. Mehra, "Approaches to adaptive filtering",
IEEE Trans. Automatic Control 17, 1972. M. S. Bartlett and D. G. Kendall, "The statistical analysis of
variance-heterogeneity and the logarithmic transformation", Supplement to J. Royal Statistical Society 8, 1946.)
"""
from __future__ import annotations

import math
from typing import NamedTuple

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, INPUT_SIZE, ROW, Event, Head


class _Scale(NamedTuple):
    """Columns of one scale: mean of the logarithm, and how much of PRIOR its variance has lost. Zeros: the prior."""

    LOG: int = 0
    KNOWN: int = 1
    TIME: int = 2  # s, of the latest deviation
    SIZE: int = 3


Scale = _Scale()


class _Seen(NamedTuple):
    """Columns of what is seen of one input besides the fixes."""

    SCALE: int = 0  # a `Scale`
    WAY: int = 3  # m, north and east, that its speeds make up since the fix START, see trust/way.py,
    WAY_TIME: int = 5  # s, till when; 0: it is no speed
    START: int = 6  # time, s, latitude and longitude, rad, of that fix; time 0: none
    MORE: int = 9  # share by which that way is longer than the one of the fixes,
    KNOWN: int = 10  # and how much of `way.PRIOR` its variance has lost,
    COMPARED: int = 11  # 1: enough of it at some time
    FITTED: int = 12  # time, s, of the latest one that fitted; negative: of the latest that was where no fix is
    LATEST: int = 13  # two values of the latest message, see trust/repeats.py,
    SAID: int = 15  # time of it, s,
    GAINED: int = 16  # by how much the state has changed since it says that, between messages, m/s or rad,
    LEFT: int = 17  # and what it was after the latest,
    SINCE: int = 18  # time, s, since which it says that
    LAST: int = 19  # velocity north and east with which its way ends, m/s
    VARIANCE: int = 21  # of that way, m^2
    COMPARED_IN: int = 22  # what of it is compared, see trust/way.py
    SURPRISED: int = 23  # 1: the latest one was far longer than expected, -1: far shorter
    OTHERS: int = 24  # messages in a row that were other ones, see trust/repeats.py
    LATER: int = 25  # 1/s: what the latest ones say of its time offset, beside the estimate, over the variance of that,
    TELLS: int = 26  # 1/s^2, the inverse of that variance,
    FOLLOWED: int = 27  # and by what the state follows, in each component, for each s: see trust/clock_jump.py
    SIZE: int = 29


Seen = _Seen()
#: of a state: what is seen of each kind of measurement but the fixes, by its number modulo this
KINDS = 7
Kinds = ROW.place('Kinds', SEEN=Seen.SIZE * KINDS)
assert Seen.SIZE == INPUT_SIZE
Inputs = HEAD.place(
    'Inputs',
    COUNT=1,  # how many inputs have a name
    UNNAMED=1)  # 1: there has been a measurement, other than a fix, of one without; else all of `Kinds` is zero
#: variance of the logarithm before anything is seen: a claimed sigma is off by a factor of three, one sigma
PRIOR = 4.8
#: 1/s, by which that variance grows: a scale may change by a factor of e within ten minutes
CHANGES = 1.0 / 600.0
#: multiple of the assumed variance that is believed at least: a tenth of the sigma, as much as anybody claims too much
SMALLEST = 0.01
#: and at most: a thousand times the sigma
LARGEST = 1e6
#: mean and variance of the logarithm of a mean square of normal numbers with expectation 1, of one and of two
LOG_MEAN = (-1.2704, -0.5772)
LOG_VARIANCE = (4.9348, 1.6449)
#: a deviation beyond so many sigma of the logarithm counts as that
LARGEST_SURPRISE = 2.0


@njit(_nrt=False)
def seen_of(mem, r, at):
    """Position of what is seen (`Seen`) of the input that the record at `at` is from, in the state at r."""
    number = int(mem[at + Event.INPUT])
    if number == 0:
        return r + Kinds.SEEN + Seen.SIZE * (int(mem[at + Event.KIND]) % KINDS)
    return r + int(mem[Head.WIDTH]) - Seen.SIZE * (int(mem[Inputs.COUNT]) - number + 1)


@njit(_nrt=False)
def learn(mem, at, time, squared, part, rest, dimensions, weight=1.0):
    """Learn from one deviation at `time`, s; at: of the scale in `mem`.

    squared: mean square of its one or two `dimensions`, expected to be scale * part + rest. weight: below 1 where
    several deviations tell the same. Whether the estimate before it allowed for one as large.
    """
    known = mem[at + Scale.KNOWN] - CHANGES * max(time - mem[at + Scale.TIME], 0.0)
    variance, mem[at + Scale.TIME] = PRIOR - max(known, 0.0), time
    share = math.exp(mem[at + Scale.LOG]) * part
    expected = share + rest
    share /= expected
    noise = LOG_VARIANCE[dimensions - 1] / weight
    shown = max(squared, 1e-12 * expected) / math.exp(LOG_MEAN[dimensions - 1])
    surprise = math.log(shown / expected)
    if surprise > LARGEST_SURPRISE * math.sqrt(LOG_VARIANCE[dimensions - 1]):  # no chance: up to what explains it
        share = surprise / (math.log((shown - rest) / part) - mem[at + Scale.LOG])
    sigma = math.sqrt(share * share * variance + LOG_VARIANCE[dimensions - 1])
    fits = surprise <= LARGEST_SURPRISE * sigma
    surprise = max(-LARGEST_SURPRISE * sigma, min(surprise, LARGEST_SURPRISE * sigma))
    gain = share * variance / (share * share * variance + noise)
    level = mem[at + Scale.LOG] + gain * surprise
    mem[at + Scale.LOG] = max(math.log(SMALLEST), min(level, math.log(LARGEST)))
    mem[at + Scale.KNOWN] = PRIOR - variance + gain * share * variance
    return fits


@njit(_nrt=False)
def begin_scale(mem, at):
    """Nothing is known of it but the prior."""
    mem[at + Scale.LOG] = mem[at + Scale.KNOWN] = 0.0


@njit(_nrt=False)
def reopen(mem, at, factor):
    """The assumed variance is `factor` times what it was: the realised one stays where it is the larger of both, and
    may be any other."""
    mem[at + Scale.LOG] = max(mem[at + Scale.LOG] - math.log(factor), 0.0)
    mem[at + Scale.KNOWN] = 0.0


@njit(_nrt=False)
def scale(row, at):
    """Realised over assumed variance: as seen where it is more, where it is less only as far as that is certain."""
    level, variance = row[at + Scale.LOG], PRIOR - row[at + Scale.KNOWN]
    return math.exp(level if level > 0.0 else min(level + math.sqrt(variance), 0.0))
