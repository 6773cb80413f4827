"""What is known of a land vehicle without measuring it: at a standstill it neither moves nor turns, else it does not go
sideways or upwards. Applied ten times a second, each unless the vehicle is seen not to keep to it.
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from .measurements import acceleration, non_holonomic, standstill
from .measurements.geometry import angular_rate, body_to_level
from .memory import (
    NAV,
    Event,
    Head,
    Kind,
    Nav,
    Sample,
    channel_of,
    store_covariance,
    velocity_state,
    velocity_variance,
    yaw_state,
)
from .prediction import set_radii
from .trust import contradiction, gyroscopes, new_start
from .trust.force_noise import force_noise
from .trust.imu_faults import Imu
from .trust.standstill import wheels_turn
from .trust.white_noise import Shown, hides_turns
from .update import ROBUST, begin_update, clear_rows, correct_by_scalar, end_update, product, project, update

#: standstill and non-holonomic constraints are applied this often, s: their errors last about as long
CONSTRAINT_INTERVAL = 0.1
#: where samples are no more often than that, each non-holonomic one has a smaller variance, so that a second tells as
#: much; but none tells more than this many
MOST_TOLD = 2.0
#: m/s: what the accelerometers call a standstill is one only below this speed plus three sigma: smooth roads, a creep
#: in traffic
STILL_SPEED = 0.3
#: rad/s: and only below this turn rate plus three sigma: a robot that turns on the spot about its IMU stands still by
#: the accelerometers, and takes 40 s for a turn at the most; a gyroscope that is off by less does not turn a parked car
STILL_RATE = 0.15
#: s over which the constraint's NIS is averaged
CONSTRAINT_MEMORY = 10.0
#: mean NIS above which the constraint is not used: it is 1 of a vehicle that keeps to it
CONSTRAINT_OFF = 6.0
#: and below which it is used again: half, so that it does not come and go
CONSTRAINT_ON = 3.0


@njit(_nrt=False)
def constrain(mem, r, sample):
    """What is known of a land vehicle: at standstill no velocity and no rotation, else no sideways velocity.

    r: position of the state, sample: of the sample that led to it.
    """
    still = mem[sample + Sample.STILL] != 0.0 and mem[Head.ZERO_VELOCITY_SIGMA] > 0.0 and not wheels_turn(mem, r)
    if not still and mem[Head.LATERAL_SIGMA] == 0.0:
        return
    (n, h), p = begin_update(mem, r), int(mem[Head.SCRATCH_AT])
    at = h + 6 * n  # a record for the time being
    since, mem[r + Nav.CONSTRAINT_TIME] = mem[r + Nav.CONSTRAINT_TIME], 0.0
    gyroscopes.allow_for_end(mem, r, n, since)
    yaw = yaw_state(mem)
    if still:
        squared = mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2
        agrees = squared < STILL_SPEED**2 + 9.0 * velocity_variance(mem, r)
        # a vehicle that creeps smoothly and straight on does not turn; where a gyroscope turns, its error has made the
        # velocity wrong, too, which then does not deny the standstill
        still = ((agrees or _turns(mem, r, sample, n, 0.0, gyroscopes.NEW_ERROR))
                 and not _turns(mem, r, sample, n, STILL_RATE, ROBUST))
        if still and not agrees:
            for i in range(2):
                mem[p + (n + 1) * (velocity_state(mem) + i)] += mem[r + Nav.V_N + i] ** 2
    if still:
        dimensions = standstill.observe_velocity(mem, r, at, h, n)
        update(mem, r, at, n, dimensions, 1.0, 0.0, 0.0)
        _note(mem, sample, at, Kind.ZERO_VELOCITY, dimensions)
        clear_rows(mem, h, n)
        dimensions = standstill.observe_rate(mem, at, h, n, sample)
        gyroscopes.free(mem, r, at, n, dimensions, sample)
        update(mem, r, at, n, dimensions, 1.0, 0.0, 0.0)
    elif mem[Head.LATERAL_SIGMA] > 0.0 and not _fixes_tell_the_heading(mem, r, mem[p + (n + 1) * yaw]):
        c, shown = body_to_level(mem, r), mem[sample + Shown.SIDEWAYS]
        if hides_turns(mem, shown + force_noise(mem, r)):  # then how vehicles move tells more of the acceleration
            dimensions = acceleration.observe(mem, at, h, n, c, sample, since)
            update(mem, r, at, n, dimensions, 1.0, ROBUST, 0.0)
            clear_rows(mem, h, n)
        if not hides_turns(mem, shown):
            dimensions = non_holonomic.observe(mem, r, at, h, n, c, sample)
            _constrain_motion(mem, r, at, n, h, dimensions, since)
            _note(mem, sample, at, Kind.NON_HOLONOMIC, dimensions)
    else:
        store_covariance(mem, p, int(mem[Head.N_NAVIGATION]), int(mem[Head.N_AUGMENTED]), mem, r)
        return
    end_update(mem, r)
    set_radii(mem, r)


@njit(_nrt=False)
def _share(since):
    """Factor on the variance of the non-holonomic constraint `since` s after the last: its errors are a density."""
    return max(CONSTRAINT_INTERVAL / since, 1.0 / MOST_TOLD)


@njit(_nrt=False)
def _fixes_tell_the_heading(mem, r, variance):
    """Whether the heading is too uncertain for the constraint, which is linear in its error, and fixes will find it.

    Without them the constraint is all there is against drifting away.
    """
    since = mem[r + Nav.TIME] - mem[r + Nav.FIX_TIME]
    return variance > new_start.LARGEST_YAW_SIGMA**2 and since < new_start.LONGEST_PAIR


@njit(_nrt=False)
def _turns(mem, r, sample, n, rate, sigmas):
    """Whether the gyroscopes turn by more than `rate`, rad/s, and so many sigmas at the sample; P is in the scratch."""
    w_x, w_y, w_z = angular_rate(mem, r, sample)
    p, variance = int(mem[Head.SCRATCH_AT]), mem[Imu.SPREAD + 1]
    for axis in range(3, 6):
        state = channel_of(mem, axis)
        if state >= 0:
            variance += mem[p + (n + 1) * state]
    return w_x * w_x + w_y * w_y + w_z * w_z > rate * rate + sigmas * sigmas * variance


@njit(_nrt=False)
def _constrain_motion(mem, r, at, n, h, dimensions, since):
    """The components of the non-holonomic constraint one by one, each unless the vehicle does not keep to it.

    since: s from the one before. Each is judged by the variance as it is, so
    that a slow IMU's is judged as a fast one's, and used with that for its interval.
    """
    for k in range(dimensions):
        z, variance = mem[at + Event.Z_N + k], mem[at + (Event.R_NN if k == 0 else Event.R_EE)]
        column = h + (3 + k) * n
        innovation = z - product(mem, n, h + n * k, r + NAV)
        s = variance + project(mem, n, h + n * k, column)
        nis = innovation * innovation / s
        # where each fix is believed in any case there is nothing to decide
        if k == 0 and mem[Head.GATE] > 0.0 and contradiction.slides(mem, r, innovation, s, since):
            contradiction.unsettle(mem, r, n, innovation, since)
            s = variance + project(mem, n, h + n * k, column)
            nis = innovation * innovation / s
        mem[at + Event.Z_N + k] = innovation
        mem[at + (Event.S_NN if k == 0 else Event.S_EE)] = s
        running = Nav.LATERAL_NIS if k == 0 else Nav.VERTICAL_NIS
        before = mem[r + running]
        off = before < 0.0  # the sign tells that it is off
        mean = abs(before) + (min(nis, 25.0) - abs(before)) * min(since / CONSTRAINT_MEMORY, 1.0)
        off = mean > (CONSTRAINT_ON if off else CONSTRAINT_OFF)
        mem[r + running] = -mean if off else mean
        if off:
            mem[r + Nav.SIDEWAYS] += since if k == 0 else 0.0
            continue
        if nis > ROBUST**2:
            s *= nis / ROBUST**2  # as if the noise were larger by as much
        correct_by_scalar(mem, r, n, h + n * k, column, z, s - (1.0 - _share(since)) * variance)


@njit(_nrt=False)
def _note(mem, sample, at, kind, dimensions):
    """What a constraint said, beside the sample it was applied at."""
    mem[sample + Sample.CONSTRAINT] = kind
    for k in range(dimensions):
        mem[sample + Sample.Z + k] = mem[at + Event.Z_N + k]
    mem[sample + Sample.S] = mem[at + Event.S_NN]
    mem[sample + Sample.S + 1] = mem[at + Event.S_EE]
    mem[sample + Sample.S + 2] = mem[at + Event.S_DD]
