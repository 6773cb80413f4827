"""Speed over ground along the vehicle, from its wheels: at the axle whose wheels are counted, with a scale error."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.compiled import njit

from ..layout import Event, Head, Kind
from .geometry import add_body_velocity, angular_rate, body_velocity, vehicle_to_level
from .records import empty, refuse, stated_or


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Predicted minus measured speed, positive forwards; one component. measured = (1 + scale) true."""
    _, w_y, w_z = angular_rate(mem, r, sample)
    c = vehicle_to_level(mem, r, c)
    forward = body_velocity(mem, r, c, 0) + w_y * mem[Head.AXLE_Z] - w_z * mem[Head.AXLE_Y]
    add_body_velocity(mem, r, h, c, 0, 1.0)
    mem[at + Event.Z_N] = forward - mem[at + Event.VALUE]
    scale = int(mem[Head.SPEED_SCALE])
    if scale >= 0:
        mem[h + scale] = -forward
    across = int(mem[Head.AXLE_ACROSS])
    if across >= 0:
        mem[h + across] = w_z
    return 1


#: faster is no land vehicle, m/s
FASTEST = 150.0
#: not better than this, m/s
SMALLEST_SIGMA = 0.001


def records(settings, speeds):
    """Records of `speeds` (`samples.Speeds`), why each cannot be used ('' where it can), and no warnings.

    settings: `SensorSettings`; its offset is the scale error that is known.
    """
    n = len(speeds)
    r, reasons = empty(Kind.SPEED, n), np.full(n, '', dtype=object)
    refuse(reasons, ~(np.abs(speeds.speed) < FASTEST), lambda i: f'speed {speeds.speed[i]:g} m/s: dropped')
    r[:, Event.VALUE] = speeds.speed / (1.0 + settings.offset)
    r[:, Event.R_NN] = stated_or(speeds.variance, settings, SMALLEST_SIGMA)
    return r, reasons, np.full(n, '', dtype=object)
