"""Which devices send: what standard messages tell of an IMU and of a receiver, so that another one is told from it."""
from __future__ import annotations

#: names of the sensors
IMU, GNSS = 'imu', 'gnss'
#: s of stamps over which a rate is counted at least
COUNTED = 5.0
#: and messages
MESSAGES = 5
#: s from one message to the next, which is a clock that was set, or a driver that was stopped
GAP = 60.0
#: ratio of two rates from which on they are different ones: clocks and lost messages make less
OTHER_RATE = 1.2


class Identity:
    """What the messages of each of `sensors`, names, have told since the start."""

    def __init__(self, sensors: tuple[str, ...]):
        self._sensors = sensors
        self._first: dict[str, tuple[int, dict]] = {}  # stamp (ns) of the first message that counts, and what it told
        self._newest, self._counts = dict.fromkeys(sensors, 0), dict.fromkeys(sensors, 0)
        self._complete: dict[str, dict] = {}

    @property
    def known(self) -> dict[str, dict] | None:
        """By sensor what its messages tell, `rate` (Hz) among it; None until that is known of each."""
        return self._complete if len(self._complete) == len(self._sensors) else None

    def lacks(self, sensor: str) -> bool:
        """Whether more of its messages are asked for."""
        return sensor not in self._complete

    def add(self, sensor: str, stamp: int, told: dict) -> None:
        """A message of `sensor`, one of those that it lacks; stamp: ns. told: what does not change from
        one message of a device to the next."""
        first, was_told = self._first.setdefault(sensor, (stamp, told))
        seconds, since = (stamp - first) * 1e-9, (stamp - self._newest[sensor]) * 1e-9
        self._newest[sensor] = stamp
        if was_told != told or not 0.0 <= since <= GAP:  # not of the messages before
            self._first[sensor], self._counts[sensor] = (stamp, told), 0
        elif seconds >= COUNTED and self._counts[sensor] >= MESSAGES:
            self._complete[sensor] = {**told, 'rate': self._counts[sensor] / seconds}
        self._counts[sensor] += 1


def differences(before: dict[str, dict], now: dict[str, dict]) -> list[str]:
    """In words, what `now` tells of the sensors otherwise than `before`; what only one of them knows says nothing."""
    return [f'{sensor}: {what} {now[sensor][what]:.4g} (before: {value:.4g})' if what == 'rate' else
            f'{sensor}: {what} {now[sensor][what]!r} (before: {value!r})'
            for sensor, told in before.items() for what, value in told.items()
            if what in now.get(sensor, {}) and _other(what, value, now[sensor][what])]


def _other(what: str, a, b) -> bool:
    return max(a, b) > OTHER_RATE * min(a, b) if what == 'rate' else a != b
