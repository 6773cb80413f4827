"""What arrives and cannot be used: each with a notice that names topic, field and value, and a filter that goes on."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_support import configure

from mems_ins_fusion.filter.memory import Event, Kind, views
from mems_ins_fusion.filter.runs.intake import Intake
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.start.plausibility import problem_of_samples
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.samples import Fixes
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

RATE = 50
FORCE, TURN = (0.0, 0.0, 9.8), (0.0, 0.0, 0.0)
FIX = (math.radians(48.0), math.radians(11.5), 480.0)
COVARIANCE = [1.0, 0, 0, 0, 1.0, 0, 0, 0, 4.0]
SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND


@pytest.fixture
def fusion():
    """A filter that runs: five seconds at rest, heading from a parameter."""
    made = FusionFilter(configure({'alignment.heading': 'parameter'}))
    for k in range(5 * RATE):
        made.add_imu(BEGIN + k * SECOND // RATE, *FORCE, *TURN)
        if k % RATE == 5:
            made.add_fix(BEGIN + k * SECOND // RATE, *FIX, COVARIANCE)
    assert made.status == 'running'
    made.notices()
    return made


def now(fusion):
    return fusion._now


def said(fusion):
    return [(notice.level, notice.text) for notice in fusion.notices()]


def kept(fusion):
    """The fixes that the filter remembers."""
    fixes = views(fusion._memory)[4]
    return fixes[fixes[:, Event.TIME] > 0]


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize('index', range(6))
def test_an_imu_sample_that_is_not_a_number_is_dropped(fusion, index, bad):
    sample = [*FORCE, *TURN]
    sample[index] = bad
    before = fusion._memory.copy()
    assert not fusion.add_imu(now(fusion) + 20_000_000, *sample)
    (level, text), = said(fusion)
    assert level == 'warning'
    assert text.startswith('/imu/data: linear_acceleration (') and text.endswith(': sample dropped')
    assert str(bad) in text
    assert np.array_equal(fusion._memory, before)
    assert fusion.add_imu(now(fusion) + 20_000_000, *FORCE, *TURN)


def test_lines_about_numbers_that_no_sensor_sends_stay_short(fusion):
    fusion.add_imu(now(fusion) + 20_000_000, 0.1234567890123, 1e300, math.nan, *TURN)
    fusion.add_fix(now(fusion), 1e300, *FIX[1:], COVARIANCE)
    assert all(len(text) < 130 for _, text in said(fusion))


#: samples of each input in the units of the filter, as they are measured at rest
AT_REST = {'speed': (0.0, 0.01), 'velocity': (np.zeros(3), 0.01 * np.eye(3)), 'heading': (0.0, 0.01),
           'twist': (np.zeros(3), np.full(3, 0.01)), 'pressure': (95700.0, 25.0),
           'magnetometer': (np.array([0.0, 2e-5, -4e-5]), 1e-14)}


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('number', [0, 1])
@pytest.mark.parametrize('name', AT_REST)
@pytest.mark.parametrize('absurd', [1e300, -1e300, math.nan, math.inf, 5e-324])
def test_no_number_of_an_input_makes_the_state_none(name, number, absurd):
    # given a filter at rest that hears one more input
    made = FusionFilter(configure({'alignment.heading': 'parameter', f'{name}_topic': '/one'},
                                  mechanization='strapdown'))
    for k in range(8 * RATE):
        stamp = BEGIN + k * SECOND // RATE
        made.add_imu(stamp, *FORCE, *TURN)
        if k % RATE == 5:
            made.add_fix(stamp, *FIX, COVARIANCE)
        if k % 10 == 0:
            numbers = [np.copy(one) for one in AT_REST[name]]
            if k > 5 * RATE:  # when its value, or its variance, is not that of a sensor
                numbers[number] = np.where(numbers[number] == 0.0, numbers[number], absurd) if number else \
                    np.full_like(numbers[number], absurd)
            made.add(name, stamp, *numbers)
    # then it is refused, or weighs nothing, or its default counts
    assert made.state in ('fusing', 'degraded') and np.isfinite(made.odometry).all()
    assert not any('finite' in text for _, text in said(made))


def test_a_fix_without_fix_status_is_dropped(fusion):
    fusion.add_fix(now(fusion), *FIX, COVARIANCE, status=-1)
    assert said(fusion) == [('warning', '/gps/fix: no fix, by its status')]


@pytest.mark.parametrize('bad', [math.nan, math.inf])
@pytest.mark.parametrize('index', range(3))
def test_a_fix_that_is_not_a_number_is_dropped(fusion, index, bad):
    fix = list(FIX)
    fix[index] = bad
    count = len(kept(fusion))
    fusion.add_fix(now(fusion), *fix, COVARIANCE)
    (level, text), = said(fusion)
    assert level == 'warning' and text.startswith('/gps/fix: latitude, longitude, altitude ') and str(bad) in text
    assert text.endswith(': fix dropped') and len(kept(fusion)) == count


@pytest.mark.parametrize(('latitude', 'longitude'), [(91.0, 11.5), (-90.5, 11.5), (48.0, 721.0)])
def test_a_fix_that_is_not_on_earth_is_dropped(fusion, latitude, longitude):
    fusion.add_fix(now(fusion), math.radians(latitude), math.radians(longitude), 480.0, COVARIANCE)
    (level, text), = said(fusion)
    assert level == 'warning'
    assert text == (f'/gps/fix: latitude {latitude:g}, longitude {longitude:g} deg is not on earth: fix dropped')


@pytest.mark.parametrize(('covariance', 'kind'), [
    ([0.0] * 9, 2), (COVARIANCE, 0), ([math.nan] * 9, 2), ([-1.0, 0, 0, 0, 1, 0, 0, 0, 4], 2),
    ([1.0, 2.0, 0, 2.0, 1.0, 0, 0, 0, 4.0], 3)], ids=['zeros', 'unknown', 'nan', 'negative', 'not positive'])
def test_a_covariance_that_says_nothing_becomes_the_default(fusion, covariance, kind):
    fusion.add_fix(now(fusion), *FIX, covariance, covariance_type=kind)
    (level, text), = said(fusion)
    assert level == 'warning'
    assert text.startswith(f'/gps/fix: position_covariance (type {kind}) [{covariance[0]:g}, {covariance[1]:g}, .., ')
    assert text.endswith('is not usable: gnss.default_sigma 3 m is used')
    assert kept(fusion)[-1, [Event.R_NN, Event.R_NE, Event.R_EE, Event.R_DD]] == pytest.approx([9, 0, 9, 36])


def test_a_covariance_is_east_north_up_and_never_smaller_than_a_millimetre(fusion):
    fusion.add_fix(now(fusion), *FIX, [1.0, 0.5, 0, 0.5, 2.0, 0, 0, 0, 3.0])
    assert kept(fusion)[-1, [Event.R_NN, Event.R_NE, Event.R_EE, Event.R_DD]] == pytest.approx([2, 0.5, 1, 3])
    fusion.add_fix(now(fusion) - 1, *FIX, [1e-12, 0, 0, 0, 1e-12, 0, 0, 0, 0.0])
    assert kept(fusion)[-2, [Event.R_NN, Event.R_EE]] == pytest.approx([1e-6, 1e-6])
    # without a variance of the height it is four times that of the larger component
    assert kept(fusion)[-2, Event.R_DD] == pytest.approx(4e-6)
    fusion.add_fix(now(fusion) - 2, *FIX, [1.0, 0.5, 0, 0.5, 2.0, 0, 0, 0, 0.0])
    assert kept(fusion)[-3, Event.R_DD] == pytest.approx(8.0)
    assert said(fusion) == []


def test_a_parameter_replaces_the_covariance_without_complaint():
    fusion = FusionFilter(configure({'alignment.heading': 'parameter', 'gnss.sigma': 2.5}))
    for k in range(5 * RATE):
        fusion.add_imu(BEGIN + k * SECOND // RATE, *FORCE, *TURN)
        if k % RATE == 5:
            fusion.add_fix(BEGIN + k * SECOND // RATE, *FIX, [0.0] * 9)
    assert not any('covariance' in text for _, text in said(fusion))
    assert kept(fusion)[-1, [Event.R_NN, Event.R_NE, Event.R_EE]] == pytest.approx([6.25, 0, 6.25])


def test_stamps_that_come_twice_or_go_back_are_dropped(fusion):
    last = now(fusion)
    for stamp in (last, last - 60_000_000):
        before = fusion._memory.copy()
        assert not fusion.add_imu(stamp, *FORCE, *TURN)
        (level, text), = said(fusion)
        assert level == 'warning' and np.array_equal(fusion._memory, before)
        assert text == (f'/imu/data: header.stamp {stamp * 1e-9:.6f} s does not follow {last * 1e-9:.6f} s: '
                        'sample dropped')
        assert fusion.add_imu(now(fusion) + 20_000_000, *FORCE, *TURN)
        last = now(fusion)


def test_a_single_stamp_from_the_future_does_not_stop_the_filter(fusion):
    assert not fusion.add_imu(now(fusion) + 3600 * SECOND, *FORCE, *TURN)
    assert fusion.add_imu(now(fusion) + 20_000_000, *FORCE, *TURN)
    assert fusion.status == 'running' and len(said(fusion)) == 1


@pytest.mark.parametrize('jump', [-3600, 3600, -1, 30])
def test_a_clock_that_jumps_makes_the_filter_align_anew(fusion, jump):
    start = now(fusion) + jump * SECOND
    answers = [fusion.add_imu(start + k * SECOND // RATE, *FORCE, *TURN) for k in range(1, 8)]
    assert not any(answers)
    texts = said(fusion)
    assert f'/imu/data: header.stamp jumped by {jump + 0.1:+.3f} s and stays there: the filter aligns anew' in (
        text for _, text in texts)
    assert fusion.status == 'waiting for a fix on /gps/fix'
    # and it does so
    for k in range(8, 8 + 5 * RATE):
        fusion.add_imu(start + k * SECOND // RATE, *FORCE, *TURN)
        if k % RATE == 5:
            fusion.add_fix(start + k * SECOND // RATE, *FIX, COVARIANCE)
    assert fusion.status == 'running'


def test_a_gap_is_bridged_and_the_covariance_says_so(fusion):
    before = fusion.update_odometry()
    sigma = fusion.position_covariance_enu[0]
    assert fusion.add_imu(now(fusion) + 2 * SECOND, *FORCE, *TURN)
    assert fusion.update_odometry() == before + 2 * SECOND
    assert fusion.position_covariance_enu[0] > sigma + 2.0


def test_a_fix_that_comes_twice_is_used_once(fusion):
    stamp = now(fusion)
    fusion.add_fix(stamp, *FIX, COVARIANCE)
    count = len(kept(fusion))
    fusion.add_fix(stamp, *FIX, COVARIANCE)
    assert said(fusion) == [('warning', f'/gps/fix: header.stamp {stamp * 1e-9:.6f} s came twice: second fix dropped')]
    assert len(kept(fusion)) == count


def test_of_several_fixes_the_good_ones_are_used_each_as_it_is():
    # given a fix that is not a number between good ones, of which the next has its stamp, and one of tomorrow
    stamp = BEGIN + SECOND * np.array([1, 2, 2, 86_400, 3])
    latitude = np.array([0.1, math.nan, 0.2, 0.3, 0.4])
    fixes = Fixes(stamp, stamp, latitude, np.full(5, 0.2), np.full(5, 480.0), np.tile(np.eye(3), (5, 1, 1)),
                  np.zeros(5, np.int8), np.full(5, 2, np.uint8))
    intake = Intake(configure({'gnss.max_delay': 3.0}))
    used, events = intake.measured(Kind.POSITION, fixes, np.full(5, BEGIN + 3 * SECOND), BEGIN)
    # then each of the others is used with its own place and time
    assert list(used) == [0, 2, 4]
    assert np.array_equal(events[:, [Event.LATITUDE, Event.TIME]], [[0.1, 1.0], [0.2, 2.0], [0.4, 3.0]])
    assert [notice.text.split()[1] for notice in intake.notices()] == ['latitude,', 'fix']


def test_a_fix_that_is_too_late_is_dropped():
    fusion = FusionFilter(configure({'alignment.heading': 'parameter', 'gnss.max_delay': 0.5}))
    for k in range(5 * RATE):
        fusion.add_imu(BEGIN + k * SECOND // RATE, *FORCE, *TURN)
        if k % RATE == 5:
            fusion.add_fix(BEGIN + k * SECOND // RATE, *FIX, COVARIANCE)
    fusion.notices()
    fusion.add_fix(now(fusion) - 400_000_000, *FIX, COVARIANCE)
    assert said(fusion) == []
    stamp = now(fusion) - 700_000_000
    fusion.add_fix(stamp, *FIX, COVARIANCE)
    (level, text), = said(fusion)
    assert level == 'warning' and 'gnss.max_delay' in text
    assert text.startswith(f'/gps/fix: fix stamped {stamp * 1e-9:.3f} s came 0.70 s after the IMU samples of its time')


@pytest.mark.parametrize('running', [False, True])
@pytest.mark.parametrize('offset', [-3600.0, 3600.0])
def test_clocks_that_differ_by_an_hour_are_said(fusion, running, offset):
    if not running:
        fusion = FusionFilter(configure())
        fusion.add_imu(BEGIN, *FORCE, *TURN)
        fusion.notices()
    fusion.add_fix(now(fusion) + round(offset * SECOND), *FIX, COVARIANCE)
    (level, text), = said(fusion)
    assert level == 'warning' and text.startswith('/gps/fix: fix stamped ') and '3600.0' in text
    assert 'the clocks differ (gnss.time_offset)' in text and text.endswith('dropped')
    # and the parameter repairs it
    repaired = FusionFilter(configure({'gnss.time_offset': 60.0}))
    repaired.add_imu(BEGIN, *FORCE, *TURN)
    repaired.notices()
    repaired.add_fix(BEGIN + 60 * SECOND, *FIX, COVARIANCE)
    assert said(repaired) == []


def test_an_outage_is_said_once_and_its_end_as_well(fusion):
    for _ in range(4 * RATE):
        fusion.add_imu(now(fusion) + SECOND // RATE, *FORCE, *TURN)
    (level, text), = said(fusion)
    assert level == 'warning' and text.startswith('no fix used from /gps/fix for 2.5')
    assert fusion.status.startswith('outage for 4.')
    fusion.add_fix(now(fusion), *FIX, COVARIANCE)
    assert said(fusion) == [('info', 'fixes on /gps/fix again')] and fusion.status == 'running'


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_acceleration_in_g_is_not_started_with(mechanization):
    drive = simulate_drive(40.0, 2, float(RATE), standstill=10.0)
    config = configure({'alignment.heading': 'parameter', 'mechanization': mechanization})
    recording = simulate_recording(drive, SensorErrors(), GnssNoise(1.0, 1.0)).recording
    imu = replace(recording.imu, specific_force=recording.imu.specific_force / STANDARD_GRAVITY)
    result = run(config, imu, recording.gnss)
    text = result.notices[-1].text
    assert result.start is None and 'a possible specific force on /imu/data' in text
    assert "in g; set imu.acceleration_unit to 'g'" in text


@pytest.mark.parametrize('mechanization, size, removed', [('strapdown', 0.9, True), ('strapdown', 0.1, True),
                                                          ('strapdown', 30.0, False), ('planar', 1.0, False)])
def test_gravity_that_is_removed_may_look_like_another_unit(mechanization, size, removed):
    """Given samples of a driver that removes gravity, in motion, Then a wrong unit is not the only cause that is told;
    planar needs no gravity."""
    samples = np.zeros((300, 7))
    samples[:, 0], samples[:, 1] = np.arange(300) / 100.0, size
    text = problem_of_samples(samples, configure({'mechanization': mechanization}))
    assert 'a possible specific force' in text and ('has removed gravity' in text) == removed


@pytest.mark.parametrize(('factor', 'told'), [(1.2, True), (1.05, False), (1.0, False)])
def test_a_wrong_scale_is_seen_at_standstill(factor, told):
    drive = simulate_drive(40.0, 2, float(RATE), standstill=10.0)
    config = configure({'alignment.heading': 'parameter'})
    recording = simulate_recording(drive, SensorErrors(), GnssNoise(1.0, 1.0)).recording
    imu = replace(recording.imu, specific_force=recording.imu.specific_force * factor)
    errors = [notice.text for notice in run(config, imu, recording.gnss).notices if notice.level == 'error']
    if not told:
        assert errors == []
        return
    text, = errors
    size = float(text.removeprefix('/imu/data: linear_acceleration is ').split()[0])
    assert size == pytest.approx(9.807 * factor, rel=1e-3)
    assert text.endswith(' at rest where gravity is 9.807 m/s^2: a wrong unit or scale')


def test_a_recording_without_usable_fixes_does_not_start():
    drive = simulate_drive(20.0, 2, float(RATE), standstill=10.0)
    recording = simulate_recording(drive).recording
    none = replace(recording.gnss, status=np.full(len(recording.gnss), -1, np.int8))
    result = run(configure(), recording.imu, none)
    assert len(result.stamp) == 0 and result.start is None and result.memory is None
    assert result.notices[-1].level == 'error'
    assert result.notices[-1].text.startswith('the filter did not start: waiting for')
    assert len(result.innovations.nis) == 0


def test_empty_recordings_are_empty_results():
    drive = simulate_drive(20.0, 2, float(RATE), standstill=10.0)
    recording = simulate_recording(drive).recording
    for imu, gnss in ((recording.imu.select(slice(0, 0)), recording.gnss),
                      (recording.imu, recording.gnss.select(slice(0, 0)))):
        result = run(configure(), imu, gnss)
        assert len(result.stamp) == 0 and result.start is None
