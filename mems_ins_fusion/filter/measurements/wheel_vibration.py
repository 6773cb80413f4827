"""Speed from the vibration of the wheels: an odometer for vehicles that give none (docs/wheel_vibration.md).

Every HOP seconds a window of the samples (`wheel_spectrum`) is compared with a wheel of circumference C at x, the
logarithm of the true over the filter's speed: harmonic h of an axis then has a line at h exp(x) / C cycles per metre of
the filter's way. With the power q of each such channel (logarithm, over its neighbourhood)

    T(x) = sum a (q(x) - b),     a = (on - off) / spread,  b = (on + off) / 2,

where `on` and `off` are the means of q that the channel has shown on the line and beside it while fixes told the speed,
`spread` its variance beside it: the discriminant of two normal distributions, zero for a channel that shows no line.
The likelihood of x, relative to no line at all, is

    NONE + (1 - NONE) exp(strength T(x)):

any window may be one without a line, and channels are not independent of each other. `strength` is the one that has
predicted best, each window before anything was learned of it. Where none of them has predicted better than nothing for
certain, nothing is told.

While fixes come, the windows tell the circumference: first a comb (C at which the lines of all windows add up), then a
Kalman filter of ln C. When none come they tell the speed: prior times likelihood on a grid, several peaks and all, and
its moments give the measurement of which the prior makes them.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ...parameters.parameter import Parameter
from ..memory import HEAD, NAV, SAMPLE, Event, Head, Nav, Sample, packed, place, sample_at, state_at, velocity_state
from .geometry import angular_rate
from .speed import rolling
from .wheel_spectrum import AXES, BINS, POINTS, SHORTEST, WINDOW, Row, Spectrum, look
from .wheel_spectrum import begin as begin_spectrum

#: where the memory of the wheels begins, 0: nobody listens; whether what is told is used
Wheels = HEAD.place('Wheels', AT=1, USED=1)
#: beside a sample: speed told at it, m/s, and its variance; 0: none
Told = SAMPLE.place('Told', SPEED=1, VARIANCE=1)
PARAMETER = Parameter(
    'wheel_vibration', 'off', 'text', 'Speed from the vibration of the wheels, their circumference found while fixes '
    'come. report: it is told on /diagnostics and in report.json; on: it is also used while no fixes come.',
    choices=('off', 'report', 'on'))

#: s from one window to the next: tapered windows that overlap by half are nearly independent
HOP = 2.0
#: m/s: below it the lines of the wheels lie among those of the suspension
SLOWEST = 4.0
#: rad/s: in a turn the wheels of both sides have two speeds, and lines split
FASTEST_TURN = 0.1
#: s: time constant of the turn rate that is compared with it
TURN_TIME = 0.5
HARMONICS = 3
CHANNELS = AXES * HARMONICS
#: of the grid of x: at 40 m/s a line of the third harmonic is 0.5 % wide
STEP = 0.003
HALF = 85  # grid points to either side of x = 0
GRID = 2 * HALF + 1
#: m: middle of the circumferences that are looked for, 1.5 to 2.5: cars and vans
MIDDLE = 1.94
#: cycles per metre that are looked at
HIGHEST = HARMONICS / MIDDLE * math.exp(STEP * HALF)
#: of a grid point that has no spectrum
NOTHING = -99.0
#: grid points beside the line that say nothing of the mean beside it: 5 %
LINE = 17
#: grid points to either side of the line that the filter's own speed may be off by, 0.6 %
NEAR = 2
#: windows over which what a channel shows is averaged: five minutes
MEMORY = 150.0
#: sigmas of the comb: of some twenty independent circumferences one is above it once in millions of drives
COMB_SIGMAS = 6.0
#: windows before which no comb is believed: half a minute
COMB_WINDOWS = 15.0
#: windows over which the comb forgets, ten minutes: a tyre may be changed
COMB_MEMORY = 300.0
#: sigma of ln C as the comb finds it, and what it may change by in a second: 0.1 % in ten minutes, as a tyre warms up
COMB_SIGMA, DRIFT = 0.01, 0.001**2 / 600.0
#: further from C the comb must be to have found another wheel
OTHER = 0.02
#: the larger variance of each look at C for errors of the fixes that last longer than a hop
LASTING = 2.0
#: ln C is good enough for telling a speed at this sigma
CALIBRATED = 0.005
#: exponents of the likelihood that are tried: channels are not independent
STRENGTHS = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
#: windows that none of them is chosen before, and the sigmas by which it must have predicted better than nothing
FEWEST, PROVEN = 20.0, 3.0
#: part of the windows that are without a line even so
NONE = 0.3
#: s after a fix until which fixes come
WITHOUT_FIX = 3.0
#: part of the speed that its sigma may be for windows to tell the circumference
KNOWN = 0.02
#: and above which no window tells a speed: the grid ends at twice that
LOST = 0.125
#: part of the prior's variance: a posterior that is larger tells nothing
TELLS = 0.8
#: s over which an error of the circumference is the same: with independent errors of the speeds told the position's
#: error after that time is the same as with one common error of sigma sqrt(HOP / OUTAGE) of theirs
OUTAGE = 60.0


class _Ear(NamedTuple):
    """Columns, from Wheels.AT on. From KEPT to KEPT_END is what the next start may begin with."""

    SINCE: int = 0  # s, time since which the vehicle goes straight and fast enough
    LAST: int = 1  # s, time of the last window
    TURN: int = 2  # rad/s
    TIME: int = 3  # s, way and values of the row that is not complete
    WAY: int = 4
    VALUES: int = 5
    ELAPSED: int = 11  # s so far
    HEARD: int = 12  # and of these with a line
    SPEED: int = 13  # told last, m/s, and its variance and time
    VARIANCE: int = 14
    TOLD: int = 15
    COMB_SEEN: int = 16
    COMB_VARIANCE: int = 17
    COMB: int = 18
    KEPT: int = COMB + GRID
    LOG_C: int = KEPT
    VARIANCE_C: int = KEPT + 1  # 0: unknown
    LEARNED: int = KEPT + 2  # windows that went into what follows
    ON: int = KEPT + 3
    OFF: int = ON + CHANNELS
    SPREAD: int = OFF + CHANNELS
    SCORE: int = SPREAD + CHANNELS  # mean of the logarithm of how much better each strength predicted than nothing
    SQUARE: int = SCORE + len(STRENGTHS)  # and its mean square
    KEPT_END: int = SQUARE + len(STRENGTHS)
    CHANNEL: int = KEPT_END  # room to work: power of each channel,
    TOTAL: int = CHANNEL + CHANNELS * GRID  # and T
    SPECTRUM: int = TOTAL + GRID
    SIZE: int = SPECTRUM + Spectrum.SIZE


Ear = _Ear()


def begin(memory: np.ndarray, at: int, used: bool) -> None:
    """Listen from now on, with the memory of the wheels at `at`."""
    memory[Wheels.AT], memory[Wheels.USED] = at, used
    memory[at + Ear.SPREAD:at + Ear.SPREAD + CHANNELS] = 1.0
    begin_spectrum(memory[at + Ear.SPECTRUM:at + Ear.SIZE])


def learned(memory: np.ndarray) -> np.ndarray | None:
    """What the filter with this memory knows of the wheels; None where nobody listens."""
    at = int(memory[Wheels.AT])
    return memory[at + Ear.KEPT:at + Ear.KEPT_END].copy() if at else None


def remember(memory: np.ndarray, kept: np.ndarray | None) -> None:
    """Begin with what an earlier filter has `learned`, if anything."""
    at = int(memory[Wheels.AT])
    if at and kept is not None:
        memory[at + Ear.KEPT:at + Ear.KEPT_END] = kept


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Predicted minus told speed; one component. It has no sign, and is that of the middle of the car."""
    rolling(mem, r, at, h, n, c, sample)
    mem[at + Event.R_NN] = mem[sample + Told.VARIANCE]
    mem[at + Event.Z_N] -= math.copysign(mem[sample + Told.SPEED], mem[at + Event.Z_N])
    return 1


@njit(_nrt=False)
def listen(mem, k):
    """Take in sample k, and at the end of a window tell the speed beside it; whether that is to be used."""
    at, sample, r = int(mem[Wheels.AT]), place(sample_at(mem, k)), place(state_at(mem, k))
    dt, time = mem[sample + Sample.INTERVAL], mem[sample + Sample.TIME]
    speed = math.sqrt(mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2 + mem[r + Nav.V_D] ** 2)
    mem[at + Ear.ELAPSED] += dt
    mem[at + Ear.TURN] += min(dt / TURN_TIME, 1.0) * (angular_rate(mem, r, sample)[2] - mem[at + Ear.TURN])
    if speed < SLOWEST or abs(mem[at + Ear.TURN]) > FASTEST_TURN or dt > mem[Head.MAX_GAP] or (
            mem[sample + Sample.FAULT] != 0.0):
        mem[at + Ear.SINCE] = time
        for i in range(Ear.TIME, Ear.ELAPSED):
            mem[at + i] = 0.0
        return False
    mem[at + Ear.TIME] += dt
    mem[at + Ear.WAY] += dt * speed
    for i in range(AXES):
        mem[at + Ear.VALUES + i] += dt * mem[sample + Sample.F_X + i]
    if mem[at + Ear.TIME] < SHORTEST:
        return False
    _put(mem, at)
    if time - mem[at + Ear.SINCE] < WINDOW or time - mem[at + Ear.LAST] < HOP - 0.5 * SHORTEST:
        return False
    mem[at + Ear.LAST] = time
    return _hear(mem, at, r, sample, speed)


@njit(_nrt=False)
def _put(mem, at):
    """The mean of the samples since the last row as the next row of the ring."""
    ring, lasted = at + Ear.SPECTRUM, mem[at + Ear.TIME]
    count = int(mem[ring + Spectrum.COUNT])
    row = ring + Spectrum.RING + Row.SIZE * (count % POINTS)
    mem[row + Row.TIME], mem[row + Row.SPEED] = lasted, mem[at + Ear.WAY] / lasted
    for i in range(AXES):
        mem[row + Row.VALUES + i] = mem[at + Ear.VALUES + i] / lasted
    mem[ring + Spectrum.COUNT] = count + 1.0
    for i in range(Ear.TIME, Ear.ELAPSED):
        mem[at + i] = 0.0


@njit(_nrt=False)
def follow(mem, change):
    """The speed has been corrected by `change`, m/s: so were those of the samples before it."""
    ring = int(mem[Wheels.AT]) + Ear.SPECTRUM + Spectrum.RING
    for i in range(POINTS):
        mem[ring + Row.SIZE * i + Row.SPEED] += change


@njit(_nrt=False)
def along_variance(mem, r):
    """Variance of the speed over ground of the state at r, m^2/s^2."""
    v, n_navigation = velocity_state(mem), int(mem[Head.N_NAVIGATION])
    p = place(r + NAV + n_navigation + int(mem[Head.N_AUGMENTED]))
    v_n, v_e = mem[r + Nav.V_N], mem[r + Nav.V_E]
    total = (v_n * v_n * mem[p + packed(v, v, n_navigation)] + v_e * v_e * mem[p + packed(v + 1, v + 1, n_navigation)]
             + 2.0 * v_n * v_e * mem[p + packed(v, v + 1, n_navigation)])
    return max(mem[r + Nav.VARIANCE_FACTOR], 1.0) * total / max(v_n * v_n + v_e * v_e, 1e-6)


@njit(_nrt=False)
def _hear(mem, at, r, sample, speed):
    """What the window that ends at the state at r says; whether it tells a speed that is to be used."""
    time, way, last = look(mem, at + Ear.SPECTRUM, HIGHEST)
    mean = way / time
    variance = along_variance(mem, r) / (mean * mean)  # of x
    fixes_come = mem[r + Nav.TIME] - mem[r + Nav.RESIDUAL_TIME] < WITHOUT_FIX
    if fixes_come and variance < KNOWN**2:
        _comb(mem, at, way, last)
    if mem[at + Ear.VARIANCE_C] == 0.0:
        return False
    _channels(mem, at, way, last, mem[at + Ear.LOG_C])
    _discriminate(mem, at)
    strength = _strength(mem, at)
    mem[at + Ear.VARIANCE_C] += DRIFT * HOP
    prior = variance + mem[at + Ear.VARIANCE_C]
    middle, spread, heard = _posterior(mem, at, strength, prior)
    noise = 1.0 / (1.0 / spread - 1.0 / prior) if spread < TELLS * prior else 0.0
    if strength > 0.0 and heard > 1.0 and mem[at + Ear.VARIANCE_C] < CALIBRATED**2:
        mem[at + Ear.HEARD] += HOP
        mem[at + Ear.SPEED], mem[at + Ear.TOLD] = speed + middle * mean, mem[sample + Sample.TIME]
        mem[at + Ear.VARIANCE] = mean * mean * spread
        if noise > 0.0 and not fixes_come and mem[Wheels.USED] > 0.0:
            mem[sample + Told.SPEED] = speed + middle * (prior + noise) / prior * mean
            mem[sample + Told.VARIANCE] = mean * mean * (noise + mem[at + Ear.VARIANCE_C] * OUTAGE / HOP)
            return True
    if fixes_come and variance < KNOWN**2:
        _score(mem, at, mean)
        _learn(mem, at)
        if noise > 0.0:
            gain = mem[at + Ear.VARIANCE_C] / (mem[at + Ear.VARIANCE_C] + LASTING * (variance + noise))
            mem[at + Ear.LOG_C] -= gain * middle * (prior + noise) / prior
            mem[at + Ear.VARIANCE_C] *= 1.0 - gain
    return False


@njit(_nrt=False)
def _channels(mem, at, way, last, log_c):
    """Power of each channel on the grid of x for the circumference exp(log_c)."""
    power, ratio = at + Ear.SPECTRUM + Spectrum.POWER, math.exp(STEP)
    for h in range(HARMONICS):
        place = 2.0 * (h + 1) * way * math.exp(-log_c - HALF * STEP)
        for i in range(GRID):
            j = int(place)
            share = place - j
            for axis in range(AXES):
                value = NOTHING
                if j < last:
                    value = (1.0 - share) * mem[power + BINS * axis + j] + share * mem[power + BINS * axis + j + 1]
                mem[at + Ear.CHANNEL + GRID * (AXES * h + axis) + i] = value
            place *= ratio


@njit(_nrt=False)
def _comb(mem, at, way, last):
    """Find the circumference at which the lines of all windows add up."""
    _channels(mem, at, way, last, math.log(MIDDLE))
    mean, square, best = 0.0, 0.0, 0
    for i in range(GRID):
        total = 0.0
        for channel in range(CHANNELS):
            value = mem[at + Ear.CHANNEL + GRID * channel + i]
            total += value if value > NOTHING else 0.0
        mem[at + Ear.TOTAL + i] = total
        mean += total / GRID
    forget = 1.0 - 1.0 / COMB_MEMORY
    for i in range(GRID):
        above = mem[at + Ear.TOTAL + i] - mean
        square += above * above / GRID
        mem[at + Ear.COMB + i] = forget * mem[at + Ear.COMB + i] + above
        if mem[at + Ear.COMB + i] > mem[at + Ear.COMB + best]:
            best = i
    mem[at + Ear.COMB_SEEN] = forget * mem[at + Ear.COMB_SEEN] + 1.0
    mem[at + Ear.COMB_VARIANCE] = forget**2 * mem[at + Ear.COMB_VARIANCE] + square
    sigmas = mem[at + Ear.COMB + best] / math.sqrt(mem[at + Ear.COMB_VARIANCE])
    if mem[at + Ear.COMB_SEEN] < COMB_WINDOWS or sigmas < COMB_SIGMAS:
        return
    log_c = math.log(MIDDLE) - (best - HALF) * STEP
    if mem[at + Ear.VARIANCE_C] == 0.0 or abs(log_c - mem[at + Ear.LOG_C]) > OTHER:
        for i in range(Ear.KEPT, Ear.KEPT_END):
            mem[at + i] = 1.0 if Ear.SPREAD <= i < Ear.SCORE else 0.0
        mem[at + Ear.LOG_C], mem[at + Ear.VARIANCE_C] = log_c, COMB_SIGMA**2


@njit(_nrt=False)
def _discriminate(mem, at):
    """T on the grid of x from the power of the channels and what they have shown."""
    for i in range(GRID):
        mem[at + Ear.TOTAL + i] = 0.0
    for channel in range(CHANNELS):
        on, off, spread = mem[at + Ear.ON + channel], mem[at + Ear.OFF + channel], mem[at + Ear.SPREAD + channel]
        # no more than is certain
        shown = on - off - math.sqrt(2.0 * spread / max(mem[at + Ear.LEARNED], 1.0))
        if shown > 0.0:
            for i in range(GRID):
                value = mem[at + Ear.CHANNEL + GRID * channel + i]
                if value > NOTHING:
                    mem[at + Ear.TOTAL + i] += shown / spread * (value - 0.5 * (on + off))


@njit(_nrt=False)
def _likelihood(mem, at, strength, i):
    """Of grid point i over that of no line."""
    return NONE + (1.0 - NONE) * math.exp(strength * mem[at + Ear.TOTAL + i])


@njit(_nrt=False)
def _strength(mem, at):
    """The exponent that has predicted best; 0: none better than nothing for certain."""
    best, strength, n = 0.0, 0.0, mem[at + Ear.LEARNED]
    if n < FEWEST:
        return 0.0
    for s in range(len(STRENGTHS)):
        score = mem[at + Ear.SCORE + s]
        sigma = math.sqrt(max(mem[at + Ear.SQUARE + s] - score * score, 0.0) / n)
        if score > best and score > PROVEN * sigma:
            best, strength = score, STRENGTHS[s]
    return strength


@njit(_nrt=False)
def _posterior(mem, at, strength, variance):
    """Mean and variance of x with the prior N(0, variance), and the likelihood of the window over that of no line."""
    if variance > LOST**2:
        return 0.0, variance, 0.0
    total, first, second, prior = 0.0, 0.0, 0.0, 0.0
    for i in range(GRID):
        x = STEP * (i - HALF)
        expected = math.exp(-0.5 * x * x / variance)
        weight = expected * _likelihood(mem, at, strength, i)
        prior += expected
        total += weight
        first += weight * x
        second += weight * x * x
    return first / total, second / total - (first / total) ** 2, total / prior


@njit(_nrt=False)
def _score(mem, at, speed):
    """How much better than nothing each strength has predicted where the line is, among speeds within LOST."""
    n = min(mem[at + Ear.LEARNED] + 1.0, MEMORY)
    for s in range(len(STRENGTHS)):
        near = everywhere = 0.0
        for i in range(GRID):
            value = _likelihood(mem, at, STRENGTHS[s], i)
            everywhere += value / GRID
            if abs(i - HALF) <= NEAR:
                near += value / (2 * NEAR + 1)
        score = math.log(near / everywhere)
        mem[at + Ear.SCORE + s] += (score - mem[at + Ear.SCORE + s]) / n
        mem[at + Ear.SQUARE + s] += (score * score - mem[at + Ear.SQUARE + s]) / n


@njit(_nrt=False)
def _learn(mem, at):
    """What each channel shows on the line and beside it."""
    n = min(mem[at + Ear.LEARNED] + 1.0, MEMORY)
    mem[at + Ear.LEARNED] = n
    for channel in range(CHANNELS):
        values = at + Ear.CHANNEL + GRID * channel
        if mem[values] == NOTHING or mem[values + GRID - 1] == NOTHING:
            continue
        beside, square, count = 0.0, 0.0, 2.0 * (HALF - LINE)
        for i in range(GRID):
            if abs(i - HALF) > LINE:
                beside += mem[values + i] / count
                square += mem[values + i] ** 2 / count
        mem[at + Ear.ON + channel] += (mem[values + HALF] - mem[at + Ear.ON + channel]) / n
        mem[at + Ear.OFF + channel] += (beside - mem[at + Ear.OFF + channel]) / n
        variance = square - beside * beside
        mem[at + Ear.SPREAD + channel] += (variance - mem[at + Ear.SPREAD + channel]) / n
