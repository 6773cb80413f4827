"""Each effect changes what it says, by its formula, and nothing else."""
from __future__ import annotations

import numpy as np
import pytest
from simulation_support import FLU, close

from mems_ins_fusion.effects.base import Effect
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.navigation.earth import gravity, radii
from mems_ins_fusion.sensor_errors.models import GaussMarkov
from mems_ins_fusion.simulation.drive import START_STAMP
from mems_ins_fusion.simulation.simulation import (
    GnssNoise,
    SensorErrors,
    SimulatedAiding,
    simulate_drive,
    simulate_recording,
)

SENSORS = SensorErrors((GaussMarkov(0.05, 100.0),) * 3, (GaussMarkov(1e-3, 100.0),) * 3, (0.01,) * 3, (1e-4,) * 3)
DURATION = 240.0
RECEIVER = GnssNoise(sigma=1.5, rate=5.0)


@pytest.fixture(scope='module')
def drive():
    return simulate_drive(DURATION, 2)


def simulated(drive, name, **values):
    return simulate_recording(drive, SENSORS, RECEIVER, [(EFFECTS[name], values)], seed=6)


def changes(drive, name, **values):
    """What an effect adds to the same sensor errors: specific force, angular rate in body axes, and fixes (NED, m)."""
    with_it, without = simulated(drive, name, **values).recording, simulate_recording(drive, SENSORS, RECEIVER, seed=6)
    without = without.recording
    meridian, prime_vertical = radii(without.gnss.latitude)
    h = without.gnss.height
    fixes = np.column_stack([(with_it.gnss.latitude - without.gnss.latitude) * (meridian + h),
                             (with_it.gnss.longitude - without.gnss.longitude) * (prime_vertical + h)
                             * np.cos(without.gnss.latitude), -(with_it.gnss.height - h)])
    return ((with_it.imu.specific_force - without.imu.specific_force) * FLU,
            (with_it.imu.angular_rate - without.imu.angular_rate) * FLU, fixes)


# which of specific force x, y, z, angular rate x, y, z, fixes north, east, down each effect may touch on a level road
TOUCHED = {
    'gnss_time_offset': '......NE.', 'gnss_lever_arm': '......NED', 'gnss_coloured_noise': '......NE.',
    'accelerometer_scale': 'xy.......', 'gyroscope_scale': '.....z...', 'mounting_rotation': 'xyzxyz...',
    'tilt': 'xyzxyz...', 'g_sensitivity': '.....z...', 'temperature': 'xy...z...',
    'accelerometer_lever_arm': 'xy.......', 'sideslip': 'xy...z...',
    'gnss_lag': '......NE.', 'gnss_latency': '......NE.', 'gnss_outliers': '......NED', 'rear_axle': 'xy....NE.',
    **dict.fromkeys(('speed_scale', 'speed_time_offset', 'velocity_time_offset', 'heading_time_offset',
                     'twist_time_offset', 'magnetometer_time_offset', 'pressure_time_offset', 'speed_lag',
                     'velocity_lag', 'heading_lag', 'twist_lag', 'magnetometer_lag', 'pressure_lag',
                     'twist_yaw', 'pressure_dynamic'), '.........'),
    'gyroscope_warm_up': '.....z...', 'imu_repeats': 'xyzxyz...', 'imu_jitter': '.........',
}


@pytest.mark.parametrize('name', EFFECTS)
def test_an_effect_touches_what_it_should_and_nothing_else(drive, name):
    prior = {p.name: p.prior_scale for p in EFFECTS[name].parameters}
    force, rate, fixes = changes(drive, name, **prior)
    size = np.concatenate([np.abs(change).max(axis=0) for change in (force, rate, fixes)])
    expected = np.array([c != '.' for c in TOUCHED[name]])
    assert np.all(size[expected] > 1e-5)
    # rounding: a difference of radians of latitude is worth 1 nm; gravity a metre further north is another by 8e-9
    assert np.all(size[~expected] < 1e-8)


@pytest.mark.parametrize('name', EFFECTS)
def test_an_effect_of_size_zero_is_no_effect(drive, name):
    # given all parameters at zero but those that scale nothing, a time constant
    values = {p.name: 0.0 for p in EFFECTS[name].parameters if p.name not in ('tau', 'at') or name.endswith('_lag')}
    for change in changes(drive, name, **values):
        assert np.abs(change).max() < 1e-8


@pytest.mark.parametrize('name', EFFECTS)
def test_registry_and_effect_agree(name):
    effect = EFFECTS[name]
    assert effect.name == name and effect.principal in [p.name for p in effect.parameters]
    assert all(p.prior_scale > 0 and p.unit for p in effect.parameters)


def test_time_offset_makes_a_fix_describe_an_earlier_time(drive):
    offset = 0.15
    _, _, fixes = changes(drive, 'gnss_time_offset', time_offset=offset)
    time = RECEIVER.times(DURATION)
    speed = np.interp(time, drive.time, np.linalg.norm(drive.velocity, axis=1))
    # stamped t, it describes t - offset: it lies behind the vehicle, by speed times offset
    behind = -np.sum(fixes[:, :2] * drive.at(time).velocity[:, :2], axis=1) / np.maximum(speed, 1e-9)
    moving = speed > 1.0
    assert close(behind[moving], offset * speed[moving], 0.5 * 2.5 * offset**2 + 1e-6)


def test_lever_arm_is_forward_left_up(drive):
    _, _, fixes = changes(drive, 'gnss_lever_arm', x=1.2, y=0.4, z=1.5)
    yaw = drive.at(RECEIVER.times(DURATION)).yaw
    expected = np.column_stack([1.2 * np.cos(yaw) + 0.4 * np.sin(yaw), 1.2 * np.sin(yaw) - 0.4 * np.cos(yaw),
                                np.full(len(yaw), -1.5)])
    assert close(fixes, expected, 1e-5)  # at a radius that differs by 1.5 m in 6.4e6


def test_coloured_noise_is_gauss_markov():
    # given 5 h of fixes at rest
    rest = simulate_drive(18000.0, 1, rate=1.0, standstill=18000.0)
    sigma, tau, dt = 2.0, 20.0, 0.2
    _, _, fixes = changes(rest, 'gnss_coloured_noise', sigma=sigma, tau=tau)
    n = len(fixes) - 1
    decay = np.exp(-dt / tau)
    for axis in (0, 1):
        driving = fixes[1:, axis] - decay * fixes[:-1, axis]
        assert np.mean(driving**2) == pytest.approx(sigma**2 * (1 - decay**2), rel=4 * np.sqrt(2 / n))
        assert abs(np.corrcoef(driving, fixes[:-1, axis])[0, 1]) < 4 / np.sqrt(n)
        # the squares' correlation time is tau / 2, so that 18000 s hold 18000 / tau independent ones
        assert np.mean(fixes[:, axis]**2) == pytest.approx(sigma**2, rel=4 * np.sqrt(2 * tau / 18000))
    assert abs(np.corrcoef(fixes[:, 0], fixes[:, 1])[0, 1]) < 4 * np.sqrt(tau / 18000)


def test_coloured_noise_forgets_over_an_outage():
    rest = simulate_drive(400.0, 1, rate=1.0, standstill=400.0)
    effect = EFFECTS['gnss_coloured_noise']
    time = np.array([0.0, 1.0, 300.0])
    errors = np.array([effect.distort_fixes(rest, time, np.zeros((3, 3)), {'sigma': 1.0, 'tau': 10.0},
                                            np.random.default_rng(seed))[:, 0] for seed in range(2000)])
    correlation = np.corrcoef(errors.T)
    assert close(correlation[0, 1], np.exp(-0.1), 0.02)
    assert abs(correlation[0, 2]) < 4 / np.sqrt(2000)
    assert np.var(errors, axis=0) == pytest.approx(np.ones(3), rel=4 * np.sqrt(2 / 2000))


def test_scale_factors_multiply(drive):
    force, _, _ = changes(drive, 'accelerometer_scale', x=0.02, y=-0.03)
    assert close(force, drive.specific_force * [0.02, -0.03, 0], 1e-12)
    _, rate, _ = changes(drive, 'gyroscope_scale', z=0.015)
    assert close(rate, drive.angular_rate * [0, 0, 0.015], 1e-12)


def test_g_sensitivity_adds_to_the_vertical_gyroscope(drive):
    _, rate, _ = changes(drive, 'g_sensitivity', x=3e-4, y=-5e-4)
    assert close(rate[:, 2], drive.specific_force @ [3e-4, -5e-4, 0], 1e-15)


@pytest.mark.parametrize('angle, seen', [
    # turned to the left, forward acceleration shows on the right; nose down, gravity's reaction shows backwards on the
    # forward axis; rolled to the right, its left axis looks up
    ('yaw', lambda f, a: np.column_stack([f[:, 0] - a * f[:, 1], f[:, 1] + a * f[:, 0], f[:, 2]])),
    ('pitch', lambda f, a: np.column_stack([f[:, 0] + a * f[:, 2], f[:, 1], f[:, 2] - a * f[:, 0]])),
    ('roll', lambda f, a: np.column_stack([f[:, 0], f[:, 1] + a * f[:, 2], f[:, 2] - a * f[:, 1]])),
])
def test_mounting_rotation_turns_the_sensors_in_forward_left_up(drive, angle, seen):
    a = 1e-4  # small: the formulas are first order
    force, rate, _ = changes(drive, 'mounting_rotation', **{angle: a})
    assert close(force, seen(drive.specific_force, a) - drive.specific_force, a**2 * 20)
    assert close(rate, seen(drive.angular_rate, a) - drive.angular_rate, a**2)


def test_mounting_rotation_is_what_a_wrong_declaration_does(drive):
    # given sensors mounted at 0.1 rad and declared at 0.04, as yaw: the same as 0.06 undeclared
    turned = simulate_recording(drive, mounting_rpy=(0, 0, 0.1)).recording.imu
    undeclared = simulate_recording(drive, mounting_rpy=(0, 0, 0.04),
                                    effects=[(EFFECTS['mounting_rotation'], {'yaw': 0.06})]).recording.imu
    assert close(undeclared.specific_force, turned.specific_force, 1e-12)


def test_tilt_leaks_gravity_in_proportion_to_acceleration(drive):
    k_pitch, k_roll = 0.01, 0.008
    force, rate, _ = changes(drive, 'tilt', pitch_per_acceleration=k_pitch, roll_per_acceleration=k_roll)
    g = gravity(drive.latitude[0], drive.height[0])
    acceleration = drive.specific_force[:, :2]
    # nose up by k a_x shows g k a_x more, leaning outwards by k a_y shows g k a_y more; second order left out
    bound = 10 * (0.01 * 2.5)**2 + 2.5 * 0.01 / 10
    assert close(force[:, 0], g * k_pitch * acceleration[:, 0], bound)
    assert close(force[:, 1], g * k_roll * acceleration[:, 1], bound)
    assert force[:, 0].max() > 4 * bound
    # the attitude's rate shows in the gyroscopes: nose up is positive about the right axis
    jerk = np.gradient(acceleration, 1 / drive.rate, axis=0)
    assert close(rate[:, 1], k_pitch * jerk[:, 0], 0.025 * 0.6 + 1e-4)
    straight = np.abs(drive.angular_rate[:, 2]) < 1e-9
    assert close(rate[straight, 1], k_pitch * jerk[straight, 0], 2e-4)
    assert np.abs(rate[straight, 1]).max() > 5e-3


def test_tilt_and_sideslip_are_part_of_the_true_attitude(drive):
    tilted = simulated(drive, 'tilt', pitch_per_acceleration=0.01).drive
    middle = np.gradient(np.linalg.norm(drive.velocity, axis=1), drive.time)
    assert close(tilted.pitch, 0.01 * middle, 1e-4)
    slipping = simulated(drive, 'sideslip', angle_per_acceleration=0.02)
    speed = np.linalg.norm(drive.velocity, axis=1)
    lateral = speed * np.gradient(drive.yaw, drive.time)
    to_velocity = np.arctan2(drive.velocity[:, 1], drive.velocity[:, 0]) - slipping.drive.yaw
    moving = speed > 0.5
    moving[-1] = False  # where the differences of yaw are one-sided
    assert close(np.sin(to_velocity[moving]), 0.02 * lateral[moving], 1e-4)
    assert close(slipping.recording.reference.latitude, drive.latitude, 1e-15)


def test_temperature_moves_the_biases(drive):
    simulation = simulated(drive, 'temperature', accelerometer_x=0.004, accelerometer_y=-0.002, gyroscope_z=1e-4)
    force, rate, _ = changes(drive, 'temperature', accelerometer_x=0.004, accelerometer_y=-0.002, gyroscope_z=1e-4)
    recorded = simulation.recording.temperature
    warmth = np.interp(drive.stamp, recorded.stamp, recorded.celsius) - 25.0
    assert np.ptp(warmth) > 5
    bound = 1e-3  # K: between the recorded temperatures, one a second
    assert close(force[:, 0], 0.004 * warmth, 0.004 * bound)
    assert close(force[:, 1], -0.002 * warmth, 0.002 * bound)
    assert close(rate[:, 2], 1e-4 * warmth, 1e-4 * bound)


def test_accelerometers_off_the_reference_point_feel_their_own_acceleration(drive):
    x, y = 0.8, 0.3  # forward, left
    force, _, _ = changes(drive, 'accelerometer_lever_arm', x=x, y=y)
    # the track of that point, differentiated twice, minus that of the reference point, in body axes
    step = 0.02
    time = drive.time[200:-200:7] - 0.5 / drive.rate
    yaw = [drive.at(time + k * step).yaw for k in (-1, 0, 1)]
    arm = [np.column_stack([x * np.cos(a) + y * np.sin(a), x * np.sin(a) - y * np.cos(a)]) for a in yaw]
    acceleration = (arm[0] - 2 * arm[1] + arm[2]) / step**2
    c, s = np.cos(yaw[1]), np.sin(yaw[1])
    expected = np.column_stack([c * acceleration[:, 0] + s * acceleration[:, 1],
                                -s * acceleration[:, 0] + c * acceleration[:, 1]])
    assert close(force[200:-200:7, :2], expected, 2e-3)
    assert np.abs(force).max() > 0.1


def test_effects_outside_the_library_can_be_simulated(drive):
    class Quadratic(Effect):
        name = 'quadratic'
        parameters = EFFECTS['gyroscope_scale'].parameters

        def distort_imu(self, drive, specific_force, angular_rate, values, rng):
            return specific_force + values['z'] * specific_force**2, angular_rate

    simulation = simulate_recording(drive, effects=[(Quadratic(), {'z': 0.01})])
    expected = drive.specific_force + 0.01 * drive.specific_force**2
    assert close(simulation.recording.imu.specific_force, expected * FLU, 1e-12)
    assert simulation.effects == {'quadratic': {'z': 0.01}}


def test_an_unknown_parameter_is_refused(drive):
    with pytest.raises(ValueError, match="tilt has no parameter 'yaw'"):
        simulate_recording(drive, effects=[(EFFECTS['tilt'], {'yaw': 1.0})])


def test_two_effects_add_up(drive):
    both = simulate_recording(drive, effects=[(EFFECTS['tilt'], {'pitch_per_acceleration': 0.01}),
                                              (EFFECTS['gyroscope_scale'], {'z': 0.02})])
    tilted = simulate_recording(drive, effects=[(EFFECTS['tilt'], {'pitch_per_acceleration': 0.01})])
    rate = tilted.recording.imu.angular_rate * [1, 1, 1.02]
    assert close(both.recording.imu.angular_rate, rate, 1e-12)
    assert np.array_equal(both.recording.imu.stamp, both.drive.stamp) and both.drive.stamp[0] == START_STAMP


def test_a_smoothing_receiver_is_a_low_pass(drive):
    # given fixes behind a low pass of 0.8 s: tau dp/dt = (true position) - p
    tau, step = 0.8, 0.01
    time = np.arange(30.0, 200.0, 0.37)
    position = [EFFECTS['gnss_lag'].distort_fixes(drive, time + k * step, drive.at(time + k * step).position,
                                                  {'tau': tau}, None) for k in (-1, 0, 1)]
    rate = (position[2] - position[0]) / (2 * step)
    assert close(tau * rate, drive.at(time).position - position[1], 2e-3)
    # and at constant speed it is late by that
    steady = np.linalg.norm(drive.at(time).position - position[1], axis=1) / tau
    assert steady.max() == pytest.approx(np.linalg.norm(drive.velocity, axis=1).max(), rel=0.05)


def test_a_latency_drifts_and_steps():
    time = np.arange(101.0)
    late = time - EFFECTS['gnss_latency'].fix_times(time, {'step': 0.2, 'drift': 1e-3, 'at': 0.3})
    assert close(late, 1e-3 * time + np.where(time >= 30.0, 0.2, 0.0), 1e-12)


def test_outliers_are_as_many_and_as_large_as_they_should_be():
    rest = simulate_drive(4000.0, 1, rate=1.0, standstill=4000.0)
    _, _, fixes = changes(rest, 'gnss_outliers', share=0.1, sigma=30.0)
    wrong = np.abs(fixes).max(axis=1) > 1e-6
    assert wrong.mean() == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / len(wrong)))
    assert fixes[wrong].std() == pytest.approx(30.0, rel=4 / np.sqrt(6 * wrong.sum()))


def test_the_imu_is_where_the_rear_axle_is_seen_from_it(drive):
    moved = simulated(drive, 'rear_axle', x=-1.5).drive
    arm = moved.attitude.inv().apply(moved.position - drive.position)
    assert close(arm, [1.5, 0.0, 0.0], 1e-9)


def test_a_warming_gyroscope_forgets_its_bias(drive):
    _, rate, _ = changes(drive, 'gyroscope_warm_up', z=2e-3, tau=60.0)
    assert close(rate[:, 2], 2e-3 * np.exp(-drive.time / 60.0), 1e-12)


def test_wheels_of_another_size_measure_another_speed(drive):
    aiding = SimulatedAiding(speed_rate=10.0, speed_scale=0.0)
    speeds = [simulate_recording(drive, effects=effects, aiding=aiding).recording.speed
              for effects in ([], [(EFFECTS['speed_scale'], {'scale': 0.04})])]
    true = drive.path.wheel_speed((speeds[0].stamp - START_STAMP) * 1e-9)
    assert close(speeds[1].speed - speeds[0].speed, 0.04 * true, 1e-9)


def test_repeated_samples_repeat_the_one_before(drive):
    plain, disturbed = (simulate_recording(drive, SENSORS, effects=effects).recording.imu
                        for effects in ([], [(EFFECTS['imu_repeats'], {'share': 0.4})]))
    repeats = (disturbed.specific_force[1:] == disturbed.specific_force[:-1]).all(axis=1)
    assert repeats.mean() == pytest.approx(0.4, abs=4 * np.sqrt(0.24 / len(repeats)))
    own = np.append(True, ~repeats)
    assert np.array_equal(disturbed.angular_rate[own], plain.angular_rate[own])
    assert np.array_equal(disturbed.stamp, plain.stamp)


def test_late_stamps_keep_their_order(drive):
    plain, disturbed = (simulate_recording(drive, SENSORS, effects=effects).recording.imu
                        for effects in ([], [(EFFECTS['imu_jitter'], {'sigma': 2e-3})]))
    late = (disturbed.stamp - plain.stamp) * 1e-9
    assert late.min() >= 0 and np.diff(disturbed.stamp).min() > 0
    # 2 ms on average, and a little more as the latest push those behind them
    assert 2e-3 < late.mean() < 2.1e-3
    assert np.array_equal(disturbed.specific_force, plain.specific_force)
    assert np.array_equal(disturbed.received, disturbed.stamp)


@pytest.mark.parametrize('name, value', [('speed', 'speed'), ('velocity', 'velocity'), ('heading', 'yaw'),
                                         ('twist', 'twist'), ('magnetometer', 'field')])
def test_what_is_measured_through_a_low_pass_lags_as_a_low_pass_does(drive, name, value):
    # given an input without noise, and a low pass of 0.4 s that follows it 200 times a second
    tau, rate = 0.4, 200.0
    quiet = SimulatedAiding(**{f'{name}_rate': rate}, speed_sigma=0.0, speed_scale=0.0, velocity_sigma=0.0,
                            heading_sigma=0.0, twist_sigma=0.0, twist_turn_sigma=0.0, twist_scale=0.0,
                            twist_turn_scale=0.0, magnetometer_sigma=0.0, magnetometer_disturbance=0.0)
    lagging, plain = (np.asarray(getattr(simulate_recording(drive, SENSORS, RECEIVER, [(
        EFFECTS[f'{name}_lag'], {'tau': lag})], seed=6, aiding=quiet).recording.streams()[name], value))
        for lag in (tau, 0.0))
    plain, lagging = (np.unwrap(one) if value == 'yaw' else one for one in (plain, lagging))
    smooth, weight = plain.copy(), 1.0 - np.exp(-1.0 / (rate * tau))
    for k in range(1, len(smooth)):
        smooth[k] = smooth[k - 1] + weight * (0.5 * (plain[k] + plain[k - 1]) - smooth[k - 1])
    # then it is what comes out of that, and not what goes in
    off = np.abs(lagging - smooth).max()
    assert off < 0.05 * np.abs(plain - smooth).max()


def test_effects_stand_behind_one_option_or_several():
    from mems_ins_fusion.cli.simulate import _parser

    # one option with both was refused as 'unrecognized arguments'
    said = _parser().parse_args('--output x --effect tilt.roll=0.1 tilt.pitch=0.2 --effect imu_jitter=1 --rtk'.split())
    assert said.effect == ['tilt.roll=0.1', 'tilt.pitch=0.2', 'imu_jitter=1'] and said.rtk
