"""The smoother: against a dense one of Rauch, Tung and Striebel, against truth, through outages and restarts."""
from __future__ import annotations

import numpy as np
import pytest
from filter_support import HEIGHT, LATITUDE, LONGITUDE, configure, newest, take_all

from mems_ins_fusion.filter import replay, smoothing
from mems_ins_fusion.filter.alignment import Start
from mems_ins_fusion.filter.initial import initialize
from mems_ins_fusion.filter.layout import NAV, Event, Verdict, covariance, set_covariance, views
from mems_ins_fusion.samples import Fixes, ImuSamples, Velocities

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
                  HEIGHT + rng.standard_normal(m), covariance, np.full(m, 2, np.uint8), np.zeros(m, np.int8))
    velocity = Velocities(at, at, rng.standard_normal((m, 3)), np.tile(np.eye(3), (m, 1, 1)))
    return imu, fixes, replay.Aiding(velocity=velocity)


START = Start(0.0, LATITUDE, LONGITUDE, HEIGHT, np.array([3.0, -1.0]), 0.7, np.diag([4.0, 4.0, 1.0, 1.0, 0.01]), None)


def _dense(config, imu, records):
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
            rows = views(moved)[2]
            rows[int(views(moved)[0][9]) % len(rows[:-2]), NAV:NAV + n] = np.eye(n)[i]
            take_all(moved, sample[None], records[:0], [0])
            columns.append(of(moved)[0])
        transitions.append(np.column_stack(columns))
        take_all(plain, sample[None], records[:0], [0])
        prior = of(plain)
        prior_x.append(prior[0])
        prior_p.append(prior[1])
        mine = records[np.abs(records[:, Event.TIME] - sample[0]) < 1e-6]
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
    records = run.measured.record.copy()
    records[:, Event.VERDICT] = Verdict.PENDING
    x, p = _dense(config, imu, records)
    at = run.index - 1
    n = config.layout.n
    np.testing.assert_allclose(run.sigma, np.sqrt(p[at][:, np.arange(n), np.arange(n)]), rtol=1e-5)
    np.testing.assert_allclose(run.covariance_ne, p[at, 0, 1], rtol=1e-4, atol=1e-6)
    first = config.layout.n_navigation
    np.testing.assert_allclose(run.sensor_errors, x[at][:, first:first + config.layout.n_sensor:config.layout.order],
                               rtol=1e-5, atol=1e-8)
    filtered = replay._Replay(config, imu, fixes, aiding, START, keep).run()
    assert np.mean(run.sigma[:, 0] < 0.9 * filtered.sigma[:, 0]) > 0.5
