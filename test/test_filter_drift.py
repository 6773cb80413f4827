"""What the filter learns of its sensors' drift: a drive with stops, sensors better and worse than assumed."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_support import configure, newest, started

from mems_ins_fusion.filter.memory import NAV, Head, Nav
from mems_ins_fusion.filter.runs import replay
from mems_ins_fusion.filter.trust.drift import (
    DRIFT_MEMORY,
    DRIFT_PRIOR,
    DRIFT_WINDOW,
    Drift,
    learn_drift,
)
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.samples import Fixes, ImuSamples

RATE, STAND, GO, STOPS = 20, 10.0, 50.0, 14
ASSUMED, ASSUMED_FORCE, TAU = 1e-3, 0.02, 100.0  # rad/s, m/s^2, s
CAR = {'mechanization': 'strapdown', 'vehicle.zero_velocity': True, 'vehicle.learn_drift': True,
       'gyroscope.gauss_markov.sigma': [ASSUMED],
       'gyroscope.gauss_markov.tau': [TAU], 'gyroscope.noise_density': [5e-5],
       'accelerometer.gauss_markov.sigma': [ASSUMED_FORCE], 'accelerometer.gauss_markov.tau': [TAU],
       'accelerometer.initial_sigma': [0.05]}
GYROSCOPES = Drift.RATIO + 1


def stop_and_go(factor, seed=0, force_factor=1.0):
    """A vehicle that goes straight on and stops, by a plain formula; its sensors drift by these
    factors of ASSUMED and ASSUMED_FORCE."""
    rng, period = np.random.default_rng(seed), STAND + GO
    time = np.arange(round((STOPS * period + STAND) * RATE)) / RATE
    phase = np.clip((time % period - STAND) / GO, 0.0, 1.0)
    speed = 12.0 * np.sin(np.pi * phase) ** 2
    force = np.zeros((len(time), 3))
    force[:, 0], force[:, 2] = np.gradient(speed, 1 / RATE), 9.81  # forward-left-up
    force += 0.02 * rng.standard_normal(force.shape) * (1.0 + 5.0 * (speed > 0.1))[:, None]
    keep, drift = np.exp(-1 / (RATE * TAU)), np.empty((len(time), 6))
    value, size = np.zeros(6), np.repeat([factor * ASSUMED, force_factor * ASSUMED_FORCE], 3)
    for k in range(len(time)):
        value = keep * value + size * np.sqrt(1 - keep**2) * rng.standard_normal(6)
        drift[k] = value
    drift, force = drift[:, :3], force + drift[:, 3:]
    rate = drift + 5e-5 * np.sqrt(RATE) * rng.standard_normal(drift.shape)
    stamp = (time * 1e9).astype(np.int64)
    imu = ImuSamples(stamp, stamp, force, rate)
    each = slice(RATE // 2, None, RATE)
    north = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / RATE)])[each]
    n = len(north)
    sigma, (meridian, prime_vertical) = 0.02, radii(0.8)
    return imu, Fixes(stamp[each], stamp[each], 0.8 + (north + sigma * rng.standard_normal(n)) / meridian,
                      0.2 + sigma * rng.standard_normal(n) / (prime_vertical * np.cos(0.8)), np.zeros(n),
                      np.tile(sigma**2 * np.eye(3), (n, 1, 1)), status=np.zeros(n, np.int8),
                      covariance_type=np.full(n, 2, np.uint8))


def ended(factor, seed=0, force_factor=1.0, **values):
    """The newest row of the filter's memory after such a drive."""
    imu, fixes = stop_and_go(factor, seed, force_factor)
    run = replay.run(configure({**CAR, **values}), imu, fixes)
    return newest(run.memory)


@pytest.mark.parametrize('model', ['gauss_markov', 'random_walk'])
def test_the_drift_is_learned(model):
    walk = {'sensor_error_model': model, 'gyroscope.random_walk.q': [ASSUMED * np.sqrt(2 / TAU)],
            'accelerometer.random_walk.q': [ASSUMED_FORCE * np.sqrt(2 / TAU)]}
    ratio = {factor: ended(factor, **walk)[GYROSCOPES] for factor in (0.1, 1.0, 4.0)}
    # then a sensor that is as assumed is taken for that, a better one for better, one that is worse for worse
    assert 0.4 < ratio[1.0] < 2.0 and ratio[0.1] < 0.4 * ratio[1.0] and ratio[4.0] > 4.0 * ratio[1.0], ratio
    # and a good one never for perfect: the assumed one keeps its weight
    assert ratio[0.1] > 0.9 * DRIFT_PRIOR / (DRIFT_PRIOR + DRIFT_MEMORY), ratio


def test_that_of_the_accelerometers_is_learned_beside_it():
    rows = {factor: ended(1.0, force_factor=factor) for factor in (0.2, 1.0, 4.0)}
    ratio = {factor: row[Drift.RATIO] for factor, row in rows.items()}
    # then a better one never counts as better than assumed
    assert ratio[0.2] == 1.0 <= ratio[1.0] < 2.0 and ratio[4.0] > 4.0 * ratio[1.0], ratio
    # and the gyroscopes are not blamed for it
    assert all(0.3 < row[GYROSCOPES] < 3.0 for row in rows.values())


def test_the_bias_that_a_sensor_was_switched_on_with_is_no_drift():
    # given gyroscopes whose bias, unknown at the start, is up to 20 times what they drift
    imu, fixes = stop_and_go(1.0)
    moving = imu.select(slice(round((STAND + 10.0) * RATE), None))
    biased = replace(moving, angular_rate=moving.angular_rate + [0.01, -0.02, 0.015])
    row = newest(replay.run(configure({**CAR, 'gyroscope.initial_sigma': [0.02]}), biased, fixes).memory)
    # then it is not taken for one that its model lets decay: that would be 35 times the drift
    assert 0.3 < row[GYROSCOPES] < 8.0


@pytest.mark.parametrize(('values', 'why'), [({'vehicle.learn_drift': False}, 'not asked for'),
                                             ({'sensor_error_model': 'autoregressive'}, 'steps as configured'),
                                             ({'mechanization': 'planar'}, 'slopes are no drift')])
def test_without_it_the_noise_is_as_configured(values, why):
    row = ended(4.0, **values)
    assert row[Drift.RATIO] == row[GYROSCOPES] == 1.0 and not row[Drift.WEIGHT:Drift.WEIGHT + 2].any(), why


@pytest.mark.parametrize(('constraints', 'factor', 'moved', 'ratio'), [
    (False, 1.0, 4.0, 2.5),  # innovations are white: the sensors
    (False, 4.0, 4.0, 1.0),  # as much as the receiver explains
    (False, 2.0, 4.0, 1.5),  # more than that
    (False, 4.0, 0.25, 0.625),  # and less than expected is less, whoever errs
    (True, 4.0, 4.0, 2.5)])  # who stands still, or does not slip, is not moved by a receiver
def test_what_a_receiver_may_have_moved_is_no_drift(constraints, factor, moved, ratio):
    # given one window of estimates that have moved by so much more in square than fixes have told
    config = configure({**CAR, 'sensor_error_model': 'random_walk', 'gyroscope.random_walk.q': [1e-5],
                        'vehicle.zero_velocity': constraints})
    memory = started(config)
    r, x, e = int(memory[Head.ROWS_AT]), NAV + 9, NAV + 15 + 9 * 15
    told = 0.5 * DRIFT_WINDOW * 1e-10
    memory[r + Nav.TIME], memory[r + Drift.TIME], memory[r + Nav.VARIANCE_FACTOR] = 1.0 + DRIFT_WINDOW, 1.0, factor
    for k in range(3, 6):
        memory[r + Drift.BIAS_VARIANCE + k] = memory[r + Drift.BIAS + k] = 1e-9
        memory[r + x + k] = 1e-9 + np.sqrt(moved * told)
        memory[r + e + 7 * k] = 1e-9 + told
    # when it has ended
    learn_drift(memory, r)
    assert memory[r + Drift.RATIO + 1] == pytest.approx(ratio)
