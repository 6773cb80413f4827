"""Advance one filter by one IMU sample or by one measurement: the two steps of `kernel.run`.

A late measurement is applied at its own time: the filter returns to the last state before it, or to an earlier one
where that is no longer kept, and repeats the samples and measurements that followed.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit
from mems_ins_fusion.compiled_lanes import LANES, four, put

from ..navigation.earth import gravity
from . import history
from .apply import apply_event
from .constraints import CONSTRAINT_INTERVAL, constrain, decide_share
from .measurements.geometry import body_to_level
from .measurements.wheel_vibration import Wheels, listen
from .memory import (
    NAV,
    Error,
    Event,
    Head,
    Kind,
    Nav,
    Sample,
    Verdict,
    channel_of,
    copy,
    element_at,
    event_at,
    has_constraints,
    kept_state,
    nonnegative,
    oldest_state,
    row_of,
    sample_at,
    state_at,
    state_before,
    time_of,
)
from .prediction import UNKNOWN_TILT_SIGMA, allow_for_restart, predict
from .trust import imu_faults, imu_share
from .trust.extrapolation import Wrong
from .trust.imu_faults import Fault, Imu
from .trust.imu_share import Share
from .trust.standstill import certain_speed, is_still, velocity_sigma
from .trust.usual_speed import is_without_fixes
from .trust.white_noise import show_noise

#: answers of `take_event`: the measurement is in the memory; it is older than the first state; it is older than
#: `gnss.max_delay` or than the states in the memory; it is older than measurements that the memory has dropped
TAKEN, BEFORE_START, TOO_LATE, FORGOTTEN = 0, 1, 2, 3
#: s. After at least this long without a valid IMU sample the sensor errors may have changed, because the IMU may have
#: been switched off and on or its driver restarted (`allow_for_restart`). Shorter than such a restart takes
SHORTEST_RESTART = 1.5
#: m/s, standard deviation that is added to the velocity where a state is not finite and is replaced by the state before
#: it, as UNKNOWN_TILT_SIGMA to the attitude: far more than one sample can change the velocity
RESTART_VELOCITY = 1.0


@njit(_nrt=False)
def advance(memory, k):
    """Compute state k from state k - 1 and IMU sample k. The interval is split at each measurement in it."""
    first_row, dst = nonnegative(state_at(memory, k - 1)), nonnegative(state_at(memory, k))
    sample = nonnegative(sample_at(memory, k))
    src = first_row
    begin, end = memory[src + Nav.TIME], memory[sample + Sample.TIME]
    count = int(memory[Head.EVENTS])
    first = count
    while first > 0 and memory[event_at(memory, first - 1) + Event.TIME] > begin:
        first -= 1
    width, spare = int(memory[Head.WIDTH]), int(memory[Head.RING_AT]) - int(memory[Head.WIDTH])
    memory[sample + Sample.CONSTRAINT] = 0.0
    for i in range(first, count):
        event = event_at(memory, i)
        time = memory[event + Event.TIME]
        if time > end:
            break
        if time > memory[src + Nav.TIME]:
            predict(memory, src, spare, sample, time - memory[src + Nav.TIME])
            memory[spare + Nav.TIME] = time
            src, spare = spare, 2 * int(memory[Head.RING_AT]) - 3 * width - spare  # the other of the last two rows
        apply_event(memory, src, event, sample)
    if end > memory[src + Nav.TIME]:
        predict(memory, src, dst, sample, end - memory[src + Nav.TIME])
    else:
        copy(memory, dst, memory, src, width)
    memory[dst + Nav.TIME] = end
    if memory[first_row + Nav.BRIDGED] > SHORTEST_RESTART and memory[dst + Nav.BRIDGED] == 0.0:
        allow_for_restart(memory, dst)  # this is the first valid sample after a long gap
    due = CONSTRAINT_INTERVAL - 0.5 * memory[sample + Sample.INTERVAL]  # due at the nearest sample
    if has_constraints(memory) and memory[dst + Nav.CONSTRAINT_TIME] > due:
        constrain(memory, dst, sample)
    if memory[Share.STATE] > 0.0:
        decide_share(memory, dst)
    if not _is_finite(memory, dst):
        _restore(memory, first_row, dst, end)


@njit(_nrt=False, forceinline=True)
def _is_finite(memory, r):
    """Whether the navigation solution, the navigation errors and their variances in row r are finite."""
    r, n_navigation, m = (nonnegative(r), nonnegative(int(memory[Head.N_NAVIGATION])),
                          nonnegative(int(memory[Head.N_AUGMENTED])))
    total = 0.0
    for i in range(Nav.MEMORY):
        total += memory[r + i]
    diagonal = r + NAV + n_navigation + m
    for i in range(n_navigation):
        total += memory[r + NAV + i] + memory[diagonal]
        diagonal += n_navigation + m + 1
    return math.isfinite(total)


@njit(_nrt=False)
def _restore(memory, good, r, time):
    """Replace the state in row r by the earlier state in row `good`, with larger variances of velocity and attitude.

    time: of the new state, s since the filter's epoch.
    """
    copy(memory, r, memory, good, int(memory[Head.WIDTH]))
    memory[r + Nav.TIME] = time
    n_navigation = int(memory[Head.N_NAVIGATION])
    for error in range(Error.V_N, Error.SIZE):
        i = row_of(memory, error)
        if i >= 0:
            sigma = RESTART_VELOCITY if error <= Error.V_D else UNKNOWN_TILT_SIGMA
            memory[element_at(memory, r, i, i)] += sigma**2
    history.lose(memory, n_navigation + int(memory[Head.N_AUGMENTED]))
    memory[r + Nav.RESTARTS] += 1.0


@njit(_nrt=False)
def take_sample(memory, samples, i):
    """Predict to the time of sample i of `samples` (see `kernel.run`), with the measurements up to that time."""
    i, k = nonnegative(i), int(memory[Head.SAMPLES]) + 1
    sample, before = nonnegative(sample_at(memory, k)), nonnegative(state_at(memory, k - 1))
    time = samples[i, 0]
    dt = time - memory[nonnegative(sample_at(memory, k - 1)) + Sample.TIME]
    memory[sample + Sample.TIME], memory[sample + Sample.INTERVAL] = time, dt
    sigma = velocity_sigma(memory, before)
    speed = certain_speed(memory, before, sigma)
    before_fault = memory[nonnegative(sample_at(memory, k - 1)) + Sample.FAULT]
    wrong = imu_faults.is_wrong(memory, before, time)
    fault = imu_faults.check(memory, samples, i, dt, speed, wrong, before_fault)
    memory[sample + Sample.FAULT] = fault
    memory[sample + Sample.RATE_SCATTER] = memory[Imu.RATE_SCATTER]
    differ = samples.shape[1] > 7 and memory[Share.STATE] > 0.0
    if differ:
        imu_share.take_difference(memory, before, sample, samples, i)
    if fault == Fault.NONE:
        _condition(memory, sample)
        if differ:
            imu_share.remove_share(memory, sample)
    else:
        coast(memory, sample, before)
    if dt > memory[Head.MAX_GAP] and k > 1:  # the motion during the gap is unknown: use the mean of both ends
        last = nonnegative(sample_at(memory, k - 1))
        for j in range(6):
            memory[sample + Sample.F_X + j] = 0.5 * (memory[sample + Sample.F_X + j] + memory[last + Sample.F_X + j])
    show_noise(memory, k, dt)
    memory[sample + Sample.STILL] = 0.0
    if memory[Head.ZERO_VELOCITY_SIGMA] > 0.0 and fault == Fault.NONE:
        still = is_still(memory, sample, dt, speed, sigma, is_without_fixes(memory, before))
        if still and not imu_faults.is_stuck(memory, dt):  # a stuck accelerometer looks still in motion, too
            memory[sample + Sample.STILL] = memory[nonnegative(sample_at(memory, k - 1)) + Sample.STILL] + dt
    _refuse_ahead(memory, time)
    advance(memory, k)
    memory[Head.SAMPLES] = k
    if memory[Wheels.AT] > 0.0:
        listen(memory, k)
    if memory[Wrong.SINCE] != 0.0:
        _withdraw(memory, k)


@njit(_nrt=False)
def _refuse_ahead(memory, time):
    """Refuse measurements whose stamp is more than Head.AHEAD later than `time`, s, of the new IMU sample.

    They arrived before this sample, so their stamp must come from another clock.
    """
    i = int(memory[Head.EVENTS]) - 1
    while i >= 0 and memory[event_at(memory, i) + Event.TIME] > time + memory[Head.AHEAD]:
        memory[event_at(memory, i) + Event.VERDICT] = Verdict.AHEAD
        i -= 1


@njit(_nrt=False, fastmath={'contract'}, forceinline=True)
def _condition(memory, sample):
    """Write to `sample` the latest six values (sensor axes), rotated to body axes and corrected as configured."""
    for first in range(0, 6 - LANES + 1, 6 - LANES):  # the first four of the six, and the last four
        total = four(memory, Head.OFFSET + first)
        for j in range(6):
            total = total + memory[Imu.RAW + j] * four(memory, Head.CONDITIONING + 6 * j + first)
        put(memory, sample + Sample.F_X + first, total)


@njit(_nrt=False)
def coast(memory, sample, r):
    """Write to `sample` what the IMU would measure if the vehicle kept the velocity of the state at r and did not turn.
    """
    c = body_to_level(memory, r)
    g = gravity(memory[r + Nav.LATITUDE], memory[r + Nav.HEIGHT])
    for axis in range(6):
        # the reaction to gravity, and the estimated errors, which the prediction subtracts again
        state = channel_of(memory, axis)
        error = memory[r + NAV + state] + imu_share.error(memory, r, sample, axis) if state >= 0 else 0.0
        memory[sample + Sample.F_X + axis] = error - g * c[6 + axis] if axis < 3 else error


@njit(_nrt=False)
def repeat(memory, after, until):
    """Compute the states after state `after`, which is in the memory, up to state `until` again."""
    for j in range(after + 1, until + 1):
        advance(memory, j)


@njit(_nrt=False)
def return_to(memory, k):
    """Have state k in the memory again, of which the samples are still there; the caller repeats what followed it."""
    repeat(memory, kept_state(memory, k), k)


@njit(_nrt=False)
def can_return_to(memory, k):
    """Whether all measurements that are needed to return to state k are in the memory."""
    return time_of(memory, kept_state(memory, k)) >= memory[Head.FORGOTTEN]


@njit(_nrt=False)
def take_event(memory, events, i):
    """Put measurement i of `events` (rows as in `Event`) into the memory and, where it is late, repeat what followed.

    Returns TAKEN, or the reason why it is not used: BEFORE_START, TOO_LATE, FORGOTTEN.
    """
    newest, oldest, time = int(memory[Head.SAMPLES]), oldest_state(memory), events[i, Event.TIME]
    if time <= time_of(memory, oldest):
        return BEFORE_START if oldest == 0 else TOO_LATE
    if time_of(memory, newest) - time > memory[Head.MAX_DELAY]:
        return TOO_LATE
    k = state_before(memory, time)
    if not can_return_to(memory, k):
        return FORGOTTEN
    count = int(memory[Head.EVENTS])
    if count == int(memory[Head.EVENT_CAPACITY]):  # full: drop the older half
        half = count // 2
        memory[Head.FORGOTTEN] = memory[event_at(memory, half - 1) + Event.TIME]
        copy(memory, event_at(memory, 0), memory, event_at(memory, half), (count - half) * Event.SIZE)
        count -= half
    place = count
    while place > 0 and memory[event_at(memory, place - 1) + Event.TIME] > time:
        copy(memory, event_at(memory, place), memory, event_at(memory, place - 1), Event.SIZE)
        place -= 1
    at = event_at(memory, place)
    for c in range(Event.SIZE):
        memory[at + c] = events[i, c]
    memory[Head.EVENTS] = count + 1
    repeat(memory, kept_state(memory, k), newest)  # nothing, unless it is late
    if memory[Wrong.SINCE] != 0.0:
        _withdraw(memory, newest)
    return TAKEN


@njit(_nrt=False)
def _withdraw(memory, newest):
    """Return to the state before the fixes that have turned out to be wrong (since Wrong.SINCE), and repeat what
    followed without them.

    Nothing is done where that state is no longer in the memory, nor for a smoother, whose history cannot go back.
    """
    since, memory[Wrong.SINCE] = memory[Wrong.SINCE], 0.0
    k = state_before(memory, since)
    if time_of(memory, k) >= since or not can_return_to(memory, k) or memory[Head.HISTORY_AT] > 0.0:
        return
    for i in range(int(memory[Head.EVENTS])):
        at = event_at(memory, i)
        verdict = memory[at + Event.VERDICT]
        if memory[at + Event.KIND] == Kind.POSITION and memory[at + Event.TIME] >= since and verdict != 0.0:
            memory[at + Event.WITHDRAWN] = 1.0
    repeat(memory, kept_state(memory, k), newest)
