"""What the samples of the latest seconds show of lines that go with the way: a spectrum in cycles per metre.

A wheel that is out of balance shakes the vehicle once a revolution, tyre and tread at multiples of that. The samples of
a window are taken at equal steps of the way that the filter went, so that such a line is sharp however the speed
changes. The logarithm of the power of each axis is compared with its neighbourhood and with what stands at that
frequency in Hz always - suspension, engine at idle, mount - which wheels do not. Bin j of the spectrum is j / 2 cycles
per window: with the way L and the time T of the window j / (2 L) cycles per metre and j / (2 T) Hz.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

#: s of samples that are looked at together: a line is then 0.5 Hz wide, which is 1 m/s at the first harmonic, 0.3 at
#: the third; in a longer one a speed that is not known smears the lines
WINDOW = 4.0
#: steps of the way in a window: at 40 m/s each 0.3 m, where the third harmonic has two to a cycle
POINTS = 512
#: s: samples that come more often are averaged to this interval, so that POINTS of them fill a window
SHORTEST = 1.01 * WINDOW / POINTS
AXES = 6
#: bins to either side that are the neighbourhood: 2 Hz
NEIGHBOURHOOD = 16
#: parts of half the sampling rate above which nothing is looked at: what was interpolated is not power
HIGHEST = 0.9
#: least logarithm of the power over its neighbourhood that counts: no single bin says more against a line,
LEAST = -1.5
#: and the largest: nor for one
MOST = 3.5
#: windows over which what stands in Hz is averaged: five minutes
STANDING_MEMORY = 150.0
BINS = POINTS + 1


class _Row(NamedTuple):
    """One sample in the ring."""

    TIME: int = 0  # s that it lasted
    SPEED: int = 1  # m/s, of the filter
    VALUES: int = 2  # specific force and angular rate, body axes
    SIZE: int = 8


Row = _Row()


class _Spectrum(NamedTuple):
    """Columns, from where the memory of the wheels begins."""

    COUNT: int = 0  # rows put into the ring so far
    WINDOWS: int = 1  # windows looked at, up to STANDING_MEMORY
    RING: int = 2
    TAPER: int = RING + POINTS * Row.SIZE
    COSINE: int = TAPER + POINTS
    SINE: int = COSINE + POINTS
    REVERSED: int = SINE + POINTS  # where the transform takes each point
    SERIES: int = REVERSED + POINTS  # room to work: points of each axis,
    REAL: int = SERIES + AXES * POINTS  # two axes at once,
    IMAGINARY: int = REAL + 2 * POINTS
    SUM: int = IMAGINARY + 2 * POINTS
    POWER: int = SUM + BINS + 1  # and the spectrum of each axis
    STANDING: int = POWER + AXES * BINS  # what stands in Hz
    SIZE: int = STANDING + AXES * BINS


Spectrum = _Spectrum()


def begin(part: np.ndarray) -> None:
    """Write the tables into `part`, an array that begins with the columns of `Spectrum`."""
    angle = np.pi * np.arange(POINTS) / POINTS
    part[Spectrum.TAPER:Spectrum.TAPER + POINTS] = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(POINTS) + 0.5) / POINTS)
    part[Spectrum.COSINE:Spectrum.COSINE + POINTS], part[Spectrum.SINE:Spectrum.SINE + POINTS] = (
        np.cos(angle), -np.sin(angle))
    bits = (2 * POINTS).bit_length() - 1
    part[Spectrum.REVERSED:Spectrum.REVERSED + POINTS] = [int(f'{i:0{bits}b}'[::-1], 2) for i in range(POINTS)]


@njit(_nrt=False)
def _newest(mem, at):
    """How many rows of the ring make up the window that ends with the newest, its time (s) and its way (m)."""
    count, n, time, way = int(mem[at + Spectrum.COUNT]), 0, 0.0, 0.0
    while n < min(count, POINTS) and time < WINDOW - 0.5 * SHORTEST:
        row = at + Spectrum.RING + Row.SIZE * ((count - 1 - n) % POINTS)
        time += mem[row + Row.TIME]
        way += mem[row + Row.TIME] * mem[row + Row.SPEED]
        n += 1
    return n, time, way


@njit(_nrt=False)
def _resample(mem, at, n, way):
    """The newest n rows at equal steps of the way, less their trend and tapered, into SERIES."""
    count = int(mem[at + Spectrum.COUNT])
    index, step = count - n, way / POINTS
    row = at + Spectrum.RING + Row.SIZE * (index % POINTS)
    half = 0.5 * mem[row + Row.TIME] * mem[row + Row.SPEED]
    here, after, there = half, row, half  # way at the middle of a row, the next row, and its way
    for m in range(POINTS):
        target = (m + 0.5) * step
        while there < target and index < count - 1:
            row, here = after, there
            index += 1
            after = at + Spectrum.RING + Row.SIZE * (index % POINTS)
            there = here + 0.5 * (mem[row + Row.TIME] * mem[row + Row.SPEED]
                                  + mem[after + Row.TIME] * mem[after + Row.SPEED])
        share = min(max((target - here) / (there - here), 0.0), 1.0) if there > here else 0.0
        for axis in range(AXES):
            mem[at + Spectrum.SERIES + POINTS * axis + m] = (
                mem[row + Row.VALUES + axis] + share * (mem[after + Row.VALUES + axis] - mem[row + Row.VALUES + axis]))
    for axis in range(AXES):
        series, mean, slope = at + Spectrum.SERIES + POINTS * axis, 0.0, 0.0
        for m in range(POINTS):
            mean += mem[series + m] / POINTS
            slope += mem[series + m] * (m - 0.5 * (POINTS - 1)) * 12.0 / (POINTS * (POINTS**2 - 1.0))
        for m in range(POINTS):
            mem[series + m] -= mean + slope * (m - 0.5 * (POINTS - 1))
            mem[series + m] *= mem[at + Spectrum.TAPER + m]


@njit(_nrt=False)
def _transform(mem, at, pair):
    """Fourier transform of the series of two axes, as real and imaginary part, filled up with as many zeros."""
    re, im = at + Spectrum.REAL, at + Spectrum.IMAGINARY
    series = at + Spectrum.SERIES + 2 * pair * POINTS
    for m in range(POINTS):
        place = int(mem[at + Spectrum.REVERSED + m])  # even: the odd ones hold the zeros, and the first step copies
        mem[re + place] = mem[re + place + 1] = mem[series + m]
        mem[im + place] = mem[im + place + 1] = mem[series + POINTS + m]
    half = 2
    while half < 2 * POINTS:
        stride = POINTS // half
        for start in range(0, 2 * POINTS, 2 * half):
            for j in range(half):
                c, s = mem[at + Spectrum.COSINE + j * stride], mem[at + Spectrum.SINE + j * stride]
                a, b = start + j, start + j + half
                x = c * mem[re + b] - s * mem[im + b]
                y = s * mem[re + b] + c * mem[im + b]
                mem[re + b], mem[im + b] = mem[re + a] - x, mem[im + a] - y
                mem[re + a] += x
                mem[im + a] += y
        half *= 2


@njit(_nrt=False)
def _level(mem, at, power, last, bound):
    """What bins 0 to `last` at `power` have in their neighbourhood on average, into SERIES; bound: no bin counts as
    further than this from what stands there."""
    total, level = at + Spectrum.SUM, at + Spectrum.SERIES
    mem[total] = 0.0
    for j in range(last + 1):
        value = mem[power + j]
        if bound > 0.0:
            value = min(max(value, mem[level + j] - bound), mem[level + j] + bound)
        mem[total + j + 1] = mem[total + j] + value
    for j in range(last + 1):
        low, high = max(j - NEIGHBOURHOOD, 0), min(j + NEIGHBOURHOOD, last) + 1
        mem[level + j] = (mem[total + high] - mem[total + low]) / (high - low)


@njit(_nrt=False)
def look(mem, at, highest):
    """The spectrum of the window that ends now into POWER: time (s), way (m), and last bin that says something.

    highest: cycles per metre that are asked for.
    """
    n, time, way = _newest(mem, at)
    last = int(min(HIGHEST * n, 2.0 * highest * way + 2 * NEIGHBOURHOOD, POINTS))
    _resample(mem, at, n, way)
    re, im = at + Spectrum.REAL, at + Spectrum.IMAGINARY
    for pair in range(AXES // 2):
        _transform(mem, at, pair)
        one = at + Spectrum.POWER + 2 * pair * BINS
        other = one + BINS
        for j in range(2, last + 1):  # the first two hold the trend
            k = 2 * POINTS - j
            x, y, u, v = mem[re + j], mem[im + j], mem[re + k], mem[im + k]
            mem[one + j] = math.log((x + u) ** 2 + (y - v) ** 2 + 1e-20)
            mem[other + j] = math.log((y + v) ** 2 + (x - u) ** 2 + 1e-20)
        for power in (one, other):
            mem[power] = mem[power + 1] = mem[power + 2]
    windows = mem[at + Spectrum.WINDOWS] + 1.0
    mem[at + Spectrum.WINDOWS] = min(windows, STANDING_MEMORY)
    for axis in range(AXES):
        power, standing = at + Spectrum.POWER + BINS * axis, at + Spectrum.STANDING + BINS * axis
        _level(mem, at, power, last, 0.0)
        _level(mem, at, power, last, MOST)
        for j in range(last + 1):
            above = min(max(mem[power + j] - mem[at + Spectrum.SERIES + j], LEAST), MOST)
            mem[power + j] = max(above - max(mem[standing + j], 0.0), LEAST)
            mem[standing + j] += (above - mem[standing + j]) / min(windows, STANDING_MEMORY)
    return time, way, last
