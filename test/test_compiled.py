"""Compiled code and where it is kept: current, shared by processes, and not needed."""
from __future__ import annotations

import ast
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mems_ins_fusion import compiled

PACKAGE = Path(compiled.__file__).parent
SAYS_THAT_IT_COMPILES = 'compiling the filter'
#: two functions, one calling the other, for the type that the first argument names
PROBE = """
import sys
from mems_ins_fusion.compiled import njit

@njit
def twice(x):
    return x + x

@njit
def thrice(x):
    return twice(x) + x

values = {'int': 2, 'float': 2.5, 'complex': 2j, 'bool': True}
value = values[sys.argv[1]]
assert thrice(value) == 3 * value, thrice(value)
print('right')
"""


@pytest.fixture
def probe(tmp_path):
    """Runs the probe in a process of its own with a cache of its own; `start` without waiting for it."""
    script = tmp_path / 'probe.py'
    script.write_text(PROBE)
    cache = tmp_path / 'cache'

    def start(kind='float', folder=cache, **options):
        environment = {**os.environ, 'NUMBA_CACHE_DIR': str(folder), 'PYTHONPATH': str(PACKAGE.parent)}
        return subprocess.Popen([sys.executable, script, kind], env=environment, text=True, stdout=subprocess.PIPE,
                                stderr=subprocess.PIPE, **options)

    def run(*arguments, **options):
        """What it said on stderr."""
        process = start(*arguments, **options)
        out, said = process.communicate()
        assert (process.returncode, out) == (0, 'right\n'), said
        return said

    run.start, run.cache = start, cache
    return run


@pytest.mark.parametrize(('version', 'in_parts'), [((0, 59, 1), True), ((0, 99, 0), False)])
def test_a_numba_that_nobody_tried_compiles_as_it_does_by_itself(tmp_path, version, in_parts):
    # given one that says it is another version than it is
    script = tmp_path / 'probe.py'
    script.write_text(f"""
import sys
import numba
numba.version_info = {version}
{PROBE.replace("values[sys.argv[1]]", "2.5")}
print('mems_ins_fusion.compiled_parts' in sys.modules)
""")
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'cache'), 'PYTHONPATH': str(PACKAGE.parent)}
    done = subprocess.run([sys.executable, script], env=environment, text=True, capture_output=True)
    # then its inside is let alone, and what is compiled is right
    assert (done.returncode, done.stdout) == (0, f'right\n{in_parts}\n'), done.stderr


def test_numbers_arrays_and_columns_are_what_they_are_in_python(tmp_path):
    # given a function with what has a way of its own in compiled_parts: columns by name, also of one of two tuples,
    # elements from the end, by an unsigned position and of integers, and operators of numbers
    script = tmp_path / 'probe.py'
    script.write_text("""
from collections import namedtuple
import numpy as np
from mems_ins_fusion.compiled import njit

Row = namedtuple('Row', 'FIRST SECOND')(1, 2)
Later = type(Row)(2, 3)

def python(row, whole, k, is_later):
    columns = Row
    if is_later:
        columns = Later
    total = row[-1] + row[columns.SECOND] - row[Row.FIRST] * whole[k]
    row[Row.FIRST] = whole[-2]
    row[np.uint64(k)] += 0.5
    whole[columns.FIRST - 1] -= k * 2
    total += 100.0 if row[0] <= 2.5 and whole[0] != whole[1] or k > 3 else 10.0
    total *= row[columns.FIRST] ** 2 / 8
    return total, k - columns.SECOND, row[2] >= total, whole[k] == Later.SECOND, columns.FIRST < 2, total > -3

compiled = njit(python)
for k in range(4):
    for is_later in (False, True):
        told = []
        for function in (python, compiled):
            row, whole = np.array([2.5, 3.0, -4.0, 5.5]), np.array([7, 3, 2, 1])
            told.append((function(row, whole, k, is_later), row.tolist(), whole.tolist()))
        assert told[0] == told[1], told
print('right')
""")
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'cache'), 'PYTHONPATH': str(PACKAGE.parent)}
    done = subprocess.run([sys.executable, script], env=environment, text=True, capture_output=True)
    # then compiled it computes what Python does
    assert (done.returncode, done.stdout) == (0, 'right\n'), done.stderr


def test_four_numbers_at_once_are_what_each_alone_would_be(tmp_path):
    # given a function of numbers and of fours, which also mixes both
    script = tmp_path / 'probe.py'
    script.write_text("""
import numpy as np
from mems_ins_fusion.compiled import njit
from mems_ins_fusion.compiled_lanes import four, put

@njit
def step(scale, a, b, pair):
    return scale * (a - 0.5 * b) + pair[0] * pair[1] - b, a * scale - 3 + b

def at_once(values, scale):
    results = step(scale, four(values, 0), four(values, 5), (four(values, 2), four(values, 9)))
    for k in range(2):
        put(values, 13 + 4 * k, results[k])

compiled, given = njit(_nrt=False)(at_once), np.random.default_rng(1).standard_normal(22)
alone = given.copy()
for i in range(4):
    alone[13 + i], alone[17 + i] = step(0.3, given[i], given[5 + i], (given[2 + i], given[9 + i]))
for function in (at_once, compiled):
    values = given.copy()
    function(values, 0.3)
    assert values.tobytes() == alone.tobytes(), values - alone
print('right')
""")
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'cache'), 'PYTHONPATH': str(PACKAGE.parent)}
    for disabled in ('0', '1'):
        # when it is compiled, or Python's
        done = subprocess.run([sys.executable, script], env={**environment, 'NUMBA_DISABLE_JIT': disabled}, text=True,
                              capture_output=True)
        # then the results are the same to the last bit
        assert (done.returncode, done.stdout) == (0, 'right\n'), done.stderr


def test_the_user_hears_that_it_compiles_and_how_long_it_took_the_last_time(probe):
    assert f'{SAYS_THAT_IT_COMPILES}, once for each version of it (about a minute)' in probe()
    assert probe() == ''
    # when another type needs compiling
    assert ' s last time)' in probe('int')


@pytest.mark.parametrize(['pattern', 'size'], [('*.nbi', 0), ('*.nbc', 100)])
def test_a_damaged_cache_is_named_and_made_anew(probe, pattern, size):
    probe()
    for path in probe.cache.rglob(pattern):
        path.write_bytes(path.read_bytes()[:size])
    said = probe()
    assert 'cannot be used' in said and str(probe.cache) in said and 'Traceback' not in said
    assert probe() == ''


def test_without_a_folder_for_it_all_works_and_says_so(probe, tmp_path):
    (tmp_path / 'file').touch()
    said = probe('float', tmp_path / 'file' / 'cache')
    assert said.count('cannot be kept in') == 1 and 'NUMBA_CACHE_DIR' in said and 'Traceback' not in said


def test_on_a_full_disk_all_works_and_says_so(probe):
    said = probe(preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)))
    assert said.count('cannot be kept in') == 1 and 'Traceback' not in said
    # and what was written by then harms nobody
    assert SAYS_THAT_IT_COMPILES in probe()


def test_several_processes_compile_at_once_and_nothing_is_lost(probe):
    kinds = ['int', 'float', 'complex', 'bool']
    started = [probe.start(kind) for kind in kinds]
    assert [process.communicate()[0] for process in started] == ['right\n'] * len(kinds)
    assert [probe(kind) for kind in kinds] == [''] * len(kinds)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_compiles_ends_without_a_traceback(tmp_path, number):
    process = subprocess.Popen(
        [sys.executable, '-m', 'mems_ins_fusion', 'compile'], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        cwd=PACKAGE.parent, env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)})
    assert SAYS_THAT_IT_COMPILES in process.stderr.readline()
    process.send_signal(number)
    _, said = process.communicate()
    assert process.returncode == 130
    assert 'Traceback' not in said and 'Error' not in said


def test_compile_leaves_nothing_to_compile():
    # given all of `compile` (from the cache), then: live, replay, outages, effects and characterization in other ways
    script = """
from numba.core import event
from mems_ins_fusion.cli import compile
compile.main([])
with event.install_recorder('numba:compile') as compiled:
    import numpy as np
    from mems_ins_fusion.characterization.fitting import fit_gauss_markov
    from mems_ins_fusion.characterization.likelihood import average
    from mems_ins_fusion.effects.registry import EFFECTS
    from mems_ins_fusion.evaluation.comparison import compare
    from mems_ins_fusion.filter.config import FilterConfig
    from mems_ins_fusion.filter.runs.live import FusionFilter
    from mems_ins_fusion.filter.runs.replay import run
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.recordings.motion import positions
    from mems_ins_fusion.simulation.simulation import simulate_drive, simulate_recording
    fit_gauss_markov(average([np.random.default_rng(1).standard_normal(2000)], 5, 0.02))
    recording = simulate_recording(simulate_drive(60.0, seed=2, rate=10.0)).recording
    imu, gnss = recording.imu, recording.gnss
    positions(gnss.select(slice(None, None, 2)))  # as the node's looks at mounting and inputs do
    compare(recording, table.check({'mechanization': 'strapdown', 'outage_durations': [5.0], 'feedback': 'open'}))
    for mechanization in ('planar', 'strapdown'):
        values = table.check({'mechanization': mechanization, 'vehicle.zero_velocity': True,
                              'vehicle.non_holonomic': True, 'imu.lever_arm': [0.1, 0.0, 0.0]})
        config = FilterConfig.from_parameters(values)
        run(config, imu, gnss)
        live = FusionFilter(config)
        for i in range(len(imu)):
            if live.add_imu(int(imu.stamp[i]), *imu.specific_force[i].tolist(), *imu.angular_rate[i].tolist()):
                live.update_odometry()
            for k in np.flatnonzero((gnss.stamp > imu.stamp[i - 1]) & (gnss.stamp <= imu.stamp[i])) if i else ():
                live.add_fix(int(gnss.stamp[k]), float(gnss.latitude[k]), float(gnss.longitude[k]),
                             float(gnss.height[k]), gnss.covariance[k].reshape(9))
        assert live.status == 'running' and live.health() and live.snapshot()
print('left:', sorted({str(e.data['dispatcher'].py_func.__name__) for _, e in compiled.buffer}))
"""
    environment = {**os.environ, 'PYTHONPATH': str(PACKAGE.parent)}
    answer = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True, env=environment)
    assert answer.stdout.endswith('left: []\n'), answer.stdout + answer.stderr


def compiled_functions():
    """(file, its syntax tree, the function) for each function that is compiled."""
    for path in PACKAGE.rglob('*.py'):
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and any('njit' in ast.unparse(d) for d in node.decorator_list):
                yield path, tree, node


def test_what_compiled_code_is_made_of_decides_whether_it_is_still_good():
    known = {path.resolve() for path in compiled.sources()}
    functions = list(compiled_functions())
    assert len(functions) > 40
    for path, tree, function in functions:
        assert path in known, f'{path} has compiled functions: its package is missing in compiled.py'
        used = {node.id for node in ast.walk(function) if isinstance(node, ast.Name)}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and used & {alias.asname or alias.name for alias in node.names}:
                source = source_of(path, node)
                assert source is None or source in known or source.stem == 'compiled', \
                    f'{path}: {function.name} uses names of {source}, whose package is missing in compiled.py'


def source_of(path, node):
    """The file of our package from which `node` in the file `path` imports; None for others."""
    module = (node.module or '').split('.')
    if node.level:
        folder = path.parents[node.level - 1]
    elif module[0] == PACKAGE.name:
        folder, module = PACKAGE, module[1:]
    else:
        return None
    target = folder.joinpath(*filter(None, module))
    return target / '__init__.py' if target.is_dir() else target.with_suffix('.py')
