"""Sigmas of estimates whose information is in few blocks: against the true scatter over many draws."""
from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from mems_ins_fusion.configuration import regression
from mems_ins_fusion.configuration.regression import jackknife, moderated

BLOCKS, ROWS, DRAWS = 8, 20, 400  # of simulated data


def designed(turns: int, rng: np.random.Generator) -> np.ndarray:
    """(b, r, 2): the second column in all blocks, the first in `turns` of them only."""
    design = rng.standard_normal((BLOCKS, ROWS, 2))
    design[turns:, :, 0] = 0.0
    return design


def estimated(design: np.ndarray, values: np.ndarray, prior: np.ndarray):
    """Solution and solutions with one block left out, each of (..., r) `values`; information of the blocks."""
    each = np.einsum('bri,brj->bij', design, design)
    right = np.einsum('bri,br->bi', design, values)
    total = each.sum(axis=0) + np.diag(prior)
    left_out = np.linalg.solve(total - each, (right.sum(axis=0) - right)[..., None])[..., 0]
    return np.linalg.solve(total, right.sum(axis=0)), left_out, each


def drawn(turns: int, common: float, prior: np.ndarray, draws: int = DRAWS):
    """Errors (d, 2), sigmas (d, 2) and the jackknife's (d, 2). common: sigma of an error that a block's rows share,
    along what they show, in sigmas of what the model expects of it."""
    rng = np.random.default_rng(11)
    design, rows = designed(turns, rng), []
    for _ in range(draws):
        shared = common * rng.standard_normal((BLOCKS, 2)) / np.sqrt(ROWS)
        values = rng.standard_normal((BLOCKS, ROWS)) + np.einsum('bri,bi->br', design, shared)
        solution, left_out, each = estimated(design, values, prior)
        rows.append((solution, moderated(left_out, each, prior, 1.0), jackknife(left_out)))
    return np.array(rows).swapaxes(0, 1)


@pytest.mark.parametrize('turns', [2, 8])
def test_a_right_model_is_believed_where_few_blocks_show_an_unknown(turns):
    # given noise as the model says, and an unknown that two of eight blocks show, or all
    errors, sigmas, by_jackknife = (part[:, 0] for part in drawn(turns, 0.0, np.full(2, 1e-6)))
    # then the sigma is the true one but for its widening, and hardly scatters, where the jackknife does
    assert np.sqrt(np.mean(sigmas**2)) == pytest.approx(errors.std(), rel=0.15)
    assert np.log(sigmas).std() < 0.2
    assert turns == 8 or np.log(by_jackknife).std() > 0.4
    assert 0.93 < np.mean(np.abs(errors) < 2.0 * sigmas) < 0.985


@pytest.mark.parametrize('turns', [3, 8])
def test_the_jackknife_counts_by_its_expectation_and_its_degrees_of_freedom(turns, monkeypatch):
    # given that the model's variance counts for nothing beside the jackknife's
    monkeypatch.setattr(regression, 'MODEL_FREEDOM', 0.0)
    errors, sigmas, _ = (part[:, 0] for part in drawn(turns, 0.0, np.full(2, 1e-6), 3000))
    # then squared sigmas are those of the errors in the mean, widened as by Student's distribution with as many degrees
    # of freedom as their scatter shows
    squared = sigmas**2
    freedom = 2.0 * squared.mean()**2 / squared.var()
    assert freedom < turns + 1.0
    widened = stats.t(freedom).ppf(stats.norm.cdf(2.0)) / 2.0
    assert np.sqrt(squared.mean()) / widened == pytest.approx(errors.std(), rel=0.05)


def test_what_many_blocks_contradict_is_not_believed():
    # given errors that the rows of a block have in common: true sigmas are three times the model's
    errors, sigmas, _ = (part[:, 1] for part in drawn(2, 8.0**0.5, np.full(2, 1e-6)))
    by_model = drawn(2, 0.0, np.full(2, 1e-6))[0][:, 1].std()
    assert errors.std() == pytest.approx(3.0 * by_model, rel=0.15)
    # then the sigma is most of the way from one to the other
    assert 1.7 * by_model < np.median(sigmas) < errors.std()


def test_what_no_block_shows_has_the_sigma_of_its_prior():
    rng = np.random.default_rng(5)
    design = designed(0, rng)
    _, left_out, each = estimated(design, rng.standard_normal((BLOCKS, ROWS)), np.array([0.25, 1e-6]))
    assert moderated(left_out, each, np.array([0.25, 1e-6]), 4.0)[0] == pytest.approx(2.0 * 2.0)
