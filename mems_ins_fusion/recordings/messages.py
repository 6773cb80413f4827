"""Layout of the messages in a recording: CDR bytes to NumPy structured arrays and back, a whole topic at once.

A message without sequences and with strings of known length has all its fields at fixed offsets, so that many of them,
joined, are one structured array. CDR: OMG DDSI-RTPS 2.3, section 10 (encapsulation header of four bytes, primitives
aligned to their size counted from behind it, strings with a 32-bit length that includes the final NUL).
"""
from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from functools import cache, reduce

import numpy as np

from mems_ins_fusion.filter.measurements.base import IMU, NAV_SAT_FIX, ODOMETRY, POSE, POSE_STAMPED, TWIST
from mems_ins_fusion.filter.measurements.fix_quality import GPS_FIX, NAV_PVT, PVT_GEODETIC
from mems_ins_fusion.filter.measurements.registry import AIDING
from mems_ins_fusion.recordings.errors import needs_rosbags
from mems_ins_fusion.samples import SECOND

TEMPERATURE = 'sensor_msgs/msg/Temperature'

_STRING = 'string'
_HEADER = (('header.stamp.sec', '<i4', 1), ('header.stamp.nanosec', '<u4', 1), ('header.frame_id', _STRING, 1))
_POSE = (('pose.pose.position', '<f8', 3), ('pose.pose.orientation', '<f8', 4), ('pose.covariance', '<f8', 36))
_TWIST = (('twist.twist.linear', '<f8', 3), ('twist.twist.angular', '<f8', 3), ('twist.covariance', '<f8', 36))

#: type: (field, NumPy type of an element, number of elements), in the order of the definition
FIELDS = {
    IMU: (*_HEADER,
          ('orientation', '<f8', 4), ('orientation_covariance', '<f8', 9),
          ('angular_velocity', '<f8', 3), ('angular_velocity_covariance', '<f8', 9),
          ('linear_acceleration', '<f8', 3), ('linear_acceleration_covariance', '<f8', 9)),
    NAV_SAT_FIX: (*_HEADER,
                  ('status.status', 'i1', 1), ('status.service', '<u2', 1),
                  ('latitude', '<f8', 1), ('longitude', '<f8', 1), ('altitude', '<f8', 1),
                  ('position_covariance', '<f8', 9), ('position_covariance_type', 'u1', 1)),
    GPS_FIX: (*_HEADER, ('status.status', '<i2', 1), ('status.satellites_used', '<u2', 1),
              ('latitude', '<f8', 1), ('longitude', '<f8', 1), ('altitude', '<f8', 1),
              ('position_covariance', '<f8', 9), ('position_covariance_type', 'u1', 1),
              ('err_horz', '<f8', 1), ('err_vert', '<f8', 1), ('hdop', '<f8', 1), ('vdop', '<f8', 1)),
    PVT_GEODETIC: (*_HEADER, ('mode', 'u1', 1), ('error', 'u1', 1), ('latitude', '<f8', 1), ('longitude', '<f8', 1),
                   ('height', '<f8', 1), ('nr_sv', 'u1', 1), ('mean_corr_age', '<u2', 1), ('h_accuracy', '<u2', 1),
                   ('v_accuracy', '<u2', 1)),
    NAV_PVT: (('year', '<u2', 1), *((name, 'u1', 1) for name in ('month', 'day', 'hour', 'min', 'sec', 'valid')),
              ('nano', '<i4', 1), ('fix_type', 'u1', 1), ('flags', 'u1', 1), ('num_sv', 'u1', 1), ('lon', '<i4', 1),
              ('lat', '<i4', 1), ('height', '<i4', 1), ('h_acc', '<u4', 1), ('v_acc', '<u4', 1),
              ('reserved1', 'u1', 6)),
    TEMPERATURE: (*_HEADER, ('temperature', '<f8', 1), ('variance', '<f8', 1)),
    ODOMETRY: (*_HEADER, ('child_frame_id', _STRING, 1), *_POSE, *_TWIST),
    POSE_STAMPED: (*_HEADER, ('pose.position', '<f8', 3), ('pose.orientation', '<f8', 4)),
    POSE: (*_HEADER, *_POSE),
    TWIST: (*_HEADER, *_TWIST),
    **{kind: (*_HEADER, *fields) for measurement in AIDING for kind, fields in measurement.layouts.items()},
}


def _definition(fields: str) -> str:
    """A definition from its fields: a type and its names, those of several types between semicolons."""
    return '\n'.join(f'{kind} {name}' for kind, *names in map(str.split, fields.split(';')) for name in names)


#: definitions of types that rosbags does not know, by name; their messages are read one by one, as they are few and
#: some have sequences: of these FIELDS has what is kept
_DEFINITIONS = {
    'gps_msgs/msg/GPSStatus': """
std_msgs/Header header
uint16 satellites_used
int32[] satellite_used_prn
uint16 satellites_visible
int32[] satellite_visible_prn
int32[] satellite_visible_z
int32[] satellite_visible_azimuth
int32[] satellite_visible_snr
int16 status
uint16 motion_source
uint16 orientation_source
uint16 position_source
""",
    GPS_FIX: 'std_msgs/Header header\ngps_msgs/GPSStatus status\n' + ''.join(f'float64 {name}\n' for name in (
        'latitude', 'longitude', 'altitude', 'track', 'speed', 'climb', 'pitch', 'roll', 'dip', 'time', 'gdop', 'pdop',
        'hdop', 'vdop', 'tdop', 'err', 'err_horz', 'err_vert', 'err_track', 'err_speed', 'err_climb', 'err_time',
        'err_pitch', 'err_roll', 'err_dip')) + 'float64[9] position_covariance\nuint8 position_covariance_type\n',
    'septentrio_gnss_driver/msg/BlockHeader': _definition(
        'uint8 sync_1 sync_2; uint16 crc id; uint8 revision; uint16 length; uint32 tow; uint16 wnc'),
    PVT_GEODETIC: _definition(
        'std_msgs/Header header; septentrio_gnss_driver/BlockHeader block_header; uint8 mode error; '
        'float64 latitude longitude height; float32 undulation vn ve vu cog; float64 rx_clk_bias; float32 rx_clk_drift;'
        'uint8 time_system datum nr_sv wa_corr_info; uint16 reference_id mean_corr_age; uint32 signal_info; '
        'uint8 alert_flag nr_bases; uint16 ppp_info latency h_accuracy v_accuracy; uint8 misc'),
    NAV_PVT: _definition(
        'uint32 i_tow; uint16 year; uint8 month day hour min sec valid; uint32 t_acc; int32 nano; '
        'uint8 fix_type flags flags2 num_sv; int32 lon lat height h_msl; uint32 h_acc v_acc; '
        'int32 vel_n vel_e vel_d g_speed heading; uint32 s_acc head_acc; uint16 p_dop; uint8[6] reserved1; '
        'int32 head_veh; int16 mag_dec; uint16 mag_acc'),
}
_LITTLE_ENDIAN_CDR = 0x0001
_MAX_PADDING = 8  # bytes that a middleware may append
_LONGEST = 100_000  # bytes of a message, most of them a frame's name


def decode(raw: list[bytes], msgtype: str) -> tuple[np.ndarray, np.ndarray]:
    """Serialized messages of `msgtype` (one of FIELDS) as a structured array with the fields named in FIELDS.

    Also which of them it holds, (n,) bool: the others are not valid. In bulk where they have one layout, else one by
    one through rosbags.
    """
    array = _decode_bulk(raw, msgtype)
    if array is not None:
        return array, np.ones(len(raw), dtype=bool)
    sizes = np.array([len(data) for data in raw])
    kept = [field[0] for field in FIELDS[msgtype] if field[1] != _STRING]
    valid = np.zeros(len(raw), dtype=bool)
    parts, places = [], []
    for size in np.unique(sizes):  # texts of several lengths, or a few messages that are damaged
        mine = np.flatnonzero(sizes == size)
        group = [raw[i] for i in mine]
        array = _decode_bulk(group, msgtype)
        if array is None:
            array, good = _decode_each(group, msgtype)
            mine = mine[good]
        plain = np.zeros(len(array), _plain_dtype(msgtype))
        for name in kept:
            plain[name] = array[name]
        parts.append(plain)
        places.append(mine)
        valid[mine] = True
    return np.concatenate(parts)[np.argsort(np.concatenate(places), kind='stable')], valid


def encode(msgtype: str, values: dict, strings: dict[str, str]) -> list[memoryview]:
    """Serialized messages of `msgtype` from arrays over messages, (n,) or (n, elements).

    values: by the names in FIELDS; what is missing is zero. strings: header.frame_id and the like, one for all.
    """
    texts = {name: strings[name].encode() for name, kind, _ in FIELDS[msgtype] if kind == _STRING}
    sizes = iter([len(text) + 1 for text in texts.values()])
    dtype = _layout(msgtype, lambda offset: next(sizes))
    array = np.zeros(len(values['header.stamp.sec']), dtype)
    array['cdr'] = _LITTLE_ENDIAN_CDR
    for name, text in texts.items():
        array[name] = text
        array[f'{name}.size'] = len(text) + 1
    for name, value in values.items():
        array[name] = value
    data, size = memoryview(array.tobytes()), dtype.itemsize
    return [data[start:start + size] for start in range(0, len(data), size)]


def stamps(array: np.ndarray) -> np.ndarray:
    """Header stamps of decoded messages, (n,) int64 ns."""
    return array['header.stamp.sec'].astype(np.int64) * SECOND + array['header.stamp.nanosec']


def stamp_fields(stamp: np.ndarray) -> dict:
    """The fields of `encode` that carry header stamps, (n,) int64 ns."""
    return {'header.stamp.sec': stamp // SECOND, 'header.stamp.nanosec': stamp % SECOND}


def _layout(msgtype, string_size) -> np.dtype:
    """The structured dtype of one message; `string_size(offset)` tells the length of the string that starts there."""
    names, formats, offsets = ['cdr'], ['>u2'], [0]
    position = 4

    def place(name, kind, count):
        nonlocal position
        element = np.dtype(kind)
        alignment = 1 if element.kind == 'S' else element.itemsize
        position += (4 - position) % alignment
        names.append(name)
        formats.append(element if count == 1 else (element, count))
        offsets.append(position)
        position += element.itemsize * count

    for name, kind, count in FIELDS[msgtype]:
        if kind == _STRING:
            place(f'{name}.size', '<u4', 1)
            place(name, f'S{string_size(position - 4)}', 1)
        else:
            place(name, kind, count)
    return np.dtype({'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': position})


def _decode_bulk(raw, msgtype) -> np.ndarray | None:
    """All messages as one array, or None where they do not share one layout."""
    first = raw[0]
    if msgtype in _DEFINITIONS or len(set(map(len, raw))) > 1:
        return None
    try:
        dtype = _layout(msgtype, lambda offset: _string_size(first, offset))
    except (struct.error, ValueError):
        return None
    if not dtype.itemsize <= len(first) < dtype.itemsize + _MAX_PADDING:
        return None
    fields = {name: dtype.fields[name] for name in dtype.names}
    padded = np.dtype({'names': list(fields), 'formats': [f[0] for f in fields.values()],
                       'offsets': [f[1] for f in fields.values()], 'itemsize': len(first)})
    array = np.frombuffer(b''.join(raw), padded)
    same = (array['cdr'] == _LITTLE_ENDIAN_CDR).all() and all(
        (array[name] == array[name][0]).all() for name in dtype.names if name.endswith('.size'))
    return array if same else None


def _string_size(message, offset) -> int:
    size = struct.unpack_from('<I', message, offset)[0]
    if not 0 < size <= len(message):
        raise ValueError
    return size


def _plain_dtype(msgtype) -> np.dtype:
    """The fields of a message but its texts."""
    fields = [field for field in FIELDS[msgtype] if field[1] != _STRING]
    return np.dtype([(name, kind) if count == 1 else (name, kind, count) for name, kind, count in fields])


def _decode_each(raw, msgtype) -> tuple[np.ndarray, np.ndarray]:
    """The valid ones of the messages, one by one through rosbags' own deserialization, and which these are."""
    dtype = _plain_dtype(msgtype)
    array, valid = np.zeros(len(raw), dtype), np.zeros(len(raw), dtype=bool)
    for i, message in enumerate(deserialized(raw, msgtype)):
        if message is not None:
            for name in dtype.names:
                array[name][i] = _elements(reduce(getattr, name.split('.'), message))
            valid[i] = True
    return array[valid], valid


def deserialized(raw: Iterable[bytes], msgtype: str) -> Iterator:
    """Messages of any type one by one as rosbags has them, None for one that is not valid."""
    store = typestore()
    for data in raw:
        try:
            yield store.deserialize_cdr(data, msgtype) if len(data) <= _LONGEST else None
        except Exception:  # whatever rosbags stumbles over, the message is not of this type
            yield None


@cache
def typestore():
    """rosbags' types of ROS 2, and those of _DEFINITIONS."""
    with needs_rosbags('reading messages of varying layout'):
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def _elements(value):
    """The numbers in a message's field: a vector or quaternion as a list, anything else as it is."""
    return [getattr(value, axis) for axis in 'xyzw' if hasattr(value, axis)] if hasattr(value, 'x') else value
