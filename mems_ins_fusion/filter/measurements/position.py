"""A fix: position of the GNSS antenna (Eq. 19), metres north, east and down."""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ...navigation import strapdown
from ..layout import PLANAR, Event, Head, Nav
from .geometry import turned


@njit(_nrt=False)
def arm_in_level(mem, c):
    """From the IMU to the antenna, in n; c: rotation from b to n."""
    x, y, z = mem[Head.LEVER_X], mem[Head.LEVER_Y], mem[Head.LEVER_Z]
    return c[0] * x + c[1] * y + c[2] * z, c[3] * x + c[4] * y + c[5] * z, c[6] * x + c[7] * y + c[8] * z


@njit(_nrt=False)
def difference(mem, r, at, c):
    """Predicted minus measured position of the antenna, north, east and down, m."""
    north, east, down = arm_in_level(mem, c)
    return ((mem[r + Nav.LATITUDE] - mem[at + Event.LATITUDE]) / mem[r + Nav.NORTH_SCALE] + north,
            (mem[r + Nav.LONGITUDE] - mem[at + Event.LONGITUDE]) / mem[r + Nav.EAST_SCALE] + east,
            mem[at + Event.HEIGHT] - mem[r + Nav.HEIGHT] + down)


@njit(_nrt=False)
def observe(mem, r, at, h, n, c):
    """`difference` and its rows of H; the number of components: the planar filter has no height."""
    mem[at + Event.Z_N], mem[at + Event.Z_E], mem[at + Event.Z_D] = difference(mem, r, at, c)
    north, east, down = arm_in_level(mem, c)
    mem[h] = mem[h + n + 1] = 1.0
    turned(mem, h, n, north, east, down)  # an error of attitude swings the antenna
    coloured = int(mem[Head.COLOURED])
    if coloured >= 0:
        mem[h + coloured] = mem[h + n + coloured + 1] = -1.0
    if mem[Head.MECHANIZATION] == PLANAR:
        return 2
    mem[h + 2 * n + strapdown.State.R_D] = 1.0
    return 3
