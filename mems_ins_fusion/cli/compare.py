"""`compare`: two replays, params files or recordings side by side, with paired statistics."""
from __future__ import annotations

import argparse
from pathlib import Path

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.errors import InputError
from mems_ins_fusion.parameters import params_file, table

DESCRIPTION = """\
Compare two of the same kind: results of replay_node, params files (also the folder of a diagnosis: its corrected.yaml),
or recordings. Params files are replayed on the recording --bag, recordings with --params-file. Errors are compared at
the epochs, and outages, that both have. Writes into the output folder: report.html, report.json, and the replays it had
to make (first/ and second/)."""

#: folders of the replays that this tool makes
PLACES = ('first', 'second')


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    return run(_parser(), compare, argv)


def compare(options: argparse.Namespace) -> str:
    """Read or replay both, compare and write the results; returns lines for the user. Raises InputError for bad options
    or input."""
    from mems_ins_fusion.reports import side_by_side
    from mems_ins_fusion.results import json_text, result_folder

    paths = [options.first, options.second]
    kinds = [_kind(path) for path in paths]
    if kinds[0] != kinds[1]:
        raise InputError(f'{paths[0]} is a {kinds[0]}, {paths[1]} a {kinds[1]}: compare two of the same kind')
    if kinds[0] == 'params file' and not options.bag:
        raise InputError('two params files are compared on a recording: give --bag')
    names = _names(paths)
    with result_folder(options.output, options.overwrite) as folder:
        if kinds[0] != 'result':
            for place, path in zip(PLACES, paths):
                _replay(options, kinds[0], path, folder / place, Path(options.output) / place)
            paths = [folder / place for place in PLACES]
        results = [side_by_side.read_result(path, name) for path, name in zip(paths, names)]
        rows = side_by_side.rows_of(*results)
        answered = side_by_side.answer(*results, rows)
        content = json_text(side_by_side.report(*results, rows, answered), indent=1)
        (folder / 'report.json').write_text(content + '\n', encoding='utf-8')
        (folder / 'report.html').write_text(side_by_side.report_page(*results, rows, answered), encoding='utf-8')
    said = [*answered.lines(), '', side_by_side.table_text(*results, rows)] if options.verbose else answered.short()
    return '\n'.join([*said, f'report: {options.output}/report.html'])


def _kind(path: str) -> str:
    """What `path` is: a result of replay_node, a params file or a recording."""
    folder = Path(path)
    if not folder.exists():
        raise InputError(f'{path} does not exist')
    if folder.suffix in ('.yaml', '.yml') or (folder / 'corrected.yaml').is_file():
        return 'params file'
    return 'result' if (folder / 'report.json').is_file() else 'recording'


def _names(paths: list[str]) -> list[str]:
    """The shortest trailing parts of the two paths that differ."""
    parts = [Path(path).absolute().parts for path in paths]
    for count in range(1, max(map(len, parts)) + 1):
        names = ['/'.join(p[-count:]) for p in parts]
        if names[0] != names[1]:
            return names
    return [f'{paths[0]} (A)', f'{paths[1]} (B)']


def _replay(options, kind: str, path: str, folder: Path, known_as: Path) -> None:
    """Replay with the params file, or the recording, `path` into `folder`."""
    from mems_ins_fusion.reports.replay import replay_recordings

    files = options.params_file
    if kind == 'params file':
        files = [*files, path if Path(path).is_file() else Path(path) / 'corrected.yaml']
    given = params_file.load_files(files)
    asked = {'reference_topic': options.reference_topic, 'reference_file': options.reference_file}
    given |= {name: value for name, value in asked.items() if value is not None}
    values = table.check(given | {'bag': [options.bag if kind == 'params file' else path], 'output_dir': str(folder),
                                  'overwrite': False, 'publish': False})
    if 'models' not in given:
        values['models'] = [values['sensor_error_model']]
    replay_recordings(values, known_as=known_as)


def _parser():
    parser = Parser('compare', DESCRIPTION)
    add = parser.add_argument
    add('first', metavar='FIRST', help='result of replay_node, params file, or recording')
    add('second', metavar='SECOND', help='the other, of the same kind')
    add('--output', required=True, metavar='DIR', help='folder for the results')
    add('--bag', metavar='BAG', help='the recording that two params files are compared on')
    parser.add_params_file('the filter for two recordings, or the parameters below both params files')
    add('--reference-topic', metavar='TOPIC', help='the truth in the recordings (default: that of the params file, '
        'else withheld fixes)')
    add('--reference-file', metavar='FILE', help='the truth as CSV, TUM, NMEA or RTKLIB .pos')
    parser.add_overwrite()
    parser.add_verbose()
    return parser
