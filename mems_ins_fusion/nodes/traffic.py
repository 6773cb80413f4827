"""Statistics of the messages on one topic: rate, delay, lost messages, silence."""
from __future__ import annotations

import math
import time
from collections.abc import Callable

from ..samples import SECOND
from .log import SilenceWatch

#: largest step of a publisher's sequence numbers; a larger one means another publisher
_FAR = 10**6


class Traffic(SilenceWatch):
    """A `SilenceWatch` whose messages are counted by `take`, which is called for each message and kept fast.

    count: number of messages so far. lost: number of missing messages, by the publisher's sequence numbers. frame_id,
    stamp (ns): of the newest message. delay: s from the stamp to the processing, NaN before the first message; measured
    for one message a second, to save time. hertz: messages per second, by their stamps. now: the node's clock, ns.
    """

    def __init__(self, patience: float, now: Callable[[], int], period: float = 30.0,
                 clock: Callable[[], float] = time.monotonic):
        super().__init__(patience, period, clock)
        self.lost, self.frame_id, self.stamp, self.delay = 0, '', 0, math.nan
        self.hertz = 0.0
        self._now, self._number, self._missing, self._waited, self._ask = now, 0, 0, 0, True
        self._quickest = 2**63
        self._counted = 0, 0

    def take(self, header, info: dict) -> float:
        """Count a message with this header. Returns its delay relative to the fastest message so far, s. info: rclpy's.
        """
        self.count += 1
        self.stamp = header.stamp.sec * SECOND + header.stamp.nanosec
        number, sent = info['publication_sequence_number'], info['source_timestamp']
        if number:
            if self._number and 1 < number - self._number < _FAR:
                self._missing += number - self._number - 1
            self._number = number
        late = time.time_ns() - sent
        if late < self._quickest:  # the publisher's clock may be another machine's
            self._quickest = late
        waited = late - self._quickest
        if waited > self._waited:
            self._waited = waited
        if self._ask:
            self._ask, self.delay, self.frame_id = False, (self._now() - self.stamp) * 1e-9, header.frame_id
        return waited * 1e-9

    def waited(self, info: dict) -> float:
        """Delay, s, of a message that is not processed yet, relative to the fastest message so far."""
        return (time.time_ns() - info['source_timestamp'] - self._quickest) * 1e-9

    def look(self, publishers: int) -> tuple[int, float]:
        """Called once a second: number of messages lost since the last call, and delay of the slowest one, s.

        publishers: number of publishers of the topic; with several, the sequence numbers are not consecutive.
        """
        missing, waited = self._missing if publishers == 1 else 0, self._waited * 1e-9
        self.lost += missing
        self._missing, self._waited, self._ask = 0, 0, True
        self._count_rate()
        return missing, waited

    def _count_rate(self) -> None:
        """Compute the rate from the stamps since the last call: at five times the speed a recording has its own rates.
        """
        (then, count), self._counted = self._counted, (self.stamp, self.count)
        if self.count == count:
            self.hertz = 0.0
        elif count and self.stamp > then:  # else they have just begun, or their clock was set back
            self.hertz = (self.count - count) / (self.stamp - then) * 1e9

    @property
    def silence(self) -> float:
        """Time since the last message, or since the subscription, s, accurate to a second."""
        return self._clock() - self._since

    @property
    def is_stale(self) -> bool:
        """Whether the topic has been silent for longer than its patience."""
        return self.silence > self._patience
