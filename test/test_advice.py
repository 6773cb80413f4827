"""Which manoeuvre shows most of an effect: what is known of it from geometry, and that it is worth what is said."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mems_ins_fusion.configuration.mounting import estimate_mounting
from mems_ins_fusion.configuration.offset import FLOOR, with_more
from mems_ins_fusion.diagnosis.advice import SPEED, advised, driven_speed, fisher_information
from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.findings import Finding
from mems_ins_fusion.diagnosis.held_out import HeldOut
from mems_ins_fusion.diagnosis.tracing import effect_unknowns
from mems_ins_fusion.effects.registry import effect_called
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.drive import Path, follow, simulate_drive
from mems_ins_fusion.simulation.manoeuvres import ASKED, Segment, asked
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

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


def looked_at(recording):
    """What looks say of offset and antenna, as findings."""
    mounting = estimate_mounting(recording.imu, recording.gnss)
    sigmas = dict(zip(('time_offset', *'xyz'), (mounting.offset.lag_sigma, *mounting.offset.arm_sigma)))
    units = {'time_offset': 's', 'x': 'm', 'y': 'm'}
    late, arm = ({n: (sigmas[n], units[n]) for n in names} for names in (('time_offset',), 'xy'))
    return [replace(one, direct=True, since=int(recording.imu.stamp[0])) for one in (
        finding('gnss_time_offset', **late), finding('gnss_lever_arm', **arm))]


@pytest.mark.parametrize('seed', [1, 3])
def test_what_a_look_gives_behind_the_manoeuvre_is_what_was_predicted(seed):
    # given an IMU with a tenth of the noise that the parameters say, in a vehicle that has driven off and once round a
    # corner, and goes on with the manoeuvre of the advice
    quiet = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[3e-5] * 3)
    speed = 10.0
    before = asked('driving straight on', speed, 80.0, 10.0)

    def driven_on(name):
        segments, begin = asked(name, speed, 80.0, 40.0)
        return simulate_recording(follow(Path(segments), begin + 40.0, 50.0), quiet, GnssNoise(0.02), seed=seed
                                  ).recording, begin
    seen, begin = driven_on('driving straight on')
    end = seen.imu.stamp[0] + round(before[1] * 1e9)
    seen = seen.having({name: samples.select(samples.stamp <= end) for name, samples in seen.streams().items()})
    for one, another in zip(looked_at(seen), (0, 1)):
        advice = advised(one, seen, VALUES)
        behind, _ = driven_on(advice.manoeuvre)
        then = looked_at(behind)[another].parameters[advice.parameter].sigma
        # then the sigma behind it is the one that was predicted
        assert then < 0.8 * advice.now
        assert then == pytest.approx(advice.then, rel=0.25)


def test_only_what_comes_from_the_begin_of_the_manoeuvre_on_lessens_a_sigma():
    # given a drive, and one that is the same without errors
    segments, _ = asked('a left and a right turn', 10.0, 80.0, 40.0)
    made, exact = (simulate_recording(follow(Path(segments), 120.0, 25.0), sensors, GnssNoise(0.02)).recording
                   for sensors in (SensorErrors(accelerometer_noise_density=[1e-2] * 3), None))
    offset = estimate_mounting(made.imu, made.gnss).offset
    begin, middle, end = (int(exact.gnss.stamp[k]) for k in (0, len(exact.gnss) // 2, -1))
    sigmas = [np.r_[with_more(offset, exact.imu, exact.gnss, since)] for since in (begin, middle, end)]
    # then all of it counts as a second drive, half of it less, and nothing of it not at all; the floor stays
    assert sigmas[2] == pytest.approx(np.r_[offset.lag_sigma, offset.arm_sigma])
    assert (sigmas[0] < sigmas[1]).all() and (sigmas[1] < sigmas[2]).all() and sigmas[0][0] > FLOOR
    assert sigmas[0][1:3] == pytest.approx(sigmas[2][1:3] / np.sqrt(2.0), rel=0.15)


def finding(name, **sigmas):
    parameters = {parameter: Estimate(0.5, sigma, unit) for parameter, (sigma, unit) in sigmas.items()}
    return Finding(name, [name], parameters, 0.0, 0.0, True, HeldOut(0.0, 1.0, []))


def sigmas(effect, parameters, sigma, names):
    """What is left of a parameter without any other knowledge, by manoeuvre."""
    unknowns = [u for u in effect_unknowns(effect_called(effect), {}) if u.parameter in parameters]
    return {name: np.diag(fisher_information(name, unknowns, recorded(sigma), VALUES)) ** -0.5 for name in names}


@pytest.mark.parametrize('speed', [0.8, 9.0, 25.0])
@pytest.mark.parametrize('name', ASKED)
def test_a_manoeuvre_begins_and_ends_at_its_speed(name, speed):
    segments, begin = asked(name, speed, 80.0, 30.0)
    assert sum(s.speed_change for s in segments) == pytest.approx(speed)
    assert sum(s.duration for s in segments) >= begin + 30.0
    # and it does at the time that is told, also where a vehicle needs long to become so fast
    times = np.cumsum([s.duration for s in segments])
    before = [s.speed_change for s, end in zip(segments, times) if end <= begin + 1e-6]
    assert begin >= 80.0 and sum(before) == pytest.approx(speed) and np.abs(times - begin).min() < 1e-6
    speeds = np.cumsum([s.speed_change for s in segments])
    assert speeds.min() > -1e-9


@pytest.mark.parametrize('sigma', [0.02, 1.5])
@pytest.mark.parametrize('speed, standing', [(15.0, 0.0), (15.0, 60.0), (5.0, 0.0)])
def test_the_speed_is_that_of_the_latest_driving(speed, standing, sigma):
    # given a vehicle that drives at 8 m/s, then at `speed`, and that stands at the end, or not
    course = Path((Segment(5.0), Segment(10.0, 8.0), Segment(30.0), Segment(10.0, speed - 8.0), Segment(30.0),
                   *([Segment(10.0, -speed), Segment(standing)] if standing else [])))
    end = sum(s.duration for s in course.segments) - 1.0
    fixes = simulate_recording(follow(course, end, 20.0), None, GnssNoise(sigma)).recording.gnss
    if standing:  # braking is driving, too
        assert 0.3 * speed < driven_speed(fixes) < speed
    else:
        assert driven_speed(fixes) == pytest.approx(speed, abs=0.05 + 0.3 * sigma)


def test_a_vehicle_that_only_stands_counts_as_one_in_town():
    fixes = simulate_recording(follow(Path((Segment(60.0),)), 50.0, 20.0), None, GnssNoise(1.5)).recording.gnss
    assert driven_speed(fixes) == driven_speed(fixes.select(slice(0, 1))) == SPEED


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
