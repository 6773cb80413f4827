"""Two filters in one memory: the first, which is published, and a second, which assumes that the fixes are wrong.

The second filter is stored after the first, has the same size, and receives the same samples and measurements while
`Bank.OPEN` is 1. After each fix the scores of both (log likelihoods, `trust/hypotheses.py`) are compared. The second
filter is dropped when its score is too low, or when both agree. It becomes the first when its score is better and it
uses the fixes, or when the first follows fixes that drift away (`trust/fix_drift.py`).

When the first filter has refused several fixes in a row, these fixes, the earlier ones, or the filter are wrong. The
first filter then assumes that the fixes are wrong, the second starts anew from them, and the scores decide.
"""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.compiled import njit

from .advance import can_return_to, repeat, return_to
from .measurements.geometry import body_to_level
from .memory import (
    HEAD,
    Head,
    Nav,
    Sample,
    copy,
    element_at,
    event_at,
    kept_state,
    oldest_state,
    sample_at,
    state_at,
    state_before,
    time_of,
    velocity_state,
    yaw_state,
)
from .trust import extrapolation, fix_drift, hypotheses, imu_faults, new_start
from .trust.creep import Creep
from .trust.extrapolation import Extrapolation
from .trust.force_noise import learn_from_velocity
from .trust.hypotheses import Hypothesis
from .trust.line import FEWEST_ON_LINE, Line
from .trust.offset import Offset
from .trust.receiver import CLAIM_CHANGE, Receiver, excess_scatter
from .trust.standstill import moves, stands

#: columns of the head of the first filter
Bank = HEAD.place(
    'Bank',
    SIZE=1,  # floats of one filter; 0: there is no room for a second one
    OPEN=1,  # 1: there is a second filter
    COMPARED=1,  # s: time of the latest fix after which both were compared
    WRONG_SINCE=1,  # s: time since which the fixes are wrong, under the hypothesis of the filter that refuses them
    SEARCHED=1,  # 1: earlier values of WRONG_SINCE have been tried (`_search_begin`)
    SCATTER=1)  # realised over claimed variance of the fixes when the second filter began, 1 at least

#: s before the first fix that did not fit: begins of a fault that `_search_begin` tries. Fixes that drift away, and
#: those after an IMU fault, fit at first
EARLIER = (0.0, 2.0, 4.0, 8.0)
#: nats: earlier begins are tried only if the second filter's score is lower by less (a trial takes 1 ms for 8 s at 100
#: Hz), and a second filter that uses no fixes is published only if its score is higher by more. Chosen; a quarter and
#: four times of it move little (docs/ablation.md)
SERIOUS_NATS = 4.0
#: nats per second, log likelihood ratio, at rest to in motion, while a standstill is detected: of the seconds of motion
#: above 1 m/s the detector takes one in 270 for a standstill (docs/standstill.md), one in 20 counts here, as such
#: seconds come together
STANDSTILL_NATS = 3.0
#: both filters agree where the square of each difference of position, velocity and heading is below this share of the
#: smaller variance. Chosen; a quarter and four times of it move little (docs/ablation.md)
AGREED_SHARE = 0.1
#: share of `gnss.recovery_time` that remains for the decay of `_restart_penalty` when a filter starts anew from fixes
#: that have been refused for that long. Chosen; a quarter and four times of it move little (docs/ablation.md)
FITTING_SHARE = 0.5


def copied(memory: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Copy the filter in `memory` to `to`, an array of the same size, and return `to`: an independent filter.

    The part of the second filter is copied only where there is one; a new one begins as a copy of the first.
    """
    end = int(memory[Bank.SIZE]) if memory[Bank.OPEN] == 0.0 else 0
    end = end or len(memory)
    to[:end] = memory[:end]
    return to


@njit(_nrt=False)
def compare(memory):
    """Compare the hypotheses after a fix: begin a second filter if the fix is unlikely, publish it if it is better,
    drop it if it is too unlikely or agrees with the first, and set what the published covariance adds for the
    others."""
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
    elif memory[Bank.SEARCHED] == 0.0 and hypotheses.score(memory, r) - hypotheses.score(other, r) < SERIOUS_NATS:
        memory[Bank.SEARCHED] = 1.0
        _search_begin(memory, other, r, interval)
    if refused:
        _start_from_fixes(memory, other, r, interval)
        if memory[Bank.OPEN] == 0.0:  # the state before the fixes is no longer in the memory: there is no second filter
            return
    _share_scales(memory, other, r)
    if (excess_scatter(memory, r) > CLAIM_CHANGE * memory[Bank.SCATTER]
            or memory[r + Creep.FOUND] == time and memory[r + Hypothesis.FIXES_WRONG] == 0.0):
        # the fixes did not fit because they scatter more than was known, or because the vehicle did not stand: they are
        # not wrong
        memory[r + Hypothesis.FIXES_WRONG] = memory[r + Hypothesis.OFFSET + Offset.VARIANCE] = memory[Bank.OPEN] = 0.0
        _publish_all(memory, other, r)
        return
    _compare_standstills(memory, other, r, interval)
    _start_without_imu(memory, other, r)
    if memory[r + Hypothesis.FIXES_WRONG] != 0.0 and new_start.are_refused(other, r):
        _start_second(memory, other, r, time - memory[Bank.WRONG_SINCE])  # they have changed once more
    if other[r + Hypothesis.FIXES_WRONG] == 0.0 and other[r + Hypothesis.OFFSET + Offset.VARIANCE] != 0.0:
        # it uses fixes again: from now on its score is by them, as that of the first
        other[r + Hypothesis.OFFSET + Offset.VARIANCE] = 0.0
        other[r + Hypothesis.SCORE] = min(other[r + Hypothesis.SCORE], memory[r + Hypothesis.SCORE])
    extrapolated = extrapolation.are_found(memory, r) or extrapolation.are_found(other, r)
    if extrapolated:
        # extrapolated fixes fit a filter that has started anew from them, and cannot be withdrawn from it
        if other[r + Hypothesis.FIXES_WRONG] != 0.0 and memory[Head.FORGOTTEN] > memory[r + Extrapolation.SINCE]:
            _swap(memory, other)
        if memory[r + Hypothesis.FIXES_WRONG] != 0.0:
            other[r + Hypothesis.SCORE] = min(other[r + Hypothesis.SCORE], memory[r + Hypothesis.SCORE])
    elif _is_better(memory, other, r):
        _swap(memory, other)
    fixes_wrong = memory[r + Hypothesis.FIXES_WRONG] != 0.0
    if other[r + Nav.REFUSED] >= FEWEST_ON_LINE:
        other[r + Hypothesis.CONSISTENT] = 0.0
    # a new start must not lose while it may still turn out to be right, without the IMU being wrong, too
    if (fixes_wrong and other[r + Hypothesis.CONSISTENT] != 0.0 and not extrapolated
            and other[r + Nav.USE_ALL_FIXES] <= memory[r + Nav.USE_ALL_FIXES]):
        behind = _restart_penalty(memory, r, time - memory[Bank.WRONG_SINCE])
        other[r + Hypothesis.SCORE] = max(other[r + Hypothesis.SCORE], memory[r + Hypothesis.SCORE] - behind)
    lead = hypotheses.score(memory, r) - hypotheses.score(other, r)
    if not fixes_wrong and lead > hypotheses.LOST_NATS or _agree(memory, other, r):
        memory[Bank.OPEN] = 0.0
    _publish_all(memory, other, r)


@njit(_nrt=False)
def _share_scales(memory, other, r):
    """Let both filters expect the same variance of a fix and of its innovation, so that none gains by a smaller one.

    It is the same receiver: how fixes scatter is what the first filter has learned, what innovations show is what the
    filter has learned that uses the fixes.
    """
    scatter, innovations = r + Receiver.SMOOTH_SCALE, r + Receiver.SLOW_SCALE
    copy(other, scatter, memory, scatter, innovations - scatter)
    size = r + Receiver.STATUS - innovations
    if memory[r + Hypothesis.FIXES_WRONG] == 0.0:
        copy(other, innovations, memory, innovations, size)
    elif other[r + Hypothesis.FIXES_WRONG] == 0.0:
        copy(memory, innovations, other, innovations, size)


@njit(_nrt=False)
def _imu_wrong_score(refusing, r):
    """Nats: score of the hypothesis that the IMU is wrong and the fixes that the filter `refusing` does not use are
    right. Where they are more likely extrapolated than measured, it is lower by the odds."""
    return hypotheses.score(refusing, r) + refusing[r + Hypothesis.IMU_NATS] - extrapolation.odds(refusing, r)


@njit(_nrt=False)
def _publish_all(memory, other, r):
    """Set what the published covariance of the state at r adds for the other hypotheses (`Hypothesis.SPREAD`): that it
    reaches to the other filter, or to where the vehicle is if the IMU is wrong, whichever is further."""
    spread = r + Hypothesis.SPREAD
    for i in range(4):
        memory[spread + i] = 0.0
    memory[r + Hypothesis.SPREAD_VARIANCE] = 0.0
    if memory[Bank.OPEN] == 0.0:
        return
    refusing = memory if memory[r + Hypothesis.FIXES_WRONG] != 0.0 else other
    its = math.exp(min(hypotheses.score(other, r) - hypotheses.score(memory, r), 100.0))
    without_imu = 0.0
    if refusing[r + Hypothesis.FIXES_WRONG] != 0.0:
        without_imu = math.exp(min(_imu_wrong_score(refusing, r) - hypotheses.score(memory, r), 100.0))
    total, at = 1.0 + its + without_imu, r + Hypothesis.IMU_OFFSET
    sigma = math.sqrt(0.5 * (other[element_at(other, r, 0, 0)] + other[element_at(other, r, 1, 1)]))
    _reach_to(memory, other, r, (0.0, 0.0, 0.0, 0.0), its / total, sigma)
    velocity = at + Offset.VELOCITY
    off = refusing[at], refusing[at + 1], refusing[velocity], refusing[velocity + 1]
    _reach_to(memory, refusing, r, off, without_imu / total, math.sqrt(refusing[at + Offset.VARIANCE]))


@njit(_nrt=False)
def _reach_to(memory, other, r, off, share, sigma):
    """Let the published covariance reach to the position of a hypothesis with the probability `share`, if it does not
    reach further. That position is the one of `other` minus `off` (north, east; m and m/s), known to `sigma`, m."""
    spread = r + Hypothesis.SPREAD
    mine, its = hypotheses.position_and_velocity(memory, r), hypotheses.position_and_velocity(other, r)
    north = (its[0] - mine[0]) / memory[r + Nav.NORTH_SCALE] - off[0]
    east = (its[1] - mine[1]) / memory[r + Nav.EAST_SCALE] - off[1]
    distance = math.hypot(north, east)
    memory[r + Hypothesis.SPREAD_VARIANCE] += share * sigma * sigma
    if share == 0.0 or distance == 0.0:
        return
    far = hypotheses.reach(share, distance, sigma)
    if far < math.hypot(memory[spread], memory[spread + 1]):
        return
    times = far / distance
    memory[spread], memory[spread + 1] = times * north, times * east
    times = min(times, 1.0)  # if both positions agree within their sigmas, the other's velocity is sufficient
    memory[spread + 2] = times * (its[2] - mine[2] - off[2])
    memory[spread + 3] = times * (its[3] - mine[3] - off[3])


@njit(_nrt=False)
def _compare_standstills(memory, other, r, interval):
    """Lower the score of a filter that certainly moves while a standstill is detected in the other one, whose state
    permits it. interval: s between the latest two fixes."""
    nats = STANDSTILL_NATS * min(max(interval, 0.0), hypotheses.LONGEST_INTERVAL)
    if stands(memory, r) and moves(other, r):
        hypotheses.add_prior(other, r, -nats)
    elif stands(other, r) and moves(memory, r):
        hypotheses.add_prior(memory, r, -nats)


@njit(_nrt=False)
def _swap(memory, other):
    """Exchange the first and the second filter."""
    for i in range(int(memory[Bank.SIZE])):
        memory[i], other[i] = other[i], memory[i]
    for i in range(Bank.SIZE, Bank.SCATTER + 1):
        memory[i] = other[i]
    r = state_at(memory, int(memory[Head.SAMPLES]))
    memory[r + Hypothesis.CONSISTENT], other[r + Hypothesis.CONSISTENT] = 0.0, 1.0
    other[r + Hypothesis.AGAINST_START] = 0.0


@njit(_nrt=False)
def _start_from_fixes(memory, other, r, interval):
    """After several refused fixes: the first filter assumes from now on that they are wrong, and the second starts anew
    from the latest of them. interval: s between the latest two fixes."""
    begun = memory[r + Nav.REFUSED + Line.SINCE]
    if memory[Bank.OPEN] == 0.0 or hypotheses.score(other, r) < hypotheses.score(memory, r):
        if _refuse_since(memory, other, max(begun, time_of(memory, oldest_state(memory) + 1)), interval) == -math.inf:
            return
    _swap(memory, other)
    begun = max(begun, memory[r + Nav.FIX_TIME] - (1.0 - FITTING_SHARE) * memory[Head.RECOVERY_TIME])
    memory[Bank.OPEN], memory[Bank.WRONG_SINCE], memory[Bank.SEARCHED] = 1.0, begun, 1.0
    memory[r + Hypothesis.AGAINST_START] = 1.0
    memory[Bank.SCATTER] = excess_scatter(memory, r)
    _start_second(memory, other, r, memory[r + Nav.FIX_TIME] - begun)


@njit(_nrt=False)
def _start_second(memory, other, r, since):
    """The second filter starts anew from the latest fix, which the first has taken for wrong for `since` s."""
    k = state_before(other, other[r + Nav.FIX_TIME])
    return_to(other, k)
    _start_anew(other, k, hypotheses.START_ANEW)
    other[r + Hypothesis.SCORE] = memory[r + Hypothesis.SCORE] - _restart_penalty(memory, r, since)


@njit(_nrt=False)
def _restart_penalty(memory, r, since):
    """Largest lead, nats, of the first filter, which has refused the fixes for `since` s, over one that has started
    anew from them.

    It decreases to zero within `gnss.recovery_time`, as a receiver seldom has the same offset for longer. It is zero if
    the first filter does not use the IMU: its position is by earlier fixes, as that of the other is by later ones.
    """
    if imu_faults.is_wrong(memory, r, memory[r + Nav.FIX_TIME]):
        return 0.0
    return hypotheses.RESTART_PENALTY * (1.0 - since / memory[Head.RECOVERY_TIME])


@njit(_nrt=False)
def _start_anew(other, k, due):
    """Let `other`, which has returned to state k, start anew from the first fix after it, and repeat what followed.
    due: value of `Hypothesis.START_DUE`."""
    start, newest = state_at(other, k), int(other[Head.SAMPLES])
    other[start + Hypothesis.START_DUE] = due
    other[Head.FORGOTTEN] = max(other[Head.FORGOTTEN], other[start + Nav.TIME])  # a late fix must not undo the start
    repeat(other, k, newest)
    other[state_at(other, newest) + Hypothesis.START_DUE] = 0.0


@njit(_nrt=False)
def _start_without_imu(memory, other, r):
    """If a wrong IMU is the most likely hypothesis, the first filter starts anew from the latest fix and does not use
    the IMU for some time, and the second assumes that the fixes are wrong."""
    swapped = memory[r + Hypothesis.FIXES_WRONG] == 0.0
    refusing, using = (other, memory) if swapped else (memory, other)
    its, time = _imu_wrong_score(refusing, r), memory[r + Nav.FIX_TIME]
    # if the latest fix fits the filter that uses the fixes, that goes on with the IMU: a time offset may be the cause
    fits = using[r + Hypothesis.OUTLIER_NATS] < 0.0
    if (refusing[r + Hypothesis.FIXES_WRONG] == 0.0 or its < hypotheses.score(refusing, r) or fits
            or its < hypotheses.score(using, r)
            or imu_faults.is_wrong(using, r, time)):
        return
    k = state_before(refusing, time)
    before = time_of(refusing, k)
    if before >= time or not can_return_to(refusing, k):
        return
    if swapped:
        _swap(memory, other)
    _copy(memory, other, state_before(memory, before - memory[Head.MAX_DELAY]))
    return_to(other, k)
    start = state_at(other, k)
    offset = Hypothesis.IMU_OFFSET  # with what the latest fix has told
    copy(other, start + offset, memory, r + offset, Offset.SIZE)
    other[start + Hypothesis.FIXES_WRONG] = 0.0
    velocity = r + offset + Offset.VELOCITY
    squared = 0.5 * (memory[velocity] ** 2 + memory[velocity + 1] ** 2)
    learn_from_velocity(other, start, time, squared, time - memory[Bank.WRONG_SINCE])
    _start_anew(other, k, hypotheses.START_WITHOUT_IMU)
    other[r + Hypothesis.SCORE] += its - hypotheses.score(other, r)
    _swap(memory, other)
    memory[Bank.SEARCHED] = 1.0


@njit(_nrt=False)
def _is_better(memory, other, r):
    """Whether the second filter is to be published.

    A second filter that uses no fixes is published only if the first one follows fixes that drift away, and that slowly
    enough for a receiver. Fixes with a constant error are followed: it bounds the error of the filter.
    """
    its, mine = hypotheses.score(other, r), hypotheses.score(memory, r)
    if other[r + Hypothesis.FIXES_WRONG] == 0.0:
        if memory[r + Hypothesis.FIXES_WRONG] != 0.0:
            its = np.logaddexp(its, _imu_wrong_score(memory, r))  # the fixes are right in both
        return its > mine
    return (its - mine > SERIOUS_NATS and its > _imu_wrong_score(other, r)
            and hypotheses.strayed_nats(other, r) < -SERIOUS_NATS
            and memory[r + Hypothesis.FIXES_WRONG] == 0.0
            and memory[r + Nav.USE_ALL_FIXES] == 0.0 and fix_drift.are_followed(memory, r)
            and hypotheses.is_drifting(other, r))


@njit(_nrt=False)
def _begin(memory, other, r, interval):
    """Begin a second filter that assumes that the latest fix is wrong, unless that is too unlikely. interval: s between
    the latest two fixes."""
    if interval <= 0.0:  # fixes have been withdrawn, and this one has been compared before
        return
    time, score = memory[r + Nav.FIX_TIME], hypotheses.score(memory, r)
    prior = math.log(hypotheses.FAULT_RATE * min(interval, hypotheses.LONGEST_INTERVAL))
    if memory[r + Hypothesis.OUTLIER_NATS] + prior < -hypotheses.LOST_NATS:
        return
    if _refuse_since(memory, other, time, interval) > score - hypotheses.LOST_NATS:
        memory[Bank.OPEN], memory[Bank.WRONG_SINCE], memory[Bank.SEARCHED] = 1.0, time, 0.0
        memory[Bank.SCATTER] = excess_scatter(memory, r)


@njit(_nrt=False)
def _search_begin(memory, other, r, interval):
    """Let `other` refuse the fixes from an earlier time on, if its hypotheses are more likely then.

    Faults of receiver and IMU begin independently, so each hypothesis keeps the score of its best begin.
    """
    latest, since = memory[Bank.WRONG_SINCE], 0.0
    fixes_wrong = imu_wrong = best = tried = -math.inf
    for back in EARLIER:
        score = _refuse_since(memory, other, latest - back, interval)
        if score == -math.inf:
            break
        tried = back
        its = _imu_wrong_score(other, r)
        fixes_wrong, imu_wrong = max(fixes_wrong, score), max(imu_wrong, its)
        either = np.logaddexp(score, its)
        if either > best:
            best, since = either, back
    if tried == -math.inf:
        return
    if since != tried:
        _refuse_since(memory, other, latest - since, interval)
    other[r + Hypothesis.SCORE] += fixes_wrong - hypotheses.score(other, r)
    other[r + Hypothesis.IMU_NATS] = imu_wrong + extrapolation.odds(other, r) - fixes_wrong
    memory[Bank.WRONG_SINCE] = latest - since


@njit(_nrt=False)
def _copy(memory, other, first):
    """Copy `memory` to `other`, without states before number `first`, to which `other` will not return."""
    copy(other, 0, memory, 0, int(memory[Head.ROWS_AT]))
    first = kept_state(memory, first)
    for k in range(first, int(memory[Head.SAMPLES]) + 1):
        row, sample = state_at(memory, k), sample_at(memory, k)
        if kept_state(memory, k) == k:
            copy(other, row, memory, row, int(memory[Head.WIDTH]))
        copy(other, sample, memory, sample, Sample.SIZE)
    events, scratch = int(memory[Head.EVENTS_AT]), int(memory[Head.SCRATCH_AT])
    copy(other, events, memory, events, event_at(memory, int(memory[Head.EVENTS])) - events)
    copy(other, scratch, memory, scratch, int(memory[Bank.SIZE]) - scratch)
    other[Head.FORGOTTEN] = max(memory[Head.FORGOTTEN], time_of(memory, first))


@njit(_nrt=False)
def _refuse_since(memory, other, since, interval):
    """Make `other` the filter that `memory` would be if it had used no fix since `since`, s. Returns its score, or -inf
    if the state of that time is no longer in the memory."""
    newest, k = int(memory[Head.SAMPLES]), state_before(memory, since)
    time = time_of(memory, k)
    if time >= since or not can_return_to(memory, k):
        return -math.inf
    _copy(memory, other, state_before(memory, time - memory[Head.MAX_DELAY]))
    return_to(other, k)
    hypotheses.begin_refusing(other, state_at(memory, k), interval)
    repeat(other, k, newest)
    return hypotheses.score(other, state_at(memory, newest))


@njit(_nrt=False)
def _agree(memory, other, r):
    """Whether both filters use the fixes, or both refuse them, and position, velocity and heading agree (AGREED_SHARE).
    """
    if memory[r + Hypothesis.FIXES_WRONG] != other[r + Hypothesis.FIXES_WRONG]:
        return False
    mine, its = hypotheses.position_and_velocity(memory, r), hypotheses.position_and_velocity(other, r)
    v, yaw = velocity_state(memory), yaw_state(memory)
    a, b = body_to_level(memory, r), body_to_level(other, r)
    turn = math.atan2(a[3] * b[0] - a[0] * b[3], a[0] * b[0] + a[3] * b[3])
    differences = ((its[0] - mine[0]) / memory[r + Nav.NORTH_SCALE], (its[1] - mine[1]) / memory[r + Nav.EAST_SCALE],
                   its[2] - mine[2], its[3] - mine[3], turn)
    states = (0, 1, v, v + 1, yaw)
    for i in range(5):
        at = element_at(memory, r, states[i], states[i])
        if differences[i] ** 2 > AGREED_SHARE * min(memory[at], other[at]):
            return False
    return True
