"""Effects in the words of people who build vehicles, and what they can check.

The words are attributes of the effect itself.
"""
from __future__ import annotations

import math
from collections.abc import Mapping

from ..diagnosis.estimate import Estimate, with_sigma
from ..effects.registry import effect_called


def description(name: str) -> str:
    """The effect `name` in words."""
    return effect_called(name).in_words or name.replace('_', ' ')


def vehicle_check(name: str) -> str:
    """What to check on the vehicle for the effect `name`; '' if unknown."""
    return effect_called(name).to_check


def looks_the_same(name: str) -> str:
    """Other causes with the same appearance as the effect `name`; '' if unknown."""
    return effect_called(name).looks_the_same


def remaining_cause(name: str, values: Mapping) -> str:
    """What a correction of the effect `name` may leave of its cause; '' if the filter has a complete model of it.
    values: checked parameters."""
    return effect_called(name).leaves(values)


def size_text(name: str, parameter: str, estimate: Estimate) -> str:
    """The size of a parameter of the effect `name` in words, angles in degrees and ratios in percent."""
    words = effect_called(name).sizes.get(parameter)
    if words is None or estimate.value is None:
        return f'{parameter} {estimate.text()}'
    shown = {'rad': (math.degrees(1.0), ' deg'), '-': (100.0, ' %')}
    factor, unit = shown.get(estimate.unit, (1.0, f' {estimate.unit}'))
    value, sigma = abs(estimate.value) * factor, estimate.sigma * factor if estimate.known else None
    return words[estimate.value < 0].format(with_sigma(value, sigma) + unit)
