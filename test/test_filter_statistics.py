"""Consistency over many seeds: NIS and NEES in their chi-square bounds, errors as large as their sigmas say.

Truth is the simulator's: for the planar mechanization a level road in an inertial frame, for strapdown hills and a
rotating earth. First the filter alone, started with errors drawn from its own initial covariance; then with its own
alignment.
"""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import MODELS, configure, fix_event, started, take_all
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from mems_ins_fusion.filter.memory import NAV, PLANAR, Event, Head, Nav, covariance, views
from mems_ins_fusion.filter.runs import replay
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.navigation.frames import wrap
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

RATE, DURATION = 20.0, 150.0
SIGMA = 1.5  # m, of a fix
YAW_SIGMA = 0.05  # rad, of a heading that is given
SEEDS = 24
#: turn-on biases only as large as a random walk's start; the other two models start stationary
START = {'random_walk': {'accelerometer.initial_sigma': [0.05], 'gyroscope.initial_sigma': [1e-3]},
         'gauss_markov': {'accelerometer.initial_sigma': [1e-9], 'gyroscope.initial_sigma': [1e-9]},
         'autoregressive': {'accelerometer.initial_sigma': [1e-9], 'gyroscope.initial_sigma': [1e-9]}}
COLOURED = {'gnss.coloured_noise.sigma': 1.0, 'gnss.coloured_noise.tau': 15.0}
EARTH = 6.378e6


@pytest.fixture(scope='module')
def drives():
    made = {}

    def drive(seed, strapdown):
        if (seed, strapdown) not in made:
            made[seed, strapdown] = simulate_drive(DURATION, seed, RATE, standstill=4.0, hills=strapdown,
                                                   rotating_earth=strapdown)
        return made[seed, strapdown]
    return drive


def filtered(config, drive, seed):
    """Navigation and sensor errors (k, N), (k, channels), states (k, width) and events of the fixes of one run."""
    sensors = SensorErrors.from_parameters(config.parameters, config.parameters['sensor_error_model'])
    simulation = simulate_recording(drive, sensors, GnssNoise(SIGMA, 1.0), seed=seed)
    imu, gnss = simulation.recording.imu, simulation.recording.gnss
    memory, initial = start_drawn(config, drive, np.random.default_rng(1000 + seed))
    time = (imu.stamp - imu.stamp[0]) * 1e-9
    north, east = coloured_noise(config, np.random.default_rng(2000 + seed), len(gnss))
    latitude = gnss.latitude + north / EARTH
    longitude = gnss.longitude + east / (EARTH * np.cos(gnss.latitude))
    fixes = np.array([fix_event(*fix, SIGMA**2 * np.eye(2), (1.5 * SIGMA) ** 2) for fix in zip(
        (gnss.stamp - imu.stamp[0]) * 1e-9, latitude, longitude, gnss.height)])
    samples = np.column_stack([time, imu.specific_force, imu.angular_rate])[1:]
    states, fixes = take_all(memory, samples, fixes, np.arange(views(memory)[2].shape[1]))
    return navigation_error(config, states, drive), sensor_error(config, states, simulation), states, fixes


def start_drawn(config, drive, rng):
    """A memory started at rest with errors drawn from the initial covariance."""
    planar = config.mechanization == PLANAR
    navigation = [2, 2, .1, .1, .03] if planar else [2, 2, 3, .1, .1, .1, .01, .01, .03]
    p = np.zeros((config.layout.n,) * 2)
    first, order = config.layout.n_navigation, config.layout.order
    p[:first, :first] = np.diag(np.square(navigation))
    for i, model in enumerate(config.models):
        at = slice(first + i * order, first + (i + 1) * order)
        p[at, at] = model.initial_covariance()
    if config.gnss.coloured:
        p[-2:, -2:] = config.gnss.coloured.sigma**2 * np.eye(2)
    e = np.array(navigation) * rng.standard_normal(config.layout.n_navigation)
    memory = started(config, velocity=(0, 0, 0), attitude=(0, 0, 0), p=p)
    row = views(memory)[2][0]
    meridian, prime_vertical = radii(drive.latitude[0])
    height = drive.height[0]
    row[Nav.LATITUDE] = drive.latitude[0] + e[0] / (meridian + height)
    row[Nav.LONGITUDE] = drive.longitude[0] + e[1] / ((prime_vertical + height) * math.cos(drive.latitude[0]))
    row[Nav.HEIGHT] = height
    if planar:
        row[[Nav.V_N, Nav.V_E, Nav.YAW]] = *e[2:4], drive.yaw[0] + e[4]
    else:
        row[Nav.HEIGHT] -= e[2]
        row[Nav.V_N:Nav.V_D + 1] = e[3:6]
        true = Rotation.from_euler('ZYX', [drive.yaw[0], drive.pitch[0], drive.roll[0]])
        x, y, z, w = (Rotation.from_rotvec(e[6:]) * true).as_quat()
        row[Nav.Q_W:Nav.Q_Z + 1] = w, x, y, z
    row[Nav.NORTH_SCALE] = 1 / (meridian + row[Nav.HEIGHT])
    row[Nav.EAST_SCALE] = 1 / ((prime_vertical + row[Nav.HEIGHT]) * math.cos(row[Nav.LATITUDE]))
    row[Nav.RADII_LATITUDE] = row[Nav.LATITUDE]
    return memory, e


def coloured_noise(config, rng, n):
    """North and east of the receiver's slow error at fixes one second apart."""
    if not config.gnss.coloured:
        return np.zeros((2, n))
    decay = math.exp(-1 / config.gnss.coloured.tau)
    noise, value = np.empty((2, n)), config.gnss.coloured.sigma * rng.standard_normal(2)
    for k in range(n):
        noise[:, k] = value
        value = decay * value + config.gnss.coloured.sigma * math.sqrt(1 - decay**2) * rng.standard_normal(2)
    return noise


def navigation_error(config, states, drive):
    """INS minus truth (k, N)."""
    k = slice(len(drive.time) - len(states), None)
    latitude, height = drive.latitude[k], drive.height[k]
    meridian, prime_vertical = radii(latitude)
    error = [(states[:, Nav.LATITUDE] - latitude) * (meridian + height),
             (states[:, Nav.LONGITUDE] - drive.longitude[k]) * (prime_vertical + height) * np.cos(latitude)]
    if config.mechanization == PLANAR:
        error += [*(states[:, Nav.V_N:Nav.V_E + 1] - drive.velocity[k, :2]).T, wrap(states[:, Nav.YAW] - drive.yaw[k])]
    else:
        attitude = Rotation.from_quat(states[:, [Nav.Q_X, Nav.Q_Y, Nav.Q_Z, Nav.Q_W]])
        true = Rotation.from_euler('ZYX', np.column_stack([drive.yaw, drive.pitch, drive.roll])[k])
        error += [height - states[:, Nav.HEIGHT], *(states[:, Nav.V_N:Nav.V_D + 1] - drive.velocity[k]).T,
                  *(attitude * true.inv()).as_rotvec().T]
    return np.column_stack(error)


def sensor_error(config, states, simulation):
    """True minus estimated error of each channel (k, channels): what still drives the navigation errors."""
    at = NAV + config.layout.n_navigation
    estimate = states[:, at:at + len(config.layout.channels) * config.layout.order:config.layout.order]
    return simulation.sensor_errors[-len(states):, config.channel_axes] - estimate


def known_states(config):
    """The error states whose truth the simulator tells: of an AR(p) block the newest value."""
    sensors = config.layout.n_navigation + config.layout.order * np.arange(len(config.layout.channels))
    return [*range(config.layout.n_navigation), *sensors]


def statistics(config, drives, strapdown, seeds=SEEDS):
    """NEES (seeds, times), error over sigma (seeds, times, states), NIS (seeds, fixes)."""
    index, instants = known_states(config), np.arange(int(10 * RATE), int(DURATION * RATE), int(20 * RATE))
    nees, normalized, nis = [], [], []
    for seed in range(seeds):
        navigation, sensors, states, fixes = filtered(config, drives(seed, strapdown), seed)
        error = np.column_stack([navigation, sensors])[instants]
        p = np.array([covariance(states[k], config.layout)[np.ix_(index, index)] for k in instants])
        nees.append(np.einsum('ki,ki->k', error, np.linalg.solve(p, error[..., None])[..., 0]))
        normalized.append(error / np.sqrt(np.einsum('kii->ki', p)))
        nis.append(fixes[1:, Event.NIS])
    return np.array(nees), np.array(normalized), np.array(nis)


def assert_consistent(nees, normalized, nis, dimension):
    """Each instant's mean NEES within its chi-square bounds (1e-4 on each side), NIS and each state's rms as well."""
    seeds = len(nees)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], seeds * dimension) / seeds
    assert np.all((low < nees.mean(axis=0)) & (nees.mean(axis=0) < high)), (nees.mean(axis=0), low, high)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 2 * nis.size) / nis.size
    assert low < nis.mean() < high
    # instants of one run are not independent: the bounds are those of two independent ones
    low, high = np.sqrt(chi2.ppf([1e-5, 1 - 1e-5], 2 * seeds) / (2 * seeds))
    rms = np.sqrt(np.mean(normalized**2, axis=(0, 1)))
    assert np.all((low < rms) & (rms < high)), (rms, low, high)


@pytest.mark.parametrize(('mechanization', 'model', 'more'), [
    *[('planar', model, {}) for model in MODELS], ('planar', 'gauss_markov', COLOURED),
    ('planar', 'random_walk', {'feedback': 'open'}), *[('strapdown', model, {}) for model in MODELS]])
def test_errors_are_as_large_as_the_covariance_says(drives, mechanization, model, more):
    config = configure({**START[model], **{k: v for k, v in more.items() if k != 'feedback'}}, sensor_error_model=model,
                       mechanization=mechanization)
    assert_consistent(*statistics(config, drives, mechanization == 'strapdown'), len(known_states(config)))


def test_a_wrong_noise_is_seen(drives):
    # given a filter that believes in fixes and sensors twice as good, or as bad, as they are
    for factor in (0.5, 2.0):
        config = configure(START['gauss_markov'])
        truth = dict(config.parameters)
        values = {'accelerometer.noise_density': [factor * 0.01], 'gyroscope.noise_density': [factor * 3e-4],
                  'accelerometer.gauss_markov.sigma': [factor * 0.05], 'gyroscope.gauss_markov.sigma': [factor * 1e-3]}
        mistuned = configure({**START['gauss_markov'], **values})
        mistuned.parameters.update({name: truth[name] for name in values})  # what simulates the sensors
        with pytest.raises(AssertionError):
            assert_consistent(*statistics(mistuned, drives, False, 8), len(known_states(config)))


# --- with its own alignment ---

def aligned(mechanization, model, heading, level, seeds, rate=25.0, still=20.0):
    """Over seeds: navigation errors over sigma (each second, 5), NIS of the fixes, gyroscope bias over sigma."""
    errors, nis, bias = [], [], []
    for seed in range(seeds):
        drive = simulate_drive(90.0, 100 + seed, rate, standstill=still, rotating_earth=mechanization == 'strapdown')
        yaw = drive.yaw[0] + YAW_SIGMA * np.random.default_rng(seed).standard_normal()
        config = configure({'alignment.level': level, 'alignment.heading': heading, 'alignment.yaw': float(wrap(yaw)),
                            'alignment.yaw_sigma': YAW_SIGMA}, mechanization=mechanization, sensor_error_model=model)
        sensors = SensorErrors.from_parameters(config.parameters, model)
        simulation = simulate_recording(drive, sensors, GnssNoise(SIGMA, 1.0), seed=seed)
        result = replay.run(config, simulation.recording.imu, simulation.recording.gnss)
        i = result.index
        east = (result.longitude - drive.longitude[i]) * EARTH * np.cos(drive.latitude[i])
        error = np.column_stack([(result.latitude - drive.latitude[i]) * EARTH, east,
                                 result.velocity[:, :2] - drive.velocity[i, :2], wrap(result.yaw - drive.yaw[i])])
        columns = range(5) if mechanization == 'planar' else [0, 1, 3, 4, 8]
        errors.append((error / result.sigma[:, columns])[:int(60 * rate):int(rate)])
        nis.append(result.innovations.nis[:50])
        # leveling takes the accelerometers' biases for tilt, which is right as long as the vehicle stays level
        gyroscopes = [channel for channel, axis in enumerate(config.channel_axes) if axis >= 3]
        axes = np.array(config.channel_axes)[gyroscopes]
        total = result.sensor_errors[0, gyroscopes] - views(result.memory)[0][Head.OFFSET + axes]
        at = config.layout.n_navigation + config.layout.order * np.array(gyroscopes)
        bias.append((simulation.sensor_errors[i[0], axes] - total) / result.sigma[0, at])
    return np.array(errors), np.array(nis), np.array(bias)


def rms(values, axis=0):
    return np.sqrt(np.mean(np.square(values), axis=axis))


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
@pytest.mark.parametrize(('model', 'heading', 'level'), [
    ('random_walk', 'course', True), ('gauss_markov', 'course', False), ('autoregressive', 'parameter', True),
    ('gauss_markov', 'parameter', False)])
def test_a_filter_that_aligned_itself_is_consistent(mechanization, model, heading, level):
    seeds = 12
    errors, nis, bias = aligned(mechanization, model, heading, level, seeds)
    assert np.all(rms(errors, (0, 1)) < 1.4)  # one of 12 seeds' rms beyond that: 3 in 1000
    assert np.all(rms(errors[:, :3]) < 2.0)
    low, high = 2 * 0.8, chi2.ppf(1 - 1e-4, 2 * nis.size) / nis.size
    assert low < nis.mean() < high
    assert np.all(rms(bias) < math.sqrt(chi2.ppf(1 - 1e-4, seeds) / seeds))
