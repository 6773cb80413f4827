"""Two statements about the receiver as two filters: likelihoods, begin and end of the second, what is published.

Known truth: a simulated vehicle on a straight road, whose fixes are right, jump, or drift away.
"""
import math

import numpy as np
import pytest
from filter_support import fix_event, newest, take_event
from scipy.linalg import expm
from scipy.stats import chi2, multivariate_normal
from test_filter_contradiction import BOTH, Drive, a_state

from mems_ins_fusion.filter.bank import (
    EARLIER,
    Bank,
    _compare_standstills,
    _is_better,
    _refuse_since,
    _restart_penalty,
    _search_begin,
    _share_scales,
)
from mems_ins_fusion.filter.memory import Event, Head, Nav, Verdict, element_at, state_at, velocity_variance
from mems_ins_fusion.filter.trust import fix_drift
from mems_ins_fusion.filter.trust.fix_drift import FORGETTING_TIME, FixDrift
from mems_ins_fusion.filter.trust.hypotheses import (
    FAULT_END_RATE,
    FAULT_RATE,
    IMU_WALK,
    LOG_RANGE,
    OUTLIER_SHARE,
    RESTART_PENALTY,
    SHORTEST_CORRELATION,
    UNDECLARED_OFFSET,
    Hypothesis,
    add_move,
    begin_refusing,
    is_drifting,
    move_offset,
    position_and_velocity,
    reach,
    score_fix,
    strayed_nats,
)
from mems_ins_fusion.filter.trust.line import Line
from mems_ins_fusion.filter.trust.new_start import are_refused
from mems_ins_fusion.filter.trust.new_start import note as note_refused
from mems_ins_fusion.filter.trust.offset import Offset
from mems_ins_fusion.filter.trust.receiver import Receiver
from mems_ins_fusion.filter.trust.standstill import Standing

S = np.array([[4.0, 1.0], [1.0, 9.0]])
DRIFT = Hypothesis.OFFSET + Offset.VELOCITY


def judged(memory, r, z, time, scatter=2.25):
    """What `score_fix` makes of a fix that is z (2,) m off at `time`, s: whether it is used, and the nats for it."""
    at = int(memory[Head.EVENTS_AT])
    memory[at + Event.TIME], memory[at + Event.Z_N], memory[at + Event.Z_E] = time, *z
    before = memory[r + Hypothesis.SCORE]
    believed = score_fix(memory, r, at, S[0, 0], S[0, 1], S[1, 1], scatter, 1.0)
    memory[r + Nav.FIX_TIME] = time
    return believed, memory[r + Hypothesis.SCORE] - before


def anywhere(z, s):
    return 1.0 / (2.0 * math.pi * LOG_RANGE * (z @ z + 2.0 * np.trace(s)))


@pytest.mark.parametrize('z', [(0.5, -1.0), (20.0, 5.0)])
@pytest.mark.parametrize('interval', [0.1, 1.0])
def test_who_believes_fixes_expects_their_innovation_but_for_single_ones_anywhere(z, interval):
    # given a filter that goes north at 10 m/s, whose stamps may be off
    _, memory, r = a_state()
    memory[r + Nav.FIX_TIME] = 1.0
    believed, nats = judged(memory, r, z, 1.0 + interval)
    s = S + np.diag([(10.0 * UNDECLARED_OFFSET) ** 2, 0.0])
    density = (1.0 - OUTLIER_SHARE) * multivariate_normal(cov=s).pdf(z) + OUTLIER_SHARE * anywhere(np.array(z), s)
    # then it believes it, and of ten a second each counts for a tenth
    assert believed and nats == pytest.approx(interval / SHORTEST_CORRELATION * math.log(density))


def test_who_doubts_expects_them_to_go_on_being_off_as_they_were():
    _, memory, r = a_state()
    memory[r + Nav.FIX_TIME] = 1.0
    begin_refusing(memory, r, 1.0)
    assert memory[r + Hypothesis.SCORE] == pytest.approx(math.log(FAULT_RATE))
    s = S + np.diag([(10.0 * UNDECLARED_OFFSET) ** 2, 0.0])
    # given a first fix that is wrong anywhere
    z = np.array([30.0, -10.0])
    believed, nats = judged(memory, r, z, 2.0)
    assert not believed and nats == pytest.approx(math.log(anywhere(z, s)))
    # when those after it drift by 2 m/s, then after some of them the next is expected there
    for k in range(1, 30):
        believed, nats = judged(memory, r, z + [2.0 * k, 0.0], 2.0 + k)
        assert not believed
    scatter = 2.25 + 0.5 * (10.0 * UNDECLARED_OFFSET) ** 2
    share = math.exp(-FAULT_END_RATE) * math.exp(-FAULT_END_RATE)
    narrowest = math.log(share / (2.0 * math.pi * scatter))
    assert narrowest - 0.7 < nats < narrowest + 1e-3
    np.testing.assert_allclose(memory[r + DRIFT:r + DRIFT + 2], [2.0, 0.0], atol=0.05)
    # and one that fits the filter again is believed
    believed, _ = judged(memory, r, np.array([0.5, 0.5]), 33.0)
    assert believed and memory[r + Hypothesis.FIXES_WRONG] == 0.0


@pytest.mark.parametrize('interval', [0.1, 1.0])
def test_refused_fixes_that_fit_are_right_again_within_the_time_for_which_receivers_fail(interval):
    # given a filter that takes fixes for wrong, which are off by no more than it may be without them
    _, memory, r = a_state()
    begin_refusing(memory, r, interval)
    z, ended, odds, time = np.array([1.5, 2.0]), 1.0 - math.exp(-FAULT_END_RATE * interval), 0.0, interval
    judged(memory, r, z, time)
    right = multivariate_normal(cov=S + np.diag([(10.0 * UNDECLARED_OFFSET) ** 2, 0.0])).pdf(z)
    believed = False
    while not believed and time < 300.0:
        time += interval
        believed, nats = judged(memory, r, z, time)
        density = math.exp(nats / min(interval / SHORTEST_CORRELATION, 1.0))
        wrong = (density - ended * right) / (1.0 - ended)
        odds += ended * right / wrong
        # then they are right once the sum over the times of the end says so: one who had used them since then would
        # have predicted each later one as well as their offset does
        assert believed == (odds > 1.0 - ended)
    assert 20.0 < time < 120.0


def test_refused_fixes_that_do_not_fit_are_never_right():
    _, memory, r = a_state()
    begin_refusing(memory, r, 1.0)
    assert not any(judged(memory, r, np.array([20.0, 0.0]), float(time))[0] for time in range(1, 300))


@pytest.mark.parametrize('interval', [0.2, 1.0])
def test_right_fixes_of_a_wrong_imu_are_expected_as_a_vehicle_accelerates(interval):
    # given a filter that uses no fixes, and an independent Kalman filter of its error: none at first but for P, and an
    # acceleration that is a Gauss-Markov process and white noise, by the matrix exponential (C. F. Van Loan 1978)
    _, memory, r = a_state()
    position = memory[element_at(memory, r, 0, 0)]
    state = np.zeros((3, 2))
    covariance = np.diag([position, 0.5 * velocity_variance(memory, r), IMU_WALK.sigma**2])
    begin_refusing(memory, r, interval)
    assert memory[r + Hypothesis.IMU_NATS] == pytest.approx(math.log(1.0 / 100.0))
    dynamics = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / IMU_WALK.correlation_time]])
    densities = np.diag([0.0, IMU_WALK.acceleration, 2.0 * IMU_WALK.sigma**2 / IMU_WALK.correlation_time])
    both = expm(interval * np.block([[-dynamics, densities], [np.zeros((3, 3)), dynamics.T]]))
    step = both[3:, 3:].T
    noise = step @ both[:3, 3:]
    scatter = 2.25 + 0.5 * (10.0 * UNDECLARED_OFFSET) ** 2
    widened = S + np.diag([(10.0 * UNDECLARED_OFFSET) ** 2, 0.0])
    # when fixes come from which the filter departs with 1 m/s^2
    for k in range(1, 12):
        z = np.array([0.4, -0.3]) + 0.5 * np.array([0.8, 0.6]) * (k * interval) ** 2
        before = memory[r + Hypothesis.IMU_NATS]
        _, nats = judged(memory, r, z, k * interval)
        state, covariance = step @ state, step @ covariance @ step.T + noise
        s = covariance[0, 0] + scatter
        density = ((1.0 - OUTLIER_SHARE) * multivariate_normal(mean=state[0], cov=s * np.eye(2)).pdf(z)
                   + OUTLIER_SHARE * anywhere(z, widened))
        gain = covariance[:, :1] / s
        state, covariance = state + gain @ (z - state[0])[None, :], covariance - gain @ covariance[:1]
        # then each is as likely where the IMU is wrong as that says, and the other statement as the score says
        gained = interval / SHORTEST_CORRELATION * math.log(density) - nats
        assert memory[r + Hypothesis.IMU_NATS] - before == pytest.approx(gained, abs=0.005)
    offset = r + Hypothesis.IMU_OFFSET
    np.testing.assert_allclose(memory[offset:offset + 6].reshape(3, 2), state, rtol=0.01)


@pytest.mark.parametrize('offset', [lambda t: 30.0, lambda t: 3.0 * t, lambda t: 0.0, lambda t: 4.0 * min(t, 10.0)])
def test_an_offset_a_drift_and_none_are_not_laid_to_the_imu(offset):
    # given fixes that are off by a constant, or by more and more, or right, or drift away and then stay, and the errors
    # of ten receivers
    nats = np.full((10, 40), -np.inf)
    for seed in range(10):
        _, memory, r = a_state()
        begin_refusing(memory, r, 1.0)
        rng = np.random.default_rng(seed)
        for k in range(1, 40):
            judged(memory, r, np.array([offset(float(k)), 0.0]) + 1.5 * rng.standard_normal(2), float(k))
            if memory[r + Hypothesis.FIXES_WRONG] == 0.0:
                break
            nats[seed, k] = memory[r + Hypothesis.IMU_NATS]
    # then once five of them have come, the IMU is never clearly more likely to be wrong, and at last less, for most
    usual = np.median(nats[:, 6:], axis=0)
    assert usual.max() < 2.0 and usual[-1] < 0.0


def test_a_correction_of_the_state_is_none_of_the_fixes():
    # given a filter that takes fixes for wrong, which are 20 m off and go on so
    _, memory, r = a_state()
    begin_refusing(memory, r, 1.0)
    for time in range(1, 20):
        judged(memory, r, np.array([20.0, -10.0]), float(time))
    # when a standstill tells that it is 6 m further north and 2 m/s slower, which is no news of the receiver
    before = position_and_velocity(memory, r)
    memory[r + Nav.LATITUDE] += 6.0 * memory[r + Nav.NORTH_SCALE]
    memory[r + Nav.V_N] -= 2.0
    memory[r + DRIFT] += 2.0  # that the fixes do not drift is known from those that have come
    move_offset(memory, r, before)
    _, moved = judged(memory, r, np.array([26.0, -10.0]), 20.0)
    _, expected = judged(memory, r, np.array([26.0, -10.0]), 21.0)
    # then the next one is as likely as those before it
    assert moved == pytest.approx(expected, abs=0.2)


def test_refused_fixes_are_as_likely_right_as_wrong_after_the_recovery_time():
    _, memory, r = a_state(**{'gnss.recovery_time': 40.0})
    nats = [_restart_penalty(memory, r, since) for since in (0.0, 20.0, 40.0)]
    assert nats == pytest.approx([RESTART_PENALTY, RESTART_PENALTY / 2, 0.0])
    # and at once where the filter that refuses them does not use the IMU
    memory[r + Nav.FIX_TIME] = memory[r + Nav.DIVERGENCE_TIME] = 5.0
    assert _restart_penalty(memory, r, 0.0) == 0.0


def test_the_published_ellipse_reaches_to_the_far_side_of_one_that_may_be_right():
    # given two filters 30 m apart, the second to 2 m, its probability 0.5, 0.02 and 0.0005
    radius = math.sqrt(chi2.ppf(0.95, 2))
    assert reach(0.5, 30.0, 2.0) == pytest.approx(30.0 * math.sqrt(0.5))
    assert radius * reach(0.02, 30.0, 2.0) == pytest.approx(30.0 + 2.0 * radius)
    assert reach(0.0005, 30.0, 2.0) == pytest.approx(30.0 * math.sqrt(0.0005))
    # and one further away than a filter is taken by fixes that drift away
    assert reach(0.02, 300.0, 2.0) == pytest.approx(300.0 * math.sqrt(0.02))


@BOTH
def test_fixes_that_jump_and_come_back_are_left_and_the_ellipse_reaches_to_them(mechanization):
    # given fixes that are 40 m off to the east for 11 s, and the same drive without them
    drive, without = Drive(), Drive()
    wrong = (drive.time > 30.0) & (drive.time < 41.0)
    drive.position[wrong, 1] += 40.0
    without.time, without.position = without.time[~wrong], without.position[~wrong]
    _, _, error, sigma, _ = drive.through(mechanization)
    _, _, coasting, _, _ = without.through(mechanization)
    # then the filter is off by what it is without fixes, and is with them when they come back
    off = np.hypot(*error.T)
    assert off.max() < np.hypot(*coasting.T).max() + 1.0 and off[round(50 * 43.0):].max() < 2.0
    # and from 5 s on, when five fixes have been refused, to the end the 95 % ellipse reaches to the fixes
    undecided = slice(round(50 * 36.5), round(50 * 40.0))
    assert (math.sqrt(chi2.ppf(0.95, 2)) * sigma[undecided, 1] > 0.8 * 40.0).all()


def a_jump():
    """A filter that takes fixes for wrong, as they have jumped by 40 m, one that has started anew from them, and where
    their states begin."""
    drive = Drive()
    drive.position[drive.time > 30.0, 1] += 40.0
    drive.time, drive.samples = drive.time[:38], drive.samples[:1876]  # the last fix is of the last sample
    drive.position = drive.position[:38]
    _, memory, _, _, _ = drive.through('planar')
    other, r = memory[int(memory[Bank.SIZE]):], state_at(memory, int(memory[Head.SAMPLES]))
    assert memory[Bank.OPEN] == 1.0 and memory[r + Hypothesis.FIXES_WRONG] == 1.0
    return memory, other, r


@pytest.mark.parametrize('first_wrong, second_wrong', [(False, True), (True, False), (True, True)])
def test_both_filters_expect_the_same_of_the_receiver(first_wrong, second_wrong):
    # given two filters with other scales, of which one or both take the fixes for wrong
    memory, other, r = a_jump()
    scatter, innovations = (slice(r + a, r + b) for a, b in (
        (Receiver.SMOOTH_SCALE, Receiver.SLOW_SCALE), (Receiver.SLOW_SCALE, Receiver.STATUS)))
    for one, wrong, value in ((memory, first_wrong, 1.0), (other, second_wrong, 2.0)):
        one[r + Hypothesis.FIXES_WRONG], one[scatter], one[innovations] = float(wrong), value, value
    _share_scales(memory, other, r)
    # then both have how fixes scatter from the first, and of innovations what the filter has that uses fixes
    expected = (1.0, 1.0) if not first_wrong else (2.0, 2.0) if not second_wrong else (1.0, 2.0)
    for one, value in zip((memory, other), expected):
        assert (one[scatter] == 1.0).all() and (one[innovations] == value).all()


def test_each_hypothesis_has_the_score_of_its_own_best_begin():
    # given a filter whose accelerometer has been off for 4.5 s, and the second one, which takes the fixes for wrong
    drive = Drive(1.0, 1.5)
    drive.samples[1500:, 1] += 1.7
    drive.time, drive.position, drive.samples = drive.time[:35], drive.position[:35], drive.samples[:1726]
    _, memory, _, _, _ = drive.through('planar')
    other, r = memory[int(memory[Bank.SIZE]):], state_at(memory, int(memory[Head.SAMPLES]))
    since, fixes_wrong, imu_wrong = memory[Bank.WRONG_SINCE], [], []
    for back in EARLIER:
        _refuse_since(memory, other, since - back, 1.0)
        fixes_wrong.append(other[r + Hypothesis.SCORE])
        imu_wrong.append(other[r + Hypothesis.SCORE] + other[r + Hypothesis.IMU_NATS])
    # when other begins are tried, of which the best one is another for a wrong receiver and for a wrong IMU
    assert np.argmax(fixes_wrong) != np.argmax(imu_wrong)
    _search_begin(memory, other, r, 1.0)
    # then either has the score of its best
    assert other[r + Hypothesis.SCORE] == pytest.approx(max(fixes_wrong))
    assert other[r + Hypothesis.SCORE] + other[r + Hypothesis.IMU_NATS] == pytest.approx(max(imu_wrong))


def test_what_each_statement_does_not_know_of_the_position_is_published_on_all_sides():
    memory, other, r = a_jump()
    # then the variance of where the vehicle is by the other one, and by a wrong IMU, is added by their probability
    scores = np.array([memory[r + Hypothesis.SCORE], other[r + Hypothesis.SCORE],
                       memory[r + Hypothesis.SCORE] + memory[r + Hypothesis.IMU_NATS]])
    share = np.exp(scores - scores.max()) / np.exp(scores - scores.max()).sum()
    variance = [0.0, 0.5 * (other[element_at(other, r, 0, 0)] + other[element_at(other, r, 1, 1)]),
                memory[r + Hypothesis.IMU_OFFSET + Offset.VARIANCE]]
    assert share[1] > 0.01 and memory[r + Hypothesis.SPREAD_VARIANCE] == pytest.approx(share @ variance, rel=0.1)


@pytest.mark.parametrize('imu_nats, is_better', [(-0.3, True), (-3.0, False)])
def test_fixes_are_right_where_a_filter_uses_them_and_where_the_imu_is_wrong(imu_nats, is_better):
    # given fixes that are wrong with the probability p, right with p / e, and right beside a wrong IMU with p e^-0.3 or
    # p e^-3: right with 1.11 p or 0.42 p
    memory, other, r = a_jump()
    memory[r + Hypothesis.SCORE], other[r + Hypothesis.SCORE], memory[r + Hypothesis.IMU_NATS] = 0.0, -1.0, imu_nats
    # then the filter that uses them is published where that is more
    assert _is_better(memory, other, r) == is_better


@pytest.mark.parametrize('first_stands, second_stands', [(True, False), (False, True), (True, True)])
def test_a_filter_that_moves_is_less_likely_while_the_vehicle_is_as_quiet_as_at_rest(first_stands, second_stands):
    # given two filters, at rest with a standstill detected just now, or in motion at 10 m/s
    memory, other, r = a_jump()
    for one, stands in ((memory, first_stands), (other, second_stands)):
        one[r + Nav.V_N:r + Nav.V_N + 2] = (0.0, 0.0) if stands else (10.0, 0.0)
        one[r + Standing.TIME] = one[r + Nav.TIME] - (0.1 if stands else 100.0)
    before = memory[r + Hypothesis.SCORE], other[r + Hypothesis.SCORE]
    _compare_standstills(memory, other, r, 0.5)
    # then the one in motion is less likely by a factor of twenty a second
    for one, score, stands in ((memory, before[0], first_stands), (other, before[1], second_stands)):
        lost = 0.0 if stands else 0.5 * math.log(20.0)
        assert score - one[r + Hypothesis.SCORE] == pytest.approx(lost, rel=0.01)


@BOTH
@pytest.mark.parametrize('rate, noise', [(1.0, 0.5), (10.0, 1.5)])
def test_an_accelerometer_that_is_off_is_left_and_not_the_fixes(mechanization, rate, noise):
    # given an accelerometer ahead that shows 1 m/s^2 too much for 15 s: by it the vehicle would be 112 m off
    drive = Drive(rate, noise)
    drive.samples[1500:2250, 1] += 1.0
    _, memory, error, sigma, _ = drive.through(mechanization)
    # then the filter goes on without the IMU, and is with the fixes before the accelerometer is right again
    assert newest(memory)[Nav.DIVERGENCE_TIME] > 30.0
    off = np.hypot(*error.T)
    assert off.max() < 0.25 * 112.0 and off[round(50 * 45.0):].max() < 4.0
    # and while it takes the fixes for wrong and is far off, the 95 % ellipse reaches to them, as they may be right
    far = off > 8.0
    assert (off < math.sqrt(chi2.ppf(0.95, 2)) * np.hypot(*sigma.T) + 2.0)[far].mean() > 0.7


def test_a_receiver_that_goes_straight_on_while_the_vehicle_brakes_is_not_laid_to_the_imu():
    # given a vehicle that brakes with 4 m/s^2 from 35 s on and stands, and fixes that go straight on at 10 m/s
    drive = Drive(1.0, 1.5)
    time, braking = drive.samples[:, 0], 10.0 / 4.0
    drive.samples[(time > 35.0) & (time <= 35.0 + braking), 1] -= 4.0
    after = np.flatnonzero(drive.time > 35.0)
    since = drive.time[after] - drive.time[after[0] - 1]
    drive.position[after] = drive.position[after[0] - 1] + np.outer(since, [10.0, 0.0])
    _, _, error, _, _ = drive.through('planar')
    # then the filter stays where it has come to rest, though by the fixes an IMU that is wrong would explain it as well
    since = np.maximum(time - 35.0, 0.0)
    braked = np.where(since < braking, 2.0 * since**2, 10.0 * since - 5.0 * braking)  # behind one that does not brake
    assert np.hypot(error[:, 0] + braked, error[:, 1]).max() < 12.0


@BOTH
def test_precise_fixes_that_jump_for_less_than_the_recovery_time_are_not_followed(mechanization):
    # given fixes of 2 cm, ten a second, that are 8 m off to the east for 8 s; gnss.recovery_time is 10 s
    drive = Drive(10.0, 0.02)
    wrong = (drive.time > 30.0) & (drive.time < 38.0)
    drive.position[wrong, 1] += 8.0
    _, _, error, _, _ = drive.through(mechanization)
    # then the filter stays where its inertial sensors have it, and is with the fixes when they are right again
    assert np.hypot(*error.T).max() < 1.5 and np.hypot(*error[round(50 * 39.0):].T).max() < 0.2


def test_right_fixes_are_found_again_though_those_before_them_did_not_agree():
    # given refused fixes, one a second, that claim 2 cm: ten that scatter by 20 m, then those of a filter that is off
    _, memory, r = a_state()
    at, rng = int(memory[Head.EVENTS_AT]), np.random.default_rng(3)
    memory[r + Receiver.CLAIMED] = 0.02**2
    innovations = [*(20.0 * rng.standard_normal((10, 2))), *np.full((12, 2), 12.0)]
    agree = []
    for k, z in enumerate(innovations):
        memory[at + Event.TIME], memory[at + Event.Z_N], memory[at + Event.Z_E] = k + 1.0, *z
        memory[at + Event.VERDICT] = Verdict.REFUSED
        note_refused(memory, r, at)
        memory[r + Nav.FIX_TIME] = k + 1.0
        agree.append(are_refused(memory, r))
    # then they are found to agree as soon as five and five more of them have come, at most
    assert not any(agree[:10]) and agree[-3:] == [True] * 3


@BOTH
def test_one_fix_far_off_opens_nothing_for_long(mechanization):
    drive = Drive()
    drive.position[30, 1] += 30.0
    _, _, error, sigma, _ = drive.through(mechanization)
    # then a few seconds later all is as sure as it was
    after = slice(round(50 * 34.0), round(50 * 40.0))
    assert np.hypot(*sigma[after].T).max() < 0.2 and np.hypot(*error.T).max() < 2.0


@BOTH
def test_where_wrong_fixes_are_followed_the_covariance_reaches_back_and_the_end_is_found(mechanization):
    # given fixes that drift away to the east by 2 m/s for 15 s
    drive = Drive()
    wrong = (drive.time > 30.0) & (drive.time < 45.0)
    drive.position[wrong, 1] += 2.0 * (drive.time[wrong] - 30.0)
    _, memory, error, sigma, _ = drive.through(mechanization)
    off, reach = np.hypot(*error.T), np.hypot(*sigma.T)
    # then wherever it is more than 10 m off, the 95 % ellipse reaches to the vehicle
    far = off > 10.0
    assert not far.any() or (off < math.sqrt(chi2.ppf(0.95, 2)) * reach + 2.0)[far].mean() > 0.9
    # and nine seconds after the fixes are right again it is with them
    assert off[round(50 * 54.5):].max() < 2.0


@BOTH
def test_fixes_that_drift_away_are_left(mechanization):
    # given fixes that drift away to the east by 3 m/s from 40 s to 52 s, when they are right again
    drive = Drive()
    wrong = (drive.time > 40.0) & (drive.time < 52.0)
    drive.position[wrong, 1] += 3.0 * (drive.time[wrong] - 40.0)
    _, _, error, _, _ = drive.through(mechanization)
    # then they are 35 m off, the filter no more than it is without any (tilt and heading of 0.02 rad and less), and it
    # is with them at once when they are right
    off = np.hypot(*error.T)
    assert off.max() < 12.0 and off[round(50 * 53.6):].max() < 2.0


@pytest.mark.parametrize('offset, drift, is_so', [
    ((0.0, 20.0), (0.0, 3.0), True),  # 20 m beside the way
    ((20.0, 0.0), (3.0, 0.0), False),  # ahead of a vehicle that goes north: stamps may be late
    ((0.0, 20.0), (0.0, 0.2), False)])  # a drift of two sigma
def test_fixes_drift_that_leave_the_way_of_the_vehicle(offset, drift, is_so):
    _, memory, r = a_state()
    memory[r + Hypothesis.FIXES_WRONG] = 1.0
    memory[r + Hypothesis.OFFSET:r + Hypothesis.OFFSET + 2] = offset
    memory[r + DRIFT:r + DRIFT + 2] = drift
    variance = r + Hypothesis.OFFSET + Offset.VARIANCE
    memory[variance:variance + 3] = 1.0, 0.05, 0.01
    assert is_drifting(memory, r) == is_so


@pytest.mark.parametrize('drift', [(3.0, 0.0), (3.0, -4.0), (0.0, 12.0)])
def test_a_filter_that_strays_and_fixes_that_drift_are_told_apart_by_their_priors(drift):
    # given a receiver that fails once an hour and then drifts by 0 +- 3 m/s, and an IMU that fails once in a hundred
    # hours and then leaves a velocity that is off by 0 +- 7 m/s
    _, memory, r = a_state()
    memory[r + DRIFT:r + DRIFT + 2] = drift
    receiver, imu = (math.log(rate) + multivariate_normal(cov=sigma**2).logpdf(drift).sum()
                     for rate, sigma in ((1.0 / 3600.0, 3.0), (1.0 / 3.6e5, 7.0)))
    # then those are the odds, as both predict the same fixes
    assert strayed_nats(memory, r) == pytest.approx(imu - receiver)


@BOTH
def test_fixes_that_have_jumped_do_not_drift(mechanization):
    # given fixes that after 40 s are 12 m off
    drive = Drive()
    drive.position[drive.time > 40.0, 1] += 12.0
    _, memory, error, _, _ = drive.through(mechanization)
    # then there is one filter that uses them and one that does not. The latter is published only where the fixes had
    # been refused, so that the other has started anew from them: else it might be the filter that was off
    other = memory[int(memory[Bank.SIZE]):]
    r = state_at(memory, int(memory[Head.SAMPLES]))
    assert memory[Bank.OPEN] == 1.0 and memory[r + Hypothesis.FIXES_WRONG] + other[r + Hypothesis.FIXES_WRONG] == 1.0
    assert memory[r + Hypothesis.FIXES_WRONG] == other[r + Nav.RECOVERIES]
    assert np.hypot(*error.T).max() < 20.0


def test_what_fixes_have_moved_is_a_position_and_a_velocity_that_are_forgotten():
    # given fixes at uneven times, each of which moves position (m) and velocity (m/s)
    _, memory, r = a_state()
    rng = np.random.default_rng(4)
    times, moves = np.cumsum(rng.uniform(0.2, 1.5, 12)), rng.standard_normal((12, 4))
    scale = np.array([memory[r + Nav.NORTH_SCALE], memory[r + Nav.EAST_SCALE]])
    at = int(memory[Head.EVENTS_AT])
    for time, (north, east, v_n, v_e) in zip(times, moves):
        memory[at + Event.TIME] = time
        fix_drift.note(memory, r, at, 0.0, 0.0)
        add_move(memory, r, r + FixDrift.MOVED, (0.0, 0.0, 0.0, 0.0), (north * scale[0], east * scale[1], v_n, v_e))
        memory[r + Nav.FIX_TIME] = time
    # when a fix comes a second later that is 2 m off to the north and 1 m to the west
    memory[at + Event.TIME] = times[-1] + 1.0
    fix_drift.note(memory, r, at, 2.0, -1.0)
    # then it is from where the filter would be without them by that less the sum of all, each with its age
    age = times[-1] + 1.0 - times
    moved = np.exp(-age / FORGETTING_TIME) @ (moves[:, :2] + age[:, None] * moves[:, 2:])
    assert memory[r + FixDrift.LATEST] == pytest.approx((2.0 - moved[0]) ** 2 + (1.0 + moved[1]) ** 2)


def test_the_second_filter_is_the_first_without_those_fixes():
    # given fixes that jump by 40 m at 40.5 s, and the same drive that ends before
    drive, before = Drive(), Drive()
    drive.position[drive.time > 40.0, 1] += 40.0
    drive.samples, before.samples = drive.samples[:2040], before.samples[:2040]
    before.time, before.position = before.time[before.time < 40.0], before.position[before.time < 40.0]
    drive.time, drive.position = drive.time[drive.time < 41.0], drive.position[drive.time < 41.0]
    _, memory, *_ = drive.through('strapdown')
    _, without, *_ = before.through('strapdown')
    # then while it is open what to believe, the second has the position and velocity of that drive
    assert memory[Bank.OPEN] == 1.0
    other = memory[int(memory[Bank.SIZE]):]
    r = state_at(memory, int(memory[Head.SAMPLES]))
    assert other[r + Hypothesis.FIXES_WRONG] == 1.0
    # (but for the last digits: its intervals are split at the fixes that it leaves)
    np.testing.assert_allclose(other[r:r + Nav.V_D], newest(without)[:Nav.V_D], rtol=1e-6, atol=1e-5)


def test_where_nothing_is_remembered_before_refused_fixes_there_is_no_second_filter():
    # given six fixes in a row that lie 20 m off and are refused, and a filter that cannot go back to before them
    _, memory, r = a_state()
    times = np.arange(6.0)
    memory[r + Nav.TIME], memory[r + Nav.FIX_TIME], memory[Head.FORGOTTEN] = 10.0, 9.0, 1e9
    for column, value in ((Nav.REFUSED, 6.0), (Nav.REFUSED + Line.SINCE, 4.0), (Nav.REFUSED + Line.T, times.sum()),
                          (Nav.REFUSED + Line.TT, times @ times), (Nav.REFUSED + Line.N, 20.0 * 6),
                          (Nav.REFUSED + Line.TN, 20.0 * times.sum()),
                          (Nav.REFUSED + Line.SQUARE, 400.0 * 6), (Hypothesis.SCORE, -50.0),
                          (Hypothesis.OUTLIER_NATS, -100.0), (Receiver.CLAIMED, 2.0)):
        memory[r + column] = value
    assert are_refused(memory, r)
    before = newest(memory)
    # when it compares both
    take_event(memory, fix_event(-1.0))  # far too late: not taken
    # then it is the only one, and as it was
    assert memory[Bank.OPEN] == 0.0 and np.array_equal(newest(memory), before)
