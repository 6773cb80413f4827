"""Figures of a replay."""
from __future__ import annotations

import numpy as np

from ..evaluation.comparison import Comparison, RunResult
from ..evaluation.metrics import rms
from ..samples import runs
from . import colours
from .html import empty_figure, legend_below
from .layers import Ground

#: largest number of points of a line
POINTS = 3000
#: half the width of the window around a manoeuvre, m
WINDOW = 40.0


def model_name(comparison: Comparison, model: str) -> str:
    """Name of `model` for people: AR with its order."""
    if model != 'autoregressive':
        return colours.MODEL_NAMES[model]
    return f'AR({comparison.run_of(model, comparison.intervals[0]).run.config.layout.order})'


def _style(model: str, width: float = 1.0) -> dict:
    """Colour, dashes and width of a model's line."""
    return {'color': colours.MODELS[model], 'linestyle': colours.DASHES[model],
            'linewidth': width * colours.WIDTHS[model]}


def track(comparison: Comparison):
    """The drive from above: the truth, each model at the shortest interval, and some of the outages."""
    figure = empty_figure(9, 7)
    axes = figure.add_subplot()
    ground = Ground(comparison.truth.reference)
    axes.plot(ground.east, ground.north, color='0.8', linewidth=5, solid_capstyle='round', zorder=1,
              label=comparison.truth.source)
    interval = comparison.intervals[0]
    for model in comparison.models:
        north, east = ground.of(comparison.run_of(model, interval).errors)
        axes.plot(east, north, **_style(model), zorder=2,
                  label=f'{model_name(comparison, model)}, fixes each {interval:g} s')
    for result in comparison.smoothed[:1]:
        north, east = ground.of(result.errors)
        axes.plot(east, north, color=colours.SMOOTHED, linewidth=1.0, zorder=2,
                  label=f'{model_name(comparison, result.model)}, smoothed')
    _mark_outages(axes, comparison, ground)
    axes.plot(ground.east[0], ground.north[0], marker='o', color='k', markersize=6, linestyle='', zorder=5,
              label='start')
    _as_map(axes)
    legend_below(figure)
    return figure


def _mark_outages(axes, comparison, ground):
    """The path of the filter without fixes: outages of a middle duration that do not overlap."""
    if not comparison.durations:
        return
    duration = comparison.durations[len(comparison.durations) // 2]
    result = min((r for r in comparison.outages if r.outages.duration == duration),
                 key=lambda r: rms(r.outages.max_error))
    last, label = -np.inf, f'{duration:g} s without fixes, {model_name(comparison, result.model)}'
    for begin, errors in zip(result.outages.begin, result.outages.errors):
        if begin < last + 2 * duration * 1e9:
            continue
        last = begin
        north, east = ground.of(errors)
        axes.plot(east, north, color=colours.OUTAGE, linewidth=1.4, zorder=3, label=label)
        axes.plot([east[-1], east[-1] - errors.east[-1]], [north[-1], north[-1] - errors.north[-1]],
                  color=colours.OUTAGE, linewidth=0.8, linestyle=':', zorder=3)
        axes.plot(east[-1], north[-1], color=colours.OUTAGE, marker='x', markersize=5, zorder=4)
        label = None


def _as_map(axes, adjustable='datalim'):
    axes.set_aspect('equal', adjustable=adjustable)
    axes.set_xlabel('east, m')
    axes.set_ylabel('north, m')
    axes.grid(color='0.92')
    axes.set_axisbelow(True)


def manoeuvre(comparison: Comparison):
    """Each update interval in a panel (the paper's Figures 7 to 9), around the turn with the largest error."""
    intervals = comparison.intervals
    figure = empty_figure(4.2 * len(intervals), 4.4)
    ground = Ground(comparison.truth.reference)
    middle = _worst_turn([comparison.run_of(m, intervals[-1]) for m in comparison.models])
    at = np.searchsorted(ground.stamp, middle)
    panels = figure.subplots(1, len(intervals), sharex=True, sharey=True, squeeze=False)[0]
    near = np.abs(ground.stamp - middle) < 60e9
    for axes, interval in zip(panels, intervals):
        axes.plot(ground.east[near], ground.north[near], color='0.8', linewidth=5, solid_capstyle='round',
                  label=comparison.truth.source)
        for model in comparison.models:
            run = comparison.run_of(model, interval).run
            part = np.abs(run.stamp - middle) < 60e9
            north, east = (values[part] for values in ground(run))
            axes.plot(east, north, **_style(model), label=model_name(comparison, model))
        axes.set_title(f'fixes each {interval:g} s', fontsize=10)
        _as_map(axes, 'box')
        axes.set_xlim(ground.east[at] - WINDOW, ground.east[at] + WINDOW)
        axes.set_ylim(ground.north[at] - WINDOW, ground.north[at] + WINDOW)
        axes.locator_params(nbins=4)  # numbers of four digits that fit below a panel
        axes.label_outer()
    legend_below(figure)
    return figure


def _worst_turn(results: list[RunResult]) -> int:
    """Stamp of the largest error in a turn over `results`; of the largest error if there are no turns."""
    worst = (-1.0, 0)
    for only_turns in (True, False):
        for result in results:
            errors = result.errors.select(result.errors.turning) if only_turns else result.errors
            if len(errors):
                at = int(np.argmax(errors.horizontal))
                worst = max(worst, (float(errors.horizontal[at]), int(errors.stamp[at])))
        if worst[0] >= 0:
            break
    return worst[1]


def error_against_time(comparison: Comparison):
    """Horizontal error of each model, one panel for each interval, with turns shaded and the filter's own 2 sigma."""
    intervals = comparison.intervals
    figure = empty_figure(10, 1.2 + 2.0 * len(intervals))
    panels = figure.subplots(len(intervals), 1, sharex=True, squeeze=False)[:, 0]
    origin = comparison.recording.imu.stamp[0]
    for axes, interval in zip(panels, intervals):
        for model in comparison.models:
            errors = comparison.run_of(model, interval).errors
            time = (errors.stamp - origin) * 1e-9
            axes.plot(*_peaks(time, errors.horizontal), **_style(model, 0.7),
                      label=model_name(comparison, model))
        name = model_name(comparison, comparison.models[-1])
        axes.plot(*_peaks(time, 2 * errors.sigma), color='0.6', linewidth=0.8, zorder=1,
                  label=f"2 sigma as the filter states it ({name})")
        turns = runs(errors.turning)
        for first, last in turns:
            axes.axvspan(time[first], time[last - 1], color='0.93', linewidth=0, zorder=0,
                         label='turning' if first == turns[0, 0] else None)
        axes.set_ylabel('horizontal error, m')
        axes.set_title(f'fixes each {interval:g} s', fontsize=10, loc='left')
        largest = max(comparison.run_of(m, interval).summary['horizontal_max_m'] for m in comparison.models)
        axes.set_ylim(0, 1.2 * largest)  # not the filter's sigma at its start
        axes.margins(x=0)
    panels[-1].set_xlabel('time, s')
    legend_below(figure)
    return figure


def _peaks(time, values):
    """At most POINTS of the points, the largest value of each part: the visible outline of a dense line."""
    every = -(-len(time) // POINTS)
    if every == 1:
        return time, values
    first = np.arange(0, len(time), every)
    return time[first], np.maximum.reduceat(values, first)


def error_against_interval(comparison: Comparison):
    """RMS error of each model against the update interval: with its 95 % interval; in turns and on straights."""
    figure = empty_figure(10, 3.8)
    whole, parts = figure.subplots(1, 2, sharey=True)
    intervals = comparison.intervals
    for place, model in enumerate(comparison.models):
        summaries = [comparison.run_of(model, i).summary for i in intervals]
        value = np.array([s['horizontal_rmse_m'] for s in summaries])
        bounds = np.array([s['horizontal_rmse_interval_m'] or (v, v) for s, v in zip(summaries, value)])
        x = np.arange(len(intervals)) + 0.12 * (place - (len(comparison.models) - 1) / 2)
        whole.errorbar(x, value, yerr=np.abs(bounds.T - value), color=colours.MODELS[model], marker='o', capsize=3,
                       label=model_name(comparison, model))
        for key, style, name in (('turning_rmse_m', '-', 'turns'), ('straight_rmse_m', ':', 'straights')):
            parts.plot(x, [np.nan if s[key] is None else s[key] for s in summaries], color=colours.MODELS[model],
                       marker='o', linestyle=style, label=f'{model_name(comparison, model)}, {name}')
    for axes in (whole, parts):
        axes.set_xticks(range(len(intervals)), [f'{i:g}' for i in intervals])
        axes.set_xlabel('update interval, s')
        axes.grid(axis='y', color='0.92')
        axes.legend(loc='upper left', fontsize=8)
        axes.set_ylim(bottom=0)
    whole.set_ylabel('RMS horizontal error, m')
    return figure


def outage_growth(comparison: Comparison):
    """Error against time since the last fix, RMS over the outages of the longest duration that has any."""
    results = [r for r in comparison.outages if len(r.outages.begin)]
    if not results:
        return None
    longest = max(r.outages.duration for r in results)
    figure = empty_figure(8, 4.4)
    axes = figure.add_subplot()
    for result in (r for r in results if r.outages.duration == longest):
        outages, name = result.outages, model_name(comparison, result.model)
        axes.plot(outages.time, np.sqrt((outages.growth**2).mean(axis=0)), color=colours.MODELS[result.model],
                  linewidth=1.2 * colours.WIDTHS[result.model], label=f'{name}: RMS error')
        axes.plot(outages.time, 2 * np.sqrt((outages.sigma**2).mean(axis=0)), color=colours.MODELS[result.model],
                  linewidth=1.0, linestyle='--', label=f"{name}: 2 sigma as the filter states it")
    axes.set_xlabel('time since the last fix, s')
    axes.set_ylabel('horizontal error, m')
    axes.set_xlim(0, longest)
    axes.set_ylim(bottom=0)
    axes.grid(color='0.92')
    axes.legend(loc='upper left', fontsize=8)
    return figure
