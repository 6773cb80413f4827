"""The likelihood of white noise plus a slow error against the dense normal distribution, and coverage of the fits."""
import numpy as np
import pytest

from mems_ins_fusion.characterization.fitting import (
    coefficients,
    fit_autoregressive,
    fit_gauss_markov,
    fit_random_walk,
    fit_white,
    reflections,
)
from mems_ins_fusion.characterization.likelihood import (
    Averages,
    autoregressive_space,
    average,
    log_likelihood,
    relative_likelihood,
    state_space,
)
from mems_ins_fusion.sensor_errors.models import Autoregressive, GaussMarkov, RandomWalk, simulate

T, N = 2.0, 0.5
WALK, MARKOV, AR2 = RandomWalk(0.2, 0.0), GaussMarkov(0.7, 9.0), Autoregressive((-1.2, 0.3), 0.4, T)


def covariance_of_means(model, n):
    """Of n adjacent means over T, from the integrals of the process's covariance function."""
    j, k = np.indices((n, n))
    if isinstance(model, RandomWalk):  # cov(x(s), x(t)) = q^2 min(s, t)
        return model.q**2 * T * np.where(j == k, j + 1 / 3, np.minimum(j, k) + 1 / 2)
    if isinstance(model, GaussMarkov):
        u = T / model.tau
        apart = np.exp(-(np.abs(j - k) - 1) * u) * ((1 - np.exp(-u)) / u) ** 2
        return model.sigma**2 * np.where(j == k, 2 * (u - 1 + np.exp(-u)) / u**2, apart)
    impulse = np.linalg.inv(np.eye(1500) + sum(a * np.eye(1500, k=-i - 1) for i, a in enumerate(model.coefficients)))
    response = model.b0 * impulse[:, 0]
    lags = np.array([response[:1500 - lag] @ response[lag:] for lag in range(n)])
    return lags[np.abs(j - k)]


def dense_log_likelihood(data, model):
    """Restricted likelihood (Harville 1974), one part after another."""
    total = 0.0
    for part in np.unique(data.part):
        z = data.z[data.part == part]
        keep = np.isfinite(z)
        c = (covariance_of_means(model, len(z)) + N**2 / T * np.eye(len(z)))[np.ix_(keep, keep)]
        z, one = z[keep], np.ones(keep.sum())
        information = one @ np.linalg.solve(c, one)
        r = z - one @ np.linalg.solve(c, z) / information
        total -= 0.5 * (r @ np.linalg.solve(c, r) + np.linalg.slogdet(c)[1] + np.log(information)
                        + (len(z) - 1) * np.log(2 * np.pi))
    return total


@pytest.mark.parametrize('model', [WALK, MARKOV, AR2], ids=lambda m: type(m).__name__)
def test_likelihood_is_that_of_the_dense_normal_distribution(model):
    # given two parts with different levels and missing averages
    rng = np.random.default_rng(1)
    z = np.concatenate([rng.standard_normal(60) + 9.8, rng.standard_normal(25) - 3])
    z[[0, 10, 11, 12, 70]] = np.nan
    data = Averages(z, np.repeat([0, 1], [60, 25]), T)
    assert log_likelihood(data, state_space(model, N, T)) == pytest.approx(dense_log_likelihood(data, model), rel=1e-9)


def test_steady_state_shortcut_changes_nothing():
    # long enough that the filter stops updating its covariance
    rng = np.random.default_rng(2)
    data = Averages(rng.standard_normal(400), np.zeros(400, int), T)
    expected = dense_log_likelihood(data, MARKOV)
    assert log_likelihood(data, state_space(MARKOV, N, T)) == pytest.approx(expected, rel=1e-9)


def test_reflection_form_is_the_same_model_and_the_scale_is_at_its_best():
    data = Averages(np.random.default_rng(3).standard_normal(50), np.zeros(50, int), T)
    space = autoregressive_space(reflections(AR2.coefficients), AR2.b0, N, T)
    value = log_likelihood(data, state_space(AR2, N, T))
    assert log_likelihood(data, space) == pytest.approx(value, rel=1e-9)
    assert coefficients(reflections(AR2.coefficients)) == pytest.approx(AR2.coefficients)
    best, scale = relative_likelihood(data, space)

    def scaled(s):
        return autoregressive_space(reflections(AR2.coefficients), s * AR2.b0, s * N, T)

    assert log_likelihood(data, scaled(scale)) == pytest.approx(best, rel=1e-9)
    assert log_likelihood(data, scaled(1.01 * scale)) < best > log_likelihood(data, scaled(0.99 * scale))


def test_averages_leave_out_mostly_missing_intervals():
    x = np.arange(12.0)
    x[[4, 5, 6, 9]] = np.nan
    data = average([x], 4, 0.25)
    np.testing.assert_allclose(data.z, [1.5, np.nan, (8 + 10 + 11) / 3])
    assert data.interval == 1.0


DENSITY = 3e-4
#: white noise plus each model, 20 min of means over 1 s, and the parameters to be found
SENSORS = {
    'random_walk': (RandomWalk(2e-5, 0.0), fit_random_walk, {'q': 2e-5}),
    'gauss_markov': (GaussMarkov(6e-4, 40.0), fit_gauss_markov, {'sigma': 6e-4, 'tau': 40.0}),
    'autoregressive': (Autoregressive((-1.7132, 0.71415), 7e-5, 1.0), lambda d: fit_autoregressive(d, 2),
                       {'a_1': -1.7132, 'a_2': 0.71415, 'b0': 7e-5}),
}


def simulated_averages(model, n, seed, rate=10):
    rng = np.random.default_rng(seed)
    x = simulate(model, n * rate, 1 / rate, rng) if model else np.zeros(n * rate)
    return average([x + 0.01 + DENSITY * np.sqrt(rate) * rng.standard_normal(n * rate)], rate, 1 / rate)


@pytest.mark.parametrize('name', SENSORS)
def test_intervals_cover_the_truth(name):
    # given 25 sensors with known parameters; the larger study (docs/characterize.md) is this one with more seeds
    model, fit, truth = SENSORS[name]
    truth = {**truth, 'noise_density': DENSITY}
    hits = dict.fromkeys(truth, 0)
    for seed in range(25):
        estimates = fit(simulated_averages(model, 1200, [seed, 7])).estimates
        for key, value in truth.items():
            hits[key] += estimates[key].lower <= value <= estimates[key].upper
    # then each 95 % interval holds the truth; fewer than 20 of 25 has a probability of 0.02 %
    assert min(hits.values()) >= 20, hits


def test_intervals_are_not_needlessly_wide():
    # Cramer-Rao: white noise density from n means has a relative sigma of about 1 / sqrt(2 n)
    estimate = fit_random_walk(simulated_averages(RandomWalk(2e-5, 0.0), 2400, 1)).estimates['noise_density']
    assert estimate.sigma / estimate.value == pytest.approx(1 / np.sqrt(2 * 2400), rel=0.15)


def test_white_noise_alone_is_called_that():
    # 30 recordings of white noise: a slow error claimed in one at the most (0.1 % each)
    claims = sum(f(simulated_averages(None, 1000, [s, 3]), intervals=False).significant
                 for s in range(30) for f in (fit_random_walk, fit_gauss_markov))
    assert claims <= 1
    fit = fit_random_walk(simulated_averages(None, 1000, [1, 3]))
    assert fit.estimates['q'].lower == 0.0 and fit.estimates['q'].upper < 1e-5
    assert fit_white(simulated_averages(None, 1000, [1, 3])).noise_density == pytest.approx(DENSITY, rel=0.08)


def test_random_walk_gives_gauss_markov_an_open_interval():
    estimates = fit_gauss_markov(simulated_averages(RandomWalk(5e-5, 0.0), 1500, 5)).estimates
    assert estimates['tau'].upper == np.inf and estimates['sigma'].upper == np.inf
    assert estimates['driving_noise'].lower < 5e-5 < estimates['driving_noise'].upper


def test_autoregressive_fit_returns_the_slow_process_at_any_interval():
    data = simulated_averages(GaussMarkov(1e-3, 200.0), 10_000, 8)
    for factor in (1, 2, 5):
        fit = fit_autoregressive(data.coarser(factor), 1, intervals=False)
        assert -factor / np.log(-fit.model.coefficients[0]) == pytest.approx(200, rel=0.4)


def test_too_few_averages_are_refused():
    with pytest.raises(ValueError, match='too few for a fit'):
        fit_random_walk(Averages(np.zeros(10), np.zeros(10, int), 1.0))
