"""One job, done in a process of its own: from recordings to a folder with `result.json` and pages."""
from __future__ import annotations

import json
import math
import traceback
import warnings
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..evaluation.verdict import NOT_USABLE
from ..parameters import params_file, table
from ..recordings.errors import RecordingError, collected_warnings
from ..recordings.remarks import ERROR, WARNING
from ..results import ResultBusy, plain, result_folder
from .failures import OTHER_VERSION, WORKER_DIED, error_id, is_ours, reason
from .jobs import Job, code, from_dict
from .sources import content_id, local_copy, size_and_time

#: name of the file of a complete result, and folder of the results below the output folder
RESULT, RESULTS = 'result.json', 'results'


def identify(place: str) -> tuple[str, int, str] | None:
    """Identity, size and time of change of what `place` names; None if it cannot be read."""
    try:
        size, time = size_and_time(place)
        with local_copy(place) as path:
            return content_id(path), size, time
    except (OSError, ValueError):
        return None


def do_job(values: dict, output: str) -> str:
    """Do the job `values` (see `jobs.from_dict`) and write its result below `output`. Returns its id.

    Any error becomes a result that describes it. Only exceptions that end the process are raised.
    """
    work = from_dict(values)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', RuntimeWarning)  # NumPy warnings about impossible values of sensors
            _do(work, Path(output) / RESULTS / work.id)
    except ResultBusy:  # another shard works on the same recording
        pass
    return work.id


def _do(work: Job, known_as: Path) -> None:
    with result_folder(known_as, overwrite=True, marker=RESULT) as folder:
        with ExitStack() as opened:
            try:
                if work.code != code():
                    raise _OtherVersion('the worker has another version of the package than the one who asks')
                paths = [opened.enter_context(local_copy(place)) for place in work.recordings]
                result = {'status': 'done', 'error_id': '', 'reason': '', **_run(work, paths, opened, folder, known_as)}
            except Exception as error:  # noqa: BLE001 one broken recording stops nobody
                names = [n for place in work.recordings for n in (place, Path(place).name, Path(place).stem)]
                found = OTHER_VERSION if isinstance(error, _OtherVersion) else error_id(error, names)
                result = failed(found, reason(error))
                if not is_ours(error):
                    (folder / 'traceback.txt').write_text(traceback.format_exc(), encoding='utf-8')
        write(folder, result)


class _OtherVersion(InputError):
    pass


def record_crash(values: dict, output: str) -> str:
    """Write the result of a job whose worker ended twice; returns its id."""
    work = from_dict(values)
    with result_folder(Path(output) / RESULTS / work.id, overwrite=True, marker=RESULT) as folder:
        write(folder, failed(WORKER_DIED, 'the worker process ended while it had this recording, twice (out of memory, '
                             'killed, or a crash)'))
    return work.id


def failed(error: str, why: str) -> dict:
    return {'status': 'failed', 'error_id': error, 'reason': why}


def write(folder: Path, result: dict) -> None:
    (folder / RESULT).write_text(json.dumps(plain(result), indent=1, sort_keys=True) + '\n', encoding='utf-8')


def _run(work: Job, paths: list[Path], opened: ExitStack, folder: Path, known_as: Path) -> dict:
    """The rows of the tables by `work`, and the columns of its recording."""
    given = params_file.load_files([opened.enter_context(local_copy(work.params_file))] if work.params_file else [])
    references = [str(opened.enter_context(local_copy(r))) if r else '' for r in work.references]
    given = given | {'memory_limit': work.options['memory_gb']}
    run = {'look': _look, 'replay': _replay, 'characterize': _characterize, 'configure': _configure,
           'diagnose': _diagnose}[work.task]
    return run(work, paths, references, given, folder, known_as)


def _replay(work: Job, paths, references, given, folder: Path, known_as: Path) -> dict:
    from ..evaluation.comparison import outage_row, run_row

    [path], [reference] = paths, references
    given = given | {'bag': [str(path)], 'output_dir': str(folder / 'replay'), 'publish': False, 'overwrite': False}
    if reference:
        given = given | {'reference_file': reference, 'reference_topic': ''}
    values = table.check(given)
    comparison, findings, said = (_replayed_with_pages if work.options['pages'] else _replayed)(values, known_as)
    notices = dict.fromkeys(n.text for r in comparison.runs for n in r.run.notices if n.level != 'info')
    rows = {
        'results': [_run_row(run_row(r, comparison.mechanization, '')) for r in comparison.runs],
        'outages': [_without(outage_row(r, comparison.mechanization, ''), 'recording', 'smoothed')
                    for r in comparison.outages],
        'findings': [*findings, *_said('reader', said), *_said('filter', notices)],
        'effects': _shown_by_recording(comparison.recording)}
    return {'recording': _about(comparison.recording), 'rows': rows,
            'page': 'replay/report.html' if work.options['pages'] else ''}


def _replayed(values: dict, known_as: Path):
    """The comparison, the findings of the checker, and the messages of the reader."""
    from ..configuration.check import check
    from ..evaluation.comparison import compare
    from ..reports.replay import read_part

    for name in ('models', 'update_intervals'):
        if not values[name]:
            raise InputError(f"parameter '{name}' is empty")
    recording, said = read_part(values['bag'][0], values, lambda part: None)
    return compare(recording, values), _checked(check(recording, values), values), said


def _replayed_with_pages(values: dict, known_as: Path):
    from ..reports.replay import replay_recordings

    done = replay_recordings(values, known_as=known_as / 'replay')
    [comparison], [about] = done.comparisons.values(), done.content['recordings']
    [found] = done.findings.values()
    return comparison, _checked(found, values), about['warnings']


def _checked(found, values: dict) -> list[dict]:
    """The findings of the checker as rows; of severity error only those that make the recording unusable with `values`.
    """
    from ..reports.verdict import certainly_wrong

    wrong = [id(f) for f in certainly_wrong(found, values)]
    return [_finding('checker', WARNING if f.severity == ERROR and id(f) not in wrong else f.severity, f.topic,
                     f.message) for f in found]


def _run_row(row: dict) -> dict:
    """A row of `results`: without intervals as pairs, and without times, which differ from run to run."""
    low, high = row['horizontal_rmse_interval_m'] or (None, None)
    return _without(row, 'recording', 'filter_seconds', 'horizontal_rmse_interval_m') | {
        'horizontal_rmse_low_m': low, 'horizontal_rmse_high_m': high}


def _shown_by_recording(recording) -> list[dict]:
    """Estimates from a recording alone, as rows; none if `configure` cannot use it."""
    from ..configuration.configure import evidence_of_recording

    try:
        return configured_effects(evidence_of_recording(recording.name, recording.imu, recording.gnss))
    except RecordingError:
        return []


def _look(work: Job, paths, references, given, folder: Path, known_as: Path) -> dict:
    """Estimates of `configure` from the recording alone."""
    result, said = _configured(paths)
    [drive] = result.drives
    rows = {'effects': configured_effects(drive), 'results': [], 'outages': [],
            'findings': [_finding('checker', f.severity, f.topic, f.message) for f in drive.remarks]
            + _said('reader', said) + [_finding('configure', 'info', '', text) for text in result.missing]}
    stamp = drive.imu.stamp
    return {'rows': rows, 'page': '', 'recording': {
        'begin_ns': int(stamp.min()), 'duration_s': drive.seconds, 'imu_samples': len(stamp),
        'fixes': 0 if drive.fixes is None else len(drive.fixes)}}


def configured_effects(drive) -> list[dict]:
    """Estimates of `configure` from one drive as rows of `effects`."""
    rows, found = [], drive.mounting
    if found is not None:
        known = [True, True, found.yaw_known]
        rows += [effect_row('configure', 'mounting_rotation', name, value, sigma, 'rad')
                 for name, value, sigma, seen in zip(('roll', 'pitch', 'yaw'), found.rpy, found.sigma, known) if seen]
        if found.offset is not None and found.offset.shown:
            rows.append(effect_row('configure', 'gnss_time_offset', 'time_offset', found.offset.lag,
                                   found.offset.lag_sigma, 's'))
        if found.offset is not None:
            rows += [effect_row('configure', 'gnss_lever_arm', axis, float(value), float(sigma), 'm')
                     for axis, value, sigma in zip('xyz', *found.offset.arm_alone())
                     if math.isfinite(sigma)]
    noise = drive.noise
    if noise is not None and noise.seconds:
        for sensor, density in (('accelerometer', noise.force_density), ('gyroscope', noise.rate_density)):
            rows.append(_noise_row('configure', sensor, density, noise.part))
    if drive.receiver is not None and drive.receiver.realised:
        rows.append(effect_row('configure', 'receiver', 'scatter', drive.receiver.realised, None, 'm'))
    return rows


def _noise_row(source: str, sensor: str, density, part: float) -> dict:
    """The noise density of a sensor, RMS of its axes (3,). part: its relative standard deviation."""
    value = float(np.sqrt(np.mean(np.square(density))))
    return effect_row(source, f'{sensor}_noise', 'density', value, value * part if math.isfinite(part) else None,
                      {'accelerometer': 'm/s^2/sqrt(Hz)', 'gyroscope': 'rad/s/sqrt(Hz)'}[sensor])


def _configure(work: Job, paths, references, given, folder: Path, known_as: Path) -> dict:
    from ..reports.configuration import answer, configuration_page, configuration_yaml, doubts

    result, said = _configured(paths)
    text = configuration_yaml(result)
    (folder / 'params.yaml').write_text(text, encoding='utf-8')
    if work.options['pages']:
        answered = answer(result, list(work.recordings), str(known_as / 'params.yaml'))
        (folder / 'params.html').write_text(configuration_page(result, text, answered), encoding='utf-8')
    rows = [effect_row('params_file', *parameter, None, '') for parameter in _parameters(result.values)]
    return {'rows': {'effects': rows, 'results': [], 'outages': [],
                     'findings': [_finding('configure', 'warning', '', text) for text in doubts(result)]},
            'page': 'params.html' if work.options['pages'] else ''}


def _configured(paths):
    """The result of `configure` for the recordings, and the messages of the reader."""
    from ..configuration.configure import configure

    with collected_warnings() as said:
        result = configure(paths)
    return result, list(dict.fromkeys(said))


def _diagnose(work: Job, paths, references, given, folder: Path, known_as: Path) -> dict:
    from ..recordings.several import one_after_another
    from ..reports.diagnosing import diagnose_drives

    values = table.check(given)
    drives, findings = _drives(work, paths, references, values)
    done = diagnose_drives(list(drives.values()), values, given, folder, str(known_as), work.options['pages'])
    names = [recording.name for recording in one_after_another([drive.recording for drive in drives.values()])]
    rows = diagnosed(done.content, dict(zip(names, drives)))
    rows['findings'] += findings
    return {'rows': rows, 'page': 'report.html' if work.options['pages'] else ''}


def _drives(work: Job, paths, references, values: dict):
    """The drives to be diagnosed, by identity, and what is wrong with the others: those that cannot be read with these
    parameters, and those that are certainly not usable. If no drive is good, all that could be read."""
    from ..reports.diagnosing import read_drive

    drives, findings, failed = {}, [], None
    for content, path, reference in zip(work.contents, paths, references):
        own = values | {'reference_file': reference, 'reference_topic': ''} if reference else values
        try:
            drives[content] = read_drive(path, own)
        except InputError as error:
            failed = failed or error
            findings.append(_finding('diagnose', 'error', '', reason(error)) | {'recording_id': content})
            continue
        findings += [_finding('diagnose', f.severity, f.topic, f.message) | {'recording_id': content}
                     for f in drives[content].wrong]
    if not drives:
        raise failed
    return {content: drive for content, drive in drives.items() if not drive.wrong} or drives, findings


def diagnosed(content: dict, contents: dict[str, str]) -> dict:
    """Rows of the tables from the `report.json` of a diagnosis. contents: identities by the names of the drives; a row
    of one drive has its identity as `recording_id`."""
    effects = []
    for effect in content['effects']:
        about = {'added': effect['added'], 'p_value': effect['p_value'], 'gain': effect['log_likelihood_gain'],
                 'cannot_be_told_from': ' '.join(n for n in effect['group'] if n != effect['name'])}
        for recording_id, parameters in [('', effect['parameters']), *(
                (contents.get(name, name), found) for name, found in effect['drives'].items())]:
            effects += [effect_row('diagnose', effect['name'], name, e['value'], e['sigma'], e['unit'], **about)
                        | {'recording_id': recording_id} for name, e in parameters.items()]
    common = {'model': content['model'], 'mechanization': content['mechanization']}
    stages = [stage for stage in ('before', 'after') if stage in content]  # data that are not usable have none
    numbers = ('horizontal_rmse_m', 'horizontal_p95_m', 'nis_mean')
    results = [common | {'stage': stage} | {name: content[stage].get(name) for name in numbers} for stage in stages]
    outages = [row | {'stage': stage} for stage in stages for row in content[stage]['outages']]
    findings = []  # findings of the checker are in the results of each recording
    if content.get('unexplained'):
        findings.append(_finding('diagnose', 'warning', '', 'a part of the innovations stays unexplained'))
    verdict = content['verdict']
    severity = 'error' if verdict['answer'] == NOT_USABLE else 'info'
    findings.append(_finding('diagnose', severity, 'verdict', f'{verdict["answer"]}: {"; ".join(verdict["because"])}'))
    findings += _said('diagnose', content.get('remarks', ())) + _said('reader', content['warnings'])
    return {'effects': effects, 'results': results, 'outages': outages, 'findings': findings}


def _characterize(work: Job, paths, references, given, folder: Path, known_as: Path) -> dict:
    from ..characterization.characterize import SENSORS, characterize
    from ..characterization.parameter_file import white_noise
    from ..reports.characterizing import read_at_rest, write_characterization

    [path], values = paths, table.check(given)
    read = read_at_rest(path, values)
    result = characterize(read.name, read.grid, read.temperature)
    write_characterization(result, read, values, folder, str(known_as), work.options['pages'])
    rows = [effect_row('characterize', *parameter, None, '')
            for parameter in _parameters(params_file.load_yaml(folder / 'imu.yaml'))]
    for sensor in SENSORS:
        white = [white_noise(axis, result.model) for axis in result.of(sensor)]
        density = np.array([w.value for w in white])
        # each axis was fitted separately: their errors are independent
        part = float(np.linalg.norm([w.value * w.sigma for w in white])) / max(float(density @ density), 1e-30)
        rows.append(_noise_row('characterize', sensor, density, part))
    findings = [_finding('checker', f.severity, f.topic, f.message) for f in read.found] + _said('reader', read.said)
    about = {'begin_ns': read.begin, 'duration_s': float(result.duration),
             'imu_samples': len(read.grid.values), 'fixes': None}
    return {'recording': about, 'rows': {'effects': rows, 'results': [], 'outages': [], 'findings': findings},
            'page': 'report.html' if work.options['pages'] else ''}


def _parameters(values: dict):
    """(effect, parameter, value) of each number among parameters; vectors by component."""
    for name, value in values.items():
        head, _, tail = name.rpartition('.')
        numbers = value if isinstance(value, list) else [value]
        for i, number in enumerate(numbers):
            if isinstance(number, (int, float)) and not isinstance(number, bool):
                yield head or name, f'{tail}[{i}]' if isinstance(value, list) else tail, float(number)


def effect_row(source: str, effect: str, parameter: str, value: float, sigma: float | None, unit: str,
               **others) -> dict:
    return {'source': source, 'effect': effect, 'parameter': parameter, 'value': value, 'sigma': sigma, 'unit': unit,
            **others}


def _finding(source: str, severity: str, topic: str, message: str) -> dict:
    return {'source': source, 'severity': severity, 'topic': topic, 'message': message}


def _said(source: str, texts) -> list[dict]:
    return [_finding(source, 'warning', '', text) for text in texts]


def _about(recording) -> dict:
    stamp = recording.imu.stamp
    return {'begin_ns': int(stamp.min()), 'duration_s': float(stamp.max() - stamp.min()) * 1e-9,
            'imu_samples': len(stamp), 'fixes': len(recording.gnss)}


def _without(row: dict, *names: str) -> dict:
    return {name: value for name, value in row.items() if name not in names}
