"""Recognition of the IMU and the receiver by properties of their messages, so that another device is noticed."""
from __future__ import annotations

#: names of the sensors
IMU, GNSS = 'imu', 'gnss'
#: s, shortest time over which a rate is measured
COUNTED = 5.0
#: smallest number of messages over which a rate is measured
MESSAGES = 5
#: s, longest step of the stamps; a longer one means that a clock was set or a driver was stopped
GAP = 60.0
#: ratio of two rates above which they are different: errors of clocks and lost messages cause less
OTHER_RATE = 1.2


class Identity:
    """Properties of the devices of each of `sensors`, by name, from their messages since the start."""

    def __init__(self, sensors: tuple[str, ...]):
        self._sensors = sensors
        self._first: dict[str, tuple[int, dict]] = {}  # stamp (ns) of the first message that counts, and its properties
        self._newest, self._counts = dict.fromkeys(sensors, 0), dict.fromkeys(sensors, 0)
        self._complete: dict[str, dict] = {}

    @property
    def known(self) -> dict[str, dict] | None:
        """By sensor the properties of its device, including `rate` (Hz); None until they are known for all sensors."""
        return self._complete if len(self._complete) == len(self._sensors) else None

    def is_unknown(self, sensor: str) -> bool:
        """Whether more messages of `sensor` are needed."""
        return sensor not in self._complete

    def add(self, sensor: str, stamp: int, properties: dict) -> None:
        """Take a message of a `sensor` that is not known yet. stamp: ns. properties: those that are the same in all
        messages of a device."""
        first, known = self._first.setdefault(sensor, (stamp, properties))
        seconds, since = (stamp - first) * 1e-9, (stamp - self._newest[sensor]) * 1e-9
        self._newest[sensor] = stamp
        if known != properties or not 0.0 <= since <= GAP:  # another device, or another clock: begin again
            self._first[sensor], self._counts[sensor] = (stamp, properties), 0
        elif seconds >= COUNTED and self._counts[sensor] >= MESSAGES:
            self._complete[sensor] = {**properties, 'rate': self._counts[sensor] / seconds}
        self._counts[sensor] += 1


def differences(before: dict[str, dict], now: dict[str, dict]) -> list[str]:
    """Differences between the devices of `before` and `now`, in words, for properties that both have."""
    said = []
    for sensor, properties in before.items():
        for name in (n for n in properties if n in now.get(sensor, {})):
            old, new = properties[name], now[sensor][name]
            if name == 'rate' and max(old, new) > OTHER_RATE * min(old, new):
                said.append(f'{sensor}: {name} {new:.4g} (before: {old:.4g})')
            elif name != 'rate' and old != new:
                said.append(f'{sensor}: {name} {new!r} (before: {old!r})')
    return said
