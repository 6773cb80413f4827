"""Damaged and hostile input for every reader, and a judge of what the package makes of it.

Used by the tests for a few seconds and by `studies/fuzz.py` for as long as one likes. Each input is read in a process
of its own, so that memory and time are those of this input alone.
"""
from __future__ import annotations

import os
import random
import resource
import signal
import struct
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fuzz_recordings import LONGEST as LONGEST_OF
from fuzz_recordings import TOOLS, recording_case
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mems_ins_fusion.errors import InputError
from mems_ins_fusion.guard import guarded, refuse

#: GB that small input may take, besides what the process had before: a process of tests holds what earlier ones left
MOST_MEMORY = 0.8
#: s of processor time that it may take
LONGEST = 30
START = 1_700_000_000_000_000_000
IMU, FIX = 'sensor_msgs/msg/Imu', 'sensor_msgs/msg/NavSatFix'


@dataclass(frozen=True)
class Outcome:
    """What one input led to. status: exit status, negative: the signal that ended it."""

    status: int
    said: str
    seconds: float
    memory: float  # GB, most that was resident besides what the process began with

    def complaint(self, longest: float = LONGEST) -> str:
        """What is wrong with it; empty where nothing is. longest: s of processor time that it may take."""
        if self.status not in (0, 2):
            return f'status {self.status}: {self.said[-300:]}'
        if any(words in self.said for words in ('Traceback', 'a defect of the program', 'RuntimeWarning')):
            return self.said[-600:]
        lines = self.said.strip().splitlines()
        if self.status == 2 and not lines:
            return 'refused without a word'
        if self.memory > MOST_MEMORY:
            return f'{self.memory:.1f} GB: {self.said[-300:]}'
        return f'{self.seconds:.0f} s: {self.said[-300:]}' if self.seconds > longest else ''


def outcome(work: Callable[[], object], longest: float = LONGEST) -> Outcome:
    """`work` as a tool does it, in a child process that ends by force after twice `longest` s of processor time."""
    with tempfile.TemporaryFile() as said:
        sys.stdout.flush()
        sys.stderr.flush()
        begun = _resident()
        child = os.fork()
        if child == 0:
            os._exit(_child(work, said.fileno(), longest))
        _, status, usage = os.wait4(child, 0)
        said.seek(0)
        text = said.read().decode(errors='replace')
    return Outcome(os.waitstatus_to_exitcode(status), text, usage.ru_utime + usage.ru_stime,
                   max(usage.ru_maxrss * 1024 - begun, 0) / 1e9)


def _resident() -> int:
    """Bytes of this process that are in memory."""
    return int(Path('/proc/self/statm').read_text().split()[1]) * resource.getpagesize()


def _child(work, said, longest: float) -> int:
    try:
        os.dup2(said, 1)
        os.dup2(said, 2)
        sys.stdout, sys.stderr = os.fdopen(1, 'w', closefd=False), os.fdopen(2, 'w', closefd=False)
        resource.setrlimit(resource.RLIMIT_CPU, (round(2 * longest), resource.RLIM_INFINITY))
        signal.alarm(round(10 * longest))  # ends the process before its test counts as one that hangs
        room = 4 * 2**30  # the machine survives what is not refused
        used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + room, resource.RLIM_INFINITY))
        status = guarded('fuzz', [], lambda: _tool(work))
        sys.stdout.flush()
        sys.stderr.flush()
        return status
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        return 99


def _tool(work) -> int:
    try:
        status = work()
        return status if isinstance(status, int) else 0
    except InputError as error:
        return refuse('fuzz', error)
    except SystemExit as error:  # argparse
        return error.code or 0


# -- good input, to be damaged ----------------------------------------------------------------------------------------

def good_bags(folder: Path) -> dict[str, Path]:
    """One small recording in every kind of bag: name to the file or folder."""
    store = get_typestore(Stores.ROS2_JAZZY)
    imu = [_imu(store, k) for k in range(120)]
    fixes = [_fix(store, k) for k in range(6)]
    found = {}
    for name, plugin, mode in (('mcap', StoragePlugin.MCAP, None), ('sqlite3', StoragePlugin.SQLITE3, None),
                               ('message', StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
                               ('zstd', StoragePlugin.MCAP, CompressionMode.FILE),
                               ('chunks', StoragePlugin.MCAP, CompressionMode.STORAGE)):
        found[name] = folder / name
        writer = Writer(found[name], version=9, storage_plugin=plugin)
        if mode is not None:
            writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            topics = [writer.add_connection(topic, kind, typestore=store)
                      for topic, kind in (('/imu/data', IMU), ('/gps/fix', FIX))]
            for k, message in enumerate(imu):
                writer.write(topics[0], START + k * 10**7, store.serialize_cdr(message, IMU))
                if k % 20 == 0:
                    writer.write(topics[1], START + k * 10**7, store.serialize_cdr(fixes[k // 20], FIX))
    store1 = get_typestore(Stores.ROS1_NOETIC)
    for name, compression in (('plain', None), ('bz2', Writer1.CompressionFormat.BZ2),
                              ('lz4', Writer1.CompressionFormat.LZ4)):
        found[name] = folder / f'{name}.bag'
        writer = Writer1(found[name])
        if compression is not None:
            writer.set_compression(compression)
        with writer:
            topic = writer.add_connection('/imu/data', IMU, typestore=store1)
            for k in range(120):
                writer.write(topic, START + k * 10**7, store1.serialize_ros1(_imu(store1, k), IMU))
    return found


def _header(store, k):
    types = store.types
    stamp = START + k * 10**7
    time_type = types['builtin_interfaces/msg/Time']
    fields = dict(stamp=time_type(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id='imu')
    return types['std_msgs/msg/Header'](**fields, **({'seq': k} if 'seq' in
                                                     types['std_msgs/msg/Header'].__dataclass_fields__ else {}))


def _imu(store, k):
    types, vector = store.types, store.types['geometry_msgs/msg/Vector3']
    zeros = np.zeros(9)
    return types[IMU](header=_header(store, k),
                      orientation=types['geometry_msgs/msg/Quaternion'](x=0.0, y=0.0, z=0.0, w=1.0),
                      orientation_covariance=zeros, angular_velocity=vector(x=0.0, y=0.0, z=0.01 * k),
                      angular_velocity_covariance=zeros, linear_acceleration=vector(x=0.1, y=0.0, z=9.81),
                      linear_acceleration_covariance=zeros)


def _fix(store, k):
    types = store.types
    return types[FIX](header=_header(store, 20 * k), status=types['sensor_msgs/msg/NavSatStatus'](status=0, service=1),
                      latitude=48.0 + 1e-5 * k, longitude=11.0, altitude=500.0,
                      position_covariance=np.diag([1.0, 1.0, 4.0]).ravel(), position_covariance_type=2)


TEXTS = {
    'imu.csv': 'time [s],ax,ay,az,wx,wy,wz,temperature\n' + ''.join(
        f'{1.7e9 + 0.01 * k:.2f},0.1,0.2,9.81,0,0,0.01,25\n' for k in range(60)),
    'gnss.csv': 'time,latitude,longitude,height,sigma\n' + ''.join(
        f'2023-11-14T22:13:{k:02d}.5Z,48.00{k},11.0,500,1.5\n' for k in range(20, 50)),
    'track.tum': ''.join(f'{1.7e9 + k:.3f} {k}.0 1.5 0.1 0 0 0 1\n' for k in range(30)),
    'track.nmea': ''.join(
        f'$GPRMC,1200{k:02d}.00,A,4807.038,N,01131.000,E,022.4,084.4,230324,003.1,W\n'
        f'$GPGGA,1200{k:02d}.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,\n' for k in range(30)),
    'track.pos': '% program: RTKPOST\n%  GPST  latitude(deg) longitude(deg) height(m) Q ns\n' + ''.join(
        f'2024/05/01 12:00:{k:02d}.000 48.0 11.0 500.0 1 9\n' for k in range(30)),
    'params.yaml': '/**:\n  ros__parameters:\n    imu_topic: /imu/data\n    gnss.lever_arm: [0.5, 0.0, 1.2]\n'
                   '    imu: {max_gap: 0.5}\n    mechanization: strapdown\n    seed: 3\n'
                   '    gyroscope.autoregressive.coefficients: [-1.7, 0.71]\n    vehicle.zero_velocity: true\n',
}

#: what a text is spoiled with
NASTY = ('', 'nan', 'NaT', 'today', 'inf', '-1e300', '1e999999', '1' * 5000, '9' * 200_000, '0x10', '1_0', '１', '\0',
         '"', "'", '{', '[' * 300, '&a [*a, *a]', '*a', '!!python/object/apply:os.system [id]', '---\n', '\t', '- ',
         '9999-12-31T23:59:59', '1:2:3:4', '2020-13-45', '%', '#', ';', ',', '$', '\u202e', '\r', 'é', '~', '-', '.',
         '!!int x', '!!timestamp x', '? [1]: 2', '<<: 3', '1e-320', '-0', '1000000 302400.0', '1970-01-01T00:00:00')
_NUMBERS = (0, 1, 2, 7, 0x7f, 0xff, 0xffff, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)


def spoiled_bytes(data: bytes, rng: random.Random) -> bytes:
    """`data` with one to four damages."""
    data = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(data) + 1)
        kind = rng.randrange(7)
        if kind == 0:
            del data[at:]
        elif kind == 1:
            data[at:at + rng.randint(1, 64)] = rng.randbytes(rng.randint(1, 64))
        elif kind == 2:
            data[at:at + 8] = struct.pack('<Q', rng.choice(_NUMBERS))
        elif kind == 3:
            data[at:at + 4] = struct.pack('<I', rng.choice(_NUMBERS) % 2**32)
        elif kind == 4:
            data[at:at] = data[at:at + rng.randint(1, 5000)]
        elif kind == 5:
            del data[at:at + rng.randint(1, 500)]
        elif at < len(data):
            data[at] ^= 1 << rng.randrange(8)
    return bytes(data)


def spoiled_text(text: str, rng: random.Random) -> bytes:
    """`text` with one to three cells or places replaced by something nasty, or spoiled as bytes."""
    if rng.random() < 0.2:
        return spoiled_bytes(text.encode(), rng)
    for _ in range(rng.randint(1, 3)):
        lines = text.splitlines(keepends=True) or ['']
        row = rng.randrange(len(lines))
        line = lines[row]
        begin = rng.randrange(len(line) + 1)
        ends = [i for i in range(begin, len(line)) if line[i] in ',; :\n'] or [len(line)]
        begin = max((i + 1 for i in range(begin) if line[i] in ',; :'), default=begin)
        lines[row] = line[:begin] + rng.choice(NASTY) + line[ends[0]:]
        text = ''.join(lines)
    return text.encode(errors='replace')


# -- what is tried ----------------------------------------------------------------------------------------------------

def recordings(folder: Path, seed: int) -> Iterator[tuple[str, Callable[[], object], float]]:
    """Endless (tool, content and seed, work to be judged, s it may take): `fuzz_recordings` through every tool."""
    for number in range(seed, sys.maxsize):
        tool = TOOLS[number % len(TOOLS)]
        what, work = recording_case(folder, random.Random(number), tool)
        yield f'{tool}, {what}, seed {number}', work, LONGEST_OF[tool]


def cases(folder: Path, seed: int) -> Iterator[tuple[str, Callable[[], object]]]:
    """Endless (reader and seed, work to be judged); the input stands in `folder`, so that it can be looked at."""
    bags = good_bags(folder)
    _read_bag(bags['mcap'])  # imported and compiled once, not in every child
    contents = {}
    for name, path in bags.items():
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            contents[f'{name}/{file.name}'] = file.read_bytes()
    npz = folder / 'rest.npz'
    np.savez_compressed(npz, acc_mps2=np.zeros((50, 3)), gyro_radps=np.zeros((50, 3)), rate_hz=100.0)
    contents['npz/rest.npz'] = npz.read_bytes()
    kinds = [*contents, *TEXTS, 'command line', 'values']
    for number in range(seed, sys.maxsize):
        rng = random.Random(number)
        kind = kinds[number % len(kinds)]
        yield f'{kind}, seed {number}', _case(kind, contents, folder, rng)


def _case(kind: str, contents: dict, folder: Path, rng) -> Callable[[], object]:
    if kind == 'command line':
        return _command_line(folder, rng)
    if kind == 'values':
        return _values(rng)
    if kind in TEXTS:
        path = folder / kind
        path.write_bytes(spoiled_text(TEXTS[kind], rng))
        return _text_reader(kind, path)
    name, _, file = kind.partition('/')
    path = folder / 'spoiled' / file
    if path.parent.exists():
        for old in path.parent.iterdir():
            old.unlink()
    path.parent.mkdir(exist_ok=True)
    for other, content in contents.items():  # the rest of a folder as it was
        if other.partition('/')[0] == name:
            (path.parent / other.partition('/')[2]).write_bytes(content)
    path.write_bytes(spoiled_bytes(contents[kind], rng))
    if name == 'npz':
        return lambda: _read_npz(path)
    alone = path.suffix == '.bag' or (path.suffix != '.yaml' and rng.random() < 0.5)
    return lambda: _read_bag(path if alone else path.parent)


def _read_bag(path) -> None:
    from mems_ins_fusion.recordings.checker import check_recording
    from mems_ins_fusion.recordings.reading import Memory, read_recording

    recording = read_recording(path, '/imu/data', None if path.suffix == '.bag' else '/gps/fix',
                               memory=Memory(1.0, 0.3, 500.0))
    check_recording(recording)


def _read_npz(path) -> None:
    from mems_ins_fusion.characterization.characterize import read_npz

    read_npz(path)


def _text_reader(kind: str, path: Path) -> Callable[[], object]:
    from mems_ins_fusion.parameters import params_file, table
    from mems_ins_fusion.recordings import csv_import
    from mems_ins_fusion.recordings.reference_files import read_reference

    if kind == 'params.yaml':
        return lambda: _use_parameters(table.check(params_file.load_yaml(path)))
    if kind == 'imu.csv':
        return lambda: csv_import.read_imu(path)
    if kind == 'gnss.csv':
        return lambda: (csv_import.read_gnss(path), read_reference(path))[:0]
    return lambda: read_reference(path, (0.8, 0.2, 500.0))


def _use_parameters(values: dict) -> None:
    from mems_ins_fusion.filter.config import FilterConfig
    from mems_ins_fusion.parameters.params_file import yaml_value

    [yaml_value(value) for value in values.values()]
    FilterConfig.from_parameters(values)


#: options of each tool, each with values that it takes: a part of the command lines is to be carried out
_OPTIONS = {
    'simulate': {'--duration': '3|0.5', '--rate': '20|200', '--seed': '0|7', '--gnss-rate': '1|5',
                 '--gnss-sigma': '0|3', '--gnss-latency': '0|0.4', '--reference-rate': '1|20', '--standstill': '0|2',
                 '--outage': '1:2|0:9',
                 '--effect': 'tilt=1|gnss_time_offset=0.2|gyroscope_scale.z=0.01', '--storage': 'mcap|sqlite3',
                 '--model': 'random_walk|autoregressive', '--params-file': 'good.yaml', '--static': '',
                 '--drive': 'realistic|flat', '--gnss-outliers': '0.5|1', '--gnss-smoothing': '0|2', '--aiding': '',
                 '--manoeuvres': 'mixed|city', '--vibration': '0|3', '--overwrite': ''},
    'import_csv': {'--imu': 'good_imu.csv', '--gnss': 'good_gnss.csv', '--reference': 'good.tum', '--gnss-sigma': '1',
                   '--imu-axes': 'forward left up|right back up', '--imu-columns': 'time=1|time=t',
                   '--gnss-columns': 'time=1', '--imu-time-unit': 's|ns', '--acceleration-unit': 'g|mg',
                   '--imu-topic': '/imu|a', '--storage': 'sqlite3', '--overwrite': ''},
    'characterize': {'--bag': 'rest', '--orders': '1|3', '--imu-topic': '/imu/data', '--params-file': 'good.yaml',
                     '--overwrite': ''},
    'configure': {'--bag': 'mcap', '--overwrite': ''},
    'diagnose': {'--bag': 'mcap', '--params-file': 'good.yaml', '--reference-topic': '/gps/fix', '--start': '0|1',
                 '--stop': '1|3', '--reference-file': 'good.tum', '--overwrite': ''},
    'compare': {'--bag': 'mcap', '--params-file': 'good.yaml', '--reference-topic': '/gps/fix', '--overwrite': ''}}
_ARGUMENTS = ('0', '-1', '5', '1e9', '1e300', 'nan', 'inf', '', 'x', '/', '/dev/null', '/dev/zero', '.', 'a=b', '1:2',
              '2:1', 'tilt=1', 'tilt.x=1e300', 'gnss_time_offset=1e9', 'nowhere', 'x' * 300, 'forward left up',
              'time=1', 'temperature=1e308', 'mcap', 'sqlite3', 'random_walk', '9' * 400, 'accelerometer_scale=1e300')


def _command_line(folder: Path, rng) -> Callable[[], object]:
    """A tool with options of its own, of which in half of the cases every value is one that it takes."""
    tool, plausible = rng.choice(list(_OPTIONS)), rng.random() < 0.5
    for name, kind in (('good_imu.csv', 'imu.csv'), ('good_gnss.csv', 'gnss.csv'), ('good.tum', 'track.tum'),
                       ('good.yaml', 'params.yaml')):
        (folder / name).write_text(TEXTS[kind])
    given = {'simulate': ['--duration', '3', '--rate', '20'], 'import_csv': ['--imu', str(folder / 'good_imu.csv')],
             'compare': [str(folder / 'mcap')] * 2}.get(tool, ['--bag', str(folder / 'mcap')])
    outputs = [folder / 'out' / f'result{rng.randrange(10**9)}{".yaml" if tool == "configure" else ""}']
    if not plausible:
        outputs += [Path('/dev/null/x'), folder / ('y' * 300), folder / 'mcap']
    options = [*given, '--output', str(rng.choice(outputs))]
    for _ in range(rng.randint(1, 3)):
        option = rng.choice(list(_OPTIONS[tool]))
        values = _OPTIONS[tool][option].split('|') if plausible or rng.random() < 0.3 else _ARGUMENTS
        value = rng.choice(values)
        options.append(option)
        if value:
            options.append(str(folder / value) if os.path.exists(folder / value) else value)
    from importlib import import_module
    return lambda: import_module(f'mems_ins_fusion.cli.{tool}').main(options)


def _values(rng) -> Callable[[], object]:
    """Samples that no sensor delivers: what checker and the measuring of errors make of them."""
    from mems_ins_fusion.evaluation.intervals import interval_of_mean
    from mems_ins_fusion.evaluation.metrics import turning_at
    from mems_ins_fusion.recordings.checker import check_recording
    from mems_ins_fusion.samples import Fixes, ImuSamples, Recording

    n, m = rng.choice([1, 2, 30, 400]), rng.choice([1, 2, 20])
    draw = np.random.default_rng(rng.randrange(2**32))
    stamp, at = START + np.arange(n) * 10**7, START + np.arange(m) * 2 * 10**8
    force, rate = draw.normal((0, 0, 9.8), 0.1, (n, 3)), draw.normal(0, 0.01, (n, 3))
    latitude, longitude, height = 0.8 + 1e-7 * draw.random((3, m))
    for array in rng.sample([force, rate, latitude, longitude, height], rng.randint(1, 3)):
        extreme = rng.choice([0.0, 1e300, -1e300, np.nan, np.inf, 1e-300, 1e18])
        if rng.random() < 0.3:
            array[...] = extreme
        else:
            array[draw.integers(len(array))] = extreme
    for times in rng.sample([stamp, at], rng.randint(0, 2)):
        times[draw.integers(len(times))] = rng.choice([0, 1, 2**31 * 10**9, 2**62, START + 10**18])
    imu = ImuSamples(stamp, np.maximum.accumulate(stamp), force, rate)
    fixes = Fixes(at, at, latitude, longitude, height, np.tile(np.eye(3), (m, 1, 1)), np.zeros(m, np.int8),
                  np.full(m, 2, np.uint8))

    def work():
        check_recording(Recording('values', imu, fixes))
        turning_at(imu, np.eye(6), at)
        interval_of_mean(height)
    return work
