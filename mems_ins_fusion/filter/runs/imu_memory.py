"""Memory of the code for several IMUs: their newest samples, their noise, and the differences between them.

`imu_comparison` writes the differences to the leading IMU, `imu_lead` chooses the leading IMU. Compiled functions of
these files have loops instead of array expressions, which take numba several times as long to compile.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, Head
from ..trust.imu_faults import Imu

#: s without a sample of the leading IMU after which the next IMU leads. Longer than the delays of drivers, buses and
#: queues between two topics, and shorter than imu.max_gap
SILENT = 0.2
#: the same limit in sampling intervals, for a slow IMU: two samples may be lost
SILENT_INTERVALS = 3.0
#: number of samples kept of each IMU: those of `imu_lead.SILENT_UNCOMPARED` at 200 Hz, those of SILENT at 5 kHz
KEPT_SAMPLES = 1024
#: s over which two IMUs are compared, and time constant of the mean of their difference, which is subtracted. Long
#: enough to contain a turn or a stop, and to find the bias of consumer-grade gyroscopes to a tenth
COMPARED_WINDOW = 20.0
#: s, time constant of the low pass of the difference that is tested at each sample: longer than vibration, short enough
#: that a wrong turn rate does not yet spoil the heading
QUICK = 0.5
#: s: a window waits for motion up to this time; an IMU that differed is not averaged for at least this time; time
#: constant of the usual noise. Longer than a straight road or a stop
SLOW = 60.0
#: an IMU is not used beside another one when its noise (standard deviation) exceeds its own usual noise and the present
#: noise of the other IMU by this factor: a rough road shakes both
NOISIER = 10.0
#: share of NOISIER squared by which one change from sample to sample raises the noise density squared at most: an error
#: that begins by a jump is not noise, and neither it nor a single sample that is off, which is two changes, may count
#: as an IMU that has become NOISIER
ONE_CHANGE = 0.4
#: number of differences in a row beyond their limit from which on an IMU is one that differs: the smallest number of
#: changes that together are more than NOISIER squared (3). Noise that has just begun is beyond the limit, too, and
#: counts as noise by then
FEWEST_BEYOND = int(1.0 / ONE_CHANGE) + 1
#: codes of the messages, see `Imus._worded`
ALONE, LEADS, AVERAGED, CHANGED, DIFFERS, NOISY = range(6)


class Book(NamedTuple):
    """The memory. Arrays have a row for each of n IMUs. The six components are specific force, then angular rate, in
    the sensor axes of the first IMU. Differences are those to the leading IMU. Stamps are ns, -1: none."""

    offset: np.ndarray  # (n, 6) constant difference to the first IMU, which is subtracted
    known: np.ndarray  # whether `offset` has been estimated
    averaged: np.ndarray  # whether the IMU agrees with the leading one, so that both are averaged
    differing: np.ndarray  # whether the IMU differs from the leading one, and `offset` is known: the filter judges both
    latest: np.ndarray  # (n, 6) latest difference
    differs: np.ndarray  # number of messages that it does not agree
    returns: np.ndarray  # whether it is to lead from now on
    usual: np.ndarray  # (n, 6) mean square of the difference in windows with agreement; 0: there was none
    window: np.ndarray  # s since the window began; negative: it has not begun
    count: np.ndarray  # number of differences in the window
    quick: np.ndarray  # (n, 12) difference and sample of the leading IMU, low-passed with QUICK
    mean: np.ndarray  # (n, 12) mean of `quick` in the window
    variance: np.ndarray  # (n, 12) and its variance
    held: np.ndarray  # (n, 6) sum of the differences since the last sample that was handed on
    held_count: np.ndarray  # and their number
    beyond: np.ndarray  # number of the last samples in a row at which the difference was larger than chance
    interval: np.ndarray  # s between samples
    now: np.ndarray  # (n, 2) noise density squared, of f and of w, with the time constant QUICK
    noise: np.ndarray  # (n, 2) the same with the time constant SLOW: the usual noise
    newest: np.ndarray  # stamp of the newest sample
    compared_at: np.ndarray  # stamp of the last sample that was compared with the leading IMU
    mark: np.ndarray  # stamp of the newest sample when the last sample of the leading IMU came
    fault: np.ndarray  # `Fault` of the newest sample
    kept: np.ndarray  # number of valid samples so far, of which the last KEPT_SAMPLES are kept
    compared: np.ndarray  # number of these that have been compared
    stamps: np.ndarray  # (n, KEPT_SAMPLES) stamps of the samples kept
    values: np.ndarray  # (n, KEPT_SAMPLES, 6) the samples kept
    heads: np.ndarray  # (n, Head.SIZE) memory of `imu_faults` for each IMU
    sample: np.ndarray  # (1, 7) argument of `imu_faults.check`
    said: np.ndarray  # (rows, 6) messages: code, IMU, leading IMU, three numbers
    said_count: np.ndarray  # (1,) number of messages
    leader: np.ndarray  # (1,) number of the leading IMU
    last: np.ndarray  # (1,) stamp of the newest sample that was handed on
    epoch: np.ndarray  # (1,) stamp from which times are counted
    restart_gap: int  # ns
    max_gap: int  # ns


def book_of(n: int, values: dict) -> Book:
    """The memory for n IMUs with the checked parameters `values`, before the first sample."""
    floats = {name: np.zeros((n, *shape)) for shape, names in (
        ((), 'window count held_count interval'), ((2,), 'now noise'), ((6,), 'offset usual held latest'),
        ((12,), 'quick mean variance'), ((KEPT_SAMPLES, 6), 'values'),
        ((Head.SIZE,), 'heads')) for name in names.split()}
    flags = {name: np.zeros(n, dtype=bool) for name in ('known', 'averaged', 'differing', 'returns')}
    stamps = {name: np.full(n, -1, dtype=np.int64) for name in ('newest', 'compared_at', 'mark')}
    counts = {name: np.zeros(n, dtype=np.int64) for name in ('differs', 'fault', 'kept', 'compared', 'beyond')}
    for head in floats['heads']:
        HEAD.begin(head)
        head[Imu.MAX_FORCE], head[Imu.MAX_RATE] = values['imu.max_specific_force'], values['imu.max_angular_rate']
    flags['known'][0] = True  # offsets are relative to the first IMU
    floats['window'][:] = -4.0 * QUICK  # as in compare_anew
    return Book(**floats, **flags, **stamps, **counts, stamps=np.zeros((n, KEPT_SAMPLES), dtype=np.int64),
                 sample=np.zeros((1, 7)), said=np.zeros((16, 6)), said_count=np.zeros(1, dtype=np.int64),
                 leader=np.zeros(1, dtype=np.int64), last=np.full(1, -1, dtype=np.int64),
                 epoch=np.full(1, -1, dtype=np.int64), restart_gap=round(values['imu.restart_gap'] * 1e9),
                 max_gap=round(values['imu.max_gap'] * 1e9))


@njit
def keep(book, i, stamp, value, dt):
    """Keep a valid sample of IMU i, and update interval and noise of this IMU. value (6,). dt: s since the one before.
    """
    if book.kept[i] > 0 and 0.0 < dt * 1e9 < book.max_gap:
        book.interval[i] += (0.1 if book.interval[i] > 0.0 else 1.0) * (dt - book.interval[i])
        before = (book.kept[i] - 1) % KEPT_SAMPLES
        for half in range(2):
            square = 0.0
            for k in range(3 * half, 3 * half + 3):
                square += (value[k] - book.values[i, before, k])**2
            density = square / 6.0 * dt
            known = book.kept[i] * dt > COMPARED_WINDOW
            step = max(min(1.0, dt / QUICK), 1.0 / book.kept[i])
            now = min(density, ONE_CHANGE * NOISIER**2 / step * book.noise[i, half]) if known else density
            book.now[i, half] += step * (now - book.now[i, half])
            if known:  # bounded: the usual noise grows by e in SLOW at most
                density = min(density, 2.0 * book.noise[i, half])
            book.noise[i, half] += max(min(1.0, dt / SLOW), 1.0 / book.kept[i]) * (density - book.noise[i, half])
    at = book.kept[i] % KEPT_SAMPLES
    book.stamps[i, at] = stamp
    for k in range(6):
        book.values[i, at, k] = value[k]
    book.kept[i] += 1


@njit
def patience(book, i):
    """Longest time without a sample of IMU i, s, in which it does not count as silent."""
    return max(SILENT, SILENT_INTERVALS * book.interval[i])


@njit
def may_lead(book, j):
    """Whether IMU j may lead: its offset is known, and it has agreed with the leading IMU or has never differed."""
    return book.known[j] and (book.usual[j, 0] > 0.0 or book.differs[j] == 0)


@njit
def compare_anew(book, j, begin):
    """Do not average IMU j until a new window has shown that it agrees with the leading one.

    begin: s, 0 or negative: the window begins -begin s from now, after QUICK has settled.
    """
    book.averaged[j] = book.differing[j] = book.returns[j] = False
    book.beyond[j] = 0
    book.window[j], book.count[j], book.held_count[j], book.compared_at[j] = begin - 4.0 * QUICK, 0.0, 0.0, -1
    for k in range(6):
        book.quick[j, k] = book.quick[j, 6 + k] = book.held[j, k] = 0.0


@njit
def say(book, code, i, first, second, third):
    """Add a message about IMU i, with the leading IMU and three numbers, for `Imus._worded`."""
    row = book.said[min(book.said_count[0], len(book.said) - 1)]
    row[0], row[1], row[2], row[3], row[4], row[5] = code, i, book.leader[0], first, second, third
    book.said_count[0] = min(book.said_count[0] + 1, len(book.said))
