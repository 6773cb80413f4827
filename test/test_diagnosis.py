"""The whole diagnosis on simulated drives with effects that it is not told of. Truth is what was simulated."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_support import PAPER

from mems_ins_fusion.diagnosis.diagnose import diagnose
from mems_ins_fusion.diagnosis.fit import fit, scores
from mems_ins_fusion.diagnosis.folds import part_masks
from mems_ins_fusion.diagnosis.held_out import held_out
from mems_ins_fusion.diagnosis.noise import noise_unknowns
from mems_ins_fusion.diagnosis.problem import DiagnosisError, Problem
from mems_ins_fusion.diagnosis.tracing import effect_unknowns
from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.navigation.frames import mounting
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

DURATION, RATE = 480.0, 25.0
# the simulated reference is the IMU's own position
VALUES = table.check({**PAPER, 'reference_lever_arm': [0.0, 0.0, 0.0]})
OUTAGES = {'durations': (10.0,), 'spacing': 60.0}
FEW = [EFFECTS[name] for name in ('gnss_time_offset', 'accelerometer_scale', 'gyroscope_scale', 'tilt')]


class Placebo(Effect):
    """Something that has nothing to do with the data: slow waves in the forward specific force."""

    name = 'placebo'
    parameters = (EffectParameter('size', 'm/s^2', 0.05),)

    def applied(self, values, recording, theta, attitude=None):
        time = (recording.imu.stamp - recording.imu.stamp[0]) * 1e-9
        wave = np.sin(2 * np.pi * time / 37.0) + np.sin(2 * np.pi * time / 23.0 + 1.0)
        force = recording.imu.specific_force - theta['size'] * wave[:, None] * [1.0, 0.0, 0.0]
        return values, replace(recording, imu=replace(recording.imu, specific_force=force))


def recorded(name=None, duration=DURATION, seed=1, values=VALUES, **theta):
    drive = simulate_drive(duration, seed, RATE)
    sensors = SensorErrors.from_parameters(values, values['sensor_error_model'])
    effects = [(EFFECTS[name], theta)] if name else []
    return simulate_recording(drive, sensors, GnssNoise(sigma=0.5), effects, seed=seed).recording


@pytest.fixture(scope='module')
def plain():
    return recorded()


@pytest.fixture(scope='module')
def undisturbed(plain):
    """The diagnosis of a drive without effects, with all effects as candidates, and what its progress was."""
    progress = []
    result = diagnose(plain, VALUES, lambda part, what: progress.append((part, what)),
                      [*EFFECTS.values(), Placebo()], **OUTAGES)
    return result, progress


@pytest.fixture(scope='module')
def scaled():
    """A drive with scale factors, and its diagnosis."""
    recording = recorded('accelerometer_scale', x=0.06, y=-0.06)
    return recording, diagnose(recording, VALUES, effects=FEW, **OUTAGES)


@pytest.fixture(scope='module')
def problem(plain):
    return Problem(plain, VALUES)


def added(diagnosis):
    return [f for f in diagnosis.findings if f.added]


def rms(measured):
    return np.sqrt(np.mean(measured.continuous.horizontal**2))


def test_scores_of_an_effect_are_the_slope_of_the_likelihood(problem):
    # given a filter at a wrong scale factor and a wrong noise level, where the likelihood rises steeply
    unknowns = [*noise_unknowns(problem)[:1], *effect_unknowns(EFFECTS['gyroscope_scale'], {})]
    x = np.array([0.4, 0.02])

    def likelihood(x):
        return problem.residual(*problem.assume(unknowns, x)).log_likelihood()[problem.mask].sum()
    slope = [(likelihood(x + h) - likelihood(x - h)) / (2 * h.sum()) for h in np.diag([1e-4, 1e-5])]
    _, found = scores(problem, unknowns, x)
    # then the central difference agrees closely, the noise level's forward one to its step of 5 %
    gradient = found.gradient(problem.mask)
    assert gradient[1] == pytest.approx(slope[1], rel=0.02)
    assert gradient[0] == pytest.approx(slope[0], rel=0.15)


def test_how_much_of_the_attitude_is_error(problem):
    # given a level road, where all that a strapdown run has of roll and pitch is error, and one with slopes
    drive = simulate_drive(DURATION, 1, RATE, grade=0.08)
    hills = simulate_recording(drive, SensorErrors.from_parameters(VALUES, VALUES['sensor_error_model']),
                               GnssNoise(sigma=0.5), seed=1).recording
    sloping = Problem(hills, VALUES)
    roll, pitch = sloping.attitude(sloping.recording)
    true = np.interp(sloping.recording.imu.stamp, drive.stamp, drive.pitch)
    # then a regression on it may be diluted by the part that errors have in it
    off = (pitch - true)[pitch != 0.0]
    assert problem.diluted > 0.5 > 4 * sloping.diluted
    assert off.var() / pitch[pitch != 0.0].var() < sloping.diluted


def test_what_moves_nothing_leaves_the_innovations_as_they_are(problem):
    unknowns = [*noise_unknowns(problem), *effect_unknowns(EFFECTS['accelerometer_scale'], {})]
    same = problem.residual(*problem.assume(unknowns, np.zeros(len(unknowns))))
    assert np.allclose(same.z, problem.base.z, rtol=0, atol=1e-9, equal_nan=True)


def test_a_time_offset_is_found_with_its_value_and_taken_out(undisturbed):
    # given a receiver whose stamps are 0.2 s late, and all effects as candidates, a placebo among them
    recording = recorded('gnss_time_offset', time_offset=0.2)
    result = diagnose(recording, VALUES, effects=[*EFFECTS.values(), Placebo()], **OUTAGES)
    # then it alone is found, within 3 sigma of the truth
    [finding] = added(result)
    assert finding.name == 'gnss_time_offset'
    offset = finding.parameters['time_offset']
    value, sigma = offset.value, offset.sigma
    assert offset.unit == 's' and 0 < sigma < 0.03 and abs(value - 0.2) < 3 * sigma
    assert finding.changes == {'gnss.time_offset': result.corrected['gnss.time_offset'],
                               'gnss.time_offset_sigma': offset.sigma}
    assert result.corrected['gnss.time_offset_sigma'] == offset.sigma
    assert finding.held_out.helps
    # the error is that without the effect and what 3 sigma (of half the data: sqrt 2 more) are at this speed
    clean = rms(undisturbed[0].before)
    speed = np.sqrt((recording.reference.velocity[:, :2] ** 2).sum(axis=1).mean())
    assert rms(result.after) < np.hypot(1.05 * clean, 3 * np.sqrt(2) * sigma * speed)
    assert rms(result.after) < 0.5 * rms(result.before)
    # the story's begin and end are told, and what cannot be known has no number
    assert not result.detections['before'].consistent and result.detections['after'].consistent
    assert not result.unexplained
    assert 'temperature' in result.hidden and 'sideslip' in result.hidden
    # and what is written loads again
    checked = table.check(result.corrected)
    assert checked['gnss.time_offset'] == pytest.approx(value)


def test_a_scale_factor_is_found_and_grouped_with_the_suspension_that_looks_the_same(scaled):
    [finding] = added(scaled[1])
    assert {'accelerometer_scale', 'tilt'} == set(finding.group)
    if finding.name == 'accelerometer_scale':
        for name, true in (('x', 0.06), ('y', -0.06)):
            estimate = finding.parameters[name]
            assert abs(estimate.value - true) < 3 * estimate.sigma < 0.06


def test_nothing_is_found_where_nothing_is(undisturbed):
    result, progress = undisturbed
    assert not added(result) and not result.unexplained
    assert result.detections['after'].consistent
    # and nothing is changed, and it says so
    assert not result.better and not result.changed and not result.noise
    # the receiver's level, which each fix shows, is what was simulated: 450 fixes of two components, and FLOOR
    assert abs(np.log(result.explained['gnss.sigma'])) < 0.03 + 4 / np.sqrt(2 * 900)
    parts = [part for part, _ in progress]
    assert parts == sorted(parts) and 0 < parts[0] and parts[-1] <= 1 and all(what for _, what in progress)


@pytest.mark.parametrize('seed', [1, 2])
def test_a_placebo_does_not_help_on_data_it_was_not_fitted_to(seed):
    # given a placebo that was put into the model all the same
    problem = Problem(recorded(seed=seed), VALUES)
    unknowns = [*noise_unknowns(problem)[:1], *effect_unknowns(Placebo(), {})]
    proof = held_out(fit(problem, unknowns, np.zeros(2)), fit(problem, unknowns[:1], np.zeros(1)), 1)
    assert not proof.helps
    # and a part that does not show it, within 1.96 sigma, would not have led to it: there it is left out
    longer = fit(problem, unknowns, np.zeros(2))
    for part, estimate in zip(part_masks(problem), proof.estimates, strict=True):
        x, covariance = longer.refitted(problem.mask & ~part, 1)
        assert (estimate[1] == 0.0) == (abs(x[1]) < 1.96 * np.sqrt(covariance[1, 1]))
    assert any(estimate[1] == 0.0 for estimate in proof.estimates)
    # while a real effect does: twice the wave that the placebo would take out
    _, disturbed = Placebo().applied(VALUES, problem.recording, {'size': -0.3})
    real = Problem(disturbed, VALUES)
    longer = fit(real, unknowns, np.zeros(2))
    assert longer.x[1] == pytest.approx(0.3, abs=0.1)
    assert held_out(longer, fit(real, unknowns[:1], np.zeros(1)), 1).helps


def test_an_effect_outside_the_library_is_not_blamed_on_one_inside(plain):
    # given accelerometers with a quadratic error, written into the recording's own numbers
    force = plain.imu.specific_force + 0.15 * plain.imu.specific_force**2 * [1.0, 1.0, 0.0]
    recording = replace(plain, imu=replace(plain.imu, specific_force=force))
    result = diagnose(recording, VALUES, effects=FEW, **OUTAGES)
    assert not result.detections['before'].consistent
    # then something stays unexplained, and it is said where and with what it goes
    assert result.unexplained
    assert {('forward accelerometer', 'forward acceleration squared'),
            ('lateral accelerometer', 'lateral acceleration squared')} <= {(r.where, r.what)
                                                                           for r in result.correlations}


def test_a_bias_that_goes_with_speed_is_named_and_measured(plain):
    # given a vertical gyroscope that reads 0.001 rad/s too much for each m/s, down positive
    speed = np.hypot(*plain.reference.velocity[:, :2].T)
    speed = np.interp(plain.imu.stamp, plain.reference.stamp, speed)
    rate = plain.imu.angular_rate + 0.001 * speed[:, None] * mounting(VALUES['imu.mounting_rpy'])[2]
    recording = replace(plain, imu=replace(plain.imu, angular_rate=rate))
    result = diagnose(recording, VALUES, effects=FEW, **OUTAGES)
    assert result.unexplained
    found = {(r.where, r.what): r for r in result.correlations}
    here = found['vertical gyroscope', 'speed']
    assert here.p < 1e-6 and here.unit == 'rad/s'
    # then its RMS is found, about the mean, of which the bias state takes care; a linear step from zero, so roughly
    assert here.rms == pytest.approx(0.001 * speed.std(), rel=0.4)


def test_temperature_coefficients_are_not_biased_by_the_standstill_before():
    # given biases that grow with a temperature that is 5 K below the reference at the first standstill
    true = {'accelerometer_x': 0.04, 'accelerometer_y': -0.05, 'gyroscope_z': 1e-3}
    result = diagnose(recorded('temperature', **true), VALUES, effects=[*FEW, EFFECTS['temperature']], **OUTAGES)
    [finding] = [f for f in added(result) if f.name == 'temperature']
    errors = {name: (e.value - true[name]) / e.sigma for name, e in finding.parameters.items()}
    assert {'accelerometer_x', 'accelerometer_y'} <= set(errors) and all(abs(e) < 3 for e in errors.values())


def test_coloured_noise_is_found_and_only_what_is_determined_gets_a_number():
    # given position errors of 2 m that last 15 s, and an IMU good enough to see them
    good = {'accelerometer.gauss_markov.sigma': [0.01], 'gyroscope.gauss_markov.sigma': [1e-4],
            'accelerometer.initial_sigma': [0.02], 'gyroscope.initial_sigma': [1e-3]}
    values = table.check({**PAPER, 'reference_lever_arm': [0.0, 0.0, 0.0], **good})
    recording = recorded('gnss_coloured_noise', values=values, sigma=2.0, tau=15.0)
    [finding] = added(result := diagnose(recording, values, effects=[*FEW, EFFECTS['gnss_coloured_noise']], **OUTAGES))
    assert finding.name == 'gnss_coloured_noise'
    assert table.check(result.corrected)['gnss.coloured_noise.sigma'] > 0.5
    # then sigma and tau are within 3 sigma, or they are said to trade against each other and have no number
    for name, true in (('sigma', 2.0), ('tau', 15.0)):
        if name in finding.parameters:
            estimate = finding.parameters[name]
            assert abs(estimate.value - true) < 3 * estimate.sigma
        else:
            low, high = (float(n) for n in result.hidden[f'gnss_coloured_noise.{name}'].split()[0:3:2])
            assert low < 1.5 * true and high > true / 1.5


def test_position_errors_decide_between_effects_that_explain_the_same(undisturbed):
    # given accelerometers that stand elsewhere, which fixes cannot tell from an antenna that does, and a reference at
    # the IMU's point that can
    recording = recorded('accelerometer_lever_arm', x=2.0, y=1.0)
    arms = [EFFECTS['gnss_lever_arm'], EFFECTS['accelerometer_lever_arm']]
    result = diagnose(recording, VALUES, effects=arms, **OUTAGES)
    [finding] = added(result)
    assert finding.name == 'accelerometer_lever_arm' and finding.group == ['accelerometer_lever_arm']
    for name, true in (('x', 2.0), ('y', 1.0)):
        estimate = finding.parameters[name]
        assert abs(estimate.value - true) < 3 * estimate.sigma
    assert rms(result.after) < 1.2 * rms(undisturbed[0].before)
    # and without that reference neither is preferred: withheld fixes are of the same antenna
    without = diagnose(replace(recording, reference=None), VALUES, effects=arms, **OUTAGES)
    assert {frozenset(f.group) for f in added(without)} == {frozenset(e.name for e in arms)}


def test_a_receiver_that_wanders_at_rest_does_not_hide_the_standstill():
    # given position errors of 1.5 m that change within 20 s
    recording = recorded('gnss_coloured_noise', sigma=1.5, tau=20.0, duration=80.0)
    assert Problem(recording, VALUES).start.standstill.duration > 20


def test_the_same_recording_gives_the_same_result(scaled):
    recording, first = scaled
    second = diagnose(recording, VALUES, effects=FEW, **OUTAGES)
    assert [(f.name, f.parameters) for f in first.findings] == [(f.name, f.parameters) for f in second.findings]
    assert added(first) and first.corrected == second.corrected and first.noise == second.noise
    assert np.array_equal(first.residuals['after'].z, second.residuals['after'].z, equal_nan=True)
    assert first.comparison == second.comparison


@pytest.mark.parametrize(('duration', 'needed'), [(70.0, 'fixes'), (20.0, '')])
def test_a_recording_that_is_too_short_says_what_is_needed(duration, needed):
    with pytest.raises(DiagnosisError) as told:
        diagnose(recorded(duration=duration), VALUES)
    text = str(told.value)
    assert text.startswith('simulation: ') and '\n' not in text and needed in text and len(text) > 20


def test_an_offset_and_a_mount_that_is_turned_are_found_together():
    # given fixes 0.6 s late, an IMU turned by 7 deg, and noise levels that are off (test_diagnosis_measured.py: both
    # with the defaults)
    drive = simulate_drive(DURATION, 3, RATE)
    sensors = SensorErrors.from_parameters(VALUES, 'gauss_markov')
    effects = [(EFFECTS['gnss_time_offset'], {'time_offset': 0.6}),
               (EFFECTS['mounting_rotation'], {'yaw': np.radians(7.0)})]
    recording = replace(simulate_recording(drive, sensors, GnssNoise(sigma=0.5), effects, seed=3).recording,
                        reference=None)
    values = table.check({'reference_lever_arm': [0.0, 0.0, 0.0], 'gnss.sigma': 2.0,
                          'gyroscope.noise_density': [2e-3], 'accelerometer.noise_density': [1e-3]})
    effects = [EFFECTS[name] for name in ('gnss_time_offset', 'mounting_rotation', 'gnss_lever_arm', 'sideslip')]
    result = diagnose(recording, values, effects=effects, **OUTAGES)
    # then both are found with their sizes, and nothing else
    found = {f.name: f.parameters for f in added(result)}
    assert set(found) == {'gnss_time_offset', 'mounting_rotation'}
    offset, yaw = found['gnss_time_offset']['time_offset'], found['mounting_rotation']['yaw']
    assert abs(offset.value - 0.6) < max(3 * offset.sigma, 0.02) and offset.sigma < 0.05
    assert abs(yaw.value - np.radians(7.0)) < np.radians(1.0)
    assert result.changed
    assert result.after.outages[0].max_error.mean() < 0.7 * result.before.outages[0].max_error.mean()


def test_slopes_are_found_where_no_score_shows_them():
    # given hills, a consumer's IMU that is a little crooked, and a planar filter whose noise levels hold the slopes
    drive = replace(REALISTIC, mounting_error=0.0).drive(DURATION, 30_013)
    sensors = SensorErrors.from_parameters(table.check({}), 'gauss_markov')
    crooked = [(EFFECTS['mounting_rotation'], {'roll': 0.01, 'pitch': -0.015})]
    recording = replace(simulate_recording(drive, sensors, GnssNoise(sigma=1.5), crooked, seed=13).recording,
                        reference=None)
    values = table.check({'mechanization': 'planar', 'vehicle.zero_velocity': False, 'vehicle.non_holonomic': False,
                          'reference_lever_arm': [0.0, 0.0, 0.0]})
    result = diagnose(recording, values, effects=[EFFECTS['tilt']], durations=(10.0, 30.0), spacing=30.0)
    # then the strapdown mechanization is proposed, for certain on held-out data, and errors are far smaller
    [finding] = added(result)
    assert finding.name == 'tilt' and finding.held_out.p < 0.01
    assert result.corrected['mechanization'] == 'strapdown'
    before, after = (np.mean(m.outages[0].max_error) for m in (result.before, result.after))
    assert after < 0.8 * before
