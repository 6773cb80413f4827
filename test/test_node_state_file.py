"""The state file: one that does not fit is not used, and the one that is replaced is never half there."""
from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.quantity import EarlierFinding
from mems_ins_fusion.nodes.state_file import StateFile
from mems_ins_fusion.parameters.parameter import ParameterError

HERE = {'stamp': 1_000 * 10**9, 'latitude': 0.84, 'longitude': 0.2, 'height': 480.0, 'yaw': 1.2}
METRE = 1 / 6.37e6  # rad of latitude


@pytest.fixture
def path(tmp_path):
    path = tmp_path / 'state.json'
    assert StateFile(path, 3600.0, 20.0).write(HERE) is None
    return path


def opened(path):
    file = StateFile(path, 3600.0, 20.0)
    return file, file.read()


def test_what_was_written_is_found_again_near_by_and_soon(path):
    file, said = opened(path)
    assert said is None
    snapshot, said = file.fitting(HERE['stamp'] + 60 * 10**9, 0.84 + 10 * METRE, 0.2, 480.0)
    assert snapshot == HERE
    assert '60 s old' in said and '10.0 m away' in said
    # and only for the first fix
    assert file.fitting(HERE['stamp'] + 61 * 10**9, 0.84, 0.2, 480.0) is None


@pytest.mark.parametrize('seconds, metres, said', [
    (3601, 0, 'it is 3601 s old, not 0 to 3600 s'), (-1, 0, 'it is -1 s old'),
    (60, 30, 'its position is 30 m from the first fix, more than 20 m')])
def test_one_too_old_too_far_or_of_the_future_is_not_used(path, seconds, metres, said):
    file, _ = opened(path)
    snapshot, reason = file.fitting(HERE['stamp'] + seconds * 10**9, 0.84 + metres * METRE, 0.2, 480.0)
    assert snapshot is None
    assert said in reason


@pytest.mark.parametrize('content', ['', '{"version": 1', '[]', '{"version": 2, "filter": {}}',
                                     '{"version": 1, "filter": {"stamp": 1}}',
                                     json.dumps({'version': 1, 'filter': {**HERE, 'latitude': float('nan')}}),
                                     json.dumps({'version': 1, 'filter': {**HERE, 'height': 'high'}})])
def test_a_damaged_one_is_named_and_not_used(path, content):
    path.write_text(content)
    file, said = opened(path)
    assert str(path) in said and 'starting without' in said and '\n' not in said
    assert file.fitting(HERE['stamp'], 0.84, 0.2, 480.0) is None


def test_none_yet_is_nothing_to_speak_of_and_no_folder_is_an_error(tmp_path):
    file, said = opened(tmp_path / 'new.json')
    assert said is None
    assert file.fitting(0, 0.84, 0.2, 480.0) is None
    with pytest.raises(ParameterError, match="parameter 'state_file': there is no folder"):
        StateFile(tmp_path / 'absent' / 'state.json', 1.0, 1.0)


def test_a_write_that_fails_leaves_the_old_file_and_says_so(path, monkeypatch):
    def full(*arguments):
        raise OSError(28, 'No space left on device')
    monkeypatch.setattr(os, 'replace', full)
    file, _ = opened(path)
    said = file.write({**HERE, 'yaw': np.pi})
    assert said == f'state file {path}: not written: No space left on device'
    assert json.loads(path.read_text())['filter'] == HERE
    assert [one.name for one in path.parent.iterdir()] == [path.name]


#: of a process that writes a state file: from then on it is killed at its next `os.fsync` or `os.replace`
KILLED = """
import os, signal, sys
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.quantity import EarlierFinding
from mems_ins_fusion.nodes.state_file import StateFile
file = StateFile(sys.argv[1], 3600.0, 20.0)
assert file.read() is None
setattr(os, sys.argv[2], lambda *arguments: os.kill(os.getpid(), signal.SIGKILL))
kept = EarlierFinding('gnss_time_offset', {'time_offset': Estimate(0.4, 0.01, 's')}, {'gnss.time_offset': 0.4}, 1)
file.write({**dict.fromkeys(('stamp', 'latitude', 'longitude', 'height'), 1.0)}, [kept], {'imu_topic': '/imu'})
"""


@pytest.mark.parametrize('at', ['fsync', 'replace'])
def test_a_kill_while_it_is_written_leaves_the_old_one(path, at):
    # given what an earlier drive has found, and a node that is killed while it writes something else
    file, _ = opened(path)
    sets, topics = {'gnss.time_offset': 0.2}, {'imu_topic': '/imu'}
    kept = EarlierFinding('gnss_time_offset', {'time_offset': Estimate(0.2, 0.01, 's')}, sets, 1)
    assert file.write(HERE, [kept], topics) is None
    status = subprocess.run([sys.executable, '-c', KILLED, str(path), at]).returncode
    assert status == -signal.SIGKILL and len(list(path.parent.iterdir())) == 2
    # then the next start has what was there before, and nothing else is left
    file, said = opened(path)
    assert said is None and file.calibration(topics)[0] == [kept]
    assert [one.name for one in path.parent.iterdir()] == [path.name]
    assert file.fitting(HERE['stamp'], 0.84, 0.2, 480.0)[0] == HERE


def test_what_a_kill_has_left_beside_it_goes_at_the_next_start(path):
    left = path.with_name(f'.{path.name}.x7')
    left.write_text('{"version"')
    file, said = opened(path)
    assert said is None and not left.exists() and path.exists()
