"""What is known before the heading is, and after a restart: the estimate while parked, start poses, snapshots."""
from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from filter_support import configure
from live_support import fed

from mems_ins_fusion.filter.memory import NAV, Head, Nav, covariance, newest_row, state_at
from mems_ins_fusion.filter.prediction import UNKNOWN_YAW_SIGMA
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.live_output import published
from mems_ins_fusion.filter.runs.odometry import LINEAR, ORIENTATION, POSE_COVARIANCE, TWIST_COVARIANCE
from mems_ins_fusion.filter.runs.snapshot import make_snapshot
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.samples import Aiding, Fixes, ImuSamples, Recording

RATE, SECOND, BEGIN = 50, 10**9, 1_700_000_000 * 10**9
HERE = (0.84, 0.2, 480.0)
METRE = 1 / 6.37e6  # rad of latitude
SIGMA = 1.5
DEFAULTS = table.defaults()


def parked(seconds, seed=0, begin=BEGIN, north=0.0, acceleration=0.0):
    """An IMU at rest that speeds up by `acceleration` (m/s^2) after `seconds`, and fixes of SIGMA twice a second."""
    rng, n = np.random.default_rng(seed), round(seconds * RATE)
    stamp = begin + np.arange(n) * SECOND // RATE
    force = 0.02 * rng.standard_normal((n, 3)) + [acceleration, 0.0, 9.806]
    imu = ImuSamples(stamp, stamp, force, 1e-3 * rng.standard_normal((n, 3)))
    at = stamp[10::RATE // 2]
    k = len(at)
    fixes = Fixes(at, at, HERE[0] + (north + SIGMA * rng.standard_normal(k)) * METRE,
                  HERE[1] + SIGMA * rng.standard_normal(k) * METRE / math.cos(HERE[0]), np.full(k, HERE[2]),
                  np.tile(SIGMA**2 * np.eye(3), (k, 1, 1)), np.zeros(k, int), np.full(k, 2))
    return imu, fixes


def feed(fusion, imu, fixes):
    """Event by event: stamps and odometry of what would be published."""
    stamps, rows = [], []
    for _ in fed(fusion, Recording('parked', imu, fixes)):
        stamps.append(fusion.update_odometry())
        rows.append(fusion.odometry.copy())
    return np.array(stamps), np.array(rows)


def texts(fusion):
    return ' | '.join(notice.text for notice in fusion.notices())


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_while_parked_the_position_is_told_and_that_the_heading_is_not_known(mechanization):
    # given a car that stands, of whose heading nothing is known
    config = configure({**DEFAULTS, 'mechanization': mechanization, 'datum': [*np.degrees(HERE[:2]), HERE[2]],
                        'gnss.lever_arm': [1.0, 0.0, 1.5]})
    imu, fixes = parked(12.0)
    fusion = FusionFilter(config)
    stamps, rows = feed(fusion, imu, fixes)
    # then there is an estimate from the third fix on, of which the datum is the median, before the filter is aligned
    assert not fusion.aligned and fusion.state == 'aligning'
    assert stamps[0] <= fixes.stamp[2] + SECOND // RATE * 2 and len(stamps) > 10 * RATE
    # its position is that of the fixes, its sigma theirs and that of an arm in an unknown direction
    pose = rows[:, POSE_COVARIANCE:LINEAR].reshape(-1, 6, 6)
    assert np.abs(rows[-1, :2]).max() < 4 * SIGMA
    assert rows[-1, 2] == pytest.approx(-1.5, abs=0.1)
    assert SIGMA**2 + 0.5 <= pose[-1, 0, 0] < 1.5 * (SIGMA**2 + 0.5)  # a dozen fixes tell their scatter to that
    # its heading is any, its velocity none
    assert np.all(pose[:, 5, 5] > 0.98 * UNKNOWN_YAW_SIGMA**2)
    assert np.abs(rows[5 * RATE:, LINEAR:LINEAR + 3]).max() < 0.1
    assert np.all(rows[5 * RATE:, TWIST_COVARIANCE] < 0.2**2)
    assert float(fusion.health()['heading sigma, deg']) > 100.0
    # and a replay would publish the same
    stamp, replayed = published(config, imu, fixes, Aiding(), config.datum, np.ones(len(imu), dtype=bool))
    assert np.array_equal(stamp, stamps) and np.array_equal(replayed, rows)


def test_who_drives_off_before_the_heading_is_known_is_still_within_what_is_said():
    # given a car that speeds up to the south, of whose heading nothing is known, and no fix any more
    fusion = FusionFilter(configure({**DEFAULTS, 'datum': [*np.degrees(HERE[:2]), HERE[2]]}))
    imu, fixes = parked(8.0)
    feed(fusion, imu, fixes)
    _, rows = feed(fusion, *(part.select(slice(None, 150)) for part in (
        parked(3.0, 1, begin=int(imu.stamp[-1]) + SECOND // RATE, acceleration=2.0)[0], fixes.select(slice(0)))))
    pose = rows[-1, POSE_COVARIANCE:LINEAR].reshape(6, 6)
    away = np.array([0.0, -0.5 * 2.0 * 3.0**2]) - rows[-1, :2]
    assert away @ np.linalg.solve(pose[:2, :2], away) < 5.99


def test_an_imu_upside_down_gives_no_estimate():
    imu, fixes = parked(8.0)
    fusion = FusionFilter(configure(DEFAULTS))
    stamps, _ = feed(fusion, replace(imu, specific_force=-imu.specific_force), fixes)
    assert len(stamps) == 0 and 'mounted as imu.mounting_rpy' in fusion.status


def drive_state(fusion):
    """Estimates and sigmas of the states behind the navigation errors, by name."""
    memory, layout = fusion._memory, fusion.config.layout
    row = memory[state_at(memory, int(memory[Head.SAMPLES])):][:int(memory[Head.WIDTH])]
    sigma = np.sqrt(np.diag(covariance(row, layout)))
    return {name: (row[NAV + i], sigma[i]) for i, name in enumerate(layout.names)}


@pytest.fixture
def before():
    """A filter that has run at rest, and what it knew of its sensors (made up, as a drive would show it)."""
    fusion = FusionFilter(configure(DEFAULTS))
    imu, fixes = parked(5.0)
    feed(fusion, imu, fixes)
    fusion.set_start(*HERE, 1.0, np.diag([1.0, 1.0, 4.0, 0.01**2]))
    feed(fusion, *parked(2.0, 1, begin=int(imu.stamp[-1]) + SECOND // RATE))
    snapshot = fusion.snapshot()
    errors = snapshot['errors']
    errors['estimate'][0], errors['estimate'][6] = 0.1, 0.02  # f_x, mounting_pitch
    errors['covariance'] = (1e-6 * np.eye(len(errors['names']))).tolist()
    return snapshot


def restarted(snapshot, after=60.0, north=0.0, seconds=8.0, **values):
    """A filter that is given `snapshot` at its first sample, `after` s later."""
    fusion = FusionFilter(configure({**DEFAULTS, **values}))
    imu, fixes = parked(seconds, 2, begin=snapshot['stamp'] + round(after * SECOND), north=north)
    fusion.add_imu(int(imu.stamp[0]) - SECOND // RATE, 0.0, 0.0, 9.806, 0.0, 0.0, 0.0)
    said = fusion.restore(json.loads(json.dumps(snapshot)), 20.0)
    feed(fusion, imu, fixes)
    return fusion, said


def test_a_restart_where_it_stood_takes_heading_and_sensor_errors(before):
    fusion, said = restarted(before)
    assert fusion.aligned and 'heading 57.3' in said and 'sensor errors' in said
    assert 'heading from the state file' in texts(fusion)
    now = fusion.snapshot()
    assert now['yaw'] == pytest.approx(before['yaw'], abs=0.01)
    assert now['yaw_sigma'] < 0.05
    state = drive_state(fusion)
    # what the standstill does not show is what it was, with less certainty: the IMU may have been off
    assert state['mounting_pitch'][0] == pytest.approx(0.02, abs=1e-3)
    assert state['f_x'][0] + 0.0 == pytest.approx(0.1, abs=0.02)
    nothing_learned = {**before, 'errors': {**before['errors'], 'names': []}}
    assert 1e-3 < state['f_x'][1] < drive_state(restarted(nothing_learned)[0])['f_x'][1]


def test_the_attitude_of_a_restart_knows_the_accelerometers_error(before):
    # given level ground and an accelerometer that is known to read 0.1 m/s^2 too much, which it does
    imu, fixes = parked(8.0, 2, begin=before['stamp'] + 60 * SECOND, acceleration=0.1)
    fusion = FusionFilter(configure(DEFAULTS))
    fusion.add_imu(int(imu.stamp[0]) - SECOND // RATE, 0.1, 0.0, 9.806, 0.0, 0.0, 0.0)
    fusion.restore(before, 20.0)
    _, rows = feed(fusion, imu, fixes)
    x, y, z, w = rows[-1, ORIENTATION:POSE_COVARIANCE]
    assert fusion.aligned and math.asin(2 * (w * y - z * x)) == pytest.approx(0.0, abs=3e-3)


@pytest.mark.parametrize('change, said', [
    ({'speed': 3.0}, 'no heading, it ended at 3.0 m/s'), ({'yaw': math.nan}, None), ({'latitude': 'north'}, None),
    ({'errors': {}}, None)])
def test_what_cannot_be_used_of_a_snapshot_is_not(before, change, said):
    if said is None:
        with pytest.raises(ValueError, match='not a state of the filter'):
            restarted({**before, **change})
        return
    fusion, told = restarted({**before, **change})
    assert said in told and not fusion.aligned


@pytest.mark.parametrize('damage', ['size', 'sign', 'nan'])
def test_a_covariance_that_is_none_is_refused(before, damage):
    p = np.array(before['errors']['covariance'])
    p = {'size': p[1:], 'sign': -p, 'nan': p * math.nan}[damage]
    with pytest.raises(ValueError, match='not a state of the filter'):
        restarted({**before, 'errors': {**before['errors'], 'covariance': p.tolist()}})


def test_errors_of_another_configuration_are_left(before):
    fusion, said = restarted(before, **{'imu.mounting_rpy': [0.0, 0.0, 0.3]})
    assert 'no sensor errors, they are of other parameters' in said and fusion.aligned


@pytest.mark.parametrize('north', [0.0, 60.0])
def test_a_heading_holds_only_where_the_vehicle_stood(before, north):
    assert restarted(before, north=north)[0].aligned == (north == 0.0)


def test_older_sensor_errors_are_less_certain(before):
    sigma = [drive_state(restarted(before, after=after)[0])['mounting_yaw'][1] for after in (1.0, 3600.0, 36000.0)]
    assert sigma[0] < sigma[1] < sigma[2]


def test_a_start_pose_in_motion_keeps_the_speed_and_at_the_start_knows_none():
    # given a filter that is told where it is at its first sample: at rest or not, who knows
    fusion = FusionFilter(configure(DEFAULTS))
    imu, _ = parked(1.0)
    nothing = parked(1.0)[1].select(slice(0))
    feed(fusion, imu.select(slice(0, 1)), nothing)
    fusion.set_start(*HERE, 0.0, np.diag([1.0, 1.0, 4.0, 0.01]))
    _, rows = feed(fusion, imu.select(slice(1, 5)), nothing)
    assert rows[-1, TWIST_COVARIANCE] > 10.0**2
    # when it speeds up to 12 m/s and is told again, heading east
    begin = int(imu.stamp[4])
    faster = parked(6.0, begin=begin + SECOND // RATE, acceleration=2.0)[0]
    faster.specific_force[:, 0] += 0.2 * np.sin(5.0 * np.arange(len(faster)) / RATE)  # as even as a road, not as rest
    _, rows = feed(fusion, faster, nothing)
    speed, variance = rows[-1, LINEAR], rows[-1, TWIST_COVARIANCE]
    fusion.set_start(*HERE, math.pi / 2, np.diag([1.0, 1.0, 4.0, 0.01]))
    _, rows = feed(fusion, parked(0.3, begin=begin + 6 * SECOND + SECOND // RATE, acceleration=0.3)[0], nothing)
    # then it goes on as fast, that way, and no surer
    assert speed > 6.0 and rows[0, LINEAR] == pytest.approx(speed, abs=0.2)
    assert rows[0, TWIST_COVARIANCE] > 0.8 * variance
    # and it has gone east since
    assert rows[-1, 0] > 0.2 * speed and abs(rows[-1, 1]) < 0.1 * speed


def test_a_new_start_says_for_how_long_fixes_were_refused_only_where_some_were():
    # given a filter that has started anew, with no fix refused before or with some in the last 3 s
    for refused, said in ((0, 'the fixes depart from the filter'), (3, 'the fixes refused for 3 s agree')):
        fusion = FusionFilter(configure(DEFAULTS))
        imu, fixes = parked(5.0)
        feed(fusion, imu, fixes)
        fusion.set_start(*HERE, 1.0, np.diag([1.0, 1.0, 4.0, 0.01]))
        fusion.notices()
        for k in range(refused):
            fusion.tallies['fix'].refuse(fusion._now - (refused - k) * SECOND, 'too far off')
        newest_row(fusion._memory)[Nav.RECOVERIES] += 1.0
        fusion._say_new_starts()
        # then it says what there was
        assert [said in notice.text for notice in fusion.notices()] == [True]


def test_parameters_that_change_while_it_runs_reach_the_filter():
    fusion = FusionFilter(configure({**DEFAULTS, 'gnss.robust_sigma': 3.0}))
    imu, fixes = parked(5.0)
    feed(fusion, imu, fixes)
    fusion.set_start(*HERE, 1.0, np.diag([1.0, 1.0, 4.0, 0.01]))
    states = fusion.config.layout.names
    fusion.adopt(fusion.changed({'gnss.robust_sigma': 5.0, 'gnss.gate_probability': 1.0,
                                 'vehicle.non_holonomic': False}))
    assert fusion._memory[Head.ROBUST_SIGMA] == 5.0 and fusion._memory[Head.GATE] == 0.0
    assert fusion._memory[Head.LATERAL_SIGMA] == 0.0 and fusion.config.layout.names == states
    fusion.adopt(fusion.changed({'gnss.recovery_time': 7.0}))  # and another one after it
    assert fusion._memory[Head.RECOVERY_TIME] == 7.0 and fusion._memory[Head.LATERAL_SIGMA] == 0.0
    feed(fusion, *parked(1.0, begin=int(imu.stamp[-1]) + SECOND))
    # what would need other states is refused
    without = FusionFilter(configure({**DEFAULTS, 'vehicle.non_holonomic': False}))
    with pytest.raises(ParameterError, match='cannot be switched on while the filter runs'):
        without.changed({'vehicle.non_holonomic': True})


def test_a_snapshot_tells_the_heading_of_the_vehicle(before):
    # given a mounting that is known to be turned, the body's heading is not the vehicle's
    fusion, _ = restarted({**before, 'errors': {**before['errors'], 'estimate': [
        0.05 if name == 'mounting_yaw' else 0.0 for name in before['errors']['names']]}})
    assert fusion.snapshot()['yaw'] == pytest.approx(before['yaw'], abs=5e-3)
    x, y, z, w = fusion.odometry[ORIENTATION:POSE_COVARIANCE]
    body = math.pi / 2 - math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    assert body == pytest.approx(before['yaw'] - 0.05, abs=5e-3)
    assert make_snapshot(fusion.config, fusion._memory, 0)['stamp'] == 0
    assert math.hypot(*to_local(fusion.snapshot()['latitude'], HERE[1], HERE[2], HERE)[:2]) < 5.0
