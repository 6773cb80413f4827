"""Fixes, IMU and the vehicle's constraint contradict each other: a slide, and what nothing decides."""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import (
    LATITUDE,
    LONGITUDE,
    configure,
    fix_event,
    newest,
    random_covariance,
    started,
    take_all,
    take_sample,
)

from mems_ins_fusion.filter.memory import (
    NAV,
    Event,
    Head,
    Kind,
    Nav,
    Sample,
    covariance,
    sample_at,
    set_covariance,
    state_at,
)
from mems_ins_fusion.filter.runs.odometry import POSE_COVARIANCE, SIZE, odometry, published_covariance
from mems_ins_fusion.filter.runs.vehicle_check import vehicle_warnings
from mems_ins_fusion.filter.trust.contradiction import (
    INFLATED_NIS,
    USE_ALL_TIME,
    inflate_to_fit,
    raise_uncertainty,
    slides,
)
from mems_ins_fusion.filter.trust.hypotheses import Hypothesis, spread
from mems_ins_fusion.navigation.earth import gravity, radii
from mems_ins_fusion.navigation.strapdown import to_euler

BOTH = pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
CAR = {'vehicle.non_holonomic': True, 'vehicle.zero_velocity': True, 'gnss.gate_probability': 0.999999,
       'gnss.robust_sigma': 3.0}
STEP = 0.1


def a_state(mechanization='strapdown', **more):
    """Configuration, memory and position of its first state, north at 10 m/s."""
    config = configure({**CAR, **more}, mechanization=mechanization)
    memory = started(config, velocity=(10.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0))
    return config, memory, state_at(memory, 0)


def slid(memory, r, innovations, s=0.04):
    return [slides(memory, r, z, s, STEP) for z in innovations]


def noise(sigma, seconds, seed=1):
    return sigma * np.random.default_rng(seed).standard_normal(round(seconds / STEP))


@pytest.mark.parametrize('usual', [0.02, 0.06])  # m/s: both well within the constraint's sigma of 0.2
def test_a_slide_is_one_beside_what_is_usual_for_the_vehicle(usual):
    # given a vehicle that has kept to its lane for two minutes
    _, memory, r = a_state()
    assert not any(slid(memory, r, noise(usual, 120.0)))
    # when it slides a dozen times as fast as usual, it is seen within a second
    assert any(slid(memory, r, np.full(10, 15.0 * usual + 0.2)))


def test_who_always_slides_is_not_told_of_it():
    # given a vehicle to which the constraint does not apply, 2 m/s sideways in waves
    _, memory, r = a_state()
    slid(memory, r, noise(2.0, 120.0))
    # then that is what is usual
    assert not any(slid(memory, r, noise(2.0, 120.0, seed=2)))


@BOTH
def test_after_a_slide_velocity_and_heading_are_as_uncertain_as_it_is_large(mechanization):
    # given a covariance in the scratch
    config, memory, r = a_state(mechanization)
    n, p = config.layout.n, int(memory[Head.SCRATCH_AT])
    before = random_covariance(n, np.random.default_rng(3))
    memory[p:p + n * n] = before.ravel()
    # when the vehicle slides by 1.5 m/s at 10 m/s
    raise_uncertainty(memory, r, n, 1.5, STEP)
    added = memory[p:p + n * n].reshape(n, n) - before
    # then by its square: of velocities, and of the angle whose sine it is at that speed
    expected = np.zeros(n)
    names = config.layout.names
    expected[[names.index('v_n'), names.index('v_e')]] = 1.5**2
    expected[names.index('yaw' if mechanization == 'planar' else 'phi_d')] = 0.15**2
    np.testing.assert_allclose(added, np.diag(expected), atol=1e-12)
    assert memory[r + Nav.USE_ALL_FIXES] == USE_ALL_TIME and memory[r + Nav.SLID] == STEP


@BOTH
def test_a_loosened_state_fits_a_fix_that_contradicts_it(mechanization):
    config, memory, r = a_state(mechanization)
    n, p, first = config.layout.n, int(memory[Head.SCRATCH_AT]), config.layout.n_navigation
    before = 0.01 * random_covariance(n, np.random.default_rng(4))
    memory[p:p + n * n] = before.ravel()
    # given an exact fix that is off by a normalized innovation of 50
    z = np.array([3.0, 4.0])
    z *= math.sqrt(50.0 / (z @ np.linalg.solve(before[:2, :2], z)))
    assert inflate_to_fit(memory, r, n, 50.0)
    after = memory[p:p + n * n].reshape(n, n)
    # then it fits as well as it has to, the sensor errors are as they were, and it is a covariance
    assert z @ np.linalg.solve(after[:2, :2], z) == pytest.approx(INFLATED_NIS)
    np.testing.assert_array_equal(after[first:, first:], before[first:, first:])
    np.testing.assert_allclose(after, after.T)
    assert np.linalg.eigvalsh(after).min() > 0.0


@BOTH
def test_a_velocity_is_not_wrong_by_more_than_itself_and_the_fix_then_an_outlier(mechanization):
    # given a vehicle at 10 m/s whose velocity is known to 1 m/s, and a fix with a normalized innovation of 1e6
    config, memory, r = a_state(mechanization)
    n, p, first = config.layout.n, int(memory[Head.SCRATCH_AT]), config.layout.names.index('v_n')
    memory[p:p + n * n] = np.eye(n).ravel()
    fits = inflate_to_fit(memory, r, n, 1e6)
    # then the velocity is uncertain by 10 m/s, and the fix does not fit
    assert not fits and memory[p + (n + 1) * first] == pytest.approx(100.0)


@BOTH
def test_fix_after_fix_leaves_an_attitude_that_is_not_known_at_all(mechanization):
    # given 300 fixes in a row with a normalized innovation of 5, as without an IMU, which nothing else corrects
    config, memory, r = a_state(mechanization)
    n, p, names = config.layout.n, int(memory[Head.SCRATCH_AT]), config.layout.names
    moved = 4 if mechanization == 'planar' else 6
    memory[p:p + n * n] = (1e-4 * random_covariance(n, np.random.default_rng(4))).ravel()
    for _ in range(300):
        assert inflate_to_fit(memory, r, n, 5.0)
        position = memory[p:p + n * n].reshape(n, n)
        position[:moved] /= math.sqrt(2.5)  # the fix corrects position and velocity
        position[:, :moved] /= math.sqrt(2.5)
    after = memory[p:p + n * n].reshape(n, n)
    # then roll and pitch are known to 0.3 rad, a heading as one of any direction, and it is a covariance
    sigma = np.sqrt(np.diag(after))
    yaw = names.index('yaw' if mechanization == 'planar' else 'phi_d')
    assert sigma[yaw] == pytest.approx(math.pi / math.sqrt(3.0))
    if mechanization == 'strapdown':
        assert sigma[[names.index('phi_n'), names.index('phi_e')]] == pytest.approx(0.3)
    assert np.linalg.eigvalsh(after / np.outer(sigma, sigma)).min() > 0.0


def test_fixes_are_used_whatever_their_innovation_for_a_time_also_where_no_constraint_is_applied():
    # given a heading that is not known, so that the constraint leaves it to the fixes, after a slide
    config = configure(CAR, mechanization='strapdown')
    sigma = np.where(np.array(config.layout.names) == 'phi_d', 1.5, 0.01)
    memory = started(config, velocity=(10.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag(sigma**2))
    memory[state_at(memory, 0) + Nav.USE_ALL_FIXES] = USE_ALL_TIME
    # when it drives on
    left = []
    for k in range(1, round(1.1 * USE_ALL_TIME / 0.01)):
        memory[state_at(memory, k - 1) + Nav.FIX_TIME] = 0.01 * (k - 1) + 1e-9
        take_sample(memory, 0.01 * k, 0.3 * math.sin(k), 0.0, 9.81, 0.0, 0.0, 0.0)
        left.append(newest(memory)[Nav.USE_ALL_FIXES])
    assert left[999] == pytest.approx(USE_ALL_TIME - 10.0, abs=0.2) and left[-1] == 0.0


@BOTH
def test_one_that_fits_loosens_nothing(mechanization):
    config, memory, r = a_state(mechanization)
    before = memory.copy()
    inflate_to_fit(memory, r, config.layout.n, 0.99 * INFLATED_NIS)
    np.testing.assert_array_equal(memory, before)


@BOTH
def test_what_is_published_holds_both_hypotheses(mechanization):
    # given a state, 3 s after a fix, that another hypothesis has 6 m and 1 m/s further east and 4 m further north
    config, memory, r = a_state(mechanization)
    memory[r + Nav.TIME], memory[r + Nav.FIX_TIME], memory[r + Nav.VARIANCE_FACTOR] = 13.0, 10.0, 2.0
    memory[r + Hypothesis.SPREAD:r + Hypothesis.SPREAD + 4] = 4.0, 6.0, 0.0, 1.0
    memory[r + Hypothesis.SPREAD_VARIANCE] = 2.0  # to 2 m, and its probability is a half
    row = memory[r:r + int(memory[Head.WIDTH])]
    # then the square of that is added, 9 m by now, and what the position is not known by the other
    added = published_covariance(row, config.layout) - 2.0 * covariance(row, config.layout)
    expected = np.zeros_like(added)
    where = [0, 1, config.layout.index('v_e')]
    expected[np.ix_(where, where)] = np.outer([4.0, 9.0, 1.0], [4.0, 9.0, 1.0]) + np.diag([2.0, 2.0, 0.0])
    np.testing.assert_allclose(added, expected, atol=1e-12)
    # and ROS is told the same
    out, enu = np.zeros(SIZE), np.zeros(9)
    odometry(memory, np.array([LATITUDE, LONGITUDE, 0.0]), 2.0, out, np.zeros(3), enu)
    pose = out[POSE_COVARIANCE:POSE_COVARIANCE + 36].reshape(6, 6)
    full = published_covariance(row, config.layout)
    np.testing.assert_allclose(pose[:2, :2], [[full[1, 1], full[0, 1]], [full[0, 1], full[0, 0]]])


class Drive:
    """North at 10 m/s for 60 s at 50 Hz, fixes of 0.5 m each second, or others; without an error what is true is known.
    """

    def __init__(self, rate=1.0, noise=0.5):
        self.noise = noise
        rng = np.random.default_rng(5)
        self.samples = np.zeros((3000, 7))
        self.samples[:, 0] = np.arange(1, 3001) / 50.0
        self.samples[:, 3] = -gravity(LATITUDE, 480.0)
        self.samples[:, 1:] += rng.standard_normal((3000, 6)) * np.repeat([0.03, 1e-3], 3)
        self.time = np.arange(0.51, 59.0, 1.0 / rate)
        self.position = np.stack([10.0 * self.time, np.zeros(len(self.time))], axis=1)
        self.position += noise * rng.standard_normal((len(self.time), 2))

    def through(self, mechanization, late=0.0, **more):
        """Configuration, memory, of each sample error (k, 2), m, and `spread` of the position (k, 2), m; late: s, of
        each fix."""
        config = configure({**CAR, **more}, mechanization=mechanization)
        n, first = config.layout.n, config.layout.n_navigation
        p = np.diag(np.concatenate([np.square([1, 1, .2, .2, .02] if first == 5 else
                                              [1, 1, 1, .2, .2, .2, .005, .005, .02]), np.full(n - first, 1e-6)]))
        memory = started(config, velocity=(10.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=p)
        scale = np.array([radii(LATITUDE)[0] + 480.0, (radii(LATITUDE)[1] + 480.0) * math.cos(LATITUDE)])
        r = self.noise**2 * np.eye(2)
        events = np.array([fix_event(t, LATITUDE + north / scale[0], LONGITUDE + east / scale[1], r=r)
                            for t, (north, east) in zip(self.time, self.position)])
        kept = [Nav.TIME, Nav.LATITUDE, Nav.LONGITUDE, Nav.FIX_TIME,
                *range(Hypothesis.SPREAD, Hypothesis.SPREAD + 4)]
        states, events = take_all(memory, self.samples, events, kept, late)
        rows = np.zeros((len(states), Nav.SIZE))
        rows[:, kept] = states
        truth = np.stack([10.0 * rows[:, Nav.TIME], np.zeros(len(rows))], axis=1)
        error = (rows[:, [Nav.LATITUDE, Nav.LONGITUDE]] - [LATITUDE, LONGITUDE]) * scale - truth
        sigma = np.abs([spread(row, 0)[:2] for row in rows])
        return config, memory, error, sigma, events


@BOTH
def test_nothing_is_open_where_all_is_right(mechanization):
    config, memory, error, sigma, events = Drive().through(mechanization)
    assert newest(memory)[Nav.SLID] == 0.0
    assert np.hypot(*sigma.T).max() < 0.5 and np.hypot(*error.T).max() < 2.0
    assert not any('sideways' in text for text in vehicle_warnings(memory, config, events))


def test_a_gyroscope_that_turns_away_is_seen_and_said():
    # given a gyroscope that shows 5 deg/s of a turn for 10 s where there is none
    drive = Drive()
    drive.samples[1500:2000, 6] += math.radians(5.0)
    config, memory, error, _, events = drive.through('planar')
    # then the fixes decide: by the IMU and the constraint it would be v w t^2 / 2 = 44 m off
    assert newest(memory)[Nav.SLID] > 1.0
    assert np.hypot(*error.T).max() < 6.0 and np.hypot(*error[-500:].T).max() < 2.0
    assert any('sideways' in text for text in vehicle_warnings(memory, config, events))


def test_how_long_an_imu_was_contradicted_is_counted_once_whatever_comes_late():
    # given the same gyroscope, and fixes in time and late: the filter goes over each second once more
    counted = []
    for late in (0.0, 0.6):
        drive = Drive()
        drive.samples[1500:2000, 6] += math.radians(5.0)
        _, memory, *_ = drive.through('planar', late)
        counted.append(newest(memory)[Nav.SLID])
    # then it is the time that it was so
    assert 1.0 < counted[0] and counted[1] == pytest.approx(counted[0], rel=0.2)


def test_where_each_fix_is_believed_nothing_is_decided_against_the_imu():
    # given the same gyroscope, and the filter that a diagnosis looks through
    drive = Drive()
    drive.samples[1500:2000, 6] += math.radians(5.0)
    _, memory, *_ = drive.through('planar', **{'gnss.gate_probability': 1.0, 'gnss.robust_sigma': 0.0})
    # then the misfit stays in what it measures: what adapted to it would hide its cause
    assert newest(memory)[Nav.SLID] == 0.0


def as_quiet_as_at_rest(mechanization, seconds, off, velocity=(0.0, 0.0, 0.0)):
    """Configuration and newest state of a filter that is sure of its velocity, m/s, after so long with samples as quiet
    as at rest; off: rad/s, (k,) of what the vertical gyroscope shows besides, 50 a second."""
    config = configure(CAR, mechanization=mechanization)
    n, first = config.layout.n, config.layout.n_navigation
    sigma = [1, 1, .05, .05, .02] if first == 5 else [1, 1, 1, .05, .05, .05, .001, .001, .02]
    p = np.diag(np.concatenate([np.square(sigma), np.full(n - first, 1e-8)]))
    memory = started(config, velocity=velocity, attitude=(0.0, 0.0, 0.0), p=p)
    samples = np.zeros((round(50 * seconds), 7))
    samples[:, 0] = np.arange(1, len(samples) + 1) / 50.0
    samples[:, 3] = gravity(LATITUDE, 480.0)
    samples[:, 1:] += np.random.default_rng(2).standard_normal((len(samples), 6)) * np.repeat([5e-3, 2e-4], 3)
    samples[:, 6] += off
    take_all(memory, samples, np.zeros((0, Event.SIZE)), [Nav.TIME])
    return config, newest(memory)


@BOTH
@pytest.mark.parametrize('begin', [0.0, 12.0])
def test_a_gyroscope_that_is_off_does_not_turn_a_parked_car(mechanization, begin):
    # given a car that stands, and a gyroscope that is 5 deg/s off for 8 s, from before it is known to stand or later
    time = np.arange(1500) / 50.0
    off = np.where((time >= begin) & (time < begin + 8.0), math.radians(5.0), 0.0)
    config, row = as_quiet_as_at_rest(mechanization, 30.0, off)
    first = config.layout.n_navigation
    heading = math.degrees(row[Nav.YAW] if first == 5 else to_euler(row[Nav.Q_W:Nav.Q_Z + 1])[2])
    sigma = math.degrees(math.sqrt(covariance(row, config.layout)[first - 1, first - 1]))
    error = math.degrees(row[NAV + config.layout.n_sensor + first - 1])
    # then the heading is as it was, or the filter knows that it may not be, and the gyroscope is right again
    assert abs(heading) < 2.0 * sigma < 30.0 and abs(error) < 0.05, (heading, sigma, error)


@BOTH
def test_an_error_that_a_gyroscope_has_got_at_a_standstill_may_go_while_the_vehicle_drives(mechanization):
    # given a car that stands for 20 s, whose gyroscope is 5 deg/s off from the twelfth on, and that drives off then
    config = configure(CAR, mechanization=mechanization)
    columns = Sigmas(config)
    off = np.where(np.arange(4500) / 50.0 >= 12.0, math.radians(5.0), 0.0)
    time, errors, sigmas = columns.of(driven_off(20.0, 90.0, off))
    # then the standstill tells the error well, and in the seconds after it nothing says that it still lasts
    at = [np.searchsorted(time, t) for t in (19.9, 20.5, 21.0)]
    assert errors[at] == pytest.approx([-5.0] * 3, abs=0.2) and sigmas[at[0]] < 0.2
    # of an error d that ends with a probability of dt / (10 s + age) the variance grows by d^2 times that
    for k in at[1:]:
        age = time[k] - 12.0
        assert sigmas[k] == pytest.approx(5.0 * math.sqrt(math.log((10.0 + age) / (10.0 + 7.9))), rel=0.1)
    # and the error of a gyroscope that has not changed is as well known as before
    _, _, usual = columns.of(driven_off(20.0, 90.0, np.zeros(4500)))
    assert usual[at[2]] < 0.1
    # an error that has lasted for a minute is the sensor's own, and what the constraint tells of it adds up
    assert np.all(np.diff(sigmas[[np.searchsorted(time, t) for t in (74.0, 78.0, 84.0, 89.0)]]) < 0.0)


class Sigmas:
    """A filter that starts at rest, and what it says of its vertical gyroscope."""

    def __init__(self, config):
        first = config.layout.n_navigation
        self.config, self.state = config, first + config.layout.n_sensor - 1
        sigma = [1, 1, .05, .05, .02] if first == 5 else [1, 1, 1, .05, .05, .05, .001, .001, .02]
        self.p = np.diag(np.concatenate([np.square(sigma), np.full(config.layout.n - first, 1e-8)]))

    def of(self, samples):
        """Time, s, and estimated error and sigma, deg/s, each tenth of a second."""
        memory = started(self.config, velocity=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=self.p)
        rows = []
        for part in np.split(samples, np.arange(5, len(samples), 5)):
            take_all(memory, part, np.zeros((0, Event.SIZE)), [Nav.TIME])
            row = newest(memory)
            p = covariance(row, self.config.layout)[self.state, self.state]
            rows.append((row[Nav.TIME], math.degrees(row[NAV + self.state]), math.degrees(math.sqrt(p))))
        return np.array(rows).T


def driven_off(stop, end, off):
    """Samples (k, 7), 50 a second, of a car that stands until `stop`, s, and then gains 1 m/s each second for 10 s on a
    bumpy road; off: rad/s, (k,), what the vertical gyroscope shows besides."""
    samples = np.zeros((round(50 * end), 7))
    time = samples[:, 0] = np.arange(1, len(samples) + 1) / 50.0
    samples[:, 3] = gravity(LATITUDE, 480.0)
    samples[:, 1:] += np.random.default_rng(2).standard_normal((len(samples), 6)) * np.repeat([5e-3, 2e-4], 3)
    moves = time > stop
    samples[:, 1] += np.where(moves & (time < stop + 10.0), 1.0, 0.0) + np.where(moves, 0.3 * np.sin(3.0 * time), 0.0)
    samples[:, 6] += off
    return samples


@BOTH
@pytest.mark.parametrize(('rate', 'stands'), [(0.0, False), (5.0, True)])
def test_a_speed_denies_a_standstill_unless_a_gyroscope_turns_that_has_misled_it(mechanization, rate, stands):
    # given a filter that is sure of 0.8 m/s, and sensors as quiet as at rest, but for a gyroscope
    _, row = as_quiet_as_at_rest(mechanization, 8.0, math.radians(rate), (0.8, 0.0, 0.0))
    # then one that goes straight on creeps smoothly, and one that turns stands
    speed = np.hypot(row[Nav.V_N], row[Nav.V_E])
    assert speed < 0.1 if stands else 0.6 < speed < 1.0


@BOTH
def test_fixes_that_drift_away_widen_what_is_published(mechanization):
    # given fixes that drift ahead by 4 m/s for 10 s, which no constraint contradicts
    drive = Drive()
    drive.position[:, 0] += 4.0 * np.clip(drive.time - 30.0, 0.0, 10.0)
    _, memory, error, sigma, _ = drive.through(mechanization)
    # then where it has been moved from is within the 95 % ellipse of what is published, but for its first seconds (less
    # than 12 m is what comes of using no fixes, and in P)
    later = slice(round(36.0 * 50), round(41.0 * 50))
    far = np.abs(error[later, 0]) > 12.0
    assert far.any()
    assert (np.abs(error[later, 0]) < 2.45 * sigma[later, 0] + 2.0)[far].mean() > 0.9


@pytest.mark.parametrize('heading_sigma, since_fix, is_applied',
                         [(0.3, 1.0, True), (0.7, 1.0, False), (0.7, 20.0, True)])
@BOTH
def test_no_constraint_on_an_unknown_heading_that_fixes_will_find(mechanization, heading_sigma, since_fix, is_applied):
    # given a vehicle in motion, its heading more or less known, the last fix some time ago
    config, memory, r = a_state(mechanization)
    row = memory[r:r + int(memory[Head.WIDTH])]
    p = 1e-4 * np.eye(config.layout.n)
    p[config.layout.n_navigation - 1] *= heading_sigma**2 / 1e-4
    set_covariance(row, config.layout, p)
    row[Nav.FIX_TIME] = -since_fix
    # when the constraint's turn comes
    samples = np.zeros((10, 7))
    samples[:, 0] = np.arange(1, 11) / 50.0
    samples[:, 3] = gravity(LATITUDE, 480.0)
    take_all(memory, samples, np.zeros((0, Event.SIZE)), [Nav.TIME])
    # then it is applied where it is linear, or where nothing else holds the vehicle
    applied = [memory[sample_at(memory, k) + Sample.CONSTRAINT] == Kind.NON_HOLONOMIC for k in range(1, 11)]
    assert any(applied) == is_applied
