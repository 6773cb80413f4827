"""CSV to recordings: columns, units, axes, times; judged by rosbags reading the result."""
from __future__ import annotations

import math

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from mems_ins_fusion.cli.import_csv import main
from mems_ins_fusion.filter.measurements.position import has_altitude
from mems_ins_fusion.recordings.csv_import import (
    axes_rotation,
    read_gnss,
    read_imu,
    read_magnetometer,
    read_pressure,
    read_speed,
    read_velocity,
)
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.reading import read_recording

G = 9.80665
T0 = 1_700_000_000


def write(path, header, rows, sign=','):
    path.write_text('\n'.join([header] * bool(header) + [sign.join(map(str, row)) for row in rows]) + '\n')
    return path


def imu_rows(count=300, start=T0, rate=100, force=(0.1, 0.2, G), turn=(0.01, 0.02, 0.03)):
    """Times with all their digits, and a constant with some noise."""
    generator = np.random.default_rng(0)
    noise = generator.normal(0, 1e-3, (count, 6))
    return [(f'{start + i // rate}.{i % rate * (10**9 // rate):09d}', *(noise[i] + [*force, *turn]))
            for i in range(count)]


def gnss_rows(count=3, start=T0):
    return [(start + i, 48.0 + 1e-7 * i, 11.0, 400.0 + i) for i in range(count)]


@pytest.fixture
def files(tmp_path):
    return (write(tmp_path / 'imu.csv', 'time,ax,ay,az,wx,wy,wz', imu_rows()),
            write(tmp_path / 'gnss.csv', 'time,latitude,longitude,height', gnss_rows()), tmp_path / 'bag')


def run(files, *options):
    imu, gnss, bag = files
    return main(['--imu', str(imu), '--gnss', str(gnss), '--output', str(bag), *options])


def test_two_files_become_a_recording(files, capsys):
    assert run(files) == 0
    output = capsys.readouterr()
    assert output.err == '' and 'written, 300 on /imu/data, 3 on /gps/fix' in output.out
    # and what comes next can be typed, on one line or more
    assert f'next: python -m mems_ins_fusion configure --bag {files[2]} --output my_car.yaml' in output.out.replace(
        ' \\\n   ', '')
    assert 'time=time, ax=ax' in output.out and 'in s, m/s^2, rad/s' in output.out
    with AnyReader([files[2]]) as reader:
        messages = [(c.topic, time, reader.deserialize(raw, c.msgtype)) for c, time, raw in reader.messages()]
    imu = [message for topic, _, message in messages if topic == '/imu/data']
    expected = imu_rows()
    for i in (0, 1, 299):
        assert (imu[i].header.stamp.sec, imu[i].header.stamp.nanosec) == (T0 + i // 100, i % 100 * 10**7)
        assert imu[i].linear_acceleration.z == expected[i][3] and imu[i].angular_velocity.x == expected[i][4]
    assert imu[0].header.frame_id == 'base_link'
    fix = next(message for topic, _, message in messages if topic == '/gps/fix')
    assert (fix.latitude, fix.longitude, fix.altitude) == pytest.approx((48.0, 11.0, 400.0), rel=1e-15)
    assert fix.position_covariance.reshape(3, 3) == pytest.approx(np.diag([6.25, 6.25, 25.0]))
    assert fix.position_covariance_type == 1 and fix.status.status == 0


#: a file with everything that is read: its columns and the numbers of a row after the time
EVERY_COLUMN = {'--imu': ('ax,ay,az,wx,wy,wz,temp', (0.1, 0.2, G, 0.01, 0.02, 0.03, 20.0)),
                '--gnss': ('lat,lon,height,sigma,vacc,hdop,status,vn,ve,vd,sacc',
                           (48.0, 11.0, 400.0, 2.0, 4.0, 1.0, 3.0, 0.0, 0.0, 0.0, 0.1)),
                '--speed': ('speed,sigma,turnrate', (3.0, 0.1, 0.01)),
                '--pressure': ('pressure', (101300.0,)),
                '--magnetometer': ('mx,my,mz', (2e-5, 1e-6, 4e-5))}


@pytest.mark.filterwarnings('error::RuntimeWarning')
@pytest.mark.parametrize('spoiled, columns', [(option, columns) for option, (columns, _) in EVERY_COLUMN.items()])
@pytest.mark.parametrize('cell', ['inf', '-inf', '1e300', '-1e200'])
def test_a_cell_that_no_sensor_writes_is_as_an_empty_one(tmp_path, capsys, spoiled, columns, cell):
    # given one such cell in each column of one file
    options = []
    for option, (names, values) in EVERY_COLUMN.items():
        rows = [[T0 + 0.05 * i, *values] for i in range(100)]
        if option == spoiled:
            for column in range(len(values)):
                rows[10 + 3 * column][1 + column] = cell
        options += [option, str(write(tmp_path / f'{option[2:]}.csv', f'time,{names}', rows))]
    # when it is imported, with warnings as errors
    assert main([*options, '--output', str(tmp_path / 'bag')]) == 0
    # then the others are as they were, and nothing else is printed
    assert capsys.readouterr().err == ''
    found = read_recording(tmp_path / 'bag', '/imu/data', '/gps/fix', temperature_topic='/imu/temperature',
                           velocity_topic='/gps/velocity', twist_topic='/wheel/odometry', pressure_topic='/pressure',
                           magnetometer_topic='/imu/mag')
    spoiled_rows = {10 + 3 * column for column in range(len(columns.split(',')))}
    good = [i for i in range(100) if i not in spoiled_rows]
    assert np.unique(found.imu.specific_force[good], axis=0) == pytest.approx(np.array([[0.1, 0.2, G]]))
    assert np.unique(found.gnss.latitude[good]) == pytest.approx(math.radians(48.0))
    assert np.unique(found.velocity.covariance[good, 0, 0]) == pytest.approx(0.01)
    assert np.isfinite(found.gnss.covariance).all()  # where no sigma is stated, the default
    if spoiled == '--imu':
        assert np.flatnonzero(np.isnan(found.imu.specific_force).any(axis=1)).tolist() == [10, 13, 16]


def test_an_existing_recording_is_only_overwritten_on_request(files, capsys):
    assert run(files) == 0
    assert run(files) == 2
    error = capsys.readouterr().err
    assert error.startswith('import_csv: ') and 'exists already' in error and error.count('\n') == 1
    assert run(files, '--overwrite', '--storage', 'sqlite3') == 0
    assert len(read_recording(files[2], '/imu/data', '/gps/fix').imu) == 300


@pytest.mark.parametrize('axes, expected', [
    ('forward left up', [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    ('forward right down', [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
    ('back, right, up', [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
    ('UP forward left', [[0, 1, 0], [0, 0, 1], [1, 0, 0]])])
def test_axes_are_turned_to_forward_left_up(tmp_path, axes, expected):
    # given sensor axes that point where the words say: `expected` has where they point as its columns
    assert axes_rotation(axes).tolist() == expected
    # when the vehicle, at rest on level ground, is measured in them
    vehicle_force, vehicle_turn = np.array([0.5, -0.25, G]), np.array([0.1, 0.2, -0.3])
    rotation = np.array(expected, float)
    rows = imu_rows(force=rotation.T @ vehicle_force, turn=rotation.T @ vehicle_turn)
    imu, _, _ = read_imu(write(tmp_path / 'imu.csv', 't,ax,ay,az,gx,gy,gz', rows), axes=axes)
    assert imu.specific_force.mean(axis=0) == pytest.approx(vehicle_force, abs=1e-3)
    assert imu.angular_rate.mean(axis=0) == pytest.approx(vehicle_turn, abs=1e-3)


@pytest.mark.parametrize('axes, expected', [
    ('forward left down', "'forward left down' are left-handed; with these x and y axes z points up"),
    ('forward back up', 'two of them lie on one line'), ('forward left', 'must be three of forward, back'),
    ('forward left sky', "got 'forward left sky'")])
def test_axes_that_cannot_be(files, capsys, axes, expected):
    assert run(files, '--imu-axes', axes) == 2
    assert expected in capsys.readouterr().err
    assert not files[2].exists()


@pytest.mark.parametrize('header', [
    'timestamp,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z',
    'Time (s),Accel X (m/s^2),Accel Y (m/s^2),Accel Z (m/s^2),Gyro X (rad/s),Gyro Y (rad/s),Gyro Z (rad/s)',
    '#t [s],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2],'
    'w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]',
    'time_s,ax_mps2,ay_mps2,az_mps2,gx_rad_s,gy_rad_s,gz_rad_s',
    'stamp,linear_acceleration.x,linear_acceleration.y,linear_acceleration.z,'
    'angular_velocity.x,angular_velocity.y,angular_velocity.z'])
def test_usual_names_are_understood(tmp_path, header):
    imu, temperature, _ = read_imu(write(tmp_path / 'imu.csv', header, imu_rows()))
    assert imu.specific_force[0, 2] == imu_rows()[0][3] and imu.angular_rate[5, 1] == imu_rows()[5][5]
    assert imu.stamp[123] == T0 * 10**9 + 1_230_000_000
    assert temperature is None


@pytest.mark.parametrize('names, options', [
    ('time,ax [g],ay [g],az [g],wx [deg/s],wy [deg/s],wz [deg/s]', {}),
    ('time,ax_g,ay_g,az_g,wx_dps,wy_dps,wz_dps', {}),
    ('time,ax,ay,az,wx,wy,wz', {'acceleration_unit': 'g', 'gyro_unit': 'deg/s'})])
def test_units_of_the_sensors(tmp_path, names, options):
    rows = imu_rows(force=(0.0, 0.5, 1.0), turn=(0.0, 90.0, -180.0))
    imu, _, text = read_imu(write(tmp_path / 'imu.csv', names, rows), **options)
    assert 'g, deg/s' in text
    assert imu.specific_force.mean(axis=0) == pytest.approx([0.0, 0.5 * G, G], abs=2e-3)
    assert imu.angular_rate.mean(axis=0) == pytest.approx([0.0, math.pi / 2, -math.pi], abs=1e-4)


@pytest.mark.parametrize('unit, digits', [('s', 0), ('ms', 3), ('us', 6), ('ns', 9)])
@pytest.mark.parametrize('epoch', [T0, 0])
@pytest.mark.parametrize('given', ['guessed', 'option', 'name'])
def test_units_of_time_keep_every_digit(tmp_path, unit, digits, epoch, given):
    exact = [(T0 if epoch else 0) * 10**9 + i * 10_000_000 + i % 7 * 1_000_000 for i in range(300)]
    scale = 10**(9 - digits)
    times = [f'{stamp // scale}.{stamp % scale:0{9 - digits}d}' if digits < 9 else stamp for stamp in exact]
    rows = [(time, *row[1:]) for time, row in zip(times, imu_rows())]
    name = {'guessed': 'time', 'option': 'time', 'name': f'time [{unit}]'}[given]
    path = write(tmp_path / 'imu.csv', f'{name},ax,ay,az,wx,wy,wz', rows)
    imu, _, text = read_imu(path, time_unit=unit if given == 'option' else None)
    assert imu.stamp.tolist() == exact
    assert f'in {unit},' in text


def test_times_as_dates(tmp_path):
    rows = [('2023-11-14T22:13:20.250Z', 48, 11), ('2023-11-14 22:13:21', 48, 11)]
    path = write(tmp_path / 'gnss.csv', 'time,lat,lon', rows)
    fixes, text = read_gnss(path)
    assert fixes.stamp.tolist() == [T0 * 10**9 + 250_000_000, (T0 + 1) * 10**9]
    assert 'in date, deg' in text and (fixes.height == 0).all()


@pytest.mark.parametrize('header, rows', [
    ('Date,Time', [('2023-11-14', '23:59:59.75'), ('2023-11-15', '0:00:00.25')]),
    ('time,date', [('23:59:59.75', '2023/11/14'), ('00:00:00.25', '2023/11/15')]),
    ('Date,UTC', [('14.11.2023', '23:59:59.75'), ('15.11.2023', '00:00:00.25')])])
def test_a_date_and_a_time_of_day_in_two_columns(tmp_path, header, rows):
    # given two rows on both sides of a midnight
    path = write(tmp_path / 'gnss.csv', f'{header},lat,lon', [(*row, 48, 11) for row in rows])
    # then 2023-11-15T00:00:00Z is 1700006400
    assert (read_gnss(path)[0].stamp - 1_700_006_400 * 10**9).tolist() == [-250_000_000, 250_000_000]


def test_times_of_day_alone_go_on_after_midnight(tmp_path):
    rows = [('23:59:59', 48, 11), ('0:00:00.5', 48, 11), ('00:00:01', 48, 11)]
    fixes, text = read_gnss(write(tmp_path / 'gnss.csv', 'time,lat,lon', rows))
    assert np.diff(fixes.stamp).tolist() == [1_500_000_000, 500_000_000] and 'in date' in text


@pytest.mark.parametrize('rows, expected', [
    ([('2023-11-14', '22:13:20'), ('soon', '22:13:21')], "'soonT22:13:21' in column 'date' is not a date"),
    ([('31/05/2023', '22:13:20')], "'31-05-2023T22:13:20' in column 'date' is not a date such as 2024-05-31"),
    ([('2023-11-14', '22:13:20'), ('2023-11-14', 'noon')], 'line 3')])
def test_dates_that_are_none_are_told(tmp_path, rows, expected):
    path = write(tmp_path / 'gnss.csv', 'date,time,lat,lon', [(*row, 48, 11) for row in rows])
    with pytest.raises(RecordingError, match=expected.replace('(', '.')):
        read_gnss(path)


def test_the_clock_of_an_arduino_has_its_unit_in_its_name(tmp_path):
    # given fixes each 4 ms and each 10 s, whose intervals do not tell the unit
    for name, interval, expected in (('Millis', 4, 4_000_000), ('micros', 10_000_000, 10_000_000_000)):
        rows = [(1000 + interval * i, 48, 11) for i in range(3)]
        fixes, _ = read_gnss(write(tmp_path / 'gnss.csv', f'{name},lat,lon', rows))
        assert np.diff(fixes.stamp).tolist() == [expected] * 2


def test_one_log_of_both_has_a_fix_where_the_position_changes(tmp_path, capsys):
    # given a row for each sample, the last position repeated until there is another, or none before the first one
    place = [('', '', '')] * 50 + [(48.0, 11.0, 400.0)] * 100 + [(48.0, 11.0000001, 400.0)] * 100 + [
        (48.0, 11.0000001, 400.5)] * 50
    rows = [(10 * i, *row[1:], *where, 0.1 * (i // 50), 0.0) for i, (row, where) in enumerate(zip(imu_rows(), place))]
    log = write(tmp_path / 'log.csv', 't,ax,ay,az,wx,wy,wz,lat,lon,alt,vn,ve', rows)
    # when it is named twice
    assert run((log, log, tmp_path / 'bag')) == 0
    # then there are three fixes, at the times of the samples that have them first, in their unit, ms
    recording = read_recording(tmp_path / 'bag', '/imu/data', '/gps/fix',
                               velocity_topic='/gps/velocity')
    assert len(recording.imu) == 300 and (recording.gnss.status == 0).all()
    assert ((recording.gnss.stamp - recording.imu.stamp[0]) * 1e-9).tolist() == [0.5, 1.5, 2.5]
    assert recording.velocity.velocity[:, 0] == pytest.approx([0.1, 0.3, 0.5])
    # and in another file with the same name for its time, all rows count
    other = write(tmp_path / 'other.csv', 't,lat,lon,alt', [(row[0], *row[7:10]) for row in rows[50:]])
    assert len(read_gnss(other, time_unit='ms')[0]) == 250


def test_missing_heights_are_told(tmp_path):
    found, text = read_gnss(write(tmp_path / 'a.csv', 'time,lat,lon', [(T0, 48, 11)]))
    assert 'no column of heights: fixes without altitude' in text and not has_altitude(found).any()
    found, text = read_gnss(write(tmp_path / 'b.csv', 'time,lat,lon,alt', [(T0, 48, 11, 5), (T0 + 1, 48, 11, '')]))
    assert 'no column' not in text and has_altitude(found).tolist() == [True, False] and (found.status == 0).all()


def test_columns_given_by_name_and_by_number(files, tmp_path):
    rows = [(row[0], *row[1:4], *row[1:4], 0.5) for row in imu_rows()]
    strange = write(tmp_path / 'strange.csv', 'clock,fx,q,ax,ay,az,p,r', rows)
    imu, _, _ = read_imu(strange, {'time': 'clock', 'wx': 'p', 'wy': 'q', 'wz': 'r', 'ax': 'fx'})
    assert (imu.angular_rate[0] == [imu_rows()[0][3], imu_rows()[0][2], 0.5]).all()
    bare = write(tmp_path / 'bare.csv', '', imu_rows())
    assert run((bare, *files[1:]), '--imu-columns', 'time=1,ax=2,ay=3,az=4,wx=5,wy=6,wz=7') == 0
    assert len(read_recording(files[2], '/imu/data').imu) == 300


@pytest.mark.parametrize('sign', [';', '\t', ' ', ','])
def test_other_separators_and_comments(tmp_path, sign):
    rows = imu_rows(5)
    text = write(tmp_path / 'imu.csv', sign.join('t ax ay az wx wy wz'.split()), rows, sign).read_text()
    lines = text.replace('.', ',' if sign == ';' else '.').splitlines()
    (tmp_path / 'imu.csv').write_text('\r\n'.join(['# a log', lines[0], '# a comment', *lines[1:], '']))
    imu, _, _ = read_imu(tmp_path / 'imu.csv')
    assert (imu.specific_force[:, 2] == [row[3] for row in rows]).all()


def test_a_temperature_column_becomes_a_topic(files, tmp_path):
    warm = write(tmp_path / 'warm.csv', 'time,ax,ay,az,wx,wy,wz,temperature', [(*row, 21.5) for row in imu_rows()])
    assert run((warm, *files[1:])) == 0
    recording = read_recording(files[2], '/imu/data', temperature_topic='/imu/temperature')
    assert (recording.temperature.celsius == 21.5).all() and len(recording.temperature) == 300


def test_fixes_with_sigma_gaps_and_radians(tmp_path):
    rows = [(T0, 0.8, ' 0.2 ', 300, 1.5), (T0 + 1, '', ' ', '', ''), (T0 + 2, 0.8, 0.2, 301, 0)]
    fixes, _ = read_gnss(write(tmp_path / 'gnss.csv', 'time,lat,lon,alt,hAcc', rows), angle_unit='rad', sigma=4.0)
    assert fixes.latitude[[0, 2]].tolist() == [0.8, 0.8]
    assert fixes.status.tolist() == [0, -1, 0]
    assert np.sqrt(fixes.covariance[:, 0, 0]) == pytest.approx([1.5, 4.0, 4.0])


@pytest.mark.parametrize('header, row, expected', [
    ('time,ax,ay,wx,wy,wz', '1,2,3,4,5,6', 'no column that looks like az; its columns are time, ax, ay, wx, wy, wz'),
    ('time,ax,ay,az,wx,wy,wz', '1,2,3,4,5,6', 'line 302: 6 cells instead of 7'),
    ('time,ax,ay,az,wx,wy,wz', '9,2,x3,4,5,6,7', "line 302: 'x3' in column 'ay' is not a number"),
    ('time,ax,ay,az,wx,wy,wz', 'soon,2,3,4,5,6,7', "line 302: 'soon' in column 'time' is not a number"),
    ('time,ax,ay,az,wx,wy,wz', 'nan,2,3,4,5,6,7', "line 302: 'nan' in column 'time' is not a time")])
def test_bad_files_are_told_in_one_line(files, tmp_path, capsys, header, row, expected):
    count = len(header.split(','))
    bad = tmp_path / 'bad.csv'
    bad.write_text('\n'.join([header, *(','.join(map(str, r[:count])) for r in imu_rows()), row]) + '\n')
    assert run((bad, *files[1:])) == 2
    error = capsys.readouterr().err
    assert expected in error and str(bad) in error and error.count('\n') == 1
    assert not files[2].exists()


def test_other_bad_input(files, tmp_path, capsys):
    def error(*options, imu=files[0], gnss=files[1]):
        assert run((imu, gnss, files[2]), *options) == 2
        text = capsys.readouterr().err
        assert text.count('\n') == 1
        return text

    assert 'cannot read' in error(imu=tmp_path / 'none.csv')
    (tmp_path / 'empty.csv').write_text('\n')
    assert 'empty.csv is empty' in error(imu=tmp_path / 'empty.csv')
    (tmp_path / 'header.csv').write_text('time,ax\n')
    assert 'has no rows' in error(imu=tmp_path / 'header.csv')
    (tmp_path / 'binary.csv').write_bytes(b'\xff\xfe\x00\x01')
    assert 'is not a text file' in error(imu=tmp_path / 'binary.csv')
    assert "no column 'clock' for time" in error('--imu-columns', 'time=clock')
    assert "got 'speed=v'" in error('--gnss-columns', 'speed=v')
    assert 'sigma of fixes must be above 0' in error('--gnss-sigma', '0')
    later = write(tmp_path / 'later.csv', 'time,lat,lon,h', gnss_rows(start=T0 + 5000))
    assert 'do not overlap in time: the fixes begin 5000 s after' in error(gnss=later)
    years = write(tmp_path / 'years.csv', 'time,lat,lon,h', gnss_rows(start=T0 - 3100 * 86400))
    assert 'the fixes begin 3100 days before' in error(gnss=years)
    assert 'beyond 90 and 360 deg' in error('--angle-unit', 'rad')
    assert 'not between 1970 and 2038' in error(gnss=write(tmp_path / 'w.csv', 'time,lat,lon', [('9e9', 1, 1)]))
    with pytest.raises(SystemExit) as usage:
        main(['--imu', 'x'])
    assert usage.value.code == 2


def test_the_checker_speaks_up(files, tmp_path, capsys):
    in_g = write(tmp_path / 'g.csv', 'time,ax,ay,az,wx,wy,wz', imu_rows(force=(0, 0, 1)))
    assert run((in_g, *files[1:])) == 0
    assert 'error: imu: the specific force is 1 m/s^2' in capsys.readouterr().out
    assert run((in_g, *files[1:]), '--overwrite', '--acceleration-unit', 'g') == 0
    assert 'instead of m/s^2' not in capsys.readouterr().out


def test_what_the_next_command_finds_is_no_error(files, tmp_path, capsys):
    """Given an IMU on its side, as a phone is mounted, When imported, Then that is a note: configure sets it."""
    on_its_side = write(tmp_path / 'side.csv', 'time,ax,ay,az,wx,wy,wz', imu_rows(force=(0, G, 0.1)))
    assert run((on_its_side, *files[1:])) == 0
    printed = capsys.readouterr().out
    assert 'note: imu: the IMU seems to be mounted on its side' in printed and '(configure does)' in printed
    assert 'error:' not in printed


def test_times_before_zero(files, tmp_path, capsys):
    """Given times of which some are negative, Then the message names the line and says what to do."""
    rows = [(i * 0.01 - 0.02, 0, 0, G, 0, 0, 0) for i in range(300)]
    assert run((write(tmp_path / 'early.csv', 'time [s],ax,ay,az,wx,wy,wz', rows), *files[1:])) == 2
    printed = capsys.readouterr().err
    assert "early.csv, line 2: time -0.02 in column 'time [s]' is before 0: add the same number" in printed


def test_a_reference_file_becomes_a_topic(files, tmp_path):
    truth = write(tmp_path / 'truth.csv', 'time,lat,lon,height', gnss_rows(30))
    assert run(files, '--reference', str(truth)) == 0
    reference = read_recording(files[2], '/imu/data', reference_topic='/reference/fix').reference
    assert len(reference) == 30 and reference.height[29] == 429.0


def test_errors_are_of_the_package(tmp_path):
    with pytest.raises(RecordingError):
        read_gnss(tmp_path / 'none.csv')


def test_velocities_stand_in_the_file_of_the_fixes(tmp_path):
    rows = [(*row, 3.0 + i, 4.0, -0.5, 0.2) for i, row in enumerate(gnss_rows())]
    header = 'time,latitude,longitude,height,vN [km/h],vE [km/h],vD [km/h],sAcc [km/h]'
    velocity, text = read_velocity(write(tmp_path / 'gnss.csv', header, rows))
    assert velocity.velocity[1] == pytest.approx(np.array([4.0, 4.0, -0.5]) / 3.6)
    assert velocity.covariance[0] == pytest.approx(np.eye(3) * (0.2 / 3.6)**2)
    assert 'north=vN' in text and text.endswith('in s, km/h')
    flat = write(tmp_path / 'flat.csv', 'time,latitude,longitude,vel_n,vel_e',
                 [(*row[:3], 1, 2) for row in gnss_rows()])
    velocity, _ = read_velocity(flat)
    assert velocity.velocity[0, :2].tolist() == [1.0, 2.0] and np.isnan(velocity.velocity[0, 2])
    assert np.isnan(velocity.covariance[0, 0, 0])
    assert read_velocity(write(tmp_path / 'none.csv', 'time,latitude,longitude,height', gnss_rows())) is None


@pytest.mark.parametrize('name, factor', [('speed', 1.0), ('wheel_speed (km/h)', 1 / 3.6), ('v [mph]', 0.44704),
                                          ('Vehicle Speed [kn]', 1852 / 3600), ('speed_mps', 1.0)])
def test_speeds_have_their_unit(tmp_path, name, factor):
    speeds, _ = read_speed(write(tmp_path / 'speed.csv', f'time,{name}', [(T0, -2.0), (T0 + 1, 36.0)]))
    assert speeds.speed == pytest.approx(factor * np.array([-2.0, 36.0])) and np.isnan(speeds.variance).all()


@pytest.mark.parametrize('name, factor', [('pressure', 1.0), ('pressure [hPa]', 100.0), ('p (mbar)', 100.0),
                                          ('Pressure [kPa]', 1000.0)])
def test_pressures_have_their_unit(tmp_path, name, factor):
    pressures, said = read_pressure(write(tmp_path / 'p.csv', f'time,{name}', [(T0, 1e5 / factor),
                                                                               (T0 + 1, 9e4 / factor)]))
    assert pressures.pressure == pytest.approx([1e5, 9e4])
    # and without a name of it by its size
    unnamed, said = read_pressure(write(tmp_path / 'u.csv', 'time,baro', [(T0, 1e5 / factor), (T0 + 1, 9e4 / factor)]))
    assert unnamed.pressure == pytest.approx([1e5, 9e4])
    with pytest.raises(RecordingError, match='is not an air pressure'):
        read_pressure(write(tmp_path / 'n.csv', 'time,baro', [(T0, 5.0), (T0 + 1, 5.0)]))


@pytest.mark.parametrize('unit, factor', [('T', 1.0), ('uT', 1e-6), ('gauss', 1e-4), ('mG', 1e-7), ('nT', 1e-9)])
def test_a_magnetic_field_has_its_unit_and_the_axes_of_the_imu(tmp_path, unit, factor):
    # given a sensor whose x points back and y right, and 20 uT forward, 3 uT to the left, 44 uT down
    rows = [(T0 + 0.1 * i, -20e-6 / factor, -3e-6 / factor, -44e-6 / factor) for i in range(3)]
    named = write(tmp_path / 'm.csv', f'time,mag_x [{unit}],mag_y [{unit}],mag_z [{unit}]', rows)
    unnamed = write(tmp_path / 'u.csv', 'time,x,y,z', rows)
    for path in (named, unnamed):
        fields, said = read_magnetometer(path, axes='back right up')
        assert fields.field == pytest.approx(np.tile([20e-6, 3e-6, -44e-6], (3, 1)), rel=1e-6, abs=1e-12)
        assert unit in said
    with pytest.raises(RecordingError, match='are not the earth'):
        read_magnetometer(write(tmp_path / 'n.csv', 'time,x,y,z', [(T0, 5.0, 0.0, 0.0), (T0 + 1, 5.0, 1.0, 0.0)]))


def test_units_stated_with_the_columns_count(tmp_path):
    # given files whose columns have names that tell no unit
    imu = write(tmp_path / 'imu.csv', 't,A1,A2,A3,B1,B2,B3', imu_rows(force=(0.0, 0.5, 1.0), turn=(0.0, 90.0, -180.0)))
    gnss = write(tmp_path / 'gnss.csv', 't,p,q,r', [(T0 + i, 0.8, 0.2, 250.0) for i in range(3)])
    other = write(tmp_path / 'other.csv', 't,v,w', [(T0 + i, 36.0, 90.0) for i in range(3)])
    air = write(tmp_path / 'air.csv', 't,p', [(T0 + i, 100.0) for i in range(3)])
    # when the units are stated where the columns are named
    names = {'ax': 'A1 [g]', 'ay': 'A2 [g]', 'az': 'A3 [g]', 'wx': 'B1 [deg/s]', 'wy': 'B2', 'wz': 'B3'}
    samples, _, said = read_imu(imu, names)
    fixes, _ = read_gnss(gnss, {'latitude': 'p [rad]', 'longitude': 'q [rad]', 'sigma': 'r [cm]'})
    odometry, _ = read_speed(other, {'speed': 'v [km/h]', 'turn_rate': 'w [deg/s]'})
    pressures, _ = read_pressure(air, {'pressure': 'p [kPa]'})
    # then they count, and an option counts more
    assert samples.specific_force.mean(axis=0) == pytest.approx([0.0, 0.5 * G, G], abs=2e-3)
    assert samples.angular_rate.mean(axis=0) == pytest.approx([0.0, math.pi / 2, -math.pi], abs=1e-4)
    in_mg, _, _ = read_imu(imu, names, acceleration_unit='mg')
    assert in_mg.specific_force == pytest.approx(1e-3 * samples.specific_force)
    assert fixes.latitude == pytest.approx(0.8) and fixes.covariance[:, 0, 0] == pytest.approx(2.5**2)
    assert odometry.twist[0] == pytest.approx([10.0, 0.0, -math.pi / 2])
    assert pressures.pressure == pytest.approx(1e5)


@pytest.mark.parametrize('option, columns, expected', [
    ('--imu-columns', 'ax=ax [foo]', "unit 'foo' of column 'ax' is not one of m/s^2, g, mg"),
    ('--imu-columns', 'time=time [sec]', "unit 'sec' of column 'time' is not one of s, ms, us, ns"),
    ('--gnss-columns', 'height=height [ft]', "unit 'ft' of column 'height' is not one of m, cm, mm")])
def test_a_stated_unit_that_is_not_known_is_refused(files, capsys, option, columns, expected):
    assert run(files, option, columns) == 2
    assert expected in capsys.readouterr().err and not files[2].exists()


def test_a_speed_with_a_turn_rate_is_an_odometry_and_a_pressure_reaches_the_recording(files, tmp_path):
    imu, gnss, bag = files
    speed = write(tmp_path / 'speed.csv', 'time,speed [km/h],yaw_rate [deg/s]', [
        (T0 + 0.1 * i, 36.0, 90.0) for i in range(20)])
    pressure = write(tmp_path / 'baro.csv', 'time,pressure [hPa]', [(T0 + 0.1 * i, 1000.0) for i in range(20)])
    assert run(files, '--speed', str(speed), '--pressure', str(pressure)) == 0
    streams = read_recording(bag, '/imu/data', '/gps/fix', twist_topic='/wheel/odometry',
                             pressure_topic='/pressure').streams()
    # then forwards, to the right, clockwise
    assert streams['twist'].twist == pytest.approx(np.tile([10.0, 0.0, -0.5 * np.pi], (20, 1)))
    assert streams['pressure'].pressure == pytest.approx(np.full(20, 1e5))


def test_speed_and_velocity_reach_the_recording(files, tmp_path):
    imu, _, bag = files
    gnss = write(tmp_path / 'gnss.csv', 'time,latitude,longitude,height,vn,ve,vd',
                 [(*row, 1.0, 2.0, 3.0) for row in gnss_rows()])
    speed = write(tmp_path / 'speed.csv', 'time,odo', [(T0 + 0.1 * i, 5.0) for i in range(20)])
    assert run((imu, gnss, bag), '--speed', str(speed), '--speed-columns', 'speed=odo') == 0
    recording = read_recording(bag, '/imu/data', '/gps/fix', speed_topic='/wheel/speed',
                               velocity_topic='/gps/velocity')
    assert recording.speed.speed.tolist() == [5.0] * 20
    assert recording.velocity.velocity[0].tolist() == [1.0, 2.0, 3.0]
