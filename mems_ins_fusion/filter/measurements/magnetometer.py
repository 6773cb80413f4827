"""Heading from the earth's magnetic field; the hard and soft iron of the vehicle are estimated during the drive.

Levelled, the field is v = hard + S u, with u the direction of magnetic north in the vehicle's axes, `hard` the hard
iron (the vehicle's own field), and S = (1 + strength) I plus a symmetric matrix without trace, the soft iron; all in
units of `NAME.horizontal_field`. Hard and soft iron are states. They become observable in turns, which the gyroscopes
measure, and where fixes show the heading; before that the field has no weight, as the hard iron's standard deviation is
twice the field. A rotation of the field that is the same at all headings is the declination, a state too. (W. Koo, S.
Sung and Y. J. Lee, "Error calibration of magnetometer using nonlinear integrated filter model with inertial sensors",
IEEE Trans. Magnetics 45, 2009; V. Renaudin, M. H. Afzal and G. Lachapelle, "Complete triaxis magnetometer calibration
in the magnetic domain", J. Sensors 2010.)
"""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation.frames import FLU_TO_FRD, mounting
from ...parameters.parameter import Parameter
from ...samples import MagneticFields
from ..memory import NAV, Error, Event, Kind
from .base import Measurement, SensorSettings
from .events import empty, refuse, stated_or
from .geometry import add, angular_rate, yaw_of
from .time_offset import add_time_offset

#: names of the states, after that of the input: hard iron forward and to the right; strength of the horizontal field
#: less 1; soft iron: field along the vehicle over that across it, and along one diagonal over that along the other;
#: rad, error of the declination
FIELD_STATES = 'hard_x', 'hard_y', 'strength', 'stretch', 'skew', 'declination'


@njit(_nrt=False)
def _levelled(mem, r, at, c):
    """The field of the event at `at` without the hard iron, levelled: forward, right, down; and the forward and right
    components of the body's first two axes in those axes."""
    norm = math.hypot(c[0], c[3])
    cos, sin = c[0] / norm, c[3] / norm
    x_x, y_x = cos * c[0] + sin * c[3], cos * c[3] - sin * c[0]
    x_y, y_y = cos * c[1] + sin * c[4], cos * c[4] - sin * c[1]
    x_z, y_z = cos * c[2] + sin * c[5], cos * c[5] - sin * c[2]
    hard = r + NAV + int(mem[at + Event.STATE])
    b_x, b_y, b_z = (mem[at + Event.VALUE] - mem[hard], mem[at + Event.VALUE + 1] - mem[hard + 1],
                     mem[at + Event.VALUE + 2])
    return (x_x * b_x + x_y * b_y + x_z * b_z, y_x * b_x + y_y * b_y + y_z * b_z,
            c[6] * b_x + c[7] * b_y + c[8] * b_z, x_x, y_x, x_y, y_y)


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Horizontal field in units of its nominal size, across the predicted one (an angle) and along it; two components.
    """
    first = int(mem[at + Event.STATE])
    x = r + NAV + first
    strength, stretch, skew = 1.0 + mem[x + 2], mem[x + 3], mem[x + 4]
    f_x, f_y, f_z, x_x, y_x, x_y, y_y = _levelled(mem, r, at, c)
    yaw, turn = yaw_of(c), angular_rate(mem, r, sample)[2]
    yaw -= mem[at + Event.DECLINATION] + mem[x + 5]
    u_x, u_y = math.cos(yaw), -math.sin(yaw)
    turned_x, turned_y = u_y, -u_x  # derivative of u by the yaw
    z_x = (strength + stretch) * u_x + skew * u_y - f_x
    z_y = skew * u_x + (strength - stretch) * u_y - f_y
    s_x = (strength + stretch) * turned_x + skew * turned_y
    s_y = skew * turned_x + (strength - stretch) * turned_y
    level = c[0] * c[0] + c[3] * c[3]  # derivative of atan2(c_21, c_11), where phi x c changes the column
    by_n, by_e = -c[6] * c[0] / level, -c[6] * c[3] / level
    cos, sin = c[0] / math.sqrt(level), c[3] / math.sqrt(level)
    for k in range(2):
        w_x, w_y = (turned_x, turned_y) if k == 0 else (u_x, u_y)
        row, by_yaw = h + n * k, w_x * s_x + w_y * s_y
        mem[row + first], mem[row + first + 1] = -(w_x * x_x + w_y * y_x), -(w_x * x_y + w_y * y_y)
        mem[row + first + 2] = -(w_x * u_x + w_y * u_y)
        mem[row + first + 3] = -(w_x * u_x - w_y * u_y)
        mem[row + first + 4] = -(w_x * u_y + w_y * u_x)
        mem[row + first + 5] = by_yaw
        add_time_offset(mem, at, row, by_yaw * turn)
        # an error of attitude changes the levelled field by phi x f, and the yaw about which it is levelled
        add(mem, row, Error.PHI_D, by_yaw)
        about = w_x * f_y - w_y * f_x
        add(mem, row, Error.PHI_N, by_n * (by_yaw - about) + f_z * (w_x * sin + w_y * cos))
        add(mem, row, Error.PHI_E, by_e * (by_yaw - about) - f_z * (w_x * cos - w_y * sin))
        z = w_x * z_x + w_y * z_y
        for i in range(len(FIELD_STATES)):  # not linear: `update` subtracts H times the estimate
            z += mem[row + first + i] * mem[x + i]
        if k == 0:
            mem[at + Event.Z_N] = z
        else:
            mem[at + Event.Z_E] = z
    return 2


@njit(_nrt=False)
def heading(mem, r, at, c):
    """Heading from the field of the event at `at` with the iron estimated at r, rad."""
    x = r + NAV + int(mem[at + Event.STATE])
    strength, stretch, skew = 1.0 + mem[x + 2], mem[x + 3], mem[x + 4]
    f_x, f_y, _, _, _, _, _ = _levelled(mem, r, at, c)
    # S^-1 f, up to a positive factor
    magnetic = -math.atan2((strength + stretch) * f_y - skew * f_x, (strength - stretch) * f_x - skew * f_y)
    return magnetic + mem[at + Event.DECLINATION] + mem[x + 5]


#: T, lower limit of the standard deviation of a field: surrounding iron disturbs it everywhere
SMALLEST_SIGMA = 1e-6
WEAKEST = 5e-6  # T, smallest field. That of the earth has 22 to 67 uT; hard iron may be against it
STRONGEST = 5e-4  # T, largest field: that of the earth and hard iron
STRENGTH_SIGMA = 0.4  # prior standard deviation of the horizontal field at a place, as a share of it: 15 to 40 uT
SOFT_WALK = 0.1 / 60.0  # 1/sqrt(s), random walk of strength and soft iron: 0.1 within an hour
SIMULATED_FIELD = 20e-6, 44e-6  # T, horizontal and vertical field in simulations: central Europe
REACH = 3.0  # m along the road, standard deviation of the disturbance by a simulated piece of iron beside it


@dataclass(frozen=True)
class FieldSettings(SensorSettings):
    """rotation: (3, 3) from the sensor's axes to the body's. hard_iron: (3,) T, sensor axes. horizontal: T.
    declination: rad."""

    rotation: np.ndarray | None = None
    hard_iron: tuple[float, ...] = (0.0, 0.0, 0.0)
    horizontal: float = 25e-6
    declination: float = 0.0


class Magnetometer(Measurement):
    observe = staticmethod(observe)
    kind, name, samples, unit, default_sigma = Kind.MAGNETIC, 'magnetometer', MagneticFields, 'T', 1e-6
    topic_text = 'Topic of the magnetic field, T: sensor_msgs/MagneticField, for robots too slow to show a course'
    components = 2
    messages = {'sensor_msgs/msg/MagneticField': ('magnetic_field', 'magnetic_field_covariance')}
    layouts = {'sensor_msgs/msg/MagneticField': (('magnetic_field', '<f8', 3),
                                                 ('magnetic_field_covariance', '<f8', 9))}
    written_to = '/imu/mag'
    #: T, white noise; then standard deviations, drawn for each seed: T, hard iron of each axis; elements of soft iron;
    #: rad, declination. T, disturbances by iron beside the road, and m, mean distance between these
    simulated_with = {'magnetometer_rate': 0.0, 'magnetometer_sigma': 0.5e-6, 'magnetometer_hard_iron': 15e-6,
                      'magnetometer_soft_iron': 0.05, 'magnetometer_declination': 0.03,
                      'magnetometer_disturbance': 5e-6, 'magnetometer_distance': 100.0}

    def parameters(self):
        return (
            *super().parameters(),
            self.factor_parameter('T', '1e-6 for uT, 1e-4 for gauss'),
            Parameter(f'{self.name}.mounting_rpy', [], 'rad', 'Roll, pitch, yaw of the rotation from its axes to '
                      'base_link; empty: imu.mounting_rpy.', lengths=(0, 3), minimum=-2 * math.pi,
                      maximum=2 * math.pi),
            Parameter(f'{self.name}.declination', 0.0, 'rad', 'Angle of magnetic north to the right of true north.',
                      minimum=-math.pi, maximum=math.pi),
            Parameter(f'{self.name}.declination_sigma', 0.05, 'rad', 'Standard deviation of its error, including a '
                      'rotation of the sensor about the vertical, which is estimated.', minimum=1e-4, maximum=math.pi),
            Parameter(f'{self.name}.horizontal_field', 25e-6, 'T', "Horizontal component of the earth's field; it is "
                      f'estimated, from {STRENGTH_SIGMA:.0%} of it.', minimum=1e-6, maximum=1e-4),
            Parameter(f'{self.name}.hard_iron', [0.0, 0.0, 0.0], 'T', 'Field of the vehicle itself, axes of the '
                      'sensor; subtracted.', lengths=(3,), minimum=-1e-3, maximum=1e-3),
            Parameter(f'{self.name}.hard_iron_sigma', 50e-6, 'T', 'Standard deviation of its error, which is '
                      'estimated. If it is small, as after a calibration, the field shows the heading at once.',
                      minimum=1e-8, maximum=1e-3),
            Parameter(f'{self.name}.hard_iron_walk', 0.05e-6, 'T/sqrt(s)', 'Random walk of the hard iron: currents, '
                      'load, doors.', minimum=0.0, maximum=1e-3),
            Parameter(f'{self.name}.soft_iron_sigma', 0.05, '-', 'Standard deviation of the elements of soft iron, '
                      'which are estimated.', minimum=1e-4, maximum=0.5))

    @property
    def state(self):
        return f'{self.name}_{FIELD_STATES[0]}'

    def states(self, values):
        def value(name):
            return values[f'{self.name}.{name}']
        hard = value('hard_iron_sigma') / value('horizontal_field'), value('hard_iron_walk') / value('horizontal_field')
        soft = value('soft_iron_sigma'), SOFT_WALK
        each = (hard, hard, (STRENGTH_SIGMA, SOFT_WALK), soft, soft, (value('declination_sigma'), 0.0))
        return {f'{self.name}_{name}': one for name, one in zip(FIELD_STATES, each)}

    def settings(self, values: Mapping):
        rpy = values[f'{self.name}.mounting_rpy'] or values['imu.mounting_rpy']
        return FieldSettings(**vars(super().settings(values)), rotation=mounting(rpy),
                             hard_iron=tuple(values[f'{self.name}.hard_iron']),
                             horizontal=values[f'{self.name}.horizontal_field'],
                             declination=values[f'{self.name}.declination'])

    def declared(self, settings, fields):
        return replace(fields, field=settings.factor * fields.field - np.asarray(settings.hard_iron),
                       variance=settings.factor**2 * fields.variance)

    def events(self, settings, fields):
        n, size = len(fields), np.linalg.norm(settings.factor * fields.field, axis=1)
        fields = self.declared(settings, fields)
        r, reasons = empty(Kind.MAGNETIC, n), {}
        refuse(reasons, ~((size >= WEAKEST) & (size <= STRONGEST)), lambda i: f'magnetic field {1e6 * size[i]:.4g} uT '
               f"is outside {1e6 * WEAKEST:g} to {1e6 * STRONGEST:g} uT: dropped (a wrong {self.name}.factor?)")
        r[:, Event.VALUE:Event.VALUE + 3] = fields.field @ settings.rotation.T / settings.horizontal
        variance = stated_or(fields.variance, settings, SMALLEST_SIGMA) / settings.horizontal**2
        r[:, Event.R_NN] = r[:, Event.R_EE] = variance
        r[:, Event.DECLINATION] = settings.declination
        return r, reasons, {}

    def off(self, measured, innovation):
        return (f'magnetic field of a heading {math.degrees(abs(innovation[0])):.0f} deg off, '
                f'{100.0 * abs(innovation[1]):.0f} % too {"weak" if innovation[1] > 0 else "strong"}')

    def read(self, fields, message):
        covariance = fields['magnetic_field_covariance'].reshape(-1, 9)
        return MagneticFields(stamp=fields['stamp'], received=fields['received'], field=fields['magnetic_field'],
                              variance=covariance[:, [0, 4, 8]].mean(axis=1))

    def written(self, fields):
        covariance = np.zeros((len(fields), 9))
        covariance[:, [0, 4, 8]] = fields.variance[:, None]
        return {'magnetic_field': fields.field, 'magnetic_field_covariance': covariance}

    def simulated(self, drive, errors, effects, rng, instants):
        time, stamp = instants(errors['magnetometer_rate'], 0.0029)
        hard = errors['magnetometer_hard_iron'] * rng.standard_normal(3)
        stretch, skew = errors['magnetometer_soft_iron'] * rng.standard_normal(2)
        declination = errors['magnetometer_declination'] * rng.standard_normal()
        horizontal, vertical = SIMULATED_FIELD
        field = np.array([horizontal * math.cos(declination), horizontal * math.sin(declination), vertical])
        around = field + errors['magnetometer_disturbance'] * _beside_the_road(
            drive, time, errors['magnetometer_distance'], rng)
        soft = np.eye(3) + np.array([[stretch, skew, 0.0], [skew, -stretch, 0.0], [0.0, 0.0, 0.0]])
        sigma = errors['magnetometer_sigma']
        body = drive.at(time).attitude.inv().apply(around) @ soft + hard
        return MagneticFields(stamp, stamp.copy(), body @ FLU_TO_FRD + sigma * rng.standard_normal(body.shape),
                              np.full(len(time), sigma**2))

    def seen_from(self, samples, to_sensor):
        return replace(samples, field=to_sensor.apply(samples.field))


def _beside_the_road(drive, time, distance, rng) -> np.ndarray:
    """(m, 3) in n, of size 1: disturbance of the field at `time` (m,) s by iron every `distance` m on average."""
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(drive.position, axis=0), axis=1))])
    at, field = np.interp(time, drive.time, driven), np.zeros((len(time), 3))
    for iron in np.cumsum(rng.exponential(distance, math.ceil(2.0 * driven[-1] / distance) + 5)):
        field += np.exp(-0.5 * ((at - iron) / REACH) ** 2)[:, None] * rng.standard_normal(3)
    return field
