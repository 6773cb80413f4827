"""A slow robot with two receivers, odometry of its wheels and a pressure sensor is set up from a bag alone."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.cli.simulate import main as simulate
from mems_ins_fusion.configuration.baseline import estimate_baseline
from mems_ins_fusion.configuration.check import compare_mounting
from mems_ins_fusion.configuration.configure import configure
from mems_ins_fusion.configuration.regression import jackknife
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.params_file import load_yaml
from mems_ins_fusion.recordings.motion import find_standstill, scatter_at_rest, without_turns
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.simulation import manoeuvres
from mems_ins_fusion.simulation.scene import FLAT, REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

REAR = -0.9  # m, from the first antenna to the second
ROBOT = """/**:
  ros__parameters:
    gnss_topic: /front/fix
    gnss.lever_arm: [0.4, 0.0, 0.5]
    twist_topic: /wheel/odometry
    pressure_topic: /baro
    inputs: [rear]
    rear.type: fix
    rear.topic: /rear/fix
    rear.lever_arm: [-0.5, 0.0, 0.5]
"""


def driven(folder, speed, seed, *options):
    """A bag of a robot that drives at `speed` m/s and turns on the spot, with receivers of 2 cm."""
    (folder / 'robot.yaml').write_text(ROBOT)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(manoeuvres, 'ROBOT_SPEED', speed)
        assert not simulate(['--output', str(folder / 'bag'), '--duration', '600', '--seed', str(seed), '--drive',
                             'realistic', '--manoeuvres', 'slow', '--gnss-rate', '5', '--gnss-sigma', '0.02',
                             '--params-file', str(folder / 'robot.yaml'), *options])
    return folder / 'bag'


@pytest.fixture(scope='module')
def slow(tmp_path_factory):
    """A robot of 0.4 m/s, its IMU near the axle; yaw of the mounting: 4.7 deg."""
    return driven(tmp_path_factory.mktemp('slow'), 0.4, 21, '--axle-to-imu', '0.1', '0', '0.2')


@pytest.fixture(scope='module')
def found(slow):
    return configure([slow]).values


def test_all_that_it_has_is_found_at_0_4_m_per_s(found):
    # then each input is there, and the odometry rather than the speed of the same wheels
    assert found['gnss_topic'] == '/front/fix' and found['twist_topic'] == '/wheel/odometry'
    assert found['pressure_topic'] == '/baro' and found['inputs'] == ['rear_fix'] and 'speed_topic' not in found
    # and the second antenna is where it is
    off = np.array(found['rear_fix.lever_arm']) - found['gnss.lever_arm'] - [REAR, 0.0, 0.0]
    assert np.abs(off[:2]).max() < 0.05
    # and what is right as it is gets no factor, no turn and no other sigma
    assert not {'speed.factor', 'twist.factor', 'heading.offset', 'rear_fix.sigma'} & found.keys()
    assert table.check(found)


def test_the_yaw_of_its_mounting_is_as_sure_as_it_says(slow):
    mounting = configure([slow]).mounting
    assert mounting.yaw_known and np.degrees(mounting.sigma[2]) < 8.0
    assert abs(mounting.rpy[2] - 0.0819) < 2.0 * mounting.sigma[2]


def test_wheels_of_a_robot_whose_antenna_moves_sideways_in_turns_keep_their_scale(tmp_path):
    # given a robot of 0.8 m/s whose antenna is 1.6 m in front of the axle: above 1 m/s it moves in turns alone
    found = configure([driven(tmp_path, 0.8, 13, '--aiding')]).values
    assert not {'speed.factor', 'twist.factor', 'velocity.factor'} & found.keys()
    assert abs(found.get('heading.offset', 0.0)) < np.radians(5.0)


def test_turning_on_the_spot_is_no_rest(slow):
    # given the fixes of the first receiver, 2 cm; when their scatter is taken where nothing but the robot turns
    values = table.check(load_yaml(slow.parent / 'robot.yaml'))
    recording = read_recording(slow, values['imu_topic'], values['gnss_topic'])
    still = find_standstill(recording.imu, recording.gnss)
    assert scatter_at_rest(recording.gnss, recording.imu, still) > 0.1
    # then it is that of the receiver without the turns
    assert scatter_at_rest(recording.gnss, recording.imu, without_turns(still, recording.imu)) < 0.03


def test_two_antennas_at_walking_speed_and_below_show_their_distance(slow):
    values = table.check(load_yaml(slow.parent / 'robot.yaml'))
    first, second = (read_recording(slow, values['imu_topic'], topic).gnss for topic in ('/front/fix', '/rear/fix'))
    seen = estimate_baseline(first, second)
    assert abs(seen.arm[0] - REAR) < 4.0 * seen.arm_sigma[0] + 0.03 and abs(seen.late) < 4.0 * seen.late_sigma


def test_the_tool_simulates_what_the_params_file_names(slow):
    # then the second receiver has the rate of the first one, and what has a topic is there without --aiding
    assert len(read_recording(slow, '/imu/data', '/rear/fix').gnss) == 3000
    recording = read_recording(slow, '/imu/data', '/front/fix', twist_topic='/wheel/odometry', pressure_topic='/baro')
    assert len(recording.others['twist']) > 5900 and len(recording.others['pressure']) > 5900


def looked_at(seed, part, *receivers, scene=FLAT, since=0.0):
    """What is found until `part` s, from `since` on, of a robot's drive of ten minutes with each of `receivers` (sigma,
    m, and rate, Hz), beside the right mounting: findings and the estimate."""
    drive = replace(scene, manoeuvres='slow').drive(606.0, seed, 50.0, standstill=25.0)
    sensors = SensorErrors.from_parameters(table.check(scene.imu), 'gauss_markov')
    for sigma, rate in receivers:
        made = simulate_recording(drive, sensors, GnssNoise(sigma, rate), seed=seed,
                                  vibration=scene.distortions(seed)['vibration']).recording
        begin, end = (made.imu.stamp[0] + int(at * 1e9) for at in (since, part))
        imu, fixes = (samples.select((samples.stamp >= begin) & (samples.stamp < end))
                      for samples in (made.imu, made.gnss))
        yield compare_mounting(imu, fixes, table.defaults(), 0.0)


def test_noise_of_the_fixes_of_a_slow_robot_is_not_taken_for_its_speed():
    # given a robot of 0.4 m/s and fixes whose noise is faster than that; when its mounting is looked at as a live node
    # does
    for findings, found in looked_at(7701, 120.0, (0.5, 5.0), (0.5, 10.0)):
        # then nothing is said of the yaw, where it was told 40 deg off for certain
        assert findings == [] and not found.yaw_known
    # nor where it was told 66 deg off
    (findings, found), = looked_at(7704, 480.0, (0.5, 1.0), scene=REALISTIC, since=240.0)
    assert findings == [] and not found.yaw_known
    # and with fixes that show its speed it is known
    (findings, found), = looked_at(7701, 606.0, (0.02, 5.0))
    assert findings == [] and found.yaw_known and abs(found.rpy[2]) < 2.5 * found.sigma[2]


def test_turns_on_the_spot_do_not_turn_the_mounting():
    # given a robot that turns on the spot, its IMU 1.2 m in front of the axle, so that it goes sideways then
    (findings, found), = looked_at(7701, 606.0, (0.02, 5.0), scene=REALISTIC)
    # then the yaw, where it was told 15 deg off, is off by no more than its sigma says
    assert found.yaw_known and abs(found.rpy[2]) < 2.5 * found.sigma[2] and findings == []


def test_two_changes_of_speed_that_agree_are_not_taken_for_many():
    # given two minutes of a robot that hardly changes its speed; when its mounting is looked at
    (findings, found), = looked_at(7710, 120.0, (0.1, 5.0), scene=REALISTIC)
    # then the yaw, which was told 48 deg off for certain, is not contradicted
    assert findings == [] and abs(found.rpy[2]) < 3.0 * found.sigma[2]


def test_what_few_parts_of_a_drive_show_has_a_large_sigma():
    # given means over twenty parts of a drive of which three, or all, show something, drawn many times
    draw = np.random.default_rng(1)
    for shown in (np.r_[1.0, 1.0, 1.0, np.full(17, 1e-3)], np.ones(20)):
        values = draw.standard_normal((4000, 20)) / np.sqrt(shown)
        mean = (values * shown).sum(axis=1) / shown.sum()
        left_out = ((values * shown).sum(axis=1)[:, None] - values * shown) / (shown.sum() - shown)
        sigma = jackknife(left_out.T, shown)
        # then two sigma hold as many of them as with a normal distribution
        assert np.mean(np.abs(mean) < 2.0 * sigma) == pytest.approx(0.954, abs=0.02)
    # and what a single part shows is as good as not known
    assert jackknife(np.r_[1.0, np.zeros(19)], np.r_[1.0, np.full(19, 1e-6)]) > 100.0
