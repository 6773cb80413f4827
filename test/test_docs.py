"""README and docs: every command in them can be typed, every link leads somewhere, and what a new user types runs."""
from __future__ import annotations

import ast
import os
import re
import shlex
import subprocess
import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from mems_ins_fusion.__main__ import main as tool
from mems_ins_fusion.parameters import params_file
from mems_ins_fusion.parameters.table import FILTER, FUSION, REPLAY, check
from mems_ins_fusion.reports.answer import YOURS
from mems_ins_fusion.tools import TOOLS

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY / 'studies'))
PAGES = [REPOSITORY / 'README.md', *sorted((REPOSITORY / 'docs').glob('*.md'))]
OF_NODE = {'fusion_node': (*FILTER, *FUSION), 'replay_node': (*FILTER, *REPLAY)}
#: commands that no test looks into, and why
NOT_OURS = {
    'sudo': 'installs on the machine', 'source': 'the shell', 'rosdep': 'a command of ROS 2', 'mkdir': 'the shell',
    'git': 'needs the network', 'pip': 'needs the network', 'touch': 'the shell', 'docker': 'needs Docker',
    'kill': 'the shell', 'true': 'the shell', 'cd': 'the shell', 'evo_ape': 'evo, in test_replay.py'}
#: of Python's own and of others' modules, likewise
OTHER_MODULES = {'venv', 'colcon', 'pip'}
#: tools that are run, in the order of the page, on a short recording; the nodes live are in test_play.py
RUN = ('simulate', 'configure', 'replay_node', 'diagnose', 'compare', 'characterize', 'import_csv', 'completion')


def commands(page):
    """(number of the line, words) of each command in a page: blocks marked sh, and indented lines of a command."""
    fenced, continued, begin = False, '', 0
    for number, line in enumerate(page.read_text(encoding='utf-8').splitlines(), 1):
        text = line.strip()
        if text.startswith('```'):
            fenced = text == '```sh'
            continue
        starts = re.match(r'    (python3?|ros2|make|evo_ape) ', line) or (line.startswith('    ') and '="' in line)
        if not (fenced or continued or starts) or not text:
            continue
        begin = begin if continued else number
        if text.endswith('\\'):
            continued += text[:-1]
            continue
        text, continued = continued + text, ''
        text = re.sub(r'\s\[[a-z]+ [a-z ]+\]', '', text)  # what may be left out, in words
        for part in re.split(r'&&|\|\|', text):
            words = shlex.split(part, comments=True)
            words = words[:words.index('>')] if '>' in words else words
            yield begin, [word for word in words if word != '&']


def all_commands():
    for page in PAGES:
        variables = {}
        for number, words in commands(page):
            if words and '=' in words[0] and '/' not in words[0]:
                name, _, value = words[0].partition('=')
                variables[f'${name}'] = shlex.split(value)
                words = words[1:]
            words = [w for word in words for w in variables.get(word, [word])]
            if words:
                yield pytest.param(words, id=f'{page.name}:{number}:{words[0].split("/")[-1]}')
        inline = r'`((?:python -m|ros2 run|ros2 launch) mems_ins_fusion [a-z][^`]*)`'
        for text in re.findall(inline, page.read_text(encoding='utf-8')):
            yield pytest.param(shlex.split(text), id=f'{page.name}:{text}')


ALL = list(all_commands())


def test_the_commands_are_found():
    assert len(ALL) > 60
    tools = {words[i + 1] for words in (p.values[0] for p in ALL) for i, word in enumerate(words[:-1])
             if word == 'mems_ins_fusion'}
    assert set(TOOLS) - {'completion'} <= tools


@pytest.mark.parametrize('words', ALL)
def test_a_command_names_what_there_is(words):
    program = words[0].split('/')[-1]
    if program in NOT_OURS:
        return
    if program == 'make':
        assert re.search(rf'^{words[1]}:', (REPOSITORY / 'Makefile').read_text(), re.MULTILINE)
    elif program == 'ros2':
        assert words[1] in ('run', 'launch', 'pkg') and 'mems_ins_fusion' in words
        if words[1] == 'run':
            check_tool(words[3], words[4:])
        if words[1] == 'launch':
            check_launch(words[3], words[4:])
    elif words[1] == '-m' and words[2].startswith('mems_ins_fusion'):
        if words[2] == 'mems_ins_fusion':
            check_tool(words[3], words[4:])
        else:
            import_module(words[2])
    elif words[1] == '-m':
        assert words[2] in OTHER_MODULES
    else:
        assert program.startswith('python')
        script = (REPOSITORY / words[1]).read_text(encoding='utf-8')
        if 'import over_drives' in script:  # where the options are that such studies share
            script += (REPOSITORY / 'studies/over_drives.py').read_text(encoding='utf-8')
        assert all(f"'{word}'" in script for word in words[2:] if word.startswith('--'))


def check_tool(name, argv):
    """AssertionError or SystemExit where the tool, an option or a parameter is unknown, or a value does not fit."""
    assert name in TOOLS
    ros = argv.index('--ros-args') if '--ros-args' in argv else len(argv)
    if name not in OF_NODE:
        module = import_module(f'mems_ins_fusion.{TOOLS[name][0]}.{name}')
        # of some tools the first word chooses what they do
        parser, rest = module._parser_of(argv) if hasattr(module, '_parser_of') else (module._parser(), argv[:ros])
        if '--help' not in argv:
            options = parser.parse_args(rest)
            check_files(getattr(options, 'params_file', []))
        return
    assert not argv[:ros] or argv == ['--help']
    pairs = list(zip(argv[ros + 1::2], argv[ros + 2::2]))
    assert len(argv[ros + 1:]) == 2 * len(pairs) and all(option in ('-p', '--params-file', '-r') for option, _ in pairs)
    check_files(value for option, value in pairs if option == '--params-file')
    for option, value in pairs:
        if option == '-p' and not value.startswith('use_sim_time:='):
            parameter, _, text = value.partition(':=')
            assert parameter in {p.name for p in OF_NODE[name]}
            check({parameter: yaml.safe_load(text)})


def check_files(paths):
    """Those of the repository are there and hold what is known."""
    for path in paths:
        if path.startswith('config/'):
            check(params_file.load_yaml(REPOSITORY / path))


def check_launch(name, argv):
    text = (REPOSITORY / 'launch' / name).read_text(encoding='utf-8')
    assert all(f"'{word.partition(':=')[0]}'" in text for word in argv)


@pytest.mark.parametrize('words', [
    ['python', '-m', 'mems_ins_fusion', 'simulate', '--ouput', 'x'], ['make', 'everything'],
    ['python', '-m', 'mems_ins_fusion', 'replay_node', '--ros-args', '-p', 'bags:=x'], ['rm', '-rf', 'x'],
    ['python', 'studies/faults.py', '--seed', '6']])
def test_the_check_sees_mistakes(words):
    with pytest.raises((AssertionError, SystemExit, OSError, IndexError)):
        test_a_command_names_what_there_is(words)


# links

def anchors(page):
    """The anchors of the headings of a page, as GitHub and the site make them."""
    found = set()
    for heading in re.findall(r'^#+ (.+)$', page.read_text(encoding='utf-8'), re.MULTILINE):
        plain = re.sub(r'\[([^]]*)\]\([^)]*\)', r'\1', heading).replace('`', '').strip().lower()
        found.add(re.sub(r'[^\w\- ]', '', plain).replace(' ', '-'))
    return found


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    text = re.sub(r'```.*?```|`[^`\n]*`', '', page.read_text(encoding='utf-8'), flags=re.DOTALL)
    for target in re.findall(r'\]\(([^)\s]+)\)', text):
        if target.startswith(('http:', 'https:', 'mailto:')):
            continue
        path, _, anchor = target.partition('#')
        other = (page.parent / path).resolve() if path else page
        assert other.exists(), target
        assert not anchor or anchor in anchors(other), target


# names

#: pages that describe the code with the names of its functions and constants
PAGES_OF_CODE = [REPOSITORY / 'docs' / f'{name}.md' for name in
                 ('ablation', 'filter', 'horizon', 'how_to_add', 'hypotheses', 'live_loop', 'standstill',
                  'way_of_a_fix')]
#: extensions of files, which are not names in a module
EXTENSIONS = {'py', 'md', 'yaml', 'json', 'html', 'csv', 'png', 'tum', 'gpx', 'kml', 'geojson', 'service'}


def code_in(page):
    """What stands in backticks in a page, without its blocks of code."""
    return set(re.findall(r'`([^`\n]+)`', re.sub(r'```.*?```', '', page.read_text(encoding='utf-8'), flags=re.DOTALL)))


@cache
def sources():
    """The files of the package, its tests and studies: text by path in the repository."""
    files = (path for folder in ('mems_ins_fusion', 'test', 'studies', 'examples', 'launch', 'config', 'scripts')
             for path in (REPOSITORY / folder).rglob('*.*') if path.suffix in ('.py', '.yaml', '.js', '.css', '.csv'))
    return {path.relative_to(REPOSITORY).as_posix(): path.read_text(encoding='utf-8') for path in files}


@cache
def names_in(module):
    """Names that the modules called so define, import, or pass as keywords (columns of the filter's memory)."""
    found = set()
    for path, text in sources().items():
        if path.startswith('mems_ins_fusion/') and path.endswith(f'/{module}.py'):
            for node in ast.walk(ast.parse(text)):
                found |= {getattr(node, name, None) for name in ('name', 'id', 'attr', 'arg')}
    return found


@cache
def words():
    return set(re.findall(r'\w+', '\n'.join(text for path, text in sources().items() if 'test_docs' not in path)))


def unknown_names(code, of_code):
    """Those of the texts in backticks that name a file, or a name in a module, that there is not. of_code: whether each
    single name has to be one of the code."""
    parameters, unknown = {one.name for one in (*FILTER, *FUSION, *REPLAY)}, set()
    for text in code:
        if re.fullmatch(r'[\w/]+\.py', text):
            there = any(f'/{path}'.endswith(f'/{text}') for path in sources())
        elif found := re.fullmatch(r'(?:\w+/)*(\w+)\.(\w+)', text):
            module, name = found.groups()
            there = (not names_in(module) or name in names_in(module) or text in parameters or name in EXTENSIONS)
        else:
            there = not of_code or not re.fullmatch(r'[A-Za-z]\w*_\w+|[A-Z]\w{3,}', text) or text in words() or (
                text.startswith('NAME_'))
        unknown |= set() if there else {text}
    return unknown


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_files_and_names_in_a_page_are_those_of_the_code(page):
    assert unknown_names(code_in(page), page in PAGES_OF_CODE) == set()


@pytest.mark.parametrize('text', ['filter/trust/doubt.py', 'new_start.finds_course', 'scale.LARGEST_INNOVATION',
                                  'trust/scale.forget_all', 'LONGEST_HELD', 'take_fix'])
def test_a_name_that_is_not_there_is_seen(text):
    assert unknown_names({text}, True) == {text}


def test_each_page_is_in_the_table_of_contents():
    index = (REPOSITORY / 'docs/index.md').read_text(encoding='utf-8')
    listed = {line.strip() for block in re.findall(r'```{toctree}(.*?)```', index, re.DOTALL)
              for line in block.splitlines() if re.fullmatch(r'\w+', line.strip())}
    assert listed == {page.stem for page in PAGES if page.name not in ('README.md', 'index.md')}


# as a new user

@pytest.fixture(scope='module')
def played(tmp_path_factory):
    """Every command of the tutorial that RUN names, in order and in one folder; what each said."""
    folder = tmp_path_factory.mktemp('tutorial')
    (folder / 'config').symlink_to(REPOSITORY / 'config')
    said = []
    for number, words in commands(REPOSITORY / 'docs/tutorial.md'):
        if words[:3] != ['python', '-m', 'mems_ins_fusion'] or words[3] not in RUN:
            continue
        process = subprocess.run([sys.executable, *words[1:]], cwd=folder, capture_output=True, text=True,
                                 env={**os.environ, 'PYTHONPATH': str(REPOSITORY)})
        said.append(SimpleNamespace(tool=words[3], words=words, process=process))
    return folder, said


def test_the_commands_of_the_tutorial_run_one_after_the_other(played):
    folder, said = played
    assert [step.tool for step in said].count('simulate') and len(said) >= 5
    for step in said:
        assert step.process.returncode == 0, f'{" ".join(step.words)}\n{step.process.stderr}'
        assert 'Traceback' not in step.process.stderr
    for name in ('my_car.yaml', 'replay/report.html', 'diagnosis/report.html', 'diagnosis/corrected.yaml'):
        assert (folder / name).is_file()


def numbers_and_words(text: str) -> tuple[list[float], str]:
    """The numbers in a text, and the text without them and without its line breaks."""
    plain = ' '.join(text.split())
    return [float(n) for n in re.findall(r'\d+(?:\.\d+)?', plain)], re.sub(r'\d+(?:\.\d+)?', '#', plain)


def test_the_tutorial_says_what_its_commands_print(played):
    """On the same seed; `python studies/pages_from_commands.py WORK tutorial` writes it anew."""
    from pages_from_commands import blocks

    printed = {step.tool: step.process.stdout for step in played[1]}
    pages = blocks((REPOSITORY / 'docs/tutorial.md').read_text(encoding='utf-8'))
    assert set(pages) == {'configure', 'replay_node', 'diagnose', 'compare'}
    for name, text in pages.items():
        (numbers, words), (now, said) = numbers_and_words(text), numbers_and_words(printed[name])
        assert said == words, f'{name}: the page has other words'
        # machines round differently, and a filter adds that up; what a person reads stays
        assert now == pytest.approx(numbers, rel=0.1, abs=0.02), name


def test_the_page_is_written_as_the_test_reads_it():
    from pages_from_commands import block, blocks, written

    page = 'Before.\n\n<!-- printed by: compare -->\n```text\nold 1\n```\n\nAfter `compare`.\n'
    new = written(page, {'compare': 'B is better: 2.0 m. ' * 9 + '\n  next\n', 'diagnose': 'nothing'})
    assert new.startswith('Before.') and new.endswith('After `compare`.\n') and 'old' not in new
    assert numbers_and_words(blocks(new)['compare']) == numbers_and_words('B is better: 2.0 m. ' * 9 + 'next')
    assert max(map(len, block('word ' * 60).splitlines())) <= 120
    assert written(new, {}) == new


def test_the_table_of_measured_drives_is_written_from_reports():
    from pages_from_commands import TABLE_COMMANDS, table_commands, with_table

    # given README, and a report for each replay of the section with its commands
    page = (REPOSITORY / 'README.md').read_text(encoding='utf-8')
    commands = table_commands(TABLE_COMMANDS.read_text(encoding='utf-8'))
    replays = [words for words in commands if words[3] == 'replay_node']
    changes = [{'duration_s': 0.0, 'after_m': 9.0, 'before_m': 9.0}] + [
        {'duration_s': d, 'after_m': d / 9.0, 'before_m': 7.0 * d} for d in (10.0, 30.0, 60.0)]
    report = {'runs': [{'update_interval_s': 1.0, 'horizontal_rmse_m': 1.234}, {'update_interval_s': 3.0}],
              'verdict': {'changes': changes},
              'outages': [{'count': n, 'within_95_percent': held} for n, held in ((7, 99.6), (5, 80.0), (3, 0.0))]}
    # when the table is written
    new = with_table(page, [(report, 4.567 if i == 0 else None) for i in range(len(replays))], 'abc1234')
    # then each row has its numbers, only the first one those of its fixes, and nothing else has changed
    before, after = page.splitlines(), new.splitlines()
    changed = [(old, line) for old, line in zip(before, after, strict=True) if old != line]
    rows = [[cell.strip() for cell in line.split('|')[1:-1]] for _, line in changed if line.startswith('|')]
    assert len(rows) == len(replays) == 5
    assert rows[0][1:3] == ['4.6 m', '1.2 m']
    assert all(row[-4:] == ['1.1 m (70)', '3.3 m (210)', '6.7 m (420)', '100, 80, 0 %'] for row in rows)
    assert [row[0] for row in rows] == [old.split('|')[1].strip() for old, _ in changed if old.startswith('|')]
    assert len(changed) == 5 + 2 and 'over 3 to 7 such' in new and 'Measured at commit abc1234' in new


def test_what_a_tool_says_to_type_next_can_be_typed(played):
    folder, said = played
    # a command of two lines as a shell takes it
    printed = [step.process.stdout.replace('\\\n', '') for step in said]
    lines = [line.strip().removeprefix('next: ') for text in printed for line in text.splitlines()]
    next_ones = [shlex.split(line) for line in lines if line.startswith('python -m mems_ins_fusion')]
    assert next_ones
    for words in next_ones:
        check_tool(words[3], words[4:])
        for option, value in zip(words, words[1:]):
            assert option != '--params-file' or value == YOURS or (folder / value).is_file()


def test_a_tool_without_its_arguments_says_what_it_needs(capsys):
    for name in TOOLS:
        if name not in OF_NODE and name not in ('compile', 'completion'):
            with pytest.raises(SystemExit):
                tool([name])
            assert 'required' in capsys.readouterr().err
