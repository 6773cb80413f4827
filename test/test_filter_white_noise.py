"""The white noise that samples show themselves: an IMU in a vehicle that shakes it, by plain formulas."""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import configure, started, take_all, take_sample

from mems_ins_fusion.filter.memory import (
    Event,
    Head,
    Kind,
    Sample,
    covariance,
    covariance_index,
    row_width,
    sample_at,
    state_at,
)
from mems_ins_fusion.filter.runs.odometry import SIZE, TWIST_COVARIANCE, odometry
from mems_ins_fusion.filter.runs.vehicle_check import LONGEST_SHAKEN, vehicle_warnings
from mems_ins_fusion.filter.trust import force_noise, white_noise
from mems_ins_fusion.filter.trust.white_noise import Shown, White
from mems_ins_fusion.navigation.strapdown import State

RATE = 20.0
STRAPDOWN = {'mechanization': 'strapdown', 'imu.adapt_noise': True}
#: rad/s/sqrt(Hz) and m/s^2/sqrt(Hz): assumed by the filter
ASSUMED = {'gyroscope.noise_density': [3e-4], 'accelerometer.noise_density': [0.01]}


def samples(seconds, gyroscope=0.0, accelerometer=0.0, motion=None, seed=0):
    """(k, 7): a level vehicle at rest, white noise of these densities; motion(time) rad/s about the vertical axis."""
    rng = np.random.default_rng(seed)
    time = np.arange(1, round(seconds * RATE) + 1) / RATE
    noise = np.sqrt(RATE) * rng.standard_normal((len(time), 6))
    values = noise * np.repeat([accelerometer, gyroscope], 3) + [0.0, 0.0, 9.81, 0.0, 0.0, 0.0]
    if motion is not None:
        values[:, 5] += motion(time)
    return np.column_stack([time, values])


def brisk(t):
    return np.sin(np.pi * t)


def shown(memory):
    """Noise densities (6,) beside the newest sample."""
    at = sample_at(memory, int(memory[Head.SAMPLES])) + Shown.WHITE
    return np.sqrt(memory[at:at + 6])


def after(rows, **values):
    config = configure({**STRAPDOWN, **ASSUMED, **values})
    memory = started(config, velocity=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0))
    take_all(memory, rows, np.zeros((0, Event.SIZE)), [0])
    return config, memory


def heading_variance(config, memory):
    at = state_at(memory, int(memory[Head.SAMPLES]))
    return memory[at + covariance_index(State.PHI_D, State.PHI_D, config.layout)]


def test_white_noise_is_shown():
    # given samples with ten and three times the noise that is assumed
    found = [shown(after(samples(60.0, 3e-3, 0.03, seed=seed))[1]) for seed in range(8)]
    # then that is what they show, on each axis
    assert np.sqrt(np.mean(np.square(found), axis=0)) == pytest.approx([0.03] * 3 + [3e-3] * 3, rel=0.15)


def test_noise_that_hides_turns_takes_the_constraint_away():
    # given a vehicle that goes on for two minutes with an IMU that scatters by less and by more than the sideways sigma
    # of 0.3 m/s within a second
    for density, hidden in ((0.1, False), (0.6, True)):
        config, memory = after(samples(120.0, 3e-4, density), **{'vehicle.non_holonomic': True})
        newest = sample_at(memory, int(memory[Head.SAMPLES]))
        assert white_noise.hides_turns(memory, memory[newest + Shown.SIDEWAYS]) == hidden
    # then the constraint says nothing from then on
    assert (memory[newest + Sample.CONSTRAINT] == Kind.NON_HOLONOMIC) == (not hidden)


def test_noise_of_the_accelerometers_that_fixes_have_shown_brings_in_how_vehicles_move():
    # given samples without noise, and fixes that have shown a density of 0.1 and 0.6 m/s^2 for a second
    config, memory = after(samples(10.0, 3e-4, 1e-3), **{'vehicle.non_holonomic': True})
    r, newest = (at(memory, int(memory[Head.SAMPLES])) for at in (state_at, sample_at))
    for density, noisy in ((0.1, False), (0.6, True)):
        memory[r + force_noise.ForceNoise.SCALE] = math.log(1.0 + density**2 / force_noise.ASSUMED_DENSITY)
        learned = force_noise.force_noise(memory, r)
        assert learned == pytest.approx(density**2) and white_noise.hides_turns(memory, learned) == noisy
        # then turns still show in the samples
        assert not white_noise.hides_turns(memory, memory[newest + Shown.SIDEWAYS])


def test_who_is_shaken_for_long_is_told_so():
    # given an IMU with ten times the noise that is assumed, for one and for two minutes
    for seconds, told in ((50.0, False), (120.0, True)):
        config, memory = after(samples(seconds, 3e-3))
        said = vehicle_warnings(memory, config, np.zeros((0, Event.SIZE)))
        assert any('vibrates faster than' in text for text in said) == told
        assert seconds < LONGEST_SHAKEN or memory[White.SHAKEN] == pytest.approx(seconds, abs=5.0)
    # and who has the noise that is assumed is not
    config, memory = after(samples(120.0, 3e-4, 0.01))
    newest = sample_at(memory, int(memory[Head.SAMPLES]))
    assert memory[White.SHAKEN] == 0.0 and white_noise.shown(memory, newest, 3) < 4.0


def test_a_motion_is_no_noise():
    # given a vehicle that turns to and fro within a second, and in two
    _, memory = after(samples(60.0, motion=lambda t: 0.3 * np.sin(2 * np.pi * t) + brisk(t)))
    assert shown(memory)[5] < 1e-4


@pytest.mark.parametrize(('real', 'factor'), [(3e-3, 100.0), (1e-4, 1.0)])
def test_the_heading_is_as_uncertain_as_the_samples_make_it(real, factor):
    # given a heading that is known at first, and no other error of the gyroscopes
    exact = {'gyroscope.gauss_markov.sigma': [1e-9], 'gyroscope.initial_sigma': [1e-9], 'gyroscope.scale_sigma': 0.0}
    grown = {}
    for adapts in (True, False):
        config, memory = after(samples(100.0, real), **{**exact, 'imu.adapt_noise': adapts})
        grown[adapts] = heading_variance(config, memory) - 1.0
    # then its variance grows with the noise that there is, where that is more than assumed, and never with less
    assert grown[False] == pytest.approx(100.0 * 3e-4**2, rel=0.01)
    assert grown[True] == pytest.approx(factor * grown[False], rel=0.15)


@pytest.mark.parametrize('sigma', [0.0, 0.01, 0.03])
def test_a_turn_makes_the_heading_less_certain_by_the_share_that_its_scale_may_be_off(sigma):
    # given a heading that is known at first, gyroscopes with no error but their scale, and a bend of 90 deg in 5 s
    exact = {'gyroscope.gauss_markov.sigma': [1e-9], 'gyroscope.initial_sigma': [1e-9],
             'gyroscope.noise_density': [1e-6], 'imu.adapt_noise': False, 'gyroscope.scale_sigma': sigma}
    config, memory = after(samples(5.0, motion=lambda t: np.full(len(t), -0.1 * np.pi)), **exact)
    # then the heading is as uncertain as that share of the turn
    grown = heading_variance(config, memory) - 1.0
    assert grown == pytest.approx((0.5 * np.pi * sigma) ** 2, rel=0.01, abs=1e-9)


@pytest.mark.parametrize('spoil', ['lost', 'out of range'])
def test_samples_that_are_missing_or_not_believed_show_nothing(spoil):
    # given a motion that is smooth, in which samples are lost now and then, or replaced by what was before
    rows = samples(60.0, motion=brisk)
    hit = np.arange(len(rows)) % 45 == 20
    if spoil == 'lost':
        rows = rows[~hit]
    else:
        rows[hit, 6] = 1e3
    # then the steps that this makes are no noise
    assert shown(after(rows)[1])[5] < 1e-4


def test_the_planar_filter_keeps_to_its_parameters():
    config = configure({'mechanization': 'planar', 'imu.adapt_noise': True, **ASSUMED})
    memory = started(config)
    for row in samples(5.0, 3e-3):
        take_sample(memory, *row)
    assert not shown(memory).any()


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_the_variance_of_the_angular_rate_that_is_published_is_that_of_the_samples(mechanization):
    # given gyroscopes with ten times the noise that is assumed
    config, memory = after(samples(60.0, 3e-3), mechanization=mechanization)
    out = np.zeros(SIZE)
    odometry(memory, np.zeros(3), 1.0, out, np.zeros(3), np.zeros(9))
    density = shown(memory)[5] if mechanization == 'strapdown' else 3e-4  # the planar filter does not look
    row = memory[state_at(memory, int(memory[Head.SAMPLES])):][:row_width(config.layout)]
    error = covariance(row, config.layout)[config.layout.index('w_z'), config.layout.index('w_z')]
    # then the sample's own variance, and that of the error taken out of it
    assert out[TWIST_COVARIANCE + 35] == pytest.approx(density**2 * RATE + error, rel=1e-9)
