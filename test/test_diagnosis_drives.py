"""Several drives of one vehicle, diagnosed together. Truth is what was simulated."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_support import PAPER

from mems_ins_fusion.diagnosis.diagnose import diagnose
from mems_ins_fusion.diagnosis.drives import Drives
from mems_ins_fusion.diagnosis.error_changes import objection
from mems_ins_fusion.diagnosis.fit import scores
from mems_ins_fusion.diagnosis.folds import part_masks
from mems_ins_fusion.diagnosis.held_out import HeldOut
from mems_ins_fusion.diagnosis.noise import noise_unknowns
from mems_ins_fusion.diagnosis.problem import Problem
from mems_ins_fusion.diagnosis.tracing import effect_unknowns
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.several import one_after_another, refuse_other_vehicles
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

VALUES = table.check({**PAPER, 'reference_lever_arm': [0.0, 0.0, 0.0]})
DEFAULT = table.check({'reference_lever_arm': [0.0, 0.0, 0.0]})
FEW = [EFFECTS[name] for name in ('gnss_time_offset', 'accelerometer_scale', 'gyroscope_scale')]
OUTAGES = {'durations': (10.0,), 'spacing': 40.0}


def drive(seed, offset=0.0, duration=200.0, sigma=0.5, name=None):
    sensors = SensorErrors.from_parameters(VALUES, VALUES['sensor_error_model'])
    effects = [(EFFECTS['gnss_time_offset'], {'time_offset': offset})] if offset else []
    recording = simulate_recording(simulate_drive(duration, seed, 25.0), sensors, GnssNoise(sigma=sigma), effects,
                                   seed=seed).recording
    return replace(recording, name=name or f'drive_{seed}')


def added(diagnosis):
    return [f for f in diagnosis.findings if f.added]


@pytest.fixture(scope='module')
def pair():
    return one_after_another([drive(1), drive(2)])


@pytest.fixture(scope='module', params=[VALUES, DEFAULT], ids=['planar', 'default'])
def problems(pair, request):
    return [Problem(recording, request.param) for recording in pair]


# the problem of several

def test_likelihood_and_scores_of_several_drives_are_the_sums_of_those_of_each(problems):
    # given a filter with a scale factor and other noise levels than the simulated ones
    both = Drives(problems)
    x = np.array([0.3, 0.1, -0.2, 0.02])

    def unknowns(problem):
        return [*noise_unknowns(problem), *effect_unknowns(EFFECTS['gyroscope_scale'], {})]
    at, found = scores(both, unknowns(both), x)
    alone = [scores(p, unknowns(p), x) for p in problems]
    # then nothing of one drive is in the other
    likelihood = [np.nansum(r.log_likelihood()[p.mask]) for p, (r, _) in zip(problems, alone)]
    assert np.nansum(at.log_likelihood()[both.mask]) == pytest.approx(sum(likelihood), rel=1e-12)
    gradient = sum(s.gradient(p.mask) for p, (_, s) in zip(problems, alone))
    assert found.gradient(both.mask) == pytest.approx(gradient, rel=1e-9)
    information = sum(s.information(p.mask) for p, (_, s) in zip(problems, alone))
    assert found.information(both.mask) == pytest.approx(information, rel=1e-9)


def test_all_runs_are_compared_by_the_residuals_of_the_filter_as_given(pair):
    # given a filter without the constraint of wheels, and one with it
    without = Problem(pair[0], table.check({'vehicle.non_holonomic': False}))
    fixed = Problem(pair[0], DEFAULT)
    assert fixed.counted[:, 1].sum() > 100 and not without.counted[:, 1].any()
    # then a run has no residual that the first filter does not have
    more = without.residual({**without.values, 'vehicle.non_holonomic': True}, without.recording)
    assert not np.isfinite(more.beside[:, 0])[~without.counted].any()
    # and one that it lacks counts as the others of its kind, here those of the second half
    assert not fixed.base.missing.any()
    late = replace(fixed.recording, imu=fixed.recording.imu.select(slice(len(fixed.recording.imu) // 2, None)))
    fewer = fixed.residual(fixed.values, late)
    lacking = fixed.counted[:, 1] & ~np.isfinite(fewer.beside[:, 0, 1])
    assert lacking.any() and fewer.missing[lacking].all()


def test_two_drives_are_held_out_in_parts_and_three_as_wholes(problems):
    two = Drives(problems)
    for part in part_masks(two):  # each part has something of each drive
        assert part[two.slices[0]].any() and part[two.slices[1]].any()
    three = Drives([*problems, problems[0]])
    shares = [[part[where].mean() for where in three.slices] for part in part_masks(Drives([*problems, problems[0]]))]
    assert len(part_masks(two)) == 4 and len(shares) == 3
    for problem in (two, three):
        together = np.sum(part_masks(problem), axis=0)
        assert together[problem.mask].min() >= 1 and not together[~problem.mask].any()


def test_drives_stand_one_after_another_and_keep_their_lengths():
    # given two drives whose stamps are the same, and whose names are
    first, second = drive(1, name='drive'), drive(2, name='drive')
    placed = one_after_another([first, second])
    assert placed[0].imu is first.imu and [r.name for r in placed] == ['drive', 'drive_2']
    assert placed[1].imu.stamp[0] > max(first.imu.stamp[-1], first.gnss.stamp[-1]) + 60 * 10**9
    for name in ('imu', 'gnss', 'reference'):
        old, new = getattr(second, name), getattr(placed[1], name)
        shift = placed[1].imu.stamp[0] - second.imu.stamp[0]
        assert (new.stamp - shift == old.stamp).all()
        assert not hasattr(old, 'received') or (new.received - shift == old.received).all()


@pytest.mark.parametrize('change, said', [
    (lambda r: r, 'holds the samples of'),
    (lambda r: replace(r, imu=r.imu.select(slice(None, None, 2))), '12.5 Hz and drive_1 one of 25 Hz'),
    (lambda r: replace(r, imu=replace(r.imu, specific_force=r.imu.specific_force * [1.0, -1.0, -1.0])),
     '-1) in the axes of the IMU in other and'),
])
def test_what_is_not_another_drive_of_the_same_vehicle_is_refused(change, said):
    first = drive(1)
    other = drive(1) if said.startswith('holds') else drive(2)
    with pytest.raises(RecordingError, match='other') as error:
        refuse_other_vehicles([first, replace(change(other), name='other')])
    assert said in str(error.value) and '\n' not in str(error.value)


def test_a_drive_that_loses_for_certain_is_named():
    proof = HeldOut(40.0, 1e-6, [], {'a': (90.0, 1.0), 'b': (-50.0, 1e-4)})
    assert objection(proof, []).startswith('b speaks against it (log likelihood -50.0')
    assert not objection(replace(proof, drives={'a': (45.0, 1.0), 'b': (-5.0, 0.2)}), [])


# the whole diagnosis

def test_an_effect_that_is_weak_in_each_drive_is_found_in_all_together():
    # given three short drives with fixes of 2 m that are stamped 0.2 s late
    drives = [drive(seed, offset=0.2, duration=150.0, sigma=2.0) for seed in (1, 2, 3)]
    values = {**VALUES, 'gnss.sigma': 2.0}
    # when one is diagnosed alone, then nothing is certain
    outages = {'durations': (10.0,), 'spacing': 15.0}  # more than two outages in a drive, of which one may be bad luck
    assert not added(diagnose(drives[0], values, effects=FEW, **outages))
    # when all are, it is, and each drive says its share
    result = diagnose(drives, values, effects=FEW, **outages)
    [finding] = added(result)
    assert finding.name == 'gnss_time_offset' and not finding.drives_contradict
    offset = finding.parameters['time_offset']
    assert abs(offset.value - 0.2) < 3 * offset.sigma < 0.2
    assert set(finding.drives) == {'drive_1', 'drive_2', 'drive_3'}
    for own in finding.drives.values():
        assert own['time_offset'].sigma > offset.sigma
        assert abs(own['time_offset'].value - 0.2) < 3.5 * own['time_offset'].sigma
    # and it is judged in each drive and in all
    assert result.changed and result.corrected['gnss.time_offset'] == pytest.approx(offset.value)
    assert [d.name for d in result.drives] == ['drive_1', 'drive_2', 'drive_3']
    rows = {row.get('drive') for row in result.comparison}
    assert rows == {None, 'drive_1', 'drive_2', 'drive_3'}
    counts = [len(d.after.continuous.horizontal) for d in result.drives]
    assert sum(counts) == len(result.after.continuous.horizontal) and min(counts) > 0


def test_what_one_drive_alone_has_is_told_and_not_added_for_all():
    # given drives of which one has a receiver whose stamps are late
    offsets = 0.0, 0.4, 0.0
    drives = [drive(seed, offset) for seed, offset in enumerate(offsets, 1)]
    result = diagnose(drives, VALUES, effects=FEW[:1], **OUTAGES)
    assert not added(result) and result.corrected['gnss.time_offset'] == 0.0
    # then it is told which one
    [finding] = [f for f in result.findings if f.name == 'gnss_time_offset']
    assert finding.drives_contradict and 'contradict each other' in finding.reason
    for own, offset in zip(finding.drives.values(), offsets):
        assert own['time_offset'].value == pytest.approx(offset, abs=0.1)


def test_a_drive_that_does_not_start_is_left_out_and_named():
    drives = [drive(1, 0.3), drive(2, 0.3, duration=30.0), drive(3, 0.3)]
    result = diagnose(drives, VALUES, effects=FEW[:1], **OUTAGES)
    assert list(result.left_out) == ['drive_2'] and 'did not start' in result.left_out['drive_2']
    assert [d.name for d in result.drives] == ['drive_1', 'drive_3']
    assert [f.name for f in added(result)] == ['gnss_time_offset']
