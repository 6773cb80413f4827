"""The three sensor error models of the paper (section 3), each as a small linear system.

    x(t + dt) = A(dt) x(t) + w,   w ~ N(0, Q(dt)),   sensor error = c x,   x(0) ~ N(0, initial covariance)

White noise of the sensor (angle and velocity random walk) is no part of them: it drives velocity and yaw directly.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RandomWalk:
    """Random walk, Eq. 11 and 12: the bias wanders without bound.

    q: driving noise, unit of the sensor per sqrt(s). initial_sigma: standard deviation at the start.
    """

    q: float
    initial_sigma: float
    order = 1
    interval = None  #: continuous in time

    def transition(self, dt: float) -> np.ndarray:
        return np.ones((1, 1))

    def process_noise(self, dt: float) -> np.ndarray:
        return np.full((1, 1), self.q**2 * dt)

    def initial_covariance(self) -> np.ndarray:
        return np.full((1, 1), self.initial_sigma**2)


@dataclass(frozen=True)
class GaussMarkov:
    """First-order Gauss-Markov process, Eq. 13 and 14: autocorrelation sigma^2 exp(-|t| / tau).

    sigma: standard deviation, unit of the sensor. tau: correlation time, s.
    """

    sigma: float
    tau: float
    order = 1
    interval = None  #: continuous in time

    def transition(self, dt: float) -> np.ndarray:
        return np.full((1, 1), math.exp(-dt / self.tau))

    def process_noise(self, dt: float) -> np.ndarray:
        return np.full((1, 1), self.sigma**2 * -math.expm1(-2 * dt / self.tau))

    def initial_covariance(self) -> np.ndarray:
        return np.full((1, 1), self.sigma**2)


@dataclass(frozen=True)
class Autoregressive:
    """Autoregressive process AR(p), Eq. 15: y(n) = -a_1 y(n-1) - ... - a_p y(n-p) + b0 w(n).

    coefficients: (a_1, ..., a_p), signs as in Eq. 15. b0: driving noise, unit of the sensor.
    interval: the sampling interval T_s the model belongs to, s; it steps once per interval and holds in between.
    State: y(n), y(n-1), ..., y(n-p+1). Raises ValueError for a model that is not stable.
    """

    coefficients: tuple[float, ...]
    b0: float
    interval: float

    def __post_init__(self):
        if self.order == 0:
            raise ValueError('an autoregressive model needs at least one coefficient')
        radius = np.abs(self.poles()).max()
        if radius >= 1:
            raise ValueError(f'the autoregressive model with coefficients {list(self.coefficients)} is not stable: '
                             f'a pole at radius {radius:.6g}')

    @property
    def order(self) -> int:
        return len(self.coefficients)

    def poles(self) -> np.ndarray:
        """Poles in the z plane; stable when all lie inside the unit circle."""
        return np.roots([1.0, *self.coefficients])

    def transition(self, dt: float | None = None) -> np.ndarray:
        """The companion matrix of one step; `dt` plays no part."""
        companion = np.eye(self.order, k=-1)
        companion[0] = -np.asarray(self.coefficients)
        return companion

    def process_noise(self, dt: float | None = None) -> np.ndarray:
        noise = np.zeros((self.order, self.order))
        noise[0, 0] = self.b0**2
        return noise

    def initial_covariance(self) -> np.ndarray:
        """The stationary covariance: the solution of P = A P A^T + Q."""
        a = self.transition()
        p = self.order
        stacked = np.linalg.solve(np.eye(p * p) - np.kron(a, a), self.process_noise().ravel())
        return stacked.reshape(p, p)


Model = RandomWalk | GaussMarkov | Autoregressive


def simulate(model: Model, n: int, dt: float, rng: np.random.Generator) -> np.ndarray:
    """The sensor error (n,) of `model` at n samples dt apart, the first drawn from the initial covariance.

    An autoregressive model whose interval is longer than dt holds its value in between, as in the filter.
    """
    from scipy.signal import lfilter

    if isinstance(model, Autoregressive):
        return _simulate_autoregressive(model, n, dt, rng)
    transition = model.transition(dt)[0, 0]
    driving = math.sqrt(model.process_noise(dt)[0, 0]) * rng.standard_normal(n)
    driving[0] = math.sqrt(model.initial_covariance()[0, 0]) * rng.standard_normal()
    return lfilter([1.0], [1.0, -transition], driving)


def _simulate_autoregressive(model: Autoregressive, n: int, dt: float, rng) -> np.ndarray:
    from scipy.signal import lfilter, lfiltic

    step = np.floor(np.arange(n) * dt / model.interval + 1e-9).astype(np.int64)
    start = rng.multivariate_normal(np.zeros(model.order), model.initial_covariance())
    denominator = [1.0, *model.coefficients]
    state = lfiltic([model.b0], denominator, y=start)
    later, _ = lfilter([model.b0], denominator, rng.standard_normal(step[-1]), zi=state)
    return np.concatenate([start[:1], later])[step]
