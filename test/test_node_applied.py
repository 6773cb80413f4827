"""What has been found while driving and drives, over real ROS 2: the bits of a replay, nothing lost by kill -9, and a
quick end."""
from __future__ import annotations

import json
import math
import os
import resource
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import PLAYABLE, NodeProcess, Peer, call, stamp_of
from std_srvs.srv import Trigger
from test_applying import HERE, NAME, drive
from test_fusion_node import flat
from test_online import OFFSET, SECOND, blind, finding

from mems_ins_fusion.diagnosis.applying import live_output
from mems_ins_fusion.diagnosis.quantity import EarlierFinding
from mems_ins_fusion.diagnosis.watch import RecordingWatch
from mems_ins_fusion.nodes.state_file import StateFile
from mems_ins_fusion.parameters import table

SENSORS = {'imu_topic': '/imu/data', 'gnss_topic': '/gps/fix'}


@pytest.fixture(autouse=True)
def without_shared_memory(monkeypatch):
    """Fast DDS 2.14 may crash a process whose peer is killed with -9: it locks a mutex in memory that is gone."""
    monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')


@pytest.fixture(scope='module')
def recording():
    """Four minutes, in which fixes are stamped late until the middle."""
    return drive(end=0.5, minutes=4.0)


@pytest.fixture
def kept(recording):
    return EarlierFinding(NAME, finding().parameters, {'gnss.time_offset': OFFSET},
                          int(recording.imu.stamp[0]) - SECOND)


def of_file(path):
    """What the state file keeps, by name; it is whole, and nothing lies beside it."""
    assert [one.name for one in path.parent.iterdir()] == [path.name]
    return {one['name']: one['set'] for one in json.loads(path.read_text())['calibration']}


def test_what_was_found_on_another_device_is_not_used(recording, kept, tmp_path):
    # given a state file whose receiver had another frame
    path = tmp_path / 'state.json'
    devices = {'gnss': {'frame_id': 'another antenna', 'service': 0, 'rate': 2.0}}
    assert StateFile(path, 1.0, 1.0).write(HERE, [kept], SENSORS, devices) is None
    peer = Peer()
    part = recording.having({name: samples.select(samples.stamp < recording.imu.stamp[0] + 30 * SECOND)
                             for name, samples in recording.streams().items()})
    with NodeProcess('fusion_node', *PLAYABLE, '-p', 'diagnosis.online:=apply', '-p', f'state_file:={path}') as node:
        node.wait_for(f'{NAME} of an earlier drive: gnss.time_offset: {OFFSET}')
        node.wait_until_ready()
        peer.connect(node, part)
        peer.play(node, part)
        # then that is said, and the filter goes on without
        peer.spin_until(lambda: any('another device than before' in line and NAME in line for line in node.lines))
        assert any('the filter will use gnss.time_offset: 0.0' in line for line in node.lines)
        node.send(signal.SIGINT)
        assert node.wait() == 0
    peer.close()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_node_and_diagnosis_with_little_work_and_the_state_in_the_file(recording, kept, number, tmp_path):
    path, peer = tmp_path / 'state.json', Peer()
    assert StateFile(path, 1.0, 1.0).write(HERE, [kept], SENSORS) is None
    part = recording.having({name: samples.select(samples.stamp < recording.imu.stamp[0] + 62 * SECOND)
                             for name, samples in recording.streams().items()})
    # given a node that has driven for a minute, so that its diagnosis has something to do
    with NodeProcess('fusion_node', *PLAYABLE, '-p', 'diagnosis.online:=apply', '-p', f'state_file:={path}') as node:
        node.wait_until_ready()
        peer.connect(node, part)
        peer.play(node, part)
        child, = subprocess.run(['pgrep', '-P', str(node.pid)], capture_output=True, text=True).stdout.split()
        worker, = subprocess.run(['pgrep', '-P', child], capture_output=True, text=True).stdout.split()
        # the node counts the time of the other two where it has seen them end
        others, before = children_seconds(), sum(seconds_of(pid) for pid in (node.pid, child, worker))
        path.unlink()
        # when a signal comes
        node.send(number)
        assert node.wait() == 0
    # then its end takes so little of a core that a busy one has it, too,
    assert children_seconds() - others - before < 0.4
    # the state is in the file, and the processes of the diagnosis are gone
    assert of_file(path) == {NAME: {'gnss.time_offset': OFFSET}} and json.loads(path.read_text())['filter']
    peer.spin_until(lambda: not any(is_running(pid) for pid in (child, worker)))
    peer.close()


def children_seconds() -> float:
    """CPU time of the ended children of this process, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def seconds_of(pid) -> float:
    """CPU time of a process so far, s."""
    ticks = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf('SC_CLK_TCK')


def is_running(pid) -> bool:
    """Whether the process is there and has not ended."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_what_a_user_accepts_and_rejects_outlasts_a_kill_at_once(tmp_path):
    late, path, peer = drive(minutes=4.0), tmp_path / 'state.json', Peer()
    arguments = (*PLAYABLE, '-p', 'diagnosis.online:=apply', '-p', 'diagnosis.share:=1.0', '-p', f'state_file:={path}')
    begun = late.having({name: samples.select(samples.stamp < late.imu.stamp[0] + 62 * SECOND)
                         for name, samples in late.streams().items()})
    told = []  # by finding, what each message that is latched has of it

    def on_calibration(message):
        told.append({status.name.rpartition(': ')[2]: {pair.key: pair.value for pair in status.values}
                     for status in message.status})
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    peer.node.create_subscription(DiagnosticArray, '/fusion_node/calibration', on_calibration, latched)

    def asked(word):
        response = call(peer, Trigger, f'/fusion_node/calibration/{word}', Trigger.Request())
        assert response.success
        return response.message

    def used(node, text):
        """Go on with the drive until the node uses other parameters; the file then."""
        for i in range(len(begun.imu), len(late.imu)):
            peer.send_imu(late.imu, i)
            if line := node.says('the filter will use', 0.2):
                assert text in line
                peer.send_imu(late.imu, i)
                node.wait_for('does not follow')  # the file has been written by then
                return of_file(path)
        raise AssertionError('the node does not use it')

    # given a node that has something on trial, which is no part of the file
    with NodeProcess('fusion_node', *arguments) as node:
        node.wait_until_ready()
        peer.connect(node, begun)
        peer.play(node, begun)
        peer.spin_until(lambda: f'{NAME} COARSE' in asked('report'))
        assert not path.exists() or of_file(path) == {}
        # when a user accepts it, then it is used and in the file, before the node has had the time to write it anyway
        asked('accept')
        (name, sets), = used(node, 'gnss.time_offset: 0.').items()
        assert name == NAME and sets['gnss.time_offset'] == pytest.approx(OFFSET, abs=0.05)
        peer.spin_until(lambda: told[-1][NAME]['applied'] == 'True')
        node.send(signal.SIGKILL)
        node.wait()
    # so that the next start begins with it, SUSPECT
    with NodeProcess('fusion_node', *arguments) as node:
        node.wait_for(f'{NAME} of an earlier drive: gnss.time_offset: ')
        node.wait_until_ready()
        peer.connect(node, begun)
        peer.play(node, begun)
        peer.spin_until(lambda: f'{NAME} SUSPECT' in asked('report'))
        assert told[-1][NAME]['applied'] == 'True' and told[-1][NAME]['state'] == 'SUSPECT'
        # and what a user rejects is neither used nor in the file,
        asked('reject')
        assert used(node, 'gnss.time_offset: 0.0 ') == {}
        # and after a reset the latched message, too, has none
        asked('reset')
        peer.spin_until(lambda: told[-1] == {} and asked('report') == 'nothing known yet')
        node.send(signal.SIGKILL)
        node.wait()
    assert of_file(path) == {}
    peer.close()


def test_a_drive_in_which_a_finding_is_dropped_has_the_bits_of_its_replay(recording, kept, tmp_path):
    path = tmp_path / 'state.json'
    assert StateFile(path, 1.0, 1.0).write(HERE, [kept], SENSORS) is None
    arguments = (*PLAYABLE, '-p', 'diagnosis.online:=apply', '-p', f'state_file:={path}')
    peer = Peer()
    # given a node that drives with an offset of an earlier drive, and is killed after a minute
    first = recording.having({name: samples.select(samples.stamp < recording.imu.stamp[0] + 60 * SECOND)
                              for name, samples in recording.streams().items()})
    with NodeProcess('fusion_node', *arguments) as node:
        node.wait_until_ready()
        peer.connect(node, first)
        peer.play(node, first)
        node.send(signal.SIGKILL)
        node.wait()
    # then the next one begins with it again
    assert of_file(path) == {NAME: {'gnss.time_offset': OFFSET}}
    peer.close()
    peer = Peer()
    with NodeProcess('fusion_node', *arguments) as node:
        node.wait_for(f'{NAME} of an earlier drive: gnss.time_offset: {OFFSET}')
        node.wait_until_ready()
        peer.connect(node, recording)
        peer.play(node, recording)
        # which drops it where the receiver has become another one,
        assert any(f'{NAME} is no longer valid: dropped' in line for line in node.lines)
        degrees = {name: [math.radians(d) for d in np.degrees(getattr(recording.gnss, name)).tolist()]
                   for name in ('latitude', 'longitude')}
        same = replace(recording, reference=None, gnss=replace(recording.gnss, **{
            name: np.array(radians) for name, radians in degrees.items()}))
        values = table.check({'diagnosis.online': 'apply'})
        run = live_output(same, values, RecordingWatch(same, values, find=blind, look=blind, kept=[kept]))
        dropped, = run.dropped
        assert 120.0 < (dropped.stamp - recording.imu.stamp[0]) / SECOND < 180.0
        # bit for bit as a replay does,
        peer.spin_until(lambda: len(peer.odometry) == len(peer.fixes) == len(run.stamp))
        assert [stamp_of(message) for message in peer.odometry] == run.stamp.tolist()
        assert np.array_equal([flat(o, f)[:85] for o, f in zip(peer.odometry, peer.fixes)], run.odometry)
        # and has it out of the file before it is killed
        node.send(signal.SIGKILL)
        node.wait()
    peer.close()
    assert of_file(path) == {}
