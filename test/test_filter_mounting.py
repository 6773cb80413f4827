"""A mounting far from that of the parameters: estimated at any angle, named, and never driven with a small sigma."""
from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filter_support import (
    central_difference,
    configure,
    random_covariance,
    started,
    state_and_covariance,
    take_sample,
)
from scipy.spatial.transform import Rotation
from test_filter_constraints import NON_HOLONOMIC, SIDEWAYS_SIGMA, true_motion

from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Event, Head, Nav, Verdict, state_at, views
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.runs.vehicle_check import found_mounting, vehicle_warnings
from mems_ins_fusion.navigation.frames import rotation_from_rpy, wrap
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'studies'))
from faults import clean_drive, truth_of  # noqa: E402

SEED, FREE = 2000, {**NON_HOLONOMIC, 'imu.mounting_sigma': 0.1, 'sensor_error_model': 'gauss_markov'}


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
@pytest.mark.parametrize('turn', [0.0, 0.8, -1.6, 3.0])
def test_no_sideways_velocity_is_linearised_where_the_mounting_is_estimated(mechanization, turn):
    # given a body that is turned in the vehicle by the estimated angle and some more, a tilt that is so certain that
    # how vehicles accelerate tells nothing, and gyroscopes without noise
    config = configure({**FREE, 'mechanization': mechanization, 'gyroscope.noise_density': [1e-9]})
    n, k = config.layout.n, 1 if mechanization == 'planar' else 2
    yaw, pitch = config.layout.index('mounting_yaw'), config.layout.index('mounting_pitch')
    scale = np.full(n, 0.01)
    if k == 2:
        scale[6:8] = 1e-3
    x = np.zeros(n)
    x[yaw] = turn
    sample, attitude = (0.3, 0.2, 9.7, 0.02, -0.03, 0.2), (0.0, 0.0, 0.7)
    velocity = Rotation.from_euler('z', 0.7 + turn + 0.05).apply((13.0, 0.0, -0.3 if k == 2 else 0.0))
    before, after = (started(config, attitude=attitude, velocity=velocity, x=x,
                             p=random_covariance(n, np.random.default_rng(5), scale)) for _ in range(2))
    for memory, since in ((before, 0.0), (after, 0.09)):  # s since the last constraint: one of them is due
        views(memory)[2][0, Nav.CONSTRAINT_TIME] = since
        take_sample(memory, 0.01, *sample)
    x, p = state_and_covariance(config, before)

    def measured(e):  # velocity to the right of the vehicle, and down
        moved, turned = true_motion(config, before, e)
        sits = Rotation.from_euler('ZYX', [e[yaw], e[pitch] if k == 2 else 0.0, 0.0])
        return (turned * sits).inv().apply(moved)
    h = -central_difference(lambda e: measured(x + e)[1:1 + k], n, 1e-6)
    s = h @ p @ h.T + SIDEWAYS_SIGMA**2 * np.eye(k)
    gain = p @ h.T @ np.linalg.inv(s)
    estimate, covariance = state_and_covariance(config, after)
    # then the correction is the dense one at that angle
    m = config.layout.n_navigation
    assert estimate[m:] == pytest.approx((x + gain @ measured(x)[1:1 + k])[m:], abs=1e-7)
    assert covariance == pytest.approx(p - gain @ s @ gain.T, abs=1e-9)


def turned_imu(recording, rpy=(0.0, 0.0, 0.0), rate=1.0):
    turn = rotation_from_rpy(*rpy)
    imu = recording.imu
    return replace(recording, imu=replace(imu, specific_force=imu.specific_force @ turn.T,
                                          angular_rate=rate * imu.angular_rate @ turn.T))


def driven(recording, begin=0.0):
    """The run at the defaults from `begin` s on, errors, and how often the ellipse held the truth."""
    clean = clean_drive(SEED)
    since = clean.imu.stamp[0] + round(begin * 1e9)
    values = table.check({'reference_lever_arm': [0.0, 0.0, 0.0]})
    result = run(FilterConfig.from_parameters(values), recording.imu.select(recording.imu.stamp > since),
                 recording.gnss.select(recording.gnss.stamp > since))
    truth = truth_of(clean, values)
    errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
    return result, errors, np.mean(errors.nees < NEES_95)


def test_an_imu_turned_by_forty_degrees_is_found_and_told():
    turn = math.radians(40.0)
    result, errors, held = driven(turned_imu(clean_drive(SEED), (0.0, 0.0, turn)))
    found = result.extras[-1, result.config.layout.extras.index('mounting_yaw')]
    # the IMU of the drive sits some degrees off by itself
    assert found == pytest.approx(-turn, abs=0.05)
    assert held > 0.9 and errors.horizontal.max() < 10.0
    truth = clean_drive(SEED).reference
    i = np.searchsorted(truth.stamp, result.stamp[-1]) - 1
    assert abs(wrap(result.yaw[-1] + found - truth.yaw[i])) < 0.03
    said, = [n.text for n in result.notices if 'forward axis' in n.text]
    assert 'to the left' in said and float(said.split('add ')[1].split()[0]) == pytest.approx(-turn, abs=0.05)


def test_the_place_of_the_axle_below_an_imu_on_the_roof_is_found():
    # given a vehicle that rolls by 3 deg at 10 m/s, and an IMU 2.5 m above its axle and 1 m ahead of it
    drive = simulate_drive(240.0, 5, rotating_earth=True, suspension=0.8, unevenness=math.radians(3.0),
                           axle_to_imu=(1.0, 0.0, -2.5))
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    recording = simulate_recording(drive, sensors, GnssNoise(1.0), seed=5).recording
    values = table.check({'reference_lever_arm': [0.0, 0.0, 0.0]})
    result = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss)
    # then the filter, which knows nothing of it, has found both
    place = dict(zip(result.config.layout.extras, result.extras[-1]))
    assert place['axle_z'] == pytest.approx(2.5, abs=0.3)
    assert place['axle_x'] == pytest.approx(-1.0, abs=0.5)
    truth = truth_of(recording, values)
    errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
    assert np.mean(errors.nees < NEES_95) > 0.9 and errors.horizontal.max() < 5.0


def test_single_refused_samples_in_a_bend_are_no_slide():
    # given an IMU ahead of the axle, and accelerometer samples out of range in the sharpest bend, each by itself; with
    # one of them at least the constraint is applied, and for all of them the turn rate is assumed
    clean = clean_drive(SEED)
    rate = np.abs(clean.imu.angular_rate[:, 2])
    bend = np.argmax(np.convolve(rate, np.ones(200), 'same'))
    force = clean.imu.specific_force.copy()
    force[bend - 55:bend + 55:11] = 1e5
    result, errors, held = driven(replace(clean, imu=replace(clean.imu, specific_force=force)))
    # then they are refused, and nothing else is said of the motion
    said = ' '.join(n.text for n in result.notices)
    assert '10 samples rejected' in said and 'sideways' not in said, said
    assert held > 0.9


@pytest.mark.parametrize('yaw', [0.5 * math.pi, -0.5 * math.pi, math.pi], ids=['left', 'right', 'backwards'])
def test_a_start_in_motion_is_none_where_the_motion_shows_another_mounting(yaw):
    # given a recording that begins in motion, and an IMU that is not mounted as the parameters say
    recording = turned_imu(clean_drive(SEED), (0.0, 0.0, yaw))
    since = recording.imu.stamp[0] + 60_000_000_000
    result = run(FilterConfig.from_parameters(table.defaults()), recording.imu.select(recording.imu.stamp > since),
                 recording.gnss.select(recording.gnss.stamp > since))
    # then nothing is estimated, and it says what to set
    assert result.start is None and not len(result.stamp)
    said, = [n.text for n in result.notices if 'taken back' in n.text]
    assert 'turn the yaw of imu.mounting_rpy by pi' in said or float(
        said.split('add ')[1].split()[0]) == pytest.approx(-yaw, abs=0.3), said


def test_what_the_start_has_not_shown_is_not_driven_with_for_long():
    # given gyroscopes in deg/s, and a start that does not show it
    result, errors, held = driven(turned_imu(clean_drive(SEED), (0.0, 0.0, 0.0), math.degrees(1.0)), 60.0)
    # then the fixes win, and the sigma says how good they are alone
    assert held > 0.85
    later = errors.horizontal[(errors.stamp - errors.stamp[0]) * 1e-9 > 100.0]
    assert np.median(errors.horizontal) < 5.0 and np.mean(later < 30.0) > 0.9
    said = ' '.join(n.text for n in result.notices)
    assert any(words in said for words in ('contradicted by the fixes', 'forward axis', 'backwards',
                                           'the IMU was wrong')), said


def test_what_no_car_does_is_said_with_the_parameters_that_are_its():
    # given a car: nothing is said
    result, _, _ = driven(clean_drive(SEED))
    assert not any('config/boat.yaml' in n.text or 'imu.mounting_rpy' in n.text for n in result.notices)
    # when it has gone sideways for so long, as the kernel counts
    memory, fixes = result.memory.copy(), np.zeros((20, Event.SIZE))
    memory[state_at(memory, int(memory[Head.SAMPLES])) + Nav.SIDEWAYS] = 20.0
    said, = vehicle_warnings(memory, result.config, fixes)
    assert 'went sideways for 20 s' in said and 'config/boat.yaml' in said
    # or fixes are refused that go on while the IMU shows a standstill
    fixes[:, Event.VERDICT], fixes[:, Event.Z_N] = Verdict.REFUSED, 3.0 * np.arange(20)
    said, = vehicle_warnings(result.memory, result.config, fixes)
    assert 'the fixes move on while /imu/data shows a standstill' in said
    fixes[::4, Event.V_N] = 5.0  # not while it drives
    assert vehicle_warnings(result.memory, result.config, fixes) == []


@pytest.mark.parametrize('known, degrees, told', [(0.1, 0.6, True), (0.01, 0.6, False), (0.01, 2.0, True)])
def test_a_mounting_within_what_the_parameters_know_of_it_is_no_news(known, degrees, told):
    # given a filter that has found the mounting to 0.15 deg
    config = configure({**FREE, 'mechanization': 'strapdown', 'imu.mounting_sigma': known})
    layout = config.layout
    x, p = np.zeros(layout.n), 1e-4 * np.eye(layout.n)
    yaw, pitch = layout.index('mounting_yaw'), layout.index('mounting_pitch')
    x[yaw], p[yaw, yaw], p[pitch, pitch] = math.radians(degrees), math.radians(0.15) ** 2, math.radians(0.15) ** 2
    # then it is told where the parameters do not know it about as well, or where it is not what they know
    assert bool(found_mounting(started(config, x=x, p=p), config)) == told
