"""Correction of a state by what is measured (Eq. 6 to 8, 19): fixes, and what is known of a land vehicle."""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..navigation import strapdown
from .layout import FIX_SIZE, HEAD_SIZE, NAV, SAMPLE_SIZE, Fix, Head, Nav, Sample, load_covariance, store_covariance
from .prediction import set_radii

#: standstill and non-holonomic constraints are applied this often, s: their errors are not white from sample to sample
CONSTRAINT_INTERVAL = 0.1
#: what the inertial sensors call a standstill is one only below this speed plus two sigma, and when the speed is known
STILL_SPEED = 0.3  # m/s
STILL_SIGMA = 0.5  # m/s


@njit
def _correct(full, n, row, h, z, variance, gain, column):
    """One scalar measurement z = h x + noise: Eq. 6 to 8 with the covariance in Joseph's form.

    full: P (n, n), updated. row: the state, whose x is updated. h, gain, column: vectors (n,), the last two scratch.
    """
    residual, s = z, variance
    for i in range(n):
        total = 0.0
        for j in range(n):
            if h[j] != 0.0:
                total += full[i, j] * h[j]
        column[i] = total
    for i in range(n):
        residual -= h[i] * row[NAV + i]
        s += h[i] * column[i]
    for i in range(n):
        gain[i] = column[i] / s
        row[NAV + i] += gain[i] * residual
    for i in range(n):  # (I - K H) P
        for j in range(n):
            full[i, j] -= gain[i] * column[j]
    for i in range(n):  # times H^T
        total = 0.0
        for j in range(n):
            if h[j] != 0.0:
                total += full[i, j] * h[j]
        column[i] = total
    for i in range(n):  # times (I - K H)^T, plus K R K^T
        for j in range(i, n):
            value = 0.5 * (full[i, j] - column[i] * gain[j] + full[j, i] - column[j] * gain[i])
            full[i, j] = full[j, i] = value + gain[i] * variance * gain[j]


@njit
def _feed_back(head, row, navigation):
    """Closed loop: the estimated navigation errors go into the solution, and x is zero there again."""
    if head[Head.OPEN_LOOP] != 0.0:
        return
    row[Nav.LATITUDE] -= row[NAV] * row[Nav.NORTH_SCALE]
    row[Nav.LONGITUDE] -= row[NAV + 1] * row[Nav.EAST_SCALE]
    if navigation == 5:
        row[Nav.V_N] -= row[NAV + 2]
        row[Nav.V_E] -= row[NAV + 3]
        row[Nav.YAW] -= row[NAV + 4]
    else:
        row[Nav.HEIGHT] += row[NAV + 2]
        row[Nav.V_N] -= row[NAV + 3]
        row[Nav.V_E] -= row[NAV + 4]
        row[Nav.V_D] -= row[NAV + 5]
        row[Nav.Q_W], row[Nav.Q_X], row[Nav.Q_Y], row[Nav.Q_Z] = strapdown.correct_attitude(
            (row[Nav.Q_W], row[Nav.Q_X], row[Nav.Q_Y], row[Nav.Q_Z]), row[NAV + 6], row[NAV + 7], row[NAV + 8])
    row[NAV:NAV + navigation] = 0.0


@njit
def body_to_level(row, navigation):
    """Rotation from b to n at `row` as nine numbers, row by row."""
    if navigation == 5:
        c, s = math.cos(row[Nav.YAW]), math.sin(row[Nav.YAW])
        return c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0
    return strapdown.matrix((row[Nav.Q_W], row[Nav.Q_X], row[Nav.Q_Y], row[Nav.Q_Z]))


@njit
def _state_and_scratch(memory, r, n):
    """The state at r, an (n, n) matrix and five vectors (5, n) to work with."""
    s = int(memory[Head.SCRATCH_AT])
    return (memory[r:r + int(memory[Head.WIDTH])], memory[s:s + n * n].reshape(n, n),
            memory[s + n * n:s + n * n + 5 * n].reshape(5, n))


@njit
def apply_fix(memory, r, at):
    """Correct the state at r with the fix at `at` (Eq. 19: predicted minus measured antenna position, in metres)."""
    head, fix = memory[:HEAD_SIZE], memory[at:at + FIX_SIZE]
    navigation, m = int(head[Head.NAVIGATION]), int(head[Head.OTHERS])
    n = navigation + m
    row, full, work = _state_and_scratch(memory, r, n)
    load_covariance(row, navigation, m, full)
    c = body_to_level(row, navigation)
    lx, ly, lz = head[Head.LEVER_X], head[Head.LEVER_Y], head[Head.LEVER_Z]
    arm_n = c[0] * lx + c[1] * ly + c[2] * lz
    arm_e = c[3] * lx + c[4] * ly + c[5] * lz
    arm_d = c[6] * lx + c[7] * ly + c[8] * lz
    h_n, h_e, h_d = work[0], work[1], work[2]
    work[:5] = 0.0
    h_n[0] = h_e[1] = 1.0
    if navigation == 5:  # an error of yaw swings the antenna
        h_n[4], h_e[4] = -arm_e, arm_n
    else:  # phi x arm
        h_n[7], h_n[8] = arm_d, -arm_e
        h_e[6], h_e[8] = -arm_d, arm_n
        h_d[2], h_d[6], h_d[7] = 1.0, arm_e, -arm_n
    coloured = int(head[Head.COLOURED])
    if coloured >= 0:
        h_n[coloured], h_e[coloured + 1] = -1.0, -1.0
    z_n = (row[Nav.LATITUDE] - fix[Fix.LATITUDE]) / row[Nav.NORTH_SCALE] + arm_n
    z_e = (row[Nav.LONGITUDE] - fix[Fix.LONGITUDE]) / row[Nav.EAST_SCALE] + arm_e
    z_d = fix[Fix.HEIGHT] - row[Nav.HEIGHT] + arm_d

    for k in range(3):
        fix[Fix.Z_N + k] = z_n if k == 0 else (z_e if k == 1 else z_d)
        for i in range(n):
            fix[Fix.Z_N + k] -= work[k, i] * row[NAV + i]
    fix[Fix.S_NN] = fix[Fix.R_NN] + _quadratic(full, n, h_n, h_n)
    fix[Fix.S_NE] = fix[Fix.R_NE] + _quadratic(full, n, h_n, h_e)
    fix[Fix.S_EE] = fix[Fix.R_EE] + _quadratic(full, n, h_e, h_e)
    fix[Fix.S_DD] = fix[Fix.R_DD] + _quadratic(full, n, h_d, h_d)
    a, b = fix[Fix.Z_N], fix[Fix.Z_E]
    determinant = fix[Fix.S_NN] * fix[Fix.S_EE] - fix[Fix.S_NE] ** 2
    fix[Fix.NIS] = (fix[Fix.S_EE] * a * a - 2.0 * fix[Fix.S_NE] * a * b + fix[Fix.S_NN] * b * b) / determinant
    fix[Fix.APPLIED] = 1.0
    fix[Fix.YAW] = math.atan2(c[3], c[0])
    fix[Fix.V_N] = row[Nav.V_N]
    fix[Fix.V_E] = row[Nav.V_E]

    # north and east made independent by the Cholesky factor of R, then one after the other
    inflation = 0.0
    if head[Head.ROBUST_SIGMA] > 0.0:  # so much noise that the innovation is just robust_sigma
        inflation = max(0.0, fix[Fix.NIS] / head[Head.ROBUST_SIGMA] ** 2 - 1.0)
    l_nn = math.sqrt(fix[Fix.R_NN] + inflation * fix[Fix.S_NN])
    l_en = (fix[Fix.R_NE] + inflation * fix[Fix.S_NE]) / l_nn
    l_ee = math.sqrt(fix[Fix.R_EE] + inflation * fix[Fix.S_EE] - l_en * l_en)
    for i in range(n):
        h_n[i] /= l_nn
        h_e[i] = (h_e[i] - l_en * h_n[i]) / l_ee
    z_n /= l_nn
    z_e = (z_e - l_en * z_n) / l_ee
    _correct(full, n, row, h_n, z_n, 1.0, work[3], work[4])
    _correct(full, n, row, h_e, z_e, 1.0, work[3], work[4])
    if navigation == 5:
        row[Nav.HEIGHT] = fix[Fix.HEIGHT] + arm_d
    else:
        _correct(full, n, row, h_d, z_d, fix[Fix.R_DD], work[3], work[4])
    store_covariance(full, navigation, m, row)
    _feed_back(head, row, navigation)
    set_radii(memory, r)


@njit
def _quadratic(full, n, left, right):
    total = 0.0
    for i in range(n):
        if left[i] != 0.0:
            for j in range(n):
                total += left[i] * full[i, j] * right[j]
    return total


@njit
def constrain(memory, r, at, dt):
    """What is known of a land vehicle: at standstill no velocity and no rotation, else no sideways velocity.

    r: position of the state, at: of the sample that led to it, dt: its interval.
    """
    head, sample = memory[:HEAD_SIZE], memory[at:at + SAMPLE_SIZE]
    still = sample[Sample.STILL] != 0.0 and head[Head.ZERO_VELOCITY_SIGMA] > 0.0
    if not still and head[Head.NON_HOLONOMIC_SIGMA] == 0.0:
        return
    navigation, m, p = int(head[Head.NAVIGATION]), int(head[Head.OTHERS]), int(head[Head.ORDER])
    n = navigation + m
    row, full, work = _state_and_scratch(memory, r, n)
    row[Nav.CONSTRAINT_TIME] = 0.0
    load_covariance(row, navigation, m, full)
    if still:  # a smooth road at speed must not pass for a standstill
        k = 2 if navigation == 5 else 3
        variance = full[k, k] + full[k + 1, k + 1]
        speed_squared = row[Nav.V_N] ** 2 + row[Nav.V_E] ** 2
        still = speed_squared < STILL_SPEED**2 + 4.0 * variance and variance < STILL_SIGMA**2
    h, gain, column = work[0], work[3], work[4]
    first_velocity, dimensions = (2, 2) if navigation == 5 else (3, 3)
    if still:
        for k in range(dimensions):
            h[:] = 0.0
            h[first_velocity + k] = 1.0
            _correct(full, n, row, h, row[Nav.V_N + k], head[Head.ZERO_VELOCITY_SIGMA] ** 2, gain, column)
        for k in range(1 if navigation == 5 else 3):
            axis = 2 if navigation == 5 else k
            h[:] = 0.0
            h[navigation + (2 * p if navigation == 5 else (3 + k) * p)] = 1.0
            # a sample at rest shows the gyroscope's error and its white noise
            _correct(full, n, row, h, sample[Sample.W_X + axis], memory[HEAD_SIZE + 3 + axis] / dt, gain, column)
    elif head[Head.NON_HOLONOMIC_SIGMA] > 0.0:
        c = body_to_level(row, navigation)
        v_n, v_e, v_d = row[Nav.V_N], row[Nav.V_E], row[Nav.V_D]
        for axis in range(1, dimensions):
            x, y, z = c[axis], c[3 + axis], c[6 + axis]
            h[:] = 0.0
            h[first_velocity], h[first_velocity + 1] = x, y
            if navigation == 5:
                h[4] = x * v_e - y * v_n
            else:
                h[5] = z
                h[6], h[7], h[8] = y * v_d - z * v_e, z * v_n - x * v_d, x * v_e - y * v_n
            sideways = x * v_n + y * v_e + z * v_d
            if axis == 1 and head[Head.SIDESLIP] != 0.0:  # what the tyres let it slip in a bend
                forward = c[0] * v_n + c[3] * v_e + c[6] * v_d
                sideways -= head[Head.SIDESLIP] * sample[Sample.F_Y] * forward
            _correct(full, n, row, h, sideways, head[Head.NON_HOLONOMIC_SIGMA] ** 2, gain, column)
    store_covariance(full, navigation, m, row)
    _feed_back(head, row, navigation)
