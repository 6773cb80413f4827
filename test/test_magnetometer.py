"""Heading from the magnetic field: its formula, its iron, robots that start by it, what is said where it is wrong."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_support import central_difference, configure, started
from live_support import lived, same_bits
from scipy.spatial.transform import Rotation

from mems_ins_fusion.configuration.configure import configure as configured
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements import magnetometer
from mems_ins_fusion.filter.measurements.geometry import body_to_level
from mems_ins_fusion.filter.memory import Event, Head, Kind, Sample, sample_at, state_at
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.checker import check_recording
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.several import shifted_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.samples import Aiding, MagneticFields
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import SLOW
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

TOPIC = {'magnetometer_topic': '/mag', 'vehicle.zero_velocity': False}
CLEAN = {'magnetometer_disturbance': 0.0}


def robot(seed, duration=150.0, rate=50.0, mounting_rpy=(0.0, 0.0, 0.0), **errors):
    """A robot at 0.4 m/s on a road that is not level, with a magnetometer and fixes of 1.5 m."""
    drive = simulate_drive(duration, seed, rate, standstill=10.0, manoeuvres=SLOW, grade=0.03, bank=0.03)
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(drive, sensors, GnssNoise(1.5, 1.0), mounting_rpy=mounting_rpy, seed=seed,
                              aiding=SimulatedAiding(magnetometer_rate=20.0, **errors)).recording


@pytest.fixture(scope='module')
def slow():
    return robot(8, 240.0, **CLEAN)


def config(**values):
    return FilterConfig.from_parameters(table.check({**TOPIC, **values}))


def driven(recording, samples=None, **values):
    samples = recording.others['magnetometer'] if samples is None else samples
    return run(config(**values), recording.imu, recording.gnss, Aiding(magnetometer=samples))


def heading_error(recording, result):
    """Degrees."""
    truth = np.interp(result.stamp, recording.reference.stamp, np.unwrap(recording.reference.yaw))
    return np.degrees(np.angle(np.exp(1j * (result.yaw - truth))))


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_innovation_and_derivatives_are_those_of_rotations(mechanization):
    # given a tilted vehicle, some iron by estimate, and a field with its share of noise
    c = configure({**TOPIC, 'magnetometer.declination': 0.1}, mechanization=mechanization)
    attitude = (0.0, 0.0, 0.7) if mechanization == 'planar' else (0.05, -0.08, 0.7)
    iron, first = np.array([0.3, -0.2, -0.15, 0.04, 0.03, 0.06]), c.layout.index('magnetometer_hard_x')
    x = np.zeros(c.layout.n)
    x[first:first + 6] = iron
    memory, n = started(c, attitude=attitude, x=x), c.layout.n
    field = np.array([0.7, -0.5, 1.9])
    r, at = state_at(memory, 0), int(memory[Head.SCRATCH_AT]) + n * n + 6 * n
    h = int(memory[Head.SCRATCH_AT]) + n * n
    memory[at + Event.VALUE:at + Event.VALUE + 3], memory[at + Event.DECLINATION] = field, 0.1
    memory[at + Event.STATE] = first
    memory[h:h + 3 * n] = 0.0
    late, sample = c.layout.index('magnetometer_time_offset'), sample_at(memory, 0)
    memory[at + Event.TIME_OFFSET], memory[sample + Sample.W_Z] = late, 0.3
    assert magnetometer.observe(memory, r, at, h, n, body_to_level(memory, r), sample) == 2

    def misfit(away):
        """Expected less measured horizontal field of a vehicle that stands level; away: true less estimated errors."""
        b, tilt = iron + away[first:first + 6], away[c.layout.n_navigation - 1:c.layout.n_navigation]
        turn = [0.0, 0.0, *tilt] if mechanization == 'planar' else away[6:9]
        true = Rotation.from_rotvec(-np.array(turn)) * Rotation.from_euler('ZYX', attitude[::-1])
        yaw = true.as_euler('ZYX')[0]
        level = (Rotation.from_euler('z', -yaw) * true).apply(field - [b[0], b[1], 0.0])
        soft = np.array([[1 + b[2] + b[3], b[4]], [b[4], 1 + b[2] - b[3]]])
        seen = yaw - 0.3 * away[late] - 0.1 - b[5]  # of a vehicle that has turned on since
        return soft @ [math.cos(seen), -math.sin(seen)] - level[:2]
    magnetic = attitude[2] - 0.1 - iron[5]
    basis = np.array([[-math.sin(magnetic), -math.cos(magnetic)], [math.cos(magnetic), -math.sin(magnetic)]])
    rows = np.array([memory[h:h + n], memory[h + n:h + 2 * n]])
    # then z = H x + noise holds where the errors are what they are estimated to be, to first order around it
    assert rows == pytest.approx(-basis @ central_difference(misfit, n, 1e-6), abs=1e-6)
    assert memory[[at + Event.Z_N, at + Event.Z_E]] - rows @ x == pytest.approx(basis @ misfit(np.zeros(n)), abs=1e-9)
    # and the heading that the field shows is the one by which it would be as expected across
    shown = magnetometer.heading(memory, r, at, body_to_level(memory, r))
    level = (Rotation.from_euler('z', -attitude[2]) * Rotation.from_euler('ZYX', attitude[::-1])).apply(
        field - [iron[0], iron[1], 0.0])[:2]
    soft = np.array([[1 + iron[2] + iron[3], iron[4]], [iron[4], 1 + iron[2] - iron[3]]])
    forward, right = np.linalg.solve(soft, level)
    assert math.remainder(shown - (math.atan2(-right, forward) + 0.1 + iron[5]), 2 * math.pi) == pytest.approx(0.0)


def test_a_robot_at_40_cm_a_second_starts_once_it_has_turned(slow):
    # given a robot that is too slow for a course: it never starts by that
    alone = run(config(magnetometer_topic=''), slow.imu, slow.gnss)
    assert not len(alone.stamp)
    # when it has a magnetometer whose iron is as strong as the field, nobody knows how strong
    result = driven(slow)
    # then it starts within a minute, at its first turns, and its heading is what it says
    assert (result.stamp[0] - slow.imu.stamp[0]) * 1e-9 < 60.0
    assert result.start.iron is not None and any('heading from the magnetic field' in text for _, text in
                                                 result.start.notes)
    error = heading_error(slow, result)
    sigma = np.degrees(result.sigma[:, result.config.layout.index('phi_d')])
    assert np.abs(error / sigma).max() < 3.0
    assert np.sqrt(np.mean(error[len(error) // 2:] ** 2)) < 4.0
    # and the declination is no surer than before: neither field nor motion tells much of it, one with the mounting
    assert result.sigma[-1, result.config.layout.index('magnetometer_declination')] > 0.03


def test_measured_iron_tells_the_heading_at_rest():
    # given a robot that stands still, and what somebody has measured of its iron, in the axes of an IMU that is turned
    rpy = (0.0, 0.0, 0.5)
    drive = simulate_drive(20.0, 4, 50.0, standstill=20.0)
    made = simulate_recording(drive, None, GnssNoise(1.5, 1.0), mounting_rpy=rpy, seed=4, aiding=SimulatedAiding(
        magnetometer_rate=20.0, magnetometer_hard_iron=0.0, magnetometer_soft_iron=0.0, magnetometer_declination=0.0,
        magnetometer_disturbance=0.0)).recording
    fields, iron = made.others['magnetometer'], np.array([12e-6, -20e-6, 5e-6])
    fields = replace(fields, field=fields.field + iron)
    known = {'magnetometer.hard_iron': iron.tolist(), 'magnetometer.hard_iron_sigma': 1e-6,
             'imu.mounting_rpy': list(rpy), 'magnetometer.declination': 0.2}
    # then it starts with the heading that it has: magnetic north is declared to be 0.2 rad to the right of where it is
    result = driven(made, fields, **known)
    assert np.abs(heading_error(made, result) - np.degrees(0.2)).max() < 1.5
    # and without the iron's value it waits for a turn
    waiting = driven(made, fields, **{**known, 'magnetometer.hard_iron_sigma': 50e-6})
    assert not len(waiting.stamp) and any('or turns' in notice.text for notice in waiting.notices)


def test_iron_beside_the_way_does_not_turn_the_heading(slow):
    # given the field of a car that the robot passes, late in the drive: 10 uT for twenty seconds
    fields, begin = slow.others['magnetometer'], slow.imu.stamp[0] + 200 * 10**9
    beside = (fields.stamp >= begin) & (fields.stamp < begin + 20 * 10**9)
    disturbed = replace(fields, field=fields.field + np.outer(beside, [6e-6, 8e-6, 0.0]))
    clean, result = driven(slow), driven(slow, disturbed)
    during = (result.stamp > begin) & (result.stamp < begin + 30 * 10**9)
    off = np.degrees(np.angle(np.exp(1j * (result.yaw - clean.yaw))))[during]
    # then it is refused, and the heading hardly moves: by itself it would be some 20 deg off
    measured = result.measured
    refused = (measured.kind == Kind.MAGNETIC) & (measured.event[:, Event.VERDICT] == 3)
    assert refused.sum() > 0.9 * beside.sum() and np.abs(off).max() < 1.5


def test_live_and_replay_give_the_same_bits(slow):
    fusion = FusionFilter(config())
    same_bits(driven(slow), lived(fusion, slow, 'magnetometer'), 5000)
    health = fusion.health()
    assert health['magnetometer used'] > 3000 and 0.0 < health['magnetometer_hard_x sigma'] < 0.1


def test_iron_that_a_run_before_has_learned_tells_the_heading_at_rest(slow):
    # given a robot that has driven, was carried somewhere else, and stands there six minutes later
    before = FusionFilter(config())
    lived(before, slow, 'magnetometer')
    rest = simulate_recording(simulate_drive(20.0, 8, 50.0, standstill=20.0, manoeuvres=SLOW), None,
                              GnssNoise(1.5, 1.0), seed=8,
                              aiding=SimulatedAiding(magnetometer_rate=20.0, **CLEAN)).recording
    rest = shifted_recording(rest, 600 * 10**9)
    # then it starts with the heading of the field; without what it knows it waits for a turn
    for snapshot in (before.snapshot(), None):
        fusion = FusionFilter(config())
        first = rest.imu
        fusion.add_imu(int(first.stamp[0]) - 10**7, *first.specific_force[0].tolist(), *first.angular_rate[0].tolist())
        if snapshot is not None:
            fusion.restore(snapshot, 1.0)
        lived(fusion, rest, 'magnetometer')
        assert fusion.aligned == (snapshot is not None)
        if fusion.aligned:
            assert any('heading from the magnetic field' in notice.text for notice in fusion.notices())
            yaw = math.pi / 2 - 2.0 * math.atan2(fusion.odometry[5], fusion.odometry[6])
            assert abs(math.remainder(yaw - rest.reference.yaw[-1], 2 * math.pi)) < 0.15


def test_a_bag_keeps_it_and_configure_and_the_checker_know_its_unit(slow, tmp_path):
    # given a bag in microtesla
    fields = slow.others['magnetometer']
    in_microtesla = replace(fields, field=1e6 * fields.field, variance=1e12 * fields.variance)
    write_recording(slow.having({'magnetometer': in_microtesla}), tmp_path / 'bag', magnetometer_topic='/mag')
    read = read_recording(tmp_path / 'bag', '/imu/data', '/gps/fix', magnetometer_topic='/mag')
    assert np.array_equal(read.others['magnetometer'].field, in_microtesla.field)
    # then the checker names the factor, and with it says nothing; configure sets it for a robot that is so slow
    worse = [f for f in check_recording(read, table.check(TOPIC))
             if f.topic == 'magnetometer' and f.severity == 'error']
    assert len(worse) == 1 and 'set magnetometer.factor to 1e-06' in worse[0].message
    values = table.check({**TOPIC, 'magnetometer.factor': 1e-6})
    assert all(f.severity == 'info' for f in check_recording(read, values) if f.topic == 'magnetometer')
    found = configured([tmp_path / 'bag']).values
    assert (found['magnetometer_topic'], found['magnetometer.factor']) == ('/mag', 1e-6)


def test_of_a_car_it_is_checked_against_the_course_and_left_out_by_configure(tmp_path):
    drive = simulate_drive(240.0, 3, 50.0, standstill=10.0)
    recording = simulate_recording(drive, None, GnssNoise(0.5, 2.0), seed=3,
                                   aiding=SimulatedAiding(magnetometer_rate=20.0, **CLEAN)).recording
    fields, rng = recording.others['magnetometer'], np.random.default_rng(1)
    said = {}
    for name, part in (('its own', fields), ('a lorry beside it', replace(
            fields, field=fields.field + 20e-6 * rng.standard_normal(3) * np.sin(fields.stamp[:, None] * 1e-10)))):
        found = check_recording(recording.having({'magnetometer': part}), table.check(TOPIC))
        said[name] = [f for f in found if f.topic == 'magnetometer' and 'horizontal' in f.values]
    assert [f.severity for f in said['its own']] == ['info']
    assert said['its own'][0].values['horizontal'] == pytest.approx(20e-6, rel=0.15)
    assert [f.severity for f in said['a lorry beside it']] == ['warning']
    write_recording(recording, tmp_path / 'bag')
    found = configured([tmp_path / 'bag'])
    assert 'magnetometer_topic' not in found.values
    assert any('/imu/mag is not used: the course' in line for setting in found.settings for line in setting.why)


def test_what_cannot_be_is_said(slow):
    # given microtesla where T are expected, and no number
    fields = slow.others['magnetometer'].select(slice(0, 100))
    wrong = MagneticFields(fields.stamp, fields.received, np.where(
        np.arange(100)[:, None] % 2, 1e6 * fields.field, np.nan), fields.variance)
    result = driven(slow, wrong)
    assert not (result.measured.kind == Kind.MAGNETIC).any()
    assert any('uT is outside 5 to 500 uT: dropped (a wrong magnetometer.factor' in notice.text
               for notice in result.notices)
    # and a filter that does not ask for it has no states for its iron
    unasked = run(config(magnetometer_topic=''), slow.imu, slow.gnss, Aiding(magnetometer=fields))
    assert any('magnetometer_topic is empty' in notice.text for notice in unasked.notices)
