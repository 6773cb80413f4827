"""Standstill: no velocity, and what the gyroscopes show is their error."""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ...navigation import planar, strapdown
from ..layout import NAV, PLANAR, Event, Head, Nav, Sample

#: the gyroscopes' drift is looked at when the vehicle has stood for so long, s
STANDING = 3.0
#: of one that has only begun, s: 0 is in motion
JUST_NOW = 1e-9
#: where that has taken so much of the variance of their errors away: a running engine hides the rest
TOLD = 0.1
#: a drift squared, over its variance, counts no more than this: what was no standstill must not ruin the rest
LARGEST_DRIFT = 9.0
#: the assumed drift is worth so many, and no more than so many are remembered; three in each standstill
DRIFT_PRIOR, DRIFT_MEMORY = 6.0, 60.0
#: the realised variance is believed between these multiples of the assumed one
SMALLEST_RATIO, LARGEST_RATIO = 0.01, 100.0


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
def learn_drift(mem, r, since):
    """Realised over assumed variance of the gyroscopes' drift, once in each standstill but the first.

    since: s since the last correction, which at the begin of a standstill may be long ago. By what the estimates of
    their errors change in its first STANDING s, against what they may: the variance that they had less the one that
    they have. P stands in the scratch. The first standstill shows the bias that the sensor was switched on with, too.
    """
    n_navigation, order = int(mem[Head.N_NAVIGATION]), int(mem[Head.ORDER])
    n, p = n_navigation + int(mem[Head.N_AUGMENTED]), int(mem[Head.SCRATCH_AT])
    first, axes = (2, 1) if mem[Head.MECHANIZATION] == PLANAR else (3, 3)
    before = mem[r + Nav.STOOD]
    begins = before == 0.0
    mem[r + Nav.STOOD] = JUST_NOW if begins else before + since
    if not begins and (before >= STANDING or mem[r + Nav.STOOD] < STANDING):
        return
    for k in range(axes):
        state = n_navigation + (first + k) * order
        bias, variance = mem[r + NAV + state], mem[p + (n + 1) * state]
        if begins:
            mem[r + Nav.BIAS + k], mem[r + Nav.BIAS_VARIANCE + k] = bias, variance
            continue
        told = mem[r + Nav.BIAS_VARIANCE + k] - variance
        if mem[r + Nav.STOPS] >= 1.0 and told > TOLD * mem[r + Nav.BIAS_VARIANCE + k]:
            realised = min((bias - mem[r + Nav.BIAS + k]) ** 2 / told, LARGEST_DRIFT)
            mem[r + Nav.DRIFT_SUM] += mem[r + Nav.DRIFT_RATIO] * realised
            mem[r + Nav.DRIFT_SEEN] += 1.0
    if begins:
        return
    mem[r + Nav.STOPS] += 1.0
    if mem[r + Nav.DRIFT_SEEN] > DRIFT_MEMORY:
        mem[r + Nav.DRIFT_SUM] *= DRIFT_MEMORY / mem[r + Nav.DRIFT_SEEN]
        mem[r + Nav.DRIFT_SEEN] = DRIFT_MEMORY
    ratio = (DRIFT_PRIOR + mem[r + Nav.DRIFT_SUM]) / (DRIFT_PRIOR + mem[r + Nav.DRIFT_SEEN])
    mem[r + Nav.DRIFT_RATIO] = min(max(ratio, SMALLEST_RATIO), LARGEST_RATIO)


@njit(_nrt=False)
def _variance(mem, axis, dt):
    """White noise of one sample of a gyroscope; an engine that runs may shake it by more."""
    return max(mem[Head.SIZE + 3 + axis] / dt, mem[Head.SPREAD + 1])
