"""Comparison of an IMU with the leading one: their difference, its limits by noise, and whether both agree in motion.

In a window (COMPARED_WINDOW) the difference has to be small compared with the motion, and not larger than the noise of
both. An IMU with a wrong axis, unit, scale or delay does not pass this test. After both have agreed, each further
window is tested in the same way, and the difference low-passed with QUICK is tested at each sample against its usual
scatter.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from .imu_memory import (
    AVERAGED,
    CHANGED,
    COMPARED_WINDOW,
    DIFFERS,
    FEWEST_BEYOND,
    KEPT_SAMPLES,
    NOISIER,
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
#: largest difference in standard deviations: an hour has some 7000 independent values of six components, and their
#: distribution has tails
SIGMAS = 8.0


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
            _compare_one(book, j, leader, c % KEPT_SAMPLES, later, earlier, part)


@njit
def is_noisier(book, i, j):
    """Whether the noise of IMU i has become larger than its usual noise and the present one of IMU j by NOISIER."""
    for half in range(2):
        if book.now[i, half] > NOISIER**2 * max(book.noise[i, half], book.now[j, half]):
            return True
    return False


@njit
def _compare_one(book, j, leader, c, later, earlier, part):
    """Compare sample c of IMU j with the leading IMU at the same time: `part` of the way from its sample `earlier` to
    `later`. Samples: their places among those kept."""
    stamp, anew = book.stamps[j, c], book.compared_at[j] == -1
    dt = 0.0 if anew else min(max((stamp - book.compared_at[j]) * 1e-9, 0.0), SILENT)
    book.compared_at[j] = stamp
    if book.count[j] == 0.0:
        for k in range(12):
            book.mean[j, k] = book.variance[j, k] = 0.0
    book.count[j] += 1.0
    book.window[j] += dt
    for k in range(6):
        between = book.values[leader, earlier, k]
        between = between + part * (book.values[leader, later, k] - between)
        book.latest[j, k] = book.values[j, c, k] - book.offset[j, k] - between + book.offset[leader, k]
        # of an averaged IMU the low-passed difference begins at zero
        _low_pass(book, j, k, book.latest[j, k], dt, anew and not book.averaged[j])
        _low_pass(book, j, 6 + k, between, dt, anew)
    if is_noisier(book, j, leader):  # till it is not, it is not averaged, and nothing is known of its other errors
        compare_anew(book, j, min(book.window[j] + 4.0 * QUICK, 0.0))
    elif may_lead(book, j) and is_noisier(book, leader, j):
        compare_anew(book, j, 0.0)
        book.returns[j] = True
    elif book.averaged[j]:
        book.held_count[j] += 1.0
        for k in range(6):
            book.held[j, k] += book.latest[j, k]
            book.offset[j, k] += min(1.0, dt / COMPARED_WINDOW) * book.latest[j, k]
        k = _largest(book, j, leader, book.quick)
        limit = _limit(book, j, leader, k)
        book.beyond[j] = book.beyond[j] + 1 if abs(book.quick[j, k]) > limit else 0
        if book.beyond[j] >= FEWEST_BEYOND:
            _differs(book, j, k, book.quick[j, k], limit)
    if book.window[j] < 0.0:
        book.count[j] = 0.0
    elif book.window[j] >= COMPARED_WINDOW:
        _decide(book, j, leader)


@njit
def _low_pass(book, j, k, value, dt, first):
    """Low-pass component k of the difference (from 6 on: of the sample of the leading IMU), dt s after the one before,
    and update mean and variance in the window. first: begin with this value."""
    if first:
        book.quick[j, k] = value
    book.quick[j, k] += min(1.0, dt / QUICK) * (value - book.quick[j, k])
    off = book.quick[j, k] - book.mean[j, k]
    book.mean[j, k] += off / book.count[j]
    book.variance[j, k] += (off * (book.quick[j, k] - book.mean[j, k]) - book.variance[j, k]) / book.count[j]


@njit
def _noise(book, i, half):
    """Noise density squared of specific force (half 0) or angular rate (1): the larger of the usual and the present
    one."""
    return max(book.noise[i, half], book.now[i, half])


@njit
def certainty_of(book, i, half):
    """Inverse of `_noise`, the weight of IMU i in the average; bounded for an IMU without noise."""
    return 1.0 / max(_noise(book, i, half), 1e-18)


@njit
def _limit(book, j, leader, k):
    """Largest low-passed difference of IMU j to the leading one that counts as chance, component k: SIGMAS sigma."""
    white = (book.now[j, k // 3] + book.now[leader, k // 3]) / (2.0 * QUICK)
    return SIGMAS * math.sqrt(max(book.usual[j, k] + white, 1e-18))


@njit
def _largest(book, j, leader, differences):
    """Component of the difference of IMU j, in `differences` (n, 12), that is the largest relative to its `_limit`."""
    which, most = 0, -1.0
    for k in range(6):
        ratio = abs(differences[j, k]) / _limit(book, j, leader, k)
        if ratio > most:
            which, most = k, ratio
    return which


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
    moved, worst, which, limit = True, 0.0, 0, 0.0
    for half in range(2):
        share, wander = (SHARE_FORCE, WANDER_FORCE) if half == 0 else (SHARE_RATE, WANDER_RATE)
        noise = 3.0 * (_noise(book, j, half) + _noise(book, leader, half)) / (2.0 * QUICK)
        motion, apart, most, largest = 0.0, 0.0, -1.0, 0
        for k in range(3 * half, 3 * half + 3):
            # a drift of the gyroscopes shows in the mean; accelerometer biases change by more than this test could find
            off = book.variance[j, k] + (book.mean[j, k]**2 if half == 1 and book.averaged[j] else 0.0)
            motion += book.variance[j, 6 + k]
            apart += off
            if off > most:
                most, largest = off, k
        motion, chance = share**2 * motion, wander**2 + noise
        moved = moved and motion > chance
        if apart > worst * max(motion, chance):
            worst, limit, which = apart / max(motion, chance), math.sqrt(max(motion, chance)), largest
    wrong = worst > (1.0 if moved else 2.0)
    if not moved and not wrong and book.known[j] and book.window[j] < SLOW:
        return
    book.window[j], book.count[j] = 0.0, 0.0
    if wrong:
        if book.averaged[j] or book.differs[j] == 0:
            _differs(book, j, which, math.sqrt(worst) * limit, limit)
    elif moved and book.averaged[j]:
        for k in range(6):
            book.usual[j, k] += 0.5 * (book.variance[j, k] + book.mean[j, k]**2 - book.usual[j, k])
    elif moved or not book.known[j]:
        _learn(book, j, leader, moved)
    if j < leader and (book.averaged[j] or book.usual[j, 0] == 0.0):
        book.returns[j] = True


@njit
def _learn(book, j, leader, agrees):
    """Take the mean of the window as the constant difference (`offset`) of IMU j, and average it if `agrees`."""
    if book.differing[j]:
        # what is left may be the change of biases only: as they walk at random, SIGMAS times the change in one window
        # is that in 64 windows, 20 minutes
        for k in range(6):
            wander = WANDER_FORCE if k < 3 else WANDER_RATE
            if abs(book.mean[j, k]) > max(_limit(book, j, leader, k), SIGMAS * wander):
                return
    k = _largest(book, j, leader, book.mean)
    if agrees and book.usual[j, 0] > 0.0 and abs(book.mean[j, k]) > _limit(book, j, leader, k):
        say(book, CHANGED, j, k, book.mean[j, k], 0.0)
    for k in range(6):
        book.offset[j, k] += book.mean[j, k]
        book.quick[j, k] -= book.mean[j, k]
        if agrees:
            book.usual[j, k] = max(book.variance[j, k], 1e-18)
    book.known[j] = True
    if agrees:
        book.averaged[j], book.differing[j] = True, False
        late = (book.newest[leader] - book.compared_at[j]) * 1e-9
        say(book, AVERAGED, j, late, late > patience(book, j), 0.0)
