"""What the filter makes of a receiver that repeats itself, jumps, wanders or states another sigma than its own.

A vehicle goes straight on at a constant speed: what is true is known by construction.
"""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_support import (
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    configure,
    fix_event,
    newest,
    started,
    statistics_at,
    take_all,
    take_event,
)
from scipy.linalg import solve_continuous_lyapunov
from scipy.signal import lfilter
from scipy.stats import chi2

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import position_errors
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import (
    Event,
    Head,
    Kind,
    Nav,
    Verdict,
    covariance,
    newest_row,
    state_at,
    variance_factor,
    views,
)
from mems_ins_fusion.filter.runs.odometry import POSE_COVARIANCE, SIZE, TWIST_COVARIANCE, odometry, published_covariance
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.runs.results import MeasurementLog, columns, result
from mems_ins_fusion.filter.start.initial import sensor_errors_of
from mems_ins_fusion.filter.trust.displacement import Integral
from mems_ins_fusion.filter.trust.force_noise import ASSUMED_DENSITY, ForceNoise, force_noise, learn_from_change
from mems_ins_fusion.filter.trust.hypotheses import Hypothesis
from mems_ins_fusion.filter.trust.line import Line, add_to_line, begin_line, fit_line
from mems_ins_fusion.filter.trust.new_start import start_anew
from mems_ins_fusion.filter.trust.receiver import (
    LASTING_TIME,
    SHORT_LOW_PASS,
    lasting_factor,
    realised_factor,
    realised_scatter,
    shown_share,
)
from mems_ins_fusion.filter.trust.receiver import Receiver as OfReceiver
from mems_ins_fusion.filter.trust.scale import PRIOR, Scale, scale
from mems_ins_fusion.navigation.earth import gravity, radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

RATE, SPEED, COURSE, SIGMA = 20.0, 12.0, 0.6, 1.0
TRUST = {'gnss.gate_probability': 0.999999, 'gnss.adapt_sigma': True, 'gnss.robust_sigma': 3.0,
         'gnss.recovery_time': 20.0}
SCALE = np.array([radii(LATITUDE)[0] + HEIGHT, (radii(LATITUDE)[1] + HEIGHT) * math.cos(LATITUDE)])  # m a rad


def true_position(time):
    """North and east, m."""
    return SPEED * np.outer(time, [math.cos(COURSE), math.sin(COURSE)])


class Receiver:
    """A drive of `duration` s with a fix each second, at its true place plus white noise of `scatter` m."""

    def __init__(self, duration=100.0, scatter=SIGMA, seed=1):
        self.rng = np.random.default_rng(seed)
        self.samples = np.zeros((round(duration * RATE), 7))
        self.samples[:, 0] = np.arange(1, len(self.samples) + 1) / RATE
        self.samples[:, 3] = gravity(LATITUDE, HEIGHT)
        self.samples[:, 1:] += self.rng.standard_normal((len(self.samples), 6)) * np.repeat([0.05, 1e-3], 3)
        self.time = np.arange(0.51, duration - 1.0, 1.0)
        self.position = true_position(self.time) + scatter * self.rng.standard_normal((len(self.time), 2))

    def through(self, sigma=SIGMA, mechanization='planar', offset=(0.0, 0.0), yaw=COURSE, late=0.0, **values):
        """Memory, error of the position (k, 2) at each sample, m, and events of the fixes; sigma: as stated; late: s,
        of all fixes or each."""
        config = configure({**TRUST, **values}, mechanization=mechanization)
        n = config.layout.n
        p = np.zeros((n, n))
        first = config.layout.n_navigation
        p[:first, :first] = np.diag(np.square([1, 1, .1, .1, .02] if first == 5 else
                                              [1, 1, 1, .1, .1, .1, .005, .005, .02]))
        p[first:, first:] = np.diag([1e-4 if axis < 3 else 1e-7 for axis in config.channel_axes])
        memory = started(config, velocity=(SPEED * math.cos(COURSE), SPEED * math.sin(COURSE), 0.0),
                         attitude=(0.0, 0.0, yaw), p=p)
        views(memory)[2][0, [Nav.LATITUDE, Nav.LONGITUDE]] += np.array(offset) / SCALE
        events = np.array([fix_event(t, LATITUDE + north / SCALE[0], LONGITUDE + east / SCALE[1],
                                       r=s**2 * np.eye(2)) for t, (north, east), s in
                            zip(self.time, self.position, np.broadcast_to(sigma, len(self.time)))])
        states, events = take_all(memory, self.samples, events, [Nav.LATITUDE, Nav.LONGITUDE], late)
        error = (states - [LATITUDE, LONGITUDE]) * SCALE - true_position(self.samples[:, 0])
        return config, memory, error, events


def verdicts(events):
    return events[:, Event.VERDICT].astype(int)


BOTH = pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])


@BOTH
def test_honest_fixes_are_used(mechanization):
    _, memory, error, events = Receiver().through(mechanization=mechanization)
    assert np.isin(verdicts(events), [Verdict.USED, Verdict.WEIGHTED]).all()
    assert np.mean(verdicts(events) == Verdict.USED) > 0.95
    assert np.hypot(*error.T).max() < 3.5 * SIGMA
    assert newest(memory)[Nav.REFUSED] == 0 == newest(memory)[Nav.RECOVERIES]


@BOTH
def test_a_position_that_repeats_itself_while_the_vehicle_moves_is_refused(mechanization):
    # given a receiver that for 8 s repeats the position that it had
    receiver = Receiver()
    receiver.position[40:48] = receiver.position[39]
    _, _, error, events = receiver.through(mechanization=mechanization)
    assert (verdicts(events)[40:48] == Verdict.FROZEN).all() and not events[40:48, Event.WEIGHT].any()
    assert not (verdicts(events)[:40] == Verdict.FROZEN).any() and verdicts(events)[48] != Verdict.FROZEN
    # then the vehicle is where it is, not 12 m a second behind
    assert np.hypot(*error.T).max() < 5.0
    # and who trusts every fix is pulled behind
    _, _, trusting, used = receiver.through(mechanization=mechanization, **{
        'gnss.gate_probability': 1.0, 'gnss.adapt_sigma': False, 'gnss.robust_sigma': 0.0})
    assert (verdicts(used) == Verdict.USED).all() and np.hypot(*trusting.T).max() > 30.0


def test_a_position_that_repeats_itself_at_rest_is_used():
    # given a receiver that holds its position while the vehicle stands
    config = configure(TRUST)
    memory = started(config, velocity=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag([1, 1, .01, .01, 1e-3,
                                                                                        1e-4, 1e-4, 1e-7]))
    samples = Receiver(30.0).samples
    events = np.array([fix_event(t) for t in np.arange(0.5, 29.0)])
    _, events = take_all(memory, samples, events, [Nav.LATITUDE])
    assert (verdicts(events) == Verdict.USED).all()


def going_straight_on(duration=200.0):
    """A receiver that goes on for 16 s from fix 140 at a velocity that is 1 m/s off, as its last fixes had it."""
    receiver = Receiver(duration)
    gone = receiver.time[140:156, None] - receiver.time[139]
    receiver.position[140:156] = receiver.position[139] + gone * (
        SPEED * np.array([math.cos(COURSE), math.sin(COURSE)]) + [0.6, -0.8])
    return receiver


@BOTH
def test_a_receiver_that_goes_straight_on_is_found_out_before_it_is_wrong(mechanization):
    receiver = going_straight_on()
    _, _, error, events = receiver.through(mechanization=mechanization)
    # those that were believed at first are withdrawn when they depart from the vehicle
    assert (verdicts(events)[140:156] == Verdict.EXTRAPOLATED).all() and not events[140:156, Event.WEIGHT].any()
    others = np.r_[:140, 156:len(events)]
    assert np.isin(verdicts(events)[others], [Verdict.USED, Verdict.WEIGHTED]).all()
    # and it costs no more than coasting through it, and the two sigma by which they depart
    receiver.time, receiver.position = receiver.time[others], receiver.position[others]
    _, _, coasting, _ = receiver.through(mechanization=mechanization)
    assert np.hypot(*error.T).max() < max(np.hypot(*coasting.T).max(), 4.0 * SIGMA)
    # and who trusts every fix follows it
    _, _, trusting, used = going_straight_on().through(mechanization=mechanization, **{
        'gnss.gate_probability': 1.0, 'gnss.adapt_sigma': False, 'gnss.robust_sigma': 0.0})
    assert (verdicts(used) == Verdict.USED).all() and np.hypot(*trusting.T).max() > 7.0


@BOTH
def test_a_receiver_that_goes_straight_on_is_found_out_where_fixes_are_rare(mechanization):
    # given a fix each five seconds, of which four go straight on beside the vehicle
    receiver = Receiver(250.0)
    receiver.time, receiver.position = receiver.time[::5], receiver.position[::5]
    gone = receiver.time[40:44, None] - receiver.time[39]
    receiver.position[40:44] = receiver.position[39] + gone * (
        SPEED * np.array([math.cos(COURSE), math.sin(COURSE)]) + [1.2, -1.6])
    _, _, _, events = receiver.through(mechanization=mechanization)
    # then they are refused, also the one that begins the line
    assert (verdicts(events)[40:44] == Verdict.EXTRAPOLATED).all()
    others = np.r_[:40, 44:len(events)]
    assert np.isin(verdicts(events)[others], [Verdict.USED, Verdict.WEIGHTED]).all()


@BOTH
@pytest.mark.parametrize('scatter, sigma', [(0.0, 3.0), (0.02, 0.02), (0.1, 3.0), (0.3, 3.0), (1.5, 1.5)])
def test_a_receiver_that_measures_never_passes_for_one_that_goes_straight_on(mechanization, scatter, sigma):
    # also where it scatters by far less than it claims, and the vehicle does go straight on
    _, _, _, events = Receiver(400.0, scatter=scatter).through(mechanization=mechanization, sigma=sigma)
    assert not (verdicts(events) == Verdict.EXTRAPOLATED).any()


def last_fix_off(sigmas, mechanization):
    """The event of a last fix that is so many sigmas of its innovation north of what is predicted, and the memory."""
    receiver, values = Receiver(20.0), {'gnss.adapt_sigma': False, 'mechanization': mechanization}
    receiver.position[-1] = true_position(receiver.time[-1:])
    r = receiver.through(**values)[3][-1]
    s = np.array([[r[Event.S_NN], r[Event.S_NE]], [r[Event.S_NE], r[Event.S_EE]]])
    receiver.position[-1] += r[[Event.Z_N, Event.Z_E]] - np.linalg.cholesky(s)[:, 0] * sigmas
    _, memory, _, events = receiver.through(**values)
    return events[-1], memory


@BOTH
def test_the_gate_is_where_the_share_of_honest_fixes_says(mechanization):
    limit = math.sqrt(-2 * math.log(1e-6))
    for factor, verdict in ((0.97, Verdict.WEIGHTED), (1.03, Verdict.REFUSED)):
        event, memory = last_fix_off(factor * limit, mechanization)
        assert event[Event.VERDICT] == verdict
        assert event[Event.NIS] == pytest.approx((factor * limit) ** 2, rel=1e-3)
        assert newest(memory)[Nav.REFUSED] == (verdict == Verdict.REFUSED)


@BOTH
def test_a_fix_beyond_three_sigma_counts_as_if_it_were_three(mechanization):
    for sigmas, verdict, weight in ((2.9, Verdict.USED, 1.0), (4.0, Verdict.WEIGHTED, 9 / 16)):
        event, _ = last_fix_off(sigmas, mechanization)
        assert event[Event.VERDICT] == verdict and event[Event.WEIGHT] == pytest.approx(weight, rel=1e-3)


def test_a_fix_within_five_metres_is_not_refused():
    # given a filter that is sure to the centimetre, and a fix of a centimetre that is 4 m off: hundreds of sigma
    receiver = Receiver(20.0, scatter=0.01)
    receiver.position[10] += [4.0, 0.0]
    _, _, _, events = receiver.through(sigma=0.01, **{'gnss.adapt_sigma': False})
    assert events[10, Event.NIS] > 400 and verdicts(events)[10] == Verdict.WEIGHTED
    receiver.position[10] += [2.0, 0.0]
    _, _, _, events = receiver.through(sigma=0.01, **{'gnss.adapt_sigma': False})
    assert verdicts(events)[10] == Verdict.REFUSED


@BOTH
@pytest.mark.parametrize(('jump', 'recovery'), [(100.0, 20.0), (400.0, 10.0)])
def test_fixes_that_agree_are_believed_after_the_stated_time(mechanization, jump, recovery):
    # given a filter that is far off and sure of it, and a receiver that is right
    receiver = Receiver()
    config, memory, error, events = receiver.through(mechanization=mechanization, offset=(0.6 * jump, -0.8 * jump),
                                                      yaw=COURSE, **{'gnss.recovery_time': recovery})
    # then what is published is as far off for that time, as the fixes may be wrong, and right from then on, to what it
    # says
    off = np.hypot(*error.T)
    first = receiver.samples[np.flatnonzero(off < 0.5 * jump)[0], 0]
    assert recovery <= first - receiver.time[0] < recovery + 2.5
    after = receiver.samples[:, 0] > first + 5.0
    assert off[after].max() < 5.0
    got, used = verdicts(events), (Verdict.USED, Verdict.WEIGHTED, Verdict.RECOVERED)
    assert np.isin(got[receiver.time > first], used).all() and newest(memory)[Nav.RECOVERIES] == 1
    p = covariance(newest(memory), config.layout)
    assert error[-1] @ np.linalg.solve(p[:2, :2], error[-1]) < 14.0


@pytest.mark.parametrize('which', [0, 1])
def test_a_restart_from_fixes_is_counted_once_where_they_overtake_each_other(which):
    # given the same filter, and every second fix so late that the next one comes before it
    receiver = Receiver()
    late = np.where(np.arange(len(receiver.time)) % 2 == which, 1.5, 0.0)
    _, memory, _, events = receiver.through(offset=(60.0, -80.0), late=late, **{'gnss.max_delay': 3.0})
    # then it starts anew once, also where the filter goes back behind the restart
    assert np.count_nonzero(verdicts(events) == Verdict.RECOVERED) == 1 == newest(memory)[Nav.RECOVERIES]


def test_a_new_start_forgets_how_large_the_innovations_of_the_old_state_were():
    # given a filter whose innovations have been ten times as large as expected
    receiver = Receiver()
    _, memory, _, _ = receiver.through()
    at = state_at(memory, int(memory[Head.SAMPLES]))
    level = at + OfReceiver.INNOVATION_SCALE
    memory[at + Nav.VARIANCE_FACTOR], memory[level] = 100.0, math.log(100.0)
    # when it starts anew from two fixes that it had refused, a second apart
    memory[at + Nav.REFUSED], memory[at + Nav.REFUSED + Line.T], memory[at + Nav.REFUSED + Line.TT] = 2.0, 1.0, 1.0
    start_anew(memory, at, int(memory[Head.EVENTS_AT]))
    # then its sigmas are those of the new state
    assert memory[at + Nav.VARIANCE_FACTOR] == 1.0 and memory[level] == 0.0


def test_fixes_among_refused_ones_never_decide_alone():
    # given a receiver that from now on is 4 m and 50 m off in turn, each in another direction
    receiver = Receiver(scatter=0.1)
    count = len(receiver.time) - 40
    angle = receiver.rng.uniform(-math.pi, math.pi, count)
    off = np.where(np.arange(count) % 2 == 0, 4.0, 50.0)
    receiver.position[40:] += off[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    _, _, _, events = receiver.through(0.1, **{'gnss.adapt_sigma': False})
    # then none that does not fit is used as it is, as a row of fixes is that are off alike
    used = verdicts(events) == Verdict.USED
    assert used[:40].all() and events[used, Event.NIS].max() < 9.0


def test_refused_fixes_that_do_not_agree_do_not_win():
    # given a receiver that for the rest of the drive is somewhere within 200 m
    receiver = Receiver()
    receiver.position[40:] += 200.0 * receiver.rng.standard_normal(receiver.position[40:].shape)
    _, memory, _, events = receiver.through(**{'gnss.adapt_sigma': False})
    assert newest(memory)[Nav.RECOVERIES] == 0
    far = np.hypot(*(receiver.position[40:] - true_position(receiver.time[40:])).T) > 60
    assert (verdicts(events)[40:][far] == Verdict.REFUSED).all()


# at 0.2 Hz the way in between hides a scatter of 75 times the claim; the start finds it (test_alignment.py)
@pytest.mark.parametrize(('factor', 'apart'), [(factor, apart) for factor in (1.0, 3.0, 8.0, 75.0, 0.3, 0.1)
                                               for apart in (1, 5) if factor < 75.0 or apart == 1])
@BOTH
def test_the_realised_sigma_of_the_receiver_is_learned(mechanization, factor, apart):
    # given a receiver that states a sigma of 1 m and scatters by `factor` as much, with a fix each second or each five
    receiver = Receiver(200.0 * apart, scatter=SIGMA)
    receiver.time, receiver.position = receiver.time[::apart], receiver.position[::apart]
    _, memory, error, events = receiver.through(sigma=SIGMA / factor, mechanization=mechanization, **{
        'gnss.adapt_covariance': True})
    ratio = math.sqrt(scale(newest(memory), OfReceiver.SCALE))
    if mechanization == 'strapdown' or apart == 1:
        assert 0.65 * factor < ratio < 2.2 * factor  # at 0.2 Hz the way in between hides a scatter of 0.1 m
    if mechanization == 'planar':  # its own errors, slopes, would pass for the receiver's: it is told, not used
        as_stated = receiver.through(sigma=SIGMA / factor, **{'gnss.adapt_sigma': False})[2]
        assert np.array_equal(error, as_stated)
        return
    # then the filter's NIS is that of the real one, or that of one whose errors may last, and it is as good as if told
    if factor >= 1.0:
        assert np.median(events[60:, Event.NIS]) == pytest.approx(2 * math.log(2), rel=0.6)
        late = len(error) // 3
        told = receiver.through(SIGMA, mechanization)[2]
        assert np.sqrt(np.mean(error[late:]**2)) < 1.3 * np.sqrt(np.mean(told[late:]**2))


@pytest.mark.parametrize('factor', [1e-3, 0.05, 20.0])
@pytest.mark.parametrize('before', [1.0, 5.0])
def test_a_claim_that_changes_at_once_changes_nothing_of_what_has_been_seen(factor, before):
    # given fixes that scatter by 1 m and claim as much, or five times that, and from 60 s on `factor` of it
    receiver = Receiver(70.0, scatter=SIGMA)
    last = int(np.flatnonzero(receiver.time > 60.0)[0])
    claims = before * np.where(receiver.time > 60.0, factor, 1.0)
    lasts, realised = [], []
    for end in (last, last + 1):
        shorter = Receiver(70.0, scatter=SIGMA)
        shorter.time, shorter.position = receiver.time[:end], receiver.position[:end]
        _, memory, *_ = shorter.through(claims[:end], 'strapdown', **{'gnss.adapt_covariance': True})
        row = newest(memory)
        lasts.append(row[Nav.LASTING])
        realised.append(scale(row, OfReceiver.SCALE) * claims[end - 1] ** 2)
    # then the first of them is believed as what has been seen, to what one fix may show, or less where it claims so
    assert realised[0] / 4.0 < realised[1] < 4.0 * max(realised[0], claims[last] ** 2)
    # and the variance of errors that last is no larger than it was, or than what is claimed now
    assert lasts[1] < 4.0 * max(lasts[0], claims[last] ** 2)


def test_a_claim_that_is_too_large_is_left_where_the_errors_are_white():
    # given a drive with the sensors that the parameters describe, and a receiver that claims ten times what it scatters
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    rms = {'left': [], 'believed': [], 'right': []}
    for seed in (3, 4):
        drive = simulate_drive(900.0, seed, standstill=20.0)
        drive = simulate_recording(drive, sensors, GnssNoise(1.5), seed=seed).recording
        large = replace(drive.gnss, covariance=100.0 * drive.gnss.covariance)
        for how, fixes, adapts in (('left', large, True), ('believed', large, False), ('right', drive.gnss, True)):
            config = FilterConfig.from_parameters(table.check({'gnss.adapt_sigma': adapts}))
            truth = truth_of(drive, config.parameters)
            errors = position_errors(run(config, drive.imu, fixes), truth, np.zeros(len(truth), dtype=bool))
            rms[how].append(np.sqrt(np.mean(errors.horizontal[len(errors.horizontal) // 2:]**2)))
    rms = {how: np.mean(found) for how, found in rms.items()}
    # then it is nearly as good as one that claims what is right; believed it is three times as far off
    assert rms['left'] < 1.5 * rms['right'] and rms['believed'] > 3.0 * rms['right'], rms


def test_a_claim_that_is_too_large_for_the_scatter_is_believed_where_the_errors_last():
    # given a receiver that is off by what it claims for tens of seconds, and scatters by a tenth of that
    believed, scattered, worse = [], [], []
    for seed in range(4):
        receiver = Receiver(500.0, seed=seed)
        scatter = 0.1 * SIGMA * receiver.rng.standard_normal((len(receiver.time), 2))
        receiver.position = lasting(receiver, 15.0) + scatter
        _, memory, error, _ = receiver.through(SIGMA, 'strapdown')
        as_claimed = receiver.through(SIGMA, 'strapdown', **{'gnss.adapt_sigma': False})[2]
        worse.append(np.sqrt(np.mean(error**2) / np.mean(as_claimed**2)))
        believed.append(scale(newest(memory), OfReceiver.SLOW_SCALE))
        scattered.append(scale(newest(memory), OfReceiver.SCALE))
    # then it counts with more than what differs from one second to the next, of which half is the scatter
    changes = 1.0 - math.exp(-1.0 / 15.0) + 0.1**2
    assert np.mean(scattered) == pytest.approx(changes, rel=0.5) and min(believed) > 3.0 * changes, believed
    assert np.mean(worse) < 1.1, worse


@pytest.mark.parametrize('apart', [1, 4, 6])
@BOTH
def test_good_fixes_pull_back_a_filter_that_is_too_sure_however_far_apart_they_are(mechanization, apart):
    # given accelerometers that go off by far more than the filter knows of, and a receiver that is right
    receiver = Receiver(duration=300.0, scatter=0.02)
    receiver.samples[:, 2] += 0.2 * np.sin(2 * np.pi * receiver.samples[:, 0] / 80.0)
    receiver.time, receiver.position = receiver.time[::apart], receiver.position[::apart]
    rms = {}
    for robust in (0.0, 3.0):
        _, memory, error, events = receiver.through(0.02, mechanization, **{'gnss.robust_sigma': robust})
        rms[robust] = np.sqrt((error**2).sum(axis=1).mean())
    # then weighting down what does not fit costs little: it is not the receiver that errs
    assert not np.isin(verdicts(events), [Verdict.REFUSED, Verdict.RECOVERED]).any()
    assert rms[3.0] < 3.0 * rms[0.0] + 0.1, rms


def long_run_variance(events, span=12):
    """Of the whitened innovations, both components: sum of their autocovariances up to `span` fixes (Bartlett)."""
    used = events[20:]
    whitened = np.array([np.linalg.solve(np.linalg.cholesky(
        [[r[Event.S_NN], r[Event.S_NE]], [r[Event.S_NE], r[Event.S_EE]]]), r[[Event.Z_N, Event.Z_E]]) for r in used])
    return np.mean([sum((1 if k == 0 else 2 * (1 - k / span)) * np.mean(u[:len(u) - k] * u[k:]) for k in range(span))
                    for u in whitened.T])


def lasting(receiver, tau):
    """Its errors, of 1 m, with a correlation time of `tau` s."""
    keep = math.exp(-1.0 / tau)
    error = np.empty((len(receiver.time), 2))
    error[0] = receiver.rng.standard_normal(2)
    for k in range(1, len(error)):
        error[k] = keep * error[k - 1] + math.sqrt(1 - keep**2) * receiver.rng.standard_normal(2)
    return true_position(receiver.time) + SIGMA * error


@BOTH
def test_a_receiver_whose_errors_last_raises_the_covariance_and_moves_no_estimate(mechanization):
    steady = {'accelerometer.gauss_markov.sigma': [0.003], 'gyroscope.gauss_markov.sigma': [2e-5]}
    factor, realised = {'white': [], 'lasting': []}, []
    for seed in range(4):
        receiver = Receiver(300.0, seed=seed)
        for errors in factor:
            if errors == 'lasting':
                receiver.position = lasting(receiver, 4.0)
            (_, memory, error, events), (_, without, same, _) = [receiver.through(mechanization=mechanization, **{
                'gnss.adapt_covariance': adapts}, **steady) for adapts in (True, False)]
            factor[errors].append(newest(memory)[Nav.VARIANCE_FACTOR])
            assert np.array_equal(error, same) and variance_factor(newest(without), 0) == 1.0
        realised.append(long_run_variance(events))
    # then it is the realised variance of the slow innovations, and that of white ones is as expected, not more
    assert np.mean(factor['white']) < 1.2 and np.mean(factor['lasting']) > 1.3 * np.mean(factor['white']), factor
    assert 0.5 < np.mean(factor['lasting']) / np.mean(realised) < 1.3, (factor, realised)


def test_one_fix_far_off_is_no_filter_that_is_too_sure():
    # given white errors, and from time to time a fix that is ten sigma off
    receiver = Receiver(300.0)
    receiver.position[20::40] += [10.0, 0.0]
    _, memory, _, _ = receiver.through(mechanization='strapdown', **{'gnss.adapt_covariance': True})
    assert newest(memory)[Nav.VARIANCE_FACTOR] < 1.7


def published(config, memory, **columns_of_row):
    """Variances that leave the filter with these columns of its newest row: position, velocity and others."""
    row = newest_row(memory)
    for name, value in columns_of_row.items():
        row[getattr(Nav, name)] = value
    out, covariance_enu = np.zeros(SIZE), np.zeros(9)
    odometry(memory, np.array([LATITUDE, LONGITUDE, HEIGHT]), 2.0, out, np.zeros(3), covariance_enu)
    states = row[columns(config.layout).astype(np.int64)][None]
    run = result(config, np.zeros(1, np.int64), np.zeros(1, np.int64), states,
                 MeasurementLog(*np.zeros((3, 0), np.int64), np.zeros((0, Event.SIZE))), start=None, notices=[],
                 memory=memory, filter_seconds=0.0)
    position = [*out[POSE_COVARIANCE:][[0, 7]], *covariance_enu[[0, 4]], *run.sigma[0, :2] ** 2]
    others = [out[POSE_COVARIANCE + 35], out[POSE_COVARIANCE + 1], out[TWIST_COVARIANCE], *run.sigma[0, 2:] ** 2,
              *run.covariance_ne, *sensor_errors_of(config, memory).covariance.diagonal()]
    return np.array(position), np.array(others)


@BOTH
def test_the_factor_is_in_all_that_is_published(mechanization):
    config, memory, _, _ = Receiver(30.0).through(mechanization=mechanization, **{'gnss.adapt_covariance': True})
    r = state_at(memory, int(memory[Head.SAMPLES]))
    memory[r + Hypothesis.SPREAD:r + Hypothesis.SPREAD + 4] = 0.0
    for one, four in zip(published(config, memory, VARIANCE_FACTOR=1.0, LASTING=0.0),
                         published(config, memory, VARIANCE_FACTOR=4.0)):
        np.testing.assert_allclose(four, 4.0 * one, rtol=1e-9)


@BOTH
def test_what_fixes_claim_and_do_not_scatter_is_taken_for_errors_that_last(mechanization):
    # given a receiver that is white, and one that claims the same, of which an error that lasts is the larger part
    share, white, tau = {'white': [], 'lasting': []}, 0.6, 40.0
    for seed in range(3):
        for kind, found in share.items():
            receiver = Receiver(300.0, seed=seed)
            if kind == 'lasting':
                slow = lasting(receiver, tau) - true_position(receiver.time)
                receiver.position = (true_position(receiver.time) + math.sqrt(1 - white**2) * slow
                                     + white * SIGMA * receiver.rng.standard_normal((len(receiver.time), 2)))
            (_, memory, error, _), (_, without, same, _) = [receiver.through(mechanization=mechanization, **{
                'gnss.adapt_covariance': adapts}) for adapts in (True, False)]
            found.append(newest(memory)[Nav.LASTING] / SIGMA**2)
            # then no estimate has moved
            assert np.array_equal(error, same) and newest(without)[Nav.LASTING] == 0.0
    # of what is claimed, what two fixes a second apart do not show
    unseen = (1 - white**2) * math.exp(-1.0 / tau)
    assert np.mean(share['white']) < 0.2 and 0.7 * unseen < np.mean(share['lasting']) < 1.3 * unseen, share


def test_errors_that_last_go_with_what_is_claimed_now():
    adapts = {'mechanization': 'strapdown', 'gnss.adapt_covariance': True}
    seldom, lost = [], []
    for seed in range(3):
        # given a receiver whose errors last, as large as it claims, but that now and then claims ten times as much
        receiver = Receiver(300.0, seed=seed)
        slow = lasting(receiver, 40.0) - true_position(receiver.time)
        receiver.position = true_position(receiver.time) + 0.95 * slow + 0.3 * SIGMA * receiver.rng.standard_normal(
            slow.shape)
        claims = np.where(np.arange(len(receiver.time)) % 10 == 5, 10.0 * SIGMA, SIGMA)
        seldom.append(newest(receiver.through(sigma=claims, **adapts)[1])[Nav.LASTING])
        # and one that after four minutes has lost what made it a hundred times as good
        size = np.where(receiver.time < 240.0, 0.01, 1.0)
        receiver.position = true_position(receiver.time) + size[:, None] * slow
        lost.append(newest(receiver.through(sigma=size * SIGMA, **adapts)[1])[Nav.LASTING])
    # then their variance is found, larger by what its expectation is above the median
    assert 0.7 * SIGMA**2 < np.mean(seldom) < 2.0 * SIGMA**2 and 0.7 * SIGMA**2 < np.mean(lost) < 2.0 * SIGMA**2, (
        seldom, lost)


@pytest.mark.parametrize('level, variance', [(1.0, 0.5), (2.0, 1.0), (0.1, 3.0), (-1.0, 0.0)])
def test_errors_that_last_have_their_expected_variance(level, variance, rng=np.random.default_rng(8)):
    # given what is known of the logarithm of a factor on their variance
    memory = started(configure({**TRUST}))
    r = state_at(memory, 0)
    memory[r + OfReceiver.LASTING_SCALE] = level
    memory[r + OfReceiver.LASTING_SCALE + Scale.REDUCED] = PRIOR - variance
    # then the factor is its expectation, at most its square (where it is hardly known), and 1 if innovations do not
    # exclude the claim
    expected = min(np.exp(rng.normal(level, math.sqrt(variance), 1_000_000)).mean(), math.exp(2.0 * level))
    assert lasting_factor(memory, r) == pytest.approx(expected if level > 0.0 else 1.0, rel=0.01)


def rare(receiver):
    """`receiver` with each fifth of its fixes."""
    receiver.time, receiver.position = receiver.time[::5], receiver.position[::5]
    return receiver


def shaken(receiver, size=0.3, tau=2.0):
    """Its samples with errors of the accelerometers of `size`, m/s^2, and a correlation time of `tau`, s."""
    keep = math.exp(-1.0 / (RATE * tau))
    white = receiver.rng.standard_normal((len(receiver.samples), 3))
    receiver.samples[:, 1:4] += size * lfilter([math.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0)
    return receiver


@pytest.mark.parametrize('scatter', [0.05, 1.0])
def test_noise_of_the_accelerometers_that_only_the_fixes_show_is_learned(scatter):
    # given accelerometers that err by 0.3 m/s^2 for seconds, a hundred times what is configured, and a sharp receiver
    # or an ordinary one
    learned, rms, alone, behind = [], [], [], []
    for seed in range(2):
        for found, learns in ((rms, True), (alone, False)):
            receiver = shaken(Receiver(300.0, scatter, seed))
            _, memory, error, events = receiver.through(
                scatter, 'strapdown', **{'gnss.adapt_covariance': True, 'vehicle.learn_drift': learns})
            found.append(np.sqrt(np.mean(error[len(error) // 2:] ** 2)) / scatter)
            if learns:
                r = state_at(memory, int(memory[Head.SAMPLES]))
                learned.append(force_noise(memory, r))
                known = np.searchsorted(receiver.samples[:, 0], receiver.time[len(receiver.time) // 2:], side='right')
                behind.append(np.sqrt(np.mean(error[known[known < len(error)]] ** 2)) / scatter)
        # then no fix passes for one of a receiver that goes straight on, though the vehicle does, to the centimetre
        assert not np.any(verdicts(events) == Verdict.EXTRAPOLATED)
    # then the noise is, to a factor, what such errors are to the velocity over seconds, 2 sigma^2 tau
    assert all(0.1 * 0.36 < q < 1.5 * 0.36 for q in learned), learned
    # and the filter is near the fixes, a second behind one off by what that scatters and by 0.2 m, what the
    # accelerometers err by. Without that it is carried away, and at last takes the IMU for wrong
    assert max(behind) < 1.2, behind  # behind a fix it is as near as that
    assert np.max(rms) < np.hypot(1.2, 0.2 / scatter) < np.min(alone), (rms, alone)


def test_noise_of_the_accelerometers_is_learned_from_rare_fixes_too():
    # given accelerometers that err by 0.3 m/s^2 for seconds, and an ordinary receiver with a fix each five seconds
    rms, learned, refused = [], [], []
    for seed in range(5):
        receiver = rare(shaken(Receiver(300.0, 1.0, seed)))
        _, memory, error, events = receiver.through(1.0, 'strapdown', **{'gnss.adapt_covariance': True,
                                                                         'vehicle.learn_drift': True})
        used = np.searchsorted(receiver.samples[:, 0], receiver.time, side='right')
        rms.append(np.sqrt(np.mean(error[used] ** 2)))
        refused.append(np.mean(verdicts(events) == Verdict.REFUSED))
        learned.append(force_noise(memory, state_at(memory, int(memory[Head.SAMPLES]))))
    # then it is found, to a factor; few fixes are refused, and where they come the filter is as near as they are, but
    # for those that come before the noise is known
    assert all(0.1 * 0.36 < q < 1.5 * 0.36 for q in learned), learned
    assert np.mean(refused) < 0.05 and np.median(rms) < 1.5, (refused, rms)


@pytest.mark.parametrize('prepared', [lambda receiver: receiver, lambda receiver: rare(receiver)], ids=['1 s', '5 s'])
def test_accelerometers_that_are_as_configured_have_no_noise_beside_that(prepared):
    for scatter in (0.05, 1.0):
        _, memory, _, _ = prepared(Receiver(300.0, scatter)).through(
            scatter, 'strapdown', **{'vehicle.learn_drift': True})
        assert force_noise(memory, state_at(memory, int(memory[Head.SAMPLES]))) == 0.0


@pytest.mark.parametrize('density', [0.0, 0.4])
def test_rare_fixes_show_whether_noise_that_was_found_is_still_there(density, rng=np.random.default_rng(7)):
    # given noise of the accelerometers of 0.4 m^2/s^3, as a restart finds it, and fixes of 1.5 m each five
    # seconds, whose second differences have the variance of that noise, or of none
    share, scatter = 5.0**2 * 10.0 / 3.0, 6.0 * 1.5**2
    _, memory, _, _ = Receiver(20.0).through(1.5, 'strapdown', **{'vehicle.learn_drift': True})
    r = state_at(memory, int(memory[Head.SAMPLES]))
    memory[r + ForceNoise.SCALE] = math.log(1.0 + 0.4 / ASSUMED_DENSITY)
    learned = []
    for k in range(200):
        squared = 0.5 * np.sum(rng.normal(0.0, math.sqrt(scatter + density * share), 2) ** 2)
        learn_from_change(memory, r, 10.0 * k, squared, share, scatter)
        learned.append(force_noise(memory, r))
    # then it is as found, or less than what fixes of that scatter hide
    middle = np.median(learned[50:])
    assert 0.5 * 0.4 < middle < 1.5 * 0.4 if density else middle < 0.25 * scatter / share, middle


def test_what_fixes_claim_and_do_not_scatter_is_no_noise_of_the_accelerometers():
    # given a receiver whose errors last, as large as it claims
    receiver = Receiver(300.0)
    receiver.position = lasting(receiver, 5.0)
    _, memory, _, _ = receiver.through(2.0 * SIGMA, 'strapdown', **{'vehicle.learn_drift': True})
    assert force_noise(memory, state_at(memory, int(memory[Head.SAMPLES]))) == 0.0


def test_accelerometers_that_are_wrong_are_no_scatter_of_the_receiver():
    # given a receiver to five centimetres, as it claims, and accelerometers that err by more between two fixes
    _, memory, _, _ = shaken(Receiver(120.0, 0.05)).through(0.05, 'strapdown')
    # then three fixes on a line say so; by what the accelerometers see it would be tens of times
    assert realised_scatter(memory, state_at(memory, int(memory[Head.SAMPLES]))) < 4.0


def test_errors_that_last_are_not_larger_than_a_claim_may_be_wrong():
    # given accelerometers that are wrong, which innovations show as they show errors of the receiver that last
    _, memory, _, _ = shaken(Receiver(200.0, 0.1)).through(0.1, 'strapdown', **{'gnss.adapt_covariance': True})
    r = state_at(memory, int(memory[Head.SAMPLES]))
    realised = max(1.0, scale(memory, r + OfReceiver.SCALE))
    assert 0.0 < memory[r + Nav.LASTING] <= 9.0 * realised * 0.1**2 * (1.0 + 1e-9)


@pytest.mark.parametrize('tau', [SHORT_LOW_PASS, SHORT_LOW_PASS / 3.0, SHORT_LOW_PASS / 10.0])
def test_what_of_lasting_errors_shows_is_what_a_filter_of_position_and_velocity_leaves(tau):
    # given a random walk that such a filter follows within tau, and a low pass of its innovations
    rate = 1.0 / SHORT_LOW_PASS
    a = np.array([[-1.0 / tau, -0.5 / tau**2, 0.0], [1.0, 0.0, 0.0], [rate, 0.0, -rate]])
    noise = np.diag([2.0 / LASTING_TIME, 0.0, 0.0])  # of the process with variance 1
    # then what is left is the variance of a linear system in its steady state
    assert shown_share(tau) == pytest.approx(solve_continuous_lyapunov(a, -noise)[2, 2], rel=1e-9)


@pytest.mark.parametrize('level', [-4.0, -1.0])
def test_before_anything_has_shown_a_claim_is_believed_half_way_to_the_scatter(level):
    # given a receiver that has been seen at rest to scatter less than it claims, for certain
    memory = np.zeros(int(Head.SIZE) + 10_000)
    memory[Head.ADAPT] = 1.0
    r = int(Head.SIZE)
    memory[r + OfReceiver.SCALE + Scale.LOG], memory[r + OfReceiver.SCALE + Scale.REDUCED] = level, PRIOR
    assert realised_factor(memory, r) == pytest.approx(math.exp(0.5 * level))
    # and once innovations have shown how much of it lasts: that
    memory[r + OfReceiver.SLOW_SCALE + Scale.LOG], memory[r + OfReceiver.SLOW_SCALE + Scale.REDUCED] = -0.2, PRIOR
    assert realised_factor(memory, r) == pytest.approx(math.exp(-0.2))


@pytest.mark.parametrize('tau', [60.0, 300.0, 1000.0])
def test_errors_that_are_claimed_rightly_are_in_the_ellipse_however_slow_they_are(tau):
    # given receivers that claim 2 m rightly, of which all but 0.3 m changes within tau
    squared, claim, white = [], 2.0, 0.3
    for seed in range(12):
        receiver = Receiver(400.0, seed=seed)
        slow = lasting(receiver, tau) - true_position(receiver.time)
        receiver.position = (true_position(receiver.time) + slow * math.sqrt(claim**2 - white**2) / SIGMA
                             + white * receiver.rng.standard_normal((len(receiver.time), 2)))
        config, memory, error, _ = receiver.through(claim, 'strapdown', **{'gnss.adapt_covariance': True})
        found = published_covariance(newest_row(memory), config.layout)[:2, :2]
        squared.append(error[-1] @ np.linalg.solve(found, error[-1]) / 2.0)
    # then the squared error over its expectation has a mean of one: twelve of two degrees of freedom each
    low, high = chi2.ppf([0.001, 0.999], 2 * 12) / (2 * 12)
    assert low < np.mean(squared) < high, squared


@BOTH
def test_errors_that_last_are_in_the_position_that_is_published(mechanization):
    config, memory, _, _ = Receiver(30.0).through(mechanization=mechanization, **{'gnss.adapt_covariance': True})
    (position, others), (more, same) = [published(config, memory, LASTING=v) for v in (0.0, 2.5)]
    np.testing.assert_allclose(more, position + 2.5, rtol=1e-9)
    np.testing.assert_array_equal(same, others)


@pytest.mark.parametrize('refused', [2, 3])
def test_a_way_ends_at_a_refused_fix_only_where_three_before_it_were_refused(refused):
    # given a filter that has refused so many fixes in a row, and a wheel speed whose way has not begun
    config, memory, _, _ = Receiver(20.0).through(**{
        'gnss.adapt_sigma': False, 'speed_topic': '/speed', 'speed.scale_sigma': 0.0, 'speed.time_offset_sigma': 0.0})
    way, now = statistics_at(config, Kind.SPEED), newest(memory)[Nav.TIME]
    views(memory)[2][:, [Nav.REFUSED, way + Integral.TIME, way + Integral.START]] = refused, now - 0.1, 0.0
    # when it refuses one more, which is some hundred metres off
    take_event(memory, fix_event(now - 0.01, LATITUDE + 1e-4))
    assert newest(memory)[Nav.REFUSED] == refused + 1
    # then a way begins there only if all of them cannot be outliers
    assert (newest(memory)[way + Integral.START] != 0.0) == (refused == 3)


def test_a_filter_has_not_strayed_from_refused_fixes_that_scatter():
    # given a receiver whose scatter becomes thirty times what it claims, so that its fixes are refused at first
    for seed in range(8):
        receiver = Receiver(120.0, seed=seed)
        receiver.position[40:] += 30.0 * receiver.rng.standard_normal(receiver.position[40:].shape)
        memory = receiver.through(mechanization='strapdown')[1]
        # then it is not said of the IMU that it has led astray, nor the velocity taken from two of them
        assert newest(memory)[Nav.DIVERGENCE_TIME] == 0.0


def test_sums_over_positions_give_the_line_of_least_squares():
    # given positions about a line
    rng = np.random.default_rng(4)
    time = np.sort(rng.uniform(100.0, 130.0, 20))
    north, east = 0.7 * time + rng.standard_normal(20), 3.0 - 0.2 * time + rng.standard_normal(20)
    memory = rng.standard_normal(Line.SIZE + 2)
    begin_line(memory, 2, time[0])
    for values in zip(time, north, east):
        add_to_line(memory, 2, *values)
    slope_n, slope_e, left, variance = fit_line(memory, 2)
    # then NumPy's line through them has these slopes, this mean square distance, and this variance of a slope
    lines, covariances = zip(*(np.polyfit(time, z, 1, cov=True) for z in (north, east)))
    assert [slope_n, slope_e] == pytest.approx([line[0] for line in lines])
    squares = [np.mean((z - np.polyval(line, time)) ** 2) for z, line in zip((north, east), lines)]
    assert left == pytest.approx(sum(squares), rel=1e-6)
    assert variance == pytest.approx(np.mean([covariance[0, 0] for covariance in covariances]))
