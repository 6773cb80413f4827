"""Speed over ground along the vehicle, from its wheels: at the axle whose wheels are counted, with a scale error."""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..layout import Event, Head
from .geometry import add_body_velocity, angular_rate, body_velocity


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Predicted minus measured speed, positive forwards; one component. measured = (1 + scale) true."""
    _, w_y, w_z = angular_rate(mem, r, sample)
    forward = body_velocity(mem, r, c, 0) + w_y * mem[Head.AXLE_Z] - w_z * mem[Head.AXLE_Y]
    add_body_velocity(mem, r, h, c, 0)
    mem[at + Event.Z_N] = forward - mem[at + Event.VALUE]
    scale = int(mem[Head.SPEED_SCALE])
    if scale >= 0:
        mem[h + scale] = -forward
    return 1
