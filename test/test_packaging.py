"""The package as its users get it: installed by pip, its files, its commands, its documents."""
from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

import mems_ins_fusion
from mems_ins_fusion.__main__ import TOOLS, main
from mems_ins_fusion.parameters import __main__ as documents
from mems_ins_fusion.parameters import params_file, table

REPOSITORY = Path(__file__).resolve().parents[1]
MANIFEST = ElementTree.parse(REPOSITORY / 'package.xml').getroot()

#: module -> (rosdep key, name on the Python package index where it is there)
MODULES = {
    'matplotlib': ('python3-matplotlib', 'matplotlib'), 'numba': ('python3-numba', 'numba'),
    'numpy': ('python3-numpy', 'numpy'), 'rosbags': ('python3-rosbags-pip', 'rosbags'),
    'scipy': ('python3-scipy', 'scipy'), 'tqdm': ('python3-tqdm', 'tqdm'), 'yaml': ('python3-yaml', 'pyyaml'),
}
#: decompression: requirements of rosbags, or (compression) of the standard library of Python 3.14
BROUGHT_BY_ROSBAGS = {'backports', 'compression', 'lz4'}


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """A copy of the repository: building leaves files behind."""
    copy = tmp_path_factory.mktemp('source') / 'mems_ins_fusion'
    wanted = ['mems_ins_fusion', 'config', 'launch', 'resource', 'scripts', 'package.xml', 'setup.py', 'setup.cfg',
              'pyproject.toml']
    for name in wanted:
        path = REPOSITORY / name
        if path.is_dir():
            shutil.copytree(path, copy / name, ignore=shutil.ignore_patterns('__pycache__'))
        else:
            copy.mkdir(exist_ok=True)
            shutil.copy(path, copy)
    return copy


@pytest.fixture(scope='module')
def prefix(source, tmp_path_factory):
    """Where pip installed the package."""
    prefix = tmp_path_factory.mktemp('prefix')
    subprocess.run([sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps', '--no-build-isolation',
                    '--no-index', '--ignore-installed', '--prefix', prefix, source], check=True)
    return prefix


def imported_modules():
    """Names of all top-level modules that the package imports anywhere."""
    for path in (REPOSITORY / 'mems_ins_fusion').rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                yield from (alias.name.split('.')[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                yield node.module.split('.')[0]


def test_the_version_is_the_same_everywhere():
    setup = re.search(r"version='(.+?)'", (REPOSITORY / 'setup.py').read_text()).group(1)
    changes = re.search(r'^(\d+\.\d+\.\d+) \(', (REPOSITORY / 'CHANGELOG.rst').read_text(), re.MULTILINE).group(1)
    assert {setup, changes, MANIFEST.findtext('version')} == {mems_ins_fusion.__version__}


def test_everything_imported_is_declared():
    ours = {'mems_ins_fusion', *sys.stdlib_module_names, *BROUGHT_BY_ROSBAGS}
    declared = {tag.text for tag in MANIFEST if tag.tag in ('depend', 'exec_depend')}
    required = re.search(r'install_requires=(\[.+?\])', (REPOSITORY / 'setup.py').read_text()).group(1)
    requirements = {re.match(r'[\w-]+', requirement).group() for requirement in ast.literal_eval(required)}
    undeclared = []
    for module in set(imported_modules()) - ours:
        rosdep_key, requirement = MODULES.get(module, (module, None))
        if rosdep_key not in declared or (requirement and requirement not in requirements):
            undeclared.append(module)
    assert not undeclared


def test_pip_installs_what_ros_looks_for(prefix):
    share = prefix / 'share' / 'mems_ins_fusion'
    assert (prefix / 'share/ament_index/resource_index/packages/mems_ins_fusion').is_file()
    assert (share / 'package.xml').is_file()
    assert (share / 'config/fusion.yaml').is_file()
    assert (share / 'launch/fusion.launch.py').is_file()


@pytest.mark.parametrize('tool', TOOLS)
def test_ros2_run_finds_each_tool(prefix, tool):
    # ros2 run starts any executable file in lib/PACKAGE
    path = prefix / 'lib' / 'mems_ins_fusion' / tool
    assert os.access(path, os.X_OK)
    assert f"'{tool}'" in path.read_text()


def test_an_installed_executable_runs_its_tool(prefix, tmp_path):
    # given the environment that ROS's setup file makes, and this Python as python3
    installed = next(prefix.glob('lib/python*/site-packages'))
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])
    answer = subprocess.run([prefix / 'lib/mems_ins_fusion/fusion_node', 'no', 'ros'], capture_output=True, text=True,
                            cwd=tmp_path, env={**os.environ, 'PYTHONPATH': str(installed), 'PATH': path})
    assert answer.returncode == 2
    assert answer.stderr.startswith("fusion_node: 'no' is not understood")


@pytest.mark.parametrize('arguments', [[], ['fuse']])
def test_without_a_known_tool_the_usage_names_each_and_the_status_is_2(arguments, capsys):
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert all(re.search(rf'^  {tool} +\w', said, re.MULTILINE) for tool in TOOLS)


def test_the_list_of_parameters_is_current():
    assert (REPOSITORY / 'docs/parameters.md').read_text() == documents.markdown(), \
        'run python -m mems_ins_fusion.parameters > docs/parameters.md'


def test_the_example_params_file_holds_each_parameter_of_the_node_at_its_default():
    given = params_file.load_yaml(REPOSITORY / 'config/fusion.yaml', 'fusion_node')
    defaults = table.defaults()
    assert given == {p.name: defaults[p.name] for p in (*table.FILTER, *table.FUSION)}
    # in the types, too, that ROS tells apart
    assert all(type(given[name]) is type(defaults[name]) for name in given)
    assert (REPOSITORY / 'config/fusion.yaml').read_text() == documents.example(), \
        'run python -m mems_ins_fusion.parameters --yaml > config/fusion.yaml'
