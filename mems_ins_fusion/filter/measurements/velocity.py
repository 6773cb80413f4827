"""GNSS velocity: velocity of the antenna over ground, north, east and down, from Doppler shifts."""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation.frames import ned_covariance_from_enu, ned_from_enu
from ...samples import Velocities
from ..memory import Error, Event, Kind, Nav, row_of
from .base import TWIST, Measurement, covariance36
from .events import LARGEST_VELOCITY, SMALLEST_SPEED_SIGMA, empty, refuse, stated_or, velocity_at
from .geometry import add, add_attitude_error, angular_rate, arm_of, rotate
from .time_offset import acceleration, add_time_offset


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Velocity of the antenna. Returns the number of components: two where the event's vertical one is NaN."""
    w_x, w_y, w_z = angular_rate(mem, r, sample)
    x, y, z = arm_of(mem, at)
    north, east, down = rotate(c, w_y * z - w_z * y, w_z * x - w_x * z, w_x * y - w_y * x)  # w x arm
    mem[at + Event.Z_N] = mem[r + Nav.V_N] + north - mem[at + Event.VALUE]
    mem[at + Event.Z_E] = mem[r + Nav.V_E] + east - mem[at + Event.VALUE + 1]
    vertical = not math.isnan(mem[at + Event.VALUE + 2])
    mem[at + Event.Z_D] = mem[r + Nav.V_D] + down - mem[at + Event.VALUE + 2] if vertical else 0.0
    add_attitude_error(mem, h, n, north, east, down)
    rate = acceleration(mem, r)
    for k in range(3):
        add(mem, h + n * k, Error.V_N + k, 1.0)
        add_time_offset(mem, at, h + n * k, rate[k])
    return 3 if vertical and row_of(mem, Error.V_D) >= 0 else 2



class Velocity(Measurement):
    observe = staticmethod(observe)
    kind, name, samples, unit, default_sigma = Kind.VELOCITY, 'velocity', Velocities, 'm/s', 0.2
    topic_text = ("Topic of the antenna's velocity, m/s east-north-up: geometry_msgs/TwistWithCovarianceStamped, "
                  'twist.linear')
    components = 2
    messages = {TWIST: ('twist.twist.linear', 'twist.covariance')}
    written_to = '/gps/velocity'
    of_antenna = from_satellites = has_arm = True
    #: m/s, white noise north and east; 1.5 times that down
    simulated_with = {'velocity_rate': 0.0, 'velocity_sigma': 0.1}

    def events(self, settings, velocities):
        n, v = len(velocities), velocities.velocity.copy()
        r, reasons = empty(Kind.VELOCITY, n), {}
        with np.errstate(over='ignore', invalid='ignore'):
            vertical = np.where(np.isnan(v[:, 2]), 0.0, v[:, 2])
            refuse(reasons, ~(np.hypot(np.hypot(v[:, 0], v[:, 1]), vertical) < LARGEST_VELOCITY),
                   lambda i: f'velocity {v[i, 0]:g}, {v[i, 1]:g}, {v[i, 2]:g} m/s (north, east, down): dropped')
        # receivers without a vertical velocity send NaN, or always zero
        v[:, 2][v[:, 2] == 0.0] = np.nan
        r[:, Event.VALUE:Event.VALUE + 3] = v
        for column, axis in ((Event.R_NN, 0), (Event.R_EE, 1), (Event.R_DD, 2)):
            r[:, column] = stated_or(velocities.covariance[:, axis, axis], settings, SMALLEST_SPEED_SIGMA)
        return r, reasons, {}

    def read(self, fields, message):
        covariance = fields['twist.covariance'][:, :9].reshape(-1, 3, 3)
        return Velocities(stamp=fields['stamp'], received=fields['received'],
                          velocity=ned_from_enu(fields['twist.twist.linear']),
                          covariance=ned_covariance_from_enu(covariance))

    def written(self, velocities):
        covariance = ned_covariance_from_enu(velocities.covariance)
        return {'twist.twist.linear': ned_from_enu(velocities.velocity),
                'twist.covariance': covariance36({6 * i + j: covariance[:, i, j] for i in range(3) for j in range(3)},
                                                 len(velocities))}

    def simulated(self, drive, errors, effects, rng, instants):
        # of the same instant as the receiver's fix of the same stamp
        time, stamp = instants(errors['velocity_rate'], None)
        antenna = self.arm.copy()  # body, forward-right-down
        for effect, values in effects:
            time = effect.fix_times(time, values) if self.is_plain else time
            if effect.name == 'gnss_lever_arm' and self.is_plain:
                antenna += [values['x'], -values['y'], -values['z']]
        velocity = velocity_at(drive, time, antenna)
        sigma = errors['velocity_sigma'] * np.array([1.0, 1.0, 1.5])
        return Velocities(stamp, stamp.copy(), velocity + sigma * rng.standard_normal((len(time), 3)),
                          np.tile(np.diag(sigma**2), (len(time), 1, 1)))
