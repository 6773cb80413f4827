"""What a fit takes for exact is in the sigmas of what it fits: time offset and arm of the antenna."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mems_ins_fusion.configuration.offset import Offset
from mems_ins_fusion.diagnosis import conclusion, exact
from mems_ins_fusion.diagnosis.diagnose import diagnose
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.exact import HELD, of_what_is_held
from mems_ins_fusion.diagnosis.findings import Finding
from mems_ins_fusion.diagnosis.fit import fit
from mems_ins_fusion.diagnosis.held_out import HeldOut
from mems_ins_fusion.diagnosis.problem import Problem
from mems_ins_fusion.diagnosis.tracing import effect_unknowns
from mems_ins_fusion.diagnosis.trial_runs import TrialRuns
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

ARM = 1.5  # m, by which the antenna is ahead of the IMU


@pytest.fixture(scope='module')
def drive():
    """Five minutes in a city."""
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(simulate_drive(300.0, 2, 25.0, standstill=10.0), sensors, GnssNoise(1.0, 1.0),
                              [(EFFECTS['gnss_lever_arm'], {'x': ARM})], seed=2).recording


def fitted(recording, arm, effect='gnss_time_offset', offset=0.0):
    """The model with one effect, of an antenna that is stated to be ahead by `arm` and clocks by `offset`; the
    parameters."""
    given = table.check({'gnss.lever_arm': [arm, 0.0, 0.0], 'gnss.time_offset': offset})
    problem = Problem(recording, given)
    unknowns = effect_unknowns(EFFECTS[effect], {}, problem.attitude)
    return fit(problem, unknowns, np.zeros(len(unknowns))), given


def track(lag=0.0, lag_sigma=0.0, arm=(0.0, 0.0, 0.0), arm_sigma=(0.0, 0.0, 0.0)):
    return Offset(lag, lag_sigma, np.array(arm), np.array(arm_sigma), 0.0, 0.0)


def test_an_arm_that_is_not_known_is_in_the_sigma_of_an_offset(drive):
    # given the offset fitted with the antenna on the IMU, and where it is; the clocks agree
    held, given = fitted(drive, 0.0)
    right, stated = fitted(drive, ARM)
    moved = held.x[0] - right.x[0]
    assert abs(right.x[0]) < 3.0 * right.sigma()[0] and abs(moved) > 3.0 * held.sigma()[0]
    # when the track shows another offset, and an arm of that size
    further = of_what_is_held(held, track(1.0, arm=[ARM, 0.0, 0.0]), given)
    # then by how much that moves the offset is known before
    assert further[0] == pytest.approx(abs(moved), rel=0.3)
    # whether the size is an estimate or its sigma, and with both it is more
    assert of_what_is_held(held, track(1.0, arm_sigma=[ARM, 0.0, 0.0]), given) == pytest.approx(further)
    assert of_what_is_held(held, track(1.0, arm=[ARM, 0.0, 0.0], arm_sigma=[ARM, 0.0, 0.0]), given) == pytest.approx(
        np.sqrt(2.0) * further, rel=0.01)
    # an arm that is stated was measured, as well as its sigma says, and one that nothing shows may be a metre
    assert of_what_is_held(right, track(1.0, arm=[ARM, 0.0, 0.0]), stated)[0] == 0.0
    roughly = of_what_is_held(right, track(1.0, arm=[ARM, 0.0, 0.0]), stated | {'gnss.lever_arm_sigma': ARM / 3.0})
    assert roughly[0] == pytest.approx(abs(moved) / 3.0, rel=0.3)
    assert of_what_is_held(held, None, given)[0] > 0.99 * further[0] / ARM


def test_an_offset_that_the_track_shows_too_is_not_one_of_an_arm(drive):
    # given an arm of which nothing is known, and a track that shows nearly that offset, or that within its sigma
    held, given = fitted(drive, 0.0)
    for shown, expected in ((track(held.x[0] + 0.01, arm_sigma=[ARM] * 3), 0.01),
                            (track(held.x[0] + 0.05, 0.03, arm_sigma=[ARM] * 3), 0.04),
                            (track(held.x[0] + 0.05, 0.06, arm_sigma=[ARM] * 3), 0.0)):
        # then it is off by no more than that
        assert of_what_is_held(held, shown, given)[0] == pytest.approx(expected)


def test_an_offset_that_is_not_known_is_in_the_sigma_of_an_arm(drive):
    arm, given = fitted(drive, 0.0, 'gnss_lever_arm')
    assert not of_what_is_held(arm, track(arm=[9.0] * 3), given).any()
    late = of_what_is_held(arm, track(lag=0.2, arm=[9.0] * 3), given)
    # forwards by some part of the way that a car goes in that time, and sideways by little
    other, _ = fitted(drive, 0.0, 'gnss_lever_arm', offset=0.2)
    assert late[0] == pytest.approx(abs(other.x[0] - arm.x[0]), rel=0.3) and 10.0 * late[1] < late[0]
    assert of_what_is_held(arm, track(lag=0.2, arm=[9.0] * 3), given | {'gnss.time_offset': 0.2}) == pytest.approx(0.0)


def test_what_is_fitted_too_is_not_held(drive):
    # given offset and arm in one model: their information has what the one does to the other
    given = table.check({})
    problem = Problem(drive, given)
    unknowns = [u for name in HELD for u in effect_unknowns(EFFECTS[name], {}, problem.attitude)]
    both = fit(problem, unknowns, np.zeros(len(unknowns)))
    assert not of_what_is_held(both, track(1.0, arm=[9.0] * 3), given).any()


def test_what_is_held_is_in_the_sigma_of_what_is_set(drive, monkeypatch):
    # given an offset that was added, and a track that shows another one and an arm
    model, given = fitted(drive, 0.0)
    finding = Finding('gnss_time_offset', ['gnss_time_offset'], {'time_offset': Estimate(model.x[0], 0.02, 's')}, 50.0,
                      1e-6, True, HeldOut(20.0, 1e-6, []))
    shown = track(1.0, arm=[ARM, 0.0, 0.0])
    trials = SimpleNamespace(library=[EFFECTS['gnss_time_offset']], origin=SimpleNamespace(given=given),
                             beside=SimpleNamespace(track=shown))
    monkeypatch.setattr(conclusion, 'by_drive_of', lambda *model_and_unknowns: ({}, False))
    [said] = conclusion._final_findings(SimpleNamespace(model=model, findings=[finding], noise=0), {}, given, trials)
    further = of_what_is_held(model, shown, given)[0]
    assert further > 0.05 and further < said.parameters['time_offset'].sigma < 1.2 * np.hypot(further, model.sigma()[0])


def test_an_effect_is_plain_with_what_is_held_unless_it_shows_for_certain_without_a_filter(drive, monkeypatch):
    # given fixes 0.5 s late, and an arm that leaves a second of that open
    late = replace(drive, gnss=replace(drive.gnss, stamp=drive.gnss.stamp + 500_000_000))
    effects = [EFFECTS['gnss_time_offset']]
    monkeypatch.setattr(exact, 'of_what_is_held', lambda model, *known: np.ones(len(model.unknowns)))
    # then an offset is set that shows for certain between the fixes, too, and no other
    assert diagnose(late, table.check({}), effects=effects, durations=(10.0,)).corrected['gnss.time_offset'] > 0.2
    monkeypatch.setattr(TrialRuns, 'certain', ())
    assert diagnose(late, table.check({}), effects=effects, durations=(10.0,)).corrected['gnss.time_offset'] == 0.0


def test_other_effects_are_left_alone(drive):
    model, given = fitted(drive, 0.0, 'accelerometer_scale')
    assert not of_what_is_held(model, track(lag=1.0), given).any()
    assert not of_what_is_held(SimpleNamespace(unknowns=[]), track(lag=1.0), given).any()
