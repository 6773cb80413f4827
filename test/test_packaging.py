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
import yaml

import mems_ins_fusion
from mems_ins_fusion.__main__ import TOOLS, main
from mems_ins_fusion.parameters import __main__ as documents
from mems_ins_fusion.parameters import params_file, table

REPOSITORY = Path(__file__).resolve().parents[1]
MANIFEST = ElementTree.parse(REPOSITORY / 'package.xml').getroot()

#: module -> (rosdep key, None where there is none for Ubuntu 24.04; name on the Python package index)
MODULES = {
    'matplotlib': ('python3-matplotlib', 'matplotlib'), 'numba': (None, 'numba'),
    'numpy': ('python3-numpy', 'numpy'), 'rosbags': (None, 'rosbags'),
    'scipy': ('python3-scipy', 'scipy'), 'tqdm': ('python3-tqdm', 'tqdm'), 'yaml': ('python3-yaml', 'pyyaml'),
}
#: decompression: requirements of rosbags, or (compression) of the standard library of Python 3.14
BROUGHT_BY_ROSBAGS = {'backports', 'compression', 'lz4'}
#: imported only by who asks for it, and said in one line where it is missing
OPTIONAL = {'robot_localization', 'dask', 'distributed', 'fsspec', 'pyarrow'}


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
    ours = {'mems_ins_fusion', *sys.stdlib_module_names, *BROUGHT_BY_ROSBAGS, *OPTIONAL}
    declared = {tag.text for tag in MANIFEST if tag.tag in ('depend', 'exec_depend')}
    requirements = {re.match(r'[\w-]+', requirement).group() for requirement in install_requires()}
    undeclared = []
    for module in set(imported_modules()) - ours:
        rosdep_key, requirement = MODULES.get(module, (module, None))
        if (rosdep_key or 'none') not in {*declared, 'none'} or (requirement and requirement not in requirements):
            undeclared.append(module)
    assert not undeclared


def install_requires():
    required = re.search(r'install_requires=(\[.+?\])', (REPOSITORY / 'setup.py').read_text(), re.DOTALL).group(1)
    return ast.literal_eval(required)


def test_what_the_extra_fleet_brings_is_imported_there_only():
    for path in (REPOSITORY / 'mems_ins_fusion').rglob('*.py'):
        if path.parent.name != 'fleet':
            optional = r'^\s*(import|from) (dask|distributed|fsspec|pyarrow)\b'
            assert not re.search(optional, path.read_text(), re.MULTILINE)


def test_the_nodes_start_without_what_only_tools_need():
    code = ('import sys, mems_ins_fusion.nodes.fusion_node, mems_ins_fusion.nodes.replay_node; '
            'print(*{"scipy.signal", "scipy.stats", "scipy.optimize", "matplotlib"} & set(sys.modules))')
    process = subprocess.run([sys.executable, '-c', code], cwd=REPOSITORY, capture_output=True, text=True)
    assert (process.returncode, process.stdout) == (0, '\n'), process.stderr or process.stdout


def test_the_lowest_versions_are_those_that_make_test_oldest_installs():
    # for the Pythons that have the versions of Ubuntu 24.04; later ones begin with later versions
    oldest = re.findall(r"^(\w+)==([\d.]+)(?!.*>= '3.13'|.*== '3.12')", (REPOSITORY / 'test/oldest.txt').read_text(),
                        re.MULTILINE)
    tested = {name: version.split('.') for name, version in oldest}
    lowest = {name: version.split('.') for name, version in (text.split('>=') for text in install_requires())}
    assert tested.keys() == lowest.keys()
    assert all(tested[name][:len(version)] == version for name, version in lowest.items())


def test_each_key_of_the_manifest_is_in_the_index_for_ubuntu_24_04():
    index = yaml.safe_load((REPOSITORY / 'test/rosdep.yaml').read_text())
    keys = {tag.text for tag in MANIFEST if tag.tag.endswith('depend')}
    released = {name for packages in index['jazzy'].values() for name in packages}
    for key in keys - released:
        packages = index['ubuntu'].get(key)
        if isinstance(packages, dict):
            packages = packages.get('noble', packages.get('*'))
        assert packages, f'rosdep has no {key} for Ubuntu 24.04, or nobody has looked'


#: elements of a package in their order, from package_format3.xsd and REP 149: how often, attributes, text
TOKEN = r'[a-z](_?[a-z0-9]+)*'
VERSION = r'(0|[1-9]\d*)(\.(0|[1-9]\d*)){2}'
EMAIL = r'[-\w%+]+(\.[-\w%+]+)*@[-a-zA-Z0-9%]+(\.[-a-zA-Z0-9%]+)*\.[a-zA-Z]{2,}'
DEPENDENCIES = {'build_depend', 'build_export_depend', 'buildtool_depend', 'buildtool_export_depend', 'exec_depend',
                'depend', 'doc_depend', 'test_depend', 'conflict', 'replace'}
LIMITS = {f'version_{comparison}' for comparison in ('lt', 'lte', 'eq', 'gte', 'gt')}
SCHEMA = [({'name'}, (1, 1), set(), TOKEN), ({'version'}, (1, 1), {'compatibility'}, VERSION),
          ({'description'}, (1, 1), set(), r'.+'), ({'maintainer'}, (1, 99), {'email'}, r'.+'),
          ({'license'}, (1, 99), {'file'}, r'.+'), ({'url'}, (0, 99), {'type'}, r'\S+'),
          ({'author'}, (0, 99), {'email'}, r'.+'), (DEPENDENCIES, (0, 99), {*LIMITS, 'condition'}, r'[\w-]+'),
          ({'group_depend'}, (0, 99), {'condition'}, r'.+'), ({'member_of_group'}, (0, 99), {'condition'}, r'.+'),
          ({'export'}, (0, 1), set(), r'.*')]


def wrong_in(package):
    """What the schema refuses in a package element, as text; nothing where it is valid."""
    if package.tag != 'package' or package.attrib != {'format': '3'}:
        yield f'{package.tag} {package.attrib}'
    left = list(package)
    for names, (fewest, most), attributes, text in SCHEMA:
        count = 0
        while left and left[0].tag in names:
            element, count = left.pop(0), count + 1
            if element.attrib.keys() - attributes or not re.fullmatch(text, (element.text or '').strip(), re.DOTALL):
                yield f'{element.tag} {element.attrib} {element.text}'
            if 'email' in attributes and not re.fullmatch(EMAIL, element.get('email', '')):
                yield f'{element.tag}: email'
        if not fewest <= count <= most:
            yield f'{count} times {min(names)}'
    yield from (f'{element.tag} is unknown or out of place' for element in left)


def test_the_manifest_is_valid():
    assert list(wrong_in(MANIFEST)) == []


@pytest.mark.parametrize(['text', 'wrong'], [
    ('<version>0.1.0</version>', '<version>0.1</version>'), ('email="maintainers@', 'email="maintainers'),
    ('<license file="LICENSE">Apache-2.0</license>', ''), ('<exec_depend>rclpy', '<run_depend>rclpy'),
    ('<package format="3">', '<package format="2">')])
def test_the_check_of_the_manifest_sees_mistakes(text, wrong):
    manifest = (REPOSITORY / 'package.xml').read_text()
    assert text in manifest
    broken = manifest.replace(text, wrong).replace('<run_depend>rclpy</exec_depend>', '<run_depend>rclpy</run_depend>')
    assert list(wrong_in(ElementTree.fromstring(broken)))


def test_pip_installs_what_ros_looks_for(prefix):
    share = prefix / 'share' / 'mems_ins_fusion'
    assert (prefix / 'share/ament_index/resource_index/packages/mems_ins_fusion').is_file()
    assert (share / 'package.xml').is_file()
    assert (share / 'config/fusion.yaml').is_file()
    for kind in ('sensors', 'layouts'):
        ours = {path.name for path in (REPOSITORY / 'config' / kind).iterdir()}
        assert ours and {path.name for path in (share / 'config' / kind).iterdir()} == ours
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
    given = params_file.load_yaml(REPOSITORY / 'config/fusion.yaml')
    defaults = table.defaults()
    assert given == {p.name: defaults[p.name] for p in (*table.FILTER, *table.FUSION)}
    # in the types, too, that ROS tells apart
    assert all(type(given[name]) is type(defaults[name]) for name in given)
    assert (REPOSITORY / 'config/fusion.yaml').read_text() == documents.example(), \
        'run python -m mems_ins_fusion.parameters --yaml > config/fusion.yaml'
