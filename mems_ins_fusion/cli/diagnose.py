"""`diagnose`: what the filter cannot explain in a recording, the effect behind it, and the error without it."""
from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.progress import Progress

if TYPE_CHECKING:
    from mems_ins_fusion.recordings.findings import Finding
    from mems_ins_fusion.samples import Recording

DESCRIPTION = """\
Diagnose a drive: run the filter as configured, find what it cannot explain, trace that to a physical effect the model
lacks (a time offset of the receiver, a lever arm, a scale factor, gravity through a tilted road, ...), add the effect,
and measure the error before and after on data that the effect was not fitted to. Writes into the output folder:
report.html, report.json and corrected.yaml, the parameters with the effects added, for --params-file of every tool.
Several recordings of one vehicle are diagnosed together: what is found is one for all of them, and proven on drives, or
parts of drives, that did not find it.
The method: docs/closing_the_loop.md; the effects: docs/effects.md."""

#: how an IMU is mounted shows in this part of a drive, s
MOUNTING_SHOWN = 1200.0


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    return run(_parser(), diagnose, argv)


def diagnose(options: argparse.Namespace) -> str:
    """Read, diagnose and write the results; the story for the user. ValueError for bad options or input."""
    from mems_ins_fusion.diagnosis.diagnose import diagnose as work
    from mems_ins_fusion.recordings.several import refuse_other_vehicles
    from mems_ins_fusion.reports.diagnosis import changed, corrected_yaml, report, report_html, story
    from mems_ins_fusion.reports.diagnosis_answer import answer
    from mems_ins_fusion.results import result_folder

    kept = params_file.load_files(options.params_file)
    values = table.check(_parameters(options, kept))
    with result_folder(options.output, options.overwrite) as folder:
        with Progress('diagnose') as bar:
            recordings, checked, warned, mounted = _read(options.bag, values, lambda part: bar(0.2 * part, 'reading'))
            refuse_other_vehicles(recordings)
            result = work(recordings, values, lambda part, what: bar(0.2 + 0.75 * part, what))
            bar(0.95, 'writing')
            # what is corrected needs no warning
            warned += [] if 'imu.mounting_rpy' in changed(result) else mounted
            answered = answer(result, checked, options.output)
            (folder / 'corrected.yaml').write_text(corrected_yaml(result, kept), encoding='utf-8')
            content = json.dumps(report(result, answered, checked, warned), indent=1, allow_nan=False)
            (folder / 'report.json').write_text(content, encoding='utf-8')
            page = report_html(result, kept, answered, checked, warned)
            (folder / 'report.html').write_text(page, encoding='utf-8')
            bar(1.0, 'done')
    return '\n'.join([*story(result, answered), *warned, f'The whole story: {options.output}/report.html'])


def _read(paths: list[str], values: dict, progress) -> tuple[list[Recording], list[Finding], list[str], list[str]]:
    """The recordings, what the checker found, and what is to be said of reading them, and of their mounting."""
    from mems_ins_fusion.configuration.check import check_mounting
    from mems_ins_fusion.evaluation.comparison import cut
    from mems_ins_fusion.recordings.checker import check_recording
    from mems_ins_fusion.reports.replay import read_part

    recordings, checked, warned, mounted = [], [], [], []
    for i, path in enumerate(paths):
        recording, texts = read_part(Path(path).expanduser(), values,
                                     lambda part, i=i: progress((i + part) / len(paths)))
        if recording.gnss is None:
            raise ValueError('gnss_topic is empty: a diagnosis needs fixes')
        shown = check_mounting(cut(recording, 0.0, MOUNTING_SHOWN), values)
        of = f'{recording.name}: ' if len(paths) > 1 else ''
        warned += [f'{of}{text}' for text in texts]
        mounted += [f'{of}{finding.message}' for finding in shown]
        checked += [replace(found, message=f'{of}{found.message}') for found in check_recording(recording)]
        recordings.append(recording)
    return recordings, checked, warned, mounted


def _parameters(options, kept: dict) -> dict:
    """What the params file, `kept`, and the options give, by full name."""
    given = dict(kept)
    asked = {'reference_topic': options.reference_topic, 'reference_file': options.reference_file,
             'start': options.start, 'stop': options.stop}
    if options.reference_topic:
        given.pop('reference_file', None)
    if options.reference_file:
        given.pop('reference_topic', None)
    if options.reference_topic and options.reference_file:
        raise ValueError('--reference-topic and --reference-file are both given: choose one')
    return given | {name: value for name, value in asked.items() if value is not None}


def _parser():
    parser = Parser('diagnose', DESCRIPTION)
    add = parser.add_argument
    add('--bag', required=True, nargs='+', metavar='BAG', help='rosbag2 folder, .mcap, .db3 or ROS 1 .bag; several of '
        'one vehicle')
    add('--output', required=True, metavar='DIR', help='folder for the results')
    parser.add_params_file('the filter as configured')
    add('--reference-topic', metavar='TOPIC', help='the truth: NavSatFix, Odometry or PoseStamped (default: '
        'reference_topic of the params file, else the fixes that are withheld)')
    add('--reference-file', metavar='FILE', help='the truth as CSV, TUM, NMEA or RTKLIB .pos')
    add('--start', type=float, metavar='S', help='skip this much of the recording')
    add('--stop', type=float, metavar='S', help="stop this long after the recording's start")
    parser.add_overwrite()
    return parser
