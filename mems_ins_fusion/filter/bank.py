"""Two filters side by side in one memory: the one that is published, and one that takes the fixes for wrong.

The second stands behind the first, as large, while `Bank.OPEN`, and gets the same samples and measurements. After each
fix their scores are compared (`trust/hypotheses.py`). The second goes where it has lost, or where both agree. It
becomes the first where its score is better and it uses the fixes, or the fixes drift away (`trust/fix_drift.py`).

Where the first has refused several fixes in a row, either these fixes are wrong or those before them were, or the
filter is: the first then takes the fixes for wrong, the second starts anew from them, and the better score decides.
"""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.compiled import njit

from .advance import advance
from .measurements.geometry import body_to_level
from .memory import (
    HEAD,
    NAV,
    Head,
    Nav,
    Sample,
    event_at,
    packed,
    sample_at,
    state_at,
    velocity_state,
    yaw_state,
)
from .trust import fix_drift, hypotheses, new_start
from .trust.hypotheses import Hypothesis

#: in the head of the first
Bank = HEAD.place(
    'Bank',
    SIZE=1,  # floats of one filter; 0: there is no room for a second
    OPEN=1,  # 1: there is one
    COMPARED=1,  # s: time of the last fix after which both were compared,
    BEGUN=1,  # from which on the second takes them for wrong,
    DATED=1)  # 1: whether that was earlier has been looked for

#: s before the fix that did not fit: since when fixes may have been wrong that drift away
BACK = (2.0, 4.0, 8.0)
#: nats by which the second is better before it becomes the first, as what is published jumps then
BETTER = 2.0
#: nats: a second that is behind by no more is worth the search since when (each 1 ms for 8 s at 100 Hz)
SERIOUS = 4.0
#: share of the variance of position, velocity and heading below which a squared difference is none
SAME = 0.1
#: share of `gnss.recovery_time` for which a filter that starts anew late has to fit before that time counts for it
FITTED = 0.5


def copied(memory: np.ndarray, to: np.ndarray) -> np.ndarray:
    """`to`, as large as `memory`, as an independent filter in the same state: without the second where there is none,
    which begins with a copy of the first."""
    end = int(memory[Bank.SIZE]) if memory[Bank.OPEN] == 0.0 else 0
    end = end or len(memory)
    to[:end] = memory[:end]
    return to


@njit(_nrt=False)
def compare(memory):
    """After each fix, once: begin a second filter where there is reason to, make it the first where it is better, end
    it where it has lost or is the same, and note how far apart both are."""
    size, r = int(memory[Bank.SIZE]), state_at(memory, int(memory[Head.SAMPLES]))
    time = memory[r + Nav.FIX_TIME]
    if size == 0 or time == memory[Bank.COMPARED]:
        return
    interval, memory[Bank.COMPARED] = time - memory[Bank.COMPARED], time
    other, refused = memory[size:], new_start.are_refused(memory, r)
    if memory[Bank.OPEN] == 0.0:
        _begin(memory, other, r, interval)
        if memory[Bank.OPEN] == 0.0 and not refused:
            return
    elif memory[Bank.DATED] == 0.0 and hypotheses.score(memory, r) - hypotheses.score(other, r) < SERIOUS:
        memory[Bank.DATED] = 1.0
        _date(memory, other, r, interval)
    if refused:
        _start_from_fixes(memory, other, r, interval)
        if memory[Bank.OPEN] == 0.0:  # what was before the fixes is not remembered: there is no second filter
            return
    if _is_better(memory, other, r):
        _swap(memory, other)
    doubts = memory[r + Hypothesis.DOUBTS] != 0.0
    if other[r + Nav.REFUSED] >= new_start.FEWEST_REFUSED:
        other[r + Hypothesis.FITS] = 0.0
    if doubts and other[r + Hypothesis.FITS] != 0.0:  # it has to be near enough when the fixes are right
        least = memory[r + Hypothesis.SCORE] - hypotheses.most_behind(memory, time - memory[Bank.BEGUN])
        other[r + Hypothesis.SCORE] = max(other[r + Hypothesis.SCORE], least)
    lead = hypotheses.score(memory, r) - hypotheses.score(other, r)
    share = 1.0 / (1.0 + math.exp(min(lead, 100.0)))
    if not doubts and lead > hypotheses.LOST or _same(memory, other, r):
        memory[Bank.OPEN] = share = 0.0
    mine, its = hypotheses.position_and_velocity(memory, r), hypotheses.position_and_velocity(other, r)
    north, east = (its[0] - mine[0]) / memory[r + Nav.NORTH_SCALE], (its[1] - mine[1]) / memory[r + Nav.EAST_SCALE]
    sigma, spread = hypotheses.reach(share, math.hypot(north, east)), r + Hypothesis.SPREAD
    memory[spread], memory[spread + 1] = sigma * north, sigma * east
    memory[spread + 2], memory[spread + 3] = sigma * (its[2] - mine[2]), sigma * (its[3] - mine[3])


@njit(_nrt=False)
def _swap(memory, other):
    """The second filter is the first from now on, and the first the second."""
    for i in range(int(memory[Bank.SIZE])):
        memory[i], other[i] = other[i], memory[i]
    for i in range(Bank.SIZE, Bank.DATED + 1):
        memory[i] = other[i]
    r = state_at(memory, int(memory[Head.SAMPLES]))
    memory[r + Hypothesis.FITS], other[r + Hypothesis.FITS] = 0.0, 1.0


@njit(_nrt=False)
def _start_from_fixes(memory, other, r, interval):
    """The first filter, which has refused fixes in a row, takes them for wrong from now on; the second starts anew from
    the latest of them. interval: s, since the fix before it."""
    begun = memory[r + Nav.REFUSED_SINCE]
    if memory[Bank.OPEN] == 0.0 or hypotheses.score(other, r) < hypotheses.score(memory, r):
        oldest = max(1, int(memory[Head.SAMPLES]) - int(memory[Head.CAPACITY]) + 2)
        if _doubt(memory, other, max(begun, memory[state_at(memory, oldest) + Nav.TIME]), interval) == -math.inf:
            return
    _swap(memory, other)
    begun = max(begun, memory[r + Nav.FIX_TIME] - (1.0 - FITTED) * memory[Head.RECOVERY_TIME])
    memory[Bank.OPEN], memory[Bank.BEGUN], memory[Bank.DATED] = 1.0, begun, 1.0
    newest, k = int(other[Head.SAMPLES]), _before(other, other[r + Nav.FIX_TIME])
    start = state_at(other, k)
    other[start + Hypothesis.STARTS] = 1.0
    other[Head.FORGOTTEN] = max(other[Head.FORGOTTEN], other[start + Nav.TIME])  # a late fix must not undo the start
    for j in range(k + 1, newest + 1):
        advance(other, j)
    other[r + Hypothesis.STARTS], other[r + Hypothesis.FITS] = 0.0, 1.0
    behind = hypotheses.most_behind(memory, memory[r + Nav.FIX_TIME] - begun)
    other[r + Hypothesis.SCORE] = memory[r + Hypothesis.SCORE] - behind


@njit(_nrt=False)
def _is_better(memory, other, r):
    """Whether the second is to be the first: one that uses no fixes only where the first follows fixes that drift away.
    Who follows a receiver that is off by a constant is off by no more than that."""
    ahead = hypotheses.score(other, r) - hypotheses.score(memory, r)
    if other[r + Hypothesis.DOUBTS] == 0.0:
        return ahead > (BETTER if memory[r + Hypothesis.DOUBTS] == 0.0 else 0.0)
    return (ahead > SERIOUS and memory[r + Hypothesis.DOUBTS] == 0.0 and memory[r + Nav.UNSETTLED] == 0.0
            and fix_drift.are_followed(memory, r)
            and hypotheses.is_drifting(other, r))


@njit(_nrt=False)
def _begin(memory, other, r, interval):
    """Begin a second filter that takes the latest fix for wrong, where that is not too unlikely. interval: s, since the
    fix before it."""
    if interval <= 0.0:  # fixes have been withdrawn, and those before them been compared already
        return
    time, score = memory[r + Nav.FIX_TIME], hypotheses.score(memory, r)
    prior = math.log(hypotheses.FIXES_WRONG * min(interval, hypotheses.LONGEST))
    if memory[r + Hypothesis.OTHERWISE] + prior < -hypotheses.LOST:
        return
    if _doubt(memory, other, time, interval) > score - hypotheses.LOST:
        memory[Bank.OPEN], memory[Bank.BEGUN], memory[Bank.DATED] = 1.0, time, 0.0


@njit(_nrt=False)
def _date(memory, other, r, interval):
    """Let the doubts of `other` have begun earlier, where that has a better score."""
    best, latest, since = hypotheses.score(other, r), memory[Bank.BEGUN], 0.0
    for back in BACK:
        score = _doubt(memory, other, latest - back, interval)
        if score > best:
            best, since = score, back
    if since != BACK[-1]:
        _doubt(memory, other, latest - since, interval)
    memory[Bank.BEGUN] = latest - since


@njit(_nrt=False)
def _copy(memory, other, first):
    """`other` as `memory`, but for the states before `first`, which it does not go back to."""
    for i in range(int(memory[Head.ROWS_AT])):
        other[i] = memory[i]
    for k in range(first, int(memory[Head.SAMPLES]) + 1):
        row, sample = state_at(memory, k), sample_at(memory, k)
        for i in range(row, row + int(memory[Head.WIDTH])):
            other[i] = memory[i]
        for i in range(sample, sample + Sample.SIZE):
            other[i] = memory[i]
    for i in range(int(memory[Head.EVENTS_AT]), event_at(memory, int(memory[Head.EVENTS]))):
        other[i] = memory[i]
    for i in range(int(memory[Head.SCRATCH_AT]), int(memory[Bank.SIZE])):
        other[i] = memory[i]
    other[Head.FORGOTTEN] = max(memory[Head.FORGOTTEN], memory[state_at(memory, first) + Nav.TIME])


@njit(_nrt=False)
def _before(memory, time):
    """Number of the state before `time`, s, or of the oldest that is remembered."""
    k = int(memory[Head.SAMPLES])
    oldest = max(0, k - int(memory[Head.CAPACITY]) + 1)
    while k > oldest and memory[state_at(memory, k) + Nav.TIME] >= time:
        k -= 1
    return k


@njit(_nrt=False)
def _doubt(memory, other, since, interval):
    """`other` as the filter in `memory`, had it used none of the fixes since then, s. Its score."""
    newest, k = int(memory[Head.SAMPLES]), _before(memory, since)
    time = memory[state_at(memory, k) + Nav.TIME]
    if time >= since or time < memory[Head.FORGOTTEN]:
        return -math.inf
    _copy(memory, other, _before(memory, time - memory[Head.MAX_DELAY]))
    hypotheses.doubt(other, state_at(memory, k), interval)
    for j in range(k + 1, newest + 1):
        advance(other, j)
    return hypotheses.score(other, state_at(memory, newest))


@njit(_nrt=False)
def _same(memory, other, r):
    """Whether both say the same of the fixes, and of position, velocity and heading."""
    if memory[r + Hypothesis.DOUBTS] != other[r + Hypothesis.DOUBTS]:
        return False
    n_navigation = int(memory[Head.N_NAVIGATION])
    mine, its = hypotheses.position_and_velocity(memory, r), hypotheses.position_and_velocity(other, r)
    p, v, yaw = r + NAV + n_navigation + int(memory[Head.N_AUGMENTED]), velocity_state(memory), yaw_state(memory)
    a, b = body_to_level(memory, r), body_to_level(other, r)
    turn = math.atan2(a[3] * b[0] - a[0] * b[3], a[0] * b[0] + a[3] * b[3])
    differences = ((its[0] - mine[0]) / memory[r + Nav.NORTH_SCALE], (its[1] - mine[1]) / memory[r + Nav.EAST_SCALE],
                   its[2] - mine[2], its[3] - mine[3], turn)
    states = (0, 1, v, v + 1, yaw)
    for i in range(5):
        at = p + packed(states[i], states[i], n_navigation)
        if differences[i] ** 2 > SAME * min(memory[at], other[at]):
            return False
    return True
