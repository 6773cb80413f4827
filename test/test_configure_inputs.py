"""`configure` finds what a recording has besides IMU and receiver: kind, unit, place and clock of each topic."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.configuration.baseline import estimate_baseline
from mems_ins_fusion.configuration.configure import configure
from mems_ins_fusion.configuration.inputs import UnusedTopic, clock_of, shown_inputs
from mems_ins_fusion.configuration.mounting import Mounting
from mems_ins_fusion.configuration.turn_offset import estimate_turn_offset
from mems_ins_fusion.configuration.velocity_offset import estimate_velocity_offset
from mems_ins_fusion.effects.aiding_time_offset import time_offset_of
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.registry import aiding, further_inputs
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.aiding import forward_speed
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.samples import Aiding, Fixes, Speeds, Velocities
from mems_ins_fusion.simulation import manoeuvres
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

MOUNTING = (0.02, 0.05, 0.4)
FRONT, REAR = [0.8, 0.0, 1.0], [-0.8, 0.3, 1.0]
TWO_RECEIVERS = {'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': '/rear/fix', 'rear.lever_arm': REAR}
TWO_WHEELS = {'inputs': ['left', 'right'], 'left.type': 'speed', 'left.topic': '/wheels/left',
              'left.lever_arm': [0.0, 0.75, -0.5], 'right.type': 'speed', 'right.topic': '/wheels/right',
              'right.lever_arm': [0.0, -0.75, -0.5]}


def recorded(given, late=None, seed=3, sigma=0.5, **errors):
    """A drive of five minutes with the inputs of `given`. late: s, by input."""
    values = table.check({'gnss.lever_arm': FRONT, **given})
    drive = simulate_drive(300.0, seed, 50.0, standstill=20.0, hills=True, pitch_per_acceleration=0.005,
                           axle_to_imu=(1.0, 0.0, 0.0))
    effects = [(EFFECTS['gnss_lever_arm'], dict(zip('xyz', FRONT))),
               *((time_offset_of(name), {'time_offset': seconds}) for name, seconds in (late or {}).items())]
    made = simulate_recording(drive, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'),
                              GnssNoise(sigma, 2.0), effects, MOUNTING, seed,
                              aiding=SimulatedAiding(fix_rate=2.0, fix_sigma=sigma, **errors),
                              named=[one for one in aiding(values) if not one.is_plain])
    return made.recording, values


def written(recording, values, path, **topics):
    named = {one.topic: values[one.topic] for one in further_inputs(values) if values[one.topic]}
    write_recording(recording, path, imu_topic='/imu/data', gnss_topic='/front/fix', inputs=further_inputs(values),
                    **{**named, **topics})
    return path


def settings_of(path):
    found = configure([path])
    assert table.check(found.values)
    return found.values, {setting.name: ' '.join(setting.why) for setting in found.settings}


@pytest.fixture(scope='module')
def robot(tmp_path_factory):
    """Two receivers 1.6 m apart, wheel odometry 0.2 s late and a pressure in hPa: the bag, and what configure finds."""
    made, values = recorded(TWO_RECEIVERS, {'twist': 0.2}, twist_rate=20.0, pressure_rate=10.0)
    pressure = made.streams()['pressure']
    made = made.having({'pressure': replace(pressure, pressure=pressure.pressure / 100.0)})
    path = written(made, values, tmp_path_factory.mktemp('bags') / 'robot', twist_topic='/wheel/odometry',
                   pressure_topic='/baro')
    return path, settings_of(path)[0]


def test_a_robot_with_two_receivers_odometry_and_pressure_is_set_up_from_a_bag(robot):
    _, values = robot
    # then the second receiver is an input with a name, its antenna where it is from the first one
    assert values['inputs'] == ['rear_fix'] and values['rear_fix.type'] == 'fix'
    off = np.array(values['rear_fix.lever_arm']) - values['gnss.lever_arm'] - np.subtract(REAR, FRONT)
    assert np.abs(off[:2]).max() < 3.0 * values['rear_fix.lever_arm_sigma'] < 0.5
    assert values['rear_fix.time_offset'] == pytest.approx(values['gnss.time_offset'], abs=0.05)
    # and the odometry is one, with its clock; the pressure is in Pa once it is multiplied
    assert values['twist_topic'] == '/wheel/odometry' and values['twist.time_offset'] == pytest.approx(0.2, abs=0.03)
    assert values['pressure_topic'] == '/baro' and values['pressure.factor'] == 100.0
    assert 'speed_topic' not in values and 'velocity_topic' not in values
    # and the reference is left alone
    assert '/reference/fix' not in values.values()


def test_what_configure_writes_is_better_than_the_first_receiver_alone(robot):
    path, values = robot
    checked = table.check(values)
    topics = {one.topic: checked[one.topic] for one in aiding(checked) if checked[one.topic]}
    recording = read_recording(path, '/imu/data', '/front/fix', '/reference/fix', inputs=aiding(checked), **topics)
    alone = table.check({name: value for name, value in values.items() if name.split('.')[0] not in (
        'inputs', 'rear_fix', 'twist_topic', 'twist', 'pressure_topic', 'pressure')})

    def error(of, samples):
        result = run(FilterConfig.from_parameters(of), recording.imu, recording.gnss, samples)
        time = recording.reference.stamp
        at = np.searchsorted(result.stamp, time[time > time[0] + 60 * 10**9])
        inside = at < len(result.stamp)
        north = (result.latitude[at[inside]] - recording.reference.latitude[-len(at):][inside]) * 6.37e6
        east = (result.longitude[at[inside]] - recording.reference.longitude[-len(at):][inside]) * 6.37e6 * np.cos(
            recording.reference.latitude[0])
        # the arm of the first antenna is not shown, and moves all of it alike
        return float(np.hypot(np.std(north), np.std(east)))

    assert error(checked, Aiding(recording.streams())) < error(alone, Aiding())


@pytest.mark.parametrize('per', [3.6, -1.0])
def test_a_car_with_a_speed_a_velocity_and_a_heading_is_set_up_from_a_bag(per, tmp_path):
    # given a speed in km/h or of the other sign, 0.3 s late, a velocity of the receiver and a heading of two antennas
    # that are 0.5 and 0.4 s late
    late = {'speed': 0.3, 'velocity': 0.5, 'heading': 0.4}
    made, values = recorded({}, late, speed_rate=20.0, velocity_rate=5.0, heading_rate=5.0)
    speed, heading = made.streams()['speed'], made.streams()['heading']
    made = made.having({'speed': replace(speed, speed=per * speed.speed),
                        'heading': replace(heading, yaw=heading.yaw + 1.0)})
    path = written(made, values, tmp_path / 'car', speed_topic='/can/speed', velocity_topic='/receiver/vel',
                   heading_topic='/gps/heading')
    found, why = settings_of(path)
    # then each is what it is, though speed and velocity have one type of message
    assert found['speed_topic'] == '/can/speed' and found['velocity_topic'] == '/receiver/vel'
    assert found['speed.factor'] == pytest.approx(1.0 / per, rel=0.03)
    assert found['speed.time_offset'] == pytest.approx(0.3, abs=0.05)
    assert found['velocity.time_offset'] == pytest.approx(0.5, abs=0.1)
    assert found['heading_topic'] == '/gps/heading' and found['heading.offset'] == pytest.approx(1.0, abs=0.05)
    assert found['heading.time_offset'] == pytest.approx(0.4, abs=0.05)
    # and that the heading's topic, which is of the IMU's type, is no IMU does not read as if it were useless
    assert '0% usable as an IMU' in why['imu_topic']


def test_the_wheels_of_both_sides_have_names_and_places(tmp_path):
    made, values = recorded(TWO_WHEELS)
    found, _ = settings_of(written(made, values, tmp_path / 'wheels'))
    assert found['inputs'] == ['wheels_left', 'wheels_right'] and 'speed_topic' not in found
    for name, true in (('wheels_left', 0.75), ('wheels_right', -0.75)):
        assert found[f'{name}.type'] == 'speed' and found[f'{name}.lever_arm'][1] == pytest.approx(true, abs=0.3)


def _dead(samples, part):
    values = getattr(samples, part)
    return replace(samples, **{part: np.broadcast_to(values[len(values) // 3], values.shape).copy()})


def test_an_input_that_is_the_same_in_every_message_is_not_used(tmp_path):
    # given a drive whose further sensors all repeat one value, which each had in motion; the drive goes mainly north,
    # so that a heading that stays the same follows its course most of the time
    made, values = recorded({}, speed_rate=10.0, velocity_rate=5.0, twist_rate=10.0, heading_rate=5.0,
                            pressure_rate=5.0)
    found = made.streams()
    made = made.having({name: _dead(found[name], part) for name, part in (
        ('speed', 'speed'), ('velocity', 'velocity'), ('twist', 'twist'), ('heading', 'yaw'),
        ('pressure', 'pressure'))})
    found, why = settings_of(written(made, values, tmp_path / 'dead', heading_topic='/gps/heading'))
    # then none is set, and why is said of each
    assert not found.keys() & {f'{name}_topic' for name in ('speed', 'velocity', 'twist', 'heading', 'pressure')}
    assert found['inputs'] == [] and why['inputs'].count('is the same in every message') == 5


def test_an_input_whose_messages_come_twice_is_said(tmp_path):
    # given a speed and a pressure of which each message is there twice, and a heading that is right
    made, values = recorded({}, speed_rate=10.0, heading_rate=5.0, pressure_rate=5.0)
    found = made.streams()
    made = made.having({name: found[name].select(np.repeat(np.arange(len(found[name])), 2))
                        for name in ('speed', 'pressure')})
    said = configure([written(made, values, tmp_path / 'twice', heading_topic='/gps/heading')]).wrong
    # then it is said of these
    said = [text for text in said if 'repeated from the message before' in text]
    assert len(said) == 2 and {text[0] for text in said} == {'/'}
    assert any(f": {len(found['speed'])} stamps repeated" in text for text in said)


@pytest.mark.parametrize('value', [0.0, 9.81, np.nan])
def test_a_second_imu_that_is_dead_is_called_one(value, tmp_path):
    # given a bag with a second topic of an IMU's messages, all the same
    made, values = recorded({'inputs': ['second'], 'second.type': 'imu', 'second.topic': '/second'})
    dead = np.full(made.imu.specific_force.shape, value)
    made = made.having({'second': replace(made.imu, specific_force=dead, angular_rate=dead)})
    found, why = settings_of(written(made, values, tmp_path / 'dead'))
    assert found['imu_topic'] == '/imu/data' and found['inputs'] == []
    assert '/second is not used: most of its rates and forces are the same in every message' in why['inputs']


@pytest.mark.parametrize('change, text', [
    (lambda v: 3.6 * v, 'it seems to be in km/h instead of m/s'), (lambda v: -v, 'it seems to be of the opposite sign'),
    (lambda v: v[:, [1, 0, 2]], 'it seems to be north-east-down instead of east-north-up')])
@pytest.mark.parametrize('topic', ['/gps/velocity', '/vel'])
def test_a_velocity_in_another_unit_or_frame_is_no_speed_of_wheels(topic, change, text):
    # given a velocity on a road that goes east most of the time, so that its first component goes with the speed
    stamp = np.arange(0, 300 * 10**9, 10**9 // 5)
    time = stamp * 1e-9
    speed, course = 8.0 + 4.0 * np.sin(time / 20.0), 0.5 * np.pi + 0.5 * np.sin(time / 30.0)
    north, east = speed * np.cos(course), speed * np.sin(course)
    fixes = Fixes(stamp, stamp, *(np.cumsum(part) * 0.2 / 6.378e6 for part in (north, east)), np.zeros(len(time)),
                  np.tile(0.1**2 * np.eye(3), (len(time), 1, 1)), np.zeros(len(time), np.int8),
                  np.full(len(time), 2, np.uint8))
    read = {'velocity': Velocities(stamp, stamp, change(np.column_stack([north, east, np.zeros(len(time))])),
                                   np.tile(0.01 * np.eye(3), (len(time), 1, 1))),
            'speed': Speeds(stamp, stamp, change(np.column_stack([north, east, 0.0 * east]))[:, 1],
                            np.full(len(time), 0.01))}
    # then it is left out, with what is wrong
    [found] = shown_inputs({topic: read}, {}, None, fixes, np.zeros(0, bool), None)
    assert isinstance(found, UnusedTopic) and text in found.why


def test_of_an_odometry_that_turns_the_other_way_round_only_the_speed_is_used(tmp_path):
    made, values = recorded({}, twist_rate=20.0)
    twist = made.streams()['twist']
    made = made.having({'twist': replace(twist, twist=twist.twist * [1.0, 1.0, -1.0])})
    found, why = settings_of(written(made, values, tmp_path / 'turned', twist_topic='/wheel/odometry'))
    assert found['speed_topic'] == '/wheel/odometry' and 'twist_topic' not in found
    assert 'its turn rate has the opposite sign' in why['speed_topic']


@pytest.mark.parametrize('arm', [[1.5, 0.0, 0.0], [-1.0, 0.0, 0.0]])
def test_where_an_odometry_is_ahead_of_the_axle_shows_in_its_velocity_sideways(arm, tmp_path):
    # given a lidar whose odometry knows the velocity sideways, in front of the IMU or at the axle, 1 m behind it
    made, values = recorded({'inputs': ['lidar'], 'lidar.type': 'twist', 'lidar.topic': '/lidar/odometry',
                             'lidar.lever_arm': arm}, twist_rate=10.0, twist_lateral_sigma=0.05)
    made = replace(made, others={'lidar': made.streams()['lidar']})
    # when
    found, why = settings_of(written(made, values, tmp_path / 'bag'))
    # then in front it is an input with a name and its place; at the axle it is the odometry that the filter expects
    if arm[0] < 0.0:
        assert found['twist_topic'] == '/lidar/odometry' and not found.get('inputs')
        return
    [name] = found['inputs']
    assert found[f'{name}.type'] == 'twist' and found[f'{name}.topic'] == '/lidar/odometry'
    assert found[f'{name}.lever_arm'] == pytest.approx(arm, abs=0.3)
    assert 'm forward' in why[f'{name}.lever_arm']


def test_what_is_a_result_or_the_same_sensor_twice_is_not_used(tmp_path):
    # given the same receiver on another topic, with the last digits rounded, the same wheels again, a fused odometry
    made, values = recorded({**TWO_WHEELS, 'inputs': ['rear', 'left', 'right'], 'rear.type': 'fix',
                             'rear.topic': '/nmea/fix', 'left.topic': '/wheels/speed', 'right.topic': '/can/speed',
                             'left.lever_arm': [0.0] * 3, 'right.lever_arm': [0.0] * 3})
    again = replace(made.gnss, latitude=np.round(made.gnss.latitude, 8), longitude=np.round(made.gnss.longitude, 8))
    made = made.having({'rear': again, 'right': made.streams()['left']})
    path = written(made, values, tmp_path / 'twice')
    found, why = settings_of(path)
    assert found['inputs'] == [] and found['speed_topic'] == '/can/speed'
    assert '/nmea/fix is not used: neither another place' in why['inputs']
    assert 'it is not shown to measure anything but what /can/speed does' in why['inputs']


def test_the_baseline_of_two_antennas_has_an_honest_sigma():
    errors = []
    for seed in range(8):
        made, _ = recorded(TWO_RECEIVERS, {'rear': 0.15}, seed=seed, sigma=0.3)
        found = estimate_baseline(made.gnss, made.others['rear'])
        errors += list(((found.arm - np.subtract(REAR, FRONT)) / found.arm_sigma)[:2])
        errors.append((found.late - 0.15) / found.late_sigma)
    # then root mean square 1, within the bounds of a chi-square distribution with 24 degrees of freedom, 0.1 %
    assert 0.55 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_antennas_at_rest_show_their_distance_before_courses_show_it():
    # given robots of 0.4 m/s, whose courses tell little, with two receivers of 2 cm
    distance, errors, sigmas = np.hypot(*np.subtract(REAR, FRONT)[:2]), [], []
    values = table.check({'gnss.lever_arm': FRONT, **TWO_RECEIVERS})
    for seed in range(4):
        drive = simulate_drive(200.0, seed, 50.0, standstill=25.0, manoeuvres=manoeuvres.SLOW)
        made = simulate_recording(drive, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'),
                                  GnssNoise(0.02, 5.0), [(EFFECTS['gnss_lever_arm'], dict(zip('xyz', FRONT)))],
                                  seed=seed, aiding=SimulatedAiding(fix_rate=5.0, fix_sigma=0.02),
                                  named=[one for one in aiding(values) if not one.is_plain]).recording
        found = estimate_baseline(made.gnss, made.others['rear'])
        errors.append(np.hypot(*found.arm[:2]) - distance)
        sigmas.append(found.arm_sigma[0])
    # then they are as far apart as they are, to less than the noise of a fix, and forward is known to centimetres
    assert np.max(np.abs(errors)) < 0.02 and np.max(sigmas) < 0.06


@pytest.mark.parametrize('late', [0.0, 0.12])
def test_what_is_not_known_of_the_time_offset_of_the_fixes_is_left_to_the_filter(late, tmp_path):
    # given a car with wheel speed whose fixes of 1 m are right, or 0.12 s late
    made, values = recorded({'speed_topic': '/can/speed'}, {'gnss': late}, seed=5, sigma=1.0, speed_rate=20.0)
    found, why = settings_of(written(made, values, tmp_path / 'bag'))
    # then the sigma of what is set is told
    left, sigma = late - found['gnss.time_offset'], found['gnss.time_offset_sigma']
    assert abs(left) < 3.0 * sigma and 0.01 <= sigma < 0.25
    assert 'the filter estimates what is left of it' in why['gnss.time_offset_sigma']


@pytest.mark.parametrize('sense', [1.0, -0.7])
def test_a_turn_rate_tells_its_clock_in_either_sense(sense):
    made, _ = recorded({}, {'twist': -0.12}, twist_rate=10.0)
    twist = made.streams()['twist']
    twist = replace(twist, twist=twist.twist * [1.0, 1.0, sense])
    found = estimate_turn_offset(made.imu, twist, rotation_from_rpy(*MOUNTING)[2])
    assert found.lag == pytest.approx(-0.12, abs=3.0 * found.lag_sigma) and found.lag_sigma < 0.03
    assert np.sign(found.correlation) == np.sign(sense) and abs(found.correlation) > 0.9
    # and a turn rate that never is one tells nothing
    assert estimate_turn_offset(made.imu, replace(twist, twist=0.0 * twist.twist), np.eye(3)[2]) is None


def test_a_low_pass_is_searched_only_where_the_turn_rate_does_not_agree_enough_without_one():
    # given an odometry through a low pass of 1.5 s
    made = simulate_recording(simulate_drive(300.0, 3, 50.0, standstill=20.0),
                              SensorErrors.from_parameters(table.defaults(), 'gauss_markov'), GnssNoise(0.5),
                              [(EFFECTS['twist_lag'], {'tau': 1.5})], seed=3,
                              aiding=SimulatedAiding(twist_rate=10.0)).recording
    alike, little, much = (estimate_turn_offset(made.imu, made.streams()['twist'], np.eye(3)[2], enough)
                           for enough in (0.9, 0.99, 1.0))
    # then it is not searched where the correlation without one is enough, and else found
    assert alike.low_pass is None and 0.9 < alike.correlation < 0.99 < little.correlation
    assert little == much and much.low_pass.tau == pytest.approx(1.5, abs=0.05)


@pytest.mark.parametrize('tau, late, rate', [(0.6, 0.2, 10.0), (1.0, -0.1, 10.0), (0.0, 0.15, 10.0), (0.6, 0.2, 2.0)])
def test_a_heading_tells_its_low_pass_beside_its_clock(tau, late, rate):
    # given a heading through a low pass, stamped late besides
    effects = [(EFFECTS['heading_lag'], {'tau': tau})] if tau else []
    made = simulate_recording(simulate_drive(600.0, 62, 50.0, standstill=25.0),
                              SensorErrors.from_parameters(table.defaults(), 'gauss_markov'), GnssNoise(0.5), effects,
                              seed=62, aiding=SimulatedAiding(heading_rate=rate)).recording
    heading = replace(made.heading, stamp=made.heading.stamp + round(late * 1e9))
    clock = clock_of('heading', heading, made.imu, None, Mounting(np.eye(3), np.zeros(3)))
    if rate < 4.0:
        assert clock.low_pass is None  # the mean over half a second would look like one
        return
    # then the offset is that of both, and the low pass is told apart from it
    lag, sigma = clock.lag
    assert lag == pytest.approx(late + tau, abs=3.0 * sigma) and sigma < 0.03
    assert clock.low_pass.certain == (tau > 0.0)
    assert clock.low_pass.tau == pytest.approx(tau, abs=3.0 * clock.low_pass.sigma)
    assert tau == 0.0 or clock.low_pass.sigma < 0.05


def test_of_an_odometry_the_turn_rate_tells_a_low_pass_that_the_speed_leaves_open():
    # given an odometry through a low pass of 0.42 s, in the speed of which the springs of the body look like one of 0.3
    made = simulate_recording(simulate_drive(400.0, 58, 50.0, standstill=25.0),
                              SensorErrors.from_parameters(table.defaults(), 'gauss_markov'), GnssNoise(0.5),
                              [(EFFECTS['twist_lag'], {'tau': 0.42})], seed=58,
                              aiding=SimulatedAiding(twist_rate=50.0)).recording
    mounting = Mounting(np.eye(3), np.full(3, 0.01))
    by_speed = clock_of('speed', forward_speed(made.streams()['twist']), made.imu, None, mounting).low_pass
    found = clock_of('twist', made.streams()['twist'], made.imu, None, mounting)
    # then the turn rate makes it certain
    assert not by_speed.certain
    assert found.low_pass.certain and found.low_pass.tau == pytest.approx(0.42, abs=3.0 * found.low_pass.sigma)
    assert found.lag[0] == pytest.approx(0.42, abs=3.0 * found.lag[1])


def test_an_odometry_is_one_where_the_yaw_of_the_mounting_is_not_known():
    # given a robot whose drive shows the up axis of its IMU, but not its yaw
    made, _ = recorded({}, {'twist': 0.15}, twist_rate=10.0)
    rotation, still = rotation_from_rpy(*MOUNTING), np.zeros(len(made.imu), dtype=bool)
    mounting = Mounting(rotation, np.array([0.01, 0.01, np.inf]))
    twist = made.streams()['twist']
    read = {'/odom': {'speed': forward_speed(twist), 'twist': twist}}
    shown, = shown_inputs(read, {}, made.imu, made.gnss, still, mounting)
    # then its turn rate is that of the gyroscopes, and tells its clock
    assert shown.measurement.name == 'twist'
    assert shown.lag[0] == pytest.approx(0.15, abs=3.0 * shown.lag[1]) and shown.lag[1] < 0.03


@pytest.mark.parametrize('rate', [1.0, 5.0])
def test_the_clock_of_a_slow_robots_velocity_is_as_sure_as_it_says(rate, monkeypatch):
    # given robots of 0.8 m/s with fixes of 2 cm and velocities of 0.1 m/s once a second, 0.2 s late
    monkeypatch.setattr(manoeuvres, 'ROBOT_SPEED', 0.8)
    errors, sigmas = [], []
    for seed in range(1, 7):
        drive = simulate_drive(600.0, seed, 50.0, standstill=25.0, manoeuvres=manoeuvres.SLOW)
        made = simulate_recording(drive, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'),
                                  GnssNoise(0.02, rate), seed=seed, aiding=SimulatedAiding(velocity_rate=1.0)).recording
        late = replace(made.velocity, stamp=made.velocity.stamp + 200_000_000)
        found = estimate_velocity_offset(late, made.gnss)
        errors.append(found.lag - 0.2)
        sigmas.append(found.lag_sigma)
    # then the errors are of the size that is told, and that is of use
    assert np.sqrt(np.mean(np.square(np.divide(errors, sigmas)))) < 1.4, (errors, sigmas)
    assert np.median(sigmas) < 0.1
