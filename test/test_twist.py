"""Odometry of others: what its twist gives the filter, live and replayed, and what wrong parts of it cost."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from live_support import lived, same_bits
from test_filter_displacement import drive, largest_errors

from mems_ins_fusion.configuration.check import SMALL_YAW, check_setup
from mems_ins_fusion.configuration.configure import configure
from mems_ins_fusion.configuration.odometry_axes import estimate_odometry_axes
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Kind, Verdict
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.checker import check_recording
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording


def config(**values):
    return FilterConfig.from_parameters(table.check({'twist_topic': '/odom', **values}))


def test_it_holds_a_position_as_well_as_a_wheel_speed():
    errors = {name: np.concatenate([largest_errors(recording, {name: recording.streams()[name]} if name else {})
                                    for recording in map(drive, (1, 2, 3))]) for name in ('', 'speed', 'twist')}
    assert errors['twist'].mean() < 1.1 * errors['speed'].mean() and errors['twist'].mean() < 0.7 * errors[''].mean()


@pytest.mark.parametrize(('turn', 'scale'), [(1.0, 0.0), (-1.0, -2.0), (1.5, 0.5)])
def test_the_turn_rate_may_count_the_other_way_or_have_a_track_that_is_not_known(turn, scale):
    # given a turn rate that is right, of the wrong sign, or half as much again, as of wheels that are skid-steered
    recording = drive(2)
    right = recording.others['twist']
    other = replace(right, twist=right.twist * [1, 1, turn])
    result = run(config(), recording.imu, recording.gnss, Aiding(twist=other))
    # then its scale is found, and within its sigma; the simulator's own is 3 %
    layout = result.config.layout
    at, sigma = layout.extras.index('twist_turn_scale'), result.sigma[-1, layout.index('twist_turn_scale')]
    found = result.extras[-1, at]
    own = run(config(), recording.imu, recording.gnss, Aiding(twist=right)).extras[-1, at]
    assert found == pytest.approx((1.0 + own) * turn - 1.0, abs=4.0 * sigma) and sigma < 0.03
    assert found == pytest.approx(scale, abs=0.1 * abs(turn) + 4.0 * sigma)
    # and the gyroscope's bias is the same
    assert result.sensor_errors[-1, 5] == pytest.approx(run(config(), recording.imu, recording.gnss, Aiding(
        twist=right)).sensor_errors[-1, 5], abs=3.0 * result.sigma[-1, result.config.layout.index('w_z')])


def test_what_it_does_not_measure_is_not_taken_for_zero():
    # given an odometry that knows no turn rate, and one whose sideways velocity is measured
    recording = drive(2)
    right = recording.others['twist']
    assert not right.twist[:, 1].any()
    still = replace(right, twist=right.twist * [1.0, 1.0, 0.0], variance=np.full_like(right.variance, 1e-6))
    speed = largest_errors(recording, {'speed': recording.speed})
    # then that is as a wheel speed
    assert largest_errors(recording, {'twist': still}).mean() < 1.5 * speed.mean() + 1.0
    result = run(config(), recording.imu, recording.gnss, Aiding(twist=still))
    assert result.measured.verdicts(Kind.TWIST).get(Verdict.REFUSED, 0) < 0.05 * len(right)


def test_live_and_replay_give_the_same_bits():
    recording = drive(2)
    twist, given = recording.others['twist'], config()
    replayed = run(given, recording.imu, recording.gnss, Aiding(twist=twist))
    same_bits(replayed, lived(FusionFilter(given), recording, 'twist', upto=2700), 1500)


def test_a_bag_keeps_it_and_the_checker_names_the_factor(tmp_path):
    recording = drive(2)
    twist = recording.others['twist']
    in_cm = replace(twist, twist=twist.twist * [100.0, 100.0, 1.0], variance=twist.variance * [1e4, 1e4, 1.0])
    write_recording(recording.having({'twist': in_cm}), tmp_path / 'bag')
    read = read_recording(tmp_path / 'bag', '/imu/data', '/gps/fix', twist_topic='/wheel/odometry')
    assert np.array_equal(read.others['twist'].twist, in_cm.twist)
    assert np.array_equal(read.others['twist'].variance, in_cm.variance)
    worse = [f.message for f in check_recording(read, table.defaults()) if f.topic == 'twist' and f.severity == 'error']
    assert not worse or 'set twist.factor to 0.01' in worse[0]
    said = [f.message for f in check_recording(read, table.defaults()) if f.topic == 'twist']
    assert any('set twist.factor to 0.01' in message for message in said)
    assert not [f for f in check_recording(read, table.check({'twist.factor': 0.01}))
                if f.topic == 'twist' and f.severity in ('warning', 'error')]


def test_a_twist_that_is_none_is_dropped_with_its_numbers():
    fusion, recording = FusionFilter(config()), drive(2)
    for i in range(600):
        fusion.add_imu(int(recording.imu.stamp[i]), *recording.imu.specific_force[i].tolist(),
                       *recording.imu.angular_rate[i].tolist())
    for value in ([np.nan, 0.0, 0.0], [1e300, 0.0, 0.0], [1.0, np.inf, 0.0]):
        fusion.add('twist', int(recording.imu.stamp[599]), np.array(value), np.zeros(3))
        assert any('dropped' in notice.text and '/odom' in notice.text for notice in fusion.notices())


@pytest.mark.parametrize('yaw', [-0.06, 0.0, 0.25])
def test_the_angle_of_an_odometry_is_found_by_filter_configure_and_checker(yaw, tmp_path):
    # given a lidar's odometry that also knows the velocity sideways, in axes turned to the left by `yaw`
    made = simulate_recording(simulate_drive(240.0, 4, 50.0, standstill=20.0), SensorErrors.from_parameters(
        table.defaults(), 'gauss_markov'), GnssNoise(0.5, 2.0), [(EFFECTS['twist_yaw'], {'yaw': yaw})], seed=4,
        aiding=SimulatedAiding(twist_rate=10.0, twist_lateral_sigma=0.05)).recording
    # when the filter knows nothing of it
    result = run(config(), made.imu, made.gnss, Aiding(twist=made.others['twist']))
    at = result.config.layout.extras.index('twist_yaw')
    sigma = result.sigma[-1, result.config.layout.index('twist_yaw')]
    # then it is a state, as sure as it says, and the odometry is used
    assert result.extras[-1, at] == pytest.approx(yaw, abs=4.0 * sigma) and sigma < 0.01
    assert result.measured.verdicts(Kind.TWIST).get(Verdict.REFUSED, 0) < 0.05 * len(made.others['twist'])
    # and without a filter it is found as well
    axes = estimate_odometry_axes(made.others['twist'])
    assert axes.yaw == pytest.approx(yaw, abs=3.0 * axes.sigma) and axes.sigma < 0.005
    write_recording(made, tmp_path / 'bag', twist_topic='/lidar/odometry')
    values = configure([tmp_path / 'bag']).values
    assert values['twist.yaw'] == pytest.approx(yaw, abs=0.01)
    large = [f for f in check_setup(made, table.check({**values, 'twist.yaw': 0.0})) if 'set twist.yaw' in f.message]
    assert len(large) == (abs(yaw) > SMALL_YAW)
    assert not [f for f in check_setup(made, table.check(values)) if 'set twist.yaw' in f.message]


def test_wheels_beside_the_imu_are_found_and_not_taken_for_late_stamps():
    # given a vehicle whose IMU sits 0.6 m to the left of the middle of its axle: in a bend it is faster or slower
    made = simulate_recording(
        simulate_drive(240.0, 4, 50.0, standstill=20.0, axle_to_imu=(1.0, -0.6, 0.0)), SensorErrors.from_parameters(
            table.defaults(), 'gauss_markov'), GnssNoise(0.5, 2.0), seed=4,
        aiding=SimulatedAiding(twist_rate=20.0)).recording
    # when the filter knows nothing of it
    result = run(config(), made.imu, made.gnss, Aiding(twist=made.others['twist']))
    # then it is a state, as sure as it says, and the odometry's stamps are right
    found = {name: (value, result.sigma[-1, result.config.layout.index(name)])
             for name, value in zip(result.config.layout.extras, result.extras[-1])}
    across, sigma = found['axle_y']
    assert across == pytest.approx(0.6, abs=4.0 * sigma) and sigma < 0.15
    late, sigma = found['twist_time_offset']
    assert late == pytest.approx(0.0, abs=4.0 * sigma) and sigma < 0.03
    # and it is one state where there is a wheel speed, too
    assert config(speed_topic='/speed').layout.extras.count('axle_y') == 1
