"""Several IMUs made one stream of samples, before the filter: live, one message at a time, and of a recording.

One of them leads: the first in the order of preference (`imu_topic`, then those of `inputs`) of which samples come that
can be believed. The filter is fed at its stamps. Where others agree with it, half of the difference (of two that are
equally noisy) is added, taken where both are known: at the stamp of the other, between two samples of the leading one.
So what they measure alike is not late. Their constant differences are taken out: to the filter the biases are those of
the first one whoever leads, and a change is no jump.

Whom to believe: a sample that `imu_faults` finds fault with is not used while another IMU is there; one that has been
silent for SILENT is replaced by the next, whose samples since then are kept for that. Two that differ beyond chance are
not averaged, and the leading one is believed, as without the other; a standstill tells which of them has changed.
"""
from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ...effects.accelerometer_lever_arm import AccelerometerLeverArm
from ...navigation.frames import mounting
from ...samples import NO_SAMPLES, ImuSamples, Recording
from ..columns import numbered
from ..measurements.inertial import InertialSettings
from ..measurements.registry import imus
from ..memory import HEAD, Head, Sample
from ..trust.imu_faults import FAULTS, Fault, Imu, check
from ..trust.standstill import is_still
from .intake import Notice
from .tally import Tally

#: s without a sample, and three intervals, after which the next IMU leads: more than drivers, buses and queues delay
#: one topic against another, and less than imu.max_gap. A sample that comes later is not used
SILENT = 0.2
SILENT_INTERVALS = 3.0
#: s that the others wait for the first sample of the first IMU: drivers start one after the other
FIRST = 5.0
#: samples of each that are kept: SILENT of an IMU of 2 kHz, and more
KEPT = 256
#: s for which two have to be compared before their constant difference is known: of consumer-grade gyroscopes in a car
#: to 6e-4 rad/s, a tenth of a turn-on bias
JOIN = 20.0
#: standard deviations of that mean by which an IMU that was away has other biases than before
CHANGED_SIGMAS = 4.0
#: s: time constant with which that difference is learned further: slower than manoeuvres, faster than a warm-up
LEARN = 60.0
#: s: time constant of the mean difference that is judged: longer than vibration, shorter than what a heading bears
QUICK = 0.25
#: standard deviations of it that are chance: six components, some 20 000 independent ones an hour, and tails
SIGMAS = 8.0
#: share of a motion by which two IMUs may differ: scale errors of 1 to 2 %, an axis off by 2 deg
SHARE = 0.05
#: m by which the arm between them may be wrong, or unknown
ARM = 0.3
#: s for which those that differed have to agree again, within half of the limit
AGREE = 2.0
#: s: a difference that lasts for longer is taken for their constant one: by then the filter knows the leading one's
#: bias. The preferred one leads again when it has been compared for as long: then its difference is known well
ADOPT = 60.0
#: s: time constant of the noise that is judged by, and of that which weighs
NOISE_NOW, NOISE = 1.0, 60.0
#: s: what is shown at rest is a mean over this
REST = 5.0
#: m/s: a speed at which `imu_faults` finds an axis that stays as it is: beside another IMU it may do so at rest, too
_MOVING = 2.0
#: a sample that is no number
_NOT_FINITE = Fault.SIZE
_REASONS = (*FAULTS, 'not a number')

column = numbered()


class _Own(NamedTuple):
    """Of one IMU, floats. Components: specific force, then angular rate, sensor axes of the first one."""

    OFFSET: int = column(6)  # what is to be subtracted
    JOINED: int = column()  # 1: that is known
    COMMON: int = column()  # s for which it has been compared with the leading one
    COUNT: int = column()  # of differences while it joins, their mean, and the variance of QUICK's about it
    MEAN: int = column(6)
    AROUND: int = column(6)
    MOTION: int = column(2)  # mean of what motion makes of a difference, meanwhile
    LATELY: int = column(6)  # mean difference over QUICK
    VARIANCE: int = column(6)  # usual mean square of that
    APART: int = column()  # s for which it has differed, 0: it agrees
    AGREED: int = column()  # s for which it has agreed since
    HELD: int = column(6)  # sum of the differences since the last sample handed on, and how many
    HELD_COUNT: int = column()
    ADDED: int = column(6)  # the last mean of them
    INTERVAL: int = column()  # s between samples
    NOW: int = column(2)  # noise density squared, of f and of w, as shown of late
    NOISE: int = column(2)  # and in the mean
    QUICK: int = column(6)  # mean over QUICK of its samples
    SLOW: int = column(3)  # of the specific force over LEARN
    STILL: int = column()  # 1 at rest
    RESTED: int = column()  # 1: the next ones are known
    REST: int = column(4)  # angular rate at rest, and the size of the specific force
    SIZE: int = column(0)


class _Whole(NamedTuple):
    """Of one IMU, integers. Stamps are ns, -1: none."""

    NEWEST: int = 0  # stamp of its newest sample
    KEPT: int = 1  # samples believed, the last ones of which are kept
    COMPARED: int = 2  # how many of them have been
    COMPARED_AT: int = 3  # stamp of the last one
    MARK: int = 4  # its newest stamp when the leading one last came
    SEEN: int = 5  # newest stamp of the leading one when it last came
    FAULT: int = 6  # of its newest sample
    SIZE: int = 7


class _Shared(NamedTuple):
    """Integers of all together."""

    LEADER: int = 0
    LAST: int = 1  # stamp of the newest sample handed on, -1: none
    EPOCH: int = 2  # stamp that times are counted from
    SAID: int = 3  # how many rows of `said` are new
    RESTART_GAP: int = 4  # ns
    MAX_GAP: int = 5  # ns
    CHANGED: int = 6  # 1: a standstill shows that the leading one has changed
    SIZE: int = 7


_OWN, _WHOLE, _SHARED = _Own(), _Whole(), _Shared()
#: what is said: a code, the IMU it is of, the one that leads, three numbers. ALONE: s of silence, fault. CHANGED:
#: component, value. APART: component, value, limit
_ALONE, _LEADS, _JOINED, _CHANGED, _APART, _TOGETHER, _OFF = range(1, 8)
_SAID_AT_ONCE = 8


class _Book(NamedTuple):
    """All that is remembered. own (n, Own.SIZE); whole (n, Whole.SIZE) and shared: integers; stamps (n, KEPT) ns and
    values (n, KEPT, 6) of the samples kept; heads (n, ...): of each, what `imu_faults` and `standstill` remember;
    sample (1, 7): the one judged; said (_SAID_AT_ONCE, 6)."""

    own: np.ndarray
    whole: np.ndarray
    shared: np.ndarray
    stamps: np.ndarray
    values: np.ndarray
    heads: np.ndarray
    sample: np.ndarray
    said: np.ndarray


@njit
def _take(book, i, stamp, value, out_stamps, out):
    """Sample `value` (6,) of IMU i, stamped `stamp` ns; how many samples to hand on are in out_stamps and out."""
    whole, shared = book.whole, book.shared
    leads, newest = shared[_SHARED.LEADER] == i, whole[i, _WHOLE.NEWEST]
    step = stamp - newest
    if newest != -1 and (step <= 0 or step > shared[_SHARED.RESTART_GAP]):  # the filter's intake knows what to do
        jumped = abs(step) > shared[_SHARED.MAX_GAP]
        if jumped:
            whole[i, _WHOLE.NEWEST], whole[i, _WHOLE.COMPARED_AT] = stamp, -1
            whole[i, _WHOLE.COMPARED] = whole[i, _WHOLE.KEPT] = 0
        if not leads:
            book.own[i, _OWN.COMMON] = 0.0 if jumped else book.own[i, _OWN.COMMON]
            return 0
        if jumped:
            shared[_SHARED.LAST] = stamp
        return _hand_on(book, i, stamp, value, 0, out_stamps, out)
    dt = 0.0 if newest == -1 else step * 1e-9
    if shared[_SHARED.EPOCH] == -1:
        shared[_SHARED.EPOCH] = stamp
    whole[i, _WHOLE.NEWEST] = stamp
    if step > shared[_SHARED.MAX_GAP] and newest != -1 and not leads:  # it may have been switched off and on
        book.own[i, _OWN.COMMON] = 0.0
    fault = _judge(book, i, stamp, value, dt)
    whole[i, _WHOLE.FAULT] = fault
    if fault == Fault.NONE:
        _keep(book, i, stamp, value, dt)
    return _led(book, i, stamp, value, fault, out_stamps, out) if leads else _followed(book, i, stamp, fault,
                                                                                      out_stamps, out)


@njit
def _judge(book, i, stamp, value, dt):
    """What is wrong with a sample, a `Fault` or _NOT_FINITE."""
    total = 0.0
    for k in range(6):
        total += value[k]
        book.sample[0, 1 + k] = value[k]
    if not np.isfinite(total):
        return _NOT_FINITE
    book.sample[0, 0] = (stamp - book.shared[_SHARED.EPOCH]) * 1e-9
    head = book.heads[i]
    for k in range(6):
        head[Head.SIZE + Sample.F_X + k] = value[k]
    book.own[i, _OWN.STILL] = is_still(head, Head.SIZE, dt, False, dt * 1e9 > book.shared[_SHARED.MAX_GAP])
    return check(head, book.sample, 0, dt, _MOVING, False)


@njit
def _keep(book, i, stamp, value, dt):
    """A sample that is believed: among those kept, and in what is known of their interval and noise."""
    own, before = book.own[i], (book.whole[i, _WHOLE.KEPT] - 1) % KEPT
    first = book.whole[i, _WHOLE.KEPT] == 0
    if not first and 0.0 < dt * 1e9 < book.shared[_SHARED.MAX_GAP]:
        own[_OWN.INTERVAL] += (0.1 if own[_OWN.INTERVAL] > 0.0 else 1.0) * (dt - own[_OWN.INTERVAL])
        for half in range(2):
            density = 0.0
            for k in range(3 * half, 3 * half + 3):
                density += (value[k] - book.values[i, before, k]) ** 2 / 6.0 * dt
            for at, time in ((_OWN.NOW, NOISE_NOW), (_OWN.NOISE, NOISE)):
                share = 1.0 if own[at + half] == 0.0 else min(1.0, dt / time)
                own[at + half] += share * (density - own[at + half])
    for k in range(6):
        own[_OWN.QUICK + k] += (1.0 if first else min(1.0, dt / QUICK)) * (value[k] - own[_OWN.QUICK + k])
    for k in range(3):
        own[_OWN.SLOW + k] += (1.0 if first else min(1.0, dt / LEARN)) * (value[k] - own[_OWN.SLOW + k])
    at = book.whole[i, _WHOLE.KEPT] % KEPT
    book.stamps[i, at] = stamp
    book.values[i, at] = value
    book.whole[i, _WHOLE.KEPT] += 1


@njit
def _patience(book, i):
    """s without a sample of IMU i that are no silence."""
    return max(SILENT, SILENT_INTERVALS * book.own[i, _OWN.INTERVAL])


@njit
def _led(book, i, stamp, value, fault, out_stamps, out):
    """A sample of the leading IMU."""
    whole, shared = book.whole, book.shared
    if fault != Fault.NONE:  # the filter bridges what it does not believe; another IMU is better
        for j in range(len(whole)):
            if j != i and book.own[j, _OWN.JOINED] > 0.0 and whole[j, _WHOLE.SEEN] != -1 and (
                    stamp - whole[j, _WHOLE.SEEN]) * 1e-9 <= _patience(book, j) + _patience(book, i):
                return 0
        shared[_SHARED.LAST] = stamp
        return _hand_on(book, i, stamp, value, 0, out_stamps, out)
    for j in range(len(whole)):
        if j != i:
            whole[j, _WHOLE.MARK] = whole[j, _WHOLE.NEWEST]
            _compare(book, j, i)
    shared[_SHARED.LAST] = stamp
    _hand_on(book, i, stamp, value, 0, out_stamps, out)
    _add_others(book, i, stamp, out)
    return 1


@njit
def _hand_on(book, i, stamp, value, row, out_stamps, out):
    """Sample `value` of IMU i as row number `row` of out, with the biases of the first IMU; how many rows there are."""
    out_stamps[row] = stamp
    for k in range(6):
        out[row, k] = value[k] - book.own[i, _OWN.OFFSET + k]
    return row + 1


@njit
def _add_others(book, i, stamp, out):
    """The mean difference of those that agree with the leading IMU i, weighed by their noise, in row 0 of out."""
    own, used = book.own, 1
    for j in range(len(own)):
        used += 1 if j != i and _agrees(book, j, stamp) else 0
    for half in range(2):
        inverse = 0.0
        for j in range(len(own)):
            if j == i or _agrees(book, j, stamp):
                inverse += _certainty(own[j], half)
        for j in range(len(own)):
            if j == i or not _agrees(book, j, stamp):
                continue
            # one that filters before it samples shows less noise than it has
            weight = min(_certainty(own[j], half) / inverse, 1.0 / used)
            for k in range(3 * half, 3 * half + 3):
                if own[j, _OWN.HELD_COUNT] > 0.0:
                    own[j, _OWN.ADDED + k] = own[j, _OWN.HELD + k] / own[j, _OWN.HELD_COUNT]
                    own[j, _OWN.HELD + k] = 0.0
                out[0, k] += weight * own[j, _OWN.ADDED + k]
    for j in range(len(own)):
        own[j, _OWN.HELD_COUNT] = 0.0


@njit
def _certainty(own, half):
    """One over the noise of specific force (half 0) or angular rate (1), which may have grown just now."""
    return 1.0 / max(own[_OWN.NOISE + half], own[_OWN.NOW + half], 1e-18)


@njit
def _agrees(book, j, stamp):
    """Whether IMU j is there, is known and does not differ."""
    own, at = book.own[j], book.whole[j, _WHOLE.COMPARED_AT]
    return (own[_OWN.JOINED] > 0.0 and own[_OWN.COMMON] >= JOIN and own[_OWN.APART] == 0.0 and at != -1
            and (stamp - at) * 1e-9 <= _patience(book, j))


@njit
def _followed(book, i, stamp, fault, out_stamps, out):
    """A sample of another IMU than the leading one: it may have to lead from now on."""
    whole, shared, own = book.whole, book.shared, book.own[i]
    leader = shared[_SHARED.LEADER]
    if fault != Fault.NONE:
        return 0
    whole[i, _WHOLE.SEEN] = whole[leader, _WHOLE.NEWEST]
    if whole[i, _WHOLE.MARK] == -1:
        whole[i, _WHOLE.MARK] = stamp
    _compare(book, i, leader)
    never = whole[leader, _WHOLE.NEWEST] == -1
    silent = (stamp - whole[i, _WHOLE.MARK]) * 1e-9
    if not never:  # what comes in a burst has waited itself
        silent = min(silent, (stamp - book.stamps[leader, (whole[leader, _WHOLE.KEPT] - 1) % KEPT]) * 1e-9)
    last = shared[_SHARED.LAST]
    follows = last == -1 or 0 < stamp - last <= shared[_SHARED.RESTART_GAP]
    if silent > (FIRST if never else _patience(book, leader)) and (own[_OWN.JOINED] > 0.0 or never) and follows:
        _say(book, _ALONE, i, leader, silent, whole[leader, _WHOLE.FAULT], 0.0)
        _lead(book, i, leader, False)
    elif own[_OWN.APART] > 0.0 and shared[_SHARED.CHANGED] > 0 and follows:
        _say(book, _OFF, i, leader, 0.0, 0.0, 0.0)
        _lead(book, i, leader, True)
        book.own[leader, _OWN.APART] = 1e-3  # it has to agree again
    elif i < leader and own[_OWN.JOINED] > 0.0 and own[_OWN.COMMON] >= ADOPT and own[_OWN.APART] == 0.0:
        _say(book, _LEADS, i, leader, 0.0, 0.0, 0.0)
        _lead(book, i, leader, True)
    else:
        shared[_SHARED.CHANGED] = 0
        return 0
    count = 0
    for c in range(max(whole[i, _WHOLE.KEPT] - KEPT, 0), whole[i, _WHOLE.KEPT]):
        at = c % KEPT
        if book.stamps[i, at] > last:
            count = _hand_on(book, i, book.stamps[i, at], book.values[i, at], count, out_stamps, out)
    if count > 0:
        shared[_SHARED.LAST] = out_stamps[count - 1]
    return count


@njit
def _lead(book, i, before, compared):
    """IMU i leads from now on, instead of the one `before`, which is compared by now or not."""
    own, whole, shared = book.own, book.whole, book.shared
    shared[_SHARED.LEADER], shared[_SHARED.CHANGED] = i, 0
    own[i, _OWN.APART], own[i, _OWN.JOINED] = 0.0, 1.0
    own[before, _OWN.COMMON], own[before, _OWN.APART] = JOIN if compared else 0.0, 0.0
    for k in range(6):
        own[before, _OWN.VARIANCE + k] = own[i, _OWN.VARIANCE + k]
    own[before, _OWN.JOINED] = 1.0 if whole[before, _WHOLE.NEWEST] != -1 else 0.0
    for j in range(len(own)):
        whole[j, _WHOLE.MARK], whole[j, _WHOLE.SEEN] = whole[j, _WHOLE.NEWEST], whole[i, _WHOLE.NEWEST]
        whole[j, _WHOLE.COMPARED] = whole[j, _WHOLE.KEPT]
        own[j, _OWN.COUNT] = own[j, _OWN.HELD_COUNT] = own[j, _OWN.AGREED] = 0.0
        for k in range(6):
            own[j, _OWN.LATELY + k] = own[j, _OWN.HELD + k] = own[j, _OWN.ADDED + k] = 0.0


@njit
def _compare(book, j, leader):
    """Those samples of IMU j that lie between two of the leading one, with it."""
    whole, kept = book.whole, book.whole[leader, _WHOLE.KEPT]
    oldest = max(kept - KEPT, 0)
    if kept == 0:
        return
    while whole[j, _WHOLE.COMPARED] < whole[j, _WHOLE.KEPT]:
        c = max(whole[j, _WHOLE.COMPARED], whole[j, _WHOLE.KEPT] - KEPT)
        at, k = c % KEPT, kept - 1
        stamp = book.stamps[j, at]
        if stamp > book.stamps[leader, k % KEPT]:
            return
        while k > oldest and book.stamps[leader, (k - 1) % KEPT] > stamp:
            k -= 1
        whole[j, _WHOLE.COMPARED] = c + 1
        if k == oldest:
            continue
        later, earlier = k % KEPT, (k - 1) % KEPT
        step = book.stamps[leader, later] - book.stamps[leader, earlier]
        if step > book.shared[_SHARED.MAX_GAP]:
            continue
        part = (stamp - book.stamps[leader, earlier]) / step
        between = book.values[leader, earlier] + part * (book.values[leader, later] - book.values[leader, earlier])
        _weigh(book, j, leader, stamp, book.values[j, at], between)


@njit
def _weigh(book, j, leader, stamp, value, between):
    """One comparison: `value` (6,) of IMU j with `between` (6,) of the leading one at the same time."""
    own, first, whole = book.own[j], book.own[leader], book.whole[j]
    since = (stamp - whole[_WHOLE.COMPARED_AT]) * 1e-9
    dt = min(max(since, 0.0), SILENT) if whole[_WHOLE.COMPARED_AT] != -1 else 0.0
    whole[_WHOLE.COMPARED_AT] = stamp
    own[_OWN.COMMON] += dt
    joins = own[_OWN.COMMON] < JOIN
    if joins:
        own[_OWN.COUNT] += 1.0
        for half in range(2):
            own[_OWN.MOTION + half] = (own[_OWN.MOTION + half] if own[_OWN.COUNT] > 1.0 else 0.0)
            own[_OWN.MOTION + half] += (_by_motion(first, between, half) - own[_OWN.MOTION + half]) / own[_OWN.COUNT]
    for k in range(6):
        e = value[k] - own[_OWN.OFFSET + k] - between[k] + first[_OWN.OFFSET + k]
        own[_OWN.LATELY + k] += (1.0 if own[_OWN.COUNT] == 1.0 else min(1.0, dt / QUICK)) * (e - own[_OWN.LATELY + k])
        if joins:
            own[_OWN.MEAN + k] = (own[_OWN.MEAN + k] if own[_OWN.COUNT] > 1.0 else 0.0)
            own[_OWN.MEAN + k] += (e - own[_OWN.MEAN + k]) / own[_OWN.COUNT]
            around = (own[_OWN.LATELY + k] - own[_OWN.MEAN + k]) ** 2
            own[_OWN.AROUND + k] = (own[_OWN.AROUND + k] if own[_OWN.COUNT] > 1.0 else 0.0)
            own[_OWN.AROUND + k] += (around - own[_OWN.AROUND + k]) / own[_OWN.COUNT]
        elif own[_OWN.APART] == 0.0:
            own[_OWN.HELD + k] += e
    if joins:
        return
    own[_OWN.HELD_COUNT] += 1.0
    if own[_OWN.COUNT] > 0.0:
        _join(book, j, leader)
    _test(book, j, leader, between, dt)


@njit
def _by_motion(first, between, half):
    """By how much two IMUs may differ for the motion that the leading one shows: specific force (0) or rate (1)."""
    turn = turning = change = 0.0
    for a in range(3):
        turn += between[3 + a] ** 2
        turning += (between[3 + a] - first[_OWN.QUICK + 3 + a]) ** 2
        change += (between[a] - first[_OWN.SLOW + a]) ** 2
    if half == 1:
        return SHARE * math.sqrt(turn)
    return SHARE * math.sqrt(change) + ARM * (turn + math.sqrt(turning) / QUICK)


@njit
def _limit(own, first, between, k):
    """What component k of the mean difference of an IMU to the leading one may be by chance, and for their motion."""
    half = k // 3
    floor = (own[_OWN.NOW + half] + first[_OWN.NOW + half]) / (2.0 * QUICK)
    return SIGMAS * math.sqrt(max(own[_OWN.VARIANCE + k], floor)) + _by_motion(first, between, half)


@njit
def _join(book, j, leader):
    """The constant difference of IMU j is known: the one that it had, where it had one that fits."""
    own = book.own[j]
    known, worst, which = own[_OWN.JOINED] > 0.0, 0.0, 0
    for k in range(6):
        own[_OWN.VARIANCE + k] = max(own[_OWN.VARIANCE + k], own[_OWN.AROUND + k])
        chance = CHANGED_SIGMAS * math.sqrt(own[_OWN.AROUND + k] * 2.0 * QUICK / JOIN) + own[_OWN.MOTION + k // 3]
        ratio = abs(own[_OWN.MEAN + k]) / max(chance, 1e-12)
        if ratio > worst:
            worst, which = ratio, k
    changed = not known or worst > 1.0
    if known and changed:
        _say(book, _CHANGED, j, leader, which, own[_OWN.MEAN + which], 0.0)
    for k in range(6):
        if changed:
            own[_OWN.OFFSET + k] += own[_OWN.MEAN + k]
            own[_OWN.LATELY + k] -= own[_OWN.MEAN + k]
        own[_OWN.HELD + k] = 0.0
    _say(book, _JOINED, j, leader, 0.0, 0.0, 0.0)
    own[_OWN.JOINED], own[_OWN.APART], own[_OWN.COUNT], own[_OWN.HELD_COUNT] = 1.0, 0.0, 0.0, 0.0


@njit
def _test(book, j, leader, between, dt):
    """Whether IMU j agrees with the leading one; where it does, their difference and its scatter are learned on."""
    own, first = book.own[j], book.own[leader]
    worst, which, limit = 0.0, 0, 0.0
    for k in range(6):
        allowed = _limit(own, first, between, k)
        ratio = abs(own[_OWN.LATELY + k]) / max(allowed, 1e-12)
        if ratio > worst:
            worst, which, limit = ratio, k, allowed
    if own[_OWN.APART] == 0.0 and worst <= 1.0:
        for k in range(6):
            own[_OWN.VARIANCE + k] += min(1.0, dt / LEARN) * (own[_OWN.LATELY + k] ** 2 - own[_OWN.VARIANCE + k])
            own[_OWN.OFFSET + k] += min(1.0, dt / LEARN) * own[_OWN.LATELY + k]
        if own[_OWN.STILL] > 0.0 and first[_OWN.STILL] > 0.0:
            _rest(own, dt)
            _rest(first, dt)
        return
    if own[_OWN.APART] == 0.0:
        _say(book, _APART, j, leader, which, own[_OWN.LATELY + which], limit)
        own[_OWN.AGREED] = 0.0
        for k in range(6):
            own[_OWN.HELD + k] = own[_OWN.ADDED + k] = 0.0
    own[_OWN.APART] += dt
    own[_OWN.AGREED] = own[_OWN.AGREED] + dt if worst < 0.5 else 0.0
    if own[_OWN.AGREED] > AGREE:
        own[_OWN.APART] = 0.0
        _say(book, _TOGETHER, j, leader, 0.0, 0.0, 0.0)
    elif own[_OWN.APART] > ADOPT:
        own[_OWN.COMMON] = 0.0
    elif own[_OWN.STILL] > 0.0 and first[_OWN.STILL] > 0.0 and own[_OWN.RESTED] > 0.0 and first[_OWN.RESTED] > 0.0:
        moved = _moved_at_rest(first, which)
        if moved > 0.5 * limit and moved > 2.0 * _moved_at_rest(own, which):
            book.shared[_SHARED.CHANGED] = 1


@njit
def _force(own):
    """Size of the specific force that an IMU shows now, m/s^2."""
    return math.sqrt(own[_OWN.QUICK] ** 2 + own[_OWN.QUICK + 1] ** 2 + own[_OWN.QUICK + 2] ** 2)


@njit
def _rest(own, dt):
    """What an IMU shows at rest."""
    for k in range(4):
        shown = own[_OWN.QUICK + 3 + k] if k < 3 else _force(own)
        share = min(1.0, dt / REST) if own[_OWN.RESTED] > 0.0 else 1.0
        own[_OWN.REST + k] += share * (shown - own[_OWN.REST + k])
    own[_OWN.RESTED] = 1.0


@njit
def _moved_at_rest(own, which):
    """By how much an IMU at rest shows another value than before: of the specific force, whose parts change with the
    road, the size."""
    if which >= 3:
        return abs(own[_OWN.QUICK + which] - own[_OWN.REST + which - 3])
    return abs(_force(own) - own[_OWN.REST + 3])


@njit
def _say(book, code, i, leader, first, second, third):
    at = min(book.shared[_SHARED.SAID], _SAID_AT_ONCE - 1)
    book.said[at, 0], book.said[at, 1], book.said[at, 2] = code, i, leader
    book.said[at, 3], book.said[at, 4], book.said[at, 5] = first, second, third
    book.shared[_SHARED.SAID] = at + 1


@njit
def _take_all(book, source, stamp, values, first, out_stamps, out, origin, faults, done):
    """Messages from number `first` on, of which source (n,) sent stamp (n,) and values (n, 6), till something is to be
    said; the number of the next message, and of the rows of out_stamps, out and origin (the message they came of) that
    are filled. faults (sources, reasons): counted. done: rows filled before."""
    room = len(out)
    for m in range(first, len(source)):
        count = _take(book, source[m], stamp[m], values[m], out_stamps[done:room], out[done:room])
        for row in range(done, done + count):
            origin[row] = m
        done += count
        faults[source[m], book.whole[source[m], _WHOLE.FAULT]] += 1
        if book.shared[_SHARED.SAID] > 0:
            return m + 1, done
    return len(source), done


class Imus:
    """What the IMUs of the checked parameters `values` say, as one. Those of `inputs` are numbered from 1, the one of
    `imu_topic` is 0."""

    def __init__(self, values: dict):
        named = imus(values)
        self.settings: tuple[InertialSettings, ...] = tuple(one.settings(values) for one in named)
        self.names = ('imu', *(one.name for one in named))
        self.topics = (values['imu_topic'], *(settings.topic for settings in self.settings))
        self.tallies = {name: Tally() for name in self.names}
        #: by name, what is wrong with an IMU now: level and text
        self.found: dict[str, tuple[str, str]] = {}
        self._arms = [_arm_corrector(values, settings) for settings in self.settings]
        n = len(self.names)
        heads = np.zeros((n, Head.SIZE + Sample.SIZE))
        for head in heads:
            HEAD.begin(head)
            head[Imu.MAX_FORCE], head[Imu.MAX_RATE] = values['imu.max_specific_force'], values['imu.max_angular_rate']
        shared = np.array([0, -1, -1, 0, round(values['imu.restart_gap'] * 1e9), round(values['imu.max_gap'] * 1e9), 0],
                          dtype=np.int64)
        whole = np.full((n, _WHOLE.SIZE), -1, dtype=np.int64)
        whole[:, [_WHOLE.KEPT, _WHOLE.COMPARED, _WHOLE.FAULT]] = 0
        own = np.zeros((n, _OWN.SIZE))
        own[0, _OWN.JOINED] = 1.0  # the biases are its own
        self._book = _Book(own, whole, shared, np.zeros((n, KEPT), dtype=np.int64), np.zeros((n, KEPT, 6)), heads,
                           np.zeros((1, 7)), np.zeros((_SAID_AT_ONCE, 6)))
        self._notices: list[Notice] = []
        self._faults = np.zeros((n, len(_REASONS)), dtype=np.int64)
        self._out_stamps, self._out = np.zeros(KEPT, dtype=np.int64), np.zeros((KEPT, 6))
        self._origin, self._source = np.zeros(KEPT, dtype=np.int64), np.zeros(1, dtype=np.int64)

    @property
    def leader(self) -> int:
        """Number of the IMU at whose stamps samples are handed on."""
        return int(self._book.shared[_SHARED.LEADER])

    def notices(self) -> list[Notice]:
        """What has happened since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def prepared(self, i: int, stamp: np.ndarray, force: np.ndarray, rate: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray]:
        """Stamps (n,) ns by the clock, and samples (n, 6) SI in the axes and at the place, of the first IMU, of what
        messages of IMU i say: stamp (n,) ns, force and rate (n, 3). Of the first one they are SI already."""
        if i == 0:
            return stamp, np.column_stack([force, rate])
        settings, arm = self.settings[i - 1], self._arms[i - 1]
        stamp = stamp - round(settings.time_offset * 1e9)
        force = _turned(settings.to_first, force * settings.force_unit)
        rate = _turned(settings.to_first, rate * settings.rate_unit)
        values = np.column_stack([force, rate])
        if arm is not None:
            good = np.isfinite(values.sum(axis=1))
            values[good] = np.column_stack(arm(stamp[good], np.ascontiguousarray(force[good]),
                                               np.ascontiguousarray(rate[good]), None))
        return stamp, values

    def add(self, i: int, stamp: int, force, rate) -> list[tuple[int, tuple[float, ...]]]:
        """One message of IMU i as for `prepared`; the samples to hand on, each a stamp and six numbers."""
        stamps, values = self.prepared(i, np.array([stamp], dtype=np.int64), np.array([force], dtype=float),
                                       np.array([rate], dtype=float))
        self._source[0] = i
        _, count = _take_all(self._book, self._source, stamps, values, 0, self._out_stamps, self._out, self._origin,
                             self._faults, 0)
        self._count(i, int(stamps[0]), int(self._book.whole[i, _WHOLE.FAULT]))
        if self._book.shared[_SHARED.SAID]:
            self._tell()
        return [(int(self._out_stamps[row]), tuple(self._out[row].tolist())) for row in range(count)]

    def warm_up(self) -> None:
        """Compile or load what is compiled now, so that the first message is not late."""
        _take_all(self._book, self._source[:0], self._origin[:0], self._out[:0], 0, self._out_stamps, self._out,
                  self._origin, self._faults, 0)

    def _count(self, i: int, stamp: int, fault: int) -> None:
        tally = self.tallies[self.names[i]]
        if fault:
            tally.refuse(stamp, _REASONS[fault])
        else:
            tally.use(math.nan)

    def of_recording(self, imu: ImuSamples, others: dict[str, ImuSamples]) -> ImuSamples:
        """All samples of a recording as one stream: `imu` of imu_topic, SI, and others by name as their messages have
        them. Its temperature is not set."""
        sources = [imu, *(others[name] for name in self.names[1:])]
        ready = [self.prepared(i, one.stamp, one.specific_force, one.angular_rate) for i, one in enumerate(sources)]
        source = np.repeat(np.arange(len(sources)), [len(one) for one in sources])
        received = np.concatenate([one.received for one in sources])
        order = np.lexsort((source, received))
        stamp, values = np.concatenate([one[0] for one in ready])[order], np.vstack([one[1] for one in ready])[order]
        within = np.concatenate([np.arange(len(one)) for one in sources])[order]
        source, received = source[order], received[order]
        room = len(source) + KEPT
        out_stamps, out, origin = np.zeros(room, np.int64), np.zeros((room, 6)), np.zeros(room, np.int64)
        faults, upto, done = self._faults, 0, 0
        while upto < len(source):
            upto, done = _take_all(self._book, source, stamp, values, upto, out_stamps, out, origin, faults, done)
            self._tell()
        for i, reason in np.argwhere(faults[:, 1:]):
            self._notices.append(Notice('warning', f'{self.topics[i]}: {faults[i, reason + 1]} samples not believed: '
                                                   f'{_REASONS[reason + 1]}'))
        origin = origin[:done]
        orientation = None
        if imu.orientation is not None:
            mine = (source[origin] == 0) & (stamp[origin] == out_stamps[:done])
            orientation = np.where(mine[:, None], imu.orientation[np.where(mine, within[origin], 0)], np.nan)
        return ImuSamples(out_stamps[:done], received[origin], out[:done, :3].copy(), out[:done, 3:].copy(),
                          orientation)

    def _tell(self) -> None:
        for row in self._book.said[:self._book.shared[_SHARED.SAID]].copy():
            self._notices.append(self._worded(int(row[0]), int(row[1]), int(row[2]), row[3:].tolist()))
        self._book.shared[_SHARED.SAID] = 0

    def _worded(self, code: int, i: int, leader: int, numbers: list[float]) -> Notice:
        topic, other = self.topics[i], self.topics[leader]
        if code == _ALONE:
            reason = _REASONS[int(numbers[1])]
            why = f'samples not believed: {reason}' if reason else f'no sample for {numbers[0]:.2f} s'
            self.found[self.names[leader]] = 'warning', f'{why}; the samples are those of {topic}'
            return Notice('warning', f'{other}: {why}: the samples of {topic} are used from now on')
        if code == _LEADS:
            return Notice('info', f'{topic}: samples are taken at its stamps again, instead of those of {other}')
        if code == _JOINED:
            self.found.pop(self.names[i], None)
            offset = self._book.own[i, _OWN.OFFSET:_OWN.OFFSET + 6] - self._book.own[
                leader, _OWN.OFFSET:_OWN.OFFSET + 6]
            return Notice('info', f'{topic}: averaged with {other} from now on; it is more by {_listed(offset[:3])} '
                                  f'm/s^2 and {_listed(offset[3:])} rad/s')
        if code == _CHANGED:
            return Notice('warning', f'{topic}: it differs from {other} by another constant than before, '
                                     f'{_component(int(numbers[0]), numbers[1])} more: other biases')
        if code == _APART:
            text = (f'it differs from {other} by {_component(int(numbers[0]), numbers[1])}, by chance up to '
                    f'{numbers[2]:.2g}: not averaged')
            self.found[self.names[i]] = 'warning', f'{text}, {other} is believed'
            return Notice('warning', f'{topic}: {text}, {other} is believed until a standstill tells')
        if code == _OFF:
            self.found.pop(self.names[i], None)
            text = f'at rest it shows another value than before, {topic} does not'
            self.found[self.names[leader]] = 'warning', f'{text}; the samples are those of {topic}'
            return Notice('warning', f'{other}: {text}: the samples of {topic} are used from now on')
        self.found.pop(self.names[i], None)
        return Notice('info', f'{topic}: it agrees with {other} again: averaged')


def as_one(recording: Recording, values: dict) -> tuple[Recording, list[str]]:
    """`recording` with the samples of all IMUs that the checked parameters `values` name as one stream, that of
    imu_topic in SI units; and what is to be said of them. As it is where there is one."""
    several = Imus(values)
    names = several.names[1:]
    if not names:
        return recording, []
    streams = recording.streams()
    imu = several.of_recording(recording.imu, {name: streams.get(name, NO_SAMPLES) for name in names})
    others = {name: samples for name, samples in recording.others.items() if name not in names}
    said = [notice.text for notice in several.notices() if notice.level != 'info']
    return replace(recording, imu=imu.with_temperature(recording.temperature), others=others), said


def _component(k: int, value: float) -> str:
    return f"{value:+.3g} {'m/s^2' if k < 3 else 'rad/s'} along axis {'xyz'[k % 3]} of the first IMU"


def _listed(values) -> str:
    return f"({', '.join(f'{value:.3g}' for value in values)})"


def _turned(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """`vectors` (n, 3) turned by `rotation` (3, 3), written out: the same bits for one sample and for many."""
    return np.stack([row[0] * vectors[:, 0] + row[1] * vectors[:, 1] + row[2] * vectors[:, 2] for row in rotation],
                    axis=1)


def _arm_corrector(values: dict, settings: InertialSettings):
    """What an IMU beside the first would measure there; None where it is there."""
    return AccelerometerLeverArm().corrector({'imu.lever_arm': settings.arm}, mounting(values['imu.mounting_rpy']))
