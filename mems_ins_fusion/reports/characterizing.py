"""From a recording at rest to a folder of results: the work of the tool `characterize`."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..characterization.characterize import Characterization, read_npz
from ..characterization.parameter_file import parameters_yaml
from ..characterization.stationary import Grid, to_grid
from ..errors import InputError
from ..filter.runs.usable import usable_samples
from ..recordings.checker import check_recording
from ..recordings.errors import collected_warnings
from ..recordings.reading import Memory, read_recording
from ..recordings.remarks import Remark
from ..recordings.units import in_si
from ..results import json_text
from .characterization import report, report_html
from .characterization_answer import answer
from .characterization_figures import figures
from .html import figure, image_bytes, narrow_bytes

#: memory: GB without samples, bytes for each sample
_MEMORY = 0.3, 500.0


@dataclass(frozen=True)
class RestRecording:
    """A recording at rest. temperature: s and degrees Celsius, or None. begin: ns, of its first sample, None without
    stamps. found: findings of the checker. said: messages of the reader."""

    name: str
    grid: Grid
    temperature: tuple[np.ndarray, np.ndarray] | None
    begin: int | None
    found: list[Remark]
    said: list[str]


def read_at_rest(path, values: dict, progress: Callable[[float], None] = lambda part: None) -> RestRecording:
    """Read a bag with the topics of the checked parameters `values`, or an .npz file. Raises InputError."""
    path = Path(path)
    if path.suffix == '.npz':
        if not path.is_file():
            raise InputError(f'{path} is not a file')
        return RestRecording(path.stem, read_npz(path), None, None, [], [])
    with collected_warnings() as said:
        recording = read_recording(path, values['imu_topic'], temperature_topic=values['temperature_topic'] or None,
                                   progress=progress, memory=Memory(values['memory_limit'], *_MEMORY))
    imu = in_si(recording.imu, values['imu.acceleration_unit'], values['imu.rate_unit'])
    seen = usable_samples(imu, values['imu.max_specific_force'], values['imu.max_angular_rate'])
    grid = to_grid(seen.stamp, np.hstack([seen.specific_force, seen.angular_rate]))
    temperature = recording.temperature
    if temperature is not None:
        temperature = (temperature.stamp - seen.stamp[0]) * 1e-9, temperature.celsius
    return RestRecording(recording.name, grid, temperature, int(seen.stamp[0]),
                         check_recording(replace(recording, imu=imu)),
                         said)


def write_characterization(result: Characterization, given: RestRecording, values: dict, folder: Path, known_as: str,
                           pages: bool = True):
    """Write imu.yaml into `folder`, and with `pages` report.json, report.html and figures. Returns the answer.

    known_as: name of the folder on the page.
    """
    topics = {name: values[f'{name}_topic'] for name in ('imu', 'temperature')}
    answered = answer(result, given.found, topics, known_as)
    (folder / 'imu.yaml').write_text(parameters_yaml(result), encoding='utf-8')
    if pages:
        content = {**report(result, answered), 'warnings': given.said}
        (folder / 'report.json').write_text(json_text(content, indent=1), encoding='utf-8')
        (folder / 'figures').mkdir()
        images = {}
        for title, (drawing, caption) in figures(result).items():
            png = image_bytes(drawing)
            (folder / 'figures' / f'{title}.png').write_bytes(png)
            images[title] = figure(png, caption, narrow=narrow_bytes(drawing))
        (folder / 'report.html').write_text(report_html(result, answered, images), encoding='utf-8')
    return answered
