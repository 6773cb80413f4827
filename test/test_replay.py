"""replay_node from the command line: results, wrong input, and what an interruption leaves behind."""
from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from conftest import shared_data
from filter_support import PAPER
from terminal_support import Terminal

from mems_ins_fusion.__main__ import main as tool
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.intake import first_datum
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.parameters.params_file import yaml_value
from mems_ins_fusion.recordings import messages
from mems_ins_fusion.recordings.bags import Bag
from mems_ins_fusion.recordings.errors import RecordingWarning
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.reports.html import number
from mems_ins_fusion.results import ResultError

REPOSITORY = Path(__file__).resolve().parents[1]
RUN_KEYS = {'model', 'mechanization', 'update_interval_s', 'horizontal_rmse_m', 'horizontal_p95_m', 'horizontal_max_m',
            'nis_mean', 'imu_samples', 'filter_seconds'}
OUTAGE_KEYS = {'model', 'duration_s', 'count', 'max_error_rms_m', 'max_error_median_m', 'max_error_p95_m',
               'percent_of_distance'}
#: parameters of a short replay
SMALL = ('models:=[random_walk]', 'update_intervals:=[6.0]', 'outage_durations:=[10.0]')


def command(*parameters: str, **given) -> list[str]:
    given = [f'{name}:={value}' for name, value in given.items()]
    return [sys.executable, '-m', 'mems_ins_fusion', 'replay_node', '--ros-args',
            *(word for p in (*parameters, *given) for word in ('-p', p))]


def replay(*parameters: str, **given) -> subprocess.CompletedProcess:
    """The command in this process, which spares the seconds that each new one takes to start."""
    words, out, err = command(*parameters, **given)[3:], io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = tool(words)
    return subprocess.CompletedProcess(words, status, out.getvalue(), err.getvalue())


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """150 s at 50 Hz, with the truth."""
    path = tmp_path_factory.mktemp('replay') / 'drive'
    assert tool(['simulate', '--output', str(path), '--duration', '150', '--rate', '50', '--seed', '4']) == 0
    return path


@pytest.fixture(scope='module')
def result(bag, tmp_path_factory):
    """Everything at its default but the truth, and a bag of the odometry."""
    folder = tmp_path_factory.mktemp('replay') / 'result'
    words = command(bag=bag, output_dir=folder, reference_topic='/reference/odometry', write_bag='true', verbose='true')
    process = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, timeout=300)
    assert process.returncode == 0, process.stderr
    return folder, process


def test_report_has_every_run_and_outage(result):
    report = json.loads((result[0] / 'report.json').read_text())
    runs = {(r['model'], r['update_interval_s']) for r in report['runs']}
    assert runs == {(m, i) for m in ('random_walk', 'gauss_markov', 'autoregressive') for i in (1.0, 3.0, 6.0)}
    assert all(RUN_KEYS <= set(r) for r in report['runs'])
    assert all(OUTAGE_KEYS <= set(o) for o in report['outages'])
    assert [o['duration_s'] for o in report['outages']] == 3 * [10.0, 30.0, 60.0]
    assert all(o['count'] > 0 for o in report['outages'])
    # and the numbers are those of a working filter with fixes of 1.5 m
    assert all(0.2 < r['horizontal_rmse_m'] < 6 and r['heading_rmse_deg'] < 10 for r in report['runs'])
    assert all(r['imu_samples'] > 5000 and r['filter_seconds'] > 0 for r in report['runs'])


def test_terminal_shows_the_errors_and_where_the_results_are(result):
    folder, process = result
    report = json.loads((folder / 'report.json').read_text())
    for run in report['runs']:
        assert any(line.startswith(run['model']) and f"{number(run['horizontal_rmse_m'], 3)} m" in line
                   for line in process.stdout.splitlines())
    for named in ('report: ', 'track: '):
        path, = (line.removeprefix(named) for line in process.stdout.splitlines() if line.startswith(named))
        assert Path(path).is_file()
    assert all(sentence in process.stdout for sentence in report['sentences']['drive'])
    assert '%|' not in process.stderr  # a bar is for a terminal; a slow machine says now and then how far it is
    assert 'replay_node: reference topic' in process.stderr  # its datum is not given: that is said
    assert 'RecordingWarning' not in process.stderr


def test_what_is_certainly_wrong_ends_with_status_2_and_a_page_that_says_what(bag, tmp_path):
    # given a gyroscope with an axis that is dead, which a filter starts with
    made = read_recording(bag, '/imu/data', '/gps/fix')
    rate = made.imu.angular_rate * [0.0, 1.0, 1.0]
    write_recording(replace(made, imu=replace(made.imu, angular_rate=rate)), tmp_path / 'drive')
    process = replay('models:=[gauss_markov]', 'update_intervals:=[1.0]', 'outage_durations:=[30.0]',
                     bag=tmp_path / 'drive', output_dir=tmp_path / 'out')
    # then all results are there, and neither answer nor status says that they can be used
    assert process.returncode == 2 and process.stdout.startswith('Not usable: /imu/data: gyroscope x: the same value')
    assert json.loads((tmp_path / 'out' / 'report.json').read_text())['verdict']['answer'] == 'not_usable'
    assert (tmp_path / 'out' / 'report.html').exists()


def test_page_holds_its_figures(result):
    page = (result[0] / 'report.html').read_text()
    report = json.loads((result[0] / 'report.json').read_text())
    assert page.count('<img src="data:image/png;base64,') == 5
    assert all(sentence.split(' (')[0] in page for sentence in report['sentences']['drive'])
    # the answer before the evidence
    answer = report['answer']['drive']
    assert page.index(answer['headline']) < page.index('<canvas') < page.index('<details>')


def test_trajectories_are_those_of_the_report(result):
    """evo, without alignment, measures the error that the report states."""
    core, sync, files = (pytest.importorskip(f'evo.{name}') for name in ('core.metrics', 'core.sync',
                                                                         'tools.file_interface'))
    report = json.loads((result[0] / 'report.json').read_text())
    for run in report['runs']:
        file = result[0] / f"{run['model']}_{run['update_interval_s']:g}s.tum"
        pair = sync.associate_trajectories(*(files.read_tum_trajectory_file(str(f))
                                             for f in (result[0] / 'truth.tum', file)), max_diff=0.001)
        for trajectory in pair:
            trajectory.positions_xyz[:, 2] = 0.0
        ape = core.APE(core.PoseRelation.translation_part)
        ape.process_data(pair)
        assert ape.get_statistic(core.StatisticsType.rmse) == pytest.approx(run['horizontal_rmse_m'], rel=5e-4)


def test_the_best_track_as_gpx_kml_and_csv(result):
    folder, _ = result
    rows = np.genfromtxt(folder / 'track.csv', delimiter=',', names=True)
    judged = np.loadtxt(folder / 'gauss_markov_1s.tum')
    truth = np.loadtxt(folder / 'truth.tum')
    # the table is the track of base_link, which this reference is: where both have a row, it is that far from the truth
    reference = json.loads((folder / 'tracks.geojson').read_text())['features'][0]['geometry']['coordinates']
    metres = 111_200.0
    east = (rows['longitude_deg'] - reference[0][0]) * metres * np.cos(np.radians(reference[0][1]))
    north = (rows['latitude_deg'] - reference[0][1]) * metres
    at = np.searchsorted(rows['time_s'], judged[:, 0] - 1e-4)
    assert np.abs(east[at] - judged[:, 1]).max() < 0.01 * np.abs(truth[:, 1]).max()
    assert np.abs(north[at] - judged[:, 2]).max() < 0.01 * np.abs(truth[:, 2]).max()
    assert (rows['sigma_north_m'] > 0).all() and (rows['sigma_yaw_deg'] > 0).all()
    # and the maps hold the same positions
    points = ElementTree.parse(folder / 'track.gpx').findall('.//{*}trkpt')
    line = ElementTree.parse(folder / 'track.kml').findtext('.//{*}coordinates').split()
    assert len(points) == len(line) > 100
    second = np.searchsorted(rows['time_s'], rows['time_s'][0] + 60)
    times = [datetime.fromisoformat(p.findtext('{*}time').replace('Z', '+00:00')).timestamp() for p in points]
    nearest = points[np.argmin(np.abs(np.array(times) - rows['time_s'][second]))]
    assert float(nearest.get('lat')) == pytest.approx(rows['latitude_deg'][second], abs=2e-4)
    assert float(line[points.index(nearest)].split(',')[0]) == pytest.approx(float(nearest.get('lon')), abs=1e-7)


def test_the_next_command_works_as_it_stands(result):
    """The parameters that the answer's command names are those of the replay."""
    report = json.loads((result[0] / 'report.json').read_text())
    [command] = [s['command'] for s in report['answer']['drive']['steps'] if '--params-file' in s['command']]
    path = command.split('--params-file ')[1].split()[0]
    assert path == str(result[0] / 'parameters.yaml')
    assert table.check(params_file.load_yaml(path))['sensor_error_model'] in ('gauss_markov', 'random_walk',
                                                                             'autoregressive')


def test_map_and_odometry_bag(result, bag):
    lines = json.loads((result[0] / 'tracks.geojson').read_text())['features']
    assert [line['properties']['name'] for line in lines][:2] == ['reference', 'random_walk_1s']
    fix = read_recording(bag, '/imu/data', '/gps/fix').gnss
    first = lines[0]['geometry']['coordinates'][0]
    assert first == pytest.approx([np.degrees(fix.longitude[0]), np.degrees(fix.latitude[0])], abs=1e-4)
    # when the odometry is read back, then its poses are those of the TUM file
    tum = np.loadtxt(result[0] / 'gauss_markov_1s.tum')
    assert len(tum) > 1000 and np.abs(np.diff(tum[1:, 0]) - 0.1).max() < 1e-6
    with Bag(result[0] / 'odometry') as written:
        assert {f'/odometry/{m}' for m in ('random_walk', 'gauss_markov', 'autoregressive')} <= set(written.topics)
        read = [messages.decode(raw, written.topics[topic])[0]
                for topic, _, raw, _ in written.read(['/odometry/gauss_markov']) if raw]
    read = np.concatenate(read)
    at = np.searchsorted(messages.stamps(read), np.round(tum[:, 0] * 1e9).astype(np.int64) - 1000)
    assert np.abs(read['pose.pose.position'][at] - tum[:, 1:4]).max() < 1e-3
    assert np.abs(read['pose.pose.orientation'][at] * np.sign(read['pose.pose.orientation'][at, 3:])
                  - tum[:, 4:] * np.sign(tum[:, 7:])).max() < 1e-5


def test_smoothed_trajectory_and_outages(bag, tmp_path):
    folder = tmp_path / 'smoothed'
    process = replay("models:=['gauss_markov']", 'update_intervals:=[1.0]', bag=bag, output_dir=folder,
                     smoothing='true', reference_topic='/reference/odometry', verbose='true')
    assert process.returncode == 0, process.stderr
    report = json.loads((folder / 'report.json').read_text())
    run, smoothed = report['runs'][0], report['smoothed'][0]
    assert smoothed['model'] == 'gauss_markov' and smoothed['horizontal_rmse_m'] < 0.8 * run['horizontal_rmse_m']
    for row in report['outages']:
        assert row['smoothed']['count'] == row['count'] > 0
        assert row['smoothed']['max_error_rms_m'] < row['max_error_rms_m']
    # both tracks, each with its sigmas
    filtered, after = (np.genfromtxt(folder / f'{name}.csv', delimiter=',', names=True)
                       for name in ('track', 'smoothed'))
    assert np.median(after['sigma_north_m']) < 0.8 * np.median(filtered['sigma_north_m'])
    assert {'smoothed.gpx', 'smoothed.kml', 'gauss_markov_1s_smoothed.tum'} <= {f.name for f in folder.iterdir()}
    assert 'Gauss-Markov, smoothed' in (folder / 'report.html').read_text()
    assert any(line.split()[1:2] == ['smoothed'] for line in process.stdout.splitlines())


def test_dead_reckoning_counts_errors_without_fixes(bag, tmp_path):
    folder = tmp_path / 'dead'
    process = replay("models:=['gauss_markov']", 'update_intervals:=[1.0]', 'outage_durations:=[]', bag=bag,
                     output_dir=folder, fixes_until='90.0', reference_topic='/reference/odometry', verbose='true')
    assert process.returncode == 0, process.stderr
    run, = json.loads((folder / 'report.json').read_text())['runs']
    assert run['fixes_used'] <= 90 and run['relative_translation_percent'] > 0
    assert 50 * 10 < run['errors_counted'] <= 60 * 50 + 1  # the last minute
    assert 'without fixes after 90 s' in process.stdout


def test_several_recordings_stand_side_by_side(bag, tmp_path):
    (tmp_path / 'other').mkdir()
    (tmp_path / 'other' / 'drive').symlink_to(bag)
    bags = f"bag:=['{bag}', '{tmp_path / 'other' / 'drive'}']"
    process = replay(bags, 'models:=[gauss_markov]', 'update_intervals:=[3.0]', 'outage_durations:=[10.0]',
                     output_dir=tmp_path / 'r', reference_topic='/reference/fix')
    assert process.returncode == 0, process.stderr
    report = json.loads((tmp_path / 'r' / 'report.json').read_text())
    one, two = report['runs']
    assert (one['recording'], two['recording']) == ('drive', 'drive_2')
    assert one['horizontal_rmse_m'] == two['horizontal_rmse_m']
    assert {'drive_gauss_markov_3s.tum', 'drive_2_gauss_markov_3s.tum'} <= {f.name for f in (tmp_path / 'r').iterdir()}


def test_a_reference_file_is_as_good_as_a_topic(bag, result, tmp_path):
    # given the truth as a TUM file at the datum of the first result
    with pytest.warns(RecordingWarning, match='first fix'):
        recording = read_recording(bag, '/imu/data', '/gps/fix', '/reference/odometry')
    place = first_datum(FilterConfig.from_parameters(table.defaults()), recording.imu, recording.gnss)
    datum = ', '.join(repr(float(v)) for v in (*np.degrees(place[:2]), place[2]))
    process = replay('models:=[gauss_markov]', 'update_intervals:=[3.0]', 'outage_durations:=[10.0]', bag=bag,
                     output_dir=tmp_path / 'r', reference_file=result[0] / 'truth.tum', datum=f'[{datum}]')
    assert process.returncode == 0, process.stderr
    run, = json.loads((tmp_path / 'r' / 'report.json').read_text())['runs']
    # then the error is that of the same run against the topic (which began later, with other runs' starts)
    other, = (r for r in json.loads((result[0] / 'report.json').read_text())['runs']
              if r['model'] == 'gauss_markov' and r['update_interval_s'] == 3.0)
    assert run['horizontal_rmse_m'] == pytest.approx(other['horizontal_rmse_m'], rel=0.05)


@pytest.mark.parametrize('given, message', [
    ({'bag': 'nowhere'}, 'nowhere'),
    ({'imu_topic': '/imu'}, "no topic '/imu' in"),
    ({'reference_topic': '/truth'}, "no topic '/truth'"),
    ({'reference_topic': '/imu/data'}, "carries sensor_msgs/Imu"),
    ({'models': '[kalman]'}, 'random_walk, gauss_markov, autoregressive'),
    ({'update_intervals': '[-1.0]'}, 'update_intervals'),
    ({'update_interval': '1.0'}, "did you mean 'update_intervals'?"),
    ({'start': '100.0', 'stop': '50.0'}, "parameter 'stop' must be after start 100 s"),
    ({'start': '1000.0'}, 'no IMU sample between start 1000 s'),
    ({'stop': '20.0'}, 'the filter did not start: waiting for the vehicle to move'),
    ({'imu.acceleration_unit': 'g', 'imu.rate_unit': 'deg/s'},
     'in m/s^2 instead of g (see imu.acceleration_unit); /imu/data: the gyroscopes turn through'),
    ({'reference_file': 'nowhere.csv'}, 'nowhere.csv'),
    ({'bag': '[]'}, "parameter 'bag'")])
def test_wrong_input_gives_one_line_and_leaves_nothing(bag, tmp_path, given, message):
    process = replay(**{'bag': bag, 'output_dir': tmp_path / 'r', **given})
    assert process.returncode == 2
    assert 'Traceback' not in process.stderr
    last = process.stderr.strip().splitlines()[-1]
    assert message in last and last.startswith('replay_node: '), process.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_result_is_not_overwritten_unless_asked(bag, result, tmp_path):
    folder = tmp_path / 'r'
    assert replay(*SMALL, bag=bag, output_dir=folder).returncode == 0
    before = (folder / 'report.json').read_text()
    refused = replay(*SMALL, bag=bag, output_dir=folder)
    assert refused.returncode == 2
    assert refused.stderr.endswith(f'{folder} exists already; choose another output, or replace it with '
                                   '-p overwrite:=true\n')
    assert (folder / 'report.json').read_text() == before
    assert replay(*SMALL, bag=bag, output_dir=folder, overwrite='true', fix_noise='1.0').returncode == 0
    assert json.loads((folder / 'report.json').read_text())['parameters']['fix_noise'] == 1.0
    # and a folder of somebody else's is safe even then
    (tmp_path / 'mine').mkdir()
    (tmp_path / 'mine' / 'photo.jpg').touch()
    assert replay(*SMALL, bag=bag, output_dir=tmp_path / 'mine', overwrite='true').returncode == 2
    assert (tmp_path / 'mine' / 'photo.jpg').exists()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('stage', ['reading', 'filtering', 'figures'])
def test_an_interrupted_replay_leaves_nothing(bag, tmp_path, number, stage):
    environment = {**os.environ, 'PYTHONUNBUFFERED': '1'}
    some = SMALL if stage == 'figures' else ()  # no longer than needed to what comes after the filter
    with Terminal() as terminal:  # on which the progress is shown
        process = subprocess.Popen(command(*some, bag=bag, output_dir=tmp_path / 'r'), cwd=REPOSITORY, env=environment,
                                   stderr=terminal.end, stdout=subprocess.DEVNULL, start_new_session=True)
        os.close(terminal.end)
        text = b''
        deadline = time.monotonic() + 240
        while stage.encode() not in text:
            assert time.monotonic() < deadline and process.poll() is None, text.decode()
            text += terminal.read()
        process.send_signal(number)
        rest = b''.join(iter(terminal.read, b'')).decode()
        assert process.wait(60) == 130
    assert 'interrupted, nothing was written' in rest and 'Traceback' not in rest
    assert list(tmp_path.iterdir()) == []


def test_published_odometry_comes_with_the_clock(bag, tmp_path):
    import ros_support
    from nav_msgs.msg import Odometry
    from rosgraph_msgs.msg import Clock

    peer = ros_support.Peer()
    clocks, odometry = [], []
    subscriptions = [peer.node.create_subscription(Clock, '/clock', clocks.append, 10),
                     peer.node.create_subscription(Odometry, '/odometry/gauss_markov', odometry.append, 100)]
    try:
        arguments = [word for p in ('models:=[gauss_markov]', 'update_intervals:=[3.0]', 'outage_durations:=[10.0]',
                                    f'bag:={bag}', f'output_dir:={tmp_path / "r"}', 'publish:=true', 'rate:=10.0')
                     for word in ('-p', p)]
        with ros_support.NodeProcess('replay_node', *arguments) as node:
            node.wait_for('publishing /odometry/gauss_markov', timeout=240.0)
            peer.spin_until(lambda: len(odometry) > 50 and len(clocks) > 50)
            node.send(signal.SIGINT)
            assert node.wait() == 0
    finally:
        for subscription in subscriptions:
            peer.node.destroy_subscription(subscription)
        peer.close()
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in odometry]
    assert np.all(np.diff(stamps) > 0)
    # ten times as fast as recorded, and the poses are those of the trajectory
    tum = np.loadtxt(tmp_path / 'r' / 'gauss_markov_3s.tum')
    place = odometry[-1].pose.pose.position
    assert np.hypot(*(np.interp(stamps[-1], tum[:, 0], axis) - value
                      for axis, value in zip(tum[:, 1:3].T, (place.x, place.y)))) < 3.0
    assert odometry[-1].pose.covariance[0] > 0 and odometry[-1].header.frame_id == 'odom'


def test_incheon_end_to_end(tmp_path):
    """A real recording: MEMS IMU upside down, RTK at 5 Hz; the paper's filter."""
    recording = shared_data('incheon_square_ros2')
    paper = [f'{name}:={yaml_value(value)}' for name, value in PAPER.items()]
    process = replay('imu.mounting_rpy:=[3.141592653589793, 0.0, 0.0]', *paper, bag=recording / 'bag',
                     gnss_topic='/fix', output_dir=tmp_path / 'r')
    assert process.returncode == 0, process.stderr
    report = json.loads((tmp_path / 'r' / 'report.json').read_text())
    assert len(report['runs']) == 9 and report['recordings'][0]['truth'] == 'fixes'
    # fixes of 1.4 cm each second at 1.2 m/s: decimetres between them
    assert all(r['horizontal_rmse_m'] < 0.5 for r in report['runs'] if r['update_interval_s'] == 1.0)


def test_an_existing_result_is_refused_before_any_work(bag, tmp_path):
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.reports.replay import replay_recordings

    (tmp_path / 'r').mkdir()
    (tmp_path / 'r' / 'report.json').touch()
    seen = []
    with pytest.raises(ResultError):
        replay_recordings(table.check({'bag': [str(bag)], 'output_dir': str(tmp_path / 'r')}),
                          lambda part, what: seen.append(what))
    assert not seen
