"""Simulated drives: exact truth that integrates to itself, and a vehicle that drives like one."""
from __future__ import annotations

import numpy as np
import pytest
from simulation_support import close

from mems_ins_fusion.navigation.earth import gravity, radii
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import simulate_drive

STILL = 25.0
SUSPENSION = {'pitch_per_acceleration': 0.008, 'roll_per_acceleration': 0.01, 'sideslip_per_acceleration': -0.006}
EARTH_RATE = 7.292115e-5


def rotation(roll, pitch, yaw):
    """Body to north-east-down, written out (Groves, 2nd ed., Eq. 2.24)."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    return np.array([[cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
                     [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
                     [-sp, sr * cp, cr * cp]])


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def rodrigues(v):
    angle = np.linalg.norm(v)
    if angle < 1e-12:
        return np.eye(3) + skew(v)
    k = skew(v / angle)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def mechanize_planar(drive):
    """The planar mechanization of DESIGN section 3 in a plain loop: final latitude, longitude, v_n, v_e, yaw."""
    dt, h = 1 / drive.rate, drive.height[0]
    lat, lon, yaw, v = drive.latitude[0], drive.longitude[0], drive.yaw[0], drive.velocity[0, :2].copy()
    for f, w in zip(drive.specific_force[1:], drive.angular_rate[1:, 2]):
        middle = yaw + 0.5 * w * dt
        yaw += w * dt
        before = v
        v = v + dt * np.array([np.cos(middle) * f[0] - np.sin(middle) * f[1],
                               np.sin(middle) * f[0] + np.cos(middle) * f[1]])
        north, east = 0.5 * dt * (before + v)
        meridian, prime_vertical = radii(lat)
        lon += east / ((prime_vertical + h) * np.cos(lat + 0.5 * north / (meridian + h)))
        lat += north / (meridian + h)
    return lat, lon, *v, yaw


def mechanize_strapdown(drive):
    """Strapdown in the local level frame with rotation matrices: final latitude, longitude, height, velocity, C."""
    dt = 1 / drive.rate
    lat, lon, h, v = drive.latitude[0], drive.longitude[0], drive.height[0], drive.velocity[0].copy()
    c = rotation(drive.roll[0], drive.pitch[0], drive.yaw[0])
    for f, w in zip(drive.specific_force[1:], drive.angular_rate[1:]):
        meridian, prime_vertical = (r + h for r in radii(lat))
        earth = np.zeros(3)
        transport = np.zeros(3)
        if drive.path.rotating_earth:
            earth = EARTH_RATE * np.array([np.cos(lat), 0, -np.sin(lat)])
            transport = np.array([v[1] / prime_vertical, -v[0] / meridian, -v[1] * np.tan(lat) / prime_vertical])
        half = rodrigues(-0.5 * dt * (earth + transport))
        middle = half @ c @ rodrigues(0.5 * dt * w)
        c = half @ middle @ rodrigues(0.5 * dt * w)
        before = v
        v = v + dt * (middle @ f + [0, 0, gravity(lat, h)] - np.cross(2 * earth + transport, v))
        north, east, down = 0.5 * dt * (before + v)
        lon += east / (prime_vertical * np.cos(lat + 0.5 * north / meridian))
        lat += north / meridian
        h -= down
    return lat, lon, h, v, c


def horizontal_error(drive, lat, lon):
    meridian, prime_vertical = radii(lat)
    return np.hypot((lat - drive.latitude[-1]) * meridian, (lon - drive.longitude[-1]) * prime_vertical * np.cos(lat))


@pytest.mark.parametrize('seed', [1, 2])
def test_given_a_level_road_the_planar_mechanization_reproduces_the_truth(seed):
    drive = simulate_drive(120.0, seed, standstill=2.0)
    lat, lon, v_n, v_e, yaw = mechanize_planar(drive)
    assert horizontal_error(drive, lat, lon) < 1e-3  # of a drive of more than a kilometre
    assert np.linalg.norm(drive.position[-1]) > 100
    assert close((v_n, v_e), tuple(drive.velocity[-1, :2]), 1e-10)
    assert close(yaw, drive.yaw[-1], 1e-10)


@pytest.mark.parametrize('options', [{'hills': True}, {'hills': True, **SUSPENSION},
                                     {'hills': True, 'rotating_earth': True, **SUSPENSION}])
def test_given_hills_and_suspension_the_strapdown_mechanization_reproduces_the_truth(options):
    drive = simulate_drive(60.0, 5, standstill=2.0, **options)
    assert abs(drive.yaw[-1] - drive.yaw[0]) > 0.5  # it turned
    lat, lon, h, v, c = mechanize_strapdown(drive)
    assert horizontal_error(drive, lat, lon) < 1e-3
    assert close(h, drive.height[-1], 1e-3)
    assert close(v, drive.velocity[-1], 1e-5)
    assert close(c, rotation(drive.roll[-1], drive.pitch[-1], drive.yaw[-1]), 1e-7)


@pytest.mark.parametrize('seed', [4, 6])
def test_given_a_realistic_drive_the_strapdown_mechanization_reproduces_the_truth(seed):
    """Road, suspension and the arm from the axle at once: the error is that of integrating at 100 Hz."""
    drive = REALISTIC.drive(80.0, seed, standstill=2.0)
    assert abs(drive.yaw[-1] - drive.yaw[0]) > 0.1 and np.ptp(drive.height) > 1
    lat, lon, h, v, c = mechanize_strapdown(drive)
    assert horizontal_error(drive, lat, lon) < 2e-3
    assert close(h, drive.height[-1], 1e-3)
    assert close(v, drive.velocity[-1], 2e-5)
    assert close(c, rotation(drive.roll[-1], drive.pitch[-1], drive.yaw[-1]), 1e-6)


def test_the_hills_make_the_difference_between_planar_and_truth():
    drive = simulate_drive(120.0, 5, hills=True)
    lat, lon, *_ = mechanize_planar(drive)
    assert horizontal_error(drive, lat, lon) > 10


def test_the_rotating_earth_makes_the_difference_between_gyroscopes():
    still = simulate_drive(10.0, standstill=10.0, rotating_earth=True)
    assert np.linalg.norm(still.angular_rate, axis=1) == pytest.approx(EARTH_RATE, rel=1e-9)
    # a gyroscope that looks down sees minus the sine of the latitude
    assert still.angular_rate[5, 2] == pytest.approx(-EARTH_RATE * np.sin(still.latitude[0]), rel=1e-9)


@pytest.mark.parametrize('options', [
    {}, {'hills': True, **SUSPENSION}, {'grade': 0.05, 'bank': 0.04, 'axle_to_imu': (1.2, -0.4, -0.6), **SUSPENSION},
    {'suspension': 1.2, 'axle_to_imu': (2.0, 0.5, -1.0), **SUSPENSION}])
def test_motion_at_any_time_obeys_finite_differences(options):
    drive = simulate_drive(240.0, 3, **options)
    time, step = np.random.default_rng(0).uniform(STILL, 239, 500), 1e-3
    before, here, after = drive.at(time - step), drive.at(time), drive.at(time + step)
    meridian, prime_vertical = radii(here.latitude)
    rate_of = {name: (getattr(after, name) - getattr(before, name)) / (2 * step)
               for name in ('position', 'velocity', 'latitude', 'longitude', 'height', 'roll', 'pitch', 'yaw')}
    assert close(rate_of['position'], here.velocity, 2e-6)
    assert close(rate_of['latitude'] * (meridian + here.height), here.velocity[:, 0], 2e-5)
    eastward = rate_of['longitude'] * (prime_vertical + here.height) * np.cos(here.latitude)
    assert close(eastward, here.velocity[:, 1], 2e-5)
    assert close(-rate_of['height'], here.velocity[:, 2], 2e-6)
    # specific force, and angular rate by Euler's kinematic equations, in the middle of the samples' intervals
    middle = drive.time[3000:-100:50] - 0.5 / drive.rate
    here, before, after = (drive.at(middle + offset) for offset in (0.0, -step, step))
    acceleration = (after.velocity - before.velocity) / (2 * step)
    roll_rate, pitch_rate, yaw_rate = ((getattr(after, a) - getattr(before, a)) / (2 * step)
                                       for a in ('roll', 'pitch', 'yaw'))
    g = gravity(here.latitude, here.height)
    for i, k in enumerate(range(3000, len(drive.time) - 100, 50)):
        c = rotation(here.roll[i], here.pitch[i], here.yaw[i])
        assert close(drive.specific_force[k], c.T @ (acceleration[i] - [0, 0, g[i]]), 1e-4)
        sr, cr, sp, cp = np.sin(here.roll[i]), np.cos(here.roll[i]), np.sin(here.pitch[i]), np.cos(here.pitch[i])
        rates = [roll_rate[i] - yaw_rate[i] * sp, pitch_rate[i] * cr + yaw_rate[i] * sr * cp,
                 -pitch_rate[i] * sr + yaw_rate[i] * cr * cp]
        assert close(drive.angular_rate[k], rates, 1e-5)


def test_signs_are_those_of_forward_right_down():
    drive = simulate_drive(400.0, 4)
    speed = np.linalg.norm(drive.velocity, axis=1)
    forward = np.gradient(speed, drive.time)
    assert np.all(drive.specific_force[forward > 0.5, 0] > 0.4)
    right = drive.angular_rate[:, 2] > 0.1  # clockwise from above: a turn to the right, acceleration to the right
    assert right.any() and np.all(drive.specific_force[right, 1] > 0)
    assert np.all(np.diff(drive.yaw)[right[1:]] > 0)
    assert close(drive.specific_force[:, 2], -gravity(drive.latitude[0], drive.height[0]), 1e-4)


@pytest.mark.parametrize('seed', range(6))
def test_the_vehicle_drives_like_one(seed):
    drive = simulate_drive(600.0, seed)
    speed = np.linalg.norm(drive.velocity, axis=1)
    horizontal = np.linalg.norm(drive.specific_force[:, :2], axis=1)
    jerk = np.abs(np.diff(drive.specific_force[:, :2], axis=0)) * drive.rate
    assert np.all(speed[drive.time <= STILL] == 0) and speed[drive.time > STILL + 10].max() > 0
    assert 8 < speed.max() <= 20.0 + 1e-9
    assert 1.5 < horizontal.max() <= 2.5
    assert jerk.max() <= 2.6
    tight = np.abs(drive.angular_rate[:, 2]) > 0.05
    assert (speed[tight] / np.abs(drive.angular_rate[tight, 2])).min() >= 9.0 - 0.01
    segments = [s for s, end in zip(drive.path.segments, np.cumsum([s.duration for s in drive.path.segments]))
                if end < 600]
    assert sum(abs(abs(s.course_change) - np.pi / 2) < 1e-9 for s in segments) >= 3
    standing = np.diff(np.flatnonzero(np.diff((speed < 1e-9).astype(int))))
    assert len(standing) >= 2  # stops under way


def test_hills_stay_within_what_roads_have():
    drive = simulate_drive(1200.0, 2, hills=True)
    assert 0.02 < np.abs(np.tan(drive.pitch)).max() <= 0.06
    assert 5 < np.ptp(drive.height) < 100


def test_the_seed_decides_and_a_longer_drive_begins_as_a_shorter_one():
    drive, again, other = (simulate_drive(100.0, seed) for seed in (7, 7, 8))
    longer = simulate_drive(200.0, 7)
    assert np.array_equal(drive.specific_force, again.specific_force)
    assert not np.array_equal(drive.specific_force, other.specific_force)
    assert np.array_equal(drive.velocity, longer.velocity[:len(drive.time)])


def test_the_rate_of_the_imu_does_not_change_the_drive():
    slow, fast = simulate_drive(100.0, 7, rate=20.0), simulate_drive(100.0, 7, rate=200.0)
    assert len(slow.time) == 2001 and len(fast.time) == 20001
    assert close(slow.latitude, fast.latitude[::10], 1e-15)
    assert close(slow.position, fast.position[::10], 1e-9)
    assert np.all(np.diff(fast.stamp) == 5_000_000)


def test_at_agrees_with_the_samples_and_stands_before_the_start():
    drive = simulate_drive(60.0, 9, hills=True, **SUSPENSION)
    motion = drive.at(drive.time)
    for name in ('position', 'latitude', 'longitude', 'height', 'velocity', 'roll', 'pitch', 'yaw'):
        assert np.array_equal(getattr(motion, name), getattr(drive, name)), name
    before = drive.at([-3.0])
    assert before.latitude[0] == drive.latitude[0] and np.all(before.velocity == 0)


def test_at_refuses_times_after_the_end():
    drive = simulate_drive(60.0, 9)
    drive.at([60.0 + 60.0])
    with pytest.raises(ValueError, match='ends at'):
        drive.at([1000.0])


@pytest.mark.parametrize('arguments', [(0.0, 1, 100.0), (10.0, 1, 0.0), (-5.0, 1, 100.0)])
def test_a_drive_without_duration_or_rate_is_refused(arguments):
    with pytest.raises(ValueError, match='must be positive'):
        simulate_drive(*arguments)


def test_a_standstill_as_long_as_the_drive_is_rest():
    drive = simulate_drive(30.0, 1, standstill=30.0)
    assert np.all(drive.velocity == 0) and np.all(drive.angular_rate == 0)
    assert np.all(drive.specific_force[:, :2] == 0)
