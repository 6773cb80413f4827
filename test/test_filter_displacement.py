"""A speed that is not the vehicle's is found out by the way between fixes, and is worth nothing, and costs nothing."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors, rms
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import INPUT_SIZE, Event, Head, Kind, Nav, Verdict
from mems_ins_fusion.filter.runs.replay import run, run_with_outages
from mems_ins_fusion.filter.trust import displacement, inputs
from mems_ins_fusion.filter.trust.displacement import Integral
from mems_ins_fusion.filter.trust.inputs import Fit
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import SLOW
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

SECOND = 10**9
KINDS = {'speed': Kind.SPEED, 'velocity': Kind.VELOCITY, 'twist': Kind.TWIST}


def drive(seed, rate=1.0, outliers=0.0, speeds=20.0):
    made = simulate_recording(simulate_drive(200.0, seed, 50.0, standstill=10.0, hills=True),
                              SensorErrors.from_parameters(table.defaults(), 'gauss_markov'), GnssNoise(1.5, rate),
                              seed=seed, aiding=SimulatedAiding(speed_rate=speeds, velocity_rate=5.0, twist_rate=20.0,
                                                                heading_rate=5.0, pressure_rate=10.0))
    recording, rng = made.recording, np.random.default_rng(seed)
    off = (rng.random(len(recording.gnss)) < outliers) * 50e-7
    return replace(recording, gnss=replace(recording.gnss, latitude=recording.gnss.latitude + off))


def config(*names):
    return FilterConfig.from_parameters(table.check({f'{name}_topic': f'/{name}' for name in names}))


def largest_errors(recording, measured, begins=(90.0, 150.0), duration=40.0):
    """Of the position, m, in outages that begin at so many s."""
    begin = recording.imu.stamp[0] + (np.array(begins) * SECOND).astype(np.int64)
    _, outages = run_with_outages(config(*measured), recording.imu, recording.gnss, begin, duration, Aiding(measured))
    result, true = outages.run, recording.reference
    north, east = radii(result.latitude)
    off = np.hypot((result.latitude - np.interp(result.stamp, true.stamp, true.latitude)) * north,
                   (result.longitude - np.interp(result.stamp, true.stamp, true.longitude)) * east
                   * np.cos(result.latitude))
    return np.array([off[(result.stamp >= b) & (result.stamp <= b + duration * SECOND)].max() for b in begin])


def turned(name, samples, matrix):
    return replace(samples, **{name: matrix * samples.speed if name == 'speed' else getattr(samples, name) @ matrix})


SWAPPED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
WRONG = {'km/h': ('speed', 3.6), 'mph': ('speed', 2.23694), 'backwards': ('speed', -1.0), 'dead': ('speed', 0.0),
         'mph taken for km/h': ('speed', 1.0 / 1.609), 'a hundredth': ('speed', 0.01),
         'east and north exchanged': ('velocity', SWAPPED), 'velocity in km/h': ('velocity', 3.6 * np.eye(3)),
         'odometry in km/h': ('twist', np.diag([3.6, 3.6, 1.0])), 'odometry backwards': ('twist', -np.eye(3))}


@pytest.mark.parametrize('wrong', WRONG)
def test_a_speed_that_is_not_the_vehicles_is_as_none(wrong):
    # given a measurement that is wrong for the whole drive
    name, matrix = WRONG[wrong]
    without, with_it = [], []
    for seed in (2, 3):
        recording = drive(seed)
        bad = turned(name, recording.streams()[name], matrix)
        without.append(largest_errors(recording, {}))
        with_it.append(largest_errors(recording, {name: bad}))
    # then outages are as they are without it, which with km/h were a kilometre
    assert np.mean(with_it) < 1.3 * np.mean(without) + 1.0, (with_it, without)
    # and most of it has been refused, in words that say so
    result = run(config(name), recording.imu, recording.gnss, Aiding({name: bad}))
    counts = result.measured.verdicts(KINDS[name])
    driven = len(bad) * 0.8
    # one that always says zero repeats itself before it has made up a way
    verdict = Verdict.FROZEN if wrong == 'dead' else Verdict.CONTRADICTED
    assert counts.get(verdict, 0) > 0.7 * driven, counts
    text = 'repeat themselves' if wrong == 'dead' else 'their integral differs from the displacement'
    assert any(text in notice.text for notice in result.notices)


def test_a_heading_that_points_elsewhere_is_as_none():
    # given a heading that is right for a minute and 90 deg off from then on, in two drives
    with_it, without = [], []
    for seed in (3, 2):
        recording = drive(seed)
        heading = recording.heading
        later = heading.stamp > heading.stamp[0] + 60 * SECOND
        bad = replace(heading, yaw=heading.yaw + 0.5 * np.pi * later)
        with_it.append(largest_errors(recording, {'heading': bad}))
        without.append(largest_errors(recording, {}))
    # then outages are as without it, and it is said why
    assert np.mean(with_it) < 1.3 * np.mean(without) + 1.0, (with_it, without)
    result = run(config('heading'), recording.imu, recording.gnss, Aiding(heading=bad))
    counts = result.measured.verdicts(Kind.HEADING)
    assert counts[Verdict.CONTRADICTED] > 0.7 * np.count_nonzero(later), counts


def test_wheels_that_have_slipped_for_long_are_used_again_within_two_seconds():
    # given wheels that are 3 m/s too fast for 8 s, longer than a slip is held for one, in a drive that goes on
    recording = drive(2)
    speed = recording.speed
    time = (speed.stamp - speed.stamp[0]) * 1e-9
    slips, after = (time >= 90.0) & (time < 98.0), (time >= 100.0) & (time < 115.0)
    assert speed.speed[(time >= 90.0) & (time < 115.0)].min() > 4.0
    bad = replace(speed, speed=speed.speed + 3.0 * slips)
    measured = run(config('speed'), recording.imu, recording.gnss, Aiding(speed=bad)).measured
    mine = measured.select(measured.kind == Kind.SPEED)
    used = np.isin(mine.event[:, Event.VERDICT], [Verdict.USED, Verdict.WEIGHTED])
    # then hardly any of the slip is used, and nearly all from two seconds after it on
    assert used[slips[mine.index]].mean() < 0.02 and used[after[mine.index]].mean() > 0.95


@pytest.mark.parametrize('v, sigma, innovation, again', [
    (10.0, 0.3, 0.5, 101.0), (0.0, 0.3, 0.0, None), (10.0, 0.7, 0.5, None), (10.0, 0.3, 1.0, None)])
def test_one_that_was_wrong_is_right_again_after_a_second_in_which_an_error_shows(v, sigma, innovation, again):
    # given a speed that was wrong until 100 s; a vehicle that goes v m/s, or stands, where a speed in any unit fits
    mem, r, at = np.zeros(3000), 1000, 2800
    own = r + 1500 - INPUT_SIZE
    mem[Head.WIDTH], mem[at + Event.KIND], mem[at + Event.INPUT], mem[at + Event.STATE] = 1500, Kind.SPEED, 1, -1
    mem[own + Integral.COMPARED], mem[own + Fit.TIME], mem[r + Nav.V_N] = -1.0, -100.0, v
    found = None
    for time in 100.0 + 0.25 * np.arange(1, 20):
        mem[at + Event.TIME] = time
        if found is None and inputs._is_right_again(mem, r, at, 15, own, innovation**2, sigma**2):
            found = time
    # then it is right after a second, or never where it does not fit, or an error of a fifth would fit
    assert found == again


@pytest.mark.parametrize(('kind', 'off', 'scatters'), [
    (Kind.SPEED, [(2.0, 0.0), (-2.0, 0.0)], True), (Kind.TWIST, [(2.0, 0.0), (-2.0, 0.0)], True),
    (Kind.VELOCITY, [(2.0, 0.5), (-2.0, 0.5)], True), (Kind.VELOCITY, [(2.0, 0.0), (2.0, 0.0)], False),
    (Kind.VELOCITY, [(0.1, 3.0), (-0.1, 3.0)], False)])
def test_what_is_far_off_on_both_sides_in_turn_scatters(kind, off, scatters):
    # given two innovations, north and east, m/s, a second apart; the filter's state and the rows of H are zero
    mem, r, at, own = np.zeros(3000), 1000, 2800, 1500
    mem[Head.SCRATCH_AT], mem[at + Event.KIND] = 2000, kind
    for time, innovation in zip((100.0, 101.0), off):
        mem[at + Event.TIME], mem[at + Event.Z_N:at + Event.Z_N + 2] = time, innovation
        squared = np.square(innovation).mean() if kind == Kind.VELOCITY else innovation[0]**2
        found = inputs._alternates(mem, r, at, 10, own, squared)
    # then it is noise where the second is on the other side; north by chance so, while it is off to the east, is none
    assert found == scatters


@pytest.mark.parametrize('name', ['speed', 'velocity', 'twist'])
def test_one_that_scatters_is_no_slip(name):
    # given an input that scatters by 2 m/s from 60 s on, many times what it claims
    rng, with_it, without = np.random.default_rng(5), [], []
    for seed in (2, 3):
        recording = drive(seed, 10.0)
        samples = recording.streams()[name]
        later = samples.stamp > samples.stamp[0] + 60 * SECOND
        values = getattr(samples, name)
        noise = 2.0 * rng.standard_normal(values.shape) * (later if values.ndim == 1 else later[:, None])
        with_it.append(largest_errors(recording, {name: replace(samples, **{name: values + noise})}))
        without.append(largest_errors(recording, {}))
    # then outages are not worse for it
    assert np.mean(with_it) < 1.1 * np.mean(without) + 1.0, (with_it, without)


@pytest.mark.parametrize(('name', 'seconds'), [('speed', 0.5), ('velocity', 0.3), ('twist', 0.5), ('heading', 0.5)])
def test_one_that_is_late_is_better_than_none_and_not_believed_too_far(name, seconds):
    # given stamps that are late from the begin on, or early
    for sign in (1, -1):
        errors = {'late': [], 'none': []}
        for seed in (2, 3, 4):
            recording = drive(seed)
            samples = recording.streams()[name]
            late = replace(samples, stamp=samples.stamp + round(sign * seconds * SECOND))
            truth = truth_of(recording, config(name).parameters)
            for case, measured in (('late', {name: late}), ('none', {})):
                result = run(config(*measured), recording.imu, recording.gnss, Aiding(measured))
                errors[case].append(position_errors(result, truth, np.zeros(len(truth), dtype=bool)))
        late, none = ([np.concatenate([getattr(of, part) for of in errors[case]]) for part in ('horizontal', 'nees')]
                      for case in ('late', 'none'))
        # then the position is not worse for it, and the ellipse holds the truth
        assert rms(late[0]) < 1.03 * rms(none[0]), (sign, rms(late[0]), rms(none[0]))
        assert np.mean(late[1] < NEES_95) > 0.93, (sign, np.mean(late[1] < NEES_95), np.mean(none[1] < NEES_95))


STUCK = {'speed': ('speed',), 'velocity': ('velocity',), 'twist': ('twist',), 'heading': ('yaw',)}


@pytest.mark.parametrize('name', STUCK)
def test_an_input_that_goes_on_with_its_last_value_is_not_believed(name):
    errors = {}
    for seed in (2, 3):
        recording = drive(seed)
        samples = recording.streams()[name]
        stuck = samples.stamp > samples.stamp[0] + 80 * SECOND
        value = {part: getattr(samples, part).copy() for part in STUCK[name]}
        for part in value.values():
            part[stuck] = part[np.flatnonzero(stuck)[0]]
        dead = replace(samples, **value)
        errors.setdefault('dead', []).append(largest_errors(recording, {name: dead}))
        errors.setdefault('none', []).append(largest_errors(recording, {name: samples.select(~stuck)}))
    assert np.mean(errors['dead']) < 1.3 * np.mean(errors['none']) + 2.0, errors


PARTS = {**STUCK, 'pressure': ('pressure',)}


@pytest.mark.parametrize('name', PARTS)
def test_one_that_never_repeats_itself_has_stopped_where_it_does(name):
    # given an input with noise in each message, that goes on with its last value while the vehicle drives
    recording = drive(2)
    samples = recording.streams()[name]
    late = samples.stamp - samples.stamp[0] > 80 * SECOND
    first = np.flatnonzero(late)[0]
    stuck = replace(samples, **{part: np.where(late.reshape(-1, *[1] * (getattr(samples, part).ndim - 1)),
                                               getattr(samples, part)[first], getattr(samples, part))
                                for part in PARTS[name]})
    # then a handful of messages is believed, and no other until the end
    result = run(config(name), recording.imu, recording.gnss, Aiding({name: stuck}))
    mine = result.measured.select(result.measured.kind != Kind.POSITION)
    frozen = mine.event[:, Event.VERDICT] == Verdict.FROZEN
    assert frozen[mine.index >= first + 8].all() and not frozen[mine.index <= first].any()


def test_a_speed_that_rounds_may_repeat_itself():
    # given steps of 0.1 m/s where the noise is 0.05 m/s
    recording = drive(2)
    steps = replace(recording.speed, speed=np.round(recording.speed.speed, 1))
    counts = run(config('speed'), recording.imu, recording.gnss, Aiding(speed=steps)).measured.verdicts(Kind.SPEED)
    assert counts.get(Verdict.FROZEN, 0) == 0, counts


def test_a_speed_in_whole_kilometres_an_hour_is_worth_nearly_as_much():
    # given steps of 0.28 m/s, in which a steady speed does not change for seconds
    exact, rounded = [], []
    for seed in (2, 3):
        recording = drive(seed)
        speed = recording.speed
        steps = replace(speed, speed=np.round(3.6 * speed.speed) / 3.6)
        exact.append(largest_errors(recording, {'speed': speed}))
        rounded.append(largest_errors(recording, {'speed': steps}))
    assert np.mean(rounded) < 1.3 * np.mean(exact) + 0.5, (exact, rounded)


@pytest.mark.parametrize(('rate', 'outliers'), [(0.2, 0.0), (1.0, 0.0), (1.0, 0.1), (10.0, 0.0), (10.0, 0.1)])
def test_a_right_one_is_never_contradicted(rate, outliers):
    for seed in (2, 3):
        recording = drive(seed, rate, outliers)
        for name, kind in KINDS.items():
            result = run(config(name), recording.imu, recording.gnss, Aiding({name: recording.streams()[name]}))
            counts = result.measured.verdicts(kind)
            assert counts.get(Verdict.CONTRADICTED, 0) < 0.02 * sum(counts.values()), (name, counts)


def test_one_that_is_too_slow_to_make_a_way_is_used():
    # given fixes and velocities each 5 s
    recording = drive(2, 0.2)
    velocity = recording.velocity.select(slice(None, None, 25))
    counts = run(config('velocity'), recording.imu, recording.gnss, Aiding(velocity=velocity)).measured.verdicts(
        Kind.VELOCITY)
    assert counts.get(Verdict.AWAITED, 0) <= 1 and counts[Verdict.USED] > 20, counts


def test_a_velocity_waits_for_the_first_ways_and_a_speed_that_fits_does_not():
    recording = drive(2)
    for name, waits in (('velocity', True), ('speed', False)):
        samples = Aiding({name: recording.streams()[name]})
        measured = run(config(name), recording.imu, recording.gnss, samples).measured
        event = measured.event[measured.kind == KINDS[name]]
        first = event[:40 if waits else 160, Event.VERDICT] == Verdict.AWAITED  # eight seconds
        assert first[:10].all() if waits else first.mean() < 0.1
        assert not (event[150 if waits else 600:, Event.VERDICT] == Verdict.AWAITED).any()


@pytest.mark.parametrize('name', ['speed', 'twist'])
@pytest.mark.parametrize('more', [3.0, -4.0])
def test_wheels_that_slip_without_fixes_are_refused_at_once_and_used_again(name, more):
    # given 40 s without fixes, in the middle of which the wheels turn for 3 s by 3 m/s more, or less, than they roll
    errors = {'rolls': [], 'slips': []}
    for seed in (2, 3):
        recording = drive(seed)
        right = recording.streams()[name]
        at = (right.stamp - recording.imu.stamp[0]) / SECOND
        slip = more * ((at > 110.0) & (at < 113.0))
        slipping = replace(right, speed=right.speed + slip) if name == 'speed' else replace(
            right, twist=right.twist + np.column_stack([slip, 0 * slip, 0 * slip]))
        for case, samples in (('rolls', right), ('slips', slipping)):
            errors[case].append(largest_errors(recording, {name: samples}, (90.0,)))
        result = run(config(name), recording.imu, recording.gnss, Aiding({name: slipping}))
        event = result.measured.event[result.measured.kind == KINDS[name]]
        since = (result.measured.stamp[result.measured.kind == KINDS[name]] - recording.imu.stamp[0]) / SECOND
        refused = since[event[:, Event.VERDICT] == Verdict.REFUSED]
        # then with fixes, too, it is those that slip, from the first on, and few others
        assert ((refused > 109.9) & (refused < 113.1)).sum() > 55 and len(refused) < 70
    assert np.max(errors['slips']) < np.max(errors['rolls']) + 1.5, errors


@pytest.mark.parametrize('rate', [10.0, 100.0])
@pytest.mark.parametrize('more', [0.7, 3.0])
def test_wheels_that_slip_again_and_again_cost_nothing_at_any_rate(rate, more):
    # given wheels that turn too fast for 3 s of each 12, also while the vehicle accelerates, brakes and turns
    recording = drive(4, speeds=rate)
    speed = recording.speed
    at = (speed.stamp - speed.stamp[0]) / SECOND
    slip = (at > 60.0) & (at % 12.0 < 3.0) & (np.abs(speed.speed) > 2.0)
    slipping = replace(speed, speed=speed.speed + more * slip)
    (off, result), (right, _) = (off_with_fixes(recording, {'speed': one}) for one in (slipping, speed))
    # then nearly all of that is refused, nearly nothing else, and the position is as with wheels that roll
    event = result.measured.event[result.measured.kind == Kind.SPEED]
    stamp = result.measured.stamp[result.measured.kind == Kind.SPEED]
    refused, slip = event[:, Event.VERDICT] == Verdict.REFUSED, slip[np.searchsorted(speed.stamp, stamp)]
    assert refused[slip].mean() > 0.9 and refused[~slip].mean() < 0.01
    assert rms(off) < 1.1 * rms(right)


@pytest.mark.parametrize('scatter', [0.7, 2.0, 6.0])
def test_a_speed_that_begins_to_scatter_is_used_with_that_noise(scatter):
    # given a wheel speed that claims 0.05 m/s or so and scatters by much more from the middle of the drive on
    for seed in (4, 5):
        recording = drive(seed, speeds=10.0)
        speed = recording.speed
        at = (speed.stamp - speed.stamp[0]) / SECOND
        noise = scatter * np.random.default_rng(seed).standard_normal(len(at)) * (at > 100.0)
        noisy, fewer = replace(speed, speed=speed.speed + noise), speed.select(at < 100.0)
        (off, result), (without, _) = (off_with_fixes(recording, {'speed': one}) for one in (noisy, fewer))
        # then it costs nothing beside a filter without it, it is not refused, and neither is what is near by chance
        # taken for exact: the ellipse holds
        assert rms(off) < 1.1 * rms(without)
        event = result.measured.event[result.measured.kind == Kind.SPEED]
        assert (event[-800:, Event.VERDICT] == Verdict.REFUSED).mean() < 0.05
        truth = truth_of(recording, config('speed').parameters)
        errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
        assert np.mean(errors.nees < NEES_95) > 0.93


def test_it_is_used_again_when_its_ways_fit():
    # given a wheel speed in km/h for a minute, and right before and after
    recording = drive(3)
    speed = recording.speed
    at = (speed.stamp - speed.stamp[0]) / SECOND
    result = run(config('speed'), recording.imu, recording.gnss, Aiding(speed=replace(
        speed, speed=speed.speed * np.where((at > 60.0) & (at < 120.0), 3.6, 1.0))))
    contradicted = result.measured.event[:, Event.VERDICT] == Verdict.CONTRADICTED
    refused = (result.measured.stamp[contradicted] - speed.stamp[0]) / SECOND
    assert 60.0 < refused.min() < 75.0
    assert 118.0 < refused.max() < 150.0


def test_the_relative_error_and_its_variance_are_those_of_a_kalman_filter():
    # given ways that are 4 % too long and turned by 0.1 rad, in all directions, and the real equations written down
    rng, mem = np.random.default_rng(1), np.zeros(INPUT_SIZE)
    mem[Integral.TIME] = 60.0
    displacement._begin(mem, 0, 2.0)
    # distance north and east, relative error
    x, p = np.zeros(4), np.diag([2.0, 2.0, displacement.ERROR_PRIOR, displacement.ERROR_PRIOR])
    h, last = np.eye(2, 4), np.zeros(2)
    off = -rng.normal(0.0, np.sqrt(2.0), 2)  # true distance, where the one at the first fix is measured as zero
    for k in range(60):
        gone = 8.0 * np.exp(0.1j * k)
        way_of_input = (1.04 + 0.1j) * gone
        off = off + [(way_of_input - gone).real, (way_of_input - gone).imag]
        measured = off + rng.normal(0.0, np.sqrt(2.0), 2)
        mem[Integral.TRAVELLED:Integral.TRAVELLED + 2] = gone.real, gone.imag
        assert displacement.learn(mem, 0, way_of_input, way_of_input - complex(*(measured - last)), 0.05, 2.0)
        last = measured
        f = np.eye(4)
        f[:2, 2:] = [[gone.real, -gone.imag], [gone.imag, gone.real]]
        wandered = p.copy()
        wandered[[2, 3], [2, 3]] = np.minimum(wandered[[2, 3], [2, 3]] + displacement.ERROR_WALK * 8.0,
                                              displacement.ERROR_PRIOR)
        x, p = f @ x, f @ wandered @ f.T + np.diag([0.05, 0.05, 0.0, 0.0])
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + 2.0 * np.eye(2))
        x, p = x + gain @ (measured - h @ x), p - gain @ h @ p
        np.testing.assert_allclose(mem[Integral.RELATIVE_ERROR:Integral.RELATIVE_ERROR + 2], x[2:], atol=1e-9)
        np.testing.assert_allclose([mem[Integral.DISTANCE_VARIANCE], displacement.ERROR_PRIOR - mem[Integral.REDUCED]],
                                   p[[0, 2], [0, 2]])
    assert displacement.is_compared(mem, 0)
    np.testing.assert_allclose(mem[Integral.RELATIVE_ERROR:Integral.RELATIVE_ERROR + 2], [0.04, 0.1],
                               atol=4.0 * np.sqrt(p[2, 2]))


@pytest.mark.parametrize('down', [np.nan, 0.0])
def test_a_velocity_without_a_vertical_one_is_used(down):
    # given a receiver that says no vertical velocity, or always that it is zero, on hills
    recordings = [drive(seed) for seed in (2, 3)]
    errors = {}
    for recording in recordings:
        flat = recording.velocity.velocity.copy()
        flat[:, 2] = down
        velocity = replace(recording.velocity, velocity=flat)
        errors.setdefault('flat', []).append(largest_errors(recording, {'velocity': velocity}))
        errors.setdefault('all', []).append(largest_errors(recording, {'velocity': recording.velocity}))
        counts = run(config('velocity'), recording.imu, recording.gnss, Aiding(velocity=velocity)).measured.verdicts(
            Kind.VELOCITY)
        assert counts[Verdict.USED] > 0.8 * len(velocity), counts
    # then what it says is worth about as much
    assert np.mean(errors['flat']) < 1.3 * np.mean(errors['all']) + 1.0, errors


def robot(seed=5, **more):
    """A robot of 0.4 m/s that turns on the spot, with fixes of 2 cm from an antenna 0.5 m before its axle, and what it
    tells: wheels ten times a second, velocity and heading once."""
    drive = simulate_drive(240.0, seed, 50.0, standstill=10.0, manoeuvres=SLOW)
    values = {'gnss.lever_arm': [0.5, 0.0, 0.4], 'vehicle.zero_velocity': False, **more}
    made = simulate_recording(
        drive, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'), GnssNoise(0.02, 5.0),
        [(EFFECTS['gnss_lever_arm'], {'x': 0.5, 'y': 0.0, 'z': 0.4})], seed=seed,
        aiding=SimulatedAiding(twist_rate=10.0, twist_sigma=0.01, velocity_rate=1.0, heading_rate=1.0))
    names = ('twist', 'velocity', 'heading')
    settings = table.check({**{f'{name}_topic': f'/{name}' for name in names}, **values})
    return FilterConfig.from_parameters(settings), made.recording


def test_what_a_robot_tells_that_turns_on_the_spot_is_its_way():
    # given inputs that are right
    settings, recording = robot()
    result = run(settings, recording.imu, recording.gnss, Aiding(
        {name: recording.streams()[name] for name in ('twist', 'velocity', 'heading')}))
    # then none is refused for its way: neither the antenna's arc about the axle is one, nor what a robot goes within
    # the second between two speeds
    for kind in (Kind.TWIST, Kind.VELOCITY, Kind.HEADING):
        counts = result.measured.verdicts(kind)
        assert counts[Verdict.USED] > 100 and Verdict.CONTRADICTED not in counts, counts


@pytest.mark.parametrize('name, matrix', [('twist', np.diag([3.6, 3.6, 1.0])), ('velocity', -np.eye(3))])
def test_what_a_robot_tells_wrong_is_not_its_way(name, matrix):
    settings, recording = robot()
    bad = turned(name, recording.streams()[name], matrix)
    counts = run(settings, recording.imu, recording.gnss, Aiding({name: bad})).measured.verdicts(KINDS[name])
    assert counts[Verdict.CONTRADICTED] > 0.6 * len(bad) and counts.get(Verdict.USED, 0) < 0.02 * len(bad), counts


@pytest.mark.parametrize('seed', [5, 6])
def test_a_quiet_robot_does_not_stand_while_its_wheels_turn(seed):
    # given a robot on even ground that is as quiet in motion as at rest, and standstills by the accelerometers
    settings, recording = robot(seed, **{'vehicle.zero_velocity': True})
    result = run(settings, recording.imu, recording.gnss, Aiding(twist=recording.streams()['twist']))
    # then it neither loses its heading nor its place, driving or turning on the spot
    true = recording.reference
    north, east = radii(result.latitude)
    off = np.hypot((result.latitude - np.interp(result.stamp, true.stamp, true.latitude)) * north,
                   (result.longitude - np.interp(result.stamp, true.stamp, true.longitude)) * east
                   * np.cos(result.latitude))
    yaw = np.interp(result.stamp, true.stamp, np.unwrap(true.yaw))
    turned_off = np.abs(np.angle(np.exp(1j * (result.yaw - yaw))))
    settled = result.stamp > result.stamp[0] + 20 * SECOND
    largest = np.degrees(turned_off[settled].max())
    assert off.max() < 0.3 and largest < 5.0, (off.max(), largest)


def off_with_fixes(recording, measured, after=30.0):
    """Distance of the filter's position from the truth, m, `after` s and later."""
    result, true = run(config(*measured), recording.imu, recording.gnss, Aiding(measured)), recording.reference
    north, east = radii(result.latitude)
    off = np.hypot((result.latitude - np.interp(result.stamp, true.stamp, true.latitude)) * north,
                   (result.longitude - np.interp(result.stamp, true.stamp, true.longitude)) * east
                   * np.cos(result.latitude))
    return off[result.stamp > recording.imu.stamp[0] + after * SECOND], result


def test_a_speed_that_becomes_one_of_another_unit_does_not_make_the_filter_refuse_the_fixes_for_long():
    for seed in (2, 3):
        # given a wheel speed that has another unit from 80 s on
        recording = drive(seed)
        off, result = off_with_fixes(recording, {'speed': changed(recording.speed, 80.0, 0.62)})
        # then it is refused as not the way between the fixes, and the filter is where these are
        of_speed = result.measured.kind == Kind.SPEED
        since = (result.measured.stamp[of_speed] - recording.speed.stamp[0]) / SECOND
        refused = result.measured.event[of_speed, Event.VERDICT] == Verdict.CONTRADICTED
        assert not refused[since < 80.0].any() and refused[since > 120.0].all()
        assert np.sqrt(np.mean(off[-50 * 60:] ** 2)) < 2.0  # the last minute


def changed(speeds, begin, share):
    """`speeds` that are `share` times as large from `begin`, s, on."""
    return replace(speeds, speed=speeds.speed * np.where((speeds.stamp - speeds.stamp[0]) / SECOND > begin, share, 1.0))


@pytest.mark.parametrize('share', [1.1, 0.93])
def test_a_speed_that_becomes_a_tenth_larger_has_another_scale(share):
    for seed in (2, 3, 7):
        # given wheels that turn by some percent more or less than they roll from 80 s on, as on grass
        recording = drive(seed)
        (off, result), (_, before) = (off_with_fixes(recording, {'speed': speeds}) for speeds in (
            changed(recording.speed, 80.0, share), recording.speed))
        without, _ = off_with_fixes(recording, {})
        # then that is found, as sure as it says, the speed is used, and the position is as good as without it at least
        at = result.config.layout.extras.index('speed_scale')
        scale, sigma = result.extras[-1, at], result.sigma[-1, result.config.layout.index('speed_scale')]
        assert 1.0 + scale == pytest.approx(share * (1.0 + before.extras[-1, at]), abs=4.0 * sigma) and sigma < 0.01
        of_speed = result.measured.event[result.measured.kind == Kind.SPEED, Event.VERDICT]
        assert np.isin(of_speed[-400:], (Verdict.USED, Verdict.WEIGHTED)).mean() > 0.95
        last_minute = slice(-50 * 60, None)
        assert rms(off[last_minute]) < 1.1 * rms(without[last_minute]) + 0.1


@pytest.mark.parametrize('seed', [3, 4])
def test_a_scale_that_changes_by_little_is_not_followed_when_the_state_has_become_uncertain(seed):
    # given fixes of 10 Hz and wheels of 100 Hz that turn by a tenth more from when the vehicle drives at about 5 m/s
    recording = drive(seed, rate=10.0, speeds=100.0)
    at = (recording.speed.stamp - recording.speed.stamp[0]) / SECOND
    mean = np.convolve(recording.speed.speed, np.ones(100) / 100, 'same')
    begin = at[np.flatnonzero((at > 80.0) & (at < 160.0) & (mean > 3.0) & (mean < 5.0))[0]]
    off, result = off_with_fixes(recording, {'speed': changed(recording.speed, begin, 1.1)})
    # then they are refused at once, and when they fit again it is the scale that has become another one
    of_speed = result.measured.kind == Kind.SPEED
    since = (result.measured.stamp[of_speed] - recording.speed.stamp[0]) / SECOND - begin
    refused = result.measured.event[of_speed, Event.VERDICT] == Verdict.REFUSED
    assert refused[(since > 0.0) & (since < 1.0)].mean() > 0.9
    time = (result.stamp[-len(off):] - recording.speed.stamp[0]) / SECOND - begin
    assert off[(time > 0.0) & (time < 30.0)].max() < 1.5  # 3.3 and 10 m where it is used as the wheels it was


def test_a_heading_that_is_mounted_some_degrees_off_is_worth_as_much():
    for seed in (2, 3):
        # given antennas that are turned by five degrees, which nobody has declared
        recording = drive(seed)
        turned_by = replace(recording.heading, yaw=recording.heading.yaw + np.radians(5.0))
        right, _ = off_with_fixes(recording, {'heading': recording.heading})
        off, result = off_with_fixes(recording, {'heading': turned_by})
        # then that is estimated, all are used, and nothing else is blamed
        index = result.config.layout.extras.index('heading_offset')
        assert np.degrees(result.extras[-1, index]) == pytest.approx(5.0, abs=1.0)
        assert set(result.measured.verdicts(Kind.HEADING)) <= {Verdict.USED, Verdict.WEIGHTED, Verdict.AWAITED}
        assert np.sqrt(np.mean(off**2)) < 1.1 * np.sqrt(np.mean(right**2)) + 0.1
        assert not result.notices or not any('sideways' in n.text or 'rejected' in n.text for n in result.notices)


@pytest.mark.parametrize(('wrong', 'fits_an_offset'), [
    (lambda yaw: yaw + np.pi, False), (lambda yaw: -yaw, False), (lambda yaw: yaw + 1.0, True)])
def test_a_heading_that_is_wrong_from_the_begin_on_costs_nothing(wrong, fits_an_offset):
    # given a heading that is half a turn off, counted the other way round, or 57 deg off
    recording = drive(3)
    heading = replace(recording.heading, yaw=wrong(recording.heading.yaw))
    off, result = off_with_fixes(recording, {'heading': heading})
    none, _ = off_with_fixes(recording, {})
    counts = result.measured.verdicts(Kind.HEADING)
    assert fits_an_offset or counts[Verdict.CONTRADICTED] > 0.5 * len(heading), counts
    assert np.sqrt(np.mean(off**2)) < 1.2 * np.sqrt(np.mean(none**2)) + 0.2


def test_a_velocity_that_is_always_zero_is_not_used_where_the_filter_does_not_know_its_speed_either():
    without, with_it = [], []
    for seed in (2, 3):
        recording = drive(seed)
        zero = replace(recording.velocity, velocity=0.0 * recording.velocity.velocity)
        without.append(off_without_fixes(recording, {}))
        with_it.append(off_without_fixes(recording, {'velocity': zero}))
    assert np.max(with_it) < 1.1 * np.max(without) + 1.0, (without, with_it)


def off_without_fixes(recording, measured, begin=90.0, duration=60.0):
    """Largest error of the position, m, in an outage of the fixes alone."""
    at = (recording.gnss.stamp - recording.imu.stamp[0]) / SECOND
    return off_with_fixes(replace(recording, gnss=recording.gnss.select((at < begin) | (at > begin + duration))),
                          measured, begin)[0].max()


@pytest.mark.parametrize(('kind', 'ratio', 'off'), [
    (Kind.SPEED, 1.1, 0.1), (Kind.SPEED, -1.0, 2.0), (Kind.SPEED, 1.0 + 0.3j, 0.0), (Kind.TWIST, 0.0, 1.0),
    (Kind.VELOCITY, 0.8j, np.hypot(1.0, 0.8)), (Kind.HEADING, np.exp(0.2j), 0.2), (Kind.HEADING, -1.0, np.pi),
    (Kind.HEADING, -np.exp(0.01j), np.pi - 0.01), (Kind.MAGNETIC, 1.5, 0.0)])
def test_the_direction_of_a_heading_is_compared_and_the_length_of_a_speed(kind, ratio, off):
    # given a way that is so many times the one of the fixes, and turned; with a sigma of nearly nothing
    mem = np.zeros(INPUT_SIZE)
    mem[Integral.RELATIVE_ERROR:Integral.RELATIVE_ERROR + 2] = np.real(ratio) - 1.0, np.imag(ratio)
    mem[Integral.REDUCED] = displacement.ERROR_PRIOR - 1e-12
    assert off == 0.0 or displacement.differs(mem, 0, kind, off - 0.01)
    assert not displacement.differs(mem, 0, kind, off + 0.01)


def compared(ways, mem=None):
    """What is seen of an input with such ways while the vehicle goes 10 m north each second; fixes of 1 m^2."""
    if mem is None:
        mem = np.zeros(INPUT_SIZE)
        mem[Integral.TIME] = 30.0
        displacement._begin(mem, 0, 1.0)
    since = np.zeros(2)  # the latest fix that has been compared, by the input and by the fixes
    for one in ways:
        since += one, 10.0
        mem[Integral.TRAVELLED] = since[1]
        if displacement.learn(mem, 0, complex(since[0]), complex(since[1]), 0.0, 1.0):
            since[:] = 0.0
    return mem


def test_one_fix_that_is_far_off_is_passed_over_and_two_are_another_speed():
    right = compared([10.0] * 30)
    # given a fix that is 30 m off, after which the next one is right again
    mem = compared([40.0, -20.0, 10.0], right.copy())
    np.testing.assert_allclose(mem[Integral.RELATIVE_ERROR], 0.0, atol=1e-3)
    assert displacement.is_compared(mem, 0) and mem[Integral.REDUCED] > 0.9 * displacement.ERROR_PRIOR
    mem[Integral.TIME] = 40.0
    compared([10.0] * 3, mem)
    assert mem[Integral.COMPARED] == 30.0  # since then
    # given a unit that changes
    mem = compared([36.0, 36.0], right.copy())
    assert not displacement.is_compared(mem, 0)
    mem[Integral.TIME] = 70.0
    compared([36.0] * 6, mem)
    assert mem[Integral.COMPARED] == 70.0 and displacement.differs(mem, 0, Kind.SPEED, 0.05)
    # when it is the right one again, it is refused until that is known
    compared([10.0, 10.0], mem)
    assert not displacement.is_compared(mem, 0) and mem[Integral.REDUCED] == 0.0
    compared([10.0] * 12, mem)
    assert displacement.is_compared(mem, 0) and not displacement.differs(mem, 0, Kind.SPEED, 0.05)


@pytest.mark.parametrize('rate', [10.0, 100.0])
def test_stamps_that_may_be_late_count_by_the_change_of_velocity_and_not_by_its_noise(rate):
    # given a speed north with a noise of 0.05 m/s that goes from 5 to 8 m/s in five seconds, stamps known to 0.3 s
    mem, rng = np.zeros(Nav.SIZE + INPUT_SIZE), np.random.default_rng(1)
    own, sigma = Nav.SIZE, 0.3
    time = np.arange(1, round(5.0 * rate) + 1) / rate
    said = 5.0 + 3.0 * time / 5.0 + 0.05 * rng.standard_normal(len(time))
    mem[own + Integral.START] = mem[own + Integral.TIME] = 1e-9
    mem[own + Integral.LAST] = mem[own + Integral.BEGAN] = 5.0
    for now, north in zip(time, said):
        displacement.integrate(mem, 0, own, now, north, 0.0, 0.0, 0.0, 0.0, sigma**2)
    # then its integral is off by the offset times the change of velocity, at any rate
    assert mem[own + Integral.LATE] == pytest.approx((sigma * (said[-1] - 5.0)) ** 2)
    assert mem[own + Integral.VARIANCE] < 0.01


@pytest.mark.parametrize('fitted, misled', [(99.9, True), (98.0, True), (94.0, False), (0.0, False)])
def test_only_an_input_that_was_used_since_the_fix_before_has_misled_the_filter(fitted, misled):
    # given a velocity at 100 s that contradicts the fixes, the one before them at 99 s, and when it fitted last
    mem, r, at = np.zeros(3000), 1000, 2800
    own = r + 1500 - INPUT_SIZE
    mem[Head.WIDTH], mem[Head.LATERAL_SIGMA] = 1500, 0.3
    mem[at + Event.KIND], mem[at + Event.INPUT], mem[at + Event.TIME] = Kind.VELOCITY, 1, 100.0
    mem[own + Integral.START], mem[own + Integral.COMPARED], mem[own + Fit.TIME] = 99.0, -1.0, fitted
    inputs._note_wrong_displacement(mem, r, at, 15)
    # then all fixes are used for a while only where it has, and it is refused in any case
    assert (mem[r + Nav.USE_ALL_FIXES] > 0.0) == misled and mem[own + Fit.TIME] == -100.0


@pytest.mark.parametrize('believed, lasts', [(99.0, 0.9), (93.9, 6.0), (20.0, 20.0)])
def test_what_an_input_has_misled_is_undone_for_as_long_as_it_was_believed(believed, lasts):
    # given a velocity half as fast again as the fixes, known since `believed` s and used until 99.9 s, at 100 s
    mem, r, at = np.zeros(3000), 1000, 2800
    own = r + 1500 - INPUT_SIZE
    mem[Head.WIDTH], mem[Head.LATERAL_SIGMA] = 1500, 0.3
    mem[at + Event.KIND], mem[at + Event.INPUT], mem[at + Event.TIME] = Kind.VELOCITY, 1, 100.0
    mem[own + Integral.START], mem[own + Integral.COMPARED], mem[own + Fit.TIME] = 99.0, believed, 99.9
    mem[own + Integral.RELATIVE_ERROR], mem[own + Integral.REDUCED] = 0.5, displacement.ERROR_PRIOR - 0.05**2
    inputs._note_wrong_displacement(mem, r, at, 15)
    # then all fixes are used for as long, 20 s at most
    assert mem[r + Nav.USE_ALL_FIXES] == pytest.approx(lasts)
    # and a longer time that began before is not cut
    mem[r + Nav.USE_ALL_FIXES], mem[own + Fit.TIME] = 15.0, 99.9
    inputs._note_wrong_displacement(mem, r, at, 15)
    assert mem[r + Nav.USE_ALL_FIXES] == pytest.approx(max(lasts, 15.0))
