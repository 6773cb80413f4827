"""An estimate with its standard deviation."""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from ..navigation.frames import wrap

#: systematic error of an estimate, relative to its value, by what no effect describes: no model of a car is exact to
#: some per cent (a body that rolls in bends, axes that are not orthogonal, effects that are too small to be found)
SYSTEMATIC = 0.05
#: smallest ratio of value and sigma, of at least one parameter, with which an effect counts as present
PLAIN = 3.0
#: number of sigmas by which two estimates of one quantity differ if they are different values: by chance 1 pair in 370
APART = 3.0


@dataclass(frozen=True)
class Estimate:
    """A value with its standard deviation, or a range (low, high) whose values explain the recording equally well.

    unit: SI, '-' for a ratio. value: None if there is only a range. sigma: None if the value was fixed, not estimated.
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
        """Whether both are known and differ significantly; angles by the smaller way round."""
        if not (self.known and other.known):
            return False
        apart = self.value - other.value
        apart = wrap(apart) if self.unit == 'rad' else apart
        return abs(apart) > APART * math.hypot(self.sigma, other.sigma)

    def text(self) -> str:
        """As text, with the number of digits that the standard deviation allows."""
        unit = '' if self.unit == '-' else f' {self.unit}'
        if self.value is None:
            low, high = self.range
            return f'{low:.2g} to {high:.2g}{unit}'
        said = with_sigma(self.value, self.sigma if self.known else None) + unit
        return f'{said}, {math.degrees(self.value):.3g} deg' if self.unit == 'rad' else said


def systematic(parameters: Mapping[str, Estimate]) -> dict[str, float]:
    """SYSTEMATIC errors of the known parameters of one effect: relative to the norm of all parameters of the same unit,
    as a small rotation of the axes mixes them."""
    lengths: dict[str, float] = {}
    for estimate in parameters.values():
        if estimate.known:
            lengths[estimate.unit] = math.hypot(lengths.get(estimate.unit, 0.0), estimate.value)
    return {name: SYSTEMATIC * lengths[e.unit] for name, e in parameters.items() if e.known}


def widened(parameters: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """The parameters of one effect, with `systematic` errors included in their sigmas."""
    more = systematic(parameters)
    return {name: replace(e, sigma=math.hypot(e.sigma, more[name])) if e.known else e for name, e in parameters.items()}


def with_sigma(value: float, sigma: float | None) -> str:
    """Both as text, with the same number of digits."""
    return rounded(value, sigma) + ('' if sigma is None else f' \N{PLUS-MINUS SIGN} {rounded(sigma, sigma)}')


def rounded(value: float, sigma: float | None) -> str:
    """`value` as text with the number of digits that its standard deviation allows."""
    if not sigma or not math.isfinite(sigma):
        return f'{value:.4g}'
    digits = max(1 - math.floor(math.log10(sigma)), 0)
    return f'{value:.{digits}f}' if digits < 8 else f'{value:.3g}'
