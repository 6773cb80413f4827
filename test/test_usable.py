"""The one intake for whoever looks at raw samples: what of a recording may be looked at, and that the filter agrees."""
from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.position import without_altitude
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.runs.usable import usable, usable_fixes, usable_samples
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording, in_time_order
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_recording

SECOND, DAY = 10**9, 86400 * 10**9
START = 1_700_000_000 * SECOND
COUNT = 3000


def samples(count=COUNT):
    stamp = START + np.arange(count) * SECOND // 100
    draw = np.random.default_rng(0)
    return ImuSamples(stamp, stamp.copy(), draw.normal((0, 0, 9.8), 0.1, (count, 3)), draw.normal(0, 0.01, (count, 3)))


def fixes(count=30):
    stamp = START + np.arange(count) * SECOND
    return Fixes(stamp, stamp + SECOND // 5, np.full(count, 0.8), 0.2 + 1e-7 * np.arange(count), np.full(count, 500.0),
                 np.tile(np.eye(3), (count, 1, 1)), np.zeros(count, np.int8), np.full(count, 2, np.uint8))


def changed(of, name, where, value):
    values = getattr(of, name).copy()
    values[where] = value
    return replace(of, **{name: values})


def test_good_samples_are_the_same_object():
    imu, found = samples(), fixes()
    assert usable_samples(imu) is imu and usable_fixes(found) is found


def test_altitudes_that_are_missing_are_those_between():
    height, covariance = np.linspace(500.0, 529.0, 30), fixes().covariance.copy()
    height[10:20] = np.nan
    without_altitude(height, covariance)
    found = usable_fixes(replace(fixes(), height=height, covariance=covariance))
    np.testing.assert_allclose(found.height, np.linspace(500.0, 529.0, 30))
    none = replace(fixes(), height=np.zeros(30), covariance=np.tile(covariance[10], (30, 1, 1)))
    assert not usable_fixes(none).height.any()


@pytest.mark.parametrize('name', ['specific_force', 'angular_rate'])
@pytest.mark.parametrize('value', [1e300, -1e30, np.nan, np.inf, 2e5])
def test_what_no_sensor_delivers_is_left_out_alone(name, value):
    imu = changed(samples(), name, (1000, 1), value)
    found = usable_samples(imu)
    assert found.stamp.tolist() == np.delete(imu.stamp, 1000).tolist()


def test_limits_of_the_parameters_count_in_si_units():
    imu = changed(samples(), 'specific_force', (1000, 1), 150.0)
    assert len(usable_samples(imu)) == COUNT and len(usable_samples(imu, 100.0, 20.0)) == COUNT - 1


def test_no_gravity_at_all_is_no_sample_and_dead_gyroscopes_are_no_imu():
    imu = samples()
    assert len(usable_samples(changed(imu, 'specific_force', slice(10, 20), 0.0))) == COUNT - 10
    assert len(usable_samples(replace(imu, specific_force=0 * imu.specific_force))) == 0
    assert len(usable_samples(replace(imu, angular_rate=0 * imu.angular_rate))) == 0
    # at rest, coarse digits are zero now and then
    assert len(usable_samples(changed(imu, 'angular_rate', slice(0, 2000), 0.0))) == COUNT


def test_each_sample_counts_once():
    imu = samples()
    assert usable_samples(imu.select(np.repeat(np.arange(COUNT), 2))).stamp.tolist() == imu.stamp.tolist()
    assert len(usable_samples(replace(imu, stamp=np.full(COUNT, START)))) == 1


@pytest.mark.parametrize('where', [0, 1500, COUNT - 1])
@pytest.mark.parametrize('stamp', [0, START - DAY, START + DAY])
def test_one_stamp_of_another_clock(where, stamp):
    found = usable_samples(changed(samples(), 'stamp', where, stamp))
    # the filter waits for five samples before it believes that a clock has jumped
    assert COUNT - 6 <= len(found) < COUNT and (np.diff(found.stamp) > 0).all()
    assert START <= found.stamp[0] and found.stamp[-1] < START + 31 * SECOND


@pytest.mark.parametrize('shift, expected', [
    (-5 * SECOND, 2000), (-DAY, 2000), (5 * SECOND, COUNT), (60 * SECOND, COUNT), (2 * 3600 * SECOND, 2000)])
def test_a_clock_that_is_set_meanwhile_leaves_the_part_with_most_samples(shift, expected):
    imu = samples()
    found = usable_samples(changed(imu, 'stamp', slice(2000, None), imu.stamp[2000:] + shift))
    assert expected - 6 <= len(found) <= expected and (np.diff(found.stamp) > 0).all()


def test_a_stretch_of_another_clock_is_left_out_and_what_follows_is_not():
    imu = samples()
    found = usable_samples(changed(imu, 'stamp', slice(1000, 1100), imu.stamp[1000:1100] + DAY))
    assert COUNT - 106 <= len(found) <= COUNT - 100 and (found.stamp < START + DAY // 2).all()


def test_fixes_that_are_none_come_twice_or_have_another_clock_are_left_out():
    good = fixes()
    assert usable_fixes(good.select(np.repeat(np.arange(30), 2))).stamp.tolist() == good.stamp.tolist()
    assert usable_fixes(good.select(slice(None, None, -1))).stamp.tolist() == good.stamp.tolist()
    for name, value in (('latitude', np.nan), ('latitude', 2.0), ('longitude', 1e300), ('height', -1e5),
                        ('height', np.inf), ('status', -1), ('stamp', START + DAY), ('stamp', 0)):
        found = usable_fixes(changed(good, name, 7, value))
        assert found.stamp.tolist() == np.delete(good.stamp, 7).tolist(), name
    null = changed(changed(good, 'latitude', 3, 0.0), 'longitude', 3, 0.0)
    assert len(usable_fixes(null)) == 29
    assert len(usable_fixes(good.select(slice(0, 0)))) == 0


def test_an_absent_receiver_stays_absent():
    assert usable(Recording('x', samples())).gnss is None


def test_the_filter_makes_the_same_of_what_is_left_out_here():
    """Not finite, twice, of another clock: who looks beside the filter and the filter itself agree on each sample."""
    whole = simulate_recording(simulate_drive(60.0, 2, 50.0, standstill=10.0), None, GnssNoise(1.0), seed=2).recording
    draw = np.random.default_rng(1)
    imu = replace(whole.imu, angular_rate=whole.imu.angular_rate + draw.normal(0, 1e-4, whole.imu.angular_rate.shape))
    twice = imu.select(np.sort(np.concatenate([np.arange(len(imu)), np.arange(100, 2900, 13)])))
    spoiled = changed(changed(twice, 'specific_force', (500, 1), np.nan), 'stamp', 900, 0)
    config = FilterConfig.from_parameters(table.check({}))
    runs = [run(config, samples, whole.gnss) for samples in (spoiled, usable_samples(spoiled))]
    for field in fields(runs[0]):
        one, other = (getattr(r, field.name) for r in runs)
        if field.name not in ('index', 'notices', 'filter_seconds') and isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other, err_msg=field.name)


def test_samples_in_the_order_of_time():
    stamp = np.array([5, 1, 3, 3, 2, 9])
    assert in_time_order(stamp, np.array([True, True, True, True, False, True])).tolist() == [1, 2, 0, 5]
    assert in_time_order(stamp, np.zeros(6, dtype=bool)).tolist() == []
