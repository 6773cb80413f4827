"""`import_csv`: converts an IMU log and a GNSS log in CSV to a recording."""
from __future__ import annotations

import argparse
import math
import shlex
from pathlib import Path

import numpy as np

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.errors import InputError
from mems_ins_fusion.recordings.log_formats import FORMATS
from mems_ins_fusion.recordings.tables import TIME_UNITS

DESCRIPTION = """\
Turn an IMU log and a GNSS log into a rosbag2 that every tool here reads: CSV, NMEA, the exports of ArduPilot, PX4,
phyphox and Sensor Logger, the text files of KF-GINS.

Columns are found by their usual names (time, ax, acc_x, accel_x, ..., wx, gyro_x, ..., latitude, lat, ...); others are
named with --imu-columns and --gnss-columns, in files without names by their numbers from 1. Units stand in brackets in
the names (acc_x [g]) or are given as options. Times of both files must be of one clock. What is missing is named all at
once, with the options that would fit.

Where --imu-axes or the preset gives the axes, samples are turned to base_link (forward, left, up), and imu.mounting_rpy
is 0. Those of a phone stay as they are: configure finds how it was mounted."""
#: parameters that `configure`, the next command, sets: what the checker finds of these is not wrong yet
_SET_BY_CONFIGURE = frozenset(('imu.mounting_rpy', 'gnss.time_offset'))


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    return run(_parser(), lambda options: '\n'.join(import_csv(options)), argv)


def import_csv(options: argparse.Namespace):
    """Convert the files in `options`; yields lines on what was done and what the bag checker found."""
    from mems_ins_fusion.configuration.check import check
    from mems_ins_fusion.filter.measurements.registry import TYPES
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.recordings import csv_columns, csv_import
    from mems_ins_fusion.recordings.checker import INFO
    from mems_ins_fusion.recordings.reference_files import read_reference
    from mems_ins_fusion.recordings.writing import write_recording
    from mems_ins_fusion.reports.answer import typed
    from mems_ins_fusion.samples import Recording, Twists

    formats = _formats(options)
    for name in dict.fromkeys(filter(None, formats.values())):
        yield f'read as {name} ({FORMATS[name].about}); --preset none turns that off'
    imu_options, gnss_options = (_with_preset(options, kind, formats[kind]) for kind in ('imu', 'gnss'))
    imu, temperature, text = csv_import.read_imu(
        options.imu, imu_options['columns'], options.imu_axes or imu_options.get('axes', 'forward left up'),
        options.imu_time_unit, options.acceleration_unit, options.gyro_unit,
        increments=options.increments or imu_options.get('increments', False), rows=imu_options.get('rows'),
        gyro=options.gyro, gravity=options.gravity)
    yield text
    fixes, aided = None, {}
    if options.gnss:
        columns, time_unit, of_imu = gnss_options['columns'], options.gnss_time_unit, False
        if Path(options.gnss).resolve() == Path(options.imu).resolve():  # one log of both, with one time
            of_imu, time_unit = not gnss_options.get('rows'), time_unit or options.imu_time_unit
            columns = {**{name: column for name, column in imu_options['columns'].items() if name == 'time'}, **columns}
        fixes, text = csv_import.read_gnss(options.gnss, columns, time_unit, options.angle_unit, options.gnss_sigma,
                                           rows=gnss_options.get('rows'), of_imu=of_imu)
        yield text
        velocity = csv_import.read_velocity(options.gnss, columns, time_unit, rows=gnss_options.get('rows'),
                                            of_imu=of_imu)
        if velocity is not None:
            aided['velocity'], text = velocity
            yield text
    if options.speed:
        speed, text = csv_import.read_speed(
            options.speed, csv_columns.parse_columns(options.speed_columns, csv_columns.SPEED_COLUMNS),
            options.speed_time_unit)
        aided['twist' if isinstance(speed, Twists) else 'speed'] = speed
        yield text
    if options.pressure:
        aided['pressure'], text = csv_import.read_pressure(
            options.pressure, csv_columns.parse_columns(options.pressure_columns, csv_columns.PRESSURE_COLUMNS),
            options.pressure_time_unit)
        yield text
    if options.magnetometer:
        aided['magnetometer'], text = csv_import.read_magnetometer(
            options.magnetometer,
            csv_columns.parse_columns(options.magnetometer_columns, csv_columns.MAGNETOMETER_COLUMNS),
            options.imu_axes or imu_options.get('axes', 'forward left up'), options.magnetometer_time_unit)
        yield text
    reference = read_reference(options.reference, _datum(options, fixes)) if options.reference else None
    recording = Recording('imported', imu, fixes, reference, temperature).having(aided)
    findings = [finding for finding in check(recording, table.defaults()) if finding.severity != INFO]
    for finding in findings:
        if 'do not overlap' in finding.message:
            raise InputError(f'{options.imu} and {options.gnss}: {finding.message}')
    write_recording(recording, options.output, options.storage, imu_topic=options.imu_topic,
                    gnss_topic=options.gnss_topic, imu_frame='base_link', overwrite=options.overwrite)
    yield f'{options.output}: written, ' + ', '.join(
        f'{len(samples)} on {topic}' for topic, samples in (
            (options.imu_topic, imu), (options.gnss_topic, fixes),
            *((TYPES[name].written_to, samples) for name, samples in aided.items()))
        if samples is not None)
    for finding in findings:
        said = finding.message.replace('see imu.acceleration_unit', 'see --acceleration-unit')
        said = f"{finding.topic}: {said.replace('see imu.rate_unit', 'see --gyro-unit')}"
        if fixes is not None and finding.settings and _SET_BY_CONFIGURE.issuperset(finding.settings):
            yield f'note: {said} (configure does)'
        else:
            yield f'{finding.severity}: {said}'
    tool, result = ('characterize', 'imu') if fixes is None else ('configure', 'my_car.yaml')
    yield from typed(f'next: python -m mems_ins_fusion {tool} --bag {shlex.quote(str(options.output))} '
                     f'--output {result}')


def _formats(options) -> dict[str, str | None]:
    """The preset for the IMU's and for the receiver's file: as in `options`, or found from the files.

    If --imu is the folder of an export, its files are written to `options`.
    """
    from mems_ins_fusion.recordings.log_formats import files_in, recognised
    from mems_ins_fusion.recordings.tables import read_table, read_text

    name = options.preset
    if name == 'none':
        return {'imu': None, 'gnss': None}
    if Path(options.imu).is_dir():
        name, paths = files_in(Path(options.imu), name)
        options.imu = str(paths['imu'])
        for option in ('gyro', 'gravity', 'gnss'):
            if getattr(options, option) is None and option in paths:
                setattr(options, option, str(paths[option]))
    if name is not None:
        return {'imu': name, 'gnss': name}
    found: dict[str, str | None] = {}
    for kind in ('imu', 'gnss'):
        path = getattr(options, kind)
        named = path is None or getattr(options, f'{kind}_columns')
        is_known = named or read_text(path, 'utf-8', 'replace')[:1] == '$'
        found[kind] = None if is_known else recognised(read_table(path).names)
    return found


def _with_preset(options, kind: str, preset: str | None) -> dict:
    """The options of the file `kind`, imu or gnss: those that are given, else those of the preset."""
    from mems_ins_fusion.recordings import csv_columns

    found = dict(getattr(FORMATS[preset], kind)) if preset else {}
    names = {'imu': csv_columns.IMU_COLUMNS, 'gnss': csv_columns.GNSS_COLUMNS}[kind]
    given = csv_columns.parse_columns(getattr(options, f'{kind}_columns'), names)
    rows = getattr(options, f'{kind}_rows')
    if rows is not None:
        column, equals, value = rows.partition('=')
        if not equals:
            raise InputError(f"--{kind}-rows must be COLUMN=VALUE, got '{rows}'")
        found['rows'] = column, value
    return {**found, 'columns': {**found.get('columns', {}), **given}}


def _datum(options, fixes) -> tuple[float, float, float] | None:
    """Origin of a reference in local coordinates: --datum, else the first fix; rad, rad, m."""
    from mems_ins_fusion.filter.measurements.position import is_fix

    if options.datum:
        latitude, longitude, height = options.datum
        return math.radians(latitude), math.radians(longitude), height
    valid = np.flatnonzero(is_fix(fixes)) if fixes is not None else ()
    if not len(valid):
        return None
    first = valid[0]
    return float(fixes.latitude[first]), float(fixes.longitude[first]), float(fixes.height[first])


def _parser() -> Parser:
    parser = Parser('import_csv', DESCRIPTION)
    add = parser.add_argument
    add('--imu', required=True, metavar='FILE', help='CSV with time, specific force and angular rate; or the folder of '
        'an export of phyphox or Sensor Logger')
    add('--gyro', metavar='FILE', help='CSV with time and angular rate, where they have a file of their own')
    add('--gravity', metavar='FILE', help='CSV with time and gravity, where the accelerometer of a phone has it '
        'removed')
    add('--gnss', metavar='FILE', help='CSV with time, latitude, longitude and, if there, height, sigma or HDOP, '
        'status, velocity; or NMEA')
    add('--preset', choices=(*FORMATS, 'none'), help='what wrote the files (default: by the names of their columns)')
    add('--speed', metavar='FILE', help='CSV with time and speed of the rear axle, to /wheel/speed; with a turn rate, '
        'left positive, to /wheel/odometry')
    add('--pressure', metavar='FILE', help='CSV with time and pressure of the air, to /pressure')
    add('--magnetometer', metavar='FILE', help='CSV with time and magnetic field in the axes of the IMU, to /imu/mag')
    add('--reference', metavar='FILE', help='reference trajectory: CSV, TUM, KF-GINS, NMEA or RTKLIB .pos, to '
        '/reference/fix')
    add('--datum', type=float, nargs=3, metavar=('LAT', 'LON', 'H'), help='deg, deg, m: origin of a reference in local '
        'coordinates (default: the first fix)')
    add('--output', required=True, metavar='BAG', help='folder of the rosbag2 to write')
    parser.add_overwrite()
    add('--storage', choices=('mcap', 'sqlite3'), default='mcap')
    add('--imu-axes', metavar='"X Y Z"', help='where the sensor\'s x, y and z point: three of forward, back, left, '
        'right, up, down (default: that of the preset, else "forward left up")')
    add('--imu-columns', default='', metavar='NAME=COLUMN,...',
        help='names: time, ax, ay, az, wx, wy, wz, temperature')
    add('--gnss-columns', default='', metavar='NAME=COLUMN,...',
        help='names: time, latitude, longitude, height, sigma, vertical_sigma, hdop, status; north, east, down '
        '(velocity, to /gps/velocity), velocity_sigma')
    add('--imu-rows', metavar='COLUMN=VALUE', help='only these rows, such as I=0 of several IMUs')
    add('--gnss-rows', metavar='COLUMN=VALUE', help='only these rows')
    add('--increments', action='store_true', help='the columns are increments of velocity and angle')
    add('--speed-columns', default='', metavar='NAME=COLUMN,...', help='names: time, speed, turn_rate, sigma')
    add('--pressure-columns', default='', metavar='NAME=COLUMN,...', help='names: time, pressure')
    add('--magnetometer-columns', default='', metavar='NAME=COLUMN,...', help='names: time, mx, my, mz')
    for kind in ('imu', 'gnss', 'speed', 'pressure', 'magnetometer'):
        add(f'--{kind}-time-unit', choices=TIME_UNITS, help='default: by name or intervals')
    add('--acceleration-unit', choices=('m/s^2', 'g', 'mg'), help='default: by name, else m/s^2')
    add('--gyro-unit', choices=('rad/s', 'deg/s'), help='default: by name, else rad/s')
    add('--angle-unit', choices=('deg', 'rad', '1e-7 deg'), help='of latitude and longitude (default: by name, else '
        'deg, or 1e-7 deg where they are beyond 360)')
    add('--gnss-sigma', type=float, default=2.5, metavar='M',
        help='horizontal standard deviation of a fix where no column states it (default %(default)g)')
    add('--imu-topic', default='/imu/data', metavar='TOPIC')
    add('--gnss-topic', default='/gps/fix', metavar='TOPIC')
    return parser
