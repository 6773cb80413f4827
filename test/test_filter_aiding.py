"""Speed, velocity, heading and the constraint with optional states, against the dense textbook Kalman update."""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import (
    LATITUDE,
    LONGITUDE,
    attitude_of,
    central_difference,
    configure,
    fix_event,
    input_event,
    newest,
    random_covariance,
    second_order_variance,
    started,
    state_and_covariance,
    statistics_at,
    take_event,
    take_sample,
    velocity_of,
)
from scipy.spatial.transform import Rotation

from mems_ins_fusion.filter.advance import TAKEN
from mems_ins_fusion.filter.measurements.time_offset import AVERAGED
from mems_ins_fusion.filter.memory import INPUT_SIZE, NAV, PLANAR, Event, Head, Kind, Nav, Verdict, views
from mems_ins_fusion.filter.trust import displacement
from mems_ins_fusion.filter.trust.displacement import Integral
from mems_ins_fusion.filter.trust.scale import PRIOR, Noise, Scale, scale

DT = 0.01
FLU = np.array([1.0, -1.0, -1.0])
SAMPLE = 0.3, 1.0, 9.7, 0.02, -0.03, 0.2  # sensor axes, forward-left-up
#: inputs without any state of their own
WITHOUT_STATES = {'speed_topic': '/speed', 'velocity_topic': '/velocity', 'heading_topic': '/heading',
                  'speed.scale_sigma': 0.0, 'heading.offset_sigma': 0.0,
                  **{f'{name}.time_offset_sigma': 0.0 for name in ('speed', 'velocity', 'heading')}}
#: all optional states there are
STATES = {'imu.mounting_sigma': 0.03, 'vehicle.rear_axle_sigma': 0.4, 'speed.scale_sigma': 0.02,
          'speed_topic': '/speed', 'velocity_topic': '/velocity', 'heading_topic': '/heading', 'twist_topic': '/twist',
          'heading.offset_sigma': 0.0, 'twist.scale_sigma': 0.02, 'twist.turn_scale_sigma': 0.1,
          'vehicle.non_holonomic': True, 'vehicle.non_holonomic_angle_sigma': 0.01,
          'gnss.coloured_noise.sigma': 0.8, 'gnss.lever_arm': [1.2, -0.7, 1.5], 'vehicle.rear_axle': [-1.1, 0.3, -0.6]}
OPTIONAL = {'coloured_n': 0.8, 'coloured_e': 0.8, 'mounting_pitch': 0.03, 'mounting_yaw': 0.03, 'axle_x': 0.4,
            'axle_z': 0.4, 'speed_scale': 0.02, 'axle_y': 0.4, 'twist_scale': 0.02, 'twist_turn_scale': 0.1,
            'twist_yaw': 0.05, **{f'{name}_time_offset': 0.1 for name in ('speed', 'velocity', 'twist', 'heading')}}
ARM, AXLE = FLU * STATES['gnss.lever_arm'], FLU * STATES['vehicle.rear_axle']
ATTITUDE = (0.05, -0.08, 0.7)


class Model:
    """What each sensor would measure, as a function of the filter's errors e (n,), written with vectors and rotations.

    The gyroscopes' error is in the rate at the lever arms only by its estimate, as in the filter. acceleration: (3,)
    m/s^2 in n, with which the velocity has changed lately.
    """

    def __init__(self, config, memory, acceleration=np.zeros(3)):
        self.acceleration = acceleration
        self.config, self.layout = config, config.layout
        self.velocity, self.attitude = velocity_of(config, memory), attitude_of(config, memory)
        x, _ = state_and_covariance(config, memory)
        self.rate = FLU * SAMPLE[3:]
        gyroscopes = [self.layout.n_navigation + i * self.layout.order
                      for i, axis in enumerate(config.channel_axes) if axis >= 3]
        if config.mechanization == PLANAR:
            self.rate = np.array([0.0, 0.0, self.rate[2] - x[gyroscopes[0]]])
        else:
            self.rate = self.rate - x[gyroscopes]
        self.sits, self.estimate, self.gyroscope = self.vehicle(x), x, gyroscopes[-1]

    def of(self, e, name):
        return e[self.layout.index(name)] if self.layout.index(name) >= 0 else 0.0

    def vehicle(self, e):
        """Rotation from the vehicle's axes to the body's."""
        return Rotation.from_euler('ZYX', [self.of(e, 'mounting_yaw'), self.of(e, 'mounting_pitch'), 0.0])

    def true(self, e):
        """Velocity in n and attitude with the error taken out."""
        velocity = self.velocity.copy()
        if self.config.mechanization == PLANAR:
            velocity[:2] -= e[2:4]
            return velocity, Rotation.from_euler('z', -e[4]) * self.attitude
        return velocity - e[3:6], Rotation.from_rotvec(-e[6:9]) * self.attitude

    def speed(self, e):
        velocity, attitude = self.true(e)
        arm = AXLE + np.array([0.0, self.of(e, 'axle_y'), self.of(e, 'axle_z')])
        # along the vehicle's axis as it is estimated: across it nothing moves that an error of that could turn in
        at_axle = (attitude * self.sits).inv().apply(velocity) + np.cross(self.rate, arm)
        return (1 + self.of(e, 'speed_scale')) * at_axle[:1] - self.of(e, 'speed_time_offset') * self.faster()

    def faster(self):
        """(1,) by what the speed grows in a second."""
        return (self.attitude * self.sits).inv().apply(self.acceleration)[:1]

    def twist(self, e):
        def at_axle(state):
            velocity, attitude = self.true(state)
            axle = AXLE + np.array([self.of(state, name) for name in ('axle_x', 'axle_y', 'axle_z')])
            return (attitude * self.sits).inv().apply(velocity) + np.cross(self.rate, axle)

        def turn_rate(state):  # of which the scale may be large, and is one with the gyroscope's error
            return np.array([(1 + self.of(state, 'twist_turn_scale')) * (FLU[2] * SAMPLE[5] - state[self.gyroscope])])
        slope = central_difference(lambda away: turn_rate(self.estimate + away), len(e), 1e-5)
        linear = turn_rate(self.estimate) + slope @ (e - self.estimate)
        twist = np.append((1 + self.of(e, 'twist_scale')) * at_axle(e)[:2], linear)
        twist[1] += self.of(e, 'twist_yaw') * at_axle(np.zeros(len(e)))[0]
        twist[0] -= self.of(e, 'twist_time_offset') * self.faster()[0]
        return twist

    def antenna_velocity(self, e):
        velocity, attitude = self.true(e)
        velocity = velocity - self.of(e, 'velocity_time_offset') * self.acceleration
        return (velocity + attitude.apply(np.cross(self.rate, ARM)))[:2 if self.config.mechanization == PLANAR else 3]

    def heading(self, e):
        _, attitude = self.true(e)
        return np.array([attitude.as_euler('ZYX')[0] + self.of(e, 'mounting_yaw')
                         - self.of(e, 'heading_time_offset') * self.rate[2]])

    def across(self, e):
        """Velocity to the right and down at the axle that does not steer, in the vehicle's own axes: zero."""
        velocity, attitude = self.true(e)
        # the lever arm is short: how its part turns with an error of the mounting is of second order
        at_axle = np.cross(self.sits.inv().apply(self.rate),
                           AXLE + np.array([self.of(e, name) for name in ('axle_x', 'axle_y', 'axle_z')]))
        seen = (attitude * self.vehicle(e)).inv().apply(velocity)
        return (seen + at_axle)[1:2 if self.config.mechanization == PLANAR else 3]

    def estimated_mounting(self, x):
        """Errors (n,) of which only the mounting is not zero."""
        return self.only(x, 'mounting_yaw', 'mounting_pitch')

    def only(self, x, *names):
        """Errors (n,) of which only these are not zero."""
        states = [i for i in map(self.layout.index, names) if i >= 0]
        e = np.zeros(len(x))
        e[states] = x[states]
        return e


def start_of(config, rng, feedback, velocity, tilt=0.03, force=0.1):
    layout = config.layout
    navigation = [2, 2, .3, .3, .03] if config.mechanization == PLANAR else [2, 2, 3, .3, .3, .3, tilt, tilt, .03]
    sensors = [force if axis < 3 else .01 for axis in config.channel_axes for _ in range(layout.order)]
    scale = np.array(navigation + sensors + [OPTIONAL[name] for name in layout.names[-len(config.extras):]])
    x = 0.3 * scale * rng.standard_normal(layout.n)
    if feedback == 'closed':
        x[:layout.n_navigation] = 0.0
    attitude = (0.0, 0.0, ATTITUDE[2]) if config.mechanization == PLANAR else ATTITUDE
    velocity = Rotation.from_euler('ZYX', attitude[::-1]).apply(velocity)
    return {'x': x, 'p': random_covariance(layout.n, rng, scale), 'attitude': attitude, 'velocity': velocity}


def assert_corrected(config, before, after, x, p):
    """`after` is `before` with estimate x and covariance p: the navigation errors fed back in a closed loop."""
    n = config.layout.n_navigation
    closed = not config.open_loop
    estimate, covariance = state_and_covariance(config, after)
    sigma = np.sqrt(np.diag(p))
    assert covariance / np.outer(sigma, sigma) == pytest.approx(p / np.outer(sigma, sigma), abs=1e-6)
    expected = np.concatenate([np.zeros(n), x[n:]]) if closed else x
    assert (estimate - expected) / sigma == pytest.approx(np.zeros(len(x)), abs=1e-6)
    taken_out = np.concatenate([x[:n] if closed else np.zeros(n), np.zeros(len(x) - n)])
    velocity, attitude = Model(config, before).true(taken_out)
    assert velocity_of(config, after) == pytest.approx(velocity, abs=1e-6)
    assert (attitude_of(config, after) * attitude.inv()).magnitude() < 1e-6


EACH = pytest.mark.parametrize(('mechanization', 'feedback', 'model'), [
    (mechanization, feedback, model) for mechanization in ('planar', 'strapdown')
    for feedback, model in (('closed', 'gauss_markov'), ('open', 'autoregressive'))])
SENSORS = {Kind.SPEED: ('speed', [0.04]), Kind.VELOCITY: ('antenna_velocity', [0.09, 0.04, 0.25]),
           Kind.HEADING: ('heading', [0.02**2]), Kind.TWIST: ('twist', [0.04, 0.09, 0.01])}


def one_deviation_tells_nothing_new(config, memory):
    """Scales are known and about 1, ways have been compared with those of fixes, the last message was long ago."""
    seen = views(memory)[2][0][-INPUT_SIZE * config.layout.inputs:].reshape(-1, INPUT_SIZE)
    seen[:, [Noise.SCALE + Scale.LOG, Noise.SCALE + Scale.REDUCED, Noise.SCALE + Scale.TIME, Integral.COMPARED]] = (
        -0.05, PRIOR, DT - 10.0, 1.0)


@EACH
@pytest.mark.parametrize(('sigmas', 'verdict'), [(0.8, Verdict.USED), (4.5, Verdict.WEIGHTED),
                                                 (9.0, Verdict.WEIGHTED)])
@pytest.mark.parametrize('kind', SENSORS, ids=['speed', 'velocity', 'heading', 'twist'])
def test_a_measurement_corrects_as_the_dense_kalman_update(kind, sigmas, verdict, mechanization, feedback, model):
    config = configure(STATES, mechanization=mechanization, feedback=feedback, sensor_error_model=model)
    assert set(config.layout.names[-len(config.extras):]) == set(OPTIONAL) - (
        {'mounting_pitch', 'axle_z'} if mechanization == 'planar' else set())
    start = start_of(config, np.random.default_rng(8), feedback, (11.0, 0.8, -0.4))
    before, after = started(config, **start), started(config, **start)
    one_deviation_tells_nothing_new(config, after)
    velocity = velocity_of(config, before)
    take_sample(before, DT, *SAMPLE)
    # given a value that is so many sigmas of the innovation away from what is expected
    x0, p0 = state_and_covariance(config, before)
    name, variances = SENSORS[kind]
    # the filter averages the acceleration; it had none before the sample
    acceleration = (velocity_of(config, before) - velocity) / (AVERAGED + DT)
    measured = getattr(Model(config, before, acceleration), name)
    h = -central_difference(measured, len(x0), 1e-5)
    k = len(h)
    judged = min(k, 2)
    r = np.diag(variances[:k])
    s = h @ p0 @ h.T + r
    away = np.zeros(k)
    away[:judged] = np.linalg.cholesky(s[:judged, :judged])[:, 0] * sigmas
    if k > 2:
        away[2] = 0.5 * math.sqrt(s[2, 2])
    event = input_event(config, DT, kind)
    event[Event.VALUE:Event.VALUE + k] = measured(np.zeros(len(x0))) - h @ x0 - away
    event[[Event.R_NN, Event.R_EE, Event.R_DD][:k]] = variances[:k]
    if kind == Kind.HEADING:
        event[Event.VALUE] += 2 * math.pi  # another name of the same
    assert take_event(after, event) == TAKEN
    take_sample(after, DT, *SAMPLE)
    # then innovation and verdict are these
    kept = views(after)[4][0]
    assert kept[Event.VERDICT] == verdict
    assert kept[Event.Z_N:Event.Z_N + k] == pytest.approx(away, abs=1e-6)
    assert kept[Event.NIS] == pytest.approx(sigmas**2, rel=1e-6)
    # and so is the correction; one that fits badly has just so much noise that it is three sigmas away
    if verdict == Verdict.WEIGHTED:
        r[:judged, :judged] += (sigmas**2 / 9 - 1) * s[:judged, :judged]
        s = h @ p0 @ h.T + r
        assert away[:judged] @ np.linalg.solve(s[:judged, :judged], away[:judged]) == pytest.approx(9.0)
        assert kept[Event.WEIGHT] == pytest.approx(9 / sigmas**2)
    gain = p0 @ h.T @ np.linalg.inv(s)
    assert_corrected(config, before, after, x0 + gain @ away, p0 - gain @ s @ gain.T)


@pytest.mark.parametrize(('kind', 'last_fix', 'verdict'), [
    (Kind.SPEED, 1.0, Verdict.REFUSED), (Kind.VELOCITY, 1.0, Verdict.REFUSED), (Kind.HEADING, 1.0, Verdict.WEIGHTED),
    (Kind.SPEED, 20.0, Verdict.WEIGHTED), (Kind.VELOCITY, 20.0, Verdict.WEIGHTED)])
def test_what_is_far_from_what_fixes_say_changes_nothing(kind, last_fix, verdict):
    # given a filter that is sure of its velocity and heading, by a fix of so many seconds ago
    config = configure(WITHOUT_STATES)
    n = config.layout.n
    memory = started(config, p=np.diag([1e-4] * n), velocity=(10.0, 0.0, 0.0))
    views(memory)[2][0][Nav.FIX_TIME] = DT - last_fix
    one_deviation_tells_nothing_new(config, memory)
    without = memory.copy()
    take_sample(without, DT, *SAMPLE)
    # when wheels spin, or something else is far off
    event = input_event(config, DT, kind)
    event[Event.VALUE:Event.VALUE + 3] = (2.0, 0.0, 0.0) if kind == Kind.HEADING else (36.0, 0.0, 0.0)
    event[[Event.R_NN, Event.R_EE, Event.R_DD]] = 0.01
    assert take_event(memory, event) == TAKEN
    take_sample(memory, DT, *SAMPLE)
    # then it is refused while fixes come; without them nobody knows who is right
    assert views(memory)[4][0][Event.VERDICT] == verdict
    same = np.array_equal(state_and_covariance(config, memory)[1], state_and_covariance(config, without)[1])
    assert same == (verdict == Verdict.REFUSED)


@pytest.mark.parametrize(('mechanization', 'feedback', 'model', 'sideways'), [
    ('planar', 'closed', 'gauss_markov', 1.5), ('planar', 'open', 'autoregressive', 1.5),
    ('strapdown', 'closed', 'gauss_markov', 1.5), ('strapdown', 'open', 'autoregressive', 1.5),
    ('planar', 'closed', 'gauss_markov', 15.0)])
def test_the_constraint_with_its_states_corrects_as_the_dense_kalman_update(mechanization, feedback, model, sideways):
    # given a vehicle that moves by its estimate sideways and down, and so certain an acceleration that how vehicles
    # accelerate tells nothing, and gyroscopes without noise
    config = configure({**STATES, 'gyroscope.noise_density': [1e-9]}, mechanization=mechanization, feedback=feedback,
                       sensor_error_model=model)
    start = start_of(config, np.random.default_rng(9), feedback, (11.0, sideways, -1.9), tilt=5e-4, force=5e-3)
    if mechanization == 'strapdown':  # where it is not zero, yaw and pitch are one to second order
        start['x'][config.layout.index('mounting_pitch')] = 0.0
    before, after = started(config, **start), started(config, **start)
    views(before)[0][Head.LATERAL_SIGMA] = 0.0  # never corrected
    for k in range(1, 50):
        for memory in (before, after):
            take_sample(memory, k * DT, *SAMPLE)
        if not np.array_equal(newest(before)[NAV:], newest(after)[NAV:]):
            break
    x0, p0 = state_and_covariance(config, before)
    model_of = Model(config, before)
    mounting = model_of.estimated_mounting(x0)
    vehicle = model_of.attitude * model_of.sits
    forward = vehicle.inv().apply(model_of.velocity)[0]
    h = -central_difference(lambda e: model_of.across(mounting + e), len(x0), 1e-5)
    r = (0.2**2 + (0.01 * forward) ** 2) * np.eye(len(h))
    omitted = second_order_variance(config, p0, vehicle, ('mounting_yaw', 'mounting_pitch'))
    s = h @ p0 @ h.T + r
    z = model_of.across(mounting) - h @ (x0 - mounting)
    nis = z**2 / np.diag(s + omitted)
    assert np.all(nis > 0.05) and np.all((nis < 9) == (sideways < 10))
    # then it is weighted down to three sigmas, and no velocity becomes better known than the linearisation lets it
    noise = np.diag(r) + np.maximum(nis / 9 - 1, 0.0) * np.diag(s + omitted)
    x, p = x0, p0
    for row, value, n, least in zip(h, z, noise, np.diag(omitted)):
        known = row @ p @ row
        n = max(n, 1.0 / (1.0 / least - 1.0 / known))
        gain = p @ row / (known + n)
        x, p = x + gain * (value - row @ (x - x0)), p - np.outer(gain, row @ p)
    assert_corrected(config, before, after, x, p)


def through(kind, value, r, seconds, rate=1.0, fixes=False, velocity=(0.0, 0.0, 0.0), yaw=0.7, sigma_yaw=0.02,
            noise=0.0, begin=0.0):
    """Memory after `seconds` of a vehicle that goes straight on, with a measurement of `value`, one number or more with
    this noise, each 1 / rate s from `begin` on."""
    rng = np.random.default_rng(1)
    config = configure({**WITHOUT_STATES, 'gnss.gate_probability': 0.999999, 'gnss.robust_sigma': 3.0})
    p = np.diag([1.0, 1.0, 0.01, 0.01, sigma_yaw**2, 1e-4, 1e-4, 1e-8])
    memory = started(config, velocity=velocity, attitude=(0.0, 0.0, yaw), p=p)
    north, east = 1.0 / newest(memory)[[Nav.NORTH_SCALE, Nav.EAST_SCALE]]
    for k in range(round(20 * seconds)):
        time = (k + 1) / 20.0
        if (k + 1) % round(20 / rate) == 0 and time > begin:
            event = input_event(config, time, kind)
            event[[Event.R_NN, Event.R_EE, Event.R_DD]] = r
            event[Event.VALUE:Event.VALUE + np.size(value)] = value + noise * rng.standard_normal(np.size(value))
            take_event(memory, event)
        if fixes and (k + 1) % 20 == 10:
            take_event(memory, fix_event(time, LATITUDE + velocity[0] * time / north,
                                          LONGITUDE + velocity[1] * time / east))
        take_sample(memory, time, 0.0, 0.0, 9.81, 0.0, 0.0, 0.0)
    return config, memory


@pytest.mark.parametrize('off', [0.5, 1.5, 3.0])
def test_headings_bring_back_a_filter_that_is_sure_of_a_wrong_one(off):
    # given a filter whose heading is wrong by many sigma, and sixty headings that agree with each other
    config, memory = through(Kind.HEADING, 0.7 + off, 0.03**2, 60.0)
    error = math.remainder(newest(memory)[Nav.YAW] - 0.7 - off, 2 * math.pi)
    sigma = math.sqrt(state_and_covariance(config, memory)[1][4, 4])
    # then it has come to them, or says that it does not know
    assert abs(error) < 0.7 * off and abs(error) < 2.5 * sigma, (error, sigma)


@pytest.mark.parametrize(('kind', 'off'), [(Kind.SPEED, 4.0), (Kind.SPEED, 6.0), (Kind.SPEED, -15.0),
                                            (Kind.VELOCITY, 6.0), (Kind.VELOCITY, -15.0)])
def test_speeds_and_velocities_bring_back_a_filter_that_is_sure_of_a_wrong_velocity(kind, off):
    # given a filter whose speed is wrong by many sigma, no fixes for 10 s (they would confirm it), and then speeds for
    # a minute that agree with each other
    ahead = np.array([math.cos(0.7), math.sin(0.7), 0.0])
    value = 10.0 if kind == Kind.SPEED else 10.0 * ahead
    config, memory = through(kind, value, 0.1**2, 72.0, velocity=(10.0 + off) * ahead, noise=0.1, begin=12.0)
    error = newest(memory)[Nav.V_N:Nav.V_N + 2] @ ahead[:2] - 10.0
    v = config.layout.index('v_n')
    sigma = math.sqrt(ahead[:2] @ state_and_covariance(config, memory)[1][v:v + 2, v:v + 2] @ ahead[:2])
    # then it has come to them, or says that it does not know
    assert abs(error) < 0.7 * abs(off) and abs(error) < 2.5 * sigma, (error, sigma)


def test_headings_that_fit_leave_their_scale_as_it_is():
    config, memory = through(Kind.HEADING, 0.7, 0.03**2, 60.0)
    assert scale(newest(memory), statistics_at(config, Kind.HEADING) + Noise.SCALE) <= 1.0
    assert math.sqrt(state_and_covariance(config, memory)[1][4, 4]) < 0.02


def test_a_wheel_speed_in_kilometres_an_hour_does_not_move_a_velocity_that_fixes_confirm():
    velocity = 10.0 * math.cos(0.7), 10.0 * math.sin(0.7), 0.0
    config, memory = through(Kind.SPEED, 36.0, 0.05**2, 60.0, rate=10.0, fixes=True, velocity=velocity)
    row = newest(memory)
    assert math.hypot(row[Nav.V_N] - velocity[0], row[Nav.V_E] - velocity[1]) < 0.3
    # and it is seen how far off it is: 26 of 10 m/s
    seen = statistics_at(config, Kind.SPEED)
    assert displacement.differs(row, seen, Kind.SPEED, displacement.TOLERATED_ERROR)
    assert row[seen + Integral.RELATIVE_ERROR] == pytest.approx(2.6, abs=0.1)
