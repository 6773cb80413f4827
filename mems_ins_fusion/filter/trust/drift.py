"""How far the sensors drift, as a multiple of what is assumed: learned from how the estimates of their errors move.

Over a WINDOW the estimate of an error moves by d, beside what its model lets it decay. The filter expects of d^2 what
the measurements have taken of the variance: decay^2 (P before) + Q - (P after). A sensor that drifts by more than is
assumed moves its estimate by more, one that drifts by less moves it by less, whatever it is that tells: fixes,
constraints, standstills. The mean of d^2 over that multiplies Q, so that the mean becomes 1 (covariance matching, R. K.
Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic Control 17, 1972). A bias that a sensor was switched on
with has no state of its own and does not decay: d is the smaller one of with and without. Strapdown with random walk or
Gauss-Markov; the steps of AR(p) are as configured, and what the planar filter calls drift are slopes.

A receiver whose errors last (a time offset) moves the estimates, too, and with nothing but fixes nobody can say that it
is not the sensors: where the innovations last, the squares are larger than expected by `variance_factor` with sensors
that are as assumed. The ratio is then the one nearest to 1 between both, all of that the receiver's or none.
Constraints and standstills hold the estimates against it.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, NAV, ROW, Head, Nav, decay_at, variance_at, variance_factor, walk_at

#: whether the drift is learned
DriftSettings = HEAD.place('DriftSettings', LEARNED=1)
#: of a state; pairs are of accelerometers and gyroscopes
Drift = ROW.place(
    'Drift',
    TIME=1,  # s, of the estimates that the next are compared with; 0: none
    BIAS=6,  # these,
    BIAS_VARIANCE=6,  # and their variances
    RATIO=(2, 1.0),  # realised over assumed variance
    SUM=2,  # of what went into that,
    WEIGHT=2,  # its weight,
    LEAST_SUM=2)  # and the sum if what lasts of the innovations is the receiver's

#: s: estimates are compared over so long; over less they hardly move
WINDOW = 30.0
#: share of the variance: where measurements have taken less of it away they say nothing
LEAST_REDUCTION = 0.1
#: times Q: where they have taken more they show the bias that the sensor was switched on with
LARGEST_REDUCTION = 2.0
#: a drift squared, over its variance, counts no more than this: one fault must not ruin the rest
LARGEST_DRIFT = 9.0
#: comparisons, one for each axis and window: the assumed drift is worth so many
DRIFT_PRIOR = 3.0
#: comparisons: no more than so many are remembered, ten minutes
DRIFT_MEMORY = 60.0
#: multiple of the assumed variance that is believed at least of accelerometers: a small error of one, which shows
#: together with the tilt, is not told well enough to count on it. Of gyroscopes DRIFT_PRIOR leaves a twentieth
SMALLEST_RATIO = 1.0
#: and at most, of both: ten times the assumed drift is another sensor's
LARGEST_RATIO = 100.0


@njit(_nrt=False)
def learn_drift(mem, r):
    """Realised over assumed variance of the drift of accelerometers and gyroscopes; r: of a state with its fix."""
    if mem[DriftSettings.LEARNED] == 0.0:
        return
    begin, time = mem[r + Drift.TIME], mem[r + Nav.TIME]
    since = time - begin
    if begin != 0.0 and since < WINDOW:
        return
    mem[r + Drift.TIME] = time
    lasting = variance_factor(mem, r) if mem[Head.CONSTRAINTS] == 0.0 else 1.0
    n_navigation, m = int(mem[Head.N_NAVIGATION]), int(mem[Head.N_AUGMENTED])
    x = r + NAV + n_navigation
    e = x + m + n_navigation * (n_navigation + m)
    for k in range(6):
        sensor = 0 if k < 3 else 1
        error, variance, ratio = mem[x + k], mem[e + (m + 1) * k], mem[r + Drift.RATIO + sensor]
        if begin != 0.0:
            decay = math.exp(-since * mem[decay_at(k)])
            driving = ratio * (mem[walk_at(m, k)] * since
                               + mem[variance_at(m, k)] * (1.0 - decay * decay))
            before = decay * decay * mem[r + Drift.BIAS_VARIANCE + k]
            reduction = before + driving - variance
            if LEAST_REDUCTION * before < reduction < LARGEST_REDUCTION * driving:
                bias = mem[r + Drift.BIAS + k]
                moved = min((error - decay * bias) ** 2, (error - bias) ** 2)
                mem[r + Drift.SUM + sensor] += ratio * min(moved / reduction, LARGEST_DRIFT)
                mem[r + Drift.LEAST_SUM + sensor] += ratio * min(moved / (lasting * reduction), LARGEST_DRIFT)
                mem[r + Drift.WEIGHT + sensor] += 1.0
        mem[r + Drift.BIAS + k], mem[r + Drift.BIAS_VARIANCE + k] = error, variance
    for sensor in range(2):
        seen = mem[r + Drift.WEIGHT + sensor]
        if seen > DRIFT_MEMORY:
            mem[r + Drift.SUM + sensor] *= DRIFT_MEMORY / seen
            mem[r + Drift.LEAST_SUM + sensor] *= DRIFT_MEMORY / seen
            seen = mem[r + Drift.WEIGHT + sensor] = DRIFT_MEMORY
        least = (DRIFT_PRIOR + mem[r + Drift.LEAST_SUM + sensor]) / (DRIFT_PRIOR + seen)
        most = (DRIFT_PRIOR + mem[r + Drift.SUM + sensor]) / (DRIFT_PRIOR + seen)
        ratio = min(max(least, 1.0), most)
        if sensor == 0:
            ratio = max(ratio, SMALLEST_RATIO)
        mem[r + Drift.RATIO + sensor] = min(ratio, LARGEST_RATIO)
