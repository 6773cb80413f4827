"""Odometry of wheels, lidar or camera: velocity of a point of the vehicle along its axes, and turn rate.

Only the twist is used. The pose drifts, so it is never used as a position.
"""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation.frames import FLU_TO_FRD
from ...parameters.parameter import Parameter
from ...samples import Twists
from ..memory import NAV, Event, Head, Kind, channel_of
from .base import ODOMETRY, TWIST, Measurement, SensorSettings, covariance36
from .events import DIFFERENCE_STEP, LARGEST_VELOCITY, SMALLEST_SPEED_SIGMA, empty, refuse, stated_or, velocity_at
from .geometry import (
    add_body_velocity,
    add_sensor_error,
    along,
    angular_rate,
    arm_of,
    body_velocity,
    sensor_error,
    vehicle_to_level,
)
from .low_pass import unfollowed, unfollowed_turn
from .time_offset import acceleration, add_time_offset


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Velocity forward and to the right, and turn rate clockwise; three components. measured = (1 + scale) true.

    A component that was not measured (NaN in the event) has a row of zeros in H.
    """
    w_x, w_y, w_z = angular_rate(mem, r, sample)
    x, y, z = arm_of(mem, at)
    behind, turns = unfollowed(mem, r, at, body_velocity(mem, r, c, 0)), w_z - unfollowed_turn(mem, r, at, w_z)
    c = vehicle_to_level(mem, r, c)
    scale = int(mem[at + Event.STATE])  # then the scale of the turn rate, and the yaw
    forward = body_velocity(mem, r, c, 0) + w_y * z - w_z * y - behind
    right = body_velocity(mem, r, c, 1) + w_z * x - w_x * z
    mem[at + Event.Z_N] = forward - mem[at + Event.VALUE]
    add_time_offset(mem, at, h, along(acceleration(mem, r), c, 0))
    add_body_velocity(mem, r, h, c, 0, 1.0)
    axle, across, below = int(mem[Head.AXLE]), int(mem[Head.AXLE_ACROSS]), int(mem[Head.AXLE_BELOW])
    if mem[at + Event.AT_AXLE] == 0.0:
        axle = across = below = -1
    if across >= 0:
        mem[h + across] = w_z
    if below >= 0:
        mem[h + below] = -w_y
    if scale >= 0:
        mem[h + scale] = -forward
    mem[at + Event.Z_E] = mem[at + Event.Z_D] = 0.0
    if measures_sideways(mem, at):
        mem[at + Event.Z_E] = right - mem[at + Event.VALUE + 1]
        add_body_velocity(mem, r, h + n, c, 1, 1.0)
        if scale >= 0:
            mem[h + n + scale] = -right
            mem[h + n + scale + 2] = -forward
        if axle >= 0:
            mem[h + n + axle] = -w_z
        if below >= 0:
            mem[h + n + below] = w_x
    if channel_of(mem, 5) >= 0 and not math.isnan(mem[at + Event.VALUE + 2]):
        turn_scale = mem[r + NAV + scale + 1] if scale >= 0 else 0.0
        # measured = (1 + scale) (gyroscope reading - its error), linearised at the estimates of both, as both may be
        # large; `update` subtracts H times the estimates
        error = sensor_error(mem, r, sample, 5)
        mem[at + Event.Z_D] = turns + error + turn_scale * error - mem[at + Event.VALUE + 2]
        mem[at + Event.Z_D] += add_sensor_error(mem, h + 2 * n, sample, 5, 1.0 + turn_scale)
        if scale >= 0:
            mem[h + 2 * n + scale + 1] = -turns
    return 3


@njit(_nrt=False)
def measures_sideways(mem, at):
    """Whether the event at `at` has a velocity to the right."""
    return not math.isnan(mem[at + Event.VALUE + 1])


def turned(twists, yaw: float):
    """`twists` in axes that are turned to the left by `yaw`, rad. What has no velocity sideways stays as it is."""
    if yaw == 0.0:
        return twists
    forward, right = twists.twist[:, 0], twists.twist[:, 1]
    along = np.column_stack([math.cos(yaw) * forward - math.sin(yaw) * right,
                             math.sin(yaw) * forward + math.cos(yaw) * right])
    twist = twists.twist.copy()
    sideways = np.isfinite(right) & (right != 0.0)
    twist[sideways, :2] = along[sideways]
    return replace(twists, twist=twist)


class Twist(Measurement):
    observe = staticmethod(observe)
    kind, name, samples, unit, default_sigma = Kind.TWIST, 'twist', Twists, 'm/s', 0.1
    topic_text = ('Topic of the odometry of wheels, a lidar or a camera, base_link: twist of nav_msgs/Odometry or '
                  'geometry_msgs/TwistWithCovarianceStamped; the source must not use the fixes')
    components, has_arm, has_lag = 2, True, True
    messages = {ODOMETRY: ('twist.twist.linear', 'twist.twist.angular', 'twist.covariance'),
                TWIST: ('twist.twist.linear', 'twist.twist.angular', 'twist.covariance')}
    written_to = '/wheel/odometry'
    #: white noise forward, m/s, to the right, m/s (0: not measured), and of the turn rate, rad/s; standard deviations
    #: of the two scale factor errors, drawn for each seed
    simulated_with = {'twist_rate': 0.0, 'twist_sigma': 0.05, 'twist_lateral_sigma': 0.0,
                      'twist_turn_sigma': 0.01, 'twist_scale': 0.01, 'twist_turn_scale': 0.03}

    def parameters(self):
        return (
            *super().parameters(),
            Parameter(f'{self.name}.turn_sigma', 0.0, 'rad/s', 'Standard deviation of its turn rate; 0: that of the '
                      'message.', minimum=0.0, maximum=1000.0),
            Parameter(f'{self.name}.default_turn_sigma', 0.05, 'rad/s', 'Standard deviation where the message has '
                      'none.', positive=True, maximum=1000.0),
            self.factor_parameter('m/s, positive forward', '0.01 for cm/s, -1 where forward is negative'),
            Parameter(f'{self.name}.scale_sigma', 0.02, '-', 'Standard deviation of the scale factor error of the '
                      'velocity, which is estimated: measured = (1 + scale) true.', minimum=1e-6, maximum=0.5),
            Parameter(f'{self.name}.turn_scale_sigma', 1.0, '-', 'Standard deviation of the scale factor error of the '
                      'turn rate, which is estimated: the track of the wheels may be unknown, skid-steered wheels slip '
                      'sideways, and some sources count turns to the right.',
                      minimum=1e-6, maximum=10.0),
            Parameter(f'{self.name}.yaw', 0.0, 'rad', 'Angle by which its axes are turned against those of base_link, '
                      'counter-clockwise seen from above.', minimum=-2 * math.pi, maximum=2 * math.pi),
            Parameter(f'{self.name}.yaw_sigma', 0.05, 'rad', 'Standard deviation of what is left of that angle, which '
                      'is estimated where the velocity sideways is measured: lidars and cameras are mounted to some '
                      'degrees.', minimum=1e-6, maximum=math.pi))

    def states(self, values):
        return {self.state: (values[f'{self.name}.scale_sigma'], 0.0),
                f'{self.name}_turn_scale': (values[f'{self.name}.turn_scale_sigma'], 0.0),
                f'{self.name}_yaw': (values[f'{self.name}.yaw_sigma'], 0.0), **self.axle_states(values)}

    @property
    def state(self):
        return f'{self.name}_scale'

    def settings(self, values):
        turn = SensorSettings(values[self.topic], values[f'{self.name}.turn_sigma'],
                              values[f'{self.name}.default_turn_sigma'])
        return replace(super().settings(values), turn=turn, yaw=values[f'{self.name}.yaw'])

    def declared(self, settings, twists):
        factor = np.array([settings.factor, settings.factor, 1.0])
        return turned(replace(twists, twist=factor * twists.twist, variance=factor**2 * twists.variance), -settings.yaw)

    def events(self, settings, twists):
        twists = self.declared(settings, twists)
        n, twist = len(twists), twists.twist.copy()
        r, reasons = empty(Kind.TWIST, n), {}
        with np.errstate(invalid='ignore'):
            refuse(reasons, ~(np.abs(twist).max(axis=1) < LARGEST_VELOCITY), lambda i: self.refusal(twist[i]))
        # drivers fill a component that they do not measure with zero and a small variance
        twist[:, 1:][twist[:, 1:] == 0.0] = np.nan
        r[:, Event.VALUE:Event.VALUE + 3] = twist
        for column, axis, of in ((Event.R_NN, 0, settings), (Event.R_EE, 1, settings), (Event.R_DD, 2, settings.turn)):
            r[:, column] = stated_or(twists.variance[:, axis], of, SMALLEST_SPEED_SIGMA)
        return r, reasons, {}

    def refusal(self, twist):
        """Why a twist (3,), forward-right-clockwise, is refused, in words."""
        return f'odometry {twist[0]:g} m/s forwards, {-twist[1]:g} m/s to the left, {-twist[2]:g} rad/s: dropped'

    def off(self, measured, innovation):
        return f'odometry {measured:.2f} m/s forwards where {measured + innovation[0]:.2f} m/s was expected'

    def read(self, fields, message):
        covariance = fields['twist.covariance']
        linear, angular = fields['twist.twist.linear'] @ FLU_TO_FRD, fields['twist.twist.angular'] @ FLU_TO_FRD
        return Twists(stamp=fields['stamp'], received=fields['received'],
                      twist=np.column_stack([linear[:, :2], angular[:, 2]]), variance=covariance[:, [0, 4, 9]])

    def written(self, twists):
        forward, right, turn = twists.twist.T
        zero = np.zeros(len(twists))
        return {'twist.twist.linear': np.column_stack([forward, -right, zero]),
                'twist.twist.angular': np.column_stack([zero, zero, -turn]),
                'twist.covariance': covariance36(dict(zip((0, 7, 35), twists.variance.T)), len(twists))}

    def simulated(self, drive, errors, effects, rng, instants):
        time, stamp = instants(errors['twist_rate'], 0.0043)
        scale, turn_scale = errors['twist_scale'], errors['twist_turn_scale']
        scale, turn_scale = 1.0 + np.array([scale, turn_scale]) * rng.standard_normal(2)
        velocity = np.einsum('kij,ki->kj', drive.at(time).attitude.as_matrix(), velocity_at(drive, time, self.arm))
        before, after = (np.unwrap(drive.at(time + step).yaw) for step in (-DIFFERENCE_STEP, DIFFERENCE_STEP))
        turn = np.arctan2(np.sin(after - before), np.cos(after - before)) / (2.0 * DIFFERENCE_STEP)
        if self.is_plain:  # at the rear axle, which does not slip sideways
            velocity[:, 0], velocity[:, 1] = drive.path.wheel_speed(time), 0.0
        sideways = errors['twist_lateral_sigma']
        sigma = np.array([errors['twist_sigma'], sideways, errors['twist_turn_sigma']])
        twist = np.column_stack([scale * velocity[:, :2], turn_scale * turn])
        twist += sigma * rng.standard_normal(twist.shape)
        if not sideways:
            twist[:, 1] = 0.0
        return turned(Twists(stamp, stamp.copy(), twist, np.tile(sigma**2, (len(time), 1))),
                      sum(effect.turned(self.name, values) for effect, values in effects))
