"""Constraints on the motion of a land vehicle: at a standstill it neither moves nor turns, in motion it moves neither
sideways nor upwards. Each is applied ten times a second, unless its innovations show that the vehicle violates it.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from .measurements import acceleration, non_holonomic, standstill
from .measurements.geometry import angular_rate, body_to_level
from .memory import (
    NAV,
    Error,
    Event,
    Head,
    Kind,
    Nav,
    Sample,
    channel_of,
    row_of,
    store_covariance,
    velocity_state,
    velocity_variance,
    yaw_state,
)
from .prediction import set_radii
from .trust import contradiction, creep, gyroscopes, hypotheses, imu_share, new_start, usual_speed
from .trust.force_noise import force_noise
from .trust.imu_share import DECIDED_VARIANCE, Share
from .trust.standstill import SURE_ODDS, Standing, moves, odds_of_standing, wheels_turn
from .trust.white_noise import Shown, hides_turns
from .update import ROBUST, begin_update, clear_rows, correct_by_scalar, end_update, product, project, update

#: s between two applications of the standstill or the non-holonomic constraint: about the correlation time of their
#: errors
CONSTRAINT_INTERVAL = 0.1
#: the non-holonomic constraint has noise of constant density, so where the IMU is slower than CONSTRAINT_INTERVAL each
#: application has a smaller variance. This is the largest divisor of the variance, reached at 5 Hz. Chosen, not
#: measured
LARGEST_DIVISOR = 2.0
#: rad/s: a standstill that the accelerometers show is accepted only if the turn rate is below this (plus three sigma,
#: added as squares). A robot that turns on the spot
#: about its IMU is at rest for the accelerometers; its turns take 40 s at the most, which is this rate. A smaller error
#: of a gyroscope is accepted as a standstill, so that it is corrected there
STILL_RATE = 0.15
#: s, time constant of the mean NIS of the non-holonomic constraint. Chosen, not measured
CONSTRAINT_MEMORY = 10.0
#: mean NIS above which the constraint is switched off; a vehicle that satisfies the constraint has 1
CONSTRAINT_OFF = 6.0
#: mean NIS below which it is switched on again, as hysteresis
CONSTRAINT_ON = 0.5 * CONSTRAINT_OFF
#: one NIS counts as no more than this (5 sigma) in that mean, so that a single slide does not switch the constraint off
LARGEST_NIS = 25.0


@njit(_nrt=False)
def constrain(mem, r, sample):
    """Apply to the state at r the standstill constraints (zero velocity and zero angular rate) or the non-holonomic
    one.

    sample: position of the IMU sample that led to the state.
    """
    still = (mem[sample + Sample.STILL] != 0.0 and mem[Head.ZERO_VELOCITY_SIGMA] > 0.0 and not wheels_turn(mem, r)
             and not creep.has_crept(mem, r))
    if not still and mem[Head.LATERAL_SIGMA] == 0.0:
        return
    before = hypotheses.position_and_velocity(mem, r)
    (n, h), p = begin_update(mem, r), int(mem[Head.SCRATCH_AT])
    at = h + 6 * n  # a temporary event in the scratch
    since, mem[r + Nav.CONSTRAINT_TIME] = mem[r + Nav.CONSTRAINT_TIME], 0.0
    gyroscopes.allow_for_end(mem, r, n, since)
    mem[r + Nav.USE_ALL_FIXES] = max(mem[r + Nav.USE_ALL_FIXES] - since, 0.0)
    yaw = yaw_state(mem)
    if still:
        speed, quiet = math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]), mem[sample + Sample.STILL]
        odds = odds_of_standing(speed, velocity_variance(mem, r), quiet)
        still = _is_believed(mem, r, sample, n, odds > SURE_ODDS)
    if still:
        creep.note_standstill(mem, r, p, n, since, quiet, odds)
        _hold_still(mem, r, at, n, h, sample)
    elif mem[Head.LATERAL_SIGMA] > 0.0 and not _fixes_tell_the_heading(mem, r, mem[p + (n + 1) * yaw]):
        c, shown = body_to_level(mem, r), mem[sample + Shown.SIDEWAYS]
        # with such noise or errors, how land vehicles accelerate is known better than the accelerometers measure it
        if (acceleration.error_variance(mem, r) > acceleration.SMALLEST_ERROR**2
                or hides_turns(mem, shown + force_noise(mem, r))):
            dimensions = acceleration.observe(mem, at, h, n, c, sample, since)
            update(mem, r, at, n, dimensions, 1.0, 1.0, ROBUST, 0.0, 0.0)
            clear_rows(mem, h, n)
        if not hides_turns(mem, shown):
            dimensions = non_holonomic.observe(mem, r, at, h, n, c, sample)
            _constrain_motion(mem, r, at, n, h, dimensions, since, mem[sample + Sample.FAULT] == 0.0)
            _note(mem, sample, at, Kind.NON_HOLONOMIC, dimensions)
        usual_speed.learn_certain_speed(mem, r)
        if usual_speed.bounds(mem, r):
            clear_rows(mem, h, n)
            standstill.observe_velocity(mem, r, at, h, n, 2, usual_speed.variance(mem, r, since))
            update(mem, r, at, n, 2, 1.0, 1.0, ROBUST, 0.0, 0.0)
    else:
        store_covariance(mem, p, int(mem[Head.N_NAVIGATION]), int(mem[Head.N_AUGMENTED]), mem, r)
        return
    end_update(mem, r)
    set_radii(mem, r)
    hypotheses.move_offset(mem, r, before)


@njit(_nrt=False)
def _is_believed(mem, r, sample, n, agrees):
    """Whether a standstill that the samples show is used. agrees: whether the estimated speed agrees with it; where it
    does not, P, which is in the scratch, is raised by the square of that speed."""
    # a slow motion contradicts a standstill (a smooth, straight creep), but not where a gyroscope shows a turn: then
    # the gyroscope is wrong, and has made the velocity wrong as well
    believed = ((agrees or not moves(mem, r) and _turns(mem, r, sample, n, 0.0, gyroscopes.JUMP_SIGMAS))
                and not _turns(mem, r, sample, n, STILL_RATE, ROBUST))
    if believed and not agrees:
        for i in range(2):
            mem[int(mem[Head.SCRATCH_AT]) + (n + 1) * (velocity_state(mem) + i)] += mem[r + Nav.V_N + i] ** 2
    return believed


@njit(_nrt=False)
def _hold_still(mem, r, at, n, h, sample):
    """Apply zero velocity and zero angular rate to the state at r."""
    mem[r + Standing.TIME] = mem[r + Nav.TIME]
    dimensions = 3 if row_of(mem, Error.V_D) >= 0 else 2
    standstill.observe_velocity(mem, r, at, h, n, dimensions, mem[Head.ZERO_VELOCITY_SIGMA] ** 2)
    update(mem, r, at, n, dimensions, 1.0, 1.0, 0.0, 0.0, 0.0)
    _note(mem, sample, at, Kind.ZERO_VELOCITY, dimensions)
    clear_rows(mem, h, n)
    dimensions = standstill.observe_rate(mem, at, h, n, sample)
    gyroscopes.allow_for_jump(mem, r, at, n, dimensions, sample)
    update(mem, r, at, n, dimensions, 1.0, 1.0, 0.0, 0.0, 0.0)


@njit(_nrt=False)
def decide_share(mem, r):
    """Of two IMUs that differ, take the one for right that the state at r shows to be."""
    value = imu_share.decided(mem, r)
    if value == 0.0:
        return
    n, h = begin_update(mem, r)
    mem[h + int(mem[Share.STATE])] = 1.0
    before = hypotheses.position_and_velocity(mem, r)
    s = DECIDED_VARIANCE + project(mem, n, h, h + 3 * n)
    correct_by_scalar(mem, r, n, h, h + 3 * n, value, s)
    end_update(mem, r)
    set_radii(mem, r)
    hypotheses.move_offset(mem, r, before)


@njit(_nrt=False)
def _variance_factor(since):
    """Factor on the variance of the non-holonomic constraint, `since` s after the previous one: noise of constant
    density."""
    return max(CONSTRAINT_INTERVAL / since, 1.0 / LARGEST_DIVISOR)


@njit(_nrt=False)
def _fixes_tell_the_heading(mem, r, variance):
    """Whether the constraint is left out because the heading is too uncertain for it and fixes will find the heading.

    The constraint is linearised in the heading error. Without fixes it is applied all the same, as nothing else bounds
    the drift. variance: of the heading, rad^2.
    """
    since = mem[r + Nav.TIME] - mem[r + Nav.FIX_TIME]
    return variance > new_start.LARGEST_YAW_SIGMA**2 and since < new_start.LONGEST_PAIR


@njit(_nrt=False)
def _turns(mem, r, sample, n, rate, sigmas):
    """Whether the sample shows an angular rate above `rate`, rad/s, and `sigmas` standard deviations (added as
    squares). P is in the scratch."""
    w_x, w_y, w_z = angular_rate(mem, r, sample)
    p, variance = int(mem[Head.SCRATCH_AT]), mem[sample + Sample.RATE_SCATTER]
    for axis in range(3, 6):
        state = channel_of(mem, axis)
        if state >= 0:
            variance += mem[p + (n + 1) * state]
    return w_x * w_x + w_y * w_y + w_z * w_z > rate * rate + sigmas * sigmas * variance


@njit(_nrt=False, forceinline=True)
def _constrain_motion(mem, r, at, n, h, dimensions, since, measured):
    """Apply the components of the non-holonomic constraint one after the other, unless the vehicle violates them.

    since: s since the previous application. measured: whether the IMU sample is valid; the turn rate of one that is
    bridged is assumed, and shows no slide. A component is tested with the variance of its event, at any rate of the
    IMU, and applied with the variance for its interval (`_variance_factor`). The variance of what it measures does not
    become smaller than the second-order term that the linearisation omits. That term is the same at each application
    while the errors are: as noise it would be averaged, and the filter would take the difference of successive
    applications, which comes from its own corrections of the speed, for knowledge of speed and direction.
    """
    for k in range(dimensions):
        z, variance = mem[at + Event.Z_N + k], mem[at + (Event.R_NN if k == 0 else Event.R_EE)]
        column = h + (3 + k) * n
        innovation = z - product(mem, n, h + n * k, r + NAV)
        omitted, prior = mem[at + non_holonomic.SECOND_ORDER[k]], project(mem, n, h + n * k, column)
        s = prior + variance + omitted
        # without a gate every fix is used anyway, so a slide need not decide between the fixes and the IMU
        if k == 0 and measured and mem[Head.GATE] > 0.0 and contradiction.slides(mem, r, innovation, s, since):
            contradiction.raise_uncertainty(mem, r, n, innovation, since)
            prior = project(mem, n, h + n * k, column)
            s = prior + variance + omitted
        nis = innovation * innovation / s
        mem[at + Event.Z_N + k] = innovation
        mem[at + (Event.S_NN if k == 0 else Event.S_EE)] = s
        running = Nav.LATERAL_NIS if k == 0 else Nav.VERTICAL_NIS
        before = mem[r + running]
        off = before < 0.0  # a negative mean marks a component that is switched off
        mean = abs(before) + (min(nis, LARGEST_NIS) - abs(before)) * min(since / CONSTRAINT_MEMORY, 1.0)
        off = mean > (CONSTRAINT_ON if off else CONSTRAINT_OFF)
        mem[r + running] = -mean if off else mean
        if off:
            mem[r + Nav.SIDEWAYS] += since if k == 0 else 0.0
            continue
        if prior <= omitted:
            continue
        # R is raised until the normalized innovation, with `omitted` in its variance, is ROBUST
        noise = max(nis / ROBUST**2, 1.0) * s - prior - omitted - (1.0 - _variance_factor(since)) * variance
        noise = max(noise, prior * omitted / (prior - omitted))
        correct_by_scalar(mem, r, n, h + n * k, column, z, prior + noise)


@njit(_nrt=False)
def _note(mem, sample, at, kind, dimensions):
    """Write kind, innovation and its variances of a constraint to the IMU sample at which it was applied."""
    mem[sample + Sample.CONSTRAINT] = kind
    for k in range(dimensions):
        mem[sample + Sample.Z + k] = mem[at + Event.Z_N + k]
    mem[sample + Sample.S] = mem[at + Event.S_NN]
    mem[sample + Sample.S + 1] = mem[at + Event.S_EE]
    mem[sample + Sample.S + 2] = mem[at + Event.S_DD]
