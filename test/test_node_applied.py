"""What has been found while driving and drives, over real ROS 2: the bits of a replay, and nothing lost by kill -9."""
from __future__ import annotations

import json
import math
import signal
from dataclasses import replace

import numpy as np
import pytest
from ros_support import PLAYABLE, NodeProcess, Peer, stamp_of
from test_applying import HERE, NAME, drive
from test_fusion_node import flat
from test_online import OFFSET, SECOND, blind, finding

from mems_ins_fusion.diagnosis.applying import driven
from mems_ins_fusion.diagnosis.quantity import Kept
from mems_ins_fusion.diagnosis.watch import Watch
from mems_ins_fusion.nodes.state_file import StateFile
from mems_ins_fusion.parameters import table

SENSORS = {'imu_topic': '/imu/data', 'gnss_topic': '/gps/fix'}


@pytest.fixture(scope='module')
def recording():
    """Four minutes, in which fixes are stamped late until the middle."""
    return drive(end=0.5, minutes=4.0)


@pytest.fixture
def kept(recording):
    return Kept(NAME, finding().parameters, {'gnss.time_offset': OFFSET}, int(recording.imu.stamp[0]) - SECOND)


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
        run = driven(same, values, Watch(same, values, find=blind, look=blind, kept=[kept]))
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
