"""Which events are good, for one live event and for a whole recording alike, and what is said of the others."""
from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.compiled import njit

from ...samples import Fixes, ImuSamples
from ..advance import FORGOTTEN, TOO_LATE
from ..config import FilterConfig
from ..measurements.registry import FIRST_NAMED
from ..memory import Event, Kind
from ..start.start import DATUM_FIXES, first_place

#: what two refusals for the same reason may differ in
_NUMBER = re.compile(r'[-+]?\b(?:nan|inf|\d[\d.]*(?:e[-+]?\d+)?)\b')
#: samples in a row whose stamps do not follow, after which the clock is believed to have jumped
JUMP_COUNT = 5
#: a measurement stamped this much after the newest IMU sample is not of the same clock, s; the kernel looks closer
LATEST = 5.0
#: what `follow` makes of a sample
GOOD, NOT_FINITE, NOT_FOLLOWING, JUMPED = 0, 1, 2, 3


@dataclass(frozen=True)
class Notice:
    """Something a user should know. level: info, warning or error."""

    level: str
    text: str


@njit
def follow(state, stamp, values, restart_gap, step_back, codes):
    """Which IMU samples are numbers and follow each other: codes (n,).

    state (3,) int64: the last good stamp, that of a jump and how many have followed it; kept from call to call, and -1
    at first. stamp (n,) ns. values (n, 6). restart_gap: ns. step_back: ns; a clock that is set back by no more, as NTP
    and PTP do, is waited for: the samples are dropped until their stamps pass the last good one. JUMPED: good, but all
    must begin anew.
    """
    for i in range(len(stamp)):
        total = 0.0
        for j in range(6):
            total += values[i, j]
        if not np.isfinite(total):
            codes[i] = NOT_FINITE
            continue
        if state[0] == -1 or 0 < stamp[i] - state[0] <= restart_gap:
            state[0], state[2] = stamp[i], 0
            codes[i] = GOOD
            continue
        if -step_back <= stamp[i] - state[0] <= 0:
            state[2] = 0
            codes[i] = NOT_FOLLOWING
            continue
        state[2] = state[2] + 1 if state[2] > 0 and stamp[i] > state[1] else 1
        state[1] = stamp[i]
        codes[i] = NOT_FOLLOWING
        if state[2] >= JUMP_COUNT:
            state[0], state[2] = stamp[i], 0
            codes[i] = JUMPED


class Intake:
    """What both ways into the filter share."""

    def __init__(self, config: FilterConfig):
        self.config = config
        self._follow = np.full(3, -1, dtype=np.int64)
        self._last = dict.fromkeys(config.inputs, None)  # stamps of the last good measurement, ns
        self._notices: list[Notice] = []
        self._restart_gap = round(config.imu.restart_gap * 1e9)
        self._step_back = round(config.imu.max_gap * 1e9)
        # the configuration computes these anew each time, which is too slow for each message
        self._latest, self._offsets = config.latest, {kind: config.time_offset_of(kind) for kind in config.inputs}
        self._ahead = dict.fromkeys(config.inputs, (0, 0))  # stamps of the last one ahead, and of the sample before
        #: why the newest measurement that `measured` refused was refused, without numbers
        self.refusal = ''
        #: how much later than the quickest ones the newest message came, s: how long it waited in queues
        self.waited = 0.0

    def notices(self) -> list[Notice]:
        """What has happened since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def say(self, level: str, text: str) -> None:
        self._notices.append(Notice(level, text))

    def topic(self, kind: int) -> str:
        return self.config.settings_of(kind).topic

    def follow(self, stamp: np.ndarray, values: np.ndarray) -> np.ndarray:
        """`follow` for these samples, stamp (n,) ns and values (n, 6); what is wrong is said."""
        codes = np.zeros(len(stamp), dtype=np.int64)
        last = int(self._follow[0])
        follow(self._follow, stamp, values, self._restart_gap, self._step_back, codes)
        flagged = np.flatnonzero(codes)
        if not len(flagged):
            return codes
        topic = self.config.imu.topic
        good = np.where((codes == GOOD) | (codes == JUMPED), np.arange(len(codes)), -1)
        newest = np.maximum.accumulate(good)
        for i in flagged:
            before = int(stamp[newest[i - 1]]) if i > 0 and newest[i - 1] >= 0 else last
            now = int(stamp[i])
            if codes[i] == NOT_FINITE:
                f, w = values[i, :3].tolist(), values[i, 3:].tolist()
                self.say('warning', f'{topic}: linear_acceleration ({f[0]}, {f[1]}, {f[2]}), angular_velocity '
                                    f'({w[0]}, {w[1]}, {w[2]}): sample dropped')
            elif codes[i] == JUMPED:
                self.say('warning', f'{topic}: header.stamp jumped by {(now - before) * 1e-9:+.3f} s and stays there: '
                                    'the filter aligns anew')
            else:
                self.say('warning', f'{topic}: header.stamp {now * 1e-9:.6f} s does not follow {before * 1e-9:.6f} s: '
                                    'sample dropped')
        return codes

    def name(self, kind: int) -> str:
        return self.config.inputs[kind].name

    def measured(self, kind: int, samples, newest: np.ndarray, epoch: int) -> tuple[np.ndarray, np.ndarray]:
        """Records of the good ones among `samples` of one input, in the order of their arrival: indices and records.

        kind: number of the input, `Kind` of one without a name.

        newest (n,): ns, the stamp of the IMU sample before each. epoch: ns, of the filter's time.
        """
        measurement, settings = self.config.inputs[kind], self.config.settings_of(kind)
        records, reasons, warnings = measurement.records(settings, samples)
        offset = self._offsets[kind]
        stamp = samples.stamp - round(offset * 1e9)
        self._refuse_twins(kind, samples.stamp, reasons)
        for i in np.flatnonzero((reasons != '') | (warnings != '')):
            self.say('warning', f'{settings.topic}: {reasons[i] or warnings[i]}')
        good = reasons == ''
        if not good.all():
            self.refusal = _NUMBER.sub('#', reasons[np.flatnonzero(~good)[-1]])
        ahead = (stamp - newest) * 1e-9
        for i in np.flatnonzero(good & ((-ahead > self._latest) | (ahead > LATEST + max(-offset, 0.0)))):
            good[i], self.refusal = False, 'stamped ahead of the IMU' if ahead[i] > 0 else 'too late'
            if ahead[i] > 0:
                self._say_ahead(kind, ahead[i], int(stamp[i]), int(newest[i]))
            else:
                self.say_not_taken(kind, TOO_LATE, int(stamp[i]), int(newest[i]))
        records[:, Event.TIME] = (stamp - epoch) * 1e-9
        if not measurement.is_plain:
            records[:, Event.INPUT] = kind - FIRST_NAMED + 1
            records[:, Event.STATE] = self.config.layout.index(measurement.state)
            records[:, Event.ARM:Event.ARM + 3] = measurement.arm
        return np.flatnonzero(good), records[good]

    def _say_ahead(self, kind: int, ahead: float, stamp: int, newest: int) -> None:
        before, sample = self._ahead[kind]
        self._ahead[kind] = stamp, newest
        why = 'the clocks differ (gnss.time_offset)'
        if sample == newest and stamp > before:  # measurements go on, samples do not
            why = f'nothing has come on {self.config.imu.topic} since'
        self.say('warning', f'{self.topic(kind)}: {self.name(kind)} stamped {ahead:.1f} s after the newest IMU sample: '
                            f'{why}; dropped')

    def _refuse_twins(self, kind: int, stamp: np.ndarray, reasons: np.ndarray) -> None:
        """A stamp that comes twice is a message that came twice."""
        good = np.flatnonzero(reasons == '')
        if not len(good):
            return
        last = -1 if self._last[kind] is None else self._last[kind]
        before = np.concatenate([[last], stamp[good[:-1]]])
        for i in good[stamp[good] == before]:
            reasons[i] = f'header.stamp {stamp[i] * 1e-9:.6f} s came twice: second {self.name(kind)} dropped'
        self._last[kind] = int(stamp[good[-1]])

    def say_not_taken(self, kind: int, answer: int, stamp: int, newest: int) -> None:
        late, why = (newest - stamp) * 1e-9, ''
        if answer == TOO_LATE:
            why = 'later than gnss.max_delay, or the clocks differ (gnss.time_offset)'
            if self.waited > 0.5 * late:
                why = f'it waited {self.waited:.2f} s in queues: the machine is busy'
        elif answer == FORGOTTEN:
            why = f'more than {self.config.event_capacity // 2} measurements have come since'
        if why:
            self.say('warning', f'{self.topic(kind)}: {self.name(kind)} stamped {stamp * 1e-9:.3f} s came {late:.2f} s '
                                f'after the IMU samples of its time: {why}; dropped')


def first_datum(config: FilterConfig, imu: ImuSamples, fixes: Fixes) -> np.ndarray | None:
    """The origin (rad, rad, m) that a live filter would have taken for its local frame; None where no fix is good."""
    if config.datum is not None:
        return config.datum
    order = np.argsort(fixes.received, kind='stable')
    arrival = np.searchsorted(imu.received, fixes.received[order], side='right')
    fixes, newest = fixes.select(order[arrival > 0]), imu.stamp[arrival[arrival > 0] - 1]
    found: list[tuple[float, float, float]] = []
    intake = Intake(config)
    for i in range(len(fixes)):
        used, records = intake.measured(Kind.POSITION, fixes.select(slice(i, i + 1)), newest[i:i + 1], 0)
        found += [tuple(record[[Event.LATITUDE, Event.LONGITUDE, Event.HEIGHT]].tolist()) for record in records]
        if len(found) == DATUM_FIXES:
            break
    return first_place(found) if found else None


def corrected(correctors: list, stamp, values, celsius) -> np.ndarray:
    """`values` (n, 6), sensor axes, without the effects that are declared. stamp (n,) ns, celsius (n,)."""
    if not correctors:
        return values
    force, rate = values[:, :3], values[:, 3:]
    for corrector in correctors:  # contiguous: compiled code is made anew for each layout
        force, rate = corrector(stamp, np.ascontiguousarray(force), np.ascontiguousarray(rate), celsius)
    return np.column_stack([force, rate])
