"""Which manoeuvre shows most of an effect: what is known of it from geometry, and that it is worth what is said."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.diagnosis.advice import advised, shown
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.findings import Finding
from mems_ins_fusion.diagnosis.held_out import HeldOut
from mems_ins_fusion.diagnosis.tracing import effect_unknowns
from mems_ins_fusion.effects.registry import effect_called
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import ASKED, asked
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_recording

VALUES = table.check({})


def recorded(sigma):
    return simulate_recording(simulate_drive(60.0, 1, 20.0), None, GnssNoise(sigma)).recording


def test_what_no_manoeuvre_lessens_stays():
    # given an offset whose sigma is half, and all but wholly, no matter of more samples
    late = finding('gnss_time_offset', time_offset=(0.02, 's'))
    given = recorded(0.02)
    without, half, whole = (advised(replace(late, least={'time_offset': least}), given, VALUES)
                            for least in (0.0, 0.01, 0.0199))
    # then the manoeuvre lessens the other half as it lessens the whole, and where nothing can be gained none is named
    rest = 1.0 / (1.0 / without.then**2 - 1.0 / 0.02**2)  # variance of the manoeuvre alone
    assert half.then**2 == pytest.approx(0.01**2 + 1.0 / (1.0 / rest + 1.0 / (0.02**2 - 0.01**2)), rel=1e-6)
    assert whole is None


def finding(name, **sigmas):
    parameters = {parameter: Estimate(0.5, sigma, unit) for parameter, (sigma, unit) in sigmas.items()}
    return Finding(name, [name], parameters, 0.0, 0.0, True, HeldOut(0.0, 1.0, []))


def sigmas(effect, parameters, sigma, names):
    """What is left of a parameter without any other knowledge, by manoeuvre."""
    unknowns = [u for u in effect_unknowns(effect_called(effect), {}) if u.parameter in parameters]
    return {name: np.diag(shown(name, unknowns, recorded(sigma), VALUES)) ** -0.5 for name in names}


@pytest.mark.parametrize('name', ASKED)
def test_a_manoeuvre_begins_and_ends_at_its_speed(name):
    segments = asked(name, 9.0, 80.0, 30.0)
    assert sum(s.speed_change for s in segments) == pytest.approx(9.0)
    assert sum(s.duration for s in segments) >= 110.0
    speeds = np.cumsum([s.speed_change for s in segments])
    assert speeds.min() > -1e-9


def test_straight_on_shows_neither_an_arm_nor_an_offset():
    # given a receiver to 2 cm. On a straight road at one speed an arm is a shift of the position, and so is an offset
    straight = 'driving straight on'
    arm = sigmas('gnss_lever_arm', ('x', 'y'), 0.02, (straight, 'a full circle'))
    assert (arm[straight] > 2.0).all() and (arm['a full circle'] < 0.5).all()
    offset = sigmas('gnss_time_offset', ('time_offset',), 0.02, (straight, 'braking and speeding up again'))
    assert offset[straight] > 0.2 and offset['braking and speeding up again'] < 0.05


def test_what_is_advised_is_worth_it_and_said_in_the_unit():
    advice = advised(finding('gnss_lever_arm', x=(0.4, 'm'), y=(0.4, 'm')), recorded(0.02), VALUES)
    assert 'turn' in advice.manoeuvre or 'circle' in advice.manoeuvre or 'slalom' in advice.manoeuvre
    assert advice.now == 0.4 and advice.then < 0.2
    assert advice.text().endswith(f'from 0.4 to {advice.then:.2g} m')
    # and nothing where half a minute adds nothing, or where nothing is known of the effect
    assert advised(finding('gnss_time_offset', time_offset=(0.001, 's')), recorded(1.5), VALUES) is None
    assert advised(finding('imu_repeats', share=(0.1, '-')), recorded(1.5), VALUES) is None
    # nor for a noise, which shows with time, whatever is driven
    assert advised(finding('gnss_coloured_noise', sigma=(1.0, 'm'), tau=(40.0, 's')), recorded(1.5), VALUES) is None
