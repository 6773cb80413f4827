"""By how much a variance is larger or smaller than assumed: the one estimate of that, for every input of the filter.

What is estimated is the logarithm of (realised over assumed variance), as an error of a factor of ten is as likely too
small as too large. A squared deviation is expected to be `scale part + rest`: `part` is the variance in question,
`rest` what else is in it, such as the way that the inertial sensors did not see. Before anything is seen the prior is
what receivers and data sheets claim: a normal distribution of the logarithm, as is what is known later. There are two
ways to learn:

* `learn_changes`, from deviations that have little in common. Their likelihood is that of a chi-square variable, but
  for outliers (OUTLIER_DENSITY), which may be of any size and say nothing; mean and variance of the product of prior
  and likelihood are integrated over NODES (assumed density filtering, P. S. Maybeck, *Stochastic Models, Estimation,
  and Control* 2, 1982, 12.7). A scale stays as it is, until it becomes another one: a receiver among houses, a mount
  that comes loose. So there are two hypotheses, each with an estimate: the scale is as it was, or it has become another
  one, of any size (CHANGED_PRIOR), some time ago or since the latest deviation; these two cases are joined after the
  deviation, whose likelihood tells between them. The more probable one is used. One deviation far off is an outlier,
  several in a row are another scale. (R. P. Adams and D. J. C. MacKay, "Bayesian online changepoint detection", 2007,
  has as many hypotheses as there are instants.)
* `learn`, from means that have much in common, each of which tells a little: a Kalman filter with one state for the
  logarithm, which forgets (M. S. Bartlett and D. G. Kendall, "The statistical analysis of variance-heterogeneity and
  the logarithmic transformation", Supplement to J. Royal Statistical Society 8, 1946). A deviation of any size counts
  as a few sigma of it. One that is too large for chance is more of `part`: `rest` has its bounds.

(R. K. Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic Control 17, 1972; S. Sarkka and A. Nummenmaa,
"Recursive noise adaptive Kalman filtering by variational Bayesian approximations", the same 54, 2009, has an inverse
gamma distribution for the same.)
"""
from __future__ import annotations

import math
from typing import NamedTuple

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, INPUT_SIZE, Event, Head


class _Scale(NamedTuple):
    """Columns of one scale: mean of the logarithm, and how much of PRIOR its variance has lost. Zeros: the prior."""

    LOG: int = 0
    REDUCED: int = 1
    TIME: int = 2  # s, of the latest deviation
    SIZE: int = 3  # of one that `learn` follows
    OTHER_LOG: int = 3  # of one that `learn_changes` follows, mean and variance if it has become another one lately,
    OTHER_REDUCED: int = 4
    CHANGED: int = 5  # and the probability of that
    CHANGING_SIZE: int = 6  # size of that


Scale = _Scale()


class _Seen(NamedTuple):
    """Columns of what is seen of one input besides the fixes."""

    SCALE: int = 0  # a `Scale` that changes
    DISPLACEMENT: int = 6  # m, north and east, by its speeds since the fix START, see trust/displacement.py,
    DISPLACEMENT_TIME: int = 8  # s, till when; 0: it is no speed
    START: int = 9  # time, s, latitude and longitude, rad, of that fix; time 0: none
    LAST: int = 12  # velocity north and east at its end, m/s
    VARIANCE: int = 14  # of that displacement, m^2
    DISTANCE: int = 15  # m, north and east, from the antenna to the integral, estimated less measured at START,
    DISTANCE_VARIANCE: int = 17  # the variance of that estimate, m^2,
    COVARIANCE: int = 18  # and its covariance with the share, m
    SHARE: int = 20  # by which its displacements are longer than those of the fixes, and turned,
    REDUCED: int = 22  # and how much of `displacement.PRIOR` its variance has lost,
    COMPARED: int = 23  # time, s, since which enough of it has been known; 0: never, -1: no more, and it was wrong
    REJECTED: int = 24  # fixes in a row beyond its gate
    FITTED: int = 25  # time, s, of the latest one that fitted; negative: of the latest that fixes contradict
    LATEST: int = 26  # two values of the latest message, see trust/repeats.py,
    LATEST_TIME: int = 28  # time of it, s,
    GAINED: int = 29  # by how much the state has changed since it says that, between messages, m/s or rad,
    LEFT: int = 30  # and what it was after the latest,
    SINCE: int = 31  # time, s, since which it says that
    DIFFERENT: int = 32  # messages in a row that were other ones, see trust/repeats.py
    JUMP_SCORE: int = 33  # 1/s: error of its time offset by the latest innovations, over the variance of that error,
    JUMP_INFORMATION: int = 34  # 1/s^2: the inverse of that variance,
    FOLLOWED: int = 35  # and by what the state follows, in each component, for each s: see trust/clock_jump.py
    TRAVELLED: int = 37  # m, north and east, by which the filter has gone since START
    BEGAN: int = 39  # velocity north and east at START, m/s,
    LATE: int = 41  # and the variance of the displacement by the error of its time offset, m^2
    UNFOLLOWED: int = 42  # by how much its low pass is behind, m/s or rad, and the time, s: measurements/low_pass.py
    UNFOLLOWED_TURN: int = 44  # the same of its turn rate, rad/s,
    TURN: int = 46  # and that of the gyroscopes at its latest message, rad/s
    ABOVE: int = 47  # times, s, of the latest that were far above and far below what was expected, see trust/inputs.py
    BELOW: int = 48
    SIZE: int = 49


Seen = _Seen()
assert Seen.SIZE == INPUT_SIZE
Inputs = HEAD.place('Inputs', COUNT=1)  # how many inputs there are but the fixes
#: variance of the logarithm before anything is seen: a claimed sigma is off by a factor of three, one sigma
PRIOR = 4.8
#: the same of a scale that has become another one: without its base a receiver may scatter a thousand times as far as
#: it claims. With 9, fixes that claim 0.1 m and scattered by 15 m stayed outliers, and the filter was 37 m off
CHANGED_PRIOR = 16.0
#: 1/s: a scale becomes another one once in twenty minutes: what a drive through a city brings
CHANGE_RATE = 1.0 / 1200.0
#: 1/s, by which the variance of one that `learn` follows grows: by a factor of e within ten minutes
LOG_WALK = 1.0 / 600.0
#: mean and variance of the logarithm of a mean square of normal numbers with expectation 1, of one and of two
LOG_MEAN = (-1.2704, -0.5772)
LOG_VARIANCE = (4.9348, 1.6449)
#: a deviation beyond so many sigma of the logarithm counts as that
LARGEST_INNOVATION = 2.0
#: least multiple of the assumed variance that is used: a tenth of the sigma, as much as anybody claims too much
SMALLEST_SCALE = 0.01
#: and at most: a thousand times the sigma
LARGEST_SCALE = 1e6
#: share of the measurements of a sensor without a fault that are outliers
OUTLIER_SHARE = 0.01
#: share of deviations that say nothing, OUTLIER_SHARE, over 14: they are spread evenly over the logarithm
#: of their square, from metres to kilometres
OUTLIER_DENSITY = OUTLIER_SHARE / 14.0
#: abscissas, in sigmas, and their weights, at which a normal distribution is integrated: the trapezoidal rule
NODES = tuple(0.5 * i for i in range(-7, 8))
WEIGHTS = tuple(0.5 / math.sqrt(2.0 * math.pi) * math.exp(-0.5 * node * node) for node in NODES)


@njit(_nrt=False)
def seen_of(mem, r, at):
    """Position of what is seen (`Seen`) of the input that the event at `at` is from, in the state at r."""
    return r + int(mem[Head.WIDTH]) - Seen.SIZE * int(mem[at + Event.INPUT])


@njit(_nrt=False)
def learn(mem, at, time, squared, part, rest, dimensions, weight=1.0):
    """Learn from one mean at `time`, s, that has much in common with those before it; at: of the scale in `mem`.

    squared: mean square of its one or two `dimensions`, expected to be scale * part + rest. weight: of this one.
    """
    known = mem[at + Scale.REDUCED] - LOG_WALK * max(time - mem[at + Scale.TIME], 0.0)
    variance, mem[at + Scale.TIME] = PRIOR - max(known, 0.0), time
    share = math.exp(mem[at + Scale.LOG]) * part
    expected = share + rest
    share /= expected
    noise = LOG_VARIANCE[dimensions - 1] / weight
    shown = max(squared, 1e-12 * expected) / math.exp(LOG_MEAN[dimensions - 1])
    innovation = math.log(shown / expected)
    if innovation > LARGEST_INNOVATION * math.sqrt(LOG_VARIANCE[dimensions - 1]):  # no chance: up to what explains it
        share = innovation / (math.log((shown - rest) / part) - mem[at + Scale.LOG])
    largest = LARGEST_INNOVATION * math.sqrt(share * share * variance + LOG_VARIANCE[dimensions - 1])
    gain = share * variance / (share * share * variance + noise)
    level = mem[at + Scale.LOG] + gain * max(-largest, min(innovation, largest))
    mem[at + Scale.LOG] = max(math.log(SMALLEST_SCALE), min(level, math.log(LARGEST_SCALE)))
    mem[at + Scale.REDUCED] = PRIOR - variance + gain * share * variance


@njit(_nrt=False)
def learn_changes(mem, at, time, squared, part, rest, dimensions, weight=1.0):
    """Learn from one deviation at `time`, s, of a scale that may become another one; at: of it in `mem`.

    squared: mean square of its one or two `dimensions`, expected to be scale * part + rest. weight: exponent of its
    likelihood, below 1 where several deviations have much in common. Returns whether the estimate before it allowed for
    a deviation as large.
    """
    lately = 0.0
    if mem[at + Scale.TIME] != 0.0:
        lately = 1.0 - math.exp(-CHANGE_RATE * max(time - mem[at + Scale.TIME], 0.0))
    earlier = (1.0 - lately) * mem[at + Scale.CHANGED]
    never = 1.0 - lately - earlier
    level, variance = mem[at + Scale.LOG], PRIOR - mem[at + Scale.REDUCED]
    level, variance, same, fits = _learned(level, variance, squared, part, rest, dimensions, weight)
    other, other_variance = mem[at + Scale.OTHER_LOG], PRIOR - mem[at + Scale.OTHER_REDUCED]
    other, other_variance, changed, fits_other = _learned(other, other_variance, squared, part, rest, dimensions,
                                                          weight)
    new, new_variance, becomes, fits_new = _learned(0.0, CHANGED_PRIOR, squared, part, rest, dimensions, weight)
    same, changed, becomes = never * same, earlier * changed, lately * becomes
    share = changed + becomes
    if share > 0.0:  # mean and variance of a mixture of two normal distributions
        part_new, difference = becomes / share, new - other
        other_variance += part_new * (new_variance - other_variance + (1.0 - part_new) * difference * difference)
        other += part_new * difference
    share /= share + same
    if share > 0.5:
        level, variance, share = other, other_variance, 0.0
    level = max(math.log(SMALLEST_SCALE), min(level, math.log(LARGEST_SCALE)))
    mem[at + Scale.TIME], mem[at + Scale.CHANGED] = time, share
    mem[at + Scale.LOG], mem[at + Scale.REDUCED] = level, PRIOR - variance
    mem[at + Scale.OTHER_LOG], mem[at + Scale.OTHER_REDUCED] = other, PRIOR - other_variance
    return never * fits + earlier * fits_other + lately * fits_new > OUTLIER_DENSITY


@njit(_nrt=False)
def _learned(level, variance, squared, part, rest, dimensions, weight):
    """Mean and variance of the logarithm after a deviation, from those before it, and its likelihood, with outliers and
    without."""
    sigma = math.sqrt(max(variance, 0.0))
    shown = max(squared, 1e-12 * (part + rest))
    total = mean = square = allowed = 0.0
    for i in range(len(NODES)):
        node = sigma * NODES[i]
        likelihood = _times_square(shown / (math.exp(level + node) * part + rest), dimensions)
        allowed += WEIGHTS[i] * likelihood
        probability = WEIGHTS[i] * (likelihood + OUTLIER_DENSITY) ** weight
        total += probability
        mean += probability * node
        square += probability * node * node
    mean /= total
    return level + mean, square / total - mean * mean, total, allowed


@njit(_nrt=False)
def _times_square(ratio, dimensions):
    """Density of a mean square of one or two normal numbers, times that square; ratio: the square over its expectation.
    """
    return math.sqrt(ratio / (2.0 * math.pi)) * math.exp(-0.5 * ratio) if dimensions == 1 else ratio * math.exp(-ratio)


@njit(_nrt=False)
def reset_scale(mem, at):
    """Nothing is known of the scale at `at`, which `learn` follows, but the prior."""
    mem[at + Scale.LOG] = mem[at + Scale.REDUCED] = 0.0


@njit(_nrt=False)
def reopen(mem, at, factor):
    """The assumed variance of a scale that changes is `factor` times what it was.

    The realised one stays as it is, or it is as assumed, where that is more, and may be any other: both hypotheses are
    as probable. Of several calls the first one's is kept.
    """
    if mem[at + Scale.CHANGED] < 0.5:
        mem[at + Scale.OTHER_LOG], mem[at + Scale.OTHER_REDUCED] = mem[at + Scale.LOG], mem[at + Scale.REDUCED]
    mem[at + Scale.OTHER_LOG] -= math.log(factor)
    mem[at + Scale.CHANGED] = 0.5
    mem[at + Scale.LOG] = max(mem[at + Scale.LOG] - math.log(factor), 0.0)
    mem[at + Scale.REDUCED] = 0.0


@njit(_nrt=False)
def scale(row, at):
    """Realised over assumed variance: as seen where it is more, where it is less only as far as that is certain."""
    level, variance = row[at + Scale.LOG], max(PRIOR - row[at + Scale.REDUCED], 0.0)
    return math.exp(level if level > 0.0 else min(level + math.sqrt(variance), 0.0))
