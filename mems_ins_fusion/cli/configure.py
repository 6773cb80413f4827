"""`configure`: from a recording to the params file of the vehicle."""
from __future__ import annotations

import argparse
from pathlib import Path

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.errors import InputError

DESCRIPTION = """\
Write the params file of a vehicle from a recording of a drive: which topics, in which units, how the IMU is mounted,
noise and biases, time offset, receiver, constraints. Each value has its evidence and its sigma as a comment. Values
that the recording does not determine are reported and left at their defaults. A minute or two with a standstill, a
right-angled turn and some braking is enough for topics, units and mounting; the time offset takes five to fifteen
minutes. A page FILE.html beside FILE.yaml shows the data behind the values. The method: docs/configure.md."""


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    return run(_parser(), configure, argv)


def configure(options: argparse.Namespace) -> str:
    """Read the recordings and write the params file; returns the findings for the user. Raises InputError for bad
    options or input."""
    from mems_ins_fusion.configuration.configure import configure as work
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.recordings.errors import collected_warnings
    from mems_ins_fusion.reports.configuration import (
        answer,
        configuration_page,
        configuration_yaml,
        result_lines,
        summary_line,
    )
    from mems_ins_fusion.results import check_files_free, write_files

    output = Path(options.output)
    if output.suffix not in ('.yaml', '.yml'):
        raise InputError(f'--output must be a .yaml file, got {output}')
    page = output.with_suffix('.html')
    check_files_free([output, page], options.overwrite)
    with collected_warnings() as said:
        result = work(options.bag)
    table.check(result.values)
    text = configuration_yaml(result)
    answered = answer(result, options.bag, options.output)
    write_files({output: text, page: configuration_page(result, text, answered)}, options.overwrite)
    lines = [*answered.lines(), '', *result_lines(result), *dict.fromkeys(said)] if options.verbose else \
        [*answered.short(), summary_line(result)]
    return '\n'.join([*lines, f'report: {page}'])


def _parser():
    parser = Parser('configure', DESCRIPTION)
    add = parser.add_argument
    add('--bag', required=True, nargs='+', metavar='BAG', help='rosbag2 folder, .mcap, .db3 or ROS 1 .bag; several of '
        'one vehicle')
    add('--output', required=True, metavar='FILE.yaml', help='the params file to write')
    parser.add_overwrite()
    parser.add_verbose()
    return parser
