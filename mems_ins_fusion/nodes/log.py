"""The log of a node, with repeated messages held back."""
from __future__ import annotations

import math
import re
import time
from collections.abc import Callable

#: numbers in any format: lines that differ only in numbers count as equal
_NUMBERS = re.compile(r'\b(nan|inf)\b|[-+]?\d[\d.]*(e[-+]?\d+)?', re.IGNORECASE)
#: s for which a repeated line is held back at first: short enough to be noticed in the log
FIRST_HOLD = 5.0
#: s, longest time for which it is held back; the time doubles with each repetition
LONGEST_HOLD = 80.0


class Throttle:
    """Passes a line on once in `period` seconds, with the number of equal lines held back since.

    Lines that differ only in numbers count as equal. The time for which a repeated line is held back doubles each time,
    up to LONGEST_HOLD, and is reset after no such line has come for that long.
    """

    def __init__(self, period: float, clock: Callable[[], float] = time.monotonic):
        self._period = period
        self._clock = clock
        self._last: dict[str, tuple[float, float, int]] = {}  # when, how long to hold, how many held

    def pass_on(self, text: str) -> str | None:
        """`text` with the number of lines held back before it; None if it is held back itself."""
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
        """Log a line that may come often (level: debug, info, warning or error). Lines that are held back are logged
        with the level debug."""
        text = self._throttle.pass_on(line)
        self.tell('debug' if text is None else level, text or line)

    def tell(self, level: str, line: str) -> None:
        """Log a line that comes seldom. rclpy needs a separate line of source for each severity."""
        if level == 'debug':
            self._logger.debug(line)
        elif level == 'info':
            self._logger.info(line)
        elif level == 'warning':
            self._logger.warning(line)
        else:
            self._logger.error(line)


class SilenceWatch:
    """Notices that a topic is silent: `patience` seconds after the last message, then every `period` seconds.

    The callback of the subscription only increments `count`, as it is called for each message.
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
        """(True, seconds of silence) when the silence is to be reported, (False, seconds) when it has ended, else None.
        """
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
    """Reports that a state has begun, and reports it again every `period` seconds while it lasts, except `quiet`
    states.
    """

    def __init__(self, period: float = 30.0, quiet: tuple[str, ...] = ('fusing',),
                 clock: Callable[[], float] = time.monotonic):
        self._period, self._quiet, self._clock = period, quiet, clock
        self._state: str | None = None
        self._level = None
        self._since = self._said = clock()

    def look(self, state: str, status: str, level=None) -> tuple[float, str | None]:
        """Seconds that `state` has lasted, and the line to log (with the description `status`), or None.

        level: severity of the state; a state is reported again when its level changes.
        """
        now = self._clock()
        changed, self._level = level != self._level, level
        if state != self._state:
            before = f' after {self._state} for {now - self._since:.0f} s' if self._state else ''
            self._state, self._since, self._said = state, now, now
            # the status 'waiting for a fix' contains the state
            return 0.0, f'state: {status}{before}' if status.startswith(state) else f'state: {state}{before} ({status})'
        lasted = now - self._since
        if (state in self._quiet or now - self._said < self._period) and not (changed and lasted > 0.0):
            return lasted, None
        self._said = now
        return lasted, f'state: still {status}, for {lasted:.0f} s' if status.startswith(state) else (
            f'state: still {state}, for {lasted:.0f} s ({status})')
