"""fusion_node over real ROS 2: the node is a child process, the test is its peer on the topics."""
from __future__ import annotations

import re
import signal
from dataclasses import replace

import numpy as np
import pytest
from live_support import fed
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_support import PLAYABLE, NodeProcess, Peer, imu_message, stamp_of

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

OUTAGE = (30.0, 36.0)


@pytest.fixture(scope='module')
def recording():
    """45 s: a standstill, then a drive with an outage of six seconds in it."""
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    gnss = GnssNoise(sigma=1.0, rate=2.0, outages=(OUTAGE,))
    return simulate_recording(simulate_drive(45.0, seed=3, standstill=10.0), sensors, gnss, seed=3).recording


def expected_outputs(recording):
    """What a filter in this process makes of the same messages: rows of stamp, odometry (85), geodetic (3)."""
    fusion = FusionFilter(FilterConfig.from_parameters(table.defaults()))
    stamps, states = [], []
    # a message carries degrees
    latitude, longitude = np.radians(np.degrees([recording.gnss.latitude, recording.gnss.longitude]))
    carried = replace(recording, gnss=replace(recording.gnss, latitude=latitude, longitude=longitude))
    for _ in fed(fusion, carried):
        stamps.append(fusion.update_odometry())
        states.append(np.concatenate([fusion.odometry, fusion.geodetic, fusion.position_covariance_enu]))
    return np.array(stamps), np.array(states)


def flat(odometry, fix):
    """One odometry message and the fix that came with it as a row in the order of `expected_outputs`."""
    pose, twist = odometry.pose.pose, odometry.twist.twist
    return np.concatenate([
        [pose.position.x, pose.position.y, pose.position.z],
        [pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w], odometry.pose.covariance,
        [twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y, twist.angular.z],
        odometry.twist.covariance, [fix.latitude, fix.longitude, fix.altitude], fix.position_covariance])


@pytest.fixture(scope='module')
def expected(recording):
    return expected_outputs(recording)


@pytest.fixture(scope='module')
def played(recording, expected):
    """The drive played to the real node, as fast as the node takes it: (odometry, fixes, lines of its log)."""
    peer = Peer()
    stamps, _ = expected
    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        peer.connect(node, recording)
        peer.play(node, recording)
        peer.spin_until(lambda: len(peer.fixes) == len(peer.odometry) == len(stamps))
        node.send(signal.SIGINT)
        assert node.wait() == 0
    peer.close()
    return peer.odometry, peer.fixes, node.lines


def test_each_sample_after_alignment_gives_one_odometry(played, expected, recording):
    odometry, fixes, _ = played
    stamps, _ = expected
    assert [stamp_of(m) for m in odometry] == stamps.tolist() == [stamp_of(m) for m in fixes]
    # and those are the IMU's own stamps, none left out from the first on
    first = np.searchsorted(recording.imu.stamp, stamps[0])
    assert stamps.tolist() == recording.imu.stamp[first:].tolist()
    assert len(stamps) > 2500


def test_the_numbers_are_those_of_the_filter_bit_for_bit(played, expected):
    odometry, fixes, _ = played
    _, states = expected
    states = states.copy()
    states[:, 85:87] = np.degrees(states[:, 85:87])
    received = np.array([flat(o, f) for o, f in zip(odometry, fixes)])
    assert np.array_equal(received, states)


def test_the_pose_follows_the_truth_in_east_north_up(played, recording):
    odometry, fixes, _ = played
    truth = recording.reference
    index = np.searchsorted(truth.stamp, [stamp_of(m) for m in odometry])
    position = np.array([[f.latitude, f.longitude] for f in fixes])
    metres = 6.37e6 * np.radians(1.0)
    north = (position[:, 0] - np.degrees(truth.latitude[index])) * metres
    east = (position[:, 1] - np.degrees(truth.longitude[index])) * metres * np.cos(truth.latitude[0])
    assert np.max(np.hypot(north, east)) < 8.0
    # the local position and the geodetic one move by the same east and north
    moved = np.array([[m.pose.pose.position.x, m.pose.pose.position.y] for m in (odometry[0], odometry[-1])])
    geodetic = np.array([[f.longitude * np.cos(truth.latitude[0]), f.latitude] for f in (fixes[0], fixes[-1])])
    assert np.diff(moved, axis=0) == pytest.approx(np.diff(geodetic, axis=0) * metres, rel=0.01, abs=0.5)
    # yaw counter-clockwise from east, velocity along it (truth: clockwise from north, north-east)
    last = odometry[-1]
    q = last.pose.pose.orientation
    yaw = np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    error = yaw - (np.pi / 2 - truth.yaw[index[-1]])
    assert abs(np.arctan2(np.sin(error), np.cos(error))) < 0.1
    speed = np.hypot(*truth.velocity[index[-1], :2])
    assert last.twist.twist.linear.x == pytest.approx(speed, abs=1.0)


def test_frames_and_covariances_are_complete(played):
    odometry, fixes, _ = played
    assert {(m.header.frame_id, m.child_frame_id) for m in odometry} == {('odom', 'base_link')}
    assert {(m.header.frame_id, m.position_covariance_type) for m in fixes} == {('base_link', 3)}
    for message in odometry[::500]:
        for covariance in (message.pose.covariance, message.twist.covariance):
            matrix = covariance.reshape(6, 6)
            assert np.allclose(matrix, matrix.T, rtol=1e-9, atol=1e-15)
            assert np.linalg.eigvalsh(matrix).min() >= -1e-12 * matrix.max()
            assert np.all(np.diag(matrix)[[0, 1, 5]] > 0)
    for fix in fixes[::500]:
        assert np.linalg.eigvalsh(fix.position_covariance.reshape(3, 3)).min() > 0


def test_in_an_outage_it_coasts_with_growing_covariance_and_says_so(played, recording):
    odometry, _, lines = played
    since = np.array([stamp_of(m) for m in odometry]) - recording.imu.stamp[0]
    during = (since > (OUTAGE[0] + 1) * 1e9) & (since < OUTAGE[1] * 1e9)
    variance = np.array([m.pose.covariance[0] + m.pose.covariance[7] for m in odometry])[during]
    assert len(variance) > 450
    assert np.all(np.diff(variance) > 0)
    assert any('no fix used from /gps/fix for 2.5 s: coasting' in line for line in lines)


def test_the_log_says_what_it_waits_for_and_that_it_is_aligned(played):
    _, _, lines = played
    assert any('waiting' in line for line in lines)
    assert any('aligned' in line for line in lines)


def test_bad_messages_are_named_with_their_field(played):
    # the hand-shake of the test sent samples that are not numbers
    _, _, lines = played
    assert any('WARN' in line and '/imu/data' in line and 'nan' in line for line in lines)
    assert any('WARN' in line and '/gps/fix' in line and 'nan' in line for line in lines)


def test_a_stream_of_nan_does_not_flood_the_log_and_does_not_end_the_node(recording, peer):
    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        peer.connect(node, recording)
        for index in range(400):
            peer.imu.publish(imu_message(index, [np.nan, 0.0, 9.8], [0.0, 0.0, 0.0]))
        # when it still answers to another mistake
        peer.send_imu(recording.imu, 0)
        node.wait_for('does not follow')
    complaints = [line for line in node.lines if 'linear_acceleration' in line]
    assert len(complaints) > 400  # all were seen
    assert sum('WARN' in line for line in complaints) < 10


def test_a_lower_rate_by_stamp_changed_while_running(recording, peer):
    # given 25 Hz from 100 Hz samples
    stamps, _ = expected_outputs(recording)
    slots = len(set((stamps // 40_000_000).tolist()))
    with NodeProcess('fusion_node', *PLAYABLE, '-p', 'odometry_rate:=25') as node:
        node.wait_until_ready()
        peer.connect(node, recording)
        peer.play(node, recording)
        peer.spin_until(lambda: len(peer.odometry) >= slots)
        assert len(peer.odometry) == slots
        assert len({stamp_of(m) // 40_000_000 for m in peer.odometry}) == slots
        # when parameters are set at run time
        service = peer.node.create_client(SetParameters, '/fusion_node/set_parameters')
        peer.spin_until(service.service_is_ready)
        wanted = [('odometry_rate', 50.0), ('odometry_rate', -1.0), ('gnss.sigma', 1.0), ('odometry_rate', 'fast')]
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()
                                                    for name, value in wanted])
        answer = service.call_async(request)
        peer.spin_until(answer.done)
    # then the rate is taken, what does not fit is refused, and the filter's own cannot change
    results = answer.result().results
    assert [r.successful for r in results] == [True, False, False, False]
    assert 'read-only' in results[2].reason


def test_silent_topics_are_named_with_what_there_is_instead_even_while_ros_time_stands_still(peer):
    # given an IMU under another name, no receiver at all, and use_sim_time without a /clock
    peer.node.destroy_publisher(peer.imu)
    raw = peer.node.create_publisher(type(imu_message(0, [0] * 3, [0] * 3)), '/imu/raw', 10)
    wanted = [r'no message on /gps/fix \(sensor_msgs/msg/NavSatFix\) .*: it has a publisher, but nothing arrives',
              r'no message on /imu/data \(sensor_msgs/msg/Imu\) .*: nobody publishes it; topics of this type: /imu/raw']
    with NodeProcess('fusion_node', '-p', 'use_sim_time:=true', '-p', 'gnss.outage_after:=1.0') as node:
        # a busy machine may not have told the node of its neighbours yet when it complains the first time
        while not all(any(re.search(text, line) for line in node.lines) for text in wanted):
            node.wait_for('no message on')
        node.send(signal.SIGTERM)
        assert node.wait() == 0
    peer.node.destroy_publisher(raw)


@pytest.mark.parametrize('signals', [[signal.SIGINT], [signal.SIGTERM], [signal.SIGINT] * 2,
                                     [signal.SIGTERM, signal.SIGINT]])
def test_a_signal_ends_it_cleanly(signals):
    with NodeProcess('fusion_node') as node:
        node.wait_until_ready()
        for number in signals:
            node.send(number)
        assert node.wait() == 0
    assert not any('Traceback' in line or 'Error' in line for line in node.lines)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_filter_is_compiled_ends_it_cleanly(number, tmp_path, monkeypatch):
    # given a machine on which nothing has been compiled yet
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path))
    with NodeProcess('fusion_node') as node:
        node.wait_for('compiling the filter')
        node.says('ready', 1.5)  # in the middle of it
        node.send(number)
        assert node.wait() == 0
    assert not any(word in line for line in node.lines for word in ('Traceback', 'Error', 'ignored', 'ready'))


def test_a_refused_parameter_is_one_line_and_status_2():
    with NodeProcess('fusion_node', '-p', 'sensor_error_modell:=random_walk') as node:
        assert node.wait() == 2
    assert node.lines == ["fusion_node: unknown parameter 'sensor_error_modell'; did you mean 'sensor_error_model'?"]
