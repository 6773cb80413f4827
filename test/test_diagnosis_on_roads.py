"""The study of the diagnosis on roads: its drives are what it says, it goes on where it stopped, and counts right."""
from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'studies'))

import diagnosis_on_roads as study  # noqa: E402

from mems_ins_fusion.effects.registry import EFFECTS  # noqa: E402

CARS = [study.car(number) for number in range(120)]


def test_the_drives_are_what_the_study_says():
    assert sum(c.constrained for c in CARS) == 60
    assert sum(c.receiver.outliers > 0 and c.receiver.smoothing > 0 for c in CARS) == 40
    assert sum(c.receiver.outliers > 0 or c.receiver.smoothing > 0 for c in CARS) == 40
    assert sum(c.receiver.sigma < 0.1 for c in CARS) == 40 and sum(c.characterized for c in CARS) == 60
    assert {g: sum(c.grade == g for c in CARS) for g in study.GRADES} == dict.fromkeys(study.GRADES, 40)
    pairs = [c for c in CARS if c.kind == 'mounting and offset']
    assert len(pairs) == 24 and sum(c.constrained for c in pairs) == 12
    for c in pairs:
        mount = {**c.there, **c.true}['mounting_rotation']
        assert 0.2 <= abs(c.true['gnss_time_offset']['time_offset']) <= 0.8
        assert np.radians(2.0) <= abs(mount['yaw']) <= np.radians(9.0)  # with the degree of every mount
        assert ('mounting_rotation' in c.true) == c.constrained
    assert all(len(c.true) == ('nothing', 'one effect', 'two effects').index(c.kind) for c in CARS if c not in pairs)
    # of the library nothing is missing but what is in every drive
    assert set(EFFECTS) - set().union(*(c.true for c in map(study.car, range(600)))) == {'tilt'}


def test_a_number_is_a_drive():
    assert study.car(17) == study.car(17)
    assert study.car(17).true != study.car(18).true


def test_what_is_declared_is_not_there_twice():
    # given the pair on a car with outliers and smoothing
    case = next(c for c in CARS if c.kind == 'mounting and offset' and c.constrained and c.receiver.smoothing)
    all_of_it, none = case.declaring(list(case.true)), case.declaring([])
    offset = case.true['gnss_time_offset']['time_offset']
    assert all_of_it['gnss.time_offset'] == pytest.approx(offset) and none['gnss.time_offset'] == 0.0
    assert all_of_it['imu.mounting_rpy'] == pytest.approx([case.true['mounting_rotation'][a]
                                                           for a in ('roll', 'pitch', 'yaw')])
    assert none['imu.mounting_rpy'] == [0.0, 0.0, 0.0] == case.given['imu.mounting_rpy']
    assert all_of_it['gnss.lag_per_acceleration'] == pytest.approx(study.smoothing_lag(case.receiver))


def test_a_tracking_filter_stays_behind_by_its_lag():
    # given a receiver that smooths, and a body that accelerates by 1 m/s^2
    receiver = study.GnssNoise(0.0, rate=2.0, smoothing=1.3)
    time = np.arange(0.0, 60.0, 0.5)
    position = np.column_stack([0.5 * time**2, 0 * time, 0 * time])
    error = receiver.distort(time, position, np.zeros_like(position), None)
    assert error[-1, 0] == pytest.approx(-study.smoothing_lag(receiver), rel=1e-6)


def row(**changes) -> dict:
    filled = {'number': 3, 'kind': 'one effect', 'constrained': True, 'grade': 'consumer', 'characterized': False,
              'sigma': 1.5, 'smoothing': 0.0, 'outliers': 0.0, 'true': {'gyroscope_scale': {'z': 0.0123456}},
              'matters': ['gyroscope_scale'], 'found': [['gyroscope_scale', 'g_sensitivity']],
              'deviations': {'gyroscope_scale.z': 1.5}, 'unexplained': False, 'before': [1.0, 2.0, 8.0, 30.0],
              'after': [0.5, 1.0, 4.0, 15.0], 'knowing': [0.5, 1.0, 4.0, 14.0], 'harm': np.bool_(False),
              'within_before': [0.5] * 3, 'within_after': [0.9] * 3, 'within_knowing': [1.0] * 3, 'seconds': 20.0,
              'failure': ''}
    return filled | changes


def test_lines_come_back_as_they_were(tmp_path):
    path = tmp_path / 'results.csv'
    assert study.read(path) == []
    study.append(path, row(number=7))
    study.append(path, row(failure='ValueError: 2, "and" more', found=''))
    first, second = study.read(path)
    assert (first['number'], first['failure'], second['number']) == (3, 'ValueError: 2, "and" more', 7)
    assert second == row(number=7, true={'gyroscope_scale': {'z': 0.01235}}, harm=False)


def test_what_is_counted():
    rows = [row(), row(found=[['mounting_rotation'], ['gyroscope_scale']]),  # the crooked mount is in every drive
            row(found=[['gnss_lever_arm']], harm=True), row(found=[], deviations={}, matters=[]),
            row(found=[['gnss_coloured_noise']], outliers=0.02, deviations={'gyroscope_scale.z': -2.5}),
            row(failure='DiagnosisError: no')]
    table = [line.split(' | ') for line in study.report(rows).splitlines() if ' | ' in line]
    lines = {cells[0][2:]: cells[1] for cells in table}
    assert lines['right first, or its group'] == '2 of 4 (50 %)'
    assert lines['a false finding'] == '1 of 5 (20 %)'
    assert lines['harm: larger errors in outages, for certain'] == '1 of 5 (20 %)'
    assert lines['values within 2 sigma'] == '3 of 4 (75 %)'
    assert lines['errors within 10 % of the knowing filter'] == '5 of 5 (100 %)'
    assert '1 failed' in study.report(rows) and 'DiagnosisError: no' in study.report(rows)
    assert study.report([])


def test_harm_is_what_is_certain():
    rng = np.random.default_rng(1)
    begin, size = [np.arange(40)], rng.uniform(1, 9, 40)
    before = study.Errors(1.0, begin, [size], [size > 0])
    worse = replace(before, largest=[size * 1.3])
    scattered = replace(before, largest=[size + rng.normal(0.0, 1.0, 40)])
    assert study.certainly_larger(worse, before)
    assert not study.certainly_larger(before, worse) and not study.certainly_larger(scattered, before)
