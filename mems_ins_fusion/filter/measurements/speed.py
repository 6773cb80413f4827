"""Wheel speed: speed over ground along the vehicle, at the axle whose wheels are counted, with a scale factor error."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from mems_ins_fusion.compiled import njit

from ...parameters.parameter import Parameter
from ...samples import Speeds
from ..memory import Event, Head, Kind, channel_of
from .base import ODOMETRY, TWIST, Measurement, covariance36
from .events import LARGEST_VELOCITY, SMALLEST_SPEED_SIGMA, empty, refuse, stated_or, velocity_at
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
from .low_pass import unfollowed
from .time_offset import acceleration, add_time_offset


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Speed, positive forward; one component. measured = (1 + scale) true."""
    _, y, z = arm_of(mem, at)
    _, w_y, w_z = angular_rate(mem, r, sample)
    behind = unfollowed(mem, r, at, body_velocity(mem, r, c, 0))
    c = vehicle_to_level(mem, r, c)
    add_body_velocity(mem, r, h, c, 0, 1.0)
    mem[at + Event.Z_N] = body_velocity(mem, r, c, 0) + w_y * z - w_z * y - behind
    add_time_offset(mem, at, h, along(acceleration(mem, r), c, 0))
    across, below = int(mem[Head.AXLE_ACROSS]), int(mem[Head.AXLE_BELOW])
    scale = int(mem[at + Event.STATE])
    if scale >= 0:
        mem[h + scale] = -mem[at + Event.Z_N]
    if mem[at + Event.AT_AXLE] != 0.0:
        if across >= 0:
            mem[h + across] = w_z
        if below >= 0:
            mem[h + below] = -w_y
    elif channel_of(mem, 5) >= 0:  # with a lateral arm the speed contains the turn rate
        mem[at + Event.Z_N] -= y * sensor_error(mem, r, sample, 5)  # `update` subtracts H times the estimate
        mem[at + Event.Z_N] += add_sensor_error(mem, h, sample, 5, -y)
    mem[at + Event.Z_N] -= mem[at + Event.VALUE]
    return 1


class Speed(Measurement):
    observe = staticmethod(observe)
    kind, name, samples, unit, default_sigma = Kind.SPEED, 'speed', Speeds, 'm/s', 0.1
    topic_text = ('Topic of the speed at the rear axle, m/s, forward positive: '
                  'geometry_msgs/TwistWithCovarianceStamped or nav_msgs/Odometry, twist.linear.x')
    offset, has_arm, has_lag = 'scale', True, True
    messages = {TWIST: ('twist.twist.linear', 'twist.covariance'), ODOMETRY: ('twist.twist.linear', 'twist.covariance')}
    written_to = '/wheel/speed'
    #: m/s, white noise of the rear wheels' speed; standard deviation of its scale factor error, drawn for each seed
    simulated_with = {'speed_rate': 0.0, 'speed_sigma': 0.05, 'speed_scale': 0.01}

    def parameters(self):
        return (
            *super().parameters(),
            self.factor_parameter('m/s, positive forward', '0.27778 for km/h, -1 where forward is negative'),
            Parameter(f'{self.name}.scale', 0.0, '-', 'Scale factor error of the speed: measured = (1 + scale) true.',
                      minimum=-0.5, maximum=0.5),
            Parameter(f'{self.name}.scale_sigma', 0.02, '-', 'Standard deviation of the remaining scale factor '
                      'error, which is estimated; 0: none remains.', minimum=0.0, maximum=0.5))

    def states(self, values):
        return {self.state: (values[f'{self.name}.scale_sigma'], 0.0), **self.axle_states(values)}

    @property
    def state(self):
        return f'{self.name}_scale'

    def declared(self, settings, speeds):
        return replace(speeds, speed=settings.factor * speeds.speed / (1.0 + settings.offset),
                       variance=settings.factor**2 * speeds.variance)

    def events(self, settings, speeds):
        speeds = self.declared(settings, speeds)
        n, speed = len(speeds), speeds.speed
        r, reasons = empty(Kind.SPEED, n), {}
        refuse(reasons, ~(np.abs(speed) < LARGEST_VELOCITY), lambda i: f'speed {speed[i]:g} m/s: dropped')
        r[:, Event.VALUE] = speed
        r[:, Event.R_NN] = stated_or(speeds.variance, settings, SMALLEST_SPEED_SIGMA)
        return r, reasons, {}

    def off(self, measured, innovation):
        return f'speed {measured:.2f} m/s where {measured + innovation[0]:.2f} m/s was expected'

    def read(self, fields, message):
        return Speeds(stamp=fields['stamp'], received=fields['received'],
                      speed=fields['twist.twist.linear'][:, 0].copy(), variance=fields['twist.covariance'][:, 0].copy())

    def written(self, speeds):
        return {'twist.twist.linear': speeds.speed[:, None] * [1.0, 0.0, 0.0],
                'twist.covariance': covariance36({0: speeds.variance}, len(speeds))}

    def simulated(self, drive, errors, effects, rng, instants):
        time, stamp = instants(errors['speed_rate'], 0.0021)
        speed = (1 + errors['speed_scale'] * rng.standard_normal()) * self._true(drive, time)
        for effect, values in effects:
            speed = effect.distort_speeds(speed, values)
        speed = speed + errors['speed_sigma'] * rng.standard_normal(len(time))
        return Speeds(stamp, stamp.copy(), speed, np.full(len(time), errors['speed_sigma'] ** 2))

    def _true(self, drive, time):
        """True speed at the rear axle, or of a named input at its lever arm, m/s."""
        if self.is_plain:
            return drive.path.wheel_speed(time)
        return np.einsum('ki,ki->k', velocity_at(drive, time, self.arm), drive.at(time).attitude.as_matrix()[:, :, 0])
