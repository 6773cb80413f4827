"""What the latest minutes show without a filter: values that are off, by how much, and the parameters to set."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mems_ins_fusion.configuration.check import SMALL_OFFSET
from mems_ins_fusion.configuration.mounting import Mounting
from mems_ins_fusion.configuration.remaining import remaining_of
from mems_ins_fusion.diagnosis import direct
from mems_ins_fusion.diagnosis.direct import direct_findings, shown_directly
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.findings import Finding
from mems_ins_fusion.diagnosis.held_out import HeldOut
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_drive,
    simulate_recording,
)

SECOND, OFFSET = 10**9, 0.3
DEFAULTS = table.check({})


@pytest.fixture(scope='module')
def recording():
    """Eight minutes at 50 Hz with fixes of centimetres; from the middle on these and wheel speed are stamped late."""
    sensors = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    made = simulate_recording(simulate_drive(480.0, seed=5, rate=50.0), sensors, GnssNoise(0.02, rate=2.0), seed=5,
                              aiding=SimulatedAiding(speed_rate=10.0)).recording
    half = made.imu.stamp[0] + 240 * SECOND

    def late(samples):
        return replace(samples, stamp=np.where(samples.stamp >= half, samples.stamp + round(OFFSET * SECOND),
                                               samples.stamp))
    return replace(made, reference=None, gnss=late(made.gnss), speed=late(made.speed), velocity=None, heading=None)


def until(recording, seconds):
    """The first `seconds` of it."""
    return recording.having({name: samples.select(samples.stamp < recording.imu.stamp[0] + seconds * SECOND)
                             for name, samples in recording.streams().items()})


def test_an_offset_shows_within_two_minutes_of_its_begin(recording):
    # given four minutes without one, and then 80 s and four minutes with it
    assert shown_directly(until(recording, 240), DEFAULTS) == []
    for seconds in (360, 480):
        found, = shown_directly(until(recording, seconds), DEFAULTS)
        offset = found.parameters['time_offset']
        assert found.name == 'gnss_time_offset' and offset.unit == 's'
        assert abs(offset.value - OFFSET) < 3.0 * offset.sigma < 0.15
        assert found.changes == {'gnss.time_offset': offset.value}
        assert 239.0 < (found.since - recording.imu.stamp[0]) / SECOND < seconds - 59.0
    # then nothing is left beside it
    assert shown_directly(recording, {**DEFAULTS, 'gnss.time_offset': OFFSET}) == []


def test_what_is_left_of_antenna_and_mounting_is_set_beside_what_is_declared(recording):
    right = {**DEFAULTS, 'gnss.time_offset': OFFSET}
    arm, = shown_directly(recording, {**right, 'gnss.lever_arm': [2.0, 0.0, 0.0]})
    assert arm.name == 'gnss_lever_arm' and arm.parameters['x'].value == pytest.approx(-2.0, abs=0.3)
    assert arm.changes['gnss.lever_arm'] == pytest.approx([0.0, 0.0, 0.0], abs=0.3)
    turned, = shown_directly(recording, {**right, 'imu.mounting_rpy': [0.0, 0.0, math.radians(10.0)]})
    assert turned.name == 'mounting_rotation'
    assert turned.changes['imu.mounting_rpy'] == pytest.approx([0.0, 0.0, 0.0], abs=math.radians(2.0))


@pytest.mark.parametrize('declared', [(0.0, 0.0, math.pi), (0.1, -0.05, 3.1), (0.0, 0.0, -math.pi / 2.0),
                                      (0.05, 0.1, 1.6)], ids=str)
def test_an_imu_declared_the_wrong_way_round_is_set_to_how_it_is_mounted(recording, declared):
    # given an IMU in the axes of the vehicle, and parameters that turn it by a right angle or two, and tilt it
    found, = shown_directly(recording, {**DEFAULTS, 'gnss.time_offset': OFFSET, 'imu.mounting_rpy': list(declared)})
    assert found.name == 'mounting_rotation'
    # then no tilt comes in with the large yaw
    to_be, mounted = (rotation_from_rpy(*rpy) for rpy in (found.changes['imu.mounting_rpy'], (0.0, 0.0, 0.0)))
    assert np.arccos((np.trace(to_be @ mounted.T) - 1.0) / 2.0) < math.radians(3.0)


@pytest.mark.parametrize(('yaw', 'parts'), [(3.0, {'roll', 'pitch', 'yaw'}), (0.3, {'roll', 'pitch'})])
def test_a_yaw_counts_where_it_is_sharp_or_certainly_off(recording, monkeypatch, yaw, parts):
    # given a mounting whose yaw is known to 10 deg only, and a tilt that is off
    seen = Mounting(rotation_from_rpy(0.2, 0.0, yaw), np.radians([1.0, 1.0, 10.0]))
    monkeypatch.setattr(direct, 'estimate_mounting', lambda imu, fixes: seen)
    # then half a turn is part of the finding, and what may be nothing is not
    found, = shown_directly(until(recording, 60), DEFAULTS)
    assert found.parameters.keys() == parts
    assert found.changes['imu.mounting_rpy'] == pytest.approx([0.2, 0.0, yaw if 'yaw' in parts else 0.0])


def test_sigmas_of_large_angles_are_those_of_angles_drawn_about_them():
    # given a rotation by large angles with errors about forward, left and up of the vehicle
    sigma, true = np.array([0.01, 0.02, 0.03]), rotation_from_rpy(0.3, -0.9, 2.0)
    drawn = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(4000, 3)) * sigma) * Rotation.from_matrix(true)
    # when its angles are taken beside no declared mounting
    left = remaining_of(Mounting(true, sigma), DEFAULTS)[:3]
    # then values and sigmas are those of the angles drawn
    angles = drawn.as_euler('xyz')
    assert [one.value for one in left] == pytest.approx([0.3, -0.9, 2.0])
    assert [one.sigma for one in left] == pytest.approx(angles.std(axis=0), rel=0.05)


def test_half_a_turn_to_either_side_is_the_same():
    # given two looks at an IMU that is mounted backwards
    one, other = Estimate(3.13, 0.02, 'rad'), Estimate(-3.13, 0.02, 'rad')
    # then they agree, and two lengths with the same numbers do not
    assert not one.differs(other)
    assert replace(one, unit='m').differs(replace(other, unit='m'))


def test_a_wheel_speed_that_is_late_is_told_by_the_name_of_its_input(recording):
    values = table.check({'inputs': ['rear'], 'rear.type': 'speed', 'rear.topic': '/rear/speed',
                          'gnss.time_offset': OFFSET})
    named = replace(recording, speed=None).having({**{n: s for n, s in recording.streams().items() if n != 'speed'},
                                                   'rear': recording.speed})
    found, = shown_directly(named, values)
    assert found.name == 'rear_time_offset'
    assert found.changes['rear.time_offset'] == pytest.approx(OFFSET, abs=0.05)


@pytest.mark.parametrize(('effect', 'sizes', 'rates', 'set_by', 'estimated'), [
    ('speed_lag', {'tau': 1.0}, {'speed_rate': 20.0}, {'speed.time_offset': 1.0, 'speed.lag': 1.0}, {}),
    ('twist_yaw', {'yaw': 0.1}, {'twist_rate': 10.0, 'twist_lateral_sigma': 0.05}, {'twist.yaw': 0.1},
     {'twist.yaw_sigma': 1e-6}),
    ('pressure_dynamic', {'share': -0.6}, {'pressure_rate': 10.0}, {'pressure.dynamic': -0.6},
     {'pressure.dynamic_sigma': 1e-6})])
def test_what_is_wrong_with_an_input_is_told_where_the_filter_does_not_estimate_it(effect, sizes, rates, set_by,
                                                                                   estimated):
    # given four minutes with an effect of an input
    made = simulate_recording(simulate_drive(240.0, seed=7, rate=50.0), SensorErrors.from_parameters(
        DEFAULTS, 'gauss_markov'), GnssNoise(0.1, rate=2.0), [(EFFECTS[effect], sizes)], seed=7,
        aiding=SimulatedAiding(**rates)).recording
    name = effect.split('_')[0]
    told = {f'{name}_topic': f'/{name}', **estimated}
    # when
    found = {finding.name: finding for finding in shown_directly(made, table.check(told))}
    # then its sizes are told, and what to set
    assert list(found) == [effect]
    for size in sizes:
        assert found[effect].parameters[size].value == pytest.approx(sizes[size], abs=4.0 * found[effect].parameters[
            size].sigma)
    assert found[effect].changes == pytest.approx(set_by, abs=0.15) and found[effect].changes.keys() == set_by.keys()
    # and with that set nothing is left; nor where the filter estimates it
    assert shown_directly(made, table.check({**told, **found[effect].changes})) == []
    if estimated:
        assert shown_directly(made, table.check({f'{name}_topic': f'/{name}'})) == []


def test_of_several_looks_the_longest_that_agrees_counts(recording, monkeypatch):
    # given looks at one, two and four minutes, of which the second is of the time before the change as well, and the
    # third shows more
    seen = {60: (0.30, 0.02), 120: (0.10, 0.02), 240: (0.29, 0.01)}

    def look(part, values):
        value, sigma = seen[round((part.imu.stamp[-1] - part.imu.stamp[0]) / SECOND)]
        parameters = {'a': Estimate(value, sigma, 's'), **({'more': Estimate(1.0, 0.1, 's')} if value == 0.29 else {})}
        return {'x': Finding('x', ['x'], parameters, 0.0, 0.0, True, HeldOut(0.0, 1.0, []))}
    monkeypatch.setattr(direct, '_shown', look)
    found, = shown_directly(recording, DEFAULTS)
    assert found.parameters['a'].value == 0.29
    assert found.parameters.keys() == {'a', 'more'}
    seen[240] = (0.12, 0.01)
    found, = shown_directly(recording, DEFAULTS)
    assert found.parameters['a'].value == 0.30


def test_what_is_as_given_is_told_with_what_may_be_left(recording):
    # given the right offset and no arm, after four minutes, and after twenty seconds that show nothing yet
    seen = {one.name: one for one in direct_findings(until(recording, 240), DEFAULTS)}
    young = {one.name: one for one in direct_findings(until(recording, 20), DEFAULTS)}
    # then nothing is off, and the offset is so well known that what may be left of it does not matter
    assert seen.keys() == young.keys() == {'gnss_time_offset', 'gnss_lever_arm', 'mounting_rotation'}
    assert not any(one.added or one.changes for one in seen.values())
    offset = seen['gnss_time_offset']
    assert offset.settled and abs(offset.parameters['time_offset'].value) + 2.0 * offset.parameters[
        'time_offset'].sigma <= SMALL_OFFSET
    assert not young['gnss_time_offset'].settled and young['gnss_time_offset'].parameters == {}
    # and what has become wrong is not among it
    later = {one.name: one.added for one in direct_findings(until(recording, 360), DEFAULTS)}
    assert later['gnss_time_offset'] and not later['gnss_lever_arm']


def test_what_has_settled_stays_so_until_another_value_is_seen():
    def seen(value, sigma, settled):
        return Finding('x', ['x'], {'a': Estimate(value, sigma, 's')}, 0.0, 0.0, False, HeldOut(0.0, 1.0, []),
                       settled=settled)
    nothing = replace(seen(0.0, 0.1, False), parameters={})
    settled, vague, other = seen(0.0, 0.01, True), seen(0.02, 0.06, False), seen(0.3, 0.06, False)
    assert settled.says_more_than(vague) and settled.says_more_than(nothing) and vague.says_more_than(nothing)
    assert not vague.says_more_than(settled) and not nothing.says_more_than(vague)
    assert other.says_more_than(settled)
