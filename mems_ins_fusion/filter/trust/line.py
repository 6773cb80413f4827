"""Straight line fitted to positions over time by least squares; the sums for it are kept in the memory."""
from __future__ import annotations

from typing import NamedTuple

from mems_ins_fusion.compiled import njit


class _Line(NamedTuple):
    """Columns of one line."""

    COUNT: int = 0  # number of positions; 0: there is no line
    SINCE: int = 1  # s, time of the first
    T: int = 2  # sums: of the time since then, s,
    TT: int = 3  # of its square,
    N: int = 4  # of the positions north, m,
    TN: int = 5  # of their products with the time,
    E: int = 6  # of the positions east, m,
    TE: int = 7  # of their products with the time,
    SQUARE: int = 8  # and of the squares of the positions, m^2
    SIZE: int = 9


Line = _Line()
#: smallest number of positions of a meaningful line: with fewer, any positions are near a line. Chosen; a quarter and
#: four times of it move little (docs/ablation.md)
FEWEST_ON_LINE = 5.0


@njit(_nrt=False)
def begin_line(mem, at, time):
    """Begin a line without positions. time: s, of the first position to come."""
    for i in range(Line.SIZE):
        mem[at + i] = 0.0
    mem[at + Line.SINCE] = time


@njit(_nrt=False)
def add_to_line(mem, at, time, north, east):
    """Add a position, m, at `time`, s, to the sums of the line at `at`."""
    t = time - mem[at + Line.SINCE]
    mem[at + Line.COUNT] += 1.0
    mem[at + Line.T] += t
    mem[at + Line.TT] += t * t
    mem[at + Line.N] += north
    mem[at + Line.TN] += t * north
    mem[at + Line.E] += east
    mem[at + Line.TE] += t * east
    mem[at + Line.SQUARE] += north * north + east * east


@njit(_nrt=False)
def fit_line(mem, at):
    """Slope (north, east; m/s) of the line at `at`, the mean square distance of the positions from it, m^2, and the
    variance of a component of the slope, m^2/s^2."""
    n = mem[at + Line.COUNT]
    t = mem[at + Line.T] / n
    spread_t = max(mem[at + Line.TT] / n - t * t, 1e-6)
    north, east = mem[at + Line.N] / n, mem[at + Line.E] / n
    slope_n = (mem[at + Line.TN] / n - t * north) / spread_t
    slope_e = (mem[at + Line.TE] / n - t * east) / spread_t
    left = mem[at + Line.SQUARE] / n - north * north - east * east - spread_t * (slope_n**2 + slope_e**2)
    left = max(left, 0.0)
    return slope_n, slope_e, left, 0.5 * left / (max(n - 2.0, 1.0) * spread_t)
