"""Files of well-known loggers, and proposals for those of unknown ones: known samples written in each format's way."""
from __future__ import annotations

import numpy as np
import pytest

from mems_ins_fusion.cli.import_csv import main
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.reference_files import read_reference

G = 9.80665
T0 = 1_700_000_000  # 14 November 2023, 22:13:20 UTC; GPS week 2288, 252818 s
COUNT, FIXES = 200, 5
TIME = np.arange(COUNT) * 0.01
NOISE = np.random.default_rng(1).normal(0, 0.01, (COUNT, 6))
FORCE, RATE = [0.1, 0.2, 9.81] + NOISE[:, :3], [0.01, -0.02, 0.03] + NOISE[:, 3:]
FRD = np.array([1.0, -1.0, -1.0])
K = np.arange(FIXES)
LATITUDE = 48.0 + 1e-6 * K


def save(path, header, *columns, sign=','):
    rows = [sign.join(map(str, row)) for row in zip(*(np.broadcast_to(c, len(columns[0])) for c in columns))]
    path.parent.mkdir(exist_ok=True)
    path.write_text('\n'.join([header] * bool(header) + rows) + '\n')
    return str(path)


def imported(tmp_path, *options, status=0):
    bag = tmp_path / 'bag'
    assert main([*options, '--output', str(bag)]) == status
    return read_recording(bag, '/imu/data', '/gps/fix' if '--gnss' in options or (tmp_path / 'export').exists() else
                          None) if status == 0 else None


def check(recording, tolerance=1e-6):
    imu = recording.imu
    assert imu.specific_force.mean(axis=0) == pytest.approx(FORCE.mean(axis=0), abs=1e-3)
    assert imu.angular_rate == pytest.approx(RATE[-len(imu):], abs=tolerance)
    assert np.degrees(recording.gnss.latitude) == pytest.approx(LATITUDE, abs=1e-9)
    assert recording.gnss.height == pytest.approx(np.full(FIXES, 500.0))


def test_ardupilot_takes_the_first_imu_and_its_status_and_hdop(tmp_path, capsys):
    twice = np.repeat(np.column_stack([RATE, FORCE]) * np.tile(FRD, 2), 2, axis=0)
    twice[1::2] += 0.5  # another IMU
    imu = save(tmp_path / 'imu.csv', 'timestamp,TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T',
               np.repeat(TIME + T0, 2), np.repeat(np.round(TIME * 1e6).astype(int), 2), np.tile([0, 1], COUNT),
               *twice.T, 0, 0, 31.5)
    gnss = save(tmp_path / 'gps.csv', 'timestamp,TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U',
                K + T0, K * 10**6, 0, [1, 3, 4, 5, 6], 0, 2288, 9, 0.8, LATITUDE, 11.0, 500.0, 0, 0, 0, 0, 1)
    recording = imported(tmp_path, '--imu', imu, '--gnss', gnss)
    check(recording)
    assert recording.gnss.status.tolist() == [-1, 0, 1, 2, 2]
    assert recording.gnss.covariance[0].diagonal() == pytest.approx([4.0, 4.0, 16.0])  # 2.5 m times HDOP
    assert 'read as ardupilot' in capsys.readouterr().out


def test_ardupilot_before_2015_counts_milliseconds_and_has_one_imu(tmp_path):
    imu = save(tmp_path / 'imu.csv', 'timestamp,TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ', TIME + T0,
               np.round(TIME * 1000).astype(int), *(RATE * FRD).T, *(FORCE * FRD).T)
    # its TimeMS of the fixes is that of the GPS week, T that of the IMU
    gnss = save(tmp_path / 'gps.csv', 'timestamp,Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T',
                K + T0, 3, 252_818_000 + 1000 * K, 2288, 9, 0.8, LATITUDE, 11.0, 0.0, 500.0, 0, 0, 0, 1000 * K)
    recording = imported(tmp_path, '--imu', imu, '--gnss', gnss)
    check(recording)
    assert recording.gnss.stamp[0] == recording.imu.stamp[0]


def test_px4_scales_and_velocity(tmp_path):
    imu = save(tmp_path / 'imu.csv', 'timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt,'
               'accelerometer_timestamp_relative,accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2]',
               np.round(TIME * 1e6).astype(int), *(RATE * FRD).T, 4000, 0, *(FORCE * FRD).T)
    gnss = save(tmp_path / 'gps.csv', 'timestamp,lat,lon,alt,alt_ellipsoid,s_variance_m_s,eph,epv,vel_n_m_s,vel_e_m_s,'
                'vel_d_m_s,fix_type', K * 10**6, np.round(LATITUDE * 1e7).astype(int), 110_000_000, 450_000, 500_000,
                0.2, 1.2, 2.0, 3.0, 0.0, 0.5, [0, 3, 4, 5, 6])
    recording = imported(tmp_path, '--imu', imu, '--gnss', gnss)
    check(recording)
    assert recording.gnss.status.tolist() == [-1, 0, 1, 2, 2]
    assert recording.gnss.covariance[1].diagonal() == pytest.approx([1.44, 1.44, 4.0])
    assert (recording.gnss.covariance_type == 2).all()
    velocity = read_recording(tmp_path / 'bag', '/imu/data', velocity_topic='/gps/velocity').velocity
    assert velocity.velocity[0] == pytest.approx([3.0, 0.0, 0.5])
    assert velocity.covariance[0, 0, 0] == pytest.approx(0.04)


@pytest.mark.parametrize('app', ['phyphox', 'sensor_logger'])
def test_phones_have_a_file_for_each_sensor(tmp_path, capsys, app):
    export, later = tmp_path / 'export', 0.004
    if app == 'phyphox':
        stamp, shifted = TIME, TIME + later
        fixes = ('"Time (s)","Latitude (°)","Longitude (°)","Height (m)","Velocity (m/s)","Direction (°)",'
                 '"Horizontal Accuracy (m)","Vertical Accuracy (m)"', K, LATITUDE, 11.0, 500.0, 0, 0, 4.0, 6.0)
        header = '"Time (s)","X ({0})","Y ({0})","Z ({0})"'
        save(export / 'Accelerometer.csv', header.format('m/s^2'), stamp, *FORCE.T)
        save(export / 'Gyroscope.csv', header.format('rad/s'), shifted, *RATE.T)
    else:
        stamp = T0 * 10**9 + np.round(TIME * 1e9).astype(np.int64)
        order = [2, 1, 0]
        fixes = ('time,seconds_elapsed,bearingAccuracy,speedAccuracy,verticalAccuracy,horizontalAccuracy,speed,bearing,'
                 'altitude,longitude,latitude', stamp[0] + K * 10**9, K, 1, 1, 6.0, 4.0, 0, 0, 500.0, 11.0, LATITUDE)
        header = 'time,seconds_elapsed,z,y,x'
        save(export / 'TotalAcceleration.csv', header, stamp, TIME, *FORCE.T[order])
        save(export / 'Gyroscope.csv', header, stamp + int(later * 1e9), TIME, *RATE.T[order])
    save(export / 'Location.csv', *fixes)
    recording = imported(tmp_path, '--imu', str(export))
    imu = recording.imu
    assert f'read as {app}' in capsys.readouterr().out
    assert len(imu) == COUNT - 1  # before the first angular rate there is none
    between = np.column_stack([np.interp(TIME[1:], TIME + later, rate) for rate in RATE.T])
    assert imu.angular_rate == pytest.approx(between, abs=1e-6)
    assert imu.specific_force == pytest.approx(FORCE[1:], abs=1e-9)
    assert recording.gnss.covariance[0].diagonal() == pytest.approx([16.0, 16.0, 36.0])
    assert recording.gnss.height[0] == 500.0


def test_gravity_that_a_phone_has_taken_away_is_added_again(tmp_path, capsys):
    # given an export of Sensor Logger with what it writes unless told otherwise
    export, stamp = tmp_path / 'export', T0 * 10**9 + np.round(TIME * 1e9).astype(np.int64)
    header, order = 'time,seconds_elapsed,z,y,x', [2, 1, 0]
    gravity = 9.81 * np.column_stack([0.01 * TIME, 0.0 * TIME, np.ones(COUNT)])
    save(export / 'Accelerometer.csv', header, stamp, TIME, *(FORCE - gravity).T[order])
    save(export / 'Gravity.csv', header, stamp, TIME, *gravity.T[order])
    save(export / 'Gyroscope.csv', header, stamp, TIME, *RATE.T[order])
    save(export / 'Location.csv', 'time,seconds_elapsed,horizontalAccuracy,altitude,longitude,latitude',
         stamp[0] + K * 10**9, K, 4.0, 500.0, 11.0, LATITUDE)
    # then the specific force is whole, and it is not taken for one of phyphox, whose files have the same names
    check(recording := imported(tmp_path, '--imu', str(export)))
    assert recording.imu.specific_force == pytest.approx(FORCE, abs=1e-9)
    assert 'read as sensor_logger' in capsys.readouterr().out


def test_u_blox_and_nmea(tmp_path):
    imu = save(tmp_path / 'imu.csv', 'time,ax,ay,az,wx,wy,wz', [f'{T0 + t:.2f}' for t in TIME], *FORCE.T, *RATE.T)
    gnss = save(tmp_path / 'pvt.csv', 'iTOW,year,month,day,hour,min,sec,valid,tAcc,nano,fixType,flags,numSV,lon,lat,'
                'height,hMSL,hAcc,vAcc,velN,velE,velD,gSpeed,headMot,sAcc', K * 1000, 2023, 11, 14, 22, 13, 20 + K, 7,
                1, -250, [3, 3, 3, 1, 3], 1, 9, 110_000_000, np.round(LATITUDE * 1e7).astype(int), 500_000, 450_000,
                1200, 2000, 1000, 0, 0, 1000, 0, 300)
    recording = imported(tmp_path, '--imu', imu, '--gnss', gnss)
    check(recording)
    assert recording.gnss.stamp[0] == T0 * 10**9 - 250 and recording.gnss.status.tolist() == [0, 0, 0, -1, 0]
    assert recording.gnss.covariance[0].diagonal() == pytest.approx([1.44, 1.44, 4.0])
    date = '$GPRMC,221320.00,A,4800.000,N,01100.000,E,022.4,084.4,141123,003.1,W\n'
    (tmp_path / 'log.nmea').write_text(date + ''.join(
        f'$GPGGA,2213{20 + k}.00,4800.000,N,01100.000,E,{4 if k else 1},08,2.0,453.1,M,46.9,M,,\n' for k in range(5)))
    (tmp_path / 'bag').rename(tmp_path / 'first')
    recording = imported(tmp_path, '--imu', imu, '--gnss', str(tmp_path / 'log.nmea'))
    assert recording.gnss.status.tolist() == [0, 2, 2, 2, 2] and recording.gnss.stamp[0] == T0 * 10**9
    assert recording.gnss.height[0] == 500.0 and recording.gnss.covariance[0, 0, 0] == pytest.approx(25.0)


def test_kf_gins_increments_and_truth(tmp_path, capsys):
    seconds = 252_800.0
    imu = save(tmp_path / 'imu.txt', '', seconds + TIME, *(RATE * FRD * 0.01).T, *(FORCE * FRD * 0.01).T, sign='  ')
    gnss = save(tmp_path / 'gnss.txt', '', seconds + K, LATITUDE, 11.0, 500.0, 0.01, 0.01, 0.02, sign='  ')
    truth = save(tmp_path / 'truth.nav', '', np.full(FIXES, 2288), seconds + K, LATITUDE, 11.0, 500.0, 1.0, 2.0, 3.0,
                 0.0, 0.0, 90.0, sign='  ')
    assert imported(tmp_path, '--imu', imu, status=2) is None
    assert 'as it seems: --preset kf-gins' in capsys.readouterr().err
    recording = imported(tmp_path, '--imu', imu, '--gnss', gnss, '--reference', truth, '--preset', 'kf-gins')
    check(recording, 1e-5)
    assert recording.gnss.covariance[0].diagonal() == pytest.approx([1e-4, 1e-4, 4e-4])
    reference = read_reference(truth)
    assert reference.stamp[0] == recording.imu.stamp[0] and reference.yaw[0] == pytest.approx(np.pi / 2)
    assert reference.velocity[0].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize('names', ['week,sow', 'GPSWeek,GPSSeconds'])
def test_gps_weeks_are_turned_into_utc(tmp_path, names):
    imu = save(tmp_path / 'imu.csv', f'{names},ax,ay,az,wx,wy,wz', np.full(COUNT, 2288), 252_818.0 + TIME, *FORCE.T,
               *RATE.T)
    recording = imported(tmp_path, '--imu', imu)
    assert recording.imu.stamp[0] == T0 * 10**9


@pytest.mark.parametrize('header, scale, expected', [
    ('TimeMS,A1,A2,A3,B1,B2,B3', (1 / G, 180 / np.pi), '"time=TimeMS,ax=A1,ay=A2,az=A3,wx=B1,wy=B2,wz=B3" '
     '--acceleration-unit g --gyro-unit '),
    ('', (1.0, 1.0), '"time=1,ax=2,ay=3,az=4,wx=5,wy=6,wz=7" --acceleration-unit m/s^2 --gyro-unit rad/s')])
def test_what_is_missing_is_named_at_once_with_the_options_that_fit(tmp_path, capsys, header, scale, expected):
    rate = RATE * scale[1] * (10.0 if header else 1.0)
    path = save(tmp_path / 'x.csv', header, np.round(TIME * 1000).astype(int), *(FORCE * scale[0]).T, *rate.T)
    assert imported(tmp_path, '--imu', path, status=2) is None
    error = capsys.readouterr().err
    assert 'ax, ay, az, wx, wy, wz' in error and expected in error and error.count('\n') == 1
    # when what is proposed is done, it is right
    options = error.split('as it seems: ')[1].strip()
    columns, rest = options.split('"')[1], options.split('"')[2].split()
    if 'deg/s' in rest:
        recording = imported(tmp_path, '--imu', path, '--imu-columns', columns, *rest)
        assert recording.imu.specific_force == pytest.approx(FORCE, abs=1e-9)
        assert recording.imu.angular_rate == pytest.approx(10.0 * RATE, abs=1e-9)


def test_where_no_column_fits_nothing_is_proposed(tmp_path, capsys):
    # given fixes in place of the IMU
    path = save(tmp_path / 'x.csv', 'TimeMS,Lat,Lng', K * 1000, LATITUDE, np.full(FIXES, 11.0))
    assert imported(tmp_path, '--imu', path, status=2) is None
    # then the option is named, and no guess of unknown columns called what it seems
    error = capsys.readouterr().err
    assert 'name them: --imu-columns "time=TimeMS,ax=?,' in error and 'as it seems' not in error


def test_sensor_axes_are_not_proposed_as_a_place(tmp_path, capsys):
    # given the samples of an IMU in place of fixes
    imu = save(tmp_path / 'imu.csv', 'time,acc_x [g],acc_y [g],acc_z [g],wx,wy,wz', TIME, *FORCE.T + 0.123456, *RATE.T)
    assert imported(tmp_path, '--imu', imu, '--gnss', imu, status=2) is None
    # then no axis is taken for a latitude
    assert capsys.readouterr().err.endswith('name them: --gnss-columns "time=time,latitude=?,longitude=?"\n')


@pytest.mark.parametrize('header, expected', [
    # a unit in a name is not contradicted by the proposal, and what is there by its name stays
    ('TimeUS,fx_g,fy_g,fz_g,p_dps,q_dps,r_dps', '"time=TimeUS,ax=fx_g,ay=fy_g,az=fz_g,wx=p_dps,wy=q_dps,wz=r_dps"\n'),
    ('clock,ax,ay,az,wx,wy,wz', '--imu-columns "time=clock,ax=ax,ay=ay,az=az,wx=wx,wy=wy,wz=wz"\n')])
def test_a_proposal_keeps_what_the_names_tell(tmp_path, capsys, header, expected):
    path = save(tmp_path / 'x.csv', header, np.round(TIME * 1e6).astype(int), *FORCE.T, *RATE.T)
    assert imported(tmp_path, '--imu', path, status=2) is None
    assert capsys.readouterr().err.endswith(expected)


def test_latitude_and_longitude_are_proposed_by_what_they_hold(tmp_path, capsys):
    imu = save(tmp_path / 'imu.csv', 'time,ax,ay,az,wx,wy,wz', TIME, *FORCE.T, *RATE.T)
    gnss = save(tmp_path / 'gnss.csv', 'clock,speed,N,E,H', 0.4 * K, 3.12, LATITUDE + 0.123456, -11.1 - 1.1e-6 * K,
                500.0)
    assert imported(tmp_path, '--imu', imu, '--gnss', gnss, status=2) is None
    proposed = 'time=clock,latitude=N,longitude=E'
    assert f'--gnss-columns "{proposed}"' in capsys.readouterr().err
    assert len(imported(tmp_path, '--imu', imu, '--gnss', gnss, '--gnss-columns', proposed).gnss) == FIXES


@pytest.mark.parametrize('header, cells, expected', [
    ('quality', ['0', '1', '2', '4', '5'], [-1, 0, 1, 2, 2]), ('fixType', ['0', '1', '2', '3', '6'], [-1, -1, 0, 0, 2]),
    ('status', ['-1', '0', '1', '2', '0'], [-1, 0, 1, 2, 0]), ('status', ['0'] * 5, [0] * 5),
    ('status', ['V', 'A', 'A', 'A', 'V'], [-1, 0, 0, 0, -1]),
    ('fix', ['no fix', '3D fix', 'DGPS fix', 'RTK float', 'RTK fixed'], [-1, 0, 1, 2, 2])])
def test_status_of_fixes(tmp_path, header, cells, expected):
    imu = save(tmp_path / 'imu.csv', 'time,ax,ay,az,wx,wy,wz', TIME, *FORCE.T, *RATE.T)
    gnss = save(tmp_path / 'gnss.csv', f'time,lat,lon,{header}', 0.4 * K, LATITUDE, 11.0, cells)
    assert imported(tmp_path, '--imu', imu, '--gnss', gnss).gnss.status.tolist() == expected


def test_a_thousand_columns_are_not_all_listed(tmp_path, capsys):
    names = ','.join(f'c{i}' for i in range(1000))
    path = tmp_path / 'x.csv'
    path.write_text(f'{names}\n{",".join(["0"] * 1000)}\n')
    assert imported(tmp_path, '--imu', str(path), status=2) is None
    error = capsys.readouterr().err
    assert 'and 960 more' in error and len(error) < 1000
