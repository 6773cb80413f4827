"""What is compared with what: thinning, noise, the truth, and a verdict that follows from the numbers."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_support import PAPER

from mems_ins_fusion.evaluation import metrics
from mems_ins_fusion.evaluation.comparison import ReplayError, add_noise, compare, fixes_apart, time_span, truth_of
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.reports.replay_answer import sentences
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.sensor_errors.models import Autoregressive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

SECOND = 10**9


def simulated(duration=200.0, gnss_rate=1.0, sigma=1.5, seed=5, model='gauss_markov', values=None):
    sensors = SensorErrors.from_parameters(table.check({**PAPER, **(values or {})}), model)
    return simulate_recording(simulate_drive(duration, seed, 50.0), sensors, GnssNoise(sigma, gnss_rate),
                              seed=seed).recording


@pytest.fixture(scope='module')
def recording():
    return simulated()


def values(**given):
    return table.check({**PAPER, 'outage_durations': [], **given})


@pytest.mark.parametrize('rate, interval, every', [(1.0, 0.0, 1), (1.0, 1.0, 1), (4.0, 1.0, 4), (4.0, 3.0, 12),
                                                   (5.0, 6.0, 30)])
def test_thinning_keeps_fixes_an_interval_apart_whatever_their_jitter(recording, rate, interval, every):
    n, rng = 400, np.random.default_rng(0)
    fixes = recording.gnss.select(np.zeros(n, dtype=int))
    jitter = rng.uniform(-0.4, 0.4, n) / rate
    fixes.stamp[:] = np.round((1e9 + np.arange(n) / rate + np.concatenate([[0.0], jitter[1:]])) * 1e9 / 1e9 * SECOND)
    used = np.flatnonzero(fixes_apart(fixes, interval))
    assert used.tolist() == list(range(0, n, every))


def test_thinning_begins_when_the_filter_has_started(recording):
    fixes = recording.gnss
    used = np.flatnonzero(fixes_apart(fixes, 6.0, int(fixes.stamp[40]) + 3))
    # all up to the start, then the first one of each six seconds since the first fix
    assert used.tolist() == [*range(41), *range(42, len(fixes), 6)]


def test_filters_that_start_at_different_times_are_given_the_same_fixes(recording):
    # given fixes four times a second, of which each second one is used, and starts a fix apart
    fixes = recording.gnss
    quarter = replace(fixes, stamp=fixes.stamp[0] + np.arange(len(fixes)) * 250_000_000)
    first = fixes_apart(quarter, 1.0, int(quarter.stamp[40]))
    for later in range(41, 48):
        other = fixes_apart(quarter, 1.0, int(quarter.stamp[later]))
        # then all up to the start are used, and after it the same ones
        assert other[:later + 1].all() and other[later + 1:].tolist() == first[later + 1:].tolist()


def test_thinning_leaves_out_fixes_that_are_none(recording):
    fixes = recording.gnss.select(slice(0, 20))
    fixes.status[3], fixes.latitude[5] = -1, np.nan
    fixes.latitude[7] = fixes.longitude[7] = 0.0  # what receivers send without a fix, whatever status they state
    assert np.flatnonzero(~fixes_apart(fixes, 0.0)).tolist() == [3, 5, 7]
    truth = truth_of(Recording('', recording.imu, fixes), values())
    assert len(truth) == 17 and truth.reference.latitude.min() > 0.5


def test_noise_is_white_seeded_and_declared():
    fixes = simulated(400.0, 10.0, 0.01).gnss
    noisy = add_noise(fixes, 1.5, seed=1)
    datum = (fixes.latitude[0], fixes.longitude[0], fixes.height[0])
    north, east = (a - b for a, b in zip(to_local(noisy.latitude, noisy.longitude, noisy.height, datum)[:2],
                                         to_local(fixes.latitude, fixes.longitude, fixes.height, datum)[:2]))
    # 4000 values: their standard deviation is known to 1.1 %, five sigma of that are allowed
    assert np.std(north) == pytest.approx(1.5, rel=0.06) and np.std(east) == pytest.approx(1.5, rel=0.06)
    assert abs(np.corrcoef(north[:-1], north[1:])[0, 1]) < 5 / np.sqrt(4000)
    assert abs(np.corrcoef(north, east)[0, 1]) < 5 / np.sqrt(4000)
    assert np.array_equal(noisy.height, fixes.height)
    expected = fixes.covariance + np.diag([1.5**2, 1.5**2, 0.0])
    assert noisy.covariance == pytest.approx(expected)
    assert np.array_equal(add_noise(fixes, 1.5, seed=1).latitude, noisy.latitude)
    assert not np.array_equal(add_noise(fixes, 1.5, seed=2).latitude, noisy.latitude)
    assert add_noise(fixes, 0.0, seed=1) is fixes


def test_noise_on_a_fix_of_unknown_covariance_is_all_that_is_known():
    fixes = simulated(60.0).gnss
    fixes.covariance_type[:], fixes.covariance[:] = 0, np.nan
    noisy = add_noise(fixes, 2.0, seed=1)
    assert noisy.covariance_type.tolist() == [2] * len(fixes)
    assert noisy.covariance[0] == pytest.approx(np.diag([4.0, 4.0, 16.0]))


def test_cut_keeps_what_lies_between_start_and_stop(recording):
    part = time_span(recording, 50.0, 120.0)
    for samples in (part.imu, part.gnss, part.reference):
        after = (samples.stamp - recording.imu.stamp[0]) / SECOND
        assert after.min() >= 50.0 and after.max() <= 120.0 and after.max() - after.min() > 68.0
    with pytest.raises(ReplayError, match='no IMU sample between start 300 s'):
        time_span(recording, 300.0, 0.0)


def test_without_a_reference_only_withheld_fixes_are_the_truth():
    from dataclasses import replace

    recording = simulated(gnss_rate=2.0)
    result = compare(replace(recording, reference=None), values(update_intervals=[0.0, 3.0], models=['gauss_markov']))
    each, third = (result.run_of('gauss_markov', i) for i in (0.0, 3.0))
    # then a run with each fix is measured against its own, and says so
    assert not each.independent and third.independent
    assert not np.isin(third.errors.stamp, third.run.innovations.stamp).any()
    assert len(third.errors) == pytest.approx(len(each.errors) * 5 / 6, abs=2)
    assert any('agreement, not accuracy' in sentence and 'At 0 s' in sentence for sentence in sentences(result))
    # and the errors hold those of the truth: 1.5 m north and east, which the verdict mentions
    assert third.summary['horizontal_rmse_m'] > 1.5
    assert any('uncertain by 1.5 m' in sentence for sentence in sentences(result))


def test_noise_makes_every_fix_a_truth():
    from dataclasses import replace

    recording = replace(simulated(sigma=0.01), reference=None)
    result = compare(recording, values(update_intervals=[1.0], models=['gauss_markov'], fix_noise=1.5))
    only, = result.runs
    assert only.independent
    # then the error is the filter's with fixes of 1.5 m: less than that of a fix, more than that of the truth
    assert 0.3 < only.summary['horizontal_rmse_m'] < 1.5 * np.sqrt(2)
    assert only.run.innovations.nis.mean() == pytest.approx(2.0, abs=1.0)


def test_all_models_are_judged_at_the_same_epochs(recording):
    result = compare(recording, values(update_intervals=[1.0, 5.0]))
    assert len(result.runs) == 6
    assert len({tuple(r.errors.stamp[[0, -1]]) + (len(r.errors),) for r in result.runs}) == 1
    assert {(p.first, p.second) for p in result.pairs} == {
        ('random_walk', 'gauss_markov'), ('random_walk', 'autoregressive'), ('gauss_markov', 'autoregressive')}


def test_errors_are_those_of_a_run_with_all_its_samples(recording):
    """That only some states are kept changes nothing."""
    from mems_ins_fusion.evaluation.comparison import truth_of
    from mems_ins_fusion.filter.config import FilterConfig
    from mems_ins_fusion.filter.runs.replay import run

    given = values(update_intervals=[3.0], models=['random_walk'])
    result = compare(recording, given).runs[0]
    settings = FilterConfig.from_parameters({**given, 'sensor_error_model': 'random_walk'})
    start = run(settings, recording.imu, recording.gnss).stamp[0]
    whole = run(settings, recording.imu, recording.gnss.select(fixes_apart(recording.gnss, 3.0, int(start))))
    truth = truth_of(recording, given)
    errors = metrics.position_errors(whole, truth, np.zeros(len(truth), dtype=bool))
    assert np.array_equal(errors.horizontal[errors.stamp >= result.errors.stamp[0]], result.errors.horizontal)


def test_fixes_that_are_stamped_late_are_the_truth_of_before():
    # given fixes whose stamps are 0.2 s later than the times of their positions by the IMU's clock
    recording = simulate_recording(simulate_drive(30.0, 5, 50.0), None, GnssNoise(0.02)).recording
    fixes = replace(recording, reference=None)
    early, late = (truth_of(fixes, values(**{'gnss.time_offset': offset})).reference.stamp for offset in (0.0, 0.2))
    assert np.array_equal(late, early - 200_000_000)


def test_the_truth_of_a_lever_arm():
    # given an antenna 3 m ahead of the IMU, and a truth that is the IMU's
    from mems_ins_fusion.effects.registry import EFFECTS

    drive = simulate_drive(200.0, 5, 50.0)
    recording = simulate_recording(drive, None, GnssNoise(0.02), [(EFFECTS['gnss_lever_arm'], {'x': 3.0})]).recording
    given = {'gnss.lever_arm': [3.0, 0.0, 0.0], 'update_intervals': [1.0], 'models': ['random_walk'],
             'outage_durations': []}
    right = compare(recording, table.check({**PAPER, **given, 'reference_lever_arm': [0.0, 0.0, 0.0]})).runs[0]
    wrong = compare(recording, table.check(given)).runs[0]
    assert right.summary['horizontal_rmse_m'] < 0.3
    assert wrong.summary['horizontal_rmse_m'] == pytest.approx(3.0, abs=0.3)


def test_a_vehicle_that_never_moves_gives_one_line():
    standing = simulate_recording(simulate_drive(60.0, 1, 50.0, standstill=60.0), None, GnssNoise(1.0)).recording
    with pytest.raises(ReplayError, match='simulation: the filter did not start'):
        compare(standing, values(update_intervals=[1.0]))


def swinging(period=25.0, tau=40.0, **sigma):
    """Parameters of a sensor whose errors swing with `period` s, as AR(2), and of Gauss-Markov models of the same
    standard deviation and correlation time, which know nothing of the swing. There is no constant bias."""
    pole = np.exp(-1 / tau + 2j * np.pi / period)
    coefficients = (-2 * pole.real, abs(pole)**2)
    unit = np.sqrt(Autoregressive(coefficients, 1.0, 1.0).initial_covariance()[0, 0])
    given = {'alignment.level': False}
    for sensor, s in sigma.items():
        given.update({f'{sensor}.initial_sigma': [0.01 * s], f'{sensor}.autoregressive.coefficients': coefficients,
                      f'{sensor}.autoregressive.interval': 1.0, f'{sensor}.autoregressive.b0': [s / unit],
                      f'{sensor}.gauss_markov.sigma': [s], f'{sensor}.gauss_markov.tau': [tau]})
    return given


def test_the_verdict_names_the_model_that_is_right():
    models = swinging(accelerometer=0.08, gyroscope=1.6e-3)
    recording = simulated(900.0, sigma=0.5, seed=8, model='autoregressive', values=models)
    result = compare(recording, values(update_intervals=[6.0], models=['gauss_markov', 'autoregressive'],
                                       outage_durations=[30.0], outage_spacing=20.0, **models))
    text = sentences(result)
    assert any(s.startswith('With fixes each 6 s AR(2) is significantly better than Gauss-Markov') for s in text), text
    assert any('outages of 30 s (largest error) AR(2) is significantly better' in s for s in text), text
    # and the numbers say the same
    error = {r.model: r.summary['horizontal_rmse_m'] for r in result.runs}
    assert error['autoregressive'] < error['gauss_markov']


def test_the_verdict_declares_no_winner_between_equal_models(recording):
    # given two models that are the same process: a Gauss-Markov process is AR(1)
    tau, sigma = 100.0, {'accelerometer': 0.05, 'gyroscope': 1e-3}
    a = np.exp(-0.02 / tau)
    same = {}
    for sensor, s in sigma.items():
        same.update({f'{sensor}.gauss_markov.tau': [tau], f'{sensor}.gauss_markov.sigma': [s],
                     f'{sensor}.autoregressive.coefficients': [-a], f'{sensor}.autoregressive.interval': 0.02,
                     f'{sensor}.autoregressive.b0': [s * np.sqrt(1 - a**2)]})
    result = compare(recording, values(update_intervals=[3.0], models=['gauss_markov', 'autoregressive'], **same))
    one, other = (r.summary['horizontal_rmse_m'] for r in result.runs)
    assert one == pytest.approx(other, rel=1e-3)
    text = ' '.join(sentences(result))
    assert 'no model is certainly better' in text or 'nobody will notice' in text
