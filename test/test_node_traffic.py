"""All that a vehicle's topics carry at once, over real ROS 2: nothing is lost, services answer, silence is told."""
from __future__ import annotations

import signal
import time

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_support import PLAYABLE, Diagnostics, NodeProcess, Peer, call, fix_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import NavSatFix
from std_srvs.srv import Trigger

from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import (
    Aiding,
    GnssNoise,
    SensorErrors,
    simulate_drive,
    simulate_recording,
)

SECOND = 10**9  # ns
#: on /diagnostics, of an input
LATE = {'refused, too late', 'refused, stamped ahead of the IMU'}
AIDING = ('-p', 'speed_topic:=/wheel/speed', '-p', 'velocity_topic:=/gps/velocity', '-p', 'heading_topic:=/gps/heading')
#: queues that hold all of a drive: what is lost is not the machine's fault
DEEP = tuple(part for topic in ('/wheel/speed', '/gps/velocity', '/gps/heading') for part in (
    '-p', f'qos_overrides.{topic}.subscription.reliability:=reliable',
    '-p', f'qos_overrides.{topic}.subscription.depth:=20000'))


@pytest.fixture(scope='module')
def recording():
    """16 s with all sensors that there can be: a standstill, then a drive."""
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(simulate_drive(16.0, seed=3, rate=400.0, standstill=6.0), sensors,
                              GnssNoise(sigma=0.5, rate=5.0), seed=3,
                              aiding=Aiding(speed_rate=100.0, velocity_rate=50.0, heading_rate=50.0)).recording


@pytest.fixture
def peer():
    peer = Peer()
    yield peer
    peer.close()


class Drive:
    """A recording that is published in the order of its stamps, with /clock each millisecond of its time."""

    def __init__(self, peer, recording):
        qos = QoSProfile(depth=20000)
        self.peer, self.recording, self.next = peer, recording, 0
        self.clock = peer.node.create_publisher(Clock, '/clock', 10)
        self.speed = peer.node.create_publisher(TwistWithCovarianceStamped, '/wheel/speed', qos)
        self.velocity = peer.node.create_publisher(TwistWithCovarianceStamped, '/gps/velocity', qos)
        self.heading = peer.node.create_publisher(PoseWithCovarianceStamped, '/gps/heading', qos)
        parts = {self.send_imu: recording.imu, self.send_fix: recording.gnss, self.send_speed: recording.speed,
                 self.send_velocity: recording.velocity, self.send_heading: recording.heading}
        stamps = np.arange(recording.imu.stamp[0], recording.imu.stamp[-1], SECOND // 1000)
        rows = [(int(stamp), 0, self.send_clock, int(stamp)) for stamp in stamps]
        rows += [(int(stamp), 1, send, i) for send, part in parts.items() for i, stamp in enumerate(part.stamp)]
        self.rows = sorted(rows, key=lambda row: row[:2])

    def play(self, seconds: float) -> None:
        """The next `seconds` of it, as fast as can be."""
        until = self.rows[self.next][0] + round(seconds * SECOND)
        while self.next < len(self.rows) and self.rows[self.next][0] < until:
            self.rows[self.next][2](self.rows[self.next][3])
            self.next += 1

    @property
    def done(self) -> bool:
        return self.next == len(self.rows)

    def send_clock(self, stamp):
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(stamp, SECOND)
        self.clock.publish(message)

    def send_imu(self, i):
        self.peer.send_imu(self.recording.imu, i)

    def send_fix(self, i):
        self.peer.send_fix(self.recording.gnss, i)

    def send_speed(self, i):
        message = TwistWithCovarianceStamped()
        message.twist.twist.linear.x = float(self.recording.speed.speed[i])
        message.twist.covariance[0] = float(self.recording.speed.variance[i])
        self._send(self.speed, message, self.recording.speed.stamp[i])

    def send_velocity(self, i):
        north, east, down = self.recording.velocity.velocity[i].tolist()
        message = TwistWithCovarianceStamped()
        message.twist.twist.linear.x, message.twist.twist.linear.y, message.twist.twist.linear.z = east, north, -down
        message.twist.covariance[[0, 7, 14]] = 0.01
        self._send(self.velocity, message, self.recording.velocity.stamp[i])

    def send_heading(self, i):
        yaw = np.pi / 2 - float(self.recording.heading.yaw[i])
        message = PoseWithCovarianceStamped()
        q = message.pose.pose.orientation
        q.z, q.w = float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
        message.pose.covariance[35] = float(self.recording.heading.variance[i])
        self._send(self.heading, message, self.recording.heading.stamp[i])

    @staticmethod
    def _send(publisher, message, stamp):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(stamp), SECOND)
        publisher.publish(message)


def test_everything_arrives_and_services_answer_while_a_clock_of_a_thousand_hertz_ticks(recording, peer):
    # given a node in the time of a recording with an IMU of 400 Hz, 100 Hz of wheel speed, 50 Hz of the others
    with NodeProcess('fusion_node', *PLAYABLE, *DEEP, *AIDING, '-p', 'use_sim_time:=true') as node:
        node.wait_until_ready()
        drive, heard = Drive(peer, recording), Diagnostics(peer)
        peer.connect(node, recording)
        for publisher in (drive.speed, drive.velocity, drive.heading):
            peer.spin_until(publisher.get_subscription_count)
        # when it is played, services and parameters are asked for in the middle of it
        answers = 0
        while not drive.done:
            drive.play(1.0)
            answers += call(peer, GetParameters, '/fusion_node/get_parameters',
                            GetParameters.Request(names=['imu_topic'])).values[0].string_value == '/imu/data'
        assert call(peer, Trigger, '/fusion_node/set_datum', Trigger.Request()).success
        # then all have answered, and what was sent has arrived and was used; what a busy machine loses is told as lost
        assert answers > 10
        sent = {'speed': len(recording.speed), 'velocity': len(recording.velocity), 'heading': len(recording.heading)}
        heard.wait(lambda d: all(int(d.values(name)['messages']) + int(d.values(name)['lost']) >= count
                                 for name, count in sent.items()))
        for name, count in sent.items():
            values = heard.values(name)
            assert 0.5 * count < int(values['messages']) <= count
            assert int(values['used']) > 0
        assert float(heard.values('speed')['realised over claimed']) < 2.0


def test_fixes_and_speeds_that_overtake_the_samples_wait_for_them(recording, peer):
    # given a node that fuses
    with NodeProcess('fusion_node', *PLAYABLE, *DEEP[:4], '-p', 'speed_topic:=/wheel/speed') as node:
        node.wait_until_ready()
        drive, heard = Drive(peer, recording), Diagnostics(peer)
        peer.connect(node, recording)
        peer.spin_until(drive.speed.get_subscription_count)
        drive.play(12.0)
        heard.wait(lambda d: d.values('filter').get('state') == 'fusing')
        before = {name: heard.values(name) for name in ('fix', 'speed')}
        # when it stands still for the machine's sake while three seconds of messages come
        node.send(signal.SIGSTOP)
        drive.play(3.0)
        peer.spin_some(0.5)
        node.send(signal.SIGCONT)
        # then each of the fixes is used, and none is called one of another clock
        heard.wait(lambda d: int(d.values('fix')['used']) >= int(before['fix']['used']) + 14)
        assert not any('the clocks differ' in line or 'stamped ahead' in line for line in node.lines)
        for name, values in before.items():
            assert {key: heard.values(name).get(key) for key in LATE} == {key: values.get(key) for key in LATE}


def test_what_a_busy_machine_loses_is_called_that(recording, peer):
    # given a node with a queue of five samples
    with NodeProcess('fusion_node', '-p', 'qos_overrides./imu/data.subscription.depth:=5') as node:
        node.wait_until_ready()
        peer.spin_until(peer.imu.get_subscription_count)
        heard = Diagnostics(peer)
        for k in range(200):  # a publisher's first messages may be lost
            peer.send_imu(recording.imu, k)
            time.sleep(0.002)
        heard.wait(lambda d: int(d.values('imu').get('messages', 0)) > 10)
        lost = int(heard.values('imu')['lost'])
        # when it stands still while 400 come
        node.send(signal.SIGSTOP)
        for k in range(200, 600):
            peer.send_imu(recording.imu, k)
        time.sleep(0.5)
        node.send(signal.SIGCONT)
        # then it says how many it has lost, and why
        for k in range(600, 700):
            peer.send_imu(recording.imu, k)
            time.sleep(0.002)
        line = node.wait_for('the machine is busy')
        assert 'WARN' in line and '/imu/data' in line and 'messages lost in the last second' in line
        heard.wait(lambda d: int(d.values('imu')['lost']) >= lost + 300)


def test_a_quality_of_service_that_does_not_fit_is_named(peer):
    # given a driver that is best effort, and a node that is told to ask for more
    publisher = peer.node.create_publisher(NavSatFix, '/gps/best_effort', QoSProfile(
        depth=5, reliability=ReliabilityPolicy.BEST_EFFORT))
    with NodeProcess('fusion_node', '-p', 'gnss_topic:=/gps/best_effort', '-p', 'gnss.outage_after:=1.0', '-p',
                     'qos_overrides./gps/best_effort.subscription.reliability:=reliable') as node:
        # then what comes in names it
        assert node.wait_for('what comes in')
        line = node.wait_for('/gps/best_effort (fix)')
        assert 'quality of service' in line
        # and so does the warning; the first one not, where a busy machine had not found the publisher yet
        warned = [line for line in node.lines if 'no message on /gps/best_effort' in line
                  and 'quality of service' in line] or [node.wait_for('quality of service')]
        assert 'no message on' in warned[0] and 'qos_overrides./gps/best_effort.subscription' in warned[0]
    peer.node.destroy_publisher(publisher)


def test_an_imu_and_a_receiver_that_are_gone_are_errors_and_the_sigma_grows(recording, peer):
    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        drive, heard = Drive(peer, recording), Diagnostics(peer)
        peer.connect(node, recording)
        drive.play(14.0)
        heard.wait(lambda d: d.values('filter').get('state') == 'fusing')
        values = heard.values('filter')
        sigma, age = float(values['position sigma, m']), float(values['age of the last fix used, s'])
        # when nothing comes any more
        heard.wait(lambda d: float(d.values('imu')['silent for, s']) > 6.0)
        # then that is no fusing, and what nobody sees is not known
        values = heard.values('filter')
        assert values['state'] == 'silent' and heard.level('filter') == heard.level('imu') == heard.level('fix') == 2
        assert 'no sample on /imu/data for' in heard.message('filter')
        assert float(values['position sigma, m']) > sigma + 5.0
        assert float(values['age of the last fix used, s']) > age + 5.0
        # when they are back
        drive.play(2.0)
        heard.wait(lambda d: d.values('filter')['state'] != 'silent' and d.level('imu') == 0)


def test_fixes_without_samples_are_not_blamed_on_the_clocks(recording, peer):
    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        peer.connect(node, recording)
        Drive(peer, recording).play(10.0)
        # when samples stop, and fixes go on
        last = int(recording.gnss.stamp[-1])
        for k in range(1, 4):
            gnss, i = recording.gnss, len(recording.gnss) - 1
            peer.gnss.publish(fix_message(last + (5 + k) * SECOND, gnss.latitude[i], gnss.longitude[i], gnss.height[i],
                                          gnss.covariance[i], 0, 2))
        # then the log says what is missing
        assert 'nothing has come on /imu/data since' in node.wait_for('after the newest IMU sample: nothing')


def test_the_preflight_says_that_all_is_fine(recording, peer):
    with NodeProcess('fusion_node', '-p', 'use_sim_time:=true') as node:
        node.wait_until_ready()
        drive = Drive(peer, recording)
        peer.spin_until(lambda: peer.imu.get_subscription_count() and peer.gnss.get_subscription_count())
        began = time.monotonic()
        while not drive.done and time.monotonic() - began < 20.0:
            drive.play(0.1)
            peer.spin_some(0.08)
        node.wait_for('what comes in (all fine)')
        block = [node.wait_for(f'  {what} ') for what in ('/imu/data (imu)', '/gps/fix (fix)', 'units', 'mounting',
                                                          'clocks')]
        assert "sensor_msgs/msg/Imu" in block[0] and "frame 'imu'" in block[0] and all(
            line.endswith(': fine') for line in block)
        assert ' m/s^2' in block[2]
