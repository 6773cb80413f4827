"""An input whose stamps are suddenly off by another time: a driver that has restarted, a queue that has filled.

By then its time offset is known to hundredths of a second (`measurements/time_offset.py`), and what is off would go
into the velocity. But until it has gone there, innovations are in proportion to how fast what is measured changes, less
what the state has followed already: their signature. The factor, least squares of the latest innovations, is how far
the estimate is off. Where that is certain, the offset has jumped by as much (A. S. Willsky and H. L. Jones, "A
generalized likelihood ratio approach to the detection and estimation of jumps in linear systems", IEEE Trans. Automatic
Control 21, 1976; theirs is the signature in the whole filter, this one that in a filter of one state for each
component, which sees half of a slow jump).

While a vehicle speeds up from rest, a speed that is a tenth too large has nearly the same signature, and a heading that
is off while it turns: the constant error of the input may have jumped instead. Both are made uncertain by what would
explain the innovation, and what follows tells them apart: at a steady speed the time does not matter.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import NAV, Event, Head
from ..update import product
from .scale import LARGEST_INNOVATION, Scale, Seen, reopen

#: s for which innovations are remembered: a manoeuvre. Of those before the jump each speaks against it
FORGETTING_TIME = 4.0
#: s for which the state keeps what it has followed, until fixes take it back
FOLLOWING_TIME = 10.0
#: sigmas beyond which it has jumped: so far off by chance is one manoeuvre of 370, and the estimate is as good again
#: after the next one
SIGNIFICANT = 3.0
#: s, and it has jumped by so much: less is the slip of tyres and the pitch of a body that accelerates
SMALLEST_JUMP = 0.05
#: s, beside the parameter: what is further off then has another fault, as wheels that slip, and would pass for one of
#: that; half a second, and a sigma of what nobody declares
LARGEST_OFFSET = 0.6
#: -, rad: up to this the constant error of an input (scale, offset of a heading) may have become another one: tyres of
#: another size or on another ground, antennas that have turned. More is another unit, or other axes. Chosen, not
#: measured
LARGEST_ERROR = 0.2


@njit(_nrt=False)
def has_jumped(mem, r, at, n, own, dimensions, noise, variance, error):
    """Whether the innovation of the event at `at` and those before say so; the offset's variance in P of the scratch
    is then larger by the square of the jump, and that of `error`, the state of the input's constant error (-1: none),
    by what would be as large an innovation.

    own: position of the input's `Seen`. noise, variance: of the innovation, of the input and of the state at r.
    """
    state = int(mem[at + Event.TIME_OFFSET])
    if state <= 0:
        return False
    p = int(mem[Head.SCRATCH_AT])
    h = p + n * n
    since, gain = max(mem[at + Event.TIME] - mem[own + Scale.TIME], 0.0), variance / (variance + noise)
    keep, left = math.exp(-since / FORGETTING_TIME), math.exp(-since / FOLLOWING_TIME)
    largest = LARGEST_INNOVATION * math.sqrt(noise + variance)
    score, information = keep * mem[own + Seen.JUMP_SCORE], keep * mem[own + Seen.JUMP_INFORMATION]
    for k in range(dimensions):
        followed = left * mem[own + Seen.FOLLOWED + k]
        signature = mem[h + n * k + state] - followed
        mem[own + Seen.FOLLOWED + k] = followed + gain * signature
        innovation = mem[at + Event.Z_N + k] - product(mem, n, h + n * k, r + NAV)
        innovation = max(-largest, min(innovation, largest))
        score += signature * innovation / (noise + variance)
        information += signature * signature / (noise + variance)
    mem[own + Seen.JUMP_SCORE], mem[own + Seen.JUMP_INFORMATION] = score, information
    if abs(score) < max(SIGNIFICANT * math.sqrt(information), SMALLEST_JUMP * information) or information == 0.0:
        return False
    jump = score / information
    if abs(mem[r + NAV + state] + jump) > LARGEST_OFFSET:
        return False
    mem[p + (n + 1) * state] += jump**2
    if error >= 0 and mem[h + error] != 0.0:
        other = jump * mem[h + state] / mem[h + error]
        mem[p + (n + 1) * error] += min(abs(other), LARGEST_ERROR) ** 2
    mem[own + Seen.JUMP_SCORE] = mem[own + Seen.JUMP_INFORMATION] = 0.0
    reopen(mem, own, 1.0)  # what seemed to be noise may have been that
    return True
