"""Write what the commands of README and tutorial print into these pages, and their pictures beside them.

    python studies/pages_from_commands.py WORK [tutorial] [demo]

WORK: an empty folder for the recordings and results. A block of the page marked with

    <!-- printed by: TOOL -->

holds what the latest command of that tool above it printed; a picture below

    <!-- drawn by: FILE -->

is the file FILE of WORK. Both are replaced; nothing else of the page is touched. The tutorial takes some minutes, as
its commands run as they stand there, on the seed given there.
"""
from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
#: the pages, by what is asked for
PAGES = {'tutorial': REPOSITORY / 'docs/tutorial.md', 'demo': REPOSITORY / 'README.md'}
#: tools that print something for a page; nodes that live until they are stopped are not run
TOOLS = ('simulate', 'configure', 'replay_node', 'diagnose', 'compare')
_MARK = re.compile(r'<!-- printed by: (\w+) -->\n```text\n(.*?)```\n', re.DOTALL)
_DRAWN = re.compile(r'<!-- drawn by: (\S+) -->\n!\[[^\]]*\]\(([^)]+)\)')
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


def main(argv: list[str]) -> None:
    work = Path(argv[0]).absolute()
    for name in argv[1:] or PAGES:
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
