"""Pseudo-measurement: the acceleration of a land vehicle is zero-mean white noise.

An IMU with known errors measures the acceleration much better than that. Where its biases or the tilt are not known,
or its noise tilts the solution within seconds, the gravity and the bias that leak in are larger than a vehicle's mean
acceleration over half a minute. Without fixes, constant velocity is then nearer to the truth than integration, and both
combined are nearer than either.
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ...navigation.earth import gravity
from ..memory import Error, Event, Nav, Sample, channel_of, element_at, row_of, sensor_variance_at
from .geometry import add_attitude_error, add_sensor_error, rotate

#: m^2/s^3, power spectral density of a land vehicle's acceleration: the velocity changes by 9.5 m/s (1 sigma) in 30 s.
#: Changes of velocity over 5 to 60 s of measured drives give 0.1 to 4.2
DENSITY = 3.0
#: m/s^2, standard deviation of the accelerometers' error up to which this is not used: it would need five minutes to
#: halve the variance of such an error (DENSITY over the variance), and costs a twelfth of a sample's time
SMALLEST_ERROR = 0.1


@njit(_nrt=False)
def tilt_variance(mem, r):
    """Variance of a horizontal component of the gravity that the tilt of the state at r leaks in, (m/s^2)^2; 0 where
    the tilt is no state."""
    phi = row_of(mem, Error.PHI_N)
    if phi < 0:
        return 0.0
    g = gravity(mem[r + Nav.LATITUDE], mem[r + Nav.HEIGHT])
    tilt = 0.5 * (mem[element_at(mem, r, phi, phi)] + mem[element_at(mem, r, phi + 1, phi + 1)])
    return g * g * tilt


@njit(_nrt=False)
def error_variance(mem, r):
    """Variance of a horizontal component of the acceleration as the state at r has it, by bias and tilt, (m/s^2)^2."""
    total = tilt_variance(mem, r)
    for axis in range(2):
        state = channel_of(mem, axis)
        if state >= 0:
            total += 0.5 * mem[sensor_variance_at(mem, r, state)]
    return total


@njit(_nrt=False)
def observe(mem, at, h, n, c, sample, since):
    """Acceleration to north and east of the IMU sample at `sample`. Returns the number of components.

    c: rotation from b to n. since: s since the previous constraint.
    """
    f_n, f_e, f_d = rotate(c, mem[sample + Sample.F_X], mem[sample + Sample.F_Y], mem[sample + Sample.F_Z])
    add_attitude_error(mem, h, n, f_n, f_e, f_d)
    for axis in range(3):
        if channel_of(mem, axis) >= 0:
            f_n += add_sensor_error(mem, h, sample, axis, c[axis])
            f_e += add_sensor_error(mem, h + n, sample, axis, c[3 + axis])
    mem[at + Event.Z_N], mem[at + Event.Z_E] = f_n, f_e
    mem[at + Event.R_NN] = mem[at + Event.R_EE] = DENSITY / since
    mem[at + Event.R_NE] = 0.0
    return 2
