"""Comparison of an IMU with the leading one: their difference, its limits by noise, and whether both agree in motion.

In a window (COMPARED_WINDOW) the difference has to be small compared with the motion, and not larger than the noise of
both. An IMU with a wrong axis, unit, scale or delay does not pass this test. After both have agreed, each further
window is tested in the same way, and the difference low-passed with QUICK is tested at each sample against its usual
scatter.
"""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.compiled import njit

from .imu_memory import (
    AVERAGED,
    CHANGED,
    COMPARED_WINDOW,
    DIFFERS,
    KEPT_SAMPLES,
    QUICK,
    SILENT,
    SLOW,
    compare_anew,
    may_lead,
    patience,
    say,
)

#: largest difference in a window over the variation of the specific force (both RMS). A delay of half a second gives
#: 0.14 or more; a scale error of 5 % gives less than the drift of the bias
SHARE_FORCE = 0.1
#: the same for the angular rate: an axis off by 1.4 deg or a scale error of 2.5 % is accepted. A scale error of 3 % has
#: a cost (studies/several_imus.py)
SHARE_RATE = 0.025
#: m/s^2, RMS of three axes, change of the biases of consumer-grade accelerometers in a window
WANDER_FORCE = 0.06
#: rad/s, the same of gyroscopes
WANDER_RATE = 3e-4
WANDER = np.repeat(np.array([WANDER_FORCE, WANDER_RATE]), 3)
#: largest difference in standard deviations: an hour has some 7000 independent values of six components, and their
#: distribution has tails
SIGMAS = 8.0
#: an IMU is not used beside another one when its noise (standard deviation) exceeds its own usual noise and the present
#: noise of the other IMU by this factor: a rough road shakes both
NOISIER = 10.0


@njit
def compare(book, j, leader):
    """Compare the samples of IMU j that lie between two samples of the leading IMU with these, interpolated."""
    oldest = max(book.kept[leader] - KEPT_SAMPLES, 0)
    while book.compared[j] < book.kept[j] and book.kept[leader] > 0:
        c, k = max(book.compared[j], book.kept[j] - KEPT_SAMPLES), book.kept[leader] - 1
        stamp = book.stamps[j, c % KEPT_SAMPLES]
        if stamp > book.stamps[leader, k % KEPT_SAMPLES]:
            return
        while k > oldest and book.stamps[leader, (k - 1) % KEPT_SAMPLES] > stamp:
            k -= 1
        book.compared[j] = c + 1
        later, earlier = k % KEPT_SAMPLES, (k - 1) % KEPT_SAMPLES
        step = book.stamps[leader, later] - book.stamps[leader, earlier]
        if k > oldest and step <= book.max_gap:
            part = (stamp - book.stamps[leader, earlier]) / step
            between = book.values[leader, earlier] + part * (book.values[leader, later] - book.values[leader, earlier])
            _compare_one(book, j, leader, stamp, book.values[j, c % KEPT_SAMPLES], between)


@njit
def is_noisier(book, i, j):
    """Whether the noise of IMU i has become larger than its usual noise and the present one of IMU j by NOISIER."""
    return (book.now[i] > NOISIER**2 * np.maximum(book.noise[i], book.now[j])).any()


@njit
def _compare_one(book, j, leader, stamp, value, between):
    """Compare `value` (6,) of IMU j with `between` (6,) of the leading one at the same time, `stamp` ns."""
    difference = value - book.offset[j] - between + book.offset[leader]
    shown = np.concatenate((difference, between))
    book.latest[j] = difference
    dt = min(max((stamp - book.compared_at[j]) * 1e-9, 0.0), SILENT)
    if book.compared_at[j] == -1:
        dt, known = 0.0, 6 if book.averaged[j] else 0  # of an averaged IMU the low-passed difference begins at zero
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
    if may_lead(book, j) and is_noisier(book, leader, j):
        compare_anew(book, j, 0.0)
        book.returns[j] = True
    elif book.averaged[j]:
        book.held[j] += difference
        book.held_count[j] += 1.0
        book.offset[j] += min(1.0, dt / COMPARED_WINDOW) * difference
        limit = _limit(book, j, leader)
        k = np.argmax(np.abs(book.quick[j, :6]) / limit)
        if abs(book.quick[j, k]) > limit[k]:
            _differs(book, j, k, book.quick[j, k], limit[k])
    if book.window[j] < 0.0:
        book.count[j] = 0.0
    elif book.window[j] >= COMPARED_WINDOW:
        _decide(book, j, leader)


@njit
def _noise(book, i):
    """Noise density squared of specific force and of angular rate (2,): the larger of the usual and the present one."""
    return np.maximum(book.noise[i], book.now[i])


@njit
def certainty_of(book, i):
    """Inverse of `_noise` (2,), the weight of IMU i in the average; bounded for an IMU without noise."""
    return 1.0 / np.maximum(_noise(book, i), 1e-18)


@njit
def _limit(book, j, leader):
    """Largest low-passed difference of IMU j to the leading one that counts as chance, (6,): SIGMAS sigma."""
    white = (book.now[j] + book.now[leader]) / (2.0 * QUICK)
    return SIGMAS * np.sqrt(np.maximum(book.usual[j] + np.repeat(white, 3), 1e-18))


@njit
def _differs(book, j, k, value, limit):
    """Do not average IMU j from now on, for twice as long each further time, with a message: component k of its
    difference is `value`, allowed is `limit`."""
    book.differs[j] += 1
    compare_anew(book, j, COMPARED_WINDOW - SLOW * 2.0**(book.differs[j] - 1))
    book.differing[j] = book.known[j]
    say(book, DIFFERS, j, k, value, limit)


@njit
def _decide(book, j, leader):
    """Test the window of IMU j. Without enough motion for the test, the window is extended up to SLOW."""
    noise = 3.0 * (_noise(book, j) + _noise(book, leader)) / (2.0 * QUICK)
    moved, worst, which, limit = True, 0.0, 0, 0.0
    for half in range(2):
        share, wander = (SHARE_FORCE, WANDER_FORCE) if half == 0 else (SHARE_RATE, WANDER_RATE)
        motion = share**2 * book.variance[j, 6 + 3 * half:9 + 3 * half].sum()
        apart, chance = book.variance[j, 3 * half:3 * half + 3], wander**2 + noise[half]
        # a drift of the gyroscopes shows in the mean; accelerometer biases change by more than this test could find
        if half == 1 and book.averaged[j]:
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
    """Take the mean of the window as the constant difference (`offset`) of IMU j, and average it if `agrees`."""
    mean, limit = book.mean[j, :6], _limit(book, j, leader)
    k = np.argmax(np.abs(mean) / limit)
    if book.differing[j] and (np.abs(mean) > np.maximum(limit, SIGMAS * WANDER)).any():
        return
    if agrees and book.usual[j, 0] > 0.0 and abs(mean[k]) > limit[k]:
        say(book, CHANGED, j, k, mean[k], 0.0)
    book.offset[j] += mean
    book.quick[j, :6] -= mean
    book.known[j] = True
    if agrees:
        book.usual[j] = np.maximum(book.variance[j, :6], 1e-18)
        book.averaged[j], book.differing[j] = True, False
        late = (book.newest[leader] - book.compared_at[j]) * 1e-9
        say(book, AVERAGED, j, late, late > patience(book, j), 0.0)
