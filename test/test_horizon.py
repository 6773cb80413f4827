"""For how long the position can be trusted without fixes: against formulas, against the filter's own way through such
a time, live as replayed, and told over real ROS 2."""
from __future__ import annotations

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from filter_support import configure, input_event, newest, started, take_all
from live_support import fed
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import PLAYABLE, Diagnostics, NodeProcess, Player, call, stamp_of
from scipy.integrate import quad
from scipy.stats import norm
from std_srvs.srv import SetBool

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Event, Kind, Nav, newest_row, set_covariance
from mems_ins_fusion.filter.runs.horizon import LONGEST_HORIZON, STEP, HorizonPredictor, exceedance_probability
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.odometry import published_covariance
from mems_ins_fusion.filter.runs.replay import run_with_outages
from mems_ins_fusion.filter.trust.receiver import Receiver
from mems_ins_fusion.filter.trust.scale import PRIOR, Scale
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

SECOND = 10**9
#: of an error that is the same in all directions, over its sigma: larger with 5 %
ROUND = math.sqrt(2.0 * math.log(20.0))
#: and of one along a line
LINE = norm.ppf(0.975)
NO_NOISE = {f'{sensor}.{name}': 0.0 for sensor in ('accelerometer', 'gyroscope')
            for name in ('noise_density', 'random_walk.q')} | {'sensor_error_model': 'random_walk'}
CAR = {'mechanization': 'strapdown', 'vehicle.zero_velocity': True, 'vehicle.non_holonomic': True,
       'vehicle.non_holonomic_sigma': 0.3, 'vehicle.non_holonomic_vertical_sigma': 2.0, 'imu.adapt_noise': True,
       'gnss.adapt_covariance': True, 'imu.mounting_sigma': 0.02, 'vehicle.rear_axle_sigma': 1.0}


def diagonal(config, **sigma):
    """Covariance (n, n) with sigmas by the names of states, nothing known of the others being wrong."""
    return np.diag([max(sigma.get(name, 0.0), 1e-9)**2 for name in config.layout.names])


def test_probability_of_a_larger_error():
    # given ellipses from a circle to a line, at any angle
    config = configure()
    for major, minor, angle in ((2.0, 2.0, 0.0), (2.0, 1.0, 0.7), (2.5, 0.4, -1.1), (2.0, 1e-9, 0.3)):
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, -s], [s, c]])
        p = np.zeros((config.layout.n, config.layout.n))
        p[:2, :2] = turn @ np.diag([major**2, minor**2]) @ turn.T
        memory = started(config, p=p)
        row = newest(memory)
        set_covariance(row, config.layout, p)
        at = int(np.flatnonzero(np.all(np.lib.stride_tricks.sliding_window_view(memory, len(row)) == row, axis=1))[0])
        # then it is what is left beside the disc: over the minor axis, of what the major one leaves at each place of it
        inside, _ = quad(lambda v: norm.pdf(v) * (2 * norm.cdf(math.sqrt(max(25.0 - (minor * v)**2, 0.0)) / major) - 1),
                         -min(5.0 / minor, 9.0), min(5.0 / minor, 9.0), limit=200)
        assert exceedance_probability(memory, at, 5.0) == pytest.approx(1.0 - inside, abs=1e-3)


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_a_vehicle_that_goes_straight_on(mechanization):
    # given the paper's filter, with an error of position, velocity and (the same in all directions) of accelerometers
    config = configure({**NO_NOISE, 'horizon.speed': 0.0, 'mechanization': mechanization})
    p = diagonal(config, r_n=0.5, r_e=0.5, v_n=0.1, v_e=0.1, f_x=0.01, f_y=0.01)
    memory = started(config, p=p, attitude=(0.0, 0.0, math.atan2(-5.0, 12.0)), velocity=(12.0, -5.0, 0.0))
    horizon = HorizonPredictor(config).predict(memory)
    # then the sigma is that of the straight line and the parabola, and the horizon is where that is the limit's
    times = np.arange(0.0, LONGEST_HORIZON, 0.01)
    sigma = np.sqrt(0.5**2 + (0.1 * times)**2 + (0.5 * 0.01 * times**2)**2)
    expected = times[np.argmax(ROUND * sigma > 5.0)]
    assert expected < horizon.seconds <= expected + STEP + 0.02
    assert horizon.metres == pytest.approx(13.0 * horizon.seconds, rel=1e-3)
    # and with a limit below what is wrong now there is none
    assert HorizonPredictor(configure({**config.parameters, 'horizon.limit': 1.2})).predict(memory) == (0.0, 0.0)


def test_what_is_realised_and_slow_errors_of_the_receiver_count():
    # given an error of the velocity alone, on a straight way
    config = configure({**NO_NOISE, 'horizon.speed': 0.0})
    memory = started(config, p=diagonal(config, v_n=0.5, v_e=0.5), velocity=(13.0, 0.0, 0.0))
    predict, row = HorizonPredictor(config).predict, newest_row(memory)
    expected = 5.0 / (ROUND * 0.5)
    # then a realised variance of four times the expected one halves the time, a quarter doubles it
    for realised, times in ((1.0, 1.0), (4.0, 0.5), (0.25, 2.0)):
        assert predict(memory, realised=realised).seconds == pytest.approx(times * expected, abs=2 * STEP)
    # and of slow errors, of which 3 m^2 are claimed and published, as they may change more slowly than in a minute, the
    # tenth counts that innovations show
    row[Nav.LASTING] = 3.0
    row[Receiver.LASTING_SCALE + Scale.LOG] = -math.log(10.0)
    row[Receiver.LASTING_SCALE + Scale.REDUCED] = PRIOR - math.log(2.0)**2
    slow = math.sqrt((5.0 / ROUND)**2 - 0.3) / 0.5
    assert predict(memory).seconds == pytest.approx(slow, abs=2 * STEP)
    # whatever is realised of the rest
    assert predict(memory, realised=0.25).seconds == pytest.approx(2.0 * slow, abs=2 * STEP)
    assert row[Nav.LASTING] == 3.0


def test_a_vehicle_that_stands_drives_off():
    # given one whose heading is not sure, and nothing else wrong
    config = configure({**NO_NOISE, 'horizon.speed': 10.0})
    memory = started(config, p=diagonal(config, yaw=0.05), velocity=(0.0, 0.0, 0.0))
    horizon = HorizonPredictor(config).predict(memory)
    # then it can go as far as that leads the limit's way aside, at 2 m/s^2 to 10 m/s
    expected = 5.0 / (LINE * 0.05)
    assert expected < horizon.metres < expected + 10.0 * STEP + 0.1
    assert horizon.seconds == pytest.approx(5.0 + (expected - 25.0) / 10.0, abs=2 * STEP)
    # and one that is known to stay where it is for ever
    config = configure({**config.parameters, 'horizon.speed': 0.0})
    assert HorizonPredictor(config).predict(memory) == (LONGEST_HORIZON, 0.0)


@pytest.mark.parametrize('told', [False, True], ids=['', 'wheel speed'])
def test_it_is_what_the_filter_itself_comes_to(told):
    # given a car's filter in the middle of a straight road, with some of everything wrong
    config = configure({**CAR, 'horizon.speed': 0.0, 'speed_topic': '/speed', 'vehicle.zero_velocity': False})
    p = diagonal(config, r_n=0.6, r_e=0.6, r_d=1.0, v_n=0.1, v_e=0.1, v_d=0.1, phi_n=0.004, phi_e=0.004, phi_d=0.01,
                 f_x=0.03, f_y=0.03, f_z=0.03, w_x=3e-4, w_y=3e-4, w_z=3e-4, mounting_pitch=0.01, mounting_yaw=0.01,
                 axle_x=1.0, axle_y=1.0, speed_scale=0.003)
    memory = started(config, p=p, attitude=(0.0, 0.0, 0.0), velocity=(15.0, 0.0, 0.0))

    def ahead(memory, begin, seconds):
        time = begin + np.arange(1, round(50 * seconds) + 1) / 50.0
        gravity = np.full(len(time), STANDARD_GRAVITY)
        samples = np.column_stack([time, 0 * time, 0 * time, gravity, np.zeros((len(time), 3))])
        speeds = np.zeros((len(time[4::5]) if told else 0, Event.SIZE))
        speeds[:] = input_event(config, 0.0, Kind.SPEED)
        speeds[:, [Event.VALUE, Event.R_NN]] = 15.0, 0.1**2
        speeds[:, Event.TIME] = time[4::5][:len(speeds)]
        take_all(memory, samples, speeds, [0])
    ahead(memory, 0.0, 2.0)
    untouched = memory.copy()
    horizon = HorizonPredictor(config).predict(memory)
    assert np.array_equal(memory, untouched)
    # when it goes on with samples of such a road
    assert 3.0 < horizon.seconds < LONGEST_HORIZON
    ahead(memory, 2.0, horizon.seconds)
    # then its own error has come to the limit
    variances = np.linalg.eigvalsh(published_covariance(newest(memory), config.layout)[:2, :2])
    rng = np.random.default_rng(1)
    errors = np.hypot(*(np.sqrt(variances)[:, None] * rng.standard_normal((2, 100_000))))
    assert np.quantile(errors, 0.95) == pytest.approx(5.0, rel=0.05)


@pytest.fixture(scope='module')
def recording():
    """100 s at 50 Hz: a standstill, then a drive; fixes each second."""
    sensors = SensorErrors(accelerometer_noise_density=[1e-3] * 3, gyroscope_noise_density=[1e-4] * 3)
    return simulate_recording(simulate_drive(100.0, seed=3, rate=50.0, standstill=6.0), sensors, GnssNoise(0.5),
                              seed=3).recording


def horizons(config, recording):
    """Horizon by the stamp of each sample after which a live filter has one."""
    fusion = FusionFilter(config)
    return {int(recording.imu.stamp[i]): fusion.horizon() for i in fed(fusion, recording) if fusion.aligned}


def test_replay_announces_what_is_told_live(recording):
    # given outages in a drive
    config = configure(CAR)
    begin = recording.gnss.stamp[[40, 55, 70]]
    _, coasting = run_with_outages(config, recording.imu, recording.gnss, begin, 20.0)
    told = horizons(config, recording)
    stamps = np.array(list(told))
    for b, announced in zip(coasting.begin.tolist(), coasting.announced.tolist()):
        # then each is announced what is told live after the last sample before the first fix withheld
        arrived = recording.gnss.received[recording.gnss.stamp > b].min()
        last = int(stamps[np.searchsorted(recording.imu.received[-len(stamps):], arrived) - 1])
        assert announced > 0.0
        assert announced == pytest.approx((last - b) * 1e-9 + told[last].seconds, abs=1e-6)


def test_the_node_tells_it(recording, peer):
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    limit = 8.0
    with NodeProcess('fusion_node', *PLAYABLE, '-p', f'horizon.limit:={limit}') as node:
        node.wait_until_ready()
        told: list[DiagnosticArray] = []
        peer.node.create_subscription(DiagnosticArray, '/fusion_node/horizon', told.append, latched)
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        player.connect()
        player.play(60.0)
        peer.spin_until(lambda: told and stamp_of(told[-1]) >= recording.imu.stamp[0] + 59 * SECOND)
        # then it is that of the filter at the same sample, a planner's numbers, once a second of samples,
        status = told[-1].status[0]
        values = {pair.key: float(pair.value) for pair in status.values}
        assert status.name == 'fusion_node: horizon' and status.level == b'\x00'
        assert values['limit, m'] == limit and 1.0 < values['seconds'] < LONGEST_HORIZON
        assert f'{limit:g} m for {values["seconds"]:.1f} s, {values["metres"]:.0f} m' in status.message
        other = FilterConfig.from_parameters(table.check({'horizon.limit': limit}))
        same = horizons(other, recording)[stamp_of(told[-1])]
        assert values['seconds'] == pytest.approx(same.seconds, abs=1e-6)  # degrees in messages are other last bits
        assert values['metres'] == pytest.approx(same.metres, rel=1e-5)
        stamps = np.array([stamp_of(message) for message in told])
        assert np.all(np.diff(stamps)[1:] == SECOND) and len(stamps) > 30
        # there at once for who comes late, and on /diagnostics,
        late: list[DiagnosticArray] = []
        peer.node.create_subscription(DiagnosticArray, '/fusion_node/horizon', late.append,
                                      QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        peer.spin_until(lambda: late)
        assert stamp_of(late[0]) == stamps[-1]
        heard.wait(lambda d: 'trust horizon, s' in d.values('filter'))
        # and in an outage it counts down
        before = len(told)
        call(peer, SetBool, '/fusion_node/use_fixes', SetBool.Request(data=False))
        player.play(70.0)
        peer.spin_until(lambda: stamp_of(told[-1]) >= recording.imu.stamp[0] + 69 * SECOND)
        left = [float(m.status[0].values[0].value) for m in told[before:]]
        assert len(left) > 8 and left[-1] < left[0] - 3.0
        heard.wait(lambda d: f'the error stays below {limit:g} m for' in d.message('filter'))
