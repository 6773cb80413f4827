"""A diagnosis leaves a wrong start value again, whichever way it has come into the parameters."""
from __future__ import annotations

from dataclasses import replace
from types import MethodType, SimpleNamespace

import numpy as np
import pytest

from mems_ins_fusion.configuration.offset import Offset, together
from mems_ins_fusion.diagnosis import conclusion, search
from mems_ins_fusion.diagnosis.candidate_proof import TestedCandidate, too_small_effect
from mems_ins_fusion.diagnosis.conclusion import _final_findings
from mems_ins_fusion.diagnosis.diagnose import diagnose
from mems_ins_fusion.diagnosis.drives import Drives
from mems_ins_fusion.diagnosis.estimate import SYSTEMATIC, Estimate
from mems_ins_fusion.diagnosis.exact import of_receiver, sigmas
from mems_ins_fusion.diagnosis.findings import Finding
from mems_ins_fusion.diagnosis.fit import fit
from mems_ins_fusion.diagnosis.held_out import HeldOut
from mems_ins_fusion.diagnosis.known import SearchState
from mems_ins_fusion.diagnosis.noise import calibrated, noise_unknowns
from mems_ins_fusion.diagnosis.plausible import implausible
from mems_ins_fusion.diagnosis.problem import Problem, Unknown
from mems_ins_fusion.diagnosis.starts import TIME_OFFSET, DirectEvidence, other_starts, shown_without_filter
from mems_ins_fusion.diagnosis.tracing import Candidate, effect_unknowns
from mems_ins_fusion.diagnosis.trial_runs import TrialRuns
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_drive,
    simulate_recording,
)

OFFSET = 0.5


@pytest.fixture(scope='module')
def late():
    """Five minutes whose fixes are stamped 0.5 s late."""
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    effect = (EFFECTS['gnss_time_offset'], {'time_offset': OFFSET})
    return simulate_recording(simulate_drive(300.0, 4, 50.0, grade=0.02), sensors, GnssNoise(0.3, 1.0), [effect],
                              seed=4).recording


def test_a_search_starts_from_what_is_given_from_what_the_recording_shows_and_from_nothing(late):
    shown, nothing = other_starts(track := shown_without_filter([late], table.check({})).track,
                                  table.check({TIME_OFFSET: -0.8}))
    assert shown[TIME_OFFSET] == pytest.approx(OFFSET, abs=0.1) and nothing[TIME_OFFSET] == 0.0
    # and what is the same start is none of its own
    alone, = other_starts(track, table.check({TIME_OFFSET: shown[TIME_OFFSET]}))
    assert alone[TIME_OFFSET] == 0.0


def test_the_heading_at_the_start_is_not_that_of_a_wrong_time_offset():
    # given a drive that starts in a bend, right stamps, and an offset of 0.8 s in the parameters
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    recording = simulate_recording(simulate_drive(120.0, 8, 25.0), sensors, GnssNoise(0.5, 1.0), seed=8).recording
    right, wrong = table.check({}), table.check({TIME_OFFSET: 0.8})
    by_right, by_wrong = (Problem(recording, values).start.yaw for values in (right, wrong))
    assert abs(by_wrong - by_right) > np.radians(4.0)
    # then the start is that with which the fixes are explained better, whichever of both is given
    for given, other in ((wrong, right), (right, wrong)):
        problem = Problem(recording, given, others=[other])
        assert problem.start.yaw == pytest.approx(by_right, abs=np.radians(0.5))
        # and so it is with another mechanization
        [planar] = Drives([problem]).configured([recording], {**given, 'mechanization': 'planar'}).each
        assert planar.start.yaw == pytest.approx(by_right, abs=np.radians(0.5))


@pytest.mark.parametrize('tau', [0.7, 1.2])
def test_a_low_pass_of_an_input_is_found_with_its_offset(tau, monkeypatch):
    # given a wheel speed that is smoothed; of 1.2 s innovations show nothing, as where the filter refuses it
    if tau > 1.0:
        monkeypatch.setattr(search, 'trace', lambda problem, nuisance, at, effects, mask: [
            Candidate(effect, [], np.zeros(0), np.zeros(0), 0.0, 1.0, None, ['delay', 'tau']) for effect in effects])
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    made = simulate_recording(simulate_drive(300.0, 8, 50.0), sensors, GnssNoise(0.3), [(EFFECTS['speed_lag'], {
        'tau': tau})], seed=8, aiding=SimulatedAiding(speed_rate=10.0)).recording
    # when
    diagnosis = diagnose(made, table.check({'speed_topic': '/speed'}), effects=[EFFECTS['speed_lag']],
                         durations=(10.0,))
    # then both are found, and set
    found, = (finding for finding in diagnosis.findings if finding.added)
    for name in ('delay', 'tau'):
        estimate = found.parameters[name]
        assert estimate.value == pytest.approx(tau, abs=3.0 * estimate.sigma) and estimate.sigma < 0.2
    assert found.changes['speed.time_offset'] == pytest.approx(tau, abs=0.2)
    assert found.changes['speed.lag'] == pytest.approx(tau, abs=0.2)
    assert np.mean(diagnosis.after.outages[0].max_error) < 0.7 * np.mean(diagnosis.before.outages[0].max_error)


def test_a_wrong_time_offset_is_left_again(late):
    # given parameters that are off by 1.3 s, and no other effect to explain it
    found = diagnose(late, table.check({TIME_OFFSET: OFFSET - 1.3}), effects=[EFFECTS['gnss_time_offset']],
                     durations=(10.0,))
    # then the offset is right within its sigma
    estimate = next(f for f in found.findings if f.name == 'gnss_time_offset').parameters['time_offset']
    assert estimate.value == pytest.approx(1.3, abs=3.0 * estimate.sigma) and estimate.sigma < 0.1
    assert found.corrected[TIME_OFFSET] == pytest.approx(OFFSET, abs=0.05)


@pytest.mark.parametrize(('stated', 'better'), [(0.1, True), (0.015, False)])
def test_a_stated_offset_gives_way_to_one_that_is_known_better(late, stated, better):
    # given an offset that is off by less than what shows for certain, and its sigma
    given = table.check({TIME_OFFSET: OFFSET + 0.02, f'{TIME_OFFSET}_sigma': stated})
    found = diagnose(late, given, effects=[EFFECTS['gnss_time_offset']], durations=(10.0,))
    # then it is moved where the recording tells it with a smaller sigma, and kept else
    now, sigma = found.corrected[TIME_OFFSET], found.corrected[f'{TIME_OFFSET}_sigma']
    if better:
        assert now == pytest.approx(OFFSET, abs=2.0 * sigma) and now != given[TIME_OFFSET] and sigma < 0.8 * stated
    else:
        assert (now, sigma) == (given[TIME_OFFSET], stated)
    # and the intervals hold for all that was compared with what was given, not only for what was chosen of it
    tested = [change for change in found.verdict.changes if change.log_ratio is not None]
    assert not better or 1 - found.verdict.level < 0.04 / len(tested)


def test_an_offset_is_no_surer_than_a_receiver_that_smooths_leaves_it():
    # given a track that a receiver explains as well that smooths and is stamped otherwise by 0.3 s
    track = Offset(0.8, 0.4, np.zeros(3), np.ones(3), 0.0, 1.0, undecided=0.3)
    plain, smoothing = (SimpleNamespace(unknowns=[SimpleNamespace(name=f'{name}.x', effect=name) for name in names],
                                        x=np.zeros(len(names)))
                        for names in (['gnss_time_offset'], ['gnss_time_offset', 'gnss_lag']))
    lasting = {tau: SimpleNamespace(unknowns=[SimpleNamespace(
        name='gnss_coloured_noise.tau', effect='gnss_coloured_noise', meant=lambda x, s: (x, s))], x=[tau])
        for tau in (4.0, 40.0)}
    # then a model that has no smoothing is not sure to that; one that has, knows what it cannot tell itself
    assert of_receiver(plain, track) == pytest.approx(np.hypot(0.3, 0.01))
    assert of_receiver(smoothing, track) == of_receiver(plain, None) == pytest.approx(0.01)
    # and errors that last for as long as a receiver smooths are a delay of a part of that, longer ones are none
    assert of_receiver(lasting[4.0], None) == pytest.approx(np.hypot(SYSTEMATIC * 4.0, 0.01))
    assert of_receiver(lasting[40.0], None) == pytest.approx(0.01)


def test_what_a_receiver_that_smooths_leaves_open_decides_whether_an_offset_is_there(late):
    # given fixes that are late, and a track that cannot tell that from smoothing to 0.3 s
    given = table.check({})
    problem = Problem(late, given)
    unknowns = effect_unknowns(EFFECTS['gnss_time_offset'], {}, problem.attitude)
    model = fit(problem, unknowns, np.zeros(len(unknowns)))
    sure, open_ = (sigmas(model, Offset(OFFSET, 0.4, np.zeros(3), np.zeros(3), 0.0, 1.0, undecided=undecided), given)
                   for undecided in (0.0, 0.3))
    # then its sigma has that, and with it the offset is not there for certain
    assert open_ == pytest.approx(np.hypot(sure, 0.3)) and sure[0] < 0.1
    assert too_small_effect(model, [0], sure) == '' and too_small_effect(model, [0], open_)


@pytest.mark.parametrize(('sigma_of_time', 'there'), [(0.3, True), (0.9, True), (1.1, False)])
def test_a_noise_whose_correlation_time_is_no_better_known_than_itself_is_not_added(sigma_of_time, there):
    # given a noise of 4 m, known to 0.5 m, and its time of 20 s, as the logarithm of a factor on that
    scatter = Unknown('gnss_coloured_noise.sigma', None, 0.0, 0.1, 100.0, variance=True)
    lasting = Unknown('gnss_coloured_noise.tau', None, 0.0, 0.1, 1.0, factor_on=20.0)
    model = SimpleNamespace(unknowns=[scatter, lasting], x=np.array([16.0, 0.0]))
    # then it counts only where the time is known as well: 20 +- 22 s is none that a filter could be told
    against = too_small_effect(model, [0, 1], np.array([4.0, sigma_of_time]))
    assert (against == '') is there and (there or 'tau' in against)
    # and a scatter whose sigma is as large as itself is not told, either
    assert 'sigma is not determined' in too_small_effect(model, [0], np.array([33.0]))


def test_what_effects_added_later_leave_unsure_is_not_set(late, monkeypatch):
    # given an offset that was plain when it was added, and is not with what was added later
    problem = Drives([Problem(late, table.check({}))])
    noise = noise_unknowns(problem)
    model = fit(problem, [*noise, *effect_unknowns(EFFECTS['gnss_time_offset'], {}, problem.attitude)],
                [*calibrated(problem, noise), 0.0])
    added = Finding('gnss_time_offset', ['gnss_time_offset'], {'time_offset': Estimate(OFFSET, 0.02, 's')}, 20.0, 1e-6,
                    True, HeldOut(20.0, 1e-6, []))
    known = SearchState(problem, model, None, (), findings=(added,))
    for further, certain, is_set in ((0.0, (), True), (0.3, (), False), (0.3, ('gnss_time_offset',), True)):
        track = Offset(OFFSET, 0.4, np.zeros(3), np.zeros(3), 0.0, 1.0, undecided=further)
        trials = SimpleNamespace(beside=SimpleNamespace(track=track), origin=problem, certain=certain, shown={},
                                 errors=lambda models: None)
        left = search.without_undetermined(known, trials)
        # then it is left out, unless the recordings show it for certain without a filter
        assert left.findings[0].added == is_set and len(left.model.unknowns) == len(noise) + is_set
        assert is_set or left.findings[0].reason == 'less than 3 sigma with the effects that were added later'


@pytest.mark.parametrize('largest, is_set', [(0.95, True), (0.5, False)])
def test_a_size_that_has_grown_beyond_all_vehicles_with_effects_added_later_is_not_set(
        late, monkeypatch, largest, is_set):
    # given an effect that was possible when it was added, whose size is OFFSET in the joint fit at the end
    monkeypatch.setitem(EFFECTS['gnss_time_offset'].largest, 'time_offset', largest * OFFSET)
    problem = Drives([Problem(late, table.check({}))])
    noise = noise_unknowns(problem)
    model = fit(problem, [*noise, *effect_unknowns(EFFECTS['gnss_time_offset'], {}, problem.attitude)],
                [*calibrated(problem, noise), 0.0])
    added = Finding('gnss_time_offset', ['gnss_time_offset'], {'time_offset': Estimate(0.3 * OFFSET, 0.02, 's')}, 20.0,
                    1e-6, True, HeldOut(20.0, 1e-6, []))
    track = Offset(OFFSET, 0.01, np.zeros(3), np.zeros(3), 0.0, 1.0, undecided=0.06)
    # whether the recordings show it or not
    for certain in ((), ('gnss_time_offset',)):
        trials = SimpleNamespace(beside=SimpleNamespace(track=track), origin=problem, certain=certain, shown={},
                                 errors=lambda models: None)
        left = search.without_undetermined(SearchState(problem, model, None, (), findings=(added,)), trials)
        # then it is set only where all of its sigma is not beyond the largest one
        assert left.findings[0].added == is_set and len(left.model.unknowns) == len(noise) + is_set
        assert is_set or 'more than any vehicle has' in left.findings[0].reason
        # and told with the size for which it is not
        told = left.findings[0].parameters['time_offset'].value
        assert told == pytest.approx(0.3 * OFFSET if is_set else OFFSET, abs=0.05)


def test_what_the_track_shows_for_certain_is_told_even_where_held_out_data_do_not_gain():
    # given an offset with which held-out data are predicted worse
    told = Finding('gnss_time_offset', ['gnss_time_offset'], {'time_offset': Estimate(0.6, 0.1, 's')}, 400.0, 1e-80,
                   False, HeldOut(-29.7, 0.57, []), 'no gain')
    model = SimpleNamespace(unknowns=[], x=[], sigma=lambda: [])
    said = {}
    for certain in ((), ('gnss_time_offset',)):
        trials = SimpleNamespace(library=[], origin=SimpleNamespace(given={}), beside=SimpleNamespace(track=None),
                                 certain=certain)
        said[certain] = _final_findings(SimpleNamespace(model=model, findings=[told]), {told.name: {}}, {}, {}, trials)
    # then it is told only where the checker tells it, too
    assert not said[()] and [finding.name for finding in said['gnss_time_offset',]] == ['gnss_time_offset']


def test_errors_before_and_after_are_those_of_the_same_outages(late, monkeypatch):
    # given a correction whose filter starts later, and so has not the first two outages
    measured = conclusion._as_measured

    def later(corrections, trials):
        return [replace(tried, errors=replace(tried.errors, outages=[
            o.select(np.arange(len(o.begin)) > 1) for o in tried.errors.outages]))
            for tried in measured(corrections, trials)]
    monkeypatch.setattr(conclusion, '_as_measured', later)
    # when the offset that the fixes have is found
    found = diagnose(late, table.check({}), effects=[EFFECTS['gnss_time_offset']], durations=(10.0,))
    assert found.corrected[TIME_OFFSET] == pytest.approx(OFFSET, abs=0.05)
    # then the errors are of the same outages, of two filters
    before, after = found.before.outages[0], found.after.outages[0]
    assert len(before.begin) and before.begin.tolist() == after.begin.tolist()
    assert before.max_error.mean() > 1.2 * after.max_error.mean()


def test_what_a_drive_cannot_tell_of_smoothing_others_may():
    # given drives on which 0.2 s without smoothing and 0.5 s with it are as likely, or the latter less so
    def seen(unlikely, lag=0.2):
        apart = 0.3 * np.sqrt(np.exp(-0.5 * unlikely) / (1.0 + np.exp(-0.5 * unlikely)))
        return Offset(lag, 0.4, np.zeros(3), np.ones(3), 0.0, 1.0, (), apart,
                      ((lag, 100.0), (lag + 0.3, 100.0 + unlikely)))
    # then two that cannot tell are no surer than one, and with the third one its evidence counts for all
    assert together([seen(0.0), seen(0.0)]).undecided == pytest.approx(0.3 * np.sqrt(0.5))
    assert together([seen(0.0), seen(4.0)]).undecided == pytest.approx(seen(4.0).undecided)
    assert together([seen(4.0), seen(4.0)]).undecided == pytest.approx(seen(8.0).undecided)
    # and it is the mean of what they tell that is uncertain by so much
    assert together([seen(0.0, 0.1), seen(0.0, 0.3)]).undecided == pytest.approx(seen(0.0).undecided)


def test_a_scale_of_the_gyroscopes_that_the_course_contradicts_is_none(late):
    # given gyroscopes that turn as far as the course does, as a bench sees it
    problem = Problem(late, table.check({TIME_OFFSET: OFFSET}))
    track = Offset(OFFSET, 0.02, np.zeros(3), np.ones(3), 0.01, 0.05)
    given = (10.0,), 30.0, lambda part, what: None, {}, DirectEvidence(track)
    shown = TrialRuns((late,), Drives([problem]), (), *given).shown
    turned = shown['gyroscope_scale.z']
    # an offset that is in the parameters is none that has to be tried first; one that is not, is
    early = Problem(late, table.check({}))
    assert [TrialRuns((late,), Drives([p]), (), *given).certain
            for p in (problem, early)] == [(), ('gnss_time_offset',)]
    assert turned.value == pytest.approx(0.0, abs=3.0 * turned.sigma)
    # then, where that is seen well enough, a scale that is far from it cannot be, and one that is not can
    seen = {'gyroscope_scale.z': replace(turned, value=0.0, sigma=0.01)}
    assert 'contradicts' in implausible('gyroscope_scale', {'z': Estimate(0.12, 0.01, '-')}, seen)
    assert implausible('gyroscope_scale', {'z': Estimate(0.02, 0.005, '-')}, seen) == ''
    # nor, where samples alias and all is vague, one that nothing is seen of
    vague = {'gyroscope_scale.z': replace(turned, value=0.2, sigma=0.3)}
    assert 'is none' in implausible('gyroscope_scale', {'z': Estimate(0.12, 0.01, '-')}, vague)
    # nor a receiver that smooths over seconds, of which the track between fixes knows nothing
    assert 'contradicts' in implausible('gnss_lag', {'lag': Estimate(4.9, 1.1, 's^2')}, shown)
    assert implausible('gnss_lag', {'lag': Estimate(0.9, 0.1, 's^2')}, shown) == ''


@pytest.mark.parametrize(('learns', 'answer', 'sets'), [
    (True, 'cannot_tell', False), (True, 'worse', False), (True, 'better', True), (False, 'cannot_tell', True)])
def test_how_fixes_scatter_is_set_only_where_errors_are_smaller_with_it(late, monkeypatch, learns, answer, sets):
    # given an offset and coloured noise that the search has added, and a filter that learns how fixes scatter or not
    given = table.check({'gnss.adapt_sigma': learns})
    problem = Problem(late, given)
    effects = [EFFECTS['gnss_time_offset'], EFFECTS['gnss_coloured_noise']]
    unknowns = [u for effect in effects for u in effect_unknowns(effect, {'tau': 40.0}, problem.attitude)]
    model = SimpleNamespace(unknowns=unknowns, x=np.array([0.3, 4.0]))
    findings = tuple(Finding(e.name, [e.name], {}, 20.0, 1e-6, True, HeldOut(9.0, 1e-6, [])) for e in effects)
    known = SearchState(problem, model, None, (), estimates=(np.array([0.2, 2.25]),), findings=findings)
    compared = []
    trials = SimpleNamespace(library=effects, origin=problem, errors=lambda models, full: compared.append(models))
    monkeypatch.setattr(conclusion, 'verdict_on', lambda *errors, effects: SimpleNamespace(answer=answer))
    # when what is to be set is chosen
    left = conclusion._scatter_proven(known, trials)
    # then the noise is set where errors are certainly smaller with it, or the filter cannot learn it; else it is only
    # told, and the offset beside it stays, in the values of each part, too
    name = 'gnss.coloured_noise.sigma'
    assert left.corrected()['gnss.time_offset'] == pytest.approx(0.3)
    assert left.corrected()[name] == pytest.approx(2.0 if sets else 0.0)
    assert left.by_part()[0][name] == pytest.approx(1.5 if sets else 0.0)
    assert [f.added for f in left.findings] == [True, sets] and left.model is known.model
    assert sets or left.findings[1].reason == conclusion.LEARNED
    if learns:
        assert [models[0][name] for models in compared] == pytest.approx([0.0, 1.5])


def test_nothing_stands_for_an_offset_that_the_track_shows_for_certain(late, monkeypatch):
    # given an offset and coloured noise, which explain as much, errors that do not shrink with the offset, and a track
    # that shows it
    names = 'gnss_coloured_noise', 'gnss_time_offset'
    candidates = [Candidate(EFFECTS[name], [], np.ones(1), np.ones(1), 20.0, 1e-6, None, [], {}) for name in names]
    problem = SimpleNamespace(mask=np.ones(1, dtype=bool), recording=late)
    residual = SimpleNamespace(log_likelihood=lambda: np.zeros(1))
    known = SearchState(problem, None, None, tuple(c.effect for c in candidates))
    monkeypatch.setattr(search, 'with_candidate', lambda *given: SimpleNamespace(problem=problem, residual=residual))
    monkeypatch.setattr(search, 'tested_on_held_out', lambda known, candidate, model, bench: TestedCandidate(
        candidate, model, {'time_offset': Estimate(0.9, 0.05, 's')}, {}, HeldOut(1.0, 0.5, []), None,
        'the error grows'))
    monkeypatch.setattr(search, 'compared', lambda *measured: [])
    monkeypatch.setattr(search, 'errors_near_30_s', lambda *measured: None)
    monkeypatch.setattr(search, 'group', lambda winner, others, mask: [winner.name])
    told = {}
    for certain in ((), ('gnss_time_offset',)):
        bench = SimpleNamespace(certain=certain, enough=lambda share: True,
                                shown={'gnss_time_offset.time_offset': Estimate(0.6, 0.1, 's')})
        bench.told = MethodType(TrialRuns.told, bench)
        significant = [(c, np.zeros(0)) for c in candidates]
        told[certain] = search._with_best_of(known, significant, candidates, bench).findings[0]
    # then it is told by its name, where else the other one would be, and with the size that the track shows
    assert [f.name for f in told.values()] == ['gnss_coloured_noise', 'gnss_time_offset']
    assert [f.parameters['time_offset'].value for f in told.values()] == [0.9, 0.6]
