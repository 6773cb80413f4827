"""From drives to a folder of results: the work of the tool `diagnose`."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..configuration.check import check
from ..diagnosis.diagnose import diagnose
from ..diagnosis.findings import Diagnosis
from ..recordings.remarks import Remark
from ..recordings.several import refuse_other_vehicles
from ..results import json_text
from ..samples import Recording
from . import diagnosis as reports
from .answer import Answer
from .diagnosis_answer import answer, not_usable
from .replay import read_part
from .verdict import certainly_wrong


@dataclass(frozen=True)
class CheckedRecording:
    """A recording. path: of the bag. found: findings of the checker. wrong: those that make it unusable. said: messages
    of the reader."""

    path: str
    recording: Recording
    found: list[Remark]
    wrong: list[Remark]
    said: list[str]


@dataclass(frozen=True)
class Diagnosed:
    """Results for some drives. result: None if the data are certainly wrong. content: of report.json."""

    result: Diagnosis | None
    answer: Answer
    content: dict
    said: list[str]


def read_drive(path, values: dict, progress: Callable[[float], None] = lambda part: None) -> CheckedRecording:
    """The part of the recording `path` that the checked parameters `values` select. Raises the errors of `read_part`.
    """
    recording, said = read_part(path, values, progress)
    found = check(recording, values)
    return CheckedRecording(str(path), recording, found, certainly_wrong(found, values), said)


def diagnose_drives(drives: Sequence[CheckedRecording], values: dict, kept: dict, folder: Path, known_as: str,
                    pages: bool = True,
                    progress: Callable[[float, str], None] = lambda part, what: None,
                    params_files: Sequence[str] = ()) -> Diagnosed:
    """Diagnose the drives of one vehicle together and write the results into `folder`: report.json, with `pages`
    report.html, and, if the data are usable, corrected.yaml.

    values: checked parameters. kept: those given, by full name, which corrected.yaml keeps. known_as: name of the
    folder on the page. params_files: files with `values`, for the commands on the page. Raises RecordingError if the
    drives are not of one vehicle, and DiagnosisError.
    """
    recordings, bags = [drive.recording for drive in drives], [drive.path for drive in drives]
    refuse_other_vehicles(recordings)
    said = [f'{_of(drive, drives)}{text}' for drive in drives for text in drive.said]
    found, wrong = ([replace(f, message=f'{_of(drive, drives)}{f.message}') for drive in drives
                     for f in getattr(drive, name)] for name in ('found', 'wrong'))
    if wrong:  # no effect is estimated from such data
        names = [recording.name for recording in recordings]
        verdict, answered = not_usable(wrong, values, bags)
        done = Diagnosed(None, answered, reports.not_usable_report(names, values, verdict, answered, found, said), said)
    else:
        result = diagnose(recordings, values, progress, spacing=values['outage_spacing'])
        answered = answer(result, found, known_as, bags, *(params_files if len(params_files) == 1 else ()))
        done = Diagnosed(result, answered, reports.report(result, answered, found, said), said)
        (folder / 'corrected.yaml').write_text(reports.corrected_yaml(result, kept), encoding='utf-8')
    (folder / 'report.json').write_text(json_text(done.content, indent=1), encoding='utf-8')
    if pages:
        page = reports.not_usable_page(names, answered, found, values) if wrong else \
            reports.report_html(done.result, kept, answered, found, said)
        (folder / 'report.html').write_text(page, encoding='utf-8')
    return done


def _of(drive: CheckedRecording, drives: Sequence[CheckedRecording]) -> str:
    """Name of the drive, if there are several."""
    return f'{drive.recording.name}: ' if len(drives) > 1 else ''
