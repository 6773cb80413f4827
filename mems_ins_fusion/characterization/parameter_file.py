"""A characterization as parameters of the filter: the YAML file for all tools, with the origin of each value."""
from __future__ import annotations

import math

import numpy as np

from ..navigation.earth import STANDARD_GRAVITY
from ..sensor_errors.models import Autoregressive, GaussMarkov, Model, RandomWalk
from . import data_sheet
from .characterize import SENSORS, Axis, Characterization
from .fitting import IntervalEstimate

#: significant digits of the values in the file
_DIGITS = 4
#: significant digits of AR coefficients: with poles near the unit circle they need more
_COEFFICIENT_DIGITS = 10


def axis_models(axis: Axis, duration: float) -> dict[str, Model]:
    """The three models of one axis with the parameters that the filter is to use.

    If the recording shows no slow error, the random walk is that at the upper end of its interval, and the two other
    models are equivalent to it over the recording: a filter with a constant bias could not correct a wrong one.
    """
    if axis.significant:
        walk, gauss_markov = axis.fits['random_walk'].model, axis.fits['gauss_markov'].model
    else:
        walk = RandomWalk(axis.fits['random_walk'].estimates['q'].upper, 0.0)
        gauss_markov = GaussMarkov(walk.q * math.sqrt(duration / 2), duration)
    fit = axis.fits['autoregressive']
    model = fit.model if axis.significant and fit.significant else _as_autoregressive(gauss_markov, fit.model)
    return {'random_walk': walk, 'gauss_markov': gauss_markov, 'autoregressive': model}


def _as_autoregressive(model: GaussMarkov, like: Autoregressive) -> Autoregressive:
    decay = math.exp(-like.interval / model.tau)
    return Autoregressive((-decay, *[0.0] * (like.order - 1)), model.sigma * math.sqrt(1 - decay**2), like.interval)


def parameters(c: Characterization) -> dict:
    """The parameters of both sensors by full name, with the recommended `sensor_error_model`."""
    values: dict = {'sensor_error_model': c.model}
    for sensor in SENSORS:
        axes = c.of(sensor)
        models = [axis_models(a, c.duration) for a in axes]
        values[f'{sensor}.noise_density'] = [white_noise(a, c.model).value for a in axes]
        if sensor == 'gyroscope':
            values[f'{sensor}.bias'] = [a.mean.value for a in axes]
        values[f'{sensor}.initial_sigma'] = [initial_sigma(c, sensor)]
        values[f'{sensor}.random_walk.q'] = [m['random_walk'].q for m in models]
        values[f'{sensor}.gauss_markov.sigma'] = [m['gauss_markov'].sigma for m in models]
        values[f'{sensor}.gauss_markov.tau'] = [m['gauss_markov'].tau for m in models]
        regressive = [m['autoregressive'] for m in models]
        values[f'{sensor}.autoregressive.coefficients'] = [a for m in regressive for a in m.coefficients]
        values[f'{sensor}.autoregressive.order'] = c.order[sensor]
        values[f'{sensor}.autoregressive.b0'] = [m.b0 for m in regressive]
        values[f'{sensor}.autoregressive.interval'] = c.interval[sensor]
    return values


def white_noise(axis, model):
    """The white noise of the fit with the recommended model, or with a random walk where there is no slow error."""
    fit = axis.fits[model]
    return (fit if fit.estimates else axis.fits['random_walk']).estimates['noise_density']


def initial_sigma(c: Characterization, sensor: str) -> float:
    """Size of the turn-on bias, as far as one recording shows it.

    Gyroscope: the RMS of the three mean rates. Accelerometer: the magnitude of the mean specific force minus gravity,
    as only the vertical component of the bias shows at rest; but not less than the slow error.
    """
    axes = c.of(sensor)
    slow = max(axis_models(a, c.duration)['gauss_markov'].sigma for a in axes)
    seen = abs(c.gravity - STANDARD_GRAVITY) if sensor == 'accelerometer' else math.sqrt(
        np.mean([a.mean.value**2 for a in axes]))
    return max(seen, slow)


def parameters_yaml(c: Characterization) -> str:
    """The params file, with comments that say where each value comes from and how certain it is."""
    values = parameters(c)
    lines = [f'# Sensor errors of {c.name}, from {c.duration:.0f} s at rest, by characterize.',
             '# Intervals in brackets: 95 %, for axes x, y, z (sensor axes).',
             '/**:', '  ros__parameters:', '    # predicts held-out data best, or as well as any and simplest',
             f'    sensor_error_model: {c.model}']
    for sensor, unit in SENSORS.items():
        axes = c.of(sensor)
        if sensor == 'accelerometer':
            lines += ['    # accelerometer.bias is not here: at rest it cannot be distinguished from tilt. Known is:',
                      f'    # mean specific force {c.gravity:.4f} m/s^2, standard gravity {STANDARD_GRAVITY} m/s^2']
        for name in (n for n in values if n.startswith(sensor)):
            lines += [f'    # {line}' for line in _origin(c, sensor, unit, axes, name.removeprefix(f'{sensor}.'))]
            digits = _COEFFICIENT_DIGITS if name.endswith('coefficients') else _DIGITS
            lines.append(f'    {name}: {_text(values[name], digits)}')
    return '\n'.join(lines) + '\n'


def _origin(c, sensor, unit, axes, name):
    quiet = [a.name[-1] for a in axes if not a.significant]
    note = [f'no slow error was found on {", ".join(quiet)}: there, the upper limit of its interval'] if quiet else []
    if name == 'noise_density':
        noise = [white_noise(a, c.model) for a in axes]
        return [f'{unit}/sqrt(Hz), beside {c.model.replace("_", " ")}: {_ranges(noise)}',
                *_data_sheet(data_sheet.white_noise, sensor, [e.value for e in noise])]
    if name == 'bias':
        return [f'{unit}, mean of the recording, rotation of the earth (up to 7.3e-5) included',
                f'long-term level: {_ranges([a.mean for a in axes])}',
                *_data_sheet(data_sheet.bias, sensor, [a.mean.value for a in axes])]
    if name == 'initial_sigma':
        return [f'{unit}, size of the turn-on bias, as far as one recording shows it',
                *_data_sheet(data_sheet.bias, sensor, [initial_sigma(c, sensor)])]
    if name == 'random_walk.q':
        return [f'{unit}/sqrt(s): {_ranges([a.fits["random_walk"].estimates["q"] for a in axes])}', *note]
    if name.startswith('gauss_markov'):
        key = name.rsplit('.', 1)[1]
        ranges = _ranges([a.fits["gauss_markov"].estimates[key] for a in axes])
        if key == 'tau':
            return [f's: {ranges}']
        sigmas = [axis_models(a, c.duration)['gauss_markov'].sigma for a in axes]
        return [f'{unit}: {ranges}', *_data_sheet(data_sheet.bias, sensor, sigmas)]
    if name == 'autoregressive.coefficients':
        return [f'a_1..a_{c.order[sensor]} of x, then y, then z; white noise is not part of them',
                *(f'{a.name[-1]}: {_ranges(_coefficients(a, c.order[sensor]))}' for a in axes)]
    if name == 'autoregressive.b0':
        known = [a.fits['autoregressive'].estimates.get('b0') for a in axes]
        return [f'{unit}: {_ranges(known)}']
    if name == 'autoregressive.interval':
        return ['s, the shortest that predicts outages as well as any']
    return []


def _coefficients(axis, order):
    return [axis.fits['autoregressive'].estimates.get(f'a_{i + 1}') for i in range(order)]


def _ranges(estimates: list[IntervalEstimate | None]) -> str:
    return ', '.join('[not known]' if e is None else f'[{e.lower:.3g}, {e.upper:.3g}]' for e in estimates)


def _data_sheet(convert, sensor, values) -> list[str]:
    """`values` in the units of data sheets, a line."""
    by_unit = [convert(sensor, value) for value in values]
    return ['in data sheets: ' + '; '.join(f'{", ".join(f"{v[unit]:.3g}" for v in by_unit)} {unit}'
                                           for unit in by_unit[0])]


def _text(value, digits: int) -> str:
    if isinstance(value, list):
        return f'[{", ".join(_text(v, digits) for v in value)}]'
    return _number(value, digits) if isinstance(value, float) else str(value)


def _number(value: float, digits: int) -> str:
    """`value` as text that YAML readers recognize as a floating-point number: with a point, also before an exponent."""
    text = f'{float(value):.{digits}g}'
    mantissa, e, exponent = text.partition('e')
    return (mantissa if '.' in mantissa else f'{mantissa}.0') + e + exponent
