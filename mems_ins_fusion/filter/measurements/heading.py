"""Heading of the vehicle, from two antennas or a compass: yaw clockwise from north."""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ...navigation import planar, strapdown
from ..layout import PLANAR, Event, Head


@njit(_nrt=False)
def observe(mem, r, at, h, n, c):
    """Predicted minus measured yaw, within half a turn; one component."""
    difference = math.atan2(c[3], c[0]) - mem[at + Event.VALUE]
    mem[at + Event.Z_N] = math.atan2(math.sin(difference), math.cos(difference))
    if mem[Head.MECHANIZATION] == PLANAR:
        mem[h + planar.State.YAW] = 1.0
    else:  # of atan2(c_21, c_11), where the column turns by phi x c
        level = c[0] * c[0] + c[3] * c[3]
        mem[h + strapdown.State.PHI_D] = 1.0
        mem[h + strapdown.State.PHI_N] = -c[6] * c[0] / level
        mem[h + strapdown.State.PHI_E] = -c[6] * c[3] / level
    yaw = int(mem[Head.MOUNTING_YAW])
    if yaw >= 0:  # the vehicle is turned by that in the body's axes
        mem[h + yaw] = -1.0
    return 1
