"""The one estimator of realised over assumed variance: against numbers drawn with a known variance."""
from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, norm

from mems_ins_fusion.filter.trust import scale as judged
from mems_ins_fusion.filter.trust.scale import Scale, learn, learn_changes, reopen, scale


def learned(realised, count=400, dimensions=2, rest=0.0, interval=1.0, outliers=0.0, seed=1, by=learn):
    """A scale after `count` deviations of variance realised + rest."""
    rng, at = np.random.default_rng(seed), np.zeros(Scale.CHANGING_SIZE)
    for k in range(count):
        deviation = math.sqrt(realised + rest) * rng.standard_normal(dimensions)
        if rng.random() < outliers:
            deviation += 1000.0
        by(at, 0, k * interval, float(np.mean(deviation**2)), 1.0, rest, dimensions)
    return at


@pytest.mark.parametrize('dimensions', [1, 2])
def test_the_moments_of_the_logarithm_are_those_of_a_chi_square_variable(dimensions):
    logarithm = [chi2(dimensions).expect(lambda x, k=k: np.log(x / dimensions)**k) for k in (1, 2)]
    assert judged.LOG_MEAN[dimensions - 1] == pytest.approx(logarithm[0], abs=1e-3)
    assert judged.LOG_VARIANCE[dimensions - 1] == pytest.approx(logarithm[1] - logarithm[0]**2, abs=1e-3)


@pytest.mark.parametrize('rest', [0.0, 3.0])
@pytest.mark.parametrize('squared', [0.01, 2.0, 50.0])
@pytest.mark.parametrize('dimensions', [1, 2])
def test_the_posterior_is_that_of_bayes_rule(dimensions, squared, rest):
    # given the prior of a scale, and one deviation
    at = np.zeros(Scale.CHANGING_SIZE)
    learn_changes(at, 0, 0.0, squared, 2.0, rest, dimensions)
    # then mean and variance are those that the densities of SciPy give
    level = np.linspace(-20.0, 20.0, 40001)
    expected = 2.0 * np.exp(level) + rest
    likelihood = chi2(dimensions).pdf(dimensions * squared / expected) * dimensions * squared / expected
    density = norm(0.0, math.sqrt(judged.PRIOR)).pdf(level) * (likelihood + judged.OUTLIER_DENSITY)
    density /= density.sum()
    mean = np.sum(density * level)
    assert at[Scale.LOG] == pytest.approx(mean, abs=0.02)
    assert judged.PRIOR - at[Scale.REDUCED] == pytest.approx(np.sum(density * (level - mean) ** 2), rel=0.02)


def test_white_noise_of_a_day_does_not_seem_to_become_smaller():
    # given a deviation each two seconds, of the assumed variance, for a day
    squared = np.random.default_rng(8).exponential(1.0, 43_200)
    at, low = np.zeros(Scale.CHANGING_SIZE), np.zeros(len(squared), dtype=bool)
    for k, value in enumerate(squared):
        learn_changes(at, 0, 2.0 * k, value, 1.0, 0.0, 2)
        low[k] = at[Scale.LOG] < -1.0
    # then less than a twentieth of the changes by the prior seem to have happened: 24 h / 20 min / 20 = 3.6, and three
    # standard deviations of a Poisson variable
    assert np.count_nonzero(np.diff(low[50:].astype(int)) == 1) <= 3.6 + 3.0 * math.sqrt(3.6)


@pytest.mark.parametrize('realised', [36.0, 400.0, 750.0**2])
def test_another_scale_is_found_after_a_few_deviations_up_and_down(realised):
    # given a scale that has been 1 for a minute, then is another one for as long, and 1 again
    found = []
    for seed in range(20):
        rng, at = np.random.default_rng(seed), np.zeros(Scale.CHANGING_SIZE)
        levels = []
        for k, variance in enumerate(np.repeat([1.0, realised, 1.0], 60)):
            learn_changes(at, 0, k + 1.0, float(np.mean(variance * rng.standard_normal(2) ** 2)), 1.0, 0.0, 2)
            levels.append(at[Scale.LOG])
        found.append(levels)
    # then eight deviations later it is known to a factor of two, mostly
    middle = np.median(found, axis=0)
    assert abs(middle[67] - math.log(realised)) < 0.7 and abs(middle[127]) < 0.7
    # and a minute of them tells it to a fifth
    assert np.std([levels[119] for levels in found]) < 0.2


def test_it_has_changed_as_probably_as_bayes_rule_says():
    # given a scale that is known to be about 1 to a factor of 1.5, and perhaps became a fifth of that a while ago
    sigma, earlier = 0.4, 0.06
    at = np.zeros(Scale.CHANGING_SIZE)
    at[Scale.TIME], at[Scale.LOG], at[Scale.REDUCED] = 10.0, 0.0, judged.PRIOR - sigma**2
    at[Scale.OTHER_LOG], at[Scale.OTHER_REDUCED], at[Scale.CHANGED] = -1.6, judged.PRIOR - 1.0, earlier
    # when a deviation comes three seconds later that is a thousand times as large
    learn_changes(at, 0, 13.0, 1000.0, 1.0, 0.0, 2)
    # then that it has changed at some time, and what it is then, is what the densities of SciPy give
    lately = 1.0 - math.exp(-3.0 * judged.CHANGE_RATE)
    level = np.linspace(-30.0, 30.0, 60001)
    likelihood = chi2(2).pdf(2000.0 / np.exp(level)) * 2000.0 / np.exp(level) + judged.OUTLIER_DENSITY
    parts = [(1.0 - lately) * (1.0 - earlier) * norm(0.0, sigma).pdf(level),
             (1.0 - lately) * earlier * norm(-1.6, 1.0).pdf(level),
             lately * norm(0.0, math.sqrt(judged.CHANGED_PRIOR)).pdf(level)]
    same, *changed = [np.sum(part * likelihood) for part in parts]
    assert at[Scale.CHANGED] == pytest.approx(sum(changed) / (same + sum(changed)), rel=0.1)  # nodes are 2 apart
    density = (parts[1] + parts[2]) * likelihood / sum(changed)
    mean = np.sum(density * level)
    assert at[Scale.OTHER_LOG] == pytest.approx(mean, abs=0.3)
    assert judged.PRIOR - at[Scale.OTHER_REDUCED] == pytest.approx(np.sum(density * (level - mean) ** 2), rel=0.1)


def test_one_deviation_far_off_is_no_other_scale():
    at = learned(1.0, 60, by=learn_changes)
    before = at[Scale.LOG]
    learn_changes(at, 0, 61.0, 400.0, 1.0, 0.0, 2)
    assert at[Scale.LOG] == pytest.approx(before, abs=0.02)


@pytest.mark.parametrize('realised', [75.0**2, 9.0, 1.0, 1 / 9, 1 / 100])
@pytest.mark.parametrize('dimensions', [1, 2])
@pytest.mark.parametrize('interval', [0.1, 1.0, 10.0])
@pytest.mark.parametrize('by', [learn, learn_changes])
def test_it_finds_the_realised_variance_upwards_and_downwards_at_any_rate(realised, dimensions, interval, by):
    found = [scale(learned(realised, 200, dimensions, interval=interval, seed=seed, by=by), 0) for seed in range(5)]
    assert 0.6 < np.exp(np.mean(np.log(found))) / realised < 2.5  # what is less than claimed counts when it is certain


@pytest.mark.parametrize('realised', [75.0**2, 1 / 100])
@pytest.mark.parametrize('by', [learn, learn_changes])
def test_ten_deviations_are_enough_to_be_near(realised, by):
    found = [scale(learned(realised, 10, seed=seed, by=by), 0) for seed in range(20)]
    assert 1 / 3 < np.median(found) / realised < 3.0


@pytest.mark.parametrize(('deviation', 'fits'), [(0.1, True), (30.0, True), (1e4, False)])
def test_a_deviation_that_the_estimate_does_not_allow_for_is_told(deviation, fits):
    # given the prior, a factor of exp(sqrt(4.8)) = 9, and a deviation of two numbers: two sigma are a factor of 160
    assert learn_changes(np.zeros(Scale.CHANGING_SIZE), 0, 0.0, deviation, 1.0, 0.0, 2) == fits


def test_the_claim_stands_until_the_contrary_is_seen():
    assert scale(np.zeros(Scale.CHANGING_SIZE), 0) == 1.0
    # a single small deviation is chance
    at = np.zeros(Scale.CHANGING_SIZE)
    learn(at, 0, 0.0, 0.05, 1.0, 0.0, 2)
    assert scale(at, 0) > 0.3


def test_deviations_that_are_mostly_something_else_teach_little():
    # given errors of variance 1 behind a way that is uncertain by ten times that, and is so
    unseen, seen = (learned(9.0, 30, rest=rest) for rest in (1000.0, 0.0))
    assert unseen[Scale.REDUCED] < 0.1 < 4.0 < seen[Scale.REDUCED]
    assert scale(unseen, 0) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize(('by', 'most'), [(learn, 3.0), (learn_changes, 1.2)])
def test_wild_deviations_count_little(by, most):
    assert scale(learned(1.0, outliers=0.15, by=by), 0) < most < 1e5 * 0.15


def test_what_was_seen_long_ago_is_less_certain():
    at = learned(9.0, 100)
    before = at[Scale.LOG]
    learn(at, 0, 4000.0, 9.0 * math.exp(1.0), 1.0, 0.0, 2)
    assert at[Scale.REDUCED] == pytest.approx(judged.PRIOR**2 / (judged.PRIOR + judged.LOG_VARIANCE[1]))
    assert at[Scale.LOG] > before


def test_what_was_seen_long_ago_is_forgotten():
    # given a scale of 9, and one deviation that stands for 900, at once and an hour later
    found = []
    for later in (1.0, 3600.0):
        at = learned(9.0, 100, by=learn_changes)
        learn_changes(at, 0, 100.0 + later, 900.0, 1.0, 0.0, 2)
        found.append(at[Scale.LOG])
    # then it is one far off, and another scale
    assert found[0] < math.log(12.0) < math.log(50.0) < found[1]


@pytest.mark.parametrize(('factor', 'expected'), [(0.01, 100.0), (100.0, 1.0)])
def test_a_claim_that_jumps_leaves_the_larger_of_both(factor, expected):
    # a receiver that scattered as it claimed, and claims a hundredth or a hundred times of it from now on
    at = np.zeros(Scale.CHANGING_SIZE)
    reopen(at, 0, factor)
    assert scale(at, 0) == pytest.approx(expected) and at[Scale.REDUCED] == 0.0


def test_a_claim_that_comes_and_goes_leaves_what_was_known():
    # given a receiver that scatters a tenth of its claimed variance, and for one fix claims a hundred times as much
    at = learned(0.1, 60, by=learn_changes)
    reopen(at, 0, 100.0)
    reopen(at, 0, 0.01)
    # then two more fixes are enough to know that again
    rng = np.random.default_rng(2)
    for k in range(2):
        learn_changes(at, 0, 61.0 + k, float(np.mean(0.1 * rng.standard_normal(2) ** 2)), 1.0, 0.0, 2)
    assert scale(at, 0) == pytest.approx(0.1, rel=0.5)
