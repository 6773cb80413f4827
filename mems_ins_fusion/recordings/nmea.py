"""Positions from NMEA 0183 logs."""
from __future__ import annotations

from datetime import datetime
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.tables import read_text
from mems_ins_fusion.samples import SECOND

_DAY = 86_400 * SECOND


class NmeaFixes(NamedTuple):
    """stamp: (n,) ns, UTC. latitude, longitude: (n,) rad. height: (n,) m above the ellipsoid. quality: (n,) of GGA: 1
    GPS, 2 differential, 4 RTK fixed, 5 RTK float. hdop: (n,), NaN where unknown."""

    stamp: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    quality: np.ndarray
    hdop: np.ndarray


def read_nmea(path) -> NmeaFixes:
    """Positions of GGA sentences (without any, of RMC), dated by RMC or ZDA. Sentences with a wrong checksum are
    skipped.

    Raises RecordingError with one line for the user.
    """
    fixes: dict[str, list] = {'GGA': [], 'RMC': []}
    day = first_day = None
    for line in read_text(path, 'ascii', 'replace').splitlines():
        fields = _nmea_fields(line)
        kind = fields[0][-3:] if fields else ''
        try:
            if kind == 'RMC' and len(fields) > 9 and fields[9]:
                day = _plausible_day(datetime.strptime(fields[9], '%d%m%y'))
                if fields[2] == 'A':
                    fixes['RMC'].append((day, time_of_day(fields[1]), *_nmea_position(fields[3:7]), np.nan, 1,
                                         np.nan))
            elif kind == 'ZDA' and len(fields) > 4 and fields[4]:
                day = _plausible_day(datetime(int(fields[4]), int(fields[3]), int(fields[2])))
            elif kind == 'GGA' and len(fields) > 11 and fields[6] not in ('', '0'):
                height = float(fields[9] or 'nan') + float(fields[11] or 0.0)
                fixes['GGA'].append((day, time_of_day(fields[1]), *_nmea_position(fields[2:6]), height,
                                     int(fields[6]), float(fields[8] or 'nan')))
        except ValueError:
            continue  # a garbled sentence
        first_day = first_day or day
    found = fixes['GGA'] or fixes['RMC']
    if not found:
        raise RecordingError(f'{path} holds no GGA or RMC sentence with a position')
    if first_day is None:
        raise RecordingError(f'{path} holds no date: GGA sentences need RMC or ZDA beside them')
    stamps = _nmea_stamps([(fix[0] or first_day, fix[1]) for fix in found])
    latitude, longitude, height, quality, hdop = np.array([fix[2:] for fix in found]).T
    return NmeaFixes(stamps, np.radians(latitude), np.radians(longitude), height, quality.astype(int), hdop)


def _plausible_day(day: datetime) -> datetime:
    if not 1980 <= day.year < 2038:
        raise ValueError
    return day


def _nmea_fields(line) -> list[str]:
    """The fields of a sentence; none where its checksum is wrong."""
    body, star, checksum = line.strip().lstrip('$').partition('*')
    if star:
        expected = 0
        for byte in body.encode():
            expected ^= byte
        if checksum[:2].upper() != f'{expected:02X}':
            return []
    return body.split(',')


def _nmea_position(fields):
    """Latitude and longitude, degrees, of ddmm.mmm, N or S, dddmm.mmm, E or W."""
    latitude = int(fields[0][:2]) + float(fields[0][2:]) / 60
    longitude = int(fields[2][:3]) + float(fields[2][3:]) / 60
    return -latitude if fields[1] == 'S' else latitude, -longitude if fields[3] == 'W' else longitude


def _nmea_stamps(times) -> np.ndarray:
    """Stamps of (day, time of day). The day is that of an earlier sentence: midnight may lie between."""
    stamps: list[int] = []
    for day, time in times:
        stamp = epoch_seconds(day) * SECOND + time
        if stamps:
            days = -((stamp - stamps[-1] + _DAY // 2) // _DAY)
            stamp += max(days, 0) * _DAY
        stamps.append(stamp)
    return np.array(stamps, np.int64)


def time_of_day(text) -> int:
    """ns since midnight of hhmmss.sss."""
    whole, _, fraction = text.partition('.')
    seconds = int(whole[:2]) * 3600 + int(whole[2:4]) * 60 + int(whole[4:6])
    return seconds * SECOND + int((fraction + '0' * 9)[:9])


def epoch_seconds(day: datetime) -> int:
    return (day - datetime(1970, 1, 1)).days * 86400
