"""Height from the pressure of the air: its formula, what it gives the filter, what is said where it is wrong."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_support import HEIGHT, central_difference, started
from live_support import lived, same_bits

from mems_ins_fusion.configuration.check import check_setup
from mems_ins_fusion.configuration.configure import configure
from mems_ins_fusion.configuration.dynamic_pressure import estimate_dynamic_pressure
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements import pressure
from mems_ins_fusion.filter.measurements.geometry import body_to_level
from mems_ins_fusion.filter.measurements.pressure import height_of, metres_per_pascal, pressure_at
from mems_ins_fusion.filter.memory import Event, Head, Kind, sample_at, state_at
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run, run_with_outages
from mems_ins_fusion.parameters import table
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.recordings.checker import check_recording
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation import manoeuvres
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording


def made(seed=5, duration=240.0, rate=50.0, vertical=4.0, effects=(), deck=manoeuvres.CITY, **errors):
    """A hilly drive with a barometer of 10 Hz, and fixes whose heights are poor."""
    drive = simulate_drive(duration, seed, rate, standstill=10.0, hills=True, manoeuvres=deck)
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    return simulate_recording(drive, sensors, GnssNoise(1.5, 1.0, vertical_sigma=vertical), effects, seed=seed,
                              aiding=SimulatedAiding(pressure_rate=10.0, **errors)).recording


def config(**values):
    return FilterConfig.from_parameters(table.check({'pressure_topic': '/pressure', **values}))


def height_error(recording, result):
    return result.height - np.interp(result.stamp, recording.reference.stamp, recording.reference.height)


@pytest.mark.parametrize(('height', 'pressure'), [(-500.0, 107477.0), (0.0, 101325.0), (1000.0, 89876.3),
                                                  (3000.0, 70121.2)])
def test_the_standard_atmosphere_is_that_of_its_tables(height, pressure):
    # geometric height and Pa: U.S. Standard Atmosphere, 1976, table I; geopotential height is less by h^2 / 6.357e6 m
    geopotential = height - height**2 / 6356766.0
    assert height_of(pressure) == pytest.approx(geopotential, abs=0.2)
    assert pressure_at(geopotential) == pytest.approx(pressure, abs=2.0)
    step = height_of(pressure - 0.5) - height_of(pressure + 0.5)
    assert metres_per_pascal(pressure) == pytest.approx(step, rel=1e-6)


def test_innovation_and_derivatives_are_those_of_the_flow_of_the_air():
    # given a share that is declared, and estimates of what is left of it and of the weather
    c, velocity, declared = config(), np.array([12.0, -5.0, 0.3]), -0.4
    bias, share = (c.layout.index(f'pressure_{name}') for name in ('bias', 'dynamic'))
    n, x = c.layout.n, np.zeros(c.layout.n)
    x[bias], x[share] = 3.0, 0.15
    memory = started(c, velocity=velocity, x=x)
    r, scratch = state_at(memory, 0), int(memory[Head.SCRATCH_AT])
    h, at = scratch + n * n, scratch + n * n + 3 * n
    memory[h:h + n], memory[scratch:scratch + n * n] = 0.0, 0.0
    memory[at + Event.VALUE], memory[at + Event.VALUE + 1], memory[at + Event.STATE] = HEIGHT - 8.0, declared, bias
    assert pressure.observe(memory, r, at, h, n, body_to_level(memory, r), sample_at(memory, 0)) == 1

    def measured(away):
        """Height that it shows, m; away: true less estimated errors of the filter."""
        away = x + away
        v_n, v_e = velocity[:2] - away[3:5]
        return HEIGHT + away[2] + away[bias] - (declared + away[share]) * (v_n**2 + v_e**2) / (2.0 * 9.80665)
    # then z = H x + noise holds where the errors are what they are estimated to be, to first order around it
    row = memory[h:h + n]
    assert row == pytest.approx(-central_difference(lambda away: np.array([measured(away)]), n, 1e-4)[0], abs=1e-6)
    assert memory[at + Event.Z_N] - row @ x == pytest.approx(measured(np.zeros(n)) - (HEIGHT - 8.0), abs=1e-9)


def test_it_knows_the_height_where_fixes_do_not_and_in_an_outage():
    # given fixes with heights of 4 m, 60 s without any of them, weather that is 80 m off and wanders
    recording = made()
    begin = recording.imu.stamp[0] + np.array([100, 160]) * 10**9
    error, lost = {}, {}
    for name, aiding in (('without', Aiding()), ('with', Aiding(pressure=recording.others['pressure']))):
        values = {} if name == 'with' else {'pressure_topic': ''}
        whole, outages = run_with_outages(config(**values), recording.imu, recording.gnss, begin, 60.0, aiding)
        settled = whole.stamp > recording.imu.stamp[0] + 60 * 10**9
        away = height_error(recording, whole)[settled]
        error[name], lost[name] = np.sqrt(np.mean(away**2)), np.abs(height_error(recording, outages.run)).max()
        assert np.sqrt(np.mean((away / whole.sigma[settled, 2]) ** 2)) < 1.7
    # then heights are the better for it, and its bias is a state whose sigma holds
    assert error['with'] < 0.8 * error['without'] and lost['with'] < max(0.7 * lost['without'], 4.0)
    assert whole.config.layout.names[-3:] == ('pressure_bias', 'pressure_dynamic', 'pressure_time_offset')
    assert whole.sigma[-1, -3] < 3.0


@pytest.mark.parametrize('share', [-0.5, 0.0, 0.4])
def test_the_flow_of_the_air_is_told_from_a_climb(share, tmp_path):
    # given a barometer that measures a share of the dynamic pressure
    recording = made(vertical=1.0, effects=[(EFFECTS['pressure_dynamic'], {'share': share})])
    # when the filter knows nothing of it
    result = run(config(), recording.imu, recording.gnss, Aiding(pressure=recording.others['pressure']))
    # then it is a state, as sure as it says, and heights are those of the fixes
    at = result.config.layout.extras.index('pressure_dynamic')
    sigma = result.sigma[-1, result.config.layout.index('pressure_dynamic')]
    assert result.extras[-1, at] == pytest.approx(share, abs=3.0 * sigma) and sigma < 0.15
    # and configure finds it without a filter, and the checker what is left of it
    seen = estimate_dynamic_pressure(recording.others['pressure'], recording.gnss)
    assert seen.share == pytest.approx(share, abs=3.0 * seen.sigma) and seen.sigma < 0.2
    write_recording(recording, tmp_path / 'bag')
    values = configure([tmp_path / 'bag']).values
    assert values['pressure.dynamic'] == pytest.approx(share, abs=3.0 * seen.sigma)
    said = [f for f in check_setup(recording, table.check({**values, 'pressure.dynamic': -share}))
            if 'dynamic pressure' in f.message]
    assert [f.severity for f in said] == ['warning' if share else 'info']


@pytest.mark.parametrize('vertical', [0.03, 1.0])
def test_of_a_slow_robot_no_share_of_the_dynamic_pressure_is_told(vertical, tmp_path, monkeypatch):
    # given a robot of 1 m/s, whose whole dynamic pressure is 5 cm of height, and half of it missing
    monkeypatch.setattr(manoeuvres, 'ROBOT_SPEED', 1.0)
    recording = made(58701, vertical=vertical, effects=[(EFFECTS['pressure_dynamic'], {'share': -0.5})],
                     deck=manoeuvres.SLOW)
    # then what is known before a recording is more than it shows
    seen = estimate_dynamic_pressure(recording.others['pressure'], recording.gnss)
    assert seen.sigma > table.defaults()['pressure.dynamic_sigma']
    # and neither checker nor configure tells a number
    said = check_setup(recording, table.check({'pressure_topic': '/pressure'}))
    assert not [f for f in said if 'dynamic pressure' in f.message]
    write_recording(recording, tmp_path / 'bag')
    found = configure([tmp_path / 'bag']).values
    assert found['pressure_topic'] and 'pressure.dynamic' not in found


@pytest.mark.filterwarnings('error')
def test_pressures_that_are_none_show_no_share():
    # given some messages with numbers that no air has
    recording = made()
    pressure = recording.others['pressure']
    spoiled = pressure.pressure.copy()
    spoiled[::20], spoiled[7::40], spoiled[11::40] = -1e300, np.nan, 0.0
    # then what is shown is what the others show
    others = pressure.select(spoiled == pressure.pressure)
    assert estimate_dynamic_pressure(replace(pressure, pressure=spoiled), recording.gnss) == (
        estimate_dynamic_pressure(others, recording.gnss))


def test_a_window_that_opens_is_not_taken_for_a_climb():
    # given 3 hPa less for five seconds, 25 m
    recording = made()
    pressure = recording.others['pressure']
    at = (pressure.stamp - pressure.stamp[0]) * 1e-9
    gust = replace(pressure, pressure=pressure.pressure - 300.0 * ((at > 150.0) & (at < 155.0)))
    found = {}
    for name, samples in (('calm', pressure), ('gust', gust)):
        result = run(config(), recording.imu, recording.gnss, Aiding(pressure=samples))
        found[name] = result
    # then its bias takes it
    assert np.abs(found['gust'].height - found['calm'].height).max() < 1.0


def test_live_and_replay_give_the_same_bits():
    recording = made(duration=100.0)
    pressure = recording.others['pressure']
    replayed = run(config(), recording.imu, recording.gnss, Aiding(pressure=pressure))
    fusion = FusionFilter(config())
    same_bits(replayed, lived(fusion, recording, 'pressure'), 2000)
    health = fusion.health()
    assert 'pressure_bias' in health and health['pressure_bias sigma'] < 10.0 and health['pressure used'] > 500


def test_a_bag_keeps_it_and_configure_and_the_checker_know_its_unit(tmp_path):
    # given a bag with hPa
    recording = made(duration=120.0)
    pressure = recording.others['pressure']
    in_hpa = replace(pressure, pressure=0.01 * pressure.pressure, variance=1e-4 * pressure.variance)
    write_recording(recording.having({'pressure': in_hpa}), tmp_path / 'bag', pressure_topic='/baro')
    read = read_recording(tmp_path / 'bag', '/imu/data', '/gps/fix', pressure_topic='/baro')
    assert np.array_equal(read.others['pressure'].pressure, in_hpa.pressure)
    # then the checker names the factor, and with it says nothing; configure sets it
    worse = [f for f in check_recording(read, table.defaults()) if f.topic == 'pressure' and f.severity == 'error']
    assert len(worse) == 1 and 'set pressure.factor to 100' in worse[0].message
    values = table.check({'pressure_topic': '/baro', 'pressure.factor': 100.0})
    assert all(f.severity == 'info' for f in check_recording(read, values) if f.topic == 'pressure')
    found = configure([tmp_path / 'bag']).values
    assert (found['pressure_topic'], found['pressure.factor']) == ('/baro', 100.0)


def test_what_cannot_be_is_said():
    # given hPa where Pa is expected, and no number
    recording = made(duration=30.0)
    pressure = recording.others['pressure']
    wrong = replace(pressure, pressure=np.where(np.arange(len(pressure)) % 2, 1013.0, np.nan))
    result = run(config(), recording.imu, recording.gnss, Aiding(pressure=wrong))
    assert not (result.measured.kind == Kind.PRESSURE).any()
    assert any('/pressure: pressure 1013 Pa is outside 40000 to 115000 Pa: dropped (a wrong pressure.factor'
               in notice.text for notice in result.notices)
    # and a filter without a height says that it has none
    with pytest.raises(ParameterError, match="'pressure_topic' needs mechanization strapdown"):
        config(mechanization='planar')


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_an_input_without_a_topic_is_not_used_and_that_is_said(mechanization):
    # given pressures that nobody has asked for, of which the planar filter knows nothing
    recording = made(duration=60.0)
    unasked = config(pressure_topic='', mechanization=mechanization)
    with_them = run(unasked, recording.imu, recording.gnss, Aiding(pressure=recording.others['pressure']))
    # then all is as without them
    assert np.array_equal(with_them.latitude, run(unasked, recording.imu, recording.gnss).latitude)
    assert [n.text for n in with_them.notices if 'pressure' in n.text] == ['pressure_topic is empty: pressure not used']
    live = FusionFilter(unasked)
    live.add_imu(10**9, 0.0, 0.0, 9.8, 0.0, 0.0, 0.0)
    with pytest.raises(ParameterError, match='pressure_topic'):
        live.add('pressure', 10**9, 95000.0, 100.0)
