"""How the filter starts by itself: heading, gyroscope bias, what it waits for, and how well it knows what it says."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_support import configure
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from mems_ins_fusion.configuration.check import compare_mounting
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.memory import Head, views
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.start.alignment import Alignment, _off_line
from mems_ins_fusion.filter.start.at_rest import blocks_of
from mems_ins_fusion.filter.start.course import _bent
from mems_ins_fusion.filter.start.initial import channel_prior
from mems_ins_fusion.filter.start.plausibility import direction_in_motion
from mems_ins_fusion.filter.trust.scale import scale
from mems_ins_fusion.navigation.earth import radii, to_local
from mems_ins_fusion.navigation.frames import FLU_TO_FRD, wrap
from mems_ins_fusion.parameters import table
from mems_ins_fusion.sensor_errors.models import Autoregressive, GaussMarkov, RandomWalk, gauss_markov_at
from mems_ins_fusion.simulation.drive import Path
from mems_ins_fusion.simulation.manoeuvres import Segment
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

RATE = 50.0
COURSE = 0.7
STAND, GO = Segment(10.0), Segment(6.0, 8.0)


@pytest.fixture(scope='module')
def template():
    return simulate_drive(1.0, 0, RATE)


def driven(template, segments, course=COURSE):
    """A drive by these manoeuvres."""
    path = Path((*segments, Segment(70.0)), course=course)
    duration = sum(s.duration for s in segments)
    return replace(template, path=path, time=np.array([0.0, duration])).altered()


def recorded(drive, seed=0, sigma=1.5, rate=1.0, **values):
    """A configuration and the recording of a drive by the sensors that it describes."""
    config = configure(values)
    sensors = SensorErrors.from_parameters(config.parameters, 'gauss_markov')
    return config, simulate_recording(drive, sensors, GnssNoise(sigma, rate), seed=seed,
                                      mounting_rpy=config.parameters['imu.mounting_rpy']).recording


def texts(notices):
    return [notice.text for notice in notices]


def test_standstill_shows_gyroscope_bias_and_tilt(template):
    # given an IMU mounted with a half turn and a bias far beyond a usual one
    drive = driven(template, [STAND, GO, Segment(10.0)])
    config = configure({'imu.mounting_rpy': [0.0, 0.0, math.pi]})
    bias = np.array([0.02, -0.03, 0.04])
    sensors = SensorErrors(gyroscope_bias=bias, gyroscope_noise_density=[3e-4] * 3,
                           accelerometer_noise_density=[0.01] * 3)
    recording = simulate_recording(drive, sensors, GnssNoise(1.0, 1.0), seed=1, mounting_rpy=[0, 0, math.pi]).recording
    result = run(config, recording.imu, recording.gnss)
    still = result.start.standstill
    # then it is seen in body axes, forward-right-down, to the white noise of ten seconds
    assert still.duration > 8
    assert still.angular_rate == pytest.approx([-0.02, -0.03, -0.04], abs=4 * 3e-4 / math.sqrt(still.duration))
    assert still.specific_force == pytest.approx([0, 0, -9.806], abs=0.02)
    note = next(text for text in texts(result.notices) if text.startswith('standstill'))
    assert 'gyroscope bias -1.1' in note and 'forward, right, down' in note and 'gravity here 9.80' in note


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_constant_tilt_is_removed(template, mechanization):
    # given a mount that is 8 degrees off level
    drive = driven(template, [STAND, GO, Segment(60.0)])
    recording = simulate_recording(drive, SensorErrors(), GnssNoise(1.5, 1.0)).recording
    tilted = Rotation.from_euler('xyz', [0.1, -0.1, 0.0]).as_matrix().T
    imu = replace(recording.imu, specific_force=recording.imu.specific_force @ tilted.T,
                  angular_rate=recording.imu.angular_rate @ tilted.T)
    leveled = run(configure(mechanization=mechanization), imu, recording.gnss)
    not_leveled = run(configure({'alignment.level': False}, mechanization=mechanization), imu, recording.gnss)
    note = next(text for text in texts(leveled.notices) if text.startswith('standstill'))
    assert 'tilt 8.' in note and ('(removed)' in note) == (mechanization == 'planar')
    assert 'removed' not in ''.join(texts(not_leveled.notices))
    conditioning = views(leveled.memory)[0][Head.CONDITIONING:Head.CONDITIONING + 36].reshape(6, 6).T
    at_rest = conditioning[:3, :3] @ imu.specific_force[:400].mean(axis=0)
    if mechanization == 'planar':  # it is taken out of the samples, as the filter has no state for it
        assert at_rest == pytest.approx([0, 0, -np.linalg.norm(at_rest)], abs=0.02)
    else:  # it is the attitude: what is felt at rest points down
        level = Rotation.from_euler('ZYX', [leveled.yaw[0], leveled.pitch[0], leveled.roll[0]])
        assert level.apply(at_rest) == pytest.approx([0, 0, -np.linalg.norm(at_rest)], abs=0.02)
    error = wrap(leveled.yaw[-1] - drive.yaw[-1])
    assert abs(error) < 4 * leveled.sigma[-1, 4 if mechanization == 'planar' else 8]


def start_errors(template, segments, seeds=24, course=COURSE, **values):
    """(yaw error over sigma, speed error along the heading over its sigma, seconds of the start) over seeds."""
    found = []
    for seed in range(seeds):
        drive = driven(template, segments, course)
        config, recording = recorded(drive, seed, **values)
        start = run(config, recording.imu, recording.gnss).start
        true = drive.at(start.time)
        along = np.array([math.cos(start.yaw), math.sin(start.yaw)])
        yaw = wrap(start.yaw - true.yaw[0]) / math.sqrt(start.covariance[4, 4])
        error = start.velocity - true.velocity[0, :2]
        found.append((yaw, along @ error / math.sqrt(along @ start.covariance[2:4, 2:4] @ along), start.time))
    return np.array(found).T


ROUTES = {
    'straight': [STAND, GO, Segment(30.0)],
    'backwards': [STAND, Segment(3.0, -2.5), Segment(12.0), Segment(4.0, 2.5), Segment(2.0), GO, Segment(20.0)],
    'backwards and turning': [STAND, Segment(3.0, -2.5), Segment(8.0, 0, 1.5), Segment(4.0, 2.5), GO, Segment(20.0)],
    'turning sharply': [STAND, Segment(3.0, 3.0, 0.8), Segment(4.0, 0, 1.2), Segment(6.0, 5.0), Segment(20.0)],
    'roundabout': [STAND, Segment(3.0, 4.0, 1.0), Segment(12.0, 0, 6.0), Segment(6.0, 5.0), Segment(20.0)],
}


@pytest.mark.parametrize('receiver', [(1.5, 1.0), (0.02, 4.0)], ids=['1.5 m', 'RTK'])
@pytest.mark.parametrize('route', ROUTES)
def test_heading_from_course_is_honest(template, route, receiver):
    yaw, speed, _ = start_errors(template, ROUTES[route], 16, sigma=receiver[0], rate=receiver[1])
    assert np.sqrt(np.mean(yaw**2)) < 1.5 and np.abs(yaw).max() < 4
    assert np.sqrt(np.mean(speed**2)) < 1.5


def test_heading_sigma_is_not_pessimistic_either(template):
    yaw, _, time = start_errors(template, ROUTES['straight'], 24)
    assert np.sqrt(np.mean(yaw**2)) > 0.4
    assert time.max() < 25  # and it does not wait for ever


def test_every_heading_is_found(template):
    for course in np.radians([-179, -91, 0, 89, 135]):
        yaw, _, _ = start_errors(template, ROUTES['straight'], 2, course=float(course))
        assert np.abs(yaw).max() < 4


@pytest.mark.parametrize('turn', [0.12, -0.2])
def test_a_way_that_always_bends_tells_the_heading(template, turn):
    # given a slow vehicle that goes round and round: no chord is long enough for fixes of 1.5 m
    # and who may have driven off backwards is waited for, for a minute
    segments = (STAND, Segment(4.0, 1.5), *[Segment(5.0, 0.0, 5.0 * turn)] * 14)
    normalized = []
    for seed in range(8):
        config, recording = recorded(driven(template, segments), seed)
        filtered = run(config, recording.imu, recording.gnss)
        assert len(filtered.stamp), texts(filtered.notices)
        true = np.interp(filtered.stamp[0], recording.reference.stamp, np.unwrap(recording.reference.yaw))
        normalized.append(wrap(filtered.yaw[0] - true) / filtered.sigma[0, config.layout.n_navigation - 1])
    # then it is found, and as good as it says
    assert np.sqrt(np.mean(np.square(normalized))) < 1.6, normalized


def test_a_recording_that_begins_in_motion_starts_without_a_standstill():
    drive = simulate_drive(120.0, 3, RATE, standstill=5.0)
    config, recording = recorded(drive, 2)
    moving = recording.imu.stamp[0] + 40_000_000_000
    result = run(config, recording.imu.select(recording.imu.stamp > moving),
                 recording.gnss.select(recording.gnss.stamp > moving))
    assert result.start.standstill is None
    assert 'no standstill seen: gyroscope bias and tilt of the IMU start unknown' in texts(result.notices)
    i = result.index + np.count_nonzero(recording.imu.stamp <= moving)
    assert abs(wrap(result.yaw[0] - drive.yaw[i[0]])) < 4 * result.sigma[0, 4]
    assert abs(wrap(result.yaw[-1] - drive.yaw[i[-1]])) < 4 * result.sigma[-1, 4]


def test_a_smooth_motion_is_no_standstill(template):
    # given constant speed from the first sample on, without vibration
    path = Path((Segment(0.1, 12.0), Segment(200.0)), course=COURSE)
    drive = replace(template, path=path, time=np.array([0.0, 30.0])).altered()
    config, recording = recorded(drive)
    later = recording.imu.stamp[0] + 1_000_000_000
    result = run(config, recording.imu.select(recording.imu.stamp > later),
                 recording.gnss.select(recording.gnss.stamp > later))
    assert result.start.standstill is None
    assert np.hypot(*result.start.velocity) == pytest.approx(12.0, abs=2.0)


@pytest.mark.parametrize('kept', [0.0, 0.3], ids=['at once', 'fading'])
@pytest.mark.parametrize('wrong', [1, 2, 3, 4])
def test_one_fix_far_off_before_a_standstill_is_seen_is_no_drive(template, wrong, kept):
    # given a vehicle that is parked and a receiver of which one of the first fixes is 30 m off, and those after it as
    # much of that as its own filter keeps
    config, recording = recorded(driven(template, [STAND, GO, Segment(20.0)]))
    gnss = recording.gnss
    after = np.arange(len(gnss)) - wrong
    north = np.where(after >= 0, 30.0 / 6.37e6 * kept ** np.maximum(after, 0), 0.0)
    result = run(config, recording.imu, replace(gnss, latitude=gnss.latitude + north))
    # then the filter starts when the vehicle drives, the right way
    assert len(result.stamp) and (result.stamp[0] - recording.imu.stamp[0]) * 1e-9 > STAND.duration
    assert abs(wrap(result.yaw[0] - COURSE)) < 0.3


@pytest.mark.parametrize('wrong', [11.5, 12.5, 14.0])
def test_one_fix_far_off_after_a_standstill_is_no_drive(template, wrong):
    # given a vehicle that drives off after 10 s, and a fix at 10 Hz that is 30 m beside its way soon after that
    config, recording = recorded(driven(template, [STAND, GO, Segment(20.0)]), rate=10.0)
    gnss = recording.gnss
    i = np.argmin(np.abs((gnss.stamp - gnss.stamp[0]) * 1e-9 - wrong))
    beside = COURSE + 0.5 * math.pi
    off = np.arange(len(gnss)) == i
    latitude = gnss.latitude + off * 30.0 * math.cos(beside) / 6.37e6
    longitude = gnss.longitude + off * 30.0 * math.sin(beside) / (6.37e6 * np.cos(gnss.latitude))
    result = run(config, recording.imu, replace(gnss, latitude=latitude, longitude=longitude))
    # then it starts in the direction in which it drives
    assert len(result.stamp) and abs(wrap(result.yaw[0] - COURSE)) < 0.3


@pytest.mark.parametrize('mounting', [[0.0, 0.0, 0.0], [0.0, 0.0, math.pi / 2], [math.pi, 0.0, 0.3]])
def test_heading_from_orientation(template, mounting):
    # given an IMU that tells its own orientation in ENU, a vehicle that heads for 0.7 rad from north
    drive = driven(template, [Segment(20.0)])
    config, recording = recorded(drive, **{'imu.mounting_rpy': mounting, 'alignment.heading': 'orientation',
                                           'alignment.yaw_sigma': 0.2})
    base = Rotation.from_euler('z', math.pi / 2 - COURSE)  # base_link to ENU
    quaternion = (base * Rotation.from_euler('xyz', mounting)).as_quat()
    imu = replace(recording.imu, orientation=np.tile(quaternion, (len(recording.imu), 1)))
    result = run(config, imu, recording.gnss)
    assert result.start.yaw == pytest.approx(COURSE, abs=1e-12)
    assert result.start.covariance[4, 4] == pytest.approx(0.04)
    assert np.array_equal(result.start.velocity, [0, 0])
    assert result.start.time < 6  # as soon as the standstill is one
    # and one without orientation waits for it, saying so; NaN is none
    for missing in (None, np.zeros((len(imu), 4)), np.full((len(imu), 4), np.nan)):
        waiting = run(config, replace(imu, orientation=missing), recording.gnss)
        assert waiting.start is None
        assert texts(waiting.notices)[-1] == (
            'the filter did not start: waiting for orientation in the messages on /imu/data')


def test_heading_from_parameter(template):
    drive = driven(template, [Segment(20.0)])
    config, recording = recorded(drive, **{'alignment.heading': 'parameter', 'alignment.yaw': -2.0})
    result = run(config, recording.imu, recording.gnss)
    assert result.start.yaw == pytest.approx(-2.0)
    assert 'heading from parameter 245.4 deg +- 5.7 deg' in ''.join(texts(result.notices))


def test_it_says_what_it_waits_for(template):
    drive = driven(template, [Segment(30.0)])
    config, recording = recorded(drive)
    fusion, imu, gnss = FusionFilter(config), recording.imu, recording.gnss
    assert fusion.status == 'waiting for IMU samples'
    for k in range(len(imu)):
        fusion.add_imu(int(imu.stamp[k]), *imu.specific_force[k], *imu.angular_rate[k])
        assert not fusion.aligned
        if k == 0:
            assert fusion.status == 'waiting for a fix on /gps/fix'
        if k % 50 == 10:
            i = k // 50
            fusion.add_fix(int(gnss.stamp[i]), gnss.latitude[i], gnss.longitude[i], gnss.height[i],
                           gnss.covariance[i].ravel())
    waiting = 'waiting for the vehicle to move straight on: its course shows the heading'
    assert fusion.status == waiting
    assert texts(fusion.notices()) == ['waiting for a fix on /gps/fix', waiting]  # each once
    assert texts(run(config, imu, gnss).notices)[-1] == f'the filter did not start: {waiting}'


def test_the_start_is_that_of_the_imu_not_of_the_antenna(template):
    drive = driven(template, [Segment(20.0)], course=math.pi / 2)  # heads east
    config, recording = recorded(drive, sigma=1e-3, **{
        'gnss.lever_arm': [2.0, 0.5, 1.0], 'alignment.heading': 'parameter', 'alignment.yaw': math.pi / 2})
    start = run(config, recording.imu, recording.gnss).start
    # the simulated antenna is at the IMU: the filter must take it 2 m further west and 0.5 m south, 1 m down
    assert (start.longitude - drive.longitude[0]) * 6.39e6 * math.cos(drive.latitude[0]) == pytest.approx(-2, abs=0.02)
    assert (start.latitude - drive.latitude[0]) * 6.37e6 == pytest.approx(-0.5, abs=0.02)
    assert start.height - drive.height[0] == pytest.approx(-1, abs=0.02)


@pytest.mark.parametrize('model', [RandomWalk(1e-3, 0.2), GaussMarkov(0.05, 60.0),
                                   Autoregressive((-1.2, 0.4), 0.01, 0.5)])
def test_bias_at_the_start_is_conditioned_on_the_standstills_mean(model):
    # given 20 s at rest that ended 5 s ago, written out step by step as one Gaussian vector
    turn_on, white, duration, since, mean = 0.1, 1e-4, 20.0, 5.0, 0.3
    dt = model.interval or 0.1
    a, q = model.transition(dt), model.process_noise(dt)
    p, n, m = model.order, round(duration / dt), round(since / dt)
    joint = block_diag(model.initial_covariance(), turn_on**2)
    maps = [np.eye(p + 1)]  # each x_k and the constant, by the initial values and all driving noises
    step, noise = block_diag(a, 1.0), np.vstack([np.linalg.cholesky(q + 1e-30 * np.eye(p)), np.zeros((1, p))])
    for k in range(n + m):
        grown = np.hstack([step @ maps[-1], noise])
        maps.append(grown)
    size = maps[-1].shape[1]
    maps = [np.pad(row, ((0, 0), (0, size - row.shape[1]))) for row in maps]
    prior = block_diag(joint, np.eye(size - p - 1))
    seen = sum(row[0] + row[p] for row in maps[:n]) / n
    last = maps[-1]
    variance = seen @ prior @ seen + white / duration
    cross = last @ prior @ seen
    estimate, covariance, constant = channel_prior(model, turn_on, white, mean, duration, since)
    expected = cross / variance * mean
    assert estimate == pytest.approx(expected[:p], rel=0.01, abs=2e-4)
    assert constant == pytest.approx(expected[p], rel=0.01)
    assert covariance == pytest.approx((last @ prior @ last.T - np.outer(cross, cross) / variance)[:p, :p], rel=0.02,
                                       abs=1e-7)


def test_without_a_standstill_the_bias_keeps_its_prior():
    estimate, covariance, constant = channel_prior(GaussMarkov(0.05, 60.0), 0.1, 1e-4, None, 0.0)
    assert estimate == [0] and constant == 0 and covariance[0, 0] == pytest.approx(0.05**2 + 0.1**2)


def test_the_heading_knows_that_the_receiver_wanders(template):
    # given fixes with 0.3 m of white noise and 1.5 m that change within 8 s, and straight starts after 10 s at rest
    coloured = {'gnss.coloured_noise.sigma': 1.5, 'gnss.coloured_noise.tau': 8.0}
    errors = {True: [], False: []}
    for seed in range(20):
        drive = driven(template, (STAND, GO, Segment(12.0)))
        for declared in errors:
            config = configure(coloured if declared else {})
            sensors = SensorErrors.from_parameters(config.parameters, 'gauss_markov')
            recording = simulate_recording(drive, sensors, GnssNoise(0.3, 1.0), seed=seed, effects=[
                (EFFECTS['gnss_coloured_noise'], {'sigma': 1.5, 'tau': 8.0})]).recording
            start = run(config, recording.imu, recording.gnss).start
            yaw = np.interp(start.time, drive.time - drive.time[0], np.unwrap(drive.yaw))
            errors[declared].append(wrap(start.yaw - yaw) / math.sqrt(start.covariance[4, 4]))
    # then the error is no larger than its sigma says (20 headings: below 1.6, one in 10,000), also where nobody
    # has said so: the fixes have shown it at rest
    for found in errors.values():
        assert np.sqrt(np.mean(np.square(found))) < math.sqrt(chi2.ppf(1 - 1e-4, 20) / 20)


@pytest.mark.parametrize('tau', [0.5, 2.0, 8.0, 20.0, 100.0, 1000.0])
def test_a_receiver_that_wanders_turns_a_path_by_what_least_squares_say(tau):
    # given twenty seconds of fixes, and the covariance of errors of 1.5 m that change within tau
    time = np.linspace(0.0, 20.0, 401)
    covariance = 1.5**2 * np.exp(-np.abs(time[:, None] - time) / tau)
    slope = (time - time.mean()) / np.sum((time - time.mean()) ** 2)
    white = slope @ covariance @ slope / (slope @ slope)
    # then they count as white noise that turns the path as far, neither a half more nor a tenth less
    config = configure({'gnss.coloured_noise.sigma': 1.5, 'gnss.coloured_noise.tau': tau})
    assert 0.9 < len(time) * _bent(config, 20.0) / white < 1.5


CAR = {'mechanization': 'strapdown', 'vehicle.non_holonomic': True}


@pytest.mark.parametrize('yaw', [90, -90, 60, 180])
def test_who_seems_to_drive_off_sideways_or_backwards_has_the_imu_turned_and_is_told_how(template, yaw):
    # given an IMU that is turned, and parameters that say it is not
    turned = [0.0, 0.0, math.radians(yaw)]
    _, recording = recorded(driven(template, ROUTES['straight']), 3, **CAR, **{'imu.mounting_rpy': turned})
    result = run(configure(CAR), recording.imu, recording.gnss)
    # then it does not start, and says what to set
    assert result.start is None
    said = texts(result.notices)[-1]
    assert 'imu.mounting_rpy' in said
    if yaw == 180:
        assert 'drives off backwards' in said and 'turn the yaw of imu.mounting_rpy by pi' in said
        return
    advice = float(said.split('add ')[1].split()[0])
    assert advice == pytest.approx(turned[2], abs=0.15)
    # and with that it starts
    right = run(configure(CAR, **{'imu.mounting_rpy': [0.0, 0.0, advice]}), recording.imu, recording.gnss)
    assert abs(wrap(right.start.yaw - COURSE)) < 4 * math.sqrt(right.start.covariance[4, 4])


BENDS = Segment(38.0), Segment(6.0, 0.0, 1.5), Segment(6.0, -2.0), Segment(6.0, 1.5), Segment(7.0, 0.0, -1.5)


def from_then_on(recording, since):
    """Samples in axes of the sensors, forward-right-down, and positions as `direction_in_motion` takes them, from
    `since` s on."""
    moving = recording.imu.stamp[0] + round(since * 1e9)
    force, rate = recording.imu.specific_force, recording.imu.angular_rate
    samples = np.column_stack([(recording.imu.stamp - moving) * 1e-9, force @ FLU_TO_FRD, rate @ FLU_TO_FRD])
    fixes = recording.gnss.select(recording.gnss.stamp >= moving)
    place = [to_local(*one, (fixes.latitude[0], fixes.longitude[0], fixes.height[0])) for one in zip(
        fixes.latitude, fixes.longitude, fixes.height)]
    positions = np.column_stack([(fixes.stamp - moving) * 1e-9, np.array(place)[:, :2], np.full(len(place), 1.5)])
    return samples[samples[:, 0] >= 0.0], positions


@pytest.mark.parametrize('yaw', [0, 60, 90, 180, 270])
@pytest.mark.parametrize('course', [0.0, 2.2])
def test_turns_and_changes_of_speed_show_how_the_imu_is_turned(template, yaw, course):
    # given a drive of which there is no sample at rest, on a slope that looks like a tilt
    turned = math.radians(yaw)
    _, recording = recorded(driven(template, (STAND, GO, *BENDS), course), 3, **CAR,
                            **{'imu.mounting_rpy': [0.0, math.radians(6.0), turned]})
    samples, positions = from_then_on(recording, 18.0)
    # when the way is straight and the speed constant, then it tells nothing
    straight = slice(0, 35 * round(RATE))
    assert direction_in_motion(samples[straight], blocks_of(samples[straight]), positions[:36]) is None
    # when there are bends and brakes, then it tells the direction
    assert abs(wrap(direction_in_motion(samples, blocks_of(samples), positions) - turned)) < 0.35


@pytest.mark.parametrize('yaw', [0, 90, 180, -90])
def test_the_start_and_the_later_checks_tell_the_same_direction(yaw):
    # given a drive with an IMU that is turned by so much, of which no parameter knows
    _, recording = recorded(simulate_drive(150.0, 3, RATE, standstill=5.0), 2, **CAR,
                            **{'imu.mounting_rpy': [0.0, 0.0, math.radians(yaw)]})
    # when the start of the filter and the check of the mounting, which is that of all tools, look at it
    samples, positions = from_then_on(recording, 0.0)
    at_start = direction_in_motion(samples, blocks_of(samples), positions)
    _, found = compare_mounting(recording.imu, recording.gnss, table.check({}), 0.0)
    # then both tell that, by different estimates
    assert found.yaw_known and abs(wrap(found.rpy[2] - math.radians(yaw))) < 4.0 * found.sigma[2]
    assert abs(wrap(at_start - found.rpy[2])) < 0.2


@pytest.mark.parametrize('yaw', [0, 90, 180])
def test_a_start_in_motion_is_taken_back_where_the_motion_shows_that_the_imu_is_turned(yaw):
    # given a recording that begins in motion, and an IMU that is turned by so much
    drive = simulate_drive(150.0, 3, RATE, standstill=5.0)
    _, recording = recorded(drive, 2, **CAR, **{'imu.mounting_rpy': [0.0, 0.0, math.radians(yaw)]})
    moving = recording.imu.stamp[0] + 40_000_000_000
    imu, gnss = (part.select(part.stamp > moving) for part in (recording.imu, recording.gnss))
    # when a filter that is told that it is not takes it, live
    fusion = FusionFilter(configure(CAR))
    published, off = [], []
    fix = 0
    for stamp, force, rate in zip(imu.stamp.tolist(), imu.specific_force.tolist(), imu.angular_rate.tolist()):
        while fix < len(gnss) and gnss.received[fix] <= stamp:
            fusion.add_fix(int(gnss.stamp[fix]), gnss.latitude[fix], gnss.longitude[fix], gnss.height[fix],
                           gnss.covariance[fix], int(gnss.status[fix]), int(gnss.covariance_type[fix]))
            fix += 1
        if fusion.add_imu(stamp, *force, *rate) and fusion.state == 'fusing':
            published.append((stamp - moving) * 1e-9)
            fusion.update_odometry()
            true = np.array([np.interp(stamp, recording.reference.stamp, getattr(recording.reference, name))
                             for name in ('latitude', 'longitude', 'height')])
            off.append(np.hypot(*to_local(*fusion.geodetic, true)[:2]))
    said = texts(fusion.notices())
    # then it starts at once; one that is turned has no estimate as soon as bends and brakes show it, and says why
    assert published[0] < 10.0
    assert max(off) < 30.0
    assert any('the start is taken back' in text for text in said) == bool(yaw)
    assert (published[-1] < 50.0) == bool(yaw)
    # and a replay of the same has none, or the same
    assert (run(configure(CAR), imu, gnss).start is None) == bool(yaw)


def test_a_car_that_backs_out_slowly_is_not_told_so(template):
    _, recording = recorded(driven(template, ROUTES['backwards']), 3, **CAR)
    assert run(configure(CAR), recording.imu, recording.gnss).start is not None


def test_gyroscopes_in_degrees_are_seen_at_rest(template):
    # given biases of tenths of a degree per second, in deg/s
    drive = driven(template, [STAND, GO, Segment(20.0)])
    sensors = SensorErrors(gyroscope_bias=np.radians([0.2, -0.3, 0.1]), gyroscope_noise_density=[1e-4] * 3,
                           accelerometer_noise_density=[0.01] * 3)
    recording = simulate_recording(drive, sensors, GnssNoise(1.0, 1.0), seed=1).recording
    imu = replace(recording.imu, angular_rate=np.degrees(recording.imu.angular_rate))
    for mechanization in ('planar', 'strapdown'):
        result = run(configure(mechanization=mechanization), imu, recording.gnss)
        assert result.start is None
        assert "at rest" in texts(result.notices)[-1] and "set imu.rate_unit to 'deg/s'" in texts(result.notices)[-1]


@pytest.mark.parametrize('axis', [0, 2])
def test_a_bias_larger_than_the_scatter_at_rest_is_no_turn(template, axis):
    # given a file that configure wrote from one drive, with the scatter of quiet gyroscopes, and the bias of the next
    bias = 0.015 * np.eye(3)[axis]
    drive = driven(template, [STAND, GO, Segment(20.0)])
    sensors = SensorErrors(gyroscope_bias=bias, gyroscope_noise_density=[1e-4] * 3,
                           accelerometer_noise_density=[0.01] * 3)
    recording = simulate_recording(drive, sensors, GnssNoise(1.0, 1.0), seed=1).recording
    for mechanization in ('planar', 'strapdown'):
        config = configure({'vehicle.still_rate': 0.006}, mechanization=mechanization)
        result = run(config, recording.imu, recording.gnss)
        # then it starts, and knows the bias from the standstill
        assert result.start is not None and result.start.standstill is not None
        np.testing.assert_allclose(result.start.standstill.angular_rate, bias * [1.0, -1.0, -1.0], atol=1e-4)


@pytest.mark.parametrize('rate', [lambda t: 0.02 * np.sin(2 * np.pi * t / 40.0), lambda t: np.full(len(t), 0.1)],
                         ids=['swings', 'turns'])
def test_who_turns_at_his_place_is_not_at_rest(template, rate):
    # given a boat at anchor, or a robot that turns on the spot: quiet sensors, fixes that stay
    drive = driven(template, [Segment(60.0)])
    config, recording = recorded(drive, **{'alignment.heading': 'parameter'})
    time = (recording.imu.stamp - recording.imu.stamp[0]) * 1e-9
    turning = recording.imu.angular_rate + np.outer(rate(time), [0.0, 0.0, 1.0])
    result = run(config, replace(recording.imu, angular_rate=turning), recording.gnss)
    # then what it turns is not taken for the gyroscope's bias with a small sigma
    if result.start is not None and result.start.standstill is not None:
        seen = result.start.standstill
        true = turning[np.abs(time - (seen.end - 0.5 * seen.duration)) < 0.5 * seen.duration].mean()
        assert seen.duration < 10.0 and abs(true) < 0.02
    else:
        assert result.start is None or result.start.standstill is None


def scattered(recording, sigma, claim, seed=0, tau=0.0):
    """Its fixes with errors of `sigma` m that last for `tau` s, north and east, claiming `claim` m."""
    gnss = recording.gnss
    error = np.random.default_rng(seed).standard_normal((len(gnss), 2))
    error = gauss_markov_at(np.arange(len(gnss)), tau, error) if tau else error
    north, east = sigma * error.T / 6.37e6
    covariance = claim**2 / gnss.covariance[0, 0, 0] * gnss.covariance
    return replace(recording, gnss=replace(gnss, latitude=gnss.latitude + north, covariance=covariance,
                                           longitude=gnss.longitude + east / np.cos(gnss.latitude)))


@pytest.mark.parametrize('rate', [1.0, 10.0])
def test_a_receiver_that_claims_far_too_little_is_judged_by_how_it_scatters(template, rate):
    # given one that claims 2 cm and scatters by 1.5 m: two fixes of it look like a drive of 2 m
    off = []
    for seed in range(8):
        drive = driven(template, [STAND, GO, Segment(40.0)])
        config, recording = recorded(drive, seed, sigma=0.02, rate=rate, **CAR)
        start = run(config, recording.imu, scattered(recording, 1.5, 0.02, seed).gnss).start
        off.append(wrap(start.yaw - drive.at(start.time).yaw[0]) / math.sqrt(start.covariance[4, 4]))
    assert np.abs(off).max() < 4.0, off


def test_a_fix_each_five_seconds_shows_at_rest_how_far_they_scatter(template):
    # given a receiver of 0.2 Hz that claims a tenth of its scatter, on a car that is parked for half a minute
    off, seen = [], []
    for seed in range(8):
        drive = driven(template, [Segment(30.0), GO, Segment(60.0)])
        config, recording = recorded(drive, seed, sigma=0.02, rate=0.2, **CAR)
        start = run(config, recording.imu, scattered(recording, 1.5, 0.15, seed).gnss).start
        off.append(wrap(start.yaw - drive.at(start.time).yaw[0]) / math.sqrt(start.covariance[4, 4]))
        seen.append(0.15 * math.sqrt(scale(start.gnss_scale, 0)))
    # then the filter starts with that, and with a heading that is as good as it says
    assert np.abs(off).max() < 4.0, off
    assert 0.7 < np.median(seen) < 2.5, seen


@pytest.mark.parametrize('tau', [30.0, 100.0])
def test_a_parked_car_whose_fixes_wander_has_not_driven_off(template, tau):
    for seed in range(3):
        config, recording = recorded(driven(template, [Segment(120.0), GO, Segment(30.0)]), seed, **CAR)
        start = run(config, recording.imu, scattered(recording, 15.0, 1.5, seed, tau).gnss).start
        assert start is None or start.time > 120.0, start.time


def test_who_reverses_out_faster_than_usual_and_then_goes_forwards_has_a_heading(template):
    drive = driven(template, [STAND, Segment(5.0, -5.0), Segment(4.0), Segment(5.0, 5.0), Segment(1.0), GO,
                              Segment(20.0)])
    config, recording = recorded(drive, 2, sigma=0.02, **CAR)
    start = run(config, recording.imu, scattered(recording, 1.5, 1.5, 2).gnss).start
    assert abs(wrap(start.yaw - drive.at(start.time).yaw[0])) < 4.0 * math.sqrt(start.covariance[4, 4])


def test_blocks_of_samples_that_have_grown_are_those_of_all_of_them(rng=np.random.default_rng(52)):
    # given samples with a gap, which come in parts
    time = np.concatenate([np.arange(0.0, 3.3, 0.01), np.arange(7.1, 9.0, 0.013)]) + 1e9
    imu = np.column_stack([time, rng.normal(size=(len(time), 6))])
    found = None
    for end in (1, 40, 41, 250, 331, len(imu)):
        found = blocks_of(imu[:end], found)
        # then they are, each to the last bit, what all samples up to then give
        whole = blocks_of(imu[:end])
        assert all(np.array_equal(part, same) for part, same in zip(found, whole))
    block = (time >= time[0] + 1.0) & (time < time[0] + 2.0)
    np.testing.assert_allclose(found.mean[1], imu[block, 1:].mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(found.scatter[1], imu[block, 1:].std(axis=0), atol=1e-12)


def at_rest(seconds, interval, scatter, claim, seed):
    """An alignment after fixes each `interval` s with `scatter`, m, that claim another, beside an IMU at rest."""
    rng, alignment = np.random.default_rng(seed), Alignment(configure({}))
    time = np.arange(0.0, seconds, 0.02)
    alignment.add_samples(np.column_stack([time, rng.normal([0.0, 0.0, -9.8, 0.0, 0.0, 0.0], [0.02] * 3 + [1e-3] * 3,
                                                            (len(time), 6))]))
    for fix in np.arange(0.0, seconds, interval):
        north, east = rng.normal(0.0, scatter / 6.4e6, 2)
        alignment.add_fix(fix, 0.8 + north, 0.1 + east / math.cos(0.8), 100.0, claim**2 * np.eye(2))
    return alignment


def test_the_scatter_of_rare_fixes_is_known_after_half_a_minute_at_rest():
    # given fixes of 1.5 m that claim 0.02 m, each five seconds: six of them
    found = np.array([at_rest(30.0, 5.0, 1.5, 0.02, seed)._realised for seed in range(40)])
    # then the start knows of it: the logarithm of a variance from eight normal numbers has a sigma of 0.53
    assert np.median(np.log(found)) == pytest.approx(2.0 * math.log(75.0), abs=0.5)
    assert np.mean(found > 0.1 * 75.0**2) > 0.9, np.sort(found)
    # and leaves those alone that claim what they scatter
    assert np.all(np.array([at_rest(30.0, 5.0, 1.5, 1.5, seed)._realised for seed in range(40)]) < 10.0)


def test_a_fix_is_compared_with_the_line_through_those_before_it(rng=np.random.default_rng(522)):
    # given fixes at any times, with a variance each, a metre to north and east being as many radians
    time, variance = np.cumsum(rng.uniform(1.0, 8.0, 6)), rng.uniform(0.5, 4.0, 6)
    place = rng.normal(0.0, 5.0, (6, 2))
    north, east = radii(0.8)
    track = [(t, 0.8 + n / (north + 100.0), 0.1 + e / ((east + 100.0) * math.cos(0.8)), 100.0, v)
             for t, (n, e), v in zip(time, place, variance)]
    off, expected = _off_line(track[:-1], track[-1])
    # then it is off the weighted least squares of NumPy at its time, by as much as their covariance says
    for axis in range(2):
        line, covariance = np.polyfit(time[:-1] - time[-1], place[:-1, axis], 1, w=variance[:-1] ** -0.5,
                                      cov='unscaled')
        assert off[axis] == pytest.approx(line[1] - place[-1, axis], abs=1e-4)
        assert expected == pytest.approx(covariance[1, 1] + variance[-1], rel=1e-9)
