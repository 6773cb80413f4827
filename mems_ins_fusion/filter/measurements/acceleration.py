"""A land vehicle keeps its velocity, by and large: its acceleration is zero but for white noise.

Inertial sensors measure the acceleration much better than that - unless they are shaken so much that their noise tilts
the solution within seconds, and what is left of gravity is larger than what vehicles do. Then, without fixes, going
straight on at the last speed is nearer to the truth than integrating, and both together are nearer than either.
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..memory import Event, Sample, channel_of
from .geometry import turned

#: m^2/s^3, density of a land vehicle's acceleration, taken for white: in 30 s its velocity changes by 9.5 m/s (1 sigma)
#: Of the changes of velocity over 5 to 60 s in measured drives: 0.1 to 4.2
DENSITY = 3.0


@njit(_nrt=False)
def observe(mem, at, h, n, c, sample, since):
    """Acceleration to north and east at the sample at `sample`; the number of components.

    c: rotation from b to n. since: s since the constraint before it.
    """
    f = mem[sample + Sample.F_X], mem[sample + Sample.F_Y], mem[sample + Sample.F_Z]
    level = (c[0] * f[0] + c[1] * f[1] + c[2] * f[2], c[3] * f[0] + c[4] * f[1] + c[5] * f[2],
             c[6] * f[0] + c[7] * f[1] + c[8] * f[2])
    turned(mem, h, n, level[0], level[1], level[2])
    for axis in range(3):
        state = channel_of(mem, axis)
        if state >= 0:
            mem[h + state] = c[axis]
            mem[h + n + state] = c[3 + axis]
    mem[at + Event.Z_N], mem[at + Event.Z_E] = level[0], level[1]
    mem[at + Event.R_NN] = mem[at + Event.R_EE] = DENSITY / since
    mem[at + Event.R_NE] = 0.0
    return 2
