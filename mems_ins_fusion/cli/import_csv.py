"""`import_csv`: an IMU log and a GNSS log in CSV to a recording."""
from __future__ import annotations

import argparse

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.recordings.tables import TIME_UNITS

DESCRIPTION = """\
Turn an IMU log and a GNSS log in CSV into a rosbag2 that every tool here reads.

Columns are found by their usual names (time, ax, acc_x, accel_x, ..., wx, gyro_x, ..., latitude, lat, ...); others are
named with --imu-columns and --gnss-columns, in files without names by their numbers from 1. Units stand in brackets in
the names (acc_x [g]) or are given as options. Times of both files must be of one clock.

Samples are turned to base_link (forward, left, up), so that imu.mounting_rpy is 0."""


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    return run(_parser(), lambda options: '\n'.join(import_csv(options)), argv)


def import_csv(options: argparse.Namespace):
    """Do what `options` ask for; yields lines that say what was done and what the bag checker found."""
    from mems_ins_fusion.recordings import csv_import
    from mems_ins_fusion.recordings.checker import INFO, check_recording
    from mems_ins_fusion.recordings.reference_files import read_reference
    from mems_ins_fusion.recordings.writing import write_recording
    from mems_ins_fusion.samples import Recording

    imu, temperature, text = csv_import.read_imu(
        options.imu, csv_import.parse_columns(options.imu_columns, csv_import.IMU_COLUMNS), options.imu_axes,
        options.imu_time_unit, options.acceleration_unit, options.gyro_unit)
    yield text
    fixes = velocity = speed = None
    if options.gnss:
        fixes, text = csv_import.read_gnss(
            options.gnss, csv_import.parse_columns(options.gnss_columns, csv_import.GNSS_COLUMNS),
            options.gnss_time_unit, options.angle_unit, options.gnss_sigma)
        yield text
        velocity = csv_import.read_velocity(
            options.gnss, csv_import.parse_columns(options.gnss_columns, csv_import.GNSS_COLUMNS),
            options.gnss_time_unit)
        if velocity is not None:
            velocity, text = velocity
            yield text
    if options.speed:
        speed, text = csv_import.read_speed(
            options.speed, csv_import.parse_columns(options.speed_columns, csv_import.SPEED_COLUMNS),
            options.speed_time_unit)
        yield text
    reference = read_reference(options.reference) if options.reference else None
    recording = Recording('imported', imu, fixes, reference, temperature, speed, velocity)
    findings = [finding for finding in check_recording(recording) if finding.severity != INFO]
    if any('do not overlap' in finding.message for finding in findings):
        raise ValueError(f'{options.imu} and {options.gnss}: {findings[-1].message}')
    write_recording(recording, options.output, options.storage, imu_topic=options.imu_topic,
                    gnss_topic=options.gnss_topic, imu_frame='base_link', overwrite=options.overwrite)
    yield f'{options.output}: written, ' + ', '.join(
        f'{len(samples)} on {topic}' for topic, samples in (
            (options.imu_topic, imu), (options.gnss_topic, fixes), ('/wheel/speed', speed), ('/gps/velocity', velocity))
        if samples is not None)
    for finding in findings:
        yield f'{finding.severity}: {finding.topic}: {finding.message}'


def _parser() -> Parser:
    parser = Parser('import_csv', DESCRIPTION)
    add = parser.add_argument
    add('--imu', required=True, metavar='FILE', help='CSV with time, specific force and angular rate')
    add('--gnss', metavar='FILE', help='CSV with time, latitude, longitude and, if there, height and sigma')
    add('--speed', metavar='FILE', help='CSV with time and speed of the rear axle, to /wheel/speed')
    add('--reference', metavar='FILE', help='reference trajectory: CSV, NMEA or RTKLIB .pos, to /reference/fix')
    add('--output', required=True, metavar='BAG', help='folder of the rosbag2 to write')
    parser.add_overwrite()
    add('--storage', choices=('mcap', 'sqlite3'), default='mcap')
    add('--imu-axes', default='forward left up', metavar='"X Y Z"',
        help='where the sensor\'s x, y and z point: three of forward, back, left, right, up, down '
        '(default "%(default)s")')
    add('--imu-columns', default='', metavar='NAME=COLUMN,...',
        help='names: time, ax, ay, az, wx, wy, wz, temperature')
    add('--gnss-columns', default='', metavar='NAME=COLUMN,...',
        help='names: time, latitude, longitude, height, sigma; north, east, down (velocity, to /gps/velocity), '
        'velocity_sigma')
    add('--speed-columns', default='', metavar='NAME=COLUMN,...', help='names: time, speed, sigma')
    add('--imu-time-unit', choices=TIME_UNITS, help='default: by name or intervals')
    add('--gnss-time-unit', choices=TIME_UNITS, help='default: by name or intervals')
    add('--speed-time-unit', choices=TIME_UNITS, help='default: by name or intervals')
    add('--acceleration-unit', choices=('m/s^2', 'g', 'mg'), help='default: by name, else m/s^2')
    add('--gyro-unit', choices=('rad/s', 'deg/s'), help='default: by name, else rad/s')
    add('--angle-unit', choices=('deg', 'rad'), help='of latitude and longitude (default: by name, else deg)')
    add('--gnss-sigma', type=float, default=2.5, metavar='M',
        help='horizontal standard deviation of a fix where no column states it (default %(default)g)')
    add('--imu-topic', default='/imu/data', metavar='TOPIC')
    add('--gnss-topic', default='/gps/fix', metavar='TOPIC')
    return parser
