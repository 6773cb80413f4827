"""Autocorrelation against its definition, and the Gauss-Markov fit on a slow process under white noise."""
import numpy as np
import pytest

from mems_ins_fusion.characterization.autocorrelation import autocorrelation, fit_gauss_markov_autocorrelation
from mems_ins_fusion.characterization.likelihood import Averages
from mems_ins_fusion.sensor_errors.models import GaussMarkov, simulate


def test_autocorrelation_is_that_of_the_definition_also_with_missing_samples():
    x = np.random.default_rng(1).standard_normal(200)
    x[[5, 6, 90]] = np.nan
    values = autocorrelation([x, x[:50]], 60)
    for lag in (0, 1, 7, 60):
        products = np.concatenate([part[lag:] * part[:len(part) - lag] for part in (x, x[:50]) if len(part) > lag])
        assert values[lag] == pytest.approx(np.nanmean(products), rel=1e-9)


def data(tau, sigma, white, n, seed):
    rng = np.random.default_rng(seed)
    z = 5.0 + simulate(GaussMarkov(sigma, tau), n, 1.0, rng) + white * rng.standard_normal(n)
    return Averages(z, np.zeros(n, int), 1.0)


def test_fit_returns_the_slow_process_and_not_the_white_noise():
    # given white noise of three times the amplitude of a process of 100 s
    fit = fit_gauss_markov_autocorrelation(data(100.0, 1.0, 3.0, 20_000, 2))
    assert fit.tau.lower < 100 < fit.tau.upper and fit.tau.value == pytest.approx(100, rel=0.35)
    assert fit.sigma.lower < 1 < fit.sigma.upper and fit.sigma.value == pytest.approx(1, rel=0.2)
    assert fit.white_variance == pytest.approx(9, rel=0.05)


def test_intervals_cover_the_truth():
    # 30 recordings of 50 correlation times; fewer than 24 hits have a probability of 0.1 % at 95 %, 7 % at 90 %
    fits = [fit_gauss_markov_autocorrelation(data(20.0, 1.0, 1.0, 1000, [s, 3])) for s in range(30)]
    assert sum(f.tau.lower < 20 < f.tau.upper for f in fits) >= 24
    assert sum(f.sigma.lower < 1 < f.sigma.upper for f in fits) >= 24


def test_short_data_are_refused():
    with pytest.raises(ValueError, match='too few for an autocorrelation'):
        fit_gauss_markov_autocorrelation(data(5.0, 1.0, 1.0, 30, 1))
