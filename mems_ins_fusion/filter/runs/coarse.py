"""Continue a small copy of a filter (newest.py) without fixes, in steps of several of the filter's samples.

The samples of a step are merged to one: the total rotation, and the mean specific force in the axes of the middle of
the step, both to second order in the rotation. So turns and fast vibrations (coning, sculling) have the same effect as
with single samples. Faults and standstills are those that the filter itself has found. A step takes the time of one
sample of the filter; at 100 Hz twenty samples are merged.
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..advance import advance
from ..memory import Event, Head, Nav, Sample, copy, event_at, nonnegative, sample_at, state_at
from ..trust.imu_share import Difference
from .newest import STEP


@njit(_nrt=False)
def follow(small, memory, after, withheld):
    """Continue `small`, whose state 0 is that after sample `after` of `memory`, to the newest sample of `memory`.

    withheld: (k,) whether measurements with this `Event.INPUT` are withheld from the copy. A measurement that arrived
    too late for its step is left out. Returns False if `memory` does not have all samples: it no longer has them, or is
    another filter's that has taken over and began after sample `after` (`bank._copy`).
    """
    k, newest = after + 1, int(memory[Head.SAMPLES])
    first, last = nonnegative(state_at(small, 0)), nonnegative(state_at(small, 1))
    event, begin = int(memory[Head.EVENTS]), small[first + Nav.TIME]
    if memory[sample_at(memory, after) + Sample.TIME] != begin:
        return False
    while event > 0 and memory[event_at(memory, event - 1) + Event.TIME] > begin:
        event -= 1
    while k <= newest:
        k = _merge(small, memory, k, newest)
        event = _take_inputs(small, memory, event, withheld)
        advance(small, 1)
        copy(small, first, small, last, int(small[Head.WIDTH]))
    return True


@njit(_nrt=False)
def _merge(small, memory, k, newest):
    """Write the samples from k on of one step of `memory` to sample 1 of `small`; returns the number of the next one.

    A gap (`imu.max_gap`) is a step of its own.
    """
    at, to = nonnegative(sample_at(memory, k)), nonnegative(sample_at(small, 1))
    # rad, rotation from the expected middle of the step: b to its begin, a to the end of the samples merged so far
    half = -0.5 * max(STEP, memory[at + Sample.INTERVAL])
    b_x, b_y, b_z = half * memory[at + Sample.W_X], half * memory[at + Sample.W_Y], half * memory[at + Sample.W_Z]
    a_x, a_y, a_z = b_x, b_y, b_z
    first, step = k, 0.0
    v_x = v_y = v_z = cone_x = cone_y = cone_z = 0.0
    while k <= newest:
        one = nonnegative(sample_at(memory, k))
        dt = memory[one + Sample.INTERVAL]
        if step > 0.0 and (step + 0.5 * dt > STEP or dt > memory[Head.MAX_GAP]):
            break
        at, k, step = one, k + 1, step + dt
        f_x, f_y, f_z = dt * memory[at + Sample.F_X], dt * memory[at + Sample.F_Y], dt * memory[at + Sample.F_Z]
        d_x, d_y, d_z = dt * memory[at + Sample.W_X], dt * memory[at + Sample.W_Y], dt * memory[at + Sample.W_Z]
        c_x, c_y, c_z = _cross(a_x - b_x, a_y - b_y, a_z - b_z, d_x, d_y, d_z)
        cone_x, cone_y, cone_z = cone_x + 0.5 * c_x, cone_y + 0.5 * c_y, cone_z + 0.5 * c_z
        m_x, m_y, m_z = a_x + 0.5 * d_x, a_y + 0.5 * d_y, a_z + 0.5 * d_z
        c_x, c_y, c_z = _cross(m_x, m_y, m_z, f_x, f_y, f_z)
        e_x, e_y, e_z = _cross(m_x, m_y, m_z, c_x, c_y, c_z)
        v_x, v_y, v_z = v_x + f_x + c_x + 0.5 * e_x, v_y + f_y + c_y + 0.5 * e_y, v_z + f_z + c_z + 0.5 * e_z
        a_x, a_y, a_z = a_x + d_x, a_y + d_y, a_z + d_z
        if dt > memory[Head.MAX_GAP]:
            break
    copy(small, to, memory, at, Sample.SIZE)
    if step > 0.0:
        for i in range(6):
            total = 0.0
            for j in range(first, k):
                one = nonnegative(sample_at(memory, j))
                total += memory[one + Sample.INTERVAL] * memory[one + Difference.VALUE + i]
            small[to + Difference.VALUE + i] = total / step
        c_x, c_y, c_z = _cross(0.5 * (a_x + b_x), 0.5 * (a_y + b_y), 0.5 * (a_z + b_z), v_x, v_y, v_z)
        small[to + Sample.F_X], small[to + Sample.F_Y] = (v_x - c_x) / step, (v_y - c_y) / step
        small[to + Sample.F_Z], small[to + Sample.W_X] = (v_z - c_z) / step, (a_x - b_x + cone_x) / step
        small[to + Sample.W_Y], small[to + Sample.W_Z] = (a_y - b_y + cone_y) / step, (a_z - b_z + cone_z) / step
        small[to + Sample.INTERVAL] = step
    return k


@njit(inline='always')
def _cross(a_x, a_y, a_z, b_x, b_y, b_z):
    return a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x


@njit(_nrt=False)
def _take_inputs(small, memory, event, withheld):
    """Copy the measurements of `memory`, from number `event` on, that belong to the step and are not withheld to
    `small`. Returns the number of the next one."""
    count, end = 0, small[nonnegative(sample_at(small, 1)) + Sample.TIME]
    while event < int(memory[Head.EVENTS]) and memory[event_at(memory, event) + Event.TIME] <= end:
        at, to = event_at(memory, event), event_at(small, count)
        if withheld[int(memory[at + Event.INPUT])] == 0.0:
            copy(small, to, memory, at, Event.SIZE)
            count += 1
        event += 1
    small[Head.EVENTS] = count
    return event
