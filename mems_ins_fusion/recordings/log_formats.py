"""Presets of the options of `import_csv` for the files of well-known loggers.

A preset is a dictionary of these options, by the names they have in `csv_import` and on the command line (`imu_columns`
is `--imu-columns`). What a user gives counts more. Sources: ArduPilot's AP_Logger and `mavlogdump.py --format csv`;
PX4's `ulog2csv`; the exports of phyphox and Sensor Logger; the u-blox interface description, UBX-NAV-PVT; the README of
KF-GINS (github.com/i2Nav-WHU/KF-GINS).
"""
from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.tables import read_table

_FRD = 'forward right down'


@dataclass(frozen=True)
class LogFormat:
    """imu, gnss: options for these files. signs: sets of columns of a file by which the format is recognized.
    files: by option, the names that its files have in the folder of an export, the best first."""

    about: str
    imu: dict = field(default_factory=dict)
    gnss: dict = field(default_factory=dict)
    signs: tuple[tuple[str, ...], ...] = ()
    files: dict[str, tuple[str, ...]] = field(default_factory=dict)


def _axes(prefix: str, names) -> dict[str, str]:
    return {f'{prefix}{axis}': name for axis, name in zip('xyz', names)}


FORMATS = {
    'ardupilot': LogFormat(
        'ArduPilot dataflash logs by mavlogdump.py --format csv --types IMU (and GPS): the first IMU of several',
        imu={'columns': {'time': 'TimeUS [us]|TimeMS [ms]', **_axes('a', ('AccX', 'AccY', 'AccZ')),
                         **_axes('w', ('GyrX', 'GyrY', 'GyrZ')), 'temperature': 'T|'},
             'axes': _FRD, 'rows': ('I', '0')},
        # logs before 2015: TimeMS, which of the fixes is that of the week; T is that of the IMU
        gnss={'columns': {'time': 'TimeUS [us]|T [ms]', 'latitude': 'Lat', 'longitude': 'Lng', 'height': 'Alt',
                          'hdop': 'HDop|', 'status': 'Status|'}, 'rows': ('I', '0')},
        signs=(('TimeUS', 'GyrX', 'AccX'), ('TimeUS', 'HDop', 'Lat', 'Lng'), ('TimeMS', 'GyrX', 'AccX'),
               ('TimeMS', 'T', 'HDop', 'Lat', 'Lng'))),
    'px4': LogFormat(
        'PX4 logs by ulog2csv: sensor_combined, and vehicle_gps_position or sensor_gps',
        imu={'columns': {'time': 'timestamp [us]', **_axes('a', (f'accelerometer_m_s2[{i}]' for i in range(3))),
                         **_axes('w', (f'gyro_rad[{i}]' for i in range(3)))}, 'axes': _FRD},
        gnss={'columns': {'time': 'timestamp [us]', 'latitude': 'latitude_deg|lat', 'longitude': 'longitude_deg|lon',
                          'height': 'altitude_ellipsoid_m|alt_ellipsoid|altitude_msl_m|alt', 'sigma': 'eph [m]|',
                          'vertical_sigma': 'epv [m]|', 'status': 'fix_type|', 'north': 'vel_n_m_s [m/s]|',
                          'east': 'vel_e_m_s [m/s]|', 'down': 'vel_d_m_s [m/s]|',
                          'velocity_sigma': 's_variance_m_s [m/s]|'}},
        signs=(('timestamp', 'gyro_rad[0]', 'accelerometer_m_s2[0]'), ('timestamp', 'fix_type', 'eph', 'vel_n_m_s'))),
    'phyphox': LogFormat(
        'phyphox, exported as CSV (comma or tabulator, decimal point): the folder with Accelerometer.csv, '
        'Gyroscope.csv and Location.csv',
        gnss={'columns': {'height': 'Altitude WGS84 (m)|Height (m)|Altitude (m)|'}},
        signs=(('Time (s)', 'Latitude (°)', 'Horizontal Accuracy (m)'),),
        files={'imu': ('Accelerometer.csv', 'Acceleration.csv', 'Raw Data.csv'), 'gyro': ('Gyroscope.csv',),
               'gnss': ('Location.csv', 'Location (GPS).csv')}),
    'sensor_logger': LogFormat(
        'Sensor Logger, exported as CSV: the folder with TotalAcceleration.csv (or AccelerometerUncalibrated.csv, or '
        'Accelerometer.csv and Gravity.csv), Gyroscope.csv and Location.csv',
        imu={'columns': {'time': 'time [ns]'}}, gnss={'columns': {'time': 'time [ns]'}},
        signs=(('time', 'seconds_elapsed', 'z', 'y', 'x'), ('time', 'seconds_elapsed', 'horizontalAccuracy')),
        files={'imu': ('TotalAcceleration.csv', 'AccelerometerUncalibrated.csv', 'Accelerometer.csv'),
               'gravity': ('Gravity.csv',), 'gyro': ('Gyroscope.csv',), 'gnss': ('LocationGps.csv', 'Location.csv')}),
    'u-center': LogFormat(
        'UBX-NAV-PVT messages as CSV, by their field names; NMEA logs of u-center are read without a preset',
        gnss={'columns': {'latitude': 'lat', 'longitude': 'lon', 'height': 'height [mm]', 'sigma': 'hAcc [mm]',
                          'vertical_sigma': 'vAcc [mm]', 'status': 'fixType', 'north': 'velN [mm/s]',
                          'east': 'velE [mm/s]', 'down': 'velD [mm/s]', 'velocity_sigma': 'sAcc [mm/s]'}},
        signs=(('fixType', 'lat', 'lon', 'hAcc', 'velN'),)),
    'kf-gins': LogFormat(
        'text files of KF-GINS and the data sets of i2Nav: IMU with increments (7 columns), GNSS (7 or 13), truth (11)',
        imu={'columns': {'time': '1 [s]', **_axes('w', '234'), **_axes('a', '567')}, 'axes': _FRD, 'increments': True},
        gnss={'columns': {'time': '1 [s]', 'latitude': '2', 'longitude': '3', 'height': '4', 'sigma': '5 [m]|',
                          'vertical_sigma': '7 [m]|', 'north': '8|', 'east': '9|', 'down': '10|',
                          'velocity_sigma': '11|'}})}


def recognised(names: list[str]) -> str | None:
    """The format whose signs are among these names of columns; None where there is none."""
    there = set(names)
    return next((name for name, known in FORMATS.items() if any(there.issuperset(signs) for signs in known.signs)),
                None)


def files_in(folder: Path, preset: str | None) -> tuple[str, dict[str, Path]]:
    """The format that the files in an exported `folder` have, and they by option (imu, gravity, gyro, gnss).

    RecordingError where no format with files of their own has an IMU there.
    """
    formats = {preset: FORMATS[preset]} if preset else FORMATS
    found = {name: {option: next((folder / file for file in files if (folder / file).is_file()), None)
                    for option, files in known.files.items()} for name, known in formats.items()}
    # phyphox and Sensor Logger use the same file names: decide by the columns, else by the number of files found
    alike = {by_columns for paths in found.values() if paths.get('imu')
             and (by_columns := recognised(read_table(paths['imu']).names)) in found}
    name = max(alike or found, key=lambda name: sum(path is not None for path in found[name].values()))
    paths = {option: path for option, path in found[name].items() if path is not None}
    if paths.get('imu') != folder / 'Accelerometer.csv':
        paths.pop('gravity', None)  # is in the others already
    if 'imu' not in paths:
        wanted = ' or '.join(dict.fromkeys(file for known in formats.values() for file in known.files.get('imu', ())))
        raise RecordingError(f'{folder} holds no {wanted or "files that are known"}: name the file of the IMU')
    return name, paths
