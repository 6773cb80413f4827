"""Scales: the ratio of the realised to the assumed variance of an input, learned from squared deviations.

This is the only estimator of such a ratio in the filter. Its state is the logarithm of the ratio, as assumed variances
are as likely too small as too large by a given factor. A squared deviation has the expectation `scale part + rest`:
`part` is the assumed variance, `rest` the sum of other variances, such as that of the motion between two fixes. The
distribution of the logarithm is normal; the prior is that of the sigmas that receivers and data sheets claim. There are
two ways to learn:

* `learn_changes`, for independent deviations. The likelihood is that of a chi-square variable plus a constant for
  outliers (OUTLIER_DENSITY). Mean and variance of the product of prior and likelihood are integrated over NODES
  (assumed density filtering, P. S. Maybeck, *Stochastic Models, Estimation, and Control* 2, 1982, 12.7). A scale may
  change at any time: a receiver comes between houses, a mount comes loose. So there are two hypotheses, each with its
  own estimate: the scale is unchanged, or it has changed to any value (CHANGED_PRIOR). The second one is a mixture of a
  change before the previous deviation and one after it, which is merged to one normal distribution after each
  deviation. The more probable hypothesis is used (a smaller scale only if it is certain): one large deviation is an
  outlier, several in a row are a change.
  (R. P. Adams and D. J. C. MacKay, "Bayesian online changepoint detection", 2007, keep a hypothesis for each instant.)
* `learn`, for mean squares that are correlated with each other: a Kalman filter with one state for the logarithm and a
  random walk (M. S. Bartlett and D. G. Kendall, "The statistical analysis of variance-heterogeneity and the logarithmic
  transformation", Supplement to J. Royal Statistical Society 8, 1946). Large innovations are bounded. A deviation that
  is too large for chance is attributed to `part`, as `rest` is known.

See also R. K. Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic Control 17, 1972, and, with an inverse
gamma distribution, S. Sarkka and A. Nummenmaa, "Recursive noise adaptive Kalman filtering by variational Bayesian
approximations", the same 54, 2009.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, INPUT


class _Scale(NamedTuple):
    """Columns of one scale. All zero: the prior."""

    LOG: int = 0  # mean of the logarithm
    REDUCED: int = 1  # PRIOR minus its variance
    TIME: int = 2  # s, of the latest deviation
    SIZE: int = 3  # number of columns of a scale for `learn`
    OTHER_LOG: int = 3  # `learn_changes`: mean if the scale has changed,
    OTHER_REDUCED: int = 4  # PRIOR minus the variance in this case,
    CHANGED: int = 5  # and the probability of a change
    CHANGING_SIZE: int = 6  # number of columns of a scale for `learn_changes`


Scale = _Scale()
#: of an input but the fixes: the scale of its noise, for `learn_changes`, with the time of its latest message
Noise = INPUT.place('Noise', SCALE=Scale.CHANGING_SIZE)
Inputs = HEAD.place('Inputs', COUNT=1)  # number of inputs without the fixes
#: prior variance of the logarithm: a claimed sigma is wrong by a factor of three (one standard deviation)
PRIOR = 4.8
#: the same after a change: a receiver that loses its base may scatter by a thousand times its claim. With 9, fixes that
#: claim 0.1 m and scatter by 15 m remain outliers, and the filter gets 37 m off
CHANGED_PRIOR = 16.0
#: 1/s, rate of changes: one in twenty minutes, as in a drive through a city. Chosen; a quarter and four times of it
#: move little (docs/ablation.md)
CHANGE_RATE = 1.0 / 1200.0
#: probability of a change from which on a smaller scale is used; a larger one is used if it is the more probable one.
#: A scale that is too small makes right measurements outliers, one that is too large costs a few of them. With 0.5
#: white noise seemed to have become smaller 72 times in 100 hours (now 3 times), once for half a minute, in which a
#: right IMU passed for a wrong one
SURE_DECREASE = 0.95
#: 1/s, growth of the variance in `learn`: by 1, which is a factor of e, in ten minutes. Chosen; a quarter and four
#: times of it move little (docs/ablation.md)
LOG_WALK = 1.0 / 600.0
#: mean of the logarithm of the mean square of one, and of two, standard normal numbers
LOG_MEAN = (-1.2704, -0.5772)
#: and its variance
LOG_VARIANCE = (4.9348, 1.6449)
#: upper limit of an innovation in standard deviations: a larger one counts as this. Chosen; a quarter and four times of
#: it move little (docs/ablation.md)
LARGEST_DEVIATION = 2.0
#: smallest scale: a tenth of the claimed sigma, as claims are not more pessimistic than this
SMALLEST_SCALE = 0.01
#: largest scale: a thousand times the claimed sigma
LARGEST_SCALE = 1e6
#: share of outliers among the measurements of a sensor without a fault. Chosen; a quarter and four times of it move
#: little (docs/ablation.md)
OUTLIER_SHARE = 0.01
#: density of outliers over the logarithm of the squared deviation: uniform over a range of 14, from metres to
#: kilometres
OUTLIER_DENSITY = OUTLIER_SHARE / 14.0
#: abscissas of the numerical integration over a normal distribution, in standard deviations
NODES = tuple(0.5 * i for i in range(-7, 8))
#: and their weights: trapezoidal rule
WEIGHTS = tuple(0.5 / math.sqrt(2.0 * math.pi) * math.exp(-0.5 * node * node) for node in NODES)


@njit(_nrt=False)
def learn(mem, at, time, squared, part, rest, dimensions, weight=1.0):
    """Learn from a mean square at `time`, s, that is correlated with the previous ones. at: position of the scale.

    squared: mean square of one or two `dimensions`, with the expectation scale * part + rest. weight: number of
    independent values that it counts as.
    """
    known = mem[at + Scale.REDUCED] - LOG_WALK * max(time - mem[at + Scale.TIME], 0.0)
    variance, mem[at + Scale.TIME] = PRIOR - max(known, 0.0), time
    slope = math.exp(mem[at + Scale.LOG]) * part
    expected = slope + rest
    slope /= expected
    noise = LOG_VARIANCE[dimensions - 1] / weight
    shown = max(squared, 1e-12 * expected) / math.exp(LOG_MEAN[dimensions - 1])
    innovation = math.log(shown / expected)
    if innovation > LARGEST_DEVIATION * math.sqrt(LOG_VARIANCE[dimensions - 1]):  # slope to the scale that explains it
        slope = innovation / (math.log((shown - rest) / part) - mem[at + Scale.LOG])
    largest = LARGEST_DEVIATION * math.sqrt(slope * slope * variance + LOG_VARIANCE[dimensions - 1])
    gain = slope * variance / (slope * slope * variance + noise)
    level = mem[at + Scale.LOG] + gain * max(-largest, min(innovation, largest))
    mem[at + Scale.LOG] = max(math.log(SMALLEST_SCALE), min(level, math.log(LARGEST_SCALE)))
    mem[at + Scale.REDUCED] = PRIOR - variance + gain * slope * variance


@njit(_nrt=False)
def learn_changes(mem, at, time, squared, part, rest, dimensions, weight=1.0):
    """Learn from a deviation at `time`, s, that is independent of the previous ones. at: position of the scale.

    squared: mean square of one or two `dimensions`, with the expectation scale * part + rest. weight: exponent of the
    likelihood, below 1 if several deviations are correlated. Returns whether the deviation was consistent with the
    estimate before it.
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
    other_probability = changed + becomes
    if other_probability > 0.0:  # mean and variance of a mixture of two normal distributions
        part_new, difference = becomes / other_probability, new - other
        other_variance += part_new * (new_variance - other_variance + (1.0 - part_new) * difference * difference)
        other += part_new * difference
    other_probability /= other_probability + same
    if other_probability > (0.5 if other > level else SURE_DECREASE):
        level, variance, other_probability = other, other_variance, 0.0
    level = max(math.log(SMALLEST_SCALE), min(level, math.log(LARGEST_SCALE)))
    mem[at + Scale.TIME], mem[at + Scale.CHANGED] = time, other_probability
    mem[at + Scale.LOG], mem[at + Scale.REDUCED] = level, PRIOR - variance
    mem[at + Scale.OTHER_LOG], mem[at + Scale.OTHER_REDUCED] = other, PRIOR - other_variance
    return never * fits + earlier * fits_other + lately * fits_new > OUTLIER_DENSITY


@njit(_nrt=False)
def _learned(level, variance, squared, part, rest, dimensions, weight):
    """Mean and variance of the logarithm after a deviation, from those before it, and the likelihood of the deviation
    with and without outliers."""
    sigma = math.sqrt(max(variance, 0.0))
    shown = max(squared, 1e-12 * (part + rest))
    total = mean = square = allowed = 0.0
    for i in range(len(NODES)):
        node = sigma * NODES[i]
        likelihood = _times_square(shown / (math.exp(level + node) * part + rest), dimensions)
        allowed += WEIGHTS[i] * likelihood
        density = likelihood + OUTLIER_DENSITY
        probability = WEIGHTS[i] * (density if weight == 1.0 else density**weight)
        total += probability
        mean += probability * node
        square += probability * node * node
    mean /= total
    return level + mean, square / total - mean * mean, total, allowed


@njit(_nrt=False)
def _times_square(ratio, dimensions):
    """Density of the logarithm of a mean square of one or two normal numbers. ratio: mean square over its expectation.
    """
    return math.sqrt(ratio / (2.0 * math.pi)) * math.exp(-0.5 * ratio) if dimensions == 1 else ratio * math.exp(-ratio)


@njit(_nrt=False)
def reset_scale(mem, at):
    """Reset the scale at `at`, for `learn`, to the prior."""
    mem[at + Scale.LOG] = mem[at + Scale.REDUCED] = 0.0


@njit(_nrt=False)
def reopen(mem, at, factor):
    """Take note that the assumed variance of the scale at `at`, for `learn_changes`, is now `factor` times the earlier
    one.

    The two hypotheses, equally probable: the realised variance is unchanged, or it is the assumed one, if that is
    larger, with the variance of the prior. In further calls the first of them is kept.
    """
    if mem[at + Scale.CHANGED] < 0.5:
        mem[at + Scale.OTHER_LOG], mem[at + Scale.OTHER_REDUCED] = mem[at + Scale.LOG], mem[at + Scale.REDUCED]
    mem[at + Scale.OTHER_LOG] -= math.log(factor)
    mem[at + Scale.CHANGED] = 0.5
    mem[at + Scale.LOG] = max(mem[at + Scale.LOG] - math.log(factor), 0.0)
    mem[at + Scale.REDUCED] = 0.0


@njit(_nrt=False)
def scale(row, at):
    """Realised over assumed variance: the estimate if it is above 1, else the estimate plus one standard deviation, at
    most 1."""
    level, variance = row[at + Scale.LOG], max(PRIOR - row[at + Scale.REDUCED], 0.0)
    return math.exp(level if level > 0.0 else min(level + math.sqrt(variance), 0.0))
