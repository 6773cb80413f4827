"""fleet: many recordings of many vehicles, interrupted, killed, in shards and on clusters, with the same tables."""
from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import time
from functools import partial
from pathlib import Path

import pytest
from fleet_support import (
    LATE,
    REST_DENSITY,
    REST_SAMPLES,
    command,
    environment,
    files,
    run,
    run_here,
    write_at_rest,
    write_late,
    write_year,
)

from mems_ins_fusion.__main__ import main as tool
from mems_ins_fusion.fleet import engines, tables
from mems_ins_fusion.parameters import params_file
from mems_ins_fusion.parameters.table import check

SIZE = 5, 5  # vehicles, and drives of each, of the year
COUNT = SIZE[0] * SIZE[1]
TASK = ('--task', 'replay', '--params-file', 'params.yaml', '--no-pages', '--workers', '2')


@pytest.fixture(scope='module')
def year(tmp_path_factory):
    folder = tmp_path_factory.mktemp('year')
    write_year(folder, *SIZE)
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
    """All recordings: killed in the middle, interrupted in the middle, and continued; (output, the interrupted run, of
    the last one what it said)."""
    output = year / 'whole'
    killed = started(year, output, 5)
    killed.kill()
    killed.communicate()
    interrupted = Interrupted(started(year, output, len(results(output)) + 5), output)
    last = run(year, 'logs', *TASK, '--output', output)
    assert last.returncode == 0, last.stderr
    return output, interrupted, last


class Interrupted:
    """A run that was interrupted. rows: of its table of recordings. cpu: s of the process, without its workers, from
    the signal to its end, which do not depend on what else the machine does."""

    def __init__(self, process, output):
        before = cpu_of(process.pid)
        process.send_signal(signal.SIGINT)
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        self.cpu = cpu_of(process.pid) - before
        self.out, self.err = process.communicate()
        self.status, self.rows = process.returncode, tables.read(output, 'recordings')


def cpu_of(pid):
    """CPU seconds of a process so far, also of one that has ended and is not yet waited for."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def test_an_interrupted_run_says_so_and_has_what_was_finished_in_its_tables(whole):
    stopped = whole[1]
    assert stopped.status == 130 and 'interrupted' in stopped.out and 'Traceback' not in stopped.err
    done = {row['recording'] for row in stopped.rows if row['status'] in ('done', 'failed')}
    left = {row['recording'] for row in stopped.rows if row['status'] == 'open'}
    assert done and left


def test_an_interruption_takes_no_two_seconds(whole):
    assert whole[1].cpu + engines.PATIENCE < 2.0  # all that it waits for is the end of its workers


def test_each_recording_is_one_row_with_its_vehicle_and_what_became_of_it(whole):
    rows = {row['recording']: row for row in tables.read(whole[0], 'recordings')}
    assert len(rows) == COUNT + 3  # two that are none, and a copy
    assert {row['vehicle'] for row in rows.values()} == {f'car_{i}' for i in range(SIZE[0])} | {'moved'}
    wrong = {'logs/car_1/empty.mcap': 'is empty', 'logs/car_1/letter.mcap': 'not an MCAP file'}
    for path, why in wrong.items():
        assert rows[path]['status'] == 'failed' and why in rows[path]['reason'] and rows[path]['error_id']
    assert len({rows[path]['error_id'] for path in wrong}) == 2
    copy = rows['logs/moved/drive_1'] if 'logs/moved/drive_1' in rows else rows['logs/car_0/moved/drive_1']
    assert (copy['status'], copy['same_as']) == ('duplicate', 'logs/car_0/drive_1')
    assert copy['recording_id'] == rows['logs/car_0/drive_1']['recording_id']
    others = [row for path, row in rows.items() if path not in wrong and row is not copy]
    assert len(others) == COUNT and {row['status'] for row in others} == {'done'}
    assert all(row['duration_s'] == pytest.approx(60.0, abs=0.1) for row in others
               if row['recording'] != 'logs/car_1/drive_3')


def test_what_is_left_of_a_truncated_recording_is_used_and_told(whole):
    row = next(r for r in tables.read(whole[0], 'recordings') if r['recording'] == 'logs/car_1/drive_3')
    told = [f['message'] for f in tables.read(whole[0], 'findings')
            if f['recording_id'] == row['recording_id'] and f['source'] == 'reader']
    assert row['duration_s'] < 50 and len(told) == 1 and 'readable' in told[0]


def test_results_are_in_tidy_tables(whole):
    done = {row['recording_id'] for row in tables.read(whole[0], 'recordings') if row['status'] == 'done'}
    results, outages = (tables.read(whole[0], name) for name in ('results', 'outages'))
    assert {row['recording_id'] for row in results} == done == {row['recording_id'] for row in outages}
    assert len(results) == len(outages) == COUNT  # one model, one interval, one duration
    assert all(0.1 < row['horizontal_rmse_m'] < 10 for row in results)
    assert {(row['duration_s'], row['model']) for row in outages} == {(10.0, 'gauss_markov')}
    seen = {(row['effect'], row['parameter']) for row in tables.read(whole[0], 'effects')}
    assert {('mounting_rotation', 'roll'), ('receiver', 'scatter')} <= seen


def test_nothing_changed_in_vehicles_that_did_not_change(whole):
    assert not [row for row in tables.read(whole[0], 'findings') if row['source'] == 'watchman']


def test_the_history_of_a_vehicle_is_in_the_order_of_time(whole):
    with open(whole[0] / 'history/car_2.csv', newline='') as file:
        stamps = [int(row['stamp_ns']) for row in csv.DictReader(file)]
    assert stamps == sorted(stamps) and len(set(stamps)) == SIZE[1]


@pytest.fixture(scope='module')
def some(year):
    """One vehicle, without any interruption, by Dask where that is installed."""
    process = run(year, 'logs/car_1/*', *TASK, '--output', 'some', dask=True)
    assert process.returncode == 0, process.stderr
    return year / 'some', process


def test_killed_continued_and_by_whatever_engine_the_tables_are_the_same_bit_for_bit(whole, some):
    for name in ('results', 'outages', 'effects', 'findings'):
        lines = [(output / f'tables/{name}.csv').read_text().splitlines() for output in (whole[0], some[0])]
        mine = [line for line in lines[0] if line.startswith(('vehicle,', 'car_1,'))]
        assert mine == lines[1] and len(mine) > 3


def test_what_is_done_is_not_done_again(year, some):
    before = {path: path.stat().st_mtime_ns for path in results(some[0])}
    tables_before = files(some[0] / 'tables')
    assert run_here(year, 'logs/car_1/*', *TASK, '--output', 'some')[0] == 0
    assert {path: path.stat().st_mtime_ns for path in results(some[0])} == before
    assert files(some[0] / 'tables') == tables_before


@pytest.fixture
def copy(some, tmp_path):
    """An output in which `some` is done already."""
    shutil.copytree(some[0], tmp_path / 'copy')
    return tmp_path / 'copy'


def test_a_moved_recording_is_not_done_twice(year, copy, tmp_path):
    shutil.copytree(year / 'logs/car_1/drive_2', tmp_path / 'car_1/renamed')
    count = len(results(copy))
    assert run_here(year, tmp_path / 'car_1', *TASK, '--output', copy)[0] == 0
    [row] = tables.read(copy, 'recordings')
    assert row['status'] == 'done' and row['recording'].endswith('car_1/renamed') and len(results(copy)) == count


def test_shards_merged_are_one_run(year, copy, tmp_path):
    fleet = 'logs/car_1/*[0-2y]*', *TASK  # three drives and one that is empty
    for shard in ('2/2', '1/2'):
        status, out, _ = run_here(year, *fleet, '--output', tmp_path / 'shards', '--shard', shard)
        assert status == 0 and 'without --shard' in out
        assert not (tmp_path / 'shards/tables').exists()
    done = {path: path.stat().st_mtime_ns for path in results(tmp_path / 'shards')}
    assert run_here(year, *fleet, '--output', tmp_path / 'shards')[0] == 0
    assert {path: path.stat().st_mtime_ns for path in results(tmp_path / 'shards')} == done and len(done) == 4
    assert run_here(year, *fleet, '--output', copy)[0] == 0
    for folder in ('tables', 'history'):
        assert files(tmp_path / 'shards' / folder) == files(copy / folder)


def test_recordings_behind_a_url_are_the_same_ones(year, some, tmp_path):
    pytest.importorskip('fsspec')
    status, _, err = run_here(year, f'file://{year}/logs/car_1/drive_[01]', *TASK, '--output', tmp_path / 'url',
                              '--vehicle-from', 'logs/{vehicle}/*')
    assert status == 0, err
    rows = tables.read(tmp_path / 'url', 'recordings')
    assert [(row['vehicle'], row['recording'], row['status']) for row in rows] == [
        ('car_1', f'file://{year}/logs/car_1/drive_{i}', 'done') for i in (0, 1)]
    lines = (some[0] / 'tables/results.csv').read_text().splitlines()
    mine = (tmp_path / 'url/tables/results.csv').read_text().splitlines()
    assert len(mine) == 3 and set(mine) <= set(lines)


def test_configure_takes_the_recordings_of_a_vehicle_together_that_can_be_used(year, tmp_path):
    """Two good ones and one that is empty."""
    output = tmp_path / 'configured'
    status, _, err = run_here(year, 'logs/car_1/*[0-1y]*', '--task', 'configure', '--output', output, '--no-pages',
                              '--vehicle-from', 'logs/{vehicle}/*')
    assert status == 0, err
    rows = tables.read(output, 'recordings')
    assert sorted((row['recording'].rpartition('/')[2], row['status']) for row in rows) == [
        ('drive_0', 'done'), ('drive_1', 'done'), ('empty.mcap', 'failed')]
    [written] = (output / 'results').glob('*/params.yaml')
    values = check(params_file.load_yaml(written))
    assert 'drive_0' in written.read_text() and 'drive_1' in written.read_text()
    together = {row['parameter']: row['value'] for row in tables.read(output, 'effects')
                if row['source'] == 'params_file' and row['effect'] == 'imu'}
    assert together['mounting_rpy[2]'] == values['imu.mounting_rpy'][2]
    alone = [row for row in tables.read(output, 'effects') if row['source'] == 'configure']
    assert {row['recording_id'] for row in alone} == {row['recording_id'] for row in rows if row['status'] == 'done'}


@pytest.fixture
def quick_diagnosis(monkeypatch):
    """The diagnosis with one candidate and outages of one length: a tenth of the time."""
    from mems_ins_fusion.diagnosis.diagnose import diagnose
    from mems_ins_fusion.effects.registry import EFFECTS

    monkeypatch.setattr('mems_ins_fusion.reports.diagnosing.diagnose', partial(
        diagnose, effects=[EFFECTS['gnss_time_offset']], durations=(10.0,)))


def test_diagnose_takes_a_vehicle_together_and_leaves_out_what_is_certainly_wrong(year, tmp_path, quick_diagnosis):
    """Three drives: in the third one the IMU is the other way round. Another vehicle has all of its drives so."""
    for vehicle, drive, backwards in (('good', 0, False), ('good', 1, False), ('good', 2, True), ('wrong', 3, True)):
        write_late(tmp_path / 'logs' / vehicle / f'drive_{drive}', seed=drive, backwards=backwards)
    (tmp_path / 'params.yaml').write_text('/**:\n  ros__parameters: {gnss.sigma: 0.5}\n')
    status, out, err = run_here(tmp_path, 'logs', '--task', 'diagnose', '--params-file', 'params.yaml', '--output',
                                'out')
    assert status == 0, err
    ids = {row['recording']: row['recording_id'] for row in tables.read(tmp_path / 'out', 'recordings')}
    found = [row for row in tables.read(tmp_path / 'out', 'effects') if row['source'] == 'diagnose']
    assert {row['vehicle'] for row in found} == {'good'}
    offsets = {row['recording_id']: row for row in found if row['effect'] == 'gnss_time_offset'}
    # all together, and each by itself
    assert set(offsets) == {'', ids['logs/good/drive_0'], ids['logs/good/drive_1']}
    assert abs(offsets['']['value'] - LATE) < 4 * offsets['']['sigma'] < 0.2
    wrong = [row for row in tables.read(tmp_path / 'out', 'findings') if row['severity'] == 'error']
    assert {(row['vehicle'], row['recording_id']) for row in wrong if 'backwards' in row['message']} >= {
        ('good', ids['logs/good/drive_2']), ('wrong', ids['logs/wrong/drive_3'])}
    [verdict] = [row for row in wrong if row['topic'] == 'verdict']
    assert verdict['vehicle'] == 'wrong' and verdict['message'].startswith('not_usable')
    # with what the single tool writes of such data: a page and no corrected.yaml
    written = [{path.name for path in folder.parent.iterdir()} for folder in (tmp_path / 'out').glob('**/report.json')]
    assert sorted('corrected.yaml' in names for names in written) == [False, True]
    assert all('report.html' in names for names in written)
    assert 'wrong' in (tmp_path / 'out/fleet.html').read_text() and 'backwards' in out


def test_characterize_measures_recordings_at_rest(tmp_path):
    """An .npz and two bags of one vehicle; in the last one the accelerometers are twice as noisy."""
    for name, day, factor in (('a.npz', 0, 1.0), ('b', 1, 1.0), ('c', 2, 2.0)):
        write_at_rest(tmp_path / 'logs/car' / name, day, factor)
    status, _, err = run_here(tmp_path, 'logs', '--task', 'characterize', '--output', 'out', '--no-pages')
    assert status == 0, err
    rows = tables.read(tmp_path / 'out', 'recordings')
    assert [(row['status'], row['imu_samples']) for row in rows] == 3 * [('done', REST_SAMPLES)]
    written = [check(params_file.load_yaml(path)) for path in (tmp_path / 'out').glob('results/*/imu.yaml')]
    found = sorted(values['accelerometer.noise_density'][0] for values in written)
    assert found == pytest.approx([REST_DENSITY, REST_DENSITY, 2 * REST_DENSITY], rel=0.15)
    # an .npz has no date
    with open(tmp_path / 'out/history/car.csv', newline='') as file:
        noise = [float(row['value']) for row in csv.DictReader(file) if row['effect'] == 'accelerometer_noise']
    assert noise == pytest.approx([REST_DENSITY, 2 * REST_DENSITY], rel=0.1)


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
    rewrite(tmp_path, 'results', [row | {'horizontal_rmse_m': row['horizontal_rmse_m'] * (1.3 if i % 2 else 0.7)}
                                  for i, row in enumerate(rows)])
    assert tool(['fleet', 'compare', str(whole[0]), str(tmp_path)]) == 0


def test_compare_refuses_what_is_no_fleet(whole, tmp_path, capsys):
    assert tool(['fleet', 'compare', str(whole[0]), str(tmp_path)]) == 2
    assert 'is not the output of fleet' in capsys.readouterr().err
