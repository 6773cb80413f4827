"""Simulated recordings: sensor errors, mounting, the receiver, and the command-line tool."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from simulation_support import FLU, close

from mems_ins_fusion.cli import simulate
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.parameters import parameter, table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.sensor_errors.models import Autoregressive, GaussMarkov, RandomWalk
from mems_ins_fusion.simulation.drive import START_STAMP
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording


@pytest.fixture(scope='module')
def drive():
    return simulate_drive(300.0, 1)


@pytest.fixture(scope='module')
def rest():
    return simulate_drive(20000.0, 1, rate=10.0, standstill=20000.0)


def within(variance, expected, n, probability=1e-4):
    """Whether the variance of n independent normal numbers of known mean is one that `expected` allows."""
    low, high = chi2.ppf([probability / 2, 1 - probability / 2], n) / n
    return low < variance / expected < high


def fix_error(recording, drive, time=None):
    """North, east, down error of the fixes, (m, 3) m, against the truth at `time` (default: their stamps)."""
    fixes = recording.gnss
    true = drive.at((fixes.stamp - START_STAMP) * 1e-9 if time is None else time)
    meridian, prime_vertical = radii(true.latitude)
    return np.column_stack([(fixes.latitude - true.latitude) * (meridian + true.height),
                            (fixes.longitude - true.longitude) * (prime_vertical + true.height) * np.cos(true.latitude),
                            true.height - fixes.height])


def test_perfect_sensors_record_the_truth_in_forward_left_up(drive):
    imu = simulate_recording(drive).recording.imu
    assert close(imu.specific_force, drive.specific_force * FLU, 1e-12)
    assert close(imu.angular_rate, drive.angular_rate * FLU, 1e-12)
    assert np.array_equal(imu.stamp, drive.stamp) and np.array_equal(imu.received, drive.stamp)


def test_mounting_turns_from_sensor_axes_to_base_link(drive):
    # given sensor axes x back, y right, z up (a half turn about z) and x left, y back, z up (a quarter turn)
    quarter = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    for yaw, to_sensor in ((np.pi, np.diag([-1.0, -1.0, 1.0])), (np.pi / 2, quarter)):
        imu = simulate_recording(drive, mounting_rpy=(0, 0, yaw)).recording.imu
        assert close(imu.specific_force, drive.specific_force * FLU @ to_sensor.T, 1e-12)
    # given x forward, y right, z down
    imu = simulate_recording(drive, mounting_rpy=(np.pi, 0, 0)).recording.imu
    assert close(imu.angular_rate, drive.angular_rate, 1e-12)


def test_mounting_applies_roll_then_pitch_then_yaw_about_fixed_axes(drive):
    rpy = (0.3, -0.2, 1.1)
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in rpy)
    to_base = (np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
               @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]]))
    imu = simulate_recording(drive, mounting_rpy=rpy).recording.imu
    assert close(imu.specific_force @ to_base.T, drive.specific_force * FLU, 1e-12)


def test_white_noise_has_its_density(drive):
    densities = np.array([0.01, 0.02, 0.03]), np.array([1e-4, 2e-4, 3e-4])
    sensors = SensorErrors(accelerometer_noise_density=densities[0], gyroscope_noise_density=densities[1])
    imu = simulate_recording(drive, sensors).recording.imu
    noise = imu.specific_force - drive.specific_force * FLU, imu.angular_rate - drive.angular_rate * FLU
    for sensor, density in zip(noise, densities):
        for axis in range(3):
            assert within(np.mean(sensor[:, axis]**2), density[axis]**2 * drive.rate, len(sensor))
        whiteness = np.corrcoef(sensor[1:, 0], sensor[:-1, 0])[0, 1]
        assert abs(whiteness) < 4 / np.sqrt(len(sensor))
    together = np.corrcoef(np.column_stack(noise).T) - np.eye(6)
    assert np.abs(together).max() < 4.5 / np.sqrt(len(drive.time))


def test_bias_and_scale_are_in_sensor_axes(drive):
    sensors = SensorErrors(accelerometer_bias=(0.1, 0.2, 0.3), gyroscope_scale=(0.0, 0.0, 0.01))
    simulation = simulate_recording(drive, sensors, mounting_rpy=(np.pi, 0, 0))  # forward-right-down
    imu = simulation.recording.imu
    assert close(imu.specific_force, drive.specific_force + [0.1, 0.2, 0.3], 1e-12)
    assert close(imu.angular_rate, drive.angular_rate * [1, 1, 1.01], 1e-12)
    assert close(simulation.sensor_errors[7], [0.1, 0.2, 0.3, 0, 0, 0], 1e-12)


def test_the_errors_of_the_axes_are_independent(rest):
    model = GaussMarkov(1.0, 10.0)
    error = simulate_recording(rest, SensorErrors((model,) * 3, (model,) * 3)).sensor_errors
    # 20000 s hold 20000 / 10 independent products of two such errors
    assert np.abs(np.corrcoef(error.T) - np.eye(6)).max() < 4.5 / np.sqrt(2000)


def test_the_turn_on_bias_is_constant_and_drawn_for_each_seed():
    short = simulate_drive(0.5, rate=10.0, standstill=0.5)
    sensors = SensorErrors(gyroscope_turn_on_sigma=(0.01, 0.02, 0.0))
    bias = np.array([simulate_recording(short, sensors, seed=seed).recording.imu.angular_rate for seed in range(400)])
    assert close(bias, bias[:, :1], 0.0)
    assert within(np.mean(bias[:, 0, 0]**2), 0.01**2, 400) and within(np.mean(bias[:, 0, 1]**2), 0.02**2, 400)
    assert np.all(bias[:, 0, 2] == 0)


def test_random_walk_of_the_recording_drives_as_its_model(rest):
    q = 1e-3
    sensors = SensorErrors(accelerometer=(RandomWalk(q, 0.0), None, None))
    error = simulate_recording(rest, sensors).recording.imu.specific_force[:, 0]
    assert error[0] == 0
    assert within(np.mean(np.diff(error)**2), q**2 / rest.rate, len(error) - 1)


def test_gauss_markov_of_the_recording_has_its_transition(rest):
    sigma, tau = 0.05, 30.0
    sensors = SensorErrors(gyroscope=(None, None, GaussMarkov(sigma, tau)))
    simulation = simulate_recording(rest, sensors)
    error = simulation.recording.imu.angular_rate[:, 2]
    driving = error[1:] - np.exp(-1 / (rest.rate * tau)) * error[:-1]
    assert within(np.mean(driving**2), sigma**2 * (1 - np.exp(-2 / (rest.rate * tau))), len(driving))
    # of the whole: 20000 s hold about 20000 / (2 * 30) independent values of error^2 (integral of rho^2 is tau)
    assert np.mean(error**2) == pytest.approx(sigma**2, rel=4 * np.sqrt(2 * tau * 2 / 20000))
    assert close(simulation.sensor_errors[:, 5], -error, 1e-12)  # body axes point down


def test_autoregressive_of_the_recording_steps_at_its_interval(rest):
    a, b0 = (-1.2, 0.32), 0.01
    sensors = SensorErrors(accelerometer=(None, Autoregressive(a, b0, interval=1.0), None))
    error = simulate_recording(rest, sensors).recording.imu.specific_force[:, 1].reshape(-1)
    steps = error[:200000].reshape(-1, 10)
    assert np.all(steps == steps[:, :1])  # holds in between
    y = steps[:, 0]
    driving = y[2:] + a[0] * y[1:-1] + a[1] * y[:-2]
    assert within(np.mean(driving**2), b0**2, len(driving))


@pytest.mark.parametrize('model, state', [('random_walk', RandomWalk), ('gauss_markov', GaussMarkov),
                                          ('autoregressive', Autoregressive)])
def test_sensor_errors_come_from_the_parameters(model, state):
    values = table.check({'accelerometer.noise_density': [1.0, 2.0, 3.0], 'gyroscope.bias': [0.5],
                               'gyroscope.initial_sigma': [0.03],
                               'gyroscope.random_walk.q': [1e-6, 2e-6, 3e-6],
                               'gyroscope.gauss_markov.tau': [10, 20, 30],
                               'gyroscope.autoregressive.coefficients': [-0.5, -0.6, -0.7],
                               'gyroscope.autoregressive.order': 1})
    sensors = SensorErrors.from_parameters(values, model)
    assert sensors.accelerometer_noise_density == [1.0, 2.0, 3.0] and sensors.gyroscope_bias == [0.5] * 3
    assert sensors.gyroscope_turn_on_sigma[0] == (0.0 if model == 'random_walk' else 0.03)
    assert all(isinstance(m, state) for m in (*sensors.accelerometer, *sensors.gyroscope))
    second = sensors.gyroscope[1]
    assert {'random_walk': lambda: second.q == 2e-6, 'gauss_markov': lambda: second.tau == 20,
            'autoregressive': lambda: second.coefficients == (-0.6,)}[model]()


@pytest.mark.parametrize('coefficients, order, message', [([-0.5, -0.6, -0.7, 0.1], 3, '3 or 9'),
                                                          ([-2.5, 1.0], 2, 'not stable')])
def test_autoregressive_parameters_that_cannot_be_are_refused(coefficients, order, message):
    values = table.check({'accelerometer.autoregressive.coefficients': coefficients,
                               'accelerometer.autoregressive.order': order})
    with pytest.raises(parameter.ParameterError, match=message):
        SensorErrors.from_parameters(values, 'autoregressive')


def test_fixes_scatter_as_their_covariance_says(rest):
    simulation = simulate_recording(rest, gnss=GnssNoise(sigma=2.0, rate=1.0))
    error, fixes = fix_error(simulation.recording, rest), simulation.recording.gnss
    assert np.all(fixes.covariance == np.diag([4.0, 4.0, 9.0])) and np.all(fixes.covariance_type == 2)
    for axis, variance in enumerate((4.0, 4.0, 9.0)):
        assert within(np.mean(error[:, axis]**2), variance, len(error))
    assert np.abs(np.corrcoef(error.T) - np.eye(3)).max() < 4 / np.sqrt(len(error))


def test_perfect_fixes_are_the_truth_between_imu_samples(drive):
    simulation = simulate_recording(drive, gnss=GnssNoise(sigma=0.0, rate=5.0))
    fixes = simulation.recording.gnss
    assert len(fixes) == 1500 and not np.isin(fixes.stamp, drive.stamp).any()
    assert np.abs(fix_error(simulation.recording, drive)).max() < 1e-6


def test_outages_take_fixes_away_and_leave_the_others_as_they_were(drive):
    whole = simulate_recording(drive, gnss=GnssNoise()).recording.gnss
    holed = simulate_recording(drive, gnss=GnssNoise(outages=[(50, 80), (200, 210)])).recording.gnss
    time = (whole.stamp - START_STAMP) * 1e-9
    kept = whole.select(~((time >= 50) & (time < 80) | (time >= 200) & (time < 210)))
    assert len(kept) == len(whole) - 40
    assert np.array_equal(holed.stamp, kept.stamp) and np.array_equal(holed.latitude, kept.latitude)


def test_latency_delays_arrival_alone(drive):
    prompt, late = (simulate_recording(drive, gnss=GnssNoise(latency=x)).recording.gnss for x in (0.0, 0.3))
    assert np.array_equal(prompt.stamp, late.stamp) and np.array_equal(prompt.longitude, late.longitude)
    assert np.all(late.received - late.stamp == 300_000_000)


@pytest.mark.parametrize('arguments', [{'rate': 0.0}, {'sigma': -1.0}, {'outages': [(20, 10)]}])
def test_a_receiver_that_cannot_be_is_refused(arguments):
    with pytest.raises(ValueError):
        GnssNoise(**arguments)


def test_the_seed_decides_the_noise_and_the_models_do_not_change_the_white_part(drive):
    white = SensorErrors(accelerometer_noise_density=(0.01,) * 3)
    slow = replace(white, accelerometer=(GaussMarkov(0.05, 100.0), None, None))
    first, again, other = (simulate_recording(drive, white, seed=seed).recording for seed in (3, 3, 4))
    assert np.array_equal(first.imu.specific_force, again.imu.specific_force)
    assert not np.array_equal(first.imu.specific_force, other.imu.specific_force)
    assert not np.array_equal(first.gnss.latitude, other.gnss.latitude)
    with_slow = simulate_recording(drive, slow, seed=3)
    difference = with_slow.recording.imu.specific_force - first.imu.specific_force
    assert close(difference, with_slow.sensor_errors[:, :3] * FLU, 1e-12)


def test_the_reference_is_the_true_motion_of_the_imu(drive):
    reference = simulate_recording(drive).recording.reference
    assert np.array_equal(reference.latitude, drive.latitude) and np.array_equal(reference.velocity, drive.velocity)
    assert np.cos(reference.yaw - drive.yaw) == pytest.approx(1.0) and np.abs(reference.yaw).max() <= np.pi


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_tool_writes_what_the_library_simulates(tmp_path, storage, capsys):
    bag = tmp_path / 'bag'
    params = tmp_path / 'params.yaml'
    params.write_text('/**:\n  ros__parameters:\n    imu.mounting_rpy: [0.0, 0.0, 3.14159]\n'
                      '    gnss.lever_arm: [0.5, 0, 0]\n    gyroscope.noise_density: [0.001]\n'
                      '    sensor_error_model: random_walk\n')
    # when
    status = simulate.main(['--output', str(bag), '--duration', '60', '--seed', '5', '--storage', storage, '--hills',
                            '--gnss-rate', '5', '--gnss-sigma', '0', '--params-file', str(params),
                            '--effect', 'gyroscope_scale=0.02', '--effect', 'gnss_lever_arm.y=0.25',
                            '--effect', 'temperature=0', '--outage', '30:40', '--aiding', '--input-rate', '50'])
    # then
    assert status == 0 and 'gyroscope_scale z=0.02' in capsys.readouterr().out
    read = read_recording(bag, '/imu/data', '/gps/fix', '/reference/fix', '/imu/temperature',
                          speed_topic='/wheel/speed', velocity_topic='/gps/velocity')
    assert abs(len(read.speed) - 3000) <= 1 and abs(len(read.velocity) - 300) <= 1
    drive = simulate_drive(60.0, 5, hills=True)
    noise = 4.5 * 0.001 * np.sqrt(100)
    slow = SensorErrors.from_parameters(table.defaults(), 'random_walk').gyroscope[2]
    bound = noise + 5 * (slow.initial_sigma + slow.q * np.sqrt(60))
    assert np.abs(read.imu.angular_rate[:, 2] + 1.02 * drive.angular_rate[:, 2]).max() < bound
    assert len(read.imu) == 6001 and len(read.gnss) == 250 and len(read.temperature.celsius) == 61
    assert close(np.linalg.norm(fix_error(read, drive)[:, :2], axis=1), np.hypot(0.5, 0.25), 0.01)
    assert close(read.reference.latitude, drive.latitude[::10], 1e-12)
    assert close(read.reference.height, drive.height[::10], 1e-9)


def test_the_odometry_of_the_tool_is_the_same_truth(tmp_path):
    bag = tmp_path / 'bag'
    simulate.main(['--output', str(bag), '--duration', '60', '--seed', '5', '--hills'])
    with pytest.warns(UserWarning, match='first fix'):
        read = read_recording(bag, '/imu/data', '/gps/fix', '/reference/odometry')
    drive = simulate_drive(60.0, 5, hills=True)
    assert close(read.reference.latitude, drive.latitude[::10], 1e-10)
    assert close(read.reference.velocity, drive.velocity[::10], 1e-3)
    assert close(np.cos(read.reference.yaw - drive.yaw[::10]), 1.0, 1e-9)


def test_static_is_a_recording_at_rest(tmp_path):
    simulate.main(['--output', str(tmp_path / 'bag'), '--duration', '40', '--static'])
    reference = read_recording(tmp_path / 'bag', '/imu/data', reference_topic='/reference/fix').reference
    assert np.ptp(reference.latitude) == 0


def test_an_existing_bag_is_kept_unless_told_otherwise(tmp_path, capsys):
    arguments = ['--output', str(tmp_path / 'bag'), '--duration', '5']
    assert simulate.main(arguments) == 0
    assert simulate.main(arguments) == 2 and 'exists already' in capsys.readouterr().err
    assert simulate.main([*arguments, '--overwrite']) == 0


@pytest.mark.parametrize('arguments, message', [
    (['--effect', 'tilts=1'], "no effect is named 'tilts'"),
    (['--effect', 'tilt'], 'NAME=VALUE'),
    (['--effect', 'tilt.yaw=1'], "no parameter 'yaw'"),
    (['--effect', 'tilt=much'], "'much' is not a number"),
    (['--duration', '0'], '--duration must be from 0.1'),
    (['--duration', 'inf'], '--duration must be from 0.1'),
    (['--standstill', '-1'], 'standstill'),
    (['--gnss-rate', '0'], '--gnss-rate must be from'),
    (['--input-rate', '0'], '--input-rate must be from'),
    (['--reference-rate', '0'], '--reference-rate must be from'),
    (['--outage', '10-20'], 'START:STOP'),
    (['--outage', '0:100'], 'no fix'),
    (['--params-file', 'absent.yaml'], 'absent.yaml'),
])
def test_bad_usage_is_told_in_one_line(tmp_path, capsys, arguments, message):
    status = simulate.main(['--output', str(tmp_path / 'bag'), '--duration', '5', *arguments])
    error = capsys.readouterr().err
    assert status == 2 and message in error and error.count('\n') == 1
    assert not (tmp_path / 'bag').exists()
