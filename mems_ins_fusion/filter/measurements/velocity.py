"""Velocity of the GNSS antenna over ground, north, east and down, as receivers measure it by Doppler shift."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation import planar, strapdown
from ..layout import PLANAR, Event, Head, Kind, Nav
from .geometry import angular_rate, turned
from .records import empty, refuse, stated_or


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Predicted minus measured velocity of the antenna; the number of components."""
    w_x, w_y, w_z = angular_rate(mem, r, sample)
    x, y, z = mem[Head.LEVER_X], mem[Head.LEVER_Y], mem[Head.LEVER_Z]
    # the antenna goes round the IMU: w x arm
    u_x, u_y, u_z = w_y * z - w_z * y, w_z * x - w_x * z, w_x * y - w_y * x
    north, east, down = (c[0] * u_x + c[1] * u_y + c[2] * u_z, c[3] * u_x + c[4] * u_y + c[5] * u_z,
                         c[6] * u_x + c[7] * u_y + c[8] * u_z)
    mem[at + Event.Z_N] = mem[r + Nav.V_N] + north - mem[at + Event.VALUE]
    mem[at + Event.Z_E] = mem[r + Nav.V_E] + east - mem[at + Event.VALUE + 1]
    mem[at + Event.Z_D] = mem[r + Nav.V_D] + down - mem[at + Event.VALUE + 2]
    turned(mem, h, n, north, east, down)
    if mem[Head.MECHANIZATION] == PLANAR:
        mem[h + planar.State.V_N] += 1.0
        mem[h + n + planar.State.V_E] += 1.0
        return 2
    mem[h + strapdown.State.V_N] += 1.0
    mem[h + n + strapdown.State.V_E] += 1.0
    mem[h + 2 * n + strapdown.State.V_D] += 1.0
    return 3


#: faster is no land vehicle, m/s
FASTEST = 150.0
#: not better than this, m/s
SMALLEST_SIGMA = 0.001


def records(settings, velocities):
    """Records of `velocities` (`samples.Velocities`), why each cannot be used ('' where it can), and no warnings.

    settings: `SensorSettings`.
    """
    n, v = len(velocities), velocities.velocity
    r, reasons = empty(Kind.VELOCITY, n), np.full(n, '', dtype=object)
    with np.errstate(over='ignore', invalid='ignore'):
        refuse(reasons, ~(np.linalg.norm(v, axis=1) < FASTEST),
               lambda i: f'velocity {v[i, 0]:g}, {v[i, 1]:g}, {v[i, 2]:g} m/s (north, east, down): dropped')
    r[:, Event.VALUE:Event.VALUE + 3] = v
    for column, axis in ((Event.R_NN, 0), (Event.R_EE, 1), (Event.R_DD, 2)):
        r[:, column] = stated_or(velocities.covariance[:, axis, axis], settings, SMALLEST_SIGMA)
    return r, reasons, np.full(n, '', dtype=object)
