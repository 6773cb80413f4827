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
from mems_ins_fusion.diagnosis.exact import HELD, SMOOTHINGS, of_smoothing, with_what_is_held
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


def jointly(recording, offset_prior, arm_prior):
    """Offset and arm of a fit of both, with these standard deviations beforehand; and their sigmas."""
    problem = Problem(recording, table.check({}))
    unknowns = [replace(u, prior=prior) for name, prior in zip(HELD, (offset_prior, arm_prior))
                for u in effect_unknowns(EFFECTS[name], {}, problem.attitude)]
    model = fit(problem, unknowns, np.zeros(len(unknowns)))
    return model.x, model.sigma()


def test_an_arm_that_is_not_known_is_in_the_sigma_of_an_offset(drive):
    # given the offset fitted with the antenna on the IMU, where it is not, and a fit of both
    held, given = fitted(drive, 0.0)
    values, joint = jointly(drive, 10.0, ARM)
    # when nothing else shows the offset, then it is as unsure as in a fit of both, and as far off as that moves it
    sigma = with_what_is_held(held, track(5.0, arm_sigma=[ARM] * 3), given)[0]
    assert sigma == pytest.approx(np.hypot(held.x[0] - values[0], joint[0]), rel=0.1)
    assert sigma > 1.5 * held.sigma()[0] and abs(held.x[0]) < 2.0 * sigma
    # whether the size of the arm is an estimate or its sigma; without a track it may be a metre
    assert with_what_is_held(held, track(5.0, arm=[ARM] * 3), given)[0] == pytest.approx(sigma)
    assert with_what_is_held(held, None, given)[0] == pytest.approx(sigma, rel=0.3)


def test_an_arm_that_is_stated_was_measured_as_well_as_its_sigma_says(drive):
    # given the offset fitted with the antenna where it is
    right, stated = fitted(drive, ARM)
    exactly, by_tape, roughly = (with_what_is_held(
        right, track(5.0, arm=[ARM, 0.0, 0.0]), stated | {'gnss.lever_arm_sigma': size})[0] for size in (0.0, 0.2, 5.0))
    # then decimetres count, and metres as in a fit of both
    values, joint = jointly(drive, 10.0, 5.0)
    assert exactly == right.sigma()[0] < by_tape < 1.5 * exactly < roughly
    assert roughly == pytest.approx(np.hypot(right.x[0] - values[0], joint[0]), rel=0.1)


def test_an_offset_that_the_track_shows_too_is_known_as_well_as_by_that(drive):
    # given an arm of which nothing is known, and a track that shows another offset, precisely or not
    held, given = fitted(drive, 0.0)
    for away, precision, expected in ((0.05, 0.0, 0.05), (0.04, 0.03, 0.05), (0.0, 0.05, 0.05)):
        shown = track(held.x[0] + away, precision, arm_sigma=[ARM] * 3)
        # then it is known to both together
        assert with_what_is_held(held, shown, given)[0] == pytest.approx(max(expected, held.sigma()[0]))


def test_a_vague_track_that_agrees_by_chance_does_not_make_an_offset_surer(drive):
    held, given = fitted(drive, 0.0)
    alone = with_what_is_held(held, None, given)[0]
    assert with_what_is_held(held, track(held.x[0], 1.0, arm_sigma=[1.0] * 3), given)[0] == pytest.approx(alone)


def test_an_offset_that_is_not_known_is_in_the_sigma_of_an_arm(drive):
    arm, given = fitted(drive, 0.0, 'gnss_lever_arm')
    assert with_what_is_held(arm, track(arm=[9.0] * 3), given) == pytest.approx(arm.sigma())
    late = with_what_is_held(arm, track(lag=0.2, arm=[99.0] * 3), given)
    # given the same of a fit of both, then forwards it is less sure, and sideways hardly
    _, joint = jointly(drive, 0.2, 10.0)
    assert late[0] > 1.2 * arm.sigma()[0] and late[1] < 1.1 * arm.sigma()[1]
    assert late[0] == pytest.approx(joint[1], rel=0.5)
    assert with_what_is_held(arm, track(lag=0.2, arm=[9.0] * 3),
                             given | {'gnss.time_offset': 0.2}) == pytest.approx(arm.sigma())


def test_what_is_fitted_too_is_not_held(drive):
    # given offset and arm in one model: their information has what the one does to the other
    given = table.check({})
    problem = Problem(drive, given)
    unknowns = [u for name in HELD for u in effect_unknowns(EFFECTS[name], {}, problem.attitude)]
    both = fit(problem, unknowns, np.zeros(len(unknowns)))
    assert np.array_equal(with_what_is_held(both, track(1.0, arm=[9.0] * 3), given), both.sigma())


def test_what_is_held_is_in_the_sigma_of_what_is_set(drive, monkeypatch):
    # given an offset that was added, and a track that shows another one and an arm
    model, given = fitted(drive, 0.0)
    given['gnss.time_offset_sigma'] = 0.4
    finding = Finding('gnss_time_offset', ['gnss_time_offset'], {'time_offset': Estimate(model.x[0], 0.02, 's')}, 50.0,
                      1e-6, True, HeldOut(20.0, 1e-6, []))
    shown = track(1.0, arm=[ARM, 0.0, 0.0])
    trials = SimpleNamespace(library=[EFFECTS['gnss_time_offset']], origin=SimpleNamespace(given=given),
                             beside=SimpleNamespace(track=shown))
    monkeypatch.setattr(conclusion, 'by_drive_of', lambda *model_and_unknowns: ({}, False))
    known = SimpleNamespace(model=model, findings=[finding], noise=0)
    estimates = conclusion._estimates(known, trials)
    proven = conclusion._proven_sigmas(known, estimates, trials)
    [said] = conclusion._final_findings(known, estimates, {}, given | {'gnss.time_offset': 0.1} | proven, trials)
    further = with_what_is_held(model, shown, given)[0]
    sigma = said.parameters['time_offset'].sigma
    assert further > 0.05 and further < sigma < 1.2 * further
    # and that is what is written beside the value, instead of the one that was given, and told with it
    assert said.changes == {'gnss.time_offset': 0.1, 'gnss.time_offset_sigma': sigma}


def test_a_value_that_was_not_fitted_keeps_its_sigma():
    # given an arm that was fitted forward to 0.1 m, and is known to the left to what the file says
    given = table.check({'gnss.lever_arm_sigma': 0.5})
    arm = SimpleNamespace(name='gnss_lever_arm', added=True)
    known = SimpleNamespace(findings=[arm])
    trials = SimpleNamespace(library=list(EFFECTS.values()), origin=SimpleNamespace(given=given))

    def proven(**sigmas):
        estimates = {arm.name: {n: Estimate(1.0, s, 'm') for n, s in sigmas.items()}}
        return conclusion._proven_sigmas(known, estimates, trials)

    # then the sigma, which is of both, stays; with both it is the larger one, and what is up has none
    assert proven(x=0.1) == {'gnss.lever_arm_sigma': 0.5}
    assert proven(x=0.1, y=0.2, z=0.9) == proven(x=0.2, y=0.1) == {'gnss.lever_arm_sigma': 0.2}
    assert proven(z=0.9) == {}
    arm.added = False
    assert proven(x=0.1, y=0.2) == {}


def test_an_effect_is_plain_with_what_is_held_unless_it_shows_for_certain_without_a_filter(drive, monkeypatch):
    # given fixes 0.5 s late, and an arm that leaves a second of that open
    late = replace(drive, gnss=replace(drive.gnss, stamp=drive.gnss.stamp + 500_000_000))
    effects = [EFFECTS['gnss_time_offset']]
    monkeypatch.setattr(exact, 'with_what_is_held', lambda model, *known: np.ones(len(model.unknowns)))
    # then an offset is set that shows for certain between the fixes, too, and no other
    assert diagnose(late, table.check({}), effects=effects, durations=(10.0,)).corrected['gnss.time_offset'] > 0.2
    monkeypatch.setattr(TrialRuns, 'certain', ())
    assert diagnose(late, table.check({}), effects=effects, durations=(10.0,)).corrected['gnss.time_offset'] == 0.0


def smoothing_drive(sigma, tau):
    """Five minutes in a city with a receiver of that noise, m, and smoothing, s."""
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(simulate_drive(300.0, 3, 25.0, standstill=10.0), sensors,
                              GnssNoise(sigma, 1.0, smoothing=tau), seed=3).recording


def test_a_receiver_that_may_smooth_is_in_the_sigma_of_an_offset():
    # given fixes that are smoothed, with which an offset was fitted without that
    made = smoothing_drive(1.5, 0.8)
    model, given = fitted(made, 0.0)
    problem = model.problem
    # when offsets each 10 ms are tried with each of the smoothings that may be; longer ones are far less likely
    tried, best = np.arange(-0.1, 0.1, 0.01), []
    for tau in (0.0, *SMOOTHINGS[:3]):
        likely = [problem.residual({**problem.values, 'gnss.time_offset': offset, 'gnss.lag_per_acceleration': tau**2},
                                   problem.recording).log_likelihood()[problem.mask].sum() for offset in tried]
        best.append((max(likely), tried[np.argmax(likely)]))
    likelihoods, offsets = np.array(best).T
    # then the sigma has what these offsets differ by, each as likely as it is
    weight = np.exp(likelihoods - likelihoods.max())
    expected = np.sqrt(weight @ (offsets - model.x[0]) ** 2 / weight.sum())
    assert of_smoothing(model, given) == pytest.approx(expected, rel=0.1, abs=0.005)
    assert expected > 0.01
    assert of_smoothing(model, given | {'gnss.lag_per_acceleration': 0.5}) == 0.0  # it is known


def test_where_fixes_show_that_nothing_smooths_the_sigma_of_an_offset_stays():
    # given fixes of 2 cm as they are: half a second of smoothing would be decimetres
    model, given = fitted(smoothing_drive(0.02, 0.0), 0.0)
    assert of_smoothing(model, given) < 0.1 * model.sigma()[0]
    # and a model that has the smoothing knows what it leaves open
    problem = model.problem
    [lag] = effect_unknowns(EFFECTS['gnss_lag'], {}, problem.attitude)
    assert of_smoothing(fit(problem, [*model.unknowns, lag], np.append(model.x, 0.0), 1), given) == 0.0


def test_other_effects_are_left_alone(drive):
    model, given = fitted(drive, 0.0, 'accelerometer_scale')
    assert np.array_equal(with_what_is_held(model, track(lag=1.0), given), model.sigma())
