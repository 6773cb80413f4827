"""kill -9 at any moment leaves the old result or the new one."""
from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

MOMENTS = 3


def run(arguments, kill_after=None) -> float:
    """The tool in a process of its own, killed after so many seconds; how long it took."""
    began = time.monotonic()
    child = subprocess.Popen([sys.executable, '-m', 'mems_ins_fusion', *arguments], stdout=subprocess.DEVNULL,
                             stderr=subprocess.DEVNULL)
    if kill_after is not None:
        time.sleep(kill_after)
        child.kill()
    status = child.wait()
    assert kill_after is not None or status == 0
    return time.monotonic() - began


def content(folder: Path) -> dict:
    """What tells one result from another: which files there are, and how large those are that hold no times."""
    return {path.name: path.stat().st_size for path in sorted(folder.iterdir())
            if path.suffix in ('.mcap', '.tum', '.csv')}


def simulate(output, duration):
    return ['simulate', '--output', str(output), '--duration', str(duration), '--rate', '50', '--overwrite']


def replay(output, bag, interval):
    parameters = {'bag': bag, 'output_dir': output, 'overwrite': 'true', 'models': '[random_walk]',
                  'update_intervals': f'[{interval:.1f}]', 'outage_durations': '[10.0]'}
    return ['replay_node', '--ros-args', *(word for p in parameters.items() for word in ('-p', ':='.join(map(str, p))))]


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('killed') / 'bag'
    run(simulate(path, 70))
    return path


@pytest.mark.parametrize('name', ['simulate', 'replay_node'])
def test_a_tool_that_is_killed_leaves_the_old_result_or_the_new_one(name, bag, tmp_path):
    output = tmp_path / 'result'

    def command(which):
        return simulate(output, (20, 25)[which]) if name == 'simulate' else replay(output, bag, (1.0, 2.0)[which])
    # given an old result, and what the new one would be
    run(command(1))
    new = content(output)
    seconds = run(command(0))
    old = content(output)
    assert old != new and old
    # when the tool is killed at several moments, then one of both is there, complete
    for moment in range(1, MOMENTS + 1):
        run(command(1), kill_after=seconds * moment / MOMENTS)
        assert content(output) in (old, new)
    # and the next one finds nothing that hinders it, and leaves nothing else
    run(command(1))
    assert content(output) == new
    assert [path.name for path in tmp_path.iterdir()] == ['result']
