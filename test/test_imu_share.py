"""Which of two IMUs that differ is right: judged by drives that are known, and by the formula of the covariance."""
from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import position_errors
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements import acceleration, speed, standstill, twist
from mems_ins_fusion.filter.measurements.geometry import body_to_level
from mems_ins_fusion.filter.memory import (
    NAV,
    Event,
    Head,
    Sample,
    covariance,
    sample_at,
    set_covariance,
    state_at,
    views,
)
from mems_ins_fusion.filter.runs.imus import as_one
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.start.initial import initialize
from mems_ins_fusion.filter.start.start import Start
from mems_ins_fusion.filter.trust import imu_share
from mems_ins_fusion.filter.trust.imu_share import Difference
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

SECOND = {'inputs': ['second'], 'second.type': 'imu', 'second.topic': '/second', 'reference_lever_arm': [0.0, 0.0, 0.0]}
VALUES = table.check(SECOND)
BEGIN = 100.0  # s, of the fault
BEGIN_STAMP = 1_700_000_000 * 10**9


@cache
def drive():
    """A drive with two IMUs, each with noise of its own."""
    made = simulate_drive(duration=200.0, seed=5)
    sensors = SensorErrors.from_parameters(table.check(REALISTIC.imu), 'gauss_markov')
    first = simulate_recording(made, sensors, GnssNoise(1.5), seed=5).recording
    other = simulate_recording(made, sensors, seed=6).recording.imu
    return replace(first, others={'second': other})


def with_fault(which, change):
    imu = drive().streams()[which]
    late = ((imu.stamp - imu.stamp[0]) * 1e-9 > BEGIN)[:, None]
    return drive().having({which: replace(imu, angular_rate=np.where(late, change(imu.angular_rate),
                                                                     imu.angular_rate))})


def largest_error(recording, values=VALUES):
    """m, from the begin of the fault on; and the share of them within the 95 % ellipse, and the last share."""
    merged, _ = as_one(recording, values)
    config = FilterConfig.from_parameters(values)
    found = run(config, merged.imu, merged.gnss)
    truth = truth_of(drive(), values)
    errors = position_errors(found, truth, np.zeros(len(truth), bool))
    late = (errors.stamp - drive().imu.stamp[0]) * 1e-9 > BEGIN
    names = [extra.name for extra in config.extras]
    share = found.extras[-1, names.index('imu_share')] if 'imu_share' in names else 0.0
    return errors.horizontal[late].max(), (errors.nees[late] < 5.99).mean(), share


FAULTS = {'5 deg/s off': lambda w: w + np.radians([0.0, 0.0, 5.0]),
          'turns the other way': lambda w: w * [1.0, 1.0, -1.0]}


@pytest.mark.parametrize('fault', FAULTS)
def test_either_of_two_may_fail_and_it_costs_the_same(fault):
    # given the same fault of the first and of the second IMU, and what one IMU alone makes of the drive
    alone, usual, _ = largest_error(replace(drive(), others={}), table.check({'reference_lever_arm': [0.0, 0.0, 0.0]}))
    of_first, inside, first_share = largest_error(with_fault('imu', FAULTS[fault]))
    of_second, inside_second, second_share = largest_error(with_fault('second', FAULTS[fault]))
    # then the filter finds out which one is right, and is as good as with that one
    assert first_share == pytest.approx(-0.5, abs=0.01) and second_share == pytest.approx(0.5, abs=0.01)
    assert max(of_first, of_second) < 1.3 * alone + 0.5
    assert of_first == pytest.approx(of_second, rel=0.2, abs=0.3)
    assert min(inside, inside_second) > usual - 0.03


def test_both_are_averaged_and_no_share_is_estimated_where_they_agree():
    _, inside, share = largest_error(drive())
    assert share == 0.0 and inside > 0.9


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_the_covariance_is_that_of_a_state_that_multiplies_the_difference(mechanization):
    # given any covariance, and errors that the difference has caused per unit of the share
    config = FilterConfig.from_parameters({**VALUES, 'mechanization': mechanization})
    layout, memory, rng = config.layout, config.memory(), np.random.default_rng(1)
    root = rng.standard_normal((layout.n, layout.n))
    before, moved = root @ root.T, rng.standard_normal(layout.n_navigation)
    row = views(memory)[2][0]
    set_covariance(row, layout, before)
    sample = int(sample_at(memory, 0))
    memory[sample + Difference.GIVEN] = 1.0
    # when they are added
    imu_share.add_error(memory, int(state_at(memory, 0)), sample, tuple(moved.tolist()))
    # then the covariance is M P M^T, M: the identity with these errors in the column of the share
    change = np.eye(layout.n)
    change[:layout.n_navigation, layout.index('imu_share')] = moved
    np.testing.assert_allclose(covariance(row, layout), change @ before @ change.T, rtol=1e-9, atol=1e-9)


def observed(what, config, share, taken, difference):
    """Innovation of a measurement, and the column of the share in H, of samples of which `taken` of the `difference`
    has been subtracted, at the estimate `share`."""
    n, state = config.layout.n, config.layout.index('imu_share')
    memory = config.memory()
    initialize(memory, config, Start(0.0, 0.9, 0.1, 0.0, np.array([6.0, 2.0]), 0.4, np.eye(5), None))
    r, sample, h = state_at(memory, 0), sample_at(memory, 0), int(memory[Head.SCRATCH_AT]) + n * n
    at = h + 6 * n
    memory[h:at + Event.SIZE] = 0.0
    memory[at + Event.VALUE:at + Event.VALUE + 3] = 6.0, np.nan, 0.2
    memory[at + Event.ARM + 1] = 1.5 if what == 'speed' else 0.0
    memory[at + Event.STATE], memory[at + Event.INPUT] = config.layout.index(f'{what}_scale'), 1.0
    memory[r + NAV + config.layout.n_navigation:r + NAV + n] = np.linspace(0.02, 0.05, n - config.layout.n_navigation)
    memory[r + NAV + state] = share
    if what == 'speed':
        memory[r + NAV + config.layout.index('speed_scale')] = 0.0  # its product with other errors is left out of H
    values = np.array([0.3, 0.4, -9.7, 0.02, -0.01, 0.15]) - taken * difference
    memory[sample + Sample.F_X:sample + Sample.F_X + 6], memory[sample + Sample.INTERVAL] = values, 0.01
    memory[sample + Difference.VALUE:sample + Difference.VALUE + 6] = difference
    memory[sample + Difference.TAKEN] = taken
    c = body_to_level(memory, r)
    if what == 'acceleration':
        count = acceleration.observe(memory, at, h, n, c, sample, 1.0)
    elif what == 'standstill':
        count = standstill.observe_rate(memory, at, h, n, sample)
    else:
        count = {'twist': twist, 'speed': speed}[what].observe(memory, r, at, h, n, c, sample)
    rows = memory[h:h + count * n].reshape(count, n)
    z = memory[[at + Event.Z_N, at + Event.Z_E, at + Event.Z_D][:count]]
    return z - rows @ memory[r + NAV:r + NAV + n], rows[:, state]


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
@pytest.mark.parametrize('what', ['twist', 'speed', 'acceleration', 'standstill'])
def test_what_measures_an_error_of_the_sensors_measures_the_share(what, mechanization):
    # given a measurement in whose H the errors of sensors are, and two IMUs that differ in all axes
    config = FilterConfig.from_parameters({**VALUES, 'mechanization': mechanization, 'twist_topic': '/twist',
                                           'speed_topic': '/speed'})
    difference = np.array([0.3, -0.2, 0.0, 0.04, 0.03, 0.09])
    innovation, column = observed(what, config, 0.2, 0.1, difference)
    # then the innovation is that of samples of which all that the estimate says has been subtracted
    np.testing.assert_allclose(innovation, observed(what, config, 0.2, 0.2, difference)[0], atol=1e-12)
    # and the column is what another estimate changes in it
    other = observed(what, config, 1.2, 0.1, difference)[0]
    np.testing.assert_allclose(column, innovation - other, atol=1e-12)
    assert np.abs(column).max() > 0.01


def test_an_odometry_without_fixes_shows_which_gyroscope_is_right():
    # given an odometry with a turn rate, whose scale the fixes have shown, and no fix from shortly before the fault on
    odometry = simulate_recording(simulate_drive(duration=200.0, seed=5), seed=5,
                                  aiding=SimulatedAiding(twist_rate=20.0)).recording.streams()['twist']
    values = table.check({**SECOND, 'twist_topic': '/odometry'})
    for which, right in (('imu', -0.5), ('second', 0.5)):
        merged, _ = as_one(with_fault(which, FAULTS['5 deg/s off']), values)
        late = (merged.gnss.stamp - drive().imu.stamp[0]) * 1e-9 > BEGIN - 1.0
        until = (merged.imu.stamp - drive().imu.stamp[0]) * 1e-9 < BEGIN + 0.5
        config = FilterConfig.from_parameters(values)
        found = run(config, merged.imu.select(until), merged.gnss.select(~late), Aiding(twist=odometry))
        # then it is decided within half a second (without the odometry it takes longer)
        share = found.extras[-1, [extra.name for extra in config.extras].index('imu_share')]
        assert share == pytest.approx(right, abs=0.01)


def differing_from_the_start():
    """Samples of two IMUs whose gyroscopes differ from the first sample on."""
    merged, _ = as_one(drive(), VALUES)
    d = np.tile([0.1, 0.05, 0.0, 0.001, -0.002, 0.02], (len(merged.imu), 1))
    return replace(merged.imu, difference=d), merged.gnss


def test_live_and_replay_give_the_same_bits_where_two_differ_before_the_start():
    # given two IMUs that differ from the first sample on, and fixes that come late, so that the filter takes samples
    # since the fix of its start once more; when they are replayed and run live
    imu, fixes = differing_from_the_start()
    fixes = replace(fixes, received=fixes.stamp + 400_000_000)
    config = FilterConfig.from_parameters(VALUES)
    replayed = run(config, imu, fixes)
    live, before = FusionFilter(config), np.searchsorted(imu.received, fixes.received, side='right')
    for k in range(len(imu)):
        for i in np.flatnonzero(before == k):
            live.add_fix(int(fixes.stamp[i]), float(fixes.latitude[i]), float(fixes.longitude[i]),
                         float(fixes.height[i]), fixes.covariance[i].ravel(), int(fixes.status[i]),
                         int(fixes.covariance_type[i]))
        live.add_imu(int(imu.stamp[k]), *imu.specific_force[k].tolist(), *imu.angular_rate[k].tolist(),
                     difference=tuple(imu.difference[k].tolist()))
    # then the states are the same
    newest = [views(memory)[2][(state_at(memory, int(memory[Head.SAMPLES])) - int(memory[Head.ROWS_AT]))
                               // int(memory[Head.WIDTH])] for memory in (live._memory, replayed.memory)]
    np.testing.assert_array_equal(*newest)


def test_a_difference_is_of_its_own_sample_only():
    # given a live filter; when a sample with a difference is followed by one without
    live = FusionFilter(FilterConfig.from_parameters(VALUES))
    for k, difference in enumerate(((1.0,) * 6, ())):
        live.add_imu(BEGIN_STAMP + k * 10**7, 0.0, 0.0, -9.8, 0.0, 0.0, 0.0, difference=difference)
    # then that has none
    np.testing.assert_array_equal(live._sample[0, 7:], np.zeros(6))


def test_a_filter_of_one_imu_takes_no_difference():
    # given the samples of two IMUs that differ, and a filter that knows of one only
    imu, fixes = differing_from_the_start()
    config = FilterConfig.from_parameters(table.check({'feedback': 'open'}))  # in which errors of the state are kept
    # then it does what it does without the difference
    with_difference, without = run(config, imu, fixes), run(config, replace(imu, difference=None), fixes)
    np.testing.assert_array_equal(with_difference.latitude, without.latitude)


@pytest.mark.parametrize('variance, share, value', [
    (0.25, 0.4, 0.0),      # nothing known
    (1e-3, 0.48, 0.5),     # one of both is excluded
    (1e-3, -0.48, -0.5),
    (1e-3, 0.3, 0.0),      # too far from both
    (0.03, 0.25, 0.0),     # 8 nats, too few
    (0.027, 0.25, 0.5),    # 9.3 nats
    (1e-7, 0.5, 0.0)])     # decided already
def test_it_is_decided_where_the_other_value_is_excluded(variance, share, value):
    config = FilterConfig.from_parameters(VALUES)
    memory, s = config.memory(), config.layout.index('imu_share')
    full = np.eye(config.layout.n)
    full[s, s] = variance
    row = views(memory)[2][0]
    set_covariance(row, config.layout, full)
    row[NAV + s] = share
    assert imu_share.decided(memory, int(state_at(memory, 0))) == value


def test_it_begins_at_both_where_they_begin_to_differ_and_ends_where_they_agree_again():
    # given a state that has a share, correlated with all others
    config = FilterConfig.from_parameters(VALUES)
    memory, layout, s = config.memory(), config.layout, config.layout.index('imu_share')
    root = np.random.default_rng(2).standard_normal((layout.n, layout.n))
    row, before, sample = views(memory)[2][0], root @ root.T, int(sample_at(memory, 0))
    for given, begins in ((0.0, 0.0), (1.0, 0.25)):
        # when the difference ends, and then begins again
        set_covariance(row, layout, before if not given else covariance(row, layout))
        row[NAV + s], memory[sample + Difference.GIVEN] = 0.4 * (1.0 - given), given
        imu_share.add_error(memory, int(state_at(memory, 0)), sample, (1.0,) * layout.n_navigation)
        # then it is no longer known, and nothing else has changed
        expected = before.copy()
        expected[s] = expected[:, s] = 0.0
        expected[s, s] = begins
        np.testing.assert_allclose(covariance(row, layout), expected, rtol=1e-12)
        assert row[NAV + s] == 0.0
