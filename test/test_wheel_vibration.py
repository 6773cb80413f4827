"""Speed from the vibration of the wheels: the spectrum over the way, the circumference, and the speed told."""
from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from filter_support import configure
from test_filter_live import in_order

from mems_ins_fusion.errors import InputError
from mems_ins_fusion.filter.measurements import wheel_spectrum, wheel_vibration
from mems_ins_fusion.filter.measurements.wheel_spectrum import (
    AXES,
    BINS,
    POINTS,
    SHORTEST,
    SPECTRUM_WINDOW,
    Row,
    Spectrum,
)
from mems_ins_fusion.filter.measurements.wheel_vibration import Lines, Wheels
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.runs.snapshot import from_snapshot, make_snapshot
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import Drive
from mems_ins_fusion.simulation.manoeuvres import _straight
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    Simulation,
    Vibration,
    simulate_drive,
    simulate_recording,
)

CIRCUMFERENCE = 1.87
#: a car with default parameters, as users have it
CAR = {'mechanization': 'strapdown', 'vehicle.zero_velocity': True, 'vehicle.non_holonomic': True}
SHAKEN = Vibration(0.02, 0.05, wheels=0.03, circumference=CIRCUMFERENCE)


@pytest.fixture(scope='module')
def drive() -> Drive:
    return simulate_drive(240.0, 5, 100.0, standstill=10.0, manoeuvres=(_straight,))


def recorded(drive, vibration=SHAKEN) -> Simulation:
    values = configure(CAR).parameters
    return simulate_recording(drive, SensorErrors.from_parameters(values, 'gauss_markov'), GnssNoise(0.3, 2.0), seed=3,
                              vibration=vibration)


@pytest.fixture(scope='module')
def simulated(drive) -> Simulation:
    return recorded(drive)


@pytest.fixture(scope='module')
def heard(simulated):
    """The same fixes through the filter that does not listen, and that reports."""
    recording = simulated.recording
    return {mode: run(configure({**CAR, 'wheel_vibration': mode}), recording.imu, recording.gnss)
            for mode in ('off', 'report')}


def test_the_transform_is_the_fourier_transform():
    # given two series
    rng, part = np.random.default_rng(1), np.zeros(Spectrum.SIZE)
    wheel_spectrum.begin(part)
    series = rng.standard_normal((AXES, POINTS))
    part[Spectrum.SERIES:Spectrum.SERIES + AXES * POINTS] = series.ravel()
    wheel_spectrum._transform(part, 0, 1)
    found = part[Spectrum.REAL:][:2 * POINTS] + 1j * part[Spectrum.IMAGINARY:][:2 * POINTS]
    assert np.allclose(found, np.fft.fft(series[2] + 1j * series[3], 2 * POINTS), atol=1e-9)


def test_a_line_in_cycles_per_metre_is_sharp_while_the_speed_changes():
    # given a vehicle that brakes from 18 to 10 m/s, with 0.9 cycles per metre on one axis beside white noise
    rng, part = np.random.default_rng(2), np.zeros(Spectrum.SIZE)
    wheel_spectrum.begin(part)
    n = 400
    speed = np.linspace(18.0, 10.0, n)
    way = np.cumsum(speed) * 0.01 - 0.5 * 0.01 * speed
    rows = part[Spectrum.RING:Spectrum.TAPER].reshape(POINTS, Row.SIZE)
    rows[:n, Row.TIME], rows[:n, Row.SPEED] = 0.01, speed
    rows[:n, Row.VALUES:] = 0.3 * rng.standard_normal((n, AXES))
    rows[:n, Row.VALUES + 2] += np.sin(2 * math.pi * 0.9 * way)
    part[Spectrum.COUNT] = n
    time, length, last = wheel_spectrum.look(part, 0, 2.5)
    assert (time, length) == pytest.approx((4.0, 56.0), rel=1e-6)
    power = part[Spectrum.POWER:Spectrum.POWER + AXES * BINS].reshape(AXES, BINS)[:, :last]
    # then it is one line, on that axis alone, where a line of steady speed would be
    line = np.flatnonzero(power[2] > 0.9 * wheel_spectrum.MOST)
    assert line.mean() / (2 * length) == pytest.approx(0.9, abs=0.5 / length) and np.ptp(line) <= 6
    assert np.all(np.delete(power, 2, axis=0).mean(axis=1) < 0.3)


def test_what_stands_in_hz_is_no_line_any_more():
    # given a line at 12 Hz on one axis, at another speed in each of forty windows
    rng, part = np.random.default_rng(3), np.zeros(Spectrum.SIZE)
    wheel_spectrum.begin(part)
    rows, shown = part[Spectrum.RING:Spectrum.TAPER].reshape(POINTS, Row.SIZE), []
    for _ in range(40):
        rows[:400, Row.TIME], rows[:400, Row.SPEED] = 0.01, rng.uniform(8.0, 20.0)
        rows[:400, Row.VALUES:] = rng.standard_normal((400, AXES))
        rows[:400, Row.VALUES] += np.sin(2 * math.pi * 12.0 * 0.01 * np.arange(400))
        part[Spectrum.COUNT] = 400
        wheel_spectrum.look(part, 0, 2.5)
        shown.append(part[Spectrum.POWER + round(2 * 12.0 * SPECTRUM_WINDOW)])
    assert shown[0] > 2.5 and abs(np.mean(shown[20:])) < 0.5


def test_the_circumference_is_found_while_fixes_come(heard):
    found = wheel_vibration.summary(heard['report'].memory)
    assert abs(found['circumference_m'] - CIRCUMFERENCE) < 2 * found['sigma_m'] < 0.015
    assert found['share_of_time_percent'] > 30.0


def test_a_report_changes_no_bit(heard):
    for name in ('latitude', 'longitude', 'velocity', 'sigma', 'sensor_errors'):
        assert np.array_equal(getattr(heard['report'], name), getattr(heard['off'], name))


def test_a_speed_is_told_without_fixes_and_no_bit_changes(simulated):
    recording = simulated.recording
    fixes = recording.gnss.select(recording.gnss.stamp < recording.imu.stamp[0] + 200 * 10**9)
    off, report = (run(configure({**CAR, 'wheel_vibration': mode}), recording.imu, fixes) for mode in ('off', 'report'))
    assert np.array_equal(report.latitude, off.latitude) and np.array_equal(report.sigma, off.sigma)
    at = int(report.memory[Wheels.AT])
    then, speed, variance = report.memory[[at + Lines.REPORTED, at + Lines.SPEED, at + Lines.VARIANCE]]
    reference = recording.reference
    true = np.interp(then, (reference.stamp - recording.imu.stamp[0]) * 1e-9,
                     np.linalg.norm(reference.velocity, axis=1))
    sigma = math.sqrt(variance)
    assert then > 205.0 and abs(speed - true) < 3.0 * sigma and sigma < wheel_vibration.LARGEST_SPEED_SIGMA


def test_nothing_is_told_where_the_speed_may_be_outside_of_the_grid(simulated):
    recording = simulated.recording
    fixes = recording.gnss.select(recording.gnss.stamp < recording.imu.stamp[0] + 150 * 10**9)
    found = run(configure({**CAR, 'wheel_vibration': 'report', 'gyroscope.gauss_markov.sigma': [0.02]}), recording.imu,
                fixes)
    then = found.memory[int(found.memory[Wheels.AT]) + Lines.REPORTED]
    v = found.config.layout.index('v_n')
    sigma = np.linalg.norm(found.sigma[:, v:v + 2], axis=1)
    state = np.searchsorted((found.stamp - recording.imu.stamp[0]) * 1e-9, then)
    # it grows further until the end, and the last speed was told before that
    assert then > 150.0 and sigma[state] < 1.5 * wheel_vibration.LARGEST_SPEED_SIGMA < sigma[-1]


def test_without_a_line_nothing_is_told(drive):
    # given a car on a rough road whose wheels are in balance
    recording = recorded(drive, Vibration(0.0, 0.1)).recording
    found = run(configure({**CAR, 'wheel_vibration': 'report'}), recording.imu, recording.gnss)
    assert found.memory[int(found.memory[Wheels.AT]) + Lines.VARIANCE] == 0.0


@pytest.mark.parametrize('feedback', ['closed', 'open'])
def test_live_and_replay_tell_the_same_bits(simulated, feedback):
    # given fixes that come 0.4 s late until 40 s before the end
    recording = simulated.recording
    fixes = replace(recording.gnss, received=recording.gnss.received + 400_000_000)
    fixes = fixes.select(fixes.stamp < recording.imu.stamp[-1] - 40 * 10**9)
    config = configure({**CAR, 'wheel_vibration': 'report'}, feedback=feedback)
    fusion, published = FusionFilter(config), []
    events = in_order(recording.imu, fixes, Aiding())
    for k in range(len(recording.imu)):
        while events and events[0][0] <= k:
            _, name, arguments = events.pop(0)
            getattr(fusion, name)(*arguments)
        if fusion.add_imu(int(recording.imu.stamp[k]), *map(float, recording.imu.specific_force[k]),
                          *map(float, recording.imu.angular_rate[k])) and fusion.aligned:
            fusion.update_odometry()
            published.append((k, *fusion.geodetic))
    replayed = run(config, recording.imu, fixes)
    at = np.searchsorted(replayed.index, [p[0] for p in published])
    assert np.array_equal(np.column_stack([replayed.latitude, replayed.longitude, replayed.height])[at],
                          np.array([p[1:] for p in published]))
    heard = [memory[int(memory[Wheels.AT]):][:Lines.SIZE] for memory in (replayed.memory, fusion._memory)]
    assert np.array_equal(*heard)
    # and a speed was told; in open loop, whose own speed diverges, not in each drive
    assert feedback == 'open' or heard[0][Lines.VARIANCE] > 0.0


def test_it_is_kept_for_the_next_start(heard):
    config, memory = configure({**CAR, 'wheel_vibration': 'report'}), heard['report'].memory
    stamp = int(heard['report'].stamp[-1])
    kept = json.loads(json.dumps(make_snapshot(config, memory, stamp)))
    remembered, _ = from_snapshot(config, kept, stamp + 10**9, 20.0)
    fresh = config.memory()
    wheel_vibration.restore(fresh, remembered.wheels)
    before, after = wheel_vibration.summary(memory), wheel_vibration.summary(fresh)
    # the same circumference, less sure of it: pressure and load
    assert after['circumference_m'] == before['circumference_m'] and after['sigma_m'] > before['sigma_m']
    with pytest.raises(InputError):
        from_snapshot(config, {**kept, 'wheels': [1.0, 2.0]}, stamp + 10**9, 20.0)
    with pytest.raises(InputError):
        from_snapshot(config, {**kept, 'wheels': [99.0, *kept['wheels'][1:]]}, stamp + 10**9, 20.0)
    assert 'wheels' not in make_snapshot(configure(CAR), heard['off'].memory, stamp)


def test_it_is_kept_where_the_filter_starts_anew(simulated, heard):
    # given a clock that jumps by an hour towards the end
    recording, config = simulated.recording, configure({**CAR, 'wheel_vibration': 'report'})
    at = int(recording.imu.stamp[0]) + 200 * 10**9
    imu, gnss = (replace(part, stamp=part.stamp + 3600 * 10**9 * (part.stamp > at),
                         received=part.received + 3600 * 10**9 * (part.received > at))
                 for part in (recording.imu, recording.gnss))
    # when the filter starts anew there
    found = run(config, imu, gnss)
    assert found.stamp[-1] == imu.stamp[-1]
    # then it still knows the circumference, which 40 s alone do not tell
    told = wheel_vibration.summary(found.memory)
    assert told['circumference_m'] == pytest.approx(CIRCUMFERENCE, rel=0.01)
    alone = run(config, imu.select(imu.stamp > at), gnss.select(gnss.stamp > at))
    assert wheel_vibration.summary(alone.memory)['circumference_m'] is None



def test_health_tells_it(heard, simulated):
    recording = simulated.recording
    fusion = FusionFilter(configure({**CAR, 'wheel_vibration': 'report'}))
    fusion._memory = heard['report'].memory.copy()
    fusion._epoch = int(recording.imu.stamp[0])
    told = fusion.health()
    assert told['circumference of the wheels, m'] == pytest.approx(CIRCUMFERENCE, rel=0.01)
    reference = recording.reference
    then = (reference.stamp[-1] - reference.stamp[0]) * 1e-9 - told['age of the speed by the wheels, s']
    true = np.interp(then, (reference.stamp - reference.stamp[0]) * 1e-9, np.linalg.norm(reference.velocity, axis=1))
    assert abs(told['speed by the wheels, m/s'] - true) < 3 * told['speed by the wheels sigma, m/s'] < 1.0


@pytest.mark.parametrize(('given', 'meant'), [(False, 'off'), ('report', 'report')])
def test_off_needs_no_quotes(given, meant):
    # given what YAML and ROS make of off
    assert table.check({'wheel_vibration': given})['wheel_vibration'] == meant


@pytest.mark.parametrize('given', ['on', True])
def test_it_cannot_be_used(given):
    with pytest.raises(ParameterError, match="'wheel_vibration' must be one of off, report; got 'on'"):
        table.check({'wheel_vibration': given})


def test_samples_that_never_change_tell_nothing():
    # given a memory that hears the same numbers over and over at 10 m/s
    memory = configure({**CAR, 'wheel_vibration': 'report'}).memory()
    at, ring = int(memory[Wheels.AT]), int(memory[Wheels.AT]) + Lines.SPECTRUM
    rows = memory[ring + Spectrum.RING:ring + Spectrum.TAPER].reshape(POINTS, Row.SIZE)
    rows[:, Row.TIME], rows[:, Row.SPEED], memory[ring + Spectrum.COUNT] = SHORTEST, 10.0, POINTS
    for _ in range(30):
        _, way, last = wheel_spectrum.look(memory, ring, wheel_vibration.HIGHEST_FREQUENCY)
        wheel_vibration._search_circumference(memory, at, way, last)
    assert memory[at + Lines.VARIANCE_C] == 0.0
