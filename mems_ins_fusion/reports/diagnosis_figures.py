"""Figures of a diagnosis."""
from __future__ import annotations

import numpy as np

from ..diagnosis.detection import COMPONENTS, LAGS
from ..diagnosis.findings import Diagnosis
from ..diagnosis.measured import MeasuredErrors
from ..diagnosis.tracing import FAMILY_ERROR_RATE
from ..evaluation.outages import Outages
from .colours import AFTER, BEFORE, FITTED
from .html import empty_figure, legend_below
from .layers import diagnosis_layers

COLOURS = {'before': BEFORE, 'fitted': FITTED, 'after': AFTER}
STAGES = {'before': 'as configured', 'fitted': 'other noise levels alone', 'after': 'with corrected.yaml'}
#: number of lags of the autocorrelation, and half the width of the histogram in standard deviations
SHOWN_LAGS, WIDEST = 3 * LAGS, 5.0
#: number of candidates of a round in a figure, those with the largest gains; all are in the table
MOST_SHOWN = 8


def autocorrelation(values: np.ndarray, lags: int) -> np.ndarray:
    """Autocorrelation of `values` (n,) at lags 1..lags, without their mean."""
    centred = values - values.mean()
    return np.array([(centred[k:] * centred[:-k]).sum() for k in range(1, lags + 1)]) / (centred**2).sum()


def residual(diagnosis: Diagnosis, stage: str):
    """Whitened innovations along and across the track at one stage: against time, their autocorrelation, histogram."""
    problem, detection = diagnosis.problem, diagnosis.detections[stage]
    mask = problem.mask & np.isfinite(diagnosis.residuals[stage].z[:, 0])
    series = diagnosis.residuals[stage].along_across()[mask].T
    minutes = (problem.stamp[mask] - problem.stamp[0]) * 1e-9 / 60
    figure = empty_figure(11, 5)
    axes = figure.subplots(2, 3, width_ratios=(2.4, 1.2, 1), sharex='col')
    for (time, acf, histogram), name, values in zip(axes, COMPONENTS[2:], series):
        time.axhspan(-2.58, 2.58, color='0.92', label='99 % of a right model')
        time.plot(minutes, values, '.', markersize=2.5, color=COLOURS[stage])
        time.set_ylabel(f'{name}, sigma')
        _autocorrelation(acf, values, COLOURS[stage])
        _histogram(histogram, values, COLOURS[stage])
    axes[0, 0].legend(loc='upper right', fontsize=7)
    axes[0, 0].set_title('whitened innovations', fontsize=9)
    axes[0, 1].set_title('autocorrelation, 99 % bounds of white noise', fontsize=9)
    axes[0, 2].set_title('histogram and N(0, 1)', fontsize=9)
    for axis, label in zip(axes[1], ('time, min', 'lag, fixes', 'sigma')):
        axis.set_xlabel(label)
    low, high = detection.nis_bounds
    p = detection.ljung_box_p
    figure.suptitle(f'{STAGES[stage]}: NIS {detection.nis_mean:.3g} ({low:.2f} to {high:.2f} expected), Ljung-Box p '
                    + ('< 0.001' if p < 0.001 else f'{p:.2g}'), fontsize=10)
    return figure


def _autocorrelation(axes, values, colour) -> None:
    lags = min(SHOWN_LAGS, len(values) // 4)
    bound = 2.58 / np.sqrt(len(values))
    axes.axhspan(-bound, bound, color='0.92')
    axes.vlines(np.arange(1, lags + 1), 0, autocorrelation(values, lags), color=colour)
    axes.axhline(0, color='k', linewidth=0.6)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -0.25), max(high, 0.25))


def _histogram(axes, values, colour) -> None:
    grid = np.linspace(-WIDEST, WIDEST, 201)
    axes.hist(np.clip(values, -WIDEST, WIDEST), np.linspace(-WIDEST, WIDEST, 41), density=True, color=colour, alpha=0.6)
    axes.plot(grid, np.exp(-0.5 * grid**2) / np.sqrt(2 * np.pi), color='k', linewidth=1)
    axes.set_yticks([])


def evidence(diagnosis: Diagnosis):
    """The gain of the candidates in every round, one below the other; None where nothing was tested."""
    if not diagnosis.rounds:
        return None
    shown = [sorted(candidates, key=lambda c: c.gain)[-MOST_SHOWN:] for candidates in diagnosis.rounds]
    figure = empty_figure(8, 0.5 + sum(0.6 + 0.2 * len(ranked) for ranked in shown))
    for i, (axes, ranked) in enumerate(zip(np.atleast_1d(figure.subplots(
            len(shown), 1, height_ratios=[3 + len(ranked) for ranked in shown])), shown)):
        chosen = diagnosis.chosen[i:i + 1]
        axes.barh([c.name for c in ranked], [c.gain for c in ranked],
                  color=[AFTER if c.name in chosen else '#9fcbe6' if c.p_adjusted <= FAMILY_ERROR_RATE else '0.85'
                         for c in ranked])
        axes.tick_params(labelsize=7)
        axes.set_title(f'round {i + 1}', fontsize=9)
    axes.set_xlabel('gain', fontsize=8)
    return figure


def errors(diagnosis: Diagnosis):
    """Horizontal error before and after: against time, with the fixes used, and in outages against the time since the
    last fix."""
    figure = empty_figure(11, 4)
    time, outage = figure.subplots(1, 2, width_ratios=(1.6, 1))
    origin, stages = diagnosis.problem.stamp[0], measured_stages(diagnosis)
    longest = _same({stage: _longest(measured) for stage, measured in stages.items()})
    for stage, measured in stages.items():
        continuous = measured.continuous
        time.plot((continuous.stamp - origin) * 1e-9 / 60, continuous.horizontal, '.', markersize=2,
                  color=COLOURS[stage], label=STAGES[stage])
        _growth(outage, longest.get(stage), stage)
    time.set(xlabel='time, min; one drive after the other' if diagnosis.drives else 'time, min',
             ylabel='horizontal error, m', yscale='log')
    time.set_title('with the fixes used', fontsize=9)
    outage.set(xlabel='since the last fix, s', ylabel='horizontal error, m', xlim=(0, None), ylim=(0, None))
    outage.set_title('without fixes', fontsize=9)
    time.legend(fontsize=8, markerscale=4)
    return figure


def measured_stages(diagnosis: Diagnosis) -> dict[str, MeasuredErrors]:
    """The measured errors by stage, without a stage of noise levels if these are the given ones or the only change, and
    without the last stage if nothing is better."""
    stages = {'before': diagnosis.before} | ({'after': diagnosis.after} if diagnosis.changed else {})
    fitted = diagnosis.fitted.continuous.horizontal
    if any(np.array_equal(fitted, stage.continuous.horizontal) for stage in stages.values()):
        return stages
    return {'before': diagnosis.before, 'fitted': diagnosis.fitted, **stages}


def _longest(measured: MeasuredErrors) -> Outages | None:
    return next((o for o in reversed(measured.outages) if len(o.growth)), None)


def _same(found: dict[str, Outages | None]) -> dict[str, Outages]:
    """The outages that all of them have."""
    there = {stage: outages for stage, outages in found.items() if outages is not None}
    begins = set.intersection(*(set(o.begin.tolist()) for o in there.values())) if there else set()
    return {stage: o.select(np.isin(o.begin, list(begins))) for stage, o in there.items()} if begins else {}


def _growth(axes, longest: Outages | None, stage: str) -> None:
    if longest is None:
        return
    low, middle, high = (np.concatenate([[0.0], q]) for q in np.percentile(longest.growth, [25, 50, 75], axis=0))
    time = np.concatenate([[0.0], longest.time])
    axes.fill_between(time, low, high, color=COLOURS[stage], alpha=0.15, linewidth=0)
    axes.plot(time, middle, color=COLOURS[stage])


def track(diagnosis: Diagnosis):
    """The drive from above: truth, before and after, with all fixes and in outages."""
    figure = empty_figure(9, 7)
    axes = figure.add_subplot()
    for layer in diagnosis_layers(diagnosis):
        if layer.points:
            continue
        pieces = np.split(np.arange(len(layer.time)), [] if layer.first is None else layer.first[1:])
        for i, piece in enumerate(pieces):
            axes.plot(layer.east[piece], layer.north[piece], color=layer.colour, linewidth=0.7 * layer.width,
                      linestyle='--' if layer.dash else '-', label=layer.name if i == 0 else None)
        if layer.ends is not None:
            axes.plot(*layer.ends[:, :2].T, 'x', color=layer.colour, markersize=5)
    axes.set_aspect('equal', adjustable='datalim')
    axes.set(xlabel='east, m', ylabel='north, m')
    axes.grid(color='0.92')
    legend_below(figure)
    return figure
