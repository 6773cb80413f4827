"""Which of two IMUs is right, where they differ by more than chance: a state of the filter.

The samples of the filter are the mean of both, and come with the difference d, the other IMU minus the leading one
(`runs/imu_comparison.py`). The error of a sample is that of the sensors plus share * d: with a share of +1/2 the
leading IMU is right, with -1/2 the other one. The share begins at 0 +- 1/2: the difference is the uncertainty of both.
As the error that it causes is correlated with those of position, velocity, attitude and sensors, each fix, constraint
and standstill tells more about it. Which IMU is the first makes no difference.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from .. import history
from ..memory import HEAD, NAV, SAMPLE, Head, Sample, nonnegative, sensor_variance_at
from .hypotheses import LOST_NATS

#: of the settings: index of the state of the share among all n; 0 (a position state): a single IMU
Share = HEAD.place('Share', STATE=1)
#: of a sample: d, body axes; whether there is one; and the share that was estimated when it came, whose part of d has
#: been subtracted from it
Difference = SAMPLE.place('Difference', VALUE=6, GIVEN=1, TAKEN=1)
NAME = 'imu_share'  # of the state
#: variance of the share as they begin to differ: either one is right
BEGIN_VARIANCE = 0.25
#: variance of the share where it is decided. It leaves a thousandth of the difference (1 sigma), as a state with its
#: variance: of 5 deg/s 0.005 deg/s, less than the biases of the sensors, which are estimated beside it
DECIDED_VARIANCE = 1e-6
#: largest difference of the share from that value, standard deviations: otherwise both are wrong
DECIDED_SIGMAS = 3.0
#: a column of zeros
ZERO = (0.0, 0.0, 0.0)


@njit(_nrt=False)
def error(mem, r, sample, axis):
    """Part of f_x ... w_z (axis 0 to 5) of the sample at `sample` that is error by the share of the state at r."""
    if mem[Share.STATE] == 0.0:
        return 0.0
    share = mem[r + NAV + int(mem[Share.STATE])] - mem[sample + Difference.TAKEN]
    return share * mem[sample + Difference.VALUE + axis]


@njit(_nrt=False)
def take_difference(mem, r, sample, samples, k):
    """Write d of sample k of `samples` (k, 13), in which it follows the sample, to `sample`, in body axes, with the
    share of the state at r."""
    given = 0.0
    for i in range(6):
        total = 0.0
        for j in range(6):
            given = max(given, abs(samples[k, 7 + j]))
            total += mem[Head.CONDITIONING + 6 * j + i] * samples[k, 7 + j]
        mem[sample + Difference.VALUE + i] = total
    mem[sample + Difference.GIVEN], mem[sample + Difference.TAKEN] = given > 0.0, mem[r + NAV + int(mem[Share.STATE])]


@njit(_nrt=False)
def remove_share(mem, sample):
    """Subtract from the six values of the sample at `sample` what is error by the share that `take_difference` took."""
    for i in range(6):
        mem[sample + Sample.F_X + i] -= mem[sample + Difference.TAKEN] * mem[sample + Difference.VALUE + i]


@njit(_nrt=False)
def add_error(mem, r, sample, moved):
    """Add the errors that the difference has caused over the latest interval to x and P of the state at r, predicted
    without them. moved: errors of the navigation states per unit of the share."""
    size, m, s = len(moved), nonnegative(int(mem[Head.N_AUGMENTED])), nonnegative(int(mem[Share.STATE]))
    n, p = size + m, nonnegative(r + NAV + size + m)
    own = nonnegative(p + n * size + m * (s - size))
    variance = own + s - size
    if mem[sample + Difference.GIVEN] == 0.0 or mem[variance] == 0.0:
        _begin(mem, r, p, size, m, s, BEGIN_VARIANCE if mem[sample + Difference.GIVEN] != 0.0 else 0.0)
        return
    for i in range(size):
        for j in range(i, size):
            more = (mem[p + n * i + s] * moved[j] + moved[i] * mem[p + n * j + s]
                    + moved[i] * moved[j] * mem[variance])
            mem[p + n * i + j] += more
            if j > i:
                mem[p + n * j + i] += more
    for i in range(size):
        for j in range(m):
            mem[p + n * i + size + j] += moved[i] * mem[own + j]
        if mem[Head.OPEN_LOOP] != 0.0:
            mem[r + NAV + i] += moved[i] * (mem[r + NAV + s] - mem[sample + Difference.TAKEN])
        if mem[Head.HISTORY_AT] > 0.0:
            rows = int(mem[Head.HISTORY_AT])
            for k in range(n):
                mem[rows + n * i + k] += moved[i] * mem[rows + n * s + k]


@njit(_nrt=False)
def decided(mem, r):
    """The value of the share, +1/2 or -1/2, if the state at r excludes the other one, and it has not been decided;
    else 0."""
    state = int(mem[Share.STATE])
    share, variance = mem[r + NAV + state], mem[sensor_variance_at(mem, r, state)]
    value = math.copysign(0.5, share)
    # once decided, the variance is smaller: a share has no process noise
    if (variance < DECIDED_VARIANCE or abs(share) < LOST_NATS * variance
            or (share - value) ** 2 > DECIDED_SIGMAS**2 * variance):
        return 0.0
    return value


@njit(_nrt=False)
def _begin(mem, r, p, size, m, s, variance):
    """Let the share be 0 with `variance`, whatever it was. p: position of P of the state at r."""
    n, own = size + m, p + (size + m) * size
    mem[r + NAV + s] = 0.0
    for i in range(size):
        mem[p + n * i + s] = 0.0
    for j in range(m):
        mem[own + m * (s - size) + j] = mem[own + m * j + s - size] = 0.0
    mem[own + (m + 1) * (s - size)] = variance
    history.forget(mem, s, n)
