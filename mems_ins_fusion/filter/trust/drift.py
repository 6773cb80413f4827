"""Drift of the sensors as a multiple of the assumed one, learned from the changes of their estimated errors.

Within a DRIFT_WINDOW the estimate of an error changes by d, apart from the decay of its model. The expectation of d^2
is the variance that measurements have removed in this time: decay^2 (P before) + Q - (P after). If a sensor drifts more
than assumed, d^2 is larger, and if it drifts less, d^2 is smaller, whichever measurements (fixes, constraints,
standstills) show the drift. The mean of d^2 over its expectation is the factor on Q (covariance matching, R. K. Mehra,
"Approaches to adaptive filtering", IEEE Trans. Automatic Control 17, 1972).

The turn-on bias of a sensor is part of the same state, but does not decay. So d is computed with and without decay, and
the smaller one is used. Drift is learned with random walk or Gauss-Markov models. AR(p) models are used as configured,
and it is not learned in the planar filter, where slopes of the road would count as drift.

Correlated errors of the receiver, such as a time offset, also change the estimates. With fixes alone they cannot be
told from drift. The ratio is then computed twice, as if correlated innovations (`variance_factor`) were caused entirely
by the receiver or entirely by the sensors, and the value nearest to 1 between both results is used.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, NAV, ROW, Head, Nav, decay_at, has_constraints, variance_at, variance_factor, walk_at

#: whether the drift is learned
DriftSettings = HEAD.place('DriftSettings', LEARNED=1)
#: of a state; pairs are of accelerometers and gyroscopes
Drift = ROW.place(
    'Drift',
    TIME=1,  # s, begin of the window; 0: none
    BIAS=6,  # estimated errors at that time, m/s^2 and rad/s,
    BIAS_VARIANCE=6,  # and their variances
    RATIO=(2, 1.0),  # realised over assumed variance of the drift
    SUM=2,  # sum of d^2 over its expectation,
    WEIGHT=2,  # its weight,
    LEAST_SUM=2)  # and the sum with correlated innovations as errors of the receiver

#: s from one estimate to the next that it is compared with: within less they hardly change. Chosen; a quarter and four
#: times of it move little (docs/ablation.md)
DRIFT_WINDOW = 30.0
#: smallest share of the variance that measurements have to remove in a window for it to count. Chosen; a quarter and
#: four times of it move little (docs/ablation.md)
LEAST_REDUCTION = 0.1
#: largest reduction of the variance over Q: a larger one is caused by the turn-on bias, not by drift
LARGEST_REDUCTION = 2.0
#: upper limit of one d^2 over its expectation, so that a single fault does not decide
LARGEST_DRIFT = 9.0
#: weight of the prior, a ratio of 1, in comparisons: one window of three axes
DRIFT_PRIOR = 3.0
#: number of comparisons that are remembered: ten minutes
DRIFT_MEMORY = 60.0
#: lower limit of the ratio of accelerometers: a bias is observed only together with the tilt, which is not enough to
#: rely on a small drift. The ratio of gyroscopes has no limit; DRIFT_PRIOR keeps it above a twentieth
SMALLEST_DRIFT_RATIO = 1.0
#: upper limit of both ratios: ten times the assumed drift is that of another class of sensors
LARGEST_DRIFT_RATIO = 100.0


@njit(_nrt=False)
def learn_drift(mem, r):
    """Update the ratios of accelerometers and gyroscopes. r: state after its correction by a fix."""
    if mem[DriftSettings.LEARNED] == 0.0:
        return
    begin, time = mem[r + Drift.TIME], mem[r + Nav.TIME]
    since = time - begin
    if begin != 0.0 and since < DRIFT_WINDOW:
        return
    mem[r + Drift.TIME] = time
    lasting = 1.0 if has_constraints(mem) else variance_factor(mem, r)
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
            ratio = max(ratio, SMALLEST_DRIFT_RATIO)
        mem[r + Drift.RATIO + sensor] = min(ratio, LARGEST_DRIFT_RATIO)
