"""bench: any filter's output measured as a replay is; answers that must follow when the recording is changed."""
from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.__main__ import main as tool
from mems_ins_fusion.fleet import bench, tracks, variants
from mems_ins_fusion.navigation.earth import from_local, to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import odometry_from_reference, write_recording
from mems_ins_fusion.reports.trajectories import write_tum
from mems_ins_fusion.simulation.simulation import SensorErrors, simulate_drive, simulate_recording

PARAMS = """\
/**:
  ros__parameters:
    reference_topic: /reference/fix
    outage_durations: [10.0, 30.0]
"""


@pytest.fixture(scope='module')
def drive():
    errors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(simulate_drive(240.0, seed=3, rate=25.0, standstill=10.0), errors, seed=3)


@pytest.fixture(scope='module')
def place(drive, tmp_path_factory):
    """A bench, as the command makes it, of a recording with a reference at the IMU."""
    folder = tmp_path_factory.mktemp('bench')
    recording = drive.recording
    write_recording(replace(recording, reference=recording.reference.select(slice(None, None, 5))), folder / 'drive')
    (folder / 'params.yaml').write_text(PARAMS)
    assert tool(['bench', 'prepare', '--bag', str(folder / 'drive'), '--params-file', str(folder / 'params.yaml'),
                 '--output', str(folder / 'bench'), '--kf-gins']) == 0
    return folder


@pytest.fixture(scope='module')
def prepared(place):
    return bench.read_prepared(place / 'bench')


def perfect(prepared, north=0.0):
    """A filter that knows the truth but for `north` m."""
    r = prepared.truth.reference
    n, e, d = to_local(r.latitude, r.longitude, r.height, prepared.datum)
    latitude, longitude, height = from_local(n + north, e, d, prepared.datum)
    zero = np.zeros(len(r))
    speed = np.gradient(np.column_stack([n, e]), r.stamp * 1e-9, axis=0)
    return tracks.FilterTrack(r.stamp, latitude, longitude, height, zero, zero, zero, speed,
                              np.full((len(r), 2), 2.0), zero)


def test_each_recording_is_there_without_the_truth(place, prepared):
    assert {'full', 'outages_10s_1', 'outages_30s_1', *variants.VARIANTS} <= set(prepared.recordings)
    for name in prepared.recordings:
        from mems_ins_fusion.recordings.bags import Bag

        with Bag(place / 'bench' / name) as bag:
            assert set(bag.topics) == {'/imu/data', '/gps/fix'}


def test_fixes_are_withheld_where_the_bench_says_and_nowhere_else(place, prepared):
    every = read_recording(place / 'bench/full', '/imu/data', '/gps/fix')
    for name, (duration, begins) in prepared.recordings.items():
        if not duration:
            continue
        some = read_recording(place / 'bench' / name, '/imu/data', '/gps/fix')
        assert len(some.imu) == len(every.imu) and len(begins)
        missing = np.setdiff1d(every.gnss.stamp, some.gnss.stamp)
        expected = [s for s in every.gnss.stamp for b in begins if b < s <= b + duration * 1e9]
        assert missing.tolist() == sorted(expected) and np.isin(begins, some.gnss.stamp).all()
        assert (np.diff(begins) >= (duration + bench.RECOVERY) * 1e9).all()


def test_the_begins_are_those_of_a_replay(place, prepared):
    from mems_ins_fusion.evaluation.comparison import compare

    values = table.check({'outage_durations': [10.0, 30.0], 'models': ['gauss_markov'], 'update_intervals': [0.0],
                          'sensor_error_model': 'gauss_markov'})
    recording = read_recording(place / 'drive', '/imu/data', '/gps/fix', '/reference/fix')
    for result in compare(recording, values).outages:
        mine = [b for duration, some in prepared.recordings.values() if duration == result.outages.duration
                for b in some.tolist()]
        assert set(result.outages.begin.tolist()) <= set(mine)


def test_a_known_error_is_measured_as_it_is(prepared):
    """A filter that is 3 m off to the north, always; by the definition of each number."""
    score = bench.score('off', prepared, dict.fromkeys(prepared.recordings, perfect(prepared, 3.0)))
    assert score.run['horizontal_rmse_m'] == pytest.approx(3.0, abs=1e-3)
    assert score.run['cross_track_rmse_m']**2 + score.run['along_track_rmse_m']**2 == pytest.approx(9.0, abs=0.01)
    assert [row['duration_s'] for row in score.outages] == [10.0, 30.0]
    for row in score.outages:
        assert row['max_error_rms_m'] == pytest.approx(3.0, abs=1e-3) and row['count'] > 3
        assert row['within_95_percent'] == 100.0  # 3 m are 1.5 sigmas


def as_file(kind, prepared, folder, reference):
    """The truth as another filter writes it."""
    n, e, d = to_local(reference.latitude, reference.longitude, reference.height, prepared.datum)
    if kind == 'tum':
        yaw = np.pi / 2 - reference.yaw
        write_tum(folder / 'full.tum', reference.stamp, np.column_stack([e, n, -d]),
                  np.column_stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)]))
    elif kind == 'nav':
        _, second = tracks.gps_week(reference.stamp)
        np.savetxt(folder / 'full.nav', np.column_stack([
            0 * second, second, np.degrees(reference.latitude), np.degrees(reference.longitude), reference.height,
            reference.velocity, 0 * n, 0 * n, np.degrees(reference.yaw)]), '%.10f')
        np.savetxt(folder / 'full.std', np.column_stack([second, *(s + 0 * n for s in (3.0, 2.0)), *[0 * n] * 19]))
    else:
        odometry = odometry_from_reference(reference, prepared.datum)
        odometry = replace(odometry, pose_covariance=np.tile(np.diag([4.0, 9.0, 1, 1, 1, 1.0]), (len(n), 1, 1)))
        from mems_ins_fusion.samples import Recording

        write_recording(Recording('full', None), folder / 'full', odometry={'/odometry/filtered': odometry})


@pytest.mark.parametrize('kind', ['tum', 'nav', 'bag'])
def test_outputs_of_other_filters_are_read(kind, prepared, drive, tmp_path):
    reference = drive.recording.reference.select(slice(None, None, 5))
    as_file(kind, prepared, tmp_path, reference)
    found = bench.tracks_in(tmp_path, prepared)['full']
    assert np.abs(found.stamp - reference.stamp).max() < 1000
    north, east, _ = to_local(found.latitude, found.longitude, found.height, prepared.datum)
    n, e, _ = to_local(reference.latitude, reference.longitude, reference.height, prepared.datum)
    assert np.abs(north - n).max() < 1e-3 and np.abs(east - e).max() < 1e-3
    assert np.abs(np.angle(np.exp(1j * (found.yaw - reference.yaw)))).max() < 1e-6
    if kind != 'tum':
        assert np.allclose(found.sigma, [3.0, 2.0])  # north and east: the message of ROS has east first
    score = bench.score(kind, prepared, {'full': found})
    assert score.run['horizontal_rmse_m'] < 0.01
    assert (score.run['within_95_percent'] is None) == (kind == 'tum')


def test_text_for_kf_gins_holds_the_drive(place, prepared, drive):
    """Its increments add up to what the truth says; frames and units of its manual."""
    imu = np.loadtxt(place / 'bench/full_kf_gins/imu.txt')
    gnss = np.loadtxt(place / 'bench/full_kf_gins/gnss.txt')
    settings = json.loads((place / 'bench/full_kf_gins/kf-gins.yaml').read_text())
    recording = drive.recording
    assert imu.shape == (len(recording.imu), 7) and gnss.shape == (len(recording.gnss), 7)
    # 1.7e9 s since the epoch is 1 384 035 218 s of GPS time with 18 leap seconds
    assert imu[0, 0] == pytest.approx(1_384_035_218 % 604800, abs=0.05)
    assert settings['imudatarate'] == 25 and imu[0, 0] < settings['starttime'] < imu[-1, 0]
    at = np.searchsorted(imu[:, 0], settings['starttime'])
    assert settings['initpos'][:2] == pytest.approx(np.degrees(
        [recording.reference.latitude[at], recording.reference.longitude[at]]), abs=5e-5)
    assert np.cos(np.radians(settings['initatt'][2]) - recording.reference.yaw[at]) > 0.97
    assert settings['imunoise']['arw'][0] == pytest.approx(
        np.degrees(table.defaults()['gyroscope.noise_density'][0]) * 60)
    turned = np.unwrap(recording.reference.yaw)
    rate = imu[:, 3] - imu[:200, 3].mean()  # without the bias that the standstill shows
    assert rate.sum() == pytest.approx(turned[-1] - turned[0], abs=0.3)
    # at rest: gravity is measured upwards, which is -z of forward-right-down
    assert imu[:100, 6].mean() * 25 == pytest.approx(-9.81, abs=0.6)  # but for the bias
    assert np.degrees(recording.gnss.latitude) == pytest.approx(gnss[:, 1], abs=1e-9)


def test_the_table_of_the_command(place, capsys):
    assert tool(['bench', str(place / 'bench'), '--params-file', str(place / 'params.yaml'), '--output',
                 str(place / 'result')]) == 0
    said = capsys.readouterr().out
    content = json.loads((place / 'result/report.json').read_text())
    [run] = content['runs']
    assert 0.2 < run['horizontal_rmse_m'] < 4 and 'mems_ins_fusion' in said
    assert [row['duration_s'] for row in content['outages']] == [10.0, 30.0]
    away = {row['variant']: row for row in content['follows']}
    assert set(away) == set(variants.VARIANTS)
    assert away['shifted']['largest_m'] < 0.005
    # the earth, whose rotation strapdown knows of, is neither turned nor mirrored
    assert all(away[name]['rms_m'] < 0.1 * run['horizontal_rmse_m'] for name in ('turned', 'mirrored'))
    assert away['halved']['rms_m'] < 0.5 * run['horizontal_rmse_m']


def test_a_filter_that_knows_of_no_rotating_earth_follows_to_millimetres(prepared):
    some = replace(prepared, recordings={name: prepared.recordings[name] for name in ('full', 'turned', 'mirrored')})
    answers = bench.own_tracks(some, {'mechanization': 'planar'})
    follows = bench.score('planar', some, answers).follows
    assert follows['turned'][1] < 0.005 and follows['mirrored'][1] < 0.005


def test_an_own_filter_that_does_not_start_is_one_line(prepared, monkeypatch):
    # given no fix that could be used
    monkeypatch.setattr(bench, 'fixes_apart', lambda fixes, interval: np.empty(0, int))
    # when this package's filter is measured, then the bench says so
    with pytest.raises(bench.BenchError, match=f'^{bench.FULL}: the filter does not start'):
        bench.own_tracks(replace(prepared, recordings={bench.FULL: prepared.recordings[bench.FULL]}), {})


def test_the_check_sees_a_filter_that_does_not_follow(prepared):
    """One that mixes up east and west is right in no mirror."""
    truth = perfect(prepared)
    answers = {'full': truth, **dict.fromkeys(variants.VARIANTS, truth)}
    follows = bench.score('blind', prepared, answers).follows
    assert follows['turned'][0] > 10 and follows['mirrored'][0] > 10


def test_a_mirrored_sensor_measures_what_a_mirrored_drive_shows():
    """Independent of the formula: the simulated drive with left and right swapped, through the same sensors."""
    rng = np.random.default_rng(1)
    imu_force, imu_rate = rng.standard_normal((2, 10, 3))
    from mems_ins_fusion.samples import Fixes, ImuSamples, Recording

    stamp = np.arange(10) * 10**8
    fixes = Fixes(stamp, stamp, np.full(10, 0.8), 0.2 + 1e-6 * np.arange(10.0), np.zeros(10), np.tile(
        np.diag([1.0, 4.0, 9.0]), (10, 1, 1)), np.zeros(10, np.int8), np.full(10, 2, np.uint8))
    recording = Recording('x', ImuSamples(stamp, stamp, imu_force, imu_rate), fixes)
    values = table.check({'imu.mounting_rpy': [0.0, 0.0, 0.0]})
    seen = variants.mirrored(recording, values, (0.8, 0.2, 0.0))
    # forward-left-up: left turns into right; roll and yaw rates change their sign, the pitch rate does not
    assert np.allclose(seen.imu.specific_force, imu_force * [1, -1, 1])
    assert np.allclose(seen.imu.angular_rate, imu_rate * [-1, 1, -1])
    assert np.allclose(seen.gnss.longitude - 0.2, 0.2 - fixes.longitude, atol=1e-12)
    turned = variants.turned(recording, values, (0.8, 0.2, 0.0))
    assert np.allclose(np.diagonal(turned.gnss.covariance, 0, 1, 2), [4.0, 1.0, 9.0])


@pytest.mark.parametrize(['words', 'told'], [
    (('nowhere', '--params-file', 'p.yaml', '--output', 'x'), 'is not what bench prepare writes'),
    (('bench', '--output', 'x'), 'no filter to measure'),
    (('bench', '--filter', 'ekf', '--output', 'x'), '--filter must be NAME=FOLDER'),
    (('bench', '--filter', 'ekf=none', '--output', 'x'), 'is not a folder with answers'),
    (('bench', '--filter', 'ekf=drive', '--output', 'x'), 'holds no answer to full')])
def test_wrong_use_is_one_line(place, words, told, capsys, monkeypatch):
    monkeypatch.chdir(place)
    assert tool(['bench', *words]) == 2
    said = capsys.readouterr().err
    assert told in said and len(said.splitlines()) == 1
