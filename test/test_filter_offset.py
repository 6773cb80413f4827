"""The Kalman filter of an offset in the plane (filter/trust/offset.py) against one with matrices."""
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from mems_ins_fusion.filter.trust import offset
from mems_ins_fusion.filter.trust.offset import Offset, Walk

WALK = Walk(velocity=0.1, acceleration=0.2, sigma=1.3, correlation_time=7.0)


def an_offset():
    """Twelve columns with any numbers; and its state (3, 2) and covariance (3, 3)."""
    rng = np.random.default_rng(1)
    root, state = rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    p = root @ root.T
    columns = np.concatenate([state.ravel(), [p[0, 0], p[0, 1], p[1, 1], p[0, 2], p[1, 2], p[2, 2]]])
    assert len(columns) == Offset.SIZE
    return columns, state, p


def covariance(columns):
    xx, xv, vv, xa, va, aa = columns[Offset.VARIANCE:]
    return np.array([[xx, xv, xa], [xv, vv, va], [xa, va, aa]])


@pytest.mark.parametrize('dt', [0.05, 0.2, 1.0])
def test_it_is_predicted_as_the_matrix_exponential_says(dt):
    # given an offset whose acceleration is a Gauss-Markov process (C. F. Van Loan, "Computing integrals involving the
    # matrix exponential", IEEE Trans. Automatic Control 23, 1978)
    columns, state, p = an_offset()
    dynamics = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / WALK.correlation_time]])
    density = np.diag([WALK.velocity, WALK.acceleration, 2.0 * WALK.sigma**2 / WALK.correlation_time])
    both = expm(dt * np.block([[-dynamics, density], [np.zeros((3, 3)), dynamics.T]]))
    step = both[3:, 3:].T
    offset.predict(columns, 0, dt, WALK)
    np.testing.assert_allclose(columns[:6].reshape(3, 2), step @ state)
    # then so is its covariance, but for the noise of the acceleration, which is that of a shorter interval
    expected = step @ p @ step.T + step @ both[:3, 3:]
    np.testing.assert_allclose(covariance(columns), expected, rtol=0.02 * dt)


def test_it_is_corrected_as_by_matrices():
    columns, state, p = an_offset()
    z, variance = np.array([1.5, -0.7]), 2.0
    s = p[0, 0] + variance
    offset.correct(columns, 0, *z, variance)
    gain = p[:, 0] / s
    np.testing.assert_allclose(columns[:6].reshape(3, 2), state + np.outer(gain, z - state[0]))
    np.testing.assert_allclose(covariance(columns), p - np.outer(gain, p[0]), atol=1e-12)


def test_an_innovation_is_as_likely_along_the_velocity_as_a_time_offset_makes_it():
    z, late = np.array([1.5, -0.7]), np.array([0.6, 0.8])
    expected = multivariate_normal(cov=2.0 * np.eye(2) + np.outer(late, late)).pdf(z)
    assert offset.density(*z, 2.0, *late) == pytest.approx(expected)
