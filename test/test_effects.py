"""The correcting half of the effects: what the simulator does to a recording, the declared effect takes out again."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_support import PAPER, configure
from scipy.signal import lsim

from mems_ins_fusion.diagnosis.problem import averaged
from mems_ins_fusion.effects.gnss_outliers import far_off
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.runs import replay as filter_replay
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.start.start import transferred
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.navigation.frames import mounting
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import ImuSamples, Speeds
from mems_ins_fusion.simulation.drive import START_STAMP
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_drive,
    simulate_recording,
)

RECEIVER = GnssNoise(sigma=0.1, rate=0.5)
#: sizes that nobody would overlook
SIZES = {'gnss_time_offset': {'time_offset': 0.3}, 'gnss_lever_arm': {'x': 2.0, 'y': -1.0, 'z': 0.5},
         'accelerometer_scale': {'x': 0.2, 'y': -0.2}, 'gyroscope_scale': {'z': 0.2},
         'mounting_rotation': {'roll': 0.05, 'pitch': -0.05, 'yaw': 0.6},
         'tilt': {'pitch_per_acceleration': 0.03, 'roll_per_acceleration': 0.03},
         'g_sensitivity': {'x': 0.02, 'y': -0.02}, 'accelerometer_lever_arm': {'x': 1.2, 'y': -0.5, 'z': 0.3},
         'temperature': {'accelerometer_x': 0.05, 'accelerometer_y': -0.05, 'gyroscope_z': 2e-3},
         'sideslip': {'angle_per_acceleration': 0.05}, 'gnss_lag': {'tau': 0.4},
         'rear_axle': {'x': -4.0}, 'gyroscope_warm_up': {'z': 0.02, 'tau': 60.0},
         'gnss_outliers': {'share': 0.05, 'sigma': 30.0}}
CONSTRAINED = ('sideslip', 'rear_axle')
SEEN = [name for name, effect in EFFECTS.items() if not effect.traced]


@pytest.fixture(scope='module')
def drive():
    return simulate_drive(200.0, 8, 50.0, standstill=12.0)


def recorded(drive, effects=(), mounting_rpy=(0.0, 0.0, 0.0), receiver=RECEIVER):
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(drive, sensors, receiver, effects, mounting_rpy, seed=3).recording


def horizontal_error(config, recording, aiding=filter_replay.Aiding()) -> float:
    """RMS distance, m, of the filter's positions from the true ones of the same samples."""
    result, true = run(config, recording.imu, recording.gnss, aiding), recording.reference
    meridian, prime_vertical = radii(result.latitude)
    north = (result.latitude - true.latitude[result.index]) * (meridian + result.height)
    east = (result.longitude - true.longitude[result.index]) * (prime_vertical + result.height)
    east *= np.cos(result.latitude)
    return float(np.sqrt(np.mean(north**2 + east**2)))


@pytest.mark.parametrize('mounting_rpy', [(0.0, 0.0, 0.0), (0.0, 0.0, np.pi / 2)])
@pytest.mark.parametrize('name', SIZES)
def test_a_declared_effect_does_no_harm(drive, name, mounting_rpy):
    # given a drive that an effect disturbs, with sensors that stand along the vehicle or across it
    effect, theta = EFFECTS[name], EFFECTS[name].complete(SIZES[name])
    values = table.check({**PAPER, 'imu.mounting_rpy': list(mounting_rpy),
                          'vehicle.non_holonomic': name in CONSTRAINED})
    disturbed = recorded(drive, [(effect, theta)], mounting_rpy)
    # when the filter does not know, knows, and when there is no effect
    ignorant = horizontal_error(configure(values), disturbed)
    knowing = horizontal_error(configure(effect.adjusted(values, effect.as_traced(theta))), disturbed)
    clean = horizontal_error(configure(values), recorded(drive, (), mounting_rpy))
    # then knowing it is as good as not having it, but that a fix which is late is of a place left since
    assert knowing < 1.17 * clean
    assert ignorant > 1.4 * clean


def test_declared_coloured_noise_makes_the_innovations_what_they_are_said_to_be(drive):
    effect, theta = EFFECTS['gnss_coloured_noise'], {'sigma': 2.0, 'tau': 40.0}
    values = table.check(PAPER)
    disturbed = recorded(drive, [(effect, theta)], receiver=GnssNoise(sigma=0.5))
    nis = {}
    for what, used in (('ignorant', values), ('knowing', effect.adjusted(values, theta))):
        innovations = run(configure(used), disturbed.imu, disturbed.gnss).innovations
        nis[what] = np.mean(innovations.nis[20:])
    # then normalized innovations squared average 2; their standard deviation is 2 over the root of their number
    assert abs(nis['knowing'] - 2) < 3 * 2 / np.sqrt(160)
    assert nis['ignorant'] > 2 + 3 * 2 / np.sqrt(160)


@pytest.mark.parametrize('name', EFFECTS)
def test_effects_of_both_signs_cancel(name):
    effect = EFFECTS[name]
    theta = effect.as_traced(effect.complete(SIZES.get(name, {})))
    # variances only add, rotations do not commute
    theta = {'gnss_coloured_noise': {'sigma': 0.0, 'tau': 60.0}, 'gnss_latency': {'wander': 0.0},
             'mounting_rotation': {'roll': 0.0, 'pitch': 0.0, 'yaw': 0.2}}.get(name, theta)
    values = table.check(PAPER)
    there = effect.adjusted(values, theta)
    if name in SEEN:  # what helps against it knows no sign
        return
    back = effect.adjusted(there, {name: -value if name != 'tau' else value for name, value in theta.items()})
    table.check(there)  # what corrected.yaml holds loads again
    there = [key for key in values if key != 'gyroscope.warm_up_time']  # the time constant of nothing
    for key, value in ((key, values[key]) for key in there):
        # one number for all axes may have become three
        same = back[key] == value or np.abs(np.subtract(back[key], value)).max() < 1e-12
        assert same, key


@pytest.mark.parametrize('name', EFFECTS)
def test_the_registry_says_all_that_a_report_needs(name):
    effect = EFFECTS[name]
    assert effect.name == name
    assert len(effect.signature) > 20
    assert effect.parameters and all(p.unit and p.prior_scale > 0 for p in (*effect.parameters, *effect.traced))
    assert effect.principal in [p.name for p in effect.parameters]
    assert all(table.ALL[setting.name] is setting for setting in effect.settings)
    # what is tried at fixed values leaves something to be estimated
    traced = {p.name for p in effect.traced}
    assert all(set(fixed) < traced for fixed in effect.tried) or name in SEEN
    # and what is simulated can be declared
    theta = effect.as_traced(effect.complete({}))
    assert set(theta) >= traced - {'compensation'}
    table.check(effect.adjusted(table.defaults(), theta))


def corrected_values() -> dict:
    return table.check({**PAPER,
        'imu.lever_arm': [2.0, -0.7, 0.3], 'accelerometer.temperature_coefficient': [0.02, -0.01],
        'gyroscope.temperature_coefficient': 3e-4, 'gyroscope.warm_up': 0.01, 'imu.mounting_rpy': [0.1, -0.2, 1.3]})


def test_correctors_take_samples_in_any_portions():
    # given samples with a gap, a doubled stamp, and a temperature that comes later
    rng, n = np.random.default_rng(4), 300
    stamp = np.cumsum(rng.integers(9_000_000, 11_000_000, n))
    stamp[100:] += 900_000_000
    stamp[200] = stamp[199]
    f, w = rng.standard_normal((2, n, 3)) * [[[3.0]], [[0.5]]]
    celsius = np.where(np.arange(n) < 50, np.nan, 20 + 0.05 * np.arange(n))
    values, names = corrected_values(), ('temperature', 'accelerometer_lever_arm', 'gyroscope_warm_up')
    rotation = mounting(values['imu.mounting_rpy'])
    for name in names:
        def portions(edges, effect=EFFECTS[name]):
            correct = effect.corrector(values, rotation)
            parts = [correct(stamp[a:b], f[a:b], w[a:b], celsius[a:b]) for a, b in zip(edges[:-1], edges[1:])]
            return [np.concatenate(column) for column in zip(*parts)]
        # when they come at once, one by one, and in blocks
        whole = portions([0, n])
        # then not a bit differs, and something has been corrected
        for edges in (np.arange(n + 1), [0, 1, 7, 100, 101, 200, 250, n]):
            assert all(np.array_equal(a, b) for a, b in zip(whole, portions(edges)))
        assert not (np.array_equal(whole[0], f) and np.array_equal(whole[1], w))


def test_no_corrector_where_nothing_is_declared():
    values = table.check(PAPER)
    for effect in EFFECTS.values():
        assert effect.corrector(values, np.eye(3)) is None
        assert effect.conditioning(values) is None


def test_the_lever_arm_of_the_accelerometers_is_that_of_a_rigid_body():
    # given accelerometers (1, 0, 0) m forward of the point, rotating about the vertical with rate t^2 / 2 (to the left)
    time = np.arange(1, 500) * 0.01
    rate, acceleration = 0.5 * time**2, time
    stamp = np.round(time * 1e9).astype(np.int64)
    w = np.column_stack([0 * time, 0 * time, rate])
    f = np.column_stack([-rate**2, acceleration, 9.8 + 0 * time])  # forward-left-up
    values = table.check({**PAPER, 'imu.lever_arm': [1.0, 0.0, 0.0]})
    # when the sensor axes are forward-left-up, which the body's are not
    rotation = mounting([0.0, 0.0, 0.0])
    left, _ = EFFECTS['accelerometer_lever_arm'].corrector(values, rotation)(stamp, f, w, np.full(len(f), np.nan))
    # then gravity alone is left, up to the angular acceleration of 0.1 s, over which it is averaged, and half a sample:
    # it grows by 1 rad/s^3
    assert np.abs(left[1:] - [0, 0, 9.8]).max() < 0.1051


def test_the_lever_arm_of_the_accelerometers_does_not_multiply_the_gyroscopes_noise():
    # given sensors at rest, 100 Hz, with white noise of the angular rate and an arm of 2 m
    w = 1.5e-3 * np.random.default_rng(1).standard_normal((20000, 3))
    stamp = np.arange(1, len(w) + 1) * 10_000_000
    values = table.check({**PAPER, 'imu.lever_arm': [2.0, 0.0, 0.0]})
    corrector = EFFECTS['accelerometer_lever_arm'].corrector(values, mounting([0.0, 0.0, 0.0]))
    force, _ = corrector(stamp, np.zeros_like(w), w, np.full(len(w), np.nan))
    # then the noise is that of differences averaged with weight 0.1: arm * sigma / 0.1 s * sqrt(2 / (2 - 0.1))
    expected = 2.0 * 1.5e-3 / 0.1 * np.sqrt(2 / 1.9)
    assert np.allclose(force[100:].std(axis=0)[1:], expected, rtol=0.05)
    # single differences would scatter ten times as much: more than the 0.3 m/s^2 that count as rest
    assert 2.0 * 1.5e-3 * np.sqrt(2) / 0.01 > 0.3 > 5 * expected


def test_live_and_replay_give_the_same_bits_with_corrections(drive):
    # given a recording with temperatures, and a filter that corrects for them and for a lever arm
    recording = recorded(drive, [(EFFECTS['temperature'], {})])
    config = configure({**corrected_values(), 'imu.mounting_rpy': [0.0, 0.0, 0.0]})
    imu, fixes, temperature = recording.imu, recording.gnss, recording.temperature
    result = run(config, imu, fixes)
    # when it is fed event by event
    fusion, published, next_fix, next_celsius = FusionFilter(config), {}, 0, 0
    for k in range(len(imu)):
        while next_fix < len(fixes) and fixes.received[next_fix] < imu.received[k]:
            i, next_fix = next_fix, next_fix + 1
            fusion.add_fix(int(fixes.stamp[i]), float(fixes.latitude[i]), float(fixes.longitude[i]),
                           float(fixes.height[i]), fixes.covariance[i].ravel())
        while next_celsius < len(temperature) and temperature.received[next_celsius] <= imu.received[k]:
            fusion.add_temperature(int(temperature.stamp[next_celsius]), float(temperature.celsius[next_celsius]))
            next_celsius += 1
        if fusion.add_imu(int(imu.stamp[k]), *map(float, imu.specific_force[k]),
                          *map(float, imu.angular_rate[k])) and fusion.aligned:
            fusion.update_odometry()
            published[k] = fusion.geodetic.copy()
    # then each state is the replay's, and the corrections matter
    common = np.isin(result.index, list(published))
    assert common.sum() > len(imu) / 2
    replayed = np.column_stack([result.latitude, result.longitude, result.height])[common]
    assert np.array_equal(replayed, [published[k] for k in result.index[common]])
    plain = run(configure(), imu, fixes)
    assert np.abs(plain.latitude[-1] - result.latitude[-1]) > 1e-10


def test_what_looks_the_same_is_a_sentence_and_goes_both_ways_for_offset_and_low_pass():
    # given the words that stand alone behind a finding
    words = {name: effect.looks_the_same for name, effect in EFFECTS.items() if effect.looks_the_same}
    # then each says that it looks alike, and an input's time offset and low pass name each other
    assert all(' look' in said for said in words.values())
    for name in ('speed', 'velocity', 'heading', 'twist', 'magnetometer', 'pressure'):
        assert 'low pass' in words[f'{name}_time_offset'] and 'stamps' in words[f'{name}_lag']


def test_effects_that_cannot_show_say_why(drive):
    recording, values = recorded(drive), table.check(PAPER)
    hidden = {name: effect.hidden(values, recording) for name, effect in EFFECTS.items()}
    assert {name for name, why in hidden.items() if why} == {
        'temperature', 'sideslip', 'mounting_rotation', 'rear_axle', 'speed_scale', 'speed_time_offset',
        'velocity_time_offset', 'heading_time_offset', 'twist_time_offset', 'magnetometer_time_offset', 'twist_yaw',
        'pressure_dynamic',
        'pressure_time_offset', *(name for name in EFFECTS if name.endswith('_lag') and name != 'gnss_lag'), *SEEN}
    assert 'temperature_topic' in hidden['temperature']
    assert 'vehicle.non_holonomic' in hidden['sideslip'] and 'vehicle.non_holonomic' in hidden['mounting_rotation']
    # and where they can, they do not
    warm = recorded(drive, [(EFFECTS['temperature'], {})])
    constrained = {**values, 'vehicle.non_holonomic': True}
    assert not EFFECTS['temperature'].hidden(values, warm)
    assert not EFFECTS['sideslip'].hidden(constrained, recording)
    assert not EFFECTS['mounting_rotation'].hidden(constrained, recording)
    assert not EFFECTS['rear_axle'].hidden(constrained, recording)
    # nor where the filter estimates it itself
    assert 'estimates' in EFFECTS['rear_axle'].hidden({**constrained, 'vehicle.rear_axle_sigma': 1.0}, recording)
    wheels = replace(recording, speed=Speeds(*np.zeros((4, 1))))
    used = {**values, 'speed_topic': '/speed'}
    assert 'estimates' in EFFECTS['speed_scale'].hidden({**used, 'speed.scale_sigma': 0.02}, wheels)
    assert not EFFECTS['speed_scale'].hidden({**used, 'speed.scale_sigma': 0.0}, wheels)
    assert 'strapdown' in EFFECTS['tilt'].hidden({**values, 'mechanization': 'strapdown'}, recording)


@pytest.mark.parametrize('offset', [-1.8, -0.8, 0.4, 0.8, 1.4])
def test_a_filter_that_knows_how_late_fixes_are_takes_them(drive, offset):
    # given fixes that are late by more than gnss.max_delay, or early by as much, or arrive late as well
    effect, theta = EFFECTS['gnss_time_offset'], {'time_offset': offset}
    recording = recorded(drive, [(effect, theta)], receiver=replace(RECEIVER, latency=0.3))
    values = table.check(PAPER)
    known = effect.adjusted(values, theta)
    result = run(configure(known), recording.imu, recording.gnss)
    # then all are used, whatever is declared
    assert len(result.innovations.z) > 0.8 * len(recording.gnss)
    assert not any('dropped' in notice.text for notice in result.notices)


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
@pytest.mark.parametrize('lag', [0.5, 1.0])
def test_a_lag_is_as_far_behind_as_a_tracking_filter(mechanization, lag):
    # given perfect sensors (on a hill for the filter that knows hills), and fixes behind by what a tracking filter of
    # the time constant sqrt(0.5) s has not followed of the true positions (its transfer function by scipy)
    drive = simulate_drive(120.0, 4, 100.0, hills=mechanization == 'strapdown')
    recording = simulate_recording(drive, None, GnssNoise(sigma=0.0)).recording
    fixes, time = recording.gnss, (recording.gnss.stamp - START_STAMP) * 1e-9
    transfer = [lag, 0.0, 0.0], [lag, 2 * np.sqrt(lag), 1.0]
    north, east, _ = (np.interp(time, drive.time, -lsim(transfer, axis - axis[0], drive.time)[1])
                      for axis in drive.position.T)
    meridian, prime_vertical = radii(fixes.latitude)
    behind = replace(fixes, latitude=fixes.latitude + north / (meridian + fixes.height),
                     longitude=fixes.longitude + east / ((prime_vertical + fixes.height) * np.cos(fixes.latitude)))
    assert np.hypot(north, east).max() > 0.7
    values = {'mechanization': mechanization, 'gnss.sigma': 1.0}
    largest = {}
    for what, used, seen in (('none', {}, fixes), ('known', {'gnss.lag_per_acceleration': lag}, behind),
                             ('ignored', {}, behind)):
        innovations = run(configure({**values, **used}), recording.imu, seen).innovations
        largest[what] = np.abs(innovations.z[20:]).max()
    # then a filter that knows finds no more in them than where there is nothing
    assert largest['known'] < largest['none'] + 0.08 < 0.3 < 0.5 < largest['ignored']


def test_of_a_smoothing_receiver_the_delay_is_not_all(drive):
    # given a receiver with a low pass of 1 s, and a filter that knows only that its fixes are late
    effect, theta = EFFECTS['gnss_lag'], {'tau': 1.0}
    disturbed, values = recorded(drive, [(effect, theta)]), table.check(PAPER)
    late = horizontal_error(configure({**values, 'gnss.time_offset': 1.0}), disturbed)
    knowing = horizontal_error(configure(effect.adjusted(values, effect.as_traced(theta))), disturbed)
    # then the lag takes out half of what is left
    assert knowing < 0.6 * late


def test_a_latency_that_steps_is_followed(drive):
    effect, theta = EFFECTS['gnss_latency'], EFFECTS['gnss_latency'].complete({'step': 0.5})
    disturbed, values = recorded(drive, [(effect, theta)]), table.check(PAPER)
    ignorant = horizontal_error(configure(values), disturbed)
    knowing = horizontal_error(configure(effect.adjusted(values, effect.as_traced(theta))), disturbed)
    assert knowing < 0.4 * ignorant


def test_a_declared_speed_scale_does_no_harm(drive):
    # given wheels without noise that turn 5 % too fast, and fixes for the first minute only
    effect, theta = EFFECTS['speed_scale'], {'scale': 0.05}
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    receiver = replace(RECEIVER, outages=[(60.0, 200.0)])
    wheels = SimulatedAiding(speed_rate=10.0, speed_sigma=0.0, speed_scale=0.0)
    values = table.check({**PAPER, 'speed_topic': '/speed', 'speed.scale_sigma': 0.0, 'speed.sigma': 0.05})
    error = {}
    for what, effects, used in (('clean', [], values), ('ignorant', [(effect, theta)], values),
                                ('knowing', [(effect, theta)], effect.adjusted(values, theta))):
        recording = simulate_recording(drive, sensors, receiver, effects, seed=3, aiding=wheels).recording
        error[what] = horizontal_error(configure(used), recording, filter_replay.Aiding(speed=recording.speed))
    assert error['knowing'] == pytest.approx(error['clean'], rel=1e-6)
    assert error['ignorant'] > 1.4 * error['clean']


@pytest.mark.parametrize(['name', 'theta'], [
    ('gnss_outliers', {'share': 0.05, 'sigma': 40.0}), ('imu_repeats', {'share': 0.3}),
    ('imu_jitter', {'sigma': 4e-3})])
def test_what_is_seen_is_as_large_as_it_is(name, theta):
    # given half an hour at 50 Hz with a receiver of 1 m, twice a second, that wanders
    drive = simulate_drive(1800.0, 5, 50.0)
    receiver = GnssNoise(sigma=1.0, rate=2.0, coloured_sigma=2.0)
    clean, disturbed = (recorded(drive, effects, receiver=receiver) for effects in ([], [(EFFECTS[name], theta)]))
    values = table.defaults()
    # then each sees its own, with its size, and nothing else
    for other in SEEN:
        assert EFFECTS[other].seen(values, clean) is None
        assert (EFFECTS[other].seen(values, disturbed) is not None) == (other == name)
    seen = EFFECTS[name].seen(values, disturbed)
    for parameter, true in theta.items():
        value, sigma = seen.parameters[parameter]
        # the smallest outliers hide, the largest delays push others along
        assert abs(value - true) < 3 * sigma + 0.2 * true
    assert seen.text[-1] != '.' and any(c.isdigit() for c in seen.text)
    # and what helps can be declared; the defaults bear outliers
    assert table.check({**values, **seen.helps}) and bool(seen.helps) == (name != 'gnss_outliers')


def test_what_helps_against_outliers_are_the_defaults():
    disturbed = recorded(simulate_drive(600.0, 5, 50.0), [(EFFECTS['gnss_outliers'], {'share': 0.05, 'sigma': 40.0})])
    seen = EFFECTS['gnss_outliers'].seen(table.check(PAPER), disturbed)
    defaults = table.defaults()
    assert seen.helps == {name: defaults[name] for name in ('gnss.robust_sigma', 'gnss.gate_probability')}


@pytest.mark.parametrize(['name', 'theta', 'lost'], [
    ('imu_repeats', {'share': 0.3}, 0.3), ('imu_jitter', {'sigma': 2e-3}, (2e-3 / 0.02)**2)])
def test_what_samples_miss_is_white_noise(drive, name, theta, lost):
    # given sensors that shake with independent samples of 0.5 m/s^2 and 0.02 rad/s, 50 Hz, and half a minute of them at
    # a time, integrated with their stamps
    rng, n, dt = np.random.default_rng(2), 1500 * 200, 0.02
    shaking = rng.standard_normal((n, 6)) * ([0.5] * 3 + [0.02] * 3)
    stamp = np.round(dt * 1e9 * np.arange(1, n + 1)).astype(np.int64)
    clean = ImuSamples(stamp, stamp, shaking[:, :3], shaking[:, 3:])
    disturbed = EFFECTS[name].distort_samples(clean, theta, rng)

    def integrated(imu):
        both = np.column_stack([imu.specific_force, imu.angular_rate])
        return (both * np.diff(imu.stamp, prepend=0)[:, None] * 1e-9).reshape(200, 1500, 6).sum(axis=1)

    error = (integrated(disturbed) - integrated(clean)).std(axis=0) / np.sqrt(1500 * dt)
    # when it is seen by a filter that takes the sensors for perfect
    values = table.check({'accelerometer.noise_density': [0.0], 'gyroscope.noise_density': [0.0]})
    helps = EFFECTS[name].seen(values, replace(recorded(drive), imu=disturbed)).helps
    density = np.concatenate([helps['accelerometer.noise_density'], helps['gyroscope.noise_density']])
    # then the noise declared is that of the integrals: 200 of them know it to a twentieth
    assert np.allclose(density, error, rtol=0.25)
    assert np.allclose(density[:3], np.sqrt(2 * lost * dt) * 0.5, rtol=0.15)


def test_a_receiver_that_jumps_and_stays_there_has_no_outlier():
    drive = simulate_drive(300.0, 5, 50.0)
    fixes = recorded(drive, receiver=GnssNoise(sigma=0.5)).gnss
    jumped = replace(fixes, latitude=fixes.latitude + np.where(np.arange(len(fixes)) > 150, 1e-5, 0.0))
    assert len(far_off(fixes)[0]) == len(far_off(jumped)[0]) == 0
    single = replace(fixes, latitude=fixes.latitude + np.where(np.arange(len(fixes)) == 150, 1e-5, 0.0))
    index, off = far_off(single)
    assert index.tolist() == [150] and np.abs(off - [[63.7, 0.0]]).max() < 3.0
    # nor do few fixes, none, or messages without a fix say anything
    assert all(len(far_off(fixes.select(slice(n)))[0]) == 0 for n in range(6))
    assert len(far_off(replace(single, status=np.full(len(single), -1, np.int8)))[0]) == 0


def test_averaging_keeps_the_motion():
    # given samples at 100 Hz with a gap and a remainder
    rng, n = np.random.default_rng(5), 1003
    stamp = np.arange(n) * 10_000_000
    stamp[402:] += 700_000_000
    imu = ImuSamples(stamp, stamp + 1, *rng.standard_normal((2, n, 3)), temperature=np.arange(n) * 0.01)
    # when they are averaged to 25 Hz
    fewer = averaged(imu, 25.0)
    # then each stands for the samples up to its stamp, and no mean reaches over the gap
    last = np.searchsorted(imu.stamp, fewer.stamp)
    assert np.array_equal(imu.stamp[last], fewer.stamp)
    count = np.diff(np.concatenate([[-1], last]))
    assert count.max() == 4 and {401, n - 1} <= set(last)
    for mean, full in ((fewer.specific_force, imu.specific_force), (fewer.angular_rate, imu.angular_rate)):
        running = np.cumsum(full, axis=0)[last]
        assert np.allclose(np.cumsum(mean * count[:, None], axis=0), running, rtol=0, atol=1e-11)
    assert np.array_equal(fewer.temperature, imu.temperature[last])


def test_slow_samples_stay_as_they_are():
    stamp = np.arange(100) * 40_000_000
    imu = ImuSamples(stamp, stamp, np.ones((100, 3)), np.ones((100, 3)))
    assert averaged(imu, 25.0) is imu


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_a_start_transferred_to_the_same_parameters_is_the_same_start(drive, mechanization):
    recording, config = recorded(drive), configure(mechanization=mechanization)
    aligned = run(config, recording.imu, recording.gnss)
    given = run(config, recording.imu, recording.gnss, start=transferred(aligned.start, config, config),
                keep=np.zeros(len(recording.imu), dtype=bool))
    # up to the rounding of the standstill's means, which go through the conditioning and back
    assert np.array_equal(given.innovations.index, aligned.innovations.index)
    assert np.allclose(given.innovations.z, aligned.innovations.z, rtol=0, atol=1e-8)
    assert np.allclose(given.innovations.s, aligned.innovations.s, rtol=1e-9, atol=0)


def test_a_start_is_transferred_where_the_antenna_says_it_is(drive):
    # given an alignment without lever arm and time offset
    recording, config = recorded(drive), configure()
    start = run(config, recording.imu, recording.gnss).start
    # when the antenna stands 2 m ahead and the fixes are 0.3 s late
    moved = transferred(start, config, configure({'gnss.lever_arm': [2.0, 0.0, 0.5], 'gnss.time_offset': 0.3}))
    # then the IMU is 2 m behind the fix, half a metre below, 0.3 s earlier, and nothing else
    meridian, prime_vertical = radii(start.latitude)
    north = (moved.latitude - start.latitude) * (meridian + start.height)
    east = (moved.longitude - start.longitude) * (prime_vertical + start.height) * np.cos(start.latitude)
    assert np.allclose([north, east], [-2 * np.cos(start.yaw), -2 * np.sin(start.yaw)], rtol=0, atol=1e-6)
    assert moved.height == pytest.approx(start.height - 0.5)
    assert moved.time == pytest.approx(start.time - 0.3, abs=1e-9)
    assert replace(moved, time=start.time, latitude=start.latitude, longitude=start.longitude, height=start.height,
                   standstill=start.standstill) == start
