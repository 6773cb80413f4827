"""What is known of a land vehicle, against the dense textbook Kalman update, and on a drive."""
from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from filter_support import (
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    MODEL_VALUES,
    attitude_of,
    central_difference,
    configure,
    fix_event,
    newest,
    random_covariance,
    started,
    state_and_covariance,
    take_event,
    take_sample,
    velocity_of,
)
from scipy.spatial.transform import Rotation

from mems_ins_fusion.evaluation.metrics import position_errors, rms
from mems_ins_fusion.filter.constraints import CONSTRAINT_INTERVAL
from mems_ins_fusion.filter.measurements import acceleration
from mems_ins_fusion.filter.memory import Head, Kind, Nav, sample_at, views
from mems_ins_fusion.filter.runs import replay
from mems_ins_fusion.filter.trust.standstill import Still
from mems_ins_fusion.filter.trust.white_noise import Shown

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'studies'))
from table_of_numbers import Drive, recording, truth_of  # noqa: E402

DT = 0.01
FLU = np.array([1.0, -1.0, -1.0])
DENSITY = np.array([1e-5, 2e-5, 3e-5])  # rad/s/sqrt(Hz), gyroscope x, y, z: another for each axis
FORCE_DENSITY = 5e-4  # m/s/sqrt(s), accelerometers: at 13 m/s both sensors count
VELOCITY_SIGMA, SIDEWAYS_SIGMA = 0.03, 0.4
NON_HOLONOMIC = {'vehicle.non_holonomic': True, 'vehicle.non_holonomic_sigma': SIDEWAYS_SIGMA,
                 'vehicle.non_holonomic_vertical_sigma': SIDEWAYS_SIGMA}
#: an IMU that adds nothing
GOOD = {'accelerometer.noise_density': [1e-6], 'accelerometer.gauss_markov.sigma': [1e-8],
        'gyroscope.gauss_markov.sigma': [1e-8]}
STANDSTILL = {'vehicle.zero_velocity': True, 'vehicle.zero_velocity_sigma': VELOCITY_SIGMA}


def made(model, mechanization, feedback, constraint=()):
    noise = {'gyroscope.noise_density': DENSITY.tolist(), 'accelerometer.noise_density': [FORCE_DENSITY]}
    return configure({**MODEL_VALUES[model], **noise, 'mechanization': mechanization, 'feedback': feedback,
                      **dict(constraint)})


def first_velocity(config):
    """Index of the first velocity error, and how many there are."""
    return (2, 2) if config.layout.n_navigation == 5 else (3, 3)


def gyroscope_states(config):
    """Indices of the gyroscopes' error states, axes as in `config.layout.channels`: the newest value of each block."""
    layout = config.layout
    return [layout.n_navigation + i * layout.order for i, name in enumerate(layout.channels) if name.startswith('w_')]


def true_motion(config, memory, e):
    """Velocity in n (3,) and attitude of the newest state with the error e (INS minus truth) taken out."""
    velocity, attitude = velocity_of(config, memory), attitude_of(config, memory)
    at, k = first_velocity(config)
    velocity[:k] -= e[at:at + k]
    if config.layout.n_navigation == 5:
        return velocity, Rotation.from_euler('z', -e[4]) * attitude
    return velocity, Rotation.from_rotvec(-e[6:9]) * attitude  # C_true = (I - [phi x]) C_ins


def across_the_road(config, memory, rate):
    """Sideways (and, strapdown, downward) velocity as a function of the error: zero for a land vehicle. And R.

    Each is that in the direction of the motion as far as its innovation is the noise of the gyroscope, and not of the
    accelerometer: what turns the vehicle's axes says nothing of the speed.
    """
    k = first_velocity(config)[1]

    def motion(e):
        velocity, attitude = true_motion(config, memory, e)
        return attitude.inv().apply(velocity)
    x = state_and_covariance(config, memory)[0]
    forward = motion(np.zeros(len(x)))[0]
    innovation = motion(np.zeros(len(x)))[1:] + central_difference(lambda e: motion(e)[1:], len(x), 1e-6) @ x
    by_turn = (forward * DENSITY[[2, 1]]) ** 2
    share = (by_turn / (by_turn + FORCE_DENSITY**2))[:k - 1]
    angles = share * innovation[:k - 1] * forward / (forward**2 + SIDEWAYS_SIGMA**2)

    def measured(e):
        now = motion(e)
        return now[1:k] - angles * (now[0] - forward)
    return measured, SIDEWAYS_SIGMA**2 * np.eye(k - 1)


def accelerates(config, memory, force):
    """Acceleration to north and east as a function of the error: zero but for white noise. And R."""
    layout = config.layout
    states = [(axis, layout.n_navigation + i * layout.order) for i, axis in enumerate(config.channel_axes) if axis < 3]

    def measured(e):
        true = force.copy()
        for axis, state in states:
            true[axis] -= e[state]
        return true_motion(config, memory, e)[1].apply(true)[:2]
    return measured, acceleration.DENSITY / CONSTRAINT_INTERVAL * np.eye(2)


def shaken(memory):
    """As after a minute in which the samples have scattered by far more than the constraint's sigma."""
    memory[sample_at(memory, int(memory[Head.SAMPLES])) + Shown.SIDEWAYS] = 1.0
    return memory


def at_rest(config, memory, rate):
    """Velocity and angular rate as a function of the error: zero at standstill. And R."""
    k = first_velocity(config)[1]
    gyroscopes, axes = gyroscope_states(config), [i - 3 for i in config.channel_axes if i >= 3]

    def measured(e):
        return np.concatenate([true_motion(config, memory, e)[0][:k], rate[axes] - e[gyroscopes]])
    return measured, np.diag([*[VELOCITY_SIGMA**2] * k, *DENSITY[axes] ** 2 / DT])


def textbook(measured, r, x, p):
    """x and P after a correction with measured(error) = 0 + noise; the dense H by finite differences."""
    h = -central_difference(measured, len(x), 1e-6)
    s = h @ p @ h.T + r
    gain = p @ h.T @ np.linalg.inv(s)
    return x + gain @ (measured(np.zeros(len(x))) - h @ x), p - gain @ s @ gain.T


def until_corrected(models, mechanization, feedback, constraint, sample, **start):
    """Two filters, with and without the constraint, up to the first sample at which they differ."""
    configs = [made(models, mechanization, feedback, more) for more in ({}, constraint)]
    memories = [started(config, **start) for config in configs]
    if configs[1].parameters['imu.adapt_noise']:
        shaken(memories[1])
    for memory in memories:  # it has been so for long: the low passes show this, nothing scatters
        head, seen = views(memory)[0], np.array(sample[:3]) * FLU
        for at in (Still.FIRST, Still.SECOND, Still.MEAN):
            head[at:at + 3] = seen
        head[[Still.MOTION, Still.REST]] = np.log([0.05, 0.01])
    for k in range(1, 1000):
        for memory in memories:
            take_sample(memory, k * DT, *sample)
        p = [state_and_covariance(config, memory)[1] for config, memory in zip(configs, memories)]
        if not np.array_equal(*p):
            return configs[1], *memories
    raise AssertionError('never corrected')


def assert_textbook(config, before, after, measured, r):
    """The step from `before` to `after` is that of the dense update."""
    x0, p0 = state_and_covariance(config, before)
    x, p = textbook(measured, r, x0, p0)
    estimate, covariance = state_and_covariance(config, after)
    sigma = np.sqrt(np.diag(p0))
    assert covariance / np.outer(sigma, sigma) == pytest.approx(p / np.outer(sigma, sigma), abs=1e-7)
    assert np.abs(p - p0).max() > 1e-3 * np.abs(p0).max()  # something was measured
    closed = config.parameters['feedback'] == 'closed'
    navigation = config.layout.n_navigation
    expected = np.concatenate([np.zeros(navigation), x[navigation:]]) if closed else x
    assert (estimate - expected) / sigma == pytest.approx(np.zeros(len(x)), abs=1e-6)
    taken_out = np.where(np.arange(len(x)) < navigation, x, 0.0) if closed else np.zeros(len(x))
    velocity, attitude = true_motion(config, before, taken_out)
    assert velocity_of(config, after) == pytest.approx(velocity, abs=1e-7)
    assert (attitude_of(config, after) * attitude.inv()).magnitude() < 1e-7


def scale_of(config, velocity=0.3, attitude=0.03, force=0.1, rate=0.01):
    errors = [2, 2, *[velocity] * 2, attitude] if config.layout.n_navigation == 5 else [
        2, 2, 3, *[velocity] * 3, *[attitude] * 3]
    return np.array(errors + [force if axis < 3 else rate for axis in config.channel_axes
                              for _ in range(config.layout.order)])


def drawn(config, scale, rng, feedback):
    """Errors and covariance far from diagonal; closed loop has no navigation errors left."""
    x = scale * rng.standard_normal(len(scale))
    if feedback == 'closed':
        x[:config.layout.n_navigation] = 0.0
    return {'x': x, 'p': random_covariance(len(scale), rng, scale)}


EACH = pytest.mark.parametrize(('model', 'mechanization', 'feedback'), [
    (model, mechanization, feedback) for model in ('GM', 'AR(2)') for mechanization in ('planar', 'strapdown')
    for feedback in ('closed', 'open')])


@EACH
def test_no_sideways_velocity_corrects_as_the_dense_kalman_update(model, mechanization, feedback):
    # given a vehicle that turns, climbs and leans, and moves a little sideways and down by its estimate, and so certain
    # an acceleration that how vehicles accelerate tells nothing
    config = made(model, mechanization, feedback)
    start = drawn(config, scale_of(config, attitude=1e-3, force=0.01), np.random.default_rng(5), feedback)
    sample, attitude = (0.3, 1.0, 9.7, 0.02, -0.03, 0.2), (0.2, -0.3, 0.7)
    turned = Rotation.from_euler('ZYX', attitude[::-1] if config.layout.n_navigation == 9 else (0.7, 0.0, 0.0))
    config, before, after = until_corrected(model, mechanization, feedback, NON_HOLONOMIC, sample,
                                            attitude=attitude, velocity=turned.apply((13.0, 0.6, -0.5)), **start)
    assert_textbook(config, before, after, *across_the_road(config, before, np.array(sample[3:]) * FLU))


@pytest.mark.parametrize('model, feedback', [('GM', 'closed'), ('GM', 'open'), ('AR(2)', 'closed')])
def test_a_velocity_that_lasts_corrects_as_the_dense_kalman_update(model, feedback, mechanization='strapdown'):
    # given a vehicle whose attitude and accelerometers are uncertain, and an IMU that is shaken
    config = made(model, mechanization, feedback)
    start = drawn(config, scale_of(config, attitude=0.1, force=1.0), np.random.default_rng(7), feedback)
    sample, attitude = (0.3, 1.0, 9.7, 0.02, -0.03, 0.2), (0.2, -0.3, 0.7)
    config, before, after = until_corrected(
        model, mechanization, feedback, {**NON_HOLONOMIC, 'imu.adapt_noise': True}, sample, attitude=attitude,
        velocity=(13.0, 0.6, -0.5), **start)
    assert_textbook(config, before, after, *accelerates(config, before, np.array(sample[:3]) * FLU))


@pytest.mark.parametrize('tilt', [0.001, 0.3])
def test_without_fixes_a_shaken_vehicle_goes_on_as_it_did_where_its_attitude_tells_no_acceleration(tilt):
    # given a filter whose attitude is uncertain by `tilt`, and an IMU that is tilted by 10 deg against it
    config = made('GM', 'strapdown', 'closed', {**NON_HOLONOMIC, **GOOD, 'imu.adapt_noise': True})
    scale = [1.0] * 3 + [0.1] * 3 + [tilt] * 2 + [1e-3] + [1e-6] * config.layout.n_augmented
    memory = started(config, velocity=(20.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag(np.square(scale)))
    # when it coasts for 20 s on what that shows of gravity, as a car in motion may
    for k in range(1, 2001):
        take_sample(shaken(memory), k * DT, 9.81 * np.sin(0.17), 0.0, 9.81 * np.cos(0.17), 0.0, 0.0, 0.0)
    north, east = velocity_of(config, memory)[:2]
    # then one that is sure of it integrates, and one that is not believes that a car keeps its speed
    assert abs(east) < 1.0
    assert north - 20.0 == pytest.approx(20.0 * 9.81 * np.sin(0.17) if tilt < 0.01 else 0.0, abs=2.0)


@pytest.mark.parametrize('sigma', [0.001, 3.0])
def test_without_fixes_a_vehicle_goes_on_as_it_did_where_its_accelerometers_are_not_known(sigma):
    # given a bias of 1.7 m/s^2 of an accelerometer that is known to `sigma`, and no vibration
    config = made('GM', 'strapdown', 'closed', {**NON_HOLONOMIC, **GOOD, 'accelerometer.gauss_markov.tau': [1e4]})
    scale = [1.0] * 3 + [0.1] * 3 + [1e-3] * 3 + [sigma] + [1e-6] * (config.layout.n_augmented - 1)
    memory = started(config, velocity=(20.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag(np.square(scale)))
    # when it coasts for 20 s
    for k in range(1, 2001):
        take_sample(memory, k * DT, 1.7, 0.0, 9.81, 0.0, 0.0, 0.0)
    north, east = velocity_of(config, memory)[:2]
    # then one that is sure of it integrates, and one that is not believes that a car keeps its speed
    assert abs(east) < 1.0
    assert north - 20.0 == pytest.approx(20.0 * 1.7 if sigma < 0.01 else 0.0, abs=2.0)


@pytest.mark.parametrize('axis, sideways, up, allowed', [(1, 100.0, 0.5, 2.5), (2, 0.3, 100.0, 10.0)])
def test_a_gyroscope_that_is_shaken_does_not_brake_the_vehicle(axis, sideways, up, allowed):
    # given a car that goes straight on at 36 m/s, known to 5 m/s, for 30 s with nothing but one component of the
    # constraint, and a gyroscope of 10 Hz with a noise of 0.02 rad/s/sqrt(Hz) about the other axis
    rate, density, speed = 10, np.full(3, 1e-5), 36.0
    density[axis] = 0.02
    config = made('GM', 'strapdown', 'closed', {
        **GOOD, 'vehicle.non_holonomic': True, 'vehicle.non_holonomic_sigma': sideways, 'imu.mounting_sigma': 0.0,
        'vehicle.non_holonomic_vertical_sigma': up, 'gyroscope.noise_density': density.tolist(),
        'vehicle.rear_axle_sigma': 0.0})
    scale = [1.0] * 3 + [5.0, 0.1, 0.1] + [0.01] * 3 + [1e-6] * config.layout.n_augmented
    found, sigma = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        memory = started(config, velocity=(speed, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag(np.square(scale)))
        for k in range(1, 30 * rate + 1):
            force = attitude_of(config, memory).inv().apply([0.0, 0.0, -9.81]) * FLU  # as if it were level
            take_sample(memory, k / rate, *force, *(density * np.sqrt(rate) * rng.standard_normal(3)))
        found.append(np.hypot(*velocity_of(config, memory)[:2]))
        sigma.append(np.sqrt(state_and_covariance(config, memory)[1][3, 3]))
    # then it is about as fast as before in the mean (sideways within two sigma: its own corrections turn the velocity
    # as well; without turning the row back it was 3 m/s, 17 sigma), and no surer of it: nothing has told its speed
    assert np.mean(found) == pytest.approx(speed, abs=allowed), found
    assert np.mean(sigma) > 4.0, sigma


@pytest.mark.parametrize('sideways, up, axle', [
    (0.3, 100.0, [-7.0, 0.0, 0.0]), (100.0, 2.0, [-7.0, 0.0, 0.0]), (0.3, 100.0, [0.0, 0.0, -2.5])],
    ids=['sideways, ahead', 'upwards, ahead', 'sideways, above'])
def test_vibration_far_from_the_axle_does_not_change_the_speed(sideways, up, axle):
    # given an IMU of 100 Hz 7 m ahead of the axle or 2.5 m above it, known exactly, in a vehicle that goes straight on
    # at 10 m/s, known to 3 m/s, for 60 s with one component of the constraint, and gyroscopes with a noise of 0.03
    # rad/s a sample
    speed, noise = 10.0, 0.03
    config = made('GM', 'strapdown', 'closed', {
        **GOOD, 'vehicle.non_holonomic': True, 'vehicle.non_holonomic_sigma': sideways, 'imu.mounting_sigma': 0.0,
        'vehicle.non_holonomic_vertical_sigma': up, 'gyroscope.noise_density': [noise * np.sqrt(DT)],
        'vehicle.rear_axle': axle, 'vehicle.rear_axle_sigma': 0.0})
    scale = [1.0] * 3 + [3.0, 0.1, 0.1] + [0.01] * 3 + [1e-6] * config.layout.n_augmented
    off = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        memory = started(config, velocity=(speed, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag(np.square(scale)))
        for k in range(1, round(60.0 / DT) + 1):
            force = attitude_of(config, memory).inv().apply([0.0, 0.0, -9.81]) * FLU  # as if it were level
            take_sample(memory, k * DT, *force, *(noise * rng.standard_normal(3)))
        off.append(np.hypot(*velocity_of(config, memory)[:2]) - speed)
    # then it is as fast as before within 1.5 sigma of the start: taken for a turn of the direction, the noise times 7 m
    # ahead makes it 65 and 5 m/s faster
    assert np.mean(off) == pytest.approx(0.0, abs=4.5), off


def test_what_the_linearisation_omits_is_not_averaged():
    # given vehicles that go straight on at 10 m/s for 20 s with an IMU without errors, whose velocity is known to 1 m/s
    # and so their course to 0.1 rad, and a mounting that is known to 0.1 rad: heading and mounting are known to differ
    # from the course by nothing
    config = made('GM', 'strapdown', 'closed', {**GOOD, **NON_HOLONOMIC, 'imu.mounting_sigma': 0.1,
                                                'vehicle.rear_axle_sigma': 0.0, 'vehicle.learn_drift': False})
    speed, sideways, yaw, mounting = 3, 4, 8, config.layout.index('mounting_yaw')
    p = np.diag(np.square([1.0] * 5 + [0.1] + [1e-4] * 3 + [1e-6] * config.layout.n_augmented))
    p[mounting, mounting] = p[yaw, mounting] = p[mounting, yaw] = 0.1**2
    p[yaw, yaw] = 0.1**2 + 0.1**2
    p[yaw, sideways] = p[sideways, yaw] = 0.1
    sigmas, moved = [], []
    for seed in range(12):
        before = np.random.default_rng(seed).standard_normal(2) + [10.0, 0.0]
        memory = started(config, velocity=(*before, 0.0), attitude=(0.0, 0.0, 0.1 * before[1]), p=p)
        for k in range(1, round(20.0 / DT) + 1):
            take_sample(memory, k * DT, 0.0, 0.0, 9.81, 0.0, 0.0, 0.0)
        moved.append(np.array(velocity_of(config, memory)[:2]) - before)
        sigmas.append(np.sqrt(np.diag(state_and_covariance(config, memory)[1])[[speed, sideways]]))
    # then the velocity is what it was, and known as well as before, as nothing has shown it. With the product of both
    # errors as white noise its sigma was 0.6 m/s, once 0.2, and it had moved by 0.8 m/s
    assert np.mean(sigmas, axis=0) == pytest.approx(1.0, abs=0.1)
    assert rms(np.ravel(moved)) < 0.4


@pytest.mark.parametrize('noise', [(0.02, 0.01), (0.02, 0.0), (0.0, 0.0)])
@pytest.mark.parametrize('speed', [0.0, 1e-3, -5.0])
def test_the_constraint_is_harmless_at_any_speed_and_noise(speed, noise):
    # given a vehicle that moves sideways by its estimate, with noise of gyroscopes, of accelerometers, or of none
    config = made('GM', 'strapdown', 'closed', {**NON_HOLONOMIC, 'gyroscope.noise_density': [noise[0]],
                                                'accelerometer.noise_density': [noise[1]]})
    scale = scale_of(config)
    memory = started(config, velocity=(speed, 0.5, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag(scale**2))
    for k in range(1, 12):  # one application
        take_sample(memory, k * DT, 0.0, 0.0, 9.81, 0.0, 0.0, 0.0)
    # then it goes less sideways, and its speed is within what it was known to
    after = attitude_of(config, memory).inv().apply(velocity_of(config, memory))
    assert abs(after[1]) < 0.5 and abs(after[0] - speed) < 3 * scale[3]


@EACH
def test_a_standstill_corrects_as_the_dense_kalman_update(model, mechanization, feedback):
    # given a vehicle at rest whose gyroscopes show another rate on each axis
    config = made(model, mechanization, feedback)
    scale = scale_of(config, velocity=0.05, attitude=3e-4, force=0.003, rate=1e-4)
    start = drawn(config, scale, np.random.default_rng(6), feedback)
    start['x'][:config.layout.n_navigation] *= 0.1
    attitude = (0.02, -0.03, 0.7)
    level = Rotation.from_euler('ZYX', attitude[::-1]) if config.layout.n_navigation == 9 else Rotation.identity()
    force = level.inv().apply([0.0, 0.0, -9.81])
    rate = np.array([1e-3, -2e-3, 3e-3])
    config, before, after = until_corrected(model, mechanization, feedback, STANDSTILL, (*force * FLU, *rate * FLU),
                                            attitude=attitude, velocity=(0.02, -0.03, 0.01), **start)
    assert_textbook(config, before, after, *at_rest(config, before, rate))


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_what_is_known_of_the_vehicle_bounds_an_outage(mechanization):
    # given a drive with bends and a standstill, and no fix from the standstill on
    drive = Drive()
    imu, fixes = recording(drive, 3, mechanization == 'strapdown')
    fixes = fixes.select(fixes.stamp < imu.stamp[-1] - 51 * 10**9)
    truth = truth_of(drive)
    outage = truth.select(truth.reference.stamp > fixes.stamp[-1])
    error, normalized, at_rest_speed = {}, {}, {}
    for name, constraint in (('none', {}), ('non_holonomic', NON_HOLONOMIC), ('standstill', STANDSTILL),
                             ('both', {**NON_HOLONOMIC, **STANDSTILL})):
        config = configure(constraint, mechanization=mechanization)
        errors = position_errors(replay.run(config, imu, fixes), outage, np.zeros(len(outage), dtype=bool))
        error[name], normalized[name] = rms(errors.horizontal), errors.nees.mean()
        time = (errors.stamp - imu.stamp[0]) * 1e-9
        # it stands from 95 s to 103 s; after hard braking the detector takes six seconds to see it
        at_rest_speed[name] = rms(errors.speed[(time > 101.5) & (time < 102.5)])
    # then no sideways velocity bounds the position, standstill the speed, and the covariance says by how much
    assert error['non_holonomic'] < 0.5 * error['none'] and error['both'] < 3.0, error
    assert max(at_rest_speed['standstill'], at_rest_speed['both']) < 0.03 < 0.1 < at_rest_speed['none'], at_rest_speed
    assert max(normalized.values()) < 6.0, normalized  # 2 on average, but errors of one drive are not independent


def test_what_the_constraints_said_of_a_whole_recording():
    # given a drive, and constraints with so large a sigma that they change nothing
    imu, fixes = recording(Drive(duration=120.0), 3, True)
    values = {'mechanization': 'strapdown', 'imu.mounting_sigma': 0.0, 'vehicle.non_holonomic': True,
              'vehicle.non_holonomic_sigma': 100.0, 'vehicle.non_holonomic_vertical_sigma': 100.0,
              'vehicle.zero_velocity': True, 'vehicle.rear_axle': [0.0, 0.0, 0.0], 'vehicle.rear_axle_sigma': 0.0}
    config = configure(values)
    plain = replay.run(config, imu, fixes)
    # when it is asked what they said
    found, said = replay.run_with_constraints(config, imu, fixes)
    # then the run is the same, and their innovations are the velocities across the vehicle, or at rest the velocity
    assert np.array_equal(found.latitude, plain.latitude) and np.array_equal(found.sigma, plain.sigma)
    moving = said.kind == Kind.NON_HOLONOMIC
    assert moving.sum() > 300 and (~moving).sum() > 20
    at = np.searchsorted(found.index, said.index[moving])
    turned = Rotation.from_euler('ZYX', np.column_stack([found.yaw, found.pitch, found.roll])[at]).inv()
    off = np.abs(said.z[moving, :2] - turned.apply(found.velocity[at])[:, 1:]).max(axis=1)
    assert np.mean(off < 1e-3) > 0.85  # but where a fix came between, which is in the state kept
    assert said.s[moving, :2] == pytest.approx(1e4, rel=1e-2)
    assert set(said.kind) == {Kind.NON_HOLONOMIC, Kind.ZERO_VELOCITY}
    assert np.abs(said.z[~moving]).max() < 1.0


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_a_second_of_constraint_tells_as_much_at_any_rate_of_the_imu(mechanization):
    # given velocities that the constraint alone tells, and IMUs of 5 to 200 Hz
    found = {}
    for rate in (200, 100, 50, 12, 8, 5):
        config = made('GM', mechanization, 'closed', {**NON_HOLONOMIC, **GOOD,
                                                      'vehicle.non_holonomic_angle_sigma': 0.0})
        n = config.layout.n_navigation
        scale = [1e-3, 1e-3, 2.0, 2.0, 1e-5] if n == 5 else [1e-3] * 3 + [2.0] * 3 + [1e-5] * 3
        p = np.diag(np.square([*scale, *[1e-6] * config.layout.n_augmented]))
        memory = started(config, velocity=(10.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=p)
        for k in range(1, 10 * rate + 1):
            take_sample(memory, k / rate, 0.0, 0.0, 9.81, 0.0, 0.0, 0.0)
        east = first_velocity(config)[0] + 1
        found[rate] = state_and_covariance(config, memory)[1][east, east]
    # then each of the 100 tenths of a second is worth one with its sigma
    for rate, variance in found.items():
        assert variance == pytest.approx(SIDEWAYS_SIGMA**2 / 100, rel=0.05), rate


def test_a_vehicle_that_goes_up_does_not_go_sideways():
    # given one that rises by 3 m/s for 20 s without a tilt that shows it
    config = made('GM', 'strapdown', 'closed', {**NON_HOLONOMIC, **GOOD, 'imu.mounting_sigma': 0.0})
    p = np.diag(np.square([1.0] * 3 + [0.1] * 3 + [1e-4] * 3 + [1e-6] * config.layout.n_augmented))
    memory = started(config, velocity=(10.0, 0.0, -3.0), attitude=(0.0, 0.0, 0.0), p=p)
    for k in range(1, 2001):
        take_sample(memory, k / 100, 0.0, 0.0, 9.81, 0.0, 0.0, 0.0)
        if k % 100 == 0:
            take_event(memory, fix_event(k / 100, latitude=LATITUDE + k / 10 / 6.38e6, height=HEIGHT + 3.0 * k / 100,
                                          r=1e-4 * np.eye(2), down=1e-4))
    # then its constraint upwards is not used, and no time sideways is counted
    assert newest(memory)[Nav.VERTICAL_NIS] < 0.0 and newest(memory)[Nav.SIDEWAYS] == 0.0


@pytest.mark.parametrize('rate', [100, 5])
def test_how_long_a_vehicle_goes_sideways_is_counted_once_whatever_comes_late(rate):
    # given a boat that drifts with 3 m/s for 20 s, and fixes of it in time and late
    config = made('GM', 'planar', 'closed', {**NON_HOLONOMIC, **GOOD})
    p = np.diag(np.square([1.0, 1.0, 0.1, 0.1, 1e-4, *[1e-6] * config.layout.n_augmented]))
    counted = []
    for late in (0.0, 0.6):
        memory = started(config, velocity=(0.0, 3.0, 0.0), attitude=(0.0, 0.0, 0.0), p=p)
        for k in range(1, 20 * rate + 1):
            time = k / rate
            take_sample(memory, time, 0.0, 0.0, 9.81, 0.0, 0.0, 0.0)
            if k % rate == 0 and time - late > 0.0:
                take_event(memory, fix_event(time - late, longitude=LONGITUDE + (time - late) * 3.0 / 4.26e6,
                                              r=1e-4 * np.eye(2)))
        counted.append(newest(memory)[Nav.SIDEWAYS])
    # then it is the time that it was so
    assert 10.0 < counted[0] <= 20.0 and counted[1] == pytest.approx(counted[0], abs=1.0)
