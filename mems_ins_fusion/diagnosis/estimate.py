"""What a diagnosis knows of one number."""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

#: no model of a car is right to a few per cent: what is in no effect of the library (a body that rolls in bends, axes
#: that are not at right angles, what else is in the car and too small to be found) moves what is estimated by this part
SYSTEMATIC = 0.05
#: sigmas from which on an effect is taken to be there: of at least one of its parameters, in all drives or in one
PLAIN = 3.0
#: standard deviations from which on two estimates of the same are two values: one pair in 370 by chance
APART = 3.0


@dataclass(frozen=True)
class Estimate:
    """A value with its standard deviation, or a range (low, high) whose values explain the recording equally well.

    unit: SI, '-' for a ratio. value: None where there is only a range. sigma: None where it was only tried.
    """

    value: float | None
    sigma: float | None
    unit: str
    range: tuple[float, float] | None = None

    @property
    def known(self) -> bool:
        """Whether there is a value with a standard deviation."""
        return self.value is not None and self.sigma is not None and math.isfinite(self.sigma)

    def differs(self, other: Estimate) -> bool:
        """Whether both are known, and are of two values."""
        return (self.known and other.known
                and abs(self.value - other.value) > APART * math.hypot(self.sigma, other.sigma))

    def text(self) -> str:
        """For a person, with as many digits as the standard deviation is worth."""
        unit = '' if self.unit == '-' else f' {self.unit}'
        if self.value is None:
            low, high = self.range
            return f'{low:.2g} to {high:.2g}{unit}'
        said = rounded(self.value, self.sigma) + (f' \N{PLUS-MINUS SIGN} {self.sigma:.2g}' if self.known else '') + unit
        return f'{said}, {math.degrees(self.value):.3g} deg' if self.unit == 'rad' else said


def systematic(parameters: Mapping[str, Estimate]) -> dict[str, float]:
    """The part of the sigmas of the parameters of one effect that is SYSTEMATIC, where they are known: a part of the
    length of those of the same unit, as axes that are a little turned make one of the other."""
    lengths: dict[str, float] = {}
    for estimate in parameters.values():
        if estimate.known:
            lengths[estimate.unit] = math.hypot(lengths.get(estimate.unit, 0.0), estimate.value)
    return {name: SYSTEMATIC * lengths[e.unit] for name, e in parameters.items() if e.known}


def widened(parameters: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """The parameters of one effect with what is `systematic` in their sigmas."""
    more = systematic(parameters)
    return {name: replace(e, sigma=math.hypot(e.sigma, more[name])) if e.known else e for name, e in parameters.items()}


def rounded(value: float, sigma: float | None) -> str:
    """`value` to as many digits as its standard deviation is worth."""
    if not sigma or not math.isfinite(sigma):
        return f'{value:.4g}'
    digits = max(1 - math.floor(math.log10(sigma)), 0)
    return f'{value:.{digits}f}' if digits < 8 else f'{value:.3g}'
