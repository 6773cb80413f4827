"""The pages of replays and comparisons: the answer, the interactive track, their width; and the tool `compare`."""
from __future__ import annotations

import base64
import io
import json
import re
import shlex
import shutil
import time as clock
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from browser_support import check_page
from filter_support import PAPER
from matplotlib import image

from mems_ins_fusion.cli.compare import main as compare
from mems_ins_fusion.evaluation.comparison import compare as replay
from mems_ins_fusion.evaluation.metrics import rms
from mems_ins_fusion.evaluation.verdict import SAME
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.params_file import yaml_value
from mems_ins_fusion.recordings.checker import Remark
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.sketch import sketch
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.reports import html, replay_answer, replay_report
from mems_ins_fusion.reports.answer import WIDTH, shorten, typed
from mems_ins_fusion.reports.replay_report import _notices
from mems_ins_fusion.reports.series import _heading
from mems_ins_fusion.reports.side_by_side import (
    CompareError,
    ErrorSeries,
    Result,
    answer,
    comparison_verdict,
    read_result,
    rows_of,
)
from mems_ins_fusion.reports.track import Layer, script, track
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

OFFSET = 0.5  # s
#: of the two params files: as it is, and the receiver's clock taken for right
RIGHT, WRONG = f'gnss.time_offset: {OFFSET}', 'gnss.sigma: 0.3'


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """A drive whose receiver's clock is OFFSET late, two params files, and their comparison in `out`."""
    from mems_ins_fusion.effects.registry import EFFECTS

    folder = tmp_path_factory.mktemp('compare')
    simulation = simulate_recording(
        simulate_drive(240.0, 3, rate=50.0), SensorErrors.from_parameters(table.check({}), 'gauss_markov'),
        GnssNoise(sigma=0.3), [(EFFECTS['gnss_time_offset'], {'time_offset': OFFSET})], seed=3)
    write_recording(simulation.recording, folder / 'drive')
    for kind, line in (('right', RIGHT), ('wrong', WRONG)):
        (folder / f'{kind}.yaml').write_text(f'/**:\n  ros__parameters:\n    reference_lever_arm: [0.0, 0.0, 0.0]\n'
                                             f'    {line}\n' + ''.join(
                                                 f'    {name}: {yaml_value(value)}\n' for name, value in PAPER.items()))
    status = compare([str(folder / 'wrong.yaml'), str(folder / 'right.yaml'), '--bag', str(folder / 'drive'),
                      '--reference-topic', '/reference/fix', '--output', str(folder / 'out')])
    assert status == 0
    return folder


def read(path):
    return json.loads((path / 'report.json').read_text())


# compare

def test_the_better_of_two_params_files_is_named(folder):
    report = read(folder / 'out')
    assert report['answer']['headline'].startswith('right.yaml is better')
    assert {row['better'] for row in report['rows'] if row['outage_duration_s'] is None} == {'right.yaml'}
    # the numbers are those of the two replays, over the same epochs
    for place, side in enumerate(('first', 'second')):
        runs = {r['update_interval_s']: r for r in read(folder / 'out' / side)['runs']}
        for row in (r for r in report['rows'] if r['outage_duration_s'] is None):
            assert row['rms_m'][place] == pytest.approx(runs[row['update_interval_s']]['horizontal_rmse_m'], rel=5e-3)


def test_outages_are_matched_by_their_fixes_whatever_the_clocks_are_said_to_be(folder):
    report = read(folder / 'out')
    rows = [row for row in report['rows'] if row['outage_duration_s'] == 10.0]
    assert rows and all(row['paired'] >= 5 for row in rows)


def test_a_result_compared_with_itself_shows_no_difference(folder, tmp_path, capsys):
    assert compare([str(folder / 'out' / 'first'), str(folder / 'out' / 'first'), '--output', str(tmp_path / 'o')]) == 0
    report = read(tmp_path / 'o')
    assert all(row['better'] is None and row['rms_m'][0] == row['rms_m'][1] for row in report['rows'])
    # and neither is another drive asked for, nor anything said of what the one or the other was fitted to
    said = ' '.join(capsys.readouterr().out.split())
    assert said.startswith('No difference between') and ': all their errors are equal. next: Use either' in said


@pytest.mark.parametrize('arguments, said', [
    (['nothing', 'nothing'], 'nothing does not exist'),
    (['{}/wrong.yaml', '{}/right.yaml'], '--bag'),
    (['{}/wrong.yaml', '{}/drive'], 'two of the same kind'),
    (['{}/out', '{}/out/first'], 'not a result of replay_node'),
])
def test_bad_input_gives_one_line_status_2_and_no_result(folder, tmp_path, capsys, arguments, said):
    status = compare([a.format(folder) for a in arguments] + ['--output', str(tmp_path / 'out')])
    error = capsys.readouterr().err
    assert status == 2
    assert len(error.splitlines()) == 1 and said in error and error.startswith('compare: ')
    assert not list(tmp_path.iterdir())


def result(name, error):
    stamp = np.arange(len(error)) * 10**9
    return Result(name, ['drive'], ['random_walk'], {('drive', 'random_walk', 1.0): ErrorSeries(stamp, error)}, {})


def test_a_difference_is_certain_only_where_the_pairs_say_so():
    # given the same errors but for a small constant, which pairs show and two separate means would not
    noise = np.abs(np.random.default_rng(1).standard_normal(2000)) + 1.0
    [row] = rows_of(result('a', noise), result('b', noise + 0.1))
    assert row.change.sign() == 1 and row.count == 2000
    # and errors of their own, the same in the mean
    other = np.abs(np.random.default_rng(2).standard_normal(2000)) + 1.0
    [row] = rows_of(result('a', noise), result('b', other))
    assert row.change.sign() == 0


def test_outages_that_begin_at_other_fixes_are_said_to_be_so():
    # given two replays whose outages begin two seconds apart, as those of another version
    error = np.abs(np.random.default_rng(1).standard_normal(50)) + 1.0
    first, second = result('a', error), result('b', error)
    for one, begin in ((first, 0), (second, 2 * 10**9)):
        stamp = begin + 30 * 10**9 * np.arange(10)
        one.outages['drive', 'random_walk', 10.0] = ErrorSeries(stamp, error[:10], within=np.ones(10, bool),
                                                                nees=np.ones(10))
    # then that is what is wrong with the comparison, and not that there are too few epochs
    wrong = ' '.join(answer(first, second, rows_of(first, second)).wrong)
    assert 'the outages of the two begin at other fixes' in wrong and 'too few epochs' not in wrong


@pytest.mark.parametrize('held', [10, 7])
def test_equal_errors_in_other_ellipses_are_not_the_same(held):
    # given two replays with equal errors, of which the second holds 10 or 7 of 10 outages in its ellipse
    error = np.abs(np.random.default_rng(1).standard_normal(50)) + 1.0
    first, second = result('a', error), result('b', error)
    for one, count in ((first, 10), (second, held)):
        one.outages['drive', 'random_walk', 10.0] = ErrorSeries(30 * 10**9 * np.arange(10), error[:10],
                                                                within=np.arange(10) < count, nees=np.ones(10))
    # then only with the same ellipses does the filter do the same
    told = answer(first, second, rows_of(first, second))
    assert 'all their errors are equal' in told.headline
    assert ('does the same with both' in told.steps[0].what) == (held == 10)


def test_replays_of_different_drives_are_sent_to_the_same_one():
    # given two replays without one epoch in common, as those of two drives whose folders have the same name
    error = np.abs(np.random.default_rng(1).standard_normal(50)) + 1.0
    first, second = result('a', error), result('b', error)
    later = ErrorSeries(1000 * 10**9 + np.arange(50) * 10**9, error)
    second.runs['drive', 'random_walk', 1.0] = later
    told = answer(first, second, rows_of(first, second))
    # then another, longer drive is not what is missing
    assert 'different drives' in told.wrong[0] and told.steps[0].what.startswith('Replay both on the same drive')


# the answer

def test_a_filter_with_a_wrong_clock_is_not_called_good(folder):
    answer = read(folder / 'out' / 'first')['answer']['drive']
    assert answer['grade'] == 'bad' and answer['headline'].startswith('The filter is not good here')
    assert answer['trust'].startswith('no, its sigmas are too small')
    assert any('diagnose --bag' in step['command'] for step in answer['steps'])
    assert any('gnss.time_offset' in step['what'] for step in answer['steps'])
    assert sum('95 % ellipse' in text for text in answer['cost']) >= 1


def test_the_right_clock_is_called_good(folder):
    answer = read(folder / 'out' / 'second')['answer']['drive']
    assert answer['grade'] == 'good' and answer['headline'].startswith('The filter is good here')
    assert 'fusion_node' in answer['steps'][-1]['command']


def test_findings_of_the_checker_are_in_the_answer_with_their_topic(folder):
    values = table.check({'models': ['gauss_markov'], 'update_intervals': [2.0], 'outage_durations': []})
    comparison = replay(read_recording(folder / 'drive', '/imu/data', '/gps/fix'), values)
    found = [Remark('error', 'imu', f'9.8 is not {STANDARD_GRAVITY}'), Remark('info', 'gnss', 'all is well'),
             Remark('warning', 'imu/gnss', 'the clocks differ')]
    answer = replay_answer.answer(comparison, found, values, 'drive', 'p.yaml')
    assert answer.grade == 'bad' and answer.headline.startswith('Not usable: /imu/data: 9.8')
    assert f'/imu/data: 9.8 is not {STANDARD_GRAVITY}' in answer.wrong
    assert '/imu/data and /gps/fix: the clocks differ' in answer.wrong
    assert not any('all is well' in text for text in answer.wrong)
    # what sigmas are worth on wrong data is not said
    assert not answer.trust
    # diagnose refuses what is certainly wrong: what to do is configure where a parameter cures it, and else to record
    step, = answer.steps
    assert step.what.startswith('Correct this where the messages come from') and not step.command
    found[0] = replace(found[0], settings=('imu.acceleration_unit',))
    step, = replay_answer.answer(comparison, found, values, 'drive', 'p.yaml').steps
    assert step.command == 'python -m mems_ins_fusion configure --bag drive --output configured.yaml'


def test_what_a_parameter_would_cure_is_said_first_and_configure_is_what_to_do(folder):
    values = table.check({'models': ['gauss_markov'], 'update_intervals': [2.0], 'outage_durations': []})
    comparison = replay(read_recording(folder / 'drive', '/imu/data', '/gps/fix'), values)
    gaps = Remark('warning', 'imu', '21 gaps')
    late = Remark('warning', 'imu/gnss', 'the fixes are 0.27 s early', settings=('gnss.time_offset',))
    # given a recording with gaps, whose fixes are early
    answer = replay_answer.answer(comparison, [gaps, late], values, 'drive', 'p.yaml')
    assert answer.wrong[:2] == ['/imu/data and /gps/fix: the fixes are 0.27 s early', '/imu/data: 21 gaps']
    assert 'mems_ins_fusion configure --bag drive' in answer.first[0].command
    # with parameters that configure found in this very recording there is nothing more to be had from it
    again = values | {'fitted_to': sketch([comparison.recording.gnss])}
    assert 'configure' not in replay_answer.answer(comparison, [gaps, late], again, 'drive', 'p.yaml').first[0].command
    # and gaps alone are nothing that a parameter cures
    assert 'configure' not in replay_answer.answer(comparison, [gaps], values, 'drive', 'p.yaml').first[0].command


# the pages

def test_no_table_has_more_columns_than_fit_and_each_cell_its_label(folder):
    """The structure that keeps a table as wide as its page: on a phone each cell stands below its heading's name."""
    css = html._STYLE
    assert 'nowrap' not in css.split('td.number')[1].split('}')[0]
    narrow = css.split('@media screen and (max-width: 52rem)')[1]
    assert 'thead { display: none; }' in narrow and 'attr(data-label)' in narrow
    for page in (folder / 'out' / 'report.html', folder / 'out' / 'first' / 'report.html'):
        text = page.read_text(encoding='utf-8')
        assert len(re.findall('<table', text)) > 0
        for heading in re.findall('<thead>(.*?)</thead>', text, re.S):
            assert heading.count('<th ') <= 11
        assert all('data-label="' in cell for cell in re.findall('<td[^>]*>', text))


def test_no_page_refers_to_a_network(folder):
    for page in (folder / 'out' / 'report.html', folder / 'out' / 'first' / 'report.html'):
        text = page.read_text(encoding='utf-8')
        assert all(source.startswith(('data:image/', '#')) for source in re.findall(r'(?:src|href)="([^"]*)"', text))
        assert not re.search(r'https?:|@import|url\(|fetch\(|XMLHttpRequest|WebSocket|import\(|<link|<iframe', text)


@pytest.mark.parametrize('page', ['report.html', 'first/report.html'])
def test_nothing_is_wider_than_its_page(folder, browser, page):
    check_page(browser, folder / 'out' / page)


def test_the_track_shows_what_the_cursor_points_at(browser, tmp_path):
    # given a line east, whose error, sigma and speed are known
    time = np.arange(0.0, 100.0, 0.5)
    values = {'error': time / 10, 'sigma': np.full(200, 1.5), 'speed': np.full(200, 7.0)}
    line = Layer('a <line>', '#0072b2', time, 7 * time, 0 * time, values)
    outage = Layer('outage', '#cc79a7', time[50:60], 7 * time[50:60], np.full(10, 300.0), {'error': np.full(10, 3.0)},
                   first=np.array([0, 5]), ends=np.array([[1.0, 2.0, 3.0, 4.0]]))
    page = tmp_path / 'page.html'
    page.write_text(html.page('A drive', [html.section('Track', track([line, outage], html.paragraph('still')))],
                              script=script()), encoding='utf-8')
    browser.open(page, 1000)
    assert browser.run('return getComputedStyle(document.querySelector(".still")).display') == 'none'
    assert browser.run('return [...document.querySelectorAll(".layers label")].map(l => l.textContent)') == [
        'a <line>', 'outage']
    # when the cursor is on the line in the middle of the map's width
    x, y, width, height = browser.run('''const r = document.querySelector("canvas.map").getBoundingClientRect();
        return [r.x, r.y, r.width, r.height];''')
    scale = 0.9 * min(width / (7 * 99.5), height / 300.0)
    middle = y + height / 2 + 150.0 * scale
    browser.command('Input.dispatchMouseEvent', type='mouseMoved', x=x + width / 2, y=middle)
    # then it reads what is there
    said = browser.run('return document.querySelector(".said").innerText')
    seconds = float(said.split(' s after')[0])
    assert seconds == pytest.approx(49.75, abs=0.5)
    assert f'error {seconds / 10:g} m, sigma 1.5 m, speed 7 m/s' in said
    # and zooming in makes the same distance on the screen a shorter one on the ground
    browser.command('Input.dispatchMouseEvent', type='mouseWheel', x=x + width / 2, y=middle, deltaX=0, deltaY=-1000)
    browser.command('Input.dispatchMouseEvent', type='mouseMoved', x=x + width / 2 + 200, y=middle)
    zoomed = float(browser.run('return document.querySelector(".said").innerText').split(' s after')[0])
    assert 0 < zoomed - seconds < 0.5 * 200 / (7 * scale)
    # on paper, the still picture
    browser.open(page, 688, 'print')
    assert browser.run('return getComputedStyle(document.querySelector(".still")).display') == 'block'
    assert browser.run('return getComputedStyle(document.querySelector(".live")).display') == 'none'


def test_a_base_map_is_fetched_only_for_who_asks_for_it(browser, tmp_path):
    # given a track of 200 m in a place, and tiles around that place on the disk, red the one in which it lies
    zoom, latitude, longitude = 18, np.radians(40.16), np.radians(-105.1)
    column, row = (2**zoom * part for part in (
        longitude / (2 * np.pi) + 0.5, 0.5 - np.arcsinh(np.tan(latitude)) / (2 * np.pi)))
    for i in range(-3, 4):
        for j in range(-3, 4):
            tile = tmp_path / f'{zoom}' / f'{int(column) + i}'
            tile.mkdir(parents=True, exist_ok=True)
            colour = [0.0, 0.0, 1.0] if i or j else [1.0, 0.0, 0.0]
            image.imsave(tile / f'{int(row) + j}.png', np.full((256, 256, 3), colour))
    time = np.arange(100.0)
    line = Layer('line', '#000000', time, 2 * time - 99.0, 0 * time, {})
    page = tmp_path / 'page.html'
    page.write_text(html.page('A drive', [html.section('Track', track(
        [line], html.paragraph('still'), np.array([latitude, longitude, 1500.0])))], script=script()), encoding='utf-8')
    browser.open(page, 1000)
    fetched = "return performance.getEntriesByType('resource').map(e => e.name)"
    assert browser.run(fetched) == []
    # when a person zooms out, asks for a map and says where its tiles are
    browser.run(f'''window.prompt = () => 'file://{tmp_path}/{{z}}/{{x}}/{{y}}.png';
        document.querySelector("button[data-zoom=out]").click();
        document.querySelector("button[data-zoom=map]").click();''')
    clock.sleep(1.0)
    # then these are drawn, and the red one is as large on the screen as it is on the ground, and where it is
    assert all(f'/{zoom}/' in name for name in browser.run(fetched))
    assert browser.run('return document.querySelector(".from").textContent') == ''
    x, y, width, height = browser.run('''const r = document.querySelector("canvas.map").getBoundingClientRect();
        return [r.x, r.y, r.width, r.height];''')
    shot = browser.command('Page.captureScreenshot', format='png')['data']
    pixels = image.imread(io.BytesIO(base64.b64decode(shot)))
    red = (pixels[..., 0] > 0.9) & (pixels[..., 2] < 0.6)
    scale = 0.9 * min(width / 198.0, height) / 1.6  # pixels per metre, after one step out
    size = 2 * np.pi * (6378137.0 + 1500.0) * np.cos(latitude) / 2**zoom * scale
    for axis, first, length, part in ((1, x, width, column % 1), (0, y, height, row % 1)):
        places, middle = np.flatnonzero(red.any(axis=1 - axis)), first + length / 2
        assert places[0] == pytest.approx(max(middle - part * size, first), abs=3)
        assert places[-1] == pytest.approx(min(middle + (1 - part) * size, first + length), abs=3)
    # and gone when it is not wanted any more
    browser.run('document.querySelector("button[data-zoom=map]").click();')
    shot = browser.command('Page.captureScreenshot', format='png')['data']
    pixels = image.imread(io.BytesIO(base64.b64decode(shot)))
    assert not ((pixels[..., 0] > 0.9) & (pixels[..., 2] < 0.6)).any()


def test_without_a_place_no_base_map_is_offered(browser, tmp_path):
    line = Layer('line', '#000000', np.arange(9.0), np.arange(9.0), np.zeros(9), {})
    page = tmp_path / 'page.html'
    page.write_text(html.page('A drive', [html.section('Track', track([line], html.paragraph('still')))],
                              script=script()), encoding='utf-8')
    browser.open(page, 1000)
    assert browser.run('return document.querySelector("button[data-zoom=map]").hidden')


@pytest.mark.parametrize('text, ending, line', [
    ('short enough', '', 'short enough'),
    # at the end of a clause
    ('the offset is known to 0.06 s: ' + 'more turns, '.replace(', ', ' ') * 4 + 'and more of what would tell', '',
     'the offset is known to 0.06 s: ' + 'more turns ' * 4 + 'and more of what ...'),
    ('the time offset between IMU and fixes is known to 0.06 s, as was said: ' + 'more turns ' * 9, ' (and 2 more)',
     'the time offset between IMU and fixes is known to 0.06 s, as was said ... (and 2 more)'),
    # never inside brackets
    ('the 95 % ellipse held the truth in 10 of 11 outages, which is what there was (59 to 100 % of all of them)', '',
     'the 95 % ellipse held the truth in 10 of 11 outages, which is what there was ...'),
])
def test_a_line_is_cut_where_a_person_would(text, ending, line):
    assert shorten(text, ending) == line and len(line) <= 100


def test_a_long_command_is_wrapped_so_that_a_shell_takes_it():
    # given a command that fits, and one of 170 characters with paths that have hyphens and spaces
    folder = 'folder-of-mine/' * 4
    command = f"python -m mems_ins_fusion compare {folder}my_car.yaml '{folder}my second  car.yaml'"
    assert typed('next: ' + command[:60]) == ['next: ' + command[:60]]
    # then no line is longer than a console shows, and a shell reads what was meant
    lines = typed('next: ' + command)
    assert len(lines) == 3 and max(map(len, lines)) <= WIDTH
    assert shlex.split('\n'.join(lines).replace('\\\n', '')) == shlex.split('next: ' + command)


def test_a_notice_of_several_runs_is_said_once():
    def run(*texts):
        return SimpleNamespace(run=SimpleNamespace(notices=[SimpleNamespace(text=text, level='warning')
                                                            for text in texts]))
    comparison = SimpleNamespace(runs=[run('/fix: 8 of 70 refused', '/imu: dead'), run('/fix: 26 of 70.5 refused'),
                                       run('/fix: 8 of 35 refused')])
    assert _notices(comparison) == ['/fix: 8 of 70 refused (and alike in 2 of the other 2 runs)', '/imu: dead']


def test_text_of_a_track_cannot_become_markup():
    hostile = '</script><script>alert(1)</script>'
    line = Layer(hostile, '#000000', np.arange(3.0), np.arange(3.0), np.arange(3.0), {})
    assert '<script>alert' not in track([line], html.paragraph('still'))


def test_the_best_model_of_each_replay_speaks_for_it():
    # given two replays with two models, of which each has another one for its best
    rng = np.random.default_rng(3)
    stamp = np.arange(2000) * 10**9

    def replay(name, best, other, of_best, of_other):
        return Result(name, ['drive'], [best, other], {('drive', best, 1.0): ErrorSeries(stamp, of_best),
                                                       ('drive', other, 1.0): ErrorSeries(stamp, of_other)}, {})
    error = np.abs(rng.standard_normal(2000)) + 1.0
    first = replay('a', 'random_walk', 'gauss_markov', error, 3 * error)
    second = replay('b', 'gauss_markov', 'random_walk', error, 2 * error)
    # then what decides is the best against the best, and the others stand in the table only
    rows = rows_of(first, second)
    assert [row.models for row in rows] == [('random_walk', 'gauss_markov'), ('random_walk', 'random_walk'),
                                            ('gauss_markov', 'gauss_markov')]
    verdict = comparison_verdict(first, second, rows)
    assert [change.before for change in verdict.changes] == [rms(error)] and verdict.answer == SAME


def test_the_model_that_speaks_is_that_of_the_params_file_of_the_replay(folder):
    result = folder / 'out' / 'first'
    assert f"sensor_error_model: {read(result)['sensor_error_model']}" in (result / 'parameters.yaml').read_text()
    assert read_result(result, 'first').models[0] == read(result)['sensor_error_model']


def test_the_model_that_speaks_is_the_best_whichever_is_configured_or_comes_first(folder, tmp_path, monkeypatch):
    # given a replay of two models of which the second, that is not configured, is the best
    values = table.check({'models': ['gauss_markov', 'random_walk'], 'update_intervals': [2.0], 'outage_durations': []})
    comparison = replay(read_recording(folder / 'drive', '/imu/data', '/gps/fix'), values)
    monkeypatch.setattr(replay_report, 'best_model', lambda comparison, configured: 'random_walk')
    content = replay_report.report({'drive': comparison}, values, {'drive': []}, {'drive': []}, [], {}, {})
    # then it speaks in its report, and in a comparison
    assert content['sensor_error_model'] == 'random_walk'
    shutil.copytree(folder / 'out' / 'first', tmp_path / 'first')
    changed = read(tmp_path / 'first') | {'sensor_error_model': 'random_walk'}
    (tmp_path / 'first' / 'report.json').write_text(json.dumps(changed))
    assert read_result(tmp_path / 'first', 'first').models == ['random_walk', 'gauss_markov']


@pytest.mark.parametrize('content', [
    {}, {'recordings': None}, {'recordings': [{}], 'parameters': {}}, {'recordings': [], 'parameters': 3},
    {'recordings': [{'name': 'a', 'truth': 'fixes'}], 'parameters': {'gnss.time_offset': 'late'}}])
def test_a_report_that_lacks_something_is_told_in_one_line(tmp_path, content):
    (tmp_path / 'report.json').write_text(json.dumps({'tool': 'replay_node', **content}))
    with pytest.raises(CompareError, match='replay the recording again with this version') as told:
        read_result(tmp_path, 'first')
    assert str(told.value).count('\n') == 0


def test_a_heading_is_not_drawn_from_north_to_north():
    yaw = np.radians([350.0, 355.0, 5.0, 10.0, 355.0])
    assert _heading(yaw) == pytest.approx([350.0, 355.0, np.nan, 10.0, np.nan], nan_ok=True)


def test_a_change_is_of_the_second_against_the_first():
    [row] = rows_of(result('a', np.full(100, 2.0)), result('b', np.full(100, 1.0)))
    assert row.change.sign() == -1 and row.change.interval() == pytest.approx((-1.0, -1.0))
