"""Three statements where a fix does not fit, judged by their likelihood: about the receiver, and about the IMU.

A copy of the filter's memory is a second filter. The logarithm of the likelihood of all fixes, and of the prior of what
the filter says of them, is its *score*:

* *They are right*, but for single ones that may be anywhere. How this filter uses a fix stands in `receiver.py`.
* *They are wrong since t0*: the receiver is off by an offset that stays, or goes on to drift as it did, or jumps to
  anywhere (multipath, extrapolation, a wrong integer). This filter uses none of them until one is right again.
* *They are right, and the IMU is wrong since t0*: the filter that uses no fixes is off by an offset that changes as a
  vehicle accelerates. This needs no third filter: the likelihood of the fixes is that of a Kalman filter of the offset
  and its drift beside the second one (`IMU_NATS`). Where it is the most likely, the published filter starts anew from
  the fixes with the velocity that they show, and goes on without the IMU for a while (`imu_faults.is_wrong`).

The second is begun where a fix is so unlikely that the receiver may have failed, and ends where it has lost or both
agree (`bank.py`). Where several fixes have been refused in a row, the published filter takes them for wrong, and the
second one starts anew from them. What is published is the filter with the better score; one that uses no fixes only
where it has refused them, or where they drift away (`fix_drift.py`). Its covariance is that of all three: it reaches to
where the vehicle is by each, as long as that may be right. (D. T. Magill, "Optimal adaptive estimation of sampled
stochastic processes", IEEE Trans. Automatic Control 10, 1965; H. A. P. Blom and Y. Bar-Shalom, "The interacting
multiple model algorithm for systems with Markovian switching coefficients", the same 33, 1988.)
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
    SCORE=1,  # nats: logarithm of the likelihood of all fixes and of the prior of what the filter says,
    FURTHER_SCORE=1,  # the same of all fixes of further receivers
    OUTLIER_NATS=1,  # nats, by which the latest fix is more likely as an outlier, which may be anywhere
    FIXES_WRONG=1,  # 1: its hypothesis is that the fixes since some time are wrong; then
    OFFSET=Offset.SIZE,  # predicted minus measured: by what they are off (offset.py); of variance 0: not known yet,
    STAYS=4,  # m, m^2: north, east, variance of that if it does not drift; and the probability that it does not,
    ENDED=1,  # how much more likely it is that they have been right again for some time than that they still are wrong,
    IMU_NATS=1,  # nats, by which it is more likely that they are right, and the IMU is wrong since that time; then
    IMU_OFFSET=Offset.SIZE,  # by what this filter is off (offset.py)
    AGAINST_START=1,  # 1: it is compared with a filter that has started anew from these fixes,
    START_DUE=1,  # START_ANEW, START_WITHOUT_IMU, or 0: the next fix is used as any other,
    CONSISTENT=1,  # 1: it has refused no row of fixes since that start, or since it became the second filter
    SPREAD=4,  # m, m/s, north and east: one sigma of position and velocity for what the other hypothesis says,
    SPREAD_VARIANCE=1)  # m^2, on each axis: variance of where the vehicle is by the others, times their probability

#: position and velocity start anew from the next fix, without or with the IMU known as wrong
START_ANEW, START_WITHOUT_IMU = 1.0, 2.0
#: 1/s: rate of faults of a receiver, one an hour (multipath, tunnels, wrong integers: drives in cities)
FAULT_RATE = 1.0 / 3600.0
#: 1/s: rate at which such a fault ends, after 20 s, and at which its fixes jump to another offset. Chosen, not measured
FAULT_END_RATE = 1.0 / 20.0
#: logarithm of the range, metres to kilometres, of a fix that may be anywhere: it is as likely 10 to 20 m off as 100 to
#: 200 m
LOG_RANGE = math.log(1000.0)
#: m/s: sigma of the drift of wrong fixes, of a receiver that loses its satellites one by one
DRIFT_SIGMA = 3.0
#: m/s: sigma of the velocity error of a filter that has strayed: half of a speed in cities, as of a heading that is off
#: by half a radian. Chosen, not measured
STRAYED_SIGMA = 7.0
#: sigmas beyond which wrong fixes significantly drift, and are off across the velocity
SIGNIFICANT = 3.0
#: how the offset of wrong fixes changes, m^2/s and m^2/s^3: as that of a receiver's filter, not of a vehicle that
#: manoeuvres
RECEIVER_WALK = Walk(velocity=0.002, acceleration=0.002)
#: 1/s: random walk of an offset that stays where it is, of the variance with which fixes scatter: multipath of a
#: receiver of 1.5 m changes by 2 m in 10 s, a wrong integer not at all. Chosen, not measured
STAYS_WALK = 0.2
#: probability from which on an offset stays: where it begins to drift, that has nothing to do with how it did before
STAYS_CERTAIN = 0.9
#: how the offset of a filter whose IMU is wrong changes: it is off by 1 m/s^2, as with a tilt of 6 deg, or by what
#: vehicles accelerate and turn (0.5 to 2 m/s^2, for 5 to 20 s), and that is not quite constant
IMU_WALK = Walk(velocity=0.0, acceleration=0.1, sigma=1.0, correlation_time=10.0)
#: nats, prior: an IMU fails once in a hundred hours (loose mounts, kerbs, drivers that mix up axes)
IMU_FAULT_PRIOR = math.log(1.0 / 3.6e5)
#: nats: a filter that starts anew from refused fixes is less likely by this at first. It says that the fixes before
#: were wrong: a fault ends as often as it begins, but few begin unnoticed
RESTART_PENALTY = 4.5
#: least probability of a hypothesis that the published 95 % ellipse holds: by ten times as wrong as the priors, which
#: are rates that differ from receiver to receiver, it is still one in a hundred
LEAST_PROBABILITY = 0.001
#: sigmas of a 95 % ellipse: the root of the 95 % quantile of chi-square with 2 degrees of freedom
ELLIPSE_SIGMAS = math.sqrt(-2.0 * math.log(0.05))
#: nats: a hypothesis that is less likely by more is dropped
LOST_NATS = 9.0
#: s: shortest correlation time of a receiver's errors: fixes that come faster count for less
SHORTEST_CORRELATION = 1.0
#: s: longer intervals between fixes count as this, for rates per second
LONGEST_INTERVAL = 5.0


@njit(_nrt=False)
def score_fix(mem, r, at, s_nn, s_ne, s_ee, r_nn, factor):
    """Whether the filter with the state at r uses the fix at `at`, whose likelihood goes into its score.

    s: covariance of the innovation, m^2; r_nn: what of it is the fix's; factor: the realised over the expected variance
    of innovations. It and a time offset that nobody declared widen the likelihoods of both statements alike, so that
    neither wins by being narrow. Beside a filter that has started anew from these fixes, the offset widens both along
    the velocity alone: widened on all sides, the likelihood is smaller by nats a second where fixes are precise, and
    wrong ones win within seconds. Beside a filter that uses the fixes it is widened on all sides: an offset that
    follows fixes goes on explaining them where it is the filter that is wrong.
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
    # the first of them is wrong: the hypothesis begins with it
    ended = 1.0 - math.exp(-FAULT_END_RATE * interval) if mem[r + Hypothesis.OFFSET + Offset.VARIANCE] != 0.0 else 0.0
    scatter = factor * r_nn
    if mem[r + Hypothesis.AGAINST_START] == 0.0:
        scatter, n, e = scatter + 0.5 * (n * n + e * e), 0.0, 0.0
    imu_wrong = _density_if_imu_wrong(mem, r, z_n, z_e, scatter, n, e, anywhere, interval)
    wrong = _density_if_wrong(mem, r, z_n, z_e, scatter, n, e, anywhere, interval)
    likelihood = ended * right + (1.0 - ended) * wrong
    mem[r + Hypothesis.SCORE] += counts * math.log(likelihood)
    mem[r + Hypothesis.IMU_NATS] += counts * math.log(imu_wrong / likelihood)
    # a filter that has used them since they were right again would have predicted this one as well as their offset does
    mem[r + Hypothesis.ENDED] += ended * right / wrong
    is_right = mem[r + Hypothesis.ENDED] > 1.0 - ended
    if is_right:
        mem[r + Hypothesis.FIXES_WRONG] = 0.0
    return is_right


@njit(_nrt=False)
def score_further_fix(mem, r, squared, variance, interval):
    """Add the likelihood of a fix of a further receiver, `interval` s after the one before it, to the score.

    squared: mean square of its innovation, expected to be variance, m^2: so a main receiver that jumps alone is wrong.
    """
    late = UNDECLARED_OFFSET**2 * (mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2)
    variance += 0.5 * late
    right = math.exp(-min(squared / variance, 1000.0)) / variance
    anywhere = 1.0 / (LOG_RANGE * (2.0 * squared + 4.0 * variance))
    likelihood = ((1.0 - OUTLIER_SHARE) * right + OUTLIER_SHARE * anywhere) / (2.0 * math.pi)
    mem[r + Hypothesis.FURTHER_SCORE] += min(max(interval, 0.0) / SHORTEST_CORRELATION, 1.0) * math.log(likelihood)


@njit(_nrt=False)
def score(row, r):
    """Nats: logarithm of the likelihood of the fixes of all receivers, and of the prior of what the filter says."""
    return row[r + Hypothesis.SCORE] + row[r + Hypothesis.FURTHER_SCORE]


@njit(_nrt=False)
def either(first, second):
    """Nats: score of the statement that one of two is true, from their scores."""
    return max(first, second) + math.log1p(math.exp(-abs(first - second)))


@njit(_nrt=False)
def reach(share, distance, sigma):
    """Sigma, m, that the other filter adds to the published position in its direction; share: its probability.

    That of the mixture of both, but no less than with a 95 % ellipse that reaches to the far side of its own: where it
    is possible (LEAST_PROBABILITY), and not further away than fixes that drift away take a filter. distance: m, from
    one filter to the other; sigma: m, of the other.
    """
    possible = share * math.exp(-0.5 * (distance * FAULT_END_RATE / DRIFT_SIGMA) ** 2)
    far_side = distance / ELLIPSE_SIGMAS + sigma if possible > LEAST_PROBABILITY else 0.0
    return max(math.sqrt(share) * distance, far_side)


@njit(_nrt=False)
def _density_if_wrong(mem, r, z_n, z_e, r_nn, late_n, late_e, anywhere, interval):
    """Density, 1/m^2, of a fix that is off by z of a wrong receiver, from which its offset is learned. r_nn: m^2, of
    the scatter about that; late: m, one sigma of what an undeclared time offset adds, along the velocity.

    Since the fix before it, the offset has stayed, has drifted evenly, or has jumped anywhere.
    """
    at, stays = r + Hypothesis.OFFSET, r + Hypothesis.STAYS
    goes_on = jumped = 0.0
    if mem[at + Offset.VARIANCE] != 0.0:
        offset.predict(mem, at, interval, RECEIVER_WALK)
        mem[stays + 2] += STAYS_WALK * interval * r_nn
        changes = 1.0 - math.exp(-FAULT_END_RATE * interval)
        jumps = max(changes, OUTLIER_SHARE)
        share = mem[stays + 3] + changes * (0.5 - mem[stays + 3])
        s, s_stays = mem[at + Offset.VARIANCE] + r_nn, mem[stays + 2] + r_nn
        if_drifts = (1.0 - share) * offset.density(z_n - mem[at], z_e - mem[at + 1], s, late_n, late_e)
        if_stays = share * offset.density(z_n - mem[stays], z_e - mem[stays + 1], s_stays, late_n, late_e)
        goes_on, jumped = (1.0 - jumps) * (if_drifts + if_stays), jumps * anywhere
    if goes_on <= jumped:
        offset.begin(mem, at, z_n, z_e, r_nn, DRIFT_SIGMA**2, 0.0)
        mem[stays], mem[stays + 1], mem[stays + 2], mem[stays + 3] = z_n, z_e, r_nn, 0.5
        return goes_on + jumped if goes_on != 0.0 else anywhere
    misfits = (z_n - mem[at]) ** 2 + (z_e - mem[at + 1]) ** 2 > SIGNIFICANT**2 * s
    offset.correct(mem, at, z_n, z_e, r_nn)
    gain = mem[stays + 2] / s_stays
    mem[stays] += gain * (z_n - mem[stays])
    mem[stays + 1] += gain * (z_e - mem[stays + 1])
    mem[stays + 2] = gain * r_nn
    mem[stays + 3] = if_stays / (if_drifts + if_stays)
    if misfits and mem[stays + 3] > STAYS_CERTAIN:
        offset.begin(mem, at, mem[stays], mem[stays + 1], mem[stays + 2], DRIFT_SIGMA**2, 0.0)
    return goes_on + jumped


@njit(_nrt=False)
def _density_if_imu_wrong(mem, r, z_n, z_e, r_nn, late_n, late_e, anywhere, interval):
    """Density, 1/m^2, of the same fix where it is right and the IMU is wrong, from which the filter's error is learned.

    That begins at none, or with the first fix where that does not fit. To be called before `_density_if_wrong`, which
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
    """The filter with the state at r says from now on that the fixes are wrong. interval: s between fixes."""
    mem[r + Hypothesis.FIXES_WRONG] = 1.0
    mem[r + Hypothesis.AGAINST_START] = mem[r + Hypothesis.ENDED] = mem[r + Hypothesis.START_DUE] = 0.0
    offset.begin(mem, r + Hypothesis.OFFSET, 0.0, 0.0, 0.0, 0.0, 0.0)
    mem[r + Hypothesis.IMU_NATS] = IMU_FAULT_PRIOR - math.log(FAULT_RATE)
    position, velocity = mem[element_at(mem, r, 0, 0)], 0.5 * velocity_variance(mem, r)
    offset.begin(mem, r + Hypothesis.IMU_OFFSET, 0.0, 0.0, position, velocity, IMU_WALK.sigma)
    mem[r + Hypothesis.SCORE] += math.log(FAULT_RATE * min(max(interval, SHORTEST_CORRELATION), LONGEST_INTERVAL))


@njit(_nrt=False)
def velocity_if_imu_wrong(mem, r):
    """North and east velocity, m/s, and their variance, m^2/s^2, as the fixes that the filter with the state at r has
    not used show it where they are right and the IMU is wrong."""
    _, _, v_n, v_e = position_and_velocity(mem, r)
    at = r + Hypothesis.IMU_OFFSET
    return (v_n - mem[at + Offset.VELOCITY], v_e - mem[at + Offset.VELOCITY + 1], mem[at + Offset.VELOCITY_VARIANCE])


@njit(_nrt=False)
def strayed_nats(mem, r):
    """Nats by which it is more likely that the filter with the state at r has strayed, as the IMU was wrong, than that
    the fixes that it takes for wrong drift as they do: both explain offset and drift alike, but for their priors."""
    at = r + Hypothesis.OFFSET + Offset.VELOCITY
    drift = mem[at] ** 2 + mem[at + 1] ** 2
    ratio = (DRIFT_SIGMA / STRAYED_SIGMA) ** 2
    return IMU_FAULT_PRIOR - math.log(FAULT_RATE) + math.log(ratio) + 0.5 * drift / DRIFT_SIGMA**2 * (1.0 - ratio)


@njit(_nrt=False)
def is_drifting(mem, r):
    """Whether the fixes that the filter with the state at r takes for wrong certainly drift away: not only along the
    velocity, as fixes do that are stamped later and later."""
    at = r + Hypothesis.OFFSET
    drift = math.hypot(mem[at + Offset.VELOCITY], mem[at + Offset.VELOCITY + 1])
    speed = math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E])
    beside = abs(mem[at] * mem[r + Nav.V_E] - mem[at + 1] * mem[r + Nav.V_N])  # times the speed
    return (drift > SIGNIFICANT * math.sqrt(mem[at + Offset.VELOCITY_VARIANCE])
            and beside > SIGNIFICANT * math.sqrt(mem[at + Offset.VARIANCE]) * speed)


@njit(_nrt=False)
def refuse_fix(mem, r, at):
    """Leave the fix at `at`, which is taken for wrong, and remember that it came."""
    mem[at + Event.VERDICT], mem[at + Event.WEIGHT] = Verdict.REFUSED, 0.0
    mem[r + Nav.RESIDUAL_N] = mem[at + Event.Z_N] - mem[r + NAV]
    mem[r + Nav.RESIDUAL_E] = mem[at + Event.Z_E] - mem[r + NAV + 1]
    mem[r + Nav.RESIDUAL_TIME] = mem[r + Nav.FIX_TIME] = mem[at + Event.TIME]
    mem[r + Nav.FIX_LATITUDE], mem[r + Nav.FIX_LONGITUDE] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]


@njit(_nrt=False)
def add_prior(mem, r, nats):
    """The filter with the state at r has said something more that has the logarithm `nats` of a prior."""
    mem[r + Hypothesis.SCORE] += nats


@njit(_nrt=False)
def spread(row, r):
    """One sigma of what the state at r in `row` is published with besides P for the other hypothesis: position (n, e;
    m) and velocity (n, e; m/s)."""
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
    """A correction that is not a fix has moved the state at r from where `position_and_velocity` had it `before`: by
    that, wrong fixes are off from another position and velocity."""
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
    """Add to the four numbers at `at`, north and east, m and m/s, by how much what `position_and_velocity` says of the
    state at r has changed."""
    mem[at] += (after[0] - before[0]) / mem[r + Nav.NORTH_SCALE]
    mem[at + 1] += (after[1] - before[1]) / mem[r + Nav.EAST_SCALE]
    mem[at + 2] += after[2] - before[2]
    mem[at + 3] += after[3] - before[3]
