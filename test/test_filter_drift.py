"""What standstills teach the filter of its gyroscopes: a drive with stops, sensors better and worse than assumed."""
from __future__ import annotations

import numpy as np
import pytest
from filter_support import configure, newest

from mems_ins_fusion.filter import replay
from mems_ins_fusion.filter.layout import Nav
from mems_ins_fusion.filter.measurements.standstill import DRIFT_PRIOR, SMALLEST_RATIO
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.samples import Fixes, ImuSamples

RATE, STAND, GO, STOPS = 20, 10.0, 50.0, 14
ASSUMED, TAU = 1e-3, 100.0  # rad/s, s
CAR = {'vehicle.zero_velocity': True, 'vehicle.learn_drift': True, 'gyroscope.gauss_markov.sigma': [ASSUMED],
       'gyroscope.gauss_markov.tau': [TAU], 'gyroscope.noise_density': [5e-5]}


def stop_and_go(factor, seed=0):
    """A vehicle that goes straight on and stops, by a plain formula; its gyroscopes drift by `factor` of ASSUMED."""
    rng, period = np.random.default_rng(seed), STAND + GO
    time = np.arange(round((STOPS * period + STAND) * RATE)) / RATE
    phase = np.clip((time % period - STAND) / GO, 0.0, 1.0)
    speed = 12.0 * np.sin(np.pi * phase) ** 2
    force = np.zeros((len(time), 3))
    force[:, 0], force[:, 2] = np.gradient(speed, 1 / RATE), 9.81  # forward-left-up
    force += 0.02 * rng.standard_normal(force.shape) * (1.0 + 5.0 * (speed > 0.1))[:, None]
    keep, drift = np.exp(-1 / (RATE * TAU)), np.empty((len(time), 3))
    value = np.zeros(3)
    for k in range(len(time)):
        value = keep * value + factor * ASSUMED * np.sqrt(1 - keep**2) * rng.standard_normal(3)
        drift[k] = value
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


def ended(factor, seed=0, **values):
    """The newest row of the filter's memory after such a drive."""
    imu, fixes = stop_and_go(factor, seed)
    run = replay.run(configure({**CAR, **values}, mechanization=values.pop('mechanization', 'strapdown')), imu, fixes)
    return newest(run.memory)


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
@pytest.mark.parametrize('model', ['gauss_markov', 'random_walk'])
def test_the_drift_is_learned(mechanization, model):
    walk = {'sensor_error_model': model, 'gyroscope.random_walk.q': [ASSUMED * np.sqrt(2 / TAU)]}
    ratio = {factor: ended(factor, mechanization=mechanization, **walk)[Nav.DRIFT_RATIO] for factor in (0.1, 1.0, 4.0)}
    # then a sensor that is as assumed is taken for that, a better one for better, one that is worse for worse
    assert 0.4 < ratio[1.0] < 2.0 and ratio[0.1] < 0.6 * ratio[1.0] and ratio[4.0] > 3.0 * ratio[1.0], ratio
    # and a good one never for perfect: the assumed one keeps its weight
    assert ratio[0.1] > max(SMALLEST_RATIO, 0.5 * DRIFT_PRIOR / (DRIFT_PRIOR + 3 * STOPS)), ratio


def test_the_first_standstill_teaches_nothing():
    row = ended(1.0)
    assert row[Nav.STOPS] > STOPS - 3 and 0 < row[Nav.DRIFT_SEEN] <= 3 * (row[Nav.STOPS] - 1)


def test_without_it_the_noise_is_as_configured():
    row = ended(4.0, **{'vehicle.learn_drift': False})
    assert row[Nav.DRIFT_RATIO] == 1.0 and row[Nav.STOPS] == 0.0
