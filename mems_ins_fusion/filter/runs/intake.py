"""Checks of samples and measurements for the live filter and for whole recordings, with messages on invalid ones."""
from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from mems_ins_fusion.compiled import njit

from ...samples import Fixes, ImuSamples
from ..advance import FORGOTTEN, TOO_LATE
from ..config import FilterConfig
from ..memory import Event, Kind
from ..start.start import DATUM_FIXES, first_place

#: number of samples in a row with ascending stamps that do not follow the earlier ones, after which the clock has
#: jumped
JUMP_COUNT = 5
#: s: a measurement whose stamp is later than the newest IMU sample by more has the stamp of another clock. Only against
#: wrong clocks: the kernel applies the limit config.AHEAD
LATEST = 5.0
GOOD, NOT_FINITE, NOT_FOLLOWING, JUMPED = 0, 1, 2, 3  # codes of IMU samples by `follow`
#: codes of measurements that are not used: no valid value, same stamp as the one before, ahead of the IMU, too late
NO_MEASUREMENT, TWIN, STAMPED_AHEAD, STAMPED_LATE = 1, 2, 3, 4


@dataclass(frozen=True)
class Notice:
    """A message to the user. level: info, warning or error."""

    level: str
    text: str


@njit
def follow(state, stamp, values, restart_gap, step_back, codes):
    """Check IMU samples for finite values and ascending stamps; the result is written to codes (n,).

    state (3,) int64: last valid stamp, stamp of the newest sample after a possible jump, and number of such samples;
    kept between calls, -1 at first. stamp (n,) ns. values (n, 6). restart_gap: ns. step_back: ns; after a smaller step
    back of the clock, as by NTP or PTP, samples are dropped until their stamps pass the last valid one. The code JUMPED
    means that the sample is valid, but the filter must restart.
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


@njit(_nrt=False)
def _check_stamps(events, stamp, newest, last, late, epoch, latest, most_ahead, codes):
    """Check the stamps of measurements and write their times to the events. Returns the last valid stamp, ns, and how
    many measurements are not valid.

    events (n, Event.SIZE). stamp (n,) ns. newest (n,): ns, stamp of the last IMU sample before each. last: ns, last
    valid stamp before these; -1: none. late: ns, time offset of the stamps. epoch: ns. latest, most_ahead: s by which a
    measurement may be older and newer than the newest sample. codes (n,), input and output: 0 for a valid measurement.
    """
    flagged = 0
    for i in range(len(events)):
        if codes[i] == 0 and stamp[i] == last:
            codes[i] = TWIN
        elif codes[i] == 0:
            last = stamp[i]
            events[i, Event.TIME] = (stamp[i] - late - epoch) * 1e-9
            ahead = (stamp[i] - late - newest[i]) * 1e-9
            if ahead > most_ahead:
                codes[i] = STAMPED_AHEAD
            elif -ahead > latest:
                codes[i] = STAMPED_LATE
        flagged += codes[i] != 0
    return last, flagged


class Intake:
    """Base class of the live filter and the replay: checks their inputs and collects messages to the user."""

    def __init__(self, config: FilterConfig):
        self.config = config
        self._follow = np.full(3, -1, dtype=np.int64)
        self._last = dict.fromkeys(config.inputs, -1)  # stamp of the last valid measurement of each input, ns; -1: none
        self._notices: list[Notice] = []
        self._restart_gap = round(config.imu.restart_gap * 1e9)
        self._step_back = round(config.imu.max_gap * 1e9)
        # computed once: these properties are too slow for each message
        self._latest, self._offsets = config.latest, {kind: config.time_offset_of(kind) for kind in config.inputs}
        self._of_input = cache(config.of_input)
        # stamp of the last measurement that was ahead of the IMU, and the stamp of the newest IMU sample at that time
        self._ahead = dict.fromkeys(config.inputs, (0, 0))
        #: reason of the latest refusal by `measured`, without numbers
        self.refusal = ''
        #: s that the newest message has waited in queues: its delay minus the smallest delay
        self.waited = 0.0

    def notices(self) -> list[Notice]:
        """Messages since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def say(self, level: str, text: str) -> None:
        self._notices.append(Notice(level, text))

    def topic(self, kind: int) -> str:
        return self.config.settings_of(kind).topic

    def follow(self, stamp: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Codes (n,) of IMU samples, stamp (n,) ns and values (n, 6), with a message for each that is not valid."""
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
                f, w = (', '.join(f'{v:.4g}' for v in part) for part in (values[i, :3], values[i, 3:]))
                self.say('warning', f'{topic}: linear_acceleration ({f}), angular_velocity ({w}): sample dropped')
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
        """Valid measurements among `samples` of one input, in the order of arrival: their indices and events.

        kind: number of the input. newest (n,): ns, stamp of the last IMU sample before each. epoch: ns, time zero of
        the filter.
        """
        measurement, settings, offset = self.config.inputs[kind], self.config.settings_of(kind), self._offsets[kind]
        events, reasons, warnings = measurement.events(settings, samples)
        codes, late = np.zeros(len(events), dtype=np.int64), round(offset * 1e9)
        for i in reasons:
            codes[i] = NO_MEASUREMENT
        stamp = np.array(samples.stamp, dtype=np.int64)
        self._last[kind], flagged = _check_stamps(events, stamp, newest, self._last[kind], late, epoch, self._latest,
                                                 LATEST + max(-offset, 0.0), codes)
        used = np.arange(len(events))
        if flagged or warnings:
            self._explain(kind, codes, stamp, newest, late, reasons, warnings)
            used = np.flatnonzero(codes == 0)
            events = events[used]
        events[:, Event.INPUT:Event.INPUT_END] = self._of_input(kind)
        return used, events

    def _explain(self, kind: int, codes, stamp, newest, late: int, reasons: dict, warnings: dict) -> None:
        """Report each measurement that is not used, or has a warning."""
        topic = self.topic(kind)
        for i in np.flatnonzero(codes == TWIN).tolist():
            reasons[i] = f'header.stamp {stamp[i] * 1e-9:.6f} s came twice: second {self.name(kind)} dropped'
        for i in sorted({*reasons, *warnings}):
            if i in reasons:
                self.refusal = reasons[i]
            self.say('warning', f'{topic}: {reasons.get(i) or warnings[i]}')
        for i in np.flatnonzero((codes == STAMPED_AHEAD) | (codes == STAMPED_LATE)).tolist():
            at, now = int(stamp[i]) - late, int(newest[i])
            if codes[i] == STAMPED_AHEAD:
                self.refusal = 'stamped ahead of the IMU'
                self._say_ahead(kind, (at - now) * 1e-9, at, now)
            else:
                self.refusal = 'too late'
                self.say_not_taken(kind, TOO_LATE, at, now)

    def _say_ahead(self, kind: int, ahead: float, stamp: int, newest: int) -> None:
        before, sample = self._ahead[kind]
        self._ahead[kind] = stamp, newest
        why = 'the clocks differ (gnss.time_offset)'
        if sample == newest and stamp > before:  # measurements go on, samples do not
            why = f'nothing has come on {self.config.imu.topic} since'
        self.say('warning', f'{self.topic(kind)}: {self.name(kind)} stamped {ahead:.1f} s after the newest IMU sample: '
                            f'{why}; dropped')

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
    """Origin (rad, rad, m) of the local frame that a live filter has with these inputs; None without a valid fix."""
    if config.datum is not None:
        return config.datum
    order = np.argsort(fixes.received, kind='stable')
    arrival = np.searchsorted(imu.received, fixes.received[order], side='right')
    there = arrival > 0
    _, events = Intake(config).measured(Kind.POSITION, fixes.select(order[there]), imu.stamp[arrival[there] - 1], 0)
    found = events[:DATUM_FIXES, [Event.LATITUDE, Event.LONGITUDE, Event.HEIGHT]]
    return first_place(found.tolist()) if len(found) else None


def remove_effects(correctors: list, stamp, values, celsius) -> np.ndarray:
    """`values` (n, 6), sensor axes, corrected for the configured effects. stamp (n,) ns, celsius (n,)."""
    if not correctors:
        return values
    force, rate = values[:, :3], values[:, 3:]
    for corrector in correctors:  # contiguous: other layouts would be compiled separately
        force, rate = corrector(stamp, np.ascontiguousarray(force), np.ascontiguousarray(rate), celsius)
    return np.column_stack([force, rate])
