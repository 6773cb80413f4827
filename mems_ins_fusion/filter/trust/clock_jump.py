"""Detection of a jump of the time offset of an input: its driver has restarted, or a queue has filled.

The time offset is a state (`measurements/time_offset.py`), which is soon known to hundredths of a second. After a jump
the filter would therefore correct the velocity instead of the offset. Innovations after a jump are the jump times a
*signature*: the time derivative of the measured quantity, minus the part of it that the state has already followed. The
jump is estimated by least squares from the latest innovations. If it is significant, the variance of the offset is
increased by its square.

Source: A. S. Willsky and H. L. Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps
in linear systems", IEEE Trans. Automatic Control 21, 1976. There the signature is that of the whole filter. Here it is
that of a filter with one state for each component, with which half of a slow jump is detected.

While a vehicle speeds up from rest, a speed that is a tenth too large has nearly the same signature, and a heading that
is off while it turns: the constant error of the input may have jumped instead. Both are made uncertain by what would
explain the innovation, and later measurements tell them apart: at a steady speed the time does not matter.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import NAV, Event, Head
from ..update import product
from .scale import LARGEST_DEVIATION, Scale, Seen, reopen

#: s, time constant with which earlier innovations are forgotten: the duration of a manoeuvre. Those before the jump
#: make the estimated jump too small
JUMP_MEMORY = 4.0
#: s, time constant with which fixes correct the part of the error that the state has followed. Chosen, not measured
FOLLOWING_TIME = 10.0
#: smallest significant jump in standard deviations. Exceeded by chance in one of 370 manoeuvres; the next manoeuvre
#: then shows the offset again
OFFSET_SIGMAS = 3.0
#: s, smallest jump: slip of tyres and pitch of the body cause errors of this size when a vehicle accelerates
SMALLEST_JUMP = 0.05
#: s, largest time offset after a jump, relative to the configured one: half a second, plus one sigma of an undeclared
#: offset. A larger one is another fault, such as wheels that slip
LARGEST_OFFSET = 0.6
#: -, rad: up to this the constant error of an input (scale, offset of a heading) may have become another one: tyres of
#: another size or on another ground, antennas that have turned. More is another unit, or other axes. Chosen, not
#: measured
LARGEST_ERROR = 0.2


@njit(_nrt=False)
def has_jumped(mem, r, at, n, own, dimensions, noise, variance, error):
    """Whether the innovations up to the event at `at` show a jump. Then the variance of the offset in P of the scratch
    is increased by the square of the jump, and that of `error`, the state of the input's constant error (-1: none), by
    what would cause the same innovation.

    own: position of the input's `Seen`. noise, variance: parts of the variance of the innovation, by the input and by
    the state at r.
    """
    state = int(mem[at + Event.TIME_OFFSET])
    if state <= 0:
        return False
    p = int(mem[Head.SCRATCH_AT])
    h = p + n * n
    since, gain = max(mem[at + Event.TIME] - mem[own + Scale.TIME], 0.0), variance / (variance + noise)
    keep, left = math.exp(-since / JUMP_MEMORY), math.exp(-since / FOLLOWING_TIME)
    largest = LARGEST_DEVIATION * math.sqrt(noise + variance)
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
    if abs(score) < max(OFFSET_SIGMAS * math.sqrt(information), SMALLEST_JUMP * information) or information == 0.0:
        return False
    jump = score / information
    if abs(mem[r + NAV + state] + jump) > LARGEST_OFFSET:
        return False
    mem[p + (n + 1) * state] += jump**2
    if error >= 0 and mem[h + error] != 0.0:
        other = jump * mem[h + state] / mem[h + error]
        mem[p + (n + 1) * error] += min(abs(other), LARGEST_ERROR) ** 2
    mem[own + Seen.JUMP_SCORE] = mem[own + Seen.JUMP_INFORMATION] = 0.0
    reopen(mem, own, 1.0)  # innovations before it may have been caused by the jump, and not by noise
    return True
