"""The correcting half of the effects: what the simulator does to a recording, the declared effect takes out again."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_support import PAPER, configure

from mems_ins_fusion.diagnosis.residuals import averaged
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.live import FusionFilter
from mems_ins_fusion.filter.replay import run
from mems_ins_fusion.filter.start import transferred
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.navigation.frames import mounting
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import ImuSamples
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

RECEIVER = GnssNoise(sigma=0.1, rate=0.5)
#: sizes that nobody would overlook
SIZES = {'gnss_time_offset': {'time_offset': 0.3}, 'gnss_lever_arm': {'x': 2.0, 'y': -1.0, 'z': 0.5},
         'accelerometer_scale': {'x': 0.2, 'y': -0.2}, 'gyroscope_scale': {'z': 0.2},
         'mounting_rotation': {'roll': 0.05, 'pitch': -0.05, 'yaw': 0.6},
         'tilt': {'pitch_per_acceleration': 0.03, 'roll_per_acceleration': 0.03},
         'g_sensitivity': {'x': 0.02, 'y': -0.02}, 'accelerometer_lever_arm': {'x': 1.2, 'y': -0.5, 'z': 0.3},
         'temperature': {'accelerometer_x': 0.05, 'accelerometer_y': -0.05, 'gyroscope_z': 2e-3},
         'sideslip': {'angle_per_acceleration': 0.05}}


@pytest.fixture(scope='module')
def drive():
    return simulate_drive(200.0, 8, 50.0, standstill=12.0)


def recorded(drive, effects=(), mounting_rpy=(0.0, 0.0, 0.0), receiver=RECEIVER):
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(drive, sensors, receiver, effects, mounting_rpy, seed=3).recording


def horizontal_error(config, recording) -> float:
    """RMS distance, m, of the filter's positions from the true ones of the same samples."""
    result, true = run(config, recording.imu, recording.gnss), recording.reference
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
    values = table.check({**PAPER, 'imu.mounting_rpy': list(mounting_rpy), 'vehicle.non_holonomic': name == 'sideslip'})
    disturbed = recorded(drive, [(effect, theta)], mounting_rpy)
    # when the filter does not know, knows, and when there is no effect
    ignorant = horizontal_error(configure(values), disturbed)
    knowing = horizontal_error(configure(effect.adjusted(values, theta)), disturbed)
    clean = horizontal_error(configure(values), recorded(drive, (), mounting_rpy))
    # then knowing it is as good as not having it
    assert knowing < 1.15 * clean
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
    theta = effect.complete(SIZES.get(name, {}))
    if name in ('gnss_coloured_noise', 'mounting_rotation'):  # variances only add, and rotations do not commute
        theta = {'sigma': 0.0, 'tau': 60.0} if 'sigma' in theta else {'roll': 0.0, 'pitch': 0.0, 'yaw': 0.2}
    values = table.check(PAPER)
    there = effect.adjusted(values, theta)
    back = effect.adjusted(there, {name: -value if name != 'tau' else value for name, value in theta.items()})
    table.check(there)  # what corrected.yaml holds loads again
    for key, value in values.items():
        # one number for all axes may have become three
        same = back[key] == value or np.abs(np.subtract(back[key], value)).max() < 1e-12
        assert same, key


@pytest.mark.parametrize('name', EFFECTS)
def test_the_registry_says_all_that_a_report_needs(name):
    effect = EFFECTS[name]
    assert effect.name == name
    assert len(effect.signature) > 20
    assert effect.parameters and all(p.unit and p.prior_scale > 0 for p in effect.traced)
    assert effect.principal in [p.name for p in effect.parameters]
    assert all(table.ALL[setting.name] is setting for setting in effect.settings)
    # what is tried at fixed values leaves something to be estimated
    traced = {p.name for p in effect.traced}
    assert all(set(fixed) < traced for fixed in effect.tried)


def corrected_values() -> dict:
    return table.check({**PAPER,
        'imu.lever_arm': [2.0, -0.7, 0.3], 'accelerometer.temperature_coefficient': [0.02, -0.01],
        'gyroscope.temperature_coefficient': 3e-4, 'imu.mounting_rpy': [0.1, -0.2, 1.3]})


def test_correctors_take_samples_in_any_portions():
    # given samples with a gap, a doubled stamp, and a temperature that comes later
    rng, n = np.random.default_rng(4), 300
    stamp = np.cumsum(rng.integers(9_000_000, 11_000_000, n))
    stamp[100:] += 900_000_000
    stamp[200] = stamp[199]
    f, w = rng.standard_normal((2, n, 3)) * [[[3.0]], [[0.5]]]
    celsius = np.where(np.arange(n) < 50, np.nan, 20 + 0.05 * np.arange(n))
    values, names = corrected_values(), ('temperature', 'accelerometer_lever_arm')
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
        assert not np.array_equal(whole[0], f)


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


def test_effects_that_cannot_show_say_why(drive):
    recording, values = recorded(drive), table.check(PAPER)
    hidden = {name: effect.hidden(values, recording) for name, effect in EFFECTS.items()}
    assert {name for name, why in hidden.items() if why} == {'temperature', 'sideslip', 'mounting_rotation'}
    assert 'temperature_topic' in hidden['temperature']
    assert 'vehicle.non_holonomic' in hidden['sideslip'] and 'vehicle.non_holonomic' in hidden['mounting_rotation']
    # and where they can, they do not
    warm = recorded(drive, [(EFFECTS['temperature'], {})])
    constrained = {**values, 'vehicle.non_holonomic': True}
    assert not EFFECTS['temperature'].hidden(values, warm)
    assert not EFFECTS['sideslip'].hidden(constrained, recording)
    assert not EFFECTS['mounting_rotation'].hidden(constrained, recording)
    assert 'strapdown' in EFFECTS['tilt'].hidden({**values, 'mechanization': 'strapdown'}, recording)


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
