"""Sizes that no vehicle has: such an estimate is told, with what it usually stands for, and never added."""
from __future__ import annotations

from collections.abc import Mapping

from ..effects.base import Effect
from ..effects.registry import EFFECTS
from .estimate import Estimate

#: by effect: the parameter that the course of the fixes shows without a filter, too; so many sigma, and this much at
#: least, are a contradiction, and so is more than this where the course shows nothing
_SHOWN_BY_COURSE = {'gyroscope_scale': 'z'}
_CONTRADICTED, _ALIKE = 4.0, 0.05


def implausible(effect: str, parameters: Mapping[str, Estimate], turned: Estimate | None = None) -> str:
    """Why these sizes cannot be, and what they usually stand for; empty where they can.

    turned: part by which the gyroscopes turn further than the course does (`Bench.turned`).
    """
    own = parameters.get(_SHOWN_BY_COURSE.get(effect, ''))
    if turned is not None and own is not None and own.value is not None:
        apart = abs(own.value - turned.value)
        contradicted = apart > max(_CONTRADICTED * turned.sigma, _ALIKE)
        if contradicted or abs(own.value) > _ALIKE and abs(turned.value) <= turned.sigma:
            return (f'the gyroscopes turn by {1 + turned.value:.3g} +- {turned.sigma:.1g} times the angle of the '
                    f'course, which {"contradicts it" if contradicted else "shows none of it"}')
    known = EFFECTS.get(effect) or Effect()
    beyond = [f'{name} of {estimate.text()}' for name, estimate in parameters.items()
              if estimate.value is not None and _within(estimate)[0] > known.largest.get(name, float('inf'))]
    if beyond:
        return f'{" and ".join(beyond)} is more than any vehicle has; it usually stands for {known.larger_is}'
    below = [f'{name} of {estimate.text()}' for name, estimate in parameters.items()
             if estimate.value is not None and _within(estimate)[1] < known.smallest.get(name, 0.0)]
    return f'{" and ".join(below)} is {known.smaller_is}' if below else ''


def _within(estimate: Estimate) -> tuple[float, float]:
    """Between which sizes it is, by a sigma: what may be possible is not impossible."""
    sigma = estimate.sigma if estimate.known else 0.0
    return abs(estimate.value) - sigma, abs(estimate.value) + sigma
