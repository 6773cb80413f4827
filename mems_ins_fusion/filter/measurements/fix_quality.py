"""Fixes in messages that tell their quality: each becomes the fields of a NavSatFix, with the class of its noise as
`status`. 2: a solution with fixed ambiguities, to a base; 1: with float ones, or differential corrections, or with
corrections that are old; 0: none of these; -1: no fix.
"""
from __future__ import annotations

import math

import numpy as np

from ...samples import SECOND

GPS_FIX = 'gps_msgs/msg/GPSFix'
PVT_GEODETIC = 'septentrio_gnss_driver/msg/PVTGeodetic'
NAV_PVT = 'ublox_msgs/msg/NavPVT'

#: m, standard deviation of a pseudorange: multiplied by the dilution of precision where a message states no other
#: error. Chosen, not measured
RANGE_SIGMA = 3.0
#: 95 % error over standard deviation of each of two components, of a horizontal distance
HORIZONTAL_95 = 2.4477
#: 95 % error over standard deviation of a height
VERTICAL_95 = 1.96
FEWEST_SATELLITES = 3  # a message with fewer satellites (but not zero: not counted) has no position
#: s, largest age of the corrections of a fix of class 2: satellite clocks and ionosphere add about a millimetre a
#: second, which then is as much as the noise of such a fix
OLDEST_CORRECTIONS = 10.0
#: class by `GPSStatus.status`
STATUS_OF = {-1: -1, 0: 0, 1: 1, 33: 1, 18: 1, 20: 1, 2: 2, 19: 2}
#: class by the lowest four bits of `PVTGeodetic.mode` (SBF reference guide): differential, fixed, float, SBAS, PPP. A
#: base that moves (7, 8) knows its own place no better than a single receiver
_MODES = {0: -1, 2: 1, 4: 2, 5: 1, 6: 1, 10: 1}
_NOT_COUNTED = 255  # number of satellites in PVTGeodetic that says that it is unknown
_UNKNOWN = 65535  # the same of its other numbers of 16 bits
#: m, standard deviations of a component per unit of `h_accuracy` (2DRMS, cm) and of `v_accuracy` (two sigma, cm)
_PER_H_ACCURACY, _PER_V_ACCURACY = 0.01 / (2.0 * math.sqrt(2.0)), 0.01 / 2.0
_HAS_UTC = 0b111  # bits of `NavPVT.valid`: date, time, and no second in doubt
_FIX_OK, _DIFFERENTIAL = 0b1, 0b10  # bits of `NavPVT.flags`; its highest two are 1 for float, 2 for fixed
_FIX_TYPES = 2, 3, 4  # `NavPVT.fix_type` with a position: 2D, 3D, with dead reckoning
#: smallest `lastCorrectionAge` (bits 1 to 4 behind `NavPVT.p_dop`) of more than OLDEST_CORRECTIONS; 0: unknown
_OLD_CODE = 5
_INVALID = 0b1  # bit of the same byte, `invalidLlh`: latitude, longitude and height are not to be used

#: fields that are needed of each
FIELDS = {
    GPS_FIX: ('status.status', 'status.satellites_used', 'latitude', 'longitude', 'altitude', 'position_covariance',
              'position_covariance_type', 'err_horz', 'err_vert', 'hdop', 'vdop'),
    PVT_GEODETIC: ('mode', 'error', 'latitude', 'longitude', 'height', 'nr_sv', 'mean_corr_age', 'h_accuracy',
                   'v_accuracy'),
    NAV_PVT: ('year', 'month', 'day', 'hour', 'min', 'sec', 'valid', 'nano', 'fix_type', 'flags', 'num_sv', 'lon',
              'lat', 'height', 'h_acc', 'v_acc', 'reserved1')}


def as_nav_sat_fix(fields, message: str) -> dict[str, np.ndarray]:
    """`fields` of messages of the type `message`, (n,) each and with `stamp` and `received`, as those of NavSatFix."""
    return {**fields, **_CONVERTED[message](fields)} if message in _CONVERTED else fields


def _of_gps_fix(fields):
    """The covariance is that of the message, or else computed from its 95 % errors, or else from its dilutions of
    precision."""
    status = np.array([STATUS_OF.get(int(one), 0) for one in fields['status.status']], dtype=np.int8)
    _refuse_few(status, fields['status.satellites_used'])
    covariance = np.array(fields['position_covariance'], dtype=float).reshape(-1, 9)
    kind = np.array(fields['position_covariance_type']).astype(np.uint8)
    missing = (kind == 0) | ~(covariance[:, [0, 4]] > 0).all(axis=1)
    for horizontal, vertical in ((fields['err_horz'] / HORIZONTAL_95, fields['err_vert'] / VERTICAL_95),
                                 (RANGE_SIGMA * fields['hdop'] / math.sqrt(2.0), RANGE_SIGMA * fields['vdop'])):
        filled = missing & np.isfinite(horizontal) & (horizontal > 0)
        covariance[filled], kind[filled] = _covariance(horizontal, vertical)[filled], 1
        missing &= ~filled
    kind[missing] = 0
    return {'status.status': status, 'position_covariance': covariance, 'position_covariance_type': kind}


def _of_pvt_geodetic(fields):
    status = np.array([_MODES.get(int(one) & 15, 0) for one in fields['mode']], dtype=np.int8)
    age = np.asarray(fields['mean_corr_age'], dtype=float)
    status[(status == 2) & (age != _UNKNOWN) & (0.01 * age > OLDEST_CORRECTIONS)] = 1
    satellites = np.asarray(fields['nr_sv'])
    _refuse_few(status, np.where(satellites == _NOT_COUNTED, 0, satellites))
    status[np.asarray(fields['error']) != 0] = -1
    horizontal, vertical = (np.where(fields[name] == _UNKNOWN, np.nan, per * np.asarray(fields[name], dtype=float))
                            for name, per in (('h_accuracy', _PER_H_ACCURACY), ('v_accuracy', _PER_V_ACCURACY)))
    return _filled(status, np.degrees(fields['latitude']), np.degrees(fields['longitude']), fields['height'],
                   horizontal, vertical)


def _of_nav_pvt(fields):
    """The message has no stamp: its UTC is taken, as its driver does for NavSatFix. Without UTC it is no fix. Its
    accuracies are taken for standard deviations, as its driver does."""
    flags, reserved = (np.asarray(fields[name]).astype(int) for name in ('flags', 'reserved1'))
    more = reserved[:, 0]  # `flags3` of later receivers
    ambiguities = flags >> 6
    status = np.where(ambiguities == 2, 2, (ambiguities == 1) | (flags & _DIFFERENTIAL > 0)).astype(np.int8)
    status[(status == 2) & (more >> 1 & 15 >= _OLD_CODE)] = 1
    _refuse_few(status, np.asarray(fields['num_sv']))
    known = np.asarray(fields['valid']).astype(int) & _HAS_UTC == _HAS_UTC
    has_position = (flags & _FIX_OK > 0) & (more & _INVALID == 0) & np.isin(fields['fix_type'], _FIX_TYPES)
    status[~known | ~has_position] = -1
    return {**_filled(status, 1e-7 * np.asarray(fields['lat'], dtype=float),
                      1e-7 * np.asarray(fields['lon'], dtype=float), 1e-3 * np.asarray(fields['height'], dtype=float),
                      *(1e-3 * np.asarray(fields[name], dtype=float) for name in ('h_acc', 'v_acc'))),
            'stamp': np.where(known, _utc(fields), fields['stamp'])}


def _utc(fields) -> np.ndarray:
    """(n,) int64 ns since the epoch."""
    year, month, day, hour, minute, second, nano = (np.asarray(fields[name]).astype(np.int64) for name in (
        'year', 'month', 'day', 'hour', 'min', 'sec', 'nano'))
    months = (12 * (year - 1970) + month - 1).astype('datetime64[M]')
    days = months.astype('datetime64[D]').astype(np.int64) + day - 1
    return (((24 * days + hour) * 60 + minute) * 60 + second) * SECOND + nano


def _refuse_few(status, satellites) -> None:
    status[(satellites > 0) & (satellites < FEWEST_SATELLITES)] = -1


def _covariance(horizontal, vertical) -> np.ndarray:
    """(n, 9) m^2 of standard deviations, m; of an unknown height twice the horizontal one."""
    covariance = np.zeros((len(horizontal), 9))
    covariance[:, 0] = covariance[:, 4] = np.square(horizontal)
    covariance[:, 8] = np.square(np.where(np.isfinite(vertical) & (vertical > 0), vertical, 2.0 * horizontal))
    return covariance


def _filled(status, latitude, longitude, altitude, horizontal, vertical):
    """Fields of NavSatFix; deg, m, and standard deviations, m."""
    stated = np.isfinite(horizontal) & (horizontal > 0)
    return {'status.status': status, 'latitude': latitude, 'longitude': longitude,
            'altitude': np.asarray(altitude, dtype=float),
            'position_covariance': _covariance(np.where(stated, horizontal, 0.0), vertical),
            'position_covariance_type': stated.astype(np.uint8)}


_CONVERTED = {GPS_FIX: _of_gps_fix, PVT_GEODETIC: _of_pvt_geodetic, NAV_PVT: _of_nav_pvt}
