"""Columns of the filter's memory that other files declare for their own use: name, size, first value.

A `Part` of the memory reserves room for them in the order of declaration. Compiled code contains their positions as
constants and is cached on disk, so the positions must be the same in every process: `filter/__init__.py` imports the
files that declare columns, always in the same order.
"""
from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable


def numbered() -> Callable[..., int]:
    """A function that numbers columns in sequence: `column(3)` reserves three and returns the first, `column(0)`
    returns the next one without reserving it."""
    end = 0

    def column(size: int = 1) -> int:
        nonlocal end
        first, end = end, end + size
        return first
    return column


class Part:
    """Room for columns in one part of the memory: positions first to end, floats. name: for messages."""

    def __init__(self, name: str, first: int, end: int):
        self.name, self.next, self.end = name, first, end
        self.first_values: list[tuple[int, float]] = []

    def place(self, owner: str, **columns):
        """Reserve columns for `owner` and return a named tuple of their positions.

        columns: for each name the number of floats, or a pair of this number and the first value of each (else zero).
        Raises IndexError where the part has no room left.
        """
        positions = []
        for size in columns.values():
            size, first = size if isinstance(size, tuple) else (size, 0.0)
            positions.append(self.next)
            if first != 0.0:
                self.first_values += [(self.next + i, first) for i in range(size)]
            self.next += size
        if self.next > self.end:
            raise IndexError(f'{self.name}: no room for {owner}, {self.next - self.end} floats too few')
        return namedtuple(owner, columns)(*positions)

    def begin(self, part) -> None:
        """Write the first values into the array `part`, in which index 0 is position 0."""
        for position, value in self.first_values:
            part[position] = value
