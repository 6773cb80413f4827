"""`bench`: the outage protocol on any filter's output, beside this package's own."""
from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.errors import InputError
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.progress import Progress

DESCRIPTION = """\
Measure filters of any kind as replay_node measures this package's: errors with fixes, and in outages. First

  bench prepare --bag drive --output drive_bench

writes the recordings for them: the original, with fixes withheld, and with changes that the output must follow (stamps
a microsecond later, the world turned by 90 degrees, mirrored, half the IMU's rate). Run each filter on each recording,
and put its outputs into a folder: NAME/ (a bag with nav_msgs/Odometry), NAME.tum, NAME.nav (KF-GINS) or NAME.csv. Then

  bench drive_bench --filter ekf=ekf_answers --params-file my_car.yaml --output result

measures them, and this package's own filter with the params file. The outputs are positions of the IMU (base_link).
Method and numbers: docs/bench.md."""

PREPARE = """\
Write the recordings of a bench, for other filters and for that of this package. Also writes bench.json and truth.csv,
which `bench` reads."""


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    argv = sys.argv[1:] if argv is None else argv
    parser, rest = _parser_of(argv)
    return run(parser, prepare if rest is not argv else bench, rest)


def prepare(options: argparse.Namespace) -> str:
    """Write the recordings; returns lines for the user. Raises InputError for bad options or input."""
    from mems_ins_fusion.fleet import bench as work
    from mems_ins_fusion.reports.replay import read_part
    from mems_ins_fusion.results import result_folder

    given = params_file.load_files(options.params_file)
    asked = {'reference_topic': options.reference_topic, 'reference_file': options.reference_file,
             'outage_durations': options.outage_durations, 'start': options.start, 'stop': options.stop}
    values = table.check(given | {name: value for name, value in asked.items() if value is not None})
    with result_folder(options.output, options.overwrite, work.MARKER) as folder, Progress('bench') as tell:
        recording, said = read_part(Path(options.bag).expanduser(), values, lambda part: tell(0.3 * part, 'reading'))
        names = work.prepare(recording, values, folder, options.kf_gins, lambda part: tell(0.3 + 0.7 * part, 'writing'))
    return '\n'.join([*said, f'{len(names)} recordings in {options.output}: {", ".join(names)}'])


def bench(options: argparse.Namespace) -> str:
    """Measure the filters; returns the table for the user. Raises InputError for bad options or input."""
    from mems_ins_fusion.fleet import bench as work
    from mems_ins_fusion.results import json_text, result_folder

    if not options.filter and not options.params_file:
        raise InputError('no filter to measure: give --filter NAME=FOLDER, or --params-file for this package\'s own')
    prepared = work.read_prepared(options.prepared)
    datum = None
    if options.datum:
        datum = math.radians(options.datum[0]), math.radians(options.datum[1]), options.datum[2]
    with result_folder(options.output, options.overwrite) as folder, Progress('bench') as tell:
        scores = []
        for text in options.filter:
            name, equals, place = text.partition('=')
            if not equals or not name:
                raise InputError(f"--filter must be NAME=FOLDER, got '{text}'")
            tracks = work.tracks_in(Path(place).expanduser(), prepared, datum, options.odometry_topic)
            scores.append(work.score(name, prepared, tracks))
        if options.params_file:
            given = params_file.load_files(options.params_file)
            tracks = work.own_tracks(prepared, given, lambda part: tell(part, 'filtering'))
            scores.append(work.score('mems_ins_fusion', prepared, tracks))
        content = json_text(work.report(scores, prepared), indent=1)
        (folder / 'report.json').write_text(content + '\n', encoding='utf-8')
    return work.table_text(scores)


def _parser_of(argv: list[str]) -> tuple[Parser, list[str]]:
    """The parser for `argv`, and the arguments that it is to parse."""
    return (_prepare_parser(), argv[1:]) if argv[:1] == ['prepare'] else (_parser(), argv)


def _parser():
    parser = Parser('bench', DESCRIPTION)
    add = parser.add_argument
    add('prepared', metavar='DIR', help='output folder of bench prepare')
    add('--filter', action='append', default=[], metavar='NAME=FOLDER', help='a filter and its outputs; repeatable')
    parser.add_params_file('the parameters of this package\'s filter, which is measured as well')
    add('--output', required=True, metavar='DIR', help='folder for report.json')
    add('--datum', type=float, nargs=3, metavar=('LAT', 'LON', 'HEIGHT'), help='origin of local coordinates of the '
        'filters, deg and m (default: the first fix)')
    add('--odometry-topic', default='', metavar='TOPIC', help='in bags with several nav_msgs/Odometry')
    parser.add_overwrite()
    return parser


def _prepare_parser():
    parser = Parser('bench prepare', PREPARE)
    add = parser.add_argument
    add('--bag', required=True, metavar='BAG', help='rosbag2 folder, .mcap, .db3 or ROS 1 .bag')
    add('--output', required=True, metavar='DIR', help='folder for the recordings')
    parser.add_params_file('topics, mounting, antenna and reference')
    add('--reference-topic', metavar='TOPIC', help='the truth in the recording (default: that of the params file, else '
        'the fixes)')
    add('--reference-file', metavar='FILE', help='the truth as CSV, TUM, NMEA or RTKLIB .pos')
    add('--outage-durations', type=float, nargs='+', metavar='S', help='(default: outage_durations of the params file, '
        'else 10 30 60)')
    add('--start', type=float, metavar='S', help='skip this much of the recording')
    add('--stop', type=float, metavar='S', help="stop this long after the recording's start")
    add('--kf-gins', action='store_true', help='also write each as text for KF-GINS: NAME_kf_gins/imu.txt, gnss.txt')
    parser.add_overwrite()
    return parser
