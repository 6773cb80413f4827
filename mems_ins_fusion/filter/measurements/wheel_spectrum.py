"""Spectrum of the latest seconds of IMU samples over distance driven, in cycles per metre.

A wheel out of balance excites the vehicle once a revolution, tyre and tread at multiples of this. The samples of a
window are resampled at equal steps of the distance by the filter, so that such a line is sharp although the speed
changes. Two means are subtracted from the logarithm of the power of each axis: that of its neighbourhood, and the
long-term mean at the same frequency in Hz, which is caused by suspension, idling engine and mount, not by the wheels.
Bin j of the spectrum is j / 2 cycles per window: with distance L and duration T of the window, j / (2 L) cycles per
metre and j / (2 T) Hz.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ..columns import numbered

#: s, duration of a window: a line is 0.5 Hz wide, which is 1 m/s at the first harmonic and 0.3 m/s at the third; in a
#: longer window the error of the speed smears the lines
SPECTRUM_WINDOW = 4.0
POINTS = 512  # steps of distance in a window: 0.3 m each at 40 m/s, two for each cycle of the third harmonic
#: s: samples are averaged to at least this interval, so that the ring of POINTS rows holds a window
SHORTEST = 1.01 * SPECTRUM_WINDOW / POINTS
AXES = 6  # three accelerometers, three gyroscopes
NEIGHBOUR_BINS = 16  # bins to either side that are the neighbourhood: 2 Hz
#: highest frequency used, as a share of the Nyquist frequency: interpolation removes power near that
HIGHEST_SHARE = 0.9
#: lower limit of the logarithm of the power over its neighbourhood, so that no single bin decides against a line.
#: Chosen, not measured
LEAST = -1.5
#: upper limit of the same, so that no single bin decides for a line. Chosen, not measured
MOST = 3.5
MEAN_OVER = 150.0  # windows over which powers and their statistics are averaged: five minutes
BINS = POINTS + 1  # number of frequencies of a spectrum, from zero on

column = numbered()


class _Row(NamedTuple):
    """One row of the ring."""

    TIME: int = column()  # its duration, s
    SPEED: int = column()  # of the filter, m/s
    VALUES: int = column(AXES)  # mean specific force and angular rate, body axes
    SIZE: int = column(0)


Row = _Row()
column = numbered()


class _Spectrum(NamedTuple):
    """Columns, counted from the start of the array or part of the memory that holds them."""

    COUNT: int = column()  # rows put into the ring so far
    WINDOWS: int = column()  # windows seen, up to MEAN_OVER
    RING: int = column(POINTS * Row.SIZE)
    TAPER: int = column(POINTS)
    COSINE: int = column(POINTS)
    SINE: int = column(POINTS)
    REVERSED: int = column(POINTS)  # bit-reversed index of each point
    SERIES: int = column(AXES * POINTS)  # scratch: resampled points of each axis,
    REAL: int = column(2 * POINTS)  # the transform of two axes at once,
    IMAGINARY: int = column(2 * POINTS)
    SUM: int = column(BINS + 1)  # running sums,
    POWER: int = column(AXES * BINS)  # and the logarithmic spectrum of each axis
    STANDING: int = column(AXES * BINS)  # mean power at constant frequency (Hz)
    SIZE: int = column(0)


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
    """The window that ends with the newest row: number of its rows, duration (s) and distance (m)."""
    count, n, time, way = int(mem[at + Spectrum.COUNT]), 0, 0.0, 0.0
    while n < min(count, POINTS) and time < SPECTRUM_WINDOW - 0.5 * SHORTEST:
        row = at + Spectrum.RING + Row.SIZE * ((count - 1 - n) % POINTS)
        time += mem[row + Row.TIME]
        way += mem[row + Row.TIME] * mem[row + Row.SPEED]
        n += 1
    return n, time, way


@njit(_nrt=False)
def _resample(mem, at, n, way):
    """Resample the newest n rows at equal steps of distance into SERIES, detrended and tapered."""
    count = int(mem[at + Spectrum.COUNT])
    index, step = count - n, way / POINTS
    row = at + Spectrum.RING + Row.SIZE * (index % POINTS)
    half = 0.5 * mem[row + Row.TIME] * mem[row + Row.SPEED]
    here, after, there = half, row, half  # distance at the middle of a row, the next row, and its distance
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
    """Fourier transform of two axes as real and imaginary part of one series, zero-padded to twice its length."""
    re, im = at + Spectrum.REAL, at + Spectrum.IMAGINARY
    series = at + Spectrum.SERIES + 2 * pair * POINTS
    for m in range(POINTS):
        k = int(mem[at + Spectrum.REVERSED + m])  # even; the odd ones are the zeros, so the first step is a copy
        mem[re + k] = mem[re + k + 1] = mem[series + m]
        mem[im + k] = mem[im + k + 1] = mem[series + POINTS + m]
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
def _neighbourhood(mem, at, power, last, bound):
    """Mean over the neighbourhood of each of the bins 0 to `last` at `power`, into SERIES. bound: values further than
    this from the means that SERIES already holds are clipped; 0: none are."""
    total, level = at + Spectrum.SUM, at + Spectrum.SERIES
    mem[total] = 0.0
    for j in range(last + 1):
        value = mem[power + j]
        if bound > 0.0:
            value = min(max(value, mem[level + j] - bound), mem[level + j] + bound)
        mem[total + j + 1] = mem[total + j] + value
    for j in range(last + 1):
        low, high = max(j - NEIGHBOUR_BINS, 0), min(j + NEIGHBOUR_BINS, last) + 1
        mem[level + j] = (mem[total + high] - mem[total + low]) / (high - low)


@njit(_nrt=False)
def look(mem, at, highest):
    """Spectrum of the window that ends now, into POWER. Returns its duration (s), distance (m), and last usable bin.

    highest: highest frequency of interest, cycles per metre.
    """
    n, time, way = _newest(mem, at)
    last = int(min(HIGHEST_SHARE * n, 2.0 * highest * way + 2 * NEIGHBOUR_BINS, POINTS))
    _resample(mem, at, n, way)
    re, im = at + Spectrum.REAL, at + Spectrum.IMAGINARY
    for pair in range(AXES // 2):
        _transform(mem, at, pair)
        one = at + Spectrum.POWER + 2 * pair * BINS
        other = one + BINS
        for j in range(2, last + 1):  # the first two bins hold the trend
            k = 2 * POINTS - j
            x, y, u, v = mem[re + j], mem[im + j], mem[re + k], mem[im + k]
            mem[one + j] = math.log((x + u) ** 2 + (y - v) ** 2 + 1e-20)
            mem[other + j] = math.log((y + v) ** 2 + (x - u) ** 2 + 1e-20)
        for power in (one, other):
            mem[power] = mem[power + 1] = mem[power + 2]
    windows = mem[at + Spectrum.WINDOWS] + 1.0
    mem[at + Spectrum.WINDOWS] = min(windows, MEAN_OVER)
    for axis in range(AXES):
        power, standing = at + Spectrum.POWER + BINS * axis, at + Spectrum.STANDING + BINS * axis
        _neighbourhood(mem, at, power, last, 0.0)
        _neighbourhood(mem, at, power, last, MOST)
        for j in range(last + 1):
            above = min(max(mem[power + j] - mem[at + Spectrum.SERIES + j], LEAST), MOST)
            mem[power + j] = max(above - max(mem[standing + j], 0.0), LEAST)
            mem[standing + j] += (above - mem[standing + j]) / min(windows, MEAN_OVER)
    return time, way, last
