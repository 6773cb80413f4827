"""The node takes odometry, air pressure and a magnetic field over real ROS 2; and says what is wrong with them."""
from __future__ import annotations

import math
from contextlib import contextmanager

import pytest
from nav_msgs.msg import Odometry
from ros_support import PLAYABLE, Diagnostics, NodeProcess, Player, hears

from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import SLOW
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

SENSORS = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)


@pytest.fixture(scope='module')
def car():
    """70 s at 50 Hz: a standstill, then a drive, with odometry and a barometer."""
    return simulate_recording(simulate_drive(70.0, seed=3, rate=50.0, standstill=6.0), SENSORS,
                              GnssNoise(sigma=0.5, rate=2.0), seed=3,
                              aiding=SimulatedAiding(twist_rate=20.0, pressure_rate=5.0)).recording


@pytest.fixture(scope='module')
def robot():
    """60 s at 50 Hz of a robot at 0.4 m/s, with a magnetometer."""
    return simulate_recording(simulate_drive(60.0, 8, 50.0, standstill=6.0, manoeuvres=SLOW), SENSORS,
                              GnssNoise(sigma=1.5, rate=2.0), seed=8,
                              aiding=SimulatedAiding(magnetometer_rate=5.0, magnetometer_disturbance=0.0)).recording


@contextmanager
def played(peer, recording, *inputs, options=(), change=None, until=1e9):
    """The node after it has heard `recording` with these inputs for `until` s, what its diagnostics say, and its latest
    odometry."""
    odometry = []
    subscription = peer.node.create_subscription(Odometry, '/odometry/fused', odometry.append, 10)
    with NodeProcess('fusion_node', *PLAYABLE, *hears(*inputs), *options) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, change)
        for name in inputs:
            player.connect(name)
        player.play(until)
        yield node, heard, odometry
    peer.node.destroy_subscription(subscription)


def in_other_units(name, i, message):
    if name == 'twist':
        message.twist.twist.linear.x *= 3.6
    elif name == 'pressure':
        message.fluid_pressure *= 0.01
    elif name == 'magnetometer':
        for axis in 'xyz':
            setattr(message.magnetic_field, axis, 1e6 * getattr(message.magnetic_field, axis))


def test_odometry_and_pressure_are_used_and_told_and_the_pose_of_the_odometry_is_not_taken(car, peer):
    with played(peer, car, 'twist', 'pressure') as (_, heard, odometry):
        # then all of it but that of the first metres has been used, though its pose is a thousand kilometres away
        heard.wait(lambda d: float(d.values('twist').get('used', 0)) > 500
                   and float(d.values('pressure').get('used', 0)) > 200)
        twist, pressure = heard.values('twist'), heard.values('pressure')
        assert 'nav_msgs/msg/Odometry' in twist['type']
        assert pressure['topic'] == '/pressure' and pressure['type'] == 'sensor_msgs/msg/FluidPressure'
        for name, values in (('twist', twist), ('pressure', pressure)):
            assert heard.level(name) == 0 and float(values['realised over claimed']) < 2.0
        assert not [key for key in twist if key.startswith('refused')]
        peer.spin_until(lambda: len(odometry) > 100)
    pose = odometry[-1].pose
    assert abs(pose.pose.position.x) < 2000.0
    # the receiver's heights scatter by 0.75 m
    assert abs(pose.pose.position.z) < 1.0 and 0.0 < pose.covariance[14] < 0.75**2


def test_kilometres_an_hour_and_hectopascals_are_named_with_the_factor(car, peer):
    with played(peer, car, 'twist', 'pressure', change=in_other_units) as (_, heard, _):
        heard.wait(lambda d: 'set twist.factor to 0.2' in d.message('twist')
                   and 'set pressure.factor to 100' in d.message('pressure'))
        assert heard.level('twist') == heard.level('pressure') == 2
        assert 'refused, its integral differs from the displacement between fixes' in heard.values('twist')


def test_a_slow_robot_starts_by_its_magnetometer_and_iron_is_told(robot, peer):
    # so slow it stands by its accelerometers
    moves = '-p', 'vehicle.zero_velocity:=false'
    with played(peer, robot, 'magnetometer', options=moves) as (node, heard, odometry):
        # then it has started by the field, and goes on with it
        assert any('aligned: heading from the magnetic field' in line for line in node.lines)
        heard.wait(lambda d: float(d.values('magnetometer').get('used', 0)) > 50)
        values = heard.values('magnetometer')
        assert values['type'] == 'sensor_msgs/msg/MagneticField' and heard.level('magnetometer') == 0
        assert float(heard.values('filter')['magnetometer_hard_x sigma']) < 0.5
        peer.spin_until(lambda: len(odometry) > 100)
    q, truth = odometry[-1].pose.pose.orientation, math.pi / 2 - robot.reference.yaw[-1]
    assert abs(math.remainder(2.0 * math.atan2(q.z, q.w) - truth, 2 * math.pi)) < 0.2


def test_microtesla_are_named_with_the_factor(robot, peer):
    with played(peer, robot, 'magnetometer', change=in_other_units, until=30.0) as (_, heard, _):
        heard.wait(lambda d: 'set magnetometer.factor to 1e-06' in d.message('magnetometer'))
        assert heard.level('magnetometer') == 2
