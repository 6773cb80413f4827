"""Data of the charts over time: estimates of a replay and raw signals, a diagnosis before and after."""
from __future__ import annotations

import numpy as np
from scipy.signal import welch

from ..diagnosis.findings import Diagnosis
from ..evaluation.comparison import Comparison
from ..filter.memory import Event, Kind, Verdict
from ..filter.runs.results import Run
from ..samples import ImuSamples
from . import colours
from .charts import Chart, Line
from .layers import seconds

#: x, y and z, and north, east and down
AXES = ('#d55e00', '#009e73', '#0072b2')
#: largest number of points of a spectrum
SPECTRUM = 300
#: number of samples of each segment of Welch's method
STRETCH = 4096
#: number of standard deviations that contain 95 % of a normal distribution
TWICE = 1.96


def replay_charts(comparison: Comparison, best: str) -> list[Chart]:
    """The run of the model `best` with all fixes, and the raw signals."""
    run, origin = comparison.run_of(best, comparison.intervals[0]).run, int(comparison.recording.imu.stamp[0])
    errors = comparison.run_of(best, comparison.intervals[0]).errors
    return [_with_truth(chart, comparison, origin) for chart in _states(run, origin)] + [
        Chart('Horizontal error, and twice its sigma', 'm', seconds(errors.stamp, origin), [
            Line('error', colours.AFTER, errors.horizontal), Line('2 sigma', colours.FITTED, 2 * errors.sigma)]),
        *_innovations(run, origin), *_sensor_errors(run, origin), *signal_charts(comparison.recording.imu, origin)]


def diagnosis_charts(diagnosis: Diagnosis) -> list[Chart]:
    """Errors before and after, innovations as configured, and the raw signals of one drive."""
    d, [problem] = diagnosis, diagnosis.problem.each
    origin = int(d.recording.imu.stamp[0])
    charts = []
    stages = [('as configured', d.before, colours.BEFORE)] + (
        [('with corrected.yaml', d.after, colours.AFTER)] if d.changed else [])
    stamp = np.unique(np.concatenate([m.continuous.stamp for _, m, _ in stages]))
    lines = [line for name, measured, colour in stages for line in (
        Line(name, colour, _at(stamp, measured.continuous.stamp, measured.continuous.horizontal)),
        Line(f'{name}: 2 sigma', colour, _at(stamp, measured.continuous.stamp, 2 * measured.continuous.sigma), 1.0,
             dash=(4, 3)))]
    charts.append(Chart('Horizontal error with the fixes used', 'm', seconds(stamp, origin), lines))
    residual = d.residuals['before']
    for k, name in enumerate(('north', 'east')):
        sigma = TWICE * np.sqrt(residual.s[:, 2 * k])
        charts.append(_innovation(f'Innovations {name} as configured', seconds(problem.stamp, origin),
                                  residual.z[:, k], sigma))
    return charts + signal_charts(d.recording.imu, origin)


def signal_charts(imu: ImuSamples, origin: int) -> list[Chart]:
    """Raw samples over time, their spectra, and the intervals between them."""
    time = seconds(imu.stamp, origin)
    order = np.maximum.accumulate(time) == time  # samples after a step back of the clock are left out
    time, force, rate = time[order], imu.specific_force[order], np.degrees(imu.angular_rate[order])
    step = np.diff(time)
    charts = [Chart('Specific force, sensor axes', 'm/s²', time, _axes(force)),
              Chart('Angular rate, sensor axes', 'deg/s', time, _axes(rate))]
    if len(step) and np.median(step) > 0:
        charts.append(Chart('Time from one IMU sample to the next', 'ms', time[1:],
                            [Line('interval', colours.AFTER, 1e3 * step)], log=bool(step.max() > 10 * np.median(step))))
        charts += [chart for name, unit, values in (('Specific force', 'm/s²/√Hz', force),
                                                    ('Angular rate', 'deg/s/√Hz', rate))
                   for chart in _spectrum(f'{name}: amplitude spectrum', unit, values, 1.0 / float(np.median(step)))]
    return charts


def _axes(values: np.ndarray) -> list[Line]:
    return [Line(name, colour, values[:, k]) for k, (name, colour) in enumerate(zip('xyz', AXES))]


def _spectrum(title: str, unit: str, values: np.ndarray, rate: float) -> list[Chart]:
    """Amplitude spectral density by Welch's method (P. D. Welch, 1967), with a constant sampling `rate`, Hz."""
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 64:
        return []
    frequency, power = welch(values, rate, nperseg=min(STRETCH, len(values)), axis=0)
    wanted = np.unique(np.searchsorted(frequency, np.geomspace(frequency[1], frequency[-1], SPECTRUM)))
    wanted = wanted[(wanted > 0) & (wanted < len(frequency))]
    return [Chart(title, unit, frequency[wanted], _axes(np.sqrt(power[wanted])), log=True, frequency=True)]


def _states(run: Run, origin: int) -> list[Chart]:
    time = seconds(run.stamp, origin)
    sigma = run.sigma[:, :2]
    return [Chart('Speed', 'm/s', time, [Line('filter', colours.AFTER, np.hypot(*run.velocity[:, :2].T))]),
            Chart('Heading, clockwise from north', 'deg', time, [
                Line('filter', colours.AFTER, _heading(run.yaw))]),
            Chart('Height', 'm', time, [Line('filter', colours.AFTER, run.height)]),
            Chart('Sigma of the position', 'm', time, [Line('north', AXES[0], sigma[:, 0]),
                                                       Line('east', AXES[1], sigma[:, 1])], log=True)]


def _with_truth(chart: Chart, comparison: Comparison, origin: int) -> Chart:
    """`chart` with the values of the reference, if it has them."""
    reference = comparison.truth.reference
    known = {'Height': reference.height, 'Speed': None if reference.velocity is None else
             np.hypot(*reference.velocity[:, :2].T), 'Heading, clockwise from north': None if reference.yaw is None else
             _heading(reference.yaw)}.get(chart.title)
    if known is None:
        return chart
    time = seconds(reference.stamp, origin)
    nearest = np.clip(np.searchsorted(time, chart.x), 0, len(time) - 1)
    there = np.abs(time[nearest] - chart.x) < 0.5
    truth = Line(comparison.truth.source, colours.FITTED, np.where(there, known[nearest], np.nan), 2.4)
    return Chart(chart.title, chart.unit, chart.x, [truth, *chart.lines])


def _heading(yaw: np.ndarray) -> np.ndarray:
    """`yaw` (n,) rad as 0 to 360 deg; NaN where it passes north, so that no line is drawn across the chart."""
    heading = np.degrees(yaw) % 360.0
    heading[1:][np.abs(np.diff(heading)) > 180.0] = np.nan
    return heading


def _innovations(run: Run, origin: int) -> list[Chart]:
    """Innovations with twice their sigma, and the normalized innovation squared of used and refused fixes."""
    of = run.innovations
    time = seconds(of.stamp, origin)
    charts = [_innovation(f'Innovations {name}', time, of.z[:, k], TWICE * np.sqrt(of.s[:, 2 * k]))
              for k, name in enumerate(('north', 'east'))]
    given = run.measured.select(run.measured.kind == Kind.POSITION)
    stamp, verdict, nis = given.stamp, given.event[:, Event.VERDICT], given.event[:, Event.NIS]
    order = np.argsort(stamp, kind='stable')
    lines = [Line(name, colour, np.where(which, nis, np.nan)[order], dots=True) for name, colour, which in (
        ('used', colours.AFTER, verdict != Verdict.REFUSED), ('refused', colours.BEFORE, verdict == Verdict.REFUSED))]
    return [*charts, Chart('Normalized innovation squared (NIS, 2 on average) of each fix', '',
                           seconds(stamp[order], origin), lines, log=True)]


def _innovation(title: str, time: np.ndarray, z: np.ndarray, twice_sigma: np.ndarray) -> Chart:
    return Chart(title, 'm', time, [Line('fix minus prediction', colours.AFTER, -z, dots=True),
                                    Line('+ 2 sigma', colours.FITTED, twice_sigma),
                                    Line('- 2 sigma', colours.FITTED, -twice_sigma)], ('+ 2 sigma', '- 2 sigma'))


def _sensor_errors(run: Run, origin: int) -> list[Chart]:
    """Estimated errors of accelerometers and gyroscopes with their sigma."""
    layout, time, charts = run.config.layout, seconds(run.stamp, origin), []
    for first, title, unit, scale in (('f', 'Estimated errors of the accelerometers', 'mm/s²', 1e3),
                                      ('w', 'Estimated errors of the gyroscopes', 'deg/h', np.degrees(3600.0))):
        lines = []
        for k, channel in enumerate(layout.channels):
            if channel[0] == first:
                value = scale * run.sensor_errors[:, k]
                state = layout.index(channel) if layout.order == 1 else layout.index(f'{channel}.1')
                sigma, colour = scale * run.sigma[:, state], AXES['xyz'.index(channel[-1])]
                lines += [Line(channel, colour, value), Line(f'{channel} + sigma', colour, value + sigma, 0.8,
                                                             dash=(4, 3)),
                          Line(f'{channel} - sigma', colour, value - sigma, 0.8, dash=(4, 3))]
        charts.append(Chart(title, unit, time, lines))
    return charts


def _at(wanted: np.ndarray, stamp: np.ndarray, values: np.ndarray) -> np.ndarray:
    """`values` at the `wanted` stamps that are among `stamp`, NaN at others."""
    found = np.full(len(wanted), np.nan)
    found[np.searchsorted(wanted, stamp)] = values
    return found
