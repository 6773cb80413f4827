"""The hostile inputs that once did harm, each as a case of its own."""
from __future__ import annotations

import bz2
import errno
import os
import signal
import sqlite3
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml
from fuzz_support import IMU, START, TEXTS, good_bags, outcome
from test_recordings import drive, write_bag

from mems_ins_fusion import guard
from mems_ins_fusion.characterization.characterize import read_npz
from mems_ins_fusion.cli import simulate
from mems_ins_fusion.cli.command import Parser
from mems_ins_fusion.cli.command import run as run_tool
from mems_ins_fusion.evaluation.metrics import turning_at
from mems_ins_fusion.evaluation.outages import outage_begins
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.recordings import csv_columns, csv_import
from mems_ins_fusion.recordings.bags import Bag
from mems_ins_fusion.recordings.checker import check_recording
from mems_ins_fusion.recordings.errors import RecordingError, RecordingWarning
from mems_ins_fusion.recordings.mcap import MAGIC
from mems_ins_fusion.recordings.reading import Memory, read_recording
from mems_ins_fusion.recordings.reference_files import read_reference
from mems_ins_fusion.results import ResultError, result_folder
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    return good_bags(tmp_path_factory.mktemp('bags'))


def refused(work) -> str:
    """What `work` is refused with: one line, little memory, no long wait."""
    found = outcome(work)
    assert not found.complaint()
    assert found.status == 2 and found.said.count('\n') == 1, found
    return found.said


# -- values ------------------------------------------------------------------------------------------------------------

def imu_at(stamp, force=(0.0, 0.0, 9.81)):
    return ImuSamples(stamp, stamp, np.tile(force, (len(stamp), 1)), np.zeros((len(stamp), 3)))


@pytest.mark.parametrize('clock', [0, 2**31 * 10**9 - 1])
@pytest.mark.parametrize('where', [0, 500, -1])
def test_one_stamp_of_a_clock_that_is_not_set(clock, where):
    stamp = START + np.arange(1000) * 10**7
    stamp[where] = clock
    epochs = START + np.arange(10) * 10**9
    found = outcome(lambda: turning_at(imu_at(stamp), np.eye(6), epochs)[:0])
    assert not found.complaint() and found.memory < 0.1
    fixes = Fixes(stamp, stamp, *np.zeros((3, 1000)), np.zeros((1000, 3, 3)), np.zeros(1000), np.ones(1000))
    assert len(outage_begins(START, fixes, 0.0, 1e-3, 0.0)) < 1000


@pytest.mark.parametrize('force', [(0.0, 0.0, 0.0), (1e300, 0.0, 0.0), (np.nan,) * 3, (np.inf, 0.0, 0.0)])
@pytest.mark.parametrize('height', [500.0, 1e300, np.nan])
def test_values_that_no_sensor_delivers(force, height):
    stamp, at = START + np.arange(3000) * 10**7, START + np.arange(30) * 10**9
    fixes = Fixes(at, at, np.full(30, 0.8) + 1e-6 * np.arange(30), np.full(30, 0.2), np.full(30, height),
                  np.tile(np.eye(3), (30, 1, 1)), np.zeros(30, np.int8), np.full(30, 2, np.uint8))
    check_recording(Recording('values', imu_at(stamp, force), fixes))


def test_a_recording_too_long_is_refused_with_an_estimate(tmp_path):
    bag = write_bag(tmp_path / 'bag', drive(1000))
    with pytest.raises(RecordingError, match="about 1.[0-9] GB of memory, more than parameter 'memory_limit'"):
        read_recording(bag, '/imu/data', memory=Memory(0.5, 0.1, 1e6))
    assert len(read_recording(bag, '/imu/data', memory=Memory(2.0, 0.1, 1e6)).imu) == 1000


# -- YAML --------------------------------------------------------------------------------------------------------------

BOMB = '/**:\n  ros__parameters:\n    a0: &a0 [x, x]\n' + ''.join(
    f'    a{k + 1}: &a{k + 1} [*a{k}, *a{k}, *a{k}, *a{k}]\n' for k in range(30))


@pytest.mark.parametrize('text, expected', [
    (BOMB, 'aliases'), ('[' * 5000, 'nested'), ('/**: !!python/object/apply:os.system [id]', 'not valid YAML'),
    ('a: 1\n---\nb: 2\n', 'not valid YAML'), ('1: 2\n/**: 3\nb: 4\n', 'must stand under'),
    ('1: 2\nb: 4\n', 'must stand under'),
    ('/**:\n  ros__parameters: {imu_topic: 2020-01-01}', "no topic|''"), ('? [1]\n: 2', 'not valid|no section'),
    ('/**:\n  ros__parameters: {1: 2}', 'not the name'), ('/**:\n  ros__parameters: {seed: !!int x}', 'not valid YAML'),
    ('/**:\n  ros__parameters: {imu_topic: ""}', 'must not be empty'), ('x' * 2_000_000, 'larger'),
    ('/**:\n  ros__parameters: {imu.max_gap: 1.0e300}', 'at most 60'),
    ('/**:\n  ros__parameters: {seed: 1.0e30}', 'at most'),
    ('/**:\n  ros__parameters: {seed: ' + '9' * 400 + '}', 'seed'),
    ('/**:\n  ros__parameters: {gyroscope.autoregressive.interval: 1.0e-9}', 'at least 0.0001'),
    ('/**:\n  ros__parameters: {gyroscope.autoregressive.coefficients: [' + '0.1, ' * 300 + ']}', '1 to 60 values'),
    ('/**:\n  ros__parameters: {datum: [1.0e9, 0.0, 0.0]}', 'latitude from -90 to 90')])
def test_params_files(tmp_path, text, expected):
    path = tmp_path / 'params.yaml'
    path.write_text(text)
    if 'imu_topic: 2020' in text:  # a text, as ROS reads it
        assert table.check(params_file.load_yaml(path))['imu_topic'] == '2020-01-01'
        return
    said = refused(lambda: table.check(params_file.load_yaml(path)))
    assert any(part in said for part in expected.split('|')), said


@pytest.mark.parametrize('model', ['autoregressive'])
def test_unstable_coefficients(tmp_path, model):
    path = tmp_path / 'params.yaml'
    path.write_text('/**:\n  ros__parameters: {gyroscope.autoregressive.coefficients: [-3.0, 0.5]}')
    assert 'coefficients' in refused(lambda: simulate.main(
        ['--output', str(tmp_path / 'bag'), '--duration', '3', '--model', model, '--params-file', str(path)]))


@pytest.mark.parametrize('text', ["driver's imu", 'a\nb', '\x07', 'é', "''", 'a: b # c'])
def test_texts_are_written_as_yaml_that_reads_back(text):
    assert yaml.safe_load(f'a: {params_file.yaml_value(text)}') == {'a': text}


# -- bags --------------------------------------------------------------------------------------------------------------

def record(opcode, content):
    return struct.pack('<BQ', opcode, len(content)) + content


def text(value):
    value = value.encode() if isinstance(value, str) else value
    return struct.pack('<I', len(value)) + value


def compressed(data, kind):
    if kind == 'lz4':
        import lz4.frame
        return lz4.frame.compress(data)
    from mems_ins_fusion.recordings.compression import zstd
    return zstd().compress(data)


@pytest.mark.parametrize('kind', ['zstd', 'lz4'])
def test_a_chunk_that_unpacks_to_gigabytes(tmp_path, kind):
    packed = 40 * compressed(bytes(16 * 2**20), kind)  # frames may follow each other
    path = tmp_path / 'bomb.mcap'
    path.write_bytes(MAGIC + record(6, struct.pack('<QQQI', 0, 0, 6 * 10**9, 0) + text(kind)
                                    + struct.pack('<Q', len(packed)) + packed) + MAGIC)
    assert 'unpacks to more than' in refused(lambda: read_recording(path, '/imu/data'))


def test_a_message_and_a_file_that_unpack_to_gigabytes(tmp_path, bags):
    packed = 40 * compressed(bytes(16 * 2**20), 'zstd')
    path = tmp_path / 'bomb.mcap.zstd'
    path.write_bytes(packed)
    assert 'unpacks to more than' in refused(lambda: read_recording(path, '/imu/data'))
    assert 'are no valid' in refused(lambda: read_recording(
        write_bag(tmp_path / 'message', [('/imu/data', IMU, START, packed)]), '/imu/data'))


def test_a_ros1_chunk_that_unpacks_to_gigabytes(tmp_path, bags):
    packed = 80 * bz2.compress(bytes(4 * 2**20))
    header = text(b'op=\x05') + text(b'compression=bz2') + text(b'size=' + struct.pack('<I', 2**31))
    path = tmp_path / 'bomb.bag'
    path.write_bytes(b'#ROSBAG V2.0\n' + text(header) + text(packed))
    assert 'is not a ROS 1 bag' in refused(lambda: read_recording(path, '/imu/data'))


@pytest.mark.parametrize('content', [record(3, b'\0'), record(4, b'\0\0\1\0' + text(b'\xff\xfe') + text('cdr')),
                                     record(5, b'\0\0'), record(4, b'\0\0\0\0' + struct.pack('<I', 2**31)),
                                     record(6, b'\0' * 5), record(0x42, b'')])
def test_mcap_records_too_short_too_long_or_not_utf8(tmp_path, content):
    path = tmp_path / 'drive.mcap'
    path.write_bytes(MAGIC + content + MAGIC)
    refused(lambda: read_recording(path, '/imu/data'))
    good = next((write_bag(tmp_path / 'bag', drive(50))).glob('*.mcap')).read_bytes()
    path.write_bytes(good[:8] + content + good[8:])
    with pytest.warns(RecordingWarning) if content[0] != 0x42 else np.errstate():
        assert len(read_recording(path, '/imu/data').imu) == 50


def database(path, *statements):
    with sqlite3.connect(path) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()
    return path


TOPICS = 'CREATE TABLE topics(id, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT)'
MESSAGES = 'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)'
ENDLESS = 'WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) '


@pytest.mark.parametrize('statements', [
    (TOPICS, f'CREATE VIEW messages AS {ENDLESS}SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(9) AS data '
     'FROM n'),
    (MESSAGES, f"CREATE VIEW topics AS {ENDLESS}SELECT i AS id, 'a' || i AS name, 'b' AS type, 'cdr' AS "
     'serialization_format FROM n'),
    (TOPICS, 'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data AS (zeroblob(900000000)))'),
    (TOPICS, MESSAGES, f"INSERT INTO topics VALUES('1) UNION {ENDLESS}SELECT i, 1, 1, 1 FROM n --', '/imu/data', "
     f"'{IMU}', 'cdr', '')")])
def test_a_database_that_computes_without_end(tmp_path, statements):
    path = database(tmp_path / 'drive.db3', *statements)
    refused(lambda: read_recording(path, '/imu/data'))


@pytest.mark.parametrize('column, value', [('data', 'NULL'), ('data', "'text'"), ('data', '5'), ('timestamp', "'x'"),
                                           ('timestamp', 'NULL'), ('topic_id', "'x'")])
def test_cells_of_another_kind_lose_their_message_only(tmp_path, bags, column, value):
    path = tmp_path / 'drive.db3'
    path.write_bytes(next(bags['sqlite3'].glob('*.db3')).read_bytes())
    # without the constraints that rosbag2 declares
    database(path, 'CREATE TABLE free AS SELECT * FROM messages', 'DROP TABLE messages',
             'ALTER TABLE free RENAME TO messages', f'UPDATE messages SET {column} = {value} WHERE id = 8')
    with pytest.warns(RecordingWarning) if column != 'topic_id' else np.errstate():
        assert len(read_recording(path, '/imu/data').imu) == 119


def test_nothing_is_written_beside_a_database_with_a_log(tmp_path, bags):
    path = tmp_path / 'drive.db3'
    path.write_bytes(next(bags['sqlite3'].glob('*.db3')).read_bytes())
    writer = sqlite3.connect(path)
    writer.execute('PRAGMA journal_mode = WAL')
    writer.execute('DELETE FROM messages WHERE id > 60')
    writer.commit()
    copy = tmp_path / 'copy'
    copy.mkdir()
    for file in (path, path.with_name('drive.db3-wal')):
        (copy / file.name).write_bytes(file.read_bytes())
    writer.close()
    before = {file.name: file.read_bytes() for file in copy.iterdir()}
    # what stands in the log alone is read, too
    assert len(read_recording(copy / 'drive.db3', '/imu/data').imu) < 60
    assert {file.name: file.read_bytes() for file in copy.iterdir()} == before


@pytest.mark.parametrize('listed', ["['..']", "['']", "['notes.txt']", "['/etc/passwd']", '[5]', '{}', "'abc'",
                                    "['a.mcap']"])
def test_metadata_that_lists_no_recordings(tmp_path, listed):
    bag = write_bag(tmp_path / 'bag', drive(20))
    (bag / 'notes.txt').write_text('x')
    (bag / 'metadata.yaml').write_text(f'rosbag2_bagfile_information: {{relative_file_paths: {listed}}}')
    with pytest.warns(RecordingWarning, match='metadata.yaml|missing'):
        assert len(read_recording(bag, '/imu/data').imu) == 20


def test_a_wrong_length_costs_no_more_than_its_chunk(tmp_path):
    path = next(write_bag(tmp_path / 'bag', drive(9000)).glob('*.mcap'))
    with Bag(path) as bag:
        chunks = sorted(bag._files[0]._chunk_channels)
    content = bytearray(path.read_bytes())
    struct.pack_into('<Q', content, chunks[1] + 1, 2**60)
    path.write_bytes(content)
    with pytest.warns(RecordingWarning, match=r'damaged at .* lost'):
        count = len(read_recording(path, '/imu/data').imu)
    assert 9000 * (1 - 1.5 / len(chunks)) < count < 9000


# -- tables ------------------------------------------------------------------------------------------------------------

def spoiled(tmp_path, name, old, new):
    path = tmp_path / name
    path.write_text(TEXTS[name].replace(old, new))
    return path


@pytest.mark.parametrize('cell', ['', 'NaT', 'today', '9999-12-31T23:59:59', '2020-13-45T00:00:00'])
def test_dates_that_are_none(tmp_path, cell):
    path = spoiled(tmp_path, 'gnss.csv', '2023-11-14T22:13:25.5Z', cell)
    assert 'gnss.csv' in refused(lambda: csv_import.read_gnss(path))


@pytest.mark.parametrize('cell', ['1e999999', '1e300', '9' * 200_000, 'inf', '-5'])
def test_times_that_are_none(tmp_path, cell):
    path = spoiled(tmp_path, 'imu.csv', '1700000000.07', cell)
    assert 'imu.csv' in refused(lambda: csv_import.read_imu(path))


@pytest.mark.parametrize('time', ['1000000 302400.0', '9999/05/01 12:00:05.000', '2312 1e300', '2312 nan'])
def test_rtklib_times_that_are_none(tmp_path, time):
    path = spoiled(tmp_path, 'track.pos', '2024/05/01 12:00:05.000', time)
    assert 'is not a time' in refused(lambda: read_reference(path))


@pytest.mark.parametrize('content', [b'', b'PK\3\4', b'\x93NUMPY\1\0v\0{"descr": "<f8"}', None])
def test_npz_that_is_none(tmp_path, content):
    path = tmp_path / 'rest.npz'
    np.savez(path, acc_mps2=np.zeros((9, 3)), gyro_radps=np.zeros((9, 3)), rate_hz=100.0)
    if content is None:
        np.save(tmp_path / 'rest.npy', np.zeros(5))
        content = (tmp_path / 'rest.npy').read_bytes()
    path.write_bytes(content or path.read_bytes()[:200])
    assert 'cannot be read as npz' in refused(lambda: read_npz(path))


def test_npz_with_a_huge_shape(tmp_path):
    path = tmp_path / 'rest.npz'
    np.savez(path, acc_mps2=np.zeros((9, 3)), gyro_radps=np.zeros((9, 3)), rate_hz=100.0)
    data, old, new = path.read_bytes(), b"(9, 3), }         ", b"(9999999999999, 3)"
    path.write_bytes(data.replace(old, new + b', }'[:0]))
    assert path.name in refused(lambda: read_npz(path))
    path.write_bytes(data[:len(data) - 30] + zlib.compress(b'x'))
    assert path.name in refused(lambda: read_npz(path))


# -- command line ------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize('options', [
    '--rate 1e9', '--duration 1e12', '--duration 1e6', '--seed -1', '--seed ' + '9' * 400, '--rate nan',
    '--gnss-rate 1e9', '--gnss-sigma inf', '--standstill 1e300'])
def test_simulate_refuses_what_has_no_end(tmp_path, options):
    refused(lambda: simulate.main(['--output', str(tmp_path / 'bag'), *options.split()]))


# -- results -----------------------------------------------------------------------------------------------------------

def write(path, **options):
    with result_folder(path, **options) as folder:
        (folder / 'report.json').write_text('new')


def test_the_same_output_twice_at_once(tmp_path):
    out = tmp_path / 'out'
    with result_folder(out) as folder:
        (folder / 'report.json').write_text('first')
        found = outcome(lambda: write(out, overwrite=True))
        assert found.status == 2 and 'another run is writing' in found.said
    assert (out / 'report.json').read_text() == 'first'
    # a result that appeared meanwhile is not replaced unasked
    with pytest.raises(ResultError, match='exists already'), result_folder(tmp_path / 'other') as folder:
        (tmp_path / 'other').mkdir()
        (tmp_path / 'other' / 'report.json').write_text('somebody faster')


def test_leftovers_of_killed_runs_are_removed_by_the_next(tmp_path):
    out = tmp_path / 'out'

    def killed():
        with result_folder(out):
            os.kill(os.getpid(), signal.SIGKILL)

    assert outcome(killed).status == -signal.SIGKILL
    (tmp_path / '.out.settings').mkdir()  # somebody's own
    assert len(list(tmp_path.iterdir())) == 2
    write(out)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['.out.settings', 'out']
    # and a result that was moved away to make room for one that never came is put back
    out.rename(tmp_path / 'moved')
    (tmp_path / '.out.abcdefgh.former').mkdir()
    (tmp_path / 'moved').rename(tmp_path / '.out.abcdefgh.former' / 'out')
    with pytest.raises(ResultError, match='exists already'):
        write(out)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['.out.settings', 'out']


def test_outputs_that_cannot_be_written(tmp_path):
    (tmp_path / 'link').symlink_to(tmp_path / 'nothing')
    assert 'symbolic link to nothing' in refused(lambda: write(tmp_path / 'link'))
    assert 'name too long' in refused(lambda: write(tmp_path / ('x' * 300)))
    assert 'cannot write /dev/null/x' in refused(lambda: write('/dev/null/x'))


def test_a_full_disk_is_said(tmp_path):
    def full():
        with result_folder(tmp_path / 'out'):
            with open('/dev/full', 'w') as file:
                file.write('x' * 100_000)

    assert 'No space left' in refused(full)
    assert not list(tmp_path.iterdir())


# -- the last net ------------------------------------------------------------------------------------------------------

def test_a_defect_is_said_in_one_line_with_its_traceback_in_a_file(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    assert guard.guarded('simulate', ['--seed', '1'], lambda: {}['absent']) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and 'number' in said and '--seed 1' in said and 'KeyError' in said
    [file] = tmp_path.iterdir()
    assert str(file) in said and 'Traceback' in file.read_text()


def defect(work) -> str:
    """The number of the defect that `work` ends in."""
    with pytest.raises(Exception) as caught:
        work()
    return guard.identity(caught.value)


def test_the_number_of_a_defect_is_that_of_its_place_not_of_the_data():
    one, same = (defect(lambda wrong=wrong: csv_import.axes_rotation(wrong)) for wrong in (5, 7.0))
    assert one == same and len(one) == 6
    assert one != defect(lambda: csv_columns.parse_columns(5, {}))


def test_errors_of_libraries_are_not_told_as_the_users(capsys):
    def work(error):
        def fails(options):
            raise error
        return run_tool(Parser('diagnose', 'x'), fails, [])

    for error in (np.linalg.LinAlgError('Eigenvalues did not converge'), ValueError('operands could not be broadcast'),
                  UnicodeDecodeError('utf-8', b'x', 0, 1, 'invalid')):
        assert guard.guarded('diagnose', [], lambda: work(error)) == 2
        assert 'a defect of the program' in capsys.readouterr().err
    assert guard.guarded('diagnose', [], lambda: work(RecordingError('a\nb \x1b[31m'))) == 2
    assert capsys.readouterr().err == 'diagnose: a b \\x1b[31m\n'


@pytest.mark.parametrize('error, said', [
    (OSError(errno.EMFILE, 'Too many open files', 'x.png'), 'ulimit -n'),
    (ImportError('libx.so: cannot open shared object file: Too many open files'), 'ulimit -n'),
    (RuntimeError("can't start new thread"), 'ulimit -u'),
    (BlockingIOError(errno.EAGAIN, 'Resource temporarily unavailable'), 'ulimit -u'),
    (ImportError('libx.so: failed to map segment from shared object'), 'no memory left'),
    (PermissionError(errno.EACCES, 'Permission denied', '/log/x'), '/log/x: Permission denied'),
    (OSError(errno.EROFS, 'Read-only file system', '/log/x'), '/log/x: Read-only file system')])
def test_what_the_system_has_too_little_of_is_no_defect(capsys, error, said):
    def work():
        raise error

    assert guard.guarded('diagnose', [], work) == 2
    found = capsys.readouterr().err
    assert said in found and 'defect' not in found and found.count('\n') == 1


def test_few_open_files_and_names_that_are_not_utf8(tmp_path):
    environment = {**os.environ, 'PYTHONPATH': str(REPOSITORY)}
    simulate = [sys.executable, '-m', 'mems_ins_fusion', 'simulate', '--duration', '3', '--output']
    found = subprocess.run(['sh', '-c', 'ulimit -n 6; exec "$@"', 'sh', *simulate, str(tmp_path / 'bag')],
                           capture_output=True, text=True, env=environment)
    assert found.returncode == 2 and 'open' in found.stderr and 'defect' not in found.stderr, found.stderr
    name = os.fsencode(tmp_path) + b'/\xff'
    found = subprocess.run([*simulate, name], capture_output=True, text=True, env=environment)
    assert found.returncode == 2 and 'is not UTF-8' in found.stderr and found.stderr.count('\n') == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('work', [
    lambda path: params_file.load_yaml(path), lambda path: read_recording(path, '/imu/data'),
    lambda path: csv_import.read_imu(path), lambda path: read_reference(path)])
@pytest.mark.parametrize('suffix', ['.yaml', '.mcap', '.csv'])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, work, suffix):
    path = tmp_path / f'pipe{suffix}'
    os.mkfifo(path)
    assert str(path) in refused(lambda: work(path))


@pytest.mark.parametrize('tool', ['replay_node', 'fusion_node'])
def test_a_node_waits_neither_for_a_pipe_nor_for_a_log_that_cannot_be_written(tmp_path, tool):
    pytest.importorskip('rclpy')
    node = [sys.executable, '-m', 'mems_ins_fusion', tool, '--ros-args']
    os.mkfifo(tmp_path / 'pipe.yaml')
    for arguments, changed, expected in (
            (['--params-file', str(tmp_path / 'pipe.yaml')], {}, 'pipe.yaml is not a file'),
            (['-p', 'imu_topic:=/x'], {'ROS_LOG_DIR': '/proc/nothing'}, 'set ROS_LOG_DIR')):
        found = subprocess.run([*node, *arguments], capture_output=True, text=True,
                               env={**os.environ, 'PYTHONPATH': str(REPOSITORY), **changed})
        assert found.returncode == 2 and expected in found.stderr and found.stderr.count('\n') == 1, found.stderr


DEAF = """
import sys
import numpy as np
from mems_ins_fusion import guard

def work():
    print('begun', flush=True)
    np.linalg.svd(np.random.default_rng(0).normal(size=(2500, 2500)))
    print('ended')

guard.GRACE = 0.1
sys.exit(guard.guarded('tool', [], work))
"""


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_tool_in_a_long_computation_of_a_library_is_not_deaf(number):
    tool = subprocess.Popen([sys.executable, '-c', DEAF], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                            env={**os.environ, 'PYTHONPATH': str(REPOSITORY)})
    assert tool.stdout.readline() == 'begun\n'
    time.sleep(0.2)  # into the computation
    tool.send_signal(number)
    out, said = tool.communicate()
    assert tool.returncode == 130 and out == '' and said == 'tool: interrupted, nothing was written\n'


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_tool_cleans_up_and_says_so(tmp_path, number):
    environment = {**os.environ, 'PYTHONPATH': str(REPOSITORY)}
    tool = subprocess.Popen([sys.executable, '-m', 'mems_ins_fusion', 'simulate', '--output', str(tmp_path / 'out'),
                             '--duration', '1500'], stderr=subprocess.PIPE, text=True, env=environment)
    deadline = time.monotonic() + 120
    while not list(tmp_path.iterdir()) and time.monotonic() < deadline:
        time.sleep(0.01)
    tool.send_signal(number)
    said = tool.communicate()[1]
    assert tool.returncode == 130 and said == 'simulate: interrupted, nothing was written\n'
    assert not list(tmp_path.iterdir())
