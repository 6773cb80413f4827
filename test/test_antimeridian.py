"""A drive across 180 degrees of longitude, where the messages jump from 180 to -180: as the same drive elsewhere."""
from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from live_support import fed

from mems_ins_fusion.configuration.inputs import shown_inputs
from mems_ins_fusion.diagnosis.clock import lateness
from mems_ins_fusion.effects.gnss_outliers import far_off
from mems_ins_fusion.evaluation.comparison import compare
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.navigation.frames import near, wrap
from mems_ins_fusion.parameters import table
from mems_ins_fusion.reports.trajectories import write_geojson, write_gpx
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_drive, simulate_recording

VALUES = table.check({'models': ['gauss_markov'], 'update_intervals': [1.0], 'outage_durations': [10.0]})


@pytest.fixture(scope='module', params=['standing', 'driving'])
def drives(request):
    """The same drive in Europe, and moved so that it crosses 180 degrees: where it stands at first (by the noise of the
    fixes several times), or half-way."""
    here = simulate_recording(simulate_drive(200.0, seed=3, hills=True), gnss=GnssNoise(sigma=0.5), seed=3).recording
    at = 0 if request.param == 'standing' else len(here.reference) // 2
    shift = np.pi - here.reference.longitude[at]

    def moved(samples):
        return replace(samples, longitude=wrap(samples.longitude + shift))

    there = replace(here, gnss=moved(here.gnss), reference=moved(here.reference))
    assert (np.abs(np.diff(there.gnss.longitude)) > np.pi).any()
    return here, there


def test_whole_turns_are_added_and_nothing_else():
    angles = np.array([0.1, 3.0, -3.0, 9.0])
    assert near(angles, 0.0)[:3].tolist() == angles[:3].tolist()  # the same bits
    assert near(angles, 3.1) == pytest.approx([0.1, 3.0, 2 * np.pi - 3.0, 9.0 - 2 * np.pi])
    assert np.isnan(near(np.nan, 0.0))


@pytest.mark.parametrize('reference', [True, False])
def test_a_replay_across_it_has_the_same_errors(drives, reference):
    # given a drive across 180 degrees / when it is replayed against a reference, or against its own withheld fixes
    elsewhere, across = (compare(one if reference else replace(one, reference=None), VALUES) for one in drives)
    # then with fixes and in outages its errors are those of the same drive elsewhere
    for name in ('horizontal_rmse_m', 'horizontal_max_m'):
        assert across.runs[0].summary[name] == pytest.approx(elsewhere.runs[0].summary[name], abs=1e-3)
    assert across.outages[0].outages.max_error == pytest.approx(elsewhere.outages[0].outages.max_error, abs=1e-3)


@pytest.fixture(scope='module')
def live(drives):
    """Longitude of the newest fix; latitude, longitude (rad) and odometry (m) that a live filter publishes across 180
    degrees."""
    fusion, found = FusionFilter(FilterConfig.from_parameters(table.defaults())), []
    fixes = drives[1].gnss
    for i in fed(fusion, drives[1]):
        fusion.update_odometry()
        newest = np.searchsorted(fixes.received, drives[1].imu.received[i]) - 1
        found.append((fixes.longitude[newest], *fusion.geodetic[:2], *fusion.odometry[:2]))
    return np.array(found)


def test_the_live_filter_goes_on_across_it(live):
    # then it stays within metres of the fixes, and its local frame has no step
    assert len(live) > 100
    assert np.abs(wrap(live[:, 2] - live[:, 0])).max() * 4.3e6 < 30.0  # m, at the latitude of the drive
    assert np.abs(np.diff(live[:, 3:], axis=0)).max() < 50.0


def test_a_filter_that_is_given_a_start_pose_on_the_other_side_takes_the_fixes(drives):
    # given a start pose whose longitude is stated a whole turn away from the fixes' / when the fixes come
    imu, fixes = drives[1].imu, drives[1].gnss
    fusion = FusionFilter(FilterConfig.from_parameters(table.defaults()))
    for i in range(1000):
        fusion.add_imu(int(imu.stamp[i]), *imu.specific_force[i], *imu.angular_rate[i])
    fusion.set_start(fixes.latitude[0], fixes.longitude[0] - 2 * np.pi, fixes.height[0], 0.3, np.eye(4))
    for i in range(1000, 1010):
        fusion.add_imu(int(imu.stamp[i]), *imu.specific_force[i], *imu.angular_rate[i])
    fusion.add_fix(int(fixes.stamp[10]), fixes.latitude[10], fixes.longitude[10], fixes.height[10],
                   fixes.covariance[10])
    # then the first one is used
    assert [one.used for one in fusion.verdicts()] == [True]


def test_no_fix_is_far_off_because_of_it(drives):
    assert len(far_off(drives[1].gnss)[0]) == len(far_off(drives[0].gnss)[0]) == 0


def test_the_clock_of_a_reference_is_compared_across_it(drives):
    elsewhere, across = (lateness(one.reference, one.gnss) for one in drives)
    assert across == pytest.approx(elsewhere, abs=1e-4)


def test_two_receivers_are_compared_across_it(drives):
    # given the receiver twice / when both are compared across 180 degrees
    found = [shown_inputs({}, {'/other': one.gnss}, one.imu, one.gnss, np.ones(len(one.imu), dtype=bool), None)
             for one in drives]
    # then it is told to be one
    assert [type(one[0]).__name__ for one in found] == ['UnusedTopic', 'UnusedTopic']
    assert found[0][0].why == found[1][0].why


def test_written_tracks_have_longitudes_up_to_180_degrees(drives, tmp_path):
    track = run(FilterConfig.from_parameters(table.defaults()), drives[1].imu, drives[1].gnss)
    write_gpx(tmp_path / 'track.gpx', track, 'drive')
    text = (tmp_path / 'track.gpx').read_text()
    degrees = np.array([float(part.split('"')[0]) for part in text.split('lon="')[1:]])
    assert len(degrees) > 100 and np.abs(degrees).min() > 179.9 and np.abs(degrees).max() <= 180.0
    write_geojson(tmp_path / 'track.geojson', {'drive': track})
    [line] = json.loads((tmp_path / 'track.geojson').read_text())['features']
    assert np.abs(np.array(line['geometry']['coordinates'])[:, 0]).max() <= 180.0
