"""Reference trajectories from files; judged by hand-made lines of each format."""
from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest

from mems_ins_fusion.navigation.earth import from_local
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.reference_files import read_reference

DATUM = (0.8, 0.2, 300.0)


def utc(*when) -> int:
    return int(datetime(*when, tzinfo=UTC).timestamp()) * 10**9


def sentence(body) -> str:
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f'${body}*{checksum:02X}'


def write(tmp_path, name, *lines):
    path = tmp_path / name
    path.write_text('\n'.join(lines) + '\n')
    return path


def test_csv_in_degrees_with_velocity_and_heading(tmp_path):
    path = write(tmp_path, 'truth.csv', 'time,lat,lon,height,vn,ve,vu,heading',
                 '1700000001.5,48.5,11.25,400,1,2,3,270', '1700000000.25,48,11,399,4,5,6,90', '1700000003,,,,,,,')
    reference = read_reference(path)
    # sorted by stamp, the empty row left out
    assert reference.stamp.tolist() == [1_700_000_000_250_000_000, 1_700_000_001_500_000_000]
    assert np.degrees(reference.latitude) == pytest.approx([48.0, 48.5])
    assert np.degrees(reference.longitude) == pytest.approx([11.0, 11.25])
    assert reference.velocity.tolist() == [[4, 5, -6], [1, 2, -3]]
    assert np.degrees(reference.yaw) == pytest.approx([90, 270])


def test_csv_in_radians_without_the_rest(tmp_path):
    reference = read_reference(write(tmp_path, 'truth.csv', 'timestamp_ns;latitude [rad];longitude [rad]',
                                     '1700000000000000123;0,8;0,2', '1700000000100000123;0,8;0,2'))
    assert reference.stamp[0] == 1_700_000_000_000_000_123
    assert reference.latitude[0] == 0.8 and reference.longitude[0] == 0.2 and reference.height[0] == 0.0
    assert reference.velocity is None and reference.yaw is None


def test_csv_in_local_coordinates_needs_the_datum(tmp_path):
    path = write(tmp_path, 'truth.csv', 't,east,north,up', '1,10,20,30', '2,11,21,31')
    reference = read_reference(path, DATUM)
    expected = from_local(20.0, 10.0, -30.0, DATUM)
    assert (reference.latitude[0], reference.longitude[0], reference.height[0]) == pytest.approx(expected, rel=1e-14)
    with pytest.raises(RecordingError, match='local coordinates: give the datum'):
        read_reference(path)


@pytest.mark.parametrize('comment', [(), ('# timestamp tx ty tz qx qy qz qw',),
                                     ('# made by a tool', '# of eight columns')])
def test_tum(tmp_path, comment):
    half = math.radians(15)
    path = write(tmp_path, 'truth.txt', *comment,
                 f'1700000000.123456789 10 20 30 0 0 {math.sin(half)} {math.cos(half)}', '1700000001 11 21 31 0 0 0 2')
    reference = read_reference(path, DATUM)
    assert reference.stamp.tolist() == [1_700_000_000_123_456_789, 1_700_000_001_000_000_000]
    expected = from_local(20.0, 10.0, -30.0, DATUM)
    assert (reference.latitude[0], reference.longitude[0], reference.height[0]) == pytest.approx(expected, rel=1e-14)
    assert np.degrees(reference.yaw) == pytest.approx([60.0, 90.0])
    with pytest.raises(RecordingError, match='give the datum'):
        read_reference(path)


def test_nmea_over_midnight(tmp_path):
    # given GGA before RMC in each second, a wrong checksum, a sentence without a fix, southern and western places
    gga = 'GPGGA,{},4807.038,S,01131.500,W,{},08,0.9,545.4,M,46.9,M,,'
    rmc = 'GNRMC,{},A,4807.038,S,01131.500,W,022.4,084.4,{},,'
    path = write(tmp_path, 'drive.nmea',
                 sentence(gga.format('235958.50', 1)), sentence(rmc.format('235958.50', '311223')),
                 sentence('GPGSV,3,1,11'), sentence(gga.format('235959.50', 4)), sentence(gga.format('235959.75', 0)),
                 sentence(gga.format('235959.80', 1))[:-1] + 'X', sentence(gga.format('000000.25', 5)),
                 sentence(gga.format('000001.25', 5)), sentence(rmc.format('000001.25', '010124')),
                 sentence(gga.format('000002.25', 5)), 'garbage')
    reference = read_reference(path)
    first, second = utc(2023, 12, 31, 23, 59, 58), utc(2024, 1, 1)
    assert reference.stamp.tolist() == [first + 500_000_000, first + 1_500_000_000, second + 250_000_000,
                                        second + 1_250_000_000, second + 2_250_000_000]
    assert np.degrees(reference.latitude[0]) == pytest.approx(-(48 + 7.038 / 60))
    assert np.degrees(reference.longitude[0]) == pytest.approx(-(11 + 31.5 / 60))
    assert reference.height[0] == pytest.approx(545.4 + 46.9)


def test_nmea_of_rmc_alone_and_without_a_date(tmp_path):
    rmc = write(tmp_path, 'rmc.nmea', sentence('GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W'),
                sentence('GPRMC,123520,V,,,,,,,230394,,'))
    reference = read_reference(rmc)
    assert reference.stamp.tolist() == [utc(1994, 3, 23, 12, 35, 19)]
    assert np.degrees(reference.longitude[0]) == pytest.approx(11 + 31 / 60) and reference.height[0] == 0.0
    position = sentence('GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,')
    dated = read_reference(write(tmp_path, 'zda.nmea', position, sentence('GPZDA,123519,23,03,1994,00,00')))
    assert dated.stamp.tolist() == [utc(1994, 3, 23, 12, 35, 19)]
    with pytest.raises(RecordingError, match='holds no date'):
        read_reference(write(tmp_path, 'gga.nmea', position))
    with pytest.raises(RecordingError, match='no GGA or RMC sentence with a position'):
        read_reference(write(tmp_path, 'none.nmea', sentence('GPGSV,3,1,11')))


HEADER = '%  {}            latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  age(s)  ratio'
ROW = '   48.123456789   11.987654321   512.3456   1   9   0.0102   0.0111   0.0222   0.00   31.5'


@pytest.mark.parametrize('system, time, expected', [
    ('GPST', '2024/05/01 12:00:18.250', utc(2024, 5, 1, 12) + 250_000_000),
    ('UTC ', '2024/05/01 12:00:18.250', utc(2024, 5, 1, 12, 0, 18) + 250_000_000),
    ('GPST', '2312 302418.250', utc(2024, 5, 1, 12) + 250_000_000),
    ('GPST', '2012/07/01 00:00:16.000', utc(2012, 7, 1))])
def test_rtklib(tmp_path, system, time, expected):
    reference = read_reference(write(tmp_path, 'drive.pos', '% program   : RTKPOST ver.2.4.3', HEADER.format(system),
                                     f'{time}{ROW}'))
    assert reference.stamp.tolist() == [expected]
    assert np.degrees(reference.latitude[0]) == pytest.approx(48.123456789, rel=1e-14)
    assert np.degrees(reference.longitude[0]) == pytest.approx(11.987654321, rel=1e-14)
    assert reference.height[0] == 512.3456 and reference.velocity is None


def test_rtklib_with_velocity(tmp_path):
    reference = read_reference(write(tmp_path, 'drive.pos', HEADER.format('UTC') + ' vn(m/s) ve(m/s) vu(m/s)',
                                     f'2024/05/01 12:00:00.000{ROW} 1.5 -2.5 0.25'))
    assert reference.velocity.tolist() == [[1.5, -2.5, -0.25]]


def test_bad_references_are_told_in_one_line(tmp_path):
    for lines, expected in (
            (('',), 'is empty'), (('a,b', '1,2'), 'no column that looks like time'),
            (('time,speed', '1,2'), 'latitude and longitude, or east and north; its columns are time, speed'),
            (('time,lat,lon', '1,,'), 'holds no valid position'),
            ((HEADER.format('GPST').replace('latitude(deg)', 'x-ecef(m)'),), 'no RTKLIB header'),
            ((HEADER.format('GPST'), f'2024/05/01 noon{ROW}'), "line 2: '2024/05/01 noon' is not a time"),
            ((HEADER.format('GPST'), '2024/05/01 12:00:00 48 11'), 'line 2: 4 cells instead of')):
        path = write(tmp_path, 'bad.txt', *lines)
        with pytest.raises(RecordingError) as caught:
            read_reference(path)
        assert expected in str(caught.value) and '\n' not in str(caught.value) and 'bad.txt' in str(caught.value)
    with pytest.raises(RecordingError, match='cannot read'):
        read_reference(tmp_path / 'none.csv')
