"""`fleet`: processes many recordings of many vehicles, on one machine or a cluster, and finds changes in a vehicle."""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.errors import InputError
from mems_ins_fusion.guard import INTERRUPTED

TASKS = ('replay', 'configure', 'diagnose', 'characterize')
#: largest number of lines of one kind on a terminal; the tables have all
MOST = 10
#: exit status of `fleet compare` if the second fleet is certainly worse
WORSE = 1

DESCRIPTION = """\
Do one task with many recordings of many vehicles. SOURCE is a folder, a glob, or a table (CSV, Parquet) with the
columns vehicle, recording, params_file, reference; local, or any URL that fsspec reads. Writes into the output
folder: tables (CSV, and Parquet where pyarrow is installed), fleet.html, each recording's result, and a history of each
vehicle with its changes and their times. Finished recordings are not done again: an interrupted run continues where it
stopped.

  fleet 'logs/*/*' --task replay --output out --vehicle-from 'logs/{vehicle}/*'
  fleet compare out_of_the_last_release out     exit status 1: worse for certain

Statistics, clusters, batch systems, queries: docs/fleet.md."""

COMPARE = """\
Compare two outputs of fleet --task replay: two releases, or two params files. Paired by recording, with intervals over
vehicles. Exit status 0: not worse for certain; 1: worse for certain, or a recording that had a result has none; 2: they
cannot be compared."""


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    argv = sys.argv[1:] if argv is None else argv
    parser, rest = _parser_of(argv)
    work, status = compare if rest is not argv else fleet, []
    return run(parser, lambda options: work(options, status), rest) or status[0]


def fleet(options: argparse.Namespace, status: list[int]) -> str:
    """Process the recordings; returns lines for the user, and writes the exit status to `status`. Raises InputError for
    bad options or input."""
    from mems_ins_fusion.fleet.run import FleetTask
    from mems_ins_fusion.fleet.run import run as do
    from mems_ins_fusion.parameters import params_file, table
    from mems_ins_fusion.progress import Progress
    from mems_ins_fusion.threads import cores

    if options.params_file:
        table.check(params_file.load_yaml(options.params_file))
    if not 0.5 <= options.memory <= 1e6:
        raise InputError(f'--memory must be from 0.5 to 1000000 GB, got {options.memory:g}')
    if options.workers is not None and not 1 <= options.workers <= 1000:
        raise InputError(f'--workers must be from 1 to 1000, got {options.workers}')
    asked = FleetTask(options.source, options.task, Path(options.output), options.vehicle_from, options.params_file,
                      options.scheduler, options.workers or cores(), options.memory, parse_shard(options.shard),
                      not options.no_pages)
    with Progress('fleet') as tell:
        result = do(asked, tell)
    status.append(INTERRUPTED if result.interrupted else 0)
    return '\n'.join(_lines(result, options.output))


def _lines(result, output: str) -> list[str]:
    from mems_ins_fusion.recordings.remarks import count_of

    done, failed, left = (result.count(status) for status in ('done', 'failed', 'open'))
    counts = f'{done} recordings done, {failed} failed, {result.count("duplicate")} twice, {left} left to do'
    if result.interrupted:
        return [f'interrupted; {counts}; the same command goes on',
                f'what is done: {output}/tables/*.csv; Parquet, histories and page wait for a run that ends by itself']
    lines = [counts, *result.said]
    lines += [f'{change.vehicle}: {change.words()}' for change in result.changes]
    lines += [f'{vehicle}: {count_of(len(wrong), "recording")} not usable with these parameters: '
              + next(iter(wrong.values())) for vehicle, wrong in list(result.not_usable().items())[:MOST]]
    if result.asked.shard != (1, 1):
        return [*lines, 'when all shards are done, the same command without --shard merges them']
    failures = dict.fromkeys(f'{r["recording"]}: {r["error_id"]}: {r["reason"]}' for r in result.rows['recordings']
                             if r['status'] == 'failed')
    more = [f'and {len(failures) - MOST} more: {output}/tables/recordings.csv'] if len(failures) > MOST else []
    return [*lines, *list(failures)[:MOST], *more, f'page: {output}/fleet.html']


def parse_shard(text: str) -> tuple[int, int]:
    """i/n as two numbers."""
    first, slash, second = text.partition('/')
    if slash and first.isdigit() and second.isdigit() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise InputError(f"--shard must be i/n with i from 1 to n, got '{text}'")


def compare(options: argparse.Namespace, status: list[int]) -> str:
    """Compare two fleets; returns lines for the user, and writes the exit status to `status`. Raises InputError if they
    cannot be compared."""
    from mems_ins_fusion.fleet import gate
    from mems_ins_fusion.results import write_files

    found = gate.compare(options.first, options.second)
    if options.output:
        write_files({options.output: gate.report_text(found)}, options.overwrite)
    status.append(WORSE if found.worse else 0)
    return '\n'.join(found.lines())


def _parser_of(argv: list[str]) -> tuple[Parser, list[str]]:
    """The parser for `argv`, and the arguments that it is to parse."""
    return (_compare_parser(), argv[1:]) if argv[:1] == ['compare'] else (_parser(), argv)


def _parser():
    parser = Parser('fleet', DESCRIPTION)
    add = parser.add_argument
    add('source', metavar='SOURCE', help='folder, glob, or table (.csv, .parquet); path or URL')
    add('--task', required=True, choices=TASKS)
    add('--output', required=True, metavar='DIR', help='folder for the results; an unfinished run there is continued')
    add('--vehicle-from', default='', metavar='PATTERN', help="where a path names the vehicle: 'logs/{vehicle}/*' "
        '(default: the folder that the recording stands in)')
    add('--params-file', default='', metavar='FILE', help='YAML with the parameters, where the table names none')
    add('--scheduler', default='local', metavar='WHERE', help='local, or the address of a Dask scheduler such as '
        'tcp://host:8786 (default %(default)s)')
    add('--workers', type=int, metavar='N', help='processes on this machine (default: its cores)')
    add('--memory', type=float, default=1.0, metavar='GB', help='for each worker: a recording that takes more is left '
        'out (default %(default)g, an hour at 100 Hz)')
    add('--shard', default='1/1', metavar='I/N', help='do the I-th of N parts, for batch systems; afterwards the same '
        'command without it merges them')
    add('--no-pages', action='store_true', help='no page for each recording: tables and fleet.html only')
    return parser


def _compare_parser():
    parser = Parser('fleet compare', COMPARE)
    add = parser.add_argument
    add('first', metavar='A', help='output of fleet --task replay: the former one')
    add('second', metavar='B', help='the new one')
    add('--output', metavar='FILE.json', help='also write the comparison for programs')
    parser.add_overwrite()
    return parser
