"""Earth, frames, and the geometry of the odometry."""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import configure, started, take_sample
from scipy.spatial.transform import Rotation

from mems_ins_fusion.filter.memory import PLANAR, Sample, views
from mems_ins_fusion.filter.runs.odometry import (
    ANGULAR,
    LINEAR,
    ORIENTATION,
    POSE_COVARIANCE,
    SIZE,
    TWIST_COVARIANCE,
    odometry,
)
from mems_ins_fusion.navigation import earth, frames, strapdown

A, F = 6378137.0, 1 / 298.257223563
PLACES = [(0.0, 0.0), (48.0, 11.5), (-33.9, 151.2), (69.6, -18.9), (-89.9, 100.0)]


@pytest.mark.parametrize(('latitude', 'meridian', 'prime_vertical'), [
    (0.0, 6335439.327, 6378137.000),  # a(1-e^2) and a
    (90.0, 6399593.626, 6399593.626),  # a^2/b, both
])
def test_radii_are_those_published_for_wgs84(latitude, meridian, prime_vertical):
    assert earth.radii(math.radians(latitude)) == pytest.approx((meridian, prime_vertical), abs=6e-4)


def test_meridian_radius_is_the_length_of_an_arc_of_latitude():
    # given the meridian ellipse by its parametric latitude, an independent description
    def point(latitude):
        beta = math.atan((1 - F) * math.tan(latitude))
        return np.array([A * math.cos(beta), A * (1 - F) * math.sin(beta)])

    for latitude in np.radians([1.0, 30.0, 48.0, 75.0]):
        arc = np.linalg.norm(point(latitude + 1e-5) - point(latitude - 1e-5)) / 2e-5
        assert earth.radii(latitude)[0] == pytest.approx(arc, rel=1e-9)
        assert earth.radii(latitude)[1] == pytest.approx(point(latitude)[0] / math.cos(latitude), rel=1e-12)


@pytest.mark.parametrize(('latitude', 'expected'), [
    (0.0, 9.7803253359), (45.0, 9.8061977694), (90.0, 9.8321849378)])  # TR8350.2, table 3.4 and Somigliana
def test_gravity_on_the_ellipsoid_is_the_published_one(latitude, expected):
    assert earth.gravity(math.radians(latitude), 0.0) == pytest.approx(expected, abs=2e-9)


def test_gravity_falls_with_height_as_the_free_air_gradient():
    # then by 0.3086 mGal per metre, and as the inverse square up high
    gradient = (earth.gravity(0.8, 100.0) - earth.gravity(0.8, 0.0)) / 100
    assert gradient == pytest.approx(-3.086e-6, rel=2e-3)
    assert earth.gravity(0.8, 20e3) == pytest.approx(earth.gravity(0.8, 0.0) * (1 + 20e3 / 6.371e6) ** -2, rel=2e-5)


def ecef(latitude, longitude, height):
    """By the ellipsoid's parametric latitude: independent of the prime-vertical radius."""
    beta = np.arctan2((1 - F) * np.sin(latitude), np.cos(latitude))
    horizontal, z = A * np.cos(beta) + height * np.cos(latitude), A * (1 - F) * np.sin(beta) + height * np.sin(latitude)
    return np.array([horizontal * np.cos(longitude), horizontal * np.sin(longitude), z])


@pytest.mark.parametrize(('latitude', 'longitude'), PLACES)
def test_local_frame_is_the_rotated_ecef_difference(latitude, longitude):
    datum = np.array([math.radians(latitude), math.radians(longitude), 250.0])
    # given the rotation from ECEF to north-east-down as two turns about axes
    rotation = Rotation.from_euler('ZY', [datum[1], -datum[0] - math.pi / 2]).inv()
    for d_lat, d_lon, height in ((1e-3, -2e-3, 300.0), (-0.02, 0.01, 0.0), (0.0, 0.0, 250.0), (1e-7, 1e-7, 250.1)):
        point = datum[0] + d_lat, datum[1] + d_lon, height
        expected = rotation.apply(ecef(*point) - ecef(*datum))
        assert earth.to_local(*point, datum) == pytest.approx(expected, abs=5e-9)


@pytest.mark.parametrize(('latitude', 'longitude'), PLACES)
def test_from_local_undoes_to_local(latitude, longitude):
    datum = np.array([math.radians(latitude), math.radians(longitude), 250.0])
    rng = np.random.default_rng(0)
    for scale in (1.0, 1e3, 1e5):
        local = rng.uniform(-scale, scale, 3)
        assert earth.to_local(*earth.from_local(*local, datum), datum) == pytest.approx(local, abs=1e-8)


@pytest.mark.parametrize(('rpy', 'sensor', 'body'), [
    ((0, 0, 0), (1, 2, 3), (1, -2, -3)),  # x forward, y left, z up
    ((math.pi, 0, 0), (1, 2, 3), (1, 2, 3)),  # x forward, y right, z down
    ((0, 0, math.pi), (1, 2, 3), (-1, 2, -3)),  # x back, y right, z up
    ((0, 0, math.pi / 2), (1, 2, 3), (-2, -1, -3)),  # x left, y back, z up
    ((0, -math.pi / 2, 0), (1, 2, 3), (-3, -2, -1))])  # x up, z back
def test_quarter_turn_mountings_are_exact(rpy, sensor, body):
    assert np.array_equal(frames.mounting(rpy) @ sensor, body)


def test_mounting_is_urdf_rpy():
    # given roll, then pitch, then yaw about fixed axes
    rng = np.random.default_rng(1)
    for rpy in rng.uniform(-3, 3, (20, 3)):
        expected = np.diag([1, -1, -1]) @ Rotation.from_euler('xyz', rpy).as_matrix()
        assert frames.mounting(rpy) == pytest.approx(expected, abs=1e-14)


def test_yaw_of_enu_and_ned_are_each_other():
    # given east, north, west and south in REP-103, then 90, 0, -90 and +-180 degrees clockwise from north
    assert frames.yaw_from_enu(np.radians([0, 90, 180, -90])) == pytest.approx(np.radians([90, 0, -90, -180]))
    angle = np.linspace(-10, 10, 101)
    twice = frames.yaw_from_enu(frames.yaw_from_enu(angle))
    assert np.exp(1j * twice) == pytest.approx(np.exp(1j * angle), abs=1e-13)
    assert np.all((twice >= -math.pi) & (twice < math.pi))


def test_yaw_of_quaternion_is_scipys():
    rotation = Rotation.random(50, random_state=3)
    x, y, z, w = rotation.as_quat().T
    assert frames.yaw_of_quaternion(x, y, z, w) == pytest.approx(rotation.as_euler('ZYX')[:, 0], abs=1e-12)


def test_leveling_is_the_smallest_rotation_to_the_vertical():
    rng = np.random.default_rng(4)
    for _ in range(20):
        force = np.array([0, 0, -9.8]) + rng.normal(0, 2, 3)
        rotation = frames.leveling(force)
        assert rotation @ force == pytest.approx([0, 0, -np.linalg.norm(force)], abs=1e-12)
        vector = Rotation.from_matrix(rotation).as_rotvec()
        assert np.linalg.norm(vector) == pytest.approx(math.acos(-force[2] / np.linalg.norm(force)), abs=1e-9)
        assert vector @ force == pytest.approx(0, abs=1e-12)
    assert np.array_equal(frames.leveling(np.array([0.0, 0, -9.8])), np.eye(3))
    # when the sensor hangs upside down, and when it measures no force at all, which has no direction
    for force in ([0.0, 0, 9.8], [1e-13, 0, 9.8], [0.0, 0, 0]):
        rotation = frames.leveling(np.array(force))
        # then it is a rotation that makes the force vertical
        assert np.isclose(np.linalg.det(rotation), 1) and np.allclose(rotation @ rotation.T, np.eye(3))
        assert np.allclose(rotation @ force, [0, 0, -np.linalg.norm(force)])


def scipys(q):
    return Rotation.from_quat([q[1], q[2], q[3], q[0]])


def test_quaternion_mathematics_is_scipys():
    rng = np.random.default_rng(5)
    for scale in (1e-9, 1e-3, 0.0199, 0.0201, 1.0, 3.0):  # both sides of the series' limit
        a, b = rng.standard_normal((2, 3)) * scale
        qa, qb = strapdown.from_rotation_vector(*a), strapdown.from_rotation_vector(*b)
        ra, rb = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
        assert np.linalg.norm(qa) == pytest.approx(1, abs=1e-15)
        assert np.reshape(strapdown.matrix(qa), (3, 3)) == pytest.approx(ra.as_matrix(), abs=4e-15)
        assert np.reshape(strapdown.matrix(strapdown.multiply(qa, qb)), (3, 3)) == pytest.approx(
            (ra * rb).as_matrix(), abs=4e-15)
        corrected = strapdown.correct_attitude(qa, *b)
        assert (scipys(corrected) * (rb.inv() * ra).inv()).magnitude() < 4e-15


def test_euler_angles_are_scipys():
    rng = np.random.default_rng(6)
    for roll, pitch, yaw in rng.uniform(-1.5, 1.5, (20, 3)) * [2, 1, 2]:
        q = strapdown.from_euler(roll, pitch, yaw)
        assert (scipys(q) * Rotation.from_euler('ZYX', [yaw, pitch, roll]).inv()).magnitude() < 1e-14
        assert strapdown.to_euler(q) == pytest.approx((roll, pitch, yaw), abs=1e-12)


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_odometry_is_in_enu_and_flu(mechanization):
    # given a state with all of it nonzero and a covariance with all correlations
    config = configure(mechanization=mechanization)
    n = config.layout.n_navigation
    rng = np.random.default_rng(7)
    root = rng.standard_normal((n + config.layout.n_augmented,) * 2) * 0.1
    p = root @ root.T
    roll, pitch, yaw = (0.0, 0.0, 2.2) if config.mechanization == PLANAR else (0.1, -0.2, 2.2)
    velocity = (3.0, -4.0, 0.0 if config.mechanization == PLANAR else 0.5)
    memory = started(config, velocity=velocity, attitude=(roll, pitch, yaw), p=p)
    out, geodetic, geodetic_covariance = np.zeros(SIZE), np.zeros(3), np.zeros(9)
    views(memory)[3][-1, Sample.TIME] = -0.01  # the sample before
    # when seen from a datum elsewhere
    datum = np.array([0.8399, 0.2003, 470.0])
    odometry(memory, datum, 2.0, out, geodetic, geodetic_covariance)
    # then position and orientation are the rotated ones
    ned_to_enu, frd_to_flu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), np.diag([1, -1, -1])
    assert out[:3] == pytest.approx(ned_to_enu @ earth.to_local(*geodetic, datum), abs=1e-9)
    attitude = Rotation.from_euler('ZYX', [yaw, pitch, roll]).as_matrix()
    expected = ned_to_enu @ attitude @ frd_to_flu
    assert Rotation.from_quat(out[ORIENTATION:ORIENTATION + 4]).as_matrix() == pytest.approx(expected, abs=1e-12)
    assert out[LINEAR:LINEAR + 3] == pytest.approx(expected.T @ ned_to_enu @ velocity, abs=1e-12)
    # and the covariances are those of a perturbed pose and twist (sampled: 3 sigma of 40000 draws is 2 %)
    pose = out[POSE_COVARIANCE:POSE_COVARIANCE + 36].reshape(6, 6)
    twist = out[TWIST_COVARIANCE:TWIST_COVARIANCE + 36].reshape(6, 6)
    assert np.array_equal(geodetic_covariance.reshape(3, 3), pose[:3, :3])
    error = rng.multivariate_normal(np.zeros(n), p[:n, :n], size=40000) * 1e-2  # small: to first order
    nine = np.zeros((40000, 9))
    nine[:, [0, 1, 3, 4, 8] if config.mechanization == PLANAR else range(9)] = error
    seen = np.column_stack([nine[:, :3] @ ned_to_enu.T, nine[:, 6:] @ ned_to_enu.T])
    turned = Rotation.from_rotvec(nine[:, 6:]).as_matrix() @ attitude
    linear = np.einsum('kji,kj->ki', turned, velocity + nine[:, 3:6]) @ frd_to_flu - out[LINEAR:LINEAR + 3]
    known = [0, 1, 5] if config.mechanization == PLANAR else range(6)  # what planar does not estimate is a constant
    assert_covariance(seen[:, known] * 1e2, pose[np.ix_(known, known)])
    if config.mechanization != PLANAR:
        assert_covariance(linear * 1e2, twist[:3, :3])
    else:
        assert_covariance(linear[:, :1] * 1e2, twist[:1, :1])


def assert_covariance(samples, expected):
    sigma = np.sqrt(np.diag(expected))
    assert np.cov(samples.T) / np.outer(sigma, sigma) == pytest.approx(expected / np.outer(sigma, sigma), abs=0.03)


def test_angular_velocity_has_its_bias_removed():
    # given a sample with a rate about each axis (forward-left-up sensor), and estimated errors
    config = configure({'mechanization': 'strapdown', 'sensor_error_model': 'random_walk'})
    x = np.zeros(15)
    x[12:15] = 0.01, 0.02, 0.03  # w_x, w_y, w_z in b
    memory = started(config, x=x)
    take_sample(memory, 0.01, 0.0, 0.0, 9.8, 0.1, 0.2, 0.3)
    out = np.zeros(SIZE)
    odometry(memory, np.array([0.84, 0.2, 480.0]), 1.0, out, np.zeros(3), np.zeros(9))
    assert out[ANGULAR:ANGULAR + 3] == pytest.approx([0.1 - 0.01, 0.2 + 0.02, 0.3 + 0.03], abs=1e-15)
