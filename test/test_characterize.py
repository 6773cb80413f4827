"""`characterize` from end to end: a simulated sensor with known errors, recovered and used in a drive; bad input."""
import contextlib
import io
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from browser_support import check_page
from conftest import shared_data
from filter_support import PAPER

from mems_ins_fusion.characterization.characterize import characterize
from mems_ins_fusion.characterization.stationary import Grid
from mems_ins_fusion.cli.characterize import main
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.samples import ImuSamples, Recording, Temperatures
from mems_ins_fusion.sensor_errors.models import simulate
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

RATE = 20.0
TRUE = table.check({**PAPER,
    'sensor_error_model': 'gauss_markov',
    'accelerometer.noise_density': [4e-3], 'accelerometer.gauss_markov.sigma': [2e-2, 3e-2, 2e-2],
    'accelerometer.gauss_markov.tau': [60.0, 90.0, 120.0], 'accelerometer.initial_sigma': [0.05],
    'gyroscope.noise_density': [3e-4], 'gyroscope.gauss_markov.sigma': [8e-4],
    'gyroscope.gauss_markov.tau': [60.0], 'gyroscope.initial_sigma': [2e-3], 'gyroscope.bias': [2e-3, -1e-3, 5e-4]})
BIAS = np.array([0.02, -0.03, 0.05, *TRUE['gyroscope.bias']])
SLOPE = 1e-3  # m/s^2 per degree, accelerometer x


def sensor_at_rest(seconds, seed=1):
    """Specific force and angular rate (n, 6) of the sensor with the TRUE errors, z down, and its temperature."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    errors = SensorErrors.from_parameters(TRUE, 'gauss_markov')
    density = np.array([*errors.accelerometer_noise_density, *errors.gyroscope_noise_density])
    slow = np.stack([simulate(m, n, 1 / RATE, rng) for m in (*errors.accelerometer, *errors.gyroscope)], axis=1)
    celsius = 30 + 8 * np.sin(2 * np.pi * np.arange(n) / n)
    values = BIAS + np.array([0, 0, -9.80665, 0, 0, 0]) + slow + density * np.sqrt(RATE) * rng.standard_normal((n, 6))
    values[:, 0] += SLOPE * (celsius - 30)
    return values, celsius


@pytest.fixture(scope='module')
def result(tmp_path_factory):
    """An hour at rest as a bag, with a knock, through the command line."""
    folder = tmp_path_factory.mktemp('characterize')
    values, celsius = sensor_at_rest(3600)
    values[40_000:40_010, :3] += 3.0
    stamp = 1_700_000_000 * 10**9 + np.arange(len(values)) * round(1e9 / RATE)
    imu = ImuSamples(stamp, stamp, values[:, :3], values[:, 3:])
    temperature = Temperatures(stamp[::20], stamp[::20], celsius[::20])
    write_recording(Recording('rest', imu, temperature=temperature), folder / 'bag',
                    temperature_topic='/imu/temperature')
    arguments = ['--bag', str(folder / 'bag'), '--output', str(folder / 'out'), '--orders', '1', '2',
                 '--temperature-topic', '/imu/temperature']
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert main(arguments) == 0
    return SimpleNamespace(
        arguments=arguments, out=folder / 'out', said=said.getvalue(),
        report=json.loads((folder / 'out' / 'report.json').read_text()),
        values=table.check(params_file.load_yaml(folder / 'out' / 'imu.yaml')))


def test_parameters_are_recovered_within_their_intervals(result):
    names = {'noise_density': 'noise_density', 'sigma': 'gauss_markov.sigma', 'tau': 'gauss_markov.tau'}
    inside = []
    for i, axis in enumerate(result.report['axes']):
        sensor = axis['name'].split()[0]
        for key, name in names.items():
            estimate = axis['models']['gauss_markov']['estimates'][key]
            truth = np.resize(TRUE[f'{sensor}.{name}'], 3)[i % 3]
            inside.append(estimate['lower'] <= truth <= estimate['upper'])
            assert estimate['value'] == pytest.approx(result.values[f'{sensor}.{name}'][i % 3], rel=0.02)
    # 18 intervals of 95 %: fewer than 14 inside has a probability of 0.2 %
    assert sum(inside) >= 14


def test_params_file_holds_what_a_filter_needs(result):
    for model in ('random_walk', 'gauss_markov', 'autoregressive'):
        FilterConfig.from_parameters({**result.values, 'sensor_error_model': model})
    assert result.values['gyroscope.bias'] == pytest.approx(BIAS[3:], abs=3 * 8e-4 / np.sqrt(3600 / 120))
    assert result.values['accelerometer.bias'] == [0.0]  # cannot be told from tilt
    text = (result.out / 'imu.yaml').read_text()
    assert text.count('#') > 15 and 'cannot be distinguished from tilt' in text


def test_numbers_are_told_as_data_sheets_write_them(result):
    # given a gyroscope with 3e-4 rad/s/sqrt(Hz), which is 1.03 deg/sqrt(h), and accelerometers with 4e-3 m/s^2/sqrt(Hz)
    text = (result.out / 'imu.yaml').read_text()
    told = dict(re.findall(r'# in data sheets: .*?([\d.]+), [\d.]+, [\d.]+ (deg/sqrt\(h\)|ug/sqrt\(Hz\))', text))
    assert {unit: float(number) for number, unit in told.items()} == pytest.approx(
        {'deg/sqrt(h)': 1.031, 'ug/sqrt(Hz)': 407.9}, rel=0.1)
    assert all(unit in text for unit in (' mg', ' deg/h'))
    # and on the terminal in a line for each sensor, from the best to the worst axis
    for sensor, unit, density in (('gyroscopes', 'deg/sqrt(h)', 1.031), ('accelerometers', 'ug/sqrt(Hz)', 407.9)):
        line, = (line for line in result.said.splitlines() if line.startswith(f'{sensor}: white noise'))
        found = re.search(rf'white noise ([\d.]+)(?: to ([\d.]+))? {re.escape(unit)}; bias instability', line)
        assert [float(v) for v in found.groups() if v] == pytest.approx([density] * (1 + bool(found[2])), rel=0.1)
        assert len(line) <= 100
    # four digits are enough, but for the coefficients
    values = [number for number in re.findall(r'(?<![\w.])-?\d+\.[\d]+(?:e-\d+)?', '\n'.join(
        line for line in text.splitlines() if '#' not in line and 'coefficients' not in line))]
    assert values and all(len(v.split('e')[0].replace('.', '').lstrip('-0')) <= 4 for v in values)


def test_knock_is_cut_out_and_gravity_and_temperature_are_reported(result):
    assert [cut['reason'] for cut in result.report['cuts']] == ['knock']
    assert result.report['cuts'][0]['start_s'] <= 2000 <= result.report['cuts'][0]['stop_s']
    assert result.report['gravity_mps2'] == pytest.approx(9.80665 - BIAS[2], abs=0.02)
    slopes = [axis['temperature_slope'] for axis in result.report['axes']]
    assert slopes[0]['lower'] < SLOPE < slopes[0]['upper']
    assert sum(s['lower'] < 0 < s['upper'] for s in slopes[1:]) >= 4


def test_report_is_self_contained(result):
    page = (result.out / 'report.html').read_text(encoding='utf-8')
    assert page.count('<figure>') == 8 and 'http' not in page
    assert page.count('<img ') == page.count(' src="data:image/png;base64,') >= 8
    assert len(list((result.out / 'figures').glob('*.png'))) == 8


def test_existing_result_is_kept(result, capsys):
    before = (result.out / 'report.json').stat().st_mtime_ns
    assert main(result.arguments) == 2
    assert 'exists already' in capsys.readouterr().err
    assert (result.out / 'report.json').stat().st_mtime_ns == before


def test_drive_filtered_with_recovered_parameters_is_as_good_as_with_the_true_ones(result):
    # given drives with that sensor, a fix every 10 s, and the filter with the true and with the recovered parameters
    recovered = {**result.values, **PAPER, 'sensor_error_model': 'gauss_markov'}
    assert recovered['gyroscope.gauss_markov.sigma'] != TRUE['gyroscope.gauss_markov.sigma']
    errors = []
    for seed in range(4):
        drive = simulate_drive(300.0, seed, RATE)
        recording = simulate_recording(drive, SensorErrors.from_parameters(TRUE, 'gauss_markov'),
                                       GnssNoise(1.0, 0.1), seed=seed).recording
        errors.append([horizontal_rmse(run(FilterConfig.from_parameters(values), recording.imu, recording.gnss),
                                       recording.reference) for values in (TRUE, recovered)])
    true, found = np.sqrt(np.mean(np.square(errors), axis=0))
    # then the error is the same within a few per cent
    assert found < 1.05 * true
    assert true < 20


def horizontal_rmse(estimate, reference):
    north = (estimate.latitude - np.interp(estimate.stamp, reference.stamp, reference.latitude)) * 6.37e6
    east = (estimate.longitude - np.interp(estimate.stamp, reference.stamp, reference.longitude)) * 6.37e6
    return np.sqrt(np.mean(north**2 + (east * np.cos(estimate.latitude)) ** 2))


def test_white_sensor_gets_no_slow_error_and_a_cautious_filter():
    rng = np.random.default_rng(5)
    values = 0.01 * rng.standard_normal((int(900 * RATE), 6)) + np.array([0, 0, 9.8, 0, 0, 0])
    found = characterize('white', Grid(RATE, values), orders=(1, 2))
    assert not any(axis.significant for axis in found.axes)
    assert all(axis.allan_parameters.random_walk is None for axis in found.axes)
    from mems_ins_fusion.characterization.parameter_file import parameters as as_parameters
    q = as_parameters(found)['gyroscope.random_walk.q']
    assert all(0 < v < 1e-4 for v in q)  # what 900 s cannot exclude: far below the white noise, 2.2e-3


def test_measured_record_runs_and_shows_the_trap(tmp_path):
    # given 1500 s of a measured MEMS sensor
    with np.load(shared_data('adis16405_static') / 'record_1.npz') as data:
        np.savez(tmp_path / 'part.npz', rate_hz=data['rate_hz'], acc_mps2=data['acc_mps2'][:150_000],
                 gyro_radps=data['gyro_radps'][:150_000])
    assert main(['--bag', str(tmp_path / 'part.npz'), '--output', str(tmp_path / 'out'), '--orders', '1', '2']) == 0
    axes = json.loads((tmp_path / 'out' / 'report.json').read_text())['axes']
    for axis in axes[3:]:
        study = axis['intervals']
        assert study['plain'][0] < 0.1  # AR(2) on raw samples: the white noise
        assert axis['allan']['noise_density'] == pytest.approx(7e-4, rel=0.15)


@pytest.mark.parametrize('content, complaint', [
    ({}, "no array 'acc_mps2'"),
    ({'acc_mps2': np.zeros((10, 2)), 'gyro_radps': np.zeros((10, 3)), 'rate_hz': 100.0}, 'acc_mps2 must be numbers'),
    ({'acc_mps2': np.zeros((9, 3)), 'gyro_radps': np.zeros((10, 3)), 'rate_hz': 100.0}, '9 samples, gyro_radps 10'),
    ({'acc_mps2': np.zeros((10, 3)), 'gyro_radps': np.zeros((10, 3)), 'rate_hz': -1.0}, 'rate_hz must be'),
    ({'acc_mps2': np.zeros((10, 3)), 'gyro_radps': np.zeros((10, 3)), 'rate_hz': 100.0}, 'too short'),
    ({'acc_mps2': np.zeros((10000, 3)), 'gyro_radps': np.zeros((10000, 3)), 'rate_hz': 100.0}, 'constant value'),
])
def test_bad_npz_is_one_clear_line(tmp_path, capsys, content, complaint):
    np.savez(tmp_path / 'bad.npz', **content)
    assert main(['--bag', str(tmp_path / 'bad.npz'), '--output', str(tmp_path / 'out')]) == 2
    error = capsys.readouterr().err
    assert complaint in error and error.count('\n') == 1
    assert [p.name for p in tmp_path.iterdir()] == ['bad.npz']


@pytest.mark.parametrize('arguments, complaint', [
    (['--bag', 'nowhere.npz'], 'nowhere.npz is not a file'),
    (['--bag', 'nowhere'], 'nowhere'),
    (['--bag', 'x.npz', '--orders', '0'], '--orders must be from 1 to 20'),
])
def test_bad_options_are_one_clear_line(tmp_path, capsys, arguments, complaint):
    assert main([*arguments, '--output', str(tmp_path / 'out')]) == 2
    error = capsys.readouterr().err
    assert complaint in error and error.count('\n') == 1


def test_broken_npz_is_one_clear_line(tmp_path, capsys):
    (tmp_path / 'bad.npz').write_bytes(b'not a zip')
    assert main(['--bag', str(tmp_path / 'bad.npz'), '--output', str(tmp_path / 'out')]) == 2
    assert 'cannot be read as npz' in capsys.readouterr().err


def test_nothing_is_wider_than_its_page(result, browser):
    check_page(browser, result.out / 'report.html')
