"""A parameter: name, default, unit, range, meaning; and the messages on values that cannot be used."""
from __future__ import annotations

import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass

from mems_ins_fusion.errors import InputError


class ParameterError(InputError):
    """A parameter that cannot be used: one line that names it, its value and what was expected."""


@dataclass(frozen=True)
class Parameter:
    """One parameter. Its type is that of `default`: bool, int, float, str, list of float or of str."""

    name: str
    default: object
    unit: str
    description: str
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    lengths: Sequence[int] | None = None  # of a list, a tuple or a range; None allows any
    positive: bool = False  # excludes zero, and the empty text
    elements: tuple[tuple[str, float], ...] = ()  # of a list: name and largest magnitude of each element

    @property
    def shown_unit(self) -> str:
        """The unit for people; '' for texts and ratios."""
        return '' if self.unit in ('text', '-') else self.unit

    @property
    def length_text(self) -> str:
        """`lengths` in words."""
        if isinstance(self.lengths, range):
            return f'{self.lengths[0]} to {self.lengths[-1]}'
        return ' or '.join(str(n) for n in self.lengths)

    def check(self, value):
        """`value` in this parameter's type; ParameterError if it does not fit."""
        if isinstance(self.default, list):
            return self._check_list(value)
        return self._check_scalar(value, type(self.default))

    def _check_list(self, value):
        if value is None:
            value = []
        if isinstance(value, (str, bytes)) or not hasattr(value, '__iter__'):
            value = [value]
        kind = self._element_type()
        value = list(value)
        if self.lengths is not None and len(value) not in self.lengths:
            raise ParameterError(f"parameter '{self.name}' must have {self.length_text} values, got {len(value)}: "
                                 f'{reprlib.repr(value)}')
        value = [self._check_scalar(v, kind) for v in value]
        for element, (what, largest) in zip(value, self.elements):
            if abs(element) > largest:
                raise ParameterError(f"parameter '{self.name}' must have a {what} from -{largest:g} to {largest:g}, "
                                     f'got {element:g}')
        return value

    def _element_type(self):
        if self.default:
            return type(self.default[0])
        return str if self.unit == 'text' else float

    def _check_scalar(self, value, kind):
        if kind is bool:
            if isinstance(value, bool):
                return value
        elif kind is str:
            if isinstance(value, bool) and 'off' in self.choices:  # YAML and ROS read unquoted on and off as booleans
                value = 'on' if value else 'off'
            if isinstance(value, str):
                return self._check_choice(value)
        elif not isinstance(value, bool):
            number = _number(value)
            if number is not None and (kind is float or number == int(number)):
                return self._check_range(kind(number))
        wanted = {bool: 'true or false', str: 'a text', int: 'a whole number', float: 'a number'}[kind]
        raise ParameterError(f"parameter '{self.name}' must be {wanted}, got {reprlib.repr(value)}")

    def _check_choice(self, value):
        if self.positive and not value:
            raise ParameterError(f"parameter '{self.name}' must not be empty")
        if '\0' in value:
            raise ParameterError(f"parameter '{self.name}' holds a null byte: {reprlib.repr(value)}")
        if self.choices and value not in self.choices:
            raise ParameterError(f"parameter '{self.name}' must be one of {', '.join(self.choices)}; got '{value}'")
        return value

    def _check_range(self, value):
        if value < self.minimum or value > self.maximum or (self.positive and value <= 0):
            low = 'above 0' if self.positive else f'at least {self.minimum:g}'
            high = f' and at most {self.maximum:g}' if self.maximum < math.inf else ''
            unit = f' {self.unit}' if self.unit not in ('', '-') else ''
            raise ParameterError(f"parameter '{self.name}' must be {low}{high}{unit}, got {value:g}")
        return value


def _number(value) -> float | None:
    """`value` as a finite float, also from a text such as 1e-3 (a text in PyYAML, a double in ROS); else None."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None
