"""The node takes the odometry of others over real ROS 2: its twist and never its pose; and says what is wrong."""
from __future__ import annotations

import pytest
from ros_support import PLAYABLE, Diagnostics, NodeProcess, Player, hears

from mems_ins_fusion.simulation.simulation import Aiding, GnssNoise, SensorErrors, simulate_drive, simulate_recording

SENSORS = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)


@pytest.fixture(scope='module')
def recording():
    """70 s at 50 Hz: a standstill, then a drive, with odometry."""
    return simulate_recording(simulate_drive(70.0, seed=3, rate=50.0, standstill=6.0), SENSORS,
                              GnssNoise(sigma=0.5, rate=2.0), seed=3, aiding=Aiding(twist_rate=20.0)).recording


def test_odometry_is_used_and_told_and_its_pose_is_not_taken(recording, peer):
    with NodeProcess('fusion_node', *PLAYABLE, *hears('twist')) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        player.connect('twist')
        player.play()
        # then all of it but that of the first metres has been used, though its pose is a thousand kilometres away
        heard.wait(lambda d: float(d.values('twist').get('used', 0)) > 500)
        values = heard.values('twist')
        assert 'nav_msgs/msg/Odometry' in values['type']
        assert heard.level('twist') == 0 and float(values['realised over claimed']) < 2.0
        assert not [key for key in values if key.startswith('refused')]
        peer.spin_until(lambda: len(peer.odometry) > 100)
    assert abs(peer.odometry[-1].pose.pose.position.x) < 2000.0


def test_kilometres_an_hour_are_refused_and_named_with_the_factor(recording, peer):
    def in_kilometres_an_hour(name, i, message):
        if name == 'twist':
            message.twist.twist.linear.x *= 3.6
    with NodeProcess('fusion_node', *PLAYABLE, *hears('twist')) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, in_kilometres_an_hour)
        player.connect('twist')
        player.play()
        heard.wait(lambda d: 'set twist.factor to 0.2' in d.message('twist'))
        assert heard.level('twist') == 2
        assert 'refused, not the way between the fixes' in heard.values('twist')
