"""A covariance that belongs to another epoch than the fix in its message."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.checker import check_recording
from mems_ins_fusion.recordings.claims import misplaced_covariances
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording


def drive(rate, seed, sigmas=(0.02, 1.5), factor=1.0, lasts=12.0):
    """Five minutes in which the receiver changes between two sigmas, about each `lasts` s; it claims them times
    `factor`."""
    made = simulate_recording(simulate_drive(300.0, seed, 50.0), SensorErrors.from_parameters(
        table.defaults(), 'gauss_markov'), GnssNoise(1e-3, rate), seed=seed).recording
    rng, fixes = np.random.default_rng(seed), made.gnss
    which = np.cumsum(rng.random(len(fixes)) < 1.0 / (lasts * rate)) % 2
    sigma = np.array(sigmas)[which]
    north, east = sigma * rng.standard_normal((2, len(fixes)))
    meridian, vertical = radii(fixes.latitude)
    covariance = (factor * sigma[:, None, None]) ** 2 * np.eye(3)
    return replace(made, gnss=replace(fixes, latitude=fixes.latitude + north / meridian, longitude=(
        fixes.longitude + east / (vertical * np.cos(fixes.latitude))), covariance=covariance))


def shifted(made, late):
    """With each covariance in the message `late` behind that of its fix."""
    return replace(made, gnss=replace(made.gnss, covariance=np.roll(made.gnss.covariance, late, axis=0)))


@pytest.mark.parametrize('late', [-1, 1, 2])
@pytest.mark.parametrize(('rate', 'factor'), [(1.0, 1.0), (5.0, 0.4)])
def test_a_covariance_of_another_epoch_is_found_and_said(rate, factor, late):
    made = shifted(drive(rate, 3, factor=factor), late)
    assert misplaced_covariances(made.gnss).late == late
    said = [one for one in check_recording(made) if 'late_messages' in one.values]
    assert [one.severity for one in said] == ['warning'] and said[0].values['late_messages'] == late
    words = {-1: '1 message after', 1: '1 message before', 2: '2 messages before'}
    assert words[late] in said[0].message


@pytest.mark.parametrize('rate', [1.0, 5.0])
@pytest.mark.parametrize('sigmas', [(0.02, 1.5), (0.5, 0.5)])
def test_of_its_own_epoch_nothing_is_said(rate, sigmas):
    for seed in (11, 12, 13, 14):
        assert misplaced_covariances(drive(rate, seed, sigmas).gnss) is None
    # nor where the claims do not change, or there is too little
    assert misplaced_covariances(shifted(drive(rate, 11, (0.5, 0.5)), 1).gnss) is None
    assert misplaced_covariances(drive(rate, 11).gnss.select(np.arange(40))) is None
