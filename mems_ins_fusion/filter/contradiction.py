"""When what the filter believes is contradicted, and nothing in it says by whom it is misled.

*A witness.* An IMU that is finite, in range and wrong (axes swapped, a gyroscope off by degrees per second, noise of a
loose mount) leads the filter astray, and the fixes look like the ones to blame. The non-holonomic constraint tells: by
such an IMU the vehicle slides. Not by how much the constraint's sigma allows, which is a bound for every car and road,
but beside what is usual for this one. Then velocity and attitude are as uncertain as the slide is large, and for a while
the fixes are believed as they are.

*No witness.* Where fixes contradict the prediction more from one to the next, either may be wrong. The filter follows
them step by step; what is published covers both: where it has been drawn from, and where the fixes would have it.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..navigation import planar, strapdown
from .layout import NAV, PLANAR, Event, Head, Nav, Verdict

#: s over which the normalized innovation squared (NIS) of the lateral constraint is averaged, and what is usual of it
NOW, USUALLY = 1.0, 30.0
#: what is usual before any has been seen: the constraint's sigma is a bound
FIRST_USUAL = 0.25
#: one beyond so many times the usual teaches no more than that
LARGEST_LESSON = 10.0
#: a slide is so many times the usual (measured drives stay below 29), and this at least; and while unsettled
SLIDE, SMALLEST_SLIDE, SLIDE_AGAIN = 40.0, 0.2, 10.0
#: after a slide the fixes decide for s
UNSETTLED_TIME = 20.0
#: slower than this a slide says nothing of the heading, m/s
SLOWEST = 1.0
#: normalized innovation squared of a fix, 2 degrees of freedom, to which an unsettled state is loosened
LOOSENED = 2.0
#: part of the way between filter and fixes that is one sigma of where the truth is
DISPUTED = 0.5
#: s in which what the fixes have drawn is forgotten when they fit
FORGIVEN = 10.0


@njit(_nrt=False)
def slides(mem, r, nis, since):
    """Whether the vehicle slides as it does not usually; nis: of the lateral constraint, since: s from the one before."""
    usual = mem[r + Nav.USUAL_SLIDING]
    mem[r + Nav.SLIDING] += (nis - mem[r + Nav.SLIDING]) * min(since / NOW, 1.0)
    mem[r + Nav.USUAL_SLIDING] += (min(nis, LARGEST_LESSON * usual) - usual) * min(since / USUALLY, 1.0)
    times = SLIDE_AGAIN if mem[r + Nav.UNSETTLED] > 0.0 else SLIDE
    mem[r + Nav.UNSETTLED] = max(mem[r + Nav.UNSETTLED] - since, 0.0)
    return mem[r + Nav.SLIDING] > max(times * usual, SMALLEST_SLIDE)


@njit(_nrt=False)
def unsettle(mem, r, n, innovation, since):
    """Velocity and heading of P in the scratch less certain by a slide of `innovation`, m/s."""
    p, squared = int(mem[Head.SCRATCH_AT]), innovation * innovation
    speed = max(math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]), SLOWEST)
    first, yaw = planar.State.V_N, planar.State.YAW
    if mem[Head.MECHANIZATION] != PLANAR:
        first, yaw = strapdown.State.V_N, strapdown.State.PHI_D
    for i in range(first, first + 2):
        mem[p + (n + 1) * i] += squared
    mem[p + (n + 1) * yaw] += squared / (speed * speed)
    mem[r + Nav.UNSETTLED] = UNSETTLED_TIME
    mem[Head.UNSETTLED] += since


@njit(_nrt=False)
def loosen(mem, r, n, nis):
    """The navigation errors in P of the scratch so uncertain that a fix with this nis, before the correction, fits."""
    if nis <= LOOSENED:
        return
    p, n_navigation, factor = int(mem[Head.SCRATCH_AT]), int(mem[Head.N_NAVIGATION]), math.sqrt(nis / LOOSENED)
    for i in range(n_navigation):
        for j in range(n):
            mem[p + n * i + j] *= factor
            mem[p + n * j + i] *= factor


@njit(_nrt=False)
def gives_in(mem, r, at, difference):
    """The filter is about to start anew from the fix at `at`; difference: predicted minus measured position, m."""
    mem[r + Nav.DRAWN_N] += difference[0] - mem[r + NAV]
    mem[r + Nav.DRAWN_E] += difference[1] - mem[r + NAV + 1]


@njit(_nrt=False)
def dispute(mem, r, at, left_n, left_e):
    """What is published beside P after the fix at `at`, which has been judged, and left this of its innovation, m.

    left: updated minus measured position. The way from the prediction to there is what the fix has drawn.
    """
    interval = max(mem[at + Event.TIME] - mem[r + Nav.FIX_TIME], 0.0)
    misfit = mem[at + Event.NIS] > mem[Head.ROBUST_SIGMA] ** 2 and mem[Head.ROBUST_SIGMA] > 0.0
    if mem[at + Event.VERDICT] == Verdict.REFUSED:
        return
    if not misfit:
        keep = math.exp(-interval / FORGIVEN)
        mem[r + Nav.DRAWN_N] *= keep
        mem[r + Nav.DRAWN_E] *= keep
        left_n = left_e = 0.0
    else:
        mem[r + Nav.DRAWN_N] += mem[at + Event.Z_N] - left_n
        mem[r + Nav.DRAWN_E] += mem[at + Event.Z_E] - left_e
    drawn_n, drawn_e = mem[r + Nav.DRAWN_N], mem[r + Nav.DRAWN_E]
    part = DISPUTED * DISPUTED
    mem[r + Nav.DISPUTED_NN] = part * (left_n * left_n + drawn_n * drawn_n)
    mem[r + Nav.DISPUTED_NE] = part * (left_n * left_e + drawn_n * drawn_e)
    mem[r + Nav.DISPUTED_EE] = part * (left_e * left_e + drawn_e * drawn_e)
