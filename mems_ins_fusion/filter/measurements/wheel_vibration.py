"""Speed from the vibration of the wheels: told beside the estimate, which it never changes (docs/wheel_vibration.md).

Every HOP seconds a window of the samples (`wheel_spectrum`) is compared with a wheel of circumference C at x, the
logarithm of the true over the filter's speed: harmonic h of an axis then has a line at h exp(x) / C cycles per metre of
the filter's way. With the power q of each such channel (logarithm, over its neighbourhood)

    T(x) = sum a (q(x) - b),     a = (on - off) / spread,  b = (on + off) / 2,

where `on` and `off` are the means of q that the channel has shown on the line and beside it while fixes told the speed,
`spread` its variance beside it: the discriminant of two normal distributions, zero for a channel that shows no line.
The likelihood of x, relative to no line at all, is

    NONE + (1 - NONE) exp(strength T(x)):

any window may be one without a line, and neither channels nor windows are independent of each other (strength < 1).
Where it has not predicted better than nothing for certain, each window before anything was learned of it, nothing is
told.

While fixes come, the windows tell the circumference: first a comb (C at which the lines of all windows add up), then a
Kalman filter of ln C. When none come they tell the speed: its density on a grid goes from window to window, several
peaks and all. No estimate uses it: on measured drives the errors without fixes did not become smaller for certain.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ...parameters.parameter import Parameter
from ..memory import (
    HEAD,
    NAV,
    Error,
    Head,
    Nav,
    Sample,
    nonnegative,
    packed,
    row_of,
    sample_at,
    state_at,
    velocity_state,
)
from .geometry import angular_rate
from .wheel_spectrum import AXES, BINS, POINTS, SHORTEST, WINDOW, Row, Spectrum, look
from .wheel_spectrum import begin as begin_spectrum

#: where the memory of the wheels begins, 0: wheel_vibration is off
Wheels = HEAD.place('Wheels', AT=1)
PARAMETER = Parameter(
    'wheel_vibration', 'off', 'text', 'Speed from the vibration of the wheels, their circumference found while fixes '
    'come. report: both are told on /diagnostics and in report.json. No estimate uses them, and none can: on measured '
    'drives the errors without fixes did not become smaller for certain (docs/wheel_vibration.md).',
    choices=('off', 'report'))

#: s from one window to the next: tapered windows that overlap by half are nearly independent
HOP = 2.0
#: m/s: below it the lines of the wheels lie among those of the suspension
SLOWEST = 4.0
#: rad/s: in a turn the wheels of both sides have two speeds, and lines split
FASTEST_TURN = 0.1
#: s: time constant of the turn rate that is compared with it
TURN_TIME = 0.5
HARMONICS = 4
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
#: and of how well the windows predict, two minutes: a wheel that is another all of a sudden is found out so soon
SCORE_MEMORY = 60.0
#: variance of the logarithm of the power of a channel: noise has 1.6
LEAST_SPREAD = 0.1
#: sigmas of the comb: of some twenty independent circumferences one is above it once in millions of drives
COMB_SIGMAS = 6.0
#: windows before which no comb is believed: half a minute
COMB_WINDOWS = 15.0
#: windows over which the comb forgets, ten minutes: a tyre may be changed
COMB_MEMORY = 300.0
#: sigma of ln C as the comb finds it
COMB_SIGMA = 0.01
#: variance that ln C gains in a second: 0.1 % in ten minutes, as a tyre warms up
DRIFT = 0.001**2 / 600.0
#: and never less: engine orders that go with the wheels in one gear pull it
LEAST_SIGMA = 0.003
#: windows over which what the looks at ln C say against it is averaged
AGAINST_MEMORY = 20.0
#: sigmas of that mean beyond which it is another wheel's, or no wheel's
AGAINST = 4.0
#: the sigma of ln C then: of one that has hardly been seen, with which nothing is told
REOPENED = 0.015
#: sigma of what it may be else after the vehicle was parked: pressure and load
PARKED = 0.003
#: further from C the comb must be to have found another wheel
OTHER = 0.02
#: the larger variance of each look at C for errors of the fixes that last longer than a hop
LASTING = 2.0
#: ln C is good enough for telling a speed at this sigma
CALIBRATED = 0.01
#: exponent of the likelihood of windows in a row: what is no line of the wheels shows in several channels, and in the
#: next window again. Sums over four windows of measured drives were right wherever they were certain, with 0.5 in 94 %
STRENGTH = 0.2
#: and of one by itself, as the circumference has them, one drive long: only channels share their errors
ALONE = 0.5
#: windows before which nothing is told: 40 s of straight driving
FEWEST = 20.0
#: sigmas by which they must have predicted better than nothing
PROVEN = 3.0
#: part of the windows that are without a line even so
NONE = 0.3
#: s after a fix until which fixes come
WITHOUT_FIX = 3.0
#: part of the speed that its sigma may be for windows to tell the circumference
KNOWN = 0.03
#: m/s: of the grid of the error of the filter's speed
SPEED_STEP = 0.05
SPEED_HALF = 80
SPEEDS = 2 * SPEED_HALF + 1
#: m/s: sigma of the filter's speed above which no speed is told, half of the grid
LOST = 2.0
#: of the density: no speed is impossible
NEVER = 1e-12

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
    AGAINST: int = 16  # mean of what the looks at ln C say against it, sigmas
    COMB_SEEN: int = 17
    COMB_VARIANCE: int = 18
    COMB: int = 19
    KEPT: int = COMB + GRID
    LOG_C: int = KEPT
    VARIANCE_C: int = KEPT + 1  # 0: unknown
    LEARNED: int = KEPT + 2  # windows that went into what follows
    ON: int = KEPT + 3
    OFF: int = ON + CHANNELS
    SPREAD: int = OFF + CHANNELS
    SCORE: int = SPREAD + CHANNELS  # mean of the logarithm of how much better than nothing windows have predicted
    SQUARE: int = SCORE + 1  # and its mean square
    KEPT_END: int = SQUARE + 1
    FILTERED: int = KEPT_END  # variance of the filter's speed at the last window, m^2/s^2
    DENSITY: int = FILTERED + 1  # of the error of the filter's speed
    CHANNEL: int = DENSITY + SPEEDS  # room to work: power of each channel,
    TOTAL: int = CHANNEL + CHANNELS * GRID  # and T
    SPECTRUM: int = TOTAL + GRID
    SIZE: int = SPECTRUM + Spectrum.SIZE


Ear = _Ear()


def begin(memory: np.ndarray, at: int) -> None:
    """Listen from now on, with the memory of the wheels at `at`."""
    memory[Wheels.AT] = at
    memory[at + Ear.SPREAD:at + Ear.SPREAD + CHANNELS] = 1.0
    begin_spectrum(memory[at + Ear.SPECTRUM:at + Ear.SIZE])


def learned(memory: np.ndarray) -> np.ndarray | None:
    """What the filter with this memory knows of the wheels, for `remember`; None where it knows nothing."""
    at = int(memory[Wheels.AT])
    known = at and memory[at + Ear.VARIANCE_C] > 0.0
    return memory[at + Ear.KEPT:at + Ear.KEPT_END].copy() if known else None


def aged(kept: np.ndarray) -> np.ndarray:
    """What a filter has `learned`, for the next start: tyres may be cold or full by then. ValueError where it is not
    that."""
    kept = np.array(kept, dtype=float)
    if kept.shape != (Ear.KEPT_END - Ear.KEPT,) or not np.isfinite(kept).all():
        raise ValueError('not what a filter has learned of wheels')
    c, variance, windows = kept[[Ear.LOG_C - Ear.KEPT, Ear.VARIANCE_C - Ear.KEPT, Ear.LEARNED - Ear.KEPT]]
    spread = kept[Ear.SPREAD - Ear.KEPT:Ear.SCORE - Ear.KEPT]
    if abs(c - math.log(MIDDLE)) > 2 * HALF * STEP or variance <= 0.0 or windows < 0.0 or (spread < 0.0).any():
        raise ValueError('not what a filter can have learned of wheels')
    kept[Ear.VARIANCE_C - Ear.KEPT] += PARKED**2
    return kept


def summary(memory: np.ndarray) -> dict | None:
    """Circumference and its sigma, m, None while it is unknown, and the share of the time with a line, percent; None
    where nobody listens."""
    at = int(memory[Wheels.AT])
    if not at:
        return None
    sigma, elapsed = math.sqrt(memory[at + Ear.VARIANCE_C]), memory[at + Ear.ELAPSED]
    c = math.exp(memory[at + Ear.LOG_C]) if sigma else None
    return {'circumference_m': c, 'sigma_m': c and c * sigma,
            'share_of_time_percent': float(100.0 * memory[at + Ear.HEARD] / max(elapsed, HOP))}


def told(memory: np.ndarray, now: float) -> dict[str, float]:
    """Numbers for a diagnosis, by name with the unit; now: s, the time of the newest sample."""
    found, at = summary(memory), int(memory[Wheels.AT])
    if found is None or found['circumference_m'] is None:
        return {}
    numbers = {'circumference of the wheels, m': found['circumference_m'],
               'circumference of the wheels sigma, m': found['sigma_m'],
               'share of the time in which the wheels are heard, %': found['share_of_time_percent']}
    if memory[at + Ear.VARIANCE] > 0.0:
        numbers |= {'speed by the wheels, m/s': float(memory[at + Ear.SPEED]),
                    'speed by the wheels sigma, m/s': math.sqrt(memory[at + Ear.VARIANCE]),
                    'age of the speed by the wheels, s': now - float(memory[at + Ear.TOLD])}
    return numbers


def remember(memory: np.ndarray, kept: np.ndarray | None) -> None:
    """Begin with what an earlier filter has `learned`, if anything."""
    at = int(memory[Wheels.AT])
    if at and kept is not None:
        memory[at + Ear.KEPT:at + Ear.KEPT_END] = kept


@njit(_nrt=False)
def listen(mem, k):
    """Take in sample k, and at the end of a window tell the speed."""
    at, sample, r = int(mem[Wheels.AT]), nonnegative(sample_at(mem, k)), nonnegative(state_at(mem, k))
    dt, time = mem[sample + Sample.INTERVAL], mem[sample + Sample.TIME]
    speed = speed_of(mem, r)
    mem[at + Ear.ELAPSED] += dt
    mem[at + Ear.TURN] += min(dt / TURN_TIME, 1.0) * (angular_rate(mem, r, sample)[2] - mem[at + Ear.TURN])
    if speed < SLOWEST or abs(mem[at + Ear.TURN]) > FASTEST_TURN or dt > mem[Head.MAX_GAP] or (
            mem[sample + Sample.FAULT] != 0.0):
        mem[at + Ear.SINCE] = time
        for i in range(Ear.TIME, Ear.ELAPSED):
            mem[at + i] = 0.0
        return
    mem[at + Ear.TIME] += dt
    mem[at + Ear.WAY] += dt * speed
    for i in range(AXES):
        mem[at + Ear.VALUES + i] += dt * mem[sample + Sample.F_X + i]
    if mem[at + Ear.TIME] < SHORTEST:
        return
    _put(mem, at)
    if time - mem[at + Ear.SINCE] >= WINDOW and time - mem[at + Ear.LAST] >= HOP - 0.5 * SHORTEST:
        _hear(mem, at, r, sample, speed)


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
def speed_of(mem, r):
    """Speed of the state at r, m/s, without its estimated error."""
    total = 0.0
    for i in range(3):
        state = row_of(mem, Error.V_N + i)
        v = mem[r + Nav.V_N + i] - (mem[r + NAV + state] if state >= 0 else 0.0)
        total += v * v
    return math.sqrt(total)


@njit(_nrt=False)
def along_variance(mem, r):
    """Variance of the speed over ground of the state at r, m^2/s^2."""
    v, n_navigation = velocity_state(mem), int(mem[Head.N_NAVIGATION])
    p = nonnegative(r + NAV + n_navigation + int(mem[Head.N_AUGMENTED]))
    v_n, v_e = mem[r + Nav.V_N], mem[r + Nav.V_E]
    total = (v_n * v_n * mem[p + packed(v, v, n_navigation)] + v_e * v_e * mem[p + packed(v + 1, v + 1, n_navigation)]
             + 2.0 * v_n * v_e * mem[p + packed(v, v + 1, n_navigation)])
    return max(mem[r + Nav.VARIANCE_FACTOR], 1.0) * total / max(v_n * v_n + v_e * v_e, 1e-6)


@njit(_nrt=False)
def _hear(mem, at, r, sample, speed):
    """What the window that ends at the state at r says."""
    time, way, last = look(mem, at + Ear.SPECTRUM, HIGHEST)
    mean, filtered, now = way / time, along_variance(mem, r), mem[sample + Sample.TIME]
    fixes_come = now - mem[r + Nav.RESIDUAL_TIME] < WITHOUT_FIX
    in_a_row, mem[at + Ear.LAST] = now - mem[at + Ear.LAST] < 1.5 * HOP, now
    learns = fixes_come and filtered < (KNOWN * mean) ** 2
    if learns:
        _comb(mem, at, way, last)
    if mem[at + Ear.VARIANCE_C] == 0.0:
        return
    _channels(mem, at, way, last, mem[at + Ear.LOG_C])
    _discriminate(mem, at)
    mem[at + Ear.VARIANCE_C] += DRIFT * HOP
    lost = filtered > LOST**2
    if fixes_come or not in_a_row or lost:
        _begin_density(mem, at, filtered + mem[at + Ear.VARIANCE_C] * mean * mean)
    else:
        _carry_density(mem, at, filtered - mem[at + Ear.FILTERED])
    mem[at + Ear.FILTERED] = filtered
    middle, spread, heard = _weigh(mem, at, mean, ALONE if fixes_come else STRENGTH)
    if _is_proven(mem, at) and heard > 1.0 and mem[at + Ear.VARIANCE_C] < CALIBRATED**2 and not lost:
        mem[at + Ear.HEARD] += HOP
        mem[at + Ear.SPEED], mem[at + Ear.TOLD] = speed + middle, now
        mem[at + Ear.VARIANCE] = spread + mem[at + Ear.VARIANCE_C] * mean * mean
    if learns:
        _score(mem, at)
        _learn(mem, at)
        _learn_circumference(mem, at, filtered / mean**2, middle / mean, spread / mean**2)


@njit(_nrt=False)
def _learn_circumference(mem, at, variance, middle, spread):
    """ln C from mean and variance of x after a window, where the filter's speed has `variance` of x."""
    prior = variance + mem[at + Ear.VARIANCE_C]
    if spread > 0.999 * prior:
        return
    noise = 1.0 / (1.0 / spread - 1.0 / prior)
    innovation, s = middle * (prior + noise) / prior, mem[at + Ear.VARIANCE_C] + LASTING * (variance + noise)
    gain = mem[at + Ear.VARIANCE_C] / s
    mem[at + Ear.LOG_C] -= gain * innovation
    mem[at + Ear.VARIANCE_C] = max(mem[at + Ear.VARIANCE_C] * (1.0 - gain), LEAST_SIGMA**2)
    mem[at + Ear.AGAINST] += (innovation / math.sqrt(s) - mem[at + Ear.AGAINST]) / AGAINST_MEMORY
    if abs(mem[at + Ear.AGAINST]) > AGAINST / math.sqrt(2.0 * AGAINST_MEMORY - 1.0):
        mem[at + Ear.VARIANCE_C], mem[at + Ear.AGAINST] = REOPENED**2, 0.0


@njit(_nrt=False)
def _begin_density(mem, at, variance):
    """The speed's error is normal with `variance`, as the filter says."""
    for i in range(SPEEDS):
        error = SPEED_STEP * (i - SPEED_HALF)
        mem[at + Ear.DENSITY + i] = math.exp(-0.5 * error * error / max(variance, SPEED_STEP**2))


@njit(_nrt=False)
def _carry_density(mem, at, variance):
    """The density of the error from one window to the next: wider by what the filter's variance has grown by."""
    density = at + Ear.DENSITY
    while variance > 0.0:  # each step mixes neighbours
        share = min(0.5 * variance / SPEED_STEP**2, 0.25)
        before = 0.0
        for i in range(SPEEDS):
            here = mem[density + i]
            after = mem[density + i + 1] if i + 1 < SPEEDS else 0.0
            mem[density + i] = here + share * (before - 2.0 * here + after)
            before = here
        variance -= 2.0 * share * SPEED_STEP**2 if share == 0.25 else variance


@njit(_nrt=False)
def _weigh(mem, at, speed, strength):
    """Multiply the density with the likelihood of a window of this mean speed: mean and variance of the error, and the
    likelihood of the window over that of no line."""
    density, total, first, second, before = at + Ear.DENSITY, 0.0, 0.0, 0.0, 0.0
    for i in range(SPEEDS):
        error = SPEED_STEP * (i - SPEED_HALF)
        x = HALF + math.log(max(1.0 + error / speed, 0.1)) / STEP
        score, j = 0.0, int(x)
        if x >= 0.0 and j + 1 < GRID:
            score = mem[at + Ear.TOTAL + j] + (x - j) * (mem[at + Ear.TOTAL + j + 1] - mem[at + Ear.TOTAL + j])
        mem[density + i] += NEVER
        before += mem[density + i]
        mem[density + i] *= _likelihood(strength * score)
        total += mem[density + i]
        first += mem[density + i] * error
        second += mem[density + i] * error * error
    for i in range(SPEEDS):
        mem[density + i] /= total
    variance = max(second / total - (first / total) ** 2, (0.5 * SPEED_STEP) ** 2)
    return first / total, variance, total / before


@njit(_nrt=False)
def _likelihood(score):
    """Of `score`, strength times T, over that of no line."""
    return NONE + (1.0 - NONE) * math.exp(score)


@njit(_nrt=False)
def _is_proven(mem, at):
    """Whether the windows have predicted better than nothing for certain."""
    n, score = min(mem[at + Ear.LEARNED], SCORE_MEMORY), mem[at + Ear.SCORE]
    return n >= FEWEST and score > PROVEN * math.sqrt(max(mem[at + Ear.SQUARE] - score * score, 0.0) / n)


@njit(_nrt=False)
def _channels(mem, at, way, last, log_c):
    """Power of each channel on the grid of x for the circumference exp(log_c)."""
    power, ratio = at + Ear.SPECTRUM + Spectrum.POWER, math.exp(STEP)
    for h in range(HARMONICS):
        line = 2.0 * (h + 1) * way * math.exp(-log_c - HALF * STEP)  # bin
        for i in range(GRID):
            j = int(line)
            share = line - j
            for axis in range(AXES):
                value = NOTHING
                if j < last:
                    value = (1.0 - share) * mem[power + BINS * axis + j] + share * mem[power + BINS * axis + j + 1]
                mem[at + Ear.CHANNEL + GRID * (AXES * h + axis) + i] = value
            line *= ratio


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
    if mem[at + Ear.COMB_SEEN] < COMB_WINDOWS or (
            mem[at + Ear.COMB + best] <= COMB_SIGMAS * math.sqrt(mem[at + Ear.COMB_VARIANCE])):
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
def _score(mem, at):
    """How much better than nothing the window has predicted where the line is."""
    n, near, everywhere = min(mem[at + Ear.LEARNED] + 1.0, SCORE_MEMORY), 0.0, 0.0
    for i in range(GRID):
        value = _likelihood(STRENGTH * mem[at + Ear.TOTAL + i])
        everywhere += value / GRID
        if abs(i - HALF) <= NEAR:
            near += value / (2 * NEAR + 1)
    score = math.log(near / everywhere)
    mem[at + Ear.SCORE] += (score - mem[at + Ear.SCORE]) / n
    mem[at + Ear.SQUARE] += (score * score - mem[at + Ear.SQUARE]) / n


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
        variance = max(square - beside * beside, LEAST_SPREAD)
        mem[at + Ear.SPREAD + channel] += (variance - mem[at + Ear.SPREAD + channel]) / n
