"""Choice of the leading IMU among several, and the samples that are handed on to the filter, with its stamps.

The leading IMU is the first in the order of preference that gives valid samples. A faulty sample (`imu_faults`) is not
used while another IMU is available. When the leading IMU is silent, the next one takes its place, from the time on at
which the samples ended; its samples are kept for this. A weighted part of the difference of IMUs that agree with the
leading one (`imu_comparison`) is added to the samples.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..trust.imu_faults import FAULTS, Fault, check
from .imu_comparison import certainty_of, compare, is_noisier
from .imu_memory import ALONE, KEPT_SAMPLES, LEADS, NOISY, compare_anew, keep, may_lead, patience, say

#: s without samples of the leading IMU after which an IMU that has not yet agreed with it leads. Drivers start one
#: after the other, and bridging some seconds is better than samples of an IMU with a wrong mounting
SILENT_UNCOMPARED = 5.0
#: code of a sample that is not finite
NOT_FINITE = Fault.SIZE
REASONS = (*FAULTS, 'not a number')


@njit
def _take(book, i, stamp, value, out_stamps, out):
    """Process sample `value` (6,) of IMU i, stamped `stamp` ns. Writes the samples to hand on to out_stamps and out;
    returns their number."""
    leads, first, step = book.leader[0] == i, book.newest[i] == -1, stamp - book.newest[i]
    if not first and not 0 < step <= book.restart_gap:  # a jump of the stamps, which the filter's intake handles
        if abs(step) > book.max_gap:
            book.newest[i], book.kept[i], book.compared[i] = stamp, 0, 0
            compare_anew(book, i, 0.0)
            book.last[0] = stamp if leads else book.last[0]
        return _hand_on(book, i, stamp, value, 0, out_stamps, out) if leads else 0
    if book.epoch[0] == -1:
        book.epoch[0] = stamp
    dt = 0.0 if first else step * 1e-9
    book.newest[i] = stamp
    if not first and step > book.max_gap:  # the IMU may have been switched off and on
        compare_anew(book, i, 0.0)
    book.fault[i] = _judge(book, i, stamp, value, dt)
    if book.fault[i] == Fault.NONE:
        keep(book, i, stamp, value, dt)
    if leads:
        return _take_leading(book, i, stamp, value, out_stamps, out)
    return _take_other(book, i, stamp, out_stamps, out) if book.fault[i] == Fault.NONE else 0


@njit
def _judge(book, i, stamp, value, dt):
    """Fault of a sample: a `Fault` or NOT_FINITE."""
    total = 0.0
    for k in range(6):
        total += value[k]
        book.sample[0, 1 + k] = value[k]
    if not math.isfinite(total):
        return NOT_FINITE
    book.sample[0, 0] = (stamp - book.epoch[0]) * 1e-9
    # as if in motion, so that frozen axes are found at rest as well: a false alarm costs little beside another IMU
    return check(book.heads[i], book.sample, 0, dt, math.inf, False)


@njit
def _take_leading(book, i, stamp, value, out_stamps, out):
    """Process a sample of the leading IMU; returns the number of samples to hand on."""
    if book.fault[i] != Fault.NONE:  # hold a faulty sample back if another IMU is available; else the filter bridges it
        for j in range(len(book.known)):
            if j != i and may_lead(book, j) and book.fault[j] == Fault.NONE and (
                    stamp - book.newest[j]) * 1e-9 <= patience(book, j) + patience(book, i):
                return 0
    else:
        for j in range(len(book.known)):
            if j != i:
                book.mark[j] = book.newest[j]
                compare(book, j, i)
    if stamp <= book.last[0]:  # up to here the IMU that led before has been handed on
        return 0
    book.last[0] = stamp
    _hand_on(book, i, stamp, value, 0, out_stamps, out)
    if book.fault[i] == Fault.NONE:
        _add_others(book, i, stamp, out)
    return 1


@njit
def _hand_on(book, i, stamp, value, row, out_stamps, out):
    """Write sample `value` of IMU i, minus its offset to the first IMU, to row `row` of out; returns the number of
    rows.
    """
    out_stamps[row] = stamp
    for k in range(6):
        out[row, k], out[row, 6 + k] = value[k] - book.offset[i, k], 0.0
    return row + 1


@njit
def _add_others(book, i, stamp, out):
    """Add to row 0 of out the mean differences of the IMUs that agree with the leading IMU i, weighted by their noise.
    """
    for half in range(2):
        used, certainty = 1, certainty_of(book, i, half)
        for j in range(len(book.known)):
            if j != i and _is_used(book, j, stamp):
                used, certainty = used + 1, certainty + certainty_of(book, j, half)
        for j in range(len(book.known)):
            if j != i and book.held_count[j] > 0.0 and _is_used(book, j, stamp):
                # at most an equal share: an IMU with a low pass shows less noise than it has
                weight = min(certainty_of(book, j, half) / certainty, 1.0 / used) / book.held_count[j]
                for k in range(3 * half, 3 * half + 3):
                    out[0, k] += weight * book.held[j, k]
    for j in range(len(book.known)):
        book.held_count[j] = 0.0
        for k in range(6):
            book.held[j, k] = 0.0
    for j in range(len(book.known)):
        # the filter finds out which one is right
        if j != i and book.differing[j] and _is_there(book, j, stamp) and not is_noisier(book, j, i):
            for k in range(6):
                out[0, k] += 0.5 * book.latest[j, k]
                out[0, 6 + k] = book.latest[j, k]
            break


@njit
def _is_used(book, j, stamp):
    """Whether IMU j is averaged with the leading one at `stamp`, ns: it agrees, and is not silent."""
    return book.averaged[j] and _is_there(book, j, stamp)


@njit
def _is_there(book, j, stamp):
    """Whether IMU j has been compared with the leading one just before `stamp`, ns."""
    at = book.compared_at[j]
    return at != -1 and (stamp - at) * 1e-9 <= patience(book, j)


@njit
def _take_other(book, i, stamp, out_stamps, out):
    """Process a valid sample of IMU i, which does not lead, and let it lead where the leading IMU is silent or worse.

    Returns the number of samples to hand on.
    """
    leader, last = book.leader[0], book.last[0]
    if book.mark[i] == -1:
        book.mark[i] = stamp
    compare(book, i, leader)
    silent, allowed = (stamp - book.mark[i]) * 1e-9, SILENT_UNCOMPARED
    if book.kept[leader] > 0:  # samples that come in a burst have waited in a queue themselves
        silent = min(silent, (stamp - book.stamps[leader, (book.kept[leader] - 1) % KEPT_SAMPLES]) * 1e-9)
        allowed = patience(book, leader) if may_lead(book, i) else SILENT_UNCOMPARED
    # messages of one IMU may come later than those of the other with the same stamps
    if last != -1 and (stamp - last > book.restart_gap or (last - stamp) * 1e-9 > patience(book, i)):
        return 0
    if silent > allowed:
        say(book, ALONE, i, silent, book.fault[leader], 0.0)
        agrees = False
    elif book.returns[i]:
        say(book, LEADS if i < leader else NOISY, i, 0.0, 0.0, 0.0)
        agrees = book.averaged[i]
    else:
        return 0
    book.leader[0], book.known[i], book.known[leader] = i, True, book.newest[leader] != -1
    for k in range(6):
        book.usual[leader, k] = book.usual[i, k]
    book.averaged[leader], book.averaged[i], book.differs[i] = agrees, False, 0
    for j in range(len(book.known)):
        agrees, book.mark[j], book.compared[j] = book.averaged[j], book.newest[j], book.kept[j]
        compare_anew(book, j, 0.0)
        book.averaged[j] = agrees
    count = 0
    for c in range(max(book.kept[i] - KEPT_SAMPLES, 0), book.kept[i]):
        k = c % KEPT_SAMPLES
        if book.stamps[i, k] > last:
            count = _hand_on(book, i, book.stamps[i, k], book.values[i, k], count, out_stamps, out)
    book.last[0] = max(last, stamp)
    return count


@njit
def take_all(book, source, stamp, values, first, out_stamps, out, origin, faults, done):
    """Process messages from number `first` on until there is a message to the user.

    source (n,): number of the IMU of each message. stamp (n,) ns. values (n, 6). out_stamps, out: samples to hand on.
    origin: number of the message from which each of these came. faults (sources, reasons): counts, output. done: number
    of rows of out that are filled already. Returns the number of the next message, and that of the rows filled.
    """
    room = len(out)
    for m in range(first, len(source)):
        count = _take(book, source[m], stamp[m], values[m], out_stamps[done:room], out[done:room])
        for row in range(done, done + count):
            origin[row] = m
        done += count
        faults[source[m], book.fault[source[m]]] += 1
        if book.said_count[0] > 0:
            return m + 1, done
    return len(source), done
