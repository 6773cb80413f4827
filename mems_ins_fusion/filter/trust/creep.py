"""Did the vehicle creep while it seemed to stand? The hypothesis that the latest standstill was none.

A car that creeps at a constant speed on a smooth road is as quiet as at rest (`standstill.py`). After a standstill that
was none, velocity and position are off by much more than their covariance says. By this hypothesis the vehicle moved
forward with a constant speed v, which has a normal distribution: the velocity of the state is off by v, and its
position by v times the *lag*, the time since then reduced by what fixes have corrected. Both hypotheses give each fix a
likelihood; a Kalman filter of one state estimates v. Where the creep is much more likely, the state is corrected by
it.

If the fixes have excluded the creep, another one may begin at any time (a robot that starts to move slowly): the
hypothesis begins anew where it has become less likely than that, or its speed is below SLOWEST_SPEED (E. S. Page,
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
    SPEED=1,  # m/s, if it crept: estimate of its speed,
    VARIANCE=1,  # and variance of it, (m/s)^2
    LAG=1,  # s: position error of the state over this speed
    TIME=1,  # s, until which LAG is known
    FORWARD=2,  # north and east component of the forward direction
    FIX_WRONG=1)  # if it stood: probability that the latest fix has an offset

#: odds at which a creep begins anew: a vehicle that starts to move without being noticed is rare. Chosen, not measured
UNNOTICED_START = 1e5
#: s after the latest zero-velocity update for which the hypothesis is kept: after that the vehicle has probably turned,
#: and its forward direction is no longer FORWARD. Chosen, not measured
LONGEST_CREEP = 60.0


@njit(_nrt=False)
def note_standstill(mem, r, p, n, c, since, quiet, odds):
    """Begin the hypothesis with the first zero-velocity update of a standstill, to be applied to the state at r.

    p: position of P, of n states; the update moves the position by what it has in common with the velocity, too. c:
    rotation from the vehicle's axes to n (9 elements). since: s since the previous application of a constraint.
    quiet: s for which the vehicle has been as quiet as at rest. odds: `standstill.odds_of_standing`; they rise
    during the standstill.
    """
    if stands(mem, r) and mem[r + Creep.ODDS] > 0.0:
        mem[r + Creep.ODDS] *= (CREEP_TIME + quiet) / (CREEP_TIME + quiet - since)
        return
    forward = math.hypot(c[0], c[3])
    mem[r + Creep.FORWARD], mem[r + Creep.FORWARD + 1] = c[0] / forward, c[3] / forward
    v, w = velocity_state(mem), velocity_state(mem) + 1
    common, variance = mem[p + v] + mem[p + n + w], mem[p + (n + 1) * v] + mem[p + (n + 1) * w]
    _begin(mem, r, mem[r + Nav.TIME], odds, common / variance)


@njit(_nrt=False)
def _begin(mem, r, time, odds, lag):
    mem[r + Creep.ODDS], mem[r + Creep.SPEED], mem[r + Creep.VARIANCE] = odds, CREEP_SPEED, CREEP_SCATTER**2
    mem[r + Creep.LAG], mem[r + Creep.TIME], mem[r + Creep.FIX_WRONG] = lag, time, 0.0


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
    excluded = mem[creep] > UNNOTICED_START or mem[r + Creep.SPEED] < SLOWEST_SPEED
    if excluded and mem[r + Creep.FIX_WRONG] < 0.5:  # while fixes are off, a creep that has begun before may be why
        _begin(mem, r, mem[r + Creep.TIME], UNNOTICED_START, 0.0)
    elapsed = max(time - mem[r + Creep.TIME], 0.0)
    mem[r + Creep.LAG] += elapsed
    mem[r + Creep.TIME] = time
    # the part of the variance that is new in this fix: it is the weight of its likelihood
    counts = (variance * min(elapsed / SHORTEST_CORRELATION, 1.0) + slow * min(elapsed / LASTING_TIME, 1.0)) / (
        variance + slow)
    variance += slow
    if counts == 0.0:
        return False
    lag, speed, spread = mem[r + Creep.LAG], mem[r + Creep.SPEED], mem[r + Creep.VARIANCE]
    # predicted minus measured position
    north, east = mem[at + Event.Z_N] - mem[r + NAV], mem[at + Event.Z_E] - mem[r + NAV + 1]
    forward_n, forward_e = mem[r + Creep.FORWARD], mem[r + Creep.FORWARD + 1]
    moved, sigma = lag * speed, lag * math.sqrt(spread)
    anywhere = OUTLIER_SHARE / (2.0 * math.pi * LOG_RANGE * (north * north + east * east + 4.0 * variance))
    stood = _density_if_stood(mem, r, north, east, variance, anywhere, elapsed)
    fits = offset.density(north + moved * forward_n, east + moved * forward_e, variance, sigma * forward_n,
                          sigma * forward_e)
    mem[creep] *= (stood / (fits + anywhere)) ** counts
    if fits < anywhere:
        return False
    gain = spread * lag / (variance / counts + sigma * sigma)
    mem[r + Creep.SPEED] -= gain * (north * forward_n + east * forward_e + moved)
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
    """Correct the state at r by the creep, and raise P, which is at p, of n states, by the uncertainty of its speed."""
    lag, speed, variance, first = mem[r + Creep.LAG], mem[r + Creep.SPEED], mem[r + Creep.VARIANCE], velocity_state(mem)
    for i in range(2):
        forward = mem[r + Creep.FORWARD + i]
        mem[r + NAV + i] -= lag * speed * forward
        mem[r + NAV + first + i] -= speed * forward
        for j in range(2):
            both = variance * forward * mem[r + Creep.FORWARD + j]
            mem[p + n * i + j] += lag * lag * both
            mem[p + n * i + first + j] += lag * both
            mem[p + n * (first + i) + j] += lag * both
            mem[p + n * (first + i) + first + j] += both
    mem[r + Standing.CONTRADICTED] = mem[r + Creep.TIME]  # the time of this fix, by `crept`
    mem[r + Creep.ODDS] = 0.0


@njit(_nrt=False)
def note_correction(mem, r, gain):
    """Note that a fix has corrected the position by `gain` times the innovation."""
    mem[r + Creep.LAG] *= 1.0 - gain
