"""`configure` and the look at the mounting: simulated drives with a known mounting, and measured recordings."""
from __future__ import annotations

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import shared_data
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from mems_ins_fusion.__main__ import main
from mems_ins_fusion.configuration.check import check, check_setup, compare_mounting
from mems_ins_fusion.configuration.configure import configure, configured, evidence_of_recording
from mems_ins_fusion.configuration.drive_settings import _turn_on_bias, vehicle_settings
from mems_ins_fusion.configuration.mounting import Mounting, deviation, estimate_mounting, rpy
from mems_ins_fusion.configuration.noise import Noise, find_noise
from mems_ins_fusion.configuration.offset import estimate_offset
from mems_ins_fusion.configuration.topics import Candidate, Topics
from mems_ins_fusion.configuration.track import _low_pass
from mems_ins_fusion.configuration.vehicle import assess_vehicle, standstills_show
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.verdict import unsettled
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.params_file import load_yaml
from mems_ins_fusion.recordings.checker import ERROR, check_recording
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.units import find_units, in_si
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.reports.configuration import doubts
from mems_ins_fusion.samples import ImuSamples
from mems_ins_fusion.simulation.drive import MARGIN, Path, follow
from mems_ins_fusion.simulation.manoeuvres import Segment
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

QUARTER = math.pi / 2
HILLS = ((0.04, 900.0, 0.3), (0.02, 250.0, 2.0))
#: two minutes: rest, off, a right-angled turn, a stop, off again
SHORT = (Segment(15.0), Segment(8.0, 10.0), Segment(15.0), Segment(4.0, -4.0), Segment(6.0, 0.0, QUARTER),
         Segment(4.0, 5.0), Segment(15.0), Segment(9.0, -11.0), Segment(8.0), Segment(9.0, 12.0),
         Segment(27.0 + MARGIN))
#: the same with twelve seconds backwards round a corner
REVERSING = (Segment(8.0), Segment(6.0, 8.0), Segment(10.0), Segment(4.0, -8.0), Segment(4.0), Segment(3.0, -2.0),
             Segment(12.0, 0.0, 0.6), Segment(3.0, 2.0), Segment(4.0), Segment(6.0, 9.0), Segment(8.0),
             Segment(5.0, 0.0, QUARTER), Segment(8.0), Segment(5.0, -5.0), Segment(6.0, 0.0, -QUARTER),
             Segment(28.0 + MARGIN))
STRAIGHT = (Segment(10.0), Segment(10.0, 12.0), Segment(100.0 + MARGIN))


def check_mounting(made, values):
    """What is said against the mounting."""
    return [finding for finding in check_setup(made, values) if 'mounting_rpy' in finding.values]


def contradictions(imu, fixes, mounting, lag=None):
    return compare_mounting(imu, fixes, table.check({'imu.mounting_rpy': mounting}), lag)[0]


def recording(segments=SHORT, mounting=(0.0, 0.0, 0.0), seed=0, sensors=None, sigma=0.5, rate=5.0, effects=(),
              hills=HILLS, **suspension):
    """What an IMU so mounted records on a hilly road, and the receiver beside it."""
    drive = follow(Path(tuple(segments), course=0.7, hills=hills, **suspension), 120.0, 100.0)
    sensors = sensors or SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(drive, sensors, GnssNoise(sigma, rate), effects, mounting, seed).recording


def errors(found, mounting):
    return deviation(found.rotation, rotation_from_rpy(*mounting))


def altered(made, rotation=np.eye(3), force=1.0, rate=1.0):
    imu = made.imu
    return replace(made, imu=replace(imu, specific_force=imu.specific_force @ rotation.T * force,
                                     angular_rate=imu.angular_rate @ rotation.T * rate))


@pytest.mark.parametrize('seed, sigma, rate', [(0, 0.02, 5.0), (1, 1.5, 1.0), (2, 1.0, 5.0), (3, 0.3, 1.0)])
def test_two_minutes_with_a_turn_and_a_stop_show_any_mounting(seed, sigma, rate):
    # given a short drive on hills in a car with springs, and an IMU that lies anyhow
    mounting = rpy(Rotation.random(random_state=seed).as_matrix())
    made = recording(mounting=mounting, seed=seed, sigma=sigma, rate=rate, pitch_per_acceleration=0.006,
                     roll_per_acceleration=0.006)
    # when the mounting is estimated from it alone
    found = estimate_mounting(made.imu, made.gnss)
    # then it is right, and the sigmas hold
    error = errors(found, mounting)
    assert np.all(np.abs(error) < 3.0 * found.sigma)
    assert found.sigma[2] < math.radians(1.5) and np.all(found.sigma[:2] < math.radians(1.5))


def test_perfect_sensors_on_a_level_road_give_the_mounting_to_a_hundredth_of_a_degree():
    # given no noise at all; with it a wrong equation could hide
    mounting = [0.4, -0.3, 2.0]
    made = recording(mounting=mounting, sensors=SensorErrors(), sigma=0.001, hills=())
    found = estimate_mounting(made.imu, made.gnss)
    assert np.abs(np.degrees(errors(found, mounting))).max() < 0.05
    assert found.lag == pytest.approx(0.0, abs=0.01)
    assert np.abs(found.bias).max() < 0.01


def test_a_bias_of_the_gyroscope_is_no_sideways_motion():
    # given a car whose gyroscope shows 0.1 rad/s about the vertical axis when it stands, and the same without
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    biased, plain = (recording(seed=5, sensors=replace(sensors, gyroscope_bias=(0.0, 0.0, bias)), sigma=1.0, rate=1.0)
                     for bias in (0.1, 0.0))
    # when the vehicle is assessed by either
    seen = []
    for made in (biased, plain):
        found = estimate_mounting(made.imu, made.gnss, lag=0.0)
        seen.append([found.turned, assess_vehicle(made.imu, np.zeros(len(made.imu), bool), found, 1.0).sideways])
    # then it goes where it points, and has turned by the same angle, each to 10 %
    assert seen[0] == pytest.approx(seen[1], rel=0.1)
    assert seen[0][1] < 0.5


def test_sigmas_are_honest():
    # given drives of four minutes with other biases, roads and receivers
    scores = []
    for seed in range(5):
        mounting = rpy(Rotation.random(random_state=seed).as_matrix())
        drive = simulate_drive(240.0, seed, hills=True, pitch_per_acceleration=0.005, roll_per_acceleration=0.005)
        sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
        made = simulate_recording(drive, sensors, GnssNoise((0.02, 1.5)[seed % 2], 1.0), mounting_rpy=mounting,
                                  seed=seed).recording
        found = estimate_mounting(made.imu, made.gnss)
        scores.append(errors(found, mounting) / found.sigma)
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all(rms < 1.7), rms
    assert np.all(rms > 0.2), rms


def test_heights_that_wander_under_a_slow_vehicle_are_no_grades():
    # given a robot at walking speed whose receiver's heights go up and down by 15 m in minutes, stated to some metres
    around = (Segment(20.0), Segment(5.0, 0.0, QUARTER)) * 3
    made = recording((Segment(15.0), Segment(5.0, 1.0), *around, Segment(25.0 + MARGIN)), sigma=0.8, rate=2.5, hills=())
    seconds = (made.gnss.stamp - made.gnss.stamp[0]) * 1e-9
    wandering = replace(made.gnss, height=made.gnss.height + 15.0 * np.sin(seconds / 25.0))
    # when the mounting is estimated from it
    found = estimate_mounting(made.imu, wandering, lag=0.0)
    # then it is the one that a level road shows
    flat = estimate_mounting(made.imu, replace(made.gnss, height=np.zeros(len(seconds))), lag=0.0)
    assert np.degrees(deviation(found.rotation, flat.rotation))[:2] == pytest.approx(np.zeros(2), abs=0.5)
    assert np.all(np.abs(errors(found, [0.0, 0.0, 0.0])[:2]) < 3.0 * found.sigma[:2])
    # and a slope of a hundred metres of road, which no height would show, is in the sigma of its gravity
    way = 1.0 * (120.0 - 15.0 - 5.0)
    gravity = next(one for one in found.level if one.source == 'gravity in motion')
    assert min(gravity.sigma) > 0.9 * math.radians(1.5) / math.sqrt(max(way / 100.0, 1.0))


@pytest.mark.parametrize('offset', [-0.4, 0.0, 0.25])
def test_the_time_offset_is_found_with_the_mounting(offset):
    effect = (EFFECTS['gnss_time_offset'], {'time_offset': offset})
    made = recording(mounting=[0.0, 0.0, 1.0], sigma=0.02, effects=[effect])
    found = estimate_mounting(made.imu, made.gnss)
    assert found.lag == pytest.approx(offset, abs=max(3.0 * found.lag_sigma, 0.05)) and found.lag_sigma < 0.1
    assert abs(errors(found, [0.0, 0.0, 1.0])[2]) < math.radians(2.0)


@pytest.fixture(scope='module')
def late():
    """Four minutes in a car with springs, antenna and clock somewhere else, the IMU lying anyhow."""
    effects = [(EFFECTS['gnss_time_offset'], {'time_offset': -0.6}),
               (EFFECTS['gnss_lever_arm'], {'x': -0.8, 'y': 0.4, 'z': 0.5})]
    drive = simulate_drive(240.0, 3, 50.0, grade=0.03, bank=0.02, suspension=1.2, pitch_per_acceleration=0.006,
                           roll_per_acceleration=0.007)
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(drive, sensors, GnssNoise(0.02, 5.0), effects, [0.0, 0.0, 2.0], 3).recording


def test_time_offset_and_antenna_are_found_together_with_honest_sigmas(late):
    # given where both are unknown, as is the mounting
    offset = estimate_mounting(late.imu, late.gnss).offset
    # then both are right within their sigmas, and these are small
    assert offset.lag == pytest.approx(-0.6, abs=3.0 * offset.lag_sigma) and offset.lag_sigma < 0.03
    assert np.all(np.abs(offset.arm - [-0.8, 0.4, 0.5]) < 3.0 * offset.arm_sigma)
    assert np.all(offset.arm_sigma[:2] < 0.3) and offset.rivals == ()


def test_a_piece_in_reverse_is_no_noise_of_the_others():
    # given two minutes of which the vehicle goes backwards for eighteen seconds, and fixes of 2 cm, 0.2 s late
    for seed in (4, 5):
        made = recording(REVERSING, sigma=0.02, seed=seed, effects=[
            (EFFECTS['gnss_time_offset'], {'time_offset': 0.2})])
        offset = estimate_offset(made.imu, made.gnss, np.eye(3))
        # then offset and antenna are as well known as in a drive without that (three times worse where it counts as
        # one that goes forwards)
        assert offset.lag == pytest.approx(0.2, abs=3.0 * offset.lag_sigma) and offset.lag_sigma < 0.015
        assert np.all(np.abs(offset.arm[:2]) < 3.0 * offset.arm_sigma[:2]) and offset.arm_sigma[:2].max() < 0.15


def test_sigmas_of_the_time_offset_are_honest():
    scores = []
    for seed in range(6):
        truth = float(np.random.default_rng(seed).uniform(-1.0, 1.0))
        drive = simulate_drive(300.0, seed, 25.0, grade=0.03, bank=0.02)
        sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
        made = simulate_recording(drive, sensors, GnssNoise(1.5, 1.0), [
            (EFFECTS['gnss_time_offset'], {'time_offset': truth})], seed=seed).recording
        offset = estimate_offset(made.imu, made.gnss, np.eye(3))
        scores.append((offset.lag - truth) / offset.lag_sigma)
    assert 0.3 < np.sqrt(np.mean(np.square(scores))) < 1.6, scores
    assert np.abs(scores).max() < 3.0


def test_gaps_in_the_samples_leave_the_offset_to_be_seen_between_them():
    # given five minutes with a gap of 0.8 s each 35 s, so that no eighth of the drive is whole
    effect = (EFFECTS['gnss_time_offset'], {'time_offset': 0.4})
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    made = simulate_recording(simulate_drive(300.0, 3, 25.0), sensors, GnssNoise(0.3, 5.0), [effect], seed=3).recording
    since = (made.imu.stamp - made.imu.stamp[0]) * 1e-9
    offset = estimate_offset(made.imu.select((since < 20.0) | (since % 35.0 > 0.8)), made.gnss, np.eye(3))
    assert offset.lag == pytest.approx(0.4, abs=3.0 * offset.lag_sigma) and offset.lag_sigma < 0.05


def test_errors_of_metres_that_last_are_told_from_white_noise_of_centimetres():
    # given a receiver whose fixes scatter by 5 cm about a track that is off by 2 m, for 20 s
    found = []
    for seed in (5, 6, 7, 8):
        made = recording(sigma=0.05, seed=seed, effects=[(EFFECTS['gnss_time_offset'], {'time_offset': 0.4})])
        noise, kept = np.random.default_rng(seed).normal(0.0, 2.0, (len(made.gnss), 2)), math.exp(-0.2 / 20.0)
        off = lfilter([math.sqrt(1.0 - kept**2)], [1.0, -kept], noise, axis=0) / 6.37e6
        offset = estimate_offset(made.imu, replace(
            made.gnss, latitude=made.gnss.latitude + off[:, 0],
            longitude=made.gnss.longitude + off[:, 1] / math.cos(made.gnss.latitude[0])), np.eye(3))
        found.append((offset.lag - 0.4, offset.lag_sigma))
    error, sigma = np.array(found).T
    # then the sigma is honest, and no larger than two minutes of such fixes ask for, of a receiver that may smooth, too
    assert np.abs(error / sigma).max() < 3.0 and sigma.mean() < 0.35, found


def test_fixes_that_are_far_off_and_a_receiver_that_smooths_move_no_offset():
    effect = (EFFECTS['gnss_time_offset'], {'time_offset': 0.3})
    drive = simulate_drive(400.0, 1, 25.0, grade=0.03)
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    receiver = GnssNoise(1.0, 1.0, smoothing=1.0, outliers=0.03)
    made = simulate_recording(drive, sensors, receiver, [effect], seed=1).recording
    offset = estimate_offset(made.imu, made.gnss, np.eye(3))
    assert offset.lag == pytest.approx(0.3, abs=3.0 * offset.lag_sigma) and offset.lag_sigma < 0.3


@pytest.mark.parametrize('seed', [1, 3])
def test_a_receiver_that_smooths_in_turns_passes_for_no_offset(seed):
    # given precise fixes of a receiver that smooths by more than a second: in turns it is behind along the way, too, by
    # the jerk, which an acceleration alone does not explain
    effect = (EFFECTS['gnss_time_offset'], {'time_offset': 0.4})
    made = simulate_recording(simulate_drive(240.0, seed, 50.0), SensorErrors(), GnssNoise(0.1, 2.0, smoothing=1.2),
                              [effect], seed=seed).recording
    # then the offset is right within its sigma, or has none (it was off by 0.24 and 0.29 s, 5 and 15 sigma)
    offset = estimate_offset(made.imu, made.gnss, np.eye(3))
    assert abs(offset.lag - 0.4) < 2.0 * offset.lag_sigma


def test_what_smoothing_leaves_undecided_is_in_the_sigma_of_the_offset(monkeypatch):
    # given a drive, and what it leaves undecided
    made = simulate_recording(simulate_drive(200.0, 1, 25.0), SensorErrors(), GnssNoise(1.0, 1.0), seed=1).recording
    found = estimate_offset(made.imu, made.gnss, np.eye(3))
    # when that is 0.7 s
    monkeypatch.setattr('mems_ins_fusion.configuration.offset._undecided', lambda by_smoothing, lag: 0.7)
    vague = estimate_offset(made.imu, made.gnss, np.eye(3))
    # then all else of the sigma is as it was
    assert vague.undecided == 0.7
    assert vague.lag_sigma**2 - 0.7**2 == pytest.approx(found.lag_sigma**2 - found.undecided**2)


def test_what_the_parameters_say_is_not_said_again(late):
    def said(**values):
        found = check(late, table.check({'imu.mounting_rpy': [0.0, 0.0, 2.0], **values}))
        return {f.severity: f.message for f in found if f.topic == 'imu/gnss'}, found

    # given nothing: the offset is named; given a wrong one: what is left of it
    nothing, _ = said()
    assert 'early' in nothing['warning'] and 'set gnss.time_offset to -' in nothing['warning']
    wrong, _ = said(**{'gnss.time_offset': -0.2})
    assert 'beside gnss.time_offset -0.2 s' in wrong['warning']
    # given the right ones there is no warning on it
    right, found = said(**{'gnss.time_offset': -0.6, 'gnss.lever_arm': [-0.8, 0.4, 0.5]})
    assert set(right) == {'info'} and 'what is left of the time offset' in right['info']
    assert not [f for f in found if 'lever_arm' in f.message]


def test_a_file_is_ready_only_when_what_it_sets_is_certain(late, tmp_path):
    # given the same drive with good fixes, and with fixes of which each says little
    write_recording(late, tmp_path / 'good', imu_topic='/imu/data', gnss_topic='/gps/fix')
    noise = np.random.default_rng(0).normal(0.0, 4.0, (2, len(late.gnss))) / 6.4e6
    noisy = replace(late.gnss, latitude=late.gnss.latitude + noise[0], longitude=late.gnss.longitude + noise[1],
                    covariance=late.gnss.covariance * 200.0**2).select(slice(0, None, 10))
    write_recording(replace(late, gnss=noisy), tmp_path / 'poor', imu_topic='/imu/data', gnss_topic='/gps/fix')
    good, poor = (configure([tmp_path / name]) for name in ('good', 'poor'))
    # then one is complete, and the other says what is not known
    assert doubts(good) == [] and good.values['gnss.time_offset'] == pytest.approx(-0.6, abs=0.05)
    assert good.values['gnss.lever_arm'][:2] == pytest.approx([-0.8, 0.4], abs=0.2)
    assert any('time offset' in text for text in doubts(poor))
    # and so does one whose values are off, or not known: what may be left decides, not how well it is known
    off = replace(good, settings=tuple(replace(s, value=-0.45) if s.name == 'gnss.time_offset' else s
                                       for s in good.settings))
    assert [left.name for left in unsettled(off.left)] == ['time offset']
    vague = replace(good, mounting=replace(good.mounting, sigma=np.radians([0.5, 0.5, 2.0])))
    assert [left.name for left in unsettled(vague.left)] == ['yaw']
    assert 'yaw of the mounting is known to 2.0 deg' in doubts(vague)[0]
    # what is wrong with a recording comes first: the rest may follow from it
    assert doubts(replace(vague, wrong=('no place',)))[0] == 'no place'


@pytest.mark.parametrize('sigma, known', [
    ([1.0, 1.0, 5.0], True), ([1.0, 1.0, 40.0], False), ([43.0, 1.0, 5.0], False)])
def test_a_mounting_of_which_an_angle_may_be_anything_has_no_yaw(sigma, known):
    assert Mounting(np.eye(3), np.radians(sigma)).yaw_known == known


@pytest.mark.parametrize('seed', [1, 2])
def test_a_straight_road_with_slopes_shows_no_yaw(seed):
    # given 70 s straight on at 25 m/s over slopes of 3 % that go with turns of 0.006 deg/s
    straight = (Segment(10.0), Segment(10.0, 25.0), Segment(100.0 + MARGIN))
    quiet = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-5] * 3)
    made = recording(straight, hills=(), seed=seed, sensors=quiet, sigma=1.5, rate=1.0)
    imu, fixes = (one.select(one.stamp > made.imu.stamp[0] + 40 * 10**9) for one in (made.imu, made.gnss))
    wave = np.sin(2.0 * math.pi * (imu.stamp - imu.stamp[0]) * 1e-9 / 24.0)[:, None]
    imu = replace(imu, specific_force=imu.specific_force + wave * [0.3, 0.03, 0.0],
                  angular_rate=imu.angular_rate + wave * [0.0, 0.0, 1e-4])
    # then the slopes, which are a hundred times what such turns would be, do not show where the vehicle's right is
    found = estimate_mounting(imu, fixes)
    assert not found.yaw_known and not found.heading


def test_a_level_road_straight_on_at_constant_speed_shows_no_yaw():
    # given a recording that begins when the vehicle drives straight on at constant speed
    made = recording(STRAIGHT, hills=())
    begin = made.imu.stamp[0] + 30 * 10**9
    made = replace(made, imu=made.imu.select(made.imu.stamp > begin), gnss=made.gnss.select(made.gnss.stamp > begin))
    found = estimate_mounting(made.imu, made.gnss)
    # then the level is known, and the yaw is said to be anything
    assert not found.yaw_known and found.sigma[2] > 1.5
    assert np.all(np.abs(errors(found, [0.0, 0.0, 0.0])[:2]) < 3.0 * found.sigma[:2])
    # and nothing is said against any yaw, but that it does not show
    assert contradictions(made.imu, made.gnss, [0.0, 0.0, 2.0]) == []
    said = [finding.message for finding in check_setup(made, table.check({'imu.mounting_rpy': [0.0, 0.0, 2.0]}))]
    assert any('yaw of imu.mounting_rpy is right does not show' in text for text in said)


def test_the_checker_says_what_configure_says_of_a_long_recording():
    # given a vehicle that goes straight on for 21 minutes before it turns and brakes, with fixes 0.3 s late, and an IMU
    # with noise: without any, all that turns shows is an outlier beside minutes without residuals
    late = EFFECTS['gnss_time_offset'], {'time_offset': 0.3}
    drive = follow(Path((Segment(10.0), Segment(10.0, 12.0), Segment(1260.0), *SHORT[1:])), 1400.0, 50.0)
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    made = simulate_recording(drive, sensors, GnssNoise(0.05, 1.0), [late], seed=0).recording
    # when the checker and configure look at it
    found = evidence_of_recording('drive', made.imu, made.gnss).mounting.offset
    said, = (finding for finding in check_setup(made, table.defaults()) if 'lag_s' in finding.values)
    # then it is one estimate, and it is right
    assert (said.values['lag_s'], said.values['sigma_s']) == (found.lag, found.lag_sigma)
    assert said.values['lag_s'] == pytest.approx(0.3, abs=min(0.1, 3.0 * said.values['sigma_s']))


@pytest.mark.parametrize('factor, words', [
    (0.1, 'too sure of itself; set gnss.sigma'), (50.0, 'far better than it says'), (1.0, '')])
def test_the_checker_says_of_the_scatter_and_the_mounting_what_configure_says(factor, words):
    # given a receiver that states its sigma wrong by `factor`
    made = recording(sigma=0.02)
    made = replace(made, gnss=replace(made.gnss, covariance=factor**2 * made.gnss.covariance))
    seen = evidence_of_recording('drive', made.imu, made.gnss)
    # when its sigmas are believed; then the scatter is that of configure, and right
    said = {f.topic: f for f in check_setup(made, table.check({'gnss.adapt_sigma': False}))
            if f.values.keys() & {'scatter_m', 'roll'}}
    assert words in said['gnss'].message and said['gnss'].severity == ('warning' if words else 'info')
    assert said['gnss'].values['scatter_m'] == seen.receiver.realised == pytest.approx(0.02, rel=0.3)
    # and where the filter learns them there is nothing to do
    learned, = (f for f in check_setup(made, table.defaults()) if 'scatter_m' in f.values)
    assert learned.severity == 'info'
    # and what is left of the mounting is what configure found
    left = said['imu'].values
    assert [left[name] for name in ('roll', 'pitch', 'yaw')] == pytest.approx(seen.mounting.rpy.tolist())
    sigmas = [left[f'{name}_sigma'] for name in ('roll', 'pitch', 'yaw')]
    assert sigmas == pytest.approx(seen.mounting.sigma.tolist(), rel=0.01)  # about axes that are tilted by 2 deg


def test_speeding_up_and_braking_alone_show_the_yaw_and_which_way_is_forwards():
    mounting = [0.0, 0.0, math.pi - 0.2]
    made = recording(STRAIGHT, mounting, sigma=0.02)
    found = estimate_mounting(made.imu, made.gnss)
    assert abs(errors(found, mounting)[2]) < max(3.0 * found.sigma[2], math.radians(3.0))


@pytest.mark.parametrize('declared, words', [
    ([0.0, 0.0, math.pi], 'backwards'), ([math.pi, 0.0, 0.0], 'upside down'), ([QUARTER, 0.0, 0.0], 'on its side'),
    ([0.0, 0.0, QUARTER], 'turned to the right by 90 +-'), ([0.0, 0.0, -QUARTER], 'turned to the left by 90 +-')])
def test_a_wrong_mounting_is_contradicted_in_plain_words(declared, words):
    made = recording(sigma=0.5)
    found, = check_mounting(made, table.check({'imu.mounting_rpy': declared}))
    assert words in found.message and found.severity == ERROR
    assert 'set imu.mounting_rpy to [' in found.message and ' deg' in found.message.split(' +- ')[1]
    # though a vehicle that may go sideways, as the parameters have it, may have that yaw
    free = check_mounting(made, table.check({'imu.mounting_rpy': declared, 'vehicle.non_holonomic': False}))
    assert [one.severity for one in free] == [ERROR if declared[0] else 'warning']
    # and who does what it says is not contradicted again
    assert check_mounting(made, table.check({'imu.mounting_rpy': found.values['mounting_rpy']})) == []


def test_a_right_mounting_is_not_contradicted_and_the_check_needs_no_search_for_the_offset():
    made = recording(mounting=[0.02, -0.02, 0.0], sigma=1.5, rate=1.0)
    assert check_mounting(made, table.defaults()) == []
    assert contradictions(made.imu, made.gnss, [0.0, 0.0, 0.0], lag=0.0) == []
    assert 'backwards' in contradictions(made.imu, made.gnss, [0.0, 0.0, math.pi], lag=0.0)[0].message
    assert contradictions(made.imu.select(slice(0, 1)), made.gnss, [0.0, 0.0, 0.0]) == []
    assert contradictions(made.imu, None, [0.0, 0.0, 0.0]) == []


@pytest.mark.parametrize('acceleration, rate', [('m/s^2', 'rad/s'), ('g', 'deg/s'), ('mg', 'rad/s')])
def test_units_are_found(acceleration, rate):
    made = recording(sigma=0.1)
    force = {'m/s^2': 1.0, 'g': 1.0 / STANDARD_GRAVITY, 'mg': 1000.0 / STANDARD_GRAVITY}[acceleration]
    made = altered(made, force=force, rate=1.0 if rate == 'rad/s' else 180.0 / math.pi)
    units = find_units(made.imu, made.gnss, STANDARD_GRAVITY)
    assert (units.acceleration, units.rate, units.gravity) == (acceleration, rate, True)
    si = in_si(made.imu, units.acceleration, units.rate)
    assert np.linalg.norm(si.specific_force[:1000].mean(axis=0)) == pytest.approx(STANDARD_GRAVITY, abs=0.5)


def test_accelerometers_without_gravity_are_told_and_still_show_the_mounting():
    # given a driver that subtracts gravity on a level road
    made = recording(sensors=SensorErrors(), sigma=0.02, hills=())
    made = replace(made, imu=replace(made.imu, specific_force=made.imu.specific_force - [0.0, 0.0, STANDARD_GRAVITY]))
    turn = Rotation.from_euler('xyz', [QUARTER, 0.0, QUARTER]).as_matrix()
    made = altered(made, turn)
    units = find_units(made.imu, made.gnss, STANDARD_GRAVITY)
    assert not units.gravity and units.acceleration == 'm/s^2'
    found = estimate_mounting(made.imu, made.gnss)
    assert np.degrees(np.abs(deviation(found.rotation, turn.T))).max() < 4.0


def test_gyroscopes_that_are_mirrored_are_no_mounting():
    made = altered(recording(sigma=0.02), rate=-1.0)
    assert [finding.severity for finding in check_recording(made) if 'mirrored' in finding.message] == [ERROR]


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """A drive in g and deg/s, with a reference beside the receiver."""
    made = altered(recording(mounting=[0.0, 0.0, QUARTER], sigma=0.05), force=1.0 / STANDARD_GRAVITY,
                   rate=180.0 / math.pi)
    path = tmp_path_factory.mktemp('bags') / 'drive'
    write_recording(replace(made, reference=made.gnss), path, imu_topic='/sensors/imu', gnss_topic='/ublox/fix')
    return path


def test_the_file_loads_and_says_what_is_there(bag, tmp_path, capsys):
    output = tmp_path / 'my_car.yaml'
    assert main(['configure', '--bag', str(bag), '--output', str(output)]) == 0
    values = load_yaml(output)
    checked = table.check(values)
    assert values['imu_topic'] == '/sensors/imu' and values['gnss_topic'] == '/ublox/fix'
    assert (values['imu.acceleration_unit'], values['imu.rate_unit']) == ('g', 'deg/s')
    assert checked['mechanization'] == 'strapdown' and checked['vehicle.non_holonomic']
    assert checked['imu.mounting_rpy'][2] == pytest.approx(QUARTER, abs=0.05)
    # a drive without faults does not switch off what bears those of other drives
    assert not {'gnss.robust_sigma', 'gnss.gate_probability', 'gnss.adapt_sigma'} & set(values)
    # every value has its evidence above it
    lines = output.read_text().splitlines()
    for i, line in enumerate(lines):
        if line.startswith('    ') and not line.startswith('    #'):
            assert lines[i - 1].startswith('    # '), line
    page = output.with_suffix('.html').read_text()
    assert 'rather than /reference/fix' in page and '<img' in page
    # what to type next is said, on the console, in five lines (a long command is wrapped), and at the top of the page
    said = re.sub(r' \\\n +', ' ', capsys.readouterr().out)
    assert len(said.splitlines()) <= 5 and all(len(line) <= 100 for line in said.splitlines() if "/" not in line)
    assert re.search(r'found: g, deg/s, roll -?[0-9.]+, pitch -?[0-9.]+, yaw [0-9.]+ \+- [0-9.]+ deg', said)
    for text in (said, re.sub('<.*?>', '', page)):
        assert 'my_car.yaml is ready to drive with' in text
        assert f'diagnose --bag {bag} --params-file {output}' in text
    assert page.index('ready to drive with') < page.index('<img') < page.index('rather than /reference/fix')
    # and an existing file is not overwritten
    capsys.readouterr()
    assert main(['configure', '--bag', str(bag), '--output', str(output)]) == 2
    assert 'exists already' in capsys.readouterr().err
    assert main(['configure', '--bag', str(bag), '--output', str(output), '--overwrite']) == 0


def test_noise_and_biases_at_rest_are_those_simulated(bag):
    result = configure([bag])
    defaults = table.defaults()
    for sensor in ('accelerometer', 'gyroscope'):
        assert result.values[f'{sensor}.noise_density'] == pytest.approx(
            [defaults[f'{sensor}.noise_density'][0]] * 3, rel=0.6)
    assert result.drives[0].noise.seconds > 15.0
    truth = recording(mounting=[0.0, 0.0, QUARTER], sigma=0.05).imu.angular_rate[:1400].mean(axis=0)
    # the bias wanders by that, to the second stop
    assert result.drives[0].noise.bias == pytest.approx(truth, abs=1e-3)


@pytest.mark.parametrize('starts, written', [
    ([0.019], 0.0),  # one turn-on bias of 0.01 rad/s (one sigma) explains it, and the next start has another one
    ([-0.021], -0.021), ([0.06], 0.06),  # no turn-on bias explains that: part of it stays
    ([0.016, 0.014], 0.015), ([0.016, -0.016], 0.0)])  # two starts show what stays to 0.007 rad/s
def test_a_bias_of_the_gyroscopes_is_set_where_the_next_start_has_it(starts, written):
    rests = [Noise(np.ones(3), np.ones(3), 100.0, 0.01, np.array([0.001, bias, 0.0])) for bias in starts]
    setting = _turn_on_bias(rests)
    assert setting.value == pytest.approx([0.001, written, 0.0] if written else [0.0])
    assert ('left at zero' in setting.why[0]) == (not written)


@pytest.mark.parametrize('shake', ['engine', 'knock'])
def test_what_shakes_a_parked_vehicle_is_no_noise_of_the_sensors(shake):
    # given a minute at rest, sensors of known noise, and a body that rocks on its springs, an engine whose shaking
    # aliases, or a door that slams
    rng, rate, density = np.random.default_rng(2), 100.0, np.repeat([2e-3, 1e-4], 3)
    time = np.arange(6000) / rate
    values = rng.normal(0.0, 1.0, (6000, 6)) * density * math.sqrt(rate) + [0, 0, STANDARD_GRAVITY, 0, 0, 0]
    if shake == 'engine':
        values[:, 3] += 4e-3 * np.sin(2 * math.pi * 1.3 * time)
        values[:, 4] += 2e-2 * np.sin(2 * math.pi * 98.7 * time) + 4e-3 * np.sin(2 * math.pi * 1.3 * time)
        values[:, :2] += 0.05 * np.sin(2 * math.pi * 1.3 * time)[:, None]
    else:
        values[3000:3050] += rng.normal(0.0, 1.0, (50, 6)) * [1, 1, 1, 0.1, 0.1, 0.1]
    stamp = np.round(time * 1e9).astype(np.int64)
    found = find_noise(ImuSamples(stamp, stamp, values[:, :3], values[:, 3:]), np.ones(6000, bool))
    # then the noise of a second and more is that of the sensors
    assert found.force_density == pytest.approx(density[:3], rel=0.35)
    assert found.rate_density == pytest.approx(density[3:], rel=0.35)


def test_several_drives_are_taken_together(bag, tmp_path):
    other = tmp_path / 'other'
    made = altered(recording(mounting=[0.0, 0.0, QUARTER], sigma=0.05, seed=5), force=1.0 / STANDARD_GRAVITY,
                   rate=180.0 / math.pi)
    write_recording(made, other, imu_topic='/sensors/imu', gnss_topic='/ublox/fix')
    alone, both = configure([bag]), configure([bag, other])
    error = errors(both.mounting, [0.0, 0.0, QUARTER])
    assert np.linalg.norm(error) < 3.0 * np.linalg.norm(both.mounting.sigma)
    # the yaw, on which the two agree, is known better; where they contradict each other sigmas do not shrink
    assert both.mounting.sigma[2] < alone.mounting.sigma[2]


def test_the_same_recording_twice_is_no_second_witness(bag):
    with pytest.raises(RecordingError, match='holds the samples of .*; give each recording once'):
        configure([bag, bag])


@pytest.mark.parametrize('arguments, words', [
    (['--bag', 'nowhere', '--output', 'car.yaml'], 'recording nowhere does not exist'),
    (['--bag', 'nowhere', '--output', 'car.txt'], '--output must be a .yaml file')])
def test_bad_input_is_one_line_and_status_2(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(['configure', *arguments]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count('\n') == 1
    assert not list(tmp_path.iterdir())


def test_a_recording_without_an_imu_says_what_there_is(tmp_path, capsys):
    made = recording()
    write_recording(replace(made, imu=None), tmp_path / 'bag')
    assert main(['configure', '--bag', str(tmp_path / 'bag'), '--output', str(tmp_path / 'car.yaml')]) == 2
    told = 'has no topic with two or more messages of type sensor_msgs/msg/Imu, only /gps/fix'
    assert told in capsys.readouterr().err


def test_a_recording_at_rest_says_what_it_does_not_show():
    made = recording((Segment(120.0 + MARGIN),), sigma=0.02)
    found = estimate_mounting(made.imu, made.gnss)
    assert not found.yaw_known and np.all(found.sigma[:2] > math.radians(1.0))
    assert found.lag == 0.0 and found.lag_sigma == math.inf and found.offset is None


def settings(made):
    topics = Topics(*((Candidate(topic, len(samples), 1.0, 0.0, 1.0, False, samples),)
                      for topic, samples in (('/imu', made.imu), ('/fix', made.gnss))), ())
    return configured(topics, [evidence_of_recording('drive', made.imu, made.gnss)], [made.gnss])


def test_the_constraint_is_left_out_only_where_a_vehicle_is_seen_to_slide():
    # given a vehicle at walking speed, whose fixes show where it turns but not how the IMU is turned in it
    slow = recording((Segment(10.0), Segment(4.0, 1.2), *(Segment(16.0, 0.0, way * QUARTER) for way in (1, 1, -1)),
                      Segment(58.0 + MARGIN)), [0.0, 0.0, 2.0], sigma=0.5, rate=1.0)
    found = settings(slow)
    assert found.mounting.sigma[2] > math.radians(6.0) and found.drives[0].vehicle.wheels
    # then it goes where it points all the same
    assert found.values['vehicle.non_holonomic']
    # and one that only goes straight on is not seen to slide: the default
    straight = settings(recording(STRAIGHT, hills=(), sigma=0.02))
    assert straight.drives[0].vehicle.wheels is None and straight.values['vehicle.non_holonomic']
    # but one that waves push to and fro by 2.6 m/s is
    made = recording(sigma=0.02)
    pushed = 5.0 * np.sin((made.gnss.stamp - made.gnss.stamp[0]) * 1e-9 * 2 * math.pi / 12.0)
    afloat = settings(replace(made, gnss=replace(made.gnss, latitude=made.gnss.latitude + pushed / 6.37e6)))
    assert not afloat.values['vehicle.non_holonomic']


#: axes as the README of the recordings tells them, and what they are turned by
MEASURED = {'longmont_rtk_drive': ('bag', '/gps/fix', [0.0, 0.0, math.pi], 9.0),
            'karlsruhe_hills': ('bag', '/gps/fix', [0.0, 0.0, 0.0], 3.0),
            'incheon_square_ros2': ('bag', '/fix', [math.pi, 0.0, 0.0], 5.0),
            'incheon_park_ros2': ('bag_0.db3', '/fix', [0.0, 0.0, 0.0], 6.0),
            'kingston_span': ('bag', '/gps/fix', [0.0, 0.0, -QUARTER], 3.0)}


@pytest.mark.parametrize('name', MEASURED)
def test_measured_recordings_show_their_mounting_however_they_are_turned(name):
    file, topic, axes, tolerance = MEASURED[name]
    made = read_recording(shared_data(name) / file, '/imu/data', topic)
    found = estimate_mounting(made.imu, made.gnss)
    assert found.yaw_known
    assert np.degrees(np.linalg.norm(errors(found, axes))) < tolerance
    # when the same IMU is mounted otherwise, the same comes out
    turn = Rotation.random(random_state=3).as_matrix()
    again = altered(made, turn)
    error = np.degrees(np.abs(deviation(estimate_mounting(again.imu, again.gnss).rotation, found.rotation @ turn.T)))
    assert np.all(error < 0.5)


def test_longmont_with_yaw_0_is_said_to_be_backwards():
    made = read_recording(shared_data('longmont_rtk_drive') / 'bag', '/imu/data', '/gps/fix')
    found, = check_mounting(made, table.defaults())
    assert 'backwards' in found.message and found.severity == ERROR


@pytest.mark.parametrize(('quiet', 'told'), [(0.0, True), (0.08, True), (0.5, False), (0.9, False)])
def test_standstills_are_used_unless_much_of_the_motion_is_as_quiet_as_rest(quiet, told):
    # given a minute at rest, then five minutes of motion of which some seconds are as quiet: a smooth road, or a robot
    rng = np.random.default_rng(4)
    rate, seconds = 50, 360
    moving = np.arange(seconds) >= 60
    shaken = moving & (rng.random(seconds) >= quiet)
    scatter = np.repeat(np.where(shaken, 10.0, np.where(moving, 0.9, 1.0)), rate)[:, None]
    stamp = np.arange(seconds * rate) * (10**9 // rate)
    imu = ImuSamples(stamp, stamp, 0.02 * scatter * rng.standard_normal((len(stamp), 3)) + [0.0, 0.0, STANDARD_GRAVITY],
                     0.001 * scatter * rng.standard_normal((len(stamp), 3)))
    vehicle = assess_vehicle(imu, ~np.repeat(moving, rate), None, 1.0)
    # then they are told apart by both sensors together
    assert vehicle.alike == pytest.approx(quiet, abs=0.1)
    settings = {setting.name: setting.value for setting in vehicle_settings([SimpleNamespace(vehicle=vehicle)])}
    assert settings['vehicle.zero_velocity'] is told
    assert ('vehicle.still_rate' in settings) is told


@pytest.mark.parametrize(('least', 'limit', 'said'), [(0.4, 0.2, 'between rest and motion'),
                                                      (0.11, 0.12, 'a little above rest')])
def test_the_limit_of_a_standstill_is_told_as_what_it_is(least, limit, said):
    # given an IMU that scatters by 0.1 m/s^2 at rest, and by `least` and more in motion
    seen = SimpleNamespace(wheels=None, alike=0.0, rest_force=0.1, rest_rate=0.001, drive_force=least, drive_rate=0.01)
    setting, = (s for s in vehicle_settings([SimpleNamespace(vehicle=seen)]) if s.name == 'vehicle.still_acceleration')
    assert setting.value == limit and setting.why[0].startswith(said)


def even_drive(speed):
    """A minute at rest, then two straight on at `speed`, m/s, on ground so even that the IMU shows nothing of it."""
    drive = follow(Path((Segment(60.0), Segment(4.0, speed), Segment(120.0 + MARGIN)), course=0.7), 180.0, 50.0)
    return simulate_recording(drive, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'),
                              GnssNoise(0.3, 1.0), seed=4).recording


@pytest.mark.parametrize(('speed', 'told'), [(1.0, False), (15.0, True)])
def test_quiet_motion_is_taken_for_a_standstill_only_where_it_is_slow(speed, told):
    # given motion as quiet as rest: slow, or so fast that the filter's own velocity denies a standstill
    made = even_drive(speed)
    # then whoever reads the recording says so where it is slow
    assert standstills_show(made.imu, made.gnss)[0] is told
    said = [f for f in check_setup(made, table.check({})) if f.settings == ('vehicle.zero_velocity',)]
    assert len(said) == (not told)
    # and nothing where standstills are not used, or there is none
    assert not [f for f in check_setup(made, table.check({'vehicle.zero_velocity': False}))
                if f.settings == ('vehicle.zero_velocity',)]
    moving = made.imu.select(made.imu.stamp > made.imu.stamp[0] + 70_000_000_000)
    assert standstills_show(moving, made.gnss) is None


@pytest.mark.parametrize(('speed', 'told'), [(1.0, False), (15.0, True)])
def test_standstills_stay_in_use_after_a_drive_without_one_unless_its_motion_is_slow_and_quiet(speed, told):
    # given a drive that begins and ends in motion
    made = even_drive(speed)
    moving = made.imu.select(made.imu.stamp > made.imu.stamp[0] + 70_000_000_000)
    vehicle = assess_vehicle(moving, np.zeros(len(moving), bool), None, 1.0, made.gnss)
    # then its rest is not known, and standstills are left out only for what its motion shows
    assert vehicle.rest_force is None and vehicle.alike == pytest.approx(0.0 if told else 1.0, abs=0.05)
    settings = {setting.name: setting.value for setting in vehicle_settings([SimpleNamespace(vehicle=vehicle)])}
    assert settings.get('vehicle.zero_velocity') is (None if told else False)
    assert 'vehicle.still_rate' not in settings


@pytest.mark.parametrize('decay', [0.0, 0.3, 0.99, 0.99999])
def test_the_low_pass_of_a_track_is_one_of_first_order(decay):
    values = np.random.default_rng(1).normal(9.0, 3.0, (3000, 3))
    expected, _ = lfilter([1.0 - decay], [1.0, -decay], values, axis=0, zi=decay * values[None, 0])
    assert _low_pass(values, decay) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize('severity, step', [('error', 'Correct this where the messages come from'),
                                            ('warning', 'Record a drive with a standstill')])
def test_another_drive_is_asked_for_only_where_the_recording_is_sound(severity, step):
    from types import SimpleNamespace

    from mems_ins_fusion.recordings.remarks import Remark
    from mems_ins_fusion.reports.configuration import answer

    # given a recording without a yaw, with a remark of that severity
    drive = SimpleNamespace(remarks=(Remark(severity, 'imu/gnss', 'IMU and fixes do not overlap in time'),))
    result = SimpleNamespace(drives=[drive], mounting=None, wrong=['they do not overlap'], missing=[], left=[])
    # then only a recording whose messages are sound is said to need turns
    assert answer(result, ['drive'], 'car.yaml').steps[0].what.startswith(step)


def test_several_drives_are_diagnosed_together():
    from types import SimpleNamespace

    from mems_ins_fusion.reports.configuration import answer

    # given a file from two recordings
    result = SimpleNamespace(drives=[], mounting=SimpleNamespace(yaw_known=True), wrong=[], missing=[], left=[])
    # then the next command has both
    assert '--bag monday "tuesday evening"'.replace('"', "'") in answer(
        result, ['monday', 'tuesday evening'], 'car.yaml').steps[0].command
