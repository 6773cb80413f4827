"""Measured recordings end to end: played over real ROS 2 to the real node, and replayed; both must agree."""
from __future__ import annotations

import math
import signal
from dataclasses import replace

import numpy as np
import pytest
from conftest import shared_data
from ros_support import PLAYABLE, NodeProcess, Peer

from mems_ins_fusion.evaluation.comparison import time_span
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording

CASES = {
    'incheon_square_ros2': ('/fix', [math.pi, 0.0, 0.0], 120.0),
    'longmont_rtk_drive': ('/gps/fix', [0.0, 0.0, math.pi], 55.0),
}


@pytest.mark.parametrize('name', CASES)
def test_the_node_gives_on_measured_messages_what_the_replay_gives(name):
    # given a measured recording, in the order in which it was recorded
    topic, mounting, duration = CASES[name]
    recording = time_span(read_recording(shared_data(name) / 'bag', '/imu/data', topic), 0.0, duration)
    gnss = recording.gnss.select(recording.gnss.received > recording.imu.received[0])
    gnss = replace(gnss, latitude=np.radians(np.degrees(gnss.latitude)),  # as a message in degrees carries it
                   longitude=np.radians(np.degrees(gnss.longitude)))
    recording = replace(recording, gnss=gnss)
    values = table.check({'imu.mounting_rpy': mounting})
    replay = run(FilterConfig.from_parameters(values), recording.imu, gnss)
    assert len(replay.stamp) > 0.1 * len(recording.imu)
    # when it is played to the node
    peer = Peer()
    with NodeProcess('fusion_node', *PLAYABLE, '-p', f'imu.mounting_rpy:={mounting}') as node:
        node.wait_until_ready()
        peer.connect(node, recording)
        peer.play(node, recording)
        peer.spin_until(lambda: peer.fixes and _stamp(peer.fixes[-1]) == recording.imu.stamp[-1])
        node.send(signal.SIGINT)
        assert node.wait() == 0
    peer.close()
    # then each position received since the heading is known is the replay's, to the last bit; the replay also holds the
    # few samples between the time of the fix that starts the filter and its arrival
    stamp = np.array([_stamp(m) for m in peer.fixes])
    headed = stamp > replay.stamp[0] + 500_000_000
    stamp = stamp[headed]
    at = np.searchsorted(replay.stamp, stamp)
    assert np.array_equal(replay.stamp[at], stamp)
    assert len(replay.stamp) - len(stamp) <= 1.0 / np.median(np.diff(recording.imu.stamp) * 1e-9)
    received = np.array([(m.latitude, m.longitude, m.altitude) for m in peer.fixes])[headed]
    expected = np.column_stack([np.degrees(replay.latitude), np.degrees(replay.longitude), replay.height])[at]
    assert np.array_equal(received, expected)


def _stamp(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
