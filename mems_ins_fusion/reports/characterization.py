"""A characterization as report.json and report.html."""
from __future__ import annotations

import math

from mems_ins_fusion.characterization import data_sheet
from mems_ins_fusion.characterization.autoregressive import METHODS, time_constant
from mems_ins_fusion.characterization.characterize import SENSORS, Characterization
from mems_ins_fusion.characterization.parameter_file import parameters, parameters_yaml
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.reports import html
from mems_ins_fusion.reports.answer import Answer
from mems_ins_fusion.reports.characterization_answer import LEAST_GRAVITY, MOST_GRAVITY
from mems_ins_fusion.reports.colours import MODEL_NAMES
from mems_ins_fusion.results import plain


def report(c: Characterization, answered: Answer) -> dict:
    """Content of report.json: plain numbers, texts and lists; null for unknown or unbounded values."""
    return {
        'answer': answered.json(),
        'recording': c.name, 'rate_hz': c.grid.rate, 'duration_at_rest_s': c.duration,
        'missing_samples': c.grid.missing, 'rejected_stamps': c.grid.rejected,
        'interval_jitter_s': plain(c.grid.jitter), 'parts_s': [[a / c.grid.rate, b / c.grid.rate]
                                                                for a, b in c.rest.parts],
        'cuts': [{'start_s': cut.start, 'stop_s': cut.stop, 'reason': cut.reason} for cut in c.rest.cuts],
        'level_shifts': [{'time_s': t, 'axis': c.axes[k].name, 'size': size} for t, k, size in c.rest.shifts],
        'gravity_mps2': c.gravity, 'model': c.model, 'interval_s': c.interval, 'order': c.order,
        'parameters': plain(parameters(c)), 'axes': [_axis(a) for a in c.axes]}


def _axis(a) -> dict:
    return plain({
        'name': a.name, 'unit': a.unit, 'mean': _estimate(a.mean), 'slow_error_significant': a.significant,
        'temperature_slope': a.temperature and _estimate(a.temperature),
        'allan': {**vars(a.allan_parameters), 'tau_s': a.allan.tau, 'deviation': a.allan.deviation,
                  'lower': a.allan.lower, 'upper': a.allan.upper},
        'autocorrelation': {'sigma': _estimate(a.autocorrelation.sigma), 'tau': _estimate(a.autocorrelation.tau)},
        'models': {name: _fit(fit) for name, fit in a.fits.items()},
        'autoregressive_methods': {f.method: {'coefficients': f.coefficients, 'b0': f.b0, 'stable': f.stable,
                                              'pole_radius': f.radius,
                                              'time_constant_s': f.time_constant(a.averages.interval)}
                                   for f in a.estimators},
        'order_curve': vars(a.order_curve),
        'joint_orders': {str(o): {'score': p.score, 'one_step_rmse': p.one_step_rmse} for o, p in
                         a.joint_orders.items()},
        'intervals': vars(a.intervals),
        'prediction': {name: {'score': p.score, 'one_step_rmse': p.one_step_rmse, 'horizon_s': p.horizons,
                              'horizon_rmse': p.horizon_rmse, 'whiteness_p': p.whiteness_p}
                       for name, p in a.predictions.items()},
        'recommendation': vars(a.recommendation)})


def _fit(fit) -> dict:
    return {'noise_density': fit.noise_density, 'log_likelihood': fit.log_likelihood, 'bic': fit.bic,
            'p_value_of_white_noise_alone': fit.p_value, 'interval_s': fit.interval,
            'estimates': {name: _estimate(e) for name, e in fit.estimates.items()}}


def _estimate(e) -> dict:
    return {'value': e.value, 'lower': e.lower, 'upper': e.upper}


def report_html(c: Characterization, answered: Answer, images: dict[str, html.Html]) -> str:
    """Content of report.html: the answer and one figure, then the evidence in folded sections. images: by name, as in
    `characterization_figures.figures`."""
    def show(*names):
        return [images[n] for n in names if n in images]

    sections = [
        html.section('What is in imu.yaml?', answered.html(), *show('horizons'), *_result(c)),
        answered.evidence(),
        html.folded('imu.yaml', 'The parameters, as the filter loads them.', html.preformatted(parameters_yaml(c))),
        html.folded('The recording', *_recording(c), *show('overview')),
        html.folded('Allan deviation', *_allan(c), *show(*(f'allan_{s}' for s in SENSORS))),
        html.folded('Which model is right', *_selection(c), *show('residuals')),
        html.folded('Fitted models', *_models(c)),
        html.folded('Autocorrelation', *_autocorrelation(c), *show('autocorrelation')),
        html.folded('Autoregressive model: interval', *_intervals(c), *show('intervals')),
        html.folded('Autoregressive model: order and method', *_orders(c), *show('orders'))]
    return html.page(f'{c.name}: sensor errors at rest', sections,
                     f'{c.duration:.0f} s at rest at {c.grid.rate:.3g} Hz; intervals are 95 %.')


def _result(c):
    recommended = [(a.name, a.recommendation) for a in c.axes]
    rows = [(name, MODEL_NAMES[r.model], r.decided, r.text) for name, r in recommended]
    return [html.table(('axis', 'model', 'decided by the data', 'why'), rows), *_data_sheet(c)]


def _data_sheet(c):
    """A table for each sensor with SI units and those of data sheets."""
    tables = []
    for sensor, unit in SENSORS.items():
        rows = [data_sheet_row(sensor, a) for a in c.of(sensor)]
        units = [key for key, _ in rows[0]]
        tables.append(html.table(['axis', *units], [[a.name, *(value for _, value in row)]
                                                    for a, row in zip(c.of(sensor), rows)]))
    return [*tables, 'As data sheets write them: white noise (angle or velocity random walk) and bias instability, the '
            'lowest point of the Allan deviation divided by 0.664. A dash: the recording does not show it.']


def data_sheet_row(sensor: str, axis) -> list[tuple]:
    """(quantity and unit, value or None) of one axis: in SI, then in units of data sheets."""
    found = axis.allan_parameters
    row = []
    for what, value, si, convert in (
            ('white noise', found.noise_density, f'{axis.unit}/sqrt(Hz)', data_sheet.white_noise),
            ('bias instability', found.bias_instability, axis.unit, data_sheet.bias)):
        known = value is not None and math.isfinite(value)
        units = convert(sensor, value if known else math.nan)
        row += [(f'{what}, {key}', v if known else None) for key, v in {si: value, **units}.items()]
    return row


def data_sheet_text(c: Characterization) -> list[str]:
    """The same as text for a terminal: a line for each axis."""
    lines = []
    for sensor in SENSORS:
        for axis in c.of(sensor):
            said: dict[str, list[str]] = {}
            for key, value in data_sheet_row(sensor, axis):
                what, unit = key.split(', ')
                said.setdefault(what, []).append('not shown' if value is None else f'{value:.3g} {unit}')
            lines.append(f'{axis.name}: ' + '; '.join(
                f'{what} {"not shown" if "not shown" in values else " = ".join(values)}'
                for what, values in said.items()))
    return lines


def data_sheet_short(c: Characterization) -> list[str]:
    """The same as one line for each sensor, from the best to the worst axis."""
    lines = []
    for sensor in SENSORS:
        found: dict[str, list[float]] = {}
        for axis in c.of(sensor):
            named = dict(data_sheet_row(sensor, axis))
            for key in (list(named)[1], list(named)[-1]):  # the first unit of data sheets, of white noise and of biases
                found.setdefault(key, []).extend(v for v in (named[key],) if v is not None)
        said = [f'{what} ' + (f'{_span(values)} {unit}' if values else 'not shown')
                for key, values in found.items() for what, unit in (key.split(', '),)]
        lines.append(f'{sensor}s: {"; ".join(said)}')
    return lines


def _span(values: list[float]) -> str:
    """From the smallest to the largest value, or one value if both have the same text."""
    return ' to '.join(dict.fromkeys(html.number(v, 3) for v in (min(values), max(values))))


def _recording(c):
    low, high = LEAST_GRAVITY, MOST_GRAVITY
    force = f'Mean specific force {c.gravity:.4f} m/s² against standard gravity {STANDARD_GRAVITY} m/s².'
    if not low <= c.gravity <= high:
        force += (f' No place on earth has that ({low} to {high}): the accelerometers have a bias or scale error of at '
                  f'least {max(low - c.gravity, c.gravity - high):.3f} m/s², mostly on the vertical axis.')
    rows = [(a.name, a.mean.value, a.mean.lower, a.mean.upper, a.unit,
             a.temperature and a.temperature.value, a.temperature and a.temperature.lower,
             a.temperature and a.temperature.upper) for a in c.axes]
    grid = (f'{len(c.grid.values)} samples on the grid; {c.grid.missing} missing, {c.grid.rejected} rejected for a '
            f'stamp that did not advance; typical jitter of the intervals {1e3 * c.grid.jitter:.3g} ms.')
    cut = sum(x.stop - x.start for x in c.rest.cuts)
    parts = [grid, f'{len(c.rest.parts)} part(s) at rest; {len(c.rest.cuts)} disturbances, {cut:.0f} s in all, '
             'cut out.']
    if c.rest.cuts:
        shown = c.rest.cuts[:20]
        parts.append(html.table(('from, s', 'to, s', 'reason'), [
            (f'{x.start:.1f}', f'{x.stop:.1f}', x.reason) for x in shown],
                                'The first 20; all are in report.json.' if len(c.rest.cuts) > 20 else ''))
    if c.rest.shifts:
        parts += ['The level shifted here within half a minute by far more than usual, without a disturbance that '
                  'would tell why. Kept: a little tilt of the table, or a jump of the bias.',
                  html.table(('at, s', 'axis', 'shift', 'unit'),
                             [(t, c.axes[k].name, size, c.axes[k].unit) for t, k, size in c.rest.shifts[:20]])]
    return [*parts, force, 'The mean of an accelerometer holds gravity and tilt, so no bias is given for it; that of a '
            'gyroscope holds the rotation of the earth (up to 7.3e-5 rad/s). The interval is that of the long-term '
            'level, slow error included.',
            html.table(('axis', 'mean', 'lower', 'upper', 'unit', 'per °C', 'lower', 'upper'), rows, digits=5),
            '' if any(a.temperature for a in c.axes) else
            'No temperature trend: no temperature topic, or less than 0.5 °C of change, or several parts.']


def _allan(c):
    rows = []
    for a in c.axes:
        p = a.allan_parameters
        rows.append((a.name, p.noise_density, p.noise_density_sigma, p.bias_instability, p.bias_instability_tau,
                     p.random_walk, p.random_walk_sigma, p.correlation_time))
    return [html.table(('axis', 'white noise N, unit/√Hz', '1σ', 'bias instability B, unit', 'at, s',
                        'random walk K, unit/√s', '1σ', 'correlation time, s'), rows,
                       'Units: m/s² for accelerometers, rad/s for gyroscopes. A dash: the curve does not show it.')]


def _autocorrelation(c):
    rows = [(a.name, *(v for e in (a.autocorrelation.sigma, a.autocorrelation.tau) for v in _estimate(e).values()))
            for a in c.axes]
    return [html.table(('axis', 'sigma', 'lower', 'upper', 'tau, s', 'lower', 'upper'), rows),
            'The classical way, for comparison: maximum likelihood below uses the same data far better.']


def _models(c):
    rows = []
    for a in c.axes:
        for name, fit in a.fits.items():
            for key, e in fit.estimates.items():
                unit = {'tau': 's'}.get(key, '' if key.startswith('a_') else a.unit + e.unit)
                rows.append((a.name, MODEL_NAMES[name], key, e.value, e.lower, e.upper, unit))
    return [f'Maximum likelihood of white noise and each model together, at averaging intervals of '
            f'{" and ".join(f"{c.interval[s]:.4g} s ({s})" for s in SENSORS)}.',
            html.table(('axis', 'model', 'parameter', 'value', 'lower', 'upper', 'unit'), rows, digits=5)]


def _intervals(c):
    rows = [(a.name, *row) for a in c.axes for row in zip(*(getattr(a.intervals, n) for n in (
        'interval', 'plain', 'joint', 'noise_density', 'outage_rmse')))]
    return ['An AR model fitted to raw samples describes the white noise: its time constant is a few samples. At '
            'longer intervals it grows with the interval and says nothing either. Together with white noise the slow '
            'error shows. The interval chosen for the models is the shortest whose prediction through the longest '
            'horizon on held-out data is within 2 % of the best, on the average of the axes.',
            html.table(('axis', 'interval, s', 'AR(2) alone: time constant, s', 'white noise + AR(2): time constant, s',
                        'white noise, unit/√Hz', 'outage error, unit'), rows)]


def _orders(c):
    rows = []
    for a in c.axes:
        for method, fit in zip(METHODS, a.estimators):
            rows.append((a.name, method, _listed(fit.coefficients), fit.b0, fit.radius, fit.stable,
                         fit.time_constant(a.averages.interval)))
        joint = a.fits['autoregressive'].model
        rows.append((a.name, 'white noise + AR', _listed(joint.coefficients), joint.b0,
                     float(abs(joint.poles()).max()), True, time_constant(joint.coefficients, joint.interval)))
    chosen = ', '.join(f'{c.order[s]} for the {s}' for s in SENSORS)
    criteria = [(a.name, int(a.order_curve.orders[a.order_curve.aic.argmin()]),
                 int(a.order_curve.orders[a.order_curve.bic.argmin()]),
                 int(a.order_curve.orders[a.order_curve.fpe.argmin()]), a.order_curve.elbow(),
                 min(a.joint_orders, key=lambda o: a.joint_orders[o].one_step_rmse)) for a in c.axes]
    return [f'Order {chosen}: the smallest that no higher one certainly beats in predicting held-out data, on any of '
            'the three axes (more than two standard errors over blocks of time).',
            html.table(('axis', 'AIC', 'BIC', 'FPE', 'RMSE within 1 %', 'white noise + AR: least RMSE'), criteria,
                       'Orders that each criterion would choose; the first four for an AR without white noise, which '
                       'needs a high order to imitate it.'),
            html.table(('axis', 'method', 'a_1 … a_p', 'b_0, unit', 'largest pole', 'stable', 'time constant, s'),
                       rows, digits=5)]


def _listed(coefficients):
    return ', '.join(f'{a:.4f}' for a in coefficients)


def _selection(c):
    rows = []
    for a in c.axes:
        for name, p in a.predictions.items():
            farthest = (p.horizon_rmse[-1], p.horizons[-1]) if len(p.horizons) else (None, None)
            rows.append((a.name, MODEL_NAMES[name], p.score, p.one_step_rmse, *farthest, p.whiteness_p,
                         a.fits[name].bic))
    return ['Fitted to the first 60 % of the recording, judged on the rest. A model counts as better when its score '
            'exceeds the other by two standard errors over 20 blocks of time and by more than one nat; else the '
            'simplest is recommended, and the table of results says that the data do not decide.',
            html.table(('axis', 'model', 'score, nats per interval', 'one-step RMSE, unit',
                        'RMSE of the mean ahead, unit', 'over, s', 'Ljung-Box p', 'BIC (all data)'), rows, digits=6)]
