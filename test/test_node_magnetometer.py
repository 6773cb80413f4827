"""The node starts a slow robot by its magnetometer over real ROS 2."""
from __future__ import annotations

import math

import pytest
from nav_msgs.msg import Odometry
from ros_support import PLAYABLE, Diagnostics, NodeProcess, Player, hears

from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import SLOW
from mems_ins_fusion.simulation.simulation import Aiding, GnssNoise, SensorErrors, simulate_recording

SENSORS = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)


@pytest.fixture(scope='module')
def recording():
    """60 s at 50 Hz of a robot at 0.4 m/s."""
    return simulate_recording(simulate_drive(60.0, 8, 50.0, standstill=6.0, manoeuvres=SLOW), SENSORS,
                              GnssNoise(sigma=1.5, rate=2.0), seed=8,
                              aiding=Aiding(magnetometer_rate=5.0, magnetometer_disturbance=0.0)).recording


def test_a_slow_robot_starts_by_it_and_iron_is_told(recording, peer):
    odometry = []
    subscription = peer.node.create_subscription(Odometry, '/odometry/fused', odometry.append, 10)
    # so slow it stands by its accelerometers
    moves = '-p', 'vehicle.zero_velocity:=false'
    with NodeProcess('fusion_node', *PLAYABLE, *hears('magnetometer'), *moves) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        player.connect('magnetometer')
        player.play()
        # then it has started by the field, and goes on with it
        assert any('aligned: heading from the magnetic field' in line for line in node.lines)
        heard.wait(lambda d: float(d.values('magnetometer').get('used', 0)) > 50)
        values = heard.values('magnetometer')
        assert values['type'] == 'sensor_msgs/msg/MagneticField' and heard.level('magnetometer') == 0
        assert float(heard.values('filter')['magnetometer_hard_x sigma']) < 0.5
        peer.spin_until(lambda: len(odometry) > 100)
    peer.node.destroy_subscription(subscription)
    q, truth = odometry[-1].pose.pose.orientation, math.pi / 2 - recording.reference.yaw[-1]
    assert abs(math.remainder(2.0 * math.atan2(q.z, q.w) - truth, 2 * math.pi)) < 0.2


def test_microtesla_are_named_with_the_factor(recording, peer):
    def in_microtesla(name, i, message):
        if name == 'magnetometer':
            for axis in 'xyz':
                setattr(message.magnetic_field, axis, 1e6 * getattr(message.magnetic_field, axis))
    with NodeProcess('fusion_node', *PLAYABLE, *hears('magnetometer')) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, in_microtesla)
        player.connect('magnetometer')
        player.play(30.0)
        heard.wait(lambda d: 'set magnetometer.factor to 1e-06' in d.message('magnetometer'))
        assert heard.level('magnetometer') == 2
