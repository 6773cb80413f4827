"""How the messages of one topic come: how often, how late, whether some are lost, and since when there are none."""
from __future__ import annotations

import math
import time
from collections.abc import Callable

from ..samples import SECOND
from .log import Watch

#: between two numbers of a publisher further apart than this, it is another publisher
_FAR = 10**6


class Traffic(Watch):
    """A `Watch` whose messages are counted by `take`, the hot path.

    count: messages so far. lost: how many are missing between those that came, by the publisher's own numbers.
    frame_id, stamp (ns): of the newest message. delay: s from the stamp to when a message was taken, NaN before the
    first; of one message a second, as that of the hot path costs. hertz: messages a second, by their stamps. now: the
    node's clock, ns.
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
        """A message with this header came; how much later than the quickest one so far, s. info: rclpy's."""
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
        """How much later than the quickest one so far a message that is not taken yet has come, s."""
        return (time.time_ns() - info['source_timestamp'] - self._quickest) * 1e-9

    def look(self, publishers: int) -> tuple[int, float]:
        """Once a second: how many messages were lost since the last call, and how late the slowest was, s.

        publishers: of the topic; the numbers of several do not follow each other.
        """
        missing, waited = self._missing if publishers == 1 else 0, self._waited * 1e-9
        self.lost += missing
        self._missing, self._waited, self._ask = 0, 0, True
        self._count_rate()
        return missing, waited

    def _count_rate(self) -> None:
        """Of the messages since the last call: a recording that is played five times as fast has its own rates."""
        (then, count), self._counted = self._counted, (self.stamp, self.count)
        if self.count == count:
            self.hertz = 0.0
        elif count and self.stamp > then:  # else they have just begun, or their clock was set back
            self.hertz = (self.count - count) / (self.stamp - then) * 1e9

    @property
    def silence(self) -> float:
        """How long ago the last message came, or the topic was subscribed, s: to a second."""
        return self._clock() - self._since

    @property
    def is_stale(self) -> bool:
        """Whether there is nothing for longer than can be."""
        return self.silence > self._patience
