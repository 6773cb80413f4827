"""Whatever comes, in whatever order: the live filter's state is finite, its covariance one, its stamps go on."""
from __future__ import annotations

import math

import numpy as np
from filter_support import configure
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from mems_ins_fusion.filter.memory import Head, covariance, state_at
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.odometry import POSE_COVARIANCE, TWIST_COVARIANCE
from mems_ins_fusion.parameters import table

SECOND, BEGIN = 10**9, 1_700_000_000 * 10**9
HERE = (math.radians(48.0), math.radians(11.0), 500.0)
DEFAULTS = table.check({'speed_topic': '/speed', 'velocity_topic': '/velocity', 'heading_topic': '/heading'})

#: any double, and those that a sensor delivers
anything = st.floats(width=64) | st.floats(-20.0, 20.0) | st.sampled_from([0.0, -0.0, 1e300, -1e300, 5e-324, 1e5])
usual = st.floats(-3.0, 3.0)
#: ns since the newest sample: as they come, late, ahead, twice, from another clock
step = st.sampled_from([10_000_000] * 6 + [0, -10_000_000, 400_000_000, 3 * SECOND, 40 * SECOND, -3600 * SECOND, 2**61])


def several(value, count):
    return st.lists(value, min_size=count, max_size=count)


driving = st.tuples(st.just('drive'), st.integers(1, 80), several(usual, 2), usual)
sample = st.tuples(st.just('imu'), step, several(anything, 6))
fix = st.tuples(st.just('fix'), step, several(anything, 2), anything, several(anything, 9), st.integers(-2, 3),
                st.integers(0, 255))
near = st.tuples(st.just('near'), several(usual, 2), st.floats(0.01, 50.0))
speed = st.tuples(st.just('speed'), step, anything, anything)
velocity = st.tuples(st.just('velocity'), step, several(anything, 3), several(anything, 9))
heading = st.tuples(st.just('heading'), step, anything, anything)
start = st.tuples(st.just('start'), several(usual, 3), st.floats(1e-3, 10.0))
switch = st.tuples(st.just('switch'), st.booleans())
temperature = st.tuples(st.just('temperature'), anything)
reset = st.tuples(st.just('reset'))
#: what is usual is drawn more often, so that there is a state to spoil
events = st.lists(st.one_of(driving, driving, near, near, near, sample, fix, speed, velocity, heading, start, switch,
                            temperature, reset), min_size=5, max_size=60)


class Fed:
    """A live filter, how far its clock is, and what must hold after each event."""

    def __init__(self, values):
        self.fusion = FusionFilter(configure({**DEFAULTS, **values}))
        self.now, self.published = BEGIN, -1
        self._stood()

    def _stood(self):
        """Ten seconds at rest with fixes, and a start: most drives begin so."""
        for _ in range(4):
            self.drive(50, (0.0, 0.0), 0.0)
            self.near((0.0, 0.0), 1.0)
        self.start((0.0, 0.0, 0.5), 1.0)

    def drive(self, count, force, rate):
        for k in range(count):
            self.imu(20_000_000, [force[0] + 1e-3 * (k % 7), force[1], 9.81 + 1e-3 * (k % 5), 0.0, 0.0, 0.1 * rate])

    def imu(self, dt, values):
        stamp = self.now + dt
        if self.fusion.add_imu(stamp, *values):
            self.now = self.fusion.update_odometry()
            assert self.now == stamp > self.published
            self.published = stamp
            self.holds()
        else:
            self.now = self.fusion._now
            self.published = -1 if self.fusion._estimating is None else self.published

    def near(self, away, sigma):
        self.fusion.add_fix(self.now, HERE[0] + away[0] * 1e-7, HERE[1] + away[1] * 1e-7, HERE[2],
                            (sigma**2 * np.eye(3)).ravel())

    def fix(self, dt, place, height, variance, status, kind):
        self.fusion.add_fix(self.now + dt, *place, height, variance, status, kind)

    def speed(self, dt, value, variance):
        self.fusion.add('speed', self.now + dt, value, variance)

    def velocity(self, dt, value, variance):
        self.fusion.add('velocity', self.now + dt, value, np.reshape(variance, (3, 3)))

    def heading(self, dt, value, variance):
        self.fusion.add('heading', self.now + dt, value, variance)

    def start(self, pose, sigma):
        self.fusion.set_start(HERE[0] + pose[0] * 1e-7, HERE[1] + pose[1] * 1e-7, HERE[2], pose[2],
                              np.diag([sigma**2, sigma**2, sigma**2, 0.01]))
        self.published = -1  # a new start, as after a reset

    def switch(self, use):
        self.fusion.use_fixes(use)

    def temperature(self, celsius):
        self.fusion.add_temperature(self.now, celsius)

    def reset(self):
        self.fusion.reset()
        self.published = -1

    def holds(self):
        fusion = self.fusion
        assert np.isfinite(fusion.odometry).all() and np.isfinite(fusion.geodetic).all()
        for at in (POSE_COVARIANCE, TWIST_COVARIANCE):
            assert_covariance(fusion.odometry[at:at + 36].reshape(6, 6))
        memory = fusion._estimating
        row = memory[state_at(memory, int(memory[Head.SAMPLES])):][:int(memory[Head.WIDTH])]
        assert np.isfinite(row).all()
        assert_covariance(covariance(row, fusion.config.layout))
        assert abs(np.linalg.norm(fusion.odometry[3:7]) - 1.0) < 1e-6


def assert_covariance(p):
    """Symmetric, variances not below zero, and no direction in which it is negative beyond rounding."""
    assert np.diag(p).min() >= 0.0
    scale = np.sqrt(np.maximum(np.diag(p), 1e-300))
    correlation = p / np.outer(scale, scale)
    assert np.abs(correlation - correlation.T).max() < 1e-6
    assert np.linalg.eigvalsh(correlation).min() > -1e-6


@settings(derandomize=True, max_examples=60, deadline=None, database=None,
          phases=[Phase.explicit, Phase.generate],
          suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(events, st.sampled_from([{}, {'mechanization': 'planar'}, {'sensor_error_model': 'random_walk'}]))
def test_nothing_that_comes_makes_the_filter_raise_or_lose_itself(drawn, values):
    fed = Fed(values)
    for name, *arguments in drawn:
        getattr(fed, name)(*arguments)
    fed.drive(20, (0.0, 0.0), 0.0)
    fusion = fed.fusion
    assert isinstance(fusion.health(), dict) and fusion.state and fusion.status
    for judged in fusion.verdicts():
        assert math.isfinite(judged.nis) and 0.0 <= judged.weight <= 1.0
    assert all('\n' not in notice.text for notice in fusion.notices())
    snapshot = fusion.snapshot()
    assert snapshot is None or math.isfinite(snapshot['yaw'])
