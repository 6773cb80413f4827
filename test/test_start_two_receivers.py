"""A slow vehicle with two receivers starts with the heading from one antenna to the other, once it has gone a metre."""
from __future__ import annotations

import math

import numpy as np
import pytest
from live_support import lived, same_bits

from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.registry import aiding
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.start.two_receivers import find_heading
from mems_ins_fusion.navigation.frames import wrap
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import SLOW
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

ARM = np.array([-0.9, 0.2])  # m, from the main antenna to the other, forward and right
SIGMA = 0.02  # m
YAW = 2.0  # rad


def seen(speed=0.4, turn=0.0, ahead=0.4, seconds=4.0, lag=0.0):
    """Fixes of both receivers at 5 Hz. ahead: m, from the IMU to the main antenna; lag: of the further one, s."""
    def antenna(time, beyond):
        yaw = YAW + turn * (time - seconds)
        way = speed * time
        return np.column_stack([time, way * np.cos(YAW) + np.cos(yaw) * beyond[0] - np.sin(yaw) * beyond[1],
                                way * np.sin(YAW) + np.sin(yaw) * beyond[0] + np.cos(yaw) * beyond[1],
                                np.full(len(time), SIGMA)])
    time = np.arange(0.0, seconds + 1e-6, 0.2)
    return antenna(time, np.array([ahead, 0.0])), antenna(time + lag, np.array([ahead, 0.0]) + ARM)


@pytest.mark.parametrize('lag', [0.0, -0.07])
def test_the_antennas_tell_the_heading_and_the_way_confirms_it(lag):
    found = find_heading(*seen(lag=lag), ARM, 0.0)
    assert wrap(found.yaw - YAW) == pytest.approx(0.0, abs=1e-9) and found.speed == pytest.approx(0.4)
    # both receivers and the place of the antenna make it uncertain
    assert found.yaw_sigma == pytest.approx(math.sqrt(2.0) * SIGMA / math.hypot(*ARM))
    wide = find_heading(*seen(lag=lag), ARM, 0.1)
    assert wide.yaw_sigma == pytest.approx(math.hypot(math.sqrt(2.0) * SIGMA, 0.1) / math.hypot(*ARM))


@pytest.mark.parametrize('case, values, arm, sigma', [
    ('at rest', {'speed': 0.0}, ARM, 0.0),
    ('reversing, or antennas exchanged', {'speed': -0.4}, ARM, 0.0),
    ('arms exchanged in the parameters', {}, -ARM, 0.0),
    ('sideways', {}, [-ARM[1], ARM[0]], 0.0),
    ('aside by 35 deg', {}, [0.82 * ARM[0] - 0.57 * ARM[1], 0.57 * ARM[0] + 0.82 * ARM[1]], 0.0),
    ('turning on the spot', {'speed': 0.0, 'turn': 0.5}, ARM, 0.0),
    ('in a turn', {'turn': 0.5}, ARM, 0.0),
    ('in a turn about the main antenna', {'turn': 0.5, 'ahead': 0.0}, ARM, 0.0),
    ('so fast that the course tells it', {'speed': 5.0}, ARM, 0.0),
    ('another distance than that of the arms', {}, 1.5 * ARM, 0.0),
    ('antennas as close as they are uncertain', {}, ARM, 0.3),
    ('arms that nobody declared', {}, 0.0 * ARM, 0.0),
    ('half a second of fixes', {'seconds': 0.6}, ARM, 0.0),
])
def test_no_heading(case, values, arm, sigma):
    assert find_heading(*seen(**values), np.asarray(arm), sigma) is None, case


def test_one_fix_or_none_of_the_other_receiver_is_no_heading_and_old_ones_neither():
    main, other = seen()
    assert find_heading(main, other[:-4], ARM, 0.0) is not None and find_heading(main, other[:-8], ARM, 0.0) is None
    assert find_heading(main, other[-1:], ARM, 0.0) is None
    assert find_heading(main[-1:], other, ARM, 0.0) is None


def test_a_robot_starts_within_seconds_of_driving_off_live_as_in_a_replay():
    # given robots of 0.4 m/s that drive off at 20 s, receivers of 2 cm 0.9 m apart
    named = {'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': '/rear', 'rear.lever_arm': [-0.5, 0.0, 0.5]}
    values = table.check({'gnss.lever_arm': [0.4, 0.0, 0.5], 'vehicle.zero_velocity': False, **named})
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    for seed in (1, 2, 3):
        drive = simulate_drive(60.0, seed, 50.0, standstill=20.0, manoeuvres=SLOW)
        recording = simulate_recording(
            drive, sensors, GnssNoise(SIGMA, 5.0), [(EFFECTS['gnss_lever_arm'], {'x': 0.4, 'y': 0.0, 'z': 0.5})],
            seed=seed, aiding=SimulatedAiding(fix_rate=5.0, fix_sigma=SIGMA),
            named=[one for one in aiding(values) if not one.is_plain]).recording
        config, samples = FilterConfig.from_parameters(values), Aiding({'rear': recording.others['rear']})
        result = run(config, recording.imu, recording.gnss, samples)
        # then it starts within five seconds, with a heading that is right by its sigma
        begin = (result.stamp[0] - recording.imu.stamp[0]) * 1e-9
        assert 20.0 < begin < 25.0
        assert any('heading from two receivers' in notice.text for notice in result.notices)
        off = wrap(result.yaw[0] - np.interp(result.stamp[0], recording.reference.stamp,
                                             np.unwrap(recording.reference.yaw)))
        # which has the 0.1 rad of the IMU's mounting in it
        assert abs(off) < 3.0 * result.sigma[0, 8] and result.sigma[0, 8] < 0.15
    same_bits(result, lived(FusionFilter(config), recording, 'rear'), 1000)
