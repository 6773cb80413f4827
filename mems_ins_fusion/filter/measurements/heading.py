"""Heading of the vehicle, from two antennas or a compass: yaw clockwise from north."""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation import planar, strapdown
from ..layout import NAV, PLANAR, Event, Head, Kind
from .records import empty, refuse, stated_or


@njit(_nrt=False)
def observe(mem, r, at, h, n, c):
    """Predicted minus measured yaw, within half a turn; one component."""
    yaw = int(mem[Head.MOUNTING_YAW])
    mounting = mem[r + NAV + yaw] if yaw >= 0 else 0.0  # the vehicle is turned by that in the body's axes
    difference = math.atan2(c[3], c[0]) + mounting - mem[at + Event.VALUE]
    mem[at + Event.Z_N] = math.atan2(math.sin(difference), math.cos(difference)) - mounting
    if mem[Head.MECHANIZATION] == PLANAR:
        mem[h + planar.State.YAW] = 1.0
    else:  # of atan2(c_21, c_11), where the column turns by phi x c
        level = c[0] * c[0] + c[3] * c[3]
        mem[h + strapdown.State.PHI_D] = 1.0
        mem[h + strapdown.State.PHI_N] = -c[6] * c[0] / level
        mem[h + strapdown.State.PHI_E] = -c[6] * c[3] / level
    if yaw >= 0:
        mem[h + yaw] = -1.0
    return 1


#: not better than this, rad
SMALLEST_SIGMA = 0.001


def records(settings, headings):
    """Records of `headings` (`samples.Headings`), why each cannot be used ('' where it can), and no warnings.

    settings: `SensorSettings`; its offset, rad clockwise, is subtracted.
    """
    n = len(headings)
    r, reasons = empty(Kind.HEADING, n), np.full(n, '', dtype=object)
    refuse(reasons, ~(np.abs(headings.yaw) < 100.0), lambda i: f'heading {headings.yaw[i]:g} rad: dropped')
    r[:, Event.VALUE] = headings.yaw - settings.offset
    r[:, Event.R_NN] = stated_or(headings.variance, settings, SMALLEST_SIGMA)
    return r, reasons, np.full(n, '', dtype=object)
