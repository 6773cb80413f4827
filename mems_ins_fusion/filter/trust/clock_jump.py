"""Detection of a jump of the time offset of an input: its driver has restarted, or a queue has filled.

The time offset is a state (`measurements/time_offset.py`), which is soon known to hundredths of a second. After a jump
the filter would therefore correct velocity, tilt and position instead of the offset. Innovations after a jump are the
jump J times a *signature*, from which J is estimated by least squares. If it is significant, the filter is made as
uncertain as J explains. The signature of a jump at each possible time would take a filter each (A. S. Willsky and H. L.
Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear systems", IEEE Trans.
Automatic Control 21, 1976). Two of them are known without one:

* *Before the state has followed it*, in the innovations of the input: the time derivative of the measured quantity,
  minus the part of it that the state has already followed, as if it had one state for each component. The variance of
  the offset is increased by J^2.
* *After the state has followed it*, in the innovations of all inputs, fixes among them: that of an error which has
  always been there, by the column of the offset in P. What the Kalman filter gives to the offset, its *corrections* d,
  is all that is needed. Without a jump they are white, and their variance is what they take from the variance V of the
  offset. So

      J = sum(d / V) / sum((V before - V after) / V^2)

  with the inverse of the denominator as its variance. P is increased by J^2 g g', with g = P(:, offset) / V: all that
  an error of the offset has moved becomes uncertain. Used for speeds, velocities and odometries: the jumps of other
  inputs are found before the state has followed them.

While a vehicle speeds up from rest, a speed that is a tenth too large has nearly the same signature, and a heading that
is off while it turns: the constant error of the input may have jumped instead. Both are made uncertain by what would
explain the innovation, and later measurements tell them apart: at a steady speed the time does not matter.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import INPUT, NAV, Event, Head, is_of_velocity
from ..update import product
from .scale import LARGEST_DEVIATION, Noise, Scale, reopen

#: of an input
Jump = INPUT.place(
    'Jump',
    SCORE=4,  # jump of its time offset over its variance, 1/s, and 1 / variance, 1/s^2, before the state has followed
    # it, and the same after that
    OFFSET=1,  # s, its time offset at its latest message,
    OFFSET_VARIANCE=1,  # s^2, and the variance of that
    FOLLOWED=2)  # part of the signature that the state has followed, two components
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
    """Whether the innovations up to the event at `at` show a jump. Then P in the scratch is increased by what it
    explains, and the variance of `error`, the state of the input's constant error (-1: none), by what would cause the
    same innovation.

    own: position of the input's columns. noise, variance: parts of the variance of the innovation, by the input and by
    the state at r. Not to be called for an input that is refused as slip, which says nothing of the time: clipped,
    3 m/s of slip in an acceleration look like half a second.
    """
    state = int(mem[at + Event.TIME_OFFSET])
    if state <= 0:
        return False
    keep = math.exp(-max(mem[at + Event.TIME] - mem[own + Noise.SCALE + Scale.TIME], 0.0) / JUMP_MEMORY)
    for k in range(4):
        mem[own + Jump.SCORE + k] *= keep
    _add_innovation(mem, r, at, n, own, dimensions, noise, variance, state)
    _add_correction(mem, r, n, own, state)
    jump, followed = _significant(mem, r, own + Jump.SCORE, state), False
    if jump == 0.0 and is_of_velocity(mem[at + Event.KIND]):  # others are found before the state has followed them
        jump, followed = _significant(mem, r, own + Jump.SCORE + 2, state), True
    if jump == 0.0:
        return False
    p = int(mem[Head.SCRATCH_AT])
    h = p + n * n
    if error >= 0 and mem[h + error] != 0.0:
        other = jump * mem[h + state] / mem[h + error]
        mem[p + (n + 1) * error] += min(abs(other), LARGEST_ERROR) ** 2
    if followed:
        column, factor = h + 3 * n, (jump / mem[p + (n + 1) * state]) ** 2
        for i in range(n):
            mem[column + i] = mem[p + n * i + state]
        for i in range(n):
            for j in range(n):
                mem[p + n * i + j] += factor * mem[column + i] * mem[column + j]
    else:
        mem[p + (n + 1) * state] += jump**2
    for k in range(4):
        mem[own + Jump.SCORE + k] = 0.0
    reopen(mem, own + Noise.SCALE, 1.0)  # innovations before it may have been caused by the jump, and not by noise
    return True


@njit(_nrt=False)
def _add_innovation(mem, r, at, n, own, dimensions, noise, variance, state):
    """Add the innovation of the event at `at` to what tells a recent jump."""
    h = int(mem[Head.SCRATCH_AT]) + n * n
    gain = variance / (variance + noise)
    left = math.exp(-max(mem[at + Event.TIME] - mem[own + Noise.SCALE + Scale.TIME], 0.0) / FOLLOWING_TIME)
    largest = LARGEST_DEVIATION * math.sqrt(noise + variance)
    for k in range(dimensions):
        followed = left * mem[own + Jump.FOLLOWED + k]
        signature = mem[h + n * k + state] - followed
        mem[own + Jump.FOLLOWED + k] = followed + gain * signature
        innovation = mem[at + Event.Z_N + k] - product(mem, n, h + n * k, r + NAV)
        innovation = max(-largest, min(innovation, largest))
        mem[own + Jump.SCORE] += signature * innovation / (noise + variance)
        mem[own + Jump.SCORE + 1] += signature * signature / (noise + variance)


@njit(_nrt=False)
def _add_correction(mem, r, n, own, state):
    """Add the correction of the offset since the previous message of the input to what tells a jump before that."""
    offset, variance = mem[r + NAV + state], mem[int(mem[Head.SCRATCH_AT]) + (n + 1) * state]
    before = mem[own + Jump.OFFSET_VARIANCE]
    if variance < before:  # else it is the first one, or was made uncertain
        mem[own + Jump.SCORE + 2] += (offset - mem[own + Jump.OFFSET]) / before
        mem[own + Jump.SCORE + 3] += (before - variance) / before**2
    mem[own + Jump.OFFSET], mem[own + Jump.OFFSET_VARIANCE] = offset, variance


@njit(_nrt=False)
def _significant(mem, r, seen, state):
    """Jump by score and information at `seen`; 0: none that is significant, or one that is another fault."""
    score, information = mem[seen], mem[seen + 1]
    if information == 0.0 or abs(score) < max(OFFSET_SIGMAS * math.sqrt(information), SMALLEST_JUMP * information):
        return 0.0
    jump = score / information
    return jump if abs(mem[r + NAV + state] + jump) <= LARGEST_OFFSET else 0.0
