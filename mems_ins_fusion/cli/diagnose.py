"""`diagnose`: finds errors that the filter's model does not explain, the effects that cause them, and corrections."""
from __future__ import annotations

import argparse
from pathlib import Path

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.errors import InputError
from mems_ins_fusion.guard import BAD_INPUT
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.progress import Progress

DESCRIPTION = """\
Diagnose a drive: run the filter as configured, find what it cannot explain, trace that to a physical effect the model
lacks (a time offset of the receiver, a lever arm, a scale factor, gravity through a tilted road, ...), add the effect,
and measure the error before and after on data that the effect was not fitted to. Writes into the output folder:
report.html, report.json and corrected.yaml, the parameters with the effects added, for --params-file of every tool.
Several recordings of one vehicle are diagnosed together: a finding is common to all of them, and is proven on drives,
or parts of drives, to which it was not fitted.
The method: docs/closing_the_loop.md; the effects: docs/effects.md."""


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    return run(_parser(), diagnose, argv)


def diagnose(options: argparse.Namespace) -> tuple[str, int]:
    """Read, diagnose and write the results; returns the answer for the user and the exit status. Raises InputError for
    bad options or input.
    """
    from mems_ins_fusion.reports.diagnosing import diagnose_drives, read_drive
    from mems_ins_fusion.reports.diagnosis import diagnosis_lines
    from mems_ins_fusion.results import result_folder

    kept = params_file.load_files(options.params_file)
    values = table.check(_parameters(options, kept))
    with result_folder(options.output, options.overwrite) as folder, Progress('diagnose') as bar:
        count = len(options.bag)
        drives = [read_drive(Path(path).expanduser(), values,
                             lambda part, i=i: bar(0.2 * (i + part) / count, 'reading'))
                  for i, path in enumerate(options.bag)]
        done = diagnose_drives(drives, values, kept, folder, options.output,
                               progress=lambda part, what: bar(0.2 + 0.75 * part, what),
                               params_files=options.params_file)
        bar(1.0, 'done')
    said = done.answer.short()
    if options.verbose:
        said = [*(done.answer.lines() if done.result is None else diagnosis_lines(done.result, done.answer)),
                *done.said]
    return '\n'.join([*said, f'report: {options.output}/report.html']), BAD_INPUT if done.result is None else 0


def _parameters(options, kept: dict) -> dict:
    """Parameters by full name: those of the params file, `kept`, and of the options."""
    given = dict(kept)
    asked = {'reference_topic': options.reference_topic, 'reference_file': options.reference_file,
             'start': options.start, 'stop': options.stop}
    if options.reference_topic:
        given.pop('reference_file', None)
    if options.reference_file:
        given.pop('reference_topic', None)
    if options.reference_topic and options.reference_file:
        raise InputError('--reference-topic and --reference-file are both given: choose one')
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
    parser.add_verbose()
    return parser
