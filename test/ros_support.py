"""Real ROS 2 for the tests: a domain of their own, the real node as a child process, messages from recordings.

Importing this module prepares the environment, for this process and its children.
"""
from __future__ import annotations

import fcntl
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion, TwistWithCovarianceStamped, Vector3
from live_support import arrivals
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure, Imu, MagneticField, NavSatFix

from mems_ins_fusion.filter.measurements.registry import AIDING

REPOSITORY = Path(__file__).resolve().parents[1]
#: s, for what a machine with nothing else to do answers at once: two busy cores have needed 20
PATIENCE = 120.0
SECOND = 10**9  # ns
#: messages that a queue holds: more than a drive of a test has
DEPTH = 20000
#: topics of a drive that is played
TOPICS = {'imu': '/imu/data', 'fix': '/gps/fix', **{m.name: m.written_to for m in AIDING}}


def hears(*names: str) -> tuple[str, ...]:
    """Arguments of a node that listens to these inputs of TOPICS, besides IMU and fixes, and loses nothing."""
    return tuple(part for name in names for part in (
        '-p', f'{name}_topic:={TOPICS[name]}', '-p', f'qos_overrides.{TOPICS[name]}.subscription.reliability:=reliable',
        '-p', f'qos_overrides.{TOPICS[name]}.subscription.depth:={DEPTH}'))


#: for a node that a recording is played to: no message is lost, no complaint held back
PLAYABLE = ('--log-level', 'fusion_node:=debug',
            '-p', 'qos_overrides./imu/data.subscription.reliability:=reliable',
            '-p', f'qos_overrides./imu/data.subscription.depth:={DEPTH}',
            '-p', 'qos_overrides./gps/fix.subscription.reliability:=reliable',
            '-p', f'qos_overrides./odometry/fused.publisher.depth:={DEPTH}',
            '-p', f'qos_overrides./fix/fused.publisher.depth:={DEPTH}')


def _reserve_domain():
    """A ROS domain that no other test process on this machine uses, and the open file that reserves it."""
    for domain in range(1, 102):
        lock = open(Path(tempfile.gettempdir()) / f'mems_ins_fusion_ros_domain_{domain}', 'w')
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
        else:
            return domain, lock
    raise RuntimeError('all ROS domains are taken')


_DOMAIN, _LOCK = _reserve_domain()
os.environ.update(ROS_DOMAIN_ID=str(_DOMAIN), ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
os.environ.setdefault('ROS_LOG_DIR', tempfile.mkdtemp(prefix='mems_ins_fusion_ros_log_'))


class NodeProcess:
    """`python -m mems_ins_fusion NAME --ros-args ARGUMENTS` as a child with its own process group; a context manager.

    `lines` are those of its output so far.
    """

    def __init__(self, name: str, *arguments: str):
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'mems_ins_fusion', name, '--ros-args', *arguments], cwd=REPOSITORY,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
            pass_fds=[_LOCK.fileno()])  # a child that outlives a killed test keeps its domain to itself
        self.lines: list[str] = []
        self._new: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self._process.stdout:
            self._new.put(line.rstrip())
        self._new.put(None)

    def wait_until_ready(self) -> None:
        """Waits long: the first start on a machine compiles the filter."""
        self.wait_for('ready', timeout=600.0)

    def wait_for(self, text: str, timeout: float = PATIENCE) -> str:
        """The first line with `text` that was not waited past before; AssertionError where none comes."""
        line = self.says(text, timeout)
        assert line, '\n'.join([f"no '{text}' in the node's output:", *self.lines])
        return line

    def says(self, text: str, timeout: float) -> str | None:
        """As `wait_for`, but None where no such line comes in `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while True:
            try:
                line = self._new.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                return None
            if line is None:
                self._new.put(None)  # the output has ended, for who asks again, too
                return None
            self.lines.append(line)
            if text in line:
                return line

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def status(self) -> int | None:
        """The exit status; None while it lives."""
        return self._process.poll()

    def send(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def wait(self, timeout: float = PATIENCE) -> int:
        """The exit status, with all output in `lines`."""
        status = self._process.wait(timeout)
        while (line := self._new.get(timeout=PATIENCE)) is not None:
            self.lines.append(line)
        return status

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                os.killpg(self._process.pid, signal.SIGKILL)


class Peer:
    """The test's side of the topics: publishes IMU samples and fixes, collects odometry and fused fixes."""

    def __init__(self):
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node('peer', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        qos = QoSProfile(depth=DEPTH)
        self.imu = self.node.create_publisher(Imu, '/imu/data', qos)
        self.gnss = self.node.create_publisher(NavSatFix, '/gps/fix', qos)
        self.odometry: list[Odometry] = []
        self.fixes: list[NavSatFix] = []
        self._outputs = [self.node.create_subscription(Odometry, '/odometry/fused', self.odometry.append, qos),
                         self.node.create_subscription(NavSatFix, '/fix/fused', self.fixes.append, qos)]

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def spin_until(self, condition, timeout: float = PATIENCE) -> None:
        """Spin until `condition()`; AssertionError after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, 'the node did not answer in time'
            self._executor.spin_once(timeout_sec=0.05)

    def spin_some(self, seconds: float = 0.3) -> None:
        """Take what has arrived."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.01)

    def connect(self, node: NodeProcess, recording) -> None:
        """Return when the node hears both topics and is heard; the first IMU sample of `recording` is played by then.

        A matched publisher may still lose its first messages, so messages are sent until the node answers: samples
        that are not numbers, which it drops and complains about.
        """
        self.spin_until(lambda: all(self.node.count_publishers(s.topic_name) for s in self._outputs))
        nan = np.full(3, np.nan)
        self._send_until_heard(node, self.imu, imu_message(0, nan, nan))
        self.send_imu(recording.imu, 0)  # fixes are not looked at before
        self._send_until_heard(node, self.gnss, fix_message(0, np.nan, np.nan, np.nan, np.zeros((3, 3)), 0, 0))

    def _send_until_heard(self, node, publisher, message):
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            publisher.publish(message)
            if node.says(f'{publisher.topic_name}: ', 0.2):
                return
        raise AssertionError(f'the node does not hear {publisher.topic_name}')

    def send_imu(self, samples, index) -> None:
        self.imu.publish(imu_of(samples, index))

    def send_fix(self, fixes, index) -> None:
        self.gnss.publish(fix_of(fixes, index))

    def play(self, node: NodeProcess, recording) -> None:
        """Publish the rest of `recording` to a node that is PLAYABLE, as fast as the node takes it.

        The node works through the messages in the order received. Each topic has a queue of its own there, so that a
        fix waits here until the node has seen the samples before it, and the samples after it until it has had the time
        to come: the last sample is sent again, and the node complains.
        """
        imu, last = recording.imu, 0
        for kind, index in arrivals(recording)[1:]:
            if kind == 'imu':
                self.send_imu(imu, index)
                self._executor.spin_once(timeout_sec=0)
                last = index
                continue
            for send in (lambda: None, lambda: self.send_fix(recording.gnss, index)):
                send()
                self.send_imu(imu, last)
                node.wait_for(f'header.stamp {imu.stamp[last] * 1e-9:.6f} s does not follow')


class Player:
    """Plays all that a recording holds to a node that is PLAYABLE and `hears` it, in the order of the stamps, as fast
    as the node takes it; with the `connect` of `peer` it begins behind the first sample.

    change: called with name (imu, fix, speed, ...), index and message before that is sent. clock: whether /clock ticks
    each millisecond of the recording's time. later: ns, by which the recording is stamped later than it is.
    """

    #: of the recording's time the node is at most so far behind, s: what is a second ahead of the samples is refused
    STEP = 0.5

    def __init__(self, peer: Peer, node: NodeProcess, recording, change=None, clock=False, later=0):
        self._peer, self._node, self._change, self.later = peer, node, change, later
        self.recording, self.sent = recording, dict.fromkeys(TOPICS, 0)
        self.parts = {'imu': recording.imu, 'fix': recording.gnss, **{
            m.name: part for m in AIDING if (part := recording.streams().get(m.name)) is not None}}
        kinds = {'speed': TwistWithCovarianceStamped, 'velocity': TwistWithCovarianceStamped,
                 'heading': PoseWithCovarianceStamped, 'pressure': FluidPressure, 'twist': Odometry,
                 'magnetometer': MagneticField}
        self.publishers = {'imu': peer.imu, 'fix': peer.gnss} | {
            name: peer.node.create_publisher(kind, TOPICS[name], QoSProfile(depth=DEPTH))
            for name, kind in kinds.items() if name in self.parts}
        rows = [(int(stamp), order, name, i) for order, (name, part) in enumerate(self.parts.items(), start=1)
                for i, stamp in enumerate(part.stamp)]
        self.begin, end = int(recording.imu.stamp[0]), int(recording.imu.stamp[-1])
        if clock:
            self.publishers['clock'] = peer.node.create_publisher(Clock, '/clock', 10)
            rows += [(stamp, 0, 'clock', stamp) for stamp in range(self.begin, end, SECOND // 1000)]
        self._rows = sorted(rows)
        self._next, self._last = self._rows.index((self.begin, 1, 'imu', 0)) + 1, None

    def connect(self, *names: str) -> None:
        """Until the node hears the inputs `names`, and IMU and fixes."""
        self._peer.connect(self._node, self.recording)
        for name in names:
            self._peer.spin_until(self.publishers[name].get_subscription_count)

    @property
    def done(self) -> bool:
        return self._next == len(self._rows)

    def skip(self, until: float) -> None:
        """Leave out what there is before `until`, s after the first sample."""
        while not self.done and self._rows[self._next][0] < self.begin + until * SECOND:
            self._next += 1

    def play(self, until: float = 1e9, in_step: bool = True) -> None:
        """What has not been played of before `until`, s after the first sample. in_step: else the node is not waited
        for."""
        follow = None
        while not self.done and (row := self._rows[self._next])[0] < self.begin + until * SECOND:
            stamp, _, name, i = row
            if in_step and (name == 'fix' or follow is not None and stamp > follow):
                self.follow()
                follow = stamp + round(self.STEP * SECOND)
            self._send(name, i)
            self._next += 1
        if in_step:
            self.follow()

    def send_between(self, begin: float, end: float, *names: str) -> None:
        """What `names` have in this time, s after the first sample, one after the other; the node is not waited for."""
        for name in names:
            seconds = (self.parts[name].stamp - self.begin) / SECOND
            for i in np.flatnonzero((seconds >= begin) & (seconds < end)):
                self._send(name, i)

    def follow(self) -> None:
        """Until the node has seen the last sample: it complains when that comes again."""
        if self._last is not None:
            self.publishers['imu'].publish(self._last)
            self._node.wait_for(f'header.stamp {stamp_of(self._last) * 1e-9:.6f} s does not follow')
            self._peer.spin_some(0.001)

    def _send(self, name, i):
        if name == 'clock':
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(i + self.later, SECOND)
        else:
            message = _MESSAGES[name](self.parts[name], i)
            _stamped(message, int(self.parts[name].stamp[i]) + self.later, name)
            if self._change:
                self._change(name, i, message)
            self.sent[name] += 1
        self.publishers[name].publish(message)
        if name == 'imu':
            self._last = message


def _speed_message(speeds, i):
    message = TwistWithCovarianceStamped()
    message.twist.twist.linear.x = float(speeds.speed[i])
    message.twist.covariance[0] = float(speeds.variance[i])
    return message


def _velocity_message(velocities, i):
    message, (north, east, down) = TwistWithCovarianceStamped(), velocities.velocity[i].tolist()
    message.twist.twist.linear = Vector3(x=east, y=north, z=-down)
    message.twist.covariance[[0, 7, 14]] = velocities.covariance[i].diagonal()[[1, 0, 2]]
    return message


def _heading_message(headings, i):
    message, yaw = PoseWithCovarianceStamped(), np.pi / 2 - float(headings.yaw[i])
    message.pose.pose.orientation = Quaternion(z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))
    message.pose.covariance[35] = float(headings.variance[i])
    return message


def _pressure_message(pressures, i):
    return FluidPressure(fluid_pressure=float(pressures.pressure[i]), variance=float(pressures.variance[i]))


def _magnetic_message(fields, i):
    message = MagneticField(magnetic_field=Vector3(**_xyz(fields.field[i])))
    message.magnetic_field_covariance[[0, 4, 8]] = fields.variance[i]
    return message


def _twist_message(twists, i):
    message, (forward, right, clockwise) = Odometry(), map(float, twists.twist[i])
    message.twist.twist.linear = Vector3(x=forward, y=-right)
    message.twist.twist.angular.z = -clockwise
    message.twist.covariance[[0, 7, 35]] = twists.variance[i]
    # a pose that nobody may take for a position
    message.pose.pose.position.x = 1e6
    return message


class Diagnostics:
    """What a node says on /diagnostics, heard by `peer`: the newest status by its name, without that of the node."""

    def __init__(self, peer: Peer):
        self._peer, self.statuses, self.count = peer, {}, 0
        self._subscription = peer.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_message, 100)

    def _on_message(self, message):
        self.count += 1
        self.statuses.update({status.name.partition(': ')[2]: status for status in message.status})

    def level(self, name: str) -> int:
        """0, 1, 2 for OK, WARN, ERROR; -1 before it was heard."""
        return self.statuses[name].level[0] if name in self.statuses else -1

    def message(self, name: str) -> str:
        return self.statuses[name].message if name in self.statuses else ''

    def values(self, name: str) -> dict[str, str]:
        return {pair.key: pair.value for pair in self.statuses[name].values} if name in self.statuses else {}

    def wait(self, condition, timeout: float = PATIENCE) -> None:
        """Until a message from now on fulfils `condition(self)`."""
        count = self.count
        self._peer.spin_until(lambda: self.count > count and condition(self), timeout)


def call(peer: Peer, kind, name: str, request):
    """The answer of a service."""
    client = peer.node.create_client(kind, name)
    peer.spin_until(client.service_is_ready)
    answer = client.call_async(request)
    peer.spin_until(answer.done)
    return answer.result()


def imu_message(stamp, force, rate) -> Imu:
    """stamp: ns. force, rate: (3,) m/s^2 and rad/s, sensor axes."""
    message = Imu(angular_velocity=Vector3(**_xyz(rate)), linear_acceleration=Vector3(**_xyz(force)),
                  orientation=Quaternion(w=0.0))
    message.orientation_covariance[0] = -1.0
    return _stamped(message, stamp, 'imu')


def fix_message(stamp, latitude, longitude, height, covariance, status, covariance_type) -> NavSatFix:
    """stamp: ns. latitude, longitude: rad. height: m. covariance: (3, 3) m^2, east-north-up."""
    message = NavSatFix(latitude=float(np.degrees(latitude)), longitude=float(np.degrees(longitude)),
                        altitude=float(height), position_covariance=np.asarray(covariance, float).reshape(9),
                        position_covariance_type=int(covariance_type))
    message.status.status = int(status)
    return _stamped(message, stamp, 'gps')


def imu_of(samples, index) -> Imu:
    return imu_message(samples.stamp[index], samples.specific_force[index], samples.angular_rate[index])


def fix_of(fixes, index) -> NavSatFix:
    return fix_message(*(getattr(fixes, column)[index] for column in (
        'stamp', 'latitude', 'longitude', 'height', 'covariance', 'status', 'covariance_type')))


def stamp_of(message) -> int:
    """ns."""
    return message.header.stamp.sec * SECOND + message.header.stamp.nanosec


_MESSAGES = {'imu': imu_of, 'fix': fix_of, 'speed': _speed_message, 'velocity': _velocity_message,
             'heading': _heading_message, 'pressure': _pressure_message, 'twist': _twist_message,
             'magnetometer': _magnetic_message}


def _xyz(vector):
    return dict(zip('xyz', map(float, vector)))


def _stamped(message, stamp, frame_id):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(stamp), SECOND)
    message.header.frame_id = frame_id
    return message
