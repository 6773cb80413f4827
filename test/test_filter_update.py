"""Corrections against the dense textbook Kalman filter; the split at the fix; fixes that come late."""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import (
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    MODEL_VALUES,
    central_difference,
    configure,
    fix_event,
    input_event,
    newest,
    random_covariance,
    started,
    state_and_covariance,
    take_all,
    take_event,
    take_sample,
)
from scipy.spatial.transform import Rotation

from mems_ins_fusion.filter.advance import BEFORE_START, FORGOTTEN, TAKEN, TOO_LATE
from mems_ins_fusion.filter.memory import (
    NAV,
    NEWEST,
    PLANAR,
    Event,
    Head,
    Kind,
    Nav,
    Sample,
    Verdict,
    sample_at,
    state_at,
    views,
)
from mems_ins_fusion.filter.trust.standstill import is_still
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.simulation.drive import simulate_drive

DT = 0.01
SAMPLE = 0.3, 1.0, 9.7, 0.02, -0.03, 0.2  # sensor axes, forward-left-up
LEVER = {'gnss.lever_arm': [1.2, -0.7, 1.5]}
COLOURED = {'gnss.coloured_noise.sigma': 0.8, 'gnss.coloured_noise.tau': 20.0}
R = np.array([[1.3, -0.6], [-0.6, 0.9]])


def made(model, mechanization, feedback, **more):
    return configure({**MODEL_VALUES[model], **LEVER, 'mechanization': mechanization, 'feedback': feedback, **more})


def scale_of(config):
    navigation = [2, 2, .3, .3, .05] if config.mechanization == PLANAR else [2, 2, 3, .3, .3, .3, .03, .03, .05]
    channels = [.1 if axis < 3 else .01 for axis in config.channel_axes for _ in range(config.layout.order)]
    return np.array(navigation + channels + ([.8, .8] if config.gnss.coloured else [])
                    + ([.2] if 'time_offset' in config.layout.names else []))


def antenna(config, row, error):
    """North, east, down of the antenna, m from the fix's place, of the state in `row` with `error` taken out."""
    meridian, prime_vertical = radii(row[Nav.LATITUDE])
    h = row[Nav.HEIGHT]
    position = np.array([(row[Nav.LATITUDE] - LATITUDE) * (meridian + h),
                         (row[Nav.LONGITUDE] - LONGITUDE) * (prime_vertical + h) * math.cos(row[Nav.LATITUDE]),
                         HEIGHT - h])
    arm = np.diag([1, -1, -1]) @ config.parameters['gnss.lever_arm']
    if config.mechanization == PLANAR:
        attitude = Rotation.from_euler('z', row[Nav.YAW] - error[4])
        position[:2] -= error[:2]
    else:
        q = Rotation.from_quat(row[[Nav.Q_X, Nav.Q_Y, Nav.Q_Z, Nav.Q_W]])
        attitude = Rotation.from_rotvec(-error[6:9]) * q
        position -= error[:3]
    return position + attitude.apply(arm)


def textbook(config, row, x, p, r, down):
    """x, P, innovation and its covariance after one joint correction with the fix at its place (Eqs. 6 to 8)."""
    n, navigation = len(x), config.layout.n_navigation
    dimensions = 2 if config.mechanization == PLANAR else 3
    h = np.zeros((dimensions, n))
    # predicted minus measured position is linear in the error with -d(antenna)/d(error taken out)
    h[:, :navigation] = -central_difference(lambda e: antenna(config, row, e)[:dimensions], navigation, 1e-6)
    if config.gnss.coloured:  # measured = true + coloured noise + white
        h[0, n - 2] = h[1, n - 1] = -1
    if config.layout.index('time_offset') == n - 1:  # it is of so much earlier: the vehicle has gone on since
        velocity = row[[Nav.V_N, Nav.V_E, Nav.V_D]][:dimensions]
        h[:, -1] = velocity
    noise = np.zeros((dimensions, dimensions))
    noise[:2, :2] = r
    if dimensions == 3:
        noise[2, 2] = down
    z = antenna(config, row, np.zeros(navigation))[:dimensions] - h @ x
    s = h @ p @ h.T + noise
    gain = p @ h.T @ np.linalg.inv(s)
    return x + gain @ z, p - gain @ s @ gain.T, z, s


@pytest.mark.parametrize('feedback', ['closed', 'open'])
@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
@pytest.mark.parametrize(('model', 'optional'), [('GM', COLOURED), ('AR(2)', COLOURED),
                                                 ('GM', {'gnss.time_offset_sigma': 0.2})])
def test_a_fix_corrects_as_the_dense_joint_kalman_update(model, optional, mechanization, feedback):
    # given lever arm, coloured noise or a time offset, a correlated R and a fix on a sample's stamp
    config = made(model, mechanization, feedback, **optional)
    rng, navigation = np.random.default_rng(4), config.layout.n_navigation
    scale = scale_of(config)
    p0, x0 = random_covariance(len(scale), rng, scale), np.zeros(len(scale))
    if feedback == 'open':
        x0 = scale * rng.standard_normal(len(scale))
    else:
        x0[navigation:] = scale[navigation:] * rng.standard_normal(config.layout.n_augmented)
    memories = [started(config, x=x0, p=p0) for _ in range(2)]
    event = fix_event(DT, r=R, down=2.0)
    event[Event.TIME_OFFSET] = max(config.layout.index('time_offset'), 0)
    assert take_event(memories[1], event) == TAKEN
    for memory in memories:
        take_sample(memory, DT, *SAMPLE)
    before, after = newest(memories[0]), newest(memories[1])
    x, p, z, s = textbook(config, before, *state_and_covariance(config, memories[0]), R, 2.0)
    # then covariance and estimate are the textbook's
    estimate, covariance = state_and_covariance(config, memories[1])
    sigma = np.sqrt(np.diag(p))
    assert covariance / np.outer(sigma, sigma) == pytest.approx(p / np.outer(sigma, sigma), abs=1e-7)
    applied = x if feedback == 'open' else np.concatenate([np.zeros(navigation), x[navigation:]])
    assert (estimate - applied) / scale == pytest.approx(np.zeros(len(x)), abs=1e-7)
    taken_out = x[:navigation] if feedback == 'closed' else np.zeros(navigation)
    expected = antenna(config, before, taken_out)  # the corrected state, seen at the antenna
    if config.mechanization == PLANAR:
        expected[2] = 0  # planar takes its height from the fix
        assert after[Nav.YAW] == pytest.approx(before[Nav.YAW] - taken_out[4], abs=1e-9)
        assert after[[Nav.V_N, Nav.V_E]] == pytest.approx(before[[Nav.V_N, Nav.V_E]] - taken_out[2:4], abs=1e-8)
    else:
        assert after[Nav.V_N:Nav.V_D + 1] == pytest.approx(before[Nav.V_N:Nav.V_D + 1] - taken_out[3:6], abs=1e-8)
    assert antenna(config, after, np.zeros(9)) == pytest.approx(expected, abs=1e-6)
    # and the innovation kept with the fix is that of the joint measurement
    kept = views(memories[1])[4][0]
    assert kept[[Event.Z_N, Event.Z_E]] == pytest.approx(z[:2], abs=1e-7)
    assert kept[[Event.S_NN, Event.S_NE, Event.S_EE]] == pytest.approx(s[[0, 0, 1], [0, 1, 1]], rel=1e-7)
    assert kept[Event.NIS] == pytest.approx(z[:2] @ np.linalg.solve(s[:2, :2], z[:2]), rel=1e-6)
    if config.mechanization != PLANAR:
        assert kept[[Event.Z_D, Event.S_DD]] == pytest.approx([z[2], s[2, 2]], rel=1e-6)


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_robust_weighting_brings_an_outlier_to_its_limit_and_leaves_others_alone(mechanization):
    values = {**MODEL_VALUES['GM'], 'mechanization': mechanization}
    for away, outlier in ((0.5, False), (60.0, True)):
        results = {}
        for robust in (0.0, 3.0):
            config = configure({**values, 'gnss.robust_sigma': robust})
            scale = scale_of(config)
            memory = started(config, velocity=(0, 0, 0), p=np.diag(scale**2))
            take_event(memory, fix_event(DT, latitude=LATITUDE + away / 6.4e6, r=R, down=100.0))
            before = started(config, velocity=(0, 0, 0), p=np.diag(scale**2))
            for m in (memory, before):
                take_sample(m, DT, *SAMPLE)
            results[robust] = state_and_covariance(config, memory)[1], newest(memory), views(memory)[4][0, Event.NIS]
        nis = results[0.0][2]
        assert (nis > 9) == outlier and results[3.0][2] == nis
        if not outlier:
            assert np.array_equal(results[0.0][1], results[3.0][1])
            continue
        # then R grows until the normalized innovation is 3: S' = S nis / 9
        p = state_and_covariance(config, before)[1]
        s = p[:2, :2] + R
        inflated = R + (nis / 9 - 1) * s
        gain = p[:, :2] @ np.linalg.inv(p[:2, :2] + inflated)
        expected = p - gain @ p[:2]
        got = results[3.0][0]
        index = [0, 1, 2, 3, 4] if mechanization == 'planar' else [0, 1, 3, 4, 8]  # not what the height corrects
        assert np.diag(got)[index] == pytest.approx(np.diag(expected)[index], rel=1e-6)
        z = views(memory)[4][0, [Event.Z_N, Event.Z_E]]
        assert z @ np.linalg.solve(p[:2, :2] + inflated, z) == pytest.approx(9.0, rel=1e-6)


@pytest.mark.parametrize('gate, corrected', [(0.999999, False), (1.0, True)])
def test_a_height_that_cannot_be_is_not_used_and_the_rest_of_the_fix_is(gate, corrected):
    # given a height of which the filter is certain to 3 m, and a fix 30 m north, where it may be, and 100 m above
    config = configure({**MODEL_VALUES['GM'], 'mechanization': 'strapdown', 'gnss.gate_probability': gate})
    heights, sigmas = [], []
    for height in (HEIGHT, HEIGHT + 100.0):
        p = np.diag(np.concatenate([[20.0, 20.0], scale_of(config)[2:]]) ** 2)
        memory = started(config, velocity=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=p)
        take_event(memory, fix_event(DT, latitude=LATITUDE + 30.0 / 6.4e6, height=height, down=1.0))
        take_sample(memory, DT, 0.0, 0.0, 9.8, 0.0, 0.0, 0.0)
        assert views(memory)[4][0, Event.VERDICT] == Verdict.USED
        heights.append(newest(memory)[Nav.HEIGHT])
        sigmas.append(np.sqrt(np.diag(state_and_covariance(config, memory)[1]))[:3])
    assert heights[0] == pytest.approx(HEIGHT, abs=0.1)
    assert heights[1] == pytest.approx(HEIGHT + (90.0 if corrected else 0.0), abs=0.1)
    # then its sigma stays, too, and north and east are corrected
    assert sigmas[1] == pytest.approx([1.0, 1.0, 0.9**0.5 if corrected else 3.0], rel=0.01)


def test_a_height_that_fits_badly_is_weighted_down_to_the_limit():
    # given a height certain to 3 m, and a fix 30 m above, certain to 1 m: of nis 90
    config = configure({**MODEL_VALUES['GM'], 'mechanization': 'strapdown', 'gnss.robust_sigma': 3.0})
    memory = started(config, velocity=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag(scale_of(config) ** 2))
    take_event(memory, fix_event(DT, height=HEIGHT + 30.0, down=1.0))
    take_sample(memory, DT, 0.0, 0.0, 9.8, 0.0, 0.0, 0.0)
    # then R grows until S is ten times as large, nis 9: gain 9 / 100
    assert views(memory)[4][0, Event.VERDICT] == Verdict.USED and views(memory)[4][0, Event.WEIGHT] == 1.0
    assert newest(memory)[Nav.HEIGHT] == pytest.approx(HEIGHT + 2.7, abs=0.02)
    assert state_and_covariance(config, memory)[1][2, 2] == pytest.approx(9.0 - 0.81, rel=0.01)


@pytest.mark.parametrize('model', ['RW', 'GM', 'AR(3)'])
def test_covariance_stays_symmetric_and_positive_for_hours_of_exact_fixes(model):
    # given two hours at 10 Hz with a fix of 1 mm each second: the worst there is for (I - K H) P
    config = configure({**MODEL_VALUES[model], 'mechanization': 'strapdown' if model == 'GM' else 'planar',
                        'accelerometer.autoregressive.interval': 0.1, 'gyroscope.autoregressive.interval': 0.1})
    n = config.layout.n
    drive = simulate_drive(120.0, 5, 10.0, standstill=1.0)
    hours = 60
    force = np.tile(drive.specific_force[1:] * [1, -1, -1], (hours, 1))
    rate = np.tile(drive.angular_rate[1:] * [1, -1, -1], (hours, 1))
    time = 0.1 * np.arange(1, len(force) + 1)
    memory = started(config, velocity=(0, 0, 0), p=np.diag(scale_of(config) ** 2 * 100))
    fixes = np.array([fix_event(t, r=1e-6 * np.eye(2), down=1e-6) for t in np.arange(0.55, time[-1], 1.0)])
    _, fixes = take_all(memory, np.column_stack([time, force, rate]), fixes, [NAV])
    assert views(memory)[0][Head.SAMPLES] == len(time) >= 72000
    assert np.all(fixes[:, Event.VERDICT] == Verdict.USED)
    _, p = state_and_covariance(config, memory)
    sigma = np.sqrt(np.diag(p))
    assert np.all(np.isfinite(sigma)) and np.all(sigma > 0)
    assert np.abs(p - p.T).max() <= 1e-15 * np.abs(p).max()
    assert np.linalg.eigvalsh(p / np.outer(sigma, sigma)).min() > 1e-13
    assert sigma.shape == (n,) and sigma[0] < 0.03


# --- where in time a fix acts ---

def driven(config, events):
    """A memory after events: ('sample', time) or ('fix', time, north offset); samples are a function of their time."""
    memory, answers = started(config, p=np.diag(scale_of(config) ** 2)), []
    for kind, time, *rest in events:
        if kind == 'sample':
            wave = np.sin(np.arange(6) + 3.0 * rest[0] if rest else np.arange(6) + 3.0 * time)
            take_sample(memory, time, *(np.array(SAMPLE) + wave * [1, 1, 1, .1, .1, .1]))
        else:
            answers.append(take_event(memory, fix_event(time, latitude=LATITUDE + rest[0] / 6.4e6, r=R)))
    return memory, answers


ALL = [(model, mechanization, feedback) for model in ('RW', 'GM', 'AR(2)') for mechanization in ('planar', 'strapdown')
       for feedback in ('closed', 'open')]


@pytest.mark.parametrize(('model', 'mechanization', 'feedback'), ALL)
def test_an_interval_is_split_at_the_fix(model, mechanization, feedback):
    config = made(model, mechanization, feedback)
    split, _ = driven(config, [('sample', 0.01), ('fix', 0.0137, 2.0), ('sample', 0.02)])
    # when the interval is fed in two parts by hand, with the same sensor values
    by_hand, _ = driven(config, [('sample', 0.01), ('fix', 0.0137, 2.0), ('sample', 0.0137, 0.02), ('sample', 0.02)])
    assert np.array_equal(newest(split), newest(by_hand))
    # then it differs from the fix taken at either end
    for time in (0.01, 0.02):
        elsewhere, _ = driven(config, [('fix', time, 2.0), ('sample', 0.01), ('sample', 0.02)])
        assert not np.allclose(newest(split)[NAV:], newest(elsewhere)[NAV:], rtol=1e-6, atol=0)


@pytest.mark.parametrize(('model', 'mechanization', 'feedback'), ALL)
def test_late_fixes_give_bit_for_bit_what_fixes_in_time_give(model, mechanization, feedback):
    # given so many samples that the states before the fixes are no longer in the memory, but for the first one
    config = made(model, mechanization, feedback, **{'gnss.max_delay': 5.0})
    times = np.round(0.01 * np.arange(1, NEWEST + 60), 9)
    samples = [('sample', t) for t in times]
    first, second, third = ('fix', 0.1533, 1.0), ('fix', 0.31, -2.0), ('fix', 0.3133, 3.0)  # one at a sample's stamp
    in_order, _ = driven(config, [first, second, third, *samples])
    for events in ([*samples, first, second, third], [*samples, third, first, second],
                   [*samples[:32], second, *samples[32:40], third, first, *samples[40:]]):
        late, answers = driven(config, events)
        assert answers == [TAKEN] * 3
        assert np.array_equal(newest(late), newest(in_order))
        # and so does each state from the sample after the fix on
        for k in range(60, NEWEST + 60):
            a, b = (memory[state_at(memory, k):][:int(memory[Head.WIDTH])] for memory in (late, in_order))
            assert np.array_equal(a, b)
    without, _ = driven(config, samples)
    assert not np.array_equal(newest(without), newest(in_order))


def test_a_fix_that_comes_late_at_a_standstill_gives_what_one_in_time_gives():
    # given a vehicle at rest whose engine shakes the gyroscopes more and more, and a fix that comes late
    config = made('GM', 'strapdown', 'closed', **{'vehicle.zero_velocity': True})
    times, rng = np.round(0.01 * np.arange(1, 500), 9), np.random.default_rng(8)
    rates = 0.001 * times[:, None] * rng.standard_normal((len(times), 3))

    def played(arrival):
        memory = started(config, velocity=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.7), p=0.01 * np.eye(config.layout.n))
        for time, rate in zip(times, rates):
            if time >= arrival > time - 0.01:
                assert take_event(memory, fix_event(3.005, r=R)) == TAKEN
            take_sample(memory, time, 0.0, 0.0, 9.8, *rate)
        return memory

    in_time = played(3.01)
    samples = views(in_time)[3][1:500]
    assert (samples[300:, Sample.CONSTRAINT] == Kind.ZERO_VELOCITY).any()
    # then it is not the engine's noise of later that tells how well the gyroscopes were known then
    assert np.array_equal(newest(played(3.95)), newest(in_time))


def test_a_late_fix_loses_nothing_of_a_fast_sensor_beside_it():
    # given a wheel speed at 100 Hz, and a fix that comes 4 s late, within the delay
    config = made('GM', 'planar', 'closed', **{'gnss.max_delay': 5.0, 'speed_topic': '/speed'})
    times = np.round(0.01 * np.arange(1, 601), 9)

    def played(fix_after):
        memory = started(config, p=0.01 * np.eye(config.layout.n))
        for time in times:
            speed = input_event(config, time - 0.005, Kind.SPEED)
            speed[[Event.VALUE, Event.R_NN]] = 13.0, 0.01
            assert take_event(memory, speed) == TAKEN
            take_sample(memory, time, *SAMPLE)
            if time == fix_after:
                assert take_event(memory, fix_event(1.505, r=R)) == TAKEN
        return memory

    # then nothing is lost by it
    assert np.array_equal(newest(played(5.5)), newest(played(1.5)))


def test_what_cannot_be_gone_back_behind_is_refused():
    # given more measurements than are remembered, within the delay
    config = made('GM', 'planar', 'closed', **{'gnss.max_delay': 10.0, 'speed_topic': '/speed'})
    memory, count = started(config, p=0.01 * np.eye(config.layout.n)), config.event_capacity + 1
    take_sample(memory, 0.01, *SAMPLE)
    for time in np.linspace(0.02, 5.0, count):
        speed = input_event(config, time, Kind.SPEED)
        speed[[Event.VALUE, Event.R_NN]] = 13.0, 0.01
        assert take_event(memory, speed) == TAKEN
        take_sample(memory, time + 1e-4, *SAMPLE)
    before = newest(memory)
    # then a fix from among those that are not is, and one behind them is taken
    assert take_event(memory, fix_event(2.0, r=R)) == FORGOTTEN
    assert np.array_equal(newest(memory), before)
    assert take_event(memory, fix_event(4.0, r=R)) == TAKEN


def test_a_fix_at_a_sample_stamp_acts_after_that_sample():
    config = made('GM', 'planar', 'closed')
    at, _ = driven(config, [('fix', 0.02, 2.0), ('sample', 0.01), ('sample', 0.02)])
    just_before, _ = driven(config, [('fix', 0.02 - 1e-9, 2.0), ('sample', 0.01), ('sample', 0.02)])
    just_after, _ = driven(config, [('fix', 0.02 + 1e-9, 2.0), ('sample', 0.01), ('sample', 0.02)])
    plain, _ = driven(config, [('sample', 0.01), ('sample', 0.02)])
    assert newest(at) == pytest.approx(newest(just_before), rel=1e-6, abs=1e-9)
    assert np.array_equal(newest(just_after), newest(plain))
    assert not np.array_equal(newest(at), newest(plain))
    # and one stamped at the state it starts from came before the start
    assert driven(config, [('fix', 0.0, 2.0), ('sample', 0.01)])[1] == [BEFORE_START]


def test_fixes_older_than_the_delay_or_the_memory_are_refused():
    config = made('GM', 'planar', 'closed', **{'gnss.max_delay': 0.3})
    samples = [('sample', t) for t in np.round(0.01 * np.arange(1, 60), 9)]
    plain, _ = driven(config, samples)
    for time, answer in ((0.28, TOO_LATE), (0.295, TAKEN), (-1.0, BEFORE_START)):
        memory, answers = driven(config, [*samples, ('fix', time, 2.0)])
        assert answers == [answer]
        assert np.array_equal(newest(memory), newest(plain)) == (answer != TAKEN)
    # given more samples than the memory holds, within the delay
    config = made('GM', 'planar', 'closed', **{'gnss.max_delay': 10.0})
    count = config.capacity // 2 + 100
    step = 9.0 / count
    memory, answers = driven(config, [*[('sample', step * k) for k in range(1, count)], ('fix', 50 * step, 2.0),
                                      ('fix', 150 * step, 2.0)])
    assert answers == [TOO_LATE, TAKEN]


def test_a_stop_of_four_seconds_is_seen_within_three():
    # given a car that brakes by 2 m/s^2 on an uneven road, stands for 4 s with its engine on, and drives off again
    time, rng = 0.01 * np.arange(4000), np.random.default_rng(5)
    moves = (time < 30.0) | (time > 34.0)
    force = moves * (0.15 * np.sin(5.0 * time) + 0.1 * rng.standard_normal(len(time))) + 0.05 * np.sin(150.0 * time)
    force += -2.0 * ((time > 25.0) & (time < 30.0)) + 1.5 * (time > 34.0)
    memory = made('GM', 'planar', 'closed', **{'vehicle.zero_velocity': True}).memory()
    sample, flags = sample_at(memory, 1), np.zeros(len(time), dtype=bool)
    for k in range(1, len(time)):
        memory[sample + Sample.F_X] = force[k]
        certain = 2.0 * (time[k] < 29.0)  # speed that the filter is certain of
        flags[k] = is_still(memory, sample, 0.01, certain, 0.0, False)
    # then it is one from 3 s after the stop at the latest to the start, and neither while braking nor afterwards
    assert flags[(time > 33.0) & (time < 34.0)].all() and not flags[(time < 30.5) | (time > 34.4)].any()


def test_a_car_that_creeps_as_quietly_as_others_stand_does_not_stand():
    # given a car that creeps at 0.8 m/s on an even road, then stands, and is quieter there by far
    time = 0.01 * np.arange(12000)
    creeps = time < 80.0
    force = np.where(creeps, 0.02, 0.002) * np.sin(3.0 * time)
    memory = made('GM', 'planar', 'closed', **{'vehicle.zero_velocity': True}).memory()
    sample, flags = sample_at(memory, 1), np.zeros(len(time), dtype=bool)
    for k in range(1, len(time)):
        memory[sample + Sample.F_X] = force[k]
        flags[k] = is_still(memory, sample, 0.01, 0.7 * (time[k] < 60.0), 0.0, False)  # certain for a minute
    # then, no longer certain, it does not stand before it does
    assert not flags[(time > 60.0) & creeps].any() and flags[time > 83.0].all()


def test_a_standstill_ends_when_the_vehicle_starts_gently():
    # given a vehicle at rest for 20 s that then gains speed with a jerk of 0.2 m/s^3, as smoothly as can be
    time = DT * np.arange(1, 2601)
    still = 20.0
    acceleration = 0.2 * np.maximum(time - still, 0.0)
    speed = 0.1 * np.maximum(time - still, 0.0) ** 2
    noise = np.random.default_rng(3).standard_normal((2, len(time), 3)) * np.array([0.02, 1e-3])[:, None, None]
    force = noise[0] + np.column_stack([acceleration + 0.05, 0 * time, 0 * time + 9.81])  # with a bias
    found = {}
    for used in (True, False):
        config = made('GM', 'planar', 'closed', **{'vehicle.zero_velocity': used, 'imu.mounting_rpy': [0.0, 0.0, 0.0]})
        memory = started(config, velocity=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=np.diag(
            [0.25, 0.25, 0.01, 0.01, 0.01, *[0.05**2] * (config.layout.n_augmented - 1), 0.01**2]))
        found[used] = []
        for k in range(len(time)):
            take_sample(memory, time[k], *force[k], *noise[1][k])
            found[used].append(newest(memory)[Nav.V_N])
    velocity = np.array(found[True])
    # then at rest the velocity is held at zero, where it drifts away without
    assert np.abs(velocity[(time > 10) & (time < still)]).max() < 0.05
    assert found[False][1900] == pytest.approx(0.05 * 19, rel=0.1)
    # and soon after the start it is the vehicle's, not zero: what was lost until then is less than 0.15 m/s
    assert np.abs(velocity - speed)[time > still + 1].max() < 0.15
    assert speed[-1] > 3.5
