"""The compiled filter: one error-state Kalman filter for the live node and for the replay of whole recordings.

All of it lives in one flat array of floats (`Memory` in memory.py lays it out): a head with sizes and settings, the
noise of each state, a ring of the latest states (rows, see layout.py), a ring of the IMU samples between them, and the
fixes of the same time. Because the ring remembers, a fix that comes late is applied at its own time: back to the state
before it and forward again.

Error state, INS minus truth (DESIGN section 3): prediction Eq. 4 and 5 for each IMU sample, correction Eq. 6 to 8 for
each fix, in blocks: P_nn navigation, P_ns cross, P_ss sensor errors; Phi = [[F, B], [0, A]] with A diagonal for random
walk and Gauss-Markov, a companion matrix per channel that steps once per T_s for AR(p).
"""
from __future__ import annotations

import math

import numpy as np
from numba import njit

from ..navigation import planar, strapdown
from ..navigation.earth import gravity, radii
from .layout import (FIX_SIZE, HEAD_SIZE, NAV, PLANAR, SAMPLE_SIZE, Fix, Head, Nav, Sample, load_covariance, packed,
                     store_covariance)

#: what a land vehicle may do unseen while the IMU is silent (one sigma): the covariance of a bridged gap
GAP_ACCELERATION = 1.5  # m/s^2
GAP_TURN_RATE = 0.3  # rad/s
#: standstill and non-holonomic constraints are applied this often, s: their errors are not white from sample to sample
CONSTRAINT_INTERVAL = 0.1
#: what the inertial sensors call a standstill is one only below this speed plus two sigma, and when the speed is known
STILL_SPEED = 0.3  # m/s
STILL_SIGMA = 0.5  # m/s
#: time constant of the running means that tell a standstill, s
STILL_TIME = 0.5
#: what the answers of `take_fix` mean
FIX_TAKEN, FIX_BEFORE_START, FIX_TOO_LATE = 0, 1, 2
#: the radii are computed anew after this much latitude, rad (13 m): the scale is then good to 2e-6
RADII_STEP = 2e-6


@njit(cache=True)
def _decay(x):
    """exp(-x), x >= 0: by its series, to rounding, where x is small - it always is at IMU rate."""
    if x < 0.01:
        return 1.0 - x * (1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0))))
    return math.exp(-x)


@njit(cache=True)
def set_radii(rows, r):
    """Latitude and longitude per metre at the position of row r."""
    north, east = radii(rows[r, Nav.LATITUDE])
    height = rows[r, Nav.HEIGHT]
    rows[r, Nav.RADII_LATITUDE] = rows[r, Nav.LATITUDE]
    rows[r, Nav.NORTH_SCALE] = 1.0 / (north + height)
    rows[r, Nav.EAST_SCALE] = 1.0 / ((east + height) * math.cos(rows[r, Nav.LATITUDE]))


@njit(cache=True)
def _move(rows, src, dst, north, east):
    """Position of row dst: that of src moved by a displacement in m."""
    rows[dst, Nav.LATITUDE] = rows[src, Nav.LATITUDE] + north * rows[src, Nav.NORTH_SCALE]
    rows[dst, Nav.LONGITUDE] = rows[src, Nav.LONGITUDE] + east * rows[src, Nav.EAST_SCALE]
    rows[dst, Nav.RADII_LATITUDE] = rows[src, Nav.RADII_LATITUDE]
    rows[dst, Nav.NORTH_SCALE] = rows[src, Nav.NORTH_SCALE]
    rows[dst, Nav.EAST_SCALE] = rows[src, Nav.EAST_SCALE]
    if abs(rows[dst, Nav.LATITUDE] - rows[dst, Nav.RADII_LATITUDE]) > RADII_STEP:
        set_radii(rows, dst)


@njit(cache=True)
def _step_planar(head, noise, rows, src, dst, sample, dt):
    """Row dst = row src, predicted over dt with the planar mechanization."""
    m = int(head[Head.OTHERS])
    p = int(head[Head.ORDER])
    jx, jy, jw = 0, p, 2 * p  # the sensor states that are the errors of f_x, f_y, w_z
    x = NAV + 5
    f_x, f_y, w_z = sample[Sample.F_X], sample[Sample.F_Y], sample[Sample.W_Z]
    closed = head[Head.OPEN_LOOP] == 0.0
    if closed:
        f_x -= rows[src, x + jx]
        f_y -= rows[src, x + jy]
        w_z -= rows[src, x + jw]
    yaw = rows[src, Nav.YAW]
    f_n, f_e, c, s = planar.rotate(yaw, dt, f_x, f_y, w_z)
    north, east, v_n, v_e, yaw = planar.mechanize(rows[src, Nav.V_N], rows[src, Nav.V_E], yaw, f_x, f_y, w_z, dt)
    rows[dst, Nav.HEIGHT] = rows[src, Nav.HEIGHT]
    _move(rows, src, dst, north, east)
    rows[dst, Nav.V_N] = v_n
    rows[dst, Nav.V_E] = v_e
    rows[dst, Nav.V_D] = 0.0
    rows[dst, Nav.YAW] = yaw
    rows[dst, Nav.Q_X] = rows[dst, Nav.Q_Y] = rows[dst, Nav.Q_Z] = 0.0

    if closed:
        for i in range(NAV, x):
            rows[dst, i] = 0.0
    else:
        (rows[dst, NAV], rows[dst, NAV + 1], rows[dst, NAV + 2], rows[dst, NAV + 3],
         rows[dst, NAV + 4]) = planar.error_step(
            dt, f_n, f_e, c, s, rows[src, NAV], rows[src, NAV + 1], rows[src, NAV + 2], rows[src, NAV + 3],
            rows[src, NAV + 4], rows[src, x + jx], rows[src, x + jy], rows[src, x + jw])

    # Phi P, column by column. The blocks of P in a row: navigation at a, cross at b, sensor at e.
    a = x + m
    b = a + 15
    e = b + 5 * m
    bx, by, bw = b + 5 * jx, b + 5 * jy, b + 5 * jw
    r = rows[src]
    g00, g10, g20, g30, g40 = planar.error_step(dt, f_n, f_e, c, s, r[a], r[a + 1], r[a + 2], r[a + 3], r[a + 4],
                                                r[bx], r[by], r[bw])
    g01, g11, g21, g31, g41 = planar.error_step(dt, f_n, f_e, c, s, r[a + 1], r[a + 5], r[a + 6], r[a + 7], r[a + 8],
                                                r[bx + 1], r[by + 1], r[bw + 1])
    g02, g12, g22, g32, g42 = planar.error_step(dt, f_n, f_e, c, s, r[a + 2], r[a + 6], r[a + 9], r[a + 10], r[a + 11],
                                                r[bx + 2], r[by + 2], r[bw + 2])
    g03, g13, g23, g33, g43 = planar.error_step(dt, f_n, f_e, c, s, r[a + 3], r[a + 7], r[a + 10], r[a + 12],
                                                r[a + 13], r[bx + 3], r[by + 3], r[bw + 3])
    g04, g14, g24, g34, g44 = planar.error_step(dt, f_n, f_e, c, s, r[a + 4], r[a + 8], r[a + 11], r[a + 13],
                                                r[a + 14], r[bx + 4], r[by + 4], r[bw + 4])
    q = rows[dst]
    for j in range(m):
        k = b + 5 * j
        q[k], q[k + 1], q[k + 2], q[k + 3], q[k + 4] = planar.error_step(
            dt, f_n, f_e, c, s, r[k], r[k + 1], r[k + 2], r[k + 3], r[k + 4],
            r[e + m * jx + j], r[e + m * jy + j], r[e + m * jw + j])

    # (Phi P) Phi^T, row by row; the sensors' white noise enters like an error that lasts one interval
    gap = dt > head[Head.MAX_GAP]
    nx, ny, nw = noise[0] / dt, noise[1] / dt, noise[5] / dt
    h = 0.5 * dt
    q[a], q[a + 1], q[a + 2], q[a + 3], q[a + 4] = planar.error_step(
        dt, f_n, f_e, c, s, g00, g01, g02, g03, g04, q[bx] + nx * dt * h * c, q[by] - ny * dt * h * s,
        q[bw] - nw * dt * h * h * f_e)
    _, q[a + 5], q[a + 6], q[a + 7], q[a + 8] = planar.error_step(
        dt, f_n, f_e, c, s, g10, g11, g12, g13, g14, q[bx + 1] + nx * dt * h * s, q[by + 1] + ny * dt * h * c,
        q[bw + 1] + nw * dt * h * h * f_n)
    _, _, q[a + 9], q[a + 10], q[a + 11] = planar.error_step(
        dt, f_n, f_e, c, s, g20, g21, g22, g23, g24, q[bx + 2] + nx * dt * c, q[by + 2] - ny * dt * s,
        q[bw + 2] - nw * dt * h * f_e)
    _, _, _, q[a + 12], q[a + 13] = planar.error_step(
        dt, f_n, f_e, c, s, g30, g31, g32, g33, g34, q[bx + 3] + nx * dt * s, q[by + 3] + ny * dt * c,
        q[bw + 3] + nw * dt * h * f_n)
    _, _, _, _, q[a + 14] = planar.error_step(
        dt, f_n, f_e, c, s, g40, g41, g42, g43, g44, q[bx + 4], q[by + 4], q[bw + 4] + nw * dt)
    if gap:
        position, velocity, turn = _gap_variance(dt)
        q[a] += position
        q[a + 5] += position
        q[a + 9] += velocity
        q[a + 12] += velocity
        q[a + 14] += turn

    _sensor_states(head, noise, rows, src, dst, x, b, e, 5, dt)


@njit(cache=True)
def _gap_variance(dt):
    """Variance of position, velocity and heading that a gap of dt adds."""
    velocity = (GAP_ACCELERATION * dt) ** 2
    return 0.25 * velocity * dt * dt, velocity, (GAP_TURN_RATE * dt) ** 2


@njit(cache=True)
def _sensor_states(head, noise, rows, src, dst, x, b, e, size, dt):
    """Predict the sensor error states: x, their covariance, and the decay of the cross block already in row dst."""
    m = int(head[Head.OTHERS])
    decay_at, walk_at, sigma_at = 6, 6 + m, 6 + 2 * m
    for j in range(m):
        decay = _decay(dt * noise[decay_at + j])
        rows[dst, x + j] = decay * rows[src, x + j]
        if decay != 1.0:
            for i in range(b + size * j, b + size * (j + 1)):
                rows[dst, i] *= decay
        for i in range(j):
            # the decay of i first, then that of j: the same product in both triangles
            both = _decay(dt * noise[decay_at + i]) * decay * rows[src, e + m * i + j]
            rows[dst, e + m * i + j] = both
            rows[dst, e + m * j + i] = both
        k = e + (m + 1) * j
        rows[dst, k] = (decay * decay * rows[src, k] + noise[walk_at + j] * dt
                        + noise[sigma_at + j] * (1.0 - decay * decay))
    rows[dst, Nav.ACCELEROMETER_PHASE] = rows[src, Nav.ACCELEROMETER_PHASE]
    rows[dst, Nav.GYROSCOPE_PHASE] = rows[src, Nav.GYROSCOPE_PHASE]
    if head[Head.ACCELEROMETER_INTERVAL] > 0.0:
        accelerometers = 2 if head[Head.MECHANIZATION] == PLANAR else 3
        _autoregressive(head, noise, rows, dst, x, b, e, size, dt, Nav.ACCELEROMETER_PHASE,
                        head[Head.ACCELEROMETER_INTERVAL], 0, accelerometers)
        _autoregressive(head, noise, rows, dst, x, b, e, size, dt, Nav.GYROSCOPE_PHASE,
                        head[Head.GYROSCOPE_INTERVAL], accelerometers, int(head[Head.CHANNELS]))


@njit(cache=True)
def _autoregressive(head, noise, rows, dst, x, b, e, size, dt, phase, interval, first, last):
    """Step the companion blocks of channels first to last once for each T_s that has passed (Eq. 22)."""
    rows[dst, phase] += dt
    while rows[dst, phase] > interval * (1.0 - 1e-6):
        rows[dst, phase] -= interval
        m = int(head[Head.OTHERS])
        p = int(head[Head.ORDER])
        a_at = 6 + 3 * m
        b_at = a_at + p * int(head[Head.CHANNELS])
        for channel in range(first, last):
            start, a = channel * p, a_at + channel * p
            _companion(rows, dst, x + start, 1, p, noise, a)
            for i in range(size):
                _companion(rows, dst, b + size * start + i, size, p, noise, a)
            for j in range(m):
                _companion(rows, dst, e + m * start + j, m, p, noise, a)
            for i in range(m):
                _companion(rows, dst, e + m * i + start, 1, p, noise, a)
            rows[dst, e + (m + 1) * start] += noise[b_at + channel]


@njit(cache=True)
def _companion(rows, row, at, stride, p, noise, a):
    """y = -a_1 v_1 - ... - a_p v_p in front, the rest moves back: p elements of a row, `stride` apart."""
    y = 0.0
    for k in range(p - 1, -1, -1):
        y -= noise[a + k] * rows[row, at + k * stride]
        if k > 0:
            rows[row, at + k * stride] = rows[row, at + (k - 1) * stride]
    rows[row, at] = y


@njit(cache=True)
def _step_strapdown(head, noise, rows, src, dst, sample, dt, full, product):
    """Row dst = row src, predicted over dt with the strapdown mechanization."""
    m = int(head[Head.OTHERS])
    p = int(head[Head.ORDER])
    x = NAV + 9
    closed = head[Head.OPEN_LOOP] == 0.0
    r, q = rows[src], rows[dst]
    f = (sample[Sample.F_X], sample[Sample.F_Y], sample[Sample.F_Z])
    w = (sample[Sample.W_X], sample[Sample.W_Y], sample[Sample.W_Z])
    if closed:
        f = (f[0] - r[x], f[1] - r[x + p], f[2] - r[x + 2 * p])
        w = (w[0] - r[x + 3 * p], w[1] - r[x + 4 * p], w[2] - r[x + 5 * p])
    rates = strapdown.frame_rates(r[Nav.LATITUDE], r[Nav.V_N], r[Nav.V_E], 1.0 / r[Nav.NORTH_SCALE],
                                  math.cos(r[Nav.LATITUDE]) / r[Nav.EAST_SCALE])
    attitude, c, f_level, moved, velocity = strapdown.mechanize(
        (r[Nav.Q_W], r[Nav.Q_X], r[Nav.Q_Y], r[Nav.Q_Z]), r[Nav.V_N], r[Nav.V_E], r[Nav.V_D], f, w, dt,
        gravity(r[Nav.LATITUDE], r[Nav.HEIGHT]), rates)
    q[Nav.HEIGHT] = r[Nav.HEIGHT] - moved[2]
    _move(rows, src, dst, moved[0], moved[1])
    q[Nav.V_N], q[Nav.V_E], q[Nav.V_D] = velocity
    q[Nav.Q_W], q[Nav.Q_X], q[Nav.Q_Y], q[Nav.Q_Z] = attitude

    if closed:
        q[NAV:x] = 0.0
    else:
        (q[NAV], q[NAV + 1], q[NAV + 2], q[NAV + 3], q[NAV + 4], q[NAV + 5], q[NAV + 6], q[NAV + 7],
         q[NAV + 8]) = strapdown.error_step(
            dt, c, f_level, (r[NAV], r[NAV + 1], r[NAV + 2]), (r[NAV + 3], r[NAV + 4], r[NAV + 5]),
            (r[NAV + 6], r[NAV + 7], r[NAV + 8]), (r[x], r[x + p], r[x + 2 * p]),
            (r[x + 3 * p], r[x + 4 * p], r[x + 5 * p]))

    # the blocks of P in a row: navigation at a, cross at b, sensor at e
    a = x + m
    b = a + 45
    e = b + 9 * m
    at = a
    for i in range(9):
        for j in range(i, 9):
            full[i, j] = full[j, i] = r[at]
            at += 1
    for j in range(9):  # Phi P, column by column
        k = b + j
        (product[0, j], product[1, j], product[2, j], product[3, j], product[4, j], product[5, j], product[6, j],
         product[7, j], product[8, j]) = strapdown.error_step(
            dt, c, f_level, (full[j, 0], full[j, 1], full[j, 2]), (full[j, 3], full[j, 4], full[j, 5]),
            (full[j, 6], full[j, 7], full[j, 8]), (r[k], r[k + 9 * p], r[k + 18 * p]),
            (r[k + 27 * p], r[k + 36 * p], r[k + 45 * p]))
    for j in range(m):
        k, s, row = b + 9 * j, e + j, m * p
        (q[k], q[k + 1], q[k + 2], q[k + 3], q[k + 4], q[k + 5], q[k + 6], q[k + 7],
         q[k + 8]) = strapdown.error_step(
            dt, c, f_level, (r[k], r[k + 1], r[k + 2]), (r[k + 3], r[k + 4], r[k + 5]),
            (r[k + 6], r[k + 7], r[k + 8]), (r[s], r[s + row], r[s + 2 * row]),
            (r[s + 3 * row], r[s + 4 * row], r[s + 5 * row]))
    # (Phi P) Phi^T, row by row, with the white noise of the sensors: B diag(density / dt) B^T
    h = 0.5 * dt
    at = a
    for i in range(9):
        white = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        n = i % 3
        for axis in range(3):
            if i < 6:
                lever = dt * h if i < 3 else dt
                # f in n turns with the attitude noise: (C dw) x f, component n
                turned = _cross_component(n, c[axis], c[3 + axis], c[6 + axis], f_level)
                white[axis] = lever * c[3 * n + axis] * noise[axis] / dt
                white[3 + axis] = lever * h * turned * noise[3 + axis] / dt
            else:
                white[3 + axis] = dt * c[3 * n + axis] * noise[3 + axis] / dt
        k = b + i
        out = strapdown.error_step(
            dt, c, f_level, (product[i, 0], product[i, 1], product[i, 2]), (product[i, 3], product[i, 4], product[i, 5]),
            (product[i, 6], product[i, 7], product[i, 8]),
            (q[k] + white[0], q[k + 9 * p] + white[1], q[k + 18 * p] + white[2]),
            (q[k + 27 * p] + white[3], q[k + 36 * p] + white[4], q[k + 45 * p] + white[5]))
        for j in range(i, 9):
            q[at] = out[j]
            at += 1
    if dt > head[Head.MAX_GAP]:
        position, velocity_variance, turn = _gap_variance(dt)
        for i in range(3):
            q[a + packed(i, i, 9)] += position
            q[a + packed(3 + i, 3 + i, 9)] += velocity_variance
            q[a + packed(6 + i, 6 + i, 9)] += turn if i == 2 else 0.1 * turn

    _sensor_states(head, noise, rows, src, dst, x, b, e, 9, dt)


@njit(cache=True)
def _cross_component(n, x, y, z, f):
    """Component n of (x, y, z) x f."""
    if n == 0:
        return y * f[2] - z * f[1]
    if n == 1:
        return z * f[0] - x * f[2]
    return x * f[1] - y * f[0]


@njit(cache=True)
def _predict(head, noise, rows, src, dst, sample, time, full, product):
    """Row dst = row src, predicted to `time` with one IMU sample."""
    dt = time - rows[src, Nav.TIME]
    if head[Head.MECHANIZATION] == PLANAR:
        _step_planar(head, noise, rows, src, dst, sample, dt)
    else:
        _step_strapdown(head, noise, rows, src, dst, sample, dt, full, product)
    rows[dst, Nav.TIME] = time
    rows[dst, Nav.CONSTRAINT_TIME] = rows[src, Nav.CONSTRAINT_TIME] + dt


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def body_to_level(row, navigation):
    """Rotation from b to n at `row` as nine numbers, row by row."""
    if navigation == 5:
        c, s = math.cos(row[Nav.YAW]), math.sin(row[Nav.YAW])
        return c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0
    return strapdown.matrix((row[Nav.Q_W], row[Nav.Q_X], row[Nav.Q_Y], row[Nav.Q_Z]))


@njit(cache=True)
def _apply_fix(head, rows, r, fix, full, work):
    """Correct row r with a fix (Eq. 19: predicted minus measured position, here of the antenna and in metres)."""
    navigation, m = int(head[Head.NAVIGATION]), int(head[Head.OTHERS])
    n = navigation + m
    row = rows[r]
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
    set_radii(rows, r)


@njit(cache=True)
def _quadratic(full, n, left, right):
    total = 0.0
    for i in range(n):
        if left[i] != 0.0:
            for j in range(n):
                total += left[i] * full[i, j] * right[j]
    return total


@njit(cache=True)
def _constrain(head, noise, rows, r, sample, dt, full, work):
    """What is known of a land vehicle: at standstill no velocity and no rotation, else no sideways velocity."""
    row = rows[r]
    still = sample[Sample.STILL] != 0.0 and head[Head.ZERO_VELOCITY_SIGMA] > 0.0
    if not still and head[Head.NON_HOLONOMIC_SIGMA] == 0.0:
        return
    row[Nav.CONSTRAINT_TIME] = 0.0
    navigation, m, p = int(head[Head.NAVIGATION]), int(head[Head.OTHERS]), int(head[Head.ORDER])
    n = navigation + m
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
            _correct(full, n, row, h, sample[Sample.W_X + axis], noise[3 + axis] / dt, gain, column)
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
            _correct(full, n, row, h, x * v_n + y * v_e + z * v_d, head[Head.NON_HOLONOMIC_SIGMA] ** 2, gain, column)
    store_covariance(full, navigation, m, row)
    _feed_back(head, row, navigation)


@njit(cache=True)
def views(memory):
    """The parts of the flat memory as arrays: head, noise, rows, ring, fixes, full, product, work."""
    head = memory[:HEAD_SIZE]
    m, p = int(head[Head.OTHERS]), int(head[Head.ORDER])
    n = int(head[Head.NAVIGATION]) + m
    width, capacity, fix_capacity = int(head[Head.WIDTH]), int(head[Head.CAPACITY]), int(head[Head.FIX_CAPACITY])
    a = HEAD_SIZE
    b = a + noise_size(m, p, int(head[Head.CHANNELS]))
    noise = memory[a:b]
    a, b = b, b + (capacity + 2) * width
    rows = memory[a:b].reshape(capacity + 2, width)
    a, b = b, b + capacity * SAMPLE_SIZE
    ring = memory[a:b].reshape(capacity, SAMPLE_SIZE)
    a, b = b, b + fix_capacity * FIX_SIZE
    fixes = memory[a:b].reshape(fix_capacity, FIX_SIZE)
    a, b = b, b + n * n
    full = memory[a:b].reshape(n, n)
    a, b = b, b + 81
    product = memory[a:b].reshape(9, 9)
    work = memory[b:b + 5 * n].reshape(5, n)
    return head, noise, rows, ring, fixes, full, product, work


@njit(cache=True)
def noise_size(m, p, channels):
    """Floats of the noise section: white (6) | decay, walk, variance (m each) | AR coefficients | b0 squared."""
    return 6 + 3 * m + channels * (p + 1)


@njit(cache=True)
def _advance(parts, k):
    """State k from state k - 1 and sample k: the interval is split at each fix in it."""
    head, noise, rows, ring, fixes, full, product, work = parts
    capacity = int(head[Head.CAPACITY])
    src, dst = (k - 1) % capacity, k % capacity
    sample = ring[dst]
    begin, end = rows[src, Nav.TIME], sample[Sample.TIME]
    count = int(head[Head.FIXES])
    first = count
    while first > 0 and fixes[first - 1, Fix.TIME] > begin:
        first -= 1
    at, spare = src, capacity
    for i in range(first, count):
        time = fixes[i, Fix.TIME]
        if time > end:
            break
        if time > rows[at, Nav.TIME]:
            _predict(head, noise, rows, at, spare, sample, time, full, product)
            at, spare = spare, (capacity + 1 if spare == capacity else capacity)
        _apply_fix(head, rows, at, fixes[i], full, work)
    if end > rows[at, Nav.TIME]:
        _predict(head, noise, rows, at, dst, sample, end, full, product)
    else:
        rows[dst] = rows[at]
    if rows[dst, Nav.CONSTRAINT_TIME] > CONSTRAINT_INTERVAL:
        _constrain(head, noise, rows, dst, sample, end - begin, full, work)


@njit(cache=True)
def _take_sample(parts, time, f_x, f_y, f_z, w_x, w_y, w_z):
    head, ring = parts[0], parts[3]
    k = int(head[Head.SAMPLES]) + 1
    sample = ring[k % int(head[Head.CAPACITY])]
    dt = time - ring[(k - 1) % int(head[Head.CAPACITY]), Sample.TIME]
    sample[Sample.TIME] = time
    for i in range(6):
        at = Head.CONDITIONING + 6 * i
        sample[Sample.F_X + i] = (head[at] * f_x + head[at + 1] * f_y + head[at + 2] * f_z + head[at + 3] * w_x
                                  + head[at + 4] * w_y + head[at + 5] * w_z + head[Head.OFFSET + i])
    if head[Head.ZERO_VELOCITY_SIGMA] > 0.0:
        sample[Sample.STILL] = _is_still(head, sample, dt)
    _advance(parts, k)
    head[Head.SAMPLES] = k


@njit(cache=True)
def _is_still(head, sample, dt):
    """1 when specific force and angular rate have scattered little over the last second, and nothing turns."""
    weight = min(1.0, dt / STILL_TIME)
    turn = 0.0
    for half in range(2):
        variance = 0.0
        for i in range(3 * half, 3 * half + 3):
            deviation = sample[Sample.F_X + i] - head[Head.STILL_MEAN + i]
            head[Head.STILL_MEAN + i] += weight * deviation
            variance += deviation * deviation
            if half == 1:
                turn = max(turn, abs(head[Head.STILL_MEAN + i]))
        head[Head.STILL_VARIANCE_F + half] += weight * (variance - head[Head.STILL_VARIANCE_F + half])
    if (head[Head.STILL_VARIANCE_F] < 3.0 * head[Head.STILL_ACCELERATION] ** 2
            and head[Head.STILL_VARIANCE_W] < 3.0 * head[Head.STILL_RATE] ** 2 and turn < head[Head.STILL_RATE]):
        return 1.0
    return 0.0


@njit(cache=True)
def _take_fix(parts, fix):
    head, _, rows, _, fixes, _, _, _ = parts
    capacity, newest = int(head[Head.CAPACITY]), int(head[Head.SAMPLES])
    oldest = max(0, newest - capacity + 1)
    time, now = fix[Fix.TIME], rows[newest % capacity, Nav.TIME]
    if time <= rows[oldest % capacity, Nav.TIME]:
        return FIX_BEFORE_START if oldest == 0 else FIX_TOO_LATE
    if now - time > head[Head.MAX_DELAY]:
        return FIX_TOO_LATE
    count = int(head[Head.FIXES])
    if count == len(fixes):  # forget the older half
        half = count // 2
        for i in range(half, count):
            fixes[i - half] = fixes[i]
        count -= half
    place = count
    while place > 0 and fixes[place - 1, Fix.TIME] > time:
        fixes[place] = fixes[place - 1]
        place -= 1
    fixes[place] = fix
    head[Head.FIXES] = count + 1
    if time <= now:  # late: back to the state before it and forward again
        k = newest
        while rows[k % capacity, Nav.TIME] >= time:
            k -= 1
        for i in range(k + 1, newest + 1):
            _advance(parts, i)
    return FIX_TAKEN


@njit(cache=True)
def take_sample(memory, time, f_x, f_y, f_z, w_x, w_y, w_z):
    """Predict to `time` (s since the epoch) with one IMU sample in sensor axes, applying the fixes before it."""
    _take_sample(views(memory), time, f_x, f_y, f_z, w_x, w_y, w_z)


@njit(cache=True)
def take_fix(memory, fix):
    """Take in one fix, a vector as in `Fix`; FIX_TAKEN, or why not."""
    return _take_fix(views(memory), fix)


@njit(cache=True)
def run(memory, time, specific_force, angular_rate, fixes, arrival, answers, columns, states):
    """A whole recording through the same filter.

    time (k,) s, specific_force and angular_rate (k, 3): samples in sensor axes. fixes (f, FIX_SIZE) in the order of their arrival, on return with their innovations;
    arrival (f,): the number of samples that arrived before each; answers (f,): as `take_fix` answers.
    states (k, len(columns)): those columns of each state as a live filter would have published it.
    """
    parts = views(memory)
    head, rows, kept = parts[0], parts[2], parts[4]
    capacity = int(head[Head.CAPACITY])
    next_fix = 0
    for k in range(len(time)):
        while next_fix < len(fixes) and arrival[next_fix] <= k:
            if int(head[Head.FIXES]) == len(kept):
                _collect(kept, len(kept), fixes)
            fixes[next_fix, Fix.ID] = next_fix
            answers[next_fix] = _take_fix(parts, fixes[next_fix])
            next_fix += 1
        _take_sample(parts, time[k], specific_force[k, 0], specific_force[k, 1], specific_force[k, 2],
                     angular_rate[k, 0], angular_rate[k, 1], angular_rate[k, 2])
        newest = int(head[Head.SAMPLES]) % capacity
        for i in range(len(columns)):
            states[k, i] = rows[newest, columns[i]]
    _collect(kept, int(head[Head.FIXES]), fixes)


@njit(cache=True)
def _collect(kept, count, fixes):
    """Innovations of the fixes remembered, back to where each came from."""
    for i in range(count):
        fixes[int(kept[i, Fix.ID])] = kept[i]
