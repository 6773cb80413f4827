"""What is remembered of several IMUs: their newest samples, their noise, and how far they agree.

`imu_comparison` fills what two of them differ by, `imu_lead` which one leads.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, Head
from ..trust.imu_faults import Imu

#: s without a sample, after which the next IMU leads: more than drivers, buses and queues delay one topic against
#: another, and less than imu.max_gap
SILENT = 0.2
#: the same in sampling intervals, of a slow IMU: two samples may be lost
SILENT_INTERVALS = 3.0
#: samples of each that are kept: FIRST of an IMU of 200 Hz, SILENT of one of 5 kHz
KEPT = 1024
#: s over which two are compared, and time constant with which the mean of their difference is taken out: a turn or a
#: stop is in it, and gyroscopes of consumer grade tell a tenth of their bias
WINDOW = 20.0
#: s: time constant of the difference that is judged: longer than vibration, shorter than what a heading bears
QUICK = 0.5
#: s up to which a window waits for motion, for which an IMU that differed is not averaged at least, and time constant
#: of the usual noise: longer than a straight road or a stop
SLOW = 60.0
#: codes of the messages, see `_worded`
ALONE, LEADS, AVERAGED, CHANGED, DIFFERS, NOISY = range(6)


class Book(NamedTuple):
    """All that is remembered. Arrays have a row for each IMU; the six components are specific force, then angular rate,
    sensor axes of the first one. Stamps are ns, -1: none."""

    offset: np.ndarray  # (n, 6) what is to be subtracted
    known: np.ndarray  # whether that has been compared
    averaged: np.ndarray  # whether it agrees with the leading one
    differs: np.ndarray  # how often it was said that it does not
    returns: np.ndarray  # whether it has to lead from now on
    usual: np.ndarray  # (n, 6) mean square of the difference in windows that agreed, 0: none has
    window: np.ndarray  # s in it, negative: till it begins
    count: np.ndarray  # differences in it
    quick: np.ndarray  # (n, 12) the difference over QUICK, and what the leading one shows
    mean: np.ndarray  # (n, 12) of these in the window
    variance: np.ndarray  # (n, 12)
    held: np.ndarray  # (n, 6) sum of the differences since the last sample handed on
    held_count: np.ndarray
    interval: np.ndarray  # s between samples
    now: np.ndarray  # (n, 2) noise density squared, of f and of w, over QUICK
    noise: np.ndarray  # (n, 2) and the usual one
    newest: np.ndarray  # stamp of its newest sample
    compared_at: np.ndarray  # stamp of the last one that was compared
    mark: np.ndarray  # its newest stamp when the leading one last came
    fault: np.ndarray  # of its newest sample
    kept: np.ndarray  # samples believed, the last KEPT of which are kept
    compared: np.ndarray  # how many of them have been
    stamps: np.ndarray  # (n, KEPT)
    values: np.ndarray  # (n, KEPT, 6)
    heads: np.ndarray  # (n, ...) what `imu_faults` remembers
    sample: np.ndarray  # (1, 7) the one judged
    said: np.ndarray  # (rows, 6) a code, the IMU it is of, the one that leads, three numbers
    said_count: np.ndarray  # (1,)
    leader: np.ndarray  # (1,)
    last: np.ndarray  # (1,) stamp of the newest sample handed on
    epoch: np.ndarray  # (1,) stamp that times are counted from
    restart_gap: int  # ns
    max_gap: int  # ns


def book_of(n: int, values: dict) -> Book:
    """Of n IMUs and the checked parameters `values`, before the first sample."""
    floats = {name: np.zeros((n, *shape)) for shape, names in (
        ((), 'window count held_count interval'), ((2,), 'now noise'), ((6,), 'offset usual held'),
        ((12,), 'quick mean variance'), ((KEPT, 6), 'values'), ((Head.SIZE,), 'heads')) for name in names.split()}
    flags = {name: np.zeros(n, dtype=bool) for name in ('known', 'averaged', 'returns')}
    stamps = {name: np.full(n, -1, dtype=np.int64) for name in ('newest', 'compared_at', 'mark')}
    counts = {name: np.zeros(n, dtype=np.int64) for name in ('differs', 'fault', 'kept', 'compared')}
    for head in floats['heads']:
        HEAD.begin(head)
        head[Imu.MAX_FORCE], head[Imu.MAX_RATE] = values['imu.max_specific_force'], values['imu.max_angular_rate']
    flags['known'][0] = True  # the biases are its own
    floats['window'][:] = -4.0 * QUICK  # as in compare_anew
    return Book(**floats, **flags, **stamps, **counts, stamps=np.zeros((n, KEPT), dtype=np.int64),
                 sample=np.zeros((1, 7)), said=np.zeros((16, 6)), said_count=np.zeros(1, dtype=np.int64),
                 leader=np.zeros(1, dtype=np.int64), last=np.full(1, -1, dtype=np.int64),
                 epoch=np.full(1, -1, dtype=np.int64), restart_gap=round(values['imu.restart_gap'] * 1e9),
                 max_gap=round(values['imu.max_gap'] * 1e9))


@njit
def keep(book, i, stamp, value, dt):
    """A sample that is believed: among those kept, and in what is known of their interval and noise."""
    if book.kept[i] > 0 and 0.0 < dt * 1e9 < book.max_gap:
        book.interval[i] += (0.1 if book.interval[i] > 0.0 else 1.0) * (dt - book.interval[i])
        step = value - book.values[i, (book.kept[i] - 1) % KEPT]
        for half in range(2):
            density = (step[3 * half:3 * half + 3]**2).sum() / 6.0 * dt
            book.now[i, half] += max(min(1.0, dt / QUICK), 1.0 / book.kept[i]) * (density - book.now[i, half])
            if book.kept[i] * dt > WINDOW:  # it grows by e in SLOW: noise that goes again is not usual
                density = min(density, 2.0 * book.noise[i, half])
            book.noise[i, half] += max(min(1.0, dt / SLOW), 1.0 / book.kept[i]) * (density - book.noise[i, half])
    book.stamps[i, book.kept[i] % KEPT] = stamp
    book.values[i, book.kept[i] % KEPT] = value
    book.kept[i] += 1


@njit
def patience(book, i):
    """s without a sample of IMU i that are no silence."""
    return max(SILENT, SILENT_INTERVALS * book.interval[i])


@njit
def compare_anew(book, j, begin):
    """IMU j is not averaged till a window, which begins at `begin` s and when QUICK has settled, has shown that it
    agrees."""
    book.averaged[j] = book.returns[j] = False
    book.window[j], book.count[j], book.held_count[j], book.compared_at[j] = begin - 4.0 * QUICK, 0.0, 0.0, -1
    book.quick[j], book.held[j] = 0.0, 0.0


@njit
def say(book, code, i, first, second, third):
    """Note a message on IMU i, for `Imus._worded`; the leading IMU and three numbers go with it."""
    row = book.said[min(book.said_count[0], len(book.said) - 1)]
    row[0], row[1], row[2], row[3], row[4], row[5] = code, i, book.leader[0], first, second, third
    book.said_count[0] = min(book.said_count[0] + 1, len(book.said))
