"""The time offset of each input is a state: found with its sigma, said, and worth nothing to a right input."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_filter_displacement import drive

from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.registry import aiding
from mems_ins_fusion.filter.memory import NAV, newest_row
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.runs.vehicle_check import found_time_offsets
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import SLOW
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

INPUTS = 'speed', 'velocity', 'twist', 'heading'


@pytest.fixture(scope='module')
def recording():
    return drive(3)


def through(recording, name, late=0.0, **values):
    """The run with the input `name` stamped `late` s too late; its offset as estimated, and its sigma."""
    samples = recording.streams()[name]
    config = FilterConfig.from_parameters(table.check({f'{name}_topic': f'/{name}', **values}))
    result = run(config, recording.imu, recording.gnss, Aiding(**{
        name: replace(samples, stamp=samples.stamp + round(late * 1e9))}))
    state = config.layout.index(f'{name}_time_offset')
    return (result, float(result.extras[-1, state - config.layout.n]), float(result.sigma[-1, state])) if (
        state >= 0) else (result, 0.0, 0.0)


def rmse(recording, result):
    north, east = radii(result.latitude)
    settled = result.stamp > result.stamp[0] + 60 * 10**9
    true = recording.reference
    return float(np.sqrt(np.mean(((result.latitude - np.interp(result.stamp, true.stamp, true.latitude)) * north)**2
                                 + ((result.longitude - np.interp(result.stamp, true.stamp, true.longitude)) * east
                                    * np.cos(result.latitude))**2, where=settled)))


@pytest.mark.parametrize('late', [-0.2, 0.0, 0.3, 0.5])
@pytest.mark.parametrize('name', INPUTS)
def test_an_offset_is_found_within_its_sigma_and_the_parameter_is_said(recording, name, late):
    result, found, sigma = through(recording, name, late)
    assert found == pytest.approx(late, abs=3.0 * sigma + 0.04 * abs(late)) and sigma < 0.06
    said = [notice.text for notice in result.notices if 'time_offset:' in notice.text]
    assert [f'/{name}' in text for text in said] == ([True] if late else [])
    if late:
        assert f'set {name}.time_offset: {found:.2f}' in said[0]


@pytest.mark.parametrize('name', INPUTS)
def test_a_right_input_pays_nothing_and_a_late_one_little(recording, name):
    exact, right, late = (rmse(recording, through(recording, name, by, **values)[0]) for by, values in (
        (0.0, {f'{name}.time_offset_sigma': 0.0}), (0.0, {}), (0.3, {})))
    assert right < 1.03 * exact + 0.01 and late < 1.1 * right + 0.02
    if name != 'heading':  # of which nobody knows the use by the position
        unknown = rmse(recording, through(recording, name, 0.3, **{f'{name}.time_offset_sigma': 0.0})[0])
        assert unknown > 1.3 * late


def test_what_is_declared_is_not_left_and_not_said(recording):
    result, left, sigma = through(recording, 'speed', 0.3, **{'speed.time_offset': 0.3})
    assert abs(left) < 3.0 * sigma and not found_time_offsets(result.memory, result.config)


def test_an_offset_that_was_found_and_then_declared_does_not_count_twice(recording):
    # given a filter that has found the speed's stamps late, and what it has saved
    result, found, _ = through(recording, 'speed', 0.3)
    before = FusionFilter(result.config)
    before._memory, before._follow[0] = result.memory, int(result.stamp[-1])
    snapshot = before.snapshot()

    def restored(**values):
        fusion = FusionFilter(FilterConfig.from_parameters(table.check({'speed_topic': '/speed', **values})))
        imu = recording.imu
        fusion.add_imu(int(imu.stamp[-1]), *imu.specific_force[-1].tolist(), *imu.angular_rate[-1].tolist())
        return fusion.restore(snapshot, 1e6)
    # then the next filter takes it over where nothing else is declared, and only there
    assert 'no sensor errors' not in restored()
    assert 'no sensor errors' in restored(**{'speed.time_offset': 0.3})
    assert 'no sensor errors' in restored(**{'speed.scale': 0.02})
    state = result.config.layout.index('speed_time_offset')
    assert newest_row(result.memory)[NAV + state] == pytest.approx(found)


def test_a_clock_that_has_jumped_is_found_when_the_vehicle_slows_down_gently():
    # given wheels whose clock jumps by half a second where the speed is constant; then the vehicle takes eight seconds
    # to brake with 1.4 m/s^2, so that velocity, tilt and position follow what is wrong and nothing looks like a step
    sensors = SensorErrors.from_parameters(table.check(REALISTIC.imu), 'gauss_markov')
    recording = simulate_recording(REALISTIC.drive(240.0, 58102), sensors, GnssNoise(1.5, 10.0), seed=58102, **{
        **REALISTIC.distortions(58102), 'aiding': SimulatedAiding(speed_rate=100.0)}).recording
    speed, jump = recording.speed, recording.imu.stamp[0] + 200 * 10**9
    late = replace(speed, stamp=speed.stamp + np.where(speed.stamp > jump, 5 * 10**8, 0))
    values = table.check({'speed_topic': '/speed', 'reference_lever_arm': [0.0, 0.0, 0.0]})
    result = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss, Aiding(speed=late))
    # then the fixes show it before the vehicle stands, and neither position nor ellipse is wrong
    truth, state = truth_of(recording, values), result.config.layout.extras.index('speed_time_offset')
    errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
    later = errors.stamp > jump
    assert result.extras[-1, state] == pytest.approx(0.5, abs=0.1)
    assert errors.horizontal[later].max() < 2.0 and np.mean(errors.nees[later] < NEES_95) > 0.95


@pytest.mark.parametrize('jump', [0.5, -0.5])
def test_a_clock_that_jumps_while_the_vehicle_brakes_hard_is_no_other_scale_factor(jump):
    # given wheels whose clock jumps by half a second as the vehicle begins to brake hard for longer than a slip lasts:
    # at first they are 1 m/s off, which passes for slip
    sensors = SensorErrors.from_parameters(table.check(REALISTIC.imu), 'gauss_markov')
    recording = simulate_recording(REALISTIC.drive(260.0, 59301), sensors, GnssNoise(1.5, 1.0), seed=59301, **{
        **REALISTIC.distortions(59301), 'aiding': SimulatedAiding(speed_rate=100.0)}).recording
    time = (recording.reference.stamp - recording.imu.stamp[0]) * 1e-9
    speed = np.hypot(*recording.reference.velocity[:, :2].T)
    slower = np.interp(time, time - 6.0, speed) - speed
    begin = time[np.argmin(np.where((time > 100.0) & (time < 220.0), slower, 0.0))]
    assert slower.min() < -9.0
    wheels, since = recording.speed, (recording.speed.stamp - recording.imu.stamp[0]) * 1e-9 - begin
    wrong = replace(wheels, stamp=wheels.stamp + np.where(since > 0.0, round(jump * 1e9), 0))
    wrong = wrong.select(np.argsort(wrong.stamp, kind='stable'))
    values = table.check({'speed_topic': '/speed', 'reference_lever_arm': [0.0, 0.0, 0.0]})
    result = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss, Aiding(speed=wrong))
    # then a few seconds later the clock has another offset, and not the wheels another circumference
    layout, after = result.config.layout, recording.imu.stamp[0] + round((begin + 15.0) * 1e9)
    for name, true in (('time_offset', jump), ('scale', 0.0)):
        state, at = layout.index(f'speed_{name}'), np.searchsorted(result.stamp, after)
        assert abs(result.extras[at, state - layout.n] - true) < 3.0 * result.sigma[at, state] + 0.02 < 0.5
    truth = truth_of(recording, values)
    errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
    later = errors.stamp > recording.imu.stamp[0] + begin * 1e9
    assert np.mean(errors.nees[later] < NEES_95) > 0.95


@pytest.mark.parametrize('to', [5.0, -8.0])
def test_a_heading_that_makes_a_step_has_another_offset_at_once(recording, to):
    # given antennas that are turned by some degrees, four sigma of their noise, from 120 s on
    heading, jump = recording.heading, recording.imu.stamp[0] + 120 * 10**9
    turned = replace(heading, yaw=heading.yaw + np.radians(to) * (heading.stamp > jump))
    config = FilterConfig.from_parameters(table.check({'heading_topic': '/heading'}))
    result, right = (run(config, recording.imu, recording.gnss, Aiding(heading=one)) for one in (turned, heading))
    # then two seconds later the offset has changed by it, within its sigma, and the heading of the vehicle has not
    state = config.layout.index('heading_offset')
    before, after = np.searchsorted(result.stamp, jump + np.array([0, 2]) * 10**9)
    offset, sigma = result.extras[:, state - config.layout.n], result.sigma[after, state]
    assert offset[after] - offset[before] == pytest.approx(np.radians(to), abs=3.0 * sigma) and sigma < 0.02
    assert np.abs(result.yaw - right.yaw)[before:after].max() < np.radians(1.0)


@pytest.mark.parametrize('name', ['speed', 'velocity'])
def test_a_clock_that_jumps_is_followed_within_two_manoeuvres(recording, name):
    # given stamps that are half a second late from 100 s on, and a filter that knows by then that they are right
    samples = recording.streams()[name]
    since = (samples.stamp - recording.imu.stamp[0]) * 1e-9
    late = replace(samples, stamp=samples.stamp + np.where(since > 100.0, 5 * 10**8, 0))
    config = FilterConfig.from_parameters(table.check({f'{name}_topic': f'/{name}'}))
    result = run(config, recording.imu, recording.gnss, Aiding(**{name: late}))
    state = config.layout.index(f'{name}_time_offset')
    found, sigma = result.extras[:, state - config.layout.n], result.sigma[:, state]
    before, after = np.searchsorted(result.stamp, recording.imu.stamp[0] + np.array([100, 130]) * 10**9)
    assert abs(found[before]) < 3.0 * sigma[before] and sigma[before] < 0.05
    # then its offset is known anew, within its sigma, and the position is no worse than without it
    assert found[after] == pytest.approx(0.5, abs=3.0 * sigma[after] + 0.02) and sigma[after] < 0.15
    without = run(FilterConfig.from_parameters(table.check({})), recording.imu, recording.gnss)
    assert rmse(recording, result) < 1.05 * rmse(recording, without)


@pytest.mark.parametrize('manoeuvres, stated, is_said', [
    (SLOW, True, True), (SLOW, False, False), (None, False, True)], ids=['robot', 'robot, no arm', 'car, no arm'])
def test_what_an_arm_that_is_not_stated_explains_is_no_clock(manoeuvres, stated, is_said):
    # given a second receiver, 1.2 m behind the main one, whose fixes are stamped 0.3 s late; the IMU is at the main
    # antenna, or 0.4 m from it, which is stated
    rear = {'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': '/rear', 'rear.lever_arm_sigma': 0.01}
    arms = {'gnss.lever_arm': [0.4, 0.0, 0.0], 'rear.lever_arm': [-0.8, 0.0, 0.0]} if stated else {
        'rear.lever_arm': [-1.2, 0.0, 0.0]}
    values = table.check({**rear, **arms})
    named = [one for one in aiding(values) if not one.is_plain]
    effects = [(EFFECTS['gnss_lever_arm'], {'x': 0.4, 'y': 0.0, 'z': 0.0})] if stated else []
    made = simulate_recording(
        simulate_drive(240.0, 5, 50.0, **({'manoeuvres': manoeuvres} if manoeuvres else {})),
        SensorErrors.from_parameters(table.defaults(), 'gauss_markov'), GnssNoise(0.02, 5.0), effects, seed=5,
        aiding=SimulatedAiding(fix_rate=5.0, fix_sigma=0.02), named=named).recording
    late = made.others['rear']
    late = replace(late, stamp=late.stamp + 300_000_000, received=late.received + 300_000_000)
    result = run(FilterConfig.from_parameters(values), made.imu, made.gnss, Aiding(rear=late))
    said = [notice.text for notice in result.notices if 'set rear.time_offset' in notice.text]
    assert bool(said) == is_said, said
