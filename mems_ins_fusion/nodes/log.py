"""What a node tells its user, without flooding."""
from __future__ import annotations

import math
import re
import time
from collections.abc import Callable

#: numbers, whatever their form: two lines that differ only there say the same
_NUMBERS = re.compile(r'\b(nan|inf)\b|[-+]?\d[\d.]*(e[-+]?\d+)?', re.IGNORECASE)
#: s for which a line that comes again is held back at first: who looks at the log now and then sees it
FIRST_HOLD = 5.0
#: s between two of them at most: a line that keeps on coming is let through ever more seldom
LONGEST_HOLD = 80.0


class Throttle:
    """Lets a line through once in `period` seconds; the next one let through tells how many were held back.

    Lines that differ only in their numbers count as one and the same. One that keeps on coming has to wait twice as
    long each time, up to LONGEST_HOLD; it begins anew when it has not come for that long.
    """

    def __init__(self, period: float, clock: Callable[[], float] = time.monotonic):
        self._period = period
        self._clock = clock
        self._last: dict[str, tuple[float, float, int]] = {}  # when, how long to hold, how many held

    def pass_on(self, text: str) -> str | None:
        """`text`, with the number of those held back before; None where it is held back itself."""
        key = _NUMBERS.sub('#', text)
        now = self._clock()
        last, hold, held_back = self._last.get(key, (-math.inf, 0.0, 0))
        if now - last < hold:
            self._last[key] = (last, hold, held_back + 1)
            return None
        again = now - last < hold + LONGEST_HOLD
        self._last[key] = (now, min(2.0 * hold, LONGEST_HOLD) if again else self._period, 0)
        return f'{text} ({held_back} more like this before)' if held_back else text


class Log:
    """The log of a node. `logger` is rclpy's."""

    def __init__(self, logger):
        self._logger, self._throttle = logger, Throttle(FIRST_HOLD)

    def say(self, level: str, line: str) -> None:
        """A line that may come often (debug, info, warning or error); what is held back is for who debugs."""
        text = self._throttle.pass_on(line)
        self.tell('debug' if text is None else level, text or line)

    def tell(self, level: str, line: str) -> None:
        """A line that comes seldom. rclpy wants a line of source of its own for each severity."""
        if level == 'debug':
            self._logger.debug(line)
        elif level == 'info':
            self._logger.info(line)
        elif level == 'warning':
            self._logger.warning(line)
        else:
            self._logger.error(line)


class Watch:
    """Notices that a topic is silent: `patience` seconds after the last message, then every `period` seconds.

    The subscription's callback adds to `count`, nothing else: it is the hot path.
    """

    def __init__(self, patience: float, period: float = 30.0, clock: Callable[[], float] = time.monotonic):
        self.count = 0
        self._patience = patience
        self._period = period
        self._clock = clock
        self._seen = 0
        self._silent = False
        self._restart(clock())

    def check(self) -> tuple[bool, float] | None:
        """(True, seconds of silence) when that is to be said, (False, seconds) when it ended, else None."""
        now = self._clock()
        if self.count != self._seen:
            silence = now - self._since
            ended, self._silent = self._silent, False
            self._seen = self.count
            self._restart(now)
            return (False, silence) if ended else None
        if now < self._due:
            return None
        self._silent = True
        self._due = now + self._period
        return True, now - self._since

    def _restart(self, now):
        self._since = now
        self._due = now + self._patience


class StateLog:
    """Says that a state began, and says it again every `period` seconds while it lasts, but for `quiet` states."""

    def __init__(self, period: float = 30.0, quiet: tuple[str, ...] = ('fusing',),
                 clock: Callable[[], float] = time.monotonic):
        self._period, self._quiet, self._clock = period, quiet, clock
        self._state: str | None = None
        self._level = None
        self._since = self._said = clock()

    def look(self, state: str, status: str, level=None) -> tuple[float, str | None]:
        """Seconds that `state` has lasted, and the line to log, with more words on it (`status`), or None.

        level: how bad that is; the same state is said again where this changes.
        """
        now = self._clock()
        changed, self._level = level != self._level, level
        if state != self._state:
            before = f' after {self._state} for {now - self._since:.0f} s' if self._state else ''
            self._state, self._since, self._said = state, now, now
            return 0.0, f'state: {state}{before} ({status})'
        lasted = now - self._since
        if (state in self._quiet or now - self._said < self._period) and not (changed and lasted > 0.0):
            return lasted, None
        self._said = now
        return lasted, f'state: still {state}, for {lasted:.0f} s ({status})'
