"""fleet: change points. What changed in a vehicle is found within one drive; where nothing changed nothing is found."""
from __future__ import annotations

import json
import math

import numpy as np
import pytest
from fleet_support import DAY, estimates

from mems_ins_fusion.configuration.offset import Offset
from mems_ins_fusion.fleet import history
from mems_ins_fusion.fleet.change_points import QUANTITIES, find_changes, series_of


def changes(rows):
    return find_changes(series_of(rows))


@pytest.mark.parametrize(['realised', 'step'], [(1.0, 1.0), (2.5, 2.5)])
def test_an_antenna_that_moves_is_found_between_the_two_drives(realised, step):
    """Eight vehicles, five drives each; whether the sigmas are right or 2.5 times too small."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        [found] = changes(estimates(rng, 8, 5, 0.04, realised, step=(2, 3, step)))
        assert (found.vehicle, found.last, found.first) == ('car_2', 14 * DAY, 21 * DAY)
        assert found.drives == (3, 2)
        assert abs(found.step - step) < 6 * found.sigma and found.sigma < 0.04 * 4 * realised


def test_the_step_is_as_exact_as_its_sigma_says():
    rng = np.random.default_rng(5)
    found = [changes(estimates(rng, 8, 8, 0.05, 2.0, step=(0, 4, 2.0))) for _ in range(60)]
    score = np.array([(c.step - 2.0) / c.sigma for [c] in found])
    assert 0.6 < np.sqrt(np.mean(score**2)) < 1.4


@pytest.mark.parametrize(['vehicles', 'drives', 'realised'], [(8, 5, 1.0), (8, 5, 4.0), (1, 12, 3.0), (30, 10, 1.5)])
def test_where_nothing_changed_nothing_is_found(vehicles, drives, realised):
    """A false one in a hundred fleets is what is asked for: in 60 none or one is expected."""
    rng = np.random.default_rng(7)
    assert sum(bool(changes(estimates(rng, vehicles, drives, 0.04, realised))) for _ in range(60)) <= 2


def test_a_vehicle_that_scatters_more_than_the_others_did_not_change():
    rng = np.random.default_rng(11)
    wrong = 0
    for _ in range(40):
        rows = estimates(rng, 8, 12, 0.04)
        for row in rows:
            if row['vehicle'] == 'car_5':
                row['value'] += 0.3 * rng.standard_normal()
        wrong += bool(changes(rows))
    assert wrong <= 2


def test_two_steps_of_one_vehicle_are_two_changes():
    rng = np.random.default_rng(13)
    rows = estimates(rng, 8, 12, 0.04)
    for row in rows:
        if row['vehicle'] == 'car_1':
            row['value'] += 1.0 * (row['stamp_ns'] >= 28 * DAY) - 2.0 * (row['stamp_ns'] >= 56 * DAY)
    assert [(c.vehicle, c.first // DAY, c.drives) for c in changes(rows)] == [('car_1', 28, (4, 4)),
                                                                              ('car_1', 56, (4, 4))]


def test_a_yaw_that_passes_half_a_turn_did_not_change():
    rng = np.random.default_rng(17)
    rows = [{**row, 'effect': 'mounting_rotation', 'parameter': 'yaw',
             'value': math.remainder(math.pi + 0.02 * rng.standard_normal(), 2 * math.pi), 'sigma': 0.02}
            for row in estimates(rng, 4, 6, 0.02)]
    assert np.ptp([row['value'] for row in rows]) > 6.0 and changes(rows) == []


def test_noise_that_doubles_is_told_in_percent():
    rng = np.random.default_rng(19)
    rows = [{**row, 'effect': 'gyroscope_noise', 'parameter': 'density', 'sigma': 2e-5, 'value':
             2e-4 * (2.0 if row['vehicle'] == 'car_0' and row['stamp_ns'] > 30 * DAY else 1.0)
             * math.exp(0.1 * rng.standard_normal())} for row in estimates(rng, 8, 8, 0.1)]
    [found] = changes(rows)
    assert 60 < found.step < 140 and 'noise of the gyroscopes: up by' in found.words() and '%' in found.words()


def test_words_name_the_dates_and_one_drive_is_called_one():
    rng = np.random.default_rng(23)
    rows = estimates(rng, 8, 6, 0.02, step=(3, 5, 0.9))
    [found] = changes(rows)
    assert found.words().startswith('antenna (forward): changed by +0.')
    assert 'between 1970-01-29 00:00 and 1970-02-05 00:00; seen in one drive only' in found.words()


def test_estimates_without_a_sigma_are_judged_by_their_scatter():
    rng = np.random.default_rng(29)
    rows = [{**row, 'effect': 'receiver', 'parameter': 'scatter', 'sigma': None, 'value':
             (9.0 if row['vehicle'] == 'car_4' and row['stamp_ns'] > 20 * DAY else 1.5)
             * math.exp(0.15 * rng.standard_normal())} for row in estimates(rng, 8, 6, 0.1)]
    assert [c.vehicle for c in changes(rows)] == ['car_4']


def test_the_quantities_are_what_the_rows_are_called():
    """Names of estimates, as the tasks write them."""
    from mems_ins_fusion.effects.registry import EFFECTS

    for effect, parameter in QUANTITIES:
        if effect in EFFECTS:
            assert parameter in {p.name for p in EFFECTS[effect].parameters}, (effect, parameter)


def test_a_state_file_of_the_node_feeds_the_history(tmp_path):
    """Written as nodes/state_file.py does, from a filter that has driven."""
    from mems_ins_fusion.filter.config import FilterConfig
    from mems_ins_fusion.filter.runs.replay import run
    from mems_ins_fusion.filter.runs.snapshot import make_snapshot
    from mems_ins_fusion.nodes.state_file import StateFile
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.simulation.simulation import simulate_drive, simulate_recording

    recording = simulate_recording(simulate_drive(60.0, seed=1, rate=20.0)).recording
    config = FilterConfig.from_parameters(table.defaults())
    result = run(config, recording.imu, recording.gnss)
    stamp = int(recording.imu.stamp[-1])
    path = tmp_path / 'car.json'
    assert StateFile(str(path), 1.0, 1.0).write(make_snapshot(config, result.memory, stamp)) is None
    rows, why = history.read_state_file(str(path))
    assert why == '' and {row['stamp_ns'] for row in rows} == {stamp}
    yaw = next(row for row in rows if row['parameter'] == 'yaw')
    at = config.layout.index('mounting_yaw')
    assert yaw['sigma'] == pytest.approx(result.sigma[-1, at], rel=0.05)
    path.write_text(json.dumps({'version': 2}))
    assert history.read_state_file(str(path))[1].startswith(f'{path} is not a state file')


def test_an_arm_is_not_drawn_to_zero_in_a_history():
    """Given what a drive measures and what is assumed before, joined as independent values of normal distributions."""
    measured, sigma, before = np.array([2.5, -0.4, 3.0]), np.array([1.0, 0.3, 50.0]), np.array([1.5, 1.0, 1.0])
    joined = 1 / (1 / sigma**2 + 1 / before**2)
    found, found_sigma = Offset(0.0, 0.1, joined * measured / sigma**2, np.sqrt(joined), 0.0, 1.0).arm_alone()
    assert found[:2] == pytest.approx(measured[:2]) and found_sigma[:2] == pytest.approx(sigma[:2])
    assert np.isinf(found_sigma[2])  # the drive shows nothing of it
