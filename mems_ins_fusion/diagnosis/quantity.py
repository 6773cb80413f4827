"""What the diagnosis while driving says of one thing, in the words of receivers that calibrate themselves."""
from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from .estimate import Estimate

#: too little has come in to say anything; found, and on trial; proven on what came after; proven, or found, but not any
#: more
INITIALISING, COARSE, FINE, SUSPECT = 'INITIALISING', 'COARSE', 'FINE', 'SUSPECT'
#: of an analysis that has found nothing, and of which quantity that and INITIALISING are said
NOTHING, ALL = 'NOTHING FOUND', 'all'
#: of the filter that drives, where it goes on with what has been found
CHANGED = 'CHANGED'


@dataclass(frozen=True)
class Quantity:
    """What is known of one thing. time: ns, stamp of the newest sample. sets: lines of a params file. better: by
    duration, mean error m without and with it, and of how many outages. text: in words. applied: whether the filter
    that drives is to have it. values: the parameters by name."""

    time: int
    name: str
    state: str
    parameters: dict[str, Estimate]
    sets: tuple[str, ...] = ()
    better: dict[float, tuple[float, float, int]] = field(default_factory=dict)
    text: str = ''
    applied: bool = False
    values: dict = field(default_factory=dict)
    advice: str = ''

    @property
    def said(self) -> tuple:
        """What is news when it changes."""
        return self.name, self.state, self.sets, self.applied


@dataclass(frozen=True)
class Kept:
    """What an earlier drive has proven of a vehicle: the parameters of one effect, and those of the filter that go with
    them."""

    name: str
    parameters: dict[str, Estimate]
    sets: dict


def together(ones: Iterable) -> dict:
    """The parameters of all of these, each with its `sets`: where two set the same one, as the later one has it."""
    return {name: value for one in ones for name, value in one.sets.items()}
