"""Noise of the GNSS receiver: the weight of its fixes, and the limits beyond which they are weighted down or refused.

The standard deviation that a receiver claims for its fixes may be wrong, and its errors may jump or drift. The realised
noise is learned from three successive fixes: from the difference between the displacements that they measure and those
that the inertial sensors measure.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.acceleration import tilt_variance
from ..memory import NAV, ROW, Error, Event, Head, Nav, Verdict, row_of
from .force_noise import ForceNoise, force_noise, learn_force_noise, learn_from_change
from .scale import PRIOR, Scale, learn_changes, reopen, reset_scale, scale
from .scale import learn as learn_scale

#: columns of a state
Receiver = ROW.place(
    'Receiver',
    CLAIMED=1,  # m^2, claimed variance of the last fix
    FIRST=2,  # first of three fixes, about a second or more apart: time, s (0: none), claimed variance, m^2
    SECOND=4,  # second one: innovation minus MOVED, m, s after the first (0: none), claimed variance, m^2
    MOVED=4,  # m, m/s: corrections of position and velocity since the first one, plus the innovation of the first
    SHORT_PASSED=3,  # whitened innovations, low-passed with SHORT_LOW_PASS, and the variance for white ones
    LAST_TWO=6,  # the two previous fixes: time, s, latitude and longitude, rad
    SMOOTH_SCALE=Scale.CHANGING_SIZE,  # realised over claimed variance by a straight line, an upper limit
    SCALE=Scale.CHANGING_SIZE,  # realised over claimed variance of the fixes
    SLOW_SCALE=Scale.SIZE,  # the same ratio by low-passed innovations
    LASTING_SCALE=Scale.SIZE,  # realised over expected variance of slow errors
    INNOVATION_SCALE=Scale.SIZE,  # realised over expected variance of low-passed innovations
    STATUS=1,  # `NavSatStatus.status` plus 1 of the fixes of the first four scales; 0: no fix yet
    BY_STATUS=3 * 2 * (Scale.CHANGING_SIZE + Scale.SIZE))  # these four scales for each status

#: s, longest time from the first to the last of three fixes that are compared with a straight line: in more time, the
#: vehicle leaves the line by more than fixes of any receiver scatter. One fix in ten seconds is still enough
LONGEST_OF_THREE = 30.0
#: s, shortest time between two of the three fixes: within less, errors of the receiver are nearly equal, and
#: differences do not show them
SHORTEST_PAIR = 0.9
#: m/s^2, upper limit of the standard deviation of the acceleration error by the tilt: half a degree
UNSEEN_ACCELERATION = 0.1
#: m: a fix with a smaller innovation is never refused, only weighted down. A state may be wrong by this distance
#: although its covariance is small, as with an unknown time offset at 20 m/s. Without this limit, right fixes are then
#: refused (Longmont: RMSE 0.26 m with it, 4.6 m without)
GATE_FLOOR = 5.0
#: s, longest time for which fixes in a row are weighted down. After it the state is taken for wrong, and fixes keep
#: their full weight until they agree with the state again. Without this limit, a filter with wrong accelerometers does
#: not accept right fixes
LONGEST_WEIGHTED = 4.0
#: s, longest interval between two fixes for which the gate is applied to the change of the innovation: within it,
#: gradual growth is an error of the state, not of the fix
LONGEST_GROWTH = 10.0
#: m/s^2, largest acceleration with which an error of the state grows: that of a tilt error of three degrees
LARGEST_GROWTH = 0.5
#: ratio of the claimed variances of two successive fixes above which only the claim has changed, not the error: the
#: realised variance is kept until fixes show another one
CLAIM_CHANGE = 10.0
#: s, time constant of the low pass of innovations for the covariance factor: errors that last for less time average out
LONG_LOW_PASS = 10.0
#: s, time constant of the low pass of innovations for slow errors. They are largest in the innovations if they change
#: about as fast as the filter follows them, which is within seconds (docs/filter.md)
SHORT_LOW_PASS = 4.0
#: s, upper limit of the time constant with which the filter follows fixes: if it follows them more slowly, other
#: measurements correct the position, too
SLOWEST_RESPONSE = 30.0
#: upper limit of a normalized innovation, a larger one counts as this: one outlier does not show that the covariance is
#: too small
LARGEST_INNOVATION = 4.0
#: share of the realised variance of fixes that is the lower limit of the variance of slow errors: no receiver has only
#: white errors
LASTING_SHARE = 0.05
#: s, time constant of slow errors: that of multipath of a moving vehicle is shorter, that of atmosphere and orbits
#: longer
LASTING_TIME = 60.0
#: s, upper limit of this time constant: what the ionosphere and the orbits add to a position changes within tens of
#: minutes. So slow errors that innovations do not show are not smaller than claimed, they may only be slower than
#: LASTING_TIME. Innovations show them in proportion to their variance over their time constant
SLOWEST_LASTING_TIME = 1000.0
#: upper limit of the share of the variance of slow errors that is in low-passed innovations, reached at rest
LARGEST_SHOWN = 0.3
#: upper limit of the variance of slow errors, over the larger of the claimed and the realised variance: a sigma wrong
#: by a factor of three, one standard deviation of `scale.PRIOR`. Innovations contain only a small share of slow errors.
#: Without this limit, an IMU that is worse than configured, or a receiver that smooths its positions, would appear as
#: slow errors of tens of metres
LARGEST_LASTING = 9.0
#: ratio of the realised to the claimed variance above which the noise of the accelerometers is not learned: the claimed
#: sigma is a tenth of the realised one, and the noise of the fixes is not known well enough
LARGEST_SCATTER = 100.0
#: number of fixes over which the logarithm of the claimed variance is averaged: about as many as determine the position
CLAIM_MEMORY = 10.0


@njit(_nrt=False)
def take_status(mem, r, at):
    """Change to the scales of the status of the fix at `at`, if it differs from that of the previous fix.

    Fixes with a base, fixes with corrections and fixes without either are measured in different ways. The errors of
    each kind are learned separately.
    """
    before, status = int(mem[r + Receiver.STATUS]), min(max(int(mem[at + Event.STATUS]), 0), 2) + 1
    mem[r + Receiver.STATUS] = status
    if before == 0 or before == status:
        return
    size = 2 * (Scale.CHANGING_SIZE + Scale.SIZE)
    left, found = r + Receiver.BY_STATUS + size * (before - 1), r + Receiver.BY_STATUS + size * (status - 1)
    for i in range(size):
        mem[left + i] = mem[r + Receiver.SMOOTH_SCALE + i]
        mem[r + Receiver.SMOOTH_SCALE + i] = mem[found + i]
    # fixes of different status have different errors, so they are not compared with each other
    for i in (Receiver.CLAIMED, Receiver.FIRST, Receiver.LAST_TWO, Receiver.LAST_TWO + 3):
        mem[r + i] = 0.0


@njit(_nrt=False)
def factor_and_limits(mem, r, at):
    """Return the factor on the covariance of the fix at `at`, the limit above which it is weighted down, and the gate.

    Both limits are in standard deviations of the innovation; 0 is no limit. The event contains the innovation before
    the correction. The estimated errors x are subtracted from it here.
    """
    z_n, z_e = mem[at + Event.Z_N] - mem[r + NAV], mem[at + Event.Z_E] - mem[r + NAV + 1]
    # a fix is refused only if its innovation is large and has become so at once: gradual growth from fix to fix is an
    # error of the state
    interval = mem[at + Event.TIME] - mem[r + Nav.RESIDUAL_TIME]
    jump, floor = math.hypot(z_n, z_e), GATE_FLOOR
    if mem[r + Nav.REFUSED] == 0.0 and mem[r + Nav.FIX_TIME] != 0.0 and 0.0 < interval < LONGEST_GROWTH:
        jump = min(jump, math.hypot(z_n - mem[r + Nav.RESIDUAL_N], z_e - mem[r + Nav.RESIDUAL_E]))
        floor += 0.5 * LARGEST_GROWTH * interval * interval
    gate = mem[Head.GATE] if jump > floor else 0.0
    robust = mem[Head.ROBUST_SIGMA]
    if mem[r + Nav.WEIGHTED] >= max(1.0, LONGEST_WEIGHTED / max(interval, 1e-3)):
        robust = 0.0
    return realised_factor(mem, r), robust, gate


@njit(_nrt=False)
def realised_scatter(mem, r):
    """Ratio of the realised to the claimed variance, from the noise of fixes about the displacements of the inertial
    sensors.

    Its upper limit is the ratio at which three successive fixes deviate from a straight line. Any excess is caused by
    the inertial sensors.
    """
    realised, smooth = scale(mem, r + Receiver.SCALE), r + Receiver.SMOOTH_SCALE
    if mem[smooth + Scale.REDUCED] == 0.0:
        return realised
    most = math.exp(mem[smooth + Scale.LOG] + math.sqrt(max(PRIOR - mem[smooth + Scale.REDUCED], 0.0)))
    return min(realised, max(most, 1.0))


@njit(_nrt=False)
def realised_factor(mem, r):
    """Factor on the claimed covariance of a fix.

    If fixes scatter more than they claim, it is the ratio of both variances. If they scatter less, they may have a
    common error, which differences between fixes do not show. (With the scatter alone, the position error with
    Kingston's receiver was larger by a quarter.) Low-passed innovations show such an error, as they contain it together
    with the errors of the state. So the factor is then the larger of two ratios: that of the scatter and that of the
    low-passed innovations, which counts as 1 if it is larger. Before there are any of these innovations, the second
    ratio is the square root of the first one.
    """
    if mem[Head.ADAPT] == 0.0:
        return 1.0
    realised, slow = realised_scatter(mem, r), r + Receiver.SLOW_SCALE
    level = mem[slow + Scale.LOG] if mem[slow + Scale.REDUCED] > 0.0 else 0.5 * math.log(realised)
    return realised if realised > 1.0 else max(realised, math.exp(min(level, 0.0)))


@njit(_nrt=False)
def excess_scatter(mem, r):
    """Factor on the claimed variance of fixes if they scatter more than they claim, else 1."""
    return max(1.0, realised_factor(mem, r))


@njit(_nrt=False)
def _claimed(mem, at):
    """Claimed variance of the fix at `at`, mean of both components, m^2."""
    return 0.5 * (mem[at + Event.R_NN] + mem[at + Event.R_EE])


@njit(_nrt=False)
def realised_variance(mem, r, at):
    """Realised variance of the fix at `at`, mean of both components, m^2."""
    return realised_factor(mem, r) * _claimed(mem, at)


@njit(_nrt=False)
def white_and_slow(mem, r, at):
    """Variances of one component of the fix at `at`, m^2: of its white errors, and of those that are nearly the same in
    the next one. The latter by its claim and by innovations, but by these no more than the white ones: they contain
    errors of the state, too."""
    white = realised_scatter(mem, r) * _claimed(mem, at)
    return white, max(_claimed(mem, at) - white, min(mem[r + Nav.LASTING], white), 0.0)


@njit(_nrt=False)
def learn(mem, r, at, left_n, left_e):
    """Update the statistics of the receiver with the fix at `at`, after its verdict.

    left_n, left_e: predicted minus measured position, m, after the correction.
    """
    time, verdict = mem[at + Event.TIME], mem[at + Event.VERDICT]
    claimed = _mean_claimed(mem, r, at)
    lasting = _lasting(mem, r, at, claimed)
    if mem[r + Nav.FIX_TIME] != 0.0 and (verdict == Verdict.USED or verdict == Verdict.WEIGHTED):
        _learn_from_innovation(mem, r, at, time - mem[r + Nav.RESIDUAL_TIME], claimed, lasting)
    if mem[Head.COVARIANCE_FACTOR] > 0.0:
        mem[r + Nav.VARIANCE_FACTOR] = scale(mem, r + Receiver.INNOVATION_SCALE)
        mem[r + Nav.LASTING] = min(lasting_factor(mem, r) * lasting,
                                   LARGEST_LASTING * max(realised_scatter(mem, r), 1.0) * claimed)
    mem[r + Nav.RESIDUAL_TIME] = time
    mem[r + Nav.RESIDUAL_N], mem[r + Nav.RESIDUAL_E] = left_n - mem[r + NAV], left_e - mem[r + NAV + 1]
    mem[r + Nav.FIX_TIME] = time
    mem[r + Nav.FIX_LATITUDE], mem[r + Nav.FIX_LONGITUDE] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]
    beyond = mem[r + Nav.WEIGHTED] > 0.0 and mem[at + Event.NIS] > mem[Head.ROBUST_SIGMA] ** 2
    # a refused fix ends the row: large innovations before it were chance or errors of the receiver, not of the state
    row_goes_on = verdict == Verdict.WEIGHTED or beyond and verdict != Verdict.REFUSED
    mem[r + Nav.WEIGHTED] = mem[r + Nav.WEIGHTED] + 1.0 if row_goes_on else 0.0


@njit(_nrt=False)
def _mean_claimed(mem, r, at):
    """Mean claimed variance of the fixes up to that at `at`, m^2. The logarithm is averaged, over about as many fixes
    as determine the position."""
    level = math.log(_claimed(mem, at))
    if mem[r + Nav.FIX_TIME] == 0.0:
        mem[r + Nav.CLAIM_LEVEL] = level
    mem[r + Nav.CLAIM_LEVEL] += (level - mem[r + Nav.CLAIM_LEVEL]) / CLAIM_MEMORY
    return math.exp(mem[r + Nav.CLAIM_LEVEL])


@njit(_nrt=False)
def _lasting(mem, r, at, claimed):
    """Variance of the slow errors of the receiver, m^2: the part of the claimed variance by which fixes do not scatter.

    The claimed variance is that of the whole error. Differences between fixes show only the part that changes from fix
    to fix (`learn_scatter`). The rest are slow errors: orbits, atmosphere, multipath. The filter follows them, so they
    are in its position error although its innovations are white. Every receiver has such errors, so a small share of
    the variance is the lower limit. claimed: mean claimed variance, m^2.
    """
    realised = realised_scatter(mem, r)
    least = LASTING_SHARE * realised * min(claimed, _claimed(mem, at))
    return max((1.0 - realised) * claimed, least)


@njit(_nrt=False)
def lasting_factor(mem, r):
    """Factor on the variance of slow errors by the claim. Innovations tell it for each time constant of these errors:
    from LASTING_TIME up to SLOWEST_LASTING_TIME. The claim is believed where it is between both, else the nearer one.
    Where these errors are larger than claimed, the factor is its expectation, not its median: that of a log-normal
    distribution, but at most its square, so that a level near zero which is not well known does not make it large.
    """
    at = r + Receiver.LASTING_SCALE
    level, variance = mem[at + Scale.LOG], max(PRIOR - mem[at + Scale.REDUCED], 0.0)
    if level > 0.0:
        return math.exp(level + min(0.5 * variance, level))
    return min(scale(mem, at) * SLOWEST_LASTING_TIME / LASTING_TIME, 1.0)


@njit(_nrt=False)
def _learn_from_innovation(mem, r, at, interval, claimed, lasting):
    """Learn three scales and the noise of the accelerometers from the low-passed innovations up to the fix at `at`.

    Innovations of a filter with a correct model are white with the covariance S. Slow errors of the receiver, or
    sensors that are worse than assumed, make them correlated. The sum of n innovations then has a variance larger than
    n S, by the factor 1 + 2 (sum of their autocorrelation), which is (1 + rho) / (1 - rho) for a first-order process.
    The covariance of the states that are learned from many fixes (velocity, attitude, biases) is too small by this
    factor. It is estimated as the variance of low-passed whitened innovations over that of white ones. The whole
    covariance is multiplied by it (a posteriori variance factor), which changes no gain.

    Slow errors of the receiver are in innovations with a shorter low pass if the filter follows them slowly
    (`shown_share`), mainly at rest. The same innovations show noise of the accelerometers beyond the assumed one
    (force_noise.py). They are not used for this if the claimed variance is far too small. If fixes are more precise
    than the prediction, each single innovation shows this noise, which the low pass would average out.

    interval: s since the previous fix. claimed: mean claimed variance, m^2. lasting: variance of slow errors by the
    claim (`_lasting`), m^2.
    """
    l_nn = math.sqrt(mem[at + Event.S_NN])
    l_en = mem[at + Event.S_NE] / l_nn
    u_n = mem[at + Event.Z_N] / l_nn
    u_e = (mem[at + Event.Z_E] - l_en * u_n) / math.sqrt(mem[at + Event.S_EE] - l_en * l_en)
    counted = min(1.0, LARGEST_INNOVATION / max(math.hypot(u_n, u_e), 1.0))
    slow, followed = r + Nav.LONG_PASSED, r + Receiver.SHORT_PASSED
    _low_pass(mem, slow, counted * u_n, counted * u_e, interval / LONG_LOW_PASS)
    _low_pass(mem, followed, counted * u_n, counted * u_e, interval / SHORT_LOW_PASS)
    if mem[slow + 2] == 0.0 or interval <= 0.0:
        return
    time, variance = mem[at + Event.TIME], 0.5 * (mem[at + Event.S_NN] + mem[at + Event.S_EE])
    factor, claim = realised_factor(mem, r), _claimed(mem, at)
    p = max(variance - factor * claim, 0.0)
    squared = 0.5 * (mem[slow] ** 2 + mem[slow + 1] ** 2) / mem[slow + 2]
    weight = min(interval / (2.0 * LONG_LOW_PASS), 1.0)
    if mem[r + Receiver.SLOW_SCALE + Scale.REDUCED] == 0.0:
        # rarer fixes than the low pass differ by all errors that are not common to several of them
        mem[r + Receiver.SLOW_SCALE + Scale.LOG] = math.log(
            factor if interval <= SHORT_LOW_PASS else realised_scatter(mem, r))
    learn_scale(mem, r + Receiver.SLOW_SCALE, time, squared * variance, claim, p, 2, weight)
    learn_scale(mem, r + Receiver.INNOVATION_SCALE, time, squared, 1.0, 0.0, 2, weight)

    white, weight = variance * mem[followed + 2], min(interval / (2.0 * SHORT_LOW_PASS), 1.0)
    squared = 0.5 * (mem[followed] ** 2 + mem[followed + 1] ** 2) * variance
    tau = min(interval * variance / max(p, 1e-9 * variance), SLOWEST_RESPONSE)
    realised = realised_scatter(mem, r)
    often = interval <= SHORT_LOW_PASS
    if realised < LARGEST_SCATTER:
        lasts = max(1.0 - realised, 0.0) * claimed
        if p > 0.5 * variance:  # the gain is above one half: a single innovation shows whether P is too small
            alone = 0.5 * counted**2 * (u_n * u_n + u_e * u_e) * variance
            learn_force_noise(mem, r, time, alone, variance, p, tau, lasts, 0.5 * p / variance)
        elif often:  # of rarer fixes the low pass does not separate slow errors from noise
            learn_force_noise(mem, r, time, squared, white, p, tau, lasts, weight)
    elif often:
        # until now, noise of the fixes may have been learned as noise of the accelerometers; of rare fixes, such
        # scatter may be theirs
        reset_scale(mem, r + ForceNoise.SCALE)
    learn_scale(mem, r + Receiver.LASTING_SCALE, time, squared, shown_share(tau) * lasting, white, 2, weight)


@njit(_nrt=False)
def _low_pass(mem, at, north, east, elapsed):
    """Update a first-order low pass at mem[at]: north, east and its variance for a white input of variance 1.

    elapsed: time since the previous update over the time constant.
    """
    keep = math.exp(-elapsed)
    mem[at] += (1.0 - keep) * (north - mem[at])
    mem[at + 1] += (1.0 - keep) * (east - mem[at + 1])
    mem[at + 2] = keep**2 * mem[at + 2] + (1.0 - keep) ** 2


@njit(_nrt=False)
def innovation_factor(mem, r):
    """Ratio of the realised to the expected variance of low-passed innovations, at least 1."""
    return max(1.0, scale(mem, r + Receiver.INNOVATION_SCALE))


@njit(_nrt=False)
def shown_share(tau):
    """Share of the variance of slow errors (first-order Gauss-Markov, LASTING_TIME) that is in low-passed innovations.

    tau: s, time constant with which the filter follows positions; it follows velocities with the damping 1 / sqrt(2).
    Such errors are nearly a random walk. Their part of the innovations is this process, filtered with the transfer
    function s^2 / (s^2 + s / tau + 1 / (2 tau^2)). After the low pass, its share of the variance is
    SHORT_LOW_PASS / (LASTING_TIME f (1 + f + f^2 / 2)), with f = SHORT_LOW_PASS / tau.
    """
    f = SHORT_LOW_PASS / tau
    return min(SHORT_LOW_PASS / (LASTING_TIME * f * (1.0 + f + 0.5 * f * f)), LARGEST_SHOWN)


@njit(_nrt=False)
def learn_scatter(mem, r, at):
    """Learn the ratio of the realised to the claimed variance from three fixes about a second apart.

    The event at `at` contains the innovation of the fix before the correction. The corrections of position and velocity
    since the first of the three fixes are subtracted from the innovations. What is left are errors of the receiver,
    errors of the inertial sensors during this time, and the errors of position and velocity at the first fix. The
    latter change linearly with time, so the second difference does not contain them.
    """
    z_n, z_e = mem[at + Event.Z_N] - mem[r + NAV], mem[at + Event.Z_E] - mem[r + NAV + 1]
    time, claimed = mem[at + Event.TIME], _claimed(mem, at)
    before, mem[r + Receiver.CLAIMED] = mem[r + Receiver.CLAIMED], claimed
    if before > 0.0 and (claimed * CLAIM_CHANGE < before or claimed > CLAIM_CHANGE * before):
        changed = claimed / before
        reopen(mem, r + Receiver.SMOOTH_SCALE, changed)
        reopen(mem, r + Receiver.SCALE, changed)
        reset_scale(mem, r + Receiver.SLOW_SCALE)
        for i in (Receiver.FIRST + 1, Receiver.SECOND + 3):
            mem[r + i] *= changed  # the ratio refers to the new claimed variance
    _learn_from_line(mem, r, at, claimed)
    moved, second, first = r + Receiver.MOVED, r + Receiver.SECOND, r + Receiver.FIRST
    fits, since, length = True, time - mem[first], mem[second + 2]
    for i in range(2):
        mem[moved + i] += (time - mem[r + Nav.FIX_TIME]) * mem[moved + 2 + i]
    north, east = z_n - mem[moved], z_e - mem[moved + 1]
    if mem[first] != 0.0:
        if since - length < SHORTEST_PAIR:
            return
        if length == 0.0:
            mem[second], mem[second + 1], mem[second + 2], mem[second + 3] = north, east, since, claimed
            return
        ratio = (since - length) / length
        north -= (1.0 + ratio) * mem[second]
        east -= (1.0 + ratio) * mem[second + 1]
        part = claimed + (1.0 + ratio) ** 2 * mem[second + 3] + ratio**2 * mem[first + 1]
        squared, noise_share = 0.5 * (north * north + east * east), (since - length) ** 2 * since / 3.0
        unseen = _unseen_acceleration(mem, r) * (0.5 * (since - length) * since) ** 2
        fits = learn_changes(mem, r + Receiver.SCALE, time, squared, part,
                             unseen + force_noise(mem, r) * noise_share, 2)
        if since - length > SHORT_LOW_PASS:  # else it is learned from innovations
            learn_from_change(mem, r, time, squared, noise_share, realised_scatter(mem, r) * part + unseen)
    # the next three fixes begin with this one, unless it is an outlier: an outlier is counted only once
    mem[first], mem[first + 1], mem[second + 2] = time if fits else 0.0, claimed, 0.0
    mem[moved], mem[moved + 1], mem[moved + 2], mem[moved + 3] = z_n, z_e, 0.0, 0.0


@njit(_nrt=False)
def _unseen_acceleration(mem, r):
    """Variance of a horizontal component of the acceleration error by the tilt error, (m/s^2)^2."""
    most = UNSEEN_ACCELERATION**2
    return min(tilt_variance(mem, r), most) if row_of(mem, Error.PHI_N) >= 0 else most


@njit(_nrt=False)
def _learn_from_line(mem, r, at, claimed):
    """Learn an upper limit of the ratio of the realised to the claimed variance without the inertial sensors.

    Three fixes of a vehicle with constant velocity deviate from uniform motion on a straight line only by their errors.
    Acceleration of the vehicle increases the deviation. claimed: variance of the fix at `at`, m^2.
    """
    last, first = r + Receiver.LAST_TWO, r + Receiver.LAST_TWO + 3
    time, latitude, longitude = mem[at + Event.TIME], mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]
    step, whole = time - mem[last], time - mem[first]
    if mem[last] != 0.0 and step < SHORTEST_PAIR:
        return
    if mem[first] != 0.0 and whole < LONGEST_OF_THREE:
        part = step / whole
        if mem[r + Receiver.SMOOTH_SCALE + Scale.REDUCED] == 0.0:  # initial value: the scale learned so far
            mem[r + Receiver.SMOOTH_SCALE + Scale.LOG] = max(mem[r + Receiver.SCALE + Scale.LOG], 0.0)
        north = (mem[last + 1] - latitude + part * (latitude - mem[first + 1])) / mem[r + Nav.NORTH_SCALE]
        east = (mem[last + 2] - longitude + part * (longitude - mem[first + 2])) / mem[r + Nav.EAST_SCALE]
        fits = learn_changes(mem, r + Receiver.SMOOTH_SCALE, time, 0.5 * (north * north + east * east),
                             claimed * (1.0 + part * part + (1.0 - part) ** 2), 0.0, 2)
        mem[first], mem[last] = 0.0, 0.0
        if not fits:
            return
    for i in range(3):
        mem[first + i] = mem[last + i]
    mem[last], mem[last + 1], mem[last + 2] = time, latitude, longitude
