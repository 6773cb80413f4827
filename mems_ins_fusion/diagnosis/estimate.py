"""What a diagnosis knows of one number."""
from __future__ import annotations

import math
from dataclasses import dataclass


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

    def text(self) -> str:
        """For a person, with as many digits as the standard deviation is worth."""
        unit = '' if self.unit == '-' else f' {self.unit}'
        if self.value is None:
            low, high = self.range
            return f'{low:.2g} to {high:.2g}{unit}'
        said = rounded(self.value, self.sigma) + (f' \N{PLUS-MINUS SIGN} {self.sigma:.2g}' if self.known else '') + unit
        return f'{said}, {math.degrees(self.value):.3g} deg' if self.unit == 'rad' else said


def rounded(value: float, sigma: float | None) -> str:
    """`value` to as many digits as its standard deviation is worth."""
    if not sigma or not math.isfinite(sigma):
        return f'{value:.4g}'
    digits = max(1 - math.floor(math.log10(sigma)), 0)
    return f'{value:.{digits}f}' if digits < 8 else f'{value:.3g}'
