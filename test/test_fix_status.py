"""Fixes with and without a base in turn: each kind is believed as it scatters, and not as the other one does."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors, rms
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Event, Kind, Verdict
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

CONFIG = FilterConfig.from_parameters(table.check({}))
METRE = 1 / 6.37e6  # rad of latitude


@pytest.fixture(scope='module')
def drive():
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(simulate_drive(480.0, seed=3, rate=50.0), sensors, GnssNoise(1e-3, rate=5.0),
                              seed=3).recording


def in_turn(drive, claimed_without: float):
    """A minute with a base, 0.02 m and status 2, and one without, 2 m and status 0, in turn."""
    fixes, rng = drive.gnss, np.random.default_rng(5)
    t = (fixes.stamp - fixes.stamp[0]) * 1e-9
    base = (t // 60.0) % 2 == 0
    error = np.where(base, 0.02, 2.0)[:, None] * rng.standard_normal((len(t), 2))
    claimed = np.where(base, 0.02, claimed_without)
    return replace(fixes, latitude=fixes.latitude + METRE * error[:, 0],
                   longitude=fixes.longitude + METRE * error[:, 1] / np.cos(fixes.latitude),
                   covariance=claimed[:, None, None] ** 2 * np.diag([1.0, 1.0, 2.25]),
                   status=np.where(base, 2, 0).astype(np.int8)), base


@pytest.mark.parametrize('claimed, told', [(2.0, True), (0.5, True), (2.0, False)])
def test_a_fix_with_a_base_is_believed_at_once_behind_a_minute_without(drive, claimed, told):
    # given claims that are right, or too small by four without a base, and a status that tells, or is always the same
    fixes, base = in_turn(drive, claimed)
    if not told:
        fixes = replace(fixes, status=np.full(len(fixes), 2, dtype=np.int8))
    found, truth = run(CONFIG, drive.imu, fixes), truth_of(drive, CONFIG.parameters)
    errors = position_errors(found, truth, np.zeros(len(truth), dtype=bool))
    t, at = (errors.stamp - fixes.stamp[0]) * 1e-9, np.searchsorted(fixes.stamp, errors.stamp, side='right') - 1
    settled, with_base = t > 130.0, base[np.clip(at, 0, None)]
    # then not more than a fix is refused, and with a base the error is its from the first fix on (all fixes of a minute
    # were refused before, as on a straight line, and the error was 0.3 m),
    measured = found.measured
    verdicts = measured.event[measured.kind == Kind.POSITION, Event.VERDICT]
    assert (~np.isin(verdicts, (Verdict.USED, Verdict.WEIGHTED))).sum() <= 1
    assert rms(errors.horizontal[settled & with_base]) < (0.05 if told else 0.2)
    # without one it is below that of the fixes, 2.8 m, and the ellipse holds
    assert rms(errors.horizontal[settled & ~with_base]) < 1.5
    assert np.mean(errors.nees[settled & ~with_base] < NEES_95) > 0.9
