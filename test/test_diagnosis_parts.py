"""Parts of the diagnosis on simulated drives whose truth is known: whose clock, what the filter has learned."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.diagnosis.clock import in_its_clock, lateness
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.learned import angles
from mems_ins_fusion.diagnosis.residuals import FLOOR, Problem, believed, looked_through, stated
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.parameters import table
from mems_ins_fusion.reports.effect_words import size
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


def in_receivers_clock(recording):
    reference = recording.reference
    return replace(recording, reference=replace(reference, stamp=reference.stamp + round(OFFSET * 1e9)))


def test_how_late_the_reference_is_against_the_fixes(late):
    value, sigma = lateness(late.reference, late.gnss)
    assert abs(value + OFFSET) < 4 * sigma < 0.1
    value, sigma = lateness(in_receivers_clock(late).reference, late.gnss)
    assert abs(value) < 4 * sigma < 0.1


@pytest.mark.parametrize('name, shared, alone', [('auto', True, False), ('imu', False, False), ('gnss', True, True),
                                                 ('own', True, True)])
def test_whose_clock_the_reference_runs_in(late, name, shared, alone):
    # given a reference in the receiver's clock, and one in the IMU's
    assert in_its_clock(in_receivers_clock(late), name)[1].with_fixes == shared
    moved, clock = in_its_clock(late, name)
    assert clock.with_fixes == alone
    # its own clock is taken to that of the fixes, any other is left
    shift = (moved.reference.stamp - late.reference.stamp) * 1e-9
    assert np.allclose(shift, OFFSET if name == 'own' else 0.0, atol=0.03)


@pytest.mark.parametrize('pitch, yaw', [(0.0, 0.1), (0.05, -0.08)])
def test_the_mountings_angles_are_those_that_the_filter_has_learned(pitch, yaw):
    recording = recorded(240.0, 0.1, [('mounting_rotation', {'roll': 0.0, 'pitch': pitch, 'yaw': yaw})])
    found = angles(recording, table.check({}))
    for name, true in (('pitch', pitch), ('yaw', yaw)):
        assert found.whole[name].value == pytest.approx(true, abs=0.02)
    assert set(found.plain) == ({'yaw'} | ({'pitch'} if pitch else set()))
    # and declaring them takes them out
    declared = EFFECTS['mounting_rotation'].adjusted(table.check({}), {'roll': 0.0, **{
        name: e.value for name, e in found.whole.items()}})
    assert not angles(recording, declared).plain


def test_a_mounting_that_is_no_state_is_not_learned():
    assert angles(recorded(60.0), table.check({'imu.mounting_sigma': 0.0})) is None


def test_the_search_looks_through_a_filter_that_adapts_to_nothing(late):
    values = table.check({'gnss.sigma': 0.7, 'gnss.time_offset_sigma': 0.3})
    config = FilterConfig.from_parameters(looked_through(values))
    assert config.gnss.gate == config.gnss.robust_sigma == 0 and not config.gnss.adapt_sigma
    assert 'time_offset' not in config.layout.names
    # each fix is believed as the filter of the user would, and FLOOR
    fixes = believed(late.gnss, stated(late.gnss, values), np.log(2.0), np.arange(len(late.gnss)) == 7)
    assert np.allclose(fixes.covariance[:, 0, 0], (2 * 0.7) ** 2 + FLOOR**2)
    assert np.flatnonzero(fixes.status < 0).tolist() == [7]
    told = stated(late.gnss, table.check({}))
    assert np.allclose(told[:, :2, :2], late.gnss.covariance[:, :2, :2])
    silent = replace(late.gnss, covariance_type=np.zeros(len(late.gnss), dtype=np.uint8))
    assert np.allclose(stated(silent, table.check({}))[:, 0, 0], 9.0)


def test_a_fix_that_is_far_off_is_set_aside(late):
    latitude = late.gnss.latitude.copy()
    latitude[60] += 300.0 / 6.4e6
    wrong = replace(late, gnss=replace(late.gnss, latitude=latitude))
    problem = Problem(wrong, table.check({}))
    assert np.flatnonzero(problem.outlying).tolist() == [60] and not problem.mask[60]


@pytest.mark.parametrize('effect, parameter, value, sigma, unit, said', [
    ('gnss_time_offset', 'time_offset', 0.25, 0.01, 's', 'fixes are stamped 0.250 \N{PLUS-MINUS SIGN} 0.01 s too late'),
    ('gnss_time_offset', 'time_offset', -0.25, 0.01, 's', 'too early'),
    ('mounting_rotation', 'yaw', math.radians(-5.0), math.radians(0.5), 'rad',
     'it is turned 5.00 \N{PLUS-MINUS SIGN} 0.5 deg more to the right'),
    ('mounting_rotation', 'pitch', 0.1, 0.01, 'rad', 'more forward'),
    ('accelerometer_scale', 'x', 0.05, 0.01, '-', 'forward 5.0 \N{PLUS-MINUS SIGN} 1 % too much'),
    ('gnss_lever_arm', 'y', -0.8, 0.1, 'm', 'further right'),
    ('g_sensitivity', 'x', 1e-3, 1e-4, '(rad/s)/(m/s^2)', 'x 0.0010'),
])
def test_the_size_of_an_effect_in_words(effect, parameter, value, sigma, unit, said):
    assert said in size(effect, parameter, Estimate(value, sigma, unit))


def test_the_words_for_an_effect_are_of_effects_that_are_there():
    from mems_ins_fusion.reports import effect_words

    for name in (*effect_words._WORDS, *effect_words._OR, *(name for name, _ in effect_words._SIZES)):
        assert name in EFFECTS
    for name, parameter in effect_words._SIZES:
        assert parameter in {p.name for p in EFFECTS[name].traced}
