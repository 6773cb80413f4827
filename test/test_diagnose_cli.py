"""The tool `diagnose`: what it writes, and that its corrected.yaml makes the filter better."""
from __future__ import annotations

import json
import re

import numpy as np
import pytest
from browser_support import check_page
from filter_support import PAPER

from mems_ins_fusion.cli.diagnose import main
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

OFFSET = 0.3  # s
GIVEN = """
/**:
  ros__parameters:
    gnss.sigma: 0.5
    reference_lever_arm: [0.0, 0.0, 0.0]
    gyroscope.noise_density: [0.0003]
    outage_spacing: 20.0
"""


def _number(text: str):
    raise ValueError(f'{text} is no JSON')


@pytest.fixture(scope='module')
def result(tmp_path_factory):
    """A drive whose receiver's clock is off, its bag, and what diagnose made of it."""
    folder = tmp_path_factory.mktemp('diagnose')
    values = table.check(PAPER)
    simulation = simulate_recording(
        simulate_drive(400.0, 1, rate=25.0), SensorErrors.from_parameters(values, 'gauss_markov'), GnssNoise(sigma=0.5),
        [(EFFECTS['gnss_time_offset'], {'time_offset': OFFSET})], seed=1)
    write_recording(simulation.recording, folder / 'bag')
    (folder / 'given.yaml').write_text(GIVEN)
    status = main(['--bag', str(folder / 'bag'), '--output', str(folder / 'out'), '--params-file',
                   str(folder / 'given.yaml'), '--reference-topic', '/reference/fix'])
    assert status == 0
    return folder


def test_the_report_is_valid_json_with_what_the_design_promises(result):
    content = json.loads((result / 'out' / 'report.json').read_text(), parse_constant=_number)

    [effect] = [e for e in content['effects'] if e['added']]
    assert effect['name'] == 'gnss_time_offset' and 'gnss_time_offset' in effect['group']
    offset = effect['parameters']['time_offset']
    assert offset['unit'] == 's'
    assert abs(offset['value'] - OFFSET) < 3.5 * offset['sigma'] < 0.2  # the truth, by its own standard deviation
    assert effect['log_likelihood_gain'] > 0 and effect['p_value'] < 0.01
    for stage in ('before', 'noise_fitted', 'after'):
        assert {'horizontal_rmse_m', 'outages', 'nis_mean', 'ljung_box_p'} <= set(content[stage])
        for outage in content[stage]['outages']:
            assert {'model', 'duration_s', 'count', 'max_error_rms_m', 'max_error_median_m', 'max_error_p95_m',
                    'percent_of_distance'} <= set(outage)
    assert content['after']['horizontal_rmse_m'] < content['before']['horizontal_rmse_m']
    assert isinstance(content['unexplained'], bool)
    # there is no temperature, and a level drive shows no height of an antenna; the constraint that sideslip needs is on
    assert {'temperature', 'gnss_lever_arm.z'} <= set(content['not_identifiable'])


def test_outages_begin_as_far_apart_as_asked(result):
    # given 400 s, of which the first outage begins 30 s after the start, and the last 10 s before the end
    content = json.loads((result / 'out' / 'report.json').read_text())
    for when in ('before', 'after'):
        counts = {row['duration_s']: row['count'] for row in content[when]['outages']}
        assert counts[10.0] == pytest.approx((400.0 - 30.0 - 10.0) / 20.0, abs=2)


def test_no_number_is_given_for_what_is_not_identifiable(result):
    content = json.loads((result / 'out' / 'report.json').read_text())

    for candidates in content['rounds']:
        for candidate in candidates:
            assert not set(candidate['parameters']) & set(candidate['undetermined'])


def test_corrected_parameters_load_and_keep_what_was_given(result):
    given = params_file.load_yaml(result / 'out' / 'corrected.yaml')
    values = table.check(given)

    assert values['reference_lever_arm'] == [0.0, 0.0, 0.0]
    assert values['gnss.time_offset'] == pytest.approx(OFFSET, abs=0.1)
    assert 'reference_topic' not in given and 'imu_topic' not in given  # nothing but what was given, and what changed
    FusionFilter(FilterConfig.from_parameters(values))


def test_a_filter_with_the_corrected_parameters_makes_a_smaller_error(result):
    recording = read_recording(result / 'bag', '/imu/data', '/gps/fix', '/reference/fix')

    def error(name):
        values = table.check(params_file.load_yaml(name))
        track = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss)
        truth, late = recording.reference, track.stamp > track.stamp[0] + 30 * 10**9
        origin = truth.stamp[0]
        latitude, longitude = (np.interp(track.stamp - origin, truth.stamp - origin, angle)
                               for angle in (truth.latitude, truth.longitude))
        meridian, prime_vertical = radii(truth.latitude[0])
        north = (track.latitude - latitude) * meridian
        east = (track.longitude - longitude) * prime_vertical * np.cos(latitude)
        return np.sqrt(np.mean(north[late] ** 2 + east[late] ** 2))

    before, after = error(result / 'given.yaml'), error(result / 'out' / 'corrected.yaml')
    # fixes that are OFFSET late shift the track by speed times OFFSET, at 10 m/s some 3 m; white noise of 0.5 m is left
    assert before > 2.0
    assert after < 0.8


def test_the_page_is_self_contained_and_the_comments_say_where_values_come_from(result):
    page = (result / 'out' / 'report.html').read_text(encoding='utf-8')
    yaml = (result / 'out' / 'corrected.yaml').read_text(encoding='ascii')

    assert 'gnss_time_offset' in page and 'data:image/png;base64,' in page
    answer = json.loads((result / 'out' / 'report.json').read_text())['answer']
    assert page.index(answer['headline']) < page.index('<canvas') < page.index('<details>')
    assert re.fullmatch(r'Use corrected.yaml: .* m instead of .* m \(95 %: .* m less\)\.', answer['headline'])
    assert answer['steps'][0]['command'].endswith(f"--params-file {result / 'out' / 'corrected.yaml'}")
    assert any('stamps a fix' in step['what'] and 'gnss.time_offset: 0.' in step['what'] for step in answer['steps'])
    assert '+-' in yaml.split('gnss.time_offset:')[0].splitlines()[-2]


def test_nothing_is_wider_than_its_page(result, browser):
    check_page(browser, result / 'out' / 'report.html')


def test_an_existing_result_stays_unless_overwritten(result, capsys):
    before = (result / 'out' / 'report.json').read_bytes()
    status = main(['--bag', str(result / 'bag'), '--output', str(result / 'out')])

    assert status == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert (result / 'out' / 'report.json').read_bytes() == before


@pytest.mark.parametrize('more, said', [
    (['--start', '100', '--stop', '50'], 'stop'),
    (['--stop', '60'], 'fixes'),
    (['--reference-topic', '/nothing'], '/nothing'),
    (['--params-file', 'nothing.yaml'], 'nothing.yaml'),
    (['--reference-topic', '/reference/fix', '--reference-file', 'track.csv'], '--reference-file'),
])
def test_bad_input_gives_one_line_status_2_and_no_result(result, tmp_path, capsys, more, said):
    status = main(['--bag', str(result / 'bag'), '--output', str(tmp_path / 'out'), *more])

    error = capsys.readouterr().err
    assert status == 2
    assert len(error.splitlines()) == 1 and said in error and error.startswith('diagnose: ')
    assert not list(tmp_path.iterdir())


# several recordings of one vehicle

@pytest.fixture(scope='module')
def several(tmp_path_factory):
    """Two drives of one vehicle, an mcap under the home directory and a sqlite3, and one that is too short."""
    folder = tmp_path_factory.mktemp('several')
    values = table.check(PAPER)
    for name, seed, duration, storage in (('monday', 1, 240.0, 'mcap'), ('tuesday', 2, 240.0, 'sqlite3'),
                                          ('yard', 3, 40.0, 'mcap')):
        simulation = simulate_recording(
            simulate_drive(duration, seed, rate=25.0), SensorErrors.from_parameters(values, 'gauss_markov'),
            GnssNoise(sigma=0.5), [(EFFECTS['gnss_time_offset'], {'time_offset': OFFSET})], seed=seed)
        write_recording(simulation.recording, folder / name, storage)
    (folder / 'given.yaml').write_text(GIVEN)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('HOME', str(folder))
        assert main(['--bag', '~/monday', *(str(folder / name) for name in ('yard', 'tuesday')), '--output',
                     str(folder / 'out'), '--params-file', str(folder / 'given.yaml'), '--reference-topic',
                     '/reference/fix']) == 0
    return folder


def test_several_recordings_give_one_report_with_each_drive_in_it(several):
    content = json.loads((several / 'out' / 'report.json').read_text(), parse_constant=_number)

    assert content['recording'] == 'monday, tuesday'
    assert list(content['left_out']) == ['yard'] and 'fixes' in content['left_out']['yard']
    [effect] = [e for e in content['effects'] if e['added']]
    assert effect['name'] == 'gnss_time_offset' and set(effect['drives']) == {'monday', 'tuesday'}
    assert effect['parameters']['time_offset']['value'] == pytest.approx(OFFSET, abs=0.06)
    for drive in content['drives']:
        assert drive['after']['horizontal_rmse_m'] < drive['before']['horizontal_rmse_m']
        assert drive['after']['nis_mean'] < drive['before']['nis_mean']
    for stage in ('before', 'after'):
        outages = [drive[stage]['outages'][0]['count'] for drive in content['drives']]
        assert content[stage]['outages'][0]['count'] == sum(outages) and min(outages) > 0
    values = table.check(params_file.load_yaml(several / 'out' / 'corrected.yaml'))
    assert values['gnss.time_offset'] == pytest.approx(OFFSET, abs=0.06)


def test_the_page_of_several_recordings_names_each(several, browser):
    page = (several / 'out' / 'report.html').read_text(encoding='utf-8')

    assert page.count('<canvas class="map"') == 2
    assert 'yard was left out' in page and 'Drive tuesday' in page
    check_page(browser, several / 'out' / 'report.html')


@pytest.mark.parametrize('names, said', [
    (('monday', 'monday'), 'give each recording once'),
    (('monday', 'nowhere'), 'nowhere'),
])
def test_recordings_that_do_not_go_together_give_one_line_and_no_result(several, tmp_path, capsys, names, said):
    status = main(['--bag', *(str(several / name) for name in names), '--output', str(tmp_path / 'out')])

    error = capsys.readouterr().err
    assert status == 2 and len(error.splitlines()) == 1 and said in error
    assert not list(tmp_path.iterdir())
