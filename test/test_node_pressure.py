"""The node takes the pressure of the air over real ROS 2, and says of it what it says of every input."""
from __future__ import annotations

import pytest
from nav_msgs.msg import Odometry
from ros_support import PLAYABLE, Diagnostics, NodeProcess, Player, hears

from mems_ins_fusion.simulation.simulation import Aiding, GnssNoise, SensorErrors, simulate_drive, simulate_recording

SENSORS = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)


@pytest.fixture(scope='module')
def recording():
    """60 s at 50 Hz: a standstill, then a drive, with a barometer."""
    return simulate_recording(simulate_drive(60.0, seed=3, rate=50.0, standstill=6.0), SENSORS,
                              GnssNoise(sigma=0.5, rate=2.0), seed=3, aiding=Aiding(pressure_rate=5.0)).recording


def test_pressure_is_used_and_told(recording, peer):
    odometry = []
    subscription = peer.node.create_subscription(Odometry, '/odometry/fused', odometry.append, 10)
    with NodeProcess('fusion_node', *PLAYABLE, *hears('pressure')) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        player.connect('pressure')
        player.play()
        # then all of it has been used, and the bias is told with its sigma
        heard.wait(lambda d: float(d.values('pressure').get('used', 0)) > 200)
        values = heard.values('pressure')
        assert values['topic'] == '/pressure' and values['type'] == 'sensor_msgs/msg/FluidPressure'
        assert heard.level('pressure') == 0 and float(values['realised over claimed']) < 2.0
        peer.spin_until(lambda: len(odometry) > 100)
    peer.node.destroy_subscription(subscription)
    # the receiver's heights scatter by 0.75 m
    assert abs(odometry[-1].pose.pose.position.z) < 1.0
    assert 0.0 < odometry[-1].pose.covariance[14] < 0.75**2


def test_hectopascals_are_named_with_the_factor(recording, peer):
    def in_hectopascals(name, i, message):
        if name == 'pressure':
            message.fluid_pressure *= 0.01
    with NodeProcess('fusion_node', *PLAYABLE, *hears('pressure')) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, in_hectopascals)
        player.connect('pressure')
        player.play(50.0)
        heard.wait(lambda d: 'set pressure.factor to 100' in d.message('pressure'))
        assert heard.level('pressure') == 2
