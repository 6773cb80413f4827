"""The params files in config/ for vehicles that are no cars: each runs on such a vehicle, and why it is needed."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from filter_support import LATITUDE, LONGITUDE

from mems_ins_fusion.evaluation.metrics import NEES_95, Truth, position_errors, rms
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.navigation.earth import gravity, radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.params_file import load_yaml
from mems_ins_fusion.samples import Fixes, ImuSamples, Reference

CONFIG = Path(__file__).resolve().parents[1] / 'config'
RATE, HEIGHT = 50, 20.0


def recorded(forward, sideways, yaw, sigma, seed=1):
    """IMU (forward-left-up), fixes each second and truth of a body on level ground.

    forward, sideways (to the right) (k,): m/s at RATE; yaw (k,) rad, clockwise from north. sigma: m, of the fixes.
    """
    rng, n = np.random.default_rng(seed), len(yaw)
    time = np.arange(n) / RATE
    cos, sin = np.cos(yaw), np.sin(yaw)
    velocity = np.column_stack([cos * forward - sin * sideways, sin * forward + cos * sideways])
    position = np.cumsum(velocity, axis=0) / RATE
    acceleration = np.gradient(velocity, 1 / RATE, axis=0)
    force = np.column_stack([cos * acceleration[:, 0] + sin * acceleration[:, 1],
                             -(cos * acceleration[:, 1] - sin * acceleration[:, 0]),
                             np.full(n, gravity(LATITUDE, HEIGHT))])
    rate = np.column_stack([np.zeros(n), np.zeros(n), -np.gradient(yaw, 1 / RATE)])
    force += 0.02 * rng.standard_normal((n, 3)) + [0.03, -0.02, 0.02]
    rate += 0.001 * rng.standard_normal((n, 3)) + [0.002, -0.001, 0.003]
    meridian, prime_vertical = radii(LATITUDE)
    latitude = LATITUDE + position[:, 0] / (meridian + HEIGHT)
    longitude = LONGITUDE + position[:, 1] / ((prime_vertical + HEIGHT) * np.cos(LATITUDE))
    stamp = np.rint(time * 1e9).astype(np.int64) + 10**15
    at = np.arange(0, n, RATE)
    noise = sigma * rng.standard_normal((2, len(at)))
    fixes = Fixes(stamp[at], stamp[at], latitude[at] + noise[0] / meridian,
                  longitude[at] + noise[1] / (prime_vertical * np.cos(LATITUDE)), np.full(len(at), HEIGHT),
                  np.tile(np.diag([sigma**2, sigma**2, 4 * sigma**2]), (len(at), 1, 1)),
                  status=np.zeros(len(at), np.int8), covariance_type=np.full(len(at), 2, np.uint8))
    truth = Reference(stamp[::5], latitude[::5], longitude[::5], np.full(len(stamp[::5]), HEIGHT), yaw=yaw[::5])
    return ImuSamples(stamp, stamp, force, rate), fixes, Truth(truth, np.zeros(3), np.zeros(len(truth)), 'truth')


def errors(drive, values):
    imu, fixes, truth = drive
    return position_errors(run(FilterConfig.from_parameters(table.check(values)), imu, fixes), truth,
                           np.zeros(len(truth), dtype=bool))


def smooth(steps, seconds=1.0):
    """Steps (k,) at RATE as a vehicle can take them."""
    width = round(seconds * RATE)
    return np.convolve(np.pad(steps, width, mode='edge'), np.ones(width) / width, 'same')[width:-width]


@pytest.fixture(scope='module')
def boat():
    """Five minutes at 6 m/s on a winding course, across which wind and current set it by up to 1.5 m/s."""
    time = np.arange(300 * RATE) / RATE
    moving = smooth(np.where(time > 20, 6.0, 0.0), 8.0)
    return recorded(moving, moving / 4 * np.sin(0.05 * time), 0.8 * np.sin(0.007 * np.cumsum(moving) / RATE), 1.5)


@pytest.fixture(scope='module')
def robot():
    """Lanes of 12 s at 1 m/s, and at the end of each half a turn on the spot, with the IMU above the axle."""
    time = np.arange(300 * RATE) / RATE
    lane = time % 24.0
    forward = smooth(np.where((time > 12) & (lane > 0.5) & (lane < 12.5), 1.0, 0.0))
    turn = smooth(np.where((time > 12) & (lane > 15) & (lane < 21), np.pi / 6, 0.0))
    return recorded(forward, 0 * forward, 0.3 + np.cumsum(turn) / RATE, 0.02)


def test_a_boat_is_no_car(boat):
    given, car = errors(boat, load_yaml(CONFIG / 'boat.yaml')), errors(boat, {})
    assert rms(given.horizontal) < 2.0
    assert np.mean(given.nees < NEES_95) > 0.9
    # a car does not slip: who tells the filter so loses the boat
    assert rms(car.horizontal) > 2 * rms(given.horizontal)


def test_a_robot_turns_on_the_spot(robot):
    given = errors(robot, load_yaml(CONFIG / 'robot.yaml'))
    later = given.stamp > given.stamp[0] + 50 * 10**9
    assert rms(given.horizontal[later]) < 0.05
    # a turn on the spot is no standstill, although the accelerometers see none of it
    assert np.degrees(rms(given.heading[later])) < 2.0
    assert np.mean(given.nees[later] < NEES_95) > 0.9
