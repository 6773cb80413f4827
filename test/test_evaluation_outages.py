"""Outages: each is the run that the filter makes without those fixes, and its error is that against the known truth."""
from __future__ import annotations

import numpy as np
import pytest
from filter_support import PAPER

from mems_ins_fusion.evaluation.metrics import Truth, position_errors, rms
from mems_ins_fusion.evaluation.outages import outage_begins, run_outages, summary
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run, run_with_outages
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

SECOND = 10**9
MODELS = table.MODELS
#: m, of the trust horizon
LIMIT = 3.0


def config(**values):
    return FilterConfig.from_parameters(table.check({**PAPER, **values}))


@pytest.fixture(scope='module', params=[0.0, 0.3], ids=['prompt fixes', 'late fixes'])
def recording(request):
    """240 s at 50 Hz with fixes each second."""
    values = table.check(PAPER)
    return simulate_recording(simulate_drive(240.0, 3, 50.0), SensorErrors.from_parameters(values, 'gauss_markov'),
                              GnssNoise(1.0, latency=request.param), seed=3).recording


def truth_of(recording):
    return Truth(recording.reference, np.zeros(3), np.zeros(len(recording.reference)), 'reference')


def same(a, b, rows=slice(None)):
    """Bit for bit."""
    return all(np.array_equal(getattr(a, name)[rows], getattr(b, name))
               for name in ('stamp', 'latitude', 'longitude', 'velocity', 'yaw', 'sigma', 'covariance_ne'))


@pytest.mark.parametrize('model', MODELS)
def test_a_replay_of_some_samples_is_the_run(recording, model):
    keep = np.zeros(len(recording.imu), dtype=bool)
    keep[::7] = True
    whole = run(config(sensor_error_model=model), recording.imu, recording.gnss)
    part = run(config(sensor_error_model=model), recording.imu, recording.gnss, keep=keep)
    assert len(part.stamp) > 500
    assert same(whole, part, keep[whole.index])
    assert np.array_equal(whole.innovations.z, part.innovations.z)


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_an_outage_is_the_run_without_its_fixes(recording, mechanization):
    # given outages that overlap each other
    settings = config(mechanization=mechanization, **{'vehicle.zero_velocity': True, 'vehicle.non_holonomic': True})
    gnss = recording.gnss
    begin = gnss.stamp[[80, 95, 100, 180]]
    ordinary, coasting = run_with_outages(settings, recording.imu, gnss, begin, 30.0)
    assert coasting.begin.tolist() == begin.tolist()
    for i, b in enumerate(begin):
        # when the whole recording is run without the fixes of one of them
        withheld = (gnss.stamp > b) & (gnss.stamp <= b + 32 * SECOND)
        alone = run(settings, recording.imu, gnss.select(~withheld))
        # then that is what was branched off, bit for bit, up to the sample after its end
        rows = slice(coasting.first[i], coasting.first[i + 1])
        stamp = coasting.run.stamp[rows]
        assert stamp[0] <= b and stamp[-1] >= b + 30 * SECOND
        alone_rows = np.searchsorted(alone.stamp, stamp)
        for name in ('latitude', 'longitude', 'velocity', 'yaw', 'sigma'):
            assert np.array_equal(getattr(alone, name)[alone_rows], getattr(coasting.run, name)[rows]), name
    # and the ordinary run has not noticed
    assert same(run(settings, recording.imu, gnss), ordinary)


def test_a_fix_of_before_the_outage_counts_though_it_comes_after_its_begin(recording):
    # given a fix that arrives after the next one, which is the first withheld
    gnss, settings = recording.gnss, config(**{'gnss.max_delay': 2.0})
    begin = int(gnss.stamp[100])
    gnss.received[100] += round(1.3 * SECOND)
    gnss = gnss.select(np.argsort(gnss.received, kind='stable'))
    assert gnss.stamp[101] == begin
    _, coasting = run_with_outages(settings, recording.imu, gnss, [begin], 15.0)
    recording.gnss.received[100] -= round(1.3 * SECOND)
    # then the outage is the run that has it, without those after it
    alone = run(settings, recording.imu, gnss.select((gnss.stamp <= begin) | (gnss.stamp > begin + 17 * SECOND)))
    late = coasting.run.stamp > begin + 5 * SECOND
    rows = np.searchsorted(alone.stamp, coasting.run.stamp[late])
    assert late.sum() > 400
    assert np.array_equal(alone.latitude[rows], coasting.run.latitude[late])


def test_the_largest_error_is_that_against_the_truth(recording):
    settings, truth = config(**{'horizon.limit': LIMIT}), truth_of(recording)
    begin = recording.gnss.stamp[[80, 120]]
    short, long = run_outages(settings, recording.imu, recording.gnss, truth, [20.0, 10.0], begin)
    assert (short.duration, long.duration) == (10.0, 20.0)
    for outages in (short, long):
        for i, b in enumerate(begin):
            end = b + round(outages.duration * SECOND)
            withheld = (recording.gnss.stamp > b) & (recording.gnss.stamp <= end + SECOND)
            alone = run(settings, recording.imu, recording.gnss.select(~withheld))
            errors = position_errors(alone, truth, np.zeros(len(truth), dtype=bool))
            inside = (errors.stamp > b) & (errors.stamp <= end)
            assert outages.max_error[i] == pytest.approx(errors.horizontal[inside].max(), rel=1e-12)
            # and it crosses the limit when one of these is larger for the first time
            over = errors.stamp[inside][errors.horizontal[inside] > LIMIT]
            assert outages.crossed[i] == (pytest.approx((over[0] - b) * 1e-9) if len(over) else np.inf)
            # and the distance is that of the truth, within what a filter with fixes gets wrong
            rows = (truth.reference.stamp >= b) & (truth.reference.stamp <= end)
            speed = np.hypot(*truth.reference.velocity[rows].T[:2])
            assert outages.distance[i] == pytest.approx(speed.mean() * outages.duration, abs=0.5 * outages.duration)
            assert outages.growth[i, -1] == pytest.approx(errors.horizontal[inside][-1], rel=1e-6)


def test_more_outages_do_not_change_an_outage(recording):
    truth, stamps = truth_of(recording), recording.gnss.stamp
    alone, = run_outages(config(), recording.imu, recording.gnss, truth, [15.0], stamps[[100]])
    among, = run_outages(config(), recording.imu, recording.gnss, truth, [15.0], stamps[60:140:5])
    assert among.max_error[among.begin == stamps[100]].tolist() == alone.max_error.tolist()


def test_outages_of_several_lengths_in_one_run_are_those_of_a_run_for_each(recording):
    truth, stamps = truth_of(recording), recording.gnss.stamp
    begin, longest = stamps[60:140:5], np.tile([20.0, 5.0], 8)
    several = run_outages(config(), recording.imu, recording.gnss, truth, [5.0, 20.0], begin, longest=longest)
    # given runs of one length each, then there are only those of the length that was asked for, to the last bit
    for outages, wanted in zip(several, (longest >= 5.0, longest >= 20.0)):
        alone, = run_outages(config(), recording.imu, recording.gnss, truth, [outages.duration], begin[wanted])
        assert outages.begin.tolist() == begin[wanted].tolist()
        for name in ('max_error', 'distance', 'growth', 'sigma', 'kept', 'announced', 'crossed'):
            assert np.array_equal(getattr(outages, name), getattr(alone, name)), name


def test_an_outage_that_the_recording_does_not_hold_is_not_counted(recording):
    truth, stamps = truth_of(recording), recording.gnss.stamp
    begin = np.array([stamps[2], stamps[100], stamps[-12]])  # before the start, inside, 11 s before the end
    ten, thirty = run_outages(config(), recording.imu, recording.gnss, truth, [10.0, 30.0], begin)
    assert ten.begin.tolist() == begin[1:].tolist()
    assert thirty.begin.tolist() == begin[1:2].tolist()


def test_begins_are_fixes_about_the_spacing_apart(recording):
    first = int(recording.gnss.stamp[40]) - 3
    begin = outage_begins(first, recording.gnss, 0.25, 20.0, 10.0)
    assert np.isin(begin + SECOND // 4, recording.gnss.stamp).all()
    assert begin[0] >= first + 30 * SECOND
    assert np.diff(begin) / SECOND == pytest.approx(np.full(len(begin) - 1, 20.0), abs=1.0)
    assert recording.gnss.stamp[-1] - begin[-1] >= 10 * SECOND


def test_filters_that_start_at_different_times_have_the_same_outages(recording):
    # given starts 0 to 25 s apart, and another time offset
    first, offset = int(recording.gnss.stamp[40]), 0.25
    early = outage_begins(first, recording.gnss, 0.0, 20.0, 10.0)
    for later in range(1, 26, 4):
        late = outage_begins(first + later * SECOND, recording.gnss, offset, 20.0, 10.0)
        # then only outages that begin too soon are missing
        assert late.tolist() == (early[early - SECOND // 4 >= first + (later + 30) * SECOND] - SECOND // 4).tolist()
        assert len(late) >= len(early) - 2


def test_a_short_recording_keeps_its_longest_outage(recording):
    # given 70 s after the first possible begin, and 28 s until the next one counted from the first fix
    fixes, first = recording.gnss, int(recording.gnss.stamp[0]) + 62 * SECOND
    short = fixes.select(fixes.stamp <= first + 100 * SECOND)
    possible = short.stamp[short.stamp >= first + 30 * SECOND]
    # then an outage of 60 s begins at once, and those of less time follow
    begin = outage_begins(first, short, 0.0, 30.0, 10.0, 60.0)
    assert begin[0] == possible[0] and len(begin) >= 2
    # and where the next one counted from the first fix has room for it, it is that
    later = outage_begins(first, fixes, 0.0, 30.0, 10.0, 60.0)
    assert 25 < (later[0] - possible[0]) / SECOND < 30
    assert later.tolist() == outage_begins(first, fixes, 0.0, 30.0, 10.0).tolist()


def test_summary_by_hand(recording):
    outages, = run_outages(config(), recording.imu, recording.gnss, truth_of(recording), [10.0],
                           recording.gnss.stamp[60:200:10])
    numbers = summary(outages)
    assert numbers['count'] == 14
    assert numbers['max_error_rms_m'] == pytest.approx(rms(outages.max_error))
    assert numbers['max_error_median_m'] == np.median(outages.max_error)
    assert numbers['max_error_p95_m'] == np.percentile(outages.max_error, 95)
    assert numbers['percent_of_distance'] == pytest.approx(100 * outages.max_error.sum() / outages.distance.sum())
    none = summary(outages.select(np.zeros(14, dtype=bool)))
    assert none['count'] == 0 and none['max_error_rms_m'] is None


def test_errors_stay_inside_what_the_filter_says():
    # given a sensor with exactly the errors that the filter models, and 35 outages
    values = table.check(PAPER)
    sensors = SensorErrors.from_parameters(values, 'gauss_markov')
    simulated = simulate_recording(simulate_drive(900.0, 11, 50.0), sensors, GnssNoise(1.0), seed=11).recording
    outages, = run_outages(config(), simulated.imu, simulated.gnss, truth_of(simulated), [20.0],
                           simulated.gnss.stamp[80:860:22])
    # then most of the errors at their ends lie inside the 95 % ellipses: fewer than 25 of 35 has p = 1e-6
    assert len(outages.begin) > 30 and outages.within.mean() > 25 / 35
