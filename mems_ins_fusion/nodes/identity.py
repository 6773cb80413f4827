"""Which IMU and which receiver send: what their messages tell of them, so that another device is recognised."""
from __future__ import annotations

#: names of the sensors
IMU, GNSS = 'imu', 'gnss'
#: s, a rate is measured over at least this long
COUNTED = 5.0
#: and over this many messages
MESSAGES = 5
#: s, a longer step from one message to the next is a clock that was set, or a driver that was stopped
GAP = 60.0
#: rates with a larger ratio are different: errors of clocks and lost messages make less
OTHER_RATE = 1.2


class Identity:
    """What the messages of each of `sensors`, by name, have told of their devices since the start."""

    def __init__(self, sensors: tuple[str, ...]):
        self._sensors = sensors
        self._first: dict[str, tuple[int, dict]] = {}  # stamp (ns) of the first message that counts, and its properties
        self._newest, self._counts = dict.fromkeys(sensors, 0), dict.fromkeys(sensors, 0)
        self._complete: dict[str, dict] = {}

    @property
    def known(self) -> dict[str, dict] | None:
        """By sensor what its messages tell, `rate` (Hz) among it; None until that is known of each."""
        return self._complete if len(self._complete) == len(self._sensors) else None

    def is_unknown(self, sensor: str) -> bool:
        """Whether more of its messages are needed."""
        return sensor not in self._complete

    def add(self, sensor: str, stamp: int, properties: dict) -> None:
        """A message of a `sensor` that is unknown; stamp: ns. properties: what does not change from one message of a
        device to the next."""
        first, known = self._first.setdefault(sensor, (stamp, properties))
        seconds, since = (stamp - first) * 1e-9, (stamp - self._newest[sensor]) * 1e-9
        self._newest[sensor] = stamp
        if known != properties or not 0.0 <= since <= GAP:  # another device, or another clock: begin again
            self._first[sensor], self._counts[sensor] = (stamp, properties), 0
        elif seconds >= COUNTED and self._counts[sensor] >= MESSAGES:
            self._complete[sensor] = {**properties, 'rate': self._counts[sensor] / seconds}
        self._counts[sensor] += 1


def differences(before: dict[str, dict], now: dict[str, dict]) -> list[str]:
    """What differs between the devices of `before` and `now`, in words; of properties that both tell."""
    said = []
    for sensor, properties in before.items():
        for name in (n for n in properties if n in now.get(sensor, {})):
            old, new = properties[name], now[sensor][name]
            if name == 'rate' and max(old, new) > OTHER_RATE * min(old, new):
                said.append(f'{sensor}: {name} {new:.4g} (before: {old:.4g})')
            elif name != 'rate' and old != new:
                said.append(f'{sensor}: {name} {new!r} (before: {old!r})')
    return said
