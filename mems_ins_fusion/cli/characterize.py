"""`characterize`: sensor error parameters from a recording of the IMU at rest."""
from __future__ import annotations

import argparse

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.errors import InputError
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.progress import Progress

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
    from mems_ins_fusion.reports.characterization import data_sheet_short, data_sheet_text
    from mems_ins_fusion.reports.characterizing import read_at_rest, write_characterization
    from mems_ins_fusion.results import result_folder

    if min(options.orders) < 1 or max(options.orders) > 20:
        raise InputError(f'--orders must be from 1 to 20, got {" ".join(map(str, options.orders))}')
    with result_folder(options.output, options.overwrite) as folder:
        asked = {'imu_topic': options.imu_topic, 'temperature_topic': options.temperature_topic}
        values = table.check(params_file.load_files(options.params_file) | {k: v for k, v in asked.items() if v})
        with Progress('characterize') as tell:
            given = read_at_rest(options.bag, values, lambda part: tell(part, 'reading'))
        with Progress('characterize') as tell:
            result = work.characterize(given.name, given.grid, given.temperature, options.orders,
                                       lambda done, total, what: tell(done / total, what))
        answered = write_characterization(result, given, values, folder, options.output)
    place = f'report: {options.output}/report.html'
    if not options.verbose:
        return '\n'.join([*answered.short(), *data_sheet_short(result), place])
    return '\n'.join([*given.said, *answered.lines(), '', f'{given.name}: {result.duration:.0f} s at rest, '
                      f'{len(result.rest.cuts)} disturbances cut out',
                      *(f'{axis.name}: {axis.recommendation.text}' for axis in result.axes),
                      f'recommended for all axes: {result.model}', '', *data_sheet_text(result), '', place])


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
