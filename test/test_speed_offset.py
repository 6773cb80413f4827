"""How late a wheel speed is: found against the IMU, known to the filter, set by `configure`, said by the checker."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.configuration.check import check_setup
from mems_ins_fusion.configuration.configure import configure
from mems_ins_fusion.configuration.speed_offset import SHOWN, estimate_speed_offset
from mems_ins_fusion.diagnosis.starts import shown_without_filter
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.registry import aiding
from mems_ins_fusion.filter.memory import Event, Kind
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.samples import Aiding, Speeds
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

MOUNTING = (0.0, 0.05, 0.4)


def drive_with_wheels(offset=0.0, seed=4, duration=200.0, velocity_rate=0.0, lag=0.0, **aided):
    drive = simulate_drive(duration, seed, 100.0, standstill=10.0, hills=True, pitch_per_acceleration=0.005,
                           axle_to_imu=(1.5, 0.3, 0.0))
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    effects = [(EFFECTS['speed_time_offset'], {'time_offset': offset}),
               *((EFFECTS[f'{name}_lag'], {'tau': lag}) for name in ('speed', 'twist', 'heading'))]
    return simulate_recording(drive, sensors, GnssNoise(0.02, 5.0), effects, MOUNTING, seed,
                              aiding=SimulatedAiding(speed_rate=10.0, velocity_rate=velocity_rate, **aided)).recording


@pytest.mark.parametrize('offset', [-0.2, 0.0, 0.35])
def test_a_late_speed_is_found_with_a_sigma_that_holds(offset):
    # given hills, a body that pitches, an IMU in front of the axle, a mounting known to a degree, wheels of 1 % scale
    made = drive_with_wheels(offset)
    found = estimate_speed_offset(made.imu, made.speed, rotation_from_rpy(0.01, 0.06, 0.38))
    # then
    assert found.lag_sigma < SHOWN and abs(found.lag - offset) < min(3.0 * found.lag_sigma, 0.05)
    assert found.scale == pytest.approx(1.0, abs=0.05)


def test_what_shows_nothing_is_told_as_nothing():
    made = drive_with_wheels()
    # given a speed that never changes, noise in place of a speed, too few, and no number among them
    constant = replace(made.speed, speed=np.full(len(made.speed), 8.0))
    noise = replace(made.speed, speed=np.random.default_rng(0).standard_normal(len(made.speed)))
    rotation = rotation_from_rpy(*MOUNTING)
    assert estimate_speed_offset(made.imu, constant, rotation) is None
    assert estimate_speed_offset(made.imu, made.speed.select(slice(0, 50)), rotation) is None
    assert estimate_speed_offset(made.imu, replace(constant, speed=np.full(len(constant), np.nan)), rotation) is None
    found = estimate_speed_offset(made.imu, noise, rotation)
    assert found is None or found.lag_sigma >= SHOWN


def test_the_filter_takes_each_input_at_its_own_time():
    # given
    made, late = drive_with_wheels(0.0, velocity_rate=5.0), 0.3
    aiding = Aiding(speed=made.speed, velocity=made.velocity)
    given = {'speed_topic': '/speed', 'velocity_topic': '/velocity', 'imu.mounting_rpy': list(MOUNTING),
             'gnss.time_offset': 0.05, 'velocity.time_offset': 0.02, 'speed.time_offset': late}
    # when
    result = run(FilterConfig.from_parameters(table.check(given)), made.imu, made.gnss, aiding)
    # then each is of its stamp less its own offset, what the antenna measures less the receiver's, too
    for kind, samples, offset in ((Kind.SPEED, made.speed, late), (Kind.VELOCITY, made.velocity, 0.07),
                                  (Kind.POSITION, made.gnss, 0.05)):
        mine = result.measured.select(result.measured.kind == kind)
        assert len(mine.stamp) > 100
        assert np.abs(mine.stamp - (samples.stamp[mine.index] - round(offset * 1e9))).max() < 1000


def test_a_low_pass_is_told_from_stamps_that_are_late(tmp_path):
    # given a speed that is 0.8 s late: by its stamps, or 0.7 s of it by a low pass
    found = {}
    for tau in (0.0, 0.7):
        made = drive_with_wheels(0.8 - tau, lag=tau)
        found[tau] = estimate_speed_offset(made.imu, made.speed, rotation_from_rpy(*MOUNTING))
        # then it is as late in all
        assert found[tau].lag == pytest.approx(0.8, abs=3.0 * found[tau].lag_sigma) and found[tau].lag_sigma < 0.05
    assert not found[0.0].low_pass.certain and found[0.0].low_pass.tau < 0.35
    assert found[0.7].low_pass.certain
    assert found[0.7].low_pass.tau == pytest.approx(0.7, abs=3.0 * found[0.7].low_pass.sigma)
    # and the checker, configure and diagnose tell it
    values = table.check({'imu.mounting_rpy': list(MOUNTING), 'speed_topic': '/speed', 'speed.time_offset': 0.8})
    said = [f for f in check_setup(made, values) if f.topic == 'imu/speed']
    assert [f.severity for f in said] == ['info', 'warning'] and 'set speed.lag to 0.' in said[1].message
    assert [f.severity for f in check_setup(made, {**values, 'speed.lag': 0.7}) if f.topic == 'imu/speed'] == [
        'info', 'info']
    shown = shown_without_filter([made], values)
    assert shown.low_passes['speed'].tau == pytest.approx(found[0.7].low_pass.tau, abs=0.01)
    # diagnose tries it together with its offset, and no other offset of the speed
    mine = {effect.name: effect for effect in shown.effects(values) if effect.name.startswith('speed_')}
    assert [one.name for one in mine['speed_lag'].traced] == ['delay', 'tau'] and 'speed_time_offset' not in mine
    # where one of 0.7 s is declared there is none; beside one of 0.4 s there is the rest, by their squares
    without = shown_without_filter([made], {**values, 'speed.lag': 0.7})
    mine = {effect.name: effect for effect in without.effects(values) if effect.name.startswith('speed_')}
    assert not without.low_passes and 'speed_time_offset' in mine
    assert [one.name for one in mine['speed_lag'].traced] == ['tau']
    beside = shown_without_filter([made], {**values, 'speed.lag': 0.4}).low_passes['speed'].tau
    assert math.hypot(beside, 0.4) == pytest.approx(found[0.7].low_pass.tau, abs=0.01)
    write_recording(made, tmp_path / 'bag', speed_topic='/can/speed')
    result = configure([tmp_path / 'bag']).values
    assert result['speed.lag'] == pytest.approx(0.7, abs=0.1) and (
        result['speed.time_offset'] == pytest.approx(0.8, abs=0.1))


def test_with_the_offset_told_innovations_of_the_speed_are_those_of_one_in_time():
    # given a speed that is 0.35 s late; m/s, RMS of its innovations
    made = drive_with_wheels(0.35)
    spread = {}
    for told in (0.0, 0.35):
        values = table.check({'speed_topic': '/speed', 'imu.mounting_rpy': list(MOUNTING), 'speed.time_offset': told,
                              'speed.time_offset_sigma': 0.0})
        found = run(FilterConfig.from_parameters(values), made.imu, made.gnss, Aiding(speed=made.speed)).measured
        spread[told] = np.sqrt(np.mean(found.event[found.kind == Kind.SPEED, Event.Z_N] ** 2))
    # then: its noise is 0.05 m/s, and what is left of its scale of 1 % before it is found
    assert spread[0.35] < 0.08 < 0.15 < spread[0.0]


@pytest.mark.parametrize(('name', 'component', 'noise', 'offset_alone'), [
    ('speed', Event.Z_N, 0.05, 1.3), ('twist', Event.Z_N, 0.05, 1.3), ('twist', Event.Z_D, 0.01, 1.1),
    ('heading', Event.Z_N, 0.02, 1.1)])
def test_with_the_low_pass_told_innovations_are_those_of_an_input_without(name, component, noise, offset_alone):
    # given what comes through a low pass of 0.7 s, and its offset declared alone, or with the low pass
    made = drive_with_wheels(lag=0.7, twist_rate=20.0, heading_rate=10.0, heading_sigma=0.02)
    kind, spread = {'speed': Kind.SPEED, 'twist': Kind.TWIST, 'heading': Kind.HEADING}[name], {}
    for told in (0.0, 0.7):
        values = table.check({f'{name}_topic': f'/{name}', 'imu.mounting_rpy': list(MOUNTING), f'{name}.lag': told,
                              f'{name}.time_offset': 0.7, f'{name}.time_offset_sigma': 0.0})
        found = run(FilterConfig.from_parameters(values), made.imu, made.gnss, Aiding(**{
            name: made.streams()[name]})).measured
        z = found.event[found.kind == kind, component]
        spread[told] = np.sqrt(np.mean(z[len(z) // 4:] ** 2)) / noise
    # then with it only their noise is left, and what the state and its scale may be off by
    assert spread[0.7] < min(1.2, 0.93 * spread[0.0]) and spread[0.0] > offset_alone


def test_configure_sets_topic_unit_and_offset_of_a_can_speed_and_the_checker_agrees(tmp_path):
    # given a bag with a speed in km/h, 0.35 s late, beside a velocity of the receiver and the odometry of a filter
    made = drive_with_wheels(0.35, velocity_rate=5.0)
    made = replace(made, speed=replace(made.speed, speed=3.6 * made.speed.speed))
    write_recording(made, tmp_path / 'bag', speed_topic='/can/speed', velocity_topic='/gps/velocity')
    # when
    result = configure([tmp_path / 'bag'])
    # then
    assert result.values['speed_topic'] == '/can/speed'
    assert result.values['speed.factor'] == pytest.approx(1 / 3.6, rel=0.03)
    assert result.values['speed.time_offset'] == pytest.approx(0.35, abs=0.05)
    # and the checker has nothing to say of the file, but names the value where it is missing
    values = table.check(result.values)
    said = [f for f in check_setup(made, values) if f.topic == 'imu/speed']
    assert [f.severity for f in said] == ['info', 'info'] and 'low pass' in said[1].message
    said = [f for f in check_setup(made, {**values, 'speed.time_offset': 0.0}) if f.topic == 'imu/speed']
    assert [f.severity for f in said] == ['warning', 'info'] and 'set speed.time_offset to 0.3' in said[0].message


@pytest.mark.parametrize(('name', 'values', 'against'), [
    ('velocity', {'velocity_topic': '/gps/velocity'}, 'gnss'), ('heading', {'heading_topic': '/heading'}, 'imu'),
    ('own', {'inputs': ['own'], 'own.type': 'velocity', 'own.topic': '/own'}, 'gnss'),
    ('rear', {'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': '/rear', 'rear.lever_arm': [-0.8, 0.0, 0.0]},
     'gnss')])
def test_the_checker_and_diagnose_tell_the_clock_of_each_input(name, values, against):
    # given an input that is 0.3 s late, and fixes that are 0.2 s late, which is declared
    values = table.check({'imu.mounting_rpy': list(MOUNTING), **values, 'gnss.time_offset': 0.2})
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    named = [one for one in aiding(values) if not one.is_plain]
    made = simulate_recording(simulate_drive(200.0, 4, 100.0, standstill=10.0), sensors, GnssNoise(0.02, 5.0), (),
                              MOUNTING, 4, named=named, aiding=SimulatedAiding(
                                  velocity_rate=5.0, heading_rate=5.0, fix_rate=5.0, fix_sigma=0.02)).recording
    moved = {one: replace(samples, stamp=samples.stamp + 3 * 10**8) for one, samples in made.streams().items()}
    late = replace(made, gnss=replace(made.gnss, stamp=made.gnss.stamp + 2 * 10**8)).having({name: moved[name]})
    # then it is told beside what is declared; that of the receiver's velocity counts beside the fixes' own
    own = 0.1 if name == 'velocity' else 0.3
    shown = shown_without_filter([late], values).clocks[name]
    assert shown.value == pytest.approx(own, abs=3.0 * shown.sigma) and shown.sigma < 0.05
    said = [f for f in check_setup(late, values) if f.topic == f'{against}/{name}']
    low_pass = ['info'] if name == 'heading' else []  # of which none shows
    assert [f.severity for f in said] == ['warning', *low_pass] and (
        f'set {name}.time_offset to {shown.value:.2f}' in said[0].message)
    declared = {**values, f'{name}.time_offset': own}
    assert [f.severity for f in check_setup(late, declared) if f.topic == f'{against}/{name}'] == ['info', *low_pass]


def test_a_velocity_is_not_taken_for_the_speed_of_wheels(tmp_path):
    # given a bag whose only twist is the receiver's velocity, on a topic whose name does not say so
    made = drive_with_wheels(0.0, velocity_rate=5.0)
    write_recording(replace(made, speed=None), tmp_path / 'bag', velocity_topic='/vel')
    # then
    assert 'speed_topic' not in configure([tmp_path / 'bag']).values


def test_an_offset_moves_the_simulated_samples_and_not_their_stamps():
    plain, late = drive_with_wheels(0.0), drive_with_wheels(0.4)
    assert isinstance(late.speed, Speeds) and np.array_equal(plain.speed.stamp, late.speed.stamp)
    # what is stamped t is of t - 0.4 s: four samples of 10 Hz; both have the same noise
    noise = np.diff(late.speed.speed[4:] - plain.speed.speed[4:])
    assert np.abs(np.convolve(noise, np.ones(10), 'valid')).max() > 0.3
    shifted = plain.speed.speed[:-4] - late.speed.speed[4:]
    assert np.std(shifted) < 0.09
