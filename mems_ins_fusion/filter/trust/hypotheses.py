"""Hypotheses on a fix that does not fit: it is an outlier, the receiver is wrong, or the IMU is wrong.

The *score* of a filter is the logarithm of the likelihood of all fixes under its hypothesis, plus the logarithm of the
prior of that hypothesis:

* *The fixes are right*, except for single outliers, which may be anywhere. How this filter uses a fix is in
  `receiver.py`.
* *The fixes have been wrong since t0*: the receiver has an offset that stays, that drifts evenly, or that jumps
  (multipath, extrapolation, a wrong integer ambiguity). This filter uses no fix until one is right again.
* *The fixes are right, and the IMU has been wrong since t0*: the filter that uses no fixes has an error that grows as a
  vehicle accelerates. This needs no third filter: the likelihood of the fixes is that of a Kalman filter of that error,
  which runs beside the filter of the second hypothesis (`IMU_NATS`). If it is the most likely, the published filter
  starts anew from the fixes, with the velocity that they show, and does not use the IMU for some time
  (`imu_faults.is_wrong`).

The filter of the second hypothesis is begun when a fix is so unlikely that the receiver may have failed. It ends when
it is too unlikely or when both filters agree (`bank.py`). If several fixes have been refused in a row, the published
filter assumes that they are wrong, and the second one starts anew from them. Published is the filter with the better
score; one that uses no fixes only after it has refused them, or if they drift away (`fix_drift.py`). The published
covariance is that of all hypotheses: it reaches to where the vehicle is by each of them while that is possible. (D. T.
Magill, "Optimal adaptive estimation of sampled stochastic processes", IEEE Trans. Automatic Control 10, 1965; H. A. P.
Blom and Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching coefficients",
the same 33, 1988.)
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.base import UNDECLARED_OFFSET
from ..memory import NAV, ROW, Event, Nav, Verdict, element_at, velocity_state, velocity_variance
from . import offset
from .offset import Offset, Walk
from .scale import OUTLIER_SHARE

#: of a state
Hypothesis = ROW.place(
    'Hypothesis',
    SCORE=1,  # nats: log likelihood of all fixes, plus log prior of the hypothesis
    FURTHER_SCORE=1,  # nats: log likelihood of all fixes of further receivers
    OUTLIER_NATS=1,  # nats: log likelihood ratio of the latest fix, an outlier to what the filter assumes
    FIXES_WRONG=1,  # 1: the hypothesis is that the fixes are wrong since some time. Then:
    OFFSET=Offset.SIZE,  # drifting offset of the fixes, predicted minus measured (offset.py); variance 0: no fix yet
    STAYS=2,  # m, constant offset of the fixes, north and east
    STAYS_VARIANCE=1,  # m^2, its variance on each axis
    STAYS_PROBABILITY=1,  # probability that the offset is constant
    ENDED=1,  # probability that the fault has ended at some fix, over the probability that it goes on
    IMU_NATS=1,  # nats: log likelihood ratio, a wrong IMU and right fixes to wrong fixes; then
    IMU_OFFSET=Offset.SIZE,  # the error of this filter, which uses no fixes (offset.py)
    AGAINST_START=1,  # 1: the other filter has started anew from these fixes
    START_DUE=1,  # START_ANEW or START_WITHOUT_IMU at the next fix; 0: none
    CONSISTENT=1,  # 1: no row of fixes refused since the latest start, or since it became the second filter
    SPREAD=4,  # m, m/s, north and east: one sigma of position and velocity, added for the other hypotheses
    SPREAD_VARIANCE=1)  # m^2, on each axis: variance of position under the other hypotheses, times their probability

#: values of START_DUE: position and velocity start anew from the next fix, with the IMU or without it
START_ANEW, START_WITHOUT_IMU = 1.0, 2.0
#: 1/s, rate of receiver faults: one an hour (multipath, tunnels, wrong integer ambiguities, in drives in cities)
FAULT_RATE = 1.0 / 3600.0
#: 1/s, rate at which a receiver fault ends, and at which its offset changes: once in 20 s. Chosen; a quarter and four
#: times of it move little (docs/ablation.md)
FAULT_END_RATE = 1.0 / 20.0
#: logarithm of the range of the error of an outlier, metres to kilometres: an error of 10 to 20 m is as likely as one
#: of 100 to 200 m
LOG_RANGE = math.log(1000.0)
#: m/s, standard deviation of the drift of wrong fixes: as of a receiver that loses its satellites one by one
DRIFT_SIGMA = 3.0
#: m/s, standard deviation of the velocity error after an IMU fault: 14 m/s with a heading error of half a radian.
#: Chosen; a quarter and four times of it move little (docs/ablation.md)
STRAYED_SIGMA = 7.0
#: standard deviations from which on a drift of the fixes, an offset across the velocity, and a misfit of the drifting
#: offset are significant: by chance in one case of 370
SIGNIFICANT_SIGMAS = 3.0
#: process noise of the drifting offset of wrong fixes, m^2/s and m^2/s^3: that of a receiver's filter. More would
#: follow the error of a wrong IMU, too
RECEIVER_WALK = Walk(velocity=0.002, acceleration=0.002)
#: 1/s, process noise of a constant offset, times the variance of a fix: multipath of a receiver of 1.5 m changes by 2 m
#: in 10 s, a wrong integer ambiguity by nothing. Chosen; a quarter and four times of it move little (docs/ablation.md)
STAYS_WALK = 0.2
#: probability of a constant offset from which on a misfit of the drifting offset restarts that one. Chosen; a quarter
#: and four times of it move little (docs/ablation.md)
STAYS_CERTAIN = 0.9
#: process noise of the error of a filter whose IMU is wrong: an acceleration of 1 m/s^2, as by a tilt of 6 deg, or as
#: vehicles accelerate and turn (0.5 to 2 m/s^2 for 5 to 20 s), plus white noise of 0.1 m^2/s^3, as it is not constant
IMU_WALK = Walk(velocity=0.0, acceleration=0.1, sigma=1.0, correlation_time=10.0)
#: nats, log prior of an IMU fault: one in a hundred hours (loose mounts, kerbs, drivers that mix up axes)
IMU_FAULT_PRIOR = math.log(1.0 / 3.6e5)
#: nats, penalty of a filter that starts anew from refused fixes. Its hypothesis is that the earlier fixes were wrong:
#: faults end as often as they begin, but few begin unnoticed
RESTART_PENALTY = 4.5
#: smallest probability of a hypothesis that the published 95 % ellipse contains: the priors are rates that differ from
#: receiver to receiver; if they are wrong by a factor of ten, it is still one in a hundred
LEAST_PROBABILITY = 0.001
#: sigmas of a 95 % ellipse: the root of the 95 % quantile of chi-square with 2 degrees of freedom
ELLIPSE_SIGMAS = math.sqrt(-2.0 * math.log(0.05))
#: nats: a hypothesis whose score is lower by more is dropped (a ratio of 8000)
LOST_NATS = 9.0
#: s, correlation time of receiver errors: the log likelihood of fixes at shorter intervals is reduced in proportion
SHORTEST_CORRELATION = 1.0
#: s, longest interval between fixes for which rates per second are integrated
LONGEST_INTERVAL = 5.0


@njit(_nrt=False)
def score_fix(mem, r, at, s_nn, s_ne, s_ee, r_nn, factor):
    """Add the likelihood of the fix at `at` to the score of the filter with the state at r. Returns whether it is used.

    s: covariance of the innovation, m^2; r_nn: the part of it that is the fix's; factor: realised over expected
    variance of innovations. This factor and an undeclared time offset widen the likelihoods of all hypotheses alike, so
    that none gains by a smaller variance. If the other filter has started anew from these fixes, the time offset widens
    them along the velocity only: in all directions it would cost nats per second with precise fixes, and wrong fixes
    would win. If the other filter uses the fixes, it widens them in all directions: an offset that is estimated from
    the fixes explains them even if it is the filter that is wrong.
    """
    interval = min(max(mem[at + Event.TIME] - mem[r + Nav.FIX_TIME], 0.0), LONGEST_INTERVAL)
    counts = min(interval / SHORTEST_CORRELATION, 1.0)
    z_n, z_e = mem[at + Event.Z_N] - mem[r + NAV], mem[at + Event.Z_E] - mem[r + NAV + 1]
    n, e = UNDECLARED_OFFSET * mem[r + Nav.V_N], UNDECLARED_OFFSET * mem[r + Nav.V_E]
    s_nn, s_ne, s_ee = factor * s_nn + n * n, factor * s_ne + n * e, factor * s_ee + e * e
    determinant = s_nn * s_ee - s_ne * s_ne
    nis = (s_ee * z_n * z_n - 2.0 * s_ne * z_n * z_e + s_nn * z_e * z_e) / determinant
    right = math.exp(-0.5 * min(nis, 1000.0)) / (2.0 * math.pi * math.sqrt(determinant))
    anywhere = 1.0 / (2.0 * math.pi * LOG_RANGE * (z_n * z_n + z_e * z_e + 2.0 * (s_nn + s_ee)))
    if mem[r + Hypothesis.FIXES_WRONG] == 0.0:
        likelihood = (1.0 - OUTLIER_SHARE) * right + OUTLIER_SHARE * anywhere
        mem[r + Hypothesis.OUTLIER_NATS] = math.log(anywhere / likelihood)
        mem[r + Hypothesis.SCORE] += counts * math.log(likelihood)
        return True
    # the hypothesis begins with a wrong fix, so the fault cannot have ended at the first one
    ended = 1.0 - math.exp(-FAULT_END_RATE * interval) if mem[r + Hypothesis.OFFSET + Offset.VARIANCE] != 0.0 else 0.0
    scatter = factor * r_nn
    if mem[r + Hypothesis.AGAINST_START] == 0.0:
        scatter, n, e = scatter + 0.5 * (n * n + e * e), 0.0, 0.0
    imu_wrong = _density_if_imu_wrong(mem, r, z_n, z_e, scatter, n, e, anywhere, interval)
    wrong = _density_if_wrong(mem, r, z_n, z_e, scatter, n, e, anywhere, interval)
    likelihood = ended * right + (1.0 - ended) * wrong
    mem[r + Hypothesis.SCORE] += counts * math.log(likelihood)
    mem[r + Hypothesis.IMU_NATS] += counts * math.log(imu_wrong / likelihood)
    # sum over the times at which the fault may have ended: a filter that had used the fixes since then would predict
    # this one as well as their offset does
    mem[r + Hypothesis.ENDED] += ended * right / wrong
    is_right = mem[r + Hypothesis.ENDED] > 1.0 - ended
    if is_right:
        mem[r + Hypothesis.FIXES_WRONG] = 0.0
    return is_right


@njit(_nrt=False)
def score_further_fix(mem, r, squared, variance, interval):
    """Add the likelihood of a fix of a further receiver, `interval` s after its previous one, to the score: it shows
    whether the main receiver has jumped alone.

    squared: mean square of its innovation on each axis, variance: the expected one, m^2.
    """
    late = UNDECLARED_OFFSET**2 * (mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2)
    variance += 0.5 * late
    right = math.exp(-min(squared / variance, 1000.0)) / variance
    anywhere = 1.0 / (LOG_RANGE * (2.0 * squared + 4.0 * variance))
    likelihood = ((1.0 - OUTLIER_SHARE) * right + OUTLIER_SHARE * anywhere) / (2.0 * math.pi)
    mem[r + Hypothesis.FURTHER_SCORE] += min(max(interval, 0.0) / SHORTEST_CORRELATION, 1.0) * math.log(likelihood)


@njit(_nrt=False)
def score(row, r):
    """Nats: log likelihood of the fixes of all receivers, plus the log prior of the hypothesis."""
    return row[r + Hypothesis.SCORE] + row[r + Hypothesis.FURTHER_SCORE]


@njit(_nrt=False)
def reach(share, distance, sigma):
    """Standard deviation, m, that another hypothesis adds to the published position in its direction.

    It is that of the mixture of both, but at least so large that the 95 % ellipse reaches to the far side of the other
    one, if that is possible (LEAST_PROBABILITY), and not further away than drifting fixes can take a filter. share:
    probability of the other hypothesis; distance: m, to its position; sigma: m, of its position.
    """
    possible = share * math.exp(-0.5 * (distance * FAULT_END_RATE / DRIFT_SIGMA) ** 2)
    far_side = distance / ELLIPSE_SIGMAS + sigma if possible > LEAST_PROBABILITY else 0.0
    return max(math.sqrt(share) * distance, far_side)


@njit(_nrt=False)
def _density_if_wrong(mem, r, z_n, z_e, r_nn, late_n, late_e, anywhere, interval):
    """Density, 1/m^2, of a fix with the innovation z if the receiver is wrong; the offset is estimated from it.

    Since the previous fix the offset has stayed constant, has drifted evenly, or has jumped. r_nn: m^2, variance of a
    fix about its offset; late: m, one sigma of what an undeclared time offset adds, along the velocity.
    """
    at, stays = r + Hypothesis.OFFSET, r + Hypothesis.STAYS
    variance, probability = r + Hypothesis.STAYS_VARIANCE, r + Hypothesis.STAYS_PROBABILITY
    goes_on = jumped = 0.0
    if mem[at + Offset.VARIANCE] != 0.0:
        offset.predict(mem, at, interval, RECEIVER_WALK)
        mem[variance] += STAYS_WALK * interval * r_nn
        changes = 1.0 - math.exp(-FAULT_END_RATE * interval)
        jumps = max(changes, OUTLIER_SHARE)
        share = mem[probability] + changes * (0.5 - mem[probability])
        s, s_stays = mem[at + Offset.VARIANCE] + r_nn, mem[variance] + r_nn
        if_drifts = (1.0 - share) * offset.density(z_n - mem[at], z_e - mem[at + 1], s, late_n, late_e)
        if_stays = share * offset.density(z_n - mem[stays], z_e - mem[stays + 1], s_stays, late_n, late_e)
        goes_on, jumped = (1.0 - jumps) * (if_drifts + if_stays), jumps * anywhere
    if goes_on <= jumped:
        offset.begin(mem, at, z_n, z_e, r_nn, DRIFT_SIGMA**2, 0.0)
        mem[stays], mem[stays + 1], mem[variance], mem[probability] = z_n, z_e, r_nn, 0.5
        return goes_on + jumped if goes_on != 0.0 else anywhere
    misfits = (z_n - mem[at]) ** 2 + (z_e - mem[at + 1]) ** 2 > SIGNIFICANT_SIGMAS**2 * s
    offset.correct(mem, at, z_n, z_e, r_nn)
    gain = mem[variance] / s_stays
    mem[stays] += gain * (z_n - mem[stays])
    mem[stays + 1] += gain * (z_e - mem[stays + 1])
    mem[variance] = gain * r_nn
    mem[probability] = if_stays / (if_drifts + if_stays)
    if misfits and mem[probability] > STAYS_CERTAIN:
        offset.begin(mem, at, mem[stays], mem[stays + 1], mem[variance], DRIFT_SIGMA**2, 0.0)
    return goes_on + jumped


@njit(_nrt=False)
def _density_if_imu_wrong(mem, r, z_n, z_e, r_nn, late_n, late_e, anywhere, interval):
    """Density, 1/m^2, of the same fix if it is right and the IMU is wrong; the filter's error is estimated from it.

    The error begins at zero, or at the first fix if that does not fit. To be called before `_density_if_wrong`, which
    marks the first fix.
    """
    at = r + Hypothesis.IMU_OFFSET
    offset.predict(mem, at, interval, IMU_WALK)
    density = offset.density(z_n - mem[at], z_e - mem[at + 1], mem[at + Offset.VARIANCE] + r_nn, late_n, late_e)
    fits = (1.0 - OUTLIER_SHARE) * density
    outlier = OUTLIER_SHARE * anywhere
    if mem[r + Hypothesis.OFFSET + Offset.VARIANCE] == 0.0 and fits < anywhere:  # it has been wrong for longer
        offset.begin(mem, at, z_n, z_e, r_nn, DRIFT_SIGMA**2, IMU_WALK.sigma)
        return anywhere
    if fits > outlier:
        offset.correct(mem, at, z_n, z_e, r_nn)
    return fits + outlier


@njit(_nrt=False)
def begin_refusing(mem, r, interval):
    """Let the hypothesis of the filter with the state at r be that the fixes are wrong from now on. interval: s between
    fixes."""
    mem[r + Hypothesis.FIXES_WRONG] = 1.0
    mem[r + Hypothesis.AGAINST_START] = mem[r + Hypothesis.ENDED] = mem[r + Hypothesis.START_DUE] = 0.0
    offset.begin(mem, r + Hypothesis.OFFSET, 0.0, 0.0, 0.0, 0.0, 0.0)
    mem[r + Hypothesis.IMU_NATS] = IMU_FAULT_PRIOR - math.log(FAULT_RATE)
    position, velocity = mem[element_at(mem, r, 0, 0)], 0.5 * velocity_variance(mem, r)
    offset.begin(mem, r + Hypothesis.IMU_OFFSET, 0.0, 0.0, position, velocity, IMU_WALK.sigma)
    mem[r + Hypothesis.SCORE] += math.log(FAULT_RATE * min(max(interval, SHORTEST_CORRELATION), LONGEST_INTERVAL))


@njit(_nrt=False)
def velocity_if_imu_wrong(mem, r):
    """North and east velocity, m/s, and their variance, m^2/s^2, if the IMU is wrong: from the fixes that the filter
    with the state at r has not used."""
    _, _, v_n, v_e = position_and_velocity(mem, r)
    at = r + Hypothesis.IMU_OFFSET
    return (v_n - mem[at + Offset.VELOCITY], v_e - mem[at + Offset.VELOCITY + 1], mem[at + Offset.VELOCITY_VARIANCE])


@njit(_nrt=False)
def strayed_nats(mem, r):
    """Log odds, nats, of a past IMU fault to a drift of the fixes that the filter with the state at r refuses: both
    explain offset and drift equally well and differ in their priors only."""
    at = r + Hypothesis.OFFSET + Offset.VELOCITY
    drift = mem[at] ** 2 + mem[at + 1] ** 2
    ratio = (DRIFT_SIGMA / STRAYED_SIGMA) ** 2
    return IMU_FAULT_PRIOR - math.log(FAULT_RATE) + math.log(ratio) + 0.5 * drift / DRIFT_SIGMA**2 * (1.0 - ratio)


@njit(_nrt=False)
def is_drifting(mem, r):
    """Whether the drift of the fixes that the filter with the state at r refuses is significant, and is not only along
    the velocity, as that of a time offset that grows."""
    at = r + Hypothesis.OFFSET
    drift = math.hypot(mem[at + Offset.VELOCITY], mem[at + Offset.VELOCITY + 1])
    speed = math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E])
    beside = abs(mem[at] * mem[r + Nav.V_E] - mem[at + 1] * mem[r + Nav.V_N])  # times the speed
    return (drift > SIGNIFICANT_SIGMAS * math.sqrt(mem[at + Offset.VELOCITY_VARIANCE])
            and beside > SIGNIFICANT_SIGMAS * math.sqrt(mem[at + Offset.VARIANCE]) * speed)


@njit(_nrt=False)
def refuse_fix(mem, r, at):
    """Refuse the fix at `at` and note its innovation and time."""
    mem[at + Event.VERDICT], mem[at + Event.WEIGHT] = Verdict.REFUSED, 0.0
    mem[r + Nav.RESIDUAL_N] = mem[at + Event.Z_N] - mem[r + NAV]
    mem[r + Nav.RESIDUAL_E] = mem[at + Event.Z_E] - mem[r + NAV + 1]
    mem[r + Nav.RESIDUAL_TIME] = mem[r + Nav.FIX_TIME] = mem[at + Event.TIME]
    mem[r + Nav.FIX_LATITUDE], mem[r + Nav.FIX_LONGITUDE] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]


@njit(_nrt=False)
def add_prior(mem, r, nats):
    """Add `nats`, the log prior of a further assumption, to the score of the filter with the state at r."""
    mem[r + Hypothesis.SCORE] += nats


@njit(_nrt=False)
def spread(row, r):
    """Standard deviations that are published in addition to P for the other hypotheses, of the state at r in `row`:
    position (n, e; m) and velocity (n, e; m/s)."""
    since = row[r + Nav.TIME] - row[r + Nav.FIX_TIME]
    v_n, v_e = row[r + Hypothesis.SPREAD + 2], row[r + Hypothesis.SPREAD + 3]
    return row[r + Hypothesis.SPREAD] + since * v_n, row[r + Hypothesis.SPREAD + 1] + since * v_e, v_n, v_e


@njit(_nrt=False)
def position_and_velocity(mem, r):
    """Latitude, longitude (rad), north and east velocity (m/s) of the state at r, x taken out."""
    x, k = r + NAV, velocity_state(mem)
    return (mem[r + Nav.LATITUDE] - mem[x] * mem[r + Nav.NORTH_SCALE],
            mem[r + Nav.LONGITUDE] - mem[x + 1] * mem[r + Nav.EAST_SCALE],
            mem[r + Nav.V_N] - mem[x + k], mem[r + Nav.V_E] - mem[x + k + 1])


@njit(_nrt=False)
def move_offset(mem, r, before):
    """Change the offsets by what a correction other than a fix has changed position and velocity of the state at r.
    before: `position_and_velocity` before that correction."""
    if mem[r + Hypothesis.FIXES_WRONG] != 0.0 and mem[r + Hypothesis.OFFSET + Offset.VARIANCE] != 0.0:
        after = position_and_velocity(mem, r)
        for i in range(2):
            mem[r + Hypothesis.STAYS + i] -= mem[r + Hypothesis.OFFSET + i]
        add_move(mem, r, r + Hypothesis.OFFSET, before, after)
        add_move(mem, r, r + Hypothesis.IMU_OFFSET, before, after)
        for i in range(2):
            mem[r + Hypothesis.STAYS + i] += mem[r + Hypothesis.OFFSET + i]


@njit(_nrt=False)
def add_move(mem, r, at, before, after):
    """Add the change of position and velocity of the state at r to the four numbers at `at` (north, east; m and m/s).
    before, after: results of `position_and_velocity`."""
    mem[at] += (after[0] - before[0]) / mem[r + Nav.NORTH_SCALE]
    mem[at + 1] += (after[1] - before[1]) / mem[r + Nav.EAST_SCALE]
    mem[at + 2] += after[2] - before[2]
    mem[at + 3] += after[3] - before[3]
