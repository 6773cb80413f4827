"""Write what the commands of README and tutorial print into these pages, and their pictures beside them.

    python studies/pages_from_commands.py WORK [tutorial] [demo] [measured]

WORK: an empty folder for the recordings and results. A block of the page marked with

    <!-- printed by: TOOL -->

holds what the latest command of that tool above it printed; a picture below

    <!-- drawn by: FILE -->

is the file FILE of WORK. Both are replaced; nothing else of the page is touched. The tutorial takes some minutes, as
its commands run as they stand there, on the seed given there. measured: README's table of measured drives, below

    <!-- measured by: docs/replay.md -->

by the commands of that page, a row each; only where the drives are there (`../shared/data`).
"""
from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY))

import numpy as np  # noqa: E402

from mems_ins_fusion.navigation.earth import to_local  # noqa: E402
from mems_ins_fusion.recordings.reading import read_recording  # noqa: E402
from mems_ins_fusion.reports.html import number  # noqa: E402
from mems_ins_fusion.samples import Recording  # noqa: E402

#: the pages, by what is asked for
PAGES = {'tutorial': REPOSITORY / 'docs/tutorial.md', 'demo': REPOSITORY / 'README.md'}
#: README's table of measured drives, the page with its commands, and the folder of the recordings
TABLE = REPOSITORY / 'README.md'
TABLE_COMMANDS, DATA = REPOSITORY / 'docs/replay.md', '../shared/data'
#: tools that print something for a page; nodes that live until they are stopped are not run
TOOLS = ('simulate', 'configure', 'replay_node', 'diagnose', 'compare')
_MARK = re.compile(r'<!-- printed by: (\w+) -->\n```text\n(.*?)```\n', re.DOTALL)
_DRAWN = re.compile(r'<!-- drawn by: (\S+) -->\n!\[[^\]]*\]\(([^)]+)\)')
_TABLE = re.compile(r'(<!-- measured by: docs/replay.md -->\n(?:\|.*\n){2})((?:\|.*\n)+)')
_COUNTS, _COMMIT = re.compile(r'over\s\d+\sto\s\d+\ssuch'), re.compile(r'(?<=Measured at commit )\w+')
#: columns of a page
WIDTH = 120


def commands(page: Path) -> list[list[str]]:
    """The commands of the page that print something, in order: of README those of `make demo`."""
    if page.name == 'README.md':
        made = subprocess.run(['make', '-n', '-s', 'demo'], cwd=REPOSITORY, capture_output=True, text=True, check=True)
        found = [shlex.split(line) for line in made.stdout.replace('\\\n', ' ').splitlines()]
        return [[sys.executable, *words[words.index('-m'):]] for words in found
                if 'mems_ins_fusion' in words and words[words.index('mems_ins_fusion') + 1] in TOOLS]
    blocks = re.findall(r'```sh\n(.*?)```', page.read_text(encoding='utf-8'), re.DOTALL)
    lines = [shlex.split(line, comments=True) for line in '\n'.join(blocks).replace('\\\n', ' ').splitlines()]
    return [[sys.executable, *words[1:]] for words in lines
            if words[:3] == ['python', '-m', 'mems_ins_fusion'] and words[3] in TOOLS]


def printed(words: list[str], folder: Path) -> str:
    """What a command says on its standard output."""
    process = subprocess.run(words, cwd=folder, capture_output=True, text=True,
                             env={**os.environ, 'PYTHONPATH': str(REPOSITORY)})
    if process.returncode:
        sys.exit(f'{shlex.join(words)}\n{process.stderr}')
    return process.stdout


def block(text: str) -> str:
    """`text` as a page holds it: no line longer than WIDTH."""
    return '\n'.join(part for line in text.strip().splitlines()
                     for part in textwrap.wrap(line, WIDTH, subsequent_indent='    ') or ['']) + '\n'


def written(page: str, said: dict[str, str]) -> str:
    """The text of a page with what the tools said, by name."""
    return _MARK.sub(lambda found: found[0] if found[1] not in said else
                     f'<!-- printed by: {found[1]} -->\n```text\n{block(said[found[1]])}```\n', page)


def blocks(page: str) -> dict[str, str]:
    """What the page says that each tool prints."""
    return {name: text for name, text in _MARK.findall(page)}


def table_commands(page: str) -> list[list[str]]:
    """The commands of the section of docs/replay.md about README's table, in order."""
    section = page.split('## The table of the README\n')[1].split('\n## ')[0]
    lines = [line[4:] for line in section.splitlines() if line.startswith('    ')]
    found = [shlex.split(line) for line in '\n'.join(lines).replace('\\\n', ' ').splitlines()]
    return [[sys.executable, *words[1:]] for words in found]


def fixes_alone(recording: Recording) -> float:
    """RMS distance, m, of the fixes from the reference at the same time."""
    truth, fixes = recording.reference, recording.gnss
    fixes = fixes.select((fixes.stamp >= truth.stamp[0]) & (fixes.stamp <= truth.stamp[-1]))
    origin = truth.latitude[0], truth.longitude[0], truth.height[0]
    at, true = (to_local(one.latitude, one.longitude, one.height, origin)[:2] for one in (fixes, truth))
    apart = [there - np.interp((fixes.stamp - truth.stamp[0]) * 1e-9, (truth.stamp - truth.stamp[0]) * 1e-9, axis)
             for there, axis in zip(at, true)]
    return float(np.sqrt(np.mean(np.square(apart).sum(axis=0))))


def row(line: str, report: dict, alone: float | None) -> str:
    """A line of README's table with the numbers of a replay's `report`. alone: m, None without a reference; then the
    cells of errors with fixes stay as they are."""
    title, *cells = [cell.strip() for cell in line.strip().strip('|').split('|')]
    if alone is not None:
        [run] = [run for run in report['runs'] if run['update_interval_s'] == 1.0]
        cells[:2] = [f'{number(alone, 2)} m', f'{number(run["horizontal_rmse_m"], 2)} m']
    changes = [change for change in report['verdict']['changes'] if change['duration_s']]
    cells[2:5] = [f'{number(change["after_m"], 2)} m ({number(change["before_m"], 2)})' for change in changes]
    cells[5] = ', '.join(f'{outage["within_95_percent"]:.0f}' for outage in report['outages']) + ' %'
    return '|' + ''.join(f' {cell} |' if cell else ' |' for cell in (title, *cells)) + '\n'


def with_table(page: str, reports: list[tuple[dict, float | None]], commit: str) -> str:
    """README with its table of measured drives by `reports`, each with the error of its fixes alone, in the order of
    the rows."""
    lines = _TABLE.search(page)[2].splitlines()
    new = ''.join(row(line, *of) for line, of in zip(lines, reports, strict=True))
    counts = [outage['count'] for report, _ in reports for outage in report['outages']]
    page = _TABLE.sub(lambda found: found[1] + new, page)
    page = _COUNTS.sub(f'over {min(counts)} to {max(counts)} such', page)
    return _COMMIT.sub(commit, page, count=1)  # that of the first table


def measured(folder: Path) -> None:
    """Write README's table of measured drives."""
    reports = []
    for words in table_commands(TABLE_COMMANDS.read_text(encoding='utf-8')):
        words = [word.replace(DATA, str(REPOSITORY / DATA)) for word in words]
        print(shlex.join(words[1:]), flush=True)
        printed(words, folder)
        if words[3] != 'replay_node':
            continue
        given = dict(word.split(':=', 1) for word in words if ':=' in word)
        report = json.loads((folder / given['output_dir'] / 'report.json').read_text(encoding='utf-8'))
        topic = given.get('reference_topic')
        drive = read_recording(given['bag'], '/imu/data', '/gps/fix', topic) if topic else None
        reports.append((report, fixes_alone(drive) if drive is not None else None))
    commit = subprocess.run(['git', 'rev-parse', '--short', 'HEAD'], cwd=REPOSITORY, capture_output=True, text=True,
                            check=True).stdout.strip()
    TABLE.write_text(with_table(TABLE.read_text(encoding='utf-8'), reports, commit), encoding='utf-8')


def main(argv: list[str]) -> None:
    work = Path(argv[0]).absolute()
    for name in argv[1:] or PAGES:
        if name == 'measured':
            (work / name).mkdir(parents=True)
            measured(work / name)
            continue
        page, folder = PAGES[name], work / name
        folder.mkdir(parents=True)
        said = {}
        for words in commands(page):
            print(shlex.join(words[1:]), flush=True)
            said[words[3]] = printed(words, folder)
        text = page.read_text(encoding='utf-8')
        for source, target in _DRAWN.findall(text):
            shutil.copyfile(folder / source, page.parent / target)
        page.write_text(written(text, said), encoding='utf-8')


if __name__ == '__main__':
    main(sys.argv[1:])
