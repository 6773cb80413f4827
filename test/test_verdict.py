"""Verdicts: right as often as they say, silent where chance does as well, and the same words everywhere."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.evaluation.intervals import (
    Difference,
    effective_number,
    interval_of_share,
    mean_with_error,
    p_of_so_few,
    paired,
)
from mems_ins_fusion.evaluation.verdict import (
    BETTER,
    CANNOT_TELL,
    NO,
    SAME,
    TOO_CAREFUL,
    WORSE,
    YES,
    Consistency,
    change_in_outages,
    change_with_fixes,
    decide,
    trust_in_sigmas,
)
from mems_ins_fusion.reports.diagnosis_answer import headline
from mems_ins_fusion.reports.verdict import because, change_text, span_text, too_small_text, trust_text, verdict_json


def outages(rng, n, overlap=1, tail=4.0):
    """Largest errors (n,) of outages, of which each shares its time with the `overlap` - 1 next ones."""
    each = np.exp(0.6 * rng.standard_t(tail, n + overlap))
    return 5.0 * np.array([each[i:i + overlap].mean() for i in range(n)])


def drive(rng, factor=1.0, n=17):
    """The changes of one drive: outages of 10, 30 and 60 s each 30 s, and errors with fixes."""
    found = []
    for duration, overlap in ((10.0, 1), (30.0, 1), (60.0, 2)):
        before = outages(rng, n, overlap)
        after = factor * before * np.exp(0.3 * rng.standard_normal(n))
        found.append(change_in_outages(duration, before, after, n // overlap))
    before = np.abs(rng.standard_normal(400)) + 0.1
    return [*found, change_with_fixes(before, before * np.exp(0.05 * rng.standard_normal(400)))]


@pytest.mark.parametrize('n, overlap', [(8, 1), (17, 1), (17, 2), (50, 6)])
def test_an_interval_holds_the_mean_of_a_few_outages_that_overlap(n, overlap):
    # given 400 drives of n outages; the mean that each estimates is 0
    rng = np.random.default_rng(n + overlap)
    held = 0
    for _ in range(400):
        each = rng.standard_normal(n + overlap)
        found = mean_with_error(np.array([each[i:i + overlap].mean() for i in range(n)]), n // overlap)
        held += found is None or found.low < 0 < found.high
    # then 95 % of the intervals hold it, by four binomial sigmas; a block bootstrap's held it in 78 to 88 %
    assert held / 400 > 0.95 - 4 * np.sqrt(0.95 * 0.05 / 400)


def test_nothing_that_changed_is_called_better_in_one_of_twenty_drives_at_most():
    rng = np.random.default_rng(1)
    answers = [decide(drive(rng)).answer for _ in range(300)]
    assert answers.count(BETTER) + answers.count(WORSE) <= 15 + 4 * np.sqrt(15)
    assert BETTER in [decide(drive(rng, 0.4)).answer for _ in range(3)]


@pytest.mark.parametrize('alike', [0.0, 0.9])
def test_the_best_of_several_that_are_no_better_is_called_better_in_one_of_twenty_drives_at_most(alike):
    # given eight filters in each drive whose errors are on the average those of the one before, alike or not
    rng, called, alone, drives = np.random.default_rng(7), 0, 0, 200
    for _ in range(drives):
        changes, number = [[] for _ in range(8)], 1.0
        for duration, overlap in ((10.0, 1), (30.0, 1), (60.0, 2)):
            before, shared = outages(rng, 17, overlap), rng.standard_normal(17)
            own = np.sqrt(alike) * shared + np.sqrt(1 - alike) * rng.standard_normal((8, 17))
            after = before * np.exp(0.3 * own - 0.045)
            number = max(number, effective_number(after - before))
            for one, errors in zip(changes, after):
                one.append(change_in_outages(duration, before, errors, 17 // overlap))
        called += any(decide(each, number).answer == BETTER for each in changes)
        alone += any(decide(each).answer == BETTER for each in changes)
    # then the best of them is seldom called better, and more often where each is judged as if it were the only one
    assert called <= 0.05 * drives and called < 0.5 * alone
    # and what is better is found among eight, too
    assert BETTER in [decide(drive(rng, 0.4), 8.0).answer for _ in range(3)]


def test_tests_that_go_together_count_as_fewer():
    rng = np.random.default_rng(8)
    one, four = rng.standard_normal(4000), rng.standard_normal((4, 4000))
    assert effective_number(four) == pytest.approx(4.0, abs=0.01)
    assert effective_number(np.array([one, 2.0 * one, -one])) == pytest.approx(1.0)
    # of a correlation of 0.6 each, 1 + 3 (1 - 0.36)
    assert effective_number(np.sqrt(0.6) * one + np.sqrt(0.4) * four) == pytest.approx(2.92, abs=0.1)
    # what changes nothing is no test
    assert effective_number(np.array([one, 0.0 * one])) == effective_number(np.zeros((0, 5))) == 1.0


def test_better_is_for_certain_and_worse_in_nothing():
    rng = np.random.default_rng(2)
    good, bad = decide(drive(rng, 0.3)), decide(drive(rng, 3.0))
    assert (good.answer, bad.answer) == (BETTER, WORSE)
    assert good.shown.duration == 30.0 and good.shown.after < good.shown.before
    # one thing better and another one worse is no recommendation
    both = decide([*drive(rng, 0.3)[:2], *drive(rng, 3.0)[2:]])
    assert both.answer == CANNOT_TELL and both.gains and both.losses


def test_the_same_numbers_are_the_same_and_too_few_say_nothing():
    error = np.random.default_rng(3).permutation(np.linspace(1.0, 9.0, 20))
    assert decide([change_in_outages(30.0, error, error.copy(), 20)]).answer == SAME
    # what is certain and felt by nobody is not better
    assert decide([change_in_outages(30.0, error, 0.99 * error, 20)]).answer == SAME
    assert decide([change_in_outages(30.0, error[:2], 0.1 * error[:2], 2)]).answer == CANNOT_TELL
    assert decide([]).answer == CANNOT_TELL


def test_a_mean_that_grows_while_the_median_shrinks_is_no_gain():
    # given outages as on Longmont: most a little smaller, a few much larger
    before = np.array([4.0] * 12 + [9.0, 12.0, 20.0])
    after = np.array([3.5] * 12 + [13.0, 15.0, 26.0])
    verdict = decide([change_in_outages(30.0, before, after, 15)])
    assert np.median(after) < np.median(before) and verdict.answer == CANNOT_TELL
    assert 'm less to' in because(verdict)[0] and because(verdict)[0].startswith('no certain difference')


def test_the_interval_of_a_share_and_its_p_are_those_of_the_binomial_distribution():
    from scipy.stats import binom, binomtest

    for k, n in ((5, 6), (17, 17), (0, 4), (14, 18)):
        expected = binomtest(k, n).proportion_ci(0.95, 'exact')
        assert interval_of_share(k, n) == pytest.approx((expected.low, expected.high), abs=1e-9)
        assert p_of_so_few(k, n, 0.95) == pytest.approx(binom.cdf(k, n, 0.95), abs=1e-12)


def consistent(rng, held, of, scale=1.0):
    within = np.arange(of) < held
    return Consistency(30.0, scale**2 * rng.chisquare(2, of), within, of)


@pytest.mark.parametrize('held, of, answer', [(5, 6, CANNOT_TELL), (15, 17, CANNOT_TELL), (17, 17, YES), (16, 17, YES),
                                              (9, 17, NO), (4, 4, CANNOT_TELL)])
def test_trust_is_not_given_or_taken_by_chance(held, of, answer):
    # given errors that are as large as the sigmas say, and counts of outages in the ellipse
    rng = np.random.default_rng(held)
    assert trust_in_sigmas([consistent(rng, held, of), Consistency(None, rng.chisquare(2, 500))]).answer == answer


def test_sigmas_that_are_honest_are_called_too_small_in_one_of_twenty_drives_at_most():
    rng = np.random.default_rng(5)
    answers = []
    for _ in range(300):
        ends = rng.chisquare(2, (3, 17))
        answers.append(trust_in_sigmas([Consistency(duration, nees, nees < 5.99, apart) for duration, nees, apart in
                                        zip((10.0, 30.0, 60.0), ends, (17, 17, 9))]).answer)
    assert answers.count(NO) <= 15 + 4 * np.sqrt(15)


def test_sigmas_that_are_not_honest_are_told_by_their_size_over_time():
    rng = np.random.default_rng(6)
    small = trust_in_sigmas([consistent(rng, 17, 17), Consistency(None, 4.0 * rng.chisquare(2, 500))])
    assert small.answer == NO and 1.8 < small.scale.value < 2.2 and 'too small' in trust_text(small)
    large = trust_in_sigmas([consistent(rng, 17, 17, 0.4), Consistency(None, 0.16 * rng.chisquare(2, 500))])
    assert large.answer == TOO_CAREFUL
    assert trust_text(large).startswith('its sigmas are too large: errors in 30 s without fixes are 0.')
    # and of two durations the one that speaks most against them is told
    two = trust_in_sigmas([consistent(rng, 17, 17, 0.2),
                           Consistency(10.0, 0.16 * rng.chisquare(2, 17), np.ones(17, bool), 17)])
    assert two.answer == TOO_CAREFUL and two.scale.duration == 30.0
    # how wide they are without fixes is not hidden by the receiver's noise in the innovations
    assert trust_in_sigmas([consistent(rng, 17, 17, 0.4),
                            Consistency(None, rng.chisquare(2, 500))]).answer == TOO_CAREFUL
    assert trust_in_sigmas([consistent(rng, 17, 17), Consistency(None, 0.16 * rng.chisquare(2, 500))]).answer == YES
    # where the counts alone show that they are too small, errors over time are no evidence of it
    counted = trust_in_sigmas([consistent(rng, 9, 17, 0.9), Consistency(None, 0.8 * rng.chisquare(2, 500))])
    assert counted.answer == NO and counted.scale is None
    assert trust_text(counted) == f'no, its sigmas are too small: {too_small_text(counted)}.'
    assert too_small_text(counted).startswith('the 95 % ellipse held the truth in 9 of 17')
    assert trust_in_sigmas([]).answer == CANNOT_TELL and 'too short' in trust_text(trust_in_sigmas([]))


def test_the_words_hold_the_interval_and_its_unit():
    change = change_in_outages(30.0, np.array([6.0, 7.0, 8.0, 9.0]), np.array([4.0, 5.5, 5.0, 6.5]), 4)
    text = change_text(change, 0.95)
    assert text.startswith('in 30 s without fixes the error is 5.2 m instead of 7.5 m (95 %: ')
    assert text.endswith(' m less)')
    low, high = change.interval()
    assert f'{-high:.2g}' in text and f'{-low:.2g}' in text
    assert span_text(-1.0, 2.0) == '1 m less to 2 m more' and span_text(0.5, 1.5) == '0.50 to 1.5 m more'
    assert span_text(-184.3, -181.9) == '182 to 184 m less'  # not 180 to 180
    assert span_text(0.0, 0.0) == span_text(-0.004, 0.0) == 'the same' and span_text(-0.004, 0.02) != 'the same'
    # and the other way round, the ratio is the inverse one
    turned = change.turned.interval()
    assert change.turned.before == change.after and (turned[0] > 0) == (high < 0)
    assert (1 + turned[0] / 5.25) * (1 + high / 7.5) == pytest.approx(1.0)
    content = verdict_json(decide([change]))
    assert content['answer'] in ('better', 'cannot_tell') and content['because']
    # errors with all fixes and with few are two rows, which a program can tell apart
    of_fixes = [change_with_fixes(np.arange(9.0), np.ones(9), every=every) for every in (0.0, 6.0)]
    assert [(c['duration_s'], c['every_s']) for c in verdict_json(decide([change, *of_fixes]))['changes']] == [
        (change.duration, 0.0), (None, 0.0), (None, 6.0)]


def test_a_headline_does_not_contradict_the_file():
    # given a gain for certain, but for one drive of several that has the cost of it
    gain = change_in_outages(30.0, np.arange(20.0) + 5.0, np.arange(20.0) + 2.0 + 0.1 * np.sin(np.arange(20.0)), 20)
    verdict = replace(decide([gain]), answer=CANNOT_TELL, why=('the error grows: in monday',))
    # then a file that is kept is said to be kept, and why; one that is changed, by what its likelihood proves, is not
    assert headline(verdict).startswith('Keep your parameters: the error grows: in monday')
    assert headline(verdict, changed=True).startswith('corrected.yaml is not proven to make errors smaller: in 30')
    # and where the file is kept, it is said that the smaller error is not with it
    chance = change_in_outages(30.0, np.array([6.0, 7.0, 8.0, 9.0]), np.array([4.0, 9.5, 3.0, 9.5]), 4)
    for kept in (verdict, decide([chance])):
        assert kept.answer == CANNOT_TELL and '; with what was found, in 30 s' in headline(kept).replace(': w', '; w')
        # nor is something said to be found where only noise levels were tried
        assert ' with other noise levels, in 30 s' in headline(kept, tried='other noise levels')
        assert 'found' not in headline(kept, tried='other noise levels')
    # nothing is named with which errors are larger by chance, or the same
    for kept in (decide([chance.turned]), decide([change_in_outages(30.0, *2 * [np.arange(20.0) + 5.0], 20)])):
        assert kept.answer in (SAME, CANNOT_TELL) and not kept.shown.smaller
        assert headline(kept) == 'Keep your parameters: nothing that was tried makes errors smaller.'


def test_what_is_certainly_wrong_makes_a_recording_not_usable():
    from mems_ins_fusion.recordings.checker import Remark
    from mems_ins_fusion.reports.diagnosis_answer import not_usable
    from mems_ins_fusion.reports.verdict import certainly_wrong

    values = {'mechanization': 'strapdown', 'imu_topic': '/imu', 'gnss_topic': '/fix', 'temperature_topic': ''}
    backwards = Remark('error', 'imu', 'the IMU seems to be mounted backwards: set imu.mounting_rpy to [0.0, 0.0, 3]')
    dead = Remark('error', 'imu', 'rotation rate x: the same value in every sample', {'axes': 'x'})
    found = [backwards, dead, Remark('warning', 'gnss', 'gaps')]
    assert certainly_wrong(found, values) == [backwards, dead]
    # a planar filter does without three of the axes
    assert certainly_wrong(found, values | {'mechanization': 'planar'}) == [backwards]
    verdict, answer = not_usable([backwards], values, ['my drive'])
    assert verdict_json(verdict)['answer'] == 'not_usable' and 'set imu.mounting_rpy' in answer.headline
    assert answer.grade == 'bad' and answer.headline.startswith('Not usable')
    # what to do is to set what can be set, or to record again where nothing can
    settable = replace(backwards, settings=('imu.mounting_rpy',))
    (step,), (cure,) = (not_usable([f], values, ['my drive'])[1].steps for f in (settable, dead))
    assert step.command == "python -m mems_ins_fusion configure --bag 'my drive' --output configured.yaml"
    assert cure.what.startswith('Correct this') and not cure.command
    # and nothing is said twice
    lines = answer.short()
    assert ' '.join(lines).count('mounted backwards') == 1 and not any(line.startswith('wrong') for line in lines)


def test_no_line_of_an_answer_ends_between_a_number_and_its_unit():
    from mems_ins_fusion.reports.answer import GOOD, Answer

    for words in range(1, 60):  # whatever stands before it
        lines = Answer(GOOD, f'{"x " * words}30 s without fixes 5.0 m instead of 7.6 m (95 %: 7.6 m less)').short()
        assert not any(line.endswith(tuple('0123456789')) for line in lines)
        assert ' '.join(lines).endswith('(95 %: 7.6 m less)') and all(len(line) <= 100 for line in lines)


def test_what_to_do_next_is_never_cut():
    from mems_ins_fusion.reports.answer import BAD, WARNING, Answer, Step

    # given a step in words that fills more than a line, and a note that does
    step = ('Record a drive with a standstill, right-angled turns and braking, and run configure again; or set '
            'imu.mounting_rpy by hand.')
    note = 'the yaw of the mounting is not shown: record a drive with a right-angled turn, braking and a standstill'
    lines = Answer(WARNING, 'my_car.yaml is not complete.', [note, 'gaps'], steps=[Step(step)]).short()
    # then the step stands there in full, the note is cut and called one
    text = ' '.join(line.strip() for line in lines)
    assert text.endswith(f'next: {step}') and all(len(line) <= 100 for line in lines)
    assert lines[1].startswith('note: the yaw') and lines[1].endswith(' ... (and 1 more)')
    # and what makes a result useless is called wrong
    assert Answer(BAD, 'Not usable.', [note]).short()[1].startswith('wrong: ')


def test_a_diagnosis_that_proves_nothing_says_what_the_recording_contradicts():
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_answer import _steps

    kept = SimpleNamespace(better=False, changed=False, findings=[], verdict=decide([]), values={}, corrected={})
    step, = _steps(kept, 'out', ['drive'], 'my.yaml', ['imu.mounting_rpy', 'gnss.time_offset'])
    assert step.what == 'Set imu.mounting_rpy and gnss.time_offset as configure writes them, and diagnose again:'
    assert step.command == 'python -m mems_ins_fusion configure --bag drive --output configured.yaml'
    # and that comes before a comparison of what was changed
    first, *_ = _steps(SimpleNamespace(**{**vars(kept), 'changed': True}), 'out', ['drive'], 'my.yaml', ['gnss.sigma'])
    assert first.command == step.command
    # a proof comes before it
    better = SimpleNamespace(**{**vars(kept), 'better': True, 'changed': True, 'trust': trust_in_sigmas([])})
    assert 'as configure' not in str(_steps(better, 'out', ['drive'], 'my.yaml', ['gnss.time_offset']))


def test_a_diagnosis_is_green_only_where_a_gain_is_proven_or_nothing_is_wrong():
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_answer import _grade

    def grade(lacking=False, **of):
        return _grade(SimpleNamespace(**{'trust': trust_in_sigmas([]), 'better': False, 'changed': False} | of),
                      lacking)

    untrue = replace(trust_in_sigmas([]), answer='no')
    assert grade(better=True, changed=True) == grade() == 'good'
    # a changed file without a proof, innovations that are not right, sigmas that are too small
    assert grade(changed=True) == grade(lacking=True) == grade(better=True, changed=True, trust=untrue) == 'warning'
    assert grade(trust=untrue) == 'bad'


def test_what_was_found_is_told_in_the_order_of_what_it_gains():
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_answer import _left

    found = [SimpleNamespace(saves=saves) for saves in ((30.0, 5.0, 5.4), None, (30.0, 5.0, 2.0))]
    assert [f.saves for f in sorted(found, key=_left)] == [(30.0, 5.0, 2.0), None, (30.0, 5.0, 5.4)]


@pytest.mark.parametrize(('saves', 'said'), [
    (None, ''), ((30.0, 5.0, 5.01), ''), ((30.0, 0.0, 0.0), ''),
    ((30.0, 5.0, 4.0), ' When it was added, the error in 30 s without fixes became 20 % smaller.'),
    ((10.0, 5.0, 5.5), ' When it was added, the error in 10 s without fixes became 10 % larger.')])
def test_what_one_effect_gains_is_told_in_per_cent(saves, said):
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_answer import _saves

    assert _saves(SimpleNamespace(saves=saves)) == said


def test_who_keeps_the_parameters_is_told_to_drive_on_with_them():
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_answer import _steps

    chance = change_in_outages(30.0, np.array([6.0, 7.0, 8.0, 9.0]), np.array([4.0, 9.5, 3.0, 9.5]), 4)

    def step(answer, **of):
        kept = SimpleNamespace(**{'better': False, 'changed': False, 'findings': [], 'unexplained': False, 'values': {},
                                  'corrected': {}, 'verdict': replace(decide([chance]), answer=answer)} | of)
        only, = _steps(kept, 'out', ['drive'], 'my.yaml', [])
        return only

    # and where chance may have made the difference, unless a longer drive would tell what something is
    for answer in (SAME, WORSE, CANNOT_TELL):
        assert step(answer).command.endswith('fusion_node --ros-args --params-file my.yaml')
    left_alone = SimpleNamespace(added=False, drives_contradict=False, changes={}, name='gnss_time_offset')
    for more in ({'unexplained': True}, {'findings': [left_alone]}):
        assert step(CANNOT_TELL, **more).what.startswith('Record a longer drive')


def test_what_is_left_alone_is_told_with_what_it_may_be_instead():
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_answer import tried_text

    one = SimpleNamespace(drives=[])
    alone = SimpleNamespace(name='gnss_time_offset', group=['gnss_time_offset'], seen='', reason='too small a gain',
                            parameters={'time_offset': Estimate(0.3618, 0.06027, 's')})
    said = tried_text(alone, one)
    assert '0.362 ± 0.060 s' in said and said.endswith('too small a gain.')
    alone.group.append('gnss_coloured_noise')
    assert tried_text(alone, one) == (
        f"{said} (This recording cannot tell it from: the receiver's errors last for seconds to minutes.)")


def test_what_parameters_were_fitted_to_is_known_by_its_content(tmp_path):
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.recordings.reading import read_recording
    from mems_ins_fusion.recordings.sketch import fitted_to, sketch
    from mems_ins_fusion.recordings.writing import write_recording
    from mems_ins_fusion.samples import Recording
    from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

    def drive(seed) -> Recording:
        sensors = SensorErrors.from_parameters(table.check({}), 'gauss_markov')
        return simulate_recording(simulate_drive(60.0, seed, rate=10.0), sensors, GnssNoise(1.0), seed=seed).recording
    one, other = drive(1), drive(2)
    known = sketch([one.gnss])
    assert len(known) == 8 and fitted_to(one, known) and not fitted_to(other, known) and not fitted_to(one, [])
    # in another file, under other topics, without its first half or its second
    write_recording(one, tmp_path / 'renamed', imu_topic='/a', gnss_topic='/b')
    again = read_recording(tmp_path / 'renamed', '/a', '/b')
    assert fitted_to(again, known)
    half = len(one.gnss) // 2
    parts = [replace(again, gnss=again.gnss.select(part)) for part in (slice(0, half), slice(half, None))]
    assert any(fitted_to(part, known) for part in parts)
    assert fitted_to(other, sketch([one.gnss, other.gnss]))


def test_each_parameter_that_is_changed_is_told_with_its_reason():
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_answer import settings_texts

    # given a file with an effect, a noise level and a switched setting
    values = {'gnss.time_offset': 0.0, 'gyroscope.gauss_markov.sigma': [0.001], 'imu.adapt_noise': True, 'other': 1.0}
    effect = SimpleNamespace(added=True, changes={'gnss.time_offset': 0.2}, name='gnss_time_offset', parameters={})
    d = SimpleNamespace(
        values=values, noise={'gyroscope.gauss_markov.sigma': 0.316}, findings=[effect],
        corrected={**values, 'gnss.time_offset': 0.2, 'gyroscope.gauss_markov.sigma': [0.000316],
                   'imu.adapt_noise': False},
        remarks=['It is no noise: positions are predicted better with imu.adapt_noise: false.'])
    # then the effect is told as such, and of the others what is set and why
    level, switch = settings_texts(d)
    assert level == ('corrected.yaml sets gyroscope.gauss_markov.sigma to [0.000316]: with this noise level the '
                     'positions are predicted best; it is 0.316 times the configured one, [0.001].')
    assert switch.startswith('corrected.yaml sets imu.adapt_noise to false: It is no noise')
    assert switch.endswith('before: true.')


@pytest.mark.parametrize('parameters, said', [
    ({}, 'sigma: 2 to 4.7 m explain the recording equally well; tau: 9.3 to 50 s explain the recording equally well'),
    ({'sigma': Estimate(2.0, 0.3, 'm')}, 'sigma 2.00 ± 0.30 m')])
def test_of_an_effect_without_a_known_size_the_range_is_told(parameters, said):
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_answer import found_text

    # given an effect that was added, none or one of whose parameters the recording determines, and another one
    values = {'gnss.coloured_noise.sigma': 0.0, 'gnss.coloured_noise.tau': 60.0}
    corrected = {'gnss.coloured_noise.sigma': 2.0, 'gnss.coloured_noise.tau': 9.3}
    effect = SimpleNamespace(added=True, changes=corrected, name='gnss_coloured_noise', parameters=parameters, seen='',
                             group=['gnss_coloured_noise'])
    ranges = {'sigma': '2 to 4.7 m explain the recording equally well',
              'tau': '9.3 to 50 s explain the recording equally well'}
    d = SimpleNamespace(values=values, corrected=corrected, noise={}, findings=[effect], better=False, hidden={
        'tilt': 'no slope', 'gnss_lever_arm.z': 'not determined by this recording',
        **{f'gnss_coloured_noise.{name}': why for name, why in ranges.items() if name not in parameters}})
    # then its line says how large it may be, and both values that are set
    text = found_text(effect, d)
    assert text.startswith(f'gnss_coloured_noise: {said}: the receiver')
    assert 'gnss.coloured_noise.sigma to 2.0 (it was 0.0), gnss.coloured_noise.tau to 9.3 (it was 60.0)' in text


def test_what_a_direct_look_shows_stands_behind_what_it_is():
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_answer import found_text

    # given samples that come twice, against which a noise density is set
    name = 'accelerometer.noise_density'
    effect = SimpleNamespace(added=True, changes={name: [0.0114833] * 3}, name='imu_repeats', parameters={},
                             seen='2 % of the samples repeat. Set the driver to its rate', group=['imu_repeats'])
    text = found_text(effect, SimpleNamespace(values={name: [0.00262] * 3}, corrected=effect.changes, noise={},
                                              findings=[effect], better=False, hidden={}))
    # then the line begins with what it is, and has three digits
    assert text.startswith('imu_repeats: IMU samples come twice: 2 % of the samples repeat. Set the driver to its')
    assert 'to [0.0115, 0.0115, 0.0115] (it was [0.00262, 0.00262, 0.00262])' in text


def test_the_error_that_the_headline_tells_is_not_repeated_on_the_page():
    from mems_ins_fusion.reports.answer import GOOD, Answer

    # given a headline with the error, and lines of all durations
    cost = ['in 10 s 2 m; held in 14 of 14', 'in 30 s 5 m; held in 14 of 14', 'in 60 s 9 m; held in 13 of 14']
    for said, repeated in (('Keep your parameters: in 30 s 5 m.', False), ('Keep your parameters.', True)):
        page = Answer(GOOD, said, cost=cost).html()
        # then the middle one is a line of its own only where the headline does not contain it
        assert ('<b>error:</b>' in page) == repeated, page


@pytest.mark.parametrize('fitted, after, changed, shown', [
    (1.0, 1.0, False, ['before']), (2.0, 1.0, False, ['before', 'fitted']),
    # noise levels that are all that was changed are no stage of their own
    (2.0, 2.0, True, ['before', 'after']), (2.0, 3.0, True, ['before', 'fitted', 'after'])])
def test_a_page_shows_each_filter_once(fitted, after, changed, shown):
    from types import SimpleNamespace

    from mems_ins_fusion.reports.diagnosis_figures import measured_stages

    def measured(error):
        return SimpleNamespace(continuous=SimpleNamespace(horizontal=np.full(3, error)))
    # given errors of the filter as configured, with other noise levels, and with corrected.yaml
    stages = measured_stages(SimpleNamespace(before=measured(1.0), fitted=measured(fitted), after=measured(after),
                                             changed=changed))
    # then those that are alike stand there once, in this order
    assert list(stages) == shown


@pytest.mark.parametrize('lag, value, said', [(-0.12, 0.0, 'fixes 0.120 +- 0.080 s early (not set)'),
                                              (0.3, 0.3, 'fixes 0.300 +- 0.080 s late')])
def test_a_time_offset_that_the_file_does_not_have_is_told_as_such(lag, value, said):
    from types import SimpleNamespace

    from mems_ins_fusion.reports.configuration import summary_line

    # given what configure has found, and the value in its file
    mounting = SimpleNamespace(rpy=np.zeros(3), sigma=np.full(3, 0.01), yaw_known=True, lag=lag, lag_sigma=0.08,
                               offset=SimpleNamespace(shown=True))
    line = summary_line(SimpleNamespace(mounting=mounting, values={
        'imu.acceleration_unit': 'g', 'imu.rate_unit': 'rad/s', 'gnss.time_offset': value}))
    assert line.endswith(said)


def skewed(rng, n, overlap, scatter, other=None, ratio=1.0):
    """Largest errors of n outages, before and after: lognormal, those before with the standard deviation `scatter` of
    the logarithm, with a correlation of 0.7, and of the means with `ratio`."""
    z = rng.standard_normal((2, n + overlap - 1))
    found = []
    for mean, sigma, log in ((1.0, scatter, z[0]), (ratio, other or scatter, 0.7 * z[0] + np.sqrt(0.51) * z[1])):
        each = mean * np.exp(sigma * log - 0.5 * sigma**2)
        found.append(np.array([each[i:i + overlap].mean() for i in range(n)]))
    return found


@pytest.mark.parametrize('scatter, other, ratio', [(0.5, None, 1.0), (1.0, None, 1.0), (0.5, None, 0.5),
                                                   (1.0, 0.5, 0.1)])
@pytest.mark.parametrize('n, overlap', [(5, 1), (12, 2), (40, 3)])
def test_an_interval_of_skewed_errors_holds_the_true_change(n, overlap, scatter, other, ratio):
    # given 300 drives of 5 to 40 outages with errors as of a Rayleigh distribution, or more skewed
    rng, drives = np.random.default_rng(n), 300
    missed = changed = 0
    for _ in range(drives):
        change = change_in_outages(30.0, *skewed(rng, n, overlap, scatter, other, ratio), n // overlap)
        if change.log_ratio is not None:
            low, high = change.log_ratio.interval()
            missed += not low < np.log(ratio) < high
            changed += abs(change.sign()) * (ratio == 1.0)
    # then one in twenty intervals misses the true ratio of the means, by four binomial sigmas
    most = 0.05 * drives + 4 * np.sqrt(0.05 * 0.95 * drives)
    assert missed <= most and changed <= most


def test_a_filter_that_is_better_in_each_of_twelve_outages_is_better():
    # given the errors of a velocity that is kept, of 12 outages: tens of metres on straight roads, hundreds with a turn
    rng = np.random.default_rng(4)
    kept = np.array([9, 12, 15, 18, 21, 27, 40, 60, 95, 270, 480, 730.0])
    filtered = np.exp(0.5 * rng.standard_normal(12)) * 4.5
    verdict = decide([change_in_outages(30.0, rng.permutation(kept), filtered, 12)] * 3)
    # then it is better, though the difference of the means is not certain, and the interval is between none and all
    assert paired(filtered, kept).interval(verdict.level)[1] > 0
    assert verdict.answer == BETTER
    assert -kept.mean() < verdict.shown.interval(verdict.level)[0]
    # and one that is worse in most, or in the mean only, is not
    assert decide([change_in_outages(30.0, filtered, filtered * np.where(np.arange(12) < 9, 0.8, 4.0), 12)]).answer == \
        CANNOT_TELL


@pytest.mark.parametrize('count', [5, 12, 40])
@pytest.mark.parametrize('large', [300.0, 1e6])
def test_one_large_outage_is_too_few_to_say_more(count, large):
    # given outages of about 1 m, and one of them far off after the change
    before = 1.0 + 0.1 * np.sin(np.arange(count))
    after = before[::-1].copy()
    after[2] = large
    for change in (found := change_in_outages(30.0, before, after, count)), found.turned:
        verdict = decide([change] * 3)
        # then there is no verdict, and the interval, whose end is at thousands of km, is not told
        assert verdict.answer == CANNOT_TELL
        interval = change.interval(verdict.level)
        assert interval is None or max(map(abs, interval)) < 10 * max(change.before, change.after)
    assert because(decide([found] * 3))[0].endswith(f'(too few to say more); mean of the largest error in {count} '
                                                    'outages')
    # and what is certain stays certain where the end is not told: 100 times the error, within a factor of 40
    certain = replace(found, before=1.0, after=100.0, log_ratio=Difference(np.log(100.0), 1.6, 20.0))
    assert certain.sign() == 1 and certain.interval() is None and decide([certain]).answer == WORSE


def test_a_mean_that_one_error_makes_has_no_interval():
    # given one outage of 300 m among 12 of about 1 m, before and after
    before = np.array([1.0] * 6 + [300.0] + [1.0] * 5)
    after = before * (0.5 + 0.1 * np.sin(np.arange(12)))
    # then half the error there is one number, and nothing is certain; with 5 m instead it is the mean of several
    assert change_in_outages(30.0, before, after, 12).log_ratio is None
    several = change_in_outages(30.0, np.minimum(before, 5.0), np.minimum(after, 2.5), 12)
    assert several.log_ratio.count == pytest.approx(6.5, abs=0.5) and several.sign() == -1
    # and a file beside itself is the same, whatever the errors
    assert decide([change_in_outages(30.0, before, before.copy(), 12)]).answer == SAME


@pytest.mark.parametrize('scatter, ratio, least', [(0.5, 0.5, 0.5), (1.0, 0.1, 0.7)])
def test_much_smaller_errors_show_in_five_outages(scatter, ratio, least):
    rng = np.random.default_rng(5)
    changes = [change_in_outages(30.0, *skewed(rng, 5, 1, scatter, 0.5, ratio), 5) for _ in range(300)]
    assert np.mean([c.sign() == -1 for c in changes]) > least


def test_errors_near_zero_count_as_a_centimetre():
    # given outages at a standstill: nothing that a user feels, though a thousandth of the error before
    still = np.full(12, 0.004)
    change = change_in_outages(30.0, still, still / 1000, 12)
    assert change.sign() == 0 and change.interval() == (0.0, 0.0)
    assert change_in_outages(30.0, 0 * still, 0 * still, 12).interval() == (0.0, 0.0)
