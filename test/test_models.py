"""The three sensor error models: discretization, stationary covariance, stability, and what they simulate."""
from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov
from scipy.stats import chi2

from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.sensor_errors.models import Autoregressive, GaussMarkov, RandomWalk, simulate

STABLE = [(-0.9,), (-1.7132, 0.71415), (-1.1, 0.3, -0.05), (-0.5, 0.2, 0.1, -0.3)]


def van_loan(f, g_squared, dt):
    """Transition and process noise of dx = f x dt + g dW: C. Van Loan, IEEE Trans. Automatic Control 23 (1978)."""
    block = expm(np.array([[-f, g_squared], [0.0, f]]) * dt)
    transition = block[1, 1]
    return transition, transition * block[0, 1]


@pytest.mark.parametrize('dt', [1e-4, 0.01, 1.0, 100.0])
def test_continuous_models_are_discretized_exactly(dt):
    for model, f, g_squared in ((GaussMarkov(0.05, 30.0), -1 / 30.0, 2 * 0.05**2 / 30.0),
                                (RandomWalk(0.003, 0.1), 0.0, 0.003**2)):
        transition, noise = van_loan(f, g_squared, dt)
        assert model.transition(dt)[0, 0] == pytest.approx(transition, rel=1e-13)
        assert model.process_noise(dt)[0, 0] == pytest.approx(noise, rel=1e-11)


def test_one_long_step_is_many_short_ones():
    for model in (GaussMarkov(0.05, 30.0), RandomWalk(0.003, 0.1)):
        p = model.initial_covariance()
        for _ in range(100):
            p = model.transition(0.1) @ p @ model.transition(0.1).T + model.process_noise(0.1)
        a = model.transition(10.0)
        assert p == pytest.approx(a @ model.initial_covariance() @ a.T + model.process_noise(10.0), rel=1e-12)


@pytest.mark.parametrize('coefficients', STABLE)
def test_stationary_covariance_solves_the_lyapunov_equation(coefficients):
    model = Autoregressive(coefficients, 0.01, 1.0)
    expected = solve_discrete_lyapunov(model.transition(), model.process_noise())
    assert model.initial_covariance() == pytest.approx(expected, rel=1e-8)


def test_gauss_markov_starts_stationary():
    model = GaussMarkov(0.05, 30.0)
    a, q = model.transition(7.0)[0, 0], model.process_noise(7.0)[0, 0]
    assert solve_discrete_lyapunov(np.array([[a]]), np.array([[q]])) == pytest.approx(model.initial_covariance())


def test_autoregressive_companion_is_eq_15():
    # given past values and no noise, the next one is the printed sum
    past = np.array([0.3, -0.2, 0.5])
    model = Autoregressive((-1.1, 0.3, -0.05), 0.01, 1.0)
    after = model.transition() @ past
    assert after[0] == pytest.approx(1.1 * 0.3 - 0.3 * -0.2 + 0.05 * 0.5)
    assert np.array_equal(after[1:], past[:2])
    assert np.array_equal(np.argwhere(model.process_noise()), [[0, 0]])
    assert model.process_noise()[0, 0] == 0.01**2


def test_autoregressive_of_order_one_is_gauss_markov():
    # given the same decay over T_s
    gm = GaussMarkov(0.05, 30.0)
    a = math.exp(-1 / 30.0)
    ar = Autoregressive((-a,), 0.05 * math.sqrt(1 - a**2), 1.0)
    assert ar.transition(1.0) == pytest.approx(gm.transition(1.0))
    assert ar.process_noise(1.0) == pytest.approx(gm.process_noise(1.0))
    assert ar.initial_covariance() == pytest.approx(gm.initial_covariance())


@pytest.mark.parametrize('coefficients', [(-1.0,), (-2.0, 1.0), (0.0, 1.1), (-1.7, 0.69)])
def test_unstable_autoregressive_model_is_refused(coefficients):
    with pytest.raises(ValueError, match='not stable: a pole at radius'):
        Autoregressive(coefficients, 0.01, 1.0)


def test_autoregressive_model_without_coefficients_is_refused():
    with pytest.raises(ValueError, match='at least one coefficient'):
        Autoregressive((), 0.01, 1.0)


@pytest.mark.parametrize('model', [GaussMarkov(0.05, 2.0), RandomWalk(0.003, 0.01),
                                   Autoregressive((-1.2, 0.4), 0.01, 0.25), Autoregressive((-0.9,), 0.01, 0.1)])
def test_simulated_errors_have_the_models_covariances(model):
    # given 1500 draws of 3 s
    dt, n = 0.1, 31
    rng = np.random.default_rng(2)
    draws = np.array([simulate(model, n, dt, rng) for _ in range(1500)])
    for k in (0, 1, 30):
        p, cross = model.initial_covariance(), model.initial_covariance()
        if model.interval is None:
            a, q = model.transition(k * dt), model.process_noise(k * dt)
            p, cross = a @ p @ a.T + q, a @ p
        else:
            steps = math.floor(k * dt / model.interval + 1e-9)
            cross = np.linalg.matrix_power(model.transition(), steps) @ p
        low, high = chi2.ppf([1e-4, 1 - 1e-4], len(draws)) / len(draws)
        assert low < draws[:, k].var() / p[0, 0] < high
        correlation = cross[0, 0] / math.sqrt(p[0, 0] * model.initial_covariance()[0, 0])
        assert np.corrcoef(draws[:, 0], draws[:, k])[0, 1] == pytest.approx(correlation, abs=4 / math.sqrt(1500))


def test_models_from_parameters_per_axis():
    values = table.check({'accelerometer.gauss_markov.sigma': [1.0, 2.0, 3.0], 'gyroscope.random_walk.q': [0.5],
                               'accelerometer.autoregressive.coefficients': [-0.9, -0.8, -0.7],
                               'accelerometer.autoregressive.order': 1,
                               'accelerometer.autoregressive.b0': [1.0, 2.0, 3.0],
                               'accelerometer.autoregressive.interval': 0.5})
    assert [m.sigma for m in GaussMarkov.from_parameters(values, 'accelerometer')] == [1, 2, 3]
    assert [m.q for m in RandomWalk.from_parameters(values, 'gyroscope')] == [0.5] * 3
    models = Autoregressive.from_parameters(values, 'accelerometer')
    assert [(m.coefficients, m.b0, m.interval) for m in models] == [((-0.9,), 1.0, 0.5), ((-0.8,), 2.0, 0.5),
                                                                    ((-0.7,), 3.0, 0.5)]


def test_three_coefficients_without_an_order_are_one_model_of_order_three():
    values = table.check({'gyroscope.autoregressive.coefficients': [-1.1, 0.3, -0.05]})
    assert [m.order for m in Autoregressive.from_parameters(values, 'gyroscope')] == [3, 3, 3]


def test_autoregressive_parameters_that_do_not_fit_are_refused_by_name():
    values = table.check({'gyroscope.autoregressive.coefficients': [-1.1, 0.3, -0.05, 0.1],
                               'gyroscope.autoregressive.order': 2})
    with pytest.raises(ParameterError, match="'gyroscope.autoregressive.coefficients' must have 2 or 6 values"):
        Autoregressive.from_parameters(values, 'gyroscope')
    values = table.check({'accelerometer.autoregressive.coefficients': [-1.1]})
    with pytest.raises(ParameterError, match="'accelerometer.autoregressive.coefficients'.*not stable"):
        Autoregressive.from_parameters(values, 'accelerometer')
