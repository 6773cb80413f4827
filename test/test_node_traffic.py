"""All that a vehicle's topics carry at once, over real ROS 2: nothing is lost, services answer, silence is told."""
from __future__ import annotations

import signal
import time
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_support import PLAYABLE, SECOND, Diagnostics, NodeProcess, Player, call, fix_of, hears, imu_message
from sensor_msgs.msg import NavSatFix
from std_srvs.srv import Trigger

from mems_ins_fusion.nodes.inputs import Queue, stamp_of
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_drive,
    simulate_recording,
)

AIDING = ('speed', 'velocity', 'heading')
#: on /diagnostics, of an input
LATE = {'refused, too late', 'refused, stamped ahead of the IMU'}


@pytest.fixture(scope='module')
def recording():
    """16 s with all sensors that there can be: a standstill, then a drive."""
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(simulate_drive(20.0, seed=3, rate=400.0, standstill=6.0), sensors,
                              GnssNoise(sigma=0.5, rate=5.0), seed=3,
                              aiding=SimulatedAiding(speed_rate=100.0, velocity_rate=50.0, heading_rate=50.0)).recording


def test_everything_arrives_and_services_answer_while_a_clock_of_a_thousand_hertz_ticks(recording, peer):
    # given a node in the time of a recording with an IMU of 400 Hz, 100 Hz of wheel speed, 50 Hz of the others
    with NodeProcess('fusion_node', *PLAYABLE, *hears(*AIDING), '-p', 'use_sim_time:=true') as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, clock=True)
        player.connect(*AIDING)
        player.skip(3.0)  # it stands
        # when it is played, services and parameters are asked for in the middle of it
        answers = 0
        while not player.done:
            player.play(4.0 + answers)
            answers += call(peer, GetParameters, '/fusion_node/get_parameters',
                            GetParameters.Request(names=['imu_topic'])).values[0].string_value == '/imu/data'
        assert call(peer, Trigger, '/fusion_node/set_datum', Trigger.Request()).success
        # then all have answered, and all that was sent has arrived and was used
        assert answers > 10
        heard.wait(lambda d: all(int(d.values(name)['messages']) == player.sent[name] for name in AIDING))
        for name in AIDING:
            values = heard.values(name)
            assert values['lost'] == '0' and int(values['used']) > 100  # not before the start
            assert sum(int(values.get(key, 0)) for key in LATE) < 10  # those of before the fix that it started from
            assert float(values['realised over claimed']) < 2.0
            assert {'rate, Hz', 'delay, s'} <= values.keys()


def test_fixes_and_speeds_that_overtake_the_samples_wait_for_them(recording, peer):
    # given a node that fuses
    with NodeProcess('fusion_node', *PLAYABLE, *hears('speed')) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        player.connect('speed')
        player.play(12.0)
        heard.wait(lambda d: d.values('filter').get('state') == 'fusing'
                   and int(d.values('speed')['messages']) == player.sent['speed'])  # those of before the start, too
        before = {name: heard.values(name) for name in ('fix', 'speed')}
        # when it stands still for the machine's sake, and what comes after that comes topic by topic, the samples last
        node.send(signal.SIGSTOP)
        player.send_between(12.0, 13.8, 'fix', 'speed')
        time.sleep(0.5)  # longer than a message is late on a machine with nothing else to do
        node.send(signal.SIGCONT)
        time.sleep(0.5)
        player.send_between(12.0, 13.8, 'imu')
        # then each of the fixes is used, and none is called one of another clock
        heard.wait(lambda d: int(d.values('fix')['used']) >= int(before['fix']['used']) + 8)
        assert not any('the clocks differ' in line or 'stamped ahead' in line for line in node.lines)
        for name, values in before.items():
            assert {key: heard.values(name).get(key) for key in LATE} == {key: values.get(key) for key in LATE}


class StalledTopic:
    """In place of an `Input`: messages at `stamps` (s) that all waited for half a second; tells `order` what it passes
    on, by name and stamp."""

    def __init__(self, name, stamps, order):
        self.name, self.is_imu, self.order = name, name == 'imu', order
        self.traffic = SimpleNamespace(stamp=0, waited=lambda info: 0.5)
        self._messages = [imu_message(round(stamp * SECOND), np.zeros(3), np.zeros(3)) for stamp in stamps]

    def take(self):
        return (self._messages.pop(0), {'source_timestamp': 0}) if self._messages else None

    def on_message(self, message, info):
        self.traffic.stamp = stamp_of(message)
        self.order.append((self.name, self.traffic.stamp / SECOND))


def test_what_overtook_samples_is_passed_on_as_soon_as_they_have_caught_up():
    # given fixes that come before the samples, all in one go, after a first sample
    order = []
    queue = Queue(SimpleNamespace(create_guard_condition=lambda serve: SimpleNamespace(trigger=lambda: None)))
    samples, fixes = StalledTopic('imu', [10.0], order), StalledTopic('fix', [10.2, 11.0, 12.0, 13.0], order)
    queue.inputs = [samples]
    queue.serve(samples, *samples.take())
    # when they are served
    queue.inputs = [fixes, StalledTopic('imu', np.arange(101, 140) / 10, order)]
    queue.inputs[1].traffic = samples.traffic
    queue.serve(fixes, *fixes.take())
    # then each fix is passed on when the samples are half a second before it
    newest = 10.0
    for name, stamp in order:
        if name == 'fix' and stamp > 10.5:
            assert stamp - newest == pytest.approx(0.5)
        newest = stamp if name == 'imu' else newest
    assert [stamp for name, stamp in order if name == 'fix'] == [10.2, 11.0, 12.0, 13.0] and len(order) == 44


def test_what_a_busy_machine_loses_is_called_that(recording, peer):
    # given a node with a queue of five samples
    with NodeProcess('fusion_node', '--log-level', 'fusion_node:=debug',  # which tells what is said too often, too
                     '-p', 'qos_overrides./imu/data.subscription.depth:=5') as node:
        node.wait_until_ready()
        heard, stamps = Diagnostics(peer), count(int(recording.imu.stamp[0]), SECOND // 400)

        def send():
            peer.imu.publish(imu_message(next(stamps), recording.imu.specific_force[0], recording.imu.angular_rate[0]))
        while int(heard.values('imu').get('messages', 0)) < 10:  # a publisher's first messages may be lost
            send()
            peer.spin_some(0.005)
        # when it stands still while 400 come
        node.send(signal.SIGSTOP)
        for _ in range(400):
            send()
        time.sleep(0.5)  # longer than a message is late on a machine with nothing else to do
        node.send(signal.SIGCONT)
        # then it says how many it has lost, and why
        lost = int(heard.values('imu')['lost'])
        while int(heard.values('imu')['lost']) < lost + 300:
            send()
            peer.spin_some(0.005)
        said, told = [], 0
        while told < 300:
            said.append(node.wait_for('messages lost in the last second'))
            told += int(said[-1].split('/imu/data: ')[1].split()[0])
        assert 'WARN' in said[0] and any('the machine is busy' in line for line in said)


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
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        player.connect()
        player.play(14.0)
        heard.wait(lambda d: d.values('filter').get('state') == 'fusing')
        values = heard.values('filter')
        sigma, age = float(values['position sigma, m']), float(values['age of the last fix used, s'])
        # when samples stop, and fixes go on
        last, i = int(recording.gnss.stamp[-1]), len(recording.gnss) - 1
        for k in range(1, 4):
            message = fix_of(recording.gnss, i)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(last + (5 + k) * SECOND, SECOND)
            peer.gnss.publish(message)
        # then the log says what is missing, and does not blame the clocks
        assert 'nothing has come on /imu/data since' in node.wait_for('after the newest IMU sample: nothing')
        # when nothing comes any more
        heard.wait(lambda d: float(d.values('imu')['silent for, s']) > 6.0 and d.level('fix') == 2)
        # then that is no fusing, and what nobody sees is not known
        values = heard.values('filter')
        assert values['state'] == 'silent' and heard.level('filter') == heard.level('imu') == 2
        assert 'no sample on /imu/data for' in heard.message('filter')
        assert float(values['position sigma, m']) > sigma + 5.0
        assert float(values['age of the last fix used, s']) > age + 5.0
        # when they are back
        player.play()
        heard.wait(lambda d: d.values('filter')['state'] != 'silent' and d.level('imu') < 2)


def test_the_preflight_says_that_all_is_fine(recording, peer):
    with NodeProcess('fusion_node', '-p', 'use_sim_time:=true') as node:
        node.wait_until_ready()
        player, tenths = Player(peer, node, recording, clock=True), iter(range(1, 160))
        peer.spin_until(lambda: peer.imu.get_subscription_count() and peer.gnss.get_subscription_count())
        # when a drive comes, at most as fast as it was driven
        while not (said := node.says('what comes in', 0.0)):
            player.play(next(tenths) / 10, in_step=False)
            peer.spin_some(0.1)
        assert 'all fine' in said
        block = [node.wait_for(f'  {what} ') for what in ('/imu/data (imu)', '/gps/fix (fix)', 'units', 'mounting',
                                                          'clocks')]
        assert " Imu, " in block[0] and "frame 'imu'" in block[0] and all(
            line.endswith(': fine') for line in block), block
        assert ' m/s^2' in block[2]
