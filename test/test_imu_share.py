"""Which of two IMUs that differ is right: judged by drives that are known, and by the formula of the covariance."""
from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import position_errors
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Sample, covariance, sample_at, set_covariance, state_at, views
from mems_ins_fusion.filter.runs.imus import as_one
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.trust import imu_share
from mems_ins_fusion.filter.trust.imu_share import Difference
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

SECOND = {'inputs': ['second'], 'second.type': 'imu', 'second.topic': '/second', 'reference_lever_arm': [0.0, 0.0, 0.0]}
VALUES = table.check(SECOND)
BEGIN = 100.0  # s, of the fault


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
    row = views(memory)[2][(state_at(memory, 0) - int(memory[imu_share.Head.ROWS_AT])) // len(views(memory)[2][0])]
    set_covariance(row, layout, before)
    sample = int(sample_at(memory, 0))
    memory[sample + Difference.GIVEN] = 1.0
    # when they are added
    imu_share.add_error(memory, int(state_at(memory, 0)), sample, tuple(moved.tolist()))
    # then the covariance is M P M^T, M: the identity with these errors in the column of the share
    change = np.eye(layout.n)
    change[:layout.n_navigation, layout.index('imu_share')] = moved
    np.testing.assert_allclose(covariance(row, layout), change @ before @ change.T, rtol=1e-9, atol=1e-9)
    assert memory[sample + Sample.FAULT] == 0.0
