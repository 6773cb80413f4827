"""Errors, their sums and their confidence, against hand computation, evo, SciPy and statsmodels."""
from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mems_ins_fusion.evaluation import intervals, metrics
from mems_ins_fusion.evaluation.metrics import Truth, position_errors
from mems_ins_fusion.filter.runs.results import Run
from mems_ins_fusion.navigation.earth import from_local
from mems_ins_fusion.reports.trajectories import write_judged, write_truth
from mems_ins_fusion.samples import Fixes, ImuSamples, Reference

DATUM = (0.84, 0.2, 480.0)
SECOND = 10**9


def make_run(time, north, east, *, yaw=0.0, roll=0.0, pitch=0.0, v_n=0.0, v_e=0.0, p=(1.0, 1.0, 0.0),
             behind=(0.0, 0.0), datum=DATUM):
    """A run at times (n,) s with positions in m at `datum`; p: P_nn, P_ee, P_ne."""
    n = len(time)
    latitude, longitude, height = from_local(np.asarray(north, float), np.asarray(east, float), np.zeros(n), datum)
    full = [np.broadcast_to(np.asarray(v, float), n) for v in (roll, pitch, yaw, v_n, v_e)]
    return Run(config=None, stamp=np.round(np.asarray(time) * SECOND).astype(np.int64), index=np.arange(n),
               latitude=latitude, longitude=longitude, height=height,
               velocity=np.column_stack([full[3], full[4], np.zeros(n)]), roll=full[0], pitch=full[1], yaw=full[2],
               sensor_errors=np.empty((n, 0)), sigma=np.sqrt(np.tile([p[0], p[1]], (n, 1))),
               extras=np.empty((n, 0)), covariance_ne=np.full(n, p[2]), behind=np.tile(behind, (n, 1)),
               innovations=None, measured=None, start=None,
               notices=[], memory=None, filter_seconds=0.0)


def make_truth(time, north, east, *, velocity=None, yaw=None, lever_arm=(0.0, 0.0, 0.0), variance=0.0, datum=DATUM):
    n = len(time)
    latitude, longitude, height = from_local(np.asarray(north, float), np.asarray(east, float), np.zeros(n), datum)
    reference = Reference(np.round(np.asarray(time) * SECOND).astype(np.int64), latitude, longitude, height, velocity,
                          None if yaw is None else np.full(n, yaw))
    return Truth(reference, np.asarray(lever_arm, float), np.full(n, variance), 'reference')


def errors_of(run, truth, longest_gap=10.0):
    return position_errors(run, truth, np.zeros(len(truth), dtype=bool), longest_gap)


def test_a_receiver_that_is_behind_is_no_error_of_who_knows_by_how_much():
    # given positions that are right, and fixes that stay 2 m south and 1 m east of them
    time = np.arange(5.0)
    run = make_run(time, 10.0 * time, 0.0 * time, behind=(2.0, -1.0))
    said = make_truth(time, 10.0 * time - 2.0, 0.0 * time + 1.0)
    # then that is what the run expects of such fixes; beside a reference it would be an error
    assert np.allclose(errors_of(run, replace(said, behind=True)).horizontal, 0.0, atol=1e-6)
    assert np.allclose(errors_of(run, said).horizontal, np.hypot(2.0, 1.0), atol=1e-6)


def test_fixes_that_are_late_are_no_error_of_a_filter_that_estimates_by_how_much():
    # given positions that are right at 10 m/s north and 4 m/s west, fixes stamped 0.3 s late, and a filter whose states
    # have that offset from the third second on
    time = np.arange(5.0)
    late = np.array([0.0, 0.0, 0.3, 0.3, 0.3])
    run = replace(make_run(time, 10.0 * time, -4.0 * time, v_n=10.0, v_e=-4.0),
                  extras=np.column_stack([np.ones(5), late]),
                  config=SimpleNamespace(extras=[SimpleNamespace(name=name) for name in ('pitch', 'time_offset')]))
    said = make_truth(time, 10.0 * (time - 0.3), -4.0 * (time - 0.3))
    # then fixes as the truth show no error where it is known; a reference of another clock shows all of it
    known = errors_of(run, replace(said, receiver_clock=True))
    assert known.horizontal == pytest.approx(0.3 * np.hypot(10.0, 4.0) * (late == 0.0), abs=1e-4)
    assert errors_of(run, said).horizontal == pytest.approx(np.full(5, 0.3 * np.hypot(10.0, 4.0)), abs=1e-4)
    # and without such a state nothing is taken away
    without = replace(run, extras=np.empty((5, 0)), config=SimpleNamespace(extras=[]))
    assert errors_of(without, replace(said, receiver_clock=True)).horizontal == pytest.approx(
        errors_of(run, said).horizontal)


TIME = np.arange(5.0)


def test_components_of_a_constant_offset():
    # given a vehicle heading east at 7 m/s that is estimated 3 m north and 4 m east of the truth, 0.1 rad off
    run = make_run(TIME, np.full(5, 3.0), 10 * TIME + 4.0, yaw=math.pi / 2 + 0.1, v_n=0.0, v_e=7.5, p=(4.0, 9.0, 0.0))
    truth = make_truth(TIME, np.zeros(5), 10 * TIME, velocity=np.tile([0.0, 7.0, 0.0], (5, 1)), yaw=math.pi / 2)
    errors = errors_of(run, truth)
    # then right of an eastward heading is south
    assert errors.north == pytest.approx(np.full(5, 3.0), abs=1e-4)
    assert errors.east == pytest.approx(np.full(5, 4.0), abs=1e-4)
    assert errors.horizontal == pytest.approx(np.full(5, 5.0), abs=1e-4)
    assert errors.along == pytest.approx(np.full(5, 4.0), abs=1e-4)
    assert errors.cross == pytest.approx(np.full(5, -3.0), abs=1e-4)
    assert errors.heading == pytest.approx(np.full(5, 0.1), abs=1e-12)
    assert errors.speed == pytest.approx(np.full(5, 0.5), abs=1e-12)
    assert errors.sigma == pytest.approx(np.full(5, math.sqrt(13.0)))
    assert errors.nees == pytest.approx(np.full(5, 9 / 4 + 16 / 9), abs=1e-3)


def test_nees_with_correlation_and_uncertain_truth_is_the_quadratic_form():
    run = make_run(TIME, np.full(5, 1.0), np.full(5, -2.0), p=(4.0, 2.0, 1.5))
    errors = errors_of(run, make_truth(TIME, np.zeros(5), np.zeros(5), variance=0.25))
    e = np.array([errors.north[0], errors.east[0]])
    covariance = np.array([[4.0, 1.5], [1.5, 2.0]]) + 0.25 * np.eye(2)
    assert errors.nees[0] == pytest.approx(e @ np.linalg.solve(covariance, e))


def test_errors_are_those_of_the_antenna():
    # given an antenna 2 m ahead, 1 m to the left and 1.5 m above a tilted IMU
    arm_flu, roll, pitch, yaw = np.array([2.0, 1.0, 1.5]), 0.1, -0.2, 0.7
    n, e, d = Rotation.from_euler('ZYX', [yaw, pitch, roll]).apply(arm_flu * [1, -1, -1])
    run = make_run(TIME, TIME, 2 * TIME, yaw=yaw, roll=roll, pitch=pitch)
    truth = make_truth(TIME, TIME + n, 2 * TIME + e, lever_arm=arm_flu * [1, -1, -1])
    assert errors_of(run, truth).horizontal == pytest.approx(np.zeros(5), abs=1e-4)
    # when the arm is forgotten, then the error is its horizontal length
    forgotten = errors_of(run, make_truth(TIME, TIME + n, 2 * TIME + e))
    assert forgotten.horizontal == pytest.approx(np.hypot(n, e), abs=1e-4)


def test_a_run_is_interpolated_between_its_samples_and_only_there():
    run = make_run([0.0, 1.0, 2.0, 15.0, 16.0], [0.0, 2.0, 4.0, 30.0, 32.0], np.zeros(5))
    truth = make_truth([-0.5, 0.25, 1.5, 2.0, 8.0, 15.0, 15.5, 16.5], [0, 0.5, 3, 4, 16, 30, 31, 33], np.zeros(8))
    errors = errors_of(run, truth)
    # then epochs before, after and in the gap of 13 s are left out
    assert (errors.stamp / SECOND).tolist() == [0.25, 1.5, 2.0, 15.0, 15.5]
    assert errors.horizontal == pytest.approx(np.zeros(5), abs=1e-6)


def test_longitude_wraps():
    datum = (0.3, math.pi - 1e-7, 0.0)
    run = make_run(TIME, np.zeros(5), np.full(5, 2.0), datum=datum)
    truth = make_truth(TIME, np.zeros(5), np.full(5, -1.0), datum=datum)
    truth.reference.longitude[:] = metrics.wrap(truth.reference.longitude)
    run.longitude[:] = metrics.wrap(run.longitude)
    assert errors_of(run, truth).east == pytest.approx(np.full(5, 3.0), abs=1e-4)


def test_summary_by_hand():
    run = make_run(TIME, [0.0, 1.0, 2.0, 3.0, 10.0], np.zeros(5), yaw=0.0)
    truth = make_truth(TIME, np.zeros(5), np.zeros(5))
    errors = position_errors(run, truth, np.array([True, False, False, False, True]))
    numbers = metrics.summary(errors)
    assert numbers['horizontal_rmse_m'] == pytest.approx(math.sqrt(114 / 5), abs=1e-3)
    assert numbers['horizontal_median_m'] == numbers['cep50_m'] == pytest.approx(2.0, abs=1e-3)
    assert numbers['horizontal_p95_m'] == numbers['cep95_m'] == pytest.approx(3 + 0.8 * 7, abs=1e-3)
    assert numbers['horizontal_max_m'] == pytest.approx(10.0, abs=1e-3)
    assert numbers['turning_rmse_m'] == pytest.approx(math.sqrt(100 / 2), abs=1e-3)
    assert numbers['straight_rmse_m'] == pytest.approx(math.sqrt(14 / 3), abs=1e-3)
    assert numbers['along_track_rmse_m'] == pytest.approx(math.sqrt(114 / 5), abs=1e-3)
    assert numbers['cross_track_rmse_m'] == pytest.approx(0.0, abs=1e-3)
    assert numbers['within_95_percent'] == pytest.approx(60.0)  # 0, 1 and 4 are below 5.99
    assert numbers['heading_rmse_deg'] is None and numbers['speed_rmse_mps'] is None
    assert numbers['errors_counted'] == 5


def test_rmse_is_evos_without_alignment(tmp_path):
    # given a run and a truth at other times, as TUM files
    evo_metrics, evo_sync, file_interface = (pytest.importorskip(f'evo.{name}') for name in (
        'core.metrics', 'core.sync', 'tools.file_interface'))
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 60.0, 0.1)
    north, east = np.cumsum(rng.standard_normal((2, len(time))), axis=1)
    run = make_run(time, north, east, yaw=0.3)
    truth = make_truth(time, north + rng.standard_normal(len(time)), east + 2 * rng.standard_normal(len(time)))
    truth = replace(truth, lever_arm=np.array([1.5, -0.8, 0.4]))
    errors = errors_of(run, truth)
    write_judged(tmp_path / 'run.tum', run, errors, truth.reference, DATUM)
    write_truth(tmp_path / 'truth.tum', truth.reference, DATUM)
    # when evo measures the absolute position error in the horizontal plane
    trajectories = [file_interface.read_tum_trajectory_file(str(tmp_path / f'{name}.tum')) for name in ('truth', 'run')]
    trajectories = evo_sync.associate_trajectories(*trajectories)
    for trajectory in trajectories:
        trajectory.positions_xyz[:, 2] = 0.0
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data(trajectories)
    # then it is ours, to the millimetre that a TUM file resolves
    assert ape.get_statistic(evo_metrics.StatisticsType.rmse) == pytest.approx(
        metrics.summary(errors)['horizontal_rmse_m'], abs=1e-3)


def test_tum_orientation_is_that_of_base_link_in_east_north_up(tmp_path):
    roll, pitch, yaw = 0.1, -0.2, 2.0
    run, truth = make_run(TIME, TIME, TIME, roll=roll, pitch=pitch, yaw=yaw), make_truth(TIME, TIME, TIME)
    write_judged(tmp_path / 'run.tum', run, errors_of(run, truth), truth.reference, DATUM)
    written = Rotation.from_quat(np.loadtxt(tmp_path / 'run.tum')[0, 4:])
    to_enu = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    expected = to_enu * Rotation.from_euler('ZYX', [yaw, pitch, roll]) * Rotation.from_matrix(np.diag([1, -1, -1]))
    assert (written.inv() * expected).magnitude() < 1e-6


def test_turns_are_those_of_the_gyroscope_with_a_margin():
    # given 10 deg/s between 20 and 30 s, seen by a gyroscope whose z axis points up, and a bias of 1 deg/s
    time = np.arange(0.0, 60.0, 0.01)
    rate = np.radians(1.0) + np.where((time >= 20) & (time < 30), np.radians(10.0), 0.0)
    stamp = np.round(time * SECOND).astype(np.int64)
    imu = ImuSamples(stamp, stamp, np.tile([0.0, 0.0, 9.81], (len(time), 1)),
                     np.column_stack([0 * rate, 0 * rate, rate]))
    conditioning = np.kron(np.eye(2), np.diag([1.0, -1.0, -1.0]))
    epochs = np.array([5.0, 17.0, 18.6, 25.0, 31.4, 33.0, 55.0])
    turning = metrics.turning_at(imu, conditioning, np.round(epochs * SECOND).astype(np.int64))
    assert turning.tolist() == [False, False, True, True, True, False, False]


def test_truth_from_fixes_leaves_out_what_is_no_position():
    n = 4
    fixes = Fixes(stamp=np.array([30, 10, 20, 40]) * SECOND, received=np.arange(n), latitude=np.full(n, 0.8),
                  longitude=np.array([0.1, 0.2, np.nan, 0.4]), height=np.zeros(n),
                  covariance=np.tile(np.diag([1.0, 3.0, 9.0]), (n, 1, 1)), status=np.array([0, 0, 0, -1], np.int8),
                  covariance_type=np.array([2, 0, 2, 2], np.uint8))
    truth = metrics.truth_from_fixes(fixes, (1.0, 0.0, 0.0), 0.5, 'fixes')
    # then the rest is in order, at the times they describe, with the variance where it is known
    assert truth.reference.longitude.tolist() == [0.2, 0.1]
    assert truth.reference.stamp.tolist() == [round(9.5 * SECOND), round(29.5 * SECOND)]
    assert truth.variance.tolist() == [0.0, 2.0]


def autoregressive_series(rng, n, rho=0.9):
    from scipy.signal import lfilter

    return lfilter([math.sqrt(1 - rho**2)], [1.0, -rho], rng.standard_normal(n + 200))[200:]


def test_correlation_length_of_an_ar1_series_is_its_integrated_autocorrelation():
    rng = np.random.default_rng(0)
    lengths = [intervals.correlation_length(autoregressive_series(rng, 20000)) for _ in range(10)]
    assert np.mean(lengths) == pytest.approx((1 + 0.9) / (1 - 0.9), rel=0.15)
    assert intervals.correlation_length(rng.standard_normal(20000)) == pytest.approx(1.0, abs=0.1)


def test_an_interval_covers_the_mean_of_a_correlated_series():
    # given 150 series of known mean 0; independent draws would cover it in 35 % of them
    rng = np.random.default_rng(2)
    covered = 0
    for _ in range(150):
        low, high = intervals.interval_of_mean(autoregressive_series(rng, 3000))
        covered += low < 0 < high
    # then about 95 % of the 95 % intervals hold it (binomial: 0.95 +- 0.018; the estimated correlation costs a little)
    assert 0.87 < covered / 150 < 0.995


def test_a_paired_comparison_finds_a_difference_and_none_where_there_is_none():
    rng = np.random.default_rng(3)
    false_alarms = 0
    for _ in range(100):
        common = autoregressive_series(rng, 1500)
        a, b = (common + 0.3 * autoregressive_series(rng, 1500) for _ in range(2))
        false_alarms += intervals.paired(a, b).p < 0.05
    assert false_alarms <= 14  # binomial, 5 expected; 14 leave room for chance
    # when one is larger by less than what both share scatters, then the pairing shows it (sigma of the mean: 0.05)
    difference = intervals.paired(a + 0.3, b)
    assert difference.p < 0.01 and difference.low < difference.mean < difference.high
    assert difference.mean == pytest.approx(np.mean(a + 0.3 - b))


def test_too_few_values_say_nothing():
    assert intervals.paired(np.arange(3.0), np.zeros(3)) is None
    assert np.isnan(intervals.interval_of_mean(np.arange(4.0))).all()


def test_equal_series_do_not_differ():
    assert intervals.paired(np.ones(100), np.ones(100)).p == 1.0


def test_holm_is_that_of_statsmodels():
    multitest = pytest.importorskip('statsmodels.stats.multitest')
    p = [0.04, 0.001, 0.03, 0.8, 0.012]
    assert intervals.holm(p) == pytest.approx(multitest.multipletests(p, method='holm')[1].tolist())
    assert intervals.holm([]) == []


def kitti_development_kit(truth, estimate, lengths=range(100, 900, 100), step=1):
    """Mean translation error, %, of poses as (n, 4, 4) matrices: the loops of the benchmark's evaluate_odometry."""
    distance = [0.0]
    for previous, now in zip(truth[:-1], truth[1:]):
        distance.append(distance[-1] + np.linalg.norm(now[:3, 3] - previous[:3, 3]))
    found = []
    for first in range(0, len(truth), step):
        for length in lengths:
            last = next((i for i in range(first, len(truth)) if distance[i] >= distance[first] + length), None)
            if last is None:
                continue
            true = np.linalg.inv(truth[first]) @ truth[last]
            seen = np.linalg.inv(estimate[first]) @ estimate[last]
            found.append(np.linalg.norm((np.linalg.inv(seen) @ true)[:3, 3]) / length)
    return 100 * np.mean(found)


def poses(position, yaw):
    matrices = np.tile(np.eye(4), (len(yaw), 1, 1))
    matrices[:, 0, 0] = matrices[:, 1, 1] = np.cos(yaw)
    matrices[:, 1, 0], matrices[:, 0, 1] = np.sin(yaw), -np.sin(yaw)
    matrices[:, :2, 3] = position
    return matrices


def test_the_heading_error_of_a_reference_without_one_is_that_of_the_course():
    # given an estimate that is the truth turned by 0.1 rad, and a vehicle that stops
    stamp = np.arange(300, dtype=np.int64) * 10**8
    speed = np.where(np.arange(300) < 200, 8.0, 0.0)
    yaw = 0.02 * np.arange(300)
    truth = np.cumsum(0.1 * speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0)
    cos, sin = np.cos(0.1), np.sin(0.1)
    estimate = truth @ np.array([[cos, sin], [-sin, cos]]) + [5.0, -3.0]
    found = metrics.turned_by_course(stamp, truth, estimate)
    assert found[:195] == pytest.approx(np.full(195, 0.1))
    assert np.isnan(found[210:]).all()


def test_relative_translation_is_that_of_the_kitti_benchmark():
    # given 200 s of a winding drive at 2 Hz, and an estimate that drifts in position and heading
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 200.0, 0.5)
    yaw = 0.8 * np.sin(0.05 * time)
    step = 4.0 + np.sin(0.7 * time)[:, None]
    position = np.cumsum(step * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0)
    estimate = position + np.cumsum(0.3 * rng.standard_normal((len(time), 2)), axis=0)
    turned = 0.1 * np.sin(0.11 * time)
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    stamp = np.round(time * SECOND).astype(np.int64) + 7
    found = metrics.relative_translation_percent(stamp, position, estimate, turned, distance)
    # a start each second, which is each second pose
    assert found == pytest.approx(kitti_development_kit(poses(position, yaw), poses(estimate, yaw + turned), step=2),
                                  rel=1e-9)
    # where the truth has no heading, the estimated one counts as right
    unknown = metrics.relative_translation_percent(stamp, position, estimate, np.full(len(time), np.nan), distance)
    assert unknown == pytest.approx(kitti_development_kit(poses(position, 0 * yaw), poses(estimate, 0 * yaw), step=2),
                                    rel=1e-9)
    assert metrics.relative_translation_percent(stamp[:5], position[:5], estimate[:5], turned[:5], distance[:5]) is None
