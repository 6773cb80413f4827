"""What the diagnosis while driving says of one thing, in the words of receivers that calibrate themselves."""
from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from ..effects.registry import effect_called
from .estimate import Estimate

INITIALISING, COARSE, FINE, SUSPECT = 'INITIALISING', 'COARSE', 'FINE', 'SUSPECT'
#: for those who have not read of them
MEANING = {INITIALISING: 'too few samples yet', COARSE: 'found, being tested', FINE: 'proven by what came after',
           SUSPECT: 'not certain any more'}
#: the same where the parameters are as given
AS_GIVEN = {INITIALISING: MEANING[INITIALISING], COARSE: 'as given, as far as is seen', FINE: 'right as given'}
#: of an analysis that has found nothing, and of which quantity that and INITIALISING are said
NOTHING, ALL = 'NOTHING FOUND', 'all'
#: of the filter that drives, where it goes on with what has been found
CHANGED = 'CHANGED'
#: s, a year: a value that nobody has seen for so long may have become any other that would surprise nobody
ANOTHER = 365.25 * 86_400.0


@dataclass(frozen=True)
class Quantity:
    """What is known of one thing. time: ns, stamp of the newest sample. sets: lines of a params file. better: by
    duration, mean error m without and with it, and of how many outages. Without lines the parameters are as given, as
    far as is seen, and `parameters` what may be left. text: in words. applied: whether the filter
    that drives is to have it. kept: it for the next drive, where it is applied."""

    time: int
    name: str
    state: str
    parameters: dict[str, Estimate]
    sets: tuple[str, ...] = ()
    better: dict[float, tuple[float, float, int]] = field(default_factory=dict)
    text: str = ''
    applied: bool = False
    kept: Kept | None = None
    advice: str = ''

    @property
    def sentence(self) -> str:
        """State and text, for a person."""
        meaning = (MEANING if self.sets else AS_GIVEN).get(self.state)
        return f'{self.state}{f" ({meaning})" if meaning else ""}: {self.text}'

    @property
    def is_as_given(self) -> bool:
        """Whether it is of parameters that are as given, as far as is seen."""
        return not self.sets and self.name != ALL

    @property
    def is_to_look_at(self) -> bool:
        """Whether a person should know: proven, or not certain any more. What is right as given needs nobody."""
        return self.state == SUSPECT or self.state == FINE and bool(self.sets)

    @property
    def said(self) -> tuple:
        """What is news when it changes."""
        return self.name, self.state, self.sets, self.applied, self.advice


@dataclass(frozen=True)
class Kept:
    """What an earlier drive has proven of a vehicle: the parameters of one effect, and those of the filter that go with
    them. found: ns, stamp of the sample at which it was proven; 0: nobody knows."""

    name: str
    parameters: dict[str, Estimate]
    sets: dict
    found: int = 0

    def aged(self, now: int) -> dict[str, Estimate]:
        """The parameters of the effect as sure as they are at the stamp `now`, ns: the variance grows with the time
        since, as of a random walk."""
        walked = min(max((now - self.found) * 1e-9 / ANOTHER, 0.0), 1.0) if self.found else 0.0
        scales = {one.name: one.prior_scale for one in effect_called(self.name).traced}
        return {name: replace(e, sigma=math.hypot(e.sigma, math.sqrt(walked) * scales.get(name, 0.0))) if e.known else e
                for name, e in self.parameters.items()}


class Findings(NamedTuple):
    """What the filters should have: parameters by name of each finding. applied: in the one that drives. tried: each in
    one beside it, which takes over when it is proven."""

    applied: dict[str, dict]
    tried: dict[str, dict]


def together(ones: Iterable) -> dict:
    """The parameters of all of these, each with its `sets`: where two set the same one, as the later one has it."""
    return {name: value for one in ones for name, value in one.sets.items()}
