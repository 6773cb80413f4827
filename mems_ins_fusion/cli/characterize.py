"""`characterize`: sensor error parameters from a recording of the IMU at rest."""
from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.errors import InputError
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.progress import Progress

#: GB at the start, bytes for each sample
_MEMORY = 0.3, 500.0

DESCRIPTION = """\
Characterize an IMU from a recording at rest (minutes to hours; hours for the slow errors): Allan deviation,
autocorrelation, and the parameters of the three sensor error models with their uncertainty. Writes into the output
folder: imu.yaml (for --params-file of the other tools), report.html, report.json and figures."""


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    return run(_parser(), characterize, argv)


def characterize(options: argparse.Namespace) -> str:
    """Read, characterize and write the results; lines for the user. InputError for bad options or input."""
    from mems_ins_fusion.characterization import characterize as work
    from mems_ins_fusion.characterization.parameter_file import parameters_yaml
    from mems_ins_fusion.recordings.errors import RecordingWarning
    from mems_ins_fusion.reports.characterization import data_sheet_text, report, report_html
    from mems_ins_fusion.reports.characterization_answer import answer
    from mems_ins_fusion.reports.characterization_figures import figures
    from mems_ins_fusion.reports.html import image_bytes
    from mems_ins_fusion.results import json_text, result_folder

    if min(options.orders) < 1 or max(options.orders) > 20:
        raise InputError(f'--orders must be from 1 to 20, got {" ".join(map(str, options.orders))}')
    with result_folder(options.output, options.overwrite) as folder:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter('always', RecordingWarning)
            name, grid, temperature, topics, checked = _read(options)
        said = [str(w.message) for w in caught if issubclass(w.category, RecordingWarning)]
        with Progress('characterize') as tell:
            result = work.characterize(name, grid, temperature, options.orders,
                                       lambda done, total, what: tell(done / total, what))
        answered = answer(result, checked, topics, options.output)
        (folder / 'imu.yaml').write_text(parameters_yaml(result), encoding='utf-8')
        (folder / 'report.json').write_text(json_text({**report(result, answered), 'warnings': said}, indent=1),
                                            encoding='utf-8')
        (folder / 'figures').mkdir()
        images = {}
        for title, (drawing, caption) in figures(result).items():
            images[title] = image_bytes(drawing), caption
            (folder / 'figures' / f'{title}.png').write_bytes(images[title][0])
        (folder / 'report.html').write_text(report_html(result, answered, images), encoding='utf-8')
    sheet, place = data_sheet_text(result), f'report: {options.output}/report.html'
    if not options.verbose:
        return '\n'.join([*answered.short(), *sheet, place])
    return '\n'.join([*said, *answered.lines(), '', f'{name}: {result.duration:.0f} s at rest, {len(result.rest.cuts)} '
                      'disturbances cut out', *(f'{axis.name}: {axis.recommendation.text}' for axis in result.axes),
                      f'recommended for all axes: {result.model}', '', *sheet, '', place])


def _read(options):
    """Name, grid and temperature of the recording, its topics, and what the checker found.

    InputError where it cannot be used.
    """
    from mems_ins_fusion.characterization.characterize import read_npz
    from mems_ins_fusion.characterization.stationary import to_grid

    path = Path(options.bag)
    if path.suffix == '.npz':
        if not path.is_file():
            raise InputError(f'{path} is not a file')
        return path.stem, read_npz(path), None, {}, []
    from mems_ins_fusion.filter.runs.usable import usable_samples
    from mems_ins_fusion.recordings.checker import check_recording
    from mems_ins_fusion.recordings.reading import Memory, read_recording
    from mems_ins_fusion.recordings.units import in_si

    values = table.check(params_file.load_files(options.params_file))
    with Progress('characterize') as tell:
        recording = read_recording(path, options.imu_topic or values['imu_topic'],
                                   progress=lambda part: tell(part, 'reading'),
                                   temperature_topic=options.temperature_topic or values['temperature_topic'] or None,
                                   memory=Memory(values['memory_limit'], *_MEMORY))
    imu = in_si(recording.imu, values['imu.acceleration_unit'], values['imu.rate_unit'])
    temperature = recording.temperature
    seen = usable_samples(imu, values['imu.max_specific_force'], values['imu.max_angular_rate'])
    grid = to_grid(seen.stamp, np.hstack([seen.specific_force, seen.angular_rate]))
    if temperature is not None:
        temperature = (temperature.stamp - seen.stamp[0]) * 1e-9, temperature.celsius
    topics = {'imu': options.imu_topic or values['imu_topic'],
              'temperature': options.temperature_topic or values['temperature_topic']}
    return recording.name, grid, temperature, topics, check_recording(replace(recording, imu=imu))


def _parser():
    parser = Parser('characterize', DESCRIPTION)
    add = parser.add_argument
    add('--bag', required=True, metavar='BAG', help='rosbag2 folder, .mcap, .db3 or ROS 1 .bag; or .npz with acc_mps2 '
        '(n, 3), gyro_radps (n, 3) and rate_hz')
    add('--output', required=True, metavar='DIR', help='folder for the results')
    parser.add_params_file('imu_topic and temperature_topic')
    add('--imu-topic', metavar='TOPIC', help='sensor_msgs/Imu (default: imu_topic of the params file, else /imu/data)')
    add('--temperature-topic', metavar='TOPIC', help='sensor_msgs/Temperature (default: that of the params file)')
    add('--orders', type=int, nargs='+', default=[1, 2, 3], metavar='P',
        help='orders of the autoregressive model to try (default 1 2 3)')
    parser.add_overwrite()
    parser.add_verbose()
    return parser
