"""`play`: a recording on its topics over real ROS 2, and a node that lives in its time."""
from __future__ import annotations

import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import ros_support
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, NavSatFix

from mems_ins_fusion.__main__ import main as tool
from mems_ins_fusion.nodes import play
from mems_ins_fusion.recordings.bags import Bag

SECONDS = 60


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """A drive at 50 Hz that begins soon, with wheel speed."""
    path = tmp_path_factory.mktemp('play') / 'drive'
    assert tool(['simulate', '--output', str(path), '--duration', str(SECONDS), '--rate', '50', '--seed', '4',
                 '--standstill', '8', '--aiding']) == 0
    return path


class Playing:
    """`play ARGUMENTS` as a child process, and all that `Peer` hears of it; a context manager."""

    def __init__(self, *arguments, topics=(('/imu/data', Imu), ('/gps/fix', NavSatFix), ('/clock', Clock))):
        self._arguments = arguments
        self.peer = ros_support.Peer()
        self.heard: dict[str, list] = {topic: [] for topic, _ in topics}
        self._subscriptions = [self.peer.node.create_subscription(kind, topic, self.heard[topic].append,
                                                                   QoSProfile(depth=20000)) for topic, kind in topics]

    def __enter__(self):
        self.process = subprocess.Popen([sys.executable, '-m', 'mems_ins_fusion', 'play', *map(str, self._arguments)],
                                        cwd=ros_support.REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                        text=True)
        return self

    def __exit__(self, *exception):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.peer.close()

    def until(self, condition):
        self.peer.spin_until(condition)

    def to_the_end(self):
        """Standard output of the player, which has ended well."""
        self.until(lambda: self.process.poll() is not None)
        self.peer.spin_some()
        output, error = self.process.communicate()
        assert self.process.returncode == 0 and error == ''
        return output


def stamps(messages):
    return [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]


def test_each_message_is_published_as_it_was_recorded(bag):
    with Bag(bag) as recorded:
        raw = {topic: [(time, message) for _, *block, _ in recorded.read([topic]) for time, message in zip(*block)]
               for topic in ('/imu/data', '/gps/fix')}
    begin = raw['/imu/data'][0][0] + 40 * 10**9
    # when a part is played fast
    with Playing(bag, '--rate', 20, '--start', 40) as playing:
        output = playing.to_the_end()
    # then what is heard of each topic is the end of the recording
    for topic, recorded in raw.items():
        heard = playing.heard[topic]
        assert heard == [deserialize_message(message, type(heard[0])) for time, message in recorded if time >= begin]
        assert len(heard) >= 20
    # and the clock never runs backwards, and goes as far as the messages
    clock = np.array([c.clock.sec * 10**9 + c.clock.nanosec for c in playing.heard['/clock']])
    assert (np.diff(clock) >= 0).all() and clock[-1] == stamps(playing.heard['/imu/data'])[-1]
    assert '3001 on /imu/data' in output and 'played ' in output.splitlines()[-1]


def test_it_takes_the_time_that_was_recorded_divided_by_the_rate(bag):
    with Playing(bag, '--rate', 10, '--start', 40, '--topics', '/gps/fix') as playing:
        output = playing.to_the_end()
    assert 1.8 < float(output.split()[-2]) < 10.0
    assert not playing.heard['/imu/data'] and len(playing.heard['/gps/fix']) == 20


def test_it_loops_until_a_signal_and_ends_with_status_0(bag):
    with Playing(bag, '--rate', 50, '--start', 50, '--loop') as playing:
        playing.until(lambda: len(playing.heard['/gps/fix']) > 25)  # of 10 in the part
        playing.process.send_signal(signal.SIGINT)
        assert playing.process.wait(ros_support.PATIENCE) == 0
        assert playing.process.stderr.read() == ''


def test_a_topic_can_be_renamed(bag):
    with Playing(bag, '--rate', 50, '--start', 50, '--ros-args', '-r', '/imu/data:=/other',
                 topics=[('/other', Imu), ('/imu/data', Imu)]) as playing:
        playing.to_the_end()
    assert len(playing.heard['/other']) > 400 and not playing.heard['/imu/data']


def test_the_live_node_runs_on_a_recording_in_its_time_as_the_readme_has_it(bag):
    with Bag(bag) as recorded:
        last = max(time for _, times, _, _ in recorded.read(['/imu/data']) for time in times)
    # given the two commands of the README
    with ros_support.NodeProcess('fusion_node', '-p', 'use_sim_time:=true', '-p', 'speed_topic:=/wheel/speed') as node:
        node.wait_until_ready()
        with Playing(bag, '--rate', 5, topics=[('/odometry/fused', Odometry)]) as playing:
            heard, answers, odometry = ros_support.Diagnostics(playing.peer), 0, playing.heard['/odometry/fused']
            # when services are called while it plays; a busy machine may lose its last samples
            deadline = time.monotonic() + 30.0
            while time.monotonic() < deadline and (not odometry or stamps(odometry[-1:])[0] < last - 10**8):
                answers += ros_support.call(playing.peer, GetParameters, '/fusion_node/get_parameters',
                                            GetParameters.Request(names=['imu_topic'])).values[0].string_value != ''
                playing.peer.spin_some(0.5)
            # then they answer, and the wheel speed is used
            assert answers > 3
            heard.wait(lambda d: int(d.values('speed').get('used', 0)) > 100)
        node.wait_for('state: fusing')
        node.send(signal.SIGINT)
        assert node.wait() == 0
    # the odometry carries the recording's time, and there is one for each sample after the start
    assert len(odometry) > 500


@pytest.mark.parametrize(['arguments', 'said'], [
    (['nowhere'], 'nowhere does not exist'), (['{bag}', '--topics', '/imu/dat'], "did you mean '/imu/data'"),
    (['{bag}', '--rate', '0'], '--rate must be'), (['{bag}', '--start', '100'], 'is after the end'),
    (['{bag}', '--memory-limit', '0.2'], 'memory'), (['{bag}', '--lop'], "did you mean '--loop'")])
def test_what_is_wrong_is_said_in_one_line(bag, arguments, said, capsys):
    try:
        status = play.main([*(a.format(bag=bag) for a in arguments), '--wait', '0'])
    except SystemExit as end:
        status = end.code
    error = capsys.readouterr().err
    assert status == 2
    assert error.startswith('play: ') and len(error.splitlines()) == 1 and said in error
