"""Named inputs, any number: two receivers, two wheels; each with its own arm, clock, sigma, scale and status."""
from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from live_support import lived, same_bits

from mems_ins_fusion.cli.simulate import main as simulate
from mems_ins_fusion.diagnosis.gathering import Gathering, chunks
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.registry import FIRST_NAMED, aiding
from mems_ins_fusion.filter.memory import INPUT_SIZE, NAV, Event, Head, Verdict, state_at
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run, run_with_outages
from mems_ins_fusion.filter.trust.scale import Noise, scale
from mems_ins_fusion.navigation.frames import wrap
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.parameters.params_file import load_yaml
from mems_ins_fusion.recordings.checker import check_recording
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.reports import replay as replay_report
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

FRONT = [0.8, 0.0, 1.0]
REAR = {'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': '/rear/fix', 'rear.lever_arm': [-0.8, 0.0, 1.0]}
WHEELS = {'inputs': ['left', 'right'], 'left.type': 'speed', 'left.topic': '/left', 'left.lever_arm': [0.0, 0.75, -0.5],
          'right.type': 'speed', 'right.topic': '/right', 'right.lever_arm': [0.0, -0.75, -0.5]}
SIGMA = 0.02


def given(**values):
    return table.check({'gnss.lever_arm': FRONT, **values})


def recorded(values, duration=120.0, seed=2, standstill=10.0, rate=50.0, sensors=None, **errors):
    """A drive with the receiver at FRONT and the named inputs of `values`."""
    drive = simulate_drive(duration, seed, rate, standstill=standstill)
    arm = (EFFECTS['gnss_lever_arm'], dict(zip('xyz', FRONT)))
    sensors = sensors or SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    named = [one for one in aiding(values) if not one.is_plain]
    return simulate_recording(drive, sensors, GnssNoise(SIGMA, 2.0), [arm], seed=seed, named=named,
                              aiding=SimulatedAiding(fix_rate=2.0, fix_sigma=SIGMA, **errors)).recording


def through(values, recording, names=None):
    samples = {name: part for name, part in recording.others.items() if names is None or name in names}
    return run(FilterConfig.from_parameters(values), recording.imu, recording.gnss, Aiding(samples))


def yaw_error(recording, result):
    return wrap(result.yaw - np.interp(result.stamp, recording.reference.stamp, np.unwrap(recording.reference.yaw)))


def test_two_receivers_give_the_heading_at_a_standstill_better_than_one():
    # given a car that stands for two minutes, a heading known to 5.7 degrees, receivers of 2 cm that are 1.6 m apart
    values = given(**{**REAR, 'alignment.heading': 'parameter', 'alignment.yaw_sigma': 0.1, 'gnss.adapt_sigma': False,
                      'rear.lever_arm_sigma': 0.0})
    error, sigma = {}, {}
    for seed in range(3):
        recording = recorded(values, seed=seed, duration=125.0, standstill=120.0)
        off = float(recording.reference.yaw[0]) + 0.08
        for names in ((), ('rear',)):
            result = through({**values, 'alignment.yaw': float(wrap(off))}, recording, names)
            at = np.searchsorted(result.stamp, recording.imu.stamp[0] + 110 * 10**9)
            error.setdefault(names, []).append(abs(yaw_error(recording, result)[at]))
            sigma[names] = result.sigma[at, 8]
    # then one receiver knows what it was told, two know it to half a degree, with a sigma that says so
    assert np.median(error[()]) > 0.05 and sigma[()] > 4.0 * sigma['rear',]
    assert max(error['rear',]) < np.radians(0.5) and sigma['rear',] < np.radians(0.5)
    assert max(error['rear',]) < 3.5 * sigma['rear',]


def test_an_antenna_that_is_not_where_it_is_said_to_be_is_found_and_the_heading_says_how_sure_it_is():
    # given the second antenna 0.2 m further to the right than the parameters say, known to 0.2 m
    values = given(**{**REAR, 'rear.lever_arm_sigma': 0.2})
    recording = recorded(given(**{**REAR, 'rear.lever_arm': [-0.8, -0.2, 1.0]}), duration=240.0, standstill=30.0)
    result = through(values, recording)
    arm = result.config.layout.index('rear_arm_right')
    left = result.memory[state_at(result.memory, int(result.memory[Head.SAMPLES])) + NAV + arm]
    sigma = result.sigma[-1, arm]
    # then it is found, and the heading is right within its sigma, which the place of the antenna does not make small
    assert left == pytest.approx(0.2, abs=3.0 * sigma) and sigma < 0.1
    exact = through({**values, 'rear.lever_arm_sigma': 0.0}, recording)
    wrong, right = (abs(yaw_error(recording, run)[-1]) for run in (exact, result))
    assert right < 3.0 * result.sigma[-1, 8] and right < 0.3 * wrong


def test_each_receiver_has_its_arm_clock_and_scale():
    # given a rear receiver whose stamps are 0.2 s late and whose fixes scatter by five times what they claim
    values = given(**{**REAR, 'rear.time_offset': 0.2})
    recording = recorded(values)
    rear = recording.others['rear']
    late = replace(rear, stamp=rear.stamp + 200_000_000, received=rear.received + 200_000_000,
                   covariance=rear.covariance / 25.0)
    recording = recording.having({'rear': late})
    result = through(values, recording)
    mine = result.measured.select(result.measured.kind == FIRST_NAMED)
    assert len(mine.stamp) > 150
    # then each is taken at its own time and fits there
    assert np.abs(mine.stamp - (late.stamp[mine.index] - 200_000_000)).max() < 1000
    assert np.abs(mine.event[20:, [Event.Z_N, Event.Z_E]]).max() < 0.3
    wrong = through({**values, 'rear.time_offset': 0.0, 'rear.time_offset_sigma': 0.0}, recording)
    theirs = wrong.measured.select(wrong.measured.kind == FIRST_NAMED)
    assert np.abs(theirs.event[20:, [Event.Z_N, Event.Z_E]]).max() > 1.0
    # where nobody has declared it, it is estimated
    left = through({**values, 'rear.time_offset': 0.0}, recording)
    state = left.config.layout.index('rear_time_offset')
    found, sigma = left.extras[-1, state - left.config.layout.n], left.sigma[-1, state]
    assert found == pytest.approx(0.2, abs=3.0 * sigma) and sigma < 0.02
    theirs = left.measured.select(left.measured.kind == FIRST_NAMED)
    assert np.abs(theirs.event[20:, [Event.Z_N, Event.Z_E]]).max() < 0.3
    # and its scale is learned beside the other's
    at = state_at(result.memory, int(result.memory[Head.SAMPLES])) + int(result.memory[Head.WIDTH]) - INPUT_SIZE
    assert 2.5 < np.sqrt(scale(result.memory, at + Noise.SCALE)) < 8.0


def test_two_wheels_of_an_axle_tell_the_turn_rate():
    # given a gyroscope whose bias about z is 0.01 rad/s, no standstill, poor fixes, wheels of 5 mm/s
    values = given(**{**WHEELS, 'left.scale_sigma': 0.0, 'right.scale_sigma': 0.0, 'vehicle.zero_velocity': False,
                      'gnss.sigma': 3.0, 'gnss.adapt_sigma': False, 'gyroscope.initial_sigma': [0.02]})
    white = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    recording = recorded(values, sensors=white, standstill=0.0, speed_scale=0.0, speed_sigma=0.005)
    rate = recording.imu.angular_rate + [0.0, 0.0, -0.01]  # the sensor's z is up: 0.01 about the body's
    recording = replace(recording, imu=replace(recording.imu, angular_rate=rate))
    error, sigma = {}, {}
    for names in ((), ('left', 'right')):
        result = through(values, recording, names)
        after = np.searchsorted(result.stamp, result.stamp[0] + 20 * 10**9)
        error[names] = abs(result.sensor_errors[after, 5] - 0.01)
        sigma[names] = result.sigma[after, result.config.layout.index('w_z')]
    # then after twenty seconds, of which half went by until fixes of 3 m had shown that their ways fit, they know it
    # better than the fixes do, and as well as they say. (Ten speeds a second tell no more than one: their errors last)
    assert sigma['left', 'right'] < 0.6 * sigma[()] and sigma['left', 'right'] < 2e-3
    assert error['left', 'right'] < 3.0 * sigma['left', 'right']


def test_wheels_have_their_own_scales_and_barometers_their_own_biases():
    values = given(**{**WHEELS, 'inputs': ['left', 'right', 'roof'], 'roof.type': 'pressure', 'roof.topic': '/baro'})
    names = FilterConfig.from_parameters(values).layout.names
    assert names[-7:] == ('left_scale', 'left_time_offset', 'right_scale', 'right_time_offset', 'roof_bias',
                          'roof_dynamic', 'roof_time_offset')
    recording = recorded(values, speed_scale=0.0)
    right = recording.others['right']
    result = through(values, recording.having({'right': replace(right, speed=1.03 * right.speed)}))
    scales = result.extras[-1, [-7, -5]]
    assert scales == pytest.approx([0.0, 0.03], abs=0.006)


def test_live_and_replay_give_the_same_bits_and_each_has_its_tally():
    # given a receiver, two wheels and a barometer with names, one of the wheels dead after a while
    values = given(**{**REAR, **WHEELS, 'inputs': ['rear', 'left', 'right', 'roof'], 'roof.type': 'pressure',
                      'roof.topic': '/baro', 'speed_topic': '/speed'})
    recording = recorded(values, duration=80.0, speed_rate=10.0)
    right = recording.others['right']
    broken = replace(right, speed=np.where(np.arange(len(right)) > 300, np.nan, right.speed))
    recording = recording.having({'right': broken})
    config = FilterConfig.from_parameters(values)
    parts = {**recording.others, 'speed': recording.speed}
    replayed = run(config, recording.imu, recording.gnss, Aiding(parts))
    fusion = FusionFilter(config)
    same_bits(replayed, lived(fusion, recording, 'speed', 'rear', 'left', 'right', 'roof'), 2000)
    health = fusion.health()
    assert all(health[f'{name} used'] > 100 for name in ('rear', 'left', 'right', 'roof', 'speed'))
    assert health['right refused, speed .. m/s: dropped'] > 100 and 'left refused, speed .. m/s: dropped' not in health
    assert any('/right refused' in reason for reason in fusion.reasons)


def test_a_receiver_that_fixes_contradict_stays_refused_when_they_end():
    # given a rear receiver that is 30 m off from 60 s on to 115 s, and fixes until 80 s
    values, noise = given(**REAR), 1.5
    recording = recorded(values, duration=130.0)
    rear, rng = recording.others['rear'], np.random.default_rng(5)
    time = (rear.stamp - recording.imu.stamp[0]) * 1e-9
    off = np.where((time > 60.0) & (time < 115.0), 30.0, 0.0)
    rear = replace(rear, latitude=rear.latitude + (off + noise * rng.standard_normal(len(rear))) / 6.37e6,
                   covariance=rear.covariance + np.diag([noise, noise, noise]) ** 2)
    fixes = recording.gnss
    recording = replace(recording, gnss=fixes.select(fixes.stamp < recording.imu.stamp[0] + 80 * 10**9))
    result = through(values, recording.having({'rear': rear}))
    # then it is used until it is off, and refused from then on
    mine = result.measured.select(result.measured.kind == FIRST_NAMED)
    verdict, since = mine.event[:, Event.VERDICT], time[mine.index]
    assert np.isin(verdict[(since > 20.0) & (since < 60.0)], (Verdict.USED, Verdict.WEIGHTED)).all()
    assert (verdict[off[mine.index] != 0.0] == Verdict.REFUSED).all()
    # and the position is as without it
    without = through(values, recording.having({'rear': rear.select(time < 60.0)}))
    there = result.stamp < recording.imu.stamp[0] + 115 * 10**9
    assert np.abs(result.latitude - without.latitude)[there].max() * 6.37e6 < 0.01


@pytest.mark.parametrize('until', [120.0, 1e9])
def test_a_main_receiver_that_jumps_beside_a_right_one_is_not_followed(until):
    # given a main receiver that is 30 m off from 60 s on, for a minute or to the end
    values = given(**REAR, reference_lever_arm=[0.0, 0.0, 0.0])
    recording = recorded(values, duration=200.0)
    fixes = recording.gnss
    time = (fixes.stamp - recording.imu.stamp[0]) * 1e-9
    off = np.where((time >= 60.0) & (time < until), 30.0, 0.0) / 6.37e6
    result = through(values, replace(recording, gnss=replace(fixes, latitude=fixes.latitude + off)))
    # then the filter goes on with the other one, long after gnss.recovery_time
    truth = truth_of(recording, values)
    errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
    settled = errors.stamp > recording.imu.stamp[0] + 20e9
    assert errors.horizontal[settled].max() < 1.0
    assert np.mean(errors.nees[settled] < NEES_95) > 0.9


def test_an_outage_withholds_the_second_receiver_too():
    values = given(**REAR)
    recording = recorded(values)
    begin = recording.imu.stamp[0] + np.array([60 * 10**9])
    config = FilterConfig.from_parameters(values)
    _, outages = run_with_outages(config, recording.imu, recording.gnss, begin, 30.0, Aiding(recording.others))
    assert outages.run.sigma[-1, 0] > 0.5


def test_a_bag_keeps_them_and_the_checker_names_them(tmp_path):
    # given a simulation from a params file that names them, and a wheel in km/h
    values = given(**{**REAR, **WHEELS, 'inputs': ['rear', 'left', 'right']})
    recording = recorded(values)
    left = recording.others['left']
    recording = recording.having({'left': replace(left, speed=3.6 * left.speed)})
    inputs = aiding(values)
    topics = {one.topic: values[one.topic] for one in inputs if values[one.topic]}
    write_recording(recording, tmp_path / 'bag', inputs=inputs, **topics)
    read = read_recording(tmp_path / 'bag', '/imu/data', '/gps/fix', inputs=inputs, **topics)
    assert np.array_equal(read.others['rear'].stamp, recording.others['rear'].stamp)
    assert np.abs(read.others['rear'].latitude - recording.others['rear'].latitude).max() < 1e-12
    # then the checker says of each what is wrong with it
    said = {f.topic: f.message for f in check_recording(read, values) if f.severity == 'error'}
    assert set(said) == {'left'} and 'set left.factor to 0.2' in said['left']


def test_simulate_makes_what_a_params_file_names(tmp_path):
    file = tmp_path / 'car.yaml'
    file.write_text("/**:\n  ros__parameters:\n    inputs: ['rear']\n    rear:\n      type: fix\n"
                    '      topic: /rear/fix\n      lever_arm: [-1.0, 0.0, 0.5]\n', encoding='utf-8')
    bag = tmp_path / 'bag'
    assert simulate(['--output', str(bag), '--duration', '40', '--params-file', str(file)]) == 0
    values = table.check({'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': '/rear/fix'})
    read = read_recording(bag, '/imu/data', '/gps/fix', inputs=aiding(values), **{'rear.topic': '/rear/fix'})
    assert len(read.others['rear']) == 40


@pytest.mark.parametrize(('values', 'words'), [
    ({'inputs': ['rear']}, "parameter 'rear.type' is missing: 'inputs' has 'rear'"),
    ({**REAR, 'rear.type': 'sonar'},
     "parameter 'rear.type' must be one of fix, heading, imu, magnetometer, pose, pressure, speed, twist, velocity; "
     "got 'sonar'"),
    ({**REAR, 'rear.topic': ''}, "parameter 'rear.topic' is missing"),
    ({**REAR, 'rear.factor': 2.0}, "unknown parameter 'rear.factor'"),
    ({**REAR, 'rear.sigma': -1.0}, "parameter 'rear.sigma' must be at least 0"),
    ({'inputs': ['gnss']}, "'gnss' is the prefix of other parameters"),
    ({'inputs': ['Rear axle']}, "parameter 'inputs' must have different names of small letters"),
    ({**REAR, 'inputs': ['rear', 'rear']}, "parameter 'inputs' must have different names"),
    ({'rear.topic': '/rear'}, "unknown parameter 'rear.topic'")])
def test_what_is_no_input_is_one_clear_line(values, words):
    with pytest.raises(ParameterError) as caught:
        table.check(values)
    assert words in str(caught.value)


def test_the_params_file_of_a_replay_names_them_again(tmp_path, monkeypatch):
    # given what a replay with a named input writes beside its report
    values = given(**REAR)
    monkeypatch.setattr(replay_report, 'best_model', lambda comparison, model: model)
    file = tmp_path / 'parameters.yaml'
    file.write_text(replay_report.parameters_yaml({'drive': None}, values), encoding='utf-8')
    # then it is the same filter
    assert table.check(load_yaml(file)) == values


def test_the_diagnosis_while_driving_hears_them():
    # given a drive with a second receiver and two wheels, one message after the other as a node has them
    values = given(**{**REAR, **WHEELS, 'inputs': ['rear', 'left', 'right']})
    recording = recorded(values, 130.0, rate=20.0)
    imu, gathering, live = recording.imu, Gathering(aiding(values)), []
    rows = sorted((int(received), order, name, i) for order, (name, samples) in enumerate(
        {'imu': imu, 'gnss': recording.gnss, **recording.others}.items())
        for i, received in enumerate(samples.received))
    for _, _, name, i in rows:
        samples = imu if name == 'imu' else recording.streams()[name]
        numbers = [getattr(samples, field.name)[i] for field in fields(samples)[2:]
                   if getattr(samples, field.name) is not None]
        if name == 'imu':
            full = gathering.add_sample((int(imu.stamp[i]), *imu.specific_force[i].tolist(),
                                         *imu.angular_rate[i].tolist()))
            live += [full.recording()] if full else []
        elif name == 'gnss':
            gathering.add_fix((int(samples.stamp[i]), *numbers[:3], numbers[3].ravel(), *numbers[4:]))
        else:
            gathering.add(name, int(samples.stamp[i]), tuple(numbers))
    # then its chunks hold them, bit for bit as those of a replay do, and all of them
    replayed = list(chunks(recording, aiding(values)))
    assert len(live) == len(replayed) == 4
    for one, other in zip(live, replayed):
        assert {'rear', 'left', 'right'} <= one.others.keys() == other.others.keys()
        for name, samples in one.others.items():
            for column, numbers in vars(samples).items():
                assert np.array_equal(numbers, getattr(other.others[name], column)), (name, column)
    heard = np.concatenate([chunk.others['rear'].stamp for chunk in replayed])
    assert np.array_equal(heard, recording.others['rear'].stamp[:len(heard)]) and len(heard) > 230
