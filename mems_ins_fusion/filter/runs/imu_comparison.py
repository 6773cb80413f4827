"""Comparing two IMUs: how far they differ, by how much they may by chance, and whether they agree in motion.

Over WINDOW the difference of IMU j to the leading one has to be small against the motion and no more than the noise of
both, which an axis, a unit, a scale or a delay that is wrong does not pass. Where they have agreed, each further window
is judged in the same way, and the difference over QUICK at once against its usual scatter.
"""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.compiled import njit

from .imu_memory import (
    AVERAGED,
    CHANGED,
    DIFFERS,
    KEPT,
    QUICK,
    SILENT,
    SLOW,
    WINDOW,
    compare_anew,
    patience,
    say,
)

#: share of the specific force by which two that agree may differ in a window, RMS: half a second late is 0.14 and more,
#: and a scale that is off by 5 % is less than what a bias wanders by
SHARE_FORCE = 0.1
#: the same of the angular rate: an axis off by 1.4 deg, a scale off by 2.5 %; one of 3 % costs, studies/several_imus.py
SHARE_RATE = 0.025
#: m/s^2, RMS of three axes: by which biases of consumer-grade parts wander in a window
WANDER_FORCE = 0.06
#: rad/s, the same
WANDER_RATE = 3e-4
#: standard deviations of the difference that are chance: six components, some 7000 independent ones an hour, and tails
SIGMAS = 8.0
#: multiple of its usual noise, and of that of the other, at which the leading IMU is replaced: rough roads shake both
NOISIER = 10.0


@njit
def compare(book, j, leader):
    """Those samples of IMU j that lie between two of the leading one, with it."""
    oldest = max(book.kept[leader] - KEPT, 0)
    while book.compared[j] < book.kept[j] and book.kept[leader] > 0:
        c, k = max(book.compared[j], book.kept[j] - KEPT), book.kept[leader] - 1
        stamp = book.stamps[j, c % KEPT]
        if stamp > book.stamps[leader, k % KEPT]:
            return
        while k > oldest and book.stamps[leader, (k - 1) % KEPT] > stamp:
            k -= 1
        book.compared[j] = c + 1
        later, earlier = k % KEPT, (k - 1) % KEPT
        step = book.stamps[leader, later] - book.stamps[leader, earlier]
        if k > oldest and step <= book.max_gap:
            part = (stamp - book.stamps[leader, earlier]) / step
            between = book.values[leader, earlier] + part * (book.values[leader, later] - book.values[leader, earlier])
            _weigh(book, j, leader, stamp, book.values[j, c % KEPT], between)


@njit
def _weigh(book, j, leader, stamp, value, between):
    """One comparison: `value` (6,) of IMU j with `between` (6,) of the leading one at the same time."""
    difference = value - book.offset[j] - between + book.offset[leader]
    shown = np.concatenate((difference, between))
    dt = min(max((stamp - book.compared_at[j]) * 1e-9, 0.0), SILENT)
    if book.compared_at[j] == -1:
        dt, known = 0.0, 6 if book.averaged[j] else 0  # the difference is none
        book.quick[j, known:] = shown[known:]
    book.compared_at[j] = stamp
    if book.count[j] == 0.0:
        book.mean[j], book.variance[j] = 0.0, 0.0
    book.count[j] += 1.0
    book.window[j] += dt
    book.quick[j] += min(1.0, dt / QUICK) * (shown - book.quick[j])
    off = book.quick[j] - book.mean[j]
    book.mean[j] += off / book.count[j]
    book.variance[j] += (off * (book.quick[j] - book.mean[j]) - book.variance[j]) / book.count[j]
    if book.averaged[j]:
        book.held[j] += difference
        book.held_count[j] += 1.0
        book.offset[j] += min(1.0, dt / WINDOW) * difference
        limit, others = _limit(book, j, leader), np.maximum(book.noise[leader], book.now[j])
        k = np.argmax(np.abs(book.quick[j, :6]) / limit)
        if (book.now[leader] > NOISIER**2 * others).any():
            compare_anew(book, j, 0.0)
            book.returns[j] = True
        elif abs(book.quick[j, k]) > limit[k]:
            _differs(book, j, k, book.quick[j, k], limit[k])
    if book.window[j] < 0.0:
        book.count[j] = 0.0
    elif book.window[j] >= WINDOW:
        _decide(book, j, leader)


@njit
def _noise(book, i):
    """Noise density squared of specific force and of angular rate (2,), which may have grown just now."""
    return np.maximum(book.noise[i], book.now[i])


@njit
def certainty_of(book, i):
    """Inverse of `_noise`, limited where an IMU shows none."""
    return 1.0 / np.maximum(_noise(book, i), 1e-18)


@njit
def _limit(book, j, leader):
    """What the difference over QUICK of IMU j to the leading one may be by chance, (6,)."""
    white = (book.now[j] + book.now[leader]) / (2.0 * QUICK)
    return SIGMAS * np.sqrt(np.maximum(book.usual[j] + np.repeat(white, 3), 1e-18))


@njit
def _differs(book, j, k, value, limit):
    """IMU j is not averaged from now on, twice as long each further time: component k of its difference is `value`, and
    may be `limit`."""
    book.differs[j] += 1
    compare_anew(book, j, WINDOW - SLOW * 2.0**(book.differs[j] - 1))
    say(book, DIFFERS, j, k, value, limit)


@njit
def _decide(book, j, leader):
    """What the window shows of IMU j. It goes on up to SLOW till there is motion enough to tell."""
    noise = 3.0 * (_noise(book, j) + _noise(book, leader)) / (2.0 * QUICK)
    moved, worst, which, limit = True, 0.0, 0, 0.0
    for half in range(2):
        share, wander = (SHARE_FORCE, WANDER_FORCE) if half == 0 else (SHARE_RATE, WANDER_RATE)
        motion = share**2 * book.variance[j, 6 + 3 * half:9 + 3 * half].sum()
        apart, chance = book.variance[j, 3 * half:3 * half + 3], wander**2 + noise[half]
        if half == 1 and book.averaged[j]:  # a rate that drifts; biases of accelerometers wander by more than shows
            apart = apart + book.mean[j, 3:6]**2
        moved = moved and motion > chance
        if apart.sum() > worst * max(motion, chance):
            worst, limit = apart.sum() / max(motion, chance), math.sqrt(max(motion, chance))
            which = 3 * half + np.argmax(apart)
    wrong = worst > (1.0 if moved else 2.0)
    if not moved and not wrong and book.known[j] and book.window[j] < SLOW:
        return
    book.window[j], book.count[j] = 0.0, 0.0
    if wrong:
        if book.averaged[j] or book.differs[j] == 0:
            _differs(book, j, which, math.sqrt(worst) * limit, limit)
    elif moved and book.averaged[j]:
        book.usual[j] += 0.5 * (book.variance[j, :6] + book.mean[j, :6]**2 - book.usual[j])
    elif moved or not book.known[j]:
        _learn(book, j, leader, moved)
    if j < leader and (book.averaged[j] or book.usual[j, 0] == 0.0):
        book.returns[j] = True


@njit
def _learn(book, j, leader, agrees):
    """The mean of the window is the constant difference of IMU j, which is averaged from now on if it agrees."""
    mean, limit = book.mean[j, :6], _limit(book, j, leader)
    k = np.argmax(np.abs(mean) / limit)
    if agrees and book.usual[j, 0] > 0.0 and abs(mean[k]) > limit[k]:
        say(book, CHANGED, j, k, mean[k], 0.0)
    book.offset[j] += mean
    book.quick[j, :6] -= mean
    book.known[j] = True
    if agrees:
        book.usual[j] = np.maximum(book.variance[j, :6], 1e-18)
        book.averaged[j] = True
        late = (book.newest[leader] - book.compared_at[j]) * 1e-9
        say(book, AVERAGED, j, late, late > patience(book, j), 0.0)
