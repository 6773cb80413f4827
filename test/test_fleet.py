"""fleet: many recordings of many vehicles, interrupted, killed, in shards and on clusters, with the same tables."""
from __future__ import annotations

import csv
import json
import shutil
import signal
import subprocess
import time

import pytest
from fleet_support import command, environment, files, run, write_year

from mems_ins_fusion.__main__ import main as tool
from mems_ins_fusion.fleet import tables
from mems_ins_fusion.parameters import params_file
from mems_ins_fusion.parameters.table import check

TASK = ('--task', 'replay', '--params-file', 'params.yaml', '--no-pages', '--workers', '2')


@pytest.fixture(scope='module')
def year(tmp_path_factory):
    folder = tmp_path_factory.mktemp('year')
    write_year(folder)
    return folder


def results(output):
    return list((output / 'results').glob('[!.]*/result.json'))


def started(year, output, enough):
    """A run on all recordings, in which `enough` results are there by now."""
    process = subprocess.Popen(command('logs', *TASK, '--output', output), cwd=year, env=environment(),
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 300
    while len(results(output)) < enough:
        assert process.poll() is None and time.monotonic() < until, process.communicate()
        time.sleep(0.05)
    return process


@pytest.fixture(scope='module')
def whole(year):
    """All recordings: killed in the middle, interrupted in the middle, and continued; (output, of the interrupted run:
    status, what it said, its table of recordings; of the last one what it said)."""
    output = year / 'whole'
    killed = started(year, output, 5)
    killed.kill()
    killed.communicate()
    stopped = started(year, output, len(results(output)) + 5)
    stopped.send_signal(signal.SIGINT)
    said = stopped.communicate(timeout=60)
    between = tables.read(output, 'recordings')
    last = run(year, 'logs', *TASK, '--output', output)
    assert last.returncode == 0, last.stderr
    return output, (stopped.returncode, *said, between), last


def test_an_interrupted_run_says_so_and_has_what_was_finished_in_its_tables(whole):
    status, out, err, rows = whole[1]
    assert status == 130 and 'interrupted' in out and 'Traceback' not in err
    done = {row['recording'] for row in rows if row['status'] in ('done', 'failed')}
    left = {row['recording'] for row in rows if row['status'] == 'open'}
    assert len(done) >= 10 and left


def test_each_recording_is_one_row_with_its_vehicle_and_what_became_of_it(whole):
    rows = {row['recording']: row for row in tables.read(whole[0], 'recordings')}
    assert len(rows) == 43
    assert {row['vehicle'] for row in rows.values()} == {f'car_{i}' for i in range(8)} | {'moved'}
    wrong = {'logs/car_1/empty.mcap': 'is empty', 'logs/car_1/letter.mcap': 'not an MCAP file'}
    for path, why in wrong.items():
        assert rows[path]['status'] == 'failed' and why in rows[path]['reason'] and rows[path]['error_id']
    assert len({rows[path]['error_id'] for path in wrong}) == 2
    copy = rows['logs/moved/drive_1'] if 'logs/moved/drive_1' in rows else rows['logs/car_0/moved/drive_1']
    assert (copy['status'], copy['same_as']) == ('duplicate', 'logs/car_0/drive_1')
    assert copy['recording_id'] == rows['logs/car_0/drive_1']['recording_id']
    others = [row for path, row in rows.items() if path not in wrong and row is not copy]
    assert len(others) == 40 and {row['status'] for row in others} == {'done'}
    assert all(row['duration_s'] == pytest.approx(75.0, abs=0.1) for row in others
               if row['recording'] != 'logs/car_1/drive_3')


def test_what_is_left_of_a_truncated_recording_is_used_and_told(whole):
    row = next(r for r in tables.read(whole[0], 'recordings') if r['recording'] == 'logs/car_1/drive_3')
    told = [f['message'] for f in tables.read(whole[0], 'findings')
            if f['recording_id'] == row['recording_id'] and f['source'] == 'reader']
    assert row['duration_s'] < 70 and len(told) == 1 and 'readable' in told[0]


def test_results_are_in_tidy_tables(whole):
    done = {row['recording_id'] for row in tables.read(whole[0], 'recordings') if row['status'] == 'done'}
    results, outages = (tables.read(whole[0], name) for name in ('results', 'outages'))
    assert {row['recording_id'] for row in results} == done == {row['recording_id'] for row in outages}
    assert len(results) == len(outages) == 40  # one model, one interval, one duration
    assert all(0.1 < row['horizontal_rmse_m'] < 10 for row in results)
    assert {(row['duration_s'], row['model']) for row in outages} == {(10.0, 'gauss_markov')}
    seen = {(row['effect'], row['parameter']) for row in tables.read(whole[0], 'effects')}
    assert {('mounting_rotation', 'roll'), ('receiver', 'scatter')} <= seen


def test_nothing_changed_in_vehicles_that_did_not_change(whole):
    assert not [row for row in tables.read(whole[0], 'findings') if row['source'] == 'watchman']


def test_the_history_of_a_vehicle_is_in_the_order_of_time(whole):
    with open(whole[0] / 'history/car_2.csv', newline='') as file:
        stamps = [int(row['stamp_ns']) for row in csv.DictReader(file)]
    assert stamps == sorted(stamps) and len(set(stamps)) == 5


@pytest.fixture(scope='module')
def some(year):
    """Two vehicles, without any interruption, by Dask where that is installed."""
    process = run(year, 'logs/car_[01]/*', *TASK, '--output', 'some', dask=True)
    assert process.returncode == 0, process.stderr
    return year / 'some', process


def test_killed_continued_and_by_whatever_engine_the_tables_are_the_same_bit_for_bit(whole, some):
    for name in ('results', 'outages', 'effects', 'findings'):
        lines = [(output / f'tables/{name}.csv').read_text().splitlines() for output in (whole[0], some[0])]
        mine = [line for line in lines[0] if line.startswith(('vehicle,', 'car_0,', 'car_1,'))]
        assert mine == lines[1] and len(mine) > 3


def test_what_is_done_is_not_done_again(year, some):
    before = {path: path.stat().st_mtime_ns for path in results(some[0])}
    tables_before = files(some[0] / 'tables')
    process = run(year, 'logs/car_[01]/*', *TASK, '--output', 'some')
    assert process.returncode == 0, process.stderr
    assert {path: path.stat().st_mtime_ns for path in results(some[0])} == before
    assert files(some[0] / 'tables') == tables_before


def test_a_moved_recording_is_not_done_twice(year, some):
    (year / 'elsewhere').mkdir()
    shutil.copytree(year / 'logs/car_0/drive_2', year / 'elsewhere/car_0/renamed')
    count = len(results(some[0]))
    process = run(year, 'elsewhere', *TASK, '--output', 'some')
    assert process.returncode == 0, process.stderr
    [row] = tables.read(some[0], 'recordings')
    assert row['status'] == 'done' and row['recording'] == 'elsewhere/car_0/renamed' and len(results(some[0])) == count
    run(year, 'logs/car_[01]/*', *TASK, '--output', 'some')


def test_shards_merged_are_one_run(year, some):
    for shard in ('2/2', '1/2'):
        process = run(year, 'logs/car_[01]/*', *TASK, '--output', 'shards', '--shard', shard)
        assert process.returncode == 0 and 'without --shard' in process.stdout, process.stderr
        assert not (year / 'shards/tables').exists()
    done = {path: path.stat().st_mtime_ns for path in results(year / 'shards')}
    process = run(year, 'logs/car_[01]/*', *TASK, '--output', 'shards')
    assert process.returncode == 0, process.stderr
    assert {path: path.stat().st_mtime_ns for path in results(year / 'shards')} == done
    assert files(year / 'shards/tables') == files(some[0] / 'tables')
    assert files(year / 'shards/history') == files(some[0] / 'history')


def test_recordings_behind_a_url_are_the_same_ones(year, some):
    pytest.importorskip('fsspec')
    process = run(year, f'file://{year}/logs/car_0/*', *TASK, '--output', 'url', '--vehicle-from', 'logs/{vehicle}/*')
    assert process.returncode == 0, process.stderr
    rows = tables.read(year / 'url', 'recordings')
    assert {row['vehicle'] for row in rows} == {'car_0'} and all(r['recording'].startswith('file://') for r in rows)
    assert [row['status'] for row in rows].count('done') == 5
    lines = [line for line in (some[0] / 'tables/results.csv').read_text().splitlines() if line.startswith('car_0,')]
    assert lines == (year / 'url/tables/results.csv').read_text().splitlines()[1:]


def test_configure_takes_the_recordings_of_a_vehicle_together_that_can_be_used(year):
    """Two good ones and one that is empty."""
    process = run(year, 'logs/car_1/*[0-1y]*', '--task', 'configure', '--output', 'configured', '--no-pages',
                  '--workers', '1', '--vehicle-from', 'logs/{vehicle}/*')
    assert process.returncode == 0, process.stderr
    rows = tables.read(year / 'configured', 'recordings')
    assert sorted((row['recording'].rpartition('/')[2], row['status']) for row in rows) == [
        ('drive_0', 'done'), ('drive_1', 'done'), ('empty.mcap', 'failed')]
    [written] = (year / 'configured/results').glob('*/params.yaml')
    values = check(params_file.load_yaml(written))
    assert 'drive_0' in written.read_text() and 'drive_1' in written.read_text()
    together = {row['parameter']: row['value'] for row in tables.read(year / 'configured', 'effects')
                if row['source'] == 'params_file' and row['effect'] == 'imu'}
    assert together['mounting_rpy[2]'] == values['imu.mounting_rpy'][2]
    alone = [row for row in tables.read(year / 'configured', 'effects') if row['source'] == 'configure']
    assert {row['recording_id'] for row in alone} == {row['recording_id'] for row in rows if row['status'] == 'done'}


@pytest.mark.parametrize(['words', 'told'], [
    (('nowhere', '--task', 'replay', '--output', 'x'), 'nowhere does not exist'),
    (('logs/*.txt', '--task', 'replay', '--output', 'x'), 'no recording there'),
    (('logs', '--task', 'replay', '--output', 'logs'), 'holds other files than results of fleet'),
    (('logs', '--task', 'configure', '--output', 'some'), 'holds a fleet with --task replay'),
    (('logs', '--task', 'replay', '--output', 'x', '--shard', '3/2'), '--shard must be i/n'),
    (('logs', '--task', 'replay', '--output', 'x', '--vehicle-from', 'logs/*'), '--vehicle-from must hold {vehicle}'),
    (('logs', '--task', 'replay', '--output', 'x', '--vehicle-from', 'a/{vehicle}'), '--vehicle-from does not fit'),
    (('logs', '--task', 'replay', '--output', 'x', '--params-file', 'none.yaml'), 'params file none.yaml'),
    (('logs', '--task', 'replay', '--output', 'x', '--scheduler', 'here'), '--scheduler must be local or an address'),
    (('logs', '--task', 'replay', '--output', 'x', '--memory', '0'), '--memory must be'),
    (('nothing://x/*', '--task', 'replay', '--output', 'x'), 'nothing://x/*: Protocol not known')])
def test_wrong_use_is_one_line(year, some, words, told, capsys, monkeypatch):
    monkeypatch.chdir(year)
    assert tool(['fleet', *words]) == 2
    said = capsys.readouterr().err
    assert said.startswith('fleet: ') and told in said and len(said.splitlines()) == 1


# compare

def changed(output, target, factor, fail=None):
    """A copy of the tables of a fleet, as if errors were `factor` times as large; fail: a recording that fails now."""
    shutil.copytree(output / 'tables', target / 'tables')
    for name, column in (('results', 'horizontal_rmse_m'), ('outages', 'max_error_rms_m')):
        rows = tables.read(output, name)
        rewrite(target, name, [row if row[column] is None else row | {column: factor * row[column]} for row in rows])
    if fail:
        rewrite(target, 'recordings', [row | {'status': 'failed', 'reason': 'no'} if row['recording'] == fail else row
                                       for row in tables.read(output, 'recordings')])
    return target


def rewrite(target, name, rows):
    with open(target / f'tables/{name}.csv', 'w', newline='') as file:
        writer = csv.writer(file)
        writer.writerow(tables.TABLES[name])
        writer.writerows(row.values() for row in rows)


@pytest.mark.parametrize(['factor', 'fail', 'status', 'answer'], [
    (1.0, None, 0, 'same'), (1.3, None, 1, 'worse'), (0.7, None, 0, 'better'),
    (1.0, 'logs/car_3/drive_3', 1, 'same')])
def test_compare_is_a_gate(whole, tmp_path, factor, fail, status, answer, capsys):
    other = changed(whole[0], tmp_path / 'other', factor, fail)
    assert tool(['fleet', 'compare', str(whole[0]), str(other), '--output', str(tmp_path / 'gate.json')]) == status
    content = json.loads((tmp_path / 'gate.json').read_text())
    assert content['verdict']['answer'] == answer and content['unit'] == 'vehicles'
    assert content['worse_for_certain'] == bool(status) and content['verdict']['because']
    assert ('no result any more' in capsys.readouterr().out) == bool(fail)


def test_noise_is_not_worse_for_certain(whole, tmp_path):
    """Errors that change at random, by as much as a release that is no better and no worse changes them."""
    shutil.copytree(whole[0] / 'tables', tmp_path / 'tables')
    rows = tables.read(whole[0], 'results')
    rewrite(tmp_path, 'results', [row | {'horizontal_rmse_m': row['horizontal_rmse_m'] * (1.3 if i % 2 else 0.77)}
                                  for i, row in enumerate(rows)])
    assert tool(['fleet', 'compare', str(whole[0]), str(tmp_path)]) == 0


def test_compare_refuses_what_is_no_fleet(whole, tmp_path, capsys):
    assert tool(['fleet', 'compare', str(whole[0]), str(tmp_path)]) == 2
    assert 'is not the output of fleet' in capsys.readouterr().err
