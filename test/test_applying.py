"""What is found while driving drives: when an answer counts, how filters change over, what is taken back and kept."""
from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from ros_support import PLAYABLE, NodeProcess, call
from std_srvs.srv import Trigger
from test_online import OFFSET, SECOND, blind, finding

from mems_ins_fusion.diagnosis import online
from mems_ins_fusion.diagnosis.applying import WAIT, AnswerSchedule, apply_findings, live_output, with_applied
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.false_alarms import FALSE_ALARMS
from mems_ins_fusion.diagnosis.gathering import CHUNK, chunks
from mems_ins_fusion.diagnosis.online import OTHER, Online
from mems_ins_fusion.diagnosis.quantity import COARSE, FINE, SUSPECT, EarlierFinding, FilterFindings
from mems_ins_fusion.diagnosis.trial import DOUBTED, TAKEN_BACK, Trial
from mems_ins_fusion.diagnosis.trial_outages import OUTAGES
from mems_ins_fusion.diagnosis.watch import RecordingWatch
from mems_ins_fusion.effects.registry import effect_called
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Nav, newest_row
from mems_ins_fusion.filter.runs import changing
from mems_ins_fusion.filter.runs.blending import BLENDING
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.odometry import LINEAR, ORIENTATION, POSE_COVARIANCE, POSITION, SIZE
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.navigation.frames import wrap, yaw_of_quaternion
from mems_ins_fusion.nodes.identity import GNSS, IMU, Identity, differences
from mems_ins_fusion.nodes.state_file import StateFile
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

NAME = 'gnss_time_offset'
#: an analysis counts with the answer to its own chunk
APPLY = table.check({'diagnosis.online': 'apply', 'diagnosis.share': 1.0})


def drive(begin=0.0, end=1.0, minutes=16.0, offset=OFFSET):
    """At 20 Hz, fixes stamped `offset` s late in a part of it."""
    sensors = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    recording = simulate_recording(simulate_drive(60.0 * minutes, seed=5, rate=20.0), sensors,
                                   GnssNoise(0.1, rate=2.0), seed=5).recording
    gnss = recording.gnss
    part = (gnss.stamp - gnss.stamp[0]) / (minutes * 60.0 * SECOND)
    late = np.where((part >= begin) & (part < end), round(offset * SECOND), 0)
    return replace(recording, gnss=replace(gnss, stamp=gnss.stamp + late, received=gnss.received + late), speed=None,
                   velocity=None, heading=None)


@pytest.fixture(scope='module')
def late():
    return drive(minutes=10.0)


def test_an_answer_counts_some_chunks_after_its_own_or_when_it_is_there():
    # given answers that come in time
    answer = [FilterFindings({'a': {'x': k}}, {}) for k in range(3)]
    due, told = AnswerSchedule({}), []
    for k in range(4):
        told.append(due.at_end_of_chunk())
        due.handed()
        due.answered(answer[k // 2])
    # then that of chunk k counts behind chunk k + WAIT, and what is not new is not told
    assert told == [None] * WAIT + [answer[0], None, answer[1]][:4 - WAIT] and due.late == 0
    # one that is late counts at the end of the first chunk after it
    due, told = AnswerSchedule({}), []
    for k in range(6):
        if k == 4:
            due.answered(answer[1])
        told.append(due.at_end_of_chunk())
        due.handed()
    assert told == [None, None, None, None, answer[1], None] and due.late == 6 - WAIT - 1
    # and what a user asks counts at once, also against answers that were given before
    due = AnswerSchedule(answer[1].applied)
    for _ in range(2):
        due.handed()
        due.answered(answer[2])
    due.answered(FilterFindings({}, {}), is_chunk=False)
    assert due.asked() == FilterFindings({}, {}) and due.asked() is None and due.at_end_of_chunk() is None


def test_an_answer_that_does_not_know_what_was_dropped_does_not_bring_it_back():
    # given two findings that drive, of which one is dropped while the answer to a chunk from before is awaited
    both = {'a': {'x': 1}, 'b': {'y': 2}}
    due = AnswerSchedule(both)
    due.handed()
    due.answered(FilterFindings(both, {}, frozenset({'a'})))
    due.dropped('a')
    assert due.unknown_to(0) == {'a'} and due.unknown_to(1) == set()
    # then that answer says nothing new, and the one to the chunk in which it was dropped counts as it is
    assert due.at_end_of_chunk() is None
    due.handed()
    again = FilterFindings({'a': {'x': 3}, 'b': {'y': 2}}, {'c': {'z': 1}}, frozenset({'b'}))
    due.answered(again)
    assert due.at_end_of_chunk() == again


def fed(fusion, recording, first=0, last=None, at=None):
    """Samples from `first` to `last` of a recording and its fixes through a filter, and `at` (index: what to do)."""
    imu, gnss = recording.imu, recording.gnss
    arrival = np.searchsorted(imu.received, gnss.received, side='right')
    for i in range(first, len(imu) if last is None else last):
        if at and i in at:
            at[i]()
        fusion.add_imu(int(imu.stamp[i]), *imu.specific_force[i].tolist(), *imu.angular_rate[i].tolist())
        for k in np.flatnonzero(arrival == i + 1):
            fusion.add_fix(int(gnss.stamp[k]), gnss.latitude[k], gnss.longitude[k], gnss.height[k], gnss.covariance[k],
                           int(gnss.status[k]), int(gnss.covariance_type[k]))


def begun(values, recording, begin, last):
    """A filter with `values` that begins at the sample `begin` where one with APPLY is, fed to `last`."""
    present, own = FusionFilter(FilterConfig.from_parameters(APPLY)), changing.WatchedFilter(
        FilterConfig.from_parameters(values))
    fed(present, recording, 0, begin + 1)
    fed(own, recording, begin, last, {begin + 1: lambda: own.begin_at(present)})
    return own


def test_the_new_filter_takes_over_where_it_does_not_show(late):
    # given a filter that is to go on with another noise from 200 s on
    begin, end = 200 * 20, 420 * 20
    values = {**APPLY, 'accelerometer.noise_density': [0.02] * 3}
    fusion = changing.ChangingFilter(FilterConfig.from_parameters(APPLY))
    arrays, before = (fusion.odometry, fusion.geodetic, fusion.position_covariance_enu), []
    fed(fusion, late, 0, end, {begin: lambda: fusion.change(values), begin + 20: lambda: before.append(fusion.datum)})
    # then one that has it takes over once, after it has settled, by no more than three sigma (1.5 deg of heading),
    handover, = fusion.handovers
    waited = (handover.stamp - late.imu.stamp[begin]) / SECOND
    assert changing.SETTLING <= waited < changing.LONGEST_WAIT and not fusion.changing
    assert handover.position < 0.5 and abs(handover.yaw) < math.radians(4.5)
    # with the bits of a filter that began with the change, where the present one was,
    own = begun(values, late, begin, end)
    own.datum = fusion.datum
    own.update_odometry(), fusion.update_odometry()
    assert np.array_equal(own.odometry, fusion.odometry)
    # and who looks at the estimate looks at the same arrays, in the same local frame
    assert all(a is b for a, b in zip(arrays, (fusion.odometry, fusion.geodetic, fusion.position_covariance_enu)))
    assert np.array_equal(fusion.datum, before[0])
    assert any('goes on with other parameters' in notice.text for notice in fusion.notices())


def test_a_new_start_of_the_other_filter_is_not_told_again_where_it_takes_over(late):
    # given a filter that runs beside the published one and has started anew from refused fixes once
    config = FilterConfig.from_parameters(APPLY)
    fusion, other = changing.ChangingFilter(config), changing.WatchedFilter(config)
    for one in (fusion, other):
        fed(one, late, 0, 100 * 20)
    newest_row(other._memory)[Nav.RECOVERIES] = 1.0
    other._say_new_starts()
    fusion.notices()
    # when it takes over
    fusion._take_over(other, int(late.imu.stamp[100 * 20]), 0.0, 0.0)
    fed(fusion, late, 100 * 20, 105 * 20)
    # then the published filter has not restarted
    assert not any('restart' in notice.text for notice in fusion.notices()) and fusion.state != 'recovering'


def test_a_filter_with_what_is_on_trial_takes_over_as_soon_as_that_is_proven(late):
    # given a filter beside with another noise from 100 s on, which is to drive once it has run for as long as it may
    values, begin, end = {**APPLY, 'accelerometer.noise_density': [0.02] * 3}, 100 * 20, 282 * 20
    last = end + round((BLENDING + 2.0) * 20)
    fusion = changing.ChangingFilter(FilterConfig.from_parameters(APPLY))
    fed(fusion, late, 0, last, {begin: lambda: fusion.prepare([values, {**values, 'imu.adapt_noise': False}]),
                                    begin + 500: lambda: fusion.prepare([values]),
                                    end: lambda: fusion.change(values)})
    # then it does not have to settle first,
    handover, = fusion.handovers
    assert handover.stamp - late.imu.stamp[end] <= 1.1 * SECOND
    # and has the bits of one that began when it was on trial
    own = begun(values, late, begin, last)
    own.datum = fusion.datum
    own.update_odometry(), fusion.update_odometry()
    assert np.array_equal(own.odometry, fusion.odometry)


def test_a_filter_that_the_fixes_show_to_be_better_does_not_wait(late, monkeypatch):
    # given the right offset from 200 s on, and a new filter that never is as sure as the present one
    monkeypatch.setattr(changing, '_as_sure', lambda present, other, times: False)
    begin = 200 * 20
    fusion = changing.ChangingFilter(FilterConfig.from_parameters(APPLY))
    fed(fusion, late, 0, 420 * 20, {begin: lambda: fusion.change({**APPLY, 'gnss.time_offset': OFFSET})})
    # then it takes over as soon as it has settled
    handover, = fusion.handovers
    waited = (handover.stamp - late.imu.stamp[begin]) / SECOND
    assert changing.SETTLING <= waited < changing.SETTLING + 20.0 < changing.LONGEST_WAIT


def test_what_is_published_does_not_jump_where_another_filter_takes_over(late, monkeypatch):
    # given a filter with another arm of the antenna, which takes over metres from the one before
    monkeypatch.setattr(changing, 'LONGEST_WAIT', changing.SETTLING)
    monkeypatch.setattr(changing, 'LOST', math.inf)
    begin, end = 200 * 20, 280 * 20
    exact = {**APPLY, 'gyroscope.scale_sigma': 0.0}  # else a fix moves it by as much
    values = {**exact, 'gnss.lever_arm': [3.0, 0.0, 0.0]}
    fusion, own, present = (made(FilterConfig.from_parameters(with_)) for made, with_ in (
        (changing.ChangingFilter, exact), (changing.WatchedFilter, values), (FusionFilter, exact)))
    published, right, places = [], [], []

    def look(one, rows):
        one.update_odometry()
        rows.append(one.odometry.copy())
        if one is fusion:
            places.append(to_local(*one.geodetic.tolist(), one.datum))
    fed(fusion, late, 0, end, {begin: lambda: fusion.change(values), **{
        i: lambda: look(fusion, published) for i in range(begin + 1, end)}})
    own.datum = fusion.datum
    fed(present, late, 0, begin + 1)
    fed(own, late, begin, end, {begin + 1: lambda: own.begin_at(present),
                                **{i: lambda: look(own, right) for i in range(begin + 1200, end)}})
    handover, = fusion.handovers
    published, right, places = np.array(published), np.array(right), np.array(places)[:, :2]
    at = int(np.searchsorted(late.imu.stamp, handover.stamp)) - begin
    assert handover.position > 1.0
    # then no step from one sample to the next is more than the vehicle moves, its velocity's and what is left of
    # the difference
    step = np.hypot(*np.diff(published[:, :2], axis=0).T)[at - 5:at + 5]
    moved = np.hypot(*published[:-1, LINEAR:LINEAR + 2].T)[at - 5:at + 5] / 20.0
    assert np.all(step - moved < 0.2 * handover.position)
    yaw = np.unwrap(2.0 * np.arctan2(published[:, 5], published[:, 6]))
    assert np.abs(np.diff(yaw))[at - 5:at + 5].max() < math.radians(3.0)
    # the square of how far the new filter's estimate is from the one published is part of the variance published,
    new, old = right[at - 1199:], published[at:]
    apart = np.hypot(*(new - old)[:, :2].T)
    added = (old - new)[:, [POSE_COVARIANCE, POSE_COVARIANCE + 7]].sum(axis=1)
    assert np.allclose(added, apart**2, atol=1e-9) and apart[0] == pytest.approx(handover.position, rel=1e-6)
    # and latitude and longitude are those of the position
    assert np.allclose(places[:, ::-1], published[:, :2], atol=1e-3)
    # until nothing is left, to the bit
    last = round(20 * BLENDING) + 2
    assert np.array_equal(new[last:], old[last:]) and len(old) > last + 20


def test_the_trust_horizon_is_of_what_is_published_where_another_filter_takes_over(late, monkeypatch):
    # given a filter with another arm of the antenna, which takes over metres from the one before
    monkeypatch.setattr(changing, 'LONGEST_WAIT', changing.SETTLING)
    monkeypatch.setattr(changing, 'LOST', math.inf)
    begin, limit, rows = 200 * 20, 1.0, []
    given = table.check({**APPLY, 'gnss.time_offset': OFFSET, 'horizon.limit': limit})
    fusion = changing.ChangingFilter(FilterConfig.from_parameters(given))

    def look():
        fusion.update_odometry()
        p = fusion.odometry[POSE_COVARIANCE:LINEAR].reshape(6, 6)[:2, :2].copy()
        rows.append((fusion.horizon().seconds, p))
    fed(fusion, late, 0, 280 * 20, {begin: lambda: fusion.change({**given, 'gnss.lever_arm': [3.0, 0.0, 0.0]}),
                                    **{i: look for i in range(begin + 1190, 280 * 20)}})
    handover, = fusion.handovers
    assert handover.position > 1.0
    # then it is nothing where the error of the published position is above the limit with more than 5 %,
    rng = np.random.default_rng(1)
    normal = rng.standard_normal((2, 20_000))
    seconds = np.array([row[0] for row in rows])
    larger = np.array([np.mean(np.hypot(*(np.linalg.cholesky(p) @ normal)) > limit) for _, p in rows])
    clear = np.abs(larger - 0.05) > 0.01
    assert np.array_equal(seconds[clear] == 0.0, larger[clear] > 0.05)
    # which is the case while the difference goes over, and not before and after that
    over = np.flatnonzero(larger > 0.05)
    assert 20 < len(over) < 20 * BLENDING and np.all(np.diff(over) == 1) and seconds[0] > 0.0 < seconds[-1]
    # and a difference that is below the limit now makes the time shorter as long as it lasts
    def ahead(seconds):
        return fusion._horizon.predict(fusion._memory, added=(0.0, 0.45 * limit, seconds)).seconds
    assert 0.0 < ahead(BLENDING) < ahead(1.0) == fusion.horizon().seconds


def test_a_filter_that_has_lost_its_way_does_not_take_over(late, monkeypatch):
    # given a new filter that may have run for long enough, and is not as certain as it has to be, or is
    begin, last = 200 * 20, 300 * 20
    monkeypatch.setattr(changing, 'LONGEST_WAIT', 80.0)
    monkeypatch.setattr(changing, 'SHOWN_BETTER', math.inf)
    for lost, takes_over in ((0.1, False), (3.0, True)):
        monkeypatch.setattr(changing, 'LOST', lost)
        monkeypatch.setattr(changing, 'AS_SURE', 0.1)
        fusion, seen = changing.ChangingFilter(FilterConfig.from_parameters(APPLY)), []
        fed(fusion, late, 0, last, {begin: lambda: fusion.change({**APPLY, 'gnss.time_offset': OFFSET}),
                                    last - 1: lambda: seen.append(fusion._next and fusion._next.begun)})
        # then it takes over, or another one begins
        assert bool(fusion.handovers) == takes_over
        assert takes_over or seen[0] == pytest.approx(late.imu.stamp[begin] + 80 * SECOND, abs=2 * SECOND)


def test_a_new_filter_begins_where_the_present_one_is(late):
    # given a vehicle under way, and a mounting that turns the names of its axes by 5 deg
    begin, turn = 200 * 20, math.radians(5.0)
    turned = {**APPLY, 'imu.mounting_rpy': [0.0, 0.0, turn]}
    present = FusionFilter(FilterConfig.from_parameters(APPLY))
    fed(present, late, 0, begin + 1)
    own = begun(turned, late, begin, begin + 1)
    own.begin_at(present)
    # then it is aligned from its first sample on, at the same place, with the heading of its own axes and an honest
    # sigma
    own.datum = present.datum
    own.update_odometry(), present.update_odometry()
    assert own.aligned and np.hypot(*(own.odometry - present.odometry)[:2]) < 1e-3
    yaws = [yaw_of_quaternion(*one.odometry[ORIENTATION:POSE_COVARIANCE]) for one in (own, present)]
    assert wrap(yaws[0] - yaws[1]) == pytest.approx(-turn, abs=1e-6)
    sigma = math.sqrt(own.odometry[POSE_COVARIANCE:LINEAR].reshape(6, 6)[5, 5])  # with that of the mounting
    assert math.radians(10.0) < sigma < math.radians(12.0)


def of_chunks(recording, answers, monkeypatch, kept=(), count=None):
    """The state after each of the first `count` chunks, where the analyses find what `answers` has, one after the
    other."""
    monkeypatch.setattr(online, 'FIRST', 2 * CHUNK)
    monkeypatch.setattr(online, 'LATEST', 4 * CHUNK)
    monkeypatch.setattr(online, 'ANALYSIS', CHUNK)
    asked = iter(answers)
    work = Online({**APPLY, 'diagnosis.window': 300.0}, lambda part, values: next(asked, []), blind, kept)
    return [({q.name: (q.state, q.applied) for q in work.take(chunk)}, work.sets)
            for chunk in list(chunks(recording))[:count]], work


def test_what_is_proven_is_applied_and_the_fixes_are_met(late, monkeypatch):
    said, _ = of_chunks(late, [[finding()]], monkeypatch, count=10)
    first = next(k for k, (_, sets) in enumerate(said) if sets)
    # then it is on trial, then drives, and goes on to be better than the filter without it
    assert said[1][0] == {NAME: (COARSE, False)} and 2 <= first < 8
    assert all(states == {NAME: (FINE, True)} and sets == {'gnss.time_offset': OFFSET} for states, sets in said[first:])
    # and the errors of who drives so are those of the right parameters at the end
    truth = late.reference
    datum = np.array([truth.latitude[0], truth.longitude[0], 0.0])
    north, east, _ = to_local(truth.latitude, truth.longitude, truth.height, datum)

    def error(values, watch=None):
        run = live_output(replace(late, reference=None), values, watch, datum, every=20)
        last = run.stamp > late.imu.stamp[-1] - 120 * SECOND
        t = (run.stamp[last] - truth.stamp[0]) * 1e-9, (truth.stamp - truth.stamp[0]) * 1e-9
        off = run.odometry[last, :2] - np.column_stack([np.interp(*t, east), np.interp(*t, north)])
        return math.sqrt((off**2).sum(axis=1).mean()), run
    answers = iter([[finding()]])
    watch = RecordingWatch(late, {**APPLY, 'diagnosis.window': 300.0}, find=lambda part, values: next(answers, []),
                           look=blind)
    (applied, run), (given, _) = error(APPLY, watch), error({**APPLY, 'gnss.time_offset': OFFSET})
    assert len(run.handovers) == 1 and applied == pytest.approx(given, rel=0.2)
    assert applied < 0.5 * error(APPLY)[0] and not run.dropped


def test_what_is_not_true_any_more_is_taken_back_and_another_value_takes_its_place(monkeypatch):
    # given an offset that goes after six minutes of twelve
    both = drive(end=0.5, minutes=12.0)
    said, work = of_chunks(both, [[finding()]], monkeypatch)
    first = next(k for k, (_, sets) in enumerate(said) if sets)
    gone = next(k for k, (_, sets) in enumerate(said) if k > first and not sets)
    assert 12 <= gone <= 23 and said[gone][0][NAME] == (SUSPECT, False) and not said[-1][1]
    # given one that comes to another value, which an analysis of the last minutes finds: what is left
    gnss = both.gnss
    later = gnss.stamp > gnss.stamp[0] + 360 * SECOND
    both = replace(both, gnss=replace(gnss, stamp=np.where(later, gnss.stamp - round(OFFSET * SECOND), gnss.stamp)))
    left = replace(finding(-2 * OFFSET), changes={'gnss.time_offset': -OFFSET})
    answers = [[finding()], [], [], [], [], [], [left]]
    said, work = of_chunks(both, answers, monkeypatch)
    names = [states for states, _ in said if f'{NAME}{OTHER}' in states]
    assert all(states[NAME] == (SUSPECT, True) for states in names)
    assert said[-1][1] in ({'gnss.time_offset': -OFFSET}, {}) and said[11][1] == {'gnss.time_offset': OFFSET}


def test_what_has_become_wrong_is_dropped_within_a_minute(monkeypatch):
    # given an offset that goes after eight minutes of ten, and was applied before
    recording = drive(end=0.5)
    recording = recording.having({name: samples.select(samples.stamp <= recording.imu.stamp[0] + 600 * SECOND)
                                  for name, samples in recording.streams().items()})
    changed, answers = recording.imu.stamp[0] + 480 * SECOND, iter([[finding()]])
    monkeypatch.setattr(online, 'FIRST', CHUNK)
    watch = RecordingWatch(recording, {**APPLY, 'diagnosis.window': 300.0}, look=blind,
                           find=lambda part, values: next(answers, []))
    run = live_output(replace(recording, reference=None), APPLY, watch, every=20)
    # then the filter that ran on without it takes over within a minute, knows from when on it is right,
    dropped, = run.dropped
    assert dropped.name == NAME and 0.0 < (dropped.stamp - changed) / SECOND < 60.0
    assert abs(dropped.since - changed) / SECOND < 20.0
    assert [handover.stamp for handover in run.handovers][1:] == [dropped.stamp]
    # the diagnosis is told, does not bring it back, and has forgotten the samples from before
    assert not watch.wanted.applied and (NAME, SUSPECT, False) in {(q.name, q.state, q.applied) for q in watch.said}
    assert watch._work._window.imu.stamp[0] >= dropped.since
    # and the bits are those of a filter that never had it
    own = FusionFilter(FilterConfig.from_parameters(APPLY))
    fed(own, recording)
    own.update_odometry()
    assert np.array_equal(own.odometry[POSE_COVARIANCE:], run.odometry[-1][POSE_COVARIANCE:])


def test_what_an_earlier_drive_has_proven_is_suspect_until_it_is_proven_again(late, monkeypatch):
    right = EarlierFinding(NAME, finding().parameters, {'gnss.time_offset': OFFSET})
    said, _ = of_chunks(late, [], monkeypatch, [right], count=10)
    assert said[0] == ({NAME: (SUSPECT, True)}, {'gnss.time_offset': OFFSET})
    assert said[-1] == ({NAME: (FINE, True)}, {'gnss.time_offset': OFFSET})
    # and goes where it is wrong by now
    wrong = EarlierFinding(NAME, finding().parameters, {'gnss.time_offset': -OFFSET})
    said, _ = of_chunks(late, [], monkeypatch, [wrong], count=10)
    assert said[0][1] == {'gnss.time_offset': -OFFSET} and said[-1] == ({NAME: (SUSPECT, False)}, {})


def after_a_look(recording, look, harm):
    """A diagnosis that has looked at a chunk without fixes with an offset that drives. harm: wealth against it."""
    work = Online(APPLY, blind, look, [EarlierFinding(NAME, finding().parameters, {'gnss.time_offset': OFFSET})])
    trial = work.applied[NAME]
    for bets in trial.bets.values():
        bets.con = math.log(harm)
    chunk = next(iter(chunks(recording)))
    work.take(chunk.having({**chunk.streams(), 'gnss': chunk.gnss.select(slice(0, 0))}))
    assert trial.harm == pytest.approx(harm)
    return work


def another_offset(recording, values):
    return [finding(-OFFSET)]


def test_two_turns_take_back_what_the_last_minutes_show_to_be_another(late):
    # given outages that speak against an offset that drives by as much as two turns do of an antenna
    harm = 2.0 * DOUBTED
    assert harm < TAKEN_BACK
    # then it goes where a look at the samples shows another value, and not else
    assert after_a_look(late, blind, harm).sets == {'gnss.time_offset': OFFSET}
    other = after_a_look(late, another_offset, harm)
    assert other.sets == {}
    # and is told as what has been taken back: the other value is what was left beside it
    assert other.trials[NAME].harmful and other.trials[NAME].finding.parameters['time_offset'].value == OFFSET


def test_the_filter_beside_is_told_of_which_finding_another_value_is_on_trial(late):
    # given outages that say nothing against an offset that drives
    assert after_a_look(late, blind, harm=1.0).wanted.doubted == frozenset()
    doubted = after_a_look(late, another_offset, harm=1.0)
    assert doubted.sets == {'gnss.time_offset': OFFSET} and doubted.wanted.doubted == {NAME}
    # and no longer when it is gone
    assert after_a_look(late, another_offset, harm=2.0 * DOUBTED).wanted.doubted == frozenset()


def test_the_filter_beside_takes_over_at_once_where_a_finding_is_taken_back(late, monkeypatch):
    # given fixes that are late, a filter with a finding that they are not, one beside it without, and a diagnosis that
    # takes the finding back after 100 s
    monkeypatch.setattr(changing, 'DROPPED', math.inf)
    begin, last = 100 * 20 + 1, 102 * 20  # nearly a second and two fixes before filters are compared
    right = {**APPLY, 'gnss.time_offset': OFFSET}
    fusion, running = changing.ChangingFilter(FilterConfig.from_parameters(APPLY)), []
    fusion.watch({NAME: right})
    fed(fusion, late, 0, last, {begin: lambda: fusion.change(right),
                                begin + 1: lambda: running.extend(fusion._running)})
    # then that one goes on, which has run for long and gets each sample once, with the bits of a filter that never had
    # the finding
    assert len(running) == 1
    handover, = fusion.handovers
    assert handover.stamp - late.imu.stamp[begin] <= 1.1 * SECOND and not fusion._running
    own = FusionFilter(FilterConfig.from_parameters(right))
    fed(own, late, 0, last)
    assert np.array_equal(newest_row(own._memory), newest_row(fusion._memory))


TOPICS = {'imu_topic': '/imu/data', 'gnss_topic': '/fix'}
HERE = {'stamp': 1_000 * SECOND, 'latitude': 0.84, 'longitude': 0.2, 'height': 480.0, 'yaw': 1.2}


def test_the_state_file_keeps_it_for_the_same_sensors(tmp_path):
    path = tmp_path / 'state.json'
    kept = [EarlierFinding(NAME, finding().parameters, {'gnss.time_offset': OFFSET}, HERE['stamp'] - 5)]
    file = StateFile(path, 1.0, 1.0)
    assert file.write(HERE, kept, TOPICS) is None
    assert file.write(HERE, [EarlierFinding('x', {}, {'gnss.time_offset': 0.1})],
                      {**TOPICS, 'gnss_topic': '/other'}) is None
    again = StateFile(path, 1.0, 1.0)
    assert again.read() is None
    found, said = again.calibration(TOPICS)
    assert found == kept and 'gnss_time_offset of an earlier drive' in said[0]
    # who does not know what is applied leaves it there; who knows that nothing is takes it out
    assert again.write(HERE) is None and StateFile.read(again) is None and again.calibration(TOPICS)[0] == kept
    assert again.write(HERE, [], TOPICS) is None and not again.calibration(TOPICS)[0]
    # and one that is damaged is named
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, 'calibration': [{'name': 'x', 'set': {'gnss.time_offset': 'soon'}}]}))
    assert 'cannot be used' in StateFile(path, 1.0, 1.0).read()


def test_another_device_is_told_from_what_its_messages_say():
    # given an IMU of 100 Hz and a receiver of 4 Hz, from the first message of the receiver on with another frame
    def known(rate, frame):
        identity = Identity((IMU, GNSS))
        for k in range(round(8 * rate)):
            identity.add(IMU, round(k / rate * SECOND), {'frame_id': 'imu'})
        assert identity.known is None and identity.is_unknown(GNSS) and not identity.is_unknown(IMU)
        identity.add(GNSS, -90 * SECOND, {'frame_id': frame, 'service': 1})  # before its clock was set
        for k in range(24):
            identity.add(GNSS, k * SECOND // 4, {'frame_id': frame if k else '', 'service': 1})
        return identity.known
    before = known(100.0, 'antenna')
    assert before[IMU] == {'frame_id': 'imu', 'rate': pytest.approx(100.0)}
    assert before[GNSS] == {'frame_id': 'antenna', 'service': 1, 'rate': pytest.approx(4.0)}
    # then a driver that leaves out a tenth is the same device, and another rate or frame is not
    assert differences(before, known(110.0, 'antenna')) == []
    assert differences(before, known(200.0, 'antenna')) == ['imu: rate 200 (before: 100)']
    assert differences(before, known(100.0, 'gps')) == ["gnss: frame_id 'gps' (before: 'antenna')"]
    # nor does a file speak against it that does not know
    assert differences({}, before) == [] and differences({IMU: {'rate': 100.0}}, before) == []


def test_the_state_file_keeps_which_devices_it_was_found_on(tmp_path):
    path, devices = tmp_path / 'state.json', {IMU: {'frame_id': 'imu', 'rate': 100.0}}
    kept = [EarlierFinding(NAME, finding().parameters, {'gnss.time_offset': OFFSET})]
    assert StateFile(path, 1.0, 1.0).write(HERE, kept, TOPICS, devices) is None
    again = StateFile(path, 1.0, 1.0)
    assert again.read() is None
    assert again.devices(TOPICS) == devices and again.devices({**TOPICS, 'imu_topic': '/other'}) == {}
    content = json.loads(path.read_text())
    content['calibration'][0]['devices'] = {IMU: 'x'}
    path.write_text(json.dumps(content))
    assert 'cannot be used' in StateFile(path, 1.0, 1.0).read()


def test_what_is_kept_is_less_sure_the_longer_nobody_has_seen_it(late, monkeypatch):
    # given an offset of +- 0.02 s that was proven a month before this drive, and one of ten years ago
    begin, day = int(late.imu.stamp[0]), 86_400 * SECOND
    month, years = (EarlierFinding(NAME, finding().parameters, {'gnss.time_offset': OFFSET}, begin - age * day)
                    for age in (30, 3650))
    # then the variance has grown by a twelfth of what would surprise nobody in a year (0.1 s), and by no more than that
    usual = next(one for one in effect_called(NAME).parameters if one.name == 'time_offset').prior_scale
    assert month.aged(begin)['time_offset'].sigma == pytest.approx(math.hypot(0.02, usual * math.sqrt(30 / 365.25)))
    assert years.aged(begin)['time_offset'].sigma == pytest.approx(math.hypot(0.02, usual))
    assert month.aged(begin - 60 * day) == month.parameters  # of a recording from before
    # it is said so, and what is kept for the next start is as it was found, as often as the node starts
    work = Online(APPLY, blind, blind, [month])
    told, = work.take(next(chunks(late)))
    assert told.state == SUSPECT and told.parameters == month.aged(begin) and told.kept == month
    # until this drive proves it: then it is as new
    said, work = of_chunks(late, [], monkeypatch, [month], count=10)
    assert said[-1][0] == {NAME: (FINE, True)}
    again = work.applied[NAME].kept
    assert again.parameters == month.parameters and begin < again.found <= late.imu.stamp[-1]


def test_a_user_may_accept_and_reject():
    # given a finding on trial, and one that has been shown to do harm
    work = Online(table.check({'diagnosis.online': 'report'}), blind, blind)
    work.trials = {NAME: Trial(finding(), {'gnss.time_offset': OFFSET}, 100.0), 'x': Trial(finding(), {'a': 1}, 100.0)}
    for bets in work.trials['x'].bets.values():
        bets.con = 10.0
    # then the first is applied and not proven, until it is rejected, and the other one has a trial beside it
    assert work.trials['x'].state == SUSPECT
    told = {q.name: (q.state, q.applied) for q in work.accept()}
    assert told == {NAME: (SUSPECT, True), 'x': (COARSE, False)} and work.sets == {'gnss.time_offset': OFFSET}
    assert not work.reject() and work.sets == {}


def test_the_node_begins_with_what_is_kept_and_does_what_a_user_asks(tmp_path, peer, late):
    # given a node with what an earlier drive has proven of its sensors
    path, topics = tmp_path / 'state.json', {**TOPICS, 'gnss_topic': '/gps/fix'}
    assert StateFile(path, 1.0, 1.0).write(HERE,
                                           [EarlierFinding(NAME, finding().parameters, {'gnss.time_offset': OFFSET})],
                                           topics) is None
    with NodeProcess('fusion_node', *PLAYABLE, '-p', 'diagnosis.online:=apply', '-p', f'state_file:={path}') as node:
        node.wait_for(f'gnss_time_offset of an earlier drive: gnss.time_offset: {OFFSET}')
        node.wait_until_ready()

        def asked(word):
            return call(peer, Trigger, f'/fusion_node/calibration/{word}', Trigger.Request())
        # then it is told before there is a sample, and goes when the user says so
        peer.spin_until(lambda: f'{NAME} SUSPECT' in asked('report').message)
        assert asked('accept').success
        assert asked('reject').success
        peer.spin_until(lambda: asked('report').message == 'nothing known yet')
        peer.connect(node, late)  # by the first sample
        assert any('the filter will use gnss.time_offset: 0.0 (before: 0.4)' in line for line in node.lines)


def test_what_an_analysis_finds_beside_an_applied_value_is_what_is_left():
    # given the same finding on trial, and applied
    one, other = Trial(finding(0.4), {}, 1.0), Trial(finding(0.4), {}, 1.0)
    other.apply(0)
    # then 0.4 again is the same of the one, and as much more of the other; nothing left is nothing new
    assert not one.differs(finding(0.41)) and other.differs(finding(0.41))
    assert one.differs(finding(0.01)) and not other.differs(finding(0.01))
    # and what neither has yet, as the place of the antenna to the left after a turn, is new beside what is applied
    # where it is certain; what is on trial takes it over
    for value, is_new in ((0.8, True), (0.1, False)):
        more = finding(0.4)
        more.parameters['y'] = Estimate(value, 0.1, 'm')
        assert one.is_refined_by(more) and not one.differs(more)
        more = replace(more, parameters={'y': Estimate(value, 0.1, 'm')})
        assert other.differs(more) == is_new and not one.is_refined_by(more)


def test_what_is_on_trial_goes_on_with_a_better_value():
    # given a finding on trial of samples from the stamp 100 on, with half of the wealth that it needs
    one = Trial(replace(finding(0.4, 0.02), since=100), {}, 1e3, taken=1)
    for bets in one.bets.values():
        bets.pro = math.log(500.0)
    # then a value that agrees refines it where it is better known, and not from samples of before: these may be of
    # before a change
    better = replace(finding(0.43, 0.01), since=200)
    for other, refines in ((better, True), (replace(better, since=99), False), (finding(0.43, 0.018), False)):
        assert one.is_refined_by(other) == refines and not one.differs(other)
    # nor where another parameter is less well known than before
    known = replace(better, parameters={**better.parameters, 'y': Estimate(1.0, 0.1, 'm')})
    vague = replace(better, parameters={'time_offset': Estimate(0.43, 0.03, 's'), 'y': Estimate(1.0, 0.1, 'm')})
    assert one.is_refined_by(known) and not one.is_refined_by(vague)
    # and it keeps its wealth and its begin
    one.refine(known)
    assert one.wealth == pytest.approx(500.5) and one.sets == known.changes and one.finding.since == 100
    assert one.finding.parameters == known.parameters


def test_trials_begin_anew_when_what_they_are_compared_with_changes():
    work = Online(APPLY, blind, blind)
    proven, rest = Trial(finding(), {'gnss.time_offset': OFFSET}, 1.0), Trial(finding(), {}, 1e9)
    proven.proven = True
    for trial in (proven, rest):
        trial.take({duration: [((2.0, 0.0), (1.0, 0.0))] * 2 for duration in OUTAGES})
    work.trials = {NAME: proven, 'other': rest}
    work._decide()
    assert work.sets == {'gnss.time_offset': OFFSET} and list(work.trials) == ['other']
    assert rest.wealth == rest.harm == 1.0 and not any(rest.errors.values()) and proven.wealth > 1.0


def test_what_is_proven_with_something_else_has_to_be_proven_beside_it():
    # given two findings that the same outages have proven, as an arm of the antenna and a time offset at one speed
    work = Online(APPLY, blind, blind)
    work.trials = {name: Trial(finding(), {parameter: OFFSET}, **work._false_alarms.next()) for name, parameter in (
        (NAME, 'gnss.time_offset'), ('other', 'other'))}
    for trial in work.trials.values():
        trial.take({duration: [((2.0, 0.0), (1.0, 0.0))] * 200 for duration in OUTAGES})
        assert trial.state == FINE
    # then one of them is applied, and the other one is not before outages beside the first have proven it, as the
    # second trial that it is: what it had won is given away
    for _ in range(3):
        work._decide()
    other = work.trials['other']
    assert list(work.applied) == [NAME] and other.state == COARSE and other.wealth == 1.0
    assert other.needed == pytest.approx((2 * math.pi) ** 2 / (6 * FALSE_ALARMS))
    # and what drives stays proven where the other one follows
    other.take({duration: [((2.0, 0.0), (1.0, 0.0))] * 200 for duration in OUTAGES})
    work._decide()
    assert [trial.state for trial in work.applied.values()] == [FINE, FINE] and work.begun == 2


@pytest.mark.parametrize('applied, looks', [(False, [0, 1, 1, 2, 2]), (True, [1, 2, 3, 4, 5])])
def test_what_is_applied_is_looked_at_with_each_chunk(late, monkeypatch, applied, looks):
    # given what is applied, or nothing, later than there is a look with each chunk
    monkeypatch.setattr(online, 'LATEST', 0.5 * CHUNK)
    count, seen = [], []
    work = Online(APPLY, blind, lambda part, values: count.append(1) or [],
                  [EarlierFinding(NAME, finding().parameters, {'gnss.time_offset': OFFSET}, 0)] if applied else ())
    for chunk in list(chunks(replace(late, gnss=late.gnss.select(slice(0, 0)))))[1:6]:
        work.take(chunk)
        seen.append(len(count))
    # then a look that shows another value does not wait for its turn
    assert seen == looks


def test_what_a_trial_has_lost_has_to_be_won_again_where_it_begins_anew():
    # given a trial on which outages have cost nearly half of the wealth that it began with
    one = Trial(finding(), {}, 100.0)
    for _ in range(20):
        one.take({duration: [((1.0, 0.0), (2.0, 0.0))] * 9 for duration in OUTAGES})
    left = one.wealth
    assert left < 0.6
    # then its mean does not grow by a new begin: 1 of as much more is as improbable as before
    one.begin_anew()
    assert one.wealth == 1.0 and one.needed == pytest.approx(100.0 / left)


def test_a_mounting_that_the_filter_estimates_changes_nothing_that_trials_compare():
    # given a mounting that is proven, and an offset on trial
    def left(values):
        work = Online(values, blind, blind)
        turned = replace(finding(), name='mounting_rotation', changes={'imu.mounting_rpy': [0.0, 0.0, 0.1]})
        work.trials = {one.name: Trial(one, one.changes, 1e3) for one in (turned, finding())}
        work.trials['mounting_rotation'].proven = True
        work.trials[NAME].take({duration: [((2.0, 0.0), (1.0, 0.0))] * 3 for duration in OUTAGES})
        work._decide()
        assert list(work.applied) == ['mounting_rotation']
        return work.trials[NAME]
    # then what outages have shown of the offset holds where the filter estimates pitch and yaw itself, and only there
    assert left(APPLY).wealth > 1.0 and left(APPLY).needed == 1e3
    assert left({**APPLY, 'imu.mounting_sigma': 0.0}).wealth == 1.0


def test_what_was_dropped_may_come_back():
    # given an offset that was dropped, and one that has lost on trial, which a look finds again
    work = Online(APPLY, blind, lambda recording, values: [finding()])
    for trial, again in ((Trial(finding(), {}, 1e3, harmful=True), True), (Trial(finding(), {}, 1.0), False)):
        assert trial.rejected
        work.trials = {NAME: trial}
        work._put_on_trial(finding(), latest=True, again=False)
        # then the first is on trial once more, as the driver may have restarted once more
        assert (work.trials[NAME] is not trial) == again


def test_no_filter_runs_beside_without_what_each_filter_estimates_itself():
    # given a mounting and a time offset that are applied: two filters that estimate the first meet the fixes alike, but
    # for how long either has run
    applied = {'mounting_rotation': {'imu.mounting_rpy': [0.0, 0.0, 0.1]}, NAME: {'gnss.time_offset': OFFSET}}
    _, without = with_applied(APPLY, applied)
    assert list(without) == [NAME]
    # unless they take it as it is given
    _, without = with_applied({**APPLY, 'imu.mounting_sigma': 0.0}, applied)
    assert set(without) == set(applied)


def test_filters_that_have_just_begun_drop_nothing():
    # given a filter without a finding that starts with the one with it, as after kill -9 on the way, and is nearer to
    # two fixes a second by a metre
    def seconds_until_better(settling):
        one = changing.ParallelFilter(SimpleNamespace(aligned=True, misfits={}), 0, 0, settling)
        for second in range(200):
            numbers = range(2 * second + 1, 2 * second + 3)
            one.fusion.misfits.update(dict.fromkeys(numbers, (0.1, 0.0)))
            one.compare(dict.fromkeys(numbers, (1.1, 0.0)), second * SECOND)
            if one.is_better(changing.DROPPED):
                return second
    # then it takes over only after both have settled, in the same time from there on
    assert seconds_until_better(changing.SETTLING) == seconds_until_better(0.0) + changing.SETTLING < 120
    # and so does the one beside a filter that begins with a kept value, but not one that begins later
    fusion = changing.ChangingFilter(FilterConfig.from_parameters({**APPLY, 'gnss.time_offset': OFFSET}))
    fusion.watch({NAME: APPLY})
    assert fusion._beside[NAME]._settling == changing.SETTLING and fusion._beside_with(APPLY)._settling == 0.0


def test_a_present_filter_without_a_heading_is_not_waited_for(late):
    # given an IMU declared the wrong way round, with which the filter does not start, and the right mounting from 100 s
    # on, with the vehicle under way
    backwards = {**APPLY, 'imu.mounting_rpy': [0.0, 0.0, math.pi]}
    fusion, begin = changing.ChangingFilter(FilterConfig.from_parameters(backwards)), 100 * 20
    fed(fusion, late, 0, begin)
    assert fusion.has_estimate and not fusion.aligned
    fusion.change(APPLY)
    fed(fusion, late, begin, begin + round(0.5 * changing.SETTLING) * 20)
    # then the filter with it takes over as soon as it has a heading, and not after SETTLING
    assert fusion.aligned and not fusion.changing


def test_what_an_estimate_without_a_filter_doubts_is_dropped_by_less(late):
    # given a finding that drives, and fixes that speak against it as much as one turn does against a wrong antenna
    def dropped(doubted):
        fusion = changing.ChangingFilter(FilterConfig.from_parameters({**APPLY, 'gnss.time_offset': OFFSET}))
        fusion.watch({NAME: APPLY})
        fed(fusion, late, 0, 100 * 20)
        one = fusion._beside[NAME]
        one._compared, one._bets.pro = fusion._fixes, math.log(2.0 * changing.SHOWN_BETTER)
        apply_findings(fusion, APPLY, FilterFindings({NAME: {'gnss.time_offset': OFFSET}}, {}, frozenset(doubted)),
                       changes=False)
        fusion._compare(fusion._now)
        return [one.name for one in fusion.dropped()]
    # then it is dropped at once where the last minutes show another value, and not else
    assert dropped({NAME}) == [NAME] and dropped({'gnss_lever_arm'}) == []


def test_where_the_fixes_speak_against_a_finding_the_estimate_goes_over_before_it_is_dropped(late):
    # given a filter with a wrong arm of the antenna, and one without it beside it, which stand apart
    def published(wealth):
        fusion = changing.ChangingFilter(FilterConfig.from_parameters({
            **APPLY, 'gnss.time_offset': OFFSET, 'gnss.lever_arm': [3.0, 0.0, 0.0], 'gnss.lever_arm_sigma': 0.0}))
        fusion.watch({NAME: {**APPLY, 'gnss.time_offset': OFFSET}})
        one, rows = fusion._beside[NAME], []
        one._bets.take = lambda present, other: None
        fed(fusion, late, 0, 120 * 20)

        def look():
            fusion.update_odometry()
            one.fusion.update_odometry()
            rows.append((fusion.odometry.copy(), one.fusion.odometry.copy()))
        # when it wins so much in a second
        one._bets.take = lambda present, other: setattr(one._bets, 'pro', math.log(wealth))
        begin = 120 * 20
        fed(fusion, late, begin, begin + 3 * 20, {i: look for i in range(begin, begin + 3 * 20)})
        told = [notice.text for notice in fusion.notices() if NAME in notice.text]
        return np.array([row[0] for row in rows]), np.array([row[1] for row in rows]), told, fusion
    p = slice(POSITION, POSITION + 2)
    alone, without, told, _ = published(1.0)
    assert not told
    apart = np.linalg.norm(without[-1, p] - alone[-1, p])
    assert apart > 2.0
    # then nothing changes as long as it is as likely that the finding is right
    assert np.array_equal(published(changing.SHOWN_BETTER)[0], alone)
    # and with ten times that the estimate goes over by nine tenths within a second, without a jump, and it is said
    moved, _, told, fusion = published(10.0 * changing.SHOWN_BETTER)
    part = np.linalg.norm(moved[:, p] - alone[:, p], axis=1) / np.linalg.norm(without[:, p] - alone[:, p], axis=1)
    assert part[0] == 0.0 and np.max(np.diff(part)) < 0.06 and part[-1] == pytest.approx(0.9, abs=1e-3)
    assert len(told) == 1 and 'without it' in told[0]
    # with a covariance that covers the estimates of both, and so does the trust horizon
    for other in (alone, without):
        d = moved[-1, p] - other[-1, p]
        assert d @ np.linalg.solve(moved[-1, POSE_COVARIANCE:LINEAR].reshape(6, 6)[:2, :2], d) < 1.3
    assert fusion.horizon().seconds < FusionFilter.horizon(fusion).seconds
    # and where the diagnosis takes the finding back the estimate does not jump either
    before = moved[-1, p]
    fusion.change(fusion._beside[NAME].fusion.config.parameters)
    fusion.update_odometry()
    assert np.linalg.norm(fusion.odometry[p] - before) < 0.06 * apart + 1.0


ARM = {'x': 1.2, 'y': -0.8}
JUMP = 200  # s after the begin


def jumping(after):
    """At 20 Hz, an antenna at ARM whose fixes jump at JUMP, while the vehicle drives, to where they are with the arm
    `after`."""
    sensors = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    motion = simulate_drive(JUMP + 30.0, seed=5, rate=20.0)
    first, second = (simulate_recording(motion, sensors, GnssNoise(0.02), seed=5,
                                        effects=[(effect_called('gnss_lever_arm'), one)]).recording
                     for one in (ARM, after))
    gnss, other = first.gnss, second.gnss
    jumped = gnss.stamp >= first.imu.stamp[0] + JUMP * SECOND
    return replace(first, gnss=replace(gnss, **{name: np.where(jumped, getattr(other, name), getattr(gnss, name))
                                                for name in ('latitude', 'longitude', 'height')}))


def with_the_arm(recording):
    """A filter with ARM, and one without it beside it, fed up to the jump."""
    fusion = changing.ChangingFilter(FilterConfig.from_parameters({**APPLY, 'gnss.lever_arm': [1.2, -0.8, 0.0]}))
    fusion.watch({'gnss_lever_arm': APPLY})
    fed(fusion, recording, 0, JUMP * 20)
    return fusion


def distance_from_truth(fusion, truth):
    fusion.update_odometry()
    k = np.searchsorted(truth.stamp, fusion._now)
    return math.hypot(*to_local(*fusion.geodetic, (truth.latitude[k], truth.longitude[k], truth.height[k]))[:2])


@pytest.mark.parametrize('goes_to', ['where it is without it', 'beyond'])
def test_a_jump_of_the_fixes_to_where_they_are_without_a_finding_shows_that_it_has_gone(goes_to):
    # given an arm of the antenna that is right, and fixes that jump while the vehicle drives
    after = {} if goes_to == 'where it is without it' else {name: -3.0 * value for name, value in ARM.items()}
    recording = jumping(after)
    fusion = with_the_arm(recording)
    assert not fusion._suspected
    # when a few of them have come
    fed(fusion, recording, JUMP * 20, (JUMP + 6) * 20)
    # then a filter goes on from there without it, and the published estimate with that one,
    if not after:
        assert fusion._suspected == 'gnss_lever_arm' and distance_from_truth(fusion, recording.reference) < 0.4
    # but not where they jump beyond, although they are nearer to where they are without it all the same
    else:
        assert not fusion._suspected and not fusion._branches


def test_a_doubted_finding_is_dropped_to_the_filter_that_goes_on_from_the_jump():
    # given an arm of the antenna that was right, another value of which is on trial, and fixes that jump to where they
    # are without it: the filter without it that has run all the time is as far off then as the one with it
    recording = jumping({})
    fusion = with_the_arm(recording)
    fusion.doubt(frozenset({'gnss_lever_arm'}))
    fusions, second = {}, JUMP
    while 'gnss_lever_arm' in fusion._beside and second < JUMP + 10:
        fusions = {name: some['gnss_lever_arm'] for name, some in (
            ('beside', fusion._beside), ('branch', fusion._branches)) if some}
        fed(fusion, recording, second * 20, (second + 1) * 20)
        second += 1
    # then the one takes over that the fixes have shown to be better,
    assert [one.name for one in fusion.dropped()] == ['gnss_lever_arm']
    branch = fusions['branch']
    assert fusion._memory is branch.fusion._memory and branch.is_better(changing.SHOWN_BETTER)
    assert not fusions['beside'].is_better(changing.SHOWN_BETTER)
    # and the estimate is right when it has gone over
    fed(fusion, recording, second * 20, (second + round(BLENDING)) * 20)
    assert distance_from_truth(fusion, recording.reference) < 0.3


def test_one_second_after_a_jump_drops_nothing_whatever_is_doubted():
    # given the filter without a finding that has run all the time, and a branch
    beside = changing.ParallelFilter(SimpleNamespace(aligned=True, misfits={}), 0, 0)

    def meets(one, number, own, present):
        one.fusion.misfits[number] = (own, 0.0)
        one.compare({number: (present, 0.0)}, number * SECOND)
    for number in range(1, 30):
        meets(beside, number, 0.1, 0.1)
    branch = changing.ParallelFilter(SimpleNamespace(aligned=True, misfits={}), 30 * SECOND, 30, branch_of=beside)
    # when the fixes of one second are where it predicts them, which by chance they are one time in SHOWN_BETTER
    meets(branch, 31, 0.1, 1.4)
    # then that is not enough, nor is a second in which both predict the same, but a bet that it wins is
    assert not branch.is_refuted and not branch.is_better(changing.SHOWN_BETTER)
    meets(branch, 32, 0.1, 0.1)
    assert not branch.is_refuted and not branch.is_better(changing.SHOWN_BETTER)
    meets(branch, 33, 0.1, 1.4)
    assert branch.is_better(changing.SHOWN_BETTER)


def test_the_covariance_covers_both_estimates_whatever_the_weight(late, monkeypatch):
    # given a filter with a wrong arm of the antenna, and one without it beside it, which stand apart
    right = {**APPLY, 'gnss.time_offset': OFFSET}
    fusion = changing.ChangingFilter(FilterConfig.from_parameters({
        **right, 'gnss.lever_arm': [3.0, 0.0, 0.0], 'gnss.lever_arm_sigma': 0.0}))
    fusion.watch({NAME: right})
    one, end = fusion._beside[NAME], 120 * 20
    one._bets.take = lambda present, other: None
    fed(fusion, late, 0, end)
    p = slice(POSITION, POSITION + 2)
    for weight in (0.1, 0.3, 0.9):
        # when it has this weight in the published estimate
        wealth = changing.SHOWN_BETTER / (1.0 - weight)
        one._bets.take = lambda present, other, wealth=wealth: setattr(one._bets, 'pro', math.log(wealth))
        fed(fusion, late, end, end + 3 * 20)
        end += 3 * 20
        FusionFilter.update_odometry(fusion)
        own = fusion.odometry.copy()
        fusion.update_odometry()
        one.fusion.update_odometry()
        published, other = fusion.odometry, one.fusion.odometry
        assert np.linalg.norm(other[p] - own[p]) > 2.0
        assert published[p] == pytest.approx(own[p] + weight * (other[p] - own[p]), abs=1e-6)
        # then both positions are within one sigma, of pose, fused fix and trust horizon
        covariance = published[POSE_COVARIANCE:LINEAR].reshape(6, 6)[:2, :2]
        for apart in (own[p] - published[p], other[p] - published[p]):
            for covers in (covariance, fusion.position_covariance_enu.reshape(3, 3)[:2, :2]):
                assert apart @ np.linalg.solve(covers, apart) < 1.0
        assert math.hypot(*fusion._further) == pytest.approx(
            max(weight, 1.0 - weight) * np.linalg.norm(other[p] - own[p]), rel=1e-6)
    # and what is to take over has to be as certain as the filter itself, which that does not make less certain
    compared = []
    monkeypatch.setattr(changing, '_as_sure', lambda present, *_: compared.append(present.copy()))
    fusion._next = one
    fusion._follow_up(fusion._now)
    assert np.array_equal(compared[0], own) and not np.array_equal(own, published)


def test_it_is_said_once_where_the_estimate_moves_to_another_filter_and_where_it_is_back():
    # given two findings that are applied, and a filter without each
    fusion = changing.ChangingFilter(FilterConfig.from_parameters(APPLY))
    fusion.watch({'one': APPLY, 'two': APPLY})

    def said(**weights):
        for name, one in fusion._beside.items():
            one.weight = lambda stamp, name=name: weights.get(name, 0.0)
        fusion._compare(0)
        return [(notice.level, notice.text.split(':')[0]) for notice in fusion.notices()]
    # then it is told of the one without which the fixes are met best, once,
    assert said() == []
    assert said(one=0.5, two=0.1) == [('warning', 'one')] and said(one=0.6, two=0.3) == []
    assert said(one=0.6, two=0.7) == [('warning', 'two')]
    # and so is the way back,
    assert said() == [('info', 'two')] and said() == []
    # but not where the finding is not applied any more
    assert said(one=0.5) == [('warning', 'one')]
    del fusion._beside['one']
    assert said() == []


def test_a_filter_that_is_less_sure_does_not_take_over():
    # given two odometries with the sigmas of a filter that has just begun, and one that drives: m and rad
    def odometry(position, yaw):
        out = np.zeros(SIZE)
        out[POSE_COVARIANCE:LINEAR] = np.diag([position**2, position**2, 1.0, 1.0, 1.0, yaw**2]).ravel()
        return out
    present = odometry(0.5, 0.01)
    assert changing._as_sure(present, odometry(0.6, 0.012), 1.25)
    assert not any(changing._as_sure(present, other, 1.25) for other in (odometry(0.5, 0.02), odometry(1.0, 0.01)))
