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

from ..memory import NAV, Event, Head, is_of_velocity
from .scale import Scale, Seen, reopen

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
def has_jumped(mem, r, at, n, own, slips, error):
    """Whether the corrections of the time offset up to the event at `at` show a jump."""
    state = int(mem[at + Event.TIME_OFFSET])
    if state <= 0:
        return False
    p = int(mem[Head.SCRATCH_AT])
    value, variance = mem[r + NAV + state], mem[p + (n + 1) * state]
    change, expected = value - mem[own + Seen.OFFSET], mem[own + Seen.OFFSET_VARIANCE]
    mem[own + Seen.OFFSET], mem[own + Seen.OFFSET_VARIANCE] = value, variance
    keep = math.exp(-max(mem[at + Event.TIME] - mem[own + Scale.TIME], 0.0) / JUMP_MEMORY)
    score, information = keep * mem[own + Seen.JUMP_SCORE], keep * mem[own + Seen.JUMP_INFORMATION]
    if variance < expected:
        score += change / expected
        information += (expected - variance) / expected**2
    mem[own + Seen.JUMP_SCORE], mem[own + Seen.JUMP_INFORMATION] = score, information
    if slips or information == 0.0 or (
            abs(score) < max(OFFSET_SIGMAS * math.sqrt(information), SMALLEST_JUMP * information)):
        return False
    jump = score / information
    if abs(value + jump) > LARGEST_OFFSET:
        return False
    h = p + n * n
    if error >= 0 and mem[h + error] != 0.0:
        other = jump * mem[h + state] / mem[h + error]
        mem[p + (n + 1) * error] += min(abs(other), LARGEST_ERROR) ** 2
    if is_of_velocity(mem[at + Event.KIND]):
        factor = (jump / variance) ** 2
        column = h + 3 * n
        for i in range(n):
            mem[column + i] = mem[p + n * i + state]
        for i in range(n):
            for j in range(n):
                mem[p + n * i + j] += factor * mem[column + i] * mem[column + j]
    else:
        mem[p + (n + 1) * state] += jump**2
    mem[own + Seen.OFFSET_VARIANCE] = mem[p + (n + 1) * state]
    mem[own + Seen.JUMP_SCORE] = mem[own + Seen.JUMP_INFORMATION] = 0.0
    reopen(mem, own, 1.0)  # innovations before it may have been caused by the jump, and not by noise
    return True
