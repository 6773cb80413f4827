"""Several IMUs combined to one stream of samples for the filter: live, one message at a time, and of a recording.

One of them leads (`imu_lead`): the first in the order of preference (`imu_topic`, then those of `inputs`) that gives
valid samples. The filter gets samples with its stamps.

Another IMU only replaces a leading one that fails, until both have agreed while the vehicle moved, or differ although
their constant difference is known (`imu_comparison`). Where they differ, the samples are the mean of both and come with
the difference: the filter finds out which one is right (`trust/imu_share.py`); of more than two IMUs it gets the
difference of the first one that differs. Where they have agreed, the difference to the leading IMU, times its
weight (one half for two IMUs with the same noise), is added to the samples. The difference is computed at the stamp of
the other IMU, with the leading one interpolated, so that the average is not delayed. The mean of the difference over
COMPARED_WINDOW is subtracted: the biases in the samples are always those of the first IMU, and do not jump when an IMU
fails or returns.
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
from .imu_lead import REASONS, take_all
from .imu_memory import ALONE, AVERAGED, CHANGED, DIFFERS, KEPT_SAMPLES, LEADS, NOISIER, book_of
from .intake import Notice
from .tally import Tally


class Imus:
    """The IMUs of the checked parameters `values` as one stream. The IMU of `imu_topic` has the number 0, those of
    `inputs` are numbered from 1."""

    def __init__(self, values: dict):
        named = imus(values)
        self.settings: tuple[InertialSettings, ...] = tuple(one.settings(values) for one in named)
        self.names = ('imu', *(one.name for one in named))
        self.topics = (values['imu_topic'], *(settings.topic for settings in self.settings))
        self.tallies = {name: Tally() for name in self.names}
        #: by name, what is wrong with an IMU now: level and text
        self.found: dict[str, tuple[str, str]] = {}
        # functions that convert samples to the place of the first IMU; None for an IMU without a lever arm
        self._arms = [AccelerometerLeverArm().corrector({'imu.lever_arm': settings.arm},
                                                        mounting(values['imu.mounting_rpy']))
                      for settings in self.settings]
        n = len(self.names)
        self._book = book_of(n, values)
        self._notices: list[Notice] = []
        self._faults = np.zeros((n, len(REASONS)), dtype=np.int64)
        self._out_stamps, self._out = np.zeros(KEPT_SAMPLES, dtype=np.int64), np.zeros((KEPT_SAMPLES, 12))
        self._origin, self._source = np.zeros(KEPT_SAMPLES, dtype=np.int64), np.zeros(1, dtype=np.int64)

    @property
    def leader(self) -> int:
        """Number of the IMU at whose stamps samples are handed on."""
        return int(self._book.leader[0])

    def notices(self) -> list[Notice]:
        """Messages to the user since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def prepared(self, i: int, stamp: np.ndarray, force: np.ndarray, rate: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray]:
        """Messages of IMU i converted to the clock, axes, place and units of the first IMU.

        stamp (n,): ns. force, rate (n, 3): in sensor axes and the units of the messages (of the first IMU: SI). Returns
        stamps (n,), ns, and samples (n, 6): specific force, m/s^2, and angular rate, rad/s.
        """
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
        """Take one message of IMU i (arguments as for `prepared`). Returns the samples to hand on: stamp, six numbers,
        and six of their difference (`ImuSamples.difference`).
        """
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
        """Compile or load the compiled code now, so that the first message is not delayed."""
        take_all(self._book, self._source[:0], self._origin[:0], self._out[:0, :6].copy(), 0, self._out_stamps,
                 self._out, self._origin, self._faults, 0)

    def _count(self, i: int, stamp: int, fault: int) -> None:
        tally = self.tallies[self.names[i]]
        if fault:
            tally.refuse(stamp, REASONS[fault])
        else:
            tally.use(math.nan)

    def of_recording(self, imu: ImuSamples, others: dict[str, ImuSamples]) -> ImuSamples:
        """All samples of a recording as one stream, without temperature.

        imu: samples of imu_topic, SI. others: samples of the other IMUs by name, in the units of their messages.
        """
        sources = [imu, *(others[name] for name in self.names[1:])]
        ready = [self.prepared(i, one.stamp, one.specific_force, one.angular_rate) for i, one in enumerate(sources)]
        source = np.repeat(np.arange(len(sources)), [len(one) for one in sources])
        received = np.concatenate([one.received for one in sources])
        order = np.lexsort((source, received))
        stamp, values = np.concatenate([one[0] for one in ready])[order], np.vstack([one[1] for one in ready])[order]
        within = np.concatenate([np.arange(len(one)) for one in sources])[order]
        source, received = source[order], received[order]
        room = len(source) + KEPT_SAMPLES
        out_stamps, out, origin = np.zeros(room, np.int64), np.zeros((room, 12)), np.zeros(room, np.int64)
        faults, upto, done = self._faults, 0, 0
        while upto < len(source):
            upto, done = take_all(self._book, source, stamp, values, upto, out_stamps, out, origin, faults, done)
            self._tell()
        for i, reason in np.argwhere(faults[:, 1:]):
            self._notices.append(Notice('warning', f'{self.topics[i]}: {faults[i, reason + 1]} samples rejected: '
                                                   f'{REASONS[reason + 1]}'))
        origin = origin[:done]
        orientation = None
        if imu.orientation is not None:
            mine = (source[origin] == 0) & (stamp[origin] == out_stamps[:done])
            orientation = np.where(mine[:, None], imu.orientation[np.where(mine, within[origin], 0)], np.nan)
        return ImuSamples(out_stamps[:done], received[origin], out[:done, :3].copy(), out[:done, 3:6].copy(),
                          orientation, difference=out[:done, 6:].copy())

    def _tell(self) -> None:
        for row in self._book.said[:self._book.said_count[0]]:
            self._notices.append(self._worded(int(row[0]), int(row[1]), int(row[2]), row[3:].tolist()))
        self._book.said_count[0] = 0

    def _worded(self, code: int, i: int, leader: int, numbers: list[float]) -> Notice:
        topic, other = self.topics[i], self.topics[leader]
        if code == ALONE:
            reason = REASONS[int(numbers[1])]
            why = f'samples rejected: {reason}' if reason else f'no sample for {numbers[0]:.2f} s'
            self.found[self.names[leader]] = 'warning', f'{why}; the samples are those of {topic}'
            return Notice('warning', f'{other}: {why}: the samples of {topic} are used from now on')
        if code == LEADS:
            self.found.pop(self.names[i], None)
            return Notice('info', f'{topic}: leads again, samples are taken at its stamps instead of those of {other}')
        if code == AVERAGED:
            self.found.pop(self.names[i], None)
            offset = self._book.offset[i] - self._book.offset[leader]
            how = (f'agrees with {other}, but comes {numbers[0]:.2f} s later: used only without it' if numbers[1] else
                   f'averaged with {other} from now on')
            return Notice('info', f'{topic}: {how}; its constant difference is {_listed(offset[:3])} m/s^2 and '
                                  f'{_listed(offset[3:])} rad/s')
        if code == CHANGED:
            return Notice('warning', f'{topic}: its constant difference to {other} has changed by '
                                     f'{_component(int(numbers[0]), numbers[1])}: its biases have changed')
        if code == DIFFERS:
            text = (f'it differs from {other} by {_component(int(numbers[0]), numbers[1])}, noise explains '
                    f'{numbers[2]:.2g}: not averaged, ')
            text += ('which one is right is what fixes, constraints and standstills show' if self._book.differing[i]
                     else f'{other} is used alone')
            self.found[self.names[i]] = 'warning', text
            return Notice('warning', f'{topic}: {text}')
        self.found.pop(self.names[i], None)
        text = f'it has become more than {NOISIER:g} times as noisy, {topic} has not'
        self.found[self.names[leader]] = 'warning', f'{text}; the samples are those of {topic}'
        return Notice('warning', f'{other}: {text}: the samples of {topic} are used from now on')


def as_one(recording: Recording, values: dict) -> tuple[Recording, list[str]]:
    """`recording` with the samples of all IMUs in the checked parameters `values` as one stream, and the warnings.

    Samples of imu_topic are in SI units. With a single IMU the recording is returned unchanged.
    """
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
    """`vectors` (n, 3) rotated by `rotation` (3, 3). Written out, so that one sample gives the same bits as many."""
    return np.stack([row[0] * vectors[:, 0] + row[1] * vectors[:, 1] + row[2] * vectors[:, 2] for row in rotation],
                    axis=1)
