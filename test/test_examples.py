"""The scripts and the notebook of examples/ run, and do what they say."""
from __future__ import annotations

import ast
import importlib.util
import json
from pathlib import Path

import matplotlib
import pytest

from mems_ins_fusion.__main__ import main as tool

FOLDER = Path(__file__).resolve().parents[1] / 'examples'


def example(name):
    """A script of the folder as a module."""
    spec = importlib.util.spec_from_file_location(f'example_{name}', FOLDER / f'{name}.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('examples') / 'drive'
    assert tool(['simulate', '--output', str(path), '--duration', '90', '--rate', '50', '--seed', '1']) == 0
    return path


def test_each_example_is_tested():
    assert {path.name for path in FOLDER.iterdir() if path.suffix in ('.py', '.ipynb')} == {
        'live_filter.py', 'replay_and_plot.py', 'own_sensor.py', 'outage.ipynb'}


def test_the_live_filter_takes_one_event_at_a_time(bag, capsys):
    assert example('live_filter').main(str(bag)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) >= 4 and lines[-1].endswith('fusing') and ' 48.00' in lines[-1]


def test_a_replay_becomes_a_picture(bag, tmp_path, capsys):
    example('replay_and_plot').main(str(bag), str(tmp_path / 'track.png'))
    assert (tmp_path / 'track.png').stat().st_size > 10_000
    assert 'mean NIS' in capsys.readouterr().out


def test_an_own_sensor_with_wheel_speed_is_located():
    assert example('own_sensor').main() < 3.0  # m, two sigma of its fixes


def test_the_notebook_runs_from_top_to_bottom(capsys):
    matplotlib.use('agg')
    notebook = json.loads((FOLDER / 'outage.ipynb').read_text(encoding='utf-8'))
    assert notebook['nbformat'] == 4 and not any(cell.get('outputs') for cell in notebook['cells'])
    names: dict = {}
    for cell in notebook['cells']:
        if cell['cell_type'] == 'code':
            exec(''.join(cell['source']), names)
    metres, sigmas = (float(word) for word in capsys.readouterr().out.split()[::2])
    assert metres < 100 and sigmas < 3.5


@pytest.mark.parametrize('study', sorted((FOLDER.parent / 'studies').glob('*.py')), ids=lambda path: path.stem)
def test_a_study_finds_what_it_imports_of_the_package(study):
    # given the imports of a study, which no test runs
    for node in ast.walk(ast.parse(study.read_text(encoding='utf-8'))):
        if isinstance(node, ast.ImportFrom) and (node.module or '').startswith('mems_ins_fusion'):
            module = importlib.import_module(node.module)
            missing = [name.name for name in node.names if not hasattr(module, name.name)
                       and importlib.util.find_spec(f'{node.module}.{name.name}') is None]
            assert not missing, f'{node.module} has no {", ".join(missing)}'
