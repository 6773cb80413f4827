"""What is wrong with what comes in is said, in the log and on /diagnostics, by the real node over real ROS 2."""
from __future__ import annotations

import math

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import QoSProfile
from ros_support import PLAYABLE, Diagnostics, NodeProcess, Peer, call, fix_message
from sensor_msgs.msg import Imu, NavSatFix
from std_srvs.srv import Trigger

from mems_ins_fusion.nodes.inputs import stamp_of
from mems_ins_fusion.simulation.simulation import Aiding, GnssNoise, SensorErrors, simulate_drive, simulate_recording

SECOND = 10**9  # ns


@pytest.fixture(scope='module')
def recording():
    """60 s at 50 Hz: a standstill, then a drive, with wheel speed and heading."""
    sensors = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    return simulate_recording(simulate_drive(60.0, seed=3, rate=50.0, standstill=6.0), sensors,
                              GnssNoise(sigma=0.5, rate=2.0), seed=3,
                              aiding=Aiding(speed_rate=10.0, heading_rate=5.0, speed_scale=0.0)).recording


@pytest.fixture
def peer():
    peer = Peer()
    yield peer
    peer.close()


class Player:
    """Publishes a recording in the order of its stamps, all but /imu/data from reliable queues."""

    def __init__(self, peer, node, recording, change=None, fix=None):
        """change: name and function of a stamp and a message, which it may change. fix: of index and message."""
        self.peer, self.node, self.recording, self.change, self.fix = peer, node, recording, change, fix
        qos = QoSProfile(depth=20000)
        self.speed = peer.node.create_publisher(TwistWithCovarianceStamped, '/wheel/speed', qos)
        self.heading = peer.node.create_publisher(Imu, '/compass', qos)

    def play(self, begin=0.0, end=1e9):
        """From `begin` to `end`, s; a measurement waits until the node has seen the samples of before it."""
        imu, origin = self.recording.imu, int(self.recording.imu.stamp[0])
        parts = {'imu': imu, 'fix': self.recording.gnss, 'speed': self.recording.speed,
                 'heading': self.recording.heading}
        rows = sorted((int(stamp), order, name, i) for order, (name, part) in enumerate(parts.items())
                      for i, stamp in enumerate(part.stamp) if begin <= (stamp - origin) * 1e-9 < end)
        last = None
        for _, _, name, i in rows:
            if name == 'imu':
                self.peer.send_imu(imu, i)
                last = i
            elif name == 'fix':
                if last is not None:
                    self.peer.send_imu(imu, last)
                    self.node.wait_for(f'header.stamp {imu.stamp[last] * 1e-9:.6f} s does not follow')
                    self.peer.spin_some(0.01)
                message = fix_message(*(getattr(self.recording.gnss, column)[i] for column in (
                    'stamp', 'latitude', 'longitude', 'height', 'covariance', 'status', 'covariance_type')))
                if self.fix:
                    self.fix(i, message)
                self.peer.gnss.publish(message)
            else:
                self._send(name, i)

    def _send(self, name, i):
        if name == 'speed':
            message, publisher, part = TwistWithCovarianceStamped(), self.speed, self.recording.speed
            message.twist.twist.linear.x = float(part.speed[i])
            message.twist.covariance[0] = float(part.variance[i])
        else:
            message, publisher, part = Imu(), self.heading, self.recording.heading
            yaw = math.pi / 2 - float(part.yaw[i])
            message.orientation.z, message.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
            message.orientation_covariance[8] = float(part.variance[i])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(part.stamp[i]), SECOND)
        if self.change and self.change[0] == name:
            self.change[1](message)
        publisher.publish(message)


def in_kilometres_an_hour(message):
    message.twist.twist.linear.x *= 3.6
    message.twist.covariance[0] *= 3.6**2


def in_reverse(message):
    message.twist.twist.linear.x *= -1.0


def a_hundredth(message):
    message.twist.twist.linear.x *= 0.01


@pytest.mark.parametrize('change, factor', [(in_kilometres_an_hour, 1 / 3.6), (in_reverse, -1.0), (a_hundredth, 100.0)])
def test_a_wheel_speed_that_fits_a_factor_is_named_with_the_parameter(recording, peer, change, factor):
    with NodeProcess('fusion_node', *PLAYABLE, '-p', 'speed_topic:=/wheel/speed') as node:
        node.wait_until_ready()
        heard = Diagnostics(peer)
        player = Player(peer, node, recording, ('speed', change))
        peer.connect(node, recording)
        peer.spin_until(player.speed.get_subscription_count)
        player.play(0.02, 50.0)
        heard.wait(lambda d: 'speed.factor' in d.message('speed'))
        assert heard.level('speed') == 2 or change is a_hundredth and heard.level('speed') >= 1
        told = float(heard.message('speed').split('set speed.factor to ')[1].split(';')[0])
        assert told == pytest.approx(factor, rel=0.1)
        assert any('/wheel/speed: the speed is' in line and 'speed.factor' in line for line in node.lines) or (
            node.wait_for('speed.factor'))


def test_the_factor_makes_it_right(recording, peer):
    given = '-p', 'speed_topic:=/wheel/speed', '-p', 'speed.factor:=0.27778'
    with NodeProcess('fusion_node', *PLAYABLE, *given) as node:
        node.wait_until_ready()
        heard = Diagnostics(peer)
        player = Player(peer, node, recording, ('speed', in_kilometres_an_hour))
        peer.connect(node, recording)
        peer.spin_until(player.speed.get_subscription_count)
        player.play(0.02, 40.0)
        heard.wait(lambda d: int(d.values('speed').get('used', 0)) > 150)
        assert heard.level('speed') == 0 and heard.values('filter')['state'] == 'fusing', heard.message('filter')
        assert not any(key.startswith('refused') for key in heard.values('speed'))


def test_a_clock_that_is_set_back_by_60_ms_changes_nothing(recording, peer):
    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        heard = Diagnostics(peer)
        player = Player(peer, node, recording)
        peer.connect(node, recording)
        player.play(0.02, 30.0)
        heard.wait(lambda d: d.values('filter').get('state') == 'fusing')
        biases = {key: value for key, value in heard.values('filter').items() if key.startswith('f_')}
        last = max(map(stamp_of, peer.odometry))
        # when the stamps are 60 ms less from then on
        object.__setattr__(recording.imu, 'stamp', recording.imu.stamp - 60_000_000)
        try:
            player.play(30.0 - 0.06, 34.0)
        finally:
            object.__setattr__(recording.imu, 'stamp', recording.imu.stamp + 60_000_000)
        peer.spin_until(lambda: stamp_of(peer.odometry[-1]) > last + 3 * SECOND)
        # then no stamp goes back, and it fuses on with what it had learned
        stamps = [stamp_of(message) for message in peer.odometry]
        assert all(b > a for a, b in zip(stamps, stamps[1:]))
        heard.wait(lambda d: True)
        assert heard.values('filter')['state'] == 'fusing' and biases
        assert not any('aligns anew' in line for line in node.lines)


def test_a_wrong_first_fix_does_not_make_the_datum_and_refused_ones_are_shown(recording, peer):
    shown, points = [], []
    subscriptions = [peer.node.create_subscription(NavSatFix, '/fusion_node/refused_fixes', shown.append, 50),
                     peer.node.create_subscription(PointStamped, '/fusion_node/refused_points', points.append, 50)]

    def far(i, message):
        if i in (0, 60):  # 300 m east
            message.longitude += 300.0 / 111e3 / math.cos(math.radians(message.latitude))

    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        heard = Diagnostics(peer)
        player = Player(peer, node, recording, fix=far)
        peer.connect(node, recording)
        player.play(0.02, 40.0)
        heard.wait(lambda d: 'datum' in d.values('filter') and int(d.values('fix').get('used', 0)) > 30)
        latitude, longitude, _ = (float(part) for part in heard.values('filter')['datum'].split(','))
        # then the datum is where the vehicle was
        assert abs(latitude - math.degrees(recording.gnss.latitude[1])) < 3e-5
        assert abs(longitude - math.degrees(recording.gnss.longitude[1])) < 5e-5
        # and the one that came later is refused, and there for maps and views
        peer.spin_until(lambda: shown and points)
        stamps = [stamp_of(message) for message in shown]
        assert stamps == [int(recording.gnss.stamp[60])]
        assert points[0].header.frame_id == 'odom' and math.hypot(points[0].point.x, points[0].point.y) > 100.0
        # when the datum is put where the vehicle is
        answer = call(peer, Trigger, '/fusion_node/set_datum', Trigger.Request())
        assert answer.success
        del peer.odometry[:]
        player.play(40.0, 41.0)
        later = recording.imu.stamp[0] + 40 * SECOND  # what was published before may still be on its way
        peer.spin_until(lambda: any(stamp_of(message) > later for message in peer.odometry))
        place = next(message for message in peer.odometry if stamp_of(message) > later).pose.pose.position
        assert math.hypot(place.x, place.y) < 2.0
        # or at a place that a parameter names
        place = [48.0, 11.0, 500.0]
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=place)
        request = SetParameters.Request(parameters=[Parameter(name='datum', value=value)])
        assert call(peer, SetParameters, '/fusion_node/set_parameters', request).results[0].successful
        heard.wait(lambda d: d.values('filter')['datum'].startswith('48.00000000, 11.00000000'))
        request.parameters[0].value.double_array_value = [148.0, 11.0, 500.0]
        refused = call(peer, SetParameters, '/fusion_node/set_parameters', request).results[0]
        assert not refused.successful and 'datum' in refused.reason
    for subscription in subscriptions:
        peer.node.destroy_subscription(subscription)


def test_two_d_and_the_axes_of_the_vehicle(peer):
    # given a drive with RTK, and an IMU that is turned by 3 deg, which no parameter tells
    turned = simulate_recording(
        simulate_drive(140.0, seed=5, rate=50.0, standstill=8.0),
        SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3),
        GnssNoise(sigma=0.03, rate=1.0), seed=5, mounting_rpy=[0.0, 0.0, math.radians(3.0)],
        aiding=Aiding(speed_rate=1.0, heading_rate=1.0)).recording
    given = '-p', 'two_d:=true', '-p', 'vehicle_axes:=true', '-p', 'odometry_rate:=10.0'
    with NodeProcess('fusion_node', *PLAYABLE, *given) as node:
        node.wait_until_ready()
        heard = Diagnostics(peer)
        player = Player(peer, node, turned)
        peer.connect(node, turned)
        player.play(0.02)
        peer.spin_until(lambda: stamp_of(peer.odometry[-1]) > turned.imu.stamp[-1] - SECOND)
        # then the pose is one in the plane,
        last: Odometry = peer.odometry[-1]
        pose, twist = last.pose.pose, last.twist.twist
        assert pose.position.z == pose.orientation.x == pose.orientation.y == 0.0
        assert twist.linear.z == twist.angular.x == twist.angular.y == 0.0
        assert np.linalg.eigvalsh(last.pose.covariance.reshape(6, 6)).min() > 0.0
        # its axes are the vehicle's: no speed sideways, the yaw of the truth
        fast = [m for m in peer.odometry[-500:] if m.twist.twist.linear.x > 5.0]
        assert len(fast) > 100
        assert abs(np.mean([m.twist.twist.linear.y / m.twist.twist.linear.x for m in fast])) < 0.01
        truth = dict(zip(turned.reference.stamp.tolist(), turned.reference.yaw.tolist()))
        errors = [math.pi / 2 - 2 * math.atan2(m.pose.pose.orientation.z, m.pose.pose.orientation.w)
                  - truth[stamp_of(m)] for m in fast]
        assert abs(np.mean([math.remainder(error, 2 * math.pi) for error in errors])) < math.radians(0.7)
        # and how far the parameter is off is said once, with the line to set, and the sigma of the vehicle's heading
        said = [line for line in node.lines if 'set imu.mounting_rpy: [' in line]
        assert len(said) == 1 and '/imu/data: the vehicle points 3.' in said[0] or '2.' in said[0]
        yaw = float(said[0].split('imu.mounting_rpy: [')[1].split(']')[0].split(',')[2])
        assert yaw == pytest.approx(math.radians(3.0), abs=math.radians(0.7))
        heard.wait(lambda d: 'heading sigma of the vehicle, deg' in d.values('filter'))
        assert 0.0 < float(heard.values('filter')['heading sigma of the vehicle, deg']) < 1.0


def test_a_start_in_motion_makes_no_noise_on_stderr(recording, peer):
    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        peer.connect(node, recording)
        Player(peer, node, recording).play(12.0, 50.0)
        Diagnostics(peer).wait(lambda d: d.values('filter').get('mounting', '').startswith('nothing'))
    node.wait()
    assert not any('DLASCL' in line or 'Traceback' in line for line in node.lines)


def test_what_repeats_is_said_ever_more_seldom(recording, peer):
    with NodeProcess('fusion_node', *PLAYABLE, '-p', 'imu.mounting_rpy:=[0.0, 3.14159, 0.0]') as node:
        node.wait_until_ready()
        peer.connect(node, recording)
        Player(peer, node, recording).play(0.02, 40.0)  # 80 fixes, each with something to say
        peer.spin_some(1.5)
    node.wait()
    assert sum('waiting for' in line and 'DEBUG' not in line for line in node.lines) < 15
