"""fleet: sources, tables, queries and the page, without a filter."""
from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from browser_support import check_page

from mems_ins_fusion.fleet import change_points, failures, population, tables
from mems_ins_fusion.fleet.page import page
from mems_ins_fusion.fleet.run import Fleet, FleetTask
from mems_ins_fusion.fleet.sources import Entry, SourceError, content_id, find_entries
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.recordings.errors import RecordingError

REPOSITORY = Path(__file__).resolve().parents[1]


# sources

@pytest.fixture
def logs(tmp_path, monkeypatch):
    for name in ('car_1/monday.mcap', 'car_1/b/tuesday.db3', 'car_2/wednesday.bag', 'car_2/notes.txt',
                 'car_2/split/split_0.mcap', 'car_2/split/split_1.mcap', 'car_2/split/metadata.yaml'):
        path = tmp_path / 'logs' / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(name.encode())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_folder_is_looked_through(logs):
    assert find_entries('logs') == [
        Entry('b', 'logs/car_1/b/tuesday.db3'), Entry('car_1', 'logs/car_1/monday.mcap'),
        Entry('car_2', 'logs/car_2/split'), Entry('car_2', 'logs/car_2/wednesday.bag')]


@pytest.mark.parametrize('source', ['logs', 'logs/**/*.*', '{here}/logs', 'file://{here}/logs'])
def test_the_vehicle_is_where_the_pattern_says(logs, source):
    if '://' in source:
        pytest.importorskip('fsspec')
    found = find_entries(source.format(here=logs), 'logs/{vehicle}/**')
    named = [e for e in found if not e.recording.endswith(('.txt', '.yaml')) and 'split_' not in e.recording]
    assert [entry.vehicle for entry in named].count('car_1') == 2
    assert {entry.vehicle for entry in found} == {'car_1', 'car_2'}


@pytest.mark.parametrize('kind', ['csv', 'parquet'])
def test_a_table_names_vehicle_params_file_and_reference(logs, kind):
    rows = [{'vehicle': 'a', 'recording': 'logs/car_1/monday.mcap', 'params_file': 'a.yaml', 'reference': ''},
            {'vehicle': 'b', 'recording': '/else/where.bag', 'params_file': '', 'reference': 's3://x/truth.csv'}]
    path = logs / f'fleet.{kind}'
    if kind == 'csv':
        path.write_text('\n'.join([','.join(rows[0]), *(','.join(row.values()) for row in rows)]))
    else:
        parquet = pytest.importorskip('pyarrow.parquet')
        import pyarrow

        parquet.write_table(pyarrow.Table.from_pylist(rows), path)
    assert find_entries(str(path)) == [
        Entry('a', str(logs / 'logs/car_1/monday.mcap'), str(logs / 'a.yaml'), ''),
        Entry('b', '/else/where.bag', '', 's3://x/truth.csv')]


@pytest.mark.parametrize(['text', 'told'], [('vehicle,bag\na,b\n', "no column 'recording', only vehicle, bag"),
                                            ('vehicle,recording\na,\n', "row 1 has no 'recording'")])
def test_a_wrong_table_is_told(logs, text, told):
    (logs / 'fleet.csv').write_text(text)
    with pytest.raises(SourceError, match=told):
        find_entries(str(logs / 'fleet.csv'))


def test_a_recording_is_what_is_in_it(logs):
    """Not what it is called; and two empty files are not the same."""
    content = content_id(logs / 'logs/car_2/split')
    (logs / 'logs/car_2/split').rename(logs / 'elsewhere')
    assert content_id(logs / 'elsewhere') == content
    (logs / 'elsewhere/split_1.mcap').write_bytes(b'other')
    assert content_id(logs / 'elsewhere') != content
    for name in ('one', 'two'):
        (logs / name).touch()
    assert content_id(logs / 'one') != content_id(logs / 'two')


# failures

def test_an_error_has_the_same_id_wherever_it_is():
    ids = {failures.error_id(RecordingError(f'{path} breaks off at {size} MB of 3.1 MB'), [path])
           for path, size in (('a/b.mcap', 1), ('drive 7', 2.5))}
    assert len(ids) == 1 and re.fullmatch('recording-[0-9a-f]{6}', ids.pop())
    assert failures.error_id(RecordingError('something else')) != failures.error_id(RecordingError('something'))
    assert failures.error_id(ParameterError('x')).startswith('parameter-')
    assert failures.error_id(MemoryError()) == 'out-of-memory'
    assert failures.error_id(ZeroDivisionError('division by zero')).startswith('defect-')


# tables

def fleet_rows(vehicles=8, drives=5, seed=0):
    """Tables as a replay of two models makes them: auto-regressive is worse in each vehicle."""
    rng = np.random.default_rng(seed)
    rows = {name: [] for name in tables.TABLES}
    for vehicle in range(vehicles):
        for drive in range(drives):
            about = {'vehicle': f'car {vehicle}/ä', 'recording_id': f'{vehicle}.{drive}', 'params_file': '',
                     'task': 'replay', 'stage': '', 'mechanization': 'strapdown', 'update_interval_s': 1.0}
            rows['recordings'].append(about | {'recording': f'logs/{vehicle}/{drive}', 'status': 'done',
                                               'begin_ns': drive * 10**15, 'duration_s': 600.0, 'imu_samples': 60000,
                                               'error_id': '', 'reason': '', 'page': f'results/{vehicle}/r.html'})
            error = (1 + 0.3 * vehicle) * np.exp(0.1 * rng.standard_normal())
            for model, factor in (('gauss_markov', 1.0), ('autoregressive', 1.3)):
                rows['results'].append(about | {'model': model, 'horizontal_rmse_m': factor * error})
                rows['outages'].append(about | {'model': model, 'duration_s': 30.0, 'count': 17,
                                                'max_error_rms_m': 5 * factor * error, 'within_95_percent': 95.0})
            rows['effects'].append(about | {'source': 'configure', 'effect': 'gnss_time_offset', 'unit': 's',
                                            'parameter': 'time_offset', 'sigma': 0.02,
                                            'value': (0.25 if vehicle == 3 else 0.0) + 0.02 * rng.standard_normal()})
    rows['recordings'].append({'vehicle': 'car 0/ä', 'recording': 'logs/0/broken', 'recording_id': 'x',
                               'status': 'failed', 'error_id': 'recording-0', 'reason': 'is <empty>', 'task': 'replay'})
    return rows


def test_tables_are_read_as_they_were_written(tmp_path):
    rows = fleet_rows()
    tables.write(tmp_path, rows)
    for name in tables.TABLES:
        written = [{c: '' if v is None and tables.TABLES[name][c] == tables.TEXT else v for c, v in row.items()}
                   for row in tables.complete(name, rows[name])]
        assert tables.read(tmp_path, name) == written


def test_parquet_holds_what_csv_holds_by_vehicle(tmp_path):
    dataset = pytest.importorskip('pyarrow.dataset')
    tables.write(tmp_path, fleet_rows())
    for name in tables.TABLES:
        folder = tmp_path / 'tables' / name
        if name == 'findings':  # there are none
            assert not folder.exists()
            continue
        found = dataset.dataset(folder, partitioning='hive').to_table().to_pylist()
        assert {row['vehicle'] for row in found} == {f'car {i}/ä' for i in range(8)}
        read = [{c: None if v == '' else v for c, v in row.items()} for row in tables.read(tmp_path, name)]
        found = [{c: None if row[c] == '' else row[c] for c in tables.TABLES[name]} for row in found]
        assert sorted(map(str, read)) == sorted(map(str, found))


def test_without_pyarrow_there_is_csv_and_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'pyarrow', None)
    said = tables.write(tmp_path, fleet_rows())
    assert 'CSV only' in said and len(said.splitlines()) == 1
    assert sorted(p.name for p in (tmp_path / 'tables').iterdir()) == sorted(f'{name}.csv' for name in tables.TABLES)


def queries():
    """Those of docs/fleet.md."""
    text = (REPOSITORY / 'docs/fleet.md').read_text(encoding='utf-8')
    return re.findall(r'```sql\n(.*?)```', text, re.DOTALL)


def test_the_queries_of_the_docs_say_what_they_promise(tmp_path, monkeypatch):
    duckdb = pytest.importorskip('duckdb')
    pytest.importorskip('pyarrow')
    rows = fleet_rows()
    tables.write(tmp_path / 'out', rows)
    monkeypatch.chdir(tmp_path)
    best, offsets, failed = (duckdb.sql(query).fetchall() for query in queries())
    # the models by their mean over vehicles: what is written above, by another way
    ours = {model: np.mean([np.mean([r['max_error_rms_m'] for r in rows['outages'] if r['model'] == model
                                     and r['vehicle'] == v]) for v in {r['vehicle'] for r in rows['outages']}])
            for model in ('gauss_markov', 'autoregressive')}
    assert [row[0] for row in best] == ['gauss_markov', 'autoregressive']
    assert [row[-1] for row in best] == pytest.approx([ours[row[0]] for row in best])
    assert [row[0] for row in offsets] == ['car 3/ä'] and offsets[0][1] == pytest.approx(0.25, abs=0.05)
    assert failed == [('recording-0', 1, 'is <empty>')]


# vehicles

def test_the_vehicle_is_the_unit():
    """One vehicle with a thousand recordings counts as one: its errors do not decide for all."""
    where = population.ComparedQuantity(30.0, 1.0)
    rng = np.random.default_rng(1)
    before = {(f'car_{v}', str(d)): 5.0 + v + 0.1 * rng.standard_normal() for v in range(5) for d in range(3)}
    before |= {('taxi', str(d)): 5.0 + 0.1 * rng.standard_normal() for d in range(1000)}
    after = {key: error + (2.0 if key[0] == 'taxi' else 0.0) for key, error in before.items()}
    change, unit = population.change(where, before, after)
    assert unit == 'vehicles' and change.count == 6
    assert change.after - change.before == pytest.approx(2.0 / 6, abs=0.05) and change.sign() == 0
    few, unit = population.change(where, *({k: e for k, e in errors.items() if k[0] == 'taxi'}
                                           for errors in (before, after)))
    assert unit == 'recordings' and few.sign() == 1


def test_the_interval_over_vehicles_holds_as_often_as_it_says():
    """Seven vehicles that differ by themselves: 95 of 100 intervals of the mean hold the truth."""
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(400):
        own = 1.0 + 0.3 * rng.standard_normal(7)
        values = {(str(v), str(d)): own[v] + 0.1 * rng.standard_normal() for v in range(7) for d in range(1 + 3 * v)}
        low, high = population.mean_of(population.over_vehicles(values)[0]).interval()
        held += low < 1.0 < high
    assert 0.92 < held / 400 < 0.98


def test_who_wins_where(tmp_path):
    rows = fleet_rows()
    errors = population.errors_of(*(tables.complete(name, rows[name]) for name in ('results', 'outages')))
    standings = population.standings(errors)
    assert [(s.where.without, s.candidate.model, s.answer) for s in standings] == [
        (0.0, 'gauss_markov', ''), (0.0, 'autoregressive', 'worse'),
        (30.0, 'gauss_markov', ''), (30.0, 'autoregressive', 'worse')]


@pytest.mark.parametrize('own_files', [False, True])
def test_params_files_compete_where_they_were_tried_on_the_same_recordings(own_files):
    """Not where each vehicle has its own."""
    rows = fleet_rows()
    for name in ('results', 'outages'):
        some = [row | {'params_file': f'{row["vehicle"]}.yaml' if own_files else 'a.yaml'} for row in rows[name]
                if row['model'] == 'gauss_markov']
        rows[name] = some if own_files else some + [row | {'params_file': 'b.yaml', **{
            key: 2 * row[key] for key in ('horizontal_rmse_m', 'max_error_rms_m') if key in row}} for row in some]
    errors = population.errors_of(*(tables.complete(name, rows[name]) for name in ('results', 'outages')))
    found = [(s.candidate.params_file, s.count, s.answer) for s in population.standings(errors) if s.where.without]
    assert found == ([('', 8, '')] if own_files else [('a.yaml', 8, ''), ('b.yaml', 8, 'worse')])
    verdict, unit = population.compared(errors, errors)
    assert (verdict.answer, unit, {c.count for c in verdict.changes}) == ('same', 'vehicles', {8})


# the page

def made_page(rows, changes=()):
    asked = FleetTask('logs', 'replay', Path('out'))
    rows = {name: tables.complete(name, some) for name, some in rows.items()}
    return page(Fleet(asked, rows, list(changes)), [])


def test_the_page_names_the_vehicle_that_is_not_as_the_others():
    text = made_page(fleet_rows())
    assert 'car 3/ä is not as the others: time offset of the receiver' in text
    assert 'gauss markov' in text and 'worse' in text and 'recording-0' in text


def test_a_hostile_name_is_text(tmp_path):
    rows = fleet_rows()
    rows['recordings'][0]['recording'] = '</script><img src=x onerror=alert(1)>'
    text = made_page(rows)
    assert '</script><img' not in text and '<img src=x' not in text


def test_the_page_bears_ten_thousand_recordings(browser, tmp_path):
    rows = fleet_rows()
    some = rows['recordings'][:40]
    rows['recordings'] = [row | {'recording': f'{row["recording"]}/{i}', 'recording_id': f'{row["recording_id"]}.{i}'}
                          for i in range(250) for row in some]
    rows['recordings'].append({'vehicle': 'last', 'recording': 'needle', 'recording_id': 'n', 'status': 'failed',
                               'error_id': 'recording-1', 'reason': 'no', 'task': 'replay'})
    (tmp_path / 'fleet.html').write_text(made_page(rows), encoding='utf-8')
    assert (tmp_path / 'fleet.html').stat().st_size < 4e6
    browser.open(tmp_path / 'fleet.html', 1200)
    count = 'return document.querySelectorAll(".fleet-table tbody tr").length'
    said = 'return document.querySelector(".fleet-table .said").textContent'
    assert (browser.run(count), browser.run(said)) == (50, '1 to 50 of 10001')
    browser.run('document.querySelectorAll(".fleet-table button")[1].click()')
    assert browser.run(said) == '51 to 100 of 10001'
    browser.run('const i = document.querySelector(".fleet-table input"); i.value = "needle fail";'
                'i.dispatchEvent(new Event("input"))')
    assert (browser.run(count), browser.run(said)) == (1, '1 to 1 of 1')
    browser.run('const i = document.querySelector(".fleet-table input"); i.value = "";'
                'i.dispatchEvent(new Event("input")); document.querySelectorAll(".fleet-table th")[5].click();')
    assert browser.run('return document.querySelector(".fleet-table tbody td").textContent').startswith('car')


def test_the_page_fits_a_phone_and_a_sheet_of_paper(browser, tmp_path):
    arm = change_points.QUANTITIES['gnss_lever_arm', 'x']
    change = change_points.ChangePoint('car 1/ä', arm, 'diagnose', 0, 10**15, (3, 2), 0.6, 0.05, 1e-5)
    (tmp_path / 'fleet.html').write_text(made_page(fleet_rows(), [change]), encoding='utf-8')
    check_page(browser, tmp_path / 'fleet.html')
