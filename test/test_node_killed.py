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
    # given an old result
    seconds = run(command(0))
    old, there = content(output), []
    # when a tool that makes a new one is killed at several moments, and the next one is not
    for moment in range(1, MOMENTS + 1):
        run(command(1), kill_after=seconds * moment / MOMENTS)
        there.append(content(output))
    run(command(1))
    # then after each there was the old one or the new one, complete, and nothing else is left
    new = content(output)
    assert old != new and old
    assert all(found in (old, new) for found in there)
    assert [path.name for path in tmp_path.iterdir()] == ['result']
