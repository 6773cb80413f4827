"""From a recording of a sensor at rest to the parameters of its error models, and their uncertainty.

The steps: find the samples at rest; compute the Allan deviation of each axis; choose for each sensor the averaging
interval at which its slow error is modelled, by how well the models predict the error in an outage; fit the three
models together with the white noise at this interval; compare them on data that they were not fitted to.
"""
from __future__ import annotations

import math
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock

import numpy as np

from ..guard import one_line
from ..threads import threads
from . import autoregressive as ar
from .allan import AllanCurve, AllanParameters, allan_deviation, allan_parameters
from .autocorrelation import AutocorrelationFit, fit_gauss_markov_autocorrelation
from .fitting import (
    IntervalEstimate,
    ModelFit,
    fit_autoregressive,
    fit_autoregressive_orders,
    fit_gauss_markov,
    fit_random_walk,
)
from .likelihood import Averages, average, estimate_levels, innovations, state_space
from .selection import Prediction, Recommendation, overall, predict, recommend, smallest_unbeaten, split
from .stationary import Grid, RestPeriods, StationaryError, axis_name, find_rest

SENSORS = {'accelerometer': 'm/s^2', 'gyroscope': 'rad/s'}
#: s, averaging intervals at which the models may be fitted
INTERVALS = (1.0, 2.0, 5.0, 10.0)
#: smallest number of averages for a fit. Chosen, not measured
_FEWEST = 150
#: s, averaging intervals for which the report shows the time constant of an AR(2)
_SHOWN = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
#: share by which a longer interval must predict an outage better to be chosen. Chosen, not measured
_GAIN = 0.02
_BURG_ORDERS = 10  # largest order in the figure of Burg models
#: bytes, largest size of an unpacked .npz file; 8 h at 100 Hz have 0.14 GB
_LARGEST_NPZ = 10**9


@dataclass(frozen=True)
class IntervalStudy:
    """AR(2) fits as a function of the averaging interval (s): the time constant (s) of the slowest pole, fitted without
    white noise (plain, Burg) and together with it (joint), and the white noise density of the joint fit.

    outage_rmse: error of the joint model's predicted mean over the longest horizon. The joint model is fitted to the
    training part and evaluated on the rest. NaN: not computed.
    """

    interval: np.ndarray
    plain: np.ndarray
    joint: np.ndarray
    noise_density: np.ndarray
    outage_rmse: np.ndarray


@dataclass(frozen=True)
class Axis:
    """All results for one axis; unit is that of the sensor.

    mean: Estimate, gravity and tilt included for an accelerometer. slow, averages: the data at 1 s or the shortest
    interval and at the models' interval. estimators: AR fits of the averages by the three classical methods.
    order_curve: Burg models (Figure 6). joint_orders: held-out prediction of white noise + AR for each order tried.
    fits, predictions: by model name, at the models' interval. temperature: slope, unit per degree, or None.
    """

    name: str
    unit: str
    mean: IntervalEstimate
    allan: AllanCurve
    allan_parameters: AllanParameters
    autocorrelation: AutocorrelationFit
    intervals: IntervalStudy
    slow: Averages
    averages: Averages
    estimators: tuple[ar.ArFit, ...]
    order_curve: ar.OrderCurve
    joint_orders: dict[int, Prediction]
    fits: dict[str, ModelFit]
    predictions: dict[str, Prediction]
    recommendation: Recommendation
    temperature: IntervalEstimate | None

    @property
    def significant(self) -> bool:
        """Whether a slow error is significant beside the white noise."""
        return self.fits['random_walk'].significant or self.fits['gauss_markov'].significant


@dataclass(frozen=True)
class Characterization:
    """The result. interval (s) and order of the AR model: by sensor. model: the one recommended for all axes.
    gravity: length of the mean specific force, m/s^2."""

    name: str
    grid: Grid
    rest: RestPeriods
    axes: tuple[Axis, ...]
    interval: dict[str, float]
    order: dict[str, int]
    model: str
    gravity: float

    @property
    def duration(self) -> float:
        """Time at rest that was used, s."""
        used = sum(b - a for a, b in self.rest.parts) - sum(self.rest.holes[a:b].sum() for a, b in self.rest.parts)
        return float(used / self.grid.rate)

    def of(self, sensor: str) -> tuple[Axis, ...]:
        return tuple(a for a in self.axes if a.name.startswith(sensor))


def characterize(name: str, grid: Grid, temperature=None, orders=(1, 2, 3), progress=None) -> Characterization:
    """Characterize six axes at rest.

    grid: values (n, 6), specific force m/s^2 and angular rate rad/s in sensor axes. temperature: (seconds from the
    grid's start, degrees Celsius) arrays or None. orders: of the AR models tried. progress: called with (done, total,
    what was done). Raises StationaryError (ValueError) where the recording does not allow it.
    """
    orders = sorted(set(orders))
    rest = find_rest(grid)
    steps = _Progress(progress, 6 * 3)
    # the axes share the processors: likelihoods and transforms release the interpreter
    with ThreadPoolExecutor(min(6, threads())) as pool:
        def each(function, label, *arguments):
            def run(k, *values):
                result = function(*values)
                steps.finished(f'{axis_name(k)}: {label}')
                return result
            return list(pool.map(run, range(6), *arguments))

        prepared = each(lambda k: _prepare(grid, rest, k), 'Allan deviation', range(6))
        studies = each(_study_intervals, 'averaging interval', prepared)
        factors = np.repeat([_choose_interval(studies[s:s + 3], prepared[s:s + 3]) for s in (0, 3)], 3)
        averages = [p.slow.coarser(int(f)) for p, f in zip(prepared, factors)]
        tried = list(pool.map(lambda a: _try_orders(a, orders), averages))
        best = [list(t)[smallest_unbeaten(list(t.values()))] for t in tried]
        chosen = np.repeat([max(best[:3]), max(best[3:])], 3)
        axes = each(lambda k, p, study, a, t: _finish(k, p, study, a, t, int(chosen[k]), temperature), 'models',
                    range(6), prepared, studies, averages, tried)
    intervals = {sensor: axes[3 * s].averages.interval for s, sensor in enumerate(SENSORS)}
    chosen_orders = {sensor: int(chosen[3 * s]) for s, sensor in enumerate(SENSORS)}
    model = overall([list(a.predictions.values()) for a in axes if a.significant] or
                    [list(a.predictions.values()) for a in axes])
    gravity = math.sqrt(sum(a.mean.value**2 for a in axes[:3]))
    return Characterization(name, grid, rest, tuple(axes), intervals, chosen_orders, model, gravity)


class _Progress:
    def __init__(self, report, total):
        self.report, self.total, self.done, self.lock = report, total, 0, Lock()

    def finished(self, what):
        with self.lock:
            self.done += 1
            if self.report:
                self.report(self.done, self.total, what)


@dataclass(frozen=True)
class _Prepared:
    rate: float
    samples: list[np.ndarray]  # the first of them only, for the plain fits at short intervals
    curve: AllanCurve
    slow: Averages


def _prepare(grid, rest, k):
    parts = [np.where(rest.holes[a:b], np.nan, grid.values[a:b, k]) for a, b in rest.parts]
    slow = average(parts, max(1, round(INTERVALS[0] * grid.rate)), 1 / grid.rate)
    first = [parts[0][:round(600 * grid.rate)]]
    return _Prepared(grid.rate, first, allan_deviation(parts, grid.rate), slow)


def _study_intervals(p: _Prepared) -> IntervalStudy:
    base = p.slow.interval
    rows = [_study_short(p, t) for t in _SHOWN if 1.5 / p.rate <= t < base / 1.5]
    rows += [_study_long(p.slow, round(t)) for t in _SHOWN if t >= 1 and len(p.slow.z) / round(t) >= 60]
    return IntervalStudy(*np.array(rows).T)


def _study_short(p, interval):
    averages = average(p.samples, round(interval * p.rate), 1 / p.rate)
    return averages.interval, _plain(averages), math.nan, math.nan, math.nan


def _study_long(slow, factor):
    averages = slow.coarser(factor)
    data, start = split(averages)
    if start < 40:
        return averages.interval, _plain(averages), math.nan, math.nan, math.nan
    fit = fit_autoregressive(data.slice(0, start), 2, intervals=False)
    joint = ar.time_constant(fit.model.coefficients, averages.interval) if fit.significant else math.nan
    rmse = predict(data, start, '', fit.model, fit.noise_density).horizon_rmse
    return averages.interval, _plain(averages), joint, fit.noise_density, rmse[-1] if len(rmse) else math.nan


def _plain(averages):
    return ar.burg(averages.centred(), 2).time_constant(averages.interval)


def _choose_interval(studies, prepared) -> int:
    """Factor of averaging on the 1 s means: the shortest interval that predicts outages as well as any.

    The criterion is the mean over the axes of the logarithm of the joint model's outage error, so that all axes have
    the same weight.
    """
    base = prepared[0].slow.interval
    count = min(np.isfinite(p.slow.z).sum() for p in prepared)
    factors = [round(t) for t in INTERVALS if count / round(t) >= _FEWEST] or [1]
    errors = []
    for factor in factors:
        at = [np.argmin(np.abs(s.interval - factor * base)) for s in studies]
        errors.append(np.mean([math.log(s.outage_rmse[i]) for s, i in zip(studies, at)]))
    errors = np.nan_to_num(np.array(errors), nan=math.inf)
    return factors[int(np.flatnonzero(errors <= errors.min() + _GAIN)[0])] if np.isfinite(errors).any() else 1


def _try_orders(averages, orders):
    data, start = split(averages)
    fits = fit_autoregressive_orders(data.slice(0, start), orders)
    if not any(fit.significant for fit in fits):  # without a slow error, higher orders are not tried
        fits = fits[:1]
    return {fit.model.order: _judge(fit, data, start) for fit in fits}


def _judge(fit, data, start):
    return predict(data, start, 'autoregressive', fit.model, fit.noise_density)


def _finish(k, p, study, averages, tried, order, temperature) -> Axis:
    fits = {'random_walk': fit_random_walk(averages), 'gauss_markov': fit_gauss_markov(averages),
            'autoregressive': fit_autoregressive(averages, order)}
    data, start = split(averages)
    predictions = {}
    for model, fit in (('random_walk', fit_random_walk), ('gauss_markov', fit_gauss_markov)):
        trained = fit(data.slice(0, start), intervals=False)
        predictions[model] = predict(data, start, model, trained.model, trained.noise_density)
    predictions['autoregressive'] = tried.get(order) or _judge(
        fit_autoregressive(data.slice(0, start), order, intervals=False), data, start)
    significant = fits['random_walk'].significant or fits['gauss_markov'].significant
    level = np.nanmean(data.z[:start])
    name = axis_name(k)
    return Axis(name, SENSORS[name.split()[0]], _mean(averages, fits['gauss_markov']), p.curve,
                allan_parameters(p.curve),
                fit_gauss_markov_autocorrelation(p.slow), study, p.slow, averages,
                tuple(method(averages.centred(), order) for method in ar.METHODS.values()),
                ar.order_curve(data.z[:start] - level, data.z[start:] - level, min(_BURG_ORDERS, start // 10)),
                tried, fits, predictions, recommend(list(predictions.values()), significant),
                _temperature_slope(averages, fits['gauss_markov'], temperature))


def _mean(averages, fit):
    """Mean over the recording; its uncertainty is that of the long-term level, including the slow error."""
    space = state_space(fit.model, fit.noise_density, averages.interval)
    _, sigma = estimate_levels(averages, space)
    value, half = float(np.nanmean(averages.z)), 1.96 * float(np.nanmin(sigma))
    return IntervalEstimate(value, value - half, value + half, '')


def _temperature_slope(averages, fit, temperature) -> IntervalEstimate | None:
    """Slope over temperature by generalized least squares, with the slow error as coloured noise; None if the
    temperature is constant."""
    if temperature is None or averages.part.max() > 0:
        return None
    times = (np.arange(len(averages.z)) + 0.5) * averages.interval
    celsius = np.interp(times, *temperature)
    if np.ptp(celsius) < 0.5:
        return None
    space = state_space(fit.model, fit.noise_density, averages.interval)
    columns = []
    for series in (averages.z, np.where(np.isfinite(averages.z), celsius - celsius.mean(), np.nan),
                   np.where(np.isfinite(averages.z), 1.0, np.nan)):
        error, variance = innovations(Averages(series, averages.part, averages.interval), space, [0.0])
        columns.append((error / np.sqrt(variance))[np.isfinite(averages.z)])
    design = np.stack(columns[1:], axis=1)
    solution = np.linalg.lstsq(design, columns[0], rcond=None)[0]
    half = 1.96 * math.sqrt(np.linalg.inv(design.T @ design)[0, 0])
    return IntervalEstimate(float(solution[0]), float(solution[0] - half), float(solution[0] + half),
                            'per degree Celsius')


def read_npz(path) -> Grid:
    """Read a recording in npz format: `acc_mps2` (n, 3), `gyro_radps` (n, 3), `rate_hz`. Raises StationaryError for any
    other file."""
    try:
        with zipfile.ZipFile(path) as archive:  # NumPy would also read a pickle or a single array
            size = sum(entry.file_size for entry in archive.infolist())
            if size > _LARGEST_NPZ:
                raise StationaryError(f'{path} unpacks to {size / 1e9:.1f} GB, more than {_LARGEST_NPZ / 1e9:g} GB')
        with np.load(path, allow_pickle=False) as data:
            missing = [name for name in ('acc_mps2', 'gyro_radps', 'rate_hz') if name not in data]
            if missing:
                raise StationaryError(f'{path} has no array {missing[0]!r}')
            force, rate, hertz = data['acc_mps2'], data['gyro_radps'], data['rate_hz']
    except StationaryError:
        raise
    except Exception as error:  # NumPy passes on what zipfile, zlib, struct and tokenize raise on damaged files
        raise StationaryError(f'{path} cannot be read as npz: {one_line(error)}') from None
    for name, array in (('acc_mps2', force), ('gyro_radps', rate)):
        if array.ndim != 2 or array.shape[1] != 3 or not _is_real(array):
            raise StationaryError(f'{path}: {name} must be numbers of shape (n, 3), got {array.shape} {array.dtype}')
    if len(force) != len(rate):
        raise StationaryError(f'{path}: acc_mps2 has {len(force)} samples, gyro_radps {len(rate)}')
    if hertz.size != 1 or not _is_real(hertz) or not 1 <= hertz.item() <= 10000:
        raise StationaryError(f'{path}: rate_hz must be one number from 1 to 10000, got {hertz}')
    values = np.hstack([force, rate]).astype(float)
    values[~np.isfinite(values).all(axis=1)] = np.nan
    return Grid(float(hertz.item()), values, missing=int(np.isnan(values[:, 0]).sum()))


def _is_real(array: np.ndarray) -> bool:
    return array.dtype.kind in 'iuf'  # a span of time is a whole number to np.issubdtype
