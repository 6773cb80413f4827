"""Speed from the vibration of the wheels: a diagnostic output that changes no estimate (docs/wheel_vibration.md).

Every HOP seconds a window of IMU samples (wheel_spectrum.py) is compared with a wheel of circumference C. Let x be the
logarithm of true speed over the filter's speed. Harmonic h has a line at h exp(x) / C cycles per metre, where metres
are those of the filter. A channel is one axis and one harmonic; q is the logarithm of its power over that of its
neighbourhood. The discriminant of two normal distributions, line and no line, is

    T(x) = sum a (q(x) - b),     a = (on - off) / spread,  b = (on + off) / 2,

where `on` and `off` are the channel's mean q on the line and beside it, learned while fixes gave the speed, and
`spread` is its variance beside the line. A channel without a line does not contribute. The likelihood of x over that of
no line is

    NO_LINE + (1 - NO_LINE) exp(exponent T(x)):

as a window may have no line, and neither channels nor windows are independent (exponent < 1). No speed is reported
until the windows have predicted significantly better than chance; each window is tested before it is used for learning.

While fixes come, the windows give the circumference: first by a search for the C at which the sum of the lines of all
windows is largest (a comb), then by a Kalman filter of ln C. Without fixes they give the speed: its probability density
on a grid, which may have several peaks, is propagated from window to window.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ...parameters.parameter import Parameter
from ..columns import numbered
from ..memory import (
    HEAD,
    NAV,
    Error,
    Head,
    Nav,
    Sample,
    element_at,
    nonnegative,
    row_of,
    sample_at,
    state_at,
    velocity_state,
)
from .acceleration import error_variance
from .geometry import angular_rate
from .wheel_spectrum import AXES, BINS, MEAN_OVER, POINTS, SHORTEST, SPECTRUM_WINDOW, Row, Spectrum, look
from .wheel_spectrum import begin as begin_spectrum

#: position of the columns `Lines` in the memory, 0: wheel_vibration is off
Wheels = HEAD.place('Wheels', AT=1)
PARAMETER = Parameter(
    'wheel_vibration', 'off', 'text', 'Speed from the vibration of the wheels, their circumference found while fixes '
    'come. report: both are reported on /diagnostics and in report.json. No estimate uses them: on measured drives the '
    'errors without fixes did not become significantly smaller (docs/wheel_vibration.md).',
    choices=('off', 'report'))

HOP = 2.0  # s between windows: tapered windows that overlap by half are nearly independent
SLOWEST = 4.0  # m/s: below this speed the lines of the wheels lie among those of the suspension
FASTEST_TURN = 0.1  # rad/s: above this turn rate the wheels of the two sides have different speeds, and lines split
TURN_LOW_PASS = 0.5  # s, time constant of the low pass of the turn rate
HARMONICS = 4  # multiples of the revolution that are looked at
CHANNELS = AXES * HARMONICS  # number of powers that are looked at in each window
LOG_STEP = 0.003  # step of the grid of x: at 40 m/s a line of the third harmonic is 0.5 % wide
HALF = 85  # grid points to either side of x = 0
GRID = 2 * HALF + 1  # number of grid points of x
MIDDLE = 1.94  # m, geometric mean of the circumferences searched, 1.5 to 2.5: cars and vans
HIGHEST_FREQUENCY = HARMONICS / MIDDLE * math.exp(LOG_STEP * HALF)  # highest frequency looked at, cycles per metre
NO_POWER = -99.0  # power of a grid point beyond the spectrum
LINE_HALF_WIDTH = 17  # half width of a line, grid points (5 %): these are left out of the mean beside it
SCORE_HALF_WIDTH = 2  # error of the filter's own speed that the score allows, grid points to either side (0.6 %)
SCORE_MEMORY = 60.0  # windows over which the score is averaged: two minutes, so that another wheel is noticed soon
LEAST_SPREAD = 0.1  # smallest variance of a channel's logarithmic power; noise has 1.6
#: sigmas by which the sum for a circumference has to exceed zero in the search: chance does so once in millions of
#: drives
COMB_SIGMAS = 6.0
COMB_WINDOWS = 15.0  # number of windows that the search needs: half a minute
COMB_MEMORY = 300.0  # number of windows over which the search is averaged: ten minutes, as a tyre may be changed
COMB_SIGMA = 0.01  # standard deviation of ln C as the search finds it
C_DRIFT = 0.001**2 / 600.0  # 1/s, variance that ln C gains: 0.1 % in ten minutes, as a tyre warms up
LEAST_SIGMA = 0.003  # smallest standard deviation of ln C: engine orders that follow the wheels in one gear bias it
INNOVATION_MEMORY = 20.0  # windows over which the normalized innovation of ln C is averaged
INNOVATION_LIMIT = 4.0  # sigmas of that mean beyond which the lines are of another wheel, or of no wheel
#: standard deviation of ln C that is set then: larger than LARGEST_C_SIGMA, so that no speed is reported
REOPENED_SIGMA = 0.015
PARKED_SIGMA = 0.003  # standard deviation by which ln C may change while the vehicle is parked: pressure and load
NEW_WHEEL = 0.02  # ln C that the search finds is of another wheel beyond this difference
#: factor on the variance of each innovation of ln C: errors of the fixes last longer than one window
FIX_ERROR_FACTOR = 2.0
LARGEST_C_SIGMA = 0.01  # standard deviation of ln C above which no speed is reported
#: exponent of the likelihood of successive windows: interference shows in several channels and windows. With 0.5, sums
#: over four windows of measured drives that were certain were right in only 94 %
EXPONENT = 0.2
#: exponent of the likelihood of one window, for the circumference: only channels share their errors
EXPONENT_SINGLE = 0.5
FEWEST_WINDOWS = 20.0  # windows before which no speed is reported: 40 s of straight driving
PROVEN = 3.0  # sigmas by which the mean score must exceed zero before a speed is reported
NO_LINE = 0.3  # prior probability of a window without a line
WITHOUT_FIX = 3.0  # s after the last fix used from which there are no fixes
#: largest standard deviation of the filter's speed, as a share of the speed, for windows to teach the circumference
RELATIVE_SPEED_SIGMA = 0.03
SPEED_STEP = 0.05  # m/s, step of the grid of the error of the filter's speed
SPEED_HALF = 80  # grid points to either side of zero
SPEEDS = 2 * SPEED_HALF + 1  # number of grid points of that error
#: m/s, standard deviation of the filter's speed above which no speed is reported: half of the grid
LARGEST_SPEED_SIGMA = 2.0
DENSITY_FLOOR = 1e-12  # added to each point of the density: no speed is impossible

column = numbered()


class _Lines(NamedTuple):
    """Columns, counted from Wheels.AT. From CALIBRATION to CALIBRATION_END is what outlasts the run."""

    SINCE: int = column()  # s, time since which the vehicle goes straight and fast enough
    LAST: int = column()  # s, time of the last window
    TURN: int = column()  # rad/s, low-passed turn rate
    TIME: int = column()  # the row that is being averaged: its duration, s,
    WAY: int = column()  # distance, m,
    VALUES: int = column(AXES)  # and sums of samples
    ELAPSED: int = column()  # s since the start
    WITH_LINE: int = column()  # and of these with a line, s
    SPEED: int = column()  # the last speed reported, m/s,
    VARIANCE: int = column()  # its variance
    REPORTED: int = column()  # and its time
    MEAN_INNOVATION: int = column()  # mean normalized innovation of ln C
    COMB_SEEN: int = column()  # windows in the search, and the variance of its sums
    COMB_VARIANCE: int = column()
    COMB: int = column(GRID)  # sums of the power of all windows at each circumference
    CALIBRATION: int = column(0)
    LOG_C: int = column()
    VARIANCE_C: int = column()  # 0: unknown
    WINDOWS: int = column()  # number of windows in the statistics that follow
    ON: int = column(CHANNELS)
    OFF: int = column(CHANNELS)
    SPREAD: int = column(CHANNELS)
    SCORE: int = column()  # mean log likelihood ratio of windows at the known speed, and its mean square
    SQUARE: int = column()
    CALIBRATION_END: int = column(0)
    FILTER_VARIANCE: int = column()  # of the filter's speed at the last window, m^2/s^2
    DENSITY: int = column(SPEEDS)  # probability of each error of the filter's speed
    CHANNEL: int = column(CHANNELS * GRID)  # scratch: q of each channel,
    DISCRIMINANT: int = column(GRID)  # and T
    SPECTRUM: int = column(Spectrum.SIZE)
    SIZE: int = column(0)


Lines = _Lines()


def begin(memory: np.ndarray, at: int) -> None:
    """Write the first values of the columns, which begin at `at`."""
    memory[Wheels.AT] = at
    memory[at + Lines.SPREAD:at + Lines.SPREAD + CHANNELS] = 1.0
    begin_spectrum(memory[at + Lines.SPECTRUM:at + Lines.SIZE])


def calibration(memory: np.ndarray) -> np.ndarray | None:
    """Circumference and channel statistics, for `restore`; None while the circumference is unknown."""
    at = int(memory[Wheels.AT])
    known = at and memory[at + Lines.VARIANCE_C] > 0.0
    return memory[at + Lines.CALIBRATION:at + Lines.CALIBRATION_END].copy() if known else None


def checked_calibration(values) -> np.ndarray:
    """A saved `calibration` for the next start, less certain by PARKED_SIGMA. ValueError where it cannot be one."""
    kept = np.array(values, dtype=float)
    if kept.shape != (Lines.CALIBRATION_END - Lines.CALIBRATION,) or not np.isfinite(kept).all():
        raise ValueError('no calibration of wheels')
    first = Lines.CALIBRATION
    c, variance, windows = kept[[Lines.LOG_C - first, Lines.VARIANCE_C - first, Lines.WINDOWS - first]]
    spread = kept[Lines.SPREAD - first:Lines.SCORE - first]
    if abs(c - math.log(MIDDLE)) > 2 * HALF * LOG_STEP or variance <= 0.0 or windows < 0.0 or (spread < 0.0).any():
        raise ValueError('no possible calibration of wheels')
    kept[Lines.VARIANCE_C - first] += PARKED_SIGMA**2
    return kept


def summary(memory: np.ndarray) -> dict | None:
    """Circumference and its sigma, m (None while unknown), and the share of the time with a line, percent; None where
    wheel_vibration is off."""
    at = int(memory[Wheels.AT])
    if not at:
        return None
    sigma, elapsed = math.sqrt(memory[at + Lines.VARIANCE_C]), memory[at + Lines.ELAPSED]
    c = math.exp(memory[at + Lines.LOG_C]) if sigma else None
    return {'circumference_m': c, 'sigma_m': c and c * sigma,
            'share_of_time_percent': float(100.0 * memory[at + Lines.WITH_LINE] / max(elapsed, HOP))}


def diagnostics(memory: np.ndarray, now: float) -> dict[str, float]:
    """Values for /diagnostics, by name with the unit; now: s, the time of the newest sample."""
    found, at = summary(memory), int(memory[Wheels.AT])
    if found is None or found['circumference_m'] is None:
        return {}
    numbers = {'circumference of the wheels, m': found['circumference_m'],
               'circumference of the wheels sigma, m': found['sigma_m'],
               'share of the time with a line of the wheels, %': found['share_of_time_percent']}
    if memory[at + Lines.VARIANCE] > 0.0:
        numbers |= {'speed by the wheels, m/s': float(memory[at + Lines.SPEED]),
                    'speed by the wheels sigma, m/s': math.sqrt(memory[at + Lines.VARIANCE]),
                    'age of the speed by the wheels, s': now - float(memory[at + Lines.REPORTED])}
    return numbers


def restore(memory: np.ndarray, kept: np.ndarray | None) -> None:
    """Begin with a `checked_calibration`, if there is one."""
    at = int(memory[Wheels.AT])
    if at and kept is not None:
        memory[at + Lines.CALIBRATION:at + Lines.CALIBRATION_END] = kept


@njit(_nrt=False)
def listen(mem, k):
    """Add sample k to the current row, and process the window if one ends here."""
    at, sample, r = int(mem[Wheels.AT]), nonnegative(sample_at(mem, k)), nonnegative(state_at(mem, k))
    dt, time = mem[sample + Sample.INTERVAL], mem[sample + Sample.TIME]
    speed = _speed_of(mem, r)
    mem[at + Lines.ELAPSED] += dt
    mem[at + Lines.TURN] += min(dt / TURN_LOW_PASS, 1.0) * (angular_rate(mem, r, sample)[2] - mem[at + Lines.TURN])
    if speed < SLOWEST or abs(mem[at + Lines.TURN]) > FASTEST_TURN or dt > mem[Head.MAX_GAP] or (
            mem[sample + Sample.FAULT] != 0.0):
        mem[at + Lines.SINCE] = time
        for i in range(Lines.TIME, Lines.ELAPSED):
            mem[at + i] = 0.0
        return
    mem[at + Lines.TIME] += dt
    mem[at + Lines.WAY] += dt * speed
    for i in range(AXES):
        mem[at + Lines.VALUES + i] += dt * mem[sample + Sample.F_X + i]
    if mem[at + Lines.TIME] < SHORTEST:
        return
    _append_row(mem, at)
    if time - mem[at + Lines.SINCE] >= SPECTRUM_WINDOW and time - mem[at + Lines.LAST] >= HOP - 0.5 * SHORTEST:
        _process_window(mem, at, r, sample, speed)


@njit(_nrt=False)
def _append_row(mem, at):
    """Append the mean of the samples since the last row to the ring of rows."""
    ring, lasted = at + Lines.SPECTRUM, mem[at + Lines.TIME]
    count = int(mem[ring + Spectrum.COUNT])
    row = ring + Spectrum.RING + Row.SIZE * (count % POINTS)
    mem[row + Row.TIME], mem[row + Row.SPEED] = lasted, mem[at + Lines.WAY] / lasted
    for i in range(AXES):
        mem[row + Row.VALUES + i] = mem[at + Lines.VALUES + i] / lasted
    mem[ring + Spectrum.COUNT] = count + 1.0
    for i in range(Lines.TIME, Lines.ELAPSED):
        mem[at + i] = 0.0


@njit(_nrt=False)
def _speed_of(mem, r):
    """Speed of the state at r, m/s, corrected by its estimated error."""
    total = 0.0
    for i in range(3):
        state = row_of(mem, Error.V_N + i)
        v = mem[r + Nav.V_N + i] - (mem[r + NAV + state] if state >= 0 else 0.0)
        total += v * v
    return math.sqrt(total)


@njit(_nrt=False)
def _along_variance(mem, r):
    """Variance of the speed over ground of the state at r, m^2/s^2."""
    v = velocity_state(mem)
    v_n, v_e = mem[r + Nav.V_N], mem[r + Nav.V_E]
    total = (v_n * v_n * mem[element_at(mem, r, v, v)] + v_e * v_e * mem[element_at(mem, r, v + 1, v + 1)]
             + 2.0 * v_n * v_e * mem[element_at(mem, r, v, v + 1)])
    return max(mem[r + Nav.VARIANCE_FACTOR], 1.0) * total / max(v_n * v_n + v_e * v_e, 1e-6)


@njit(_nrt=False)
def _process_window(mem, at, r, sample, speed):
    """Process the window that ends at the state at r."""
    time, way, last = look(mem, at + Lines.SPECTRUM, HIGHEST_FREQUENCY)
    mean, filtered, now = way / time, _along_variance(mem, r), mem[sample + Sample.TIME]
    fixes_come = now - mem[r + Nav.RESIDUAL_TIME] < WITHOUT_FIX
    in_a_row, mem[at + Lines.LAST] = now - mem[at + Lines.LAST] < 1.5 * HOP, now
    learns = fixes_come and filtered < (RELATIVE_SPEED_SIGMA * mean) ** 2
    if learns:
        _search_circumference(mem, at, way, last)
    if mem[at + Lines.VARIANCE_C] == 0.0:
        return
    _channel_powers(mem, at, way, last, mem[at + Lines.LOG_C])
    _discriminant(mem, at)
    mem[at + Lines.VARIANCE_C] += C_DRIFT * HOP
    lost = filtered > LARGEST_SPEED_SIGMA**2
    if fixes_come or not in_a_row or lost:
        _begin_density(mem, at, filtered + mem[at + Lines.VARIANCE_C] * mean * mean)
    else:
        _diffuse_density(mem, at, filtered - mem[at + Lines.FILTER_VARIANCE])
    mem[at + Lines.FILTER_VARIANCE] = filtered
    middle, spread, ratio = _update_density(mem, at, mean, EXPONENT_SINGLE if fixes_come else EXPONENT)
    if _is_proven(mem, at) and ratio > 1.0 and mem[at + Lines.VARIANCE_C] < LARGEST_C_SIGMA**2 and not lost:
        mem[at + Lines.WITH_LINE] += HOP
        mem[at + Lines.SPEED], mem[at + Lines.REPORTED] = speed + middle, now
        mem[at + Lines.VARIANCE] = spread + mem[at + Lines.VARIANCE_C] * mean * mean
        if not fixes_come:  # the filter's error is one of the middle of the window, and has changed since then
            mem[at + Lines.VARIANCE] += (0.5 * time) ** 2 * error_variance(mem, r)
    if learns:
        _update_score(mem, at)
        _update_channels(mem, at)
        _update_circumference(mem, at, filtered / mean**2, middle / mean, spread / mean**2)


@njit(_nrt=False)
def _update_circumference(mem, at, variance, middle, spread):
    """Kalman step of ln C. variance: prior variance of x from the filter's speed; middle, spread: mean and variance of
    x after the window."""
    prior = variance + mem[at + Lines.VARIANCE_C]
    if spread > 0.999 * prior:
        return
    noise = 1.0 / (1.0 / spread - 1.0 / prior)
    innovation, s = middle * (prior + noise) / prior, mem[at + Lines.VARIANCE_C] + FIX_ERROR_FACTOR * (variance + noise)
    gain = mem[at + Lines.VARIANCE_C] / s
    mem[at + Lines.LOG_C] -= gain * innovation
    mem[at + Lines.VARIANCE_C] = max(mem[at + Lines.VARIANCE_C] * (1.0 - gain), LEAST_SIGMA**2)
    mem[at + Lines.MEAN_INNOVATION] += (innovation / math.sqrt(s) - mem[at + Lines.MEAN_INNOVATION]) / INNOVATION_MEMORY
    if abs(mem[at + Lines.MEAN_INNOVATION]) > INNOVATION_LIMIT / math.sqrt(2.0 * INNOVATION_MEMORY - 1.0):
        mem[at + Lines.VARIANCE_C], mem[at + Lines.MEAN_INNOVATION] = REOPENED_SIGMA**2, 0.0


@njit(_nrt=False)
def _begin_density(mem, at, variance):
    """Density of the error of the filter's speed: normal with the filter's `variance`."""
    for i in range(SPEEDS):
        error = SPEED_STEP * (i - SPEED_HALF)
        mem[at + Lines.DENSITY + i] = math.exp(-0.5 * error * error / max(variance, SPEED_STEP**2))


@njit(_nrt=False)
def _diffuse_density(mem, at, variance):
    """Widen the density by `variance`, by which that of the filter has grown since the last window."""
    density = at + Lines.DENSITY
    while variance > 0.0:  # explicit diffusion steps, stable up to a share of 0.25
        share = min(0.5 * variance / SPEED_STEP**2, 0.25)
        before = 0.0
        for i in range(SPEEDS):
            here = mem[density + i]
            after = mem[density + i + 1] if i + 1 < SPEEDS else 0.0
            mem[density + i] = here + share * (before - 2.0 * here + after)
            before = here
        variance -= 2.0 * share * SPEED_STEP**2 if share == 0.25 else variance


@njit(_nrt=False)
def _update_density(mem, at, speed, exponent):
    """Multiply the density by the likelihood of a window of this mean speed. Returns mean and variance of the error,
    and the likelihood of the window over that of no line."""
    density, total, first, second, before = at + Lines.DENSITY, 0.0, 0.0, 0.0, 0.0
    for i in range(SPEEDS):
        error = SPEED_STEP * (i - SPEED_HALF)
        x = HALF + math.log(max(1.0 + error / speed, 0.1)) / LOG_STEP
        score, j = 0.0, int(x)
        if x >= 0.0 and j + 1 < GRID:
            here = at + Lines.DISCRIMINANT + j
            score = mem[here] + (x - j) * (mem[here + 1] - mem[here])
        mem[density + i] += DENSITY_FLOOR
        before += mem[density + i]
        mem[density + i] *= _likelihood(exponent * score)
        total += mem[density + i]
        first += mem[density + i] * error
        second += mem[density + i] * error * error
    for i in range(SPEEDS):
        mem[density + i] /= total
    variance = max(second / total - (first / total) ** 2, (0.5 * SPEED_STEP) ** 2)
    return first / total, variance, total / before


@njit(_nrt=False)
def _likelihood(score):
    """Likelihood ratio, line over no line, of `score`: exponent times T."""
    return NO_LINE + (1.0 - NO_LINE) * math.exp(score)


@njit(_nrt=False)
def _is_proven(mem, at):
    """Whether the mean score is significantly above zero."""
    n, score = min(mem[at + Lines.WINDOWS], SCORE_MEMORY), mem[at + Lines.SCORE]
    return n >= FEWEST_WINDOWS and score > PROVEN * math.sqrt(max(mem[at + Lines.SQUARE] - score * score, 0.0) / n)


@njit(_nrt=False)
def _channel_powers(mem, at, way, last, log_c):
    """q of each channel on the grid of x, for the circumference exp(log_c)."""
    power, ratio = at + Lines.SPECTRUM + Spectrum.POWER, math.exp(LOG_STEP)
    for h in range(HARMONICS):
        line = 2.0 * (h + 1) * way * math.exp(-log_c - HALF * LOG_STEP)  # bin
        for i in range(GRID):
            j = int(line)
            share = line - j
            for axis in range(AXES):
                value = NO_POWER
                if j < last:
                    value = (1.0 - share) * mem[power + BINS * axis + j] + share * mem[power + BINS * axis + j + 1]
                mem[at + Lines.CHANNEL + GRID * (AXES * h + axis) + i] = value
            line *= ratio


@njit(_nrt=False)
def _search_circumference(mem, at, way, last):
    """Add the window to the sums of the search; a circumference that stands out there becomes the estimate."""
    _channel_powers(mem, at, way, last, math.log(MIDDLE))
    mean, square, best = 0.0, 0.0, 0
    for i in range(GRID):
        total = 0.0
        for channel in range(CHANNELS):
            value = mem[at + Lines.CHANNEL + GRID * channel + i]
            total += value if value > NO_POWER else 0.0
        mem[at + Lines.DISCRIMINANT + i] = total
        mean += total / GRID
    forget = 1.0 - 1.0 / COMB_MEMORY
    for i in range(GRID):
        above = mem[at + Lines.DISCRIMINANT + i] - mean
        square += above * above / GRID
        mem[at + Lines.COMB + i] = forget * mem[at + Lines.COMB + i] + above
        if mem[at + Lines.COMB + i] > mem[at + Lines.COMB + best]:
            best = i
    mem[at + Lines.COMB_SEEN] = forget * mem[at + Lines.COMB_SEEN] + 1.0
    mem[at + Lines.COMB_VARIANCE] = forget**2 * mem[at + Lines.COMB_VARIANCE] + square
    if mem[at + Lines.COMB_SEEN] < COMB_WINDOWS or (
            mem[at + Lines.COMB + best] <= COMB_SIGMAS * math.sqrt(mem[at + Lines.COMB_VARIANCE])):
        return
    log_c = math.log(MIDDLE) - (best - HALF) * LOG_STEP
    if mem[at + Lines.VARIANCE_C] == 0.0 or abs(log_c - mem[at + Lines.LOG_C]) > NEW_WHEEL:
        for i in range(Lines.CALIBRATION, Lines.CALIBRATION_END):
            mem[at + i] = 1.0 if Lines.SPREAD <= i < Lines.SCORE else 0.0
        mem[at + Lines.LOG_C], mem[at + Lines.VARIANCE_C] = log_c, COMB_SIGMA**2


@njit(_nrt=False)
def _discriminant(mem, at):
    """T on the grid of x, from q and the statistics of the channels."""
    for i in range(GRID):
        mem[at + Lines.DISCRIMINANT + i] = 0.0
    for channel in range(CHANNELS):
        on, off, spread = mem[at + Lines.ON + channel], mem[at + Lines.OFF + channel], mem[at + Lines.SPREAD + channel]
        # one-sigma lower bound
        shown = on - off - math.sqrt(2.0 * spread / max(mem[at + Lines.WINDOWS], 1.0))
        if shown > 0.0:
            for i in range(GRID):
                value = mem[at + Lines.CHANNEL + GRID * channel + i]
                if value > NO_POWER:
                    mem[at + Lines.DISCRIMINANT + i] += shown / spread * (value - 0.5 * (on + off))


@njit(_nrt=False)
def _update_score(mem, at):
    """Average the log likelihood ratio of a line at the known speed over one anywhere on the grid."""
    n, near, everywhere = min(mem[at + Lines.WINDOWS] + 1.0, SCORE_MEMORY), 0.0, 0.0
    for i in range(GRID):
        value = _likelihood(EXPONENT * mem[at + Lines.DISCRIMINANT + i])
        everywhere += value / GRID
        if abs(i - HALF) <= SCORE_HALF_WIDTH:
            near += value / (2 * SCORE_HALF_WIDTH + 1)
    score = math.log(near / everywhere)
    mem[at + Lines.SCORE] += (score - mem[at + Lines.SCORE]) / n
    mem[at + Lines.SQUARE] += (score * score - mem[at + Lines.SQUARE]) / n


@njit(_nrt=False)
def _update_channels(mem, at):
    """Average mean and variance of each channel on the line and beside it."""
    n = min(mem[at + Lines.WINDOWS] + 1.0, MEAN_OVER)
    mem[at + Lines.WINDOWS] = n
    for channel in range(CHANNELS):
        values = at + Lines.CHANNEL + GRID * channel
        if mem[values] == NO_POWER or mem[values + GRID - 1] == NO_POWER:
            continue
        beside, square, count = 0.0, 0.0, 2.0 * (HALF - LINE_HALF_WIDTH)
        for i in range(GRID):
            if abs(i - HALF) > LINE_HALF_WIDTH:
                beside += mem[values + i] / count
                square += mem[values + i] ** 2 / count
        mem[at + Lines.ON + channel] += (mem[values + HALF] - mem[at + Lines.ON + channel]) / n
        mem[at + Lines.OFF + channel] += (beside - mem[at + Lines.OFF + channel]) / n
        variance = max(square - beside * beside, LEAST_SPREAD)
        mem[at + Lines.SPREAD + channel] += (variance - mem[at + Lines.SPREAD + channel]) / n
