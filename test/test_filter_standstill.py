"""A robot that moves as quietly as it stands: what fixes say of a standstill that the accelerometers show."""
from __future__ import annotations

import numpy as np
import pytest
from filter_support import LATITUDE, LONGITUDE, configure, fix_event, started, take_all
from scipy.signal import lfilter
from scipy.stats import norm

from mems_ins_fusion.filter.memory import Event, Nav, Sample, sample_at, state_at
from mems_ins_fusion.filter.trust.standstill import (
    CREEP_SCATTER,
    CREEP_SPEED,
    CREEP_TIME,
    SPEED_DENSITY,
    STOP_SCATTER,
    STOPS_PER_CREEP,
    STOPS_PER_SMOOTH_ROAD,
    SURE_ODDS,
    is_still,
    odds_of_standing,
    velocity_sigma,
)
from mems_ins_fusion.navigation.earth import gravity, radii

METRES = radii(LATITUDE)[0]  # per radian of latitude, at height 0


def quiet(seconds, rng):
    """Samples (k, 7), 50 a second, of an IMU that neither accelerates nor turns, sensor axes."""
    samples = np.zeros((50 * seconds, 7))
    samples[:, 0] = np.arange(1, len(samples) + 1) / 50.0
    samples[:, 3] = gravity(LATITUDE, 0.0)
    samples[:, 1:] += rng.standard_normal((len(samples), 6)) * np.repeat([5e-3, 2e-4], 3)
    return samples


def fixes_of(north, interval, sigma, height=0.0):
    """Records of fixes that are `north`, m, of the start, one each `interval`, s, which claim sigma, m."""
    return np.array([fix_event(interval * (k + 1) - 0.001, LATITUDE + z / (METRES + height), LONGITUDE, height,
                                np.eye(2) * sigma**2) for k, z in enumerate(north)])


def through(north, interval, sigma, seed=1):
    """Time, s, position north, m, and velocity, m/s, of a filter that starts at rest, with quiet sensors and these
    fixes."""
    config = configure({'mechanization': 'planar', 'feedback': 'closed', 'vehicle.zero_velocity': True})
    memory = started(config, velocity=(0.1, 0.0, 0.0), attitude=(0.0, 0.0, 0.0))
    samples = quiet(round(len(north) * interval), np.random.default_rng(seed))
    rows, _ = take_all(memory, samples, fixes_of(north, interval, sigma),
                             [Nav.TIME, Nav.LATITUDE, Nav.V_N, Nav.NORTH_SCALE])
    return rows[:, 0], (rows[:, 1] - LATITUDE) / rows[:, 3], rows[:, 2]


@pytest.mark.parametrize(('sigma', 'interval'), [(0.1, 1.0), (0.5, 0.2), (1.5, 1.0), (1.5, 5.0)])
def test_a_robot_that_moves_as_quietly_as_it_stands_is_not_held_at_rest(sigma, interval):
    # given a robot that goes on at 0.4 m/s for three minutes as if it stood, and fixes
    truth = 0.4 * interval * np.arange(1, round(180.0 / interval) + 1)
    time, north, velocity = through(truth + sigma * np.random.default_rng(2).standard_normal(len(truth)), interval,
                                       sigma)
    # then a standstill is taken for one until the fixes have gone far enough to tell, and it is never far behind again
    far = np.abs(north - 0.4 * time)
    assert far[time > 10.0].max() < 14.0 * sigma + 2.0
    assert np.median(far[time > 90.0]) < 2.0 * sigma + 0.2
    assert np.median(velocity[time > 90.0]) == pytest.approx(0.4, abs=0.2)


def test_a_robot_that_starts_as_quietly_as_it_stands_is_soon_found_to_move():
    # given a robot that goes on at 0.4 m/s after two minutes at rest, without any vibration, and fixes
    truth = 0.4 * np.clip(np.arange(1, 241) - 120.0, 0.0, None)
    time, north, _ = through(truth + 0.5 * np.random.default_rng(8).standard_normal(240), 1.0, 0.5)
    # then it is behind for less than a minute
    far = np.abs(north - np.interp(time, np.arange(1, 241), truth))
    assert far.max() < 15.0 and far[time > 180.0].max() < 1.5


@pytest.mark.parametrize('kind', ['white', 'jump', 'wander'])
def test_fixes_of_a_vehicle_that_stands_do_not_contradict_it(kind):
    # given an hour at rest, and fixes that claim 0.5 m and scatter by that, or jump by 3 m, too, or claim 1 m, scatter
    # by 0.3 m and wander by 1 m
    rng = np.random.default_rng(3)
    claim, scatter = (1.0, 0.3) if kind == 'wander' else (0.5, 0.5)
    noise = scatter * rng.standard_normal(3600)
    if kind == 'jump':
        noise += 3.0 * (np.arange(3600) // 45 % 2)
    elif kind == 'wander':
        keep = np.exp(-1.0 / 30.0)
        noise += lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(3600))
    time, _, velocity = through(noise, 1.0, claim)
    # then the vehicle stays at rest
    assert np.abs(velocity[time > 10.0]).max() < 0.02


def test_a_vehicle_that_stands_does_not_gain_speed_without_accelerating():
    # given a vehicle that stands for two minutes, and fixes that drift away at 3 m/s from 60 s on
    north = 3.0 * np.clip(np.arange(1, 121) - 60.0, 0.0, None)
    time, _, velocity = through(north + 0.3 * np.random.default_rng(5).standard_normal(120), 1.0, 0.3)
    # then it is the receiver that is wrong
    assert np.abs(velocity[(time > 10.0) & (time < 85.0)]).max() < 0.05


def test_gyroscopes_that_show_zeros_only_and_are_configured_without_noise_do_no_harm():
    # given a minute at rest with gyroscopes that are dead, and no noise of theirs in the parameters
    config = configure({'mechanization': 'planar', 'vehicle.zero_velocity': True, 'gyroscope.noise_density': [0.0]})
    memory, samples = started(config, velocity=(0.0, 0.0, 0.0)), quiet(60, np.random.default_rng(6))
    samples[:, 4:] = 0.0
    rows, _ = take_all(memory, samples, fixes_of(np.zeros(60), 1.0, 1.5), [Nav.LATITUDE, Nav.V_N])
    # then the state stays finite, and at rest
    assert np.isfinite(rows).all() and np.abs(rows[500:, 1]).max() < 0.02


def test_what_is_certainly_slow_for_seconds_shows_how_quiet_the_vehicle_is_in_motion():
    # given a robot that goes at 0.3 m/s, certainly at first, and is as quiet as others at rest
    time = 0.01 * np.arange(6000)
    memory = configure({'mechanization': 'planar', 'vehicle.zero_velocity': True}).memory()
    sample, flags = sample_at(memory, 1), np.zeros(len(time), dtype=bool)
    for k in range(1, len(time)):
        memory[sample + Sample.F_X] = 0.02 * np.sin(3.0 * time[k])
        flags[k] = is_still(memory, sample, 0.01, 0.25 if time[k] < 30.0 else 0.0, 0.0, False)
    assert flags[(time > 1.6) & (time < 2.9)].any() and not flags[time > 10.0].any()


def test_a_stop_that_passes_for_slow_motion_does_not_hide_the_next_one():
    # given a car that stops twice for 8 s, and a filter that takes it for 1.4 +- 0.4 m/s for the first time
    time = 0.01 * np.arange(8000)
    stops = [(time > begin) & (time < begin + 8.0) for begin in (30.0, 60.0)]
    force = np.where(stops[0] | stops[1], 0.01, 0.1) * np.sin(3.0 * time)
    speed = np.where(stops[0], 0.6, np.where(stops[1], 0.0, 9.8))
    memory = configure({'mechanization': 'planar', 'vehicle.zero_velocity': True}).memory()
    sample, flags = sample_at(memory, 1), np.zeros(len(time), dtype=bool)
    for k in range(1, len(time)):
        memory[sample + Sample.F_X] = force[k]
        flags[k] = is_still(memory, sample, 0.01, speed[k], 0.4 if stops[0][k] else 0.1, False)
    # then the second one is seen, but for its first seconds
    assert flags[stops[1] & (time > 63.5)].all() and not flags[~(stops[0] | stops[1])].any()


@pytest.mark.parametrize('gap', [1.7, 10.0])
@pytest.mark.parametrize('before', [0.005, 0.2])
def test_a_vehicle_that_moves_after_a_gap_does_not_stand(gap, before):
    # given a car that stands, or moves, samples that are missing, and the car moving after that
    time = np.append(0.01 * np.arange(2000), 20.0 + gap + 0.01 * np.arange(300))
    memory = configure({'mechanization': 'planar', 'vehicle.zero_velocity': True}).memory()
    sample, flags = sample_at(memory, 1), np.zeros(len(time), dtype=bool)
    for k in range(1, len(time)):
        memory[sample + Sample.TIME] = time[k]
        steady, varying = (2.0, 0.2) if time[k] > 20.0 else (0.0, before)
        memory[sample + Sample.F_X] = steady + varying * np.sin(3.0 * time[k])
        flags[k] = is_still(memory, sample, time[k] - time[k - 1], 0.0, 2.0, False)
    # then it stands before the gap, or not, and not after it
    assert (flags[(time > 5.0) & (time < 20.0)] == (before < 0.1)).all() and not flags[time > 20.0].any()


def test_a_quiet_vehicle_stands_where_that_is_ten_times_as_likely_as_motion():
    # given estimated speeds and their sigmas, and for how long the vehicle has been as quiet as at rest
    speeds, sigmas, believed = np.geomspace(0.01, 30.0, 31), np.geomspace(0.02, 8.0, 9), []
    for sigma in sigmas:
        # then the odds by SciPy's distributions decide: of the estimated speed, and of how long a creep stays quiet
        stops = norm.pdf(speeds, 0.0, np.hypot(sigma, STOP_SCATTER))
        motion = (norm.pdf(speeds, CREEP_SPEED, np.hypot(sigma, CREEP_SCATTER)) / STOPS_PER_CREEP
                  + SPEED_DENSITY / STOPS_PER_SMOOTH_ROAD)
        for quiet_for in (0.0, 1.0, 5.0, 60.0):
            odds = stops / (motion / (1.0 + quiet_for / CREEP_TIME))
            found = np.array([odds_of_standing(speed, sigma**2, quiet_for) for speed in speeds])
            assert found == pytest.approx(odds, rel=1e-9)
            believed.append(np.mean(found > SURE_ODDS))
    assert 0.05 < np.mean(believed) < 0.95


@pytest.mark.parametrize(('estimate', 'sigma', 'speed', 'held'), [
    (0.8, 0.25, 0.8, False), (0.25, 0.25, 0.0, True), (12.0, 4.0, 0.0, True), (12.0, 0.5, 12.0, False)])
def test_a_vehicle_as_quiet_as_at_rest_stands_only_where_its_speed_may_be_zero(estimate, sigma, speed, held):
    # given a car without fixes, with this estimated speed and its standard deviation, and quiet samples for 9 s
    config = configure({'mechanization': 'planar', 'feedback': 'closed', 'vehicle.zero_velocity': True})
    covariance = np.diag([1.0, 1.0, sigma**2, 0.1**2, 0.02**2] + [1e-6] * (config.layout.n - 5))
    memory = started(config, velocity=(estimate, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=covariance)
    rows, _ = take_all(memory, quiet(9, np.random.default_rng(7)), np.zeros((0, Event.SIZE)), [Nav.V_N])
    # then its speed is within three sigma of the true one
    assert (abs(rows[-1, 0]) < 0.02) == held
    assert abs(rows[-1, 0] - speed) < 3.0 * velocity_sigma(memory, state_at(memory, len(rows)))


def test_a_car_with_fixes_does_not_stand_at_a_speed_that_they_show():
    # given a car on a road without any unevenness, 9.85 +- 3 m/s by the filter, and fixes of such a car
    config = configure({'mechanization': 'planar', 'feedback': 'closed', 'vehicle.zero_velocity': True})
    covariance = np.diag([1.0, 1.0, 9.0, 0.1**2, 0.02**2] + [1e-6] * (config.layout.n - 5))
    memory = started(config, velocity=(9.85, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=covariance)
    fixes = fixes_of(9.85 * (np.arange(20) + 1.0), 1.0, 30.0)  # imprecise: the velocity remains as unsure as it is
    rows, _ = take_all(memory, quiet(20, np.random.default_rng(7)), fixes, [Nav.V_N])
    # then it goes on
    assert np.abs(rows[:, 0] - 9.85).max() < 1.0
