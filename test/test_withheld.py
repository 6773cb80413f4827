"""How far positions without fixes really are off, by copies of the filter: against outages of a replay, for sensors
that are better and worse than the parameters say, and where a copy says nothing."""
from __future__ import annotations

import numpy as np
import pytest
from filter_support import configure, fix_event, started, take_event, take_sample
from live_support import fed

from mems_ins_fusion.filter.bank import _copy
from mems_ins_fusion.filter.memory import Head, Sample, sample_at
from mems_ins_fusion.filter.runs.coarse import follow
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.newest import NewestState
from mems_ins_fusion.filter.runs.replay import run_with_outages
from mems_ins_fusion.filter.runs.withheld import AGES, COPIES_AT_ONCE, PERIOD, PERIODS_APART, WEIGHT, Withheld
from mems_ins_fusion.filter.trust.scale import PRIOR, Scale, learn_changes
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_drive,
    simulate_recording,
)

#: what the parameters say, where nothing else is given
NOISE = {'accelerometer.noise_density': 1e-3, 'gyroscope.noise_density': 1e-4, 'accelerometer.random_walk.q': 1e-5,
         'gyroscope.random_walk.q': 1e-6, 'sensor_error_model': 'random_walk', 'imu.adapt_noise': False,
         'vehicle.learn_drift': False, 'vehicle.zero_velocity': True}
SECOND = 10**9


def drive(seconds: float = 400.0, worse: float = 1.0, seed: int = 5, standstill: float = 6.0, **more):
    """At 25 Hz, with sensors whose white noise is `worse` times that of NOISE; fixes each second."""
    sensors = SensorErrors(accelerometer_noise_density=[worse * 1e-3] * 3, gyroscope_noise_density=[worse * 1e-4] * 3)
    return simulate_recording(simulate_drive(seconds, seed=seed, rate=25.0, standstill=standstill), sensors,
                              GnssNoise(0.02), seed=seed, **more).recording


def realised(recording, fixes_until: float = np.inf, **values) -> float:
    fusion = FusionFilter(configure({**NOISE, **values}))
    for i in fed(fusion, recording):
        fusion.use_fixes((recording.imu.stamp[i] - recording.imu.stamp[0]) * 1e-9 < fixes_until)
    return fusion._withheld.realised


def test_it_is_what_outages_of_a_replay_show():
    # given outages that begin where a live filter has its copies, and the same filter with all fixes
    recording, config = drive(170.0), configure(NOISE)
    imu = recording.imu
    slots = np.arange(PERIOD, 150.0, PERIOD)
    first = np.searchsorted((imu.stamp - imu.stamp[0]) * 1e-9, slots)
    begin = imu.stamp[first - 1]
    whole, outages = run_with_outages(config, imu, recording.gnss, begin, PERIOD + 1.0)
    expected = np.zeros(Scale.CHANGING_SIZE)
    for slot, at, rows in zip(slots, first, (slice(*pair) for pair in zip(outages.first, outages.first[1:]))):
        copy = outages.run.states(rows)
        for age in AGES:
            # when the difference of both is compared with the difference of their covariances, at the last sample
            # before the time that is due
            last = imu.stamp[np.searchsorted((imu.stamp - imu.stamp[0]) * 1e-9, slot + age) - 1]
            a, b = (one.states(np.flatnonzero(one.stamp == last)) for one in (copy, whole))
            if not len(a.stamp):
                continue
            meridian, prime = radii(b.latitude[0])
            off = np.array([(a.latitude - b.latitude)[0] * meridian,
                            (a.longitude - b.longitude)[0] * prime * np.cos(b.latitude[0])])
            difference = np.diag(a.sigma[0, :2]**2 - b.sigma[0, :2]**2) + (
                a.covariance_ne - b.covariance_ne)[0] * (np.ones((2, 2)) - np.eye(2))
            squared = off @ np.linalg.solve(difference, off) / 2.0
            learn_changes(expected, 0, float((last - imu.stamp[0]) * 1e-9), squared, 1.0, 0.0, 2, WEIGHT)
    # then a live filter has learned the same
    same = Withheld(config)
    same._scale[:] = expected
    assert realised(recording) == pytest.approx(same.realised, rel=0.02)
    assert abs(np.log(same.realised)) > 0.02


@pytest.mark.parametrize('unknown', [0.04, 0.1, 0.3])
def test_a_variance_below_the_expected_one_counts_as_its_tail_of_5_percent_asks(unknown):
    # given that the logarithm of realised over expected variance is -1 but for a normal error of variance `unknown`
    learned = Withheld(configure(NOISE))
    learned._scale[[Scale.LOG, Scale.REDUCED]] = -1.0, PRIOR - unknown
    rng = np.random.default_rng(3)
    true = np.exp(-1.0 + np.sqrt(unknown) * rng.standard_normal(400_000))
    errors = np.sqrt(true)[:, None] * rng.standard_normal((len(true), 2))
    # then 5 % of the errors are beyond what 5 % of a normal distribution of the variance that is used are beyond, in a
    # plane, and no more along a line
    beyond = np.mean(np.hypot(*errors.T) > np.sqrt(-2.0 * np.log(0.05) * learned.realised))
    assert beyond == pytest.approx(0.05, abs=0.004)
    assert 0.03 < np.mean(np.abs(errors[:, 0]) > 1.96 * np.sqrt(learned.realised)) < 0.051


def test_as_expected_before_it_is_known_to_be_less_and_as_seen_where_it_is_more():
    learned = Withheld(configure(NOISE))
    assert learned.realised == 1.0
    learned._scale[[Scale.LOG, Scale.REDUCED]] = -0.1, PRIOR - 0.3
    assert learned.realised == 1.0
    learned._scale[Scale.LOG] = 0.5
    assert learned.realised == pytest.approx(np.exp(0.5))


@pytest.mark.parametrize('worse, least, most', [(0.25, 0.05, 0.8), (3.0, 2.0, 20.0)])
def test_sensors_that_are_better_or_worse_than_assumed(worse, least, most):
    assert least < realised(drive(PERIOD * (COPIES_AT_ONCE + 6 * PERIODS_APART) + 5.0, worse)) < most  # twelve copies


def test_what_says_nothing_of_errors_while_driving():
    # given a vehicle that stands without being held at rest, and a filter whose fixes end before the first copy
    standing, driving = drive(200.0, 3.0, standstill=300.0), drive(200.0, 3.0)
    assert realised(standing, **{'vehicle.zero_velocity': False, 'alignment.heading': 'parameter'}) == 1.0
    assert realised(driving, fixes_until=PERIOD - 1.0) == 1.0


def test_copies_follow_each_other_at_first_and_are_rare_later(monkeypatch):
    begun, copy = [], Withheld._copy

    def noted(self, time, memory):
        begun.append(time)
        copy(self, time, memory)
    monkeypatch.setattr(Withheld, '_copy', noted)
    realised(drive(PERIOD * (COPIES_AT_ONCE + 2 * PERIODS_APART) + 5.0))
    late = COPIES_AT_ONCE + PERIODS_APART * np.arange(1, 3)
    assert begun == pytest.approx(PERIOD * np.array([*range(1, COPIES_AT_ONCE + 1), *late]), abs=0.05)


def test_an_outage_withholds_what_is_from_satellites():
    # given inputs of both kinds, one of them without a topic, and a second receiver
    config = configure({'velocity_topic': '/velocity', 'speed_topic': '/speed', 'pressure_topic': '/pressure',
                        'mechanization': 'strapdown', 'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': '/rear'})
    withheld = {one.name: config.from_satellites[int(config.of_input(number)[0])]
                for number, one in config.inputs.items() if config.settings_of(number).topic}
    # then receivers and the velocity that one measures are withheld, and not wheels nor air
    assert withheld == {'fix': 1.0, 'rear': 1.0, 'velocity': 1.0, 'speed': 0.0, 'pressure': 0.0}


def test_a_memory_of_few_samples_is_followed_in_time():
    # given a filter that keeps ten seconds of samples, a third of what a copy takes
    recording = drive(170.0, 3.0)
    short, long = realised(recording, **{'gnss.max_delay': 0.1}), realised(recording)
    # then its copies miss none
    assert long > 1.5 and short == pytest.approx(long, rel=0.01)


@pytest.mark.parametrize('missing', [0.0, 30.0])
def test_a_copy_that_is_due_at_the_first_sample_is_followed(missing):
    # given a filter that has one sample when its first copy is due, and one into whose gap a fix falls
    config, begin = configure(NOISE), 3.0 * PERIOD
    memory, copies = started(config, time=begin - 0.01), Withheld(config)
    copies.begin(begin - 0.01)
    if missing:
        take_event(memory, fix_event(begin + 0.5 * missing))
    # when it is told of the samples, each as often as it asks for
    for k in range(20):
        time, calls = begin + 0.04 * k + missing * (k > 10), 0
        while copies.due <= time:
            copies.before(time, memory)
            calls += 1
            assert calls < 3
        take_sample(memory, time, 0.0, 0.0, 9.81, 0.0, 0.0, 0.0)


def test_a_copy_ends_where_a_filter_takes_over_that_has_not_all_samples():
    # given a copy, and the filter five seconds later
    recording, fusion = drive(80.0), FusionFilter(configure(NOISE))
    begin, small = 60 * 25, NewestState(fusion.config, 4, 2, fusion.config.event_capacity)
    for i in fed(fusion, recording):
        if i == begin:
            small.take(fusion._memory)
            taken = int(fusion._memory[Head.SAMPLES])
        if i == begin + 125:
            break
    # and a second filter that began between both, in a memory that had another one a minute before
    withheld, newest = fusion.config.from_satellites, int(fusion._memory[Head.SAMPLES])
    for began, complete in ((taken, True), (taken + 50, False)):
        second = fusion._memory.copy()
        for k in range(taken, newest + 1):
            second[sample_at(second, k) + Sample.TIME] -= 60.0
        _copy(fusion._memory, second, began)
        # then the copy goes on with the samples of the second where this has all of them, and ends where it has not
        assert follow(small.memory.copy(), second, taken, withheld) == complete


@pytest.mark.parametrize('inputs', [(), ('speed',)])
def test_the_horizon_follows_what_was_realised_and_a_replay_the_live_filter(inputs):
    # given sensors that are three times as noisy as assumed, and wheel speeds, which the copies get, or none
    recording = drive(200.0, 3.0, aiding=SimulatedAiding(speed_rate=10.0))
    config = configure({**NOISE, 'speed_topic': '/wheel/speed' if inputs else ''})
    imu, begin = recording.imu, recording.gnss.stamp[[50, 150]]
    measured = Aiding(speed=recording.speed) if inputs else Aiding()
    _, outages = run_with_outages(config, imu, recording.gnss, begin, 10.0, measured)
    fusion, told = FusionFilter(config), {}
    for i in fed(fusion, recording, *inputs):
        if fusion.aligned:
            told[int(imu.stamp[i])] = fusion.horizon().seconds, fusion._horizon.predict(fusion._memory).seconds
    for b, announced in zip(begin.tolist(), outages.announced.tolist()):
        # then the announcement in a replay is that of the live filter at the last sample before the next fix
        arrived = recording.gnss.received[recording.gnss.stamp > b].min()
        last = int(imu.stamp[np.searchsorted(imu.received, arrived, side='right') - 1])
        assert announced == pytest.approx((last - b) / SECOND + told[last][0], abs=1e-6)
    # and another one than by the covariance alone
    assert abs(told[last][0] / told[last][1] - 1.0) > 0.1
