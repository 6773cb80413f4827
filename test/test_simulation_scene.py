"""The scene of a simulated drive: what is promised of road, body, shaking, receiver and further sensors."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from simulation_support import close

from mems_ins_fusion.cli import simulate
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.navigation.frames import wrap
from mems_ins_fusion.recordings.errors import RecordingWarning
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.scene import FLAT, REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SimulatedAiding, Vibration, simulate_recording


@pytest.fixture(scope='module')
def realistic():
    return REALISTIC.drive(900.0, 4)


def errors_of(fixes, drive, time):
    """North, east, down of fixes from the truth at `time`, m."""
    truth = drive.at(time)
    datum = drive.latitude[0], drive.longitude[0], drive.height[0]
    return np.subtract(to_local(fixes.latitude, fixes.longitude, fixes.height, datum),
                       to_local(truth.latitude, truth.longitude, truth.height, datum)).T


def test_flat_is_what_simulate_drive_makes_by_itself():
    plain, flat = simulate_drive(60.0, 3), FLAT.drive(60.0, 3)
    assert np.array_equal(plain.specific_force, flat.specific_force) and np.array_equal(plain.latitude, flat.latitude)
    assert FLAT.distortions(3) == {'effects': [], 'vibration': None, 'aiding': None}


def test_the_road_is_as_steep_as_asked_and_the_drive_begins_there():
    drive = simulate_drive(900.0, 5, grade=0.03, bank=0.02, parked_on_slope=True)
    assert 0.02 < np.abs(np.tan(drive.pitch)).max() <= 0.03 + 1e-9
    assert abs(np.tan(drive.pitch[0])) == pytest.approx(0.03) and abs(np.tan(drive.roll[0])) == pytest.approx(0.02)
    other = simulate_drive(900.0, 5, grade=0.03)
    assert abs(np.tan(other.pitch[0])) < 0.029


def test_the_body_swings_on_its_springs_as_a_damped_oscillator():
    rigid, soft = (simulate_drive(300.0, 1, roll_per_acceleration=0.006, suspension=hertz) for hertz in (0.0, 1.2))
    omega = 2 * np.pi * 1.2
    _, expected, _ = lsim(([omega**2], [1.0, 2 * 0.3 * omega, omega**2]), rigid.roll, rigid.time)
    assert close(soft.roll, expected, 0.004 * np.abs(expected).max())
    assert np.abs(soft.roll - rigid.roll).max() > 0.03 * np.abs(expected).max()


def test_unevenness_has_its_size_and_goes_with_the_speed(realistic):
    drive = simulate_drive(900.0, 1, suspension=1.2, unevenness=0.003)
    speed = np.hypot(*drive.velocity[:, :2].T)
    for low, high in ((4.0, 8.0), (8.0, 12.0), (12.0, 20.0)):
        chosen = (speed > low) & (speed < high)
        expected = 0.003 * np.sqrt(np.mean(speed[chosen]**2)) / 10
        assert np.std(drive.pitch[chosen]) == pytest.approx(expected, rel=0.25)
        assert np.std(drive.roll[chosen]) == pytest.approx(expected, rel=0.25)


def test_the_rear_axle_does_not_slip_sideways_and_the_imu_does():
    drive = simulate_drive(600.0, 3, axle_to_imu=(1.5, 0.0, 0.0))
    body = drive.attitude.inv().apply(drive.velocity)
    assert np.allclose(body[:, 1], 1.5 * drive.angular_rate[:, 2], atol=2e-3) and np.abs(body[:, 1]).max() > 0.3
    assert close(body[:, 0], drive.path.wheel_speed(drive.time), 1e-9)


def test_the_mixed_manoeuvres_reverse_stand_and_cruise(realistic):
    speed = realistic.path.wheel_speed(realistic.time)
    assert speed.min() < -1.0 and speed.max() > 20.0
    assert (speed == 0).mean() > 0.08
    backwards = speed < -0.5
    course = np.arctan2(realistic.velocity[backwards, 1], realistic.velocity[backwards, 0])
    assert np.all(np.cos(course - realistic.yaw[backwards]) < -0.5)


@pytest.mark.parametrize('rate', [10.0, 100.0])
def test_engine_and_road_shake_as_asked(rate):
    drive = simulate_drive(1500.0, 4, rate)
    speed = np.abs(drive.path.wheel_speed(drive.time))
    standing = speed == 0
    idle, _ = Vibration(idle=0.05, engine_off=0.0).shake(drive, np.random.default_rng(1))
    assert idle[standing, 2].std() == pytest.approx(0.05, rel=0.1)
    off, _ = Vibration(idle=0.05, engine_off=1.0).shake(drive, np.random.default_rng(1))
    assert np.all(off[standing] == 0) and off[~standing, 2].std() == pytest.approx(0.05, rel=0.1)
    road, turn = Vibration(road=0.1, smoothness=0.0).shake(drive, np.random.default_rng(1))
    assert np.all(road[standing] == 0)
    assert np.std(road[~standing, 2] / speed[~standing]) == pytest.approx(0.01, rel=0.2)
    assert np.abs(turn).max() > 0
    # the body goes nowhere by it
    if rate == 100.0:
        assert np.abs(np.cumsum(road[:, 2]) / rate).max() < 0.05


def test_the_surface_varies_about_its_mean():
    drive = simulate_drive(3000.0, 4, 50.0)
    speed = np.abs(drive.path.wheel_speed(drive.time))
    road, _ = Vibration(road=0.1).shake(drive, np.random.default_rng(1))
    moving = speed > 5.0
    seconds = (road[:, 2] / np.maximum(speed, 1))[moving][:moving.sum() // 50 * 50].reshape(-1, 50).std(axis=1)
    assert np.percentile(seconds, 95) / np.percentile(seconds, 5) > 4


def test_aiding_is_the_truth_with_its_noise(realistic):
    aiding = SimulatedAiding(speed_rate=10.0, velocity_rate=5.0, heading_rate=5.0)
    arm = (EFFECTS['gnss_lever_arm'], {'x': 0.5, 'y': 1.0, 'z': 1.5})
    recording = simulate_recording(realistic, effects=[arm], aiding=aiding, seed=6).recording

    def seconds(samples):
        return (samples.stamp - realistic.stamp[0]) * 1e-9

    speed = realistic.path.wheel_speed(seconds(recording.speed))
    scale = np.dot(recording.speed.speed, speed) / np.dot(speed, speed)
    assert 1e-4 < abs(scale - 1) < 0.04
    assert np.std(recording.speed.speed - scale * speed) == pytest.approx(0.05, rel=0.05)
    assert np.all(recording.speed.variance == 0.05**2)
    time, step = seconds(recording.velocity), 0.01

    def antenna(t):
        motion = realistic.at(t)
        return motion.position + motion.attitude.apply([0.5, -1.0, -1.5])

    error = recording.velocity.velocity - (antenna(time + step) - antenna(time - step)) / (2 * step)
    assert error.std(axis=0) == pytest.approx([0.1, 0.1, 0.15], rel=0.05)
    assert recording.velocity.covariance[0] == pytest.approx(np.diag([0.01, 0.01, 0.0225]))
    error = wrap(recording.heading.yaw - realistic.at(seconds(recording.heading)).yaw)
    assert error.std() == pytest.approx(0.02, rel=0.05) and abs(error.mean()) < 0.002


@pytest.fixture(scope='module')
def rest():
    return simulate_drive(6000.0, 1, rate=1.0, standstill=6000.0)


def test_a_receiver_with_coloured_noise_and_outliers(rest):
    gnss = GnssNoise(sigma=0.5, coloured_sigma=2.0, coloured_tau=10.0)
    fixes = simulate_recording(rest, gnss=gnss).recording.gnss
    error = errors_of(fixes, rest, gnss.times(rest.time[-1]))[:, 0]
    assert np.var(error) == pytest.approx(4.25, rel=0.25)
    assert np.mean(error[10:] * error[:-10]) / 4.0 == pytest.approx(np.exp(-1), abs=0.15)
    assert fixes.covariance[0, 0, 0] == pytest.approx(4.25)
    wrong = simulate_recording(rest, gnss=GnssNoise(sigma=0.5, outliers=0.05)).recording.gnss
    size = np.linalg.norm(errors_of(wrong, rest, gnss.times(rest.time[-1]))[:, :2], axis=1)
    assert (size > 4.0).mean() == pytest.approx(0.05, abs=0.01)
    assert wrong.covariance[0, 0, 0] == 0.25  # and does not say so


def test_a_receiver_that_smooths_is_late_where_the_velocity_changes(rest):
    drive = simulate_drive(600.0, 2, rate=10.0)
    gnss = GnssNoise(sigma=0.0, rate=5.0, smoothing=1.0)
    time = gnss.times(drive.time[-1])
    error = errors_of(simulate_recording(drive, gnss=gnss).recording.gnss, drive, time)
    motion, before = drive.at(time), drive.at(time - 0.2)
    acceleration = np.linalg.norm(motion.velocity - before.velocity, axis=1) / 0.2
    # critically damped: behind by the acceleration times the time constant squared, for one that lasts
    assert 0.5 < np.linalg.norm(error, axis=1)[acceleration > 1.0].mean() < 3.0
    quiet = simulate_recording(rest, gnss=GnssNoise(sigma=1.0, smoothing=5.0)).recording.gnss
    scatter = errors_of(quiet, rest, GnssNoise().times(rest.time[-1]))[:, 0]
    assert np.std(scatter) < 0.7 and np.corrcoef(scatter[1:], scatter[:-1])[0, 1] > 0.7


def test_dropouts_take_fixes_away_and_leave_the_others_as_they_were(rest):
    whole, holed = (simulate_recording(rest, gnss=GnssNoise(dropouts=n)).recording.gnss for n in (0.0, 30.0))
    gap = np.diff(holed.stamp) * 1e-9
    assert 20 < (gap > 1.5).sum() < 90 and gap.max() < 80
    kept = np.isin(whole.stamp, holed.stamp)
    assert np.array_equal(whole.latitude[kept], holed.latitude)


@pytest.mark.parametrize('options', [{'outliers': -0.1}, {'outliers': 1.5}, {'smoothing': -1.0}, {'dropouts': np.inf}])
def test_a_receiver_that_cannot_be_is_refused(options):
    with pytest.raises(ValueError, match='the receiver'):
        GnssNoise(**options)


def test_the_mounting_is_off_within_its_bound_and_differently_for_each_seed():
    drawn = np.array([list(REALISTIC.distortions(seed)['effects'][0][1].values()) for seed in range(200)])
    assert np.degrees(np.abs(drawn).max(axis=0)) == pytest.approx([5.0] * 3, abs=0.2)
    assert np.abs(drawn.mean(axis=0)).max() < np.radians(0.8)


def test_the_tool_writes_a_realistic_drive(tmp_path, capsys):
    bag = tmp_path / 'bag'
    status = simulate.main(['--output', str(bag), '--duration', '60', '--seed', '5', '--drive', 'realistic', '--rtk',
                            '--mounting-error', '0'])
    assert status == 0 and 'fixes of 0.02 m' in ' '.join(capsys.readouterr().out.split())
    with pytest.warns(RecordingWarning, match='first fix'):
        recording = read_recording(bag, '/imu/data', '/gps/fix', '/reference/odometry', speed_topic='/wheel/speed',
                                   velocity_topic='/gps/velocity', heading_topic='/gps/heading')
    drive = replace(REALISTIC, mounting_error=0.0).drive(60.0, 5)
    assert close(recording.reference.velocity, drive.velocity[::10], 1e-6)
    assert close(wrap(recording.reference.yaw - drive.yaw[::10]), 0.0, 1e-9)
    assert len(recording.speed) == 600 and len(recording.velocity) == len(recording.heading) == 60
    # turn-on biases, and otherwise the sensors of the scene
    still = recording.imu.select(slice(0, 2000))
    assert 0 < np.linalg.norm(still.angular_rate.mean(axis=0)) < 0.01


def test_options_change_one_thing_each(tmp_path):
    bag = tmp_path / 'bag'
    simulate.main(['--output', str(bag), '--duration', '60', '--seed', '5', '--grade', '0.04', '--parked-on-slope'])
    recording = read_recording(bag, '/imu/data', '/gps/fix', '/reference/fix')
    drive = simulate_drive(60.0, 5, grade=0.04, parked_on_slope=True)
    assert close(recording.reference.height, drive.height[::10], 1e-6) and np.ptp(drive.height) > 2
