"""The bag checker finds each defect that is put into a drive of known motion, and none in the sound one."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import shared_data

from mems_ins_fusion.navigation.earth import from_local, gravity
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.checker import ERROR, INFO, WARNING, check_recording
from mems_ins_fusion.recordings.motion import compare_steering, find_standstill, up_axis
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording
from mems_ins_fusion.simulation.drive import MARGIN, Path, follow
from mems_ins_fusion.simulation.manoeuvres import Segment
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

START = 1_700_000_000_000_000_000
DATUM = (0.8, 0.2, 300.0)
REST = 30.0  # s at the start
BIAS = 0.02  # rad/s, of the gyroscopes
G = float(gravity(DATUM[0], DATUM[2]))


def drive(duration=300.0, rate=100.0, fix_interval=0.5, sigma=0.02, lag=0.0, arm=0.0, seed=1):
    """Rest, then bends at 6 to 10 m/s. IMU axes forward-left-up; antenna `arm` m ahead; fixes stamped `lag` s late."""
    generator = np.random.default_rng(seed)
    fine = np.arange(0.0, duration + 5.0, 0.005)
    moving = np.clip((fine - REST) / 5.0, 0.0, 1.0)
    speed = moving * (8.0 + 2.0 * np.sin(2 * np.pi * fine / 37.0))
    turn = moving * (0.3 * np.sin(2 * np.pi * fine / 11.0) + 0.2 * np.sin(2 * np.pi * fine / 23.0))  # clockwise, rad/s
    yaw = 0.7 + np.concatenate([[0.0], np.cumsum(0.5 * (turn[1:] + turn[:-1]) * 0.005)])
    velocity = speed * np.array([np.cos(yaw), np.sin(yaw)])
    track = np.concatenate([np.zeros((2, 1)), np.cumsum(0.5 * (velocity[:, 1:] + velocity[:, :-1]) * 0.005, axis=1)], 1)
    track += arm * np.array([np.cos(yaw), np.sin(yaw)])

    time = np.arange(0.0, duration, 1.0 / rate)
    noise = generator.normal(size=(len(time), 6)) * np.where(time < REST, 0.02, 0.6)[:, None]
    still = np.zeros_like(time)
    force = np.column_stack([np.interp(time, fine, np.gradient(speed, fine)),
                             -np.interp(time, fine, speed * turn), still + G]) + noise[:, :3]
    angular_rate = np.column_stack([still, still, -np.interp(time, fine, turn)]) + 0.01 * noise[:, 3:] + BIAS
    stamp = START + np.round(time * 1e9).astype(np.int64)
    imu = ImuSamples(stamp, stamp + 1_000_000 + generator.integers(0, 500_000, len(stamp)), force, angular_rate)

    seconds = np.arange(1.0, duration - 1.0, fix_interval)
    north, east = (np.interp(seconds - lag, fine, axis) + generator.normal(0.0, sigma, len(seconds)) for axis in track)
    latitude, longitude, height = from_local(north, east, np.zeros_like(north), DATUM)
    stamp = START + np.round(seconds * 1e9).astype(np.int64)
    count = len(stamp)
    fixes = Fixes(stamp, stamp + 60_000_000, latitude, longitude, height,
                  np.tile(np.diag([sigma**2, sigma**2, 4 * sigma**2]), (count, 1, 1)), np.zeros(count, np.int8),
                  np.full(count, 2, np.uint8))
    return Recording('drive', imu, fixes)


@pytest.fixture(scope='module')
def sound():
    return drive()


def with_imu(recording, **arrays):
    return replace(recording, imu=replace(recording.imu, **arrays))


def with_fixes(recording, **arrays):
    return replace(recording, gnss=replace(recording.gnss, **arrays))


def finding(recording, text, severity=WARNING):
    """The one finding of that severity whose message holds `text`."""
    findings = check_recording(recording)
    found = [f for f in findings if text in f.message and f.severity == severity]
    assert len(found) == 1, [(f.severity, f.message) for f in findings]
    return found[0]


def test_a_sound_recording_has_nothing_but_information(sound):
    findings = check_recording(sound)
    assert {f.severity for f in findings} == {INFO}
    rates = {f.topic: f.values['rate_hz'] for f in findings if 'rate_hz' in f.values}
    assert rates == pytest.approx({'imu': 100.0, 'gnss': 2.0})
    assert finding(sound, 'points up', INFO).values['axis'] == '+z'
    gravity_found = finding(sound, 'at rest, gravity there is', INFO).values
    assert gravity_found['magnitude'] == pytest.approx(G, abs=0.01) and gravity_found['standstill_s'] > 25.0


def test_standstill_is_where_the_vehicle_stands(sound):
    still = find_standstill(sound.imu, sound.gnss)
    time = (sound.imu.stamp - START) * 1e-9
    assert still[(time > 1.0) & (time < REST - 3.0)].all()
    assert not still[time > REST + 3.0].any()
    # without fixes, too; and a smooth ride is none when the fixes move
    assert (find_standstill(sound.imu)[time < REST - 1.0]).all()
    smooth = replace(sound.imu, specific_force=np.tile([0.0, 0.0, G], (len(time), 1)))
    assert not find_standstill(smooth, sound.gnss)[time > REST + 3.0].any()


def test_bursts(sound):
    # given a driver that stamps ten samples of 100 Hz when it reads them
    k, stamp = np.arange(len(sound.imu)), sound.imu.stamp
    read = stamp[np.minimum(k // 10 * 10 + 9, len(k) - 1)] + 200_000 * (k % 10)
    found = finding(replace(sound, imu=replace(sound.imu, stamp=read)), 'bursts')
    assert found.message.startswith('stamps come in bursts of 10, 0.098 s apart, 100 Hz in the mean: set on arrival')
    # and none in one that was paused for 20 s after each second, or that loses a third of its samples
    paused = replace(sound.imu, stamp=stamp + 20 * 10**9 * (k // 100))
    assert not any('bursts' in remark.message for remark in check_recording(replace(sound, imu=paused)))
    kept = sound.imu.select(np.random.default_rng(0).random(len(k)) > 1 / 3)
    assert not any('bursts' in remark.message for remark in check_recording(replace(sound, imu=kept)))


def test_gaps(sound):
    keep = np.ones(len(sound.imu), bool)
    keep[5000:5200] = keep[9000:9003] = False
    found = finding(replace(sound, imu=sound.imu.select(keep)), 'gaps')
    assert found.values == pytest.approx({'count': 2, 'missing': 203, 'longest_s': 2.01, 'at_s': 49.99})
    assert found.message == ('2 gaps, about 203 messages missing; the longest lasts 2.01 s, 50.0 s after the start')


def test_stamps_that_go_back_or_repeat(sound):
    stamp = sound.imu.stamp.copy()
    stamp[700] -= 500_000_000
    stamp[800] = stamp[799]
    recording = with_imu(sound, stamp=stamp)
    assert finding(recording, 'stamps go back').values == pytest.approx({'count': 1, 'largest_s': 0.49})
    assert finding(recording, 'repeated from the message before').values == {'count': 1}


def test_irregular_stamps(sound):
    jitter = np.random.default_rng(2).integers(-4_000_000, 4_000_000, len(sound.imu))
    assert finding(with_imu(sound, stamp=sound.imu.stamp + jitter), 'irregular').topic == 'imu'


def test_stamps_that_are_not_set(sound):
    recording = with_imu(sound, stamp=np.zeros(len(sound.imu), np.int64))
    assert finding(recording, 'stamps are not set', ERROR)


def test_clocks_of_stamp_and_log(sound):
    assert finding(with_imu(sound, received=sound.imu.received + 5 * 10**9), 'different clocks').topic == 'imu'
    assert finding(with_fixes(sound, received=sound.gnss.stamp - 50_000_000), 'some arrive before it').topic == 'gnss'
    drifting = sound.imu.received + np.linspace(0, 1e8, len(sound.imu)).astype(np.int64)
    assert finding(with_imu(sound, received=drifting), 'drifts').values['drift_s'] == pytest.approx(0.067, abs=0.002)


def test_imu_and_fixes_apart_in_time(sound):
    for shift, said in ((3600, '3600 s after the IMU'), (-3600, '3600 s before the IMU')):
        stamp = sound.gnss.stamp + shift * 10**9
        found = finding(with_fixes(sound, stamp=stamp, received=stamp), 'do not overlap', ERROR)
        assert found.topic == 'imu/gnss' and said in found.message


def test_samples_that_are_no_numbers(sound):
    force = sound.imu.specific_force.copy()
    force[1234:1236, 1] = np.nan
    found = finding(with_imu(sound, specific_force=force), 'not finite')
    assert found.values == pytest.approx({'count': 2, 'first_s': 12.34})


def test_dead_and_repeated_samples(sound):
    rate = sound.imu.angular_rate.copy()
    rate[:, 1] = 0.125
    assert 'gyroscope y' in finding(with_imu(sound, angular_rate=rate), 'the same value', ERROR).message
    slow = np.arange(len(sound.imu)) // 2 * 2
    recording = with_imu(sound, angular_rate=sound.imu.angular_rate[slow],
                         specific_force=sound.imu.specific_force[slow])
    assert finding(recording, 'repeat the one before').values['part'] == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize('factor, unit', [(1 / 9.80665, 'in g '), (1000 / 9.80665, 'in mg ')])
@pytest.mark.parametrize('rest', [True, False])
def test_accelerometers_in_other_units(sound, factor, unit, rest):
    imu = sound.imu if rest else sound.imu.select((sound.imu.stamp - START) > REST * 1e9)
    recording = replace(sound, imu=replace(imu, specific_force=imu.specific_force * factor))
    assert unit in finding(recording, 'instead of m/s^2', ERROR).message


def test_gravity_that_is_removed_or_wrong(sound):
    assert finding(with_imu(sound, specific_force=sound.imu.specific_force - (0, 0, G)), 'driver has removed gravity',
                   ERROR)
    assert finding(with_imu(sound, specific_force=sound.imu.specific_force * 1.3), 'unit or scale', ERROR)
    assert finding(with_imu(sound, specific_force=sound.imu.specific_force * 1.05), 'a large bias or scale error')


def test_gyroscopes_in_degrees_or_mirrored(sound):
    degrees = with_imu(sound, angular_rate=np.degrees(sound.imu.angular_rate))
    assert finding(degrees, 'deg/s instead of rad/s', ERROR).values['ratio'] == pytest.approx(57.3, rel=0.02)
    assert finding(with_imu(sound, angular_rate=-sound.imu.angular_rate), 'not right-handed', ERROR)
    assert finding(with_imu(sound, angular_rate=1.2 * sound.imu.angular_rate), 'a wrong scale')


def test_noise_of_the_gyroscopes_is_no_scale():
    # given a phone on a motorway, whose samples at 10 Hz alias what shakes it
    rng, segments = np.random.default_rng(0), [Segment(10.0), Segment(20.0, 30.0)]
    for turn in rng.uniform(-0.35, 0.35, 18):
        segments += [Segment(12.0, 0.0, turn), Segment(4.0)]
    drive = follow(Path((*segments, Segment(60.0 + MARGIN)), course=0.7), 300.0, 10.0)
    made = simulate_recording(drive, SensorErrors(), GnssNoise(2.0, 1.0), seed=0).recording
    shaken = with_imu(made, angular_rate=made.imu.angular_rate + rng.normal(0.0, 0.1, (len(made.imu), 3)))
    found = compare_steering(shaken.imu, shaken.gnss, np.array([0.0, 0.0, 1.0]))
    # then course and gyroscopes disagree, by more than scatter explains, and the sigma knows why
    turned, sigma = found.turned
    assert turned - 1.0 > max(2.0 * found.scale_sigma * turned**2, 0.4)
    assert turned - 1.0 < sigma
    assert not [f for f in check_recording(shaken) if 'times the angle' in f.message and f.severity != INFO]


def test_what_the_parameters_say_is_not_said_again(sound):
    # given sensors with faults that the params file states
    values = table.check({'gyroscope.bias': [0.0, 0.2, 0.0], 'gyroscope.scale': [0.2], 'gnss.sigma': 0.02,
                          'accelerometer.bias': [0.0, 0.0, 0.5], 'imu.mounting_rpy': [0.0, 0.0, 1.0],
                          'imu.acceleration_unit': 'g', 'imu.rate_unit': 'deg/s'})
    wrong = with_imu(sound, angular_rate=1.2 * sound.imu.angular_rate + [0.0, 0.2, 0.0],
                     specific_force=sound.imu.specific_force + [0.0, 0.0, 0.5])
    unknown = replace(wrong, gnss=replace(wrong.gnss, covariance_type=np.zeros(len(wrong.gnss), np.uint8)))
    # then nothing of it is said, of units or of the axis that points up either
    assert len([f for f in check_recording(unknown) if f.severity != INFO]) >= 4
    said = check_recording(unknown, values)
    assert not [f for f in said if f.severity != INFO or 'points up' in f.message]
    # but what is not as they say
    right = check_recording(sound, values)
    assert all([f for f in right if text in f.message] for text in ('at rest: a large bias', 'wrong scale'))


def test_a_unit_that_the_params_file_has_wrong_names_its_parameter(sound):
    in_degrees = with_imu(sound, angular_rate=np.degrees(sound.imu.angular_rate))
    assert finding(in_degrees, 'they seem to be in deg/s', ERROR).settings == ('imu.rate_unit',)
    in_g = with_imu(sound, specific_force=sound.imu.specific_force / 9.80665)
    assert finding(in_g, 'seem to be in g instead', ERROR).settings == ('imu.acceleration_unit',)


def test_a_gyroscope_bias_too_large_to_be_one(sound):
    assert finding(with_imu(sound, angular_rate=sound.imu.angular_rate + (0, 0.2, 0)), 'at rest: a large bias')


@pytest.mark.parametrize('axes, up', [(np.diag([1.0, -1.0, -1.0]), '-z'), (np.roll(np.eye(3), 1, axis=0), '+x')])
def test_the_axis_that_points_up(sound, axes, up):
    turned = with_imu(sound, specific_force=sound.imu.specific_force @ axes.T,
                      angular_rate=sound.imu.angular_rate @ axes.T)
    assert finding(turned, 'points up', INFO).values['axis'] == up
    assert finding(turned, 'times the angle of the course', INFO).values['ratio'] == pytest.approx(1.0, abs=0.05)


def test_no_axis_points_up(sound):
    c = np.sqrt(0.5)
    tilted = np.array([[c, 0, c], [0, 1, 0], [-c, 0, c]])
    recording = with_imu(sound, specific_force=sound.imu.specific_force @ tilted.T)
    assert finding(recording, 'no sensor axis points up', INFO)


def test_fixes_that_are_none(sound):
    status, latitude = sound.gnss.status.copy(), sound.gnss.latitude.copy()
    longitude = sound.gnss.longitude.copy()
    status[10:14] = -1
    latitude[20] = np.nan
    latitude[30] = longitude[30] = 0.0
    recording = with_fixes(sound, status=status, latitude=latitude, longitude=longitude)
    assert finding(recording, 'without a fix (status').values == {'count': 4}
    assert finding(recording, 'not finite or impossible').values == {'count': 1}
    assert finding(recording, 'latitude 0, longitude 0').values == {'count': 1}
    assert not [f for f in check_recording(recording) if 'jumps' in f.message]


def test_a_covariance_that_says_nothing(sound):
    covariance = sound.gnss.covariance.copy()
    covariance[:5] = 0.0
    assert finding(with_fixes(sound, covariance=covariance), 'unknown or zero covariance').values == {'count': 5}
    unknown = np.zeros(len(sound.gnss), np.uint8)
    count = len(sound.gnss)
    assert finding(with_fixes(sound, covariance_type=unknown), 'gnss.default_sigma').values == {'count': count}


def test_frozen_fixes(sound):
    latitude, longitude = sound.gnss.latitude.copy(), sound.gnss.longitude.copy()
    latitude[200:210], longitude[200:210] = latitude[200], longitude[200]
    found = finding(with_fixes(sound, latitude=latitude, longitude=longitude), 'freezes')
    assert found.values == pytest.approx({'count': 1, 'longest_s': 4.5})
    # a receiver that holds its position at rest is no fault
    latitude, longitude = sound.gnss.latitude.copy(), sound.gnss.longitude.copy()
    latitude[5:50], longitude[5:50] = latitude[5], longitude[5]
    latitude[50:] += 4.0 / 6.37e6  # released, it moves to where it sees itself then
    recording = with_fixes(sound, latitude=latitude, longitude=longitude)
    assert not [f for f in check_recording(recording) if 'freezes' in f.message]


def test_jumping_fixes(sound):
    latitude = sound.gnss.latitude.copy()
    latitude[300] += 1e-4  # 637 m
    latitude[400:] += 30.0 / 6.37e6  # a step that stays
    found = finding(with_fixes(sound, latitude=latitude), 'jumps')
    assert found.values['largest_m'] == pytest.approx(637.0, rel=0.02)
    assert found.values['count'] == 3  # there and back, and the step


def test_a_recording_of_nothing_but_an_imu(sound):
    findings = check_recording(replace(sound, gnss=None))
    assert {f.topic for f in findings} == {'imu'} and {f.severity for f in findings} == {INFO}


@pytest.mark.parametrize('count', [0, 1, 2, 3])
def test_very_short_recordings_are_no_obstacle(sound, count):
    some = slice(0, count)
    short = replace(sound, imu=sound.imu.select(some), gnss=sound.gnss.select(some))
    assert isinstance(check_recording(short), list)
    assert isinstance(check_recording(replace(sound, gnss=sound.gnss.select(some))), list)


@pytest.mark.parametrize('name, topic, up', [('longmont_rtk_drive', '/gps/fix', '+z'),
                                             ('karlsruhe_hills', '/gps/fix', '+z'),
                                             ('incheon_square_ros2', '/fix', '-z')])
def test_measured_recordings(name, topic, up):
    recording = read_recording(shared_data(name) / 'bag', '/imu/data', topic)
    findings = check_recording(recording)
    assert not [f for f in findings if f.severity == ERROR]
    assert finding(recording, 'points up', INFO).values['axis'] == up
    assert finding(recording, 'times the angle of the course', INFO).values['ratio'] == pytest.approx(1.0, abs=0.05)
    if name == 'karlsruhe_hills':  # its gaps are documented
        assert finding(recording, 'gaps').values['longest_s'] == pytest.approx(1.67, abs=0.01)
    still = find_standstill(recording.imu, recording.gnss)
    assert up_axis(recording.imu, still)[1] == pytest.approx(9.8, abs=0.15)
