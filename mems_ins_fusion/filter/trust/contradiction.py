"""When what the filter believes is contradicted, and nothing in it says by whom it is misled.

*The IMU is wrong* although its samples are finite and in range (axes swapped, a gyroscope off by degrees per second,
noise of a loose mount). The fixes then do not fit, which looks as if they were wrong. The non-holonomic constraint
tells the two apart: with such an IMU the vehicle seems to slide sideways, more than is usual for this vehicle (the
constraint's sigma is a bound for every car and road). Velocity and heading are then made as uncertain as the slide is
large, and for UNSETTLED_TIME fixes are believed whatever their innovation.

*A standstill was none*: a vehicle that creeps very smoothly is taken for one at rest, and its velocity is set to zero.
When it then brakes, the estimated velocity points backwards by about what the standstill took away. Such a velocity
does not keep the next standstill from being applied.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ...navigation import strapdown
from ...navigation.earth import gravity
from ..memory import PLANAR, Head, Nav, velocity_state, yaw_state
from . import hypotheses
from .force_noise import ForceNoise
from .scale import begin_scale

#: s over which the normalized innovation squared (NIS) of the lateral constraint is averaged: its errors last about as
#: long
NOW = 1.0
#: s over which the usual NIS of a vehicle is averaged: some bends and some straights
USUALLY = 30.0
#: usual NIS before any has been seen: half a sigma, as the constraint's sigma is a bound for all vehicles
FIRST_USUAL = 0.25
#: a NIS of more than this many times the usual counts as that: one slide must not become the usual
LARGEST_LESSON = 10.0
#: a slide is a mean NIS of this many times the usual: measured drives stay below 29
SLIDE = 40.0
#: and this mean NIS at least: below half a sigma there is nothing to explain, however quiet the vehicle usually is
SMALLEST_SLIDE = 0.2
#: times the usual, while unsettled: who slid a moment ago does so again more easily
SLIDE_AGAIN = 10.0
#: s for which the fixes decide after a slide: in that time a heading is found again from them
UNSETTLED_TIME = 20.0
#: m/s, speed below which a slide tells no more of the heading than at it: the ratio of the two would be without bound
SLOWEST = 1.0
#: normalized innovation squared of a fix, 2 degrees of freedom, to which an unsettled state is loosened
LOOSENED = 2.0
#: m/s that a wrong standstill takes away at least: less is within what a standstill corrects rightly
SMALLEST_TAKEN = 0.3
#: s since the standstill, after which the velocity is no consequence of it: a creep in traffic ends sooner
LATELY = 30.0
#: cosine of the angle between the velocity and what was taken, reversed: 37 deg, as the vehicle may have turned since
BACK = 0.8
#: size of the velocity at most, over what was taken: the vehicle may brake from a little more than it crept at
AS_LARGE = 2.0
#: m/s more, for the noise of a small velocity
AS_LARGE_FLOOR = 0.5


@njit(_nrt=False)
def slides(mem, r, innovation, s, since):
    """Whether the IMU has the vehicle slide as it does not usually.

    innovation, s: of the lateral constraint, m/s, and its variance. since: s from the one before.
    """
    nis = innovation * innovation / s
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
    first, yaw = velocity_state(mem), yaw_state(mem)
    for i in range(first, first + 2):
        mem[p + (n + 1) * i] += squared
    mem[p + (n + 1) * yaw] += squared / (speed * speed)
    if mem[r + Nav.UNSETTLED] == 0.0:
        hypotheses.claim(mem, r, hypotheses.IMU_WRONG)
    mem[r + Nav.UNSETTLED] = UNSETTLED_TIME
    mem[r + Nav.SLID] += since


@njit(_nrt=False)
def let_fixes_decide(mem, r):
    """The state at r has been misled by an input that is wrong for certain, and the innovations have been that
    input's, not the accelerometers'."""
    begin_scale(mem, r + ForceNoise.SCALE)
    if mem[Head.LATERAL_SIGMA] > 0.0:  # else nobody counts the time
        mem[r + Nav.UNSETTLED] = UNSETTLED_TIME


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
def stood(mem, r, v_n, v_e):
    """Remember what a standstill took away from the velocity at r, which was v_n, v_e before, m/s."""
    if mem[r + Nav.TIME] - mem[r + Nav.STOOD] > NOW:
        mem[r + Nav.TAKEN_N] = mem[r + Nav.TAKEN_E] = 0.0
    mem[r + Nav.STOOD] = mem[r + Nav.TIME]
    mem[r + Nav.TAKEN_N] += v_n - mem[r + Nav.V_N]
    mem[r + Nav.TAKEN_E] += v_e - mem[r + Nav.V_E]


@njit(_nrt=False)
def goes_back(mem, r):
    """Whether the velocity at r is against what a standstill took away lately, and about as large."""
    taken = math.hypot(mem[r + Nav.TAKEN_N], mem[r + Nav.TAKEN_E])
    if taken < SMALLEST_TAKEN or mem[r + Nav.TIME] - mem[r + Nav.STOOD] > LATELY:
        return False
    speed = math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E])
    along = (mem[r + Nav.V_N] * mem[r + Nav.TAKEN_N] + mem[r + Nav.V_E] * mem[r + Nav.TAKEN_E]) / taken
    return -along > BACK * speed and speed < AS_LARGE * taken + AS_LARGE_FLOOR


@njit(_nrt=False)
def admit(mem, r, n):
    """P in the scratch as uncertain as a state is whose velocity goes back: that is wrong altogether, the position by
    what was taken since then, the tilt by what the velocity has changed besides."""
    p, first = int(mem[Head.SCRATCH_AT]), velocity_state(mem)
    elapsed = mem[r + Nav.TIME] - mem[r + Nav.STOOD]
    besides = 0.0
    for i in range(2):
        velocity, taken = mem[r + Nav.V_N + i], mem[r + Nav.TAKEN_N + i]
        mem[p + (n + 1) * i] += (taken * elapsed) ** 2
        mem[p + (n + 1) * (first + i)] += velocity * velocity
        besides += (velocity + taken) ** 2
    if mem[Head.MECHANIZATION] != PLANAR:
        tilt = besides / (gravity(mem[r + Nav.LATITUDE], mem[r + Nav.HEIGHT]) * elapsed) ** 2
        for i in range(strapdown.State.PHI_N, strapdown.State.PHI_E + 1):
            mem[p + (n + 1) * i] += tilt
