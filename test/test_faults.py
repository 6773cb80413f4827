"""Each fault of studies/faults.py on one realistic drive, parameters at their defaults: contained, said, forgotten."""
from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from mems_ins_fusion.evaluation.metrics import rms

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'studies'))
from faults import FAULTS, judged  # noqa: E402

SEED = 2001
#: quiet ones: a claim of sigma is not refused but outgrown, a height is refused alone, a frozen IMU may be at rest
UNSAID = {'nothing', 'claimed sigma a tenth of the true one', 'altitude 1000 m off for 10 s', 'IMU frozen for 5 s'}


@pytest.mark.parametrize('fault', FAULTS, ids=lambda fault: fault.name)
def test_a_fault_is_contained_said_and_forgotten(fault):
    # given a drive with the fault, without it, and without fixes while it lasts
    faulty, clean, coasting = judged(fault, SEED)

    def during(outcome):
        return outcome.error[(outcome.time >= 0) & (outcome.time <= fault.duration + 1.0)].max()

    def later(outcome):
        return rms(outcome.error[np.abs(outcome.time - fault.duration - 20.0) < 2.5])

    # then nothing is lost for good: 20 s after its end the error is within three times that without the fault
    assert np.isfinite(faulty.error).all()
    assert later(faulty) < 3.0 * max(later(clean), 1.0)
    # and meanwhile it costs no more than coasting through it would, or than fixes without an IMU: their scatter and
    # what a car may do in the second between two
    if fault.duration <= 20.0:
        assert during(faulty) < max(1.3 * during(coasting), 3.0 * max(during(clean), 2.0))
    # and it is said
    assert bool(faulty.said) or fault.name in UNSAID
