"""Poses of a lidar or a camera as an input: only the way between them counts, wherever and however they begin."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mems_ins_fusion.configuration.configure import configure
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.base import ODOMETRY
from mems_ins_fusion.filter.measurements.pose import LONGEST_APART, between
from mems_ins_fusion.filter.measurements.registry import TYPES, aiding
from mems_ins_fusion.filter.runs.replay import run_with_outages
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

SECOND = 10**9
LIDAR = {'inputs': ['lidar'], 'lidar.type': 'pose', 'lidar.topic': '/lidar/odometry',
         'lidar.lever_arm': [1.2, 0.0, 0.5]}


@pytest.fixture(scope='module')
def drive():
    """Four minutes with fixes of 0.5 m and a lidar that tells poses: checked values and the recording."""
    values = table.check(LIDAR)
    path = simulate_drive(240.0, 3, 50.0, standstill=20.0, hills=True)
    made = simulate_recording(path, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'), GnssNoise(0.5, 2.0),
                              seed=3, aiding=SimulatedAiding(twist_scale=0.0), named=[aiding(values)[-1]])
    return values, made.recording


def test_a_circle_is_a_velocity_forwards_and_a_turn_rate():
    # given a vehicle that goes round to the left at 2 m/s and 0.5 rad/s, 10 times a second, in a frame turned about
    turn, speed, step = 0.5, 2.0, 0.1
    angle = turn * step * np.arange(20)
    place = speed / turn * np.column_stack([np.sin(angle), 1.0 - np.cos(angle), np.zeros(20)])
    frame = Rotation.from_euler('zyx', [2.0, 0.3, -0.4])
    attitude = frame * Rotation.from_rotvec(np.column_stack([np.zeros((20, 2)), angle]))
    # when
    twist = between(np.full(19, step), frame.apply(place) + [100.0, -50.0, 3.0], 3.0 * attitude.as_quat())
    # then it is the chord along the nose, nothing sideways, and the turn is counter-clockwise
    chord = 2.0 * speed / turn * np.sin(0.5 * turn * step) / step
    assert twist == pytest.approx(np.tile([chord, 0.0, -turn], (19, 1)), abs=1e-9)


@pytest.mark.parametrize('wrong', ['no step', 'too long', 'NaN', 'no orientation'])
def test_what_is_no_way_is_not_one(wrong):
    step, place, attitude = np.full(3, 0.1), np.zeros((4, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (4, 1))
    if wrong in ('no step', 'too long'):
        step[1] = 0.0 if wrong == 'no step' else LONGEST_APART + 0.1
    elif wrong == 'NaN':
        place[2, 1] = np.nan
    else:
        attitude[2] = 0.0
    twist = between(step, place, attitude)
    assert np.isnan(twist[1]).all() and not np.isnan(twist[0]).any()
    # and the measurement says so of the one that it cannot use
    n = np.zeros(3, dtype=np.int64)
    values = table.check(LIDAR)
    lidar = aiding(values)[-1]
    _, reasons, _ = lidar.events(lidar.settings(values), lidar.samples(n, n, twist, twist * np.nan, place[1:],
                                                                        attitude[1:], n))
    assert 'a pose that is not finite, or not 0 to 1 s after' in reasons[1] and 0 not in reasons


def test_a_bag_of_poses_is_read_as_what_lies_between_them(drive, tmp_path):
    values, recording = drive
    write_recording(recording, tmp_path / 'bag', inputs=aiding(values), **{'lidar.topic': '/lidar/odometry'})
    read = read_recording(tmp_path / 'bag', '/imu/data', '/gps/fix', inputs=aiding(values),
                          **{'lidar.topic': '/lidar/odometry'}).others['lidar']
    written = recording.others['lidar']
    assert len(read) == len(written) - 1
    assert read.twist == pytest.approx(written.twist[1:], abs=1e-9)
    assert np.abs(read.stamp - written.stamp[1:]).max() <= 1


def errors_without_fixes(values, recording, samples):
    begin = recording.imu.stamp[0] + np.arange(60, 180, 15) * SECOND
    config = FilterConfig.from_parameters(values)
    _, found = run_with_outages(config, recording.imu, recording.gnss, begin, 30.0, samples)
    reference, errors = recording.reference, []
    for k in range(len(found.begin)):
        last = found.first[k + 1] - 1
        stamp = found.run.stamp[last]
        north, east = ((np.interp(stamp, reference.stamp, getattr(reference, name)) - getattr(found.run, name)[last])
                       * 6.37e6 for name in ('latitude', 'longitude'))
        errors.append(np.hypot(north, east * np.cos(reference.latitude[0])))
    return np.array(errors)


def test_without_fixes_it_is_worth_an_odometry(drive):
    values, recording = drive
    alone = errors_without_fixes(values, recording, Aiding())
    with_poses = errors_without_fixes(values, recording, Aiding(recording.others))
    assert len(alone) > 6
    assert with_poses.max() < 5.0 < alone.max() and with_poses.mean() < 0.5 * alone.mean()


def test_its_own_frame_moved_and_turned_gives_the_same(drive):
    # given the same poses of a frame that is elsewhere and turned by two radians
    values, recording = drive
    lidar, turned = recording.others['lidar'], Rotation.from_rotvec([0.0, 0.0, 2.0])
    moved = TYPES['pose'].read({
        'stamp': lidar.later, 'received': lidar.received,
        'pose.pose.position': turned.apply(lidar.position) + [5e5, 4e6, 100.0],
        'pose.pose.orientation': (turned * Rotation.from_quat(lidar.orientation)).as_quat()}, ODOMETRY)
    assert moved.twist == pytest.approx(lidar.twist[1:], abs=1e-6)


@pytest.mark.parametrize('twist', ['empty', 'that of wheels'])
def test_configure_takes_poses_only_of_an_odometry_that_has_no_twist(drive, twist, tmp_path):
    values, recording = drive
    write_recording(recording, tmp_path / 'bag', inputs=aiding(values), **{'lidar.topic': '/lidar/odometry'})
    if twist != 'empty':
        kind = TYPES['twist'].named('wheels', 100)
        lidar = recording.others['lidar']
        twists = kind.samples(lidar.stamp, lidar.received, lidar.twist, np.full(lidar.twist.shape, 0.01))
        write_recording(replace(recording, others={'wheels': twists}), tmp_path / 'bag', inputs=(kind,), overwrite=True,
                        **{'wheels.topic': '/wheel/odometry'})
    found = configure([tmp_path / 'bag']).values
    assert table.check(found)
    if twist == 'empty':
        assert found['inputs'] == ['lidar_odometry'] and found['lidar_odometry.type'] == 'pose'
        assert found['lidar_odometry.time_offset'] == pytest.approx(0.0, abs=0.03)
    else:
        # measured where the lidar is, 1.2 m ahead of the axle
        assert found['inputs'] == ['wheel_odometry'] and found['wheel_odometry.type'] == 'twist'
        assert found['wheel_odometry.lever_arm'] == pytest.approx([1.2, 0.0, 0.0], abs=0.2)
