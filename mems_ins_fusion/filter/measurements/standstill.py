"""Standstill: no velocity, and what the gyroscopes show is their error."""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ...navigation import planar, strapdown
from ..layout import PLANAR, Event, Head, Nav, Sample


@njit(_nrt=False)
def observe_velocity(mem, r, at, h, n):
    """The velocity; the number of components."""
    first = planar.State.V_N if mem[Head.MECHANIZATION] == PLANAR else strapdown.State.V_N
    dimensions = 2 if mem[Head.MECHANIZATION] == PLANAR else 3
    variance = mem[Head.ZERO_VELOCITY_SIGMA] ** 2
    for k in range(dimensions):
        mem[at + Event.Z_N + k] = mem[r + Nav.V_N + k]
        mem[h + n * k + first + k] = 1.0
    mem[at + Event.R_NN] = mem[at + Event.R_EE] = mem[at + Event.R_DD] = variance
    mem[at + Event.R_NE] = 0.0
    return dimensions


@njit(_nrt=False)
def observe_rate(mem, r, at, h, n, sample, dt):
    """The angular rate of the sample at position `sample`, dt after the one before it: error and white noise."""
    n_navigation, p = int(mem[Head.N_NAVIGATION]), int(mem[Head.ORDER])
    if mem[Head.MECHANIZATION] == PLANAR:
        mem[at + Event.Z_N] = mem[sample + Sample.W_Z]
        mem[h + n_navigation + 2 * p] = 1.0
        mem[at + Event.R_NN] = _variance(mem, 2, dt)
        return 1
    for k in range(3):
        mem[at + Event.Z_N + k] = mem[sample + Sample.W_X + k]
        mem[h + n * k + n_navigation + (3 + k) * p] = 1.0
    mem[at + Event.R_NN], mem[at + Event.R_EE] = _variance(mem, 0, dt), _variance(mem, 1, dt)
    mem[at + Event.R_DD], mem[at + Event.R_NE] = _variance(mem, 2, dt), 0.0
    return 3


@njit(_nrt=False)
def _variance(mem, axis, dt):
    """White noise of one sample of a gyroscope; an engine that runs may shake it by more."""
    return max(mem[Head.SIZE + 3 + axis] / dt, mem[Head.SPREAD + 1])
