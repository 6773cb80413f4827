"""The smoother: against a dense one of Rauch, Tung and Striebel, against truth, through outages and restarts."""
from __future__ import annotations

import numpy as np
import pytest
from filter_support import HEIGHT, LATITUDE, LONGITUDE, configure, newest, take_all

from mems_ins_fusion.evaluation.metrics import NEES_95, Truth, position_errors, rms
from mems_ins_fusion.filter.memory import NAV, STRAPDOWN, Event, Verdict, covariance, newest_row
from mems_ins_fusion.filter.runs import replay, smoothing
from mems_ins_fusion.filter.start.alignment import Start
from mems_ins_fusion.filter.start.initial import initialize
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Fixes, ImuSamples, Velocities
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

RATE, SECONDS = 20, 12
STEP = 10**9 // RATE


def _drive(seed=3):
    """An IMU that turns and brakes at RATE, fixes and velocities, none of it consistent: a smoother is linear."""
    rng = np.random.default_rng(seed)
    n = RATE * SECONDS + 1
    stamp = np.arange(n, dtype=np.int64) * STEP
    time = stamp * 1e-9
    force = np.column_stack([np.sin(0.7 * time), 1.5 * np.cos(0.4 * time), 9.8 + 0.1 * rng.standard_normal(n)])
    rate = np.column_stack([0.02 * np.sin(time), 0.02 * np.cos(time), 0.3 * np.sin(0.5 * time)])
    imu = ImuSamples(stamp, stamp, force, rate)
    at = stamp[RATE // 2::RATE // 2]
    m = len(at)
    covariance = np.tile(np.diag([2.0, 1.5, 4.0]), (m, 1, 1))
    covariance[:, 0, 1] = covariance[:, 1, 0] = 0.5
    fixes = Fixes(at, at, LATITUDE + 1e-6 * rng.standard_normal(m), LONGITUDE + 1e-6 * rng.standard_normal(m),
                  HEIGHT + rng.standard_normal(m), covariance, status=np.zeros(m, np.int8),
                  covariance_type=np.full(m, 2, np.uint8))
    velocity = Velocities(at, at, rng.standard_normal((m, 3)), np.tile(np.eye(3), (m, 1, 1)))
    return imu, fixes, replay.Aiding(velocity=velocity)


START = Start(0.0, LATITUDE, LONGITUDE, HEIGHT, np.array([3.0, -1.0]), 0.7, np.diag([4.0, 4.0, 1.0, 1.0, 0.01]), None)


def _dense(config, imu, events):
    """States and covariances smoothed as Rauch, Tung and Striebel do, at each sample: (k, n), (k, n, n).

    The transition is what the kernel does to the estimate in open loop, covariances are inverted.
    """
    n, samples = config.layout.n, np.column_stack([imu.stamp * 1e-9, imu.specific_force, imu.angular_rate])[1:]
    memory = config.memory()
    initialize(memory, config, START)
    x, p, prior_x, prior_p, transitions = [], [], [], [], []

    def of(memory):
        row = newest(memory)
        return row[NAV:NAV + n].copy(), covariance(row, config.layout)

    for sample in samples:
        now, plain = of(memory), memory.copy()
        x.append(now[0])
        p.append(now[1])
        columns = []
        for i in range(n):
            moved = memory.copy()
            newest_row(moved)[NAV:NAV + n] = np.eye(n)[i]
            take_all(moved, sample[None], events[:0], [0])
            columns.append(of(moved)[0])
        transitions.append(np.column_stack(columns))
        take_all(plain, sample[None], events[:0], [0])
        prior = of(plain)
        prior_x.append(prior[0])
        prior_p.append(prior[1])
        mine = events[np.abs(events[:, Event.TIME] - sample[0]) < 1e-6]
        mine[:, Event.TIME] = sample[0]
        take_all(memory, sample[None], mine, [0])
    now = of(memory)
    x, p = [*x, now[0]], [*p, now[1]]
    for k in range(len(samples) - 1, -1, -1):
        gain = p[k] @ transitions[k].T @ np.linalg.inv(prior_p[k])
        x[k] = x[k] + gain @ (x[k + 1] - prior_x[k])
        p[k] = p[k] + gain @ (p[k + 1] - prior_p[k]) @ gain.T
    return np.array(x[1:]), np.array(p[1:])


@pytest.mark.parametrize('values', [
    {}, {'sensor_error_model': 'autoregressive'}, {'mechanization': 'strapdown'},
    {'mechanization': 'strapdown', 'gnss.coloured_noise.sigma': 1.0, 'gnss.time_offset_sigma': 0.1,
     'gnss.robust_sigma': 1.0}], ids=['planar', 'AR', 'strapdown', 'optional states, weighted fixes'])
def test_equals_a_dense_smoother(values):
    # given a filter in open loop, in which the estimate is linear
    config = configure(values, feedback='open', velocity_topic='/velocity')
    imu, fixes, aiding = _drive()
    keep = np.zeros(len(imu), dtype=bool)
    keep[::7] = True
    # when it is smoothed with every seventh state kept
    run = smoothing._Smoothing(config, imu, fixes, aiding, START, keep).run()
    # then it is what a dense smoother says that looks at every sample
    events = run.measured.event.copy()
    events[:, Event.VERDICT] = Verdict.PENDING
    x, p = _dense(config, imu, events)
    at = run.index - 1
    n = config.layout.n
    np.testing.assert_allclose(run.sigma, np.sqrt(p[at][:, np.arange(n), np.arange(n)]), rtol=1e-5)
    np.testing.assert_allclose(run.covariance_ne, p[at, 0, 1], rtol=1e-4, atol=1e-6)
    first = config.layout.n_navigation
    np.testing.assert_allclose(run.sensor_errors, x[at][:, first:first + config.layout.n_sensor:config.layout.order],
                               rtol=1e-5, atol=1e-8)
    filtered = replay.Replay(config, imu, fixes, aiding, START, keep).run()
    assert np.mean(run.sigma[:, 0] < 0.9 * filtered.sigma[:, 0]) > 0.5


SEEDS = 20
#: a car as the filter thinks of it, at its defaults
CAR = {name: table.defaults()[name] for name in (
    'vehicle.zero_velocity', 'vehicle.non_holonomic', 'gnss.gate_probability', 'gnss.adapt_sigma', 'gnss.robust_sigma',
    'vehicle.non_holonomic_sigma', 'vehicle.non_holonomic_vertical_sigma', 'imu.mounting_sigma',
    'vehicle.rear_axle_sigma')}


def simulated(seed, config, latency=0.0, duration=150.0):
    drive = simulate_drive(duration, seed, 20.0, hills=config.mechanization == STRAPDOWN,
                           rotating_earth=config.mechanization == STRAPDOWN)
    sensors = SensorErrors.from_parameters(config.parameters, 'gauss_markov')
    return simulate_recording(drive, sensors, GnssNoise(1.5, latency=latency), seed=seed).recording


def errors_of(run, recording):
    truth = Truth(recording.reference, np.zeros(3), np.zeros(len(recording.reference)), 'reference')
    inside = (recording.reference.stamp >= run.stamp[0]) & (recording.reference.stamp <= run.stamp[-1])
    return position_errors(run, truth.select(inside), np.zeros(inside.sum(), dtype=bool))


@pytest.mark.parametrize('values', [{}, {'mechanization': 'strapdown'}, {'mechanization': 'strapdown', **CAR}],
                         ids=['planar', 'strapdown', 'car'])
def test_is_better_than_the_filter_and_knows_how_good_it_is(values):
    config = configure(values)
    filtered, smooth = [], []
    for seed in range(SEEDS):
        recording = simulated(seed, config)
        filtered.append(errors_of(replay.run(config, recording.imu, recording.gnss), recording))
        smooth.append(errors_of(smoothing.smoothed(config, recording.imu, recording.gnss), recording))
    before, after = (np.concatenate([e.horizontal for e in errors]) for errors in (filtered, smooth))
    nees = np.concatenate([e.nees for e in smooth])
    assert rms(after) < 0.7 * rms(before)
    # errors of one drive go together: some tens of independent ones
    assert 0.9 < np.mean(nees < NEES_95) < 0.985
    assert np.mean([rms(e.sigma) for e in smooth]) < 0.7 * np.mean([rms(e.sigma) for e in filtered])


@pytest.mark.parametrize('values', [{}, {'mechanization': 'strapdown', **CAR}], ids=['planar', 'car'])
def test_an_outage_is_the_smoothed_run_without_its_fixes(values):
    config = configure(values)
    recording = simulated(3, config, duration=200.0)
    imu, gnss = recording.imu, recording.gnss
    begin, duration = gnss.stamp[[60, 90]], 30.0
    keep = np.zeros(len(imu), dtype=bool)
    keep[::4] = True
    outages = smoothing.smoothed_outages(config, imu, gnss, begin, duration, keep=keep)
    assert outages.begin.tolist() == begin.tolist()
    for i, b in enumerate(begin):
        # given the recording up to a minute after the outage, without its fixes
        end = b + round((duration + smoothing.AFTER) * 1e9)
        left = gnss.select(((gnss.stamp <= b) | (gnss.stamp > b + round(duration * 1e9))) & (gnss.stamp < end))
        until = imu.stamp < end
        whole = smoothing.smoothed(config, imu.select(until), left, keep=keep[until])
        part = outages.run.states(slice(outages.first[i], outages.first[i + 1]))
        at = np.searchsorted(whole.stamp, part.stamp)
        assert len(at) > 100
        np.testing.assert_allclose(part.sigma, whole.sigma[at], rtol=1e-6)
        np.testing.assert_allclose(part.latitude, whole.latitude[at], rtol=0, atol=1e-12)
        np.testing.assert_allclose(part.velocity, whole.velocity[at], rtol=0, atol=1e-5)
        # then the error stays a small part of the filter's
        coasting = replay.run_with_outages(config, imu, gnss, begin[i:i + 1], duration, keep=keep)[1].run
        inside = recording.reference
        inside = inside.select((inside.stamp > b) & (inside.stamp < part.stamp[-1]))
        worst = [position_errors(run, Truth(inside, np.zeros(3), np.zeros(len(inside)), ''),
                                 np.zeros(len(inside), dtype=bool)).horizontal.max() for run in (part, coasting)]
        assert worst[0] < 0.5 * worst[1]


def test_late_fixes_are_used_at_their_own_time():
    config = configure({'mechanization': 'strapdown'})
    prompt, late = (simulated(5, config, latency) for latency in (0.0, 0.4))
    whole, after = (smoothing.smoothed(config, r.imu, r.gnss) for r in (prompt, late))
    # the filter starts later, and the last fix does not come any more
    both = slice(np.searchsorted(whole.stamp, after.stamp[0]) + 400, -400)
    at = np.searchsorted(after.stamp, whole.stamp[both])
    np.testing.assert_allclose(after.velocity[at], whole.velocity[both], atol=0.02)
    np.testing.assert_allclose(after.sigma[at][:, :6], whole.sigma[both][:, :6], rtol=0.02)


def test_stretches_between_restarts_are_smoothed_apart():
    config = configure({})
    recording = simulated(2, config, duration=240.0)
    gap = (recording.imu.stamp > recording.imu.stamp[0] + 110 * 10**9) & (
        recording.imu.stamp < recording.imu.stamp[0] + 130 * 10**9)
    run = smoothing.smoothed(config, recording.imu.select(~gap), recording.gnss)
    assert np.count_nonzero(np.diff(run.stamp) > 15e9) == 1
    errors = errors_of(run, recording)
    assert np.median(errors.horizontal) < 1.5 and np.isfinite(run.sigma).all()
