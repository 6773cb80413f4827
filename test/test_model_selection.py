"""Prediction of held-out data against theory, and recommendations where the right model is known."""
import numpy as np
import pytest

from mems_ins_fusion.characterization.autocorrelation import ljung_box
from mems_ins_fusion.characterization.likelihood import Averages
from mems_ins_fusion.characterization.selection import overall, predict, recommend
from mems_ins_fusion.sensor_errors.models import Autoregressive, GaussMarkov, RandomWalk, simulate

N = 0.5


def data(model, n, seed):
    rng = np.random.default_rng(seed)
    return Averages(3.0 + simulate(model, n, 1.0, rng) + N * rng.standard_normal(n), np.zeros(n, int), 1.0)


def test_prediction_error_of_a_perfect_model_is_that_of_theory():
    # given a negligible slow error: the mean over h s of white noise cannot be predicted, and has sigma N / sqrt(h)
    d = data(GaussMarkov(1e-6, 10.0), 100_000, 1)
    p = predict(d, 60_000, 'x', GaussMarkov(1e-6, 10.0), N)
    np.testing.assert_allclose(p.horizon_rmse, N / np.sqrt(p.horizons), rtol=0.08)
    assert p.one_step_rmse == pytest.approx(N, rel=0.02)
    assert p.score == pytest.approx(-0.5 * np.log(2 * np.pi * N**2) - 0.5, abs=0.02)
    assert p.whiteness_p > 0.01


def test_residual_of_the_right_model_is_white_and_normal_and_of_a_wrong_one_not():
    truth = Autoregressive((-1.5, 0.56), 0.3, 1.0)
    d = data(truth, 20_000, 2)
    right = predict(d, 12_000, 'right', truth, N)
    wrong = predict(d, 12_000, 'wrong', RandomWalk(0.05, 0.0), N)
    assert right.whiteness_p > 0.01 and right.residual.std() == pytest.approx(1, abs=0.03)
    assert wrong.whiteness_p < 1e-6
    assert np.all(right.horizon_rmse <= wrong.horizon_rmse)


def test_right_model_is_recommended_where_the_data_decide():
    truth = Autoregressive((-1.5, 0.56), 0.3, 1.0)
    d = data(truth, 20_000, 3)
    judged = [predict(d, 12_000, 'random_walk', RandomWalk(0.3, 0.0), N),
              predict(d, 12_000, 'autoregressive', truth, N)]
    answer = recommend(judged, True)
    assert answer.model == 'autoregressive' and answer.decided
    assert overall([judged, judged]) == 'autoregressive'


def test_simplest_is_recommended_and_doubt_is_told_where_they_do_not():
    # given a random walk, and a Gauss-Markov process that is one for practical purposes
    d = data(RandomWalk(0.05, 0.0), 3000, 4)
    judged = [predict(d, 1800, 'random_walk', RandomWalk(0.05, 0.0), N),
              predict(d, 1800, 'gauss_markov', GaussMarkov(0.05 * np.sqrt(1e6 / 2), 1e6), N)]
    answer = recommend(judged, True)
    assert answer.model == 'random_walk' and not answer.decided
    assert 'cannot decide between random walk and Gauss-Markov' in answer.text
    assert 'no slow error' in recommend(judged, False).text


def test_ljung_box_has_its_level():
    # p-values of white noise are uniform: 5 % below 0.05, here of 400
    rng = np.random.default_rng(5)
    below = np.mean([ljung_box(rng.standard_normal(500), 20) < 0.05 for _ in range(400)])
    assert 0.02 < below < 0.09
