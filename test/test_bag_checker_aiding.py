"""The bag checker finds wrong units, signs and frames of speed, velocity and heading, and none in sound ones."""
from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from mems_ins_fusion.configuration.velocity_offset import estimate_velocity_offset
from mems_ins_fusion.navigation.frames import wrap
from mems_ins_fusion.recordings.aiding import check_heading, check_speed
from mems_ins_fusion.recordings.checker import ERROR, INFO, WARNING, check_recording
from mems_ins_fusion.samples import Fixes, Headings, Speeds, Velocities, possible
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_drive, simulate_recording

AIDING = ('speed', 'velocity', 'heading')


def drive(sigma):
    """A hilly drive with fixes of `sigma` m, and all three at 5 Hz with known noise."""
    generator = np.random.default_rng(4)
    simulation = simulate_recording(simulate_drive(300.0, seed=2, rate=50.0, hills=True), gnss=GnssNoise(sigma, 1.0))
    truth = simulation.drive
    at = slice(None, None, 10)
    stamp, count = truth.stamp[at], len(truth.stamp[at])
    received = stamp + 20_000_000
    speed = np.hypot(*truth.velocity[at, :2].T) + generator.normal(0.0, 0.05, count)
    velocity = truth.velocity[at] + generator.normal(0.0, 0.1, (count, 3))
    yaw = wrap(truth.yaw[at] + generator.normal(0.0, 0.01, count))
    return replace(simulation.recording, speed=Speeds(stamp, received, speed, np.full(count, 0.05**2)),
                   velocity=Velocities(stamp, received, velocity, np.tile(0.1**2 * np.eye(3), (count, 1, 1))),
                   heading=Headings(stamp, received, yaw, np.full(count, 0.01**2)))


@pytest.fixture(scope='module', params=[0.02, 1.5])
def sound(request):
    return drive(request.param)


def altered(recording, part, **arrays):
    return replace(recording, **{part: replace(getattr(recording, part), **arrays)})


def findings(recording, severity, values=MappingProxyType({})):
    return [f for f in check_recording(recording, values) if f.topic in AIDING and f.severity == severity]


def the_one(recording, severity, values=MappingProxyType({})):
    """The one finding above information on the three."""
    found = findings(recording, WARNING, values) + findings(recording, ERROR, values)
    assert len(found) == 1, [(f.severity, f.topic, f.message) for f in found]
    assert found[0].severity == severity
    return found[0]


def test_sound_ones_give_nothing_but_information(sound):
    assert not findings(sound, WARNING) + findings(sound, ERROR)
    information = findings(sound, INFO)
    assert [f.values['rate_hz'] for f in information if 'rate_hz' in f.values] == pytest.approx([5.0] * 3)
    ratios = {f.topic: f.values['ratio'] for f in information if 'ratio' in f.values}
    assert ratios == pytest.approx({'speed': 1.0, 'velocity': 1.0}, abs=0.03)
    offset = next(f.values['offset_rad'] for f in information if 'offset_rad' in f.values)
    assert np.degrees(offset) == pytest.approx(0.0, abs=1.5)


@pytest.mark.parametrize('unit, factor', [('km/h', 3.6), ('mph', 1 / 0.44704), ('knots', 3600 / 1852)])
def test_other_units(sound, unit, factor):
    assert f'in {unit} instead' in the_one(altered(sound, 'speed', speed=factor * sound.speed.speed), ERROR).message
    fast = altered(sound, 'velocity', velocity=factor * sound.velocity.velocity)
    assert any(f'in {unit} instead' in f.message for f in findings(fast, ERROR))


def test_a_speed_that_is_wrong(sound):
    assert 'forward has to be positive' in the_one(altered(sound, 'speed', speed=-sound.speed.speed), ERROR).message
    slow = the_one(altered(sound, 'speed', speed=0.7 * sound.speed.speed), WARNING)
    assert 'wrong scale' in slow.message and slow.values['ratio'] == pytest.approx(0.7, rel=0.03)


@pytest.mark.parametrize('share', [0.0, 1.0])
@pytest.mark.parametrize('name, part', [('speed', 'speed'), ('velocity', 'velocity'), ('heading', 'yaw')])
def test_one_that_is_the_same_in_every_message_is_dead(sound, name, part, share):
    # given a sensor that repeats zero, or what it had once in motion
    values = getattr(getattr(sound, name), part)
    dead = altered(sound, name, **{part: np.broadcast_to(share * values[len(values) // 3], values.shape).copy()})
    # then that is said, and no factor or offset that would make it fit
    [found] = [f for f in findings(dead, ERROR) + findings(dead, WARNING) if f.topic == name]
    assert 'is the same in every message while the vehicle drives' in found.message and not found.settings
    assert f'leave {name}_topic empty until its sensor works' in found.message


def test_a_constant_speed_of_a_vehicle_that_keeps_its_speed_is_not_dead():
    # given fixes of 5 cm along a circle at 10 m/s, and a speed in whole m/s
    time = np.arange(0.0, 120.0, 0.2)
    stamp = (time * 1e9).astype(np.int64)
    latitude, longitude = (100.0 / 6.37e6 * part for part in (np.sin(time / 10.0), np.cos(time / 10.0)))
    fixes = Fixes(stamp, stamp, latitude, longitude, np.zeros(len(time)),
                  np.tile(0.05**2 * np.eye(3), (len(time), 1, 1)), np.zeros(len(time), np.int8),
                  np.full(len(time), 2, np.uint8))
    speeds = Speeds(stamp, stamp, np.full(len(time), 10.0), np.full(len(time), 0.01))
    # then it is compared, and right; a heading that stays the same in these turns is dead
    assert not [remark for remark in check_speed(speeds, fixes) if remark.severity != INFO]
    headings = Headings(stamp, stamp, np.full(len(time), 1.0), np.full(len(time), 0.01))
    assert [remark.values for remark in check_heading(headings, fixes)] == [{'repeated': len(time)}]


@pytest.mark.parametrize('factor', [3.6, -1.0, 0.01, -0.5])
def test_a_factor_of_the_speed_is_named_until_the_params_file_has_it(sound, factor):
    wrong = altered(sound, 'speed', speed=factor * sound.speed.speed, variance=factor**2 * sound.speed.variance)
    found = [f for f in findings(wrong, WARNING) + findings(wrong, ERROR) if 'speed.factor' in f.message]
    assert len(found) == 1 and found[0].settings == ('speed.factor',)
    told = float(found[0].message.split('set speed.factor to ')[1])
    assert told == pytest.approx(1.0 / factor, rel=0.05)
    # when it is declared, nothing is left to say, nor where a constant scale error is
    for values in ({'speed.factor': told}, {'speed.factor': told / 2.0, 'speed.scale': -0.5}):
        left = check_recording(wrong, values)
        assert not [f for f in left if f.topic == 'speed' and f.severity != INFO]


def test_a_heading_that_is_turned_is_named_until_the_params_file_has_it(sound):
    turned = altered(sound, 'heading', yaw=wrap(sound.heading.yaw + 2.0))
    wrong = the_one(turned, ERROR)
    assert wrong.settings == ('heading.offset',)
    told = float(wrong.message.split('set heading.offset to ')[1])
    assert told == pytest.approx(2.0, abs=0.03)
    assert not [f for f in check_recording(turned, {'heading.offset': told})
                if f.topic == 'heading' and f.severity != INFO]


@pytest.mark.parametrize('columns, signs, text', [
    ([1, 0, 2], [1, 1, -1], 'north-east-down instead of east-north-up'), ([0, 1, 2], [-1, -1, 1], 'opposite sign'),
    ([0, 1, 2], [1, -1, 1], 'opposite sign in east'), ([0, 1, 2], [-1, 1, 1], 'opposite sign in north')])
def test_a_velocity_in_another_frame(sound, columns, signs, text):
    turned = altered(sound, 'velocity', velocity=sound.velocity.velocity[:, columns] * signs)
    assert text in the_one(turned, ERROR).message


def test_a_velocity_in_the_vehicles_axes(sound):
    forward = np.column_stack([np.zeros((len(sound.speed), 1)), sound.speed.speed, np.zeros(len(sound.speed))])
    assert 'axes of the vehicle' in the_one(altered(sound, 'velocity', velocity=forward), ERROR).message


def test_a_vertical_velocity_with_the_wrong_sign():
    sound = drive(0.02)
    upside_down = altered(sound, 'velocity', velocity=sound.velocity.velocity * (1, 1, -1))
    assert 'up has to be positive' in the_one(upside_down, ERROR).message


def test_a_heading_that_turns_the_other_way(sound):
    clockwise = wrap(np.pi / 2 - sound.heading.yaw)  # north-east-down angles taken for east-north-up ones
    assert 'REP 103' in the_one(altered(sound, 'heading', yaw=clockwise), ERROR).message


@pytest.mark.parametrize('degrees, severity', [(8.0, WARNING), (90.0, ERROR), (180.0, ERROR)])
def test_a_heading_that_is_turned(sound, degrees, severity):
    turned = altered(sound, 'heading', yaw=wrap(sound.heading.yaw + np.radians(degrees)))
    found = the_one(turned, severity)
    assert np.degrees(abs(found.values['offset_rad'])) == pytest.approx(degrees, abs=1.5)


def test_a_heading_that_is_not_one(sound):
    noise = np.random.default_rng(1).uniform(-np.pi, np.pi, len(sound.heading))
    assert 'does not follow' in the_one(altered(sound, 'heading', yaw=noise), ERROR).message


def test_messages_that_say_nothing(sound):
    yaw, variance = sound.heading.yaw.copy(), sound.heading.variance.copy()
    yaw[5:8], variance[20] = np.nan, 0.0
    counts = {f.message: f.values['count'] for f in findings(altered(sound, 'heading', yaw=yaw, variance=variance),
                                                             WARNING)}
    assert counts == {'3 messages without a heading, or with an impossible one': 3,
                      '1 message with an unknown or zero covariance': 1}
    nothing = altered(sound, 'speed', speed=np.full(len(sound.speed), np.nan))
    assert 'without a speed' in findings(nothing, ERROR)[0].message


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('absurd', [1e300, -1e155, np.inf, np.nan])
def test_numbers_that_no_vehicle_has_do_not_spoil_the_comparison(sound, absurd):
    # given a speed, a velocity and a heading, each seventh message of which has an absurd number
    def spoiled(samples, column):
        values = getattr(samples, column).copy()
        values[::7] = absurd
        return replace(samples, **{column: values})

    columns = {'speed': 'speed', 'heading': 'yaw', 'velocity': 'velocity'}
    wrong = sound.having({name: spoiled(sound.streams()[name], column) for name, column in columns.items()})
    count = sum(-(-len(sound.streams()[name]) // 7) for name in columns)
    # then only that is told, and clocks and axes are those of the others
    told = findings(wrong, WARNING)
    assert sum(f.values['count'] for f in told) == count and not findings(wrong, ERROR)
    offset = estimate_velocity_offset(wrong.velocity, wrong.gnss)
    others = sound.velocity.select(possible(wrong.velocity.velocity))
    assert offset == estimate_velocity_offset(others, wrong.gnss)


def test_stamps_of_another_clock(sound):
    found = findings(altered(sound, 'speed', stamp=sound.speed.stamp + 3600 * 10**9), WARNING)
    assert any('hardly overlaps' in f.message for f in found)


def test_a_velocity_far_worse_than_it_says():
    sound = drive(0.02)
    late = altered(sound, 'velocity', stamp=sound.velocity.stamp + 1_500_000_000,
                   received=sound.velocity.received + 1_500_000_000, covariance=1e-4 * sound.velocity.covariance)
    assert 'too sure of itself, or late' in the_one(late, WARNING).message


@pytest.mark.parametrize('count', [0, 1, 2])
@pytest.mark.parametrize('part', AIDING)
def test_very_short_ones_are_no_obstacle(sound, part, count):
    short = replace(sound, **{part: getattr(sound, part).select(slice(0, count))})
    assert isinstance(check_recording(short), list)
    assert isinstance(check_recording(replace(short, gnss=None)), list)
