"""Recordings of absurd but well-formed content, each of which once ended a tool. More of them: studies/fuzz.py."""
from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import fuzz_recordings
import numpy as np
import pytest
from fuzz_support import outcome

from mems_ins_fusion.configuration.check import compare_mounting
from mems_ins_fusion.configuration.configure import Setting, _possible, evidence_of_recording
from mems_ins_fusion.configuration.mounting import deviation
from mems_ins_fusion.diagnosis import candidate_proof
from mems_ins_fusion.diagnosis.error_changes import larger_errors
from mems_ins_fusion.diagnosis.fit import FittedModel, _finite
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.metrics import summary, turning_at
from mems_ins_fusion.evaluation.outages import _fitting
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.recordings.checker import ERROR, check_recording
from mems_ins_fusion.results import json_text

CONTENTS = pytest.mark.parametrize('content', list(fuzz_recordings.KNOWN))


@pytest.fixture(scope='module')
def good():
    return fuzz_recordings.drive('car')


@CONTENTS
def test_who_looks_at_raw_samples_survives(good, content):
    recording = fuzz_recordings.in_order(fuzz_recordings.KNOWN[content](good))
    findings = check_recording(recording)
    assert all(np.isfinite(v) for f in findings for v in f.values.values() if isinstance(v, float)), findings
    compare_mounting(recording.imu, recording.gnss, table.defaults())
    turning_at(recording.imu, np.eye(6), good.gnss.stamp)


@pytest.mark.parametrize('content', ['a dead IMU', 'dead accelerometers', 'dead gyroscopes', 'a constant IMU'])
def test_a_dead_sensor_is_an_error_of_the_recording(good, content):
    findings = check_recording(fuzz_recordings.KNOWN[content](good))
    assert any(f.severity == ERROR and f.topic == 'imu' for f in findings)


def test_one_absurd_sample_is_said_and_changes_nothing_else(good):
    spoiled = check_recording(fuzz_recordings.KNOWN['one sample of 1e300'](good))
    said = [f.message for f in spoiled]
    assert any('1 sample beyond what an IMU delivers (up to 1e+300)' in text for text in said)
    clean = {f.message for f in check_recording(good) if 'IMU' not in f.message}
    assert len(clean & set(said)) >= len(clean) - 3  # those with a mean over all samples differ in a digit


@pytest.mark.parametrize('content, status', [
    ('one sample of 1e300', 0), ('dead accelerometers', 2), ('dead gyroscopes', 2), ('constant accelerometers', 0),
    ('each sample twice', 0), ('one stamp of 1970', 0), ('the first stamp a day early', 0)])
def test_configure(tmp_path, good, content, status):
    bag = fuzz_recordings.written(fuzz_recordings.KNOWN[content](good), tmp_path / 'bag')
    found = outcome(lambda: fuzz_recordings.use('configure', bag, tmp_path, False))
    assert not found.complaint() and found.status == status, found
    if status == 0:  # what it writes can be loaded
        assert params_file.load_yaml(tmp_path / 'found.yaml')['imu_topic'] == '/imu/data'
    else:
        assert 'has no samples that could be used' in found.said


def test_gaps_of_imu_and_fixes_in_turn_are_no_mounting(good):
    # given 12 s of samples, and fixes of which a few are among them, in turn
    imu, gnss = good.imu, good.gnss
    part, part_fix = ((samples.stamp - imu.stamp[0]) % (24 * 10**9) / 24e9 for samples in (imu, gnss))
    left = replace(good, imu=imu.select(part < 0.5), gnss=gnss.select(part_fix > 0.25))
    # then what is told of the mounting is near to what the whole drive tells, or nothing is told
    whole, found = (evidence_of_recording(r.name, r.imu, r.gnss).mounting for r in (good, left))
    assert whole.yaw_known
    away = deviation(found.rotation, whole.rotation)[:3 if found.yaw_known else 2]
    assert np.all(np.abs(away) < 3.0 * np.hypot(found.sigma, whole.sigma)[:len(away)])
    # and a filter with that starts
    values = table.check({'imu.mounting_rpy': found.rpy.tolist()})
    assert len(run(FilterConfig.from_parameters(values), left.imu, left.gnss).stamp) > 100


def test_configure_sets_nothing_that_no_vehicle_has():
    settings, beyond = _possible([Setting('vehicle.still_rate', 0.0, ()), Setting('vehicle.still_rate', 0.01, ()),
                                  Setting('gyroscope.bias', [1e6, 0.0, 0.0], ())])
    assert [s.value for s in settings] == [0.01]
    assert 'vehicle.still_rate' in beyond[0] and 'gyroscope.bias' in beyond[1]


@pytest.mark.parametrize('content', ['one sample of 1e300', 'fixes that have teleported', 'constant accelerometers'])
def test_replay(tmp_path, good, content):
    bag = fuzz_recordings.written(fuzz_recordings.KNOWN[content](good), tmp_path / 'bag')
    found = outcome(lambda: fuzz_recordings.use('replay', bag, tmp_path, False), 120)
    assert not found.complaint(120), found


# -- parts of a diagnosis ----------------------------------------------------------------------------------------------

def test_a_run_that_never_starts_has_no_outages():
    class Nothing:
        stamp = begin = np.empty(0, dtype=np.int64)

    assert _fitting(10.0, Nothing(), [], [], Nothing()) == []


def test_a_correction_with_which_the_filter_does_not_run_is_no_correction():
    ran = {'what': 'outages of 10 s', 'count': 0, 'kept': 0.0, 'decides': True}
    assert 'the filter runs in 0 %' in larger_errors([ran])
    assert larger_errors([{**ran, 'kept': 1.0}]) == ''


def test_slopes_beyond_all_numbers_count_for_nothing():
    assert _finite(np.array([1.0, np.nan, np.inf, -1e200, -3.0])).tolist() == [1.0, 0.0, 0.0, 0.0, -3.0]


def test_an_effect_that_has_lost_its_axes_is_refined_without_them(monkeypatch):
    """`prune` has removed the axis: there is nothing left whose time constant could be fitted."""
    effect, fitted = EFFECTS['gyroscope_warm_up'], []

    class Problem:
        mask = np.ones(3, dtype=bool)
        attitude = None

    known = SimpleNamespace(model=SimpleNamespace(unknowns=[]), problem=Problem())
    axes = candidate_proof.effect_unknowns(effect, dict(effect.tried[0]), None)

    def fit(problem, unknowns, x, iterations):
        assert len(unknowns) == len(x)
        fitted.append([u.name for u in unknowns])
        return FittedModel(problem, unknowns, np.asarray(x), np.eye(len(x)), None, None)

    monkeypatch.setattr(candidate_proof, 'fit', fit)
    monkeypatch.setattr(candidate_proof, 'also_determined', lambda *arguments: [])
    monkeypatch.setattr(FittedModel, 'likelihood', lambda self, mask: 0.0)
    monkeypatch.setattr(FittedModel, 'sigma', lambda self: np.ones(len(self.x)))
    monkeypatch.setattr(candidate_proof, 'certainly_better', lambda one, other, gain: False)
    monkeypatch.setattr(FittedModel, 'moved', lambda self: self.problem)
    candidate = SimpleNamespace(effect=effect, fixed=dict(effect.tried[0]), undetermined={})
    whole = FittedModel(Problem(), axes, np.full(len(axes), 0.1), np.eye(len(axes)), None, None)
    candidate_proof._completed(known, candidate, whole)
    assert len(fitted) == len(effect.tried) and all(names[0] == axes[0].name for names in fitted)
    pruned = FittedModel(Problem(), [], np.empty(0), np.empty((0, 0)), None, None)
    assert candidate_proof._completed(known, candidate, pruned) == (pruned, {}) and len(fitted) == len(effect.tried)


# -- numbers that are none ---------------------------------------------------------------------------------------------

def test_a_number_that_is_none_is_null_in_a_report():
    content = {'a': [1.0, float('nan')], 'b': {'c': float('-inf'), 'd': np.float64('nan')}, 'e': (2, True, 'x', None)}
    assert json.loads(json_text(content)) == {'a': [1.0, None], 'b': {'c': None, 'd': None}, 'e': [2, True, 'x', None]}


def test_an_interval_of_squares_does_not_begin_below_zero():
    from mems_ins_fusion.evaluation.metrics import Errors

    n = 400
    zeros, large = np.zeros(n), np.where(np.arange(n) == 0, 1e6, 1.0)
    errors = Errors(stamp=np.arange(n) * 10**9, north=large, **{name: zeros for name in (
        'east', 'along', 'cross', 'sigma', 'variance', 'nees', 'heading', 'speed')}, turning=zeros.astype(bool))
    interval = summary(errors)['horizontal_rmse_interval_m']
    assert interval is None or all(np.isfinite(interval))
