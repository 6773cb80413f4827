"""The node hears inputs with a name over real ROS 2, and has a status for each."""
from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistWithCovarianceStamped
from rclpy.qos import QoSProfile
from ros_support import DEPTH, PLAYABLE, Diagnostics, NodeProcess, Player, fix_of
from sensor_msgs.msg import NavSatFix

from mems_ins_fusion.filter.measurements.registry import aiding
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_drive,
    simulate_recording,
)

SENSORS = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
GIVEN = {'inputs': ['rear', 'left', 'lidar'],
         'rear.type': 'fix', 'rear.topic': '/rear/fix', 'rear.lever_arm': [-1.0, 0.0, 1.0],
         'left.type': 'speed', 'left.topic': '/left', 'lidar.type': 'pose', 'lidar.topic': '/lidar/pose'}


@pytest.fixture(scope='module')
def recording():
    """60 s at 50 Hz: a standstill, then a drive, with a second receiver, one wheel and the poses of a lidar."""
    named = [one for one in aiding(table.check(GIVEN)) if not one.is_plain]
    return simulate_recording(simulate_drive(60.0, seed=3, rate=50.0, standstill=6.0), SENSORS, GnssNoise(0.5, 2.0),
                              seed=3, aiding=SimulatedAiding(fix_rate=2.0, fix_sigma=0.5), named=named).recording


def test_each_named_input_is_used_and_has_its_own_status(recording, peer):
    text = [part for name, value in GIVEN.items() for part in ('-p', f'{name}:={value}'.replace("'", ''))]
    reliable = [part for topic in ('/rear/fix', '/left', '/lidar/pose') for part in (
        '-p', f'qos_overrides.{topic}.subscription.reliability:=reliable')]
    with NodeProcess('fusion_node', *PLAYABLE, *text, *reliable) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        rear, left, lidar = (recording.others[name] for name in GIVEN['inputs'])
        publishers = [peer.node.create_publisher(kind, topic, QoSProfile(depth=DEPTH))
                      for kind, topic in ((NavSatFix, '/rear/fix'), (TwistWithCovarianceStamped, '/left'),
                                        (PoseStamped, '/lidar/pose'))]
        player.connect()
        for publisher in publishers:
            peer.spin_until(publisher.get_subscription_count)
        player.play(8.0)
        i, j, k = (int(np.searchsorted(stamp, recording.imu.stamp[0] + 8 * 10**9))
                   for stamp in (rear.stamp, left.stamp, lidar.later))
        for second in np.arange(8.5, 50.0, 0.5):  # what is of a time follows the samples of it
            player.play(second)
            until = recording.imu.stamp[0] + round(second * 10**9)
            while rear.stamp[i] < until:
                publishers[0].publish(stamped(fix_of(rear, i), rear.stamp[i]))
                i += 1
            while left.stamp[j] < until:
                message = stamped(TwistWithCovarianceStamped(), left.stamp[j])
                # a wheel that has lost its sensor from the 30th second on
                message.twist.twist.linear.x = float(left.speed[j]) if second < 30 else float('nan')
                message.twist.covariance[0] = float(left.variance[j])
                publishers[1].publish(message)
                j += 1
            while lidar.later[k] < until:
                message = stamped(PoseStamped(), lidar.later[k])
                for part, numbers in ((message.pose.position, lidar.position[k]),
                                      (message.pose.orientation, lidar.orientation[k])):
                    for axis, number in zip('xyzw', numbers):
                        setattr(part, axis, float(number))
                publishers[2].publish(message)
                k += 1
        # then the second receiver is well, with its own numbers, while the wheel says why it is not
        heard.wait(lambda d: d.level('rear') == 0 and d.level('left') > 0
                   and 'speed nan m/s: dropped' in d.message('left'))
        assert heard.values('rear')['topic'] == '/rear/fix'
        assert float(heard.values('rear')['realised over claimed']) < 2.5
        assert 'delay, s' in heard.values('rear') and 'rate, Hz' in heard.values('rear')
        assert float(heard.values('left')['used']) > 50
        # and of the poses what lies between them is used, all but the first one
        assert heard.level('lidar') == 0 and 'geometry_msgs/msg/PoseStamped' in heard.values('lidar')['type']
        assert int(heard.values('lidar')['used']) > 300 and float(heard.values('lidar')['realised over claimed']) < 2.5


def stamped(message, stamp):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(stamp), 10**9)
    return message
