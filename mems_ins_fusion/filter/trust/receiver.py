"""What the filter makes of its GNSS receiver: with which weight its fixes are used.

A receiver repeats itself, jumps, wanders and states a sigma that is not its own. The realised scatter is seen in how
three fixes that follow each other differ from what the inertial sensors say of the displacements between them.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements.acceleration import tilt_variance
from ..memory import NAV, ROW, Error, Event, Head, Nav, Verdict, row_of
from .force_noise import ForceNoise, force_noise, learn_force_noise, learn_from_change
from .scale import PRIOR, Scale, learn_changes, reopen, reset_scale, scale
from .scale import learn as learn_scale

#: of a state
Receiver = ROW.place(
    'Receiver',
    CLAIMED=1,  # variance of the last fix, as it says, m^2
    FIRST=2,  # of three fixes, a second or more apart, the first: time, s (0: none), and the variance it claims, m^2,
    SECOND=4,  # the second: predicted minus measured position, m, beside MOVED, s after the first (0: none), variance,
    MOVED=4,  # and how fixes have moved position and velocity since the first, m, m/s, and how far off that was
    SHORT_PASSED=3,  # whitened innovations behind a low pass of SHORT_LOW_PASS, and their variance were they white
    LAST_TWO=6,  # two fixes before the next one: time, s, latitude and longitude, rad,
    SMOOTH_SCALE=Scale.CHANGING_SIZE,  # realised over claimed variance at most, as three fixes are off a straight line,
    SCALE=Scale.CHANGING_SIZE,  # realised over claimed variance of the fixes,
    SLOW_SCALE=Scale.SIZE,  # the same as the innovations behind a low pass show it,
    LASTING_SCALE=Scale.SIZE,  # of what of it lasts over what is expected of that,
    INNOVATION_SCALE=Scale.SIZE,  # and of the innovations behind a low pass
    STATUS=1,  # of the fixes that the first four scales are of, `NavSatStatus.status` and 1; 0: none yet,
    BY_STATUS=3 * 2 * (Scale.CHANGING_SIZE + Scale.SIZE))  # and these scales of the fixes of each status

#: s from the first to the last of three fixes that are compared with a straight line: in more, what a vehicle does
#: takes it further from that than any receiver scatters. A fix each ten seconds still counts
LONGEST_OF_THREE = 30.0
#: s over which the receiver's scatter is seen in how its error changes: over less than that errors are alike
SHORTEST_PAIR = 0.9
#: m/s^2, by which the inertial sensors are wrong in between at most, as far as the filter knows: half a degree of tilt
UNSEEN_ACCELERATION = 0.1
#: m: a fix nearer than this is never refused, only weighted down. A filter that is off by so much without knowing it,
#: as with an unknown time offset at 20 m/s, else refuses right fixes (Longmont: RMSE 0.26 m with it, 4.6 m without)
GATE_FLOOR = 5.0
#: s for which a row of fixes is weighted down at most: then it is the filter that is wrong, and they are used as
#: they are until they fit again (without the end good fixes are refused by a filter whose accelerometers are off)
LONGEST_WEIGHTED = 4.0
#: s: what grows from fix to fix is the filter's own error, where they are no further apart than that
LONGEST_GROWTH = 10.0
#: m/s^2, by which the filter's own error grows at most: a tilt that is three degrees wrong
LARGEST_GROWTH = 0.5
#: factor by which the claimed variance changes at once where it is another claim, and no other error: the realised
#: variance is then as it was until the fixes show more
CLAIM_CHANGE = 10.0
#: s over which innovations are averaged to see whether they are white: what lasts for shorter averages out
LONG_LOW_PASS = 10.0
#: s over which they are averaged to see errors that last: such errors, followed by the filter, are in its innovations
#: most where these change about as fast as it follows, within seconds (docs/filter.md)
SHORT_LOW_PASS = 4.0
#: s: fixes that are followed more slowly than that are followed by other measurements, too
SLOWEST_RESPONSE = 30.0
#: normalized innovation as which a larger one counts: one fix far off is not a filter that is too sure
LARGEST_INNOVATION = 4.0
#: share of the variance of fixes that counts as errors that last before any have been seen, whatever they scatter: of
#: no receiver are all errors white
LASTING_SHARE = 0.05
#: s, time constant of such errors: multipath of a moving vehicle lasts for shorter, atmosphere and orbits for longer
LASTING_TIME = 60.0
#: share of the variance of errors that last which shows behind a low pass of SHORT_LOW_PASS at most, at rest
LARGEST_SHOWN = 0.3
#: variance of errors that last at most, over that which fixes claim or scatter: a sigma that is off by a factor of
#: three, one sigma of `scale.PRIOR`. They show in innovations by a small share, so that an IMU that is worse than
#: configured, or a receiver that smooths, would pass for errors of tens of metres
LARGEST_LASTING = 9.0
#: realised over claimed variance from which on fixes show nothing of the accelerometers: a receiver that claims a tenth
#: of its sigma. What its scatter is, is then not known well enough
LARGEST_SCATTER = 100.0
#: fixes over which the logarithm of what they claim is averaged: about as many as the position remembers
CLAIM_MEMORY = 10.0


@njit(_nrt=False)
def take_status(mem, r, at):
    """Go on with the scales of fixes with the status of the fix at `at`: one that is fixed to a base, one that is
    corrected and one that is neither are measured in three ways, and each has errors of its own."""
    before, status = int(mem[r + Receiver.STATUS]), min(max(int(mem[at + Event.STATUS]), 0), 2) + 1
    mem[r + Receiver.STATUS] = status
    if before == 0 or before == status:
        return
    size = 2 * (Scale.CHANGING_SIZE + Scale.SIZE)
    left, found = r + Receiver.BY_STATUS + size * (before - 1), r + Receiver.BY_STATUS + size * (status - 1)
    for i in range(size):
        mem[left + i] = mem[r + Receiver.SMOOTH_SCALE + i]
        mem[r + Receiver.SMOOTH_SCALE + i] = mem[found + i]
    # the error has not changed since the last fix, it is another one
    for i in (Receiver.CLAIMED, Receiver.FIRST, Receiver.LAST_TWO, Receiver.LAST_TWO + 3):
        mem[r + i] = 0.0


@njit(_nrt=False)
def factor_and_limits(mem, r, at):
    """Factor on the covariance of the fix at `at`, and where it is weighted down and where refused, in sigmas.

    Called with its innovation before the correction, in which x is still to be taken out.
    """
    z_n, z_e = mem[at + Event.Z_N] - mem[r + NAV], mem[at + Event.Z_E] - mem[r + NAV + 1]
    # refused only if it is off by something that matters, and has become so at once: what grows from fix to fix is the
    # filter's own error
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
    """Realised over claimed variance, as fixes scatter about the way that the inertial sensors see, but no more than
    three fixes in a row are off a straight line: what is seen beyond that is the inertial sensors'."""
    realised, smooth = scale(mem, r + Receiver.SCALE), r + Receiver.SMOOTH_SCALE
    if mem[smooth + Scale.REDUCED] == 0.0:
        return realised
    most = math.exp(mem[smooth + Scale.LOG] + math.sqrt(max(PRIOR - mem[smooth + Scale.REDUCED], 0.0)))
    return min(realised, max(most, 1.0))


@njit(_nrt=False)
def realised_factor(mem, r):
    """Factor on the covariance that a fix claims: as fixes scatter, where that is more than they claim.

    Where they scatter less, what they have in common does not show between them (Kingston's receiver, believed by its
    scatter alone, made the position worse by a quarter). It shows in the innovations behind a low pass, which are of
    what the filter averages over: the larger of both is believed. Before any have shown it is half-way between the
    scatter and the claim, as a logarithm.
    """
    if mem[Head.ADAPT] == 0.0:
        return 1.0
    realised, slow = realised_scatter(mem, r), r + Receiver.SLOW_SCALE
    level = mem[slow + Scale.LOG] if mem[slow + Scale.REDUCED] > 0.0 else 0.5 * math.log(realised)
    return realised if realised > 1.0 else max(realised, math.exp(min(level, 0.0)))


@njit(_nrt=False)
def excess_scatter(mem, r):
    """Factor on the variance that fixes claim, as they scatter, where that is more."""
    return max(1.0, realised_factor(mem, r))


@njit(_nrt=False)
def _claimed(mem, at):
    """Variance of a component that the fix at `at` claims, m^2."""
    return 0.5 * (mem[at + Event.R_NN] + mem[at + Event.R_EE])


@njit(_nrt=False)
def realised_variance(mem, r, at):
    """Of a component of the fix at `at`, m^2, as fixes have been seen to scatter."""
    return realised_factor(mem, r) * _claimed(mem, at)


@njit(_nrt=False)
def learn(mem, r, at, left_n, left_e):
    """Remember the fix at `at`, which has been judged; left_n, left_e: predicted minus measured position after that."""
    time, verdict = mem[at + Event.TIME], mem[at + Event.VERDICT]
    claimed = _mean_claimed(mem, r, at)
    lasting = _lasting(mem, r, at, claimed)
    if mem[r + Nav.FIX_TIME] != 0.0 and (verdict == Verdict.USED or verdict == Verdict.WEIGHTED):
        _learn_from_innovation(mem, r, at, time - mem[r + Nav.RESIDUAL_TIME], claimed, lasting)
    if mem[Head.COVARIANCE_FACTOR] > 0.0:
        mem[r + Nav.VARIANCE_FACTOR] = scale(mem, r + Receiver.INNOVATION_SCALE)
        mem[r + Nav.LASTING] = min(scale(mem, r + Receiver.LASTING_SCALE) * lasting,
                                   LARGEST_LASTING * max(realised_scatter(mem, r), 1.0) * claimed)
    mem[r + Nav.RESIDUAL_TIME] = time
    mem[r + Nav.RESIDUAL_N], mem[r + Nav.RESIDUAL_E] = left_n - mem[r + NAV], left_e - mem[r + NAV + 1]
    mem[r + Nav.FIX_TIME] = time
    mem[r + Nav.FIX_LATITUDE], mem[r + Nav.FIX_LONGITUDE] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]
    beyond = mem[r + Nav.WEIGHTED] > 0.0 and mem[at + Event.NIS] > mem[Head.ROBUST_SIGMA] ** 2
    # one that is refused ends the row: those before it were off by chance, or the receiver is wrong, not the filter
    row_goes_on = verdict == Verdict.WEIGHTED or beyond and verdict != Verdict.REFUSED
    mem[r + Nav.WEIGHTED] = mem[r + Nav.WEIGHTED] + 1.0 if row_goes_on else 0.0


@njit(_nrt=False)
def _mean_claimed(mem, r, at):
    """Variance that fixes claim, m^2: the mean of its logarithm over about as many as the position remembers, with the
    fix at `at`."""
    level = math.log(_claimed(mem, at))
    if mem[r + Nav.FIX_TIME] == 0.0:
        mem[r + Nav.CLAIM_LEVEL] = level
    mem[r + Nav.CLAIM_LEVEL] += (level - mem[r + Nav.CLAIM_LEVEL]) / CLAIM_MEMORY
    return math.exp(mem[r + Nav.CLAIM_LEVEL])


@njit(_nrt=False)
def _lasting(mem, r, at, claimed):
    """Variance of the receiver's errors that last, m^2: what it claims, and fixes do not scatter.

    A receiver states how far off it may be, and fixes show of that what changes between them (`learn_scatter`). The
    rest are errors of orbits, atmosphere and multipath: the filter follows them, its innovations stay white, and its
    position is as far off. No receiver is without; a share counts as such. claimed: variance that fixes claim, m^2.
    """
    realised = realised_scatter(mem, r)
    least = LASTING_SHARE * realised * min(claimed, _claimed(mem, at))
    return max((1.0 - realised) * claimed, least)


@njit(_nrt=False)
def _learn_from_innovation(mem, r, at, interval, claimed, lasting):
    """Learn from the innovations behind low passes what is wrong with their covariance, from the fix at `at`.

    Innovations of a filter that is right are white with covariance S. Receivers whose errors last and filters whose
    sensors are worse than assumed have innovations that last: the sum of n of them has a variance larger than n S, by
    the factor 1 + 2 (sum of their autocorrelation) - (1 + rho) / (1 - rho) for a first-order process - and by so much
    the covariance of what is learned from many fixes (velocity, attitude, biases) is too small. It is seen as the
    variance of whitened innovations behind a first-order low pass, over the one that it has for white ones, and the
    whole covariance is scaled by it (the a posteriori variance factor): no gain changes.

    Errors of the receiver that last show behind a shorter low pass where the filter does not follow them at once
    (`shown_share`), at rest above all. The same innovations show accelerometers that are noisier than assumed
    (force_noise.py), but not beside a receiver whose claims are far too small. Where fixes are more precise than the
    prediction, such noise shows in each innovation; the low pass would average it out.

    interval: s since the fix before. claimed: variance that fixes claim, lasting: of errors that last, as far as they
    claim those, m^2.
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
        mem[r + Receiver.SLOW_SCALE + Scale.LOG] = math.log(factor)
    learn_scale(mem, r + Receiver.SLOW_SCALE, time, squared * variance, claim, p, 2, weight)
    learn_scale(mem, r + Receiver.INNOVATION_SCALE, time, squared, 1.0, 0.0, 2, weight)

    white, weight = variance * mem[followed + 2], min(interval / (2.0 * SHORT_LOW_PASS), 1.0)
    squared = 0.5 * (mem[followed] ** 2 + mem[followed + 1] ** 2) * variance
    tau = min(interval * variance / max(p, 1e-9 * variance), SLOWEST_RESPONSE)
    realised = realised_scatter(mem, r)
    if interval <= SHORT_LOW_PASS:  # the low pass of rarer fixes does not part what lasts from their scatter
        if realised < LARGEST_SCATTER:
            lasts = max(1.0 - realised, 0.0) * claimed
            if p > 0.5 * variance:  # each fix is followed by more than half: its innovation alone shows what P lacks
                alone = 0.5 * counted**2 * (u_n * u_n + u_e * u_e) * variance
                learn_force_noise(mem, r, time, alone, variance, p, tau, lasts, 0.5 * p / variance)
            else:
                learn_force_noise(mem, r, time, squared, white, p, tau, lasts, weight)
        else:  # before that was known its scatter has passed for noise of the accelerometers
            reset_scale(mem, r + ForceNoise.SCALE)
    learn_scale(mem, r + Receiver.LASTING_SCALE, time, squared, shown_share(tau) * lasting, white, 2, weight)


@njit(_nrt=False)
def _low_pass(mem, at, north, east, elapsed):
    """A first-order low pass at mem[at], north and east, and its variance for white numbers of variance 1.

    elapsed: since the last ones, in time constants.
    """
    keep = math.exp(-elapsed)
    mem[at] += (1.0 - keep) * (north - mem[at])
    mem[at + 1] += (1.0 - keep) * (east - mem[at + 1])
    mem[at + 2] = keep**2 * mem[at + 2] + (1.0 - keep) ** 2


@njit(_nrt=False)
def innovation_factor(mem, r):
    """Realised over expected variance of the innovations behind a low pass, where it is above 1."""
    return max(1.0, scale(mem, r + Receiver.INNOVATION_SCALE))


@njit(_nrt=False)
def shown_share(tau):
    """Share of the variance of a first-order Gauss-Markov process with LASTING_TIME that is in low-passed innovations.

    tau: s, within which the filter follows positions; velocities it follows with the damping 1 / sqrt(2). Its
    innovations are such a process, nearly a random walk, behind s^2 / (s^2 + s / tau + 1 / (2 tau^2)). After the low
    pass SHORT_LOW_PASS / (LASTING_TIME f (1 + f + f^2 / 2)) of the variance is left, f = SHORT_LOW_PASS / tau.
    """
    f = SHORT_LOW_PASS / tau
    return min(SHORT_LOW_PASS / (LASTING_TIME * f * (1.0 + f + 0.5 * f * f)), LARGEST_SHOWN)


@njit(_nrt=False)
def learn_scatter(mem, r, at):
    """Realised over claimed variance, from the second difference of the errors of three fixes about a second apart.

    Called with the innovation of the fix at `at` before the correction. Innovations, less what the corrections since
    the first of the three have done to position and velocity, are errors of the receiver, of the inertial sensors in
    that time, and of the position and velocity at the first, which change evenly: not in the second difference.
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
            mem[r + i] *= changed  # it is realised over what is claimed from now on, too
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
        if since - length > SHORT_LOW_PASS:  # else innovations tell it
            learn_from_change(mem, r, time, squared, noise_share, realised_scatter(mem, r) * part + unseen)
    # the next three begin with this fix, unless it is far off, which counts once
    mem[first], mem[first + 1], mem[second + 2] = time if fits else 0.0, claimed, 0.0
    mem[moved], mem[moved + 1], mem[moved + 2], mem[moved + 3] = z_n, z_e, 0.0, 0.0


@njit(_nrt=False)
def _unseen_acceleration(mem, r):
    """Variance of an acceleration to north or east that is an error of the tilt, (m/s^2)^2."""
    most = UNSEEN_ACCELERATION**2
    return min(tilt_variance(mem, r), most) if row_of(mem, Error.PHI_N) >= 0 else most


@njit(_nrt=False)
def _learn_from_line(mem, r, at, claimed):
    """Realised over claimed variance at most, without the inertial sensors: three fixes of a vehicle that keeps its
    velocity lie on a straight line, evenly in time, but for their errors; what the vehicle does besides adds to it.

    claimed: variance of the fix at `at`, m^2.
    """
    last, first = r + Receiver.LAST_TWO, r + Receiver.LAST_TWO + 3
    time, latitude, longitude = mem[at + Event.TIME], mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]
    step, whole = time - mem[last], time - mem[first]
    if mem[last] != 0.0 and step < SHORTEST_PAIR:
        return
    if mem[first] != 0.0 and whole < LONGEST_OF_THREE:
        part = step / whole
        if mem[r + Receiver.SMOOTH_SCALE + Scale.REDUCED] == 0.0:  # begins with what the start has shown
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
