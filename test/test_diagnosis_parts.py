"""Parts of the diagnosis on simulated drives whose truth is known: whose clock, what the filter has learned."""
from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mems_ins_fusion.diagnosis.clock import lateness, lateness_against, reference_clock_of
from mems_ins_fusion.diagnosis.drives import Drives
from mems_ins_fusion.diagnosis.error_changes import compared, larger_errors
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.findings import Finding
from mems_ins_fusion.diagnosis.fit import fit
from mems_ins_fusion.diagnosis.held_out import HeldOut, held_out
from mems_ins_fusion.diagnosis.learned_mounting import learned_angles
from mems_ins_fusion.diagnosis.measured import measure_errors, without_clock_of_truth
from mems_ins_fusion.diagnosis.noise import calibrated, noise_unknowns
from mems_ins_fusion.diagnosis.problem import FLOOR, Problem, stated_covariances, with_covariances, without_adaptation
from mems_ins_fusion.diagnosis.trial_runs import FOR_EFFECTS, FOR_LEVELS, REPORTED, TrialRuns
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.comparison import compare, truth_of
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.reports.diagnosis import _interval, _noise, rounded_value, unexplained_text
from mems_ins_fusion.reports.diagnosis_answer import _size
from mems_ins_fusion.reports.effect_words import size_text
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

OFFSET = 0.3  # s


def recorded(duration=120.0, sigma=0.5, effects=()):
    values = table.check({})
    sensors = SensorErrors.from_parameters(values, values['sensor_error_model'])
    effects = [(EFFECTS[name], EFFECTS[name].complete(theta)) for name, theta in effects]
    return simulate_recording(simulate_drive(duration, 4, 25.0), sensors, GnssNoise(sigma=sigma), effects,
                              seed=4).recording


@pytest.fixture(scope='module')
def late():
    """Fixes stamped OFFSET late; the reference is in the IMU's clock."""
    return recorded(effects=[('gnss_time_offset', {'time_offset': OFFSET})])


def test_a_search_makes_a_constraint_no_stricter_than_configured(late):
    # given a vehicle that never slides
    problem = Problem(late, table.check({}))
    noise = noise_unknowns(problem)
    model = fit(problem, noise, calibrated(problem, noise))
    # then other levels may become smaller, and this one stands for every road
    levels = dict(zip((u.name for u in noise), model.x))
    assert levels['vehicle.non_holonomic_sigma'] == 0.0 and min(levels.values()) < 0.0


def in_receivers_clock(recording):
    reference = recording.reference
    return replace(recording, reference=replace(reference, stamp=reference.stamp + round(OFFSET * 1e9)))


def test_how_late_the_reference_is_against_the_fixes(late):
    value, sigma = lateness(late.reference, late.gnss)
    assert abs(value + OFFSET) < 4 * sigma < 0.1
    value, sigma = lateness(in_receivers_clock(late).reference, late.gnss)
    assert abs(value) < 4 * sigma < 0.1


@pytest.mark.parametrize('name, shared, alone', [('auto', 'gnss', 'auto'), ('imu', 'imu', 'imu'),
                                                 ('gnss', 'gnss', 'gnss'), ('own', 'own', 'own')])
def test_whose_clock_the_reference_runs_in(late, name, shared, alone):
    # given a reference in the receiver's clock, one in the IMU's, and fixes that are too few to tell
    assert reference_clock_of(in_receivers_clock(late), name).name == shared
    assert reference_clock_of(late, name).name == alone
    few = replace(in_receivers_clock(late), gnss=late.gnss.select(slice(0, 10)))
    assert reference_clock_of(few, name).name == alone
    # without a reference the fixes are the truth
    assert reference_clock_of(replace(late, reference=None), name).name == 'gnss'


def test_a_reference_in_the_receivers_clock_is_as_late_as_the_fixes(late):
    # given the filter that knows by how much the fixes are late, and a truth that is as late
    values = table.check({'gnss.time_offset': OFFSET, 'vehicle.zero_velocity': False})
    recording = in_receivers_clock(late)
    problem = Problem(recording, values)
    problem.reference_clock = 'gnss'
    found = measure_errors(problem, recording, recording.imu, [values], [10.0], 20.0)
    # then it is as good as it is; with twice the offset between them it would be 2 v OFFSET = 8 m off
    assert np.sqrt(np.mean(found.continuous.horizontal**2)) < 1.0
    # and the stamps are those of the truth given, by which models with other offsets are compared
    assert np.isin(found.continuous.stamp, recording.reference.stamp).all()


def test_the_errors_without_fixes_are_those_of_a_replay():
    # given fixes of 4 Hz that are stamped late, as the filter knows
    drive, effect = simulate_drive(120.0, 4, 25.0), EFFECTS['gnss_time_offset']
    recording = simulate_recording(drive, SensorErrors(), GnssNoise(sigma=0.5, rate=4.0),
                                   [(effect, {'time_offset': OFFSET})], seed=4).recording
    values = table.check({'gnss.time_offset': OFFSET, 'outage_durations': [10.0], 'outage_spacing': 17.0,
                          'models': ['gauss_markov'], 'update_intervals': [1.0]})
    recording = replace(recording, reference=None)
    # when a diagnosis measures them, and a replay does
    found = measure_errors(Problem(recording, values), recording, recording.imu, [values], [10.0], 17.0).outages[0]
    [replayed] = [result.outages for result in compare(recording, values).outages]
    # then outages begin at the same fixes, and errors are the same
    assert len(found.begin) == 3
    assert (found.begin - round(OFFSET * 1e9)).tolist() == replayed.begin.tolist()
    assert found.max_error.tolist() == replayed.max_error.tolist()


@pytest.mark.parametrize('clock', [0.0, 0.4, -3.0])
@pytest.mark.parametrize('offset', [0.0, OFFSET])
def test_a_reference_of_its_own_clock_judges_all_but_time(late, clock, offset):
    # given filters with and without the right offset, and a reference whose clock differs by any amount
    values = table.check({'gnss.time_offset': offset, 'vehicle.zero_velocity': False})
    off = replace(late.reference, stamp=late.reference.stamp + round(clock * 1e9))
    problem = Problem(replace(late, reference=off), values)
    problem.reference_clock = 'own'
    found = measure_errors(problem, replace(late, reference=off), late.imu, [values], [10.0], 20.0)
    # then the errors are as small as if both ran in one clock, and their stamps are those of the reference
    assert np.isin(found.continuous.stamp, off.stamp).all()
    assert np.sqrt(np.mean(found.continuous.horizontal**2)) < 1.0
    # and what the clock of the track differs by is the filter's offset and the reference's
    config = FilterConfig.from_parameters(values)
    track = run(config, late.imu, late.gnss)
    assert lateness_against(track, truth_of(replace(late, reference=off), values)) == pytest.approx(
        clock - (OFFSET - offset), abs=0.05)


@pytest.mark.parametrize('clock, veto', [(0.0, False), (OFFSET, True), (-1.0, False), (0.5, True)])
def test_no_offset_is_vetoed_by_the_clock_of_a_reference(late, clock, veto):
    # given a reference whose clock is late by `clock`, known to be the IMU's or not known, and the right offset
    recording = replace(late, reference=replace(late.reference, stamp=late.reference.stamp + round(clock * 1e9)))
    found = {}
    for name in ('imu', 'auto'):
        problem = Problem(recording, table.check({}))
        problem.reference_clock = name
        found[name] = [measure_errors(problem, recording, late.imu, [table.check({'gnss.time_offset': offset})], [],
                                      20.0)
                       for offset in (0.0, OFFSET)]
    # then a clock that is not known does not speak against it, even where errors with that clock taken for the IMU's do
    assert bool(larger_errors(compared(*found['imu']))) == veto
    assert not larger_errors(compared(*found['auto']))
    # and where they do not, it speaks for it
    before, after = found['auto']
    expected = (before.without_offset, after.without_offset) if veto else (before, after)
    assert without_clock_of_truth(before, after) == expected


@pytest.mark.parametrize('pitch, yaw', [(0.0, 0.1), (0.05, -0.08)])
def test_the_mountings_angles_are_those_that_the_filter_has_learned(pitch, yaw):
    recording = recorded(240.0, 0.1, [('mounting_rotation', {'roll': 0.0, 'pitch': pitch, 'yaw': yaw})])
    found = learned_angles(recording, table.check({}))
    for name, true in (('pitch', pitch), ('yaw', yaw)):
        assert found.whole[name].value == pytest.approx(true, abs=0.02)
    assert set(found.plain) == ({'yaw'} | ({'pitch'} if pitch else set()))
    # and declaring them takes them out
    declared = EFFECTS['mounting_rotation'].adjusted(table.check({}), {'roll': 0.0, **{
        name: e.value for name, e in found.whole.items()}})
    assert not learned_angles(recording, declared).plain


def test_a_mounting_that_is_no_state_is_not_learned():
    assert learned_angles(recorded(60.0), table.check({'imu.mounting_sigma': 0.0})) is None


def test_the_search_looks_through_a_filter_that_adapts_to_nothing(late):
    values = table.check({'gnss.sigma': 0.7, 'gnss.time_offset_sigma': 0.3})
    config = FilterConfig.from_parameters(without_adaptation(values, late))
    assert config.gnss.gate == config.parameters['gnss.robust_sigma'] == 0 and not config.parameters['gnss.adapt_sigma']
    assert 'time_offset' not in config.layout.names
    # each fix is believed as the filter of the user would, and FLOOR
    fixes = with_covariances(late.gnss, stated_covariances(late.gnss, values), np.log(2.0),
                             np.arange(len(late.gnss)) == 7)
    assert np.allclose(fixes.covariance[:, 0, 0], (2 * 0.7) ** 2 + FLOOR**2)
    assert np.flatnonzero(fixes.status < 0).tolist() == [7]
    told = stated_covariances(late.gnss, table.check({}))
    assert np.allclose(told[:, :2, :2], late.gnss.covariance[:, :2, :2])
    silent = replace(late.gnss, covariance_type=np.zeros(len(late.gnss), dtype=np.uint8))
    assert np.allclose(stated_covariances(silent, table.check({}))[:, 0, 0], 9.0)


@pytest.mark.parametrize('told', [True, False])
def test_the_search_uses_standstills_only_where_they_can_be_told_from_motion(late, monkeypatch, told):
    # given a drive that shows standstills, or motion that is as quiet
    monkeypatch.setattr('mems_ins_fusion.diagnosis.problem.standstills_show', lambda *recorded: (told, 0.1))
    asked = []
    monkeypatch.setattr(TrialRuns, '_measured', lambda trials, models, use: asked.append((use, *models)))
    given = table.check({'speed.time_offset_sigma': 0.1})
    trials = TrialRuns((late,), Drives([Problem(late, given)]), (), (10.0,), 30.0, lambda *said: None)
    # when filters are tried for a decision on effects, for the report, and for the choice of noise levels
    trials.errors([given])
    trials.errors([given], full=True)
    trials.each([given])
    # then decisions on effects stand on them only where they show, and on nothing that adapts; the others are of the
    # filter that drives
    assert trials.origin.each[0].values['vehicle.zero_velocity'] is told
    assert [use for use, _ in asked] == [FOR_EFFECTS, REPORTED, FOR_LEVELS]
    assert [values['vehicle.zero_velocity'] for _, values in asked] == [told, True, True]
    assert [values['imu.adapt_noise'] for _, values in asked] == [False, True, True]
    assert [values['speed.time_offset_sigma'] for _, values in asked] == [0.0, 0.1, 0.1]
    assert trials.without_standstills == ({} if told else {'vehicle.zero_velocity': False})
    assert trials.switches == ('imu.adapt_noise', *(() if told else ['vehicle.zero_velocity']))


def test_standstills_are_tried_where_a_file_does_without(late):
    trials = TrialRuns((late,), Drives([Problem(late, table.check({'vehicle.zero_velocity': False}))]), (), (10.0,),
                       30.0, lambda *said: None)
    assert 'vehicle.zero_velocity' in trials.switches


def test_a_fix_that_is_far_off_is_set_aside(late):
    latitude = late.gnss.latitude.copy()
    latitude[60] += 300.0 / 6.4e6
    wrong = replace(late, gnss=replace(late.gnss, latitude=latitude))
    problem = Problem(wrong, table.check({}))
    assert np.flatnonzero(problem.outlying).tolist() == [60] and not problem.mask[60]


@pytest.mark.parametrize('effect, parameter, value, sigma, unit, said', [
    ('gnss_time_offset', 'time_offset', 0.25, 0.01, 's',
     'fixes are stamped 0.250 \N{PLUS-MINUS SIGN} 0.010 s too late'),
    ('gnss_time_offset', 'time_offset', -0.25, 0.01, 's', 'too early'),
    ('mounting_rotation', 'yaw', math.radians(-5.0), math.radians(0.5), 'rad',
     'it is turned 5.00 \N{PLUS-MINUS SIGN} 0.50 deg more to the right'),
    ('mounting_rotation', 'pitch', 0.1, 0.01, 'rad', 'more forward'),
    ('accelerometer_scale', 'x', 0.05, 0.01, '-', 'forward 5.0 \N{PLUS-MINUS SIGN} 1.0 % too much'),
    ('gnss_lever_arm', 'y', -0.8, 0.1, 'm', 'further right'),
    ('g_sensitivity', 'x', 1e-3, 1e-4, '(rad/s)/(m/s^2)', 'x 0.0010'),
])
def test_the_size_of_an_effect_in_words(effect, parameter, value, sigma, unit, said):
    assert said in size_text(effect, parameter, Estimate(value, sigma, unit))


@pytest.mark.parametrize('stated, value, said', [
    (0.3, -0.02, 'stamped 0.02 s earlier than your file says'), (0.3, 0.02, '0.02 s later than your file says'),
    (0.0, -0.02, 'stamped 0.02 s too early')])
def test_a_time_offset_is_in_addition_to_that_of_the_file(stated, value, said):
    # given an offset that was found with a file that states one, or none
    finding = Finding('gnss_time_offset', ['gnss_time_offset'], {'time_offset': Estimate(value, None, 's')}, 50.0, 1e-6,
                      True, HeldOut(20.0, 1e-6, []), changes={'gnss.time_offset': stated + value})
    # then its words are those of what the file lacks
    assert _size(finding, SimpleNamespace(values={'gnss.time_offset': stated}, hidden={})).endswith(said)


@pytest.mark.parametrize('name', EFFECTS)
def test_the_words_for_an_effect_are_of_parameters_that_it_has(name):
    effect = EFFECTS[name]
    assert effect.in_words
    assert {*effect.sizes, *effect.largest} <= {p.name for p in (*effect.traced, *effect.parameters)} | {'z', 'tau'}
    assert bool(effect.largest) == bool(effect.larger_is) and bool(effect.smallest) == bool(effect.smaller_is)


@pytest.mark.parametrize('sigmas, supported', [(1.5, False), (2.5, True)])
def test_what_the_other_parts_do_not_support_is_not_held_against_a_part(sigmas, supported):
    # given an effect that the other parts of the data show with so many sigma, and that gains 1 at each fix
    stamp = np.arange(300) * 10**9

    class Alike:
        """A residual of whose fixes each has a likelihood that grows with the effect's estimate."""

        def __init__(self, x):
            self.x = x

        def log_likelihood(self):
            return np.full(len(stamp), 10.0 * self.x)

    problem = SimpleNamespace(stamp=stamp, mask=np.ones(len(stamp), dtype=bool),
                              residuals=lambda unknowns, found: [Alike(x[-1] if len(x) > 1 else 0.0) for x in found])
    problem.each = [problem]
    noise, effect = SimpleNamespace(name='noise'), SimpleNamespace(name='effect')
    longer = SimpleNamespace(problem=problem, unknowns=[noise, effect], refitted=lambda mask, count: (
        np.array([0.0, 0.1]), np.diag([1.0, (0.1 / sigmas) ** 2])))
    shorter = SimpleNamespace(unknowns=[noise], refitted=lambda mask, count: (np.zeros(1), np.eye(1)))
    proof = held_out(longer, shorter, 1)
    # then it gains where they support it (5 % by chance: 1.96 sigma), and is left out where they do not
    assert proof.gain == pytest.approx(len(stamp) if supported else 0.0)
    assert all(x[1] == (0.1 if supported else 0.0) for x in proof.estimates)


@pytest.mark.parametrize('found, added, said', [('velocity_time_offset', True, 'velocity'),
                                                ('velocity_time_offset', False, ''),
                                                ('speed_time_offset', True, ''),
                                                ('doppler_time_offset', True, "input 'doppler'"),
                                                ('left_time_offset', True, '')])
def test_what_stays_unexplained_may_be_a_low_pass_that_the_filter_has_no_model_of(found, added, said):
    # given an error of the positions that goes with acceleration, beside a time offset of an input, which may have a
    # name: a velocity has no low pass in the filter, a speed has
    values = table.check({'inputs': ['doppler', 'left'], 'doppler.type': 'velocity', 'doppler.topic': '/doppler',
                          'left.type': 'speed', 'left.topic': '/left'})
    rest = SimpleNamespace(where='position along the track', what='forward acceleration', rms=0.11, sigma=0.03,
                           unit='m')
    told = unexplained_text(SimpleNamespace(unexplained=True, correlations=[rest], values=values,
                                            findings=[SimpleNamespace(name=found, added=added)]))
    # then the positions are not the only cause that is named, where the filter corrects the offset alone
    assert 'position along the track that goes with forward acceleration (0.110 m RMS).' in told
    assert told.endswith(f'a low pass of the {said}, of which the filter corrects the time offset only.') == bool(said)


@pytest.mark.parametrize('added, but', [(True, 'but for gyroscope.noise_density (see What was found)'), (False, '')])
def test_noise_that_an_effect_changes_is_not_said_to_be_as_given(added, but):
    # given no noise level that is proven, and an effect whose correction sets a noise density
    effect = SimpleNamespace(added=added, changes={'gyroscope.noise_density': [0.01] * 3, 'gnss.time_offset': 0.2})
    page = _noise(SimpleNamespace(explained={}, noise={}, findings=[effect]))
    # then the page does not say that all noise of corrected.yaml is the given one
    assert 'corrected.yaml has those that were given' + (f', {but}.' if added else '.') in page


def test_people_read_three_digits():
    assert rounded_value([0.0114833, -0.0], 3) == [0.0115, 0.0] and rounded_value(0.0114833) == 0.01148
    assert _interval({'low': -3.15472e-7, 'high': 6.29321e-6}) == '-3.15e-7 to 6.29e-6'
