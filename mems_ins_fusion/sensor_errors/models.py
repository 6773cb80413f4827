"""The three sensor error models of the paper (section 3), each as a small linear system.

    x(t + dt) = A(dt) x(t) + w,   w ~ N(0, Q(dt)),   sensor error = c x,   x(0) ~ N(0, initial covariance)

White noise of the sensor (angle and velocity random walk) is not part of the models: it drives velocity and yaw
directly.
"""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.errors import InputError

from ..parameters.parameter import ParameterError


def per_axis(parameters: Mapping, name: str) -> list[float]:
    """The values of a parameter that holds one value for all axes or three, as three: sensor axes x, y, z."""
    values = parameters[name]
    return list(values) * 3 if len(values) == 1 else list(values)


class Model:
    """Base class of the sensor error models. A new model is a subclass with the methods of those below, and a line in
    MODELS.

    The attributes are those that the filter's compiled prediction needs: a state decays by exp(-decay dt), and its
    variance grows by walk dt + variance (1 - exp(-2 decay dt)); or, with an interval, it makes one autoregressive step
    with coefficients and b0 in each interval.
    """

    order = 1
    #: s, interval of the autoregressive steps; None: the model is continuous in time
    interval: float | None = None
    decay = walk = variance = b0 = 0.0
    coefficients: tuple[float, ...] = ()
    #: whether the initial value of the state is the turn-on bias; else the turn-on bias is a separate constant
    holds_turn_on = False
    #: name of the parameter for the size of the error, without the sensor's name
    level = ''

    @classmethod
    def from_parameters(cls, parameters: Mapping, sensor: str) -> list[Model]:
        """The models of a sensor's x, y and z axes. parameters: checked, by full name. sensor: accelerometer or
        gyroscope."""
        raise NotImplementedError

    def of_order(self, order: int) -> Model:
        """The same process with `order` states."""
        return self

    def with_tilt(self, sigma: float, time: float) -> tuple[Model, float]:
        """This model with an added Gauss-Markov error of standard deviation `sigma` and correlation time `time`, s.

        Returns the model, and the part of the added error that is to be treated as white noise: its density squared.
        """
        return self, 10.0 * sigma**2  # changes the velocity by as much in ten seconds as a constant of size sigma


@dataclass(frozen=True)
class RandomWalk(Model):
    """Random walk, Eq. 11 and 12: the bias wanders without bound.

    q: driving noise, unit of the sensor per sqrt(s). initial_sigma: standard deviation at the start.
    """

    q: float
    initial_sigma: float
    holds_turn_on = True
    level = 'random_walk.q'

    @classmethod
    def from_parameters(cls, parameters: Mapping, sensor: str) -> list[RandomWalk]:
        sigma = per_axis(parameters, f'{sensor}.initial_sigma')
        return [cls(q, s) for q, s in zip(per_axis(parameters, f'{sensor}.random_walk.q'), sigma)]

    @property
    def walk(self) -> float:
        return self.q**2

    def with_tilt(self, sigma, time):
        return RandomWalk(math.hypot(self.q, sigma * math.sqrt(2 / time)), math.hypot(self.initial_sigma, sigma)), 0.0

    def transition(self, dt: float) -> np.ndarray:
        return np.ones((1, 1))

    def process_noise(self, dt: float) -> np.ndarray:
        return np.full((1, 1), self.q**2 * dt)

    def initial_covariance(self) -> np.ndarray:
        return np.full((1, 1), self.initial_sigma**2)


@dataclass(frozen=True)
class GaussMarkov(Model):
    """First-order Gauss-Markov process, Eq. 13 and 14: autocorrelation sigma^2 exp(-|t| / tau).

    sigma: standard deviation, unit of the sensor. tau: correlation time, s.
    """

    sigma: float
    tau: float
    level = 'gauss_markov.sigma'

    @classmethod
    def from_parameters(cls, parameters: Mapping, sensor: str) -> list[GaussMarkov]:
        tau = per_axis(parameters, f'{sensor}.gauss_markov.tau')
        return [cls(s, t) for s, t in zip(per_axis(parameters, f'{sensor}.gauss_markov.sigma'), tau)]

    @property
    def decay(self) -> float:
        return 1 / self.tau

    @property
    def variance(self) -> float:
        return self.sigma**2

    def with_tilt(self, sigma, time):
        total = math.hypot(self.sigma, sigma)
        share = (sigma / total) ** 2  # weights of the two correlation times: their shares of the variance
        return GaussMarkov(total, math.exp(share * math.log(time) + (1 - share) * math.log(self.tau))), 0.0

    def transition(self, dt: float) -> np.ndarray:
        return np.full((1, 1), math.exp(-dt / self.tau))

    def process_noise(self, dt: float) -> np.ndarray:
        return np.full((1, 1), self.sigma**2 * -math.expm1(-2 * dt / self.tau))

    def initial_covariance(self) -> np.ndarray:
        return np.full((1, 1), self.sigma**2)


@dataclass(frozen=True)
class Autoregressive(Model):
    """Autoregressive process AR(p), Eq. 15: y(n) = -a_1 y(n-1) - ... - a_p y(n-p) + b0 w(n).

    coefficients: (a_1, ..., a_p), signs as in Eq. 15. b0: driving noise, unit of the sensor.
    interval: the sampling interval T_s the model belongs to, s; it steps once per interval and holds in between.
    State: y(n), y(n-1), ..., y(n-p+1). Raises InputError for a model that is not stable.
    """

    coefficients: tuple[float, ...]
    b0: float
    interval: float
    level = 'autoregressive.b0'

    @classmethod
    def from_parameters(cls, parameters: Mapping, sensor: str) -> list[Autoregressive]:
        """As `Model.from_parameters`. Raises ParameterError for a model that is not stable or whose order is unclear.
        """
        name = f'{sensor}.autoregressive.coefficients'
        values = parameters[name]
        order = parameters[f'{sensor}.autoregressive.order'] or len(values)
        if len(values) not in (order, 3 * order):
            raise ParameterError(f"parameter '{name}' must have {order} or {3 * order} values for order {order}, got "
                                 f'{len(values)}')
        values = values * 3 if len(values) == order else values
        b0 = per_axis(parameters, f'{sensor}.autoregressive.b0')
        interval = parameters[f'{sensor}.autoregressive.interval']
        try:
            return [cls(tuple(values[i * order:(i + 1) * order]), b0[i], interval) for i in range(3)]
        except ValueError as error:
            raise ParameterError(f"parameter '{name}': {error}") from None

    def of_order(self, order):
        return Autoregressive((*self.coefficients, *[0.0] * (order - self.order)), self.b0, self.interval)

    def __post_init__(self):
        if self.order == 0:
            raise InputError('an autoregressive model needs at least one coefficient')
        radius = np.abs(self.poles()).max()
        if radius >= 1:
            raise InputError(f'the autoregressive model with coefficients {list(self.coefficients)} is not stable: '
                             f'a pole at radius {radius:.6g}')

    @property
    def order(self) -> int:
        return len(self.coefficients)

    def poles(self) -> np.ndarray:
        """Poles in the z plane; stable when all lie inside the unit circle."""
        return np.roots([1.0, *self.coefficients])

    def transition(self, dt: float | None = None) -> np.ndarray:
        """The companion matrix of one step; `dt` is not used."""
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


#: by the name of the parameter `sensor_error_model`
MODELS: dict[str, type[Model]] = {'random_walk': RandomWalk, 'gauss_markov': GaussMarkov,
                                  'autoregressive': Autoregressive}


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


def gauss_markov_at(time: np.ndarray, tau: float, white: np.ndarray) -> np.ndarray:
    """A first-order Gauss-Markov process (n, k) with the correlation time `tau`, s, at `time` (n,), s, of any spacing.

    white: (n, k) white noise that drives it. The process begins with the first row of `white`, and has the standard
    deviation of `white`.
    """
    error = white.copy()
    for i, decay in enumerate(np.exp(-np.diff(time) / tau)):
        error[i + 1] = decay * error[i] + math.sqrt(1 - decay**2) * white[i + 1]
    return error


def _simulate_autoregressive(model: Autoregressive, n: int, dt: float, rng) -> np.ndarray:
    from scipy.signal import lfilter, lfiltic

    step = np.floor(np.arange(n) * dt / model.interval + 1e-9).astype(np.int64)
    start = rng.multivariate_normal(np.zeros(model.order), model.initial_covariance())
    denominator = [1.0, *model.coefficients]
    state = lfiltic([model.b0], denominator, y=start)
    later, _ = lfilter([model.b0], denominator, rng.standard_normal(step[-1]), zi=state)
    return np.concatenate([start[:1], later])[step]
