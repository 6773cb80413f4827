"""Prediction of one state from the one before it (Eq. 4 and 5), for each mechanization, in blocks.

P_nn navigation, P_ns cross, P_ss sensor errors; Phi = [[F, B], [0, A]] with A diagonal for random walk and
Gauss-Markov, and one companion matrix per channel that steps once per T_s for AR(p). F and B are never written down:
`error_step` of the mechanization applies them to a column.

All functions work on the flat memory, because an array more costs as much as the mathematics: `src`, `dst` and `sample`
are positions in it, of the state before, of the state to write, and of the IMU sample of the interval.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..navigation import planar, strapdown
from ..navigation.earth import gravity, radii
from .layout import NAV, PLANAR, Head, Nav, Sample, packed

#: what a land vehicle may do unseen while the IMU is silent (one sigma): the covariance of a bridged gap
GAP_ACCELERATION = 1.5  # m/s^2
GAP_TURN_RATE = 0.3  # rad/s
LONGEST_BRIDGE = 2.0  # s: after that they are others
#: the radii are computed anew after this much latitude, rad (13 m): the scale is then good to 2e-6
RADII_STEP = 2e-6


@njit(_nrt=False, fastmath={'contract'})
def predict(mem, src, dst, sample, dt):
    """State dst = state src, predicted over dt with one IMU sample; its TIME is left to the caller, who knows it."""
    if src < 0 or dst < 0 or sample < 0:  # never: but it tells the compiler that no index counts from the end
        return
    m, p = int(mem[Head.N_AUGMENTED]), int(mem[Head.ORDER])
    if mem[Head.MECHANIZATION] != PLANAR:
        _step_strapdown(mem, src, dst, sample, dt, m, p)
    elif m == 6 and p == 2:  # AR(2), with its sizes known to the compiler: a third faster (the others gain nothing)
        _step_planar(mem, src, dst, sample, dt, 6, 2)
    else:
        _step_planar(mem, src, dst, sample, dt, m, p)
    for k in range(Nav.MEMORY, NAV):
        mem[dst + k] = mem[src + k]
    if dt > mem[Head.MAX_GAP] or mem[sample + Sample.FAULT] != 0.0:
        _bridge(mem, dst, dt, m)
    else:
        mem[dst + Nav.BRIDGED] = 0.0


@njit(_nrt=False)
def set_radii(mem, r):
    """Latitude and longitude per metre at the position of row r."""
    north, east = radii(mem[r + Nav.LATITUDE])
    height = mem[r + Nav.HEIGHT]
    mem[r + Nav.RADII_LATITUDE] = mem[r + Nav.LATITUDE]
    mem[r + Nav.NORTH_SCALE] = 1.0 / (north + height)
    mem[r + Nav.EAST_SCALE] = 1.0 / ((east + height) * math.cos(mem[r + Nav.LATITUDE]))


@njit(_nrt=False)
def _move(mem, src, dst, north, east):
    """Position of row dst: that of src moved by a displacement in m."""
    mem[dst + Nav.LATITUDE] = mem[src + Nav.LATITUDE] + north * mem[src + Nav.NORTH_SCALE]
    mem[dst + Nav.LONGITUDE] = mem[src + Nav.LONGITUDE] + east * mem[src + Nav.EAST_SCALE]
    mem[dst + Nav.RADII_LATITUDE] = mem[src + Nav.RADII_LATITUDE]
    mem[dst + Nav.NORTH_SCALE] = mem[src + Nav.NORTH_SCALE]
    mem[dst + Nav.EAST_SCALE] = mem[src + Nav.EAST_SCALE]
    if abs(mem[dst + Nav.LATITUDE] - mem[dst + Nav.RADII_LATITUDE]) > RADII_STEP:
        set_radii(mem, dst)


@njit(inline='always')
def _step_planar(mem, src, dst, sample, dt, m, p):
    """One interval of the planar mechanization with m states behind the navigation errors, p for each channel."""
    x = NAV + 5
    # columns of the blocks of P (navigation a, cross b), and of the errors of f_x, f_y, w_z
    a = x + m
    b = a + 15
    jx, jy, jw = 0, p, 2 * p
    bx, by, bw = b, b + 5 * p, b + 10 * p
    f_x, f_y, w_z = mem[sample + Sample.F_X], mem[sample + Sample.F_Y], mem[sample + Sample.W_Z]
    closed = mem[Head.OPEN_LOOP] == 0.0
    if closed:
        f_x -= mem[src + x]
        f_y -= mem[src + x + p]
        w_z -= mem[src + x + 2 * p]
    yaw = mem[src + Nav.YAW]
    f_n, f_e, c, s = planar.rotate(yaw, dt, f_x, f_y, w_z)
    north, east, v_n, v_e, yaw = planar.mechanize(mem[src + Nav.V_N], mem[src + Nav.V_E], yaw, f_x, f_y, w_z, dt)
    _move(mem, src, dst, north, east)
    mem[dst + Nav.HEIGHT] = mem[src + Nav.HEIGHT]
    mem[dst + Nav.V_N] = v_n
    mem[dst + Nav.V_E] = v_e
    mem[dst + Nav.YAW] = yaw

    if closed:
        for i in range(5):
            mem[dst + NAV + i] = 0.0
    else:
        (mem[dst + NAV], mem[dst + NAV + 1], mem[dst + NAV + 2], mem[dst + NAV + 3],
         mem[dst + NAV + 4]) = planar.error_step(
            dt, f_n, f_e, c, s, mem[src + NAV], mem[src + NAV + 1], mem[src + NAV + 2], mem[src + NAV + 3],
            mem[src + NAV + 4], mem[src + x], mem[src + x + p], mem[src + x + 2 * p])

    if mem[Head.HISTORY_AT] > 0.0:
        _carry_planar(mem, dt, f_n, f_e, c, s, m, p)
    # Phi P, column by column
    g00, g10, g20, g30, g40 = planar.error_step(
        dt, f_n, f_e, c, s, mem[src + a], mem[src + a + 1], mem[src + a + 2], mem[src + a + 3], mem[src + a + 4],
        mem[src + bx], mem[src + by], mem[src + bw])
    g01, g11, g21, g31, g41 = planar.error_step(
        dt, f_n, f_e, c, s, mem[src + a + 1], mem[src + a + 5], mem[src + a + 6], mem[src + a + 7], mem[src + a + 8],
        mem[src + bx + 1], mem[src + by + 1], mem[src + bw + 1])
    g02, g12, g22, g32, g42 = planar.error_step(
        dt, f_n, f_e, c, s, mem[src + a + 2], mem[src + a + 6], mem[src + a + 9], mem[src + a + 10], mem[src + a + 11],
        mem[src + bx + 2], mem[src + by + 2], mem[src + bw + 2])
    g03, g13, g23, g33, g43 = planar.error_step(
        dt, f_n, f_e, c, s, mem[src + a + 3], mem[src + a + 7], mem[src + a + 10], mem[src + a + 12], mem[src + a + 13],
        mem[src + bx + 3], mem[src + by + 3], mem[src + bw + 3])
    g04, g14, g24, g34, g44 = planar.error_step(
        dt, f_n, f_e, c, s, mem[src + a + 4], mem[src + a + 8], mem[src + a + 11], mem[src + a + 13], mem[src + a + 14],
        mem[src + bx + 4], mem[src + by + 4], mem[src + bw + 4])
    x0, x1, x2, x3, x4 = _cross_column(mem, src, dt, f_n, f_e, c, s, jx, m, p)
    y0, y1, y2, y3, y4 = _cross_column(mem, src, dt, f_n, f_e, c, s, jy, m, p)
    w0, w1, w2, w3, w4 = _cross_column(mem, src, dt, f_n, f_e, c, s, jw, m, p)

    # (Phi P) Phi^T, row by row; the sensors' white noise enters like an error that lasts one interval
    h = 0.5 * dt
    nx, ny, nw = mem[Head.SIZE + 0], mem[Head.SIZE + 1], mem[Head.SIZE + 5]
    a00, a01, a02, a03, a04 = planar.error_step(
        dt, f_n, f_e, c, s, g00, g01, g02, g03, g04, x0 + nx * h * c, y0 - ny * h * s, w0 - nw * h * h * f_e)
    _, a11, a12, a13, a14 = planar.error_step(
        dt, f_n, f_e, c, s, g10, g11, g12, g13, g14, x1 + nx * h * s, y1 + ny * h * c, w1 + nw * h * h * f_n)
    _, _, a22, a23, a24 = planar.error_step(
        dt, f_n, f_e, c, s, g20, g21, g22, g23, g24, x2 + nx * c, y2 - ny * s, w2 - nw * h * f_e)
    _, _, _, a33, a34 = planar.error_step(
        dt, f_n, f_e, c, s, g30, g31, g32, g33, g34, x3 + nx * s, y3 + ny * c, w3 + nw * h * f_n)
    _, _, _, _, a44 = planar.error_step(dt, f_n, f_e, c, s, g40, g41, g42, g43, g44, x4, y4, w4 + nw)
    mem[dst + a], mem[dst + a + 1], mem[dst + a + 2], mem[dst + a + 3], mem[dst + a + 4] = a00, a01, a02, a03, a04
    mem[dst + a + 5], mem[dst + a + 6], mem[dst + a + 7], mem[dst + a + 8] = a11, a12, a13, a14
    mem[dst + a + 9], mem[dst + a + 10], mem[dst + a + 11] = a22, a23, a24
    mem[dst + a + 12], mem[dst + a + 13], mem[dst + a + 14] = a33, a34, a44
    for j in range(m):
        k = dst + b + 5 * j
        if j == jx:
            r0, r1, r2, r3, r4 = x0, x1, x2, x3, x4
        elif j == jy:
            r0, r1, r2, r3, r4 = y0, y1, y2, y3, y4
        elif j == jw:
            r0, r1, r2, r3, r4 = w0, w1, w2, w3, w4
        else:
            r0, r1, r2, r3, r4 = _cross_column(mem, src, dt, f_n, f_e, c, s, j, m, p)
        decay = _decay(dt * mem[Head.SIZE + 6 + j])
        mem[k], mem[k + 1], mem[k + 2] = decay * r0, decay * r1, decay * r2
        mem[k + 3], mem[k + 4] = decay * r3, decay * r4
    _sensor_states(mem, src, dst, dt, 5, m, p)


@njit(_nrt=False)
def _carry_planar(mem, dt, f_n, f_e, c, s, m, p):
    """The transition of the history over one interval: its navigation rows."""
    n = 5 + m
    for k in range(int(mem[Head.HISTORY_AT]), int(mem[Head.HISTORY_AT]) + n):
        x = k + 5 * n
        moved = planar.error_step(dt, f_n, f_e, c, s, mem[k], mem[k + n], mem[k + 2 * n], mem[k + 3 * n],
                                  mem[k + 4 * n], mem[x], mem[x + n * p], mem[x + 2 * n * p])
        for i in range(5):
            mem[k + n * i] = moved[i]


@njit(_nrt=False)
def _carry_strapdown(mem, step, m, p):
    """The same for the strapdown mechanization."""
    n = 9 + m
    for k in range(int(mem[Head.HISTORY_AT]), int(mem[Head.HISTORY_AT]) + n):
        x, q = k + 9 * n, n * p
        moved = strapdown.error_step(step, (mem[k], mem[k + n], mem[k + 2 * n]),
                                     (mem[k + 3 * n], mem[k + 4 * n], mem[k + 5 * n]),
                                     (mem[k + 6 * n], mem[k + 7 * n], mem[k + 8 * n]),
                                     (mem[x], mem[x + q], mem[x + 2 * q]),
                                     (mem[x + 3 * q], mem[x + 4 * q], mem[x + 5 * q]))
        for i in range(9):
            mem[k + n * i] = moved[i]


@njit(_nrt=False)
def _carry_sensors(mem, dt, size, m):
    """The rows behind the navigation errors."""
    n = size + m
    for j in range(m):
        decay, at = _decay(dt * mem[Head.SIZE + 6 + j]), int(mem[Head.HISTORY_AT]) + n * (size + j)
        for k in range(at, at + n):
            mem[k] *= decay


@njit(inline='always')
def _cross_column(mem, src, dt, f_n, f_e, c, s, j, m, p):
    """Column j of the cross block of Phi P."""
    k = src + NAV + 5 + m + 15
    e = k + 5 * m + j
    k += 5 * j
    return planar.error_step(dt, f_n, f_e, c, s, mem[k], mem[k + 1], mem[k + 2], mem[k + 3], mem[k + 4],
                             mem[e], mem[e + m * p], mem[e + 2 * m * p])


@njit(_nrt=False)
def _bridge(mem, r, dt, m):
    """Add to the covariance of row r what a vehicle may have done unseen for dt, while no sample could be believed.

    An acceleration and a turn rate that last: what they add in dt depends on how long it has been so.
    """
    before = mem[r + Nav.BRIDGED]
    after = before + dt
    mem[r + Nav.BRIDGED] = min(after, LONGEST_BRIDGE)
    squares = after**2 - before**2
    velocity, turn = GAP_ACCELERATION**2 * squares, GAP_TURN_RATE**2 * squares
    position = 0.25 * GAP_ACCELERATION**2 * (after**4 - before**4)
    if mem[Head.MECHANIZATION] == PLANAR:
        a = r + NAV + 5 + m
        for i in range(2):
            mem[a + packed(i, i, 5)] += position
            mem[a + packed(2 + i, 2 + i, 5)] += velocity
        mem[a + packed(4, 4, 5)] += turn
        return
    a = r + NAV + 9 + m
    for i in range(3):
        mem[a + packed(i, i, 9)] += position
        mem[a + packed(3 + i, 3 + i, 9)] += velocity
        mem[a + packed(6 + i, 6 + i, 9)] += turn if i == 2 else 0.1 * turn


@njit
def _decay(x):
    """exp(-x), x >= 0: by its series, to rounding, where x is small - it always is at IMU rate."""
    if x < 0.01:
        return 1.0 - x * (1.0 - x * (1 / 2 - x * (1 / 6 - x * (1 / 24 - x * (1 / 120)))))
    return math.exp(-x)


@njit(inline='always')
def _sensor_states(mem, src, dst, dt, size, m, p):
    """The m states behind the `size` navigation errors: x, their covariance, and the steps of AR(p)."""
    x = NAV + size
    b = x + m + size * (size + 1) // 2
    e = b + size * m
    first, last = (2 * p, 3 * p) if size == 5 else (3 * p, 6 * p)  # the gyroscopes' states
    for j in range(m):
        drift = mem[src + Nav.DRIFT_RATIO] if first <= j < last else 1.0
        decay = _decay(dt * mem[Head.SIZE + 6 + j])
        mem[dst + x + j] = decay * mem[src + x + j]
        # sensor block: row j is scaled now, column j when each row below it has been
        for i in range(j):
            both = mem[dst + e + m * i + j] * decay
            mem[dst + e + m * i + j] = both
            mem[dst + e + m * j + i] = both
        for i in range(j + 1, m):
            mem[dst + e + m * j + i] = decay * mem[src + e + m * j + i]
        squared = decay * decay
        mem[dst + e + (m + 1) * j] = (squared * mem[src + e + (m + 1) * j] + drift * (
            mem[Head.SIZE + 6 + m + j] * dt + mem[Head.SIZE + 6 + 2 * m + j] * (1.0 - squared)))
    if mem[Head.HISTORY_AT] > 0.0:
        _carry_sensors(mem, dt, size, m)
    if mem[Head.ACCELEROMETER_INTERVAL] > 0.0:
        _autoregressive(mem, src, dst, dt, size, m, p)
    mem[dst + Nav.CONSTRAINT_TIME] = mem[src + Nav.CONSTRAINT_TIME] + dt


@njit(inline='always')
def _autoregressive(mem, src, dst, dt, size, m, p):
    """Step the companion blocks of accelerometers and gyroscopes, each once for every T_s that has passed (Eq. 22)."""
    accelerometers, channels = (2, 3) if size == 5 else (3, 6)
    for sensor in range(2):
        phase, interval = Nav.ACCELEROMETER_PHASE + sensor, mem[Head.ACCELEROMETER_INTERVAL + sensor]
        first, last = (0, accelerometers) if sensor == 0 else (accelerometers, channels)
        mem[dst + phase] = mem[src + phase] + dt
        while mem[dst + phase] > interval * (1.0 - 1e-6):
            mem[dst + phase] -= interval
            drift = mem[src + Nav.DRIFT_RATIO] if sensor else 1.0
            for channel in range(first, last):
                _step_channel(mem, dst, size, m, p, channel, channels, drift)


@njit(inline='always')
def _step_channel(mem, dst, size, m, p, channel, channels, drift):
    """One step of one channel's AR(p): companion matrix on x, on both sides of P, and b0^2 times `drift`."""
    x = NAV + size
    b = x + m + size * (size + 1) // 2
    e = b + size * m
    start, a = channel * p, 6 + 3 * m + channel * p
    _companion(mem, dst + x + start, 1, p, a)
    for i in range(size):
        _companion(mem, dst + b + size * start + i, size, p, a)
    for j in range(m):
        _companion(mem, dst + e + m * start + j, m, p, a)
    for i in range(m):
        _companion(mem, dst + e + m * i + start, 1, p, a)
    if mem[Head.HISTORY_AT] > 0.0:
        n = size + m
        for k in range(n):
            _companion(mem, int(mem[Head.HISTORY_AT]) + n * (size + start) + k, n, p, a)
    mem[dst + e + (m + 1) * start] += drift * mem[Head.SIZE + 6 + 3 * m + channels * p + channel]


@njit(inline='always')
def _companion(mem, at, stride, p, a):
    """y = -a_1 v_1 - ... - a_p v_p in front, the rest moves back: p elements of a row, `stride` apart."""
    y = 0.0
    for k in range(p - 1, -1, -1):
        y -= mem[Head.SIZE + a + k] * mem[at + k * stride]
        if k > 0:
            mem[at + k * stride] = mem[at + (k - 1) * stride]
    mem[at] = y


@njit(_nrt=False, fastmath={'contract'})
def _step_strapdown(mem, src, dst, sample, dt, m, p):
    """One interval of the strapdown mechanization."""
    x = NAV + 9
    a = x + m
    b = a + 45
    e = b + 9 * m
    closed = mem[Head.OPEN_LOOP] == 0.0
    f = (mem[sample + Sample.F_X], mem[sample + Sample.F_Y], mem[sample + Sample.F_Z])
    w = (mem[sample + Sample.W_X], mem[sample + Sample.W_Y], mem[sample + Sample.W_Z])
    if closed:
        f = (f[0] - mem[src + x], f[1] - mem[src + x + p], f[2] - mem[src + x + 2 * p])
        w = (w[0] - mem[src + x + 3 * p], w[1] - mem[src + x + 4 * p], w[2] - mem[src + x + 5 * p])
    latitude, height = mem[src + Nav.LATITUDE], mem[src + Nav.HEIGHT]
    rates = strapdown.frame_rates(latitude, mem[src + Nav.V_N], mem[src + Nav.V_E], 1.0 / mem[src + Nav.NORTH_SCALE],
                                  1.0 / (mem[src + Nav.EAST_SCALE] * math.cos(latitude)))
    attitude, c, f_level, moved, velocity = strapdown.mechanize(
        (mem[src + Nav.Q_W], mem[src + Nav.Q_X], mem[src + Nav.Q_Y], mem[src + Nav.Q_Z]), mem[src + Nav.V_N],
        mem[src + Nav.V_E], mem[src + Nav.V_D], f, w, dt, gravity(latitude, height), rates)
    step = strapdown.transition(dt, c, f_level)
    if mem[Head.HISTORY_AT] > 0.0:
        _carry_strapdown(mem, step, m, p)
    _move(mem, src, dst, moved[0], moved[1])
    mem[dst + Nav.HEIGHT] = height - moved[2]
    mem[dst + Nav.V_N], mem[dst + Nav.V_E], mem[dst + Nav.V_D] = velocity
    mem[dst + Nav.Q_W], mem[dst + Nav.Q_X], mem[dst + Nav.Q_Y], mem[dst + Nav.Q_Z] = attitude

    if closed:
        for i in range(9):
            mem[dst + NAV + i] = 0.0
    else:
        k = NAV
        _store(mem, dst + k, strapdown.error_step(
            step, (mem[src + k], mem[src + k + 1], mem[src + k + 2]),
            (mem[src + k + 3], mem[src + k + 4], mem[src + k + 5]),
            (mem[src + k + 6], mem[src + k + 7], mem[src + k + 8]),
            (mem[src + x], mem[src + x + p], mem[src + x + 2 * p]),
            (mem[src + x + 3 * p], mem[src + x + 4 * p], mem[src + x + 5 * p])))
    for j in range(m):
        errors = (mem[src + e + j], mem[src + e + m * p + j], mem[src + e + 2 * m * p + j])
        turns = (mem[src + e + 3 * m * p + j], mem[src + e + 4 * m * p + j], mem[src + e + 5 * m * p + j])
        k = b + 9 * j
        _store(mem, dst + k, strapdown.error_step(
            step, (mem[src + k], mem[src + k + 1], mem[src + k + 2]),
            (mem[src + k + 3], mem[src + k + 4], mem[src + k + 5]),
            (mem[src + k + 6], mem[src + k + 7], mem[src + k + 8]), errors, turns))

    # Phi P, column by column, then (Phi P) Phi^T, row by row; scratch: P_nn at s, the transpose of Phi P at g
    s = int(mem[Head.SCRATCH_AT])
    g = s + 81
    column = src + a
    for i in range(9):
        for j in range(i, 9):
            mem[s + 9 * i + j] = mem[s + 9 * j + i] = mem[column]
            column += 1
    for j in range(9):
        k, q = src + b + j, s + 9 * j
        _store(mem, g + 9 * j, strapdown.error_step(
            step, (mem[q], mem[q + 1], mem[q + 2]), (mem[q + 3], mem[q + 4], mem[q + 5]),
            (mem[q + 6], mem[q + 7], mem[q + 8]), (mem[k], mem[k + 9 * p], mem[k + 18 * p]),
            (mem[k + 27 * p], mem[k + 36 * p], mem[k + 45 * p])))
    column = dst + a
    for i in range(9):
        k, q = dst + b + i, g + i
        white_f, white_w = _white(mem, i, dt, c, f_level)
        result = strapdown.error_step(
            step, (mem[q], mem[q + 9], mem[q + 18]), (mem[q + 27], mem[q + 36], mem[q + 45]),
            (mem[q + 54], mem[q + 63], mem[q + 72]),
            (mem[k] + white_f[0], mem[k + 9 * p] + white_f[1], mem[k + 18 * p] + white_f[2]),
            (mem[k + 27 * p] + white_w[0], mem[k + 36 * p] + white_w[1], mem[k + 45 * p] + white_w[2]))
        for j in range(i, 9):
            mem[column] = result[j]
            column += 1
    for j in range(m):
        decay = _decay(dt * mem[Head.SIZE + 6 + j])
        for i in range(9):
            mem[dst + b + 9 * j + i] *= decay
    _sensor_states(mem, src, dst, dt, 9, m, p)


@njit(inline='always')
def _store(mem, at, values):
    """Nine values side by side."""
    for i in range(9):
        mem[at + i] = values[i]


@njit(inline='always')
def _white(mem, i, dt, c, f):
    """Row i of B diag(density / dt), the white noise of the six sensors: for f, for w."""
    h, n = 0.5 * dt, i % 3
    x, y, z = c[3 * n], c[3 * n + 1], c[3 * n + 2]
    if i >= 6:
        return (0.0, 0.0, 0.0), (x * mem[Head.SIZE + 3], y * mem[Head.SIZE + 4], z * mem[Head.SIZE + 5])
    lever = h if i < 3 else 1.0
    # the specific force in n turns with the attitude: (C dw) x f, component n
    j, k = (n + 1) % 3, (n + 2) % 3
    turned = (c[3 * j] * f[k] - c[3 * k] * f[j], c[3 * j + 1] * f[k] - c[3 * k + 1] * f[j],
              c[3 * j + 2] * f[k] - c[3 * k + 2] * f[j])
    white_f = (lever * x * mem[Head.SIZE], lever * y * mem[Head.SIZE + 1], lever * z * mem[Head.SIZE + 2])
    lever *= h
    return white_f, (lever * turned[0] * mem[Head.SIZE + 3], lever * turned[1] * mem[Head.SIZE + 4],
                     lever * turned[2] * mem[Head.SIZE + 5])
