"""Fixes in messages that tell their quality: of gps_msgs, septentrio_gnss_driver and ublox_msgs."""
from __future__ import annotations

import struct
import sys
from dataclasses import replace
from datetime import datetime, timezone
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from mems_ins_fusion.configuration.topics import find_topics
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.base import NAV_SAT_FIX
from mems_ins_fusion.filter.measurements.fix_quality import GPS_FIX, NAV_PVT, PVT_GEODETIC
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


def pvt_geodetic(**fields):
    """The fix of one message of Septentrio: fixed, 14 satellites, 2DRMS of 4 cm."""
    given = {'mode': 4, 'error': 0, 'latitude': 0.8, 'longitude': 0.15, 'height': 300.0, 'nr_sv': 14,
             'mean_corr_age': 100, 'h_accuracy': 4, 'v_accuracy': 6, 'stamp': 7, 'received': 8, **fields}
    return TYPES['fix'].read({name: np.array([value]) for name, value in given.items()}, PVT_GEODETIC)


def nav_pvt(**fields):
    """The fix of one message of u-blox: fixed, at 2026-02-03 04:05:06.25 UTC, corrections of 2 to 5 s."""
    given = {'year': 2026, 'month': 2, 'day': 3, 'hour': 4, 'min': 5, 'sec': 6, 'valid': 7, 'nano': 250_000_000,
             'fix_type': 3, 'flags': 131, 'num_sv': 20, 'lon': 90_000_000, 'lat': 480_000_000, 'height': 300_000,
             'h_acc': 14, 'v_acc': 20, 'reserved1': [3 << 1, 0, 0, 0, 0, 0], 'stamp': 7, 'received': 8, **fields}
    return TYPES['fix'].read({name: np.array([value]) for name, value in given.items()}, NAV_PVT)


@pytest.mark.parametrize(('fields', 'expected'), [
    ({'mode': 0}, -1), ({'mode': 1}, 0), ({'mode': 2}, 1), ({'mode': 4}, 2), ({'mode': 0xC4}, 2), ({'mode': 5}, 1),
    ({'mode': 6}, 1), ({'mode': 7}, 0), ({'mode': 10}, 1), ({'error': 3}, -1), ({'nr_sv': 2}, -1), ({'nr_sv': 255}, 2),
    ({'mean_corr_age': 1000}, 2), ({'mean_corr_age': 1001}, 1), ({'mean_corr_age': 65535}, 2)])
def test_septentrio_tells_float_from_fixed_and_old_corrections(fields, expected):
    fix = pvt_geodetic(**fields)
    assert fix.status == expected and fix.stamp == 7
    # 2DRMS is 2 sqrt(sigma_e^2 + sigma_n^2), the vertical one two sigma
    np.testing.assert_allclose(np.sqrt(fix.covariance[0].diagonal()), [0.04 / np.sqrt(8), 0.04 / np.sqrt(8), 0.03])
    assert (fix.latitude, fix.longitude) == (pytest.approx(0.8), pytest.approx(0.15))  # rad in the message, too


def test_accuracies_that_septentrio_does_not_know_are_none():
    assert pvt_geodetic(h_accuracy=65535).covariance_type == 0
    assert np.isfinite(pvt_geodetic(v_accuracy=65535).covariance).all()


@pytest.mark.parametrize(('fields', 'expected'), [
    ({'flags': 131}, 2), ({'flags': 67}, 1), ({'flags': 3}, 1), ({'flags': 1}, 0), ({'flags': 130}, -1),
    ({'fix_type': 0}, -1), ({'fix_type': 1}, -1), ({'fix_type': 5}, -1), ({'fix_type': 2}, 2), ({'num_sv': 2}, -1),
    ({'reserved1': [4 << 1, 0, 0, 0, 0, 0]}, 2), ({'reserved1': [5 << 1, 0, 0, 0, 0, 0]}, 1),
    ({'reserved1': [0, 0, 0, 0, 0, 0]}, 2), ({'reserved1': [3 << 1 | 1, 0, 0, 0, 0, 0]}, -1)])
def test_ublox_tells_float_from_fixed_and_old_corrections(fields, expected):
    fix = nav_pvt(**fields)
    assert fix.status == expected
    np.testing.assert_allclose(np.sqrt(fix.covariance[0].diagonal()), [0.014, 0.014, 0.02])
    np.testing.assert_allclose(np.degrees([fix.latitude[0], fix.longitude[0]]), [48.0, 9.0])
    assert fix.height == pytest.approx(300.0)


@pytest.mark.parametrize('nano', [250_000_000, -250_000_000])
def test_a_message_without_a_stamp_has_its_utc(nano):
    # by the calendar of Python
    second = round(datetime(2026, 2, 3, 4, 5, 6, tzinfo=timezone.utc).timestamp())
    assert nav_pvt(nano=nano).stamp == second * SECOND + nano and nav_pvt().received == 8


@pytest.mark.parametrize('valid', [0, 1, 3])
def test_a_message_without_utc_is_no_fix_when_it_was_received(valid):
    fix = nav_pvt(valid=valid, year=0, month=0)
    assert fix.status == -1 and fix.stamp == 7


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


def _septentrio(store, fixes, i):
    kinds = {name: store.types[name] for name in (PVT_GEODETIC, 'septentrio_gnss_driver/msg/BlockHeader')}
    given = {'mode': (5, 4)[i % 2], 'latitude': fixes.latitude[i], 'longitude': fixes.longitude[i],
             'height': fixes.height[i], 'nr_sv': 14, 'mean_corr_age': 120, 'h_accuracy': 40, 'v_accuracy': 60}
    zero = kinds[PVT_GEODETIC].__dataclass_fields__
    header = store.types['std_msgs/msg/Header'](store.types['builtin_interfaces/msg/Time'](
        int(fixes.stamp[i] // SECOND), int(fixes.stamp[i] % SECOND)), 'gnss' * (1 + i % 2))
    block = kinds['septentrio_gnss_driver/msg/BlockHeader'](36, 64, 1, 4007, 2, 96, 5, 6)
    return kinds[PVT_GEODETIC](**{**dict.fromkeys(zero, 0), 'header': header, 'block_header': block, **given})


def _ublox(store, fixes, i):
    at = datetime.fromtimestamp(fixes.stamp[i] // SECOND, timezone.utc)
    given = {'year': at.year, 'month': at.month, 'day': at.day, 'hour': at.hour, 'min': at.minute, 'sec': at.second,
             'nano': int(fixes.stamp[i] % SECOND), 'valid': 7, 'fix_type': 3, 'flags': (67, 131)[i % 2], 'num_sv': 20,
             'lon': round(np.degrees(fixes.longitude[i]) * 1e7), 'lat': round(np.degrees(fixes.latitude[i]) * 1e7),
             'height': round(fixes.height[i] * 1e3), 'h_acc': 141, 'v_acc': 300, 'reserved1': np.zeros(6, np.uint8)}
    kind = store.types[NAV_PVT]
    return kind(**{**dict.fromkeys(kind.__dataclass_fields__, 0), **given})


#: the drivers' definitions as their authors publish them, with the constants left out
_DEFINED = {
    'septentrio_gnss_driver/msg/BlockHeader': 'uint8 sync_1\nuint8 sync_2\nuint16 crc\nuint16 id\nuint8 revision\n'
                                              'uint16 length\nuint32 tow\nuint16 wnc',
    PVT_GEODETIC: '''std_msgs/Header header
BlockHeader block_header
uint8 mode
uint8 error
float64 latitude
float64 longitude
float64 height
float32 undulation
float32 vn
float32 ve
float32 vu
float32 cog
float64 rx_clk_bias
float32 rx_clk_drift
uint8 time_system
uint8 datum
uint8 nr_sv
uint8 wa_corr_info
uint16 reference_id
uint16 mean_corr_age
uint32 signal_info
uint8 alert_flag
uint8 nr_bases
uint16 ppp_info
uint16 latency
uint16 h_accuracy
uint16 v_accuracy
uint8 misc''',
    NAV_PVT: '''uint8 CLASS_ID = 1
uint32 i_tow
uint16 year
uint8 month
uint8 day
uint8 hour
uint8 min
uint8 sec
uint8 valid
uint8 VALID_DATE = 1
uint32 t_acc
int32 nano
uint8 fix_type
uint8 flags
uint8 flags2
uint8 num_sv
int32 lon
int32 lat
int32 height
int32 h_msl
uint32 h_acc
uint32 v_acc
int32 vel_n
int32 vel_e
int32 vel_d
int32 g_speed
int32 heading
uint32 s_acc
uint32 head_acc
uint16 p_dop
uint8[6] reserved1
int32 head_veh
int16 mag_dec
uint16 mag_acc'''}


@pytest.fixture(scope='module', params=[(PVT_GEODETIC, _septentrio), (NAV_PVT, _ublox)], ids=['septentrio', 'ublox'])
def driven(request, tmp_path_factory):
    """A drive with an IMU, the fixes in the messages of a driver, float and fixed in turn, and, as that driver does,
    in NavSatFix beside them: the folder of the bag, and the fixes."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    kind, message = request.param
    folder = tmp_path_factory.mktemp('driver')
    drive = simulate_drive(90.0, seed=4, rate=50.0)
    recording = simulate_recording(drive, None, GnssNoise(0.15, 2.0), seed=4).recording
    write_recording(recording, folder / 'plain', storage='sqlite3')
    fixes, store = recording.gnss, get_typestore(Stores.ROS2_JAZZY)
    for name, text in _DEFINED.items():
        store.register(get_types_from_msg(text, name))
    writer = Writer(folder / 'bag', version=9, storage_plugin=StoragePlugin.MCAP)
    with writer, Bag(folder / 'plain') as plain:
        topic = writer.add_connection('/z/pvt', kind, typestore=store)
        beside = {name: writer.add_connection(name, plain.topics[name], typestore=store)
                  for name in ('/imu/data', '/gps/fix')}
        for i in range(len(fixes)):
            writer.write(topic, int(fixes.received[i]), store.serialize_cdr(message(store, fixes, i), kind))
        for name, times, raw, _ in plain.read(list(beside)):
            for time, one in zip(times, raw):
                writer.write(beside[name], time, one)
    return folder / 'bag', fixes


def test_a_bag_of_a_driver_is_read_as_one_of_fixes(driven):
    bag, fixes = driven
    back = read_recording(bag, '/imu/data', '/z/pvt').gnss
    np.testing.assert_array_equal(back.stamp, fixes.stamp)
    np.testing.assert_allclose(back.latitude, fixes.latitude, atol=1e-9)  # rad: u-blox rounds to 1 cm
    np.testing.assert_allclose(back.longitude, fixes.longitude, atol=1e-9)
    np.testing.assert_allclose(back.height, fixes.height, atol=1e-3)
    assert back.status.tolist() == [(1, 2)[i % 2] for i in range(len(fixes))]
    np.testing.assert_allclose(back.covariance[:, 0, 0], 0.02, rtol=0.01)


def test_configure_takes_the_topic_that_tells_the_quality_of_the_same_fixes(driven):
    topics = find_topics(driven[0])
    assert [one.topic for one in topics.gnss] == ['/z/pvt', '/gps/fix']


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


def test_live_a_message_without_a_header_is_the_fix_of_its_utc():
    pytest.importorskip('rclpy')
    from mems_ins_fusion.nodes.inputs import Input, stamp_of

    kind = type('NavPVT', (_Message,), {'__module__': 'ublox_msgs.msg._nav_pvt'})
    message = kind(year=2026, month=2, day=3, hour=4, min=5, sec=6, valid=7, nano=-250_000_000, fix_type=3, flags=67,
                   num_sv=20, lon=90_000_000, lat=480_000_000, height=300_000, h_acc=141, v_acc=300,
                   reserved1=np.zeros(6, np.uint8))
    served, node = [], SimpleNamespace(get_clock=lambda: SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=7)))
    source = Input.__new__(Input)
    source._node, source._queue = node, SimpleNamespace(serve=lambda *one: served.append(one))
    source._on_first(message, {})
    made, second = served[0][1], round(datetime(2026, 2, 3, 4, 5, 6, tzinfo=timezone.utc).timestamp())
    assert stamp_of(made) == second * SECOND - 250_000_000 and made.status.status == 1
    assert made.latitude == pytest.approx(48.0) and made.position_covariance[0] == pytest.approx(0.141**2)
    # before it has UTC it is no fix, of now
    source._on_first(kind(**{**vars(message), 'valid': 0}), {})
    assert stamp_of(served[1][1]) == 7 and served[1][1].status.status == -1


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
