"""Did the vehicle creep while it seemed to stand? The hypothesis that the latest standstill was none.

A car that creeps at a constant speed on a smooth road is as quiet as at rest (`standstill.py`). After a standstill that
was none, velocity and position are off by much more than their covariance says. By this hypothesis the vehicle moved
with a constant velocity v, of normal distribution: the velocity of the state is off by v, and its position by v times
the *lag*, the time since then reduced by what fixes have corrected. Both hypotheses give each fix a likelihood; a
Kalman filter estimates v. Where the creep is much more likely, the state is corrected by it. The direction of v is
taken for unknown: a slow robot turns more slowly than its gyroscopes can tell, and a vehicle may go backwards.

If the fixes have excluded the creep, another one may begin at any time (a robot that starts to move slowly): the
hypothesis begins anew where it has become less likely than that, or its velocity is below SLOWEST_SPEED (E. S. Page,
"Continuous inspection schemes", Biometrika 41, 1954).
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import NAV, ROW, Event, Nav, velocity_state
from . import offset
from .hypotheses import FAULT_END_RATE, LOG_RANGE, SHORTEST_CORRELATION
from .receiver import LASTING_TIME
from .scale import OUTLIER_SHARE
from .standstill import CREEP_SCATTER, CREEP_SPEED, CREEP_TIME, SLOWEST_SPEED, SURE_ODDS, Standing, stands

#: of a state
Creep = ROW.place(
    'Creep',
    ODDS=1,  # how many times as likely it is that the vehicle stood; 0: there has been no standstill
    VELOCITY=2,  # m/s, if it crept: estimate of its velocity, north and east,
    VARIANCE=1,  # and variance of each component, (m/s)^2
    LAG=1,  # s: position error of the state over this velocity
    TIME=1,  # s, until which LAG is known
    FIX_WRONG=1,  # if it stood: probability that the latest fix has an offset
    FOUND=1)  # s, time of the latest fix that showed that the vehicle crept; 0: none

#: odds at which a creep begins anew: a vehicle that starts to move without being noticed is rare. Chosen, not measured
UNNOTICED_START = 1e5
#: (m/s)^2, variance of a component of the velocity of a creep before there are fixes: its mean square in any direction
CREEP_VARIANCE = 0.5 * (CREEP_SPEED**2 + CREEP_SCATTER**2)
#: s after the latest zero-velocity update for which the hypothesis is kept: after that the vehicle has probably turned.
#: Chosen, not measured
LONGEST_CREEP = 60.0
#: s, longest interruption of its quiet after which a creep goes on: a few times CREEP_TIME. After minutes of driving
#: without fixes another standstill has nothing to do with it. Chosen, not measured
LONGEST_INTERRUPTION = 10.0
#: s for which standstills are not used after a creep that was taken for a standstill: time to learn the level of
#: motion. Chosen, not measured
MOTION_TIME = 60.0


@njit(_nrt=False)
def note_standstill(mem, r, p, n, since, quiet, odds):
    """Begin the hypothesis with the first zero-velocity update of a standstill, to be applied to the state at r.

    One that fixes have not excluded goes on over an interruption of some seconds: a creep is often not quiet for all of
    its time, and the state is off by all of it.

    p: position of P, of n states; the update moves the position by what it has in common with the velocity, too. since:
    s since the previous application of a constraint. quiet: s for which the vehicle has been as quiet as at rest. odds:
    `standstill.odds_of_standing`; they rise during the standstill.
    """
    interruption = mem[r + Nav.TIME] - mem[r + Standing.TIME]
    goes_on = mem[r + Creep.ODDS] < UNNOTICED_START and interruption < LONGEST_INTERRUPTION
    if mem[r + Creep.ODDS] > 0.0 and (stands(mem, r) or goes_on):
        mem[r + Creep.ODDS] *= (CREEP_TIME + quiet) / (CREEP_TIME + quiet - since)
        return
    v, w = velocity_state(mem), velocity_state(mem) + 1
    common, variance = mem[p + v] + mem[p + n + w], mem[p + (n + 1) * v] + mem[p + (n + 1) * w]
    _begin(mem, r, mem[r + Nav.TIME], odds, common / variance)


@njit(_nrt=False)
def _begin(mem, r, time, odds, lag):
    """Begin the hypothesis at `time`, s, with these odds and this LAG, s."""
    mem[r + Creep.ODDS], mem[r + Creep.VARIANCE] = odds, CREEP_VARIANCE
    mem[r + Creep.VELOCITY] = mem[r + Creep.VELOCITY + 1] = mem[r + Creep.FIX_WRONG] = 0.0
    mem[r + Creep.LAG], mem[r + Creep.TIME] = lag, time


@njit(_nrt=False)
def crept(mem, r, at, variance, slow):
    """Compare both hypotheses with the fix at `at`, before it corrects the state at r. Returns whether the vehicle
    crept.

    variance: of a component of the innovation, m^2, without the slow errors of the receiver, which are nearly the same
    in successive fixes. slow: variance of these, m^2.
    """
    creep, time = r + Creep.ODDS, mem[at + Event.TIME]
    if mem[creep] == 0.0 or time - mem[r + Standing.TIME] > LONGEST_CREEP:
        mem[creep] = 0.0
        return False
    velocity = r + Creep.VELOCITY
    squared = mem[velocity] ** 2 + mem[velocity + 1] ** 2 + 2.0 * mem[r + Creep.VARIANCE]
    excluded = mem[creep] > UNNOTICED_START or squared < SLOWEST_SPEED**2
    if excluded and mem[r + Creep.FIX_WRONG] < 0.5:  # while fixes are off, a creep that has begun before may be why
        _begin(mem, r, mem[r + Creep.TIME], UNNOTICED_START, 0.0)
    elapsed = max(time - mem[r + Creep.TIME], 0.0)
    mem[r + Creep.LAG] += elapsed
    mem[r + Creep.TIME] = time
    # by how much the slow errors have changed since then; the part of the variance that is new in this fix is the
    # weight of its likelihood
    changed = slow * min(2.0 * abs(mem[r + Creep.LAG]) / LASTING_TIME, 1.0)
    new = slow * min(2.0 * elapsed / LASTING_TIME, 1.0)
    counts = min((variance * min(elapsed / SHORTEST_CORRELATION, 1.0) + new) / (variance + changed), 1.0)
    variance += changed
    if counts == 0.0:
        return False
    lag, spread = mem[r + Creep.LAG], mem[r + Creep.VARIANCE]
    # predicted minus measured position
    north, east = mem[at + Event.Z_N] - mem[r + NAV], mem[at + Event.Z_E] - mem[r + NAV + 1]
    anywhere = OUTLIER_SHARE / (2.0 * math.pi * LOG_RANGE * (north * north + east * east + 4.0 * variance))
    stood = _density_if_stood(mem, r, north, east, variance, anywhere, elapsed)
    off_n, off_e, expected = north + lag * mem[velocity], east + lag * mem[velocity + 1], variance + lag * lag * spread
    fits = offset.density(off_n, off_e, expected, 0.0, 0.0)
    mem[creep] *= (stood / (fits + anywhere)) ** counts
    if fits < anywhere:
        return False
    gain = spread * lag / (variance / counts + lag * lag * spread)
    mem[velocity] -= gain * off_n
    mem[velocity + 1] -= gain * off_e
    mem[r + Creep.VARIANCE] -= gain * lag * spread
    return mem[creep] * SURE_ODDS < 1.0


@njit(_nrt=False)
def _density_if_stood(mem, r, north, east, variance, anywhere, elapsed):
    """Density, 1/m^2, of the difference (north, east), m, of prediction and fix if the vehicle stood: the fix is right,
    an outlier, or has the offset of the previous one once more."""
    wrong = mem[r + Creep.FIX_WRONG] * math.exp(-FAULT_END_RATE * elapsed)
    again_n, again_e = north - mem[r + Nav.RESIDUAL_N], east - mem[r + Nav.RESIDUAL_E]
    right = (1.0 - wrong) * offset.density(north, east, variance, 0.0, 0.0)
    other = anywhere + wrong * offset.density(again_n, again_e, 2.0 * variance, 0.0, 0.0)
    mem[r + Creep.FIX_WRONG] = other / (right + other)
    return right + other


@njit(_nrt=False)
def correct(mem, r, p, n):
    """Correct the state at r by the creep, and raise P, which is at p, of n states, by its uncertainty."""
    lag, variance, first = mem[r + Creep.LAG], mem[r + Creep.VARIANCE], velocity_state(mem)
    for i in range(2):
        velocity, v = mem[r + Creep.VELOCITY + i], first + i
        mem[r + NAV + i] -= lag * velocity
        mem[r + NAV + v] -= velocity
        mem[p + (n + 1) * i] += lag * lag * variance
        mem[p + n * i + v] += lag * variance
        mem[p + n * v + i] += lag * variance
        mem[p + (n + 1) * v] += variance
    mem[r + Creep.FOUND] = mem[r + Creep.TIME]  # the time of this fix, by `crept`
    mem[r + Creep.ODDS] = 0.0


@njit(_nrt=False)
def has_crept(mem, r):
    """Whether fixes have recently shown that the vehicle crept while it was as quiet as at rest."""
    return mem[r + Creep.FOUND] != 0.0 and mem[r + Nav.TIME] - mem[r + Creep.FOUND] < MOTION_TIME


@njit(_nrt=False)
def note_correction(mem, r, gain):
    """Note that a fix has corrected the position by `gain` times the innovation."""
    mem[r + Creep.LAG] *= 1.0 - gain
