"""The node with two IMUs over real ROS 2: one of them is killed in the drive, and it goes on."""
from __future__ import annotations

import numpy as np
import pytest
from rclpy.qos import QoSProfile
from ros_support import DEPTH, PLAYABLE, Diagnostics, NodeProcess, Player, imu_of, stamp_of
from sensor_msgs.msg import Imu

from mems_ins_fusion.filter.measurements.registry import imus
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

SENSORS = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
GIVEN = {'inputs': ['second'], 'second.type': 'imu', 'second.topic': '/second', 'second.mounting_rpy': [0.0, 0.0, 1.5]}
DEAD = 45.0  # s: the first IMU stops


@pytest.fixture(scope='module')
def recording():
    """80 s at 50 Hz with a second IMU of 100 Hz, which lies with its x axis to the left; turns in the first half."""
    return simulate_recording(simulate_drive(80.0, seed=5, rate=50.0, standstill=6.0), SENSORS, GnssNoise(0.5, 2.0),
                              seed=5, named=imus(table.check(GIVEN))).recording


def test_odometry_goes_on_where_the_first_imu_is_killed(recording, peer):
    text = [part for name, value in GIVEN.items() for part in ('-p', f'{name}:={value}'.replace("'", ''))]
    with NodeProcess('fusion_node', *PLAYABLE, *text, '-p', 'qos_overrides./second.subscription.reliability:=reliable',
                     '-p', f'qos_overrides./second.subscription.depth:={DEPTH}') as node:
        node.wait_until_ready()
        second, fixes = recording.others['second'], recording.gnss
        publisher = peer.node.create_publisher(Imu, '/second', QoSProfile(depth=DEPTH))
        sent = 0

        def send_second(until):
            nonlocal sent
            while second.stamp[sent] < until:
                publisher.publish(imu_of(second, sent))
                sent += 1

        def with_second(name, i, message):
            send_second(stamp_of(message))

        heard, player = Diagnostics(peer), Player(peer, node, recording, with_second)
        player.STEP = 0.1  # topics of a burst come one after the other, which is no silence
        player.connect()
        peer.spin_until(publisher.get_subscription_count)
        # given both, well and averaged
        player.play(DEAD)
        assert any('/second: averaged with /imu/data from now on' in line for line in node.lines)
        # when the first one is silent from then on, while the second one and the fixes come
        fix = int(np.searchsorted(fixes.stamp, player.begin + DEAD * 1e9))
        for until in np.arange(DEAD + 0.5, 79.0, 0.5):
            send_second(player.begin + until * 1e9)
            last = second.stamp[sent - 1]
            peer.spin_until(lambda last=last: peer.odometry and stamp_of(peer.odometry[-1]) == last)
            while fix < len(fixes) and fixes.stamp[fix] < player.begin + until * 1e9:
                peer.send_fix(fixes, fix)
                fix += 1
        # then it says so, in the log and on /diagnostics
        said = node.wait_for('/imu/data: no sample for 0.')
        assert '/second are used from now on' in said
        heard.wait(lambda d: d.level('imu') > 0 and 'the samples are those of /second' in d.message('filter')
                   and not d.message('filter').startswith('silent'))
    # and odometry has gone on at the second one's rate, near the truth to the end
    stamps = np.array([stamp_of(message) for message in peer.odometry])
    assert (np.diff(stamps) > 0).all() and np.diff(stamps).max() <= 21_000_000
    fused = peer.fixes[-1]
    reference = recording.reference
    at = int(np.searchsorted(reference.stamp, stamp_of(fused)))
    north, east, _ = to_local(np.radians(fused.latitude), np.radians(fused.longitude), fused.altitude,
                              (reference.latitude[at], reference.longitude[at], reference.height[at]))
    assert np.hypot(north, east) < 1.5
