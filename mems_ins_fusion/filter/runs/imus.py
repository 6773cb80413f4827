"""Several IMUs made one stream of samples, before the filter: live, one message at a time, and of a recording.

One of them leads (`imu_lead`): the first in the order of preference (`imu_topic`, then those of `inputs`) that gives
samples which can be believed. The filter is fed at its stamps.

Another IMU is a fallback and no more until it has agreed with the leading one while the vehicle moved
(`imu_comparison`). From then on half of their difference (of two that are equally noisy) is added, taken at the stamp
of the other between two samples of the leading one, so that what both measure is not late. Its mean over WINDOW is
taken out: to the filter the biases are those of the first one whoever leads, and one that comes or goes is no jump.
"""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...effects.accelerometer_lever_arm import AccelerometerLeverArm
from ...navigation.frames import mounting
from ...samples import NO_SAMPLES, ImuSamples, Recording
from ..measurements.inertial import InertialSettings
from ..measurements.registry import imus
from .imu_comparison import NOISIER
from .imu_lead import REASONS, take_all
from .imu_memory import ALONE, AVERAGED, CHANGED, DIFFERS, KEPT, LEADS, book_of
from .intake import Notice
from .tally import Tally


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
        # what an IMU beside the first would measure there; None of one that is there
        self._arms = [AccelerometerLeverArm().corrector({'imu.lever_arm': settings.arm},
                                                        mounting(values['imu.mounting_rpy']))
                      for settings in self.settings]
        n = len(self.names)
        self._book = book_of(n, values)
        self._notices: list[Notice] = []
        self._faults = np.zeros((n, len(REASONS)), dtype=np.int64)
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
        _, count = take_all(self._book, self._source, stamps, values, 0, self._out_stamps, self._out, self._origin,
                            self._faults, 0)
        self._count(i, int(stamps[0]), int(self._book.fault[i]))
        if self._book.said_count[0]:
            self._tell()
        return [(int(self._out_stamps[row]), tuple(self._out[row].tolist())) for row in range(count)]

    def warm_up(self) -> None:
        """Compile or load what is compiled now, so that the first message is not late."""
        take_all(self._book, self._source[:0], self._origin[:0], self._out[:0], 0, self._out_stamps, self._out,
                 self._origin, self._faults, 0)

    def _count(self, i: int, stamp: int, fault: int) -> None:
        tally = self.tallies[self.names[i]]
        if fault:
            tally.refuse(stamp, REASONS[fault])
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
            upto, done = take_all(self._book, source, stamp, values, upto, out_stamps, out, origin, faults, done)
            self._tell()
        for i, reason in np.argwhere(faults[:, 1:]):
            self._notices.append(Notice('warning', f'{self.topics[i]}: {faults[i, reason + 1]} samples not believed: '
                                                   f'{REASONS[reason + 1]}'))
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
        if code == ALONE:
            reason = REASONS[int(numbers[1])]
            why = f'samples not believed: {reason}' if reason else f'no sample for {numbers[0]:.2f} s'
            self.found[self.names[leader]] = 'warning', f'{why}; the samples are those of {topic}'
            return Notice('warning', f'{other}: {why}: the samples of {topic} are used from now on')
        if code == LEADS:
            self.found.pop(self.names[i], None)
            return Notice('info', f'{topic}: samples are taken at its stamps again, instead of those of {other}')
        if code == AVERAGED:
            self.found.pop(self.names[i], None)
            offset = self._book.offset[i] - self._book.offset[leader]
            how = (f'agrees with {other}, but comes {numbers[0]:.2f} s later: used only without it' if numbers[1] else
                   f'averaged with {other} from now on')
            return Notice('info', f'{topic}: {how}; it is more by {_listed(offset[:3])} m/s^2 and '
                                  f'{_listed(offset[3:])} rad/s')
        if code == CHANGED:
            return Notice('warning', f'{topic}: it differs from {other} by another constant than before, '
                                     f'{_component(int(numbers[0]), numbers[1])} more: other biases')
        if code == DIFFERS:
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
