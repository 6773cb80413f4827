"""Maximum likelihood fits of white noise plus each of the three sensor error models, with their uncertainty.

Intervals are profile likelihood intervals (Wilks): if the recording contains only a few correlation times, the
likelihood of the correlation time is far from a parabola, and an interval from its curvature would be too short on the
long side. If the profile does not fall by _DROP within the range that is searched, the interval is open (0 or
infinity).
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..errors import InputError
from ..sensor_errors.models import Autoregressive, GaussMarkov, Model, RandomWalk
from .likelihood import Averages, autoregressive_space, log_likelihood, relative_likelihood, scaled, state_space

#: drop of the log likelihood at the ends of a 95 % interval: half the 0.95 quantile of chi-square, 1 degree
_DROP = 1.9207
#: p-value of white noise alone (likelihood ratio test) below which a slow error is significant
SIGNIFICANCE = 0.001


@dataclass(frozen=True)
class IntervalEstimate:
    """A value and its 95 % interval, in `unit`."""

    value: float
    lower: float
    upper: float
    unit: str

    @property
    def sigma(self) -> float:
        """One sigma of a normal distribution with this interval; infinite where the interval is open."""
        return (self.upper - self.lower) / (2 * 1.96)


@dataclass(frozen=True)
class ModelFit:
    """White noise plus one model, fitted to averages.

    model: RandomWalk, GaussMarkov, Autoregressive, or None for white noise alone. noise_density: unit/sqrt(Hz).
    log_likelihood: nats (restricted). estimates: by parameter name. p_value: of white noise alone (likelihood ratio).
    interval: averaging interval of the data, s. n: intervals present.
    """

    model: Model | None
    noise_density: float
    log_likelihood: float
    estimates: dict[str, IntervalEstimate]
    p_value: float
    interval: float
    n: int

    @property
    def significant(self) -> bool:
        return self.p_value < SIGNIFICANCE

    @property
    def free_parameters(self) -> int:
        return 1 + {type(None): 0, RandomWalk: 1, GaussMarkov: 2}.get(
            type(self.model), getattr(self.model, 'order', 0) + 1)

    @property
    def bic(self) -> float:
        return -2 * self.log_likelihood + self.free_parameters * math.log(self.n)


def fit_white(data: Averages) -> ModelFit:
    """White noise alone."""
    value, density = relative_likelihood(data, state_space(None, 1.0, data.interval))
    n = _present(data)
    half = 1.96 * density / math.sqrt(2 * n)
    return ModelFit(None, density, value,
                    {'noise_density': IntervalEstimate(density, density - half, density + half, '/sqrt(Hz)')},
                    1.0, data.interval, n)


def fit_random_walk(data: Averages, intervals: bool = True) -> ModelFit:
    """White noise plus random walk: noise_density and q.

    intervals: whether to compute the 95 % intervals. Like the other fits, it raises InputError for fewer than 20
    averages.
    """
    _check(data)

    def space(log_ratio, density=1.0):
        return state_space(RandomWalk(density * math.exp(log_ratio), 0.0), density, data.interval)

    limits = _ratio_limits(data)
    starts = [[_log_ratio_of_walk(data, share)] for share in (1e-5, 1e-3, 0.1, 10.0)]
    (log_ratio,), value = _maximize(lambda t: relative_likelihood(data, space(*t))[0], starts, [limits])
    density = relative_likelihood(data, space(log_ratio))[1]
    q = density * math.exp(log_ratio)

    def cost(t):
        return -log_likelihood(data, state_space(RandomWalk(math.exp(t[1]), 0.0), math.exp(t[0]), data.interval))

    log_density = math.log(density)
    estimates = _profiles(cost, [log_density, math.log(q)],
                          [_noise_limits(density), (log_density + limits[0], log_density + limits[1])],
                          {'noise_density': '/sqrt(Hz)', 'q': '/sqrt(s)'}) if intervals else {}
    return ModelFit(RandomWalk(q, 0.0), density, value, estimates, _p_value(data, value, 1), data.interval,
                    _present(data))


def fit_gauss_markov(data: Averages, intervals: bool = True) -> ModelFit:
    """White noise plus first-order Gauss-Markov: noise_density, sigma and tau; with them the driving noise
    sigma sqrt(2/tau), which a recording determines far better than either.

    tau is sought between half the averaging interval and ten times the duration.
    """
    _check(data)

    def space(log_ratio, log_tau):
        return state_space(_from_driving(log_ratio, log_tau), 1.0, data.interval)

    starts = [[_log_ratio_of_walk(data, share), math.log(tau)]
              for tau in np.geomspace(3 * data.interval, data.duration / 3, 4) for share in (1e-3, 0.1, 10.0)]
    low, high = _ratio_limits(data)
    limits = [(low, high + 3), (math.log(data.interval / 2), math.log(10 * data.duration))]
    t, value = _maximize(lambda t: relative_likelihood(data, space(*t))[0], starts, limits)
    density = relative_likelihood(data, space(*t))[1]
    found = scaled(_from_driving(*t), density)
    p_value = _p_value(data, value, 2)
    estimates = _gauss_markov_intervals(data, density, found, limits) if intervals else {}
    return ModelFit(found, density, value, estimates, p_value, data.interval, _present(data))


def _from_driving(log_driving, log_tau):
    return GaussMarkov(math.exp(log_driving + log_tau / 2) / math.sqrt(2), math.exp(log_tau))


def _gauss_markov_intervals(data, density, found, limits):
    log_density = math.log(density)
    driving = found.sigma * math.sqrt(2 / found.tau)

    def cost(model, t):
        return -log_likelihood(data, state_space(model, math.exp(t[0]), data.interval))

    estimates = _profiles(lambda t: cost(_from_driving(t[1], t[2]), t), np.log([density, driving, found.tau]),
                          [_noise_limits(density), (log_density + limits[0][0], log_density + limits[0][1]), limits[1]],
                          {'noise_density': '/sqrt(Hz)', 'driving_noise': '/sqrt(s)', 'tau': 's'})
    sigma_limits = (math.log(found.sigma) - 8, math.log(found.sigma) + 5)
    estimates |= _profiles(lambda t: cost(GaussMarkov(math.exp(t[1]), math.exp(t[2])), t),
                           np.log([density, found.sigma, found.tau]),
                           [_noise_limits(density), sigma_limits, limits[1]], {'sigma': ''}, [1])
    if math.isinf(estimates['tau'].upper):  # as good as a random walk, whose variance has no bound
        estimates['sigma'] = replace(estimates['sigma'], upper=math.inf)
    return estimates


def fit_autoregressive(data: Averages, order: int, intervals: bool = True) -> ModelFit:
    """White noise plus AR(p) at the averaging interval of `data`: noise_density, a_1..a_p and b0.

    The reflection coefficients are fitted, so that the model is stable. The intervals come from the curvature of the
    likelihood: in the Fisher transform of the reflection coefficients it is nearly a parabola. If white noise alone
    explains the data (not significant), there are no intervals, as the coefficients are not determined.
    """
    return fit_autoregressive_orders(data, [order], intervals)[0]


def fit_autoregressive_orders(data: Averages, orders, intervals: bool = False) -> list[ModelFit]:
    """`fit_autoregressive` for several orders at little more than the cost of the highest."""
    _check(data)
    fits = []
    for t, value in _ar_maxima(data, max(orders)):
        order = len(t) - 1
        if order not in orders:
            continue
        density = relative_likelihood(data, _ar_space(data, t, 1.0))[1]
        found = Autoregressive(coefficients(np.tanh(t[:-1])), density * math.exp(t[-1]), data.interval)
        p_value = _p_value(data, value, order + 1)
        estimates = _ar_intervals(data, t, density) if intervals and p_value < SIGNIFICANCE else {}
        fits.append(ModelFit(found, density, value, estimates, p_value, data.interval, _present(data)))
    return fits


def _ar_space(data, t, density):
    return autoregressive_space(np.tanh(t[:-1]), density * math.exp(t[-1]), density, data.interval)


def _ar_maxima(data, highest):
    """The best (transformed reflection coefficients, log(b0/N)) of each order; the search for an order starts from the
    result of the order below."""
    slowest = math.atanh(math.exp(-data.interval / (10 * data.duration)))
    ratio_limits = (math.log(1e-3 * data.interval / data.duration), math.log(1e4))
    starts = [[-math.atanh(math.exp(-data.interval / tau)), 0.5 * math.log(share * 2 / tau)]
              for tau in np.geomspace(3 * data.interval, data.duration / 5, 3) for share in (0.1, 1.0, 10.0)]
    resonant = []
    for p in range(1, highest + 1):
        limits = [(-slowest, slowest)] * p + [ratio_limits]
        best, value = _maximize(lambda t: relative_likelihood(data, _ar_space(data, t, 1.0))[0], starts, limits,
                                resonant)
        yield best, value
        starts = [[*best[:-1], k, best[-1] + shift] for k, shift in ((0.0, 0.0), (0.8, -1.0), (0.4, -0.5))]
        starts += _two_pole_starts(data, p + 1)
        resonant = [[*best[:-1], -0.4, best[-1]]]  # for a vibration that is aliased to a fast oscillation by averaging


def _two_pole_starts(data, order):
    """A slow and a fast real pole, the slow error about as large as the white noise of one mean."""
    starts = []
    for slow in np.geomspace(10 * data.interval, data.duration / 5, 3):
        for fast in (2.0, 5.0):
            poles = np.zeros(order)
            poles[:2] = math.exp(-data.interval / slow), math.exp(-1 / fast)
            partial = reflections(np.poly(poles)[1:])
            starts.append([*np.arctanh(partial), 0.5 * math.log(1 / slow) + math.log(1 - poles[1])])
    return starts


def coefficients(partial) -> tuple[float, ...]:
    """a_1..a_p from reflection coefficients in (-1, 1): the step-up recursion of Levinson."""
    a = np.ones(1)
    for k in partial:
        a = np.concatenate([a, [0.0]])
        a = a + k * a[::-1]
    return tuple(float(v) for v in a[1:])


def reflections(a) -> np.ndarray:
    """The reflection coefficients of a_1..a_p: step-down."""
    a = np.concatenate([[1.0], a])
    found = []
    while len(a) > 1:
        k = a[-1]
        found.append(k)
        a = ((a - k * a[::-1]) / (1 - k**2))[:-1]
    return np.array(found[::-1])


def _ar_intervals(data, t, density):
    """Normal intervals from the Hessian at the maximum; noise_density and b0 in logarithms."""
    best = np.concatenate([t[:-1], [t[-1] + math.log(density), math.log(density)]])

    def cost(s):
        return -log_likelihood(data, _ar_space(data, [*s[:-2], s[-2] - s[-1]], math.exp(s[-1])))

    spread = _covariance(cost, best)
    order = len(t) - 1
    value = np.array(coefficients(np.tanh(best[:-2])))
    jacobian = np.array([(np.array(coefficients(np.tanh(best[:-2] + h))) - value) / 1e-6
                         for h in 1e-6 * np.eye(order)]).T
    sigma = np.sqrt(np.maximum(np.diag(jacobian @ spread[:order, :order] @ jacobian.T), 0.0))
    estimates = {f'a_{i + 1}': IntervalEstimate(float(a), float(a - 1.96 * s), float(a + 1.96 * s), '-')
                 for i, (a, s) in enumerate(zip(value, sigma))}
    for name, index, unit in (('b0', -2, ''), ('noise_density', -1, '/sqrt(Hz)')):
        half = 1.96 * math.sqrt(max(spread[index, index], 0.0))
        centre = math.exp(best[index])
        upper = centre * math.exp(half) if half < 50 else math.inf
        estimates[name] = IntervalEstimate(centre, centre * math.exp(-half), upper, unit)
    return estimates


def _covariance(cost, best, step=2e-3):
    """Inverse of the Hessian of `cost` by central differences; infinite in directions that the data do not determine.
    """
    d = len(best)
    e = step * np.eye(d)
    centre = cost(best)
    hessian = np.empty((d, d))
    for i in range(d):
        hessian[i, i] = (cost(best + e[i]) - 2 * centre + cost(best - e[i])) / step**2
        for j in range(i):
            hessian[i, j] = hessian[j, i] = (cost(best + e[i] + e[j]) - cost(best + e[i] - e[j])
                                             - cost(best - e[i] + e[j]) + cost(best - e[i] - e[j])) / (4 * step**2)
    values, vectors = np.linalg.eigh(hessian)
    return (vectors / np.maximum(values, 1e-6)) @ vectors.T


def _profiles(cost, best, limits, names, indices=None):
    """Profile likelihood intervals of parameters whose logarithms are `best`; names: those wanted, with units."""
    best = np.asarray(best, float)
    curvature = _covariance(cost, best)
    found = {}
    for index, (name, unit) in zip(indices or range(len(best)), names.items()):
        low, high = (_profile_end(cost, best, index, limits, curvature, side) for side in (-1, 1))
        found[name] = IntervalEstimate(math.exp(best[index]), 0.0 if low is None else math.exp(low),
                                       math.inf if high is None else math.exp(high), unit)
    return found


def _profile_end(cost, best, index, limits, curvature, side):
    """Value of parameter `index`, on one side of the best, at which its profile has risen by _DROP; None beyond the
    limits."""
    from scipy.optimize import brentq

    others = [i for i in range(len(best)) if i != index]
    bounds = [limits[i] for i in others]
    lowest = cost(best)
    # start values of the other parameters: by the quadratic approximation, corrected by the result of the last search
    follow = np.clip(curvature[others, index] / curvature[index, index], -3, 3)
    state = {'off': np.zeros(len(others))}

    @cache  # a repeated search may end at another point of a flat ridge, and a root finder needs one value
    def rise(value):
        def inner(t):
            full = np.empty(len(best))
            full[index], full[others] = value, t
            return cost(full)
        ahead = best[others] + follow * (value - best[index])
        found, at = _minimize(inner, ahead + state['off'], bounds)
        state['off'] = at - ahead
        return found - lowest - _DROP

    limit = limits[index][0 if side < 0 else 1]
    step = float(np.clip(2 * math.sqrt(curvature[index, index]), 1e-3, 0.5))
    near = float(best[index])
    while True:
        far = float(best[index]) + side * step
        if side * (far - limit) >= 0:
            far = limit
        if rise(far) > 0:
            return brentq(rise, *sorted((near, far)), xtol=0.01 * step) if rise(near) < 0 else near
        if far == limit:
            return None
        near, step = far, 2 * step


def _maximize(objective, starts, limits, always=()):
    """The best maximum from several start values: a rough search from the two best ones and from those in `always`,
    then a full search from the best result."""
    ranked = sorted((_clip(s, limits) for s in starts), key=objective, reverse=True)[:2] + list(always)
    _, rough = min((_minimize(lambda t: -objective(t), start, limits, 0.05) for start in ranked),
                   key=lambda pair: pair[0])
    value, best = _minimize(lambda t: -objective(t), rough, limits)
    return best, -value


def _minimize(cost, start, bounds, tolerance=1e-4):
    """Minimum of a negative log likelihood to within about `tolerance` nats: (value, where)."""
    from scipy.optimize import minimize

    start = _clip(start, bounds)
    high = np.array([upper for _, upper in bounds])

    def with_gradient(t, step=1e-4):  # one-sided differences; scipy's own cost more than a likelihood
        value = cost(t)
        steps = np.where(t + step > high, -step, step)
        return value, np.array([(cost(t + h) - value) / h[i] for i, h in enumerate(np.diag(steps))])

    result = minimize(with_gradient, start, method='L-BFGS-B', jac=True, bounds=bounds,
                      options={'ftol': tolerance / max(abs(cost(start)), 1.0), 'gtol': 1e-3, 'maxiter': 200})
    return float(result.fun), result.x


def _clip(t, limits):
    return np.clip(np.asarray(t, float), [low for low, _ in limits], [high for _, high in limits])


def _log_ratio_of_walk(data, share):
    """log(q/N) at which the walk over one interval is `share` of the white noise of one mean."""
    return 0.5 * math.log(3 * share) - math.log(data.interval)


def _ratio_limits(data):
    """Limits of log(q/N): from a walk of a thousandth of the white noise of one mean to one that hides all white noise.
    """
    return math.log(1e-3 / data.duration), math.log(1e3 / data.interval)


def _noise_limits(density):
    return math.log(density) - 8, math.log(density) + 3


def _p_value(data, value, extra):
    """p-value of white noise alone, by the likelihood ratio; conservative: chi-square with all extra parameters."""
    from scipy.stats import chi2

    return float(chi2.sf(2 * max(value - fit_white(data).log_likelihood, 0.0), extra))


def _present(data):
    return int(np.isfinite(data.z).sum())


def _check(data):
    if _present(data) < 20:
        raise InputError(f'{_present(data)} averages over {data.interval:g} s are too few for a fit; 20 are needed')
