"""The white noise that the samples of an IMU show themselves, where it is more than its parameters say.

A vehicle shakes its IMU faster than many sample: what is not filtered out before the samples are taken is folded
down, as white noise, and is in the integrals of the samples what the sensor's own noise is, often ten times as large. A
motion that the samples do show is smooth from one to the next. So a high difference of samples in a row is noise: that
of order n has `binomial(2 n, n)` times the variance of one sample, and that times the sampling interval is the noise
density squared.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit
from mems_ins_fusion.compiled_lanes import four, put

from ..memory import HEAD, SAMPLE, WHITE, Head, Sample, nonnegative, sample_at

#: whether it is used; s in which the samples showed far more than is assumed
White = HEAD.place('White', ADAPT=1, SHAKEN=1)
#: beside a sample: noise density squared of each axis that the samples show lately, and of f_y over LONG_MEAN_TIME
Shown = SAMPLE.place('Shown', WHITE=6, SIDEWAYS=1)

#: s over which the squared differences are averaged: the noise changes with the road and the engine
MEAN_TIME = 3.0
#: s over which that of the sideways accelerometer is averaged again: whether the vehicle shakes the IMU altogether
LONG_MEAN_TIME = 60.0
#: s in which the velocity integrated from samples is compared with a constraint on it: where the noise moves it by
#: more than the constraint's sigma in that, noise passes for turns, and the speed for what goes with turns
COMPARED_OVER = 1.0
#: of the difference: a motion at a quarter of the sampling rate counts 2^n / binomial(2 n, n) of its variance
ORDER = 6
#: a gyroscope that shows so many times the noise density assumed is worth a word
NOTEWORTHY = 5.0
#: samples are evenly spaced where no interval is longer or shorter than the last by this factor
EVEN_RATIO = 1.5
_WEIGHTS = tuple((-1) ** j * math.comb(ORDER, j) / math.sqrt(math.comb(2 * ORDER, ORDER)) for j in range(ORDER + 1))


@njit(_nrt=False)
def show_noise(mem, k, dt):
    """Noise density squared of each axis, beside sample k, dt s after the one before it; what is known of that, where
    one of those that the difference needs is missing or not used."""
    if mem[White.ADAPT] == 0.0:
        return
    at, last = nonnegative(sample_at(mem, k)), nonnegative(sample_at(mem, k - 1))
    for i in range(7):
        mem[at + Shown.WHITE + i] = mem[last + Shown.WHITE + i]
    if k <= ORDER:
        return
    if mem[at + Sample.FAULT] != 0.0:
        return
    # differences of the first and of the last four of the six axes
    first, last = _WEIGHTS[0] * four(mem, at + Sample.F_X), _WEIGHTS[0] * four(mem, at + Sample.F_Z)
    for j in range(1, ORDER + 1):
        one, weight = nonnegative(sample_at(mem, k - j)), _WEIGHTS[j]
        interval = mem[one + Sample.INTERVAL] if j < ORDER else dt
        if mem[one + Sample.FAULT] != 0.0 or interval > EVEN_RATIO * dt or dt > EVEN_RATIO * interval:
            return
        first = first + weight * four(mem, one + Sample.F_X)
        last = last + weight * four(mem, one + Sample.F_Z)
    share, white = min(dt / MEAN_TIME, 1.0), at + Shown.WHITE
    known, others = four(mem, white), four(mem, white + 2)
    put(mem, white, known + share * (dt * first * first - known))
    put(mem, white + 2, others + share * (dt * last * last - others))
    mem[at + Shown.SIDEWAYS] += min(dt / LONG_MEAN_TIME, 1.0) * (mem[at + Shown.WHITE + 1] - mem[at + Shown.SIDEWAYS])
    if shown(mem, at, 3) > NOTEWORTHY**2:
        mem[White.SHAKEN] += dt


@njit(_nrt=False)
def density(mem, sample, axis):
    """Noise density squared of an axis at the sample at `sample`: as assumed, or as it shows itself."""
    return max(mem[WHITE + axis], mem[sample + Shown.WHITE + axis])


@njit(_nrt=False)
def hides_turns(mem, noise):
    """Whether a noise density squared of the accelerometers, m^2/s^3, moves the velocity by more within COMPARED_OVER
    than the sigma of the constraint on the velocity sideways."""
    return COMPARED_OVER * noise > mem[Head.LATERAL_SIGMA] ** 2


@njit(_nrt=False)
def shown(mem, sample, first):
    """Noise density squared used of a sensor over that assumed, of its noisiest axis at the sample at `sample`.

    first: its first axis, 0 of the accelerometers, 3 of the gyroscopes.
    """
    largest = 1.0
    for axis in range(first, first + 3):
        if mem[WHITE + axis] > 0.0:
            largest = max(largest, density(mem, sample, axis) / mem[WHITE + axis])
    return largest
