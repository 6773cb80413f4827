"""Whether the vehicle crept while it seemed to stand: the likelihood of fixes, and the correction of the state."""
from __future__ import annotations

import numpy as np
import pytest
from filter_support import LATITUDE, configure, fix_event, random_covariance, started, take_all
from scipy.stats import multivariate_normal
from test_filter_standstill import METRES, quiet

from mems_ins_fusion.filter.memory import NAV, Event, Head, Nav, event_at, state_at, velocity_state
from mems_ins_fusion.filter.trust.creep import CREEP_VARIANCE, Creep, correct, crept, note_correction, note_standstill
from mems_ins_fusion.filter.trust.standstill import Standing, odds_of_standing
from mems_ins_fusion.filter.update import begin_update

YAW, ODDS, SIGMA = 0.5, 100.0, 3.0
FORWARD = np.array([np.cos(YAW), np.sin(YAW)])
PLANAR = {'mechanization': 'planar', 'feedback': 'closed', 'vehicle.zero_velocity': True}


def at_first_update(p=None):
    """A memory with one state, position of the state, of P and number of states, at the first zero-velocity update."""
    config = configure(PLANAR)
    n = config.layout.n
    memory = started(config, attitude=(0.0, 0.0, YAW), p=np.diag([4.0, 4.0, 0.25, 0.25] + [1e-4] * (n - 4))
                     if p is None else p(n))
    r = state_at(memory, 0)
    begin_update(memory, r)
    at = int(memory[Head.SCRATCH_AT])
    note_standstill(memory, r, at, n, 0.1, 0.0, ODDS)
    return memory, r, at, n


@pytest.mark.parametrize('speed', [0.0, 0.2, 0.4])
def test_a_creep_is_as_likely_as_all_its_fixes_together(speed):
    # given by how much eight fixes, 2 s apart, are ahead of a filter that they do not correct
    memory, r, _, _ = at_first_update()
    time, event = 2.0 * np.arange(1, 9), event_at(memory, 0)
    ahead = speed * time[:, None] * FORWARD + SIGMA * np.random.default_rng(1).standard_normal((8, 2))
    memory[r + Standing.TIME] = time[-1]
    for seconds, difference in zip(time, -ahead):
        memory[event + Event.TIME] = seconds
        memory[event + Event.Z_N:event + Event.Z_N + 2] = difference
        crept(memory, r, event, SIGMA**2, 0.0)
    # then the odds are those of SciPy's joint densities: noise alone, or the same unknown velocity in all of them
    design, noise = np.kron(time[:, None], np.eye(2)), SIGMA**2 * np.eye(16)
    stood, moved = (multivariate_normal(np.zeros(16), covariance).logpdf(ahead.ravel())
                    for covariance in (noise, noise + CREEP_VARIANCE * design @ design.T))
    assert np.log(memory[r + Creep.ODDS]) == pytest.approx(np.log(ODDS) + stood - moved, abs=0.1)
    # and the velocity is that of least squares with its prior
    weight = 1.0 / CREEP_VARIANCE + time @ time / SIGMA**2
    assert memory[r + Creep.VELOCITY:r + Creep.VELOCITY + 2] == pytest.approx(time @ ahead / SIGMA**2 / weight)
    assert memory[r + Creep.VARIANCE] == pytest.approx(1.0 / weight)


def test_the_speed_of_a_creep_is_found_although_fixes_correct_the_filter():
    # given a filter whose position follows fixes by a quarter of their difference, and a vehicle that creeps at 0.9 m/s
    memory, r, _, _ = at_first_update()
    event, error, rng, gain = event_at(memory, 0), np.zeros(2), np.random.default_rng(2), 0.25
    for seconds in np.arange(1.0, 31.0):
        error = error - 0.9 * FORWARD  # estimated minus true position
        difference = error + 0.5 * rng.standard_normal(2)
        memory[event + Event.TIME] = memory[r + Standing.TIME] = seconds
        memory[event + Event.Z_N:event + Event.Z_N + 2] = difference
        crept(memory, r, event, 0.25, 0.0)
        note_correction(memory, r, gain)
        error = error - gain * difference
    # then this velocity is found
    velocity = memory[r + Creep.VELOCITY:r + Creep.VELOCITY + 2]
    assert velocity == pytest.approx(0.9 * FORWARD, abs=3.0 * memory[r + Creep.VARIANCE] ** 0.5)
    assert memory[r + Creep.VARIANCE] < 0.05**2


@pytest.mark.parametrize('speed, interruption, goes_on', [(0.9, 5.0, True), (0.0, 5.0, False), (0.9, 600.0, False)])
def test_a_creep_goes_on_over_a_short_interruption_unless_fixes_have_excluded_it(speed, interruption, goes_on):
    # given 20 s of fixes during a standstill that was a creep, or one, and then a time in which it seems to move
    memory, r, at, n = at_first_update()
    event = event_at(memory, 0)
    for seconds in np.arange(1.0, 21.0):
        memory[event + Event.TIME] = memory[r + Standing.TIME] = seconds
        memory[event + Event.Z_N:event + Event.Z_N + 2] = -speed * seconds * FORWARD
        crept(memory, r, event, SIGMA**2, 0.0)
    before = memory[r + Creep.ODDS:r + Creep.FOUND].copy()
    # when the next standstill begins
    memory[r + Nav.TIME] = 20.0 + interruption
    note_standstill(memory, r, at, n, 0.1, 2.0, ODDS)
    # then what the fixes have told of a creep is kept, but for the time that it has been quiet
    after = memory[r + Creep.ODDS:r + Creep.FOUND]
    assert (before[0] < 1e3) == (speed > 0.0)
    if goes_on:
        assert after[1:] == pytest.approx(before[1:]) and after[0] == pytest.approx(before[0], rel=0.1)
    else:
        assert after[0] == ODDS and after[3] == CREEP_VARIANCE


@pytest.mark.parametrize('odds', [1.0, 1e12])
def test_a_creep_that_fixes_have_excluded_may_begin_anew(odds):
    # given a minute of fixes that agree with a standstill, which was doubtful or sure
    memory, r, _, _ = at_first_update()
    event = event_at(memory, 0)
    memory[r + Creep.ODDS] = odds
    for seconds in np.arange(1.0, 61.0):
        memory[event + Event.TIME] = memory[r + Standing.TIME] = seconds
        memory[event + Event.Z_N:event + Event.Z_N + 2] = 0.0
        crept(memory, r, event, 0.25, 0.0)
    # then a creep is looked for that has begun in the last seconds
    assert memory[r + Creep.LAG] < 10.0 and memory[r + Creep.ODDS] < 1e9


def test_an_outlier_is_no_sign_of_a_creep():
    # given a standstill that may be a creep, and a fix that is 60 m off after 5 s
    memory, r, _, _ = at_first_update()
    event = event_at(memory, 0)
    memory[r + Creep.ODDS] = 0.05
    memory[event + Event.TIME] = memory[r + Standing.TIME] = 5.0
    memory[event + Event.Z_N:event + Event.Z_N + 2] = -60.0 * FORWARD
    # then nothing is learned from it
    assert not crept(memory, r, event, SIGMA**2, 0.0)
    assert memory[r + Creep.VELOCITY] == 0.0 and memory[r + Creep.ODDS] == pytest.approx(0.05, rel=0.1)


def test_a_standstill_is_the_likelier_the_longer_it_lasts():
    # given a standstill of 2 s, and then one of 2.1 s
    memory, r, at, n = at_first_update()
    memory[r + Standing.TIME] = memory[r + Nav.TIME]
    note_standstill(memory, r, at, n, 0.1, 2.1, ODDS)
    # then its odds have changed as those of the detector do for a given speed
    longer, shorter = (odds_of_standing(0.3, 0.04, quiet_for) for quiet_for in (2.1, 2.0))
    assert memory[r + Creep.ODDS] == pytest.approx(ODDS * longer / shorter)


def test_the_state_is_corrected_by_what_a_creep_has_made_it_wrong():
    # given a state whose position and velocity have errors in common, and the correction by a velocity of zero
    covariance = {}

    def positive(n):
        covariance['p'] = random_covariance(n, np.random.default_rng(3))
        return covariance['p']

    memory, r, at, n = at_first_update(positive)
    p, v = covariance['p'], velocity_state(memory)
    cross, own = np.trace(p[:2, v:v + 2]), np.trace(p[v:v + 2, v:v + 2])
    # then the position is off by this ratio, s, times a speed that the vehicle had nevertheless
    assert memory[r + Creep.LAG] == pytest.approx(cross / own)
    # and when 5 s have gone, with 0.8 +- 0.2 m/s, position and velocity are corrected by it, and P is raised by its
    # variance
    memory[r + Creep.LAG], memory[r + Creep.VARIANCE] = 5.0, 0.04
    memory[r + Creep.VELOCITY:r + Creep.VELOCITY + 2] = 0.8 * FORWARD
    x, before = memory[r + NAV:r + NAV + n].copy(), memory[at:at + n * n].copy()
    correct(memory, r, at, n)
    effect = np.zeros((n, 2))  # of the velocity on the errors
    effect[:2], effect[v:v + 2] = 5.0 * np.eye(2), np.eye(2)
    assert memory[r + NAV:r + NAV + n] == pytest.approx(x - effect @ (0.8 * FORWARD))
    assert memory[at:at + n * n] - before == pytest.approx(0.04 * (effect @ effect.T).ravel())


def test_a_filter_that_took_a_creep_for_a_stop_is_right_soon_after_it():
    # given a car that creeps at 1.2 m/s without any vibration and stops after 12 s; a filter that takes it for 0.6 +-
    # 0.6 m/s, so that it is rather at rest; and a fix each 5 s
    sigma, rng = 1.5, np.random.default_rng(5)
    config = configure(PLANAR)
    memory = started(config, velocity=(0.6, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag(
        [4.0, 4.0, 0.36, 0.01, 4e-4] + [1e-6] * (config.layout.n - 5)))
    samples = quiet(60, rng)
    time = samples[:, 0]
    samples[(time > 12.0) & (time <= 13.0), 1] -= 1.2
    truth = 1.2 * np.minimum(time, 12.0) + np.clip(time - 12.0, 0.0, 1.0) * 0.6
    fixes = np.array([fix_event(t - 0.001, LATITUDE + (np.interp(t, time, truth) + sigma * rng.standard_normal())
                                / METRES, height=0.0, r=np.eye(2) * sigma**2) for t in np.arange(5.0, 60.0, 5.0)])
    rows, _ = take_all(memory, samples, fixes, [Nav.LATITUDE, Nav.V_N, Nav.NORTH_SCALE])
    north = (rows[:, 0] - LATITUDE) / rows[:, 2]
    # then it has taken it for a stop at first, and is within the noise of the fixes from the third one on
    assert np.abs(rows[(time > 3.0) & (time < 4.9), 1]).max() < 0.05
    assert np.abs(north - truth)[time > 16.0].max() < 3.0 * sigma
    assert np.abs(rows[time > 20.0, 1]).max() < 0.4
