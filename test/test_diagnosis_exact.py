"""What a fit takes for exact is in the sigmas of what it fits: time offset and arm of the antenna."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mems_ins_fusion.configuration.offset import Offset
from mems_ins_fusion.diagnosis.exact import of_what_is_held
from mems_ins_fusion.diagnosis.fit import fit
from mems_ins_fusion.diagnosis.problem import Problem
from mems_ins_fusion.diagnosis.tracing import effect_unknowns
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

ARM = 1.5  # m, by which the antenna is ahead of the IMU


@pytest.fixture(scope='module')
def drive():
    """Five minutes in a city."""
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(simulate_drive(300.0, 2, 25.0, standstill=10.0), sensors, GnssNoise(1.0, 1.0),
                              [(EFFECTS['gnss_lever_arm'], {'x': ARM})], seed=2).recording


def fitted(recording, arm, effect='gnss_time_offset', offset=0.0):
    """The model with one effect, of an antenna that is stated to be ahead by `arm` and clocks by `offset`; the
    parameters."""
    given = table.check({'gnss.lever_arm': [arm, 0.0, 0.0], 'gnss.time_offset': offset})
    problem = Problem(recording, given)
    unknowns = effect_unknowns(EFFECTS[effect], {}, problem.attitude)
    return fit(problem, unknowns, np.zeros(len(unknowns))), given


def track(lag=0.0, lag_sigma=0.0, arm=(0.0, 0.0, 0.0), arm_sigma=(0.0, 0.0, 0.0)):
    return Offset(lag, lag_sigma, np.array(arm), np.array(arm_sigma), 0.0, 0.0)


def test_an_arm_that_is_not_known_is_in_the_sigma_of_an_offset(drive):
    # given the offset fitted with the antenna on the IMU, and where it is; the clocks agree
    held, given = fitted(drive, 0.0)
    right, stated = fitted(drive, ARM)
    moved = held.x[0] - right.x[0]
    assert abs(right.x[0]) < 3.0 * right.sigma()[0] and abs(moved) > 3.0 * held.sigma()[0]
    # when the track shows another offset, and an arm of that size
    further = of_what_is_held(held, track(1.0, arm=[ARM, 0.0, 0.0]), given)
    # then by how much that moves the offset is known before
    assert further[0] == pytest.approx(abs(moved), rel=0.3)
    # whether the size is an estimate or its sigma, and with both it is more
    assert of_what_is_held(held, track(1.0, arm_sigma=[ARM, 0.0, 0.0]), given) == pytest.approx(further)
    assert of_what_is_held(held, track(1.0, arm=[ARM, 0.0, 0.0], arm_sigma=[ARM, 0.0, 0.0]), given) == pytest.approx(
        np.sqrt(2.0) * further, rel=0.01)
    # an arm that is stated was measured, and one that nothing shows may be a metre
    assert of_what_is_held(right, track(1.0, arm=[ARM, 0.0, 0.0]), stated)[0] == 0.0
    assert of_what_is_held(held, None, given)[0] > 0.99 * further[0] / ARM


def test_an_offset_that_the_track_shows_too_is_not_one_of_an_arm(drive):
    # given an arm of which nothing is known, and a track that shows nearly that offset, or that within its sigma
    held, given = fitted(drive, 0.0)
    for shown, expected in ((track(held.x[0] + 0.01, arm_sigma=[ARM] * 3), 0.01),
                            (track(held.x[0] + 0.05, 0.03, arm_sigma=[ARM] * 3), 0.04),
                            (track(held.x[0] + 0.05, 0.06, arm_sigma=[ARM] * 3), 0.0)):
        # then it is off by no more than that
        assert of_what_is_held(held, shown, given)[0] == pytest.approx(expected)


def test_an_offset_that_is_not_known_is_in_the_sigma_of_an_arm(drive):
    arm, given = fitted(drive, 0.0, 'gnss_lever_arm')
    assert not of_what_is_held(arm, track(arm=[9.0] * 3), given).any()
    late = of_what_is_held(arm, track(lag=0.2, arm=[9.0] * 3), given)
    # forwards by some part of the way that a car goes in that time, and sideways by little
    other, _ = fitted(drive, 0.0, 'gnss_lever_arm', offset=0.2)
    assert late[0] == pytest.approx(abs(other.x[0] - arm.x[0]), rel=0.3) and 10.0 * late[1] < late[0]
    assert of_what_is_held(arm, track(lag=0.2, arm=[9.0] * 3), given | {'gnss.time_offset': 0.2}) == pytest.approx(0.0)


def test_other_effects_are_left_alone(drive):
    model, given = fitted(drive, 0.0, 'accelerometer_scale')
    assert not of_what_is_held(model, track(lag=1.0), given).any()
    assert not of_what_is_held(SimpleNamespace(unknowns=[]), track(lag=1.0), given).any()
