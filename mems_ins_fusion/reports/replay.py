"""From recordings to a folder of results: the work of `replay_node` without ROS."""
from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..configuration.check import check
from ..diagnosis.applying import live_output
from ..diagnosis.quantity import CHANGED, FindingState
from ..diagnosis.watch import RecordingWatch, live_messages
from ..evaluation.comparison import Comparison, ReplayError, compare, time_span
from ..filter.config import FilterConfig
from ..filter.measurements.registry import further_inputs, named_parameters
from ..filter.runs.imus import as_one
from ..filter.runs.intake import first_datum
from ..filter.runs.odometry import ORIENTATION, POSE_COVARIANCE, POSITION
from ..parameters.parameter import ParameterError
from ..parameters.params_file import yaml_value
from ..parameters.table import FILTER
from ..parameters.table import defaults as default_parameters
from ..recordings.errors import collected_warnings
from ..recordings.reading import Memory, read_recording
from ..recordings.reference_files import read_reference
from ..recordings.remarks import ERROR, Remark, checked_text
from ..recordings.several import free_name
from ..recordings.units import in_si
from ..results import result_folder
from ..samples import Recording
from . import trajectories
from .answer import Answer, topics_of
from .replay_answer import answer, best_model
from .replay_report import FIGURES, draw_figures, online_row, report, report_page, write_report

#: file with the parameters of the replay, for the next command
PARAMS_FILE = 'parameters.yaml'
#: file with the output of a live node, with diagnosis.online `apply`
DRIVEN = 'driven.tum'

#: memory of replay and diagnosis: GB without a recording, bytes for each message
_MEMORY = 0.75, 500.0
#: called with the part of the work that is done, 0 to 1, and the current step; an exception ends the work
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Replay:
    """Results of a replay. folder: of the files. content: of report.json. comparisons, answers, findings: by recording.
    """

    folder: Path
    content: dict
    comparisons: dict[str, Comparison]
    answers: dict[str, Answer]
    findings: dict[str, list[Remark]]


def replay_recordings(values: dict, progress: Progress = lambda part, what: None, known_as=None) -> Replay:
    """Replay the recordings `bag` and write the results to `output_dir`.

    values: checked parameters. known_as: name of the folder on the pages, if `output_dir` is temporary. Raises a
    ValueError with one line for the user (ParameterError, RecordingError, ResultError, ReplayError); in this case, and
    if `progress` raises, nothing is written.
    """
    _check(values)
    timing: dict[str, float] = {}
    with result_folder(values['output_dir'], values['overwrite'], option='-p overwrite:=true') as folder:
        comparisons, findings, said, online = {}, {}, {}, []
        for i, path in enumerate(values['bag']):
            part = _Part(progress, i / len(values['bag']), 1 / len(values['bag']))
            with _timed(timing, 'reading'):
                recording, texts = read_part(path, values, lambda done: part(0.25 * done, 'reading'))
            name = free_name(recording.name, comparisons)
            said[name] = texts
            with _timed(timing, 'checking'):
                findings[name] = check(recording, values)
            with _timed(timing, 'filter and errors'):
                try:
                    comparisons[name] = compare(recording, values, lambda done: part(0.25 + 0.3 * done, 'filtering'))
                except ReplayError:
                    # the checker lists everything that is wrong, the filter only the first reason why it does not start
                    wrong = [checked_text(f, topics_of(values)) for f in findings[name] if f.severity == ERROR]
                    if not wrong:
                        raise
                    raise ReplayError(f'{name}: {"; ".join(wrong)}') from None
            if values['diagnosis.online'] != 'off':
                with _timed(timing, 'diagnosis.online'):
                    def watching(done):
                        part(0.55 + 0.05 * done, 'diagnosing')
                    if values['diagnosis.online'] == 'apply':
                        driven_to = folder / (f'{name}_{DRIVEN}' if len(values['bag']) > 1 else DRIVEN)
                        watch = RecordingWatch(recording, values, watching)
                        changes = _drive(driven_to, comparisons[name], values, watch)
                        told = watch.said + changes
                    else:
                        told = live_messages(recording, values, watching)
                online += [online_row(quantity, name, int(recording.imu.stamp[0])) for quantity in told]
        content, answers = _write(folder, comparisons, findings, said, online, values, timing, progress,
                                  Path(known_as or values['output_dir']))
    return Replay(Path(values['output_dir']), content, comparisons, answers, findings)


def _drive(path: Path, comparison: Comparison, values: dict, watch: RecordingWatch) -> list[FindingState]:
    """Write the output of a live node with the findings while driving; if it changed its parameters."""
    run = live_output(comparison.recording, values, watch, origin(comparison, values))
    kept = trajectories.first_in_each_slot(run.stamp, trajectories.POSE_INTERVAL)
    rows = run.odometry[kept]
    trajectories.write_tum(path, run.stamp[kept], rows[:, POSITION:ORIENTATION], rows[:, ORIENTATION:POSE_COVARIANCE])
    return [FindingState(handover.stamp, 'filter', CHANGED, {}, text=handover.text, applied=True)
            for handover in run.handovers]


def _check(values: dict) -> None:
    for name, why in (('bag', 'no recording to replay'), ('output_dir', 'no folder for the results'),
                      ('models', 'no model to compare'), ('update_intervals', 'no update interval')):
        if not values[name]:
            raise ParameterError(f"parameter '{name}' is empty: {why}")
        if isinstance(values[name], list):
            values[name] = list(dict.fromkeys(values[name]))


def read_part(path, values: dict, progress: Callable[[float], None]) -> tuple[Recording, list[str]]:
    """The part of the recording `path` that `values` select, and the messages of the reader.

    Raises ParameterError, RecordingError or ReplayError.
    """
    if values['stop'] and values['stop'] <= values['start']:
        raise ParameterError(f"parameter 'stop' must be after start {values['start']:g} s, got {values['stop']:g}")
    if not values['gnss_topic']:
        raise ParameterError("parameter 'gnss_topic' is empty: without fixes there is nothing to fuse or to measure")
    if values['reference_topic'] and values['reference_file']:
        raise ParameterError("parameters 'reference_topic' and 'reference_file' are both given: choose one")
    with collected_warnings() as said:
        recording = _read_whole(path, values, progress)
    recording = replace(recording, imu=in_si(recording.imu, values['imu.acceleration_unit'], values['imu.rate_unit']))
    recording, notices = as_one(recording, values)
    return time_span(recording, values['start'], values['stop']), [*said, *notices]


def _read_whole(path, values: dict, progress) -> Recording:
    datum, inputs = _datum(values), further_inputs(values)
    recording = read_recording(path, values['imu_topic'], values['gnss_topic'], values['reference_topic'] or None,
                               values['temperature_topic'] or None, progress, datum,
                               Memory(values['memory_limit'], *_MEMORY),
                               inputs, **{one.topic: values[one.topic] for one in inputs})
    if values['reference_file']:
        recording = replace(recording, reference=read_reference(values['reference_file'], datum))
    return recording


def _datum(values: dict) -> tuple[float, float, float] | None:
    """The parameter `datum` in rad, rad, m."""
    datum = values['datum']
    return (math.radians(datum[0]), math.radians(datum[1]), datum[2]) if datum else None


class _Part:
    """Progress of one part of the work as progress of the whole."""

    def __init__(self, progress: Progress, first: float, share: float):
        self.progress, self.first, self.share = progress, first, share

    def __call__(self, part: float, what: str) -> None:
        self.progress(self.first + self.share * part, what)


@contextmanager
def _timed(timing: dict, what: str) -> Iterator[None]:
    """Add the CPU time of the block, all threads together, to timing[what]."""
    began = time.process_time()
    yield
    timing[what] = timing.get(what, 0.0) + time.process_time() - began


def parameters_yaml(comparisons: dict[str, Comparison], values: dict) -> str:
    """The params file of the replayed filter: parameters that are not at their defaults, and the best model."""
    given = default_parameters()
    names = [p.name for p in (*FILTER, *named_parameters(values, given).values())
             if values[p.name] != given.get(p.name) and p.name != 'sensor_error_model']
    model = best_model(next(iter(comparisons.values())), values['sensor_error_model'])
    lines = ['# Parameters of a replay that are not at their default; sensor_error_model: the best of those replayed.',
             '/**:', '  ros__parameters:', f'    sensor_error_model: {model}',
             *(f'    {name}: {yaml_value(values[name])}' for name in names)]
    return '\n'.join(lines) + '\n'


def _write(folder: Path, comparisons, findings, said, online, values, timing, progress,
           known_as: Path) -> tuple[dict, dict[str, Answer]]:
    several = len(comparisons) > 1
    with _timed(timing, 'trajectories'):
        for name, comparison in comparisons.items():
            _write_trajectories(folder, f'{name}_' if several else '', comparison, values)
            progress(0.6, 'trajectories')
    figures = {}
    steps = len(comparisons) * len(FIGURES)
    with _timed(timing, 'figures'):
        for i, (name, comparison) in enumerate(comparisons.items()):
            figures[name] = draw_figures(f'{name}_' if several else '', comparison, folder,
                                         lambda: progress(0.65 + 0.3 * i / steps, 'figures'))
    params_file = known_as / PARAMS_FILE
    (folder / PARAMS_FILE).write_text(parameters_yaml(comparisons, values), encoding='utf-8')
    answers = {name: answer(c, findings[name], values, path, str(params_file))
               for (name, c), path in zip(comparisons.items(), values['bag'])}
    content = report(comparisons, values, findings, said, online, answers, timing)
    write_report(folder, content, report_page(comparisons, values, content, figures, answers))
    progress(1.0, 'done')
    return content, answers


def _write_trajectories(folder: Path, prefix: str, comparison: Comparison, values: dict) -> None:
    reference = comparison.truth.reference
    datum = origin(comparison, values)
    trajectories.write_truth(folder / f'{prefix}truth.tum', reference, datum)
    tracks = {comparison.truth.source: reference}
    for result in comparison.runs:
        name = f'{result.model}_{result.interval:g}s'
        trajectories.write_judged(folder / f'{prefix}{name}.tum', result.run, result.errors, reference, datum)
        tracks[name] = result.run
    for result in comparison.smoothed:
        name = f'{result.model}_{result.interval:g}s_smoothed'
        trajectories.write_judged(folder / f'{prefix}{name}.tum', result.run, result.errors, reference, datum)
        tracks[name] = result.run
    trajectories.write_geojson(folder / f'{prefix}tracks.geojson', tracks)
    shortest, model = comparison.intervals[0], best_model(comparison, values['sensor_error_model'])
    name = f'{comparison.recording.name}, {model}, {shortest:g} s'
    exported = {'track': (comparison.run_of(model, shortest), name),
                'smoothed': (comparison.smoothed_of(model), f'{name}, smoothed')}
    for file, (result, name) in exported.items():
        if result is not None:
            trajectories.write_csv(folder / f'{prefix}{file}.csv', result.run)
            trajectories.write_gpx(folder / f'{prefix}{file}.gpx', result.run, name)
            trajectories.write_kml(folder / f'{prefix}{file}.kml', result.run, name)
    _write_outages(folder / f'{prefix}outages.csv', comparison)
    if values['write_bag']:
        trajectories.write_bag(folder / f'{prefix}odometry', comparison.recording,
                               {m: comparison.run_of(m, shortest) for m in comparison.models}, datum, values)


#: columns of outages.csv, with a row for each outage
OUTAGE_COLUMNS = ('model', 'duration_s', 'begin_ns', 'max_error_m', 'distance_m', 'within_95', 'nees', 'announced_s',
                  'crossed_s')


def _write_outages(path: Path, comparison: Comparison) -> None:
    with open(path, 'w', encoding='ascii') as file:
        file.write(','.join(OUTAGE_COLUMNS) + '\n')
        for result in comparison.outages:
            o = result.outages
            file.writelines(f'{result.model},{o.duration:g},{begin},{error:.4f},{distance:.2f},{int(within)},{nees:.4g},'
                            f"{announced:.1f},{f'{crossed:.1f}' if crossed < np.inf else ''}\n"
                            for begin, error, distance, within, nees, announced, crossed in zip(
                                o.begin, o.max_error, o.distance, o.within, o.consistency.nees, o.announced, o.crossed))


def origin(comparison: Comparison, values: dict) -> np.ndarray:
    """Origin of the trajectories, that of the live node: the parameter `datum`, or the first fixes; rad, rad, m."""
    recording, truth = comparison.recording, comparison.truth.reference
    found = first_datum(FilterConfig.from_parameters(values), recording.imu, recording.gnss)
    return np.array([truth.latitude[0], truth.longitude[0], truth.height[0]]) if found is None else found
