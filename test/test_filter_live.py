"""The live filter and the replay of a recording are one filter: the same events give the same bits."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_support import MODELS, configure, newest

from mems_ins_fusion.filter.memory import NAV, Event, Kind, Verdict
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.live_output import published as would_publish
from mems_ins_fusion.filter.runs.odometry import POSE_COVARIANCE, TWIST_COVARIANCE, published_covariance
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.navigation.frames import wrap
from mems_ins_fusion.samples import Aiding, Fixes, Headings, ImuSamples, Speeds, Velocities
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

RATE = 50.0
#: what is to become the default
TRUST = {'gnss.gate_probability': 0.999999, 'gnss.adapt_sigma': True, 'gnss.robust_sigma': 3.0}


@pytest.fixture(scope='module')
def drive():
    return simulate_drive(140.0, 8, RATE, standstill=12.0)


def recorded(drive, model, **gnss):
    values = configure(sensor_error_model=model).parameters
    recording = simulate_recording(drive, SensorErrors.from_parameters(values, model),
                                   GnssNoise(1.0, 4.0, **gnss), seed=3).recording
    return recording.imu, recording.gnss


def troubled(imu: ImuSamples, fixes: Fixes) -> tuple[ImuSamples, Fixes]:
    """The same with samples that are not numbers, doubled, backwards and delayed, and a restart of the IMU's clock."""
    n = len(imu)
    force, stamp = imu.specific_force.copy(), imu.stamp.copy()
    force[300, 1], force[1500] = np.nan, np.inf
    stamp[1700] = stamp[1699]  # twice
    stamp[1800] = stamp[1790]  # backwards
    stamp[1900] += 3_600_000_000_000  # one jump
    keep = np.ones(n, bool)
    keep[2000:2040] = False  # a gap that is bridged
    received = imu.received + 3_000_000
    received[2100:2150] = received[2150]  # they arrive in a burst
    # after 100 s the clock starts anew, so that the filter must align once more
    half = int(66 * RATE)
    stamp[half:] += 50_000_000_000
    late = fixes.stamp > imu.stamp[half]
    fix_stamp = np.where(late, fixes.stamp + 50_000_000_000, fixes.stamp)
    fix_received = fixes.received.copy()
    fix_received[::7] += 900_000_000  # some are much later than others: they overtake each other
    order = np.argsort(fix_received, kind='stable')
    latitude, status = fixes.latitude.copy(), fixes.status.copy()
    latitude[40], status[41] = np.nan, -1
    fix_stamp[60] = fix_stamp[59]
    moved = replace(fixes, stamp=fix_stamp, received=fix_received, latitude=latitude, status=status)
    return replace(imu, stamp=stamp, received=received, specific_force=force).select(keep), moved.select(order)


def aided(drive, seed=4, latency=0.3) -> Aiding:
    """Speed at the axle 1.1 m behind with 2 % too much, velocity of the antenna and heading, each late by up to
    `latency`, at rates that do not fit the IMU's, so that each overtakes others."""
    rng = np.random.default_rng(seed)

    def at(rate, phase):
        time = np.arange(phase, drive.time[-1] - 1.0, 1 / rate)
        stamp = drive.stamp[0] + np.round(time * 1e9).astype(np.int64)
        return time, stamp, stamp + np.round(latency * rng.random(len(time)) * 1e9).astype(np.int64)

    def of(values, time):
        return np.column_stack([np.interp(time, drive.time, column) for column in values.T])

    def by_arrival(samples):
        return samples.select(np.argsort(samples.received, kind='stable'))

    time, stamp, received = at(7.0, 0.31)
    forward = np.einsum('ki,ki->k', drive.attitude.as_matrix()[:, :, 0], drive.velocity)
    speed = 1.02 * np.interp(time, drive.time, forward) + 0.1 * rng.standard_normal(len(time))
    speeds = Speeds(stamp, received, speed, np.full(len(time), 0.1**2))
    time, stamp, received = at(3.0, 0.17)
    velocities = Velocities(stamp, received, of(drive.velocity, time) + 0.2 * rng.standard_normal((len(time), 3)),
                            np.tile(0.2**2 * np.eye(3), (len(time), 1, 1)))
    time, stamp, received = at(1.3, 0.23)
    yaw = np.interp(time, drive.time, np.unwrap(drive.yaw)) + 0.03 * rng.standard_normal(len(time))
    headings = Headings(stamp, received, wrap(yaw), np.full(len(time), 0.03**2))
    return Aiding(speed=by_arrival(speeds), velocity=by_arrival(velocities), heading=by_arrival(headings))


def in_order(imu, fixes, aiding):
    """(how many IMU samples came before, method of the filter, its arguments) of each measurement, as they arrive."""
    events = []
    for order, (name, samples, arguments) in enumerate((
            ('fix', fixes, lambda s, i: (float(s.latitude[i]), float(s.longitude[i]), float(s.height[i]),
                                             s.covariance[i].ravel(), int(s.status[i]), int(s.covariance_type[i]))),
            ('speed', aiding.get('speed'), lambda s, i: (float(s.speed[i]), float(s.variance[i]))),
            ('velocity', aiding.get('velocity'), lambda s, i: (s.velocity[i], s.covariance[i])),
            ('heading', aiding.get('heading'), lambda s, i: (float(s.yaw[i]), float(s.variance[i]))))):
        if samples is not None:
            after = np.searchsorted(imu.received, samples.received, side='right')
            events += [((after[i], samples.received[i], order, i), name, int(samples.stamp[i]), arguments(samples, i))
                       for i in range(len(samples))]
    return [(place[0], *(('add_fix', (stamp, *arguments)) if name == 'fix' else ('add', (name, stamp, *arguments))))
            for place, name, stamp, arguments in sorted(events, key=lambda event: event[0])]


def live(config, imu, fixes, aiding=Aiding()):
    """Everything a live node would have published, fed event by event."""
    fusion, published, notices = FusionFilter(config), [], []
    events = in_order(imu, fixes, aiding)
    for k in range(len(imu)):
        while events and events[0][0] <= k:
            _, name, arguments = events.pop(0)
            getattr(fusion, name)(*arguments)
        if fusion.add_imu(int(imu.stamp[k]), *map(float, imu.specific_force[k]),
                          *map(float, imu.angular_rate[k])) and fusion.aligned:
            stamp = fusion.update_odometry()
            row = newest(fusion._memory)
            sigma = np.sqrt(np.diag(published_covariance(row, config.layout)))
            published.append((k, stamp, *fusion.geodetic, *sigma, row))
        notices += fusion.notices()
    return published, notices


@pytest.mark.parametrize('feedback', ['closed', 'open'])
@pytest.mark.parametrize('model', MODELS)
@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_live_and_replay_give_the_same_bits(drive, mechanization, model, feedback):
    # given a recording with fixes that come 0.2 to 1.1 s late, and everything that goes wrong
    config = configure({'gnss.lever_arm': [0.5, 0.2, 1.0], 'gnss.coloured_noise.sigma': 0.3, 'gnss.robust_sigma': 4.0},
                       mechanization=mechanization, sensor_error_model=model, feedback=feedback)
    imu, fixes = troubled(*recorded(drive, model, latency=0.2))
    published, notices = live(config, imu, fixes)
    replayed = run(config, imu, fixes)
    # then each state that the live filter published is in the replay, twice aligned
    index = np.array([p[0] for p in published])
    at = np.searchsorted(replayed.index, index)
    assert len(index) > 4000 and np.array_equal(replayed.index[at], index)
    assert np.count_nonzero(np.diff(index) > 100) == 1
    assert np.array_equal(replayed.stamp[at], [p[1] for p in published])
    geodetic = np.array([p[2:5] for p in published])
    assert np.array_equal(np.column_stack([replayed.latitude, replayed.longitude, replayed.height])[at], geodetic)
    assert np.array_equal(replayed.sigma[at], np.array([p[5:-1] for p in published]))
    first = NAV + config.layout.n_navigation
    errors = np.array([p[-1][first:first + config.layout.n_sensor:config.layout.order] for p in published])
    assert np.array_equal(replayed.sensor_errors[at], errors)
    assert np.array_equal(newest(replayed.memory), published[-1][-1])
    # and it is the whole of it, but for the moments before the fix that started the filter had come
    missing = np.setdiff1d(replayed.index, index)
    assert len(missing) < 2 * 0.5 * RATE
    # and both have said the same of the data
    def texts(items):
        return sorted(n.text for n in items if 'dropped' in n.text or 'jumped' in n.text or 'status' in n.text)
    assert texts(notices) == texts(replayed.notices)
    assert len(texts(notices)) >= 8


@pytest.mark.parametrize(('mechanization', 'feedback'), [('planar', 'closed'), ('strapdown', 'open'),
                                                         ('strapdown', 'closed')])
def test_live_and_replay_give_the_same_bits_with_all_that_can_be_measured(drive, mechanization, feedback):
    # given speed, velocity and heading, too, which come late and overtake each other, and all optional states
    config = configure({'speed_topic': '/speed', 'velocity_topic': '/velocity', 'heading_topic': '/heading',
                        'vehicle.non_holonomic': True, 'vehicle.zero_velocity': True, 'imu.mounting_sigma': 0.03,
                        'vehicle.rear_axle_sigma': 0.5, 'gnss.coloured_noise.sigma': 0.3, **TRUST},
                       mechanization=mechanization, feedback=feedback)
    imu, fixes = troubled(*recorded(drive, 'gauss_markov', latency=0.2))
    aiding = aided(drive)
    published, notices = live(config, imu, fixes, aiding)
    replayed = run(config, imu, fixes, aiding)
    index = np.array([p[0] for p in published])
    at = np.searchsorted(replayed.index, index)
    assert len(index) > 4000 and np.array_equal(replayed.index[at], index)
    assert np.array_equal(np.column_stack([replayed.latitude, replayed.longitude, replayed.height])[at],
                          np.array([p[2:5] for p in published]))
    assert np.array_equal(replayed.sigma[at], np.array([p[5:-1] for p in published]))
    first = NAV + config.layout.n_navigation + config.layout.n_sensor
    extras = np.array([p[-1][first:first + len(config.extras)] for p in published])
    assert len(config.extras) == (10 if mechanization == 'planar' else 12)
    assert np.array_equal(replayed.extras[at], extras)
    assert np.array_equal(newest(replayed.memory), published[-1][-1])
    # and each of them has been used
    for kind in (Kind.POSITION, Kind.SPEED, Kind.VELOCITY, Kind.HEADING):
        assert replayed.measured.verdicts(kind)[Verdict.USED] > 20


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_live_and_replay_give_the_same_bits_where_fixes_are_withdrawn(drive, mechanization):
    # given a receiver whose fixes come late, and that goes straight on for 5 s while the vehicle is fast
    config = configure(TRUST, mechanization=mechanization)
    imu, fixes = recorded(drive, 'gauss_markov', latency=0.2)
    speed = np.interp(fixes.stamp, drive.stamp, np.hypot(*drive.velocity.T[:2]))
    begin = next(i for i in range(240, len(fixes)) if speed[i - 40:i + 20].min() > 6.0)
    gone = np.arange(1, 21)
    for values in (fixes.latitude, fixes.longitude):
        values[begin:begin + 20] = values[begin - 1] + gone * (values[begin - 1] - values[begin - 21]) / 20
    fixes.latitude[begin:begin + 20] += gone * 0.5 / 6.37e6  # by 2 m/s off, so that they do depart
    published, _ = live(config, imu, fixes)
    replayed = run(config, imu, fixes)
    # then all of them are refused in the end, the first ones too
    verdicts = replayed.measured.event[np.isin(replayed.measured.index, begin + np.arange(20)), Event.VERDICT]
    assert len(verdicts) == 20 and (verdicts == Verdict.EXTRAPOLATED).all()
    # and what was published meanwhile is the same
    index = np.array([p[0] for p in published])
    at = np.searchsorted(replayed.index, index)
    assert np.array_equal(replayed.index[at], index)
    assert np.array_equal(np.column_stack([replayed.latitude, replayed.longitude, replayed.height])[at],
                          np.array([p[2:5] for p in published]))
    assert np.array_equal(newest(replayed.memory), published[-1][-1])


@pytest.mark.parametrize(('mechanization', 'feedback'), [('planar', 'closed'), ('planar', 'open'),
                                                         ('strapdown', 'closed')])
def test_what_a_replay_publishes_is_what_a_live_filter_publishes(drive, mechanization, feedback):
    # given fixes whose stated height varies, and a restart
    config = configure({'datum': [48.0, 11.5, 400.0]}, mechanization=mechanization, feedback=feedback)
    imu, fixes = troubled(*recorded(drive, 'gauss_markov', latency=0.2))
    fixes.covariance[:, 2, 2] = 4.0 + np.arange(len(fixes)) % 5
    fusion, odometry = FusionFilter(config), {}
    events = in_order(imu, fixes, Aiding())
    for k in range(len(imu)):
        while events and events[0][0] <= k:
            _, name, arguments = events.pop(0)
            getattr(fusion, name)(*arguments)
        if fusion.add_imu(int(imu.stamp[k]), *map(float, imu.specific_force[k]), *map(float, imu.angular_rate[k])):
            stamp = fusion.update_odometry()
            odometry[stamp] = fusion.odometry.copy()
    keep = np.arange(len(imu)) % 3 == 0
    stamp, rows = would_publish(config, imu, fixes, Aiding(), config.datum, keep)
    common = np.isin(stamp, list(odometry))
    assert common.sum() > 1500 and common.mean() > 0.95
    assert np.array_equal(rows[common], [odometry[s] for s in stamp[common].tolist()])


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_an_arm_that_is_not_known_is_in_the_published_covariance_of_the_position_alone(drive, mechanization):
    # given the same fixes for a filter whose arm is known and one whose arm is not, to 0.4 m
    imu, fixes = recorded(drive, 'gauss_markov')
    known, unknown = (FusionFilter(configure({'gnss.lever_arm': [0.5, 0.2, 1.0], 'gnss.lever_arm_sigma': sigma},
                                             mechanization=mechanization)) for sigma in (0.0, 0.4))
    for fusion in (known, unknown):
        events = in_order(imu, fixes, Aiding())
        for k in range(3000):
            while events and events[0][0] <= k:
                _, name, arguments = events.pop(0)
                getattr(fusion, name)(*arguments)
            fusion.add_imu(int(imu.stamp[k]), *map(float, imu.specific_force[k]), *map(float, imu.angular_rate[k]))
        fusion.update_odometry()
    # then east and north have its variance more, and nothing else differs
    more = np.zeros_like(known.odometry)
    more[[POSE_COVARIANCE, POSE_COVARIANCE + 7]] = 0.16
    assert unknown.odometry - known.odometry == pytest.approx(more, abs=1e-12)
    assert unknown.position_covariance_enu - known.position_covariance_enu == pytest.approx(
        np.diag([0.16, 0.16, 0.0]).ravel(), abs=1e-12)
    assert known.odometry[TWIST_COVARIANCE] > 0.0 and known.odometry[POSE_COVARIANCE] > 0.0
    # and so has the covariance of a replay
    exact, inexact = (run(fusion.config, imu, fixes) for fusion in (known, unknown))
    assert inexact.sigma[:, :2] ** 2 - exact.sigma[:, :2] ** 2 == pytest.approx(np.full((len(exact.sigma), 2), 0.16))
    assert np.array_equal(inexact.sigma[:, 3:], exact.sigma[:, 3:])


def test_a_recording_without_trouble_is_the_same_too(drive):
    # and one in which each fix arrives together with a sample: it comes after it
    config = configure()
    imu, fixes = recorded(drive, 'gauss_markov')
    fixes = replace(fixes, received=imu.received[np.searchsorted(imu.received, fixes.received).clip(max=len(imu) - 1)])
    published, _ = live(config, imu, fixes)
    replayed = run(config, imu, fixes)
    first = len(replayed.index) - len(published)  # what went by before the fix that started it had come
    assert first <= 1 and np.array_equal(replayed.index[first:], [p[0] for p in published])
    assert np.array_equal(replayed.latitude[first:], [p[2] for p in published])


def test_stamps_from_zero_are_stamps(drive):
    # given a simulator's clock that starts at 0
    config = configure()
    imu, fixes = recorded(drive, 'gauss_markov')
    zero = imu.stamp[0]
    imu = replace(imu, stamp=imu.stamp - zero, received=imu.received - zero)
    fixes = replace(fixes, stamp=fixes.stamp - zero, received=fixes.received - zero)
    published, _ = live(config, imu, fixes)
    assert np.array_equal(run(config, imu, fixes).latitude, [p[2] for p in published])


def test_fixes_that_come_late_lead_to_the_same_state(drive):
    # given the same fixes at once and 0.4 s late, all of them before the end
    config = configure({'alignment.heading': 'parameter', 'alignment.yaw': 1.0})
    imu, fixes = recorded(drive, 'gauss_markov')
    fixes = fixes.select(fixes.stamp < imu.stamp[-1] - 1_000_000_000)
    late = replace(fixes, received=fixes.received + 400_000_000)
    first = fixes.received <= fixes.received[16]  # the start in time, so that it is the same one
    late = replace(late, received=np.where(first, fixes.received, late.received))
    a, b = run(config, imu, fixes), run(config, imu, late)
    assert a.start.time == b.start.time
    assert np.array_equal(newest(a.memory), newest(b.memory))
    assert not np.array_equal(a.latitude, b.latitude)
    assert np.array_equal(a.innovations.nis, b.innovations.nis)


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_open_loop_is_closed_loop_to_first_order(drive, mechanization):
    # given good sensors, so that the errors that the open loop lets grow stay small
    values = {'accelerometer.initial_sigma': [0.01], 'gyroscope.initial_sigma': [1e-4],
              'accelerometer.gauss_markov.sigma': [0.005], 'gyroscope.gauss_markov.sigma': [3e-5],
              'accelerometer.noise_density': [0.002], 'gyroscope.noise_density': [3e-5], 'gyroscope.scale_sigma': 0.0,
              'alignment.heading': 'parameter', 'alignment.yaw': float(np.angle(np.exp(1j * drive.yaw[0]))),
              'alignment.yaw_sigma': 0.01, 'mechanization': mechanization}
    config = configure(values)
    recording = simulate_recording(drive, SensorErrors.from_parameters(config.parameters, 'gauss_markov'),
                                   GnssNoise(0.3, 4.0), seed=5).recording
    closed, opened = (run(configure({**values, 'feedback': feedback}), recording.imu, recording.gnss)
                      for feedback in ('closed', 'open'))
    n = slice(len(closed.stamp) // 2, None)
    north = (closed.latitude - opened.latitude)[n] * 6.37e6
    east = (closed.longitude - opened.longitude)[n] * 6.39e6 * math.cos(closed.latitude[0])
    # then both differ by a small part of their sigma, and have the same covariance
    assert np.abs(north).max() < 0.15 * closed.sigma[n, 0].mean() and np.abs(north).max() > 0
    assert np.abs(east).max() < 0.15 * closed.sigma[n, 1].mean()
    yaw = 4 if mechanization == 'planar' else 8
    assert np.abs(closed.yaw - opened.yaw)[n].max() < 0.15 * closed.sigma[n, yaw].mean()
    assert np.abs(np.log(opened.sigma[n] / closed.sigma[n])).max() < 0.05


def test_what_goes_on_is_said_once():
    # given an IMU with twenty times the noise that is assumed, for four minutes
    drive = simulate_drive(240.0, 8, RATE, standstill=12.0)
    imu, fixes = recorded(drive, 'gauss_markov')
    noise = 20 * 3e-4 * math.sqrt(RATE) * np.random.default_rng(1).standard_normal(imu.angular_rate.shape)
    shaken = replace(imu, angular_rate=imu.angular_rate + noise)
    config = configure({'imu.adapt_noise': True, 'vehicle.non_holonomic': True, 'vehicle.zero_velocity': True, **TRUST},
                       mechanization='strapdown')
    # then it is told so after a minute of that, and not again
    _, notices = live(config, shaken, fixes)
    assert sum('vibrates faster' in notice.text for notice in notices) == 1
