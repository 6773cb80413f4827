"""The statistics of the diagnosis, each against an independent formula, finite differences, a library or chance."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from filter_support import random_covariance
from scipy.signal import lfilter
from scipy.stats import chi2, ttest_1samp

from mems_ins_fusion.characterization.autocorrelation import ljung_box
from mems_ins_fusion.diagnosis import candidate_proof
from mems_ins_fusion.diagnosis.conclusion import (
    NOT_EACH,
    PREDICTS_WORSE,
    Correction,
    MeasuredCorrection,
    _as_measured,
    _chosen,
    _noise_remarks,
    _switched,
)
from mems_ins_fusion.diagnosis.detection import detect
from mems_ins_fusion.diagnosis.error_changes import (
    ONE_SIDED,
    candidates,
    compared,
    gain_proven,
    larger_errors,
    objection,
    objection_to_errors,
    predicted,
    verdict_on,
)
from mems_ins_fusion.diagnosis.estimate import Estimate, widened
from mems_ins_fusion.diagnosis.fit import FittedModel, Scores, fit, scores
from mems_ins_fusion.diagnosis.folds import part_masks
from mems_ins_fusion.diagnosis.held_out import HeldOut, certainly_better
from mems_ins_fusion.diagnosis.measured import MeasuredErrors, in_common
from mems_ins_fusion.diagnosis.noise_levels import choose, multiplied
from mems_ins_fusion.diagnosis.outliers import isolated
from mems_ins_fusion.diagnosis.plausible import implausible
from mems_ins_fusion.diagnosis.problem import Unknown
from mems_ins_fusion.diagnosis.residuals import Residual, lasting, tempered, whiten_matrix
from mems_ins_fusion.diagnosis.tracing import Candidate, _test, effect_unknowns, group
from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.intervals import effective_number
from mems_ins_fusion.evaluation.metrics import Errors
from mems_ins_fusion.evaluation.outages import Outages
from mems_ins_fusion.evaluation.verdict import Verdict, change_in_outages
from mems_ins_fusion.parameters import table

N = 400


class Made(Effect):
    """An effect of two parameters, for tests that bring their own derivatives."""

    name = 'made'
    parameters = (EffectParameter('a', '-', 1.0), EffectParameter('b', '-', 1.0))


def covariances(rng, n=N):
    return np.array([random_covariance(2, rng) for _ in range(n)])


def packed(s):
    return np.column_stack([s[:, 0, 0], s[:, 0, 1], s[:, 1, 1]])


def white(rng, n=N) -> Residual:
    """Innovations of a filter whose model is right."""
    s = covariances(rng, n)
    z = np.einsum('fij,fj->fi', np.linalg.cholesky(s), rng.standard_normal((n, 2)))
    return Residual(z, packed(s), rng.uniform(-3, 3, n), rng.standard_normal((n, 2)))


def test_whitening_is_by_cholesky_factors():
    rng = np.random.default_rng(1)
    residual, s, change = white(rng), None, covariances(rng)
    s = np.array([[[nn, ne], [ne, ee]] for nn, ne, ee in residual.s])
    inverse = np.linalg.inv(np.linalg.cholesky(s))
    assert np.allclose(residual.whitened(), np.einsum('fij,fj->fi', inverse, residual.z), rtol=1e-9, atol=1e-9)
    dense = inverse @ change @ inverse.transpose(0, 2, 1)
    assert np.allclose(whiten_matrix(residual.factors(), packed(change)), packed(dense), rtol=1e-8, atol=1e-8)
    nis = [z @ np.linalg.solve(m, z) for z, m in zip(residual.z, s)]
    assert np.allclose(residual.nis(), nis, rtol=1e-8)
    counted = [n if n < 9 else 9 * (1 + np.log(n / 9)) for n in nis]
    expected = -0.5 * (np.linalg.slogdet(s)[1] + counted)
    assert np.allclose(residual.log_likelihood(), expected, rtol=1e-8, atol=1e-8)


def test_a_filter_that_applies_a_constraint_more_often_is_not_more_likely():
    # given the velocities at standstills of one run, each of likelihood 3 and more, and of one that lacks some of them
    # and has others instead
    rng, n = np.random.default_rng(5), 200
    fixes = white(rng, n)
    beside = np.stack([0.02 * rng.standard_normal((n, 1)), np.full((n, 1), 0.02**2)], axis=1)
    there = np.zeros((n, 1), dtype=bool)
    there[20:80] = True
    lacks, more = np.arange(n) < 40, np.arange(n) >= 60

    def counted(seen):
        return replace(fixes, beside=np.where(seen[:, None, None], beside, np.nan)).counting(there)

    # then those that both have count as they are, one that is missing as the mean of the others of that run, and one
    # that the first run does not have counts nothing
    alone = fixes.log_likelihood()
    each = np.log(1 / 0.02) - 0.5 * tempered((beside[:, 0, 0] / 0.02) ** 2)
    whole, few, many = (counted(seen).log_likelihood() - alone for seen in (there[:, 0], ~lacks, more | there[:, 0]))
    assert np.allclose(whole, np.where(there[:, 0], each, 0.0)) and np.allclose(many, whole)
    assert np.allclose(few[40:80], each[40:80]) and np.allclose(few[20:40], each[40:80].mean())
    assert not few[:20].any() and not few[80:].any()


def test_along_and_across_is_the_same_in_turned_axes():
    residual = white(np.random.default_rng(2))
    for k, turned in enumerate(residual.along_across()):
        c, s = np.cos(residual.yaw[k]), np.sin(residual.yaw[k])
        to_track = np.array([[c, s], [-s, c]])
        nn, ne, ee = residual.s[k]
        factor = np.linalg.cholesky(to_track @ [[nn, ne], [ne, ee]] @ to_track.T)
        assert np.allclose(turned, np.linalg.solve(factor, to_track @ residual.z[k]), rtol=1e-8, atol=1e-8)
    assert np.allclose((residual.along_across() ** 2).sum(axis=1), residual.nis(), rtol=1e-8)


def made_innovations(rng):
    """z and S as smooth functions of two unknowns; S(x) = S_0 exp(a x) and some off the diagonal."""
    base, slope, curve = white(rng), rng.standard_normal((N, 2, 2)), rng.standard_normal((N, 2))
    growth = 0.3 * rng.standard_normal((N, 2))
    # and numbers of their own beside the fixes, some not there
    number, move, grow = rng.standard_normal((3, N, 3))
    number[::4] *= 6.0  # beyond the tail
    number[:, 1][missing := rng.uniform(size=N) < 0.3] = np.nan
    grow[missing, 1] = np.nan

    def at(x):
        z = base.z + slope @ x + curve * x[0] * x[1]
        s = base.s * np.exp(growth @ x)[:, None] + np.array([0.1, 0.05, 0.2]) * (x[0] ** 2 + x[1])
        own = np.stack([number + move * x[0] + x[1] ** 2, np.exp(0.3 * grow * x[1]) + x[0] ** 2], axis=1)
        return Residual(z, s, base.yaw, base.velocity, own)
    return at


def unknown_size(step: float, **more) -> Unknown:
    """An unknown of the problems here, which bring their own innovations."""
    return Unknown('effect.size', lambda values, recording, x: (values, recording), 0.0, step, 10.0, **more)


def scores_at(at, x, step, mask) -> Scores:
    """The scores of innovations `at` a point, by each element of x."""
    problem = SimpleNamespace(mask=mask, residuals=lambda unknowns, points: [at(point) for point in points])
    return scores(problem, [unknown_size(step)] * len(x), x)[1]


def forward_scores(residual, moved, step, mask) -> Scores:
    """The scores of unknowns by which `residual` becomes each of `moved`."""
    problem = SimpleNamespace(mask=mask, residuals=lambda unknowns, points: list(moved))
    return scores(problem, [unknown_size(step, one_sided=True)] * len(moved), np.zeros(len(moved)), residual)[1]


def test_scores_are_the_derivatives_of_the_likelihood():
    # given innovations and covariances that depend on two unknowns, at a point that is no maximum
    at, x, step, mask = made_innovations(np.random.default_rng(3)), np.array([0.1, 0.2]), 1e-5, np.arange(N) >= 50
    ends = [[at(x + sign * step * axis) for sign in (1, -1)] for axis in np.eye(2)]
    found = scores_at(at, x, step, mask)
    # then each fix's score is the difference of its likelihoods, and zero outside the mask
    expected = np.stack([(plus.log_likelihood() - minus.log_likelihood()) / (2 * step) for plus, minus in ends], axis=1)
    assert np.allclose(found.score[mask], expected[mask], rtol=1e-5, atol=1e-5)
    assert not found.score[~mask].any() and not found.sensitivity[~mask].any()
    assert np.allclose(found.gradient(mask), expected[mask].sum(axis=0), rtol=1e-6)


def test_the_information_is_that_of_the_dense_formula():
    at, x, step = made_innovations(np.random.default_rng(4)), np.array([0.1, 0.2]), 1e-5
    ends = [[at(x + sign * step * axis) for sign in (1, -1)] for axis in np.eye(2)]
    mask = np.ones(N, dtype=bool)
    found = scores_at(at, x, step, mask).information(mask)
    expected = np.zeros((2, 2))
    for k in range(N):
        inverse = np.linalg.inv(unpacked(at(x).s[k]))
        dz = [(plus.z[k] - minus.z[k]) / (2 * step) for plus, minus in ends]
        ds = [(unpacked(plus.s[k]) - unpacked(minus.s[k])) / (2 * step) for plus, minus in ends]
        weight = min(1.0, 9 / (at(x).z[k] @ inverse @ at(x).z[k]))  # of a fix that is off
        expected += weight * np.array([[dz[i] @ inverse @ dz[j] + 0.5 * np.trace(inverse @ ds[i] @ inverse @ ds[j])
                                        for j in range(2)] for i in range(2)])
        for z, variance, dz, ds in zip(*at(x).beside[k], *np.transpose(
                [(plus.beside[k] - minus.beside[k]) / (2 * step) for plus, minus in ends], (1, 2, 0))):
            if np.isfinite(z):
                expected += min(1.0, 9 * variance / z**2) * (np.outer(dz, dz) / variance
                                                             + 0.5 * np.outer(ds, ds) / variance**2)
    assert np.allclose(found, expected, rtol=1e-5)


def test_what_lasts_counts_for_less():
    # given white numbers, such that follow each other with 0.8 from one to the next, and a few
    rng = np.random.default_rng(12)
    variance = rng.uniform(0.5, 2.0, (20_000, 3))
    u = np.column_stack([rng.standard_normal(20_000), lfilter([0.6], [1.0, -0.8], rng.standard_normal(20_000)),
                         np.full(20_000, np.nan)])
    u[:30, 2], u[::7, 1] = 1.0, np.nan
    # then they are worth what the spectrum at zero says: (1 + 0.8) / (1 - 0.8)
    found = lasting(np.stack([np.sqrt(variance) * u, variance], axis=1), np.ones(20_000, dtype=bool))
    assert found == pytest.approx([1.0, 9.0, 1.0], rel=0.1)


def unpacked(s):
    return np.array([[s[0], s[1]], [s[1], s[2]]])


@pytest.mark.parametrize('n', [40, 100, 1000])
def test_ljung_box_is_that_of_statsmodels(n):
    diagnostic = pytest.importorskip('statsmodels.stats.diagnostic', reason='statsmodels, the judge, is not installed')

    rng = np.random.default_rng(n)
    noise = rng.standard_normal(n)
    for values in (noise, noise + 0.4 * np.roll(noise, 1) + 3.0):
        expected = diagnostic.acorr_ljungbox(values, lags=[min(10, n // 5)])['lb_pvalue'].iloc[0]
        assert ljung_box(values, 10) == pytest.approx(expected, rel=1e-6)


def test_detection_is_silent_when_the_model_is_right_and_says_what_is_wrong_when_not():
    # given 100 residuals of right models: each is called inconsistent by chance once in 50, at most
    mask = np.ones(N, dtype=bool)
    wrong = sum(not detect(white(np.random.default_rng(100 + k)), mask).consistent for k in range(100))
    assert wrong <= 2 + 3 * np.sqrt(2)
    # when they are too large, too small, of one sign, or follow each other
    good = white(np.random.default_rng(5))
    s = np.array([unpacked(row) for row in good.s])
    factor = np.linalg.cholesky(s)
    lasting, alternating = (good.whitened() + sign * np.roll(good.whitened(), 1, axis=0) for sign in (1, -1))

    def words(z):
        return ' '.join(detect(Residual(z, good.s, good.yaw, good.velocity), mask).words())
    assert 'as large as the filter expects (NIS' in words(1.5 * good.z)
    assert 'smaller than the filter expects' in words(0.7 * good.z)
    assert 'mean is not zero: north' in words(good.z + factor[:, :, 0] * 0.5)
    last, alternate = (words(np.einsum('fij,fj->fi', factor, z) / np.sqrt(2)) for z in (lasting, alternating))
    assert 'not white' in last and 'an error that lasts' in last and 'other sign' not in last
    assert 'not white' in alternate and 'follows the fixes too closely' in alternate and 'lasts' not in alternate
    assert words(good.z).startswith('The innovations are white')


def problem_of_fixes(n=600):
    problem = SimpleNamespace(stamp=1_700_000_000_000_000_000 + np.arange(n) * 10**9, mask=np.arange(n) >= 20)
    problem.each = (problem,)
    return problem


def synthetic(rng, n=N, theta=(0.0, 0.0)):
    """Residual, scores of two parameters that act on z with slow regressors, and scores of a noise level."""
    residual = white(rng, n)
    phase = rng.uniform(0, 2 * np.pi, (2, 2, 1))
    period = rng.uniform(15, 80, (2, 2, 1))
    regressors = np.sin(2 * np.pi * np.arange(n) / period + phase).transpose(2, 1, 0)  # (n, component, parameter)
    # innovations z - d(theta) are what the model expects: the effect's derivative is the regressor
    residual = Residual(residual.z + regressors @ theta, residual.s, residual.yaw, residual.velocity)

    def moved(z, s=None):
        return Residual(z, residual.s if s is None else s, residual.yaw, residual.velocity)
    mask = np.ones(n, dtype=bool)
    own = forward_scores(residual, [moved(residual.z - regressors[:, :, i]) for i in range(2)], 1.0, mask)
    level = forward_scores(residual, [moved(residual.z, 1.01 * residual.s)], 0.01, mask)
    return residual, own, level, mask


def score_test(rng, theta=(0.0, 0.0)) -> Candidate:
    _, own, level, mask = synthetic(rng, theta=theta)
    return _test(problem_of_fixes(N), Made(), effect_unknowns(Made(), {}), own, level, mask, {})


def test_the_score_test_keeps_its_level():
    # given 500 drives without the effect
    p = np.array([score_test(np.random.default_rng(1000 + k)).p for k in range(500)])
    # then p below 5 % is as rare as it says, not counting 3 sigma of chance; being the larger of two p it may be rarer
    for level in (0.01, 0.05, 0.2):
        share, sigma = np.mean(p < level), np.sqrt(level * (1 - level) / len(p))
        assert share <= level + 3 * sigma
        assert share >= level / 5 - 3 * sigma / 5
    assert np.mean(p < 0.2) > 0.05


def test_the_score_test_is_careful_where_innovations_follow_each_other():
    # given 300 drives without the effect, whose innovations follow each other: 0.9 of each is in the next, so at a
    # period of 60 fixes they have 9.5 times the power of white ones
    p = []
    for k in range(300):
        rng = np.random.default_rng(3000 + k)
        residual, _, level, mask = synthetic(rng)
        factor = np.linalg.cholesky([unpacked(row) for row in residual.s])
        lasting = lfilter([np.sqrt(0.19)], [1.0, -0.9], rng.standard_normal((N, 2)), axis=0)
        z = np.einsum('fij,fj->fi', factor, lasting)
        slow = np.sin(2 * np.pi * np.arange(N) / 60.0)[:, None]
        coloured = Residual(z, residual.s, residual.yaw, residual.velocity)
        moved = Residual(z - slow, residual.s, residual.yaw, residual.velocity)
        own = forward_scores(coloured, [moved], 1.0, mask)
        p.append(_test(problem_of_fixes(N), Made(), effect_unknowns(Made(), {})[:1], own, level, mask, {}).p)
        naive = own.gradient(mask)[0] ** 2 / own.information(mask)[0, 0]
        p[-1] = p[-1], chi2.sf(naive, 1)
    careful, naive = np.array(p).T
    # then what would be found for certain in many of them is found in few
    assert np.mean(naive < 1e-3) > 0.1 and np.mean(careful < 1e-3) < 0.02


def row(before, after, p=0.5, rms=(0.0, 0.0), within=(1.0, 1.0), count=20, decides=True):
    return {'what': 'outages of 30 s, mean largest error in m', 'before': before, 'after': after, 'p': p,
            'rms_before': rms[0], 'rms_after': rms[1], 'within_before': within[0], 'within_after': within[1],
            'count': count, 'apart': count, 'decides': decides}


def proven(rows):
    return not objection_to_errors(rows)


def test_what_speaks_against_an_effect():
    better, worse, alike = row(4.0, 2.0, 0.001), row(10.0, 12.0, 0.001), row(4.0, 4.05)
    sure, weak, none = (HeldOut(gain, p, []) for gain, p in ((20.0, 0.001), (5.0, 0.4), (-1.0, 0.6)))
    assert objection(sure, [better]) == objection(sure, [better, alike]) == objection(weak, [better]) == ''
    # nothing measured is no objection either
    assert objection(sure, []) == objection(sure, [{'what': 'outages of 60 s', 'count': 0, 'decides': True}]) == ''
    assert objection(sure, [better, worse]).startswith('the error grows: outages of 30 s, mean largest error in m, 10')
    # what is certain may grow by what a few dozen outages scatter by, what is likely may not
    likely, little = HeldOut(20.0, 0.1, []), HeldOut(10.0, 0.1, [])
    assert objection(sure, [row(4.0, 4.3)]) == '' and 'all in all it is 1.15 times' in objection(sure, [row(4.0, 4.6)])
    assert 'all in all it is 1.07 times' in objection(likely, [row(4.0, 4.3)])
    # the same error is none where the ellipse comes to hold it, a larger one is
    assert objection(likely, [row(4.0, 4.3, within=(0.6, 0.8))]) == ''
    assert objection(likely, [row(4.0, 4.3, within=(0.6, 0.61))])
    assert objection(sure, [row(1.0, 1.3, within=(0.6, 0.9))])
    # nor does an ellipse speak against an error that is plainly smaller: that is a matter of noise levels
    assert objection(sure, [row(4.0, 1.5, within=(0.97, 0.74))]) == ''
    assert 'ellipse' in objection(likely, [row(4.0, 3.2, within=(0.97, 0.74))])
    # nor against an effect that is certain
    assert objection(sure, [row(4.0, 3.2, within=(0.97, 0.74))]) == ''
    assert larger_errors([row(4.0, 1.5, within=(0.97, 0.74))])
    said = 'too small a gain on data it was not fitted to (log likelihood +5.0, p 0.4)'
    assert objection(weak, [alike]).startswith(said)
    assert objection(little, [alike]).startswith('too small') and objection(likely, [alike]) == ''
    assert objection(none, [better]).startswith('no gain')
    # nor does a gain count of what is only there with all of the data
    assert 'without the one part' in objection(replace(sure, supported=0.5), [better])
    # an error that is a little smaller for certain proves nothing: whatever bends follows what is wrong a little
    assert objection(weak, [row(4.0, 3.8, 0.001)]).startswith('too small')


@pytest.mark.parametrize('rows, harmed', [
    ([row(10.0, 10.25, 0.0005)], False),  # a growth of two per cent, for certain
    ([row(0.005, 0.009, 0.0005)], False),  # millimetres
    ([row(10.0, 10.8, 0.0005)], True),
    ([row(10.0, 10.8, 0.4)], False),
    ([row(10.0, 11.5, 0.4)], True),  # too much, certain or not
    ([row(10.0, 9.0, 0.1, rms=(20.0, 26.0))], True),  # the mean shrinks, the tails do not
    ([row(10.0, 9.0, within=(0.95, 0.80))], True),
    ([row(10.0, 9.0, within=(0.60, 0.58))], False),
    ([row(10.0, 9.0, within=(0.60, 0.40))], True),
    ([row(10.0, 9.0, within=(1.0, 0.92))], False),
    ([row(1.0, 50.0, 0.0005, decides=False)], False),  # agreement with fixes that the filter was given
    ([row(4.0, 2.0), row(10.0, 30.0, 0.001)], True),
])
def test_what_is_harm(rows, harmed):
    assert bool(larger_errors(rows)) == harmed
    assert not (harmed and proven(rows))


def test_outages_that_overlap_are_not_each_a_proof():
    # given ellipses that miss five of 36 outages, these all apart, or of 60 s and begun every 20 s
    held = row(40.0, 30.0, within=(1.0, 31 / 36), count=36)
    assert 'ellipse' in larger_errors([held]) and not larger_errors([held | {'apart': 12}])
    # nor is one of five that is missed once more where two were missed already
    missed = row(40.0, 30.0, within=(0.6, 0.4), count=5)
    assert not larger_errors([missed]) and 'ellipse' in larger_errors([missed | {'within_after': 0.2}])
    # and where about the same errors come to be held in three of ten outages more, which may be one stretch of road
    healed = row(40.0, 42.0, within=(0.6, 0.9), count=10)
    assert proven([healed]) and not proven([healed | {'apart': 3}])


def overlapping(duration, spacing, count):
    begin = np.arange(count) * round(spacing * 1e9)
    there = np.ones(count)
    return MeasuredErrors(
        Errors(**dict.fromkeys(Errors.__dataclass_fields__, np.zeros(0))),
        [Outages(duration=duration, time=np.zeros(0), errors=[], begin=begin, max_error=there, distance=there,
                 within=there > 0, growth=there, sigma=there, kept=there, announced=there, crossed=there)], True,
        np.zeros(0), np.zeros(0))


def test_outages_apart_are_counted():
    one = overlapping(60.0, 20.0, 36)
    row = next(row for row in compared(one, one) if 'outages' in row['what'])
    assert row['count'] == 36 and row['apart'] == 12
    assert next(r for r in compared(*[overlapping(10.0, 20.0, 36)] * 2) if 'outages' in r['what'])['apart'] == 36


def test_means_before_and_after_are_of_the_same_outages():
    # given a filter that starts later, and so misses the first three outages, which were the largest, and ten epochs
    whole, late = overlapping(10.0, 20.0, 12), overlapping(10.0, 20.0, 12)
    whole.outages[0].max_error[:3] = 50.0
    late = replace(late, outages=[late.outages[0].select(np.arange(12) > 2)])
    epochs = Errors(**dict.fromkeys(Errors.__dataclass_fields__, np.arange(100)))
    whole, late = replace(whole, continuous=epochs), replace(late, continuous=epochs.select(np.arange(100) >= 10))
    # then both ways round, in single drives and without lateness, too, the same ones are left
    for one, other in ((whole, late), (late, whole)):
        found = in_common(*(replace(m, drives={'a': m}, without_offset=m) for m in (one, other)))
        for measured in (found, found.drives['a'], found.without_offset):
            assert len(measured.outages[0].begin) == 9 and measured.outages[0].max_error.mean() == 1.0
            assert measured.continuous.stamp.tolist() == list(range(10, 100))
    # and where one of them has no lateness of its own, neither is measured without it
    assert in_common(replace(whole, without_offset=whole), late).without_offset is None


def test_a_prediction_is_not_better_than_the_fix_it_is_judged_by():
    # given a filter that is right to a decimetre, and outages at whose end a fix of 1.5 m says where the vehicle is
    rng, count = np.random.default_rng(8), 300
    one = overlapping(10.0, 20.0, count)
    off = 1.5 * rng.standard_normal((count, 2))

    def merit(sigma):
        end = dict.fromkeys(Errors.__dataclass_fields__, np.zeros(1))
        errors = [Errors(**end | {'north': n, 'east': e, 'variance': np.array([sigma**2 + 1.5**2])})
                  for n, e in off[:, :, None]]
        found = replace(one, outages=[replace(one.outages[0], errors=errors)])
        return found.scores()[1][1].mean()
    # then who says so predicts as well as can be: the entropy of the fix, and worse who says a metre
    assert merit(0.1) == pytest.approx(-2 * np.log(1.5) - 1.0, abs=0.1)
    assert merit(0.1) > merit(1.0) > merit(3.0)


def test_an_effect_that_the_likelihood_has_proven_may_scatter_as_few_outages_do():
    # given errors that are larger by a seventh, which chance gives in two of five cases, in one of ten, in one of 50
    for p, harmed in ((0.4, False), (0.1, False), (0.02, True)):
        assert larger_errors([row(30.0, 34.0, p)]) and bool(larger_errors([row(30.0, 34.0, p)], effects=True)) == harmed
        tails = row(30.0, 30.0, rms=(50.0, 60.0)) | {'rms_p': p}
        assert larger_errors([tails]) and bool(larger_errors([tails], effects=True)) == harmed
    # where there are too few of them for a probability, their number tells
    few = row(30.0, 34.0, None, count=9)
    assert not larger_errors([few], effects=True) and larger_errors([few | {'count': 90, 'apart': 90}], effects=True)
    assert not larger_errors([few | {'count': 90}], effects=True)  # most of the 90 overlap
    assert larger_errors([row(30.0, 42.0, None, count=9)], effects=True)
    # and they have no say beside those that are enough
    assert proven([row(10.0, 9.0), row(30.0, 36.0, None, count=3)])
    assert not proven([row(30.0, 36.0, None, count=3)])
    assert not proven([row(10.0, 11.0), row(30.0, 20.0, None, count=3)])


@pytest.mark.parametrize('count', [2, 3])
def test_outages_too_few_for_a_test_seldom_speak_against_what_changes_nothing(count):
    # given two filters that err alike, and by half the same, in two or three outages
    rng, objections = np.random.default_rng(3), 0
    for _ in range(2000):
        common, own = rng.standard_normal((2, count)), rng.standard_normal((2, 2, count))
        old, new = (10.0 * np.hypot(*(np.sqrt(0.6) * common + np.sqrt(0.4) * one)) for one in own)
        objections += bool(larger_errors([row(old.mean(), new.mean(), None, count=count)], effects=True))
    # then little more often than the 5 % of a test; one standard deviation would be 20 %
    assert objections < 150


def test_errors_must_not_grow_with_what_the_likelihood_has_proven():
    # the fixes that are the truth may have it, too, so that errors do not shrink; but they must not grow
    assert proven([row(10.0, 10.0)]) and not proven([row(10.0, 10.5)])
    # an ellipse counts for less where errors are plainly smaller
    assert not proven([row(10.0, 9.0, within=(1.0, 0.8))])
    assert proven([row(10.0, 1.0, within=(1.0, 0.8))])
    assert not proven([row(10.0, 1.0, within=(1.0, 0.6))])
    # nor does a slightly larger error that ellipses come to hold
    assert proven([row(10.0, 10.5, within=(0.5, 0.95))])


def test_a_fix_that_is_far_off_counts_by_its_logarithm():
    nis = np.array([0.0, 4.0, 8.9999, 9.0001, 9.0 * np.e, 9.0 * np.e**5])
    assert np.allclose(tempered(nis), [0.0, 4.0, 9.0, 9.0, 18.0, 54.0], atol=1e-3)


def test_fixes_that_are_off_alone_are_told_from_a_lasting_misfit():
    z = np.zeros((20, 2))
    z[5], z[10:13] = 8.0, 8.0
    residual = Residual(z, np.tile([1.0, 0.0, 1.0], (20, 1)), np.zeros(20), np.zeros((20, 2)))
    assert np.flatnonzero(isolated(residual, np.ones(20, dtype=bool))).tolist() == [5]


def measured_with(score):
    """A `MeasuredErrors` as the search of noise levels sees it: 40 outages whose predictions have this likelihood."""
    stamp = np.arange(40)
    outages = SimpleNamespace(begin=stamp, apart=len(stamp))
    return SimpleNamespace(outages=[outages], scores=lambda: [(stamp, score(stamp))])


def test_noise_levels_are_chosen_by_predictions_of_parts_that_do_not_judge_them():
    # given a drive whose gyroscopes are ten times as noisy as configured, but for the last quarter, where all is right
    values = table.check({'vehicle.non_holonomic': False})

    def likelihood(configuration):
        k = np.log10(configuration['gyroscope.noise_density'][0] / values['gyroscope.noise_density'][0])
        other = np.log10(configuration['accelerometer.noise_density'][0] / values['accelerometer.noise_density'][0])
        return lambda stamp: np.where(stamp < 30, -3 * (k - 1) ** 2, -12 * k**2) - other**2
    found = choose(values, lambda all_of: [measured_with(likelihood(v)) for v in all_of], lambda stamp: stamp // 10, 4,
                   1.0)
    # then the whole drive chooses what suits it in the mean, the first three quarters what suits them
    assert found.factors['gyroscope.noise_density'] == pytest.approx(3.16)
    assert found.by_part[3]['gyroscope.noise_density'] == pytest.approx(10.0)
    assert all(factor == 1.0 for name, factor in found.factors.items() if name != 'gyroscope.noise_density')
    moved = multiplied(values, {'gnss.sigma': 3.16}, 0.5)
    assert moved['gnss.sigma'] == pytest.approx(1.58) and values['gnss.sigma'] == 0


def test_sensors_may_be_a_tenth_as_noisy_as_configured():
    # given predictions that are best with a thirtieth of the gyroscope's drift
    values = table.check({'vehicle.non_holonomic': False})

    def likelihood(configuration):
        k = np.log10(configuration['gyroscope.gauss_markov.sigma'][0] / values['gyroscope.gauss_markov.sigma'][0])
        return lambda stamp: 0.0 * stamp - 3 * (k + 1.5) ** 2
    found = choose(values, lambda all_of: [measured_with(likelihood(v)) for v in all_of], lambda stamp: stamp // 10, 4,
                   1.0)
    # then less than a tenth is not believed
    assert found.factors['gyroscope.gauss_markov.sigma'] == pytest.approx(0.1)


def test_a_constraint_is_never_stricter_than_configured():
    # given a drive that keeps to its lane three times as closely as the constraint asks
    def likelihood(configuration):
        k = np.log10(configuration['vehicle.non_holonomic_sigma'] / table.defaults()['vehicle.non_holonomic_sigma'])
        return lambda stamp: 0.0 * stamp - 12 * (k + 0.5) ** 2
    found = choose(table.defaults(), lambda all_of: [measured_with(likelihood(v)) for v in all_of],
                   lambda stamp: stamp // 10, 4, 1.0)
    assert set(found.factors.values()) == {1.0}


def test_a_level_that_makes_no_difference_stays_as_configured():
    found = choose(table.check({}), lambda all_of: [measured_with(lambda stamp: 0.0 * stamp) for _ in all_of],
                   lambda stamp: stamp // 10, 4, 1.0)
    assert set(found.factors.values()) == {1.0}


@pytest.mark.parametrize('switch', ['imu.adapt_noise', 'vehicle.zero_velocity'])
@pytest.mark.parametrize('is_on', [True, False])
@pytest.mark.parametrize('other, first', [(-1.5, True), (-2.95, False), (-4.0, False)])
def test_a_setting_is_the_other_way_round_only_where_that_predicts_better(other, first, is_on, switch):
    # given what was configured, an effect that predicts better, and how well it does so with a setting the other way
    # round: noise from the samples, or standstills that cannot be told from motion
    given = table.check({switch: is_on})
    correction = Correction({**given, 'gnss.time_offset': 0.3}, [{**given, 'gnss.time_offset': 0.3}], {}, True)

    def errors(models, full):
        merit = -5.0 if models[0]['gnss.time_offset'] == 0.0 else -3.0 if models[0][switch] == is_on else other
        return measured_with(lambda stamp: 0.0 * stamp + merit)
    found = _as_measured([correction, Correction(given, [given], {}, False)],
                         SimpleNamespace(errors=errors, switches=(switch,)))
    # then what predicts best stands first, if it is better by more than chance, and what was given last
    best = found[0].correction.values
    assert best['gnss.time_offset'] == 0.3 and (best[switch] != is_on) == first
    assert found[-1].correction.values == given
    assert _switched(given, best) == ({switch: not is_on} if first else {})
    # and it has to be better than the same without
    turned = next(one.correction for one in found if one.correction.values == {**correction.values, switch: not is_on})
    assert turned.beside == (correction,)


def test_effects_are_tried_without_the_noise_levels_that_came_with_them():
    # given effects that predict worse while decisions are made, so that only those with noise levels are left
    given = table.check({'imu.adapt_noise': False})
    late = {**given, 'gnss.time_offset': 0.2}
    effects = Correction(late, [late], {}, True)
    levelled = replace(effects, values={**late, 'gnss.sigma': 2.0}, by_part=[{**late, 'gnss.sigma': 2.0}],
                       factors={'gnss.sigma': 2.0}, beside=(effects,))
    trials = SimpleNamespace(errors=lambda models, full: measured_with(lambda stamp: 0.0 * stamp),
                             switches=())
    # then both are measured, each once, and what was given
    for options in ([levelled], [levelled, effects]):
        found = _as_measured([*options, Correction(given, [given], {}, False)], trials)
        assert [one.correction.values for one in found] == [levelled.values, late, given]


@pytest.mark.parametrize('answers, gain, chosen', [
    # effects alone, whose likelihood is proven: noise levels would hide them
    (['cannot_tell', 'better', 'same'], True, 0),
    (['cannot_tell', 'cannot_tell', 'same'], True, 0),
    # not where an error grows: then noise levels, if they have a gain of their own and no error grows
    (['worse', 'better', 'same'], True, 1),
    (['worse', 'cannot_tell', 'same'], True, 1),
    # else what was given
    (['worse', 'worse', 'same'], True, 2),
    (['worse', 'cannot_tell', 'same'], False, 2),
    (['worse', 'better', 'same'], False, 2),
])
def test_what_corrected_yaml_holds(answers, gain, chosen):
    # given effects alone, noise levels, and what was given, the best by prediction first; errors that are the same, but
    # for those without the noise levels
    given, one = table.check({}), outages_with(1.0)
    effects, noise = {**given, 'gnss.time_offset': 0.2}, {**given, 'gnss.sigma': 2.0}
    without, kept = outages_with(2.0) if gain else one, Correction(given, [given], {}, False)
    levels = Correction(noise, [noise], {'gnss.sigma': 2.0}, False, beside=(kept,))
    tried = [(MeasuredCorrection(Correction(effects, [effects], {}, True), one), Verdict(answers[0])),
             (MeasuredCorrection(levels, one, (without,)), Verdict(answers[1])),
             (MeasuredCorrection(kept, one), Verdict(answers[2]))]
    correction, _, verdict, _, _ = taken(tried, one, {})
    assert correction is tried[chosen][0].correction
    assert verdict.answer == answers[0 if chosen == 2 else chosen]  # or that on the best of what was tried


@pytest.mark.parametrize('first, second, named', [
    # the best predictions, and the next, with errors of so many m instead of one: what is named has smaller ones
    (0.9, 0.8, 0), (1.2, 0.8, 1), (1.2, 1.1, 0)])
def test_where_parameters_stay_what_is_named_makes_sense(first, second, named):
    given, one = table.check({}), outages_with(1.0)
    setting, noise = {**given, 'imu.adapt_noise': False}, {**given, 'gnss.sigma': 2.0}
    kept = Correction(given, [given], {}, False)

    def verdict(scale, answer='cannot_tell'):
        return Verdict(answer, (change_in_outages(30.0, np.ones(9), np.full(9, scale), 9),))
    # given that neither is proven
    tried = [(MeasuredCorrection(Correction(setting, [setting], {}, False, beside=(kept,)), one, (one,)),
              verdict(first)),
             (MeasuredCorrection(Correction(noise, [noise], {'gnss.sigma': 2.0}, False, beside=(kept,)), one, (one,)),
              verdict(second)), (MeasuredCorrection(kept, one), Verdict('same'))]
    correction, _, said, about, _ = taken(tried, one, {})
    assert correction is kept and about is tried[named][0] and said == tried[named][1]
    # and where errors are smaller with it for certain, but a part of it is not proven, it is not said to be better
    tried[named] = tried[named][0], verdict((first, second)[named], 'better')
    assert taken(tried, one, {})[2] == Verdict('cannot_tell', tried[named][1].changes, why=(NOT_EACH,))


def test_smaller_errors_go_before_better_predictions():
    # given a setting that predicts best, and noise levels with which errors are smaller for certain, both proven
    given = table.check({})
    setting, noise = {**given, 'imu.adapt_noise': False}, {**given, 'gnss.sigma': 2.0}
    unsure, honest, smaller = outages_with(1.0, 0.3), outages_with(1.0, 1.0), outages_with(0.5, 0.15)
    kept = Correction(given, [given], {}, False)
    tried = [(MeasuredCorrection(Correction(setting, [setting], {}, False, beside=(kept,)), honest, (unsure,)),
              Verdict('cannot_tell')),
             (MeasuredCorrection(Correction(noise, [noise], {'gnss.sigma': 2.0}, False, beside=(kept,)), smaller,
                                 (unsure,)),
              Verdict('better')),
             (MeasuredCorrection(kept, unsure), Verdict('same'))]
    # then these are in corrected.yaml, and the setting where there are no such levels
    assert taken(tried, unsure, {})[0].values == noise
    assert taken([tried[0], tried[2]], unsure, {})[0].values == setting


@pytest.mark.parametrize('alone, both, chosen', [
    # noise levels without a gain of their own, and effects without them with an error that grows: what was given is
    # worse for certain than both together
    ('worse', 'better', 'both'),
    # not where errors with both are not smaller for certain, and effects alone go before
    ('worse', 'cannot_tell', 'given'), ('cannot_tell', 'better', 'alone')])
def test_what_only_together_makes_errors_smaller_is_kept_together(alone, both, chosen):
    given, one = table.check({}), outages_with(1.0)
    late = {**given, 'gnss.time_offset': 0.2}
    effects = Correction(late, [late], {}, True)
    levelled = replace(effects, values={**late, 'gnss.sigma': 2.0}, factors={'gnss.sigma': 2.0}, beside=(effects,))
    options = {'both': levelled, 'alone': effects, 'given': Correction(given, [given], {}, False)}
    tried = [(MeasuredCorrection(levelled, one, (one,)), Verdict(both)),
             (MeasuredCorrection(effects, one), Verdict(alone)),
             (MeasuredCorrection(options['given'], one), Verdict('same'))]
    assert taken(tried, one, {})[0] is options[chosen]


@pytest.mark.parametrize('error, chosen', [(1.0, False), (1.5, True)])
def test_standstills_that_cannot_be_told_from_motion_need_a_proof_not_to_do_without(error, chosen):
    # given errors that are the same without standstills, or larger
    used, off = table.check({}), table.check({'vehicle.zero_velocity': False})
    kept = Correction(used, [used], {}, False)
    tried = [(MeasuredCorrection(kept.switched('vehicle.zero_velocity'), outages_with(error), (outages_with(1.0),)),
              Verdict('cannot_tell')), (MeasuredCorrection(kept, outages_with(1.0)), Verdict('same'))]
    assert tried[0][0].correction.values == off
    # then corrected.yaml does without them where it does no harm, if the recording asks for that
    found = taken(tried, outages_with(1.0), {'vehicle.zero_velocity': False})[0].values
    assert found['vehicle.zero_velocity'] == chosen
    # and else only with a proof
    assert taken(tried, outages_with(1.0), {})[0].values == used
    # the same beside an effect with which errors are a third, and which predicts best with them
    late = {**used, 'gnss.time_offset': 0.2}
    effect = Correction(late, [late], {}, True)
    tried = [(MeasuredCorrection(effect, outages_with(1.0)), Verdict('better')),
             (MeasuredCorrection(effect.switched('vehicle.zero_velocity'), outages_with(error), (outages_with(1.0),)),
              Verdict('better')), (MeasuredCorrection(kept, outages_with(3.0)), Verdict('same'))]
    found = taken(tried, outages_with(3.0), {'vehicle.zero_velocity': False})[0].values
    assert found == {**late, 'vehicle.zero_velocity': chosen}


@pytest.mark.parametrize('verdict', ['better', 'cannot_tell'])
def test_corrected_yaml_has_no_values_with_which_errors_are_larger_than_with_those_of_the_parts(verdict):
    # given an effect of which a recording tells a range: errors with the values of each part are the same or smaller,
    # those with the values of all data twice as large
    given, one = table.check({}), outages_with(1.0)
    wander = {**given, 'gnss.coloured_noise.sigma': 2.5}
    part = {**given, 'gnss.coloured_noise.sigma': 1.6}
    tried = [(MeasuredCorrection(Correction(wander, [part, part], {}, True), outages_with(0.9)), Verdict(verdict)),
             (MeasuredCorrection(Correction(given, [given], {}, False), one), Verdict('same'))]
    # then it is told, with the reason, and not set
    correction, *_, against = _chosen(tried, one, {}, lambda correction: outages_with(2.0))
    assert correction.values == given and 'grows' in against
    # and it is set where errors with the values of all data are as with those of the parts
    assert taken(tried, one, {})[0].values == wander


def test_effects_that_predict_worse_for_certain_are_told():
    # given effects with which errors are the same, and sigmas four times too large
    given, one = table.check({}), outages_with(1.0)
    late = {**given, 'gnss.time_offset': 0.2}
    tried = [(MeasuredCorrection(Correction(late, [late], {}, True), outages_with(1.0, 4.0)), Verdict('cannot_tell')),
             (MeasuredCorrection(Correction(given, [given], {}, False), one), Verdict('same'))]
    # then what was given stays, and the reason is said
    correction, *_, against = taken(tried, one, {})
    assert correction.values == given and against == PREDICTS_WORSE
    tried[0] = MeasuredCorrection(tried[0][0].correction, one), Verdict('cannot_tell')
    assert taken(tried, one, {})[0].values == late


def taken(tried, before, wanted):
    """What is chosen for corrected.yaml where its values make the errors of the parts."""
    return _chosen(tried, before, wanted, lambda correction: next(
        one.errors for one, _ in tried if one.correction is correction))


def outages_with(scale, sigma=1.0, count=36, largest=0.0, seed=1):
    """Outages of 10 s that end with errors of `scale` m on each axis, one of `largest` m; the filter says `sigma`."""
    error = scale * np.random.default_rng(seed).rayleigh(size=count)
    error[0] = max(error[0], largest)
    plain = overlapping(10.0, 20.0, count)
    ends = [SimpleNamespace(horizontal=[e], variance=[sigma**2]) for e in error]
    return replace(plain, outages=[replace(plain.outages[0], max_error=error, errors=ends,
                                           within=error**2 < chi2.ppf(0.95, 2) * sigma**2)])


@pytest.mark.parametrize('before, after, proven', [
    # errors that are smaller for certain, whatever the sigmas
    (outages_with(1.0), outages_with(0.5), True),
    # the same errors, and sigmas that come to be honest; or less so; or are the same
    (outages_with(1.0, 0.4), outages_with(1.0, 1.0), True),
    (outages_with(1.0, 1.0), outages_with(1.0, 0.4), False),
    (outages_with(1.0), outages_with(1.0), False),
    # honest sigmas of errors that are larger
    (outages_with(1.0, 0.4), outages_with(1.3, 1.3), False),
    # sigmas that a single outage asks for, and too few outages to say
    (outages_with(1.0, 1.0, largest=8.0), outages_with(1.0, 1.2, largest=8.0), False),
    (outages_with(1.0, 0.4, count=3), outages_with(1.0, 1.0, count=3), False),
])
def test_noise_levels_are_proven_by_smaller_errors_or_by_honest_sigmas(before, after, proven):
    assert gain_proven(before, after) == proven


def test_filters_that_are_tried_count_by_how_unlike_their_changes_are():
    # given outages of two durations, and three filters of which one begins later
    rng, begin = np.random.default_rng(3), np.arange(4000) * 10**10
    errors = 5.0 + rng.standard_normal((4, 4000))

    def measured(*each, first=0):
        return SimpleNamespace(outages=[SimpleNamespace(begin=begin[first:], max_error=one[first:]) for one in each])
    before = measured(0 * begin, 0 * begin)
    alike = [measured(errors[0], errors[0]), measured(errors[0], errors[0], first=7)]
    # then those that change the same outages in the same way are one, and unlike in one duration they are several
    assert candidates(before, alike) == pytest.approx(1.0)
    assert candidates(before, [*alike, measured(errors[0], errors[1])]) == pytest.approx(
        effective_number(errors[[0, 0, 1]]), abs=0.01)
    # those without an outage cannot be said to be alike
    assert candidates(SimpleNamespace(outages=[]), [measured(errors[0])] * 2) == 2


def test_what_is_predicted_better_is_the_mean_of_the_horizons():
    # given outages of two durations, one predicted better by one in log likelihood, give or take, the other as before
    rng, begin = np.random.default_rng(2), np.arange(30) * 10**10
    gain, none = 1.0 + rng.standard_normal((2, 30)), rng.standard_normal(30)

    def of(*scores):
        return SimpleNamespace(without_offset=None, outages=[SimpleNamespace(begin=begin, apart=30)] * 2,
                               scores=lambda: [
            (begin[:0], begin[:0]), *((begin, score) for score in scores)])
    # then each has one vote, and no more is certain than that both err together
    found = predicted(of(0 * none, none), of(gain[0], none))
    assert found.mean == pytest.approx(0.5 * gain[0].mean())
    found, one = predicted(of(0 * none, 0 * none), of(*gain)), predicted(of(none, none), of(none + gain[0], none))
    assert found.mean == pytest.approx(gain.mean())
    assert found.sigma == pytest.approx(gain.std(axis=1, ddof=1).mean() / np.sqrt(found.count), rel=0.2)
    assert one.sigma == pytest.approx(0.5 * gain[0].std(ddof=1) / np.sqrt(one.count), rel=0.2)
    # and a filter that never runs for so long cannot be compared
    assert predicted(of(none), of(none, none)) is None


@pytest.mark.parametrize('alike', [0.0, 0.7, 1.0])
def test_predictions_that_are_the_same_are_seldom_better_for_certain(alike):
    # given outages of three durations whose predictions differ by chance, more or less alike in all of them
    def of(scores):
        return SimpleNamespace(without_offset=None, outages=[SimpleNamespace(begin=s, apart=len(s)) for s in scores],
                               scores=lambda: [(np.zeros(0), np.zeros(0)), *((np.arange(len(s)), s) for s in scores)])
    proven = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        together = rng.standard_normal(24)
        gain = [np.sqrt(1 - alike**2) * rng.standard_normal(n) + alike * together[:n] for n in (24, 12, 6)]
        proven += predicted(of([0 * g for g in gain]), of(gain)).interval(ONE_SIDED)[0] > 0
    # then chance proves no more than 5 %
    assert proven < 30


@pytest.mark.parametrize('levelled, better', [(outages_with(0.9, seed=4), False), (outages_with(0.5), True)])
def test_noise_levels_count_by_their_own_gain_whether_the_offset_is_given_or_found(levelled, better):
    # given fixes that are late: errors of 5 m, 1 m with the offset, and by chance or for certain less with other
    # noise levels
    given, late, known = table.check({}), outages_with(5.0), outages_with(1.0)
    offset, noise = {**given, 'gnss.time_offset': 0.2}, {**given, 'gnss.time_offset': 0.2, 'gnss.sigma': 2.0}
    effects = Correction(offset, [offset], {}, True)
    both = Correction(noise, [noise], {'gnss.sigma': 2.0}, True, beside=(effects,))
    levels = Correction(noise, [noise], {'gnss.sigma': 2.0}, False, beside=(replace(effects, effects=False),))
    # when the offset is found, which both together prove, and when the params file has it already
    tried = [MeasuredCorrection(both, levelled, (known,)), MeasuredCorrection(effects, known),
             MeasuredCorrection(Correction(given, [given], {}, False), late)]
    found = taken([(t, verdict_on(late, t.errors, t.correction.effects)) for t in tried], late, {})
    tried = [MeasuredCorrection(levels, levelled, (known,)), MeasuredCorrection(replace(effects, effects=False), known)]
    after = taken([(t, verdict_on(known, t.errors)) for t in tried], known, {})
    # and when the offset alone is not proven
    alone = taken([(MeasuredCorrection(both, levelled, (known,)), Verdict('better')),
                   (MeasuredCorrection(effects, known), Verdict('worse')),
                   (MeasuredCorrection(Correction(given, [given], {}, False), late), Verdict('same'))], late, {})
    # then it is kept with the noise levels with which it is: what was given is worse for certain
    assert (alone[0].values, alone[2].answer) == (noise, 'better')
    # and else both ways end with the same parameters: with the noise levels that have a gain of their own
    assert found[0].values == after[0].values == (noise if better else offset)
    assert found[2].answer == 'better'


def test_what_cannot_be_is_told_with_what_it_stands_for():
    arm = {'z': Estimate(-20.2, 2.3, 'm'), 'x': Estimate(0.5, 0.1, 'm')}
    said = implausible('gnss_lever_arm', arm)
    assert said.startswith('z of -20.2 \N{PLUS-MINUS SIGN} 2.3 m is more than any vehicle')
    assert 'time offset' in implausible('gnss_lever_arm', arm)
    assert implausible('gnss_lever_arm', {'x': arm['x']}) == implausible('of_nobody', arm) == ''
    # an arm of 3 m can be, one that may be 3 m, too
    assert implausible('gnss_lever_arm', {'y': Estimate(-3.3, 0.2, 'm')})
    assert implausible('gnss_lever_arm', {'y': Estimate(-3.3, 0.8, 'm')}) == ''
    # what lasts for less than the time between fixes is no coloured noise
    # nor is an offset of an input whose clock shows another one; a clock that shows little denies nothing
    late = {'time_offset': Estimate(-0.15, 0.02, 's')}
    for value, sigma, denied in ((0.003, 0.012, True), (-0.12, 0.012, False), (0.1, 0.5, False), (0.0, np.inf, False)):
        clock = {'speed_time_offset.time_offset': Estimate(value, sigma, 's')}
        assert bool(implausible('speed_time_offset', late, clock)) is denied
    # that of the fixes is found together with arm and smoothing, which the track alone need not tell
    assert not implausible('gnss_time_offset', late, {'gnss_time_offset.time_offset': Estimate(0.003, 0.012, 's')})
    assert 'white' in implausible('gnss_coloured_noise', {'tau': Estimate(0.5, 0.2, 's')})
    assert implausible('gnss_coloured_noise', {'tau': Estimate(1.5, 0.2, 's')}) == ''
    assert implausible('gnss_coloured_noise', {'sigma': Estimate(0.5, 0.2, 'm')}) == ''


def test_a_sigma_holds_what_no_model_of_a_car_knows():
    # given an arm known to a centimetre by the innovations, and a ratio that was only tried
    arm = {'x': Estimate(3.0, 0.01, 'm'), 'y': Estimate(-4.0, 0.01, 'm'), 'scale': Estimate(0.1, None, '-')}
    found = widened(arm)
    # then each axis is uncertain by a part of its length, 5 m; what is large already stays
    assert found['x'].sigma == found['y'].sigma == pytest.approx(np.hypot(0.01, 0.25))
    assert found['scale'] == arm['scale'] and found['x'].value == 3.0
    assert widened({'x': Estimate(0.1, 1.0, 'm')})['x'].sigma == pytest.approx(1.0, rel=1e-3)


def test_what_is_refitted_to_a_part_stays_near_where_it_stands_for_a_size():
    variance = Unknown('receiver.sigma', None, 0.0, 0.1, 10.0, variance=True)
    factor = Unknown('receiver.tau', None, 0.0, 0.1, 1.5, factor_on=40.0)
    # half and twice the size: a quarter and four times its square; by what a factor's logarithm is
    assert np.allclose(variance.meant(np.array(variance.near(2.0))[1], 0.0)[0], 2 * np.sqrt(2.0))
    assert np.allclose(variance.near(2.0), (0.5, 8.0)) and variance.near(0.0) == (-np.inf, np.inf)
    assert np.allclose(np.exp(factor.near(0.3)), np.exp(0.3) * np.array([0.5, 2.0]))
    assert replace(variance, variance=False).near(2.0) == (-np.inf, np.inf)


def test_an_estimate_says_no_more_digits_than_it_knows():
    assert Estimate(0.26503, 0.0071, 's').text() == '0.2650 \N{PLUS-MINUS SIGN} 0.0071 s'
    assert Estimate(0.1, None, 'rad').text() == '0.1 rad, 5.73 deg'
    assert Estimate(None, None, 'm', (1.0, 3.0)).text() == '1 to 3 m'


def test_the_score_test_finds_what_is_there_with_its_size():
    theta = np.array([0.6, -0.4])
    candidates = [score_test(np.random.default_rng(2000 + k), theta) for k in range(60)]
    assert np.median([c.p for c in candidates]) < 1e-4
    errors = np.array([(c.theta - theta) / c.sigma for c in candidates]).ravel()
    # 120 errors of unit variance: mean within 3 / sqrt(120), mean square within 3 sqrt(2 / 120)
    assert abs(errors.mean()) < 3 / np.sqrt(120)
    assert abs(np.mean(errors**2) - 1) < 3 * np.sqrt(2 / 120)


def test_what_the_data_do_not_determine_gets_no_number():
    # given an effect of which only the first parameter touches the innovations
    _, own, level, mask = synthetic(np.random.default_rng(8))
    own = Scores(own.score * [1.0, 1e-4], own.sensitivity * np.array([1.0, 1e-4])[:, None])
    candidate = _test(problem_of_fixes(N), Made(), effect_unknowns(Made(), {}), own, level, mask, {})
    assert candidate.undetermined == ['b']
    assert [u.name for u in candidate.unknowns] == ['made.a'] and len(candidate.theta) == 1


def candidate_of(name: str, scores: Scores, mask) -> Candidate:
    effect = type(name, (Made,), {'name': name})()
    total, information = scores.gradient(mask), scores.information(mask)
    theta = np.linalg.solve(information, total)
    return Candidate(effect, [None] * len(theta), theta, np.ones(len(theta)), float(total @ theta), 1e-9, scores, [])


def test_effects_that_act_alike_are_one_group_and_others_are_not():
    _, own, _, mask = synthetic(np.random.default_rng(9), theta=(0.8, 0.6))
    one = Scores(own.score[:, :1], own.sensitivity[:, :1])
    parallel = Scores(-3 * one.score, -3 * one.sensitivity)
    other = Scores(own.score[:, 1:], own.sensitivity[:, 1:])
    winner = candidate_of('winner', one, mask)
    alike, different = candidate_of('alike', parallel, mask), candidate_of('different', other, mask)
    assert group(winner, [different, winner, alike], mask) == ['winner', 'alike']
    # and what is no finding itself is nobody's group
    assert group(winner, [different, winner, replace(alike, p=0.5)], mask) == ['winner']


def test_the_parts_held_out_share_the_fixes_out_in_blocks():
    problem = problem_of_fixes()
    masks = np.array(part_masks(problem))
    assert len(masks) == 4 and np.array_equal(masks.sum(axis=0), problem.mask)
    # 580 s in eight blocks, in turns
    whose = masks[:, problem.mask].argmax(axis=0)
    changes = np.flatnonzero(np.diff(whose)) + 1
    assert np.array_equal(changes, np.ceil(np.arange(1, 8) * 579 / 8))
    assert whose[[0, *changes]].tolist() == [0, 1, 2, 3, 0, 1, 2, 3]


class Jumping:
    """Innovations in proportion to x up to `at`, and metres more of it from there: another decision of the filter."""

    def __init__(self, at: float, fixes: int = 200):
        self.at, self.mask, self.stamp = at, np.ones(fixes, dtype=bool), np.arange(fixes) * 1_000_000_000
        self.noise = np.random.default_rng(3).standard_normal((fixes, 2))

    def residuals(self, unknowns, points):
        def one(x):
            z = self.noise + (x - 0.2) + 50.0 * (x > self.at)
            return Residual(z, np.tile([1.0, 0.0, 1.0], (len(z), 1)), np.zeros(len(z)), np.zeros_like(z))
        return [one(x) for [x] in points]


@pytest.mark.parametrize('at', [0.101, 0.125, 9.0])
def test_a_jump_of_the_innovations_is_no_slope(at):
    # given innovations of slope 1, and a decision of the filter that turns near where the fit begins, or nowhere near
    model = fit(Jumping(at), [unknown_size(0.05)], [0.1])
    # then the fit goes as far as it may, and is as sure as 200 fixes of a metre in two directions are
    assert model.x[0] == pytest.approx(min(at, 0.2), abs=0.1) and model.x[0] < at
    assert model.sigma()[0] == pytest.approx(1.0 / np.sqrt(400.0), rel=0.3)


def test_a_jump_of_few_innovations_does_not_stop_the_fit_of_a_noise_level():
    # given innovations twice as large as expected, and a noise level: the variances are e^(2 x) times as large. From
    # x = 1/3 on the filter decides otherwise, by which three of 200 innovations are 6 m larger
    rng = np.random.default_rng(5)
    z, jumping = 2.0 * rng.standard_normal((200, 2)), np.arange(200)[:, None] % 90 == 20

    def residuals(unknowns, points):
        return [Residual(z + 6.0 * np.sign(z) * (jumping & (x > 1 / 3)),
                         np.exp(2 * x) * np.tile([1.0, 0.0, 1.0], (200, 1)), np.zeros(200), np.zeros((200, 2)))
                for [x] in points]
    problem = SimpleNamespace(mask=np.ones(200, dtype=bool), residuals=residuals)
    # when it is fitted from a point whose difference reaches over the jump
    model = fit(problem, [unknown_size(0.05, noise=True, one_sided=True)], [0.3])
    # then it goes on to where they are as large as expected: at ln 2, or beyond it because of the larger ones
    assert np.log(2.0) - 0.1 < model.x[0] < np.log(2.0) + 0.25


def test_a_jump_of_one_innovation_is_no_slope_of_it():
    # given innovations of slope 1, one of which jumps by two standard deviations beside the point
    def at(x):
        z = np.full((N, 2), x[0])
        z[7] += 2.0 * (x[0] > 0.03)
        return Residual(z, np.tile([1.0, 0.0, 1.0], (N, 1)), np.zeros(N), np.zeros((N, 2)))
    found = scores_at(at, np.array([0.0]), 0.05, np.ones(N, dtype=bool))
    # then the information is that of the slope: one for each of two components
    assert found.information(np.ones(N, dtype=bool))[0, 0] == pytest.approx(2.0 * N)


@pytest.mark.parametrize('name, bounds, factor, said', [
    ('gyroscope.noise', (1 / 3, 10.0), 1 / 3, 'gyroscope.noise would have to be 0.33 times as large as configured, or'),
    ('gyroscope.noise', (1 / 3, 10.0), 0.34, 'gyroscope.noise would have to be 0.34 times as large as configured, or'),
    ('gnss.sigma', (1 / 3, 100.0), 1 / 3, 'gnss.sigma would have to be 0.33 times as large as configured, or smaller'),
    ('gyroscope.noise', (1 / 3, 10.0), 0.4, None), ('gyroscope.noise', (1 / 3, 10.0), 9.0, None),
    ('gyroscope.noise', (1 / 3, 10.0), 10.0, 'gyroscope.noise would have to be 10 times as large as configured to'),
    ('gnss.sigma', (1 / 3, 100.0), 100.0, None), ('vehicle.non_holonomic_sigma', (1.0, 10.0), 1.0, None)])
def test_a_noise_level_that_rests_on_a_bound_of_the_fit_is_said(name, bounds, factor, said):
    # given a level that a fit keeps between bounds, and one that is no noise level
    level = Unknown(name, None, 0.0, 0.05, 1.0, bounds=tuple(np.log(bounds)), noise=True)
    size = Unknown('effect.size', None, 0.0, 0.1, 1.0)
    model = SimpleNamespace(unknowns=[level, size], x=np.array([np.log(factor), 0.0]),
                            covariance=np.diag([0.04, 0.1]))
    # then the user is told at which bound it is, if any
    assert [text[:len(said or '')] for text in _noise_remarks(model, {})] == ([said] if said else [])


@pytest.mark.parametrize('factor, said', [(0.1, 'or smaller, to'), (0.316, None), (1.0, None), (10.0, 'No sensor')])
def test_of_a_level_that_was_chosen_the_bounds_are_those_of_the_choice(factor, said):
    # given a level at the lower bound of the fit, for which the user's filter asked for another factor
    level = Unknown('gyroscope.noise', None, 0.0, 0.05, 1.0, bounds=(np.log(1 / 3), np.log(10.0)),
                    noise=True)
    model = SimpleNamespace(unknowns=[level], x=np.array([np.log(1 / 3)]), covariance=np.array([[0.04]]))
    # then what is said is of that factor
    remarks = _noise_remarks(model, {'gyroscope.noise': factor})
    assert len(remarks) == (1 if said else 0) and all(said in text for text in remarks)


@pytest.mark.parametrize('count, said', [(0.3, 0), (0.6, 1), (200.0, 1)])
@pytest.mark.parametrize('name, by', [('gnss.sigma', 'gnss.adapt_sigma'), ('gyroscope.noise', 'at rest')])
def test_a_level_of_which_a_drive_tells_nothing_is_no_remark(name, by, count, said):
    # given a level with a prior of one e-fold, at its lower bound, of which the scatter of `count` values tells: the
    # logarithm of a standard deviation has a variance of 1 / (2 count) by them
    level = Unknown(name, None, 0.0, 0.05, 1.0, bounds=(np.log(1 / 3), np.log(10.0)), noise=True)
    covariance = np.array([[1.0 / (1.0 + 2.0 * count)]])
    # then it is said where the drive tells more of it than the prior, with what shows it
    remarks = _noise_remarks(SimpleNamespace(unknowns=[level], x=np.log([1 / 3]), covariance=covariance), {})
    assert len(remarks) == said and all(by in text for text in remarks)


@pytest.mark.parametrize('gains, better', [
    (np.full(300, 0.04), True), (np.full(300, 0.01), False),
    (np.where(np.arange(300) < 30, 0.4, 0.0), False), (np.where(np.arange(300) % 60 < 30, 0.2, -0.12), False)])
def test_a_fit_is_better_for_certain_only_if_it_is_in_most_of_the_drive(gains, better):
    # given two fits of ten blocks of 30 s, the likelihoods of whose innovations differ by so much at each fix
    rng = np.random.default_rng(11)
    gains = gains + 0.02 * rng.standard_normal(300)
    z = rng.standard_normal((300, 2))
    problem = SimpleNamespace(stamp=np.arange(300) * 1_000_000_000, mask=np.ones(300, dtype=bool), each=(None,))

    def model(more):
        unit = Residual(z, np.tile([1.0, 0.0, 1.0], (300, 1)), np.zeros(300), np.zeros((300, 2)))
        return SimpleNamespace(problem=problem, residual=replace(unit, missing=more))
    # then a sum that a few blocks make, or whose sign changes from block to block, is no certain one
    sums = gains.reshape(10, 30).sum(axis=1)
    expected = sums.sum() > 3.3 and ttest_1samp(sums, 0.0, alternative='greater').pvalue < 0.01
    assert certainly_better(model(gains), model(np.zeros(300)), 3.3) == expected == better
    assert not certainly_better(model(np.zeros(300)), model(gains), 3.3)


@pytest.mark.parametrize('begin, end', [(0, 300), (120, 150)])
def test_of_a_parameter_that_fits_equally_well_at_several_values_there_is_a_range(monkeypatch, begin, end):
    # given fits of coloured noise from each correlation time that is tried, of which that from 40 s explains the
    # innovations better by 12 in log likelihood: all over the drive, or in one block of 30 s
    effect, count = EFFECTS['gnss_coloured_noise'], 300
    rng = np.random.default_rng(19)
    problem = SimpleNamespace(stamp=np.arange(count) * 10**9, mask=np.ones(count, dtype=bool), each=(None,),
                              attitude=None)
    unit = Residual(rng.standard_normal((count, 2)), np.tile([1.0, 0.0, 1.0], (count, 1)), np.zeros(count),
                    np.zeros((count, 2)))
    there = (np.arange(count) >= begin) & (np.arange(count) < end)
    gains = np.where(there, 12.0 / (end - begin), 0.0) + 1e-3 * rng.standard_normal(count)
    alone = effect_unknowns(effect, effect.tried[0])
    nothing = Scores(np.zeros((count, 2)), np.zeros((count, 2, 5)))

    def fitted(problem, unknowns, x, iterations=0):
        best = unknowns[-1].factor_on == 40.0
        return FittedModel(problem, unknowns, np.asarray(x, dtype=float), np.eye(len(x)),
                           replace(unit, missing=gains) if best else unit, nothing)

    monkeypatch.setattr(candidate_proof, 'fit', fitted)
    known = SimpleNamespace(model=SimpleNamespace(unknowns=[]), problem=problem)
    # when the correlation time is estimated, too
    model, hidden = candidate_proof._refined(known, effect,
                                             FittedModel(problem, alone, np.ones(1), np.eye(1), unit, None))
    # then the best one is taken, and the range of all is told unless it is better for certain
    assert model.unknowns[-1].factor_on == 40.0
    assert hidden == ({} if end - begin == count else {
        'gnss_coloured_noise.tau': '10 to 1.6e+02 s explain the recording equally well'})


@pytest.mark.parametrize('sigma, said', [(0.02, True), (0.2, False)])
def test_a_value_beyond_the_interval_of_one_that_fits_as_well_makes_it_a_range(monkeypatch, sigma, said):
    # given three fits that explain the innovations equally well, with sizes of 0.9, 1 and 1.1 m and correlation times
    # of 40 s, and as sure of the size as `sigma` (m, at 1 m)
    effect, count = EFFECTS['gnss_coloured_noise'], 300
    problem = SimpleNamespace(stamp=np.arange(count) * 10**9, mask=np.ones(count, dtype=bool), each=(None,),
                              attitude=None)
    unit = Residual(np.ones((count, 2)), np.tile([1.0, 0.0, 1.0], (count, 1)), np.zeros(count), np.zeros((count, 2)))
    nothing = Scores(np.zeros((count, 2)), np.zeros((count, 2, 5)))
    sizes = {10.0: 1.0, 40.0: 0.9, 160.0: 1.1}  # the first is the best, as all are

    def fitted(problem, unknowns, x, iterations=0):
        start = unknowns[-1].factor_on
        return FittedModel(problem, unknowns, np.array([sizes[start]**2, np.log(40.0 / start)]),
                           np.diag([(2.0 * sigma)**2, 0.01]), unit, nothing)  # of a square: 2 x times that of x

    monkeypatch.setattr(candidate_proof, 'fit', fitted)
    known = SimpleNamespace(model=SimpleNamespace(unknowns=[]), problem=problem)
    alone = effect_unknowns(effect, effect.tried[0])
    # when it is told how well they are determined
    _, hidden = candidate_proof._refined(known, effect,
                                         FittedModel(problem, alone, np.ones(1), np.eye(1), unit, nothing))
    # then the size is a range where the interval of the best one does not hold the others
    assert hidden == ({'gnss_coloured_noise.sigma': '0.9 to 1.1 m explain the recording equally well'} if said else {})
