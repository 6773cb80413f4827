"""What a search knows after a step."""
from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..effects.base import Effect
from .findings import Finding
from .fit import Model
from .measured import Measured
from .problem import Problem
from .tracing import Candidate


@dataclass(frozen=True)
class Known:
    """What is known after a step: the model, what was found, and what is still to be tried.

    estimates: the unknowns by the part that is held out. errors: those of the user's filter with the effects so far,
    in each part with the estimate from the others.
    """

    problem: Problem
    model: Model
    errors: Measured
    effects: tuple[Effect, ...]
    rejected: tuple[Effect, ...] = ()
    estimates: tuple[np.ndarray, ...] = ()
    findings: tuple[Finding, ...] = ()
    rounds: tuple[list[Candidate], ...] = ()
    chosen: tuple[str, ...] = ()
    hidden: dict[str, str] = field(default_factory=dict)

    @property
    def noise(self) -> int:
        """How many of the unknowns, the first ones, are noise levels."""
        return sum(u.noise for u in self.model.unknowns)

    def corrected(self) -> dict:
        """The user's parameters with the effects found so far."""
        return self.problem.corrected(self.model.unknowns, self.model.x)

    def by_part(self) -> list[dict]:
        """The same by the part that is held out; one for all where nothing was estimated."""
        return [self.problem.corrected(self.model.unknowns, x) for x in self.estimates] or [self.corrected()]
