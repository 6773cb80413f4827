"""Columns of the filter's memory that a mechanism asks for in its own file: name, size, first value.

A part of the memory (`Part`) places them one behind the other, as they are asked for, in the room that it has. Compiled
code takes their positions as constants, and compiled code is kept: so they have to be the same in each process, which
is why `filter/__init__.py` imports the mechanisms, always in one order.
"""
from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable


def numbered() -> Callable[..., int]:
    """Numbers columns one behind the other: `column(3)` is the first of the next three, `column(0)` another name of the
    next one."""
    end = 0

    def column(size: int = 1) -> int:
        nonlocal end
        first, end = end, end + size
        return first
    return column


class Part:
    """One part of the memory. name: in messages. first, end: its room, in floats."""

    def __init__(self, name: str, first: int, end: int):
        self.name, self.next, self.end = name, first, end
        self.first_values: list[tuple[int, float]] = []

    def place(self, owner: str, **columns):
        """Room for the columns of `owner`: a named tuple of their positions.

        columns: by name, how many floats, or these and their first value, where it is not zero.
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
        """Write the first values into `part`, an array that begins where the positions count from."""
        for position, value in self.first_values:
            part[position] = value
