"""One block of lines in the log soon after the start: the inputs, their rates, and whether they fit the parameters."""
from __future__ import annotations

import math
import time
from collections.abc import Sequence
from statistics import median

import numpy as np

from ..filter.config import AHEAD
from ..filter.start.plausibility import is_in_g, why_not_gravity
from ..navigation.earth import STANDARD_GRAVITY
from ..navigation.frames import rotation_from_rpy
from .inputs import Input

#: s after the first sample at which the block is logged, if a fix has come by then
AFTER_SAMPLE = 5.0
#: s after the start at which it is logged without a fix, or without any sample: then once more when these have come
AT_THE_LATEST = 12.0
#: s: stamps that differ more from the node's clock are of another clock
_OTHER_CLOCK = 1.0
#: s, smallest age of the stamp of a fix relative to the newest sample: below it, the fix has the stamp of another
#: clock, as samples are not delayed by so much
_NEWER = -0.1
#: m/s^2 by which the mean specific force may differ from gravity: braking, a bias
_GRAVITY = 1.5
#: m/s^2, largest mean specific force over a second of an IMU that delivers the acceleration alone: braking. Hard
#: braking is more, but seldom when a node has just been started
_WITHOUT_GRAVITY = 4.0
#: rad by which its direction may differ from the vertical: a slope, a turn
_TILT = math.radians(15.0)


class Preflight:
    """Reports the inputs once, and before that, once, that no sample comes. inputs: of the node, the IMU and the fixes
    first."""

    def __init__(self, inputs: Sequence[Input], values: dict):
        self._inputs, self._values = inputs, values
        self._began, self._sampled = time.monotonic(), None
        self._ages: list[float] = []  # s, from the stamp of each fix to that of the newest sample when it came
        self._has_position = False
        self._done = self._said_silent = False

    def add_fix(self, stamp: int, has_position: bool) -> None:
        """A message of the receiver with this stamp, ns, has come. has_position: by its status and its numbers."""
        self._has_position |= has_position
        imu = self._inputs[0].traffic
        if imu.count and not self._done:
            self._ages.append((imu.stamp - stamp) * 1e-9)

    def look(self, force: np.ndarray | None) -> tuple[str, str] | None:
        """Level and text. force: (3,) mean specific force of the last second, m/s^2, sensor axes."""
        now, (imu, fix) = time.monotonic(), self._inputs[:2]
        if self._sampled is None and imu.traffic.count:
            self._sampled = now
        late = now - self._began > AT_THE_LATEST
        ripe = self._sampled is not None and now - self._sampled > AFTER_SAMPLE and (fix.traffic.count or late)
        silent = self._sampled is None and late and not self._said_silent
        if self._done or not (ripe or silent):
            return None
        self._done, self._said_silent = bool(ripe), True
        lines = [(f'{i.topic_name} ({i.name})', *self._input(i)) for i in self._inputs]
        if force is not None:
            lines.append(('units', *_units(force, self._values['mechanization'])))
            if abs(np.linalg.norm(force) - STANDARD_GRAVITY) < _GRAVITY:  # by gravity alone
                lines.append(('mounting', *self._mounting(force)))
        lines.append(('clocks', *self._clocks()))
        width = max(len(line[0]) for line in lines)
        text = '\n'.join(f'  {what:{width}s}  {seen}: {advice or "fine"}' for what, seen, advice in lines)
        wrong = sum(bool(advice) for *_, advice in lines)
        return ('warning' if wrong else 'info',
                f'what comes in ({f"{wrong} to look at" if wrong else "all fine"}):\n{text}')

    def _input(self, source: Input) -> tuple[str, str]:
        traffic = source.traffic
        if not traffic.count:
            return source.kind, f'no message: {source.why_silent()}'
        seen = (f"{source.kind.rpartition('/')[2]}, {traffic.hertz:.3g} Hz, frame '{traffic.frame_id}', "
                f'stamps {traffic.delay:.2g} s old')
        if (publishers := source.publishers()) > 1:
            return seen, f'{publishers} publishers on this topic, whose messages are mixed: stop all but one'
        if source.name == 'imu' and traffic.hertz < 20.0:
            return seen, 'an IMU needs 20 Hz or more'
        if source.name == 'fix' and not self._has_position:
            return seen, 'the receiver has no position yet (status -1, or NaN)'
        return seen, source.qos_problem()

    def _mounting(self, force) -> tuple[str, str]:
        up = rotation_from_rpy(*self._values['imu.mounting_rpy'])[2] @ force / np.linalg.norm(force)
        tilt = math.acos(max(-1.0, min(1.0, float(up))))
        return (f'specific force {math.degrees(tilt):.0f} deg from the vertical (up to {math.degrees(_TILT):.0f} by '
                'slopes and turns)', 'set imu.mounting_rpy (`configure` finds it)' if tilt > _TILT else '')

    def _clocks(self) -> tuple[str, str]:
        if not self._ages:
            return 'nothing to compare', 'no samples, or no fixes'
        # stamps are compared with stamps: the clock of this machine differs from that of a recording that is played
        # fast
        age, offset = median(self._ages), self._values['gnss.time_offset']
        seen = f"stamps of the fixes are {_older(age)} than the IMU's when they arrive"
        if offset:
            seen += f', {_older(age + offset)} with gnss.time_offset {offset:g} s'
            if not -AHEAD - max(-offset, 0.0) < age + offset < self._values['gnss.max_delay'] + max(offset, 0.0):
                return seen, 'such fixes are refused: gnss.time_offset is not that of these clocks, or wrong in sign'
        elif not _NEWER < age < self._values['gnss.max_delay']:
            return seen, 'the clocks differ: set gnss.time_offset (`configure` finds it), or synchronize them'
        behind = self._inputs[0].traffic.delay
        if abs(behind) > _OTHER_CLOCK:
            seen += f"; all are {abs(behind):.3g} s {'behind' if behind > 0 else 'ahead of'} the node's own clock"
            if self._values['predict_to_now']:
                return seen, 'predict_to_now needs stamps of the node\'s clock (use_sim_time with a recording)'
        return seen, ''


def _older(seconds: float) -> str:
    return f"{abs(seconds):.3g} s {'older' if seconds >= 0.0 else 'newer'}"


def _units(force, mechanization: str) -> tuple[str, str]:
    size = float(np.linalg.norm(force))
    level = mechanization == 'planar'
    fine = abs(size - STANDARD_GRAVITY) < _GRAVITY or level and size < _WITHOUT_GRAVITY and not is_in_g(size, level)
    return f'linear_acceleration is {size:.2f} m/s^2', '' if fine else why_not_gravity(size, level)
