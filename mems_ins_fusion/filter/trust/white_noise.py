"""White noise of the IMU samples, measured from their high-order differences.

Vehicles vibrate at frequencies above half the sampling rate of many IMUs. Vibration that is not filtered out before
sampling is aliased to white noise, which may be ten times that of the sensor and has the same effect on the integrals.
The motion of the vehicle is smooth from one sample to the next, so the difference of order n of successive samples
consists of noise. Its variance is `binomial(2 n, n)` times that of one sample, and the variance of a sample times the
sampling interval is the noise density squared.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit
from mems_ins_fusion.compiled_lanes import four, put

from ..memory import HEAD, SAMPLE, WHITE, Head, Sample, nonnegative, sample_at

White = HEAD.place(
    'White',
    ADAPT=1,  # whether the measured noise is used
    SHAKEN=1)  # s for which the noise of a gyroscope was NOTEWORTHY
#: of a sample
Shown = SAMPLE.place(
    'Shown',
    WHITE=6,  # measured noise density squared of each axis, mean over MEAN_TIME,
    SIDEWAYS=1)  # and that of f_y, mean over LONG_MEAN_TIME

#: s, time constant of the mean of the squared differences: the noise changes with the road and the engine
MEAN_TIME = 3.0
#: s, time constant of the long-term mean of the noise of f_y. Chosen; a quarter and four times of it move little
#: (docs/ablation.md)
LONG_MEAN_TIME = 60.0
#: s. If the noise of f_y changes the velocity within this time by more than the sigma of the lateral constraint, the
#: constraint takes noise for turns (`hides_turns`). And the time over which noise adds up to an error of direction or
#: velocity, beside that of a single sample (`non_holonomic._share_of_direction`)
COMPARED_OVER = 1.0
#: order n of the difference: of a motion at a quarter of the sampling rate, 2^n / binomial(2 n, n) of the variance
#: counts as noise
ORDER = 6
#: ratio of the measured to the configured noise density of a gyroscope above which it is reported. Chosen, not measured
NOTEWORTHY = 5.0
#: largest ratio of two successive intervals of evenly spaced samples; others are not evaluated. Chosen; a quarter and
#: four times of it move little (docs/ablation.md)
EVEN_RATIO = 1.5
#: weights of the samples in the difference, such that its variance is that of one sample
_WEIGHTS = tuple((-1) ** j * math.comb(ORDER, j) / math.sqrt(math.comb(2 * ORDER, ORDER)) for j in range(ORDER + 1))


@njit(_nrt=False, forceinline=True)
def show_noise(mem, k, dt):
    """Write the measured noise density squared of each axis to sample k, dt s after the previous one. The values of the
    previous sample are kept if one of the samples for the difference is missing or faulty."""
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
    """Noise density squared of an axis at the sample at `sample`: the larger of the configured and the measured one."""
    return max(mem[WHITE + axis], mem[sample + Shown.WHITE + axis])


@njit(_nrt=False)
def hides_turns(mem, noise):
    """Whether accelerometers with this noise density squared, m^2/s^3, change the velocity within COMPARED_OVER by more
    than the sigma of the lateral constraint."""
    return COMPARED_OVER * noise > mem[Head.LATERAL_SIGMA] ** 2


@njit(_nrt=False)
def shown(mem, sample, first):
    """Ratio of the noise density squared that is used to the configured one, of the noisiest axis of a sensor, at the
    sample at `sample`. first: first axis of the sensor, 0: accelerometers, 3: gyroscopes."""
    largest = 1.0
    for axis in range(first, first + 3):
        if mem[WHITE + axis] > 0.0:
            largest = max(largest, density(mem, sample, axis) / mem[WHITE + axis])
    return largest
