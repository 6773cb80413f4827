"""What is wrong with what comes in is said, in the log and on /diagnostics, by the real node over real ROS 2."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from ros_support import PLAYABLE, SECOND, Diagnostics, NodeProcess, Player, call, hears, stamp_of
from sensor_msgs.msg import NavSatFix
from std_srvs.srv import Trigger

from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_drive,
    simulate_recording,
)

SENSORS = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)


@pytest.fixture(scope='module')
def recording():
    """60 s at 50 Hz: a standstill, then a drive, with wheel speed and heading."""
    return simulate_recording(simulate_drive(60.0, seed=3, rate=50.0, standstill=6.0), SENSORS,
                              GnssNoise(sigma=0.5, rate=2.0), seed=3,
                              aiding=SimulatedAiding(speed_rate=10.0, heading_rate=5.0, speed_scale=0.0)).recording


def in_kilometres_an_hour(name, i, message):
    if name == 'speed':
        message.twist.twist.linear.x *= 3.6
        message.twist.covariance[0] *= 3.6**2


def turned(name, i, message):
    """Headings that are half a turn off."""
    if name == 'heading':
        q = message.pose.pose.orientation
        q.z, q.w = q.w, -q.z


def test_a_wheel_speed_in_another_unit_and_headings_that_are_turned_are_named(recording, peer):
    def both(*told):
        in_kilometres_an_hour(*told)
        turned(*told)
    with NodeProcess('fusion_node', *PLAYABLE, *hears('speed', 'heading')) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, both)
        player.connect('speed', 'heading')
        player.play(50.0)
        # then each input says what is wrong with it, with the parameter,
        heard.wait(lambda d: 'speed.factor' in d.message('speed') and 'heading.offset' in d.message('heading'))
        assert heard.level('speed') == heard.level('heading') == 2
        told = float(heard.message('speed').split('set speed.factor to ')[1].split(';')[0])
        assert told == pytest.approx(1 / 3.6, rel=0.1)
        offset = float(heard.message('heading').split('set heading.offset to ')[1].split(';')[0])
        assert abs(offset) == pytest.approx(math.pi, abs=0.1)
        assert any('/wheel/speed: the speed is' in line and 'speed.factor' in line for line in node.lines) or (
            node.wait_for('speed.factor'))
        # and the filter gives them as its reasons
        assert heard.level('filter') >= 1
        assert all(f'{topic}: the ' in heard.message('filter') for topic in ('/wheel/speed', '/gps/heading'))


def test_the_factor_makes_it_right(recording, peer):
    with NodeProcess('fusion_node', *PLAYABLE, *hears('speed'), '-p', 'speed.factor:=0.27778') as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, in_kilometres_an_hour)
        player.connect('speed')
        player.play(30.0)
        heard.wait(lambda d: int(d.values('speed').get('used', 0)) > 100)
        assert heard.level('speed') == 0 and heard.values('filter')['state'] == 'fusing', heard.message('filter')
        assert not any(key.startswith('refused') for key in heard.values('speed'))


def test_a_clock_of_the_imu_that_is_set_and_one_that_stops(recording, peer):
    def bias_sigma():
        heard.wait(lambda d: True)
        return max(float(value) for key, value in heard.values('filter').items()
                   if key.startswith('w_z') and key.endswith('sigma'))

    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        player.connect()
        player.play(30.0)
        heard.wait(lambda d: d.values('filter').get('state') == 'fusing')
        last, known = max(map(stamp_of, peer.odometry)), bias_sigma()
        # when the stamps are 60 ms less from then on
        player.later = -60_000_000
        player.play(34.0)
        peer.spin_until(lambda: stamp_of(peer.odometry[-1]) > last + 3 * SECOND)
        # then no stamp goes back, and it fuses on with what it had learned
        stamps = [stamp_of(message) for message in peer.odometry]
        assert all(b > a for a, b in zip(stamps, stamps[1:]))
        heard.wait(lambda d: d.values('filter')['state'] == 'fusing')
        assert bias_sigma() < 1.1 * known
        # when the IMU is silent for 2 s of driving
        player.skip(36.0)
        player.play(36.2)
        # then it may have restarted with other errors: they are free, and the filter goes on
        heard.wait(lambda d: d.values('imu')['gaps'] == '1')
        assert bias_sigma() > 2.0 * known
        assert not any('aligns anew' in line for line in node.lines)
        # when the stamps jump by a minute
        player.later += 60 * SECOND
        player.play(38.0)
        # then it aligns anew
        assert any('header.stamp jumped by +60.' in line and 'the filter aligns anew' in line for line in node.lines)


def test_a_wrong_first_fix_makes_no_datum_and_refused_ones_are_shown_until_they_agree(recording, peer):
    shown, points = [], []
    subscriptions = [peer.node.create_subscription(NavSatFix, '/fusion_node/refused_fixes', shown.append, 50),
                     peer.node.create_subscription(PointStamped, '/fusion_node/refused_points', points.append, 50)]

    def far(name, i, message):
        if name == 'fix' and (i in (0, 60) or i >= 84):  # 300 m east
            message.longitude += 300.0 / 111e3 / math.cos(math.radians(message.latitude))

    with NodeProcess('fusion_node', *PLAYABLE, '-p', 'gnss.recovery_time:=5.0') as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, far)
        player.connect()
        player.play(40.0)
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
        player.play(41.0)
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
        # when fixes are far off for good, the log says for how long they were refused
        player.play(60.0)
        heard.wait(lambda d: True)
        said, = (line for line in node.lines if 'agree with each other' in line)
        row = [stamp for message in shown if (stamp := stamp_of(message)) >= recording.gnss.stamp[84]]
        believed = recording.gnss.stamp[84 + len(row)]
        assert float(said.split('refused for ')[1].split()[0]) == pytest.approx((believed - row[0]) / SECOND, abs=0.6)
    for subscription in subscriptions:
        peer.node.destroy_subscription(subscription)


def test_two_d_and_the_axes_of_the_vehicle(peer):
    # given a drive with RTK, and an IMU that is turned by 3 deg, which no parameter tells
    turned = simulate_recording(
        simulate_drive(140.0, seed=5, rate=50.0, standstill=8.0), SENSORS, GnssNoise(sigma=0.03, rate=1.0), seed=5,
        mounting_rpy=[0.0, 0.0, math.radians(3.0)]).recording
    given = '-p', 'two_d:=true', '-p', 'vehicle_axes:=true', '-p', 'odometry_rate:=10.0'
    with NodeProcess('fusion_node', *PLAYABLE, *given) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, turned)
        player.connect()
        player.play()
        peer.spin_until(lambda: peer.odometry and stamp_of(peer.odometry[-1]) > turned.imu.stamp[-1] - SECOND)
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


def test_a_start_in_motion_with_a_wild_sample_makes_no_noise_on_stderr(recording, peer):
    def wild(name, i, message):
        if name == 'imu' and i == 1500:
            message.linear_acceleration.x = 1e300

    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, wild)
        player.connect()
        player.skip(12.0)
        player.play(50.0)
        # how much of the drive the one look after 30 s sees is chance, and so whether the yaw shows; nothing is wrong
        heard.wait(lambda d: d.values('filter').get('mounting', '').startswith(('nothing speaks', 'gravity does not')))
        assert heard.values('imu')['refused, out of range'] == '1'
    node.wait()
    assert not any('DLASCL' in line or 'Traceback' in line for line in node.lines)


def test_a_start_that_cannot_be_is_a_warning_then_an_error_with_the_parameter(recording, peer):
    # given accelerations in g
    def in_g(name, i, message):
        if name == 'imu':
            force = message.linear_acceleration
            force.x, force.y, force.z = (part / STANDARD_GRAVITY for part in (force.x, force.y, force.z))

    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording, in_g)
        player.connect()
        # then it is a warning when that has lasted for some seconds, and an error later
        levels = {}
        for seconds in range(8, 60, 8):
            player.play(seconds)
            heard.wait(lambda d: True)
            levels[heard.level('filter')] = heard.message('filter')
        assert [*levels] == [0, 1, 2]
        assert all("set imu.acceleration_unit to 'g'" in message for message in levels.values()), levels
    node.wait()
    said = [line for line in node.lines if 'state: ' in line and 'imu.acceleration_unit' in line]
    assert any('WARN' in line for line in said) and any('ERROR' in line for line in said), said
    # and it is not said with each of the fixes
    assert sum('waiting for' in line and 'DEBUG' not in line for line in node.lines) < 15


def test_fixes_that_are_stamped_early_are_found_in_the_innovations(recording, peer):
    early = replace(recording, gnss=replace(recording.gnss, stamp=recording.gnss.stamp - 8 * SECOND // 10))
    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, early)
        player.connect()
        player.play()
        heard.wait(lambda d: d.values('filter').get('state') == 'degraded')
        assert heard.level('filter') == 1 and 'gnss.time_offset' in heard.message('filter')
