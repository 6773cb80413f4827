"""The figures of a characterization, as Matplotlib figures without a window."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.characterization.autocorrelation import autocorrelation
from mems_ins_fusion.characterization.characterize import SENSORS, Characterization
from mems_ins_fusion.characterization.selection import TRAINING
from mems_ins_fusion.reports.colours import DASHES, MODEL_NAMES, MODELS, WIDTHS
from mems_ins_fusion.reports.html import empty_figure
from mems_ins_fusion.sensor_errors.models import Autoregressive, RandomWalk

_UNIT = {'accelerometer': 'm/s²', 'gyroscope': 'rad/s'}
_STYLE = {name: (colour, MODEL_NAMES[name]) for name, colour in MODELS.items()}
#: of the axes x, y, z
_AXES = ('#000000', '#e69f00', '#56b4e9')


CAPTIONS = {
    'overview': 'Means over 10 s, without the mean of the recording. Shaded: cut out.',
    'allan_accelerometer': 'Overlapping Allan deviation of the accelerometers with 95 % bounds, the coefficients read '
                           'from it, and what the fitted models would show.',
    'allan_gyroscope': 'Overlapping Allan deviation of the gyroscopes, likewise.',
    'autocorrelation': 'Autocorrelation of 1 s means. Lag 0, which holds the white noise, is left out. The curves are '
                       'the Gauss-Markov process fitted to it, and that of maximum likelihood.',
    'orders': 'Prediction error against the order of the AR model on held-out data (Figure 6 of the paper): plain AR '
              'by Burg, and white noise + AR. Below: information criteria of the plain AR, less their minimum; FPE as '
              'n log(FPE).',
    'intervals': 'Time constant of the slowest pole of an AR(2) against the averaging interval it is fitted at. Fitted '
                 'as it is, it follows the interval: it describes the white noise. Fitted together with white noise, '
                 'it shows the slow error. Vertical line: the interval chosen.',
    'horizons': 'RMS error of the predicted mean over the coming seconds, on held-out data: what an outage of that '
                'length costs, in velocity or heading per second of it.',
    'residuals': 'Autocorrelation of the normalized residual (one-step innovation) of the recommended model on '
                 'held-out data. Between the dashed lines it is white; p is that of the Ljung-Box test.',
}


def figures(c: Characterization) -> dict[str, tuple]:
    """By file name: (figure, caption)."""
    drawn = {'overview': _overview(c), **{f'allan_{sensor}': _allan(c, sensor) for sensor in SENSORS},
             'autocorrelation': _autocorrelation(c), 'orders': _orders(c), 'intervals': _intervals(c),
             'horizons': _horizons(c), 'residuals': _residuals(c)}
    return {name: (figure, CAPTIONS[name]) for name, figure in drawn.items()}


def _grid(height=5.6, rows=2, columns=3, sharex=True):
    figure = empty_figure(11.0, height)
    return figure, figure.subplots(rows, columns, sharex=sharex, squeeze=False)


def _panels(c, sharex=True):
    figure, panels = _grid(sharex=sharex)
    for axis, panel in zip(c.axes, panels.flat):
        panel.set_title(axis.name, fontsize=10)
        panel.grid(alpha=0.3)
    return figure, panels


def _overview(c):
    figure, panels = _panels(c)
    for axis, panel in zip(c.axes, panels.flat):
        size = max(1, round(10 * c.grid.rate))
        k = c.axes.index(axis)
        values = c.grid.values[:len(c.grid.values) // size * size, k].reshape(-1, size)
        present = np.isfinite(values)
        mean = np.where(present, values, 0.0).sum(axis=1) / np.maximum(present.sum(axis=1), 1)
        mean[present.sum(axis=1) < size / 2] = np.nan
        panel.plot((np.arange(len(mean)) + 0.5) * size / c.grid.rate, mean - axis.mean.value, lw=0.8)
        for cut in c.rest.cuts:
            panel.axvspan(cut.start, max(cut.stop, cut.start + c.grid.values.shape[0] / c.grid.rate / 1000),
                          color='#cc79a7', alpha=0.35, lw=0)
        panel.set_ylabel(_UNIT[axis.name.split()[0]])
    for panel in panels[-1]:
        panel.set_xlabel('time in s')
    return figure


def _allan(c, sensor):
    figure, panels = _grid(height=4.2, rows=1)
    for axis, panel in zip(c.of(sensor), panels.flat):
        curve, found = axis.allan, axis.allan_parameters
        panel.fill_between(curve.tau, curve.lower, curve.upper, color='0.8', label='95 % bounds')
        panel.loglog(curve.tau, curve.deviation, 'k', lw=1.2, label='Allan deviation')
        if found.noise_density is not None:
            panel.loglog(curve.tau, found.noise_density / np.sqrt(curve.tau), ':', color='#cc79a7', lw=1.4,
                         label='N, slope −1/2')
        if found.random_walk is not None:
            panel.loglog(curve.tau, found.random_walk * np.sqrt(curve.tau / 3), ':', color='#e69f00', lw=1.4,
                         label='K, slope +1/2')
        if found.bias_instability is not None:
            panel.plot(found.bias_instability_tau, found.bias_instability * 0.664, 'o', color='#e69f00', ms=5,
                       label='0.664 B')
        for name, fit in axis.fits.items():
            colour, label = _STYLE[name]
            tau, deviation = model_allan(fit, curve.tau)
            panel.loglog(tau, deviation, color=colour, lw=0.8 * WIDTHS[name], ls=DASHES[name], label=f'fitted: {label}')
        panel.set_ylim(0.4 * curve.lower.min(), 2.5 * curve.upper.max())
        panel.set_title(axis.name, fontsize=10)
        panel.set_xlabel('averaging time in s')
        panel.grid(alpha=0.3, which='both', lw=0.4)
    panels[0, 0].set_ylabel(f'Allan deviation in {_UNIT[sensor]}')
    panels[0, 0].legend(fontsize=7)
    return figure


def model_allan(fit, tau):
    """Averaging times (s) and Allan deviation that white noise and the model of `fit` would show.

    Random walk and Gauss-Markov: IEEE Std 952-1997, C.1.3 and C.1.7. AR: from its autocovariances, at multiples of
    its interval.
    """
    if isinstance(fit.model, Autoregressive):
        sizes = np.unique(np.round(tau[tau >= fit.model.interval] / fit.model.interval)).astype(int)
        tau, slow = sizes * fit.model.interval, _regressive_allan(fit.model, sizes)
    elif isinstance(fit.model, RandomWalk):
        slow = fit.model.q**2 * tau / 3
    else:
        u = tau / fit.model.tau
        slow = 2 * fit.model.sigma**2 / u * (1 - (3 - 4 * np.exp(-u) + np.exp(-2 * u)) / (2 * u))
    return tau, np.sqrt(fit.noise_density**2 / tau + np.maximum(slow, 0.0))


def _regressive_allan(model, sizes):
    """Allan variance over `sizes` intervals: (2 V(m) - V(2m) / 2) / m^2 with V the variance of the sum of m values."""
    longest = 2 * int(sizes.max(initial=1))
    a, state = model.transition(), model.initial_covariance()[:, 0]
    covariances = np.empty(longest)
    for lag in range(longest):
        covariances[lag] = state[0]
        state = a @ state
    number = np.arange(1, longest + 1)
    # V(m) = m r(0) + 2 sum over k < m of (m - k) r(k)
    total, moment = np.cumsum(covariances), np.cumsum(np.arange(longest) * covariances)
    variance = number * (2 * total - covariances[0]) - 2 * moment
    return (2 * variance[sizes - 1] - variance[2 * sizes - 1] / 2) / sizes**2


def _autocorrelation(c):
    figure, panels = _panels(c)
    for axis, panel in zip(c.axes, panels.flat):
        fit, model = axis.autocorrelation, axis.fits['gauss_markov'].model
        step = max(1, len(fit.lags) // 500)
        panel.plot(fit.lags[1::step], fit.values[1::step], 'k', lw=0.8, label='measured')
        panel.plot(fit.lags[1:], fit.fitted[1:], color='#cc79a7', lw=1.8, label='fit to the curve')
        if axis.significant:
            panel.plot(fit.lags[1:], model.sigma**2 * np.exp(-fit.lags[1:] / model.tau), '--',
                       color=MODELS['gauss_markov'], lw=1.4,
                       label='maximum likelihood')
        panel.set_ylabel(f'({_UNIT[axis.name.split()[0]]})²')
    for panel in panels[-1]:
        panel.set_xlabel('lag in s')
    panels[0, 0].legend(fontsize=7)
    return figure


def _orders(c):
    figure, panels = _grid(columns=6)
    for axis, (top, bottom) in zip(c.axes, panels.T):
        curve, unit = axis.order_curve, _UNIT[axis.name.split()[0]]
        scale = 1e3
        top.plot(curve.orders, scale * curve.rmse, 'k.-', lw=0.8, label='plain AR, Burg')
        top.plot(list(axis.joint_orders), [scale * p.one_step_rmse for p in axis.joint_orders.values()], 's-', ms=4,
                 color=MODELS['autoregressive'], lw=0.8, label='white noise + AR')
        top.set_title(axis.name, fontsize=9)
        top.set_ylabel(f'RMSE in 10⁻³ {unit}', fontsize=8)
        n = TRAINING * len(axis.averages.z)
        for name, values in (('AIC', curve.aic), ('BIC', curve.bic), ('FPE', n * np.log(curve.fpe))):
            bottom.plot(curve.orders, values - values.min(), '.-', lw=0.8, label=name)
        bottom.set_xlabel('order p')
        bottom.set_ylabel('nats over minimum', fontsize=8)
        for panel in (top, bottom):
            panel.grid(alpha=0.3)
            panel.tick_params(labelsize=7)
    panels[0, 0].legend(fontsize=6)
    panels[1, 0].legend(fontsize=6)
    return figure


def _intervals(c):
    figure, panels = _grid(height=4.2, rows=1, columns=2)
    for sensor, panel in zip(SENSORS, panels.flat):
        for i, axis in enumerate(c.of(sensor)):
            study = axis.intervals
            panel.loglog(study.interval, study.plain, '.--', color=_AXES[i], lw=1,
                         label=f'{axis.name[-1]}, AR(2) alone')
            panel.loglog(study.interval, study.joint, 'o-', color=_AXES[i], lw=1, ms=4,
                         label=f'{axis.name[-1]}, white noise + AR(2)')
        panel.loglog(study.interval, study.interval, color='0.6', lw=0.8, label='the interval itself')
        panel.axvline(c.interval[sensor], color='k', lw=0.8, ls=':')
        panel.set_title(sensor, fontsize=10)
        panel.set_xlabel('averaging interval in s')
        panel.set_ylabel('time constant in s')
        panel.grid(alpha=0.3)
    panels[0, 0].legend(fontsize=7)
    return figure


def _horizons(c):
    from matplotlib.ticker import FixedLocator, NullLocator

    figure, panels = _panels(c, sharex='row')
    for axis, panel in zip(c.axes, panels.flat):
        for name, prediction in axis.predictions.items():
            colour, label = _STYLE[name]
            panel.plot(prediction.horizons, prediction.horizon_rmse, '.', color=colour, ls=DASHES[name],
                       lw=WIDTHS[name], label=label)
        panel.set_xscale('log')
        panel.xaxis.set_major_locator(FixedLocator(prediction.horizons))
        panel.xaxis.set_major_formatter('{x:.0f}')
        panel.xaxis.set_minor_locator(NullLocator())
        panel.set_ylim(0, 1.15 * max(p.horizon_rmse.max(initial=0) for p in axis.predictions.values()))
        panel.set_ylabel(f'RMS error in {_UNIT[axis.name.split()[0]]}', fontsize=8)
        panel.ticklabel_format(axis='y', scilimits=(-2, 2))
    for panel in panels[-1]:
        panel.set_xlabel('horizon in s')
    panels[0, 0].legend(fontsize=7, loc='lower left')
    return figure


def _residuals(c):
    figure, panels = _panels(c, sharex='row')
    for axis, panel in zip(c.axes, panels.flat):
        prediction = axis.predictions[axis.recommendation.model]
        residual = prediction.residual - prediction.residual.mean()
        values = autocorrelation([residual], min(40, len(residual) // 4))
        bound = 1.96 / np.sqrt(len(residual))
        lags = np.arange(1, len(values)) * axis.averages.interval
        panel.vlines(lags, 0, values[1:] / values[0], color=_STYLE[axis.recommendation.model][0], lw=1.5)
        for level in (-bound, 0, bound):
            panel.axhline(level, color='k', lw=0.6, ls='-' if level == 0 else '--')
        panel.set_title(f'{axis.name}: {_STYLE[axis.recommendation.model][1]}, p = {prediction.whiteness_p:.2g}',
                        fontsize=9)
        panel.set_ylabel('autocorrelation')
    for panel in panels[-1]:
        panel.set_xlabel('lag in s')
    return figure
