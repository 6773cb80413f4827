"""One step of the kernel: covariance and estimated errors against dense matrices built from finite differences."""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import (
    HEIGHT,
    MODEL_VALUES,
    central_difference,
    configure,
    newest,
    random_covariance,
    started,
    state_and_covariance,
    take_sample,
)
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from mems_ins_fusion.filter.memory import PLANAR, STRAPDOWN, Head, Nav, decay_at, views
from mems_ins_fusion.filter.prediction import _decays
from mems_ins_fusion.navigation import planar, strapdown
from mems_ins_fusion.navigation.earth import gravity, radii
from mems_ins_fusion.parameters.table import ALL

DT = 0.01
VELOCITY, ATTITUDE = np.array([12.0, -5.0, 0.3]), (0.02, -0.03, 0.7)
FORCE, RATE = np.array([1.3, 2.1, 9.4]), np.array([0.1, -0.2, 0.5])  # sensor axes forward-left-up
FLIP = np.array([1.0, -1.0, -1.0])
COLOURED = {'gnss.coloured_noise.sigma': 0.8, 'gnss.coloured_noise.tau': 3.0}
CASES = [(model, mechanization, coloured) for model in MODEL_VALUES for mechanization in ('planar', 'strapdown')
         for coloured in (False, True)]


def settings(model, mechanization, coloured, **more):
    return configure({**MODEL_VALUES[model], 'mechanization': mechanization, **(COLOURED if coloured else {}),
                      'accelerometer.noise_density': [0.01, 0.02, 0.03], 'gyroscope.noise_density': [1e-3, 2e-3, 3e-3],
                      **more})


def navigation_jacobian(config, x=()):
    """F (N, N) and B (N, channels) by central differences of the mechanization."""
    f, w = FORCE * FLIP, RATE * FLIP
    size = config.layout.n_navigation + len(config.layout.channels)
    if config.mechanization == PLANAR:
        def after(e):
            north, east, v_n, v_e, yaw = planar.mechanize(VELOCITY[0] + e[2], VELOCITY[1] + e[3], ATTITUDE[2] + e[4],
                                                          f[0] + e[5], f[1] + e[6], w[2] + e[7], DT)
            return e[0] + north, e[1] + east, v_n, v_e, yaw
    else:
        q0 = strapdown.from_euler(*ATTITUDE)
        nominal = strapdown.mechanize(q0, *VELOCITY, tuple(f), tuple(w), DT, 9.81, (0.0,) * 5)[0]

        def after(e):
            q = strapdown.multiply(strapdown.from_rotation_vector(*e[6:9]), q0)
            q, _, _, moved, v = strapdown.mechanize(q, *(VELOCITY + e[3:6]), tuple(f + e[9:12]), tuple(w + e[12:15]),
                                                    DT, 9.81, (0.0,) * 5)
            a, b = (Rotation.from_quat([*p[1:], p[0]]) for p in (q, nominal))
            return np.concatenate([e[:3] + moved, v, (a * b.inv()).as_rotvec()])
    jacobian = central_difference(after, size, 1e-4)
    return jacobian[:, :config.layout.n_navigation], jacobian[:, config.layout.n_navigation:]


def sensor_matrices(config, name):
    """A and Q (m, m) of the sensor error states and the coloured noise, each from its closed form."""
    values, blocks, noise = config.parameters, [], []
    for axis in config.channel_axes:
        sensor = 'accelerometer' if axis < 3 else 'gyroscope'
        if name == 'RW':
            a, q = np.eye(1), [[values[f'{sensor}.random_walk.q'][0] ** 2 * DT]]
        elif name == 'GM':
            tau, sigma = (values[f'{sensor}.gauss_markov.{part}'][0] for part in ('tau', 'sigma'))
            a, q = [[math.exp(-DT / tau)]], [[sigma**2 * (1 - math.exp(-2 * DT / tau))]]
        else:  # Eq. 22, with the 1 in each shifting row
            coefficients = values[f'{sensor}.autoregressive.coefficients']
            p = len(coefficients)
            a = np.vstack([-np.array(coefficients), np.eye(p)[:-1]])
            q = np.zeros((p, p))
            q[0, 0] = values[f'{sensor}.autoregressive.b0'][0] ** 2
        blocks.append(np.asarray(a))
        noise.append(np.asarray(q))
    if config.gnss.coloured:
        decay = math.exp(-DT / 3.0)
        blocks.append(decay * np.eye(2))
        noise.append(0.8**2 * (1 - decay**2) * np.eye(2))
    return block_diag(*blocks), block_diag(*noise)


def dense(config, name):
    """Phi and Q (n, n) of the whole filter."""
    f, b = navigation_jacobian(config)
    a, q = sensor_matrices(config, name)
    layout = config.layout
    output = np.zeros((len(layout.channels), layout.n_augmented))  # c: each channel's error is its first state
    output[range(len(layout.channels)), range(0, layout.n_sensor, layout.order)] = 1
    phi = np.block([[f, b @ output], [np.zeros((layout.n_augmented, layout.n_navigation)), a]])
    values = config.parameters
    density = np.concatenate([values['accelerometer.noise_density'], values['gyroscope.noise_density']])
    squared = density**2
    if config.mechanization == STRAPDOWN:  # an unknown scale factor turns by its share of a turn, which lasts for 5 s
        squared[3:] += 5.0 * values['gyroscope.scale_sigma'] ** 2 * np.square(RATE)
    white = np.diag(squared[config.channel_axes] / DT)  # a sample is a mean over its interval
    return phi, block_diag(b @ white @ b.T, q)


def realistic(config):
    """Scales of the error states: m, m/s, rad, and sensor units."""
    navigation = [2, 2, 0.3, 0.3, 0.05] if config.mechanization == PLANAR else [2, 2, 3, .3, .3, .3, .03, .03, .05]
    channels = [0.1 if axis < 3 else 0.01 for axis in config.channel_axes for _ in range(config.layout.order)]
    return np.array(navigation + channels + ([0.8, 0.8] if config.gnss.coloured else []))


@pytest.mark.parametrize(('name', 'mechanization', 'coloured'), CASES)
def test_covariance_is_predicted_with_the_dense_phi_and_q(name, mechanization, coloured):
    config = settings(name, mechanization, coloured)
    assert config.layout.n == {'planar': 5 + 3 * config.layout.order, 'strapdown': 9 + 6 * config.layout.order}[
        mechanization] + 2 * coloured
    scale = realistic(config)
    p = random_covariance(len(scale), np.random.default_rng(2), scale)
    memory = started(config, velocity=VELOCITY, attitude=ATTITUDE, p=p)
    take_sample(memory, DT, *FORCE, *RATE)
    _, predicted = state_and_covariance(config, memory)
    phi, q = dense(config, name)
    expected = phi @ p @ phi.T + q
    sigma = np.sqrt(np.diag(expected))
    assert predicted / np.outer(sigma, sigma) == pytest.approx(expected / np.outer(sigma, sigma), abs=3e-7)
    assert np.array_equal(predicted, predicted.T)


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_process_noise_alone_is_q(mechanization):
    # given perfect knowledge, so that Phi P Phi^T does not hide Q
    config = settings('AR(2)', mechanization, True)
    n = config.layout.n
    memory = started(config, velocity=VELOCITY, attitude=ATTITUDE, p=np.zeros((n, n)))
    take_sample(memory, DT, *FORCE, *RATE)
    _, predicted = state_and_covariance(config, memory)
    _, q = dense(config, 'AR(2)')
    sigma = np.sqrt(np.diag(q))
    sigma[sigma == 0] = 1.0
    # attitude noise turns the force at mid-interval: exact to |w| dt / 4
    bound = 1e-6 if mechanization == 'planar' else 0.25 * DT * np.linalg.norm(RATE)
    assert predicted / np.outer(sigma, sigma) == pytest.approx(q / np.outer(sigma, sigma), abs=bound)


@pytest.mark.parametrize(('name', 'mechanization', 'coloured'), [c for c in CASES if c[2]])
def test_open_loop_error_state_is_predicted_with_phi(name, mechanization, coloured):
    config = settings(name, mechanization, coloured, feedback='open')
    x = realistic(config) * np.random.default_rng(3).standard_normal(config.layout.n)
    memory = started(config, velocity=VELOCITY, attitude=ATTITUDE, x=x)
    take_sample(memory, DT, *FORCE, *RATE)
    predicted, _ = state_and_covariance(config, memory)
    phi, _ = dense(config, name)
    assert (predicted - phi @ x) / realistic(config) == pytest.approx(np.zeros(len(x)), abs=3e-6)


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
@pytest.mark.parametrize('feedback', ['closed', 'open'])
def test_navigation_solution_is_the_mechanization_of_the_corrected_sample(mechanization, feedback):
    # given estimated sensor errors, which only the closed loop takes out
    config = settings('AR(2)', mechanization, False, feedback=feedback)
    x = np.zeros(config.layout.n)
    errors = 0.1 * np.arange(1.0, len(config.layout.channels) + 1)
    x[config.layout.n_navigation::2] = errors
    memory = started(config, velocity=VELOCITY, attitude=ATTITUDE, x=x)
    before = newest(memory)
    take_sample(memory, DT, *FORCE, *RATE)
    row = newest(memory)
    sample = np.concatenate([FORCE * FLIP, RATE * FLIP])
    if feedback == 'closed':
        sample[config.channel_axes] -= errors
    meridian, prime_vertical = (r + before[Nav.HEIGHT] for r in radii(before[Nav.LATITUDE]))
    if config.mechanization == PLANAR:
        north, east, v_n, v_e, yaw = planar.mechanize(*VELOCITY[:2], ATTITUDE[2], sample[0], sample[1], sample[5], DT)
        assert row[[Nav.V_N, Nav.V_E, Nav.YAW]] == pytest.approx([v_n, v_e, yaw], abs=1e-15)
        assert row[Nav.HEIGHT] == before[Nav.HEIGHT]
    else:
        q, _, _, (north, east, down), v = strapdown.mechanize(
            strapdown.from_euler(*ATTITUDE), *VELOCITY, tuple(sample[:3]), tuple(sample[3:]), DT,
            gravity(before[Nav.LATITUDE], before[Nav.HEIGHT]),
            strapdown.frame_rates(before[Nav.LATITUDE], *VELOCITY[:2], meridian, prime_vertical))
        assert row[Nav.V_N:Nav.V_D + 1] == pytest.approx(v, abs=1e-14)
        assert row[Nav.Q_W:Nav.Q_Z + 1] == pytest.approx(q, abs=1e-15)
        assert before[Nav.HEIGHT] - row[Nav.HEIGHT] == pytest.approx(down, abs=1e-12)
    moved = row[Nav.LATITUDE] - before[Nav.LATITUDE], row[Nav.LONGITUDE] - before[Nav.LONGITUDE]
    assert moved == pytest.approx((north / meridian, east / prime_vertical / math.cos(before[Nav.LATITUDE])), abs=3e-16)


def test_a_long_gap_adds_what_a_vehicle_may_do_unseen():
    config = configure({'mechanization': 'planar', 'imu.max_gap': 0.5})
    sigmas = []
    for gap in (0.49, 0.51, 2.0):
        memory = started(config, velocity=VELOCITY, p=np.eye(8) * 1e-8)
        take_sample(memory, gap, *FORCE, *RATE)
        sigmas.append(np.sqrt(np.diag(state_and_covariance(config, memory)[1])))
    # then nothing below the limit, and at 2 s metres per second and half a radian
    assert sigmas[0][2] < 0.05 and sigmas[0][4] < 0.01
    assert sigmas[2][2] == pytest.approx(3.0, rel=0.01) and sigmas[2][4] == pytest.approx(0.6, rel=0.01)
    assert sigmas[1][2] == pytest.approx(1.5 * 0.51, rel=0.01)


def test_over_a_gap_the_mean_of_the_samples_at_both_ends_counts():
    # given a specific force forwards of 0 before a gap of 2 s and of 1 m/s^2 behind it
    config = configure({'mechanization': 'planar', 'imu.max_gap': 0.5})
    memory = started(config, velocity=(10.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.eye(8) * 1e-8)
    take_sample(memory, 0.1, 0.0, 0.0, 9.8, 0.0, 0.0, 0.0)
    take_sample(memory, 2.1, 1.0, 0.0, 9.8, 0.0, 0.0, 0.0)
    assert newest(memory)[Nav.V_N] == pytest.approx(11.0, abs=1e-6)


def test_the_radii_are_those_of_the_height_that_belongs_to_them():
    # given a vehicle that climbs steeply while it moves so far that they are computed anew, and rows of other heights
    config = configure({'mechanization': 'strapdown', 'imu.max_gap': 9.0})
    memory = started(config, velocity=(15.0, 5.0, -8.0))
    views(memory)[2][1:, Nav.HEIGHT] = 9000.0
    take_sample(memory, 2.0, 0.0, 0.0, 9.8, 0.0, 0.0, 0.0)
    row = newest(memory)
    assert row[Nav.HEIGHT] == pytest.approx(HEIGHT + 16.0, abs=1.0)
    meridian, prime_vertical = radii(row[Nav.LATITUDE])
    assert 1.0 / row[Nav.NORTH_SCALE] == pytest.approx(meridian + row[Nav.HEIGHT], rel=1e-12)
    assert 1.0 / row[Nav.EAST_SCALE] == pytest.approx(
        (prime_vertical + row[Nav.HEIGHT]) * np.cos(row[Nav.LATITUDE]), rel=1e-12)


def stepped(name, steps, more=(), x=None, dt=DT):
    """Sensor states and covariance after each of `steps` samples, planar, open loop."""
    config = settings(name, 'planar', False, **{'feedback': 'open', **dict(more)})
    memory, states = started(config, x=x), []
    for k in range(1, steps + 1):
        take_sample(memory, k * dt, 0.0, 0.0, 9.8, 0.0, 0.0, 0.0)
        states.append(state_and_covariance(config, memory))
    return np.array([s[0] for s in states]), np.array([s[1] for s in states])


def test_erratum_eq_18_gauss_markov_decays_exponentially():
    # given tau 7 s; the printed 1 - beta would turn the sign's size by dt alone
    x = np.zeros(8)
    x[5] = 0.3
    states, _ = stepped('GM', 200, x=x)
    exact = 0.3 * np.exp(-DT * np.arange(1, 201) / 7.0)
    assert states[:, 5] == pytest.approx(exact, rel=1e-12)
    assert abs(0.3 * (1 - 1 / 7.0) - exact[0]) > 0.04  # as printed, after one sample
    assert abs(0.3 * (1 - DT / 7.0) ** 200 - exact[-1]) < 1e-4  # its first order


def test_erratum_eq_22_each_block_shifts_and_there_are_eleven_states():
    # given different past values in all three blocks
    x = np.concatenate([np.zeros(5), [0.1, 0.2, 0.3, 0.4, 0.05, 0.06]])
    states, _ = stepped('AR(2)', 1, x=x)
    assert states.shape[1] == 11
    # then the second state is the first of before, that of f_y, too: the printed row of zeros would give 0
    assert states[0, [6, 8, 10]] == pytest.approx([0.1, 0.3, 0.05], abs=1e-15)
    assert states[0, 7] == pytest.approx(1.2 * 0.3 - 0.4 * 0.4, abs=1e-15)


def test_erratum_eq_16_the_driving_noise_keeps_the_variance_stationary():
    # given the stationary covariance at the start; without b0 w(n) it would die away
    _, p = stepped('AR(2)', 400)
    b0, a1, a2 = ALL['accelerometer.autoregressive.b0'].default[0], -1.2, 0.4
    stationary = b0**2 * (1 + a2) / ((1 - a2) * ((1 + a2) ** 2 - a1**2))  # Box and Jenkins, AR(2)
    initial = stationary + 0.2**2  # of a turn-on bias that no standstill showed
    decayed = np.linalg.matrix_power([[1.2, -0.4], [1, 0]], 400)
    assert p[0, 5, 5] > stationary and initial > p[-1, 5, 5]
    assert p[-1, 5, 5] == pytest.approx(stationary, rel=1e-6)
    assert decayed[0, 0] ** 2 * initial < 1e-9 * stationary


@pytest.mark.parametrize('ratio', [1.0, 2.5, 10.0])
def test_autoregressive_model_steps_once_per_its_own_interval_and_holds_in_between(ratio):
    more = {'accelerometer.autoregressive.interval': ratio * DT, 'gyroscope.autoregressive.interval': 2 * ratio * DT}
    x = np.concatenate([np.zeros(5), [0.1, 0.2, 0.3, 0.4, 0.05, 0.06]])
    states, p = stepped('AR(2)', 100, more, x)
    for k in range(100):
        for start, coefficients, interval in ((5, (-1.2, 0.4), ratio), (7, (-1.2, 0.4), ratio),
                                              (9, (-1.08, 0.4), 2 * ratio)):
            steps = math.floor((k + 1) / interval + 1e-9)
            companion = np.array([[-coefficients[0], -coefficients[1]], [1, 0]])
            expected = np.linalg.matrix_power(companion, steps) @ x[start:start + 2]
            assert states[k, start:start + 2] == pytest.approx(expected, abs=1e-14)
    # and P steps with it
    changed = np.flatnonzero(np.abs(np.diff(p[:, 5, 5])) > 0) + 2  # the number of the sample that changed it
    expected = [k for k in range(2, 101) if math.floor(k / ratio + 1e-9) > math.floor((k - 1) / ratio + 1e-9)]
    assert list(changed[:30]) == expected[:30]


def test_the_mean_over_a_whole_step_is_what_the_velocity_sees():
    # given a held error: over ten IMU intervals it moves the velocity error by ten times dt
    x = np.zeros(11)
    x[5] = 0.1
    states, _ = stepped('AR(2)', 10, {'accelerometer.autoregressive.interval': 10 * DT}, x)
    assert np.hypot(states[8, 2], states[8, 3]) == pytest.approx(9 * DT * 0.1, rel=1e-9)


@pytest.mark.parametrize('dt', [DT, 0.1, 2.0, 100.0])
def test_states_decay_as_exponentials_also_where_only_one_of_them_decays_fast(dt):
    config = configure({**MODEL_VALUES['GM'], 'mechanization': 'strapdown', **COLOURED})
    memory, m = started(config), config.layout.n_augmented
    at, rates = int(memory[Head.SCRATCH_AT]), memory[[decay_at(j) for j in range(m)]]
    assert len(set(rates)) == 3
    _decays(memory, at, dt, m)
    assert memory[at:at + m] == pytest.approx(np.exp(-dt * rates), rel=1e-14)
