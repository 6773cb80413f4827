"""Fixes in messages that tell their quality: gps_msgs/GPSFix."""
from __future__ import annotations

import struct
import sys
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from mems_ins_fusion.configuration.topics import find_topics
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.base import GPS_FIX, NAV_SAT_FIX
from mems_ins_fusion.filter.measurements.position import NO_ALTITUDE_SIGMA, has_altitude, is_fix, without_altitude
from mems_ins_fusion.filter.measurements.registry import TYPES
from mems_ins_fusion.filter.memory import Error
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.bags import Bag
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_drive, simulate_recording

SECOND = 10**9
#: numbers behind the altitude, in the order of the message's definition
_BEHIND = ('track', 'speed', 'climb', 'pitch', 'roll', 'dip', 'time', 'gdop', 'pdop', 'hdop', 'vdop', 'tdop', 'err',
           'err_horz', 'err_vert', 'err_track', 'err_speed', 'err_climb', 'err_time', 'err_pitch', 'err_roll',
           'err_dip')


class Cdr:
    """Writes primitives aligned to their size behind the header of four bytes."""

    def __init__(self):
        self.data = bytearray(b'\x00\x01\x00\x00')

    def put(self, kind, *values):
        size = struct.calcsize(kind)
        self.data += bytes(-(len(self.data) - 4) % size) + struct.pack(f'<{len(values)}{kind}', *values)

    def header(self, stamp):
        self.put('i', stamp // SECOND)
        self.put('I', stamp % SECOND)
        self.put('I', 4)
        self.data += b'gps\0'

    def numbers(self, count):
        self.put('I', count)
        if count:
            self.put('i', *range(count))


def gps_fix(stamp, latitude, longitude, altitude, status=19, used=9, covariance=(0.0,) * 9, kind=0, satellites=5,
            **more) -> bytes:
    """One message, as a driver with the package installed writes it. latitude, longitude: deg."""
    cdr = Cdr()
    cdr.header(stamp)
    cdr.header(stamp)
    cdr.put('H', used)
    cdr.numbers(satellites)
    cdr.put('H', satellites)
    for _ in range(4):
        cdr.numbers(satellites)
    cdr.put('h', status)
    cdr.put('H', 1, 0, 1)
    cdr.put('d', latitude, longitude, altitude, *(more.get(name, 0.0) for name in _BEHIND), *covariance)
    cdr.put('B', kind)
    return bytes(cdr.data)


def read(**fields):
    """The fix of one message with these fields."""
    given = {'status.status': 0, 'status.satellites_used': 9, 'latitude': 48.0, 'longitude': 9.0, 'altitude': 300.0,
             'position_covariance': np.zeros(9), 'position_covariance_type': 0, 'err_horz': 0.0, 'err_vert': 0.0,
             'hdop': 0.0, 'vdop': 0.0, 'stamp': 0, 'received': 0, **fields}
    return TYPES['fix'].read({name: np.array([value]) for name, value in given.items()}, GPS_FIX)


@pytest.mark.parametrize(('status', 'expected'), [(-1, -1), (0, 0), (1, 1), (33, 1), (18, 1), (20, 1), (2, 2), (19, 2)])
def test_a_float_is_not_a_fixed_one_and_both_are_more_than_none(status, expected):
    assert read(**{'status.status': status}).status == expected


def test_too_few_satellites_are_no_fix():
    assert read(**{'status.satellites_used': 2}).status == -1
    assert read(**{'status.satellites_used': 0}).status == 0  # not told


def test_the_noise_is_taken_from_what_tells_it_best():
    # given a covariance, 95 % errors and a dilution of precision: the first of them that is filled counts
    told = {'err_horz': 4.8955, 'err_vert': 3.92, 'hdop': 2.0, 'vdop': 3.0}
    own = read(position_covariance=np.diag([4.0, 9.0, 16.0]).ravel(), position_covariance_type=2, **told)
    np.testing.assert_array_equal(own.covariance[0], np.diag([4.0, 9.0, 16.0]))
    # 95 % of a two-dimensional normal distribution are within sigma sqrt(-2 log 0.05)
    np.testing.assert_allclose(read(**told).covariance[0], np.diag([4.0, 4.0, 4.0]), rtol=1e-3)
    # the variances of north and east are half of that of both, 3 m of range times the dilution
    by_dilution = read(**{**told, 'err_horz': 0.0, 'err_vert': np.nan})
    np.testing.assert_allclose(by_dilution.covariance[0], np.diag([18.0, 18.0, 81.0]))
    assert by_dilution.covariance_type == 1
    assert read().covariance_type == 0  # then gnss.default_sigma counts


def test_a_bag_of_such_messages_is_read_as_one_of_fixes(tmp_path):
    # given a drive whose fixes are in these messages, with more and fewer satellites
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    recording = simulate_recording(simulate_drive(30.0, seed=2, rate=50.0), None, GnssNoise(0.5, 2.0), seed=2).recording
    write_recording(recording, tmp_path / 'plain', storage='sqlite3')
    fixes, store = recording.gnss, get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg('std_msgs/Header header', GPS_FIX))  # what the file says of it is not asked
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer, Bag(tmp_path / 'plain') as plain:
        topic = writer.add_connection('/gps/quality', GPS_FIX, typestore=store)
        samples = writer.add_connection('/imu/data', 'sensor_msgs/msg/Imu', typestore=store)
        for i in range(len(fixes)):
            writer.write(topic, int(fixes.received[i]), gps_fix(
                int(fixes.stamp[i]), np.degrees(fixes.latitude[i]), np.degrees(fixes.longitude[i]), fixes.height[i],
                status=(20, 19)[i % 2], err_horz=1.2, err_vert=2.0, satellites=4 + i % 5))
        for _, times, messages, _ in plain.read(['/imu/data']):
            for time, message in zip(times, messages):
                writer.write(samples, time, message)
    # when it is read
    read_back = read_recording(tmp_path / 'bag', '/imu/data', '/gps/quality').gnss
    # then the places, stamps and classes are theirs
    np.testing.assert_array_equal(read_back.stamp, fixes.stamp)
    np.testing.assert_allclose(read_back.latitude, fixes.latitude, rtol=1e-14)
    np.testing.assert_allclose(read_back.height, fixes.height)
    assert read_back.status.tolist() == [(1, 2)[i % 2] for i in range(len(fixes))]
    np.testing.assert_allclose(read_back.covariance[:, 0, 0], (1.2 / np.sqrt(-2.0 * np.log(0.05)))**2, rtol=1e-3)
    # and `configure` finds them as a receiver's
    assert find_topics(tmp_path / 'bag').gnss[0].topic == '/gps/quality'


class _Message(SimpleNamespace):
    pass


def _live(monkeypatch):
    """A class of messages as the package would have it, where it is not installed."""
    package, module = ModuleType('gps_msgs'), ModuleType('gps_msgs.msg')
    kind = type('GPSFix', (_Message,), {'__module__': 'gps_msgs.msg._gps_fix'})
    module.GPSFix, package.msg = kind, module
    monkeypatch.setitem(sys.modules, 'gps_msgs', package)
    monkeypatch.setitem(sys.modules, 'gps_msgs.msg', module)
    return kind


@pytest.mark.parametrize('kind', [0, 2])  # covariance unknown, and known
@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_a_fix_without_altitude_tells_where_and_not_how_high(tmp_path, kind, mechanization):
    simulated = simulate_recording(simulate_drive(60.0, seed=3), gnss=GnssNoise(0.5), seed=3).recording
    fixes = replace(simulated.gnss, covariance_type=np.full(len(simulated.gnss), kind, np.uint8))
    without = np.full(len(fixes), np.nan)
    write_recording(replace(simulated, gnss=replace(fixes, height=without)), tmp_path / 'without')
    back = read_recording(tmp_path / 'without', '/imu/data', '/gps/fix')
    assert is_fix(back.gnss).all() and not has_altitude(back.gnss).any()
    config = FilterConfig.from_parameters(table.check({'mechanization': mechanization}))
    level, found = run(config, simulated.imu, fixes), run(config, back.imu, back.gnss)
    assert len(found.stamp) == len(level.stamp)
    if mechanization == 'strapdown':
        assert found.sigma[-1, config.layout.rows[Error.R_D]] > 1000.0  # m
    for name in ('latitude', 'longitude'):
        off = 6.4e6 * (getattr(found, name) - getattr(level, name))
        assert np.abs(off).max() < 0.5  # m, the sigma of one fix


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_fixes_with_and_without_altitude_in_turns_keep_the_height(mechanization):
    simulated = simulate_recording(simulate_drive(60.0, seed=3), gnss=GnssNoise(0.5), seed=3).recording
    height, covariance = simulated.gnss.height.copy(), simulated.gnss.covariance.copy()
    height[1::2] = np.nan
    without_altitude(height, covariance)
    found = run(FilterConfig.from_parameters(table.check({'mechanization': mechanization})), simulated.imu,
                replace(simulated.gnss, height=height, covariance=covariance))
    # then it is that of the level road from the second fix after the start on
    assert np.abs(found.height[300:] - simulated.reference.height[0]).max() < 3.0  # m


def test_live_such_a_message_is_the_same_fix(monkeypatch):
    std = pytest.importorskip('std_msgs.msg')
    from mems_ins_fusion.nodes.inputs import message_class, nav_sat_fix

    assert message_class(GPS_FIX) is None and message_class(NAV_SAT_FIX) is not None
    kind = _live(monkeypatch)
    assert message_class(GPS_FIX) is kind
    header = std.Header(frame_id='gps')
    header.stamp.sec = 5
    made = nav_sat_fix(kind(header=header, status=SimpleNamespace(status=20, satellites_used=12), latitude=48.0,
                            longitude=9.0, altitude=300.0, position_covariance=np.zeros(9), position_covariance_type=0,
                            err_horz=4.8955, err_vert=3.92, hdop=0.0, vdop=0.0))
    assert made.status.status == 1 and made.position_covariance_type == 1 and made.header.stamp.sec == 5
    assert made.latitude == pytest.approx(48.0, abs=1e-12)
    np.testing.assert_allclose(made.position_covariance.reshape(3, 3), 4.0 * np.eye(3), rtol=1e-3)


def test_live_a_fix_without_altitude_is_the_same_as_in_a_bag():
    sensor = pytest.importorskip('sensor_msgs.msg')
    from mems_ins_fusion.nodes.inputs import nav_sat_fix

    made = nav_sat_fix(sensor.NavSatFix(latitude=48.0, longitude=9.0, altitude=float('nan'), position_covariance_type=2,
                                        position_covariance=np.diag([1.0, 1.0, 4.0]).ravel()))
    assert made.altitude == 0.0 and made.position_covariance_type == 2
    assert np.sqrt(made.position_covariance[[0, 4, 8]]).tolist() == [1.0, 1.0, NO_ALTITUDE_SIGMA]


def test_what_is_published_and_not_installed_is_named():
    pytest.importorskip('rclpy')
    from mems_ins_fusion.nodes.inputs import Input

    told = Input.__new__(Input)
    told._missing, told._kinds, told.topic_name = {GPS_FIX}, {NAV_SAT_FIX: object}, '/gps'
    told._node = SimpleNamespace(publishers=(), get_publishers_info_by_topic=lambda topic: [
        SimpleNamespace(topic_type=GPS_FIX)], get_topic_names_and_types=lambda: [])
    assert told.why_silent() == "it carries gps_msgs/msg/GPSFix, and the package 'gps_msgs' is not installed"
