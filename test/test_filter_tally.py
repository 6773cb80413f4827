"""What becomes of the measurements of one input, and a filter's words on what it cannot use."""
from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from filter_support import configure
from live_support import lived

from mems_ins_fusion.filter.runs.intake import first_datum
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.tally import Tally
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_drive, simulate_recording

SECOND = 10**9  # ns


def test_refusals_in_a_row_tell_from_when_and_why():
    tally = Tally()
    tally.use(4.0)
    for k in range(5):
        tally.refuse(k * SECOND, 'beyond the gate', 16.0)
    assert (tally.used, tally.refused) == (1, {'beyond the gate': 5})
    assert (tally.row, tally.since, tally.last) == (5, 0, 4 * SECOND)
    assert tally.misfit == pytest.approx(math.sqrt((4.0 + 5 * 16.0) / 6))
    assert tally.steadily(5 * SECOND, patient=True) and not tally.steadily(60 * SECOND, patient=True)
    tally.use(1.0)
    assert tally.row == 0 and not tally.steadily(5 * SECOND, patient=False)


def test_three_of_a_fast_sensor_are_an_instant():
    tally = Tally()
    for k in range(3):
        tally.refuse(k * SECOND // 100, 'beyond the gate')
    assert tally.steadily(SECOND, patient=False) and not tally.steadily(SECOND, patient=True)
    assert math.isnan(tally.misfit)


@pytest.fixture(scope='module')
def recording():
    return simulate_recording(simulate_drive(20.0, seed=2, rate=50.0, standstill=12.0), None,
                              GnssNoise(sigma=0.5, rate=2.0), seed=2).recording


def waited(config, imu, fixes):
    """A filter after the first 300 samples, with the fixes of the same time."""
    fusion = FusionFilter(config)
    lived(fusion, Recording('begin', imu, fixes), upto=300)
    return fusion


@pytest.mark.parametrize('wrong', [0, 1, 2])
def test_the_datum_is_the_same_live_and_replayed_and_one_wrong_fix_does_not_make_it(recording, wrong):
    fixes = recording.gnss
    latitude = fixes.latitude.copy()
    latitude[wrong] += 1e-4  # 640 m
    altered = replace(fixes, latitude=latitude)
    config = configure(mechanization='strapdown')
    live = waited(config, recording.imu, altered).datum
    assert np.array_equal(live, first_datum(config, recording.imu, altered))
    assert abs(live[0] - fixes.latitude[0]) * 6.4e6 < 5.0


def test_a_start_that_cannot_be_is_told_from_one_that_waits(recording):
    config, imu, fixes = configure(mechanization='strapdown'), recording.imu, recording.gnss
    waiting = waited(config, imu, fixes)
    assert waiting.state == 'aligning' and not waiting.contradicted
    in_g = replace(imu, specific_force=imu.specific_force / 9.80665)
    wrong = waited(config, in_g, fixes)
    assert wrong.contradicted and "imu.acceleration_unit to 'g'" in wrong.status
    # fixes that are all refused cannot start it, but a receiver that has none yet will have one
    refused = waited(config, imu, replace(fixes, height=fixes.height + 2e4))
    assert refused.contradicted and re.search(r'altitude 2\d{4}\.?\d* m is outside', refused.status)
    garage = waited(config, imu, replace(fixes, status=np.full(len(fixes), -1, np.int8)))
    assert not garage.contradicted and '(no fix, by its status)' in garage.status
