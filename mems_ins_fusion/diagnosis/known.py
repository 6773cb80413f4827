"""State of the search for effects after a step."""
from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..effects.base import Effect
from .findings import Finding
from .fit import FittedModel
from .measured import MeasuredErrors
from .problem import Problem
from .tracing import Candidate


@dataclass(frozen=True)
class SearchState:
    """State of the search after a step: the model, the findings, and the effects that are still candidates.

    errors: of the user's filter with the effects so far, in each part of the data with the estimate from the others.
    effects: candidates. rejected: effects that failed since the last one was added. estimates: the unknowns, for each
    part that is held out. rounds: the tested candidates of each round. chosen: for each round that tried any, the
    name of the effect that it added, or of the first one tried. hidden: by name, why an effect or a parameter does not
    show.
    """

    problem: Problem
    model: FittedModel
    errors: MeasuredErrors
    effects: tuple[Effect, ...]
    rejected: tuple[Effect, ...] = ()
    estimates: tuple[np.ndarray, ...] = ()
    findings: tuple[Finding, ...] = ()
    rounds: tuple[list[Candidate], ...] = ()
    chosen: tuple[str, ...] = ()
    hidden: dict[str, str] = field(default_factory=dict)

    @property
    def noise(self) -> int:
        """Number of noise levels; they are the first unknowns."""
        return sum(u.noise for u in self.model.unknowns)

    def corrected(self) -> dict:
        """The user's parameters with the effects that are added; the model may have others that are only told."""
        return self._with_added(self.model.x)

    def by_part(self) -> list[dict]:
        """The same with the estimates without each part; a single one if nothing was estimated."""
        return [self._with_added(x) for x in self.estimates] or [self.corrected()]

    def _with_added(self, x: np.ndarray) -> dict:
        added = {finding.name for finding in self.findings if finding.added}
        kept = [i for i, unknown in enumerate(self.model.unknowns) if unknown.effect in added]
        return self.problem.corrected([self.model.unknowns[i] for i in kept], x[kept])
