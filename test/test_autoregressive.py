"""The AR estimators against known processes, least squares and statsmodels; the trap of raw samples."""
import warnings

import numpy as np
import pytest

from mems_ins_fusion.characterization import autoregressive as ar
from mems_ins_fusion.sensor_errors.models import Autoregressive, GaussMarkov, simulate

KNOWN = Autoregressive((-1.5, 0.7), 0.3, 1.0)


def known(n, seed=1):
    return simulate(KNOWN, n, 1.0, np.random.default_rng(seed))


@pytest.mark.parametrize('method', ar.METHODS.values())
def test_known_process_is_recovered(method):
    # standard deviation of the estimates: sqrt((1 - a_2^2) / n), the asymptotic result for AR(2)
    n = 50_000
    fit = method(known(n), 2)
    np.testing.assert_allclose(fit.coefficients, KNOWN.coefficients, atol=4 * np.sqrt((1 - 0.7**2) / n))
    assert fit.b0 == pytest.approx(0.3, rel=4 / np.sqrt(2 * n))
    assert fit.stable and fit.radius == pytest.approx(np.sqrt(0.7), abs=0.02)


def test_estimates_are_those_of_statsmodels():
    linear_model = pytest.importorskip('statsmodels.regression.linear_model',
                                       reason='statsmodels, the judge of this test, is not installed')
    x = known(500)
    coefficients, variance = linear_model.burg(x, 4, demean=False)
    np.testing.assert_allclose(ar.burg(x, 4).coefficients, -coefficients, rtol=1e-9)
    assert ar.burg(x, 4).b0**2 == pytest.approx(variance, rel=0.01)  # the power of the first samples counts otherwise
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', FutureWarning)
        coefficients, sigma = linear_model.yule_walker(x, 4, method='mle', demean=False)
    np.testing.assert_allclose(ar.yule_walker(x, 4).coefficients, -coefficients, rtol=1e-9)
    assert ar.yule_walker(x, 4).b0 == pytest.approx(sigma)


def test_covariance_method_is_least_squares():
    x = known(300)
    lagged = np.stack([x[1:-1], x[:-2]], axis=1)
    expected, residual, *_ = np.linalg.lstsq(lagged, x[2:], rcond=None)
    fit = ar.covariance(x, 2)
    np.testing.assert_allclose(fit.coefficients, -expected, rtol=1e-9)
    assert fit.b0**2 == pytest.approx(residual[0] / 298)


def test_instability_is_told():
    growing = 1.1 ** np.arange(40)
    fit = ar.covariance(growing, 1)
    assert not fit.stable and fit.radius == pytest.approx(1.1) and fit.time_constant(1.0) == np.inf
    assert ar.burg(growing, 1).stable and ar.yule_walker(growing, 1).stable


@pytest.mark.parametrize('method', ar.METHODS.values())
def test_missing_samples_are_not_bridged(method):
    x = known(40_000)
    x[::100] = np.nan
    np.testing.assert_allclose(method(x, 2).coefficients, KNOWN.coefficients, atol=0.03)


def test_order_curve_finds_the_order():
    x = known(20_000)
    curve = ar.order_curve(x[:12_000], x[12_000:], 8)
    assert curve.elbow() == 2
    assert curve.orders[curve.bic.argmin()] == 2
    assert curve.rmse[1] == pytest.approx(0.3, rel=0.03)
    # FPE and AIC agree for long records: n log FPE = AIC + constant (Kay, section 7.8)
    np.testing.assert_allclose(12_000 * np.log(curve.fpe / curve.fpe[0]), curve.aic - curve.aic[0], atol=0.2)


def test_raw_samples_say_nothing_about_the_slow_error():
    # given a sensor with a bias of correlation time 300 s under strong white noise, 100 Hz
    rng = np.random.default_rng(3)
    x = simulate(GaussMarkov(1e-3, 300.0), 100_000, 0.01, rng) + 3e-3 * rng.standard_normal(100_000)
    fits = [method(x - x.mean(), 2) for method in ar.METHODS.values()]
    # then all three methods agree with each other, and are useless
    for fit in fits[1:]:
        np.testing.assert_allclose(fit.coefficients, fits[0].coefficients, atol=1e-3)
    assert all(fit.time_constant(0.01) < 0.1 for fit in fits)


def test_too_few_samples_are_refused():
    with pytest.raises(ValueError, match='too few for an AR'):
        ar.burg(np.zeros(4), 2)
    with pytest.raises(ValueError, match='at least 1'):
        ar.burg(np.zeros(40), 0)
