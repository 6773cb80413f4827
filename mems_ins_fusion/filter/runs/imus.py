"""Several IMUs made one stream of samples, before the filter: live, one message at a time, and of a recording.

One of them leads: the first in the order of preference (`imu_topic`, then those of `inputs`) that gives samples which
can be believed. The filter is fed at its stamps. A sample that `imu_faults` finds fault with is not used while another
IMU is there, and one that is silent is replaced by the next, whose samples since then are kept for that.

Another IMU is a fallback and no more until it has agreed with the leading one while the vehicle moved: over WINDOW,
their difference has to be small against the motion and no more than their noise, which an axis, a unit, a scale or a
delay that is wrong does not pass. From then on half of their difference (of two that are equally noisy) is added,
taken at the stamp of the other between two samples of the leading one, so that what both measure is not late. Its mean
over WINDOW is taken out: to the filter the biases are those of the first one whoever leads, and one that comes or goes
is no jump. Each further window is judged in the same way, and the difference at once against its usual scatter.
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
from ..measurements.inertial import InertialSettings
from ..measurements.registry import imus
from ..memory import HEAD, Head
from ..trust.imu_faults import FAULTS, Fault, Imu, check
from .intake import Notice
from .tally import Tally

#: s without a sample, after which the next IMU leads: more than drivers, buses and queues delay one topic against
#: another, and less than imu.max_gap
SILENT = 0.2
#: the same in sampling intervals, of a slow IMU: two samples may be lost
SILENT_INTERVALS = 3.0
#: s that an IMU which has not agreed with the leading one waits for that: drivers start one after the other, and the
#: filter bridges seconds without samples better than with an IMU that is mounted another way
FIRST = 5.0
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
#: m/s: a speed at which `imu_faults` finds an axis that stays as it is: beside another IMU it may do so at rest, too
_MOVING = 2.0
#: a sample that is no number
_NOT_FINITE = Fault.SIZE
_REASONS = (*FAULTS, 'not a number')

#: codes of the messages, see `_worded`
_ALONE, _LEADS, _AVERAGED, _CHANGED, _DIFFERS, _NOISY = range(6)


class _Book(NamedTuple):
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


def _book_of(n: int, values: dict) -> _Book:
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
    floats['window'][:] = -4.0 * QUICK  # as in _compare_anew
    return _Book(**floats, **flags, **stamps, **counts, stamps=np.zeros((n, KEPT), dtype=np.int64),
                 sample=np.zeros((1, 7)), said=np.zeros((16, 6)), said_count=np.zeros(1, dtype=np.int64),
                 leader=np.zeros(1, dtype=np.int64), last=np.full(1, -1, dtype=np.int64),
                 epoch=np.full(1, -1, dtype=np.int64), restart_gap=round(values['imu.restart_gap'] * 1e9),
                 max_gap=round(values['imu.max_gap'] * 1e9))


@njit
def _take(book, i, stamp, value, out_stamps, out):
    """Sample `value` (6,) of IMU i, stamped `stamp` ns; how many samples to hand on are in out_stamps and out."""
    leads, first, step = book.leader[0] == i, book.newest[i] == -1, stamp - book.newest[i]
    if not first and not 0 < step <= book.restart_gap:  # a jump of the stamps, which the filter's intake handles
        if abs(step) > book.max_gap:
            book.newest[i], book.kept[i], book.compared[i] = stamp, 0, 0
            _compare_anew(book, i, 0.0)
            book.last[0] = stamp if leads else book.last[0]
        return _hand_on(book, i, stamp, value, 0, out_stamps, out) if leads else 0
    if book.epoch[0] == -1:
        book.epoch[0] = stamp
    dt = 0.0 if first else step * 1e-9
    book.newest[i] = stamp
    if not first and step > book.max_gap:  # it may have been switched off and on
        _compare_anew(book, i, 0.0)
    book.fault[i] = _judge(book, i, stamp, value, dt)
    if book.fault[i] == Fault.NONE:
        _keep(book, i, stamp, value, dt)
    if leads:
        return _led(book, i, stamp, value, out_stamps, out)
    return _followed(book, i, stamp, out_stamps, out) if book.fault[i] == Fault.NONE else 0


@njit
def _judge(book, i, stamp, value, dt):
    """What is wrong with a sample, a `Fault` or _NOT_FINITE."""
    if not np.isfinite(value.sum()):
        return _NOT_FINITE
    book.sample[0, 0] = (stamp - book.epoch[0]) * 1e-9
    book.sample[0, 1:] = value
    return check(book.heads[i], book.sample, 0, dt, _MOVING, False)


@njit
def _keep(book, i, stamp, value, dt):
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
def _patience(book, i):
    """s without a sample of IMU i that are no silence."""
    return max(SILENT, SILENT_INTERVALS * book.interval[i])


@njit
def _may_lead(book, j):
    """Whether nothing speaks against IMU j beside the leading one, or it has agreed with it before."""
    return book.known[j] and (book.usual[j, 0] > 0.0 or book.differs[j] == 0)


@njit
def _led(book, i, stamp, value, out_stamps, out):
    """A sample of the leading IMU; how many there are to hand on."""
    if book.fault[i] != Fault.NONE:  # the filter bridges what it does not believe; another IMU is better
        for j in range(len(book.known)):
            if j != i and _may_lead(book, j) and book.fault[j] == Fault.NONE and (
                    stamp - book.newest[j]) * 1e-9 <= _patience(book, j) + _patience(book, i):
                return 0
    else:
        for j in range(len(book.known)):
            if j != i:
                book.mark[j] = book.newest[j]
                _compare(book, j, i)
    book.last[0] = stamp
    _hand_on(book, i, stamp, value, 0, out_stamps, out)
    if book.fault[i] == Fault.NONE:
        _add_others(book, i, stamp, out)
    return 1


@njit
def _hand_on(book, i, stamp, value, row, out_stamps, out):
    """Sample `value` of IMU i as row number `row` of out, with the biases of the first IMU; how many rows there are."""
    out_stamps[row] = stamp
    out[row] = value - book.offset[i]
    return row + 1


@njit
def _add_others(book, i, stamp, out):
    """The mean difference of those that agree with the leading IMU i, weighed by their noise, in row 0 of out."""
    used, certainty = 1, _certainty(book, i)
    for j in range(len(book.known)):
        if j != i and _is_used(book, j, stamp):
            used, certainty = used + 1, certainty + _certainty(book, j)
    for j in range(len(book.known)):
        if j != i and book.held_count[j] > 0.0 and _is_used(book, j, stamp):
            # one that filters before it samples shows less noise than it has
            weight = np.minimum(_certainty(book, j) / certainty, 1.0 / used) / book.held_count[j]
            out[0, :3] += weight[0] * book.held[j, :3]
            out[0, 3:] += weight[1] * book.held[j, 3:]
        book.held[j], book.held_count[j] = 0.0, 0.0


@njit
def _noise(book, i):
    """Noise density squared of specific force and of angular rate (2,), which may have grown just now."""
    return np.maximum(book.noise[i], book.now[i])


@njit
def _certainty(book, i):
    """Inverse of `_noise`, limited where an IMU shows none."""
    return 1.0 / np.maximum(_noise(book, i), 1e-18)


@njit
def _is_used(book, j, stamp):
    """Whether IMU j is averaged with the leading one: it agrees, and is there."""
    at = book.compared_at[j]
    return book.averaged[j] and at != -1 and (stamp - at) * 1e-9 <= _patience(book, j)


@njit
def _followed(book, i, stamp, out_stamps, out):
    """A sample of another IMU than the leading one, believed: it may have to lead from now on."""
    leader, last = book.leader[0], book.last[0]
    if book.mark[i] == -1:
        book.mark[i] = stamp
    _compare(book, i, leader)
    silent, patience = (stamp - book.mark[i]) * 1e-9, FIRST
    if book.kept[leader] > 0:  # what comes in a burst has waited itself
        silent = min(silent, (stamp - book.stamps[leader, (book.kept[leader] - 1) % KEPT]) * 1e-9)
        patience = _patience(book, leader) if _may_lead(book, i) else FIRST
    if last != -1 and not 0 < stamp - last <= book.restart_gap:
        return 0
    if silent > patience:
        _say(book, _ALONE, i, silent, book.fault[leader], 0.0)
        agrees = False
    elif book.returns[i]:
        _say(book, _LEADS if i < leader else _NOISY, i, 0.0, 0.0, 0.0)
        agrees = book.averaged[i]
    else:
        return 0
    book.leader[0], book.known[i], book.known[leader] = i, True, book.newest[leader] != -1
    book.usual[leader] = book.usual[i]
    book.averaged[leader], book.averaged[i], book.differs[i] = agrees, False, 0
    for j in range(len(book.known)):
        agrees, book.mark[j], book.compared[j] = book.averaged[j], book.newest[j], book.kept[j]
        _compare_anew(book, j, 0.0)
        book.averaged[j] = agrees
    count = 0
    for c in range(max(book.kept[i] - KEPT, 0), book.kept[i]):
        if book.stamps[i, c % KEPT] > last:
            count = _hand_on(book, i, book.stamps[i, c % KEPT], book.values[i, c % KEPT], count, out_stamps, out)
    book.last[0] = stamp
    return count


@njit
def _compare_anew(book, j, begin):
    """IMU j is not averaged till a window, which begins at `begin` s and when QUICK has settled, has shown that it
    agrees."""
    book.averaged[j] = book.returns[j] = False
    book.window[j], book.count[j], book.held_count[j], book.compared_at[j] = begin - 4.0 * QUICK, 0.0, 0.0, -1
    book.quick[j], book.held[j] = 0.0, 0.0


@njit
def _compare(book, j, leader):
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
            _compare_anew(book, j, 0.0)
            book.returns[j] = True
        elif abs(book.quick[j, k]) > limit[k]:
            _differs(book, j, k, book.quick[j, k], limit[k])
    if book.window[j] < 0.0:
        book.count[j] = 0.0
    elif book.window[j] >= WINDOW:
        _decide(book, j, leader)


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
    _compare_anew(book, j, WINDOW - SLOW * 2.0**(book.differs[j] - 1))
    _say(book, _DIFFERS, j, k, value, limit)


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
        _say(book, _CHANGED, j, k, mean[k], 0.0)
    book.offset[j] += mean
    book.quick[j, :6] -= mean
    book.known[j] = True
    if agrees:
        book.usual[j] = np.maximum(book.variance[j, :6], 1e-18)
        book.averaged[j] = True
        late = (book.newest[leader] - book.compared_at[j]) * 1e-9
        _say(book, _AVERAGED, j, late, late > _patience(book, j), 0.0)


@njit
def _say(book, code, i, first, second, third):
    """Note a message on IMU i, for `_worded`; the leading IMU and three numbers go with it."""
    row = book.said[min(book.said_count[0], len(book.said) - 1)]
    row[0], row[1], row[2], row[3], row[4], row[5] = code, i, book.leader[0], first, second, third
    book.said_count[0] = min(book.said_count[0] + 1, len(book.said))


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
        faults[source[m], book.fault[source[m]]] += 1
        if book.said_count[0] > 0:
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
        self._book = _book_of(n, values)
        self._notices: list[Notice] = []
        self._faults = np.zeros((n, len(_REASONS)), dtype=np.int64)
        self._out_stamps, self._out = np.zeros(KEPT, dtype=np.int64), np.zeros((KEPT, 6))
        self._origin, self._source = np.zeros(KEPT, dtype=np.int64), np.zeros(1, dtype=np.int64)

    @property
    def leader(self) -> int:
        """Number of the IMU at whose stamps samples are handed on."""
        return int(self._book.leader[0])

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
        self._count(i, int(stamps[0]), int(self._book.fault[i]))
        if self._book.said_count[0]:
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
        for row in self._book.said[:self._book.said_count[0]]:
            self._notices.append(self._worded(int(row[0]), int(row[1]), int(row[2]), row[3:].tolist()))
        self._book.said_count[0] = 0

    def _worded(self, code: int, i: int, leader: int, numbers: list[float]) -> Notice:
        topic, other = self.topics[i], self.topics[leader]
        if code == _ALONE:
            reason = _REASONS[int(numbers[1])]
            why = f'samples not believed: {reason}' if reason else f'no sample for {numbers[0]:.2f} s'
            self.found[self.names[leader]] = 'warning', f'{why}; the samples are those of {topic}'
            return Notice('warning', f'{other}: {why}: the samples of {topic} are used from now on')
        if code == _LEADS:
            self.found.pop(self.names[i], None)
            return Notice('info', f'{topic}: samples are taken at its stamps again, instead of those of {other}')
        if code == _AVERAGED:
            self.found.pop(self.names[i], None)
            offset = self._book.offset[i] - self._book.offset[leader]
            how = (f'agrees with {other}, but comes {numbers[0]:.2f} s later: used only without it' if numbers[1] else
                   f'averaged with {other} from now on')
            return Notice('info', f'{topic}: {how}; it is more by {_listed(offset[:3])} m/s^2 and '
                                  f'{_listed(offset[3:])} rad/s')
        if code == _CHANGED:
            return Notice('warning', f'{topic}: it differs from {other} by another constant than before, '
                                     f'{_component(int(numbers[0]), numbers[1])} more: other biases')
        if code == _DIFFERS:
            text = (f'it differs from {other} by {_component(int(numbers[0]), numbers[1])}, by chance up to '
                    f'{numbers[2]:.2g}: not averaged')
            self.found[self.names[i]] = 'warning', f'{text}, {other} is believed'
            return Notice('warning', f'{topic}: {text}, {other} is believed')
        self.found.pop(self.names[i], None)
        text = f'it has become more than {NOISIER:g} times as noisy, {topic} has not'
        self.found[self.names[leader]] = 'warning', f'{text}; the samples are those of {topic}'
        return Notice('warning', f'{other}: {text}: the samples of {topic} are used from now on')


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
