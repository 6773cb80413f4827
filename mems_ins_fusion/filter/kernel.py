"""The compiled filter: one error-state Kalman filter for the live node and for the replay of whole recordings.

All of it lives in one flat array of floats (`FilterConfig.memory` lays it out): a head with sizes and settings, the
noise of each state, a ring of the latest states (rows, see layout.py), a ring of the IMU samples between them, and the
fixes of the same time. Because the ring remembers, a fix that comes late is applied at its own time: back to the state
before it and forward again.
"""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.compiled import njit

from .correction import CONSTRAINT_INTERVAL, apply_fix, constrain
from .layout import FIX_SIZE, Fix, Head, Nav, Sample, fix_at, sample_at, state_at
from .prediction import predict

#: what the answers of `take_fix` mean
FIX_TAKEN, FIX_BEFORE_START, FIX_TOO_LATE = 0, 1, 2
#: time constant of the running means that tell a standstill, s
STILL_TIME = 0.5
#: how long, s, these means must have stayed within so much of the specific force, m/s^2
STEADY_TIME, STEADY_ACCELERATION = 1.0, 0.05


@njit
def _advance(memory, k):
    """State k from state k - 1 and sample k: the interval is split at each fix in it."""
    src, dst, sample = state_at(memory, k - 1), state_at(memory, k), sample_at(memory, k)
    begin, end = memory[src + Nav.TIME], memory[sample + Sample.TIME]
    count = int(memory[Head.FIXES])
    first = count
    while first > 0 and memory[fix_at(memory, first - 1) + Fix.TIME] > begin:
        first -= 1
    width, spare = int(memory[Head.WIDTH]), int(memory[Head.RING_AT]) - int(memory[Head.WIDTH])
    for i in range(first, count):
        fix = fix_at(memory, i)
        time = memory[fix + Fix.TIME]
        if time > end:
            break
        if time > memory[src + Nav.TIME]:
            predict(memory, src, spare, sample, time - memory[src + Nav.TIME])
            memory[spare + Nav.TIME] = time
            src, spare = spare, 2 * int(memory[Head.RING_AT]) - 3 * width - spare  # the other of the last two rows
        apply_fix(memory, src, fix)
    if end > memory[src + Nav.TIME]:
        predict(memory, src, dst, sample, end - memory[src + Nav.TIME])
    else:
        for i in range(width):
            memory[dst + i] = memory[src + i]
    memory[dst + Nav.TIME] = end
    if memory[dst + Nav.CONSTRAINT_TIME] > CONSTRAINT_INTERVAL:
        constrain(memory, dst, sample, end - begin)


@njit
def take_sample(memory, time, f_x, f_y, f_z, w_x, w_y, w_z):
    """Predict to `time` (s since the epoch) with one IMU sample in sensor axes, applying the fixes before it."""
    k = int(memory[Head.SAMPLES]) + 1
    sample = sample_at(memory, k)
    memory[sample + Sample.TIME] = time
    for i in range(6):
        c = Head.CONDITIONING + 6 * i
        memory[sample + Sample.F_X + i] = (memory[c] * f_x + memory[c + 1] * f_y + memory[c + 2] * f_z
                                           + memory[c + 3] * w_x + memory[c + 4] * w_y + memory[c + 5] * w_z
                                           + memory[Head.OFFSET + i])
    if memory[Head.ZERO_VELOCITY_SIGMA] > 0.0:
        memory[sample + Sample.STILL] = _is_still(memory, sample,
                                                  time - memory[sample_at(memory, k - 1) + Sample.TIME])
    _advance(memory, k)
    memory[Head.SAMPLES] = k


@njit
def _is_still(memory, sample, dt):
    """1 when specific force and angular rate scatter little, nothing turns, and their means have been steady for a
    while: who starts or stops gently is quiet, but not that."""
    weight = min(1.0, dt / STILL_TIME)
    turn = 0.0
    for half in range(2):
        variance = 0.0
        for i in range(3 * half, 3 * half + 3):
            deviation = memory[sample + Sample.F_X + i] - memory[Head.STILL_MEAN + i]
            memory[Head.STILL_MEAN + i] += weight * deviation
            variance += deviation * deviation
            if half == 1:
                turn = max(turn, abs(memory[Head.STILL_MEAN + i]))
        memory[Head.STILL_VARIANCE_F + half] += weight * (variance - memory[Head.STILL_VARIANCE_F + half])
    steady = (memory[Head.STILL_VARIANCE_F] < 3.0 * memory[Head.STILL_ACCELERATION] ** 2
              and memory[Head.STILL_VARIANCE_W] < 3.0 * memory[Head.STILL_RATE] ** 2
              and turn < memory[Head.STILL_RATE])
    for i in range(3):
        if abs(memory[Head.STILL_MEAN + i] - memory[Head.STILL_REFERENCE + i]) > STEADY_ACCELERATION:
            steady = False
    time = memory[sample + Sample.TIME]
    if not steady:
        memory[Head.STILL_SINCE] = time
        for i in range(3):
            memory[Head.STILL_REFERENCE + i] = memory[Head.STILL_MEAN + i]
    return 1.0 if time - memory[Head.STILL_SINCE] >= STEADY_TIME else 0.0


@njit
def take_fix(memory, fix):
    """Take in one fix, a vector as in `Fix`; FIX_TAKEN, or why not."""
    capacity, newest = int(memory[Head.CAPACITY]), int(memory[Head.SAMPLES])
    oldest = max(0, newest - capacity + 1)
    time, now = fix[Fix.TIME], memory[state_at(memory, newest) + Nav.TIME]
    if time <= memory[state_at(memory, oldest) + Nav.TIME]:
        return FIX_BEFORE_START if oldest == 0 else FIX_TOO_LATE
    if now - time > memory[Head.MAX_DELAY]:
        return FIX_TOO_LATE
    count = int(memory[Head.FIXES])
    if count == int(memory[Head.FIX_CAPACITY]):  # forget the older half
        half = count // 2
        for i in range(half, count):
            _copy_fix(memory, fix_at(memory, i - half), memory, fix_at(memory, i))
        count -= half
    place = count
    while place > 0 and memory[fix_at(memory, place - 1) + Fix.TIME] > time:
        _copy_fix(memory, fix_at(memory, place), memory, fix_at(memory, place - 1))
        place -= 1
    _copy_fix(memory, fix_at(memory, place), fix, 0)
    memory[Head.FIXES] = count + 1
    if time <= now:  # late: back to the state before it and forward again
        k = newest
        while memory[state_at(memory, k) + Nav.TIME] >= time:
            k -= 1
        for i in range(k + 1, newest + 1):
            _advance(memory, i)
    return FIX_TAKEN


@njit
def _copy_fix(to, at, source, begin):
    for i in range(FIX_SIZE):
        to[at + i] = source[begin + i]


@njit(nogil=True)
def run(memory, time, specific_force, angular_rate, fixes, arrival, answers, columns, states):
    """A whole recording through the same filter.

    time (k,) s, specific_force and angular_rate (k, 3): samples in sensor axes. fixes (f, FIX_SIZE) in the order of
    their arrival, on return with their innovations; arrival (f,): the number of samples that arrived before each;
    answers (f,): as `take_fix` answers. states (k, len(columns)): those columns of each state as a live filter would
    have published it.
    """
    next_fix = 0
    for k in range(len(time)):
        while next_fix < len(fixes) and arrival[next_fix] <= k:
            if memory[Head.FIXES] == memory[Head.FIX_CAPACITY]:
                collect(memory, fixes)
            fixes[next_fix, Fix.ID] = next_fix
            answers[next_fix] = take_fix(memory, fixes[next_fix])
            next_fix += 1
        take_sample(memory, time[k], specific_force[k, 0], specific_force[k, 1], specific_force[k, 2],
                    angular_rate[k, 0], angular_rate[k, 1], angular_rate[k, 2])
        newest = np.uint64(state_at(memory, int(memory[Head.SAMPLES])))
        for i in range(len(columns)):
            states[k, i] = memory[newest + columns[i]]
    collect(memory, fixes)


@njit
def collect(memory, fixes):
    """Innovations of the fixes remembered, back to where each came from."""
    for i in range(int(memory[Head.FIXES])):
        at = fix_at(memory, i)
        _copy_fix(fixes[int(memory[at + Fix.ID])], 0, memory, at)
