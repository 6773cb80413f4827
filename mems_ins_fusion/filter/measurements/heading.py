"""Heading of the vehicle from two antennas or a compass: yaw clockwise from north."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation.frames import unit_quaternions, wrap, yaw_from_enu, yaw_of_quaternion
from ...parameters.parameter import Parameter
from ...samples import Headings
from ..memory import NAV, Error, Event, Head, Kind
from .base import IMU, NOT_THERE, POSE, Measurement
from .events import empty, refuse, stated_or
from .geometry import add, angular_rate, yaw_of
from .low_pass import unfollowed
from .time_offset import add_time_offset


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Yaw of the vehicle; the innovation is wrapped to (-pi, pi]. One component."""
    yaw, offset = int(mem[Head.MOUNTING_YAW]), int(mem[at + Event.STATE])
    # yaw of the vehicle's axes in b, and error of the measured heading; `update` subtracts H times these estimates
    estimated = (mem[r + NAV + yaw] if yaw >= 0 else 0.0) + (mem[r + NAV + offset] if offset >= 0 else 0.0)
    now = yaw_of(c)
    difference = now + estimated - unfollowed(mem, r, at, now) - mem[at + Event.VALUE]
    mem[at + Event.Z_N] = math.atan2(math.sin(difference), math.cos(difference)) - estimated
    add_time_offset(mem, at, h, angular_rate(mem, r, sample)[2])
    level = c[0] * c[0] + c[3] * c[3]  # derivative of atan2(c_21, c_11), where phi x c changes the column
    add(mem, h, Error.PHI_D, 1.0)
    add(mem, h, Error.PHI_N, -c[6] * c[0] / level)
    add(mem, h, Error.PHI_E, -c[6] * c[3] / level)
    for state in (yaw, offset):
        if state >= 0:
            mem[h + state] = -1.0
    return 1


SMALLEST_SIGMA = 0.001  # rad, lower limit of the standard deviation of a heading, whatever the message states
LARGEST_YAW = 100.0  # rad: a larger yaw is not an angle in radians, even if it was not wrapped


class Heading(Measurement):
    observe = staticmethod(observe)
    kind, name, samples, unit, default_sigma = Kind.HEADING, 'heading', Headings, 'rad', 0.05
    topic_text = ('Topic of the heading of base_link (two antennas or a compass): yaw of sensor_msgs/Imu.orientation '
                  'or geometry_msgs/PoseWithCovarianceStamped, counter-clockwise from east')
    offset, has_lag = 'offset', True
    messages = {IMU: ('orientation', 'orientation_covariance'), POSE: ('pose.pose.orientation', 'pose.covariance')}
    written_to = '/gps/heading'
    from_satellites = True  # of two antennas, perhaps
    #: rad, white noise
    simulated_with = {'heading_rate': 0.0, 'heading_sigma': 0.02}

    def parameters(self):
        return (
            *super().parameters(),
            Parameter(f'{self.name}.offset', 0.0, 'rad', 'Measured heading minus heading of base_link, clockwise; it '
                      'is subtracted.', minimum=-2 * math.pi, maximum=2 * math.pi),
            Parameter(f'{self.name}.offset_sigma', 0.1, 'rad', 'Standard deviation of the remaining offset, which is '
                      'estimated: antennas and compasses are mounted to some degrees; 0: none remains.',
                      minimum=0.0, maximum=math.pi))

    def states(self, values):
        return {self.state: (values[f'{self.name}.offset_sigma'], 0.0)}

    @property
    def state(self):
        return f'{self.name}_offset'

    def declared(self, settings, headings):
        return replace(headings, yaw=headings.yaw - settings.offset)

    def events(self, settings, headings):
        headings = self.declared(settings, headings)
        n = len(headings)
        r, reasons = empty(Kind.HEADING, n), {}
        refuse(reasons, ~(np.abs(headings.yaw) < LARGEST_YAW), lambda i: f'heading {headings.yaw[i]:g} rad: dropped')
        r[:, Event.VALUE] = headings.yaw
        r[:, Event.R_NN] = stated_or(headings.variance, settings, SMALLEST_SIGMA)
        return r, reasons, {}

    def off(self, measured, innovation):
        return (f'heading {math.degrees(measured) % 360:.1f} deg differs from the expected one by '
                f'{math.degrees(abs(innovation[0])):.1f} deg')

    def read(self, fields, message):
        """NaN for an Imu message without an orientation, and for a zero quaternion."""
        if message == IMU:
            orientation, variance = fields['orientation'], fields['orientation_covariance'][:, 1].copy()
            absent = fields['orientation_covariance'][:, 0] == NOT_THERE[0]
        else:
            orientation, variance = fields['pose.pose.orientation'], fields['pose.covariance'][:, 0]
            absent = np.zeros(len(orientation), bool)
        yaw = yaw_from_enu(yaw_of_quaternion(*unit_quaternions(orientation).T))
        yaw[absent] = np.nan
        return Headings(stamp=fields['stamp'], received=fields['received'], yaw=yaw, variance=variance)

    def written(self, headings):
        """An Imu message with an orientation alone."""
        half = 0.5 * yaw_from_enu(headings.yaw)
        absent = np.isnan(headings.yaw)
        orientation = np.column_stack([np.zeros((len(headings), 2)), np.sin(half), np.cos(half)])
        covariance = np.zeros((len(headings), 9))
        covariance[:, [0, 4]] = np.pi**2  # roll and pitch are not known
        covariance[:, 8] = headings.variance
        covariance[absent, 0] = NOT_THERE[0]
        return {'orientation': np.where(absent[:, None], (0.0, 0.0, 0.0, 1.0), orientation),
                'orientation_covariance': covariance, 'angular_velocity_covariance': NOT_THERE,
                'linear_acceleration_covariance': NOT_THERE}

    def simulated(self, drive, errors, effects, rng, instants):
        time, stamp = instants(errors['heading_rate'], 0.0053)
        yaw = wrap(drive.at(time).yaw + errors['heading_sigma'] * rng.standard_normal(len(time)))
        return Headings(stamp, stamp.copy(), yaw, np.full(len(time), errors['heading_sigma'] ** 2))
