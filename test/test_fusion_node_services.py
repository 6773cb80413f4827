"""What the node says of itself and what can be asked of it, over real ROS 2: one node, one drive."""
from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import PLAYABLE, NodeProcess, Peer, imu_message
from sensor_msgs.msg import NavSatFix
from std_srvs.srv import SetBool, Trigger

from mems_ins_fusion.nodes.inputs import Queue, aiding_inputs, stamp_of
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

NODE = '/fusion_node'


@pytest.fixture(scope='module')
def recording():
    """25 s: a standstill, then a drive."""
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(simulate_drive(25.0, seed=3, standstill=10.0), sensors, GnssNoise(sigma=1.0, rate=2.0),
                              seed=3).recording


class Listener(Peer):
    """A peer that hears all that the node says of itself."""

    def __init__(self):
        super().__init__()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.diagnostics, self.verdicts, self.poses = [], [], []
        self.listening = [
            self.node.create_subscription(DiagnosticArray, '/diagnostics', self.diagnostics.append, 100),
            self.node.create_subscription(DiagnosticArray, f'{NODE}/verdicts', self.verdicts.append, 1000),
            self.node.create_subscription(PoseWithCovarianceStamped, '/pose/fused', self.poses.append, 1000)]
        self.latched = latched

    def hears_datum(self):
        """The datum, heard by one who comes late."""
        heard: list[NavSatFix] = []
        subscription = self.node.create_subscription(NavSatFix, f'{NODE}/datum', heard.append, self.latched)
        self.spin_until(lambda: heard)
        self.node.destroy_subscription(subscription)
        return heard[0]

    def call(self, kind, name, request):
        client = self.node.create_client(kind, f'{NODE}/{name}')
        self.spin_until(client.service_is_ready)
        answer = client.call_async(request)
        self.spin_until(answer.done)
        return answer.result()

    def wait_for_state(self, wanted):
        """The values of the first status from now on that tells `wanted`."""
        del self.diagnostics[:]
        self.spin_until(lambda: self.diagnostics and values_of(self.diagnostics[-1])['state'] == wanted)
        return self.diagnostics[-1].status[0], values_of(self.diagnostics[-1])


def values_of(array):
    return {pair.key: pair.value for pair in array.status[0].values}


@pytest.fixture
def peer():
    peer = Listener()
    yield peer
    peer.close()


def test_it_says_how_it_is_and_does_what_it_is_asked(recording, peer):
    with NodeProcess('fusion_node', *PLAYABLE, '-p', 'frames:=map_odom') as node:
        # given a node without input
        node.wait_until_ready()
        status, values = peer.wait_for_state('waiting')
        assert status.level == b'\x01' and status.name == 'fusion_node: filter'
        # when a drive is played to it
        peer.connect(node, recording)
        peer.play(node, recording)
        status, values = peer.wait_for_state('fusing')
        # then it says so, with numbers
        assert status.level == b'\x00'
        assert float(values['mean NIS']) < 10.0 and float(values['position sigma, m']) < 3.0
        assert int(values['fix used']) > 0 and float(values['heading sigma, deg']) < 30.0
        # and each fix has its verdict at its own time; the hand-shake's was not a number
        fixes = recording.gnss.stamp.tolist()
        peer.spin_until(lambda: peer.verdicts and stamp_of(peer.verdicts[-1]) == fixes[-1])
        used = [stamp_of(m) for m in peer.verdicts if values_of(m)['used'] == '1']
        assert used == fixes[fixes.index(used[0]):] and len(used) > 10
        assert all(math.isfinite(float(values_of(m)['innovation_north'])) for m in peer.verdicts
                   if values_of(m)['used'] == '1')
        # and the datum is there for who comes late, and in the log
        datum = peer.hears_datum()
        assert abs(datum.latitude - math.degrees(recording.gnss.latitude[0])) < 1e-3
        assert any('datum: latitude' in line for line in node.lines)
        # and the odometry in odom has no jump; poses in the map are of the same times (each topic keeps its last ten
        # messages: who reads the other one meanwhile misses some)
        last = int(recording.imu.stamp[-1])
        peer.spin_until(lambda: peer.poses and stamp_of(peer.poses[-1]) == stamp_of(peer.odometry[-1]) == last)
        assert len(peer.poses) > 1000
        assert {stamp_of(m) for m in peer.poses} <= {stamp_of(m) for m in peer.odometry}
        speeds = [math.hypot(m.twist.twist.linear.x, m.twist.twist.linear.y) for m in peer.odometry]
        steps = [math.dist((a.pose.pose.position.x, a.pose.pose.position.y),
                           (b.pose.pose.position.x, b.pose.pose.position.y))
                 for a, b in zip(peer.odometry, peer.odometry[1:])]
        # (before the heading is known each fix begins it anew)
        steps, speeds = steps[-500:], speeds[-500:]
        assert len(steps) == 500 and max(step - 0.01 * speed for step, speed in zip(steps, speeds[1:])) < 0.005
        assert {m.header.frame_id for m in peer.poses} == {'map'}

        # when fixes are switched off
        answer = peer.call(SetBool, 'use_fixes', SetBool.Request(data=False))
        assert answer.success and 'ignored' in answer.message
        # and it is told where it is
        pose = PoseWithCovarianceStamped()
        pose.header.frame_id = 'map'
        pose.pose.pose.position.x, pose.pose.pose.orientation.w = 700.0, 1.0
        pose.pose.covariance[0] = pose.pose.covariance[7] = pose.pose.covariance[35] = 0.01
        start = peer.node.create_publisher(PoseWithCovarianceStamped, '/initialpose', 1)
        peer.spin_until(start.get_subscription_count)
        start.publish(pose)
        node.wait_for('/initialpose: starting from')
        step = 10_000_000
        for k in range(1, 6):
            send_at(peer, recording, last + k * step)
        peer.spin_until(lambda: stamp_of(peer.poses[-1]) == last + 5 * step)
        # then it is there
        assert peer.poses[-1].pose.pose.position.x == pytest.approx(700.0, abs=1.0)
        # when it is reset, it begins anew
        assert peer.call(Trigger, 'reset', Trigger.Request()).success
        send_at(peer, recording, last + 6 * step)
        peer.wait_for_state('waiting')


def send_at(peer, recording, stamp):
    peer.imu.publish(imu_message(stamp, recording.imu.specific_force[0], recording.imu.angular_rate[0]))


def test_output_by_the_clock_goes_on_between_samples_from_a_start_pose(recording, peer):
    # given output at 50 Hz by a clock that the samples share, started from a pose
    pose = '[48.0, 11.0, 500.0, 0.0]'
    with NodeProcess('fusion_node', '-p', 'predict_to_now:=true', '-p', 'odometry_rate:=50.0', '-p',
                     'imu.max_gap:=1.0', '-p', 'imu.mounting_sigma:=0.0', '-p', f'start_pose:={pose}') as node:
        node.wait_until_ready()
        now = peer.node.get_clock().now
        sent = []

        def enough():
            stamp = now().nanoseconds
            if not sent or stamp - sent[-1] > 200_000_000:  # 5 Hz
                sent.append(stamp)
                send_at(peer, recording, stamp)
            return len(peer.odometry) > 60
        peer.spin_until(enough)
        # then there are many more messages than samples, each later than the one before
        stamps = [stamp_of(m) for m in peer.odometry]
        assert all(b > a for a, b in zip(stamps, stamps[1:]))
        assert len(stamps) > 3 * len([s for s in sent if s > stamps[0]])
        assert peer.odometry[0].pose.covariance[35] == pytest.approx(0.01, abs=0.005)
        # when samples stop, it stops and says why
        node.wait_for('nothing is published')


def test_a_speed_is_heard_in_whichever_type_it_comes():
    heard = []
    fusion = SimpleNamespace(add=lambda *told: heard.append(told))
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node('listener', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        # given a speed topic that nobody publishes yet
        speed, = aiding_inputs(node, Queue(node), {'speed_topic': '/speed'}, fusion, lambda *_: None)
        # when a publisher of one of the two types comes
        publisher = node.create_publisher(TwistWithCovarianceStamped, '/speed', 10)
        message = TwistWithCovarianceStamped()
        message.header.stamp.sec, message.twist.twist.linear.x, message.twist.covariance[0] = 7, 3.5, 0.04
        for _ in range(100):
            speed.look()
            publisher.publish(message)
            executor.spin_once(timeout_sec=0.1)
            if heard:
                break
        assert heard[0] == ('speed', 7 * 10**9, 3.5, 0.04)
        assert speed.traffic.count == len(heard)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
