"""The diagnosis while driving: bets that chance does not win, the same chunks live as replayed, and over real ROS 2."""
from __future__ import annotations

import io
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import PATIENCE, PLAYABLE, REPOSITORY, Diagnostics, NodeProcess, Player, stamp_of

from mems_ins_fusion.diagnosis import false_alarms, online, trial_outages, worker
from mems_ins_fusion.diagnosis.advice import Advice
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.false_alarms import FALSE_ALARMS
from mems_ins_fusion.diagnosis.findings import Finding
from mems_ins_fusion.diagnosis.gathering import CHUNK, Gathering, chunks
from mems_ins_fusion.diagnosis.held_out import HeldOut
from mems_ins_fusion.diagnosis.online import Analysis, Online
from mems_ins_fusion.diagnosis.quantity import ALL, COARSE, FINE, INITIALISING, NOTHING, SUSPECT
from mems_ins_fusion.diagnosis.trial import Trial
from mems_ins_fusion.diagnosis.trial_outages import OUTAGES
from mems_ins_fusion.filter.runs import betting
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_drive,
    simulate_recording,
)

SECOND = 10**9
OFFSET, NAME = 0.4, 'gnss_time_offset'


def blind(recording, values):
    """An analysis, or a look, that finds nothing."""
    return []


def finding(value=OFFSET, sigma=0.02):
    """A time offset as `diagnose` has it."""
    return Finding('gnss_time_offset', ['gnss_time_offset'], {'time_offset': Estimate(value, sigma, 's')}, 50.0, 1e-9,
                   True, HeldOut(20.0, 1e-6, []), changes={'gnss.time_offset': value})


def trial(needed=1.0 / FALSE_ALARMS):
    return Trial(finding(), {}, needed)


def taken(present, other, needed=1.0 / FALSE_ALARMS):
    """A trial after outages, of each duration, at whose end two filters are so far from the fixes (k, 2), m."""
    one = trial(needed)
    for pair in zip(present.tolist(), other.tolist()):
        one.take({duration: [pair] for duration in OUTAGES})
        if one.proven:
            break
    return one


def test_chance_does_not_prove():
    # given 60 trials of two filters that are equally good, 200 outages each: errors that come and go in size, with
    # heavy tails and outliers, of predictions whose difference has nothing to do with them
    rng = np.random.default_rng(7)
    proven = 0
    for _ in range(60):
        size = np.exp(rng.standard_normal((200, 1)))
        middle = rng.standard_t(2, (200, 2)) * size
        apart = rng.standard_normal((200, 2)) * rng.exponential(1.0, (200, 1))
        proven += taken(middle + 0.5 * apart, middle - 0.5 * apart, needed=10.0).proven
    # then not more of them have ever proven ten to one than may have (10 % of 60 is 6: twelve or more have p = 0.01)
    assert proven < 12


def test_in_a_block_the_outages_count_in_which_the_predictions_are_apart():
    # given errors of 1 m that last for five measurements, and predictions that are 4 m apart in one of nine, as in a
    # turn, and else 2 cm; the other one is right
    wealth = []
    for seed in range(6):
        rng, bets, error = np.random.default_rng(seed), betting.Bets(0.0, 30), 0.0
        for k in range(600):
            error = 0.8 * error + 0.6 * rng.standard_normal()
            bets.take((error + (0.02 if k % 9 else 4.0), 0.0), (error, 0.0))
        wealth.append(bets.pro)
    # then it is proven each time (a block of equal weights proves it in none)
    assert min(wealth) > math.log(1.0 / FALSE_ALARMS)


def test_a_small_advantage_is_not_worth_a_change():
    # given a thousand outages after which the fixes are 4 % of the way beyond the middle, and 30 %
    rng = np.random.default_rng(3)
    apart, noise = np.array([[1.0, 0.0]]), 0.02 * rng.standard_normal((1000, 2))
    assert not taken(noise + 0.54 * apart, noise - 0.46 * apart).proven
    assert taken(noise + 0.8 * apart, noise - 0.2 * apart).proven


def test_what_predicts_the_next_fix_better_and_half_a_minute_worse_is_not_proven():
    # given 100 outages of each duration, of which those of 30 s are worse with the finding
    one = trial()
    for _ in range(100):
        better, worse = ((1.0, 0.0), (0.2, 0.0)), ((0.2, 0.0), (1.0, 0.0))
        one.take({duration: [worse if duration == max(OUTAGES) else better] for duration in OUTAGES})
    assert one.wealth > one.needed and one.doubted and not one.proven
    # then without those it is
    one = trial()
    for _ in range(100):
        one.take({duration: [] if duration == max(OUTAGES) else [better] for duration in OUTAGES})
    assert one.proven


def test_what_a_finding_loses_in_some_minutes_need_not_all_be_won_again():
    # given five minutes with an outage each that is worse with a finding, and one with twenty that are better, all of
    # which are bet on
    worse, better = ((0.2, 0.0), (1.0, 0.0)), ((1.0, 0.0), (0.2, 0.0))
    one = trial()
    for (_, clear), bets in one.bets.items():
        bets.__init__(clear)
        bets.pro = -math.inf
    assert one.wealth == 1.0
    for pairs in (*[[worse]] * 5, [better] * 20):
        one.take({duration: pairs for duration in OUTAGES})
        assert not one.rejected
    # then it is proven by what was kept for the sixth, 1 / 42, which each outage multiplies by 1.9 at most,
    assert one.proven and one.wealth < 1.2 * 1.9**20 / 42.0
    assert math.log(42.0 / FALSE_ALARMS) < 20 * math.log(1.9) < 5 * math.log(10.0) + math.log(1.0 / FALSE_ALARMS)
    # and wealth is not made by waiting
    one = trial()
    for _ in range(50):
        one.take({duration: [] for duration in OUTAGES})
    assert one.wealth == pytest.approx(1.0)


def test_what_is_better_is_proven_and_what_is_worse_rejected():
    # given a filter that is right and one that is off by 1 m, and fixes with a noise of 1 m on each axis, nine times
    counts = []
    for seed in range(1, 10):
        noise = np.random.default_rng(seed).standard_normal((300, 2))
        off = noise + [1.0, 0.0]
        better = taken(off, noise)
        assert better.proven and better.state == FINE
        counts.append(len(better.errors[5.0]))
        # and the other way round it is rejected
        worse = taken(noise, off)
        assert worse.rejected and worse.state == SUSPECT and not worse.proven
    # then as a rule the right one is proven by a hundred outages
    assert np.median(counts) < 120


def test_errors_that_last_for_outages_prove_nothing():
    # given 40 trials of 20 minutes, in each outage of which the truth lies in the middle of both predictions, but for
    # an error of twice their difference that lasts for twenty outages, as does the side on which the other one lies
    def proven(seed: int, first: int) -> bool:
        rng, bets, common, side = np.random.default_rng(seed), betting.Bets(0.0, first), 0.0, 0.0
        for _ in range(900):
            common = 0.95 * common + math.sqrt(1.0 - 0.95**2) * rng.standard_normal()
            side = 0.95 * side + math.sqrt(1.0 - 0.95**2) * rng.standard_normal()
            half = math.copysign(0.25, side)
            bets.take((common + half, 0.0), (common - half, 0.0))
            if bets.pro > math.log(1.0 / FALSE_ALARMS):
                return True
        return False
    # then bets on each of them prove by chance that one is better (1 % of 40 may be), and bets on blocks do not
    assert sum(proven(seed, 0) for seed in range(40)) >= 5
    assert sum(proven(seed, 30) for seed in range(40)) == 0


def test_a_trial_looks_for_half_a_minute_before_it_stakes():
    # given outages with errors that last, all of them better with the finding
    rng = np.random.default_rng(1)
    errors = np.cumsum(0.1 * rng.standard_normal(100))
    one, seen = trial(), trial()
    pairs = [((error + 0.5, 0.0), (error, 0.0)) for error in errors]
    one.take({duration: pairs[:29] if duration == 1.0 else [] for duration in OUTAGES})
    # then 29 s of them win nothing, and a hundred much less than one bet on each would
    assert one.wealth == pytest.approx(1.0)
    seen.take({duration: pairs if duration == 1.0 else [] for duration in OUTAGES})
    assert max(bets.pro for bets in seen.bets.values()) < 10 * math.log(1.9)
    # and where half a minute has been seen before, with errors that do not last, the first one wins
    one, better = trial(), ((1.0, 0.0), (0.1, 0.0))
    one.see({duration: [((side + 0.1, 0.0), (side, 0.0)) for side in (0.1, -0.1) * 15] for duration in OUTAGES})
    assert one.wealth == 1.0
    one.take({duration: [better] if duration == 1.0 else [] for duration in OUTAGES})
    assert one.wealth > 1.05


def test_what_lasts_is_bet_on_in_blocks():
    # given 200 measurements with errors of 1 m that last, and predictions that are 0.4 m apart
    def bets_made(correlation: float, first: int = 30) -> int:
        rng, bets, error, wealth = np.random.default_rng(1), betting.Bets(0.0, first), 0.0, set()
        for _ in range(200):
            error = correlation * error + math.sqrt(1.0 - correlation**2) * rng.standard_normal()
            bets.take((error + 0.2, 0.0), (error - 0.2, 0.0))
            wealth.add(bets.pro)
        return len(wealth) - 1
    # then as a rule each is bet on where they do not last, and one block of dozens where they last for ten
    assert bets_made(0.0) > 150 and 10 < bets_made(0.5) < 50 and 2 < bets_made(0.9) < 20
    # and each is where nobody asks for how long they last
    assert bets_made(0.9, 0) == 199


def test_centimetres_decide_and_millimetres_do_not():
    # given an hour of fixes with a noise of 4 mm, which one filter meets and another one misses by `off` m
    rng = np.random.default_rng(1)
    noise = 0.004 * rng.standard_normal((3600, 2))

    def decided(off):
        bets = betting.Bets()
        for fix in noise:
            bets.take((fix[0] + off, fix[1]), (fix[0], fix[1]))
        return bets.pro > math.log(86_400.0)
    # then a filter is better where it is nearer by what a user notices, and not by what fixes tell of its age
    assert not decided(0.006) and decided(0.04)


def test_errors_that_both_predictions_have_in_common_cost_no_clear_bets():
    # given filters whose predictions are 2 cm apart on a road where both are off by 4 cm for a minute, to the side of
    # the first one, behind a minute in which errors come to either side
    rng, sides = np.random.default_rng(2), np.concatenate([np.resize([1.0, -1.0], 60), np.full(60, -1.0)])
    all_of_them, clear = betting.Bets(), betting.Bets(betting.CLEAR)
    for side in sides:
        off = 0.04 * side + 0.005 * rng.standard_normal()
        for bets in all_of_them, clear:
            bets.take((off + 0.01, 0.0), (off - 0.01, 0.0))
    # then a bet on each of them loses most of the wealth, and one where the middle is clear of such errors nothing
    assert all_of_them.pro < math.log(0.05) and clear.pro == 0.0
    # and in a turn, where they are 20 cm apart, both win
    before = all_of_them.pro
    for bets in all_of_them, clear:
        bets.take((0.2, 0.0), (0.0, 0.0))
    assert clear.pro > 0.5 and all_of_them.pro > before + 0.5


def test_the_bets_are_those_of_the_formula():
    # given two fixes a metre from one filter and on the other one, and one in the middle but for the margin of 5 mm
    bets = betting.Bets()
    bets.take((1.0, 0.0), (0.0, 0.5))
    assert bets.pro == bets.con == 0.0  # the first one tells how far fixes usually are
    bets.take((2.0, 0.0), (1.0, 0.0))
    # then y = 1.5, B = 0.5, d = 1: x is bounded to 1, and 0.9 of the wealth was on it
    assert bets.pro == pytest.approx(math.log(1.9)) and bets.con == pytest.approx(math.log(0.1))
    bets.take((0.05, 0.1), (-0.05, 0.1))
    usual = 0.75  # of 0.5 and 1
    part = 1.56 * (0.05 - 0.005) / usual
    assert bets.pro == pytest.approx(math.log(1.9) + math.log1p(-part * 0.005 / usual))
    # and where both predict the same, or one is nearer by less than that, nothing is bet
    before = bets.pro, bets.con
    bets.take((3.0, 1.0), (3.0, 1.0))
    bets.take((0.009, 0.0), (0.0, 0.0))
    assert (bets.pro, bets.con) == before


@pytest.fixture(scope='module')
def drive():
    """Eleven minutes at 20 Hz, fixes stamped OFFSET late."""
    sensors = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    recording = simulate_recording(simulate_drive(670.0, seed=5, rate=20.0), sensors, GnssNoise(0.1, rate=2.0), seed=5,
                                   aiding=SimulatedAiding(speed_rate=5.0)).recording
    gnss = recording.gnss
    stamp, received = gnss.stamp + round(OFFSET * SECOND), gnss.received + round(OFFSET * SECOND)
    return replace(recording, gnss=replace(gnss, stamp=stamp, received=received))


def given_live(recording):
    """The chunks that a node gathers, each message in the order in which it was received."""
    gathering, made = Gathering(), []
    imu, gnss, speed = recording.imu, recording.gnss, recording.speed
    rows = sorted([*((int(t), 2, i) for i, t in enumerate(imu.received)),
                   *((int(t), 3, i) for i, t in enumerate(gnss.received)),
                   *((int(t), 4, i) for i, t in enumerate(speed.received))])
    for _, kind, i in rows:
        if kind == 2:
            full = gathering.add_sample((int(imu.stamp[i]), *imu.specific_force[i].tolist(),
                                         *imu.angular_rate[i].tolist()))
            made += [full.recording()] if full else []
        elif kind == 3:
            gathering.add_fix((int(gnss.stamp[i]), gnss.latitude[i], gnss.longitude[i], gnss.height[i],
                               gnss.covariance[i].ravel(), gnss.status[i], gnss.covariance_type[i]))
        else:
            gathering.add('speed', int(speed.stamp[i]), (speed.speed[i], speed.variance[i]))
    return made


def same(a, b):
    """Bit for bit, with the same types."""
    assert a.streams().keys() == b.streams().keys()
    for name, samples in a.streams().items():
        for column, values in vars(samples).items():
            other = getattr(b.streams()[name], column)
            assert (values is None and other is None) or (
                np.array_equal(values, other) and values.dtype == other.dtype), (name, column)


def test_live_has_the_chunks_of_the_recording(drive):
    replayed, live = list(chunks(drive)), given_live(drive)
    assert len(replayed) == len(live) == 22
    for a, b in zip(replayed, live):
        same(a, b)
        assert CHUNK - 0.2 < (a.imu.stamp[-1] - a.imu.stamp[0]) / SECOND < CHUNK
    # and nothing is lost between them
    assert np.array_equal(np.concatenate([c.imu.stamp for c in replayed]), drive.imu.stamp[:22 * 600])
    fixes = np.concatenate([c.gnss.stamp for c in replayed])
    assert np.array_equal(fixes, drive.gnss.stamp[:len(fixes)]) and len(fixes) >= 22 * 60 - 3


def test_wild_samples_cost_nothing(drive):
    # given samples that are not numbers, and one stamped an hour ahead
    imu = drive.imu
    stamp, force = imu.stamp.copy(), imu.specific_force.copy()
    force[100:103] = np.nan
    stamp[2000] += 3600 * SECOND
    wild = replace(drive, imu=replace(imu, stamp=stamp, specific_force=force))
    replayed, live = list(chunks(wild)), given_live(wild)
    assert len(replayed) == len(live) == 23
    for a, b in zip(replayed, live):
        same(a, b)
    # then the chunk that it cuts goes on behind it
    work = Online(table.check({'diagnosis.share': 1.0}), blind, blind)
    for chunk in replayed:
        said = work.take(chunk)
    assert said[0].state == NOTHING
    assert (work._window.imu.stamp[-1] - work._window.imu.stamp[0]) / SECOND > 590.0


def followed(drive, answers, count=5):
    """What is said after each of the first `count` chunks; the analyses find what `answers` gives one after the other,
    then the last."""
    asked = iter(answers)
    work = Online(table.check({'diagnosis.window': 240.0, 'diagnosis.share': 1.0}),
                  lambda recording, values: next(asked, answers[-1]), blind)
    return [work.take(chunk) for chunk in list(chunks(drive))[:count]], work


def test_a_finding_is_proven_on_what_comes_after(drive, monkeypatch):
    # given analyses of which the second finds what there is, and something that is not
    monkeypatch.setattr(online, 'FIRST', CHUNK)
    monkeypatch.setattr(online, 'ANALYSIS', CHUNK)
    monkeypatch.setattr(false_alarms, 'FALSE_ALARMS', 0.1)  # less is needed, of a short drive
    wrong = replace(finding(-0.3), name='gnss_latency', changes={'gnss.time_offset': -0.3})
    said, work = followed(drive, [[], [finding(), wrong], [finding(), wrong], [finding()], [finding()]], count=8)
    states = [{quantity.name: quantity.state for quantity in quantities} for quantities in said]
    assert states[0] == {ALL: NOTHING}
    # then both are on trial, and in the end the one is proven, and the other is not
    assert states[1] == {'gnss_time_offset': COARSE, 'gnss_latency': COARSE}
    assert states[-1] == {'gnss_time_offset': FINE, 'gnss_latency': SUSPECT}
    told = next(q for q in said[-1] if q.name == 'gnss_time_offset')
    assert told.sets == (f'gnss.time_offset: {OFFSET}',) and told.time == int(list(chunks(drive))[7].imu.stamp[-1])
    for duration, (without, with_it, count) in told.better.items():
        assert with_it < 0.6 * without and count >= 5, duration
    # the outages were all after the analysis, and did not overlap
    assert len(work.trials['gnss_time_offset'].errors[10.0]) <= (len(said) - 2) * 3


def test_what_the_last_minute_shows_is_not_suspect_for_being_young(drive):
    # given a finding on trial, and an analysis of all that is kept that does not find it
    work = Online(table.check({}), blind, blind)
    work.trials = {'gnss_time_offset': trial()}
    for shown, state in (({'gnss_time_offset'}, COARSE), (set(), SUSPECT)):
        work._analysis = Analysis(drive, {}, 0, False, dict(work.trials), shown)
        work._conclude()
        # then it is SUSPECT only where the last minute does not show it, either
        assert work.trials['gnss_time_offset'].state == state


def test_a_result_counts_with_the_same_chunk_whenever_it_is_there(drive, monkeypatch):
    # given 0.6 of a core, so that an analysis may take three chunks more than its own
    monkeypatch.setattr(online, 'FIRST', 2 * CHUNK)
    settings, asked = table.check({'diagnosis.share': 0.6}), []

    def find(recording, values):
        asked.append(recording)
        return [finding()]

    def said(does):
        work, names = Online(settings, find, blind), []
        for chunk in list(chunks(drive))[:5]:
            names.append([q.name for q in work.take(chunk)])
            does(work)
        return names
    # then its result is told with the answer to the fifth chunk, whether it was done before or is waited for then
    expected = [[ALL]] * 4 + [['gnss_time_offset']]
    assert said(lambda work: None) == expected and len(asked) == 1
    assert said(Online.analyse) == expected and len(asked) == 2
    # and it is of the first two
    assert all(np.array_equal(part.imu.stamp, drive.imu.stamp[:2 * 600]) for part in asked)


def test_an_analysis_of_other_parameters_than_drive_now_is_abandoned(drive, monkeypatch):
    # given an analysis that goes on when what is on trial is applied
    monkeypatch.setattr(online, 'FIRST', CHUNK)

    def find(recording, values):
        assert not work.is_abandoned
        work.accept()
        assert work.is_abandoned
        raise online.Abandoned
    work = Online(table.check({'diagnosis.online': 'apply'}), find, blind)
    work.trials = {'gnss_time_offset': trial()}
    first, *_ = chunks(drive)
    work.take(first)
    # then nothing of it is left
    work.analyse()
    assert work._analysis is None and not work.is_abandoned and not work.is_awaited


def test_what_is_younger_than_an_analysis_stays(drive):
    # given a value that came on trial while an analysis went on, which finds another one
    work = Online(table.check({}), lambda recording, values: [finding(0.1)], blind)
    work._analysis = Analysis(drive, {}, 0, True, {})
    work.trials = {'gnss_time_offset': trial()}
    work._conclude()
    assert work.trials['gnss_time_offset'].finding.parameters['time_offset'].value == OFFSET


def test_no_chunk_waits_for_an_analysis(drive, monkeypatch):
    # given the process of the diagnosis, in which an analysis begins with the second chunk and ends when four are
    # answered
    monkeypatch.setattr(worker.os, 'nice', lambda by: None)
    monkeypatch.setattr(worker.signal, 'signal', lambda *arguments: None)
    monkeypatch.setattr(online, 'direct_findings', blind)
    monkeypatch.setattr(online, 'FIRST', 2 * CHUNK)
    source, sink, behind = io.BytesIO(), io.BytesIO(), []

    def answers():
        reader, told = io.BytesIO(sink.getvalue()), []
        while reader.tell() < len(sink.getvalue()):
            told.append(pickle.load(reader))
        return told

    def found(part, values, progress):
        deadline = time.monotonic() + 20.0
        while len(answers()) < 4 and time.monotonic() < deadline:
            progress(0.5, 'searching')
        behind.append(len(answers()))
        return [finding()]
    monkeypatch.setattr(online, 'findings_in_recording', found)
    for one in ((table.check({'diagnosis.share': 0.6}), []), *((chunk, []) for chunk in list(chunks(drive))[:5])):
        pickle.dump(one, source)
    source.seek(0)
    # when all chunks are there
    worker.process_chunks(source, sink)
    # then the next two have their answers before the analysis is done, and the fifth has the result of that
    assert behind == [4]
    assert [[q.name for q in quantities] for quantities, _, _ in answers()] == [[ALL]] * 4 + [['gnss_time_offset']]


def test_the_process_ends_with_its_input_in_an_analysis(drive, monkeypatch):
    # given the process of the diagnosis, whose input ends while it does an analysis that nothing else ends
    monkeypatch.setattr(worker.os, 'nice', lambda by: None)
    monkeypatch.setattr(worker.signal, 'signal', lambda *arguments: None)
    monkeypatch.setattr(online, 'direct_findings', blind)
    monkeypatch.setattr(online, 'FIRST', CHUNK)
    over = threading.Event()

    def found(part, values, progress):
        while not over.wait(0.01):
            progress(0.5, 'searching')
        return []
    monkeypatch.setattr(online, 'findings_in_recording', found)
    source, sink = io.BytesIO(), io.BytesIO()
    for one in ((table.check({}), []), (next(chunks(drive)), [])):
        pickle.dump(one, source)
    source.seek(0)
    work = threading.Thread(target=worker.process_chunks, args=(source, sink), daemon=True)
    work.start()
    work.join(20.0)
    # then it ends, having answered
    ended = not work.is_alive()
    over.set()
    assert ended and pickle.loads(sink.getvalue())[0][0].name == ALL


def test_no_answer_waits_for_the_advice(drive, monkeypatch):
    # given the process of the diagnosis, and a look that has something to tell from the second chunk on, which is not
    # proven in four
    monkeypatch.setattr(false_alarms, 'FALSE_ALARMS', 1e-300)
    monkeypatch.setattr(worker.os, 'nice', lambda by: None)
    monkeypatch.setattr(worker.signal, 'signal', lambda *arguments: None)
    looks = iter([[], [finding()], [], []])
    monkeypatch.setattr(online, 'direct_findings', lambda recording, values: next(looks))
    monkeypatch.setattr(online, 'findings_in_recording', lambda part, values, progress: [])
    source, sink, there = io.BytesIO(), io.BytesIO(), []

    def answers():
        reader, told = io.BytesIO(sink.getvalue()), []
        while reader.tell() < len(sink.getvalue()):
            told.append(pickle.load(reader)[0])
        return told

    def advised(one, recording, values):
        there.append(len(answers()))
        return Advice('a turn', 'time_offset', 's', 0.02, 0.01)
    monkeypatch.setattr(online, 'advised', advised)
    values, few = table.check({}), list(chunks(drive))[:4]
    for one in ((values, []), *((chunk, []) for chunk in few)):
        pickle.dump(one, source)
    source.seek(0)
    worker.process_chunks(source, sink)
    # then it is told that, and what would show more is found after that, once, and told a minute later
    assert there == [2]
    told = [[(q.name, q.advice != '') for q in quantities] for quantities in answers()]
    assert told == [[(ALL, False)], [(NAME, False)], [(NAME, True)], [(NAME, True)]]
    # and a replay, in which nobody calls for it in between, tells the same
    looks = iter([[], [finding()], [], []])
    work = Online(values, blind, lambda recording, given: next(looks))
    assert [[(q.name, q.advice != '') for q in work.take(chunk)] for chunk in few] == told


def test_outages_within_which_the_errors_of_fixes_last_prove_no_colour_of_them(drive, monkeypatch):
    # given filters of which the one with what is on trial is nearer to the fixes in all outages,
    def predicted(part, values, chunk):
        off = 1.0 if values['gnss.coloured_noise.sigma'] or values['gnss.time_offset'] else 2.0
        return {d: {k: ((off, 0.0), 1e3) for k in range(20)} for d in OUTAGES}
    monkeypatch.setattr(trial_outages, 'predicted', predicted)
    colour = {'gnss.coloured_noise.sigma': 1.7, 'gnss.coloured_noise.tau': 8.0}
    noise = replace(finding(), name='gnss_coloured_noise', parameters={'sigma': Estimate(1.7, 0.2, 'm')},
                    changes=colour)
    first, second, *_ = chunks(drive)
    work = Online(table.check({}), blind, blind)
    work.take(first)
    work.trials = {one.name: Trial(one, one.changes, 1.0 / FALSE_ALARMS) for one in (noise, finding())}
    work.take(second)
    # then those of 1 and 5 s say nothing of errors of the fixes that last 8 s, and all of them of a time offset
    counted = {name: [d for d, pairs in one.errors.items() if pairs] for name, one in work.trials.items()}
    assert counted == {'gnss_coloured_noise': [10.0, 30.0], NAME: list(OUTAGES)}


@pytest.mark.parametrize('rate', [1.0, 4.0])
def test_outages_of_one_chunk_after_another_join_and_judge_what_is_new(rate):
    # given fixes whose intervals are not that regular, in chunks
    rng, second = np.random.default_rng(3), np.arange(0.0, 200.0, 1.0 / rate)
    stamp = ((second + rng.uniform(0.0, 0.02, len(second))) * SECOND).astype(np.int64)
    imu = np.arange(0, 200 * SECOND, SECOND // 20)

    def until(end, since=0.0):
        """Stamps of samples and fixes of a part of the drive, s."""
        return SimpleNamespace(**{name: SimpleNamespace(stamp=of[(of >= since * SECOND) & (of < end * SECOND)])
                                  for name, of in (('imu', imu), ('gnss', stamp))})
    for duration in OUTAGES:
        length, begins = round(duration * SECOND), []
        for end in np.arange(2 * CHUNK, 200.0, CHUNK):
            mine = sorted({*trial_outages._begins(until(end), until(end, end - CHUNK), duration)})
            # then each chunk has as many as it can have, of those no longer than an interval of the fixes half,
            least = 0.5 if duration * rate == 1.0 else 1.0
            assert least * CHUNK / duration - 1.0 <= len(mine) <= CHUNK / duration + 1.0 and len(mine) >= 1
            # and what is judged of them is of the chunk, and a second before its end the latest
            assert all(one + 0.7 * length > (end - CHUNK) * SECOND - 1 for one in mine)
            assert mine[-1] + length <= (end - 1.0) * SECOND
            begins += mine
        # and they overlap by no more than an interval of the fixes
        assert np.diff(begins).min() >= length - 1.1 * SECOND / rate


def test_a_look_is_taken_after_each_chunk_at_first_and_each_minute_later(drive):
    begin, looks = drive.imu.stamp[0], []

    def look(recording, values):
        looks.append(round((recording.imu.stamp[-1] - begin) / SECOND))
        return []
    work = Online(table.check({}), blind, look)
    for chunk in chunks(drive):
        work.take(chunk)
    assert looks == [30, 60, 90, 120, 150, 180, 210, 240, 300, 360, 420, 480, 540, 600, 660]


def test_what_is_as_given_is_told_and_how_it_would_show(drive, monkeypatch):
    # given looks that show a time offset to a tenth of a second, of an arm nothing, and in the last one the offset well
    def seen(name, sigma=None, settled=False):
        known = {'time_offset': Estimate(0.01, sigma, 's')} if sigma else {}
        return Finding(name, [name], known, 0.0, 0.0, False, HeldOut(0.0, 1.0, []), settled=settled)
    shown = iter([[seen('gnss_time_offset', 0.1), seen('gnss_lever_arm')]] * 3
                 + [[seen('gnss_time_offset', 0.01, True), seen('gnss_lever_arm')]])
    asked = []
    monkeypatch.setattr(online, 'LATEST', 50.0)
    monkeypatch.setattr(online, 'LOOKED', CHUNK)
    monkeypatch.setattr(online, 'advised', lambda one, recording, values: asked.append(one) or Advice(
        'a left turn', next(iter(one.parameters)), 'm', 0.1, 0.01))
    work = Online(table.check({}), blind, lambda recording, values: next(shown))
    said = [{q.name: q for q in work.take(chunk)} for chunk in list(chunks(drive))[:4]]
    # then each is told, with what may be left of it, and none has a line to set or is to look at
    states = [(one['gnss_time_offset'].state, one['gnss_lever_arm'].state) for one in said]
    assert states == [(COARSE, INITIALISING)] * 3 + [(FINE, INITIALISING)]
    assert said[0]['gnss_time_offset'].parameters['time_offset'].sigma == 0.1
    assert not any(q.is_to_look_at or q.sets or q.applied for one in said for q in one.values())
    # and what would show more, of one after the other, as they become ready; what nothing shows has its usual size
    assert [one.name for one in asked] == ['gnss_time_offset', 'gnss_lever_arm']
    assert asked[1].parameters['x'].sigma > 0.3
    assert said[3]['gnss_lever_arm'].advice and not said[3]['gnss_time_offset'].advice
    # and a finding on trial takes the place of what is told of its effect, a reset that of all
    work.trials = {'gnss_lever_arm': trial()}
    assert [q.name for q in work.quantities()] == ['gnss_lever_arm', 'gnss_time_offset']
    work.reset()
    assert work.quantities() == []


def test_filters_on_trial_begin_with_what_shows_the_finding(drive, monkeypatch):
    # given two findings on trial in the sixth minute, one of the whole drive, and one that the last minute alone shows
    begins = {}

    def predicted(part, values, chunk):
        begins.setdefault(values['gnss.time_offset'], set()).add((int(part.imu.stamp[0]), int(part.gnss.stamp[0])))
        return {duration: {} for duration in OUTAGES}
    monkeypatch.setattr(trial_outages, 'predicted', predicted)
    several = list(chunks(drive))[:12]
    work = Online(table.check({}), blind, blind)
    for chunk in several[:11]:
        work.take(chunk)
    work.trials = {str(value): Trial(replace(finding(value), since=since), finding(value).changes, 1e3, taken=1)
                   for value, since in ((0.1, 0), (0.2, int(several[10].imu.stamp[0])))}
    work.take(several[11])
    # then the filters of the second, with it and without it, have seen nothing from before that
    assert [begin for begin, _ in begins[0.2]] == [int(several[10].imu.stamp[0])]
    assert all(fix >= begin for pairs in begins.values() for begin, fix in pairs)
    settled = int(several[11].imu.stamp[-1] - several[11].imu.stamp[0]) + round(trial_outages.SETTLING * SECOND)
    long_ago = int(several[11].imu.stamp[-1]) - settled
    assert [begin for begin, _ in begins[0.1]] == [pytest.approx(long_ago, abs=SECOND)]
    assert {begin for begin, _ in begins[0.0]} == {begin for value in (0.1, 0.2) for begin, _ in begins[value]}


def test_a_mounting_that_the_filter_finds_out_itself_is_proven(monkeypatch):
    # given a mounting that is 6 deg off in yaw, and one on trial that is right
    turn = math.radians(6.0)
    sensors = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    recording = simulate_recording(simulate_drive(310.0, seed=5, rate=20.0), sensors, GnssNoise(0.05, rate=2.0),
                                   seed=5).recording
    recording = replace(recording, reference=None, speed=None, velocity=None, heading=None)

    def states(declared, tried, count):
        """After each of the first `count` chunks, with a mounting declared and one on trial."""
        one = Finding('mounting_rotation', ['mounting_rotation'], {'yaw': Estimate(tried, 0.01, 'rad')}, 0.0, 0.0, True,
                      HeldOut(0.0, 1.0, []), changes={'imu.mounting_rpy': [0.0, 0.0, tried]})
        work = Online(table.check({'imu.mounting_rpy': [0.0, 0.0, declared]}), blind,
                      lambda part, values: [one] if not work.trials else [])
        return [work.take(chunk)[0].state for chunk in list(chunks(recording))[:count]]
    # then it is proven within two and a half minutes, though filters that estimate it predict the same with either,
    assert FINE in states(turn, 0.0, 5)
    # and a wrong one is not
    assert FINE not in states(0.0, turn, 10)


def test_where_only_the_finding_lets_the_filter_start_it_is_told_how_to_apply_it():
    # given an IMU that is declared backwards, with which the filter refuses to start while the vehicle drives forwards
    sensors = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    recording = simulate_recording(simulate_drive(310.0, seed=5, rate=20.0), sensors, GnssNoise(0.05, rate=2.0),
                                   seed=5).recording
    recording = replace(recording, reference=None, speed=None, velocity=None, heading=None)
    work = Online(table.check({'imu.mounting_rpy': [0.0, 0.0, math.pi]}), blind)
    for chunk in list(chunks(recording))[:8]:
        said = work.take(chunk)
    # then the mounting is found and not proven, as there is nothing to compare it with, and the reader knows what to do
    one, = (quantity for quantity in said if quantity.name == 'mounting_rotation')
    assert one.state == COARSE and not one.better
    assert 'an estimate only with it' in one.text and '~/calibration/accept' in one.text
    # and what is applied is how it is mounted
    one, = (quantity for quantity in work.accept() if quantity.name == 'mounting_rotation')
    assert one.applied and '~/calibration/accept' not in one.text
    assert work.sets['imu.mounting_rpy'] == pytest.approx([0.0, 0.0, 0.0], abs=math.radians(3.0))
    # while a finding that both filters are compared with says nothing of it
    compared = trial()
    compared.take({duration: [((1.0, 0.0), (0.5, 0.0))] for duration in OUTAGES})
    assert 'estimate only' not in compared.quantity(0, NAME).text


def test_a_value_that_has_changed_begins_anew(monkeypatch, drive):
    monkeypatch.setattr(online, 'FIRST', CHUNK)
    monkeypatch.setattr(online, 'ANALYSIS', CHUNK)
    said, work = followed(drive, [[finding(0.1)], [finding(0.12)], [finding()], [], []])
    needed = [(np.pi * k) ** 2 / (6 * FALSE_ALARMS) for k in (1, 2)]
    assert said[1][0].sets == ('gnss.time_offset: 0.1',)  # not apart from what is on trial
    assert said[4][0].sets == (f'gnss.time_offset: {OFFSET}',)
    # a second trial needs more, so that all together are false as seldom
    assert work.trials['gnss_time_offset'].needed == pytest.approx(needed[1])
    assert sum(1 / ((np.pi * k) ** 2 / 6) for k in range(1, 10_000)) == pytest.approx(1.0, abs=1e-3)


def test_a_value_that_is_better_known_goes_on_with_the_same_test(monkeypatch, drive):
    # given a value on trial, and later one that agrees with half of its sigma
    monkeypatch.setattr(online, 'FIRST', CHUNK)
    monkeypatch.setattr(online, 'ANALYSIS', CHUNK)
    said, work = followed(drive, [[finding(0.1)], [finding(0.12, 0.01)], [], [], []])
    # then that is told and on trial from then on, as the first trial
    assert [one[0].sets for one in said[:3]] == [('gnss.time_offset: 0.1',), *[('gnss.time_offset: 0.12',)] * 2]
    assert work.begun == 1 and work.trials['gnss_time_offset'].taken >= 3
    assert work.wanted.tried in ({}, {'gnss_time_offset': {'gnss.time_offset': 0.12}})


#: a process with a share of a core, by `supervise`; arguments: that share, the file for its number
SUPERVISED = """
import os, sys
from mems_ins_fusion.diagnosis import worker
supervised = os.fork()
if not supervised:
    work()
open(sys.argv[2], 'w').write(f'{{supervised}}\\n')
os._exit(worker.supervise(supervised, float(sys.argv[1]), {parent}))
"""
FOR_EVER = """
def work():
    while True:
        pass
"""
TURNS = """
import sys, time
def work():  # two thousandths of a second out of twenty
    while True:
        time.sleep(0.018)
        began = time.process_time()
        while time.process_time() < began + 0.002:
            pass
        sys.stdout.write('.')
        sys.stdout.flush()
"""


def started(script: str, *arguments, **options) -> subprocess.Popen:
    """A process that runs a script: one forked here would have the signal handlers of other tests and the pipe of
    pytest-xdist, which waits for whoever has it."""
    return subprocess.Popen([sys.executable, '-c', script, *map(str, arguments)], cwd=REPOSITORY, **options)


def read_number(path):
    """The number in a file; None as long as it is not all there."""
    text = path.read_text() if path.exists() else ''
    return int(text) if text.endswith('\n') else None


def test_the_process_has_its_share_and_goes_when_its_parent_does(tmp_path):
    # given a process that works for ever, at a tenth of a core
    began = time.monotonic()
    child = started(FOR_EVER + SUPERVISED.format(parent='os.getppid()'), 0.1, tmp_path / 'pid')
    try:
        busy, used = None, 0.0
        while used < 0.3:  # s of a core: three seconds, longer on a busy machine
            assert child.poll() is None and time.monotonic() < began + PATIENCE
            time.sleep(0.05)
            busy = busy or read_number(tmp_path / 'pid')
            if busy:
                ticks = open(f'/proc/{busy}/stat').read().rsplit(')', 1)[1].split()[11]
                used = int(ticks) / os.sysconf('SC_CLK_TCK')
        # then it has had no more than that,
        assert used < 0.15 * (time.monotonic() - began)
    finally:
        child.terminate()
        child.wait(PATIENCE)
    # and is gone with who asked for it
    assert not os.path.exists(f'/proc/{busy}')


def test_a_process_that_does_not_get_its_share_is_not_stopped(tmp_path):
    # given two processes that get a core for a tenth of the time, as on a busy machine, of which one has a share that
    # it does not use up
    paths = tmp_path / 'supervised', tmp_path / 'free'
    with open(paths[0], 'wb') as supervised, open(paths[1], 'wb') as free:
        children = [started(TURNS + SUPERVISED.format(parent='os.getppid()'), 0.15, tmp_path / 'pid',
                            stdout=supervised), started(TURNS + 'work()', stdout=free)]
    try:
        deadline = time.monotonic() + PATIENCE
        while not all(path.stat().st_size for path in paths):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        begun = [path.stat().st_size for path in paths]
        while paths[1].stat().st_size < begun[1] + 150:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        turns = [path.stat().st_size - before for path, before in zip(paths, begun)]
        # then it had all of its turns, and not only those in a part of the time
        assert turns[0] > 0.6 * turns[1]
    finally:
        for child in children:
            child.terminate()
        for child in children:
            child.wait(PATIENCE)


def test_the_process_does_not_outlive_who_asked(tmp_path):
    # given one whose parent is not there any more, as after kill -9
    child = started(FOR_EVER + SUPERVISED.format(parent='os.getpid()'), 0.5, tmp_path / 'pid')
    assert child.wait(PATIENCE) == -signal.SIGKILL & 0xFF
    assert not os.path.exists(f"/proc/{read_number(tmp_path / 'pid')}")


def test_the_node_tells_it_as_the_replay_does(drive, peer):
    # given the first minutes of a drive, with the bits of its messages, and a process that may have all of a core
    recording = drive.having({name: s.select(s.stamp < drive.imu.stamp[0] + 123 * SECOND)
                              for name, s in drive.streams().items()})
    places = {name: np.array([math.radians(degrees) for degrees in np.degrees(getattr(recording.gnss, name))])
              for name in ('latitude', 'longitude')}
    recording = replace(recording, gnss=replace(recording.gnss, **places), speed=None)
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    settings = {'diagnosis.online': 'report', 'diagnosis.window': 120.0, 'diagnosis.share': 1.0}
    arguments = [part for name, value in settings.items() for part in ('-p', f'{name}:={value}')]
    with NodeProcess('fusion_node', *PLAYABLE, *arguments) as node:
        node.wait_until_ready()
        told: list[DiagnosticArray] = []
        peer.node.create_subscription(DiagnosticArray, '/fusion_node/calibration', told.append, latched)
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        player.connect()
        player.play(70.0)
        peer.spin_until(lambda: len(told) >= 2)
        # the second look is after a minute, and shows the offset
        assert told[1].status[0].name == 'fusion_node: calibration: gnss_time_offset'
        assert told[1].status[0].message.startswith(COARSE)
        player.play()
        peer.spin_until(lambda: len(told) >= 4)
        # then what it says after each chunk is what a replay says, and on /diagnostics
        expected = Online(table.check(settings))
        for message, chunk in zip(told, chunks(recording)):
            quantities = expected.take(chunk)
            assert stamp_of(message) == quantities[0].time
            assert [s.name for s in message.status] == [f'fusion_node: calibration: {q.name}' for q in quantities]
            assert [s.message.split(':')[0] for s in message.status] == [q.state for q in quantities]
        values = {v.key: v.value for s in told[-1].status for v in s.values if 'time_offset' in s.name}
        assert float(values['time_offset, s']) == pytest.approx(OFFSET, abs=0.05)
        offset = float(values['set 1'].removeprefix('gnss.time_offset: '))
        # to the digits of a line to copy; linear algebra with another number of threads rounds otherwise
        assert offset == pytest.approx(expected.trials['gnss_time_offset'].sets['gnss.time_offset'], rel=2e-5)
        heard.wait(lambda d: 'time_offset' in d.message('calibration: gnss_time_offset'))
        node.send(signal.SIGINT)
        assert node.wait() == 0
    assert any('diagnosis.online: gnss_time_offset COARSE (found, being tested): ' in line for line in node.lines)


def test_the_first_start_of_the_node_compiles_what_the_diagnosis_needs():
    # given all that the child process of a first start compiles, or has from the cache
    script = """
import gc
from numba.core.dispatcher import Dispatcher
from mems_ins_fusion.nodes import loading
def there():
    return {(one.py_func.__name__, types) for one in gc.get_objects() if isinstance(one, Dispatcher)
            and one.py_func.__module__.startswith('mems_ins_fusion') for types in one.overloads}
loading._compile()
before = there()
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.gathering import chunks
from mems_ins_fusion.diagnosis.online import Online
from mems_ins_fusion.diagnosis.quantity import EarlierFinding
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import simulate_drive, simulate_recording
# when two minutes with a finding of an earlier drive are looked at, tested and analysed
recording = simulate_recording(simulate_drive(150.0, seed=2, rate=20.0)).recording
kept = EarlierFinding('gnss_time_offset', {'time_offset': Estimate(0.1, 0.05, 's')}, {'gnss.time_offset': 0.1})
online = Online(table.check({'diagnosis.online': 'apply'}), kept=[kept])
for chunk in chunks(recording):
    online.take(chunk)
online.analyse()
assert online._analysis.findings is not None and not online._analysis.problem
assert all(online.applied['gnss_time_offset'].errors.values()) and len(before) > 10
print('more:', sorted(name for name, _ in there() - before))
"""
    environment = {**os.environ, 'PYTHONPATH': str(REPOSITORY)}
    answer = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True, env=environment)
    # then no other one is compiled in the small share of a core of the diagnosis
    assert answer.stdout.endswith('more: []\n'), answer.stdout + answer.stderr
