"""State of each finding of the diagnosis while driving, in the terms of receivers that calibrate themselves."""
from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from ..effects.registry import effect_called
from .estimate import Estimate

INITIALISING, COARSE, FINE, SUSPECT = 'INITIALISING', 'COARSE', 'FINE', 'SUSPECT'
#: explanations of the states
MEANING = {INITIALISING: 'too few samples yet', COARSE: 'found, being tested', FINE: 'proven by what came after',
           SUSPECT: 'not certain any more'}
#: explanations if the parameters are as given
AS_GIVEN = {INITIALISING: MEANING[INITIALISING], COARSE: 'as given, as far as is seen', FINE: 'right as given'}
#: state of an analysis without findings, and name of the quantity that it and INITIALISING refer to
NOTHING, ALL = 'NOTHING FOUND', 'all'
#: state of the filter if it uses a finding
CHANGED = 'CHANGED'
#: s, a year: a value that has not been observed for this long may have any usual value
ANOTHER = 365.25 * 86_400.0


@dataclass(frozen=True)
class FindingState:
    """State of one finding. time: ns, stamp of the newest sample. sets: lines for a params file. better: by duration,
    mean error m without and with it, and the number of outages. Without lines the parameters are right as given, as far
    as is known, and `parameters` are possible remaining errors. text: in words. applied: whether the filter is to use
    it. kept: the finding for the next drive, if it is applied."""

    time: int
    name: str
    state: str
    parameters: dict[str, Estimate]
    sets: tuple[str, ...] = ()
    better: dict[float, tuple[float, float, int]] = field(default_factory=dict)
    text: str = ''
    applied: bool = False
    kept: EarlierFinding | None = None
    advice: str = ''

    @property
    def sentence(self) -> str:
        """State and text as a sentence."""
        meaning = (MEANING if self.sets else AS_GIVEN).get(self.state)
        return f'{self.state}{f" ({meaning})" if meaning else ""}: {self.text}'

    @property
    def is_as_given(self) -> bool:
        """Whether it confirms parameters as given."""
        return not self.sets and self.name != ALL

    @property
    def is_to_look_at(self) -> bool:
        """Whether the user should know: it is proven, or has become uncertain. Confirmed parameters need no attention.
        """
        return self.state == SUSPECT or self.state == FINE and bool(self.sets)

    @property
    def said(self) -> tuple:
        """The parts whose change is reported."""
        return self.name, self.state, self.sets, self.applied, self.advice


@dataclass(frozen=True)
class EarlierFinding:
    """A finding proven in an earlier drive: the parameters of one effect, and those of the filter for it. found: ns,
    stamp of the sample at which it was proven; 0: unknown."""

    name: str
    parameters: dict[str, Estimate]
    sets: dict
    found: int = 0

    def aged(self, now: int) -> dict[str, Estimate]:
        """The parameters of the effect at the stamp `now`, ns: their variance grows with time like that of a random
        walk."""
        walked = min(max((now - self.found) * 1e-9 / ANOTHER, 0.0), 1.0) if self.found else 0.0
        scales = {one.name: one.prior_scale for one in effect_called(self.name).traced}
        return {name: replace(e, sigma=math.hypot(e.sigma, math.sqrt(walked) * scales.get(name, 0.0))) if e.known else e
                for name, e in self.parameters.items()}


class FilterFindings(NamedTuple):
    """Findings for the filters: parameters by name of each finding. applied: in the filter that is used. tried: each in
    a parallel filter, which takes over when the finding is proven. doubted: names of the applied ones of which
    another value is on trial, from a look or an analysis."""

    applied: dict[str, dict]
    tried: dict[str, dict]
    doubted: frozenset[str] = frozenset()


def merged_settings(ones: Iterable) -> dict:
    """All parameters of these findings with their `sets`; if two set the same parameter, the later one counts."""
    return {name: value for one in ones for name, value in one.sets.items()}
