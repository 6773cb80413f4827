"""IMU samples that cannot be believed: seen, bridged, with a covariance that covers what happened meanwhile."""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import HEIGHT, LATITUDE, configure, fix_event, newest, started, take_all, take_event, take_sample

from mems_ins_fusion.filter.memory import Event, Head, Nav, Sample, covariance, newest_row, state_at, views
from mems_ins_fusion.filter.trust.imu_faults import Fault, Imu, is_wrong
from mems_ins_fusion.filter.trust.standstill import MOVING_SPEED, certain_speed, velocity_sigma
from mems_ins_fusion.navigation.earth import gravity

RATE, SPEED = 50.0, 12.0
BOTH = pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])


def driven(mechanization, change, count=400, speed=SPEED, acceleration=0.0, **vehicle):
    """A filter after `count` samples of a vehicle that goes north, each given to change(samples) first."""
    samples = np.zeros((count, 7))
    samples[:, 0] = np.arange(1, count + 1) / RATE
    samples[:, 3] = gravity(LATITUDE, HEIGHT)
    samples[:, 1:] += np.random.default_rng(2).standard_normal((count, 6)) * np.repeat([0.05, 1e-3], 3)
    samples[200:250, 1] += acceleration
    change(samples)
    config = configure({f'vehicle.{name}': value for name, value in vehicle.items()}, mechanization=mechanization)
    n = config.layout.n_navigation
    p = 1e-6 * np.eye(config.layout.n)
    p[:n, :n] = np.diag(np.square([1, 1, .1, .1, .01] if n == 5 else [1, 1, 1, .1, .1, .1, .003, .003, .01]))
    memory = started(config, velocity=(speed, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=p)
    states, _ = take_all(memory, samples, np.zeros((0, Event.SIZE)), [Nav.V_N, Nav.V_E])
    return config, memory, states


def spike(samples):
    samples[210, 1] = 60.0


def out_of_range(samples):
    samples[210, 6] = 400.0


def saturated(samples):
    samples[200:225, 2] = 19.62


def frozen(samples):
    samples[200:250, 1:] = samples[199, 1:]


def zero(samples):
    samples[200:225, 1:] = 0.0


FAULTS = pytest.mark.parametrize(('change', 'fault', 'least', 'most'), [
    (spike, Fault.SPIKE, 1, 1), (out_of_range, Fault.RANGE, 1, 1), (saturated, Fault.SATURATED, 20, 25),
    (frozen, Fault.FROZEN, 25, 50), (zero, Fault.ZERO, 25, 25)], ids=lambda v: getattr(v, '__name__', ''))


@BOTH
@FAULTS
def test_a_fault_is_seen_for_what_it_is_and_bridged(mechanization, change, fault, least, most):
    config, memory, velocity = driven(mechanization, change)
    head = views(memory)[0]
    counts = head[Imu.FAULTS:Imu.FAULTS + Fault.SIZE]
    assert least <= counts[fault] <= most and counts.sum() == counts[fault]
    # then it goes on as it did, and the covariance knows more of the bridge than the error
    error = np.hypot(velocity[-1, 0] - SPEED, velocity[-1, 1])
    p = covariance(newest(memory), config.layout)
    first = 2 if mechanization == 'planar' else 3
    sigma = math.sqrt(p[first, first])
    assert error < 3 * sigma + 0.1 and error < 2.5
    assert sigma > math.sqrt(0.1**2 + (1.5 * (counts[fault] - 1) / RATE) ** 2)


def test_an_imu_that_the_fixes_have_contradicted_is_doubted_for_half_a_minute():
    # given a state that was set to fixes which it had diverged from, 100 s after the epoch
    _, memory, _ = driven('strapdown', lambda samples: None, count=2)
    r = state_at(memory, int(memory[Head.SAMPLES]))
    memory[r + Nav.DIVERGENCE_TIME] = 100.0
    # then
    at = 0.0, 29.0, 31.0
    assert [bool(is_wrong(memory, r, 100.0 + t)) for t in at] == [True, True, False]
    # and one that was not is not
    memory[r + Nav.DIVERGENCE_TIME] = 0.0
    assert not is_wrong(memory, r, 100.0)


@BOTH
def test_while_an_imu_is_doubted_its_samples_are_bridged_as_a_vehicle_that_keeps_its_velocity(mechanization):
    # given a state that was set to fixes which it had diverged from, and a second of samples that show a braking
    config, memory, _ = driven(mechanization, lambda samples: None, count=50, non_holonomic=False)
    r = state_at(memory, int(memory[Head.SAMPLES]))
    memory[r + Nav.DIVERGENCE_TIME] = memory[r + Nav.TIME]
    before, p = newest(memory).copy(), covariance(newest(memory), config.layout)
    noise = np.random.default_rng(3).standard_normal((50, 6)) * np.repeat([0.05, 1e-3], 3)
    for k, sample in enumerate(noise + [-3.0, 0.0, 9.8, 0.0, 0.0, 0.0], start=51):
        take_sample(memory, k / RATE, *sample)
    # then none of them is believed, the velocity stays, and its variance grows by the density of an acceleration that
    # is white: 3 m^2/s^3
    assert memory[Imu.FAULTS + Fault.CONTRADICTED] == 50
    after, grown = newest(memory), covariance(newest(memory), config.layout)
    first = 2 if mechanization == 'planar' else 3
    assert after[Nav.V_N] == pytest.approx(before[Nav.V_N], abs=0.05)
    assert after[Nav.V_D] == pytest.approx(before[Nav.V_D], abs=0.05)
    assert grown[first, first] - p[first, first] == pytest.approx(3.0, rel=0.1)
    # and what the accelerometer is off by, which was not used, has no part in it
    bias = config.layout.index('f_x')
    assert abs(grown[first, bias] - p[first, bias]) < 0.01 * p[bias, bias]


@BOTH
def test_honest_samples_are_believed(mechanization):
    _, memory, velocity = driven(mechanization, lambda samples: None)
    assert not views(memory)[0][Imu.FAULTS:Imu.FAULTS + Fault.SIZE].any()
    assert np.hypot(velocity[-1, 0] - SPEED, velocity[-1, 1]) < 0.3


@BOTH
def test_the_covariance_covers_what_the_vehicle_did_unseen(mechanization):
    # given a vehicle that brakes with 3 m/s^2 for a second, while its IMU gives zeros
    def nothing(samples):
        samples[200:250, 1:] = 0.0

    config, memory, velocity = driven(mechanization, nothing)
    _, _, seen = driven(mechanization, lambda samples: None, acceleration=-3.0)
    assert seen[-1, 0] == pytest.approx(SPEED - 3.0, abs=0.3)
    sigma = math.sqrt(covariance(newest(memory), config.layout)[(2, 2) if mechanization == 'planar' else (3, 3)])
    assert abs(velocity[-1, 0] - seen[-1, 0]) < 2.5 * sigma


@BOTH
def test_an_axis_that_is_stuck_is_not_believed_again_because_the_vehicle_may_have_come_to_rest(mechanization):
    # given a slow vehicle whose forward accelerometer stays for 4 s at what it showed while braking
    def stuck(samples):
        samples[200:400, 1] = -2.0

    _, memory, _ = driven(mechanization, stuck, count=450, speed=4.0)
    # then all of them but the first 0.3 s, in which that may be chance, are bridged, though by then it may stand
    assert 200 - 0.3 * RATE - 2 <= memory[Imu.FAULTS + Fault.FROZEN] <= 200
    at = state_at(memory, 398)
    assert certain_speed(memory, at, velocity_sigma(memory, at)) < MOVING_SPEED


def test_a_sensor_that_always_repeats_itself_at_rest_is_believed():
    def constant(samples):
        samples[100:, 1:] = samples[99, 1:]

    _, memory, _ = driven('planar', constant, speed=0.0)
    assert not views(memory)[0][Imu.FAULTS:Imu.FAULTS + Fault.SIZE].any()


def flags_at_rest(change, speed=0.0, count=800):
    """Whether a parked vehicle was taken for one at the last of `count` samples."""
    _, memory, _ = driven('strapdown', change, count=count, speed=speed, zero_velocity=True)
    head, samples = views(memory)[0], views(memory)[3]
    return samples[int(head[Head.SAMPLES]) % len(samples), Sample.STILL] > 0.0


@pytest.mark.parametrize('axis', [1, 2, 3])
def test_an_accelerometer_that_repeats_itself_is_no_sign_of_rest(axis):
    # given a parked vehicle, and then an axis that would not show that it drives off
    def stuck(samples):
        samples[730:, axis] = samples[730, axis]

    assert flags_at_rest(lambda samples: None)
    assert not flags_at_rest(stuck)


def test_a_gyroscope_that_repeats_itself_at_rest_is_no_matter():
    def stuck(samples):
        samples[730:, 6] = samples[730, 6]

    assert flags_at_rest(stuck)


def test_rest_is_seen_soon_behind_a_bridge_however_much_the_specific_force_has_changed():
    # given a vehicle on a road that brakes for 4 s, of which the last is not shown, nor 1 s after that, and then stands
    def braked(samples):
        samples[:650, 2] += 0.3 * np.sin(2.0 * samples[:650, 0])
        samples[450:650, 1] -= SPEED / 4.0
        samples[600:700, 1:] = 0.0

    # then 4 s later it is seen
    assert flags_at_rest(braked, speed=SPEED, count=900)


@BOTH
def test_a_state_that_is_not_finite_is_taken_back(mechanization):
    config, memory, _ = driven(mechanization, lambda samples: None)
    before = newest(memory)
    # given an error estimate that has become nothing
    row = newest_row(memory)
    views(memory)[0][Head.CONDITIONING] = np.nan
    time = row[Nav.TIME] + 1 / RATE
    sample = np.array([[time, 0.0, 0.0, 9.8, 0.0, 0.0, 0.0]])
    states, _ = take_all(memory, sample, np.zeros((0, Event.SIZE)), [Nav.V_N])
    after = newest(memory)
    assert np.isfinite(after[:Sample.SIZE]).all() and after[Nav.RESTARTS] == 1
    assert after[Nav.TIME] == pytest.approx(time) and after[Nav.V_N] == before[Nav.V_N]
    first = 2 if mechanization == 'planar' else 3
    change = covariance(after, config.layout) - covariance(before, config.layout)
    assert change[first, first] == pytest.approx(1.0) and change[-1, -1] == 0.0
    # and a late fix, behind which the filter repeats that sample, does not make it two
    take_event(memory, fix_event(time - 0.3))
    assert newest(memory)[Nav.RESTARTS] == 1


def with_a_gap(mechanization, seconds, fixes=0.0):
    """A filter on a steady way north behind a gap of `seconds`, with fixes that tell nothing, so far apart, in it."""
    config = configure({'imu.max_gap': 0.5}, mechanization=mechanization)
    n = config.layout.n_navigation
    p = 1e-6 * np.eye(config.layout.n)
    p[:n, :n] = np.diag(np.square([1, 1, .1, .1, .01] if n == 5 else [1, 1, 1, .1, .1, .1, .003, .003, .01]))
    memory = started(config, velocity=(SPEED, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=p)
    time = np.concatenate([np.arange(1, 51) / RATE, 1.0 + seconds + np.arange(5) / RATE])
    samples = np.column_stack([time, np.zeros((len(time), 6))])
    samples[:, 3] = gravity(LATITUDE, HEIGHT)
    at = np.arange(1.0 + fixes, 1.0 + seconds, fixes) if fixes else np.zeros(0)
    events = np.array([fix_event(t, LATITUDE + SPEED * t / 6.37e6, r=1e8 * np.eye(2), down=1e8) for t in at])
    take_all(memory, samples, events.reshape(-1, Event.SIZE), [Nav.V_N])
    return config, memory


@BOTH
@pytest.mark.parametrize('apart', [0.4, 0.1])
def test_a_gap_is_bridged_as_long_as_it_is_whatever_falls_into_it(mechanization, apart):
    # given a gap of 2 s, and the same with fixes in it that tell nothing
    config, memory = with_a_gap(mechanization, 2.0)
    p = covariance(newest(memory), config.layout)
    first = 2 if mechanization == 'planar' else 3
    assert math.sqrt(p[first, first]) > 2.0
    _, memory = with_a_gap(mechanization, 2.0, apart)
    # then velocity and heading are as uncertain
    parted = covariance(newest(memory), config.layout)
    last = config.layout.n_navigation - 1
    for i in (first, first + 1, last):
        assert parted[i, i] == pytest.approx(p[i, i], rel=0.2)  # gravity leaks through the tilt of parts of it


@BOTH
@pytest.mark.parametrize('model', ['random_walk', 'gauss_markov', 'autoregressive'])
def test_behind_a_gap_in_which_the_imu_may_have_restarted_its_errors_are_free(mechanization, model):
    config = configure({'sensor_error_model': model, 'imu.max_gap': 0.5}, mechanization=mechanization)
    first = [m.initial_covariance()[0, 0] + t**2 for m, t in zip(config.models, config.turn_on_sigma)]
    states = config.layout.n_navigation + config.layout.order * np.arange(len(config.models))
    sample = [0.0, 0.0, gravity(LATITUDE, HEIGHT), 0.0, 0.0, 0.0]
    for seconds, share in ((0.9, 0.0), (2.0, 0.3)):
        memory = started(config, p=1e-10 * np.eye(config.layout.n))
        times = 0.02, 0.02 + seconds, 0.04 + seconds
        take_all(memory, np.array([[t, *sample] for t in times]), np.zeros((0, Event.SIZE)), [0])
        after = np.diag(covariance(newest(memory), config.layout))[states]
        # then by three tenths of what one is uncertain by that was never seen; else by what its model says
        drift = [m.process_noise(0.04 + seconds)[0, 0] if model != 'autoregressive' else 0.0 for m in config.models]
        assert after == pytest.approx(share**2 * np.array(first) + drift, abs=2e-4 * min(first), rel=0.01)
