"""A remark on a recording, as the bag checker makes them."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

INFO, WARNING, ERROR = 'info', 'warning', 'error'
#: standard deviations by which a number has to differ for a remark: by chance one in 16 000 does
SURE = 4.0


@dataclass(frozen=True)
class Remark:
    """One remark. severity: info, warning or error (the recording gives no sensible result as it is).

    topic: imu, gnss, temperature, speed, velocity or heading, or imu/gnss if it concerns both. values: the numbers in
    the message, SI. settings: names of the parameters that should have other values.
    """

    severity: str
    topic: str
    message: str
    values: dict = field(default_factory=dict)
    settings: tuple[str, ...] = ()


def checked_text(remark: Remark, topics: Mapping[str, str]) -> str:
    """A remark with the topic it is about, which it names itself or which `topics` has for `imu`, `gnss` and
    `temperature`."""
    names = remark.topic if remark.topic.startswith('/') else ' and '.join(
        topics.get(part) or part for part in remark.topic.split('/'))
    return f'{names}: {remark.message}'


def count_of(number: int, thing: str) -> str:
    """`number` of `thing` in words: 1 gap, 2 gaps."""
    return f'{number} {thing}' if number == 1 else f'{number} {thing}s'


def time_in_words(seconds: float) -> str:
    """`seconds` with three digits, in the largest of days, hours and seconds of which there are two: 12.5 s, 3100 days.
    """
    name, per = next(((name, per) for name, per in (('days', 86400.0), ('h', 3600.0)) if abs(seconds) >= 2.0 * per),
                     ('s', 1.0))
    return f'{float(f"{seconds / per:.3g}"):g} {name}'
