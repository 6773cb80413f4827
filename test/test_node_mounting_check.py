"""A wrong mounting is named while the vehicle drives, in the words of replays."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from ros_support import PLAYABLE, NodeProcess, Peer

from mems_ins_fusion.nodes.mounting_check import LOOKS, MEMORY, RATE, MountingCheck
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.manoeuvres import SLOW
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording


def parameters(mounting_rpy, **more):
    return {**table.defaults(), 'imu.mounting_rpy': mounting_rpy, **more}


@pytest.fixture(scope='module')
def recording():
    """More than two minutes at 50 Hz with an IMU that is turned to the left by a right angle."""
    return simulate_recording(simulate_drive(140.0, seed=5, rate=50.0, standstill=10.0),
                              SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3),
                              GnssNoise(sigma=1.0, rate=0.5), seed=5, mounting_rpy=[0.0, 0.0, math.pi / 2]).recording


def looked(recording, mounting_rpy, **more):
    """What is found when it looks once a second, and the check. more: other parameters."""
    check, found = MountingCheck(parameters(mounting_rpy, **more)), []
    imu, gnss, next_fix = recording.imu, recording.gnss, 0
    for k in range(len(imu)):
        check.add_sample((int(imu.stamp[k]), *imu.specific_force[k].tolist(), *imu.angular_rate[k].tolist()))
        while next_fix < len(gnss) and gnss.stamp[next_fix] <= imu.stamp[k]:
            i, next_fix = next_fix, next_fix + 1
            check.add_fix((int(gnss.stamp[i]), gnss.latitude[i], gnss.longitude[i], gnss.height[i],
                           gnss.covariance[i].reshape(9), 0, 2))
        if k % 50 == 49:
            found.append(check.look())
    return [f for f in found if f], check


def test_a_wrong_mounting_is_named_with_the_angles_to_set(recording):
    found, check = looked(recording, [0.0, 0.0, 0.0])
    level, text = found[-1]
    assert level == 'error' and check.is_wrong and check.found == text
    assert 'turned to the left by' in text and 'set imu.mounting_rpy to [' in text
    yaw = float(text.split('[')[1].split(']')[0].split(',')[2])
    assert yaw == pytest.approx(math.pi / 2, abs=math.radians(5.0))


@pytest.mark.parametrize('force, rate, words', [
    (9.80665, math.radians(1.0), ['the accelerometers seem to be in g', 'they seem to be in deg/s']),
    (1.0, math.radians(1.0), ['they seem to be in deg/s']), (9.80665, 1.0, ['the accelerometers seem to be in g'])])
def test_wrong_units_are_named_and_not_taken_for_a_wrong_mounting(recording, force, rate, words):
    # given a driver that does not deliver SI units, and the right mounting
    imu = replace(recording.imu, specific_force=recording.imu.specific_force / force,
                  angular_rate=recording.imu.angular_rate / rate)
    found, check = looked(replace(recording, imu=imu), [0.0, 0.0, math.pi / 2])
    # then each look says which unit, and says nothing of a mounting that it cannot know
    assert found and all(level == 'error' and 'mounted' not in text for level, text in found)
    assert all(word in found[-1][1] for word in words) and check.found == found[-1][1]
    assert not check.is_certainly_wrong


def test_what_is_found_twice_is_certain_and_a_start_in_reverse_is_not(recording):
    # given a car that drives as cars do: the first look may be wrong, the second is not any more
    _, check = looked(recording, [0.0, 0.0, 0.0])
    assert check.is_certainly_wrong
    _, right = looked(recording, [0.0, 0.0, math.pi / 2])
    assert not right.is_certainly_wrong
    # given one that does nothing but reverse, at the speed at which one does that: it looks as if mounted backwards
    drive = simulate_drive(140.0, seed=5, rate=50.0, standstill=10.0)
    slow = tuple(replace(s, speed_change=-0.3 * s.speed_change) for s in drive.path.segments)
    reversing = simulate_recording(drive.altered(segments=slow), SensorErrors(), GnssNoise(sigma=0.1, rate=1.0),
                                   seed=5).recording
    found, check = looked(reversing, [0.0, 0.0, 0.0])
    assert 'backwards' in found[-1][1] and check.is_wrong and not check.is_certainly_wrong


def test_the_right_one_is_not_contradicted_and_memory_is_bounded(recording):
    found, check = looked(recording, [0.0, 0.0, math.pi / 2])
    assert found == [] and not check.is_wrong and check.found == 'nothing speaks against imu.mounting_rpy'
    # before a turn or a change of speed only gravity has shown
    before = recording.imu.stamp < recording.imu.stamp[0] + 9 * 10**9
    parked = replace(recording, imu=recording.imu.select(np.tile(np.flatnonzero(before), 5)))
    stamp = recording.imu.stamp[0] + np.arange(len(parked.imu)) * 20_000_000
    parked = replace(parked, imu=replace(parked.imu, stamp=stamp))
    _, still = looked(parked, [0.0, 0.0, 0.0])
    assert 'yaw of imu.mounting_rpy is right does not show yet' in still.found and not still.is_wrong
    # and what it remembers does not grow, nor after its last look
    begin = int(recording.imu.stamp[-1])
    for second in range(1, round(LOOKS[-1]) + 60):
        for k in range(50):
            check.add_sample((begin + second * 10**9 + k * 20_000_000, 0.0, 0.0, 9.8, 0.0, 0.0, 0.0))
        check.look()
    assert check.done and len(check._means) <= RATE * MEMORY and not check._samples


def test_samples_of_another_clock_and_of_no_vehicle_do_not_end_it(recording):
    check = MountingCheck(parameters([0.0, 0.0, 0.0]))
    for stamp, value in ((10**18, 1.0), (10**18 + 10**7, 1e300), (5, 2.0), (2 * 10**18, -1e300), (2 * 10**18 + 1, 3.0)):
        check.add_sample((stamp, *[value] * 6))
        check.look()
    for k in range(4000):
        check.add_sample((3 * 10**18 + k * 10**7, *([1e300] * 6 if k % 3 else [math.nan] * 6)))
    with np.errstate(all='ignore'):
        check.look()
    assert not check.is_wrong


def test_the_node_says_it_in_its_log_and_on_diagnostics(recording):
    peer, heard = Peer(), []
    subscription = peer.node.create_subscription(DiagnosticArray, '/diagnostics', heard.append, 10)
    with NodeProcess('fusion_node', *PLAYABLE) as node:
        # given a mounting that is not in the parameters
        node.wait_until_ready()
        peer.connect(node, recording)
        peer.play(node, recording)
        # then it is named
        said = [line for line in node.lines if 'the IMU seems to be mounted' in line]  # while it was played
        line = said[-1] if said else node.wait_for('the IMU seems to be mounted')
        assert 'ERROR' in line and '/imu/data' in line and 'set imu.mounting_rpy to' in line
        peer.spin_until(lambda: heard and 'seems to be mounted' in heard[-1].status[0].message)
        status = heard[-1].status[0]
        assert status.level != b'\x00'
        assert 'set imu.mounting_rpy' in {pair.key: pair.value for pair in status.values}['mounting']
        # and after the second look nothing is published with it
        peer.spin_until(lambda: heard[-1].status[0].level == b'\x02')
        told = 'nothing is published with a mounting that is certainly wrong'
        assert any(told in line for line in node.lines) or node.wait_for(told)
        # and that is the reason that it gives, where fixes and samples come
        peer.spin_until(lambda: told in heard[-1].status[0].message)
        assert 'waiting for' not in heard[-1].status[0].message
        begun = next(i for i, line in enumerate(node.lines) if told in line)
        assert not any('waiting for' in line for line in node.lines[begun:])
    peer.node.destroy_subscription(subscription)
    peer.close()


@pytest.mark.parametrize('topics, level, words', [
    ({}, 'warning', 'set vehicle.zero_velocity: false'),
    ({'twist_topic': '/wheel/odometry'}, 'info', '/wheel/odometry'), ({'vehicle.zero_velocity': False}, None, '')])
def test_motion_that_is_as_quiet_as_rest_is_told(topics, level, words):
    # given a robot of 0.4 m/s on even ground, whose wheels may tell when it stands
    drive = simulate_drive(60.0, seed=5, rate=50.0, standstill=10.0, manoeuvres=SLOW)
    made = simulate_recording(drive, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'),
                              GnssNoise(0.02, 5.0), seed=5).recording
    _, check = looked(made, [0.0, 0.0, 0.0], **topics)
    assert check.standstills is None if level is None else check.standstills[0] == level
    assert not words or words in check.standstills[1] and 'as quiet as rest' in check.standstills[1]


def test_a_car_stands_where_it_is_quiet(recording):
    _, check = looked(recording, [0.0, 0.0, math.pi / 2])
    assert check.standstills is None
